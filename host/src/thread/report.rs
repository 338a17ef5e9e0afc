//! What is asked of threads between steps, and said of them after one.
//!
//! Entry points: [`SourcesState::hold_thread`], [`Balance::feel_threads`].

use super::{Bridge, ThreadEnd, ThreadHold, ThreadPlace, ThreadPoint, ThreadReport, ThreadState};
use crate::anchors::AnchorPoint;
use crate::model::Model;
use crate::needle::anchor;
use crate::step::{Balance, Felt, Pull, Sources, SourcesState};
use nalgebra::{Vector3, Vector6};

impl SourcesState {
    /// See [`crate::step::State::hold_thread`]; `at` is where it is held, if it has a place.
    pub fn hold_thread(
        &mut self,
        sources: &Sources,
        nodes_m: &[[f64; 3]],
        thread: usize,
        end: ThreadEnd,
        hold: ThreadHold,
        at: Option<[f64; 3]>,
    ) -> bool {
        let Some(each) = self.threads.get(thread) else {
            return false;
        };
        let nearest = match end {
            ThreadEnd::Tail => each.passed.first(),
            ThreadEnd::Head | ThreadEnd::Span => each.passed.last(),
        };
        let at = at.map_or_else(Vector3::zeros, Vector3::from);
        let outside = match end {
            ThreadEnd::Span => nearest_outside(&self.thread_path(sources, nodes_m, thread), &at),
            _ => None,
        };
        let near = nearest.map_or(at, |near| {
            let near = anchor(&sources.mesh, &near.crossing);
            place_of(nodes_m, &near)
        });
        self.threads[thread].hold(end, hold, at, (near, outside));
        true
    }

    /// See [`crate::step::State::bridges`].
    pub fn bridges(
        &self,
        sources: &Sources,
        model: &Model,
        nodes_m: &[[f64; 3]],
        thread: usize,
    ) -> Vec<Bridge> {
        let Some(each) = self.threads.get(thread) else {
            return Vec::new();
        };
        let mut each = each.clone();
        let ground = sources.threads.ground(&sources.mesh, model.points_m());
        each.segments.clear();
        // Beyond a hand on a span, too.
        each.head.by = ThreadHold::Free;
        let place = |at: &AnchorPoint| place_of(nodes_m, at);
        each.lay(&ground, None, &mut Vec::new(), place);
        let spans = each.spans.iter().enumerate();
        let bridging = spans.filter(|(_, span)| span.bridges);
        bridging
            .map(|(index, span)| Bridge {
                rest_m: span.rest_m,
                now_m: each.lengths_of(index),
                tension_n: self.threads[thread].tension_in_span(span.key),
            })
            .collect()
    }

    /// See [`crate::step::State::thread_pressures_pa`].
    pub fn thread_pressures_pa(&self, sources: &Sources, thread: usize) -> Vec<f64> {
        let each = self
            .threads
            .get(thread)
            .zip(sources.threads.parts.get(thread));
        each.map_or_else(Vec::new, |(each, part)| each.pressures_pa(part).collect())
    }

    /// See [`crate::step::State::thread_path`].
    pub fn thread_path(
        &self,
        sources: &Sources,
        nodes_m: &[[f64; 3]],
        thread: usize,
    ) -> Vec<ThreadPoint> {
        let mut places = self.thread_places(sources, nodes_m, thread);
        // A hand that holds the head ends the path.
        if self.threads.get(thread).is_some_and(ThreadState::is_apart) {
            places.pop();
        }
        places.into_iter().map(|(_, point)| point).collect()
    }

