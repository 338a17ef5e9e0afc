//! Values that a receiver takes and values that it refuses, for every field that can be wrong.

#![allow(clippy::unwrap_used)]

use crate::common::{
    encode_again, frame, header_for, padded, sample, unpack_one, validate_either, verdict,
};
use proptest::prelude::*;
use sutura_shared::device::{DeviceDescription, Kinematics};
use sutura_shared::wire::message::{
    Command, Contact, Course, End, Fixture, Friction, HandScript, Hello, Mode, Needle, Ping, Pong,
    Refusal, Report, Simulate, State, Tension, Thread, Tip, WAY_POINTS, WayPoint,
};
use sutura_shared::wire::{Checked, Header, Kind, Message, Reject, Valid, validate};

const NOT_FINITE: [f32; 3] = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY];

/// A copy of `message` with one thing changed.
fn with<M: Copy>(message: M, change: impl FnOnce(&mut M)) -> M {
    let mut changed = message;
    change(&mut changed);
    changed
}

/// The smallest number above `x` in magnitude.
fn beyond(x: f32) -> f32 {
    f32::from_bits(x.to_bits() + 1)
}

/// A number is taken at its limits and refused just beyond them and when it is not one.
#[track_caller]
fn check_numbers(verdict_on: impl Fn(f32) -> Result<(), Reject>, low: f32, high: f32) {
    assert!(low <= 0.0 && high > 0.0, "else `beyond` is not beyond");
    assert_eq!(verdict_on(low), Ok(()), "{low}");
    assert_eq!(verdict_on(high), Ok(()), "{high}");
    let below = if low == 0.0 {
        -f32::from_bits(1)
    } else {
        beyond(low)
    };
    assert_eq!(verdict_on(below), Err(Reject::Range), "{below}");
    assert_eq!(
        verdict_on(beyond(high)),
        Err(Reject::Range),
        "beyond {high}"
    );
    for value in NOT_FINITE {
        assert_eq!(verdict_on(value), Err(Reject::NotFinite), "{value}");
    }
}

/// The limits of one field.
#[track_caller]
fn check_limits<M: Message + Copy>(
    message: M,
    field: impl Fn(&mut M) -> &mut f32,
    low: f32,
    high: f32,
) {
    let verdict_on = |value| verdict(with(message, |m| *field(m) = value));
    check_numbers(verdict_on, low, high);
}

#[test]
fn contact_limits() {
    let contact = sample::contact();
    for i in 0..3 {
        check_limits(contact, |c| &mut c.position_m[i], -10.0, 10.0);
    }
    for i in 0..6 {
        check_limits(contact, |c| &mut c.wrench[i], -1e4, 1e4);
    }
    for i in 0..21 {
        check_limits(contact, |c| &mut c.tangent[i], -1e7, 1e7);
    }
    check_limits(contact, |c| &mut c.gap_m, 0.0, 10.0);
    check_limits(contact, |c| &mut c.relaxation_per_s, 0.0, 1e3);
    let tool = |tool| verdict(with(contact, |c| c.tool = tool));
    assert_eq!(tool(7), Ok(()));
    assert_eq!(tool(8), Err(Reject::Range));
    // The console caps the horizon itself.
    assert_eq!(verdict(with(contact, |c| c.horizon_us = u32::MAX)), Ok(()));
}

