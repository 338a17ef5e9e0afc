//! What evolves from step to step.
//!
//! Entry point: [`State`].

use super::sources::SourcesState;
use super::targets::pose_of;
use crate::anchors::ConstraintState;
use crate::body::Motion;
use crate::hash::hash_of;
use crate::jaws::Grasped;
use crate::model::Model;
use crate::needle::{self, Grip};
use crate::rod::PairState;
use crate::thread::{
    Bridge, Obstacle, ThreadEnd, ThreadHold, ThreadPlace, ThreadPoint, Tightening, nearest_outside,
};
use crate::tool::{Act, ToolSample};
use nalgebra::{Isometry3, Vector3};
use serde::Serialize;

/// What evolves.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct State {
    /// What evolves in the tissue itself, if nothing acts on it but loads and handles.
    motion: Motion,
    pub(crate) sources: Option<Box<SourcesState>>,
}

impl State {
    /// Hash of everything that it holds, to the bit.
    pub fn hash(&self) -> u64 {
        hash_of(self)
    }

    /// No tool anywhere yet, tissue at rest under its loads.
    pub fn new(model: &Model) -> Self {
        Self::moving(model, &model.motion)
    }

    /// As [`Self::new`], with tissue as the unloaded mesh has it where steps bring it to rest: linear tissue is there with the
    /// first one, and without anything that may act no step moves any.
    pub fn unloaded(model: &Model) -> Self {
        match model.sources {
            Some(_) => Self::moving(model, &model.body.at_rest()),
            None => Self::new(model),
        }
    }

    fn moving(model: &Model, motion: &Motion) -> Self {
        let sources = model.sources.as_ref();
        Self {
            motion: motion.clone(),
            sources: sources.map(|sources| Box::new(SourcesState::new(sources, motion.clone()))),
        }
    }

    /// Rows of needles, threads, handles and tissues that touch, and their forces.
    pub(crate) fn grasp(&self) -> Option<&ConstraintState> {
        self.sources.as_ref().map(|needles| &needles.grasp)
    }

    pub(crate) fn motion(&self) -> &Motion {
        let sources = self.sources.as_ref();
        sources.map_or(&self.motion, |sources| sources.grasp.motion())
    }

    /// Has a tool take a needle where it is, with the tool at `sample`; or nobody. Nothing moves and no force
    /// changes by that; a needle that nobody holds goes where the tissue takes it in later steps. Says
    /// whether there are such a needle and tool, and the sample is a pose.
    pub fn hold(&mut self, model: &Model, needle: u8, sample: Option<&ToolSample>) -> bool {
        let (Some(sources), Some(state)) = (&model.sources, &mut self.sources) else {
            return false;
        };
        let index = sources.needles.iter().position(|part| part.id == needle);
        let Some(each) = index.and_then(|index| state.each.get_mut(index)) else {
            return false;
        };
        let Some(sample) = sample else {
            each.grip = None;
            return true;
        };
        match pose_of(sample).filter(|_| model.tool(sample.id).is_some()) {
            Some(pose) => {
                each.grip = Some(Grip::new(sample.id, &pose, &each.pose));
                true
            }
            None => false,
        }
    }

