//! A simulated console on the bench: bytes in, ticks, and what must hold after every one of them.
//!
//! Entry point: [`Bench`]; [`stream`] is the target as fuzzers call it.

use sutura_shared::control::{MAX_HORIZON_US, STALE_DECAY_US, TICK_S, TickOutput, Tuning};
use sutura_shared::device::{DeviceDescription, Joint, Kinematics};
use sutura_shared::link::{Checks, Counters, HostEvent, HostLink};
use sutura_shared::simulated_console::{Pace, SimulatedConsole};
use sutura_shared::wire::message::{Fixture, Mode, State};
use sutura_shared::wire::{MAX_FRAME, Message, faults};

/// Rounding of a handful of operations in single precision, and of a current that is near its limit.
const ROUNDING: f32 = 1e-5;
const OF_CURRENT: f32 = 1e-6;
/// Faults after which the weight may be let down.
const LETS_DOWN: u16 = faults::ENCODER_JUMP | faults::OUT_OF_REACH | faults::OVERSPEED;

/// A console, a host that opens its sessions, and what they did last.
pub struct Bench {
    console: SimulatedConsole,
    seed: u32,
    tuning: Tuning,
    host: HostLink,
    before: Option<TickOutput>,
    /// Ticks since a fixture was rendered last.
    without_fixture: u32,
    up: Vec<u8>,
    /// Session that the console has given last; 0 before the first.
    pub session: u32,
    /// What the console's ticks told last.
    pub state: Option<State>,
    /// Ticks run, and those of them under torque.
    pub ticks: [u64; 2],
    /// Ticks in each mode.
    pub modes: [u64; 5],
}

/// The bench console of the examples, in its own words.
fn device() -> DeviceDescription {
    let joint = |inertia, damping, coulomb| Joint {
        counts_per_unit: 81487.0,
        zero_counts: 0,
        effort_per_amp: 3.75,
        max_current_a: 4.0,
        max_slew_per_s: 2000.0,
        max_speed_per_s: 2.0,
        inertia,
        damping,
        coulomb,
    };
    DeviceDescription {
        name: *b"bench\0\0\0\0\0\0\0\0\0\0\0",
        kinematics: Kinematics::Cartesian { origin_m: [0.0; 3] },
        joints: [
            joint(0.45, 1.5, 0.25),
            joint(0.35, 1.2, 0.2),
            joint(0.25, 1.0, 0.15),
        ],
        gravity_mass_kg: [0.0, 0.0, 0.25],
        max_force_n: 10.0,
        max_power_w: 10.0,
        max_grip_speed_m_per_s: 1.5,
        actuation_delay_us: 1000,
    }
}

fn at_boot(seed: u32, tuning: Tuning) -> SimulatedConsole {
    SimulatedConsole::tuned(&device(), seed, tuning, Checks::ALL)
        .unwrap_or_else(|error| panic!("the built-in device: {error}"))
}

impl Bench {
    /// A console at boot.
    ///
    /// # Panics
    /// If the built-in device is unusable.
    pub fn new(seed: u32, tuning: Tuning) -> Bench {
        Bench {
            console: at_boot(seed, tuning),
            seed,
            tuning,
            host: HostLink::new(1000),
            before: None,
            without_fixture: 0,
            up: Vec::new(),
            session: 0,
            state: None,
            ticks: [0; 2],
            modes: [0; 5],
        }
    }

    /// Switches the console off and on again.
    pub fn restart(&mut self) {
        self.seed = self.seed.wrapping_add(1);
        self.console = at_boot(self.seed, self.tuning);
        (self.host, self.session) = (HostLink::new(1000), 0);
        (self.before, self.without_fixture, self.state) = (None, 0, None);
    }

    /// Counters of the console since it was switched on.
    pub fn counters(&self) -> Counters {
        self.console.counters()
    }

    /// Console time now \[us\].
    pub fn now_us(&self) -> u64 {
        self.console.board().now_us()
    }

    /// Gives the console bytes.
    pub fn feed(&mut self, bytes: &[u8]) {
        self.console.feed(bytes);
    }

    /// Asks for a session until the console gives one, as a host does.
    ///
    /// # Panics
    /// If it gives none, although nothing else is on the line.
    pub fn shake_hands(&mut self, nonce: u32) {
        for _ in 0..4 {
            let mut frame = [0; MAX_FRAME];
            let len = self.host.hello(nonce, &mut frame).unwrap_or_default();
            let before = self.session;
            self.feed(&[0]);
            self.feed(frame.get(..len).unwrap_or_default());
            // A session that is in use is out of reach for 300 ms.
            for _ in 0..400 {
                self.tick();
                if self.session != before {
                    return;
                }
            }
        }
        panic!("the console gives no session after a delimiter and a good Hello");
    }

