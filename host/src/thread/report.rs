//! What is asked of threads between steps, and said of them after one.
//!
//! Entry points: [`SourcesState::thread_path`], [`Balance::feel_threads`], [`Balance::report_threads`].

use super::{Bridge, HandReport, ThreadEnd, ThreadPlace, ThreadPoint, ThreadReport, ThreadTension};
use crate::anchors::AnchorPoint;
use crate::model::Model;
use crate::needle::anchor;
use crate::step::{Balance, Felt, Pull, Sources, SourcesState};
use nalgebra::{Vector3, Vector6};

impl SourcesState {
    /// See [`crate::step::State::bridges`].
    pub fn bridges(
        &self,
        sources: &Sources,
        model: &Model,
        nodes_m: &[[f64; 3]],
        thread: usize,
    ) -> Vec<Bridge> {
        let ground = sources.threads.ground(&sources.mesh, model.points_m());
        let place = |at: &AnchorPoint| place_of(nodes_m, at);
        let mut bridges = Vec::new();
        for mut each in self.joined(thread) {
            each.segments.clear();
            each.lay(&ground, None, &mut Vec::new(), place);
            let spans = each.spans.iter().enumerate();
            let bridging = spans.filter(|(_, span)| span.bridges);
            bridges.extend(bridging.map(|(index, span)| Bridge {
                rest_m: span.rest_m,
                now_m: each.lengths_of(index),
                tension_n: self.tension_after(thread, span.key),
            }));
        }
        bridges
    }

    /// Tension behind the face of that name, towards the head, up to a hand \[N\].
    fn tension_after(&self, thread: usize, id: u32) -> f64 {
        let mut strands = self.strands(thread).iter();
        let is_own = |strand: &usize| {
            self.threads[*strand]
                .passed
                .iter()
                .any(|passed| passed.id == id)
        };
        let own = strands.find(is_own);
        own.map_or(0.0, |strand| self.threads[strand].tension_after(id))
    }

    /// See [`crate::step::State::thread_pressures_pa`].
    pub fn thread_pressures_pa(&self, sources: &Sources, thread: usize) -> Vec<f64> {
        let strands = self.strands(thread).iter();
        let each = strands.map(|strand| (&self.threads[strand], sources.threads.part_of(strand)));
        each.flat_map(|(each, part)| each.pressures_pa(part))
            .collect()
    }

    /// See [`crate::step::State::thread_path`].
    pub fn thread_path(
        &self,
        sources: &Sources,
        nodes_m: &[[f64; 3]],
        thread: usize,
    ) -> Vec<ThreadPoint> {
        let mut places = self.thread_places(sources, nodes_m, thread);
        if self.is_head_in_hand(thread) {
            places.pop();
        }
        places.into_iter().map(|(_, point)| point).collect()
    }

    /// Whether a hand holds the head apart from the needle, so that the path ends there.
    pub(super) fn is_head_in_hand(&self, thread: usize) -> bool {
        self.strands(thread).head(&self.threads) != thread
    }

    /// The points of a thread's path, and the needle's end behind a hand that holds the head, from tail to head; each with the id
    /// of the face that it is or lies behind, 0 before the first.
    pub(super) fn thread_places(
        &self,
        sources: &Sources,
        nodes_m: &[[f64; 3]],
        thread: usize,
    ) -> Vec<(u32, ThreadPoint)> {
        let mut path: Vec<(u32, ThreadPoint)> = Vec::new();
        let mut before: Option<usize> = None;
        for strand in self.strands(thread).iter() {
            let each = &self.threads[strand];
            let mut last = path.last().map_or(0, |(last, _)| *last);
            let places = self.places(sources, nodes_m, strand);
            if each.goes_on() {
                // The hand between the two is the first point of this one.
                path.pop();
            } else if let Some(before) = before {
                let ends = [path.last(), places.first()].map(|end| end.map(|(_, end)| end.at_m));
                let along_m = [self.threads[before].head.alpha, each.tail.alpha];
                for (at_m, along_m) in ends.into_iter().zip(along_m) {
                    let what = ThreadPlace::Cut;
                    path.extend(at_m.map(|at_m| {
                        (
                            last,
                            ThreadPoint {
                                at_m,
                                along_m,
                                what,
                                tension_n: 0.0,
                            },
                        )
                    }));
                }
            }
            for (id, point) in places {
                last = last.max(id);
                path.push((last, point));
            }
            before = Some(strand);
        }
        path
    }

