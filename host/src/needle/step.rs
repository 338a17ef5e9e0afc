//! One step of a scene with needles, and what it reports of them.
//!
//! Entry point: [`step`]. A tool's way is followed in pieces, a balance at the end of each; then
//! every tool gets its wrench and tangent, every needle its report.

use super::drive::{Drive, NeedleWork, about, position};
use super::kept::Kept;
use super::model::{MAX_NEEDLES, Needles};
use super::state::{Grip, NeedleState, Tip};
use super::tangent::{Moves, Pull, TangentWork, slide_twist};
use super::threads::{report_threads, thread_ends};
use super::{Curve, NeedlePart, Wanted};
use crate::anchors::{Grasp, System};
use crate::body::{Body, Motion};
use crate::clock::Clock;
use crate::collide::TouchState;
use crate::fem::Moved;
use crate::model::Model;
use crate::source::tool::{Cones, NEAR, Placements, ToolContacts};
use crate::step::{MAX_TOOL_ROWS, ToolRows};
use crate::step::{Status, StepReport};
use crate::thread::{MOST_SEGMENTS, ThreadHold, ThreadState};
use crate::tool::{MAX_TOOLS, ToolSample};
use nalgebra::{Isometry3, Matrix6, Quaternion, Translation3, UnitQuaternion, Vector3, Vector6};
use serde::Serialize;

/// Pieces that one step follows.
const MAX_PIECES: u32 = 32;
/// Times that a piece without balance is halved before the step gives up.
const MAX_HALVINGS: i32 = 3;
/// Largest turn of a piece \[rad\]: the tip's path is taken as straight within one.
const MOST_TURN: f64 = 0.1;
/// As far ahead of a tip outside the next boundary is looked for \[m\].
const LOOK_M: f64 = 0.005;

/// Where a needle's tip is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TipPlace {
    /// Outside the tissue.
    #[default]
    Outside,
    /// It holds a boundary face, from either side.
    Holding,
    /// Inside.
    Inside,
    /// The needle was put here, into the tissue, without a way that led in: it touches nothing until all of it has been
    /// outside once. See [`crate::step::State::put`].
    Waiting,
}

/// What a step found about one needle.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct NeedleReport {
    /// Which needle.
    pub id: u8,
    /// The tool that holds it.
    pub held_by: Option<u8>,
    /// Where its tip is.
    pub tip: TipPlace,
    /// Faces that it goes through.
    pub crossings: u32,
    /// Boundary faces that it has broken through so far.
    pub punctures: u32,
    /// Whether all that rubs slides.
    pub slides: bool,
    /// Wrench of the tissue on it, along its slide \[N\]: below zero against driving.
    pub axial_n: f64,
    /// Largest axial force of friction and cutting, forward and backward \[N\].
    pub limit_n: [f64; 2],
    /// Axial force of the tip on the face that it holds \[N\].
    pub hold_n: f64,
    /// Axial force that breaks through it \[N\]; infinite for never, 0 when it holds none.
    pub puncture_n: f64,
    /// Stiffness against its slide \[N/m\]: if all stuck, and as it is.
    pub stiffness_n_per_m: [f64; 2],
    /// Its slide as a twist of the grip per metre: linear, then angular \[1/m\].
    pub slide: [f64; 6],
    /// Spent so far \[J\]: by friction, cutting, and forces let go.
    pub dissipated_j: [f64; 3],
    /// Times so far that the way through the cells was guessed by its direction, or lost, or that tissue folded
    /// so far that crossings would have changed places.
    pub guessed: u32,
}

/// What evolves about the needles of a scene.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct NeedlesState {
    pub grasp: Grasp,
    pub each: Vec<NeedleState>,
    pub threads: Vec<ThreadState>,
    pub touch: Option<TouchState>,
    #[serde(skip_serializing_if = "ToolContacts::touch_nothing")]
    pub tools: ToolContacts,
    time_us: u64,
}

/// Scratch.
pub(crate) struct NeedlesWork {
    pub drive: NeedleWork,
    tangent: TangentWork,
    ahead: Vec<u32>,
    cones: Option<Cones>,
    /// Of tools that touch, at the last step's balance.
    pub rows: Vec<ToolRows>,
    /// Of hyperelastic tissue.
    kept: Option<Box<Kept>>,
}

