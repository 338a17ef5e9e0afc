//! Needles from scene file to console: what is felt, when it arrives, and what is refused.
#![allow(clippy::unwrap_used, reason = "tests")]

#[cfg(unix)]
use crate::support::session_of;
use crate::support::{root, sutura, sutura_in};
use serde_json::Value;
use std::ops::ControlFlow;
use std::path::Path;
use sutura_hil::NativeConsole;
use sutura_host::link::{LinkError, LockstepConsole};
use sutura_host::scene::{Scene, load};
use sutura_host::script::path;
use sutura_host::session::{
    LINE_BYTES_PER_S, Plan, Rendering, SceneSolver, Snapshot, Solve, Solved, Summary, run_lockstep,
};
use sutura_shared::wire::message::{Contact, Needle, State, Tip};
use sutura_shared::wire::{Accumulator, Unchecked, Valid, decode};

const SLABS: &str = "scenes/needle-slabs.toml";
const ARC: &str = "scenes/needle-arc.toml";
const HYPERELASTIC: &str = "scenes/needle-hyperelastic.toml";
/// Period of the host in both scenes \[us\].
const PERIOD_US: u64 = 5000;

fn run(scene: &str) -> Value {
    run_on(scene, &[])
}

fn run_on(scene: &str, tissue: &[&str]) -> Value {
    let line = ["run", scene, "--lockstep", "--format", "json"];
    let ran = sutura(&[&line, tissue].concat());
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    serde_json::from_str(&ran.stdout).unwrap()
}

/// A body that is pressed into a slab and swept over it: the hand feels it steadily, and friction spends.
#[test]
fn a_needles_body_sweeps_over_a_slab() {
    let summary = run_on("scenes/needle-sweeps.toml", &["--seconds", "2.4"]);
    assert_eq!(summary["status"], "ok");
    assert_eq!(summary["steps_withheld"], serde_json::json!({}));
    assert_eq!(summary["decays"], 0);
    // Pressed by 1 mm less what the hand gives way by it is 0.61 to 0.63 N, and at most 0.15 N across that.
    let peak = summary["force_n"]["peak"].as_f64().unwrap();
    assert!((0.55..0.75).contains(&peak), "{peak} N");
    let needle = &summary["scene"]["needles"][0];
    assert_eq!(
        (&needle["tip"], &needle["most_crossings"]),
        (&"outside".into(), &0.into()),
        "{needle}"
    );
    let spent = needle["dissipated_j"]["friction"].as_f64().unwrap();
    // 0.12 N along some 4 mm.
    assert!((1e-4..2e-3).contains(&spent), "{spent} J");
}

/// Corotational tissue under a thin body that is swept to and fro, with so many solves a second.
fn swept(host_hz: f64) -> (Watched, Tapped, Summary) {
    let text = std::fs::read_to_string(root().join("scenes/needle-sweeps.toml")).unwrap();
    let (before, _) = text.split_once("[hand]").unwrap();
    let before = before
        .replace("seconds = 6.0", "seconds = 20.0")
        .replace("thickness_m = 0.001", "thickness_m = 0.0003")
        .replace("surface_friction = 0.2", "surface_friction = 0.0")
        .replace("model = \"linear\"", "model = \"corotational\"");
    let high = (0.0, -0.0141, 0.006);
    let sweeps = (0..7).map(|turn| {
        let x_m = [-0.0141, 0.0059][turn % 2];
        (0.2 + 0.15 * turn as f64, x_m, -0.001)
    });
    let points = [high].into_iter().chain(sweeps).map(|(time_s, x_m, z_m)| {
        format!("[[hand.way_point]]\ntime_s = {time_s}\nposition_m = [{x_m}, -0.0181, {z_m}]\n")
    });
    let hand = "[hand]\nstiffness_n_per_m = 1000.0\ndamping_n_s_per_m = 10.0\n";
    let host = format!("[host]\nhost_hz = {host_hz}\nhorizon_ms = 60.0\n");
    let text = [before.as_str(), hand, &points.collect::<String>(), &host].concat();
    let document = sutura_host::scene::Document::embedded("sweeps.toml", Path::new(""), &text);
    let scene = Scene::read(&document, "sweeps").unwrap();
    watch(&scene, 2.5)
}

