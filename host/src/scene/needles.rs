//! `[[needle]]`: shapes, where they start, who holds them when, and how tissue answers them.
//!
//! Entry points: [`read_needles`], [`read_needle_tissue`], [`read_needle_solver`].

use super::Tool;
use super::document::{Document, Flaw, SceneError};
use super::tool_shape::unit_vector;
use crate::mesh::TetMesh;
use crate::needle::{
    self, Curve, Joints, MOST_SEGMENTS, NeedleSegment, NeedleSegments, NeedleShape, NeedleTissue,
    Playback,
};
use nalgebra::{Isometry3, Vector3};
use sutura_scene_file::scene::{
    NeedleHoldSection, NeedleSection, NeedleSegmentSection, NeedleShapeName, NeedleSolverSection,
    NeedleTissueSection, PlaybackName, RegionSection, SceneFile, TissueSection,
};
use toml::Spanned;

/// Points of a needle at which it is looked whether it starts in tissue.
const LOOKS: u32 = 32;
/// A direction's part across another one that still is a direction: a degree.
const LEAST_ACROSS: f64 = 0.0175;

/// Coulomb's coefficient of a needle on the surface where a scene does not say: its tip digs in at any angle.
const SURFACE_FRICTION: f64 = f64::INFINITY;

/// A needle of a scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Needle {
    /// Number on the wire.
    pub id: u8,
    /// Centre line and thickness.
    pub needle: needle::Needle,
    /// Where its frame is at the start, end at the origin and first tangent along x.
    pub start: Isometry3<f64>,
    /// Whether its shaft touches the surface.
    pub body: bool,
    /// What it falls with where nobody holds it.
    pub weight: Option<needle::NeedleWeight>,
    /// Who holds it, in the order of time; the first from the start on.
    pub holds: Vec<Hold>,
}

/// From when on who holds a needle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hold {
    /// Since the session began \[s\].
    pub time_s: f64,
    /// Id of the tool; `None`: it is let go.
    pub tool: Option<u8>,
}

/// Speed against accuracy of needles.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct NeedleSolver {
    /// What follows a puncture.
    pub playback: Playback,
}

/// The needles of a scene, with different ids.
///
/// # Errors
/// A flaw at a length, angle or direction that is none, at a start inside the tissue, at a hold by a tool
/// that is no grip.
pub(super) fn read_needles(
    document: &Document,
    sections: &[Spanned<NeedleSection>],
    tools: &[Tool],
    mesh: &TetMesh,
) -> Result<Vec<Needle>, SceneError> {
    let surface = mesh.surface();
    let mut needles: Vec<Needle> = Vec::with_capacity(sections.len());
    for (place, section) in sections.iter().enumerate() {
        let said = section.get_ref();
        let id = said.id.as_ref().map_or(place as u8, |id| *id.get_ref());
        if needles.iter().any(|needle| needle.id == id) {
            let span = said
                .id
                .as_ref()
                .map_or_else(|| section.span(), Spanned::span);
            let message = format!("two needles have the id {id}");
            let help = "give every needle an `id` of its own, 0 to 255";
            return Err(document.flaw(span, message, "the second", Some(help)));
        }
        let shape = read_shape(document, section)?;
        let help = "the diameter in metres: suture needles have 0.0002 to 0.0012";
        let positive = |v: f64| v > 0.0;
        let thickness_m =
            document.number("thickness_m", &said.thickness_m, "positive", positive, help)?;
        let needle = needle::Needle { shape, thickness_m };
        let start = read_start(document, said, needle)?;
        let curve = needle.at(&start);
        let inside = |look: &u32| {
            let alpha = curve.length * f64::from(*look) / f64::from(LOOKS);
            surface.contains(mesh.points_m(), curve.at(alpha).into())
        };
        if let Some(look) = (0..=LOOKS).find(inside) {
            let message = format!(
                "this needle starts inside the tissue, {:.1} mm from its end",
                1e3 * curve.length * f64::from(look) / f64::from(LOOKS)
            );
            let help = "a needle comes from outside: move `end_m` away, or turn `direction`";
            return Err(document.flaw(said.end_m.span(), message, "inside", Some(help)));
        }
        let holds = read_holds(document, section, tools)?;
        needles.push(Needle {
            id,
            needle,
            start,
            body: said.body,
            weight: None,
            holds,
        });
    }
    check_hands(document, sections, &needles)?;
    Ok(needles)
}

