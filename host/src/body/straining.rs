//! Hyperelastic tissue as rows see it.
//!
//! Entry points: [`Straining::look`], [`Straining::linearise`], [`Straining::accept`], what [`super::Body`] has of these
//! names.

use super::{Evolving, Push, outside};
use crate::columns::Columns;
use crate::fem::{
    Balance, HyperelasticState, HyperelasticTissue, HyperelasticWorkspace, Linearisation, Moved,
    SolveScratch,
};

/// Scratch.
pub(super) struct Scratch {
    tissue: HyperelasticWorkspace,
    /// Forces from outside \[N\], and what they change in a pass, then the displacement of that \[m\], (unknowns).
    external: Vec<f64>,
    change: Vec<f64>,
    solve: SolveScratch,
    /// Forces of the pass before.
    before: Vec<Push>,
}

/// All that hyperelastic tissue has.
pub(super) struct Straining<'a> {
    pub tissue: &'a HyperelasticTissue,
    pub loads: &'a [f64],
    pub own: &'a mut Evolving<HyperelasticState>,
    pub scratch: &'a mut Scratch,
}

impl Scratch {
    pub fn new(tissue: &HyperelasticTissue) -> Self {
        Self {
            tissue: tissue.workspace(),
            external: vec![0.0; tissue.unknowns()],
            change: vec![0.0; tissue.unknowns()],
            solve: tissue.scratch(),
            before: Vec::new(),
        }
    }

    pub fn predicted(&self) -> &[f64] {
        self.tissue.predicted()
    }

    pub fn energy_j(&self) -> f64 {
        self.tissue.energy_j()
    }
}

impl Straining<'_> {
    pub fn look(&mut self, columns: &Columns) -> Balance {
        let Scratch {
            tissue, external, ..
        } = self.scratch;
        outside(self.loads, &self.own.pushes, columns, external);
        self.tissue.look(&self.own.state, tissue, external)
    }

    pub fn linearise(&mut self, columns: &mut Columns) -> Linearisation {
        let report = self
            .tissue
            .answer(&mut self.own.state, &mut self.scratch.tissue);
        columns.belong_to(self.own.state.fingerprint());
        report
    }

    pub fn accept(&mut self, columns: &Columns, pushes: impl Iterator<Item = Push>) -> Moved {
        let Evolving { state, pushes: own } = &mut *self.own;
        let Scratch {
            tissue,
            external,
            change,
            solve,
            before,
        } = &mut *self.scratch;
        // Both have the room that forces may take.
        before.clear();
        before.reserve(own.capacity());
        before.clone_from(own);
        own.clear();
        own.extend(pushes);
        change.copy_from_slice(external);
        outside(self.loads, own, columns, external);
        for (change, external) in change.iter_mut().zip(external.iter()) {
            *change = external - *change;
        }
        // Where no force has changed, nothing is displaced.
        if change.iter().any(|force| *force != 0.0) {
            state.factor().solve(change, solve);
        }
        let moved = self.tissue.accept(state, tissue, external, change);
        if moved == Moved::Not {
            own.clone_from(before);
        }
        moved
    }
}