/// A hand that goes 130 mm/s, several times what a step follows of a thin body's way at 15 solves a second, is caught up with: each
/// step is felt where it has come to.
#[test]
fn a_hand_that_is_faster_than_a_step_follows_is_caught_up_with() {
    let (watched, tapped, summary) = swept(15.0);
    assert_eq!((summary.status.as_str(), summary.decays), ("ok", 0));
    assert_eq!(summary.steps_withheld.len(), 0, "{summary:?}");
    assert!(summary.steps_behind > 5, "{}", summary.steps_behind);
    assert!(
        (1e-3..0.03).contains(&summary.most_lag_m),
        "{} m",
        summary.most_lag_m
    );
    // What is told is told for where the needle is, not for where the hand is.
    let mut lags = 0;
    for step in &watched.steps {
        let sent = tapped.contacts.iter().find(|(us, _)| *us == step.time_us);
        let state = tapped.states.iter().find(|(us, _)| *us == step.time_us);
        let (Some((_, sent)), Some((_, state))) = (sent, state) else {
            continue;
        };
        let way = sent.position_m.iter().zip(state.position_m);
        let lag_m = way
            .map(|(a, b)| f64::from(a - b).powi(2))
            .sum::<f64>()
            .sqrt();
        assert!((lag_m - step.solved.lag_m).abs() < 1e-6, "{lag_m}");
        lags += u32::from(lag_m > 1e-3);
    }
    assert!(lags > 5, "{lags}");
}

/// Every step is sent, the force stays below the device's limit, and at the end the tissue is alone again.
fn check_session(summary: &Value, punctures: u32) {
    assert_eq!(summary["status"], "ok");
    assert_eq!(summary["steps_withheld"], serde_json::json!({}));
    assert_eq!(summary["decays"], 0);
    assert_eq!(summary["needle_waited_steps"], 0);
    assert_eq!(
        (&summary["frames"]["lost"], &summary["frames"]["rejected"]),
        (&0.into(), &0.into())
    );
    assert_eq!(summary["latency_us"]["max"], 5000.0);
    // The device's `max_force_n` is 10.
    let peak = summary["force_n"]["peak"].as_f64().unwrap();
    assert!((0.2..3.0).contains(&peak), "{peak} N");
    let scene = &summary["scene"];
    assert_eq!(scene["punctures"], punctures, "{scene}");
    let needle = &scene["needles"][0];
    assert_eq!(
        (&needle["tip"], &needle["crossings"], &needle["guessed"]),
        (&"outside".into(), &0.into(), &0.into()),
        "{needle}"
    );
    assert_eq!(needle["axial_n"].as_f64(), Some(0.0), "{needle}");
    for key in ["friction", "cutting", "release"] {
        let spent = needle["dissipated_j"][key].as_f64().unwrap();
        assert!(spent > 0.0, "{key}: {needle}");
    }
}

#[test]
fn a_straight_needle_goes_through_both_slabs_and_comes_back() {
    let summary = run(SLABS);
    check_session(&summary, 4);
    let again = run(SLABS);
    assert_eq!(summary["trace_hash"], again["trace_hash"]);
    assert_eq!(summary["scene"], again["scene"]);
    // What the hand puts in is spent in the tissue: nothing comes back that was not there.
    assert!(
        summary["energy_j"]["min"].as_f64() > Some(-1e-6),
        "{summary}"
    );
    let needle = &summary["scene"]["needles"][0];
    let most = needle["most_crossings"].as_u64().unwrap();
    assert!(most >= 12, "three layers of cells in each slab: {most}");
}

/// An arc half way through that is pulled aside, not along itself: tissue slides along what bends, to where it is pulled least.
#[test]
fn an_arc_that_is_pulled_aside_drags_the_tissue_along() {
    let text = std::fs::read_to_string(root().join(ARC)).unwrap();
    let (before, rest) = text.split_once("[[tool.way_point]]\ntime_s = 9.0").unwrap();
    let (_, hand) = rest.split_once("# The hand is a spring").unwrap();
    let directory = tempfile::tempdir().unwrap();
    for [x, y, z] in [[0.0, 0.0, 0.012], [0.006, 0.01, 0.006]] {
        let at = |[x, y, z]: [f64; 3]| {
            let [x, y] = [0.014 + x, 0.0007 + y];
            format!("position_m = [{x}, {y}, {z:?}]\n")
        };
        let turned = "rotation_deg = [0.0, -105.0, 0.0]\n";
        let begin = format!("[[tool.way_point]]\ntime_s = 9.0\n{}", at([0.0; 3]));
        let stay = format!(
            "[[tool.way_point]]\ntime_s = 12.0\n{turned}{}",
            at([0.0; 3])
        );
        let aside = format!(
            "[[tool.way_point]]\ntime_s = 13.5\n{turned}{}",
            at([x, y, z])
        );
        let scene = [
            before,
            &begin,
            &stay,
            &aside,
            "# The hand is a spring",
            hand,
        ]
        .concat();
        std::fs::write(directory.path().join("aside.toml"), scene).unwrap();
        let line = ["run", "aside.toml", "--lockstep", "--seconds", "13.6"];
        let ran = sutura_in(
            directory.path(),
            &[&line[..], &["--format", "json"]].concat(),
        );
        assert_eq!(ran.code, 0, "{}", ran.stderr);
        let summary: Value = serde_json::from_str(&ran.stdout).unwrap();
        assert_eq!(summary["steps_withheld"], serde_json::json!({}));
        let scene = &summary["scene"];
        assert_eq!(scene["needles"][0]["crossings"], 7, "{scene}");
        let force = &scene["held"][0]["force_n"];
        let force = [0, 1, 2].map(|axis| force[axis].as_f64().unwrap());
        let along = [x, y, z].into_iter().zip(force).map(|(way, n)| way * n);
        let way_m = (x * x + y * y + z * z).sqrt();
        let back_n = along.sum::<f64>() / way_m;
        assert!((2.0..6.0).contains(&back_n), "{back_n} N: {force:?}");
    }
}

