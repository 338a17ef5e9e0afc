//! Which pairs meet on the way from the last balance to where a solve would have the nodes.
//!
//! Entry point: [`TouchState::look`]. Pairs are taken up in the order in which they meet, at first only those that
//! have no feature in common with an earlier one (younes-2021, 3.3.1): what those rows change may keep the
//! others apart. Where boundaries meet flat, edges cross edges beside every vertex that meets a face, and the
//! latter is enough: of edges only those are taken up at first that have no node of such a pair.

use super::body::Pair;
use super::feature_pair::{faces_each_other, rise_m, stance, stance_along, weighted};
use super::near::Nearby;
use super::pairs::Path;
use super::sweep::{Margin, Verdict};
use super::touch::Touching;
use super::touch_state::{BEYOND, Kept, TouchState, across};
use nalgebra::Vector3;

/// Pairs are held apart at the separation and meet at this part of it: what rows hold up to an error of second
/// order does not come up again for features nearby, which lie in the same planes.
const MEETS: f64 = 0.5;
/// A pair whose direction has turned in a solve so far that this part of the separation is missing is linearised anew.
const TURNED: f64 = 0.8;
/// Room for error when it is decided whether a solve violates a pair, in separations.
const VIOLATED: f64 = 1e-6;
/// Looks of a balance after which everything that meets is taken up at once.
const IN_ORDER: u32 = 4;
/// Cosine below which two directions are not nearly the same.
const ALONG: f64 = 0.9;
/// Looks of a balance in which pairs are linearised anew.
const TURNS: u32 = 6;
/// Pairs found by one look, for each that may be kept.
const FOUND: usize = 8;

/// A pair that meets.
#[derive(Clone, Copy, Debug)]
struct Found {
    time: f64,
    kept: Kept,
    /// How far outside its features it meets.
    outside: f64,
}

/// Scratch, and what saves looking.
#[derive(Clone, Debug)]
pub struct TouchWork {
    pub(super) nearby: Nearby,
    found: Vec<Found>,
    /// Pairs that are kept, sorted.
    kept: Vec<(u32, Pair)>,
    /// Features of pairs taken up in this look.
    taken: Vec<Feature>,
    /// Pairs that met in the newest look and found no room.
    pub(super) without_room: usize,
}

impl TouchWork {
    /// For bodies whose nodes are among the first `nodes`.
    pub fn new(touching: &Touching, nodes: usize) -> Self {
        let most = touching.most_pairs();
        Self {
            nearby: Nearby::new(touching, nodes),
            found: Vec::with_capacity(FOUND * most),
            kept: Vec::with_capacity(most),
            taken: Vec::with_capacity(2 * most),
            without_room: 0,
        }
    }

    /// Whether pairs met in the newest look that found no room: nothing keeps them apart.
    pub fn is_full(&self) -> bool {
        self.without_room > 0
    }
}

impl TouchState {
    /// A solve would have the nodes `at` (n x 3): takes up pairs that meet on a straight way there from the last
    /// balance. Whether any came, so that the rows have to be solved again. Allocates nothing.
    pub fn look(&mut self, touching: &Touching, work: &mut TouchWork, at: &[Vector3<f64>]) -> bool {
        if at.len() != self.at.len() {
            return false;
        }
        self.looks += 1;
        let TouchWork {
            nearby,
            found,
            kept,
            taken,
            without_room,
        } = work;
        *without_room = 0;
        found.clear();
        taken.clear();
        kept.clear();
        kept.extend(self.pairs.iter().map(|kept| (kept.part, kept.pair)));
        kept.sort_unstable();
        let separation_m = touching.separation_m();
        let margin = Margin {
            separation_m: MEETS * separation_m,
            tolerance_m: 0.1 * MEETS * separation_m,
        };
        let path = |node: u32| Path {
            from: self.at[node as usize],
            to: at[node as usize],
        };
        let within_m = margin.separation_m + margin.tolerance_m;
        nearby.visit(touching, path, within_m, |part, pair| {
            if found.len() < found.capacity()
                && kept.binary_search(&(part, pair)).is_err()
                && let Some(new) = meets(touching, part, pair, path, &margin)
            {
                found.push(new);
            }
        });
        let edges = |found: &Found| matches!(found.kept.pair, Pair::EdgeEdge(..));
        found.sort_unstable_by(|a, b| {
            let order = edges(a).cmp(&edges(b)).then(a.time.total_cmp(&b.time));
            order.then_with(|| (a.kept.part, a.kept.pair).cmp(&(b.kept.part, b.kept.pair)))
        });
        let mut any = false;
        for new in found.iter() {
            let said =
                |old: &Kept| says_the_same(old, new, separation_m, |node| self.at[node as usize]);
            if self.pairs.iter().any(said) {
                continue;
            }
            let features = features(&new.kept);
            let clash = |feature: &Feature| match new.kept.pair {
                Pair::EdgeEdge(..) => taken.iter().any(|taken| taken.shares_node(feature)),
                _ => taken.contains(feature),
            };
            if self.looks <= IN_ORDER && features.iter().any(clash) {
                continue;
            }
            if self.pairs.len() >= touching.most_pairs() {
                self.refused += 1;
                *without_room += 1;
                continue;
            }
            taken.extend(features);
            self.pairs.push(Kept {
                serial: self.next_serial,
                ..new.kept
            });
            self.next_serial += 1;
            any = true;
        }
        self.turn(touching, at) || any
    }

