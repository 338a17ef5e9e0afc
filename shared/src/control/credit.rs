//! How a force comes back that an outage has taken away: at a bounded rate, against a bounded credit.
//!
//! Entry points: [`Credit::watch`] every tick, [`Credit::lose`] while nothing is under power, [`Credit::raise`] for the
//! force that may be had, [`Credit::draw`] and [`Credit::pay`] for what it costs. While the force is gone the hand sinks
//! in and pays nothing; a tank alone never lets such a force come back before the hand has left. What is lent is the
//! work of pushing the hand out to where it would have rested, and what the contact stores there. It stays owed until
//! energy that was taken from the hand has paid it back.

use super::TICK_S;
use crate::math::{clamp, max, min};

/// Rate at which a force comes back \[N/s\], below the 5 N/s that it may by what encoders' steps add.
const RATE_N_PER_S: f32 = 4.95;
/// Speeds of a grip on its way out from which on it comes back slower, and no further \[m/s\]: a light hand is not thrown past
/// where it rests.
const PUSHED_OUT: (f32, f32) = (0.02, 0.04);
/// Most that is lent \[J\]: 6 to 13 mJ are at stake in a press of 1 to 3 N. With what a tank has at the start it is 15 mJ.
const LIMIT_J: f32 = 14.5e-3;
/// Part of a force with less of which left it is gone.
const GONE: f32 = 0.05;
/// Part of the horizon for which it may be gone without being lost to a hand that moves: where frames come so seldom that one of them makes this
/// gap, the force would never be there.
const DIP: f32 = 0.2;
/// Longer than any dip \[s\].
const NEVER_S: f32 = 1.0;
/// Ticks for which a hand has rested in tissue whose force is withheld, after which that comes back: a dip has made it sink in, or
/// whatever else.
const LACKS_TICKS: u16 = 25;
/// A force that is not covered goes on the way out at so many times the slope of its spring.
const GOES: f32 = 4.0;
/// Way on which a force ends below which it gives next to no energy \[m\]: the hand's own way in builds it up at once.
const SHORT_M: f32 = 0.25e-3;
/// Slower motion is none \[m/s\]: an encoder's step looks like that.
const SLOWEST: f32 = 2e-3;
/// Ticks in a row with all of the force after which it is back: a blend from nothing hides what is wanted for two.
const CALM_TICKS: u8 = 10;
/// Force that may be missing of one that is back: a part of it, and what encoders' steps make \[N\].
const MISSING: (f32, f32) = (0.005, 0.03);
/// Drag while anything is owed: damping \[N s/m\], and the most of it \[N\], which nobody notices.
const DRAG: (f32, f32) = (0.5, 0.02);

/// The line of credit of one console, and how far a force has come back.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Credit {
    /// Lent and not paid back \[J\].
    owed_j: f32,
    /// What may be had of a force that is coming back \[N\]; none once it is back.
    level_n: Option<f32>,
    calm_ticks: u8,
    /// Time for which contact data has been too old, or not there \[s\].
    gone_s: f32,
    /// Ticks, less those of a moving hand, for which force has been missing.
    lacking: u16,
}

impl Credit {
    /// Nothing is owed. The first force comes back like one after an outage: the tool may be inside tissue.
    pub const NEW: Credit = Credit {
        owed_j: 0.0,
        level_n: Some(0.0),
        calm_ticks: 0,
        gone_s: NEVER_S,
        lacking: 0,
    };

    /// Lent and not paid back \[J\].
    pub fn owed_j(&self) -> f32 {
        self.owed_j
    }

    /// Whether a force is coming back.
    pub fn is_open(&self) -> bool {
        self.level_n.is_some()
    }

    /// Whatever is wanted comes back from a force that is there \[N\].
    pub fn lose(&mut self, left_n: f32) {
        self.level_n = Some(left_n);
        self.calm_ticks = 0;
    }