/// A second hand takes it on the far side: it is the one that holds it in the end.
#[test]
fn an_arc_goes_through_both_tube_walls_and_changes_hands() {
    let summary = run(ARC);
    check_session(&summary, 4);
    assert_eq!(summary["scene"]["needles"][0]["held_by"], 1);
}

/// The force of corotational tissue to some hundredths, as nothing is strained far but what the tip presses on, and its
/// own bits again.
#[test]
fn a_needle_goes_through_hyperelastic_tissue() {
    let summary = run(HYPERELASTIC);
    check_session(&summary, 2);
    assert_eq!(summary["scene"]["tissue"], "hyperelastic");
    assert_eq!(summary["rendering"], "rows");
    assert_eq!(summary["trace_hash"], run(HYPERELASTIC)["trace_hash"]);
    let corotational = run_on(HYPERELASTIC, &["--tissue", "corotational"]);
    check_session(&corotational, 2);
    let figures = |summary: &Value| {
        let needle = &summary["scene"]["needles"][0];
        let spent = needle["dissipated_j"]["friction"].as_f64().unwrap();
        [
            needle["peak_axial_n"].as_f64().unwrap(),
            spent,
            summary["force_n"]["rms"].as_f64().unwrap(),
        ]
    };
    let (own, other) = (figures(&summary), figures(&corotational));
    println!("hyperelastic {own:?}, corotational {other:?}");
    for (own, other) in own.iter().zip(other) {
        let off = (own / other - 1.0).abs();
        assert!(off > 1e-6 && off < 0.1, "{own} {other}");
    }
}

/// In real time a thread computes what the needle comes to, and frames go through a pseudo-terminal. What is felt is above, in
/// simulated time.
#[cfg(unix)]
#[test]
fn a_session_in_real_time_ends_as_it_may() {
    let ran = session_of(&["run", SLABS, "--seconds", "2.5"]);
    assert!(ran.ended_well(), "{}", ran.stderr);
    let summary = ran.json();
    if ran.code == 0 {
        assert_eq!(summary["ticks"], 2500);
    }
    assert_eq!(summary["frames"]["rejected"], 0);
}

/// What a solver step gave, and for which console time \[us\].
struct Step {
    time_us: u64,
    solved: Solved,
}

/// A solver that writes down what it gives.
struct Watched {
    solver: SceneSolver,
    steps: Vec<Step>,
}

impl Solve for Watched {
    fn solve(&mut self, state: &Valid<State>) -> Solved {
        let solved = self.solver.solve(state);
        self.steps.push(Step {
            time_us: state.console_time_us(),
            solved,
        });
        solved
    }

    fn scene(&self) -> serde_json::Map<String, Value> {
        self.solver.scene()
    }
}

/// A console whose line is tapped both ways.
struct Tapped {
    console: NativeConsole,
    down: Accumulator,
    up: Accumulator,
    contacts: Vec<(u64, Contact)>,
    needles: Vec<(u64, Needle)>,
    /// With their console times \[us\].
    states: Vec<(u64, State)>,
}

impl LockstepConsole for Tapped {
    fn exchange(&mut self, down: &[u8], up: &mut Vec<u8>) -> Result<(), LinkError> {
        let before = up.len();
        self.console.exchange(down, up)?;
        let message = |end: &mut Accumulator, byte| {
            let packet = end.push(byte)?;
            packet.and_then(|packet| decode(packet)?.unpack()).ok()
        };
        for byte in down {
            match message(&mut self.down, *byte) {
                Some(Unchecked::Contact(header, body)) => {
                    self.contacts.push((header.console_time_us, body));
                }
                Some(Unchecked::Needle(header, body)) => {
                    self.needles.push((header.console_time_us, body));
                }
                _ => {}
            }
        }
        for byte in &up[before..] {
            if let Some(Unchecked::State(header, body)) = message(&mut self.up, *byte) {
                self.states.push((header.console_time_us, body));
            }
        }
        Ok(())
    }

