//! A tool's rows as the wire carries them: f32, and delta as it would be without forces.
//!
//! Entry point: [`rows_frame`].

use super::contact_frame::GRIP;
use super::pack_symmetric;
use crate::step::{ToolRowKind, ToolRows};
use sutura_shared::wire::message::{Row, RowKind, Rows};
use sutura_shared::wire::{List, Message};

/// The frame of a tool's rows; none if there are none, or if the console would not take them (a compliance without
/// an end, or none at all): then it has the tangent.
pub fn rows_frame(rows: &ToolRows) -> Option<Rows> {
    let count = rows.count;
    let row = |i: usize| {
        let by_forces = (0..count).map(|j| rows.compliance_between(i, j) * rows.lambda_n[j]);
        Row {
            kind: match rows.kind[i] {
                ToolRowKind::Smooth => RowKind::Smooth { id: rows.id[i] },
                ToolRowKind::Normal { friction } => RowKind::Normal {
                    id: rows.id[i],
                    friction: friction as f32,
                },
                ToolRowKind::Tangent => RowKind::Tangent {
                    anchor_m: rows.slip_m[i] as f32,
                },
            },
            delta_free_m: (rows.delta_m[i] + rows.slip_m[i] - by_forces.sum::<f64>()) as f32,
            lambda_n: rows.lambda_n[i] as f32,
            jacobian: rows.jacobian[i].map(|entry| entry as f32),
        }
    };
    let entries = &rows.compliance[..count * (count + 1) / 2];
    let frame = Rows {
        tool: GRIP,
        held: pack_symmetric(&rows.held),
        curvature_per_m: rows.curvature_per_m as f32,
        rows: List::of((0..count).map(row)),
        compliance: List::of(entries.iter().map(|entry| *entry as f32)),
    };
    (count > 0 && frame.check().is_ok()).then_some(frame)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two nodes, one that bears 2 N and one 1 mm away.
    fn two() -> ToolRows {
        let mut rows = ToolRows::NONE;
        rows.tool = 3;
        rows.count = 2;
        rows.id[..2].copy_from_slice(&[71, 12]);
        rows.delta_m[1] = 1e-3;
        rows.lambda_n[0] = 2.0;
        rows.compliance[..3].copy_from_slice(&[0.02, 0.01, 0.03]);
        rows.jacobian[0] = [0.0, 0.0, 1.0, 0.1, 0.2, 0.0];
        rows.jacobian[1] = [0.0, 0.6, 0.8, 0.0, 0.0, 0.5];
        rows.curvature_per_m = 80.0;
        rows.held[0][1] = 4.0;
        rows.held[1][0] = 4.0;
        rows
    }

    #[test]
    fn delta_is_that_without_forces() {
        let frame = rows_frame(&two()).expect("valid");
        let [first, second] = frame.rows.items() else {
            panic!("two rows: {frame:?}");
        };
        assert_eq!(frame.tool, GRIP);
        assert_eq!(
            (first.kind, first.lambda_n),
            (RowKind::Smooth { id: 71 }, 2.0)
        );
        // 0 - 0.02 * 2, and 1 mm - 0.01 * 2.
        assert_eq!((first.delta_free_m, second.delta_free_m), (-0.04, -0.019));
        assert_eq!(second.jacobian, [0.0, 0.6, 0.8, 0.0, 0.0, 0.5]);
        assert_eq!(frame.compliance.items(), [0.02, 0.01, 0.03]);
        assert_eq!((frame.held[1], frame.curvature_per_m), (4.0, 80.0));
    }

    #[test]
    fn what_the_console_would_refuse_is_not_sent() {
        assert_eq!(rows_frame(&ToolRows::NONE), None);
        let mut endless = two();
        endless.compliance[0] = f64::INFINITY;
        assert_eq!(rows_frame(&endless), None);
        let mut stiff = two();
        stiff.compliance[2] = 0.0;
        assert_eq!(rows_frame(&stiff), None);
        let mut nonsense = two();
        nonsense.held[2][2] = f64::NAN;
        assert_eq!(rows_frame(&nonsense), None);
    }
}
