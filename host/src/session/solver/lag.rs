//! Lag of the driven tool behind its hand, and what a console makes of it.
//!
//! Entry points: [`Lag::between`], [`Lag::outruns`]. A step that is [`Behind`](crate::step::Status::Behind) reports the balance where the
//! tool is by then. The console evaluates it where the hand is: over a lag longer than the contact itself the tangent
//! makes a force of geometry that nobody has solved.

use crate::step::ToolContact;
use crate::tool::ToolSample;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};

/// Way from where a step has a tool to where its hand is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Lag {
    /// Translation \[m\].
    way_m: Vector3<f64>,
    /// Rotation vector \[rad\], world frame.
    turn_rad: Vector3<f64>,
}

impl Lag {
    /// From `reached` to `wanted`.
    pub fn between(reached: &ToolSample, wanted: &ToolSample) -> Self {
        let turned = |sample: &ToolSample| {
            let [x, y, z, w] = sample.orientation;
            UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z))
        };
        Lag {
            way_m: Vector3::from(wanted.position_m) - Vector3::from(reached.position_m),
            turn_rad: (turned(wanted) * turned(reached).inverse()).scaled_axis(),
        }
    }

    /// Whether the contact's tangent and gap give a larger change of force over this lag than its whole force. `holds`: a
    /// needle or thread in the grip pulls as well as it pushes. A tool that the tangent has leave the tissue outruns nothing.
    pub fn outruns(&self, contact: &ToolContact, holds: bool) -> bool {
        let normal = Vector3::from(contact.normal);
        let closed_m = -normal.dot(&self.way_m);
        let is_apart = contact.gap_m > 0.0 && !holds;
        // Nothing is touched: a hand on its way in closes whatever gap there is before the tool does.
        if is_apart && closed_m <= 0.0 {
            return false;
        }
        let [x, y, z, ..] = contact.wrench;
        let force = Vector3::new(x, y, z);
        let change = self.change_n(contact);
        if !is_apart && !holds && normal.dot(&(force + change)) <= 0.0 {
            return false;
        }
        change.norm() > force.norm()
    }

    /// Change of force by the tangent \[N\].
    fn change_n(&self, contact: &ToolContact) -> Vector3<f64> {
        let [x, y, z, ..] = contact.tangent.map(|[x, y, z, a, b, c]| {
            Vector3::new(x, y, z).dot(&self.way_m) + Vector3::new(a, b, c).dot(&self.turn_rad)
        });
        Vector3::new(x, y, z)
    }
}

/// The contact as it is, wherever the hand goes: without tangent, and without a surface ahead.
pub(super) fn without_course(contact: &ToolContact) -> ToolContact {
    ToolContact {
        tangent: [[0.0; 6]; 6],
        gap_m: if contact.gap_m > 0.0 { f64::MAX } else { 0.0 },
        ..*contact
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Pose;
    use crate::script::at_rest;

    /// A spring of 500 N/m upwards that holds so much \[N\], or is so far below \[m\].
    fn spring(force_n: f64, gap_m: f64) -> ToolContact {
        let mut contact = ToolContact {
            wrench: [0.0, 0.0, force_n, 0.0, 0.0, 0.0],
            gap_m,
            normal: [0.0, 0.0, 1.0],
            ..ToolContact::default()
        };
        contact.tangent[2][2] = -500.0;
        contact.tangent[2][4] = -5.0;
        contact
    }

    fn lag(z_m: f64) -> Lag {
        Lag {
            way_m: Vector3::new(0.0, 0.0, z_m),
            turn_rad: Vector3::zeros(),
        }
    }

    #[test]
    fn a_lag_is_compared_with_what_is_touched() {
        // 1 N of 500 N/m is 2 mm deep.
        assert!(!lag(-1.9e-3).outruns(&spring(1.0, 0.0), false));
        assert!(lag(-2.1e-3).outruns(&spring(1.0, 0.0), false));
        // On the way out it lets go; what is held pulls.
        assert!(!lag(9e-3).outruns(&spring(1.0, 0.0), false));
        assert!(lag(9e-3).outruns(&spring(1.0, 0.0), true));
        // On the way in no force was solved, on the way out none is made.
        assert!(lag(-0.1e-3).outruns(&spring(0.0, 1e-3), false));
        assert!(!lag(0.1e-3).outruns(&spring(0.0, 1e-3), false));
        // A turn counts by what it presses: 0.3 rad of 5 N/rad.
        let turned = Lag {
            way_m: Vector3::zeros(),
            turn_rad: Vector3::new(0.0, -0.3, 0.0),
        };
        assert!(turned.outruns(&spring(1.0, 0.0), false));
        assert!(!turned.outruns(&spring(2.0, 0.0), false));
    }

    /// The rotation is that from where the tool is to where the hand is, whichever sign the quaternions have.
    #[test]
    fn a_lag_is_from_the_tool_to_the_hand() {
        let sample = |z_m: f64, angle_rad: f64, sign: f64| {
            let (sine, cosine) = (0.5 * angle_rad).sin_cos();
            let pose = Pose {
                position_m: [0.0, 0.0, z_m],
                orientation: [0.0, sign * sine, 0.0, sign * cosine],
            };
            at_rest(0, &pose)
        };
        let lag = Lag::between(&sample(0.002, 0.1, 1.0), &sample(-0.001, 0.4, -1.0));
        let expected = Lag {
            way_m: Vector3::new(0.0, 0.0, -0.003),
            turn_rad: Vector3::new(0.0, 0.3, 0.0),
        };
        assert!((lag.way_m - expected.way_m).norm() < 1e-15);
        assert!((lag.turn_rad - expected.turn_rad).norm() < 1e-12);
    }

    #[test]
    fn without_its_course_a_contact_is_what_it_is() {
        let touching = without_course(&spring(1.0, 0.0));
        assert_eq!((touching.wrench[2], touching.gap_m), (1.0, 0.0));
        assert_eq!(touching.tangent, [[0.0; 6]; 6]);
        assert_eq!(without_course(&spring(0.0, 1e-3)).gap_m, f64::MAX);
    }
}
