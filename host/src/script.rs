//! What a scene's scripts say at a time: where tools are that the console does not carry, how grips are
//! turned, and who holds which needle.
//!
//! Entry points: [`Script::step_to`] and [`Script::follow`] before each step; [`path`] for what a session will
//! come by.

use crate::model::Model;
use crate::scene::{Pose, Scene, Way, position_at};
use crate::step::State;
use crate::tool::ToolSample;
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};
use sutura_shared::wire::message::HandScript;

/// The scripts of a scene, and how far they have been followed.
#[derive(Clone, Debug)]
pub struct Script {
    /// The driven tool, if there is one, then those that are held or moved.
    samples: Vec<ToolSample>,
    /// Of each sample's tool.
    ways: Vec<Option<Way>>,
    is_driven: bool,
    /// In the order of time.
    changes: Vec<Change>,
    /// How many of them have been made.
    made: usize,
    /// Whether tools and needles have met in a step before.
    has_begun: bool,
    hand: Option<HandScript>,
    /// Where the driven tool is without a hand, before its script turns it.
    rest: Pose,
}

/// A needle changes hands.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Change {
    time_s: f64,
    needle: u8,
    tool: Option<u8>,
}

impl Script {
    /// The scripts of `scene`, at their start. The driven tool is where the hand begins or the scene holds it;
    /// without either it is at the origin until [`Self::go`] is told where.
    pub fn new(scene: &Scene) -> Self {
        let somewhere = Pose {
            position_m: [0.0; 3],
            orientation: [0.0, 0.0, 0.0, 1.0],
        };
        let driven = scene.driven();
        let at = |id, pose: Option<Pose>| at_rest(id, &pose.unwrap_or(somewhere));
        let held = || scene.held();
        let samples = driven
            .map(|tool| at(tool.id, tool.pose))
            .into_iter()
            .chain(held().map(|(tool, pose)| at(tool.id, Some(pose))));
        let ways = driven
            .map(|tool| tool.way.clone())
            .into_iter()
            .chain(held().map(|(tool, _)| tool.way.clone()));
        let mut changes: Vec<Change> = scene
            .needles
            .iter()
            .flat_map(|needle| {
                needle.holds.iter().map(|hold| Change {
                    time_s: hold.time_s,
                    needle: needle.id,
                    tool: hold.tool,
                })
            })
            .collect();
        changes.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
        let rest = driven.and_then(|tool| tool.pose).map_or(somewhere, |pose| {
            let turns = driven.is_some_and(|tool| tool.way.is_some());
            let orientation = if turns {
                somewhere.orientation
            } else {
                pose.orientation
            };
            Pose {
                orientation,
                ..pose
            }
        });
        let mut script = Script {
            samples: samples.collect(),
            ways: ways.collect(),
            is_driven: driven.is_some(),
            changes,
            made: 0,
            has_begun: false,
            hand: scene.hand,
            rest,
        };
        let begin = script.in_hand(0.0);
        script.go(0.0, begin);
        script
    }

    /// Id of the tool that the console's grip carries.
    pub fn driven(&self) -> Option<u8> {
        let first = self.samples.first().filter(|_| self.is_driven);
        first.map(|sample| sample.id)
    }

    /// Where the tools are: the driven one, if there is one, then the others.
    pub fn samples(&self) -> &[ToolSample] {
        &self.samples
    }

    /// Goes on to a time since the session began \[s\], with the driven tool, if there is one, where the console has
    /// it (its script turns it further), and lets needles change hands. Returns where the tools are for the step.
    pub fn step_to(
        &mut self,
        time_s: f64,
        console: ToolSample,
        model: &Model,
        state: &mut State,
    ) -> &[ToolSample] {
        if !self.has_begun {
            self.go(time_s, console);
        }
        // A needle is taken where the last step has left it, by a tool where that was then.
        while let Some(change) = self.due(time_s) {
            let by = change.tool.and_then(|id| self.sample(id));
            // The scene has been checked: there is such a needle.
            state.hold(model, change.needle, by.as_ref());
        }
        if self.has_begun {
            self.go(time_s, console);
        }
        self.has_begun = true;
        &self.samples
    }

    /// [`Self::step_to`] with the driven tool on the hand's path, or held where the scene says without a hand.
    pub fn follow(&mut self, time_s: f64, model: &Model, state: &mut State) -> &[ToolSample] {
        self.step_to(time_s, self.in_hand(time_s), model, state)
    }

