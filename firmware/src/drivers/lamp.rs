//! A light-emitting diode that says what the console does.
//!
//! Entry point: [`Lamp::tick`]. Which level lights it is the board's: see [`Lamp::new`].

use embedded_hal::digital::{OutputPin, PinState};

/// What a lamp shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Show {
    /// Nothing.
    Dark,
    /// Light.
    Lit,
    /// Two flashes a second.
    Blinking,
}

/// Half a period of blinking \[ticks\].
const HALF: u16 = 250;

/// A lamp on a pin.
#[derive(Debug)]
pub struct Lamp<P> {
    pin: P,
    lit: PinState,
    tick: u16,
}

impl<P: OutputPin> Lamp<P> {
    /// `lit`: the level that lights it.
    pub fn new(pin: P, lit: PinState) -> Self {
        Self { pin, lit, tick: 0 }
    }

    /// Once a tick. A pin that refuses is a lamp that does not work, which nothing depends on.
    pub fn tick(&mut self, show: Show) {
        self.tick = if show == Show::Blinking {
            (self.tick + 1) % (2 * HALF)
        } else {
            0
        };
        let lit = match show {
            Show::Dark => false,
            Show::Lit => true,
            Show::Blinking => self.tick < HALF,
        };
        let _ = self.pin.set_state(if lit { self.lit } else { !self.lit });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use embedded_hal_mock::eh1::MockError;
    use embedded_hal_mock::eh1::digital::{Mock, State, Transaction};
    use std::io::ErrorKind;
    use std::vec::Vec;

    #[test]
    fn it_blinks_in_halves_of_250_ms_and_begins_lit() {
        let level = |tick: u16| {
            if tick % 500 < 250 {
                State::Low
            } else {
                State::High
            }
        };
        let calls: Vec<_> = (1..=1000)
            .map(|tick| Transaction::set(level(tick)))
            .collect();
        let mut pin = Mock::new(&calls);
        let mut lamp = Lamp::new(pin.clone(), PinState::Low);
        (0..1000).for_each(|_| lamp.tick(Show::Blinking));
        pin.done();
    }

    #[test]
    fn dark_and_lit_in_either_polarity_and_a_pin_that_refuses_is_borne() {
        for (lit, [dark_level, lit_level]) in [
            (PinState::High, [State::Low, State::High]),
            (PinState::Low, [State::High, State::Low]),
        ] {
            let refused = Transaction::set(lit_level).with_error(MockError::Io(ErrorKind::Other));
            let calls = [
                Transaction::set(dark_level),
                refused,
                Transaction::set(lit_level),
            ];
            let mut pin = Mock::new(&calls);
            let mut lamp = Lamp::new(pin.clone(), lit);
            for show in [Show::Dark, Show::Lit, Show::Lit] {
                lamp.tick(show);
            }
            pin.done();
        }
    }
}