    /// Puts the needles that a tool holds to where they are with it at `sample`, without the way there: for a tool that was
    /// moved while nobody looked. One that is then in tissue is in no hole and touches nothing until all of it has been
    /// outside once ([`needle::TipPlace::Waiting`]). One that was in tissue before stays in its holes, and follows in the next
    /// step as always. Its body is put likewise. Says how many needles were put.
    pub fn put(&mut self, sample: &ToolSample) -> usize {
        let Some(pose) = pose_of(sample) else {
            return 0;
        };
        let Some(sources) = &mut self.sources else {
            return 0;
        };
        let mut put = 0;
        for (needle, each) in sources.each.iter_mut().enumerate() {
            let grip = each.grip.filter(|grip| grip.tool == sample.id);
            let is_put = grip.is_some_and(|grip| each.put(pose * grip.needle));
            put += usize::from(is_put);
            let threads = sources.threads.iter_mut().filter(|_| is_put);
            threads.for_each(|thread| thread.forget_laps(Obstacle::Needle(needle)));
            let own = |pair: &&mut PairState| is_put && pair.has(Obstacle::Needle(needle));
            sources
                .pairs
                .iter_mut()
                .filter(own)
                .for_each(PairState::forget);
        }
        let bar = sources.bars.iter().position(|bar| bar.tool == sample.id);
        if let Some(bar) = bar {
            sources.bars[bar].put(pose);
            let threads = sources.threads.iter_mut();
            threads.for_each(|thread| thread.forget_laps(Obstacle::Bar(bar)));
            let own = |pair: &&mut PairState| pair.has(Obstacle::Bar(bar));
            sources
                .pairs
                .iter_mut()
                .filter(own)
                .for_each(PairState::forget);
        }
        put
    }

    /// Has the jaws of a tool close, or open. They take hold of what is between them at the end of the next step that has the
    /// columns for it, where the tool and the tissue are then: nothing moves and no force changes by that. Open jaws hold
    /// nothing at once. Says whether the tool has jaws.
    pub fn act(&mut self, model: &Model, act: Act) -> bool {
        let (tool, closed) = match act {
            Act::Close(tool) => (tool, true),
            Act::Open(tool) => (tool, false),
        };
        let found = model.sources.as_ref().zip(self.sources.as_mut());
        let jaws = found.and_then(|(sources, state)| {
            let index = sources.jaws_of(tool)?;
            state.jaws.get_mut(index)
        });
        jaws.map(|jaws| jaws.close(closed)).is_some()
    }

    /// Where the last step has a tool that was sampled at `sample`: there, or, where its status was [`super::Status::Behind`], as far on
    /// the way as that has come, by what the tool carries.
    pub fn reached(&self, model: &Model, sample: &ToolSample) -> ToolSample {
        let found = self.sources.as_ref().zip(model.sources.as_ref());
        found.map_or(*sample, |(state, sources)| {
            state.reached(model, sources, sample)
        })
    }

    /// The points that the jaws of a tool hold.
    pub fn grasped(&self, model: &Model, tool: u8) -> &[Grasped] {
        let found = model.sources.as_ref().zip(self.sources.as_ref());
        let jaws = found.and_then(|(sources, state)| state.jaws.get(sources.jaws_of(tool)?));
        jaws.map_or(&[], |jaws| &jaws.points)
    }

    /// Where a needle is: its frame, as [`crate::needle::NeedleShape`] has it.
    pub fn needle_pose(&self, model: &Model, needle: u8) -> Option<Isometry3<f64>> {
        let parts = &model.sources.as_ref()?.needles;
        let index = parts.iter().position(|part| part.id == needle)?;
        Some(self.sources.as_ref()?.each.get(index)?.pose)
    }

    /// The point of a needle's centre line that is nearest to a place \[m\], (3); `None` if there is no such needle.
    pub fn nearest_of_needle(&self, model: &Model, needle: u8, to: &[f64; 3]) -> Option<[f64; 3]> {
        let parts = &model.sources.as_ref()?.needles;
        let part = parts.iter().find(|part| part.id == needle)?;
        let curve = part.needle.at(&self.needle_pose(model, needle)?);
        Some(curve.nearest(&Vector3::from(*to)).into())
    }

