//! Ways in which a session ends: none is `ok` where limits cut the force, a tool was inside, or what was felt and what was touched
//! are not the same.
#![allow(clippy::unwrap_used, reason = "tests")]

use crate::support::session::{Plane, device, patient, plan, undisturbed};
use crate::support::{root, sutura, sutura_in};
use serde_json::{Map, Value};
use std::ops::ControlFlow;
use std::path::Path;
use std::time::Duration;
use sutura_hil::{NativeConsole, VirtualConsole};
use sutura_host::link::{LinkError, LockstepConsole, Order};
use sutura_host::scene::BUILT_IN_DEVICES;
use sutura_host::session::{
    Arms, Attendant, EndingKind, Instruction, Line, Plan, Progress, Solve, Solved, Steer, Steered,
    Stop, Summary, run_lockstep, run_real_time, run_steered,
};
use sutura_host::step::{Status, ToolContact};
use sutura_shared::wire::Valid;
use sutura_shared::wire::message::{Command, Mode, State};
use sutura_testkit::{Random, full};

/// Slew of a joint, so slow that the press is over before its force is there \[N/s\].
const SLOW_N_PER_S: f64 = 21.0;

/// A ball that a hand presses 8 mm into a slab; the modulus \[Pa\], and the device.
fn press(youngs_modulus_pa: f64, device: &str) -> String {
    format!(
        r#"
name = "A press"
seconds = 0.8
device = "{device}"
host = {{ host_hz = 100.0 }}

[mesh.slab]
size_m = [0.06, 0.06, 0.03]
divisions = [6, 6, 3]

[tissue]
model = "linear"
youngs_modulus_pa = {youngs_modulus_pa:?}
poisson_ratio = 0.4

[[fixed]]
plane = {{ axis = "z", at_m = -0.03 }}

[[tool]]
radius_m = 0.036

[hand]
stiffness_n_per_m = 2000.0
damping_n_s_per_m = 10.0
way_point = [{{ time_s = 0.0, position_m = [0.0, 0.0, 0.037] }}, {{ time_s = 0.3, position_m = [0.0, 0.0, 0.028] }}]
"#
    )
}

/// Exit code, summary and stderr of `sutura run --lockstep --format json` with this scene.
fn run(folder: &Path, scene: &str, more: &[&str]) -> (i32, Value, String) {
    std::fs::write(folder.join("scene.toml"), scene).unwrap();
    let line = ["run", "scene.toml", "--lockstep", "--format", "json"];
    let ran = sutura_in(folder, &[&line[..], more].concat());
    (ran.code, ran.json(), ran.stderr)
}

fn word(summary: &Value) -> &str {
    let status = summary["status"].as_str().unwrap();
    status.split_once(':').map_or(status, |(word, _)| word)
}

/// The arm gives 2 N at most, where the bench console gives more: the summary, the table and a replay say in how many ticks.
#[test]
fn a_force_that_the_device_cuts_off_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let (code, free, _) = run(folder.path(), &press(20e3, "cartesian-bench"), &[]);
    assert_eq!((code, word(&free)), (0, "ok"), "{}", free["status"]);
    assert_eq!(free["ticks_limited"]["force"], 0);
    let due_n = free["force_n"]["peak"].as_f64().unwrap();
    assert!(due_n > 2.3, "{due_n} N");

    let scene = press(20e3, "serial-arm");
    let record = ["--record", "press.mcap"];
    let (code, cut, stderr) = run(folder.path(), &scene, &record);
    assert_eq!((code, word(&cut)), (0, "limited"), "{stderr}");
    let limited = &cut["ticks_limited"];
    assert!(limited["force"].as_u64() > Some(100), "{limited}");
    assert!(limited["power"].is_u64() && limited["slew"].is_u64());
    let [peak_n, solved_n] =
        ["peak", "solved_peak"].map(|key| cut["force_n"][key].as_f64().unwrap());
    assert!(
        (peak_n - 2.0).abs() < 1e-3 && solved_n > 2.2,
        "{peak_n} of {solved_n} N"
    );
    for words in ["limited: ", "largest force, 2 N", "press less deep"] {
        assert!(stderr.contains(words), "{words}: {stderr}");
    }
    let table = sutura_in(folder.path(), &["run", "scene.toml", "--lockstep"]);
    let row = format!("limited    force in {} ticks", limited["force"]);
    assert!(table.stdout.contains(&row), "{}", table.stdout);
    let replayed = sutura_in(folder.path(), &["replay", "press.mcap", "--format", "json"]);
    assert_eq!(replayed.code, 0, "{}", replayed.stderr);
    assert_eq!(&replayed.json()["console"]["ticks_limited"], limited);
}

