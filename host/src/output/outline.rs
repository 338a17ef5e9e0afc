//! Lines that show a tool's shape.
//!
//! Entry point: [`outline`].

use crate::tool::{Shape, Tool};
use nalgebra::Vector3;
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Pieces of half a circle.
const HALF: u32 = 16;

/// Lines on what a tool touches with, in the frame of the grip, from the tool's offset \[m\]; and how far the shape reaches
/// around them \[m\].
pub(super) fn outline(tool: &Tool) -> (f64, Vec<Vec<Vector3<f64>>>) {
    let axis = Vector3::from(tool.axis);
    let side = tool.side_across();
    let up = side.cross(&axis);
    // `rho` across the axis, `z` along it.
    let turned = |profile: &[(f64, f64)], rings: &[usize]| {
        let meridian = |way: Vector3<f64>| {
            let point = |(rho, z): &(f64, f64)| way * *rho + axis * *z;
            let back = profile
                .iter()
                .rev()
                .map(|(rho, z)| point(&(-rho, *z)))
                .chain(profile.first().map(point));
            profile.iter().map(point).chain(back).collect::<Vec<_>>()
        };
        let ring = |place: &usize| {
            let (rho, z) = profile[*place];
            let angles = (0..=2 * HALF).map(|k| PI * f64::from(k) / f64::from(HALF));
            angles
                .map(|angle| (side * angle.cos() + up * angle.sin()) * rho + axis * z)
                .collect()
        };
        let mut lines = vec![meridian(side), meridian(up)];
        lines.extend(rings.iter().map(ring));
        lines
    };
    match &tool.shape {
        Shape::Grip => (0.0, Vec::new()),
        Shape::Sphere { radius_m } => {
            let profile: Vec<_> = arc([0.0, 0.0], *radius_m, [0.0, PI]).collect();
            (0.0, turned(&profile, &[HALF as usize / 2]))
        }
        Shape::Capsule { radius_m, length_m } => {
            let front = arc([0.0, 0.0], *radius_m, [0.0, FRAC_PI_2]);
            let back = arc([0.0, -length_m], *radius_m, [FRAC_PI_2, PI]);
            let profile: Vec<_> = front.chain(back).collect();
            let waist = HALF as usize / 2;
            (0.0, turned(&profile, &[waist, waist + 1]))
        }
        Shape::FlatPunch {
            radius_m,
            fillet_m,
            length_m,
        } => {
            let flat = radius_m - fillet_m;
            let front = arc([flat, -fillet_m], *fillet_m, [0.0, FRAC_PI_2]);
            let back = arc([flat, fillet_m - length_m], *fillet_m, [FRAC_PI_2, PI]);
            let profile: Vec<_> = std::iter::once((0.0, 0.0))
                .chain(front)
                .chain(back)
                .chain([(0.0, -length_m)])
                .collect();
            let quarter = HALF as usize / 2;
            let rings = [1, quarter + 1, quarter + 2, 2 * quarter + 2];
            (0.0, turned(&profile, &rings))
        }
        Shape::RoundedBox { size_m, fillet_m } => {
            let middle = axis * (-0.5 * size_m[2]);
            let ways = [side, up, axis];
            let faces = (0..3).flat_map(|k| [1.0, -1.0].map(|sign| (k, sign)));
            let face = |(k, sign): (usize, f64)| {
                let flat = |k: usize| ways[k] * (0.5 * size_m[k] - fillet_m);
                let centre = middle + ways[k] * (sign * 0.5 * size_m[k]);
                let (u, v) = (flat((k + 1) % 3), flat((k + 2) % 3));
                let corners = [
                    (1.0, 1.0),
                    (-1.0, 1.0),
                    (-1.0, -1.0),
                    (1.0, -1.0),
                    (1.0, 1.0),
                ];
                corners.map(|(a, b)| centre + u * a + v * b).to_vec()
            };
            (0.0, faces.map(face).collect())
        }
        Shape::Mesh { mesh, fillet_m } => {
            let at = |node: u32| {
                let p = mesh.points_m()[node as usize];
                side * p.x + axis.cross(&side) * -p.y - axis * p.z
            };
            let edges = mesh
                .triangles()
                .iter()
                .flat_map(|[a, b, c]| [[*a, *b], [*b, *c], [*c, *a]]);
            // Each edge runs both ways.
            let once = edges.filter(|[a, b]| a < b);
            (*fillet_m, once.map(|ends| ends.map(at).to_vec()).collect())
        }
    }
}

/// A part of a circle about (rho, z) \[m\], from front to back: at 0 it is before its centre, at pi behind it.
fn arc([rho, z]: [f64; 2], radius: f64, [from, to]: [f64; 2]) -> impl Iterator<Item = (f64, f64)> {
    let pieces = (f64::from(2 * HALF) * (to - from) / TAU).round() as u32;
    (0..=pieces).map(move |k| {
        let angle = from + (to - from) * f64::from(k) / f64::from(pieces);
        (rho + radius * angle.sin(), z + radius * angle.cos())
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::contact::shape::Solid;
    use crate::tool::{ClosedMesh, Placement};
    use nalgebra::UnitQuaternion;

    /// Every point of an outline is where the distance that contact uses is zero; edges of a swept mesh are its radius inside.
    #[test]
    fn outlines_lie_on_what_touches() {
        let tetrahedron = ClosedMesh::new(
            &[
                [0.0, 0.0, 0.0],
                [8e-3, 0.0, 0.0],
                [0.0, 9e-3, 0.0],
                [0.0, 0.0, 7e-3],
            ],
            &[[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]],
        );
        let shapes = [
            Shape::Sphere { radius_m: 3e-3 },
            Shape::Capsule {
                radius_m: 2e-3,
                length_m: 9e-3,
            },
            Shape::FlatPunch {
                radius_m: 5e-3,
                fillet_m: 0.7e-3,
                length_m: 12e-3,
            },
            Shape::RoundedBox {
                size_m: [4e-3, 6e-3, 9e-3],
                fillet_m: 0.5e-3,
            },
            Shape::Mesh {
                mesh: tetrahedron.expect("closed").into(),
                fillet_m: 0.4e-3,
            },
        ];
        let axis = Vector3::new(0.36, -0.48, -0.8);
        let side = axis.cross(&Vector3::y()).normalize();
        for shape in shapes {
            let mut tool = Tool::new(shape, [0.0; 3]);
            (tool.axis, tool.side) = (axis.into(), side.into());
            let placement = Placement {
                centre: Vector3::new(0.01, -0.02, 0.03),
                rotation: UnitQuaternion::from_euler_angles(0.3, -0.7, 1.9),
            };
            let solid = Solid::new(&tool, 0.0, &placement);
            let (radius_m, lines) = outline(&tool);
            assert!(lines.len() > 2 && lines.iter().all(|line| line.len() > 1));
            for local in lines.iter().flatten() {
                let at = placement.centre + placement.rotation * local;
                let gap_m = solid.gap(&at);
                let what = &tool.shape;
                assert!(
                    (gap_m + radius_m).abs() < 1e-9,
                    "{what:?}: {gap_m} m at {local}"
                );
            }
        }
        assert!(outline(&Tool::new(Shape::Grip, [0.0; 3])).1.is_empty());
    }
}
