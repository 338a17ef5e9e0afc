//! Many scenarios: each as it is, and once more without the guard that it is about, which must be noticed.
//!
//! Entry point: [`Case::run`]. What a suite needs of a kind of console is a [`Bench`].

use super::host::HostError;
use super::peer::{Peer, PeerError, native};
use super::run::{Hosts, Outcome, RunError, run};
use super::{ConsoleKind, Scenario, Ticks};
use crate::scenario::host::ModelHost;
use sutura_shared::simulated_console::Without;

/// How a kind of console is started, and the hosts to go with it.
pub trait Bench: Sync {
    /// Which kind.
    fn kind(&self) -> ConsoleKind;

    /// A console that has just booted, without the guards of these names.
    ///
    /// # Errors
    /// When there is none.
    fn console(&self, off: &[String]) -> Result<Box<dyn Peer + '_>, PeerError>;

    /// Whether guards can be switched off in it.
    fn has_mutants(&self) -> bool {
        true
    }

    /// Whether the console has motors, as far as that is known.
    fn has_motors(&self) -> bool {
        false
    }

    /// The hosts of a scenario.
    fn hosts(&self) -> Box<Hosts<'_>> {
        Box::new(|scenario, generation, arms| {
            let host: Result<_, HostError> = ModelHost::new(scenario, generation, arms);
            Ok(Box::new(host?))
        })
    }
}

/// The shared simulation in this process.
pub struct Native;

impl Bench for Native {
    fn kind(&self) -> ConsoleKind {
        ConsoleKind::Native
    }

    fn console(&self, off: &[String]) -> Result<Box<dyn Peer + '_>, PeerError> {
        let mut without = Without::default();
        for name in off {
            without.switch_off(name);
        }
        Ok(Box::new(native(without)?))
    }
}

/// What became of a scenario.
#[derive(Debug)]
pub enum Verdict {
    /// It ran.
    Ran(Outcome),
    /// It is not for this console.
    Skipped(&'static str),
    /// It did not run to its end.
    Broken(RunError),
}

/// What became of a mutant.
#[derive(Debug)]
pub enum MutantVerdict {
    /// These expectations were not met, as must be.
    Caught(Vec<String>),
    /// It passed for the real thing: the scenario does not show what its guard is for.
    Survived,
    /// There is none, or it was not asked for.
    Skipped,
    /// It did not run to its end.
    Broken(RunError),
}

/// A scenario and what became of it.
#[derive(Debug)]
pub struct Case {
    /// Its name.
    pub name: String,
    /// What it shows.
    pub about: String,
    /// What is off in the mutant.
    pub off: Vec<String>,
    /// As it is.
    pub verdict: Verdict,
    /// Whether a second run gave the same bits; none where time is the clock's.
    pub repeats: Option<bool>,
    /// Without the guard.
    pub mutant: MutantVerdict,
}

/// What a suite does beside running each scenario once.
#[derive(Clone, Copy, Debug)]
pub struct Extent {
    /// Run the mutants.
    pub mutants: bool,
    /// Run everything in lockstep twice and compare.
    pub twice: bool,
}

impl Case {
    /// Runs a scenario and its mutant.
    pub fn run(scenario: &Scenario, bench: &dyn Bench, extent: Extent) -> Case {
        let mut case = Case {
            name: scenario.name.clone(),
            about: scenario.about.clone(),
            off: scenario.mutant.clone(),
            verdict: Verdict::Skipped(""),
            repeats: None,
            mutant: MutantVerdict::Skipped,
        };
        if let Some(reason) = unfit(scenario, bench) {
            case.verdict = Verdict::Skipped(reason);
            return case;
        }
        let lockstep = matches!(bench.kind(), ConsoleKind::Native | ConsoleKind::Qemu);
        match once(scenario, bench, &[], Outcome::is_met) {
            Ok(outcome) => {
                if extent.twice && lockstep {
                    let again = once(scenario, bench, &[], Outcome::is_met);
                    case.repeats = Some(again.is_ok_and(|again| again.hash == outcome.hash));
                }
                case.verdict = Verdict::Ran(outcome);
            }
            Err(error) => case.verdict = Verdict::Broken(error),
        }
        if extent.mutants && bench.has_mutants() && !scenario.mutant.is_empty() {
            case.mutant = match once(scenario, bench, &scenario.mutant, |o| !o.is_met()) {
                Ok(outcome) => {
                    let unmet = outcome.checks.iter().filter(|check| !check.met);
                    let unmet: Vec<_> = unmet
                        .map(|check| format!("{}: {}", check.what, check.found))
                        .collect();
                    if unmet.is_empty() {
                        MutantVerdict::Survived
                    } else {
                        MutantVerdict::Caught(unmet)
                    }
                }
                Err(error) => MutantVerdict::Broken(error),
            };
        }
        case
    }

    /// Whether everything was as it must be.
    pub fn is_met(&self) -> bool {
        let scenario = match &self.verdict {
            Verdict::Ran(outcome) => outcome.is_met(),
            Verdict::Skipped(_) => true,
            Verdict::Broken(_) => false,
        };
        let mutant = matches!(
            self.mutant,
            MutantVerdict::Caught(_) | MutantVerdict::Skipped
        );
        scenario && mutant && self.repeats != Some(false)
    }
}

/// How often a run is repeated that the machine held up.
const ATTEMPTS: usize = 4;
/// A host of 100 Hz whose machine lets nobody go on for so long loses its contact \[ticks\].
const HELD_UP: Ticks = 15;

/// One run. By the wall clock, one in which the machine held up console or bench measures the machine: it is repeated, if
/// its outcome is not `wanted`.
fn once(
    scenario: &Scenario,
    bench: &dyn Bench,
    off: &[String],
    wanted: fn(&Outcome) -> bool,
) -> Result<Outcome, RunError> {
    let mut attempt = 1;
    loop {
        let mut console = bench.console(off)?;
        let mut hosts = bench.hosts();
        let outcome = run(scenario, console.as_mut(), hosts.as_mut())?;
        let held_up = outcome.held_up;
        if wanted(&outcome) || held_up < HELD_UP || attempt == ATTEMPTS {
            return Ok(outcome);
        }
        tracing::warn!(
            "{}: held up for {held_up} ms by this machine; once more",
            scenario.name
        );
        attempt += 1;
    }
}

/// Why a scenario is not for this console.
fn unfit(scenario: &Scenario, bench: &dyn Bench) -> Option<&'static str> {
    if !scenario.consoles.contains(&bench.kind()) {
        return Some("not for this kind of console");
    }
    if bench.has_motors()
        && let Some(reason) = scenario.needs_simulation()
    {
        return Some(reason);
    }
    let resets = |fault: &super::Fault| matches!(fault.kind, super::FaultKind::ConsoleReset);
    let by_hand = bench.kind() == ConsoleKind::Port && scenario.faults.iter().any(resets);
    by_hand.then_some("a console at a port is reset by hand")
}
