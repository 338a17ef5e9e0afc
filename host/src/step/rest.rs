//! The state before the first step where loads or handles bring tissues together, and that of hyperelastic tissue that
//! handles hold: these come on in pieces, a balance at the end of each.
//!
//! Entry points: [`settle`], [`hold`]. Where the loads alone would have the tissues says nothing of which side of each other they
//! rest on, so the way there is followed from the unloaded mesh, as a step follows that of a needle.

use super::balance::Balance;
use super::report::{Status, StepReport};
use super::sources::{Sources, SourcesState, SourcesWork};
use super::targets::Targets;
use crate::anchors::ConstraintState;
use crate::body::{Body, Motion};
use crate::clock::Clock;
use crate::collide::TouchState;
use crate::fem::Moved;
use crate::model::Model;
use crate::needle::NeedlePart;
use crate::source::Handles;
use crate::thread::Threads;
use crate::work;
use nalgebra::Vector3;

/// Most parts of the loads that are tried: tissue that these would move by more pieces of a way has loads that cannot be meant.
const MOST_TRIED: u32 = 256;
/// Smallest part of the loads that is tried by itself.
const LEAST_SHARE: f64 = 1.0 / 4096.0;
/// Out-of-balance force on tissue that turns over the forces on it, at the end and on the way.
const IN_BALANCE: [f64; 2] = [1e-10, 1e-3];
/// Passes over such tissue at one share of the loads: a stale factor leaves about a tenth in each.
const MOST_PASSES: u32 = 300;
/// Of these, such that can only go a part of their way: cells that would have to turn inside out become flatter for ever.
const MOST_PARTS: u32 = 20;
/// Balances under the whole loads until nothing moves, for what rows leave to the next one.
const MOST_BALANCES: u32 = 32;
/// Farthest way of a node between two of them that is none, in mean edges.
const AT_REST: f64 = 1e-9;

/// What evolves, before the first step.
#[derive(Clone, Debug)]
pub(crate) struct Rest {
    /// Its rows and their forces.
    pub grasp: ConstraintState,
    pub touch: TouchState,
    /// Elastic energy beyond that under the loads alone \[J\]; 0 for tissue that turns.
    pub stored_j: f64,
}

/// Loads under which no balance was found.
#[derive(Clone, Copy, Debug)]
pub(crate) struct NoRest {
    /// Part of them at which one was found still.
    pub share: f64,
    pub status: Status,
}

/// What is taken from the needles on the way.
struct Whole {
    resting: Vec<[f64; 3]>,
    resting_m: Vec<Vector3<f64>>,
    handles: Handles,
    parts: Vec<NeedlePart>,
    threads: Threads,
}

/// Brings tissues that may touch to rest under the loads and handles of a model, which remembers that as
/// [`Sources::rest`] and in its motion. Sources and threads are left out: they begin apart from the tissue. Nothing changes
/// where nothing touches.
///
/// # Errors
/// The part of the loads that has a balance, and what the next one ended with.
pub(crate) fn settle(model: &mut Model) -> Result<(), NoRest> {
    let Some(mut sources) = model.sources.take() else {
        return Ok(());
    };
    let far_m = way_m(&sources);
    let settled = if far_m > 0.0 {
        let whole = Whole::take_from(&mut sources);
        let settled = follow(model, &mut sources, &whole, far_m);
        whole.give_back(&mut sources);
        settled
    } else {
        Ok(None)
    };
    if let Ok(Some((rest, motion, potential_j))) = &settled {
        sources.rest = Some(Box::new(rest.clone()));
        model.motion = motion.clone();
        model.resting_potential_j = potential_j.unwrap_or(model.resting_potential_j);
    }
    model.sources = Some(sources);
    settled.map(|_| ())
}

/// Farthest way of a node that may touch, from the unloaded mesh \[m\].
fn way_m(sources: &Sources) -> f64 {
    let touching = sources.touching.iter();
    let nodes = touching.flat_map(|touching| touching.nodes());
    let ways = nodes.filter_map(|node| sources.resting.get(*node as usize));
    ways.fold(0.0, |most, way| most.max(Vector3::from(*way).norm()))
}

impl Whole {
    fn take_from(sources: &mut Sources) -> Self {
        Self {
            resting: sources.resting.clone(),
            resting_m: sources.resting_m.clone(),
            handles: std::mem::take(&mut sources.handles),
            parts: std::mem::take(&mut sources.needles),
            threads: std::mem::replace(&mut sources.threads, Threads::none()),
        }
    }

    fn give_back(self, sources: &mut Sources) {
        sources.resting = self.resting;
        sources.resting_m = self.resting_m;
        sources.handles = self.handles;
        sources.needles = self.parts;
        sources.threads = self.threads;
    }

