//! One step of the solver, and what it reports.
//!
//! Entry point: [`step`]. Three lifetimes: [`Model`] is constant, [`State`] evolves and can be kept
//! and compared, [`Workspace`] is scratch and a cache that could be dropped between any two steps.

use crate::contact::active_set::{self, ContactWork, Failure, MAX_ROWS, Near, Row, Sphere};
use crate::contact::columns::Columns;
use crate::contact::tangent::{self, TangentWork};
use crate::model::Model;
use crate::tool::{MAX_TOOLS, ToolSample};
use nalgebra::{Matrix3, Vector3};
use std::time::Instant;

/// Longest piece of a path, in radii: short against the curvature that turns the normals.
const PIECE: f64 = 0.25;
/// Pieces that one step follows; together eight radii.
const MAX_SUBSTEPS: u32 = 32;
/// Times that a piece without balance is halved before the step gives up.
const MAX_HALVINGS: i32 = 3;
/// Vertices within this many radii of a sphere may come to be touched within a piece.
const NEAR: f64 = 0.5;

/// How a step ended. Anything but `Ok` means: send nothing, let the console's data age.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Status {
    /// Balance found at the sampled poses.
    #[default]
    Ok,
    /// A pose is not finite, or a quaternion has no length. The state is as before.
    NotFinite,
    /// A sample's id is not in the model, or is there twice. The state is as before.
    UnknownTool,
    /// Columns of the compliance are still missing for newly touched vertices; the next step goes on.
    Waiting,
    /// The tool moved farther than one step follows; the next step goes on from where this one ended.
    Behind,
    /// No stable balance found: too deep (about a radius), where the tissue would slip around the sphere;
    /// the state stays at the last pose that had one.
    NotConverged,
    /// More vertices touched than a step has room for; as `NotConverged`.
    TooManyRows,
    /// A tool's centre is inside the tissue and did not come in through the surface.
    Inside,
}

impl Status {
    /// As reports print it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::NotFinite => "not-finite",
            Self::UnknownTool => "unknown-tool",
            Self::Waiting => "waiting",
            Self::Behind => "behind",
            Self::NotConverged => "not-converged",
            Self::TooManyRows => "too-many-rows",
            Self::Inside => "inside",
        }
    }
}

/// One tool's contact, ready for the console.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct ToolContact {
    /// Which tool.
    pub id: u8,
    /// Wrench on the tool: force \[N\], then moment about the grip \[N m\], (6), world frame.
    pub wrench: [f64; 6],
    /// d wrench / d pose for left (world-frame) increments, (6 x 6) by rows \[N/m, N, N m/rad\]. Its skew
    /// part is -1/2 \[moment\]x in the rotations. Apart: as it will be just after touching.
    pub tangent: [[f64; 6]; 6],
    /// Distance along `normal` to the nearest vertex \[m\]; 0 in contact.
    pub gap_m: f64,
    /// Unit vector out of the tissue, (3).
    pub normal: [f64; 3],
    /// Touched vertices.
    pub rows: u32,
}

/// Time spent in each stage \[ns\].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct Stages {
    /// Where the boundary is and which vertices are near a tool.
    pub detect_ns: u64,
    /// New columns of the compliance.
    pub columns_ns: u64,
    /// Active set and Newton.
    pub solve_ns: u64,
    /// Wrenches and tangents.
    pub reduce_ns: u64,
}

/// What a step did.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct StepReport {
    /// How it ended.
    pub status: Status,
    contacts: [ToolContact; MAX_TOOLS],
    tools: usize,
    /// Touched vertices of all tools.
    pub rows: u32,
    /// Newton iterations, all sub-steps together.
    pub iterations: u32,
    /// Pieces into which the tools' path was cut.
    pub substeps: u32,
    /// Columns of the compliance computed, three per vertex.
    pub columns_computed: u32,
    /// Largest of gap over radius and of tangential force over largest force.
    pub residual: f64,
    /// Elastic energy that the tools have put into the tissue \[J\].
    pub stored_energy_j: f64,
    /// Time per stage.
    pub stages: Stages,
}

