//! Bad poses, jumps, missing columns, tools that cannot be, same bits.

use super::bench::{Bench, RADIUS, SOFT, all_finite, at, ball, contact, force, pose, slab_mesh};
use nalgebra::{UnitQuaternion, Vector3};
use std::collections::hash_map::DefaultHasher;
use std::hash::Hasher;
use sutura_host::fem::Loads;
use sutura_host::model::{Model, ModelError, Warning};
use sutura_host::step::{State, Status, StepOptions, Workspace, step};
use sutura_host::tool::{Tool, ToolSample};
use sutura_testkit::Random;

#[test]
fn bad_poses_get_a_status_and_the_state_recovers() {
    let mut bench = Bench::slab(ball([0.0; 3]));
    let press = at(0.003, 0.001, RADIUS - 0.006);
    let (_, undisturbed) = bench.afresh(at(0.0, 0.0, 0.05), press);
    let expected = contact(&undisturbed);

    let quaternion = |orientation| ToolSample {
        orientation,
        ..press
    };
    let bad = [
        ("nan", at(f64::NAN, 0.0, 0.0), Some(Status::NotFinite)),
        (
            "infinite",
            at(0.0, f64::INFINITY, 0.0),
            Some(Status::NotFinite),
        ),
        ("huge", at(0.0, 0.0, 1e300), Some(Status::NotFinite)),
        (
            "no quaternion",
            quaternion([0.0; 4]),
            Some(Status::NotFinite),
        ),
        (
            "nan quaternion",
            quaternion([f64::NAN; 4]),
            Some(Status::NotFinite),
        ),
        (
            "unknown id",
            ToolSample { id: 9, ..press },
            Some(Status::UnknownTool),
        ),
        ("far away", at(50.0, -20.0, 9.0), Some(Status::Ok)),
        ("other side", at(0.0, 0.0, -0.2), None),
        ("deep", at(0.0, 0.0, -0.002), None),
        ("through the table", at(0.0, 0.0, -0.03), None),
        ("into the side", at(0.03, 0.01, -0.01), None),
    ];
    for start in [at(0.0, 0.0, 0.05), press] {
        for (name, sample, status) in bad {
            let mut state = State::new(&bench.model);
            bench.step(&mut state, at(0.0, 0.0, 0.05));
            bench.step(&mut state, start);
            let kept = state.clone();
            let report = bench.step(&mut state, sample);
            println!(
                "{name}: {:?}, {} substeps, {} rows",
                report.status, report.substeps, report.rows
            );
            assert!(all_finite(&report), "{name}");
            if let Some(status) = status {
                assert_eq!(report.status, status, "{name}");
            }
            if matches!(report.status, Status::NotFinite | Status::UnknownTool) {
                assert_eq!(state, kept, "{name} leaves the state as it was");
            }
            if report.status != Status::Ok {
                assert!(
                    report.contacts().is_empty(),
                    "{name}: no contact without a balance"
                );
            }
            // Back into the air and down again: as if nothing had been.
            let air = bench.step(&mut state, at(0.0, 0.0, 0.05));
            assert_eq!((air.status, air.rows), (Status::Ok, 0), "{name}");
            let again = contact(&bench.step(&mut state, press));
            let error = (force(&again) - force(&expected)).norm() / force(&expected).norm();
            assert!(
                error < 1e-9,
                "{name}: the force afterwards is off by {error:e}"
            );
        }
    }
}

#[test]
fn wild_motion_never_breaks_the_solver() {
    let mut bench = Bench::slab(ball([0.0, 0.0, -0.02]));
    bench.options.vertices_per_step = Some(40);
    let mut random = Random::new(3);
    let mut state = State::new(&bench.model);
    let mut seen = std::collections::BTreeMap::new();
    for tick in 0..600 {
        let position = random.vector() * 0.05 + Vector3::z() * 0.03;
        let rotation = UnitQuaternion::from_scaled_axis(random.vector());
        let sample = pose(position, rotation);
        let report = bench.step(&mut state, sample);
        assert!(all_finite(&report), "tick {tick}");
        *seen.entry(report.status.name()).or_insert(0) += 1;
        if report.status == Status::Ok && tick % 5 == 0 {
            bench.assert_balanced(&state, &[sample]);
        }
    }
    println!("{seen:?}");
    assert!(seen["ok"] > 300, "{seen:?}");
    let air = bench.step(&mut state, at(0.0, 0.0, 0.1));
    assert_eq!((air.status, air.rows), (Status::Ok, 0));
}