impl NeedlesState {
    pub fn new(needles: &Needles, motion: Motion) -> Self {
        let settings = needles.anchor_settings();
        let mut grasp = Grasp::new(motion, &settings);
        let mut touch = needles
            .touching
            .as_ref()
            .map(|touching| TouchState::new(touching, &needles.resting_m));
        if let (Some(rest), Some(touch)) = (&needles.rest, &mut touch) {
            grasp.copy_rows(&rest.grasp);
            touch.copy_from(&rest.touch);
        }
        Self {
            grasp,
            each: needles
                .parts
                .iter()
                .map(|part| NeedleState::new(part, &needles.settings))
                .collect(),
            threads: needles
                .threads
                .parts
                .iter()
                .map(|part| ThreadState::new(part, MOST_SEGMENTS))
                .collect(),
            touch,
            tools: ToolContacts::new(&needles.tools),
            time_us: 0,
        }
    }
}

impl NeedlesWork {
    pub fn new(model: &Model, needles: &Needles) -> Self {
        let settings = needles.anchor_settings();
        let state = NeedlesState::new(needles, model.motion.clone());
        let mut groups = vec![Vec::new(); needles.hierarchy.groups()];
        for (group, face) in needles.hierarchy.grouped_faces() {
            groups[group].extend(needles.mesh.vertices(face));
        }
        for group in &mut groups {
            group.sort_unstable();
            group.dedup();
        }
        let (body, reached) = (&model.body, model.reached(needles));
        let held = &model.held;
        let system = System::grouped(body, &model.motion, held, &reached, settings, &groups);
        Self {
            drive: NeedleWork::new(
                needles,
                system,
                &state.each,
                &state.threads,
                state.touch.as_ref(),
                &state.grasp,
            ),
            tangent: TangentWork::new(
                settings.most_rows + settings.most_spread,
                needles.tools.most_contacts(),
            ),
            cones: needles
                .tools
                .cones(settings.most_rows + settings.most_spread),
            rows: Vec::with_capacity(MAX_TOOLS),
            // A cell and its neighbours around each tip, and one that lies ahead.
            ahead: Vec::with_capacity(24 * MAX_NEEDLES),
            kept: matches!(model.body, Body::Hyperelastic { .. })
                .then(|| Box::new(Kept::new(needles, &state))),
        }
    }
}

impl NeedlesWork {
    /// Where hyperelastic tissue cannot go the state is as before the step.
    fn put_back(&mut self, state: &mut NeedlesState) {
        if let Some(kept) = &self.kept {
            kept.put_back(state);
            // What is asked for places under these needs their columns, and no others are fetched.
            self.drive.pushes.clear();
            self.drive
                .pushes
                .extend_from_slice(state.grasp.motion().pushed());
        }
    }

    /// Computes the columns of all nodes whose resting position \[m\] satisfies `near`; how many are there.
    pub fn prepare(
        &mut self,
        model: &Model,
        needles: &Needles,
        near: impl Fn([f64; 3]) -> bool,
    ) -> usize {
        let near = |(node, at): (u32, &[f64; 3])| near(*at).then_some(node);
        let mut nodes: Vec<u32> = (0u32..).zip(&model.resting_m).filter_map(near).collect();
        // What acts before the first step acts in it.
        let rest = needles.rest.as_ref().into_iter();
        let acting = rest.flat_map(|rest| rest.grasp.pushes());
        nodes.extend(acting.filter_map(|(vertex, _)| model.node_of(needles, vertex)));
        nodes.extend(needles.handles.loads().map(|load| load.node));
        self.drive
            .system
            .prepare(&model.body, &model.motion, &nodes)
    }
}