    /// Has so much of the loads act.
    fn load(&self, sources: &mut Sources, points_m: &[[f64; 3]], share: f64) {
        let whole = self.resting.iter().zip(points_m);
        let scaled = sources.resting.iter_mut().zip(&mut sources.resting_m);
        for ((way, at), (whole, from)) in scaled.zip(whole) {
            *way = whole.map(|u| share * u);
            *at = Vector3::from(*from) + Vector3::from(*way);
        }
        sources.handles = self.handles.at_share(share);
    }
}

/// The rest, the tissue's motion there and the potential energy of tissue that turns \[J\].
type Settled = (Rest, Motion, Option<f64>);

/// Says that a rest is looked for.
fn begin(far_m: f64) {
    work::begin("looking for rest under loads and handles", || {
        format!("nodes go up to {:.1} mm", 1e3 * far_m)
    });
}

/// Takes the loads on; nothing if tissues do not touch in the end.
fn follow(
    model: &Model,
    sources: &mut Sources,
    whole: &Whole,
    far_m: f64,
) -> Result<Option<Settled>, NoRest> {
    let points_m = model.points_m();
    begin(far_m);
    whole.load(sources, points_m, 0.0);
    // There are as many rows at any share.
    let mut work = SourcesWork::new(model, sources);
    let mut state = SourcesState::new(sources, model.body.at_rest());
    in_shares(
        sources.piece_m / far_m,
        &mut state,
        |state, share, exact| {
            whole.load(sources, points_m, share);
            work.balance.nodes.rest_moved();
            let body = model.body.at_share(share);
            balance(&body, sources, points_m, state, &mut work, exact)
        },
    )?;
    come_to_rest(model, sources, &mut state, &mut work)
        .map_err(|status| NoRest { share: 1.0, status })?;
    let SourcesState { grasp, touch, .. } = state;
    let touch = touch.filter(|touch| touch.pairs() > 0);
    Ok(touch.map(|touch| {
        let motion = grasp.motion().clone();
        let system = &mut work.balance.system;
        let potential_j = model.body.potential_j(&motion, system.body_work());
        let stored_j = potential_j.map_or_else(|| system.stored_j(&grasp), |_| 0.0);
        let rest = Rest {
            grasp,
            touch,
            stored_j,
        };
        (rest, motion, potential_j)
    }))
}

/// Brings hyperelastic tissue from its balance under the loads alone to where its handles hold it; its motion there, and
/// their forces on the tissue \[N\], (h x 3).
///
/// # Errors
/// The part of the handles' ways that has a balance, and what the next one ended with.
pub(crate) fn hold(
    model: &Model,
    mut sources: Sources,
    handles: &Handles,
) -> Result<(Motion, Vec<[f64; 3]>), NoRest> {
    let resting = sources.resting.clone();
    let along = |share| handles.part_way(&resting, share);
    sources.handles = along(0.0);
    let far_m = handles.way_m(&resting);
    begin(far_m);
    let mut work = SourcesWork::new(model, &sources);
    let mut state = SourcesState::new(&sources, model.motion.clone());
    in_shares(
        sources.piece_m / far_m,
        &mut state,
        |state, share, exact| {
            sources.handles = along(share);
            let (body, points_m) = (&model.body, model.points_m());
            balance(body, &sources, points_m, state, &mut work, exact)
        },
    )?;
    Ok((
        state.grasp.motion().clone(),
        sources.handles.forces_n(&state.grasp),
    ))
}

/// Comes to a balance at growing shares of what acts, `stride` apart at first, up to the whole; each is asked for with
/// how exact it has to be. Gives up after so [many](MOST_TRIED).
fn in_shares(
    stride: f64,
    state: &mut SourcesState,
    mut balanced: impl FnMut(&mut SourcesState, f64, f64) -> Result<(), Status>,
) -> Result<(), NoRest> {
    let (mut share, mut stride) = (0.0, stride.min(1.0));
    let mut tried = 0;
    let mut why = Status::NotConverged;
    while share < 1.0 {
        // The rest of them by strides like this is too many: that is known before they are tried.
        let left = (1.0 - share) / stride;
        if f64::from(tried) + left > f64::from(MOST_TRIED) || work::is_stopped() {
            return Err(NoRest { share, status: why });
        }
        tried += 1;
        work::part((1e3 * share) as usize, 1000);
        let next = if share + stride < 1.0 {
            share + stride
        } else {
            1.0
        };
        let before = state.clone();
        let exact = IN_BALANCE[usize::from(next < 1.0)];
        match balanced(state, next, exact) {
            Ok(()) => share = next,
            Err(status) => {
                *state = before;
                why = status;
                stride *= 0.5;
                if stride < LEAST_SHARE {
                    return Err(NoRest { share, status });
                }
            }
        }
    }
    Ok(())
}

