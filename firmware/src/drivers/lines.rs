//! Lines that a tick looks at: buttons, pedals, end stops and an encoder's index.
//!
//! Entry points, once a tick: [`Switch::tick`], [`EndStops::tick`], [`Index::tick`]. Which level means what is the board's: a line of the
//! other polarity is turned round by its pin. A line that cannot be read is what does least: a switch that is let go, an
//! end stop that is reached.

use embedded_hal::digital::InputPin;

/// A contact bounces for 1 to 5 ms, a pedal's for up to 10 (makers' data sheets); nobody feels 10 ms more.
const BOUNCES: u8 = 10;

/// A button or a pedal.
#[derive(Debug)]
pub struct Switch<P> {
    /// High = pressed.
    pin: P,
    pressed: bool,
    /// Ticks in a row for which the line has been otherwise.
    other: u8,
}

/// What a switch has done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stroke {
    /// It is pressed, since this tick.
    Pressed,
    /// It is let go, since this tick.
    Released,
}

impl<P: InputPin> Switch<P> {
    /// A switch that counts as let go until it has been seen pressed for 10 ms.
    pub fn new(pin: P) -> Self {
        Self {
            pin,
            pressed: false,
            other: 0,
        }
    }

    /// Looks at the line; what has happened, once it has been the same for 10 ticks.
    pub fn tick(&mut self) -> Option<Stroke> {
        let now = self.pin.is_high().unwrap_or(false);
        if now == self.pressed {
            self.other = 0;
            return None;
        }
        self.other += 1;
        if self.other < BOUNCES {
            return None;
        }
        (self.pressed, self.other) = (now, 0);
        Some(if now {
            Stroke::Pressed
        } else {
            Stroke::Released
        })
    }

    /// Whether it is pressed.
    pub fn is_pressed(&self) -> bool {
        self.pressed
    }
}

/// The two end stops of a joint: normally closed contacts, high = not reached.
#[derive(Debug)]
pub struct EndStops<L, H> {
    low: L,
    high: H,
}

/// Where end stops say that a joint is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reached {
    /// Between them.
    Neither,
    /// At the lower one.
    Low,
    /// At the upper one.
    High,
    /// At both, which no joint is: a wire is broken, or their supply is off.
    Broken,
}

impl<L: InputPin, H: InputPin> EndStops<L, H> {
    /// The end stops of a joint.
    pub fn new(low: L, high: H) -> Self {
        Self { low, high }
    }

    /// Looks at both. They are not debounced: a stop may not come late.
    pub fn tick(&mut self) -> Reached {
        match [
            self.low.is_low().unwrap_or(true),
            self.high.is_low().unwrap_or(true),
        ] {
            [false, false] => Reached::Neither,
            [true, false] => Reached::Low,
            [false, true] => Reached::High,
            [true, true] => Reached::Broken,
        }
    }
}

/// An encoder's index, high once a turn for about a count: seen only where the joint goes slowly, as it does when its zero is looked
/// for.
#[derive(Debug)]
pub struct Index<P> {
    pin: P,
    /// Level and counts of the tick before.
    before: Option<(bool, i32)>,
}

impl<P: InputPin> Index<P> {
    /// An index that nobody has looked at.
    pub fn new(pin: P) -> Self {
        Self { pin, before: None }
    }

    /// Looks at the line at these counts. Where it has gone high since the tick before: the counts then and now, between which it did.
    /// A line that stays high is found once; one that cannot be read, never, and the next level after it is no edge.
    pub fn tick(&mut self, counts: i32) -> Option<[i32; 2]> {
        let Ok(high) = self.pin.is_high() else {
            self.before = None;
            return None;
        };
        match self.before.replace((high, counts)) {
            Some((false, before)) if high => Some([before, counts]),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use embedded_hal_mock::eh1::MockError;
    use embedded_hal_mock::eh1::digital::{Mock, State, Transaction};
    use std::io::ErrorKind;
    use std::vec::Vec;

    /// A line with these levels; `None` = it cannot be read.
    fn line(levels: &[Option<bool>], call: fn(State) -> Transaction) -> Mock {
        let calls: Vec<_> = levels
            .iter()
            .map(|level| match level {
                Some(true) => call(State::High),
                Some(false) => call(State::Low),
                None => call(State::High).with_error(MockError::Io(ErrorKind::TimedOut)),
            })
            .collect();
        Mock::new(&calls)
    }

    /// As the mock answers `is_low` with whether the level is low.
    fn of(levels: &[Option<bool>]) -> Mock {
        line(levels, Transaction::get)
    }

    fn repeat(parts: &[(Option<bool>, usize)]) -> Vec<Option<bool>> {
        parts
            .iter()
            .flat_map(|(level, times)| std::iter::repeat_n(*level, *times))
            .collect()
    }

    #[test]
    fn a_press_counts_after_10_ms_and_bouncing_does_not() {
        let levels = repeat(&[
            (Some(false), 3),
            (Some(true), 9),
            (Some(false), 1),
            (Some(true), 10),
            (Some(false), 9),
            (Some(true), 1),
            (Some(false), 10),
        ]);
        let mut pin = of(&levels);
        let mut switch = Switch::new(pin.clone());
        let strokes: Vec<_> = (0..levels.len())
            .filter_map(|tick| switch.tick().map(|stroke| (tick, stroke)))
            .collect();
        pin.done();
        assert_eq!(strokes, [(22, Stroke::Pressed), (42, Stroke::Released)]);
        assert!(!switch.is_pressed());
    }

    #[test]
    fn a_switch_that_cannot_be_read_is_let_go() {
        let levels = repeat(&[(Some(true), 10), (None, 10), (None, 5)]);
        let mut pin = of(&levels);
        let mut switch = Switch::new(pin.clone());
        let first = (0..10).find_map(|_| switch.tick());
        assert_eq!(first, Some(Stroke::Pressed));
        assert!(switch.is_pressed());
        let strokes: Vec<_> = (0..15).filter_map(|_| switch.tick()).collect();
        pin.done();
        assert_eq!(strokes, [Stroke::Released]);
    }

    #[test]
    fn end_stops_stop_when_open_unreadable_or_both() {
        let levels = [Some(true), Some(false), None];
        let mut found = Vec::new();
        for low in levels {
            for high in levels {
                let (mut low, mut high) = (of(&[low]), of(&[high]));
                found.push(EndStops::new(low.clone(), high.clone()).tick());
                low.done();
                high.done();
            }
        }
        use Reached::{Broken, High, Low, Neither};
        assert_eq!(
            found,
            [
                Neither, High, High, Low, Broken, Broken, Low, Broken, Broken
            ]
        );
    }

    #[test]
    fn an_index_is_between_two_ticks_counts() {
        let levels = [
            Some(true),
            Some(false),
            Some(true),
            Some(true),
            Some(false),
            None,
            Some(true),
            Some(false),
            Some(true),
        ];
        let mut pin = of(&levels);
        let mut index = Index::new(pin.clone());
        let found: Vec<_> = (0..9).map(|tick| index.tick(10 * tick)).collect();
        pin.done();
        let mut expected = [None; 9];
        // High from the start is no edge, nor is it after a tick that saw nothing.
        expected[2] = Some([10, 20]);
        expected[8] = Some([70, 80]);
        assert_eq!(found, expected);
    }
}