/// Follows the tools with the needles that they hold. `samples` have been looked at: known, finite, once each.
#[expect(clippy::too_many_arguments, reason = "they are the step")]
pub(crate) fn step(
    model: &Model,
    needles: &Needles,
    state: &mut NeedlesState,
    (samples, tools): (&[ToolSample], &Placements),
    wanted: &Wanted,
    work: &mut NeedlesWork,
    report: &mut StepReport,
    clock: &mut Clock,
) -> Status {
    work.rows.clear();
    let tools = needles.tools.targets(tools);
    if !state
        .tools
        .bring_in(&needles.tools, &tools, |at| model.contains(at))
    {
        return Status::Inside;
    }
    work.drive.system.begin_step();
    report.renewals = work.drive.system.take_over(&model.body, &mut state.grasp);
    clock.lap(&mut report.stages.tissue_ns);
    let count = state.each.len();
    let mut speeds = [0.0; MAX_NEEDLES];
    for (speed, each) in speeds.iter_mut().zip(&state.each) {
        *speed = each.speed;
    }
    let mut targets = [Isometry3::identity(); MAX_NEEDLES];
    for (target, each) in targets.iter_mut().zip(&mut state.each) {
        *target = each.pose;
        let held_by = each.grip.and_then(|grip| {
            let sample = samples.iter().find(|sample| sample.id == grip.tool);
            sample.and_then(|sample| Some(pose_of(sample)? * grip.needle))
        });
        if let Some(pose) = held_by {
            *target = pose;
        }
    }
    let mut ends = [[Vector3::zeros(); 2]; MAX_NEEDLES];
    for (ends, thread) in ends.iter_mut().zip(&state.threads) {
        *ends = [thread.tail, thread.head].map(|hold| match hold.by {
            ThreadHold::Tool(tool) => {
                let sample = samples.iter().find(|sample| sample.id == tool);
                sample.map_or(hold.at, |sample| Vector3::from(sample.position_m))
            }
            _ => hold.at,
        });
    }
    let time_us = samples.iter().map(|sample| sample.console_time_us).max();
    let passed_s = time_us.map_or(0.0, |now| 1e-6 * now.saturating_sub(state.time_us) as f64);
    for ((each, target), part) in state.each.iter_mut().zip(&targets).zip(&needles.parts) {
        let (from, to) = (part.needle.at(&each.pose), part.needle.at(target));
        let middle = 0.5 * from.length;
        let slide = from.project(&to.at(middle), middle) - middle;
        each.speed = if passed_s > 0.0 {
            slide / passed_s
        } else {
            0.0
        };
    }
    if let Some(kept) = &mut work.kept {
        kept.keep(state);
    }
    let status = loop {
        let body = &model.body;
        if let Some(balance) = work.drive.system.look(body, &mut state.grasp) {
            report.imbalance = balance.imbalance;
            report.tangent_error = body.tangent_error(&balance);
            if report.passes > 0 && balance.imbalance <= model.passes.tolerance {
                break Status::Ok;
            }
        }
        let linearised = work.drive.system.linearise(body, &mut state.grasp);
        clock.lap(&mut report.stages.tissue_ns);
        if let Some(linearised) = linearised {
            if !linearised.sound {
                break Status::NotConverged;
            }
            report.renewals.asked += u32::from(linearised.asked);
            if linearised.refactored {
                report.refactorisations += 1;
                report.tangent_error = 0.0;
            }
        }
        if let Some(kept) = work.kept.as_ref().filter(|_| report.passes > 0) {
            kept.begin_again(state);
            report.substeps = 0;
        }
        let status = follow(
            model,
            needles,
            state,
            &Targets {
                needles: &targets[..count],
                threads: &ends[..state.threads.len()],
                tools: &tools,
            },
            work,
            report,
            clock,
        );
        if !matches!(status, Status::Ok | Status::Behind) || body.is_linear() {
            break status;
        }
        let moved = work.drive.system.accept(body, &mut state.grasp);
        clock.lap(&mut report.stages.tissue_ns);
        if moved == Moved::Not {
            break Status::NotConverged;
        }
        report.passes += 1;
        if report.passes >= model.passes.most {
            report.tangent_error += body.tangent_error_of_pass(state.grasp.motion());
        }
        if status == Status::Behind || report.passes >= model.passes.most {
            // Half way there is no balance.
            break match moved {
                Moved::Part => Status::NotConverged,
                _ => status,
            };
        }
    };
    if matches!(status, Status::Ok | Status::Behind) {
        state.time_us = time_us.unwrap_or(state.time_us);
    } else {
        // While columns are awaited the tissue stays where their factor is of.
        if status != Status::Waiting {
            work.put_back(state);
        }
        for (each, speed) in state.each.iter_mut().zip(&speeds) {
            each.speed = *speed;
        }
    }
    let status = match status {
        Status::Ok
            if state
                .tools
                .forget_inside(&needles.tools, |at| model.contains(at)) =>
        {
            Status::Inside
        }
        status => status,
    };
    // Of a touch of a tool one counts for all.
    let rows = work.drive.count() - work.drive.tool_rows.len();
    report.rows = (rows + state.tools.contacts.len()) as u32;
    if status == Status::Ok && !needles.tools.is_empty() {
        let most = work.drive.system.settings().vertices_per_step;
        let left = most.saturating_sub(report.columns_computed as usize / 3);
        let computed = look_ahead(model, needles, state, wanted, &mut work.drive, left);
        report.columns_computed += 3 * computed;
        clock.lap(&mut report.stages.columns_ns);
    }
    if status == Status::Ok {
        reduce(model, needles, state, samples, wanted, work, report, clock);
    }
    status
}

