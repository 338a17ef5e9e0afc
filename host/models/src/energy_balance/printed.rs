//! Zhang-2017 (5.8) and (5.9) as printed.
//!
//! Entry point: [`run`]. Cell k moves its nodes by `-w_i W_k / (sum_j w_j |dW_k/dx_j|^2) dW_k/dx_i`; a node takes the
//! sum, or the mean, over its cells. All cells look at the same positions.

use super::nodes::Rows;
use super::number::{Float, Number};
use super::solver::Core;
use super::visit::{Form, Found, Group, Memory, add_to_nodes, visit};
use pulp::Simd;

/// Least square of a gradient, by the nodes' weights, that has a direction \[J\].
const NOTHING: f64 = 1e-37;

struct Increments<'a, T> {
    u: &'a Rows<T>,
    sum: &'a mut Rows<T>,
}

impl<S: Simd, T: Float> Form<S, T> for Increments<'_, T> {
    const ENERGY: bool = true;
    #[inline(always)]
    fn field(&self) -> &Rows<T> {
        self.u
    }
    #[inline(always)]
    fn take(&mut self, group: Group<'_>, found: Found<T::Number<S>>) {
        let mut norm = found.energy.like(NOTHING);
        for k in 0..4 {
            let [x, y, z] = found.gradient[k];
            let square = z.fma(z, y.fma(y, x * x));
            norm = square.fma(found.corners[k][3], norm);
        }
        let lambda = found.energy / norm;
        let mut by = found.gradient;
        for k in 0..4 {
            let factor = -(found.corners[k][3] * lambda);
            for c in 0..3 {
                by[k][c] = factor * by[k][c];
            }
        }
        add_to_nodes(by, self.sum, group);
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
            u: core.u.rows(),
            sum: core.g.rows_mut(),
        };
        visit(simd, &core.cells, elastic, &mut increments);
        if mean {
            for (g, valence) in core.g.iter_mut().zip(&core.valence) {
                if valence.wide() > 0.0 {
                    *g = g.map(|g| g / *valence);
                }
            }
        }
        for (u, g) in core.u.iter_mut().zip(core.g.iter()) {
            for c in 0..3 {
                u[c] += g[c];
            }
        }
    }
    core.most_iterations
}
