//! A closed surface of triangles, and its place nearest to a point.
//!
//! Entry points: [`ClosedMesh::new`], [`ClosedMesh::read`], [`ClosedMesh::nearest`]. On which side of the surface a point is
//! say the normals of triangles and, where an edge or a vertex is nearest, pseudo-normals: sums of the triangles' normals there, at a vertex
//! weighted by their angles (Baerentzen & Aanaes 2005). Parts of the surface that cut each other are not looked for.

use crate::boxes::{Bounds, Tree};
use crate::mesh::{Closed, SurfaceFlaw, SurfaceFormat, TriangleMesh};
use nalgebra::{Matrix3, Vector3};

/// Most triangles of a mesh: every vertex near it asks for the nearest one.
pub const MOST_TRIANGLES: usize = 20_000;
/// Sines and relative lengths below this are nothing but rounding.
const ROUNDING: f64 = 1e-9;
/// Places along an axis among which the deepest inside is looked for first, and rounds that make it more exact.
const PLACES: u32 = 17;
const ROUNDS: u32 = 40;

/// A closed surface of triangles that see their corners counter-clockwise from outside.
#[derive(Clone, Debug)]
pub struct ClosedMesh {
    points_m: Vec<Vector3<f64>>,
    triangles: Vec<[u32; 3]>,
    /// Of the triangles, unit vectors out of the surface.
    normals: Vec<Vector3<f64>>,
    /// Triangles across the edges of each, the first from its first corner to its second.
    across: Vec<[u32; 3]>,
    /// Pseudo-normals of points, of any length.
    point_normals: Vec<Vector3<f64>>,
    /// Where the neighbours of each point begin among all, and where the last ones end.
    first_neighbour: Vec<u32>,
    neighbours: Vec<u32>,
    /// Around the triangles.
    tree: Tree,
    /// The farthest point from the origin \[m\].
    reach_m: f64,
    /// A place deep inside \[m\], and how far it is from the surface \[m\].
    deepest_m: (Vector3<f64>, f64),
}

/// What of a triangle is nearest to a point: its face, the edge from this corner on, or this corner.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Part {
    Face,
    Edge(usize),
    Corner(usize),
}

/// The place of a surface nearest to a point.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Foot {
    /// Signed distance of the point \[m\], negative inside.
    pub distance: f64,
    /// Its gradient, unit vector.
    pub normal: Vector3<f64>,
    /// Its Hessian \[1/m\].
    pub curvature: Matrix3<f64>,
}

impl PartialEq for ClosedMesh {
    fn eq(&self, other: &Self) -> bool {
        (&self.points_m, &self.triangles) == (&other.points_m, &other.triangles)
    }
}

impl ClosedMesh {
    /// Of points \[m\], (n x 3), and triangles by their corners.
    ///
    /// # Errors
    /// What keeps them from being one closed surface, see [`SurfaceFlaw`].
    pub fn new(points_m: &[[f64; 3]], triangles: &[[u32; 3]]) -> Result<Self, SurfaceFlaw> {
        Self::of(TriangleMesh::new(points_m.to_vec(), triangles.to_vec()))
    }

    /// The surface in a file's `bytes`, whose unit is `scale_to_m` metres, but for triangles that are none or there again.
    ///
    /// # Errors
    /// As of [`Self::new`], and [`SurfaceFlaw::File`] for what cannot be read.
    pub fn read(format: SurfaceFormat, bytes: &[u8], scale_to_m: f64) -> Result<Self, SurfaceFlaw> {
        let mut surface = format.read(bytes, scale_to_m)?;
        surface.drop_repeated();
        Self::of(surface)
    }

    fn of(surface: TriangleMesh) -> Result<Self, SurfaceFlaw> {
        if surface.triangles.len() > MOST_TRIANGLES {
            return Err(SurfaceFlaw::TooMany {
                triangles: surface.triangles.len(),
                most: MOST_TRIANGLES,
            });
        }
        let Closed { normals, across } = surface.check()?;
        let points_m: Vec<Vector3<f64>> = surface.points_m.iter().map(|at| (*at).into()).collect();
        let triangles = surface.triangles;
        let corners = |triangle: &[u32; 3]| triangle.map(|point| points_m[point as usize]);
        let tree = Tree::new(triangles.len() as u32, |triangle| {
            let corners = corners(&triangles[triangle as usize]);
            corners.iter().fold(Bounds::NOTHING, |all, at| all.with(at))
        });
        let (first_neighbour, neighbours) = neighbours(points_m.len(), &triangles);
        let mut mesh = Self {
            point_normals: point_normals(&points_m, &triangles, &normals),
            reach_m: points_m.iter().map(Vector3::norm).fold(0.0, f64::max),
            points_m,
            triangles,
            normals,
            across,
            first_neighbour,
            neighbours,
            tree,
            deepest_m: (Vector3::zeros(), 0.0),
        };
        mesh.deepest_m = mesh.find_deepest();
        Ok(mesh)
    }

