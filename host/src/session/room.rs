//! Whether a scene's session comes to touch more of the surface than a step has room for.
//!
//! Entry point: [`overfull`]. Vertices near the tools along their scripts are counted on tissue at rest; only a scene in which these
//! are many is followed, as a session in lockstep.

use super::{Effort, Plan, Progress, SceneSolver, Solve, SolveError, Solved, Spared, run_lockstep};
use crate::contact::shape::Solid;
use crate::fem::TissueError;
use crate::link::LockstepConsole;
use crate::mesh::Surface;
use crate::rod::MOST_TOUCHES;
use crate::scene::{Needle, Scene};
use crate::script::Script;
use crate::source::tool::{MOST_CONTACTS, NEAR};
use crate::step::Status;
use crate::tool::{Act, ToolSample};
use crate::work;
use nalgebra::Vector3;
use serde_json::{Map, Value};
use std::fmt;
use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use sutura_shared::wire::Valid;
use sutura_shared::wire::message::State;

/// Time between two looks \[s\]: a hand at 0.1 m/s goes 2 mm meanwhile.
const EVERY_S: f64 = 0.02;
/// Most looks at a session.
const MOST_LOOKS: f64 = 2000.0;
/// A hand strays from its path, and tissue moves along, by so much \[m\].
const MARGIN_M: f64 = 0.003;

/// Places that a body touches for each vertex near it, at most: edges and faces are places, too.
const PLACES_A_VERTEX: usize = 3;
/// A hand's grip comes to rest within so much \[s\].
const AFTER_S: f64 = 0.5;

/// A step of a session that touches more than it has room for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Overfull {
    /// Since the session began \[s\].
    pub time_s: f64,
    /// Contacts that are too many.
    pub crowd: Crowd,
}

/// Contacts that are too many for a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Crowd {
    /// Vertices inside the tools, on tissue at rest.
    Vertices(usize),
    /// Places of the surface that the body of a grip or a needle touches.
    Places,
}

impl fmt::Display for Overfull {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let time_s = self.time_s;
        match self.crowd {
            Crowd::Vertices(vertices) => write!(
                f,
                "at {time_s:.2} s the tools are on {vertices} vertices of the mesh, and a step has room for {MOST_CONTACTS} in contact"
            ),
            Crowd::Places => write!(
                f,
                "at {time_s:.2} s a body touches more vertices, edges and faces of the mesh than the {MOST_TOUCHES} for which it has room"
            ),
        }
    }
}

impl Overfull {
    /// The next step, in words.
    pub const HELP: &str = "take a coarser mesh or a smaller tool, or press less deep: a session withholds such steps (`too-many-rows`)";
}

/// The first step of a scene's session in lockstep that has no room for all that its tools touch; none if all have. A session that
/// ends before its time for other reasons is judged as far as it came.
///
/// # Errors
/// The same as [`SceneSolver::for_session`]'s.
pub fn overfull(
    scene: &Scene,
    plan: &Plan,
    console: &mut dyn LockstepConsole,
) -> Result<Option<Overfull>, SolveError> {
    let surface = scene.mesh.surface();
    let plan = Plan {
        seconds: plan.seconds.min(end_s(scene)),
        ..*plan
    };
    if !scene.has_rows() || !may_crowd(scene, &surface, plan.seconds) {
        return Ok(None);
    }
    let is_full = Arc::new(AtomicBool::new(false));
    let mut watched = Watched {
        solver: SceneSolver::for_session(scene, &plan)?,
        began_us: None,
        full: None,
        is_full: is_full.clone(),
    };
    work::begin(
        "following the session, whose tools come near many vertices",
        || scene.name.clone(),
    );
    let stops = |progress: &Progress<'_>| {
        work::part(
            (1e3 * progress.elapsed_s) as usize,
            (1e3 * progress.seconds) as usize,
        );
        match is_full.load(Ordering::Relaxed) || work::is_stopped() {
            true => ControlFlow::Break(()),
            false => ControlFlow::Continue(()),
        }
    };
    // The session itself reports any other end.
    let _ = run_lockstep(console, &plan, &mut watched, stops);
    if watched.full.is_none() && work::is_stopped() {
        return Err(TissueError::Stopped.into());
    }
    Ok(watched.full.map(|(time_us, samples)| {
        let vertices = near(scene, &surface, &samples, Part::Shape, |_, _| 0.0);
        Overfull {
            time_s: 1e-6 * time_us as f64,
            crowd: match vertices <= MOST_CONTACTS && has_bodies(scene) {
                true => Crowd::Places,
                false => Crowd::Vertices(vertices.max(MOST_CONTACTS + 1)),
            },
        }
    }))
}

/// Time by which all scripts have ended and what they moved is at rest \[s\].
fn end_s(scene: &Scene) -> f64 {
    let hand = scene.hand.iter();
    let points = hand.flat_map(|hand| &hand.way_points[..usize::from(hand.count)]);
    let ways = scene.tools.iter().filter_map(|tool| tool.way.as_ref());
    let stops = ways.flat_map(|way| way.stops()).map(|stop| stop.time_s);
    let times = points.map(|point| f64::from(point.time_s)).chain(stops);
    times.fold(0.0, f64::max) + AFTER_S
}

