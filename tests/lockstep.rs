//! `sutura run` in lockstep: the same bits at every run, and the contract of its output.
#![allow(clippy::unwrap_used, reason = "tests")]

use crate::support;
use crate::support::session::{Plane, device, force_at_rest, plan};
use crate::support::sutura;
use serde_json::Value;
use std::ops::ControlFlow;
use sutura_hil::NativeConsole;
use sutura_host::link::LinkError;
use sutura_host::session::{
    Instruction, Progress, Rendering, SessionError, Steer, Steered, Tuning, run_lockstep,
    run_steered,
};
use sutura_shared::link::Mismatch;
use sutura_shared::wire::Reject;
use sutura_shared::wire::message::Mode;

fn run(arguments: &[&str]) -> Value {
    let ran = sutura(&[&["run", "--lockstep", "--format", "json"], arguments].concat());
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    serde_json::from_str(&ran.stdout).unwrap()
}

#[test]
fn two_runs_give_one_trace_and_another_rate_gives_another() {
    let first = run(&[]);
    let again = run(&[]);
    assert_eq!(first["trace_hash"], again["trace_hash"]);
    for key in [
        "ticks",
        "frames",
        "latency_us",
        "age_ms",
        "force_n",
        "energy_j",
    ] {
        assert_eq!(first[key], again[key], "{key}");
    }
    assert_eq!(
        (&first["ticks"], &first["tick_overruns"]),
        (&5000.into(), &0.into())
    );
    assert_eq!(
        (&first["frames"]["lost"], &first["frames"]["rejected"]),
        (&0.into(), &0.into())
    );
    // A solve takes one period of 200 Hz, and its contact is used in the tick that it is ready for.
    assert_eq!(first["latency_us"]["max"], 5000.0);
    assert_ne!(
        run(&["--host-hz", "100"])["trace_hash"],
        first["trace_hash"]
    );
}

/// A console whose name nobody may print: why its answer is not taken is said, not that none came.
#[test]
fn an_answer_that_is_refused_is_no_silence() {
    let mut plan = plan(0.1);
    plan.device.name[..4].copy_from_slice(b"\x1b[1m");
    let mut console = NativeConsole::new(&plan.device).unwrap();
    let stop = |_: &Progress<'_>| ControlFlow::Continue(());
    let error = run_lockstep(&mut console, &plan, &mut Plane, stop).unwrap_err();
    let SessionError::Link(LinkError::Mismatch { mismatch, .. }) = &error else {
        panic!("{error:?}");
    };
    assert_eq!(*mismatch, Mismatch::Unusable(Reject::Name));
    let SessionError::Link(error) = error else {
        unreachable!("looked at above");
    };
    assert!(
        error.to_string().contains("a name is not plain UTF-8"),
        "{error}"
    );
    assert!(
        error.help().contains("`name` of 1 to 16"),
        "{}",
        error.help()
    );
}

/// Ticks between two tunings.
const TUNED_EVERY: u64 = 500;
/// Ticks of the old rate that a change takes at most, and of the new one until its first frame is there.
const CHANGES_WITHIN: u64 = 150;

/// Every so often another rate and rendering, and what the console felt between.
struct Tuner {
    plan: Vec<Tuning>,
    tuned: Option<Tuning>,
    /// Solves since the last tuning was in force, and since which tick.
    solves: Option<(u64, u64)>,
    rates: Vec<(f64, f64)>,
    /// Farthest from the force at rest \[N\].
    off_n: f64,
}

impl Steer for Tuner {
    fn steer(&mut self, now: &Steered<'_>, _: &mut Vec<Instruction>) -> ControlFlow<()> {
        let place = (now.ticks / TUNED_EVERY) as usize;
        let into = now.ticks % TUNED_EVERY;
        // The first half second is the way down, and a quarter more until it rests.
        if place == 0 || (place == 1 && into < 250) {
            return ControlFlow::Continue(());
        }
        assert_eq!(now.state.mode, Mode::Armed, "at tick {}", now.ticks);
        let off_n = f64::from(now.state.force_n[2]) - force_at_rest();
        self.off_n = self.off_n.max(off_n.abs());
        let tuning = place.checked_sub(2).and_then(|at| self.plan.get(at));
        let Some(tuning) = tuning.copied() else {
            return ControlFlow::Continue(());
        };
        match into {
            0 => self.tuned = Some(tuning),
            CHANGES_WITHIN => self.solves = Some((now.solves, now.ticks)),
            _ if into + 1 == TUNED_EVERY => {
                if let Some((solves, ticks)) = self.solves.take() {
                    let rate = 1e3 * (now.solves - solves) as f64 / (now.ticks - ticks) as f64;
                    self.rates.push((tuning.host_hz, rate));
                }
            }
            _ => {}
        }
        ControlFlow::Continue(())
    }

