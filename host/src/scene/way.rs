//! `[[tool.way_point]]`: how a grip turns, and where one goes that the console does not carry.
//!
//! Entry points: [`read_way`], [`Way::pose_at`]. Between two points with minimum jerk, at rest at both (Flash and
//! Hogan 1985), as the hand's path.

use super::document::{Document, SceneError};
use nalgebra::{UnitQuaternion, Vector3};
use sutura_scene_file::scene::{ToolSection, ToolWayPointSection};
use toml::Spanned;

/// Latest time of a way point \[s\], as the hand's.
const LATEST_S: f64 = 3600.0;

/// A tool's script: one way point at least, times not decreasing.
#[derive(Clone, Debug, PartialEq)]
pub struct Way(Vec<WayStop>);

/// One way point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WayStop {
    /// Since the session began \[s\].
    pub time_s: f64,
    /// Where the grip is \[m\], (3); `None` for a grip that the console carries.
    pub position_m: Option<[f64; 3]>,
    /// Axis in the world frame times angle \[rad\], (3).
    pub rotation_rad: [f64; 3],
}

/// Where a script has a grip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OnWay {
    /// Position \[m\] and velocity \[m/s\], (3) each, of a tool that the console does not carry.
    pub moved: Option<([f64; 3], [f64; 3])>,
    /// Grip to world, unit quaternion (x, y, z, w).
    pub orientation: [f64; 4],
}

impl Way {
    /// The points, in the order of time.
    pub fn stops(&self) -> &[WayStop] {
        &self.0
    }

    /// Where the script is at a time since the session began \[s\]: it rests before its first point and
    /// after its last.
    pub fn at(&self, time_s: f64) -> OnWay {
        let next = self.0.partition_point(|stop| stop.time_s <= time_s);
        let (from, to) = match (next.checked_sub(1), self.0.get(next)) {
            (Some(last), Some(to)) => (&self.0[last], to),
            (Some(last), None) => (&self.0[last], &self.0[last]),
            (None, _) => (&self.0[0], &self.0[0]),
        };
        let length_s = to.time_s - from.time_s;
        // Rests: both ends are one point.
        let s = if length_s > 0.0 {
            (time_s - from.time_s) / length_s
        } else {
            1.0
        };
        let blend = s * s * s * (10.0 - 15.0 * s + 6.0 * s * s);
        let rate = if length_s > 0.0 {
            30.0 * s * s * (1.0 - s) * (1.0 - s) / length_s
        } else {
            0.0
        };
        let between = |a: [f64; 3], b: [f64; 3]| Vector3::from(a).lerp(&Vector3::from(b), blend);
        let turn = UnitQuaternion::from_scaled_axis(between(from.rotation_rad, to.rotation_rad));
        let moved = from.position_m.zip(to.position_m).map(|(a, b)| {
            let velocity = (Vector3::from(b) - Vector3::from(a)) * rate;
            (between(a, b).into(), velocity.into())
        });
        OnWay {
            moved,
            orientation: turn.coords.into(),
        }
    }
}