    /// The points of a strand's path, from tail to head.
    pub(super) fn strand_places(
        &self,
        sources: &Sources,
        nodes_m: &[[f64; 3]],
        strand: usize,
    ) -> Vec<ThreadPoint> {
        let places = self.places(sources, nodes_m, strand);
        places.into_iter().map(|(_, point)| point).collect()
    }

    /// The points of a strand's path, each with the id of the face that it is or lies behind, 0 before the first.
    fn places(
        &self,
        sources: &Sources,
        nodes_m: &[[f64; 3]],
        strand: usize,
    ) -> Vec<(u32, ThreadPoint)> {
        let each = &self.threads[strand];
        let mut path = Vec::with_capacity(each.passed.len() + 3);
        let end = |at: Vector3<f64>, along_m, tension_n| ThreadPoint {
            at_m: at.into(),
            along_m,
            what: ThreadPlace::End,
            tension_n,
        };
        if each.is_tail_in_hand() {
            path.push((0, end(each.tail.at, each.tail.alpha, each.tension_after(0))));
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
        for passed in &each.passed {
            let at = anchor(&sources.mesh, &passed.crossing);
            let face = ThreadPoint {
                at_m: place_of(nodes_m, &at).into(),
                along_m: passed.crossing.alpha,
                what: match (passed.is_boundary, passed.crossing.enters) {
                    (false, _) => ThreadPlace::Inside,
                    (true, true) => ThreadPlace::Enters,
                    (true, false) => ThreadPlace::Leaves,
                },
                tension_n: each.tension_after(passed.id),
            };
            path.push((passed.id, face));
            bends(&mut path, passed.id);
        }
        let last = path.last().map_or(0, |(last, _)| *last);
        if each.head.by.is_hand() {
            path.push((last, end(each.head.at, each.head.alpha, 0.0)));
        } else if sources.threads.is_led(strand) {
            let needle = sources.threads.needle_of(strand);
            let curve = sources.needles[needle].needle.at(&self.each[needle].pose);
            path.push((last, end(curve.start, 0.0, 0.0)));
        }
        each.draw_laps(&mut path);
        path
    }

    /// Where on a thread its tail ends \[m\], and the direction in which its head is fastened to the needle.
    pub(super) fn thread_ends(&self, sources: &Sources, thread: usize) -> (f64, Vector3<f64>) {
        let first = self.strands(thread).iter().next().unwrap_or(thread);
        let needle = sources.threads.needle_of(thread);
        let curve = sources.needles[needle].needle.at(&self.each[needle].pose);
        (self.threads[first].end_m, curve.tangent)
    }
}

/// A point of a thread outside.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Outside {
    /// Where it is \[m\].
    pub at: Vector3<f64>,
    /// Where a hand has it that takes it there \[m\]: what is slack comes to the hand, what is taut stays.
    pub held: Vector3<f64>,
    /// Where on the thread \[m\], the slack of its span shared out evenly, and with what the way to the hand needs from the face before.
    pub along_m: f64,
    /// Faces before it.
    pub faces: usize,
}

