//! The way of a needle from bite to bite: round its circle's centre through tissue, then in the open to where the
//! next bite begins.
//!
//! Entry point: [`Sewing::script`]. Two hands take turns: one goes round with the needle, the other one carries it.

use super::turn::{Vec3, along, cross, rotation_vector};
#[cfg(test)]
use super::turn::{norm, rotated};

/// Between a hand's rest and what the other hand does \[s\]: two steps at 200 Hz.
pub const REST_S: f64 = 0.01;

/// One bite: the tip goes round the circle's centre.
#[derive(Clone, Copy, Debug)]
pub struct Bite {
    /// Centre of the circle \[m\].
    pub centre: Vec3,
    /// Unit vectors in the circle's plane; angles count from the first towards the second.
    pub axes: [Vec3; 2],
    /// Where the tip is before and after \[degree\].
    pub tip_deg: [f64; 2],
    /// How long it takes \[s\].
    pub seconds: f64,
    /// Way aside in the open after it \[m\].
    pub aside: Vec3,
    /// How long the way to the next bite takes \[s\].
    pub way_s: f64,
}

/// A needle in the shape of an arc, and its bites.
#[derive(Clone, Debug)]
pub struct Sewing {
    pub radius_m: f64,
    pub angle_deg: f64,
    pub thickness_m: f64,
    /// When the first bite begins \[s\].
    pub begin_s: f64,
    pub bites: Vec<Bite>,
    /// By how much a third hand draws the needle away after each bite \[m\]; none without. The second hand takes it there.
    pub pulls: Vec<Vec3>,
    /// How long that has it \[s\].
    pub pull_s: f64,
}

/// A point of a hand's script.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stop {
    pub time_s: f64,
    pub position_m: Vec3,
    pub rotation_deg: Vec3,
}

/// What two hands do.
#[derive(Clone, Debug, Default)]
pub struct Script {
    /// Of the hand that goes round with the needle, and of the one that carries it.
    pub stops: [Vec<Stop>; 2],
    /// From when on which of them holds the needle \[s\]; 2 is a third one that pulls.
    pub holds: Vec<(f64, usize)>,
    /// When each bite ends \[s\].
    pub ends_s: Vec<f64>,
}

impl Bite {
    /// 1 if the angle grows.
    fn sense(&self) -> f64 {
        (self.tip_deg[1] - self.tip_deg[0]).signum()
    }

    /// From the centre to the tip, the way that it goes, and the axis that it goes round; of unit length.
    fn frame(&self, tip_deg: f64) -> [Vec3; 3] {
        let (sin, cos) = tip_deg.to_radians().sin_cos();
        let out = along(self.axes[0].map(|v| cos * v), sin, self.axes[1]);
        let axis = cross(self.axes[0], self.axes[1]).map(|v| self.sense() * v);
        [out, cross(axis, out), axis]
    }

    /// Axis times angle of the whole bite \[rad\].
    fn turn(&self) -> Vec3 {
        let angle = (self.tip_deg[1] - self.tip_deg[0]).abs().to_radians();
        self.frame(0.0)[2].map(|v| angle * v)
    }
}

impl Sewing {
    /// The needle's end \[m\], the direction from it, and that to the centre, before the first bite.
    pub fn start(&self) -> [Vec3; 3] {
        let bite = &self.bites[0];
        let end_deg = bite.tip_deg[0] - bite.sense() * self.angle_deg;
        let [out, way, _] = bite.frame(end_deg);
        [along(bite.centre, self.radius_m, out), way, out.map(|v| -v)]
    }

    /// Where the needle's end is after a bite \[m\].
    pub fn end_after(&self, bite: &Bite) -> Vec3 {
        let end_deg = bite.tip_deg[1] - bite.sense() * self.angle_deg;
        along(bite.centre, self.radius_m, bite.frame(end_deg)[0])
    }

    /// Axis times angle \[rad\] from the end of a bite to the beginning of the next one.
    fn turn_between(from: &Bite, to: &Bite) -> Vec3 {
        rotation_vector(from.frame(from.tip_deg[1]), to.frame(to.tip_deg[0]))
    }

