//! A thread pulled through two slabs.

use nalgebra::Vector3;
use std::sync::Arc;
use sutura_host::anchors::AnchorPoint;
use sutura_host::fem::{LinearTissue, Material};
use sutura_host::mesh::{TetMesh, slab};
use sutura_host::thread::pull::{PathPoint, Pull, PullStatus, ThreadSolver};

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

fn solver(mesh: &TetMesh, fixed: &[u32], points: usize) -> ThreadSolver {
    let tissue = LinearTissue::new(mesh, MATERIAL, fixed).expect("tissue");
    ThreadSolver::new(Arc::new(tissue), mesh.points_m(), points, 20.0).expect("a solver")
}

fn pulled(count: usize, shares: &[f64]) -> Vec<Pull> {
    let (mesh, fixed) = wound();
    let (path, outside) = stitches(&mesh, count);
    let mut solver = solver(&mesh, &fixed, path.len());
    let slack = solver.pull(&path, &outside, 10.0);
    println!("{count} stitches: slack {slack:?}");
    assert_eq!(slack.status, PullStatus::Ok);
    assert_eq!(slack.tension_n, 0.0);
    shares
        .iter()
        .map(|share| {
            let pull = solver.pull(&path, &outside, share * slack.length_m);
            println!(
                "{share}: {pull:?} ends {:?} {:?}",
                solver.end_force_n(false),
                solver.end_force_n(true)
            );
            pull
        })
        .collect()
}

#[test]
fn trace() {
    for count in [1, 3, 6] {
        pulled(count, &[0.99, 0.95, 0.9, 0.85, 0.8, 0.75, 0.7, 0.6, 0.5]);
    }
}
