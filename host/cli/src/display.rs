//! How a session shows itself: a bar while it runs, a table or an object when it is over.
//!
//! Entry points: [`Display`], [`table`], [`object`].

use crate::Format;
use crate::failure::Cause;
use indicatif::{ProgressBar, ProgressStyle};
use schemars::JsonSchema;
use serde::Serialize;
use std::fmt::{Arguments, Write as _};
use std::io::{self, IsTerminal, Write as _};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use sutura_host::session::{GivenUp, LimitedTicks, Progress, SafeStop, Summary, mode_word};
use sutura_host::text::{escaped, escaped_json, one_line};

/// Lines that are kept while the terminal is drawn on: those that are new, and all that have not been printed.
static HELD: Mutex<Option<[Vec<String>; 2]>> = Mutex::new(None);
/// Lines that are kept at most.
const MOST_HELD: usize = 1000;

fn held() -> MutexGuard<'static, Option<[Vec<String>; 2]>> {
    HELD.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A line on stderr, if anybody reads it; kept where the terminal is drawn on. Foreign text in it steers no terminal and ends no line.
pub fn note(text: Arguments<'_>) {
    let text = one_line(&text.to_string());
    if let Some([new, all]) = held().as_mut() {
        if all.len() < MOST_HELD {
            new.push(text.clone());
            all.push(text);
        }
        return;
    }
    let _ = writeln!(io::stderr(), "{text}");
}

/// Lines are kept from now on: the terminal is drawn on.
#[cfg(feature = "top")]
pub fn hold_notes() {
    held().get_or_insert_default();
}

/// The lines that are new.
#[cfg(feature = "top")]
pub fn take_notes() -> Vec<String> {
    held()
        .as_mut()
        .map(|[new, _]| std::mem::take(new))
        .unwrap_or_default()
}

/// Prints what was kept, and keeps no more.
#[cfg(feature = "top")]
pub fn release_notes() {
    let kept = held().take();
    for line in kept.into_iter().flat_map(|[_, all]| all) {
        note!("{line}");
    }
}

/// Where logs go: to stderr, line by line, as notes.
pub struct Log;

impl io::Write for Log {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let text = String::from_utf8_lossy(bytes);
        if held().is_none() {
            io::stderr().write_all(with_colours(&text).as_bytes())?;
        } else {
            note!("{}", without_colours(text.trim_end()));
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        io::stderr().flush()
    }
}

/// A line that steers a terminal by nothing but colours, with its end.
fn with_colours(text: &str) -> String {
    let (text, end) = match text.strip_suffix('\n') {
        Some(text) => (text, "\n"),
        None => (text, ""),
    };
    let mut parts = text.split('\x1b');
    let first = one_line(parts.next().unwrap_or_default());
    let shown = parts.fold(first, |text, part| {
        let rest = part.trim_start_matches(|c: char| c.is_ascii_digit() || "[;".contains(c));
        let is_colour = part.starts_with('[') && rest.starts_with('m');
        let mark = if is_colour { "\x1b" } else { "\\u{1b}" };
        text + mark + &one_line(part)
    });
    shown + end
}

/// A text without what makes terminals colour it.
fn without_colours(text: &str) -> String {
    let mut parts = text.split('\x1b');
    let first = parts.next().unwrap_or_default().to_owned();
    parts.fold(first, |text, part| {
        text + part.split_once('m').map_or(part, |(_, rest)| rest)
    })
}

/// A line on stdout, in JSON or in words; whether it could be written.
#[cfg(feature = "top")]
pub fn tell(text: &str, format: Format) -> bool {
    let text = match format {
        Format::Json => escaped_json(text),
        Format::Text => one_line(text),
    };
    let mut out = io::stdout();
    writeln!(out, "{text}").and_then(|()| out.flush()).is_ok()
}

/// A line on stdout, in which foreign text steers no terminal and ends no line. That nobody reads it is not a failure; a full disk ends
/// the command with code 1.
pub fn say(text: Arguments<'_>) {
    line(&one_line(&text.to_string()));
}

/// Lines on stdout, as [`say`] prints one. Foreign text in them has gone through [`one_line`].
pub fn lines(text: &str) {
    line(&escaped(text));
}

