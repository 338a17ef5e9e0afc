//! What evolves as it was: before a balance that fails, before a step on tissue that is not linear.
//!
//! Entry points: [`Kept::keep`], [`Kept::put_back`]; [`Kept::keep_place`], [`Kept::put_back_place`]. Every pass of a step
//! on tissue that is not linear follows the whole way of the step on its own linearisation: what rubs slides by how far it has
//! come since the step began (an implicit Euler step), which a pass that went on from the one before would not know.

use super::sources::{Sources, SourcesState};
use crate::anchors::ConstraintState;
use crate::body::{Motion, Place};
use crate::collide::TouchState;
use crate::jaws::JawsState;
use crate::needle::NeedleState;
use crate::rod::{BarState, PairState};
use crate::source::Kept as Memory;
use crate::source::tool::ToolContacts;
use crate::thread::ThreadState;

/// All that evolves but the tissue's factor, in memory of its own.
pub(super) struct Kept {
    place: Place,
    rows: ConstraintState,
    each: Vec<NeedleState>,
    threads: Vec<ThreadState>,
    touch: Option<TouchState>,
    tools: ToolContacts,
    jaws: Vec<JawsState>,
    bars: Vec<BarState>,
    pairs: Vec<PairState>,
    memory: Vec<Memory>,
}

impl Kept {
    /// Room for a state of these sources, on tissue that moves like `motion`.
    pub fn new(sources: &Sources, state: &SourcesState, motion: Motion) -> Self {
        Self {
            place: Place::default(),
            rows: ConstraintState::new(motion, &sources.anchor_settings()),
            each: state.each.clone(),
            threads: state.threads.clone(),
            touch: state.touch.clone(),
            tools: ToolContacts::new(&sources.tools),
            jaws: state.jaws.clone(),
            bars: state.bars.clone(),
            pairs: state.pairs.clone(),
            memory: state.memory.clone(),
        }
    }

    /// Keeps all but where the tissue is.
    pub fn keep(&mut self, state: &SourcesState) {
        self.rows.copy_rows(&state.grasp);
        for (kept, each) in self.each.iter_mut().zip(&state.each) {
            kept.copy_from(each);
        }
        for (kept, thread) in self.threads.iter_mut().zip(&state.threads) {
            kept.copy_from(thread);
        }
        if let (Some(kept), Some(touch)) = (&mut self.touch, &state.touch) {
            kept.copy_from(touch);
        }
        self.tools.copy_from(&state.tools);
        for (kept, each) in self.jaws.iter_mut().zip(&state.jaws) {
            kept.copy_from(each);
        }
        for (kept, each) in self.bars.iter_mut().zip(&state.bars) {
            kept.copy_from(each);
        }
        self.pairs.copy_from_slice(&state.pairs);
        self.memory.copy_from_slice(&state.memory);
    }

    /// Keeps where tissue that is not linear is, too. Allocates the first time.
    pub fn keep_place(&mut self, state: &SourcesState) {
        state.grasp.motion().keep(&mut self.place);
        self.keep(state);
    }

    /// The state is as it was kept, but for the tissue.
    pub fn put_back(&self, state: &mut SourcesState) {
        state.grasp.copy_rows(&self.rows);
        for (each, kept) in state.each.iter_mut().zip(&self.each) {
            each.copy_from(kept);
        }
        for (thread, kept) in state.threads.iter_mut().zip(&self.threads) {
            thread.copy_from(kept);
        }
        if let (Some(touch), Some(kept)) = (&mut state.touch, &self.touch) {
            touch.copy_from(kept);
        }
        state.tools.copy_from(&self.tools);
        for (each, kept) in state.jaws.iter_mut().zip(&self.jaws) {
            each.copy_from(kept);
        }
        for (each, kept) in state.bars.iter_mut().zip(&self.bars) {
            each.copy_from(kept);
        }
        state.pairs.copy_from_slice(&self.pairs);
        state.memory.copy_from_slice(&self.memory);
    }

    /// As [`Self::put_back`], with tissue that is not linear where it was kept.
    pub fn put_back_place(&self, state: &mut SourcesState) {
        state.grasp.go_back(&self.place);
        self.put_back(state);
    }
}
