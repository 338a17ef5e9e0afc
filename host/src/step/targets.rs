//! Where a step has needles, the ends of threads and tools go, and the way there.
//!
//! Entry points: [`Targets::read`], [`Targets::share`], [`Targets::part_way`].

use super::balance::Balance;
use super::sources::{Sources, SourcesState};
use crate::jaws::{Jaws, JawsState};
use crate::needle::{MAX_NEEDLES, NeedlePart, NeedleState, Tip};
use crate::rod::{Bar, BarState};
use crate::source::tool::Placements;
use crate::thread::{MAX_STRANDS, Obstacle, ThreadHold};
use crate::tool::{MAX_TOOLS, ToolSample};
use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion, Vector3};

/// Largest turn of a piece of the way \[rad\]: the tip's path is taken as straight within one.
const MOST_TURN: f64 = 0.1;

/// Pieces of a mean edge: as far a body goes at once that is two edges from the surface.
pub(super) const EDGE_PIECES: f64 = 4.0;

/// Where everything goes that somebody holds; what nobody holds is where the tissue took it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Targets {
    /// The needles' frames.
    pub needles: [Isometry3<f64>; MAX_NEEDLES],
    /// Both ends of strands \[m\].
    pub threads: [[Vector3<f64>; 2]; MAX_STRANDS],
    /// By their places among those that touch.
    pub tools: Placements,
    /// Grips that carry jaws; nothing for one that has not been anywhere.
    pub jaws: [Option<Isometry3<f64>>; MAX_TOOLS],
    /// Grips that carry bars; likewise.
    pub bars: [Option<Isometry3<f64>>; MAX_TOOLS],
    /// From where needles fall that nobody holds and that have a weight.
    falls_from: [Option<Isometry3<f64>>; MAX_NEEDLES],
    /// For as long they fall \[s\], and how much of the way is done.
    fall_s: f64,
    done: f64,
}

impl Targets {
    /// Nothing goes anywhere.
    pub fn none() -> Self {
        Self {
            needles: [Isometry3::identity(); MAX_NEEDLES],
            threads: [[Vector3::zeros(); 2]; MAX_STRANDS],
            tools: [None; MAX_TOOLS],
            jaws: [None; MAX_TOOLS],
            bars: [None; MAX_TOOLS],
            falls_from: [None; MAX_NEEDLES],
            fall_s: 0.0,
            done: 0.0,
        }
    }

    /// Where `samples` take what the tools hold, and the tools themselves, of which all are at `placements`; what nobody holds
    /// falls for `fall_s`.
    pub fn read(
        sources: &Sources,
        state: &SourcesState,
        samples: &[ToolSample],
        placements: &Placements,
        fall_s: f64,
    ) -> Self {
        let of = |tool: u8| samples.iter().find(|sample| sample.id == tool);
        let mut targets = Self {
            tools: sources.tools.targets(placements),
            fall_s,
            ..Self::none()
        };
        for (index, (each, part)) in state.each.iter().zip(&sources.needles).enumerate() {
            let held = each
                .grip
                .and_then(|grip| Some(pose_of(of(grip.tool)?)? * grip.needle));
            let is_near = each.is_near || state.passes(Obstacle::Needle(index));
            let falls_to = each.fall(part, fall_s, (sources.piece_m, is_near));
            targets.falls_from[index] = falls_to.map(|_| each.pose);
            targets.needles[index] = held.or(falls_to).unwrap_or(each.pose);
        }
        for (ends, thread) in targets.threads.iter_mut().zip(&state.threads) {
            *ends = [thread.tail, thread.head].map(|hold| match hold.by {
                ThreadHold::Tool(tool) => of(tool)
                    .and_then(pose_of)
                    .map_or(hold.at, |pose| (pose * Point3::from(hold.on_tool)).coords),
                _ => hold.at,
            });
        }
        let jaws = state.jaws.iter().zip(&sources.jaws);
        for (target, (each, part)) in targets.jaws.iter_mut().zip(jaws) {
            *target = of(part.tool).and_then(pose_of).or(each.pose);
        }
        let bars = state.bars.iter().zip(&sources.bars);
        for (target, (each, part)) in targets.bars.iter_mut().zip(bars) {
            *target = of(part.tool).and_then(pose_of).or(each.pose);
        }
        targets
    }

