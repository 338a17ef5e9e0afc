//! The scene's tissue, tools and needles behind [`Solve`]: a state becomes a sample, a step, a contact.
//!
//! Entry point: [`TissueSolver::new`]. The console's one grip carries the scene's driven tool; the others stay
//! where the scene holds them, or follow their scripts.

use super::look_ahead::{Look, course};
use super::look_budget::{Ahead, LookBudget, Looked};
use super::{
    Effort, Goal, HeldNeedle, HeldThread, Plan, Rendering, SceneSolver, Solve, Solved, Spared,
    reach_m, sideways,
};
use crate::clock::Clock;
use crate::contact::shape::Solid;
use crate::model::Model;
use crate::needle::{NeedleReport, TipPlace};
use crate::output::tip_word;
use crate::scene::{Needle, Scene, Tissue};
use crate::script::{Path, Script, at_rest, path};
use crate::solve::{SolveError, bring_in};
use crate::step::{self, Arrival, Rule, Status, StepReport, ToolRows, Workspace};
use crate::thread::{ThreadReport, ThreadTension};
use crate::tool::ToolSample;
use crate::wound::Wound;
use nalgebra::Vector3;
use serde_json::{Map, Value, json};
use sutura_client::Lead;
use sutura_shared::control::LOST_AFTER_US;
use sutura_shared::wire::Valid;
use sutura_shared::wire::message::{Course, End, Friction, State, Tension, Tip};

/// How far from the tool vertices are prepared, in radii: as far as a step looks ahead.
const PREPARED_RADII: f64 = 0.5;
/// How far from a needle nodes are prepared, in mean edges: those of the faces that it goes through, and of the
/// next ones.
const PREPARED_EDGES: f64 = 1.5;
/// And so much further \[m\]: the hand strays from its path, and tissue moves along.
const PREPARED_MARGIN_M: f64 = 0.003;

/// Seconds between two places of the hand that the solver is prepared for.
const PREPARED_EVERY_S: f64 = 0.02;

/// Most steps of one look, forward and backward, and how long they are wanted on average \[m\].
const LOOK_STEPS: [usize; 2] = [24, 16];

/// So much slack is looked through to the taut thread \[m\], and so far into that, in turn \[m\].
const NEARLY_TAUT_M: f64 = 0.01;
const TIGHTENING_M: [f64; 3] = [2e-4, 5e-4, 1e-3];
/// States farther apart than this are far apart \[us\], and a needle's way between them is followed in pieces of this time
/// \[us\].
const FAR_US: u64 = 5_500;
const PIECE_US: u64 = 1_000;
/// With fewer, both ways together, friction and stiffness say as much.
const LOOK_LEAST: usize = 4;
/// A frame is in use until it is so many periods old where the host stalls, or for so long \[us\].
const LOOK_PERIODS: f64 = 4.0;
const LOOK_MOST_US: f64 = 150e3;
/// A hand that rests sets out, and a moving one gets faster, by this \[m/s^2\]; and a little more \[m\].
const LOOK_HAND_M_PER_S: f64 = 0.25;
const LOOK_MARGIN_M: f64 = 5e-4;
/// Farther than this a look is too coarse, forward and backward \[m\].
const LOOK_MOST_M: [f64; 2] = [0.018, 0.012];

/// A model with its state and scratch.
pub struct TissueSolver {
    name: String,
    tissue: Tissue,
    model: Model,
    state: step::State,
    work: Workspace,
    /// How long a frame is in use at most \[s\], from its state on.
    ahead_s: f64,
    /// When frames usually are in use.
    lead: Lead,
    /// Whether frames carry the states of needle and thread, which are what is looked ahead for.
    looks_ahead: bool,
    budget: LookBudget,
    effort: Effort,
    script: Script,
    /// Console time of the first step \[us\], from which scripts count.
    began_us: Option<u64>,
    deepest: Deepest,
    needles: Vec<NeedleTally>,
    wound: Option<Wound>,
    /// Largest tension so far at an end of each thread \[N\].
    peak_tension_n: Vec<f64>,
    /// Of the state before.
    last_sample: Option<ToolSample>,
    last: StepReport,
    /// The newest step that found a balance.
    last_good: StepReport,
}

