//! A tangent that is factored beside the steps: what it is of, and how a state takes it over.
//!
//! Entry points: [`CorotationalState::ask`], [`CorotationalTissue::renew`], [`CorotationalState::adopt`]. The tangent
//! follows from rotations and stretches, so that a state that has asked holds all that the answer depends on: its
//! bits do not depend on who factors, nor when.

use super::super::factor::{Factor, RefactorScratch};
use super::super::rotation::{Polar, matrix};
use super::linearise::fingerprint;
use super::{CorotationalState, CorotationalTissue, CorotationalWorkspace, TangentKind};
use nalgebra::{Matrix3, UnitQuaternion};
use std::sync::atomic::{AtomicU64, Ordering};

/// A tangent is asked for at this part of the turn that would have it factored in the step, so that it is there in time.
const EARLY: f64 = 0.5;
/// At this part of that while nothing presses: the next touch is foretold by it, and nobody waits for another one.
const IDLE: f64 = 0.1;
/// Who wants factors younger than so many linearisations wants them of the step itself.
const LEAST_EVERY: u32 = 16;
/// Steps until the next is asked for after one that could not be factored.
const HOLD_OFF: u32 = 32;

static NEXT_TICKET: AtomicU64 = AtomicU64::new(1);

/// All that a tangent depends on.
#[derive(Clone, Debug, PartialEq)]
struct Snapshot {
    /// Rotation of each cell, (m).
    rotations: Vec<UnitQuaternion<f64>>,
    /// Stretch of each cell, (m).
    stretches: Vec<Matrix3<f64>>,
}

/// What a state has asked for.
#[derive(Clone, Debug)]
pub(super) struct Asked {
    /// Which, among all that were asked for; copies of a state share it. Decides nothing.
    ticket: Option<u64>,
    at: Snapshot,
    /// Steps since.
    steps: u32,
    /// Age of the factor then.
    age: u32,
    /// Steps until the next may be asked for.
    hold_off: u32,
}

/// A tangent and its factor.
pub(crate) struct Renewed {
    at: Snapshot,
    factor: Factor,
    kind: TangentKind,
    fingerprint: u64,
    /// Whether it could be factored.
    sound: bool,
}

/// How factors are made beside the steps, as a linearisation has to know it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Beside {
    /// At so many times the turn that makes a factor old it is made in the step.
    pub helpless: f64,
    /// Whether no row presses on the tissue.
    pub idle: bool,
}

/// What factoring takes.
pub(crate) struct RenewScratch {
    stiffness: Vec<f64>,
    refactor: RefactorScratch,
}

impl Snapshot {
    fn at_rest(cells: usize) -> Self {
        Self {
            rotations: vec![UnitQuaternion::identity(); cells],
            stretches: vec![Matrix3::identity(); cells],
        }
    }

    fn copy_from(&mut self, other: &Self) {
        self.rotations.copy_from_slice(&other.rotations);
        self.stretches.copy_from_slice(&other.stretches);
    }
}

impl Asked {
    pub(super) fn nothing(cells: usize) -> Self {
        Self {
            ticket: None,
            at: Snapshot::at_rest(cells),
            steps: 0,
            age: 0,
            hold_off: 0,
        }
    }

    pub(super) fn forgo(&mut self) {
        self.ticket = None;
    }
}

impl PartialEq for Asked {
    fn eq(&self, other: &Self) -> bool {
        match (self.ticket, other.ticket) {
            (None, None) => self.hold_off == other.hold_off,
            (Some(_), Some(_)) => {
                (self.steps, self.age) == (other.steps, other.age) && self.at == other.at
            }
            _ => false,
        }
    }
}

impl Renewed {
    pub fn new(tissue: &CorotationalTissue) -> Self {
        Self {
            at: Snapshot::at_rest(tissue.cells()),
            factor: tissue.rest_factor.clone(),
            kind: TangentKind::Consistent,
            fingerprint: 0,
            sound: true,
        }
    }

    pub fn factor(&self) -> &Factor {
        &self.factor
    }

    pub fn is_sound(&self) -> bool {
        self.sound
    }

    /// It shall be what `state` has asked for.
    pub fn read(&mut self, state: &CorotationalState) {
        self.at.copy_from(&state.asked.at);
    }

    #[cfg(test)]
    pub fn spoil(&mut self) {
        self.sound = false;
    }
}

