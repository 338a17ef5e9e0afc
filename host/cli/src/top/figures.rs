//! What is known of a session, from what its page is told.
//!
//! Entry points: [`Figures::hear`], and the questions that the screen asks. What a session does not say is `None`, never a number.

use super::source::Message;
use serde_json::Value;
use std::collections::VecDeque;
use std::time::{Duration, Instant};
use sutura_host::picture::Read;
use sutura_host::session::fault_names;

/// How far back the force is kept \[s\].
pub const KEPT_S: f64 = 30.0;
/// The longest time whose largest force is kept as one \[s\].
const BIN_S: f64 = 0.05;
/// Longest that figures stand without a new word.
const OLD: Duration = Duration::from_secs(2);
/// Words of the modes, from 0.
const MODES: [&str; 5] = ["boot", "idle", "armed", "decaying", "fault"];
/// Things that have happened that are kept.
const EVENTS: usize = 200;

/// The figures.
pub struct Figures {
    hello: Value,
    gauges: Value,
    /// When they came.
    heard: Instant,
    /// Largest force in a short time \[N\], and when that began \[s\].
    forces: VecDeque<(f64, f64)>,
    /// Of the newest tick: force \[N\], mode, faults.
    tick: Option<(f64, u8, u16)>,
    events: VecDeque<String>,
    /// The newest answer that says no, and what it was about.
    refused: Option<String>,
    asked: VecDeque<(u64, String)>,
}

/// 50 and 99 of 100 \[us\].
pub type Spread = [f64; 2];

impl Figures {
    /// Nothing is known.
    pub fn new(now: Instant) -> Self {
        Self {
            hello: Value::Null,
            gauges: Value::Null,
            heard: now,
            forces: VecDeque::new(),
            tick: None,
            events: VecDeque::new(),
            refused: None,
            asked: VecDeque::new(),
        }
    }

    /// Takes note of a message; whether it says anything new.
    pub fn hear(&mut self, message: &Message, now: Instant) -> bool {
        match message {
            Message::Binary(bytes) => self.ticks(bytes),
            Message::Text(text) => match text["kind"].as_str() {
                Some("hello") => self.hello(text),
                Some("gauges") => {
                    (self.gauges, self.heard) = (text.clone(), now);
                    true
                }
                Some("event") => self.event(text),
                _ => self.answer(text),
            },
        }
    }

    fn hello(&mut self, text: &Value) -> bool {
        if text["session"] != self.hello["session"] {
            // What was known is another session's.
            (self.gauges, self.tick) = (Value::Null, None);
            self.forces.clear();
        }
        self.hello = text.clone();
        true
    }

    fn ticks(&mut self, bytes: &[u8]) -> bool {
        let Some(read) = Read::of(bytes).filter(|read| read.kind == 3) else {
            return false;
        };
        let norm = |force: &[f64; 3]| force.iter().map(|x| x * x).sum::<f64>().sqrt();
        let forces: Vec<f64> = read.vectors(5).iter().map(norm).collect();
        for (time_s, force_n) in read.f64s(1).into_iter().zip(&forces) {
            match self.forces.back_mut() {
                Some((begin_s, most_n)) if time_s - *begin_s < BIN_S => {
                    *most_n = most_n.max(*force_n);
                }
                _ => self.forces.push_back((time_s, *force_n)),
            }
        }
        let newest_s = self.forces.back().map_or(0.0, |(time_s, _)| *time_s);
        let is_old = |(time_s, _): &(f64, f64)| newest_s - time_s > KEPT_S;
        while self.forces.front().is_some_and(is_old) {
            self.forces.pop_front();
        }
        let newest = forces.last().copied().zip(read.u8s(8).pop());
        if let Some(((force_n, mode), faults)) = newest.zip(read.u16s(10).pop()) {
            self.tick = Some((force_n, mode, faults));
        }
        true
    }

    fn event(&mut self, text: &Value) -> bool {
        let what = text["what"].as_str().unwrap_or_default();
        if what == "ready" {
            return false;
        }
        let words = text["text"].as_str().filter(|words| !words.is_empty());
        let time_s = text["time_s"].as_f64().unwrap_or_default();
        self.note(format!("{time_s:8.2} s  {}", words.unwrap_or(what)));
        true
    }

    fn answer(&mut self, text: &Value) -> bool {
        let Some(id) = text["re"].as_u64() else {
            return false;
        };
        let known = self.asked.iter().position(|(own, _)| *own == id);
        let about = known.and_then(|at| self.asked.remove(at));
        let error = &text["error"];
        self.refused = error["message"].as_str().map(|message| {
            let help = match error["help"].as_str().unwrap_or_default() {
                // In the words of who sends commands.
                "say `take_control` first" => "t takes the controls",
                help => help,
            };
            let name = about.map_or(String::new(), |(_, name)| format!("{name}: "));
            format!("{name}{message}; {help}")
        });
        true
    }

