//! Progress of a console by the states that can be used, and what came in their place.
//!
//! Entry points: [`Advance`] judges states by their ticks; [`Unusable`] counts frames and bytes between two states that count.

use std::fmt;
use std::time::Duration;
use sutura_shared::link::Counters;
use sutura_shared::wire::Reject;

/// Share of the ticks that are due in the time of a silence; a counter with fewer stands still.
const LEAST_SHARE: f64 = 0.05;

/// Judges whether the ticks of a console go on.
#[derive(Clone, Copy, Debug)]
pub struct Advance {
    /// Ticks from one state that counts to the next, at least.
    least: u32,
    mark: Option<u32>,
}

impl Advance {
    /// Ticks come `tick_hz` times a second, and `silent` without progress is a silence.
    pub fn new(tick_hz: u16, silent: Duration) -> Self {
        let due = LEAST_SHARE * f64::from(tick_hz) * silent.as_secs_f64();
        Advance {
            least: (due as u32).max(1),
            mark: None,
        }
    }

    /// Takes a state's tick. Whether it is so far from the last one that counted that this one counts.
    pub fn counts(&mut self, tick: u32) -> bool {
        let counts = self
            .mark
            .is_none_or(|mark| tick.wrapping_sub(mark) >= self.least);
        if counts {
            self.mark = Some(tick);
        }
        counts
    }
}

/// Counts states since the last one that [counted](Advance), and what came since the last state. Its text is the reason why none
/// counts.
#[derive(Clone, Debug, Default)]
pub struct Unusable {
    bytes: u64,
    /// Frames refused, by reason, the newest kind last.
    refused: Vec<(Reject, u32)>,
    /// The same since the link's first session began.
    all: Vec<(Reject, u32)>,
    /// Refused frames that the link's end had counted before.
    known: u32,
    /// States since the one that counted; ticks of that one and of the newest.
    standing: u32,
    from: u32,
    tick: u32,
    /// Good frames besides states.
    others: u32,
}

impl Unusable {
    /// Adds bytes.
    pub fn bytes(&mut self, count: usize) {
        self.bytes += count as u64;
    }

    /// Adds what the link's end has refused since it was looked at last.
    pub fn look(&mut self, counters: &Counters) {
        let new = counters.frames_rejected.wrapping_sub(self.known);
        self.known = counters.frames_rejected;
        let Some(reject) = counters.last_reject.filter(|_| new > 0) else {
            return;
        };
        for refused in [&mut self.refused, &mut self.all] {
            match refused.iter_mut().find(|(kind, _)| *kind == reject) {
                Some((_, count)) => *count = count.saturating_add(new),
                None => refused.push((reject, new)),
            }
        }
    }

    /// Returns the reason for which most frames were refused in all sessions, and how many.
    pub fn refused_most(&self) -> Option<(Reject, u32)> {
        most(&self.all)
    }

    /// Begins anew for another session, whose end has counted nothing.
    pub fn begin(&mut self) {
        *self = Unusable {
            all: std::mem::take(&mut self.all),
            ..Unusable::default()
        };
    }

    /// Adds a state that did not count.
    pub fn stood(&mut self, tick: u32) {
        self.forget();
        (self.standing, self.tick) = (self.standing.saturating_add(1), tick);
    }

    /// Adds another good frame.
    pub fn other(&mut self) {
        self.others = self.others.saturating_add(1);
    }

    /// Begins anew after a state that counted.
    pub fn counted(&mut self, tick: u32) {
        self.forget();
        (self.standing, self.from, self.tick) = (0, tick, tick);
    }

    /// Whether the peer sent frames, and they were refused.
    pub fn is_refused(&self) -> bool {
        !self.stands_still() && !self.refused.is_empty()
    }

    /// Whether there were more states than ticks. A console that is gone in the midst of its states has one a tick.
    fn stands_still(&self) -> bool {
        self.standing > self.tick.wrapping_sub(self.from)
    }

