//! A lead that does not take the device's description at its word: more of it while a grip in contact swings and does not
//! calm down.
//!
//! Entry point: [`Swing::watch`], once in every tick. A force that acts a time t later than it is led by is a damper of -K t on a
//! contact of stiffness K (Colgate and Schenkel 1997), whether an amplifier's filter, a tick of a bus or a strong motor is to
//! blame: the grip swings at its own frequency, and goes on. A longer lead is a damper of the other sign. It is learnt half-wave
//! by half-wave, taken back where it is too long, which makes quick swings, and forgotten if it does not help: then a hand swings on
//! purpose, or trembles. What was learnt lasts as long as the console is armed.

use super::TICK_S;
use crate::math::{Vec3, dot, max, min};
use core::f32::consts::PI;

/// Time constant of what is no swing of a speed \[s\].
const SLOW_S: f32 = 0.03;
/// Longest half-wave of a swing \[ticks\]: hands go to and fro more slowly.
const LONGEST: u16 = 120;
/// The same in terms of the console's own frequency on that contact, as the square of their ratio: a mass that is one with the grip
/// makes it slower by so much.
const HEAVIER: f32 = 2.6;
/// Half-waves of at most so many ticks are those of too long a lead, and of at least so many those of too short a one.
const QUICK: u16 = 8;
const LATE: u16 = 11;
/// Smallest swing that counts, the smallest that is nothing that encoders make, and one that a hand cannot but feel, in their steps.
const SMALLEST: f32 = 2.0;
const PLAIN: f32 = 3.0;
const LARGE: f32 = 10.0;
/// Part of what it was one wave before that a swing must have to be the same.
const KEPT: f32 = 0.9;
/// Half-waves in a row until a large swing is one, a plain one, and a small one.
const LARGE_SAME: u16 = 3;
const SAME: u16 = 4;
const SMALL_SAME: u16 = 12;
/// What a half-wave changes of the lead, twice as much if it is large, and the most that is added to it \[s\].
const STEP_S: f32 = 0.05e-3;
const MOST_S: f32 = 2.5e-3;
/// Half-waves with all the lead that there is, after which it did not help.
const IN_VAIN: u16 = 4;
/// Force above which a bounce has begun \[N\], and part of its largest below which it is over: what a swap has left fades for a while.
const LIGHT_N: f32 = 0.05;
const FADED: f32 = 0.05;
/// Slower bounces tell nothing \[m/s\].
const SLOWEST: f32 = 0.02;
/// Half-wave of a bounce, as the square of its ratio to the console's own: from one that is bent to that of a mass one with the grip.
const BOUNCES: (f32, f32) = (0.4, 4.0);
/// Depth of a bounce over that of a sine with its speed and time: a hand that taps stays, or turns at once.
const DEPTH: (f32, f32) = (0.8, 2.0);
/// Speed on the way out over that on the way in from which on a bounce has been given energy, and bounces in a row until it is no hand.
const GIVEN: f32 = 1.02;
const SAME_BOUNCES: u16 = 2;
/// Part of the delay that a bounce tells which is added to the lead, and the most of one bounce \[s\].
const LEARNT: f32 = 0.7;
const BOUNCE_S: f32 = 0.4e-3;
/// Share of the lead that is forgotten in a tick: a time constant of half a minute.
const LEAK: f32 = TICK_S / 30.0;

/// What a console is in one direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Along {
    /// Square of the angular frequency that it has on the present contact by itself \[1/s^2\].
    pub square_per_s2: f32,
    /// Least way that its encoders tell \[m\].
    pub step_m: f32,
}

/// What is known of the device, and of the swing that there is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Swing {
    /// Along the newest force, of length 1.
    direction: Vec3,
    /// What is no swing of the speed \[m/s\].
    slow: f32,
    wave: HalfWave,
    /// Of the half-waves before this one, the newest first: how fast at most \[m/s\]; and whether there was a force.
    peaks: [f32; 2],
    touched: bool,
    /// Half-waves in a row that did not calm down, and of these, those with all the lead that there is.
    same: u16,
    in_vain: u16,
    bounce: Bounce,
    /// Bounces in a row that were given energy.
    bounces: u16,
    /// What is added to the lead \[s\].
    lead_s: f32,
}

