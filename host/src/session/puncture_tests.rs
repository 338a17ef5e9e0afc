//! Punctures of the shipped needles: what the frame before one foretells, against the solve in which it has come.

use super::late_tests::{plan, valid};
use super::{Rendering, SceneSolver, Solve};
use crate::scene::{Scene, load};
use crate::script;
use nalgebra::Vector3;
use std::path::Path;
use sutura_shared::control::{Control, LocalNeedle, TickInput};
use sutura_shared::kinematics::Grip;
use sutura_shared::wire::message::{Contact, Mode, State};

const HOST_HZ: f64 = 200.0;

fn force(wrench: &[f32; 6]) -> Vector3<f64> {
    let [x, y, z, ..] = wrench.map(f64::from);
    Vector3::new(x, y, z)
}

/// Force after a motion of the grip by the tangent of its symmetric part \[N\].
fn by_tangent(contact: &Contact, dx: &[f32; 6]) -> Vector3<f64> {
    let mut change = Vector3::zeros();
    let pairs = (0..6).flat_map(|row| (row..6).map(move |column| (row, column)));
    for ((row, column), entry) in pairs.zip(contact.tangent) {
        if row < 3 {
            change[row] += f64::from(entry * dx[column]);
        }
        if column < 3 && column != row {
            change[column] += f64::from(entry * dx[row]);
        }
    }
    change
}

/// The wrist, which the console does not sense, turns here as the script has it. Of every puncture by the needle in the console's grip: by how much the force fell \[N\], and how far off that it was
/// foretold.
fn foretold(scene: &Scene, until_s: f64) -> Vec<(f64, f64)> {
    let plan = plan(scene, HOST_HZ);
    let mut solver = SceneSolver::for_session(scene, &plan).expect("a solver");
    let path = script::path(scene, until_s, 1.0 / HOST_HZ, 1.0);
    let (mut found, mut punctures) = (Vec::new(), 0);
    let mut before: Option<(Contact, LocalNeedle)> = None;
    let mut last = path.grips[0];
    let mut control = Control::new(plan.device).expect("a device");
    let at_rest = control.tick(&TickInput::default(), None).state;
    for (place, grip) in path.grips.iter().enumerate() {
        let now_us = 1_000_000 + (place as f64 * 1e6 / HOST_HZ) as u64;
        let velocity = [0, 1, 2].map(|i| (grip.position_m[i] - last.position_m[i]) * HOST_HZ);
        last = *grip;
        let state = State {
            tick: place as u32,
            position_m: grip.position_m.map(|x| x as f32),
            velocity_m_per_s: velocity.map(|x| x as f32),
            mode: Mode::Armed,
            ..at_rest
        };
        let solved = solver.solve(&valid(1, now_us, state));
        let Some(felt) = solved.frames(&state, 60_000, Rendering::Rows) else {
            println!("{place}: {:?}", solved.status);
            before = None;
            continue;
        };
        let (contact, needle) = (felt.contact, felt.needle);
        if solver.punctures() > punctures
            && let Some((was, needle)) = &mut before
        {
            let [from, to] = [path.grips[place - 1], *grip].map(|pose| Grip {
                position_m: pose.position_m.map(|x| x as f32).into(),
                orientation: pose.orientation.map(|x| x as f32),
            });
            let dx = to.moved_from(&from);
            let linear = force(&was.wrench) + by_tangent(was, &dx);
            let then = linear + force(&needle.correction(&dx, now_us));
            let came = force(&contact.wrench);
            found.push(((came - linear).norm(), (came - then).norm()));
        }
        punctures = solver.punctures();
        before = needle.map(|needle| {
            let mut local = LocalNeedle::new(&valid(2, now_us, needle));
            local.note_contact(&contact.tangent, &contact.wrench);
            (contact, local)
        });
    }
    found
}

/// A round needle's tip points elsewhere than its grip goes, and the force falls off along the tip.
#[test]
fn a_puncture_comes_as_it_was_foretold() {
    for (name, until_s) in [("needle-arc", 8.0), ("needle-slabs", 6.0)] {
        let scenes = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenes");
        let scene = load(&scenes.join(format!("{name}.toml"))).expect("a shipped scene");
        let found = foretold(&scene, until_s);
        println!("{name}: {found:.3?}");
        assert!(found.len() >= 2, "{name}: {found:?}");
        for (fall_n, off_n) in found {
            assert!(off_n <= 0.45 * fall_n, "{name}: {off_n} N of {fall_n} N");
        }
    }
}
