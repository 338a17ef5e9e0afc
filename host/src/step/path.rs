//! Follows the tools from where they were to where they are, a piece of the path at a time.
//!
//! Entry point: [`follow`].

use super::{Clock, State, Status, StepReport, Workspace};
use crate::body::View;
use crate::contact::active_set::{self, Failure, Near};
use crate::contact::entry::{Nearest, way_in};
use crate::contact::shape::Solid;
use crate::model::Model;
use crate::tool::{MAX_TOOLS, Placement, ToolSample};
use nalgebra::Vector3;

/// Pieces that one step follows; together eight radii of a sphere.
const MAX_SUBSTEPS: u32 = 32;
/// Times that a piece without balance is halved before the step gives up.
const MAX_HALVINGS: i32 = 3;
/// Vertices within this many radii of a tool may come to be touched within a piece.
pub(super) const NEAR: f64 = 0.5;
/// Vertices whose columns a step computes for a touch to come, where a renewed factor makes them void.
const MOST_AHEAD: usize = 8;

/// Where each tool's shape has to go.
pub(super) type Targets = [Option<Placement>; MAX_TOOLS];

pub(super) fn read_samples(model: &Model, samples: &[ToolSample]) -> Result<Targets, Status> {
    let mut targets = [None; MAX_TOOLS];
    for sample in samples {
        let (index, tool) = model.tool(sample.id).ok_or(Status::UnknownTool)?;
        let placement = tool.place(sample).ok_or(Status::NotFinite)?;
        if targets[index].replace(placement).is_some() {
            return Err(Status::UnknownTool);
        }
    }
    Ok(targets)
}

/// Moves the tools along straight paths in pieces short enough that no vertex ends up on the wrong side
/// of one.
pub(super) fn follow(
    model: &Model,
    state: &mut State,
    targets: &Targets,
    work: &mut Workspace,
    report: &mut StepReport,
    clock: &mut Clock,
) -> Status {
    if let Err(status) = place(model, state, targets, work) {
        return status;
    }
    locate(model, state, work);
    clock.lap(&mut report.stages.detect_ns);

    let mut halvings = 0;
    let mut status = Status::Behind;
    while report.substeps < MAX_SUBSTEPS {
        let (part, placements) = advance(model, state, targets, work, 0.5f64.powi(halvings));
        clock.lap(&mut report.stages.detect_ns);
        report.substeps += 1;
        work.saved.clone_from(&state.rows);
        if let Err(failure) = balance(model, state, work, report, clock) {
            state.rows.clone_from(&work.saved);
            locate(model, state, work);
            status = failure;
            if failure == Status::Waiting || halvings == MAX_HALVINGS {
                break;
            }
            halvings += 1;
            continue;
        }
        state.placements = placements;
        if part >= 1.0 {
            look_ahead(model, state, work, report);
            clock.lap(&mut report.stages.columns_ns);
            return settle(model, state, work);
        }
        status = Status::Behind;
        halvings = 0;
    }
    if status != Status::Waiting && is_free(model, targets) {
        // The way there could not be followed, but nothing is touched at its end: let go.
        state.rows.clear();
        state.placements = *targets;
        put(model, &state.placements, work);
        locate(model, state, work);
        find_near(state, work, 0.0);
        look_ahead(model, state, work, report);
        work.contact.newton.clear();
        work.contact.residual = 0.0;
        return Status::Ok;
    }
    status
}

/// Balances the tissue once more with the tools where [`follow`] has brought them.
pub(super) fn stay(
    model: &Model,
    state: &mut State,
    work: &mut Workspace,
    report: &mut StepReport,
    clock: &mut Clock,
) -> Status {
    locate(model, state, work);
    work.saved.clone_from(&state.rows);
    if let Err(failure) = balance(model, state, work, report, clock) {
        state.rows.clone_from(&work.saved);
        return failure;
    }
    settle(model, state, work)
}

/// Lifts tools that are not sampled and finds a way in for those that had no place before.
fn place(
    model: &Model,
    state: &mut State,
    targets: &Targets,
    work: &mut Workspace,
) -> Result<(), Status> {
    for (index, target) in targets.iter().enumerate() {
        let Some(target) = target else {
            state.rows.retain(|row| row.tool as usize != index);
            state.placements[index] = None;
            continue;
        };
        if state.placements[index].is_none() {
            let solid = model.solid(index, target);
            let out = from_outside(model, &solid).ok_or(Status::Inside)?;
            state.placements[index] = Some(Placement {
                centre: target.centre + out,
                ..*target
            });
        }
    }
    put(model, &state.placements, work);
    Ok(())
}

