//! Newton's method for the balance of free nodes: the least potential with some nodes held.
//!
//! Entry points: [`Balance::newton`], [`Balance::predict`]. The potential is elastic energy less the work
//! of dead loads, plus `inertia / 2 m |x - anchor|^2` in dynamics, where the step of an implicit method is
//! a minimum as well. Steps are halved until the potential falls: a flat or inverted cell has none.

use super::elastic::Elastic;
use super::factor::Factor;
use crate::BuildError;
use nalgebra::Vector3;

/// Least share of the fall that the slope promises (Armijo).
const FALL: f64 = 1e-4;
const MOST_HALVINGS: u32 = 40;

/// Elasticity, what acts on it, and buffers.
pub(super) struct Balance {
    pub elastic: Elastic,
    factor: Factor,
    /// Tangent at the last state it was wanted for, (entries of the pattern).
    values: Vec<f64>,
    /// Held nodes, (nodes).
    pub held: Vec<bool>,
    /// Force on every node \[N\].
    pub load: Vec<Vector3<f64>>,
    /// Mass of every node \[kg\]; zeros in statics.
    pub masses: Vec<f64>,
    /// Weight of inertia \[1/s^2\]; zero in statics.
    pub inertia: f64,
    /// Where inertia alone would take every node \[m\].
    pub anchor: Vec<Vector3<f64>>,
    /// Force out of balance of every node after [`Self::imbalance`]; at a held node, what holds it \[N\].
    pub gradient: Vec<Vector3<f64>>,
    trial: Vec<Vector3<f64>>,
    product: Vec<Vector3<f64>>,
    columns: Vec<f64>,
    grain: f64,
    energy_grain: f64,
    size: f64,
}

/// 2-norms \[N\].
#[derive(Clone, Copy)]
pub(super) struct Imbalance {
    /// Force out of balance at free nodes.
    pub free: f64,
    /// Largest of loads, what holds the held nodes, and inertia.
    pub acting: f64,
    /// What round-off leaves of `free`.
    pub round_off: f64,
}

impl Imbalance {
    /// As a share of the forces that act; at or below `tolerance` if as small as round-off allows.
    pub fn relative(self, tolerance: f64) -> f64 {
        let least = self.round_off / tolerance;
        if self.free == 0.0 {
            0.0
        } else {
            self.free / self.acting.max(least)
        }
    }
}

#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum End {
    Converged,
    /// Out of iterations.
    Unfinished,
    /// No way down, or numbers that are none.
    Stuck,
}

impl Balance {
    pub fn new(elastic: Elastic) -> Result<Self, BuildError> {
        let nodes = elastic.discrete.rest.len();
        let zeros = || vec![Vector3::zeros(); nodes];
        let [low, high] = [f64::min, f64::max].map(|pick| {
            let rest = elastic.discrete.rest.iter();
            rest.copied()
                .reduce(|a, b| a.zip_map(&b, pick))
                .unwrap_or_default()
        });
        Ok(Self {
            factor: Factor::new(&elastic.pattern)?,
            values: vec![0.0; elastic.pattern.entries()],
            held: vec![false; nodes],
            load: zeros(),
            masses: vec![0.0; nodes],
            inertia: 0.0,
            anchor: zeros(),
            gradient: zeros(),
            trial: zeros(),
            product: zeros(),
            columns: vec![0.0; 9 * nodes],
            grain: elastic.grain(),
            energy_grain: 4.0 * f64::EPSILON * elastic.stiffness_volume(),
            size: (high - low).norm(),
            elastic,
        })
    }

    /// Round-off in the potential \[J\].
    pub fn energy_grain(&self) -> f64 {
        self.energy_grain
    }

    /// Potential \[J\]; not finite where the elastic energy is not.
    fn potential(&mut self, x: &[Vector3<f64>]) -> f64 {
        let rest = &self.elastic.discrete.rest;
        let mut sum = 0.0;
        for (node, x) in x.iter().enumerate() {
            sum -= self.load[node].dot(&(x - rest[node]));
            if self.inertia > 0.0 {
                sum +=
                    0.5 * self.inertia * self.masses[node] * (x - self.anchor[node]).norm_squared();
            }
        }
        sum + self.elastic.energy(x)
    }

