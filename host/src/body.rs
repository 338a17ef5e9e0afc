//! Tissue of any model as rows see it: where it is without their forces, and how it gives way.
//!
//! Entry points: [`Body::look`], [`Body::linearise`], [`Body::free`], [`Body::accept`]. Rows find forces
//! p on the linearised tissue `u = u_free + K^-1 p`. Linear tissue is that and needs one pass.
//! Corotational and hyperelastic tissue is linearised about its present u under the forces p_0 of the last pass,
//! `u_free = u + du - K_0^-1 p_0`, where du answers the out-of-balance force with the present tangent
//! and K_0 is the factored one: a fixed point is in balance and fulfils the rows whatever K_0 is.
//! Hyperelastic tissue goes that way only as far as no cell inverts.

mod straining;

use crate::columns::Columns;
use crate::fem::{
    Balance, Beside, CorotationalState, CorotationalTissue, CorotationalWorkspace, Factor,
    Factored, HeldPoints, HyperelasticState, HyperelasticTissue, LinearTissue, Linearisation,
    Moved, Numbering, SolveScratch,
};
use crate::renewal::{Renewals, Rule};
use nalgebra::Vector3;
use serde::Serialize;
use std::sync::Arc;
use straining::Straining;

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
    /// Stiffness that follows from strains of any size.
    Hyperelastic {
        tissue: Arc<HyperelasticTissue>,
        /// Forces that do not come from rows \[N\], (unknowns).
        loads: Vec<f64>,
    },
}

/// What evolves in tissue.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(crate) enum Motion {
    /// Nothing in linear tissue: its displacement follows from the forces.
    #[default]
    Still,
    /// Of corotational tissue.
    Turning(Evolving<CorotationalState>),
    /// Of hyperelastic tissue.
    Straining(Evolving<HyperelasticState>),
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Evolving<S> {
    state: S,
    /// Forces of the last pass.
    pushes: Vec<Push>,
}

type Turning = Evolving<CorotationalState>;

/// Where tissue that is not linear is and the forces on it, to go back to; nothing of linear tissue.
#[derive(Default)]
pub(crate) struct Place {
    u: Vec<f64>,
    pushes: Vec<Push>,
}

/// Scratch of tissue that needs more than one pass.
pub(crate) struct BodyWork(Works);

enum Works {
    None,
    Turning(Box<Scratch>),
    Straining(Box<straining::Scratch>),
}

