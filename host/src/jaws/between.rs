//! What is between open pads: the points of tissue that they hold when they close.
//!
//! Entry points: [`between`] at the end of a step. Of the boundary's vertices between the pads, and the points of it that are
//! nearest to the corners of the pads' rectangle, those that are farthest from each other are taken (Gonzalez 1985), as far as
//! none follows from the others: rows on dependent points would contradict each other.

use super::model::{FEWEST_POINTS, MOST_POINTS};
use super::{Jaws, JawsPart, Pads};
use crate::anchors::AnchorPoint;
use crate::collide::closest;
use crate::event::{Event, Loss};
use crate::mesh::{HalfFace, HalfFaces};
use crate::needle::{Capsule, MOST_GROUPS, Slack};
use crate::step::{Balance, Sources, unloaded};
use nalgebra::{Isometry3, Vector3};

/// As far outside of the pads a point is between them still \[m\]: rounding.
const TIE_M: f64 = 1e-9;
/// Least part of a point's weights that others do not have.
const LEAST_OWN: f64 = 0.05;
/// Farther apart than so many mean edges points are not all at one place.
const APART: f64 = 0.5;
/// Vertices whose columns a step computes ahead for pads that are open.
const AHEAD: usize = 2;
/// Corners of a triangle that five planes have cut.
const MOST_CORNERS: usize = 8;

/// A point that may be held.
#[derive(Clone, Copy, Debug)]
struct Candidate {
    at: AnchorPoint,
    place_m: Vector3<f64>,
    /// From the nearest point that is taken \[m\]; below zero: it is not to be.
    far_m: f64,
}

/// Scratch.
#[derive(Debug, Default)]
pub(super) struct Between {
    faces: Vec<HalfFace>,
    nodes: Vec<u32>,
    candidates: Vec<Candidate>,
    chosen: Vec<Candidate>,
    /// Rows of the Cholesky factor of the products of the chosen points' weights.
    factor: Vec<[f64; MOST_POINTS]>,
}

impl Between {
    /// Room for all of a boundary, if there are jaws.
    pub fn new(sources: &Sources) -> Self {
        if sources.jaws.is_empty() {
            return Self::default();
        }
        let faces = sources.mesh.boundary().half_faces().len();
        Self {
            faces: Vec::with_capacity(faces),
            nodes: Vec::with_capacity((3 * faces).max(4 * MOST_POINTS)),
            candidates: Vec::with_capacity(3 * faces + 4),
            chosen: Vec::with_capacity(MOST_POINTS),
            factor: Vec::with_capacity(MOST_POINTS),
        }
    }

    /// Chooses what jaws hold of the faces listed, of a grip at `pose`, with nodes where `at` says \[m\].
    fn choose(
        &mut self,
        mesh: &HalfFaces,
        jaws: &Jaws,
        pose: &Isometry3<f64>,
        edge_m: f64,
        at: impl Fn(u32) -> Vector3<f64>,
    ) {
        self.list(mesh, jaws, pose, &at);
        self.chosen.clear();
        self.factor.clear();
        let middle = jaws.on_pads(pose, (0.5 * jaws.length_m, 0.0));
        let nearest = |of: &Candidate| -of.place_m.metric_distance(&middle);
        for candidate in &mut self.candidates {
            candidate.far_m = f64::INFINITY;
        }
        while self.chosen.len() < jaws.points {
            let is_first = self.chosen.is_empty();
            let rank = |of: &Candidate| if is_first { nearest(of) } else { of.far_m };
            let mut best: Option<usize> = None;
            for (place, candidate) in self.candidates.iter().enumerate() {
                let is_free = candidate.far_m > 0.0;
                let wins = best.is_none_or(|best| rank(candidate) > rank(&self.candidates[best]));
                if is_free && wins {
                    best = Some(place);
                }
            }
            let Some(best) = best else {
                break;
            };
            let taken = self.candidates[best];
            self.candidates[best].far_m = -1.0;
            if self.extend_factor(&taken.at) {
                for other in &mut self.candidates {
                    let far_m = other.place_m.metric_distance(&taken.place_m);
                    other.far_m = other.far_m.min(far_m);
                }
                self.chosen.push(taken);
            }
        }
        if self.chosen.len() < FEWEST_POINTS || self.widest_m() < APART * edge_m {
            self.take_nearest_face(mesh, &middle, at);
        }
    }

