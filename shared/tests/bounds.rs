//! Bounded by construction: whatever the encoders and the host send, the motors get little, and slowly.
//!
//! Some thousand cases, always the same; a million with `SUTURA_FULL=1`, as many and such as `PROPTEST_CASES` and
//! `PROPTEST_RNG_SEED` say. What was once found is in `kept/`.

#![allow(clippy::unwrap_used, reason = "a test")]

use crate::events::{Counts, Dice, Event, SILENCE, from_text, shrink, to_text};
use crate::rig::{arm, bench, fixture_frame, frame};
use proptest::test_runner::{Config, RngSeed};
use std::path::Path;
use sutura_shared::control::{
    Control, Guards, MAX_HORIZON_US, STALE_DECAY_US, TICK_S, TickInput, TickOutput, Tuning,
};
use sutura_shared::device::DeviceDescription;
use sutura_shared::kinematics;
use sutura_shared::math::max;
use sutura_shared::wire::message::{Fixture, Mode, State};
use sutura_shared::wire::{Message, faults};
use sutura_testkit::full;

/// Rounding of a handful of operations in single precision.
const ROUNDING: f32 = 1e-5;
/// Cases unless another number is asked for, and those of the long form.
const CASES: u32 = 3000;
const FULL_CASES: u32 = 1_000_000;
/// Most events of a case.
const EVENTS: u64 = 400;
/// Ticks without a fixture's push after which none of it is left: the slew limits take 8 at most.
const FADED_TICKS: u32 = 10;

/// What was promised, or why that is broken.
type Held = Result<(), String>;

macro_rules! hold {
    ($condition:expr, $($what:tt)*) => {
        // What is no number breaks a promise, too.
        let is_held: bool = $condition;
        if !is_held {
            return Err(format!("{}: {}", stringify!($condition), format!($($what)*)));
        }
    };
}

/// What the switches of a case turn on, and its events.
struct Case {
    switches: [bool; 2],
    events: Vec<Event>,
}

/// Holds over the cases that are kept of this name, and over all that are drawn.
fn holds_over_all(name: &str, promise: impl Fn([bool; 2], &[Event]) -> Held) {
    for (path, case) in kept(name) {
        if let Err(broken) = promise(case.switches, &case.events) {
            panic!("{path}: {broken}");
        }
    }
    let config = Config::default();
    let cases = match config.cases {
        256 if full() => FULL_CASES,
        256 => CASES,
        chosen => chosen,
    };
    let first = match config.rng_seed {
        RngSeed::Fixed(seed) => seed,
        RngSeed::Random => 1,
    };
    for number in 0..u64::from(cases) {
        let mut dice = Dice::new(Dice::new(first).bits() ^ number);
        let switches = [dice.chance(0.5), dice.chance(0.5)];
        let count = 1 + dice.below(EVENTS - 1) as usize;
        let events = dice.events(count);
        if promise(switches, &events).is_err() {
            let events = shrink(&events, |events| promise(switches, events).is_err());
            let broken = promise(switches, &events).unwrap_err();
            let [a, b] = switches.map(u8::from);
            panic!(
                "case {number} of seed {first}: {broken}\n# {a} {b}\n{}",
                to_text(&events)
            );
        }
    }
}

/// Cases in `kept/NAME-*.txt`: two switches in the first line, then events.
fn kept(name: &str) -> Vec<(String, Case)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/kept");
    let files = std::fs::read_dir(folder)
        .unwrap()
        .map(|file| file.unwrap().path());
    let of_name = |path: &std::path::PathBuf| {
        let stem = path.file_stem().unwrap().to_string_lossy().into_owned();
        stem.rsplit_once('-')
            .is_some_and(|(start, _)| start == name)
    };
    let cases: Vec<_> = files
        .filter(of_name)
        .map(|path| {
            let text = std::fs::read_to_string(&path).unwrap();
            let first = text.lines().next().unwrap();
            let mut switches = first.split_whitespace().skip(1).map(|word| word == "1");
            let case = Case {
                switches: [switches.next().unwrap(), switches.next().unwrap()],
                events: from_text(&text),
            };
            (path.display().to_string(), case)
        })
        .collect();
    assert!(!cases.is_empty(), "no case of {name} is kept");
    cases
}

