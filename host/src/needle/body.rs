//! Bodies of needles: the shaft outside of the tissue against its surface.
//!
//! Entry points: [`Balance::touch_bodies`] after a solve, [`Balance::follow_bodies`] once a balance is found. The shaft is a
//! ball swept along the needle's curve. What can come to touch it is an edge of the boundary that crosses it, a vertex that
//! stands out, and a face under one of its ends or where its curve bulges. Each is a point of the tissue with the rows of a
//! cone: the first keeps it outside, by the distance of the edge's line from the curve's tangent, which does not turn with the
//! thickness of the needle. Where a row lies and which way it looks stays while it is solved for, unless what presses has come to
//! overlap, and follows once a balance is found; what slips is plastic flow, integrated backwards (Simo & Hughes 1998, 1.4).
//!
//! The tissue around a hole is held by the rows of the hole: no part of the shaft touches that is nearer than a mean edge to
//! where it goes in or out, along the needle, or to its tip, which is sharp.

use super::hierarchy::{Capsule, Slack};
use super::model::NeedlePart;
use super::source::What;
use super::state::{NeedleState, Tip};
use super::surface::Lie;
use super::{Curve, MOST_GROUPS};
use crate::anchors::AnchorPoint;
use crate::mesh::{HalfFace, Side};
use crate::step::{Balance, Status};
use nalgebra::{Matrix3, Vector3};
use serde::Serialize;

/// Most places that a body touches at once.
pub(crate) const MOST_TOUCHES: usize = 64;
/// Of a circle this much is taken as one straight piece when boxes are asked \[rad\].
const PIECE: f64 = 0.16;
/// A body's overlap at a balance at most, and where it is found to touch anew, in mean edges.
const OVERLAP: [f64; 2] = [5e-4, 1e-4];
/// Solves of a balance after which distances are taken as they are.
const CORRECTED: u32 = 16;
/// Places within so many radii of a body may come to touch in a piece of its way, of so many radii.
const NEAR: f64 = 0.5;
pub(super) const PIECE_RADII: f64 = 0.25;
/// Larger coefficients of friction are as this one: it slips at 6 degrees from the surface.
const MOST_FRICTION: f64 = 10.0;
/// Least part of an edge across the needle that it crosses.
const ACROSS: f64 = 1e-3;
/// A vertex stands out when no neighbour lies higher by this part of the way there.
const STANDS_OUT: f64 = 0.02;
/// Least cosine between the direction in which something is touched and the surface's normal.
const FACING: f64 = 0.3;
/// Steps in which the place on a circle nearest to an edge is looked for.
const LOOKS: u32 = 8;

/// What of the surface is touched.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) enum Feature {
    /// By its vertices, the lower one first.
    Edge([u32; 2]),
    Vertex(u32),
    Face(HalfFace, Part),
}

/// Which part of a body is over a face.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub(crate) enum Part {
    End,
    Front,
    Bulge,
}

/// A place where a body touches the surface, or may come to.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct Touch {
    /// Names its rows.
    pub id: u32,
    pub feature: Feature,
    pub at: AnchorPoint,
    /// On the needle \[m\].
    pub alpha: f64,
    pub lie: Lie,
    pub friction: f64,
    /// Of the tissue's point from the curve, along the normal, when it touches \[m\].
    pub apart_m: f64,
    /// Force on the tissue at the last balance \[N\].
    pub force: Vector3<f64>,
}

/// A feature as a body sees it.
struct Found {
    at: AnchorPoint,
    alpha: f64,
    normal: Vector3<f64>,
    /// From the body's surface \[m\]; negative inside.
    gap_m: f64,
    /// Whether the feature and the body end beyond this place.
    is_within: bool,
    /// Of a cell at it.
    cell: u32,
}

/// A needle's body where it is.
struct Shaft<'a> {
    curve: Curve,
    radius_m: f64,
    /// Where it ends before the tip \[m\].
    front_m: f64,
    /// How far from a hole it begins \[m\].
    margin_m: f64,
    state: &'a NeedleState,
}

impl<'a> Shaft<'a> {
    fn new(part: &NeedlePart, state: &'a NeedleState, edge_m: f64) -> Self {
        let curve = part.needle.at(&state.pose);
        let radius_m = 0.5 * part.needle.thickness_m;
        let margin_m = edge_m.max(4.0 * radius_m);
        Self {
            front_m: curve.length - margin_m,
            curve,
            radius_m,
            margin_m,
            state,
        }
    }

    /// Whether the needle is outside of the tissue at a place, and not near where it goes in or out.
    fn is_free(&self, holes: impl Iterator<Item = f64>, alpha: f64) -> bool {
        let mut inside = self.state.history.before().is_some();
        for hole in holes {
            if (hole - alpha).abs() < self.margin_m {
                return false;
            }
            inside ^= hole < alpha;
        }
        !inside && (0.0..=self.front_m).contains(&alpha)
    }
}