/// Refuses keys of other shapes.
fn check_keys(document: &Document, said: &NeedleSection) -> Result<(), SceneError> {
    let span = |key: &Option<Spanned<f64>>| key.as_ref().map(Spanned::span);
    let of_arcs = [span(&said.radius_m), span(&said.angle_deg)];
    let of_segments = said.segments.as_ref().map(Spanned::span);
    let towards = said.towards.as_ref().map(Spanned::span);
    let mut arcs = of_arcs.into_iter().flatten();
    let (word, foreign, help) = match said.shape {
        NeedleShapeName::Straight => (
            "a straight needle has no radius, angle or side that it bends to",
            arcs.next().or(towards).or(of_segments),
            "make it `shape = \"arc\"`, or leave this key out",
        ),
        NeedleShapeName::Arc => (
            "an arc's length is that of its radius and angle together",
            span(&said.length_m).or(of_segments),
            "leave `length_m` out, or make it `shape = \"straight\"`",
        ),
        NeedleShapeName::Segments => (
            "a needle of segments has the lengths and radii of these",
            span(&said.length_m).or_else(|| arcs.next()),
            "put it into `segments`",
        ),
    };
    match foreign {
        Some(span) => Err(document.flaw(span, word, "not of this shape", Some(help))),
        None => Ok(()),
    }
}

fn read_shape(
    document: &Document,
    section: &Spanned<NeedleSection>,
) -> Result<NeedleShape, SceneError> {
    let said = section.get_ref();
    check_keys(document, said)?;
    let number = |key: &str, value: &Option<Spanned<f64>>, rule: &str, most: f64, help: &str| {
        let value = needed(document, section, key, value.as_ref())?;
        document.number(key, value, rule, |v| v > 0.0 && v < most, help)
    };
    let most = f64::INFINITY;
    match said.shape {
        NeedleShapeName::Straight => {
            let help = "from end to tip, in metres: 0.02 to 0.06 are usual";
            Ok(NeedleShape::Straight {
                length_m: number("length_m", &said.length_m, "positive", most, help)?,
            })
        }
        NeedleShapeName::Arc => {
            let help = "of the circle, in metres: 0.004 to 0.02 are usual";
            let radius_m = number("radius_m", &said.radius_m, "positive", most, help)?;
            let rule = "more than 0 and less than 360";
            let help = "from end to tip: half a circle is 180, suture needles have 90 to 225";
            let degrees = number("angle_deg", &said.angle_deg, rule, 360.0, help)?;
            Ok(NeedleShape::Arc {
                radius_m,
                angle_rad: degrees.to_radians(),
            })
        }
        NeedleShapeName::Segments => {
            let segments = needed(document, section, "segments", said.segments.as_ref())?;
            read_segments(document, segments)
        }
    }
}

fn read_segments(
    document: &Document,
    said: &Spanned<Vec<NeedleSegmentSection>>,
) -> Result<NeedleShape, SceneError> {
    let mut segments = Vec::with_capacity(said.get_ref().len());
    let mut turn = 0.0;
    for segment in said.get_ref() {
        let positive = |key: &str, value: &Spanned<f64>, help: &str| {
            document.number(key, value, "positive", |v| v > 0.0, help)
        };
        let help = "along the needle, in metres";
        let length_m = positive("length_m", &segment.length_m, help)?;
        let radius_m = match &segment.radius_m {
            Some(value) => positive("radius_m", value, "of the circle; left out it is straight")?,
            None => f64::INFINITY,
        };
        turn += length_m / radius_m;
        segments.push(NeedleSegment { length_m, radius_m });
    }
    let flaw =
        |message: String, help: &str| document.flaw(said.span(), message, "segments", Some(help));
    if turn >= std::f64::consts::TAU {
        let message = format!("the segments turn by {:.0} degrees", turn.to_degrees());
        return Err(flaw(
            message,
            "less than a whole turn, 360 degrees, together",
        ));
    }
    let shape = NeedleSegments::new(&segments).map(NeedleShape::Segments);
    shape.ok_or_else(|| {
        let message = format!("{} segments", segments.len());
        flaw(
            message,
            &format!("a needle is made of 1 to {MOST_SEGMENTS}"),
        )
    })
}

