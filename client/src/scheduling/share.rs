//! Who takes too much of a core to go before others.

use std::time::Duration;

/// Time over which a thread's computing is looked at.
pub const WINDOW: Duration = Duration::from_millis(100);
/// Largest part of a window that a thread may compute before others: what is left is theirs.
pub const MOST: f64 = 0.8;
/// How long a thread that gave way must stay below [`CALM`] before it goes first again.
pub const REST: Duration = Duration::from_secs(1);
/// Largest part of a window that counts as rest. Less than [`MOST`]: a thread at the edge does not change back and forth.
const CALM: f64 = 0.5;

/// What a thread is to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Change {
    /// Go on as it is.
    None,
    /// Be an ordinary thread from now on.
    GiveWay,
    /// Go first again.
    Return,
}

/// The account of one thread.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Share {
    /// Rest so far, while it gives way.
    resting: Option<Duration>,
    given: u64,
}

impl Share {
    /// Whether it goes first.
    pub(super) fn is_held(&self) -> bool {
        self.resting.is_none()
    }

    /// How often it gave way.
    pub(super) fn given(&self) -> u64 {
        self.given
    }

    /// In the last `wall` it computed for `computed`.
    pub(super) fn note(&mut self, wall: Duration, computed: Duration) -> Change {
        let share = computed.as_secs_f64() / wall.as_secs_f64().max(f64::MIN_POSITIVE);
        match &mut self.resting {
            None if share > MOST => {
                self.resting = Some(Duration::ZERO);
                self.given += 1;
                Change::GiveWay
            }
            None => Change::None,
            Some(rested) if share <= CALM => {
                *rested += wall;
                if *rested < REST {
                    return Change::None;
                }
                self.resting = None;
                Change::Return
            }
            Some(rested) => {
                *rested = Duration::ZERO;
                Change::None
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Windows of this length and these parts, and what each led to.
    fn changes(window_ms: u64, parts: &[f64]) -> (Vec<Change>, Share) {
        let window = Duration::from_millis(window_ms);
        let mut share = Share::default();
        let note = |part: &f64| share.note(window, window.mul_f64(*part));
        (parts.iter().map(note).collect(), share)
    }

    #[test]
    fn who_rests_enough_goes_first_for_ever() {
        let (changes, share) = changes(100, &[0.0, 0.79, 0.4, 0.79, 0.79, 0.01]);
        assert!(changes.iter().all(|change| *change == Change::None));
        assert!(share.is_held() && share.given() == 0);
    }

    #[test]
    fn who_does_not_gives_way_within_one_window() {
        for window_ms in [100, 2000] {
            let (changes, share) = changes(window_ms, &[0.9, 1.0, 1.0]);
            assert_eq!(changes, [Change::GiveWay, Change::None, Change::None]);
            assert!(!share.is_held() && share.given() == 1);
        }
    }

    #[test]
    fn it_comes_back_after_a_second_of_rest_on_end() {
        let mut parts = vec![1.0];
        parts.extend([0.1; 9]);
        // Neither too much nor rest: the second begins anew.
        parts.push(0.6);
        parts.extend([0.1; 10]);
        let (changes, share) = changes(100, &parts);
        let returns = changes.iter().position(|change| *change == Change::Return);
        assert_eq!(returns, Some(parts.len() - 1));
        assert!(share.is_held() && share.given() == 1);
    }

    #[test]
    fn a_thread_that_always_spins_holds_less_than_a_tenth_of_the_time() {
        // Starved to half a core by two busy programs while it is ordinary, alone on its core while it goes first.
        let window = Duration::from_millis(100);
        let (mut share, mut held) = (Share::default(), 0);
        for _ in 0..1100 {
            let part = if share.is_held() { 1.0 } else { 0.5 };
            held += u32::from(share.is_held());
            share.note(window, window.mul_f64(part));
        }
        assert!(held <= 101, "{held} of 1100 windows");
    }

    #[test]
    fn a_window_without_length_changes_nothing() {
        let mut share = Share::default();
        assert_eq!(share.note(Duration::ZERO, Duration::ZERO), Change::None);
        assert!(share.is_held());
    }
}