impl StepReport {
    /// One per sample, in the samples' order; empty unless the status is `Ok`.
    pub fn contacts(&self) -> &[ToolContact] {
        &self.contacts[..self.tools]
    }
}

/// What evolves: where the tools are and which vertices they push how.
#[derive(Clone, Debug, PartialEq)]
pub struct State {
    /// Centre of each tool's sphere at the last balance \[m\], by the tool's index; `None` before its
    /// first sample.
    centres: [Option<Vector3<f64>>; MAX_TOOLS],
    /// Touched vertices and their forces at that balance: the next solve's warm start.
    rows: Vec<Row>,
}

impl State {
    /// No tool anywhere yet, tissue at rest under its loads.
    pub fn new(model: &Model) -> Self {
        let most = MAX_ROWS.min(model.touchable.len());
        Self {
            centres: [None; MAX_TOOLS],
            rows: Vec::with_capacity(most),
        }
    }

    /// Nodes that are touched and the force on the tissue there \[N\].
    pub fn contact_forces(&self, model: &Model) -> impl Iterator<Item = (u32, [f64; 3])> {
        self.rows
            .iter()
            .map(|row| (model.touchable[row.vertex as usize], row.force.into()))
    }
}

/// Scratch and the cache of compliance columns.
pub struct Workspace {
    columns: Columns,
    contact: ContactWork,
    tangent: TangentWork,
    /// Where the touchable vertices rest without tools \[m\], (b): what displacements are added to.
    resting_m: Vec<Vector3<f64>>,
    /// Displacement of the touchable vertices \[m\], (3 b).
    displacement: Vec<f64>,
    saved: Vec<Row>,
    spheres: [Sphere; MAX_TOOLS],
    /// Vertices whose columns one step may compute before it says [`Status::Waiting`].
    pub vertices_per_step: usize,
}

impl Workspace {
    /// Empty cache; all other buffers at their largest size.
    pub fn new(model: &Model) -> Self {
        let vertices = model.touchable.len();
        Self {
            columns: Columns::new(model),
            contact: ContactWork::new(vertices),
            tangent: TangentWork::new(),
            resting_m: model.touchable_m.clone(),
            displacement: vec![0.0; 3 * vertices],
            saved: Vec::with_capacity(MAX_ROWS),
            spheres: [Sphere::default(); MAX_TOOLS],
            vertices_per_step: 8,
        }
    }

    /// Computes the columns of all boundary vertices whose resting position \[m\] satisfies `near`, so
    /// that touching them later costs nothing. Returns how many are there now.
    pub fn prepare(&mut self, model: &Model, near: impl Fn([f64; 3]) -> bool) -> usize {
        let missing: Vec<u32> = (0u32..)
            .zip(&self.resting_m)
            .filter(|(vertex, at)| near((**at).into()) && !self.columns.has(*vertex))
            .map(|(vertex, _)| vertex)
            .collect();
        self.columns.compute(model, &missing);
        self.columns.count()
    }

    /// Memory held by the cache \[bytes\].
    pub fn cache_bytes(&self) -> usize {
        self.columns.bytes()
    }
}

/// Follows the tools from where they were to where `samples` says, balances the tissue, and reduces
/// the balance to one contact per sample. A tool that is not sampled is lifted off.
///
/// Deterministic for one binary and one SIMD level. Allocates only for new columns.
pub fn step(
    model: &Model,
    state: &mut State,
    samples: &[ToolSample],
    work: &mut Workspace,
) -> StepReport {
    let mut report = StepReport::default();
    let mut clock = Clock::start();
    work.contact.iterations = 0;
    let targets = match read_samples(model, samples) {
        Ok(targets) => targets,
        Err(status) => return StepReport { status, ..report },
    };
    report.status = follow(model, state, &targets, work, &mut report, &mut clock);
    report.iterations = work.contact.iterations;
    report.rows = state.rows.len() as u32;
    report.residual = work.contact.residual;
    if report.status == Status::Ok {
        reduce(model, state, samples, &targets, work, &mut report);
    }
    clock.lap(&mut report.stages.reduce_ns);
    report
}

