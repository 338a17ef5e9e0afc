//! Tissue of either model as rows see it: where it is without their forces, and how it gives way.
//!
//! Entry points: [`Body::linearise`], [`Body::free`], [`Body::accept`]. Rows find forces p on the
//! linearised tissue `u = u_free + K^-1 p`. Linear tissue is that and needs one pass. Corotational
//! tissue is linearised about its present u under the forces p_0 of the last pass,
//! `u_free = u + du - K_0^-1 p_0`, where du answers the out-of-balance force with the present tangent
//! and K_0 is the factored one: a fixed point is in balance and fulfils the rows whatever K_0 is.

use crate::columns::Columns;
use crate::fem::{
    CorotationalState, CorotationalTissue, CorotationalWorkspace, Factor, Factored, LinearTissue,
    Linearisation, Numbering, SolveScratch, TissueError,
};
use nalgebra::Vector3;
use std::sync::Arc;

/// A force on a vertex that columns can reach.
pub(crate) type Push = (u32, Vector3<f64>);

/// Tissue that evolves.
pub(crate) enum Body {
    /// Constant stiffness.
    Linear {
        tissue: Arc<LinearTissue>,
        /// Displacement without rows \[m\], (unknowns).
        resting: Vec<f64>,
    },
    /// Stiffness that turns with the cells.
    Corotational(Box<Turning>),
}

/// Corotational tissue, its state, and buffers.
pub(crate) struct Turning {
    tissue: Arc<CorotationalTissue>,
    state: CorotationalState,
    work: CorotationalWorkspace,
    /// Forces of the last pass.
    pushes: Vec<Push>,
    /// Loads \[N\], (unknowns).
    loads: Vec<f64>,
    external: Vec<f64>,
    change: Vec<f64>,
    scratch: SolveScratch,
}

impl Factored for Body {
    fn numbering(&self) -> &Numbering {
        match self {
            Self::Linear { tissue, .. } => tissue.numbering(),
            Self::Corotational(turning) => turning.tissue.numbering(),
        }
    }

    fn factor(&self) -> &Factor {
        match self {
            Self::Linear { tissue, .. } => tissue.factor(),
            Self::Corotational(turning) => turning.state.factor(),
        }
    }
}

impl Body {
    /// Linear tissue that rests at `resting` \[m\] (unknowns) without rows.
    pub fn linear(tissue: Arc<LinearTissue>, resting: Vec<f64>) -> Self {
        Self::Linear { tissue, resting }
    }

    /// Corotational tissue at rest, under `loads` \[N\] (unknowns), with up to `most_pushes` forces.
    pub fn corotational(
        tissue: Arc<CorotationalTissue>,
        loads: Vec<f64>,
        most_pushes: usize,
    ) -> Result<Self, TissueError> {
        let unknowns = tissue.unknowns();
        Ok(Self::Corotational(Box::new(Turning {
            state: tissue.state(),
            work: tissue.workspace()?,
            pushes: Vec::with_capacity(most_pushes),
            loads,
            external: vec![0.0; unknowns],
            change: vec![0.0; unknowns],
            scratch: tissue.scratch(1),
            tissue,
        })))
    }

    /// Whether one pass is exact.
    pub fn is_linear(&self) -> bool {
        matches!(self, Self::Linear { .. })
    }

    /// Linearises about the present displacement under the forces of the last pass; columns that do not
    /// belong to the factor any more are forgotten. Nothing to do for linear tissue.
    pub fn linearise(&mut self, columns: &mut Columns) -> Option<Linearisation> {
        let Self::Corotational(turning) = self else {
            return None;
        };
        turning.external.copy_from_slice(&turning.loads);
        for &(vertex, force) in &turning.pushes {
            let first = columns.first_unknown(vertex);
            for axis in 0..3 {
                turning.external[first + axis] += force[axis];
            }
        }
        let report =
            turning
                .tissue
                .linearise(&mut turning.state, &mut turning.work, &turning.external);
        if report.refactored {
            columns.forget();
        }
        Some(report)
    }

    /// Vertices whose columns [`Self::free`] will read.
    pub fn pushed(&self) -> &[Push] {
        match self {
            Self::Linear { .. } => &[],
            Self::Corotational(turning) => &turning.pushes,
        }
    }

    /// Displacement of a vertex without row forces, by the linearisation \[m\].
    pub fn free(&self, columns: &Columns, vertex: u32) -> Vector3<f64> {
        let first = columns.first_unknown(vertex);
        match self {
            Self::Linear { resting, .. } => Vector3::from_column_slice(&resting[first..first + 3]),
            Self::Corotational(turning) => {
                let predicted = &turning.work.predicted()[first..first + 3];
                let mut at = Vector3::from_column_slice(predicted);
                for &(pushed, force) in &turning.pushes {
                    at -= columns.block(vertex, pushed) * force;
                }
                at
            }
        }
    }

    /// Takes over the forces of a pass and moves the tissue accordingly.
    pub fn accept(&mut self, columns: &Columns, pushes: impl Iterator<Item = Push>) {
        let Self::Corotational(turning) = self else {
            return;
        };
        let Turning {
            state,
            work,
            change,
            scratch,
            pushes: last,
            ..
        } = &mut **turning;
        change.fill(0.0);
        let mut add = |(vertex, force): Push, sign: f64| {
            let first = columns.first_unknown(vertex);
            for axis in 0..3 {
                change[first + axis] += sign * force[axis];
            }
        };
        for push in last.drain(..) {
            add(push, -1.0);
        }
        for push in pushes {
            add(push, 1.0);
            last.push(push);
        }
        state.factor().solve(change, 1, scratch);
        let moved = work.predicted().iter().zip(change.iter());
        for (u, (predicted, change)) in state.unknowns_mut().iter_mut().zip(moved) {
            *u = predicted + change;
        }
    }

    /// Displacement of free nodes \[m\] (unknowns) with `pushes` acting, into `u`.
    pub fn field(
        &self,
        columns: &Columns,
        pushes: impl Iterator<Item = Push>,
        u: &mut [f64],
        scratch: &mut SolveScratch,
    ) {
        match self {
            Self::Linear { tissue, resting } => {
                u.fill(0.0);
                for (vertex, force) in pushes {
                    let first = columns.first_unknown(vertex);
                    for axis in 0..3 {
                        u[first + axis] += force[axis];
                    }
                }
                tissue.factor().solve(u, 1, scratch);
                for (u, resting) in u.iter_mut().zip(resting) {
                    *u += resting;
                }
            }
            Self::Corotational(turning) => u.copy_from_slice(turning.state.unknowns()),
        }
    }
}