/// A solver's state between two steps, for others of the same scene to go on from.
pub struct Moment {
    state: step::State,
    script: Script,
    began_us: Option<u64>,
    budget: LookBudget,
    deepest: Deepest,
    needles: Vec<NeedleTally>,
    wound: Option<Wound>,
    peak_tension_n: Vec<f64>,
    last_sample: Option<ToolSample>,
    last: StepReport,
    last_good: StepReport,
}

/// What the session's hardest press looked like.
#[derive(Clone, Copy, Debug, Default)]
struct Deepest {
    force_n: f64,
    position_m: [f64; 3],
    rows: u32,
    stored_energy_j: f64,
}

/// A needle as the last good step left it, and at its worst.
#[derive(Clone, Copy, Debug, Default)]
struct NeedleTally {
    last: NeedleReport,
    peak_axial_n: f64,
    most_crossings: u32,
}

impl TissueSolver {
    /// Builds the scene's solver and brings the tools that are held to their places.
    ///
    /// # Errors
    /// What [`Scene::build`] refuses; tools that are held too deep.
    pub fn new(scene: &Scene) -> Result<Self, SolveError> {
        let (model, mut state, mut work) = scene.build()?;
        // Grips touch nothing on their way.
        let held: Vec<_> = scene
            .held()
            .filter(|(tool, _)| scene.needles.is_empty() || !tool.shape.is_grip())
            .map(|(tool, pose)| (tool.id, tool.shape.clone(), pose))
            .collect();
        let last = bring_in(&model, &mut state, &held, &mut work)?;
        let wound = Wound::new(scene, &model);
        Ok(TissueSolver {
            name: scene.name.clone(),
            tissue: scene.tissue,
            budget: LookBudget::new(1e6 / scene.host.host_hz, model.points_m().len()),
            looks_ahead: true,
            effort: Effort::Full,
            model,
            state,
            work,
            ahead_s: 0.0,
            lead: Lead::new(),
            script: Script::new(scene),
            began_us: None,
            last_sample: None,
            deepest: Deepest::default(),
            needles: scene.needles.iter().map(NeedleTally::of).collect(),
            wound,
            peak_tension_n: vec![0.0; scene.threads.len()],
            last,
            last_good: last,
        })
    }

    /// As [`TissueSolver::new`], prepared for what a session is to be: what the hand will come by is computed, and rows
    /// are reduced to what its line carries.
    ///
    /// # Errors
    /// As there.
    pub fn for_session(scene: &Scene, plan: &Plan) -> Result<Self, SolveError> {
        let mut solver = TissueSolver::new(scene)?;
        // The same on every machine; a session in real time has them when they are there.
        let rule = Rule::SAME_EVERYWHERE;
        solver.work.renew_beside(&solver.model, rule);
        let used = plan.hand.way_points.get(..usize::from(plan.hand.count));
        let hand_s = used
            .and_then(<[_]>::last)
            .map_or(0.0, |point| f64::from(point.time_s));
        let ways = scene.tools.iter().filter_map(|tool| tool.way.as_ref());
        let ends = ways.filter_map(|way| way.stops().last());
        // Afterwards everything rests.
        let end_s = ends.fold(hand_s, |end, stop| end.max(stop.time_s));
        let path = path(
            scene,
            end_s.min(plan.seconds),
            PREPARED_EVERY_S,
            TissueSolver::apart_m(scene),
        );
        solver.prepare(&path);
        // The console has them a period later, and uses them for another.
        solver.reduce_to(plan.most_rows(), 2.0 / plan.host_hz);
        solver.plan_every(1.0 / plan.host_hz);
        solver.looks_ahead = plan.rendering == Rendering::Rows;
        Ok(solver)
    }