    /// Its points \[m\], (n x 3).
    pub fn points_m(&self) -> &[Vector3<f64>] {
        &self.points_m
    }

    /// Its triangles by their corners.
    pub fn triangles(&self) -> &[[u32; 3]] {
        &self.triangles
    }

    /// The box around it.
    pub(crate) fn bounds(&self) -> Bounds {
        self.tree.bounds()
    }

    /// No point of it is farther from the origin \[m\].
    pub fn reach_m(&self) -> f64 {
        self.reach_m
    }

    /// A place inside as far from the surface as any, and how far that is \[m\].
    pub fn deepest_m(&self) -> (Vector3<f64>, f64) {
        self.deepest_m
    }

    /// The nearest place of the surface, if a number is finite. Allocates nothing.
    pub(crate) fn nearest(&self, at: &Vector3<f64>) -> Option<Foot> {
        let mut nearest: Option<(f64, u32, Part, Vector3<f64>)> = None;
        self.tree.least(
            |bounds| bounds.distance_squared(at),
            |triangle| {
                let (part, arm) = arm(at, &self.corners(triangle));
                let square = arm.norm_squared();
                if nearest.is_none_or(|(least, ..)| square < least) {
                    nearest = Some((square, triangle, part, arm));
                }
                square
            },
        );
        let (square, triangle, part, arm) = nearest?;
        square.is_finite().then(|| self.foot(triangle, part, &arm))
    }

    fn corners(&self, triangle: u32) -> [Vector3<f64>; 3] {
        self.triangles[triangle as usize].map(|point| self.points_m[point as usize])
    }

    /// The distance that `arm` is long, from this part of a triangle.
    fn foot(&self, triangle: u32, part: Part, arm: &Vector3<f64>) -> Foot {
        let face = self.normals[triangle as usize];
        let out = match part {
            Part::Face => face,
            Part::Edge(side) => face + self.normals[self.across[triangle as usize][side] as usize],
            Part::Corner(corner) => {
                self.point_normals[self.triangles[triangle as usize][corner] as usize]
            }
        };
        let length = arm.norm();
        if part == Part::Face || length <= ROUNDING * ROUNDING * self.reach_m {
            return Foot {
                distance: face.dot(arm),
                normal: out.try_normalize(0.0).unwrap_or(face),
                curvature: Matrix3::zeros(),
            };
        }
        let distance = length.copysign(out.dot(arm));
        let normal = arm / distance;
        let straight = self.straight(triangle, part, &normal);
        let bent = Matrix3::identity() - normal * normal.transpose() - straight;
        Foot {
            distance,
            normal,
            curvature: bent / distance,
        }
    }

    /// Projects on directions along which the surface goes straight on across `normal`: that of the edge, and those of
    /// faces and edges where the point is no less before these.
    fn straight(&self, triangle: u32, part: Part, normal: &Vector3<f64>) -> Matrix3<f64> {
        let corners = self.corners(triangle);
        let flat = |way: &Vector3<f64>| way.dot(normal).abs() <= ROUNDING * way.norm();
        let first = match part {
            Part::Face => return Matrix3::identity() - normal * normal.transpose(),
            Part::Edge(side) => {
                let along = corners[(side + 1) % 3] - corners[side];
                let other = self.corners(self.across[triangle as usize][side]);
                let faces = corners.iter().chain(&other).map(|at| at - corners[side]);
                let aside = faces.map(|way| way - along * (way.dot(&along) / along.norm_squared()));
                let is_face = aside
                    .filter(|way| way.norm() > ROUNDING * along.norm())
                    .any(|way| flat(&way));
                if is_face {
                    return Matrix3::identity() - normal * normal.transpose();
                }
                along.normalize()
            }
            Part::Corner(corner) => {
                let point = self.triangles[triangle as usize][corner];
                let mut ways = self.ways_from(point).filter(flat);
                let Some(first) = ways.next().map(|way| way.normalize()) else {
                    return Matrix3::zeros();
                };
                if ways.any(|way| way.cross(&first).norm() > ROUNDING.sqrt() * way.norm()) {
                    return Matrix3::identity() - normal * normal.transpose();
                }
                first
            }
        };
        first * first.transpose()
    }

    /// From a point along its edges \[m\].
    fn ways_from(&self, point: u32) -> impl Iterator<Item = Vector3<f64>> {
        let point = point as usize;
        let places = self.first_neighbour[point] as usize..self.first_neighbour[point + 1] as usize;
        let neighbours = self.neighbours[places].iter();
        neighbours.map(move |other| self.points_m[*other as usize] - self.points_m[point])
    }