fn line(text: &str) {
    match writeln!(io::stdout(), "{text}") {
        Err(error) if error.kind() != io::ErrorKind::BrokenPipe => {
            note!("the result cannot be written: {error}");
            std::process::exit(i32::from(Cause::Failed.code()));
        }
        _ => {}
    }
}

/// A bar on a terminal for so many parts of a command; nothing where stderr is no terminal.
pub fn progress(length: usize) -> ProgressBar {
    let bar = ProgressBar::new(length as u64);
    match ProgressStyle::with_template("{bar:30} {pos}/{len} {msg}") {
        Ok(style) => bar.with_style(style),
        Err(_) => bar,
    }
}

/// Shows how far a session is.
pub struct Display {
    bar: Option<ProgressBar>,
    stream: bool,
    /// Tells how far it is, where stderr is no terminal.
    teller: Option<Teller>,
}

/// Pace of a session.
#[derive(Debug)]
struct Pace {
    /// Whether it takes the time that the clock does, and ends when it is to end.
    real_time: bool,
    began: Instant,
    /// Newest note, and last line.
    heard: Instant,
    said: Instant,
    elapsed_s: f64,
    seconds: f64,
}

impl Pace {
    /// Returns the line that is due, if any, and how long it is until another may be.
    fn tell(&mut self, now: Instant) -> (Option<String>, Duration) {
        let silent = now.saturating_duration_since(self.said);
        if silent < SILENT {
            return (None, SILENT - silent);
        }
        self.said = now;
        let so_far_s = now.saturating_duration_since(self.began).as_secs_f64();
        let step = now.saturating_duration_since(self.heard);
        let Self {
            real_time,
            elapsed_s,
            seconds,
            ..
        } = self;
        let keeps_time = *real_time && *elapsed_s > 0.5 * so_far_s && step <= LONG_STEP;
        let line = (!keeps_time).then(|| {
            let step = match step > LONG_STEP {
                true => format!(", {:.0} s of them in one place", step.as_secs_f64()),
                false => String::new(),
            };
            format!("{elapsed_s:.1} of {seconds:.1} s after {so_far_s:.0} s{step} ..")
        });
        (line, SILENT)
    }
}

/// Thread that tells the pace of a session while that is at work, in the midst of a step, too.
struct Teller {
    pace: Arc<(Mutex<Option<Pace>>, Condvar)>,
    thread: Option<JoinHandle<()>>,
}

impl Teller {
    fn start(seconds: f64, real_time: bool) -> Self {
        let now = Instant::now();
        let pace = Pace {
            real_time,
            began: now,
            heard: now,
            said: now,
            elapsed_s: 0.0,
            seconds,
        };
        let pace = Arc::new((Mutex::new(Some(pace)), Condvar::new()));
        let shared = pace.clone();
        let tell = move || {
            let (pace, ended) = &*shared;
            let mut guard = pace.lock().unwrap_or_else(PoisonError::into_inner);
            while let Some(pace) = guard.as_mut() {
                let (line, wait) = pace.tell(Instant::now());
                if let Some(line) = line {
                    note!("{line}");
                }
                let waited = ended.wait_timeout(guard, wait);
                guard = waited.unwrap_or_else(PoisonError::into_inner).0;
            }
        };
        let thread = std::thread::Builder::new().name("sutura-pace".to_owned());
        // Without it the session goes on in silence.
        let thread = thread.spawn(tell).ok();
        Self { pace, thread }
    }

    fn hear(&self, note: &Progress<'_>) {
        let mut guard = self.pace.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(pace) = guard.as_mut() {
            (pace.elapsed_s, pace.seconds) = (note.elapsed_s, note.seconds);
            pace.heard = Instant::now();
        }
    }
}

