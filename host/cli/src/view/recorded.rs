//! `sutura view FILE.mcap`: a recording on a time line, whose pictures are made by running it again.
//!
//! Entry point: [`show`]. What is shown is what was felt: every solve that is run again is compared with what was recorded.

use super::hello::{Kind, hello};
use super::page::Page;
use super::recorded_pictures::Pictures;
use super::sandbox::At;
use super::telemetry::Telemetry;
use crate::failure::{Cause, Failure};
use crate::recording::failure;
use crate::replay::begins_later;
use crate::signals::{Stoppable, unfinished};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use sutura_host::picture::{Painter, SolvesOf};
use sutura_host::recording::replay::{HostVerdict, sessions};
use sutura_host::recording::{Begins, Recording};
use sutura_host::scene::Scene;
use sutura_shared::wire::message::{Mode, State};
use sutura_view::{Beginning, Shared};

/// Pictures a second of the recording.
const HZ: f64 = 30.0;
/// Rows of a block of telemetry.
const BLOCK: usize = 1000;
/// Between two looks for what is to be shown.
const LOOK_EVERY: Duration = Duration::from_millis(50);

/// A recording that can be shown.
pub struct Opened {
    /// Its file.
    pub file: PathBuf,
    recording: Recording,
    scene: Scene,
}

impl Opened {
    /// Reads it, and its scene.
    ///
    /// # Errors
    /// A file that is no recording, or of a scene that is refused.
    pub fn read(file: &Path) -> Result<Opened, Failure> {
        let recording = Recording::read(file).map_err(failure)?;
        let scene = crate::scene::recorded(&recording)?;
        Ok(Opened {
            file: file.to_owned(),
            recording,
            scene,
        })
    }

    /// Time of the picture that is asked for \[s\], if any.
    ///
    /// # Errors
    /// It has no pictures, or none of then.
    pub fn shot_at(&self, asked_s: Option<f64>) -> Result<f64, Failure> {
        if self.recording.about.begins == Begins::Later {
            return Err(begins_later(&self.file, "there is no tissue to draw"));
        }
        let to_s = Line::of(&self.recording, None).to_s;
        match asked_s {
            None => Ok(super::SHOT_AT_S.min(to_s)),
            Some(at_s) if at_s <= to_s + LEAST_S => Ok(at_s.min(to_s)),
            Some(at_s) => {
                let to_s = down_to_ms(to_s);
                let message = format!(
                    "{} ends at {to_s:.3} s: there is no picture of {at_s} s",
                    self.file.display()
                );
                let help = format!("--at takes 0 to {to_s:.3}");
                Err(Failure::say(Cause::BadInput, message, help))
            }
        }
    }
}

/// Below what a console's clock counts \[s\].
const LEAST_S: f64 = 5e-7;

/// A time rounded down to milliseconds \[s\]: what is printed of it is within the recording.
fn down_to_ms(time_s: f64) -> f64 {
    (1e3 * time_s).floor() * 1e-3
}

