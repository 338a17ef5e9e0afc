//! Several tools on one tissue.

use super::bench::{Bench, RADIUS, all_finite, at, ball, contact, force, pose, slab_mesh};
use super::rows::assert_reproduced;
use nalgebra::{UnitQuaternion, Vector3};
use sutura_host::fem::Loads;
use sutura_host::step::{State, Status};
use sutura_host::tool::{Shape, Tool, ToolSample};
use sutura_testkit::Random;

#[test]
fn two_tools_feel_each_other_through_the_tissue() {
    let (mesh, bottom) = slab_mesh();
    let tool = ball([0.0; 3]);
    let mut bench = Bench::new(
        &mesh,
        &bottom,
        Loads::default(),
        &[(0, tool.clone()), (5, tool)],
    );
    let left = at(-0.018, 0.0, RADIUS - 0.005);
    let right = ToolSample {
        id: 5,
        ..at(0.018, 0.0, RADIUS - 0.005)
    };
    let mut state = State::new(&bench.model);
    let both = bench.follow(&mut state, &[right, left]);
    assert_eq!((both.status, both.contacts().len()), (Status::Ok, 2));
    let [first, second] = both.contacts() else {
        panic!("two contacts")
    };
    assert_eq!((first.id, second.id), (5, 0));
    let mirrored = Vector3::new(-1.0, 1.0, 1.0).component_mul(&force(second));
    assert!((force(first) - mirrored).norm() < 1e-9 * force(first).norm());
    // The right one lifts off: the left one is alone and feels something else.
    let one = bench.follow(&mut state, &[left]);
    let alone = force(&contact(&one));
    assert!((alone - force(second)).norm() > 1e-3 * alone.norm());
    let mut fresh = State::new(&bench.model);
    let fresh = bench.follow(&mut fresh, &[left]);
    assert!((alone - force(&contact(&fresh))).norm() < 1e-9 * alone.norm());
}

/// What is felt is the same, and so are the tangents that are asked for.
#[test]
fn tangents_of_tools_that_nobody_asks_for_are_left_out() {
    let (mesh, bottom) = slab_mesh();
    let tool = ball([0.0; 3]);
    let tools = [(0, tool.clone()), (5, tool)];
    let mut bench = Bench::new(&mesh, &bottom, Loads::default(), &tools);
    let left = at(-0.018, 0.0, RADIUS - 0.005);
    let right = ToolSample {
        id: 5,
        ..at(0.018, 0.0, RADIUS - 0.005)
    };
    let mut feel = |tangents: Option<usize>| {
        bench.options.tangents = tangents;
        let mut state = State::new(&bench.model);
        let report = bench.follow(&mut state, &[right, left]);
        assert_eq!(report.status, Status::Ok);
        [report.contacts()[0], report.contacts()[1]]
    };
    let [first, second] = feel(None);
    for asked in 0..3 {
        let felt = feel(Some(asked));
        for (place, (felt, whole)) in felt.iter().zip([first, second]).enumerate() {
            assert!(force(&whole).norm() > 0.1 && whole.tangent[2][2] < -1.0);
            assert_eq!((felt.wrench, felt.rows), (whole.wrench, whole.rows));
            let expected = if place < asked {
                whole.tangent
            } else {
                Default::default()
            };
            assert_eq!(felt.tangent, expected);
        }
    }
}