#[test]
fn a_sphere_that_touches_too_much_says_so() {
    let (mesh, bottom) = slab_mesh();
    let tool = Tool::sphere(0.4, [0.0; 3]);
    let mut bench = Bench::new(&mesh, &bottom, Loads::default(), &[(0, tool)]);
    let mut state = State::new(&bench.model);
    assert_eq!(bench.step(&mut state, at(0.0, 0.0, 0.41)).rows, 0);
    let light = bench.step(&mut state, at(0.0, 0.0, 0.4 - 2e-4));
    assert_eq!(light.status, Status::Ok);
    let deep = bench.step(&mut state, at(0.0, 0.0, 0.4 - 8e-3));
    assert_eq!(
        (deep.status, deep.contacts().len()),
        (Status::TooManyRows, 0)
    );
    let again = bench.step(&mut state, at(0.0, 0.0, 0.4 - 2e-4));
    let (before, after) = (force(&contact(&light)), force(&contact(&again)));
    assert!(
        (before - after).norm() < 1e-9 * before.norm(),
        "{before} and {after}"
    );
}

/// It comes from outside to where it is, as one that was seen on its way.
#[test]
fn a_first_sample_may_touch_and_be_inside() {
    let mut bench = Bench::slab(ball([0.0; 3]));
    for height in [RADIUS - 0.006, RADIUS - 0.009, RADIUS - 0.012] {
        let press = at(0.003, 0.001, height);
        let (_, path) = bench.afresh(at(0.003, 0.001, 0.05), press);
        let mut state = State::new(&bench.model);
        let cold = bench.step(&mut state, press);
        assert_eq!((cold.status, path.status), (Status::Ok, Status::Ok));
        let (cold, path) = (force(&contact(&cold)), force(&contact(&path)));
        assert!(
            (cold - path).norm() < 1e-9 * path.norm(),
            "{height}: {cold} and {path}"
        );
    }
}

#[test]
fn a_teleport_in_contact_ends_where_a_walk_ends() {
    let mut bench = Bench::slab(ball([0.0; 3]));
    let (from, to) = (
        at(-0.02, -0.015, RADIUS - 0.004),
        at(0.02, 0.01, RADIUS - 0.007),
    );
    let (_, fresh) = bench.afresh(at(0.02, 0.01, 0.05), to);
    let (mut state, _) = bench.afresh(at(-0.02, -0.015, 0.05), from);
    let mut report = bench.step(&mut state, to);
    assert!(report.substeps > 1);
    for _ in 0..10 {
        if report.status != Status::Behind {
            break;
        }
        report = bench.step(&mut state, to);
    }
    let (jumped, fresh) = (force(&contact(&report)), force(&contact(&fresh)));
    assert!(
        (jumped - fresh).norm() < 1e-8 * fresh.norm(),
        "{jumped} and {fresh}"
    );
}

#[test]
fn missing_columns_are_waited_for() {
    let mut bench = Bench::slab(ball([0.0; 3]));
    bench.options.vertices_per_step = Some(3);
    let press = at(0.0, 0.0, RADIUS - 0.006);
    let mut state = State::new(&bench.model);
    bench.step(&mut state, at(0.0, 0.0, 0.05));
    let mut waited = 0;
    let report = loop {
        let report = bench.step(&mut state, press);
        assert!(report.columns_computed <= 9);
        if report.status != Status::Waiting {
            break report;
        }
        waited += 1;
        assert!(waited < 100);
    };
    assert!(waited > 1, "{} rows in steps of 3 columns", report.rows);
    let mut prepared = Bench::slab(ball([0.0; 3]));
    prepared.options.vertices_per_step = Some(0);
    assert!(prepared.work.prepare(&prepared.model, |p| p[2] > -1e-9) == 17 * 17);
    let (_, ready) = prepared.afresh(at(0.0, 0.0, 0.05), press);
    assert_eq!(ready.columns_computed, 0);
    let difference = force(&contact(&ready)) - force(&contact(&report));
    assert!(difference.norm() < 1e-9 * force(&contact(&ready)).norm());
}

