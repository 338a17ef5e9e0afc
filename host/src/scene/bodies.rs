//! `[[body_contact]]`: which threads may lie on which bodies of grips and needles.
//!
//! Entry point: [`read_body_contacts`].

use super::document::{Document, SceneError};
use super::threads::Thread;
use super::{Needle, Tool};
use crate::thread::{ThreadBody, ThreadContact};
use sutura_scene_file::wound::{BodyContactSection, BodyName};
use toml::Spanned;

/// The pairs, in the order of the sections.
///
/// # Errors
/// A flaw at what is not there or has no body, at two threads or two bodies, at a pair that is there already.
pub(super) fn read_body_contacts(
    document: &Document,
    sections: &[Spanned<BodyContactSection>],
    (threads, needles, tools): (&[Thread], &[Needle], &[Tool]),
) -> Result<Vec<ThreadContact>, SceneError> {
    let mut contacts: Vec<ThreadContact> = Vec::with_capacity(sections.len());
    for section in sections {
        let [first, second] = &section.get_ref().between;
        let (thread, body) = match (first.get_ref(), second.get_ref()) {
            (BodyName::Thread(_), BodyName::Thread(_)) => {
                let message = "two threads: they do not lie on each other";
                let help = "name a thread and a body: `between = [{ thread = 0 }, { tool = 1 }]`";
                return Err(document.flaw(second.span(), message, "no body", Some(help)));
            }
            (BodyName::Thread(thread), _) => ((first, *thread), second),
            (_, BodyName::Thread(thread)) => ((second, *thread), first),
            _ => {
                let message = "no thread: bodies of grips and needles do not press on each other";
                let help = "name a thread and a body: `between = [{ thread = 0 }, { tool = 1 }]`";
                return Err(document.flaw(second.span(), message, "another body", Some(help)));
            }
        };
        let (place, thread) = thread;
        if threads.iter().all(|other| other.part.id != thread) {
            let message = format!("there is no thread {thread}");
            let ids: Vec<u8> = threads.iter().map(|thread| thread.part.id).collect();
            let help = format!("this scene's threads are {ids:?}");
            return Err(document.flaw(place.span(), message, "no such thread", Some(&help)));
        }
        let with = read_body(document, body, (needles, tools))?;
        let contact = ThreadContact { thread, with };
        if contacts.contains(&contact) {
            let message = format!("thread {thread} is to lie on this twice");
            let help = "leave one of the two sections out";
            return Err(document.flaw(section.span(), message, "the second", Some(help)));
        }
        contacts.push(contact);
    }
    Ok(contacts)
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
                let message = format!("needle {id} has no body that a thread could lie on");
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
                let message = format!("tool {id} has no body that a thread could lie on");
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