/// Contact since it began.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Bounce {
    ticks: u16,
    /// Largest force \[N\], and way in \[m\].
    most_n: f32,
    deep_m: f32,
    /// Largest speed on the way in and out \[m/s\].
    inward: f32,
    outward: f32,
    /// Square of the console's own angular frequency where it turned \[1/s^2\].
    square_per_s2: f32,
}

impl Bounce {
    const NONE: Bounce = Bounce {
        ticks: 0,
        most_n: 0.0,
        deep_m: 0.0,
        inward: 0.0,
        outward: 0.0,
        square_per_s2: 0.0,
    };

    /// By how much later than described the force acted \[s\], if it has given energy: a delay t is a damper of -K t, with which half a
    /// wave of the angular frequency w ends exp(pi w t / 2) times as fast as it began.
    fn late_s(&self) -> Option<f32> {
        let half_s = f32::from(self.ticks) * TICK_S;
        let radian_s = half_s * (1.0 / PI);
        let ratio = radian_s * radian_s * self.square_per_s2;
        let is_own = (BOUNCES.0..BOUNCES.1).contains(&ratio);
        let sine_m = self.inward * radian_s;
        let is_sine = (DEPTH.0 * sine_m..DEPTH.1 * sine_m).contains(&self.deep_m);
        if !is_own || !is_sine || self.inward < SLOWEST || self.outward < GIVEN * self.inward {
            return None;
        }
        // The logarithm of their ratio, to its third order.
        let log = 2.0 * (self.outward - self.inward) / (self.outward + self.inward);
        Some((2.0 / PI) * radian_s * log)
    }
}

/// The half-wave so far.
#[derive(Clone, Copy, Debug, PartialEq)]
struct HalfWave {
    outward: bool,
    ticks: u16,
    /// How fast at most \[m/s\].
    peak: f32,
    /// Whether there was a force in any of its ticks, and in all.
    touched: bool,
    held: bool,
}

impl HalfWave {
    const fn new(outward: bool) -> Self {
        HalfWave {
            outward,
            ticks: 0,
            peak: 0.0,
            touched: false,
            held: true,
        }
    }
}

impl Swing {
    /// Nothing has swung yet.
    pub const NONE: Swing = Swing {
        direction: Vec3::new(0.0, 0.0, 1.0),
        slow: 0.0,
        wave: HalfWave::new(false),
        peaks: [0.0; 2],
        touched: false,
        same: 0,
        in_vain: 0,
        bounce: Bounce::NONE,
        bounces: 0,
        lead_s: 0.0,
    };

    /// What is to be added to the lead \[s\].
    pub fn lead_s(&self) -> f32 {
        self.lead_s
    }

    /// Takes note of a tick: force \[N\], velocity of the grip \[m/s\], and what the console is in a direction of length 1.
    pub fn watch(&mut self, force: &Vec3, velocity: &Vec3, along: impl Fn(&Vec3) -> Along) {
        let size = libm::sqrtf(dot(force, force));
        if size > 0.0 {
            self.direction = force * (1.0 / size);
        }
        let speed = dot(&self.direction, velocity);
        self.watch_bounce(size, speed, &along);
        self.slow += (speed - self.slow) * (TICK_S / SLOW_S);
        let swing = speed - self.slow;
        self.lead_s -= self.lead_s * LEAK;
        let wave = &mut self.wave;
        wave.ticks = wave.ticks.saturating_add(1);
        wave.touched |= size > 0.0;
        wave.held &= size > 0.0;
        let outward = swing > 0.0;
        if outward != wave.outward {
            let along = along(&self.direction);
            self.judge(&along);
            self.peaks = [self.wave.peak, self.peaks[0]];
            self.touched = self.wave.touched;
            self.wave = HalfWave::new(outward);
        }
        self.wave.peak = max(self.wave.peak, swing.abs());
    }

