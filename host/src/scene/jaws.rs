//! `[[jaws]]`: pads on grips, and when they are closed.
//!
//! Entry point: [`read_jaws`].

use super::document::{Document, SceneError};
use super::tool_shape::unit_vector;
use super::{Needle, Thread, Tool};
use crate::jaws::{self, FEWEST_POINTS, JawsPart, MOST_POINTS};
use crate::thread::ThreadHold;
use crate::tool::{MOST_FRICTION, Shape};
use nalgebra::Vector3;
use sutura_scene_file::jaws::{JawsCloseSection, JawsSection};
use toml::Spanned;

/// Jaws of a scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Jaws {
    /// What is constant about them, and which tool carries them.
    pub part: JawsPart,
    /// From when until when they are closed \[s\], in the order of time.
    pub closes: Vec<[f64; 2]>,
}

impl Jaws {
    /// Whether their script has them closed at a time since the session began \[s\].
    pub fn is_closed(&self, time_s: f64) -> bool {
        let mut closes = self.closes.iter();
        closes.any(|[from_s, to_s]| (*from_s..*to_s).contains(&time_s))
    }
}

/// The jaws of a scene, on different tools.
///
/// # Errors
/// A flaw at a tool that is no grip, is nowhere, or holds something else; at a number or direction that is none; at times that
/// go back.
pub(super) fn read_jaws(
    document: &Document,
    sections: &[Spanned<JawsSection>],
    tools: &[Tool],
    (needles, threads): (&[Needle], &[Thread]),
) -> Result<Vec<Jaws>, SceneError> {
    let mut jaws: Vec<Jaws> = Vec::with_capacity(sections.len());
    for section in sections {
        let said = section.get_ref();
        check_tool(document, &said.tool, tools, (needles, threads))?;
        let tool = *said.tool.get_ref();
        if jaws.iter().any(|other| other.part.tool == tool) {
            let message = format!("tool {tool} has jaws already");
            let help = "a tool carries one pair: give the other one a grip of its own";
            return Err(document.flaw(said.tool.span(), message, "the second", Some(help)));
        }
        let part = JawsPart {
            tool,
            jaws: read_shape(document, said)?,
        };
        if let Some(flaw) = part.jaws.flaw() {
            return Err(document.flaw(section.span(), flaw, "in this section", None));
        }
        let closes = read_closes(document, &said.close)?;
        jaws.push(Jaws { part, closes });
    }
    Ok(jaws)
}

fn check_tool(
    document: &Document,
    said: &Spanned<u8>,
    tools: &[Tool],
    (needles, threads): (&[Needle], &[Thread]),
) -> Result<(), SceneError> {
    let (id, span) = (*said.get_ref(), said.span());
    let Some(tool) = tools.iter().find(|tool| tool.id == id) else {
        let message = format!("there is no tool {id}");
        let ids: Vec<u8> = tools.iter().map(|tool| tool.id).collect();
        let help = format!("this scene's tools are {ids:?}");
        return Err(document.flaw(span, message, "no such tool", Some(&help)));
    };
    if tool.shape.shape != Shape::Grip {
        let message = format!("tool {id} touches tissue by itself: it cannot carry jaws");
        let help = "make it `shape = \"grip\"`";
        return Err(document.flaw(span, message, "no grip", Some(help)));
    }
    if !tool.driven && tool.pose.is_none() {
        let message = format!("tool {id} is nowhere: it cannot hold tissue");
        let help = "give it `position_m` or `[[tool.way_point]]`, or let it be driven";
        return Err(document.flaw(span, message, "has no place", Some(help)));
    }
    let by = ThreadHold::Tool(id);
    let mut needle_holds = needles.iter().flat_map(|needle| &needle.holds);
    let mut thread_holds = threads.iter().flat_map(|thread| &thread.holds);
    let what = if needle_holds.any(|hold| hold.tool == Some(id)) {
        "a needle"
    } else if thread_holds.any(|hold| hold.by == by) {
        "a thread"
    } else {
        return Ok(());
    };
    let message = format!("tool {id} holds {what}, too");
    let help = "jaws that take hold of tissue hold nothing else: give them a grip of their own";
    Err(document.flaw(span, message, "holds one thing", Some(help)))
}

