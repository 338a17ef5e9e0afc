//! Shortest ways out of the tissue for a tool that has slipped into it.
//!
//! Entry point: [`WayOut::from`]. Allocates: for people at a page, not for the loop.

use crate::collide::closest;
use crate::contact::shape::Solid;
use crate::mesh::Surface;
use crate::scene::{Pose, Scene};
use crate::script::at_rest;
use crate::tool::Tool;
use nalgebra::Vector3;
use std::collections::BTreeSet;

/// Clearance beyond the first place that is free, over the tool's radius: tissue that moves does not touch it at once.
const CLEARANCE: f64 = 0.2;
/// Overlap that round-off makes, over the tool's radius.
const ROUNDING: f64 = 1e-9;
/// Step along a way on which the first free place is looked for, over the tool's radius.
const STEP: f64 = 0.1;
/// Depth of a point below the boundary that counts as in the tissue, over the mean edge.
const BELOW: f64 = 0.01;

/// Difference of distances that counts as none, over the mean edge.
const AS_NEAR: f64 = 1e-6;

/// The tissue at rest, and the tool that the console's grip carries.
#[derive(Clone, Debug)]
pub struct WayOut {
    surface: Surface,
    /// Nodes \[m\], (n x 3).
    points_m: Vec<[f64; 3]>,
    /// Nodes that are held, ascending.
    held: Vec<u32>,
    tool: Tool,
    /// Place of the grip at which the scene's hand begins, if there is one \[m\].
    begins_m: Option<[f64; 3]>,
    /// Tools that stand still.
    others: Vec<Solid>,
}

impl WayOut {
    /// Builds it for a scene whose nodes rest at `points_m` (n x 3); none if the console's grip carries nothing that touches.
    pub fn of(scene: &Scene, points_m: &[[f64; 3]]) -> Option<Self> {
        let tool = scene.driven()?.shape.clone();
        if tool.is_grip() || points_m.len() != scene.mesh.points_m().len() {
            return None;
        }
        let surface = scene.mesh.surface();
        let stand_still = scene.tools.iter().filter(|other| {
            let stays = !other.driven && other.way.is_none();
            stays && !other.shape.is_grip()
        });
        let others = stand_still.filter_map(|other| {
            let placement = other.shape.place(&at_rest(other.id, &other.pose?))?;
            Some(Solid::new(&other.shape, surface.mean_edge_m, &placement))
        });
        Some(Self {
            others: others.collect(),
            begins_m: scene.hand.map(|hand| {
                let [first, ..] = hand.way_points;
                first.position_m.map(f64::from)
            }),
            points_m: points_m.to_vec(),
            held: scene.fixed.clone(),
            tool,
            surface,
        })
    }

    /// Displacement of the grip \[m\] after which its tool is clear of the tissue at rest and of tools that stand still, along the normal of
    /// a vertex: the shortest one that leads to where the place is in sight at which the hand begins, or out through no held face, which
    /// is a wall. Zero for a tool that is clear already and has not `slipped` in; `None` for no pose, or where no way is found.
    pub fn from(&self, grip: &Pose, slipped: bool) -> Option<[f64; 3]> {
        let placement = self.tool.place(&at_rest(0, grip))?;
        let solid = Solid::new(&self.tool, self.surface.mean_edge_m, &placement);
        if !slipped && self.is_clear(&solid) && !self.meets_another(&solid) {
            return Some([0.0; 3]);
        }
        let begins = self.in_tissue(&solid.middle())?;
        let start = self.start(grip);
        // A tool that presses from outside goes back to that side.
        let outside = Some(solid.middle()).filter(|at| !slipped && !self.contains(at));
        let mut shortest: Option<(f64, Vector3<f64>)> = None;
        for (least_m, normal) in self.directions(&solid) {
            if shortest.is_some_and(|(way_m, _)| least_m >= way_m) {
                break;
            }
            let Some(way_m) = self.free_after(&solid, &normal, least_m) else {
                continue;
            };
            let end = solid.middle() + normal * way_m;
            let is_walled = || self.leads_through_held(&begins, &end) || self.is_beyond_held(&end);
            let leads_out = match outside {
                Some(_) => self.is_in_sight(outside.as_ref(), &end),
                None => self.is_in_sight(start.as_ref(), &end) || !is_walled(),
            };
            if !leads_out {
                continue;
            }
            if shortest.is_none_or(|(before_m, _)| way_m < before_m) {
                shortest = Some((way_m, normal));
            }
        }
        let (way_m, normal) = shortest?;
        Some((normal * (way_m + CLEARANCE * solid.radius())).into())
    }

    fn at(&self, node: u32) -> Vector3<f64> {
        self.points_m[node as usize].into()
    }

