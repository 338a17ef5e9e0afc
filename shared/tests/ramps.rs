//! How forces come at arming and go at a fault: the weight over 300 ms, the contact over 50 ms, and what cuts at once.

#![allow(clippy::unwrap_used, reason = "a test")]

use crate::events::Dice;
use crate::rig::{Loop, arm, bench, fixture_frame, frame, hand, wall};
use sutura_shared::control::{Control, TICK_S, TickInput, TickOutput};
use sutura_shared::device::{DeviceDescription, JOINTS};
use sutura_shared::kinematics::{GRAVITY, forward};
use sutura_shared::math::max;
use sutura_shared::simulated_console::SimulatedBoard;
use sutura_shared::wire::faults;
use sutura_shared::wire::message::{Command, Fixture, Mode, Simulate};

/// \[ticks\].
const WEIGHT: u16 = 300;
const CONTACT: u16 = 50;
/// Current of the whole weight of the bench console's z stage \[A\].
const CARRY_A: f32 = 0.25 * GRAVITY / 3.75;

/// Causes that leave the motors alone, and the fault that each is.
type Cause = fn(&mut Loop);
const GENTLE: [(u16, Cause); 2] = [
    (faults::ENCODER_JUMP, |console| {
        console.input.encoder_counts[1] += 165;
    }),
    (faults::ENCODER_JUMP, |console| {
        console.input.orientation = Some([0.0; 4]);
    }),
];
const HARD: [(u16, Cause); 5] = [
    (faults::E_STOP, |console| {
        console.input.emergency_stop = true
    }),
    (faults::BOARD, |console| console.input.board_fault = true),
    (faults::SUPPLY | faults::BOARD, |console| {
        console.input.supply_low = true
    }),
    (faults::AMPLIFIER | faults::BOARD, |console| {
        console.input.amplifiers_unready = true
    }),
    (faults::TIME_BASE, |console| {
        console.input.time_base_fault = true
    }),
];

#[test]
fn the_weight_comes_by_equal_steps() {
    let mut console = Loop::new(bench());
    console.control.command(Command::Arm);
    for tick in 1..=400_u16 {
        let output = console.tick();
        let part = f32::from(tick.min(WEIGHT)) / f32::from(WEIGHT);
        assert!(
            (output.current_a[2] - CARRY_A * part).abs() < 1e-6,
            "{tick}"
        );
    }
}

#[test]
fn a_fault_lets_the_weight_down_and_takes_the_contact_at_once() {
    for (fault, cause) in GENTLE {
        for armed in [1, 100, 300, 700_u16] {
            let mut console = Loop::armed_on_credit(bench());
            console.place(2, -1e-3);
            for _ in 1..armed {
                console.contact(wall(1000.0, [0.0, 0.0, -1e-3]));
            }
            cause(&mut console);
            let full = armed.min(WEIGHT);
            for left in (0..full).rev() {
                let output = console.contact(wall(1000.0, [0.0, 0.0, -1e-3]));
                assert_eq!(
                    (output.state.mode, output.state.faults),
                    (Mode::Fault, fault)
                );
                assert_eq!(output.state.force_n, [0.0; 3]);
                let carried = CARRY_A * f32::from(left) / f32::from(WEIGHT);
                assert!(
                    (output.current_a[2] - carried).abs() < 2e-5,
                    "{armed} {left}: {output:?}"
                );
                assert_eq!(output.amplifiers_on, left > 0);
            }
            let output = console.tick();
            assert!(
                !output.amplifiers_on && output.current_a == [0.0; 3],
                "{armed}"
            );
        }
    }
}

/// At any time of a let-down, too, and together with a cause that lets down.
#[test]
fn what_allows_no_torque_cuts_in_its_tick() {
    for (fault, cause) in HARD {
        for after in [0, 1, 150, 298_u32] {
            let mut console = Loop::armed(bench());
            console.wait(400);
            console.input.encoder_counts[1] += 165;
            if after > 0 {
                assert!(console.wait(after).current_a[2] > 0.0);
            }
            cause(&mut console);
            let output = console.tick();
            // "Ready" is nobody's matter in the tick of another fault that cuts; it is in one that lets down.
            assert_eq!(output.state.faults, fault | faults::ENCODER_JUMP);
            assert!(
                !output.amplifiers_on && output.current_a == [0.0; 3],
                "{fault:#b} {after}"
            );
            assert!(!console.wait(10).amplifiers_on);
        }
    }
}

