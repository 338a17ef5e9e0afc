//! The hands of the measurements, by name: where they want the grip, and how firmly they hold it.
//!
//! Entry points: [`Motion::at`], [`Grasp`].

use std::f64::consts::PI;

/// Way of the grip in the frame of a scene: x along the skin, z out of it, 0 where the tool touches.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Motion {
    /// 1 Hz from 2 mm above the skin to 10 mm deep.
    Presses,
    /// 0.25 m/s from 10 mm above the skin to 5 mm deep, 80 ms there, and back, 2.5 times a second.
    Taps,
    /// 5 mm deep, then from 0.6 s on, at once, 20 mm to either side at 0.1 m/s.
    Strokes,
    /// 5 mm deep, then 1 mm up and down at 8 Hz.
    Tremor,
    /// 10 mm deep in half a second, held there.
    Hold,
    /// 6 mm deep in half a second, held there.
    Inside,
    /// Drawn out at 7.3 mm/s, and to and fro by 6 mm at 1 Hz: lets go by 2.8 mm and pulls again by 10 mm.
    Pulls,
    /// 70 mm up and down at 4 Hz: 1.8 m/s, which no console should go along with.
    Throw,
    /// 40 mm up and down at 4 Hz: 1 m/s, as fast as a hand goes.
    Swing,
    /// 2 mm deep in a round body of 8 mm, then from 0.6 s on around it, all the way, at 0.1 m/s.
    RoundThin,
    /// The same around one of 20 mm.
    RoundThick,
    /// That deep, then for 0.2 s down by `size_nm` and back in every two milliseconds, straight in between.
    Rattle {
        /// \[nm\].
        depth_nm: u32,
        /// \[nm\].
        size_nm: u32,
    },
}

impl Motion {
    /// Those whose errors are published.
    pub const NAMED: [Motion; 4] = [
        Motion::Presses,
        Motion::Taps,
        Motion::Strokes,
        Motion::Tremor,
    ];

    /// When [`Motion::Rattle`] begins and ends to rattle \[ms\].
    pub const RATTLES_MS: [usize; 2] = [250, 450];

    /// As tables print it.
    pub fn name(self) -> &'static str {
        match self {
            Motion::Presses => "presses",
            Motion::Taps => "taps",
            Motion::Strokes => "strokes",
            Motion::Tremor => "tremor",
            Motion::Hold => "hold",
            Motion::Inside => "inside",
            Motion::Pulls => "pulls",
            Motion::Throw => "throw",
            Motion::Swing => "swing",
            Motion::RoundThin | Motion::RoundThick => "round",
            Motion::Rattle { .. } => "rattle",
        }
    }

    /// Where the hand wants the grip \[m\], (3).
    pub fn at(self, time_s: f64) -> [f64; 3] {
        match self {
            Motion::Presses => [
                0.0,
                0.0,
                2e-3 - 12e-3 * 0.5 * (1.0 - (2.0 * PI * time_s).cos()),
            ],
            Motion::Taps => {
                let phase = time_s.rem_euclid(0.4);
                let down = way(phase - 0.1, 60e-3) - way(phase - 0.24, 60e-3);
                [0.0, 0.0, 10e-3 - 0.25 * down]
            }
            Motion::Strokes => {
                let side = triangle((time_s - 0.6).max(0.0), 20e-3, 0.1, 40e-3);
                [side, 0.0, 2e-3 - 7e-3 * ramp(time_s / 0.5)]
            }
            Motion::Tremor => {
                let shake = ramp((time_s - 0.5) / 0.2) * 1e-3 * (16.0 * PI * time_s).sin();
                [0.0, 0.0, 2e-3 - 7e-3 * ramp(time_s / 0.5) + shake]
            }
            Motion::Hold => [0.0, 0.0, 2e-3 - 12e-3 * ramp(time_s / 0.5)],
            Motion::Inside => [0.0, 0.0, 2e-3 - 8e-3 * ramp(time_s / 0.5)],
            Motion::Pulls => {
                let back = 3e-3 * (1.0 - (2.0 * PI * time_s).cos());
                [0.0, 0.0, 22e-3 / 3.0 * time_s - back]
            }
            Motion::Throw => [0.0, 0.0, 70e-3 * (8.0 * PI * time_s).cos()],
            Motion::Swing => [0.0, 0.0, 40e-3 * (8.0 * PI * time_s).cos()],
            Motion::RoundThin => around(time_s, 8e-3),
            Motion::RoundThick => around(time_s, 20e-3),
            Motion::Rattle { depth_nm, size_nm } => {
                let [from_ms, until_ms] = Motion::RATTLES_MS.map(|ms| ms as f64);
                let since_ms = (1e3 * time_s).clamp(from_ms, until_ms) - from_ms;
                let down = 1.0 - (since_ms.rem_euclid(2.0) - 1.0).abs();
                let deep_m = 1e-9 * (f64::from(depth_nm) + f64::from(size_nm) * down);
                [0.0, 0.0, 2e-3 - (deep_m + 2e-3) * ramp(5.0 * time_s)]
            }
        }
    }

    /// Its velocity \[m/s\], (3).
    pub fn velocity(self, time_s: f64) -> [f64; 3] {
        const STEP_S: f64 = 1e-5;
        let (before, after) = (self.at(time_s - STEP_S), self.at(time_s + STEP_S));
        [0, 1, 2].map(|axis: usize| (after[axis] - before[axis]) / (2.0 * STEP_S))
    }
}

