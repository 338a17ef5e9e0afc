//! Balance of the nodes' summed energy gradients with the loads, along conjugate directions.
//!
//! Entry point: [`run`]. One visit an iteration: the gradient at a trial step gives the curvature along the
//! direction, and with it the best step and, to second order, the gradient there (preconditioned
//! conjugate gradients after Polak and Ribiere). What zhang-2017 steps by, cell by cell and towards W = 0, is here
//! the gradient that (5.3) starts from, so the only point of rest is the balance of forces.

use super::number::Float;
use super::solver::{Core, add, dot, gradient};
use pulp::Simd;

/// Limits of a step as a share of the trial's.
const LEAST: f64 = 0.1;
const MOST: f64 = 5.0;

/// Visits all cells until the share of force out of balance is below the tolerance.
#[inline(always)]
pub(super) fn run<S: Simd, T: Float, const L: usize>(simd: S, core: &mut Core<T, L>) -> u32 {
    let memory = core.relaxation.memory();
    gradient::<S, T, L, false>(simd, &core.cells, memory, &core.u, &mut core.g);
    let acting = out_of_balance(
        &core.u,
        &core.ahead,
        &core.inertia,
        &core.force,
        &core.free,
        &mut core.g,
    );
    let enough = core.tolerance * core.tolerance * acting;
    core.rough.apply(&core.free, &core.g, &mut core.z);
    let mut rho = dot(&core.g, &core.z);
    for (d, z) in core.d.iter_mut().zip(&core.z) {
        *d = z.map(|z| -z);
    }
    let mut visits = 1;
    while visits < core.most_iterations && dot(&core.g, &core.g) > enough {
        visits += 1;
        let slope = dot(&core.d, &core.g);
        add(&mut core.u, core.stride, &core.d);
        let memory = core.relaxation.memory();
        gradient::<S, T, L, false>(simd, &core.cells, memory, &core.u, &mut core.trial);
        out_of_balance(
            &core.u,
            &core.ahead,
            &core.inertia,
            &core.force,
            &core.free,
            &mut core.trial,
        );
        // The change of the gradient from here on.
        add(&mut core.trial, -1.0, &core.g);
        let curvature = dot(&core.d, &core.trial) / core.stride;
        let best = if curvature > 0.0 {
            (-slope / curvature).clamp(LEAST * core.stride, MOST * core.stride)
        } else {
            core.stride
        };
        add(&mut core.u, best - core.stride, &core.d);
        let share = best / core.stride;
        add(&mut core.g, share, &core.trial);
        core.stride = best.clamp(1e-3, 10.0);
        core.rough.apply(&core.free, &core.g, &mut core.z);
        let turn = (share * dot(&core.z, &core.trial) / rho).max(0.0);
        rho = dot(&core.g, &core.z);
        let turn = if turn.is_finite() { turn } else { 0.0 };
        let factor = T::of(turn);
        let fields = core.d.as_flattened_mut().iter_mut();
        for (d, z) in fields.zip(core.z.as_flattened()) {
            *d = factor.fma(*d, -*z);
        }
        if dot(&core.d, &core.g) >= 0.0 {
            for (d, z) in core.d.iter_mut().zip(&core.z) {
                *d = z.map(|z| -z);
            }
        }
    }
    visits
}

/// From the elastic gradient to what free nodes lack to balance; the square of the forces that act
/// \[N^2\]: loads, and what holds the others.
#[inline(always)]
fn out_of_balance<T: Float>(
    u: &[[T; 4]],
    ahead: &[[T; 4]],
    inertia: &[T],
    force: &[[T; 4]],
    free: &[T],
    g: &mut [[T; 4]],
) -> f64 {
    let mut acting = [T::default(); 4];
    let nodes = u.iter().zip(ahead).zip(inertia).zip(force).zip(free);
    for (g, ((((u, ahead), inertia), force), free)) in g.iter_mut().zip(nodes) {
        for c in 0..4 {
            let sum = inertia.fma(u[c] - ahead[c], g[c]);
            let held = (T::of(1.0) - *free) * sum;
            acting[c] = held.fma(held, force[c].fma(force[c], acting[c]));
            g[c] = *free * (sum - force[c]);
        }
    }
    acting.iter().map(|a| a.wide()).sum()
}
