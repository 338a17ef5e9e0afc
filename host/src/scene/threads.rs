//! `[[thread]]`: which needles draw threads, what holds their ends when, and when they are tightened.
//!
//! Entry point: [`read_threads`].

use super::document::{Document, Flaw, SceneError};
use super::{Jaws, Needle, Tool};
use crate::thread::{
    MAX_STRANDS, MOST_HANDS, ThreadEnd, ThreadHold, ThreadPart, Through, Tightening,
};
use crate::tool::{MOST_FRICTION, Shape};
use sutura_scene_file::scene::ToolSection;
use sutura_scene_file::wound::{
    ThreadCutSection, ThreadEndName, ThreadHoldSection, ThreadSection, ThreadTightenSection,
};
use toml::Spanned;

/// What a thread bears that does not say \[N\]: braided sutures of 0.3 mm break at 20 to 30 N.
const STRENGTH_N: f64 = 20.0;

/// A thread of a scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Thread {
    /// What is constant about it.
    pub part: ThreadPart,
    /// What holds its ends, in the order of time.
    pub holds: Vec<ThreadHeld>,
    /// When it is cut, in the order of time.
    pub cuts: Vec<Cut>,
    /// When it is tightened, in the order of time.
    pub tightens: Vec<Tighten>,
}

/// When a thread is cut, and where it is nearest to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cut {
    /// Since the session began \[s\].
    pub time_s: f64,
    /// By which tool, or at which place.
    pub by: CutBy,
    /// Whether both ends are knotted.
    pub knots: bool,
}

/// What cuts a thread.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum CutBy {
    /// A tool, by its id, where it is then.
    Tool(u8),
    /// A place \[m\], (3).
    Place([f64; 3]),
}

/// From when on what holds an end of a thread.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ThreadHeld {
    /// Since the session began \[s\].
    pub time_s: f64,
    /// Which end.
    pub end: ThreadEnd,
    /// What holds it.
    pub by: ThreadHold,
}

/// When hands tighten a thread's spans between punctures, in proportion to time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tighten {
    /// When it begins \[s\].
    pub time_s: f64,
    /// When it is done \[s\].
    pub until_s: f64,
    /// Thread that is left in them then, over their length in the unloaded mesh.
    pub ratio: f64,
    /// Whether one comes after the other.
    pub in_turn: bool,
    /// Tension in one at which its hand draws no further \[N\].
    pub most_n: f64,
}

impl Thread {
    /// Pressure of it that tissue bears \[Pa\].
    pub fn tear_pa(&self) -> f64 {
        self.part.through.tear_pa
    }

    /// How far its spans are tightened at a time since the session began \[s\]; `None` before that begins.
    pub fn tightened(&self, time_s: f64) -> Option<Tightening> {
        let begun = self
            .tightens
            .partition_point(|tighten| tighten.time_s <= time_s);
        let (last, before) = self.tightens[..begun].split_last()?;
        let length_s = last.until_s - last.time_s;
        Some(Tightening {
            ratio: [before.last().map_or(1.0, |before| before.ratio), last.ratio],
            done: if time_s < last.until_s {
                (time_s - last.time_s) / length_s
            } else {
                1.0
            },
            in_turn: last.in_turn,
            most_n: last.most_n,
        })
    }
}

