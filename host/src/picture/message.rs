//! A picture as plain values, and its bytes.
//!
//! Entry point: [`Picture::encode`].

use super::bytes::{Message, as_i16, as_u16, not_below};
use super::painter::Scalar;

/// What a picture shows; all of it in the world frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Picture {
    /// Counts pictures, from 1.
    pub sequence: u32,
    /// Whether it is of a recording.
    pub recorded: bool,
    /// Whether nothing was sent for the newest step.
    pub withheld: bool,
    /// Session time \[s\].
    pub time_s: f64,
    /// Console time \[us\].
    pub console_time_us: u64,
    /// Solves before it.
    pub solves: u32,
    /// Number of its geometry.
    pub geometry: u32,
    /// Displacement of each vertex from its unloaded position \[m\], (v x 3).
    pub displacement_m: Vec<[f64; 3]>,
    /// A value at each vertex, (v), if anybody wants one.
    pub scalar: Option<(Scalar, Vec<f64>)>,
    /// Tools, the driven one first.
    pub tools: Vec<ToolView>,
    /// Needles, in the scene's order.
    pub needles: Vec<NeedleView>,
    /// Threads that have a path.
    pub threads: Vec<ThreadView>,
    /// Vertices that are pushed and the force on the tissue there \[N\].
    pub contacts: Vec<(u32, [f64; 3])>,
    /// How the solver does.
    pub status: StatusView,
}

/// A tool.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ToolView {
    /// Which.
    pub id: u8,
    /// Whether the console drives it.
    pub driven: bool,
    /// Where its shape's own point is \[m\], (3).
    pub position_m: [f64; 3],
    /// How it is turned: x, y, z, w.
    pub orientation: [f64; 4],
    /// Force \[N\] and moment about the grip \[N m\] on it, (6).
    pub wrench: [f64; 6],
    /// Distance to the tissue \[m\].
    pub gap_m: f64,
    /// Vertices that it touches.
    pub rows: u32,
}

/// A needle.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct NeedleView {
    /// Which.
    pub id: u8,
    /// 0 outside, 1 holding a boundary, 2 inside, 3 waiting.
    pub tip: u8,
    /// The tool that holds it.
    pub held_by: Option<u8>,
    /// Its end \[m\], (3).
    pub position_m: [f64; 3],
    /// How its frame is turned: x, y, z, w.
    pub orientation: [f64; 4],
    /// Faces that it goes through.
    pub crossings: u32,
    /// Boundaries that it has broken through.
    pub punctures: u32,
    /// Axial force \[N\].
    pub axial_n: f64,
    /// Force of its tip on the boundary that holds it \[N\].
    pub hold_n: f64,
    /// The force that breaks through \[N\].
    pub puncture_n: f64,
}

/// A thread.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ThreadView {
    /// Which.
    pub id: u8,
    /// 0 slack, 1 taut.
    pub state: u8,
    /// From tail to head.
    pub points: Vec<ThreadPointView>,
}

/// A point of a thread.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ThreadPointView {
    /// Where it is \[m\], (3).
    pub at_m: [f64; 3],
    /// 0 end, 1 inside, 2 enters, 3 leaves, 4 wraps, 5 hangs, 6 the loose end of a piece.
    pub what: u8,
    /// Tension up to the next \[N\].
    pub tension_n: f64,
}

/// How the solver does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StatusView {
    /// Place of the word among [`super::statuses`].
    pub word: u8,
    /// Whether the driven tool touches.
    pub touches: bool,
    /// Touched vertices.
    pub rows: u32,
    /// Pairs of touching tissue.
    pub touching: u32,
    /// Iterations of the newest step.
    pub iterations: u32,
    /// What is left of the equations.
    pub residual: f64,
    /// Energy that tools have put in \[J\].
    pub energy_j: f64,
    /// Largest tension at an end of a thread \[N\].
    pub tension_n: Option<f64>,
    /// Longest span between two parts over its unloaded length.
    pub bridge_ratio: Option<f64>,
    /// The grip \[m\], (3).
    pub grip_m: [f64; 3],
}

impl Default for StatusView {
    fn default() -> Self {
        Self {
            word: 0,
            touches: false,
            rows: 0,
            touching: 0,
            iterations: 0,
            residual: 0.0,
            energy_j: 0.0,
            tension_n: None,
            bridge_ratio: None,
            grip_m: [0.0; 3],
        }
    }
}

