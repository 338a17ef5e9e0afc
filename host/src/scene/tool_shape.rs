//! What a `[[tool]]` touches with: which keys a shape has, and what they may say.
//!
//! Entry point: [`read_shape`].

use super::document::{Document, SceneError};
use crate::mesh::{MOST_BYTES, SurfaceFlaw, SurfaceFormat};
use crate::tool::{self, ClosedMesh, Shape, Tool};
use nalgebra::Vector3;
use std::ops::Range;
use sutura_scene_file::scene::{ToolSection, ToolShape};
use toml::Spanned;

/// Bars so much longer than wide end far from the tissue.
const LENGTH_IN_RADII: f64 = 4.0;

/// Shapes that touch, as a scene and as a sentence calls them, and their keys; all have an offset and friction.
const SHAPES: [(ToolShape, &str, &str, &[&str]); 5] = [
    (ToolShape::Sphere, "sphere", "a sphere", &["radius_m"]),
    (
        ToolShape::FlatPunch,
        "flat-punch",
        "a flat punch",
        &["radius_m", "fillet_m", "length_m", "axis"],
    ),
    (
        ToolShape::Capsule,
        "capsule",
        "a capsule",
        &["radius_m", "length_m", "axis"],
    ),
    (
        ToolShape::RoundedBox,
        "rounded-box",
        "a rounded box",
        &["size_m", "fillet_m", "axis", "side"],
    ),
    (
        ToolShape::Mesh,
        "mesh",
        "a mesh",
        &["mesh", "scale_to_m", "fillet_m", "axis", "side"],
    ),
];

/// The shape on its grip, without friction.
///
/// # Errors
/// A flaw at a key that the shape does not have, at one that it needs, at a length, or at a direction without length.
pub(super) fn read_shape(
    document: &Document,
    spanned: &Spanned<ToolSection>,
) -> Result<Tool, SceneError> {
    let section = spanned.get_ref();
    refuse_others(document, section)?;
    let offset_m = match &section.offset_m {
        Some(offset) => document.finite("offset_m", offset)?,
        None => [0.0; 3],
    };
    let shape = match section.shape {
        ToolShape::Grip => return Ok(Tool::new(Shape::Grip, offset_m)),
        ToolShape::Sphere => Shape::Sphere {
            radius_m: read_radius(document, spanned)?,
        },
        ToolShape::FlatPunch => read_punch(document, spanned)?,
        ToolShape::Capsule => read_capsule(document, spanned)?,
        ToolShape::RoundedBox => read_box(document, spanned)?,
        ToolShape::Mesh => read_mesh(document, spanned)?,
    };
    let axis = read_axis(document, section)?;
    let side = match section.shape {
        ToolShape::RoundedBox | ToolShape::Mesh => read_side(document, section, &axis)?,
        _ => Vector3::from(Tool::DEFAULT_SIDE),
    };
    Ok(Tool {
        axis: axis.into(),
        side: side.into(),
        ..Tool::new(shape, offset_m)
    })
}

/// Keys that say something of a shape, with where they stand.
fn said(section: &ToolSection) -> impl Iterator<Item = (&'static str, Range<usize>)> {
    let length = |key: &Option<Spanned<f64>>| key.as_ref().map(Spanned::span);
    let vector = |key: &Option<Spanned<[f64; 3]>>| key.as_ref().map(Spanned::span);
    let keys = [
        ("radius_m", length(&section.radius_m)),
        ("size_m", vector(&section.size_m)),
        ("mesh", section.mesh.as_ref().map(Spanned::span)),
        ("scale_to_m", length(&section.scale_to_m)),
        ("fillet_m", length(&section.fillet_m)),
        ("length_m", length(&section.length_m)),
        ("axis", vector(&section.axis)),
        ("side", vector(&section.side)),
        ("offset_m", vector(&section.offset_m)),
        ("friction", length(&section.friction)),
        ("static_friction", length(&section.static_friction)),
    ];
    keys.into_iter()
        .filter_map(|(key, span)| Some((key, span?)))
}

/// Keys that all shapes have that touch.
fn is_common(key: &str) -> bool {
    ["offset_m", "friction", "static_friction"].contains(&key)
}