/// The threads of a scene, with different ids, on different needles.
///
/// # Errors
/// A flaw at a needle that is not there or has a thread already, at a length or force that is none, at a hold by
/// nothing that can hold, at times that go back.
pub(super) fn read_threads(
    document: &Document,
    sections: &[Spanned<ThreadSection>],
    needles: &[Needle],
    tools: &[Tool],
) -> Result<Vec<Thread>, SceneError> {
    let mut threads: Vec<Thread> = Vec::with_capacity(sections.len());
    let mut counted = Counted::default();
    for (place, section) in sections.iter().enumerate() {
        let said = section.get_ref();
        let id = said.id.as_ref().map_or(place as u8, |id| *id.get_ref());
        if threads.iter().any(|thread| thread.part.id == id) {
            let span = said
                .id
                .as_ref()
                .map_or_else(|| section.span(), Spanned::span);
            let message = format!("two threads have the id {id}");
            let help = "give every thread an `id` of its own, 0 to 255";
            return Err(document.flaw(span, message, "the second", Some(help)));
        }
        let needle = *said.needle.get_ref();
        let span = said.needle.span();
        if needles.iter().all(|other| other.id != needle) {
            let message = format!("there is no needle {needle}");
            let ids: Vec<u8> = needles.iter().map(|needle| needle.id).collect();
            let help = format!("this scene's needles are {ids:?}");
            return Err(document.flaw(span, message, "no such needle", Some(&help)));
        }
        if threads.iter().any(|thread| thread.part.needle == needle) {
            let message = format!("needle {needle} has a thread already");
            let help =
                "one thread is fastened to a needle's end: give the other one another needle";
            return Err(document.flaw(span, message, "the second", Some(help)));
        }
        let help = "from tail to head, in metres: 0.3 to 0.9 are usual";
        let positive = |v: f64| v > 0.0;
        let length_m = document.number("length_m", &said.length_m, "positive", positive, help)?;
        let strength_n = match &said.strength_n {
            Some(value) => {
                let help = "tension at which it would break, in newtons: sutures have 5 to 60";
                document.number("strength_n", value, "positive", positive, help)?
            }
            None => STRENGTH_N,
        };
        let holds = read_holds(document, &said.hold, tools)?;
        let mut through = read_through(document, said)?;
        let cuts = read_cuts(document, &said.cut, tools)?;
        through.strands = counted.add(document, section, &holds, &cuts)?;
        let part = ThreadPart {
            id,
            needle,
            length_m,
            friction: read_friction(document, said.friction.as_ref(), MOST_FRICTION)?,
            strength_n,
            through,
        };
        threads.push(Thread {
            part,
            tightens: read_tightens(document, &said.tighten, &part, &holds)?,
            holds,
            cuts,
        });
    }
    Ok(threads)
}

/// How a thread stretches, drags, slips and presses.
fn read_through(document: &Document, said: &ThreadSection) -> Result<Through, SceneError> {
    let number = |key: &str, value: &Option<Spanned<f64>>, sound: fn(f64) -> bool, help: &str| {
        let Some(value) = value else {
            return Ok(None);
        };
        let rule = if sound(0.0) {
            "zero or positive"
        } else {
            "positive"
        };
        document.number(key, value, rule, sound, help).map(Some)
    };
    // What does not give way.
    let rigid = |value: &Option<Spanned<f64>>| {
        let value = value.as_ref().map(|value| *value.get_ref());
        value == Some(f64::INFINITY)
    };
    let positive = |v: f64| v > 0.0;
    let mut through = Through::default();
    let help = "tension over strain, in newtons: sutures have 50 to 500; `inf` does not stretch";
    if !rigid(&said.axial_stiffness_n)
        && let Some(value) = number("axial_stiffness_n", &said.axial_stiffness_n, positive, help)?
    {
        through.axial_stiffness_n = value;
    }
    let help = "force per length in tissue, in newtons per metre: 0 to 20 are usual";
    if let Some(value) = number("drag_n_per_m", &said.drag_n_per_m, |v| v >= 0.0, help)? {
        through.drag_n_per_m = value;
    }
    let help = "tension at which it slips through a grip, in newtons; `inf` for never";
    if !rigid(&said.grip_n)
        && let Some(value) = number("grip_n", &said.grip_n, positive, help)?
    {
        through.grip_n = value;
    }
    let help = "tension at which it opens, in newtons; `inf` for never";
    if !rigid(&said.knot_n)
        && let Some(value) = number("knot_n", &said.knot_n, positive, help)?
    {
        through.knot_n = value;
    }
    let help = "diameter in metres: sutures have 0.00007 (6-0) to 0.0004 (0)";
    if let Some(value) = number("thickness_m", &said.thickness_m, positive, help)? {
        through.thickness_m = value;
    }
    let help = "in pascals: soft tissue bears 1e5 to 1e6 under a thread";
    if let Some(value) = number("tear_pa", &said.tear_pa, positive, help)? {
        through.tear_pa = value;
    }
    through.body = said.body;
    Ok(through)
}