    /// A contact that begins and ends as a mass on a spring does must not end faster than it began.
    fn watch_bounce(&mut self, size: f32, speed: f32, along: impl Fn(&Vec3) -> Along) {
        let bounce = &mut self.bounce;
        if size > max(LIGHT_N, FADED * bounce.most_n) {
            bounce.most_n = max(bounce.most_n, size);
            bounce.ticks = bounce.ticks.saturating_add(1);
            bounce.deep_m += max(-speed, 0.0) * TICK_S;
            bounce.inward = max(bounce.inward, -speed);
            bounce.outward = max(bounce.outward, speed);
            if speed > 0.0 && bounce.square_per_s2 <= 0.0 {
                bounce.square_per_s2 = along(&self.direction).square_per_s2;
            }
            return;
        }
        if bounce.ticks == 0 {
            return;
        }
        let late_s = core::mem::replace(bounce, Bounce::NONE).late_s();
        let Some(late_s) = late_s else {
            self.bounces = 0;
            return;
        };
        self.bounces = self.bounces.saturating_add(1);
        if self.bounces >= SAME_BOUNCES {
            self.lead_s = min(self.lead_s + min(LEARNT * late_s, BOUNCE_S), MOST_S);
        }
    }

    /// A half-wave is over.
    fn judge(&mut self, along: &Along) {
        let HalfWave { ticks, peak, .. } = self.wave;
        // The radian of a sine with such a half-wave.
        let radian_s = f32::from(ticks) * (TICK_S / PI);
        let is_own = ticks <= LONGEST && radian_s * radian_s * along.square_per_s2 < HEAVIER;
        let steps = peak * radian_s / along.step_m;
        let same = if steps > LARGE {
            LARGE_SAME
        } else if steps > PLAIN {
            SAME
        } else {
            SMALL_SAME
        };
        // One that leaves the tissue loses little, delay or none: only what grows is a swing then.
        let kept = if self.wave.held { KEPT } else { 1.0 };
        let touches = self.wave.touched || self.touched;
        if !(is_own && touches && steps > SMALLEST && peak > kept * self.peaks[1]) {
            (self.same, self.in_vain) = (0, 0);
            return;
        }
        self.same = self.same.saturating_add(1);
        if self.same < same {
            return;
        }
        let step_s = if steps > LARGE { 2.0 * STEP_S } else { STEP_S };
        if self.in_vain >= IN_VAIN {
            self.lead_s = 0.0;
        } else if ticks <= QUICK {
            self.lead_s = max(self.lead_s - step_s, 0.0);
        } else if ticks >= LATE {
            self.lead_s = min(self.lead_s + step_s, MOST_S);
            self.in_vain += u16::from(self.lead_s >= MOST_S);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A console of 0.1 kg with steps of 10 um.
    const MASS_KG: f32 = 0.1;
    const STEP_M: f32 = 10e-6;

    /// Watches a mass on a spring of `stiffness` \[N/m\] that is pressed by 1 N and moves to and fro by `size` \[m\] with
    /// `hz`, growing by `growth` a second, for some seconds.
    fn after(seconds: f32, stiffness: f32, size: f32, hz: f32, growth: f32) -> Swing {
        let mut swing = Swing::NONE;
        let along = |_: &Vec3| Along {
            square_per_s2: stiffness / MASS_KG,
            step_m: STEP_M,
        };
        for tick in 0..(seconds / TICK_S) as u32 {
            let t = tick as f32 * TICK_S;
            let w = 2.0 * PI * hz;
            let size = size * libm::expf(growth * t);
            let depth = 1.0 / stiffness + size * libm::sinf(w * t);
            let force = Vec3::new(0.0, 0.0, max(0.0, depth * stiffness));
            let velocity = Vec3::new(0.0, 0.0, -size * w * libm::cosf(w * t));
            swing.watch(&force, &velocity, along);
        }
        swing
    }

    fn own_hz(stiffness: f32) -> f32 {
        libm::sqrtf(stiffness / MASS_KG) / (2.0 * PI)
    }

    #[test]
    fn what_swings_and_does_not_calm_down_is_led_by_more() {
        let hz = own_hz(2000.0);
        let lead_s = after(0.3, 2000.0, 50e-6, hz, 0.0).lead_s();
        assert!(lead_s > 0.5e-3 && lead_s < MOST_S, "{lead_s}");
        // A mass that is one with the grip makes it slower.
        assert!(after(0.3, 2000.0, 50e-6, 0.7 * hz, 0.0).lead_s() > 0.0);
        // Calms down by a fifth in a wave.
        assert_eq!(after(0.3, 2000.0, 200e-6, hz, -0.2 * hz).lead_s(), 0.0);
    }

    #[test]
    fn hands_encoders_and_what_a_lead_does_not_help_are_left_alone() {
        // A press at 2 Hz, 5 mm deep; and so much of an encoder's step.
        assert_eq!(after(3.0, 300.0, 3e-3, 2.0, 0.0).lead_s(), 0.0);
        let hz = own_hz(2000.0);
        assert_eq!(after(3.0, 2000.0, 8e-6, hz, 0.0).lead_s(), 0.0);
        // Small ones count if they last.
        assert_eq!(after(0.2, 2000.0, 25e-6, hz, 0.0).lead_s(), 0.0);
        assert!(after(0.5, 2000.0, 25e-6, hz, 0.0).lead_s() > 0.0);
        // It was no delay: all of it is taken back for as long as that swing lasts.
        assert_eq!(after(3.0, 2000.0, 50e-6, hz, 0.0).lead_s(), 0.0);
    }

    #[test]
    fn quick_swings_take_it_back_and_time_does() {
        let mut swing = after(0.3, 2000.0, 50e-6, own_hz(2000.0), 0.0);
        let before_s = swing.lead_s();
        let along = |_: &Vec3| Along {
            square_per_s2: 1e4,
            step_m: STEP_M,
        };
        let force = Vec3::new(0.0, 0.0, 1.0);
        let still = Vec3::zeros();
        for _ in 0..30_000 {
            swing.watch(&force, &still, along);
        }
        let left = swing.lead_s() / before_s;
        assert!((left - 0.368).abs() < 0.01, "{left}");
        for tick in 0..200 {
            let speed = if tick % 8 < 4 { 0.05 } else { -0.05 };
            swing.watch(&force, &Vec3::new(0.0, 0.0, speed), along);
        }
        assert_eq!(swing.lead_s(), 0.0);
    }

    /// Bounces on 1500 N/m, each so many times as fast on its way out as on its way in.
    fn after_bounces(count: u32, grows: f32, ticks: u16) -> f32 {
        let mut swing = Swing::NONE;
        let along = |_: &Vec3| Along {
            square_per_s2: 1500.0 / MASS_KG,
            step_m: STEP_M,
        };
        let mut size = 0.1;
        for _ in 0..count {
            for tick in 0..ticks {
                let w = PI * f32::from(tick) / f32::from(ticks);
                let force = Vec3::new(0.0, 0.0, libm::sinf(w));
                let speed = -size * libm::cosf(w);
                swing.watch(&force, &Vec3::new(0.0, 0.0, speed), along);
                if 2 * tick == ticks {
                    size *= grows;
                }
            }
            for tick in 0..60_u16 {
                let speed = size * (1.0 - f32::from(tick) / 30.0);
                swing.watch(&Vec3::zeros(), &Vec3::new(0.0, 0.0, speed), along);
            }
        }
        swing.lead_s()
    }

    #[test]
    fn bounces_that_are_given_energy_are_led_by_more() {
        // Half a wave of 0.1 kg on 1500 N/m takes 26 ms, and one of 1 ms late ends exp(0.19) times as fast.
        assert_eq!(after_bounces(1, 1.2, 26), 0.0);
        let lead_s = after_bounces(2, 1.2, 26);
        assert!((0.1e-3..=BOUNCE_S).contains(&lead_s), "{lead_s}");
        assert_eq!(after_bounces(5, 0.95, 26), 0.0);
        // A hand that taps takes its time.
        assert_eq!(after_bounces(5, 1.2, 80), 0.0);
    }
}