/// The script of a tool, if it has one.
///
/// # Errors
/// A flaw at a time that goes back, a position that the console gives already or that is missing, or a second
/// orientation.
pub(super) fn read_way(
    document: &Document,
    section: &ToolSection,
    driven: bool,
) -> Result<Option<Way>, SceneError> {
    if section.way_point.is_empty() {
        return Ok(None);
    }
    if let Some(orientation) = &section.orientation {
        let message = "an orientation beside way points, which turn the grip";
        let help =
            "leave `orientation` out: `rotation_deg` of the way points says how the grip is turned";
        return Err(document.flaw(orientation.span(), message, "said twice", Some(help)));
    }
    if let Some(position) = section.position_m.as_ref().filter(|_| !driven) {
        let message = "a position beside way points, which move the grip";
        let help = "leave `position_m` out: that of the way points says where the grip is";
        return Err(document.flaw(position.span(), message, "said twice", Some(help)));
    }
    let mut stops: Vec<WayStop> = Vec::with_capacity(section.way_point.len());
    for point in &section.way_point {
        let ToolWayPointSection {
            time_s,
            rotation_deg,
            position_m,
        } = point.get_ref();
        let before_s = stops.last().map_or(0.0, |stop| stop.time_s);
        let rule = format!("at least {before_s}, the time before it, and at most {LATEST_S}");
        let help = "times are counted from the start of the session and do not go back";
        let in_order = |t| t >= before_s && t <= LATEST_S;
        let time_s = document.number("time_s", time_s, &rule, in_order, help)?;
        let rotation_rad = match rotation_deg {
            Some(rotation) => document
                .finite("rotation_deg", rotation)?
                .map(f64::to_radians),
            None => [0.0; 3],
        };
        let position_m = match (position_m, driven) {
            (Some(position), false) => Some(document.finite("position_m", position)?),
            (None, true) => None,
            (Some(position), true) => {
                let message = "a position for a tool that the console carries";
                let help = "leave `position_m` out here, and say in `[hand]` where the grip goes";
                return Err(document.flaw(
                    position.span(),
                    message,
                    "the console says where",
                    Some(help),
                ));
            }
            (None, false) => {
                let message = "a way point without a place";
                let help = "add `position_m`: the console does not carry this tool";
                return Err(document.flaw(point.span(), message, "no position_m", Some(help)));
            }
        };
        stops.push(WayStop {
            time_s,
            position_m,
            rotation_rad,
        });
    }
    Ok(Some(Way(stops)))
}

/// Where the tool's own section begins.
pub(super) fn place(section: &Spanned<ToolSection>) -> std::ops::Range<usize> {
    let radius = section.get_ref().radius_m.as_ref();
    radius.map_or_else(|| section.span(), Spanned::span)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn way() -> Way {
        let stop = |time_s, x, degrees: f64| WayStop {
            time_s,
            position_m: Some([x, 0.0, 0.0]),
            rotation_rad: [0.0, degrees.to_radians(), 0.0],
        };
        Way(vec![
            stop(1.0, 0.0, 0.0),
            stop(3.0, 0.4, 90.0),
            stop(3.0, 0.4, 90.0),
            stop(4.0, 0.0, -270.0),
        ])
    }

    #[test]
    fn a_grip_rests_before_and_after_and_passes_the_middle_at_full_speed() {
        let way = way();
        assert_eq!(way.at(-1.0), way.at(1.0));
        assert_eq!(way.at(9.0), way.at(4.0));
        let (start, speed) = way.at(1.0).moved.expect("moved");
        assert_eq!((start, speed), ([0.0; 3], [0.0; 3]));
        let middle = way.at(2.0);
        let (at, speed) = middle.moved.expect("moved");
        assert!((at[0] - 0.2).abs() < 1e-15);
        // Minimum jerk: 15/8 of the mean speed.
        assert!((speed[0] - 15.0 / 8.0 * 0.2).abs() < 1e-15, "{speed:?}");
        let half = 22.5f64.to_radians();
        let expected = [0.0, half.sin(), 0.0, half.cos()];
        for (found, expected) in middle.orientation.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-15);
        }
    }

    #[test]
    fn speeds_are_the_derivatives_of_places() {
        let (way, h) = (way(), 1e-6);
        for time in [1.2, 2.7, 3.3, 3.9] {
            let at = |t| way.at(t).moved.expect("moved");
            let slope = (at(time + h).0[0] - at(time - h).0[0]) / (2.0 * h);
            assert!((slope - at(time).1[0]).abs() < 1e-8, "at {time} s");
        }
    }

    /// A rotation vector may go round more than once: it is what the hand does, not only where it ends.
    #[test]
    fn a_turn_goes_the_way_that_is_written() {
        let quarter = |t: f64| {
            let [x, y, z, w] = way().at(t).orientation;
            let turn =
                UnitQuaternion::new_unchecked(nalgebra::Quaternion::new(w, x, y, z)).scaled_axis();
            turn.y.to_degrees()
        };
        // From 90 degrees back through -90 to -270: half way at -90.
        assert!((quarter(3.5) + 90.0).abs() < 1e-9, "{}", quarter(3.5));
    }
}