/// Where needles, the ends of threads and tools have to go.
struct Targets<'a> {
    needles: &'a [Isometry3<f64>],
    threads: &'a [[Vector3<f64>; 2]],
    tools: &'a Placements,
}

/// Takes the needles to their targets in pieces.
fn follow(
    model: &Model,
    needles: &Needles,
    state: &mut NeedlesState,
    to: &Targets,
    work: &mut NeedlesWork,
    report: &mut StepReport,
    clock: &mut Clock,
) -> Status {
    let Targets {
        needles: targets,
        threads,
        tools,
    } = *to;
    let mut halvings = 0;
    loop {
        // What nobody holds is where the tissue took it.
        let mut ends = [Isometry3::identity(); MAX_NEEDLES];
        for ((end, each), target) in ends.iter_mut().zip(&state.each).zip(targets) {
            *end = if each.grip.is_some() {
                *target
            } else {
                each.pose
            };
        }
        let mut part = 1.0f64;
        for ((each, target), own) in state.each.iter().zip(&ends).zip(&needles.parts) {
            part = part.min(piece(needles, each, target, own));
        }
        let mut holds = [[Vector3::zeros(); 2]; MAX_NEEDLES];
        for (thread, target) in state.threads.iter().zip(threads) {
            let way = [target[0] - thread.tail.at, target[1] - thread.head.at];
            let far = way[0].norm().max(way[1].norm());
            if !thread.segments.is_empty() && far > 0.0 {
                part = part.min(needles.piece_m / far);
            }
        }
        part = part.min(state.tools.part(&needles.tools, tools));
        if !part.is_finite() {
            return Status::NotFinite;
        }
        part *= 0.5f64.powi(halvings);
        for ((hold, thread), target) in holds.iter_mut().zip(&state.threads).zip(threads) {
            let between = |from: Vector3<f64>, to: Vector3<f64>| {
                if part >= 1.0 {
                    to
                } else {
                    from + (to - from) * part
                }
            };
            *hold = [
                between(thread.tail.at, target[0]),
                between(thread.head.at, target[1]),
            ];
        }
        let mut poses = [Isometry3::identity(); MAX_NEEDLES];
        for ((pose, each), target) in poses.iter_mut().zip(&state.each).zip(&ends) {
            *pose = towards(&each.pose, target, part);
        }
        let placements = state.tools.towards(tools, part);
        report.substeps += 1;
        let count = state.each.len();
        let mut drive = Drive {
            body: &model.body,
            needles,
            points_m: model.points_m(),
            states: &mut state.each,
            threads: &mut state.threads,
            touch: state.touch.as_mut(),
            tools: &mut state.tools,
            grasp: &mut state.grasp,
            work: &mut work.drive,
            report,
            clock,
        };
        let threads_count = threads.len();
        match drive.to(&poses[..count], &holds[..threads_count], &placements) {
            Ok(()) if part >= 1.0 => return Status::Ok,
            Ok(()) => halvings = 0,
            // Between tools the way counts: its end may be on their other side.
            Err(Status::NotConverged) if !needles.tools.is_empty() && halvings < MAX_HALVINGS => {
                halvings += 1;
            }
            // Where the way leads through what has no balance, its end may have one: that it can be left again.
            Err(Status::NotConverged | Status::TooManyRows)
                if part < 1.0 && needles.tools.is_empty() =>
            {
                return drive.jump(&ends[..count], threads, tools);
            }
            // The way there could not be followed, but nothing is touched at its end: let go.
            Err(Status::NotConverged | Status::TooManyRows)
                if needles.tools.are_free(tools, |at| model.contains(at)) =>
            {
                drive.tools.let_go();
                return drive.jump(&ends[..count], threads, tools);
            }
            Err(status) => return status,
        }
        if drive.report.substeps >= MAX_PIECES {
            if needles.tools.are_free(tools, |at| model.contains(at)) {
                drive.tools.let_go();
                return drive.jump(&ends[..count], threads, tools);
            }
            return Status::Behind;
        }
    }
}

