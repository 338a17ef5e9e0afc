//! Makes pictures of snapshots: where all nodes are is found once for each, and everything else follows from that.
//!
//! Entry points: [`Painter::new`], [`Painter::paint`]. Allocates, in a thread of its own.

use super::boundary::Boundary;
use super::describe::statuses;
use super::message::{NeedleView, Picture, StatusView, ThreadPointView, ThreadView, ToolView};
use crate::fem::von_mises_pa;
use crate::model::Model;
use crate::needle::TipPlace;
use crate::scene::{Needle, Scene, Tool};
use crate::session::Snapshot;
use crate::step::State;
use crate::thread::{FreeThreads, Hanging, ThreadPlace, ThreadTension};

/// What is shown at the vertices in colours.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scalar {
    /// How far they have moved.
    Displacement,
    /// Largest principal stress, tension positive.
    StressLargest,
    /// Smallest principal stress.
    StressSmallest,
    /// Equivalent stress of von Mises.
    VonMises,
    /// Of what pushes there.
    Pressure,
}

impl Scalar {
    /// All of them, in the order of their numbers.
    pub const ALL: [Scalar; 5] = [
        Scalar::Displacement,
        Scalar::StressLargest,
        Scalar::StressSmallest,
        Scalar::VonMises,
        Scalar::Pressure,
    ];

    /// Its name, its unit, and whether it has a sign.
    pub fn words(self) -> (&'static str, &'static str, bool) {
        match self {
            Scalar::Displacement => ("displacement", "m", false),
            Scalar::StressLargest => ("stress-largest", "Pa", true),
            Scalar::StressSmallest => ("stress-smallest", "Pa", true),
            Scalar::VonMises => ("von-mises", "Pa", false),
            Scalar::Pressure => ("pressure", "Pa", false),
        }
    }

    /// The one of this name.
    pub fn named(name: &str) -> Option<Scalar> {
        Scalar::ALL
            .into_iter()
            .find(|scalar| scalar.words().0 == name)
    }

    /// The one of this number, from 1.
    pub fn numbered(number: u8) -> Option<Scalar> {
        let place = usize::from(number).checked_sub(1)?;
        Scalar::ALL.get(place).copied()
    }

    /// Its number in messages, from 1.
    pub fn number(self) -> u8 {
        1 + self as u8
    }

    /// Whether a solver of a model to which tools stick has none.
    pub fn needs_model(self) -> bool {
        self != Scalar::Displacement
    }
}

/// What pictures of one scene have in common.
#[derive(Clone, Debug)]
pub struct Painter {
    boundary: Boundary,
    tools: Vec<Tool>,
    needles: Vec<Needle>,
    threads: Vec<u8>,
}

impl Painter {
    /// Of a scene, whose geometry gets this number.
    pub fn new(scene: &Scene, geometry: u32) -> Self {
        Self {
            boundary: Boundary::of(&scene.mesh, &scene.fixed, geometry),
            tools: scene.tools.clone(),
            needles: scene.needles.clone(),
            threads: scene.threads.iter().map(|thread| thread.part.id).collect(),
        }
    }

    /// What does not change.
    pub fn boundary(&self) -> &Boundary {
        &self.boundary
    }

    /// A picture of a solver of this scene, with its threads as they hang after their last beat; straight without.
    pub fn paint(
        &self,
        of: &Snapshot,
        hanging: Option<&mut Hanging>,
        scalar: Option<Scalar>,
        sequence: u32,
    ) -> Picture {
        let nodes_m = of.positions_m();
        let free = hanging.and_then(|hanging| of.threads(hanging, &nodes_m));
        let moved = |(node, from): (&u32, &[f64; 3])| {
            let at = nodes_m.get(*node as usize).unwrap_or(from);
            [0, 1, 2].map(|axis: usize| at[axis] - from[axis])
        };
        let vertices = self.boundary.nodes.iter().zip(&self.boundary.points_m);
        let displacement_m: Vec<[f64; 3]> = vertices.map(moved).collect();
        let contacts = self.contacts(of.constrained());
        let scalar = scalar.and_then(|scalar| {
            let values = self.values(scalar, of, &nodes_m, &displacement_m, &contacts)?;
            Some((scalar, values))
        });
        let (needles, threads) = match of.constrained() {
            Some(tissue) => (
                self.needles(of, tissue),
                self.threads(of, tissue, free, &nodes_m),
            ),
            None => (Vec::new(), Vec::new()),
        };
        Picture {
            sequence,
            recorded: false,
            withheld: !of.last().status.has_balance(),
            time_s: of.time_s(),
            console_time_us: of.console_time_us(),
            solves: of.solves,
            geometry: self.boundary.number,
            displacement_m,
            scalar,
            tools: self.tools(of),
            needles,
            threads,
            contacts,
            status: self.status(of, &nodes_m),
        }
    }

    /// What pushes at the boundary.
    fn contacts(&self, tissue: Option<(&Model, &State)>) -> Vec<(u32, [f64; 3])> {
        let forces = tissue
            .into_iter()
            .flat_map(|(model, state)| state.contact_forces(model));
        let on_vertices =
            forces.filter_map(|(node, force_n)| Some((self.boundary.vertex(node)?, force_n)));
        on_vertices.collect()
    }

