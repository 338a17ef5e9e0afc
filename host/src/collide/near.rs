//! Pairs of features that are near each other, kept while nothing moves far.
//!
//! Entry point: [`Nearby::visit`]. A pair that was apart by d cannot meet before its features have moved by d
//! together, so that a list serves as long as they have not (Verlet 1967). What is
//! visited may be more than what meets, never less, and does not depend on when the list was made.

use super::body::{Body, Pair};
use super::pairs::Path;
use super::patch::closest;
use super::sweep::Margin;
use super::touch::Touching;
use nalgebra::Vector3;

/// Places in the list for each pair of features that may be kept.
const LISTED: usize = 64;
/// What rounding may hide of a distance, as a part of it and of the places' magnitude.
const ROUNDING: f64 = 1e-12;

#[derive(Clone, Copy, Debug)]
struct Listed {
    /// No farther apart than they were \[m\].
    distance_m: f64,
    part: u32,
    pair: Pair,
    /// Unit vector from the second to the first where they are nearest, (3); zero if they touch.
    direction: Vector3<f64>,
}

impl Listed {
    /// Whether all of one stays ahead of all of the other by more than `within_m` along the direction: a plane between them
    /// that most pairs do not even come near.
    fn stays_ahead(&self, path: &impl Fn(u32) -> Path, within_m: f64) -> bool {
        let along = self.pair.nodes().map(|node| {
            let Path { from, to } = path(node);
            [self.direction.dot(&from), self.direction.dot(&to)]
        });
        let [a, b, c, d] = along;
        let hidden = 8.0 * f64::EPSILON * along.iter().flatten().map(|x| x.abs()).sum::<f64>();
        (0..2).all(|time| {
            let [a, b, c, d] = [a, b, c, d].map(|along| along[time]);
            let ahead = match self.pair {
                Pair::EdgeEdge(..) => a.min(b) - c.max(d),
                _ => a - b.max(c).max(d),
            };
            ahead > within_m * (1.0 + 1e-9) + hidden
        })
    }
}

/// The list and trees.
#[derive(Clone, Debug)]
pub(super) struct Nearby {
    /// Two bodies of each part, or one.
    bodies: Vec<Vec<Body>>,
    listed: Vec<Listed>,
    /// Where nodes were when the list was made \[m\], (n).
    listed_at: Vec<Vector3<f64>>,
    /// Pairs that were no farther apart than this are all listed \[m\]; below 0 if there is no list.
    reach_m: f64,
    /// How far each node is from there at most, on its way \[m\], (n).
    moved_m: Vec<f64>,
}

impl Nearby {
    pub fn new(touching: &Touching, nodes: usize) -> Self {
        let still = |_| Path {
            from: Vector3::zeros(),
            to: Vector3::zeros(),
        };
        let bodies = touching.parts.iter().map(|part| {
            let shells = part.shells();
            let count = if part.is_one() { 1 } else { 2 };
            let bodies = shells[..count].iter();
            bodies
                .map(|shell| Body::new(shell.faces(), still, &margin(0.0)))
                .collect()
        });
        Self {
            bodies: bodies.collect(),
            listed: Vec::with_capacity(LISTED * touching.settings.most_pairs),
            listed_at: vec![Vector3::zeros(); nodes],
            reach_m: -1.0,
            moved_m: vec![0.0; nodes],
        }
    }

    /// Visits every pair that may come within `within_m` while nodes move as `path` says.
    pub fn visit(
        &mut self,
        touching: &Touching,
        path: impl Fn(u32) -> Path,
        within_m: f64,
        mut visit: impl FnMut(u32, Pair),
    ) {
        let mut most = self.follow(touching, &path);
        // Nothing can be said of what may be anywhere.
        if !most.is_finite() {
            return;
        }
        let reach_m = touching.settings.guard * touching.mean_edge_m();
        // A list made anew helps where they do not move farther than it would reach.
        let helps = || 2.0 * farthest_m(touching, &path) + within_m <= reach_m;
        if 2.0 * most + within_m > self.reach_m && helps() {
            self.list(touching, |node| path(node).from, reach_m);
            most = self.follow(touching, &path);
        }
        if 2.0 * most + within_m > self.reach_m {
            // All that meets on the way, this once.
            self.meeting(touching, path, within_m, visit);
            return;
        }
        for listed in &self.listed {
            if listed.distance_m > 2.0 * most + within_m {
                continue;
            }
            let moved = |node: u32| self.moved_m[node as usize];
            let [a, b, c, d] = listed.pair.nodes().map(moved);
            let moved_m = match listed.pair {
                Pair::EdgeEdge(..) => a.max(b) + c.max(d),
                _ => a + b.max(c).max(d),
            };
            if listed.distance_m <= moved_m + within_m && !listed.stays_ahead(&path, within_m) {
                visit(listed.part, listed.pair);
            }
        }
    }