#[test]
fn directions_and_rotations_have_unit_length() {
    let contact = sample::contact();
    let normal = |normal| verdict(Contact { normal, ..contact });
    let orientation = |orientation| {
        let of_contact = verdict(Contact {
            orientation,
            ..contact
        });
        let state = State {
            orientation,
            ..sample::state()
        };
        assert_eq!(verdict(state), of_contact);
        of_contact
    };
    assert_eq!(normal([0.6, 0.0, -0.8]), Ok(()));
    // Squares of 1 +- 0.0009 and 1 +- 0.0011.
    assert_eq!(normal([0.0, 0.0, 1.000_45]), Ok(()));
    assert_eq!(normal([0.0, 0.0, 0.999_55]), Ok(()));
    assert_eq!(normal([0.0, 0.0, 1.000_55]), Err(Reject::Range));
    assert_eq!(normal([0.0, 0.0, 0.999_45]), Err(Reject::Range));
    assert_eq!(normal([0.0; 3]), Err(Reject::Range));
    assert_eq!(orientation([0.5, 0.5, -0.5, -0.5]), Ok(()));
    assert_eq!(orientation([0.0; 4]), Err(Reject::Range));
    assert_eq!(orientation([1.0, 0.0, 0.0, 0.05]), Err(Reject::Range));
    // The square of this would overflow.
    assert_eq!(normal([f32::MAX, 0.0, 0.0]), Err(Reject::Range));
    for value in NOT_FINITE {
        assert_eq!(normal([0.0, value, 1.0]), Err(Reject::NotFinite));
        let reject = orientation([0.0, 0.0, value, 1.0]);
        assert_eq!(reject, Err(Reject::NotFinite));
    }
}

#[test]
fn needle_limits() {
    let needle = sample::needle();
    for i in 0..3 {
        check_limits(needle, |n| &mut n.slide[i], -100.0, 100.0);
    }
    // The first makes the needle round, whatever the others.
    for i in 4..6 {
        check_limits(needle, |n| &mut n.slide[i], -1e4, 1e4);
    }
    let signed: [FieldOf<Needle>; 2] = [|n| &mut n.axial_n, |n| &mut n.punctured_n];
    for field in signed {
        check_limits(needle, field, -1e4, 1e4);
    }
    let magnitudes: [FieldOf<Needle>; 4] = [
        |n| &mut n.friction_n[0],
        |n| &mut n.friction_n[1],
        |n| &mut n.hold_n,
        |n| &mut n.puncture_n,
    ];
    for field in magnitudes {
        check_limits(needle, field, 0.0, 1e4);
    }
    for i in 0..2 {
        check_limits(needle, |n| &mut n.stiffness_n_per_m[i], 0.0, 1e7);
    }
    // Points that do not count are looked at, too.
    for i in [1, 3, 11] {
        check_limits(needle, |n| &mut n.course.points[i][1], -1e4, 1e4);
    }
    check_limits(needle, |n| &mut n.course.points[11][0], 0.0, 10.0);
    let counts = |forward, backward| {
        verdict(with(needle, |n| {
            n.course = Course {
                forward,
                backward,
                points: [[0.5; 2]; 12],
            };
        }))
    };
    assert_eq!(
        (counts(0, 0), counts(12, 0), counts(7, 5)),
        (Ok(()), Ok(()), Ok(()))
    );
    assert_eq!(counts(7, 6), Err(Reject::Range));
    assert_eq!(counts(255, 255), Err(Reject::Range));
    // Ways grow, each way by itself.
    let way = |i: usize, way_m| verdict(with(needle, |n| n.course.points[i][0] = way_m));
    assert_eq!(way(1, 0.0009), Err(Reject::Range));
    assert_eq!(way(3, 0.5), Ok(()));
    let tool = |tool| verdict(with(needle, |n| n.tool = tool));
    assert_eq!(tool(7), Ok(()));
    assert_eq!(tool(8), Err(Reject::Range));
    assert_eq!(verdict(with(needle, |n| n.needle = u8::MAX)), Ok(()));
}