    /// What the hands do. After the last bite the first hand rests, with the needle.
    pub fn script(&self) -> Script {
        let mut script = Script {
            holds: vec![(0.0, 0)],
            ..Script::default()
        };
        let mut now_s = self.begin_s;
        for (index, bite) in self.bites.iter().enumerate() {
            let [round, carry] = &mut script.stops;
            let stop = |time_s, position_m, turn: Vec3| Stop {
                time_s,
                position_m,
                rotation_deg: turn.map(f64::to_degrees),
            };
            round.push(stop(now_s, bite.centre, [0.0; 3]));
            now_s += bite.seconds;
            round.push(stop(now_s, bite.centre, bite.turn()));
            script.ends_s.push(now_s);
            let mut from = bite.centre;
            if let Some(pull) = self.pulls.get(index) {
                script.holds.push((now_s + REST_S, 2));
                now_s += 2.0 * REST_S + self.pull_s;
                from = along(from, 1.0, *pull);
            }
            let Some(next) = self.bites.get(index + 1) else {
                continue;
            };
            script.holds.push((now_s + REST_S, 1));
            now_s += 2.0 * REST_S;
            round.push(stop(now_s, bite.centre, bite.turn()));
            let turn = Self::turn_between(bite, next);
            let half_way = along(from, 0.5, along(next.centre, -1.0, from));
            carry.push(stop(now_s, from, [0.0; 3]));
            carry.push(stop(
                now_s + 0.5 * bite.way_s,
                along(half_way, 1.0, bite.aside),
                turn.map(|v| 0.5 * v),
            ));
            now_s += bite.way_s;
            carry.push(stop(now_s, next.centre, turn));
            script.holds.push((now_s + REST_S, 0));
            now_s += 2.0 * REST_S;
            carry.push(stop(now_s, next.centre, turn));
            // Back, empty, while the needle goes through tissue.
            if self.pulls.is_empty() {
                carry.push(stop(now_s + 0.5 * next.seconds, next.centre, [0.0; 3]));
            }
        }
        script
    }
}

#[cfg(test)]
impl Sewing {
    /// Places of the needle on its way in the open \[m\], bite by bite: on each of so many poses as many points.
    pub fn in_the_open(&self, poses: u32, points: u32) -> Vec<Vec<Vec3>> {
        let pairs = self.bites.iter().zip(self.bites.iter().skip(1));
        pairs
            .map(|(bite, next)| {
                let turn = Self::turn_between(bite, next);
                let half_way = along(bite.centre, 0.5, along(next.centre, -1.0, bite.centre));
                let far = along(half_way, 1.0, bite.aside);
                let pose = |s: f64| {
                    let (from, to, part) = if s < 0.5 {
                        (bite.centre, far, 2.0 * s)
                    } else {
                        (far, next.centre, 2.0 * s - 1.0)
                    };
                    let centre = along(from, part, along(to, -1.0, from));
                    (centre, turn.map(|v| s * v))
                };
                let mut places = Vec::new();
                for k in 0..=poses {
                    let (centre, turn) = pose(f64::from(k) / f64::from(poses));
                    for point in 0..=points {
                        let back = self.angle_deg * f64::from(point) / f64::from(points);
                        let degrees = bite.tip_deg[1] - bite.sense() * back;
                        let out = rotated(turn, bite.frame(degrees)[0]);
                        places.push(along(centre, self.radius_m, out));
                    }
                }
                places
            })
            .collect()
    }

    /// Fastest that the needle's middle goes within bites, and in the open \[m/s\]: minimum jerk has 15/8 of the mean
    /// speed at most.
    pub fn speeds_m_per_s(&self) -> [f64; 2] {
        let mut speeds = [0.0f64; 2];
        for (bite, next) in self.bites.iter().zip(self.bites.iter().skip(1)) {
            let round = self.radius_m * norm(bite.turn()) / bite.seconds;
            let turn = 0.5 * self.radius_m * norm(Self::turn_between(bite, next));
            let moved = along(bite.aside, 0.5, along(next.centre, -1.0, bite.centre));
            let open = (turn + norm(moved)) / (0.5 * bite.way_s);
            speeds = [speeds[0].max(1.875 * round), speeds[1].max(1.875 * open)];
        }
        speeds
    }
}