    /// The candidates: vertices by their numbers, then what is nearest to the pads' corners.
    fn list(
        &mut self,
        mesh: &HalfFaces,
        jaws: &Jaws,
        pose: &Isometry3<f64>,
        at: &impl Fn(u32) -> Vector3<f64>,
    ) {
        let in_pads = |place: &Vector3<f64>| {
            jaws.in_pads(&pose.inverse_transform_point(&(*place).into()).coords)
        };
        let corners = |face: &HalfFace| mesh.vertices(*face).map(at);
        self.faces
            .retain(|face| meets(jaws, corners(face).map(|at| in_pads(&at))));
        self.nodes.clear();
        let nodes = self.faces.iter().flat_map(|face| mesh.vertices(*face));
        self.nodes.extend(nodes);
        self.nodes.sort_unstable();
        self.nodes.dedup();
        let mut candidates = std::mem::take(&mut self.candidates);
        candidates.clear();
        let mut add = |at: AnchorPoint, place_m: Vector3<f64>| {
            let place = in_pads(&place_m);
            if planes(jaws)
                .iter()
                .all(|plane| plane.beyond_m(&place) <= TIE_M)
            {
                candidates.push(Candidate {
                    at,
                    place_m,
                    far_m: 0.0,
                });
            }
        };
        for node in &self.nodes {
            add(vertex(*node), at(*node));
        }
        for along_m in [0.0, jaws.length_m] {
            for aside in [-0.5, 0.5] {
                let corner = jaws.on_pads(pose, (along_m, aside * jaws.width_m));
                if let Some((_, face, weights)) = self.nearest_face(&corner, corners) {
                    let [a, b, c] = mesh.vertices(face);
                    let [x, y, z] = weights;
                    let point = AnchorPoint {
                        nodes: [a, b, c, a],
                        weights: [x, y, z, 0.0],
                    };
                    let [u, v, w] = corners(&face);
                    add(point, u * x + v * y + w * z);
                }
            }
        }
        self.candidates = candidates;
    }

    /// The face nearest to a place, how far it is \[m\], and which of its points.
    fn nearest_face(
        &self,
        to: &Vector3<f64>,
        corners: impl Fn(&HalfFace) -> [Vector3<f64>; 3],
    ) -> Option<(f64, HalfFace, [f64; 3])> {
        let found = self.faces.iter().map(|face| {
            let closest = closest(&corners(face).map(|at| at - to));
            (closest.point.norm(), *face, closest.weights)
        });
        found.min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)))
    }

    /// Where points are few or all at one place the nearest face is held by its corners.
    fn take_nearest_face(
        &mut self,
        mesh: &HalfFaces,
        middle: &Vector3<f64>,
        at: impl Fn(u32) -> Vector3<f64>,
    ) {
        let corners = |face: &HalfFace| mesh.vertices(*face).map(&at);
        let Some((_, face, _)) = self.nearest_face(middle, corners) else {
            return;
        };
        self.chosen.clear();
        for node in mesh.vertices(face) {
            self.chosen.push(Candidate {
                at: vertex(node),
                place_m: at(node),
                far_m: 0.0,
            });
        }
    }

    /// Takes a point's weights into the factor, if they do not follow from those that are there.
    fn extend_factor(&mut self, at: &AnchorPoint) -> bool {
        let mut row = [0.0; MOST_POINTS];
        let whole = product(at, at);
        let mut own = whole;
        for (place, (known, other)) in self.factor.iter().zip(&self.chosen).enumerate() {
            let before: f64 = row.iter().zip(known).take(place).map(|(a, b)| a * b).sum();
            row[place] = (product(at, &other.at) - before) / known[place];
            own -= row[place] * row[place];
        }
        let is_new = own > LEAST_OWN * whole && self.factor.len() < MOST_POINTS;
        if is_new {
            row[self.factor.len()] = own.sqrt();
            self.factor.push(row);
        }
        is_new
    }

    /// The largest distance between two of the chosen points \[m\].
    fn widest_m(&self) -> f64 {
        let pairs = self
            .chosen
            .iter()
            .flat_map(|a| self.chosen.iter().map(move |b| (a, b)));
        pairs.fold(0.0, |most, (a, b)| {
            most.max(a.place_m.metric_distance(&b.place_m))
        })
    }
}

