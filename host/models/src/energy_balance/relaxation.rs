//! Viscoelastic stress by a Prony series, zhang-2017 (5.29) to (5.32).
//!
//! Entry point: [`Relaxation`]. The incremental update is backward Euler, gamma' = (alpha S - gamma) / tau:
//! with A = dt alpha / (dt + tau) and B = tau / (dt + tau), gamma = A S + B gamma_before, so that during a step the
//! stress is (1 - sum A) S - sum B gamma_before, the first part from the law and the second known.

use super::cells::Cells;
use super::nodes::Rows;
use super::number::{Float, Number};
use super::settings::Prony;
use super::visit::{Memory, second_stress};
use pulp::Simd;

/// Stress terms of every cell.
#[derive(Clone, Debug)]
pub(super) struct Relaxation<T, const L: usize> {
    terms: Vec<Prony>,
    /// gamma of each term and batch, times volume \[J\].
    gamma: Vec<Vec<[[T; L]; 6]>>,
    saved: Vec<Vec<[[T; L]; 6]>>,
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
            saved: terms.iter().map(|_| none()).collect(),
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

    /// Remembers the terms.
    pub fn save(&mut self) {
        for (saved, gamma) in self.saved.iter_mut().zip(&self.gamma) {
            saved.copy_from_slice(gamma);
        }
    }

    /// Goes back to them.
    pub fn restore(&mut self) {
        for (gamma, saved) in self.gamma.iter_mut().zip(&self.saved) {
            gamma.copy_from_slice(saved);
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
    #[inline(always)]
    pub fn end<S: Simd>(&mut self, simd: S, cells: &Cells<T, L>, u: &Rows<T>) {
        if !self.terms.is_empty() {
            self.end_of::<S, 0>(simd, cells, u);
            self.end_of::<S, 1>(simd, cells, u);
            self.end_of::<S, 2>(simd, cells, u);
        }
    }

    #[inline(always)]
    fn end_of<S: Simd, const LAW: u8>(&mut self, simd: S, cells: &Cells<T, L>, u: &Rows<T>) {
        let lanes = <T::Number<S> as Number<S>>::LANES;
        for index in cells.runs[LAW as usize].clone() {
            for from in (0..L).step_by(lanes) {
                let batch = &cells.batches[index];
                let stress = second_stress::<S, T, L, LAW>(simd, batch, from, u);
                for (term, gamma) in self.terms.iter().zip(&mut self.gamma) {
                    let takes = self.step_s * term.share / (self.step_s + term.time_s);
                    let keeps = term.time_s / (self.step_s + term.time_s);
                    for (gamma, stress) in gamma[index].iter_mut().zip(stress) {
                        let before = T::Number::load(simd, &gamma[from..]);
                        let now = stress.fma(stress.like(takes), before * stress.like(keeps));
                        now.store(&mut gamma[from..]);
                    }
                }
            }
        }
    }
}