/// A control loop, and what has been asked of it.
struct Run {
    device: DeviceDescription,
    control: Control,
    input: TickInput,
    sequence: u32,
    before: Option<TickOutput>,
    /// Ticks since a fixture may have pushed.
    open_ticks: u32,
    carried: Carried,
}

/// What the motors may carry, by the test's own count: the weight comes in 300 ticks and goes in as many.
#[derive(Clone, Copy, Default)]
struct Carried {
    /// Ticks' worth of the weight.
    ticks: u16,
    /// Most effort of a joint's weight in any pose so far.
    most: [f32; 3],
}

impl Carried {
    fn note(&mut self, weight: &[f32; 3], output: &TickOutput) {
        for (most, weight) in self.most.iter_mut().zip(weight) {
            *most = max(*most, weight.abs());
        }
        self.ticks = match (output.state.mode, output.amplifiers_on) {
            (_, false) => 0,
            (Mode::Fault, true) => self.ticks.saturating_sub(1),
            (_, true) => (self.ticks + 1).min(300),
        };
    }

    fn part(&self) -> f32 {
        f32::from(self.ticks) / 300.0
    }
}

/// Faults after which the weight may still be carried, less and less.
const LETS_DOWN: u16 = faults::ENCODER_JUMP | faults::OUT_OF_REACH | faults::OVERSPEED;

/// Whether a fixture may push at this tick; a wall is felt some time ahead of the motion.
fn may_push(fixture: &Fixture, state: &State) -> bool {
    let Fixture::Wall {
        point_m, normal, ..
    } = fixture
    else {
        return *fixture != Fixture::None;
    };
    let speed: f32 = state.velocity_m_per_s.iter().map(|v| v.abs()).sum();
    let axes = normal.iter().zip(point_m).zip(&state.position_m);
    let deep_m: f32 = axes.map(|((n, wall), grip)| n * (wall - grip)).sum();
    deep_m + 5e-3 * speed + 1e-3 > 0.0
}

impl Run {
    /// Without the tank the force need not be paid for: all that holds it then are the limits.
    fn new(device: DeviceDescription, tank: bool) -> Self {
        let guards = Guards {
            tank,
            ..Guards::ALL
        };
        let tuning = Tuning {
            guards,
            ..Tuning::default()
        };
        Run {
            device,
            control: Control::tuned(device, tuning).unwrap(),
            input: TickInput::default(),
            sequence: 0,
            before: None,
            open_ticks: 0,
            carried: Carried::default(),
        }
    }

    fn tick(&mut self, event: &Event) -> TickOutput {
        self.input.now_us += 1000;
        let pairs = self.input.encoder_counts.iter_mut();
        match event.counts {
            Counts::Moved(steps) => {
                pairs
                    .zip(steps)
                    .for_each(|(c, step)| *c = c.wrapping_add(i32::from(step) / 6));
            }
            Counts::Anything(counts) => self.input.encoder_counts = counts,
        }
        let [emergency_stop, board_fault, overrun] = event.flags;
        self.input = TickInput {
            emergency_stop,
            board_fault,
            overrun,
            ..self.input
        };
        if let Some(command) = event.command {
            self.control.command(command);
        }
        if let Some(fixture) = event.fixture {
            self.sequence += 1;
            self.control.fix(&fixture_frame(self.sequence, fixture));
        }
        let fresh = event.contact.as_ref().map(|(age_us, body)| {
            self.sequence += 1;
            frame(
                self.sequence,
                self.input.now_us.saturating_sub(*age_us),
                *body,
            )
        });
        self.control
            .tick(&self.input, fresh.map(Into::into).as_ref())
    }

