//! Threads and tissues that touch within a balance: laid before a solve, looked at after it, taken over at its end.
//!
//! Entry points: [`Drive::lay_threads`], [`Drive::settle_threads`], [`Drive::meets`], [`Drive::finish_sewing`].

use super::MOST_GROUPS;
use super::drive::{Drive, NeedleWork, anchor};
use super::model::Needles;
use super::state::NeedleState;
use crate::anchors::AnchorPoint;
use crate::thread::{ThreadHold, ThreadState, wraps};
use nalgebra::Vector3;

/// A thread that would bend by less over tissue cuts into it \[rad\].
const LEAST_TURN: f64 = 0.05;

impl Drive<'_> {
    /// Whether both ends of a thread withstand a pull.
    pub(super) fn is_held(&self, thread: usize) -> bool {
        let needle = &self.states[self.needles.threads.needles[thread]];
        let state = &self.threads[thread];
        state.is_tail_held() && head_at(self.needles, needle, state, thread).is_some()
    }

    /// The tools that hold the tail and the head of a thread.
    pub(super) fn held_by(&self, thread: usize) -> [Option<u8>; 2] {
        let state = &self.threads[thread];
        let by = |hold: &ThreadHold| match hold {
            ThreadHold::Tool(tool) => Some(*tool),
            _ => None,
        };
        let needle = &self.states[self.needles.threads.needles[thread]];
        let head = match state.head.by {
            ThreadHold::Free | ThreadHold::Knot => needle.grip.map(|grip| grip.tool),
            hold => by(&hold),
        };
        [by(&state.tail.by), head]
    }

    /// The paths of threads that pull, and where they are linearised first.
    pub(super) fn lay_threads(&mut self) {
        let held = &self.needles.threads;
        let ground = held.ground(&self.needles.mesh, self.points_m);
        let mut known = std::mem::take(&mut self.work.known_segments);
        for index in 0..self.threads.len() {
            let needle = &self.states[held.needles[index]];
            let head = head_at(self.needles, needle, &self.threads[index], index);
            let mut thread = std::mem::take(&mut self.threads[index]);
            if thread.pulls(head.is_some()) {
                thread.lay(&ground, head, &mut known, |at| self.position_of(at));
                if self.needles.threads.parts[index].friction > 0.0 {
                    thread.pass_through(&self.needles.mesh, |at| self.position_of(at));
                }
            } else {
                thread.segments.clear();
                thread.spans.clear();
            }
            self.threads[index] = thread;
        }
        self.work.known_segments = known;
    }

    /// Takes the threads' tensions from a solve and linearises their paths anew; whether that was not needed.
    pub(super) fn settle_threads(&mut self) -> bool {
        let held = &self.needles.threads;
        let ground = held.ground(&self.needles.mesh, self.points_m);
        let mut settled = true;
        let mut first = 0;
        for (index, thread) in self.threads.iter_mut().enumerate() {
            if thread.segments.is_empty() {
                continue;
            }
            let needle = &self.states[held.needles[index]];
            let is_held =
                thread.is_tail_held() && head_at(self.needles, needle, thread, index).is_some();
            let rows = (self.work.set.rows.len(), first);
            settled &= thread.settle(
                &held.parts[index],
                is_held,
                rows,
                &ground,
                &self.work.system,
                self.grasp,
            );
            first += thread.spread_rows(&held.parts[index], is_held);
        }
        settled
    }

    /// Threads have slid: those that pull as the solve says, others follow their needle.
    fn finish_threads(&mut self) {
        for index in 0..self.threads.len() {
            let needle = self.needles.threads.needles[index];
            let head = head_at(
                self.needles,
                &self.states[needle],
                &self.threads[index],
                index,
            );
            let is_held = self.threads[index].is_tail_held() && head.is_some();
            self.threads[index].finish(is_held);
            if is_held {
                continue;
            }
            let Some(head) = head else {
                self.draw_back(index);
                continue;
            };
            let Some(last) = self.threads[index].passed.last().map(|last| last.crossing) else {
                continue;
            };
            let way = head - self.position_of(&anchor(&self.needles.mesh, &last));
            let thread = &mut self.threads[index];
            let short = way.norm() - (thread.head.alpha - last.alpha);
            if short > 0.0 {
                thread.draw(short);
                thread.drop_behind();
            }
        }
    }

    /// What a tail that is pulled draws out of the tissue of a thread whose head nobody holds.
    fn draw_back(&mut self, index: usize) {
        let thread = &self.threads[index];
        let tail = thread.tail;
        let has_place = matches!(tail.by, ThreadHold::Place(_) | ThreadHold::Tool(_));
        let Some(first) = thread.passed.first().filter(|_| has_place) else {
            return;
        };
        let way = tail.at - self.position_of(&anchor(&self.needles.mesh, &first.crossing));
        let short = way.norm() - (first.crossing.alpha - tail.alpha);
        if short > 0.0 {
            let thread = &mut self.threads[index];
            thread.draw(-short);
            thread.drop_ahead();
        }
    }

    /// Finds where all nodes are after the last solve.
    pub(super) fn look_at_all(&mut self) {
        if self.work.at_solve == self.work.solves {
            return;
        }
        self.work.at_solve = self.work.solves;
        if self.work.pushes.is_empty() && self.body.is_linear() {
            // Nothing acts: all nodes rest.
            if !self.work.at_rest {
                self.work.at.copy_from_slice(&self.needles.resting_m);
                self.work.at_rest = true;
            }
            return;
        }
        self.work.at_rest = false;
        self.clock.lap(&mut self.report.stages.solve_ns);
        let numbering = self.body.numbering();
        let NeedleWork { system, at, .. } = &mut *self.work;
        let u = system.field(self.body, self.grasp);
        for ((node, at), from) in (0u32..).zip(at.iter_mut()).zip(self.points_m) {
            *at = Vector3::from(*from) + Vector3::from(numbering.at_node(u, node));
        }
        self.report.fields += 1;
        self.clock.lap(&mut self.report.stages.field_ns);
    }

    /// As far as nodes may be from where they rest \[m\].
    fn slack_m(&self) -> f64 {
        let mut slack = [0.0; MOST_GROUPS];
        let slack = &mut slack[..self.needles.hierarchy.groups()];
        let NeedleWork { system, pushes, .. } = &*self.work;
        let resting = &self.needles.resting;
        system.slack(self.body, self.grasp, pushes, resting, slack);
        slack.iter().copied().fold(0.0, f64::max)
    }

    /// Whether tissues have met on the way to where the last solve has them, and so have rows now.
    pub(super) fn meets(&mut self) -> bool {
        let Some(touching) = &self.needles.touching else {
            return false;
        };
        let slack_m = self.slack_m();
        let is_clear = self.touch.as_ref().is_none_or(|touch| {
            touch.is_clear(slack_m + touch.strayed_m(touching, &self.needles.resting_m))
        });
        if is_clear {
            return false;
        }
        self.look_at_all();
        let NeedleWork { touch, at, .. } = &mut *self.work;
        let met = match (&mut self.touch, touch) {
            (Some(state), Some(work)) => state.look(touching, work, at),
            _ => false,
        };
        self.clock.lap(&mut self.report.stages.detect_ns);
        met
    }

    /// A balance is found: what touches is looked at anew.
    fn finish_touch(&mut self) {
        let Some(touching) = &self.needles.touching else {
            return;
        };
        if self.work.at_solve != self.work.solves {
            return;
        }
        let first = 3 * self.work.points.len();
        let NeedleWork { touch, at, .. } = &mut *self.work;
        if let (Some(state), Some(work)) = (&mut self.touch, touch) {
            let lambda = self.grasp.lambda().get(first..).unwrap_or_default();
            state.accept(touching, work, at, lambda);
            self.report.touching = state.pressing() as u32;
        }
        self.clock.lap(&mut self.report.stages.detect_ns);
    }

    /// Brings the skin to where all nodes are.
    fn fit_skin(&mut self) {
        let NeedleWork {
            skin,
            at,
            at_rest,
            skin_at_rest,
            ..
        } = &mut *self.work;
        let Some(skin) = skin else {
            return;
        };
        if !(*at_rest && *skin_at_rest) {
            skin.refit(at);
            *skin_at_rest = *at_rest;
        }
    }

    /// A balance is found: where taut threads bend over tissue.
    fn bend_threads(&mut self) {
        if self.threads.iter().all(|thread| !thread.may_bend()) {
            self.threads
                .iter_mut()
                .for_each(|thread| thread.bends.clear());
            return;
        }
        self.look_at_all();
        self.fit_skin();
        let NeedleWork {
            skin,
            at,
            wraps: found,
            bends,
            ..
        } = &mut *self.work;
        let Some(skin) = skin else {
            return;
        };
        let mesh = &self.needles.mesh;
        for thread in self.threads.iter_mut() {
            thread.bend(mesh, at, bends, |from, to, up, out| {
                found.clear();
                wraps(skin, at, from, to, up, LEAST_TURN, found);
                out.extend(found.iter().map(|wrap| AnchorPoint {
                    nodes: [wrap.nodes[0], wrap.nodes[1], wrap.nodes[0], wrap.nodes[0]],
                    weights: [wrap.weights[0], wrap.weights[1], 0.0, 0.0],
                }));
            });
        }
        self.clock.lap(&mut self.report.stages.detect_ns);
    }

    /// A balance is found: threads have slid, and what bends and touches is looked at anew.
    pub(super) fn finish_sewing(&mut self) {
        self.finish_threads();
        self.bend_threads();
        self.finish_touch();
    }
}