fn needed<'a, T>(
    document: &Document,
    section: &Spanned<NeedleSection>,
    key: &str,
    value: Option<&'a T>,
) -> Result<&'a T, SceneError> {
    value.ok_or_else(|| {
        let message = format!("missing key `{key}`");
        let help = format!("add `{key} = ...`");
        document.flaw(section.span(), message, "needed here", Some(&help))
    })
}

fn read_start(
    document: &Document,
    said: &NeedleSection,
    needle: needle::Needle,
) -> Result<Isometry3<f64>, SceneError> {
    let end = document.finite("end_m", &said.end_m)?;
    let direction = |key: &str, value: &Spanned<[f64; 3]>| {
        let vector = Vector3::from(document.finite(key, value)?);
        unit_vector(vector).ok_or_else(|| {
            let message = format!("{key}: a direction without length");
            let help = "three numbers along x, y, z, not all zero";
            document.flaw(value.span(), message, "no direction", Some(help))
        })
    };
    let tangent = direction("direction", &said.direction)?;
    let aside = match &said.towards {
        None if !needle.shape.bends() => Vector3::ith(tangent.iamin(), 1.0),
        Some(towards) => {
            let side = direction("towards", towards)?;
            if side.cross(&tangent).norm() < LEAST_ACROSS {
                let message = "towards: along `direction`, not to one of its sides";
                let help = "from the needle's end to the circle's centre, across `direction`";
                return Err(document.flaw(towards.span(), message, "no side", Some(help)));
            }
            side
        }
        None => {
            let message = "an arc that does not say to which side it bends";
            let help = "add `towards = [..]`, from the needle's end to the circle's centre";
            let span = said.direction.span();
            return Err(document.flaw(span, message, "and bends where?", Some(help)));
        }
    };
    let inward = (aside - tangent * tangent.dot(&aside)).normalize();
    Ok(Isometry3::from(&Curve {
        start: Vector3::from(end),
        tangent,
        inward,
        curvature: needle.shape.curvature_per_m(),
        length: needle.shape.length_m(),
        joints: Joints::default(),
    }))
}

fn read_holds(
    document: &Document,
    section: &Spanned<NeedleSection>,
    tools: &[Tool],
) -> Result<Vec<Hold>, SceneError> {
    if section.get_ref().hold.is_empty() {
        let message = "nobody holds this needle";
        let help = "add `[[needle.hold]]` with `time_s = 0.0` and the id of a `tool`";
        return Err(document.flaw(section.span(), message, "no hold", Some(help)));
    }
    let mut holds: Vec<Hold> = Vec::new();
    for hold in &section.get_ref().hold {
        let NeedleHoldSection { time_s, tool } = hold.get_ref();
        let help = "the first hold is from 0 on; times do not go back";
        let time_s = match holds.last() {
            None => document.number("time_s", time_s, "0, the first", |t| t == 0.0, help)?,
            Some(before) => {
                let rule = format!("at least {}, the time before it", before.time_s);
                let in_order = |t| t >= before.time_s;
                document.number("time_s", time_s, &rule, in_order, help)?
            }
        };
        if let Some(id) = tool {
            let grips: Vec<u8> = tools.iter().map(|tool| tool.id).collect();
            let Some(found) = tools.iter().find(|tool| tool.id == *id.get_ref()) else {
                let message = format!("there is no tool {}", id.get_ref());
                let help = format!("this scene's tools are {grips:?}");
                return Err(document.flaw(id.span(), message, "no such tool", Some(&help)));
            };
            if !found.driven && found.pose.is_none() {
                let message = format!("tool {} is nowhere: it cannot hold a needle", found.id);
                let help = "give it `position_m` or `[[tool.way_point]]`, or let it be driven";
                return Err(document.flaw(id.span(), message, "has no place", Some(help)));
            }
        }
        holds.push(Hold {
            time_s,
            tool: tool.as_ref().map(|id| *id.get_ref()),
        });
    }
    Ok(holds)
}

