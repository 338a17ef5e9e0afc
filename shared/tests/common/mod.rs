//! Messages and helpers that several tests of the wire share.

#![allow(
    dead_code,
    clippy::unwrap_used,
    reason = "each test binary uses its part"
)]

use sutura_shared::device::{DeviceDescription, Joint, Kinematics};
use sutura_shared::wire::message::{
    Command, Contact, Course, End, Fixture, Friction, HandScript, Hello, Mode, Needle, Ping, Pong,
    Refusal, Report, Row, RowKind, Rows, Simulate, State, Tension, Thread, Tip, WayPoint,
};
use sutura_shared::wire::{
    Accumulator, Checked, Direction, Header, Kind, List, MAX_FRAME, Message, PROTOCOL_VERSION,
    Reject, Unchecked, Valid, ValidRows, decode, encode,
};

/// A name, padded with zeros.
pub fn padded(name: &str) -> [u8; 16] {
    let mut bytes = [0; 16];
    bytes[..name.len()].copy_from_slice(name.as_bytes());
    bytes
}

/// The messages of `tests/golden/frames.py`.
pub mod sample {
    use super::*;

    pub fn hello_host() -> Hello {
        Hello {
            schema_hash: 0x0123_4567_89ab_cdef,
            nonce: 0xdead_beef,
            session: 0,
            tick_hz: 1000,
            max_frame: 300,
            simulated: false,
            device_name: [0; 16],
            refusal: Refusal::None,
        }
    }

    pub fn hello_console() -> Hello {
        Hello {
            session: 0x00c0_ffee,
            simulated: true,
            device_name: padded("desk"),
            ..hello_host()
        }
    }

    pub fn state() -> State {
        State {
            tick: 123_456,
            position_m: [0.125, -0.25, 0.5],
            orientation: [0.0, 0.0, 0.0, 1.0],
            velocity_m_per_s: [1.5, -0.0, -2.0],
            force_n: [0.75, 0.0, -3.5],
            current_a: [0.25, -0.25, 1.0],
            mode: Mode::Decaying,
            faults: 0b10001,
            contact_sequence: 77,
            contact_age_us: 33_000,
            applied_age_us: u32::MAX,
            trace_hash: 0xfedc_ba98_7654_3210,
            encoder_counts: [300, -2, i32::MIN],
            inputs: 0b1000_1001,
            heard_sequence: 70_000,
        }
    }

    pub fn ping() -> Ping {
        Ping {
            host_us: 5_000_000_000,
        }
    }

    pub fn pong() -> Pong {
        Pong {
            host_us: 5_000_000_000,
            received_us: 123_456_100,
            sent_us: 123_457_000,
        }
    }

    pub fn contact() -> Contact {
        Contact {
            tool: 0,
            position_m: [0.125, -0.25, 0.5],
            orientation: [0.5, -0.5, 0.5, 0.5],
            wrench: [0.0, 1.0, -2.0, 0.5, 0.25, -0.125],
            tangent: core::array::from_fn(|k| -8.0 * (k as f32 + 1.0)),
            gap_m: 0.0,
            normal: [0.0, 0.0, 1.0],
            relaxation_per_s: 0.5,
            horizon_us: 100_000,
        }
    }

    pub fn needle() -> Needle {
        Needle {
            tool: 0,
            needle: 3,
            slide: [0.0, 0.75, -2.0, 125.0, 0.0, -0.0],
            tip: Tip::Holding,
            friction: Friction::Backward,
            axial_n: -0.375,
            friction_n: [0.5, 0.25],
            stiffness_n_per_m: [256.0, 64.0],
            hold_n: 0.0625,
            puncture_n: 0.125,
            punctured_n: -0.3125,
            course: Course {
                forward: 3,
                backward: 1,
                points: core::array::from_fn(|point| match point {
                    0 => [0.0009765625, -0.5],
                    1 => [0.0009765625, -0.3125],
                    2 => [0.001953125, -0.34375],
                    3 => [0.000_122_070_31, 0.25],
                    _ => [0.0; 2],
                }),
            },
        }
    }