#[test]
fn fixture_limits() {
    let wall = |point_m, normal, stiffness_n_per_m, damping_n_s_per_m| {
        verdict(Fixture::Wall {
            point_m,
            normal,
            stiffness_n_per_m,
            damping_n_s_per_m,
        })
    };
    let (origin, up) = ([0.0; 3], [0.0, 0.0, 1.0]);
    let range = Err(Reject::Range);
    assert_eq!(verdict(Fixture::None), Ok(()));
    assert_eq!(wall([10.0, -10.0, 0.0], up, 1e7, 1e4), Ok(()));
    assert_eq!(wall([10.1, 0.0, 0.0], up, 1.0, 0.0), range);
    assert_eq!(wall(origin, [0.0, 0.0, 0.9], 1.0, 0.0), range);
    assert_eq!(wall(origin, up, -1e-9, 0.0), range);
    assert_eq!(wall(origin, up, 1.1e7, 0.0), range);
    assert_eq!(wall(origin, up, 1.0, 1.1e4), range);
    let not_finite = Err(Reject::NotFinite);
    assert_eq!(wall([f32::NAN, 0.0, 0.0], up, 1.0, 0.0), not_finite);
    assert_eq!(wall(origin, up, f32::INFINITY, 0.0), not_finite);
    let coupling = |anchor_m, stiffness_n_per_m, damping_n_s_per_m| {
        verdict(Fixture::Coupling {
            anchor_m,
            stiffness_n_per_m,
            damping_n_s_per_m,
        })
    };
    assert_eq!(coupling([10.0; 3], 0.0, 0.0), Ok(()));
    assert_eq!(coupling([0.0, 0.0, -10.1], 0.0, 0.0), range);
    assert_eq!(coupling(origin, 1.0, f32::NAN), not_finite);
    assert_eq!(coupling(origin, 1.0, -1.0), range);
}

#[test]
fn thread_limits() {
    let taut = sample::thread();
    check_limits(taut, |t| &mut t.tension_n, 0.0, 1e4);
    check_limits(taut, |t| &mut t.stiffness_n_per_m, 0.0, 1e7);
    let slack = Thread {
        state: Tension::Slack,
        tension_n: 0.0,
        ..taut
    };
    check_limits(slack, |t| &mut t.slack_m, 0.0, 10.0);
    assert_eq!(
        verdict(with(slack, |t| t.tension_n = 1e-9)),
        Err(Reject::Range)
    );
    // What pulls is not slack.
    for state in [Tension::Taut, Tension::Strained] {
        let pulls = Thread { state, ..taut };
        assert_eq!(verdict(pulls), Ok(()));
        assert_eq!(
            verdict(with(pulls, |t| t.slack_m = 1e-9)),
            Err(Reject::Range)
        );
    }
    let tool = |tool| verdict(with(taut, |t| t.tool = tool));
    assert_eq!((tool(7), tool(8)), (Ok(()), Err(Reject::Range)));
    assert_eq!(verdict(with(taut, |t| t.thread = u8::MAX)), Ok(()));
    let along = |direction| verdict(Thread { direction, ..taut });
    assert_eq!(along([0.6, 0.0, -0.8]), Ok(()));
    assert_eq!(along([0.6, 0.0, -0.7]), Err(Reject::Range));
    assert_eq!(along([0.0; 3]), Err(Reject::Range));
    assert_eq!(along([0.0, f32::NAN, 1.0]), Err(Reject::NotFinite));
}

/// A straight needle slides as far as it is moved; a round one may be held anywhere, even in its middle.
#[test]
fn a_straight_needle_slides_along_a_unit_vector() {
    let slides = |slide| {
        verdict(Needle {
            slide,
            ..sample::needle()
        })
    };
    assert_eq!(slides([0.6, 0.0, -0.8, 0.0, 0.0, 0.0]), Ok(()));
    assert_eq!(slides([0.6, 0.0, -0.8, -0.0, 0.0, 0.0]), Ok(()));
    assert_eq!(slides([0.6, 0.0, -0.7, 0.0, 0.0, 0.0]), Err(Reject::Range));
    assert_eq!(slides([0.0; 6]), Err(Reject::Range));
    assert_eq!(slides([0.6, 0.0, -0.7, 0.0, 50.0, 0.0]), Ok(()));
    assert_eq!(slides([0.0, 0.0, 0.0, 0.0, 50.0, 0.0]), Ok(()));
    for value in NOT_FINITE {
        let slide = slides([1.0, 0.0, 0.0, 0.0, 0.0, value]);
        assert_eq!(slide, Err(Reject::NotFinite));
    }
}

