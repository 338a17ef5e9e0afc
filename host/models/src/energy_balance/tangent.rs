//! Stiffness of held nodes by small trial steps.
//!
//! Entry point: [`secant`]. Each axis is tried both ways from the same state, so that what the state itself still
//! has to settle cancels. The error is what a second run of the same length changes, and how far the matrix
//! is from symmetric, which it would be in balance. [`crate::secant`] takes whole steps instead: its error is that of a
//! curved force, and would miss how far iterations stop from balance.

use super::{EnergyBalance, Form, Trial};
use crate::{BoundaryConditions, Tangent};
use nalgebra::{Matrix3, Vector3};

/// A trial step as a share of a cell's edge: 1 % strain of one cell, far above single precision's noise.
const TRIAL: f64 = 0.01;

/// `None` for the printed forms, which have no balance to speak of, and where a trial does not stay finite.
pub(super) fn secant(
    model: &mut EnergyBalance,
    drive: &BoundaryConditions<'_>,
    moved: &[usize],
    step_s: f64,
) -> Option<Tangent> {
    let printed = matches!(model.settings.form, Form::Printed | Form::Averaged);
    let unknown = moved.iter().any(|index| *index >= drive.held.len());
    if printed || unknown || model.objection(drive, step_s).is_some() {
        return None;
    }
    model.remember();
    let found = trials(model, drive, moved, step_s);
    model.go_back();
    let [first, second] = found?;
    let size = second.norm().max(f64::MIN_POSITIVE);
    let error = ((second - first).norm() + (second - second.transpose()).norm()) / size;
    error.is_finite().then(|| Tangent {
        stiffness_n_per_m: [0, 1, 2].map(|r| [0, 1, 2].map(|c| second[(r, c)])),
        error,
    })
}

/// The stiffness after one run of each trial, and after two; none unless all numbers are finite.
fn trials(
    model: &mut EnergyBalance,
    drive: &BoundaryConditions<'_>,
    moved: &[usize],
    step_s: f64,
) -> Option<[Matrix3<f64>; 2]> {
    let mut found = [Matrix3::zeros(); 2];
    let step_m = TRIAL * model.edge_m;
    for axis in 0..3 {
        for way in [-1.0, 1.0] {
            let mut by_m = [0.0; 3];
            by_m[axis] = way * step_m;
            for matrix in &mut found {
                let (_, finite) = model.advance(drive, step_s, Some(Trial { moved, by_m }));
                if !finite {
                    return None;
                }
                let mut sum = Vector3::zeros();
                for index in moved {
                    let node = drive.held[*index].0 as usize;
                    sum += Vector3::from(model.gradient_n[node]);
                }
                let column = matrix.column(axis) + sum * (way / (2.0 * step_m));
                matrix.set_column(axis, &column);
                if model.settings.motion == super::Motion::Dynamic {
                    // A second time step would be another question.
                    model.go_back();
                }
            }
            model.go_back();
        }
    }
    Some(found)
}
