//! Numbers to and from the motor timer, the encoder timers and the tick timer.
//!
//! Entry points: [`SetPoint`], [`PulseTimer`], [`StopLine`], [`Counter16`], [`TickClock`].

use sutura_shared::device::DeviceError;
use sutura_shared::mutant::stands;
use sutura_shared::wire::validate::MAX_CURRENT;

/// How an amplifier reads a set point from the width of its pulses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SetPoint {
    /// Pulses a second \[Hz\].
    pub frequency_hz: u32,
    /// Fewest and most of them that the amplifier takes \[Hz\].
    pub takes_hz: [u32; 2],
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
    /// value"). 4 kHz: inside that, and about 2 % on a straight line between the two.
    pub const fn escon(full_scale_a: f32) -> SetPoint {
        SetPoint {
            frequency_hz: 4000,
            takes_hz: [10, 5000],
            backwards: 0.1,
            forwards: 0.9,
            full_scale_a,
        }
    }

    /// The same with so many pulses a second \[Hz\]: fewer are told more exactly, and later.
    pub const fn at(self, frequency_hz: u32) -> SetPoint {
        SetPoint {
            frequency_hz,
            ..self
        }
    }

    /// How old a set point is when it acts, on average \[us\]: half a pulse until the timer takes it, and a pulse until the amplifier
    /// has measured it.
    pub const fn delay_us(&self) -> u32 {
        match self.frequency_hz {
            0 => u32::MAX,
            frequency_hz => 1_500_000 / frequency_hz,
        }
    }

    /// Checks that an amplifier can read it, and that one whose pulses have stopped reads no current.
    ///
    /// # Errors
    /// [`DeviceError`] names the first field that is not as it must be.
    pub const fn check(&self) -> Result<(), DeviceError> {
        let [least_hz, most_hz] = self.takes_hz;
        if self.frequency_hz < least_hz || self.frequency_hz > most_hz || self.frequency_hz == 0 {
            return wrong("frequency_hz", "a frequency that the amplifier takes");
        }
        // No pulses are 0 %, and a line that is stuck may be 100.
        if !is_within(self.backwards, 0.01, 0.99) {
            return wrong("backwards", "a part of the period, 0.01 to 0.99");
        }
        if !is_within(self.forwards, 0.01, 0.99) {
            return wrong("forwards", "a part of the period, 0.01 to 0.99");
        }
        if (self.forwards - self.backwards).abs() < LEAST_SPAN {
            return wrong("forwards", "a tenth of the period from backwards or more");
        }
        if !is_within(self.full_scale_a, 1e-3, MAX_CURRENT) {
            return wrong("full_scale_a", "0.001 to 1000 A");
        }
        Ok(())
    }

    /// Counts of no current, of `period` counts.
    pub const fn none(&self, period: u16) -> u16 {
        (0.5 * (self.backwards + self.forwards) * period as f32 + 0.5) as u16
    }

    /// Fewest and most counts of a pulse, of `period` counts: what is beyond them by a hair is a fault to the amplifier.
    const fn ends(&self, period: u16) -> [u16; 2] {
        let turned = self.forwards < self.backwards;
        let (low, high) = if turned {
            (self.forwards, self.backwards)
        } else {
            (self.backwards, self.forwards)
        };
        let least = low * period as f32;
        let cut = least as u16;
        let up = if (cut as f32) < least { 1 } else { 0 };
        [cut + up, (high * period as f32) as u16]
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
        let [least, most] = self.ends(period);
        let counts = ((middle + half * share) * f32::from(period) + 0.5) as u16;
        counts.max(least).min(most)
    }
}

/// Least part of the period between full current one way and the other: less is told too coarsely.
const LEAST_SPAN: f32 = 0.1;

const fn is_within(value: f32, least: f32, most: f32) -> bool {
    value >= least && value <= most
}

const fn wrong(field: &'static str, rule: &'static str) -> Result<(), DeviceError> {
    Err(DeviceError {
        joint: None,
        field,
        rule,
    })
}

/// How a timer of 16 bits makes pulses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PulseTimer {
    /// The timer's clock is divided by one more than this.
    pub prescaler: u16,
    /// Counts of a period.
    pub period: u16,
}

/// Fewest counts of a period: a current is told to a part in a hundred of the least span.
const LEAST_COUNTS: u32 = 1000;