/// Which part of its way a needle may go at once.
fn piece(needles: &Needles, each: &NeedleState, target: &Isometry3<f64>, own: &NeedlePart) -> f64 {
    let (from, to) = (own.needle.at(&each.pose), own.needle.at(target));
    let touches = !each.holds.is_empty() || !matches!(each.tip, Tip::Outside | Tip::Waiting);
    let turn = (target.rotation * each.pose.rotation.inverse()).angle();
    let mut part = MOST_TURN / turn;
    if touches {
        let way = [0.0, 0.5, 1.0]
            .map(|share| (to.at(share * to.length) - from.at(share * from.length)).norm());
        part = part.min(needles.piece_m / way.into_iter().fold(0.0, f64::max));
    }
    // A way without end is none.
    if part.is_nan() {
        f64::NAN
    } else {
        part.min(1.0)
    }
}

/// A part of the way: straight for the origin of the frame, about one axis; all of it is exactly `to`.
fn towards(from: &Isometry3<f64>, to: &Isometry3<f64>, part: f64) -> Isometry3<f64> {
    if part >= 1.0 {
        return *to;
    }
    let shift = (to.translation.vector - from.translation.vector) * part;
    let turn = (to.rotation * from.rotation.inverse()).scaled_axis() * part;
    about(&from.translation.vector, &shift, &turn) * from
}

/// The pose of a sample's grip; `None` for a number that is not finite, even squared, or a quaternion without
/// length.
pub(crate) fn pose_of(sample: &ToolSample) -> Option<Isometry3<f64>> {
    let [x, y, z, w] = sample.orientation;
    let far = Vector3::from(sample.position_m).norm_squared();
    if !(far.is_finite() && sample.orientation.iter().all(|x| x.is_finite())) {
        return None;
    }
    let rotation = UnitQuaternion::try_new(Quaternion::new(w, x, y, z), 1e-6)?;
    Some(Isometry3::from_parts(
        Translation3::from(sample.position_m),
        rotation,
    ))
}

/// A tool at `pose` takes a needle where that is.
pub(crate) fn grip(tool: u8, pose: &Isometry3<f64>, needle: &Isometry3<f64>) -> Grip {
    Grip {
        tool,
        needle: pose.inverse() * needle,
    }
}

