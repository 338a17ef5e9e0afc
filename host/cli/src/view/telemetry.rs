//! Rows for plots, and what happens, of every state and every solve: collected in the recorder's thread, shown from another.
//!
//! Entry points: [`Telemetry::seen`] for the recorder, [`Telemetry::show`] and [`Telemetry::gauges`] for who shows.

use super::gauges::Gauges;
use super::live::Tap;
use super::take_out::grip;
use serde_json::{Map, Value, json};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use sutura_host::picture::{SolveRow, SolvesOf, TickRow, encode_solves, encode_ticks};
use sutura_host::recording::{Passed, Seen, SolveSample};
use sutura_host::scene::Pose;
use sutura_host::session::{LimitedTicks, LinkSummary, fault_words};
use sutura_host::step::Status;
use sutura_shared::wire::faults;
use sutura_shared::wire::message::{Mode, Report, State};
use sutura_view::Shared;

/// Most rows that wait to be shown: of ticks that nobody takes for so long nobody would see.
const MOST: usize = 20_000;

/// What a session has to show.
pub struct Telemetry {
    inner: Mutex<Inner>,
    /// Who is told of all that passes, besides.
    live: Option<Tap>,
}

struct Inner {
    of: SolvesOf,
    /// Console time of the first armed state \[us\].
    began_us: Option<u64>,
    ticks: Vec<TickRow>,
    solves: Vec<SolveRow>,
    events: Vec<Value>,
    gauges: Gauges,
    mode: Option<Mode>,
    faults: u16,
    punctures: u32,
    /// Whether the newest solve has found that a tool had slipped into the tissue.
    has_slipped: bool,
    /// Name of the person who asked for a safe stop; cleared when the console is armed.
    stopped_by: Option<&'static str>,
    /// Whether somebody has asked to arm it, and no state has shown it armed since.
    arming: bool,
    /// Whether the tool is to be taken out of the tissue, and no state has shown the console at rest since.
    leaving: bool,
}

impl Telemetry {
    /// Of a session.
    pub fn new(of: SolvesOf) -> Self {
        let inner = Inner {
            of,
            began_us: None,
            ticks: Vec::new(),
            solves: Vec::new(),
            events: Vec::new(),
            gauges: Gauges::new(),
            mode: None,
            faults: 0,
            punctures: 0,
            has_slipped: false,
            stopped_by: None,
            arming: false,
            leaving: false,
        };
        Self {
            inner: Mutex::new(inner),
            live: None,
        }
    }

    /// Tells channels for other programs, too.
    pub fn with(self, live: Option<Tap>) -> Arc<Self> {
        Arc::new(Self { live, ..self })
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// For a recorder, which tells of everything that passes.
    pub fn seen(self: &Arc<Self>) -> Seen {
        let own = self.clone();
        Box::new(move |passed| match passed {
            Passed::State(state) => {
                own.state(state.console_time_us(), state.body());
                if let Some(live) = &own.live {
                    live.state(state.body());
                }
            }
            Passed::Solve(sample) => {
                own.solve(sample);
                if let Some(live) = &own.live {
                    live.solve(sample);
                }
            }
        })
    }

    /// Takes note of a state.
    pub fn state(&self, console_time_us: u64, state: &State) {
        self.lock().state(console_time_us, state);
    }

    /// Takes note of a solve.
    pub fn solve(&self, sample: &SolveSample) {
        self.lock().solve(sample);
    }

    /// What has happened since this was asked last.
    pub fn take_events(&self) -> Vec<Value> {
        std::mem::take(&mut self.lock().events)
    }

    /// Shows the rows and events that have come.
    pub fn show(&self, shared: &Shared) {
        let (of, ticks, solves, events) = {
            let mut inner = self.lock();
            let (ticks, solves) = (&mut inner.ticks, Vec::new());
            let ticks = std::mem::take(ticks);
            let solves = std::mem::replace(&mut inner.solves, solves);
            (inner.of, ticks, solves, std::mem::take(&mut inner.events))
        };
        let mut bytes = Vec::new();
        if !ticks.is_empty() {
            encode_ticks(of.session, &ticks, &mut bytes);
            shared.block(bytes.clone());
        }
        if !solves.is_empty() {
            encode_solves(of, &solves, &mut bytes);
            shared.block(bytes);
        }
        events.iter().for_each(|event| shared.text(event));
    }

    /// Figures, see [`Gauges::said`].
    pub fn gauges(
        &self,
        report: Option<&Report>,
        link: Option<&LinkSummary>,
        limited: Option<LimitedTicks>,
    ) -> Map<String, Value> {
        let mut inner = self.lock();
        let session = inner.of.session;
        // One that is told to rest and to arm before the same tick never rests.
        let is_armed = inner.arming && inner.mode.is_some_and(renders);
        let stopped_by = inner.stopped_by.filter(|_| !is_armed);
        let mut said = inner.gauges.said(report, link, limited);
        said.insert("kind".to_owned(), json!("gauges"));
        said.insert("session".to_owned(), json!(session));
        said.insert("stopped_by".to_owned(), json!(stopped_by));
        said
    }

    /// Grip position in the newest state \[m\].
    pub fn grip(&self) -> Option<Pose> {
        self.lock().gauges.newest().map(grip)
    }

    /// Whether the newest solve has found that a tool had slipped into the tissue.
    pub fn has_slipped(&self) -> bool {
        self.lock().has_slipped
    }

    /// Whether the newest state is of a console that renders.
    pub fn renders(&self) -> bool {
        self.lock().mode.is_some_and(renders)
    }

    /// Whether the console's last state is armed, not decaying.
    pub fn is_armed(&self) -> bool {
        self.lock().mode == Some(Mode::Armed)
    }

    /// Somebody has asked for a safe stop. One before the session's first state holds it at rest from the start.
    pub fn safe_stop(&self, by: &'static str) {
        let mut inner = self.lock();
        if std::mem::take(&mut inner.arming) {
            inner.stopped_by = None;
        }
        inner.stopped_by.get_or_insert(by);
    }

    /// Somebody has asked to arm the console.
    pub fn arm(&self) {
        self.lock().arming = true;
    }

    /// Somebody has asked to take the tool out of the tissue, for which the console is disarmed.
    pub fn take_out(&self) {
        let mut inner = self.lock();
        inner.leaving = inner.mode.is_some_and(renders);
    }

    /// Tells of something that is known elsewhere.
    pub fn event(&self, what: &str, text: &str, help: &str) {
        self.lock().event(what, text, help);
    }
}

/// Whether a console of this mode renders.
fn renders(mode: Mode) -> bool {
    matches!(mode, Mode::Armed | Mode::Decaying)
}

impl Inner {
    fn time_s(&self, console_time_us: u64) -> f64 {
        let began_us = self.began_us.unwrap_or(console_time_us);
        1e-6 * (console_time_us as f64 - began_us as f64)
    }

