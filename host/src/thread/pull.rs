//! A thread pulled through tissue without friction: one tension, the true length.
//!
//! Entry point: [`ThreadSolver::pull`]. Younes 2021, 3.33, with both end segments: the path's length outside the
//! tissue `L(u) = sum |x_(i+1) - x_i|` must not exceed what there is of thread. L is convex, so the
//! balance is the unique minimum of the tissue's energy under `L <= available`, and the tension T >= 0 its
//! multiplier. It is not linearised and pulled in steps (3.35 to 3.37): every segment outside is three rows on the
//! compliance between anchors, made once a pull, and `tension.rs` solves for their forces, segments that
//! close (welds, which carry any force up to T) included. A tension beyond the thread's strength is cut there, so
//! that forces are bounded when a path cannot be as short as it is asked to be.

use super::tension::{End as Solved, Piece, Tension};
use crate::anchors::{AnchorPoint, AnchorSettings, Grasp, SpreadRow, System, Term};
use crate::body::{Body, Push};
use crate::fem::{LinearTissue, TissueError};
use crate::rows::RowKind;
use nalgebra::Vector3;
use std::sync::Arc;

/// The true length is held this well \[m\].
pub const LENGTH_TOLERANCE_M: f64 = 1e-6;
/// No scene is larger \[m\]; what is farther away is no place.
const FARTHEST_M: f64 = 1e6;

/// A point of a thread's path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PathPoint {
    /// A point of tissue that it runs through.
    Tissue(AnchorPoint),
    /// Where the first or the last end is held \[m\], (3). A path that begins or ends in tissue is tied there.
    Held([f64; 3]),
}

/// How a pull ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum PullStatus {
    /// Balance found.
    Ok,
    /// Balance found at the thread's strength, with the path still longer than what there is of thread.
    Strained,
    /// Columns are still missing; there are no forces.
    Waiting,
    /// Points or numbers that make no path, or more than there is room for; there are no forces.
    Malformed,
    /// No balance within the solves allowed; forces are bounded by the strength, the length is not held.
    NotConverged,
}

/// What a pull found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pull {
    /// How it ended.
    pub status: PullStatus,
    /// Tension \[N\]; 0 while the thread is slack.
    pub tension_n: f64,
    /// Length of the outside segments \[m\].
    pub length_m: f64,
    /// Segments of no length that the tension holds closed.
    pub welds: u32,
    /// Solves.
    pub solves: u32,
}

/// How tension and the forces on held ends change about the last pull, exact where no segment closes or opens
/// and the thread stays slack or taut. An end that is not held has zeros.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PullTangent {
    /// d(forces on the first and the last end) / d(their positions) \[N/m\], row by row: symmetric.
    pub ends_n_per_m: [[f64; 6]; 6],
    /// d(tension) / d(positions of the first and the last end) \[N/m\]; also d(forces on them) / d(available).
    pub tension_n_per_m: [f64; 6],
    /// d(tension) / d(available) \[N/m\], not positive.
    pub available_n_per_m: f64,
}

/// Linear tissue and a thread through it.
pub struct ThreadSolver {
    body: Body,
    points_m: Vec<[f64; 3]>,
    strength_n: f64,
    grasp: Grasp,
    system: System,
    tension: Tension,
    pushes: Vec<Push>,
    anchors: Vec<AnchorPoint>,
    terms: Vec<Term>,
    rows: Vec<SpreadRow>,
    segments: Vec<[End; 2]>,
    /// Where segments are without the thread's forces \[m\], (3 segments).
    free: Vec<f64>,
    /// Changes of `free` by the ends' coordinates and by the available length, (3 segments x 7).
    changes: Vec<f64>,
}

#[derive(Clone, Copy, Debug)]
enum End {
    Anchor(usize),
    Held(Vector3<f64>),
}

impl ThreadSolver {
    /// For paths of up to `most_points` points through `tissue`, whose unloaded nodes are at `points_m`, of a
    /// thread that bears `strength_n`.
    ///
    /// # Errors
    /// Other numbers of nodes.
    pub fn new(
        tissue: Arc<LinearTissue>,
        points_m: &[[f64; 3]],
        most_points: usize,
        strength_n: f64,
    ) -> Result<Self, TissueError> {
        let resting = vec![0.0; tissue.unknowns()];
        let body = Body::Linear { tissue, resting };
        let most_segments = most_points.saturating_sub(1);
        let settings = AnchorSettings {
            most_rows: 0,
            most_anchors: most_points,
            most_spread: 3 * most_segments,
            most_terms: 6 * most_segments,
            vertices_per_step: usize::MAX,
            ..AnchorSettings::default()
        };
        let grasp = Grasp::new(body.at_rest(), &settings);
        let mut system = System::everywhere(&body, grasp.motion(), settings, &[]);
        system.reserve_spread();
        Ok(Self {
            points_m: points_m.to_vec(),
            strength_n,
            system,
            tension: Tension::new(most_segments),
            pushes: Vec::with_capacity(4 * most_points),
            anchors: Vec::with_capacity(most_points),
            terms: Vec::with_capacity(6 * most_segments),
            rows: Vec::with_capacity(3 * most_segments),
            segments: Vec::with_capacity(most_segments),
            free: Vec::with_capacity(3 * most_segments),
            changes: vec![0.0; 3 * most_segments * CHANGES],
            grasp,
            body,
        })
    }

