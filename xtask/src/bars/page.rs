//! What a page costs a session, and what it does for its user: the solver's time on a core, memory, pictures, safe stop.
//! Entry point: [`all`]. The clients are programs that read as a browser does, slowly, or not at all.

use super::client::{ARMED, Client, Said};
use super::judge::Verdict;
use crate::run::{Tool, root};
use anyhow::{Context, Result, bail};
use serde::Serialize;
use serde_json::{Value, json};
use std::fmt::Write;
use std::io::{BufRead as _, BufReader, Read as _};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{JoinHandle, sleep};
use std::time::{Duration, Instant};

/// For a scene to be built and run to its end.
const LONG: Duration = Duration::from_secs(120);
/// Scenes whose solver is watched.
const SCENES: [&str; 2] = ["palpation", "anastomosis-20"];
/// Of the solver's time on a core, and at least so much \[us\].
const NEAR: f64 = 0.05;
const NEAR_US: f64 = 30.0;
/// What a client that stands still may cost \[MB\], for so long.
const GROWTH_MB: f64 = 8.0;
const STANDS: Duration = Duration::from_secs(60);
/// The host keeps so much for newcomers: before that it grows by itself.
const FILLS: Duration = Duration::from_secs(65);
/// Age of what a client that goes on is shown \[ms\], after the two pictures that were underway.
const AGE_MS: f64 = 200.0;
const UNDERWAY: usize = 2;
/// Of the pictures that are made, that others do not get \[%\].
const OTHERS: f64 = 5.0;
const TRIALS: usize = 200;
/// From a safe stop to the order that disarms, 99 of 100 \[ms\].
const STOP_MS: f64 = 20.0;

/// One bar and what was measured for it.
#[derive(Debug, Serialize)]
pub struct Figure {
    pub name: String,
    pub verdict: Verdict,
    pub unit: &'static str,
    /// What is compared with the limit.
    pub judged: f64,
    pub limit: f64,
    /// All that was measured, ascending.
    pub values: Vec<f64>,
}

impl Figure {
    /// Judged by the value below which this share of all is.
    fn new(
        name: impl Into<String>,
        unit: &'static str,
        limit: f64,
        share: f64,
        mut values: Vec<f64>,
    ) -> Self {
        values.sort_by(f64::total_cmp);
        let place = (share * values.len() as f64).ceil() as usize;
        let judged = values.get(place.saturating_sub(1)).copied();
        let judged = judged.unwrap_or(f64::NAN);
        Self {
            name: name.into(),
            verdict: if judged <= limit {
                Verdict::Met
            } else {
                Verdict::Missed
            },
            unit,
            judged,
            limit,
            values,
        }
    }

    pub fn is_missed(&self) -> bool {
        self.verdict == Verdict::Missed
    }
}

/// A line for each.
pub fn table(figures: &[Figure]) -> String {
    let mut text = String::new();
    for figure in figures {
        let word = if figure.is_missed() {
            "MISSED"
        } else {
            "met   "
        };
        let end = |value: Option<&f64>| value.copied().unwrap_or(f64::NAN);
        let median = figure.values.get(figure.values.len() / 2);
        let _ = writeln!(
            text,
            "  {word}  {}: {:.1} {}, limit {:.1} (of {}: median {:.1}, least {:.1}, largest {:.1})",
            figure.name,
            figure.judged,
            figure.unit,
            figure.limit,
            figure.values.len(),
            end(median),
            end(figure.values.first()),
            end(figure.values.last()),
        );
    }
    text
}

/// Measures everything; `pairs` runs of each scene with each kind of clients.
///
/// # Errors
/// What keeps it from being measured.
pub fn all(program: &Path, pairs: u32) -> Result<Vec<Figure>> {
    let mut figures = Vec::new();
    let mut add = |more: Vec<Figure>| {
        eprintln!("{}", table(&more));
        figures.extend(more);
    };
    for scene in SCENES {
        add(solver(program, scene, pairs)?);
    }
    add(stops(program)?);
    add(slow_client(program)?);
    add(stopped_client(program)?);
    Ok(figures)
}

