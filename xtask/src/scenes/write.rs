//! Parts of scene files that several scenes have.
//!
//! Entry points: [`needle`], [`hand`], [`console_hand`].

use super::stitch::{Sewing, Stop};
use super::turn::Vec3;
use std::fmt::Write;

/// A tenth of a micrometre.
const METRES: usize = 7;
/// A ten-thousandth of a degree: 17 nm at 10 mm.
const DEGREES: usize = 4;

/// `[x, y, z]`, without negative zeros.
pub fn vector(x: Vec3, digits: usize) -> String {
    let tiny = 0.5 * 0.1f64.powi(digits as i32);
    let [x, y, z] = x.map(|v| if v.abs() < tiny { 0.0 } else { v });
    format!("[{x:.digits$}, {y:.digits$}, {z:.digits$}]")
}

/// A position \[m\].
pub fn position(x: Vec3) -> String {
    vector(x, METRES)
}

/// `[[needle]]` at its start; `holds` are times and ids of tools.
pub fn needle(text: &mut String, sewing: &Sewing, holds: &[(f64, u8)]) {
    let [end, direction, towards] = sewing.start();
    let (radius, angle, thickness) = (sewing.radius_m, sewing.angle_deg, sewing.thickness_m);
    let _ = write!(
        text,
        "[[needle]]
shape = \"arc\"
radius_m = {radius}
angle_deg = {angle:?}
thickness_m = {thickness}
end_m = {}
direction = {}
towards = {}
hold = [
",
        position(end),
        position(direction),
        position(towards),
    );
    for (time_s, tool) in holds {
        let _ = writeln!(text, "  {{ time_s = {time_s:.3}, tool = {tool} }},");
    }
    text.push_str("]\n\n");
}

/// `[[tool]]`: a grip with its script, which takes what is so far from it \[m\].
pub fn hand(text: &mut String, id: u8, reach_m: f64, stops: &[Stop]) {
    let _ = writeln!(
        text,
        "[[tool]]\nid = {id}\nshape = \"grip\"\nreach_m = {reach_m}\nway_point = ["
    );
    for stop in stops {
        let at = position(stop.position_m);
        let _ = write!(text, "  {{ time_s = {:.3}, position_m = {at}", stop.time_s);
        if stop.rotation_deg != [0.0; 3] {
            let turn = vector(stop.rotation_deg, DEGREES);
            let _ = write!(text, ", rotation_deg = {turn}");
        }
        text.push_str(" },\n");
    }
    text.push_str("]\n\n");
}

/// `[hand]`, on the console's grip.
pub fn console_hand(text: &mut String, way: &[(f64, Vec3)]) {
    text.push_str(
        "# The hand is a spring: the grip stays behind these points by force / stiffness.
[hand]
stiffness_n_per_m = 2000.0
damping_n_s_per_m = 20.0
way_point = [
",
    );
    for (time_s, at) in way {
        let at = position(*at);
        let _ = writeln!(text, "  {{ time_s = {time_s:.3}, position_m = {at} }},");
    }
    text.push_str("]\n\n");
}