/// Balances under the whole loads until nothing moves.
fn come_to_rest(
    model: &Model,
    sources: &Sources,
    state: &mut SourcesState,
    work: &mut SourcesWork,
) -> Result<(), Status> {
    let mean_edge_m = model.surface().mean_edge_m;
    for _ in 0..MOST_BALANCES {
        let before = state.touch.as_ref().map(|touch| touch.at_m().to_vec());
        let (body, points_m) = (&model.body, model.points_m());
        balance(body, sources, points_m, state, work, IN_BALANCE[0])?;
        let now = state.touch.iter().flat_map(TouchState::at_m);
        let ways = before.iter().flatten().zip(now);
        let moved_m = ways.fold(0.0f64, |most, (from, to)| most.max((to - from).norm()));
        if moved_m <= AT_REST * mean_edge_m {
            break;
        }
    }
    Ok(())
}

/// Balances tissue at one share of its loads; tissue that turns until its out-of-balance force is a share `exact` of
/// the forces.
fn balance(
    body: &Body,
    sources: &Sources,
    points_m: &[[f64; 3]],
    state: &mut SourcesState,
    work: &mut SourcesWork,
    exact: f64,
) -> Result<(), Status> {
    work.balance.system.begin_step();
    let mut parts = 0;
    for pass in 0..MOST_PASSES {
        if let Some(balance) = work.balance.system.look(body, &mut state.grasp)
            && pass > 0
            && balance.imbalance <= exact
        {
            return Ok(());
        }
        let linearised = work.balance.system.linearise(body, &mut state.grasp);
        if linearised.is_some_and(|linearised| !linearised.sound) {
            return Err(Status::NotConverged);
        }
        let mut balance = Balance {
            body,
            sources,
            points_m,
            most_vertices: usize::MAX,
            tip_reach_m: 0.0,
            state,
            work: &mut work.balance,
            report: &mut StepReport::default(),
            clock: &mut Clock::start(),
        };
        balance.to(&Targets::none())?;
        if body.is_linear() {
            return Ok(());
        }
        let moved = work.balance.system.accept(body, &mut state.grasp);
        parts += u32::from(moved != Moved::Whole);
        if parts > MOST_PARTS {
            break;
        }
    }
    Err(Status::NotConverged)
}

#[cfg(test)]
mod tests {
    use crate::scene::{Document, SceneError, read};
    use crate::work::{TARGET, WHAT};
    use std::fmt::Debug;
    use std::sync::{Arc, Mutex};
    use tracing::field::{Field, Visit};
    use tracing::span::{Attributes, Id, Record};
    use tracing::{Event, Metadata, Subscriber};

    /// Names of the work that was begun.
    #[derive(Clone, Default)]
    struct Told(Arc<Mutex<Vec<String>>>);

    impl Subscriber for Told {
        fn enabled(&self, metadata: &Metadata<'_>) -> bool {
            metadata.target() == TARGET
        }

        fn new_span(&self, _: &Attributes<'_>) -> Id {
            Id::from_u64(1)
        }

        fn record(&self, _: &Id, _: &Record<'_>) {}

        fn record_follows_from(&self, _: &Id, _: &Id) {}

        fn event(&self, event: &Event<'_>) {
            event.record(&mut &*self);
        }

        fn enter(&self, _: &Id) {}

        fn exit(&self, _: &Id) {}
    }

    impl Visit for &Told {
        fn record_str(&mut self, field: &Field, value: &str) {
            if field.name() == WHAT {
                let mut told = self.0.lock().expect("nobody has panicked");
                told.push(value.to_owned());
            }
        }

        fn record_debug(&mut self, _: &Field, _: &dyn Debug) {}
    }

    /// Slabs that a force presses together \[N\], and the work that is told.
    fn pressed(down_n: f64) -> (Result<(), SceneError>, Vec<String>) {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../scenes/touching-slabs.toml");
        let text = std::fs::read_to_string(path).expect("a scene that ships");
        let loads = format!("total_force_n = [0.0, 0.1, -{down_n}]");
        let text = text.replace("total_force_n = [0.0, 0.1, -0.5]", &loads);
        assert!(text.contains(&loads));
        let told = Told::default();
        let scene = read(&Document::embedded("slabs.toml", "".as_ref(), &text));
        let scene = scene.expect("a good scene");
        let built = tracing::subscriber::with_default(told.clone(), || scene.build());
        let told = told.0.lock().expect("nobody has panicked").clone();
        (built.map(drop), told)
    }

    /// The search for rest is told under its own name, and loads that move tissue out of all proportion are refused before it takes minutes.
    #[test]
    fn rest_is_looked_for_by_its_name_and_within_limits() {
        let (built, told) = pressed(0.5);
        built.expect("rest under half a newton");
        let is_rest = |what: &&String| what.starts_with("looking for rest");
        assert_eq!(told.iter().filter(is_rest).count(), 1, "{told:?}");
        let (built, told) = pressed(500.0);
        assert_eq!(told.iter().filter(is_rest).count(), 1, "{told:?}");
        let error = built.expect_err("no rest under 500 N").to_string();
        assert!(error.contains("make the loads smaller"), "{error}");
    }
}