/// Shows a recording until `stop` is set; the page opens it at a time, if there is to be one.
///
/// # Errors
/// Its tissue cannot be made again; `stop` was set before it had been run again.
pub fn show(
    page: &Page,
    opened: Opened,
    at: Option<&At>,
    stop: &Arc<AtomicBool>,
) -> Result<(), Failure> {
    let _ends = Stoppable::by(stop);
    let Opened {
        recording, scene, ..
    } = opened;
    let about = &recording.about;
    let shared = page.shared();
    let solvable = about.begins != Begins::Later;
    let why = "it holds the last seconds of a session: what the solver was before is not known, and there is no tissue to show";
    let mut line = Line::of(&recording, (!solvable).then_some(why));
    line.at_s = at.map(|at| at.at_s.clamp(0.0, line.to_s));
    let painter = Painter::new(&scene, shared.session() + 1);
    let mut geometry = Vec::new();
    painter.boundary().encode(0, &mut geometry);
    let kind = Kind {
        source: "recording",
        pace: if about.lockstep {
            "lockstep"
        } else {
            "real-time"
        },
        console: &about.console,
        commands: if solvable {
            vec!["seek", "scalar"]
        } else {
            vec!["seek"]
        },
        has_model: scene.tissue.sticking().is_none(),
        ..Kind::default()
    };
    let mut said = hello(&scene, &about.plan, &kind);
    said.insert("time_line".to_owned(), line.said());
    shared.begin(Beginning {
        hello: said,
        geometry: Some(geometry),
        recorded: true,
    });
    let of = SolvesOf {
        session: shared.session(),
        needles: scene.needles.len(),
        threads: scene.threads.len(),
    };
    line.marks = telemetry(shared, of, &recording, &line);
    shared.amend("time_line", line.said());
    let mut pictures = Pictures::new(shared, &scene, &recording, &painter, of, stop);
    if solvable {
        let verdict = pictures.make(&mut line);
        // Whatever came of work that was stopped is none of the recording's.
        if stop.load(Ordering::Relaxed) {
            return Err(unfinished(UNFINISHED, HELP));
        }
        let verdict = verdict?;
        (line.badge, line.text) = judged(&verdict);
        tell(shared, &line, "ready");
        tell(shared, &line, "verified");
        note!("{}", line.text);
    }
    if let Some(at) = at {
        // A picture is made of the first solve that is due.
        let period_s = 1.0 / line.hz + 1.0 / about.plan.host_hz;
        let found_s = pictures.before(at.at_s);
        if found_s.is_none_or(|found_s| at.at_s - found_s > period_s) {
            return Err(no_picture(at.at_s, found_s, &line.text));
        }
        let _ = at.reached.set(period_s);
    }
    while !stop.load(Ordering::Relaxed) {
        if !solvable || pictures.are_as_wanted() {
            std::thread::sleep(LOOK_EVERY);
        } else {
            match pictures.make(&mut line) {
                Err(_) if stop.load(Ordering::Relaxed) => {}
                made => drop(made?),
            }
            tell(shared, &line, "ready");
        }
    }
    Ok(())
}

const UNFINISHED: &str = "the recording had not been run again to its end";
const HELP: &str = "run it again, and let it come so far; a recording of a shorter session, or of a coarser mesh, takes less time";

/// Why nothing is drawn for a time \[s\]; the picture before it is of `found_s`.
fn no_picture(at_s: f64, found_s: Option<f64>, text: &str) -> Failure {
    let newest = found_s.map_or_else(
        || "none before it".to_owned(),
        |found_s| format!("the one before it is of {found_s:.3} s"),
    );
    let message = format!("there is no picture of {at_s} s, {newest}: {text}");
    let help = "where the console rests nothing is solved, and from where a replay differs nothing is shown: take another --at";
    Failure::say(Cause::Failed, message, help)
}

/// How a recording lies in time, and what is known of it.
#[derive(Clone, Debug)]
pub struct Line {
    began_us: u64,
    to_s: f64,
    /// Pictures are there up to here \[s\].
    pub ready_s: f64,
    /// Pictures a second \[Hz\].
    pub hz: f64,
    /// Where the page opens it, if not at the start.
    at_s: Option<f64>,
    why: Option<&'static str>,
    badge: &'static str,
    text: String,
    /// What happened, as events say it.
    marks: Vec<Value>,
}

impl Line {
    fn of(recording: &Recording, why: Option<&'static str>) -> Self {
        let states = states(recording);
        let renders =
            |(_, state): &&(u64, State)| matches!(state.mode, Mode::Armed | Mode::Decaying);
        let began_us = states.iter().find(renders).map_or(0, |(us, _)| *us);
        // Afterwards it is only asked for its counters.
        let active = |(_, state): &&(u64, State)| state.mode != Mode::Idle;
        let last_us = states.iter().rfind(active).map_or(began_us, |(us, _)| *us);
        Self {
            began_us,
            to_s: 1e-6 * last_us.saturating_sub(began_us) as f64,
            ready_s: 0.0,
            hz: HZ,
            at_s: None,
            badge: if why.is_some() { "none" } else { "running" },
            text: why.map_or_else(|| "it is being run again".to_owned(), str::to_owned),
            marks: Vec::new(),
            why,
        }
    }

