//! Contact rows on the console against contacts whose forces are known.

use crate::common;
use crate::common::rows::{Contact3, cone, frame, smooth};
use proptest::prelude::*;
use sutura_shared::control::{ContactRows, Fresh};
use sutura_shared::math::max;
use sutura_shared::wire::message::{RowKind, Rows};
use sutura_shared::wire::{List, Valid, ValidContact};

/// Solved for this console time \[us\].
const SOLVED: u64 = 1_000_000;

fn at(x: f32, y: f32, z: f32) -> [f32; 6] {
    [x, y, z, 0.0, 0.0, 0.0]
}

/// Wrench of rows whose frame's wrench is that of its multipliers.
fn force(rows: &mut ContactRows, body: &Rows, dx: &[f32; 6]) -> [f32; 3] {
    let solved = rows.solve(dx);
    assert!(solved.residual < 1e-4, "{}", solved.residual);
    let mut force = [0.0; 3];
    for (axis, sum) in force.iter_mut().enumerate() {
        *sum = solved.change[axis];
        for row in body.rows.items() {
            *sum += row.jacobian[axis] * row.lambda_n;
        }
    }
    force
}

fn assert_near(found: [f32; 3], expected: [f32; 3], tolerance: f32, what: &str) {
    for (found, expected) in found.into_iter().zip(expected) {
        assert!(
            (found - expected).abs() <= tolerance,
            "{what}: {found} {expected}"
        );
    }
}

#[test]
fn a_smooth_wall_pushes_as_deep_as_it_is_pressed() {
    // 500 N/m behind z = 0, solved 1 mm above it.
    let body = smooth(7, 1.0 / 500.0, 1e-3);
    let mut rows = ContactRows::unpack(&frame(SOLVED, body));
    for (z, push) in [
        (0.0, 0.0),
        (-1e-3, 0.0),
        (-3e-3, 1.0),
        (-2e-3, 0.5),
        (1e-3, 0.0),
        (-5e-3, 2.0),
    ] {
        let found = force(&mut rows, &body, &at(0.1, 0.0, z));
        assert_near(found, [0.0, 0.0, push], 1e-5, "wall");
    }
}

/// What is held: M dx, next to the rows.
#[test]
fn held_stiffness_acts_besides_the_rows() {
    let mut body = smooth(7, 1.0 / 500.0, 1e-3);
    body.held = core::array::from_fn(|k| k as f32);
    let mut rows = ContactRows::unpack(&frame(SOLVED, body));
    let change = rows.solve(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]).change;
    // Rows of the packed triangle: 0 to 5, 6 to 10, 11 to 14, 15 to 17, 18 19, 20.
    assert_eq!(change, [70.0, 171.0, 246.0, 297.0, 329.0, 350.0]);
}

/// A point on a plane of 1000 N/m across and 400 N/m along: elastic up to the cone, then it slips at
/// `friction N`, and reversed it unloads elastically from there. All of it by hand.
#[test]
fn a_point_on_a_coulomb_plane_sticks_slips_and_reverses() {
    let contact = Contact3 {
        normal: 1000.0,
        along: 400.0,
        friction: 0.5,
    };
    let body = cone(3, &contact, -2e-3);
    let mut rows = ContactRows::unpack(&frame(SOLVED, body));
    // 2 N across: slips at 1 N, after 2.5 mm.
    let mut drag = |x: f32, expected: f32| {
        let found = force(&mut rows, &body, &at(x, 0.0, 0.0));
        assert_near(found, [expected, 0.0, 2.0], 2e-4, &format!("{x} m"));
    };
    for step in 0..=25 {
        let x = step as f32 * 1e-4;
        drag(x, -400.0 * x);
    }
    for step in 26..=60 {
        drag(step as f32 * 1e-4, -1.0);
    }
    // Back: 5 mm from one limit to the other.
    for step in (10..=60).rev() {
        let x = step as f32 * 1e-4;
        drag(x, -1.0 + 400.0 * (6e-3 - x));
    }
    for step in (-20..10).rev() {
        drag(step as f32 * 1e-4, 1.0);
    }
}

