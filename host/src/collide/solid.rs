//! Bodies by their cells, and how deep one reaches into another: for reports on meshes, not for steps.
//!
//! Entry points: [`Solid::new`], [`Solid::penetration_into`]. A point is inside where a cell has it; allocates.

use super::patch::closest;
use super::shell::Shell;
use crate::boxes::{Bounds, Tree};
use crate::mesh::signed_volume;
use nalgebra::Vector3;
use std::collections::HashMap;

/// Parts of an edge at whose ends it is looked at.
const SAMPLES: u32 = 8;

/// One body of a mesh.
pub struct Solid<'a> {
    points_m: &'a [[f64; 3]],
    cells: &'a [[u32; 4]],
    of_cells: Tree,
    /// Boundary triangles, (f x 3), of either orientation.
    faces: Vec<[u32; 3]>,
    of_faces: Tree,
}

/// Part of a body that lies in another one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Penetration {
    /// Nodes in the other body.
    pub nodes: usize,
    /// Largest distance from a point there to the other body's boundary \[m\].
    pub depth_m: f64,
    /// That point \[m\], (3).
    pub at_m: [f64; 3],
}

impl<'a> Solid<'a> {
    /// Makes a body of `cells` (m x 4) between points \[m\] (n x 3).
    pub fn new(points_m: &'a [[f64; 3]], cells: &'a [[u32; 4]]) -> Self {
        let faces = boundary(cells);
        let around = |nodes: &[u32]| {
            let nodes = nodes.iter().map(|node| place(points_m, *node));
            nodes.fold(Bounds::NOTHING, |all, at| all.with(&at))
        };
        Self {
            points_m,
            cells,
            of_cells: Tree::new(cells.len() as u32, |cell| around(&cells[cell as usize])),
            of_faces: Tree::new(faces.len() as u32, |face| around(&faces[face as usize])),
            faces,
        }
    }

    /// Mean length of the boundary's edges \[m\].
    pub fn mean_edge_m(&self) -> f64 {
        let shell = Shell::new(&self.faces);
        let lengths = shell
            .edges()
            .map(|[a, b]| self.place(a).metric_distance(&self.place(b)));
        let (count, sum) = lengths.fold((0u32, 0.0), |(count, sum), length| {
            (count + 1, sum + length)
        });
        sum / f64::from(count.max(1))
    }

    /// Returns this body's part that lies in the other by more than `least_m`, by its nodes and by points along the edges of its boundary.
    pub fn penetration_into(&self, other: &Self, least_m: f64) -> Option<Penetration> {
        let within = other.of_cells.bounds();
        if !self.of_cells.bounds().meets(&within) {
            return None;
        }
        let mut found = Penetration {
            nodes: 0,
            depth_m: 0.0,
            at_m: [0.0; 3],
        };
        let mut look = |point: Vector3<f64>| {
            let depth_m = other.depth_m(&point);
            if depth_m > found.depth_m {
                (found.depth_m, found.at_m) = (depth_m, point.into());
            }
            depth_m > least_m
        };
        let mut nodes: Vec<u32> = self.cells.iter().flatten().copied().collect();
        nodes.sort_unstable();
        nodes.dedup();
        let count = nodes.into_iter().filter(|node| look(self.place(*node)));
        let count = count.count();
        for [a, b] in Shell::new(&self.faces).edges() {
            let (from, to) = (self.place(a), self.place(b));
            if Bounds::NOTHING.with(&from).with(&to).meets(&within) {
                for sample in 1..SAMPLES {
                    look(from.lerp(&to, f64::from(sample) / f64::from(SAMPLES)));
                }
            }
        }
        found.nodes = count;
        (found.depth_m > least_m).then_some(found)
    }

    /// Distance from a point inside to the boundary \[m\], 0 outside.
    fn depth_m(&self, point: &Vector3<f64>) -> f64 {
        let mut is_inside = false;
        self.of_cells.near(&Bounds::NOTHING.with(point), |cell| {
            is_inside |= self.cell_has(self.cells[cell as usize], point);
        });
        if !is_inside {
            return 0.0;
        }
        let squared = self.of_faces.least(
            |bounds| bounds.distance_squared(point),
            |face| {
                let corners = self.faces[face as usize].map(|node| self.place(node) - point);
                closest(&corners).point.norm_squared()
            },
        );
        squared.sqrt()
    }