/// Coulomb's coefficient of a thread or a contact, at most `most`; 0 when left out.
pub(super) fn read_friction(
    document: &Document,
    value: Option<&Spanned<f64>>,
    most: f64,
) -> Result<f64, SceneError> {
    let help =
        "Coulomb's coefficient, a number without unit: 0.05 to 0.3 between wet tissues and threads";
    let rule = match most.is_finite() {
        true => format!("between 0 and {most}"),
        false => "zero or positive".to_owned(),
    };
    let is_sound = |v| (0.0..=most).contains(&v);
    value.map_or(Ok(0.0), |value| {
        document.number("friction", value, &rule, is_sound, help)
    })
}

fn read_holds(
    document: &Document,
    sections: &[Spanned<ThreadHoldSection>],
    tools: &[Tool],
) -> Result<Vec<ThreadHeld>, SceneError> {
    let mut holds: Vec<ThreadHeld> = Vec::with_capacity(sections.len());
    for section in sections {
        let said = section.get_ref();
        let before_s = holds.last().map_or(0.0, |hold| hold.time_s);
        let time_s = in_order(document, "time_s", &said.time_s, before_s)?;
        let end = match said.end {
            ThreadEndName::Tail => ThreadEnd::Tail,
            ThreadEndName::Head => ThreadEnd::Head,
            ThreadEndName::Span => ThreadEnd::Span,
        };
        let knot = said.knot.as_ref().filter(|knot| *knot.get_ref());
        let lets_go = said.lets_go.as_ref().filter(|lets_go| *lets_go.get_ref());
        let by = match (&said.tool, &said.at_m, knot) {
            (None, None, None) => ThreadHold::Free,
            (None, None, Some(_)) if end == ThreadEnd::Tail => ThreadHold::Knot,
            (None, None, Some(knot)) => {
                let message = "a knot at the head, which the needle draws through the tissue";
                let help = "make it `end = \"tail\"`, or name the `tool` that holds the head";
                return Err(document.flaw(knot.span(), message, "at the head", Some(help)));
            }
            (None, Some(at), None) => ThreadHold::Place(document.finite("at_m", at)?),
            (Some(id), None, None) => {
                let tool = read_tool(document, id, tools)?;
                if lets_go.is_some() {
                    ThreadHold::Without(tool)
                } else {
                    ThreadHold::Tool(tool)
                }
            }
            _ => {
                let message = "an end of a thread that is held by several things";
                let help = "give one of `tool`, `at_m` and `knot`, or none to let it go";
                return Err(document.flaw(section.span(), message, "held twice", Some(help)));
            }
        };
        if let Some(lets_go) = lets_go
            && (end == ThreadEnd::Tail || !matches!(by, ThreadHold::Without(_)))
        {
            let message = "no tool that lets go of a head or a span";
            let help =
                "name the `tool`; a tail is let go by a hold without `tool`, `at_m` and `knot`";
            return Err(document.flaw(lets_go.span(), message, "nothing to let go", Some(help)));
        }
        holds.push(ThreadHeld { time_s, end, by });
    }
    Ok(holds)
}

/// Hands between the ends of all threads so far, and strands that these and cuts make of them.
#[derive(Default)]
struct Counted {
    hands: usize,
    strands: usize,
}

