//! Where a thread's spans bend over tissue, from one balance to the next.
//!
//! Entry points: [`ThreadState::bend`], [`ThreadState::bend_as_before`].

use super::model::{MOST_BENDS, ThreadTension};
use super::segments::{End, Span};
use super::state::ThreadState;
use crate::anchors::AnchorPoint;
use crate::mesh::HalfFaces;
use nalgebra::Vector3;

/// Of its edge's length: a string that bends over the one of two rims that touch, so near to each other, bends over the other one too, else it
/// would press down the one and the other in turn.
const BESIDE: f64 = 0.1;
/// Normals of both ends that add up to less leave no plane to bend in.
const LEAST_UP: f64 = 0.5;

/// Between two faces of a convex body a path is at most so many times as long as its chord: it stays within the wedge of the
/// faces' planes, whose sides are together 2 / |sum of the normals| chords.
const LONGEST_BRIDGE: f64 = 2.0 / LEAST_UP;
/// To an end that is held the path may lead around an edge, however far that is. Assumed is half a circle over its diameter: a
/// thread with more than that to spare is taken for slack, which is wrong of one that is held behind a body that is thin
/// against its width.
const LONGEST_WAY: f64 = std::f64::consts::FRAC_PI_2;

/// An end of the edge that a bend is on.
fn corner(bend: &AnchorPoint, end: usize) -> AnchorPoint {
    let mut weights = [0.0; 4];
    weights[end] = 1.0;
    AnchorPoint { weights, ..*bend }
}

/// Scratch.
pub(crate) struct BendWork {
    former: Vec<(u32, AnchorPoint)>,
    /// Edges of those of a span.
    edges: Vec<[u32; 2]>,
    new: Vec<AnchorPoint>,
}

impl BendWork {
    /// For so many segments.
    pub fn new(most: usize) -> Self {
        Self {
            former: Vec::with_capacity(most),
            edges: Vec::with_capacity(most),
            new: Vec::with_capacity(most),
        }
    }
}

impl ThreadState {
    /// Whether where it bends over tissue can matter: it has a path, and not so much to spare that it stays slack with any.
    pub fn may_bend(&self) -> bool {
        let longest = self.segments.iter().map(|segment| {
            let span = self.spans.get(segment.span);
            let is_held = span.is_none_or(|span| span.from.is_none() || span.to.is_none());
            let times = if is_held { LONGEST_WAY } else { LONGEST_BRIDGE };
            times * segment.path_m()
        });
        !self.segments.is_empty()
            && (self.state != ThreadTension::Slack || self.available_m() < longest.sum::<f64>())
    }

    /// Bends as it did in the last balance, if it bends elsewhere since; whether it does.
    pub fn bend_as_before(&mut self) -> bool {
        let pairs = self.segments.iter().zip(self.segments.iter().skip(1));
        let former = pairs.filter_map(|(one, next)| match one.ends[1] {
            End::Tissue(bend) if one.key.0 == next.key.0 => Some((one.key.0, bend)),
            _ => None,
        });
        if former.clone().eq(self.bends.iter().copied()) {
            return false;
        }
        self.bends.clear();
        self.bends.extend(former);
        true
    }

    /// The sum of the outward normals at the ends of a span outside; nothing where that is no way out of the tissue.
    fn way_out(&self, mesh: &HalfFaces, at: &[Vector3<f64>], span: &Span) -> Option<Vector3<f64>> {
        let mut up = Vector3::zeros();
        let mut inside = false;
        for passed in [span.from, span.to].into_iter().flatten() {
            let Some(passed) = self.passed.get(passed) else {
                continue;
            };
            inside |= !passed.is_boundary;
            let [a, b, c] = mesh.vertices(passed.crossing.face).map(|node| {
                at.get(node as usize)
                    .copied()
                    .unwrap_or_else(Vector3::zeros)
            });
            up += (b - a)
                .cross(&(c - a))
                .try_normalize(0.0)
                .unwrap_or_default();
        }
        // Between two cuts that face each other no side is outside.
        inside |= up.norm() < LEAST_UP;
        // The needle's end is in the tissue.
        inside |= span.to.is_none()
            && span
                .from
                .and_then(|from| self.passed.get(from))
                .is_some_and(|from| from.crossing.enters);
        (!inside).then_some(up)
    }