impl CorotationalTissue {
    pub(crate) fn renew_scratch(&self) -> RenewScratch {
        RenewScratch {
            stiffness: vec![0.0; self.pattern.entries()],
            refactor: self.rest_factor.refactor_scratch(),
        }
    }

    /// Factors the tangent that `renewed` is to be of: the consistent one, or else the projected one. Allocates
    /// nothing.
    pub(crate) fn renew(&self, renewed: &mut Renewed, scratch: &mut RenewScratch) {
        renewed.sound = false;
        for kind in [TangentKind::Consistent, TangentKind::Projected] {
            let cells = renewed.at.rotations.iter().zip(&renewed.at.stretches);
            let cells = cells.map(|(rotation, stretch)| Polar {
                rotation: matrix(rotation),
                stretch: *stretch,
            });
            self.assemble_of(cells, &mut scratch.stiffness, kind);
            let factor = &mut renewed.factor;
            if factor
                .refactor(&self.pattern, &scratch.stiffness, &mut scratch.refactor)
                .is_ok()
            {
                renewed.kind = kind;
                renewed.fingerprint = fingerprint(&scratch.stiffness);
                renewed.sound = true;
                return;
            }
        }
    }

    /// Whether the policy leaves time for factors that are made beside the steps.
    pub(crate) fn has_time(&self) -> bool {
        self.policy.refactor_rotation_rad > 0.0 && self.policy.refactor_every >= LEAST_EVERY
    }

    /// Whether it is time for another factor, with cells that have turned by so much since the last \[rad\].
    pub(super) fn is_ageing(&self, state: &CorotationalState, turn_rad: f64, idle: bool) -> bool {
        let early = EARLY * if idle { IDLE } else { 1.0 };
        turn_rad > early * self.policy.refactor_rotation_rad
            || state.age > self.policy.refactor_every
    }

    /// Whether the factor is of no help any more: at so many `times` the turn that makes it old.
    pub(super) fn is_helpless(&self, turn_rad: f64, times: f64) -> bool {
        turn_rad > times * self.policy.refactor_rotation_rad
    }

    /// Whether the factor of a state was of no help any more at the last linearisation, and what it has asked for was.
    pub(crate) fn is_in_need(&self, state: &CorotationalState, times: f64) -> bool {
        self.is_helpless(state.rotation_since_refactor(), times)
            && !self.is_helpless(state.rotation_since(&state.asked.at.rotations), times)
    }
}

impl CorotationalState {
    /// Asks for a factor of the tangent at the last update, unless one is on its way already.
    pub(super) fn ask(&mut self, workspace: &CorotationalWorkspace) -> bool {
        let asked = &mut self.asked;
        if asked.ticket.is_some() || asked.hold_off > 0 {
            return false;
        }
        asked.at.rotations.copy_from_slice(&self.rotations);
        for (to, polar) in asked.at.stretches.iter_mut().zip(&workspace.polar) {
            *to = polar.stretch;
        }
        asked.ticket = Some(NEXT_TICKET.fetch_add(1, Ordering::Relaxed));
        asked.steps = 0;
        asked.age = self.age;
        true
    }

    /// Number of what was asked for and has not come.
    pub(crate) fn ticket(&self) -> Option<u64> {
        self.asked.ticket
    }

    /// Steps since then.
    pub(crate) fn steps_since_asked(&self) -> u32 {
        self.asked.steps
    }

    /// A step begins; whether a factor is on its way.
    pub(crate) fn count_step(&mut self) -> bool {
        let asked = &mut self.asked;
        asked.hold_off = asked.hold_off.saturating_sub(1);
        asked.steps = asked
            .steps
            .saturating_add(u32::from(asked.ticket.is_some()));
        asked.ticket.is_some()
    }

    /// Takes over what it has asked for: nothing is copied.
    pub(crate) fn adopt(&mut self, renewed: &mut Renewed) {
        std::mem::swap(&mut self.factor, &mut renewed.factor);
        std::mem::swap(&mut self.factored_rotations, &mut renewed.at.rotations);
        std::mem::swap(&mut self.factored_stretches, &mut renewed.at.stretches);
        self.tangent = renewed.kind;
        self.fingerprint = renewed.fingerprint;
        self.generation += 1;
        self.age = self.age.saturating_sub(self.asked.age);
        self.asked.ticket = None;
    }

    /// Keeps the factor that it has; what it has asked for will not come.
    pub(crate) fn go_without(&mut self) {
        self.asked.ticket = None;
        self.asked.hold_off = HOLD_OFF;
    }
}
