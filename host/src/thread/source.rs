//! Threads as a source of constraints: laid before a round, linearised after each solve, drawn at the end.
//!
//! Entry point: [`ThreadSource`].

use super::model::MOST_SEGMENTS;
use super::state::Hold;
use super::{
    BendWork, FollowWork, Segment, Skin, ThreadHold, ThreadPart, ThreadState, Tie, Wrap, wraps,
};
use crate::anchors::AnchorPoint;
use crate::needle::{NeedleState, anchor};
use crate::source::{Room, Source};
use crate::step::{Balance, BalanceWork, Felt, Pull, Sources, Status};
use crate::tool::ToolSample;
use nalgebra::Vector3;

/// Solves of a balance after which bounds of friction follow with what the other rows answer: mostly they push on as they did.
const PATIENCE: u32 = 6;
/// Solves of a balance after which segments that are not settled go back and forth: Newton's method has a few sets of welds and of what
/// touches in turn.
const SWINGS: u32 = 32;
/// Part of each change that is then made.
const DAMPED: f64 = 0.5;
/// A thread that would bend by less over tissue cuts into it \[rad\].
const LEAST_TURN: f64 = 0.03;
/// The same where its spans have bodies: between two edges it cuts in by a quarter of their distance times this.
const LEAST_TURN_OF_BODY: f64 = 0.002;
/// Part of its edge by which a bend may have wandered when it is looked for again within a balance, and stay where it was.
const WANDER: f64 = 0.05;
/// The same at its end. What a bend jumps is felt: 0.05 changed tensions by up to 3 % at once, 0.01 by up to 1.5 %.
const SETTLED: f64 = 1e-3;
/// Rounds of a balance in which spans are lifted out of the tissue.
const MOST_LIFTS: u32 = 12;

/// Threads.
pub(crate) struct ThreadSource;

/// Scratch of all threads.
pub(crate) struct ThreadWork {
    known_segments: Vec<Segment>,
    skin: Option<Skin>,
    /// Whether the skin was brought last to where the tissue rests.
    skin_at_rest: bool,
    bends: BendWork,
    wraps: Vec<Wrap>,
    follow: FollowWork,
    /// Ends that the tool holds that is looked at.
    pub pulls: Vec<Pull>,
    /// Rounds of this balance in which spans were lifted.
    lifts: u32,
}

impl ThreadWork {
    /// Nothing for a scene without threads.
    pub fn new(sources: &Sources) -> Self {
        let count = sources.threads.parts.len();
        let most = if count > 0 { MOST_SEGMENTS } else { 0 };
        let rubs = sources.threads.parts.iter().any(ThreadPart::rubs);
        let boundary = || sources.mesh.boundary().triangles();
        Self {
            known_segments: Vec::with_capacity(most),
            skin: (count > 0).then(|| Skin::new(boundary(), &sources.resting_m)),
            skin_at_rest: false,
            bends: BendWork::new(most),
            wraps: Vec::with_capacity(most),
            follow: FollowWork::new(rubs),
            pulls: Vec::with_capacity(2 * sources.threads.strands()),
            lifts: 0,
        }
    }

    /// Before a balance.
    pub fn begin(&mut self) {
        self.lifts = 0;
    }
}

impl Source for ThreadSource {
    /// A row for every span, and of all that lies beyond it.
    fn room(&self, sources: &Sources) -> Room {
        let parts = &sources.threads.parts;
        let most = MOST_SEGMENTS * parts.len();
        let rubbing = parts.iter().any(ThreadPart::rubs);
        Room {
            anchors: most,
            rows: 3 * most,
            spread: 2 * most,
            terms: most * if rubbing { MOST_SEGMENTS } else { 3 },
        }
    }

    fn prepare(&self, balance: &mut Balance) {
        balance.place_laps();
        balance.lay_threads();
    }

    fn append(&self, balance: &mut Balance) {
        let held = &balance.sources.threads;
        let ground = held.ground(&balance.sources.mesh, balance.points_m);
        for (index, thread) in balance.state.threads.iter_mut().enumerate() {
            let needle = &balance.state.each[held.needle_of(index)];
            let head = head_at(balance.sources, needle, thread, index);
            let is_held = thread.is_held(head.is_some());
            let set = &mut balance.work.set;
            thread.make_rows(index, held.part_of(index), is_held, &ground, set);
        }
    }

    fn soften(&self, balance: &mut Balance, _solve: u32) {
        balance.soften_threads();
    }

    fn settle(&self, balance: &mut Balance, solve: u32) -> Result<bool, Status> {
        balance.work.threads.follow.part = if solve > SWINGS { DAMPED } else { 1.0 };
        Ok(balance.settle_threads(solve > PATIENCE))
    }

