//! What keys do.
//!
//! Entry point: [`Keys::press`].

use super::figures::Figures;
use super::terminal::Pressed;
use serde_json::{Value, json};
use std::time::{Duration, Instant};

/// How long the first press of a key that is to be pressed twice is remembered.
const TWICE_WITHIN: Duration = Duration::from_secs(2);

/// What the program does.
#[derive(Clone, Debug, PartialEq)]
pub enum Does {
    /// Nothing that the session hears of.
    Nothing,
    /// It ends.
    Quit,
    /// It asks the session for something.
    Say(Value),
}

/// Keys so far.
#[derive(Clone, Debug, Default)]
pub struct Keys {
    /// Whether the keys are explained.
    pub helps: bool,
    /// When arming was asked for the first time.
    arms: Option<Instant>,
}

impl Keys {
    /// Whether the next press arms.
    pub fn is_arming(&self, now: Instant) -> bool {
        self.arms
            .is_some_and(|then| now.saturating_duration_since(then) <= TWICE_WITHIN)
    }

    /// Takes note of a key.
    pub fn press(&mut self, pressed: Pressed, figures: &Figures, now: Instant) -> Does {
        let was_arming = self.is_arming(now);
        if pressed == Pressed::Resized {
            return Does::Nothing;
        }
        self.arms = None;
        let helped = self.helps;
        self.helps = pressed == Pressed::Key('?') && !helped;
        let say = |command: &str| Does::Say(json!({"do": command}));
        match pressed {
            // Whatever else is on the screen.
            Pressed::Key('s') => say("safe_stop"),
            Pressed::Interrupt => Does::Quit,
            Pressed::Key('q') if !helped => Does::Quit,
            Pressed::Key('p') => say(if figures.is_paused() {
                "resume"
            } else {
                "pause"
            }),
            Pressed::Key('a') if was_arming => say("arm"),
            Pressed::Key('a') => {
                self.arms = Some(now);
                Does::Nothing
            }
            Pressed::Key('c') => say("clear_fault"),
            Pressed::Key('t') => say("take_control"),
            _ => Does::Nothing,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn safe_stop_asks_nothing_and_arming_is_asked_for_twice() {
        let now = Instant::now();
        let figures = Figures::new(now);
        let mut keys = Keys::default();
        let mut press = |letter, at| keys.press(Pressed::Key(letter), &figures, at);
        let arm = Does::Say(json!({"do": "arm"}));
        assert_eq!(press('s', now), Does::Say(json!({"do": "safe_stop"})));
        assert_eq!(press('a', now), Does::Nothing);
        assert_eq!(press('a', now + TWICE_WITHIN), arm);
        // Once more is a first time; too late is one, too; and any other key takes it back.
        assert_eq!(press('a', now), Does::Nothing);
        assert_eq!(press('a', now + 2 * TWICE_WITHIN), Does::Nothing);
        assert_eq!(
            press('s', now + 2 * TWICE_WITHIN),
            Does::Say(json!({"do": "safe_stop"}))
        );
        assert_eq!(press('a', now + 2 * TWICE_WITHIN), Does::Nothing);
        // Help is left by any key, and stops no stop.
        assert_eq!(press('?', now), Does::Nothing);
        assert_eq!(press('q', now), Does::Nothing);
        assert_eq!(press('?', now), Does::Nothing);
        assert_eq!(press('s', now), Does::Say(json!({"do": "safe_stop"})));
        assert_eq!(press('q', now), Does::Quit);
    }
}
