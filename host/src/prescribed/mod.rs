//! Any tissue model with tools that stick to it: nodes go where tools take them, and what holds them back is what tools feel.
//!
//! Entry points: `Prescribed::new`, `Prescribed::follow`. For models without the compliance that rows need; those that
//! have it go with [`step`](crate::step::step), whose tools slip.

mod fading;
mod sticking;

use crate::clock::Clock;
use crate::contact::entry::{Nearest, way_in};
use crate::contact::shape::Solid;
use crate::hash::hash_of;
use crate::mesh::Surface;
use crate::model::check_tools;
use crate::registry;
use crate::scene::{Registered, Rendering, Scene, SceneError};
use crate::script::{at_rest, outside};
use crate::step::{Status, StepReport, ToolContact};
use crate::tool::{MAX_TOOLS, Placement, Shape, Tool, ToolSample};
use fading::Fading;
use miette::Diagnostic;
use nalgebra::Vector3;
use serde_json::{Value, json};
use sticking::{Sticking, Tools, Touched, stacked};
use sutura_client::ahead::reach_m;
use sutura_models::{Outcome, Tissue};
use thiserror::Error;

/// Most balances of a step: with the nodes found at first, and twice with others. What is left then the next step does. Models
/// with time have one: a second would be another step.
const MOST_PASSES: usize = 3;
/// Most pieces of a tool's way in a step.
const MOST_PIECES: f64 = 8.0;
/// Longest piece of a step of models with time \[s\]: nodes that are held are where they shall be at once, and the longer the
/// piece, the heavier is what they run into.
const LONGEST_PIECE_S: f64 = 5e-3;
/// Most steps that bring held tools to their places and tissue to rest, of models that go to balance.
const MOST_STEPS: usize = 1000;
/// Longest that models with time are given to come to rest \[s\].
const SETTLE_S: f64 = 20.0;
/// A node that is slower than this rests \[mean edges a second\]: in a fifth of a second, in which bodies follow a hand, it
/// goes a five-thousandth of an edge.
const STILL_EDGES_PER_S: f64 = 1e-3;
/// Time for which all nodes must be that slow \[s\]: not only where they turn back, and twice the time in which models let
/// their slowest motion die away.
const STILL_S: f64 = 0.1;
/// Longest time of one step of a model \[s\]: a console that was silent for longer has not moved all that time.
const LONGEST_STEP_S: f64 = 0.1;

/// From a state until its frame has been in use for a period, in periods.
const AHEAD_PERIODS: f64 = 2.0;
/// The same where the host stalls: for so long a touch to come is foretold.
const LATE_PERIODS: f64 = 6.0;
/// The middle of its use, as a part of that.
const USED: f64 = 0.75;
/// Least depth of a touch to come, in radii.
const LEAST_DEPTH: f64 = 0.05;
/// Beyond this relative error a model does not stand by its force: nobody gets it.
const MOST_FORCE_ERROR: f64 = 0.5;

/// Why a model does not take a scene.
#[derive(Debug, Error, Diagnostic)]
pub enum PrescribedError {
    /// It does not go with what the scene has.
    #[error("{model} tissue does not take this scene: {reason}")]
    #[diagnostic(help("{help}"))]
    Refused {
        /// The model.
        model: &'static str,
        /// Why.
        reason: String,
        /// What to do.
        help: &'static str,
    },
    /// Tools without a shape, or too many.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Scene(#[from] SceneError),
    /// Held tools could not be brought to their places.
    #[error("the tissue found no rest with the tools where the scene holds them: {}", .0.name())]
    #[diagnostic(help("move the tools' `position_m` less deep into the tissue"))]
    NoRest(Status),
    /// What acts on it without tools could not be brought to balance.
    #[error("the tissue found no rest under its weight and its loads: {}", .0.name())]
    #[diagnostic(help(
        "see that `youngs_modulus_pa` is in Pa and `density_kg_per_m3` in kg/m^3; make the tissue stiffer, or take `corotational` tissue, which says \
         how far it would sag"
    ))]
    NoBalance(Status),
}

