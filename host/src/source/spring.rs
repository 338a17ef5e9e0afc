//! Springs between two points of tissue, or from one to a fixed place.
//!
//! Entry point: [`SpringSection`]. With d from end to end and n = d/|d| the tension is T = k (|d| - L). Linearised at the last
//! solve that is a row along n that gives way by 1/k and, while T > 0, two across that give way by |d|/T, as the force turns.

use super::added::{
    Added, Kept, Section, append_way, check_between, check_near, frame_along, nearest_node,
};
use super::{Room, Source};
use crate::anchors::AnchorPoint;
use crate::mesh::TetMesh;
use crate::step::{Balance, Sources, Status};
use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::Deserialize;
use std::sync::Arc;

/// `[[spring]]`: pulls two points together, or pushes them apart, along the line between them.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SpringSection {
    /// The node nearest to this place of the unloaded mesh \[m\], (3).
    from_m: [f64; 3],
    /// The other end, as `from_m` \[m\], (3).
    to_m: [f64; 3],
    /// Whether the other end is a fixed place in the room instead.
    #[serde(default)]
    to_is_fixed: bool,
    /// Tension per length \[N/m\].
    stiffness_n_per_m: f64,
    /// Length without tension \[m\]; as long as it is at rest when left out.
    length_m: Option<f64>,
}

#[derive(Debug)]
struct Spring {
    index: usize,
    ends: [Option<AnchorPoint>; 2],
    said: SpringSection,
}

impl Section for SpringSection {
    fn build(&self, index: usize, mesh: &TetMesh) -> Result<Arc<dyn Added>, String> {
        check_between("stiffness_n_per_m", self.stiffness_n_per_m, (0.0, 1e9))?;
        check_between("length_m", self.length_m.unwrap_or(1.0), (0.0, 10.0))?;
        let finite = self.from_m.iter().chain(&self.to_m).all(|x| x.is_finite());
        if !finite {
            return Err("`from_m` and `to_m` must be two places".to_owned());
        }
        let from = nearest_node(mesh, "from_m", self.from_m)?;
        let to = match self.to_is_fixed {
            true => {
                check_near(mesh, "to_m", self.to_m)?;
                None
            }
            false => Some(nearest_node(mesh, "to_m", self.to_m)?),
        };
        if self.from_m == self.to_m || to == Some(from) {
            return Err("`from_m` and `to_m` must be two places, not at one node".to_owned());
        }
        let (ends, said) = ([Some(from), to], self.clone());
        Ok(Arc::new(Spring { index, ends, said }))
    }
}

impl Spring {
    /// From one end to the other \[m\], if points are where `at` says.
    fn way(&self, at: impl Fn(&AnchorPoint) -> Vector3<f64>) -> Vector3<f64> {
        let [from, to] = self.ends.each_ref().map(|end| end.as_ref().map(&at));
        to.unwrap_or(self.said.to_m.into()) - from.unwrap_or_default()
    }
}

/// What is kept: the way at the last solve \[m\], (3), and the length without tension \[m\].
impl Source for Spring {
    fn room(&self, _sources: &Sources) -> Room {
        Room::new(2, 3)
    }

    fn append(&self, balance: &mut Balance) {
        let [x, y, z, length_m, ..] = balance.state.memory[self.index];
        let (way, unloaded) = (Vector3::new(x, y, z), self.way(|at| balance.unloaded(at)));
        let stiff = self.said.stiffness_n_per_m;
        let turns = stiff * (way.norm() - length_m) / way.norm();
        let row = |n: Vector3<f64>, rest_m, stiff| (n, rest_m - n.dot(&unloaded), stiff);
        let [along, one, other] = frame_along(&way);
        let rows = [
            row(along, length_m, stiff),
            row(one, 0.0, turns),
            row(other, 0.0, turns),
        ];
        append_way(&mut balance.work.set, self.index, self.ends, rows);
    }

    fn settle(&self, balance: &mut Balance, _solve: u32) -> Result<bool, Status> {
        let now = self.way(|at| balance.position_of(at));
        let kept = &mut balance.state.memory[self.index];
        let change = (now - Vector3::new(kept[0], kept[1], kept[2])).norm();
        kept[..3].copy_from_slice(now.as_slice());
        Ok(change <= 1e-9 * now.norm())
    }
}

impl Added for Spring {
    fn begin(&self, rest: &dyn Fn(&AnchorPoint) -> Vector3<f64>, kept: &mut Kept) {
        let way = self.way(rest);
        kept[..3].copy_from_slice(way.as_slice());
        kept[3] = self.said.length_m.unwrap_or(way.norm());
    }

    fn explain(&self) -> (String, String) {
        let why = format!("`[[spring]]`: {} N/m", self.said.stiffness_n_per_m);
        (format!("spring {}", self.index), why)
    }

    fn values(&self, kept: &Kept) -> Vec<(&'static str, f64)> {
        let length_m = Vector3::new(kept[0], kept[1], kept[2]).norm();
        let tension_n = self.said.stiffness_n_per_m * (length_m - kept[3]);
        vec![("length_m", length_m), ("tension_n", tension_n)]
    }
}

#[cfg(test)]
#[test]
fn the_tangent_of_a_tool_beside_a_spring_is_that_of_whole_steps() {
    // Whole steps there and back slip where the tool rubs.
    let slab = include_str!("../../../scenes/tied-slab.toml").replace("friction = 0.1\n", "");
    let slab = slab.as_str();
    let (tied, error) = super::testing::held(slab, 0.014);
    let (free, _) = super::testing::held(slab.split("[[spring]]").next().unwrap_or(""), 0.014);
    let change_n = tied.contacts()[0].wrench[2] - free.contacts()[0].wrench[2];
    assert!(change_n > 0.01 && error < 1e-6, "{change_n} N, {error}");
}