#[test]
fn state_limits() {
    let state = State {
        faults: 0,
        ..sample::state()
    };
    for i in 0..3 {
        check_limits(state, |s| &mut s.position_m[i], -10.0, 10.0);
        check_limits(state, |s| &mut s.velocity_m_per_s[i], -100.0, 100.0);
        check_limits(state, |s| &mut s.force_n[i], -1e4, 1e4);
        check_limits(state, |s| &mut s.current_a[i], -1e3, 1e3);
    }
}

#[test]
fn a_console_in_fault_is_heard_whatever_its_encoders_say() {
    let state = State {
        faults: 1 << 15,
        mode: Mode::Fault,
        position_m: [1e30, 0.0, -1e30],
        velocity_m_per_s: [f32::MAX; 3],
        ..sample::state()
    };
    assert_eq!(verdict(state), Ok(()));
    let healthy = State { faults: 0, ..state };
    assert_eq!(verdict(healthy), Err(Reject::Range));
    let not_finite = with(state, |s| s.force_n[2] = f32::NAN);
    assert_eq!(verdict(not_finite), Err(Reject::NotFinite));
}

#[test]
fn command_limits() {
    for command in [Command::Arm, Command::Disarm, Command::ClearFault] {
        assert_eq!(verdict(command), Ok(()));
    }
    let every = |ticks| verdict(Command::StateEvery { ticks });
    assert_eq!(every(0), Err(Reject::Range));
    assert_eq!(every(1), Ok(()));
    assert_eq!(every(1000), Ok(()));
    assert_eq!(every(1001), Err(Reject::Range));
}

#[test]
fn reports_are_taken_as_they_are() {
    let report = Report {
        last_reject: 255,
        reset_cause: 255,
        ..sample::report()
    };
    assert_eq!(verdict(report), Ok(()));
}

#[test]
fn names_are_printable_text() {
    let named = |device_name| {
        let hello = verdict(Hello {
            device_name,
            ..sample::hello_console()
        });
        let device = DeviceDescription {
            name: device_name,
            ..sample::cartesian()
        };
        assert_eq!(verdict(Simulate::Device(device)), hello);
        hello
    };
    assert_eq!(named(padded("")), Ok(()));
    assert_eq!(named(padded("console é ✂")), Ok(()));
    assert_eq!(named(*b"sixteen letters!"), Ok(()));
    assert_eq!(validate::name(&padded("desk")), Ok("desk"));
    let broken = [
        *b"\xff\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0",
        // A character of two bytes, cut.
        *b"fifteen letter \xc3",
        *b"goes\0on\0\0\0\0\0\0\0\0\0",
        *b"\x1b[2Jclear\0\0\0\0\0\0\0",
        *b"two\nlines\0\0\0\0\0\0\0",
    ];
    for name in broken {
        assert_eq!(named(name), Err(Reject::Name), "{name:?}");
    }
}

#[test]
fn hello_needs_a_control_rate() {
    let hello = Hello {
        tick_hz: 0,
        ..sample::hello_host()
    };
    assert_eq!(verdict(hello), Err(Reject::Range));
}

/// A way of pointing at one field.
type FieldOf<T> = fn(&mut T) -> &mut f32;

/// The limits of one field of an order.
#[track_caller]
fn check_order<T: Copy>(
    order: fn(T) -> Simulate,
    message: T,
    field: FieldOf<T>,
    low: f32,
    high: f32,
) {
    let verdict_on = |value| verdict(order(with(message, |m| *field(m) = value)));
    check_numbers(verdict_on, low, high);
}