/// The program with a page, and what it prints.
struct Host {
    child: Child,
    url: String,
    lines: Receiver<String>,
}

impl Host {
    fn start(program: &Path, arguments: &[&str]) -> Result<Self> {
        let mut command = Command::new(program);
        let command = command.args(arguments).args(["--view-port", "0"]);
        let command = command.current_dir(root()).env_remove("RUST_LOG");
        let command = command.stdin(Stdio::null()).stdout(Stdio::piped());
        let mut child = command.stderr(Stdio::piped()).spawn()?;
        let (said, urls) = channel();
        let stderr = child.stderr.take().context("no stderr")?;
        std::thread::spawn(move || {
            for line in BufReader::new(stderr).lines().map_while(Result::ok) {
                if let Some(url) = line.strip_prefix("see it: ") {
                    let _ = said.send(url.to_owned());
                }
            }
        });
        let (tell, lines) = channel();
        let stdout = child.stdout.take().context("no stdout")?;
        std::thread::spawn(move || {
            for line in BufReader::new(stdout).lines().map_while(Result::ok) {
                let _ = tell.send(line);
            }
        });
        let url = urls.recv_timeout(LONG).context("no page")?;
        Ok(Self { child, url, lines })
    }

    /// What the session says of itself once it is over; then the program ends.
    fn summary(mut self) -> Result<Value> {
        let mut text = self.lines.recv_timeout(LONG).context("no summary")?;
        signal("INT", self.child.id())?;
        self.child.wait()?;
        text.extend(self.lines.iter());
        serde_json::from_str(&text).with_context(|| format!("no summary: {text}"))
    }

    /// Resident memory \[MB\].
    fn memory_mb(&self) -> Result<f64> {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id()))?;
        let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
        let kb = line.and_then(|line| line.trim().strip_suffix("kB")?.trim().parse::<f64>().ok());
        Ok(kb.context("the system does not say how much memory is used")? / 1000.0)
    }
}

impl Drop for Host {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn signal(name: &str, pid: u32) -> Result<()> {
    Tool::new(&format!("kill -{name} {pid}")).run()
}

/// Who watches.
#[derive(Clone, Copy, Debug)]
enum Clients {
    None,
    /// They take every picture at once.
    KeepUp(usize),
    /// It asks for pictures and takes none.
    NeverReads,
}

/// Pictures that a client has got, and the session's time of the newest.
#[derive(Default)]
struct Seen {
    pictures: usize,
    /// At the newest gauges: made by the host, and got.
    made: [f64; 2],
    gaps: usize,
    newest_s: f64,
}

/// A client that keeps up until the page is gone or the session is over.
fn keep_up(url: &str) -> Result<(Arc<Mutex<Seen>>, JoinHandle<()>)> {
    let mut client = Client::open(url)?;
    client.send(json!({"do": "picture_hz", "hz": 60}))?;
    client.send(json!({"do": "scalar", "name": "von-mises"}))?;
    let seen = Arc::new(Mutex::new(Seen::default()));
    let own = seen.clone();
    let thread = std::thread::spawn(move || {
        let mut blocks = 0;
        while let Ok(said) = client.read() {
            let mut seen = own.lock().unwrap_or_else(PoisonError::into_inner);
            match said {
                Said::Picture(time_s) => {
                    seen.pictures += 1;
                    seen.newest_s = time_s;
                }
                // Before the first there is always one.
                Said::Ticks { gap, .. } => {
                    seen.gaps += usize::from(gap && blocks > 0);
                    blocks += 1;
                }
                Said::Text(value) if value["source"] == "recording" => break,
                Said::Text(value) => {
                    if let Some(made) = value.pointer("/pictures/made").and_then(Value::as_f64) {
                        seen.made = [made, seen.pictures as f64];
                    }
                }
                _ => {}
            }
        }
    });
    Ok((seen, thread))
}

impl Clients {
    fn count(self) -> usize {
        match self {
            Self::None => 0,
            Self::KeepUp(count) => count,
            Self::NeverReads => 1,
        }
    }

