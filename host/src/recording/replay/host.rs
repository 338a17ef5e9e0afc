//! The solver's steps of a recording, run again.
//!
//! Entry point: [`replay_host`]. The same solver takes the recorded states in the recorded order; after every step the hash of
//! its state must be the recorded one. Another build, or other instructions, round otherwise: then the forces are compared.

use super::super::about::Begins;
use super::super::read::Recording;
use super::super::samples::SolveSample;
use super::sessions::{Session, parse, sessions};
use crate::link::Felt;
use crate::session::{Plan, SceneSolver, Solve, Solved};
use crate::work;
use std::collections::HashMap;
use std::ops::ControlFlow;
use std::time::Instant;
use sutura_shared::control::TICK_HZ;
use sutura_shared::wire::message::{Contact, State};
use sutura_shared::wire::{Checked, Valid};

/// Largest difference of a force or moment that other rounding may make, over the largest of the session.
const WITHIN: f64 = 1e-9;

/// What the replay of a solver came to.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct HostVerdict {
    /// Solves in the recording.
    pub steps: u64,
    /// Those that were run again and came out the same.
    pub verified_steps: u64,
    /// Whether all of those have the same bits; otherwise they are the same to `WITHIN`.
    pub identical: bool,
    /// Largest difference of an entry of a wrench, over the largest of the session so far.
    pub largest_difference: f64,
    /// Contacts of a session whose beginning is not in the recording that went down as they had been solved.
    pub contacts: u64,
    /// The first solve that came out differently, from 1.
    pub diverged_step: Option<u64>,
    /// The console's tick that it was for.
    pub diverged_at: Option<u32>,
    /// The first solve that cannot be run again.
    pub unverifiable_from: Option<u64>,
    /// Why, of any of these.
    pub why: Option<String>,
    /// Hash of the solver's state after the last solve.
    pub hash: u64,
}

/// Runs the solver's steps again, up to the first that differs. `same_bits`: the solver is the same build, on a machine with
/// the same instructions. `seen` is shown the solver after each, and what the solve came to, with its times on the wall here.
///
/// ```
/// use std::ops::ControlFlow;
/// use sutura_host::link::{LinkError, LockstepConsole};
/// use sutura_host::recording::replay::replay_host;
/// use sutura_host::recording::{About, Recorder, Recording, TappedConsole, TappedSolver};
/// use sutura_host::scene::{Document, read};
/// use sutura_host::session::{LINE_BYTES_PER_S, Plan, Rendering, SceneSolver, run_lockstep};
/// use sutura_shared::simulated_console::SimulatedConsole;
/// use sutura_shared::wire::message::Fixture;
///
/// /// A tick for each exchange.
/// struct Console(SimulatedConsole);
///
/// impl LockstepConsole for Console {
///     fn exchange(&mut self, down: &[u8], up: &mut Vec<u8>) -> Result<(), LinkError> {
///         self.0.feed(down);
///         self.0.tick(Default::default());
///         self.0.drain(up);
///         Ok(())
///     }
///     fn name(&self) -> &str {
///         "simulated"
///     }
/// }
///
/// let document = Document::embedded("slab.toml", "".as_ref(), r#"
///     name = "slab"
///     device = "cartesian-bench"
///     [mesh.slab]
///     size_m = [0.08, 0.08, 0.03]
///     divisions = [8, 8, 3]
///     [tissue]
///     model = "linear"
///     youngs_modulus_pa = 15e3
///     poisson_ratio = 0.45
///     [[fixed]]
///     plane = { axis = "z", at_m = -0.03 }
///     [[tool]]
///     radius_m = 0.014
///     [hand]
///     stiffness_n_per_m = 1000.0
///     damping_n_s_per_m = 10.0
///     [[hand.way_point]]
///     time_s = 0.0
///     position_m = [0.0, 0.0, 0.016]
///     [[hand.way_point]]
///     time_s = 0.4
///     position_m = [0.0, 0.0, 0.010]
/// "#);
/// let scene = read(&document)?;
/// let plan = Plan {
///     device: scene.device.ok_or("a device")?.description,
///     hand: scene.hand.ok_or("a hand")?,
///     host_hz: 50.0,
///     seconds: 0.5,
///     tick_hz: 1000,
///     state_every: 1,
///     rendering: Rendering::Tangent,
///     line_bytes_per_s: LINE_BYTES_PER_S,
///     horizon_us: None,
///     clear_fault: false,
///     fixture: Fixture::None,
/// };
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("session.mcap");
/// let about = About {
///     lockstep: true,
///     ..About::here("example".to_owned(), &plan, scene.tissue.word())
/// };
/// let recorder = Recorder::start(Some(&path), about, document.sources())?;
/// let mut console = Console(SimulatedConsole::new(&plan.device, 0)?);
/// let mut solver = SceneSolver::for_session(&scene, &plan)?;
/// let summary = run_lockstep(
///     &mut TappedConsole::new(&mut console, recorder.tap()),
///     &plan,
///     &mut TappedSolver::new(&mut solver, recorder.tap()),
///     |_| ControlFlow::Continue(()),
/// )?;
/// assert_eq!(summary.status, "ok");
/// recorder.finish()?;
///
/// // Another solver of the scene in the file finds the same, to the bit.
/// let recording = Recording::read(&path)?;
/// let scene = read(&Document::from_sources(&recording.sources))?;
/// let mut again = SceneSolver::for_session(&scene, &recording.about.plan)?;
/// let mut lowest_m = 0.0f64;
/// let verdict = replay_host(&recording, &mut again, true, |solver, _| {
///     let heights = solver.positions_m().iter().map(|at| at[2] + 0.03).fold(f64::INFINITY, f64::min);
///     lowest_m = lowest_m.min(heights);
/// });
/// assert!(verdict.identical && verdict.diverged_step.is_none(), "{verdict:?}");
/// assert_eq!(verdict.verified_steps, recording.solves.len() as u64);
/// // The hand pressed: the last solve pushes the tool upwards. The table lets nothing through.
/// let (_, last) = recording.solves.last().ok_or("a solve")?;
/// assert!(last.wrench.is_some_and(|wrench| wrench[2] > 0.0));
/// assert!(lowest_m > -1e-9);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn replay_host(
    recording: &Recording,
    solver: &mut SceneSolver,
    same_bits: bool,
    mut seen: impl FnMut(&SceneSolver, &SolveSample),
) -> HostVerdict {
    replay_host_while(recording, solver, same_bits, |solver, here| {
        seen(solver, here);
        ControlFlow::Continue(())
    })
}

