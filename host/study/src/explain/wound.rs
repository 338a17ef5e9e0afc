//! What a scene builds for threads and for tissues that touch.

use super::Component;
use std::time::Duration;
use sutura_host::scene::Scene;
use sutura_host::step::StepReport;
use sutura_host::thread::ThreadPart;

/// A component for each thread, or one that says that there is none.
pub(super) fn threads(scene: &Scene, walk: &[(StepReport, Duration)]) -> Vec<Component> {
    if scene.threads.is_empty() {
        return vec![Component::absent(
            "thread",
            "no `[[thread]]`: no thread rows",
        )];
    }
    let thread = |(index, thread): (usize, &sutura_host::scene::Thread)| {
        let reports = walk
            .iter()
            .filter_map(|(step, _)| step.threads().get(index));
        let punctures = reports.map(|report| report.punctures).max();
        let why = match punctures {
            Some(punctures) => format!(
                "`[[thread]]`: {:.0} mm long, through {punctures} boundaries at most along the scripts; {}",
                1e3 * thread.part.length_m,
                rows(&thread.part)
            ),
            None => "`[[thread]]`; no `[hand]` to follow here".to_owned(),
        };
        Component::built(format!("thread {}", thread.part.id), why)
    };
    scene.threads.iter().enumerate().map(thread).collect()
}

/// What rows a thread has.
fn rows(part: &ThreadPart) -> String {
    let through = part.through;
    let mut said =
        "one row for its length outside and inside, others across each piece of it".to_owned();
    if part.friction > 0.0 || through.drag_n_per_m > 0.0 {
        said += ", one for the friction of each passage through tissue";
    }
    let limits = [
        (through.axial_stiffness_n, "stretches with EA"),
        (through.grip_n, "slips through a grip at"),
        (part.strength_n, "breaks at"),
    ];
    for (value, what) in limits {
        if value.is_finite() {
            said += &format!("; {what} {value} N");
        }
    }
    said
}

/// A component for each pair of parts that may touch, or one that says that there is none.
pub(super) fn touching(scene: &Scene, walk: &[(StepReport, Duration)]) -> Vec<Component> {
    if scene.touching.is_empty() {
        let why = "no `[[tissue_contact]]`: parts of the mesh go through each other and through themselves";
        return vec![Component::absent("contact of tissues", why)];
    }
    let pressing = walk.iter().map(|(step, _)| step.touching).max();
    let pair = |pair: &sutura_host::scene::TissueContact| {
        let [first, second] = &pair.between;
        let [a, b] = [0, 1].map(|side: usize| pair.faces[side].len());
        let why = match pressing {
            Some(most) => format!(
                "`[[tissue_contact]]`: {a} and {b} faces; {most} pairs of features press at most along the scripts"
            ),
            None => format!("`[[tissue_contact]]`: {a} and {b} faces"),
        };
        Component::built(format!("contact of {first} and {second}"), why)
    };
    scene.touching.iter().map(pair).collect()
}

/// A component for each thread and body that it may lie on, or one that says that there is none.
pub(super) fn body_contacts(scene: &Scene, walk: &[(StepReport, Duration)]) -> Vec<Component> {
    if scene.body_contacts.is_empty() && scene.body_pairs.is_empty() {
        let why = "no `[[body_contact]]`: threads, grips and needles go through each other";
        return vec![Component::absent("threads on bodies", why)];
    }
    let each = scene.body_contacts.iter().map(|contact| {
        let own = walk.iter().flat_map(|(step, _)| step.threads());
        let own = own.filter(|report| report.id == contact.thread);
        let why = "`[[body_contact]]`: three rows across the two straight pieces beside it";
        let why = match own.map(|report| report.laps).max() {
            Some(most) => {
                format!("{why}; its spans lie on {most} bodies at most along the scripts")
            }
            None => why.to_owned(),
        };
        Component::built(
            format!("thread {} on {}", contact.thread, contact.with),
            why,
        )
    });
    let pairs = scene.body_pairs.iter().map(|pair| {
        let [one, other] = pair.between;
        let (stiff, friction) = (pair.stiffness_n_per_m, pair.friction);
        let why = format!(
            "`[[body_contact]]`: {stiff} N/m, friction {friction}; hands have both, no rows"
        );
        Component::built(format!("{one} on {other}"), why)
    });
    each.chain(pairs).collect()
}