fn read_shape(document: &Document, said: &JawsSection) -> Result<jaws::Jaws, SceneError> {
    let number = |key: &str, value: &Spanned<f64>, rule: &str, most: f64, help: &str| {
        let sound = |v: f64| v > 0.0 && v < most;
        document.number(key, value, rule, sound, help)
    };
    let or = |key: &str, value: &Option<Spanned<f64>>, usual: f64, help: &str| match value {
        Some(value) => number(key, value, "positive", f64::INFINITY, help),
        None => Ok(usual),
    };
    let not_negative = |v: f64| v >= 0.0;
    let help = "in newtons: graspers press with 1 to 5";
    let clamp_n = match *said.clamp_n.get_ref() == f64::INFINITY {
        // Nothing slips.
        true => f64::INFINITY,
        false => document.number("clamp_n", &said.clamp_n, "0 or more", not_negative, help)?,
    };
    let rule = format!("between 0 and {MOST_FRICTION}");
    let help = "serrated jaws on wet tissue have 0.3 to 0.6";
    let in_range = |v: f64| (0.0..=MOST_FRICTION).contains(&v);
    let friction = document.number("friction", &said.friction, &rule, in_range, help)?;
    let opening_deg = match &said.opening_deg {
        Some(value) => {
            let (rule, help) = ("more than 0 and less than 180", "graspers open by 30 to 90");
            number("opening_deg", value, rule, 180.0, help)?
        }
        None => jaws::DEFAULT_OPENING_DEG,
    };
    let (axis, side) = read_directions(document, said)?;
    let offset_m = match &said.offset_m {
        Some(offset) => document.finite("offset_m", offset)?,
        None => [0.0; 3],
    };
    let strength_pa = match &said.strength_pa {
        Some(value) => {
            let (rule, help) = (
                "positive",
                "pull over the area of a pad: soft organs bear 1e4 to 1e5 Pa",
            );
            document.number("strength_pa", value, rule, |v| v > 0.0, help)?
        }
        None => f64::INFINITY,
    };
    let [long, wide] = [
        "from the hinge to the front: 0.01 to 0.03",
        "along the hinge: 0.003 to 0.01",
    ];
    Ok(jaws::Jaws {
        offset_m,
        axis: axis.into(),
        side: side.into(),
        length_m: or("length_m", &said.length_m, jaws::DEFAULT_LENGTH_M, long)?,
        width_m: or("width_m", &said.width_m, jaws::DEFAULT_WIDTH_M, wide)?,
        opening_rad: opening_deg.to_radians(),
        clamp_n,
        friction,
        points: read_points(document, said)?,
        strength_pa,
    })
}

fn read_points(document: &Document, said: &JawsSection) -> Result<usize, SceneError> {
    let Some(points) = &said.points else {
        return Ok(jaws::DEFAULT_POINTS);
    };
    let count = *points.get_ref() as usize;
    if !(FEWEST_POINTS..=MOST_POINTS).contains(&count) {
        let message = format!("points = {count}: must be from {FEWEST_POINTS} to {MOST_POINTS}");
        let help = "three hold a moment; each takes three rows";
        return Err(document.flaw(points.span(), message, "out of range", Some(help)));
    }
    Ok(count)
}

/// Where the pads point, and along their hinge: unit vectors across each other.
fn read_directions(
    document: &Document,
    said: &JawsSection,
) -> Result<(Vector3<f64>, Vector3<f64>), SceneError> {
    let usual = jaws::Jaws::new(0.0, 0.0);
    let direction = |key: &str, value: &Option<Spanned<[f64; 3]>>, usual: [f64; 3]| match value {
        Some(value) => {
            let vector = Vector3::from(document.finite(key, value)?);
            unit_vector(vector).ok_or_else(|| {
                let message = format!("{key}: a direction without length");
                let help = "three numbers along x, y, z, not all zero";
                document.flaw(value.span(), message, "no direction", Some(help))
            })
        }
        None => Ok(Vector3::from(usual)),
    };
    let axis = direction("axis", &said.axis, usual.axis)?;
    let side = direction("side", &said.side, usual.side)?;
    let across = side - axis * axis.dot(&side);
    let side = across.try_normalize(1e-6).ok_or_else(|| {
        let key = said.side.as_ref().or(said.axis.as_ref());
        let span = key.map_or_else(|| said.tool.span(), Spanned::span);
        let message = "the hinge lies along the pads' axis";
        let help = "add `side = [..]` across `axis`: the pads close across both";
        document.flaw(span, message, "no direction across the axis", Some(help))
    })?;
    Ok((axis, side))
}

fn read_closes(
    document: &Document,
    sections: &[Spanned<JawsCloseSection>],
) -> Result<Vec<[f64; 2]>, SceneError> {
    let mut closes: Vec<[f64; 2]> = Vec::with_capacity(sections.len());
    for section in sections {
        let JawsCloseSection { from_s, to_s } = section.get_ref();
        let before_s = closes.last().map_or(0.0, |[_, to_s]| *to_s);
        let rule = format!("at least {before_s}, when the jaws are open again");
        let help = "times are counted from the start of the session and do not go back";
        let from_s = document.number("from_s", from_s, &rule, |t| t >= before_s, help)?;
        let to_s = match to_s {
            Some(to_s) => {
                let rule = format!("more than {from_s}, when they close");
                document.number("to_s", to_s, &rule, |t| t > from_s, help)?
            }
            None => f64::INFINITY,
        };
        closes.push([from_s, to_s]);
    }
    Ok(closes)
}