    /// Lifts spans that have bodies out of the tissue, and all onto bodies that they are to lie on.
    fn advance(&self, balance: &mut Balance, _played: Option<usize>) -> Result<bool, Status> {
        let threads = &balance.sources.threads;
        let lifts = &mut balance.work.threads.lifts;
        let have_bodies = threads.parts.iter().any(|part| part.through.body);
        if *lifts >= MOST_LIFTS || !have_bodies && threads.contacts.is_empty() {
            return Ok(false);
        }
        *lifts += 1;
        let bends = have_bodies && balance.bend_threads(WANDER, |part| part.through.body);
        Ok(balance.find_laps() | bends)
    }

    fn accept(&self, balance: &mut Balance) {
        balance.finish_threads();
        balance.bend_threads(SETTLED, |_| true);
        balance.follow_laps();
    }

    fn feel(&self, balance: &mut Balance, felt: &mut Felt) {
        balance.feel_threads(felt);
    }

    fn report(&self, balance: &mut Balance, _samples: &[ToolSample]) {
        balance.report_threads();
    }
}

impl Balance<'_> {
    /// Where the thread on a needle's end is held nearest to it \[m\], and how much there is of it up to there \[m\]; nothing of a
    /// needle without, or with one that nothing holds.
    pub(crate) fn leash(&self, needle: usize) -> Option<(Vector3<f64>, f64)> {
        let held = &self.sources.threads;
        let leads = |strand: &usize| {
            self.state.threads[*strand].is_used
                && held.is_led(*strand)
                && held.needle_of(*strand) == needle
        };
        let thread = &self.state.threads[(0..self.state.threads.len()).find(leads)?];
        let in_hand = |hold: &Hold| hold.by.is_hand().then_some((hold.at, -hold.alpha));
        let at_last = || {
            let last = &thread.passed.last()?.crossing;
            let at = self.position_of(&anchor(&self.sources.mesh, last));
            Some((at, -last.alpha))
        };
        in_hand(&thread.head)
            .or_else(at_last)
            .or_else(|| in_hand(&thread.tail))
    }

    /// Whether both ends of a thread withstand a pull.
    pub(super) fn is_held(&self, thread: usize) -> bool {
        let needle = &self.state.each[self.sources.threads.needle_of(thread)];
        let state = &self.state.threads[thread];
        state.is_held(head_at(self.sources, needle, state, thread).is_some())
    }

    /// The tools that hold the tail and the head of a thread.
    pub(super) fn held_by(&self, thread: usize) -> [Option<u8>; 2] {
        let state = &self.state.threads[thread];
        let by = |hold: &ThreadHold| match hold {
            ThreadHold::Tool(tool) => Some(*tool),
            _ => None,
        };
        let needle = &self.state.each[self.sources.threads.needle_of(thread)];
        let grip = needle.grip.filter(|_| self.sources.threads.is_led(thread));
        let head = match state.head.by {
            ThreadHold::Free | ThreadHold::Knot => grip.map(|grip| grip.tool),
            hold => by(&hold),
        };
        [by(&state.tail.by), head]
    }

    /// The paths of threads that pull, and where they are linearised first.
    fn lay_threads(&mut self) {
        let held = &self.sources.threads;
        let ground = held.ground(&self.sources.mesh, self.points_m);
        let mut known = std::mem::take(&mut self.work.threads.known_segments);
        for index in 0..self.state.threads.len() {
            let needle = &self.state.each[held.needle_of(index)];
            let head = head_at(self.sources, needle, &self.state.threads[index], index);
            let mut thread = std::mem::take(&mut self.state.threads[index]);
            let part = held.part_of(index);
            thread.drop_behind();
            if thread.pulls(part, head.is_some()) {
                thread.lay(&ground, head, &mut known, |at| self.position_of(at));
            } else {
                thread.segments.clear();
                thread.spans.clear();
                thread.laps.clear();
            }
            let drawn_m = thread.take_in(thread.is_head_held(head.is_some()));
            self.state.threads[index] = thread;
            self.state.move_before(index, drawn_m);
        }
        self.work.threads.known_segments = known;
    }

    /// Threads stretch.
    fn soften_threads(&mut self) {
        let BalanceWork { system, set, .. } = &mut *self.work;
        let n = set.count();
        let mut first = set.rows.len();
        let held = &self.sources.threads;
        for (index, thread) in self.state.threads.iter().enumerate() {
            let needle = &self.state.each[held.needle_of(index)];
            let is_held = thread.is_held(head_at(self.sources, needle, thread, index).is_some());
            let part = held.part_of(index);
            thread.soften(part, is_held, first, n, system.compliance_mut(n));
            first += thread.spread_rows(part, is_held);
        }
    }

    /// Takes the threads' tensions from a solve and linearises their paths anew; whether that was not needed. Bounds may follow with all that
    /// the other rows answer.
    fn settle_threads(&mut self, with_answers: bool) -> bool {
        let BalanceWork {
            system,
            set,
            threads,
            ..
        } = &mut *self.work;
        threads.follow.leave_others();
        if with_answers {
            let counts = [set.rows.len(), set.spread.len()];
            threads
                .follow
                .condense_others(system, &self.state.grasp, counts);
        }
        let held = &self.sources.threads;
        let ground = held.ground(&self.sources.mesh, self.points_m);
        let mut settled = true;
        let mut first = 0;
        if self
            .state
            .threads
            .iter()
            .any(|thread| !thread.segments.is_empty())
        {
            self.displace_anchors();
        }
        for index in 0..self.state.threads.len() {
            if self.state.threads[index].segments.is_empty() {
                continue;
            }
            self.state.look_beyond(index);
            let thread = &mut self.state.threads[index];
            let needle = &self.state.each[held.needle_of(index)];
            let is_held = thread.is_held(head_at(self.sources, needle, thread, index).is_some());
            let rows = (self.work.set.rows.len(), first);
            let part = held.part_of(index);
            settled &= thread.settle(
                part,
                is_held,
                rows,
                &ground,
                (&self.work.system, &self.state.grasp),
                &mut self.work.threads.follow,
            );
            first += thread.spread_rows(part, is_held);
        }
        settled
    }

    /// How multipliers of threads that are at a bound follow others.
    pub(crate) fn tie_threads(&mut self, out: &mut Vec<Tie>) {
        out.clear();
        let mut first = self.work.set.rows.len();
        for (index, thread) in self.state.threads.iter().enumerate() {
            if thread.segments.is_empty() {
                continue;
            }
            let is_held = self.is_held(index);
            let part = self.sources.threads.part_of(index);
            let solved = (&self.state.grasp, first);
            thread.tie(part, is_held, solved, &mut self.work.threads.follow, out);
            first += thread.spread_rows(part, is_held);
        }
    }

    /// See [`ThreadState::bend_as_before`]; whether any thread does.
    pub(crate) fn bend_as_before(&mut self) -> bool {
        let threads = self.state.threads.iter_mut();
        threads.fold(false, |any, thread| thread.bend_as_before() | any)
    }

    /// Threads have slid: those that pull as the solve says, others follow their needle or a hand.
    fn finish_threads(&mut self) {
        for index in 0..self.state.threads.len() {
            let is_held = self.is_held(index);
            let part = self.sources.threads.part_of(index);
            let ends = self.state.reach_m(index);
            self.state.threads[index].finish(part, is_held, ends);
            self.state.share_slips(index);
        }
        for index in 0..self.state.threads.len() {
            let part = self.sources.threads.part_of(index);
            // What drags, or hands have, has slid already.
            let thread = &self.state.threads[index];
            let has_slid = (part.drags() || thread.has_hands()) && !thread.segments.is_empty();
            if !self.is_held(index) && !has_slid {
                self.follow_ends(index);
            }
        }
    }

    /// A strand of which one end is free follows the other one without tension.
    fn follow_ends(&mut self, index: usize) {
        let needle = &self.state.each[self.sources.threads.needle_of(index)];
        let thread = &self.state.threads[index];
        let Some(head) = head_at(self.sources, needle, thread, index) else {
            self.draw_back(index);
            return;
        };
        let Some(last) = thread.passed.last().map(|last| last.crossing) else {
            return;
        };
        let way = head - self.position_of(&anchor(&self.sources.mesh, &last));
        let thread = &mut self.state.threads[index];
        let short = way.norm() - (thread.head.alpha - last.alpha);
        if short > 0.0 {
            thread.draw(short);
            thread.drop_behind();
        }
    }

    /// What a tail that is pulled draws out of the tissue of a thread whose head nobody holds.
    fn draw_back(&mut self, index: usize) {
        let thread = &self.state.threads[index];
        let tail = thread.tail;
        let Some(first) = thread.passed.first().filter(|_| tail.by.is_hand()) else {
            return;
        };
        let way = tail.at - self.position_of(&anchor(&self.sources.mesh, &first.crossing));
        let short = way.norm() - (first.crossing.alpha - tail.alpha);
        if short > 0.0 {
            self.state.threads[index].draw_back(short);
        }
    }

    /// Brings the skin to where all nodes are.
    fn fit_skin(&mut self) {
        let BalanceWork { nodes, threads, .. } = &mut *self.work;
        let Some(skin) = &mut threads.skin else {
            return;
        };
        if !(nodes.at_rest && threads.skin_at_rest) {
            skin.refit(&nodes.at);
            threads.skin_at_rest = nodes.at_rest;
        }
    }

    /// Where those of the taut threads that are `meant` bend over tissue as the last solve has it; whether that is elsewhere than
    /// before. Bends that have wandered by less than `wander` of their edge stay.
    fn bend_threads(&mut self, wander: f64, meant: impl Fn(&ThreadPart) -> bool) -> bool {
        let parts = &self.sources.threads;
        let mut changed = false;
        let mut may_bend = false;
        for (index, thread) in self.state.threads.iter_mut().enumerate() {
            if !meant(parts.part_of(index)) {
                continue;
            }
            if thread.may_bend() {
                may_bend = true;
            } else {
                changed |= !thread.bends.is_empty();
                thread.bends.clear();
            }
        }
        if !may_bend {
            return changed;
        }
        self.find_all_nodes();
        self.fit_skin();
        let BalanceWork { nodes, threads, .. } = &mut *self.work;
        let ThreadWork {
            skin,
            wraps: found,
            bends,
            ..
        } = threads;
        let (Some(skin), at) = (skin, &nodes.at) else {
            return changed;
        };
        let mesh = &self.sources.mesh;
        for (index, thread) in self.state.threads.iter_mut().enumerate() {
            let part = parts.part_of(index);
            if !meant(part) {
                continue;
            }
            let least_turn = match part.through.body {
                true => LEAST_TURN_OF_BODY,
                false => LEAST_TURN,
            };
            changed |= thread.bend(mesh, at, bends, wander, |[from, to, up], former, out| {
                found.clear();
                wraps(skin, at, from, to, up, (least_turn, former), found);
                out.extend(found.iter().map(|wrap| AnchorPoint {
                    nodes: [wrap.nodes[0], wrap.nodes[1], wrap.nodes[0], wrap.nodes[0]],
                    weights: [wrap.weights[0], wrap.weights[1], 0.0, 0.0],
                }));
            });
        }
        self.clock.lap(&mut self.report.stages.detect_ns);
        changed
    }
}

