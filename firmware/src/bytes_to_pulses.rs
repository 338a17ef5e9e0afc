//! Limits hold under any command: from the bytes that a host sends to the pulses that the amplifiers of [`CONSOLE`] get.
//!
//! Frames of all kinds with numbers of all sizes, noise, encoders that jump, a ready line and a stop that come and go.

use crate::devices::CONSOLE;
use crate::drivers::amplifier::Amplifiers;
use crate::signals::PulseTimer;
use core::cell::Cell;
use core::convert::Infallible;
use embedded_hal::digital::{self, InputPin, OutputPin};
use embedded_hal::pwm::{self, SetDutyCycle};
use std::vec::Vec;
use sutura_shared::console_endpoint::{ConsoleEndpoint, Costs, Delivery, Sample};
use sutura_shared::control::{Control, Fresh, TICK_HZ, TickInput};
use sutura_shared::device::JOINTS;
use sutura_shared::link::{ConsoleLink, HostLink, Identity};
use sutura_shared::wire::message::{Command, Contact, Fixture, Report};
use sutura_shared::wire::{MAX_FRAME, Message};

/// Cases, and ticks of one with a host; then it is silent for so many.
const CASES: u32 = 80;
const TICKS: u64 = 700;
const SILENT: u64 = 1100;
const TIMER: PulseTimer = match PulseTimer::new(168_000_000, CONSOLE.set_point.frequency_hz) {
    Ok(timer) => timer,
    Err(_) => panic!("no timer"),
};

struct Pulses<'a>(&'a Cell<u16>);
struct Line<'a>(&'a Cell<bool>);

impl pwm::ErrorType for Pulses<'_> {
    type Error = Infallible;
}

impl SetDutyCycle for Pulses<'_> {
    fn max_duty_cycle(&self) -> u16 {
        TIMER.period
    }

    fn set_duty_cycle(&mut self, duty: u16) -> Result<(), Infallible> {
        self.0.set(duty);
        Ok(())
    }
}

impl digital::ErrorType for Line<'_> {
    type Error = Infallible;
}

impl OutputPin for Line<'_> {
    fn set_low(&mut self) -> Result<(), Infallible> {
        self.0.set(false);
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        self.0.set(true);
        Ok(())
    }
}

impl InputPin for Line<'_> {
    fn is_high(&mut self) -> Result<bool, Infallible> {
        Ok(self.0.get())
    }

    fn is_low(&mut self) -> Result<bool, Infallible> {
        Ok(!self.0.get())
    }
}

/// Numbers from a seed (Knuth's linear congruential generator).
struct Dice(u32);

impl Dice {
    /// 0 to 1, without it.
    fn part(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (self.0 >> 8) as f32 / (1 << 24) as f32
    }

    fn chance(&mut self, part: f32) -> bool {
        self.part() < part
    }

    /// As often of this size as of that of a force that nobody means.
    fn number(&mut self, some: f32, many: f32) -> f32 {
        let most = if self.chance(0.5) { some } else { many };
        most * (2.0 * self.part() - 1.0)
    }

    fn unit(&mut self) -> [f32; 3] {
        let mut normal = [0.0; 3];
        normal[(3.0 * self.part()) as usize] = if self.chance(0.5) { 1.0 } else { -1.0 };
        normal
    }

    fn contact(&mut self, position_m: [f32; 3]) -> Contact {
        Contact {
            tool: 0,
            position_m,
            orientation: [0.0, 0.0, 0.0, 1.0],
            wrench: core::array::from_fn(|_| self.number(10.0, 1e4)),
            tangent: core::array::from_fn(|_| self.number(3e3, 1e7)),
            gap_m: self.number(1e-3, 1e-2).max(0.0),
            normal: self.unit(),
            relaxation_per_s: 0.0,
            horizon_us: (self.part() * 4e5) as u32,
        }
    }