/// Whether a grip or a needle has a body.
fn has_bodies(scene: &Scene) -> bool {
    scene.bars().next().is_some() || scene.needles.iter().any(|part| part.body)
}

/// Most places that a needle's body can touch, wherever it lies \[-\]: as many vertices as its length has edges, and as its breadth.
fn most_places(scene: &Scene, surface: &Surface, part: &Needle) -> usize {
    let at = |node: u32| Vector3::from(scene.mesh.points_m()[node as usize]);
    let sides = surface.triangles.iter().flat_map(|&[a, b, c]| {
        let [a, b, c] = [a, b, c].map(at);
        [(a - b).norm(), (b - c).norm(), (c - a).norm()]
    });
    let shortest_m = sides.fold(f64::INFINITY, f64::min);
    let vertices = |way_m: f64| 1.0 + way_m / shortest_m;
    let along = vertices(part.needle.shape.length_m());
    (PLACES_A_VERTEX as f64 * along * vertices(part.needle.thickness_m)) as usize
}

/// Whether tools come near so many vertices, if they keep to their scripts, that a step may lack room. A needle's body goes where the
/// tissue lets it.
fn may_crowd(scene: &Scene, surface: &Surface, seconds: f64) -> bool {
    let mut script = Script::new(scene);
    let every_s = EVERY_S.max(seconds / MOST_LOOKS);
    let looks = (seconds / every_s).ceil() as u32;
    let limits = [
        (Part::Shape, MOST_CONTACTS),
        (Part::Body, MOST_TOUCHES / PLACES_A_VERTEX),
    ];
    let mut began: Vec<ToolSample> = Vec::new();
    let mut crowds = |look: u32| {
        let time_s = f64::from(look) * every_s;
        let in_hand = script.in_hand(time_s);
        let samples = script.step_to(time_s, in_hand, None);
        if look == 0 {
            began.extend_from_slice(samples);
        }
        // Tissue comes up around a tool that goes into it.
        let rests = |sample: &ToolSample| {
            began.iter().any(|began| {
                began.id == sample.id
                    && began.position_m == sample.position_m
                    && began.orientation == sample.orientation
            })
        };
        let reach_m = |sample: &ToolSample, radius_m: f64| match rests(sample) {
            true => MARGIN_M,
            false => NEAR * radius_m + MARGIN_M,
        };
        limits
            .iter()
            .any(|(part, most)| near(scene, surface, samples, *part, reach_m) > *most)
    };
    let mut needles = scene.needles.iter().filter(|part| part.body);
    needles.any(|part| most_places(scene, surface, part) > MOST_TOUCHES)
        || (0..=looks).any(&mut crowds)
}

/// Part of a tool that meets the tissue.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Part {
    /// Shape of a tool that is no grip.
    Shape,
    /// Body of a grip.
    Body,
}

/// Vertices of tissue at rest that are no farther from this part of the tools than `reach_m` says for a tool and its radius \[m\].
fn near(
    scene: &Scene,
    surface: &Surface,
    samples: &[ToolSample],
    part: Part,
    reach_m: impl Fn(&ToolSample, f64) -> f64,
) -> usize {
    let each = samples.iter().filter_map(|sample| {
        let tool = scene.tools.iter().find(|tool| tool.id == sample.id)?;
        let capsule;
        let shape = match part {
            Part::Shape => Some(&tool.shape).filter(|shape| !shape.is_grip())?,
            Part::Body => {
                capsule = tool.body?.capsule();
                &capsule
            }
        };
        let solid = Solid::new(shape, surface.mean_edge_m, &shape.place(sample)?);
        let reach_m = reach_m(sample, solid.radius());
        let bound_m = solid.bound() + reach_m;
        let is_near = |node: &&u32| {
            let at = Vector3::from(scene.mesh.points_m()[**node as usize]);
            (solid.centre - at).norm_squared() <= bound_m * bound_m && solid.gap(&at) <= reach_m
        };
        Some(surface.vertices.iter().filter(is_near).count())
    });
    each.sum()
}

/// A solver whose first step without room is remembered; after that it steps no more.
struct Watched {
    solver: SceneSolver,
    began_us: Option<u64>,
    full: Option<(u64, Vec<ToolSample>)>,
    /// Ends the session.
    is_full: Arc<AtomicBool>,
}

impl Solve for Watched {
    fn solve(&mut self, state: &Valid<State>) -> Solved {
        if self.full.is_some() {
            return Solved::default();
        }
        let now_us = state.console_time_us();
        let began_us = *self.began_us.get_or_insert(now_us);
        let solved = self.solver.solve(state);
        if solved.status == Status::TooManyRows {
            self.full = Some((
                now_us.saturating_sub(began_us),
                self.solver.samples().to_vec(),
            ));
            self.is_full.store(true, Ordering::Relaxed);
        }
        solved
    }

    fn spare(&mut self, effort: Effort) -> Spared {
        self.solver.spare(effort)
    }

    fn tune(&mut self, plan: &Plan) {
        self.solver.tune(plan);
    }

    fn act(&mut self, act: Act) -> bool {
        Solve::act(&mut self.solver, act)
    }

    fn scene(&self) -> Map<String, Value> {
        Map::new()
    }
}