/// Lifting takes the cone away, and what touches again sticks where it touches.
#[test]
fn lifting_forgets_where_it_stuck() {
    let contact = Contact3 {
        normal: 1000.0,
        along: 400.0,
        friction: 0.5,
    };
    let body = cone(3, &contact, -2e-3);
    let mut rows = ContactRows::unpack(&frame(SOLVED, body));
    let mut go = |x, y, z| force(&mut rows, &body, &at(x, y, z));
    assert_near(go(1e-3, 0.0, 0.0), [-0.4, 0.0, 2.0], 1e-4, "sticks");
    // Half as deep, half the cone: 0.5 N is still more than 0.4 N.
    assert_near(go(1e-3, 0.0, 1e-3), [-0.4, 0.0, 1.0], 1e-4, "less");
    assert_near(go(1e-3, 0.0, 1.6e-3), [-0.2, 0.0, 0.4], 1e-4, "slips");
    assert_near(go(1e-3, 0.0, 3e-3), [0.0; 3], 1e-6, "open");
    assert_near(go(9e-3, 1e-3, 3e-3), [0.0; 3], 1e-6, "elsewhere");
    assert_near(go(9e-3, 1e-3, 0.0), [0.0, 0.0, 2.0], 1e-4, "down");
    assert_near(go(9e-3, 2e-3, 0.0), [0.0, -0.4, 2.0], 1e-4, "sticks again");
}

/// On a circle the force turns until it is against the motion.
#[test]
fn slip_is_opposed_whatever_its_direction() {
    let contact = Contact3 {
        normal: 1000.0,
        along: 400.0,
        friction: 0.5,
    };
    let body = cone(3, &contact, -2e-3);
    let mut rows = ContactRows::unpack(&frame(SOLVED, body));
    for step in 0..2000_u16 {
        let angle = 1e-3 * f64::from(step);
        let (s, c) = (angle.sin() as f32, angle.cos() as f32);
        let [x, y, z] = force(&mut rows, &body, &at(0.1 * c - 0.1, 0.1 * s, 0.0));
        assert!((z - 2.0).abs() < 1e-4);
        if step > 500 {
            // Relative slip lags the turn by the elastic way, 2.5 mm of the circle's 100 mm.
            let against = x * s - y * c;
            assert!(against > 0.9995, "{step}: {x} {y}");
        }
    }
}

#[test]
fn multipliers_carry_over_by_id_and_new_ids_start_at_the_hosts() {
    // Two walls that do not couple; the host thinks the second one bears 3 N.
    let two = |ids: [u32; 2]| {
        let mut body = smooth(ids[0], 1.0 / 500.0, 1e-3);
        let mut second = smooth(ids[1], 1.0 / 500.0, 1e-3).rows.items()[0];
        second.lambda_n = 3.0;
        assert!(body.rows.push(second));
        body.compliance = List::of([1.0 / 500.0, 0.0, 1.0 / 500.0]);
        frame(SOLVED, body)
    };
    let down = at(0.0, 0.0, -2e-3);
    let mut old = ContactRows::unpack(&two([7, 8]));
    old.solve(&down);
    let mut new = ContactRows::unpack(&two([8, 9]));
    new.adopt(&old);
    // Nothing to see of the multipliers but through the first solve, which is exact without coupling.
    assert_eq!(new.multipliers_n().collect::<Vec<_>>(), [0.5, 3.0]);
}

