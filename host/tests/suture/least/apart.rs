//! Two bodies kept apart by a barrier between nodes and faces, and edges and edges (Li et al. 2020).
//!
//! Entry points: [`Apart::new`], [`Apart::energy`]. A state in which an edge of one goes through a face of the other has infinite energy, so
//! that descents that begin apart stay apart.

use super::{Stamp, Term};
use nalgebra::Vector3;
use std::cell::{Cell, RefCell};
use std::collections::BTreeSet;

/// Force of a pair at half of the distance from which it acts \[N\].
const FORCE_N: f64 = 0.05;
/// What is so near is looked at \[m\], and the list is good until a node has moved by a quarter of that.
const REACH_M: f64 = 2e-3;
/// Edges with less than this sine squared between them are one line, and weaker the nearer they are to that.
const PARALLEL: f64 = 1e-3;

/// The boundary of a body.
struct Shell {
    faces: Vec<[u32; 3]>,
    edges: Vec<[u32; 2]>,
    nodes: Vec<u32>,
}

/// Two bodies.
pub struct Apart {
    shells: [Shell; 2],
    /// Distance from which pairs push each other away now, and in the end \[m\].
    acts_m: Cell<f64>,
    pub narrowest_m: f64,
    near: RefCell<Near>,
}

/// What is near what.
#[derive(Default)]
struct Near {
    at: Vec<Vector3<f64>>,
    /// A node of one body and a face of the other.
    faces: Vec<(u32, [u32; 3])>,
    /// An edge of either body, and how far they are from being parallel, 0 to 1.
    edges: Vec<([u32; 2], [u32; 2], f64)>,
    /// An edge of one body and a face of the other.
    pierced: Vec<([u32; 2], [u32; 3])>,
}

impl Shell {
    fn new(faces: &[[u32; 3]]) -> Self {
        let pairs = faces
            .iter()
            .flat_map(|[a, b, c]| [[*a, *b], [*b, *c], [*c, *a]]);
        // Each edge is in two faces, once in either direction.
        let edges = pairs.filter(|[a, b]| a < b).collect();
        let nodes: BTreeSet<u32> = faces.iter().flatten().copied().collect();
        Self {
            faces: faces.to_vec(),
            edges,
            nodes: nodes.into_iter().collect(),
        }
    }
}

/// The weights of the point of a triangle that is nearest to a point (Ericson 2005, 5.1.5).
fn nearest([a, b, c]: [Vector3<f64>; 3], p: &Vector3<f64>) -> [f64; 3] {
    let (ab, ac) = (b - a, c - a);
    let along = |from: Vector3<f64>| (ab.dot(&(p - from)), ac.dot(&(p - from)));
    let ((d1, d2), (d3, d4), (d5, d6)) = (along(a), along(b), along(c));
    if d1 <= 0.0 && d2 <= 0.0 {
        return [1.0, 0.0, 0.0];
    }
    if d3 >= 0.0 && d4 <= d3 {
        return [0.0, 1.0, 0.0];
    }
    if d6 >= 0.0 && d5 <= d6 {
        return [0.0, 0.0, 1.0];
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        let v = d1 / (d1 - d3);
        return [1.0 - v, v, 0.0];
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        let w = d2 / (d2 - d6);
        return [1.0 - w, 0.0, w];
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
        let w = (d4 - d3) / ((d4 - d3) + (d5 - d6));
        return [0.0, 1.0 - w, w];
    }
    let sum = va + vb + vc;
    [va / sum, vb / sum, vc / sum]
}

/// Where on two edges they are nearest to each other, from 0 to 1 (Ericson 2005, 5.1.9).
fn nearest_of([a, b]: [Vector3<f64>; 2], [c, d]: [Vector3<f64>; 2]) -> [f64; 2] {
    let (one, other, between) = (b - a, d - c, a - c);
    let (aa, ee) = (one.norm_squared(), other.norm_squared());
    let (ac, af, ab) = (one.dot(&between), other.dot(&between), one.dot(&other));
    let across = aa * ee - ab * ab;
    let s = if across > 1e-12 * aa * ee {
        ((ab * af - ac * ee) / across).clamp(0.0, 1.0)
    } else {
        0.5
    };
    let t = (ab * s + af) / ee;
    if t < 0.0 {
        [(-ac / aa).clamp(0.0, 1.0), 0.0]
    } else if t > 1.0 {
        [((ab - ac) / aa).clamp(0.0, 1.0), 1.0]
    } else {
        [s, t]
    }
}

/// Whether an edge goes through a face.
fn pierces([p, q]: [Vector3<f64>; 2], [a, b, c]: [Vector3<f64>; 3]) -> bool {
    let side = |a: &Vector3<f64>, b: &Vector3<f64>, c: &Vector3<f64>, d: &Vector3<f64>| {
        (b - a).cross(&(c - a)).dot(&(d - a)) > 0.0
    };
    if side(&a, &b, &c, &p) == side(&a, &b, &c, &q) {
        return false;
    }
    let first = side(&p, &q, &a, &b);
    first == side(&p, &q, &b, &c) && first == side(&p, &q, &c, &a)
}

pub fn place(terms: &[Term], at: &[Vector3<f64>]) -> Vector3<f64> {
    let each = terms.iter();
    each.map(|(node, weight)| at[*node as usize] * *weight)
        .sum()
}

/// The least and the largest coordinates of some nodes.
type Box3 = (Vector3<f64>, Vector3<f64>);