    /// Computes beforehand what steps along `path` will need, so that the first touch costs no more than
    /// any other. Returns how many vertices are prepared.
    pub fn prepare(&mut self, path: &Path) -> usize {
        let edge_m = self.model.surface().mean_edge_m;
        let needles_m = PREPARED_EDGES * edge_m + PREPARED_MARGIN_M;
        let driven = self.driven().and_then(|id| self.model.tool(id));
        let touching = driven.filter(|(_, tool)| !tool.is_grip());
        let solids: Vec<Solid> = touching.map_or_else(Vec::new, |(_, tool)| {
            let placed = path
                .grips
                .iter()
                .filter_map(|grip| tool.place(&at_rest(0, grip)));
            placed
                .map(|place| Solid::new(tool, edge_m, &place))
                .collect()
        });
        let near = |vertex: [f64; 3]| {
            let vertex = Vector3::from(vertex);
            let touched = |solid: &Solid| {
                solid.gap(&vertex) <= PREPARED_RADII * solid.radius() + PREPARED_MARGIN_M
            };
            let pierced =
                |place: &Vector3<f64>| (place - vertex).norm_squared() <= needles_m * needles_m;
            solids.iter().any(touched) || path.needles.iter().any(pierced)
        };
        let count = self.work.prepare(&self.model, near);
        tracing::info!("compliance of {count} vertices computed beforehand");
        count
    }

    /// From now on steps reduce the driven tool's contact to so many rows at most (0: to none), those that matter
    /// within `ahead_s` first.
    pub fn reduce_to(&mut self, most_rows: usize, ahead_s: f64) {
        self.work.most_rows = most_rows;
        self.work.reach_m = reach_m(ahead_s);
        self.ahead_s = ahead_s;
    }

    /// Solves are planned every `period_s` from now on: what is looked at ahead is paid from that.
    pub fn plan_every(&mut self, period_s: f64) {
        self.budget.plan(1e6 * period_s);
    }

    /// The driven tool's rows at the last step, if there are any.
    fn rows(&self) -> Option<ToolRows> {
        let rows = self.work.rows(self.driven()?)?;
        (self.last.status == Status::Ok && rows.count > 0).then_some(*rows)
    }

    /// Distance between the points of a needle that [`Self::prepare`] needs at most \[m\].
    pub fn apart_m(scene: &Scene) -> f64 {
        0.5 * scene.mesh.surface().mean_edge_m
    }

    /// Id of the tool that the console's grip carries.
    pub fn driven(&self) -> Option<u8> {
        self.script.driven()
    }

    /// Steps with the driven tool where `sample` is, and all else where the scripts have it at its time, counted from
    /// the first step's.
    pub fn step(&mut self, sample: ToolSample) -> StepReport {
        self.step_with(sample, false)
    }

    /// As [`Self::step`]; of a console that is `armed_anew` nobody knows by which way its grip came where it is.
    fn step_with(&mut self, sample: ToolSample, armed_anew: bool) -> StepReport {
        let now_us = sample.console_time_us;
        let began_us = *self.began_us.get_or_insert(now_us);
        let time_s = 1e-6 * now_us.saturating_sub(began_us) as f64;
        let samples = self
            .script
            .step_to(time_s, sample, &self.model, &mut self.state);
        if let Some(driven) = samples.first().filter(|_| armed_anew) {
            self.state.put(driven);
        }
        self.last = step::step(&self.model, &mut self.state, samples, &mut self.work);
        for (tally, report) in self.needles.iter_mut().zip(self.last.needles()) {
            tally.last = *report;
            tally.peak_axial_n = tally.peak_axial_n.max(report.axial_n.abs());
            tally.most_crossings = tally.most_crossings.max(report.crossings);
        }
        for (peak, thread) in self.peak_tension_n.iter_mut().zip(self.last.threads()) {
            *peak = thread.tension_n.into_iter().fold(*peak, f64::max);
        }
        if self.last.status == Status::Ok {
            self.last_good = self.last;
        }
        self.last
    }

    /// Boundaries that needles have broken through so far.
    pub fn punctures(&self) -> u32 {
        let punctures = self.needles.iter().map(|needle| needle.last.punctures);
        punctures.sum()
    }

    /// Where it is now.
    pub fn moment(&self) -> Moment {
        Moment {
            state: self.state.clone(),
            script: self.script.clone(),
            began_us: self.began_us,
            budget: self.budget.clone(),
            deepest: self.deepest,
            needles: self.needles.clone(),
            wound: self.wound.clone(),
            peak_tension_n: self.peak_tension_n.clone(),
            last_sample: self.last_sample,
            last: self.last,
            last_good: self.last_good,
        }
    }