    /// As these are now, with needles that fall on their threads.
    pub fn on_leashes(mut self, balance: &Balance) -> Self {
        for needle in 0..balance.state.each.len() {
            if self.falls_from[needle].is_some() {
                self.needles[needle] = balance.on_leash(needle, &self.needles[needle]);
            }
        }
        self
    }

    /// As these are now, `done` of the way: what nobody holds is where the tissue took it, unless it falls.
    pub fn with_free(mut self, state: &SourcesState, done: f64) -> Self {
        self.done = done;
        let each = state.each.iter().zip(&self.falls_from);
        for (target, (each, falls_from)) in self.needles.iter_mut().zip(each) {
            if each.grip.is_none() && falls_from.is_none() {
                *target = each.pose;
            }
        }
        self
    }

    /// Which share of the way can be followed at once, at most 1; not finite for a way that is not.
    pub fn share(&self, sources: &Sources, state: &SourcesState) -> f64 {
        let mut share = 1.0f64;
        let needles = state.each.iter().zip(&self.needles).zip(&sources.needles);
        for (index, ((each, target), own)) in needles.enumerate() {
            if self.falls_from[index].is_some() {
                // Of all its way, whatever bore it on the one that is done.
                let far = (1.0 - self.done) * each.falls_by(own, target, self.fall_s);
                let nears = each.is_near || state.passes(Obstacle::Needle(index));
                let piece_m = match own.body && nears {
                    true => own.body_piece_m(),
                    false => sources.piece_m * EDGE_PIECES,
                };
                share = share.min(if far > piece_m { piece_m / far } else { 1.0 });
                continue;
            }
            let passes = state.passes(Obstacle::Needle(index));
            share = share.min(needle_share(sources.piece_m, (each, passes), target, own));
        }
        for (thread, target) in state.threads.iter().zip(&self.threads) {
            let way = [target[0] - thread.tail.at, target[1] - thread.head.at];
            let far = way[0].norm().max(way[1].norm());
            if !thread.segments.is_empty() && far > 0.0 {
                share = share.min(sources.piece_m / far);
            }
        }
        let jaws = state.jaws.iter().zip(&self.jaws).zip(&sources.jaws);
        for ((each, target), part) in jaws {
            share = share.min(jaws_share(sources.piece_m, each, target, &part.jaws));
        }
        let bars = state.bars.iter().zip(&self.bars).zip(&sources.bars);
        for (index, ((each, target), part)) in bars.enumerate() {
            let nears = each.is_near || state.passes(Obstacle::Bar(index));
            share = share.min(bar_share(sources, (each, nears), target, &part.bar));
        }
        share.min(state.tools.part(&sources.tools, &self.tools))
    }

    /// Where everything is after a share of the way from `state`; all of it leads exactly here.
    pub fn part_way(&self, state: &SourcesState, share: f64) -> Self {
        let mut next = *self;
        let falls = self.falls_from.iter();
        for (pose, (each, falls_from)) in next.needles.iter_mut().zip(state.each.iter().zip(falls))
        {
            *pose = match falls_from {
                Some(from) => towards(from, pose, self.done + share * (1.0 - self.done)),
                None => towards(&each.pose, pose, share),
            };
        }
        for (ends, thread) in next.threads.iter_mut().zip(&state.threads) {
            for (end, from) in ends.iter_mut().zip([thread.tail.at, thread.head.at]) {
                if share < 1.0 {
                    *end = from + (*end - from) * share;
                }
            }
        }
        let jaws = next
            .jaws
            .iter_mut()
            .zip(state.jaws.iter().map(|each| each.pose));
        let bars = next
            .bars
            .iter_mut()
            .zip(state.bars.iter().map(|each| each.pose));
        for (pose, before) in jaws.chain(bars) {
            if let (Some(from), Some(to)) = (before, *pose) {
                *pose = Some(towards(&from, &to, share));
            }
        }
        next.tools = state.tools.towards(&self.tools, share);
        next
    }
}

