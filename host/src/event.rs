//! What happens at an instant, beside what a step balances: a thread slips through a grip or breaks, its knot opens, a hand takes hold of nothing.
//!
//! Entry point: [`Event`]; [`crate::step::StepReport::events`] has those of a step, [`crate::script::Script::take_missed`] those of scripts.

use crate::thread::ThreadEnd;
use serde::Serialize;

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
    /// A thread was cut. Both ends are free, or knotted.
    Cut {
        /// Id of the thread.
        thread: u8,
        /// Where on it, counted from the needle, at most 0 \[m\].
        along_m: f64,
    },
    /// A knot at the end of a thread opened: that is free.
    Opened {
        /// Id of the thread.
        thread: u8,
        /// Tension there \[N\].
        tension_n: f64,
    },
    /// A thread presses harder on tissue than that bears.
    Pressed {
        /// Id of the thread.
        thread: u8,
        /// What it presses with, where most \[Pa\].
        pressure_pa: f64,
        /// What tissue bears \[Pa\].
        tear_pa: f64,
    },
    /// Jaws took hold of tissue.
    Grasped {
        /// Id of the tool that carries them.
        tool: u8,
        /// How many points of it they hold.
        points: u32,
    },
    /// Jaws hold nothing although they are closed.
    Lost {
        /// Id of the tool that carries them.
        tool: u8,
        /// What has become of the tissue.
        why: Loss,
    },
    /// A tool was to take what is out of its reach. It is tried again in every step until the time of that hold ends; what held it
    /// before goes on meanwhile.
    Missed {
        /// Id of the tool.
        tool: u8,
        /// What it was to take.
        what: Held,
        /// How far it was from that \[m\].
        distance_m: f64,
        /// Where it would have had to be, give or take its reach \[m\], (3).
        nearest_m: [f64; 3],
    },
}

/// Why closed jaws hold nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum Loss {
    /// There was nothing between them.
    Nothing,
    /// It has slipped out.
    Slipped,
    /// It bore no more.
    Tore,
}

/// What a tool can hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Held {
    /// A needle, by its id.
    Needle(u8),
    /// An end of a thread, by its id.
    Thread(u8, ThreadEnd),
}
