//! Contact rows that a console takes, and rows that it refuses.

use crate::common;
use crate::common::{frame, golden_rows, rows::wild, rows_in, sample, verdict};
use proptest::prelude::*;
use sutura_shared::wire::message::{Row, RowKind, Rows};
use sutura_shared::wire::{List, MAX_FRAME, Reject};

/// The sample with one thing changed.
fn with(change: impl FnOnce(&mut Rows)) -> Result<(), Reject> {
    let mut rows = sample::rows();
    change(&mut rows);
    verdict(rows)
}

/// Numbers that are just right, just too large, and no numbers.
#[track_caller]
fn check_limits(field: fn(&mut Rows) -> &mut f32, low: f32, high: f32) {
    let at = |value| with(|rows| *field(rows) = value);
    let beyond = |x: f32| f32::from_bits(x.to_bits() + 1);
    assert_eq!((at(low), at(high)), (Ok(()), Ok(())), "{low} {high}");
    let below = if low == 0.0 { -1e-30 } else { beyond(low) };
    assert_eq!(at(below), Err(Reject::Range), "{below}");
    assert_eq!(at(beyond(high)), Err(Reject::Range), "beyond {high}");
    for value in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        assert_eq!(at(value), Err(Reject::NotFinite), "{value}");
    }
}

#[test]
fn every_number_has_its_limits() {
    assert_eq!(verdict(sample::rows()), Ok(()));
    assert_eq!(with(|rows| rows.tool = 8), Err(Reject::Range));
    check_limits(|rows| &mut rows.held[20], -1e7, 1e7);
    check_limits(|rows| &mut rows.curvature_per_m, 0.0, 1e4);
    check_limits(
        |rows| &mut rows.rows.items_mut()[2].delta_free_m,
        -10.0,
        10.0,
    );
    check_limits(|rows| &mut rows.rows.items_mut()[2].jacobian[5], -1e3, 1e3);
    check_limits(|rows| &mut rows.rows.items_mut()[0].lambda_n, 0.0, 1e4);
    check_limits(|rows| &mut rows.rows.items_mut()[1].lambda_n, 0.0, 1e4);
    check_limits(|rows| &mut rows.rows.items_mut()[3].lambda_n, -1e4, 1e4);
    fn anchor(rows: &mut Rows) -> &mut f32 {
        match &mut rows.rows.items_mut()[3].kind {
            RowKind::Tangent { anchor_m } => anchor_m,
            other => panic!("{other:?}"),
        }
    }
    check_limits(anchor, -10.0, 10.0);
}

#[test]
fn friction_is_neither_nothing_nor_endless() {
    let friction = |value| {
        with(|rows| {
            rows.rows.items_mut()[1].kind = RowKind::Normal {
                id: 1,
                friction: value,
            }
        })
    };
    assert_eq!((friction(1e-6), friction(10.0)), (Ok(()), Ok(())));
    for value in [0.0, -0.5, 10.1] {
        assert_eq!(friction(value), Err(Reject::Range), "{value}");
    }
    assert_eq!(friction(f32::NAN), Err(Reject::NotFinite));
}

/// W of the sample: rows of 4, 3, 2 and 1 entries.
#[test]
fn a_compliance_is_one() {
    let entry = |index: usize, value| with(|rows| rows.compliance.items_mut()[index] = value);
    for diagonal in [0, 4, 7, 9] {
        for value in [0.0, -1.0, 0.9e-7, 1.1e4] {
            assert_eq!(entry(diagonal, value), Err(Reject::Range), "{value}");
        }
        assert_eq!(entry(diagonal, f32::NAN), Err(Reject::NotFinite));
    }
    assert_eq!(entry(9, 1e4), Ok(()));
    // Of rows 0 and 2: at most sqrt(0.5 * 1.0).
    for sign in [1.0, -1.0] {
        assert_eq!(entry(2, sign * 0.707_05), Ok(()));
        assert_eq!(entry(2, sign * 0.707_2), Err(Reject::Range));
        // Of rows 2 and 3: sqrt(1 * 2).
        assert_eq!(entry(8, sign * 1.414), Ok(()));
        assert_eq!(entry(8, sign * 1.415), Err(Reject::Range));
    }
    let short = with(|rows| rows.compliance = List::of([0.5; 9]));
    assert_eq!(short, Err(Reject::Range));
    let long = with(|rows| rows.compliance = List::of([0.5; 11]));
    assert_eq!(long, Err(Reject::Range));
    let none = with(|rows| {
        rows.rows = List::new();
        rows.compliance = List::new();
    });
    assert_eq!(none, Ok(()));
}