#[test]
fn small_tools_warn_and_impossible_ones_are_refused() {
    let (mesh, bottom) = slab_mesh();
    let build = |tools: &[(u8, Tool)]| Model::new(&mesh, SOFT, &bottom, Loads::default(), tools);
    let sphere = |radius_m| Tool::sphere(radius_m, [0.0; 3]);
    let model = build(&[(0, sphere(0.0)), (1, sphere(0.02))]).expect("a model");
    let warnings = model.warnings();
    assert!(
        matches!(warnings[..], [Warning::SmallTool { id: 0, radius_m: 0.0, mean_edge_m }] if mean_edge_m > 0.005)
    );
    let text = warnings[0].to_string();
    assert!(
        text.contains("tool 0") && text.contains("0.00 mm") && text.contains("nobody has measured"),
        "{text}"
    );
    assert!(matches!(
        build(&[(3, sphere(-1.0))]),
        Err(ModelError::Tool { id: 3, .. })
    ));
    assert!(matches!(
        build(&[(3, sphere(f64::NAN))]),
        Err(ModelError::Tool { .. })
    ));
    assert!(matches!(
        build(&[0, 1].map(|_| (3, sphere(0.01)))),
        Err(ModelError::SameTool(3))
    ));
    // A bare point still feels something and never a number that is none.
    let mut work = Workspace::new(&model);
    let mut state = State::new(&model);
    for step_mm in 0..20 {
        let report = step(
            &model,
            &mut state,
            &[at(0.0, 0.0, 0.01 - 1e-3 * f64::from(step_mm))],
            &StepOptions::default(),
            &mut work,
        );
        assert!(all_finite(&report));
        if (8..12).contains(&step_mm) {
            assert!(force(&contact(&report)).z > 0.0, "at step {step_mm}");
        }
    }
}

#[test]
fn a_path_gives_the_same_bits_twice() {
    let run = || {
        let mut bench = Bench::slab(ball([0.0, 0.0, -0.01]));
        bench.options.vertices_per_step = Some(4);
        let mut state = State::new(&bench.model);
        let mut hasher = DefaultHasher::new();
        let mut rows = 0;
        for tick in 0..300 {
            let t = f64::from(tick) / 300.0;
            let turn = std::f64::consts::TAU * t;
            let position = Vector3::new(
                0.015 * turn.cos(),
                0.012 * (2.0 * turn).sin(),
                RADIUS + 0.01 + 0.004 - 0.012 * (0.5 * turn).sin(),
            );
            let rotation =
                UnitQuaternion::from_scaled_axis(Vector3::new(0.3 * turn.sin(), 0.2, 0.0));
            let report = bench.step(&mut state, pose(position, rotation));
            rows = rows.max(report.rows);
            hasher.write_u8(report.status as u8);
            for contact in report.contacts() {
                for x in contact
                    .wrench
                    .iter()
                    .chain(contact.tangent.iter().flatten())
                {
                    hasher.write_u64(x.to_bits());
                }
            }
            for (node, force) in state.contact_forces(&bench.model) {
                hasher.write_u32(node);
                force.iter().for_each(|x| hasher.write_u64(x.to_bits()));
            }
        }
        let field = bench
            .model
            .equilibrium(&state)
            .expect("a balance")
            .displacement_m;
        field
            .iter()
            .flatten()
            .for_each(|x| hasher.write_u64(x.to_bits()));
        (hasher.finish(), rows)
    };
    let (first, second) = (run(), run());
    assert_eq!(first, second);
    assert!(first.1 >= 10, "the path presses {} vertices", first.1);
}
