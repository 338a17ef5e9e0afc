//! Balance of the nodes' summed energy gradients with the loads, along conjugate directions.
//!
//! Entry point: [`run`]. One visit an iteration: the gradient at a trial step gives the curvature along the
//! direction, and with it the best step and, to second order, the gradient there (preconditioned
//! conjugate gradients after Polak and Ribiere). What zhang-2017 steps by, cell by cell and towards W = 0, is here
//! the gradient that (5.3) starts from, so the only point of rest is the balance of forces.

use super::nodes::{groups, groups_mut, total};
use super::number::Float;
use super::solver::{Core, add, gradient};
use pulp::Simd;

/// Limits of a step as a share of the trial's.
const LEAST: f64 = 0.1;
const MOST: f64 = 5.0;
/// Limits of a trial step.
const TRIAL: (f64, f64) = (1e-3, 10.0);
/// Furthest that a node goes in a visit, as a share of a cell's edge: what the curvature says further off is no
/// guide where cells have inverted.
const FURTHEST: f64 = 0.5;

/// Visits all cells until the share of force out of balance is below the tolerance.
#[inline(always)]
pub(super) fn run<S: Simd, T: Float, const L: usize>(simd: S, core: &mut Core<T, L>) -> u32 {
    let memory = core.relaxation.memory();
    gradient::<S, T, L, false>(simd, &core.cells, memory, &core.u, &mut core.g);
    let enough = core.tolerance * core.tolerance * out_of_balance(core);
    core.d.fill([T::default(); 4]);
    core.trial.fill([T::default(); 4]);
    let (mut square, mut grain) = settle(core, 0.0, 0.0);
    let (mut share, mut rho) = (0.0, 1.0);
    let mut visits = 1;
    while visits < core.most_iterations && square > enough.max(grain) {
        visits += 1;
        core.rough.add_smooth(&core.g, &mut core.z);
        let (with_change, with_all) = answer(core);
        let turn = (share * with_change / rho).max(0.0);
        rho = with_all;
        let mut way = turn_to(core, if turn.is_finite() { turn } else { 0.0 });
        if way.slope >= 0.0 {
            way = turn_to(core, 0.0);
        }
        let most = FURTHEST * core.edge_m / way.furthest;
        let stride = core.stride.min(most);
        add(&mut core.u, stride, &core.d);
        let memory = core.relaxation.memory();
        gradient::<S, T, L, false>(simd, &core.cells, memory, &core.u, &mut core.trial);
        let curvature = change(core) / stride;
        let best = if curvature > 0.0 {
            (-way.slope / curvature)
                .clamp(LEAST * stride, MOST * stride)
                .min(most)
        } else {
            stride
        };
        core.stride = best.clamp(TRIAL.0, TRIAL.1);
        share = best / stride;
        (square, grain) = settle(core, best - stride, share);
    }
    visits
}

// Each pass below reads a group's rows, works on copies and writes them back: otherwise every store might change
// what is read next, and nothing is done side by side.

/// From the elastic gradient to what free nodes lack to balance; the square of the forces that act
/// \[N^2\]: loads, inertia, and what holds the others.
#[inline(always)]
fn out_of_balance<T: Float, const L: usize>(core: &mut Core<T, L>) -> f64 {
    let mut acting = [[T::default(); 4]; 4];
    let known = groups(&core.ahead).iter().zip(groups(&core.inertia));
    let known = known.zip(groups(&core.force)).zip(groups(&core.free));
    let nodes = groups_mut(&mut core.g).iter_mut().zip(groups(&core.u));
    for ((g, u), (((ahead, inertia), force), free)) in nodes.zip(known) {
        let mut now = *g;
        for k in 0..4 {
            for c in 0..4 {
                let slow = inertia[k][c] * (u[k][c] - ahead[k][c]);
                let sum = slow + now[k][c];
                let lack = free[k][c] * (sum - force[k][c]);
                // All of it at a held node.
                let held = sum - force[k][c] - lack;
                let slow = free[k][c] * slow;
                let squares = force[k][c].fma(force[k][c], acting[k][c]);
                acting[k][c] = slow.fma(slow, held.fma(held, squares));
                now[k][c] = lack;
            }
        }
        *g = now;
    }
    total(acting)
}

