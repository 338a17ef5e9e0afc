//! What contact rows cost, and how many bytes they are. Entry point: [`all`].

use crate::measure::{Meter, Wire};
use core::hint::black_box;
use sutura_shared::control::ContactRows;
use sutura_shared::math::Vec3;
use sutura_shared::wire::message::{MAX_ROWS, Row, RowKind, Rows};
use sutura_shared::wire::{List, MAX_FRAME};

/// Ticks of a stroke over which the most expensive one is looked for.
const TICKS: u64 = 60;

/// Sizes, the way in, and a tick's work, for 24 smooth rows and for 8 cones.
pub fn all(meter: &mut impl Meter, wire: &mut Wire) {
    for (cones, names) in [(0, SMOOTH_NAMES), (MAX_ROWS / 3, CONES_NAMES)] {
        let body = patch(cones);
        let mut frame = [0; MAX_FRAME];
        let (mut receive, mut solve, mut replace) = (0, 0, 0);
        let mut rows = ContactRows::NONE;
        for tick in 1..=TICKS {
            let now_us = 1000 * tick;
            // Presses by 1.5 mm and back, and strokes sideways: contacts open, stick and slip.
            let press = tick.abs_diff(TICKS / 2) as f32 / 20_000.0 - 1e-3;
            let dx = [tick as f32 * 1e-4, 0.0, press, 0.0, 1e-3, 0.0];
            if tick % 10 == 1 {
                let length = wire.host.send(now_us, &body, &mut frame).unwrap_or(0);
                let mut bytes = &frame[..length];
                receive = receive.max(meter.once(|| {
                    black_box(wire.console.receive(&mut bytes, u64::MAX).is_some());
                }));
                let farthest = |_: &Vec3| -1e-3;
                replace = replace.max(meter.once(|| rows.replace(wire.console.rows(), farthest)));
            }
            solve = solve.max(meter.once(|| {
                black_box(rows.solve(black_box(&dx)));
            }));
        }
        let length = wire.host.send(0, &body, &mut frame).unwrap_or(0);
        meter.line(names.bytes, length as u32);
        meter.line(names.receive, receive);
        meter.line(names.replace, replace);
        meter.line(names.solve, solve);
    }
}

struct Names {
    bytes: &'static str,
    receive: &'static str,
    replace: &'static str,
    solve: &'static str,
}

const SMOOTH_NAMES: Names = Names {
    bytes: "rows24_frame_bytes",
    receive: "rows24_receive_and_unpack",
    replace: "rows24_replace",
    solve: "rows24_solve",
};

const CONES_NAMES: Names = Names {
    bytes: "rows24_cones_frame_bytes",
    receive: "rows24_cones_receive_and_unpack",
    replace: "rows24_cones_replace",
    solve: "rows24_cones_solve",
};

/// A patch under a ball, `cones` of its contacts with friction, 24 rows in all: what is pressed at one place
/// gives way at the others, the less the farther.
pub fn patch(cones: usize) -> Rows {
    let mut rows = List::new();
    let mut compliance = List::new();
    for k in 0..MAX_ROWS {
        let part = if k < 3 * cones { k % 3 } else { 0 };
        let id = 10_000 + k as u32;
        let kind = match part {
            0 if k < 3 * cones => RowKind::Normal { id, friction: 0.4 },
            0 => RowKind::Smooth { id },
            _ => RowKind::Tangent { anchor_m: 0.0 },
        };
        let mut jacobian = [0.0, 0.0, 1.0, 0.01, -0.01, 0.0];
        jacobian.rotate_right(part);
        rows.push(Row {
            kind,
            delta_free_m: if part == 0 {
                1e-4 * k as f32 - 6e-3
            } else {
                0.0
            },
            lambda_n: if part == 0 { 0.02 } else { 0.001 },
            jacobian,
        });
        for j in k..MAX_ROWS {
            compliance.push(0.03 / (1 + j - k) as f32);
        }
    }
    Rows {
        tool: 0,
        held: [1.0; 21],
        curvature_per_m: 100.0,
        rows,
        compliance,
    }
}