/// Eight vertices in a row under a ball, shared among so many rows, in equilibrium: each bears 0.3 N and pulls its neighbours along.
fn patch(rows: usize) -> Rows {
    const VERTICES: usize = 8;
    let each = VERTICES / rows;
    let place = |vertex: usize| vertex as f32 - 3.5;
    let share = 1.0 / each as f32;
    let of = |row: usize| row * each..(row + 1) * each;
    let coupling = |i: usize, j: usize| {
        let pairs = of(i).flat_map(|a| of(j).map(move |b| (a, b)));
        let ways = pairs.map(|(a, b)| {
            let own = if a == b { 0.2e-3 } else { 0.0 };
            own + 2e-3 / (1.0 + 0.1 * (place(a) - place(b)).abs())
        });
        ways.sum::<f32>() * share * share
    };
    let mut body = smooth(0, 1.0, 0.0);
    let like = body.rows.items()[0];
    body.rows = List::default();
    body.compliance = List::default();
    for i in 0..rows {
        let mut row = like;
        row.kind = RowKind::Smooth {
            id: of(i).start as u32,
        };
        row.lambda_n = 0.3 * each as f32;
        row.jacobian = [0.0; 6];
        for vertex in of(i) {
            let (x, length) = (
                0.1 * place(vertex),
                (1.0 + 0.01 * place(vertex) * place(vertex)).sqrt(),
            );
            row.jacobian[0] += share * x / length;
            row.jacobian[2] += share / length;
        }
        row.delta_free_m = -(0..rows).map(|j| coupling(i, j)).sum::<f32>() * row.lambda_n;
        assert!(body.rows.push(row));
        for j in i..rows {
            assert!(body.compliance.push(coupling(i, j)));
        }
    }
    body
}

/// A frame that shares its rows among vertices in another way has other multipliers for the same force: where it was solved for,
/// the force is the host's in the first tick.
#[test]
fn rows_that_are_shared_in_another_way_push_as_before() {
    let still = at(0.0, 0.0, 0.0);
    for (before, now) in [(4, 8), (8, 4), (2, 8), (8, 2)] {
        let mut old = ContactRows::unpack(&frame(SOLVED, patch(before)));
        old.solve(&still);
        let body = patch(now);
        let mut new = ContactRows::unpack(&frame(SOLVED + 16_000, body));
        new.adopt(&old);
        let [x, _, z] = force(&mut new, &body, &still);
        assert!(
            x.abs() < 1e-3 && (z - 2.4).abs() < 0.1,
            "{before} {now}: {x} {z}"
        );
    }
}

/// Solved ahead, 4 mm from where it stuck, of which it slipped 1.5 mm; and no force is known of the frame before.
fn foretold() -> (Rows, ContactRows) {
    let contact = Contact3 {
        normal: 1000.0,
        along: 400.0,
        friction: 0.5,
    };
    let mut body = cone(3, &contact, -2e-3);
    for row in body.rows.items_mut() {
        let along = row.jacobian[0] * 4e-3;
        row.delta_free_m += along;
        if let RowKind::Tangent { anchor_m } = &mut row.kind {
            *anchor_m = along * 1.5 / 4.0;
            row.lambda_n = -400.0 * (along - *anchor_m);
        }
    }
    (body, ContactRows::unpack(&frame(SOLVED, body)))
}

/// The host foresaw a slip to 4 mm; the grip came to 3 mm and turned: it slips there, and unloads on the way back.
#[test]
fn what_was_foretold_slips_no_farther_than_the_grip_came() {
    let (body, fresh) = foretold();
    let mut rows = ContactRows::NONE;
    rows.replace(&fresh, |along| {
        assert_eq!((along.x, along.y, along.z), (1.0, 0.0, 0.0));
        -1e-3
    });
    let turned = force(&mut rows, &body, &at(-1e-3, 0.0, 0.0));
    assert_near(turned, [-1.0, 0.0, 2.0], 2e-4, "slips where it turned");
    let back = force(&mut rows, &body, &at(-2e-3, 0.0, 0.0));
    assert_near(back, [-0.6, 0.0, 2.0], 2e-4, "and sticks from there");
    // Turned before it slipped at all: no more is taken back than there was.
    let (body, fresh) = foretold();
    rows.replace(&fresh, |_| -3.5e-3);
    let early = force(&mut rows, &body, &at(-3.5e-3, 0.0, 0.0));
    assert_near(early, [-0.2, 0.0, 2.0], 2e-4, "has not slipped");
}

