//! What every model asks of a drive before it moves anything.
//!
//! Entry points: [`refused`], and [`wrong`] for models whose steps need no length.

use crate::{BoundaryConditions, Diagnostics, Outcome};

/// Why a step cannot be taken, if it cannot.
pub(crate) fn refused(
    drive: &BoundaryConditions<'_>,
    nodes: usize,
    step_s: f64,
) -> Option<&'static str> {
    if step_s.is_finite() && step_s > 0.0 {
        wrong(drive, nodes)
    } else {
        Some("the time step is not a finite number above zero")
    }
}

/// Why a drive cannot be followed, however long the step, if it cannot.
pub(crate) fn wrong(drive: &BoundaryConditions<'_>, nodes: usize) -> Option<&'static str> {
    let finite = |values: &[f64; 3]| values.iter().all(|value| value.is_finite());
    if !drive.force_n.is_empty() && drive.force_n.len() != nodes {
        Some("the loads are neither none nor one for each node")
    } else if !drive.held.is_sorted_by(|a, b| a.0 < b.0) {
        Some("held nodes do not ascend")
    } else if drive
        .held
        .last()
        .is_some_and(|held| held.0 as usize >= nodes)
    {
        Some("a held node does not exist")
    } else if !drive.held.iter().all(|held| finite(&held.1)) {
        Some("a held node's displacement is not finite")
    } else if !drive.force_n.iter().all(finite) {
        Some("a load is not finite")
    } else {
        None
    }
}

/// What is said of a step that was not taken.
pub(crate) fn failed(reason: &'static str, energy_j: f64) -> Diagnostics {
    Diagnostics {
        outcome: Outcome::Failed(reason),
        iterations: 0,
        residual: f64::NAN,
        force_error: f64::INFINITY,
        energy_j,
        energy_difference: f64::NAN,
        momentum: [0.0; 3],
        angular_momentum: [0.0; 3],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_fault_is_named() {
        let good = [(1, [0.0; 3]), (4, [1.0, 0.0, 0.0])];
        let of = |held: &[(u32, [f64; 3])], force_n: &[[f64; 3]], step_s| {
            refused(&BoundaryConditions { held, force_n }, 5, step_s)
        };
        assert_eq!(of(&good, &[], 1e-3), None);
        assert_eq!(of(&good, &[[0.0; 3]; 5], 1e-3), None);
        for step_s in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(of(&good, &[], step_s).is_some_and(|why| why.contains("time step")));
        }
        assert!(of(&good, &[[0.0; 3]; 4], 1e-3).is_some_and(|why| why.contains("each node")));
        assert!(of(&good, &[[f64::NAN; 3]; 5], 1e-3).is_some_and(|why| why.contains("load")));
        let swapped = [good[1], good[0]];
        assert!(of(&swapped, &[], 1e-3).is_some_and(|why| why.contains("ascend")));
        assert!(of(&[good[0], good[0]], &[], 1e-3).is_some_and(|why| why.contains("ascend")));
        assert!(of(&[(5, [0.0; 3])], &[], 1e-3).is_some_and(|why| why.contains("exist")));
        assert!(of(&[(2, [f64::NAN; 3])], &[], 1e-3).is_some_and(|why| why.contains("finite")));
    }
}
