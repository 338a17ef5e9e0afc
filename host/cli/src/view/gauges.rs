//! Figures of a session while it runs, from every state and every solve.
//!
//! Entry points: [`Gauges::state`], [`Gauges::solve`], [`Gauges::said`].

use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use std::time::Instant;
use sutura_host::recording::SolveSample;
use sutura_host::session::{LimitedTicks, LinkSummary, RoundTrip, fault_names, mode_word};
use sutura_host::times::Times;
use sutura_shared::wire::message::{Mode, Report, State};

/// Longest time that percentiles tell apart \[us\].
const LONGEST_US: u64 = 100_000_000;

/// Their channel in live channels.
#[cfg(feature = "foxglove")]
pub const TOPIC: &str = "/gauges";

/// Their JSON Schema.
#[cfg(feature = "foxglove")]
pub fn schema() -> Value {
    let number = || json!({"type": ["number", "null"]});
    let of = |keys: &[&str]| {
        let keys = keys.iter().map(|key| ((*key).to_owned(), number()));
        json!({"type": ["object", "null"], "properties": keys.collect::<Map<_, _>>(), "additionalProperties": false})
    };
    let percentiles = of(&["p50", "p99"]);
    let spread = json!({
        "type": "object", "properties": {"now": percentiles, "all": percentiles}, "required": ["now", "all"],
    });
    let mut properties = Map::new();
    let mut add = |keys: &[&str], schema: &Value| {
        properties.extend(keys.iter().map(|key| ((*key).to_owned(), schema.clone())));
    };
    add(&["kind", "mode"], &json!({"type": "string"}));
    add(
        &["faults"],
        &json!({"type": "array", "items": {"type": "string"}}),
    );
    add(&["latency_us", "age_us", "step_us", "rtt_us"], &spread);
    add(
        &["stages_us"],
        &json!({"type": ["array", "null"], "items": {"type": "number"}}),
    );
    add(&["frames"], &of(&["lost", "rejected", "superseded"]));
    add(
        &["ticks_limited"],
        &of(&["force", "current", "power", "speed", "slew"]),
    );
    add(&["bytes_per_s"], &of(&["down", "up"]));
    add(&["pictures"], &of(&["wanted", "made", "sent"]));
    add(
        &["withheld"],
        &json!({"type": "object", "additionalProperties": {"type": "integer"}}),
    );
    add(
        &["paused", "controller", "connected"],
        &json!({"type": "boolean"}),
    );
    add(&["recording"], &json!({"type": ["boolean", "null"]}));
    add(&["stopped_by"], &json!({"type": ["string", "null"]}));
    add(&["wall_latency_us"], &percentiles);
    let numbers = [
        "session",
        "time_s",
        "tick",
        "rest_us",
        "sessions",
        "ticks_late",
        "tick_overruns",
        "solves",
        "energy_j",
        "energy_min_j",
        "force_n",
        "host_hz",
        "rows_hz",
        "wall_hz",
        "speed",
        "wanted_speed",
        "picture_hz",
        "picture_us",
        "clients",
    ];
    add(&numbers, &number());
    json!({
        "$schema": "https://json-schema.org/draft/2020-12/schema", "title": "Gauges", "type": "object",
        "required": properties.keys().collect::<Vec<_>>(), "properties": properties, "additionalProperties": false,
    })
}

/// A time: all of the session, and what came since figures were said last.
struct Spread {
    all: Times,
    now: Times,
}

impl Spread {
    fn new() -> Self {
        Self {
            all: Times::new(LONGEST_US),
            now: Times::new(LONGEST_US),
        }
    }

    fn record(&mut self, us: u64) {
        self.all.record(us);
        self.now.record(us);
    }

    /// Percentiles, and what comes now begins anew.
    fn said(&mut self) -> Value {
        let now = std::mem::replace(&mut self.now, Times::new(LONGEST_US));
        let percentiles = |times: &Times| {
            let is_empty = times.quantile(1.0) == 0;
            (!is_empty).then(|| json!({"p50": times.quantile(0.5), "p99": times.quantile(0.99)}))
        };
        json!({"now": percentiles(&now), "all": percentiles(&self.all)})
    }
}

/// The figures.
pub struct Gauges {
    latency: Spread,
    age: Spread,
    step: Spread,
    last: Option<State>,
    energy_j: f64,
    energy_min_j: f64,
    withheld: BTreeMap<String, u64>,
    /// Solves of the session.
    all_solves: u64,
    /// Sums of solves that say what their stages took since figures were said last: how many, their steps, their stages \[us\].
    staged: (u64, f64, Vec<f64>),
    /// Of the newest state \[s\], and when figures were said last: on the wall, then.
    time_s: f64,
    said: (Instant, f64),
    /// Solves since then, and those of which the console was sent rows.
    solves: u64,
    with_rows: u64,
}