/// A model with its tools.
pub(crate) struct Prescribed {
    model: Registered,
    tissue: Box<dyn Tissue>,
    /// Whether its steps have a length.
    has_time: bool,
    has_tangent: bool,
    surface: Surface,
    sticking: Sticking,
    shapes: Vec<(u8, Tool)>,
    /// The tool whose tangent is wanted.
    driven: Option<u8>,
    /// Relaxation of its force, if the tissue's stress relaxes.
    fading: Option<Fading>,
    tools: Tools,
    /// Rows of the drive whose nodes press, of the tool at hand.
    pressing: Vec<usize>,
    /// Nodes that it will meet.
    to_come: Vec<(u32, f64)>,
    force_n: Vec<[f64; 3]>,
    period_s: f64,
    /// Length of the pieces of the last step \[s\].
    piece_s: f64,
    /// When the last step was, by the console's clock.
    last_us: Option<u64>,
    /// Of the last tangent.
    tangent_error: f64,
    /// Of the last balance: elastic energy \[J\], force out of balance as a share, and the error of what holds the nodes.
    energy_j: f64,
    residual: f64,
    force_error: f64,
    /// Whether the driven tool held nodes in the last step, and whether what that gave means nothing.
    touched: bool,
    unfinished: bool,
    tally: Statistics,
}

/// What a session will say of its steps.
#[derive(Clone, Copy, Debug, Default)]
struct Statistics {
    most_nodes: u32,
    converged: u64,
    unfinished: u64,
    failed: u64,
    why_failed: Option<&'static str>,
    residual: f64,
    /// Steps in which the driven tool touched, how many of these gave no contact, and how many of those because of the force's
    /// error; its largest that was sent.
    contact_steps: u64,
    withheld: u64,
    unbelieved: u64,
    force_error: f64,
    tangents: u64,
    tangent_error: f64,
}

impl Prescribed {
    /// Builds a scene's tissue, brings held tools to their places, and lets all come to rest; what still moves after 20 s of
    /// its own time is left moving. Steps come `host_hz` times a second, and have a tangent if the console renders from that.
    ///
    /// # Errors
    /// [`PrescribedError::Refused`] for scenes with needles or handles, and for what the model itself refuses; tools that are too
    /// many, have no shape, or are held too deep.
    pub fn new(
        scene: &Scene,
        model: Registered,
        rendering: Rendering,
        host_hz: f64,
    ) -> Result<Self, PrescribedError> {
        let refuse = |reason: String, help| PrescribedError::Refused {
            model: model.name(),
            reason,
            help,
        };
        let entry = registry::entry(model.name());
        let entry = entry.ok_or_else(|| refuse("there is no such model".to_owned(), ""))?;
        refused(scene, &entry).map_or(Ok(()), |(reason, help)| Err(refuse(reason, help)))?;
        if rendering == Rendering::Rows {
            let reason = "rows need the compliance between the places that are touched, which it does not have";
            let help = "give `--rendering tangent` or `--rendering hold`, or `--tissue linear`";
            return Err(refuse(reason.to_owned(), help));
        }
        if let Some(tool) = scene.tools.iter().find(|tool| !tool.shape.is_smooth()) {
            let name = model.name();
            tracing::warn!(
                "tools stick to {name} tissue: the `friction` of tool {} changes nothing",
                tool.id
            );
        }
        let shapes: Vec<_> = scene
            .tools
            .iter()
            .map(|tool| (tool.id, tool.shape.clone()))
            .collect();
        check_tools(&shapes).map_err(|error| scene.placed(error))?;
        let tissue = model
            .build(&scene.body(), &scene.mesh)
            .map_err(|reason| refuse(reason, "change the scene, or take another `--tissue`"))?;
        let mut prescribed = Prescribed {
            model,
            tissue,
            has_time: entry.has_step,
            has_tangent: rendering == Rendering::Tangent,
            surface: scene.mesh.surface(),
            sticking: Sticking::new(&scene.mesh, &scene.fixed),
            shapes,
            driven: scene.driven().map(|tool| tool.id),
            fading: scene
                .relaxation
                .filter(|_| model.relaxes())
                .map(Fading::new),
            tools: [const { None }; MAX_TOOLS],
            pressing: Vec::with_capacity(scene.mesh.points_m().len()),
            to_come: Vec::with_capacity(scene.mesh.points_m().len()),
            force_n: scene.node_forces(),
            period_s: 1.0 / host_hz,
            piece_s: 1.0 / host_hz,
            last_us: None,
            tangent_error: 0.0,
            energy_j: 0.0,
            residual: 0.0,
            force_error: 0.0,
            touched: false,
            unfinished: false,
            tally: Statistics::default(),
        };
        prescribed.bring_in(scene)?;
        prescribed.tally = Statistics::default();
        Ok(prescribed)
    }