impl PulseTimer {
    /// As many counts a period as there can be.
    ///
    /// # Errors
    /// [`DeviceError`] if the timer's clock is too slow for that frequency, or there is none.
    pub const fn new(clock_hz: u32, frequency_hz: u32) -> Result<PulseTimer, DeviceError> {
        let counts = match frequency_hz {
            0 => 0,
            frequency_hz => clock_hz / frequency_hz,
        };
        if counts < LEAST_COUNTS {
            return Err(DeviceError {
                joint: None,
                field: "frequency_hz",
                rule: "at most a thousandth of the timer's clock",
            });
        }
        let prescaler = counts >> 16;
        Ok(PulseTimer {
            prescaler: prescaler as u16,
            period: (counts / (prescaler + 1)) as u16,
        })
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

    /// Numbers from 0 to 1, always the same.
    fn draws() -> impl FnMut() -> f32 {
        let mut seed = 1_u32;
        move || {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (seed >> 8) as f32 / (1 << 24) as f32
        }
    }

    /// Set points of any frequency, span and polarity that are admissible, on timers of any period: pulses stay within the span, no
    /// current is its middle, more current is a longer pulse forwards, and the other polarity is the mirror image.
    #[test]
    fn any_admissible_set_point_keeps_its_pulses_within_its_span() {
        let mut draw = draws();
        let (mut admissible, mut turned_round) = (0, 0);
        while admissible < 20_000 {
            let set_point = SetPoint {
                frequency_hz: (10.0 * 2000.0_f32.powf(draw())) as u32,
                takes_hz: [10, 20_000],
                backwards: draw(),
                forwards: draw(),
                full_scale_a: 0.1 + 30.0 * draw(),
            };
            if set_point.check().is_err() {
                continue;
            }
            admissible += 1;
            let timer = PulseTimer::new(168_000_000, set_point.frequency_hz).expect("slow enough");
            let period = timer.period;
            let parts = [set_point.backwards, set_point.forwards].map(f64::from);
            let span = [parts[0].min(parts[1]), parts[0].max(parts[1])];
            let [a, b] = [0, 1].map(|_| 2.0 * set_point.full_scale_a * (2.0 * draw() - 1.0));
            for current_a in [a, b, f32::MAX, f32::MIN, f32::INFINITY, f32::NAN, -0.0] {
                let counts = set_point.duty(current_a, period);
                let part = f64::from(counts) / f64::from(period);
                // Half a count of single precision.
                let hair = 0.01 / f64::from(period);
                assert!(
                    part >= span[0] - hair && part <= span[1] + hair,
                    "{set_point:?}: {current_a} A are {counts} of {period}"
                );
                let scale = f64::from(set_point.full_scale_a);
                let share = (f64::from(current_a) / scale).clamp(-1.0, 1.0);
                let share = if share.is_nan() { 0.0 } else { share };
                let wanted = 0.5 * (parts[0] + parts[1]) + 0.5 * share * (parts[1] - parts[0]);
                let off = (part - wanted).abs() * f64::from(period);
                assert!(
                    off <= 1.01,
                    "{set_point:?}: {current_a} A is off by {off} counts"
                );
            }
            assert_eq!(set_point.duty(0.0, period), set_point.none(period));
            let forwards = set_point.forwards > set_point.backwards;
            turned_round += u32::from(!forwards);
            let rises = set_point.duty(a.max(b), period) >= set_point.duty(a.min(b), period);
            let falls = set_point.duty(a.max(b), period) <= set_point.duty(a.min(b), period);
            assert!(if forwards { rises } else { falls }, "{set_point:?}");
            let other = SetPoint {
                backwards: set_point.forwards,
                forwards: set_point.backwards,
                ..set_point
            };
            let apart = other.duty(a, period).abs_diff(set_point.duty(-a, period));
            assert!(apart <= 1, "{set_point:?}: {apart} counts apart");
        }
        assert!((5000..15_000).contains(&turned_round), "{turned_round}");
    }

    /// 10 Hz to 5 kHz are what the manufacturer says that the amplifier takes.
    #[test]
    fn what_an_amplifier_cannot_read_is_refused_by_its_field() {
        assert_eq!(SET_POINT.check(), Ok(()));
        assert_eq!(SET_POINT.at(1000).check(), Ok(()));
        type Change = fn(&mut SetPoint);
        let refused: [(&str, Change); 12] = [
            ("frequency_hz", |s| s.frequency_hz = 20_000),
            ("frequency_hz", |s| s.frequency_hz = 9),
            ("frequency_hz", |s| {
                (s.frequency_hz, s.takes_hz) = (0, [0, 0])
            }),
            ("backwards", |s| s.backwards = 0.0),
            ("backwards", |s| s.backwards = f32::NAN),
            ("forwards", |s| s.forwards = 1.0),
            ("forwards", |s| s.forwards = f32::NAN),
            ("forwards", |s| s.forwards = s.backwards),
            ("forwards", |s| s.forwards = s.backwards + 0.09),
            ("full_scale_a", |s| s.full_scale_a = 0.0),
            ("full_scale_a", |s| s.full_scale_a = -5.0),
            ("full_scale_a", |s| s.full_scale_a = f32::INFINITY),
        ];
        for (field, change) in refused {
            let mut set_point = SET_POINT;
            change(&mut set_point);
            let error = set_point.check().expect_err(field);
            assert_eq!(error.field, field, "{set_point:?}");
        }
    }

    #[test]
    fn a_set_point_acts_a_pulse_and_a_half_later() {
        assert_eq!(SET_POINT.delay_us(), 375);
        assert_eq!(SET_POINT.at(1000).delay_us(), 1500);
        assert_eq!(SET_POINT.at(0).delay_us(), u32::MAX);
    }

    #[test]
    fn a_timer_takes_as_many_counts_as_16_bits_have_room_for() {
        let timer = |frequency_hz| PulseTimer::new(168_000_000, frequency_hz);
        let is = |prescaler, period| Ok(PulseTimer { prescaler, period });
        assert_eq!(timer(4000), is(0, 42_000));
        assert_eq!(timer(1000), is(2, 56_000));
        for frequency_hz in 10..=168_000 {
            let timer = timer(frequency_hz).expect("within its range");
            let counts = (u32::from(timer.prescaler) + 1) * u32::from(timer.period);
            let made_hz = 168e6 / f64::from(counts);
            let error = made_hz / f64::from(frequency_hz) - 1.0;
            assert!(error.abs() < 1e-3, "{frequency_hz} Hz: {timer:?}");
            assert!(timer.prescaler == 0 || timer.period > 32_000, "{timer:?}");
        }
        for frequency_hz in [0, 168_001, u32::MAX] {
            assert!(timer(frequency_hz).is_err(), "{frequency_hz}");
        }
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