impl Gauges {
    /// Nothing has happened yet.
    pub fn new() -> Self {
        Self {
            latency: Spread::new(),
            age: Spread::new(),
            step: Spread::new(),
            last: None,
            energy_j: 0.0,
            energy_min_j: 0.0,
            withheld: BTreeMap::new(),
            all_solves: 0,
            staged: (0, 0.0, Vec::new()),
            time_s: 0.0,
            said: (Instant::now(), 0.0),
            solves: 0,
            with_rows: 0,
        }
    }

    /// Takes note of a state.
    pub fn state(&mut self, time_s: f64, state: &State) {
        let renders = matches!(state.mode, Mode::Armed | Mode::Decaying);
        if renders && state.contact_age_us != u32::MAX {
            self.age.record(u64::from(state.contact_age_us));
        }
        if let Some(before) = &self.last {
            if before.contact_sequence != state.contact_sequence {
                self.latency.record(u64::from(state.applied_age_us));
            }
            // The passivity observer: what the hand has put in.
            let work = (0..3).map(|i| {
                f64::from(before.force_n[i]) * f64::from(state.position_m[i] - before.position_m[i])
            });
            self.energy_j -= work.sum::<f64>();
            self.energy_min_j = self.energy_min_j.min(self.energy_j);
        }
        self.last = Some(*state);
        self.time_s = time_s;
    }

    /// Takes note of a solve.
    pub fn solve(&mut self, sample: &SolveSample) {
        self.solves += 1;
        self.with_rows += u64::from(sample.console_rows > 0);
        self.all_solves += 1;
        if !sample.stages_us.is_empty() {
            let (count, step_us, stages_us) = &mut self.staged;
            (*count, *step_us) = (*count + 1, *step_us + sample.step_us);
            stages_us.resize(sample.stages_us.len(), 0.0);
            for (sum, us) in stages_us.iter_mut().zip(&sample.stages_us) {
                *sum += us;
            }
        }
        self.step.record(sample.step_us as u64);
        if sample.status != "ok" {
            *self.withheld.entry(sample.status.clone()).or_default() += 1;
        }
    }

    /// The newest state.
    pub fn newest(&self) -> Option<&State> {
        self.last.as_ref()
    }

    /// Session time of the newest state \[s\].
    pub fn time_s(&self) -> f64 {
        self.time_s
    }

    /// What each stage took on average since this was asked last, and the rest of the step \[us\]; null where no solve says.
    fn staged(&mut self) -> (Value, Value) {
        let (count, step_us, stages_us) = std::mem::take(&mut self.staged);
        if count == 0 {
            return (Value::Null, Value::Null);
        }
        let mean = |sum: f64| sum / count as f64;
        let rest_us = mean(step_us - stages_us.iter().sum::<f64>());
        let stages_us: Vec<f64> = stages_us.into_iter().map(mean).collect();
        (json!(stages_us), json!(rest_us.max(0.0)))
    }