    /// Held tools come from outside, and what acts already acts until all rests; a scene without such tools may begin as the
    /// mesh has it.
    fn bring_in(&mut self, scene: &Scene) -> Result<(), PrescribedError> {
        let held: Vec<_> = scene.held().collect();
        if held.is_empty() && (self.force_n.is_empty() || !scene.settle) {
            return Ok(());
        }
        let no_rest = match held.is_empty() {
            true => PrescribedError::NoBalance,
            false => PrescribedError::NoRest,
        };
        let points = scene.mesh.points_m();
        let at = |from_outside: bool| -> Vec<ToolSample> {
            let samples = held.iter().map(|(tool, pose)| {
                let pose = if from_outside {
                    outside(&self.surface, points, &tool.shape, pose)
                } else {
                    *pose
                };
                at_rest(tool.id, &pose)
            });
            samples.collect()
        };
        let (from, to) = (at(true), at(false));
        let mut status = self.go(&from, self.period_s);
        let most_steps = if self.has_time {
            (SETTLE_S / self.period_s).ceil() as usize
        } else {
            MOST_STEPS
        };
        let mut last_m = points.to_vec();
        let mut still_s = 0.0;
        for _ in 0..most_steps {
            let before = self.tally.converged;
            last_m.copy_from_slice(self.tissue.positions_m());
            status = self.go(&to, self.period_s);
            let rests = match status {
                Status::Ok if self.has_time => {
                    still_s = if self.is_still(&last_m) {
                        still_s + self.period_s
                    } else {
                        0.0
                    };
                    still_s >= STILL_S
                }
                Status::Ok => self.tally.converged > before,
                Status::Behind => false,
                _ => return Err(no_rest(status)),
            };
            if rests {
                return Ok(());
            }
        }
        // Models that never are in balance rest after as many steps.
        match status {
            Status::Ok => Ok(()),
            _ => Err(no_rest(status)),
        }
    }

    /// Steps come so often from now on, and have a tangent if the console renders from that.
    pub fn tune(&mut self, rendering: Rendering, host_hz: f64) {
        self.period_s = 1.0 / host_hz;
        self.has_tangent = rendering == Rendering::Tangent;
    }

    /// Whether no node is faster than [`STILL_EDGES_PER_S`], given where all were a step ago \[m\], (n x 3).
    fn is_still(&self, last_m: &[[f64; 3]]) -> bool {
        let least_m = STILL_EDGES_PER_S * self.surface.mean_edge_m * self.period_s;
        let mut nodes = self.tissue.positions_m().iter().zip(last_m);
        nodes.all(|(now, last)| (Vector3::from(*now) - Vector3::from(*last)).norm() <= least_m)
    }

    /// Where every node is \[m\], (n x 3).
    pub fn positions_m(&self) -> &[[f64; 3]] {
        self.tissue.positions_m()
    }

    /// Where the last step has a tool that was sampled at `sample`.
    pub fn reached(&self, sample: &ToolSample) -> ToolSample {
        let index = self.shapes.iter().position(|(id, _)| *id == sample.id);
        let found =
            index.and_then(|index| Some((&self.shapes[index].1, self.tools[index].as_ref()?)));
        found.map_or(*sample, |(tool, (placement, _))| {
            tool.sample_at(placement, sample)
        })
    }

    /// Follows the tools to `samples`. Where there is a balance there is a contact for each.
    pub fn follow(&mut self, samples: &[ToolSample]) -> StepReport {
        let now_us = samples.first().map(|sample| sample.console_time_us);
        let passed_us = now_us.zip(self.last_us);
        let step_s = match passed_us.map_or(0, |(now, last)| now.saturating_sub(last)) {
            0 => self.period_s,
            us => (1e-6 * us as f64).min(LONGEST_STEP_S),
        };
        self.last_us = now_us.or(self.last_us);
        let mut report = StepReport::default();
        let mut clock = Clock::start();
        let mut status = self.go(samples, step_s);
        self.touched = self.is_touching(status);
        self.unfinished = status.has_balance() && self.touched && !self.stands_by_its_force();
        if self.unfinished {
            // Tissue goes on from where it is, towards balance.
            status = Status::NotConverged;
        }
        self.tally.contact_steps += u64::from(self.touched);
        self.tally.withheld += u64::from(self.touched && !status.has_balance());
        self.tally.unbelieved += u64::from(self.unfinished);
        self.tally.force_error = match status {
            Status::Ok | Status::Behind if self.touched => {
                self.tally.force_error.max(self.force_error)
            }
            _ => self.tally.force_error,
        };
        clock.lap(&mut report.stages.tissue_ns);
        report.status = status;
        report.imbalance = self.residual;
        report.stored_energy_j = self.energy_j;
        match status {
            Status::Ok => self.reduce(samples, &mut report),
            Status::Behind => {
                if let Some(first) = samples.first() {
                    let mut reached = [*first; MAX_TOOLS];
                    for (reached, sample) in reached.iter_mut().zip(samples) {
                        *reached = self.reached(sample);
                    }
                    self.reduce(&reached[..samples.len().min(MAX_TOOLS)], &mut report);
                }
            }
            _ => {}
        }
        self.fade(&mut report, step_s);
        clock.lap(&mut report.stages.reduce_ns);
        report
    }