/// Eight, side by side, are in balance in whatever order they come.
#[test]
fn eight_tools_press_at_once() {
    let (mesh, bottom) = slab_mesh();
    let ids = [0, 1, 2, 3, 4, 5, 6, 7];
    let tools = ids.map(|id| (id, ball([0.0; 3])));
    let mut bench = Bench::new(&mesh, &bottom, Loads::default(), &tools);
    let samples = ids.map(|id| {
        let (column, row) = (f64::from(id % 4), f64::from(id / 4));
        ToolSample {
            id,
            ..at(
                0.024 * (column - 1.5),
                0.03 * (row - 0.5),
                RADIUS - 1e-3 - 2e-4 * f64::from(id),
            )
        }
    });
    let mut solve = |samples: &[ToolSample]| {
        let mut state = State::new(&bench.model);
        let report = bench.follow(&mut state, samples);
        assert_eq!(
            (report.status, report.contacts().len()),
            (Status::Ok, samples.len())
        );
        (state, report)
    };
    let (state, report) = solve(&samples);
    let mut turned = samples;
    turned.rotate_left(3);
    let (_, again) = solve(&turned);
    for (place, contact) in report.contacts().iter().enumerate() {
        assert!(contact.rows > 0 && force(contact).z > 0.01, "{contact:?}");
        let other = &again.contacts()[(place + 8 - 3) % 8];
        assert_eq!(other.id, contact.id);
        let error = (force(other) - force(contact)).norm();
        assert!(error < 1e-9 * force(contact).norm(), "{error} N");
    }
    bench.assert_balanced(&state, &samples);
}

/// The tangent of one tool while another presses some of the same vertices and stays where it is.
#[test]
fn two_tools_may_touch_the_same_vertex() {
    let (mesh, bottom) = slab_mesh();
    let offset = [0.01, 0.0, -0.02];
    let tools = [(0, Tool::sphere(RADIUS, offset)), (5, ball([0.0; 3]))];
    let mut bench = Bench::new(&mesh, &bottom, Loads::default(), &tools);
    let other = ToolSample {
        id: 5,
        ..at(0.0045, 0.001, RADIUS - 0.005)
    };
    let grip = Vector3::new(-0.0045, 0.0, RADIUS - 0.0055) - Vector3::from(offset);
    let mut solve = |sample: ToolSample| {
        let mut state = State::new(&bench.model);
        let air = at(0.0, 0.0, 0.1);
        bench.follow(&mut state, &[air, ToolSample { id: 5, ..air }]);
        let report = bench.follow(&mut state, &[sample, other]);
        assert_eq!(report.status, Status::Ok);
        bench.assert_balanced(&state, &[sample, other]);
        let mut nodes: Vec<u32> = state.contact_forces(&bench.model).map(|at| at.0).collect();
        nodes.sort_unstable();
        (contact(&report), nodes)
    };
    let (here, nodes) = solve(pose(grip, UnitQuaternion::identity()));
    let shared = nodes.windows(2).filter(|pair| pair[0] == pair[1]).count();
    println!("{} touches, {shared} vertices twice", nodes.len());
    assert!(shared > 0, "no vertex is touched by both");
    let h = [2e-6, 1e-4];
    let mut worst = 0.0f64;
    for axis in 0..6 {
        let step = h[axis / 3];
        let mut by = Vector3::zeros();
        by[axis % 3] = step;
        let wrenches = [-2.0, -1.0, 1.0, 2.0].map(|way| {
            let (dx, turn) = if axis < 3 {
                (by * way, Vector3::zeros())
            } else {
                (Vector3::zeros(), by * way)
            };
            let (contact, touched) = solve(pose(grip + dx, UnitQuaternion::from_scaled_axis(turn)));
            assert_eq!(touched, nodes, "a switch");
            contact.wrench
        });
        let [mm, m, p, pp] = wrenches;
        for row in 0..6 {
            let expected = (8.0 * (p[row] - m[row]) - (pp[row] - mm[row])) / (12.0 * step);
            // Each block against the size that the arm gives it.
            let size = here.tangent[2][2].abs() * 0.02f64.powi((row / 3 + axis / 3) as i32);
            worst = worst.max((here.tangent[row][axis] - expected).abs() / size);
        }
    }
    println!("largest error {worst:.1e}");
    assert!(worst < 1e-6);
}

