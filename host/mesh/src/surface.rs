//! The boundary of a mesh: triangles, vertices, outward normals, and whether a point lies inside.
//!
//! Entry point: [`Surface::of`]. Normals are angle-weighted (Baerentzen & Aanaes 2005); the inside
//! test sums solid angles (van Oosterom & Strackee 1983).

use super::TetMesh;
use nalgebra::Vector3;

/// Boundary of a tetrahedral mesh, in its rest shape.
#[derive(Clone, Debug)]
pub struct Surface {
    /// Mesh nodes of each boundary triangle, counter-clockwise seen from outside, (f x 3).
    pub triangles: Vec<[u32; 3]>,
    /// Mesh nodes on the boundary, ascending, (b).
    pub vertices: Vec<u32>,
    /// Unit outward normal at each entry of `vertices`, (b x 3).
    pub normals: Vec<[f64; 3]>,
    /// Mean length of the triangles' edges \[m\].
    pub mean_edge_m: f64,
}

impl Surface {
    /// The boundary of `mesh`: faces that belong to one cell only, in the order of the cells.
    pub fn of(mesh: &TetMesh) -> Self {
        let boundary = mesh.half_faces().boundary();
        let (triangles, vertices) = (boundary.triangles().to_vec(), boundary.vertices().to_vec());
        let mut normal_of = vec![Vector3::zeros(); mesh.points_m().len()];
        let mut edges = 0.0;
        for &triangle in &triangles {
            let p = triangle.map(|node| Vector3::from(mesh.points_m()[node as usize]));
            let normal = (p[1] - p[0]).cross(&(p[2] - p[0])).normalize();
            for corner in 0..3 {
                let a = p[(corner + 1) % 3] - p[corner];
                let b = p[(corner + 2) % 3] - p[corner];
                edges += a.norm();
                normal_of[triangle[corner] as usize] += normal * a.angle(&b);
            }
        }
        let normals = vertices
            .iter()
            .map(|&node| {
                normal_of[node as usize]
                    .try_normalize(1e-12)
                    .unwrap_or_else(Vector3::z)
            })
            .map(Into::into)
            .collect();
        let mean_edge_m = edges / (3 * triangles.len()) as f64;
        Self {
            triangles,
            vertices,
            normals,
            mean_edge_m,
        }
    }

    /// Whether `point` lies inside the closed boundary, with nodes at `points_m` \[m\], (n x 3).
    pub fn contains(&self, points_m: &[[f64; 3]], point: [f64; 3]) -> bool {
        self.encloses(
            |node| Vector3::from(points_m[node as usize]),
            &Vector3::from(point),
        )
    }

    /// Whether `point` lies inside the closed boundary, with nodes `at` some places \[m\], (3): the solid angles of the
    /// triangles add up to 4 pi inside and to 0 outside.
    pub fn encloses(&self, at: impl Fn(u32) -> Vector3<f64>, point: &Vector3<f64>) -> bool {
        let mut half_angle = 0.0;
        for triangle in &self.triangles {
            half_angle += self::half_angle(triangle.map(|node| at(node) - point));
        }
        half_angle > std::f64::consts::PI
    }

    /// Triangles that the straight way between two points goes through, edges included, with nodes `at` some places \[m\], (3).
    pub fn crossed<'a>(
        &'a self,
        at: impl Fn(u32) -> Vector3<f64> + 'a,
        from: &Vector3<f64>,
        to: &Vector3<f64>,
    ) -> impl Iterator<Item = [u32; 3]> + 'a {
        let (from, way) = (*from, to - from);
        let each = self.triangles.iter().copied();
        each.filter(move |triangle| is_crossed(triangle.map(|node| at(node) - from), &way))
    }
}