/// What came as far as it was foretold, or farther, is what the frame says.
#[test]
fn a_grip_that_came_as_far_has_the_hosts_anchor() {
    for beyond_m in [0.0, 1e-3] {
        let (body, fresh) = foretold();
        let mut rows = ContactRows::NONE;
        rows.replace(&fresh, |_| beyond_m);
        let here = force(&mut rows, &body, &at(0.0, 0.0, 0.0));
        assert_near(here, [-1.0, 0.0, 2.0], 2e-4, "the frame's");
        let back = force(&mut rows, &body, &at(-1e-3, 0.0, 0.0));
        assert_near(back, [-0.6, 0.0, 2.0], 2e-4, "back");
    }
}

/// What sticks to a ball goes along with it and is no farther from it; what has slid over it is.
#[test]
fn a_round_tool_opens_no_gap_over_what_sticks_to_it() {
    let contact = Contact3 {
        normal: 1000.0,
        along: 400.0,
        friction: 0.5,
    };
    let mut body = cone(3, &contact, -2e-3);
    body.curvature_per_m = 100.0;
    let mut rows = ContactRows::unpack(&frame(SOLVED, body));
    rows.solve(&at(0.0, 0.0, 0.0));
    let stuck = force(&mut rows, &body, &at(2e-3, 0.0, 0.0));
    assert_near(stuck, [-0.8, 0.0, 2.0], 2e-4, "sticks");
    for _ in 0..50 {
        rows.solve(&at(8e-3, 0.0, 0.0));
    }
    let slid = rows.solve(&at(8e-3, 0.0, 0.0)).change[2];
    assert!(slid < -0.5, "{slid}");
}

#[test]
fn rows_go_with_the_contact_of_their_time_only() {
    let body = smooth(7, 1.0 / 500.0, 1e-3);
    let rows = ContactRows::unpack(&frame(SOLVED, body));
    let contact = |time, tool| {
        let mut header = common::header_for::<sutura_shared::wire::message::Contact>();
        header.console_time_us = time;
        let body = sutura_shared::wire::message::Contact {
            tool,
            ..common::sample::contact()
        };
        let contact: ValidContact = Valid::new(header, body).expect("valid");
        contact
    };
    assert_eq!(Fresh::of(contact(SOLVED, 0), &rows).rows, rows);
    // The rows of the next contact were lost.
    assert!(Fresh::of(contact(SOLVED + 1000, 0), &rows).rows.is_empty());
    assert!(Fresh::of(contact(SOLVED, 1), &rows).rows.is_empty());
    assert!(Fresh::of(contact(0, 0), &ContactRows::NONE).rows.is_empty());
}

#[test]
fn a_pose_that_is_no_pose_changes_nothing() {
    let body = smooth(7, 1.0 / 500.0, 1e-3);
    let mut rows = ContactRows::unpack(&frame(SOLVED, body));
    rows.solve(&at(0.0, 0.0, -2e-3));
    let before = rows;
    for wrong in [f32::NAN, f32::INFINITY, -1e30] {
        let solved = rows.solve(&at(0.0, wrong, 0.0));
        assert_eq!(solved.residual, f32::MAX);
        assert_eq!(solved.change, [0.0; 6]);
        assert_eq!(rows, before);
    }
}

