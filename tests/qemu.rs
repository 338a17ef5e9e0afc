//! The firmware image under QEMU. Needs QEMU and the image: feature `qemu-tests`, which `cargo xtask test`
//! turns on after `cargo xtask setup` and `cargo xtask firmware --board virtual`.
#![cfg(unix)]
#![allow(clippy::unwrap_used, reason = "tests")]

use crate::support::session::{self, Overrunning};
use crate::support::{root, sutura};
use serde_json::Value;
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::time::Duration;
use sutura_hil::identity_trace::{self, IdentityTrace};
use sutura_hil::{NativeConsole, QemuConsole, qemu};
use sutura_host::link::{LinkOptions, LockstepConsole, open_serial};
use sutura_host::session::{SessionError, run_real_time};
use sutura_shared::wire::MAX_REAL_TIME_FRAME;

const TIME_LIMIT: Duration = Duration::from_secs(300);

fn image() -> PathBuf {
    let image = qemu::default_image();
    assert!(
        image.is_file(),
        "no firmware image at {}: run `cargo xtask setup` and `cargo xtask firmware --board virtual`",
        image.display()
    );
    image
}

fn start() -> QemuConsole {
    QemuConsole::start(image(), TIME_LIMIT).unwrap_or_else(|error| panic!("{error}"))
}

/// Runs a scene natively and on the image, in lockstep: what they have in common, once.
fn same_bits_natively_and_on_the_image(scene: &str) -> Value {
    same_bits_for(scene, &[])
}

/// The same of a run with such options.
fn same_bits_for(scene: &str, options: &[&str]) -> Value {
    let image = image();
    let run = |console: &[&str]| -> Value {
        let ran = sutura(&[&["run", "--format", "json", scene], options, console].concat());
        assert_eq!(ran.code, 0, "{}", ran.stderr);
        serde_json::from_str(&ran.stdout).unwrap()
    };
    let native = run(&["--console", "virtual", "--lockstep"]);
    let emulated = run(&["--console", "qemu", "--image", image.to_str().unwrap()]);
    println!("{scene} under QEMU in {} s", emulated["wall_s"]);
    assert_eq!(native["trace_hash"], emulated["trace_hash"]);
    for key in [
        "ticks",
        "frames",
        "latency_us",
        "age_ms",
        "force_n",
        "energy_j",
    ] {
        assert_eq!(native[key], emulated[key], "{key}");
    }
    emulated
}

#[test]
fn palpation_gives_the_same_bits_natively_and_on_the_image() {
    let emulated = same_bits_natively_and_on_the_image("scenes/palpation.toml");
    assert_eq!(emulated["ticks"], 5000);
}

/// What was recorded natively comes out the same on the image, and the other way round.
#[test]
fn a_recording_comes_out_the_same_natively_and_on_the_image() {
    let folder = tempfile::TempDir::new().unwrap();
    let (image, file) = (image(), folder.path().join("session.mcap"));
    let (image, file) = (image.to_str().unwrap(), file.to_str().unwrap());
    let json = |arguments: &[&str]| -> Value {
        let ran = sutura(&[arguments, &["--format", "json"]].concat());
        assert_eq!(ran.code, 0, "{}", ran.stderr);
        serde_json::from_str(&ran.stdout).unwrap()
    };
    let native = ["--console", "virtual", "--lockstep"];
    let emulated = ["--console", "qemu", "--image", image];
    for console in [&native[..], &emulated[..]] {
        let record = ["run", "--seconds", "1", "--overwrite", "--record", file];
        json(&[&record[..], console].concat());
        let mut natively = json(&["replay", file, "--verify"]);
        let on_image = json(&[
            "replay",
            file,
            "--verify",
            "--console",
            "qemu",
            "--image",
            image,
        ]);
        // An image is not asked what its limits took away.
        let counted = natively["console"].as_object_mut().unwrap();
        assert!(counted.remove("ticks_limited").is_some());
        assert_eq!(natively["console"], on_image["console"]);
        assert_eq!(natively["console"]["verified_ticks"], natively["ticks"]);
        assert!(natively["ticks"].as_u64().unwrap() >= 1000);
    }
}