    /// Takes note of what the age of contact data leaves of its force, 0 to 1, for how long it is good \[s\], and whether the grip rests:
    /// the first after nothing, and after an outage, may find the tool inside. `before_n`: the force of the last tick \[N\], a fixture's.
    pub fn watch(&mut self, left: f32, horizon_s: f32, before_n: f32, rests: bool) {
        if left < GONE {
            self.gone_s = min(self.gone_s + TICK_S, NEVER_S);
            return;
        }
        if self.gone_s > DIP * horizon_s || self.gone_s > 0.0 && rests {
            self.lose(before_n);
        }
        self.gone_s = 0.0;
    }

    /// Takes note of whether a part of a force is withheld, with what is let through of it \[N\]. What a hand that rests
    /// lacks comes back.
    pub fn lack(&mut self, lacks: bool, allowed_n: f32, rests: bool) {
        if !lacks || self.gone_s > 0.0 || self.is_open() {
            self.lacking = 0;
        } else if !rests {
            self.lacking = self.lacking.saturating_sub(1);
        } else {
            self.lacking += 1;
            if self.lacking >= LACKS_TICKS {
                self.lose(allowed_n);
            }
        }
    }

    /// What may be had now of a force of `size` \[N\] that is coming back, and ends at `size`; none if none is coming back.
    /// `speed`: of the grip along the force \[m/s\]; `covered_n`: what the tank pays for.
    pub fn raise(&mut self, size: f32, speed: f32, stiffness: f32, covered_n: f32) -> Option<f32> {
        let level = self.level_n.as_mut()?;
        let (slow, fast) = PUSHED_OUT;
        let is_short = size < SHORT_M * stiffness;
        let quick = if is_short { speed } else { speed.abs() };
        let mut rate = RATE_N_PER_S * clamp((fast - quick) * (1.0 / (fast - slow)), 0.0, 1.0);
        if *level > covered_n {
            rate -= GOES * stiffness * max(speed - SLOWEST, 0.0);
        } else if is_short {
            rate += stiffness * max(-speed - SLOWEST, 0.0);
        }
        *level = clamp(*level + rate * TICK_S, 0.0, size);
        Some(*level)
    }

    /// Energy for a force that is coming back, as much of it as the line still has \[J\].
    pub fn draw(&mut self, missing_j: f32) -> f32 {
        let drawn = clamp(missing_j, 0.0, LIMIT_J - self.owed_j);
        self.owed_j += drawn;
        drawn
    }

    /// Pays back what was taken from the hand and is not needed for the present contact \[J\].
    pub fn pay(&mut self, energy_j: f32) {
        self.owed_j = max(self.owed_j - energy_j, 0.0);
    }

    /// Takes note of what was missing of a force of `size` \[N\], and whether the tank pays for all of it: a force that has
    /// been all there for a while is back.
    pub fn note(&mut self, size: f32, missing: f32, is_covered: bool) {
        let (part, least) = MISSING;
        self.calm_ticks = if is_covered && missing <= part * size + least {
            self.calm_ticks.saturating_add(1)
        } else {
            0
        };
        if self.calm_ticks >= CALM_TICKS {
            self.end();
        }
    }

    /// Nothing is left to come back.
    pub fn end(&mut self) {
        self.level_n = None;
    }