#[cfg(test)]
mod tests {
    use super::super::Scene;
    use super::*;

    const SCENE: &str = r#"
[mesh.slab]
size_m = [0.02, 0.02, 0.01]
divisions = [2, 2, 1]
[tissue]
youngs_modulus_pa = 20e3
poisson_ratio = 0.45
needle = { friction_n_per_m = 10.0, puncture_pa = 1e5 }
[[fixed]]
plane = { axis = "z", at_m = -0.01 }
[[tool]]
id = 4
shape = "grip"
[[tool]]
id = 5
shape = "grip"
position_m = [0.0, 0.0, 0.1]
[[tool]]
id = 6
radius_m = 0.01
[[tool]]
id = 7
shape = "grip"
[[needle]]
shape = "straight"
length_m = 0.02
thickness_m = 0.001
end_m = [0.0, 0.0, 0.1]
direction = [1.0, 0.0, 0.0]
hold = [{ time_s = 0.0, tool = 5 }]
[[jaws]]
tool = 4
clamp_n = 2.0
friction = 0.4
"#;

    fn read(more: &str) -> Result<Scene, String> {
        let text = format!("{SCENE}{more}");
        let document = Document::embedded("test.toml", "".as_ref(), &text);
        Scene::read(&document, "test").map_err(|error| error.to_string())
    }

    #[test]
    fn keys_are_those_of_the_file() {
        let scene = read(
            "length_m = 0.015\nwidth_m = 0.004\nopening_deg = 45.0\noffset_m = [0.0, 0.0, -0.05]\naxis = [0.0, 3.0, 0.0]\n\
             side = [1.0, 1.0, 0.0]\npoints = 12\nstrength_pa = 2e4\n[[jaws.close]]\nfrom_s = 1.0\nto_s = 2.0\n[[jaws.close]]\nfrom_s = 3.0\n",
        )
        .expect("a good scene");
        let jaws = &scene.jaws[0];
        let expected = jaws::Jaws {
            offset_m: [0.0, 0.0, -0.05],
            axis: [0.0, 1.0, 0.0],
            side: [1.0, 0.0, 0.0],
            length_m: 0.015,
            width_m: 0.004,
            opening_rad: 45.0f64.to_radians(),
            clamp_n: 2.0,
            friction: 0.4,
            points: 12,
            strength_pa: 2e4,
        };
        assert_eq!((jaws.part.tool, jaws.part.jaws), (4, expected));
        let closed = [0.9, 1.0, 1.9, 2.0, 2.9, 3.0, 99.0].map(|time_s| jaws.is_closed(time_s));
        assert_eq!(closed, [false, true, true, false, false, true, true]);
        assert_eq!(scene.driven_jaws(), Some(4));
        // Nothing slips.
        let tight = SCENE.replace("clamp_n = 2.0", "clamp_n = inf");
        let document = Document::embedded("test.toml", "".as_ref(), &tight);
        let tight = Scene::read(&document, "test").expect("a good scene");
        assert_eq!(tight.jaws[0].part.jaws.clamp_n, f64::INFINITY);
        let pushed = SCENE.replace("clamp_n = 2.0", "clamp_n = -inf");
        let document = Document::embedded("test.toml", "".as_ref(), &pushed);
        let refused = Scene::read(&document, "test")
            .expect_err("a push")
            .to_string();
        assert!(refused.contains("clamp_n"), "{refused}");
        // What is left out.
        let usual = read("").expect("a good scene").jaws[0].part.jaws;
        assert_eq!(usual, jaws::Jaws::new(2.0, 0.4));
        let warned = scene.warnings.iter().map(ToString::to_string);
        assert_eq!(warned.filter(|w| w.contains("tool 4")).count(), 0);
    }

    #[test]
    fn what_makes_no_sense_is_refused_at_its_place() {
        let refused = |more: &str, said: &str| {
            let found = read(more).expect_err(more);
            assert!(found.contains(said), "{more}: {found}");
        };
        let second = |tool: u8| format!("[[jaws]]\ntool = {tool}\nclamp_n = 1.0\nfriction = 0.5\n");
        refused(&second(4), "has jaws already");
        refused(&second(5), "holds a needle, too");
        refused(&second(6), "touches tissue by itself");
        refused(&second(7), "is nowhere");
        refused(&second(8), "there is no tool 8");
        refused("points = 2", "points = 2");
        refused("opening_deg = 180.0", "opening_deg");
        refused("width_m = 0.0", "width_m");
        refused("strength_pa = -1.0", "strength_pa");
        refused("side = [0.0, 0.0, 2.0]", "along the pads' axis");
        refused("axis = [0.0, 0.0, 0.0]", "without length");
        refused("close = [{ from_s = 2.0, to_s = 1.0 }]", "to_s");
        refused("close = [{ from_s = 2.0 }, { from_s = 3.0 }]", "from_s");
        refused("grip_m = 1.0", "grip_m");
    }
}
