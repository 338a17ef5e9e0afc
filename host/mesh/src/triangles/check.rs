//! Whether triangles are the surface of a solid.
//!
//! Entry point: [`TriangleMesh::check`]. Parts that cut each other are not looked for.

use super::{SurfaceFlaw, TriangleMesh};
use nalgebra::Vector3;
use std::collections::{HashMap, HashSet};

/// Sines and relative lengths below this are nothing but rounding.
pub(super) const ROUNDING: f64 = 1e-9;

/// What is known of a surface that is closed.
#[derive(Clone, Debug)]
pub struct Closed {
    /// Of the triangles, unit vectors out of the surface, (f x 3).
    pub normals: Vec<Vector3<f64>>,
    /// Triangles across the edges of each, the first from its first corner to its second, (f x 3).
    pub across: Vec<[u32; 3]>,
}

impl TriangleMesh {
    /// Whether these are triangles with an area that see their corners counter-clockwise from outside, two at each edge, and
    /// that are all met on one way around each point.
    ///
    /// # Errors
    /// The first [`SurfaceFlaw`] found.
    pub fn check(&self) -> Result<Closed, SurfaceFlaw> {
        self.check_corners()?;
        let normals = self.normals()?;
        let across = self.across()?;
        self.check_fans(&across)?;
        let volume_m3 = self.volume_m3();
        if volume_m3.is_nan() || volume_m3 <= 0.0 {
            return Err(SurfaceFlaw::InsideOut { volume_m3 });
        }
        Ok(Closed { normals, across })
    }

    /// Whether there are triangles, and all of their corners are somewhere.
    pub(super) fn check_corners(&self) -> Result<(), SurfaceFlaw> {
        if self.triangles.is_empty() {
            return Err(SurfaceFlaw::Empty);
        }
        let points = self.points_m.len();
        for (triangle, corners) in self.triangles.iter().enumerate() {
            let face = self.face(triangle);
            if let Some(&corner) = corners.iter().find(|corner| **corner as usize >= points) {
                return Err(SurfaceFlaw::NoPoint {
                    face,
                    corner,
                    points,
                });
            }
            // Squared as well: beyond that no distance can be computed.
            let squares = self.corners(triangle).map(|at| at.norm_squared());
            if !squares.iter().sum::<f64>().is_finite() {
                return Err(SurfaceFlaw::NotFinite { face });
            }
        }
        Ok(())
    }

    fn normals(&self) -> Result<Vec<Vector3<f64>>, SurfaceFlaw> {
        let normal = |triangle| {
            let [a, b, c] = self.corners(triangle);
            let (ab, ac) = (b - a, c - a);
            let least = ROUNDING * ab.norm_squared().max(ac.norm_squared());
            let normal = ab.cross(&ac).try_normalize(least);
            normal.ok_or(SurfaceFlaw::NoArea {
                face: self.face(triangle),
                at_m: a.into(),
            })
        };
        (0..self.triangles.len()).map(normal).collect()
    }

    /// Triangles across the edges of each.
    fn across(&self) -> Result<Vec<[u32; 3]>, SurfaceFlaw> {
        let mut passed = HashMap::with_capacity(3 * self.triangles.len());
        for (triangle, corners) in self.triangles.iter().enumerate() {
            for (from, to) in edges(corners) {
                if let Some(other) = passed.insert((from, to), triangle) {
                    return Err(SurfaceFlaw::Turned {
                        one: self.face(other),
                        other: self.face(triangle),
                        from_m: self.points_m[from as usize],
                        to_m: self.points_m[to as usize],
                    });
                }
            }
        }
        let mut across = vec![[0; 3]; self.triangles.len()];
        let (mut open, mut first) = (0, None);
        for (triangle, corners) in self.triangles.iter().enumerate() {
            for (side, (from, to)) in edges(corners).into_iter().enumerate() {
                match passed.get(&(to, from)) {
                    Some(other) => across[triangle][side] = *other as u32,
                    None => {
                        open += 1;
                        first = first.or(Some((triangle, from, to)));
                    }
                }
            }
        }
        match first {
            None => Ok(across),
            Some((triangle, from, to)) => Err(SurfaceFlaw::Open {
                face: self.face(triangle),
                from_m: self.points_m[from as usize],
                to_m: self.points_m[to as usize],
                edges: open,
            }),
        }
    }

    /// Whether the triangles at each point are all met on one way around it.
    fn check_fans(&self, across: &[[u32; 3]]) -> Result<(), SurfaceFlaw> {
        let mut at_point = vec![Vec::new(); self.points_m.len()];
        for (triangle, corners) in self.triangles.iter().enumerate() {
            for corner in corners {
                at_point[*corner as usize].push(triangle);
            }
        }
        for (point, triangles) in at_point.iter().enumerate() {
            let Some(&first) = triangles.first() else {
                continue;
            };
            let after = |here: &usize| {
                let mut corners = self.triangles[*here].iter();
                let corner = corners.position(|at| *at as usize == point)?;
                Some(across[*here][corner] as usize).filter(|next| *next != first)
            };
            let round = std::iter::successors(Some(first), after).take(triangles.len());
            if round.clone().count() == triangles.len() {
                continue;
            }
            let met: HashSet<usize> = round.collect();
            let other = triangles.iter().find(|other| !met.contains(other));
            return Err(SurfaceFlaw::Pinched {
                one: self.face(first),
                other: self.face(other.copied().unwrap_or(first)),
                at_m: self.points_m[point],
            });
        }
        Ok(())
    }
}

/// The edges of a triangle, the first from its first corner to its second.
pub(super) fn edges(&[a, b, c]: &[u32; 3]) -> [(u32, u32); 3] {
    [(a, b), (b, c), (c, a)]
}
