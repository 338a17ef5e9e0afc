//! Zhang-2017 (5.8) and (5.9) as printed.
//!
//! Entry point: [`run`]. Cell k moves its nodes by `-w_i W_k / (sum_j w_j |dW_k/dx_j|^2) dW_k/dx_i`; a node takes the
//! sum, or the mean, over its cells. All cells look at the same positions.

use super::cells::{Batch, Form, Found, Memory, visit};
use super::number::Float;
use super::solver::{Core, add};
use pulp::Simd;

struct Increments<'a, T> {
    u: &'a [[T; 4]],
    ease: &'a [T],
    sum: &'a mut [[T; 4]],
}

impl<T: Float, const L: usize> Form<T, L> for Increments<'_, T> {
    const ENERGY: bool = true;
    #[inline(always)]
    fn displacement(&self) -> &[[T; 4]] {
        self.u
    }
    #[inline(always)]
    fn take(&mut self, _: usize, batch: &Batch<T, L>, found: &Found<T, L>) {
        for lane in 0..L {
            let nodes = [0, 1, 2, 3].map(|k| batch.nodes[k][lane] as usize);
            let mut norm = T::default();
            for (k, node) in nodes.iter().enumerate() {
                for c in 0..3 {
                    let g = found.gradient[3 * k + c][lane];
                    norm = (self.ease[*node] * g).fma(g, norm);
                }
            }
            if norm.wide() <= 0.0 {
                continue;
            }
            let lambda = found.energy[lane] / norm;
            for (k, node) in nodes.into_iter().enumerate() {
                for c in 0..3 {
                    let by = -(self.ease[node] * lambda * found.gradient[3 * k + c][lane]);
                    self.sum[node][c] += by;
                }
            }
        }
    }
}

/// Visits all cells as often as is set. Nodes have been moved by inertia and loads before (5.13).
#[inline(always)]
pub(super) fn run<S: Simd, T: Float, const L: usize>(
    simd: S,
    core: &mut Core<T, L>,
    mean: bool,
) -> u32 {
    let elastic = Memory {
        share: 1.0,
        stress: &[],
    };
    for _ in 0..core.most_iterations {
        core.g.fill([T::default(); 4]);
        let mut increments = Increments {
            u: &core.u,
            ease: &core.ease,
            sum: &mut core.g,
        };
        visit(simd, &core.cells, elastic, &mut increments);
        if mean {
            for (g, valence) in core.g.iter_mut().zip(&core.valence) {
                if valence.wide() > 0.0 {
                    *g = g.map(|g| g / *valence);
                }
            }
        }
        add(&mut core.u, 1.0, &core.g);
    }
    core.most_iterations
}
