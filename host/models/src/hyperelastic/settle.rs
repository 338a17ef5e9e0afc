//! The end of a step: what becomes of the state, and the account of work, energy and momenta.
//!
//! Entry points: [`Hyperelastic::arrive`] in dynamics, [`Hyperelastic::commit`] or [`Hyperelastic::restore`], then
//! [`Hyperelastic::diagnose`].

use super::motion::Course;
use super::newton::Balance;
use super::{Hyperelastic, State, Work};
use crate::{BoundaryConditions, Diagnostics, Outcome};
use nalgebra::Vector3;

impl Hyperelastic {
    /// From the middle of a step in dynamics to its end, in `work.passed`; returns the work done.
    pub(super) fn arrive(&mut self, course: Course) -> Result<f64, &'static str> {
        let Self {
            balance,
            state,
            work,
            ..
        } = self;
        work.passed.copy_from_slice(&state.x);
        work.velocity.copy_from_slice(&state.velocity);
        course.arrive(&work.x, &balance.held, &mut work.passed, &mut work.velocity);
        if !balance.elastic.energy(&work.passed).is_finite() {
            return Err("the end of the step has flat or inverted cells");
        }
        let acting = |node: usize| held_part(balance, node) + work.load[node];
        let nodes = work.passed.iter().zip(&state.x).enumerate();
        Ok(nodes
            .map(|(node, (to, from))| acting(node).dot(&(to - from)))
            .sum())
    }

    /// Makes what `work` holds the state.
    pub(super) fn commit(&mut self, course: Course, work_j: f64, drive: &BoundaryConditions<'_>) {
        let Self {
            balance,
            state,
            work,
            ..
        } = self;
        state.at.copy_from_slice(&work.x);
        if course.inertia > 0.0 {
            state.x.copy_from_slice(&work.passed);
            state.velocity.copy_from_slice(&work.velocity);
        } else {
            state.x.copy_from_slice(&work.x);
        }
        state.course = course;
        state.load.copy_from_slice(&work.load);
        state.work_j += work_j;
        for (node, holding) in state.holding.iter_mut().enumerate() {
            *holding = held_part(balance, node);
        }
        for (out, x) in state.positions_m.iter_mut().zip(&state.x) {
            *out = (*x).into();
        }
        state.held.clear();
        state.held.extend(drive.held.iter().map(|(node, _)| node));
        // What holds a mid-edge node is shared by its ends.
        let discrete = &balance.elastic.discrete;
        work.holding.copy_from_slice(&state.holding);
        for &edge in &discrete.boundary_ends {
            let half = 0.5 * state.holding[discrete.corners + edge as usize];
            for end in discrete.ends[edge as usize] {
                work.holding[end as usize] += half;
            }
        }
        state.reactions_n.clear();
        let reactions = state
            .held
            .iter()
            .map(|&node| <[f64; 3]>::from(work.holding[node as usize]));
        state.reactions_n.extend(reactions);
    }

    /// What is held and how masses count is as in the last good step.
    pub(super) fn restore(&mut self) {
        let (balance, state) = (&mut self.balance, &self.state);
        balance.inertia = state.course.inertia;
        balance.held.fill(false);
        for &node in &state.held {
            balance.held[node as usize] = true;
        }
        let discrete = &balance.elastic.discrete;
        for &edge in &discrete.boundary_ends {
            let [a, b] = discrete.ends[edge as usize].map(|node| balance.held[node as usize]);
            balance.held[discrete.corners + edge as usize] = a && b;
        }
    }

    pub(super) fn diagnose(
        &mut self,
        outcome: Outcome,
        iterations: u32,
        residual: f64,
    ) -> Diagnostics {
        let energy_j = self.balance.elastic.energy(&self.state.x);
        let kinetic_j = self.kinetic_j();
        let (mut momentum, mut angular) = (Vector3::zeros(), Vector3::zeros());
        let State { x, velocity, .. } = &self.state;
        for ((mass, v), x) in self.balance.masses.iter().zip(velocity).zip(x) {
            momentum += *mass * v;
            angular += *mass * x.cross(v);
        }
        let missing = self.state.work_j - energy_j - kinetic_j;
        Diagnostics {
            outcome,
            iterations,
            residual,
            force_error: outcome.force_error(residual),
            energy_j,
            energy_difference: if missing.abs() <= self.balance.energy_grain() {
                0.0
            } else {
                missing / self.state.work_j.abs()
            },
            momentum: momentum.into(),
            angular_momentum: angular.into(),
        }
    }
}

/// What holds a node \[N\]; zero for a free one.
pub(super) fn held_part(balance: &Balance, node: usize) -> Vector3<f64> {
    if balance.held[node] {
        balance.gradient[node]
    } else {
        Vector3::zeros()
    }
}

/// Work between the last balance on the way and `work.x`, shares `[done, next]` of the way \[J\].
pub(super) fn trapezoid(
    balance: &Balance,
    state: &State,
    work: &Work,
    [done, next]: [f64; 2],
) -> f64 {
    let mean = 0.5 * (done + next);
    let mut sum = 0.0;
    for (node, (to, from)) in work.x.iter().zip(&work.passed).enumerate() {
        let holding = 0.5 * (work.holding[node] + held_part(balance, node));
        let load = state.load[node] + mean * (work.load[node] - state.load[node]);
        sum += (holding + load).dot(&(to - from));
    }
    sum
}