    fn words(self) -> &'static str {
        match self {
            Self::None => "no page",
            Self::KeepUp(1) => "a client that keeps up",
            Self::KeepUp(_) => "eight clients",
            Self::NeverReads => "a client that never reads",
        }
    }

    /// What the solver's thread had of a core in a solve, 99 of 100 \[us\].
    fn core_p99_us(self, program: &Path, scene: &str) -> Result<f64> {
        let scene = format!("scenes/{scene}.toml");
        let arguments = ["run", &scene, "--lockstep", "--format", "json"];
        let summary = if self.count() == 0 {
            let mut command = Command::new(program);
            let command = command.args(arguments).current_dir(root());
            let output = command.env_remove("RUST_LOG").output()?;
            serde_json::from_slice(&output.stdout)?
        } else {
            let host = Host::start(program, &[&arguments[..], &["--view"]].concat())?;
            let mut deaf = None;
            for _ in 0..self.count() {
                if matches!(self, Self::NeverReads) {
                    let mut client = Client::open(&host.url)?;
                    client.send(json!({"do": "picture_hz", "hz": 60}))?;
                    deaf = Some(client);
                } else {
                    keep_up(&host.url)?;
                }
            }
            let summary = host.summary()?;
            drop(deaf);
            let view = &summary["view"];
            let all =
                view["clients"] == self.count() && view["pictures"]["made"].as_u64() > Some(0);
            if !all {
                bail!("the clients have not seen the session: {view}");
            }
            summary
        };
        let core = summary.pointer("/core_us/p99").and_then(Value::as_f64);
        core.with_context(|| format!("no time on a core in {summary}"))
    }
}

/// The solver's time on a core with each kind of clients, against none.
fn solver(program: &Path, scene: &str, pairs: u32) -> Result<Vec<Figure>> {
    const KINDS: [Clients; 4] = [
        Clients::None,
        Clients::KeepUp(1),
        Clients::NeverReads,
        Clients::KeepUp(8),
    ];
    let mut found: [Vec<f64>; 4] = Default::default();
    for pair in 0..pairs as usize {
        eprintln!("{scene}, watched: {} of {pairs}", pair + 1);
        for place in 0..KINDS.len() {
            let kind = (pair + place) % KINDS.len();
            found[kind].push(KINDS[kind].core_p99_us(program, scene)?);
        }
    }
    let mut none = found[0].clone();
    none.sort_by(f64::total_cmp);
    let usual_us = none[none.len() / 2];
    let limit_us = (NEAR * usual_us).max(NEAR_US);
    eprintln!("{scene}: p99 of a solve without a page: {none:.1?} us");
    let figures = (1..KINDS.len()).map(|kind| {
        let both = found[kind].iter().zip(&found[0]);
        let more = both.map(|(with, without)| with - without).collect();
        let name = format!(
            "{scene}, p99 of a solve on a core, more with {}",
            KINDS[kind].words()
        );
        Figure::new(name, "us", limit_us, 0.5, more)
    });
    Ok(figures.collect())
}

