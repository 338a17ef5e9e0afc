//! Each cell a constraint C = sqrt(2 W) of compliance 1, one batch after another.
//!
//! Entry point: [`run`]. With the ease w of a node (how far a newton moves it) a cell's multiplier changes by
//! `(-C - lambda) / (sum_j w_j |dC/dx_j|^2 + 1)` and its nodes by `w_i dC/dx_i` times that (Macklin et al. 2016). In
//! motion w is the inverse mass times the square of the time step, and a step is implicit Euler. Without,
//! w is the inverse of a share of the node's own stiffness, and every iteration begins at the present stresses,
//! lambda = -C, with the step w (f - dW/dx) that they and the loads ask for: it stays where it is only
//! in balance, whatever w is and however few iterations follow.

use super::cells::{Batch, Form, Found, Memory, visit};
use super::number::Float;
use super::settings::Motion;
use super::solver::Core;
use pulp::Simd;

/// Least energy that has a direction \[J\].
const NOTHING: f64 = 1e-30;

/// The constraints; `BEGIN`: only sets the multipliers to what the present stresses are, and sums
/// the nodes' gradients.
struct Constraints<'a, T, const L: usize, const BEGIN: bool> {
    u: &'a mut [[T; 4]],
    sum: &'a mut [[T; 4]],
    ease: &'a [T],
    multiplier: &'a mut [[T; L]],
}

impl<T: Float, const L: usize, const BEGIN: bool> Form<T, L> for Constraints<'_, T, L, BEGIN> {
    const ENERGY: bool = true;
    #[inline(always)]
    fn displacement(&self) -> &[[T; 4]] {
        self.u
    }
    #[inline(always)]
    fn take(&mut self, index: usize, batch: &Batch<T, L>, found: &Found<T, L>) {
        let mut norm = [T::default(); L];
        let least = T::of(NOTHING);
        let twice = found.energy.map(|w| {
            let w = w + w;
            if w > least { w } else { least }
        });
        let multipliers = &mut self.multiplier[index];
        if BEGIN {
            for lane in 0..L {
                multipliers[lane] = -twice[lane].root();
                for k in 0..4 {
                    let sum = &mut self.sum[batch.nodes[k][lane] as usize];
                    for c in 0..3 {
                        sum[c] += found.gradient[3 * k + c][lane];
                    }
                }
            }
            return;
        }
        let ease = batch
            .nodes
            .map(|of| of.map(|node| self.ease[node as usize]));
        for k in 0..4 {
            for c in 0..3 {
                let g = &found.gradient[3 * k + c];
                for lane in 0..L {
                    norm[lane] = (ease[k][lane] * g[lane]).fma(g[lane], norm[lane]);
                }
            }
        }
        let mut by = [T::default(); L];
        for lane in 0..L {
            let c = twice[lane].root();
            let change = -(c + multipliers[lane]) / (norm[lane] / twice[lane] + T::of(1.0));
            multipliers[lane] += change;
            by[lane] = change / c;
        }
        for k in 0..4 {
            for lane in 0..L {
                let u = &mut self.u[batch.nodes[k][lane] as usize];
                let factor = ease[k][lane] * by[lane];
                for c in 0..3 {
                    u[c] = factor.fma(found.gradient[3 * k + c][lane], u[c]);
                }
            }
        }
    }
}

/// Visits all cells as often as is set.
#[inline(always)]
pub(super) fn run<S: Simd, T: Float, const L: usize>(simd: S, core: &mut Core<T, L>) -> u32 {
    let elastic = Memory {
        share: 1.0,
        stress: &[],
    };
    let quasi_static = core.motion == Motion::QuasiStatic;
    if !quasi_static {
        for ((u, ease), force) in core.u.iter_mut().zip(&core.ease).zip(&core.force) {
            for c in 0..3 {
                u[c] = ease.fma(force[c], u[c]);
            }
        }
        for multipliers in &mut core.multiplier {
            *multipliers = [T::default(); L];
        }
    }
    for _ in 0..core.most_iterations {
        if quasi_static {
            core.g.fill([T::default(); 4]);
            let mut begin = Constraints::<T, L, true> {
                u: &mut core.u,
                sum: &mut core.g,
                ease: &core.ease,
                multiplier: &mut core.multiplier,
            };
            visit(simd, &core.cells, elastic, &mut begin);
            let nodes = core.g.iter().zip(&core.force).zip(&core.ease);
            for (u, ((g, force), ease)) in core.u.iter_mut().zip(nodes) {
                for c in 0..3 {
                    u[c] = ease.fma(force[c] - g[c], u[c]);
                }
            }
        }
        let mut constraints = Constraints::<T, L, false> {
            u: &mut core.u,
            sum: &mut core.g,
            ease: &core.ease,
            multiplier: &mut core.multiplier,
        };
        visit(simd, &core.cells, elastic, &mut constraints);
    }
    core.most_iterations
}