/// A hand holds one needle at a time.
fn check_hands(
    document: &Document,
    sections: &[Spanned<NeedleSection>],
    needles: &[Needle],
) -> Result<(), SceneError> {
    let holder = |needle: &Needle, time_s: f64| {
        let last = needle.holds.iter().rev().find(|hold| hold.time_s <= time_s);
        last.and_then(|hold| hold.tool)
    };
    for (index, needle) in needles.iter().enumerate() {
        for (place, hold) in needle.holds.iter().enumerate() {
            let others = needles.iter().enumerate().filter(|(at, _)| *at != index);
            let mut others = others.filter(|(_, other)| {
                hold.tool.is_some() && holder(other, hold.time_s) == hold.tool
            });
            let (Some((_, other)), Some(tool)) = (others.next(), hold.tool) else {
                continue;
            };
            let span = sections[index].get_ref().hold[place].span();
            let message = format!(
                "tool {tool} holds the needles {} and {} at {} s",
                other.id, needle.id, hold.time_s
            );
            let help =
                "let one needle go before the other is taken: `[[needle.hold]]` without `tool`";
            return Err(document.flaw(span, message, "a hand holds one", Some(help)));
        }
    }
    Ok(())
}

/// How each cell answers needles, (m); empty in a scene without needles.
///
/// # Errors
/// A flaw at a number that is none, or where a scene with needles says nothing of how tissue answers.
pub(super) fn read_needle_tissue(
    document: &Document,
    file: &SceneFile,
    of_cell: &[u32],
    warnings: &mut Vec<Flaw>,
) -> Result<Vec<NeedleTissue>, SceneError> {
    let (tissue, regions): (&TissueSection, &[Spanned<RegionSection>]) =
        (&file.tissue, &file.region);
    let everywhere = match &tissue.needle {
        Some(section) => Some(read_properties(document, section, None)?),
        None => None,
    };
    let mut list = Vec::with_capacity(1 + regions.len());
    list.extend(everywhere);
    for region in regions {
        let region = region.get_ref();
        match (&region.needle, &everywhere) {
            (Some(section), Some(_)) => {
                list.push(read_properties(document, section, everywhere.as_ref())?);
            }
            (None, Some(everywhere)) => list.push(*everywhere),
            (Some(section), None) => {
                let message = "a region answers needles in its own way, but the tissue in none";
                let help = "add `[tissue.needle]`: it says what the rest of the tissue does";
                return Err(document.flaw(section.span(), message, "own way", Some(help)));
            }
            (None, None) => {}
        }
    }
    match (&tissue.needle, file.needle.first()) {
        (None, Some(needle)) => {
            let message = "a needle, but nothing that says how the tissue answers it";
            let help = "add `[tissue.needle]` with `friction_n_per_m` and `puncture_pa`";
            Err(document.flaw(
                needle.span(),
                message,
                "needs `[tissue.needle]`",
                Some(help),
            ))
        }
        (Some(section), None) => {
            let message = "the tissue answers needles, but there are none";
            let help = "add a `[[needle]]`, or leave this out";
            warnings.push(document.warning(section.span(), message, "not used", help));
            Ok(Vec::new())
        }
        (None, None) => Ok(Vec::new()),
        (Some(_), Some(_)) => Ok(of_cell
            .iter()
            .filter_map(|index| list.get(*index as usize).copied())
            .collect()),
    }
}

