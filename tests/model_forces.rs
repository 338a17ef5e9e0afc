//! What sessions on any tissue model send: no force beyond what the reference has, and hardly a step in contact left out.
//!
//! `SUTURA_FULL=1 cargo test --release -p sutura --test all model_forces:: -- --nocapture` has the shipped scene, all of it, with every
//! setting, and prints a table; without, the forces of the usual settings, and of one that jams, on a coarse slab and the hand's
//! way down.
#![allow(clippy::unwrap_used, reason = "tests")]

use crate::support::root;
use std::ops::ControlFlow;
use std::path::Path;
use sutura_hil::NativeConsole;
use sutura_host::scene::{Document, Registered, Scene, Tissue, models};
use sutura_host::session::{
    LINE_BYTES_PER_S, Plan, Rendering, SceneSolver, Solve, Solved, run_lockstep,
};
use sutura_shared::wire::Valid;
use sutura_shared::wire::message::{Fixture, State};
use sutura_testkit::full;

/// Most that any frame may have, in peaks of the reference. Classical mail jams where the hand overshoots: 3.5 at 50 Hz.
const MOST_PEAKS: f64 = 4.0;
/// With this setting mail jams under the hand: its forces then mean nothing.
const JAMS: &str = "chainmail-ellipsoid: limit 0.1";
/// Least share of the steps in contact that usual settings render.
const LEAST_RENDERED: f64 = 0.95;

/// A solver whose results are counted on their way to the console.
struct Watched {
    solver: SceneSolver,
    felt: Felt,
}

/// What a session sent.
#[derive(Clone, Copy, Debug, Default)]
struct Felt {
    contact_steps: u32,
    rendered: u32,
    unfinished: u32,
    /// Of any frame \[N\].
    peak_n: f64,
    /// Of the console \[N\].
    rendered_peak_n: f64,
}

impl Felt {
    fn share(&self) -> f64 {
        f64::from(self.rendered) / f64::from(self.contact_steps.max(1))
    }
}

impl Solve for Watched {
    fn solve(&mut self, state: &Valid<State>) -> Solved {
        let solved = self.solver.solve(state);
        let felt = &mut self.felt;
        felt.contact_steps += u32::from(solved.touched);
        felt.rendered += u32::from(solved.touched && solved.contact.is_some());
        felt.unfinished += u32::from(solved.unfinished);
        assert!(!(solved.unfinished && solved.contact.is_some()));
        if let Some(contact) = &solved.contact {
            let [x, y, z, ..] = contact.wrench;
            felt.peak_n = felt.peak_n.max((x * x + y * y + z * z).sqrt());
        }
        solved
    }

    fn scene(&self) -> serde_json::Map<String, serde_json::Value> {
        self.solver.scene()
    }
}

fn palpation() -> Scene {
    let text = std::fs::read_to_string(root().join("scenes/palpation-frictionless.toml")).unwrap();
    let text = if full() {
        text
    } else {
        // The hand is deepest at 3.3 s.
        text.replace("divisions = [20, 20, 8]", "divisions = [8, 8, 4]")
            .replace("seconds = 5.0", "seconds = 3.6")
            .replace("host_hz = 200.0", "host_hz = 50.0")
    };
    let document = Document::embedded("palpation.toml", Path::new(""), &text);
    Scene::read(&document, "palpation").unwrap()
}

fn plan(scene: &Scene, rendering: Rendering) -> Plan {
    let host_hz = scene.host.host_hz;
    // As long as a console takes at this rate.
    let horizon_us = (3e6 / host_hz).clamp(60e3, 150e3) as u32;
    Plan {
        device: scene.device.unwrap().description,
        hand: scene.hand.unwrap(),
        host_hz,
        seconds: scene.seconds,
        tick_hz: 1000,
        state_every: 1,
        horizon_us: Some(horizon_us),
        clear_fault: false,
        fixture: Fixture::None,
        rendering,
        line_bytes_per_s: LINE_BYTES_PER_S,
    }
}

fn session(scene: &mut Scene, tissue: Tissue) -> Felt {
    scene.tissue = tissue;
    let plan = plan(scene, tissue.usual_rendering());
    let solver = SceneSolver::for_session(scene, &plan).unwrap();
    watch(solver, &plan)
}

fn watch(solver: SceneSolver, plan: &Plan) -> Felt {
    let felt = Felt::default();
    let mut watched = Watched { solver, felt };
    let mut console = NativeConsole::new(&plan.device).unwrap();
    let summary = run_lockstep(&mut console, plan, &mut watched, |_| {
        ControlFlow::Continue(())
    });
    Felt {
        rendered_peak_n: summary.unwrap().force_n.peak,
        ..watched.felt
    }
}

/// The peak of Newton's balance with tools that stick, on the same hand \[N\].
fn reference_n(scene: &Scene) -> f64 {
    let model = Registered::new("hyperelastic", Some("linear cells, to 1e-3")).unwrap();
    let plan = plan(scene, Rendering::Tangent);
    let solver = SceneSolver::sticking(scene, model, plan.rendering, plan.host_hz).unwrap();
    let felt = watch(solver, &plan);
    assert_eq!(felt.rendered, felt.contact_steps, "{felt:?}");
    assert!(felt.peak_n > 1.0, "{felt:?}");
    felt.peak_n
}

/// Every tissue that `--tissue` takes, the usual settings first: no name after the colon.
fn tissues() -> Vec<(String, Tissue)> {
    let mut names: Vec<String> = ["linear", "corotational"].map(str::to_owned).into();
    names.extend(["1 pass", "4 passes"].map(|passes| format!("corotational: {passes}")));
    for entry in models() {
        if names.iter().any(|name| name == entry.tissue) {
            continue;
        }
        names.push(entry.tissue.to_owned());
        let settings = entry.settings.iter().skip(1);
        names.extend(settings.map(|setting| format!("{}: {}", entry.tissue, setting.name)));
    }
    names.retain(|name| full() || !name.contains(':') || name == JAMS);
    assert!(names.iter().any(|name| name == JAMS), "{names:?}");
    let named = names.into_iter().map(|name| {
        let tissue = Tissue::named(&name).unwrap();
        (name, tissue)
    });
    named.collect()
}

/// What no model stands by does not leave the host, and usual settings stand by what they have.
#[test]
fn no_frame_has_a_force_that_the_tissue_cannot_have() {
    let mut scene = palpation();
    let most_n = MOST_PEAKS * reference_n(&scene);
    let mut wrong = Vec::new();
    for (name, tissue) in tissues() {
        let felt = session(&mut scene, tissue);
        println!(
            "{name:50} frame {:8.3} N, console {:6.3} N, {:4} of {:4} steps in contact rendered, {:4} unfinished",
            felt.peak_n, felt.rendered_peak_n, felt.rendered, felt.contact_steps, felt.unfinished
        );
        if felt.peak_n > most_n {
            wrong.push(format!("{name}: {} N of {most_n} N", felt.peak_n));
        }
        let usual = !name.contains(':');
        if full() && usual && (felt.contact_steps == 0 || felt.share() < LEAST_RENDERED) {
            wrong.push(format!("{name}: {felt:?}"));
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}