    /// The point near an end of a thread that is nearest to a place \[m\], (3): of the straight way from the outermost face that it goes
    /// through to what holds that end, of a free tail that face alone, as where it hangs the balance does not know; without a
    /// face the needle's end; of a span, of all straight ways outside. `None` if there is no such thread. Solves for all nodes.
    pub fn nearest_of_thread(
        &self,
        model: &Model,
        thread: u8,
        end: ThreadEnd,
        to: &[f64; 3],
    ) -> Option<[f64; 3]> {
        let path = self.thread_path(model, thread, &self.positions(model));
        let outer = |point: &ThreadPoint| Vector3::from(point.at_m);
        if end == ThreadEnd::Span {
            let nearest = nearest_outside(&path, &Vector3::from(*to), false);
            return nearest.map(|nearest| nearest.at.into());
        }
        let pair = match end {
            ThreadEnd::Tail => path.iter().take(2).map(outer).collect::<Vec<_>>(),
            ThreadEnd::Head | ThreadEnd::Span => path.iter().rev().take(2).map(outer).collect(),
        };
        let (first, next) = (*pair.first()?, pair.last()?);
        // A free tail ends at a face.
        let is_held = end == ThreadEnd::Head || path.first()?.what == ThreadPlace::End;
        let way = if is_held {
            next - first
        } else {
            Vector3::zeros()
        };
        let share = way.dot(&(Vector3::from(*to) - first)) / way.norm_squared();
        let share = if share.is_finite() {
            share.clamp(0.0, 1.0)
        } else {
            0.0
        };
        Some((first + way * share).into())
    }

    /// The faces that a needle goes through, from its end to its tip.
    pub fn crossings(&self, model: &Model, needle: u8) -> &[needle::Crossing] {
        let history = self.needle_history(model, needle);
        history.map_or(&[], needle::History::crossings)
    }

    /// The faces that a thread goes through, from its tail to its head, alpha from there: at most 0.
    pub fn thread_crossings(
        &self,
        model: &Model,
        thread: u8,
    ) -> impl Iterator<Item = &needle::Crossing> {
        let sources = self.sources.as_ref().zip(model.thread(thread));
        let strands = sources.into_iter().flat_map(|(state, index)| {
            let strands = state.strands(index).iter();
            strands.map(|strand| &state.threads[strand])
        });
        strands.flat_map(|strand| strand.passed.iter().map(|passed| &passed.crossing))
    }

    /// The way of a needle through the mesh.
    pub fn needle_history(&self, model: &Model, needle: u8) -> Option<&needle::History> {
        let parts = &model.sources.as_ref()?.needles;
        let index = parts.iter().position(|part| part.id == needle)?;
        Some(&self.sources.as_ref()?.each.get(index)?.history)
    }

    /// Has an end of a thread, or a span, held by something else from now on. A span that is taut is held where it is, and moves with
    /// the tool; what is slack comes to the hand. Says whether there is such a thread and such a tool among `samples`, and room for
    /// another hand.
    pub fn hold_thread(
        &mut self,
        model: &Model,
        thread: u8,
        end: ThreadEnd,
        hold: ThreadHold,
        samples: &[ToolSample],
    ) -> bool {
        let nodes_m = self.positions(model);
        let (Some(sources), Some(state)) = (&model.sources, &mut self.sources) else {
            return false;
        };
        let Some(thread) = model.thread(thread) else {
            return false;
        };
        let tool = |id: u8| samples.iter().find(|sample| sample.id == id);
        let pose = match hold {
            ThreadHold::Free | ThreadHold::Knot | ThreadHold::Without(_) => None,
            ThreadHold::Place([x, y, z]) => Some(Isometry3::translation(x, y, z)),
            ThreadHold::Tool(id) => match tool(id).and_then(pose_of) {
                Some(pose) => Some(pose),
                None => return false,
            },
        };
        let is_finite = |at: &Vector3<f64>| at.iter().all(|x| x.is_finite());
        let is_sound = pose.is_none_or(|pose| is_finite(&pose.translation.vector));
        is_sound && state.hold_thread(sources, &nodes_m, thread, end, hold, pose)
    }

    /// Cuts a thread outside the tissue, where it is nearest to a place \[m\], (3). Both ends are free; with `knots` each has one that is too
    /// thick for a puncture: before the cut at the last face, behind it at the cut. Says whether there is something to cut, and room
    /// for another strand.
    pub fn cut_thread(&mut self, model: &Model, thread: u8, at_m: &[f64; 3], knots: bool) -> bool {
        let nodes_m = self.positions(model);
        let found = model.sources.as_ref().zip(self.sources.as_mut());
        let Some(((sources, state), thread)) = found.zip(model.thread(thread)) else {
            return false;
        };
        let at = Vector3::from(*at_m);
        at.iter().all(|x| x.is_finite()) && state.cut_thread(sources, &nodes_m, thread, &at, knots)
    }