/// Scratch of corotational tissue.
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
        Self::Turning(Evolving { state, pushes })
    }

    /// Hyperelastic tissue that starts in `state`.
    pub fn straining(state: HyperelasticState) -> Self {
        let pushes = Vec::new();
        Self::Straining(Evolving { state, pushes })
    }

    /// Room for so many forces, which a copy does not have.
    pub fn with_room(mut self, pushes: usize) -> Self {
        match &mut self {
            Self::Still => {}
            Self::Turning(turning) => turning.pushes.reserve(pushes),
            Self::Straining(straining) => straining.pushes.reserve(pushes),
        }
        self
    }

    /// Vertices whose columns [`Body::free`] will read, and the forces on them.
    pub fn pushed(&self) -> &[Push] {
        match self {
            Self::Still => &[],
            Self::Turning(turning) => &turning.pushes,
            Self::Straining(straining) => &straining.pushes,
        }
    }

    /// Number of the present factor, for [`Columns::belong_to`].
    pub fn factor(&self) -> u64 {
        match self {
            Self::Still => 0,
            Self::Turning(turning) => turning.state.fingerprint(),
            Self::Straining(straining) => straining.state.fingerprint(),
        }
    }

    /// The state of corotational tissue.
    pub fn state(&self) -> Option<&CorotationalState> {
        match self {
            Self::Turning(turning) => Some(&turning.state),
            _ => None,
        }
    }

    /// The state of hyperelastic tissue.
    pub fn strained(&self) -> Option<&HyperelasticState> {
        match self {
            Self::Straining(straining) => Some(&straining.state),
            _ => None,
        }
    }

    /// Writes down where tissue is whose displacement does not follow from the forces alone. Allocates the first time.
    pub fn keep(&self, place: &mut Place) {
        let (u, pushes) = match self {
            Self::Still => return,
            Self::Turning(own) => (own.state.unknowns(), &own.pushes),
            Self::Straining(own) => (own.state.unknowns(), &own.pushes),
        };
        place.u.clear();
        place.u.extend_from_slice(u);
        place.pushes.clear();
        place.pushes.reserve(pushes.capacity());
        place.pushes.extend_from_slice(pushes);
    }

    /// Puts such tissue where `other` is, without new memory; the factor stays, and nothing goes on from here.
    pub fn see(&mut self, other: &Self) {
        match (self, other) {
            (Self::Turning(own), Self::Turning(other)) => {
                own.state.see(&other.state);
                own.pushes.clone_from(&other.pushes);
            }
            (Self::Straining(own), Self::Straining(other)) => {
                own.state.see(&other.state);
                own.pushes.clone_from(&other.pushes);
            }
            _ => {}
        }
    }

    /// Takes such tissue back to where it was; the factor stays.
    pub fn go_back(&mut self, place: &Place) {
        let (u, pushes) = match self {
            Self::Still => return,
            Self::Turning(own) => (own.state.unknowns_mut(), &mut own.pushes),
            Self::Straining(own) => (own.state.unknowns_mut(), &mut own.pushes),
        };
        u.copy_from_slice(&place.u);
        pushes.clone_from(&place.pushes);
    }

    /// Displacement of free nodes \[m\], (unknowns), where it does not follow from the forces alone.
    pub fn unknowns(&self) -> Option<&[f64]> {
        match self {
            Self::Still => None,
            Self::Turning(turning) => Some(turning.state.unknowns()),
            Self::Straining(straining) => Some(straining.state.unknowns()),
        }
    }
}