    fn fixture(&mut self) -> Fixture {
        match (3.0 * self.part()) as u32 {
            0 => Fixture::None,
            1 => Fixture::Wall {
                point_m: [self.number(1e-3, 1e-2); 3],
                normal: self.unit(),
                stiffness_n_per_m: self.number(2e3, 1e7).abs(),
                damping_n_s_per_m: self.number(10.0, 100.0).abs(),
            },
            _ => Fixture::Coupling {
                anchor_m: [self.number(1e-3, 1e-2); 3],
                stiffness_n_per_m: self.number(2e3, 1e7).abs(),
                damping_n_s_per_m: self.number(10.0, 100.0).abs(),
            },
        }
    }
}

/// A host that sends anything, in a session.
struct Host {
    link: HostLink,
    dice: Dice,
    position_m: [f32; 3],
    now_us: u64,
    /// Whether it puts up walls and couplings.
    fixtures: bool,
}

impl Host {
    fn frame(&mut self, message: &impl Message) -> Vec<u8> {
        let mut frame = [0; MAX_FRAME];
        let length = self.link.send(self.now_us, message, &mut frame);
        length.map_or(Vec::new(), |length| frame[..length].to_vec())
    }

    fn bytes(&mut self) -> Vec<u8> {
        let mut down = match (100.0 * self.dice.part()) as u32 {
            0..=19 => {
                let contact = self.dice.contact(self.position_m);
                self.frame(&contact)
            }
            20..=22 if self.fixtures => {
                let fixture = self.dice.fixture();
                self.frame(&fixture)
            }
            23 => self.frame(&Command::Disarm),
            24..=30 => self.frame(&Command::ClearFault),
            31..=45 => self.frame(&Command::Arm),
            46..=50 => (0..100).map(|_| (256.0 * self.dice.part()) as u8).collect(),
            _ => Vec::new(),
        };
        if self.dice.chance(0.02)
            && let Some(byte) = down.last_mut()
        {
            *byte ^= 4;
        }
        down
    }
}