#[test]
fn rows_of_a_contact_belong_together() {
    let [smooth, normal, tangent, other] = *sample::rows().rows.items() else {
        panic!("four rows");
    };
    let order = |rows: &[Row]| {
        let mut body = sample::rows();
        body.rows = List::of(rows.iter().copied());
        body.compliance = List::new();
        for i in 0..rows.len() {
            body.compliance.push(1.0);
            (i + 1..rows.len()).for_each(|_| assert!(body.compliance.push(0.0)));
        }
        verdict(body)
    };
    let refused = Err(Reject::Range);
    assert_eq!(order(&[smooth, normal, tangent, other]), Ok(()));
    assert_eq!(order(&[normal, tangent, other, smooth]), Ok(()));
    assert_eq!(order(&[smooth]), Ok(()));
    assert_eq!(order(&[tangent]), refused, "no normal");
    assert_eq!(order(&[normal, tangent]), refused, "one tangent");
    assert_eq!(order(&[normal]), refused, "no tangent");
    assert_eq!(order(&[normal, tangent, smooth]), refused, "torn apart");
    assert_eq!(order(&[normal, tangent, other, other]), refused, "three");
    assert_eq!(order(&[smooth, tangent, other]), refused, "smooth has none");
    // A name is used once, by whatever kind.
    assert_eq!(order(&[smooth, smooth]), refused);
    let again = Row {
        kind: RowKind::Smooth { id: 70_000 },
        ..smooth
    };
    assert_eq!(order(&[normal, tangent, other, again]), refused);
}

/// From `tests/golden/frames.py`, which shares no code with this crate. Then every byte of it changed, and every
/// one left out.
#[test]
fn the_frame_is_that_of_the_independent_encoder_and_no_other_is_taken() {
    let bytes = golden_rows();
    let ours = frame(0x00c0_ffee, 14, 123_423_000, &sample::rows());
    assert_eq!(common::hex_of(&ours), common::hex_of(&bytes));
    let read = rows_in(&bytes);
    let [Ok(rows)] = &read[..] else {
        panic!("{read:?}")
    };
    assert_eq!(*rows.body(), sample::rows());
    for place in 0..bytes.len() {
        for flip in 1..=255 {
            let mut changed = bytes.clone();
            changed[place] ^= flip;
            changed.push(0);
            assert!(rows_in(&changed).iter().all(Result::is_err), "{place}");
        }
        let missing = [&bytes[..place], &bytes[place + 1..]].concat();
        assert!(rows_in(&missing).iter().all(Result::is_err), "{place}");
    }
    // The other way does not know them, and this one knows nothing else.
    assert_eq!(common::unpack_all(&bytes)[..], [Err(Reject::Kind)]);
    let contact = frame(1, 1, 0, &sample::contact());
    assert_eq!(rows_in(&contact)[..], [Err(Reject::Kind)]);
    let state = frame(1, 1, 0, &sample::state());
    assert_eq!(rows_in(&state)[..], [Err(Reject::Direction)]);
}

/// 24 smooth rows of nodes below two million: what a host sends.
#[test]
fn a_full_frame_is_35_packets_of_usb() {
    let rows = |n: usize, cones| {
        let numbers = vec![[0.3; 8]; n];
        frame(
            1,
            u32::MAX,
            u64::MAX,
            &wild(&numbers, cones, &[0.123; 300], 0),
        )
    };
    let full = rows(24, 0).len();
    println!(
        "24 smooth rows: {full} bytes; 8 cones: {} bytes",
        rows(24, 8).len()
    );
    assert!(full <= 35 * 64 && rows(24, 8).len() <= 35 * 64);
    assert!(rows(12, 0).len() < 900 && rows(1, 0).len() < 160);
    assert!(full <= MAX_FRAME);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(500))]

    #[test]
    fn rows_arrive_as_sent_or_not_at_all(
        numbers in prop::collection::vec(prop::array::uniform8(-1.0f32..1.0), 0..=24),
        cones in 0usize..=8,
        entries in prop::collection::vec(-1.0f32..1.0, 300),
        exponent in -7i32..=4,
        (place, bits) in (0usize..2200, any::<u32>()),
        head in any::<(u32, u32, u64)>(),
    ) {
        let cones = cones.min(numbers.len() / 3);
        let mut body = wild(&numbers, cones, &entries, exponent);
        let bytes = frame(head.0, head.1, head.2, &body);
        let read = rows_in(&bytes);
        let [Ok(rows)] = &read[..] else { panic!("{read:?}") };
        prop_assert_eq!(rows.body(), &body);
        prop_assert_eq!((rows.sequence(), rows.console_time_us()), (head.1, head.2));
        prop_assert_eq!(frame(head.0, head.1, head.2, rows.body()), bytes);
        // Any bits in the place of one number: refused, or still a problem that can be solved.
        let value = f32::from_bits(bits);
        let count = body.compliance.items().len();
        if count > 0 {
            body.compliance.items_mut()[place % count] = value;
            if verdict(body).is_ok() {
                let rows = sutura_shared::control::ContactRows::unpack(&common::rows::frame(1, body));
                let force = { rows }.solve(&[1e-3; 6]);
                prop_assert!(force.change.iter().all(|x| x.is_finite()));
            }
        }
    }
}