impl Balance<'_> {
    fn shaft(&self, needle: usize) -> Option<Shaft<'_>> {
        let part = &self.sources.needles[needle];
        let state = &self.state.each[needle];
        let shaft = Shaft::new(part, state, self.sources.edge_m());
        let touches = part.body && state.tip != Tip::Waiting && shaft.front_m > 0.0;
        touches.then_some(shaft)
    }

    /// Whether a body may touch at a place of its needle.
    fn is_free(&self, shaft: &Shaft, alpha: f64) -> bool {
        let mesh = &self.sources.mesh;
        let crossings = shaft.state.history.crossings().iter();
        let holes = crossings.filter(|crossing| crossing.enters || crossing.leaves(mesh));
        shaft.is_free(holes.map(|hole| hole.alpha), alpha)
    }

    /// Lists the faces of the boundary that are nearer to a body than `reach_m`.
    fn near_body(&self, shaft: &Shaft, reach_m: f64, out: &mut Vec<HalfFace>) {
        out.clear();
        let mut slack = [0.0; MOST_GROUPS];
        let slack = Slack::ByGroup(self.slack(&mut slack));
        let bend = shaft.curve.curvature;
        let pieces = (shaft.front_m * bend / PIECE).ceil().max(1.0);
        let piece_m = shaft.front_m / pieces;
        let reach_m = reach_m + shaft.radius_m + piece_m * piece_m * bend / 8.0;
        for place in 0..pieces as u32 {
            let [a, b] = [0.0, 1.0].map(|end| shaft.curve.at((f64::from(place) + end) * piece_m));
            let capsule = Capsule::new(&a, &b);
            self.sources.hierarchy.near(
                |bounds, group| capsule.meets(bounds, reach_m + slack.of(group)),
                |face| out.push(face),
            );
            out.sort_unstable();
            out.dedup();
        }
    }

    /// A side of the boundary by its vertices.
    fn side(&self, [a, b]: [u32; 2]) -> Option<Side> {
        let boundary = self.sources.mesh.boundary();
        let mut leaving = boundary.leaving(a);
        leaving.find(|side| boundary.side_vertices(*side)[1] == b)
    }

    /// An edge against the tangent of the needle where that is nearest to it.
    fn find_edge(&self, shaft: &Shaft, nodes: [u32; 2]) -> Option<Found> {
        let boundary = self.sources.mesh.boundary();
        let side = self.side(nodes)?;
        let [from, to] = nodes.map(|node| self.position(node));
        let edge = to - from;
        let square = edge.norm_squared();
        let middle = (from + to) * 0.5;
        let mut alpha = shaft.curve.project(&middle, 0.5 * shaft.front_m);
        let mut part = 0.5;
        for _ in 0..LOOKS {
            let (along, at) = (shaft.curve.tangent_at(alpha), shaft.curve.at(alpha));
            let (slant, apart) = (along.dot(&edge), at - from);
            let across = square - slant * slant;
            if across <= ACROSS * square {
                return None;
            }
            part = (apart.dot(&edge) - slant * apart.dot(&along)) / across;
            let ahead = part * slant - apart.dot(&along);
            alpha += ahead;
            if ahead.abs() <= 1e-14 * shaft.curve.length {
                break;
            }
        }
        let [one, other] = [side, boundary.opposite(side)].map(|side| {
            let area = self.area(side.triangle());
            area.try_normalize(0.0).unwrap_or_default()
        });
        let out = (one + other).try_normalize(0.0)?;
        let normal = edge.cross(&shaft.curve.tangent_at(alpha));
        let normal = normal.try_normalize(0.0)?;
        let facing = normal.dot(&out);
        let normal = normal * facing.signum();
        let face = boundary.half_faces().get(side.triangle())?;
        (facing.abs() > FACING).then(|| Found {
            at: AnchorPoint {
                nodes: [nodes[0], nodes[1], nodes[0], nodes[0]],
                weights: [1.0 - part, part, 0.0, 0.0],
            },
            alpha,
            normal,
            gap_m: normal.dot(&(shaft.curve.at(alpha) - from - edge * part)) - shaft.radius_m,
            is_within: (0.0..=1.0).contains(&part),
            cell: face.cell(),
        })
    }

    /// A vertex that stands out towards the needle.
    fn find_vertex(&self, shaft: &Shaft, node: u32) -> Option<Found> {
        let boundary = self.sources.mesh.boundary();
        let (at, out) = (self.position(node), self.node_normal(node));
        let alpha = shaft.curve.project(&at, 0.5 * shaft.front_m);
        let along = shaft.curve.tangent_at(alpha);
        let apart = shaft.curve.at(alpha) - at;
        let apart = apart - along * along.dot(&apart);
        let distance = apart.norm();
        let normal = apart.try_normalize(1e-3 * shaft.radius_m)?;
        let facing = normal.dot(&out);
        let normal = normal * facing.signum();
        let face = boundary.leaving(node).next()?;
        let face = boundary.half_faces().get(face.triangle())?;
        let is_within = boundary.leaving(node).all(|side| {
            let way = self.position(boundary.side_vertices(side)[1]) - at;
            normal.dot(&way) <= STANDS_OUT * way.norm()
        });
        (facing.abs() > FACING).then(|| Found {
            at: AnchorPoint {
                nodes: [node; 4],
                weights: [1.0, 0.0, 0.0, 0.0],
            },
            alpha,
            normal,
            gap_m: distance * facing.signum() - shaft.radius_m,
            is_within,
            cell: face.cell(),
        })
    }

    /// A face under an end of the body, or where that bulges.
    fn find_face(&self, shaft: &Shaft, face: HalfFace, part: Part) -> Option<Found> {
        let nodes = self.sources.mesh.vertices(face);
        let [a, b, c] = nodes.map(|node| self.position(node));
        let normal = (b - a).cross(&(c - a)).try_normalize(0.0)?;
        let curve = &shaft.curve;
        let alpha = match part {
            Part::End => 0.0,
            Part::Front => shaft.front_m,
            Part::Bulge => lowest(curve, &normal)?,
        };
        let at = curve.at(alpha);
        let inner = Matrix3::from_columns(&[b - a, c - a, normal]).try_inverse()? * (at - a);
        let weights = [1.0 - inner.x - inner.y, inner.x, inner.y];
        Some(Found {
            at: AnchorPoint {
                nodes: [nodes[0], nodes[1], nodes[2], nodes[0]],
                weights: [weights[0], weights[1], weights[2], 0.0],
            },
            alpha,
            normal,
            gap_m: inner.z - shaft.radius_m,
            is_within: weights.iter().all(|weight| *weight >= 0.0),
            cell: face.cell(),
        })
    }

    fn find(&self, shaft: &Shaft, feature: Feature) -> Option<Found> {
        let found = match feature {
            Feature::Edge(nodes) => self.find_edge(shaft, nodes),
            Feature::Vertex(node) => self.find_vertex(shaft, node),
            Feature::Face(face, part) => self.find_face(shaft, face, part),
        };
        found.map(|found| Found {
            is_within: found.is_within && self.is_free(shaft, found.alpha),
            ..found
        })
    }

    /// After the `solve`th solve: bodies that are in the tissue touch it; whether there are none.
    ///
    /// # Errors
    /// More places than there is room for.
    pub(super) fn touch_bodies(&mut self, solve: u32) -> Result<bool, Status> {
        let mut settled = true;
        let edge_m = self.sources.edge_m();
        for needle in 0..self.state.each.len() {
            settled &=
                solve > CORRECTED || self.correct(needle, OVERLAP.map(|overlap| overlap * edge_m));
            let added = self.add_touches(needle, -OVERLAP[1] * edge_m);
            settled &= added.ok_or(Status::TooManyRows)? == 0;
        }
        Ok(settled)
    }

    /// Has what presses, or is in the body, lie where the last solve has it, unless that is where it lies give or take
    /// `within_m`, both; whether all do.
    fn correct(&mut self, needle: usize, within_m: [f64; 2]) -> bool {
        let mut right = true;
        for place in 0..self.state.each[needle].touches.len() {
            let Some(index) = self.point_of(needle, What::Touch(place)) else {
                continue;
            };
            let point = self.work.needles.points[index];
            let presses = self.state.grasp.lambda()[point.first_row] > 0.0;
            let touch = self.state.each[needle].touches[place];
            let Some(shaft) = self.shaft(needle) else {
                continue;
            };
            let is_off = |found: &Found| {
                let gap_m = found.gap_m;
                let is_inside = gap_m < -within_m[1] && gap_m > -shaft.radius_m;
                (presses && gap_m.abs() > within_m[0]) || (!presses && found.is_within && is_inside)
            };
            let Some(found) = self.find(&shaft, touch.feature).filter(is_off) else {
                continue;
            };
            let next = if found.is_within {
                let mut next = self.touch(&shaft, touch.feature, &found);
                let slid_m = self.slipped(&point);
                next.lie.slid_m = slid_m - found.normal * found.normal.dot(&slid_m);
                Touch {
                    id: touch.id,
                    force: touch.force,
                    ..next
                }
            } else {
                Touch {
                    apart_m: touch.apart_m - found.gap_m,
                    ..touch
                }
            };
            self.state.each[needle].touches[place] = next;
            right = false;
        }
        right
    }

    /// Takes up what is nearer to a body than `within_m` and not yet touched; how much that is, nothing if there is no room.
    fn add_touches(&mut self, needle: usize, within_m: f64) -> Option<usize> {
        let mut faces = std::mem::take(&mut self.work.needles.near);
        let mut found = std::mem::take(&mut self.work.needles.found);
        found.clear();
        let mut has_room = true;
        if let Some(shaft) = self.shaft(needle) {
            self.near_body(&shaft, within_m.max(0.0), &mut faces);
            let touches = &shaft.state.touches;
            let most = MOST_TOUCHES - touches.len();
            let mut look = |feature: Feature| {
                let known = touches.iter().chain(&found);
                if known.into_iter().any(|touch| touch.feature == feature) {
                    return;
                }
                let Some(there) = self.find(&shaft, feature) else {
                    return;
                };
                let is_near = there.gap_m < within_m && there.gap_m > -shaft.radius_m;
                if !(is_near && there.is_within && self.gives(&there.at)) {
                    return;
                }
                has_room &= found.len() < most;
                if has_room {
                    found.push(self.touch(&shaft, feature, &there));
                }
            };
            for face in &faces {
                let nodes = self.sources.mesh.vertices(*face);
                for corner in 0..3 {
                    let (a, b) = (nodes[corner], nodes[(corner + 1) % 3]);
                    look(Feature::Edge([a.min(b), a.max(b)]));
                    look(Feature::Vertex(a));
                }
                for part in [Part::End, Part::Front, Part::Bulge] {
                    look(Feature::Face(*face, part));
                }
            }
        }
        let state = &mut self.state.each[needle];
        for touch in &found {
            let id = state.new_id();
            state.touches.push(Touch { id, ..*touch });
        }
        let count = found.len();
        self.work.needles.near = faces;
        self.work.needles.found = found;
        has_room.then_some(count)
    }

    /// Whether a point of the tissue can move.
    fn gives(&self, at: &AnchorPoint) -> bool {
        let numbering = self.body.numbering();
        let parts = at.nodes.iter().zip(at.weights);
        parts
            .filter(|(_, weight)| *weight != 0.0)
            .any(|(node, _)| !numbering.is_fixed(*node))
    }

    fn touch(&self, shaft: &Shaft, feature: Feature, found: &Found) -> Touch {
        let along = shaft.curve.tangent_at(found.alpha);
        let friction = self.sources.tissue(found.cell).surface_friction;
        Touch {
            id: 0,
            feature,
            at: found.at,
            alpha: found.alpha,
            lie: Lie::new(found.normal, &along),
            friction: friction.min(MOST_FRICTION),
            apart_m: shaft.radius_m,
            force: Vector3::zeros(),
        }
    }

    /// Bodies touch where the balance has them: what presses goes with its edge, and what is near may touch next.
    pub(super) fn follow_bodies(&mut self) {
        for needle in 0..self.state.each.len() {
            if !self.sources.needles[needle].body {
                continue;
            }
            let mut touches = std::mem::take(&mut self.state.each[needle].touches);
            touches.retain_mut(|touch| {
                if touch.force == Vector3::zeros() {
                    return false;
                }
                let shaft = self.shaft(needle);
                let Some((shaft, found)) = shaft.and_then(|shaft| {
                    let found = self.find(&shaft, touch.feature)?;
                    found.is_within.then_some((shaft, found))
                }) else {
                    return false;
                };
                *touch = Touch {
                    id: touch.id,
                    force: touch.force,
                    ..self.touch(&shaft, touch.feature, &found)
                };
                true
            });
            self.state.each[needle].touches = touches;
            let thickness_m = self.sources.needles[needle].needle.thickness_m;
            // Of what finds no room now the next solve sees whether it has to.
            let _ = self.add_touches(needle, 0.5 * NEAR * thickness_m);
            let mut faces = std::mem::take(&mut self.work.needles.near);
            if let Some(shaft) = self.shaft(needle) {
                self.near_body(&shaft, 2.0 * self.sources.edge_m(), &mut faces);
            } else {
                faces.clear();
            }
            self.state.each[needle].is_near = !faces.is_empty();
            self.work.needles.near = faces;
        }
    }
}

/// Where a circle is nearest to a plane below it with this normal \[m\]; `None` for lines.
fn lowest(curve: &Curve, normal: &Vector3<f64>) -> Option<f64> {
    if curve.curvature == 0.0 {
        return None;
    }
    // Along the normal by -cos: sin and cos of the angle there.
    let (forward, inward) = (normal.dot(&curve.tangent), normal.dot(&curve.inward));
    let angle = (-forward).atan2(inward);
    Some(angle.rem_euclid(std::f64::consts::TAU) / curve.curvature)
}
