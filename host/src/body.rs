//! Tissue of either model as rows see it: where it is without their forces, and how it gives way.
//!
//! Entry points: [`Body::look`], [`Body::linearise`], [`Body::free`], [`Body::accept`]. Rows find forces
//! p on the linearised tissue `u = u_free + K^-1 p`. Linear tissue is that and needs one pass.
//! Corotational tissue is linearised about its present u under the forces p_0 of the last pass,
//! `u_free = u + du - K_0^-1 p_0`, where du answers the out-of-balance force with the present tangent
//! and K_0 is the factored one: a fixed point is in balance and fulfils the rows whatever K_0 is.

use crate::columns::Columns;
use crate::fem::{
    Balance, CorotationalState, CorotationalTissue, CorotationalWorkspace, Factor, Factored,
    HeldPoints, LinearTissue, Linearisation, Numbering, SolveScratch,
};
use crate::renewal::{Renewals, Rule};
use nalgebra::Vector3;
use serde::Serialize;
use std::sync::Arc;

/// A force on a vertex that columns can reach.
pub(crate) type Push = (u32, Vector3<f64>);

/// Tissue: what is constant.
#[derive(Debug)]
pub(crate) enum Body {
    /// Constant stiffness.
    Linear {
        tissue: Arc<LinearTissue>,
        /// Displacement without rows \[m\], (unknowns).
        resting: Vec<f64>,
    },
    /// Stiffness that turns with the cells.
    Corotational {
        tissue: Arc<CorotationalTissue>,
        /// Forces that do not come from rows \[N\], (unknowns).
        loads: Vec<f64>,
    },
}

/// What evolves in tissue: nothing if it is linear, for its displacement follows from the forces.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(crate) struct Motion(Option<Turning>);

#[derive(Clone, Debug, PartialEq, Serialize)]
struct Turning {
    state: CorotationalState,
    /// Forces of the last pass.
    pushes: Vec<Push>,
}

/// Scratch of corotational tissue.
pub(crate) struct BodyWork(Option<Box<Scratch>>);

struct Scratch {
    tissue: CorotationalWorkspace,
    external: Vec<f64>,
    change: Vec<f64>,
    solve: SolveScratch,
    /// Elastic energy of the displacement that was accepted last \[J\].
    energy_j: f64,
}

/// Tissue with the stiffness that it has at present.
pub(crate) struct View<'a> {
    numbering: &'a Numbering,
    factor: &'a Factor,
}

impl<'a> View<'a> {
    pub fn new(numbering: &'a Numbering, factor: &'a Factor) -> Self {
        Self { numbering, factor }
    }
}

impl Factored for View<'_> {
    fn numbering(&self) -> &Numbering {
        self.numbering
    }

    fn factor(&self) -> &Factor {
        self.factor
    }
}

impl Motion {
    /// Corotational tissue that starts in `state`.
    pub fn turning(state: CorotationalState) -> Self {
        let pushes = Vec::new();
        Self(Some(Turning { state, pushes }))
    }

    /// Room for so many forces, which a copy does not have.
    pub fn with_room(mut self, pushes: usize) -> Self {
        if let Some(turning) = &mut self.0 {
            turning.pushes.reserve(pushes);
        }
        self
    }

    /// Vertices whose columns [`Body::free`] will read, and the forces on them.
    pub fn pushed(&self) -> &[Push] {
        self.0.as_ref().map_or(&[], |turning| &turning.pushes)
    }

    /// Number of the present factor, for [`Columns::belong_to`].
    pub fn factor(&self) -> u64 {
        self.state().map_or(0, CorotationalState::fingerprint)
    }

    /// The state of corotational tissue.
    pub fn state(&self) -> Option<&CorotationalState> {
        self.0.as_ref().map(|turning| &turning.state)
    }
}

impl Body {
    pub fn numbering(&self) -> &Numbering {
        match self {
            Self::Linear { tissue, .. } => tissue.numbering(),
            Self::Corotational { tissue, .. } => tissue.numbering(),
        }
    }

    /// Whether one pass is exact.
    pub fn is_linear(&self) -> bool {
        matches!(self, Self::Linear { .. })
    }

    /// This tissue under so much of its loads \[1\].
    pub fn at_share(&self, share: f64) -> Self {
        let scaled = |values: &[f64]| values.iter().map(|value| share * value).collect();
        match self {
            Self::Linear { tissue, resting } => Self::Linear {
                tissue: tissue.clone(),
                resting: scaled(resting),
            },
            Self::Corotational { tissue, loads } => Self::Corotational {
                tissue: tissue.clone(),
                loads: scaled(loads),
            },
        }
    }