    fn name(&self) -> &str {
        self.console.name()
    }
}

/// A session of the first `seconds` of a scene, with all that went over the line.
fn watch(scene: &Scene, seconds: f64) -> (Watched, Tapped, Summary) {
    let mut solver = SceneSolver::new(scene).unwrap();
    solver.prepare(&path(scene, seconds, 0.02, SceneSolver::apart_m(scene)));
    watch_with(solver, scene, seconds)
}

/// The same by a solver that may have a past.
fn watch_with(solver: SceneSolver, scene: &Scene, seconds: f64) -> (Watched, Tapped, Summary) {
    let mut watched = Watched {
        solver,
        steps: Vec::new(),
    };
    let plan = Plan {
        device: scene.device.unwrap().description,
        hand: scene.hand.unwrap(),
        host_hz: scene.host.host_hz,
        seconds,
        tick_hz: 1000,
        state_every: 1,
        horizon_us: scene.host.horizon_us,
        clear_fault: false,
        fixture: sutura_shared::wire::message::Fixture::None,
        rendering: Rendering::Rows,
        line_bytes_per_s: LINE_BYTES_PER_S,
    };
    let mut tapped = Tapped {
        console: NativeConsole::new(&plan.device).unwrap(),
        down: Accumulator::new(),
        up: Accumulator::new(),
        contacts: Vec::new(),
        needles: Vec::new(),
        states: Vec::new(),
    };
    let summary = run_lockstep(&mut tapped, &plan, &mut watched, |_| {
        ControlFlow::Continue(())
    });
    (watched, tapped, summary.unwrap())
}

/// What lies ahead of a needle in the air is looked for where its tip may get before the next looks, and not before.
#[test]
fn nothing_is_looked_for_in_the_air() {
    let scene = load(&root().join(SLABS)).unwrap();
    let (watched, tapped, _) = watch(&scene, 2.5);
    let tip = |step: &Step| step.solved.needle.map(|needle| needle.tip);
    let meets = watched
        .steps
        .iter()
        .position(|step| tip(step) == Some(Tip::Holding));
    let meets = meets.expect("it meets the slab");
    let looks = watched.steps[..meets]
        .iter()
        .map(|step| step.solved.looked.made != [0; 2]);
    let looks: Vec<bool> = looks.collect();
    // As the console is armed the grip gives way a little, fast.
    let begins = looks.iter().rposition(|looks| !looks).expect("not all") + 1;
    let spared = looks.iter().filter(|looks| !**looks).count();
    println!(
        "{spared} of {meets} steps do not look, the last {} do",
        meets - begins
    );
    let at = |step: usize| {
        let time_us = watched.steps[step].time_us;
        let state = tapped.states.iter().find(|(us, _)| *us == time_us);
        state.expect("told").1.position_m.map(f64::from)
    };
    let way_m = at(meets).into_iter().zip(at(begins));
    let way_m = way_m
        .map(|(to, from)| (to - from).powi(2))
        .sum::<f64>()
        .sqrt();
    let reach_m = 5e-4 + 0.25 * 4.0 * 1e-6 * PERIOD_US as f64;
    assert!(way_m > 0.95 * reach_m, "{way_m} of {reach_m} m");
    assert!(2 * spared > meets, "{spared} of {meets}");
}