    /// The driven tool on the hand's path.
    fn in_hand(&self, time_s: f64) -> ToolSample {
        let pose = match &self.hand {
            Some(hand) => Pose {
                position_m: position_at(hand, time_s),
                orientation: [0.0, 0.0, 0.0, 1.0],
            },
            None => self.rest,
        };
        ToolSample {
            console_time_us: (1e6 * time_s).round() as u64,
            ..at_rest(self.driven().unwrap_or_default(), &pose)
        }
    }

    fn go(&mut self, time_s: f64, console: ToolSample) {
        for sample in &mut self.samples {
            sample.console_time_us = console.console_time_us;
        }
        if let Some(driven) = self.samples.first_mut().filter(|_| self.is_driven) {
            *driven = console;
        }
        for (index, (sample, way)) in self.samples.iter_mut().zip(&self.ways).enumerate() {
            let Some(on_way) = way.as_ref().map(|way| way.at(time_s)) else {
                continue;
            };
            if let Some((position_m, velocity_m_per_s)) = on_way.moved {
                sample.position_m = position_m;
                sample.velocity_m_per_s = velocity_m_per_s;
            }
            sample.orientation = if self.is_driven && index == 0 {
                let turned = quaternion(on_way.orientation) * quaternion(console.orientation);
                turned.coords.into()
            } else {
                on_way.orientation
            };
        }
    }

    fn due(&mut self, time_s: f64) -> Option<Change> {
        let next = self.changes.get(self.made)?;
        let due = (next.time_s <= time_s).then_some(*next)?;
        self.made += 1;
        Some(due)
    }

    fn sample(&self, id: u8) -> Option<ToolSample> {
        self.samples.iter().find(|sample| sample.id == id).copied()
    }
}

/// A tool at rest there.
pub(crate) fn at_rest(id: u8, pose: &Pose) -> ToolSample {
    ToolSample {
        id,
        position_m: pose.position_m,
        orientation: pose.orientation,
        velocity_m_per_s: [0.0; 3],
        console_time_us: 0,
    }
}

/// A sample's or a script's own: of unit length.
fn quaternion([x, y, z, w]: [f64; 4]) -> UnitQuaternion<f64> {
    UnitQuaternion::new_unchecked(Quaternion::new(w, x, y, z))
}

/// Places that a session comes by if its hands keep to their scripts.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Path {
    /// Of the driven tool's grip, and how it is turned there.
    pub grips: Vec<Pose>,
    /// Of the needles' centre lines \[m\].
    pub needles: Vec<Vector3<f64>>,
}

/// Where the scripts lead until `seconds` \[s\], looked at `every_s`; points of a needle are at most `apart_m` from each
/// other. Empty without a hand.
pub fn path(scene: &Scene, seconds: f64, every_s: f64, apart_m: f64) -> Path {
    let mut path = Path::default();
    if scene.hand.is_none() {
        return path;
    }
    let mut script = Script::new(scene);
    // Needles as they would go in the open, and in which tool's frame they are where.
    let mut poses: Vec<Isometry3<f64>> = scene.needles.iter().map(|n| n.start).collect();
    let mut grips: Vec<Option<(u8, Isometry3<f64>)>> = vec![None; poses.len()];
    let places = (seconds / every_s).ceil().max(0.0) as u32;
    for place in 0..=places {
        let time_s = f64::from(place) * every_s;
        while let Some(change) = script.due(time_s) {
            let by = change.tool.and_then(|id| script.sample(id));
            let index = scene.needles.iter().position(|n| n.id == change.needle);
            if let Some(index) = index {
                grips[index] = by.map(|tool| (tool.id, isometry(&tool).inverse() * poses[index]));
            }
        }
        let in_hand = script.in_hand(time_s);
        script.go(time_s, in_hand);
        if let Some(grip) = script.samples.first().filter(|_| script.is_driven) {
            path.grips.push(Pose {
                position_m: grip.position_m,
                orientation: grip.orientation,
            });
        }
        for ((needle, pose), grip) in scene.needles.iter().zip(&mut poses).zip(&grips) {
            let holder = grip.and_then(|(id, _)| script.sample(id));
            if let (Some(tool), Some((_, in_grip))) = (holder, grip) {
                *pose = isometry(&tool) * in_grip;
            }
            let curve = needle.needle.at(pose);
            let pieces = (curve.length / apart_m).ceil().max(1.0) as u32;
            let alphas = (0..=pieces).map(|k| curve.length * f64::from(k) / f64::from(pieces));
            path.needles.extend(alphas.map(|alpha| curve.at(alpha)));
        }
    }
    path
}

fn isometry(sample: &ToolSample) -> Isometry3<f64> {
    Isometry3::from_parts(
        Translation3::from(sample.position_m),
        quaternion(sample.orientation),
    )
}