/// A device file beside the scene: the bench console with some keys changed.
fn bench(folder: &Path, changes: &[(&str, f64)]) {
    let (_, text) = BUILT_IN_DEVICES[0];
    let changed = |line: &str| {
        let of = |key: &str| {
            line.strip_prefix(key)
                .is_some_and(|rest| rest.starts_with(" ="))
        };
        let change = changes.iter().find(|(key, _)| of(key));
        change.map_or(line.to_owned(), |(key, value)| format!("{key} = {value:?}"))
    };
    let lines: Vec<String> = text.lines().map(changed).collect();
    std::fs::write(folder.join("mine.toml"), lines.join("\n")).unwrap();
}

/// The words name the limit that cut, with its value as it was written, and the next step is one against that limit.
#[test]
fn the_limit_that_cut_is_named() {
    let named = |changes: &[(&str, f64)]| {
        let folder = tempfile::tempdir().unwrap();
        bench(folder.path(), changes);
        run(folder.path(), &press(20e3, "mine.toml"), &[])
    };
    for (changes, words, help) in [
        (
            ("max_force_n", 1.1),
            "the device's largest force, 1.1 N, cut the force off in ",
            "a device with more force",
        ),
        (
            ("max_power_w", 0.003),
            "the device's largest power, 0.003 W, cut the force off in ",
            "a device with more force",
        ),
        (
            ("max_current_a", 0.9),
            "the largest current of a motor cut the force off in ",
            "motors with more current",
        ),
    ] {
        let (code, summary, stderr) = named(&[changes]);
        let status = summary["status"].as_str().unwrap();
        assert_eq!((code, word(&summary)), (0, "limited"), "{status}: {stderr}");
        let said = format!("limited: {words}");
        assert!(status.starts_with(&said), "{said}: {status}");
        assert!(!status.contains(" in 0"), "{status}");
        assert!(stderr.contains(&said) && stderr.contains(help), "{stderr}");
    }
    // Gravity alone takes more than these motors have.
    let (code, summary, stderr) = named(&[("max_current_a", 0.01)]);
    let status = summary["status"].as_str().unwrap();
    assert_eq!((code, word(&summary)), (8, "not-rendered"), "{status}");
    let words = "N: the largest current of a motor cut the force off in ";
    assert!(status.contains(words), "{status}");
    for help in [words, "motors with more current"] {
        assert!(stderr.contains(help), "{help}: {stderr}");
    }
    assert!(!stderr.contains("came too late"), "{stderr}");
}

/// Slew that lets less than half of the force through: not `ok`, and said.
#[test]
fn a_force_that_slew_takes_away_is_said() {
    let folder = tempfile::tempdir().unwrap();
    bench(folder.path(), &[("max_slew_n_per_s", SLOW_N_PER_S)]);
    let (code, summary, stderr) = run(folder.path(), &press(20e3, "mine.toml"), &[]);
    assert_eq!((code, word(&summary)), (0, "limited"), "{summary}");
    let force = |key: &str| summary["force_n"][key].as_f64().unwrap();
    assert!(force("peak") < 0.5 * force("solved_peak"), "{summary}");
    for words in ["limited: ", "ticks_withheld", "more slew"] {
        assert!(stderr.contains(words), "{words}: {stderr}");
    }
}

/// A line that brings every frame of the console twice.
struct Twice(NativeConsole);

impl LockstepConsole for Twice {
    fn exchange(&mut self, down: &[u8], up: &mut Vec<u8>) -> Result<(), LinkError> {
        self.0.exchange(down, up)?;
        up.extend_from_within(..);
        Ok(())
    }

    fn name(&self) -> &str {
        "twice"
    }
}