#[test]
fn device_numbers_are_finite_and_bounded() {
    let numbers: [FieldOf<DeviceDescription>; 12] = [
        |d| &mut d.joints[0].counts_per_unit,
        |d| &mut d.joints[1].effort_per_amp,
        |d| &mut d.joints[2].max_current_a,
        |d| &mut d.joints[0].max_slew_per_s,
        |d| &mut d.joints[1].max_speed_per_s,
        |d| &mut d.joints[2].inertia,
        |d| &mut d.joints[0].damping,
        |d| &mut d.joints[1].coulomb,
        |d| &mut d.gravity_mass_kg[2],
        |d| &mut d.max_force_n,
        |d| &mut d.max_power_w,
        |d| &mut d.max_grip_speed_m_per_s,
    ];
    for field in numbers {
        check_order(Simulate::Device, sample::cartesian(), field, -1e9, 1e9);
    }
    let origin: FieldOf<DeviceDescription> = |d| match &mut d.kinematics {
        Kinematics::Cartesian { origin_m } => &mut origin_m[1],
        Kinematics::SerialArm { shoulder_m, .. } => &mut shoulder_m[1],
    };
    let length: [FieldOf<DeviceDescription>; 2] = [
        |d| match &mut d.kinematics {
            Kinematics::SerialArm { upper_m, .. } => upper_m,
            Kinematics::Cartesian { .. } => unreachable!(),
        },
        |d| match &mut d.kinematics {
            Kinematics::SerialArm { fore_m, .. } => fore_m,
            Kinematics::Cartesian { .. } => unreachable!(),
        },
    ];
    for device in [sample::cartesian(), sample::serial_arm()] {
        check_order(Simulate::Device, device, origin, -10.0, 10.0);
    }
    for field in length {
        check_order(Simulate::Device, sample::serial_arm(), field, -10.0, 10.0);
    }
}

#[test]
fn hand_limits() {
    let hand = sample::hand();
    let order = Simulate::Hand;
    check_order(order, hand, |h| &mut h.stiffness_n_per_m, 0.0, 1e5);
    check_order(order, hand, |h| &mut h.damping_n_s_per_m, 0.0, 1e4);
    check_order(order, hand, |h| &mut h.start_joint[2], -10.0, 10.0);
    let place: FieldOf<HandScript> = |h| &mut h.way_points[1].position_m[0];
    check_order(order, hand, place, -10.0, 10.0);
    // Unused way points are checked as well.
    let unused: FieldOf<HandScript> = |h| &mut h.way_points[11].position_m[2];
    check_order(order, hand, unused, -10.0, 10.0);
    let only_one = HandScript { count: 1, ..hand };
    let time: FieldOf<HandScript> = |h| &mut h.way_points[0].time_s;
    check_order(order, only_one, time, 0.0, 3600.0);
}

#[test]
fn hand_scripts_have_way_points_in_the_order_of_time() {
    let with_times = |count, times: &[f32]| {
        let mut way_points = [WayPoint::default(); WAY_POINTS];
        for (point, time_s) in way_points.iter_mut().zip(times) {
            point.time_s = *time_s;
        }
        verdict(Simulate::Hand(HandScript {
            count,
            way_points,
            ..sample::hand()
        }))
    };
    assert_eq!(with_times(3, &[0.0, 1.0, 1.0]), Ok(()), "standing still");
    assert_eq!(with_times(3, &[0.0, 1.0, 0.5]), Err(Reject::Range));
    assert_eq!(with_times(2, &[0.0, 1.0, 0.5]), Ok(()), "not used");
    assert_eq!(with_times(1, &[2.0]), Ok(()));
    assert_eq!(with_times(0, &[]), Err(Reject::Range));
    assert_eq!(with_times(12, &[0.0; 12]), Ok(()));
    assert_eq!(with_times(13, &[0.0; 12]), Err(Reject::Range));
    assert_eq!(with_times(255, &[0.0; 12]), Err(Reject::Range));
    assert_eq!(with_times(1, &[-0.5]), Err(Reject::Range));
}

#[test]
fn a_header_of_another_kind_or_version_does_not_validate() {
    let header = header_for::<Contact>();
    let contact = sample::contact();
    let kind = Kind::Command;
    let other = Valid::new(Header { kind, ..header }, contact);
    assert_eq!(other, Err(Reject::Kind));
    let old = Valid::new(
        Header {
            version: 9,
            ..header
        },
        contact,
    );
    assert_eq!(old, Err(Reject::Version));
    let valid = Valid::new(
        Header {
            sequence: 8,
            console_time_us: 1 << 40,
            ..header
        },
        contact,
    )
    .unwrap();
    assert_eq!(valid.sequence(), 8);
    assert_eq!(valid.console_time_us(), 1 << 40);
    assert_eq!(*valid.body(), contact);
}