    fn forget(&mut self) {
        self.refused.clear();
        (self.bytes, self.others) = (0, 0);
    }
}

impl fmt::Display for Unusable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Unusable { standing, tick, .. } = self;
        if self.stands_still() {
            return write!(f, "its ticks stand still: {standing} states at tick {tick}");
        }
        let refused = self.refused.iter().map(|(_, count)| *count);
        let refused = refused.fold(0, u32::saturating_add);
        match most(&self.refused) {
            Some((reject, count)) if count == refused => {
                write!(f, "{refused} frames were refused: {reject}")
            }
            Some((reject, count)) => {
                write!(
                    f,
                    "{refused} frames were refused, {count} of them: {reject}"
                )
            }
            None if self.others > 0 && self.standing > 0 => {
                write!(f, "its ticks crawl: {standing} states up to tick {tick}")
            }
            None if self.others > 0 => {
                write!(f, "{} other messages came", self.others)
            }
            None if self.bytes > 0 => write!(f, "{} bytes came, no whole frame", self.bytes),
            None => f.write_str("nothing came"),
        }
    }
}

/// The reason that came most.
fn most(refused: &[(Reject, u32)]) -> Option<(Reject, u32)> {
    refused.iter().max_by_key(|(_, count)| *count).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A twentieth of the ticks that are due is progress, less is none; a counter that wraps or starts anew goes on.
    #[test]
    fn ticks_that_crawl_stand_still() {
        let mut advance = Advance::new(1000, Duration::from_secs(2));
        let counted = |advance: &mut Advance, ticks: &[u32]| {
            let counted = ticks.iter().map(|tick| advance.counts(*tick));
            counted.collect::<Vec<_>>()
        };
        assert_eq!(
            counted(&mut advance, &[7, 7, 8, 106, 107, 108]),
            [true, false, false, false, true, false]
        );
        assert_eq!(counted(&mut advance, &[0, 99, 100]), [true, false, true]);
        assert_eq!(
            counted(&mut advance, &[u32::MAX, 98, 99]),
            [true, false, true]
        );
        // Once a second is too rare for a counter of 1 kHz, and enough for a slow one.
        let mut slow = Advance::new(1, Duration::from_secs(2));
        assert_eq!(counted(&mut slow, &[0, 1, 1]), [true, true, false]);
    }

    #[test]
    fn the_reason_is_the_kind_that_came_most() {
        let mut unusable = Unusable::default();
        assert_eq!(unusable.to_string(), "nothing came");
        unusable.bytes(400);
        assert_eq!(unusable.to_string(), "400 bytes came, no whole frame");
        unusable.other();
        assert_eq!(unusable.to_string(), "1 other messages came");
        let mut counters = Counters::default();
        let mut refuse = |unusable: &mut Unusable, times: u32, reject| {
            counters.frames_rejected += times;
            counters.last_reject = Some(reject);
            unusable.look(&counters);
            unusable.look(&counters);
        };
        refuse(&mut unusable, 12, Reject::NotFinite);
        assert_eq!(
            unusable.to_string(),
            "12 frames were refused: a number is not finite"
        );
        refuse(&mut unusable, 30, Reject::Sequence);
        assert_eq!(
            unusable.to_string(),
            "42 frames were refused, 30 of them: duplicate or out of order"
        );
        assert!(unusable.is_refused());
        unusable.counted(17);
        assert_eq!(unusable.to_string(), "nothing came");
        assert_eq!(unusable.refused_most(), Some((Reject::Sequence, 30)));
        unusable.stood(17);
        unusable.stood(18);
        assert!(!unusable.is_refused());
        assert_eq!(
            unusable.to_string(),
            "its ticks stand still: 2 states at tick 18"
        );
        // Gone in the midst of its states.
        unusable.counted(19);
        unusable.stood(20);
        unusable.stood(21);
        assert_eq!(unusable.to_string(), "nothing came");
        unusable.other();
        assert_eq!(
            unusable.to_string(),
            "its ticks crawl: 2 states up to tick 21"
        );
    }
}