    /// Goes on where another solver of the same scene was.
    pub fn go_on_from(&mut self, moment: &Moment) {
        self.state.clone_from(&moment.state);
        self.script.clone_from(&moment.script);
        self.began_us = moment.began_us;
        self.budget = moment.budget.clone();
        self.deepest = moment.deepest;
        self.needles.clone_from(&moment.needles);
        self.wound.clone_from(&moment.wound);
        self.peak_tension_n.clone_from(&moment.peak_tension_n);
        self.last_sample = moment.last_sample;
        self.last = moment.last;
        self.last_good = moment.last_good;
    }

    /// The solver's parts, for what looks at them between steps.
    pub fn parts(&self) -> (&Model, &step::State, &Workspace) {
        (&self.model, &self.state, &self.work)
    }

    /// What there is to say of threads and of what they close.
    fn wound(&self) -> Map<String, Value> {
        let found = self.wound.as_ref().map(|wound| {
            let samples = self.script.samples();
            wound.report(&self.model, &self.state, &self.last_good, samples)
        });
        let Some(Ok(Value::Object(mut map))) = found.map(serde_json::to_value) else {
            return Map::new();
        };
        let threads = map.get_mut("threads").and_then(Value::as_array_mut);
        for (thread, peak) in threads.into_iter().flatten().zip(&self.peak_tension_n) {
            thread["peak_tension_n"] = json!(peak);
        }
        map
    }

    /// Follows a needle's way between two states that are far apart in several steps: friction is that of the depth at
    /// which a step begins, and a boundary gives way at a step's end.
    fn come_closer(&mut self, before: &ToolSample, sample: &ToolSample) {
        let period_us = sample
            .console_time_us
            .saturating_sub(before.console_time_us);
        let far = period_us > FAR_US && period_us <= LOOK_MOST_US as u64;
        if !far || self.needles.is_empty() || self.tissue.word() != "linear" {
            return;
        }
        let wanted = (period_us / PIECE_US).saturating_sub(1) as usize;
        let pieces = self.budget.approach(wanted, &self.last) as u64 + 1;
        let blend = |from: f64, to: f64, part: f64| from + (to - from) * part;
        for piece in 1..pieces {
            let part = piece as f64 / pieces as f64;
            let mut between = *sample;
            for (at, from) in between.position_m.iter_mut().zip(before.position_m) {
                *at = blend(from, *at, part);
            }
            let turned = before.orientation.iter().zip(sample.orientation);
            // The nearer of the two quaternions that are the same turn; a step makes a unit of it.
            let product: f64 = turned.map(|(a, b)| a * b).sum();
            let sign = if product < 0.0 { -1.0 } else { 1.0 };
            for (at, from) in between.orientation.iter_mut().zip(before.orientation) {
                *at = blend(sign * from, *at, part);
            }
            between.console_time_us = before.console_time_us + period_us * piece / pieces;
            if !self.budget.allows(Ahead::Approach, 0) {
                return;
            }
            let report = self.step(between);
            self.budget.made(Ahead::Approach, 0, &report);
        }
    }

    /// How the axial force of the needle in the grip goes on, as far as it may get before the console hears of it.
    fn look_ahead(&mut self, needle: u8, report: &StepReport, period_us: u64) -> Course {
        let found = report.needles().iter().find(|other| other.id == needle);
        let samples = self.script.samples();
        let (Some(found), Some(sample)) = (found, samples.first()) else {
            return Course::default();
        };
        let Some(mut look) = self.look(found, sample, period_us, report) else {
            return Course::default();
        };
        look.steps = self.budget.course(look.steps);
        course(
            &self.model,
            &self.state,
            samples,
            found,
            &look,
            (&mut self.work, &mut self.budget),
        )
    }

