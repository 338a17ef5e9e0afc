//! Numbers to and from the motor timer, the encoder timers and the tick timer.
//!
//! Entry points: [`SetPoint`], [`StopLine`], [`Counter16`], [`TickClock`].

use sutura_shared::mutant::stands;

/// How an amplifier reads a set point from the width of its pulses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SetPoint {
    /// Pulses a second \[Hz\].
    pub frequency_hz: u32,
    /// Part of the period that means full current backwards.
    pub backwards: f32,
    /// Part of the period that means full current forwards; below [`Self::backwards`] for the other polarity.
    pub forwards: f32,
    /// That full current \[A\], as it is set in the amplifier.
    pub full_scale_a: f32,
}

impl SetPoint {
    /// maxon ESCON, set point by pulses, full scale at 10 and 90 % duty.
    ///
    /// The amplifier takes 10 Hz to 5 kHz, with an error of 0.5 % at 1 kHz and 2.5 % at 5 kHz (hardware reference, "PWM set
    /// value"). 4 kHz: inside that, about 2 % on a straight line between the two; and a set point is 0.25 to
    /// 0.5 ms old when it acts: up to a pulse until the timer takes it, and a pulse until the amplifier has measured it.
    pub const fn escon(full_scale_a: f32) -> SetPoint {
        SetPoint {
            frequency_hz: 4000,
            backwards: 0.1,
            forwards: 0.9,
            full_scale_a,
        }
    }

    /// Counts of no current, of `period` counts.
    pub const fn none(&self, period: u16) -> u16 {
        (0.5 * (self.backwards + self.forwards) * period as f32 + 0.5) as u16
    }

    /// Counts of a pulse for a motor current \[A\], of `period` counts. A current beyond the scale is clamped; NaN means none.
    pub fn duty(&self, current_a: f32, period: u16) -> u16 {
        let share = current_a / self.full_scale_a;
        // Spelled out: what `clamp` does to a NaN is not what a motor wants.
        let share = if share >= 1.0 {
            1.0
        } else if share <= -1.0 {
            -1.0
        } else if share.is_nan() {
            0.0
        } else {
            share
        };
        let middle = 0.5 * (self.forwards + self.backwards);
        let half = 0.5 * (self.forwards - self.backwards);
        // Rounded: cut off, 10 % could become a hair less, which the amplifier takes for a fault.
        ((middle + half * share) * f32::from(period) + 0.5) as u16
    }
}

/// The emergency stop as a tick finds it. The timer takes its outputs off by itself when the line opens,
/// and its flag remembers that: a stop shorter than a tick has to reach the tick too, or it would go on
/// commanding motors that are off.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StopLine {
    /// The line is open now.
    pub open: bool,
    /// The timer's flag: it has been open since the flag was cleared.
    pub tripped: bool,
}

impl StopLine {
    /// Whether this tick has to stop.
    pub fn pressed(self) -> bool {
        self.open || self.tripped && stands("stop_flag")
    }

    /// Whether the flag is to be cleared: only after a tick was told of it, and with the line closed.
    pub fn clears_flag(self) -> bool {
        self.tripped && !self.open
    }
}

/// A 16-bit encoder counter, widened.
///
/// Right as long as it is read before the encoder moves 32767 counts on.
#[derive(Clone, Copy, Debug, Default)]
pub struct Counter16 {
    total: i32,
}

impl Counter16 {
    /// Takes the counter's present value and returns the wide count (wrapping).
    pub fn widen(&mut self, count: u16) -> i32 {
        let moved = count.wrapping_sub(self.total as u16) as i16;
        self.total = self.total.wrapping_add(i32::from(moved));
        self.total
    }
}

/// Console time from the ticks of a timer, checked by a counter of the core's clock that counts down, `PER_US` a microsecond.
///
/// A tick is a period of the tick timer, so that whatever happens to the counter, contacts age and sessions expire as long as
/// ticks run; that ticks run is for the watchdogs to see. The counter tells how many periods went by unseen while a tick was
/// late, and whether the two clocks contradict each other.
#[derive(Clone, Copy, Debug)]
pub struct TickClock<const PER_US: u32> {
    us: u64,
    /// The counter at the tick before.
    last: u32,
    /// Ticks in a row whose length nobody can believe.
    odd: u8,
    /// Ticks, and their length by the counter \[us\], since the two were last compared.
    compared: (u8, u32),
}

