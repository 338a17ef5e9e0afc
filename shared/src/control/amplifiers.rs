//! Whether the amplifiers take currents, from what the board says of them in every tick.
//!
//! Entry points: [`Amplifiers::judge`], [`Amplifiers::take_current`].

use crate::mutant::stands;

/// Longest time from arming until the amplifiers are ready \[ticks\]: 20 ms of pulses before they are enabled, and 500 ms in
/// which a servo amplifier checks itself and its supply.
const LONGEST_WAIT: u16 = 520;

/// The amplifiers of a console.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Amplifiers {
    /// Not asked for.
    Off,
    /// Asked for, so many ticks ago.
    Waking(u16),
    /// They take currents.
    On,
}

impl Amplifiers {
    /// One tick. `wanted`: the mode is one with torque; `unready`: the board says that they do not take currents. True if that
    /// is a fault: they had been ready, or have had their time. They are off then.
    pub fn judge(&mut self, wanted: bool, unready: bool) -> bool {
        let (next, fault) = match *self {
            _ if !wanted => (Amplifiers::Off, false),
            _ if !unready => (Amplifiers::On, false),
            Amplifiers::Off => (Amplifiers::Waking(0), false),
            Amplifiers::Waking(ticks) if ticks + 1 < LONGEST_WAIT => {
                (Amplifiers::Waking(ticks + 1), false)
            }
            Amplifiers::Waking(_) | Amplifiers::On => (Amplifiers::Off, self.must_be_ready()),
        };
        *self = next;
        fault
    }

    /// Whether it is a fault that they are not ready.
    #[inline(always)]
    fn must_be_ready(self) -> bool {
        match self {
            Amplifiers::On => stands("ready_kept"),
            _ => stands("ready_in_time"),
        }
    }

    /// Whether currents go to the motors.
    pub fn take_current(self) -> bool {
        self == Amplifiers::On || !stands("ready_first")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ready_amplifiers_take_current_in_the_tick_that_wants_it() {
        let mut amplifiers = Amplifiers::Off;
        assert!(!amplifiers.judge(true, false) && amplifiers.take_current());
        assert!(!amplifiers.judge(false, false) && !amplifiers.take_current());
    }

    #[test]
    fn nobody_asks_whether_amplifiers_are_ready_that_are_not_wanted() {
        let mut amplifiers = Amplifiers::Off;
        for _ in 0..10_000 {
            assert!(!amplifiers.judge(false, true) && !amplifiers.take_current());
        }
    }

    /// 20 ms of pulses and 500 ms of waking: ready in the tick 520 ms after the one that arms, or a fault in that.
    #[test]
    fn they_have_their_time_to_get_ready_and_no_more() {
        let mut amplifiers = Amplifiers::Off;
        for tick in 0..520 {
            assert!(!amplifiers.judge(true, true), "{tick}");
            assert!(!amplifiers.take_current());
        }
        let mut late = amplifiers;
        assert!(late.judge(true, true));
        assert!(!amplifiers.judge(true, false) && amplifiers.take_current());
    }

    #[test]
    fn ready_that_is_lost_is_a_fault_at_once_and_takes_the_current_away() {
        let mut amplifiers = Amplifiers::Off;
        amplifiers.judge(true, false);
        assert!(amplifiers.judge(true, true) && !amplifiers.take_current());
    }
}
