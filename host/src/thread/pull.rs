//! A thread pulled through tissue without friction: one tension, the true length.
//!
//! Entry point: [`ThreadSolver::pull`]. Younes 2021, 3.33 to 3.36, with both end segments and with second derivatives. The
//! path's length outside the tissue `L(u) = sum |x_(i+1) - x_i|` must not exceed what there is of thread. L is
//! convex, so the balance is the unique minimum of the tissue's energy under `L <= available`, and the
//! tension T >= 0 its multiplier. Newton's method for it: a segment of direction d and length l is a row
//! along d, shared by all segments, and a spring T/l across d, the second derivative of T |x|: without it
//! the iteration diverges as soon as T/l exceeds the tissue's stiffness, that is, whenever a wound
//! closes. A segment of no length may carry any force up to T (the subdifferential of |x| is the unit
//! ball): it is a weld of three rows until its force exceeds T.

use crate::anchors::{AnchorPoint, AnchorSettings, Grasp, SpreadRow, System, Term, is_solved};
use crate::body::{Body, Push};
use crate::fem::{LinearTissue, TissueError};
use crate::rows::RowKind;
use nalgebra::Vector3;
use std::sync::Arc;

/// The true length is held this well \[m\].
pub const LENGTH_TOLERANCE_M: f64 = 1e-6;
/// Most solves of one pull.
const MOST_SOLVES: u32 = 60;
/// Shortest segment that has a direction \[m\].
const WELD_M: f64 = 1e-6;

/// A point of a thread's path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PathPoint {
    /// A point of tissue that it runs through.
    Tissue(AnchorPoint),
    /// Where an end is held \[m\], (3).
    Held([f64; 3]),
}

/// How a pull ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum PullStatus {
    /// Balance found.
    Ok,
    /// Columns are still missing.
    Waiting,
    /// Points or numbers that make no path, or more than there is room for.
    Malformed,
    /// No balance within the solves allowed: the thread is shorter than anything can follow.
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
    /// Segments of no length.
    pub welds: u32,
    /// Solves.
    pub solves: u32,
}

/// Linear tissue and a thread through it.
pub struct ThreadSolver {
    body: Body,
    points_m: Vec<[f64; 3]>,
    grasp: Grasp,
    system: System,
    pushes: Vec<Push>,
    anchors: Vec<AnchorPoint>,
    terms: Vec<Term>,
    rows: Vec<SpreadRow>,
    segments: Vec<Segment>,
}

/// A piece of thread outside the tissue.
#[derive(Clone, Copy, Debug)]
struct Segment {
    ends: [End; 2],
    /// x_1 - x_0 now \[m\].
    way: Vector3<f64>,
    welded: bool,
    /// Its first row across, or of its weld.
    first_row: usize,
}

#[derive(Clone, Copy, Debug)]
enum End {
    Anchor(usize),
    Held(Vector3<f64>),
}

impl ThreadSolver {
    /// For paths of up to `most_points` points through `tissue`, whose unloaded nodes are at `points_m`.
    ///
    /// # Errors
    /// Other numbers of nodes.
    pub fn new(
        tissue: Arc<LinearTissue>,
        points_m: &[[f64; 3]],
        most_points: usize,
    ) -> Result<Self, TissueError> {
        let resting = vec![0.0; tissue.unknowns()];
        let body = Body::Linear { tissue, resting };
        let settings = AnchorSettings {
            most_rows: 0,
            most_anchors: most_points,
            most_spread: 1 + 3 * most_points,
            vertices_per_step: usize::MAX,
            ..AnchorSettings::default()
        };
        let grasp = Grasp::new(body.at_rest(), &settings);
        let system = System::everywhere(&body, grasp.motion(), settings, &[]);
        Ok(Self {
            points_m: points_m.to_vec(),
            system,
            pushes: Vec::with_capacity(4 * most_points),
            anchors: Vec::with_capacity(most_points),
            terms: Vec::with_capacity(8 * most_points),
            rows: Vec::with_capacity(1 + 3 * most_points),
            segments: Vec::with_capacity(most_points),
            grasp,
            body,
        })
    }

