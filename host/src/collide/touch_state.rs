//! Pairs of features that are kept apart: what evolves, and the rows that it makes.
//!
//! Entry points: [`TouchState::rows`] before a solve, [`TouchState::look`] after it, until it brings nothing new, and
//! [`TouchState::accept`] once the balance is found. A pair is held by non-penetration that is linearised where
//! the nodes were at the last balance (younes-2021, 2.2.6 and 2.73); what that leaves is of second order in
//! a step and is made good by the next. Pairs are inequalities, so that none ever pulls.

use super::body::Pair;
use super::feature_pair::{FeaturePair, rise_m, stance, weighted};
use super::look::TouchWork;
use super::touch::Touching;
use crate::anchors::{AnchorPoint, PointConstraint};
use crate::rows::RowKind;
use nalgebra::Vector3;
use serde::Serialize;

/// Bit of a row's id that no other rows have.
const ID: u64 = 1 << 40;
/// How far outside its face or edge a point of contact may be and still be held there, in barycentric
/// coordinates: as much as a separation is of an edge, twice.
pub(super) const BEYOND: f64 = 0.01;
/// How far beyond its face a vertex that presses on it may be in a valley, and still be held by that face beside the next one.
const VALLEY: f64 = 0.25;
/// Faces over which a point of contact may wander in one step.
const WANDERED: usize = 8;

/// A pair that is kept apart.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) struct Kept {
    /// Names it from step to step.
    pub serial: u64,
    pub part: u32,
    pub pair: Pair,
    /// With these the nodes' positions add up to the difference between the two points, (4).
    pub weights: [f64; 4],
    /// Unit vector along which the first must stay ahead of the second, (3).
    pub normal: Vector3<f64>,
    /// Unit vector across the normal, (3).
    pub tangent: Vector3<f64>,
    /// By how much it must stay ahead \[m\].
    pub hold_m: f64,
    /// Force at the last balance \[N\].
    pub force_n: f64,
}

impl Kept {
    /// Distance along the normal \[m\].
    fn gap_m(&self, at: impl Fn(u32) -> Vector3<f64>) -> f64 {
        self.normal
            .dot(&weighted(&self.pair.nodes(), &self.weights, at))
    }
}

/// Unit vector across `normal` that is as near as possible to `along`.
pub(crate) fn across(normal: &Vector3<f64>, along: &Vector3<f64>) -> Vector3<f64> {
    let flat = along - normal * normal.dot(along);
    flat.try_normalize(0.1).unwrap_or_else(|| {
        let axis = Vector3::ith(normal.iamin(), 1.0);
        (axis - normal * normal.dot(&axis)).normalize()
    })
}

/// What evolves in bodies that may touch.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TouchState {
    /// In the order in which they came.
    pub(super) pairs: Vec<Kept>,
    /// Where nodes were at the last balance \[m\], (n).
    pub(super) at: Vec<Vector3<f64>>,
    /// How far apart everything was then for certain \[m\].
    pub(super) clear_m: f64,
    /// Where nodes were when that was found from all of them \[m\], (n), and what was found; below 0 if nothing was.
    cleared_at: Vec<Vector3<f64>>,
    cleared_m: f64,
    pub(super) next_serial: u64,
    /// Looks since the last balance.
    pub(super) looks: u32,
    /// Pairs that met while there was no room for them.
    pub(super) refused: u64,
}

impl TouchState {
    /// Nothing is kept yet; nodes are `at` \[m\], (n x 3), as many as [`Touching::new`] was given.
    pub fn new(touching: &Touching, at: &[Vector3<f64>]) -> Self {
        Self {
            pairs: Vec::with_capacity(touching.most_pairs()),
            at: at.to_vec(),
            // Not known before the first balance.
            clear_m: 0.0,
            cleared_at: at.to_vec(),
            cleared_m: -1.0,
            next_serial: 0,
            looks: 0,
            refused: 0,
        }
    }

    /// As a copy of `other`, without new memory.
    pub fn copy_from(&mut self, other: &Self) {
        self.pairs.clone_from(&other.pairs);
        self.at.clone_from(&other.at);
        self.clear_m = other.clear_m;
        self.cleared_at.clone_from(&other.cleared_at);
        self.cleared_m = other.cleared_m;
        self.next_serial = other.next_serial;
        self.looks = other.looks;
        self.refused = other.refused;
    }