    fn contains(&self, point: &Vector3<f64>) -> bool {
        self.surface.contains(&self.points_m, (*point).into())
    }

    /// Whether a tool touches nothing of the tissue at rest.
    fn is_clear(&self, solid: &Solid) -> bool {
        let least_m = -ROUNDING * solid.radius();
        let mut vertices = self.surface.vertices.iter();
        vertices.all(|node| solid.gap(&self.at(*node)) >= least_m)
            && !solid.cores().iter().any(|core| self.contains(core))
    }

    /// Point in the tissue at a place, or below the boundary vertex next to it.
    fn in_tissue(&self, place: &Vector3<f64>) -> Option<Vector3<f64>> {
        if self.contains(place) {
            return Some(*place);
        }
        let vertices = self.surface.vertices.iter().zip(&self.surface.normals);
        let far = |node: u32| (self.at(node) - place).norm_squared();
        let (node, normal) = vertices.min_by(|a, b| far(*a.0).total_cmp(&far(*b.0)))?;
        let below_m = BELOW * self.surface.mean_edge_m;
        Some(self.at(*node) - Vector3::from(*normal) * below_m)
    }

    /// Outward normals of all vertices, each once, with the least way that could lead past such a vertex \[m\], ascending.
    fn directions(&self, solid: &Solid) -> Vec<(f64, Vector3<f64>)> {
        let middle = solid.middle();
        let vertices = self.surface.vertices.iter().zip(&self.surface.normals);
        let mut ways: Vec<_> = vertices
            .map(|(node, normal)| {
                let normal = Vector3::from(*normal);
                let beyond_m = (self.at(*node) - middle).dot(&normal) + solid.radius();
                (beyond_m.max(0.0), normal)
            })
            .collect();
        ways.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut seen = BTreeSet::new();
        // To a few degrees.
        ways.retain(|(_, normal)| {
            seen.insert(<[f64; 3]>::from(*normal).map(|x| (16.0 * x).round() as i8))
        });
        ways
    }

    /// Shortest way along a direction, from `least_m` on, after which a tool is clear \[m\].
    fn free_after(&self, solid: &Solid, along: &Vector3<f64>, least_m: f64) -> Option<f64> {
        let step_m = STEP * solid.radius();
        let most = 2.0 * solid.bound() / step_m;
        let mut ways = (0..=most.ceil() as u32).map(|step| least_m + f64::from(step) * step_m);
        ways.find(|way_m| {
            let there = solid.moved(&(along * *way_m));
            self.is_clear(&there) && !self.meets_another(&there)
        })
    }

    /// Whether a tool overlaps another one, by the points well inside it.
    fn meets_another(&self, solid: &Solid) -> bool {
        let apart_m = (1.0 + CLEARANCE) * solid.radius();
        let mut others = self.others.iter();
        others.any(|other| solid.cores().iter().any(|core| other.gap(core) < apart_m))
    }

    /// Middle of a tool that is held as the grip is, where the hand begins; none if that is not clear.
    fn start(&self, grip: &Pose) -> Option<Vector3<f64>> {
        let pose = Pose {
            position_m: self.begins_m?,
            ..*grip
        };
        let placement = self.tool.place(&at_rest(0, &pose))?;
        let solid = Solid::new(&self.tool, self.surface.mean_edge_m, &placement);
        self.is_clear(&solid).then(|| solid.middle())
    }

    /// Whether no tissue is between two places: then the solver calls neither behind a wall.
    fn is_in_sight(&self, start: Option<&Vector3<f64>>, end: &Vector3<f64>) -> bool {
        start.is_some_and(|start| {
            let mut crossed = self.surface.crossed(|node| self.at(node), start, end);
            crossed.next().is_none()
        })
    }

    fn is_held(&self, triangle: &[u32; 3]) -> bool {
        let mut nodes = triangle.iter();
        nodes.all(|node| self.held.binary_search(node).is_ok())
    }

    fn leads_through_held(&self, from: &Vector3<f64>, to: &Vector3<f64>) -> bool {
        let mut crossed = self.surface.crossed(|node| self.at(node), from, to);
        crossed.any(|triangle| self.is_held(&triangle))
    }

