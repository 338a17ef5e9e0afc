//! What is wrong with a surface and can be put right in one way only.
//!
//! Entry point: [`TriangleMesh::repair`]. Which side of a part is outside says its volume, and how many of the others it lies in.

use super::check::edges;
use super::{SurfaceFlaw, TriangleMesh};
use crate::surface::half_angle;
use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::Serialize;
use std::collections::{HashMap, HashSet};
use std::f64::consts::PI;

/// Points closer than this part of the surface's size are one: coordinates of 32 bits are no better.
const SAME: f64 = 1e-6;

/// What [`TriangleMesh::repair`] did, and found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
pub struct Repaired {
    /// Points that lay on others and are one with them now.
    pub welded_points: usize,
    /// Triangles dropped: with two corners at one place, or there a second time.
    pub dropped_triangles: usize,
    /// Edges without a neighbour that were split at a point that lies on them.
    pub split_edges: usize,
    /// Holes filled: of few edges, or flat.
    pub filled_holes: usize,
    /// Triangles turned over, so that all of them look outwards.
    pub turned_triangles: usize,
    /// Parts that have no point in common.
    pub parts: usize,
    /// Those of them that are hollows, as they lie inside others.
    pub hollows: usize,
}

/// Triangles of a part that are looked at to say whether it lies in another.
const CORNERS_LOOKED_AT: usize = 16;

impl TriangleMesh {
    /// Welds points that lie on others, drops triangles without three corners and those that are there again, splits open edges at
    /// points on them, fills holes that are small or flat, and turns triangles until all look outwards; what lies inside another
    /// part is a hollow of it.
    ///
    /// # Errors
    /// What is left for others to mend: [`SurfaceFlaw::Open`], [`SurfaceFlaw::Crowded`], [`SurfaceFlaw::OneSided`], and what
    /// [`TriangleMesh::check`] finds.
    pub fn repair(&mut self) -> Result<Repaired, SurfaceFlaw> {
        self.check_corners()?;
        let bounds = self.bounds(0..self.triangles.len());
        let size_m = (bounds.1 - bounds.0).norm();
        let repaired = Repaired {
            welded_points: self.weld(bounds.0, SAME * size_m),
            dropped_triangles: self.drop_repeated(),
            ..Repaired::default()
        };
        let open = match self.neighbours() {
            Ok(_) => return self.turn(repaired),
            Err(flaw @ SurfaceFlaw::Open { .. }) => flaw,
            Err(other) => return Err(other),
        };
        let closing = self.close(SAME * size_m);
        let closed = self.turn(Repaired {
            split_edges: closing.split_edges,
            filled_holes: closing.holes,
            ..repaired
        });
        // What fills a hole and is no solid then, as in the rim of a sheet, was none.
        match closed {
            Ok(_) if closing.holes > 0 && self.has_sheet()? => Err(open),
            Err(flaw) if closing.holes > 0 && !matches!(flaw, SurfaceFlaw::Open { .. }) => {
                Err(open)
            }
            other => other,
        }
    }

    /// Whether a part of a closed surface holds nothing.
    fn has_sheet(&self) -> Result<bool, SurfaceFlaw> {
        let parts = self.parts(&mut vec![false; self.triangles.len()])?;
        let is_sheet = |part: &Vec<usize>| {
            let (low, high) = self.bounds(part.iter().copied());
            self.part_volume_m3(part).abs() <= SAME * (high - low).norm().powi(3)
        };
        Ok(parts.iter().any(is_sheet))
    }

    /// Volume inside a part by its orientation \[m^3\].
    fn part_volume_m3(&self, part: &[usize]) -> f64 {
        let origin = self.corners(part[0])[0];
        let six_fold = part.iter().map(|triangle| {
            let [a, b, c] = self.corners(*triangle).map(|at| at - origin);
            a.dot(&b.cross(&c))
        });
        six_fold.sum::<f64>() / 6.0
    }

    /// Turns triangles until all look outwards, and checks that they are the surface of a solid.
    fn turn(&mut self, repaired: Repaired) -> Result<Repaired, SurfaceFlaw> {
        let mut turned = vec![false; self.triangles.len()];
        let parts = self.parts(&mut turned)?;
        for (triangle, turned) in turned.iter().enumerate() {
            if *turned {
                self.triangles[triangle].swap(1, 2);
            }
        }
        let hollows = self.turn_parts(&parts, &mut turned);
        self.check()?;
        Ok(Repaired {
            turned_triangles: turned.iter().filter(|turned| **turned).count(),
            parts: parts.len(),
            hollows,
            ..repaired
        })
    }