    /// Efforts that carry the weight at the pose of the encoders.
    fn weight(&self) -> [f32; 3] {
        let joints = self.input.encoder_counts.iter().zip(&self.device.joints);
        let mut q = [0.0; 3];
        for (q, (counts, joint)) in q.iter_mut().zip(joints) {
            *q = *counts as f32 * (1.0 / joint.counts_per_unit);
        }
        kinematics::forward(&self.device, &q).weight_effort
    }

    /// What must hold after every tick.
    fn check(&mut self, output: &TickOutput) -> Held {
        let state = &output.state;
        // The host accepts it: finite, in range.
        hold!(state.check() == Ok(()), "{state:?}");
        let square: f64 = state.force_n.iter().map(|f| f64::from(*f).powi(2)).sum();
        let limit = self.device.max_force_n * (1.0 + ROUNDING);
        hold!(square <= f64::from(limit).powi(2), "{state:?}");

        let before = self.before.map_or([0.0; 3], |before| before.current_a);
        for ((now, before), joint) in output.current_a.iter().zip(before).zip(&self.device.joints) {
            hold!(now.abs() <= joint.max_current_a, "{state:?}");
            let step_effort = (now - before) * joint.effort_per_amp;
            let limit = joint.max_slew_per_s * TICK_S * (1.0 + ROUNDING) + ROUNDING;
            // A fault takes the contact away at once; what is carried then is bounded below.
            let off = state.mode == Mode::Fault || !output.amplifiers_on && *now == 0.0;
            hold!(
                off || step_effort.abs() <= limit,
                "{before} {now} {state:?}"
            );
        }

        let torque = matches!(state.mode, Mode::Armed | Mode::Decaying);
        let lets_down = output.amplifiers_on && !torque;
        let may = state.mode == Mode::Fault && state.faults & !LETS_DOWN == 0;
        hold!(!lets_down || may, "{state:?}");
        hold!(!torque || output.amplifiers_on, "{state:?}");
        self.carried.note(&self.weight(), output);
        let motors = output.current_a.iter().zip(&self.device.joints);
        for ((current_a, joint), most) in motors.zip(self.carried.most) {
            let effort = (current_a * joint.effort_per_amp).abs();
            let carried = most * self.carried.part() * (1.0 + 1e-4) + ROUNDING;
            hold!(!lets_down || effort <= carried, "{carried} {state:?}");
        }
        hold!(
            (state.faults != 0) == (state.mode == Mode::Fault),
            "{state:?}"
        );
        hold!(torque || state.force_n == [0.0; 3], "{state:?}");
        hold!(
            output.amplifiers_on || output.current_a == [0.0; 3],
            "{state:?}"
        );
        self.open_ticks = match may_push(self.control.fixture(), state) {
            true => 0,
            false => self.open_ticks + 1,
        };
        let may_have_force =
            state.contact_age_us < MAX_HORIZON_US + STALE_DECAY_US || self.open_ticks < FADED_TICKS;
        hold!(
            may_have_force || state.force_n.map(f32::to_bits) == [0; 3],
            "{state:?}"
        );
        hold!(state.current_a == output.current_a, "{state:?}");
        self.before = Some(*output);
        Ok(())
    }
}