/// What a case came to: the largest force \[N\], and the largest change of a current in a tick \[A\], as the pulses say.
fn run(seed: u32) -> (f32, f32) {
    let set_point = CONSOLE.set_point;
    let middle = set_point.none(TIMER.period);
    let duty = [const { Cell::new(0) }; JOINTS];
    let (outputs, enable, ready) = (Cell::new(true), Cell::new(true), Cell::new(false));
    let mut amplifiers = Amplifiers::new(
        [0, 1, 2].map(|motor: usize| Pulses(&duty[motor])),
        Line(&outputs),
        Line(&enable),
        Line(&ready),
        set_point,
    );
    amplifiers.drive(None).expect("lines that obey");
    let identity = Identity {
        tick_hz: TICK_HZ,
        simulated: false,
        device_name: CONSOLE.device.name,
    };
    let mut endpoint = ConsoleEndpoint::new(ConsoleLink::new(identity, seed), Report::default());
    let mut control = Control::new(CONSOLE.device).expect("a valid device");
    let mut host = Host {
        link: HostLink::new(TICK_HZ),
        dice: Dice(seed),
        position_m: [0.0; 3],
        now_us: 0,
        fixtures: seed.is_multiple_of(2),
    };
    let mut hello = [0; MAX_FRAME];
    let length = host.link.hello(seed, &mut hello).expect("a hello fits");
    let mut down = hello[..length].to_vec();
    let mut encoder_counts = [0_i32; JOINTS];
    let mut before_a = [0.0; JOINTS];
    let mut fresh: Option<Fresh> = None;
    let (mut most_n, mut most_step_a) = (0.0_f32, 0.0_f32);
    for tick in 1..=TICKS + SILENT {
        let is_alone = tick > TICKS;
        let now_us = 1000 * tick;
        let expired = endpoint.expire(now_us);
        let mut rest = &down[..];
        let came = core::iter::from_fn(|| endpoint.receive(&mut rest, now_us));
        for delivery in expired.into_iter().chain(came.collect::<Vec<_>>()) {
            match delivery {
                Delivery::Contact(contact) => fresh = Some(endpoint.fresh(contact)),
                Delivery::Order(order) => order.obey(&mut control, |_, _| {}),
            }
        }
        let dice = &mut host.dice;
        if !is_alone {
            ready.set(dice.chance(0.9999));
            // A change of pace of at most 190 counts: more is no motion.
            for counts in &mut encoder_counts {
                *counts = counts.wrapping_add(dice.number(20.0, 95.0) as i32);
            }
            if dice.chance(1e-4) {
                encoder_counts = [0; 3].map(|_: i32| dice.number(1e3, 2e9) as i32);
            }
        }
        let input = TickInput {
            now_us,
            encoder_counts,
            emergency_stop: !is_alone && dice.chance(1e-4),
            amplifiers_unready: !amplifiers.take_currents(),
            ..TickInput::default()
        };
        let output = control.tick(&input, fresh.take().as_ref());
        let current_a = output.amplifiers_on.then_some(&output.current_a);
        amplifiers.drive(current_a).expect("lines that obey");

        let counts = duty.each_ref().map(Cell::get);
        for counts in counts {
            let part = f32::from(counts) / f32::from(TIMER.period);
            let span = set_point.backwards - 1e-6..=set_point.forwards + 1e-6;
            assert!(span.contains(&part), "{seed}, {tick}: {counts}");
        }
        assert!(enable.get() || counts == [middle; JOINTS], "{seed}, {tick}");
        let half = 0.5 * (set_point.forwards - set_point.backwards) * f32::from(TIMER.period);
        let count_a = set_point.full_scale_a / half;
        let read_a = counts.map(|count| (f32::from(count) - f32::from(middle)) * count_a);
        let joints = CONSOLE.device.joints.iter().zip(read_a).zip(before_a);
        let mut square = 0.0;
        for ((joint, read_a), before_a) in joints {
            assert!(read_a.abs() <= joint.max_current_a + count_a);
            let step_a = (read_a - before_a).abs();
            let most_a = 1e-3 * joint.max_slew_per_s / joint.effort_per_amp + 2.0 * count_a;
            assert!(
                step_a <= most_a || read_a == 0.0,
                "{seed}, {tick}: {step_a} A in a tick"
            );
            if read_a != 0.0 {
                most_step_a = most_step_a.max(step_a);
            }
            square += (read_a * joint.effort_per_amp).powi(2);
        }
        // Axes at right angles: the grip's force is what they give together.
        let force_n = square.sqrt();
        let limit_n = CONSOLE.device.max_force_n;
        assert!(force_n <= limit_n * 1.001, "{seed}, {tick}: {force_n} N");
        most_n = most_n.max(force_n);
        before_a = read_a;
        // A contact's horizon, at most 150 ms, and 30 of decay; a fixture has no age, and a session ends after a second.
        let silent = tick.saturating_sub(TICKS);
        if silent > if host.fixtures { 1001 } else { 181 } {
            assert_eq!(counts, [middle; JOINTS], "{seed}: {silent} ms");
        }
        assert!(!enable.get() || silent <= 1001, "{seed}: {silent} ms");

        let sample = Sample {
            now_us,
            state: output.state,
            costs: Costs::default(),
        };
        let mut up = Vec::new();
        endpoint.send(&sample, now_us, |bytes| up.extend_from_slice(bytes));
        for byte in up {
            host.link.receive(byte);
        }
        (host.position_m, host.now_us) = (output.state.position_m, now_us);
        down = if is_alone { Vec::new() } else { host.bytes() };
    }
    (most_n, most_step_a)
}

#[test]
fn whatever_bytes_come_down_pulses_stay_within_the_consoles_limits() {
    let cases = (0..CASES).map(run);
    let [mut force, mut slew] = [0; 2];
    for (most_n, most_step_a) in cases {
        force += u32::from(most_n > 7.99);
        slew += u32::from(most_step_a > 0.999);
    }
    // They do come to both limits.
    assert!(force > CASES / 3 && slew > CASES / 3, "{force}, {slew}");
}