    /// Makes one of points that lie within `same_m` of each other, and drops those that no triangle has; how many lay on others.
    /// `low` has the least coordinates.
    fn weld(&mut self, low: Vector3<f64>, same_m: f64) -> usize {
        let cell =
            |at: &Vector3<f64>| (at - low).map(|x| (x / same_m.max(f64::MIN_POSITIVE)) as i64);
        let mut cells: HashMap<[i64; 3], Vec<u32>> = HashMap::new();
        let mut points_m: Vec<[f64; 3]> = Vec::new();
        let mut number = vec![None; self.points_m.len()];
        let mut welded = 0;
        for corner in self.triangles.iter_mut().flatten() {
            let old = *corner as usize;
            *corner = *number[old].get_or_insert_with(|| {
                let at = Vector3::from(self.points_m[old]);
                let own = cell(&at);
                let around = (0..27).flat_map(|k| {
                    let there = [k % 3, k / 3 % 3, k / 9].map(|n: i64| n - 1);
                    let there = [0, 1, 2].map(|axis| own[axis].saturating_add(there[axis]));
                    cells.get(&there).into_iter().flatten().copied()
                });
                let is_near =
                    |other: &u32| (Vector3::from(points_m[*other as usize]) - at).norm() <= same_m;
                if let Some(other) = around.filter(is_near).min() {
                    welded += 1;
                    return other;
                }
                let new = points_m.len() as u32;
                points_m.push(at.into());
                cells.entry(own.into()).or_default().push(new);
                new
            });
        }
        self.points_m = points_m;
        welded
    }

    /// Drops triangles with a corner twice, and those on the corners of an earlier one; how many.
    pub fn drop_repeated(&mut self) -> usize {
        let mut seen = HashSet::new();
        let keep: Vec<bool> = (self.triangles.iter())
            .map(|&[a, b, c]| {
                let mut corners = [a, b, c];
                corners.sort_unstable();
                a != b && b != c && c != a && seen.insert(corners)
            })
            .collect();
        self.faces = (0..keep.len())
            .map(|triangle| self.face(triangle) as u32)
            .collect();
        let (mut own, mut other) = (keep.iter(), keep.iter());
        self.triangles.retain(|_| *own.next().unwrap_or(&true));
        self.faces.retain(|_| *other.next().unwrap_or(&true));
        keep.iter().filter(|keep| !**keep).count()
    }

    /// Triangles that hang together, and which of them are to be turned so that all of a part look the same way.
    fn parts(&self, turned: &mut [bool]) -> Result<Vec<Vec<usize>>, SurfaceFlaw> {
        let neighbours = self.neighbours()?;
        let mut seen = vec![false; self.triangles.len()];
        let mut parts = Vec::new();
        for first in 0..self.triangles.len() {
            if std::mem::replace(&mut seen[first], true) {
                continue;
            }
            let mut part = vec![first];
            let mut next = 0;
            while let Some(&here) = part.get(next) {
                next += 1;
                for (side, &(other, same_way)) in neighbours[here].iter().enumerate() {
                    let wanted = turned[here] ^ same_way;
                    if !std::mem::replace(&mut seen[other], true) {
                        turned[other] = wanted;
                        part.push(other);
                    } else if turned[other] != wanted {
                        let (from, to) = edges(&self.triangles[here])[side];
                        return Err(SurfaceFlaw::OneSided {
                            one: self.face(here),
                            other: self.face(other),
                            from_m: self.points_m[from as usize],
                            to_m: self.points_m[to as usize],
                        });
                    }
                }
            }
            parts.push(part);
        }
        Ok(parts)
    }

    /// Sides of all triangles, by the ends of their edges: the lesser, the greater, the triangle, and which of its sides.
    pub(super) fn sides(&self) -> Vec<((u32, u32), usize, usize)> {
        let mut sides = Vec::with_capacity(3 * self.triangles.len());
        for (triangle, corners) in self.triangles.iter().enumerate() {
            for (side, (from, to)) in edges(corners).into_iter().enumerate() {
                sides.push(((from.min(to), from.max(to)), triangle, side));
            }
        }
        sides.sort_unstable();
        sides
    }