    /// Takes note of what this program says beside its figures.
    pub fn note(&mut self, note: String) {
        self.events.push_back(note);
        if self.events.len() > EVENTS {
            self.events.pop_front();
        }
    }

    /// Takes note of a command that was sent.
    pub fn asked(&mut self, command: Value) {
        let name = command["do"].as_str().unwrap_or_default().replace('_', " ");
        self.asked
            .push_back((command["id"].as_u64().unwrap_or_default(), name));
        self.refused = None;
    }

    /// What a session says of itself: a text of `hello`.
    pub fn word(&self, key: &str) -> Option<&str> {
        self.hello[key].as_str()
    }

    /// Whether it is a recording.
    pub fn is_recording(&self) -> bool {
        self.word("source") == Some("recording")
    }

    /// Whether this program controls it.
    pub fn controls(&self) -> bool {
        self.word("role") == Some("control")
    }

    /// Whether time stands still.
    pub fn is_paused(&self) -> bool {
        self.gauges["paused"] == true
    }

    /// For how long nothing was said of the session, if that is too long.
    pub fn silent_for(&self, now: Instant) -> Option<Duration> {
        let since = now.saturating_duration_since(self.heard);
        (since > OLD).then_some(since)
    }

    /// The console's mode.
    pub fn mode(&self) -> Option<&str> {
        let of_tick = self
            .tick
            .and_then(|(_, mode, _)| MODES.get(usize::from(mode)).copied());
        of_tick
            .or(self.gauges["mode"].as_str())
            .or(self.word("mode"))
    }

    /// Latched faults: name, what that is, what to do.
    pub fn faults(&self) -> Vec<(String, String, String)> {
        let said = |list: &Value| -> Vec<String> {
            let list = list.as_array().into_iter().flatten();
            list.filter_map(|name| name.as_str().map(str::to_owned))
                .collect()
        };
        let names = match self.tick {
            Some((_, _, bits)) => fault_names(bits),
            None => said(&self.hello["faults"]),
        };
        let word = |name: &str, key: &str| {
            let fix = self.hello["fixes"][name][key].as_str();
            fix.unwrap_or_default().to_owned()
        };
        let with_fix = |name: String| {
            let (message, help) = (word(&name, "message"), word(&name, "help"));
            (name, message, help)
        };
        names.into_iter().map(with_fix).collect()
    }

    /// Force on the grip \[N\].
    pub fn force_n(&self) -> Option<f64> {
        self.tick.map(|(force_n, ..)| force_n)
    }

    /// The largest that is kept \[N\].
    pub fn most_n(&self) -> f64 {
        self.forces.iter().map(|(_, n)| *n).fold(0.0, f64::max)
    }

    /// The largest force in each of so many parts of the last 30 s \[N\]; none where there was no tick.
    pub fn force_line(&self, parts: usize) -> Vec<Option<f64>> {
        let mut line = vec![None; parts];
        let newest_s = self.forces.back().map_or(0.0, |(time_s, _)| *time_s);
        for (time_s, force_n) in &self.forces {
            let back = (newest_s - time_s) / KEPT_S * parts as f64;
            let at = parts.checked_sub(1 + back as usize);
            if let Some(place) = at.and_then(|at| line.get_mut(at)) {
                *place = Some(place.map_or(*force_n, |most: f64| most.max(*force_n)));
            }
        }
        line
    }

    /// How old a contact may be \[us\].
    pub fn horizon_us(&self) -> Option<f64> {
        self.hello["horizon_ms"].as_f64().map(|ms| 1e3 * ms)
    }

    /// Percentiles of the last moment and of the session.
    pub fn spread(&self, key: &str) -> [Option<Spread>; 2] {
        ["now", "all"].map(|when| {
            let of = &self.gauges[key][when];
            Some([of["p50"].as_f64()?, of["p99"].as_f64()?])
        })
    }

    /// A figure of the gauges, by keys one inside the other.
    pub fn number(&self, keys: &[&str]) -> Option<f64> {
        let found = keys.iter().fold(&self.gauges, |value, key| &value[*key]);
        found.as_f64()
    }

    /// Steps a second that the session asks for \[Hz\].
    pub fn wanted_hz(&self) -> Option<f64> {
        self.hello["host_hz"].as_f64()
    }