    /// Pairs that are kept apart.
    pub fn pairs(&self) -> usize {
        self.pairs.len()
    }

    /// Where nodes were at the last balance \[m\], (n x 3).
    pub fn at_m(&self) -> &[Vector3<f64>] {
        &self.at
    }

    /// Pairs that pressed at the last balance.
    pub fn pressing(&self) -> usize {
        let pressing = self.pairs.iter().filter(|pair| pair.force_n > 0.0);
        pressing.count()
    }

    /// Pairs that met since the beginning while [`Touching::most_pairs`] were kept already.
    pub fn refused(&self) -> u64 {
        self.refused
    }

    /// How far nodes that may meet were at the last [`Self::accept`] from the places `from` (n) \[m\].
    pub fn strayed_m(&self, touching: &Touching, from: &[Vector3<f64>]) -> f64 {
        let ways = touching.nodes().iter().filter_map(|&node| {
            let (at, from) = (self.at.get(node as usize)?, from.get(node as usize)?);
            Some((at - from).norm_squared())
        });
        ways.fold(0.0, f64::max).sqrt()
    }

    /// Whether nothing can meet as long as no node is farther than `moved_m` from where it was at the last
    /// [`Self::accept`]: then nobody has to know where the nodes are.
    pub fn is_clear(&self, moved_m: f64) -> bool {
        self.pairs.is_empty() && 2.0 * moved_m < self.clear_m
    }

    /// Appends the anchors and rows of the pairs that are kept: of each one row, or with friction three.
    /// `points_m` (n x 3) are the unloaded nodes. Weights of an anchor add up to 0. Allocates nothing if there is
    /// room.
    pub fn rows(
        &self,
        touching: &Touching,
        points_m: &[[f64; 3]],
        anchors: &mut Vec<AnchorPoint>,
        rows: &mut Vec<PointConstraint>,
    ) {
        let unloaded = |node: u32| Vector3::from(points_m[node as usize]);
        for kept in &self.pairs {
            let anchor = anchors.len() as u32;
            let nodes = kept.pair.nodes();
            anchors.push(AnchorPoint {
                nodes,
                weights: kept.weights,
            });
            let rest = weighted(&nodes, &kept.weights, unloaded);
            let mut add = |axis: u64, kind, direction: Vector3<f64>, target_m| {
                rows.push(PointConstraint {
                    id: ID | kept.serial << 2 | axis,
                    anchor,
                    kind,
                    direction: direction.into(),
                    target_m,
                });
            };
            let friction = touching.parts[kept.part as usize].friction;
            let kind = if friction > 0.0 {
                RowKind::Normal { friction }
            } else {
                RowKind::Inequality
            };
            add(0, kind, -kept.normal, kept.normal.dot(&rest) - kept.hold_m);
            if friction > 0.0 {
                // It sticks where it was at the last balance.
                let slid = weighted(&nodes, &kept.weights, |node| self.at[node as usize]) - rest;
                let across = kept.normal.cross(&kept.tangent);
                add(1, RowKind::Tangent, kept.tangent, kept.tangent.dot(&slid));
                add(2, RowKind::Tangent, across, across.dot(&slid));
            }
        }
    }

    /// A balance has been found, with nodes at `at` (n x 3) and forces `lambda` \[N\] of the rows of
    /// [`Self::rows`], in their order. Pairs that do not press and have drifted apart are let go of, and so are
    /// those that have slid off each other; normals, points of contact and distances are made anew.
    /// Allocates nothing.
    pub fn accept(
        &mut self,
        touching: &Touching,
        work: &mut TouchWork,
        at: &[Vector3<f64>],
        lambda: &[f64],
    ) {
        if at.len() != self.at.len() {
            return;
        }
        self.at.copy_from_slice(at);
        self.looks = 0;
        let mut row = 0;
        for kept in &mut self.pairs {
            kept.force_n = lambda.get(row).copied().unwrap_or_default();
            let rough = touching.parts[kept.part as usize].friction > 0.0;
            row += if rough { 3 } else { 1 };
        }
        let mut place = 0;
        while place < self.pairs.len() {
            let renewed = renewed(touching, &self.pairs[place], at);
            // One that has wandered onto a face may find itself there.
            let renewed = renewed.filter(|new| {
                let same = |other: &Kept| other.part == new.part && other.pair == new.pair;
                new.pair == self.pairs[place].pair || !self.pairs.iter().any(same)
            });
            match renewed {
                Some(renewed) => {
                    self.pairs[place] = renewed;
                    place += 1;
                }
                None => {
                    self.pairs.remove(place);
                }
            }
        }
        self.clear(touching, work);
    }