/// The point of what lies outside that is nearest to a place \[m\]; what is slack counts as straight. `is_held` says whether the path's end
/// withstands a pull: then it gives nothing of what the way to the hand lacks.
pub(crate) fn nearest_outside(
    path: &[ThreadPoint],
    to: &Vector3<f64>,
    is_held: bool,
) -> Option<Outside> {
    let at = |point: &ThreadPoint| Vector3::from(point.at_m);
    let is_face = |point: &&ThreadPoint| {
        !matches!(
            point.what,
            ThreadPlace::End | ThreadPlace::Wraps | ThreadPlace::Cut
        )
    };
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
        let is_taut = span.first().is_some_and(|from| from.tension_n > 0.0);
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
                let before_m = gone_m + from.metric_distance(to);
                let after_m = total_m - gone_m - way.norm() + until.metric_distance(to);
                let most_m = match is_held && last + 1 == path.len() {
                    true => end - begin - after_m,
                    false => f64::INFINITY,
                };
                let even_m = part * (end - begin);
                let (held, along_m) = if is_taut || before_m > most_m {
                    (point, even_m)
                } else {
                    (*to, even_m.max(before_m).min(most_m))
                };
                let outside = Outside {
                    at: point,
                    held,
                    along_m: begin + along_m,
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

/// Where a point of tissue is whose nodes are at `nodes_m` \[m\].
pub(super) fn place_of(nodes_m: &[[f64; 3]], at: &AnchorPoint) -> Vector3<f64> {
    let parts = at.nodes.iter().zip(at.weights);
    let places = parts
        .filter_map(|(node, weight)| Some(Vector3::from(*nodes_m.get(*node as usize)?) * weight));
    places.sum()
}

/// An end of a strand: its tension \[N\], the unit vector along which it pulls what holds it, (3), and where that is \[m\], (3); zero
/// where nothing does.
#[derive(Clone, Copy)]
struct EndReport {
    tension_n: f64,
    direction: [f64; 3],
    at_m: [f64; 3],
}

impl Felt {
    /// Adds the pull of a thread.
    fn pull(&mut self, Pull { arm, force, .. }: &Pull) {
        let moment = arm.cross(force);
        self.wrench += Vector6::new(force.x, force.y, force.z, moment.x, moment.y, moment.z);
        self.rows += 1;
        if self.touching.is_none() {
            self.gap_m = 0.0;
        }
    }
}

impl Balance<'_> {
    /// What a tool feels of the ends of threads that it holds, or the needle before them.
    pub(super) fn feel_threads(&mut self, felt: &mut Felt) {
        self.work.threads.pulls.clear();
        let mut first = self.work.set.rows.len();
        for (index, thread) in self.state.threads.iter().enumerate() {
            let part = self.sources.threads.part_of(index);
            let is_held = self.is_held(index);
            let ends = [ThreadEnd::Tail, ThreadEnd::Head].into_iter();
            for (end, by) in ends.zip(self.held_by(index)) {
                let Some((force, at, rows)) = thread.end(end, part, is_held, first) else {
                    continue;
                };
                if by != Some(felt.tool) {
                    continue;
                }
                let pull = Pull {
                    arm: at - felt.grip,
                    force,
                    rows,
                    on_body: None,
                };
                felt.pull(&pull);
                self.work.threads.pulls.push(pull);
            }
            // What lies on its body is felt along the straight pieces there: where these begin does not matter.
            for pull in thread.pulls_on(part, is_held, first) {
                if self.carrier(pull.with) != Some(felt.tool) {
                    continue;
                }
                let pull = Pull {
                    arm: pull.far_m - felt.grip,
                    force: pull.force,
                    rows: pull.rows,
                    on_body: Some(pull.way),
                };
                felt.pull(&pull);
                self.work.threads.pulls.push(pull);
            }
            first += thread.spread_rows(part, is_held);
        }
    }

    /// What a step found about each thread.
    pub(super) fn report_threads(&mut self) {
        let threads = &self.sources.threads;
        let count = threads.parts.len();
        for index in 0..count {
            self.report.threads_mut(count)[index] = self.thread_report(index);
            self.report_hands(index);
        }
        for strand in 0..self.state.threads.len() {
            let id = threads.part_of(strand).id;
            let strands = self.state.strands(threads.thread_of(strand));
            let is_head = strand == strands.head(&self.state.threads);
            for event in self.state.threads[strand].take_events(id, is_head) {
                self.report.happened(event);
            }
        }
    }

    /// The ends are those that somebody holds: beyond a hand at the head is only the needle.
    fn thread_report(&self, index: usize) -> ThreadReport {
        let strands = self.state.strands(index);
        let head = strands.head(&self.state.threads);
        let tail = strands.iter().next().unwrap_or(index);
        let mut out = ThreadReport {
            id: self.sources.threads.part_of(index).id,
            held_by: [self.held_by(tail)[0], self.held_by(head)[1]],
            ..ThreadReport::default()
        };
        for strand in strands.iter() {
            self.add_strand(strand, &mut out);
            if strand == head {
                break;
            }
        }
        let ends = [(tail, ThreadEnd::Tail), (head, ThreadEnd::Head)];
        for (place, (strand, end)) in ends.into_iter().enumerate() {
            let thread = &self.state.threads[strand];
            let felt = self.end_report(strand, end);
            (out.tension_n[place], out.direction[place]) = (felt.tension_n, felt.direction);
            out.end_m[place] = felt.at_m;
            out.end_state[place] = thread.state;
            out.slack_m[place] = thread.available_m() - thread.length_m();
            out.pulled_m[place] = thread.pulled_m[place];
            out.slipped_m[place] = thread.slipped_m[place];
        }
        out
    }

    /// What holds a thread between its ends, from the tail on.
    fn report_hands(&mut self, index: usize) {
        let strands = self.state.strands(index);
        let head = strands.head(&self.state.threads);
        let mut between = strands.iter();
        let mut before = between.next().unwrap_or(index);
        for after in between {
            // One at the head is between ends as long as the needle is held beyond it.
            if before == head && self.state.threads[after].segments.is_empty() {
                break;
            }
            if self.state.threads[after].goes_on() {
                let hand = self.hand_report([before, after]);
                self.report.held(hand);
            }
            before = after;
        }
    }

    /// Adds what is of all strands.
    fn add_strand(&self, strand: usize, out: &mut ThreadReport) {
        let thread = &self.state.threads[strand];
        let part = self.sources.threads.part_of(strand);
        let welds = thread.segments.iter().filter(|segment| segment.is_weld);
        if thread.state == ThreadTension::Taut {
            out.state = ThreadTension::Taut;
        }
        out.punctures += thread.punctures();
        out.length_m += thread.length_m();
        out.available_m += thread.available_m();
        out.drawn_m += thread.drawn_m();
        out.welds += welds.count() as u32;
        out.wraps += thread.bends.len() as u32;
        out.laps += thread.laps.iter().filter(|lap| lap.is_on).count() as u32;
        out.dissipated_j += thread.friction_j;
        out.pressure_pa = thread.pressures_pa(part).fold(out.pressure_pa, f64::max);
        if let Some(lost_m) = thread.broken_off_m {
            out.broken_off_m = Some(out.broken_off_m.unwrap_or(0.0) + lost_m);
        }
    }

    fn end_report(&self, strand: usize, end: ThreadEnd) -> EndReport {
        let thread = &self.state.threads[strand];
        let segment = match end {
            ThreadEnd::Tail => thread.segments.first(),
            ThreadEnd::Head | ThreadEnd::Span => thread.segments.last(),
        };
        let is_free = match end {
            ThreadEnd::Tail => !thread.is_tail_held(),
            ThreadEnd::Head | ThreadEnd::Span => thread.ends_at_hand(),
        };
        let tension_n = segment.filter(|_| !is_free);
        let tension_n = tension_n.map_or(0.0, |segment| segment.tension_n);
        let part = self.sources.threads.part_of(strand);
        let pull = thread.end(end, part, self.is_held(strand), 0);
        let pull = pull.map(|(force, at, rows)| {
            let direction = force.try_normalize(0.0).unwrap_or_else(|| rows.pull());
            (direction.into(), at.into())
        });
        let (direction, at_m) = pull.unwrap_or_default();
        EndReport {
            tension_n,
            direction,
            at_m,
        }
    }

    /// Of the hand between two strands.
    fn hand_report(&self, strands: [usize; 2]) -> HandReport {
        let [before, after] = strands.map(|strand| &self.state.threads[strand]);
        let ends = [
            self.end_report(strands[0], ThreadEnd::Head),
            self.end_report(strands[1], ThreadEnd::Tail),
        ];
        HandReport {
            thread: self.sources.threads.part_of(strands[0]).id,
            tool: self.held_by(strands[0])[1],
            at_m: after.tail.at.into(),
            along_m: after.tail.alpha,
            tension_n: ends.map(|end| end.tension_n),
            direction: ends.map(|end| end.direction),
            slack_m: [before, after].map(|each| each.available_m() - each.length_m()),
            slipped_m: [before.slipped_m[1], after.slipped_m[0]],
        }
    }
}