    /// Balances the tissue with a thread along `path`, whose segments are outside the tissue where `outside` says
    /// so, (points - 1), with `available_m` of it for them.
    pub fn pull(&mut self, path: &[PathPoint], outside: &[bool], available_m: f64) -> Pull {
        let mut found = Pull {
            status: PullStatus::Malformed,
            tension_n: 0.0,
            length_m: 0.0,
            welds: 0,
            solves: 0,
        };
        if !self.lay(path, outside) || !(available_m.is_finite() && available_m >= 0.0) {
            return found;
        }
        if !self.system.read(&self.body, &self.anchors, &[]) {
            return found;
        }
        self.system.begin_step();
        let fetched = self.system.fetch(&self.body, &self.grasp, usize::MAX);
        if !fetched.all {
            found.status = PullStatus::Waiting;
            return found;
        }
        self.pushes.clear();
        self.pushes.extend(self.grasp.pushes());
        self.measure();
        let mut tension = 0.0;
        loop {
            found.solves += 1;
            if found.solves > MOST_SOLVES {
                found.status = PullStatus::NotConverged;
                break;
            }
            self.make_rows(tension, available_m);
            let sound = self.system.read(&self.body, &self.anchors, &[])
                && self.system.read_spread(&self.rows, &self.terms);
            if !sound {
                return found;
            }
            self.system.assemble(&self.body, &self.grasp, &[]);
            let outcome = self.system.solve(&[], &mut self.grasp);
            if !is_solved(&outcome) {
                found.status = PullStatus::NotConverged;
                break;
            }
            self.pushes.clear();
            self.pushes.extend(self.grasp.pushes());
            let before = tension;
            tension = self.grasp.lambda().first().copied().unwrap_or(0.0);
            let changed = self.measure() | self.weld_or_part(tension);
            let length: f64 = self.segments.iter().map(|segment| segment.way.norm()).sum();
            found.length_m = length;
            let held = if tension > 0.0 {
                (length - available_m).abs() <= LENGTH_TOLERANCE_M
            } else {
                length <= available_m + LENGTH_TOLERANCE_M
            };
            let still = (tension - before).abs() <= 1e-6 * tension.max(before);
            if held && still && !changed {
                found.status = PullStatus::Ok;
                break;
            }
        }
        found.tension_n = tension;
        found.welds = self
            .segments
            .iter()
            .filter(|segment| segment.welded)
            .count() as u32;
        found
    }
}

impl ThreadSolver {
    /// Force on a held end \[N\], (3): the last one if `last`, else the first; zero unless a segment leads there.
    pub fn end_force_n(&self, last: bool) -> [f64; 3] {
        let tension = self.grasp.lambda().first().copied().unwrap_or(0.0);
        let (segment, end, sign) = if last {
            (self.segments.last(), 1, -1.0)
        } else {
            (self.segments.first(), 0, 1.0)
        };
        let pulled = segment.filter(|segment| matches!(segment.ends[end], End::Held(_)));
        let force = pulled
            .and_then(|segment| segment.way.try_normalize(f64::MIN_POSITIVE))
            .map_or_else(Vector3::zeros, |along| along * (sign * tension));
        force.into()
    }

    /// Where a point of the path is \[m\], (3); `None` for one that it does not have.
    pub fn anchor_m(&self, anchor: usize) -> Option<[f64; 3]> {
        (anchor < self.anchors.len()).then(|| self.at(&End::Anchor(anchor)).into())
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
        let mut before: Option<End> = None;
        for (index, point) in path.iter().enumerate() {
            let end = match point {
                PathPoint::Tissue(anchor) => {
                    let sum: f64 = anchor.weights.iter().sum();
                    if (sum - 1.0).abs() > 1e-9 || sum.is_nan() {
                        return false;
                    }
                    self.anchors.push(*anchor);
                    End::Anchor(self.anchors.len() - 1)
                }
                PathPoint::Held(at) => {
                    if !at.iter().all(|x| x.is_finite()) {
                        return false;
                    }
                    End::Held(Vector3::from(*at))
                }
            };
            if let Some(before) = before
                && outside[index - 1]
            {
                self.segments.push(Segment {
                    ends: [before, end],
                    way: Vector3::zeros(),
                    welded: false,
                    first_row: 0,
                });
            }
            before = Some(end);
        }
        true
    }