    /// Fills [`Self::gradient`].
    pub fn imbalance(&mut self, x: &[Vector3<f64>]) -> Imbalance {
        self.gradient.fill(Vector3::zeros());
        self.elastic.gradient(x, &mut self.gradient);
        let [mut free, mut holding, mut load, mut inertial, mut heavy] = [0.0; 5];
        let mut far: f64 = 0.0;
        for (node, gradient) in self.gradient.iter_mut().enumerate() {
            let weight = self.inertia * self.masses[node];
            let inertia = weight * (x[node] - self.anchor[node]);
            *gradient += inertia - self.load[node];
            inertial += inertia.norm_squared();
            load += self.load[node].norm_squared();
            heavy += weight * weight;
            far = far.max(x[node].amax()).max(self.size);
            if self.held[node] {
                holding += gradient.norm_squared();
            } else {
                free += gradient.norm_squared();
            }
        }
        Imbalance {
            free: free.sqrt(),
            acting: load.max(holding).max(inertial).sqrt(),
            round_off: far * (self.grain + 4.0 * f64::EPSILON * heavy.sqrt()),
        }
    }

    /// Assembles and factors the tangent at `x`; returns the shift that made it positive definite, zero
    /// for none.
    pub fn factor_tangent(&mut self, x: &[Vector3<f64>]) -> Option<f64> {
        self.elastic.tangent(x, false, &mut self.values);
        let pattern = &self.elastic.pattern;
        if self.inertia > 0.0 {
            for unknown in 0..pattern.unknowns {
                self.values[pattern.diagonal(unknown)] += self.inertia * self.masses[unknown / 3];
            }
        }
        self.factor.factor(pattern, &self.values, &self.held)
    }

    /// Moves held nodes to their `targets` and the others as the tangent says. False: no finite state.
    pub fn predict(&mut self, x: &mut [Vector3<f64>], targets: &[Vector3<f64>]) -> bool {
        let nodes = x.len();
        let mut most: f64 = 0.0;
        for node in 0..nodes {
            self.trial[node] = if self.held[node] {
                targets[node] - x[node]
            } else {
                Vector3::zeros()
            };
            most = most.max(self.trial[node].amax());
        }
        if most == 0.0 {
            return true;
        }
        if !self.imbalance(x).free.is_finite() || self.factor_tangent(x).is_none() {
            return false;
        }
        self.elastic
            .pattern
            .multiply(&self.values, &self.trial, &mut self.product);
        self.solve_free(|gradient, product| -gradient - product);
        for (node, x) in x.iter_mut().enumerate() {
            *x = if self.held[node] {
                targets[node]
            } else {
                *x + self.direction(node)
            };
        }
        self.potential(x).is_finite()
    }

    /// Goes to balance from `x`, held nodes where they are, with at most `limit` iterations, counted in
    /// `iterations`.
    pub fn newton(
        &mut self,
        x: &mut [Vector3<f64>],
        tolerance: f64,
        limit: u32,
        iterations: &mut u32,
    ) -> (End, Imbalance) {
        let mut made = 0;
        loop {
            let imbalance = self.imbalance(x);
            if !imbalance.free.is_finite() {
                return (End::Stuck, imbalance);
            }
            if imbalance.relative(tolerance) <= tolerance {
                return (End::Converged, imbalance);
            }
            if made == limit {
                return (End::Unfinished, imbalance);
            }
            made += 1;
            *iterations += 1;
            if self.factor_tangent(x).is_none() {
                return (End::Stuck, imbalance);
            }
            self.solve_free(|gradient, _| -gradient);
            if !self.descend(x) {
                return (End::Stuck, imbalance);
            }
        }
    }