/// Frames that are refused all the time leave a session `ok`, and are said with the reason that came most.
#[test]
fn many_refused_frames_are_said() {
    let ran = |console: &mut dyn LockstepConsole| {
        let go_on = |_: &Progress<'_>| ControlFlow::Continue(());
        run_lockstep(console, &plan(0.5), &mut Plane, go_on).unwrap()
    };
    let good = ran(&mut NativeConsole::new(&device()).unwrap());
    assert!(good.refusals.is_empty(), "{:?}", good.refusals);
    let twice = ran(&mut Twice(NativeConsole::new(&device()).unwrap()));
    assert_eq!(twice.status, "ok");
    let said = twice.refusals.concat();
    assert!(
        said.contains("frames of the console were refused")
            && said.contains("duplicate or out of order"),
        "{said}"
    );
}

/// Pa where kPa were meant: nobody feels it, and the run says so.
#[test]
fn tissue_that_nobody_feels_is_no_success() {
    let folder = tempfile::tempdir().unwrap();
    for modulus_pa in [12.0, 0.012] {
        let scene = press(modulus_pa, "cartesian-bench");
        let (code, summary, stderr) = run(folder.path(), &scene, &[]);
        assert_eq!((code, word(&summary)), (8, "faint"), "{stderr}");
        assert!(summary["contact_steps"].as_u64() > Some(25));
        assert!(stderr.contains("is the modulus in Pa?"), "{stderr}");
    }
    // A thread that stays slack pulls at nothing.
    let shaft = std::fs::read_to_string(root().join("scenes/thread-over-shaft.toml")).unwrap();
    for (taut, slack) in [
        ("length_m = 0.0808", "length_m = 0.085"),
        ("0.0007, -0.033]", "0.0007, -0.0093]"),
    ] {
        let slack = shaft.replace(taut, slack);
        assert_ne!(shaft, slack);
        let (code, summary, stderr) = run(folder.path(), &slack, &[]);
        assert_eq!((code, word(&summary)), (0, "ok"), "{stderr}");
    }
    // Nothing is too soft if nothing was touched.
    let away = press(12.0, "cartesian-bench").replace("0.037]", "0.05]");
    let away = away.replace("0.028]", "0.045]");
    let (code, summary, stderr) = run(folder.path(), &away, &[]);
    assert_eq!((code, word(&summary)), (0, "ok"), "{stderr}");
    assert!(stderr.contains("touched nothing"), "{stderr}");
}

/// A shaft so thin that a step follows 30 um of its way: its hand feels no force of geometry that nobody has solved, and the session
/// does not pass for a success.
#[test]
fn a_shaft_that_lags_behind_its_hand_feels_nothing_foretold() {
    let scene = r#"
name = "A needle pushed by a shaft"
seconds = 5.0
device = "cartesian-bench"
host = { host_hz = 125.0, horizon_ms = 60.0 }

[mesh.slab]
size_m = [0.03, 0.03, 0.012]
divisions = [8, 8, 3]

[tissue]
model = "linear"
youngs_modulus_pa = 30e3
poisson_ratio = 0.45

[tissue.needle]
surface_friction = 0.2
friction_n_per_m = 15.0
cutting_pa = 1e5
puncture_pa = 5e5

[[fixed]]
plane = { axis = "z", at_m = -0.012 }

[[tool]]
id = 0
shape = "grip"
body = { radius_m = 0.000002, length_m = 0.04, axis = [0.0, 1.0, 0.0], offset_m = [0.0, 0.02, 0.0] }

[[tool]]
id = 1
shape = "grip"
way_point = [
  { time_s = 0.1, position_m = [0.0013, 0.0007, 0.032] },
  { time_s = 1.0, position_m = [0.0013, 0.0007, 0.020] },
  { time_s = 1.3, position_m = [0.0013, 0.0007, 0.020] },
  { time_s = 1.8, position_m = [0.0013, 0.0307, 0.040] },
]

[[needle]]
shape = "straight"
length_m = 0.03
thickness_m = 0.0008
end_m = [0.0013, 0.0007, 0.032]
direction = [0.0, 0.0, -1.0]
body = true
hold = [{ time_s = 0.0, tool = 1 }, { time_s = 1.2 }]

[[body_contact]]
between = [{ needle = 0 }, { tool = 0 }]

[hand]
stiffness_n_per_m = 1000.0
damping_n_s_per_m = 10.0
way_point = [
  { time_s = 0.0, position_m = [-0.02, 0.002, 0.008] },
  { time_s = 1.8, position_m = [-0.01, 0.002, 0.008] },
  { time_s = 3.5, position_m = [0.006, 0.002, 0.008] },
  { time_s = 5.0, position_m = [-0.02, 0.002, 0.008] },
]
"#;
    let folder = tempfile::tempdir().unwrap();
    let (code, summary, stderr) = run(folder.path(), scene, &[]);
    let felt_n = summary["force_n"]["peak"].as_f64().unwrap();
    let solved_n = summary["force_n"]["solved_peak"].as_f64().unwrap();
    // The extrapolation from a frame along the hand's path is left.
    assert!(felt_n <= solved_n + 0.2, "{felt_n} of {solved_n} N");
    assert!(summary["steps_outrun"].as_u64() > Some(50), "{summary}");
    // If nothing at all is felt, the lag is the reason.
    let words = ["untouched", "behind"];
    assert!(code == 8 && words.contains(&word(&summary)), "{stderr}");
}