impl Body {
    pub fn numbering(&self) -> &Numbering {
        match self {
            Self::Linear { tissue, .. } => tissue.numbering(),
            Self::Corotational { tissue, .. } => tissue.numbering(),
            Self::Hyperelastic { tissue, .. } => tissue.numbering(),
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
            Self::Hyperelastic { tissue, loads } => Self::Hyperelastic {
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
            Self::Hyperelastic { tissue, .. } => Motion::straining(tissue.state()),
        }
    }

    pub fn work(&self) -> BodyWork {
        BodyWork(match self {
            Self::Linear { .. } => Works::None,
            Self::Corotational { tissue, .. } => Works::Turning(Box::new(Scratch {
                tissue: tissue.workspace(),
                external: vec![0.0; tissue.unknowns()],
                change: vec![0.0; tissue.unknowns()],
                solve: tissue.scratch(),
                energy_j: 0.0,
            })),
            Self::Hyperelastic { tissue, .. } => {
                Works::Straining(Box::new(straining::Scratch::new(tissue)))
            }
        })
    }

    /// The stiffness that columns are of.
    pub fn view<'a>(&'a self, motion: &'a Motion) -> View<'a> {
        let factor = match self {
            Self::Linear { tissue, .. } => tissue.factor(),
            Self::Corotational { tissue, .. } => motion
                .state()
                .map_or(tissue.rest_factor(), CorotationalState::factor),
            Self::Hyperelastic { tissue, .. } => motion
                .strained()
                .map_or(tissue.rest_factor(), HyperelasticState::factor),
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
        match (self, motion) {
            (Self::Corotational { tissue, .. }, Motion::Turning(turning)) => {
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
        if let Some(mut straining) = self.straining(motion, work) {
            return Some(straining.look(columns));
        }
        let (tissue, loads, turning, scratch) = self.turning(motion, work)?;
        outside(loads, &turning.pushes, columns, &mut scratch.external);
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
        if let Some(mut straining) = self.straining(motion, work) {
            return Some(straining.linearise(columns));
        }
        let (tissue, _, turning, scratch) = self.turning(motion, work)?;
        let Scratch {
            tissue: workspace,
            external,
            ..
        } = scratch;
        let beside = columns.helpless().map(|helpless| Beside {
            helpless,
            idle: turning.pushes.is_empty(),
        });
        let report = tissue.answer(&mut turning.state, workspace, external, beside);
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
            (_, Works::Turning(scratch)) => scratch.tissue.predicted(),
            (_, Works::Straining(scratch)) => scratch.predicted(),
            (_, Works::None) => &[],
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
    /// changed most stands for all. Of hyperelastic tissue strain and turn are those of the deformation gradient.
    pub fn tangent_error(&self, balance: &Balance) -> f64 {
        self.error_of(balance.change_since_refactor)
    }

    /// What a pass that has not been looked at adds to the estimate.
    pub fn tangent_error_of_pass(&self, motion: &Motion) -> f64 {
        match (self, motion) {
            (Self::Corotational { tissue, .. }, Motion::Turning(turning)) => {
                self.error_of(tissue.change_since_linearised(&turning.state))
            }
            (Self::Hyperelastic { .. }, Motion::Straining(straining)) => {
                self.error_of(straining.state.change_of_move())
            }
            _ => 0.0,
        }
    }

    fn error_of(&self, change: f64) -> f64 {
        match self {
            Self::Linear { .. } => 0.0,
            Self::Corotational { tissue, .. } => change * tissue.stiffness_ratio(),
            Self::Hyperelastic { tissue, .. } => change * tissue.stiffness_ratio(),
        }
    }

    /// Takes over the forces of a pass and moves the tissue accordingly, as far as it can go; if it cannot, forces stay
    /// as they were, too.
    pub fn accept(
        &self,
        motion: &mut Motion,
        work: &mut BodyWork,
        columns: &Columns,
        pushes: impl Iterator<Item = Push>,
    ) -> Moved {
        if let Some(mut straining) = self.straining(motion, work) {
            return straining.accept(columns, pushes);
        }
        let Some((_, _, turning, scratch)) = self.turning(motion, work) else {
            return Moved::Whole;
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
            turning.state.factor().solve(change, solve);
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
        Moved::Whole
    }

    /// Elastic energy \[J\] of corotational or hyperelastic tissue less the work of its loads, as it was accepted last.
    pub fn potential_j(&self, motion: &Motion, work: &BodyWork) -> Option<f64> {
        let (loads, energy_j) = match (self, &work.0) {
            (Self::Corotational { loads, .. }, Works::Turning(scratch)) => {
                (loads, scratch.energy_j)
            }
            (Self::Hyperelastic { loads, .. }, Works::Straining(scratch)) => {
                (loads, scratch.energy_j())
            }
            _ => return None,
        };
        let done = loads.iter().zip(motion.unknowns()?).map(|(f, u)| f * u);
        Some(energy_j - done.sum::<f64>())
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
        if let Some(unknowns) = motion.unknowns() {
            u.copy_from_slice(unknowns);
        } else {
            self.displaced(motion, &BodyWork(Works::None), columns, pushes, u, scratch);
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
        self.view(motion).factor().solve(u, scratch);
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
        match (self, motion, &mut work.0) {
            (
                Self::Corotational { tissue, loads },
                Motion::Turning(turning),
                Works::Turning(scratch),
            ) => Some((tissue, loads, turning, scratch)),
            _ => None,
        }
    }

    /// The parts of hyperelastic tissue.
    fn straining<'a>(
        &'a self,
        motion: &'a mut Motion,
        work: &'a mut BodyWork,
    ) -> Option<Straining<'a>> {
        match (self, motion, &mut work.0) {
            (
                Self::Hyperelastic { tissue, loads },
                Motion::Straining(own),
                Works::Straining(scratch),
            ) => Some(Straining {
                tissue,
                loads,
                own,
                scratch,
            }),
            _ => None,
        }
    }
}

/// Forces on the unknowns \[N\]: loads and those of rows, into `external`.
fn outside(loads: &[f64], pushes: &[Push], columns: &Columns, external: &mut [f64]) {
    external.copy_from_slice(loads);
    for &(vertex, force) in pushes {
        let first = columns.first_unknown(vertex);
        for axis in 0..3 {
            external[first + axis] += force[axis];
        }
    }
}