    /// Balances the tissue with a thread along `path`, whose segments are outside the tissue where `outside` says
    /// so, (points - 1), with `available_m` of it for them. The forces of the last pull are where it starts.
    pub fn pull(&mut self, path: &[PathPoint], outside: &[bool], available_m: f64) -> Pull {
        let mut found = Pull {
            status: PullStatus::Malformed,
            tension_n: 0.0,
            length_m: 0.0,
            welds: 0,
            solves: 0,
        };
        self.pushes.clear();
        let sound = self.lay(path, outside)
            && available_m.abs() <= FARTHEST_M
            && self.system.read(&self.body, &self.anchors, &[], &[])
            && self.system.read_spread(&self.rows, &self.terms);
        if !sound {
            self.forget();
            return found;
        }
        self.system.begin_step();
        let fetched = self.system.fetch(&self.body, &self.grasp, usize::MAX);
        if !fetched.all {
            self.forget();
            found.status = PullStatus::Waiting;
            return found;
        }
        self.system.assemble(&self.body, &self.grasp, &[]);
        self.free.clear();
        // Rows have no targets: what is left of them is how far the tissue moves them the other way.
        let moved = self.system.delta_free_m(self.rows.len());
        for (index, ends) in self.segments.iter().enumerate() {
            let apart = self.unloaded(&ends[1]) - self.unloaded(&ends[0]);
            let moved = &moved[3 * index..3 * index + 3];
            self.free
                .extend(apart.iter().zip(moved).map(|(x, delta)| x - delta));
        }
        let (solved, solves) = self.tension.solve(
            self.system.compliance(self.rows.len()),
            &self.free,
            available_m,
            self.strength_n,
        );
        found.status = match solved {
            Solved::Solved => PullStatus::Ok,
            Solved::Limit => PullStatus::Strained,
            Solved::NotConverged => PullStatus::NotConverged,
            Solved::Malformed => {
                self.forget();
                return found;
            }
        };
        self.pushes
            .extend(self.system.pushes(self.tension.force_n()));
        found.solves = solves;
        found.tension_n = self.tension.tension_n();
        found.length_m = self.tension.length_m();
        let pieces = self.tension.pieces();
        found.welds = pieces.iter().filter(|piece| **piece == Piece::Weld).count() as u32;
        found
    }

    /// How the last pull's result changes with its ends and what there is of thread; zeros if there is none.
    pub fn tangent(&mut self) -> PullTangent {
        let mut tangent = PullTangent {
            ends_n_per_m: [[0.0; 6]; 6],
            tension_n_per_m: [0.0; 6],
            available_n_per_m: 0.0,
        };
        let n = self.tension.force_n().len();
        let (Some(last), true) = (self.segments.len().checked_sub(1), n == self.free.len()) else {
            return tangent;
        };
        let changes = &mut self.changes[..n * CHANGES];
        changes.fill(0.0);
        let held = [
            matches!(self.segments[0][0], End::Held(_)),
            matches!(self.segments[last][1], End::Held(_)),
        ];
        // A segment is its second end less its first; the thread pulls an end along it.
        let ends = [(0, -1.0), (3 * last, 1.0)];
        for end in (0..2).filter(|end| held[*end]) {
            let (first, sign) = ends[end];
            for axis in 0..3 {
                changes[n * (3 * end + axis) + first + axis] = sign;
            }
        }
        let available = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0];
        let compliance = self.system.compliance(n);
        let forces = self.tension.change(compliance, changes, &available);
        changes.copy_from_slice(forces);
        for (column, change) in changes.chunks_exact(n).enumerate() {
            let tension = self.tension.tension_change_n(change);
            let Some(of_tension) = tangent.tension_n_per_m.get_mut(column) else {
                tangent.available_n_per_m = tension;
                break;
            };
            *of_tension = if held[column / 3] { tension } else { 0.0 };
            for end in (0..2).filter(|end| held[*end]) {
                let (first, sign) = ends[end];
                for axis in 0..3 {
                    tangent.ends_n_per_m[3 * end + axis][column] = -sign * change[first + axis];
                }
            }
        }
        tangent
    }

    fn forget(&mut self) {
        self.tension.clear();
        self.anchors.clear();
        self.segments.clear();
        self.rows.clear();
        self.free.clear();
    }
}

/// Coordinates of two ends, and the available length.
const CHANGES: usize = 7;

