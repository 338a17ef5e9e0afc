//! What each guard of the console, and each of the host's mendings, is for: the bars that fail without it.
//!
//! Entry point: [`mutants`].

use super::bars::{Bar, bars};
use super::case::{Case, Scenes, Spec};
use super::corners;
use super::suite::{Extent, core, first_stalls, measure};
use super::switches::Switch;
use super::trials;
use schemars::JsonSchema;
use serde::Serialize;
use std::ops::ControlFlow;
use sutura_shared::control::Guards;
use sutura_shared::device::DeviceError;

/// What a switch is for: the bars that fail without it and not with it.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Mutant {
    /// What is off.
    pub guard: &'static str,
    /// What fails then, with its value; should be some.
    pub fails: Vec<Bar>,
}

/// What is run with each of them off: the short form.
pub fn specs() -> Vec<Spec> {
    let mut specs = core(Extent::Short, Guards::ALL);
    specs.extend(trials::known_worst());
    specs.extend(first_stalls());
    // What a description that is wrong costs.
    specs.extend(corners::known_worst());
    specs
}

/// Each switch off in turn; those that were tried when `done` has said not to go on.
///
/// # Errors
/// Mechanics that make no valid device.
pub fn mutants(
    scenes: &Scenes,
    threads: usize,
    done: &(dyn Fn(usize, &Case) -> ControlFlow<()> + Sync),
) -> Result<Vec<Mutant>, DeviceError> {
    let all = specs();
    let mut mutants = Vec::new();
    let cases = measure(&all, scenes, threads, done)?;
    if cases.len() < all.len() {
        return Ok(mutants);
    }
    let with_all = bars(&cases);
    for (index, switch) in Switch::all().into_iter().enumerate() {
        let specs: Vec<Spec> = all.iter().map(|spec| spec.without(switch)).collect();
        let told = |n: usize, case: &Case| done((index + 1) * all.len() + n, case);
        let cases = measure(&specs, scenes, threads, &told)?;
        if cases.len() < specs.len() {
            break;
        }
        let found = bars(&cases);
        let met = |bar: &&Bar| with_all.iter().any(|with| with.name == bar.name && with.ok);
        let fails = found.iter().filter(|bar| !bar.ok).filter(met);
        mutants.push(Mutant {
            guard: switch.name(),
            fails: fails.cloned().collect(),
        });
    }
    Ok(mutants)
}