/// What a [`TickClock`] says of a tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Beat {
    /// Console time \[us\].
    pub now_us: u64,
    /// Three ticks in a row took less than half of their period or more than ten by the counter: one of the clocks stands or
    /// races.
    pub contradicts: bool,
    /// Every hundred ticks, if the clocks were more than 5 % apart in them: time by the counter over time by the ticks \[%\].
    pub apart_percent: Option<u32>,
}

/// Period of the tick timer \[us\].
const PERIOD_US: u32 = 1000;
/// Lengths of a tick that can be believed \[us\]: half a period to ten.
const BELIEVED_US: core::ops::RangeInclusive<u32> = PERIOD_US / 2..=10 * PERIOD_US;
/// So many ticks in a row that cannot be believed are a fault.
const MAX_ODD: u8 = 3;
/// Ticks after which the clocks are compared.
const COMPARE_TICKS: u8 = 100;

impl<const PER_US: u32> TickClock<PER_US> {
    /// Bits of the counter: those of SysTick.
    const MASK: u32 = 0x00FF_FFFF;

    /// A clock that starts at 0 us, one period before the first tick, with the counter at `counter`.
    pub const fn new(counter: u32) -> Self {
        const { assert!(PER_US > 0) };
        Self {
            us: 0,
            last: counter,
            odd: 0,
            compared: (0, 0),
        }
    }

