//! Pictures of a recording: made by running its solver's steps again, and again where other values are to be seen.
//!
//! Entry points: [`Pictures::make`], [`Pictures::are_as_wanted`]. A picture has one scalar. Where a page chooses another one
//! pictures of it take the places of those that have it not, from the start on.

use super::recorded::{Line, tell};
use crate::failure::Failure;
use crate::recording::build;
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use sutura_host::picture::{Painter, Scalar, SolveRow, SolvesOf, encode_solves};
use sutura_host::recording::replay::{HostVerdict, replay_host_while};
use sutura_host::recording::{About, Recording, SolveSample};
use sutura_host::scene::Scene;
use sutura_host::session::{SceneSolver, Snapshot};
use sutura_host::thread::{Beats, Hanging};
use sutura_view::Shared;

/// What pictures of a recording may take \[bytes\]; there are fewer of a longer one.
const MOST_BYTES: f64 = 256e6;
/// Between two words on how far it is.
const TELL_EVERY: Duration = Duration::from_millis(250);

/// The pictures of a recording.
pub struct Pictures<'a> {
    shared: &'a Shared,
    scene: &'a Scene,
    recording: &'a Recording,
    painter: &'a Painter,
    of: SolvesOf,
    stop: &'a AtomicBool,
    /// When each of them is \[s\], ascending, and what its scalar is.
    made: Vec<(f64, Option<Scalar>)>,
    /// Of those that are made now; none of tissue that has no stresses.
    scalar: Option<Scalar>,
}

impl<'a> Pictures<'a> {
    /// None yet.
    pub fn new(
        shared: &'a Shared,
        scene: &'a Scene,
        recording: &'a Recording,
        painter: &'a Painter,
        of: SolvesOf,
        stop: &'a AtomicBool,
    ) -> Self {
        let has_model = scene.tissue.sticking().is_none();
        Self {
            shared,
            scene,
            recording,
            painter,
            of,
            stop,
            made: Vec::new(),
            scalar: has_model.then_some(Scalar::VonMises),
        }
    }

    /// Time of the picture at or before a time \[s\].
    pub fn before(&self, at_s: f64) -> Option<f64> {
        let times = self.made.iter().map(|(made_s, _)| *made_s);
        times.take_while(|made_s| *made_s <= at_s).last()
    }

    /// Whether all of them have the scalar that was chosen last.
    pub fn are_as_wanted(&self) -> bool {
        self.are_as_wanted_from(0)
    }

    fn are_as_wanted_from(&self, first: usize) -> bool {
        let wanted = self.wanted();
        let mut left = self.made.iter().skip(first);
        wanted.is_none() || left.all(|(_, scalar)| *scalar == wanted)
    }

    /// The scalar that pictures must have to be as wanted; none where any will do: displacements are in all of them.
    fn wanted(&self) -> Option<Scalar> {
        let wanted = self.shared.wants().scalar;
        let wanted = wanted.as_deref().and_then(Scalar::named);
        wanted.filter(|scalar| scalar.needs_model() && self.scalar.is_some())
    }

    /// Runs the solver's steps again. The first time all of them, with a picture as often as the line is to have them; later up
    /// to the last one that is not as wanted. Ends early once the program is to end.
    ///
    /// # Errors
    /// Its tissue cannot be made again.
    pub fn make(&mut self, line: &mut Line) -> Result<HostVerdict, Failure> {
        let shown = crate::work::watch();
        let recording = self.recording;
        let about = &recording.about;
        let mut solver = SceneSolver::for_session(self.scene, &about.plan)?;
        drop(shown);
        let here = About::here(build(), &about.plan, &about.tissue);
        let mut own = Snapshot::of(&solver);
        let mut hanging = solver.model().and_then(|model| Hanging::new(model));
        let mut beats = Beats::default();
        let mut bytes = Vec::new();
        let is_first = self.made.is_empty();
        let (mut solves, mut next, mut due_s) = (0, 0, 0.0);
        let mut told = Instant::now();
        let mut rows = Vec::new();
        let see = |solver: &SceneSolver, here: &SolveSample| {
            solves += 1;
            let time_s = line.time_s(here.console_time_us);
            if is_first && about.lockstep && line.holds(time_s) {
                rows.push(SolveRow {
                    time_s,
                    sample: here.clone(),
                });
            }
            if is_first {
                line.ready_s = time_s;
            } else {
                due_s = self.made.get(next).map_or(f64::INFINITY, |(at_s, _)| *at_s);
            }
            let stops = self.stop.load(Ordering::Relaxed);
            let is_beat = beats.is_due(here.console_time_us);
            if let Some(hanging) = hanging.as_mut().filter(|_| is_beat && !stops) {
                solver.snapshot(&mut own);
                own.beat(hanging, &own.positions_m());
            }
            if time_s >= due_s && !stops {
                self.scalar = self.wanted().or(self.scalar);
                let is_there = self.made.get(next).map(|(_, scalar)| *scalar);
                if is_there != Some(self.scalar) {
                    solver.snapshot(&mut own);
                    own.solves = solves;
                    let sequence = next as u32 + 1;
                    let hanging = hanging.as_mut();
                    let mut picture = self.painter.paint(&own, hanging, self.scalar, sequence);
                    (picture.recorded, picture.time_s) = (true, time_s);
                    picture.encode(&mut bytes);
                    self.shared.recorded_picture(time_s, bytes.clone());
                }
                match self.made.get_mut(next) {
                    Some((_, scalar)) => *scalar = self.scalar,
                    None => {
                        self.made.push((time_s, self.scalar));
                        line.thin_out(MOST_BYTES / bytes.len() as f64);
                        due_s = time_s + 1.0 / line.hz - 1e-9;
                    }
                }
                next += 1;
            }
            if told.elapsed() >= TELL_EVERY {
                told = Instant::now();
                tell(self.shared, line, "ready");
                timed(self.shared, self.of, &mut rows);
            }
            let is_done = stops || (!is_first && self.are_as_wanted_from(next));
            if is_done {
                ControlFlow::Break(())
            } else {
                ControlFlow::Continue(())
            }
        };
        let same_bits = about.same_bits(&here);
        let verdict = replay_host_while(recording, &mut solver, same_bits, see);
        timed(self.shared, self.of, &mut rows);
        Ok(verdict)
    }
}

/// Says how long solves took that were run again, in place of what is shown of them: a recording in lockstep does not say it.
fn timed(shared: &Shared, of: SolvesOf, rows: &mut Vec<SolveRow>) {
    if !rows.is_empty() {
        let mut bytes = Vec::new();
        encode_solves(of, rows, &mut bytes);
        shared.block(bytes);
        rows.clear();
    }
}