    /// The points of a thread's path, and the needle's end behind a hand that holds the head, from tail to head; each with the id
    /// of the face that it is or lies behind, 0 before the first.
    pub(super) fn thread_places(
        &self,
        sources: &Sources,
        nodes_m: &[[f64; 3]],
        thread: usize,
    ) -> Vec<(u32, ThreadPoint)> {
        let Some(each) = self.threads.get(thread) else {
            return Vec::new();
        };
        let part = &sources.needles[sources.threads.needles[thread]];
        let needle = &self.each[sources.threads.needles[thread]];
        let mut path = Vec::with_capacity(each.passed.len() + 3);
        let end = |at: Vector3<f64>, along_m| ThreadPoint {
            at_m: at.into(),
            along_m,
            what: ThreadPlace::End,
            tension_n: 0.0,
        };
        if matches!(each.tail.by, ThreadHold::Place(_) | ThreadHold::Tool(_)) {
            let tail = ThreadPoint {
                tension_n: each.tension_after(0),
                ..end(each.tail.at, each.tail.alpha)
            };
            path.push((0, tail));
        }
        let bends = |path: &mut Vec<(u32, ThreadPoint)>, key: u32| {
            for (_, bend) in each.bends.iter().filter(|(of, _)| *of == key) {
                let point = ThreadPoint {
                    at_m: place_of(nodes_m, bend).into(),
                    along_m: path.last().map_or(0.0, |(_, last)| last.along_m),
                    what: ThreadPlace::Wraps,
                    tension_n: each.tension_after(key),
                };
                path.push((key, point));
            }
        };
        bends(&mut path, 0);
        let hand = match each.head.by {
            ThreadHold::Place(_) | ThreadHold::Tool(_) => Some(end(each.head.at, each.head.alpha)),
            _ => None,
        };
        let (faces, mut last) = (each.faces_of_path(), 0);
        for (index, passed) in each.passed.iter().enumerate() {
            path.extend(hand.filter(|_| index == faces).map(|hand| (last, hand)));
            let at = anchor(&sources.mesh, &passed.crossing);
            let face = ThreadPoint {
                at_m: place_of(nodes_m, &at).into(),
                along_m: passed.crossing.alpha,
                what: match (passed.is_boundary, passed.crossing.enters) {
                    (false, _) => ThreadPlace::Inside,
                    (true, true) => ThreadPlace::Enters,
                    (true, false) => ThreadPlace::Leaves,
                },
                tension_n: each.tension_in_span(passed.id),
            };
            last = passed.id;
            path.push((last, face));
            bends(&mut path, last);
        }
        path.extend(hand.filter(|_| each.is_apart()).map(|hand| (last, hand)));
        path.push((last, end(part.needle.at(&needle.pose).start, 0.0)));
        path
    }

    /// Where on a thread its tail ends \[m\], and the direction in which its head is fastened to the needle.
    pub(super) fn thread_ends(&self, sources: &Sources, thread: usize) -> (f64, Vector3<f64>) {
        let each = &self.threads[thread];
        let needle = sources.threads.needles[thread];
        let curve = sources.needles[needle].needle.at(&self.each[needle].pose);
        (each.end_m, curve.tangent)
    }
}

/// A point of a thread outside.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Outside {
    /// Where it is \[m\].
    pub at: Vector3<f64>,
    /// Where on the thread \[m\], the slack of its span shared out evenly, and with what the way to the hand needs from the face before.
    pub along_m: f64,
    /// Faces before it.
    pub faces: usize,
}

/// The point of what lies outside that is nearest to a place \[m\]; what is slack counts as straight.
pub(crate) fn nearest_outside(path: &[ThreadPoint], to: &Vector3<f64>) -> Option<Outside> {
    let at = |point: &ThreadPoint| Vector3::from(point.at_m);
    let is_face =
        |point: &&ThreadPoint| !matches!(point.what, ThreadPlace::End | ThreadPlace::Wraps);
    let mut nearest: Option<(f64, Outside)> = None;
    let mut first = 0;
    while first + 1 < path.len() {
        // A span, with the points that it bends around.
        let wraps = path[first + 1..].iter();
        let wraps = wraps.take_while(|point| point.what == ThreadPlace::Wraps);
        let last = first + 1 + wraps.count();
        let outside = matches!(path[first].what, ThreadPlace::End | ThreadPlace::Leaves);
        let span = path.get(first..=last).filter(|_| outside);
        let span = span.unwrap_or_default();
        let pairs = || span.windows(2).map(|two| (at(&two[0]), at(&two[1])));
        let total_m: f64 = pairs().map(|(a, b)| a.metric_distance(&b)).sum();
        let mut gone_m = 0.0;
        for (from, until) in pairs() {
            let way = until - from;
            let share = (way.dot(&(to - from)) / way.norm_squared()).clamp(0.0, 1.0);
            let share = if share.is_finite() { share } else { 0.0 };
            let point = from + way * share;
            let distance_m = point.metric_distance(to);
            if nearest.is_none_or(|(least_m, _)| distance_m < least_m) {
                let part = (gone_m + share * way.norm()) / total_m.max(f64::MIN_POSITIVE);
                let [begin, end] = [path[first].along_m, path[last].along_m];
                let needed_m = gone_m + from.metric_distance(to);
                let outside = Outside {
                    at: point,
                    along_m: begin + (part * (end - begin)).max(needed_m),
                    faces: path[..=first].iter().filter(is_face).count(),
                };
                nearest = Some((distance_m, outside));
            }
            gone_m += way.norm();
        }
        first = last;
    }
    nearest.map(|(_, outside)| outside)
}

