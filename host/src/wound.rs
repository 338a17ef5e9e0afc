//! How well a wound is closed: gaps, overlaps, bridges, tension, stress.
//!
//! Entry points: [`Wound::new`] before the first step, [`Wound::report`] at any time after it. Allocates and takes
//! steps of its own: for reports, not for the loop.

use crate::boxes::Bounds;
use crate::collide::{gaps_m, penetration_m};
use crate::fem::von_mises_pa;
use crate::model::Model;
use crate::scene::{Scene, TissueContact};
use crate::step::{State, Status, StepOptions, StepReport, Workspace, step};
use crate::thread::{Bridge, HandReport, ThreadReport, ThreadTension};
use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt;

/// Part of the spans' length in the unloaded mesh by which punctures are drawn together at a time, for comparison: a tenth of an
/// edge or less, where gaps are a few edges wide.
const WELDING_STEP: f64 = 1.0 / 60.0;
/// What is left of their length then: as good as nothing.
const WELDED: f64 = 1e-3;
/// Smallest part of such a step that is tried.
const SMALLEST_SHARE: f64 = 1.0 / 16.0;

/// Most steps that wait for columns at one place.
const MOST_WAITS: u32 = 64;

/// Parts of tissue that a scene brings together, and how far apart they were.
#[derive(Clone, Debug)]
pub struct Wound {
    contacts: Vec<TissueContact>,
    bodies: Bodies,
    threads: Vec<u8>,
    mean_edge_m: f64,
    /// Mean over all nodes of rims \[m\].
    gap_m: Option<f64>,
}

/// Boundaries of bodies that may touch, and the pairs of them.
#[derive(Clone, Debug, Default)]
struct Bodies {
    /// Boundary triangles of each, (f x 3).
    faces: Vec<Vec<[u32; 3]>>,
    pairs: Vec<[usize; 2]>,
}

/// Deepest interpenetration of touching parts that contact may leave [mean edges of the boundary]. Rims that a thread draws together on a
/// coarse mesh are a tenth deep in each other between their pairs.
const MOST_OVERLAP: f64 = 0.25;

/// Parts that may touch, deeper in each other than contact leaves them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Overlap {
    /// Deepest interpenetration over the mean edge of the boundary.
    pub ratio: f64,
}

impl Overlap {
    /// Next step.
    pub const HELP: &str = "move the parts apart in the mesh by `at_m`, or make the loads smaller; leave the pair out if its parts may pass";

    /// Returns the overlap of parts whose deepest interpenetration over the mean edge is `ratio`, if contact does not leave as much.
    pub fn of(ratio: f64) -> Option<Self> {
        (ratio > MOST_OVERLAP).then_some(Self { ratio })
    }
}

impl fmt::Display for Overlap {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "parts in `[[tissue_contact]]` are {:.2} mean edges deep in each other, and nothing keeps them apart there",
            self.ratio
        )
    }
}

/// What a scene with threads or tissues that touch reports; a key is left out where there is nothing to say.
#[derive(Clone, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct WoundReport {
    /// Mean gap of the rims over that at the start.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gap_ratio: Option<f64>,
    /// Deepest interpenetration over the mean edge of the boundary.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub penetration_ratio: Option<f64>,
    /// Longest of the spans of threads between two parts, each over its length in the unloaded mesh.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bridge_ratio: Option<f64>,
    /// `rim_gap_m` over `rim_gap_welded_m`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rim_gap_vs_welded: Option<f64>,
    /// Mean distance of the rims' nodes to the other part \[m\].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rim_gap_m: Option<f64>,
    /// The same of these punctures alone: what bridges the parts drawn together all the way from rest, and nothing that holds threads.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rim_gap_welded_m: Option<f64>,
    /// Largest tension at an end of a thread \[N\].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tension_n: Option<f64>,
    /// Thread drawn out of the tissue, of all threads at both ends and by hands that tighten \[m\].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pulled_m: Option<f64>,
    /// Largest principal stress of a cell, of either sign \[Pa\].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stress_peak_pa: Option<f64>,
    /// Largest equivalent stress of a cell (von Mises) \[Pa\].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub von_mises_peak_pa: Option<f64>,
    /// Pairs of features of touching parts that press.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub touching: Option<u32>,
    /// The threads, in the scene's order.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub threads: Vec<ThreadSummary>,
}

