//! `cargo xtask sweep`: numbers of shipped scenes that cannot be meant, and what the command says of them. Entry point: [`all`].
//!
//! Each number is changed alone: times 0.001 and 1000, zero, negated. It has to end refused at a place of the scene, with a warning or
//! another word, or well: with something felt where the solver was touched, and nothing where it was not.

mod child;
mod numbers;

use crate::run::{root, target};
use anyhow::{Context, Result, bail};
use child::Ended;
use clap::Args;
use numbers::{Change, Number};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

/// Numbers that are drawn without `--full`.
const DRAWN: usize = 100;
/// Longest session without `--full` \[s\]; something is felt by then in half of the shipped scenes.
const SECONDS: f64 = 2.0;
/// Least force that a finger feels, and largest force of a frame ahead of its solve \[N\].
const FELT_N: f64 = 5e-3;

/// Words of the command about a session in which a slack thread or the like was held.
const FAINT: &str = "and the largest force was";

/// Words of the command about a console that goes to rest by itself.
const LET_GO: &str = "the console let go";

/// Options of the sweep.
#[derive(Args, Clone, Debug)]
pub struct Arguments {
    /// Every key of every scene in place of a drawn hundred, in sessions of full length.
    #[arg(long)]
    pub full: bool,
    /// Seed of the draw; printed.
    #[arg(long)]
    pub seed: Option<u64>,
    /// Only scenes with this in their name.
    #[arg(long)]
    pub scene: Option<String>,
    /// Only keys with this in them, such as `hand.` or `radius_m`.
    #[arg(long)]
    pub key: Option<String>,
    /// Number of drawn changes.
    #[arg(long, default_value_t = DRAWN, conflicts_with = "full")]
    pub count: usize,
    /// The command, built before; the workspace's debug build when left out.
    #[arg(long, value_name = "PROGRAM")]
    pub sutura: Option<PathBuf>,
}

/// A shipped scene.
struct Scene {
    path: PathBuf,
    text: String,
    numbers: Vec<Number>,
    /// Whether a hand can hold a console in it.
    is_session: bool,
    /// Length of its session \[s\].
    seconds: f64,
}

/// Outcome of a changed number.
enum Outcome {
    /// At a place of the scene's file.
    Refused(String),
    Warned(String),
    /// By another status than `ok`, or an exit code that says what cannot be trusted.
    Said(String),
    /// Peaks \[N\].
    Felt {
        felt_n: f64,
        solved_n: f64,
    },
    /// A solve without a session.
    Solved,
    /// Not as it has to be.
    Wrong(String),
}

/// Sweeps, prints a line for each number, and fails if one ends as it must not.
///
/// # Errors
/// Lists them; a scene or a program that is not there.
pub fn all(arguments: &Arguments) -> Result<()> {
    let now = SystemTime::now().duration_since(UNIX_EPOCH);
    let fresh = now.map_or(0, |since| since.as_nanos() as u64);
    let seed = arguments.seed.unwrap_or(fresh);
    let program = match &arguments.sutura {
        Some(program) => std::path::absolute(program)?,
        None => target()?.join("debug/sutura"),
    };
    if !program.is_file() {
        bail!("{} is not there: cargo build -p sutura", program.display());
    }
    let scenes = scenes(arguments)?;
    let all: Vec<(usize, usize, Change)> = cases(&scenes, arguments);
    let picked = match arguments.full {
        true => all,
        false => numbers::draw(all, arguments.count, seed),
    };
    match arguments.full {
        true => println!("{} changed numbers", picked.len()),
        false => println!(
            "{} changed numbers; the same again: cargo xtask sweep --seed {seed} --count {}",
            picked.len(),
            arguments.count
        ),
    }
    let folder = target()?.join("sweep");
    let mut sweep = Sweep {
        program,
        folder,
        full: arguments.full,
        unchanged: BTreeMap::new(),
    };
    let mut counts = BTreeMap::<&str, usize>::new();
    let mut wrong = Vec::new();
    for (scene, number, change) in picked {
        let (scene, number) = (&scenes[scene], &scenes[scene].numbers[number]);
        let name = scene.path.file_stem().unwrap_or_default().display();
        let changed = change.of(number);
        let what = format!("{name} {} = {} -> {changed}", number.key, number.written);
        let outcome = sweep.one(scene, number, &changed)?;
        let (word, line) = outcome.words();
        *counts.entry(word).or_default() += 1;
        println!("{what}: {line}");
        if matches!(outcome, Outcome::Wrong(_)) {
            wrong.push(format!("{what}: {line}"));
        }
    }
    let counts: Vec<String> = counts
        .iter()
        .map(|(word, count)| format!("{count} {word}"))
        .collect();
    println!("{}", counts.join(", "));
    if !wrong.is_empty() {
        bail!(
            "{} did not end as they must:\n{}",
            wrong.len(),
            wrong.join("\n")
        );
    }
    Ok(())
}