    /// Tissue at rest without loads.
    pub fn at_rest(&self) -> Motion {
        match self {
            Self::Linear { .. } => Motion::default(),
            Self::Corotational { tissue, .. } => Motion::turning(tissue.state()),
        }
    }

    pub fn work(&self) -> BodyWork {
        BodyWork(match self {
            Self::Linear { .. } => None,
            Self::Corotational { tissue, .. } => Some(Box::new(Scratch {
                tissue: tissue.workspace(),
                external: vec![0.0; tissue.unknowns()],
                change: vec![0.0; tissue.unknowns()],
                solve: tissue.scratch(1),
                energy_j: 0.0,
            })),
        })
    }

    /// The stiffness that columns are of.
    pub fn view<'a>(&'a self, motion: &'a Motion) -> View<'a> {
        let factor = match self {
            Self::Linear { tissue, .. } => tissue.factor(),
            Self::Corotational { tissue, .. } => motion
                .state()
                .map_or(tissue.rest_factor(), CorotationalState::factor),
        };
        View {
            numbering: self.numbering(),
            factor,
        }
    }

    /// A step begins: a factor that was renewed beside the steps is taken over if its time has come.
    pub fn begin_step(
        &self,
        motion: &mut Motion,
        columns: &mut Columns,
        held: &HeldPoints,
    ) -> Renewals {
        match (self, &mut motion.0) {
            (Self::Corotational { tissue, .. }, Some(turning)) => {
                columns.take_over(tissue, &mut turning.state, held)
            }
            _ => Renewals::default(),
        }
    }

    /// From now on factors of turning tissue are renewed beside the steps and taken over by `rule`, unless its policy
    /// wants them fresh; `reached` are the vertices of `columns`. Whether they are.
    pub fn renew_beside(
        &self,
        columns: &mut Columns,
        held: &Arc<HeldPoints>,
        reached: &[u32],
        rule: Rule,
    ) -> bool {
        match self {
            Self::Corotational { tissue, .. } if tissue.has_time() => {
                columns.renew(tissue, held, reached, rule);
                true
            }
            _ => false,
        }
    }

    /// How far from balance the tissue is under the forces of the last pass; `None` for linear tissue.
    pub fn look(
        &self,
        motion: &mut Motion,
        work: &mut BodyWork,
        columns: &Columns,
    ) -> Option<Balance> {
        let (tissue, loads, turning, scratch) = self.turning(motion, work)?;
        scratch.external.copy_from_slice(loads);
        for &(vertex, force) in &turning.pushes {
            let first = columns.first_unknown(vertex);
            for axis in 0..3 {
                scratch.external[first + axis] += force[axis];
            }
        }
        let balance = tissue.look(&mut turning.state, &mut scratch.tissue, &scratch.external);
        scratch.energy_j = tissue.energy_j(&scratch.tissue);
        Some(balance)
    }

    /// After [`Self::look`]: linearises there; columns of another factor are forgotten, and the next factor is asked for
    /// when this one gets old. `None` for linear tissue.
    pub fn linearise(
        &self,
        motion: &mut Motion,
        work: &mut BodyWork,
        columns: &mut Columns,
    ) -> Option<Linearisation> {
        let (tissue, _, turning, scratch) = self.turning(motion, work)?;
        let Scratch {
            tissue: workspace,
            external,
            ..
        } = scratch;
        let report = tissue.answer(&mut turning.state, workspace, external, columns.helpless());
        columns.belong_to(turning.state.fingerprint());
        if report.asked {
            columns.ask(&turning.state);
        }
        Some(report)
    }

    /// Displacement \[m\] (unknowns) that the linearisation answers with, [`Motion::pushed`] still acting.
    pub fn predicted<'a>(&'a self, work: &'a BodyWork) -> &'a [f64] {
        match (self, &work.0) {
            (Self::Linear { resting, .. }, _) => resting,
            (_, Some(scratch)) => scratch.tissue.predicted(),
            (_, None) => &[],
        }
    }

    /// Displacement of a vertex without row forces, by the linearisation \[m\].
    pub fn free(
        &self,
        motion: &Motion,
        work: &BodyWork,
        columns: &Columns,
        vertex: u32,
    ) -> Vector3<f64> {
        let first = columns.first_unknown(vertex);
        let mut at = Vector3::from_column_slice(&self.predicted(work)[first..first + 3]);
        for &(pushed, force) in motion.pushed() {
            at -= columns.block(vertex, pushed) * force;
        }
        at
    }

    /// Estimate of the relative error of a tangent whose factor is as old as `balance` says: a cell that
    /// has turned by theta shears where its factored stiffness expects pressure, which differs in the energy
    /// norm by theta sqrt((lambda + 2 mu) / mu); a change of stretch counts like a turn. The cell that
    /// changed most stands for all.
    pub fn tangent_error(&self, balance: &Balance) -> f64 {
        self.error_of(balance.change_since_refactor)
    }