    /// Where a slack thread becomes taut and how stiff it is then, if that is near: the solver pulls on a copy of its
    /// state. Not where tissue is linearised anew by a step.
    fn tighten(&mut self, driven: u8, thread: &mut HeldThread, like: &StepReport) {
        let near = (0.0..=NEARLY_TAUT_M).contains(&thread.slack_m);
        let known = thread.direction != [0.0; 3];
        let Some(sample) = self.script.samples().first().copied() else {
            return;
        };
        let linear = self.tissue.word() == "linear";
        let is_paid = self.budget.affords(Ahead::Pull, like) >= 1;
        if !(near && known && linear && is_paid) {
            return;
        }
        let mut samples = self.script.samples().to_vec();
        let mut state = self.state.clone();
        // Straight back is not quite the way on which it tightens.
        for beyond_m in TIGHTENING_M {
            if !self.budget.allows(Ahead::Pull, 0) {
                return;
            }
            let way_m = thread.slack_m + beyond_m;
            for (at, (from, pull)) in samples[0]
                .position_m
                .iter_mut()
                .zip(sample.position_m.iter().zip(thread.direction))
            {
                *at = from - pull * way_m;
            }
            let report = step::step(&self.model, &mut state, &samples, &mut self.work);
            self.budget.made(Ahead::Pull, 0, &report);
            let there = at_grip(&report, driven).filter(|_| report.status == Status::Ok);
            let Some(there) = there else {
                return;
            };
            if there.state == Tension::Taut && there.stiffness_n_per_m > 0.0 {
                thread.stiffness_n_per_m = there.stiffness_n_per_m;
                thread.slack_m = (way_m - there.tension_n / there.stiffness_n_per_m).max(0.0);
                return;
            }
        }
    }

    /// How far to look; not at all where tissue is linearised anew by a step, or where it would take too long.
    fn look(
        &self,
        needle: &NeedleReport,
        sample: &ToolSample,
        period_us: u64,
        like: &StepReport,
    ) -> Option<Look> {
        let affordable = self.budget.affords(Ahead::Course, like);
        let waits = needle.tip == TipPlace::Waiting;
        if waits || self.tissue.word() != "linear" || affordable < LOOK_LEAST {
            return None;
        }
        let [x, y, z, ..] = needle.slide;
        let [u, v, w] = sample.velocity_m_per_s;
        let square = (x * x + y * y + z * z).max(1e-6);
        let speed_m_per_s = (x * u + y * v + z * w) / square;
        let seconds = 1e-6 * (LOOK_PERIODS * period_us as f64).min(LOOK_MOST_US);
        let reach = |speed: f64, most_m: f64| {
            (LOOK_MARGIN_M + speed.max(LOOK_HAND_M_PER_S) * seconds).min(most_m)
        };
        let reach_m = [
            reach(speed_m_per_s, LOOK_MOST_M[0]),
            reach(-speed_m_per_s, LOOK_MOST_M[1]),
        ];
        let goes_back = speed_m_per_s < 0.0;
        let steps = [goes_back, !goes_back].map(|aside| {
            let side = usize::from(aside);
            (affordable * (2 - side) / 3).clamp(1, LOOK_STEPS[side])
        });
        Some(Look {
            reach_m,
            steps,
            speed_m_per_s: speed_m_per_s.abs(),
            goes_back,
        })
    }

    /// Whether tissue remembers which way tools came.
    fn remembers(&self) -> bool {
        let rubs = self.model.tools().iter().any(|(_, tool)| !tool.is_smooth());
        !self.needles.is_empty() || self.wound.is_some() || rubs
    }

    /// Whether what lies ahead of a tool that rubs is solved on a copy of the state: not in haste.
    fn tries_ahead(&self) -> bool {
        self.effort == Effort::Full && self.would_try_ahead()
    }

    /// The same if there is time for it: not where tissue is linearised anew by a step.
    fn would_try_ahead(&self) -> bool {
        let driven = self.driven().and_then(|driven| self.model.tool(driven));
        let rubs = driven.is_some_and(|(_, tool)| !tool.is_grip() && !tool.is_smooth());
        rubs && self.looks_ahead && self.tissue.word() == "linear"
    }