/// A plane of springs as a solver that is right in some steps.
#[derive(Clone, Copy, Debug)]
struct Drawn {
    stiffness_n_per_m: f64,
    max_force_n: f64,
    max_power_w: f64,
    max_slew_n_per_s: f64,
    /// Part of the steps in contact that end inside.
    inside: f64,
    /// Whether steps foretell a contact that none of them finds.
    ghost: bool,
    /// Whether such steps are in contact all the same, without a force.
    grazes: bool,
    /// Whether nothing is sent in contact.
    mute: bool,
    seed: u64,
}

struct Springs {
    drawn: Drawn,
    random: Random,
    inside: u64,
    touched: u64,
    largest_n: f64,
}

impl Solve for Springs {
    fn solve(&mut self, state: &Valid<State>) -> Solved {
        let z = f64::from(state.body().position_m[2]);
        let Drawn {
            stiffness_n_per_m,
            inside,
            ghost,
            grazes,
            mute,
            ..
        } = self.drawn;
        let is_in = z < 0.0;
        if is_in && self.random.chance(inside) {
            self.inside += 1;
            return Solved {
                status: Status::Inside,
                touched: true,
                ..Solved::default()
            };
        }
        let touched = is_in && (!ghost || grazes);
        let mut contact = ToolContact {
            normal: [0.0, 0.0, 1.0],
            gap_m: if ghost { 1e-4 } else { z.max(0.0) },
            ..ToolContact::default()
        };
        if touched && !ghost {
            contact.wrench[2] = -stiffness_n_per_m * z;
            self.touched += 1;
            self.largest_n = self.largest_n.max(contact.wrench[2]);
        }
        contact.tangent[2][2] = -stiffness_n_per_m;
        Solved {
            position_m: match ghost {
                true => [0.0, 0.0, z.max(1e-3) as f32],
                false => state.body().position_m,
            },
            contact: (!(mute && touched)).then_some(contact),
            status: Status::Ok,
            touched,
            presses: touched,
            ..Solved::default()
        }
    }

    fn scene(&self) -> Map<String, Value> {
        Map::new()
    }
}

/// The session of a draw, its solver, and the ticks that the console's limits cut by force and by power.
fn session(drawn: Drawn) -> (Summary, Springs, [u32; 2]) {
    let plan = plan(0.9);
    let mut device = device();
    (device.max_force_n, device.max_power_w) = (drawn.max_force_n as f32, drawn.max_power_w as f32);
    for joint in &mut device.joints {
        joint.max_slew_per_s = drawn.max_slew_n_per_s as f32;
    }
    let plan = Plan { device, ..plan };
    let mut console = NativeConsole::new(&device).unwrap();
    let mut solver = Springs {
        drawn,
        random: Random::new(drawn.seed),
        inside: 0,
        touched: 0,
        largest_n: 0.0,
    };
    let go_on = |_: &Progress<'_>| ControlFlow::Continue(());
    let summary = run_lockstep(&mut console, &plan, &mut solver, go_on).unwrap();
    let ticks = console.console().control().ticks_limited();
    (summary, solver, [ticks.force, ticks.power])
}

