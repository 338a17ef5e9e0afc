//! The press that candidates are measured on: the hand's first, or one along the normal if it never touches.
//!
//! Entry point: [`Press::of`].

use nalgebra::Vector3;
use sutura_host::mesh::Surface;
use sutura_host::scene::{Pose, Scene, position_at};
use sutura_host::script::gap_at_rest;
use sutura_host::tool::Tool;
use sutura_shared::wire::message::HandScript;

/// How closely the hand's path is looked at \[s\].
const LOOK_S: f64 = 0.005;
/// How deep a press goes that the hand does not make, in radii, or mean edges where those are longer.
const DEPTH_RADII: f64 = 0.3;
/// How far outside it begins \[m\].
const OUTSIDE_M: f64 = 1e-4;

/// A way of the driven tool's grip, from where it is still outside to where it is deepest.
#[derive(Clone, Copy, Debug)]
pub(super) enum Press {
    /// The hand's own, between two times \[s\].
    Hand {
        hand: HandScript,
        from_s: f64,
        to_s: f64,
    },
    /// Straight between two places \[m\].
    Straight {
        from_m: Vector3<f64>,
        to_m: Vector3<f64>,
    },
}

impl Press {
    /// Of a scene's driven tool; none without a tool that touches.
    pub fn of(scene: &Scene) -> Option<Self> {
        let tool = &scene.driven()?.shape;
        let surface = scene.mesh.surface();
        let gap = |at: [f64; 3]| gap(scene, &surface, tool, at);
        let hand = scene.hand;
        if let Some(press) = hand.and_then(|hand| of_hand(hand, scene.seconds, gap)) {
            return Some(press);
        }
        let start = hand.map_or([0.0; 3], |hand| position_at(&hand, 0.0));
        let (apart, normal) = gap(start)?;
        let deep = DEPTH_RADII * tool.radius_m().max(surface.mean_edge_m);
        let start = Vector3::from(start);
        Some(Press::Straight {
            from_m: start - normal * (apart - OUTSIDE_M),
            to_m: start - normal * (apart + deep),
        })
    }

    /// Its beginning, and `steps` places more at equal times \[m\].
    pub fn places(&self, steps: usize) -> Vec<[f64; 3]> {
        let at = |step| {
            let share = step as f64 / steps as f64;
            match self {
                Press::Hand { hand, from_s, to_s } => {
                    position_at(hand, from_s + share * (to_s - from_s))
                }
                Press::Straight { from_m, to_m } => from_m.lerp(to_m, share).into(),
            }
        };
        (0..=steps).map(at).collect()
    }
}

/// The hand's first press, if it has one that begins outside.
fn of_hand(
    hand: HandScript,
    seconds: f64,
    gap: impl Fn([f64; 3]) -> Option<(f64, Vector3<f64>)>,
) -> Option<Press> {
    // It rests after its last way point.
    let points = &hand.way_points[..usize::from(hand.count).min(hand.way_points.len())];
    let rests_s = points.last().map_or(0.0, |last| f64::from(last.time_s));
    let time = |step: usize| LOOK_S * step as f64;
    let steps = (seconds.min(rests_s) / LOOK_S).ceil() as usize;
    let mut gaps = (0..=steps).map(|step| {
        let found = gap(position_at(&hand, time(step)));
        (step, found.map_or(f64::MAX, |(gap, _)| gap))
    });
    let (touch, mut least) = gaps.find(|(_, gap)| *gap < 0.0)?;
    let mut deepest = touch;
    for (step, gap) in gaps {
        if gap > least {
            break;
        }
        (deepest, least) = (step, gap);
    }
    Some(Press::Hand {
        hand,
        from_s: time(touch.checked_sub(1)?),
        to_s: time(deepest),
    })
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
    gap_at_rest(surface, scene.mesh.points_m(), tool, &pose)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;
    use sutura_host::scene::{Document, read};

    fn scene(seconds: f64, way_points: &str) -> Scene {
        let text = format!(
            r#"
name = "Press"
seconds = {seconds}
device = "cartesian-bench"
[mesh.slab]
size_m = [0.06, 0.06, 0.03]
divisions = [6, 6, 3]
[tissue]
youngs_modulus_pa = 10e3
poisson_ratio = 0.4
[[fixed]]
plane = {{ axis = "z", at_m = -0.03 }}
[[tool]]
radius_m = 0.01
[hand]
stiffness_n_per_m = 1000.0
damping_n_s_per_m = 10.0
way_point = [{way_points}]
"#
        );
        read(&Document::embedded("press.toml", Path::new(""), &text)).expect("a scene")
    }

    const TWICE: &str = "{ time_s = 0.0, position_m = [0.0, 0.0, 0.02] },
        { time_s = 1.0, position_m = [0.0, 0.0, 0.008] },
        { time_s = 2.0, position_m = [0.0, 0.0, 0.02] },
        { time_s = 3.0, position_m = [0.0, 0.0, 0.004] }";

    fn gap_at(scene: &Scene, at: [f64; 3]) -> f64 {
        let tool = &scene.driven().expect("a tool").shape;
        gap(scene, &scene.mesh.surface(), tool, at)
            .expect("a gap")
            .0
    }

    #[test]
    fn it_is_the_hands_first() {
        for seconds in [4.0, 86_400.0] {
            let scene = scene(seconds, TWICE);
            let press = Press::of(&scene).expect("a press");
            for steps in [4, 24] {
                let way = press.places(steps);
                assert_eq!(way.len(), steps + 1);
                assert!((0.0..2e-4).contains(&gap_at(&scene, way[0])), "{way:?}");
                assert!((way[steps][2] - 0.008).abs() < 1e-6, "{way:?}");
                assert!(way.is_sorted_by(|a, b| a[2] >= b[2]), "{way:?}");
            }
        }
        // Over before its first press is deepest.
        let way = Press::of(&scene(0.8, TWICE)).expect("a press").places(4);
        assert!((0.0085..0.0099).contains(&way[4][2]), "{way:?}");
    }

    #[test]
    fn a_hand_that_never_touches_is_taken_along_the_normal() {
        let scene = scene(5.0, "{ time_s = 0.0, position_m = [0.0, 0.0, 0.02] }");
        let way = Press::of(&scene).expect("a press").places(6);
        assert!((gap_at(&scene, way[0]) - OUTSIDE_M).abs() < 1e-9, "{way:?}");
        // The mesh is coarser than the tool.
        let deep = DEPTH_RADII * scene.mesh.surface().mean_edge_m;
        assert!((gap_at(&scene, way[6]) + deep).abs() < 1e-9, "{way:?}");
    }
}
