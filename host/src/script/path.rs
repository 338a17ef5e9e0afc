//! What a session comes by if its hands keep to their scripts.
//!
//! Entry point: [`path`].

use super::holds::Taken;
use super::{Script, isometry};
use crate::scene::{Needle, Pose, Scene};
use nalgebra::{Isometry3, UnitVector3, Vector3};

/// Places that a session comes by if its hands keep to their scripts.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Path {
    /// Of the driven tool's grip, and how it is turned there.
    pub grips: Vec<Pose>,
    /// Of the needles' centre lines \[m\].
    pub needles: Vec<Vector3<f64>>,
    /// Between pads that close \[m\].
    pub pads: Vec<Vector3<f64>>,
    /// Of needles that are let go and have a weight.
    pub falls: Vec<Fall>,
}

/// A needle's fall, which may tip over where it lands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fall {
    /// Its centre where it is let go \[m\].
    from_m: Vector3<f64>,
    along: UnitVector3<f64>,
    /// As far from its centre's line it may come to lie \[m\].
    reach_m: f64,
}

impl Fall {
    /// Of a needle that is let go with its centre line through `places`; nothing of one that no gravity draws.
    fn of(places: &[Vector3<f64>], gravity: &[f64; 3]) -> Option<Self> {
        let along = UnitVector3::try_new(Vector3::from(*gravity), 0.0)?;
        let from_m = places.iter().sum::<Vector3<f64>>() / places.len() as f64;
        let farthest = |most: f64, place: &Vector3<f64>| most.max((place - from_m).norm());
        // An end stays where it touches first, and the other goes over it.
        let reach_m = 2.0 * places.iter().fold(0.0, farthest);
        Some(Self {
            from_m,
            along,
            reach_m,
        })
    }

    /// Whether it may come to lie on a surface at `vertex` \[m\], whose outward normal is `normal`.
    pub fn lands_on(&self, vertex: &Vector3<f64>, normal: &Vector3<f64>) -> bool {
        let way = vertex - self.from_m;
        let down_m = way.dot(&self.along);
        let beside_m = (way - self.along.scale(down_m)).norm();
        normal.dot(&self.along) < 0.0 && down_m >= -self.reach_m && beside_m <= self.reach_m
    }
}

/// Where the scripts lead until `seconds` \[s\], looked at `every_s`; points of a needle are at most `apart_m` from each
/// other. Empty without a hand.
pub fn path(scene: &Scene, seconds: f64, every_s: f64, apart_m: f64) -> Path {
    let mut path = Path::default();
    if scene.hand.is_none() {
        return path;
    }
    let mut script = Script::new(scene);
    // Needles as they would go in the open, and in which tool's frame they are where.
    let mut poses: Vec<Isometry3<f64>> = scene.needles.iter().map(|n| n.start).collect();
    let mut grips: Vec<Option<(u8, Isometry3<f64>)>> = vec![None; poses.len()];
    // Who is to take each, but does not reach it yet.
    let mut waiting: Vec<Option<u8>> = vec![None; poses.len()];
    let along = |needle: &Needle, pose: &Isometry3<f64>| -> Vec<Vector3<f64>> {
        let curve = needle.needle.at(pose);
        let pieces = (curve.length / apart_m).ceil().max(1.0) as u32;
        let alphas = (0..=pieces).map(|k| curve.length * f64::from(k) / f64::from(pieces));
        alphas.map(|alpha| curve.at(alpha)).collect()
    };
    let places = (seconds / every_s).ceil().max(0.0) as u32;
    for place in 0..=places {
        let time_s = f64::from(place) * every_s;
        while let Some(change) = script.due(time_s) {
            let Taken::Needle { id, tool } = change.what else {
                continue;
            };
            let index = scene.needles.iter().position(|n| n.id == id);
            if let Some(index) = index {
                waiting[index] = tool;
                if tool.is_none() {
                    grips[index] = None;
                    let needle = &scene.needles[index];
                    let weight = needle.weight.iter();
                    let places = along(needle, &poses[index]);
                    let falls = weight.filter_map(|w| Fall::of(&places, &w.gravity_m_per_s2));
                    path.falls.extend(falls);
                }
            }
        }
        for (index, needle) in scene.needles.iter().enumerate() {
            let Some((tool, reach_m)) = waiting[index].and_then(|id| script.hand(id)) else {
                continue;
            };
            let at = Vector3::from(tool.position_m);
            let pose = &poses[index];
            if needle.needle.at(pose).nearest(&at).metric_distance(&at) <= reach_m {
                grips[index] = Some((tool.id, isometry(&tool).inverse() * pose));
                waiting[index] = None;
            }
        }
        let in_hand = script.in_hand(time_s);
        script.go(time_s, in_hand);
        if let Some(grip) = script.samples.first().filter(|_| script.is_driven) {
            path.grips.push(Pose {
                position_m: grip.position_m,
                orientation: grip.orientation,
            });
        }
        for (jaws, before) in &mut script.jaws {
            let closes = jaws.is_closed(time_s);
            let begins = closes && !std::mem::replace(before, closes);
            let tool = script.samples.iter().find(|s| s.id == jaws.part.tool);
            if let Some(tool) = tool.filter(|_| begins) {
                let pads = jaws.part.jaws.between(&isometry(tool), apart_m);
                path.pads.extend(pads);
            }
        }
        for ((needle, pose), grip) in scene.needles.iter().zip(&mut poses).zip(&grips) {
            let holder = grip.and_then(|(id, _)| script.sample(id));
            if let (Some(tool), Some((_, in_grip))) = (holder, grip) {
                *pose = isometry(&tool) * in_grip;
            }
            path.needles.extend(along(needle, pose));
        }
    }
    path
}