const SOUND: Drawn = Drawn {
    stiffness_n_per_m: 300.0,
    max_force_n: 10.0,
    max_power_w: 5.0,
    max_slew_n_per_s: 2000.0,
    inside: 0.0,
    ghost: false,
    grazes: false,
    mute: false,
    seed: 1,
};

/// Each ending has its word, and its word alone.
#[test]
fn each_ending_has_its_word() {
    use EndingKind::{Faint, Inside, Limited, NotRendered, Ok, Untouched};
    let soft = SOUND.stiffness_n_per_m * 1e-5;
    for (kind, drawn) in [
        (Ok, SOUND),
        (
            Limited,
            Drawn {
                max_force_n: 1.5,
                ..SOUND
            },
        ),
        (
            Limited,
            Drawn {
                max_power_w: 0.01,
                ..SOUND
            },
        ),
        (
            Limited,
            Drawn {
                stiffness_n_per_m: 1400.0,
                max_slew_n_per_s: 20.1,
                ..SOUND
            },
        ),
        (
            Inside,
            Drawn {
                inside: 0.05,
                ..SOUND
            },
        ),
        (
            NotRendered,
            Drawn {
                inside: 0.5,
                ..SOUND
            },
        ),
        (
            NotRendered,
            Drawn {
                mute: true,
                ..SOUND
            },
        ),
        (
            Untouched,
            Drawn {
                ghost: true,
                ..SOUND
            },
        ),
        (
            Untouched,
            Drawn {
                ghost: true,
                grazes: true,
                ..SOUND
            },
        ),
        (
            Faint,
            Drawn {
                stiffness_n_per_m: soft,
                ..SOUND
            },
        ),
    ] {
        let (summary, _, _) = session(drawn);
        assert_eq!(summary.ending.kind, kind, "{drawn:?}: {}", summary.status);
        assert!(
            summary.status.starts_with(kind.word()),
            "{}",
            summary.status
        );
    }
}

/// No session ends `ok` when more than ten ticks were cut by force or power, or by slew or energy account with less than half of
/// the force felt; when a tool was inside; or when a contact was found and nothing felt, or the other way round.
#[test]
fn no_session_that_ends_ok_was_cut_inside_or_felt_otherwise() {
    let seed = std::env::var("PROPTEST_RNG_SEED").ok();
    let seed = seed.and_then(|seed| seed.parse().ok()).unwrap_or(1);
    let cases = if full() { 2000 } else { 60 };
    println!("PROPTEST_RNG_SEED={seed}");
    let mut random = Random::new(seed);
    let mut good = 0;
    for _ in 0..cases {
        let drawn = Drawn {
            stiffness_n_per_m: 10f64.powf(random.between(-3.0, 3.5)),
            max_force_n: random.between(0.5, 10.0),
            max_power_w: 10f64.powf(random.between(-2.5, 0.7)),
            max_slew_n_per_s: 0.0,
            inside: if random.chance(0.3) {
                random.unit()
            } else {
                0.0
            },
            ghost: random.chance(0.1),
            grazes: random.chance(0.5),
            mute: random.chance(0.1),
            seed: random.bits(),
        };
        // Twice the largest force a second is the least that a device may have.
        let drawn = Drawn {
            max_slew_n_per_s: drawn.max_force_n * 10f64.powf(random.between(0.31, 2.5)),
            ..drawn
        };
        let (summary, solver, [force, power]) = session(drawn);
        let said = format!("{drawn:?}: {}, {:?}", summary.status, summary.force_n);
        let ticks = summary.ticks_limited;
        assert_eq!(
            (ticks.force, ticks.power),
            (force.into(), Some(power.into())),
            "{said}"
        );
        if summary.status != "ok" {
            continue;
        }
        good += 1;
        assert!(force <= 10 && power <= 10, "{said}");
        let slew = ticks.slew.unwrap_or(0);
        let is_half = summary.force_n.peak >= 0.5 * summary.force_n.solved_peak;
        assert!(
            is_half || (slew <= 10 && summary.ticks_withheld <= 10),
            "{said}: {ticks:?}"
        );
        assert_eq!(solver.inside, 0, "{said}");
        let felt_n = summary.force_n.peak;
        assert!(solver.largest_n < 0.05 || felt_n > 5e-3, "{said}");
        assert!(solver.largest_n > 5e-3 || felt_n <= 0.05, "{said}");
        // Ten ticks are beyond doubt where states say so by themselves.
        assert!(felt_n <= drawn.max_force_n * (1.0 + 1e-6), "{said}");
    }
    println!("{good} of {cases} ended ok");
}

