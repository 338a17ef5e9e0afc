//! The move of a pass, no farther than cells stand it.
//!
//! Entry point: [`HyperelasticTissue::accept`]. Under the forces of the pass the way to where its linearisation is in
//! balance goes down the potential; it is halved until that falls by a share of what the slope promises (Armijo; Nocedal
//! & Wright 2006, 3.1). A flat or inverted cell has no energy, so that none is ever accepted.

use super::super::corotational::dot;
use super::{HyperelasticState, HyperelasticTissue, HyperelasticWorkspace};
use nalgebra::Matrix3;

/// Least share of the fall that the slope promises.
const FALL: f64 = 1e-4;
/// Shortest part of a way that is tried: 1/1024.
const MOST_HALVINGS: u32 = 10;

/// How far a pass moved the tissue.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Moved {
    /// To where the linearisation is in balance.
    Whole,
    /// A part of that way: the rows are not fulfilled yet.
    Part,
    /// Nowhere: every part that was tried inverts a cell, or the way is not finite.
    Not,
}

impl HyperelasticTissue {
    /// After a linearisation: moves free nodes from where they are towards [`HyperelasticWorkspace::predicted`] plus
    /// `change` \[m\], (unknowns), under the forces `external` \[N\], (unknowns). Allocates nothing.
    pub(crate) fn accept(
        &self,
        state: &mut HyperelasticState,
        workspace: &mut HyperelasticWorkspace,
        external: &[f64],
        change: &[f64],
    ) -> Moved {
        let ends = workspace.predicted.iter().zip(change);
        let starts = ends.zip(state.unknowns());
        for (way, ((predicted, change), u)) in workspace.search.iter_mut().zip(starts) {
            *way = predicted + change - u;
        }
        let way = &workspace.search;
        let work_j = dot(external, way);
        let slope_j = dot(&workspace.internal, way) - work_j;
        if !slope_j.is_finite() {
            return Moved::Not;
        }
        self.scatter(&workspace.search, &mut workspace.direction);
        let before_j = workspace.elasticity.energy_j(&workspace.x);
        let mut share = 1.0;
        for halvings in 0..=MOST_HALVINGS {
            let after_j = energy_at(workspace, share);
            let fall_j = after_j - before_j - share * work_j;
            // A stale factor may lead upwards: then only cells decide.
            let is_down = slope_j >= 0.0 || fall_j <= FALL * share * slope_j + self.round_off_j;
            if after_j.is_finite() && is_down {
                self.go(state, workspace, share, after_j);
                // A fresh factor leads nowhere else, an old one might.
                state.is_poor |= halvings > 0;
                return if halvings == 0 {
                    Moved::Whole
                } else {
                    Moved::Part
                };
            }
            share *= 0.5;
        }
        workspace.energy_j = before_j;
        state.is_poor = true;
        Moved::Not
    }

    /// Goes this share of the way.
    fn go(
        &self,
        state: &mut HyperelasticState,
        workspace: &mut HyperelasticWorkspace,
        share: f64,
        energy_j: f64,
    ) {
        for (u, way) in state.unknowns_mut().iter_mut().zip(&workspace.search) {
            *u += share * way;
        }
        let slopes = workspace.elasticity.deformations(&workspace.direction);
        let changes = slopes.zip(&workspace.deformed).map(|(slope, f)| {
            let inverse = f.try_inverse().unwrap_or_default();
            (slope * inverse).norm()
        });
        state.change_of_move = share * changes.fold(0.0, f64::max);
        workspace.energy_j = energy_j;
    }
}

/// Energy \[J\] this share of the way from the last look; not finite where a cell is flat or inverted, whatever its law.
fn energy_at(workspace: &mut HyperelasticWorkspace, share: f64) -> f64 {
    let HyperelasticWorkspace {
        elasticity,
        x,
        trial,
        direction,
        ..
    } = workspace;
    for ((trial, x), way) in trial.iter_mut().zip(x.iter()).zip(direction.iter()) {
        *trial = x + way * share;
    }
    if elasticity.deformations(trial).any(|f| is_inverted(&f)) {
        return f64::INFINITY;
    }
    elasticity.energy_j(trial)
}

fn is_inverted(f: &Matrix3<f64>) -> bool {
    let volume = f.determinant();
    volume.is_nan() || volume <= 0.0
}
