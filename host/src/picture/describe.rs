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
            "side": shape.side,
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
