//! The scripted hand of a scene, and the path that it would like to take.
//!
//! Entry points: [`hand_script`] (what a simulated console is sent) and [`position_at`] (the path by
//! itself, for solves without a console).

use super::Device;
use super::document::{Document, Flaw, SceneError};
use super::units::length;
use nalgebra::Vector3;
use sutura_scene_file::scene::HandSection;
use sutura_shared::device::{DeviceDescription, JOINTS, Kinematics};
use sutura_shared::kinematics::forward;
use sutura_shared::virtual_console::path;
use sutura_shared::wire::message::{HandScript, WAY_POINTS, WayPoint};
use sutura_shared::wire::validate::{MAX_HAND_DAMPING, MAX_HAND_STIFFNESS, MAX_POSITION, name};
use toml::Spanned;

/// Checks the `[hand]` section and places the device's joints at its first way point.
///
/// # Errors
/// A flaw at what is wrong: no way point or too many, times that go back, a point out of reach.
pub fn hand_script(
    document: &Document,
    section: &HandSection,
    device: &DeviceDescription,
) -> Result<HandScript, SceneError> {
    let help = "a human hand holds a grip with some 200 to 2000 N/m and 2 to 40 N s/m";
    // Up to what a console takes.
    let number = |key: &str, value: &Spanned<f64>, most: f32| {
        let rule = format!("from 0 to {most}");
        let sound = |v| (0.0..=f64::from(most)).contains(&v);
        let number = document.number(key, value, &rule, sound, help);
        number.map(|v| v as f32)
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
        let rule = format!("at least {before_s}, the time before it, and at most 3600");
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
            let (message, help) = out_of_reach(&device.kinematics, position);
            return Err(document.flaw(
                point.position_m.span(),
                message,
                "out of reach",
                Some(&help),
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
        stiffness_n_per_m: number(
            "stiffness_n_per_m",
            &section.stiffness_n_per_m,
            MAX_HAND_STIFFNESS,
        )?,
        damping_n_s_per_m: number(
            "damping_n_s_per_m",
            &section.damping_n_s_per_m,
            MAX_HAND_DAMPING,
        )?,
        start_joint,
        count: count as u8,
        way_points,
    })
}

/// Parts of a straight way at which its joints are looked at.
const LOOKS: u32 = 32;
/// Highest speed of a way with minimum jerk over its mean speed (Flash and Hogan 1985).
pub(super) const PEAK_SPEED: f64 = 15.0 / 8.0;

/// Warnings of a hand that leads its console beyond the stops of its joints, to where its motors do not bear its weight, or faster than
/// it allows: one of each kind, at the first such way point.
pub(super) fn beyond_device(
    document: &Document,
    section: &HandSection,
    device: &Device,
) -> Vec<Flaw> {
    let travel = beyond_travel(document, section, device);
    let weight = beyond_motors(document, section, device);
    let speed = beyond_speed(document, section, device);
    travel.into_iter().chain(weight).chain(speed).collect()
}

/// A warning at the first way point where a motor gives less than carries what the device says that it carries.
fn beyond_motors(document: &Document, section: &HandSection, device: &Device) -> Option<Flaw> {
    let description = &device.description;
    let unit = match description.kinematics {
        Kinematics::Cartesian { .. } => "N",
        Kinematics::SerialArm { .. } => "N m",
    };
    section.way_point.get_ref().iter().find_map(|point| {
        let joints = joints_at(&description.kinematics, *point.position_m.get_ref())?;
        let efforts = forward(description, &joints).weight_effort;
        let mut each = efforts.into_iter().zip(&description.joints).enumerate();
        let (index, (effort, joint)) = each.find(|(_, (effort, joint))| {
            effort.abs() > joint.effort_per_amp.abs() * joint.max_current_a
        })?;
        let message = format!(
            "here the weight of {} takes {:.2} {unit} of joint {index}, and its motor gives {:.2} {unit}: the grip falls",
            device_name(device),
            effort.abs(),
            joint.effort_per_amp.abs() * joint.max_current_a,
        );
        let help = "masses are in kg: a lighter grip or a counterweight, or a motor or a current that carries it";
        let place = point.position_m.span();
        Some(document.warning(place, &message, "not carried", help))
    })
}

/// A warning at the first way point that lies beyond the stops of a joint.
fn beyond_travel(document: &Document, section: &HandSection, device: &Device) -> Option<Flaw> {
    let kinematics = &device.description.kinematics;
    let beyond = |position: [f64; 3]| {
        let joints = joints_at(kinematics, position)?.map(f64::from);
        let each = joints.into_iter().zip(device.travel).enumerate();
        // A stop is where it is to a few micrometres, and single precision is near it.
        let mut each = each.filter_map(|(index, (at, travel))| Some((index, at, travel?)));
        each.find(|(_, at, [low, high])| *at < low - 1e-6 || *at > high + 1e-6)
    };
    let points = section.way_point.get_ref();
    let mut far = points.iter().filter_map(|point| {
        let found = beyond(*point.position_m.get_ref())?;
        Some((point, found))
    });
    let (point, (joint, at, [low, high])) = far.next()?;
    let unit = match kinematics {
        Kinematics::Cartesian { .. } => "m",
        Kinematics::SerialArm { .. } => "rad",
    };
    let more = match far.count() {
        0 => String::new(),
        count => format!("; so do {count} more"),
    };
    let message = format!(
        "this way point takes joint {joint} of {} to {at:.3} {unit}, and its travel is {low} to {high} {unit}{more}",
        device_name(device)
    );
    let position = *point.position_m.get_ref();
    let help = match beyond(position.map(|along| 1e-3 * along)) {
        None if position.iter().any(|along| along.abs() >= 0.5) => {
            "lengths are in metres: times 0.001 it is within".to_owned()
        }
        _ => "a simulated console goes there, one with motors runs against its stop: bring scene and hand nearer to the middle of the travel".to_owned(),
    };
    let place = point.position_m.span();
    Some(document.warning(place, &message, "beyond the travel", &help))
}

/// A warning at the first way point that is reached faster than the console allows.
fn beyond_speed(document: &Document, section: &HandSection, device: &Device) -> Option<Flaw> {
    let points = section.way_point.get_ref();
    let most = f64::from(device.description.max_grip_speed_m_per_s);
    let name = device_name(device);
    points.windows(2).find_map(|pair| {
        let [from, to] = [0, 1].map(|index| &pair[index]);
        let [from_m, to_m] = [from, to].map(|point| Vector3::from(*point.position_m.get_ref()));
        let way_m = from_m.metric_distance(&to_m);
        let length_s = to.time_s.get_ref() - from.time_s.get_ref();
        // Least duration under the limits \[s\], and the limit that sets it.
        let needed_s = PEAK_SPEED * way_m / most;
        let joint = slowest_joint(device, &from_m, &to_m);
        let joint = joint.filter(|(_, joint_s)| *joint_s > needed_s && *joint_s > length_s);
        let (whose, needed_s) = match joint {
            Some((joint, needed_s)) => (
                format!("its joint {joint} is in a fault there (encoder jump)"),
                needed_s,
            ),
            None => (format!("is in a fault above {most} m/s (overspeed)"), needed_s),
        };
        // The path is computed in single precision.
        if needed_s <= length_s * (1.0 + 1e-6) || way_m <= 1e-9 {
            return None;
        }
        let how = match length_s > 0.0 {
            true => format!("goes at up to {:.2} m/s", PEAK_SPEED * way_m / length_s),
            false => "jumps".to_owned(),
        };
        let message = format!(
            "the hand {how} on its {} to this way point, and {name} {whose}",
            length(way_m)
        );
        let help = format!(
            "give it {needed_s:.2} s instead of {length_s:.2} s, or a shorter way; lengths are in metres, times in seconds"
        );
        let place = to.position_m.span();
        Some(document.warning(place, &message, "too fast", &help))
    })
}

/// The joint that takes longest for a straight way of the grip, and that time \[s\].
fn slowest_joint(
    device: &Device,
    from_m: &Vector3<f64>,
    to_m: &Vector3<f64>,
) -> Option<(usize, f64)> {
    let kinematics = &device.description.kinematics;
    let at = |look: u32| {
        let s = f64::from(look) / f64::from(LOOKS);
        let blend = s * s * s * (10.0 - 15.0 * s + 6.0 * s * s);
        joints_at(kinematics, from_m.lerp(to_m, blend).into())
    };
    let looks = (0..LOOKS).filter_map(|look| at(look).zip(at(look + 1)));
    let times = looks.flat_map(|(a, b)| {
        let joints = device.description.joints.iter().enumerate();
        joints.map(move |(index, joint)| {
            let rate = f64::from((b[index] - a[index]).abs()) * f64::from(LOOKS);
            (index, rate / f64::from(joint.max_speed_per_s))
        })
    });
    times.max_by(|a, b| a.1.total_cmp(&b.1))
}

/// The device as its file calls it: checked when that was read.
fn device_name(device: &Device) -> String {
    name(&device.description.name)
        .unwrap_or_default()
        .to_owned()
}

/// Joint coordinates that bring the grip to `position` \[m\]; of an arm's two ways the one with the elbow
/// above. None where the grip cannot be.
pub fn joints_at(kinematics: &Kinematics, position: [f64; 3]) -> Option<[f32; JOINTS]> {
    // Farther than a frame can say.
    if position
        .iter()
        .any(|along| along.abs() > f64::from(MAX_POSITION))
    {
        return None;
    }
    let joints: [f32; JOINTS] = match *kinematics {
        Kinematics::Cartesian { origin_m } => {
            std::array::from_fn(|i| (position[i] - f64::from(origin_m[i])) as f32)
        }
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
            [y.atan2(x) as f32, shoulder as f32, elbow as f32]
        }
    };
    // The hand's first position is given joint by joint.
    let is_said = |q: &f32| q.abs() <= MAX_POSITION;
    joints.iter().all(is_said).then_some(joints)
}

