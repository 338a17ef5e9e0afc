//! The short form of `cargo xtask fuzz`, with what the frames must have reached: fuzz that gets nowhere shows nothing.

use sutura_fuzz::driver::{Counts, Target, run};
use sutura_fuzz::files::Files;
use sutura_fuzz::seeds;
use sutura_fuzz::traffic::{Tally, Traffic};
use sutura_host::recording::Recording;
use sutura_host::recording::replay::{NativeTicks, replay_console};
use sutura_shared::control::{Guards, Tuning};
use sutura_shared::wire::Reject;

fn frames(target: Target) -> Tally {
    match run(target, 1, target.short(), None) {
        (Counts::Frames(tally), false) => {
            println!("{tally:#?}");
            tally
        }
        (_, true) => panic!("a defect: see above"),
        _ => panic!("{target:?} is no target of frames"),
    }
}

fn files(target: Target) -> Files {
    match run(target, 1, target.short(), None) {
        (Counts::Files(files), false) => {
            println!("{files:#?}");
            files
        }
        (_, true) => panic!("a defect: see above"),
        _ => panic!("{target:?} is no target of files"),
    }
}

#[test]
fn a_console_bears_a_million_frames() {
    let tally = frames(Target::Stream);
    assert_eq!(tally.frames, 1_000_000);
    assert!(10 * tally.mutated >= 9 * tally.frames);
    assert!(
        2 * tally.restamped >= tally.mutated,
        "too few reach the checks of the values"
    );
    assert!(5 * tally.decoded >= 2 * tally.frames && 5 * tally.accepted >= tally.frames);
    assert!(2 * tally.ticks >= tally.frames && 4 * tally.ticks_under_torque >= tally.ticks);
    assert!(tally.heard_again >= 4000);
    // All that this console can refuse; two reasons wait for rare handshakes.
    let others = [
        Reject::NotSimulated,
        Reject::Nonce,
        Reject::TickRate,
        Reject::FrameSize,
        // Hosts alone refuse states.
        Reject::Clock,
    ];
    for reject in Reject::ALL
        .into_iter()
        .filter(|reject| !others.contains(reject))
    {
        let count = tally.refused.get(reject as usize).copied();
        assert!(count > Some(0), "nothing was refused for `{reject}`");
    }
}

/// The bounds that are checked are those of the guards: without one of them the same frames break one. (Slew is limited
/// twice, the second time where nothing switches it off.)
#[test]
fn a_console_without_its_guards_is_found_out() {
    let seeds = seeds::frames();
    let all = Guards::ALL;
    let guards = [
        (
            "force",
            Guards {
                force: false,
                ..all
            },
        ),
        (
            "horizon",
            Guards {
                horizon: false,
                ..all
            },
        ),
    ];
    for (name, guards) in guards {
        let tuning = Tuning {
            guards,
            ..Tuning::default()
        };
        let noticed = std::panic::catch_unwind(|| Traffic::tuned(&seeds, 1, tuning).run(200_000));
        assert!(
            noticed.is_err(),
            "a console without `{name}` was not found out"
        );
    }
}

#[test]
fn a_host_bears_what_consoles_say() {
    let tally = frames(Target::Host);
    assert!(2 * tally.restamped >= tally.mutated && 5 * tally.accepted >= tally.frames);
    assert!(tally.heard_again >= 4000);
}

#[test]
fn scenes_are_read_or_refused() {
    let files = files(Target::Scene);
    assert!(20 * files.accepted >= files.files && 10 * files.accepted <= 9 * files.files);
}

#[test]
fn meshes_are_read_or_refused() {
    let files = files(Target::Mesh);
    assert!(20 * files.accepted >= files.files && 10 * files.accepted <= 9 * files.files);
}

#[test]
fn recordings_are_replayed_or_refused() {
    let files = files(Target::Recording);
    assert!(20 * files.accepted >= files.files && 10 * files.accepted <= 9 * files.files);
}

/// Of what is left of the seeds every tick comes out as it was recorded.
#[test]
fn recordings_are_good_as_they_are() {
    let seeds = seeds::recordings();
    assert!(seeds.len() > 1);
    for seed in seeds {
        let path = std::path::Path::new(&seed.name);
        let recording = Recording::from_bytes(path, &seed.bytes).expect("a recording");
        let mut console = NativeTicks::new(&recording.about.plan.device);
        let verdict = replay_console(&recording, &mut console);
        assert!(verdict.ticks > 100, "{}", seed.name);
        assert_eq!(verdict.verified_ticks, verdict.ticks, "{}", seed.name);
        assert!(sutura_fuzz::recording(&seed.bytes));
    }
}

#[test]
fn seeds_are_good_as_they_are() {
    for (target, reader) in [
        ("scene", sutura_fuzz::scene as fn(&[u8]) -> bool),
        ("mesh", sutura_fuzz::mesh),
    ] {
        let files = seeds::files(target);
        assert!(files.len() > 4);
        for file in files {
            let good = reader(file.text.as_bytes());
            // One names a mesh that is not there; regressions are bad on purpose.
            let bad = file.name.starts_with("no-mesh") || file.name.starts_with("regression");
            assert_eq!(good, !bad, "{target}: {}", file.name);
        }
    }
}

/// What libFuzzer would call, on what it would begin with.
#[test]
fn streams_of_seeds_are_borne() {
    for seed in seeds::frames() {
        sutura_fuzz::stream(&seed.body);
        sutura_fuzz::host(&seed.body);
    }
}