    /// Says how fast the driven tool's force fades. A step without a contact begins anew.
    fn fade(&mut self, report: &mut StepReport, step_s: f64) {
        let Some(fading) = &mut self.fading else {
            return;
        };
        let count = report.contacts().len();
        let driven = self.driven;
        let mut contacts = report.contacts_mut(count).iter_mut();
        match contacts.find(|contact| Some(contact.id) == driven) {
            Some(contact) => {
                let [x, y, z, ..] = contact.wrench;
                contact.relaxation_per_s = fading.rate_per_s(&Vector3::new(x, y, z), step_s);
            }
            None => {
                fading.rate_per_s(&Vector3::zeros(), step_s);
            }
        }
    }

    /// Whether the driven tool was in contact in the last step, also where the result is withheld.
    pub fn touched(&self) -> bool {
        self.touched
    }

    /// Whether the last step is withheld because its force means nothing.
    pub fn is_unfinished(&self) -> bool {
        self.unfinished
    }

    /// Moves the tools there, in pieces that are short against their shapes.
    fn go(&mut self, samples: &[ToolSample], step_s: f64) -> Status {
        let mut way = [None; MAX_TOOLS];
        let mut pieces = 1.0_f64;
        for sample in samples {
            let Some(index) = self.shapes.iter().position(|(id, _)| *id == sample.id) else {
                return Status::UnknownTool;
            };
            let shape = &self.shapes[index].1;
            if shape.shape == Shape::Grip {
                continue;
            }
            let Some(target) = shape.place(sample) else {
                return Status::NotFinite;
            };
            if self.tools[index].is_none() && !self.appears(index, &target) {
                return Status::Inside;
            }
            let Some((from, solid)) = &self.tools[index] else {
                continue;
            };
            let length =
                (target.centre - from.centre).norm() + from.angle_to(&target) * solid.reach();
            pieces = pieces.max((length / solid.piece()).ceil());
            way[index] = Some((*from, target));
        }
        let timed = if self.has_time {
            (step_s / LONGEST_PIECE_S - 1e-9).ceil().max(1.0)
        } else {
            1.0
        };
        let pieces = pieces.max(timed);
        let count = pieces.min(MOST_PIECES.max(timed));
        self.piece_s = step_s / count;
        for piece in 1..=count as u32 {
            let before = self.tools.clone();
            for (index, way) in way.iter().enumerate() {
                if let Some((from, target)) = way {
                    let there = from.towards(target, f64::from(piece) / pieces);
                    self.tools[index] = Some((there, self.solid(index, &there)));
                }
            }
            self.sticking.keep();
            if !self.balance(&before, self.piece_s) {
                self.tools = before;
                self.sticking.go_back();
                return Status::NotConverged;
            }
        }
        if pieces > count {
            return Status::Behind;
        }
        self.all_outside()
    }

    /// Whether the driven tool was in contact in a step that ended like this.
    fn is_touching(&mut self, status: Status) -> bool {
        let driven = |(id, _): &(u8, Tool)| Some(*id) == self.driven;
        let Some(index) = self.shapes.iter().position(driven) else {
            return false;
        };
        match status {
            Status::Ok | Status::Behind if self.meets_wall(index) => true,
            Status::Ok | Status::Behind => {
                self.sticking.pressing(index, &mut self.pressing);
                // What was let go by a force that means nothing may well be there.
                !self.pressing.is_empty()
                    || (!self.stands_by_its_force() && self.sticking.held(index))
            }
            // What the step began to hold is no longer there.
            Status::NotConverged => self.sticking.held(index),
            // It was inside, or another tool is.
            Status::Inside => self.tools[index].is_none() || self.sticking.held(index),
            _ => false,
        }
    }