/// From the elastic gradient at the trial step to the change of what is out of balance; its product with the
/// direction.
#[inline(always)]
fn change<T: Float, const L: usize>(core: &mut Core<T, L>) -> f64 {
    let mut product = [[T::default(); 4]; 4];
    let known = groups(&core.ahead).iter().zip(groups(&core.inertia));
    let known = known.zip(groups(&core.force)).zip(groups(&core.free));
    let nodes = groups(&core.u).iter().zip(groups(&core.g));
    let nodes = nodes.zip(groups(&core.d)).zip(known);
    let trial = groups_mut(&mut core.trial).iter_mut();
    for (t, (((u, g), d), (((ahead, inertia), force), free))) in trial.zip(nodes) {
        let mut by = *t;
        for k in 0..4 {
            for c in 0..4 {
                let sum = inertia[k][c].fma(u[k][c] - ahead[k][c], by[k][c]);
                by[k][c] = free[k][c].fma(sum - force[k][c], -g[k][c]);
                product[k][c] = by[k][c].fma(d[k][c], product[k][c]);
            }
        }
        *t = by;
    }
    total(product)
}

/// Goes `by` along the direction, and takes a `share` of the change. Squares of what is out of balance, and of the
/// force that rounding displacements makes \[N^2\]. Each node's own answer goes to `z`.
#[inline(always)]
fn settle<T: Float, const L: usize>(core: &mut Core<T, L>, by: f64, share: f64) -> (f64, f64) {
    let (by, share) = (T::of(by), T::of(share));
    let mut square = [[T::default(); 4]; 4];
    let mut grain = [[T::default(); 4]; 4];
    let known = groups(&core.d).iter().zip(groups(&core.trial));
    let known = known.zip(groups(&core.own)).zip(groups(core.rough.own()));
    let nodes = groups_mut(&mut core.u).iter_mut();
    let nodes = nodes
        .zip(groups_mut(&mut core.g))
        .zip(groups_mut(&mut core.z));
    for (((u, g), z), (((d, t), own), inverse)) in nodes.zip(known) {
        let (mut placed, mut lack, mut answer) = (*u, *g, *z);
        for k in 0..4 {
            for c in 0..4 {
                placed[k][c] = by.fma(d[k][c], placed[k][c]);
                lack[k][c] = share.fma(t[k][c], lack[k][c]);
                let rounded = placed[k][c] * own[k][c];
                grain[k][c] = rounded.fma(rounded, grain[k][c]);
                square[k][c] = lack[k][c].fma(lack[k][c], square[k][c]);
            }
        }
        for k in 0..4 {
            for c in 0..4 {
                let [first, second, third] = &inverse[k];
                let sum = second[c].fma(lack[k][1], first[c] * lack[k][0]);
                answer[k][c] = third[c].fma(lack[k][2], sum);
            }
        }
        (*u, *g, *z) = (placed, lack, answer);
    }
    let half_ulp = 0.5 * T::EPSILON;
    (total(square), total(grain) * half_ulp * half_ulp)
}

/// Products of the answer with the change and with all that is out of balance.
#[inline(always)]
fn answer<T: Float, const L: usize>(core: &Core<T, L>) -> (f64, f64) {
    let mut with_change = [[T::default(); 4]; 4];
    let mut with_all = [[T::default(); 4]; 4];
    let nodes = groups(&core.trial).iter().zip(groups(&core.g));
    for (z, (t, g)) in groups(&core.z).iter().zip(nodes) {
        for k in 0..4 {
            for c in 0..4 {
                with_change[k][c] = z[k][c].fma(t[k][c], with_change[k][c]);
                with_all[k][c] = z[k][c].fma(g[k][c], with_all[k][c]);
            }
        }
    }
    (total(with_change), total(with_all))
}

/// A direction's slope, and how far it moves a node along an axis at most.
struct Way {
    slope: f64,
    furthest: f64,
}

/// From the last direction to the next.
#[inline(always)]
fn turn_to<T: Float, const L: usize>(core: &mut Core<T, L>, turn: f64) -> Way {
    let turn = T::of(turn);
    let mut slope = [[T::default(); 4]; 4];
    let mut furthest = [[T::default(); 4]; 4];
    let nodes = groups(&core.z).iter().zip(groups(&core.g));
    for (d, (z, g)) in groups_mut(&mut core.d).iter_mut().zip(nodes) {
        let mut next = *d;
        for k in 0..4 {
            for c in 0..4 {
                next[k][c] = turn.fma(next[k][c], -z[k][c]);
                slope[k][c] = next[k][c].fma(g[k][c], slope[k][c]);
                let square = next[k][c] * next[k][c];
                let most = furthest[k][c];
                furthest[k][c] = if square > most { square } else { most };
            }
        }
        *d = next;
    }
    let squares = furthest.as_flattened().iter().map(|square| square.wide());
    Way {
        slope: total(slope),
        furthest: squares.fold(f64::MIN_POSITIVE, f64::max).sqrt(),
    }
}