/// From a safe stop's leaving the client to the answer, which is given as the order leaves.
fn stops(program: &Path) -> Result<Vec<Figure>> {
    let sandbox = ["view", "scenes/palpation.toml"];
    let real = ["run", "scenes/palpation.toml", "--view", "--seconds", "120"];
    let mut figures = Vec::new();
    for (words, arguments, others) in [
        ("a sandbox", &sandbox[..], 0),
        ("a session in real time", &real[..], 0),
        ("a session in real time, 8 clients", &real[..], 7),
    ] {
        eprintln!("safe stop: {words}");
        let host = Host::start(program, arguments)?;
        let mut client = Client::open(&host.url)?;
        client.ask(json!({"do": "picture_hz", "hz": 0}))?;
        for _ in 0..others {
            keep_up(&host.url)?;
        }
        client.mode(ARMED)?;
        let mut took_ms = Vec::new();
        for _ in 0..TRIALS {
            took_ms.push(stop_ms(&mut client)?);
            client.ask(json!({"do": "arm"}))?;
            client.mode(ARMED)?;
        }
        figures.push(Figure::new(
            format!("safe stop, {words}, p99"),
            "ms",
            STOP_MS,
            0.99,
            took_ms,
        ));
    }
    eprintln!("safe stop: while another scene is made");
    let host = Host::start(program, &sandbox)?;
    let mut client = Client::open(&host.url)?;
    client.ask(json!({"do": "picture_hz", "hz": 0}))?;
    client.mode(ARMED)?;
    let (mut took_ms, mut between_ms) = (Vec::new(), Vec::new());
    for scene in ["anastomosis-20", "palpation"].into_iter().cycle() {
        let switch = client.send(json!({"do": "scene", "name": scene}))?;
        let mut is_made = false;
        while !is_made {
            let began = Instant::now();
            let stop = client.send(json!({"do": "safe_stop"}))?;
            client.until(|said| match said {
                Said::Text(value) => {
                    is_made |= value["re"] == switch;
                    (value["re"] == stop).then_some(())
                }
                _ => None,
            })?;
            // Where the old session is over, its console rests already: the answer is the next one's.
            let times = if is_made {
                &mut between_ms
            } else {
                &mut took_ms
            };
            times.push(1e3 * began.elapsed().as_secs_f64());
            sleep(Duration::from_millis(40));
        }
        if took_ms.len() >= TRIALS {
            break;
        }
    }
    eprintln!("stops after a session, answered by the next one: {between_ms:.0?} ms");
    let name = "safe stop, while another scene is made, p99";
    figures.push(Figure::new(name, "ms", STOP_MS, 0.99, took_ms));
    Ok(figures)
}

fn stop_ms(client: &mut Client) -> Result<f64> {
    let began = Instant::now();
    client.ask(json!({"do": "safe_stop"}))?;
    Ok(1e3 * began.elapsed().as_secs_f64())
}

/// What a client gets beside one that reads 1 kB/s, against what it gets alone.
fn slow_client(program: &Path) -> Result<Vec<Figure>> {
    const WATCHED: Duration = Duration::from_secs(10);
    eprintln!("a client that reads 1 kB/s");
    let host = Host::start(program, &["view", "scenes/palpation.toml"])?;
    let (seen, _) = keep_up(&host.url)?;
    // Of the pictures that are made, whose number is the machine's.
    let part = || {
        let now = || seen.lock().unwrap_or_else(PoisonError::into_inner).made;
        let before = now();
        sleep(WATCHED);
        let after = now();
        100.0 * (after[1] - before[1]) / (after[0] - before[0])
    };
    sleep(Duration::from_secs(3));
    let alone = part();
    let mut slow = Client::open(&host.url)?;
    slow.send(json!({"do": "picture_hz", "hz": 60}))?;
    let mut stream = slow.into_stream();
    let over = Arc::new(AtomicBool::new(false));
    let ends = over.clone();
    let reader = std::thread::spawn(move || {
        let mut bytes = [0; 100];
        while !ends.load(Ordering::Relaxed) && stream.read(&mut bytes).is_ok_and(|read| read > 0) {
            sleep(Duration::from_millis(100));
        }
    });
    sleep(Duration::from_secs(3));
    let beside = part();
    over.store(true, Ordering::Relaxed);
    let _ = reader.join();
    let gaps = seen.lock().unwrap_or_else(PoisonError::into_inner).gaps;
    eprintln!("{alone:.1} % of the pictures alone, {beside:.1} % beside it");
    Ok(vec![
        Figure::new(
            "pictures of others, fewer beside a client that reads 1 kB/s",
            "%",
            OTHERS,
            1.0,
            vec![alone - beside],
        ),
        Figure::new(
            "ticks that others miss beside it",
            "gaps",
            0.0,
            1.0,
            vec![gaps as f64],
        ),
    ])
}