/// A flaw at the first key that the shape does not have.
fn refuse_others(document: &Document, section: &ToolSection) -> Result<(), SceneError> {
    let own = SHAPES.iter().find(|shape| shape.0 == section.shape);
    let has = |key: &str| own.is_some_and(|shape| is_common(key) || shape.3.contains(&key));
    let Some((key, span)) = said(section).find(|(key, _)| !has(key)) else {
        return Ok(());
    };
    let others = SHAPES
        .iter()
        .filter(|shape| is_common(key) || shape.3.contains(&key));
    let others: Vec<String> = others
        .map(|shape| format!("`shape = \"{}\"`", shape.1))
        .collect();
    let help = format!(
        "leave this key out, or add a shape that has it: {}",
        others.join(", ")
    );
    let (message, label) = match own {
        Some(shape) => (
            format!("{} has no `{key}`", shape.2),
            format!("the shape is {}", shape.2),
        ),
        None => (
            format!("a grip touches nothing but with a `body`: it has no `{key}`"),
            "the shape is a grip".to_owned(),
        ),
    };
    Err(document.flaw(span, message, label, Some(&help)))
}

/// A key that the shape cannot do without.
fn missing(document: &Document, spanned: &Spanned<ToolSection>, key: &str) -> SceneError {
    let message = format!("missing key `{key}`");
    let help = format!(
        "add `{key} = ...`; only a `shape = \"grip\"`, which holds a needle, touches with nothing"
    );
    document.flaw(spanned.span(), message, "needed here", Some(&help))
}

fn read_radius(document: &Document, spanned: &Spanned<ToolSection>) -> Result<f64, SceneError> {
    let section = spanned.get_ref();
    let radius = section.radius_m.as_ref();
    let radius = radius.ok_or_else(|| missing(document, spanned, "radius_m"))?;
    let (rule, least): (_, fn(f64) -> bool) = if section.shape == ToolShape::Sphere {
        ("zero or positive", |r| r >= 0.0)
    } else {
        ("positive", |r| r > 0.0)
    };
    let help = "the radius of the sphere or the bar that touches the tissue, in metres; a sphere of 0 is a bare point";
    document.number("radius_m", radius, rule, least, help)
}

fn read_punch(document: &Document, spanned: &Spanned<ToolSection>) -> Result<Shape, SceneError> {
    let section = spanned.get_ref();
    let radius_m = read_radius(document, spanned)?;
    let fillet_m = match &section.fillet_m {
        Some(fillet) => document.number(
            "fillet_m",
            fillet,
            "more than 0 and at most the radius",
            |f| f > 0.0 && f <= radius_m,
            "the punch's rim is rounded by this: a sharp one would cut real tissue, and has no normal",
        )?,
        None => tool::DEFAULT_FILLET * radius_m,
    };
    let length_m = match &section.length_m {
        Some(length) => document.number(
            "length_m",
            length,
            "at least two fillets",
            |l| l >= 2.0 * fillet_m,
            "the length of the bar behind the face, with a rounded rim at both ends",
        )?,
        None => LENGTH_IN_RADII * radius_m,
    };
    Ok(Shape::FlatPunch {
        radius_m,
        fillet_m,
        length_m,
    })
}

fn read_capsule(document: &Document, spanned: &Spanned<ToolSection>) -> Result<Shape, SceneError> {
    let radius_m = read_radius(document, spanned)?;
    let length_m = match &spanned.get_ref().length_m {
        Some(length) => document.number(
            "length_m",
            length,
            "zero or positive",
            |l| l >= 0.0,
            "the length of the straight part, from centre to centre of the round ends; with 0 it is a sphere",
        )?,
        None => LENGTH_IN_RADII * radius_m,
    };
    Ok(Shape::Capsule { radius_m, length_m })
}

fn read_box(document: &Document, spanned: &Spanned<ToolSection>) -> Result<Shape, SceneError> {
    let section = spanned.get_ref();
    let size = section.size_m.as_ref();
    let size = size.ok_or_else(|| missing(document, spanned, "size_m"))?;
    let size_m = document.finite("size_m", size)?;
    if let Some(wrong) = size_m.iter().find(|size| **size <= 0.0) {
        let message = format!("size_m: a box that is {wrong} m wide");
        let help = "from face to face along `side`, across both, and along `axis`; for a box that looks down along x, y and z";
        return Err(document.flaw(size.span(), message, "must be positive", Some(help)));
    }
    let unsaid = Shape::rounded_box(size_m);
    let Some(fillet) = &section.fillet_m else {
        return Ok(unsaid);
    };
    let fillet_m = document.number(
        "fillet_m",
        fillet,
        "more than 0 and at most half of each size",
        |f| f > 0.0 && f <= unsaid.radius_m(),
        "the box's edges and corners are rounded by this: sharp ones would cut real tissue, and have no normal",
    )?;
    Ok(Shape::RoundedBox { size_m, fillet_m })
}

