//! Rows for plots, and what happens, of every state and every solve: collected in the recorder's thread, shown from another.
//!
//! Entry points: [`Telemetry::seen`] for the recorder, [`Telemetry::show`] and [`Telemetry::gauges`] for who shows.

use super::gauges::Gauges;
use super::live::Tap;
use super::take_out::grip;
use serde_json::{Map, Value, json};
use std::collections::VecDeque;
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

/// Most states that may be newer than the newest solve of one of them.
const MOST_GRIPS: usize = 512;
/// Clearance of a tool that is plainly beside the tissue \[m\].
const CLEAR_M: f64 = 1e-3;

/// Last place of the grip at which its tool touched nothing, for one of which the newest solve found no balance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Withheld {
    /// Position of the grip in that solve \[m\].
    pub at_m: [f64; 3],
    /// Position of the grip \[m\]; none if there was no such place.
    pub clear_m: Option<[f64; 3]>,
}

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
    /// Name of the person who asked for a safe stop; cleared when the console is armed.
    stopped_by: Option<&'static str>,
    /// Newest grip positions \[m\], each with its console time \[us\].
    grips: VecDeque<(u64, [f64; 3])>,
    /// Newest grip position at which the tool touched nothing \[m\], and its clearance there \[m\].
    clear: Option<([f64; 3], f64)>,
    /// Grip position of the newest solve \[m\], if that found no balance.
    withheld_m: Option<[f64; 3]>,
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
            stopped_by: None,
            grips: VecDeque::with_capacity(MOST_GRIPS),
            clear: None,
            withheld_m: None,
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
        let mut said = inner.gauges.said(report, link, limited);
        said.insert("kind".to_owned(), json!("gauges"));
        said.insert("session".to_owned(), json!(session));
        said.insert("stopped_by".to_owned(), json!(inner.stopped_by));
        said
    }

    /// Grip position in the newest state \[m\].
    pub fn grip(&self) -> Option<Pose> {
        self.lock().gauges.newest().map(grip)
    }

    /// Returns where the tool was clear last, if the solver says that it is in the tissue, or finds no balance there.
    pub fn withheld(&self) -> Option<Withheld> {
        let inner = self.lock();
        let clear_m = inner.clear.map(|(clear_m, _)| clear_m);
        inner.withheld_m.map(|at_m| Withheld { at_m, clear_m })
    }

    /// Somebody has asked for a safe stop.
    pub fn safe_stop(&self, by: &'static str) {
        self.lock().stopped_by = Some(by);
    }

    /// Tells of something that is known elsewhere.
    pub fn event(&self, what: &str, text: &str, help: &str) {
        self.lock().event(what, text, help);
    }
}

impl Inner {
    fn time_s(&self, console_time_us: u64) -> f64 {
        let began_us = self.began_us.unwrap_or(console_time_us);
        1e-6 * (console_time_us as f64 - began_us as f64)
    }

    fn state(&mut self, console_time_us: u64, state: &State) {
        if self.grips.len() == MOST_GRIPS {
            self.grips.pop_front();
        }
        self.grips
            .push_back((console_time_us, state.position_m.map(f64::from)));
        let renders = matches!(state.mode, Mode::Armed | Mode::Decaying);
        if self.began_us.is_none() {
            if !renders {
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
                    let words = match (self.stopped_by, before) {
                        (Some(by), _) => format!("safe stop, asked for by {by}"),
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
        self.note_place(sample);
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

    /// Takes note of where the tool is clear of the tissue, and of solves without balance. While columns are awaited neither is known.
    fn note_place(&mut self, sample: &SolveSample) {
        if sample.status == Status::Waiting.name() {
            return;
        }
        let mut grips = self.grips.iter();
        let own = grips.find(|(time_us, _)| *time_us == sample.console_time_us);
        let Some((_, grip_m)) = own.copied() else {
            return;
        };
        let found = [Status::Ok, Status::Behind].map(Status::name);
        let is_found = found.contains(&sample.status.as_str());
        self.withheld_m = (!is_found).then_some(grip_m);
        let gap_m = sample.gap_m.unwrap_or(f64::MAX).min(CLEAR_M);
        let least_m = self.clear.map_or(0.0, |(_, gap_m)| gap_m);
        if sample.status != Status::Ok.name() || sample.rows > 0 || gap_m <= 0.0 || gap_m < least_m
        {
            return;
        }
        self.clear = Some((grip_m, gap_m));
    }

    fn event(&mut self, what: &str, text: &str, help: &str) {
        let time_s = self.gauges.time_s();
        self.events.push(json!({
            "kind": "event", "session": self.of.session, "time_s": time_s, "what": what, "text": text, "help": help,
        }));
    }
}