/// Any f32 there is, with the awkward ones often.
fn any_number() -> impl Strategy<Value = f32> {
    prop_oneof![
        8 => -2.0f32..2.0,
        1 => any::<u32>().prop_map(f32::from_bits),
        1 => prop_oneof![
            Just(f32::NAN), Just(f32::INFINITY), Just(-0.0), Just(f32::MIN_POSITIVE),
            Just(f32::from_bits(1)), Just(f32::MAX), Just(10.0), Just(1e4),
        ],
    ]
}

fn numbers<const N: usize>() -> impl Strategy<Value = [f32; N]> {
    prop::collection::vec(any_number(), N).prop_map(|v| v.try_into().unwrap())
}

/// Quaternions and normals that are often of unit length, so that the rest gets tested too.
fn any_unit<const N: usize>() -> impl Strategy<Value = [f32; N]> {
    prop_oneof![
        9 => prop::collection::vec(-1.0f32..1.0, N).prop_map(|v| {
            let length = v.iter().map(|x| x * x).sum::<f32>().sqrt();
            let unit: Vec<_> = v.iter().map(|x| x / length).collect();
            unit.try_into().unwrap()
        }),
        1 => numbers::<N>(),
    ]
}

prop_compose! {
    fn any_contact()(
        tool in 0u8..10,
        position_m in numbers(),
        orientation in any_unit(),
        wrench in numbers(),
        tangent in prop_oneof![Just([-1.0; 21]), numbers()],
        gap_m in prop_oneof![Just(0.0), any_number()],
        normal in any_unit(),
        relaxation_per_s in prop_oneof![Just(0.0), any_number()],
        horizon_us in any::<u32>(),
    ) -> Contact {
        Contact {
            tool, position_m, orientation, wrench, tangent, gap_m, normal, relaxation_per_s, horizon_us,
        }
    }
}

prop_compose! {
    fn any_needle()(
        (tool, needle) in (0u8..9, any::<u8>()),
        (linear, angular) in (any_unit::<3>(), prop_oneof![Just([0.0; 3]), numbers::<3>()]),
        tip in prop_oneof![Just(Tip::Outside), Just(Tip::Holding), Just(Tip::Inside)],
        friction in
            prop_oneof![Just(Friction::Sticks), Just(Friction::Forward), Just(Friction::Backward)],
        friction_n in prop_oneof![Just([0.5, 0.25]), numbers()],
        stiffness_n_per_m in prop_oneof![Just([90.0, 0.0]), numbers()],
        (axial_n, punctured_n) in (any_number(), any_number()),
        (hold_n, puncture_n) in prop_oneof![Just((0.0, 1e4)), (any_number(), any_number())],
    ) -> Needle {
        let ([a, b, c], [d, e, f]) = (linear, angular);
        Needle {
            tool, needle, slide: [a, b, c, d, e, f], tip, friction, axial_n,
            friction_n, stiffness_n_per_m, hold_n, puncture_n, punctured_n, course: Course::default(),
        }
    }
}

prop_compose! {
    fn any_thread()(
        (tool, thread) in (0u8..9, any::<u8>()),
        end in prop_oneof![Just(End::Tail), Just(End::Head)],
        state in prop_oneof![Just(Tension::Slack), Just(Tension::Taut), Just(Tension::Strained)],
        direction in any_unit(),
        (tension_n, stiffness_n_per_m) in (prop_oneof![Just(0.0), any_number()], any_number()),
        slack_m in prop_oneof![Just(0.0), any_number()],
    ) -> Thread {
        Thread {
            tool, thread, end, state, direction, tension_n, stiffness_n_per_m, slack_m,
        }
    }
}

