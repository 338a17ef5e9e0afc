//! The parts of a scene with a model that tools stick to: few, as nothing is prepared.
//!
//! Entry point: [`explain`].

use super::{Component, console, geometry, hand_path, loads, materials_of, pieces, timed};
use sutura_host::scene::{Registered, Scene};
use sutura_host::session::SceneSolver;
use sutura_host::solve::SolveError;
use sutura_host::step::StepReport;

/// Builds the scene, follows its hand in pieces, and lists its parts.
pub(super) fn explain(scene: &Scene, model: Registered) -> Result<Vec<Component>, SolveError> {
    let mut parts = geometry(scene);
    let (solver, took) = timed(|| SceneSolver::new(scene));
    let mut solver = solver?;
    let why = format!("`[tissue] model`, with the setting \"{}\"", model.setting());
    let name = format!("{} tissue", model.name());
    parts.push(Component::built(name, why).takes(Some(took), "once"));
    parts.push(materials_of(scene));

    let hand = hand_path(scene);
    let driven = solver.driven();
    let walk = driven.map_or_else(Vec::new, |id| pieces(&mut solver, id, &hand));
    let nodes = |report: &StepReport| report.contacts().first().map_or(0, |own| own.rows);
    let in_contact = walk.iter().filter(|(report, _)| nodes(report) > 0);
    let most_nodes = in_contact.clone().map(|(report, _)| nodes(report)).max();
    let most_nodes = most_nodes.unwrap_or(0);
    let mut touching: Vec<_> = in_contact.map(|(_, took)| *took).collect();
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