/// Two tools in one place leave open which of them pushes: they bear as little as they can, half each.
#[test]
fn two_tools_in_one_place_share_the_force() {
    let (mesh, bottom) = slab_mesh();
    let tools = [(0, ball([0.0; 3])), (5, ball([0.0; 3]))];
    let mut bench = Bench::new(&mesh, &bottom, Loads::default(), &tools);
    let mut state = State::new(&bench.model);
    let mut both = |state: &mut State, z: f64| {
        let sample = at(0.001, 0.0, z);
        let samples = [sample, ToolSample { id: 5, ..sample }];
        bench.follow(state, &samples)
    };
    assert_eq!(both(&mut state, 0.05).status, Status::Ok);
    let pressed = both(&mut state, RADIUS - 0.004);
    assert_eq!(pressed.status, Status::Ok);
    let [one, other] = pressed.contacts() else {
        panic!("two contacts")
    };
    let (one, other) = (force(one), force(other));
    assert!(
        (one - other).norm() < 1e-6 * one.norm(),
        "{one} and {other}"
    );
    let air = both(&mut state, 0.05);
    assert_eq!((air.status, air.rows), (Status::Ok, 0));
    let mut alone = Bench::slab(ball([0.0; 3]));
    let (_, whole) = alone.afresh(at(0.001, 0.0, 0.05), at(0.001, 0.0, RADIUS - 0.004));
    let whole = force(&contact(&whole));
    assert!((one + other - whole).norm() < 1e-6 * whole.norm());
}

/// Three tools anywhere, at once, one or two of them gone again: every balance is one, every vertex that two
/// of them touch shares its force between them, and rows are there and reproduce the tangent.
#[test]
fn wild_motion_of_three_tools_never_breaks_the_solver() {
    let (mesh, bottom) = slab_mesh();
    let shape = Shape::FlatPunch {
        radius_m: RADIUS,
        fillet_m: 0.3 * RADIUS,
        length_m: 0.04,
    };
    let tools = [
        (0, Tool::new(shape.clone(), [0.0, 0.0, -0.02])),
        (5, ball([0.0; 3])),
        (6, Tool::new(shape, [0.0; 3])),
    ];
    let mut bench = Bench::new(&mesh, &bottom, Loads::default(), &tools);
    bench.options.most_rows = sutura_host::step::MAX_TOOL_ROWS;
    let mut state = State::new(&bench.model);
    let mut random = Random::new(99);
    let mut seen = std::collections::BTreeMap::new();
    let (mut shared, mut turning, mut not) = (0, 0, 0);
    for tick in 0..240 {
        let samples = [(0, 0.03), (5, 0.02), (6, 0.02)].map(|(id, height)| ToolSample {
            id,
            ..pose(
                random.vector() * 0.025 + Vector3::z() * height,
                UnitQuaternion::from_scaled_axis(random.vector() * 0.4),
            )
        });
        let samples = &samples[..1 + tick % 3];
        let mut report = bench.follow(&mut state, samples);
        for _ in 0..3 {
            if report.status == Status::Behind {
                report = bench.follow(&mut state, samples);
            }
        }
        assert!(all_finite(&report));
        *seen.entry(report.status.name()).or_insert(0) += 1;
        if report.status != Status::Ok {
            continue;
        }
        bench.assert_balanced(&state, samples);
        let mut nodes: Vec<u32> = state.contact_forces(&bench.model).map(|at| at.0).collect();
        nodes.sort_unstable();
        shared += nodes.windows(2).filter(|pair| pair[0] == pair[1]).count();
        for contact in report.contacts().iter().filter(|contact| contact.rows > 0) {
            let rows = bench.work.rows(contact.id).expect("rows");
            assert!(rows.count > 0);
            if rows.turning {
                turning += 1;
            } else {
                not += 1;
                assert_reproduced(rows, contact, "without turning");
            }
        }
    }
    println!("{seen:?}, {shared} shared, rows with turning normals {turning}, without {not}");
    assert!(seen["ok"] > 200 && shared > 0 && turning > 0 && not > 0);
}
