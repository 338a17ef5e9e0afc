//! A step: check the drive, go to it in as many parts as it takes, keep account.
//!
//! Entry point: [`Tissue`] for [`Hyperelastic`]. A part that fails is halved, from the last balance on the
//! straight way to the drive; one that succeeds is doubled.

use super::motion::{Course, Motion};
use super::newton::{End, Imbalance};
use super::settle::{held_part, trapezoid};
use super::{Hyperelastic, State};
use crate::drive_check::wrong;
use crate::{BoundaryConditions, Diagnostics, Outcome, Tangent, Tissue};
use nalgebra::Vector3;

/// The smallest part of the way.
const SMALLEST_PART: f64 = 1.0 / 4096.0;
/// Iterations after which a part that can be halved is.
const PATIENCE: u32 = 25;

impl Tissue for Hyperelastic {
    /// Iterations are those of Newton's method, each with its tangent assembled and factored. A drive
    /// with nodes that do not exist or do not ascend, or numbers that are none, fails. Quasi-static models
    /// do not look at `step_s`. The work in `energy_difference` is summed by the trapezoidal rule over the
    /// parts of each step in statics, so that it shows how coarse they were. `residual` at or below the
    /// tolerance may mean that round-off allows no less.
    fn step(&mut self, drive: &BoundaryConditions<'_>, step_s: f64) -> Diagnostics {
        let mut iterations = 0;
        let (outcome, residual) = match self.advance(drive, step_s, &mut iterations) {
            Ok((outcome, imbalance)) => (outcome, imbalance.relative(self.settings.tolerance)),
            Err(reason) => {
                self.restore();
                (Outcome::Failed(reason), f64::NAN)
            }
        };
        self.diagnose(outcome, iterations, residual)
    }

    fn positions_m(&self) -> &[[f64; 3]] {
        &self.state.positions_m
    }

    fn reactions_n(&self) -> &[[f64; 3]] {
        &self.state.reactions_n
    }

    /// Exact. `None` also before the first step, for indices beyond the drive's, and where the tangent of
    /// free nodes is not positive definite.
    fn tangent(
        &mut self,
        _drive: &BoundaryConditions<'_>,
        moved: &[usize],
        _step_s: f64,
    ) -> Option<Tangent> {
        let share = &mut self.work.share;
        share.fill(0.0);
        for &index in moved {
            share[*self.state.held.get(index)? as usize] = 1.0;
        }
        self.condensed()
    }

    /// Exact, as [`tangent`](Self::tangent) is.
    fn tangent_to_come(
        &mut self,
        _drive: &BoundaryConditions<'_>,
        touched: &[(u32, f64)],
        _step_s: f64,
    ) -> Option<Tangent> {
        if self.state.held.is_empty() {
            return None;
        }
        let (held, share) = (&mut self.balance.held, &mut self.work.share);
        share.fill(0.0);
        let corners = self.balance.elastic.discrete.corners;
        for &(node, part) in touched {
            let node = node as usize;
            if node < corners && !held[node] {
                held[node] = true;
                share[node] = part;
            }
        }
        let discrete = &self.balance.elastic.discrete;
        for &edge in &discrete.boundary_ends {
            let [a, b] = discrete.ends[edge as usize].map(|node| node as usize);
            held[discrete.corners + edge as usize] = held[a] && held[b];
        }
        let found = self.condensed();
        self.restore();
        found
    }
}

impl Hyperelastic {
    /// The tangent of what is held, each corner by the share that is in the workspace.
    fn condensed(&mut self) -> Option<Tangent> {
        let share = &mut self.work.share;
        let discrete = &self.balance.elastic.discrete;
        for &edge in &discrete.boundary_ends {
            let mid = discrete.corners + edge as usize;
            if self.balance.held[mid] {
                let [a, b] = discrete.ends[edge as usize];
                share[mid] = 0.5 * (share[a as usize] + share[b as usize]);
            }
        }
        let scale = self.state.course.share;
        let stiffness = self.balance.condensed(&self.state.at, &self.work.share)?;
        Some(Tangent {
            stiffness_n_per_m: stiffness.map(|row| row.map(|k| scale * k)),
            error: 0.0,
        })
    }