    pub fn thread() -> Thread {
        Thread {
            tool: 0,
            thread: 2,
            end: End::Head,
            state: Tension::Taut,
            direction: [0.0, -1.0, -0.0],
            tension_n: 1.5,
            stiffness_n_per_m: 512.0,
            slack_m: 0.0,
        }
    }

    /// A smooth contact and one with friction: four rows.
    pub fn rows() -> Rows {
        let row = |k: f32, kind, lambda_n| Row {
            kind,
            delta_free_m: -0.25 * k,
            lambda_n,
            jacobian: [0.0, -0.5 * k, -1.0, 0.125, k, -0.0],
        };
        let normal = RowKind::Normal {
            id: 70_000,
            friction: 0.5,
        };
        Rows {
            tool: 0,
            held: core::array::from_fn(|k| 8.0 * (k as f32 + 1.0)),
            curvature_per_m: 125.0,
            rows: List::of([
                row(1.0, RowKind::Smooth { id: 3 }, 0.75),
                row(2.0, normal, 2.0),
                row(3.0, RowKind::Tangent { anchor_m: -0.125 }, -0.5),
                row(4.0, RowKind::Tangent { anchor_m: 0.0 }, 0.0),
            ]),
            compliance: List::of([0.5, 0.25, -0.125, 0.0, 0.5, 0.0625, -0.0, 1.0, 0.03125, 2.0]),
        }
    }

    pub fn fixed_wall() -> Fixture {
        Fixture::Wall {
            point_m: [0.0, 0.0, -0.125],
            normal: [0.0, 0.0, 1.0],
            stiffness_n_per_m: 800.0,
            damping_n_s_per_m: 2.0,
        }
    }

    pub fn coupling() -> Fixture {
        Fixture::Coupling {
            anchor_m: [0.25, -0.5, 0.0],
            stiffness_n_per_m: 400.0,
            damping_n_s_per_m: 1.5,
        }
    }

    pub fn report() -> Report {
        Report {
            ticks: 100_000,
            tick_overruns: 1,
            ticks_late: 2,
            frames_received: 30_000,
            frames_lost: 4,
            frames_rejected: 5,
            frames_superseded: 300,
            last_reject: 4,
            reset_cause: 1,
            epitaph_kind: 2,
            epitaph_place: 0x0800_1234,
            stack_free_bytes: 4096,
            tick_cost_max: 2400,
        }
    }

    pub fn device(kinematics: Kinematics) -> DeviceDescription {
        let joint = |k: f32| Joint {
            counts_per_unit: 1000.0 * k,
            zero_counts: -(k as i32),
            effort_per_amp: 0.25 * k,
            max_current_a: 2.5,
            max_slew_per_s: 400.0,
            max_speed_per_s: 3.0,
            inertia: 0.125 * k,
            damping: 0.5,
            coulomb: 0.0625,
        };
        DeviceDescription {
            name: padded("bras é"),
            kinematics,
            joints: [joint(1.0), joint(2.0), joint(3.0)],
            gravity_mass_kg: [0.0, 0.5, 0.25],
            max_force_n: 12.0,
            max_power_w: 6.0,
            max_grip_speed_m_per_s: 1.5,
            actuation_delay_us: 1000,
        }
    }

    pub fn cartesian() -> DeviceDescription {
        device(Kinematics::Cartesian {
            origin_m: [-1.0, 0.0, 0.5],
        })
    }

    pub fn serial_arm() -> DeviceDescription {
        device(Kinematics::SerialArm {
            shoulder_m: [0.0, 0.0, 0.25],
            upper_m: 0.125,
            fore_m: 0.25,
        })
    }

    pub fn hand() -> HandScript {
        let mut way_points = [WayPoint::default(); 12];
        for (k, point) in way_points.iter_mut().take(3).enumerate() {
            let k = k as f32;
            *point = WayPoint {
                time_s: 0.5 * k,
                position_m: [0.25, 0.0, -0.125 * k],
            };
        }
        HandScript {
            stiffness_n_per_m: 200.0,
            damping_n_s_per_m: 2.0,
            start_joint: [0.0, 0.5, -0.5],
            count: 3,
            way_points,
        }
    }
}

