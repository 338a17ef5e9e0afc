//! A virtual wall and a virtual coupling: forces that need no host.
//!
//! Entry point: [`Fixed::force`]. A spring and a damper behind a plane, which push and never pull, or at a point, which
//! hold (Colgate, Stanley and Brown 1995). Stiffness and damping are capped at what the device can render stably.

use crate::device::DeviceDescription;
use crate::math::{Vec3, dot, max, min};
use crate::wire::message::Fixture;

/// Largest stiffness in what the device renders stably in a hand: a fixture may be all that holds the grip.
const ALONE: f32 = 0.25 / 0.55;
/// Largest damping over what the device renders stably, per delay: a tenth of mass per delay, since the velocity is an estimate.
const DAMPING: f32 = 0.1 / 0.55;

/// The fixture that a host has put up, if any.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Fixed {
    fixture: Fixture,
    max_stiffness: f32,
    max_damping: f32,
}

impl Fixed {
    /// None, on this device.
    pub fn none(device: &DeviceDescription) -> Self {
        let delay_s = device.loop_delay_s();
        let stiffness = device.stable_stiffness_n_per_m();
        Fixed {
            fixture: Fixture::None,
            max_stiffness: ALONE * stiffness,
            max_damping: DAMPING * stiffness * delay_s,
        }
    }

    /// Puts up another one in its place.
    pub fn set(&mut self, fixture: &Fixture) {
        self.fixture = *fixture;
    }

    /// What is up.
    pub fn fixture(&self) -> &Fixture {
        &self.fixture
    }

    /// Largest stiffness that it can have \[N/m\].
    pub fn stiffness(&self) -> f32 {
        let (stiffness, _) = self.spring();
        stiffness
    }

    /// Stiffness that it can have along a direction of any length \[N/m\]; 0 for none.
    pub fn stiffness_along(&self, direction: &Vec3) -> f32 {
        let (stiffness, _) = self.spring();
        match self.fixture {
            Fixture::Wall { normal, .. } => {
                let (along, square) = (
                    dot(&Vec3::from(normal), direction),
                    dot(direction, direction),
                );
                if square > 0.0 {
                    stiffness * (along * along / square)
                } else {
                    0.0
                }
            }
            Fixture::None | Fixture::Coupling { .. } => stiffness,
        }
    }

    /// Stiffness \[N/m\] and damping \[N s/m\], as far as the device renders them.
    fn spring(&self) -> (f32, f32) {
        match self.fixture {
            Fixture::None => (0.0, 0.0),
            Fixture::Wall {
                stiffness_n_per_m,
                damping_n_s_per_m,
                ..
            }
            | Fixture::Coupling {
                stiffness_n_per_m,
                damping_n_s_per_m,
                ..
            } => (
                min(stiffness_n_per_m, self.max_stiffness),
                min(damping_n_s_per_m, self.max_damping),
            ),
        }
    }

    /// Force on the grip at a place \[m\] and velocity \[m/s\] \[N\].
    pub fn force(&self, place: &Vec3, velocity: &Vec3) -> Vec3 {
        let (stiffness, damping) = self.spring();
        match self.fixture {
            Fixture::None => Vec3::zeros(),
            Fixture::Wall {
                point_m, normal, ..
            } => {
                let normal = Vec3::from(normal);
                let deep_m = dot(&normal, &(Vec3::from(point_m) - place));
                if deep_m > 0.0 {
                    let push = stiffness * deep_m - damping * dot(&normal, velocity);
                    normal * max(push, 0.0)
                } else {
                    Vec3::zeros()
                }
            }
            Fixture::Coupling { anchor_m, .. } => {
                (Vec3::from(anchor_m) - place) * stiffness - velocity * damping
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::{JOINTS, Joint, Kinematics};

    /// 0.1 kg with one tick of delay: at most 4000 N/m and 4 N s/m.
    fn fixed(fixture: Fixture) -> Fixed {
        let joint = |inertia| Joint {
            counts_per_unit: 1e5,
            zero_counts: 0,
            effort_per_amp: 1.0,
            max_current_a: 1.0,
            max_slew_per_s: 1.0,
            max_speed_per_s: 1.0,
            inertia,
            damping: 0.0,
            coulomb: 0.0,
        };
        let mut fixed = Fixed::none(&DeviceDescription {
            name: [0; 16],
            kinematics: Kinematics::Cartesian { origin_m: [0.0; 3] },
            joints: [joint(0.3), joint(0.1), joint(0.2)],
            gravity_mass_kg: [0.0; JOINTS],
            max_force_n: 1.0,
            max_power_w: 1.0,
            max_grip_speed_m_per_s: 1.0,
            actuation_delay_us: 1000,
        });
        fixed.set(&fixture);
        fixed
    }

    fn wall(stiffness: f32, damping: f32) -> Fixed {
        fixed(Fixture::Wall {
            point_m: [0.0, 0.0, 0.01],
            normal: [0.0, 0.0, 1.0],
            stiffness_n_per_m: stiffness,
            damping_n_s_per_m: damping,
        })
    }

    #[test]
    fn a_wall_pushes_out_and_never_pulls() {
        let wall = wall(1000.0, 2.0);
        let at = |z: f32, v: f32| {
            wall.force(&Vec3::new(0.3, -0.2, z), &Vec3::new(1.0, 1.0, v))
                .z
        };
        assert!((at(0.008, 0.0) - 2.0).abs() < 1e-5);
        assert!((at(0.008, -0.5) - 3.0).abs() < 1e-5);
        // Drawn out faster than its spring follows, it lets go.
        assert_eq!(at(0.008, 1.5), 0.0);
        assert_eq!(at(0.0101, -1.0), 0.0);
    }

    #[test]
    fn a_coupling_holds_from_all_sides() {
        let coupling = fixed(Fixture::Coupling {
            anchor_m: [0.0, 0.01, 0.0],
            stiffness_n_per_m: 500.0,
            damping_n_s_per_m: 1.0,
        });
        let force = coupling.force(&Vec3::new(0.002, 0.012, 0.0), &Vec3::new(0.0, 0.0, 0.5));
        assert!(
            (force - Vec3::new(-1.0, -1.0, -0.5))
                .iter()
                .all(|f| f.abs() < 1e-5)
        );
    }

    #[test]
    fn nothing_is_stiffer_than_the_device_stands() {
        assert!((wall(1e6, 1e4).stiffness() - 4000.0).abs() < 0.01);
        let pushed = wall(0.0, 1e4).force(&Vec3::zeros(), &Vec3::new(0.0, 0.0, -1.0));
        assert!((pushed.z - 4.0).abs() < 1e-5, "{pushed}");
        assert_eq!(
            fixed(Fixture::None).force(&Vec3::zeros(), &Vec3::x()),
            Vec3::zeros()
        );
    }
}
