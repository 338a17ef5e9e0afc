//! `cargo xtask bars`: what sessions in real time must hold, measured in seconds on this machine: idle, and beside busy
//! loops, against the same scene in lockstep. Entry point: [`all`].

pub mod client;
#[path = "../../../host/study/src/idle.rs"]
mod idle;
mod judge;
mod load;
mod measured;
mod page;
mod table;

use crate::Format;
use crate::run::{Tool, root};
use anyhow::{Context, Result, bail};
use clap::Args;
use judge::Bar;
use load::Load;
use measured::Measured;
use serde::Serialize;
use serde_json::Value;
use std::path::{Path, PathBuf};

/// Scenes that must hold on a busy machine, too.
const BUSY: [&str; 6] = [
    "palpation",
    "needle-slabs",
    "needle-arc",
    "wound-slabs",
    "anastomosis-20",
    "anastomosis-50",
];

#[derive(Args)]
pub struct Arguments {
    /// Runs of each scene under each load.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..))]
    runs: u32,
    /// Only these, by the names of their files in scenes/, without the ending; may be given several times.
    #[arg(long, value_name = "NAME")]
    scene: Vec<String>,
    /// Only on the machine as it is, which should be idle.
    #[arg(long, conflicts_with = "busy")]
    idle: bool,
    /// Only beside busy loops, one a core and at least two: as a user without real-time rights, and as one with them.
    #[arg(long)]
    busy: bool,
    /// Only what a page costs and does: clients that keep up, stand still, and stop the console.
    #[arg(long, conflicts_with_all = ["idle", "busy", "scene"])]
    page: bool,
    /// How to print what was measured.
    #[arg(long, value_enum, default_value = "text")]
    format: Format,
}

/// Runs of one scene under one load.
#[derive(Serialize)]
struct Group {
    scene: String,
    load: Load,
    lockstep: Measured,
    runs: Vec<Measured>,
    bars: Vec<Bar>,
}

#[derive(Serialize)]
struct Outcome {
    status: &'static str,
    groups: Vec<Group>,
    /// Of sessions with a page.
    page: Vec<page::Figure>,
    /// What could not be measured here, and why.
    unmeasured: Vec<String>,
}

/// Measures, prints, and fails if a bar is missed.
///
/// # Errors
/// If a bar is missed, or there is nothing to measure.
pub fn all(arguments: &Arguments) -> Result<()> {
    let scenes = chosen(&runnable(&root().join("scenes"))?, &arguments.scene)?;
    let program = build()?;
    let mut outcome = Outcome {
        status: "ok",
        groups: Vec::new(),
        page: Vec::new(),
        unmeasured: Vec::new(),
    };
    for load in Load::ALL {
        let only = arguments.idle || arguments.busy;
        if arguments.page || only && arguments.idle != (load == Load::Idle) {
            continue;
        }
        if let Err(error) = load.is_possible(&program) {
            outcome.unmeasured.push(format!("{load}: {error:#}"));
            continue;
        }
        if let Some(warning) = load.warning() {
            eprintln!("warning: {warning}");
        }
        let named = !arguments.scene.is_empty();
        let asked = |name: &&String| load == Load::Idle || named || BUSY.contains(&name.as_str());
        for name in scenes.iter().filter(asked) {
            let group = measure(&program, name, load, arguments.runs)?;
            eprintln!("{}", table::group(&group));
            outcome.groups.push(group);
        }
    }
    if arguments.page || !(arguments.idle || arguments.busy || !arguments.scene.is_empty()) {
        outcome.page = page::all(&program, arguments.runs)?;
    }
    let bars = || outcome.groups.iter().flat_map(|group| &group.bars);
    let missed = bars().filter(|bar| bar.is_missed()).count()
        + outcome
            .page
            .iter()
            .filter(|figure| figure.is_missed())
            .count();
    if outcome.groups.is_empty() && outcome.page.is_empty() {
        bail!(
            "nothing could be measured: {}",
            outcome.unmeasured.join("; ")
        );
    }
    if missed > 0 {
        outcome.status = "missed";
    }
    match arguments.format {
        Format::Json => println!("{}", serde_json::to_string(&outcome)?),
        Format::Text => {
            println!("{}", table::verdicts(&outcome.groups, &outcome.unmeasured));
            println!("{}", page::table(&outcome.page));
        }
    }
    if missed > 0 {
        let all = bars().count() + outcome.page.len();
        bail!("{missed} of {all} bars are missed");
    }
    Ok(())
}

/// Names of the scenes that can be run: those with a hand.
fn runnable(folder: &Path) -> Result<Vec<String>> {
    let entries = std::fs::read_dir(folder).context("there is no folder `scenes`")?;
    let mut names = Vec::new();
    for path in entries.flatten().map(|entry| entry.path()) {
        if path.extension().is_none_or(|end| end != "toml") {
            continue;
        }
        let text = std::fs::read_to_string(&path)?;
        let table: toml::Table =
            toml::from_str(&text).with_context(|| path.display().to_string())?;
        if table.contains_key("hand") {
            let stem = path.file_stem().unwrap_or_default();
            names.push(stem.to_string_lossy().into_owned());
        }
    }
    names.sort();
    Ok(names)
}

fn chosen(all: &[String], asked: &[String]) -> Result<Vec<String>> {
    if let Some(wrong) = asked.iter().find(|name| !all.contains(name)) {
        bail!("scenes/ has no `{wrong}` to run; it has {}", all.join(", "));
    }
    let wanted = all
        .iter()
        .filter(|name| asked.is_empty() || asked.contains(name));
    Ok(wanted.cloned().collect())
}

/// Builds the command as its users do; its path.
fn build() -> Result<PathBuf> {
    let words = "cargo build --release --locked --message-format json-render-diagnostics";
    let messages = Tool::new(words).output()?;
    let objects = messages
        .lines()
        .filter_map(|line| serde_json::from_str::<Value>(line).ok());
    let programs = objects.filter_map(|object| Some(PathBuf::from(object["executable"].as_str()?)));
    let mut sutura = programs.filter(|path| path.file_stem().is_some_and(|name| name == "sutura"));
    sutura.next().context("cargo named no program `sutura`")
}

fn measure(program: &Path, name: &str, load: Load, runs: u32) -> Result<Group> {
    let scene = format!("scenes/{name}.toml");
    eprintln!("{name}, {load}: in lockstep");
    let lockstep = Load::Idle.run(program, &[&scene, "--lockstep"])?;
    let _busy = load.begin()?;
    let mut measured = Vec::new();
    for number in 1..=runs {
        eprintln!("{name}, {load}: run {number} of {runs}");
        measured.push(load.run(program, &[&scene])?);
    }
    Ok(Group {
        scene: name.to_owned(),
        load,
        bars: judge::bars(name, load, &lockstep, &measured),
        lockstep,
        runs: measured,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scenes_without_a_hand_are_left_out_and_the_busy_ones_are_there() {
        let all = runnable(&root().join("scenes")).expect("readable");
        assert!(!all.contains(&"cube-handle".to_owned()), "{all:?}");
        for name in BUSY {
            assert!(all.contains(&name.to_owned()), "{name}");
        }
        let asked = ["palpation".to_owned()];
        assert_eq!(chosen(&all, &asked).expect("one"), asked);
        assert_eq!(chosen(&all, &[]).expect("all"), all);
        let error = chosen(&all, &["palpatoin".to_owned()]).expect_err("no such scene");
        assert!(error.to_string().contains("palpation"), "{error}");
    }
}
