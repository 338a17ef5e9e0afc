//! Columns that a step computes ahead of need.
//!
//! Entry points: [`near_tools`], [`near_tips`].

use super::balance::{Balance, BalanceWork};
use super::options::StepOptions;
use super::tool_rows::MAX_TOOL_ROWS;
use crate::body::Body;
use crate::source::tool::{Contact, NEAR};
use nalgebra::Vector3;

/// Vertices whose columns a step computes for a touch to come, where a renewed factor makes them void.
const MOST_AHEAD: usize = 8;
/// The same beside a touch, which has a step compute enough: a hand slides to few, and the next factor brings them along.
const MOST_BESIDE: usize = 1;
/// Vertices whose columns a step computes ahead of a needle's tip.
const PREFETCHED: usize = 2;

/// Columns of the vertices that tools will touch, where `options` says that they may go.
pub(super) fn near_tools(balance: &mut Balance, options: &StepOptions) {
    let (body, linear) = (balance.body, balance.body.is_linear());
    // The next factor would make them void, and where none is renewed beside the steps it comes at once: but of
    // hyperelastic tissue, whose factor lasts for some steps.
    let lasts = matches!(body, Body::Hyperelastic { .. });
    let is_used = linear || lasts || balance.work.system.columns().renews();
    if balance.sources.tools.is_empty() || !is_used {
        return;
    }
    find_next(balance, options);
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
        // As many as rows can tell of. The next factor can have them from the start; until then this one foretells what comes.
        let next = &next[..next.len().min(MAX_TOOL_ROWS)];
        system.wish(next);
        let most = if lasts || is_apart {
            MOST_AHEAD
        } else if balance.report.renewals.adopted > 0 {
            0
        } else {
            MOST_BESIDE
        };
        system.compute_ahead(body, grasp, next, left.min(most))
    };
    balance.report.columns_computed += 3 * computed;
    balance.clock.lap(&mut balance.report.stages.columns_ns);
}

/// Lists the nodes that tools will touch, the soonest first: they are nearest here or where the tool may go.
fn find_next(balance: &mut Balance, options: &StepOptions) {
    let ahead_m = Vector3::from(options.ahead_m);
    balance.find_near_tools(options.reach_m + ahead_m.norm());
    let tools = &balance.sources.tools;
    let mut gaps = std::mem::take(&mut balance.work.tools.next_gaps);
    gaps.clear();
    let near = &balance.work.tools.near;
    for own in near.chunk_by(|a, b| a.0 == b.0) {
        let tool = own[0].0;
        let Some(placement) = &balance.state.tools.placements[tool as usize] else {
            continue;
        };
        let solid = tools.solid(tool as usize, placement);
        let then = solid.moved(&ahead_m);
        for (_, node) in own {
            let at = balance.position(*node);
            let gap_m = solid.gap(&at).min(then.gap(&at));
            let touches = |contact: &Contact| (contact.tool, contact.node) == (tool, *node);
            if gap_m < NEAR * solid.radius() + options.reach_m
                && !tools.is_wall(*node)
                && !balance.state.tools.contacts.iter().any(touches)
            {
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
