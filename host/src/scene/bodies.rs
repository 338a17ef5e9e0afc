//! `[[body_contact]]`: which threads may lie on which bodies of grips and needles, and which of these press on each other.
//!
//! Entry points: [`read_body_contacts`], [`idle_pairs`].

use super::document::{Document, Flaw, SceneError};
use super::threads::Thread;
use super::{Needle, Tool};
use crate::rod::{BodyContact, STIFFEST_PAIR_N_PER_M};
use crate::thread::{ThreadBody, ThreadContact};
use crate::tool::MOST_FRICTION;
use sutura_scene_file::wound::{BodyContactSection, BodyName};
use toml::Spanned;

/// N/m of a pair that says nothing: two thirds of what a console renders stably at 200 frames a second (`docs/src/fidelity.md`, stability),
/// so that tissue under one of the two has room beside it.
const STIFFNESS_N_PER_M: f64 = 1000.0;

/// What a scene has of threads, needles and tools.
type Parts<'a> = (&'a [Thread], &'a [Needle], &'a [Tool]);

/// What is named: threads on bodies, and bodies that press on each other, both in the order of the sections.
///
/// # Errors
/// A flaw at what is not there or has no body, at two threads or two needles, at a pair that is there already, at a number out of range,
/// and at one that a thread has no use for.
pub(super) fn read_body_contacts(
    document: &Document,
    sections: &[Spanned<BodyContactSection>],
    bodies: Parts,
) -> Result<(Vec<ThreadContact>, Vec<BodyContact>), SceneError> {
    let (mut laps, mut pairs) = (Vec::new(), Vec::new());
    for section in sections {
        let [first, second] = &section.get_ref().between;
        match (first.get_ref(), second.get_ref()) {
            (BodyName::Thread(_), BodyName::Thread(_)) => {
                let message = "two threads: they do not lie on each other";
                let help = "name a thread and a body: `between = [{ thread = 0 }, { tool = 1 }]`";
                return Err(document.flaw(second.span(), message, "no body", Some(help)));
            }
            (BodyName::Thread(thread), _) => {
                let lap = read_lap(document, section, (first, *thread), (second, bodies), &laps)?;
                laps.push(lap);
            }
            (_, BodyName::Thread(thread)) => {
                let lap = read_lap(document, section, (second, *thread), (first, bodies), &laps)?;
                laps.push(lap);
            }
            _ => pairs.push(read_pair(document, section, (bodies.1, bodies.2), &pairs)?),
        }
    }
    Ok((laps, pairs))
}

/// A warning for each needle that a body is to press on while its own tool holds it: nothing of that is felt.
pub(super) fn idle_pairs(
    document: &Document,
    sections: &[Spanned<BodyContactSection>],
    needles: &[Needle],
) -> Vec<Flaw> {
    let idle = |section: &Spanned<BodyContactSection>| {
        let [first, second] = section.get_ref().between.each_ref();
        let (needle, tool) = match (first.get_ref(), second.get_ref()) {
            (BodyName::Needle(needle), BodyName::Tool(tool))
            | (BodyName::Tool(tool), BodyName::Needle(needle)) => (*needle, *tool),
            _ => return None,
        };
        let holds = &needles.iter().find(|other| other.id == needle)?.holds;
        let hold = holds.iter().find(|hold| hold.tool == Some(tool))?;
        let message = format!(
            "from {} s on tool {tool} itself holds needle {needle}: its body does not press on that meanwhile",
            hold.time_s
        );
        let help = "a needle is pressed on while another tool holds it, or none";
        Some(document.warning(section.span(), &message, "not all the time", help))
    };
    sections.iter().filter_map(idle).collect()
}

/// A thread and a body that it lies on, beside those that are known.
fn read_lap(
    document: &Document,
    section: &Spanned<BodyContactSection>,
    (place, thread): (&Spanned<BodyName>, u8),
    (body, (threads, needles, tools)): (&Spanned<BodyName>, Parts),
    known: &[ThreadContact],
) -> Result<ThreadContact, SceneError> {
    if threads.iter().all(|other| other.part.id != thread) {
        let message = format!("there is no thread {thread}");
        let ids: Vec<u8> = threads.iter().map(|thread| thread.part.id).collect();
        let help = format!("this scene's threads are {ids:?}");
        return Err(document.flaw(place.span(), message, "no such thread", Some(&help)));
    }
    let said = section.get_ref();
    let numbers = [
        ("stiffness_n_per_m", &said.stiffness_n_per_m),
        ("friction", &said.friction),
    ];
    for (key, value) in numbers {
        if let Some(value) = value {
            let message = format!("a thread slides on a body: `{key}` has no use here");
            let help = "leave it out, or name two bodies";
            return Err(document.flaw(value.span(), message, "of two bodies", Some(help)));
        }
    }
    let with = read_body(document, body, (needles, tools))?;
    let contact = ThreadContact { thread, with };
    if known.contains(&contact) {
        let message = format!("thread {thread} is to lie on this twice");
        let help = "leave one of the two sections out";
        return Err(document.flaw(section.span(), message, "the second", Some(help)));
    }
    Ok(contact)
}