    fn state(&mut self, console_time_us: u64, state: &State) {
        if self.began_us.is_none() {
            let rests = state.mode == Mode::Idle && self.stopped_by.is_some();
            if !rests && !renders(state.mode) {
                return;
            }
            self.began_us = Some(console_time_us);
        }
        let time_s = self.time_s(console_time_us);
        self.gauges.state(time_s, state);
        if self.ticks.len() < MOST {
            self.ticks.push(TickRow {
                time_s,
                state: *state,
            });
        }
        let before = self.mode.replace(state.mode);
        if before != Some(state.mode) {
            if state.mode != Mode::Idle && std::mem::take(&mut self.arming) {
                self.stopped_by = None;
            }
            match (before, state.mode) {
                (_, Mode::Decaying) => self.event(
                    "decay",
                    "the force goes to zero: what the host has sent last is older than its horizon",
                    "",
                ),
                (Some(Mode::Decaying), Mode::Armed) => {}
                (_, Mode::Armed) => {
                    self.stopped_by = None;
                    self.event("armed", "the console is armed", "");
                }
                (before, Mode::Idle) => {
                    let leaves = std::mem::take(&mut self.leaving);
                    let words = match (self.stopped_by, before) {
                        (Some(by), _) => format!("safe stop, asked for by {by}"),
                        (None, _) if leaves => {
                            "the console rests while the tool is taken out of the tissue".to_owned()
                        }
                        (None, Some(Mode::Decaying)) => {
                            "the console has let go: no contact came in time for half a second"
                                .to_owned()
                        }
                        (None, _) => "the console is at rest".to_owned(),
                    };
                    self.event("disarmed", &words, "");
                }
                _ => {}
            }
        }
        let new = state.faults & !std::mem::replace(&mut self.faults, state.faults);
        let named = faults::NAMES.iter().filter(|(bit, _)| new & bit != 0);
        for (bit, name) in named {
            let (message, help) = fault_words(*bit);
            self.event("fault", &format!("{name}: {message}"), help);
        }
    }

    fn solve(&mut self, sample: &SolveSample) {
        let time_s = self.time_s(sample.console_time_us);
        self.gauges.solve(sample);
        self.has_slipped = sample.status == Status::Inside.name();
        let before = std::mem::replace(&mut self.punctures, sample.punctures);
        if sample.punctures > before {
            self.event("puncture", "a needle has broken through a boundary", "");
        }
        if self.solves.len() < MOST {
            self.solves.push(SolveRow {
                time_s,
                sample: sample.clone(),
            });
        }
    }

    fn event(&mut self, what: &str, text: &str, help: &str) {
        let time_s = self.gauges.time_s();
        self.events.push(json!({
            "kind": "event", "session": self.of.session, "time_s": time_s, "what": what, "text": text, "help": help,
        }));
    }
}