    /// What the contact is solved for: ahead of the state, or on it where tissue remembers which way tools came and nothing is
    /// tried.
    fn goal(&mut self, state: &State, period_us: u64) -> Goal {
        let (position_m, velocity) = (state.position_m, state.velocity_m_per_s);
        let contact = self.last.contacts().first();
        let stays = self.remembers() && !self.tries_ahead();
        let usual_s = self.lead.lead_s(
            state.contact_sequence,
            state.applied_age_us,
            period_us as f64 * 1e-6,
        );
        let lead_s = match contact {
            Some(_) if !stays => usual_s,
            _ => 0.0,
        };
        let normal = contact.map_or([0.0; 3], |contact| contact.normal);
        sideways(position_m, velocity, &normal, lead_s, self.ahead_s)
    }

    /// A step to `goal` on a copy of the state: what the console is to have of it, which the state does not keep. None if
    /// there is no balance, or nothing lies ahead.
    fn try_ahead(&mut self, goal: &Goal) -> Option<StepReport> {
        let mut samples = self.script.samples().to_vec();
        let driven = samples.first_mut()?;
        let there = goal.position_m.map(f64::from);
        if self.last.status != Status::Ok || driven.position_m == there {
            return None;
        }
        driven.position_m = there;
        let mut state = self.state.clone();
        let report = step::step(&self.model, &mut state, &samples, &mut self.work);
        (report.status == Status::Ok).then_some(report)
    }

    fn sample(&self, state: &Valid<State>) -> Option<ToolSample> {
        let body = state.body();
        Some(ToolSample {
            id: self.driven()?,
            position_m: body.position_m.map(f64::from),
            orientation: body.orientation.map(f64::from),
            velocity_m_per_s: body.velocity_m_per_s.map(f64::from),
            console_time_us: state.console_time_us(),
        })
    }
}

/// Whether a console has let go between two states, by when they are: an armed one is not without contacts for so long. One that
/// has started anew may have an earlier time.
fn is_armed_anew(before_us: u64, sample: &ToolSample) -> bool {
    let passed_us = sample.console_time_us.checked_sub(before_us);
    passed_us.is_none_or(|passed_us| passed_us > u64::from(LOST_AFTER_US))
}

/// The needle in the grip of `driven`, for the wire.
fn in_grip(report: &StepReport, driven: u8) -> Option<HeldNeedle> {
    let needles = report.needles().iter();
    let needle = needles.into_iter().find(|n| n.held_by == Some(driven))?;
    let friction = match (needle.slides, needle.axial_n > 0.0) {
        (false, _) => Friction::Sticks,
        (true, false) => Friction::Forward,
        (true, true) => Friction::Backward,
    };
    // What sticks gives way, too, once the boundary does: at most friction is left.
    let left_n = needle.axial_n + needle.hold_n;
    let [forward_n, backward_n] = needle.limit_n;
    Some(HeldNeedle {
        tool: driven,
        needle: needle.id,
        slide: needle.slide,
        tip: match needle.tip {
            TipPlace::Outside | TipPlace::Waiting => Tip::Outside,
            TipPlace::Holding => Tip::Holding,
            TipPlace::Inside => Tip::Inside,
        },
        waits: needle.tip == TipPlace::Waiting,
        friction,
        axial_n: needle.axial_n,
        friction_n: needle.limit_n,
        stiffness_n_per_m: needle.stiffness_n_per_m,
        hold_n: needle.hold_n,
        puncture_n: needle.puncture_n,
        punctured_n: left_n.max(-forward_n).min(backward_n),
        course: Course::default(),
    })
}

/// How much a force along `direction` grows per metre that the grip of `driven` moves against it \[N/m\]: the tangent's
/// part along it, which turning does not change.
fn along(report: &StepReport, driven: u8, direction: &[f64; 3]) -> f64 {
    let contact = report
        .contacts()
        .iter()
        .find(|contact| contact.id == driven);
    contact.map_or(0.0, |contact| {
        let rows = contact.tangent.iter().zip(direction);
        let changes = rows.map(|(row, n)| n * (0..3).map(|i| row[i] * direction[i]).sum::<f64>());
        -changes.sum::<f64>()
    })
}