/// Which share of its way a needle may go at once, which `passes` a thread that may lie on it, or a body, or not.
fn needle_share(
    piece_m: f64,
    (each, passes): (&NeedleState, bool),
    target: &Isometry3<f64>,
    own: &NeedlePart,
) -> f64 {
    let (from, to) = (own.needle.at(&each.pose), own.needle.at(target));
    let touches = !each.holds.is_empty() || !matches!(each.tip, Tip::Outside | Tip::Waiting);
    let turn = (target.rotation * each.pose.rotation.inverse()).angle();
    let mut share = MOST_TURN / turn;
    let nears = own.body && each.is_near;
    let piece_m = match (nears, touches || passes) {
        (true, _) => piece_m.min(own.body_piece_m()),
        (false, true) => piece_m,
        // It is looked for farther than this.
        (false, false) => piece_m * EDGE_PIECES,
    };
    if touches || own.body {
        let way = [0.0, 0.5, 1.0]
            .map(|along| (to.at(along * to.length) - from.at(along * from.length)).norm());
        share = share.min(piece_m / way.into_iter().fold(0.0, f64::max));
    }
    // A way without end is none.
    if share.is_nan() {
        f64::NAN
    } else {
        share.min(1.0)
    }
}

/// Which share of their way jaws may go at once: all of it while they hold nothing.
fn jaws_share(piece_m: f64, each: &JawsState, target: &Option<Isometry3<f64>>, jaws: &Jaws) -> f64 {
    let (Some(from), Some(to), false) = (each.pose, target, each.points.is_empty()) else {
        return 1.0;
    };
    let turn = (to.rotation * from.rotation.inverse()).angle();
    let ways = [0.0, jaws.length_m].map(|along_m| {
        let [a, b] = [&from, to].map(|pose| jaws.on_pads(pose, (along_m, 0.0)));
        a.metric_distance(&b)
    });
    let share = (MOST_TURN / turn).min(piece_m / ways[0].max(ways[1]));
    // A way without end is none.
    if share.is_nan() {
        f64::NAN
    } else {
        share.min(1.0)
    }
}

/// Which share of its way a bar may go at once, which `nears` something or not.
fn bar_share(
    sources: &Sources,
    (each, nears): (&BarState, bool),
    to: &Option<Isometry3<f64>>,
    bar: &Bar,
) -> f64 {
    let (Some(from), Some(to)) = (each.pose, to) else {
        return 1.0;
    };
    if each.is_sunk && !nears {
        // It touches nothing on its way.
        return 1.0;
    }
    let piece_m = match nears {
        true => bar.piece_m(sources.edge_m()),
        // It is looked for farther than this.
        false => sources.piece_m * EDGE_PIECES,
    };
    let turn = (to.rotation * from.rotation.inverse()).angle();
    let [here, there] = [&from, to].map(|pose| bar.ends(pose));
    let ways = here.iter().zip(&there).map(|(a, b)| a.metric_distance(b));
    let share = (MOST_TURN / turn).min(piece_m / ways.fold(0.0, f64::max));
    // A way without end is none.
    if share.is_nan() {
        f64::NAN
    } else {
        share.min(1.0)
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

/// A shift and a turn about a point.
pub(crate) fn about(
    centre: &Vector3<f64>,
    shift: &Vector3<f64>,
    turn: &Vector3<f64>,
) -> Isometry3<f64> {
    let rotation = UnitQuaternion::from_scaled_axis(*turn);
    let to = centre + shift - rotation * centre;
    Isometry3::from_parts(Translation3::from(to), rotation)
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
