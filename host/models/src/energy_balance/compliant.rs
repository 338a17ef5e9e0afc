//! Each cell a constraint C = sqrt(2 W) of compliance 1, one batch after another.
//!
//! Entry point: [`run`]. With the weight w of a node (how far a newton moves it) a cell's multiplier changes by
//! `(-C - lambda) / (sum_j w_j |dC/dx_j|^2 + 1)` and its nodes by `w_i dC/dx_i` times that (Macklin et al. 2016). In
//! motion w is the inverse mass times the square of the time step, and a step is implicit Euler. Without,
//! w is the inverse of a share of the node's own stiffness, and every iteration begins at the present stresses,
//! lambda = -C, with the step w (f - dW/dx) that they and the loads ask for: it stays where it is only
//! in balance, whatever w is and however few iterations follow. Iterations are carried on by their momentum, which is
//! zero in balance.

use super::nodes::Rows;
use super::number::{Float, Number};
use super::settings::Motion;
use super::solver::Core;
use super::visit::{Form, Found, Group, Memory, add_to_nodes, visit};
use pulp::Simd;

/// Least energy that has a direction \[J\].
const NOTHING: f64 = 1e-30;

/// Sets the multipliers to what the present stresses are, and sums the nodes' gradients.
struct Begin<'a, T, const L: usize> {
    u: &'a Rows<T>,
    sum: &'a mut Rows<T>,
    multiplier: &'a mut [[T; L]],
}

impl<S: Simd, T: Float, const L: usize> Form<S, T> for Begin<'_, T, L> {
    const ENERGY: bool = true;
    #[inline(always)]
    fn field(&self) -> &Rows<T> {
        self.u
    }
    #[inline(always)]
    fn take(&mut self, group: Group<'_>, found: Found<T::Number<S>>) {
        let w = found.energy;
        let c = (w + w).most(w.like(NOTHING)).root();
        (-c).store(&mut self.multiplier[group.batch][group.from..]);
        add_to_nodes(found.gradient, self.sum, group);
    }
}

/// Moves the nodes of one batch after another.
struct Constraints<'a, S, T, const L: usize> {
    simd: S,
    u: &'a mut Rows<T>,
    multiplier: &'a mut [[T; L]],
}

impl<S: Simd, T: Float, const L: usize> Form<S, T> for Constraints<'_, S, T, L> {
    const ENERGY: bool = true;
    #[inline(always)]
    fn field(&self) -> &Rows<T> {
        self.u
    }
    #[inline(always)]
    fn take(&mut self, group: Group<'_>, found: Found<T::Number<S>>) {
        let w = found.energy;
        let twice = (w + w).most(w.like(NOTHING));
        let mut norm = w.like(0.0);
        for k in 0..4 {
            let [x, y, z] = found.gradient[k];
            let square = z.fma(z, y.fma(y, x * x));
            norm = square.fma(found.corners[k][3], norm);
        }
        let c = twice.root();
        let multipliers = &mut self.multiplier[group.batch][group.from..];
        let before = T::Number::load(self.simd, multipliers);
        let change = -(c + before) / (norm / twice + w.like(1.0));
        (before + change).store(multipliers);
        let by = change / c;
        let mut corners = found.corners;
        for k in 0..4 {
            let factor = by * corners[k][3];
            for axis in 0..3 {
                corners[k][axis] = factor.fma(found.gradient[k][axis], corners[k][axis]);
            }
        }
        // Written out: a loop of this size would go through memory.
        T::Number::put(corners[0], self.u, group.nodes[0]);
        T::Number::put(corners[1], self.u, group.nodes[1]);
        T::Number::put(corners[2], self.u, group.nodes[2]);
        T::Number::put(corners[3], self.u, group.nodes[3]);
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
        for (u, force) in core.u.iter_mut().zip(&core.force) {
            for c in 0..3 {
                u[c] = u[3].fma(force[c], u[c]);
            }
        }
        for multipliers in &mut core.multiplier {
            *multipliers = [T::default(); L];
        }
    }
    core.d.copy_from_slice(&core.u);
    let mut since_restart = 0.0;
    for iteration in 0..core.most_iterations {
        if quasi_static {
            core.trial.copy_from_slice(&core.u);
            core.g.fill([T::default(); 4]);
            let mut begin = Begin {
                u: core.u.rows(),
                sum: core.g.rows_mut(),
                multiplier: &mut core.multiplier,
            };
            visit(simd, &core.cells, elastic, &mut begin);
            for (u, (g, force)) in core.u.iter_mut().zip(core.g.iter().zip(&core.force)) {
                for c in 0..3 {
                    u[c] = u[3].fma(force[c] - g[c], u[c]);
                }
            }
        }
        let mut constraints = Constraints {
            simd,
            u: core.u.rows_mut(),
            multiplier: &mut core.multiplier,
        };
        visit(simd, &core.cells, elastic, &mut constraints);
        if quasi_static && iteration + 1 < core.most_iterations {
            since_restart = go_on(core, since_restart);
        }
    }
    core.most_iterations
}

/// Carries the last iteration's way on (Nesterov 1983), from the start again where it leads against the next one
/// (O'Donoghue and Candes 2015). Where an iteration stands still, so does this.
#[inline(always)]
fn go_on<T: Float, const L: usize>(core: &mut Core<T, L>, since_restart: f64) -> f64 {
    let mut against = 0.0;
    for ((u, from), last) in core.u.iter().zip(core.trial.iter()).zip(&core.d) {
        for c in 0..3 {
            against += ((from[c] - u[c]) * (u[c] - last[c])).wide();
        }
    }
    let since_restart = if against > 0.0 {
        0.0
    } else {
        since_restart + 1.0
    };
    let share = T::of(since_restart / (since_restart + 3.0));
    for (u, last) in core.u.iter_mut().zip(&mut core.d) {
        for c in 0..3 {
            let here = u[c];
            u[c] = share.fma(here - last[c], here);
            last[c] = here;
        }
    }
    since_restart
}