impl Counted {
    /// Adds a thread that is held and cut so; in how many strands it may come.
    fn add(
        &mut self,
        document: &Document,
        section: &Spanned<ThreadSection>,
        holds: &[ThreadHeld],
        cuts: &[Cut],
    ) -> Result<u8, SceneError> {
        let hands = hands_between(holds);
        let own = 1 + hands + cuts.len();
        self.hands += hands;
        self.strands += own;
        if self.hands > MOST_HANDS {
            let message = format!(
                "{} hands between the ends of threads; at most {MOST_HANDS} are possible",
                self.hands
            );
            let help =
                "let one tool take one span after the other: it lets go of the one that it had";
            return Err(document.flaw(section.span(), message, "held by too many", Some(help)));
        }
        let fits = u8::try_from(own)
            .ok()
            .filter(|_| self.strands <= MAX_STRANDS);
        fits.ok_or_else(|| {
            let message = format!(
                "hands and cuts make {} strands of the threads; at most {MAX_STRANDS} are possible",
                self.strands
            );
            let help =
                "one for each thread, each hand between its ends and each cut: cut it fewer times";
            document.flaw(section.span(), message, "in too many parts", Some(help))
        })
    }
}

/// How many hands hold a thread between its ends, if each that does so at some time did so at once.
fn hands_between(holds: &[ThreadHeld]) -> usize {
    let is_hand = |by: ThreadHold| matches!(by, ThreadHold::Tool(_) | ThreadHold::Place(_));
    let of = |end: ThreadEnd| {
        let holds = holds.iter().filter(move |hold| hold.end == end);
        holds.map(|hold| hold.by).filter(move |by| is_hand(*by))
    };
    let mut hands: Vec<ThreadHold> = Vec::new();
    for by in of(ThreadEnd::Span) {
        if !hands.contains(&by) {
            hands.push(by);
        }
    }
    // The head has one holder at a time.
    hands.len() + usize::from(of(ThreadEnd::Head).next().is_some())
}

fn read_cuts(
    document: &Document,
    sections: &[Spanned<ThreadCutSection>],
    tools: &[Tool],
) -> Result<Vec<Cut>, SceneError> {
    let mut cuts: Vec<Cut> = Vec::with_capacity(sections.len());
    for section in sections {
        let said = section.get_ref();
        let before_s = cuts.last().map_or(0.0, |cut| cut.time_s);
        let time_s = in_order(document, "time_s", &said.time_s, before_s)?;
        let by = match (&said.tool, &said.at_m) {
            (Some(id), None) => CutBy::Tool(read_tool(document, id, tools)?),
            (None, Some(at)) => CutBy::Place(document.finite("at_m", at)?),
            _ => {
                let message = "a cut by nothing, or by two things";
                let help = "give one of `tool` and `at_m`";
                return Err(document.flaw(section.span(), message, "cut by what", Some(help)));
            }
        };
        cuts.push(Cut {
            time_s,
            by,
            knots: said.knots,
        });
    }
    Ok(cuts)
}

/// Id of a grip that is somewhere.
fn read_tool(document: &Document, id: &Spanned<u8>, tools: &[Tool]) -> Result<u8, SceneError> {
    let flaw = |message: String, label: &str, help: &str| {
        Err(document.flaw(id.span(), message, label, Some(help)))
    };
    let Some(found) = tools.iter().find(|tool| tool.id == *id.get_ref()) else {
        let ids: Vec<u8> = tools.iter().map(|tool| tool.id).collect();
        let help = format!("this scene's tools are {ids:?}");
        return flaw(
            format!("there is no tool {}", id.get_ref()),
            "no such tool",
            &help,
        );
    };
    if found.shape.shape != Shape::Grip {
        let message = format!("tool {} is no grip: it cannot hold a thread", found.id);
        return flaw(message, "touches tissue", "make it `shape = \"grip\"`");
    }
    if !found.driven && found.pose.is_none() {
        let message = format!("tool {} is nowhere: it cannot hold a thread", found.id);
        let help = "give it `position_m` or `[[tool.way_point]]`, or let it be driven";
        return flaw(message, "has no place", help);
    }
    Ok(found.id)
}