fn any_row_numbers() -> impl Strategy<Value = [f32; 8]> {
    prop::array::uniform8(-1.0f32..1.0)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(500))]

    /// Whatever validates, positive definite or not, is solved to finite forces, tick after tick.
    #[test]
    fn any_valid_rows_give_finite_forces(
        rows in prop::collection::vec(any_row_numbers(), 24),
        cones in 0usize..=8,
        entries in prop::collection::vec(-1.0f32..1.0, 300),
        exponent in -7i32..=4,
        reach in prop_oneof![Just(1e-3f32), Just(10.0)],
        ways in prop::collection::vec(prop::array::uniform6(-1.0f32..1.0), 1..30),
    ) {
        let body = common::rows::wild(&rows, cones, &entries, exponent);
        let mut solved = ContactRows::unpack(&frame(SOLVED, body));
        for (tick, way) in (1u64..).zip(ways) {
            let dx = way.map(|way| way * reach);
            let now_us = SOLVED + 1000 * tick;
            let force = solved.solve(&dx);
            prop_assert!(force.residual >= 0.0 && force.residual.is_finite());
            prop_assert!(force.change.iter().all(|x| x.is_finite()), "{:?}", force);
            solved.replace(&ContactRows::unpack(&frame(now_us, body)), |_| -1e-3);
        }
        let multipliers: Vec<_> = solved.multipliers_n().collect();
        for (row, lambda) in body.rows.items().iter().zip(multipliers) {
            prop_assert!(lambda.abs() <= 1.001e5, "{lambda}");
            if !matches!(row.kind, RowKind::Tangent { .. }) {
                prop_assert!(lambda >= 0.0);
            }
        }
    }
}

/// A ball of 10 mm that rolls off a bump, seen from a frame in which it touches: the gap is that of circles.
#[test]
fn a_round_tool_opens_its_gaps_as_it_moves_aside() {
    let mut body = smooth(7, 1.0 / 500.0, -2e-3);
    body.rows.items_mut()[0].lambda_n = 1.0;
    body.curvature_per_m = 100.0;
    let mut rows = ContactRows::unpack(&frame(SOLVED, body));
    for (x, z) in [
        (0.0_f32, 0.0_f32),
        (2e-3, 0.0),
        (-3e-3, 1e-3),
        (5e-3, 0.0),
        (8e-3, -1e-3),
    ] {
        let foot = 10e-3 + z;
        let gap = (foot * foot + x * x).sqrt() - 10e-3;
        let push = 500.0 * max(2e-3 - gap, 0.0);
        let found = force(&mut rows, &body, &at(0.0, x, z));
        assert_near(found, [0.0, 0.0, push], 1e-5, "ball");
    }
    // The same vertex, 5 mm away from the ball: 15 mm from its middle.
    let mut near = smooth(7, 1.0 / 500.0, 5e-3);
    near.curvature_per_m = 100.0;
    let mut rows = ContactRows::unpack(&frame(SOLVED, near));
    let gap = (9e-3_f32 * 9e-3 + 3e-3 * 3e-3).sqrt() - 10e-3;
    let found = force(&mut rows, &near, &at(3e-3, 0.0, -6e-3));
    assert_near(found, [0.0, 0.0, -500.0 * gap], 1e-5, "from afar");
}

/// In place or beside: the same rows.
#[test]
fn replaced_rows_are_adopted_ones() {
    let body = common::rows::wild(&[[0.3; 8]; 24], 4, &[0.2; 300], -2);
    let mut old = ContactRows::unpack(&frame(SOLVED, body));
    old.solve(&at(1e-3, 2e-3, -1e-3));
    let fresh = ContactRows::unpack(&frame(SOLVED + 2000, body));
    let here = at(1e-3, 0.0, 0.0);
    let mut adopting = fresh;
    adopting.adopt(&old);
    assert_ne!(adopting, fresh);
    old.replace(&fresh, |_| 0.0);
    assert_eq!(old, adopting);
    old.replace(&ContactRows::NONE, |_| 0.0);
    assert!(old.is_empty());
    let nothing = old.solve(&here);
    assert_eq!((nothing.change, nothing.residual), ([0.0; 6], 0.0));
}