/// At the end of a step: pads that close take hold of what is between them, once its columns are there; for pads that are open
/// some of these are computed ahead.
pub(crate) fn between(balance: &mut Balance) {
    let sources = balance.sources;
    for (index, part) in sources.jaws.iter().enumerate() {
        let state = &balance.state.jaws[index];
        let (pads, Some(pose)) = (state.pads, state.pose) else {
            continue;
        };
        if pads == Pads::Closed {
            continue;
        }
        let mut found = std::mem::take(&mut balance.work.jaws.between);
        balance.find_between(part, &pose, &mut found);
        let closes = pads == Pads::Closing;
        let is_ready = balance.compute_between(&mut found, closes);
        if closes && is_ready {
            let taken = found.chosen.iter().map(|point| (point.at, point.place_m));
            balance.state.jaws[index].take(part, &pose, taken);
            let points = balance.state.jaws[index].points.len() as u32;
            let tool = part.tool;
            balance.report.happened(match points {
                0 => Event::Lost {
                    tool,
                    why: Loss::Nothing,
                },
                _ => Event::Grasped { tool, points },
            });
            let report = balance.state.jaws[index].report(part);
            let told = &mut balance.report.jaws_mut(sources.jaws.len())[index];
            (told.pads, told.points) = (report.pads, report.points);
        }
        balance.work.jaws.between = found;
    }
}

impl Balance<'_> {
    /// Chooses what pads at `pose` would hold.
    fn find_between(&self, part: &JawsPart, pose: &Isometry3<f64>, found: &mut Between) {
        let (sources, jaws) = (self.sources, &part.jaws);
        let [hinge, front] = [0.0, jaws.length_m].map(|along| jaws.on_pads(pose, (along, 0.0)));
        let capsule = Capsule::new(&hinge, &front);
        let gape_m = jaws.length_m * (0.5 * jaws.opening_rad).tan();
        let reach_m = gape_m.hypot(0.5 * jaws.width_m);
        let mut slack = [0.0; MOST_GROUPS];
        let slack = Slack::ByGroup(self.slack(&mut slack));
        found.faces.clear();
        let faces = &mut found.faces;
        sources.hierarchy.near(
            |bounds, group| capsule.meets(bounds, reach_m + slack.of(group)),
            |face| faces.push(face),
        );
        // Of tissue that is not linear where the step has moved it.
        let (system, grasp, pushes) = (
            &self.work.system,
            &self.state.grasp,
            &self.work.nodes.pushes,
        );
        let at = |node: u32| {
            unloaded(self.points_m, node) + system.displacement(self.body, grasp, pushes, node)
        };
        found.choose(&sources.mesh, jaws, pose, sources.edge_m, at);
    }

    /// Has columns of what was chosen computed, all that a step has left for pads that close; whether all are there. Of tissue
    /// that is not linear the next step computes them.
    fn compute_between(&mut self, found: &mut Between, closes: bool) -> bool {
        if !self.body.is_linear() {
            return true;
        }
        found.nodes.clear();
        for point in &found.chosen {
            let used = point.at.nodes.iter().zip(point.at.weights);
            let used = used
                .filter(|(node, weight)| *weight != 0.0 && !self.body.numbering().is_fixed(**node));
            found.nodes.extend(used.map(|(node, _)| *node));
        }
        let left = self.vertices_left();
        let most = if closes { left } else { left.min(AHEAD) };
        let grasp = &self.state.grasp;
        let system = &mut self.work.system;
        let computed = system.compute_ahead(self.body, grasp, &found.nodes, most);
        self.report.columns_computed += 3 * computed;
        let is_ready = found.nodes.iter().all(|node| system.has(*node));
        self.clock.lap(&mut self.report.stages.columns_ns);
        is_ready
    }
}

/// A vertex as a point.
fn vertex(node: u32) -> AnchorPoint {
    AnchorPoint {
        nodes: [node; 4],
        weights: [1.0, 0.0, 0.0, 0.0],
    }
}

/// Sum of the products of the weights that two points have of the same nodes.
fn product(a: &AnchorPoint, b: &AnchorPoint) -> f64 {
    let of_a = a.nodes.iter().zip(a.weights);
    let pairs = of_a.flat_map(|a| b.nodes.iter().zip(b.weights).map(move |b| (a, b)));
    let same = pairs.filter(|((a, _), (b, _))| a == b);
    same.map(|((_, a), (_, b))| a * b).sum()
}

/// A plane that bounds what is between the pads, in their coordinates.
struct Plane {
    out: Vector3<f64>,
    at_m: f64,
}

impl Plane {
    /// How far beyond it a place is, in the plane's own measure \[m\].
    fn beyond_m(&self, place: &Vector3<f64>) -> f64 {
        self.out.dot(place) - self.at_m
    }
}

