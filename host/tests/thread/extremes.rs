//! Whatever is asked for: a status, bounded forces, no NaN.

use super::*;
use sutura_host::thread::pull::{Pull, PullStatus};

/// A sound answer: finite, no force beyond the tension, no tension beyond the strength.
fn sound(solver: &ThreadSolver, pull: &Pull, strength_n: f64, points: usize) {
    assert!(
        pull.tension_n >= 0.0 && pull.tension_n <= strength_n,
        "{pull:?}"
    );
    assert!(pull.length_m.is_finite());
    let bound = pull.tension_n * (1.0 + 1e-9);
    for segment in 0..points {
        assert!(Vector3::from(solver.segment_force_n(segment)).norm() <= bound);
    }
    let sum: f64 = solver.forces().map(|(_, f)| Vector3::from(f).norm()).sum();
    assert!(sum <= 2.0 * bound * points as f64 * 4.0);
    assert!((0..points).all(|at| {
        solver
            .anchor_m(at)
            .is_none_or(|at| at.iter().all(|x| x.is_finite()))
    }));
}

fn tissue(nodes: [u32; 4], weights: [f64; 4]) -> PathPoint {
    PathPoint::Tissue(AnchorPoint { nodes, weights })
}

#[test]
fn extreme_paths_end_in_balance_or_at_the_strength() {
    let scene = Scene::new();
    let mesh = &scene.mesh;
    let cell = mesh.cells()[mesh.cells().len() / 2];
    let other = mesh.cells()[7];
    let node = |nodes: [u32; 4], index: usize| tissue([nodes[index]; 4], [1.0, 0.0, 0.0, 0.0]);
    let one_cell = |count: usize| -> Vec<PathPoint> {
        let mut random = Random(5);
        (0..count)
            .map(|_| {
                let weights = [0.0; 4].map(|_: f64| random.unit());
                let sum: f64 = weights.iter().sum();
                tissue(cell, weights.map(|w| w / sum))
            })
            .collect()
    };
    let fixed = |index: usize| tissue([scene.fixed[index]; 4], [1.0, 0.0, 0.0, 0.0]);
    let held = |x: f64| PathPoint::Held([x, 0.0, 0.02]);
    let mut in_one = one_cell(12);
    in_one.insert(0, held(-0.02));
    in_one.push(held(0.02));
    let paths: Vec<Vec<PathPoint>> = vec![
        stitches(mesh, 6).0,
        in_one,
        one_cell(9),
        vec![fixed(0), fixed(5)],
        vec![held(-0.01), fixed(0), fixed(5), held(0.01)],
        vec![
            held(-0.01),
            node(cell, 0),
            fixed(5),
            node(other, 1),
            held(0.01),
        ],
        // Points that are the same from the start.
        vec![node(cell, 0), node(cell, 0)],
        vec![
            held(0.0),
            node(cell, 0),
            node(cell, 0),
            node(other, 0),
            node(other, 0),
            held(0.01),
        ],
        vec![node(cell, 0), node(other, 0), node(cell, 0), node(other, 0)],
        // One segment.
        vec![node(cell, 0), node(other, 0)],
        vec![held(0.0), node(other, 0)],
        vec![held(0.0), held(0.01)],
        // An end that is where its point is.
        vec![
            PathPoint::Held(mesh.points_m()[cell[0] as usize]),
            node(cell, 0),
        ],
    ];
    for strength in [0.05, STRENGTH_N] {
        for (index, path) in paths.iter().enumerate() {
            for every in [true, false] {
                let outside: Vec<bool> = if index == 0 {
                    stitches(mesh, 6).1
                } else {
                    let last = path.len() - 2;
                    (0..=last)
                        .map(|at| every || at % 2 == 0 || at == last)
                        .collect()
                };
                let mut solver = scene.solver(path.len(), strength);
                let whole = length_m(&scene, path, &outside, &scene.at_rest());
                for share in [1.0, 0.5, 0.1, 1e-3, 0.0] {
                    let available = share * whole;
                    let pull = solver.pull(path, &outside, available);
                    sound(&solver, &pull, strength, path.len());
                    let what = format!("{strength} N, path {index}, {share}: {pull:?}");
                    match pull.status {
                        PullStatus::Ok => assert!(pull.length_m <= available + 1e-6, "{what}"),
                        PullStatus::Strained => {
                            assert!(
                                pull.tension_n == strength && pull.length_m > available,
                                "{what}"
                            );
                        }
                        _ => panic!("{what}"),
                    }
                }
            }
        }
    }
}