/// Contacts as rows.
pub mod rows {
    use super::*;
    use sutura_shared::math::{clamp, max};

    /// A checked frame.
    pub fn frame(console_time_us: u64, body: Rows) -> ValidRows {
        let header = Header {
            console_time_us,
            ..header_for::<Rows>()
        };
        Valid::new(header, body).unwrap()
    }

    /// One smooth row along z, with a gap at the frame's pose.
    pub fn smooth(id: u32, compliance: f32, gap_m: f32) -> Rows {
        let row = Row {
            kind: RowKind::Smooth { id },
            delta_free_m: gap_m,
            lambda_n: 0.0,
            jacobian: [0.0, 0.0, 1.0, 0.0, 0.0, 0.0],
        };
        Rows {
            tool: 0,
            held: [0.0; 21],
            curvature_per_m: 0.0,
            rows: List::of([row]),
            compliance: List::of([compliance]),
        }
    }

    /// A point on springs \[N/m\].
    pub struct Contact3 {
        pub normal: f32,
        pub along: f32,
        pub friction: f32,
    }

    /// That point, with z as its normal and x and y as its tangents; in balance at the frame's pose.
    pub fn cone(id: u32, contact: &Contact3, gap_m: f32) -> Rows {
        let axis = |axis: usize| core::array::from_fn(|k| if k == axis { 1.0 } else { 0.0 });
        let row = |kind, delta_free_m: f32, lambda_n, jacobian| Row {
            kind,
            delta_free_m,
            lambda_n,
            jacobian,
        };
        let friction = contact.friction;
        let push = contact.normal * max(-gap_m, 0.0);
        let tangent = RowKind::Tangent { anchor_m: 0.0 };
        let (n, t) = (1.0 / contact.normal, 1.0 / contact.along);
        Rows {
            tool: 0,
            held: [0.0; 21],
            curvature_per_m: 0.0,
            rows: List::of([
                row(RowKind::Normal { id, friction }, gap_m, push, axis(2)),
                row(tangent, 0.0, 0.0, axis(0)),
                row(tangent, 0.0, 0.0, axis(1)),
            ]),
            compliance: List::of([n, 0.0, 0.0, t, 0.0, t]),
        }
    }

    /// Rows of any numbers that still validate, the first of them cones, coupled up to the limit: W may be
    /// indefinite.
    pub fn wild(numbers: &[[f32; 8]], cones: usize, entries: &[f32], exponent: i32) -> Rows {
        let n = numbers.len();
        let size = 10f64.powi(exponent) as f32;
        let diagonal: Vec<f32> = (0..n)
            .map(|k| clamp(size * (1.0 + 4.0 * entries[k].abs()), 1e-7, 1e4))
            .collect();
        let mut compliance = List::new();
        for i in 0..n {
            for j in i..n {
                let entry = entries[(7 * i + 3 * j) % entries.len()];
                // Extremes are what breaks a solver: half of them are at the limit.
                let entry = if entry.abs() < 0.5 {
                    entry
                } else {
                    if entry < 0.0 { -1.0 } else { 1.0 }
                };
                let most = (diagonal[i] * diagonal[j]).sqrt();
                compliance.push(if i == j { diagonal[i] } else { entry * most });
            }
        }
        let mut rows = List::new();
        for (k, numbers) in numbers.iter().enumerate() {
            let id = k as u32;
            let kind = match k {
                k if k >= 3 * cones => RowKind::Smooth { id },
                k if k % 3 == 0 => RowKind::Normal {
                    id,
                    friction: max(10.0 * numbers[0].abs(), 1e-6),
                },
                _ => RowKind::Tangent {
                    anchor_m: numbers[1],
                },
            };
            let lambda = 1e4 * numbers[6];
            let is_tangent = matches!(kind, RowKind::Tangent { .. });
            rows.push(Row {
                kind,
                delta_free_m: 10.0 * numbers[7],
                lambda_n: if is_tangent { lambda } else { lambda.abs() },
                jacobian: core::array::from_fn(|axis| 1e3 * numbers[axis]),
            });
        }
        Rows {
            tool: 0,
            held: core::array::from_fn(|k| 1e7 * entries[k]),
            curvature_per_m: 1e4 * entries[21].abs(),
            rows,
            compliance,
        }
    }
}