/// In this process the console counts by itself; behind a port its states tell of the largest force alone.
#[test]
fn over_a_port_states_tell_of_the_largest_force_alone() {
    let plan = plan(0.6);
    let mut device = device();
    device.max_force_n = 1.0;
    let plan = Plan { device, ..plan };
    for is_asked in [true, false] {
        let (summary, told) = undisturbed(|| {
            let mut console = VirtualConsole::start_in_memory(&device).unwrap();
            let line = Line::Once {
                port: console.host_port().unwrap(),
                attendant: None,
                limits: is_asked.then(|| console.limits()),
            };
            let mut told = None;
            let ran = run_real_time(line, patient(), &plan, &mut Plane, |note| {
                told = Some(note.limited);
                ControlFlow::Continue(())
            });
            Some((ran.ok()?, told?))
        });
        let ticks = summary.ticks_limited;
        assert_eq!(
            [ticks.power, ticks.speed, ticks.slew].map(|count| count.is_some()),
            [is_asked; 3]
        );
        assert_eq!(told.power.is_some(), is_asked);
        // A machine that is late may let the console go before it is pressed.
        if summary.force_n.peak > 0.9999 {
            assert!(ticks.force > 0, "{ticks:?}");
        }
    }
}

/// Says instructions at ticks, and counts the ticks before which the console was armed.
struct Scripted<'a> {
    script: &'a [(u64, &'a [Instruction])],
    begins_at_rest: bool,
    armed_ticks: u64,
}

impl Steer for Scripted<'_> {
    fn begins_at_rest(&mut self) -> bool {
        self.begins_at_rest
    }

    fn steer(&mut self, now: &Steered<'_>, instructions: &mut Vec<Instruction>) -> ControlFlow<()> {
        self.armed_ticks += u64::from(now.state.mode == Mode::Armed);
        let rounds = self.script.iter().filter(|(tick, _)| *tick == now.ticks);
        instructions.extend(rounds.flat_map(|(_, round)| round.iter().cloned()));
        ControlFlow::Continue(())
    }
}

const ARM: Instruction = Instruction::Order(Order::Command(Command::Arm));
const DISARM: Instruction = Instruction::Order(Order::Command(Command::Disarm));

fn stop_by(person: &str) -> Instruction {
    Instruction::Stop(Stop::Safe, person.to_owned())
}

/// Runs a session with a script; the summary, and the ticks before which the console was armed.
fn scripted(begins_at_rest: bool, script: &[(u64, &[Instruction])]) -> (Summary, u64) {
    let mut console = NativeConsole::new(&device()).unwrap();
    let mut steer = Scripted {
        script,
        begins_at_rest,
        armed_ticks: 0,
    };
    let go_on = |_: &Progress<'_>| ControlFlow::Continue(());
    let ran = run_steered(&mut console, &plan(1.2), &mut Plane, go_on, &mut steer).unwrap();
    (ran, steer.armed_ticks)
}

/// Persons who asked for safe stops, and when \[s\].
fn stops(summary: &Summary) -> Vec<(&str, f64)> {
    let each = summary.safe_stops.iter();
    each.map(|stop| (stop.by.as_str(), stop.at_s)).collect()
}

/// A console that a person stopped did not let go, and who it was is in the summary, also where it was armed again.
#[test]
fn a_safe_stop_is_in_the_summary_with_its_person() {
    let stop = [stop_by("page 7"), DISARM];
    let (rests, _) = scripted(false, &[(500, &stop)]);
    assert_eq!(rests.status, "stopped: safe stop by page 7 at 0.50 s");
    assert_eq!(rests.mode, "idle");
    let (armed, _) = scripted(false, &[(500, &stop), (700, &[ARM])]);
    assert_eq!(
        (armed.status.as_str(), armed.mode.as_str()),
        ("ok", "armed")
    );
    for summary in [rests, armed] {
        assert_eq!(stops(&summary), [("page 7", 0.5)]);
    }
}

