//! Viscoelastic stress by a Prony series, zhang-2017 (5.29) to (5.32).
//!
//! Entry point: [`Relaxation`]. The incremental update is backward Euler, gamma' = (alpha S - gamma) / tau:
//! with A = dt alpha / (dt + tau) and B = tau / (dt + tau), gamma = A S + B gamma_before, so that during a step the
//! stress is (1 - sum A) S - sum B gamma_before, the first part from the law and the second known.

use super::cells::{Cells, Memory, gather, second_stress};
use super::number::Float;
use super::settings::Prony;

/// Stress terms of every cell.
#[derive(Clone, Debug)]
pub(super) struct Relaxation<T, const L: usize> {
    terms: Vec<Prony>,
    /// gamma of each term and batch, times volume \[J\].
    gamma: Vec<Vec<[[T; L]; 6]>>,
    /// Sum of B gamma.
    known: Vec<[[T; L]; 6]>,
    share: f64,
    step_s: f64,
}

impl<T: Float, const L: usize> Relaxation<T, L> {
    pub fn new(terms: &[Prony], cells: &Cells<T, L>) -> Self {
        let none = || vec![[[T::default(); L]; 6]; cells.batches.len()];
        Self {
            gamma: terms.iter().map(|_| none()).collect(),
            known: if terms.is_empty() { Vec::new() } else { none() },
            terms: terms.to_vec(),
            share: 1.0,
            step_s: 0.0,
        }
    }

    /// What acts during the step.
    #[inline(always)]
    pub fn memory(&self) -> Memory<'_, T, L> {
        Memory {
            share: self.share,
            stress: &self.known,
        }
    }

    /// Begins a step of `step_s`.
    pub fn begin(&mut self, step_s: f64) {
        self.step_s = step_s;
        self.share = 1.0;
        for known in self.known.as_flattened_mut().as_flattened_mut() {
            *known = T::default();
        }
        for (term, gamma) in self.terms.iter().zip(&self.gamma) {
            self.share -= step_s * term.share / (step_s + term.time_s);
            let keeps = T::of(term.time_s / (step_s + term.time_s));
            let known = self.known.as_flattened_mut().as_flattened_mut();
            let gamma = gamma.as_flattened().as_flattened();
            for (known, gamma) in known.iter_mut().zip(gamma) {
                *known = keeps.fma(*gamma, *known);
            }
        }
    }

    /// Ends it at displacements `u` (n + 1).
    pub fn end(&mut self, cells: &Cells<T, L>, u: &[[T; 4]]) {
        if self.terms.is_empty() {
            return;
        }
        for (law, run) in cells.runs.iter().enumerate() {
            for index in run.clone() {
                let batch = &cells.batches[index];
                let corners = gather(&batch.nodes, u);
                for lane in 0..L {
                    let stress = second_stress(batch, lane, &corners, law);
                    for (term, gamma) in self.terms.iter().zip(&mut self.gamma) {
                        let takes = self.step_s * term.share / (self.step_s + term.time_s);
                        let keeps = term.time_s / (self.step_s + term.time_s);
                        for (gamma, stress) in gamma[index].iter_mut().zip(stress) {
                            gamma[lane] = T::of(takes * stress + keeps * gamma[lane].wide());
                        }
                    }
                }
            }
        }
    }
}
