//! Shortest ways out of the tissue for a tool that has slipped into it.
//!
//! Entry point: [`WayOut::from`]. Allocates: for people at a page, not for the loop.

use crate::contact::entry::{Nearest, way_in};
use crate::contact::shape::Solid;
use crate::mesh::Surface;
use crate::scene::{Pose, Scene};
use crate::script::at_rest;
use crate::tool::Tool;
use nalgebra::Vector3;

/// Clearance beyond the first place that is free, over the tool's radius: tissue that moves does not touch it at once.
const CLEARANCE: f64 = 0.2;

/// The tissue at rest, and the tool that the console's grip carries.
#[derive(Clone, Debug)]
pub struct WayOut {
    surface: Surface,
    /// Nodes \[m\], (n x 3).
    points_m: Vec<[f64; 3]>,
    /// Boundary nodes that are not held, with their outward normals.
    free: Vec<(u32, Vector3<f64>)>,
    tool: Tool,
}

impl WayOut {
    /// Builds it for a scene whose nodes rest at `points_m` (n x 3); none if the console's grip carries nothing that touches.
    pub fn of(scene: &Scene, points_m: &[[f64; 3]]) -> Option<Self> {
        let tool = scene.driven()?.shape.clone();
        if tool.is_grip() || points_m.len() != scene.mesh.points_m().len() {
            return None;
        }
        let surface = scene.mesh.surface();
        let vertices = surface.vertices.iter().zip(&surface.normals);
        // No way leads out through what stands on a table.
        let free: Vec<_> = vertices
            .filter(|(node, _)| scene.fixed.binary_search(node).is_err())
            .map(|(node, normal)| (*node, Vector3::from(*normal)))
            .collect();
        Some(Self {
            surface,
            points_m: points_m.to_vec(),
            free,
            tool,
        })
    }

    /// Displacement of the grip \[m\] after which its tool is clear of the tissue at rest, along the normal of the nearest vertex
    /// that is not held. Zero for a tool that is clear already; `None` for no pose, or where no way is found.
    pub fn from(&self, grip: &Pose) -> Option<[f64; 3]> {
        let placement = self.tool.place(&at_rest(0, grip))?;
        let solid = Solid::new(&self.tool, self.surface.mean_edge_m, &placement);
        let nearest = |solid: &Solid| {
            let gap_m = |node: u32| solid.gap(&self.points_m[node as usize].into());
            let gaps = self
                .free
                .iter()
                .map(|(node, normal)| (gap_m(*node), node, normal));
            let (gap_m, node, normal) = gaps.min_by(|a, b| a.0.total_cmp(&b.0))?;
            Some(Nearest {
                at: self.points_m[*node as usize].into(),
                normal: *normal,
                gap_m,
            })
        };
        let is_inside =
            |point: &Vector3<f64>| self.surface.contains(&self.points_m, (*point).into());
        let out = way_in(&solid, nearest, is_inside)?;
        let clearance_m = CLEARANCE * solid.radius();
        let longer = out.try_normalize(0.0).map(|along| along * clearance_m);
        Some((out + longer.unwrap_or_default()).into())
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
            let out = ways.from(&grip([0.0, 0.0, -depth_m])).expect("a way");
            assert!(out[0].abs() < 1e-12 && out[1].abs() < 1e-12, "{out:?}");
            assert!((out[2] - (depth_m + 1.2 * 0.014)).abs() < 1e-9, "{out:?}");
        }
        assert_eq!(ways.from(&grip([0.0, 0.0, 0.02])), Some([0.0; 3]));
        let beside = slab("shape = \"grip\"");
        assert!(WayOut::of(&beside, beside.mesh.points_m()).is_none());
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
            let out = ways.from(&grip(from)).expect("a way");
            let at = [0, 1, 2].map(|axis: usize| from[axis] + out[axis]);
            prop_assert_eq!(ways.from(&grip(at)), Some([0.0; 3]));
        }
    }
}