/// Of safe stops and orders to arm before one tick the last one counts, for the console and for the words alike.
#[test]
fn a_safe_stop_and_arming_before_one_tick_count_in_their_order() {
    let [first, second] = ["page 7", "page 8"].map(stop_by);
    let ended = |script: &[(u64, &[Instruction])]| {
        let (summary, _) = scripted(false, script);
        let by: Vec<String> = stops(&summary).iter().map(|(by, _)| (*by).into()).collect();
        (summary.status, summary.mode, by.join(", "))
    };
    let said = |status: &str, mode: &str, by: &str| (status.into(), mode.into(), by.into());
    let stop = [first.clone(), DISARM];
    assert_eq!(
        ended(&[(500, &[ARM, first.clone(), DISARM])]),
        said("stopped: safe stop by page 7 at 0.50 s", "idle", "page 7")
    );
    assert_eq!(
        ended(&[(500, &[first.clone(), DISARM, ARM])]),
        said("ok", "armed", "page 7")
    );
    assert_eq!(
        ended(&[(500, &[first, DISARM, ARM, second.clone(), DISARM])]),
        said(
            "stopped: safe stop by page 8 at 0.50 s",
            "idle",
            "page 7, page 8"
        )
    );
    // At rest nothing has shown the console armed when it is stopped anew.
    assert_eq!(
        ended(&[(500, &stop), (700, &[ARM, second, DISARM])]),
        said(
            "stopped: safe stop by page 8 at 0.70 s",
            "idle",
            "page 7, page 8"
        )
    );
}

/// A session that begins at rest is armed in no tick, and says who stopped it, until somebody arms it.
#[test]
fn a_session_begins_at_rest_after_a_safe_stop() {
    let stop = [stop_by("page 7"), DISARM];
    let (rests, armed_ticks) = scripted(true, &[(1, &stop)]);
    assert_eq!(rests.status, "stopped: safe stop by page 7 at 0.00 s");
    assert_eq!((rests.mode.as_str(), armed_ticks), ("idle", 0));
    assert_eq!(rests.force_n.peak, 0.0);
    assert_eq!(stops(&rests), [("page 7", 0.001)]);
    let (armed, armed_ticks) = scripted(true, &[(1, &stop), (300, &[ARM])]);
    assert_eq!(
        (armed.status.as_str(), armed.mode.as_str()),
        ("ok", "armed")
    );
    assert!((890..900).contains(&armed_ticks), "{armed_ticks}");
}

/// Stops the console before it is known to be armed.
struct Early {
    is_told: bool,
}

impl Attendant for Early {
    fn lost(&mut self, _: &LinkError) {}

    fn back(&mut self) {}

    fn arms(&mut self) -> Arms {
        Arms::No
    }

    fn stops(&mut self) -> Vec<(Stop, String)> {
        match std::mem::replace(&mut self.is_told, true) {
            true => Vec::new(),
            false => vec![(Stop::Safe, "page 7".to_owned())],
        }
    }

    fn wait(&mut self, most: Duration) -> Option<Order> {
        if self.is_told {
            std::thread::sleep(most);
            return None;
        }
        Some(Order::Command(Command::Disarm))
    }
}

/// In real time a safe stop holds a console that is about to be armed, and the session goes on at rest.
#[test]
fn a_safe_stop_before_the_console_is_armed_holds_it() {
    let mut console = VirtualConsole::start_in_memory(&device()).unwrap();
    let line = Line::Once {
        port: console.host_port().unwrap(),
        attendant: Some(Box::new(Early { is_told: false })),
        limits: None,
    };
    let go_on = |_: &Progress<'_>| ControlFlow::Continue(());
    let ran = run_real_time(line, patient(), &plan(0.5), &mut Plane, go_on).unwrap();
    assert!(
        ran.status.starts_with("stopped: safe stop by page 7 at "),
        "{}",
        ran.status
    );
    assert_eq!((ran.mode.as_str(), ran.safe_stops.len()), ("idle", 1));
}

