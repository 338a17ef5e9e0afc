//! What a page is told of a scene's tools, needles and threads before it draws them.
//!
//! Entry points: [`describe_tools`], [`describe_needles`], [`describe_threads`].

use crate::needle::NeedleShape;
use crate::output::centre_line;
use crate::scene::Scene;
use crate::step::Status;
use crate::tool::Shape;
use nalgebra::Isometry3;
use serde_json::{Value, json};

/// Words of a step's end, in the order of their numbers.
pub fn statuses() -> [&'static str; 8] {
    [
        Status::Ok,
        Status::NotFinite,
        Status::UnknownTool,
        Status::Waiting,
        Status::Behind,
        Status::NotConverged,
        Status::TooManyRows,
        Status::Inside,
    ]
    .map(Status::name)
}

/// Tools: their shapes, and how these are fixed to their grips.
pub fn describe_tools(scene: &Scene) -> Value {
    let each = scene.tools.iter().map(|tool| {
        let shape = &tool.seen();
        let (mut length_m, mut fillet_m, mut size_m, mut mesh_of) = (None, None, None, None);
        let word = match &shape.shape {
            Shape::Sphere { .. } => "sphere",
            Shape::Capsule {
                length_m: length, ..
            } => {
                length_m = Some(*length);
                "capsule"
            }
            Shape::FlatPunch {
                fillet_m: fillet,
                length_m: length,
                ..
            } => {
                (length_m, fillet_m) = (Some(*length), Some(*fillet));
                "punch"
            }
            Shape::RoundedBox {
                size_m: size,
                fillet_m: fillet,
            } => {
                (size_m, fillet_m) = (Some(*size), Some(*fillet));
                "box"
            }
            Shape::Mesh {
                mesh,
                fillet_m: fillet,
            } => {
                (mesh_of, fillet_m) = (Some(mesh), Some(*fillet));
                "mesh"
            }
            Shape::Grip => "grip",
        };
        let points_m = mesh_of.map(|mesh| {
            let points = mesh.points_m().iter();
            points.map(|at| [at.x, at.y, at.z]).collect::<Vec<_>>()
        });
        json!({
            "id": tool.id,
            "driven": tool.driven,
            "shape": word,
            "radius_m": shape.radius_m(),
            "length_m": length_m,
            "fillet_m": fillet_m,
            "size_m": size_m,
            "offset_m": shape.offset_m,
            "axis": shape.axis,
            // Their frame is made of both: what is round and lies along its side would be flat.
            "side": <[f64; 3]>::from(shape.side_across()),
            "points_m": points_m,
            "triangles": mesh_of.map(|mesh| mesh.triangles().to_vec()),
        })
    });
    each.collect()
}

/// Needles: their shapes, and their centre lines in their own frames.
pub fn describe_needles(scene: &Scene) -> Value {
    let each = scene.needles.iter().map(|needle| {
        let (word, radius_m, angle_rad) = match needle.needle.shape {
            NeedleShape::Straight { .. } => ("straight", None, None),
            NeedleShape::Arc {
                radius_m,
                angle_rad,
            } => ("arc", Some(radius_m), Some(angle_rad)),
            NeedleShape::Segments(_) => ("segments", None, None),
        };
        json!({
            "id": needle.id,
            "shape": word,
            "length_m": needle.needle.shape.length_m(),
            "radius_m": radius_m,
            "angle_rad": angle_rad,
            "thickness_m": needle.needle.thickness_m,
            "points_m": centre_line(&needle.needle, &Isometry3::identity()),
        })
    });
    each.collect()
}

/// Threads.
pub fn describe_threads(scene: &Scene) -> Value {
    let each = scene.threads.iter().map(|thread| {
        json!({
            "id": thread.part.id,
            "needle": thread.part.needle,
            "radius_m": thread.part.radius_m(),
            "length_m": thread.part.length_m,
        })
    });
    each.collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{self, Document};
    use std::path::Path;

    /// A page turns a tool by its axis and its side, so that these have to be across each other, of a body along x, too.
    #[test]
    fn sides_of_bodies_are_across_their_axes() {
        let head = "[mesh.slab]\nsize_m = [0.04, 0.04, 0.01]\ndivisions = [2, 2, 1]\n[tissue]\nyoungs_modulus_pa = 3e4\n\
                    poisson_ratio = 0.4\n[[fixed]]\nplane = { axis = \"z\", at_m = -0.01 }\n[[tool]]\nshape = \"grip\"\n\
                    position_m = [0.0, 0.0, 0.1]\nbody = { radius_m = 0.002, length_m = 0.06, axis = ";
        for axis in ["[1.0, 0.0, 0.0]", "[0.6, 0.0, -0.8]", "[0.0, 1.0, 0.0]"] {
            let text = format!("{head}{axis} }}\n");
            let document = Document::embedded("bodies.toml", Path::new("/nowhere"), &text);
            let tools = describe_tools(&scene::read(&document).expect("a scene"));
            let direction =
                |key: &str| [0, 1, 2].map(|at| tools[0][key][at].as_f64().expect("a number"));
            let [along, side] = ["axis", "side"].map(|key| nalgebra::Vector3::from(direction(key)));
            assert!(
                along.dot(&side).abs() < 1e-12 && (side.norm() - 1.0).abs() < 1e-12,
                "{axis}: {side}"
            );
        }
    }
}
