//! The solver's thread as the wire carries it: f32, within the wire's limits.
//!
//! Entry point: [`thread_frame`].

use super::contact_frame::GRIP;
use crate::step::StepReport;
use crate::thread::{ThreadReport, ThreadTension};
use sutura_shared::wire::message::{End, Tension, Thread};
use sutura_shared::wire::validate::{MAX_POSITION, MAX_TANGENT, MAX_WRENCH};

/// A thread that the driven tool holds, by itself or by its needle, as a step left it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeldThread {
    /// Tool that holds it.
    pub tool: u8,
    /// Id of the thread.
    pub thread: u8,
    /// Which end.
    pub end: End,
    /// Whether it pulls.
    pub state: Tension,
    /// Unit vector along which it pulls the grip, (3), world frame; zero where its path has no direction.
    pub direction: [f64; 3],
    /// Force with which it pulls \[N\].
    pub tension_n: f64,
    /// Tension gained per metre that the grip moves against `direction` \[N/m\].
    pub stiffness_n_per_m: f64,
    /// What there is of it more than its path needs \[m\].
    pub slack_m: f64,
}

impl HeldThread {
    /// The thread that pulls at the grip of `driven`, for the wire; of a thread with both ends there, its head. Between the ends it is that
    /// side of the hand that pulls harder, or has less slack, which is the head of what is there and on the other side the tail.
    pub(super) fn at_grip(report: &StepReport, driven: u8) -> Option<Self> {
        Self::at_end(report, driven).or_else(|| Self::between_ends(report, driven))
    }

    fn between_ends(report: &StepReport, driven: u8) -> Option<Self> {
        let hand = report
            .hands()
            .iter()
            .find(|hand| hand.tool == Some(driven))?;
        let [before, after] = hand.tension_n;
        let is_tail = after > before || (after == before && hand.slack_m[1] < hand.slack_m[0]);
        let side = usize::from(is_tail);
        let tension_n = hand.tension_n[side];
        Some(Self {
            tool: driven,
            thread: hand.thread,
            end: [End::Head, End::Tail][side],
            state: if tension_n > 0.0 {
                Tension::Taut
            } else {
                Tension::Slack
            },
            direction: hand.direction[side],
            tension_n,
            stiffness_n_per_m: along(report, driven, &hand.direction[side]),
            slack_m: hand.slack_m[side],
        })
    }

    fn at_end(report: &StepReport, driven: u8) -> Option<Self> {
        let at = |thread: &ThreadReport, end: usize| thread.held_by[end] == Some(driven);
        let [tail, head] = [0, 1];
        let threads = report.threads();
        let thread = threads.iter().find(|t| at(t, head) || at(t, tail))?;
        let end = if at(thread, head) { head } else { tail };
        Some(Self {
            tool: driven,
            thread: thread.id,
            end: [End::Tail, End::Head][end],
            state: match thread.end_state[end] {
                ThreadTension::Slack => Tension::Slack,
                ThreadTension::Taut => Tension::Taut,
            },
            direction: thread.direction[end],
            tension_n: thread.tension_n[end],
            stiffness_n_per_m: along(report, driven, &thread.direction[end]),
            slack_m: thread.slack_m[end],
        })
    }
}

/// How much a force along `direction` grows per metre that the grip of `driven` moves against it \[N/m\]: the tangent's
/// part along it, which turning does not change.
fn along(report: &StepReport, driven: u8, direction: &[f64; 3]) -> f64 {
    let contact = report
        .contacts()
        .iter()
        .find(|contact| contact.id == driven);
    contact.map_or(0.0, |contact| {
        let rows = contact.tangent.iter().zip(direction);
        let changes = rows.map(|(row, n)| n * (0..3).map(|i| row[i] * direction[i]).sum::<f64>());
        -changes.sum::<f64>()
    })
}

