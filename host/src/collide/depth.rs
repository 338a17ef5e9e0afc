//! By how much two bodies overlap, and how far apart they are: for reports, not for steps.
//!
//! Entry points: [`penetration_m`], [`gaps_m`]. What is inside is said by solid angles (van Oosterom & Strackee
//! 1983); both allocate.

use super::patch::closest;
use super::shell::Shell;
use crate::boxes::{Bounds, Tree};
use nalgebra::Vector3;
use std::f64::consts::PI;

/// Points at which a part of an edge that lies inside is looked at.
const SAMPLES: u32 = 16;

/// The boundary of a body where its nodes are.
struct Hull<'a> {
    faces: &'a [[u32; 3]],
    at: &'a [Vector3<f64>],
    tree: Tree,
}

impl<'a> Hull<'a> {
    fn new(faces: &'a [[u32; 3]], at: &'a [Vector3<f64>]) -> Self {
        let around = |face: u32| {
            let nodes = faces[face as usize].iter();
            nodes.fold(Bounds::NOTHING, |all, node| all.with(&at[*node as usize]))
        };
        Self {
            faces,
            at,
            tree: Tree::new(faces.len() as u32, around),
        }
    }

    fn corners(&self, face: usize) -> [Vector3<f64>; 3] {
        self.faces[face].map(|node| self.at[node as usize])
    }

    /// Whether a point lies inside: the solid angles of the faces add up to 4 pi there and to 0 outside.
    fn contains(&self, point: &Vector3<f64>) -> bool {
        if !self.tree.bounds().meets(&Bounds::NOTHING.with(point)) {
            return false;
        }
        let half_angles = (0..self.faces.len()).map(|face| {
            let [a, b, c] = self.corners(face).map(|corner| corner - point);
            let (la, lb, lc) = (a.norm(), b.norm(), c.norm());
            let spread = la * lb * lc + a.dot(&b) * lc + b.dot(&c) * la + c.dot(&a) * lb;
            a.dot(&b.cross(&c)).atan2(spread)
        });
        half_angles.sum::<f64>() > PI
    }

    /// Distance from a point to the nearest face.
    fn distance_m(&self, point: &Vector3<f64>) -> f64 {
        let faces = (0..self.faces.len()).map(|face| {
            let corners = self.corners(face).map(|corner| corner - point);
            closest(&corners).point.norm()
        });
        faces.fold(f64::INFINITY, f64::min)
    }

    /// How deep a point lies inside, 0 outside.
    fn depth_m(&self, point: &Vector3<f64>) -> f64 {
        if self.contains(point) {
            self.distance_m(point)
        } else {
            0.0
        }
    }

    /// Where on the way from one point to another faces are gone through, in order, added to `out`.
    fn crossings(&self, from: &Vector3<f64>, to: &Vector3<f64>, out: &mut Vec<f64>) {
        let first = out.len();
        let along = to - from;
        let around = Bounds::NOTHING.with(from).with(to);
        self.tree.near(&around, |face| {
            let [a, b, c] = self.corners(face as usize);
            let normal = (b - a).cross(&(c - a));
            let steep = normal.dot(&along);
            let time = normal.dot(&(a - from)) / steep;
            if !(0.0..=1.0).contains(&time) {
                return;
            }
            let through = from + along * time;
            let sides = [(a, b), (b, c), (c, a)];
            let inside = |(p, q): &(Vector3<f64>, Vector3<f64>)| {
                (q - p).cross(&(through - p)).dot(&normal) >= 0.0
            };
            if sides.iter().all(inside) {
                out.push(time);
            }
        });
        out[first..].sort_unstable_by(f64::total_cmp);
    }
}

/// How deep one of two bodies reaches into the other at most \[m\]: of the points of their boundaries that
/// lie inside the other body the distance to its boundary, at every node and along every edge that goes through
/// a face, to about a hundredth. `bodies` are the faces of either, counter-clockwise seen from
/// outside, closed; `at` are positions of nodes \[m\], (n x 3).
pub fn penetration_m(bodies: [&[[u32; 3]]; 2], at: &[Vector3<f64>]) -> f64 {
    let hulls = bodies.map(|faces| Hull::new(faces, at));
    let mut deepest = 0.0f64;
    for (faces, other) in [(bodies[0], &hulls[1]), (bodies[1], &hulls[0])] {
        let shell = Shell::new(faces);
        for node in shell.nodes() {
            deepest = deepest.max(other.depth_m(&at[node as usize]));
        }
        let mut times = Vec::new();
        for [a, b] in shell.edges() {
            let (from, to) = (&at[a as usize], &at[b as usize]);
            times.clear();
            times.push(0.0);
            other.crossings(from, to, &mut times);
            if times.len() == 1 {
                continue;
            }
            times.push(1.0);
            for part in times.windows(2) {
                let place =
                    |share: f64| from + (to - from) * (part[0] + (part[1] - part[0]) * share);
                if !other.contains(&place(0.5)) {
                    continue;
                }
                let samples = (1..SAMPLES).map(|k| f64::from(k) / f64::from(SAMPLES));
                let depths = samples.map(|share| other.distance_m(&place(share)));
                deepest = depths.fold(deepest, f64::max);
            }
        }
    }
    deepest
}