/// The tip presses on the upper slab until it gives way. What the console is told of it, and when.
#[test]
fn the_drop_of_a_puncture_is_felt_before_its_frame_comes() {
    let scene = load(&root().join(SLABS)).unwrap();
    assert_eq!(1e6 / scene.host.host_hz, PERIOD_US as f64);
    let (watched, tapped, _) = watch(&scene, 2.5);
    let needle = |step: &Step| step.solved.needle.expect("in the grip all the time");
    let at = watched
        .steps
        .windows(2)
        .position(|pair| {
            needle(&pair[0]).tip == Tip::Holding && needle(&pair[1]).tip == Tip::Inside
        })
        .expect("it breaks through");
    let (holding, inside) = (&watched.steps[at], &watched.steps[at + 1]);
    let (before, after) = (needle(holding), needle(inside));

    // The threshold of the scene: 5e5 Pa on a tip of 0.8 mm. A step moves the tip by less than 0.1 mm, which
    // the tissue answers by some hundredths of a newton.
    let threshold_n = 5e5 * 0.25 * std::f64::consts::PI * 0.8e-3f64.powi(2);
    assert!((before.puncture_n / threshold_n - 1.0).abs() < 1e-12);
    let pressed = before.hold_n / threshold_n;
    assert!((0.8..=1.0).contains(&pressed), "{pressed} of the threshold");
    // Nothing else held it back. What was said to be left after the puncture is about what is left: the way
    // since the first contact rubs already.
    assert!((before.axial_n + before.hold_n).abs() < 0.01 * threshold_n);
    let drop_n = after.axial_n - before.axial_n;
    assert!(drop_n > 0.3 * threshold_n, "{drop_n} N of {threshold_n}");

    // The frame of the puncture's step is the one that the console uses one period after that step's state.
    let told = tapped
        .needles
        .iter()
        .find(|(time_us, _)| *time_us == inside.time_us);
    assert_eq!(told.expect("sent").1.tip, Tip::Inside);
    let contact = tapped.contacts.iter().find(|(t, _)| *t == inside.time_us);
    let (_, contact) = contact.expect("sent");
    assert!((f64::from(-contact.wrench[2]) - after.axial_n).abs() < 1e-6);
    let sent_at = |time_us: u64| tapped.contacts.iter().position(|(t, _)| *t == time_us);
    assert_eq!(
        sent_at(inside.time_us),
        sent_at(holding.time_us).map(|n| n + 1)
    );
    let uses = |(time_us, state): &&(u64, State)| {
        u64::from(state.contact_age_us) + inside.time_us == *time_us
    };
    let (first_us, first) = tapped.states.iter().find(uses).expect("used");
    assert!(first_us - inside.time_us <= PERIOD_US, "{first_us}");
    assert_eq!(u64::from(first.applied_age_us), first_us - inside.time_us);

    // The console has not waited for that: the boundary has given way on it where the host foretold it.
    let drops = tapped.states.windows(4).map(|four| {
        let fell = four[0].1.force_n[2] - four[3].1.force_n[2];
        (f64::from(fell), four[3].0)
    });
    let (felt_n, felt_us) = drops.fold(
        (0.0, 0),
        |most, drop| if drop.0 > most.0 { drop } else { most },
    );
    assert!(felt_n > 0.6 * drop_n, "{felt_n} N of {drop_n}");
    assert!(
        (holding.time_us..*first_us).contains(&felt_us),
        "felt at {felt_us} us, host between {} and {}",
        holding.time_us,
        inside.time_us
    );
    let most = tapped.states.iter().flat_map(|(_, state)| state.force_n);
    assert!(most.map(f32::abs).fold(0.0, f32::max) < 1.0);
}

/// While the grip holds the needle every contact comes with its needle, just before it and for the same state;
/// afterwards contacts come alone.
#[test]
fn needles_go_with_the_contacts_of_the_tool_that_holds_them() {
    let text = std::fs::read_to_string(root().join(SLABS)).unwrap();
    // Let go once it has come to rest in the upper slab.
    let text = text.replace(
        "[[needle.hold]]\ntime_s = 0.0\ntool = 0\n",
        "[[needle.hold]]\ntime_s = 0.0\ntool = 0\n[[needle.hold]]\ntime_s = 2.4\n",
    );
    let document = sutura_host::scene::Document::embedded("slabs.toml", Path::new(""), &text);
    let scene = Scene::read(&document, "slabs").unwrap();
    let (watched, tapped, summary) = watch(&scene, 3.0);
    assert_eq!(summary.status, "ok");
    let held: Vec<u64> = watched
        .steps
        .iter()
        .filter(|step| step.solved.needle.is_some())
        .map(|step| step.time_us)
        .collect();
    let sent: Vec<u64> = tapped.needles.iter().map(|(time_us, _)| *time_us).collect();
    assert_eq!(sent, held, "all that there is to tell is told");
    let began_us = watched.steps[0].time_us;
    let last_us = held.last().expect("some") - began_us;
    assert!((2_390_000..2_400_000).contains(&last_us), "{last_us}");
    assert!(tapped.contacts.len() > sent.len() + 100);
    let (_, last) = tapped.contacts.last().expect("some");
    assert_eq!(last.wrench, [0.0; 6], "nothing in the grip");
    for (time_us, needle) in &tapped.needles {
        let contact = tapped.contacts.iter().find(|(t, _)| t == time_us);
        let (_, contact) = contact.expect("with each needle");
        assert_eq!(needle.slide, [0.0, 0.0, -1.0, 0.0, 0.0, 0.0]);
        // Axial force is that of the wrench along the slide.
        let along = -contact.wrench[2];
        assert!((needle.axial_n - along).abs() <= 1e-6, "{needle:?}");
    }
    // The needle stays where it was let go: in the slab.
    let scene = &summary.scene["needles"][0];
    assert_eq!(
        (&scene["held_by"], &scene["tip"]),
        (&Value::Null, &"inside".into())
    );
}