#[test]
fn nothing_to_let_down_is_off_at_once() {
    let mut weightless = bench();
    weightless.gravity_mass_kg = [0.0; JOINTS];
    let mut console = Loop::armed_on_credit(weightless);
    console.place(2, -1e-3);
    for _ in 0..100 {
        console.contact(wall(1000.0, [0.0, 0.0, -1e-3]));
    }
    console.input.encoder_counts[1] += 165;
    let output = console.tick();
    assert_eq!(output.state.mode, Mode::Fault);
    assert!(!output.amplifiers_on && output.current_a == [0.0; 3]);
}

/// An order ends it; and one that arms meanwhile goes on with what is carried.
#[test]
fn clearing_the_fault_ends_a_let_down_and_arming_in_it_goes_on_from_there() {
    let mut console = Loop::armed(bench());
    console.wait(400);
    for pace in [65, 130, 130, 130, 130, 130, 130, 65] {
        console.input.encoder_counts[1] += pace;
        console.tick();
    }
    let before = console.wait(100);
    assert_eq!(before.state.faults, faults::OVERSPEED);
    let before = before.current_a[2];
    let mut cleared = console.control;
    cleared.command(Command::ClearFault);
    let mut input = console.input;
    input.now_us += 1000;
    let output = cleared.tick(&input, None);
    assert_eq!(
        (output.state.mode, output.amplifiers_on),
        (Mode::Idle, false)
    );
    console.control.command(Command::ClearFault);
    console.control.command(Command::Arm);
    let output = console.tick();
    assert_eq!(output.state.mode, Mode::Armed);
    assert!((output.current_a[2] - before - CARRY_A / f32::from(WEIGHT)).abs() < 1e-6);
}

/// A wall that a console is armed inside of, with the force paid for: as much of the largest force as 50 ms let through.
#[test]
fn no_contact_force_is_above_its_ramp_after_arming() {
    for fixture in [false, true] {
        let mut console = Loop::on_credit(bench());
        for step in 1..=8_u8 {
            console.place(2, -0.5e-3 * f32::from(step));
            console.tick();
        }
        console.control.command(Command::Arm);
        if fixture {
            let wall = Fixture::Wall {
                point_m: [0.0; 3],
                normal: [0.0, 0.0, 1.0],
                stiffness_n_per_m: 4000.0,
                damping_n_s_per_m: 0.0,
            };
            console.control.fix(&fixture_frame(1, wall));
        }
        for tick in 1..=100_u16 {
            let contact = wall(4000.0, [0.0, 0.0, -4e-3]);
            let output = if fixture {
                console.tick()
            } else {
                console.contact(contact)
            };
            let ramp = f32::from(tick.min(CONTACT)) / f32::from(CONTACT);
            let force = output.state.force_n[2];
            assert!(force <= 10.0 * ramp + 1e-5, "{tick}: {force}");
            assert!(tick < CONTACT || force > 9.0, "{tick}: {force}");
        }
    }
}

/// What a test knows of the ramps by counting ticks.
#[derive(Default)]
struct Counted {
    weight: u16,
    contact: u16,
}

/// A console with a hand, tissue and somebody who arms, disarms, faults and clears at any time.
struct Wild {
    control: Control,
    board: SimulatedBoard,
    device: DeviceDescription,
    counted: Counted,
    before: Option<(TickOutput, [f32; JOINTS])>,
    sequence: u32,
    /// Ticks left of a spell in which the first joint's encoder is too fast, and the counts that it is off by.
    hurries: u32,
    off: i32,
    jumped: bool,
}

/// Ticks of such a spell: up to speed, above it for longer than is believed, and down again.
const HURRIES: u32 = 26;

