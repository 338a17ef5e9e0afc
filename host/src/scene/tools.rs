//! `[[tool]]`: shapes on grips, which of them the console drives, and where the others are held or go.
//!
//! Entry point: [`read_tools`].

use super::document::{Document, Flaw, SceneError};
use super::hand::position_at;
use super::tool_shape::{read_shape, unit_vector};
use super::way::{self, Way, read_way};
use super::{Pose, Tool};
use crate::contact::shape::Solid;
use crate::mesh::{Surface, TetMesh};
use crate::model::{
    ACCURATE_RADIUS_IN_EDGES, LEAST_MEASURED_IN_EDGES, LEAST_RADIUS_IN_EDGES,
    measured_error_percent,
};
use crate::rod::Bar;
use crate::script::at_rest;
use crate::tool::{self, Shape};
use miette::{Diagnostic, Severity};
use nalgebra::Vector3;
use std::ops::Range;
use sutura_scene_file::scene::{ToolSection, ToolShape};
use sutura_shared::wire::message::HandScript;
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
    (mesh, hand): (&TetMesh, Option<&HandScript>),
    (warnings, notes): (&mut Vec<Flaw>, &mut Vec<Flaw>),
) -> Result<Vec<Tool>, SceneError> {
    let surface = mesh.surface();
    let driven = driven_tool(document, sections)?;
    let mut tools: Vec<Tool> = Vec::with_capacity(sections.len());
    for (place, spanned) in sections.iter().enumerate() {
        let section = spanned.get_ref();
        let at = way::place(spanned);
        let is_grip = section.shape == ToolShape::Grip;
        let shape = read_touching(document, spanned)?;
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
        if !is_grip {
            let hand = hand.filter(|_| driven);
            let poses = poses(hand, way.as_ref(), pose.as_ref());
            let edges = Edges::near(&surface, mesh.points_m(), &shape, &poses);
            let small = small_tool(document, at.clone(), &shape.shape, &edges);
            let thin = thin_rim(document, at.clone(), &shape.shape, &edges);
            for flaw in small.into_iter().chain(thin) {
                let list = match flaw.severity() {
                    Some(Severity::Warning) => &mut *warnings,
                    _ => &mut *notes,
                };
                list.push(flaw);
            }
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
            unit_vector(vector).ok_or_else(|| {
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

/// Edges of the boundary that a tool meets \[m\].
struct Edges {
    /// Mean of those near its path.
    near_m: f64,
    /// Mean of all; a tool counts as no smaller than that.
    mean_m: f64,
}

/// Local edges that differ from the mean of all by less than this part are the same: the mesh is not graded.
const GRADED: f64 = 0.1;
/// Vertices within so many radii of a tool are near it.
const NEAR_RADII: f64 = 0.5;
/// Most poses of a path at which edges are looked for.
const MOST_POSES: u32 = 200;

impl Edges {
    /// Those near a tool in one of these poses; of a tool that is near none, those at the vertex nearest to it.
    fn near(surface: &Surface, points_m: &[[f64; 3]], shape: &tool::Tool, poses: &[Pose]) -> Self {
        let mean_m = surface.mean_edge_m;
        let placed = poses
            .iter()
            .filter_map(|pose| shape.place(&at_rest(0, pose)));
        let solids: Vec<Solid> = placed.map(|place| Solid::new(shape, 0.0, &place)).collect();
        let gap_m = |node: u32| {
            let at = Vector3::from(points_m[node as usize]);
            let gaps = solids.iter().map(|solid| solid.gap(&at));
            gaps.fold(f64::INFINITY, f64::min)
        };
        let gaps: Vec<f64> = surface.vertices.iter().map(|node| gap_m(*node)).collect();
        let nearest_m = gaps.iter().copied().fold(f64::INFINITY, f64::min);
        let most_m = nearest_m.max(NEAR_RADII * shape.radius_m());
        let is_near = |node: &u32| {
            let place = surface.vertices.binary_search(node);
            place.is_ok_and(|place| gaps[place] <= most_m)
        };
        let (mut sum_m, mut count) = (0.0, 0u32);
        for triangle in surface
            .triangles
            .iter()
            .filter(|all| all.iter().any(is_near))
        {
            let at = triangle.map(|node| Vector3::from(points_m[node as usize]));
            sum_m += (0..3)
                .map(|k| at[k].metric_distance(&at[(k + 1) % 3]))
                .sum::<f64>();
            count += 3;
        }
        let near_m = sum_m / f64::from(count);
        let is_graded = near_m.is_finite() && (near_m / mean_m - 1.0).abs() > GRADED;
        Self {
            near_m: if is_graded { near_m } else { mean_m },
            mean_m,
        }
    }
}

/// Positions that a scene gives a tool: along the hand's path or its script, or its held pose.
fn poses(hand: Option<&HandScript>, way: Option<&Way>, pose: Option<&Pose>) -> Vec<Pose> {
    let rest = pose.map_or([0.0, 0.0, 0.0, 1.0], |pose| pose.orientation);
    let used = hand.and_then(|hand| hand.way_points.get(..usize::from(hand.count)));
    let hand_s = used
        .and_then(|points| points.last())
        .map(|point| f64::from(point.time_s));
    let way_s = way
        .and_then(|way| way.stops().last())
        .map(|stop| stop.time_s);
    let Some(end_s) = hand_s.into_iter().chain(way_s).reduce(f64::max) else {
        return pose.copied().into_iter().collect();
    };
    let at = |look: u32| {
        let time_s = end_s * f64::from(look) / f64::from(MOST_POSES);
        let on_way = way.map(|way| way.at(time_s));
        let moved = on_way.and_then(|on_way| on_way.moved).map(|(at, _)| at);
        let carried = hand.map(|hand| position_at(hand, time_s));
        Some(Pose {
            position_m: moved.or(carried).or(pose.map(|pose| pose.position_m))?,
            orientation: on_way.map_or(rest, |on_way| on_way.orientation),
        })
    };
    // A hand's path may be left for where the scene holds the tool without one.
    (0..=MOST_POSES)
        .filter_map(at)
        .chain(pose.copied())
        .collect()
}

/// Returns how deep a hand presses a tool into tissue that does not give way \[m\]: as deep as its path goes, less what it gives
/// way itself under the device's largest force \[N\].
pub(super) fn depth_m(mesh: &TetMesh, tool: &Tool, (hand, most_n): (&HandScript, f64)) -> f64 {
    let surface = mesh.surface();
    let at = |node: &u32| Vector3::from(mesh.points_m()[*node as usize]);
    let deepest_m = poses(Some(hand), tool.way.as_ref(), None)
        .into_iter()
        .filter_map(|pose| tool.shape.place(&at_rest(0, &pose)))
        .map(|place| Solid::new(&tool.shape, 0.0, &place))
        .flat_map(|solid| {
            let depths = surface
                .vertices
                .iter()
                .map(move |node| -solid.gap(&at(node)));
            depths.reduce(f64::max)
        });
    let deepest_m = deepest_m.fold(0.0, f64::max);
    (deepest_m - most_n / f64::from(hand.stiffness_n_per_m)).max(0.0)
}

/// A tool that is small against the mesh where it comes, and what was measured of such ones: of interest below four edges, a
/// warning below three; nothing of a larger one.
fn small_tool(document: &Document, at: Range<usize>, shape: &Shape, edges: &Edges) -> Option<Flaw> {
    let (edge_m, radius_m) = (edges.near_m, shape.radius_m());
    let in_edges = radius_m / edge_m;
    // Radius that the solver uses.
    let counts_m = shape.at_least(edges.mean_m).radius_m();
    if counts_m > radius_m && in_edges >= LEAST_RADIUS_IN_EDGES {
        let message = format!(
            "a tool of {:.1} mm radius counts as one of {:.1} mm, the mean edge of the whole boundary; where the tool comes edges have {:.1} mm",
            radius_m * 1e3,
            counts_m * 1e3,
            edge_m * 1e3
        );
        let help = "a tool smaller than the mean edge would slip in between vertices elsewhere: take a larger tool, or a mesh that is finer everywhere on its boundary";
        let label = format!("{:.1} edges of the whole", radius_m / edges.mean_m);
        return Some(document.note(Severity::Warning, at, message, label, Some(help)));
    }
    let severity = match in_edges {
        edges if edges < LEAST_RADIUS_IN_EDGES => Severity::Warning,
        edges if edges < ACCURATE_RADIUS_IN_EDGES => Severity::Advice,
        _ => return None,
    };
    let [accurate, _] = measured_error_percent(ACCURATE_RADIUS_IN_EDGES).unwrap_or_default();
    let accurate_m = ACCURATE_RADIUS_IN_EDGES * edge_m;
    let what = format!(
        "a tool of {:.1} mm radius on edges of {:.1} mm",
        radius_m * 1e3,
        edge_m * 1e3
    );
    let (message, help) = match measured_error_percent(in_edges) {
        Some([error, largest]) => (
            format!(
                "{what}: a ball like that has a measured error of {error:.0} % in its force, {largest:.0} % where it is largest"
            ),
            format!(
                "measured over the places of a cell against an independent value; with a radius of {accurate_m:.4} m, four edges, or a finer mesh it is {accurate:.0} %"
            ),
        ),
        None => (
            format!(
                "{what}: less than {LEAST_MEASURED_IN_EDGES} edges, of which nobody has measured how wrong the force is, and it counts as one of {:.1} mm",
                counts_m * 1e3
            ),
            format!(
                "with a radius of {accurate_m:.4} m, four edges, or a finer mesh the measured error is {accurate:.0} %"
            ),
        ),
    };
    let label = format!("{in_edges:.1} edges");
    Some(document.note(severity, at, message, label, Some(&help)))
}

/// Rim of a flat face below which a warning is due, and a note [mean edges where the tool comes].
const THIN_RIM: (f64, f64) = (0.5, 1.0);

/// A flat face whose rim the mesh does not resolve. Drawn aside it ploughs: vertices before its side never come under the face. On a linear slab a
/// punch of 2.7 edges, 0.3 radii deep, lost 52 % of its force with a rim of 0.27 edges in four strokes, and 2 % with one of 1.2.
fn thin_rim(document: &Document, at: Range<usize>, shape: &Shape, edges: &Edges) -> Option<Flaw> {
    let (Shape::FlatPunch { fillet_m, .. } | Shape::RoundedBox { fillet_m, .. }) = shape else {
        return None;
    };
    let in_edges = fillet_m / edges.near_m;
    let severity = match in_edges {
        thin if thin < THIN_RIM.0 => Severity::Warning,
        thin if thin < THIN_RIM.1 => Severity::Advice,
        _ => return None,
    };
    let message = format!(
        "a rim of {:.1} mm on edges of {:.1} mm: drawn aside, the face ploughs, and its force may fall by half without a word",
        fillet_m * 1e3,
        edges.near_m * 1e3
    );
    let help = format!(
        "pressed straight it is right; to draw it aside, take a `fillet_m` of {:.4} m or more, or a finer mesh",
        edges.near_m
    );
    let label = format!("{in_edges:.1} edges");
    Some(document.note(severity, at, message, label, Some(&help)))
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
