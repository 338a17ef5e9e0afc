//! Bounded by construction: whatever the encoders and the host send, the motors get little, and slowly.

#![allow(clippy::unwrap_used, reason = "a test")]

use crate::rig::{arm, bench, frame};
use proptest::prelude::*;
use sutura_shared::control::{
    Control, Guards, MAX_HORIZON_US, STALE_DECAY_US, TICK_S, TickInput, TickOutput, Tuning,
};
use sutura_shared::device::DeviceDescription;
use sutura_shared::kinematics;
use sutura_shared::wire::message::{Command, Contact, Mode};
use sutura_shared::wire::{Message, faults};

/// Rounding of a handful of operations in single precision.
const ROUNDING: f32 = 1e-5;

/// What happens before one tick.
#[derive(Clone, Debug)]
struct Event {
    counts: Counts,
    contact: Option<(u64, Contact)>,
    command: Option<Command>,
    /// Emergency stop, board fault, overrun.
    flags: [bool; 3],
}

#[derive(Clone, Debug)]
enum Counts {
    /// As a hand would move them.
    Moved([i8; 3]),
    /// As a broken cable would.
    Anything([i32; 3]),
}

/// Up to `limit` in magnitude: any size, zeros of both signs and subnormals often.
fn number(limit: f32) -> impl Strategy<Value = f32> {
    let any = prop::num::f32::POSITIVE
        | prop::num::f32::NEGATIVE
        | prop::num::f32::SUBNORMAL
        | prop::num::f32::ZERO;
    let shrunk = any.prop_map(move |x| {
        if x.abs() > limit {
            limit.copysign(x)
        } else {
            x
        }
    });
    prop_oneof![-limit..=limit, shrunk]
}

fn unit() -> impl Strategy<Value = [f32; 3]> {
    let direction = prop::array::uniform3(-1.0_f64..1.0);
    let long = direction.prop_filter("too short", |v| v.iter().map(|x| x * x).sum::<f64>() > 0.01);
    long.prop_map(|v| {
        let length = v.iter().map(|x| x * x).sum::<f64>().sqrt();
        v.map(|x| (x / length) as f32)
    })
}

fn contact() -> impl Strategy<Value = Contact> {
    let place = prop_oneof![
        prop::array::uniform3(-0.1_f32..0.1),
        prop::array::uniform3(number(10.0))
    ];
    let wrench = prop::array::uniform6(prop_oneof![number(20.0), number(1e4)]);
    let tangent = prop::collection::vec(prop_oneof![number(5000.0), number(1e7)], 21);
    let gap = prop_oneof![
        Just(0.0),
        Just(-0.0),
        0.0_f32..0.01,
        number(10.0).prop_map(f32::abs)
    ];
    let horizon = prop_oneof![0..200_000_u32, any::<u32>()];
    (
        0..2_u8,
        place,
        wrench,
        tangent,
        gap,
        unit(),
        number(1000.0),
        horizon,
    )
        .prop_map(
            |(tool, position_m, wrench, tangent, gap_m, normal, relaxation, horizon_us)| Contact {
                tool,
                position_m,
                orientation: [0.0, 0.0, 0.0, 1.0],
                wrench,
                tangent: tangent.try_into().unwrap(),
                gap_m,
                normal,
                relaxation_per_s: relaxation.abs(),
                horizon_us,
            },
        )
}

fn event() -> impl Strategy<Value = Event> {
    let counts = prop_oneof![
        200 => any::<[i8; 3]>().prop_map(Counts::Moved),
        1 => any::<[i32; 3]>().prop_map(Counts::Anything),
    ];
    let age = prop_oneof![0..20_000_u64, 0..400_000_u64, any::<u64>()];
    let command = prop_oneof![
        5 => Just(Command::Arm),
        1 => Just(Command::Disarm),
        5 => Just(Command::ClearFault),
    ];
    let rarely = || prop::bool::weighted(0.005);
    (
        counts,
        prop::option::weighted(0.2, (age, contact())),
        prop::option::weighted(0.3, command),
        (rarely(), rarely(), prop::bool::weighted(0.1)),
    )
        .prop_map(|(counts, contact, command, (stop, board, overrun))| Event {
            counts,
            contact,
            command,
            flags: [stop, board, overrun],
        })
}

