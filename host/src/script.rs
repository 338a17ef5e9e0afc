//! What a scene's scripts say at a time: where tools are that the console does not carry, how grips are
//! turned, and who holds which needle and thread, as far as hands reach.
//!
//! Entry points: [`Script::step_to`] and [`Script::follow`] before each step; [`path`] for what a session will
//! come by.

mod holds;
mod path;

use crate::contact::shape::Solid;
use crate::event::Event;
use crate::mesh::Surface;
use crate::model::Model;
use crate::scene::{Jaws, Pose, Scene, Thread, Way, position_at};
use crate::step::State;
use crate::thread::Tightening;
use crate::tool::{Act, Tool, ToolSample};
use holds::{Change, Waiting, changes};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};
pub use path::{Fall, Path, path};
use sutura_shared::wire::message::HandScript;

/// The scripts of a scene, and how far they have been followed.
#[derive(Clone, Debug)]
pub struct Script {
    /// The driven tool, if there is one, then those that are held or moved.
    samples: Vec<ToolSample>,
    /// Of each sample's tool.
    ways: Vec<Option<Way>>,
    /// Where somebody has put each, in place of its way.
    placed: Vec<Option<Pose>>,
    /// From how far it takes what it is to hold \[m\].
    reaches_m: Vec<f64>,
    is_driven: bool,
    /// In the order of time; needles before threads.
    changes: Vec<Change>,
    /// How many of them have been due.
    made: usize,
    /// Those of them that have not been made yet, for what is out of reach.
    waiting: Vec<Waiting>,
    /// What was out of reach, to be told.
    missed: Vec<Event>,
    /// Those that are tightened, each with what it was tightened to last.
    tightened: Vec<(Thread, Option<Tightening>)>,
    /// Jaws, and whether their script had each closed last: hands may do otherwise in between.
    jaws: Vec<(Jaws, bool)>,
    /// Whether tools and needles have met in a step before.
    has_begun: bool,
    hand: Option<HandScript>,
    /// Where the driven tool is without a hand, before its script turns it.
    rest: Pose,
}

