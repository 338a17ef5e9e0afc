//! The simulation against theory: bounds that are known in closed form, on a plain sampled wall without hand or
//! host.
//!
//! Entry point: [`oracles`]. A wall of stiffness K and damping B, force -K x - B dx/T, on a device with damping b:
//! *stable* below K = (b + B) / (T/2 + t_d) (Gil, Avello, Rubio and Florez 2004, for short delay and low damping);
//! *passive* below K T/2 + |B| = b (Colgate and Schenkel 1997), and with an encoder of step D and Coulomb friction f
//! below K = min(2 b / T, 2 f / D) (Abbott and Okamura 2005). Passive means: no way of the hand, and the worst is
//! tried, gets energy out of wall and device.

use serde::Serialize;

/// One figure against theory.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Oracle {
    /// What.
    pub name: String,
    /// Found.
    pub value: f64,
    /// By theory: the bound itself, or the sign of the energy.
    pub expected: f64,
    /// Of both.
    pub unit: &'static str,
    /// Whether they agree: within 15 %, or in sign.
    pub ok: bool,
}

/// A plain wall on a device of one axis.
#[derive(Clone, Copy, Debug)]
struct Wall {
    /// Device \[kg\], \[N s/m\], \[N\].
    mass: f64,
    damping: f64,
    coulomb: f64,
    /// Step of the encoder \[m\]; 0 for none.
    quantum: f64,
    /// Wall \[N/m\], \[N s/m\].
    stiffness: f64,
    wall_damping: f64,
    /// Sample period and delay of the force, a multiple of it \[s\].
    period: f64,
    delay_periods: usize,
}

/// Steps in a sample period.
const STEPS: usize = 200;

impl Wall {
    const LIGHT: Wall = Wall {
        mass: 0.1,
        damping: 0.5,
        coulomb: 0.0,
        quantum: 0.0,
        stiffness: 0.0,
        wall_damping: 0.0,
        period: 1e-3,
        delay_periods: 0,
    };

    fn seen(&self, x: f64) -> f64 {
        if self.quantum > 0.0 {
            (x / self.quantum).floor() * self.quantum
        } else {
            x
        }
    }

    /// Whether the device comes to rest on the wall after a push: both-sided, so that nothing bounces.
    fn settles(&self) -> bool {
        let (mut x, mut v, mut before) = (0.0, 1e-2, 0.0);
        let mut waiting = vec![0.0; self.delay_periods];
        let h = self.period / STEPS as f64;
        let fade = (-self.damping * h / self.mass).exp();
        // Long enough for growth or decay of a percent in a swing to show.
        let samples = (40.0 / self.period.sqrt()) as usize + 2000;
        let (mut early, mut late) = (0.0_f64, 0.0_f64);
        for sample in 0..samples {
            waiting.push(-self.stiffness * x - self.wall_damping * (x - before) / self.period);
            before = x;
            let force = waiting.remove(0);
            for _ in 0..STEPS {
                // Exact under a constant force and viscous damping.
                let end = force / self.damping;
                let next = end + (v - end) * fade;
                x += end * h + (v - end) * (1.0 - fade) * self.mass / self.damping;
                v = next;
            }
            let energy = v * v * self.mass + self.stiffness * x * x;
            if sample < samples / 2 && sample > samples / 4 {
                early = early.max(energy);
            } else if sample >= 3 * samples / 4 {
                late = late.max(energy);
            }
            if !energy.is_finite() || energy > 1e12 {
                return false;
            }
        }
        late < early
    }

    /// The largest stiffness with which it settles.
    fn stiffest(&self) -> f64 {
        let (mut low, mut high) = (1.0_f64, 1e5_f64);
        while high / low > 1.002 {
            let middle = (low * high).sqrt();
            let wall = Wall {
                stiffness: middle,
                ..*self
            };
            if wall.settles() {
                low = middle;
            } else {
                high = middle;
            }
        }
        low
    }

    /// Energy that a hand gets \[J\], for ways between samples at which it is at `places` \[m\], straight at
    /// constant speed in between; it begins and ends at rest, so that what moves has given back its share.
    fn energy_got(&self, places: &[f64]) -> f64 {
        let mut waiting = vec![0.0; self.delay_periods];
        let mut got = 0.0;
        let mut before = places.first().copied().unwrap_or(0.0);
        for pair in places.windows(2) {
            let (x, way) = (pair[0], pair[1] - pair[0]);
            let seen = self.seen(x);
            waiting.push(-self.stiffness * seen - self.wall_damping * (seen - before) / self.period);
            before = seen;
            let force = waiting.remove(0);
            got += force * way;
            got -= self.damping * way * way / self.period + self.coulomb * way.abs();
        }
        got
    }