impl Wild {
    fn new(device: DeviceDescription, dice: &mut Dice) -> Self {
        let mut control = Control::new(device).unwrap();
        let mut board = SimulatedBoard::new(&device);
        let mut deep = |from: i32| from as f32 * 1e-3 - 1e-3 * dice.below(12) as f32;
        // The arm's elbow is at an angle, away from where it is straight.
        let start_joint = if device == arm() {
            [0.0, 0.8, -1.4]
        } else {
            [0.0; 3]
        };
        let at = forward(&device, &start_joint).position_m;
        let points = [0.0, 0.4, 0.9, 1.5].map(|s| (s, [at[0], at[1], at[2] + deep(6)]));
        let mut script = hand(400.0, 6.0, &points);
        script.start_joint = start_joint;
        board.simulate(&Simulate::Hand(script), &mut control);
        Wild {
            control,
            board,
            device,
            counted: Counted::default(),
            before: None,
            sequence: 0,
            hurries: 0,
            off: 0,
            jumped: false,
        }
    }

    fn tick(&mut self, dice: &mut Dice) -> TickOutput {
        let mut input = TickInput {
            emergency_stop: dice.chance(0.001),
            amplifiers_unready: dice.chance(0.001),
            ..self.board.read(false)
        };
        if self.hurries == 0 && dice.chance(0.003) {
            self.hurries = HURRIES;
        }
        self.hurries = self.hurries.saturating_sub(1);
        let part = self.hurries.min(HURRIES - self.hurries).min(8) as f32 / 8.0;
        let joint = &self.device.joints[0];
        let pace = joint.max_speed_per_s * TICK_S * joint.counts_per_unit;
        self.off += (0.95 * part * pace) as i32;
        input.encoder_counts[0] += self.off;
        if dice.chance(0.001) {
            input.encoder_counts[0] += 2000;
        }
        // Counts that are lost wait for a restart.
        if self.jumped && dice.chance(0.02) {
            self.control = Control::new(self.device).unwrap();
            (self.before, self.counted) = (None, Counted::default());
        }
        for (command, part) in [
            (Command::ClearFault, 0.06),
            (Command::Arm, 0.06),
            (Command::Disarm, 0.001),
        ] {
            if dice.chance(part) {
                self.control.command(command);
            }
        }
        let at = forward(&self.device, &self.joints(&input)).position_m;
        let fresh = dice.chance(0.1).then(|| {
            self.sequence += 1;
            let stiffness = 200.0 + dice.below(3000) as f32;
            frame(self.sequence, input.now_us, wall(stiffness, at.into()))
        });
        let output = self.control.tick(&input, fresh.map(Into::into).as_ref());
        self.board.write(&output);
        self.jumped = output.state.faults & faults::ENCODER_JUMP != 0;
        self.check(&input, &output);
        output
    }

    fn joints(&self, input: &TickInput) -> [f32; JOINTS] {
        core::array::from_fn(|i| {
            input.encoder_counts[i] as f32 / self.device.joints[i].counts_per_unit
        })
    }

    /// No force above what its ramp allows, and no step of the weight above that of its ramp, by the test's own count.
    fn check(&mut self, input: &TickInput, output: &TickOutput) {
        let state = &output.state;
        let torque = matches!(state.mode, Mode::Armed | Mode::Decaying);
        let had = self
            .before
            .is_some_and(|(before, _)| matches!(before.state.mode, Mode::Armed | Mode::Decaying));
        self.counted = match (torque, output.amplifiers_on) {
            (_, false) => Counted::default(),
            (false, true) => Counted {
                weight: self.counted.weight.saturating_sub(1),
                contact: 0,
            },
            (true, true) => Counted {
                weight: (self.counted.weight + 1).min(WEIGHT),
                contact: if had {
                    (self.counted.contact + 1).min(CONTACT)
                } else {
                    1
                },
            },
        };
        let [weight, contact] = [
            f32::from(self.counted.weight) / f32::from(WEIGHT),
            f32::from(self.counted.contact) / f32::from(CONTACT),
        ];
        let force = state.force_n.iter().map(|f| f * f).sum::<f32>().sqrt();
        assert!(
            force <= self.device.max_force_n * contact * 1.0001 + 1e-6,
            "{contact} {state:?}"
        );
        let pose = forward(&self.device, &self.joints(input));
        let efforts = pose.effort(&state.force_n.into());
        let carried: [f32; JOINTS] = core::array::from_fn(|i| {
            output.current_a[i] * self.device.joints[i].effort_per_amp - efforts[i]
        });
        if let (Some((before, carried_before)), true) = (&self.before, output.amplifiers_on) {
            for i in 0..JOINTS {
                // Of the whole weight in this pose: a step of the ramp, what the pose has changed, and rounding. What the slew
                // limit has kept back of a contact counts as weight here.
                let most = self.device.gravity_mass_kg.iter().sum::<f32>() * GRAVITY;
                let slewed = before
                    .state
                    .force_n
                    .iter()
                    .chain(&state.force_n)
                    .map(|f| f.abs())
                    .sum::<f32>();
                let step = (carried[i] - carried_before[i]).abs();
                let jumped = state.faults & faults::ENCODER_JUMP != 0 && !torque;
                let allowed = most / f32::from(WEIGHT) * 1.2
                    + 1e-4
                    // An encoder that lies in a pose that changes fast.
                    + if self.hurries > 0 { 1e-2 * slewed } else { 0.0 }
                    + if jumped { 0.0 } else { 1e-3 * slewed };
                assert!(
                    step <= allowed,
                    "joint {i}: {step} of {allowed}, {weight} {state:?}"
                );
            }
        }
        self.before = Some((*output, carried));
    }
}