impl ThreadSolver {
    /// Force on a held end \[N\], (3): the last one if `last`, else the first; zero for one that is not held.
    pub fn end_force_n(&self, last: bool) -> [f64; 3] {
        let (segment, end, sign) = if last {
            (self.segments.len().wrapping_sub(1), 1, -1.0)
        } else {
            (0, 0, 1.0)
        };
        let held = self.segments.get(segment);
        let held = held.is_some_and(|ends| matches!(ends[end], End::Held(_)));
        if held {
            self.segment_force_n(segment).map(|force| sign * force)
        } else {
            [0.0; 3]
        }
    }

    /// Force of a segment outside the tissue \[N\], (3), on its first end; the second has the opposite.
    pub fn segment_force_n(&self, segment: usize) -> [f64; 3] {
        let force = self.tension.force_n().get(3 * segment..3 * segment + 3);
        force.map_or([0.0; 3], |force| [force[0], force[1], force[2]])
    }

    /// A segment outside the tissue \[m\], (3), from its first end to the second; `None` if there is none.
    pub fn segment_m(&self, segment: usize) -> Option<[f64; 3]> {
        let way = self.tension.way_m().get(3 * segment..3 * segment + 3);
        way.map(|way| [way[0], way[1], way[2]])
    }

    /// Where a point of tissue of the path is \[m\], (3), counted without held ends; `None` for one that it does not
    /// have.
    pub fn anchor_m(&self, anchor: usize) -> Option<[f64; 3]> {
        (anchor < self.anchors.len()).then(|| self.at(anchor).into())
    }

    /// Forces of the thread on nodes \[N\].
    pub fn forces(&self) -> impl Iterator<Item = (u32, [f64; 3])> + '_ {
        self.pushes.iter().filter_map(|(vertex, force)| {
            let node = self.body.numbering().node_at(*vertex)?;
            Some((node, (*force).into()))
        })
    }

    /// Reads a path; whether it is one.
    fn lay(&mut self, path: &[PathPoint], outside: &[bool]) -> bool {
        if path.len() < 2 || outside.len() + 1 != path.len() || path.len() > self.anchors.capacity()
        {
            return false;
        }
        self.anchors.clear();
        self.segments.clear();
        self.rows.clear();
        self.terms.clear();
        let mut before: Option<End> = None;
        for (index, point) in path.iter().enumerate() {
            let end = match point {
                PathPoint::Tissue(anchor) => {
                    let sum: f64 = anchor.weights.iter().sum();
                    let sound = (sum - 1.0).abs() <= 1e-9
                        && anchor.weights.iter().all(|weight| weight.abs() <= 1e3);
                    if !sound {
                        return false;
                    }
                    self.anchors.push(*anchor);
                    End::Anchor(self.anchors.len() - 1)
                }
                PathPoint::Held(at) => {
                    let is_end = index == 0 || index + 1 == path.len();
                    let is_outside = outside[index.saturating_sub(1).min(outside.len() - 1)];
                    let is_place = at.iter().all(|x| x.abs() <= FARTHEST_M);
                    if !(is_end && is_outside && is_place) {
                        return false;
                    }
                    End::Held(Vector3::from(*at))
                }
            };
            if let Some(before) = before
                && outside[index - 1]
            {
                self.segments.push([before, end]);
                self.add_rows([before, end]);
            }
            before = Some(end);
        }
        true
    }

    /// Three rows along the axes, on a segment's ends.
    fn add_rows(&mut self, ends: [End; 2]) {
        for axis in 0..3 {
            let first = self.terms.len() as u32;
            for (end, sign) in ends.iter().zip([-1.0, 1.0]) {
                if let End::Anchor(anchor) = end {
                    self.terms.push(Term {
                        anchor: *anchor as u32,
                        direction: (Vector3::ith(axis, 1.0) * sign).into(),
                    });
                }
            }
            self.rows.push(SpreadRow {
                id: self.rows.len() as u64,
                kind: RowKind::Equality,
                target_m: 0.0,
                compliance_m_per_n: 0.0,
                terms: (first, self.terms.len() as u32 - first),
            });
        }
    }

    /// Where an anchor is \[m\].
    fn at(&self, anchor: usize) -> Vector3<f64> {
        let anchor = &self.anchors[anchor];
        let parts = anchor.nodes.iter().zip(anchor.weights);
        parts
            .filter(|(_, weight)| *weight != 0.0)
            .map(|(node, weight)| {
                let system = &self.system;
                let moved = system.displacement(&self.body, &self.grasp, &self.pushes, *node);
                (rest(&self.points_m, *node) + moved) * weight
            })
            .sum()
    }

    /// Where a point is without any displacement.
    fn unloaded(&self, end: &End) -> Vector3<f64> {
        match *end {
            End::Held(at) => at,
            End::Anchor(index) => {
                let anchor = &self.anchors[index];
                let parts = anchor.nodes.iter().zip(anchor.weights);
                parts
                    .map(|(node, weight)| rest(&self.points_m, *node) * weight)
                    .sum()
            }
        }
    }
}

fn rest(points_m: &[[f64; 3]], node: u32) -> Vector3<f64> {
    points_m
        .get(node as usize)
        .map_or_else(Vector3::zeros, |at| Vector3::from(*at))
}