    fn values(
        &self,
        scalar: Scalar,
        of: &Snapshot,
        nodes_m: &[[f64; 3]],
        displacement_m: &[[f64; 3]],
        contacts: &[(u32, [f64; 3])],
    ) -> Option<Vec<f64>> {
        let stress = |value: fn(&[f64; 3]) -> f64| {
            let (model, _) = of.constrained()?;
            let ways = nodes_m.iter().zip(model.points_m());
            let moved: Vec<[f64; 3]> = ways
                .map(|(at, from)| [0, 1, 2].map(|axis: usize| at[axis] - from[axis]))
                .collect();
            let principal = model.principal_stress_in_pa(&moved, &self.boundary.cells);
            let of_triangles: Vec<f64> = principal.iter().map(value).collect();
            Some(self.boundary.by_area(&of_triangles))
        };
        match scalar {
            Scalar::Displacement => {
                let length = |[x, y, z]: &[f64; 3]| (x * x + y * y + z * z).sqrt();
                Some(displacement_m.iter().map(length).collect())
            }
            Scalar::StressLargest => stress(|[largest, _, _]| *largest),
            Scalar::StressSmallest => stress(|[_, _, smallest]| *smallest),
            Scalar::VonMises => stress(von_mises_pa),
            Scalar::Pressure => of
                .constrained()
                .map(|_| self.boundary.pressure_pa(contacts)),
        }
    }

    fn tools(&self, of: &Snapshot) -> Vec<ToolView> {
        let contacts = of.last().contacts();
        let each = of.samples().iter().filter_map(|sample| {
            let tool = self.tools.iter().find(|tool| tool.id == sample.id)?;
            let placement = tool.seen().place(sample)?;
            let contact = contacts.iter().find(|contact| contact.id == tool.id);
            Some(ToolView {
                id: tool.id,
                driven: tool.driven,
                position_m: placement.centre.into(),
                orientation: placement.rotation.coords.into(),
                wrench: contact.map_or([f64::NAN; 6], |contact| contact.wrench),
                gap_m: contact.map_or(f64::INFINITY, |contact| contact.gap_m),
                rows: contact.map_or(0, |contact| contact.rows),
            })
        });
        each.collect()
    }

    fn needles(&self, of: &Snapshot, (model, state): (&Model, &State)) -> Vec<NeedleView> {
        let each = self.needles.iter().map(|needle| {
            let pose = state.needle_pose(model, needle.id).unwrap_or(needle.start);
            let reports = of.good().needles().iter();
            let report = reports.copied().find(|report| report.id == needle.id);
            let report = report.unwrap_or_default();
            NeedleView {
                id: needle.id,
                tip: match report.tip {
                    TipPlace::Outside => 0,
                    TipPlace::Holding => 1,
                    TipPlace::Inside => 2,
                    TipPlace::Waiting => 3,
                },
                held_by: report.held_by,
                position_m: pose.translation.vector.into(),
                orientation: pose.rotation.coords.into(),
                crossings: report.crossings,
                punctures: report.punctures,
                axial_n: report.axial_n,
                hold_n: report.hold_n,
                puncture_n: report.puncture_n,
            }
        });
        each.collect()
    }

    fn threads(
        &self,
        of: &Snapshot,
        (model, state): (&Model, &State),
        free: Option<&FreeThreads>,
        nodes_m: &[[f64; 3]],
    ) -> Vec<ThreadView> {
        let each = self.threads.iter().map(|id| {
            let report = of.good().threads().iter().find(|report| report.id == *id);
            let straight = || state.thread_path(model, *id, nodes_m);
            let path = free.map_or_else(straight, |free| free.path(*id).to_vec());
            let points = path.iter().map(|point| ThreadPointView {
                at_m: point.at_m,
                what: match point.what {
                    ThreadPlace::End => 0,
                    ThreadPlace::Inside => 1,
                    ThreadPlace::Enters => 2,
                    ThreadPlace::Leaves => 3,
                    ThreadPlace::Wraps => 4,
                    ThreadPlace::Hangs => 5,
                    ThreadPlace::Cut => 6,
                },
                tension_n: point.tension_n,
            });
            ThreadView {
                id: *id,
                state: match report.map(|report| report.state).unwrap_or_default() {
                    ThreadTension::Slack => 0,
                    ThreadTension::Taut => 1,
                },
                points: points.collect(),
            }
        });
        each.filter(|thread| thread.points.len() > 1).collect()
    }

    fn status(&self, of: &Snapshot, nodes_m: &[[f64; 3]]) -> StatusView {
        let (last, good) = (of.last(), of.good());
        let bridges = of.constrained().into_iter().flat_map(|(model, state)| {
            let of_thread = |id: &u8| state.bridges(model, *id, nodes_m);
            self.threads.iter().flat_map(of_thread).collect::<Vec<_>>()
        });
        let ends = good.threads().iter().flat_map(|thread| thread.tension_n);
        let word = last.status.name();
        let place = statuses().iter().position(|status| *status == word);
        let contact = last.contacts().first();
        StatusView {
            word: place.unwrap_or_default() as u8,
            touches: contact.is_some_and(|contact| contact.rows > 0),
            rows: last.rows,
            touching: good.touching,
            iterations: last.iterations,
            residual: last.residual,
            energy_j: good.stored_energy_j,
            tension_n: ends.reduce(f64::max),
            bridge_ratio: bridges
                .map(|span| span.now_m / span.rest_m)
                .reduce(f64::max),
            grip_m: of
                .samples()
                .first()
                .map_or([0.0; 3], |sample| sample.position_m),
        }
    }
}