/// The pads' front, their sides, and the pads themselves, opened.
fn planes(jaws: &Jaws) -> [Plane; 5] {
    let slope = (0.5 * jaws.opening_rad).tan();
    let aside_m = 0.5 * jaws.width_m;
    let plane = |x, y, z, at_m| Plane {
        out: Vector3::new(x, y, z),
        at_m,
    };
    [
        plane(1.0, 0.0, 0.0, jaws.length_m),
        plane(0.0, 1.0, 0.0, aside_m),
        plane(0.0, -1.0, 0.0, aside_m),
        plane(-slope, 0.0, 1.0, 0.0),
        plane(-slope, 0.0, -1.0, 0.0),
    ]
}

/// Whether a triangle in the pads' coordinates \[m\] has a part between them (Sutherland & Hodgman 1974).
fn meets(jaws: &Jaws, corners: [Vector3<f64>; 3]) -> bool {
    let mut polygon = [Vector3::zeros(); MOST_CORNERS];
    polygon[..3].copy_from_slice(&corners);
    let mut count = 3;
    for plane in planes(jaws) {
        let before = polygon;
        let mut left = 0;
        for place in 0..count {
            let (from, to) = (before[place], before[(place + 1) % count]);
            let (a, b) = (plane.beyond_m(&from), plane.beyond_m(&to));
            if a <= 0.0 && left < MOST_CORNERS {
                polygon[left] = from;
                left += 1;
            }
            if (a <= 0.0) != (b <= 0.0) && left < MOST_CORNERS {
                polygon[left] = from + (to - from) * (a / (a - b));
                left += 1;
            }
        }
        count = left;
    }
    count > 0
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::UnitQuaternion;

    /// Against points spread over triangles: what has one between the pads meets them.
    #[test]
    fn triangles_with_a_point_between_the_pads_meet_them() {
        let jaws = Jaws::new(1.0, 0.5);
        let mut random = sutura_testkit::Random::new(5);
        let (mut met, mut not) = (0, 0);
        for _ in 0..4000 {
            let mut corner = |size: f64| Vector3::from_fn(|_, _| size * random.signed());
            let from = corner(0.03);
            let corners = [from, from + corner(0.02), from + corner(0.02)];
            let parts = || (0..=12).map(|k| f64::from(k) / 12.0);
            let has = parts().flat_map(|s| parts().map(move |t| (s * (1.0 - t), s * t)));
            let [a, b, c] = corners;
            let has = has
                .map(|(s, t)| a + (b - a) * s + (c - a) * t)
                .any(|place| {
                    planes(&jaws)
                        .iter()
                        .all(|plane| plane.beyond_m(&place) <= 0.0)
                });
            let found = meets(&jaws, corners);
            assert!(found || !has, "{corners:?}");
            met += u32::from(has);
            not += u32::from(!found);
        }
        assert!(met > 100 && not > 1000, "{met} {not}");
    }

    #[test]
    fn places_in_the_pads_lead_back_to_the_world() {
        let mut jaws = Jaws::new(1.0, 0.5);
        jaws.offset_m = [0.001, -0.002, 0.03];
        let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.3, -0.7, 1.1));
        let pose = Isometry3::from_parts(Vector3::new(0.1, 0.2, -0.3).into(), turn);
        let place = jaws.on_pads(&pose, (0.004, -0.001));
        let local = pose.inverse_transform_point(&place.into()).coords;
        let back = jaws.in_pads(&local);
        assert!(
            (back - Vector3::new(0.004, -0.001, 0.0)).norm() < 1e-16,
            "{back}"
        );
        let [across, axis, side] = jaws.frame(&pose.rotation);
        assert!((axis.cross(&side) - across).norm() < 1e-15);
    }

    #[test]
    fn points_that_follow_from_others_are_not_taken() {
        let mut between = Between::default();
        let point = |weights: [f64; 3]| AnchorPoint {
            nodes: [4, 7, 9, 4],
            weights: [weights[0], weights[1], weights[2], 0.0],
        };
        let mut take = |at: AnchorPoint| {
            let taken = between.extend_factor(&at);
            if taken {
                between.chosen.push(Candidate {
                    at,
                    place_m: Vector3::zeros(),
                    far_m: 0.0,
                });
            }
            taken
        };
        assert!(take(point([1.0, 0.0, 0.0])));
        assert!(take(point([0.2, 0.8, 0.0])));
        assert!(!take(point([0.5, 0.5, 0.0])), "on the edge between them");
        assert!(take(point([0.1, 0.1, 0.8])));
        assert!(!take(point([0.3, 0.3, 0.4])), "the fourth of a face");
    }
}