    fn tuned(&mut self) -> Option<Tuning> {
        self.tuned.take()
    }
}

/// While a plane is pressed every rate and rendering follows on another: no frame is missing on the way to a slower one, and what is
/// felt stays what it was.
#[test]
fn a_session_goes_on_at_another_rate_and_with_another_rendering() {
    let changes = [
        (25.0, Rendering::Rows),
        (1000.0, Rendering::Hold),
        (25.0, Rendering::Tangent),
        (60.0, Rendering::Rows),
        (250.0, Rendering::Tangent),
        (30.0, Rendering::Hold),
    ];
    let tunings = changes.map(|(host_hz, rendering)| Tuning { host_hz, rendering });
    let seconds = 1e-3 * (TUNED_EVERY * (changes.len() as u64 + 2)) as f64;
    let mut tuner = Tuner {
        plan: tunings.to_vec(),
        tuned: None,
        solves: None,
        rates: Vec::new(),
        off_n: 0.0,
    };
    let mut console = NativeConsole::new(&device()).unwrap();
    let go_on = |_: &Progress<'_>| ControlFlow::Continue(());
    let summary = run_steered(&mut console, &plan(seconds), &mut Plane, go_on, &mut tuner).unwrap();
    assert_eq!((summary.mode.as_str(), summary.frames.lost), ("armed", 0));
    assert_eq!(tuner.rates.len(), changes.len());
    for (wanted, reached) in &tuner.rates {
        let slack = 1e3 / (TUNED_EVERY - CHANGES_WITHIN) as f64;
        assert!(
            (wanted - reached).abs() <= slack,
            "{reached} of {wanted} Hz"
        );
    }
    assert!(tuner.off_n < 0.01 * force_at_rest(), "{} N", tuner.off_n);
}

/// Scripts rely on these keys.
#[test]
fn the_summary_has_the_keys_of_the_contract() {
    let summary = run(&["--seconds", "0.5"]);
    for key in [
        "console",
        "tick_hz",
        "ticks",
        "tick_overruns",
        "ticks_late",
        "mode",
        "faults",
        "host_hz",
        "frames",
        "latency_us",
        "age_ms",
        "step_us",
        "stages_us",
        "force_n",
        "energy_j",
        "trace_hash",
        "scene",
    ] {
        assert!(!summary[key].is_null(), "{key} in {summary}");
    }
    let inner = [
        ("frames", &["sent", "lost", "rejected", "superseded"][..]),
        ("latency_us", &["p50", "p99", "p999", "max"]),
        ("age_ms", &["p50", "max"]),
        ("step_us", &["p50", "p99", "max"]),
        ("force_n", &["peak", "rms"]),
        ("energy_j", &["min"]),
    ];
    for (key, parts) in inner {
        for part in parts {
            assert!(summary[key][part].is_number(), "{key}.{part} in {summary}");
        }
    }
    assert_eq!(
        (&summary["console"], &summary["ticks"]),
        (&"virtual".into(), &500.into())
    );
}