/// Needle frames go down with every contact, and are in the trace.
#[test]
fn a_driven_needle_gives_the_same_bits_natively_and_on_the_image() {
    for scene in ["scenes/needle-slabs.toml", "scenes/needle-arc.toml"] {
        let emulated = same_bits_natively_and_on_the_image(scene);
        assert_eq!(emulated["scene"]["punctures"], 4, "{scene}");
    }
}

/// Cones of tools that rub, beside needles and threads, on every tissue that has a compliance.
#[test]
fn scenes_in_which_all_is_solved_at_once_give_the_same_bits_natively_and_on_the_image() {
    for scene in [
        "scenes/drag.toml",
        "scenes/suture-and-probe.toml",
        "scenes/needle-hyperelastic.toml",
        "scenes/touching-slabs.toml",
        "scenes/tied-slab.toml",
        "scenes/jaws-lift.toml",
    ] {
        let emulated = same_bits_natively_and_on_the_image(scene);
        assert!(emulated["decays"] == 0, "{scene}");
    }
    // A needle that starts nearer and goes in faster, until it is 3 mm deep, and few solves a second: in each all is looked through ahead.
    let shipped = std::fs::read_to_string(root().join("scenes/needle-held-slab.toml")).unwrap();
    let nearer = shipped.replace("0.048", "0.042");
    let faster = nearer.replace("time_s = 3.0", "time_s = 2.0");
    let scene = tempfile::NamedTempFile::with_suffix(".toml").unwrap();
    std::fs::write(scene.path(), &faster).unwrap();
    let few = ["--seconds", "1", "--host-hz", "30"];
    let held = same_bits_for(scene.path().to_str().unwrap(), &few);
    assert!(held["decays"] == 0);
    assert!(held["scene"]["punctures"].as_u64().unwrap() > 0);
}

/// Thread frames, too.
#[test]
fn a_sewn_wound_gives_the_same_bits_natively_and_on_the_image() {
    let emulated = same_bits_natively_and_on_the_image("scenes/wound-slabs.toml");
    assert_eq!(emulated["scene"]["threads"][0]["state"], "taut");
}

#[test]
fn the_identity_trace_has_the_committed_hash_natively_and_on_the_image() {
    let committed = identity_trace::committed().last().unwrap();
    let trace = |console: &mut dyn LockstepConsole| -> IdentityTrace {
        identity_trace::run(console).unwrap_or_else(|error| panic!("{error}"))
    };
    let native = trace(&mut NativeConsole::new(&session::device()).unwrap());
    let mut console = start();
    let emulated = trace(&mut console);
    console.quit().unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(native, emulated);
    assert!(native.coverage.states >= 10_000, "{:?}", native.coverage);
    assert_eq!(emulated.hash, committed.hash);
}

/// Ticks that overran, as recordings of consoles that keep time have them.
#[test]
fn ticks_that_overran_give_the_same_bits_natively_and_on_the_image() {
    fn trace(console: impl LockstepConsole, overran: &'static [u32]) -> IdentityTrace {
        let mut console = Overrunning::new(console, overran);
        identity_trace::run(&mut console).unwrap_or_else(|error| panic!("{error}"))
    }
    let native = || NativeConsole::new(&session::device()).unwrap();
    let overran = &[2000, 2001, 7000];
    let late = trace(native(), overran);
    assert_eq!(late, trace(start(), overran));
    assert_ne!(late.hash, trace(native(), &[]).hash);
}