/// Memory while a client stands still, and what it is shown when it goes on.
fn stopped_client(program: &Path) -> Result<Vec<Figure>> {
    eprintln!("a client that is stopped: {} s", (FILLS + STANDS).as_secs());
    let host = Host::start(program, &["view", "scenes/palpation.toml"])?;
    let (seen, _) = keep_up(&host.url)?;
    let newest_s = || seen.lock().unwrap_or_else(PoisonError::into_inner).newest_s;
    let mut command = Command::new(std::env::current_exe()?);
    let command = command.args(["watch-page", &host.url]).stdin(Stdio::null());
    let mut client = Stopped(command.stdout(Stdio::piped()).spawn()?);
    let (tell, pictures) = channel();
    let stdout = client.0.stdout.take().context("no stdout")?;
    std::thread::spawn(move || {
        for line in BufReader::new(stdout).lines().map_while(Result::ok) {
            let _ = tell.send((Instant::now(), line.parse::<f64>().unwrap_or(f64::NAN)));
        }
    });
    sleep(FILLS);
    let before = pictures.try_iter().count();
    if before < 100 {
        bail!("the client that is to be stopped has seen {before} pictures");
    }
    let before_mb = host.memory_mb()?;
    signal("STOP", client.0.id())?;
    let mut grown_mb = Vec::new();
    for _ in 0..STANDS.as_secs() {
        sleep(Duration::from_secs(1));
        grown_mb.push(host.memory_mb()? - before_mb);
    }
    // What it wrote before it was stopped.
    pictures.try_iter().for_each(drop);
    let goes_on = Instant::now();
    signal("CONT", client.0.id())?;
    let mut ages_ms = Vec::new();
    for _ in 0..UNDERWAY + 5 {
        let (at, time_s) = pictures
            .recv_timeout(LONG)
            .context("it sees nothing any more")?;
        let age_ms = 1e3 * (newest_s() - time_s);
        let after_ms = 1e3 * (at - goes_on).as_secs_f64();
        eprintln!("{after_ms:.0} ms after it goes on: a picture {age_ms:.0} ms old");
        ages_ms.push(age_ms);
    }
    let fresh = ages_ms.split_off(UNDERWAY);
    Ok(vec![
        Figure::new(
            "memory, more while a client stands still for 60 s",
            "MB",
            GROWTH_MB,
            1.0,
            grown_mb,
        ),
        Figure::new(
            "age of what it is shown when it goes on",
            "ms",
            AGE_MS,
            1.0,
            fresh,
        ),
    ])
}

/// A client that is ended, also while it is stopped.
struct Stopped(Child);

impl Drop for Stopped {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_figure_is_judged_by_the_share_that_was_asked_for() {
        let values = || (1..=200).map(f64::from).collect::<Vec<_>>();
        let worst = Figure::new("p99", "ms", 198.0, 0.99, values());
        assert_eq!((worst.judged, worst.is_missed()), (198.0, false));
        assert!(Figure::new("p99", "ms", 197.0, 0.99, values()).is_missed());
        assert!(Figure::new("all", "ms", 199.0, 1.0, values()).is_missed());
        assert!(Figure::new("nothing", "ms", 1.0, 1.0, Vec::new()).is_missed());
        let text = table(&[worst]);
        assert!(
            text.contains("met     p99: 198.0 ms, limit 198.0 (of 200"),
            "{text}"
        );
    }
}