/// A thread as a step has left it.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct ThreadSummary {
    /// Id of the thread.
    pub thread: u8,
    /// `slack` or `taut`.
    pub state: &'static str,
    /// Ids of the tools that hold its tail and its head, (2).
    pub held_by: [Option<u8>; 2],
    /// Tension at tail and head \[N\], (2).
    pub tension_n: [f64; 2],
    /// Boundaries that it goes through.
    pub punctures: u32,
    /// Spans between two parts.
    pub bridges: usize,
    /// Each of them, from the tail on.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub bridging: Vec<BridgeSummary>,
    /// Length of its path, outside tissue and inside \[m\].
    pub length_m: f64,
    /// What there is of it for that \[m\].
    pub available_m: f64,
    /// Drawn out at tail and head \[m\], (2).
    pub pulled_m: [f64; 2],
    /// Segments of no length that the tension holds closed.
    pub welds: u32,
    /// Points of tissue that it bends around.
    pub wraps: u32,
    /// Bodies that its spans lie on, each span counted.
    #[serde(skip_serializing_if = "is_none")]
    pub laps: u32,
    /// Spent by friction \[J\].
    pub dissipated_j: f64,
    /// Slipped through the grips at tail and head so far \[m\], (2).
    #[serde(skip_serializing_if = "nothing_slipped")]
    pub slipped_m: [f64; 2],
    /// Drawn out of its spans by hands that tighten them \[m\].
    #[serde(skip_serializing_if = "is_nothing")]
    pub drawn_m: f64,
    /// What has been broken off \[m\], if it has broken.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub broken_off_m: Option<f64>,
    /// What holds it between its ends, from the tail on; what has the head, too, as long as the needle beyond is held.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub hands: Vec<HandSummary>,
    /// What it presses on tissue at each passage, from the tail on \[Pa\].
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub thread_pressure_pa: Vec<f64>,
}

/// A span between two parts as a step has left it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, JsonSchema)]
pub struct BridgeSummary {
    /// Its length over that in the unloaded mesh.
    pub ratio: f64,
    /// Tension in it \[N\].
    pub tension_n: f64,
}

/// A hand between the ends of a thread as a step has left it. Pairs are of the sides of the tail and of the head.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct HandSummary {
    /// Id of the tool; none for a place.
    pub held_by: Option<u8>,
    /// Where it holds the thread, counted from the head \[m\].
    pub along_m: f64,
    /// Tension at both sides \[N\], (2).
    pub tension_n: [f64; 2],
    /// Slipped through it so far to both sides \[m\], (2).
    #[serde(skip_serializing_if = "nothing_slipped")]
    pub slipped_m: [f64; 2],
}

fn is_nothing(length_m: &f64) -> bool {
    *length_m == 0.0
}

fn is_none(count: &u32) -> bool {
    *count == 0
}

fn nothing_slipped(slipped_m: &[f64; 2]) -> bool {
    *slipped_m == [0.0; 2]
}

impl Wound {
    /// What `scene` brings together; `None` if it has neither threads nor tissues that touch.
    pub fn new(scene: &Scene, model: &Model) -> Option<Self> {
        if scene.threads.is_empty() && scene.touching.is_empty() {
            return None;
        }
        let places: Vec<_> = model.points_m().iter().map(|x| Vector3::from(*x)).collect();
        Some(Self {
            gap_m: rim_gap_m(&scene.touching, &places),
            contacts: scene.touching.clone(),
            bodies: Bodies::of(scene),
            threads: scene.threads.iter().map(|thread| thread.part.id).collect(),
            mean_edge_m: model.surface().mean_edge_m,
        })
    }

    /// Returns the overlap of parts that may touch, if it is deeper than contact leaves them.
    pub fn overlap(&self, model: &Model, state: &State) -> Option<Overlap> {
        let at: Vec<_> = state
            .positions(model)
            .into_iter()
            .map(Vector3::from)
            .collect();
        Overlap::of(self.penetration_ratio(&at)?)
    }