    /// Stages of a step with what each took of late on average \[us\], and then what none names; without the wait where there is
    /// none, as in real time.
    pub fn stages(&self) -> Vec<(String, Option<f64>)> {
        let names = self.hello["stages"].as_array().into_iter().flatten();
        let names = names.filter_map(Value::as_str).enumerate();
        let us = |place: usize| self.gauges["stages_us"][place].as_f64();
        let each = names.map(|(at, name)| (name.to_owned(), us(at)));
        let said =
            |(name, us): &(String, Option<f64>)| name != "wait" || us.is_some_and(|us| us > 0.0);
        let mut all: Vec<_> = each.filter(said).collect();
        all.push(("rest".to_owned(), self.number(&["rest_us"])));
        all
    }

    /// How solves have ended: a word and how many.
    pub fn statuses(&self) -> Vec<(String, u64)> {
        let Some(all) = self.gauges["solves"].as_u64() else {
            return Vec::new();
        };
        let withheld = self.gauges["withheld"].as_object().into_iter().flatten();
        let withheld: Vec<(String, u64)> = withheld
            .filter_map(|(word, count)| Some((word.clone(), count.as_u64()?)))
            .collect();
        let others: u64 = withheld.iter().map(|(_, count)| count).sum();
        let mut said = vec![("ok".to_owned(), all.saturating_sub(others))];
        said.extend(withheld);
        said
    }

    /// Ticks in which a limit of the device took a part of the force away, by limit, where there are any.
    pub fn limited(&self) -> Vec<(String, u64)> {
        let limits = self.gauges["ticks_limited"]
            .as_object()
            .into_iter()
            .flatten();
        limits
            .filter_map(|(name, count)| Some((name.clone(), count.as_u64()?)))
            .filter(|(_, count)| *count > 0)
            .collect()
    }

    /// What has happened, the newest last.
    pub fn events(&self) -> impl DoubleEndedIterator<Item = &str> {
        self.events.iter().map(String::as_str)
    }

    /// Why the last command was not done.
    pub fn refused(&self) -> Option<&str> {
        self.refused.as_deref()
    }

    /// The figures in a line, or as the gauges' object; none before there are any.
    pub fn line(&self, as_json: bool) -> Option<String> {
        if self.gauges.is_null() {
            return None;
        }
        if as_json {
            return Some(self.gauges.to_string());
        }
        let number = |keys: &[&str], decimals: usize| {
            let value = self.number(keys);
            value.map_or("–".to_owned(), |value| format!("{value:.decimals$}"))
        };
        let ms = |key: &str| match self.spread(key) {
            [Some([p50, p99]), _] => format!("{:.1}/{:.1} ms", 1e-3 * p50, 1e-3 * p99),
            [None, _] => "–".to_owned(),
        };
        let faults: Vec<String> = self
            .faults()
            .into_iter()
            .map(|(name, message, help)| format!("  {name}: {message}; {help}"))
            .collect();
        Some(format!(
            "{} s  {}  {} N  latency {}  age {}  step {}  energy {} J  late {}  overruns {}  lost {}  rejected {}  speed {}{}",
            number(&["time_s"], 2),
            self.mode().unwrap_or("–"),
            self.force_n()
                .map_or("–".to_owned(), |force_n| format!("{force_n:.3}")),
            ms("latency_us"),
            ms("age_us"),
            ms("step_us"),
            number(&["energy_j"], 6),
            number(&["ticks_late"], 0),
            number(&["tick_overruns"], 0),
            number(&["frames", "lost"], 0),
            number(&["frames", "rejected"], 0),
            number(&["speed"], 2),
            faults.concat(),
        ))
    }
}