impl Script {
    /// The scripts of `scene`, at their start. The driven tool is where the hand begins or the scene holds it;
    /// without either it is at the origin until the first step.
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
        let changes = changes(scene);
        let reaches = driven.into_iter().chain(held().map(|(tool, _)| tool));
        let reaches = reaches.map(|tool| tool.reach_m);
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
        let samples: Vec<_> = samples.collect();
        let mut script = Script {
            placed: vec![None; samples.len()],
            samples,
            ways: ways.collect(),
            is_driven: driven.is_some(),
            reaches_m: reaches.collect(),
            waiting: Vec::with_capacity(changes.len()),
            missed: Vec::with_capacity(changes.len()),
            changes,
            made: 0,
            tightened: scene
                .threads
                .iter()
                .filter(|thread| !thread.tightens.is_empty())
                .map(|thread| (thread.clone(), None))
                .collect(),
            jaws: scene
                .jaws
                .iter()
                .map(|jaws| (jaws.clone(), false))
                .collect(),
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
    /// it (its script turns it further), and lets needles and threads in the tissue, if there are any, change hands and be
    /// tightened. Returns where the tools are for the step.
    pub fn step_to(
        &mut self,
        time_s: f64,
        console: ToolSample,
        tissue: Option<(&Model, &mut State)>,
    ) -> &[ToolSample] {
        if !self.has_begun {
            self.go(time_s, console);
        }
        // A needle is taken where the last step has left it, by a tool where that was then.
        if let Some((model, state)) = tissue {
            self.change_hands(time_s, model, state);
        }
        if self.has_begun {
            self.go(time_s, console);
        }
        self.has_begun = true;
        &self.samples
    }

    fn change_hands(&mut self, time_s: f64, model: &Model, state: &mut State) {
        while let Some(change) = self.due(time_s) {
            self.waiting.retain(|hold| !hold.ends_with(&change));
            self.waiting.push(Waiting::new(change));
        }
        let mut waiting = std::mem::take(&mut self.waiting);
        waiting.retain_mut(|hold| !self.take(hold, model, state));
        self.waiting = waiting;
        for (thread, before) in &mut self.tightened {
            let now = thread.tightened(time_s);
            if now != *before {
                state.tighten(model, thread.part.id, now);
                *before = now;
            }
        }
        for (jaws, before) in &mut self.jaws {
            let (now, tool) = (jaws.is_closed(time_s), jaws.part.tool);
            if now != std::mem::replace(before, now) {
                state.act(model, Act::of_jaws(tool, now));
            }
        }
    }

    /// From the next step on a tool that the console does not carry is there, whatever its script says; whether there is such a tool.
    pub fn place(&mut self, tool: u8, pose: &Pose) -> bool {
        let driven = self.driven();
        let mut places = self.samples.iter().zip(&mut self.placed);
        let found = places.find(|(sample, _)| sample.id == tool && driven != Some(tool));
        found.map(|(_, placed)| *placed = Some(*pose)).is_some()
    }

    /// [`Self::step_to`] with the driven tool on the hand's path, or held where the scene says without a hand.
    pub fn follow(&mut self, time_s: f64, model: &Model, state: &mut State) -> &[ToolSample] {
        self.step_to(time_s, self.in_hand(time_s), Some((model, state)))
    }

    /// The driven tool on the hand's path.
    pub(crate) fn in_hand(&self, time_s: f64) -> ToolSample {
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
        let ways = self.ways.iter().zip(&self.placed);
        for (index, (sample, (way, placed))) in self.samples.iter_mut().zip(ways).enumerate() {
            if let Some(pose) = placed {
                let console_time_us = sample.console_time_us;
                *sample = ToolSample {
                    console_time_us,
                    ..at_rest(sample.id, pose)
                };
                continue;
            }
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

    /// Makes a change that is due, if what is to be held is within reach; whether it is.
    fn take(&mut self, hold: &mut Waiting, model: &Model, state: &mut State) -> bool {
        let hand = hold.tool().and_then(|id| self.hand(id));
        let missed = hand.and_then(|(sample, reach_m)| hold.missed(&sample, reach_m, model, state));
        match missed {
            Some(missed) => self.missed.extend(hold.tell(missed)),
            None => hold.make(&self.samples, model, state),
        }
        missed.is_none()
    }

    /// A tool, and how far it reaches \[m\].
    fn hand(&self, id: u8) -> Option<(ToolSample, f64)> {
        let mut hands = self.samples.iter().zip(&self.reaches_m);
        let found = hands.find(|(sample, _)| sample.id == id);
        found.map(|(sample, reach_m)| (*sample, *reach_m))
    }

    /// What hands have missed since this was asked last: each hold once.
    pub fn take_missed(&mut self) -> impl Iterator<Item = Event> + '_ {
        self.missed.drain(..)
    }

    fn sample(&self, id: u8) -> Option<ToolSample> {
        self.hand(id).map(|(sample, _)| sample)
    }
}

/// A tool at rest there.
pub fn at_rest(id: u8, pose: &Pose) -> ToolSample {
    ToolSample {
        id,
        position_m: pose.position_m,
        orientation: pose.orientation,
        velocity_m_per_s: [0.0; 3],
        console_time_us: 0,
    }
}

/// The pose moved out along the nearest vertex's normal until the shape is clear of the tissue.
pub(crate) fn outside(surface: &Surface, points: &[[f64; 3]], shape: &Tool, pose: &Pose) -> Pose {
    let Some(placement) = shape.place(&at_rest(0, pose)) else {
        return *pose;
    };
    let solid = Solid::new(shape, surface.mean_edge_m, &placement);
    let gap = |solid: &Solid, node: u32| solid.gap(&points[node as usize].into());
    let nearest = surface
        .vertices
        .iter()
        .zip(&surface.normals)
        .min_by(|a, b| gap(&solid, *a.0).total_cmp(&gap(&solid, *b.0)));
    let Some((_, normal)) = nearest else {
        return *pose;
    };
    let stride = Vector3::from(*normal) * solid.radius();
    let clear = |solid: &Solid| {
        surface.vertices.iter().all(|node| gap(solid, *node) > 0.0)
            && !surface.contains(points, solid.middle().into())
    };
    let out = (0..1000)
        .map(|strides| stride * f64::from(strides))
        .find(|out| clear(&solid.moved(out)))
        .unwrap_or_default();
    Pose {
        position_m: (Vector3::from(pose.position_m) + out).into(),
        ..*pose
    }
}

/// How far a tool in a pose is from the vertex nearest to it of tissue at rest \[m\], and the tool's normal there, into the
/// tissue's outside; `points` (n x 3) are the nodes \[m\]. None if it is no pose, or has no normal there.
pub fn gap_at_rest(
    surface: &Surface,
    points: &[[f64; 3]],
    tool: &Tool,
    pose: &Pose,
) -> Option<(f64, Vector3<f64>)> {
    let placement = tool.place(&at_rest(0, pose))?;
    let solid = Solid::new(tool, surface.mean_edge_m, &placement);
    let at = |node: u32| Vector3::from(points[node as usize]);
    let vertices = surface.vertices.iter();
    let gaps = vertices.map(|node| (solid.gap(&at(*node)), *node));
    let (gap, node) = gaps.min_by(|a, b| a.0.total_cmp(&b.0))?;
    Some((gap, -solid.touch(&at(node))?.normal))
}

/// A sample's or a script's own: of unit length.
fn quaternion([x, y, z, w]: [f64; 4]) -> UnitQuaternion<f64> {
    UnitQuaternion::new_unchecked(Quaternion::new(w, x, y, z))
}

fn isometry(sample: &ToolSample) -> Isometry3<f64> {
    Isometry3::from_parts(
        Translation3::from(sample.position_m),
        quaternion(sample.orientation),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::needle::NeedleWeight;
    use crate::scene::{Document, Hold};
    use crate::step::{Status, StepOptions, Workspace, step};

    /// A slab, a driven grip that turns, a second hand that takes the needle from it in the open, on its way, and
    /// lets it go.
    pub(super) const SCENE: &str = r#"
device = "cartesian-bench"
seconds = 4.0

[mesh.slab]
size_m = [0.02, 0.02, 0.01]
divisions = [2, 2, 1]

[tissue]
youngs_modulus_pa = 20e3
poisson_ratio = 0.45
needle = { friction_n_per_m = 10.0, puncture_pa = 1e5 }

[[fixed]]
plane = { axis = "z", at_m = -0.01 }

[[tool]]
id = 4
shape = "grip"
reach_m = 0.011
[[tool.way_point]]
time_s = 0.0
[[tool.way_point]]
time_s = 2.0
rotation_deg = [0.0, 90.0, 0.0]

[[tool]]
id = 6
shape = "grip"
reach_m = 0.1
[[tool.way_point]]
time_s = 1.0
position_m = [0.0, 0.0, 0.1]
[[tool.way_point]]
time_s = 3.0
position_m = [0.0, 0.05, 0.1]

[[needle]]
id = 1
shape = "straight"
length_m = 0.02
thickness_m = 0.001
end_m = [0.01, 0.0, 0.06]
direction = [0.0, 0.0, -1.0]
[[needle.hold]]
time_s = 0.0
tool = 4
[[needle.hold]]
time_s = 2.0
tool = 6
[[needle.hold]]
time_s = 3.5

[hand]
stiffness_n_per_m = 1000.0
damping_n_s_per_m = 10.0
way_point = [{ time_s = 0.0, position_m = [0.0, 0.0, 0.06] }]
"#;

    fn scene() -> Scene {
        let document = Document::embedded("test.toml", "".as_ref(), SCENE);
        Scene::read(&document, "test").expect("good")
    }

    /// Where the second hand's script has it along y \[m\].
    fn hand_y(scene: &Scene, time_s: f64) -> f64 {
        let way = scene.tools[1].way.as_ref().expect("it moves");
        way.at(time_s).moved.expect("it moves").0[1]
    }

    fn near(a: [f64; 3], b: [f64; 3]) {
        let apart = (Vector3::from(a) - Vector3::from(b)).norm();
        assert!(apart < 1e-9, "{a:?} is not {b:?}");
    }

    /// Held at its end, 10 mm beside the grip: a quarter turn brings that from +x to -z, and the tip with it.
    #[test]
    fn a_needle_follows_the_grip_that_holds_it() {
        let scene = scene();
        let (model, mut state, mut work) = scene.build().expect("held");
        let mut script = Script::new(&scene);
        assert_eq!(script.driven(), Some(4));
        let mut go = |time_s: f64, state: &mut State, work: &mut Workspace| {
            let tools = script.follow(time_s, &model, state);
            let report = step(&model, state, tools, &StepOptions::default(), work);
            assert_eq!(report.status, Status::Ok, "at {time_s} s");
            let held_by = report.needles()[0].held_by;
            let pose = state.needle_pose(&model, 1).expect("it exists");
            let curve = scene.needles[0].needle.at(&pose);
            (held_by, curve.at(0.0).into(), curve.at(curve.length).into())
        };
        let (held_by, end, tip) = go(0.0, &mut state, &mut work);
        assert_eq!(held_by, Some(4));
        near(end, [0.01, 0.0, 0.06]);
        near(tip, [0.01, 0.0, 0.04]);
        for place in 1..19 {
            go(0.1 * f64::from(place), &mut state, &mut work);
        }
        let (_, before, _) = go(1.9, &mut state, &mut work);
        let (held_by, end, tip) = go(2.0, &mut state, &mut work);
        // The other hand takes it where the step before left it, and has taken it along since then.
        assert_eq!(held_by, Some(6));
        let hand = |time_s: f64| hand_y(&scene, time_s);
        assert!(hand(2.0) - hand(1.9) > 4e-3);
        near(
            end,
            [before[0], before[1] + hand(2.0) - hand(1.9), before[2]],
        );
        let turned = (Vector3::from(tip) - Vector3::from(end)).normalize();
        assert!(turned.x < -0.99, "down has become -x: {turned}");
        for place in 21..=30 {
            go(0.1 * f64::from(place), &mut state, &mut work);
        }
        let (_, moved, _) = go(3.0, &mut state, &mut work);
        near(moved, [end[0], end[1] + hand(3.0) - hand(2.0), end[2]]);
        let (held_by, left, _) = go(3.5, &mut state, &mut work);
        assert_eq!(held_by, None);
        near(left, moved);
    }

    /// What the console senses comes before the script's own turn.
    #[test]
    fn a_wrist_turns_what_the_console_senses() {
        let scene = scene();
        let (model, mut state, _) = scene.build().expect("held");
        let mut script = Script::new(&scene);
        let about = |axis: Vector3<f64>| {
            UnitQuaternion::from_scaled_axis(axis * std::f64::consts::FRAC_PI_2)
        };
        let sensed = about(Vector3::x());
        let console = ToolSample {
            orientation: sensed.coords.into(),
            ..script.samples()[0]
        };
        let tools = script.step_to(2.0, console, Some((&model, &mut state)));
        let expected = about(Vector3::y()) * sensed;
        let found = quaternion(tools[0].orientation);
        assert!(found.angle_to(&expected) < 1e-12);
        assert_eq!(tools[1].id, 6);
        near(tools[1].position_m, [0.0, 0.025, 0.1]);
    }

    /// A needle with a weight that is let go may come to lie below, on what faces it, as far aside as it is long.
    #[test]
    fn a_path_tells_where_needles_land() {
        let mut scene = scene();
        let falls = |scene: &Scene| path(scene, 4.0, 0.1, 1.0).falls;
        scene.needles[0].holds = vec![
            Hold {
                time_s: 0.0,
                tool: Some(scene.tools[0].id),
            },
            Hold {
                time_s: 0.1,
                tool: None,
            },
        ];
        assert_eq!(falls(&scene), []);
        scene.needles[0].weight = Some(NeedleWeight {
            density_kg_per_m3: 7900.0,
            gravity_m_per_s2: [0.0, 0.0, -9.81],
        });
        let [fall] = falls(&scene)[..] else {
            panic!("one");
        };
        let up = Vector3::z();
        let lands = |x: f64, z: f64, normal: Vector3<f64>| {
            fall.lands_on(&Vector3::new(0.01 + x, 0.0, z), &normal)
        };
        assert!(lands(0.0, 0.0, up) && lands(0.015, -1.0, up));
        // Too far aside, above, and a face that looks away.
        assert!(!lands(0.025, 0.0, up) && !lands(0.0, 0.08, up) && !lands(0.0, 0.0, -up));
    }

    /// Without tissue a path goes where the steps go: through the same poses of the needle.
    #[test]
    fn a_path_has_the_places_of_grips_and_needles() {
        let path = path(&scene(), 4.0, 0.02, 0.011);
        assert_eq!(path.grips.len(), 201);
        // Two pieces of 10 mm: three points a time.
        assert_eq!(path.needles.len(), 201 * 3);
        // A needle is taken where it was a place before, nearly at rest.
        let near = |found: Vector3<f64>, x: [f64; 3]| {
            assert!(
                (found - Vector3::from(x)).norm() < 1e-6,
                "{found} is not {x:?}"
            );
        };
        near(path.needles[0], [0.01, 0.0, 0.06]);
        near(path.needles[2], [0.01, 0.0, 0.04]);
        // At 2 s turned by 90 degrees and taken by the second hand, which goes on.
        let went = |until_s: f64| hand_y(&scene(), until_s) - hand_y(&scene(), 1.98);
        near(path.needles[3 * 100], [0.0, went(2.0), 0.05]);
        near(path.needles[3 * 100 + 2], [-0.02, went(2.0), 0.05]);
        near(path.needles[3 * 200], [0.0, went(4.0), 0.05]);
    }
}