/// Where one tool's sphere has to go.
#[derive(Clone, Copy)]
struct Target {
    centre: Vector3<f64>,
    /// Grip to centre \[m\].
    arm: Vector3<f64>,
}

type Targets = [Option<Target>; MAX_TOOLS];

fn read_samples(model: &Model, samples: &[ToolSample]) -> Result<Targets, Status> {
    let mut targets = [None; MAX_TOOLS];
    for sample in samples {
        let (index, tool) = model.tool(sample.id).ok_or(Status::UnknownTool)?;
        let arm = tool.arm(sample).ok_or(Status::NotFinite)?;
        let centre = Vector3::from(sample.position_m) + arm;
        if !centre.norm_squared().is_finite() {
            return Err(Status::NotFinite);
        }
        if targets[index].replace(Target { centre, arm }).is_some() {
            return Err(Status::UnknownTool);
        }
    }
    Ok(targets)
}

/// Moves the spheres along straight paths in pieces short enough that no vertex ends up on the wrong
/// side of one.
fn follow(
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
        let part = advance(model, state, targets, work, 0.5f64.powi(halvings));
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
        for (centre, sphere) in state.centres.iter_mut().zip(&work.spheres) {
            *centre = sphere.present.then_some(sphere.centre);
        }
        if part >= 1.0 {
            look_ahead(model, work, report);
            clock.lap(&mut report.stages.columns_ns);
            return settle(model, state, work);
        }
        status = Status::Behind;
        halvings = 0;
    }
    if status != Status::Waiting && is_free(model, targets, work) {
        // The way there could not be followed, but nothing is touched at its end: let go.
        state.rows.clear();
        for (centre, target) in state.centres.iter_mut().zip(targets) {
            *centre = target.map(|target| target.centre);
        }
        place_spheres(model, state, work);
        locate(model, state, work);
        work.contact.residual = 0.0;
        return Status::Ok;
    }
    status
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
            state.centres[index] = None;
            continue;
        };
        if state.centres[index].is_none() {
            let radius = model.touch_radius_m(index);
            state.centres[index] =
                Some(way_in(model, &work.resting_m, target.centre, radius).ok_or(Status::Inside)?);
        }
    }
    place_spheres(model, state, work);
    Ok(())
}

fn place_spheres(model: &Model, state: &State, work: &mut Workspace) {
    for (index, sphere) in work.spheres.iter_mut().enumerate() {
        *sphere = match state.centres[index] {
            Some(centre) => Sphere {
                centre,
                radius: model.touch_radius_m(index),
                present: true,
            },
            None => Sphere::default(),
        };
    }
}

/// A free place from which a sphere can come straight to `centre`: back along the normal of the
/// nearest vertex. `None` if the centre lies inside the tissue.
fn way_in(
    model: &Model,
    resting_m: &[Vector3<f64>],
    centre: Vector3<f64>,
    radius: f64,
) -> Option<Vector3<f64>> {
    let Some((vertex, distance)) = nearest(resting_m, &centre) else {
        return Some(centre);
    };
    if model.contains(&centre) {
        return None;
    }
    let normal = model.touchable_normal[vertex];
    let mut back = (radius - distance).max(0.0);
    // Twice as far each time: after 40 times any mesh is left behind.
    for _ in 0..40 {
        let start = centre + normal * back;
        let free = nearest(resting_m, &start).is_none_or(|(_, near)| near >= radius);
        if free && !model.contains(&start) {
            return Some(start);
        }
        back = 2.0 * back.max(0.1 * radius);
    }
    None
}