/// What a section says, with `otherwise` for what it leaves out.
fn read_properties(
    document: &Document,
    section: &Spanned<NeedleTissueSection>,
    otherwise: Option<&NeedleTissue>,
) -> Result<NeedleTissue, SceneError> {
    let said = section.get_ref();
    let needed = |key: &str| {
        let message = format!("missing key `{key}`");
        let help = "friction and puncture decide what is felt, and differ a hundredfold between tissues: no value would \
                    do for all. Soft organs have some 10 to 100 N/m and 1e5 to 1e6 Pa, skin and fascia ten times that";
        document.flaw(section.span(), message, "needed here", Some(help))
    };
    let not_negative = |key: &str, value: &Spanned<f64>, help: &str| {
        document.number(key, value, "zero or positive", |v| v >= 0.0, help)
    };
    let friction_n_per_m = match (&said.friction_n_per_m, otherwise) {
        (Some(value), _) => {
            let help =
                "force per length of needle in tissue while it slides: soft organs 10 to 100 N/m";
            not_negative("friction_n_per_m", value, help)?
        }
        (None, Some(otherwise)) => otherwise.friction_n_per_m,
        (None, None) => return Err(needed("friction_n_per_m")),
    };
    let static_friction_n_per_m = match (&said.static_friction_n_per_m, otherwise) {
        (Some(value), _) => document.number(
            "static_friction_n_per_m",
            value,
            &format!("at least {friction_n_per_m}, the friction while it slides"),
            |v| v >= friction_n_per_m,
            "what holds a needle still is no less than what holds a sliding one back",
        )?,
        // Its own friction comes with its own static one.
        (None, Some(otherwise)) if said.friction_n_per_m.is_none() => {
            otherwise.static_friction_n_per_m
        }
        (None, _) => friction_n_per_m,
    };
    let viscous_n_s_per_m2 = match (&said.viscous_n_s_per_m2, otherwise) {
        (Some(value), _) => not_negative(
            "viscous_n_s_per_m2",
            value,
            "added to friction_n_per_m at 1 m/s",
        )?,
        (None, otherwise) => otherwise.map_or(0.0, |other| other.viscous_n_s_per_m2),
    };
    let cutting_pa = match (&said.cutting_pa, otherwise) {
        (Some(value), _) => not_negative(
            "cutting_pa",
            value,
            "force on the tip that cuts on, over its area: some tenths of puncture_pa",
        )?,
        (None, otherwise) => otherwise.map_or(0.0, |other| other.cutting_pa),
    };
    let puncture_pa = match (&said.puncture_pa, otherwise) {
        // Never punctured.
        (Some(value), _) if *value.get_ref() == f64::INFINITY => f64::INFINITY,
        (Some(value), _) => not_negative(
            "puncture_pa",
            value,
            "force that breaks through, over the tip's area; `inf` is never",
        )?,
        (None, Some(otherwise)) => otherwise.puncture_pa,
        (None, None) => return Err(needed("puncture_pa")),
    };
    Ok(NeedleTissue {
        friction_n_per_m,
        static_friction_n_per_m,
        viscous_n_s_per_m2,
        cutting_pa,
        puncture_pa,
        surface_friction: read_surface_friction(document, said, otherwise)?,
    })
}

/// Coulomb's coefficient on the surface, with `otherwise` for one that is left out.
fn read_surface_friction(
    document: &Document,
    said: &NeedleTissueSection,
    otherwise: Option<&NeedleTissue>,
) -> Result<f64, SceneError> {
    let help = "Coulomb's coefficient of the needle on the surface; `inf`: its tip never slips";
    match &said.surface_friction {
        Some(value) if *value.get_ref() == f64::INFINITY => Ok(f64::INFINITY),
        Some(value) => {
            let not_negative = |v| v >= 0.0;
            document.number(
                "surface_friction",
                value,
                "zero or positive",
                not_negative,
                help,
            )
        }
        None => Ok(otherwise.map_or(SURFACE_FRICTION, |other| other.surface_friction)),
    }
}

/// Speed against accuracy.
///
/// # Errors
/// A flaw at settings without a needle.
pub(super) fn read_needle_solver(
    document: &Document,
    file: &SceneFile,
) -> Result<NeedleSolver, SceneError> {
    let Some(section) = &file.needle_solver else {
        return Ok(NeedleSolver::default());
    };
    if file.needle.is_empty() {
        let message = "settings for needles in a scene that has none";
        let help = "add a `[[needle]]`, or leave this section out";
        return Err(document.flaw(section.span(), message, "no needle", Some(help)));
    }
    let NeedleSolverSection { playback } = section.get_ref();
    Ok(NeedleSolver {
        playback: match playback {
            PlaybackName::OneSolve => Playback::OneSolve,
            PlaybackName::EveryPose => Playback::EveryPose,
        },
    })
}