/// Whether the way from the origin goes through a triangle.
fn is_crossed([a, b, c]: [Vector3<f64>; 3], way: &Vector3<f64>) -> bool {
    // On one side of the way's line are all edges, and the ends of the way on either side of the plane.
    let sides = [(a, b), (b, c), (c, a)].map(|(p, q)| way.dot(&p.cross(&q)));
    let is_around = sides.iter().all(|side| *side >= 0.0) || sides.iter().all(|side| *side <= 0.0);
    let normal = (b - a).cross(&(c - a));
    let (first, last) = (normal.dot(&a), normal.dot(&(a - way)));
    is_around && first != last && first * last <= 0.0
}

/// Half of the solid angle of a triangle seen from the origin, above zero where it sees its corners clockwise: from inside.
pub(crate) fn half_angle([a, b, c]: [Vector3<f64>; 3]) -> f64 {
    let (la, lb, lc) = (a.norm(), b.norm(), c.norm());
    let volume = a.dot(&b.cross(&c));
    let spread = la * lb * lc + a.dot(&b) * lc + b.dot(&c) * la + c.dot(&a) * lb;
    volume.atan2(spread)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::slab;

    #[test]
    fn the_boundary_is_closed_and_points_outwards() {
        let size = [0.3, 0.2, 0.1];
        let mesh = slab(size, [3, 4, 2]).expect("a slab");
        let surface = mesh.surface();
        assert_eq!(surface.triangles.len(), 2 * 2 * (12 + 8 + 6));
        assert_eq!(surface.vertices.len(), 4 * 5 * 3 - 2 * 3);
        // Divergence theorem: the flux of x through the boundary is three times the volume.
        let mut flux = 0.0;
        let mut area = Vector3::zeros();
        for triangle in &surface.triangles {
            let p = triangle.map(|node| Vector3::from(mesh.points_m()[node as usize]));
            let a = (p[1] - p[0]).cross(&(p[2] - p[0])) * 0.5;
            flux += a.dot(&(p[0] + p[1] + p[2])) / 3.0;
            area += a;
        }
        assert!((flux - 3.0 * size.iter().product::<f64>()).abs() < 1e-15);
        assert!(area.norm() < 1e-16);
    }

    #[test]
    fn a_way_crosses_the_faces_between_its_ends() {
        let mesh = slab([0.2, 0.2, 0.1], [4, 4, 2]).expect("a slab");
        let surface = mesh.surface();
        let count = |from: [f64; 3], to: [f64; 3]| {
            let at = |node: u32| Vector3::from(mesh.points_m()[node as usize]);
            surface.crossed(at, &from.into(), &to.into()).count()
        };
        let (above, inside, below) = (0.03, -0.04, -0.13);
        let at = |z: f64| [0.0123, -0.0311, z];
        assert_eq!(count(at(above), at(below)), 2);
        assert_eq!(count(at(above), at(inside)), 1);
        assert_eq!(count(at(inside), at(below)), 1);
        assert_eq!(count(at(above), at(2.0 * above)), 0);
        assert_eq!(count(at(-0.03), at(inside)), 0);
        // Through a node and through an edge it does not slip between them.
        assert!(count([0.0, 0.0, above], [0.0, 0.0, inside]) > 1);
        assert!(count([0.0, 0.01, above], [0.0, 0.01, inside]) > 0);
        // Beside it.
        assert_eq!(count([0.3, 0.0, above], [0.3, 0.0, below]), 0);
    }

    #[test]
    fn normals_point_out_and_points_are_told_apart() {
        let mesh = slab([0.2, 0.2, 0.1], [4, 4, 2]).expect("a slab");
        let surface = mesh.surface();
        for (&node, normal) in surface.vertices.iter().zip(&surface.normals) {
            let p = mesh.points_m()[node as usize];
            let step = |way: f64| [0, 1, 2].map(|axis: usize| p[axis] + way * 1e-4 * normal[axis]);
            assert!(surface.contains(mesh.points_m(), step(-1.0)), "below {p:?}");
            assert!(!surface.contains(mesh.points_m(), step(1.0)), "above {p:?}");
        }
    }
}