    fn advance(
        &mut self,
        drive: &BoundaryConditions<'_>,
        step_s: f64,
        iterations: &mut u32,
    ) -> Result<(Outcome, Imbalance), &'static str> {
        self.take(drive)?;
        let course = match self.settings.motion {
            Motion::Static => Course::STATIC,
            Motion::Implicit {
                drag_per_s, scheme, ..
            } => {
                if !(step_s.is_finite() && step_s > 0.0) {
                    return Err("the length of the step is not a time");
                }
                let State { x, velocity, .. } = &self.state;
                Course::plan(scheme, step_s, drag_per_s, x, velocity, &mut self.balance)
            }
        };
        // Balance is sought at this share of the way of held nodes.
        for (target, x) in self.work.target.iter_mut().zip(&self.state.x) {
            *target = x + course.share * (*target - x);
        }
        let (end, imbalance, mut work_j) = self.go(iterations)?;
        if course.inertia > 0.0 {
            work_j = self.arrive(course)?;
        }
        self.commit(course, work_j, drive);
        let outcome = match end {
            End::Converged => Outcome::Converged,
            End::Unfinished | End::Stuck => Outcome::Unfinished,
        };
        Ok((outcome, imbalance))
    }

    /// Takes held nodes, targets and loads from a drive.
    fn take(&mut self, drive: &BoundaryConditions<'_>) -> Result<(), &'static str> {
        let discrete = &self.balance.elastic.discrete;
        if let Some(reason) = wrong(drive, discrete.corners) {
            return Err(reason);
        }
        let (held, work) = (&mut self.balance.held, &mut self.work);
        held.fill(false);
        for &(node, moved) in drive.held {
            let node = node as usize;
            held[node] = true;
            work.target[node] = discrete.rest[node] + Vector3::from(moved);
        }
        for &edge in &discrete.boundary_ends {
            let [a, b] = discrete.ends[edge as usize].map(|node| node as usize);
            let mid = discrete.corners + edge as usize;
            held[mid] = held[a] && held[b];
            if held[mid] {
                work.target[mid] = 0.5 * (work.target[a] + work.target[b]);
            }
        }
        work.load.copy_from_slice(&work.own_load);
        for (load, force) in work.load.iter_mut().zip(drive.force_n) {
            *load += Vector3::from(*force);
        }
        if work.load.iter().flatten().all(|force| force.is_finite()) {
            Ok(())
        } else {
            Err("a force is not a number")
        }
    }

    /// Goes to the targets and loads in `work`, from the state to `work.x`. Returns the work done on the
    /// way as well, which means nothing in dynamics.
    fn go(&mut self, iterations: &mut u32) -> Result<(End, Imbalance, f64), &'static str> {
        let Self {
            settings,
            balance,
            state,
            work,
        } = self;
        work.x.copy_from_slice(&state.x);
        work.passed.copy_from_slice(&state.x);
        work.holding.copy_from_slice(&state.holding);
        let (mut done, mut part, mut work_j) = (0.0, 1.0 / f64::from(settings.load_steps), 0.0);
        loop {
            let next = if done + part > 1.0 - 0.5 * SMALLEST_PART {
                1.0
            } else {
                done + part
            };
            let between = |from: &Vector3<f64>, to: &Vector3<f64>| from + next * (to - from);
            for node in 0..work.x.len() {
                work.waypoint[node] = between(&state.x[node], &work.target[node]);
                balance.load[node] = between(&state.load[node], &work.load[node]);
            }
            let most = settings.most_iterations - *iterations;
            let halved = 0.5 * part >= SMALLEST_PART;
            let limit = if halved { most.min(PATIENCE) } else { most };
            let found = if balance.predict(&mut work.x, &work.waypoint) {
                Some(balance.newton(&mut work.x, settings.tolerance, limit, iterations))
            } else {
                None
            };
            let spent = *iterations >= settings.most_iterations;
            match found {
                Some((End::Converged, imbalance)) => {
                    work_j += trapezoid(balance, state, work, [done, next]);
                    if next == 1.0 {
                        return Ok((End::Converged, imbalance, work_j));
                    }
                    work.passed.copy_from_slice(&work.x);
                    for (node, holding) in work.holding.iter_mut().enumerate() {
                        *holding = held_part(balance, node);
                    }
                    done = next;
                    part *= 2.0;
                }
                // The end of the way, with numbers that can be used.
                Some((End::Unfinished, imbalance)) if spent && next == 1.0 => {
                    work_j += trapezoid(balance, state, work, [done, next]);
                    return Ok((End::Unfinished, imbalance, work_j));
                }
                _ => {
                    if !halved {
                        return Err("no balance, however small the parts of the way");
                    }
                    work.x.copy_from_slice(&work.passed);
                    part *= 0.5;
                }
            }
            if spent {
                return Err("out of iterations on the way to the drive");
            }
        }
    }
}