/// What a session in real time may say, for tests of the screen.
#[cfg(test)]
pub fn example(now: Instant) -> Figures {
    use serde_json::json;
    use sutura_host::picture::{TickRow, encode_ticks};
    use sutura_shared::wire::faults;
    use sutura_shared::wire::message::{Mode, State};
    let mut figures = Figures::new(now);
    let fixes = faults::NAMES.iter().map(|(bit, name)| {
        let (message, help) = sutura_host::session::fault_words(*bit);
        let fix = json!({"message": message, "help": help});
        ((*name).to_owned(), fix)
    });
    let hello = json!({
        "kind": "hello", "session": 1, "version": "0.1.0", "scene": "palpation", "tissue": "linear", "rendering": "rows",
        "device": "delta-3", "console": "/dev/ttyACM0", "source": "live", "pace": "real-time", "role": "control",
        "host_hz": 250.0, "horizon_ms": 20.0, "mode": "idle", "faults": [],
        "stages": ["approach", "tissue", "detect", "columns", "solve", "field", "reduce", "look", "wait"],
        "fixes": fixes.collect::<serde_json::Map<_, _>>(),
    });
    let both = |p50: f64, p99: f64| json!({"now": {"p50": p50, "p99": p99}, "all": {"p50": p50, "p99": 2.0 * p99}});
    let gauges = json!({
        "kind": "gauges", "session": 1, "time_s": 12.5, "tick": 12500, "mode": "armed", "faults": [],
        "latency_us": both(3200.0, 4800.0), "age_us": both(5100.0, 7900.0), "step_us": both(810.0, 1240.0),
        "stages_us": [0.0, 12.0, 55.0, 90.0, 480.0, 0.0, 31.0, 120.0, 0.0], "rest_us": 22.0,
        "rtt_us": {"now": {"p50": 910.0, "p99": 1400.0}, "all": {"p50": 905.0, "p99": 2100.0}},
        "bytes_per_s": {"down": 44500.0, "up": 51200.0}, "sessions": 1,
        "ticks_late": 3, "tick_overruns": 0, "frames": {"lost": 1, "rejected": 0, "superseded": 12},
        "solves": 3100, "withheld": {"waiting": 7}, "energy_j": 0.00123, "energy_min_j": -0.000004, "force_n": 1.5,
        "host_hz": 249.8, "speed": 1.0, "paused": false,
    });
    let rows: Vec<TickRow> = (0..12_500)
        .map(|tick| TickRow {
            time_s: 1e-3 * f64::from(tick),
            state: State {
                tick,
                force_n: [0.0, 0.0, 1.5 * (tick as f32 / 2000.0).sin().abs()],
                mode: Mode::Armed,
                contact_age_us: 4100,
                faults: 0,
                position_m: [0.0; 3],
                orientation: [0.0, 0.0, 0.0, 1.0],
                velocity_m_per_s: [0.0; 3],
                current_a: [0.0; 3],
                contact_sequence: 1,
                applied_age_us: 3100,
                trace_hash: 1,
                encoder_counts: [0; 3],
                inputs: 0,
                heard_sequence: 0,
            },
        })
        .collect();
    let mut bytes = Vec::new();
    encode_ticks(1, &rows, &mut bytes);
    let event =
        json!({"kind": "event", "time_s": 0.0, "what": "armed", "text": "the console is armed"});
    let said = [hello, gauges, event].map(Message::Text);
    for message in said.into_iter().chain([Message::Binary(bytes)]) {
        figures.hear(&message, now);
    }
    figures
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn what_is_not_said_is_no_number() {
        let now = Instant::now();
        let mut figures = Figures::new(now);
        assert_eq!(
            (figures.force_n(), figures.mode(), figures.line(false)),
            (None, None, None)
        );
        assert_eq!(figures.spread("rtt_us"), [None, None]);
        let gauges =
            json!({"kind": "gauges", "rtt_us": {"now": null, "all": null}, "ticks_late": null});
        assert!(figures.hear(&Message::Text(gauges), now));
        assert_eq!(figures.number(&["ticks_late"]), None);
        let line = figures.line(false).expect("a line");
        assert!(line.contains("late –") && line.contains("– N"), "{line}");
    }

    #[test]
    fn the_force_is_kept_for_thirty_seconds_with_its_peaks() {
        let figures = example(Instant::now());
        let line = figures.force_line(30);
        // 12.5 s of 30: the rest is not there.
        assert_eq!(line.iter().filter(|part| part.is_none()).count(), 17);
        let most = line.iter().flatten().copied().fold(0.0, f64::max);
        assert!((most - 1.5).abs() < 1e-3 && most == figures.most_n());
        assert_eq!(figures.statuses()[0], ("ok".to_owned(), 3093));
    }

    /// Another session's figures are void; what was refused says so in this program's words.
    #[test]
    fn a_new_session_begins_with_nothing() {
        let now = Instant::now();
        let mut figures = example(now);
        figures.asked(json!({"id": 4, "do": "clear_fault"}));
        let error = json!({"message": "no", "help": "say `take_control` first"});
        figures.hear(&Message::Text(json!({"re": 4, "error": error})), now);
        assert_eq!(
            figures.refused(),
            Some("clear fault: no; t takes the controls")
        );
        figures.hear(
            &Message::Text(json!({"kind": "hello", "session": 2, "mode": "idle"})),
            now,
        );
        assert_eq!(
            (figures.force_n(), figures.most_n(), figures.mode()),
            (None, 0.0, Some("idle"))
        );
    }
}