    /// Figures since this was asked last, and of the whole session.
    pub fn said(
        &mut self,
        report: Option<&Report>,
        link: Option<&LinkSummary>,
        limited: Option<LimitedTicks>,
    ) -> Map<String, Value> {
        let (stages_us, rest_us) = self.staged();
        let trips = |rtt: Option<RoundTrip>| {
            let rtt = rtt.filter(|rtt| rtt.max > 0.0);
            rtt.map(|rtt| json!({"p50": rtt.p50, "p99": rtt.p99}))
        };
        let (then, before_s) = std::mem::replace(&mut self.said, (Instant::now(), self.time_s));
        let wall_s = then.elapsed().as_secs_f64();
        let passed_s = self.time_s - before_s;
        let solves = std::mem::take(&mut self.solves);
        let with_rows = std::mem::take(&mut self.with_rows);
        let a_second = |count: u64| (passed_s > 0.0).then(|| count as f64 / passed_s);
        let wall_hz = (passed_s > 0.0 && wall_s > 0.0).then(|| solves as f64 / wall_s);
        let latency_us = self.latency.said();
        // Latencies are counted in ticks: on the wall each of these took so many times as long.
        let slower = (passed_s > 0.0).then(|| wall_s / passed_s);
        let on_wall = |part: &str| latency_us["now"][part].as_f64().zip(slower);
        let on_wall = |part: &str| on_wall(part).map(|(us, slower)| us * slower);
        let wall_latency_us = on_wall("p50").zip(on_wall("p99"));
        let wall_latency_us = wall_latency_us.map(|(p50, p99)| json!({"p50": p50, "p99": p99}));
        let state = self.last.as_ref();
        let force_n = state.map_or(0.0, |state| {
            state
                .force_n
                .iter()
                .map(|f| f64::from(*f).powi(2))
                .sum::<f64>()
                .sqrt()
        });
        let counted = |of: fn(&Report) -> u32| report.map(of);
        let said = json!({
            "time_s": self.time_s,
            "tick": state.map_or(0, |state| state.tick),
            "mode": state.map_or("boot", |state| mode_word(state.mode)),
            "faults": fault_names(state.map_or(0, |state| state.faults)),
            "latency_us": latency_us,
            "wall_latency_us": wall_latency_us,
            "age_us": self.age.said(),
            "step_us": self.step.said(),
            "stages_us": stages_us,
            "rest_us": rest_us,
            "rtt_us": {"now": trips(link.map(|link| link.rtt_now_us)), "all": trips(link.map(|link| link.rtt_us))},
            "bytes_per_s": link.map(|link| link.bytes_per_s),
            "sessions": link.map(|link| link.sessions),
            "ticks_late": counted(|report| report.ticks_late),
            "tick_overruns": counted(|report| report.tick_overruns),
            "frames": {
                "lost": counted(|report| report.frames_lost),
                "rejected": counted(|report| report.frames_rejected),
                "superseded": counted(|report| report.frames_superseded),
            },
            "ticks_limited": limited,
            "solves": self.all_solves,
            "withheld": self.withheld,
            "energy_j": self.energy_j,
            "energy_min_j": self.energy_min_j,
            "force_n": force_n,
            "host_hz": a_second(solves),
            "rows_hz": a_second(with_rows),
            "wall_hz": wall_hz,
            "speed": if wall_s > 0.0 { passed_s / wall_s } else { 0.0 },
        });
        match said {
            Value::Object(said) => said,
            _ => Map::new(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;
    use sutura_shared::console_endpoint::Sample;

    /// Ten solves in a tenth of a second, of which four had rows for the console; then none, and then time that stands still.
    #[test]
    fn solves_and_rows_are_counted_a_second_by_the_consoles_time() {
        let mut gauges = Gauges::new();
        let mut after = |time_s: f64, solves: u32| {
            for solve in 0..solves {
                let sample = json!({
                    "console_time_us": 0, "status": "ok", "state_hash": "", "wrench": null, "gap_m": null, "rows": 3, "step_us": 1.0,
                    "console_rows": if solve < 4 { 12 } else { 0 },
                });
                gauges.solve(&serde_json::from_value(sample).expect("a solve"));
            }
            gauges.state(time_s, &Sample::BEFORE_THE_FIRST.state);
            let said = gauges.said(None, None, None);
            let rate = |key: &str| said[key].as_f64().map(f64::round);
            (rate("host_hz"), rate("rows_hz"))
        };
        assert_eq!(after(0.1, 10), (Some(100.0), Some(40.0)));
        assert_eq!(after(0.2, 0), (Some(0.0), Some(0.0)));
        assert_eq!(after(0.2, 2), (None, None));
        assert_eq!(after(0.3, 1), (Some(10.0), Some(10.0)));
    }

    /// While the wall clock has gone ten times as far as the session's, ten times fewer solves come in its second, and each
    /// contact is felt ten times as late.
    #[test]
    fn a_session_that_is_slow_is_told_by_the_clock_on_the_wall() {
        let mut gauges = Gauges::new();
        let mut state = Sample::BEFORE_THE_FIRST.state;
        gauges.state(0.0, &state);
        (state.contact_sequence, state.applied_age_us) = (1, 5000);
        gauges.state(0.1, &state);
        let solve = json!({
            "console_time_us": 0, "status": "ok", "state_hash": "", "wrench": null, "gap_m": null, "rows": 3, "step_us": 170e3,
        });
        let solve = serde_json::from_value(solve).expect("a solve");
        (0..20).for_each(|_| gauges.solve(&solve));
        gauges.said.0 = Instant::now() - Duration::from_secs(1);
        let said = gauges.said(None, None, None);
        let number = |value: &Value| value.as_f64().expect("a number");
        let speed = number(&said["speed"]);
        assert!((number(&said["host_hz"]) - 200.0).abs() < 1e-9, "{said:?}");
        assert!(
            (number(&said["wall_hz"]) / speed - 200.0).abs() < 1e-6,
            "{said:?}"
        );
        let [latency, on_wall] = ["latency_us", "wall_latency_us"].map(|key| &said[key]);
        let on_wall_us = number(&on_wall["p50"]) * speed;
        assert!(
            (on_wall_us - number(&latency["now"]["p50"])).abs() < 1e-6,
            "{said:?}"
        );
        assert!(speed < 0.1001 && on_wall_us > 4900.0, "{said:?}");
        // Time that stands still has no rate.
        assert!(gauges.said(None, None, None)["wall_hz"].is_null());
    }
}