    /// Whether a place outside of the tissue is on the far side of a held face that is nearest to it, or as near as any: there a tool
    /// would press on what is held from behind.
    fn is_beyond_held(&self, place: &Vector3<f64>) -> bool {
        let corners = |face: &[u32; 3]| face.map(|node| self.at(node) - place);
        let far_m = |face: &[u32; 3]| closest(&corners(face)).point.norm();
        let faces = || self.surface.triangles.iter();
        let nearest_m = faces().map(far_m).fold(f64::INFINITY, f64::min);
        let as_near_m = nearest_m + AS_NEAR * self.surface.mean_edge_m;
        let mut held = faces().filter(|face| self.is_held(face));
        held.any(|face| {
            let [a, b, c] = corners(face);
            far_m(face) <= as_near_m && a.dot(&(b - a).cross(&(c - a))) < 0.0
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Document, read};
    use proptest::prelude::*;

    fn slab(tool: &str) -> Scene {
        let text = format!(
            r#"
            name = "slab"
            device = "cartesian-bench"
            [mesh.slab]
            size_m = [0.08, 0.08, 0.03]
            divisions = [8, 8, 3]
            [tissue]
            model = "linear"
            youngs_modulus_pa = 15e3
            poisson_ratio = 0.45
            [[fixed]]
            plane = {{ axis = "z", at_m = -0.03 }}
            [[tool]]
            {tool}
            "#
        );
        read(&Document::embedded("slab.toml", "".as_ref(), &text)).expect("a scene")
    }

    fn grip(position_m: [f64; 3]) -> Pose {
        Pose {
            position_m,
            orientation: [0.0, 0.0, 0.0, 1.0],
        }
    }

    /// 11 mm below the top of the slab it leads upwards, by that and the radius; 4 mm above the floor on which the slab is fixed, too.
    #[test]
    fn it_leads_to_the_nearest_side_that_is_not_held() {
        let scene = slab("radius_m = 0.014");
        let ways = WayOut::of(&scene, scene.mesh.points_m()).expect("a tool");
        for depth_m in [0.011, 0.026] {
            let out = ways
                .from(&grip([0.0, 0.0, -depth_m]), false)
                .expect("a way");
            assert!(out[0].abs() < 1e-12 && out[1].abs() < 1e-12, "{out:?}");
            assert!((out[2] - (depth_m + 1.2 * 0.014)).abs() < 1e-9, "{out:?}");
        }
        assert_eq!(ways.from(&grip([0.0, 0.0, 0.02]), false), Some([0.0; 3]));
        let beside = slab("shape = \"grip\"");
        assert!(WayOut::of(&beside, beside.mesh.points_m()).is_none());
    }

    /// A rim of the top that is held with the floor is no wall to a tool beside it: the way leads up between.
    #[test]
    fn a_held_rim_leaves_the_way_up() {
        let mut tool = "shape = \"capsule\"\nradius_m = 0.01\nlength_m = 0.04".to_owned();
        for (axis, low) in [(0, 0.03), (0, -0.05), (1, 0.03), (1, -0.05)] {
            let (mut min_m, mut max_m) = ([-0.05, -0.05, -0.05], [0.05, 0.05, 0.01]);
            (min_m[axis], max_m[axis]) = (low, low + 0.02);
            tool += &format!("\n[[fixed]]\nbox = {{ min_m = {min_m:?}, max_m = {max_m:?} }}");
        }
        let scene = slab(&tool);
        let ways = WayOut::of(&scene, scene.mesh.points_m()).expect("a tool");
        for at in [
            [0.0, 0.0, -0.02],
            [0.01, 0.01, -0.015],
            [-0.015, 0.005, -0.01],
        ] {
            let out = ways.from(&grip(at), true).expect("a way");
            assert!(
                out[0].abs() < 1e-12 && out[1].abs() < 1e-12,
                "{at:?}: {out:?}"
            );
            assert!(at[2] + out[2] > 0.01 && out[2] < 0.06, "{at:?}: {out:?}");
        }
    }

    /// A ball that was drawn into a clamp that reaches the top is led up from it: the hand has begun above.
    #[test]
    fn it_leads_up_from_within_a_clamp() {
        let scene = slab(
            "radius_m = 0.014\n[[fixed]]\nbox = { min_m = [0.01, -0.05, -0.05], max_m = [0.05, 0.05, 0.01] }\n\
             [hand]\nstiffness_n_per_m = 500.0\ndamping_n_s_per_m = 5.0\n[[hand.way_point]]\ntime_s = 0.0\nposition_m = [0.0, 0.0, 0.03]",
        );
        let ways = WayOut::of(&scene, scene.mesh.points_m()).expect("a tool");
        for at in [[0.02, 0.0, -0.01], [0.025, 0.01, -0.012], [0.0, 0.0, -0.02]] {
            let out = ways.from(&grip(at), true).expect("a way");
            assert!(at[2] + out[2] > 0.014, "{at:?}: {out:?}");
        }
        // Pressed on the clamp from above, or on the floor from below, it is led away from there.
        for (at, up) in [([0.03, 0.0, 0.01], true), ([0.0, 0.0, -0.042], false)] {
            let out = ways.from(&grip(at), false).expect("a way");
            assert_eq!(out[2] > 0.0, up, "{at:?}: {out:?}");
            assert!(
                out[0].abs() < 1e-12 && out[2].abs() < 0.014,
                "{at:?}: {out:?}"
            );
        }
        // Never out below the floor.
        let out = ways.from(&grip([0.0, 0.0, -0.04]), true).expect("a way");
        assert!(-0.04 + out[2] > -0.03, "{out:?}");
    }

    /// A triangle of the top whose three nodes are held, as in a corner between two held sides, is no wall: the way leads up past it.
    #[test]
    fn a_lone_face_of_held_nodes_is_no_wall() {
        let mut tool = "radius_m = 0.014".to_owned();
        for (x, y) in [(0.04, 0.04), (0.04, -0.04), (-0.04, 0.04), (-0.04, -0.04)] {
            for [x, y] in [[x, y], [0.75 * x, y], [x, 0.75 * y]] {
                let (low, high) = ([x - 1e-4, y - 1e-4, -1e-4], [x + 1e-4, y + 1e-4, 1e-4]);
                tool += &format!("\n[[fixed]]\nbox = {{ min_m = {low:?}, max_m = {high:?} }}");
            }
        }
        let scene = slab(&tool);
        let ways = WayOut::of(&scene, scene.mesh.points_m()).expect("a tool");
        for (x, y) in [
            (0.025, 0.025),
            (0.025, -0.025),
            (-0.025, 0.025),
            (-0.025, -0.025),
        ] {
            let out = ways.from(&grip([x, y, -0.01]), true).expect("a way");
            assert!(out[2] - 0.01 > 0.014, "{x} {y}: {out:?}");
        }
    }

    /// Beside a punch that is held in the tissue the way leads past it.
    #[test]
    fn it_ends_in_no_other_tool() {
        let punch = "driven = true\nradius_m = 0.014\n[[tool]]\nid = 1\nshape = \"flat-punch\"\nradius_m = 0.0135\nfillet_m = 0.004\nlength_m = 0.04\n\
                     position_m = [0.022, 0.0, -0.003]";
        let scene = slab(punch);
        let ways = WayOut::of(&scene, scene.mesh.points_m()).expect("a tool");
        for at in [
            [0.0204, 0.0022, -0.0239],
            [0.0196, 0.0, -0.0142],
            [0.0272, 0.0069, -0.0149],
        ] {
            let out = ways.from(&grip(at), true).expect("a way");
            let [x, y, z] = [0, 1, 2].map(|axis: usize| at[axis] + out[axis]);
            // Off the punch's shaft, or above its upper end.
            let aside_m = (x - 0.022).hypot(y);
            assert!(
                aside_m > 0.0135 + 0.014 || z > 0.037 + 0.014,
                "{at:?} to {x} {y} {z}"
            );
        }
    }

    /// Behind the held floor the way leads up through the tissue or past its sides, never along below the floor; a tool that has slipped in
    /// is led out from there even if it is clear of the tissue.
    #[test]
    fn it_leads_out_from_behind_a_held_floor() {
        let scene = slab("radius_m = 0.014");
        let ways = WayOut::of(&scene, scene.mesh.points_m()).expect("a tool");
        for at in [
            [0.0, 0.0, -0.0313],
            [0.01, -0.003, -0.04],
            [0.0, 0.0, -0.1],
            [0.0401, 0.0361, -0.0338],
        ] {
            let out = ways.from(&grip(at), true).expect("a way");
            let end = Vector3::from(at) + Vector3::from(out);
            assert!(end.z > -0.03, "{at:?} to {end:?}");
            assert_eq!(ways.from(&grip(end.into()), false), Some([0.0; 3]));
        }
        assert_eq!(ways.from(&grip([0.0, 0.0, -0.1]), false), Some([0.0; 3]));
    }

    proptest! {
        /// From anywhere in the slab every shape is clear of it afterwards.
        #[test]
        fn afterwards_the_tool_is_clear(
            x in -0.035..0.035_f64,
            y in -0.035..0.035_f64,
            z in -0.03..0.0_f64,
            shape in 0..3_usize,
        ) {
            let tools = [
                "radius_m = 0.008",
                "shape = \"capsule\"\nradius_m = 0.006\nlength_m = 0.02",
                "shape = \"rounded-box\"\nsize_m = [0.012, 0.01, 0.02]\nfillet_m = 0.002",
            ];
            let scene = slab(tools[shape]);
            let ways = WayOut::of(&scene, scene.mesh.points_m()).expect("a tool");
            let from = [x, y, z];
            let out = ways.from(&grip(from), false).expect("a way");
            let at = [0, 1, 2].map(|axis: usize| from[axis] + out[axis]);
            prop_assert_eq!(ways.from(&grip(at), false), Some([0.0; 3]));
        }
    }
}
