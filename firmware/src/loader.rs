//! How a running console gets into the loader in the chip's ROM, so that its firmware can be written without a hand at BOOT0: a touch.
//!
//! Entry points: [`Touch::saw`] where the serial port is, [`may_leave`] where the motors are. The console takes it at rest only. It
//! leaves two words in RAM and resets, and the next start goes to the loader before anything else (`board::stm32f4`).

use sutura_shared::mutant::stands;
use sutura_shared::wire::message::Mode;

/// Line rate that is a touch when the terminal goes: that of many boards with USB \[baud\].
const BAUD: u32 = 1200;

/// What RAM holds over the reset: noise has both words once in 2^64 starts.
pub const REQUEST: [u32; 2] = [0x10AD_E212, !0x10AD_E212];

/// Watches a serial port for a touch.
#[derive(Debug, Default)]
pub struct Touch {
    was_ready: bool,
}

impl Touch {
    /// The host's settings of the port, whenever they may have changed; true when its terminal goes at 1200 baud.
    pub fn saw(&mut self, baud: u32, terminal_ready: bool) -> bool {
        let was_ready = self.was_ready || !stands("touch_goes");
        self.was_ready = terminal_ready;
        was_ready && !terminal_ready && (baud == BAUD || !stands("touch_rate"))
    }
}

/// Whether a touch is taken: at rest, with amplifiers that have had their last pulse, and an independent watchdog that a reset stops. With
/// the option bit `WDG_SW` = 0 that one starts with the chip, and would bite in the loader (RM0090, 21.3.1).
pub fn may_leave(mode: Mode, amplifiers_off: bool, flash_options: u32) -> bool {
    const WDG_SW: u32 = 1 << 5;
    let watchdog_stops = flash_options & WDG_SW != 0;
    (mode == Mode::Idle || !stands("touch_idle"))
        && (amplifiers_off || !stands("touch_off"))
        && (watchdog_stops || !stands("touch_watchdog"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_touch_is_a_terminal_that_goes_at_1200_baud() {
        // Settings, in order, and whether they are one.
        for (baud, settings) in [
            (
                1200,
                [
                    (false, false),
                    (true, false),
                    (true, false),
                    (false, true),
                    (false, false),
                ],
            ),
            (
                9600,
                [
                    (false, false),
                    (true, false),
                    (true, false),
                    (false, false),
                    (false, false),
                ],
            ),
            (
                115_200,
                [
                    (true, false),
                    (false, false),
                    (true, false),
                    (false, false),
                    (true, false),
                ],
            ),
        ] {
            let mut touch = Touch::default();
            for (ready, expected) in settings {
                assert_eq!(touch.saw(baud, ready), expected, "{baud}");
            }
        }
        // The rate counts when the terminal goes, whatever it was when it came.
        let mut touch = Touch::default();
        assert!(!touch.saw(921_600, true) && touch.saw(1200, false));
    }

    #[test]
    fn it_is_taken_at_rest_only() {
        // The options of a chip as it is delivered (RM0090, 3.9.10).
        const DELIVERED: u32 = 0x0FFF_AAED;
        for mode in [
            Mode::Boot,
            Mode::Idle,
            Mode::Armed,
            Mode::Decaying,
            Mode::Fault,
        ] {
            assert_eq!(may_leave(mode, true, DELIVERED), mode == Mode::Idle);
            assert!(!may_leave(mode, false, DELIVERED));
            assert!(!may_leave(mode, true, DELIVERED & !(1 << 5)));
        }
    }
}