fn put(model: &Model, placements: &Targets, work: &mut Workspace) {
    for (index, solid) in work.solids.iter_mut().enumerate() {
        *solid = placements[index].map(|placement| model.solid(index, &placement));
    }
}

/// How far off the tool's way to where `solid` is begins, in tissue without tools.
fn from_outside(model: &Model, solid: &Solid) -> Option<Vector3<f64>> {
    let near = |solid: &Solid| {
        let (vertex, gap_m) = nearest(model.touchable_m.iter().copied(), solid)?;
        Some(Nearest {
            at: model.touchable_m[vertex],
            normal: model.touchable_normal[vertex],
            gap_m,
        })
    };
    way_in(solid, near, |point| model.contains(point))
}

/// The point with the least gap, and that gap \[m\].
pub(super) fn nearest(
    points: impl Iterator<Item = Vector3<f64>>,
    solid: &Solid,
) -> Option<(usize, f64)> {
    points
        .map(|point| solid.gap(&point))
        .enumerate()
        .min_by(|a, b| a.1.total_cmp(&b.1))
}

/// Where the touchable vertices are.
pub(super) fn displaced(work: &Workspace) -> impl Iterator<Item = Vector3<f64>> {
    let displacement = work.displacement.chunks_exact(3);
    work.resting_m
        .iter()
        .zip(displacement)
        .map(|(resting, u)| resting + Vector3::new(u[0], u[1], u[2]))
}

/// Displacement of every touchable vertex under the forces of the state.
fn locate(model: &Model, state: &State, work: &mut Workspace) {
    debug_assert_eq!(work.displacement.len(), 3 * model.touchable.len());
    work.displacement.fill(0.0);
    for row in &state.rows {
        work.columns
            .add(row.vertex, &row.force, &mut work.displacement);
    }
}

/// Puts the tools one piece further along their paths; says which part of the way that was, and where
/// they are now.
fn advance(
    model: &Model,
    state: &State,
    targets: &Targets,
    work: &mut Workspace,
    shrink: f64,
) -> (f64, Targets) {
    let mut part = 1.0f64;
    for (index, target) in targets.iter().enumerate() {
        if let (Some(target), Some(from)) = (target, &state.placements[index]) {
            let solid = model.solid(index, from);
            let mut reach = solid.piece();
            if state.rows.is_empty() {
                // Nothing is touched or moves: as far as the gap goes, too.
                let near = nearest(work.resting_m.iter().copied(), &solid);
                reach += near.map_or(f64::MAX, |near| near.1).max(0.0);
            }
            let way = (target.centre - from.centre).norm() + solid.reach() * from.angle_to(target);
            if way > reach {
                part = part.min(reach / way);
            }
        }
    }
    part *= shrink;
    let mut placements = state.placements;
    for (placement, target) in placements.iter_mut().zip(targets) {
        if let (Some(placement), Some(target)) = (placement, target) {
            *placement = placement.towards(target, part);
        }
    }
    put(model, &placements, work);
    (part, placements)
}

/// Lists the vertices that a tool might come to touch in this piece of the path, and `reach_m` farther; whether one that
/// no row of it holds is inside it.
fn find_near(state: &State, work: &mut Workspace, reach_m: f64) -> bool {
    work.contact.near.clear();
    let mut inside = false;
    let places = work.resting_m.iter().zip(work.displacement.chunks_exact(3));
    for (vertex, (resting, u)) in (0u32..).zip(places) {
        let at = resting + Vector3::new(u[0], u[1], u[2]);
        for (tool, solid) in (0u32..).zip(&work.solids) {
            let Some(solid) = solid else {
                continue;
            };
            let gap = solid.gap(&at) / solid.radius();
            if gap < NEAR + reach_m / solid.radius() {
                work.contact.near.push(Near { vertex, tool, gap });
                let held = |row: &active_set::Row| row.vertex == vertex && row.tool == tool;
                inside |= gap < -2.0 * active_set::DEPTH && !state.rows.iter().any(held);
            }
        }
    }
    inside
}

/// Balances the tissue with the tools where they are, until no vertex anywhere is inside one.
fn balance(
    model: &Model,
    state: &mut State,
    work: &mut Workspace,
    report: &mut StepReport,
    clock: &mut Clock,
) -> Result<(), Status> {
    find_near(state, work, 0.0);
    clock.lap(&mut report.stages.detect_ns);
    for _ in 0..4 {
        solve_with_columns(model, state, work, report, clock)?;
        locate(model, state, work);
        let inside = find_near(state, work, 0.0);
        clock.lap(&mut report.stages.detect_ns);
        if !inside {
            return Ok(());
        }
    }
    Err(Status::NotConverged)
}