    /// Along the direction until the potential falls.
    fn descend(&mut self, x: &mut [Vector3<f64>]) -> bool {
        let (mut slope, mut longest) = (0.0, 0.0f64);
        for node in 0..x.len() {
            let direction = self.direction(node);
            slope += self.gradient[node].dot(&direction);
            longest = longest.max(direction.norm());
        }
        if !(slope < 0.0 && longest.is_finite()) {
            return false;
        }
        let before = self.potential(x);
        // Nothing is known beyond the tissue's own size.
        let mut share = (self.size / longest).min(1.0);
        let mut trial = std::mem::take(&mut self.trial);
        let mut found = false;
        for _ in 0..MOST_HALVINGS {
            for (node, trial) in trial.iter_mut().enumerate() {
                *trial = x[node] + share * self.direction(node);
            }
            let after = self.potential(&trial);
            if after <= before + FALL * share * slope + self.energy_grain {
                x.copy_from_slice(&trial);
                found = true;
                break;
            }
            // Lowest point of the parabola through what is known.
            let bend = after - before - slope * share;
            let lowest = -0.5 * slope * share * share / bend;
            share = if lowest.is_finite() {
                lowest.clamp(0.1 * share, 0.5 * share)
            } else {
                0.5 * share
            };
        }
        self.trial = trial;
        found
    }

    /// Solves for free nodes; the right-hand side of a node comes from its gradient and product.
    fn solve_free(&mut self, rhs: impl Fn(Vector3<f64>, Vector3<f64>) -> Vector3<f64>) {
        let nodes = self.held.len();
        for node in 0..nodes {
            let force = if self.held[node] {
                Vector3::zeros()
            } else {
                rhs(self.gradient[node], self.product[node])
            };
            self.columns[3 * node..3 * node + 3].copy_from_slice(force.as_slice());
        }
        self.factor.solve(&mut self.columns[..3 * nodes]);
    }

    fn direction(&self, node: usize) -> Vector3<f64> {
        Vector3::from_column_slice(&self.columns[3 * node..3 * node + 3])
    }

    /// B' (K - K F^-1 K) B, where F^-1 acts on free nodes and B moves each held node by `share` of a common
    /// displacement. `None` where the tangent is not positive definite.
    pub fn condensed(&mut self, x: &[Vector3<f64>], share: &[f64]) -> Option<[[f64; 3]; 3]> {
        if self.factor_tangent(x)? > 0.0 {
            return None;
        }
        let nodes = x.len();
        let mut stiffness = [[0.0; 3]; 3];
        let pattern = &self.elastic.pattern;
        for column in 0..3 {
            for (trial, share) in self.trial.iter_mut().zip(share) {
                *trial = Vector3::zeros();
                trial[column] = *share;
            }
            pattern.multiply(&self.values, &self.trial, &mut self.product);
            let rhs = &mut self.columns[3 * nodes * column..3 * nodes * (column + 1)];
            for node in 0..nodes {
                for axis in 0..3 {
                    let force = self.product[node][axis];
                    stiffness[axis][column] += share[node] * force;
                    rhs[3 * node + axis] = if self.held[node] { 0.0 } else { force };
                }
            }
        }
        self.factor.solve(&mut self.columns);
        for row in 0..3 {
            for (trial, share) in self.trial.iter_mut().zip(share) {
                *trial = Vector3::zeros();
                trial[row] = *share;
            }
            pattern.multiply(&self.values, &self.trial, &mut self.product);
            for (column, stiffness) in stiffness[row].iter_mut().enumerate() {
                let solved = &self.columns[3 * nodes * column..3 * nodes * (column + 1)];
                for (node, solved) in solved.chunks_exact(3).enumerate() {
                    if !self.held[node] {
                        *stiffness -= (0..3)
                            .map(|axis| self.product[node][axis] * solved[axis])
                            .sum::<f64>();
                    }
                }
            }
        }
        stiffness
            .iter()
            .flatten()
            .all(|k| k.is_finite())
            .then_some(stiffness)
    }
}