/// A control loop, and what has been asked of it.
struct Run {
    device: DeviceDescription,
    control: Control,
    input: TickInput,
    sequence: u32,
    before: Option<TickOutput>,
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

    /// What must hold after every tick.
    fn check(&mut self, output: &TickOutput) {
        let state = &output.state;
        // The host accepts it: finite, in range.
        assert_eq!(state.check(), Ok(()), "{state:?}");
        let square: f64 = state.force_n.iter().map(|f| f64::from(*f).powi(2)).sum();
        let limit = self.device.max_force_n * (1.0 + ROUNDING);
        assert!(square <= f64::from(limit).powi(2), "{state:?}");

        let before = self.before.map_or([0.0; 3], |before| before.current_a);
        for ((now, before), joint) in output.current_a.iter().zip(before).zip(&self.device.joints) {
            assert!(now.abs() <= joint.max_current_a, "{state:?}");
            let step_effort = (now - before) * joint.effort_per_amp;
            let limit = joint.max_slew_per_s * TICK_S * (1.0 + ROUNDING) + ROUNDING;
            let off = !output.amplifiers_on && *now == 0.0;
            assert!(
                off || step_effort.abs() <= limit,
                "{before} {now} {state:?}"
            );
        }

        let torque = matches!(state.mode, Mode::Armed | Mode::Decaying);
        assert_eq!(output.amplifiers_on, torque);
        assert_eq!(state.faults != 0, state.mode == Mode::Fault);
        assert!(torque || (output.current_a == [0.0; 3] && state.force_n == [0.0; 3]));
        let longest_us = MAX_HORIZON_US + STALE_DECAY_US;
        assert!(
            state.contact_age_us < longest_us || state.force_n.map(f32::to_bits) == [0; 3],
            "{state:?}"
        );
        assert_eq!(state.current_a, output.current_a);
        self.before = Some(*output);
    }
}

/// Stands still and hears nothing.
const SILENCE: Event = Event {
    counts: Counts::Moved([0; 3]),
    contact: None,
    command: None,
    flags: [false; 3],
};

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn anything_in_leaves_the_motors_bounded(
        events in prop::collection::vec(event(), 1..400),
        jointed in any::<bool>(),
        tank in any::<bool>(),
    ) {
        let mut run = Run::new(if jointed { arm() } else { bench() }, tank);
        for event in &events {
            let output = run.tick(event);
            run.check(&output);
        }
        // Silence: within the longest horizon and 30 ms there is no contact force left, whatever was
        // there; and if there is torque, it only carries the weight.
        for _ in 0..(MAX_HORIZON_US + STALE_DECAY_US) / 1000 {
            let output = run.tick(&SILENCE);
            run.check(&output);
        }
        let last = run.tick(&SILENCE);
        prop_assert_eq!(last.state.force_n.map(f32::to_bits), [0; 3]);
        for _ in 0..60 {
            let output = run.tick(&SILENCE);
            run.check(&output);
        }
        let settled = run.tick(&SILENCE);
        let weight = {
            let q: [f32; 3] = core::array::from_fn(|i| {
                run.input.encoder_counts[i] as f32 * (1.0 / run.device.joints[i].counts_per_unit)
            });
            kinematics::forward(&run.device, &q).weight_effort
        };
        for ((current_a, weight), joint) in settled.current_a.iter().zip(weight).zip(&run.device.joints) {
            let carried = if settled.amplifiers_on { weight } else { 0.0 };
            prop_assert!((current_a * joint.effort_per_amp - carried).abs() < 1e-5);
        }
    }
}

/// The test's own books of a Cartesian console: what its contact force has taken from the hand, without credit or leak.
struct Books {
    energy_j: f64,
    /// Efforts of the contact at the last two ticks, the newest first.
    efforts: [[f64; 3]; 2],
    counts: Option<[i32; 3]>,
}