/// Where the head of a thread is held \[m\]: at its needle's end, if somebody holds that, or apart from it.
pub(super) fn head_at(
    needles: &Needles,
    needle: &NeedleState,
    thread: &ThreadState,
    index: usize,
) -> Option<Vector3<f64>> {
    match thread.head.by {
        ThreadHold::Place(_) | ThreadHold::Tool(_) => Some(thread.head.at),
        _ => {
            needle.grip?;
            let part = &needles.parts[needles.threads.needles[index]].needle;
            Some(part.at(&needle.pose).start)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clock::Clock;
    use crate::needle::{NeedlesState, NeedlesWork};
    use crate::scene::{Document, Scene};
    use crate::step::StepReport;

    /// Two slabs with a thread, and a load, so that they do not rest where the mesh has them.
    fn wound() -> Scene {
        let text = include_str!("../../../scenes/wound-slabs.toml");
        let coarse = text.replace("divisions = [8, 12, 4]", "divisions = [3, 4, 2]");
        let load = "[[load]]\non = { box = { min_m = [-0.01, -1.0, -0.001], max_m = [0.01, 1.0, 1.0] } }\n\
                    total_force_n = [0.0, 0.02, -0.05]\n";
        let text = [&coarse, "\n", load].concat();
        let document = Document::embedded("wound.toml", "".as_ref(), &text);
        Scene::read(&document, "wound").expect("a good scene")
    }

    /// Where nothing acts, what takes no solve is what a solve finds; and the skin comes back with it.
    #[test]
    fn tissue_on_which_nothing_acts_is_where_a_field_of_all_nodes_has_it() {
        let (model, ..) = wound().build().expect("a good model");
        let needles = model.needles.as_ref().expect("a needle");
        let mut state = NeedlesState::new(needles, model.motion.clone());
        let mut work = NeedlesWork::new(&model, needles);
        let (mut report, mut clock) = (StepReport::default(), Clock::start());
        let mut drive = Drive {
            body: &model.body,
            needles,
            points_m: model.points_m(),
            states: &mut state.each,
            threads: &mut state.threads,
            touch: state.touch.as_mut(),
            tools: &mut state.tools,
            grasp: &mut state.grasp,
            work: &mut work.drive,
            report: &mut report,
            clock: &mut clock,
        };
        let skin = |drive: &Drive| format!("{:?}", drive.work.skin);
        drive.look_at_all();
        drive.fit_skin();
        assert_eq!((drive.work.at_rest, drive.report.fields), (true, 0));
        let (at, skin_at_rest) = (drive.work.at.clone(), skin(&drive));

        let numbering = drive.body.numbering();
        let u = drive.work.system.field(drive.body, drive.grasp);
        let way = |node: u32| Vector3::from(numbering.at_node(u, node));
        let points = || (0..).zip(drive.points_m);
        let moved_m = points()
            .map(|(node, _)| way(node).norm())
            .fold(0.0, f64::max);
        assert!(moved_m > 1e-5, "{moved_m} m");
        for ((node, from), at) in points().zip(&at) {
            let found = Vector3::from(*from) + way(node);
            assert!((found - at).norm() < 1e-9 * moved_m, "{found} {at}");
        }

        // Tissue that has been elsewhere.
        drive.work.at.iter_mut().for_each(|at| at.z += 1e-3);
        drive.work.at_rest = false;
        drive.fit_skin();
        assert_ne!(skin(&drive), skin_at_rest);
        drive.work.solves += 1;
        drive.look_at_all();
        drive.fit_skin();
        assert_eq!(drive.work.at, at);
        assert_eq!(skin(&drive), skin_at_rest);
    }
}
