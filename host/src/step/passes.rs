//! Passes over corotational or hyperelastic tissue: linearise, find the contact forces, move the tissue.
//!
//! Entry point: [`pass`]. The first pass follows the tools along their paths, later ones balance the tissue
//! with the tools where they are. Linear tissue is followed once, as it is.

use super::path::{self, Targets};
use super::{Clock, State, Status, StepReport, Workspace};
use crate::body::Body;
use crate::fem::Moved;
use crate::model::Model;

pub(super) fn pass(
    model: &Model,
    state: &mut State,
    targets: &Targets,
    work: &mut Workspace,
    report: &mut StepReport,
    clock: &mut Clock,
) -> Status {
    // Without tools there is nothing to follow, and handles hold the tissue where it is.
    if model.body.is_linear() || model.tools.is_empty() {
        return path::follow(model, state, targets, work, report, clock);
    }
    report.renewals = model
        .body
        .begin_step(&mut state.motion, &mut work.columns, &model.held);
    let placements = state.placements;
    work.before.clone_from(&state.rows);
    state.motion.keep(&mut work.place);
    clock.lap(&mut report.stages.tissue_ns);
    loop {
        let body = &model.body;
        if let Some(balance) = body.look(&mut state.motion, &mut work.body, &work.columns) {
            report.imbalance = balance.imbalance;
            report.tangent_error = body.tangent_error(&balance);
            if report.passes > 0 && balance.imbalance <= model.passes.tolerance {
                clock.lap(&mut report.stages.tissue_ns);
                return Status::Ok;
            }
        }
        let linearised = body.linearise(&mut state.motion, &mut work.body, &mut work.columns);
        clock.lap(&mut report.stages.tissue_ns);
        if let Some(linearised) = linearised {
            if !linearised.sound {
                put_back(model, state, work, placements);
                return Status::NotConverged;
            }
            report.renewals.asked += u32::from(linearised.asked);
            if linearised.refactored {
                report.refactorisations += 1;
                report.tangent_error = 0.0;
            }
        }
        let is_free = release(model, state, work, report);
        clock.lap(&mut report.stages.columns_ns);
        if !is_free {
            return Status::Waiting;
        }
        let status = if report.passes == 0 {
            path::follow(model, state, targets, work, report, clock)
        } else {
            path::stay(model, state, work, report, clock)
        };
        // Otherwise the next step linearises about the same displacement and goes on from there.
        if !matches!(status, Status::Ok | Status::Behind) {
            return status;
        }
        let pushes = state.rows.iter().map(|row| (row.vertex, row.force));
        let moved = body.accept(&mut state.motion, &mut work.body, &work.columns, pushes);
        clock.lap(&mut report.stages.tissue_ns);
        if moved == Moved::Not {
            put_back(model, state, work, placements);
            return Status::NotConverged;
        }
        report.passes += 1;
        if report.passes >= model.passes.most {
            report.tangent_error += body.tangent_error_of_pass(&state.motion);
        }
        if status == Status::Behind || report.passes >= model.passes.most {
            // Half way there is no balance.
            if moved == Moved::Part {
                put_back(model, state, work, placements);
                return Status::NotConverged;
            }
            return status;
        }
    }
}

/// Where hyperelastic tissue cannot go the state is as before the step.
fn put_back(model: &Model, state: &mut State, work: &Workspace, placements: Targets) {
    if let Body::Hyperelastic { .. } = &model.body {
        state.motion.go_back(&work.place);
        state.rows.clone_from(&work.before);
        state.placements = placements;
    }
}

/// Where the touchable vertices are without the tools' forces, by the linearisation; whether this step
/// could compute the columns that this takes.
fn release(model: &Model, state: &State, work: &mut Workspace, report: &mut StepReport) -> bool {
    let pushed = state.motion.pushed().iter().map(|(vertex, _)| *vertex);
    let missing = &mut work.contact.missing;
    missing.clear();
    for vertex in pushed.chain(state.rows.iter().map(|row| row.vertex)) {
        if work.columns.has(vertex) {
            work.columns.keep(vertex);
        } else if !missing.contains(&vertex) {
            missing.push(vertex);
        }
    }
    let all = missing.len();
    let now = all.min(path::budget(work, report));
    let view = model.body.view(&state.motion);
    work.columns
        .compute(&view, &model.held, &work.contact.missing[..now]);
    report.columns_computed += 3 * now as u32;
    if now < all {
        return false;
    }
    // One pushed vertex at a time: its blocks lie together.
    work.displacement.fill(0.0);
    for (vertex, force) in state.motion.pushed() {
        work.columns.add(*vertex, force, &mut work.displacement);
    }
    let predicted = model.body.predicted(&work.body);
    let loaded = work.displacement.chunks_exact(3);
    for ((vertex, at), loaded) in (0u32..).zip(&mut work.resting_m).zip(loaded) {
        let first = work.columns.first_unknown(vertex);
        let unloaded = model.points_m()[model.touchable[vertex as usize] as usize];
        for axis in 0..3 {
            at[axis] = unloaded[axis] + predicted[first + axis] - loaded[axis];
        }
    }
    true
}
