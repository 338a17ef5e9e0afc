//! The parts of a scene with a model that tools stick to: few, as nothing is prepared.
//!
//! Entry point: [`explain`].

use super::{
    Component, LONGEST, MOST_WAY_STEPS, PIECE_STEPS, PIECES, console, geometry, hand_path, loads,
    materials_of, on_path, timed,
};
use crate::scene::{Registered, Scene};
use crate::session::SceneSolver;
use crate::solve::SolveError;
use crate::step::Status;
use std::time::Instant;

/// Builds the scene, follows its hand in pieces, and lists its parts.
pub(super) fn explain(scene: &Scene, model: Registered) -> Result<Vec<Component>, SolveError> {
    let mut parts = geometry(scene);
    let (solver, took) = timed(|| SceneSolver::new(scene));
    let mut solver = solver?;
    let why = format!("`[tissue] model`, with the setting \"{}\"", model.setting());
    let name = format!("{} tissue", model.name());
    parts.push(Component::built(name, why).takes(Some(took), "once"));
    parts.push(materials_of(scene));

    let mut touching = Vec::new();
    let mut most_nodes = 0;
    let hand = hand_path(scene);
    let began = Instant::now();
    for piece in 0..PIECES {
        let first = piece * hand.len() / PIECES;
        let end = (piece + 1) * hand.len() / PIECES;
        let places = hand
            .get(first..end.min(first + PIECE_STEPS))
            .unwrap_or_default();
        let (Some(id), Some(start)) = (solver.driven(), places.first()) else {
            continue;
        };
        for _ in 0..MOST_WAY_STEPS {
            let report = solver.step(on_path(id, start));
            if report.status == Status::Ok || began.elapsed() > LONGEST {
                break;
            }
        }
        for at in places {
            if began.elapsed() > LONGEST {
                break;
            }
            let ((status, nodes), took) = timed(|| {
                let report = solver.step(on_path(id, at));
                let own = report.contacts().first();
                (report.status, own.map_or(0, |contact| contact.rows))
            });
            if status == Status::Ok && nodes > 0 {
                touching.push(took);
                most_nodes = most_nodes.max(nodes);
            }
        }
    }
    touching.sort();
    let why = match touching.last() {
        Some(slowest) => format!(
            "`[[tool]]`: {most_nodes} nodes stick to the driven tool at most; median of {} steps in contact with their \
             tangent, slowest {:.0} us",
            touching.len(),
            1e6 * slowest.as_secs_f64()
        ),
        None => "`[[tool]]`: no step in contact was followed".to_owned(),
    };
    let median = touching.get(touching.len() / 2).copied();
    parts.push(Component::built("step", why).takes(median, "step"));
    parts.push(loads(scene));
    for (name, why) in [
        (
            "compliance columns",
            "contacts are not reduced to rows: tools stick to nodes",
        ),
        ("needle", "this model does not take needles"),
        ("handles", "this model does not take handles"),
    ] {
        parts.push(Component::absent(name, why));
    }
    parts.extend(console(scene));
    Ok(parts)
}