prop_compose! {
    fn any_state()(
        (tick, faults) in (any::<u32>(), prop_oneof![Just(0), any::<u16>()]),
        position_m in numbers(),
        orientation in any_unit(),
        velocity_m_per_s in numbers(),
        force_n in numbers(),
        current_a in numbers(),
        mode in prop_oneof![Just(Mode::Boot), Just(Mode::Armed), Just(Mode::Fault)],
        (contact_sequence, contact_age_us, applied_age_us) in any::<(u32, u32, u32)>(),
        (trace_hash, heard_sequence, inputs) in any::<(u64, u32, u8)>(),
        encoder_counts in any::<[i32; 3]>(),
    ) -> State {
        State {
            tick, position_m, orientation, velocity_m_per_s, force_n, current_a, mode, faults,
            contact_sequence, contact_age_us, applied_age_us, trace_hash, encoder_counts, inputs,
            heard_sequence,
        }
    }
}

prop_compose! {
    fn any_hand()(
        (stiffness_n_per_m, damping_n_s_per_m) in (0.0f32..1e3, any_number()),
        start_joint in numbers(),
        count in 0u8..14,
        times in prop_oneof![Just([1.0; WAY_POINTS]), numbers()],
        places in prop_oneof![Just([0.5; WAY_POINTS]), numbers()],
    ) -> HandScript {
        let mut way_points = [WayPoint::default(); WAY_POINTS];
        for (point, (time_s, place)) in way_points.iter_mut().zip(times.into_iter().zip(places)) {
            *point = WayPoint { time_s, position_m: [place; 3] };
        }
        HandScript { stiffness_n_per_m, damping_n_s_per_m, start_joint, count, way_points }
    }
}

fn finite(values: &[f32]) -> bool {
    values.iter().all(|value| value.is_finite())
}

fn length(values: &[f32]) -> f64 {
    let square: f64 = values.iter().map(|value| f64::from(*value).powi(2)).sum();
    square.sqrt()
}

/// What has been promised of every valid message, written down a second time.
fn holds_promises(message: &Checked) -> bool {
    match message {
        Checked::Contact(contact) => {
            let c = contact.body();
            finite(&c.wrench)
                && finite(&c.tangent)
                && finite(&c.position_m)
                && c.gap_m >= 0.0
                && c.gap_m.is_finite()
                && c.relaxation_per_s >= 0.0
                && c.relaxation_per_s.is_finite()
                && (length(&c.normal) - 1.0).abs() < 1e-3
                && (length(&c.orientation) - 1.0).abs() < 1e-3
                && c.tool < 8
        }
        Checked::Needle(needle) => {
            let n = needle.body();
            let bends = length(&n.slide[3..]) > 0.0;
            let magnitudes = [n.friction_n, n.stiffness_n_per_m, [n.hold_n, n.puncture_n]];
            finite(&n.slide)
                && (bends || (length(&n.slide) - 1.0).abs() < 1e-3)
                && finite(&[n.axial_n, n.punctured_n])
                && magnitudes
                    .iter()
                    .flatten()
                    .all(|x| x.is_finite() && *x >= 0.0)
                && n.tool < 8
        }
        Checked::Thread(thread) => {
            let t = thread.body();
            let numbers = [t.tension_n, t.stiffness_n_per_m, t.slack_m];
            (length(&t.direction) - 1.0).abs() < 1e-3
                && numbers.iter().all(|x| x.is_finite() && *x >= 0.0)
                && (t.tension_n == 0.0 || t.slack_m == 0.0)
                && t.tool < 8
        }
        Checked::State(state) => {
            let s = state.body();
            finite(&s.position_m)
                && finite(&s.velocity_m_per_s)
                && finite(&s.force_n)
                && finite(&s.current_a)
                && (length(&s.orientation) - 1.0).abs() < 1e-3
        }
        Checked::Simulate(simulate) => match simulate.body() {
            Simulate::Hand(h) => {
                let used = &h.way_points[..usize::from(h.count)];
                !used.is_empty()
                    && used.windows(2).all(|w| w[0].time_s <= w[1].time_s)
                    && h.stiffness_n_per_m >= 0.0
                    && h.damping_n_s_per_m >= 0.0
                    && finite(&h.start_joint)
                    && h.way_points.iter().all(|p| finite(&p.position_m))
            }
            _ => true,
        },
        _ => true,
    }
}