/// The slabs with a hand that takes this way \[s, m\], straight up and down. The needle's tip is 40 mm below the grip where
/// the scene has both, at 60 mm.
fn with_way(points: &[(f64, f64)]) -> Scene {
    let text = std::fs::read_to_string(root().join(SLABS)).unwrap();
    let (before, _) = text.split_once("# The tip begins 8 mm above").unwrap();
    let (_, host) = text.split_once("[host]").unwrap();
    let points = points.iter().map(|(time_s, z_m)| {
        format!("[[hand.way_point]]\ntime_s = {time_s}\nposition_m = [0.0011, 0.0007, {z_m}]\n")
    });
    let text = format!("{before}{}[host]{host}", points.collect::<String>());
    let document = sutura_host::scene::Document::embedded("slabs.toml", Path::new(""), &text);
    Scene::read(&document, "slabs").unwrap()
}

/// A needle that is let go in the air lies on the slab soon after, where the scene has gravity and says what it is made of; else it stays
/// in the air, and the console is sent the same bits as by a scene that says neither.
#[test]
fn a_needle_that_is_let_go_falls_on_the_slab() {
    let text = std::fs::read_to_string(root().join("scenes/needle-sweeps.toml")).unwrap();
    let hold = "time_s = 0.0\ntool = 0\n";
    let light = text.replacen(hold, &format!("{hold}\n[[needle.hold]]\ntime_s = 0.1\n"), 1);
    let heavy = light.replace("body = true", "body = true\ndensity_kg_per_m3 = 7900.0");
    let tissue = "[tissue]\ndensity_kg_per_m3 = 1060.0";
    let falling = format!(
        "gravity_m_per_s2 = [0.0, 0.0, -9.81]\n{}",
        heavy.replacen("[tissue]", tissue, 1)
    );
    let ended = |text: &str| {
        let document = sutura_host::scene::Document::embedded("let-go.toml", Path::new(""), text);
        let scene = Scene::read(&document, "let-go").unwrap();
        let start_m = scene.needles[0].start.translation.vector.z;
        let (watched, _, summary) = watch(&scene, 1.0);
        assert_eq!((&*summary.status, summary.decays), ("ok", 0));
        assert!(summary.steps_withheld.is_empty());
        let solver = &watched.solver;
        let snapshot = Snapshot::of(solver);
        let (model, state) = snapshot.constrained().unwrap();
        let pose = state.needle_pose(model, 0).unwrap();
        (start_m - pose.translation.vector.z, summary.trace_hash)
    };
    let [(none_m, light), (stays_m, heavy), (fell_m, _)] =
        [&light, &heavy, &falling].map(|text| ended(text));
    assert_eq!((none_m, light), (stays_m, heavy));
    println!("{stays_m} m and {fell_m} m");
    // Its end begins 6 mm above the slab, and goes down with the hand a little first.
    assert!(stays_m < 0.002 && fell_m > 0.005, "{stays_m} {fell_m} m");
}

/// A console that has started anew while nobody looked, with the hand where the needle is in the upper slab: nothing is felt of
/// that until the hand has drawn it out; then it goes in as always.
#[test]
fn a_needle_that_is_in_tissue_when_the_console_is_armed_waits_outside() {
    let (before, ..) = watch(&with_way(&[(0.0, 0.06)]), 0.3);
    assert!(before.steps.iter().all(|step| !waits(step)));
    // The tip is 6 mm in, for a second; out, 8 mm above; and 6 mm in again.
    let again = with_way(&[
        (0.0, 0.046),
        (1.0, 0.046),
        (2.0, 0.06),
        (2.5, 0.06),
        (4.5, 0.046),
    ]);
    let (watched, tapped, summary) = watch_with(before.solver, &again, 5.0);
    assert_eq!(summary.status, "ok");
    let began_us = watched.steps[0].time_us;
    let waited = watched.steps.iter().take_while(|step| waits(step)).count();
    let out_us = watched.steps[waited].time_us - began_us;
    assert!((1_200_000..2_000_000).contains(&out_us), "{out_us}");
    assert!(!watched.steps[waited..].iter().any(waits), "once is enough");
    assert_eq!(summary.needle_waited_steps, waited as u64);
    for step in &watched.steps[..waited] {
        let contact = step.solved.contact.expect("sent");
        assert_eq!((contact.wrench, contact.rows), ([0.0; 6], 0));
        let needle = step.solved.needle.expect("in the grip");
        assert_eq!((needle.tip, needle.friction_n), (Tip::Outside, [0.0; 2]));
        assert!(!step.solved.touched);
    }
    let forces = |from_us: u64, to_us: u64| {
        let times = began_us + from_us..began_us + to_us;
        let states = tapped.states.iter().filter(move |(t, _)| times.contains(t));
        let forces = states.map(|(_, state)| state.force_n.map(f32::abs));
        forces.flatten().fold(0.0, f32::max)
    };
    // Nothing is felt before it goes in, 8 mm down from 2.5 s on; then what a needle makes felt.
    assert_eq!(forces(0, 3_000_000), 0.0);
    let peak = forces(3_000_000, 5_000_000);
    assert!((0.15..1.0).contains(&peak), "{peak} N");
    assert_eq!(summary.ticks_withheld, 0);
    let needle = &summary.scene["needles"][0];
    assert_eq!(
        (&needle["punctures"], &needle["tip"]),
        (&1.into(), &"inside".into()),
        "{needle}"
    );
}

