//! Handles as rows: points of tissue that are held at a place, beside needles, threads and tissue that touches.
//!
//! Entry points: [`Handles::new`], [`Handles::append`]. The forces with which the handles hold the tissue when nothing
//! else acts are loads; rows find what comes on top of them (younes-2021, 2.2.2), which is nothing in the
//! beginning.

use super::{Room, Source};
use crate::anchors::{AnchorPoint, ConstraintSet, ConstraintState, PointConstraint};
use crate::fem::{Anchor, Handle, NodeLoad};
use crate::rows::RowKind;
use crate::step::{Balance, Sources};
use nalgebra::Vector3;

/// Bit of a row's id that no other rows have.
const ID: u64 = 1 << 52;
/// Most nodes of a handle's point: those of a cell.
pub(crate) const MOST_NODES: usize = 4;

/// A point of tissue that is held.
#[derive(Clone, Copy, Debug)]
struct Held {
    point: AnchorPoint,
    /// Its displacement from the unloaded mesh \[m\], (3).
    target_m: Vector3<f64>,
    /// Force on the tissue when nothing else acts \[N\], (3).
    resting_n: Vector3<f64>,
}

impl Held {
    /// From where tissue displaced by `resting` \[m\], (n x 3), has its point, to the target \[m\].
    fn way_m(&self, resting: &[[f64; 3]]) -> Vector3<f64> {
        let parts = self.point.nodes.iter().zip(self.point.weights);
        let at = parts.filter_map(|(node, weight)| {
            Some(Vector3::from(*resting.get(*node as usize)?) * weight)
        });
        self.target_m - at.sum::<Vector3<f64>>()
    }
}

/// Handles beside what else acts by rows.
pub(super) struct HandleSource;

impl Source for HandleSource {
    fn room(&self, sources: &Sources) -> Room {
        let count = sources.handles.count();
        Room::new(count, 3 * count)
    }

    fn append(&self, balance: &mut Balance) {
        balance.sources.handles.append(&mut balance.work.set);
    }
}

/// Points of tissue that are held; what is constant about them.
#[derive(Clone, Debug, Default)]
pub(crate) struct Handles(Vec<Held>);

impl Handles {
    /// The handles of a scene, which hold the tissue with the forces `resting_n` (h x 3) \[N\] when nothing else acts.
    ///
    /// # Errors
    /// The place of the first one on more than [`MOST_NODES`] nodes.
    pub fn new(handles: &[Handle], resting_n: &[[f64; 3]]) -> Result<Self, usize> {
        let known = resting_n.iter().map(|force| Vector3::from(*force));
        let forces = known.chain(std::iter::repeat(Vector3::zeros()));
        let held = handles.iter().zip(forces).enumerate();
        let each = held.map(|(place, (handle, resting_n))| {
            Ok(Held {
                point: point(&handle.anchor).ok_or(place)?,
                target_m: handle.target_displacement_m.into(),
                resting_n,
            })
        });
        each.collect::<Result<_, _>>().map(Self)
    }

    /// How many there are: each has an anchor and three rows.
    pub fn count(&self) -> usize {
        self.0.len()
    }

    /// Forces on nodes when nothing else acts \[N\].
    pub fn loads(&self) -> impl Iterator<Item = NodeLoad> + '_ {
        let nodes = |held: &Held| {
            let Held {
                point, resting_n, ..
            } = *held;
            let parts = point.nodes.into_iter().zip(point.weights);
            let acting = parts.filter(|(_, weight)| *weight != 0.0);
            acting.map(move |(node, weight)| NodeLoad {
                node,
                force_n: (resting_n * weight).into(),
            })
        };
        self.0.iter().flat_map(nodes)
    }

    /// The handles when so much of their way has been gone and so much of the loads acts \[1\].
    pub fn at_share(&self, share: f64) -> Self {
        let scaled = |held: &Held| Held {
            point: held.point,
            target_m: held.target_m * share,
            resting_n: held.resting_n * share,
        };
        Self(self.0.iter().map(scaled).collect())
    }

    /// The handles when they have gone so much of the way \[1\] from where tissue displaced by `resting` \[m\], (n x 3), has
    /// their points, to their targets.
    pub fn part_way(&self, resting: &[[f64; 3]], share: f64) -> Self {
        let moved = |held: &Held| Held {
            target_m: held.target_m - held.way_m(resting) * (1.0 - share),
            ..*held
        };
        Self(self.0.iter().map(moved).collect())
    }

    /// Farthest of these ways \[m\].
    pub fn way_m(&self, resting: &[[f64; 3]]) -> f64 {
        let ways = self.0.iter().map(|held| held.way_m(resting).norm());
        ways.fold(0.0, f64::max)
    }

    /// Appends an anchor and three rows for each. Allocates nothing if there is room.
    fn append(&self, set: &mut ConstraintSet) {
        for (place, held) in (0u64..).zip(&self.0) {
            let anchor = set.add(held.point);
            for axis in 0..3 {
                set.rows.push(PointConstraint {
                    id: ID | place << 2 | axis as u64,
                    anchor,
                    kind: RowKind::Equality,
                    direction: Vector3::ith(axis, 1.0).into(),
                    target_m: held.target_m[axis],
                });
            }
        }
    }

    /// Force of each on the tissue after the last solve \[N\], (h x 3): for reports.
    pub fn forces_n(&self, grasp: &ConstraintState) -> Vec<[f64; 3]> {
        let mut forces: Vec<_> = self.0.iter().map(|held| held.resting_n).collect();
        for (row, lambda) in grasp.acting().iter().zip(grasp.lambda()) {
            if row.id & ID == 0 {
                continue;
            }
            let place = ((row.id ^ ID) >> 2) as usize;
            if let Some(force) = forces.get_mut(place) {
                *force -= Vector3::from(row.direction) * *lambda;
            }
        }
        forces.into_iter().map(Into::into).collect()
    }
}

/// The point of an anchor with at most [`MOST_NODES`] nodes.
fn point(anchor: &Anchor) -> Option<AnchorPoint> {
    let first = *anchor.vertices.first()?;
    if anchor.vertices.len() > MOST_NODES {
        return None;
    }
    let mut point = AnchorPoint {
        nodes: [first; MOST_NODES],
        weights: [0.0; MOST_NODES],
    };
    let given = anchor.vertices.iter().zip(&anchor.weights);
    for ((node, weight), given) in point.nodes.iter_mut().zip(&mut point.weights).zip(given) {
        (*node, *weight) = (*given.0, *given.1);
    }
    Some(point)
}