/// What goes wrong, natively and on the image: the same bits over all states, and no mutant gets through.
#[test]
fn faults_and_mutants_are_the_same_natively_and_on_the_image() {
    use sutura_hil::scenario::processes::Emulated;
    use sutura_hil::scenario::suite::{Bench, Case, Extent, MutantVerdict, Native, Verdict};
    let some = [
        "host-killed-100hz",
        "solver-wedged-repeats",
        "bit-flips",
        "cable-pulled-long",
        "console-reset",
        "second-host",
        "clock-future",
    ];
    let extent = Extent {
        mutants: true,
        twice: false,
    };
    let image = Emulated { image: image() };
    let all = sutura_hil::scenario::built_in().unwrap_or_else(|error| panic!("{error:?}"));
    let chosen = all.iter().filter(|s| some.contains(&s.name.as_str()));
    let mut ran = 0;
    for scenario in chosen {
        let run = |bench: &dyn Bench| {
            let case = Case::run(scenario, bench, extent);
            assert!(case.is_met(), "{case:#?}");
            assert!(matches!(case.mutant, MutantVerdict::Caught(_)), "{case:#?}");
            match case.verdict {
                Verdict::Ran(outcome) => outcome.hash,
                other => panic!("{}: {other:?}", scenario.name),
            }
        };
        assert_eq!(run(&Native), run(&image), "{}", scenario.name);
        ran += 1;
    }
    assert_eq!(ran, some.len());
}

#[test]
fn the_image_ends_with_its_exit_code() {
    let mut console = start();
    let mut up = Vec::new();
    console.exchange(&[], &mut up).unwrap();
    console.quit().unwrap_or_else(|error| panic!("{error}"));

    // Without a link it says what it wants, and fails.
    let options = sutura_hil::QemuOptions {
        image: image(),
        args: vec!["nonsense".into()],
        icount: true,
        uart: false,
        gdb: false,
        time_limit: TIME_LIMIT,
    };
    let image = sutura_hil::Qemu::start(&options).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(image.wait().unwrap().code(), Some(1));
    assert!(
        image.ending().to_string().contains("lockstep"),
        "{}",
        image.ending()
    );
}

#[test]
fn an_image_that_takes_too_long_is_killed() {
    let options = sutura_hil::QemuOptions {
        image: image(),
        args: vec!["uart".into()],
        icount: true,
        uart: false,
        gdb: false,
        time_limit: Duration::from_millis(300),
    };
    let image = sutura_hil::Qemu::start(&options).unwrap_or_else(|error| panic!("{error}"));
    let error = image.wait().expect_err("it never ends by itself");
    assert!(error.to_string().contains("time limit"), "{error}");
}

/// Framing and interrupts at the rate that the emulated UART manages; nothing is asserted about time. What is felt is above, in
/// lockstep.
#[test]
fn the_uart_rejects_nothing_at_its_own_pace() {
    let mut plan = session::plan(2.0);
    plan.host_hz = 30.0;
    plan.state_every = 10;
    println!(
        "at most {} frames/s of at most {MAX_REAL_TIME_FRAME} bytes",
        plan.host_hz
    );
    let options = LinkOptions {
        contact_spacing: Duration::from_secs_f64(1.0 / 30.0),
        silent_after: Duration::from_secs(5),
        ..session::patient()
    };
    // Where the machine lets neither go on for a second the console ends the session, and says nothing more.
    let (qemu, summary) = session::undisturbed(|| {
        let qemu = qemu::with_uart(image(), TIME_LIMIT).unwrap_or_else(|error| panic!("{error}"));
        let port = open_serial(qemu.uart().unwrap()).unwrap();
        let summary = run_real_time(port, options, &plan, &mut session::Plane, |_| {
            ControlFlow::Continue(())
        });
        match summary {
            Err(SessionError::Silent { .. }) => None,
            summary => Some((qemu, summary.unwrap_or_else(|error| panic!("{error}")))),
        }
    });
    println!("{summary:#?}");
    // Frames that a late host does not take are dropped as a whole, by the console.
    assert_eq!(summary.frames.rejected, 0);
    assert!(session::ended_well(&summary), "{}", summary.status);
    assert!(summary.ticks > 0);
    let deepest = 1.3 * session::DEPTH_M * session::PLANE_N_PER_M;
    assert!(summary.force_n.peak < deepest, "{:?}", summary.force_n);
    qemu.check_log(|_| false)
        .unwrap_or_else(|error| panic!("{error}"));
}