/// One golden frame: its name and bytes from `frames.hex`, its message and header from here.
pub struct Golden {
    pub name: &'static str,
    pub bytes: Vec<u8>,
    pub message: Unchecked,
}

/// The golden frames with the messages that they must hold.
pub fn golden() -> Vec<Golden> {
    let header = |kind, session, sequence, console_time_us| Header {
        version: PROTOCOL_VERSION,
        kind,
        session,
        sequence,
        console_time_us,
    };
    let session = 0x00c0_ffee;
    let command =
        |sequence, body| Unchecked::Command(header(Kind::Command, session, sequence, 0), body);
    let simulate =
        |sequence, body| Unchecked::Simulate(header(Kind::Simulate, session, sequence, 0), body);
    let fixture =
        |sequence, body| Unchecked::Fixture(header(Kind::Fixture, session, sequence, 0), body);
    let messages = [
        Unchecked::Hello(header(Kind::Hello, 0, 0, 0), sample::hello_host()),
        Unchecked::Hello(
            header(Kind::Hello, 0, 0, 5_000_000_000),
            sample::hello_console(),
        ),
        Unchecked::State(
            header(Kind::State, session, 1, 123_456_000),
            sample::state(),
        ),
        Unchecked::Contact(
            header(Kind::Contact, session, 2, 123_423_000),
            sample::contact(),
        ),
        Unchecked::Needle(
            header(Kind::Needle, session, 12, 123_423_000),
            sample::needle(),
        ),
        Unchecked::Thread(
            header(Kind::Thread, session, 13, 123_423_000),
            sample::thread(),
        ),
        fixture(15, Fixture::None),
        fixture(16, sample::fixed_wall()),
        fixture(17, sample::coupling()),
        Unchecked::Ping(header(Kind::Ping, session, 18, 123_423_000), sample::ping()),
        Unchecked::Pong(header(Kind::Pong, session, 2, 123_457_000), sample::pong()),
        Unchecked::Hello(
            header(Kind::Hello, 0, 0, 5_000_000_000),
            Hello {
                session: 0,
                refusal: Refusal::Owned,
                ..sample::hello_console()
            },
        ),
        command(3, Command::Arm),
        command(4, Command::Disarm),
        command(5, Command::ClearFault),
        command(6, Command::StateEvery { ticks: 1000 }),
        Unchecked::Report(
            header(Kind::Report, session, u32::MAX, 1 << 63),
            sample::report(),
        ),
        simulate(7, Simulate::Device(sample::cartesian())),
        simulate(8, Simulate::Device(sample::serial_arm())),
        simulate(9, Simulate::Hand(sample::hand())),
        simulate(10, Simulate::EmergencyStop(true)),
        simulate(11, Simulate::EncoderOffset([-1, i32::MAX, i32::MIN])),
    ];
    let lines = include_str!("../../../tests/golden/frames.hex").lines();
    // Rows are read by another way.
    let lines = lines.filter(|line| !line.starts_with('#') && !line.starts_with("rows "));
    let lines: Vec<_> = lines.collect();
    assert_eq!(lines.len(), messages.len(), "frames.hex has other frames");
    lines
        .into_iter()
        .zip(messages)
        .map(|(line, message)| {
            let (name, hex) = line.split_once(' ').unwrap();
            Golden {
                name,
                bytes: bytes_of(hex),
                message,
            }
        })
        .collect()
}

/// The golden frame of [`sample::rows`]: sequence 14, console time 123.423 s.
pub fn golden_rows() -> Vec<u8> {
    let mut lines = include_str!("../../../tests/golden/frames.hex").lines();
    bytes_of(lines.find_map(|line| line.strip_prefix("rows ")).unwrap())
}