impl Picture {
    /// Writes the message.
    pub fn encode(&self, out: &mut Vec<u8>) {
        let lengths = self.displacement_m.iter().flatten().map(|x| x.abs());
        let scale = not_below(lengths.fold(0.0, f64::max));
        let range = self
            .scalar
            .as_ref()
            .map_or([0.0; 2], |(_, values)| ends(values));
        let flags = u16::from(self.recorded) + 2 * u16::from(self.withheld);
        let mut message = Message::begin(out, 2, flags, |header| {
            header.u32(self.sequence);
            header.f64(self.time_s);
            header.u64(self.console_time_us);
            header.u32(self.solves);
            header.u32(self.geometry);
            header.u32(self.displacement_m.len() as u32);
            header.f32(scale);
            header.f32(range[0]);
            header.f32(range[1]);
            header.u8(self
                .scalar
                .as_ref()
                .map_or(0, |(scalar, _)| scalar.number()));
            header.u8(0);
        });
        message.section(1, |to| {
            let all = self.displacement_m.iter().flatten();
            all.for_each(|value| to.i16(as_i16(*value, scale)));
        });
        if let Some((_, values)) = &self.scalar {
            message.section(2, |to| {
                values
                    .iter()
                    .for_each(|value| to.u16(as_u16(*value, range)))
            });
        }
        self.encode_tools(&mut message);
        self.encode_needles(&mut message);
        for thread in &self.threads {
            thread.encode(&mut message);
        }
        message.section(6, |to| {
            for (vertex, force_n) in &self.contacts {
                to.u32(*vertex);
                to.f32s(*force_n);
            }
        });
        self.status.encode(&mut message);
    }

    fn encode_tools(&self, message: &mut Message<'_>) {
        message.section(3, |to| {
            for tool in &self.tools {
                to.u8(tool.id);
                to.u8(u8::from(tool.driven));
                to.u16(0);
                to.f32s(tool.position_m);
                to.f32s(tool.orientation);
                to.f32s(tool.wrench);
                to.f32(as_gap(tool.gap_m));
                to.u32(tool.rows);
            }
        });
    }

    fn encode_needles(&self, message: &mut Message<'_>) {
        message.section(4, |to| {
            for needle in &self.needles {
                to.u8(needle.id);
                to.u8(needle.tip);
                to.u8(needle.held_by.unwrap_or(u8::MAX));
                to.u8(0);
                to.f32s(needle.position_m);
                to.f32s(needle.orientation);
                to.u32(needle.crossings);
                to.u32(needle.punctures);
                to.f32s([needle.axial_n, needle.hold_n, needle.puncture_n]);
                to.u32(0);
            }
        });
    }
}

impl ThreadView {
    fn encode(&self, message: &mut Message<'_>) {
        let origin_m = self.points.first().map_or([0.0; 3], |point| point.at_m);
        let origin = origin_m.map(|x| x as f32);
        let from = origin.map(f64::from);
        let way =
            |point: &ThreadPointView| [0, 1, 2].map(|axis: usize| point.at_m[axis] - from[axis]);
        let lengths = self.points.iter().flat_map(way).map(f64::abs);
        let scale = not_below(lengths.fold(0.0, f64::max));
        message.section(5, |to| {
            to.u8(self.id);
            to.u8(self.state);
            to.u16(0);
            to.u32(self.points.len() as u32);
            origin.into_iter().for_each(|x| to.f32(x));
            to.f32(scale);
            for point in &self.points {
                way(point)
                    .into_iter()
                    .for_each(|x| to.i16(as_i16(x, scale)));
                to.u8(point.what);
                to.u8(0);
                to.f32(point.tension_n as f32);
            }
        });
    }
}

impl StatusView {
    fn encode(&self, message: &mut Message<'_>) {
        message.section(7, |to| {
            to.u8(self.word);
            to.u8(u8::from(self.touches));
            to.u16(0);
            to.u32(self.rows);
            to.u32(self.touching);
            to.u32(self.iterations);
            to.f32s([
                self.residual,
                self.energy_j,
                self.tension_n.unwrap_or(f64::NAN),
                self.bridge_ratio.unwrap_or(f64::NAN),
            ]);
            to.f32s(self.grip_m);
            to.u32(0);
        });
    }
}

/// A distance; infinite where nothing is near.
pub(super) fn as_gap(gap_m: f64) -> f32 {
    if gap_m < 1e3 {
        gap_m as f32
    } else {
        f32::INFINITY
    }
}

/// Least and largest of what is a number.
fn ends(values: &[f64]) -> [f32; 2] {
    let numbers = || values.iter().copied().filter(|value| value.is_finite());
    let (low, high) = (numbers().reduce(f64::min), numbers().reduce(f64::max));
    [
        -not_below(-low.unwrap_or_default()),
        not_below(high.unwrap_or_default()),
    ]
}