/// The frame for the state that `thread` was solved for.
pub fn thread_frame(thread: &HeldThread) -> Thread {
    let limited = |value: f64, most: f32| (value as f32).clamp(0.0, most);
    let direction = thread.direction.map(|value| value as f32);
    let is_slack = thread.state == Tension::Slack;
    Thread {
        tool: GRIP,
        thread: thread.thread,
        end: thread.end,
        state: thread.state,
        // Nothing to pull along: any direction is as good.
        direction: if direction == [0.0; 3] {
            [0.0, 0.0, 1.0]
        } else {
            direction
        },
        // Round-off of what is slack; what is not a number stays that, and is not sent.
        tension_n: if is_slack && thread.tension_n.is_finite() {
            0.0
        } else {
            limited(thread.tension_n, MAX_WRENCH)
        },
        stiffness_n_per_m: limited(thread.stiffness_n_per_m, MAX_TANGENT),
        slack_m: if is_slack {
            limited(thread.slack_m, MAX_POSITION)
        } else {
            0.0
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::thread::HandReport;
    use sutura_shared::wire::{Message, Reject};

    const TAUT: HeldThread = HeldThread {
        tool: 0,
        thread: 2,
        end: End::Head,
        state: Tension::Taut,
        direction: [0.6, 0.0, -0.8],
        tension_n: 0.5,
        stiffness_n_per_m: 300.0,
        slack_m: -1e-15,
    };

    /// Of both sides of a hand the console is told the one that pulls harder, or will sooner.
    #[test]
    fn between_the_ends_a_hand_is_told_one_side() {
        let told = |report: &StepReport| {
            let held = HeldThread::at_grip(report, 3).expect("a thread");
            (
                held.end,
                held.state,
                held.direction,
                held.tension_n,
                held.slack_m,
            )
        };
        let direction = [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]];
        for (tension_n, slack_m, side) in [
            ([0.5, 0.2], [0.0, 0.0], 0),
            ([0.2, 0.5], [0.0, 0.0], 1),
            ([0.0, 0.0], [0.01, 0.002], 1),
            ([0.0, 0.0], [0.001, 0.002], 0),
        ] {
            let mut report = StepReport::default();
            report.held(HandReport {
                tool: Some(3),
                tension_n,
                slack_m,
                direction,
                ..HandReport::default()
            });
            let state = if tension_n[side] > 0.0 {
                Tension::Taut
            } else {
                Tension::Slack
            };
            let end = [End::Head, End::Tail][side];
            let expected = (end, state, direction[side], tension_n[side], slack_m[side]);
            assert_eq!(told(&report), expected);
            assert_eq!(HeldThread::at_grip(&report, 0), None);
        }
    }

    #[test]
    fn the_frame_passes_the_consoles_own_check() {
        let frame = thread_frame(&TAUT);
        assert_eq!(frame.check(), Ok(()));
        assert_eq!(frame.thread, 2);
        assert_eq!((frame.end, frame.state), (End::Head, Tension::Taut));
        assert_eq!(frame.direction, [0.6, 0.0, -0.8]);
        let numbers = [frame.tension_n, frame.stiffness_n_per_m, frame.slack_m];
        assert_eq!(numbers, [0.5, 300.0, 0.0]);
    }

    #[test]
    fn what_is_slack_does_not_pull_and_says_how_far_it_is_from_that() {
        let slack = HeldThread {
            state: Tension::Slack,
            direction: [0.0; 3],
            tension_n: 1e-18,
            slack_m: 0.25,
            ..TAUT
        };
        let frame = thread_frame(&slack);
        assert_eq!(frame.check(), Ok(()));
        assert_eq!((frame.tension_n, frame.slack_m), (0.0, 0.25));
    }

    #[test]
    fn nonsense_is_not_sent() {
        for bad in [
            HeldThread {
                tension_n: f64::NAN,
                ..TAUT
            },
            HeldThread {
                state: Tension::Slack,
                tension_n: f64::NAN,
                ..TAUT
            },
            HeldThread {
                stiffness_n_per_m: f64::NAN,
                ..TAUT
            },
            HeldThread {
                direction: [f64::NAN, 0.0, 1.0],
                ..TAUT
            },
        ] {
            let frame = thread_frame(&bad);
            assert_eq!(frame.check(), Err(Reject::NotFinite), "{bad:?}");
        }
    }
}