/// Two bodies that press on each other, beside those that are known.
fn read_pair(
    document: &Document,
    section: &Spanned<BodyContactSection>,
    bodies: (&[Needle], &[Tool]),
    known: &[BodyContact],
) -> Result<BodyContact, SceneError> {
    let said = section.get_ref();
    let [first, second] = &said.between;
    let between = [
        read_body(document, first, bodies)?,
        read_body(document, second, bodies)?,
    ];
    let [one, other] = between;
    if one == other {
        let message = "a body does not press on itself";
        let help = "name two: `between = [{ tool = 0 }, { tool = 1 }]`";
        return Err(document.flaw(second.span(), message, "the same", Some(help)));
    }
    if let (ThreadBody::Needle(_), ThreadBody::Needle(_)) = (one, other) {
        let message = "two needles: they go through each other";
        let help = "name the body of a grip: `between = [{ tool = 0 }, { needle = 0 }]`";
        return Err(document.flaw(second.span(), message, "another needle", Some(help)));
    }
    if known
        .iter()
        .any(|pair| pair.between.contains(&one) && pair.between.contains(&other))
    {
        let message = "these two are to press on each other twice";
        let help = "leave one of the two sections out";
        return Err(document.flaw(section.span(), message, "the second", Some(help)));
    }
    let check = |key: &str, value: &Option<Spanned<f64>>, (least, most): (f64, f64)| {
        let Some(value) = value else { return Ok(None) };
        let given = *value.get_ref();
        if given >= least && given <= most {
            return Ok(Some(given));
        }
        let message = format!("`{key}` is {given}; it must be from {least} to {most}");
        let help = format!("take one within, or leave `{key}` out");
        Err(document.flaw(value.span(), message, "out of range", Some(&help)))
    };
    let stiff = (1.0, STIFFEST_PAIR_N_PER_M);
    let stiffness = check("stiffness_n_per_m", &said.stiffness_n_per_m, stiff)?;
    let friction = check("friction", &said.friction, (0.0, MOST_FRICTION))?;
    Ok(BodyContact {
        between,
        stiffness_n_per_m: stiffness.unwrap_or(STIFFNESS_N_PER_M),
        friction: friction.unwrap_or(0.0),
    })
}

/// A body that is there.
fn read_body(
    document: &Document,
    name: &Spanned<BodyName>,
    (needles, tools): (&[Needle], &[Tool]),
) -> Result<ThreadBody, SceneError> {
    let flaw = |message: String, label: &str, help: &str| {
        Err(document.flaw(name.span(), message, label, Some(help)))
    };
    match *name.get_ref() {
        BodyName::Needle(id) => match needles.iter().find(|needle| needle.id == id) {
            None => {
                let ids: Vec<u8> = needles.iter().map(|needle| needle.id).collect();
                let help = format!("this scene's needles are {ids:?}");
                flaw(format!("there is no needle {id}"), "no such needle", &help)
            }
            Some(needle) if !needle.body => {
                let message = format!("needle {id} has no body");
                flaw(message, "no body", "add `body = true` to that `[[needle]]`")
            }
            Some(_) => Ok(ThreadBody::Needle(id)),
        },
        BodyName::Tool(id) => match tools.iter().find(|tool| tool.id == id) {
            None => {
                let ids: Vec<u8> = tools.iter().map(|tool| tool.id).collect();
                let help = format!("this scene's tools are {ids:?}");
                flaw(format!("there is no tool {id}"), "no such tool", &help)
            }
            Some(tool) if tool.body.is_none() => {
                let message = format!("tool {id} has no body");
                let help = "add `body = { radius_m = 0.002, length_m = 0.05 }` to that `[[tool]]`, which has to be a grip";
                flaw(message, "no body", help)
            }
            Some(_) => Ok(ThreadBody::Grip(id)),
        },
        BodyName::Thread(id) => {
            let help = "name a thread and a body: `between = [{ thread = 0 }, { tool = 1 }]`";
            flaw(format!("thread {id} is no body"), "no body", help)
        }
    }
}
