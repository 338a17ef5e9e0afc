//! How a step on hyperelastic tissue began, for its later passes, and for one that finds no balance.
//!
//! Entry points: [`Kept::keep`], [`Kept::begin_again`], [`Kept::put_back`]. Every pass follows the whole way of the step on
//! its own linearisation: what rubs slides by how far it has come since the step began (an implicit Euler step), which a
//! pass that went on from the one before would not know.

use super::model::Needles;
use super::state::NeedleState;
use super::step::NeedlesState;
use crate::anchors::Grasp;
use crate::body::{Motion, Place};
use crate::collide::TouchState;
use crate::source::tool::ToolContacts;
use crate::thread::ThreadState;

/// All that evolves but the tissue's factor, in memory of its own.
pub(super) struct Kept {
    place: Place,
    rows: Grasp,
    each: Vec<NeedleState>,
    threads: Vec<ThreadState>,
    touch: Option<TouchState>,
    tools: ToolContacts,
}

impl Kept {
    /// Room for a state of these needles.
    pub fn new(needles: &Needles, state: &NeedlesState) -> Self {
        Self {
            place: Place::default(),
            rows: Grasp::new(Motion::default(), &needles.anchor_settings()),
            each: state.each.clone(),
            threads: state.threads.clone(),
            touch: state.touch.clone(),
            tools: ToolContacts::new(&needles.tools),
        }
    }

    /// Allocates the first time.
    pub fn keep(&mut self, state: &NeedlesState) {
        state.grasp.motion().keep(&mut self.place);
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
    }

    /// The state is as it was kept.
    pub fn put_back(&self, state: &mut NeedlesState) {
        state.grasp.go_back(&self.place);
        self.begin_again(state);
    }

    /// As [`Self::put_back`], with the tissue where it has come to.
    pub fn begin_again(&self, state: &mut NeedlesState) {
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
    }
}