/// `sutura schema run` and the help say what a status may be.
#[test]
fn the_words_of_a_status_are_described() {
    let described = sutura(&["schema", "run"]).stdout;
    for kind in [
        EndingKind::Fault,
        EndingKind::NotRendered,
        EndingKind::Inside,
        EndingKind::Overlap,
        EndingKind::Untouched,
        EndingKind::Behind,
        EndingKind::Faint,
        EndingKind::Stopped,
        EndingKind::Idle,
        EndingKind::Limited,
        EndingKind::Ok,
    ] {
        assert!(
            described.contains(&format!("`{}`", kind.word())),
            "{kind:?}"
        );
    }
}

/// Two slabs that may touch, the lower one this far below the upper one, which a weight presses down at its free end [N].
fn slabs(apart_m: f64, down_n: f64, divisions: usize) -> String {
    let below_m = -0.01 - apart_m;
    format!(
        r#"
name = "Two slabs"
seconds = 0.1
device = "cartesian-bench"

[[mesh.part]]
name = "lower"
slab = {{ size_m = [0.04, 0.04, 0.01], divisions = [{divisions}, {divisions}, 2] }}
at_m = [0.0, 0.0, {below_m:?}]

[[mesh.part]]
name = "upper"
slab = {{ size_m = [0.04, 0.04, 0.01], divisions = [{upper}, {upper}, 2] }}

[tissue]
model = "linear"
youngs_modulus_pa = 20e3
poisson_ratio = 0.45

[[fixed]]
plane = {{ axis = "z", at_m = {:?} }}

[[fixed]]
plane = {{ axis = "x", at_m = -0.02 }}

[[tissue_contact]]
between = ["lower", "upper"]
friction = 0.3

[[load]]
on = {{ plane = {{ axis = "z", at_m = 0.0 }} }}
total_force_n = [0.0, 0.0, {:?}]

[[tool]]
shape = "grip"
driven = true

[hand]
stiffness_n_per_m = 700.0
damping_n_s_per_m = 10.0
way_point = [{{ time_s = 0.0, position_m = [0.0, 0.0, 0.03] }}]
"#,
        below_m - 0.01,
        -down_n,
        upper = divisions + 1,
    )
}

/// Status word and wound of `sutura solve` and `sutura run`, with the exit codes of these and of `sutura scene check`.
fn pressed(scene: &str) -> ([i32; 3], [Value; 2], String) {
    let folder = tempfile::tempdir().unwrap();
    let (ran, summary, _) = run(folder.path(), scene, &[]);
    let solve = ["solve", "scene.toml", "--out", "x.json", "--format", "json"];
    let solved = sutura_in(folder.path(), &solve);
    let checked = sutura_in(folder.path(), &["scene", "check", "scene.toml"]);
    let codes = [checked.code, solved.code, ran];
    (codes, [solved.json(), summary], checked.stderr)
}

/// Loads that press parts on each other are borne by both, where a quarter of an edge is less than their gap.
#[test]
fn parts_that_may_touch_do_not_go_through_each_other() {
    let ([checked, solved, ran], [solution, summary], said) = pressed(&slabs(1e-3, 0.1, 12));
    assert_eq!((checked, solved, ran), (0, 0, 0), "{said}");
    let [wound, scene] = [&solution["wound"], &summary["scene"]];
    for said in [wound, scene] {
        assert!(said["touching"].as_u64().unwrap() > 5, "{said}");
        assert!(said["penetration_ratio"].as_f64().unwrap() < 1e-3, "{said}");
    }
    assert_eq!((word(&solution), word(&summary)), ("ok", "ok"));
    let below_n = solution["fixed_reactions"][0]["force_n"][2]
        .as_f64()
        .unwrap();
    assert!((0.02..0.08).contains(&below_n), "{below_n} N");
    // By itself the upper one would move by more than its size; on the lower one it does not.
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("scene.toml"), slabs(1e-3, 1.0, 12)).unwrap();
    let checked = sutura_in(folder.path(), &["scene", "check", "scene.toml"]);
    assert_eq!(checked.code, 0, "{}", checked.stderr);
}

/// Parts that nothing keeps apart are said, by whoever is asked.
#[test]
fn parts_in_each_other_are_no_good_end() {
    let ([checked, solved, ran], [solution, summary], said) = pressed(&slabs(-2e-3, 0.01, 6));
    assert_eq!((checked, solved, ran), (2, 8, 8));
    assert!(said.contains("deep in each other"), "{said}");
    assert_eq!((word(&solution), word(&summary)), ("overlap", "overlap"));
}