    /// Damping to be taken off at a speed of the grip \[N s/m\]: pays back what is owed.
    pub fn drag(&self, speed: f32) -> f32 {
        let (damping, most_n) = DRAG;
        if self.owed_j > 0.0 && self.level_n.is_none() && self.gone_s <= 0.0 && speed > SLOWEST {
            min(damping, most_n / speed)
        } else {
            0.0
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STIFFNESS: f32 = 500.0;

    /// What may be had after some ticks of a force of 3 N, with the grip at a speed along it \[m/s\].
    fn after(ticks: u32, speed: f32, covered_n: f32) -> f32 {
        let mut credit = Credit::NEW;
        let levels = (0..ticks).map(|_| {
            let level = credit.raise(3.0, speed, STIFFNESS, covered_n);
            level.expect("it is not back yet")
        });
        levels.last().unwrap_or(0.0)
    }

    #[test]
    fn a_force_comes_back_at_its_rate_and_slower_where_it_pushes_the_hand_out() {
        assert!((after(100, 0.0, 10.0) - 0.495).abs() < 1e-4);
        assert!((after(100, 0.03, 10.0) - 0.2475).abs() < 1e-4);
        assert_eq!(after(100, 0.05, 10.0), 0.0);
        assert_eq!(after(2000, 0.0, 10.0), 3.0);
        // Uncovered it goes on the way out, 4 times as fast as its spring.
        assert!(after(100, 0.01, 0.0) < 0.005);
    }

    /// A needle in stiff tissue, of which the hand's own way makes more than the rate.
    #[test]
    fn a_force_of_a_short_way_comes_back_as_fast_as_the_hand_presses_it_in() {
        let level = |stiffness: f32, covered_n: f32| {
            let mut credit = Credit::NEW;
            credit.raise(0.5, -0.012, stiffness, covered_n)
        };
        let only_rate = Some(RATE_N_PER_S * TICK_S);
        let pressed = level(4e3, 1.0).unwrap_or(0.0);
        assert!((pressed - (RATE_N_PER_S + 40.0) * TICK_S).abs() < 1e-6);
        assert_eq!(level(1e3, 1.0), only_rate);
        let mut credit = Credit::NEW;
        credit.lose(0.4);
        let uncovered = credit.raise(0.5, -0.012, 4e3, 0.1).unwrap_or(0.0);
        assert!((uncovered - 0.4 - RATE_N_PER_S * TICK_S).abs() < 1e-6);
    }

    #[test]
    fn the_line_of_credit_is_one() {
        let mut credit = Credit::NEW;
        let lent: f32 = (0..10).map(|_| credit.draw(2e-3)).sum();
        assert!((lent - LIMIT_J).abs() < 1e-7 && credit.draw(1e-3) < 1e-7);
        // An outage brings no new one.
        credit.watch(0.0, 0.1, 0.0, true);
        credit.lose(0.0);
        assert!(credit.draw(1e-3) < 1e-7);
        credit.pay(4e-3);
        assert!((credit.draw(1.0) - 4e-3).abs() < 1e-7);
        credit.pay(1.0);
        assert_eq!(credit.owed_j(), 0.0);
    }

    #[test]
    fn what_is_gone_comes_back_and_what_a_resting_hand_lacks() {
        let back = || {
            let mut credit = Credit::NEW;
            credit.watch(1.0, 0.1, 0.0, true);
            credit.end();
            credit
        };
        let open_after = |ticks: u32, left: f32, rests: bool| {
            let mut credit = back();
            (0..ticks).for_each(|_| credit.watch(left, 0.1, 0.0, rests));
            credit.watch(1.0, 0.1, 0.0, rests);
            credit.is_open()
        };
        assert!(!open_after(99, 0.1, true) && open_after(1, 0.04, true));
        assert!(!open_after(19, 0.0, false) && open_after(22, 0.0, false));
        let lacking = |ticks: u16, rests: bool| {
            let mut credit = back();
            (0..ticks).for_each(|_| credit.lack(true, 1.0, rests));
            credit.level_n
        };
        assert_eq!(lacking(LACKS_TICKS - 1, true), None);
        assert_eq!(lacking(LACKS_TICKS, true), Some(1.0));
        assert_eq!(lacking(1000, false), None);
    }

    #[test]
    fn a_force_is_back_when_all_of_it_was_there_for_a_while() {
        let mut credit = Credit::NEW;
        for _ in 0..3 {
            (1..CALM_TICKS).for_each(|_| credit.note(2.0, 0.03, true));
            credit.note(2.0, 0.1, true);
            (1..CALM_TICKS).for_each(|_| credit.note(2.0, 0.0, true));
            credit.note(2.0, 0.0, false);
        }
        assert!(credit.is_open());
        (0..CALM_TICKS).for_each(|_| credit.note(2.0, 0.0, true));
        assert!(!credit.is_open());
    }
}