    /// The most that any of many ways gets: to and fro at every sample, of all sizes and at all depths, and
    /// random ones.
    fn most_got(&self) -> f64 {
        let mut random = super::random::Random::new(11);
        let mut most = f64::NEG_INFINITY;
        let cells = if self.quantum > 0.0 { self.quantum } else { 1e-4 };
        for size in [1e-3, 1e-2, 0.1, 1.0, 2.0, 10.0, 100.0, 1000.0] {
            for depth in [0.0, 0.5, 1.0, 5.0, 20.0] {
                // From the edge of a step of the encoder, and across it.
                let (high, low) = (-depth * cells, -depth * cells - size * cells);
                let mut places = vec![high; 3];
                for _ in 0..100 {
                    places.extend([low, high]);
                }
                places.extend([high; 3]);
                most = most.max(self.energy_got(&places));
                let mut wandering = vec![high; 3];
                for _ in 0..200 {
                    wandering.push(high - size * cells * random.unit());
                }
                wandering.extend([high; 3]);
                most = most.max(self.energy_got(&wandering));
            }
        }
        most
    }
}

/// All of them.
pub fn oracles() -> Vec<Oracle> {
    let mut found = Vec::new();
    for (wall, name) in [
        (Wall::LIGHT, "no delay"),
        (
            Wall {
                wall_damping: 0.3,
                ..Wall::LIGHT
            },
            "wall damping 0.3 N s/m",
        ),
        (
            Wall {
                delay_periods: 1,
                ..Wall::LIGHT
            },
            "one period of delay",
        ),
        (
            Wall {
                delay_periods: 2,
                ..Wall::LIGHT
            },
            "two periods of delay",
        ),
        (
            Wall {
                damping: 1.0,
                delay_periods: 1,
                ..Wall::LIGHT
            },
            "device damping 1 N s/m, one period of delay",
        ),
    ] {
        let delay = wall.period * wall.delay_periods as f64;
        let expected = (wall.damping + wall.wall_damping) / (0.5 * wall.period + delay);
        let value = wall.stiffest();
        found.push(Oracle {
            name: format!("Gil, stability, {name}"),
            value,
            expected,
            unit: "N/m",
            ok: (value / expected - 1.0).abs() <= 0.15,
        });
    }
    let colgate = |b: f64, wall_damping: f64| {
        let wall = Wall {
            damping: b,
            wall_damping,
            ..Wall::LIGHT
        };
        (wall, 2.0 * (b - wall_damping) / wall.period)
    };
    // Friction of 0.01 N at 12.3 um: the encoder limits; of 0.05 N: damping does.
    let abbott = |coulomb: f64| {
        let wall = Wall {
            coulomb,
            quantum: 12.272e-6,
            ..Wall::LIGHT
        };
        let bound = (2.0 * wall.damping / wall.period).min(2.0 * coulomb / wall.quantum);
        (wall, bound)
    };
    for ((wall, bound), name) in [
        (colgate(0.5, 0.0), "Colgate-Schenkel, b 0.5"),
        (colgate(0.5, 0.3), "Colgate-Schenkel, b 0.5, B 0.3"),
        (colgate(2.0, 0.5), "Colgate-Schenkel, b 2, B 0.5"),
        (abbott(3e-3), "Abbott-Okamura, friction 3 mN, encoder limits"),
        (abbott(0.05), "Abbott-Okamura, friction 50 mN, damping limits"),
    ] {
        for share in [0.85, 1.15] {
            let wall = Wall {
                stiffness: share * bound,
                ..wall
            };
            let got = 1e3 * wall.most_got();
            found.push(Oracle {
                name: format!("{name}: most energy got at {share} of {bound:.0} N/m"),
                value: got,
                expected: if share < 1.0 { 0.0 } else { f64::MIN_POSITIVE },
                unit: "mJ",
                ok: (got > 1e-12) == (share > 1.0),
            });
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_simulation_agrees_with_theory() {
        for oracle in oracles() {
            assert!(oracle.ok, "{oracle:?}");
        }
    }
}
