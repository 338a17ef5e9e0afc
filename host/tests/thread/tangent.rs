//! Derivatives against differences of pulls.

use super::*;
use sutura_host::thread::pull::PullStatus;

/// Tension, and forces on the ends.
fn pulled(solver: &mut ThreadSolver, path: &[PathPoint], outside: &[bool], a: f64) -> [f64; 7] {
    let pull = solver.pull(path, outside, a);
    assert!(matches!(pull.status, PullStatus::Ok | PullStatus::Strained));
    let (first, last) = (solver.end_force_n(false), solver.end_force_n(true));
    [
        first[0],
        first[1],
        first[2],
        last[0],
        last[1],
        last[2],
        pull.tension_n,
    ]
}

fn moved(path: &[PathPoint], coordinate: usize, by: f64) -> Vec<PathPoint> {
    let mut path = path.to_vec();
    let end = if coordinate < 3 { 0 } else { path.len() - 1 };
    if let PathPoint::Held(at) = &mut path[end] {
        at[coordinate % 3] += by;
    }
    path
}

#[test]
fn derivatives_are_those_of_differences() {
    let scene = Scene::new();
    let (whole_path, whole_outside) = stitches(&scene.mesh, 4);
    let points = whole_path.len();
    let mut solver = scene.solver(points, STRENGTH_N);
    let mut weak = scene.solver(points, 0.02);
    let mut checked = 0;
    let cases = [
        // Both ends held, the first only, the last only.
        (0..points, [true, true]),
        (0..points - 1, [true, false]),
        (1..points, [false, true]),
    ];
    let mut worst = 0.0f64;
    for (range, held) in cases {
        let path = &whole_path[range.clone()];
        let outside = &whole_outside[range.start..range.end - 1];
        let whole = length_m(&scene, path, outside, &scene.at_rest());
        for (share, strong) in [
            (0.95, true),
            (0.7, true),
            (0.45, true),
            (0.3, true),
            (0.3, false),
            (1.1, true),
        ] {
            let solver = if strong { &mut solver } else { &mut weak };
            let available = share * whole;
            let now = pulled(solver, path, outside, available);
            let tangent = solver.tangent();
            let step = 1e-6;
            let mut differences = [[0.0; 7]; 7];
            for (column, difference) in differences.iter_mut().enumerate() {
                // Fourth order.
                for (times, weight) in [(-2.0, 1.0), (-1.0, -8.0), (1.0, 8.0), (2.0, -1.0)] {
                    let by = times * step;
                    let at = if column < 6 {
                        pulled(solver, &moved(path, column, by), outside, available)
                    } else {
                        pulled(solver, path, outside, available + by)
                    };
                    for (difference, value) in difference.iter_mut().zip(at) {
                        *difference += weight * value / (12.0 * step);
                    }
                }
            }
            let largest = differences
                .iter()
                .flatten()
                .fold(0.0f64, |most, x| most.max(x.abs()));
            for (column, of_column) in differences.iter().enumerate() {
                for (row, &exact) in of_column.iter().enumerate() {
                    let own = match (row, column) {
                        (6, 6) => tangent.available_n_per_m,
                        (6, end) | (end, 6) => tangent.tension_n_per_m[end],
                        (row, column) => tangent.ends_n_per_m[row][column],
                    };
                    let off = (own - exact).abs() / largest.max(1e-9);
                    worst = worst.max(off);
                    assert!(off < 1e-6, "{share} {held:?} {row} {column}: {own} {exact}");
                }
            }
            if share > 1.0 {
                assert_eq!(largest, 0.0);
            } else {
                assert!(now[6] > 0.0);
                checked += 1;
            }
        }
    }
    println!("off by {worst:e} at most");
    assert_eq!(checked, 15);
}