    /// Has hands tighten every span of a thread that bridges two bodies of tissue (every one between punctures, if there is only one
    /// body): each holds its span where that goes into the tissue on the way to the head, and takes in what there is of thread in it
    /// beyond a part of its length in the unloaded mesh. With `None` they let go, and what they have taken in is thread of their spans again.
    /// Says whether there is such a thread and the numbers make sense.
    pub fn tighten(&mut self, model: &Model, thread: u8, to: Option<Tightening>) -> bool {
        let index = model.thread(thread);
        let Some((state, index)) = self.sources.as_mut().zip(index) else {
            return false;
        };
        let is_sound = to.is_none_or(|to| to.is_sound());
        if is_sound {
            state.tighten_thread(index, to);
        }
        is_sound
    }

    /// Draws every span of a thread that bridges two bodies of tissue together to a part of its length in the unloaded mesh, without thread
    /// (younes-2021, 3.37): a figure of its punctures. Whether there is such a thread.
    pub(crate) fn weld(&mut self, model: &Model, thread: u8, ratio: f64) -> bool {
        let index = model.thread(thread);
        let Some((state, index)) = self.sources.as_mut().zip(index) else {
            return false;
        };
        for strand in state.strands(index).iter() {
            state.threads[strand].welded = Some(ratio);
        }
        true
    }

    /// Tissue at rest and threads that nothing holds, through the faces that they go through in this state; nothing else of it.
    pub(crate) fn sewn_at_rest(&self, model: &Model) -> Self {
        let mut anew = Self::new(model);
        let states = anew.sources.as_mut().zip(self.sources.as_ref());
        let (Some((anew_of, own_of)), Some(sources)) = (states, &model.sources) else {
            return anew;
        };
        let at = |crossing: &needle::Crossing| {
            let anchor = needle::anchor(&sources.mesh, crossing);
            let parts = anchor.nodes.iter().zip(anchor.weights);
            let places = parts.filter_map(|(node, weight)| {
                Some(Vector3::from(*model.points_m().get(*node as usize)?) * weight)
            });
            places.sum::<Vector3<f64>>()
        };
        for thread in 0..sources.threads.parts.len() {
            // From the needle on, piece by piece.
            let mut place = thread;
            for (index, own) in own_of.joined(thread).into_iter().rev().enumerate() {
                if index > 0 {
                    let Some(room) = anew_of.room(sources, thread) else {
                        break;
                    };
                    anew_of.threads[place].before = Some(room);
                    anew_of.threads[room].is_used = true;
                    place = room;
                }
                let thread = &mut anew_of.threads[place];
                // Straight between faces; of a thread that is shorter than that, in proportion.
                let mut last: Option<Vector3<f64>> = None;
                let mut gone_m = 0.0;
                for passed in &own.passed {
                    let here = at(&passed.crossing);
                    gone_m += last.map_or(0.0, |last| here.metric_distance(&last));
                    last = Some(here);
                    let mut passed = *passed;
                    passed.crossing.alpha = gone_m;
                    thread.passed.push(passed);
                }
                let scale = (-thread.tail.alpha / gone_m).min(1.0);
                for passed in &mut thread.passed {
                    passed.crossing.alpha = scale * (passed.crossing.alpha - gone_m);
                }
            }
        }
        anew
    }

    /// The path of a thread, from tail to head, with all nodes at `nodes_m` (n x 3), see [`State::positions`]; for viewers
    /// and files.
    pub fn thread_path(&self, model: &Model, thread: u8, nodes_m: &[[f64; 3]]) -> Vec<ThreadPoint> {
        let index = model.thread(thread);
        let found = self.sources.as_ref().zip(model.sources.as_ref()).zip(index);
        found.map_or_else(Vec::new, |((state, sources), index)| {
            state.thread_path(sources, nodes_m, index)
        })
    }