/// As [`replay_host`], until `seen` has seen enough: the verdict is then of the steps up to there.
pub fn replay_host_while(
    recording: &Recording,
    solver: &mut SceneSolver,
    same_bits: bool,
    mut seen: impl FnMut(&SceneSolver, &SolveSample) -> ControlFlow<()>,
) -> HostVerdict {
    if recording.about.begins == Begins::Later {
        return compare_contacts(recording);
    }
    let mut verdict = HostVerdict {
        steps: recording.solves.len() as u64,
        identical: true,
        ..HostVerdict::default()
    };
    if recording.about.worker {
        solver.replay_worker();
    }
    if !recording.about.renews {
        solver.renew_in_step();
    }
    let sessions = sessions(recording);
    let mut run = Run {
        states: states(&sessions),
        contacts: contacts(&sessions),
        same_bits,
        plan: recording.about.plan,
        largest: 0.0,
    };
    for (index, (number, sample)) in (1_u64..).zip(&recording.solves) {
        if u64::from(*number) != index {
            verdict.unverifiable_from = Some(index);
            verdict.why = Some(format!("solve {index} is not in the recording"));
            break;
        }
        let Some(state) = run.states.get(&sample.console_time_us).copied() else {
            verdict.unverifiable_from = Some(index);
            verdict.why = Some(format!(
                "the state of console time {} us, for which solve {index} was made, is not in the recording",
                sample.console_time_us
            ));
            break;
        };
        let here = run.step(solver, &state, sample, &mut verdict);
        // A step that was given up on the way is not the recorded one.
        if work::is_stopped() {
            break;
        }
        let here = match here {
            Ok(here) => here,
            Err(how) => {
                verdict.diverged_step = Some(index);
                verdict.diverged_at = Some(state.body().tick);
                verdict.why = Some(how);
                break;
            }
        };
        verdict.verified_steps += 1;
        if seen(solver, &here).is_break() {
            break;
        }
    }
    verdict
}

/// Compares the contacts that went down with the solves that they were made of, for a recording that does not say what the solver was
/// before: nothing is run again.
pub fn compare_contacts(recording: &Recording) -> HostVerdict {
    let mut verdict = HostVerdict {
        steps: recording.solves.len() as u64,
        identical: true,
        ..HostVerdict::default()
    };
    let sessions = sessions(recording);
    let (states, contacts) = (states(&sessions), contacts(&sessions));
    for (index, (_, sample)) in (1_u64..).zip(&recording.solves) {
        let Some(sent) = contacts.get(&sample.console_time_us) else {
            continue;
        };
        if sample.wrench.map(|wrench| wrench.map(|of| of as f32)) != Some(sent.wrench) {
            let state = states.get(&sample.console_time_us);
            verdict.identical = false;
            verdict.diverged_step = Some(index);
            verdict.diverged_at = state.map(|state| state.body().tick).or(Some(0));
            verdict.why = Some("the contact that was sent is not what was solved".to_owned());
            return verdict;
        }
        verdict.contacts += 1;
    }
    verdict.unverifiable_from = Some(1);
    verdict.why = Some(
        "it holds the last seconds of a session: what the solver was before is not known, and contacts were compared with solves alone"
            .to_owned(),
    );
    verdict
}

