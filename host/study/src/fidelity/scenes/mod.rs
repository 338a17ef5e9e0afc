//! What the tools touch in the measurements: one file per scene, all behind [`Truth`].

pub mod needle;
pub mod palpation;
pub mod point;
pub mod rogue;
pub mod round;
pub mod slab;
pub mod thread;
pub mod turned;

use sutura_host::step::ToolRows;
use sutura_shared::wire::message::{Needle, Thread};

/// Where a tool is when a scene is solved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Since the start \[s\]; never goes back.
    pub time_s: f64,
    /// Grip \[m\], (3), world frame.
    pub position_m: [f64; 3],
    /// Unit quaternion (x, y, z, w).
    pub orientation: [f64; 4],
    /// \[m/s\], (3).
    pub velocity_m_per_s: [f64; 3],
    /// From here to the middle of the time in which the solution will be used \[s\].
    pub lead_s: f64,
    /// Whether a host has time for what it does besides its step.
    pub has_time: bool,
}

/// What a host sends of a solved scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Solution {
    /// Where the grip is in the solution \[m\], (3); none for where it was sampled.
    pub position_m: Option<[f32; 3]>,
    /// Wrench on the tool: force \[N\], then moment about the grip \[N m\], (6), world frame.
    pub wrench: [f64; 6],
    /// d wrench / d pose, (6 x 6) by rows.
    pub tangent: [[f64; 6]; 6],
    /// Way against `normal` until the tool touches \[m\]; 0 in contact.
    pub gap_m: f64,
    /// Out of the tissue, (3).
    pub normal: [f64; 3],
    /// Contact rows, where the scene has them.
    pub rows: Option<Box<ToolRows>>,
    /// State of a needle in the grip.
    pub needle: Option<Needle>,
    /// State of a thread in the grip.
    pub thread: Option<Thread>,
    /// Boundaries that a needle has punctured so far.
    pub punctures: u32,
}

impl Solution {
    /// Nothing touches yet, in the direction of -z; a gap below 0 is none.
    pub fn nothing(gap_m: f64) -> Self {
        Solution {
            position_m: None,
            wrench: [0.0; 6],
            tangent: [[0.0; 6]; 6],
            gap_m: gap_m.max(0.0),
            normal: [0.0, 0.0, 1.0],
            rows: None,
            needle: None,
            thread: None,
            punctures: 0,
        }
    }
}

/// A scene that can be solved along a path. The host has one, the truth another one of the same kind.
pub trait Truth {
    /// Goes on to `sample` and solves there; `None` where the solver has nothing to say yet.
    fn solve(&mut self, sample: &Sample) -> Option<Solution>;
}

/// Makes a scene at its start: one for the host, one for the truth.
pub trait Scene: Sync {
    /// As tables print it.
    fn name(&self) -> &'static str;

    /// Where the grip is when the tool touches \[m\], (3).
    fn origin_m(&self) -> [f64; 3];

    /// Where the grip is for a point of a [`Motion`](super::hand::Motion)'s way \[m\], (3), world frame: a rigid
    /// map, for the hand's velocity as well.
    fn place(&self, way_m: [f64; 3]) -> [f64; 3] {
        let origin_m = self.origin_m();
        [0, 1, 2].map(|axis: usize| origin_m[axis] + way_m[axis])
    }

    /// The scene, untouched, that gives so many contact rows at most, for use over so long a time \[s\], by solves that are
    /// planned every `period_s`.
    fn start(&self, most_rows: usize, ahead_s: f64, period_s: f64) -> Box<dyn Truth>;

    /// The same for a host that has computed nothing beforehand; where nothing can be, it is the same.
    fn start_cold(&self, most_rows: usize, ahead_s: f64, period_s: f64) -> Box<dyn Truth> {
        self.start(most_rows, ahead_s, period_s)
    }
}
