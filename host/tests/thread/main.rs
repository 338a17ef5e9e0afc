//! A thread pulled through two slabs: against a cone programme, its laws, its ends, its extremes.

mod extremes;
mod laws;
mod oracle;
mod tangent;

use nalgebra::Vector3;
use std::sync::Arc;
use sutura_host::anchors::AnchorPoint;
use sutura_host::fem::{LinearTissue, Loads, Material, NodeLoad};
use sutura_host::mesh::{TetMesh, slab};
use sutura_host::thread::pull::{PathPoint, ThreadSolver};

/// More than any of these threads is pulled with.
const STRENGTH_N: f64 = 20.0;

const MATERIAL: Material = Material {
    youngs_modulus_pa: 20e3,
    poisson_ratio: 0.4,
};

/// Two slabs, 4 mm apart in x, their far ends held.
fn wound() -> (TetMesh, Vec<u32>) {
    let one = slab([0.02, 0.03, 0.008], [5, 7, 3]).expect("a slab");
    let at = |by: f64| {
        let points = one.points_m().iter().map(|p| [p[0] + by, p[1], p[2]]);
        TetMesh::new(points.collect(), one.cells().to_vec()).expect("the same slab")
    };
    let both = at(-0.012).beside(&at(0.012)).expect("apart");
    let fixed = (0u32..)
        .zip(both.points_m())
        .filter(|(_, p)| p[0].abs() > 0.0219)
        .map(|(node, _)| node)
        .collect();
    (both, fixed)
}

/// The point of the boundary nearest to `to`.
fn anchor(mesh: &TetMesh, to: [f64; 3]) -> AnchorPoint {
    let to = Vector3::from(to);
    let at = |node: u32| Vector3::from(mesh.points_m()[node as usize]);
    let node = (0..mesh.points_m().len() as u32)
        .min_by(|a, b| (at(*a) - to).norm().total_cmp(&(at(*b) - to).norm()))
        .expect("nodes");
    AnchorPoint {
        nodes: [node; 4],
        weights: [1.0, 0.0, 0.0, 0.0],
    }
}

/// A running stitch: through the left edge, over to the right one, and so on along y.
fn stitches(mesh: &TetMesh, count: usize) -> (Vec<PathPoint>, Vec<bool>) {
    let mut path = vec![PathPoint::Held([-0.01, -0.03, 0.02])];
    let mut outside = vec![true];
    for stitch in 0..count {
        let y = -0.012 + 0.024 * stitch as f64 / (count.max(2) - 1) as f64;
        let low = mesh
            .points_m()
            .iter()
            .map(|p| p[2])
            .fold(f64::MAX, f64::min);
        // Down through the left slab, across below, up through the right one, across above.
        for (x, z) in [(-0.004, 0.0), (-0.004, low), (0.004, low), (0.004, 0.0)] {
            path.push(PathPoint::Tissue(anchor(mesh, [x, y, z])));
        }
        outside.extend([false, true, false, true]);
    }
    path.push(PathPoint::Held([0.01, 0.03, 0.02]));
    (path, outside)
}

/// A wound and a thread.
struct Scene {
    mesh: TetMesh,
    fixed: Vec<u32>,
    tissue: Arc<LinearTissue>,
}

impl Scene {
    fn new() -> Self {
        let (mesh, fixed) = wound();
        let tissue = Arc::new(LinearTissue::new(&mesh, MATERIAL, &fixed).expect("tissue"));
        Self {
            mesh,
            fixed,
            tissue,
        }
    }

    fn solver(&self, points: usize, strength_n: f64) -> ThreadSolver {
        ThreadSolver::new(
            self.tissue.clone(),
            self.mesh.points_m(),
            points,
            strength_n,
        )
        .expect("a solver")
    }

    /// Displacement of all nodes by a whole solve.
    fn moved(&self, forces: impl Iterator<Item = (u32, [f64; 3])>) -> Vec<[f64; 3]> {
        let forces = forces
            .map(|(node, force_n)| NodeLoad { node, force_n })
            .collect();
        let loads = Loads {
            forces,
            ..Loads::default()
        };
        self.tissue.solve(&loads).expect("a balance").displacement_m
    }

    /// Where a point of a path is when nodes have `moved`.
    fn at(&self, point: &PathPoint, moved: &[[f64; 3]]) -> Vector3<f64> {
        match point {
            PathPoint::Held(at) => Vector3::from(*at),
            PathPoint::Tissue(anchor) => {
                let parts = anchor.nodes.iter().zip(anchor.weights);
                parts
                    .map(|(node, weight)| {
                        let node = *node as usize;
                        let rest = Vector3::from(self.mesh.points_m()[node]);
                        (rest + Vector3::from(moved[node])) * weight
                    })
                    .sum()
            }
        }
    }

    fn at_rest(&self) -> Vec<[f64; 3]> {
        vec![[0.0; 3]; self.mesh.points_m().len()]
    }

    /// Elastic energy \[J\] of what the thread has done: half its forces times how far they went.
    fn energy_j(&self, solver: &ThreadSolver) -> f64 {
        let moved = self.moved(solver.forces());
        solver
            .forces()
            .map(|(node, force)| {
                0.5 * Vector3::from(force).dot(&Vector3::from(moved[node as usize]))
            })
            .sum()
    }
}

/// Outside length of a path \[m\].
fn length_m(scene: &Scene, path: &[PathPoint], outside: &[bool], moved: &[[f64; 3]]) -> f64 {
    outside_segments(path, outside)
        .map(|(a, b)| (scene.at(&b, moved) - scene.at(&a, moved)).norm())
        .sum()
}

fn outside_segments<'a>(
    path: &'a [PathPoint],
    outside: &'a [bool],
) -> impl Iterator<Item = (PathPoint, PathPoint)> + 'a {
    path.windows(2)
        .zip(outside)
        .filter(|(_, outside)| **outside)
        .map(|(ends, _)| (ends[0], ends[1]))
}

/// SplitMix64.
struct Random(u64);

impl Random {
    fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    fn below(&mut self, most: usize) -> usize {
        ((self.unit() * most as f64) as usize).min(most - 1)
    }

    /// A point in a cell.
    fn point(&mut self, mesh: &TetMesh) -> PathPoint {
        let nodes = mesh.cells()[self.below(mesh.cells().len())];
        let weights = [0.0; 4].map(|_: f64| self.unit());
        let sum: f64 = weights.iter().sum();
        let weights = weights.map(|weight| weight / sum);
        PathPoint::Tissue(AnchorPoint { nodes, weights })
    }

    /// A path through random points, outside between some.
    fn path(&mut self, mesh: &TetMesh) -> (Vec<PathPoint>, Vec<bool>) {
        let count = 2 + self.below(9);
        let mut path: Vec<_> = (0..count).map(|_| self.point(mesh)).collect();
        let mut outside: Vec<_> = (1..count).map(|_| self.below(4) > 0).collect();
        for last in [false, true] {
            if self.below(3) > 0 {
                let at = PathPoint::Held([0.0; 3].map(|_: f64| 0.06 * (self.unit() - 0.5)));
                let place = if last { path.len() } else { 0 };
                path.insert(place, at);
                outside.insert(if last { outside.len() } else { 0 }, true);
            }
        }
        outside[0] = true;
        (path, outside)
    }
}