/// Switches: the jointed device, and the tank.
fn motors_bounded([jointed, tank]: [bool; 2], events: &[Event]) -> Held {
    let mut run = Run::new(if jointed { arm() } else { bench() }, tank);
    for event in events {
        let output = run.tick(event);
        run.check(&output)?;
    }
    // Silence: within the longest horizon and 30 ms there is no contact force left, whatever was
    // there; and if there is torque, it only carries the weight, and what a fixture pushes until it is taken down.
    for _ in 0..(MAX_HORIZON_US + STALE_DECAY_US) / 1000 {
        let output = run.tick(&SILENCE);
        run.check(&output)?;
    }
    let last = run.tick(&SILENCE);
    run.check(&last)?;
    let opened = Event {
        fixture: Some(Fixture::None),
        ..SILENCE
    };
    for event in std::iter::once(&opened).chain([&SILENCE; 299]) {
        let output = run.tick(event);
        run.check(&output)?;
    }
    let settled = run.tick(&SILENCE);
    let weight = run.weight();
    run.check(&settled)?;
    for ((current_a, weight), joint) in settled.current_a.iter().zip(weight).zip(&run.device.joints)
    {
        let carried = weight * run.carried.part();
        hold!(
            (current_a * joint.effort_per_amp - carried).abs() < 1e-5,
            "{settled:?}"
        );
    }
    Ok(())
}

#[test]
fn anything_in_leaves_the_motors_bounded() {
    holds_over_all("motors", motors_bounded);
}

/// The test's own books of a Cartesian console: what its contact force has taken from the hand, without credit or leak.
struct Books {
    energy_j: f64,
    /// Efforts of the contact at the last two ticks, the newest first.
    efforts: [[f64; 3]; 2],
    counts: Option<[i32; 3]>,
    /// Most work of efforts that change while the grip is anywhere within the console's dead band of 0.6 counts \[J\].
    unseen_j: f64,
    /// Most work of tissue that moves by itself, at 50 mm/s, as far as the console has no other word for it than the host's \[J\].
    drifted_j: f64,
}

impl Books {
    /// Books the tick before `output` was computed, then what that commands.
    fn book(&mut self, run: &Run, output: &TickOutput) {
        let now = run.input.encoder_counts;
        let before = self.counts.replace(now).unwrap_or(now);
        // What moves on after a jump is believed again, while the fault stays.
        let jumped = (0..3).any(|axis| {
            let joint = run.device.joints[axis];
            let most = joint.max_speed_per_s * TICK_S * joint.counts_per_unit + 1.0;
            now[axis].wrapping_sub(before[axis]).unsigned_abs() as f32 > most
        });
        for axis in 0..3 {
            let joint = run.device.joints[axis];
            let way =
                f64::from(now[axis].wrapping_sub(before[axis])) / f64::from(joint.counts_per_unit);
            if !jumped {
                self.energy_j -= self.efforts[1][axis] * way;
            }
        }
        let weight = kinematics::forward(&run.device, &[0.0; 3]).weight_effort;
        let contact = core::array::from_fn(|axis| {
            let motor = output.current_a[axis] * run.device.joints[axis].effort_per_amp;
            let force = f64::from(output.state.force_n[axis]);
            f64::from(motor - weight[axis] * run.carried.part())
                .clamp(force.min(0.0), force.max(0.0))
        });
        let before = self.efforts;
        self.efforts = if output.amplifiers_on {
            [contact, self.efforts[0]]
        } else {
            [[0.0; 3]; 2]
        };
        let force = output.state.force_n;
        let force_n = force
            .iter()
            .fold(0.0, |sum, f| sum + f64::from(*f).powi(2))
            .sqrt();
        self.drifted_j += 0.05 * force_n * f64::from(TICK_S);
        let acting = self.efforts[1].iter().zip(&before[1]);
        for ((now, before), joint) in acting.zip(&run.device.joints) {
            let band_m = 0.6 / f64::from(joint.counts_per_unit);
            self.unseen_j += band_m * (now - before).abs();
        }
    }
}

/// Whatever comes in, the console never holds for paid what was not, and what it gives away is bounded by what it
/// lends after an outage and cannot take back in time: the force until the next command acts and the slew limit has taken it away, along the
/// largest way that these events bring (21 counts a tick on each axis), and what an overdrawn tank still lets
/// through. The hand may be an adversary (first switch): it goes wherever the motors push, or where a broken cable says.
fn energy_bounded([adversary, _]: [bool; 2], events: &[Event]) -> Held {
    let (least_j, bar_j) = robbed(events, adversary, true)?;
    hold!(least_j > -bar_j, "{least_j} of {bar_j}");
    Ok(())
}