fn read_mesh(document: &Document, spanned: &Spanned<ToolSection>) -> Result<Shape, SceneError> {
    let section = spanned.get_ref();
    let file = section.mesh.as_ref();
    let file = file.ok_or_else(|| missing(document, spanned, "mesh"))?;
    let scale = section.scale_to_m.as_ref();
    let scale = scale.ok_or_else(|| missing(document, spanned, "scale_to_m"))?;
    let help = "metres per unit of the mesh file: 0.001 for a mesh in millimetres";
    let scale_to_m = document.number("scale_to_m", scale, "positive", |s| s > 0.0, help)?;
    let path = document.resolve(file.get_ref());
    let bytes = document.file(&path, MOST_BYTES).map_err(|error| {
        let message = format!("cannot read the mesh {}: {error}", path.display());
        let help = "the path is relative to the scene file";
        document.flaw(file.span(), message, "this file", Some(help))
    })?;
    let format = SurfaceFormat::of(&path).map_err(SurfaceFlaw::from);
    let mesh = format.and_then(|format| ClosedMesh::read(format, &bytes, scale_to_m));
    let mesh = mesh.map_err(|flaw| {
        let message = format!("the mesh {} cannot be used: {flaw}", path.display());
        let help = "a tool's mesh is a .stl, .obj or .ply of one closed surface, faces counted from 0; a modeller's check for 3D printing finds and closes holes";
        document.flaw(file.span(), message, "this file", Some(help))
    })?;
    let shape = Shape::mesh(mesh);
    let (Shape::Mesh { mesh, .. }, Some(fillet)) = (&shape, &section.fillet_m) else {
        return Ok(shape);
    };
    let fillet_m = document.number(
        "fillet_m",
        fillet,
        "positive",
        |f| f > 0.0,
        "the mesh is larger by this all around, which makes its edges round: sharp ones have no normal",
    )?;
    Ok(Shape::Mesh {
        mesh: mesh.clone(),
        fillet_m,
    })
}

/// Returns the unit vector along a vector, however long; none along one without length.
pub(super) fn unit_vector(vector: Vector3<f64>) -> Option<Vector3<f64>> {
    match vector.norm().is_finite() {
        true => vector.try_normalize(1e-12),
        false => (vector / vector.amax()).try_normalize(1e-12),
    }
}

/// Where the front looks, unit vector.
fn read_axis(document: &Document, section: &ToolSection) -> Result<Vector3<f64>, SceneError> {
    let Some(axis) = &section.axis else {
        return Ok(Tool::DEFAULT_AXIS.into());
    };
    let vector = Vector3::from(document.finite("axis", axis)?);
    unit_vector(vector).ok_or_else(|| {
        let message = "axis: a direction without length";
        let help = "where the front looks in the grip's frame: down is [0.0, 0.0, -1.0]";
        document.flaw(axis.span(), message, "no direction", Some(help))
    })
}

/// Where a box's side looks, unit vector across its axis: what of the key lies across it.
fn read_side(
    document: &Document,
    section: &ToolSection,
    axis: &Vector3<f64>,
) -> Result<Vector3<f64>, SceneError> {
    let side = match &section.side {
        Some(side) => Vector3::from(document.finite("side", side)?),
        None => Tool::DEFAULT_SIDE.into(),
    };
    let across = |unit: Vector3<f64>| (unit - axis * axis.dot(&unit)).try_normalize(1e-6);
    unit_vector(side).and_then(across).ok_or_else(|| {
        let key = section.side.as_ref().or(section.axis.as_ref());
        let (message, label) = if section.side.is_some() {
            ("side: no direction across the axis", "nothing of it lies across the axis")
        } else {
            ("what looks along x needs a side", "nothing says how it is turned about this")
        };
        let help = "where the first of `size_m` is measured in the grip's frame, across `axis`: add `side = [0.0, 1.0, 0.0]`, or another";
        document.flaw(key.map_or(0..0, Spanned::span), message, label, Some(help))
    })
}