/// Wrenches and tangents of tools, reports of needles, columns that will soon be needed.
#[expect(clippy::too_many_arguments, reason = "they are the step")]
fn reduce(
    model: &Model,
    needles: &Needles,
    state: &mut NeedlesState,
    samples: &[ToolSample],
    wanted: &Wanted,
    work: &mut NeedlesWork,
    report: &mut StepReport,
    clock: &mut Clock,
) {
    let NeedlesState {
        grasp,
        each,
        threads,
        touch,
        tools,
        ..
    } = state;
    let NeedlesWork {
        drive: scratch,
        tangent,
        ahead,
        cones,
        rows,
        ..
    } = work;
    let mut stages_report = *report;
    let mut drive = Drive {
        body: &model.body,
        needles,
        points_m: model.points_m(),
        states: each,
        threads,
        touch: touch.as_mut(),
        tools,
        grasp,
        work: scratch,
        report: &mut stages_report,
        clock,
    };
    ahead.clear();
    tangent.factor(needles, drive.states, drive.tools, drive.grasp, drive.work);
    let in_tissue = |index: usize| drive.position_of(&drive.work.set.anchors[index]);
    let mut grips = [None; MAX_TOOLS];
    for ((contact, sample), grip_at) in report
        .contacts_mut(samples.len())
        .iter_mut()
        .zip(samples)
        .zip(&mut grips)
    {
        contact.id = sample.id;
        let grip = Vector3::from(sample.position_m);
        *grip_at = Some((sample.id, grip));
        let holds = |needle: usize| {
            let by: Option<Grip> = drive.states[needle].grip;
            by.is_some_and(|by| by.tool == sample.id)
        };
        let mut wrench = Vector6::zeros();
        let (mut gap_m, mut normal) = (f64::MAX, Vector3::z());
        for needle in (0..drive.states.len()).filter(|needle| holds(*needle)) {
            wrench += drive.wrench_on(needle, &grip);
            let own = drive
                .work
                .points
                .iter()
                .filter(|point| point.needle == needle);
            let rows = 3 * own.count() as u32;
            contact.rows += rows;
            let curve = needles.parts[needle].needle.at(&drive.states[needle].pose);
            let forward = curve.tangent_at(curve.length);
            if rows > 0 {
                gap_m = 0.0;
            }
            if drive.states[needle].tip == Tip::Outside {
                let tip = curve.at(curve.length);
                let path = Curve::segment(&tip, &(tip + forward * LOOK_M));
                if let Some(face) = path.and_then(|path| drive.first_face(&path)) {
                    gap_m = gap_m.min(face.alpha);
                    if let Some(nodes) = needles.mesh.cells().get(face.face.cell() as usize) {
                        ahead.extend(nodes);
                    }
                }
            }
            normal = -forward;
        }
        let mut pulls = [None; 2 * MAX_NEEDLES];
        for (pull, end) in pulls.iter_mut().zip(thread_ends(&drive)) {
            let Some((_, by, at, force, rows)) = end.filter(|(_, by, ..)| *by == sample.id) else {
                continue;
            };
            debug_assert_eq!(by, sample.id);
            let arm = at - grip;
            let moment = arm.cross(&force);
            wrench += Vector6::new(force.x, force.y, force.z, moment.x, moment.y, moment.z);
            contact.rows += 1;
            gap_m = 0.0;
            *pull = Some(Pull { arm, force, rows });
        }
        let touching = needles
            .tools
            .place_of(model.tool(sample.id).map(|(index, _)| index));
        if let Some(tool) = touching {
            wrench += drive.tools.wrench(tool, &grip);
            let (apart_m, out) = drive.tool_apart(tool);
            contact.rows += drive.tools.count(tool);
            (gap_m, normal) = (apart_m, out);
        }
        contact.gap_m = gap_m;
        let force: Vector3<f64> = wrench.fixed_rows::<3>(0).into();
        contact.normal = force.try_normalize(1e-12).unwrap_or(normal).into();
        contact.wrench = wrench.into();
        let mut derivative = tangent.differentiate(
            needles,
            drive.states,
            drive.grasp,
            drive.work,
            &in_tissue,
            &grip,
            Moves {
                needle: &holds,
                tool: touching,
            },
            &pulls,
        );
        // Without friction what tools feel comes from an energy: symmetric to the last bit, but for what the moment makes.
        if touching.is_some() && needles.are_conservative() {
            let moment: Vector3<f64> = wrench.fixed_rows::<3>(3).into();
            derivative = (derivative + derivative.transpose()) * 0.5;
            let mut corner = derivative.fixed_view_mut::<3, 3>(3, 3);
            corner -= moment.cross_matrix() * 0.5;
        }
        contact.tangent = derivative.transpose().into();
    }
    let lambda = drive.grasp.lambda();
    let stored = drive.work.system.stored_j(drive.grasp);
    for (needle, out) in report
        .needles_mut(drive.states.len())
        .iter_mut()
        .enumerate()
    {
        let each = &drive.states[needle];
        let part = &needles.parts[needle];
        let curve = part.needle.at(&each.pose);
        let at_grip = each.grip.and_then(|by| {
            let found = grips.iter().flatten().find(|(id, _)| *id == by.tool);
            found.map(|(_, at)| *at)
        });
        let at_grip = at_grip.unwrap_or(curve.start);
        let twist = slide_twist(&curve, &at_grip);
        let rubbing: f64 = each.holds.iter().map(|hold| hold.limit_n).sum();
        let cutting = match each.tip {
            Tip::Inside { cut: Some(cut) } => cut.limit_n,
            _ => 0.0,
        };
        let holding = drive
            .work
            .points
            .iter()
            .find(|point| point.needle == needle && point.what == super::drive::What::Holding);
        let (hold_n, puncture_n) = match (each.tip, holding) {
            (Tip::Holding { face, .. }, Some(point)) => (
                -lambda[point.first_row],
                needles.tissue(face.face.cell()).puncture_pa * part.needle.tip_area_m2(),
            ),
            _ => (0.0, 0.0),
        };
        *out = NeedleReport {
            id: part.id,
            held_by: each.grip.map(|by| by.tool),
            tip: match each.tip {
                Tip::Outside => TipPlace::Outside,
                Tip::Holding { .. } => TipPlace::Holding,
                Tip::Inside { .. } => TipPlace::Inside,
                Tip::Waiting => TipPlace::Waiting,
            },
            crossings: each.holds.len() as u32,
            punctures: each.tally.punctures,
            slides: !each.holds.is_empty()
                && each
                    .holds
                    .iter()
                    .all(|hold| hold.slides || hold.limit_n == 0.0),
            axial_n: drive.wrench_on(needle, &at_grip).dot(&twist),
            limit_n: [rubbing + cutting, rubbing],
            hold_n,
            puncture_n,
            stiffness_n_per_m: [0.0; 2],
            slide: twist.into(),
            dissipated_j: [
                each.tally.friction_j,
                each.tally.cutting_j,
                each.tally.release_j,
            ],
            guessed: each.tally.guessed + each.tally.lost + each.tally.folded,
        };
        // Cells around the tip are next.
        if let Some(cell) = each.history.tip_cell(&needles.mesh) {
            let near = needles.mesh.adjacent_cells(cell).into_iter().flatten();
            for cell in std::iter::once(cell).chain(near) {
                ahead.extend(
                    needles
                        .mesh
                        .cells()
                        .get(cell as usize)
                        .into_iter()
                        .flatten(),
                );
            }
        }
        let derivative = tangent.differentiate(
            needles,
            drive.states,
            drive.grasp,
            drive.work,
            &in_tissue,
            &at_grip,
            Moves {
                needle: &|other| other == needle,
                tool: None,
            },
            &[],
        );
        out.stiffness_n_per_m[1] = -twist.dot(&(derivative * twist));
    }
    for (needle, out) in report
        .needles_mut(drive.states.len())
        .iter_mut()
        .enumerate()
    {
        out.stiffness_n_per_m[0] = tangent.sticking(drive.work, needle);
    }
    report_threads(&drive, report);
    if let Some(cones) = cones {
        reduce_tools(&mut drive, model, samples, wanted, cones, rows, report);
    }
    let potential_j = model
        .body
        .potential_j(drive.grasp.motion(), drive.work.system.body_work());
    let stored = stored - needles.rest.as_ref().map_or(0.0, |rest| rest.stored_j);
    report.stored_energy_j = potential_j.map_or(stored, |potential_j| {
        potential_j - model.resting_potential_j
    });
    clock.lap(&mut report.stages.reduce_ns);
    let most = work.drive.system.settings().vertices_per_step;
    let left = most.saturating_sub(report.columns_computed as usize / 3);
    if model.body.is_linear() {
        let left = left.min(PREFETCHED);
        let computed =
            work.drive
                .system
                .compute_ahead(&model.body, &state.grasp, &work.ahead, left);
        report.columns_computed += 3 * computed;
        clock.lap(&mut report.stages.columns_ns);
    }
}