    /// Whether a tool presses on fixed nodes.
    fn meets_wall(&self, index: usize) -> bool {
        let nowhere = Vector3::zeros();
        let placed = self.tools[index].as_ref();
        placed.is_some_and(|(_, solid)| self.sticking.wall(solid, &nowhere).nodes > 0)
    }

    /// Whether the last balance came near enough for its reactions to mean anything.
    fn stands_by_its_force(&self) -> bool {
        self.force_error <= MOST_FORCE_ERROR
    }

    fn solid(&self, index: usize, placement: &Placement) -> Solid {
        Solid::new(&self.shapes[index].1, self.surface.mean_edge_m, placement)
    }

    /// A tool that was nowhere begins its way there, free of the tissue; whether there is such a way.
    fn appears(&mut self, index: usize, placement: &Placement) -> bool {
        let positions = self.tissue.positions_m();
        let near = |solid: &Solid| {
            let (gap_m, _, node) = self.sticking.apart(solid, positions)?;
            let vertex = self.surface.vertices.binary_search(&node).ok()?;
            Some(Nearest {
                at: positions[node as usize].into(),
                normal: self.surface.normals[vertex].into(),
                gap_m,
            })
        };
        let is_inside = |point: &Vector3<f64>| self.surface.contains(positions, (*point).into());
        let Some(out) = way_in(&self.solid(index, placement), near, is_inside) else {
            return false;
        };
        let from = Placement {
            centre: placement.centre + out,
            ..*placement
        };
        self.tools[index] = Some((from, self.solid(index, &from)));
        true
    }

    /// Finds what the tools, which came from `before`, hold, and has the model follow. Says whether it did.
    fn balance(&mut self, before: &Tools, step_s: f64) -> bool {
        let positions_m = self.tissue.positions_m();
        self.sticking.take(before, &self.tools, positions_m);
        let passes = if self.has_time { 1 } else { MOST_PASSES };
        for pass in 1..=passes {
            self.sticking.lay_out(&self.tools);
            let drive = self.sticking.drive(&self.force_n);
            let done = self.tissue.step(&drive, step_s);
            match done.outcome {
                Outcome::Converged => self.tally.converged += 1,
                Outcome::Unfinished => self.tally.unfinished += 1,
                Outcome::Failed(why) => {
                    self.tally.failed += 1;
                    self.tally.why_failed = Some(why);
                    return false;
                }
            }
            self.energy_j = done.energy_j;
            self.residual = done.residual;
            self.force_error = done.force_error;
            // Also by a force that nobody stands by: tissue that jams must not hang from a tool that leaves.
            let gone = self.sticking.let_go(&self.tools, self.tissue.reactions_n());
            // What the last pass would take, the next step takes.
            if pass == passes || gone + self.take_risen() == 0 {
                break;
            }
        }
        self.tally.residual = self.tally.residual.max(self.residual);
        true
    }

    /// Tissue that balance has brought into tools, which do not move for that. Says how many nodes.
    fn take_risen(&mut self) -> usize {
        let (tools, positions_m) = (&self.tools, self.tissue.positions_m());
        self.sticking.take(tools, tools, positions_m)
    }

    /// Force of the nodes at hand on a tool, along the outward normals that they have at rest \[N\].
    fn outward_n(&self) -> f64 {
        let rows = self.pressing.iter().filter_map(|row| {
            let vertex = self
                .surface
                .vertices
                .binary_search(&self.sticking.node(*row)?);
            let out = Vector3::from(*self.surface.normals.get(vertex.ok()?)?);
            let reaction = Vector3::from(*self.tissue.reactions_n().get(*row)?);
            Some(-reaction.dot(&out))
        });
        rows.sum()
    }

