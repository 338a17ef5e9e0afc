//! The scripted hand of a scene, and the path that it would like to take.
//!
//! Entry points: [`hand_script`] (what a simulated console is sent) and [`position_at`] (the path by
//! itself: minimum-jerk segments, Flash and Hogan 1985, for solves without a console).

use super::document::{Document, SceneError};
use super::file::HandSection;
use sutura_shared::device::{DeviceDescription, JOINTS, Kinematics};
use sutura_shared::wire::message::{HandScript, WAY_POINTS, WayPoint};
use toml::Spanned;

/// Checks the `[hand]` section and places the device's joints at its first way point.
///
/// # Errors
/// A flaw at what is wrong: no way point or too many, times that go back, a point out of reach.
pub(super) fn hand_script(
    document: &Document,
    section: &HandSection,
    device: &DeviceDescription,
) -> Result<HandScript, SceneError> {
    let help = "a human hand holds a grip with some 200 to 2000 N/m and 2 to 40 N s/m";
    let positive = |key: &str, value: &Spanned<f64>| {
        document
            .number(key, value, "zero or positive", |v| v >= 0.0, help)
            .map(|v| v as f32)
    };
    let points = &section.way_point;
    let count = points.get_ref().len();
    if !(1..=WAY_POINTS).contains(&count) {
        let message = format!("{count} way points: a hand has 1 to {WAY_POINTS}");
        let help =
            "the last point is held; leave out points on the straight way between two others";
        return Err(document.flaw(points.span(), message, "wrong number", Some(help)));
    }
    let mut way_points = [WayPoint::default(); WAY_POINTS];
    let mut before_s = 0.0;
    let mut start_joint = [0.0; JOINTS];
    for (i, point) in points.get_ref().iter().enumerate() {
        let rule = format!("at least {before_s}, the time before it");
        let help = "times are counted from the start of the session and do not go back";
        before_s = document.number(
            "time_s",
            &point.time_s,
            &rule,
            |t| t >= before_s && t <= 3600.0,
            help,
        )?;
        let position = document.finite("position_m", &point.position_m)?;
        let Some(joint) = joints_at(&device.kinematics, position) else {
            let message = "the grip cannot reach this way point".to_owned();
            let help = "see the arm's lengths and where its shoulder stands in the device file";
            return Err(document.flaw(
                point.position_m.span(),
                message,
                "out of reach",
                Some(help),
            ));
        };
        if i == 0 {
            start_joint = joint;
        }
        way_points[i] = WayPoint {
            time_s: before_s as f32,
            position_m: position.map(|v| v as f32),
        };
    }
    Ok(HandScript {
        stiffness_n_per_m: positive("stiffness_n_per_m", &section.stiffness_n_per_m)?,
        damping_n_s_per_m: positive("damping_n_s_per_m", &section.damping_n_s_per_m)?,
        start_joint,
        count: count as u8,
        way_points,
    })
}

/// Joint coordinates that bring the grip to `position` \[m\]; of an arm's two ways the one with the elbow
/// above. None where the grip cannot be.
fn joints_at(kinematics: &Kinematics, position: [f64; 3]) -> Option<[f32; JOINTS]> {
    match *kinematics {
        Kinematics::Cartesian { origin_m } => Some(std::array::from_fn(|i| {
            (position[i] - f64::from(origin_m[i])) as f32
        })),
        Kinematics::SerialArm {
            shoulder_m,
            upper_m,
            fore_m,
        } => {
            let [x, y, z] = std::array::from_fn(|i| position[i] - f64::from(shoulder_m[i]));
            let (upper, fore) = (f64::from(upper_m), f64::from(fore_m));
            let out = x.hypot(y);
            let square = out * out + z * z;
            // Law of cosines; the elbow angle is negative where the elbow stands above the line.
            let cos_elbow = (square - upper * upper - fore * fore) / (2.0 * upper * fore);
            if !(-1.0..=1.0).contains(&cos_elbow) {
                return None;
            }
            let elbow = -cos_elbow.acos();
            let shoulder = z.atan2(out) - (fore * elbow.sin()).atan2(upper + fore * elbow.cos());
            Some([y.atan2(x) as f32, shoulder as f32, elbow as f32])
        }
    }
}

/// Where the hand wants the grip at a time \[m\]: rest to rest between way points, held after the last.
pub fn position_at(hand: &HandScript, time_s: f64) -> [f64; 3] {
    let points = &hand.way_points[..usize::from(hand.count).clamp(1, WAY_POINTS)];
    let after = points.iter().position(|p| f64::from(p.time_s) > time_s);
    let (from, to) = match after {
        Some(0) => (points[0], points[0]),
        Some(i) => (points[i - 1], points[i]),
        None => (points[points.len() - 1], points[points.len() - 1]),
    };
    let length_s = f64::from(to.time_s) - f64::from(from.time_s);
    let s = if length_s > 0.0 {
        (time_s - f64::from(from.time_s)) / length_s
    } else {
        1.0
    };
    let blend = s * s * s * (10.0 - 15.0 * s + 6.0 * s * s);
    std::array::from_fn(|i| {
        let (a, b) = (f64::from(from.position_m[i]), f64::from(to.position_m[i]));
        a + blend * (b - a)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn script(points: &[(f32, [f32; 3])]) -> HandScript {
        let mut way_points = [WayPoint::default(); WAY_POINTS];
        for (slot, (time_s, position_m)) in way_points.iter_mut().zip(points) {
            *slot = WayPoint {
                time_s: *time_s,
                position_m: *position_m,
            };
        }
        HandScript {
            stiffness_n_per_m: 1000.0,
            damping_n_s_per_m: 10.0,
            start_joint: [0.0; JOINTS],
            count: points.len() as u8,
            way_points,
        }
    }

    /// Minimum jerk from rest to rest: halfway at half time, and peak speed 15/8 of the mean (Flash and
    /// Hogan 1985).
    #[test]
    fn the_path_has_minimum_jerk_and_holds_its_last_point() {
        let hand = script(&[
            (1.0, [0.0; 3]),
            (3.0, [0.5, 0.0, -1.0]),
            (3.0, [0.5, 0.0, -2.0]),
        ]);
        assert_eq!(position_at(&hand, 0.0), [0.0; 3]);
        assert_eq!(position_at(&hand, 2.0), [0.25, 0.0, -0.5]);
        let h = 1e-5;
        let speed = (position_at(&hand, 2.0 - h)[2] - position_at(&hand, 2.0 + h)[2]) / (2.0 * h);
        assert!((speed - 0.5 * 15.0 / 8.0).abs() < 1e-6, "{speed}");
        assert_eq!(position_at(&hand, 9.0), [0.5, 0.0, -2.0]);
    }

    #[test]
    fn an_arm_has_its_elbow_above_and_ends_at_its_reach() {
        let arm = Kinematics::SerialArm {
            shoulder_m: [0.0; 3],
            upper_m: 0.2,
            fore_m: 0.2,
        };
        // Upright upper arm and level forearm: elbow a quarter turn down from the upper arm.
        let [yaw, shoulder, elbow] = joints_at(&arm, [0.2, 0.0, 0.2]).expect("within reach");
        let quarter = std::f32::consts::FRAC_PI_2;
        assert!(yaw.abs() < 1e-6);
        assert!((shoulder - quarter).abs() < 1e-6, "{shoulder}");
        assert!((elbow + quarter).abs() < 1e-6, "{elbow}");
        assert!(joints_at(&arm, [0.3, 0.0, 0.3]).is_none());
    }
}