/// Solves, computing columns that turn out to be missing as long as this step may.
fn solve_with_columns(
    model: &Model,
    state: &mut State,
    work: &mut Workspace,
    report: &mut StepReport,
    clock: &mut Clock,
) -> Result<(), Status> {
    loop {
        let solved = active_set::solve(
            &work.solids,
            &work.resting_m,
            &work.columns,
            &mut state.rows,
            &mut work.contact,
        );
        clock.lap(&mut report.stages.solve_ns);
        match solved {
            Ok(()) => return Ok(()),
            Err(Failure::TooManyRows) => return Err(Status::TooManyRows),
            Err(Failure::NotConverged) => return Err(Status::NotConverged),
            Err(Failure::Missing) if work.columns.has_worker() => {
                for &vertex in &work.contact.missing {
                    work.columns.request(vertex);
                }
                return Err(Status::Waiting);
            }
            Err(Failure::Missing) => {
                let now = work.contact.missing.len().min(budget(work, report));
                work.columns.compute(
                    &view(model, state),
                    &model.held,
                    &work.contact.missing[..now],
                );
                report.columns_computed += 3 * now as u32;
                clock.lap(&mut report.stages.columns_ns);
                if now < work.contact.missing.len() {
                    return Err(Status::Waiting);
                }
                state.rows.clone_from(&work.saved);
            }
        }
    }
}

fn view<'a>(model: &'a Model, state: &'a State) -> View<'a> {
    model.body.view(&state.motion)
}

/// Vertices whose columns this step may still compute.
pub(super) fn budget(work: &Workspace, report: &StepReport) -> usize {
    work.vertices_per_step
        .saturating_sub(report.columns_computed as usize / 3)
}

/// Uses what is left of the budget, or the worker, on the columns of the nearest vertices: the tip will be
/// there soon.
fn look_ahead(model: &Model, state: &State, work: &mut Workspace, report: &mut StepReport) {
    // The next factor would make them void, and where none is renewed beside the steps it comes at once.
    let linear = model.body.is_linear();
    if !linear && !work.columns.renews() {
        return;
    }
    if work.reach_m > 0.0 {
        find_near(state, work, work.reach_m);
    }
    work.contact.near.sort_unstable_by(|a, b| {
        let nearer = a.gap.total_cmp(&b.gap);
        nearer.then((a.vertex, a.tool).cmp(&(b.vertex, b.tool)))
    });
    if !linear {
        // It can have them from the start.
        for near in &work.contact.near {
            work.columns.wish(near.vertex);
        }
        // Until then the first touch is foretold by this one.
        if !state.rows.is_empty() {
            return;
        }
    }
    let columns = &work.columns;
    if columns.has_worker() {
        for near in &work.contact.near {
            work.columns.request(near.vertex);
        }
        return;
    }
    work.contact.missing.clear();
    let most = if linear { usize::MAX } else { MOST_AHEAD };
    let now = budget(work, report).min(most);
    for near in &work.contact.near {
        if work.contact.missing.len() >= now {
            break;
        }
        // Two tools may be near one vertex.
        if !columns.has(near.vertex) && !work.contact.missing.contains(&near.vertex) {
            work.contact.missing.push(near.vertex);
        }
    }
    work.columns
        .compute(&view(model, state), &model.held, &work.contact.missing);
    report.columns_computed += 3 * work.contact.missing.len() as u32;
}

/// At the end of the path: a tool that touches nothing must be outside.
fn settle(model: &Model, state: &mut State, work: &mut Workspace) -> Status {
    for index in 0..MAX_TOOLS {
        let Some(solid) = work.solids[index] else {
            continue;
        };
        if state.rows.iter().any(|row| row.tool as usize == index) {
            continue;
        }
        // The surface is closed: behind the nearest vertex's tangent plane is the cheap suspicion,
        // the solid angle the proof.
        let middle = solid.middle();
        if let Some((vertex, _)) = nearest(model.touchable_m.iter().copied(), &solid)
            && (middle - model.touchable_m[vertex]).dot(&model.touchable_normal[vertex]) < 0.0
            && model.contains(&middle)
        {
            // It slipped in between vertices. Forget it, so that outside it starts afresh.
            state.placements[index] = None;
            work.solids[index] = None;
            return Status::Inside;
        }
    }
    Status::Ok
}

/// Whether every tool, at its target, is clear of the tissue at rest.
fn is_free(model: &Model, targets: &Targets) -> bool {
    targets.iter().enumerate().all(|(index, target)| {
        target.is_none_or(|target| {
            let solid = model.solid(index, &target);
            nearest(model.touchable_m.iter().copied(), &solid).is_none_or(|near| near.1 > 0.0)
                && !model.contains(&solid.middle())
        })
    })
}
