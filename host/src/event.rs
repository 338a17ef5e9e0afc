//! What happens at an instant, beside what a step balances: a thread slips through a grip, or breaks.
//!
//! Entry point: [`Event`]; [`crate::step::StepReport::events`] has those of a step.

use crate::thread::ThreadEnd;

/// Something that happened. What there is of a thread between its holds changes by what slips, and its length by what breaks off,
/// by nothing else.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum Event {
    /// A thread slipped through the grip of a tool, towards its middle.
    Slipped {
        /// Id of the thread.
        thread: u8,
        /// Which end is held there.
        end: ThreadEnd,
        /// Id of the tool.
        tool: u8,
        /// How much came through, unstretched \[m\].
        length_m: f64,
        /// Whether its end came through, so that the grip holds it no more.
        is_out: bool,
    },
    /// A thread broke where it was tensest; its tail is free there.
    Broke {
        /// Id of the thread.
        thread: u8,
        /// Tension there \[N\].
        tension_n: f64,
        /// What was behind that and is gone, unstretched \[m\].
        lost_m: f64,
    },
}