impl Outcome {
    /// Returns its name and its description.
    fn words(&self) -> (&'static str, String) {
        match self {
            Outcome::Refused(what) => ("refused", format!("refused: {what}")),
            Outcome::Warned(what) => ("warned", format!("warned: {what}")),
            Outcome::Said(what) => ("said", format!("said: {what}")),
            Outcome::Felt { felt_n, solved_n } => (
                "ok",
                format!("ok: felt {felt_n:.3} N, solved {solved_n:.3} N"),
            ),
            Outcome::Solved => ("ok", "ok: solved".to_owned()),
            Outcome::Wrong(what) => ("wrong", format!("WRONG: {what}")),
        }
    }
}

fn scenes(arguments: &Arguments) -> Result<Vec<Scene>> {
    let folder = root().join("scenes");
    let mut paths = Vec::new();
    for entry in std::fs::read_dir(&folder).with_context(|| folder.display().to_string())? {
        let path = entry?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let is_asked = arguments
            .scene
            .as_ref()
            .is_none_or(|part| name.contains(part));
        // Its check follows the session, for half a minute in a build for tests.
        let is_long = name == "needle-held-slab.toml" && !arguments.full;
        if path.extension().is_some_and(|end| end == "toml") && is_asked && !is_long {
            paths.push(path);
        }
    }
    paths.sort();
    paths.into_iter().map(Scene::read).collect()
}

impl Scene {
    fn read(path: PathBuf) -> Result<Self> {
        let text = std::fs::read_to_string(&path).with_context(|| path.display().to_string())?;
        let table: toml::Table = toml::from_str(&text)?;
        let seconds = table.get("seconds").and_then(toml::Value::as_float);
        Ok(Self {
            numbers: numbers::of(&text)?,
            is_session: table.contains_key("hand"),
            seconds: seconds.unwrap_or(5.0),
            path,
            text,
        })
    }
}

/// Every key of every scene by each change that changes its number; of keys in lists the first, the middle and the last.
fn cases(scenes: &[Scene], arguments: &Arguments) -> Vec<(usize, usize, Change)> {
    let mut all = Vec::new();
    for (scene, Scene { numbers, .. }) in scenes.iter().enumerate() {
        let is_asked = |number: &usize| {
            let key = &numbers[*number].key;
            arguments.key.as_ref().is_none_or(|part| key.contains(part))
        };
        for number in numbers::of_each_key(numbers).into_iter().filter(is_asked) {
            let changes = Change::ALL.into_iter();
            let changes = changes.filter(|change| change.changes(&numbers[number]));
            all.extend(changes.map(|change| (scene, number, change)));
        }
    }
    all
}

/// Warnings of an unchanged scene, and the peaks of its session \[N\].
#[derive(Clone, Default)]
struct Unchanged {
    warnings: Vec<String>,
    felt_n: f64,
}

struct Sweep {
    program: PathBuf,
    /// Changed scenes are put there.
    folder: PathBuf,
    full: bool,
    /// By the scene's path.
    unchanged: BTreeMap<PathBuf, Unchanged>,
}

impl Sweep {
    /// A scene with one number that is changed.
    fn one(&mut self, scene: &Scene, number: &Number, changed: &str) -> Result<Outcome> {
        let unchanged = self.unchanged(scene)?;
        let text = number.replaced(&scene.text, changed);
        let path = self.put(scene, &text)?;
        let checked = match self.check(&path)? {
            Ok(warnings) => warnings,
            Err(outcome) => return Ok(outcome),
        };
        let new = checked
            .into_iter()
            .find(|warning| !unchanged.warnings.contains(warning));
        if let Some(warning) = new {
            return Ok(Outcome::Warned(warning));
        }
        if !scene.is_session {
            return self.solve(&path);
        }
        // A changed length of the session is kept.
        let cut = number.key != "seconds" && !self.full && scene.seconds > SECONDS;
        self.session(&path, cut.then_some(SECONDS), &unchanged)
    }

    /// The scene beside what it names.
    fn put(&self, scene: &Scene, text: &str) -> Result<PathBuf> {
        std::fs::create_dir_all(&self.folder)?;
        let devices = self.folder.join("devices");
        std::fs::create_dir_all(&devices)?;
        for entry in std::fs::read_dir(root().join("devices"))? {
            let entry = entry?;
            std::fs::copy(entry.path(), devices.join(entry.file_name()))?;
        }
        let path = self.folder.join(scene.path.file_name().unwrap_or_default());
        // Meshes stay where they are.
        let text = text.replace("\"../", &format!("\"{}/", root().display()));
        std::fs::write(&path, text)?;
        Ok(path)
    }

    fn unchanged(&mut self, scene: &Scene) -> Result<Unchanged> {
        if let Some(known) = self.unchanged.get(&scene.path) {
            return Ok(known.clone());
        }
        let path = self.put(scene, &scene.text)?;
        let warnings = match self.check(&path)? {
            Ok(warnings) => warnings,
            Err(outcome) => bail!("{} itself: {}", path.display(), outcome.words().1),
        };
        let mut found = Unchanged {
            warnings,
            felt_n: 0.0,
        };
        if scene.is_session {
            let cut = !self.full && scene.seconds > SECONDS;
            match self.session(&path, cut.then_some(SECONDS), &found)? {
                Outcome::Felt { felt_n, .. } => found.felt_n = felt_n,
                // Cut off where jaws have closed and not pulled yet.
                Outcome::Said(what) if what == FAINT => {}
                outcome => bail!("{} itself: {}", path.display(), outcome.words().1),
            }
        }
        self.unchanged.insert(scene.path.clone(), found.clone());
        Ok(found)
    }