#[test]
fn a_stream_is_one_object_a_line_and_the_summary_comes_last() {
    let ran = sutura(&[
        "run",
        "--lockstep",
        "--seconds",
        "1",
        "--stream",
        "--format",
        "json",
    ]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let objects: Vec<Value> = ran
        .stdout
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    let (summary, notes) = objects.split_last().unwrap();
    assert_eq!(summary["ticks"], 1000);
    assert!(
        notes.len() >= 5 && notes.iter().all(|note| note["force_n"].is_array()),
        "{notes:?}"
    );
    let times: Vec<f64> = notes
        .iter()
        .map(|note| note["elapsed_s"].as_f64().unwrap())
        .collect();
    assert!(times.is_sorted());
}

#[test]
fn a_missed_budget_has_its_own_exit_code_and_still_a_summary() {
    let ran = sutura(&[
        "run",
        "--lockstep",
        "--seconds",
        "1",
        "--tissue",
        "linear",
        "--budget-ms",
        "1e-6",
        "--format",
        "json",
    ]);
    assert_eq!(ran.code, 7, "{}", ran.stderr);
    let summary: Value = serde_json::from_str(&ran.stdout).unwrap();
    assert_eq!(summary["ticks"], 1000);
    assert!(ran.stderr.contains("budget"), "{}", ran.stderr);
}

/// Static solve of the frictionless scene by other means (see tests/data/README.md), with the hand's spring.
/// 2 %: the virtual console's joints have Coulomb friction, which takes its share of the hand's push where it rests.
#[test]
fn the_peak_agrees_with_an_independent_solve() {
    let reference = include_str!("data/palpation-peak.json");
    let reference: Value = serde_json::from_str(reference).unwrap();
    let expected = reference["force_n"].as_f64().unwrap();
    let summary = run(&["scenes/palpation-frictionless.toml"]);
    let peak = summary["force_n"]["peak"].as_f64().unwrap();
    assert!(
        (peak - expected).abs() <= 0.02 * expected,
        "{peak} N, not {expected} N"
    );
}

/// A hand that presses so deep that no balance is found: the console decays and lets go, the session lasts as long as it was to, and
/// does not pass for a success.
#[test]
fn a_console_that_lets_go_rests_until_the_session_is_over() {
    let directory = tempfile::tempdir().unwrap();
    let file = support::too_deep(directory.path());
    let scene = file.to_str().unwrap();
    for mode in [&["--lockstep"][..], &[]] {
        let ran = sutura(&[&["run", scene, "--format", "json"], mode].concat());
        let summary: Value = serde_json::from_str(&ran.stdout).unwrap();
        let status = summary["status"].as_str().unwrap();
        // It let go, and before that more than a fifth of the steps in contact were withheld; a machine that is late may
        // have it let go before the latter.
        if mode.is_empty() {
            assert!(ran.ended_well() && ran.code != 0, "{}", ran.stderr);
            // Nobody is at the other end of standard input.
            assert_eq!(summary["rearmed"], 0);
            let words = ran.stderr.contains("it stays at rest");
            assert_eq!(words, ran.stderr.contains("has let go"), "{}", ran.stderr);
        } else {
            assert_eq!(ran.code, 8, "{}", ran.stderr);
            assert!(status.starts_with("not-rendered: "), "{status}");
            assert!(ran.stderr.contains("press less deep"), "{}", ran.stderr);
        }
        assert_eq!(summary["mode"], "idle", "{mode:?}");
        assert!(summary["ticks"].as_u64().unwrap() >= 5000, "{mode:?}");
        let withheld = &summary["steps_withheld"];
        let of = |why: &str| withheld[why].as_u64().unwrap_or(0);
        assert!(of("not-converged") + of("inside") > 0, "{withheld}");
    }
}

/// `sutura run --stream | head -1`: the session ends in order instead of by a panic.
#[test]
fn a_reader_that_goes_away_ends_the_session() {
    use std::io::BufRead;
    use std::process::{Command, Stdio};
    for mode in [&["--lockstep"][..], &[]] {
        let mut child = Command::new(env!("CARGO_BIN_EXE_sutura"))
            .args([&["run", "--stream"], mode].concat())
            .current_dir(support::root())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut line = String::new();
        let mut reader = std::io::BufReader::new(child.stdout.take().unwrap());
        reader.read_line(&mut line).unwrap();
        drop(reader);
        let ended = child.wait_with_output().unwrap();
        let stderr = String::from_utf8_lossy(&ended.stderr);
        assert_eq!(ended.status.code(), Some(0), "{mode:?}: {stderr}");
        assert!(!stderr.contains("panicked"), "{stderr}");
    }
}

/// A block that a ball enters by a quarter of its radius, at a third of a second.
const BLOCK: &str = r#"
seconds = 0.3
device = "cartesian-bench"
host = { host_hz = 50.0 }

[mesh.slab]
size_m = [0.06, 0.06, 0.03]
divisions = [6, 6, 3]

[tissue]
model = "linear"
youngs_modulus_pa = 10e3
poisson_ratio = 0.4

[[fixed]]
plane = { axis = "z", at_m = -0.03 }

[[tool]]
radius_m = 0.036

[hand]
stiffness_n_per_m = 1000.0
damping_n_s_per_m = 10.0
way_point = [{ time_s = 0.0, position_m = [0.0, 0.0, 0.037] }, { time_s = 0.3, position_m = [0.0, 0.0, 0.02] }]
"#;

/// `--tissue` does what the file's own words would do, and keeps the settings that the file has.
#[test]
fn the_tissue_on_the_command_line_stands_in_for_the_scenes() {
    let directory = tempfile::tempdir().unwrap();
    let corotational = |settings: &str| {
        let model = format!("model = \"corotational\"\ncorotational = {{ {settings} }}");
        BLOCK.replace("model = \"linear\"", &model)
    };
    let scenes = [
        ("linear.toml", BLOCK.to_owned()),
        ("plain.toml", corotational("")),
        ("passes.toml", corotational("passes = 20, tolerance = 1e-9")),
    ];
    for (name, text) in &scenes {
        std::fs::write(directory.path().join(name), text).unwrap();
    }
    let felt = |name: &str, tissue: &[&str]| {
        let command = ["run", name, "--lockstep", "--format", "json"];
        let ran = support::sutura_in(directory.path(), &[&command, tissue].concat());
        assert_eq!(ran.code, 0, "{name} {tissue:?}: {}", ran.stderr);
        let summary: Value = serde_json::from_str(&ran.stdout).unwrap();
        let used = summary["scene"]["tissue"].as_str().unwrap().to_owned();
        (used, summary["trace_hash"].clone())
    };
    let [linear, plain, passes] = scenes.each_ref().map(|(name, _)| felt(name, &[]));
    assert_eq!(
        [&linear.0, &plain.0, &passes.0],
        ["linear", "corotational", "corotational"]
    );
    assert!(linear.1 != plain.1 && plain.1 != passes.1 && passes.1 != linear.1);
    let over = ["--tissue", "corotational"];
    assert_eq!(felt("linear.toml", &over), plain);
    assert_eq!(felt("passes.toml", &over), passes);
    assert_eq!(felt("passes.toml", &["--tissue", "linear"]), linear);

    // What a model cannot do is refused as if the scene had asked for it.
    let handle = "[[handle]]\nvertices = [150]\nbarycentric = [1.0]\ntarget_displacement_m = [0.0, 0.0, 0.001]\n";
    std::fs::write(
        directory.path().join("handle.toml"),
        format!("{BLOCK}{handle}"),
    )
    .unwrap();
    let command = ["run", "handle.toml", "--lockstep"];
    let over = ["--tissue", "shape-matching"];
    let ran = support::sutura_in(directory.path(), &[&command[..], &over].concat());
    assert_eq!(ran.code, 2, "{}", ran.stderr);
    assert!(ran.stderr.contains("it has handles"), "{}", ran.stderr);
}

#[test]
fn what_cannot_be_is_refused_before_anything_runs() {
    for (arguments, part) in [
        (&["run", "--host-hz", "2000"][..], "at most 1000"),
        (&["run", "--seconds=-1"], "above 0"),
        (&["run", "--seconds", "1e300"], "a day"),
        (&["run", "--tissue", "jelly"], "`linear`, `corotational`"),
        (
            &["run", "--lockstep", "--console", "/dev/ttyACM0"],
            "its own clock",
        ),
        (&["run", "scenes/cube-handle.toml"], "[hand]"),
    ] {
        let ran = sutura(arguments);
        assert_eq!(ran.code, 2, "{arguments:?}: {}", ran.stderr);
        assert!(ran.stderr.contains(part), "{part:?} in {}", ran.stderr);
    }
}