    /// Runs one tick and checks what it puts out.
    ///
    /// # Panics
    /// If a bound does not hold.
    pub fn tick(&mut self) {
        let output = self.console.tick(Pace::default());
        self.without_fixture = match self.console.control().fixture() {
            Fixture::None => self.without_fixture.saturating_add(1),
            _ => 0,
        };
        self.check(&output);
        self.up.clear();
        self.console.drain(&mut self.up);
        for byte in &self.up {
            match self.host.receive(*byte) {
                Some(HostEvent::Opened(hello)) => self.session = hello.session,
                Some(HostEvent::State(state)) => self.state = Some(*state.body()),
                _ => {}
            }
        }
        let [ticks, under_torque] = &mut self.ticks;
        *ticks += 1;
        *under_torque += u64::from(output.amplifiers_on);
        if let Some(count) = self.modes.get_mut(output.state.mode as usize) {
            *count += 1;
        }
        self.before = Some(output);
    }

    /// Bounds that hold whatever came in.
    fn check(&self, output: &TickOutput) {
        let state = &output.state;
        // The device may have been changed by an order, with the amplifiers off.
        let device = self.console.board().device().description();
        assert_eq!(state.check(), Ok(()), "the host would refuse {state:?}");
        let square: f64 = state.force_n.iter().map(|f| f64::from(*f).powi(2)).sum();
        let limit = f64::from(device.max_force_n * (1.0 + ROUNDING));
        assert!(square <= limit * limit, "force beyond {limit} N: {state:?}");

        let before = self.before.map_or([0.0; 3], |before| before.current_a);
        for ((now, before), joint) in output.current_a.iter().zip(before).zip(&device.joints) {
            assert!(
                now.abs() <= joint.max_current_a,
                "current: {state:?} {joint:?}"
            );
            let [now_effort, before_effort] = [*now, before].map(|a| a * joint.effort_per_amp);
            let rounding = ROUNDING + OF_CURRENT * (now_effort.abs() + before_effort.abs());
            let limit = joint.max_slew_per_s * TICK_S * (1.0 + ROUNDING) + rounding;
            // A fault takes the contact away at once; what is let down is bounded below.
            let off = state.mode == Mode::Fault || !output.amplifiers_on && *now == 0.0;
            let step = (now_effort - before_effort).abs();
            assert!(
                off || step <= limit,
                "slew {step} of {limit}: {before} A, {state:?} {joint:?}"
            );
        }

        let torque = matches!(state.mode, Mode::Armed | Mode::Decaying);
        // What a fault lets down gets less from tick to tick, and is no contact's.
        let lets_down = output.amplifiers_on && !torque;
        let may = state.mode == Mode::Fault && state.faults & !LETS_DOWN == 0;
        assert!(!lets_down || may, "torque in {state:?}");
        assert!(!torque || output.amplifiers_on, "{state:?}");
        let fell = |before: &TickOutput| {
            let pairs = output.current_a.iter().zip(&before.current_a);
            before.state.mode != Mode::Fault
                || pairs.into_iter().all(|(now, was)| now.abs() <= was.abs())
        };
        assert!(
            !lets_down || self.before.as_ref().is_none_or(fell),
            "{state:?}"
        );
        assert_eq!(state.faults != 0, state.mode == Mode::Fault, "{state:?}");
        assert!(
            torque || state.force_n == [0.0; 3],
            "force while disarmed: {state:?}"
        );
        assert!(
            output.amplifiers_on || output.current_a == [0.0; 3],
            "current while off: {state:?}"
        );
        // The slew limit takes the force away no faster than it let it come.
        let slews = device.joints.iter().map(|joint| joint.max_slew_per_s);
        let slew_s = device.max_force_n * arm_m(device) / slews.fold(f32::MAX, f32::min);
        let gone_us = (MAX_HORIZON_US + STALE_DECAY_US).saturating_add((1e6 * slew_s) as u32);
        let stale = state.contact_age_us >= gone_us;
        // What it rendered goes as fast.
        let fixture = 1e-3 * (self.without_fixture as f32) <= slew_s + TICK_S;
        let none = state.force_n.iter().all(|f| *f == 0.0);
        assert!(
            !stale || none || fixture,
            "force from stale data, {gone_us} us: {state:?} {device:?}"
        );
    }
}

/// Most effort of a joint per force at the grip \[m\]; 1 of a stage.
fn arm_m(device: &DeviceDescription) -> f32 {
    match device.kinematics {
        Kinematics::Cartesian { .. } => 1.0,
        Kinematics::SerialArm {
            upper_m, fore_m, ..
        } => upper_m + fore_m,
    }
}

/// Any bytes, as a line might bring them, in a session that is armed: a tick after every 32 of them.
///
/// # Panics
/// On a defect.
pub fn stream(bytes: &[u8]) {
    let mut bench = Bench::new(0, Tuning::default());
    bench.tick();
    bench.shake_hands(1);
    for chunk in bytes.chunks(32) {
        bench.feed(chunk);
        bench.tick();
    }
    let before = bench.session;
    bench.shake_hands(2);
    assert_ne!(bench.session, before);
}
