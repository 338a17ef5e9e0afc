//! Complementarity, balance and energy.

use super::*;
use sutura_host::thread::pull::{LENGTH_TOLERANCE_M, PullStatus};

const SHARES: [f64; 12] = [
    1.2, 1.000001, 0.99, 0.95, 0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2,
];

#[test]
fn slack_thread_pulls_nothing_and_taut_thread_has_its_length() {
    let scene = Scene::new();
    let mut most = 0;
    for count in [1, 2, 3, 6, 8] {
        let (path, outside) = stitches(&scene.mesh, count);
        let mut solver = scene.solver(path.len(), STRENGTH_N);
        let whole = length_m(&scene, &path, &outside, &scene.at_rest());
        let mut welds = 0;
        for share in SHARES {
            let available = share * whole;
            let pull = solver.pull(&path, &outside, available);
            assert_eq!(pull.status, PullStatus::Ok, "{count} {share}");
            most = most.max(pull.solves);
            welds += pull.welds;
            // The true length, where a whole solve under the thread's forces says that the tissue is.
            let moved = scene.moved(solver.forces());
            let length = length_m(&scene, &path, &outside, &moved);
            assert!((length - pull.length_m).abs() < 1e-9);
            if share >= 1.0 {
                assert_eq!((pull.tension_n, pull.welds), (0.0, 0));
                assert_eq!(solver.forces().map(|(_, f)| f[0].abs()).sum::<f64>(), 0.0);
            } else {
                assert!(pull.tension_n > 0.0);
                assert!((length - available).abs() <= LENGTH_TOLERANCE_M, "{length}");
            }
            // No segment pushes; those that are open pull with all of the tension, along themselves.
            let segments = outside_segments(&path, &outside).enumerate();
            for (segment, (a, b)) in segments {
                let way = scene.at(&b, &moved) - scene.at(&a, &moved);
                let force = Vector3::from(solver.segment_force_n(segment));
                let most = pull.tension_n;
                assert!(force.norm() <= most * (1.0 + 1e-12));
                if way.norm() > 1e-6 {
                    let off = (force - way.normalize() * most).norm();
                    assert!(off <= 1e-6 * most, "{count} {share} {segment}: {off:e}");
                }
            }
        }
        assert!(welds > 0, "{count}");
    }
    println!("at most {most} solves");
    assert!(most <= 40, "{most}");
}

/// Ends and tissue pull on each other: the forces on nodes and those on the ends sum to nothing, and to no torque.
#[test]
fn ends_bear_what_the_tissue_bears() {
    let scene = Scene::new();
    let (path, outside) = stitches(&scene.mesh, 5);
    let mut solver = scene.solver(path.len(), STRENGTH_N);
    let whole = length_m(&scene, &path, &outside, &scene.at_rest());
    for share in [0.9, 0.6, 0.3] {
        let pull = solver.pull(&path, &outside, share * whole);
        assert_eq!(pull.status, PullStatus::Ok);
        let moved = scene.moved(solver.forces());
        let (mut force, mut torque) = (Vector3::zeros(), Vector3::zeros());
        let mut add = |at: Vector3<f64>, by: Vector3<f64>| {
            force += by;
            torque += at.cross(&by);
        };
        for (node, by) in solver.forces() {
            let at = Vector3::from(scene.mesh.points_m()[node as usize])
                + Vector3::from(moved[node as usize]);
            add(at, by.into());
        }
        let ends = [(path[0], false), (path[path.len() - 1], true)];
        for (end, last) in ends {
            let by = Vector3::from(solver.end_force_n(last));
            assert!((by.norm() - pull.tension_n).abs() < 1e-9 * pull.tension_n);
            add(scene.at(&end, &moved), by);
        }
        assert!(force.norm() < 1e-10 * pull.tension_n, "{force}");
        assert!(torque.norm() < 1e-8 * pull.tension_n * whole, "{torque}");
    }
}

/// No friction: what the hands put in, by drawing thread in and by moving the ends, is what the tissue stores.
#[test]
fn work_at_the_ends_and_of_the_pull_is_stored() {
    let scene = Scene::new();
    let (path, outside) = stitches(&scene.mesh, 4);
    let whole = length_m(&scene, &path, &outside, &scene.at_rest());
    let last = path.len() - 1;
    let held = |point: PathPoint, by: Vector3<f64>| match point {
        PathPoint::Held(at) => PathPoint::Held((Vector3::from(at) + by).into()),
        point => point,
    };
    let errors = [25, 50, 100].map(|steps| {
        let mut solver = scene.solver(path.len(), STRENGTH_N);
        let mut path_now = path.clone();
        let (mut work, mut before) = (0.0, (0.0, [Vector3::zeros(); 2]));
        let hands = |t: f64| {
            let turn = (std::f64::consts::TAU * t).sin();
            [
                Vector3::new(-0.01 * t, 0.004 * turn, 0.0),
                Vector3::new(0.0, 0.006 * t, 0.005 * turn),
            ]
        };
        let dt = 1.0 / f64::from(steps);
        for step in 0..=steps {
            let t = f64::from(step) * dt;
            let by = hands(t);
            path_now[0] = held(path[0], by[0]);
            path_now[last] = held(path[last], by[1]);
            let pull = solver.pull(&path_now, &outside, whole * (1.01 - 0.6 * t));
            assert_eq!(pull.status, PullStatus::Ok);
            let ends = [false, true].map(|last| Vector3::from(solver.end_force_n(last)));
            if step > 0 {
                let from = hands(t - dt);
                work += 0.5 * (pull.tension_n + before.0) * whole * 0.6 * dt;
                for end in 0..2 {
                    // The hand bears the opposite of what the thread does to it.
                    work -= 0.5 * (ends[end] + before.1[end]).dot(&(by[end] - from[end]));
                }
            }
            before = (pull.tension_n, ends);
        }
        let stored = scene.energy_j(&solver);
        assert!(stored > 1e-5);
        (work / stored - 1.0).abs()
    });
    println!("energy off by {errors:?}");
    assert!(errors[0] < 0.01, "{errors:?}");
    assert!(errors[2] < 0.5 * errors[0], "{errors:?}");
}

#[test]
fn the_answer_does_not_depend_on_the_last_pull() {
    let scene = Scene::new();
    let (path, outside) = stitches(&scene.mesh, 6);
    let mut warm = scene.solver(path.len(), STRENGTH_N);
    let whole = length_m(&scene, &path, &outside, &scene.at_rest());
    let (mut random, mut fewer) = (Random(3), 0);
    for _ in 0..40 {
        let available = random.unit() * whole;
        let again = warm.pull(&path, &outside, available);
        let cold_start = scene
            .solver(path.len(), STRENGTH_N)
            .pull(&path, &outside, available);
        assert_eq!(again.status, cold_start.status);
        let off = (again.tension_n - cold_start.tension_n).abs();
        assert!(off <= 1e-7 * cold_start.tension_n, "{available}: {off:e}");
        // The same again costs next to nothing.
        let same = warm.pull(&path, &outside, available);
        assert!(same.solves <= 2);
        fewer += u32::from(same.solves < cold_start.solves);
    }
    assert!(fewer > 30, "{fewer}");
}