    fn run(&self, path: &Path, words: &[&str]) -> Result<Ended> {
        let file = path.display().to_string();
        let words = [words, &[file.as_str()]].concat();
        child::run(&self.program, &self.folder, &words)
    }

    /// Warnings of `scene check`, or how that ended.
    fn check(&self, path: &Path) -> Result<Result<Vec<String>, Outcome>> {
        let ended = self.run(path, &["scene", "check", "--format", "json"])?;
        let Ended::Exit { code: 0, out, .. } = &ended else {
            return Ok(Err(ended_badly(path, &ended)));
        };
        let said: Value = serde_json::from_str(out).context("what `scene check` printed")?;
        let warnings = said["warnings"].as_array().into_iter().flatten();
        let messages = warnings.filter_map(|warning| warning["message"].as_str());
        Ok(Ok(messages.map(str::to_owned).collect()))
    }

    fn solve(&self, path: &Path) -> Result<Outcome> {
        let out = self.folder.join("solved.json");
        let out = out.display().to_string();
        let ended = self.run(path, &["solve", "--overwrite", "--out", &out])?;
        Ok(match &ended {
            Ended::Exit { code: 0, .. } => Outcome::Solved,
            _ => ended_badly(path, &ended),
        })
    }

    fn session(&self, path: &Path, cut: Option<f64>, unchanged: &Unchanged) -> Result<Outcome> {
        let seconds = cut.map(|seconds| seconds.to_string());
        let mut words = vec!["run", "--lockstep", "--format", "json"];
        if let Some(seconds) = &seconds {
            words.extend(["--seconds", seconds]);
        }
        let ended = self.run(path, &words)?;
        let Ended::Exit { code, out, err } = &ended else {
            return Ok(ended_badly(path, &ended));
        };
        let Ok(summary) = serde_json::from_str::<Value>(out) else {
            return Ok(ended_badly(path, &ended));
        };
        let status = summary["status"].as_str().unwrap_or_default();
        Ok(match code {
            0 if err.contains(FAINT) => Outcome::Said(FAINT.to_owned()),
            0 if status == "ok" => judge(&summary, unchanged),
            0 | 8 => Outcome::Said(format!("{status} (exit code {code})")),
            _ => ended_badly(path, &ended),
        })
    }
}

/// Judges a session that ended well.
fn judge(summary: &Value, unchanged: &Unchanged) -> Outcome {
    let felt_n = summary["force_n"]["peak"].as_f64().unwrap_or_default();
    let solved_n = summary["scene"]["peak"]["force_n"]
        .as_f64()
        .unwrap_or_default();
    let touched = summary["contact_steps"].as_u64().unwrap_or_default();
    let numbers = format!("felt {felt_n:.4} N, solved {solved_n:.4} N, {touched} steps in contact");
    if felt_n >= FELT_N && touched == 0 && solved_n < FELT_N {
        return Outcome::Wrong(format!("felt what nothing touched: {numbers}"));
    }
    if solved_n >= 2.0 * FELT_N && felt_n < FELT_N {
        return Outcome::Wrong(format!("not felt what was touched: {numbers}"));
    }
    // Jaws may close without a force; what is felt in the scene as it is must not vanish without a word.
    if touched > 0 && felt_n < FELT_N && unchanged.felt_n >= FELT_N {
        return Outcome::Wrong(format!("touched, and next to nothing felt: {numbers}"));
    }
    Outcome::Felt { felt_n, solved_n }
}

/// A command that did not end well: refused, if it is bad input and says where in the scene.
fn ended_badly(path: &Path, ended: &Ended) -> Outcome {
    let (code, out, err) = match ended {
        Ended::Silent { cpu_s } => {
            return Outcome::Wrong(format!("nothing was said in {cpu_s:.0} s"));
        }
        Ended::TooLong { cpu_s, last } => {
            return Outcome::Said(format!("after {cpu_s:.0} s still: {last}"));
        }
        Ended::Signal => return Outcome::Wrong("ended by a signal".to_owned()),
        Ended::Exit { code, out, err } => (*code, out, err),
    };
    let message = serde_json::from_str::<Value>(out)
        .ok()
        .and_then(|said| said["message"].as_str().map(str::to_owned))
        .or_else(|| {
            err.lines()
                .find(|line| line.contains('×'))
                .map(str::to_owned)
        })
        .unwrap_or_else(|| err.lines().next_back().unwrap_or_default().to_owned());
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let message = message.trim().to_owned();
    match code {
        2 if err.contains(&format!("{name}:")) => Outcome::Refused(message),
        // It says why behind that.
        1 if message.contains(LET_GO) => Outcome::Said(message),
        2 => Outcome::Wrong(format!("refused, but at no place: {message}")),
        _ => Outcome::Wrong(format!("exit code {code}: {message}")),
    }
}