/// Where the head of a strand is held \[m\]: in a hand, or at its needle's end, if somebody holds that.
pub(super) fn head_at(
    sources: &Sources,
    needle: &NeedleState,
    strand: &ThreadState,
    index: usize,
) -> Option<Vector3<f64>> {
    if strand.head.by.is_hand() {
        return Some(strand.head.at);
    }
    if !sources.threads.is_led(index) {
        return None;
    }
    needle.grip?;
    let part = &sources.needles[sources.threads.needle_of(index)].needle;
    Some(part.at(&needle.pose).start)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clock::Clock;
    use crate::scene::{Document, Scene};
    use crate::step::{SourcesState, SourcesWork, StepOptions, StepReport};

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
        let sources = model.sources.as_ref().expect("a needle");
        let mut state = SourcesState::new(sources, model.motion.clone());
        let mut work = SourcesWork::new(&model, sources);
        let (mut report, mut clock) = (StepReport::default(), Clock::start());
        let (state, work) = (&mut state, &mut work.balance);
        let options = StepOptions::default();
        let mut balance = Balance::new(
            &model,
            sources,
            &options,
            state,
            work,
            &mut report,
            &mut clock,
        );
        let skin = |balance: &Balance| format!("{:?}", balance.work.threads.skin);
        balance.find_all_nodes();
        balance.fit_skin();
        assert_eq!(
            (balance.work.nodes.at_rest, balance.report.fields),
            (true, 0)
        );
        let (at, skin_at_rest) = (balance.work.nodes.at.clone(), skin(&balance));

        let numbering = balance.body.numbering();
        let u = balance
            .work
            .system
            .field(balance.body, &balance.state.grasp);
        let way = |node: u32| Vector3::from(numbering.at_node(u, node));
        let points = || (0..).zip(balance.points_m);
        let moved_m = points()
            .map(|(node, _)| way(node).norm())
            .fold(0.0, f64::max);
        assert!(moved_m > 1e-5, "{moved_m} m");
        for ((node, from), at) in points().zip(&at) {
            let found = Vector3::from(*from) + way(node);
            assert!((found - at).norm() < 1e-9 * moved_m, "{found} {at}");
        }

        // Tissue that has been elsewhere.
        balance.work.nodes.at.iter_mut().for_each(|at| at.z += 1e-3);
        balance.work.nodes.at_rest = false;
        balance.fit_skin();
        assert_ne!(skin(&balance), skin_at_rest);
        balance.work.nodes.solves += 1;
        balance.find_all_nodes();
        balance.fit_skin();
        assert_eq!(balance.work.nodes.at, at);
        assert_eq!(skin(&balance), skin_at_rest);
    }
}