/// Sends a message as bytes; what comes out valid is what went in, bit by bit, and holds its promises.
fn survives(bytes: &[u8]) -> Result<(), TestCaseError> {
    let read = unpack_one(bytes).map_err(|reject| TestCaseError::fail(reject.to_string()))?;
    prop_assert_eq!(encode_again(&read), bytes);
    if let Ok(valid) = validate_either(read) {
        prop_assert!(holds_promises(&valid), "{:?}", valid);
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(4000))]

    #[test]
    fn contacts_arrive_as_sent_or_not_at_all(body in any_contact(), head in any::<(u32, u32, u64)>()) {
        survives(&frame(head.0, head.1, head.2, &body))?;
    }

    #[test]
    fn needles_arrive_as_sent_or_not_at_all(body in any_needle(), head in any::<(u32, u32, u64)>()) {
        survives(&frame(head.0, head.1, head.2, &body))?;
    }

    #[test]
    fn threads_arrive_as_sent_or_not_at_all(body in any_thread(), head in any::<(u32, u32, u64)>()) {
        survives(&frame(head.0, head.1, head.2, &body))?;
    }

    #[test]
    fn states_arrive_as_sent_or_not_at_all(body in any_state(), head in any::<(u32, u32, u64)>()) {
        survives(&frame(head.0, head.1, head.2, &body))?;
    }

    #[test]
    fn hands_arrive_as_sent_or_not_at_all(body in any_hand(), head in any::<(u32, u32, u64)>()) {
        survives(&frame(head.0, head.1, head.2, &Simulate::Hand(body)))?;
    }

    #[test]
    fn reports_and_hellos_arrive_as_sent(
        counts in any::<[u32; 10]>(),
        bytes in any::<[u8; 3]>(),
        (schema_hash, tick_hz, max_frame, simulated) in any::<(u64, u16, u16, bool)>(),
        device_name in any::<[u8; 16]>(),
    ) {
        let [ticks, tick_overruns, ticks_late, frames_received, frames_lost, frames_rejected,
            frames_superseded, epitaph_place, stack_free_bytes, tick_cost_max] = counts;
        let [last_reject, reset_cause, epitaph_kind] = bytes;
        survives(&frame(1, 2, 3, &Report {
            ticks, tick_overruns, ticks_late, frames_received, frames_lost, frames_rejected,
            frames_superseded, epitaph_place, stack_free_bytes, tick_cost_max, last_reject,
            reset_cause, epitaph_kind,
        }))?;
        survives(&frame(0, 0, 3, &Hello {
            schema_hash, nonce: ticks, session: frames_lost, tick_hz, max_frame, simulated, device_name,
            refusal: Refusal::None,
        }))?;
        survives(&frame(1, 2, 3, &Ping { host_us: schema_hash }))?;
        survives(&frame(1, 2, 3, &Pong {
            host_us: schema_hash, received_us: schema_hash, sent_us: schema_hash,
        }))?;
    }
}

/// The strategies above do produce valid messages: else they would test nothing.
#[test]
fn many_of_the_random_messages_are_valid() {
    use proptest::{strategy::ValueTree, test_runner::TestRunner};
    let mut runner = TestRunner::deterministic();
    let mut share = |valid: &mut dyn FnMut(&mut TestRunner) -> bool| {
        (0..1000).filter(|_| valid(&mut runner)).count()
    };
    let contacts = share(&mut |r| verdict(any_contact().new_tree(r).unwrap().current()).is_ok());
    let states = share(&mut |r| verdict(any_state().new_tree(r).unwrap().current()).is_ok());
    let hands =
        share(&mut |r| verdict(Simulate::Hand(any_hand().new_tree(r).unwrap().current())).is_ok());
    let needles = share(&mut |r| verdict(any_needle().new_tree(r).unwrap().current()).is_ok());
    let threads = share(&mut |r| verdict(any_thread().new_tree(r).unwrap().current()).is_ok());
    for share in [contacts, states, hands, needles, threads] {
        assert!((20..900).contains(&share), "{share} of 1000 are valid");
    }
}