    /// A tool that holds nothing, or that tissue pulls, must be outside; one that has slipped in is forgotten.
    fn all_outside(&mut self) -> Status {
        for index in 0..MAX_TOOLS {
            let Some((_, solid)) = &self.tools[index] else {
                continue;
            };
            self.sticking.pressing(index, &mut self.pressing);
            // Nodes that stick pull at a tool that is drawn back, too: that one is outside.
            let is_pulled_in = self.stands_by_its_force() && self.outward_n() < 0.0;
            if !(self.pressing.is_empty() || is_pulled_in) {
                continue;
            }
            let positions = self.tissue.positions_m();
            let Some((_, _, node)) = self.sticking.apart(solid, positions) else {
                continue;
            };
            let middle = solid.middle();
            // The cheap suspicion first, then the proof.
            let vertex = self.surface.vertices.binary_search(&node);
            let behind = vertex.is_ok_and(|vertex| {
                let normal = Vector3::from(self.surface.normals[vertex]);
                (middle - Vector3::from(positions[node as usize])).dot(&normal) < 0.0
            });
            if behind && self.surface.contains(positions, middle.into()) {
                self.tools[index] = None;
                return Status::Inside;
            }
        }
        Status::Ok
    }

    /// What each tool feels.
    fn reduce(&mut self, samples: &[ToolSample], report: &mut StepReport) {
        self.tangent_error = 0.0;
        let contacts = report.contacts_mut(samples.len());
        for (sample, place) in samples.iter().zip(contacts) {
            let mut contact = ToolContact::nowhere(sample.id);
            let index = self.shapes.iter().position(|(id, _)| *id == sample.id);
            let solid =
                index.and_then(|index| Some((index, self.tools[index].as_ref()?.1.clone())));
            if let Some((index, solid)) = solid {
                self.sticking.pressing(index, &mut self.pressing);
                let step_s = (self.driven == Some(sample.id)).then_some(self.piece_s);
                self.feel(&mut contact, sample, &solid, step_s);
            }
            *place = contact;
        }
        let walls = self.tools.iter().flatten();
        let walls = walls.map(|(_, solid)| self.sticking.wall(solid, &Vector3::zeros()).energy_j);
        report.stored_energy_j += walls.sum::<f64>();
        report.rows = report.contacts().iter().map(|contact| contact.rows).sum();
        report.tangent_error = self.tangent_error;
    }

    /// Contact of the tool whose rows are at hand, with the tangent of a piece of that length if one is wanted.
    fn feel(
        &mut self,
        contact: &mut ToolContact,
        sample: &ToolSample,
        solid: &Solid,
        step_s: Option<f64>,
    ) {
        let grip = Vector3::from(sample.position_m);
        let wall = self.sticking.wall(solid, &grip);
        if self.pressing.is_empty() && wall.nodes == 0 {
            if let Some((gap, normal, _)) = self.sticking.apart(solid, self.tissue.positions_m()) {
                contact.gap_m = gap.max(0.0);
                contact.normal = normal.into();
                if let Some(step_s) = step_s.filter(|_| self.has_tangent) {
                    self.foretell(contact, sample, (solid, &normal), step_s);
                }
            }
            return;
        }
        let touched = self
            .sticking
            .touched(&self.pressing, self.tissue.reactions_n(), &grip);
        let wrench = wall.wrench + stacked(&touched.force, &touched.moment);
        let force: Vector3<f64> = wrench.fixed_rows::<3>(0).into();
        contact.gap_m = 0.0;
        contact.rows = touched.nodes + wall.nodes;
        contact.normal = force.try_normalize(0.0).unwrap_or_else(Vector3::z).into();
        contact.wrench = wrench.into();
        let Some(step_s) = step_s else {
            return;
        };
        let tally = &mut self.tally;
        tally.most_nodes = tally.most_nodes.max(touched.nodes);
        if !self.has_tangent {
            return;
        }
        wall.add_tangent(&mut contact.tangent);
        if self.pressing.is_empty() {
            return;
        }
        let drive = self.sticking.drive(&self.force_n);
        if let Some(tangent) = self.tissue.tangent(&drive, &self.pressing, step_s) {
            tally.tangents += 1;
            tally.tangent_error = tally.tangent_error.max(tangent.error);
            self.tangent_error = tangent.error;
            // What is less sure of its force is less sure of how that changes.
            let confidence = (1.0 - self.force_error).max(0.0);
            contact.tangent = touched
                .tangent(&tangent)
                .map(|row| row.map(|entry| confidence * entry));
            wall.add_tangent(&mut contact.tangent);
        }
    }