    /// A tick begins with the counter at `counter`. Right as long as that has not gone round since the tick before (0.8 s at
    /// 21 MHz).
    pub fn tick(&mut self, counter: u32) -> Beat {
        let counts = self.last.wrapping_sub(counter) & Self::MASK;
        self.last = counter;
        let passed_us = counts / PER_US;

        let believed = BELIEVED_US.contains(&passed_us);
        self.odd = if believed {
            0
        } else {
            self.odd.saturating_add(1)
        };
        // Periods that went by unseen while an interrupt was late. What cannot be believed is one.
        let periods = if believed && stands("lost_periods") {
            ((passed_us + PERIOD_US / 2) / PERIOD_US).max(1)
        } else {
            1
        };
        self.us += u64::from(periods * PERIOD_US);

        let (ticks, sum_us) = self.compared;
        let due_us = u32::from(COMPARE_TICKS) * PERIOD_US;
        // As much as may be compared without doubt that it is wrong; and the sum cannot overflow.
        let (ticks, sum_us) = (ticks + 1, sum_us + passed_us.min(due_us));
        let is_due = ticks >= COMPARE_TICKS;
        self.compared = if is_due { (0, 0) } else { (ticks, sum_us) };
        let percent = (sum_us + due_us / 200) / (due_us / 100);
        Beat {
            now_us: self.us,
            contradicts: self.odd >= MAX_ODD && stands("time_base"),
            apart_percent: (is_due && sum_us.abs_diff(due_us) > due_us / 20).then_some(percent),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    const SET_POINT: SetPoint = SetPoint::escon(5.0);

    #[test]
    fn duty_spans_10_to_90_percent_and_nothing_leaves_it() {
        let duty = |current_a| SET_POINT.duty(current_a, 42_000);
        assert_eq!(SET_POINT.none(42_000), 21_000);
        assert_eq!(duty(0.0), 21_000);
        assert_eq!(duty(-0.0), 21_000);
        assert_eq!(duty(5.0), 37_800);
        assert_eq!(duty(-5.0), 4_200);
        assert_eq!(duty(2.5), 29_400);
        assert_eq!(duty(f32::NAN), 21_000);
        for bits in (0..=u32::MAX).step_by(65_521) {
            let value = duty(f32::from_bits(bits));
            assert!((4_200..=37_800).contains(&value), "{bits:#x} gives {value}");
        }
    }

    #[test]
    fn the_other_polarity_is_the_mirror_image() {
        let turned = SetPoint {
            backwards: 0.9,
            forwards: 0.1,
            ..SET_POINT
        };
        for current_a in [-7.0, -5.0, -1.0, 0.0, 0.3, 5.0, 9.0, f32::NAN] {
            let (duty, other) = (
                SET_POINT.duty(-current_a, 42_000),
                turned.duty(current_a, 42_000),
            );
            assert_eq!(duty, other, "{current_a}");
        }
    }

    /// What the manufacturer says that the amplifier takes: 10 Hz to 5 kHz.
    #[test]
    fn pulses_come_as_fast_as_the_amplifier_takes_them() {
        assert!((10..=5000).contains(&SET_POINT.frequency_hz));
    }

    /// The line, tick by tick, with the flag as the timer keeps it: it follows an opening at any time.
    #[test]
    fn a_stop_shorter_than_a_tick_is_not_missed() {
        let mut flag = false;
        let mut told = Vec::new();
        // Opened since the tick before; open when the tick looks.
        for (opened, open) in [
            (false, false),
            (true, false),
            (false, false),
            (true, true),
            (false, true),
            (false, false),
            (false, false),
        ] {
            flag |= opened || open;
            let line = StopLine {
                open,
                tripped: flag,
            };
            told.push(line.pressed());
            flag &= !line.clears_flag();
        }
        assert_eq!(told, [false, true, false, true, true, true, false]);
    }

    #[test]
    fn a_16_bit_counter_is_followed_across_its_ends() {
        let mut counter = Counter16::default();
        let mut truth = 0_i32;
        // Steps up to the largest that can be told apart, both ways, far beyond 16 bits.
        for step in [
            1, -1, 300, -70, 32_767, 32_767, 32_767, -32_768, -32_768, -32_768, -32_768, 5,
        ] {
            truth += step;
            assert_eq!(counter.widen(truth as u16), truth);
        }
    }

    /// A clock with a counter of 21 counts a microsecond, and what it says when the ticks are as long as that \[us\].
    fn beats(lengths_us: impl IntoIterator<Item = u32>) -> Vec<Beat> {
        let mut counter = 7_u32;
        let mut clock = TickClock::<21>::new(counter);
        let beat = |length_us: u32| {
            counter = counter.wrapping_sub(21 * length_us) & 0x00FF_FFFF;
            clock.tick(counter)
        };
        lengths_us.into_iter().map(beat).collect()
    }

    #[test]
    fn console_time_is_the_count_of_ticks() {
        // An hour, through many turns of the counter, with the jitter of interrupts.
        let jitter = |tick: u32| {
            1000 + [0, 40, 10, 0, 90, 3][tick as usize % 6] - if tick % 6 == 5 { 143 } else { 0 }
        };
        let beats = beats((0..3_600_000).map(jitter));
        for (beat, tick) in beats.iter().zip(1..) {
            assert_eq!(beat.now_us, 1000 * tick);
            assert!(!beat.contradicts && beat.apart_percent.is_none(), "{tick}");
        }
    }

    #[test]
    fn ticks_that_an_interrupt_swallowed_are_counted() {
        // Two periods lost, then the rest in time.
        let times: Vec<_> = beats([1000, 3100, 900, 1000])
            .iter()
            .map(|beat| beat.now_us)
            .collect();
        assert_eq!(times, [1000, 4000, 5000, 6000]);
    }

    /// A counter that a debugger has stopped, or that races: time goes on with the ticks, and the third one is a fault.
    #[test]
    fn a_counter_that_stands_or_races_is_a_fault_in_the_third_tick_and_time_goes_on() {
        for length_us in [0, 1, 499, 10_001, 700_000] {
            let beats = beats([1000, 1000].into_iter().chain([length_us; 40]));
            for (beat, tick) in beats.iter().zip(1..) {
                assert_eq!(beat.now_us, 1000 * tick, "{length_us} us");
                assert_eq!(beat.contradicts, tick >= 5, "{length_us} us, tick {tick}");
            }
        }
        // Two in a row are none, and what can be believed ends it.
        let beats = beats([1, 1, 1000, 20_000, 1, 1000, 500, 10_000, 500]);
        assert!(!beats.iter().any(|beat| beat.contradicts));
    }

    #[test]
    fn clocks_that_drift_apart_are_told_of_every_hundred_ticks() {
        for (length_us, said) in [
            (1000, None),
            (1049, None),
            (951, None),
            (1060, Some(106)),
            (900, Some(90)),
        ] {
            let beats = beats([length_us; 300]);
            for (beat, tick) in beats.iter().zip(1..) {
                let due = tick % 100 == 0;
                assert_eq!(
                    beat.apart_percent,
                    said.filter(|_| due),
                    "{length_us} us, tick {tick}"
                );
                assert!(!beat.contradicts);
            }
        }
    }
}
