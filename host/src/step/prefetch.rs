//! Columns that a step computes ahead of need.
//!
//! Entry points: [`near_tools`], [`near_tips`].

use super::balance::{Balance, BalanceWork};
use crate::body::Body;
use crate::source::tool::NEAR;

/// Vertices whose columns a step computes for a touch to come, where a renewed factor makes them void.
const MOST_AHEAD: usize = 8;
/// Vertices whose columns a step computes ahead of a needle's tip.
const PREFETCHED: usize = 2;

/// Columns of the vertices that tools, which come `reach_m` \[m\] farther, are nearest to.
pub(super) fn near_tools(balance: &mut Balance, reach_m: f64) {
    let (body, linear) = (balance.body, balance.body.is_linear());
    // The next factor would make them void, and where none is renewed beside the steps it comes at once: but of
    // hyperelastic tissue, whose factor lasts for some steps.
    let lasts = matches!(body, Body::Hyperelastic { .. });
    let is_used = linear || lasts || balance.work.system.columns().renews();
    if balance.sources.tools.is_empty() || !is_used {
        return;
    }
    find_next(balance, reach_m);
    let left = balance.vertices_left();
    let (grasp, is_apart) = (
        &balance.state.grasp,
        balance.state.tools.contacts.is_empty(),
    );
    let BalanceWork { system, tools, .. } = &mut *balance.work;
    let next = &tools.next_nodes;
    let computed = if linear {
        system.compute_ahead(body, grasp, next, left)
    } else {
        // It can have them from the start; until then the first touch is foretold by this one.
        system.wish(next);
        let most = if lasts || is_apart {
            left.min(MOST_AHEAD)
        } else {
            0
        };
        system.compute_ahead(body, grasp, next, most)
    };
    balance.report.columns_computed += 3 * computed;
    balance.clock.lap(&mut balance.report.stages.columns_ns);
}

/// Lists the nodes that tools are nearest to.
fn find_next(balance: &mut Balance, reach_m: f64) {
    balance.find_near_tools(reach_m);
    let tools = &balance.sources.tools;
    let mut gaps = std::mem::take(&mut balance.work.tools.next_gaps);
    gaps.clear();
    let near = &balance.work.tools.near;
    for own in near.chunk_by(|a, b| a.0 == b.0) {
        let tool = own[0].0 as usize;
        let Some(placement) = &balance.state.tools.placements[tool] else {
            continue;
        };
        let solid = tools.solid(tool, placement);
        for (_, node) in own {
            let gap_m = solid.gap(&balance.position(*node));
            if gap_m < NEAR * solid.radius() + reach_m {
                gaps.push((gap_m / solid.radius(), *node));
            }
        }
    }
    gaps.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let next = &mut balance.work.tools.next_nodes;
    next.clear();
    next.extend(gaps.iter().map(|(_, node)| *node));
    balance.work.tools.next_gaps = gaps;
}

/// Columns of the cells around needles' tips and before them.
pub(super) fn near_tips(balance: &mut Balance) {
    if !balance.body.is_linear() {
        return;
    }
    let left = balance.vertices_left().min(PREFETCHED);
    let BalanceWork {
        system, needles, ..
    } = &mut *balance.work;
    let grasp = &balance.state.grasp;
    let computed = system.compute_ahead(balance.body, grasp, &needles.ahead, left);
    balance.report.columns_computed += 3 * computed;
    balance.clock.lap(&mut balance.report.stages.columns_ns);
}