impl Drop for Teller {
    fn drop(&mut self) {
        let (pace, ended) = &*self.pace;
        *pace.lock().unwrap_or_else(PoisonError::into_inner) = None;
        ended.notify_all();
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Steps of the bar per second of the session.
const PER_SECOND: f64 = 1000.0;
/// Time without a word after which somebody who reads a log wonders whether a session goes on.
const SILENT: Duration = Duration::from_secs(10);
/// Longer than this without a note, and it is a step that lasts.
const LONG_STEP: Duration = Duration::from_secs(5);

impl Display {
    /// A bar if stderr is a terminal, lines of JSON if `stream`.
    /// Neither where `other` is shown in its place. Without them a session of `seconds` says every ten seconds how far it is, unless
    /// it is in real time and keeps up.
    pub fn new(
        stream: bool,
        format: Format,
        other: bool,
        seconds: f64,
        real_time: bool,
    ) -> Display {
        let visible = !other && io::stderr().is_terminal() && !(stream && format == Format::Text);
        let style = ProgressStyle::with_template("{elapsed_precise} {bar:32} {msg}");
        let bar = visible.then(|| {
            ProgressBar::new(0).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
        });
        if let Some(bar) = &bar {
            // Its time goes on while a step lasts.
            bar.enable_steady_tick(Duration::from_millis(500));
        }
        let is_silent = bar.is_none() && !other && !stream;
        let teller = is_silent.then(|| Teller::start(seconds, real_time));
        Display {
            bar,
            stream,
            teller,
        }
    }

    /// Shows one note.
    ///
    /// # Errors
    /// When nobody reads the stream any more.
    pub fn show(&mut self, note: &Progress<'_>) -> io::Result<()> {
        let Some(state) = note.state else {
            return Ok(());
        };
        let force_n = state
            .force_n
            .iter()
            .map(|f| f64::from(*f).powi(2))
            .sum::<f64>()
            .sqrt();
        let mode = mode_word(state.mode);
        if let Some(bar) = &self.bar {
            bar.set_length((note.seconds * PER_SECOND) as u64);
            bar.set_position((note.elapsed_s * PER_SECOND) as u64);
            bar.set_message(format!(
                "{:.1} of {:.1} s  {mode}  {force_n:.2} N",
                note.elapsed_s, note.seconds
            ));
        }
        if let Some(teller) = &self.teller {
            teller.hear(note);
        }
        if self.stream {
            let age_us = state.contact_age_us;
            let line = Line {
                elapsed_s: note.elapsed_s,
                tick: state.tick,
                mode,
                position_m: state.position_m,
                force_n: state.force_n,
                age_ms: (age_us != u32::MAX).then(|| f64::from(age_us) / 1e3),
                ticks_late: note.report.map(|report| report.ticks_late),
            };
            writeln!(io::stdout(), "{}", serde_json::to_string(&line)?)?;
        }
        Ok(())
    }

    /// Takes the bar away.
    pub fn finish(&mut self) {
        self.teller = None;
        if let Some(bar) = self.bar.take() {
            bar.finish_and_clear();
        }
    }
}

/// A result as one JSON object on stdout.
pub fn object(result: &impl Serialize) {
    // Only maps with keys that are no text could fail; results have none.
    let text = serde_json::to_string(result).unwrap_or_default();
    line(&escaped_json(&text));
}

/// A line of `sutura run --stream`.
#[derive(Serialize, JsonSchema)]
pub struct Line {
    /// Session time \[s\].
    elapsed_s: f64,
    /// The console's tick.
    tick: u32,
    /// Control mode.
    mode: &'static str,
    /// Of the grip \[m\], (3).
    position_m: [f32; 3],
    /// On the grip \[N\], (3).
    force_n: [f32; 3],
    /// Age of the contact data in use \[ms\]; none before the first.
    age_ms: Option<f64>,
    /// Ticks that started more than a period late so far; none where the console has not said so.
    ticks_late: Option<u32>,
}

/// The summary for people.
pub fn table(summary: &Summary) -> String {
    let s = summary;
    let mut out = String::new();
    let name = s
        .scene
        .get("name")
        .and_then(|name| name.as_str())
        .unwrap_or("scene");
    let mut row = |name: &str, text: String| {
        let _ = writeln!(out, "  {name:<10} {}", one_line(&text));
    };
    row(
        "session",
        format!(
            "{:.3} s by the console's clock, {:.3} s on the wall",
            s.seconds, s.wall_s
        ),
    );
    row(
        "ticks",
        format!(
            "{} at {} Hz; {} overruns, {} woken late",
            s.ticks, s.tick_hz, s.tick_overruns, s.ticks_late
        ),
    );
    row(
        "host",
        format!(
            "{:.1} of {:.1} steps a second; {}",
            s.host_hz_reached,
            s.host_hz,
            withheld(s)
        ),
    );
    if let Some(hz) = s.board_rows_hz {
        row(
            "board",
            format!(
                "time for {hz} frames of 24 rows a second, by its device file: up to {} a frame at {} Hz",
                s.most_rows, s.host_hz
            ),
        );
    }
    let f = &s.frames;
    row(
        "frames",
        format!(
            "{} sent, {} lost, {} rejected, {} superseded",
            f.sent, f.lost, f.rejected, f.superseded
        ),
    );
    let l = &s.latency_us;
    row(
        "latency",
        format!(
            "p50 {:.1} ms, p99 {:.1} ms, p99.9 {:.1} ms, max {:.1} ms (state to force)",
            l.p50 / 1e3,
            l.p99 / 1e3,
            l.p999 / 1e3,
            l.max / 1e3
        ),
    );
    row(
        "age",
        format!(
            "p50 {:.1} ms, max {:.1} ms; {} decays, force withheld in {} ticks; horizon p50 {:.0} ms, max {:.0} ms",
            s.age_ms.p50,
            s.age_ms.max,
            s.decays,
            s.ticks_withheld,
            s.horizon_ms.p50,
            s.horizon_ms.max
        ),
    );
    if let Some(text) = limited(&s.ticks_limited) {
        row("limited", text);
    }
    for SafeStop { at_s, by } in &s.safe_stops {
        row("stopped", format!("at {at_s:.2} s by {by}"));
    }
    if s.needle_waited_steps > 0 {
        row(
            "needle",
            format!(
                "armed in the tissue: in {} steps it touched nothing, as it had not been outside",
                s.needle_waited_steps
            ),
        );
    }
    if s.steps_behind > 0 {
        row(
            "behind",
            format!(
                "in {} steps the hands were faster than a step follows, and the tissue lagged by {:.1} mm at most; in {} by more than it touched, in {} in the air with the hand in the tissue",
                s.steps_behind,
                1e3 * s.most_lag_m,
                s.steps_outrun,
                s.steps_missed
            ),
        );
    }
    let l = &s.link;
    let clock = l.clock.map_or(String::new(), |clock| {
        format!(
            "; console's clock {:+.1} ppm, known to {:.2} ms",
            clock.drift_ppm,
            clock.uncertainty_us / 1e3
        )
    });
    row(
        "link",
        format!(
            "{:.1} kB/s down, {:.1} kB/s up; round trip p50 {:.1} ms, p99 {:.1} ms{clock}",
            l.bytes_per_s.down / 1e3,
            l.bytes_per_s.up / 1e3,
            l.rtt_us.p50 / 1e3,
            l.rtt_us.p99 / 1e3
        ),
    );
    row(
        "step",
        format!(
            "p50 {:.0} us, p99 {:.0} us, max {:.0} us; with all else p99 {:.0} us, max {:.0} us",
            s.step_us.p50, s.step_us.p99, s.step_us.max, s.session_us.p99, s.session_us.max
        ),
    );
    let GivenUp {
        looks,
        rows,
        solves,
    } = s.overload;
    if s.overload != GivenUp::default() {
        row(
            "overload",
            format!("{looks} solves without looking ahead, {rows} without rows, {solves} not made"),
        );
    }
    let stages: Vec<String> = s
        .stages_us
        .iter()
        .map(|(stage, us)| format!("{stage} {us:.0}"))
        .collect();
    row("stages", format!("{} us, on average", stages.join(", ")));
    row(
        "force",
        format!(
            "peak {:.3} N, rms {:.3} N; steps found up to {:.3} N",
            s.force_n.peak, s.force_n.rms, s.force_n.solved_peak
        ),
    );
    row("energy", format!("min {:.6} J", s.energy_j.min));
    let needles = s.scene.get("needles").and_then(|list| list.as_array());
    for needle in needles.into_iter().flatten() {
        let number = |key: &str| needle[key].as_f64().unwrap_or_default();
        row(
            "needle",
            format!(
                "{}: tip {}, {} punctures, axial peak {:.3} N",
                needle["needle"],
                needle["tip"].as_str().unwrap_or_default(),
                needle["punctures"],
                number("peak_axial_n")
            ),
        );
    }
    let threads = s.scene.get("threads").and_then(|list| list.as_array());
    for thread in threads.into_iter().flatten() {
        let number = |key: &str| thread[key].as_f64().unwrap_or_default();
        row(
            "thread",
            format!(
                "{}: {}, through {} boundaries, {} spans bridge, tension peak {:.3} N",
                thread["thread"],
                thread["state"].as_str().unwrap_or_default(),
                thread["punctures"],
                thread["bridges"],
                number("peak_tension_n")
            ),
        );
    }
    for event in events(s) {
        row("event", event);
    }
    for (name, values) in added(s) {
        row(name, values);
    }
    if let Some(wound) = wound(s) {
        row("wound", wound);
    }
    row("trace", s.trace_hash.clone());
    let faults = if s.faults.is_empty() {
        String::new()
    } else {
        format!(", faults: {}", s.faults.join(", "))
    };
    let first = format!(
        "{name} on {} ({}): {}, {}{faults}",
        s.console, s.device, s.status, s.mode
    );
    format!("{}\n{out}", one_line(&first))
}

/// How well the scene's wound is closed, if it has one.
fn wound(summary: &Summary) -> Option<String> {
    let number = |key: &str| summary.scene.get(key).and_then(|value| value.as_f64());
    let mut said = Vec::new();
    if let (Some(gap), Some(ratio)) = (number("rim_gap_m"), number("gap_ratio")) {
        said.push(format!(
            "gap {:.2} mm, {:.1} % of that at the start",
            1e3 * gap,
            1e2 * ratio
        ));
    }
    if let Some(welded) = number("rim_gap_vs_welded") {
        said.push(format!("{welded:.2} times that of welded punctures"));
    }
    if let Some(bridge) = number("bridge_ratio") {
        said.push(format!("longest bridge {:.1} %", 1e2 * bridge));
    }
    if let Some(depth) = number("penetration_ratio") {
        said.push(format!("overlap {depth:.4} edges"));
    }
    if let (Some(tension), Some(pulled)) = (number("tension_n"), number("pulled_m")) {
        said.push(format!(
            "{tension:.3} N, {:.0} mm of thread pulled",
            1e3 * pulled
        ));
    }
    (!said.is_empty()).then(|| said.join("; "))
}

/// The first events of the session, and how many more there were.
fn events(summary: &Summary) -> Vec<String> {
    const SHOWN: usize = 6;
    let all = summary.scene.get("events").and_then(|all| all.as_array());
    let all = all.map_or(&[][..], Vec::as_slice);
    let mut said: Vec<String> = all.iter().take(SHOWN).map(event).collect();
    let more = summary.scene.get("more_events");
    let more = more.and_then(|more| more.as_u64()).unwrap_or(0);
    let left = all.len().saturating_sub(SHOWN) as u64 + more;
    if left > 0 {
        said.push(format!("{left} more, see `--format json`"));
    }
    said
}

fn event(event: &serde_json::Value) -> String {
    let number = |key: &str| event[key].as_f64().unwrap_or_default();
    let word = |key: &str| event[key].as_str().unwrap_or_default();
    let at = format!("{:.2} s", number("time_s"));
    match word("event") {
        "slipped" => format!(
            "{at} to {:.2} s: {:.2} mm of thread {} slipped through the grip of tool {} at its {}{}",
            number("until_s"),
            1e3 * number("length_m"),
            event["thread"],
            event["tool"],
            word("end"),
            if event["is_out"] == true {
                ", which came out of it"
            } else {
                ""
            }
        ),
        "broke" => format!(
            "{at}: thread {} broke at {:.3} N; {:.0} mm behind that are gone",
            event["thread"],
            number("tension_n"),
            1e3 * number("lost_m")
        ),
        "cut" => format!(
            "{at}: thread {} was cut {:.0} mm before the needle",
            event["thread"],
            -1e3 * number("along_m")
        ),
        "opened" => format!(
            "{at}: a knot of thread {} opened at {:.3} N",
            event["thread"],
            number("tension_n")
        ),
        "pressed" => format!(
            "{at}: thread {} presses on tissue with {:.0} kPa, which bears {:.0} kPa",
            event["thread"],
            1e-3 * number("pressure_pa"),
            1e-3 * number("tear_pa")
        ),
        "missed" => format!(
            "{at}: tool {} was to take {} {}, {:.1} mm away",
            event["tool"],
            if event["needle"].is_null() {
                "thread"
            } else {
                "needle"
            },
            if event["needle"].is_null() {
                &event["thread"]
            } else {
                &event["needle"]
            },
            1e3 * number("distance_m")
        ),
        other => format!("{at}: {other}"),
    }
}

/// What sources say that the scene adds by keys of their own: their names, and their values.
fn added(summary: &Summary) -> Vec<(&str, String)> {
    let all = summary.scene.get("added").and_then(|all| all.as_object());
    let each = all.into_iter().flatten();
    let said = each.map(|(name, values)| {
        let values = values.as_object().into_iter().flatten();
        let values =
            values.map(|(key, value)| format!("{key} {:.4}", value.as_f64().unwrap_or(0.0)));
        (name.as_str(), values.collect::<Vec<_>>().join(", "))
    });
    said.collect()
}

/// Words for the ticks that the device's limits changed, if any.
pub fn limited(ticks: &LimitedTicks) -> Option<String> {
    let counts = [
        ("force", Some(ticks.force)),
        ("power", ticks.power),
        ("speed", ticks.speed),
        ("slew", ticks.slew),
    ];
    let some = |count: Option<u64>| count.filter(|count| *count > 0);
    let counts = counts
        .into_iter()
        .filter_map(|(name, count)| Some((name, some(count)?)));
    let said: Vec<String> = counts
        .map(|(name, count)| match some(ticks.current) {
            Some(current) if name == "force" => {
                format!("force in {count} ticks, {current} of them by a motor's current")
            }
            _ => format!("{name} in {count} ticks"),
        })
        .collect();
    (!said.is_empty()).then(|| said.join(", "))
}

fn withheld(summary: &Summary) -> String {
    if summary.steps_withheld.is_empty() {
        return "every step was sent".to_owned();
    }
    let kinds: Vec<String> = summary
        .steps_withheld
        .iter()
        .map(|(why, count)| format!("{count} {why}"))
        .collect();
    format!("withheld: {}", kinds.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A step that lasts is told while it does, and so is a session of many hours; one in real time is not.
    #[test]
    fn a_session_by_its_own_time_says_how_far_it_is() {
        let began = Instant::now();
        let tell = |real_time: bool, elapsed_s: f64, heard_s: u64, now_s: u64| {
            let at = |s: u64| began + Duration::from_secs(s);
            let mut pace = Pace {
                real_time,
                began,
                heard: at(heard_s),
                said: began,
                elapsed_s,
                seconds: 20.0,
            };
            let (line, wait) = pace.tell(at(now_s));
            assert!(!wait.is_zero() && wait <= SILENT);
            line
        };
        let told = |elapsed_s, heard_s, now_s| tell(true, elapsed_s, heard_s, now_s);
        assert_eq!(told(0.7, 9, 9), None);
        let line = |text: &str| Some(text.to_owned());
        assert_eq!(told(0.7, 11, 12), line("0.7 of 20.0 s after 12 s .."));
        assert_eq!(
            told(0.7, 2, 12),
            line("0.7 of 20.0 s after 12 s, 10 s of them in one place ..")
        );
        assert_eq!(told(10.5, 11, 11), None);
        assert_eq!(
            told(10.5, 2, 12),
            line("10.5 of 20.0 s after 12 s, 10 s of them in one place ..")
        );
        for elapsed_s in [10.5, 300.0] {
            let words = format!("{elapsed_s:.1} of 20.0 s after 11 s ..");
            assert_eq!(tell(false, elapsed_s, 11, 11), Some(words));
        }
    }

    #[test]
    fn logs_have_colours_and_nothing_else_that_steers() {
        let coloured = "\x1b[33m WARN\x1b[0m good\n";
        assert_eq!(with_colours(coloured), coloured);
        assert_eq!(
            with_colours("a\x1b]0;title\x07b\x1b[2Jc\u{9b}m\x1b"),
            "a\\u{1b}]0;title\\u{7}b\\u{1b}[2Jc\\u{9b}m\\u{1b}"
        );
    }
}