/// The thread that pulls at the grip of `driven`, for the wire; of a thread with both ends there, its head.
fn at_grip(report: &StepReport, driven: u8) -> Option<HeldThread> {
    let at = |thread: &ThreadReport, end: usize| thread.held_by[end] == Some(driven);
    let [tail, head] = [0, 1];
    let threads = report.threads();
    let thread = threads.iter().find(|t| at(t, head) || at(t, tail))?;
    let end = if at(thread, head) { head } else { tail };
    Some(HeldThread {
        tool: driven,
        thread: thread.id,
        end: [End::Tail, End::Head][end],
        state: match thread.state {
            ThreadTension::Slack => Tension::Slack,
            ThreadTension::Taut => Tension::Taut,
            ThreadTension::Strained => Tension::Strained,
        },
        direction: thread.direction[end],
        tension_n: thread.tension_n[end],
        stiffness_n_per_m: along(report, driven, &thread.direction[end]),
        slack_m: thread.available_m - thread.length_m,
    })
}

impl NeedleTally {
    fn of(needle: &Needle) -> Self {
        NeedleTally {
            last: NeedleReport {
                id: needle.id,
                ..NeedleReport::default()
            },
            ..NeedleTally::default()
        }
    }

    fn to_json(self) -> Value {
        let [friction, cutting, release] = self.last.dissipated_j;
        json!({
            "needle": self.last.id,
            "held_by": self.last.held_by,
            "tip": tip_word(self.last.tip),
            "punctures": self.last.punctures,
            "crossings": self.last.crossings,
            "most_crossings": self.most_crossings,
            "axial_n": self.last.axial_n,
            "peak_axial_n": self.peak_axial_n,
            "dissipated_j": { "friction": friction, "cutting": cutting, "release": release },
            "guessed": self.last.guessed,
        })
    }
}

impl Solve for TissueSolver {
    fn spare(&mut self, effort: Effort) -> Spared {
        self.effort = effort;
        self.work.spares_rows = effort >= Effort::NoRows;
        let (needles, threads) = (&self.needles, &self.peak_tension_n);
        let looks = !needles.is_empty()
            || (self.looks_ahead && !threads.is_empty())
            || self.would_try_ahead();
        Spared {
            looks: effort >= Effort::NoLooks && looks && self.tissue.word() == "linear",
            rows: effort >= Effort::NoRows && self.work.most_rows > 0,
        }
    }

    fn solve(&mut self, state: &Valid<State>) -> Solved {
        let Some(mut sample) = self.sample(state) else {
            // A scene without a tool is felt as free space, but nothing needs to be sent for that.
            return Solved {
                position_m: state.body().position_m,
                contact: None,
                rows: None,
                needle: None,
                thread: None,
                status: Status::UnknownTool,
                touched: false,
                unfinished: false,
                stages: step::Stages::default(),
                looked: Looked::default(),
            };
        };
        self.budget.begin(&self.last);
        let looks_ahead = self.looks_ahead && self.effort == Effort::Full;
        let mut clock = Clock::start();
        let before = self.last_sample.replace(sample);
        let before_us = before.map(|before| before.console_time_us);
        if let Some(before) = before.filter(|_| self.effort == Effort::Full) {
            self.come_closer(&before, &sample);
        }
        let mut stages = step::Stages::default();
        clock.lap(&mut stages.approach_ns);
        let period_us = before_us.map_or(0, |before| sample.console_time_us.saturating_sub(before));
        let mut goal = self.goal(state.body(), period_us);
        let tries = self.tries_ahead();
        if !tries {
            sample.position_m = goal.position_m.map(f64::from);
        }
        self.work.ahead_m = goal.ahead_m;
        let armed_anew = before_us.is_some_and(|before| is_armed_anew(before, &sample));
        let report = self.step_with(sample, armed_anew);
        let contact = report.contacts().first().copied();
        let (mut felt, mut rows) = (contact, self.rows());
        let mut needle = self.driven().and_then(|driven| in_grip(&report, driven));
        clock.lap(&mut 0);
        self.budget.stepped();
        if tries {
            match self.try_ahead(&goal) {
                Some(ahead) => (felt, rows) = (ahead.contacts().first().copied(), self.rows()),
                None => goal.position_m = state.body().position_m,
            }
        }
        if let (Some(needle), Status::Ok, true) = (&mut needle, report.status, looks_ahead) {
            needle.course = self.look_ahead(needle.needle, &report, period_us);
        }
        let mut thread = self.driven().and_then(|driven| at_grip(&report, driven));
        if let (Some(thread), Status::Ok) = (&mut thread, report.status)
            && thread.state == Tension::Slack
        {
            // Of what else is in the grip.
            thread.stiffness_n_per_m = 0.0;
            if looks_ahead {
                self.tighten(thread.tool, thread, &report);
            }
        }
        clock.lap(&mut stages.look_ns);
        if let Some(contact) = contact {
            let [x, y, z, ..] = contact.wrench;
            let force_n = (x * x + y * y + z * z).sqrt();
            if force_n > self.deepest.force_n {
                let (rows, stored_energy_j) = (contact.rows, report.stored_energy_j);
                self.deepest = Deepest {
                    force_n,
                    position_m: sample.position_m,
                    rows,
                    stored_energy_j,
                };
            }
        }
        let touched = match report.status {
            Status::Ok => {
                contact.is_some_and(|contact| contact.rows > 0)
                    || needle.is_some_and(|needle| needle.tip != Tip::Outside)
                    || thread.is_some_and(|thread| thread.state != Tension::Slack)
            }
            Status::Behind => report.rows > 0,
            Status::Waiting | Status::NotConverged | Status::TooManyRows | Status::Inside => true,
            Status::NotFinite | Status::UnknownTool => false,
        };
        Solved {
            position_m: goal.position_m,
            contact: felt,
            rows,
            needle,
            thread,
            status: report.status,
            touched,
            unfinished: false,
            stages: step::Stages {
                approach_ns: stages.approach_ns,
                look_ns: stages.look_ns,
                ..report.stages
            },
            looked: self.budget.looked(),
        }
    }