fn waits(step: &Step) -> bool {
    step.solved.needle.expect("in the grip").waits
}

/// A needle is taken where the scene has it, wherever the console's grip is then: a hand that begins lower does not put it into
/// the tissue.
#[test]
fn a_hand_that_begins_elsewhere_takes_the_needle_where_it_is() {
    let scene = with_way(&[(0.0, 0.046), (1.0, 0.046), (2.0, 0.034)]);
    let (watched, _, summary) = watch(&scene, 2.5);
    assert_eq!(
        (summary.status.as_str(), summary.needle_waited_steps),
        ("ok", 0)
    );
    let first = watched.steps[0].solved;
    assert_eq!(first.needle.expect("in the grip").tip, Tip::Outside);
    assert_eq!(first.contact.expect("sent").wrench, [0.0; 6]);
    // From 8 mm above by 12 mm down: as from where the scene would have the hand.
    assert_eq!(summary.scene["punctures"], 1);
}

#[test]
fn needle_scenes_are_checked_and_explained() {
    let ran = sutura(&["scene", "explain", SLABS, "--format", "json"]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let object: Value = serde_json::from_str(&ran.stdout).unwrap();
    assert_eq!(object["needles"], 1);
    let parts = object["components"].as_array().unwrap();
    let part = |name: &str| {
        let found = parts.iter().find(|part| part["name"] == name);
        found.unwrap_or_else(|| panic!("no {name} in {object:#}"))
    };
    let built = part("needle 0, straight");
    assert_eq!(built["built"], true);
    assert!(built["rows"].as_u64() >= Some(36), "{built}");
    let why = built["why"].as_str().unwrap();
    assert!(why.contains("4 punctures"), "{why}");
    assert!(part("hierarchy of the boundary")["us"].as_f64() > Some(0.0));
    assert!(part("step")["rows"].as_u64() >= Some(36));
    assert_eq!(part("tool 0, grip")["built"], true);
    let ran = sutura(&["scene", "check", SLABS]);
    assert!(ran.stdout.contains("1 needles"), "{}", ran.stdout);
}

/// `sutura solve` stops on the way: before the first contact nothing is moved, then something is, and after the
/// withdrawal nothing again.
#[test]
fn a_solve_follows_the_scripts_until_its_time() {
    let directory = tempfile::tempdir().unwrap();
    let solve = |more: &[&str]| -> Value {
        let words = [
            &[
                "solve",
                SLABS,
                "--out",
                "out.json",
                "--overwrite",
                "--format",
                "json",
            ],
            more,
        ]
        .concat();
        let slabs = root().join(SLABS);
        let words: Vec<&str> = words
            .into_iter()
            .map(|word| {
                if word == SLABS {
                    slabs.to_str().unwrap()
                } else {
                    word
                }
            })
            .collect();
        let ran = sutura_in(directory.path(), &words);
        assert_eq!(ran.code, 0, "{}", ran.stderr);
        serde_json::from_str(&ran.stdout).unwrap()
    };
    let state = |object: &Value| {
        let needle = &object["needles"][0];
        (
            needle["tip"].as_str().unwrap().to_owned(),
            needle["punctures"].as_u64().unwrap(),
            object["displacement_max_m"].as_f64().unwrap(),
        )
    };
    assert_eq!(state(&solve(&["--at", "0"])), ("outside".into(), 0, 0.0));
    // The scene's own `solve_at_s`: through both slabs.
    let through = solve(&[]);
    let (tip, punctures, moved_m) = state(&through);
    assert_eq!((tip.as_str(), punctures), ("outside", 4));
    assert!((1e-4..0.01).contains(&moved_m), "{moved_m}");
    // Friction drags the tissue down: the force on it points with the slide.
    let force = through["tools"][0]["force_n"][2].as_f64().unwrap();
    let axial = through["needles"][0]["axial_n"].as_f64().unwrap();
    assert!(
        force < -0.1 && (force - axial).abs() < 1e-9,
        "{force} {axial}"
    );
    let file = std::fs::read_to_string(directory.path().join("out.json")).unwrap();
    let file: Value = serde_json::from_str(&file).unwrap();
    assert_eq!(file["needles"], through["needles"]);
    let (tip, punctures, left_m) = state(&solve(&["--at", "12"]));
    assert_eq!((tip.as_str(), punctures), ("outside", 4));
    assert!(
        left_m <= 1e-9 * moved_m,
        "{left_m} m of {moved_m} m are left"
    );
}

#[test]
fn a_bench_walks_the_scripts() {
    let text = std::fs::read_to_string(root().join(SLABS)).unwrap();
    let short = text.replace("seconds = 12.0", "seconds = 2.0");
    let directory = tempfile::tempdir().unwrap();
    std::fs::write(
        directory.path().join("short.toml"),
        short.replace("solve_at_s = 6.0", ""),
    )
    .unwrap();
    let ran = sutura_in(
        directory.path(),
        &["bench", "short.toml", "--format", "json"],
    );
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let report: Value = serde_json::from_str(&ran.stdout).unwrap();
    let case = &report["cases"][0];
    assert_eq!(
        (&case["nodes"], &case["steps_not_ok"]),
        (&512.into(), &0.into())
    );
    // From the first contact on, a third of the way down.
    let steps = case["steps"].as_u64().unwrap();
    assert!((150..400).contains(&steps), "{case}");
    assert!(case["rows"].as_u64() >= Some(9), "{case}");
}

/// What a scene with a slip is told, and where.
#[test]
fn slips_are_told_at_their_place() {
    let text = std::fs::read_to_string(root().join(SLABS)).unwrap();
    let directory = tempfile::tempdir().unwrap();
    for (from, to, message, help) in [
        (
            "tool = 0",
            "tool = 3",
            "there is no tool 3",
            "this scene's tools are [0]",
        ),
        (
            "puncture_pa = 5e5",
            "puncture_pa = -5e5",
            "puncture_pa = -500000: must be zero or positive",
            "`inf` is never",
        ),
        (
            "length_m = 0.04",
            "",
            "missing key `length_m`",
            "add `length_m",
        ),
        (
            "end_m = [0.0011, 0.0007, 0.06]",
            "end_m = [0.0011, 0.0007, 0.05]",
            "this needle starts inside the tissue",
            "comes from outside",
        ),
        (
            "[[needle.hold]]",
            "[[needle.holds]]",
            "unknown key `holds`",
            "did you mean `hold`?",
        ),
    ] {
        assert!(text.contains(from), "{from}");
        std::fs::write(
            directory.path().join("slip.toml"),
            text.replacen(from, to, 1),
        )
        .unwrap();
        let ran = sutura_in(directory.path(), &["scene", "check", "slip.toml"]);
        assert_eq!(ran.code, 2, "{to}: {}", ran.stderr);
        let told = ran.stderr.split_whitespace().collect::<Vec<_>>().join(" ");
        for words in [message, help, "slip.toml:"] {
            assert!(told.contains(words), "{to}: no {words:?} in {}", ran.stderr);
        }
    }
    let ran = sutura(&[
        "solve",
        "scenes/palpation.toml",
        "--out",
        "x.json",
        "--at",
        "3",
    ]);
    assert_eq!(ran.code, 2, "{}", ran.stderr);
    assert!(ran.stderr.contains("has no needle"), "{}", ran.stderr);
    // A needle that nobody drives.
    let (handless, _) = text.split_once("# The hand is a spring").unwrap();
    std::fs::write(directory.path().join("slip.toml"), handless).unwrap();
    let ran = sutura_in(directory.path(), &["solve", "slip.toml", "--out", "x.json"]);
    assert_eq!(ran.code, 2, "{}", ran.stderr);
    assert!(ran.stderr.contains("nothing moves"), "{}", ran.stderr);
    assert!(ran.stderr.contains("add `[hand]`"), "{}", ran.stderr);
    let ran = sutura(&["solve", SLABS, "--out", "x.json", "--at=-1"]);
    assert_eq!(ran.code, 2, "{}", ran.stderr);
    assert!(ran.stderr.contains("from 0 to 86400"), "{}", ran.stderr);
}
