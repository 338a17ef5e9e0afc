//! `[[tool]]`: shapes on grips, which of them the console drives, and where the others are held or go.
//!
//! Entry point: [`read_tools`].

use super::document::{Document, Flaw, SceneError};
use super::tool_shape::read_shape;
use super::way::{self, read_way};
use super::{Pose, Tool};
use crate::mesh::TetMesh;
use crate::model::{ACCURATE_RADIUS_IN_EDGES, LEAST_RADIUS_IN_EDGES, measured_error_percent};
use crate::rod::Bar;
use crate::tool;
use miette::Severity;
use nalgebra::Vector3;
use std::ops::Range;
use sutura_scene_file::scene::{ToolSection, ToolShape};
use toml::Spanned;

/// From how far a grip takes what it is to hold, if it does not say \[m\]: jaws of needle holders are 5 to 10 mm long.
const REACH_M: f64 = 0.005;

/// The tools of a scene, with different ids, one of them driven.
///
/// # Errors
/// A flaw at what is wrong: a length, an id that is there already, a pose that is none, two driven tools.
pub(super) fn read_tools(
    document: &Document,
    sections: &[Spanned<ToolSection>],
    mesh: &TetMesh,
    (warnings, notes): (&mut Vec<Flaw>, &mut Vec<Flaw>),
) -> Result<Vec<Tool>, SceneError> {
    let edge_m = mesh.surface().mean_edge_m;
    let driven = driven_tool(document, sections)?;
    let mut tools: Vec<Tool> = Vec::with_capacity(sections.len());
    for (place, spanned) in sections.iter().enumerate() {
        let section = spanned.get_ref();
        let at = way::place(spanned);
        let is_grip = section.shape == ToolShape::Grip;
        let shape = read_touching(document, spanned)?;
        let radius_m = shape.radius_m();
        if !is_grip && radius_m < ACCURATE_RADIUS_IN_EDGES * edge_m {
            let (severity, list) = if radius_m < LEAST_RADIUS_IN_EDGES * edge_m {
                (Severity::Warning, &mut *warnings)
            } else {
                (Severity::Advice, &mut *notes)
            };
            list.push(small_tool(document, severity, at.clone(), radius_m, edge_m));
        }
        let id = section.id.as_ref().map_or(place as u8, |id| *id.get_ref());
        if tools.iter().any(|other| other.id == id) {
            let span = section
                .id
                .as_ref()
                .map_or_else(|| at.clone(), |id| id.span());
            let help = "give every tool an `id` of its own, 0 to 255";
            let message = format!("two tools have the id {id}");
            return Err(document.flaw(span, message, "the second", Some(help)));
        }
        let driven = driven == place;
        let way = read_way(document, section, driven)?;
        let mut pose = read_pose(document, section)?;
        if let Some(begin) = way.as_ref().map(|way| way.at(0.0)) {
            let position_m = begin.moved.map(|(at, _)| at);
            let position_m = position_m.or(pose.map(|pose| pose.position_m));
            pose = position_m.map(|position_m| Pose {
                position_m,
                orientation: begin.orientation,
            });
        }
        if !driven && pose.is_none() {
            let message = format!("tool {id} is neither driven by the console nor held");
            let help = "add `position_m` where it is to be held, or leave the tool out";
            warnings.push(document.warning(at, &message, "touches nothing", help));
        }
        tools.push(Tool {
            id,
            shape,
            driven,
            pose,
            way,
            reach_m: read_reach(document, section)?,
            body: read_body(document, section)?,
        });
    }
    Ok(tools)
}

/// From how far a grip takes what it is to hold \[m\].
fn read_reach(document: &Document, section: &ToolSection) -> Result<f64, SceneError> {
    let Some(reach) = &section.reach_m else {
        return Ok(REACH_M);
    };
    if section.shape != ToolShape::Grip {
        let message = "a reach of a tool that is no grip";
        let help = "leave `reach_m` out, or make it `shape = \"grip\"`: only grips hold needles and threads";
        return Err(document.flaw(reach.span(), message, "holds nothing", Some(help)));
    }
    let help = "from the grip to the needle or thread, in metres: jaws have 0.003 to 0.02";
    document.number("reach_m", reach, "positive", |v| v > 0.0, help)
}

/// What of a grip touches the tissue.
fn read_body(document: &Document, section: &ToolSection) -> Result<Option<Bar>, SceneError> {
    let Some(spanned) = &section.body else {
        return Ok(None);
    };
    if section.shape != ToolShape::Grip {
        let message = "a body of a tool that has a shape";
        let help =
            "leave `body` out, or make it `shape = \"grip\"`: other tools touch with their shape";
        return Err(document.flaw(spanned.span(), message, "touches already", Some(help)));
    }
    let said = spanned.get_ref();
    let positive = |value: f64| value > 0.0;
    let help =
        "the bar that touches the tissue, in metres: needle holders are 0.002 to 0.004 in radius";
    let radius_m = document.number("radius_m", &said.radius_m, "positive", positive, help)?;
    let help = "from centre to centre of the round ends, in metres";
    let length_m = document.number("length_m", &said.length_m, "positive", positive, help)?;
    let axis = match &said.axis {
        Some(axis) => {
            let vector = Vector3::from(document.finite("axis", axis)?);
            vector.try_normalize(1e-12).ok_or_else(|| {
                let message = "axis: a direction without length";
                let help = "where the front looks in the grip's frame: down is [0.0, 0.0, -1.0]";
                document.flaw(axis.span(), message, "no direction", Some(help))
            })?
        }
        None => tool::Tool::DEFAULT_AXIS.into(),
    };
    let offset_m = match &said.offset_m {
        Some(offset) => document.finite("offset_m", offset)?,
        None => [0.0; 3],
    };
    let friction = match &said.friction {
        Some(friction) => {
            let rule = format!("between 0 and {}", tool::MOST_FRICTION);
            let is_sound = |value| (0.0..=tool::MOST_FRICTION).contains(&value);
            let help = "Coulomb's coefficient on tissue: wet metal has 0.1";
            document.number("friction", friction, &rule, is_sound, help)?
        }
        None => 0.0,
    };
    Ok(Some(Bar {
        offset_m,
        axis: axis.into(),
        radius_m,
        length_m,
        friction,
    }))
}

