//! Tips on the tissue's surface: they stick within the cone of friction, and slip along it beyond.
//!
//! Entry points: [`Balance::let_slip`] after a solve, [`Balance::follow_surface`] once a balance is found. A tip that comes
//! from outside is held by three rows until the force on the tissue leaves Coulomb's cone about the surface's normal; from
//! then on it has the rows of a cone, which keep it where it lay at the last balance. What slips lies from then on where it
//! has come to: plastic flow, integrated backwards (Simo & Hughes 1998, 1.4), along a surface that stays while it is solved
//! for. Its normal is the mean of those at the face's vertices (Puso & Laursen 2004): faces meet in edges, tissue does not.

use super::Crossing;
use super::source::{Point, What, anchor};
use super::state::Tip;
use crate::collide::{across, closest};
use crate::mesh::HalfFace;
use crate::rows::{Mode, RowKind};
use crate::step::{Balance, BalanceWork};
use nalgebra::Vector3;
use serde::Serialize;

/// What slips is within rounding of the cone's rim, and not beyond, by this part of its radius.
const RIM: f64 = 1e-9;
/// Times that a place on the surface is looked for among the faces around the last one: slips are shorter than two edges.
const LOOKS: u32 = 4;

/// How a needle lies on a surface.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct Lie {
    /// Out of the tissue, unit vector, (3), and one across it, (3).
    pub normal: Vector3<f64>,
    pub tangent: Vector3<f64>,
    /// Way to the tissue's point from where the needle was when it came to lie here \[m\], (3): faces are not across the
    /// normal.
    pub off_m: Vector3<f64>,
    /// By how far it had slipped in this balance when it came to lie here, across the normal \[m\], (3).
    pub slid_m: Vector3<f64>,
}

impl Lie {
    pub fn new(normal: Vector3<f64>, along: &Vector3<f64>) -> Self {
        Self {
            tangent: across(&normal, along),
            normal,
            off_m: Vector3::zeros(),
            slid_m: Vector3::zeros(),
        }
    }

    /// Directions of its rows: out of the tissue, and two across.
    pub fn frame(&self) -> [Vector3<f64>; 3] {
        [self.normal, self.tangent, self.normal.cross(&self.tangent)]
    }
}

/// Rows of a cone.
pub(crate) fn cone(friction: f64) -> [RowKind; 3] {
    [
        RowKind::Normal { friction },
        RowKind::Tangent,
        RowKind::Tangent,
    ]
}

/// Coulomb's coefficient of a point whose rows are a cone; nothing for others.
pub(crate) fn friction_of(work: &BalanceWork, point: &Point) -> Option<f64> {
    match work.set.rows.get(point.first_row)?.kind {
        RowKind::Normal { friction } => Some(friction),
        _ => None,
    }
}

/// The force of a tip on the face that it holds, as the last solve has it \[N\].
pub(super) struct TipLoad {
    /// What breaks through once it is above the threshold, and lets go below zero.
    pub load_n: f64,
    /// Along the needle.
    pub axial_n: f64,
}