    /// Whether a point lies in a cell or on its boundary.
    fn cell_has(&self, cell: [u32; 4], point: &Vector3<f64>) -> bool {
        let corners = cell.map(|node| self.place(node));
        let whole = signed_volume(&corners);
        let share = |corner: usize| {
            let mut part = corners;
            part[corner] = *point;
            signed_volume(&part) / whole
        };
        // A cell without volume has no number there, and no point.
        (0..4).all(|corner| share(corner) >= 0.0)
    }

    fn place(&self, node: u32) -> Vector3<f64> {
        place(self.points_m, node)
    }
}

fn place(points_m: &[[f64; 3]], node: u32) -> Vector3<f64> {
    Vector3::from(points_m[node as usize])
}

/// Faces that one cell alone has, (f x 3), in the order of the cells.
fn boundary(cells: &[[u32; 4]]) -> Vec<[u32; 3]> {
    let faces = || {
        cells.iter().flat_map(|&[a, b, c, d]| {
            [[b, c, d], [a, c, d], [a, b, d], [a, b, c]].map(|mut face| {
                face.sort_unstable();
                face
            })
        })
    };
    let mut count: HashMap<[u32; 3], u32> = HashMap::with_capacity(3 * cells.len());
    for face in faces() {
        *count.entry(face).or_default() += 1;
    }
    faces().filter(|face| count[face] == 1).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::slab;

    /// A cube of 2 cm with edges of a centimetre between its nodes, moved.
    fn cube(by: [f64; 3]) -> (Vec<[f64; 3]>, Vec<[u32; 4]>) {
        let mesh = slab([0.02; 3], [2; 3]).expect("a cube");
        let points = mesh.points_m().iter();
        let moved = points.map(|at| [0, 1, 2].map(|axis| at[axis] + by[axis]));
        (moved.collect(), mesh.cells().to_vec())
    }

    fn found(by: [f64; 3], least_m: f64) -> [Option<Penetration>; 2] {
        let ((one_at, one), (other_at, other)) = (cube([0.0; 3]), cube(by));
        let (one, other) = (Solid::new(&one_at, &one), Solid::new(&other_at, &other));
        let mesh = slab([0.02; 3], [2; 3]).expect("a cube");
        let edge_m = mesh.surface().mean_edge_m;
        assert!((one.mean_edge_m() / edge_m - 1.0).abs() < 1e-12);
        [
            one.penetration_into(&other, least_m),
            other.penetration_into(&one, least_m),
        ]
    }

    #[test]
    fn nodes_of_a_cube_lie_in_another_as_deep_as_it_was_moved() {
        let [up, down] = found([0.003, 0.002, 0.019], 1e-4).map(|some| some.expect("overlap"));
        for (side, count) in [(up, 4), (down, 4)] {
            assert!((side.depth_m - 0.001).abs() < 1e-12, "{side:?}");
            assert_eq!(side.nodes, count, "{side:?}");
        }
        // By less than what is asked for, side by side, and apart.
        for (by, least_m) in [
            ([0.003, 0.002, 0.019], 0.0011),
            ([0.0, 0.0, 0.02], 1e-9),
            ([0.0, 0.0, 0.021], 0.0),
            ([0.0, 0.019, 0.021], 0.0),
        ] {
            assert_eq!(found(by, least_m), [None; 2], "{by:?}");
        }
        // At the very same place every node on the boundary is on the other's; the one inside is not.
        let [same, _] = found([0.0; 3], 1e-4);
        assert_eq!(same.map(|same| same.nodes), Some(1));
    }

    /// A bar through a cube has no node in it.
    #[test]
    fn edges_that_go_through_are_found() {
        let (at, cells) = cube([0.0; 3]);
        let bar = slab([0.1, 0.004, 0.004], [1; 3]).expect("a bar");
        let moved = bar.points_m().iter().map(|[x, y, z]| [*x, *y, z - 0.005]);
        let moved: Vec<_> = moved.collect();
        let (cube, bar) = (Solid::new(&at, &cells), Solid::new(&moved, bar.cells()));
        let through = bar.penetration_into(&cube, 1e-4).expect("it goes through");
        assert_eq!(through.nodes, 0);
        assert!(through.depth_m > 0.004, "{through:?}");
    }
}
