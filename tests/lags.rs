//! Hands that are faster than a step follows: consoles make no more of a frame, on the way to where the hand is, than its step
//! solved.

use nalgebra::{Matrix3, Vector3};
use std::path::Path;
use sutura_host::scene::{Document, Scene};
use sutura_host::session::{Plan, Rendering, SceneSolver, Solve};
use sutura_host::step::Status;
use sutura_shared::control::{Control, TickInput};
use sutura_shared::wire::message::{Contact, Mode, State};
use sutura_shared::wire::{Header, Message, PROTOCOL_VERSION, Valid};

/// A state of the console at a time \[us\].
fn valid(console_time_us: u64, body: State) -> Valid<State> {
    let header = Header {
        version: PROTOCOL_VERSION,
        kind: State::KIND,
        session: 1,
        sequence: 1,
        console_time_us,
    };
    Valid::new(header, body).expect("within the wire's limits")
}

/// A slab, and under its name what is held over it.
fn scene(model: &str, tools: &str) -> Scene {
    let text = format!(
        r#"
        name = "slab"
        device = "cartesian-bench"
        host = {{ host_hz = 100.0 }}
        [mesh.slab]
        size_m = [0.06, 0.06, 0.02]
        divisions = [12, 12, 2]
        [tissue]
        model = "{model}"
        youngs_modulus_pa = 15e3
        poisson_ratio = 0.45
        [[fixed]]
        plane = {{ axis = "z", at_m = -0.02 }}
        {tools}
        [hand]
        stiffness_n_per_m = 1000.0
        damping_n_s_per_m = 10.0
        way_point = [{{ time_s = 0.0, position_m = [0.0011, 0.0007, 0.03] }}]
        "#
    );
    Scene::read(&Document::embedded("slab", Path::new(""), &text), "slab").expect("a scene")
}

/// Force that a console makes of a frame after a way \[N\], and the frame's own.
fn foretold(contact: &Contact, way_m: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let [xx, xy, xz, _, _, _, yy, yz, _, _, _, zz, ..] = contact.tangent.map(f64::from);
    let tangent = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
    let [x, y, z, ..] = contact.wrench.map(f64::from);
    let (own, normal) = (
        Vector3::new(x, y, z),
        Vector3::from(contact.normal.map(f64::from)),
    );
    let closed_m = -normal.dot(way_m);
    let gap_m = f64::from(contact.gap_m);
    let there = match gap_m > 0.0 {
        true if closed_m > gap_m => tangent * way_m * (1.0 - gap_m / closed_m),
        true => Vector3::zeros(),
        false => own + tangent * way_m,
    };
    [there, own]
}

/// Steps behind on a way down to `deep_m` and to the side, in jumps; every frame is looked at.
fn jumps(scene: &Scene, deep_m: f64) -> u32 {
    let plan = Plan::of_scene(scene).expect("a plan");
    let mut solver = SceneSolver::for_session(scene, &plan).expect("a solver");
    let mut control = Control::new(plan.device).expect("a device");
    let at_rest = control.tick(&TickInput::default(), None).state;
    let mut random = sutura_testkit::Random::new(7);
    let mut behind = 0;
    let mut at_m: [f64; 3] = [0.0011, 0.0007, 0.03];
    for solve in 0..150_u32 {
        // Down at first, 1 mm a step; then by 5.4 cm, with a rest in which it may be caught up with.
        if solve < 40 {
            at_m[2] = (at_m[2] - 1e-3).max(deep_m);
        } else if solve % 6 == 0 {
            let side = if solve % 12 == 0 { 0.027 } else { -0.027 };
            at_m = [
                side + random.between(-0.002, 0.002),
                random.between(-0.01, 0.01),
                deep_m + random.between(0.0, 0.002),
            ];
        }
        let state = State {
            tick: 10 * solve,
            position_m: at_m.map(|x| x as f32),
            mode: Mode::Armed,
            ..at_rest
        };
        let solved = solver.solve(&valid(1_000_000 + 10_000 * u64::from(solve), state));
        if solved.status != Status::Behind {
            assert!(!solved.outrun);
            continue;
        }
        behind += 1;
        let felt = solved.frames(&state, 60_000, Rendering::Rows);
        let felt = felt.expect("a balance");
        let way = Vector3::from(at_m) - Vector3::from(felt.contact.position_m.map(f64::from));
        let [there, own] = foretold(&felt.contact, &way);
        let normal = Vector3::from(felt.contact.normal.map(f64::from));
        let leaves = felt.needle.is_none() && felt.thread.is_none() && normal.dot(&there) <= 0.0;
        assert!(
            leaves || there.norm() <= 2.01 * own.norm() + 1e-6,
            "solve {solve}: {there} of {own}, {way}"
        );
        if solved.outrun {
            assert!(felt.rows.is_none() && felt.needle.is_none() && felt.thread.is_none());
            assert_eq!(felt.contact.tangent, [0.0; 21]);
        }
    }
    behind
}

#[test]
fn no_source_is_extrapolated_by_more_than_it_holds() {
    let ball = "[[tool]]\nradius_m = 0.0025\n";
    let shaft = "[[tool]]\nshape = \"grip\"\nbody = { radius_m = 0.0001, length_m = 0.03, axis = [1.0, 0.0, 0.0], offset_m = [0.015, 0.0, 0.0] }\n";
    let needle = "[tissue.needle]\nfriction_n_per_m = 15.0\ncutting_pa = 1e5\npuncture_pa = 2e5\n\
         [[tool]]\nshape = \"grip\"\n[[needle]]\nshape = \"straight\"\nlength_m = 0.02\nthickness_m = 0.0006\n\
         end_m = [0.0011, 0.0007, 0.03]\ndirection = [0.0, 0.0, -1.0]\nhold = [{ time_s = 0.0, tool = 0 }]\n";
    // Corotational tissue and a needle that is pulled aside may find no balance half way instead.
    for (model, tools, deep_m, lags) in [
        ("linear", ball, 1.5e-3, true),
        ("corotational", ball, 1.5e-3, false),
        ("linear", shaft, -5e-4, true),
        ("linear", needle, 0.015, false),
    ] {
        let behind = jumps(&scene(model, tools), deep_m);
        println!("{model}, {deep_m} m: {behind} steps behind");
        assert!(behind > 0 || !lags, "{model}: {tools}");
    }
}