fn place_of(nodes_m: &[[f64; 3]], at: &AnchorPoint) -> Vector3<f64> {
    let parts = at.nodes.iter().zip(at.weights);
    let places = parts
        .filter_map(|(node, weight)| Some(Vector3::from(*nodes_m.get(*node as usize)?) * weight));
    places.sum()
}

impl Balance<'_> {
    /// What a tool feels of the ends of threads that it holds, or the needle before them.
    pub(super) fn feel_threads(&self, felt: &mut Felt) {
        let mut first = self.work.set.rows.len();
        let parts = &self.sources.threads.parts;
        for (index, (thread, part)) in self.state.threads.iter().zip(parts).enumerate() {
            let is_held = self.is_held(index);
            let ends = [ThreadEnd::Tail, ThreadEnd::Head].into_iter();
            for (place, (end, by)) in ends.zip(self.held_by(index)).enumerate() {
                let Some((force, at, rows)) = thread.end(end, part, is_held, first) else {
                    continue;
                };
                if by != Some(felt.tool) {
                    continue;
                }
                let arm = at - felt.grip;
                let moment = arm.cross(&force);
                felt.wrench +=
                    Vector6::new(force.x, force.y, force.z, moment.x, moment.y, moment.z);
                felt.rows += 1;
                if felt.touching.is_none() {
                    felt.gap_m = 0.0;
                }
                felt.pulls[2 * index + place] = Some(Pull { arm, force, rows });
            }
            first += thread.spread_rows(part, is_held);
        }
    }

    /// What a step found about each thread.
    pub(super) fn report_threads(&mut self) {
        let count = self.state.threads.len();
        for index in 0..count {
            self.report.threads_mut(count)[index] = self.thread_report(index);
            let id = self.sources.threads.parts[index].id;
            for event in self.state.threads[index].take_events(id) {
                self.report.happened(event);
            }
        }
    }

    fn thread_report(&self, index: usize) -> ThreadReport {
        let thread = &self.state.threads[index];
        let part = &self.sources.threads.parts[index];
        let is_held = self.is_held(index);
        let spans = 0..thread.spans.len();
        let welds = thread.segments.iter().filter(|segment| segment.is_weld);
        let mut out = ThreadReport {
            id: part.id,
            state: thread.state,
            held_by: self.held_by(index),
            punctures: thread.punctures(),
            slipped_m: thread.slipped_m,
            broken_off_m: thread.broken_off_m,
            // Not -0, which a sum of nothing is.
            length_m: spans.map(|span| thread.lengths_of(span)).sum::<f64>() + 0.0,
            available_m: thread.available_m(),
            pulled_m: thread.pulled_m,
            welds: welds.count() as u32,
            wraps: thread.bends.len() as u32,
            dissipated_j: thread.friction_j,
            pressure_pa: thread.pressures_pa(part).fold(0.0, f64::max),
            ..ThreadReport::default()
        };
        for (place, end) in [ThreadEnd::Tail, ThreadEnd::Head].into_iter().enumerate() {
            let segment = match end {
                ThreadEnd::Tail => thread.segments.first(),
                ThreadEnd::Head | ThreadEnd::Span => thread.segments.last(),
            };
            let is_free = end == ThreadEnd::Tail && !thread.is_tail_held();
            if !is_free {
                out.tension_n[place] = segment.map_or(0.0, |segment| segment.tension_n);
            }
            if let Some((force, at, rows)) = thread.end(end, part, is_held, 0) {
                let direction = force.try_normalize(0.0).unwrap_or_else(|| rows.pull());
                out.direction[place] = direction.into();
                out.end_m[place] = at.into();
            }
        }
        out
    }
}
