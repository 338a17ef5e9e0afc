//! What stops a console for good, in a held press.
//!
//! Entry points: [`Stop::spec`], [`force_after_n`].

use super::case::{Place, Question, Spec};
use super::hand::{Grasp, Motion};
use super::measure::length;
use super::run::Record;
use sutura_shared::control::Rendering;
use sutura_shared::device::JOINTS;

/// What stops it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stop {
    /// The emergency stop is pressed, and stays so.
    Pressed,
    /// An encoder says from now on that the grip is 6 mm deeper: 6 m/s.
    Jump,
    /// An encoder counts 98 too many in each of five ticks: 1.2 m/s, from one tick to the next.
    Burst,
    /// A host opens a session, and does not arm.
    Session,
}

/// All of them.
pub const STOPS: [Stop; 4] = [Stop::Pressed, Stop::Jump, Stop::Burst, Stop::Session];
/// When \[s\], and after what time no force may be left \[s\]: amplifiers need a few ticks.
pub const STOPS_AT_S: f64 = 1.0;
const GONE_AFTER_S: f64 = 0.01;
/// What the encoder is off \[counts\].
const JUMP: i32 = 500;
const BURST: (i32, f64) = (98, 5.0);

impl Stop {
    /// As tables print it.
    pub fn word(self) -> &'static str {
        match self {
            Stop::Pressed => "emergency-stop",
            Stop::Jump => "encoder-jump",
            Stop::Burst => "encoder-burst",
            Stop::Session => "new-session",
        }
    }

    /// Readings of the encoders, so long after the stop \[s\], while they should say `counts`, (3).
    pub(super) fn counts(
        stop: Option<Stop>,
        since_s: f64,
        mut counts: [i32; JOINTS],
    ) -> [i32; JOINTS] {
        counts[2] -= match stop {
            Some(Stop::Jump) => JUMP,
            Some(Stop::Burst) => BURST.0 * (since_s * 1e3 + 1.0).round().min(BURST.1) as i32,
            _ => 0,
        };
        counts
    }

    /// In a hold of the point of tissue by a rigid hand.
    pub fn spec(self) -> Spec {
        Spec {
            question: Question::Stop(self),
            grasp: Grasp::Rigid,
            seconds: 1.5,
            ..Spec::errors(Place::Point, Motion::Hold, Rendering::Rows, 60.0)
        }
    }
}

/// Largest command from 10 ms after the stop on \[N\].
pub fn force_after_n(record: &Record) -> f64 {
    let late = record
        .ticks
        .iter()
        .filter(|tick| tick.time_s >= STOPS_AT_S + GONE_AFTER_S);
    late.map(|tick| length(tick.command_n)).fold(0.0, f64::max)
}
