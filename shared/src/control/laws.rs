//! Bounds of a force by the laws of a frame's own contact, whatever an extrapolation or a blend makes of it.
//!
//! Entry points: [`Growth::note`] for every frame; [`Growth::keep`] and [`Cone::keep`] once a tick, after the blend.

use crate::math::{Vec3, dot, max, shortened};

/// Largest force over that of the last frames, and force that is allowed beside it \[N\].
const MORE: (f32, f32) = (1.3, 0.1);
/// Time after which a slot of the last frames' forces begins anew \[us\].
const SLOT_US: u64 = 100_000;
/// Slots: the last frames are those of 0.3 to 0.4 s.
const SLOTS: usize = 4;

/// Force across a cone's axis that is allowed beside it \[N\]: less than a finger notices.
const BESIDE_N: f32 = 0.01;

/// Coulomb's cone of all contacts of a tool with friction together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Cone {
    /// Direction of the sum of all normal forces, of length 1.
    pub axis: Vec3,
    /// Largest force across the axis over that along it: the largest coefficient, times the sum of all normal forces' magnitudes over the magnitude
    /// of their sum.
    pub friction: f32,
    /// Tangent of the angle by which the normals differ from the axis, about: 0 on a plane.
    pub spread: f32,
    /// Force across the axis that is allowed beside it \[N\].
    pub beside_n: f32,
}

impl Cone {
    /// The cone of contacts with this axis, largest coefficient, and sum of all normal forces' magnitudes over the magnitude of their sum.
    pub fn new(axis: Vec3, friction: f32, ratio: f32) -> Self {
        Cone {
            axis,
            friction: friction * ratio,
            spread: libm::sqrtf(max(2.0 * (ratio - 1.0), 0.0)),
            beside_n: BESIDE_N,
        }
    }

    /// The cone where the tool is that part of the way, 0 to 1, onto others' normals, with `beyond_n` allowed beside it \[N\].
    pub fn after(&self, part: f32, beyond_n: f32) -> Self {
        Cone {
            friction: self.friction + self.spread * part,
            beside_n: self.beside_n + beyond_n,
            ..*self
        }
    }

    /// Distance of a force from it \[N\], 0 within.
    pub fn beyond_n(&self, force: &Vec3) -> f32 {
        let along_n = dot(&self.axis, force);
        let across = force - self.axis * along_n;
        let most_n = self.friction * max(along_n, 0.0) + self.beside_n;
        max(libm::sqrtf(dot(&across, &across)) - most_n, 0.0)
    }

    /// A force with no more of it across the axis than friction holds.
    pub fn keep(&self, force: Vec3) -> Vec3 {
        let along_n = dot(&self.axis, &force);
        let across = force - self.axis * along_n;
        let square = dot(&across, &across);
        let most_n = self.friction * max(along_n, 0.0) + self.beside_n;
        if square <= most_n * most_n {
            return force;
        }
        self.axis * along_n + across * (most_n / libm::sqrtf(square))
    }
}

/// Forces of the last frames, beyond which a force grows by the way since the newest of them alone.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Growth {
    /// Largest forces by slot \[N\], the newest first.
    largest_n: [f32; SLOTS],
    /// Console time at which the newest slot began \[us\].
    since_us: u64,
}

impl Growth {
    /// No frames.
    pub const NONE: Growth = Growth {
        largest_n: [0.0; SLOTS],
        since_us: 0,
    };

    /// Takes note of a frame's force.
    pub fn note(&mut self, force: &Vec3, now_us: u64) {
        let passed = now_us.saturating_sub(self.since_us) / SLOT_US;
        if passed > 0 {
            for _ in 0..passed.min(SLOTS as u64) {
                self.largest_n.rotate_right(1);
                self.largest_n[0] = 0.0;
            }
            self.since_us = now_us;
        }
        let [newest, ..] = &mut self.largest_n;
        *newest = max(*newest, libm::sqrtf(dot(force, force)));
    }

    /// A force no larger than the last frames' and `more_n` allow \[N\], which is asked for where the frames' alone do not.
    pub fn keep(&self, force: Vec3, more_n: impl FnOnce() -> f32) -> Vec3 {
        let largest_n = self.largest_n.iter().copied().fold(0.0, max);
        let most_n = MORE.0 * largest_n + MORE.1;
        if dot(&force, &force) <= most_n * most_n {
            return force;
        }
        shortened(force, most_n + more_n())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_force_grows_by_the_way_beyond_those_of_the_last_frames() {
        let mut growth = Growth::NONE;
        let push = |n: f32| Vec3::new(0.0, 0.6 * n, 0.8 * n);
        growth.note(&push(2.0), 1_000_000);
        growth.note(&push(1.0), 1_050_000);
        let keep = |growth: &Growth, n: f32, more_n: f32| {
            let force = growth.keep(push(n), || more_n);
            0.6 * force.y + 0.8 * force.z
        };
        assert!((keep(&growth, 2.7, 0.0) - 2.7).abs() < 1e-5);
        assert!((keep(&growth, 5.0, 0.0) - 2.7).abs() < 1e-5);
        assert!((keep(&growth, 5.0, 1.0) - 3.7).abs() < 1e-5);
        // The first is forgotten after 0.3 to 0.4 s.
        for ms in [1150, 1250, 1299] {
            growth.note(&push(1.0), 1000 * ms);
        }
        assert!((keep(&growth, 5.0, 0.0) - 2.7).abs() < 1e-5);
        for ms in [1360, 1470] {
            growth.note(&push(1.0), 1000 * ms);
        }
        assert!((keep(&growth, 5.0, 0.0) - 1.4).abs() < 1e-5);
    }

    #[test]
    fn across_the_axis_is_no_more_than_friction_holds() {
        let axis = Vec3::new(0.6, 0.0, 0.8);
        let across = Vec3::new(0.64, 0.6, -0.48);
        let cone = Cone::new(axis, 0.2, 1.0);
        let keep = |along_n: f32, across_n: f32| {
            let force = cone.keep(axis * along_n + across * across_n);
            (dot(&axis, &force), dot(&across, &force))
        };
        let near = |found: (f32, f32), along: f32, across: f32| {
            assert!(
                (found.0 - along).abs() < 1e-5 && (found.1 - across).abs() < 1e-5,
                "{found:?}"
            );
        };
        near(keep(2.0, 0.4), 2.0, 0.4);
        near(keep(2.0, -1.0), 2.0, -0.41);
        near(keep(-1.0, 1.0), -1.0, 0.01);
        assert!((cone.beyond_n(&(axis * 2.0 + across)) - 0.59).abs() < 1e-5);
        assert_eq!(cone.beyond_n(&(axis * 2.0 + across * 0.4)), 0.0);
        // Only where normals differ does a way make it wider.
        assert_eq!(cone.after(1.0, 0.0), cone);
        let round = Cone::new(axis, 0.2, 1.02).after(0.5, 0.05);
        let force = round.keep(axis * 2.0 + across);
        assert!((dot(&across, &force) - (0.408 + 0.2 + 0.06)).abs() < 1e-5);
    }
}
