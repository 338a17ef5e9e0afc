//! Vertex against face, edge against edge: the two ways in which triangles that move come to meet.
//!
//! Entry points: [`vertex_face`], [`edge_edge`]. Each is a patch of differences that passes the origin; a
//! difference of positions is rounded once, so that it does not matter how far from the world's origin
//! the tissue lies.

use super::patch::Patch;
use super::sweep::{Found, Impact, Margin, Pass, Sweep, Verdict, first_pass};
use nalgebra::Vector3;

/// A node that moves on a straight line at constant speed, from time 0 to time 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Path {
    /// Position at time 0 \[m\], (3).
    pub from: Vector3<f64>,
    /// Position at time 1 \[m\], (3).
    pub to: Vector3<f64>,
}

/// Whether a vertex meets a triangle, and when first. Either may be degenerate or at rest. Pure; allocates
/// nothing.
pub fn vertex_face(vertex: &Path, face: [&Path; 3], margin: &Margin) -> Sweep {
    let whole = Patch::new(
        face.map(|corner| vertex.from - corner.from),
        face.map(|corner| vertex.to - corner.to),
    );
    answer(first_pass(whole, margin), |[u, v]| {
        [1.0, u + v - 1.0, -u, -v]
    })
}

/// Whether two edges meet, and when first. Either may be degenerate or at rest. Pure; allocates nothing.
pub fn edge_edge(first: [&Path; 2], second: [&Path; 2], margin: &Margin) -> Sweep {
    let ([a, b], [c, d]) = (first, second);
    let pairs = [(a, c), (b, c), (b, d), (a, d)];
    let whole = Patch::new(
        pairs.map(|(one, other)| one.from - other.from),
        pairs.map(|(one, other)| one.to - other.to),
    );
    answer(first_pass(whole, margin), |[u, v]| {
        [1.0 - u, u, v - 1.0, -v]
    })
}

fn answer((found, parts): (Found, u32), weights: impl Fn([f64; 2]) -> [f64; 4]) -> Sweep {
    let verdict = match found {
        Found::Nothing => Verdict::Apart,
        Found::NotFinite => Verdict::NotFinite,
        Found::Pass(Pass {
            time,
            place,
            given_up,
        }) => Verdict::Meet(Impact {
            time,
            weights: weights(place),
            given_up,
        }),
    };
    Sweep { verdict, parts }
}