#[test]
fn no_step_above_the_ramps_whenever_somebody_arms_or_something_fails() {
    let (mut let_down, mut cut, mut again, mut full) = (0, 0, 0, 0);
    for case in 0..60_u64 {
        let mut dice = Dice::new(case + 1);
        let device = if case % 2 == 0 { bench() } else { arm() };
        let mut wild = Wild::new(device, &mut dice);
        let mut before = (Mode::Boot, false);
        for _ in 0..3000 {
            let output = wild.tick(&mut dice);
            let now = (output.state.mode, output.amplifiers_on);
            let_down += u32::from(now == (Mode::Fault, true));
            cut += u32::from(before == (Mode::Fault, true) && now == (Mode::Fault, false));
            again += u32::from(before == (Mode::Fault, true) && now.0 == Mode::Armed);
            full += u32::from(wild.counted.weight == WEIGHT);
            before = now;
        }
    }
    let reached = [let_down, cut, again, full];
    assert!(reached.iter().all(|times| *times > 10), "{reached:?}");
}

/// Largest speed of the grip \[m/s\], and change of its place \[m\], from `begin` on, of a stage that a soft hand holds.
fn sinks(begin: impl Fn(&mut Control, &mut TickInput)) -> (f32, f32) {
    let mut control = Control::new(bench()).unwrap();
    let mut board = SimulatedBoard::new(&bench());
    let script = hand(300.0, 3.0, &[(0.0, [0.0; 3])]);
    board.simulate(&Simulate::Hand(script), &mut control);
    control.command(Command::Arm);
    for _ in 0..1500 {
        let output = control.tick(&board.read(false), None);
        board.write(&output);
    }
    let from = board.device().position()[2];
    let mut most = 0.0_f32;
    for tick in 0..1500 {
        let mut input = board.read(false);
        if tick == 0 {
            begin(&mut control, &mut input);
        }
        let output = control.tick(&input, None);
        board.write(&output);
        most = max(most, board.device().joints().1[2].abs());
    }
    (most, from - board.device().position()[2])
}

/// A hand of 300 N/m under 2.45 N: let down, the stage follows the ramp; let go of, it falls.
#[test]
fn an_arm_that_is_let_down_does_not_fall_on_the_hand() {
    let (down, sunk) = sinks(|_, input| input.encoder_counts[0] += 2000);
    let (fallen, dropped) = sinks(|_, input| input.emergency_stop = true);
    let (disarmed, _) = sinks(|control, _| control.command(Command::Disarm));
    // As far either way: the weight, less friction, over the hand's stiffness.
    let far = (0.25 * GRAVITY - 0.15) / 300.0;
    for way in [sunk, dropped] {
        assert!((way - far).abs() < 1e-3, "{way} of {far}");
    }
    // Twice the speed of the ramp, where the fall has six times.
    let ramp = far / (f32::from(WEIGHT) * TICK_S);
    assert!(down < 2.0 * ramp, "{down} of {ramp}");
    assert!(
        fallen > 5.0 * ramp && disarmed > 5.0 * ramp,
        "{fallen} {disarmed} of {ramp}"
    );
}