fn read_tightens(
    document: &Document,
    sections: &[Spanned<ThreadTightenSection>],
    part: &ThreadPart,
    holds: &[ThreadHeld],
) -> Result<Vec<Tighten>, SceneError> {
    let mut list: Vec<Tighten> = Vec::with_capacity(sections.len());
    for section in sections {
        let ThreadTightenSection {
            time_s,
            until_s,
            ratio,
            in_turn,
            most_n,
        } = section.get_ref();
        let before_s = list.last().map_or(0.0, |tighten| tighten.until_s);
        let span = time_s.span();
        let time_s = in_order(document, "time_s", time_s, before_s)?;
        let mut tails = holds.iter().filter(|hold| hold.end == ThreadEnd::Tail);
        let tail = tails.rfind(|hold| hold.time_s <= time_s);
        let is_held = tail.is_some_and(|hold| hold.by != ThreadHold::Free);
        if !(is_held || part.drags()) {
            let id = part.id;
            let message =
                format!("thread {id} is tightened at {time_s} s, and nothing holds its tail then");
            let help = "hands that tighten would draw it out by its tail: hold that before (`[[thread.hold]]` with `end = \"tail\"` and a \
                        `tool`, a place `at_m` or `knot = true`), or let tissue hold the thread back (`drag_n_per_m`)";
            return Err(document.flaw(span, message, "its tail is free", Some(help)));
        }
        let until_s = in_order(document, "until_s", until_s, time_s)?;
        let help = "what is left of the length: 0 draws the punctures together, 1 changes nothing";
        let sound = |v: f64| (0.0..=1.0).contains(&v);
        let ratio = document.number("ratio", ratio, "from 0 to 1", sound, help)?;
        let most_n = most_n.as_ref().map_or(Ok(f64::INFINITY), |most_n| {
            let help = "in newtons: a surgeon draws stitches of tissue together with 0.2 to 2";
            document.number("most_n", most_n, "above zero", |v| v > 0.0, help)
        })?;
        list.push(Tighten {
            time_s,
            until_s,
            ratio,
            in_turn: *in_turn,
            most_n,
        });
    }
    Ok(list)
}

fn in_order(
    document: &Document,
    key: &str,
    value: &Spanned<f64>,
    before_s: f64,
) -> Result<f64, SceneError> {
    let rule = format!("at least {before_s}, the time before it");
    let help = "times are counted from the start of the session and do not go back";
    document.number(key, value, &rule, |t| t >= before_s, help)
}

/// A warning for each grip that never holds a needle or a thread, carries no jaws and has no body.
pub(super) fn idle_grips(
    document: &Document,
    (tools, sections): (&[Tool], &[Spanned<ToolSection>]),
    (needles, threads): (&[Needle], &[Thread]),
    jaws: &[Jaws],
) -> Vec<Flaw> {
    let holds = |tool: &Tool| {
        let by = ThreadHold::Tool(tool.id);
        let needle = |needle: &Needle| needle.holds.iter().any(|hold| hold.tool == Some(tool.id));
        let thread = |thread: &Thread| {
            let cut = CutBy::Tool(tool.id);
            thread.holds.iter().any(|hold| hold.by == by)
                || thread.cuts.iter().any(|one| one.by == cut)
        };
        let carries = tool.body.is_some() || jaws.iter().any(|jaws| jaws.part.tool == tool.id);
        needles.iter().any(needle) || threads.iter().any(thread) || carries
    };
    let idle = |(tool, _): &(&Tool, _)| tool.shape.shape == Shape::Grip && !holds(tool);
    let warn = |(tool, section): (&Tool, &Spanned<ToolSection>)| {
        let message = format!(
            "tool {} is a grip that holds no needle and no thread",
            tool.id
        );
        let help = "name it in a `[[needle.hold]]` or `[[thread.hold]]`, give it `[[jaws]]`, or leave the tool out";
        document.warning(section.span(), &message, "does nothing", help)
    };
    tools.iter().zip(sections).filter(idle).map(warn).collect()
}
