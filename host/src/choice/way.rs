//! The press that candidates are measured on: the hand's first, or one along the normal if it never touches.
//!
//! Entry point: [`press`].

use crate::contact::shape::Solid;
use crate::mesh::Surface;
use crate::scene::Pose;
use crate::scene::{Scene, position_at};
use crate::script::at_rest;
use crate::tool::Tool;
use nalgebra::Vector3;

/// How closely the hand's path is looked at \[s\].
const LOOK_S: f64 = 0.005;
/// How deep a press goes that the hand does not make, in radii.
const DEPTH_RADII: f64 = 0.3;

/// Ways of the driven tool's grip \[m\]: from where it is still outside to where its first press is deepest, in `places` equal
/// times. None without a tool that touches.
pub(super) fn press(scene: &Scene, places: usize) -> Option<Vec<[f64; 3]>> {
    let tool = &scene.driven()?.shape;
    let surface = scene.mesh.surface();
    let gap = |at: [f64; 3]| gap(scene, &surface, tool, at).map_or(f64::MAX, |found| found.0);
    if let Some(hand) = &scene.hand {
        let at = |step: usize| position_at(hand, LOOK_S * step as f64);
        let steps = (scene.seconds / LOOK_S) as usize;
        let gaps: Vec<f64> = (0..=steps).map(|step| gap(at(step))).collect();
        if let Some(touch) = gaps
            .iter()
            .position(|gap| *gap < 0.0)
            .filter(|step| *step > 0)
        {
            let mut deepest = touch;
            while deepest < steps && gaps[deepest + 1] <= gaps[deepest] {
                deepest += 1;
            }
            let (from, to) = ((touch - 1) as f64, deepest as f64);
            let times =
                (0..=places).map(|k| LOOK_S * (from + (to - from) * k as f64 / places as f64));
            return Some(times.map(|time_s| position_at(hand, time_s)).collect());
        }
    }
    let start = scene
        .hand
        .as_ref()
        .map_or([0.0; 3], |hand| position_at(hand, 0.0));
    let (apart, normal) = self::gap(scene, &surface, tool, start)?;
    let deep = DEPTH_RADII * tool.radius_m().max(surface.mean_edge_m);
    let ways = (0..=places).map(|k| apart - 1e-4 + (deep + 1e-4) * k as f64 / places as f64);
    Some(
        ways.map(|way| (Vector3::from(start) - normal * way).into())
            .collect(),
    )
}

/// How far the tool is from the tissue at rest with its grip there \[m\], and the normal out of the tissue.
fn gap(
    scene: &Scene,
    surface: &Surface,
    tool: &Tool,
    grip: [f64; 3],
) -> Option<(f64, Vector3<f64>)> {
    let pose = Pose {
        position_m: grip,
        orientation: [0.0, 0.0, 0.0, 1.0],
    };
    let placement = tool.place(&at_rest(0, &pose))?;
    let solid = Solid::new(tool, surface.mean_edge_m, &placement);
    let points = scene.mesh.points_m();
    let at = |node: u32| Vector3::from(points[node as usize]);
    let gaps = surface
        .vertices
        .iter()
        .map(|node| (solid.gap(&at(*node)), *node));
    let (gap, node) = gaps.min_by(|a, b| a.0.total_cmp(&b.0))?;
    Some((gap, -solid.touch(&at(node))?.normal))
}
