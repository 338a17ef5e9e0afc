//! What a console's work costs, case by case: counted as instructions under the emulator, and as cycles by a board's self-test.
//!
//! Entry points: [`all`], and [`Meter`] for what counts.

use crate::devices::{CARTESIAN_BENCH, SERIAL_ARM};
use crate::measure_rows::{self, patch};
use core::hint::black_box;
use sutura_shared::console_endpoint::Sample;
use sutura_shared::control::{Control, Fresh, TICK_HZ, TickInput};
use sutura_shared::device::{DeviceDescription, JOINTS};
use sutura_shared::kinematics::forward;
use sutura_shared::link::{ConsoleLink, HostLink, Identity, LinkEvent};
use sutura_shared::wire::message::{Command, Contact, MAX_ROWS, Mode, Rows};
use sutura_shared::wire::{MAX_FRAME, ValidContact};

/// Repetitions of every measurement: the most expensive one counts.
pub const REPEAT: u32 = 8;

/// Counts what work costs.
pub trait Meter {
    /// Cost of one run.
    fn once(&mut self, work: impl FnMut()) -> u32;

    /// Whether anybody wants the figure of this name.
    fn wants(&self, _: &str) -> bool {
        true
    }

    /// Takes a figure.
    fn line(&mut self, name: &'static str, figure: u32);

    /// Runs the work a few times; the figure is the most that one took.
    fn most(&mut self, name: &'static str, mut work: impl FnMut()) {
        if self.wants(name) {
            let most = (0..REPEAT).map(|_| self.once(&mut work)).max();
            self.line(name, most.unwrap_or(0));
        }
    }
}

/// Everything that does not need the application's locks.
pub fn all(meter: &mut impl Meter, wire: &mut Wire) {
    for (device, names) in [
        (&CARTESIAN_BENCH, CARTESIAN_NAMES),
        (&SERIAL_ARM, SERIAL_ARM_NAMES),
    ] {
        device_costs(meter, wire, device, names);
    }
    let mut most = 0;
    for sequence in 0..REPEAT {
        let (frame, length) = wire.contact(
            u64::from(sequence),
            &touching(device_grip(&CARTESIAN_BENCH)),
        );
        most = most.max(meter.once(|| {
            black_box(wire.receive(&frame[..length]).is_some());
        }));
    }
    meter.line("contact_receive_and_validate", most);
    measure_rows::all(meter, wire);
    let mut frame = [0; MAX_FRAME];
    meter.most("state_encode", || {
        black_box(
            wire.console
                .encode_state(1000, &Sample::BEFORE_THE_FIRST.state, &mut frame),
        );
    });
}

/// Names of one console's figures.
struct Names {
    kinematics: &'static str,
    tick: &'static str,
    swap: &'static str,
    rows: [&'static str; 2],
    cones: [&'static str; 2],
}

const CARTESIAN_NAMES: Names = Names {
    kinematics: "kinematics_cartesian",
    tick: "tick_tangent_cartesian",
    swap: "tick_tangent_with_swap_cartesian",
    rows: ["tick_rows24_cartesian", "tick_rows24_with_swap_cartesian"],
    cones: [
        "tick_rows24_cones_cartesian",
        "tick_rows24_cones_with_swap_cartesian",
    ],
};

const SERIAL_ARM_NAMES: Names = Names {
    kinematics: "kinematics_serial_arm",
    tick: "tick_tangent_serial_arm",
    swap: "tick_tangent_with_swap_serial_arm",
    rows: ["tick_rows24_serial_arm", "tick_rows24_with_swap_serial_arm"],
    cones: [
        "tick_rows24_cones_serial_arm",
        "tick_rows24_cones_with_swap_serial_arm",
    ],
};

/// Joint coordinates in the middle of the travel, away from the arm's singular poses.
const MIDDLE: [f32; JOINTS] = [0.1, 0.4, -0.9];

fn counts(device: &DeviceDescription, q: [f32; JOINTS]) -> [i32; JOINTS] {
    let mut counts = [0; JOINTS];
    for ((count, joint), q) in counts.iter_mut().zip(&device.joints).zip(q) {
        *count = (q * joint.counts_per_unit) as i32 + joint.zero_counts;
    }
    counts
}

/// A tick whose contact is a stiff, tilted surface that the grip is in: nothing is skipped.
fn device_costs(meter: &mut impl Meter, wire: &mut Wire, device: &DeviceDescription, names: Names) {
    meter.most(names.kinematics, || {
        black_box(forward(black_box(device), black_box(&MIDDLE)));
    });
    ticks(meter, wire, device, None, [names.tick, names.swap]);
    for (cones, names) in [(0, names.rows), (MAX_ROWS / 3, names.cones)] {
        let rows = patch(cones);
        ticks(meter, wire, device, Some(&rows), names);
    }
}

/// Every tenth tick changes the model.
fn ticks(
    meter: &mut impl Meter,
    wire: &mut Wire,
    device: &DeviceDescription,
    rows: Option<&Rows>,
    [plain_name, swap_name]: [&'static str; 2],
) {
    if !meter.wants(plain_name) && !meter.wants(swap_name) {
        return;
    }
    let Ok(mut control) = Control::new(*device) else {
        return;
    };
    let grip = device_grip(device);
    let (mut plain, mut swap) = (0, 0);
    for tick in 0..400_u64 {
        let step = (tick % 40).abs_diff(20) as f32 * 1e-4;
        let input = TickInput {
            now_us: 1000 * (tick + 1),
            encoder_counts: counts(device, MIDDLE.map(|q| q + step)),
            ..TickInput::default()
        };
        if tick == 2 {
            control.command(Command::Arm);
        }
        let fresh = if tick % 10 == 5 {
            if let Some(rows) = rows {
                wire.send_rows(1000 * tick, rows);
            }
            wire.valid(1000 * tick, &touching(grip))
        } else {
            None
        };
        let slot = fresh.map(|contact| match rows {
            Some(_) => Fresh::of(contact, wire.console.rows()),
            None => contact.into(),
        });
        let mut output = None;
        let cost = meter.once(|| output = Some(control.tick(&input, slot.as_ref())));
        let armed = output.is_some_and(|output| output.state.mode == Mode::Armed);
        let force = output.map_or(0.0, |output| output.state.force_n[2]);
        // Only what renders counts.
        if armed && force > 0.0 {
            let most = if slot.is_some() {
                &mut swap
            } else {
                &mut plain
            };
            *most = cost.max(*most);
        }
    }
    meter.line(plain_name, plain);
    meter.line(swap_name, swap);
}

fn device_grip(device: &DeviceDescription) -> [f32; 3] {
    forward(device, &MIDDLE).position_m.into()
}

/// 2 N and 800 N/m along a tilted normal, relaxing.
fn touching(position_m: [f32; 3]) -> Contact {
    let normal = [0.36, 0.48, 0.8];
    let mut tangent = [0.0; 21];
    // Packed rows: 0 to 5, 6 to 10, 11 to 14, ..
    for (place, (a, b)) in [
        (0, (0, 0)),
        (1, (0, 1)),
        (2, (0, 2)),
        (6, (1, 1)),
        (7, (1, 2)),
        (11, (2, 2)),
    ] {
        tangent[place] = -800.0 * normal[a] * normal[b];
    }
    let [x, y, z] = normal.map(|n| 2.0 * n);
    Contact {
        tool: 0,
        position_m,
        orientation: [0.0, 0.0, 0.0, 1.0],
        wrench: [x, y, z, 0.0, 0.0, 0.0],
        tangent,
        gap_m: 0.0,
        normal,
        relaxation_per_s: 0.1,
        horizon_us: 100_000,
    }
}

/// Both ends of an open session.
pub struct Wire {
    /// The host's.
    pub host: HostLink,
    /// The console's.
    pub console: ConsoleLink,
}

impl Default for Wire {
    fn default() -> Self {
        Self::new()
    }
}

impl Wire {
    /// A session between the two.
    pub fn new() -> Self {
        let identity = Identity {
            tick_hz: TICK_HZ,
            simulated: true,
            device_name: CARTESIAN_BENCH.name,
        };
        let mut wire = Self {
            host: HostLink::new(TICK_HZ),
            console: ConsoleLink::new(identity, 1),
        };
        let mut frame = [0; MAX_FRAME];
        let length = wire.host.hello(1, &mut frame).unwrap_or(0);
        wire.receive(&frame[..length]);
        let length = wire.console.take_reply(0, &mut frame).unwrap_or(0);
        for &byte in &frame[..length] {
            wire.host.receive(byte);
        }
        wire
    }

    fn contact(&mut self, console_time_us: u64, contact: &Contact) -> ([u8; MAX_FRAME], usize) {
        let mut frame = [0; MAX_FRAME];
        let length = self
            .host
            .send(console_time_us, contact, &mut frame)
            .unwrap_or(0);
        (frame, length)
    }

    fn receive(&mut self, frame: &[u8]) -> Option<ValidContact> {
        let mut rest = frame;
        match self.console.receive(&mut rest, u64::MAX) {
            Some(LinkEvent::Contact(contact)) => Some(contact),
            _ => None,
        }
    }

    fn send_rows(&mut self, console_time_us: u64, rows: &Rows) {
        let mut frame = [0; MAX_FRAME];
        let length = self
            .host
            .send(console_time_us, rows, &mut frame)
            .unwrap_or(0);
        self.receive(&frame[..length]);
    }

    fn valid(&mut self, console_time_us: u64, contact: &Contact) -> Option<ValidContact> {
        let (frame, length) = self.contact(console_time_us, contact);
        self.receive(&frame[..length])
    }
}
