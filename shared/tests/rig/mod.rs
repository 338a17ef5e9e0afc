//! Devices and a bare control loop that several tests share.

#![allow(
    dead_code,
    clippy::unwrap_used,
    reason = "each test binary uses its part"
)]

use sutura_shared::control::{Control, Guards, TICK_US, TickInput, TickOutput, Tuning};
use sutura_shared::device::{DeviceDescription, Joint, Kinematics};
use sutura_shared::wire::message::{
    Command, Contact, Course, End, Fixture, Friction, HandScript, Mode, Needle, Tension, Thread,
    Tip, WAY_POINTS, WayPoint,
};
use sutura_shared::wire::{
    Header, Kind, PROTOCOL_VERSION, ValidContact, ValidFixture, ValidNeedle, ValidThread,
};

/// The numbers of `devices/cartesian-bench.toml`.
pub fn bench() -> DeviceDescription {
    let joint = |inertia, damping, coulomb| Joint {
        counts_per_unit: 81_487.0,
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
        name: *b"cartesian-bench\0",
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

/// The numbers of `devices/serial-arm.toml`.
pub fn arm() -> DeviceDescription {
    let joint = |inertia, damping, coulomb| Joint {
        counts_per_unit: 12_732.0,
        zero_counts: 0,
        effort_per_amp: 0.30,
        max_current_a: 3.0,
        max_slew_per_s: 300.0,
        max_speed_per_s: 12.0,
        inertia,
        damping,
        coulomb,
    };
    DeviceDescription {
        name: *b"serial-arm\0\0\0\0\0\0",
        kinematics: Kinematics::SerialArm {
            shoulder_m: [-0.30, 0.0, 0.12],
            upper_m: 0.22,
            fore_m: 0.22,
        },
        joints: [
            joint(0.006, 0.010, 0.012),
            joint(0.006, 0.010, 0.012),
            joint(0.003, 0.008, 0.010),
        ],
        gravity_mass_kg: [0.0, 0.06, 0.04],
        max_force_n: 2.0,
        max_power_w: 3.0,
        max_grip_speed_m_per_s: 1.5,
        actuation_delay_us: 1000,
    }
}

/// A hand on a path of way points (time \[s\], position \[m\]).
pub fn hand(stiffness: f32, damping: f32, points: &[(f32, [f32; 3])]) -> HandScript {
    let mut way_points = [WayPoint::default(); WAY_POINTS];
    for (slot, (time_s, position_m)) in way_points.iter_mut().zip(points) {
        *slot = WayPoint {
            time_s: *time_s,
            position_m: *position_m,
        };
    }
    HandScript {
        stiffness_n_per_m: stiffness,
        damping_n_s_per_m: damping,
        start_joint: [0.0; 3],
        count: points.len() as u8,
        way_points,
    }
}

/// Nothing near.
pub fn no_contact() -> Contact {
    Contact {
        tool: 0,
        position_m: [0.0; 3],
        orientation: [0.0, 0.0, 0.0, 1.0],
        wrench: [0.0; 6],
        tangent: [0.0; 21],
        gap_m: 1.0,
        normal: [0.0, 0.0, 1.0],
        relaxation_per_s: 0.0,
        horizon_us: 100_000,
    }
}

/// A spring behind the plane z = 0, solved for a grip at `position`.
pub fn wall(stiffness: f32, position: [f32; 3]) -> Contact {
    let mut contact = Contact {
        position_m: position,
        gap_m: if position[2] > 0.0 { position[2] } else { 0.0 },
        ..no_contact()
    };
    contact.tangent[11] = -stiffness;
    if position[2] < 0.0 {
        contact.wrench[2] = -stiffness * position[2];
    }
    contact
}

/// A checked frame.
pub fn frame(sequence: u32, console_time_us: u64, body: Contact) -> ValidContact {
    let header = Header {
        version: PROTOCOL_VERSION,
        kind: Kind::Contact,
        session: 1,
        sequence,
        console_time_us,
    };
    ValidContact::new(header, body).unwrap()
}

/// A straight needle that slides down through tissue, in the grip of tool 0.
pub fn needle() -> Needle {
    Needle {
        tool: 0,
        needle: 0,
        slide: [0.0, 0.0, -1.0, 0.0, 0.0, 0.0],
        tip: Tip::Inside,
        friction: Friction::Forward,
        axial_n: -0.5,
        friction_n: [0.5; 2],
        stiffness_n_per_m: [80.0, 0.0],
        hold_n: 0.0,
        puncture_n: 0.3,
        punctured_n: -0.5,
        course: Course::default(),
    }
}

/// A checked frame of a needle.
pub fn needle_frame(sequence: u32, console_time_us: u64, body: Needle) -> ValidNeedle {
    let header = Header {
        version: PROTOCOL_VERSION,
        kind: Kind::Needle,
        session: 1,
        sequence,
        console_time_us,
    };
    ValidNeedle::new(header, body).unwrap()
}

/// A thread that pulls the grip of tool 0 down.
pub fn thread() -> Thread {
    Thread {
        tool: 0,
        thread: 0,
        end: End::Head,
        state: Tension::Taut,
        direction: [0.0, 0.0, -1.0],
        tension_n: 0.75,
        stiffness_n_per_m: 120.0,
        slack_m: 0.0,
    }
}

/// A checked frame of a thread.
pub fn thread_frame(sequence: u32, console_time_us: u64, body: Thread) -> ValidThread {
    let header = Header {
        version: PROTOCOL_VERSION,
        kind: Kind::Thread,
        session: 1,
        sequence,
        console_time_us,
    };
    ValidThread::new(header, body).unwrap()
}

/// A checked frame of a fixture.
pub fn fixture_frame(sequence: u32, body: Fixture) -> ValidFixture {
    let header = Header {
        version: PROTOCOL_VERSION,
        kind: Kind::Fixture,
        session: 1,
        sequence,
        console_time_us: 0,
    };
    ValidFixture::new(header, body).unwrap()
}

/// A control loop whose encoders stand where the test puts them.
pub struct Loop {
    pub control: Control,
    pub input: TickInput,
    pub device: DeviceDescription,
    sequence: u32,
}

impl Loop {
    /// A loop that has left boot.
    pub fn new(device: DeviceDescription) -> Self {
        Loop::guarded(device, Guards::ALL)
    }

    /// A loop that has left boot, with some of its guards.
    pub fn guarded(device: DeviceDescription, guards: Guards) -> Self {
        let tuning = Tuning {
            guards,
            ..Tuning::default()
        };
        let mut this = Loop {
            control: Control::tuned(device, tuning).unwrap(),
            input: TickInput::default(),
            device,
            sequence: 0,
        };
        this.tick();
        assert_eq!(this.tick().state.mode, Mode::Idle);
        this
    }

    /// A loop that has been armed.
    pub fn armed(device: DeviceDescription) -> Self {
        Loop::new(device).arm()
    }

    /// A loop that has left boot and whose force needs no motion that paid for it: encoders that a test puts
    /// somewhere have taken no energy from a hand.
    pub fn on_credit(device: DeviceDescription) -> Self {
        let guards = Guards {
            tank: false,
            damping: false,
            ..Guards::ALL
        };
        Loop::guarded(device, guards)
    }

    /// The same, armed.
    pub fn armed_on_credit(device: DeviceDescription) -> Self {
        Loop::on_credit(device).arm()
    }

    fn arm(self) -> Self {
        let mut this = self;
        this.control.command(Command::Arm);
        assert_eq!(this.tick().state.mode, Mode::Armed);
        this
    }

    /// Puts a prismatic joint at a coordinate \[m\].
    pub fn place(&mut self, joint: usize, q: f32) {
        let counts = q * self.device.joints[joint].counts_per_unit;
        self.input.encoder_counts[joint] = libm::rintf(counts) as i32;
    }

    pub fn tick(&mut self) -> TickOutput {
        self.tick_with(None)
    }

    /// One tick, with a contact solved for console time `time_us`.
    pub fn tick_with(&mut self, contact: Option<(u64, Contact)>) -> TickOutput {
        self.input.now_us += TICK_US;
        let frame = contact.map(|(time_us, body)| {
            self.sequence += 1;
            frame(self.sequence, time_us, body)
        });
        self.control
            .tick(&self.input, frame.map(Into::into).as_ref())
    }

    /// One tick, with a contact solved for the state before it.
    pub fn contact(&mut self, body: Contact) -> TickOutput {
        self.tick_with(Some((self.input.now_us, body)))
    }

    /// Several ticks without contacts; the last one's output.
    pub fn wait(&mut self, ticks: u32) -> TickOutput {
        assert!(ticks > 0);
        for _ in 1..ticks {
            self.tick();
        }
        self.tick()
    }
}
