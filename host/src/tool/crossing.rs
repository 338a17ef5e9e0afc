//! Where a surface of triangles goes through itself.
//!
//! Entry point: [`crossing`].

use crate::boxes::{Bounds, Tree};
use crate::mesh::TriangleMesh;
use nalgebra::Vector3;

/// Coordinates are no better than this part of the largest: a few bits of 32.
const ROUNDING: f64 = 2e-7;

/// Two triangles that go through each other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Crossing {
    /// Counted from 0, ascending.
    pub triangles: [usize; 2],
    /// Point at which an edge of one goes through the other \[m\], (3).
    pub at_m: [f64; 3],
}

/// The first two triangles of which an edge of one goes through the other. Those that overlap in one plane are not looked for.
pub fn crossing(surface: &TriangleMesh) -> Option<Crossing> {
    let tree = Tree::new(surface.triangles.len() as u32, |triangle| {
        let corners = surface.corners(triangle as usize);
        corners.iter().fold(Bounds::NOTHING, |all, at| all.with(at))
    });
    let goes_through = |one: usize, other: usize| {
        let (names, face) = (surface.triangles[one], surface.triangles[other]);
        let (corners, across) = (surface.corners(one), surface.corners(other));
        (0..3).find_map(|from| {
            let to = (from + 1) % 3;
            let has_common = face.contains(&names[from]) || face.contains(&names[to]);
            let goes = !has_common && cuts(corners[from], corners[to], across);
            goes.then(|| on_plane(corners[from], corners[to], across))
        })
    };
    let mut first: Option<Crossing> = None;
    tree.own_pairs(|one, other| {
        let pair = [one.min(other) as usize, one.max(other) as usize];
        let [a, b] = pair;
        if first.is_none_or(|first| pair < first.triangles)
            && let Some(at) = goes_through(a, b).or_else(|| goes_through(b, a))
        {
            first = Some(Crossing {
                triangles: pair,
                at_m: at.into(),
            });
        }
    });
    first
}

/// Point of a line that passes from one side of a triangle's plane to the other, on that plane.
fn on_plane(from: Vector3<f64>, to: Vector3<f64>, [a, b, c]: [Vector3<f64>; 3]) -> Vector3<f64> {
    let normal = (b - a).cross(&(c - a));
    let [before, after] = [from, to].map(|end| (end - a).dot(&normal));
    from.lerp(&to, before / (before - after))
}

/// Whether a line passes from one side of a triangle to the other within its edges, by the signs of volumes. Volumes that
/// coordinates of 32 bits do not tell from none have no sign: faces in one plane and those that touch do not cross.
fn cuts(from: Vector3<f64>, to: Vector3<f64>, [a, b, c]: [Vector3<f64>; 3]) -> bool {
    let side = |p: Vector3<f64>, q: Vector3<f64>, r: Vector3<f64>, at: Vector3<f64>| {
        let (pq, pr, way) = (q - p, r - p, at - p);
        let volume = pq.cross(&pr).dot(&way);
        let off_m = ROUNDING
            * [p, q, r, at]
                .map(|x| x.amax())
                .into_iter()
                .fold(0.0, f64::max);
        let areas = pq.norm() * pr.norm() + pr.norm() * way.norm() + way.norm() * pq.norm();
        match volume.abs() > off_m * areas {
            true => volume.signum(),
            false => 0.0,
        }
    };
    let ends = side(a, b, c, from) * side(a, b, c, to);
    let around = [(a, b), (b, c), (c, a)].map(|(p, q)| side(from, to, p, q));
    // On an edge of the triangle it passes through the next one as well, and must not go between the two.
    let is_around = around.iter().all(|x| *x >= 0.0) || around.iter().all(|x| *x <= 0.0);
    ends < 0.0 && is_around && around != [0.0; 3]
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Rotation3;

    /// The faces of unit cubes that no two of them have in common, counter-clockwise seen from outside, a plane's triangles
    /// beside each other.
    fn cubes(at: &[[i32; 3]], place: impl Fn([f64; 3]) -> [f64; 3]) -> TriangleMesh {
        let (mut points, mut triangles) = (Vec::new(), Vec::new());
        for cube in at {
            for (axis, way) in (0..6).map(|side| (side / 2, (side % 2) as i32)) {
                let mut next = *cube;
                next[axis] += 2 * way - 1;
                if at.contains(&next) {
                    continue;
                }
                let corner = |k: i32| {
                    let mut corner = *cube;
                    corner[axis] += way;
                    corner[(axis + 1) % 3] += k & 1;
                    corner[(axis + 2) % 3] += k >> 1;
                    corner
                };
                let order = if way == 1 { [0, 1, 3, 2] } else { [0, 2, 3, 1] };
                let [a, b, c, d] = order.map(|k| {
                    let corner = corner(k);
                    let known = points.iter().position(|known| *known == corner);
                    known.unwrap_or_else(|| {
                        points.push(corner);
                        points.len() - 1
                    }) as u32
                });
                triangles.extend([[a, b, c], [a, c, d]]);
            }
        }
        let place = |corner: &[i32; 3]| place(corner.map(f64::from));
        TriangleMesh::new(points.iter().map(place).collect(), triangles)
    }

    /// Of 32 bits, as files have them, turned out of every axis and far from the origin.
    #[test]
    fn faces_in_one_plane_do_not_cross() {
        let block: Vec<_> = (0..27).map(|k| [k % 3, k / 3 % 3, k / 9]).collect();
        for seed in 0..50 {
            let turn = Rotation3::from_euler_angles(0.1 * f64::from(seed), 0.7, 0.3);
            let place = |at: [f64; 3]| {
                let at = turn * Vector3::from(at) * 0.13 + Vector3::new(3.0, -2.0, 5.0);
                at.map(|x| f64::from(x as f32) * 0.001).into()
            };
            let surface = cubes(&block, place);
            assert!(surface.check().is_ok());
            assert_eq!(crossing(&surface), None, "{seed}");
        }
    }

    #[test]
    fn the_first_two_that_cross_are_named() {
        let mut surface = cubes(&[[0, 0, 0]], |at| at.map(|x| 0.02 * x));
        let other = cubes(&[[0, 0, 0]], |at| at.map(|x| 0.02 * x + 0.015));
        assert_eq!(crossing(&surface), None);
        surface.points_m.extend(&other.points_m);
        let more = other.triangles.iter().map(|own| own.map(|point| point + 8));
        surface.triangles.extend(more);
        let Crossing {
            triangles: [one, other],
            at_m,
        } = crossing(&surface).expect("crosses");
        assert!(one < 12 && other >= 12, "{one} {other}");
        // On faces of both: of the first cube at 0 and 0.02, of the second at 0.015 and 0.035.
        let within = at_m
            .iter()
            .all(|x| (0.015 - 1e-12..0.02 + 1e-12).contains(x));
        let on = |face: f64| at_m.iter().any(|x| (x - face).abs() < 1e-12);
        assert!(within && on(0.02) && on(0.015), "{at_m:?}");
        // A little apart they do not.
        let apart = |surface: &mut TriangleMesh, by: f64| {
            surface.points_m[8..]
                .iter_mut()
                .flatten()
                .for_each(|x| *x += by);
        };
        apart(&mut surface, 0.0051);
        assert_eq!(crossing(&surface), None);
        // A corner that stands out of the other by the tenth part of its size.
        apart(&mut surface, -0.0021);
        assert!(crossing(&surface).is_some());
    }
}