    /// The tangent of the touch to come, if the tool may be there before the next but one frame: of all that it would meet
    /// by then.
    fn foretell(
        &mut self,
        contact: &mut ToolContact,
        sample: &ToolSample,
        (solid, normal): (&Solid, &Vector3<f64>),
        step_s: f64,
    ) {
        let ahead_s = AHEAD_PERIODS * self.period_s;
        let closing = -Vector3::from(sample.velocity_m_per_s).dot(normal);
        let way_m = closing.max(0.0) * ahead_s;
        let longest_s = LATE_PERIODS * self.period_s;
        if contact.gap_m >= closing.max(0.0) * longest_s + reach_m(longest_s) {
            return;
        }
        // In the middle of its use; as a hand that sets out meets it, at least.
        let depth_m = way_m * USED - contact.gap_m;
        let depth_m = depth_m.clamp(LEAST_DEPTH * solid.radius(), solid.radius());
        let positions = self.tissue.positions_m();
        let way = (contact.gap_m, depth_m);
        self.sticking
            .to_come(solid, positions, way, &mut self.to_come);
        let drive = self.sticking.drive(&self.force_n);
        let to_come = self.tissue.tangent_to_come(&drive, &self.to_come, step_s);
        let grip = Vector3::from(sample.position_m);
        if let Some(tangent) = to_come {
            let at = solid.middle() - normal * solid.radius() - grip;
            contact.tangent = Touched::to_come(&at).tangent(&tangent);
        }
        let there = solid.moved(&(normal * -(contact.gap_m + depth_m)));
        let wall = self.sticking.wall(&there, &grip);
        wall.add_tangent(&mut contact.tangent);
    }

    /// How the steps went, for the session's summary.
    pub fn said(&self) -> Value {
        let tally = &self.tally;
        let tangent = self.has_tangent && tally.tangents > 0;
        json!({
            "setting": self.model.setting(),
            "contact": "sticking",
            "contact_nodes": tally.most_nodes,
            "residual": tally.residual,
            "contact_steps": tally.contact_steps,
            "contact_steps_withheld": tally.withheld,
            "contact_steps_unfinished": tally.unbelieved,
            "force_error": tally.force_error,
            "outcomes": {
                "converged": tally.converged,
                "unfinished": tally.unfinished,
                "failed": tally.failed,
            },
            "why_failed": tally.why_failed,
            "tangent_error": tangent.then_some(tally.tangent_error),
        })
    }

    /// Of where every node is, what sticks to which tool and where, and where the tools are, to the bit. What else a model
    /// keeps from step to step, such as velocities, is not in it: two runs that differ there differ in positions later.
    pub fn hash(&self) -> u64 {
        let tools = self.tools.each_ref().map(|tool| Some(tool.as_ref()?.0));
        hash_of(&(self.tissue.positions_m(), self.sticking.state(), tools))
    }
}

/// Why a model does not take a scene, and what to do, if so.
fn refused(scene: &Scene, entry: &registry::Entry) -> Option<(String, &'static str)> {
    if !scene.needles.is_empty() {
        let why = entry
            .refuses_needles
            .unwrap_or("its cells have nodes that the mesh does not have: needles go with linear or averaged cells");
        let help = "give `--tissue linear`, `--tissue corotational` or `--tissue hyperelastic`, or change `model` in \
                    `[tissue]`";
        return Some((format!("it has needles, and {why}"), help));
    }
    if !scene.jaws.is_empty() {
        let help =
            "leave `[[jaws]]` out, or take `linear`, `corotational` or `hyperelastic` tissue";
        let reason = "it has jaws, whose friction only tissue with rows takes".to_owned();
        return Some((reason, help));
    }
    if let Some(part) = scene.bars().next() {
        let help = "leave `body` out, or take `linear`, `corotational` or `hyperelastic` tissue";
        let reason = format!(
            "tool {} has a body, which only tissue with rows takes",
            part.tool
        );
        return Some((reason, help));
    }
    if !scene.touching.is_empty() && scene.needles.is_empty() {
        let help = "leave `[[tissue_contact]]` out, or take `linear`, `corotational` or `hyperelastic` tissue";
        return Some((
            "it has tissues that touch, which only tissue with rows takes".to_owned(),
            help,
        ));
    }
    if let Some(added) = scene.added.first() {
        let (name, _) = added.explain();
        let help = "leave it out, or take `linear`, `corotational` or `hyperelastic` tissue";
        let reason = format!("it has {name}, which only tissue with rows takes");
        return Some((reason, help));
    }
    if !scene.loads.handles.is_empty() {
        let help = "leave the handles out, or take `linear` tissue";
        return Some((
            "it has handles, which only linear and corotational tissue take".to_owned(),
            help,
        ));
    }
    None
}