/// Ends ten times as far as there is thread for, and hands that jump.
#[test]
fn ends_pulled_too_far_strain_the_thread_or_the_tissue() {
    let scene = Scene::new();
    let (mut path, outside) = stitches(&scene.mesh, 6);
    let last = path.len() - 1;
    for strength in [0.05, STRENGTH_N] {
        let mut solver = scene.solver(path.len(), strength);
        let mut strained = 0;
        for (x, available) in [
            (0.01, 0.1),
            (1.0, 0.1),
            (100.0, 0.1),
            (0.01, 0.0),
            (1e5, 0.0),
            (0.0, 0.1),
        ] {
            path[0] = PathPoint::Held([-x, 0.0, 0.01]);
            path[last] = PathPoint::Held([x, 0.1 * x, 0.01]);
            let pull = solver.pull(&path, &outside, available);
            sound(&solver, &pull, strength, path.len());
            assert!(
                matches!(pull.status, PullStatus::Ok | PullStatus::Strained),
                "{x}: {pull:?}"
            );
            strained += u32::from(pull.status == PullStatus::Strained);
        }
        assert!(strained >= 2, "{strained}");
    }
}

#[test]
fn what_is_no_path_is_said_to_be_none() {
    let scene = Scene::new();
    let (path, outside) = stitches(&scene.mesh, 2);
    let mut solver = scene.solver(path.len(), STRENGTH_N);
    let whole = length_m(&scene, &path, &outside, &scene.at_rest());
    let with = |index: usize, point: PathPoint| {
        let mut path = path.clone();
        path[index] = point;
        path
    };
    let bad = [
        (with(0, PathPoint::Held([f64::NAN, 0.0, 0.0])), 0.1),
        (with(0, PathPoint::Held([f64::INFINITY, 0.0, 0.0])), 0.1),
        (with(0, PathPoint::Held([1e200, 0.0, 0.0])), 0.1),
        (with(3, PathPoint::Held([0.0; 3])), 0.1),
        (with(3, tissue([0; 4], [0.5, 0.0, 0.0, 0.0])), 0.1),
        (with(3, tissue([0; 4], [f64::NAN; 4])), 0.1),
        (with(3, tissue([u32::MAX; 4], [1.0, 0.0, 0.0, 0.0])), 0.1),
        (path[..5].to_vec(), 0.1),
        (Vec::new(), 0.1),
        (path.clone(), f64::NAN),
        (path.clone(), f64::INFINITY),
        (path.clone(), -0.1),
    ];
    let good = path.clone();
    for (index, (path, available)) in bad.iter().enumerate() {
        let before = solver.pull(&good, &outside, 0.6 * whole);
        assert_eq!(before.status, PullStatus::Ok);
        let pull = solver.pull(path, &outside, *available);
        assert_eq!(pull.status, PullStatus::Malformed, "{index}");
        assert_eq!((pull.tension_n, pull.solves, pull.welds), (0.0, 0, 0));
        assert_eq!(solver.forces().count(), 0);
        assert_eq!(solver.end_force_n(true), [0.0; 3]);
        assert_eq!(solver.tangent().available_n_per_m, 0.0);
    }
    let mut small = scene.solver(3, STRENGTH_N);
    assert_eq!(
        small.pull(&path, &outside, 0.1).status,
        PullStatus::Malformed
    );
    for strength in [f64::NAN, f64::INFINITY, -1.0] {
        let mut none = scene.solver(path.len(), strength);
        assert_eq!(
            none.pull(&path, &outside, 0.1).status,
            PullStatus::Malformed
        );
    }
}

#[test]
fn a_pull_allocates_nothing_once_it_has_columns() {
    let scene = Scene::new();
    let (path, outside) = stitches(&scene.mesh, 8);
    let mut solver = scene.solver(path.len(), STRENGTH_N);
    let whole = length_m(&scene, &path, &outside, &scene.at_rest());
    solver.pull(&path, &outside, whole);
    let (mut taut, mut finite) = (0, true);
    let allocated = allocation_counter::measure(|| {
        for step in 0..100 {
            let pull = solver.pull(&path, &outside, whole * (1.05 - 0.0105 * f64::from(step)));
            taut += u32::from(pull.tension_n > 0.0);
            finite &= solver.tangent().available_n_per_m.is_finite();
        }
    });
    assert!(taut > 80 && finite);
    assert_eq!(allocated.count_total, 0);
}