/// The shape, and how it rubs.
fn read_touching(
    document: &Document,
    spanned: &Spanned<ToolSection>,
) -> Result<tool::Tool, SceneError> {
    let tool = read_shape(document, spanned)?;
    let section = spanned.get_ref();
    let help = "Coulomb's coefficient on tissue: wet metal has 0.1, dry rubber 1";
    let read = |name, key: &Option<Spanned<f64>>, rule: &str, least: f64| match key {
        None => Ok(least),
        Some(key) => {
            let is_sound = |value| (least..=tool::MOST_FRICTION).contains(&value);
            document.number(name, key, rule, is_sound, help)
        }
    };
    let rule = format!("between 0 and {}", tool::MOST_FRICTION);
    let friction = read("friction", &section.friction, &rule, 0.0)?;
    let rule = format!("between `friction` and {}", tool::MOST_FRICTION);
    let static_friction = read("static_friction", &section.static_friction, &rule, friction)?;
    Ok(tool.with_friction(friction, static_friction))
}

/// Place in the list of the tool that the console's grip carries.
fn driven_tool(
    document: &Document,
    sections: &[Spanned<ToolSection>],
) -> Result<usize, SceneError> {
    let key = |section: &Spanned<ToolSection>| section.get_ref().driven.clone();
    let said = |section: &Spanned<ToolSection>| key(section).map(Spanned::into_inner);
    let is_driven = |section: &&Spanned<ToolSection>| said(section) == Some(true);
    if let Some(second) = sections.iter().filter(is_driven).nth(1) {
        let message = "two tools are driven, but the console has one grip";
        let help = "let one tool be driven, and hold the others at their `position_m`";
        let span = key(second).map_or(0..0, |driven| driven.span());
        return Err(document.flaw(span, message, "the second", Some(help)));
    }
    let driven = sections
        .iter()
        .position(|section| said(section) == Some(true))
        .or_else(|| sections.iter().position(|section| said(section).is_none()));
    match (driven, sections.first().and_then(key)) {
        (Some(place), _) => Ok(place),
        // Without tools there is nothing to drive.
        (None, None) => Ok(0),
        (None, Some(refused)) => {
            let message = "no tool is driven";
            let help = "leave `driven` out of the tool that the console's grip carries";
            Err(document.flaw(refused.span(), message, "nor is any other", Some(help)))
        }
    }
}

/// What was measured of tools that are small against the mesh: of interest below four edges, a warning below three.
fn small_tool(
    document: &Document,
    severity: Severity,
    at: Range<usize>,
    radius_m: f64,
    edge_m: f64,
) -> Flaw {
    let [error, largest] = measured_error_percent(radius_m / edge_m);
    let message = format!(
        "a tool of {:.1} mm radius on edges of {:.1} mm: a ball like that has a measured error of {error:.0} % in its force, {largest:.0} % where it is largest",
        radius_m * 1e3,
        edge_m * 1e3
    );
    let help = format!(
        "measured over the places of a cell against an independent value; with a radius of {:.4} m, four edges, or a finer mesh it is {:.0} %",
        ACCURATE_RADIUS_IN_EDGES * edge_m,
        measured_error_percent(ACCURATE_RADIUS_IN_EDGES)[0]
    );
    let label = format!("{:.1} edges", radius_m / edge_m);
    document.note(severity, at, message, label, Some(&help))
}

fn read_pose(document: &Document, section: &ToolSection) -> Result<Option<Pose>, SceneError> {
    let orientation = match &section.orientation {
        Some(value) => {
            let q = document.finite("orientation", value)?;
            let norm = q.iter().map(|v| v * v).sum::<f64>().sqrt();
            if (norm - 1.0).abs() > 1e-3 {
                let message = format!("orientation: a quaternion of length {norm:.4}");
                let help =
                    "a rotation is a unit quaternion (x, y, z, w); none is [0.0, 0.0, 0.0, 1.0]";
                return Err(document.flaw(value.span(), message, "must have length 1", Some(help)));
            }
            q.map(|v| v / norm)
        }
        None => [0.0, 0.0, 0.0, 1.0],
    };
    match (&section.position_m, &section.orientation) {
        (Some(position), _) => Ok(Some(Pose {
            position_m: document.finite("position_m", position)?,
            orientation,
        })),
        (None, Some(value)) => {
            let message = "an orientation without a position";
            let help = "both say where `sutura solve` holds the grip: add `position_m`";
            Err(document.flaw(value.span(), message, "no position_m", Some(help)))
        }
        (None, None) => Ok(None),
    }
}