    /// Deepest interpenetration of two bodies over the mean edge, with nodes `at` (n x 3) \[m\].
    fn penetration_ratio(&self, at: &[Vector3<f64>]) -> Option<f64> {
        let depth_m = self.bodies.penetration_m(at)?;
        Some(depth_m / self.mean_edge_m)
    }

    /// What a step has left.
    pub fn report(&self, model: &Model, state: &State, last: &StepReport) -> WoundReport {
        let nodes_m = state.positions(model);
        let at: Vec<_> = nodes_m.iter().copied().map(Vector3::from).collect();
        let gap_m = rim_gap_m(&self.contacts, &at);
        let bridges: Vec<_> = self
            .threads
            .iter()
            .map(|thread| state.bridges(model, *thread, &nodes_m))
            .collect();
        let each = bridges.iter().flatten().map(BridgeSummary::new);
        let ratios = each.map(|bridge| bridge.ratio);
        let bridge_ratio = ratios.reduce(f64::max);
        let welded_m = gap_m.zip(bridge_ratio).and_then(|_| {
            let drawn = self.welded(model, state)?;
            rim_gap_m(&self.contacts, &places(model, &drawn))
        });
        let displaced: Vec<[f64; 3]> = at
            .iter()
            .zip(model.points_m())
            .map(|(now, rest)| (now - Vector3::from(*rest)).into())
            .collect();
        let stresses = model.principal_stress_pa(&displaced);
        let threads = last.threads();
        let has_threads = !self.threads.is_empty();
        WoundReport {
            gap_ratio: gap_m.zip(self.gap_m).map(|(now, start)| now / start),
            penetration_ratio: self.penetration_ratio(&at),
            bridge_ratio,
            rim_gap_vs_welded: gap_m.zip(welded_m).map(|(now, welded)| now / welded),
            rim_gap_m: gap_m,
            rim_gap_welded_m: welded_m,
            tension_n: threads
                .iter()
                .map(|thread| last.most_tension_n(thread.id))
                .reduce(f64::max),
            pulled_m: has_threads.then(|| threads.iter().map(drawn_m).sum()),
            stress_peak_pa: stresses.iter().flatten().map(|s| s.abs()).reduce(f64::max),
            von_mises_peak_pa: stresses.iter().map(von_mises_pa).reduce(f64::max),
            touching: (!self.contacts.is_empty()).then_some(last.touching),
            threads: threads
                .iter()
                .zip(&bridges)
                .map(|(thread, bridges)| ThreadSummary {
                    thread_pressure_pa: state.thread_pressures_pa(model, thread.id),
                    hands: hands_of(last, thread.id),
                    bridging: bridges.iter().map(BridgeSummary::new).collect(),
                    ..ThreadSummary::new(thread, bridges.len())
                })
                .collect(),
        }
    }

    /// The same punctures drawn together from rest, their spans all to the same part of their lengths, with nothing that holds
    /// threads and tissues kept apart all the while: it depends on the punctures alone. `None` if that finds no balance.
    fn welded(&self, model: &Model, state: &State) -> Option<State> {
        let (mut state, mut work) = (state.sewn_at_rest(model), Workspace::new(model));
        let (mut left, mut part) = (1.0f64, WELDING_STEP);
        // What found no balance is tried again in smaller steps.
        while left > WELDED {
            let next = (left - part).max(WELDED);
            for thread in &self.threads {
                state.weld(model, *thread, next);
            }
            match balance(model, &mut state, &mut work) {
                Status::Ok => left = next,
                status if part <= WELDING_STEP * SMALLEST_SHARE => {
                    tracing::info!(
                        "the gap of welded punctures is not known: {status:?} at {next}"
                    );
                    return None;
                }
                _ => part *= 0.5,
            }
        }
        Some(state)
    }
}

/// How a step ends; one that computes columns goes on, as a step has room for some only.
fn balance(model: &Model, state: &mut State, work: &mut Workspace) -> Status {
    let mut status = Status::Waiting;
    for _ in 0..MOST_WAITS {
        if !matches!(status, Status::Waiting | Status::Behind) {
            break;
        }
        status = step(model, state, &[], &StepOptions::default(), work).status;
    }
    status
}