/// What the console solves by itself of the tools that touch; of those that are apart, the tangent of the touch to come.
fn reduce_tools(
    drive: &mut Drive,
    model: &Model,
    samples: &[ToolSample],
    wanted: &Wanted,
    cones: &mut Cones,
    out: &mut Vec<ToolRows>,
    report: &mut StepReport,
) {
    let contacts = report.contacts_mut(samples.len()).iter_mut();
    for (contact, sample) in contacts.zip(samples) {
        let Some((index, tool)) = model.tool(sample.id) else {
            continue;
        };
        let Some(touching) = drive.needles.tools.place_of(Some(index)) else {
            continue;
        };
        let apart = contact.rows == 0;
        if wanted.most_rows == 0 && !apart {
            continue;
        }
        let grip = Vector3::from(sample.position_m);
        let tangent = Matrix6::from_fn(|i, j| contact.tangent[i][j]);
        let of = (touching, sample.id);
        let most = Wanted {
            most_rows: if apart {
                MAX_TOOL_ROWS
            } else {
                wanted.most_rows
            },
            ..*wanted
        };
        let Some(mut rows) = drive.tool_rows(of, &grip, &tangent, &most, cones) else {
            continue;
        };
        if apart {
            let radius_m = tool.radius_m().max(model.surface().mean_edge_m);
            let at_once_m = contact.gap_m + AT_ONCE * radius_m;
            contact.tangent = cones.coming(&rows, at_once_m).transpose().into();
            rows.truncate(wanted.most_rows);
        }
        if rows.count > 0 {
            out.push(rows);
        }
    }
}