fn around<const N: usize>(nodes: &[u32; N], at: &[Vector3<f64>]) -> Box3 {
    let first = at[nodes[0] as usize];
    nodes[1..]
        .iter()
        .fold((first, first), |(least, most), node| {
            let at = &at[*node as usize];
            (least.inf(at), most.sup(at))
        })
}

/// Whether boxes are nearer to each other than that.
fn meet(a: &Box3, b: &Box3, reach_m: f64) -> bool {
    (0..3).all(|i| a.0[i] < b.1[i] + reach_m && b.0[i] < a.1[i] + reach_m)
}

impl Apart {
    /// Bodies by their faces, counter-clockwise seen from outside, that are `separation_m` apart where they press.
    pub fn new(faces: [&[[u32; 3]]; 2], separation_m: f64) -> Self {
        Self {
            shells: faces.map(Shell::new),
            acts_m: Cell::new(2.0 * separation_m),
            narrowest_m: 2.0 * separation_m,
            near: RefCell::default(),
        }
    }

    /// From which distance pairs push each other away from now on \[m\].
    pub fn act_from(&self, distance_m: f64) {
        self.acts_m.set(distance_m);
    }

    /// Looks anew what is near what, if nodes have moved.
    pub fn look(&self, at: &[Vector3<f64>]) {
        let mut near = self.near.borrow_mut();
        let moved = near.at.iter().zip(at);
        let moved = moved.fold(0.0f64, |most, (a, b)| most.max((a - b).norm()));
        if near.at.len() == at.len() && moved < 0.25 * REACH_M {
            return;
        }
        *near = Near {
            at: at.to_vec(),
            ..Near::default()
        };
        for of in 0..2 {
            let (own, other) = (&self.shells[of], &self.shells[1 - of]);
            let boxes: Vec<_> = other.faces.iter().map(|face| around(face, at)).collect();
            for node in &own.nodes {
                let here = around(&[*node], at);
                let found = boxes
                    .iter()
                    .zip(&other.faces)
                    .filter(|(other, _)| meet(other, &here, REACH_M));
                near.faces.extend(found.map(|(_, face)| (*node, *face)));
            }
            for edge in &own.edges {
                let here = around(edge, at);
                let found = boxes
                    .iter()
                    .zip(&other.faces)
                    .filter(|(other, _)| meet(other, &here, REACH_M));
                near.pierced.extend(found.map(|(_, face)| (*edge, *face)));
            }
        }
        let [own, other] = &self.shells;
        let boxes: Vec<_> = other.edges.iter().map(|edge| around(edge, at)).collect();
        let along = |[a, b]: &[u32; 2]| (at[*b as usize] - at[*a as usize]).normalize();
        for edge in &own.edges {
            let here = around(edge, at);
            let found = boxes
                .iter()
                .zip(&other.edges)
                .filter(|(other, _)| meet(other, &here, REACH_M));
            for (_, with) in found {
                let across = along(edge).cross(&along(with)).norm_squared();
                let part = (across / PARALLEL).min(1.0);
                if part > 1e-6 {
                    near.edges.push((*edge, *with, part * (2.0 - part)));
                }
            }
        }
    }

    /// Its energy \[J\], infinite if the bodies overlap; slopes and stiffnesses are stamped.
    pub fn energy(&self, at: &[Vector3<f64>], stamp: &mut Option<&mut Stamp>) -> f64 {
        let near = self.near.borrow();
        let of = |node: u32| at[node as usize];
        for (edge, face) in &near.pierced {
            if meet(&around(edge, at), &around(face, at), 0.0)
                && pierces(edge.map(of), face.map(of))
            {
                return f64::INFINITY;
            }
        }
        let mut energy = 0.0;
        let acts_m = self.acts_m.get();
        let mut push = |part: f64, terms: &[Term]| {
            let way = place(terms, at);
            let distance = way.norm();
            if distance >= acts_m {
                return;
            }
            let [own, slope, stiffness] = barrier(distance, acts_m).map(|x| part * x);
            energy += own;
            if let Some(stamp) = stamp {
                let out = way / distance;
                stamp.add(terms, out * slope, out * out.transpose() * stiffness);
            }
        };
        for (node, face) in &near.faces {
            if !meet(&around(face, at), &around(&[*node], at), acts_m) {
                continue;
            }
            let weights = nearest(face.map(of), &of(*node));
            let corner = |i: usize| (face[i], -weights[i]);
            push(1.0, &[(*node, 1.0), corner(0), corner(1), corner(2)]);
        }
        for (one, other, part) in &near.edges {
            if !meet(&around(one, at), &around(other, at), acts_m) {
                continue;
            }
            let [s, t] = nearest_of(one.map(of), other.map(of));
            push(
                *part,
                &[
                    (one[0], 1.0 - s),
                    (one[1], s),
                    (other[0], t - 1.0),
                    (other[1], -t),
                ],
            );
        }
        energy
    }
}

/// Energy, slope and stiffness of -k (d - a)^2 ln(d / a) (Li et al. 2020, 6).
fn barrier(d: f64, a: f64) -> [f64; 3] {
    // So that it is FORCE_N at half of a.
    let k = FORCE_N / ((0.5 + std::f64::consts::LN_2) * a);
    let (short, ln) = (d - a, (d / a).ln());
    [
        -k * short * short * ln,
        -k * (2.0 * short * ln + short * short / d),
        -k * (2.0 * ln + 4.0 * short / d - short * short / (d * d)),
    ]
}