    /// When this is on the line \[s\].
    pub fn time_s(&self, console_time_us: u64) -> f64 {
        1e-6 * (console_time_us as f64 - self.began_us as f64)
    }

    /// Whether this is on the line \[s\].
    pub fn holds(&self, time_s: f64) -> bool {
        (0.0..=self.to_s).contains(&time_s)
    }

    /// There is room for so many pictures.
    pub fn thin_out(&mut self, most: f64) {
        self.hz = HZ.min(most / self.to_s.max(1.0));
    }

    fn said(&self) -> Value {
        json!({
            "from_s": 0.0, "to_s": self.to_s, "ready_s": self.ready_s, "hz": self.hz, "at_s": self.at_s,
            "solvable": self.why.is_none(), "why": self.why, "badge": self.badge, "badge_text": self.text,
            "marks": self.marks,
        })
    }
}

/// States of the console, with their console time \[us\].
fn states(recording: &Recording) -> Vec<(u64, State)> {
    let sessions = sessions(recording).into_iter();
    let states = sessions.flat_map(|session| session.states);
    states
        .map(|(state, _)| (state.console_time_us(), *state.body()))
        .collect()
}

/// Shows all ticks and solves that are recorded, up to the end of the line; what happened in them.
fn telemetry(shared: &Shared, of: SolvesOf, recording: &Recording, line: &Line) -> Vec<Value> {
    let telemetry = Telemetry::new(of).with(None);
    let mut solves = recording.solves.iter().map(|(_, sample)| sample).peekable();
    let mut events = Vec::new();
    let states = states(recording).into_iter();
    let within = states.filter(|(us, _)| line.time_s(*us) <= line.to_s);
    for (number, (us, state)) in (1_usize..).zip(within) {
        telemetry.state(us, &state);
        while let Some(solve) = solves.next_if(|solve| solve.console_time_us <= us) {
            telemetry.solve(solve);
        }
        if number.is_multiple_of(BLOCK) {
            events.extend(telemetry.take_events());
            telemetry.show(shared);
        }
    }
    events.extend(telemetry.take_events());
    telemetry.show(shared);
    events
}

/// Tells how far it is, and what is known of it.
pub fn tell(shared: &Shared, line: &Line, what: &str) {
    shared.amend("time_line", line.said());
    shared.text(&json!({
        "kind": "event", "session": shared.session(), "time_s": line.ready_s, "what": what,
        "text": line.text, "help": "", "badge": line.badge,
    }));
}

/// The badge of a recording that was run again, and its words.
fn judged(verdict: &HostVerdict) -> (&'static str, String) {
    let steps = verdict.verified_steps;
    match (verdict.diverged_at, &verdict.why) {
        (Some(tick), why) => {
            let why = why.as_deref().unwrap_or_default();
            (
                "diverged",
                format!("what is shown diverges from what was recorded at tick {tick}: {why}"),
            )
        }
        (None, Some(why)) => (
            "diverged",
            format!(
                "{steps} of {} solves are as recorded, the rest cannot be run again: {why}",
                verdict.steps
            ),
        ),
        (None, None) if verdict.identical => (
            "identical",
            format!("what is shown is what was felt: {steps} solves are identical to the bit"),
        ),
        (None, None) => (
            "close",
            format!(
                "{steps} solves are as recorded to within {:.0e} of the largest force, as other rounding makes it",
                verdict.largest_difference
            ),
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The limit that is named is one that is taken.
    #[test]
    fn the_end_that_is_named_is_within_the_recording() {
        for end_us in (0..20_000).chain([2_998_700, 2_999_000, 3_000_000]) {
            let end_s = 1e-6 * f64::from(end_us);
            let named: f64 = format!("{:.3}", down_to_ms(end_s))
                .parse()
                .expect("a number");
            assert!(
                named <= end_s + LEAST_S && end_s - named < 1.001e-3,
                "{end_s}: {named}"
            );
        }
    }
}