/// The rows in `bytes`, frame by frame.
pub fn rows_in(bytes: &[u8]) -> Vec<Result<ValidRows, Reject>> {
    let mut accumulator = Accumulator::new();
    let mut out = Vec::new();
    for byte in bytes {
        if let Some(packet) = accumulator.push(*byte) {
            out.push(packet.and_then(|packet| decode(packet)?.rows(Direction::ToConsole)));
        }
    }
    out
}

fn bytes_of(hex: &str) -> Vec<u8> {
    (0..hex.len())
        .step_by(2)
        .map(|i| u8::from_str_radix(&hex[i..i + 2], 16).unwrap())
        .collect()
}

pub fn hex_of(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// A frame of the crate's own making.
pub fn frame<M: Message>(session: u32, sequence: u32, console_time_us: u64, body: &M) -> Vec<u8> {
    let mut out = [0; MAX_FRAME];
    let len = encode(session, sequence, console_time_us, body, &mut out).unwrap();
    out[..len].to_vec()
}

/// Whatever message, encoded again.
pub fn encode_again(message: &Unchecked) -> Vec<u8> {
    fn again<M: Message>(header: &Header, body: &M) -> Vec<u8> {
        frame(
            header.session,
            header.sequence,
            header.console_time_us,
            body,
        )
    }
    match message {
        Unchecked::Hello(header, body) => again(header, body),
        Unchecked::State(header, body) => again(header, body),
        Unchecked::Contact(header, body) => again(header, body),
        Unchecked::Command(header, body) => again(header, body),
        Unchecked::Report(header, body) => again(header, body),
        Unchecked::Simulate(header, body) => again(header, body),
        Unchecked::Needle(header, body) => again(header, body),
        Unchecked::Thread(header, body) => again(header, body),
        Unchecked::Fixture(header, body) => again(header, body),
        Unchecked::Ping(header, body) => again(header, body),
        Unchecked::Pong(header, body) => again(header, body),
    }
}

/// A frame around any packet content, with the right checksum: what a hostile peer can make.
pub fn forge(content: &[u8]) -> Vec<u8> {
    let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(content);
    let packet = [content, &crc.to_le_bytes()].concat();
    let mut out = vec![0; cobs::max_encoding_length(packet.len())];
    let len = cobs::try_encode(&packet, &mut out).unwrap();
    out.truncate(len);
    out.push(0);
    out
}

/// Packet content of a header.
pub fn header_bytes(version: u8, kind: u8, session: u32, sequence: u32, time_us: u64) -> Vec<u8> {
    let mut bytes = vec![version, kind];
    bytes.extend(session.to_le_bytes());
    bytes.extend(sequence.to_le_bytes());
    bytes.extend(time_us.to_le_bytes());
    bytes
}

/// What comes out of a stream of bytes, frame by frame, unpacked but not validated.
pub fn unpack_all(bytes: &[u8]) -> Vec<Result<Unchecked, Reject>> {
    let mut accumulator = Accumulator::new();
    let mut out = Vec::new();
    for byte in bytes {
        if let Some(packet) = accumulator.push(*byte) {
            out.push(packet.and_then(|packet| decode(packet)?.unpack()));
        }
    }
    out
}

/// The only frame in `bytes`.
pub fn unpack_one(bytes: &[u8]) -> Result<Unchecked, Reject> {
    let mut all = unpack_all(bytes);
    assert_eq!(all.len(), 1, "not one frame: {all:?}");
    all.remove(0)
}

/// Validates towards whichever end may receive it.
pub fn validate_either(unchecked: Unchecked) -> Result<Checked, Reject> {
    match unchecked.validate(Direction::ToConsole) {
        Err(Reject::Direction) => unchecked.validate(Direction::ToHost),
        verdict => verdict,
    }
}

/// A header for [`Valid::new`].
pub fn header_for<M: Message>() -> Header {
    Header {
        version: PROTOCOL_VERSION,
        kind: M::KIND,
        session: 1,
        sequence: 1,
        console_time_us: 0,
    }
}

/// Whether a receiver takes the message.
pub fn verdict<M: Message>(body: M) -> Result<(), Reject> {
    Valid::new(header_for::<M>(), body).map(|_| ())
}