    /// Linearises pairs anew where a solve would have the nodes if they came nearer there than they may, for the direction
    /// that keeps them apart has turned; whether any had to be.
    fn turn(&mut self, touching: &Touching, at: &[Vector3<f64>]) -> bool {
        if self.looks > TURNS {
            return false;
        }
        let at = |node: u32| at[node as usize];
        let least_m = TURNED * touching.separation_m();
        let mut any = false;
        for kept in &mut self.pairs {
            let Some(now) = stance_along(&kept.normal, &kept.pair, at) else {
                continue;
            };
            let short_m = kept.hold_m - now.gap_m(&kept.pair.nodes(), at);
            if now.outside > BEYOND || short_m <= least_m {
                continue;
            }
            let more = now.weights.iter().zip(&kept.weights);
            let wandered = more.fold(0.0f64, |most, (new, old)| most.max((new - old).abs()));
            if wandered > touching.settings.wander {
                kept.weights = now.weights;
            }
            kept.normal = now.normal;
            kept.tangent = across(&now.normal, &kept.tangent);
            any = true;
        }
        any
    }
}

/// A vertex, edge or face of one of a part's bodies.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Feature {
    part: u32,
    body: u8,
    /// Its nodes, filled up with the last.
    nodes: [u32; 3],
}

impl Feature {
    fn shares_node(&self, other: &Self) -> bool {
        let shared = |node: &u32| other.nodes.contains(node);
        self.part == other.part && self.body == other.body && self.nodes.iter().any(shared)
    }
}

/// The two features of a pair.
fn features(kept: &Kept) -> [Feature; 2] {
    let [first, second] = match kept.pair {
        Pair::VertexFace(vertex, face) => [[vertex; 3], face],
        Pair::FaceVertex(face, vertex) => [face, [vertex; 3]],
        Pair::EdgeEdge([a, b], [c, d]) => [[a, b, b], [c, d, d]],
    };
    let part = kept.part;
    let feature = |body, nodes| Feature { part, body, nodes };
    [feature(0, first), feature(1, second)]
}

/// Whether a pair that is kept holds what a new one would: the same points along nearly the same direction, or one
/// vertex at two faces that share nodes while it is not over the new one, unless that rises
/// by more than `valley_m`: in a valley both hold it.
fn says_the_same(old: &Kept, new: &Found, valley_m: f64, at: impl Fn(u32) -> Vector3<f64>) -> bool {
    if old.part != new.kept.part || new.outside < -BEYOND {
        return false;
    }
    let shared = |a: &[u32; 3], b: &[u32; 3]| a.iter().any(|node| b.contains(node));
    match (&old.pair, &new.kept.pair) {
        (Pair::VertexFace(v, face), Pair::VertexFace(w, other))
        | (Pair::FaceVertex(face, v), Pair::FaceVertex(other, w)) => {
            v == w && shared(face, other) && rise_m(face, other, at) <= valley_m
        }
        _ => {
            let new = &new.kept;
            // A vertex and a face of the other body look at each other the other way round.
            let cosine = old.normal.dot(&new.normal);
            let side = cosine.signum();
            let apart = apart(old, new, side) + apart(new, old, side);
            cosine.abs() > ALONG && apart < 8.0 * BEYOND
        }
    }
}

/// How much of the first pair's points is not the second's, by weights, those times `side`.
fn apart(one: &Kept, other: &Kept, side: f64) -> f64 {
    let (nodes, others) = (one.pair.nodes(), other.pair.nodes());
    let own = nodes.iter().zip(&one.weights);
    own.map(|(node, weight)| {
        let same = others.iter().zip(&other.weights);
        let share = same.filter(|(other, _)| *other == node);
        (weight - side * share.map(|(_, weight)| weight).sum::<f64>()).abs()
    })
    .sum()
}

/// A pair that meets on the way and that a row would have to keep apart.
fn meets(
    touching: &Touching,
    part: u32,
    pair: Pair,
    path: impl Fn(u32) -> Path,
    margin: &Margin,
) -> Option<Found> {
    let Verdict::Meet(impact) = pair.sweep(&path, margin).verdict else {
        return None;
    };
    let then = |node: u32| {
        let Path { from, to } = path(node);
        from + (to - from) * impact.time
    };
    let shells = touching.parts[part as usize].shells();
    let nodes = pair.nodes();
    let stance = stance(shells, &pair, then)?;
    if stance.outside > 0.0 {
        // Beside each other, a row along the normal would not say what keeps them apart.
        let apart = weighted(&nodes, &impact.weights, then);
        if stance.outside > 4.0 * BEYOND || apart.dot(&stance.normal) < 0.5 * apart.norm() {
            return None;
        }
    }
    let before = stance.gap_m(&nodes, |node| path(node).from);
    let after = stance.gap_m(&nodes, |node| path(node).to);
    let separation_m = touching.separation_m();
    let hold_m = before.min(separation_m);
    // On its way out, or from inside, it is not kept.
    if after >= hold_m - VIOLATED * separation_m
        || !faces_each_other(shells, &pair, &stance.normal, then)
    {
        return None;
    }
    Some(Found {
        time: impact.time,
        kept: Kept {
            serial: 0,
            part,
            pair,
            weights: stance.weights,
            normal: stance.normal,
            tangent: across(&stance.normal, &Vector3::x()),
            hold_m,
            force_n: 0.0,
        },
        outside: stance.outside,
    })
}