/// Distance from each of `nodes` to the nearest point of `faces` \[m\], whichever side of them it is on; `at` are
/// positions of nodes \[m\], (n x 3).
pub fn gaps_m(nodes: &[u32], faces: &[[u32; 3]], at: &[Vector3<f64>]) -> Vec<f64> {
    let hull = Hull::new(faces, at);
    let gaps = nodes.iter();
    gaps.map(|node| hull.distance_m(&at[*node as usize]))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::slab;

    type Boundary = (Vec<[u32; 3]>, Vec<Vector3<f64>>);

    /// Two cubes of 2 cm, the second moved and turned.
    fn cubes(to: impl Fn(Vector3<f64>) -> Vector3<f64>) -> (Boundary, Vec<[u32; 3]>) {
        let mesh = slab([0.02; 3], [2, 2, 2]).expect("a cube");
        let own: Vec<Vector3<f64>> = mesh.points_m().iter().map(|p| Vector3::from(*p)).collect();
        let faces = mesh.surface().triangles;
        let start = own.len() as u32;
        let other = faces
            .iter()
            .map(|face| face.map(|node| node + start))
            .collect();
        let mut at = own.clone();
        at.extend(own.into_iter().map(to));
        ((faces, at), other)
    }

    #[test]
    fn overlaps_are_as_deep_as_the_cubes_were_moved_into_each_other() {
        // Vertices of one in the other.
        let ((one, at), other) = cubes(|p| p + Vector3::new(0.003, 0.002, 0.019));
        assert!((penetration_m([&one, &other], &at) - 0.001).abs() < 1e-12);
        assert!((penetration_m([&other, &one], &at) - 0.001).abs() < 1e-12);
        // Ridges across each other: no vertex is inside.
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let across = |p: Vector3<f64>| {
            let p = p + Vector3::new(0.0, 0.0, 0.01);
            // About x, and far up.
            Vector3::new(3.0 * p.x, half * (p.y - p.z), half * (p.y + p.z))
        };
        let mesh = cubes(|p| p);
        let ((faces, mut at), other) = mesh;
        let start = at.len() / 2;
        for (index, at) in at.iter_mut().enumerate() {
            let turned = across(*at);
            *at = if index < start {
                turned
            } else {
                Vector3::new(turned.y, turned.x, turned.z + 0.0272)
            };
        }
        // A mirror image: inside out.
        let other: Vec<[u32; 3]> = other.iter().map(|&[a, b, c]| [a, c, b]).collect();
        let ridges = 2.0 * 0.01 * 2f64.sqrt() - 0.0272;
        // The upper ridge lies so deep below the lower one, at 45 degrees to its faces.
        let found = penetration_m([&faces, &other], &at);
        assert!((found - ridges * half).abs() < 0.01 * ridges, "{found}");
        // Apart, and one wholly inside the other.
        let ((one, at), other) = cubes(|p| p + Vector3::new(0.0, 0.0, 0.0201));
        assert_eq!(penetration_m([&one, &other], &at), 0.0);
        let middle = Vector3::new(0.0, 0.0, -0.01);
        let ((one, at), other) = cubes(|p| middle + (p - middle) * 0.5);
        // Its middle of a face lies 5 mm below the other's.
        assert!((penetration_m([&one, &other], &at) - 0.005).abs() < 1e-12);
    }

    #[test]
    fn gaps_are_distances_to_the_nearest_face() {
        let ((_, at), other) = cubes(|p| p + Vector3::new(0.0, 0.0, 0.025));
        let top: Vec<u32> = (18..27).collect();
        for gap in gaps_m(&top, &other, &at) {
            assert!((gap - 0.005).abs() < 1e-12, "{gap}");
        }
        // To a corner.
        let ((_, at), other) = cubes(|p| p + Vector3::new(0.023, 0.024, 0.032));
        let gap = gaps_m(&[26], &other, &at)[0];
        assert!((gap - 0.013).abs() < 1e-12, "{gap}");
    }
}
