//! Needles, threads and tools in the words of Foxglove's `SceneUpdate`, so that programs which know it show a recording.
//!
//! Entry points: [`Sketch`], a copy of the solver's state for the recorder's thread, and [`SceneSample::of`], what that writes of it.

use super::samples::{Turn, Xyz};
use crate::output::{Beside, Line, Part};
use crate::scene::Scene;
use crate::session::{SceneSolver, Snapshot};
use crate::thread::{Beats, Hanging};
use schemars::JsonSchema;
use serde::Serialize;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};

/// Thickness of lines that have none of their own \[m\].
const THIN_M: f64 = 2.5e-4;
const FRAME: &str = "world";

/// Copies a solver's state now and then; the copies come back to be written again.
#[derive(Debug)]
pub(super) struct Sketching {
    beside: Arc<Beside>,
    /// Which of them are sketched: at the beats of threads that hang.
    beats: Beats,
    threads: Arc<Mutex<Threads>>,
    made: u64,
    free: Receiver<Box<Snapshot>>,
    back: Sender<Box<Snapshot>>,
}

/// The threads of a scene that has some, for the recorder's thread alone.
#[derive(Debug)]
struct Threads {
    hanging: Option<Hanging>,
    /// Number of the sketch that they are at.
    at: u64,
}

/// A copy, and what is drawn of it.
#[derive(Debug)]
pub(super) struct Sketch {
    beside: Arc<Beside>,
    threads: Arc<Mutex<Threads>>,
    /// Counts them, from 1.
    number: u64,
    snapshot: Box<Snapshot>,
    back: Sender<Box<Snapshot>>,
}

impl Sketching {
    /// Of a scene with needles; there is nothing to sketch of others that samples of the grip do not say.
    pub fn new(scene: &Scene, solver: &SceneSolver) -> Option<Self> {
        let beside = Beside::of(scene);
        if !beside.has_needles() {
            return None;
        }
        let (back, free) = channel();
        // The one that all sketches but late ones are made of.
        let _ = back.send(Box::new(Snapshot::of(solver)));
        Some(Self {
            beside: Arc::new(beside),
            beats: Beats::default(),
            threads: Arc::new(Mutex::new(Threads {
                hanging: solver.model().and_then(|model| Hanging::new(model)),
                at: 0,
            })),
            made: 0,
            free,
            back,
        })
    }

    /// After a solve for a state of this console time \[us\]: a sketch, if it is time.
    pub fn solved(&mut self, solver: &SceneSolver, now_us: u64) -> Option<Sketch> {
        if !self.beats.is_due(now_us) {
            return None;
        }
        self.made += 1;
        let free = self.free.try_recv().ok();
        let mut snapshot = free.unwrap_or_else(|| Box::new(Snapshot::of(solver)));
        solver.snapshot(&mut snapshot);
        Some(Sketch {
            beside: self.beside.clone(),
            threads: self.threads.clone(),
            number: self.made,
            snapshot,
            back: self.back.clone(),
        })
    }
}

impl Sketch {
    /// What is written of it, at a time \[ns\]. Solves for the nodes: not for the loop.
    pub fn sample(self, time_ns: u64) -> SceneSample {
        let Self {
            beside,
            threads,
            number,
            snapshot,
            back,
        } = self;
        let nodes_m = snapshot.positions_m();
        let mut threads = threads.lock().unwrap_or_else(PoisonError::into_inner);
        // One that found no room in the queue is missing.
        let is_next = threads.at + 1 == number;
        threads.at = number;
        let free = threads.hanging.as_mut().and_then(|hanging| {
            if !is_next {
                hanging.begin();
            }
            snapshot.beat(hanging, &nodes_m);
            snapshot.threads(hanging, &nodes_m)
        });
        let samples = snapshot.samples();
        let lines = beside.lines(&nodes_m, snapshot.constrained(), free, samples);
        // The solver may be gone.
        let _ = back.send(snapshot);
        SceneSample::of(&lines, time_ns)
    }
}

/// What is beside the tissue at an instant; each entity takes the place of the one before that has its id.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct SceneSample {
    deletions: [(); 0],
    /// Needles, threads and tools.
    entities: Vec<Entity>,
}

/// A needle, a thread or a tool.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
struct Entity {
    timestamp: Time,
    frame_id: &'static str,
    id: String,
    /// Until another one comes.
    lifetime: Time,
    frame_locked: bool,
    metadata: [(); 0],
    arrows: [(); 0],
    cubes: [(); 0],
    spheres: [(); 0],
    cylinders: [(); 0],
    lines: Vec<Strip>,
    triangles: [(); 0],
    texts: [(); 0],
    models: [(); 0],
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, JsonSchema)]
struct Time {
    sec: u64,
    nsec: u64,
}

/// A line through points.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
struct Strip {
    r#type: u8,
    pose: Pose,
    /// \[m\].
    thickness: f64,
    scale_invariant: bool,
    /// \[m\], world frame.
    points: Vec<Xyz>,
    color: Colour,
    colors: [(); 0],
    indices: [(); 0],
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, JsonSchema)]
struct Pose {
    position: Xyz,
    orientation: Turn,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, JsonSchema)]
struct Colour {
    r: f64,
    g: f64,
    b: f64,
    a: f64,
}

impl SceneSample {
    /// Of lines at a time \[ns\]; those of one thing follow each other.
    fn of(lines: &[Line], time_ns: u64) -> Self {
        let timestamp = Time {
            sec: time_ns / 1_000_000_000,
            nsec: time_ns % 1_000_000_000,
        };
        let things = lines.chunk_by(|one, next| (one.part, one.id) == (next.part, next.id));
        let entities = things.filter_map(|lines| {
            let first = lines.first()?;
            let word = match first.part {
                Part::Needle => "needle",
                Part::Thread => "thread",
                Part::Tool => "tool",
            };
            Some(Entity {
                timestamp,
                frame_id: FRAME,
                id: format!("{word} {}", first.id),
                lifetime: Time::default(),
                frame_locked: false,
                metadata: [],
                arrows: [],
                cubes: [],
                spheres: [],
                cylinders: [],
                lines: lines.iter().map(strip).collect(),
                triangles: [],
                texts: [],
                models: [],
            })
        });
        Self {
            deletions: [],
            entities: entities.collect(),
        }
    }
}

fn strip(line: &Line) -> Strip {
    let [r, g, b] = match line.part {
        Part::Needle => [0.85, 0.87, 0.90],
        Part::Thread => [0.20, 0.45, 0.85],
        Part::Tool => [0.70, 0.74, 0.80],
    };
    let points = line.points_m.iter().map(|at| {
        let [x, y, z] = at.map(|x| x as f32);
        Xyz { x, y, z }
    });
    Strip {
        r#type: 0,
        pose: Pose {
            position: Xyz {
                x: 0.0,
                y: 0.0,
                z: 0.0,
            },
            orientation: Turn {
                x: 0.0,
                y: 0.0,
                z: 0.0,
                w: 1.0,
            },
        },
        thickness: THIN_M.max(2.0 * line.radius_m),
        scale_invariant: false,
        points: points.collect(),
        color: Colour { r, g, b, a: 1.0 },
        colors: [],
        indices: [],
    }
}