fn nearest(points: &[Vector3<f64>], to: &Vector3<f64>) -> Option<(usize, f64)> {
    points
        .iter()
        .enumerate()
        .map(|(index, point)| (index, (point - to).norm_squared()))
        .min_by(|a, b| a.1.total_cmp(&b.1))
        .map(|(index, squared)| (index, squared.sqrt()))
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

/// Puts the spheres one piece further along their paths; says which part of the way that was.
fn advance(
    model: &Model,
    state: &State,
    targets: &Targets,
    work: &mut Workspace,
    shrink: f64,
) -> f64 {
    let mut part = 1.0f64;
    for (index, target) in targets.iter().enumerate() {
        if let (Some(target), Some(centre)) = (target, state.centres[index]) {
            let radius = model.touch_radius_m(index);
            let mut reach = PIECE * radius;
            if state.rows.is_empty() {
                // Nothing is touched or moves: as far as the gap goes, too.
                let gap = nearest(&work.resting_m, &centre).map_or(f64::MAX, |near| near.1);
                reach += (gap - radius).max(0.0);
            }
            let way = (target.centre - centre).norm();
            if way > reach {
                part = part.min(reach / way);
            }
        }
    }
    part *= shrink;
    for (index, target) in targets.iter().enumerate() {
        if let (Some(target), Some(centre)) = (target, state.centres[index]) {
            work.spheres[index].centre = if part >= 1.0 {
                target.centre
            } else {
                centre.lerp(&target.centre, part)
            };
        }
    }
    part
}

/// Lists the vertices that a sphere might come to touch in this piece of the path; whether one that
/// no row holds is inside its sphere.
fn find_near(state: &State, work: &mut Workspace) -> bool {
    work.contact.near.clear();
    let mut inside = false;
    for (vertex, (resting, u)) in
        (0u32..).zip(work.resting_m.iter().zip(work.displacement.chunks_exact(3)))
    {
        let at = resting + Vector3::new(u[0], u[1], u[2]);
        let mut best: Option<(f64, u32)> = None;
        for (tool, sphere) in (0u32..)
            .zip(&work.spheres)
            .filter(|(_, sphere)| sphere.present)
        {
            let gap = (at - sphere.centre).norm() / sphere.radius - 1.0;
            if gap < NEAR && best.is_none_or(|(least, _)| gap < least) {
                best = Some((gap, tool));
            }
        }
        if let Some((gap, tool)) = best {
            work.contact.near.push(Near { vertex, tool, gap });
            inside |= gap < -2.0 * active_set::DEPTH
                && !state.rows.iter().any(|row| row.vertex == vertex);
        }
    }
    inside
}

/// Balances the tissue with the spheres where they are, until no vertex anywhere is inside one.
fn balance(
    model: &Model,
    state: &mut State,
    work: &mut Workspace,
    report: &mut StepReport,
    clock: &mut Clock,
) -> Result<(), Status> {
    find_near(state, work);
    clock.lap(&mut report.stages.detect_ns);
    for _ in 0..4 {
        solve_with_columns(model, state, work, report, clock)?;
        locate(model, state, work);
        let inside = find_near(state, work);
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
            &work.spheres,
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
            Err(Failure::Missing) => {
                let now = work.contact.missing.len().min(budget(work, report));
                work.columns.compute(model, &work.contact.missing[..now]);
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

/// Vertices whose columns this step may still compute.
fn budget(work: &Workspace, report: &StepReport) -> usize {
    work.vertices_per_step
        .saturating_sub(report.columns_computed as usize / 3)
}

/// Uses what is left of the budget on the columns of the nearest vertices: the tip will be there soon.
fn look_ahead(model: &Model, work: &mut Workspace, report: &mut StepReport) {
    let columns = &work.columns;
    work.contact.near.retain(|near| !columns.has(near.vertex));
    work.contact
        .near
        .sort_unstable_by(|a, b| a.gap.total_cmp(&b.gap));
    work.contact.missing.clear();
    let now = budget(work, report);
    work.contact
        .missing
        .extend(work.contact.near.iter().take(now).map(|near| near.vertex));
    work.columns.compute(model, &work.contact.missing);
    report.columns_computed += 3 * work.contact.missing.len() as u32;
}

/// At the end of the path: a tool that touches nothing must be outside.
fn settle(model: &Model, state: &mut State, work: &mut Workspace) -> Status {
    for index in 0..MAX_TOOLS {
        let Some(centre) = state.centres[index] else {
            continue;
        };
        if state.rows.iter().any(|row| row.tool as usize == index) {
            continue;
        }
        // The surface is closed: behind the nearest vertex's tangent plane is the cheap suspicion,
        // the solid angle the proof.
        if let Some((vertex, _)) = nearest(&work.resting_m, &centre)
            && (centre - work.resting_m[vertex]).dot(&model.touchable_normal[vertex]) < 0.0
            && model.contains(&centre)
        {
            // It slipped in between vertices. Forget it, so that outside it starts afresh.
            state.centres[index] = None;
            work.spheres[index].present = false;
            return Status::Inside;
        }
    }
    Status::Ok
}

/// Whether every tool, at its target, is clear of the tissue at rest.
fn is_free(model: &Model, targets: &Targets, work: &Workspace) -> bool {
    targets.iter().zip(&work.spheres).all(|(target, sphere)| {
        target.is_none_or(|target| {
            nearest(&work.resting_m, &target.centre).is_none_or(|near| near.1 > sphere.radius)
                && !model.contains(&target.centre)
        })
    })
}

/// Wrenches, tangents, gaps and the energy at the balance.
fn reduce(
    model: &Model,
    state: &State,
    samples: &[ToolSample],
    targets: &Targets,
    work: &mut Workspace,
    report: &mut StepReport,
) {
    report.tools = samples.len();
    for (contact, sample) in report.contacts.iter_mut().zip(samples) {
        contact.id = sample.id;
        // Read once already: the id is known and its target is there.
        let Some((index, _)) = model.tool(sample.id) else {
            continue;
        };
        let Some(target) = targets[index] else {
            continue;
        };
        contact.rows = state
            .rows
            .iter()
            .filter(|row| row.tool as usize == index)
            .count() as u32;
        let (force, tangent, normal) = if contact.rows > 0 {
            let force = tangent::force(&state.rows, index as u32);
            let tangent = tangent::centre_tangent(
                &state.rows,
                index as u32,
                &mut work.contact,
                &mut work.tangent,
            );
            (
                force,
                tangent,
                force.try_normalize(0.0).unwrap_or_else(Vector3::z),
            )
        } else {
            let (gap, tangent, normal) = apart(model, index, &target.centre, work);
            contact.gap_m = gap;
            (Vector3::zeros(), tangent, normal)
        };
        contact.normal = normal.into();
        (contact.wrench, contact.tangent) = tangent::at_grip(&force, &tangent, &target.arm);
    }
    report.stored_energy_j = 0.5
        * state
            .rows
            .iter()
            .map(|row| {
                let at = 3 * row.vertex as usize;
                row.force
                    .dot(&Vector3::from_column_slice(&work.displacement[at..at + 3]))
            })
            .sum::<f64>();
}

/// Gap, tangent just after touching, and normal of a tool that touches nothing. The tangent is that
/// of the nearest vertex alone, and zero while that is too far to matter.
fn apart(
    model: &Model,
    tool: usize,
    centre: &Vector3<f64>,
    work: &Workspace,
) -> (f64, Matrix3<f64>, Vector3<f64>) {
    let displaced = |(vertex, resting): (usize, &Vector3<f64>)| {
        let u = &work.displacement[3 * vertex..3 * vertex + 3];
        let arm = centre - resting - Vector3::new(u[0], u[1], u[2]);
        (vertex as u32, arm, arm.norm())
    };
    let Some((vertex, arm, distance)) = work
        .resting_m
        .iter()
        .enumerate()
        .map(displaced)
        .min_by(|a, b| a.2.total_cmp(&b.2))
    else {
        return (f64::MAX, Matrix3::zeros(), Vector3::z());
    };
    let normal = arm / distance;
    let gap = (distance - model.touch_radius_m(tool)).max(0.0);
    let tangent = if work.columns.has(vertex) {
        let compliance = normal.dot(&(work.columns.block(vertex, vertex) * normal));
        -normal * normal.transpose() / compliance
    } else {
        Matrix3::zeros()
    };
    (gap, tangent, normal)
}

/// Nanoseconds since the last look.
struct Clock(Instant);

impl Clock {
    fn start() -> Self {
        Self(Instant::now())
    }

    fn lap(&mut self, into: &mut u64) {
        let now = Instant::now();
        *into += (now - self.0).as_nanos() as u64;
        self.0 = now;
    }
}