/// Columns of the vertices that tools are nearest to: the tip will be there soon. Says how many were computed, of at most
/// `left`.
fn look_ahead(
    model: &Model,
    needles: &Needles,
    state: &NeedlesState,
    wanted: &Wanted,
    work: &mut NeedleWork,
    left: usize,
) -> u32 {
    let (body, linear) = (&model.body, model.body.is_linear());
    // The next factor would make them void, and where none is renewed beside the steps it comes at once: but of
    // hyperelastic tissue, whose factor lasts for some steps.
    let lasts = matches!(body, Body::Hyperelastic { .. });
    if !linear && !lasts && !work.system.columns().renews() {
        return 0;
    }
    let tools = &needles.tools;
    let placements = &state.tools.placements;
    let mut near = std::mem::take(&mut work.near_tools);
    let mut gaps = std::mem::take(&mut work.next_gaps);
    tools.near(placements, &work.slack_m, wanted.reach_m, &mut near);
    gaps.clear();
    for &(tool, node) in &near {
        let Some(placement) = &placements[tool as usize] else {
            continue;
        };
        let solid = tools.solid(tool as usize, placement);
        let at = position(body, model.points_m(), &state.grasp, work, node);
        let gap_m = solid.gap(&at);
        if gap_m < NEAR * solid.radius() + wanted.reach_m {
            gaps.push((gap_m / solid.radius(), node));
        }
    }
    gaps.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    work.next_nodes.clear();
    work.next_nodes.extend(gaps.iter().map(|(_, node)| *node));
    (work.near_tools, work.next_gaps) = (near, gaps);
    let NeedleWork {
        system, next_nodes, ..
    } = work;
    if linear {
        return system.compute_ahead(body, &state.grasp, next_nodes, left);
    }
    // It can have them from the start.
    system.wish(next_nodes);
    // Until then the first touch is foretold by this one.
    if lasts || state.tools.contacts.is_empty() {
        return system.compute_ahead(body, &state.grasp, next_nodes, left.min(MOST_AHEAD));
    }
    0
}

/// Vertices whose columns a step computes for a touch to come, where a renewed factor makes them void.
const MOST_AHEAD: usize = 8;

/// Vertices that will be touched at once, in radii: as far as one is nearer than another.
const AT_ONCE: f64 = 1e-3;

/// Vertices whose columns a step computes ahead of need.
const PREFETCHED: usize = 2;
