//! What is asked of threads between steps, and said of them after one.
//!
//! Entry points: [`NeedlesState::hold_thread`], [`thread_ends`], [`report_threads`].

use super::drive::{Drive, anchor};
use super::model::{MAX_NEEDLES, Needles};
use super::step::NeedlesState;
use crate::anchors::AnchorPoint;
use crate::model::Model;
use crate::step::StepReport;
use crate::thread::{
    Bridge, EndRows, ThreadEnd, ThreadHold, ThreadPlace, ThreadPoint, ThreadReport,
};
use nalgebra::Vector3;

impl NeedlesState {
    /// See [`crate::step::State::hold_thread`]; `at` is where it is held, if it has a place.
    pub fn hold_thread(
        &mut self,
        needles: &Needles,
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
            ThreadEnd::Head => each.passed.last(),
        };
        let at = at.map_or_else(Vector3::zeros, Vector3::from);
        let near = nearest.map_or(at, |near| {
            let near = anchor(&needles.mesh, &near.crossing);
            place_of(nodes_m, &near)
        });
        let part = &needles.threads.parts[thread];
        self.threads[thread].hold(end, hold, at, near, part);
        true
    }

    /// See [`crate::step::State::bridges`].
    pub fn bridges(
        &self,
        needles: &Needles,
        model: &Model,
        nodes_m: &[[f64; 3]],
        thread: usize,
    ) -> Vec<Bridge> {
        let Some(each) = self.threads.get(thread) else {
            return Vec::new();
        };
        let mut each = each.clone();
        let ground = needles.threads.ground(&needles.mesh, model.points_m());
        each.segments.clear();
        let place = |at: &AnchorPoint| place_of(nodes_m, at);
        each.lay(&ground, None, &mut Vec::new(), place);
        let spans = each.spans.iter().enumerate();
        let bridging = spans.filter(|(_, span)| span.bridges);
        bridging
            .map(|(index, span)| Bridge {
                rest_m: span.rest_m,
                now_m: each.lengths_of(index),
                tension_n: self.threads[thread].tension_after(span.key),
            })
            .collect()
    }

    /// See [`crate::step::State::thread_path`].
    pub fn thread_path(
        &self,
        needles: &Needles,
        nodes_m: &[[f64; 3]],
        thread: usize,
    ) -> Vec<ThreadPoint> {
        let Some(each) = self.threads.get(thread) else {
            return Vec::new();
        };
        let part = &needles.parts[needles.threads.needles[thread]];
        let needle = &self.each[needles.threads.needles[thread]];
        let mut path = Vec::with_capacity(each.passed.len() + 2);
        let end = |at: Vector3<f64>, along_m| ThreadPoint {
            at_m: at.into(),
            along_m,
            what: ThreadPlace::End,
            tension_n: 0.0,
        };
        if matches!(each.tail.by, ThreadHold::Place(_) | ThreadHold::Tool(_)) {
            path.push(ThreadPoint {
                tension_n: each.tension_after(0),
                ..end(each.tail.at, each.tail.alpha)
            });
        }
        let bends = |path: &mut Vec<ThreadPoint>, key: u32| {
            for (_, bend) in each.bends.iter().filter(|(of, _)| *of == key) {
                path.push(ThreadPoint {
                    at_m: place_of(nodes_m, bend).into(),
                    along_m: path.last().map_or(0.0, |last| last.along_m),
                    what: ThreadPlace::Wraps,
                    tension_n: each.tension_after(key),
                });
            }
        };
        bends(&mut path, 0);
        for passed in &each.passed {
            let at = anchor(&needles.mesh, &passed.crossing);
            path.push(ThreadPoint {
                at_m: place_of(nodes_m, &at).into(),
                along_m: passed.crossing.alpha,
                what: match (passed.is_boundary, passed.crossing.enters) {
                    (false, _) => ThreadPlace::Inside,
                    (true, true) => ThreadPlace::Enters,
                    (true, false) => ThreadPlace::Leaves,
                },
                tension_n: each.tension_after(passed.id),
            });
            bends(&mut path, passed.id);
        }
        let head = match each.head.by {
            ThreadHold::Place(_) | ThreadHold::Tool(_) => each.head.at,
            _ => part.needle.at(&needle.pose).start,
        };
        path.push(end(head, each.head.alpha));
        path
    }
}

fn place_of(nodes_m: &[[f64; 3]], at: &AnchorPoint) -> Vector3<f64> {
    let parts = at.nodes.iter().zip(at.weights);
    let places = parts
        .filter_map(|(node, weight)| Some(Vector3::from(*nodes_m.get(*node as usize)?) * weight));
    places.sum()
}

/// What a tool feels of the end of a thread: which thread, which tool, where \[m\], its pull \[N\], its rows.
pub(super) type Felt = (usize, u8, Vector3<f64>, Vector3<f64>, EndRows);

/// Tail and head of every thread that pulls, if a tool holds it.
pub(super) fn thread_ends(drive: &Drive) -> [Option<Felt>; 2 * MAX_NEEDLES] {
    let mut ends = [None; 2 * MAX_NEEDLES];
    let mut first = drive.work.set.rows.len();
    let parts = &drive.needles.threads;
    for (index, thread) in drive.threads.iter().enumerate() {
        let part = &parts.parts[index];
        let is_held = drive.is_held(index);
        for (place, end) in [ThreadEnd::Tail, ThreadEnd::Head].into_iter().enumerate() {
            let by = drive.held_by(index)[place];
            let felt = thread.end(end, part, is_held, first);
            if let (Some(by), Some((force, at, rows))) = (by, felt) {
                ends[2 * index + place] = Some((index, by, at, force, rows));
            }
        }
        first += thread.spread_rows(part, is_held);
    }
    ends
}

pub(super) fn report_threads(drive: &Drive, report: &mut StepReport) {
    for (index, out) in report
        .threads_mut(drive.threads.len())
        .iter_mut()
        .enumerate()
    {
        let thread = &drive.threads[index];
        let part = &drive.needles.threads.parts[index];
        let is_held = drive.is_held(index);
        *out = ThreadReport {
            id: part.id,
            state: thread.state,
            held_by: drive.held_by(index),
            punctures: thread.punctures(),
            length_m: (0..thread.spans.len())
                .map(|span| thread.lengths_of(span))
                .sum(),
            available_m: thread.available_m(),
            pulled_m: thread.pulled_m,
            welds: thread
                .segments
                .iter()
                .filter(|segment| segment.is_weld)
                .count() as u32,
            wraps: thread.bends.len() as u32,
            dissipated_j: thread.friction_j,
            ..ThreadReport::default()
        };
        for (place, end) in [ThreadEnd::Tail, ThreadEnd::Head].into_iter().enumerate() {
            let segment = match end {
                ThreadEnd::Tail => thread.segments.first(),
                ThreadEnd::Head => thread.segments.last(),
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
    }
}