    fn scene(&self) -> Map<String, Value> {
        let Deepest {
            force_n,
            position_m,
            rows,
            stored_energy_j,
        } = self.deepest;
        let held = self
            .last
            .contacts()
            .iter()
            .skip(usize::from(self.driven().is_some()));
        let held: Vec<Value> = held
            .map(|contact| {
                let [x, y, z, ..] = contact.wrench;
                json!({ "tool": contact.id, "force_n": [-x, -y, -z], "rows": contact.rows })
            })
            .collect();
        let mut report = json!({
            "name": self.name,
            "tissue": self.tissue.word(),
            "nodes": self.model.points_m().len(),
            "peak": {
                "force_n": force_n,
                "position_m": position_m,
                "rows": rows,
                "stored_energy_j": stored_energy_j,
            },
            "held": held,
        });
        if !self.needles.is_empty() {
            report["punctures"] = self.punctures().into();
            let needles = self.needles.iter().map(|needle| needle.to_json());
            report["needles"] = needles.collect();
        }
        if self.model.tools().iter().any(|(_, tool)| !tool.is_smooth()) {
            report["friction_j"] = self.last_good.friction_j.into();
        }
        for (name, values) in self.state.added(&self.model) {
            let values = values
                .into_iter()
                .map(|(key, value)| (key.to_owned(), value.into()));
            report["added"][name] = Value::Object(values.collect());
        }
        let Value::Object(mut report) = report else {
            return Map::new();
        };
        report.extend(self.wound());
        report
    }
}

impl SceneSolver for TissueSolver {
    fn hash(&self) -> u64 {
        self.state.hash()
    }

    /// Without a thread columns and factors are computed in the step.
    fn start_worker(&mut self) {
        self.budget.measure();
        if let Err(error) = self.work.start_worker(&self.model) {
            tracing::warn!("no thread for compliance columns, steps compute them: {error}");
        }
    }

    fn log_arrivals(&mut self) {
        self.work.log_arrivals();
    }

    fn take_arrivals(&mut self) -> Vec<Arrival> {
        self.work.take_arrivals()
    }

    fn replay_worker(&mut self) {
        self.budget.replay();
        self.work.replay_worker(&self.model);
    }

    fn expect(&mut self, arrivals: &[Arrival], looked: Looked) {
        self.work.expect(arrivals);
        self.budget.expect(looked);
    }

    fn renew_in_step(&mut self) {
        self.work.renew_in_step();
    }
}