struct Run {
    states: HashMap<u64, Valid<State>>,
    contacts: HashMap<u64, Contact>,
    same_bits: bool,
    /// As it is at this solve.
    plan: Plan,
    /// Largest entry of a wrench so far \[N or N m\].
    largest: f64,
}

impl Run {
    fn step(
        &mut self,
        solver: &mut SceneSolver,
        state: &Valid<State>,
        sample: &SolveSample,
        verdict: &mut HostVerdict,
    ) -> Result<SolveSample, String> {
        let arrivals: Vec<_> = sample.arrivals().collect();
        solver.expect(&arrivals, sample.looked);
        if let Some(tuning) = &sample.tuned {
            if !(1.0..=f64::from(TICK_HZ)).contains(&tuning.host_hz) {
                return Err(format!(
                    "it goes on with {} solves a second",
                    tuning.host_hz
                ));
            }
            self.plan = self.plan.tuned(tuning);
            solver.tune(&self.plan);
        }
        for act in &sample.acts {
            solver.act(*act);
        }
        let began = Instant::now();
        let solved = solver.solve(state);
        let step_us = began.elapsed().as_secs_f64() * 1e6;
        verdict.hash = solver.hash();
        let here = SolveSample::new(state, &solved, verdict.hash, &arrivals);
        let same = here.state_hash == sample.state_hash
            && (here.wrench, &here.status) == (sample.wrench, &sample.status);
        verdict.identical &= same;
        if !same && self.same_bits {
            return Err(difference(&here, sample));
        }
        self.within(&here, sample, verdict)?;
        self.sent(state, &solved, same)?;
        let here = here.with(&solved, solver.last(), solver.punctures());
        Ok(SolveSample { step_us, ..here })
    }

    /// Whether two solves are the same to what rounding makes of them.
    fn within(
        &mut self,
        here: &SolveSample,
        there: &SolveSample,
        verdict: &mut HostVerdict,
    ) -> Result<(), String> {
        if here.status != there.status {
            return Err(difference(here, there));
        }
        let (Some(here), Some(there)) = (here.wrench, there.wrench) else {
            return Ok(());
        };
        let size = there.iter().fold(0.0, |size: f64, x| size.max(x.abs()));
        self.largest = self.largest.max(size);
        let pairs = here.iter().zip(&there);
        let apart = pairs.fold(0.0, |most: f64, (a, b)| most.max((a - b).abs()));
        let relative = if apart == 0.0 {
            0.0
        } else {
            apart / self.largest
        };
        verdict.largest_difference = verdict.largest_difference.max(relative);
        if relative <= WITHIN {
            return Ok(());
        }
        Err(format!(
            "the wrench differs by {relative:.1e} of the largest, more than the {WITHIN:.0e} that other rounding makes"
        ))
    }

    /// Whether the contact that went down is what the solver gave. Some are replaced before they are sent.
    fn sent(&self, state: &Valid<State>, solved: &Solved, same: bool) -> Result<(), String> {
        let Some(sent) = self.contacts.get(&state.console_time_us()) else {
            return Ok(());
        };
        let felt = solved.frames(state.body(), sent.horizon_us, self.plan.rendering);
        match felt {
            Some(Felt { contact, .. }) if !same || contact == *sent => Ok(()),
            Some(_) => Err("the contact that was sent is not what was solved".to_owned()),
            None => Err("a contact was sent although nothing was solved".to_owned()),
        }
    }
}

fn difference(here: &SolveSample, there: &SolveSample) -> String {
    if here.status != there.status {
        return format!(
            "the solve ends as {} instead of {}",
            here.status, there.status
        );
    }
    if here.wrench != there.wrench {
        return format!(
            "the wrench is {:?} instead of {:?}",
            here.wrench, there.wrench
        );
    }
    format!(
        "the solver's state has hash {} instead of {}",
        here.state_hash, there.state_hash
    )
}

/// States by their console time \[us\].
fn states(sessions: &[Session]) -> HashMap<u64, Valid<State>> {
    let states = sessions.iter().flat_map(|session| &session.states);
    states
        .map(|(state, _)| (state.console_time_us(), *state))
        .collect()
}

/// Contacts by the console time that they were solved for \[us\].
fn contacts(sessions: &[Session]) -> HashMap<u64, Contact> {
    let frames = sessions.iter().flat_map(|session| &session.down);
    frames
        .filter_map(
            |frame| match parse(super::super::tap::Direction::Down, &frame.bytes)?.1? {
                Checked::Contact(contact) => Some((contact.console_time_us(), *contact.body())),
                _ => None,
            },
        )
        .collect()
}