    /// How far apart everything is for certain: what it was, less what nodes have moved since, as long as that
    /// is worth something.
    fn clear(&mut self, touching: &Touching, work: &mut TouchWork) {
        if !self.pairs.is_empty() {
            (self.cleared_m, self.clear_m) = (-1.0, 0.0);
            return;
        }
        let moved = touching.nodes().iter().fold(0.0f64, |most, &node| {
            let way = self.at[node as usize] - self.cleared_at[node as usize];
            most.max(way.norm_squared())
        });
        let moved_m = moved.sqrt();
        let near_m = touching.settings.guard * touching.mean_edge_m();
        if self.cleared_m < 0.0 || moved_m > (0.25 * self.cleared_m).max(0.05 * near_m) {
            let clear_m = work.nearby.clear_m(touching, &self.at) - touching.separation_m();
            self.cleared_m = clear_m.max(0.0);
            self.cleared_at.copy_from_slice(&self.at);
            self.clear_m = self.cleared_m;
        } else {
            self.clear_m = self.cleared_m - 2.0 * moved_m;
        }
    }
}

/// A pair where the nodes are now; nothing if it is to be let go of.
fn renewed(touching: &Touching, kept: &Kept, at: &[Vector3<f64>]) -> Option<Kept> {
    let at = |node: u32| at[node as usize];
    let (pair, stance) = wandered(touching, kept, at)?;
    let mut new = Kept {
        pair,
        normal: stance.normal,
        tangent: across(&stance.normal, &kept.tangent),
        ..*kept
    };
    let moved = new.weights.iter().zip(&stance.weights);
    let moved = moved.fold(0.0f64, |most, (old, new)| most.max((old - new).abs()));
    if pair != kept.pair || moved > touching.settings.wander {
        new.weights = stance.weights;
    }
    let gap_m = new.gap_m(at);
    let edge_m = touching.mean_edge_m();
    if new.force_n <= 0.0 && gap_m > touching.settings.release * edge_m {
        return None;
    }
    // What was taken up too near stays as near until it opens by itself.
    new.hold_m = new.hold_m.max(gap_m.min(touching.separation_m()));
    Some(new)
}

/// Where a pair stands now, and on which face if it has slid onto another; nothing if it has slid off.
fn wandered(
    touching: &Touching,
    kept: &Kept,
    at: impl Fn(u32) -> Vector3<f64>,
) -> Option<(Pair, FeaturePair)> {
    let shells = touching.parts[kept.part as usize].shells();
    let mut pair = kept.pair;
    for _ in 0..WANDERED {
        let stance = stance(shells, &pair, &at)?;
        if stance.outside <= BEYOND {
            return Some((pair, stance));
        }
        // Across the side that it is farthest beyond.
        let corner = (1..3).fold(0, |most, corner| {
            if stance.weights[corner + 1] > stance.weights[most + 1] {
                corner
            } else {
                most
            }
        });
        let (vertex, face, next) = match pair {
            Pair::VertexFace(vertex, face) => (vertex, face, shells[1].across(&face, corner)?),
            Pair::FaceVertex(face, vertex) => (vertex, face, shells[0].across(&face, corner)?),
            Pair::EdgeEdge(..) => return None,
        };
        let presses = kept.force_n > 0.0 && pair == kept.pair;
        if presses
            && stance.outside <= VALLEY
            && rise_m(&face, &next, &at) > touching.separation_m()
        {
            return Some((pair, stance));
        }
        pair = match pair {
            Pair::VertexFace(..) => Pair::VertexFace(vertex, next),
            _ => Pair::FaceVertex(next, vertex),
        };
        // Itself, of a body that folds.
        let [vertex, a, b, c] = pair.nodes();
        if [a, b, c].contains(&vertex) {
            return None;
        }
    }
    None
}