    /// The deepest of a net of places, and of places below the triangles, moved to where it is deeper.
    fn find_deepest(&self) -> (Vector3<f64>, f64) {
        let Bounds { low, high } = self.tree.bounds();
        let size = high - low;
        let part = |k: u32| f64::from(k) / f64::from(PLACES - 1);
        let net = (0..PLACES.pow(3)).map(|k| {
            let parts = [k % PLACES, k / PLACES % PLACES, k / PLACES.pow(2)].map(part);
            low + size.component_mul(&Vector3::from(parts))
        });
        let stride = self.triangles.len().div_ceil(1000);
        let below = (0..self.triangles.len() as u32)
            .step_by(stride)
            .flat_map(|triangle| {
                let middle = self.corners(triangle).iter().sum::<Vector3<f64>>() / 3.0;
                let inwards = self.normals[triangle as usize] * size.amax();
                (2..12).map(move |halvings| middle - inwards * 0.5f64.powi(halvings))
            });
        let depth = |at: &Vector3<f64>| self.nearest(at).map_or(f64::MIN, |foot| -foot.distance);
        let deeper = |best: (Vector3<f64>, f64), at: Vector3<f64>| {
            let depth = depth(&at);
            if depth > best.1 { (at, depth) } else { best }
        };
        let mut best = net.chain(below).fold((low, f64::MIN), deeper);
        let mut reach = size / f64::from(PLACES);
        for _ in 0..ROUNDS {
            let (from, _) = best;
            let around = (0..27).map(|k| {
                let way = [k % 3, k / 3 % 3, k / 9].map(|n| f64::from(n) - 1.0);
                from + reach.component_mul(&Vector3::from(way))
            });
            best = around.fold(best, deeper);
            if best.0 == from {
                reach *= 0.5;
            }
        }
        best
    }
}

/// From the nearest point of a triangle to `at` \[m\], and what part of it that is on (Ericson 2005, 5.1.5).
fn arm(at: &Vector3<f64>, [a, b, c]: &[Vector3<f64>; 3]) -> (Part, Vector3<f64>) {
    let (ab, ac) = (b - a, c - a);
    let (from_a, from_b, from_c) = (at - a, at - b, at - c);
    let (d1, d2) = (ab.dot(&from_a), ac.dot(&from_a));
    if d1 <= 0.0 && d2 <= 0.0 {
        return (Part::Corner(0), from_a);
    }
    let (d3, d4) = (ab.dot(&from_b), ac.dot(&from_b));
    if d3 >= 0.0 && d4 <= d3 {
        return (Part::Corner(1), from_b);
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return (Part::Edge(0), from_a - ab * (d1 / (d1 - d3)));
    }
    let (d5, d6) = (ab.dot(&from_c), ac.dot(&from_c));
    if d6 >= 0.0 && d5 <= d6 {
        return (Part::Corner(2), from_c);
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return (Part::Edge(2), from_a - ac * (d2 / (d2 - d6)));
    }
    let va = d3 * d6 - d5 * d4;
    let (to_c, to_b) = (d4 - d3, d5 - d6);
    if va <= 0.0 && to_c >= 0.0 && to_b >= 0.0 {
        return (Part::Edge(1), from_b - (c - b) * (to_c / (to_c + to_b)));
    }
    let normal = ab.cross(&ac);
    (
        Part::Face,
        normal * (normal.dot(&from_a) / normal.norm_squared()),
    )
}

/// Sums of the normals of the triangles at each point, weighted by their angles there.
fn point_normals(
    points_m: &[Vector3<f64>],
    triangles: &[[u32; 3]],
    normals: &[Vector3<f64>],
) -> Vec<Vector3<f64>> {
    let mut sums = vec![Vector3::zeros(); points_m.len()];
    for (corners, normal) in triangles.iter().zip(normals) {
        for side in 0..3 {
            let [at, next, last] = [0, 1, 2].map(|k| corners[(side + k) % 3] as usize);
            let (one, other) = (points_m[next] - points_m[at], points_m[last] - points_m[at]);
            sums[at] += normal * one.angle(&other);
        }
    }
    sums
}

/// Neighbours of each point: where they begin in the list of all, and that list.
fn neighbours(points: usize, triangles: &[[u32; 3]]) -> (Vec<u32>, Vec<u32>) {
    let edges = triangles
        .iter()
        .flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)]);
    let mut edges: Vec<(u32, u32)> = edges.collect();
    edges.sort_unstable();
    let first = |point: u32| edges.partition_point(|(from, _)| *from < point) as u32;
    let firsts = (0..=points as u32).map(first).collect();
    (firsts, edges.into_iter().map(|(_, to)| to).collect())
}