/// Around a body of that radius \[m\], in a plane across its axis.
fn around(time_s: f64, radius_m: f64) -> [f64; 3] {
    let away = radius_m + 2e-3 - 4e-3 * ramp(time_s / 0.5);
    let angle = 0.1 * way(time_s - 0.6, f64::INFINITY) / (radius_m - 2e-3);
    [away * angle.sin(), 0.0, away * angle.cos() - radius_m]
}

/// 0 to 1 for 0 to 1, with the least jerk.
pub(super) fn ramp(s: f64) -> f64 {
    let s = s.clamp(0.0, 1.0);
    s * s * s * (10.0 - 15.0 * s + 6.0 * s * s)
}

/// Time since 0, up to `length_s`, without jumps of the speed: 8 ms to start and to stop.
fn way(time_s: f64, length_s: f64) -> f64 {
    const HALF_S: f64 = 4e-3;
    let start = |t: f64| match t {
        t if t <= -HALF_S => 0.0,
        t if t < HALF_S => (t + HALF_S) * (t + HALF_S) / (4.0 * HALF_S),
        t => t,
    };
    start(time_s) - start(time_s - length_s)
}

/// Up and down between -`height` and `height` at `speed`, from 0 upwards, with rounded turns of `turn_s`.
fn triangle(time_s: f64, height: f64, speed: f64, turn_s: f64) -> f64 {
    let quarter = height / speed;
    let phase = (time_s + quarter).rem_euclid(4.0 * quarter);
    // Mirrored: the second half of the period goes down.
    let rise = if phase <= 2.0 * quarter {
        phase
    } else {
        4.0 * quarter - phase
    };
    // A parabola within half a turn of either end, with the slope of the line where they meet.
    let half = 0.5 * turn_s;
    let rounded = |rise: f64| {
        if rise < half {
            (rise * rise + half * half) / (2.0 * half)
        } else {
            rise
        }
    };
    let lower = rounded(rise);
    let upper = 2.0 * quarter - rounded(2.0 * quarter - rise);
    let along = if rise < quarter { lower } else { upper };
    along * speed - height
}

/// How the hand holds the grip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Grasp {
    /// It goes where it wants, whatever the motors do: open loop.
    Rigid,
    /// A spring and a damper between hand and grip: closed loop.
    Spring {
        /// \[N/m\].
        stiffness_n_per_m: f64,
        /// \[N s/m\].
        damping_n_s_per_m: f64,
    },
    /// A mass that moves with the grip and is pushed into the scene, whatever the motion: no spring holds it back.
    Weight {
        /// \[kg\].
        mass_kg: f64,
        /// Reached in half a second \[N\].
        force_n: f64,
    },
}

impl Grasp {
    /// A hand that holds a pen.
    pub const PEN: Grasp = Grasp::Spring {
        stiffness_n_per_m: 200.0,
        damping_n_s_per_m: 2.0,
    };
    /// As tables print it.
    pub fn word(self) -> String {
        match self {
            Grasp::Rigid => "rigid".to_owned(),
            grasp if grasp == Grasp::FREE => "free".to_owned(),
            grasp if grasp == Grasp::PEN => "pen".to_owned(),
            Grasp::Spring {
                stiffness_n_per_m, ..
            } => format!("hand-{stiffness_n_per_m:.0}"),
            Grasp::Weight { mass_kg, .. } => format!("weight-{:.0}-g", 1e3 * mass_kg),
        }
    }

    /// No hand.
    pub const FREE: Grasp = Grasp::Spring {
        stiffness_n_per_m: 0.0,
        damping_n_s_per_m: 0.0,
    };
}

#[cfg(test)]
mod tests {
    use super::*;

    fn highest_speed(motion: Motion, axis: usize) -> f64 {
        let times = (0..40_000).map(|i| f64::from(i) * 1e-4);
        times
            .map(|time| motion.velocity(time)[axis].abs())
            .fold(0.0, f64::max)
    }

    #[test]
    fn the_hands_are_as_fast_as_they_say() {
        let close = |found: f64, expected: f64| {
            assert!((found / expected - 1.0).abs() < 1e-3, "{found} {expected}");
        };
        close(highest_speed(Motion::Presses, 2), PI * 12e-3);
        close(highest_speed(Motion::Taps, 2), 0.25);
        close(highest_speed(Motion::Strokes, 0), 0.1);
        let deepest = |motion: Motion| {
            let times = (0..4000).map(|i| f64::from(i) * 1e-3);
            times.map(|time| motion.at(time)[2]).fold(0.0, f64::min)
        };
        assert!((deepest(Motion::Presses) + 10e-3).abs() < 1e-9);
        assert!((deepest(Motion::Taps) + 5e-3).abs() < 1e-9);
        assert!((deepest(Motion::Tremor) + 6e-3).abs() < 1e-5);
        assert!((deepest(Motion::Strokes) + 5e-3).abs() < 1e-9);
    }

    /// A jump of place or velocity would be a hand that nobody has.
    #[test]
    fn paths_are_smooth() {
        for motion in [
            Motion::Presses,
            Motion::Taps,
            Motion::Strokes,
            Motion::Tremor,
            Motion::Hold,
            Motion::Pulls,
        ] {
            for i in 0..40_000 {
                let time = f64::from(i) * 1e-4;
                // Strokes set off at once.
                if motion == Motion::Strokes && (time - 0.6).abs() < 2e-4 {
                    continue;
                }
                let (a, b) = (motion.velocity(time), motion.velocity(time + 1e-4));
                for axis in 0..3 {
                    // 0.2 m/s turned around in 40 ms, 0.25 m/s gained in 8 ms: 31 m/s^2.
                    let change = (b[axis] - a[axis]).abs();
                    assert!(change < 35.0 * 1e-4, "{motion:?} at {time}: {change}");
                }
            }
        }
    }
}