    /// What a thread closes, or not: its spans between two bodies of tissue, with all nodes at `nodes_m` (n x 3).
    pub fn bridges(&self, model: &Model, thread: u8, nodes_m: &[[f64; 3]]) -> Vec<Bridge> {
        let index = model.thread(thread);
        let found = self.sources.as_ref().zip(model.sources.as_ref()).zip(index);
        found.map_or_else(Vec::new, |((state, sources), index)| {
            state.bridges(sources, model, nodes_m, index)
        })
    }

    /// What a thread presses on tissue at each of its passages, from the tail on: the normal force
    /// of its turn per length and thickness \[Pa\].
    pub fn thread_pressures_pa(&self, model: &Model, thread: u8) -> Vec<f64> {
        let index = model.thread(thread);
        let found = self.sources.as_ref().zip(model.sources.as_ref()).zip(index);
        found.map_or_else(Vec::new, |((state, sources), index)| {
            state.thread_pressures_pa(sources, index)
        })
    }

    /// As a copy of `other`, a state of the same model, without new memory: of all that can be seen of it. Nothing goes on from
    /// it, as the factor of its tissue's tangent stays.
    pub(crate) fn see(&mut self, other: &Self) {
        self.motion.see(&other.motion);
        if let (Some(own), Some(other)) = (&mut self.sources, &other.sources) {
            own.see(other);
        }
    }

    /// Where all nodes are \[m\], (n x 3): allocates, for files and viewers.
    pub fn positions(&self, model: &Model) -> Vec<[f64; 3]> {
        let moved = model.displacement_m(self);
        let moved = moved.unwrap_or_else(|_| vec![[0.0; 3]; model.points_m().len()]);
        let nodes = model.points_m().iter().zip(&moved);
        nodes
            .map(|(x, u)| [x[0] + u[0], x[1] + u[1], x[2] + u[2]])
            .collect()
    }

    /// What rubs at each of [`State::crossings`], in their order.
    pub fn rubbing(
        &self,
        model: &Model,
        needle: u8,
    ) -> impl Iterator<Item = needle::CrossingFriction> {
        let found = || {
            let parts = &model.sources.as_ref()?.needles;
            let index = parts.iter().position(|part| part.id == needle)?;
            let curve = |each: &needle::NeedleState| parts[index].needle.at(&each.pose);
            let each = self.sources.as_ref()?.each.get(index)?;
            Some((each, curve(each)))
        };
        found()
            .into_iter()
            .flat_map(|(each, curve)| each.rubbing(curve))
    }

    /// What sources that the scene adds by keys of their own report: the name of each, and values with units in their
    /// names.
    pub fn added(&self, model: &Model) -> Vec<(String, Vec<(&'static str, f64)>)> {
        let found = self.sources.iter().zip(&model.sources);
        let each = found.flat_map(|(state, sources)| sources.added.iter().zip(&state.memory));
        each.map(|(added, kept)| (added.explain().0, added.values(kept)))
            .collect()
    }

    /// Prescribed nodes that constraints act on, and the force on the tissue there \[N\]; a node may come more than once.
    pub fn forces_on_prescribed(&self) -> impl Iterator<Item = (u32, [f64; 3])> {
        let forces = self
            .grasp()
            .into_iter()
            .flat_map(ConstraintState::on_prescribed);
        forces.map(|(node, force)| (node, force.into()))
    }

    /// Nodes that are touched and the force on the tissue there \[N\]; a node touched by two tools comes
    /// twice.
    pub fn contact_forces(&self, model: &Model) -> impl Iterator<Item = (u32, [f64; 3])> {
        let found = self.sources.iter().zip(&model.sources);
        found.flat_map(|(state, sources)| {
            let pushes = state.grasp.pushes();
            let pushes = pushes.filter(|(_, force)| *force != Vector3::zeros());
            pushes
                .filter_map(|(vertex, force)| Some((model.node_of(sources, vertex)?, force.into())))
        })
    }
}
