//! Numbers to and from the motor timer, the encoder timers and the cycle counter.
//!
//! Entry points: [`duty`], [`StopLine`], [`Counter16`], [`Clock`].

/// Compare value for a motor current, for an amplifier that takes 10 % duty as full current backwards,
/// 50 % as none and 90 % as full current forwards.
///
/// `full_scale_a` is the amplifier's current at 90 % \[A\], `period` the timer's counts per pulse. A current
/// beyond the scale is clamped; NaN means none.
pub fn duty(current_a: f32, full_scale_a: f32, period: u32) -> u32 {
    let share = current_a / full_scale_a;
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
    // Rounded: cut off, 10 % could become a hair less, which the amplifier takes for a fault.
    ((0.5 + 0.4 * share) * period as f32 + 0.5) as u32
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
        self.open || self.tripped
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

/// Microseconds since boot from a 32-bit counter of `PER_US` cycles a microsecond.
///
/// Right as long as it is read before the counter has gone round (25.5 s at 168 MHz).
#[derive(Clone, Copy, Debug)]
pub struct Clock<const PER_US: u32> {
    last: u32,
    cycles: u32,
    us: u64,
}

impl<const PER_US: u32> Clock<PER_US> {
    /// A clock that starts at 0 us when the counter stands at `start`.
    pub const fn new(start: u32) -> Self {
        const { assert!(PER_US > 0) };
        Self {
            last: start,
            cycles: 0,
            us: 0,
        }
    }

    /// Takes the counter's present value and returns the time \[us\].
    pub fn now_us(&mut self, counter: u32) -> u64 {
        let passed = counter.wrapping_sub(self.last);
        self.last = counter;
        self.us += u64::from(passed / PER_US);
        self.cycles += passed % PER_US;
        if self.cycles >= PER_US {
            self.cycles -= PER_US;
            self.us += 1;
        }
        self.us
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    #[test]
    fn duty_spans_10_to_90_percent_and_nothing_leaves_it() {
        assert_eq!(duty(0.0, 5.0, 8400), 4200);
        assert_eq!(duty(-0.0, 5.0, 8400), 4200);
        assert_eq!(duty(5.0, 5.0, 8400), 7560);
        assert_eq!(duty(-5.0, 5.0, 8400), 840);
        assert_eq!(duty(2.5, 5.0, 8400), 5880);
        assert_eq!(duty(f32::NAN, 5.0, 8400), 4200);
        for bits in (0..=u32::MAX).step_by(65_521) {
            let value = duty(f32::from_bits(bits), 5.0, 8400);
            assert!((840..=7560).contains(&value), "{bits:#x} gives {value}");
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

    #[test]
    fn the_clock_loses_nothing_over_many_wraps() {
        let mut clock = Clock::<168>::new(0xFFFF_FF00);
        let mut counter = 0xFFFF_FF00_u32;
        let mut cycles = 0_u64;
        for step in [
            168,
            167,
            1,
            3_000_000_000,
            4_000_000_000,
            4_294_967_295,
            11,
            168_000,
        ] {
            counter = counter.wrapping_add(step);
            cycles += u64::from(step);
            assert_eq!(clock.now_us(counter), cycles / 168);
        }
    }
}