fn places(model: &Model, state: &State) -> Vec<Vector3<f64>> {
    let places = state.positions(model);
    places.into_iter().map(Vector3::from).collect()
}

impl Bodies {
    /// Collects the two parts of each contact, and the bodies of a part that may touch itself.
    fn of(scene: &Scene) -> Self {
        let (body_of, _) = scene.mesh.half_faces().bodies();
        let mut bodies = Self::default();
        for pair in &scene.touching {
            let first = bodies.faces.len();
            if pair.is_within_one() {
                let mut own: BTreeMap<u32, Vec<[u32; 3]>> = BTreeMap::new();
                for face in &pair.faces[0] {
                    own.entry(body_of[face[0] as usize])
                        .or_default()
                        .push(*face);
                }
                bodies.faces.extend(own.into_values());
            } else {
                bodies.faces.extend(pair.faces.clone());
            }
            let own = first..bodies.faces.len();
            let pairs = own.clone().flat_map(|one| {
                let others = one + 1..own.end;
                others.map(move |other| [one, other])
            });
            bodies.pairs.extend(pairs);
        }
        bodies
    }

    /// Deepest interpenetration of a pair with nodes `at` (n x 3) \[m\]; none without pairs.
    fn penetration_m(&self, at: &[Vector3<f64>]) -> Option<f64> {
        let around = |faces: &Vec<[u32; 3]>| {
            let nodes = faces.iter().flatten();
            nodes.fold(Bounds::NOTHING, |all, node| all.with(&at[*node as usize]))
        };
        let bounds: Vec<_> = self.faces.iter().map(around).collect();
        let depths_m =
            self.pairs
                .iter()
                .map(|&[one, other]| match bounds[one].meets(&bounds[other]) {
                    true => penetration_m([&self.faces[one], &self.faces[other]], at),
                    false => 0.0,
                });
        depths_m.reduce(f64::max)
    }
}

/// Mean distance of the rims' nodes to the other part \[m\]; `None` without rims.
fn rim_gap_m(contacts: &[TissueContact], at: &[Vector3<f64>]) -> Option<f64> {
    let mut gaps = Vec::new();
    for pair in contacts {
        let [first, second] = &pair.rims;
        gaps.extend(gaps_m(first, &pair.faces[1], at));
        gaps.extend(gaps_m(second, &pair.faces[0], at));
    }
    let count = gaps.len() as f64;
    (!gaps.is_empty()).then(|| gaps.iter().sum::<f64>() / count)
}

impl BridgeSummary {
    fn new(bridge: &Bridge) -> Self {
        Self {
            ratio: bridge.now_m / bridge.rest_m,
            tension_n: bridge.tension_n,
        }
    }
}

impl ThreadSummary {
    fn new(report: &ThreadReport, bridges: usize) -> Self {
        Self {
            thread: report.id,
            state: match report.state {
                ThreadTension::Slack => "slack",
                ThreadTension::Taut => "taut",
            },
            held_by: report.held_by,
            tension_n: report.tension_n,
            punctures: report.punctures,
            bridges,
            bridging: Vec::new(),
            length_m: report.length_m,
            available_m: report.available_m,
            pulled_m: report.pulled_m,
            welds: report.welds,
            wraps: report.wraps,
            laps: report.laps,
            dissipated_j: report.dissipated_j,
            slipped_m: report.slipped_m,
            drawn_m: report.drawn_m,
            broken_off_m: report.broken_off_m,
            hands: Vec::new(),
            thread_pressure_pa: Vec::new(),
        }
    }
}

/// Drawn out of the tissue so far, at both ends and by hands that tighten \[m\].
fn drawn_m(report: &ThreadReport) -> f64 {
    report.pulled_m.iter().sum::<f64>() + report.drawn_m
}

fn hands_of(report: &StepReport, thread: u8) -> Vec<HandSummary> {
    let hands = report.hands().iter();
    let hands = hands.filter(|hand| hand.thread == thread);
    hands.map(HandSummary::new).collect()
}

impl HandSummary {
    fn new(report: &HandReport) -> Self {
        Self {
            held_by: report.tool,
            along_m: report.along_m,
            tension_n: report.tension_n,
            slipped_m: report.slipped_m,
        }
    }
}