    /// The triangle across each edge, and whether it passes the edge the same way, which none should.
    fn neighbours(&self) -> Result<Vec<[(usize, bool); 3]>, SurfaceFlaw> {
        let sides = self.sides();
        let mut neighbours = vec![[(0, false); 3]; self.triangles.len()];
        let (mut open, mut first) = (0, None);
        for at_edge in sides.chunk_by(|one, other| one.0 == other.0) {
            let ((from, to), one, side) = at_edge[0];
            let [from_m, to_m] = [from, to].map(|point| self.points_m[point as usize]);
            match at_edge[1..] {
                [] => {
                    open += 1;
                    // The first in the order of the file.
                    first = first.into_iter().chain([(one, side)]).min();
                }
                [(_, other, other_side)] => {
                    let way = |triangle: usize, side: usize| edges(&self.triangles[triangle])[side];
                    let same_way = way(one, side) == way(other, other_side);
                    neighbours[one][side] = (other, same_way);
                    neighbours[other][other_side] = (one, same_way);
                }
                [(_, second, _), (_, third, _), ..] => {
                    return Err(SurfaceFlaw::Crowded {
                        faces: [one, second, third].map(|triangle| self.face(triangle)),
                        from_m,
                        to_m,
                    });
                }
            }
        }
        let Some((triangle, side)) = first else {
            return Ok(neighbours);
        };
        let (from, to) = edges(&self.triangles[triangle])[side];
        Err(SurfaceFlaw::Open {
            face: self.face(triangle),
            from_m: self.points_m[from as usize],
            to_m: self.points_m[to as usize],
            edges: open,
        })
    }

    /// Turns parts over whose normals look into the solid; how many of them lie in an odd number of others.
    fn turn_parts(&mut self, parts: &[Vec<usize>], turned: &mut [bool]) -> usize {
        let around = self.parts_around(parts);
        let hollows: Vec<bool> = around.iter().map(|others| others.len() % 2 == 1).collect();
        for (part, is_hollow) in parts.iter().zip(&hollows) {
            if (self.part_volume_m3(part) < 0.0) != *is_hollow {
                for &triangle in part {
                    self.triangles[triangle].swap(1, 2);
                    turned[triangle] = !turned[triangle];
                }
            }
        }
        hollows.into_iter().filter(|is_hollow| *is_hollow).count()
    }

    /// The other parts that each part lies in: its box does, and corners of it all over, since parts that cut each other lie in none.
    fn parts_around(&self, parts: &[Vec<usize>]) -> Vec<Vec<usize>> {
        let bounds: Vec<_> = parts
            .iter()
            .map(|part| self.bounds(part.iter().copied()))
            .collect();
        let around = parts.iter().enumerate().map(|(own, part)| {
            let (least, most) = bounds[own];
            let every = part.len().div_ceil(CORNERS_LOOKED_AT);
            let holds = |other: &usize| {
                let (low, high) = bounds[*other];
                let mut looked_at = part.iter().step_by(every);
                *other != own
                    && (0..3).all(|k| low[k] <= least[k] && most[k] <= high[k])
                    && looked_at
                        .all(|each| self.winds_around(&parts[*other], &self.corners(*each)[0]))
            };
            (0..parts.len()).filter(holds).collect()
        });
        around.collect()
    }

    /// The bodies that a repaired surface is of, each with its hollows, in the order of their first triangles: a body in a hollow of
    /// another is one of its own.
    ///
    /// # Errors
    /// What keeps the surface from being closed.
    pub fn bodies(&self) -> Result<Vec<TriangleMesh>, SurfaceFlaw> {
        let parts = self.parts(&mut vec![false; self.triangles.len()])?;
        let around = self.parts_around(&parts);
        let outer = (0..parts.len()).filter(|part| around[*part].len().is_multiple_of(2));
        let bodies = outer.map(|outer| {
            let depth = around[outer].len() + 1;
            let is_hollow =
                |part: &usize| around[*part].len() == depth && around[*part].contains(&outer);
            let hollows = (0..parts.len()).filter(is_hollow);
            let mut body = TriangleMesh {
                points_m: self.points_m.clone(),
                triangles: Vec::new(),
                faces: Vec::new(),
            };
            for &triangle in std::iter::once(outer)
                .chain(hollows)
                .flat_map(|part| &parts[part])
            {
                body.triangles.push(self.triangles[triangle]);
                body.faces.push(self.face(triangle) as u32);
            }
            body
        });
        Ok(bodies.collect())
    }

    /// Whether a part, whichever way its normals look, has a place inside.
    fn winds_around(&self, part: &[usize], at: &Vector3<f64>) -> bool {
        let angles = part
            .iter()
            .map(|triangle| half_angle(self.corners(*triangle).map(|corner| corner - at)));
        angles.sum::<f64>().abs() > PI
    }

    /// The box around some triangles \[m\]: its least and greatest coordinates.
    fn bounds(&self, triangles: impl Iterator<Item = usize>) -> (Vector3<f64>, Vector3<f64>) {
        let corners = triangles.flat_map(|triangle| self.corners(triangle));
        let nothing = (
            Vector3::repeat(f64::INFINITY),
            Vector3::repeat(f64::NEG_INFINITY),
        );
        corners.fold(nothing, |(low, high), at| (low.inf(&at), high.sup(&at)))
    }
}