    /// How far each node gets from where it was listed; the farthest.
    fn follow(&mut self, touching: &Touching, path: &impl Fn(u32) -> Path) -> f64 {
        let mut most = 0.0f64;
        for &node in &touching.nodes {
            let (Path { from, to }, was) = (path(node), self.listed_at[node as usize]);
            let square = (from - was).norm_squared().max((to - was).norm_squared());
            // What is not a number may be anywhere.
            let moved = if square.is_nan() {
                f64::INFINITY
            } else {
                square.sqrt()
            };
            self.moved_m[node as usize] = moved;
            most = most.max(moved);
        }
        most
    }

    /// Visits pairs whose swept boxes are near.
    fn meeting(
        &mut self,
        touching: &Touching,
        path: impl Fn(u32) -> Path,
        within_m: f64,
        mut visit: impl FnMut(u32, Pair),
    ) {
        for ((part, bodies), index) in touching.parts.iter().zip(&mut self.bodies).zip(0..) {
            for body in bodies.iter_mut() {
                body.sweep(&path, &margin(within_m));
            }
            if part.is_one() {
                bodies[0].with_itself(&path, |pair| visit(index, pair));
            } else {
                bodies[0].against(&bodies[1], &path, |pair| visit(index, pair));
            }
        }
    }

    /// Lists pairs that are no farther apart than `reach_m` where the nodes are.
    fn list(&mut self, touching: &Touching, at: impl Fn(u32) -> Vector3<f64>, reach_m: f64) {
        let mut listed = std::mem::take(&mut self.listed);
        listed.clear();
        let mut all = true;
        let path = |node: u32| Path {
            from: at(node),
            to: at(node),
        };
        self.meeting(touching, path, reach_m, |part, pair| {
            let (distance_m, direction) = nearest(&pair, &at);
            if distance_m > reach_m {
                return;
            }
            all &= listed.len() < listed.capacity();
            if all {
                listed.push(Listed {
                    distance_m,
                    part,
                    pair,
                    direction,
                });
            }
        });
        self.listed = listed;
        for &node in &touching.nodes {
            self.listed_at[node as usize] = at(node);
        }
        self.reach_m = if all { reach_m } else { -1.0 };
    }

    /// How far apart all features that may meet are for certain \[m\], as far as lists reach for a body with
    /// itself.
    pub fn clear_m(&mut self, touching: &Touching, at: &[Vector3<f64>]) -> f64 {
        let path = |node: u32| Path {
            from: at[node as usize],
            to: at[node as usize],
        };
        let mut clear = f64::INFINITY;
        let reach_m = touching.settings.guard * touching.mean_edge_m();
        for (part, bodies) in touching.parts.iter().zip(&mut self.bodies) {
            if part.is_one() {
                clear = clear.min(reach_m);
                bodies[0].sweep(path, &margin(reach_m));
                bodies[0].with_itself(path, |pair| {
                    clear = clear.min(nearest(&pair, |node| at[node as usize]).0);
                });
            } else {
                for body in bodies.iter_mut() {
                    body.sweep(path, &margin(0.0));
                }
                clear = clear.min(bodies[0].apart_m(&bodies[1]));
            }
        }
        clear
    }
}

/// How far a node moves at most \[m\].
fn farthest_m(touching: &Touching, path: &impl Fn(u32) -> Path) -> f64 {
    let ways = touching.nodes.iter().map(|node| {
        let Path { from, to } = path(*node);
        (to - from).norm_squared()
    });
    ways.fold(0.0, f64::max).sqrt()
}

fn margin(separation_m: f64) -> Margin {
    Margin {
        separation_m,
        tolerance_m: 0.0,
    }
}

/// How far apart two features are for certain \[m\], and in which direction.
fn nearest(pair: &Pair, at: impl Fn(u32) -> Vector3<f64>) -> (f64, Vector3<f64>) {
    let [a, b, c, d] = pair.nodes().map(at);
    let (point, normal) = match pair {
        Pair::EdgeEdge(..) => {
            let closest = closest(&[a - c, b - c, b - d, a - d]);
            (closest.point, closest.normal)
        }
        _ => {
            let closest = closest(&[a - b, a - c, a - d]);
            (closest.point, closest.normal)
        }
    };
    let length = point.norm();
    let hidden = ROUNDING * (a.amax() + b.amax() + c.amax() + d.amax());
    let distance = (length * (1.0 - ROUNDING) - hidden).max(0.0);
    // The normal is the more exact one where they nearly touch.
    let normal = normal.map_or(point, |normal| normal * normal.dot(&point).signum());
    let direction = normal.try_normalize(0.0).unwrap_or_default();
    (if distance.is_nan() { 0.0 } else { distance }, direction)
}