impl Books {
    /// Books the tick before `output` was computed, then what that commands.
    fn book(&mut self, run: &Run, output: &TickOutput) {
        let now = run.input.encoder_counts;
        let before = self.counts.replace(now).unwrap_or(now);
        let jumped = output.state.faults & faults::ENCODER_JUMP != 0;
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
            f64::from(motor - weight[axis]).clamp(force.min(0.0), force.max(0.0))
        });
        self.efforts = if output.amplifiers_on {
            [contact, self.efforts[0]]
        } else {
            [[0.0; 3]; 2]
        };
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    /// Whatever comes in, the console never holds for paid what was not, and what it gives away is bounded by what it
    /// cannot take back in time: the force until the next command acts and the slew limit has taken it away, along the
    /// largest way that these events bring (21 counts a tick on each axis), and what an overdrawn tank still lets
    /// through. The hand is an adversary: it goes wherever the motors push, or where a broken cable says.
    #[test]
    fn anything_in_leaves_the_energy_bounded(
        events in prop::collection::vec(event(), 1..400),
        adversary in any::<bool>(),
    ) {
        let (least_j, bar_j) = robbed(&events, adversary, true)?;
        prop_assert!(least_j > -bar_j, "{least_j} of {bar_j}");
    }
}

/// Least energy in the books over a sequence of events, and the bound on what may be given away \[J\].
fn robbed(events: &[Event], adversary: bool, tank: bool) -> Result<(f64, f64), TestCaseError> {
    let mut run = Run::new(bench(), tank);
    let mut books = Books {
        energy_j: 0.0,
        efforts: [[0.0; 3]; 2],
        counts: None,
    };
    let device = run.device;
    let slew_ticks = device.max_force_n / (device.joints[0].max_slew_per_s * TICK_S);
    let way_m = 21.0 * 3.0_f32.sqrt() / device.joints[0].counts_per_unit;
    let bar_j = f64::from(device.max_force_n * way_m * (3.0 + 0.5 * slew_ticks)) + 5e-3;
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
        run.check(&output);
        books.book(&run, &output);
        let held_j = f64::from(run.control.tank_j());
        prop_assert!(
            held_j <= books.energy_j + 0.2e-3 + 1e-6,
            "{held_j} {}",
            books.energy_j
        );
        least_j = f64::min(least_j, books.energy_j);
    }
    Ok((least_j, bar_j))
}

/// The same adversary without the tank takes much more: the bound above is the tank's.
#[test]
fn without_the_tank_the_energy_is_not_bounded() {
    use proptest::strategy::ValueTree;
    use proptest::test_runner::TestRunner;
    let mut runner = TestRunner::deterministic();
    let events = prop::collection::vec(event(), 400);
    let mut worst = [0.0_f64; 2];
    let mut bar = 0.0;
    for _ in 0..40 {
        let events = events.new_tree(&mut runner).unwrap().current();
        for (worst, tank) in worst.iter_mut().zip([false, true]) {
            let (least_j, bar_j) = robbed(&events, true, tank).unwrap();
            (*worst, bar) = (worst.min(least_j), bar_j);
        }
    }
    println!(
        "without tank {} J, with it {} J, bound {} J",
        worst[0], worst[1], -bar
    );
    assert!(worst[0] < -3.0 * bar && worst[1] > -bar, "{worst:?} {bar}");
}

/// The strategies above reach what they are for: a test that never arms proves nothing.
#[test]
fn the_events_reach_torque_faults_and_limits() {
    use proptest::strategy::ValueTree;
    use proptest::test_runner::TestRunner;
    let mut runner = TestRunner::deterministic();
    let events = prop::collection::vec(event(), 400);
    let (mut modes, mut limited, mut stepped) = ([0_u32; 5], 0, 0);
    for _ in 0..40 {
        let mut run = Run::new(bench(), false);
        for event in events.new_tree(&mut runner).unwrap().current() {
            let output = run.tick(&event);
            run.check(&output);
            modes[output.state.mode as usize] += 1;
            let square: f32 = output.state.force_n.iter().map(|f| f * f).sum();
            limited += u32::from(square > 80.0);
            stepped += u32::from(output.current_a.iter().any(|a| (a * 3.75).abs() > 1.9));
        }
    }
    assert!(modes.iter().all(|ticks| *ticks > 30), "{modes:?}");
    assert!(limited > 100 && stepped > 100, "{limited} {stepped}");
}