/// What is wrong with a place \[m\] that the grip does not get to, and what to do.
fn out_of_reach(kinematics: &Kinematics, position: [f64; 3]) -> (String, String) {
    let [x, y, z] = position;
    let limit = match *kinematics {
        Kinematics::Cartesian { .. } => {
            format!("no console goes farther than {MAX_POSITION} m along an axis")
        }
        Kinematics::SerialArm {
            shoulder_m,
            upper_m,
            fore_m,
        } => {
            let from = |i: usize| position[i] - f64::from(shoulder_m[i]);
            let far_m = from(0).hypot(from(1)).hypot(from(2));
            format!(
                "it is {far_m:.3} m from the shoulder, and the arm reaches {:.3} m to {:.3} m",
                (upper_m - fore_m).abs(),
                upper_m + fore_m
            )
        }
    };
    let message = format!("the grip cannot reach this way point ({x}, {y}, {z}) m: {limit}");
    let help = match joints_at(kinematics, position.map(|along| 1e-3 * along)) {
        Some(_) => "lengths are in metres: times 0.001 it is in reach",
        None => "see the arm's lengths and where its shoulder stands in the device file",
    };
    (message, help.to_owned())
}

/// Where the hand wants the grip at a time since the session began \[m\]: the same path, in the same single
/// precision, that a simulated console follows.
pub fn position_at(hand: &HandScript, time_s: f64) -> [f64; 3] {
    // Out of range saturates: before the first way point and after the last the hand rests.
    let (position, _) = path(hand, (1e6 * time_s).round() as u32);
    position.map(f64::from).into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use sutura_shared::device::Joint;
    use sutura_shared::kinematics::forward;

    fn device(kinematics: Kinematics) -> DeviceDescription {
        let joint = Joint {
            counts_per_unit: 1.0,
            zero_counts: 0,
            effort_per_amp: 1.0,
            max_current_a: 1.0,
            max_slew_per_s: 1.0,
            max_speed_per_s: 1.0,
            inertia: 1.0,
            damping: 0.0,
            coulomb: 0.0,
        };
        DeviceDescription {
            name: [0; 16],
            kinematics,
            joints: [joint; JOINTS],
            gravity_mass_kg: [0.0; JOINTS],
            max_force_n: 1.0,
            max_power_w: 1.0,
            max_grip_speed_m_per_s: 1.0,
            actuation_delay_us: 0,
        }
    }

    const ARM: Kinematics = Kinematics::SerialArm {
        shoulder_m: [-0.3, 0.02, 0.12],
        upper_m: 0.22,
        fore_m: 0.2,
    };

    /// The console's own kinematics, fed with the joints found here, leads back to the place. Single
    /// precision carries half a metre to 3e-8 m; sine and cosine add a few times that.
    #[test]
    fn the_joints_bring_the_grip_to_the_place() {
        let cartesian = Kinematics::Cartesian {
            origin_m: [0.1, -0.2, 0.3],
        };
        for kinematics in [cartesian, ARM] {
            let device = device(kinematics);
            for step in 0..64 {
                let place =
                    [0, 1, 2].map(|axis: usize| 0.02 * f64::from(step >> (2 * axis) & 3) - 0.03);
                let joints = joints_at(&kinematics, place).expect("within reach");
                let grip = forward(&device, &joints).position_m;
                for axis in 0..3 {
                    let off = (f64::from(grip[axis]) - place[axis]).abs();
                    assert!(off < 5e-7, "{kinematics:?} at {place:?}: off by {off:e} m");
                }
            }
        }
    }

    #[test]
    fn an_arm_keeps_its_elbow_above_and_ends_at_its_reach() {
        let [_, _, elbow] = joints_at(&ARM, [0.0, 0.0, 0.0]).expect("within reach");
        // Bent down from the upper arm: the elbow stands above the line to the grip.
        assert!(elbow < 0.0);
        assert!(joints_at(&ARM, [0.1, 0.02, 0.12]).is_some());
        assert!(joints_at(&ARM, [0.121, 0.02, 0.12]).is_none());
    }

    #[test]
    fn the_path_is_held_before_and_after() {
        let mut way_points = [WayPoint::default(); WAY_POINTS];
        way_points[0] = WayPoint {
            time_s: 1.0,
            position_m: [0.0; 3],
        };
        way_points[1] = WayPoint {
            time_s: 3.0,
            position_m: [0.5, 0.0, -1.0],
        };
        let hand = HandScript {
            stiffness_n_per_m: 1000.0,
            damping_n_s_per_m: 10.0,
            start_joint: [0.0; JOINTS],
            count: 2,
            way_points,
        };
        assert_eq!(position_at(&hand, -1.0), [0.0; 3]);
        assert_eq!(position_at(&hand, 2.0), [0.25, 0.0, -0.5]);
        assert_eq!(position_at(&hand, 1e9), [0.5, 0.0, -1.0]);
    }
}