    /// Adds bends that a span had, and presses on, to those that are found for it, if one of these is over the other one of two rims that touch.
    /// The piece of the span that is looked at leads `from` a place `to` another one, `up` out of the tissue.
    fn keep_beside(
        &self,
        key: u32,
        [from, to, up]: [&Vector3<f64>; 3],
        place: &impl Fn(&AnchorPoint) -> Vector3<f64>,
        work: &mut BendWork,
    ) {
        for (_, old) in work.former.iter().filter(|(of, _)| *of == key) {
            let [a, b] = [0, 1].map(|end| place(&corner(old, end)));
            let near_m = BESIDE * a.metric_distance(&b);
            let there = place(old);
            let is_beside = |bend: &AnchorPoint| {
                bend.nodes != old.nodes && place(bend).metric_distance(&there) < near_m
            };
            let is_found = work.new.iter().any(|bend| bend.nodes == old.nodes);
            let has_room = work.new.len() < work.new.capacity();
            if is_found || !has_room || !work.new.iter().any(is_beside) {
                continue;
            }
            let way = to - from;
            let along = |bend: &AnchorPoint| (place(bend) - from).dot(&way);
            let is_own = (0.0..way.norm_squared()).contains(&along(old));
            if is_own && self.presses(key, old, up) {
                let before = work.new.iter().take_while(|bend| along(bend) < along(old));
                let before = before.count();
                work.new.insert(before, *old);
            }
        }
    }

    /// Whether a span presses on the tissue where it bends, as the last solve has it.
    fn presses(&self, key: u32, bend: &AnchorPoint, up: &Vector3<f64>) -> bool {
        let pairs = self.segments.iter().zip(self.segments.iter().skip(1));
        let mut own = pairs.filter(|(one, next)| one.key.0 == key && next.key.0 == key);
        own.any(|(one, next)| {
            one.ends[1] == End::Tissue(*bend) && (next.force - one.force).dot(up) < 0.0
        })
    }

    /// Where spans bend over tissue whose nodes are at `at` \[m\]; `over` finds bends of a chord, with the way out of
    /// the tissue, and the edges that its span bent over before. One that has wandered along its edge by less than `wander` of it stays where it
    /// was, so that what is known of it does. Whether any bend is elsewhere than before.
    pub fn bend(
        &mut self,
        mesh: &HalfFaces,
        at: &[Vector3<f64>],
        work: &mut BendWork,
        wander: f64,
        mut over: impl FnMut([&Vector3<f64>; 3], &[[u32; 2]], &mut Vec<AnchorPoint>),
    ) -> bool {
        if !self.may_bend() {
            let did_bend = !self.bends.is_empty();
            self.bends.clear();
            return did_bend;
        }
        let place = |anchor: &AnchorPoint| {
            let parts = anchor.nodes.iter().zip(anchor.weights);
            let each = parts.filter_map(|(node, weight)| Some(at.get(*node as usize)? * weight));
            each.sum::<Vector3<f64>>()
        };
        std::mem::swap(&mut self.bends, &mut work.former);
        self.bends.clear();
        let outside = self.spans.iter().filter(|span| span.passage.is_none());
        let outside = outside.count();
        for (index, span) in self.spans.iter().enumerate() {
            if span.passage.is_some() {
                continue;
            }
            let own = self.segments_of(index);
            let (Some(first), Some(last)) = (own.first(), own.last()) else {
                continue;
            };
            let ends = [first.ends[0], last.ends[1]];
            let [from, to] = ends.map(|end| match end {
                End::Tissue(anchor) => place(&anchor),
                End::Held(at) => at,
            });
            let Some(up) = self.way_out(mesh, at, span) else {
                continue;
            };
            let key = span.key;
            let former = work.former.iter().filter(|(of, _)| *of == key);
            work.edges.clear();
            let edges = former.map(|(_, bend)| [bend.nodes[0], bend.nodes[1]]);
            work.edges.extend(edges);
            work.new.clear();
            // What lies on a body bends over tissue before it and behind it.
            let mut start = from;
            let own = self.range_of(index);
            for segment in &self.segments[own] {
                match (segment.leg, segment.ends) {
                    (Some(leg), [End::Held(on), _]) if leg.leaves => start = on,
                    (Some(leg), [_, End::Held(on)]) => {
                        over([&start, &on, &up], &work.edges, &mut work.new);
                        self.keep_beside(key, [&start, &on, &up], &place, work);
                        let mut laps = self.laps.iter_mut().filter(|lap| lap.is_on);
                        if let Some(lap) =
                            laps.find(|lap| lap.key == span.key && lap.with == leg.with)
                        {
                            lap.bends = work.new.len() as u32;
                        }
                    }
                    _ => {}
                }
            }
            over([&start, &to, &up], &work.edges, &mut work.new);
            self.keep_beside(key, [&start, &to, &up], &place, work);
            for bend in &work.new {
                if self.bends.len() + outside >= MOST_BENDS {
                    break;
                }
                let mut same = work.former.iter().filter(|(of, _)| *of == key);
                let near = same.find(|(_, old)| {
                    let moved = (old.weights[0] - bend.weights[0]).abs();
                    old.nodes == bend.nodes && moved <= wander
                });
                self.bends.push((key, near.map_or(*bend, |(_, old)| *old)));
            }
        }
        self.bends != work.former
    }
}