    fn at(&self, end: &End) -> Vector3<f64> {
        match *end {
            End::Held(at) => at,
            End::Anchor(index) => {
                let anchor = &self.anchors[index];
                let parts = anchor.nodes.iter().zip(anchor.weights);
                parts
                    .filter(|(_, weight)| *weight != 0.0)
                    .map(|(node, weight)| {
                        let system = &self.system;
                        let moved =
                            system.displacement(&self.body, &self.grasp, &self.pushes, *node);
                        (rest(&self.points_m, *node) + moved) * weight
                    })
                    .sum()
            }
        }
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

    /// Takes the segments' ways from the tissue as it is; whether one has turned round and is a weld now.
    fn measure(&mut self) -> bool {
        let mut changed = false;
        for index in 0..self.segments.len() {
            let segment = self.segments[index];
            let way = self.at(&segment.ends[1]) - self.at(&segment.ends[0]);
            let turned = segment.way.dot(&way) < 0.0;
            let fixed = matches!(segment.ends, [End::Held(_), End::Held(_)]);
            let own = &mut self.segments[index];
            if !own.welded && !fixed && (turned || way.norm() < WELD_M) {
                own.welded = true;
                changed = true;
            }
            own.way = if own.welded { Vector3::zeros() } else { way };
        }
        changed
    }

    /// Welds that would carry more than the tension part, in the direction of their force.
    fn weld_or_part(&mut self, tension: f64) -> bool {
        let mut changed = false;
        let lambda = self.grasp.lambda();
        for segment in &mut self.segments {
            // One that has just been welded had no rows of its own.
            if !segment.welded || segment.first_row == 0 {
                continue;
            }
            let Some(force) = lambda.get(segment.first_row..segment.first_row + 3) else {
                continue;
            };
            let force = Vector3::from_column_slice(force);
            if force.norm() > tension * (1.0 + 1e-9) {
                segment.welded = false;
                segment.way = force.normalize() * (2.0 * WELD_M);
                changed = true;
            }
        }
        changed
    }

    /// The length's row, then those across segments and of welds.
    fn make_rows(&mut self, tension: f64, available_m: f64) {
        self.rows.clear();
        self.terms.clear();
        let mut left = available_m;
        for index in 0..self.segments.len() {
            let segment = self.segments[index];
            if segment.welded {
                continue;
            }
            let Some(along) = segment.way.try_normalize(f64::MIN_POSITIVE) else {
                continue;
            };
            left -= along.dot(&(self.unloaded(&segment.ends[1]) - self.unloaded(&segment.ends[0])));
            self.add_terms(&segment, &along);
        }
        self.rows.push(SpreadRow {
            id: 0,
            kind: RowKind::Inequality,
            target_m: left,
            compliance_m_per_n: 0.0,
            terms: (0, self.terms.len() as u32),
        });
        for index in 0..self.segments.len() {
            let segment = self.segments[index];
            self.segments[index].first_row = 0;
            if matches!(segment.ends, [End::Held(_), End::Held(_)]) {
                continue;
            }
            let length = segment.way.norm();
            let (axes, compliance) = if segment.welded {
                ([0, 1, 2].map(|axis| Vector3::ith(axis, 1.0)), 0.0)
            } else if tension > 0.0 && length > 0.0 {
                let along = segment.way / length;
                let aside = Vector3::ith(along.iamin(), 1.0);
                let first = (aside - along * along.dot(&aside)).normalize();
                // The third is along the segment and left out.
                (
                    [first, along.cross(&first), Vector3::zeros()],
                    length / tension,
                )
            } else {
                continue;
            };
            self.segments[index].first_row = self.rows.len();
            let count = if segment.welded { 3 } else { 2 };
            for (axis, direction) in axes.into_iter().take(count).enumerate() {
                let first = self.terms.len() as u32;
                self.add_terms(&segment, &direction);
                let apart = self.unloaded(&segment.ends[1]) - self.unloaded(&segment.ends[0]);
                self.rows.push(SpreadRow {
                    id: 1 + 8 * index as u64 + axis as u64 + if segment.welded { 4 } else { 0 },
                    kind: RowKind::Equality,
                    target_m: -direction.dot(&apart),
                    compliance_m_per_n: compliance,
                    terms: (first, self.terms.len() as u32 - first),
                });
            }
        }
    }

    fn add_terms(&mut self, segment: &Segment, direction: &Vector3<f64>) {
        for (end, sign) in segment.ends.iter().zip([-1.0, 1.0]) {
            if let End::Anchor(anchor) = end {
                self.terms.push(Term {
                    anchor: *anchor as u32,
                    direction: (direction * sign).into(),
                });
            }
        }
    }
}

fn rest(points_m: &[[f64; 3]], node: u32) -> Vector3<f64> {
    points_m
        .get(node as usize)
        .map_or_else(Vector3::zeros, |at| Vector3::from(*at))
}