impl Balance<'_> {
    /// Place of a needle's point among the present ones.
    pub(super) fn point_of(&self, needle: usize, what: What) -> Option<usize> {
        let mut points = self.work.needles.points.iter();
        points.position(|point| point.needle == needle && point.what == what)
    }

    /// Outward normal where a crossing lies on the boundary, unit vector; `None` off it, or where that has collapsed.
    pub(super) fn surface_normal(&self, at: &Crossing) -> Option<Vector3<f64>> {
        let nodes = self.sources.mesh.vertices(at.face);
        let parts = nodes.iter().zip(at.weights);
        let mixed = parts.map(|(node, weight)| self.node_normal(*node) * weight);
        mixed.sum::<Vector3<f64>>().try_normalize(1e-6)
    }

    /// Mean normal of the faces around a vertex of the boundary, by their areas; zero for others.
    pub(crate) fn node_normal(&self, node: u32) -> Vector3<f64> {
        let boundary = self.sources.mesh.boundary();
        let areas = boundary
            .leaving(node)
            .map(|side| self.area(side.triangle()));
        let area: Vector3<f64> = areas.sum();
        area.try_normalize(0.0).unwrap_or_default()
    }

    /// Outward normal of a triangle of the boundary, as long as its area is twice \[m^2\].
    pub(crate) fn area(&self, triangle: usize) -> Vector3<f64> {
        let corners = self.sources.mesh.boundary().triangles().get(triangle);
        corners.map_or_else(Vector3::zeros, |corners| {
            let [a, b, c] = corners.map(|node| self.position(node));
            (b - a).cross(&(c - a))
        })
    }

    /// The place on the boundary nearest to a point, among the faces around `from` and those around what is found there.
    fn nearest_on_surface(&self, from: &Crossing, to: &Vector3<f64>) -> Crossing {
        let (mesh, mut best) = (&self.sources.mesh, *from);
        let distance = |face: HalfFace| {
            let corners = mesh.vertices(face).map(|node| self.position(node) - to);
            let found = closest(&corners);
            (found.point.norm_squared(), found.weights)
        };
        let mut least = f64::INFINITY;
        for _ in 0..LOOKS {
            let middle = best.face;
            let around = mesh.vertices(middle).into_iter();
            let around = around.flat_map(|node| mesh.boundary().leaving(node));
            let around = around.filter_map(|side| {
                let faces = mesh.boundary().half_faces();
                faces.get(side.triangle()).copied()
            });
            for face in std::iter::once(middle).chain(around) {
                let (square, weights) = distance(face);
                if square < least {
                    (least, best) = (
                        square,
                        Crossing {
                            face,
                            weights,
                            ..best
                        },
                    );
                }
            }
            if best.face == middle {
                break;
            }
        }
        best
    }

    /// Coulomb's coefficient of a tip on a face; `None` where it never slips: its own cut holds one that comes from inside.
    fn tip_friction(&self, face: &Crossing) -> Option<f64> {
        let friction = self.sources.tissue(face.face.cell()).surface_friction;
        (face.enters && friction.is_finite()).then_some(friction)
    }

    /// The force of a needle's tip on the face that it holds; `None` before its first solve.
    pub(super) fn tip_load(&self, needle: usize) -> Option<TipLoad> {
        let Tip::Holding { face, rubs, .. } = self.state.each[needle].tip else {
            return None;
        };
        let index = self.point_of(needle, What::Holding)?;
        let first = self.state.grasp.lambda()[self.work.needles.points[index].first_row];
        let force = self.state.grasp.force_on(index);
        if rubs.is_some() {
            let curve = self.curve(needle);
            return Some(TipLoad {
                load_n: first,
                axial_n: force.dot(&curve.tangent_at(curve.length)),
            });
        }
        let across = || Some(-force.dot(&self.surface_normal(&face)?));
        let normal = self.tip_friction(&face).and_then(|_| across());
        Some(TipLoad {
            load_n: normal.unwrap_or(-first),
            axial_n: -first,
        })
    }

    /// Has tips whose force is outside of the cone slip; whether there are none.
    pub(super) fn let_slip(&mut self) -> bool {
        let mut none = true;
        for needle in 0..self.state.each.len() {
            let Tip::Holding {
                face,
                id,
                rubs: None,
            } = self.state.each[needle].tip
            else {
                continue;
            };
            let (Some(friction), Some(index)) = (
                self.tip_friction(&face),
                self.point_of(needle, What::Holding),
            ) else {
                continue;
            };
            let first = self.work.needles.points[index].first_row;
            let n = self.work.count();
            let w = self.work.system.compliance(n);
            let gives = (first..first + 3).all(|row| w[row * (n + 1)] > 0.0);
            let Some(normal) = self.surface_normal(&face).filter(|_| gives) else {
                continue;
            };
            let force = self.state.grasp.force_on(index);
            let pressing = -force.dot(&normal);
            let flat = (force + normal * pressing).norm();
            // What pulls is let go of.
            if pressing > 0.0 && flat > friction * pressing * (1.0 + RIM) {
                let lie = Lie::new(normal, &self.curve(needle).inward);
                let rubs = Some(lie);
                self.state.each[needle].tip = Tip::Holding { face, id, rubs };
                none = false;
            }
        }
        none
    }

    /// Tips that have slipped lie where they are now.
    pub(super) fn follow_surface(&mut self) {
        for needle in 0..self.state.each.len() {
            let Tip::Holding {
                face,
                id,
                rubs: Some(lie),
            } = self.state.each[needle].tip
            else {
                continue;
            };
            let Some(index) = self.point_of(needle, What::Holding) else {
                continue;
            };
            let first = self.work.needles.points[index].first_row;
            let slips = self.state.grasp.modes()[first + 1] == Mode::Slipping;
            let curve = self.curve(needle);
            let tip = curve.at(curve.length);
            let (mut face, mut off_m) = (face, Vector3::zeros());
            if slips {
                face = self.nearest_on_surface(&face, &tip);
                off_m = self.position_of(&anchor(&self.sources.mesh, &face)) - tip;
            }
            let normal = self.surface_normal(&face).unwrap_or(lie.normal);
            let rubs = Some(Lie {
                off_m,
                ..Lie::new(normal, &lie.tangent)
            });
            let state = &mut self.state.each[needle];
            state.tip = Tip::Holding { face, id, rubs };
            if slips {
                // What it has gone along lies outside: through the tissue it goes from here.
                state.begin_log(state.pose);
            }
        }
    }

    /// How far a point whose rows are a cone, from `first_row` on, has slipped in this balance \[m\], (3).
    pub(crate) fn slipped(&self, first_row: usize) -> Vector3<f64> {
        let delta = self.state.grasp.delta_m();
        let rows = (1..3).map(|axis| first_row + axis);
        rows.map(|row| Vector3::from(self.work.set.rows[row].direction) * delta[row])
            .sum()
    }
}
