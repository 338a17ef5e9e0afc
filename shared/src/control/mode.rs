//! What the console may do: orders from the host, latched faults, and the mode that follows.
//!
//! Entry points: [`Orders::command`], [`Faults::latch`], [`next_mode`].

use super::contact::Freshness;
use crate::mutant::stands;
use crate::wire::faults;
use crate::wire::message::{Command, Mode};

/// What the host has asked for since the last tick. Of two orders the later one counts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Orders {
    pub clear: bool,
    pub disarm: bool,
    pub arm: bool,
}

impl Orders {
    /// Adds an order.
    pub fn command(&mut self, command: Command) {
        match command {
            Command::Arm => self.arm = true,
            Command::Disarm => (self.disarm, self.arm) = (true, false),
            Command::ClearFault => (self.clear, self.arm) = (true, false),
            // The link's business.
            Command::StateEvery { .. } => {}
        }
    }
}

/// The mode of this tick, from the last tick's.
///
/// `started`: a complete tick has been run; `faults`: latched and not cleared.
pub(super) fn next_mode(
    mode: Mode,
    orders: Orders,
    faults: u16,
    started: bool,
    contact: Freshness,
) -> Mode {
    if faults != 0 && stands("fault_wins") {
        return Mode::Fault;
    }
    let mode = match mode {
        Mode::Boot if !started => return Mode::Boot,
        Mode::Boot | Mode::Fault => Mode::Idle,
        _ if orders.disarm => Mode::Idle,
        other => other,
    };
    match (mode, contact) {
        (Mode::Idle, _) if orders.arm => Mode::Armed,
        (Mode::Armed | Mode::Decaying, Freshness::Lost) => Mode::Idle,
        (Mode::Armed | Mode::Decaying, Freshness::Stale) => Mode::Decaying,
        (Mode::Decaying, Freshness::Fresh | Freshness::Missing) => Mode::Armed,
        (other, _) => other,
    }
}

/// Whether the amplifiers are on.
pub(super) fn has_torque(mode: Mode) -> bool {
    matches!(mode, Mode::Armed | Mode::Decaying)
}

/// Faults, from their causes until the host clears them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Faults {
    latched: u16,
    /// Ticks in a row that took longer than their period.
    overruns: u32,
}

/// So many overruns in a row are a fault: one or two can be a burst on the bus, three are a wrong image.
const MAX_OVERRUNS: u32 = 3;

impl Faults {
    /// Latches the causes of this tick. `clear` first forgets everything that is not present any more, but for lost counts.
    pub fn latch(&mut self, causes: u16, overrun: bool, clear: bool) {
        self.overruns = if overrun {
            self.overruns.saturating_add(1)
        } else {
            0
        };
        if clear || !stands("faults_stay") {
            self.latched &= if stands("restart") {
                faults::UNTIL_RESTART
            } else {
                0
            };
        }
        self.latched |= causes;
        if self.overruns >= MAX_OVERRUNS && stands("overrun") {
            self.latched |= faults::OVERRUN;
        }
    }

    /// Latches a fault found later in the same tick.
    pub fn add(&mut self, fault: u16) {
        self.latched |= fault;
    }

    /// Bits of [`faults`].
    pub fn latched(&self) -> u16 {
        self.latched
    }

    /// Ticks in a row that took longer than their period.
    pub fn overruns(&self) -> u32 {
        self.overruns
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use Freshness::{Fresh, Lost, Missing, Stale};
    use Mode::{Armed, Boot, Decaying, Fault, Idle};

    const NONE: Orders = Orders {
        clear: false,
        disarm: false,
        arm: false,
    };
    const ARM: Orders = Orders { arm: true, ..NONE };
    const DISARM: Orders = Orders {
        disarm: true,
        ..NONE
    };

    #[test]
    fn the_whole_table_without_faults() {
        let table = [
            // mode, orders, then the next mode for contact missing, fresh, stale, lost
            (Boot, NONE, [Idle, Idle, Idle, Idle]),
            (Boot, ARM, [Armed, Armed, Armed, Armed]),
            (Boot, DISARM, [Idle, Idle, Idle, Idle]),
            (Idle, NONE, [Idle, Idle, Idle, Idle]),
            (Idle, ARM, [Armed, Armed, Armed, Armed]),
            (Idle, DISARM, [Idle, Idle, Idle, Idle]),
            (Armed, NONE, [Armed, Armed, Decaying, Idle]),
            (Armed, ARM, [Armed, Armed, Decaying, Idle]),
            (Armed, DISARM, [Idle, Idle, Idle, Idle]),
            (Decaying, NONE, [Armed, Armed, Decaying, Idle]),
            (Decaying, ARM, [Armed, Armed, Decaying, Idle]),
            (Decaying, DISARM, [Idle, Idle, Idle, Idle]),
            // Without faults this is a fault that has just been cleared.
            (Fault, NONE, [Idle, Idle, Idle, Idle]),
            (Fault, ARM, [Armed, Armed, Armed, Armed]),
            (Fault, DISARM, [Idle, Idle, Idle, Idle]),
        ];
        for (mode, orders, expected) in table {
            for (contact, expected) in [Missing, Fresh, Stale, Lost].into_iter().zip(expected) {
                let next = next_mode(mode, orders, 0, true, contact);
                assert_eq!(next, expected, "{mode:?}, {orders:?}, {contact:?}");
            }
        }
    }

    #[test]
    fn a_fault_wins_over_everything_and_boot_waits_for_the_first_tick() {
        for mode in [Boot, Idle, Armed, Decaying, Fault] {
            for started in [false, true] {
                assert_eq!(next_mode(mode, ARM, faults::BOARD, started, Fresh), Fault);
            }
        }
        assert_eq!(next_mode(Boot, ARM, 0, false, Fresh), Boot);
    }

    #[test]
    fn torque_only_while_armed_or_decaying() {
        let on = [Boot, Idle, Armed, Decaying, Fault].map(has_torque);
        assert_eq!(on, [false, false, true, true, false]);
    }

    #[test]
    fn the_later_order_counts() {
        let after = |commands: &[Command]| {
            let mut orders = NONE;
            for command in commands {
                orders.command(*command);
            }
            orders
        };
        assert_eq!(after(&[Command::Arm, Command::Disarm]), DISARM);
        assert!(after(&[Command::Disarm, Command::Arm]).arm);
        assert!(!after(&[Command::Arm, Command::ClearFault]).arm);
        assert!(after(&[Command::ClearFault, Command::Arm]).arm);
        assert_eq!(after(&[Command::StateEvery { ticks: 5 }]), NONE);
    }

    #[test]
    fn three_overruns_in_a_row_and_no_fewer() {
        let mut faults_seen = Faults::default();
        for (overrun, latched) in [
            (true, false),
            (true, false),
            (false, false),
            (true, false),
            (true, false),
            (true, true),
            (false, true),
        ] {
            faults_seen.latch(0, overrun, false);
            assert_eq!(faults_seen.latched() == faults::OVERRUN, latched);
        }
    }

    #[test]
    fn clearing_keeps_what_is_still_there() {
        let mut all = Faults::default();
        all.latch(faults::E_STOP | faults::BOARD, false, false);
        all.latch(faults::BOARD, false, true);
        assert_eq!(all.latched(), faults::BOARD);
        all.latch(0, false, false);
        assert_eq!(all.latched(), faults::BOARD);
        all.latch(0, false, true);
        assert_eq!(all.latched(), 0);
    }
}