    /// What a pass that has not been looked at adds to the estimate.
    pub fn tangent_error_of_pass(&self, motion: &Motion) -> f64 {
        match (self, motion.state()) {
            (Self::Corotational { tissue, .. }, Some(state)) => {
                self.error_of(tissue.change_since_linearised(state))
            }
            _ => 0.0,
        }
    }

    fn error_of(&self, change: f64) -> f64 {
        match self {
            Self::Linear { .. } => 0.0,
            Self::Corotational { tissue, .. } => change * tissue.stiffness_ratio(),
        }
    }

    /// Takes over the forces of a pass and moves the tissue accordingly.
    pub fn accept(
        &self,
        motion: &mut Motion,
        work: &mut BodyWork,
        columns: &Columns,
        pushes: impl Iterator<Item = Push>,
    ) {
        let Some((_, _, turning, scratch)) = self.turning(motion, work) else {
            return;
        };
        let Scratch {
            tissue,
            external,
            change,
            solve,
            energy_j,
        } = scratch;
        change.fill(0.0);
        let mut add = |(vertex, force): Push, sign: f64| {
            let first = columns.first_unknown(vertex);
            for axis in 0..3 {
                change[first + axis] += sign * force[axis];
            }
        };
        for push in turning.pushes.drain(..) {
            add(push, -1.0);
        }
        for push in pushes {
            add(push, 1.0);
            turning.pushes.push(push);
        }
        for (external, change) in external.iter_mut().zip(change.iter()) {
            *external += change;
        }
        // Where no force has changed, nothing is displaced.
        if change.iter().any(|force| *force != 0.0) {
            turning.state.factor().solve(change, 1, solve);
        }
        // The elastic force goes from internal to external on the way: a trapezoid.
        let forces = external.iter().zip(tissue.internal_force());
        let ends = tissue.predicted().iter().zip(change.iter());
        for ((u, (predicted, change)), (external, internal)) in turning
            .state
            .unknowns_mut()
            .iter_mut()
            .zip(ends)
            .zip(forces)
        {
            let next = predicted + change;
            *energy_j += 0.5 * (external + internal) * (next - *u);
            *u = next;
        }
    }

    /// Elastic energy \[J\] of corotational tissue less the work of its loads, as it was accepted last.
    pub fn potential_j(&self, motion: &Motion, work: &BodyWork) -> Option<f64> {
        match (self, motion.state(), &work.0) {
            (Self::Corotational { loads, .. }, Some(state), Some(scratch)) => {
                let done = loads.iter().zip(state.unknowns()).map(|(f, u)| f * u);
                Some(scratch.energy_j - done.sum::<f64>())
            }
            _ => None,
        }
    }

    /// Displacement of free nodes \[m\] (unknowns) with `pushes` acting, into `u`.
    pub fn field(
        &self,
        motion: &Motion,
        columns: &Columns,
        pushes: impl Iterator<Item = Push>,
        u: &mut [f64],
        scratch: &mut SolveScratch,
    ) {
        if let Some(state) = motion.state() {
            u.copy_from_slice(state.unknowns());
        } else {
            self.displaced(motion, &BodyWork(None), columns, pushes, u, scratch);
        }
    }

    /// Displacement of free nodes \[m\] (unknowns) with `pushes` acting, by the linearisation, into `u`.
    pub fn displaced(
        &self,
        motion: &Motion,
        work: &BodyWork,
        columns: &Columns,
        pushes: impl Iterator<Item = Push>,
        u: &mut [f64],
        scratch: &mut SolveScratch,
    ) {
        u.fill(0.0);
        let before = motion
            .pushed()
            .iter()
            .map(|(vertex, force)| (*vertex, -force));
        for (vertex, force) in pushes.chain(before) {
            let first = columns.first_unknown(vertex);
            for axis in 0..3 {
                u[first + axis] += force[axis];
            }
        }
        self.view(motion).factor().solve(u, 1, scratch);
        for (u, predicted) in u.iter_mut().zip(self.predicted(work)) {
            *u += predicted;
        }
    }

    /// The parts of corotational tissue.
    fn turning<'a>(
        &'a self,
        motion: &'a mut Motion,
        work: &'a mut BodyWork,
    ) -> Option<(
        &'a CorotationalTissue,
        &'a [f64],
        &'a mut Turning,
        &'a mut Scratch,
    )> {
        match (self, &mut motion.0, &mut work.0) {
            (Self::Corotational { tissue, loads }, Some(turning), Some(scratch)) => {
                Some((tissue, loads, turning, scratch))
            }
            _ => None,
        }
    }
}