#[test]
fn anything_in_leaves_the_energy_bounded() {
    holds_over_all("energy", energy_bounded);
}

/// Least energy in the books over a sequence of events, and the bound on what may be given away \[J\].
fn robbed(events: &[Event], adversary: bool, tank: bool) -> Result<(f64, f64), String> {
    let mut run = Run::new(bench(), tank);
    let mut books = Books {
        energy_j: 0.0,
        efforts: [[0.0; 3]; 2],
        counts: None,
        unseen_j: 0.0,
        drifted_j: 0.0,
    };
    let device = run.device;
    let slew_ticks = device.max_force_n / (device.joints[0].max_slew_per_s * TICK_S);
    let way_m = 21.0 * 3.0_f32.sqrt() / device.joints[0].counts_per_unit;
    let lent_j = 15e-3;
    let bar_j = f64::from(device.max_force_n * way_m * (3.0 + 0.5 * slew_ticks)) + 5e-3 + lent_j;
    let mut least_j = 0.0;
    for event in events {
        let mut event = event.clone();
        if let (Counts::Moved(steps), true) = (&mut event.counts, adversary) {
            for (step, effort) in steps.iter_mut().zip(books.efforts[0]) {
                let size = (i16::from(*step).abs()).min(127) as i8;
                *step = if effort < 0.0 { -size } else { size };
            }
        }
        let output = run.tick(&event);
        run.check(&output)?;
        books.book(&run, &output);
        let held_j = f64::from(run.control.tank_j());
        hold!(
            // Twice: what has changed so far, and the way from the band's edge with the effort that there is.
            held_j <= books.energy_j + books.drifted_j + 2.0 * books.unseen_j + 0.5e-3 + 1e-6,
            "{held_j} {} {}",
            books.energy_j,
            books.unseen_j
        );
        least_j = f64::min(least_j, books.energy_j);
    }
    Ok((least_j, bar_j + books.drifted_j + 2.0 * books.unseen_j))
}

/// The same adversary without the tank takes much more: the bound above is the tank's.
#[test]
fn without_the_tank_the_energy_is_not_bounded() {
    let mut dice = Dice::new(1);
    let mut worst = [0.0_f64; 2];
    let mut bar = 0.0;
    for _ in 0..40 {
        let events = dice.events(EVENTS as usize);
        for (worst, tank) in worst.iter_mut().zip([false, true]) {
            let (least_j, bar_j) = robbed(&events, true, tank).unwrap();
            (*worst, bar) = (worst.min(least_j), bar_j);
        }
    }
    println!(
        "without tank {} J, with it {} J, bound {} J",
        worst[0], worst[1], -bar
    );
    assert!(worst[0] < -2.0 * bar && worst[1] > -bar, "{worst:?} {bar}");
}

/// The strategies above reach what they are for: a test that never arms proves nothing.
#[test]
fn the_events_reach_torque_faults_and_limits() {
    let mut dice = Dice::new(1);
    let (mut modes, mut limited, mut stepped) = ([0_u32; 5], 0, 0);
    for _ in 0..40 {
        let mut run = Run::new(bench(), false);
        for event in dice.events(EVENTS as usize) {
            let output = run.tick(&event);
            run.check(&output).unwrap();
            modes[output.state.mode as usize] += 1;
            let square: f32 = output.state.force_n.iter().map(|f| f * f).sum();
            limited += u32::from(square > 80.0);
            stepped += u32::from(output.current_a.iter().any(|a| (a * 3.75).abs() > 1.9));
        }
    }
    assert!(modes.iter().all(|ticks| *ticks > 30), "{modes:?}");
    assert!(limited > 100 && stepped > 100, "{limited} {stepped}");
}
