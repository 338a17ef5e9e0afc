//! `sutura bench`: time per step, by stage, on this machine.
//!
//! Each scene's case walks its hand path through the solver, without a console: once with nothing
//! cached, then several times with every compliance column at hand. Its session is run in lockstep, for what
//! all that a session's solver does takes: see `session`. The suite is in `suite`.

pub mod session;
mod sliding;
mod suite;

use crate::failure::{Cause, Failure};
use crate::{Format, Global, scene};
use clap::Args;
use indicatif::ProgressBar;
use schemars::JsonSchema;
use serde::Serialize;
use session::{SessionUs, Solves, WorstSecond};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::{Duration, Instant};
use sutura_host::model::Model;
use sutura_host::scene::{Scene, Tissue};
use sutura_host::script::Script;
use sutura_host::session::{check_rate, least_hz};
use sutura_host::step::{State, Status, StepOptions, StepReport, Workspace, step};
use sutura_host::text::escaped;
use sutura_host::thread::ThreadTension;
use sutura_shared::control::TICK_HZ;
use sutura_study::machine::Machine;

/// Slabs of `--suite`, in cubes along x, y, z.
const SLABS: [[usize; 3]; 3] = [[20, 20, 8], [26, 26, 10], [32, 32, 12]];
/// Warm passes: their medians' spread says how far to trust a figure.
const PASSES: usize = 5;
/// Sessions of which each solve's fastest counts.
const SESSION_PASSES: usize = 2;

/// Measures the time that a solver step takes, by stage.
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub struct BenchArgs {
    /// Scenes with a `[hand]` whose path the driven tool follows; scenes/palpation-frictionless.toml when left out.
    #[arg(conflicts_with = "suite")]
    pub scenes: Vec<PathBuf>,
    /// Tissue model, in place of the scenes': `linear` or `corotational`; `sutura tradeoff` measures the others.
    #[arg(long, value_name = "NAME", conflicts_with = "suite", value_parser = Tissue::named)]
    pub tissue: Option<Tissue>,
    /// Rows on circling anchors: two tubes, a cylinder, growth to 20,000 nodes; palpation of three slabs.
    #[arg(long)]
    pub suite: bool,
    /// Steps of a pass of the suite.
    #[arg(long, default_value_t = 1000, value_parser = clap::value_parser!(u32).range(1..=100_000), requires = "suite")]
    pub steps: u32,
    /// Steps of the suite on corotational tissue begin this often a second, and factors are renewed by a thread beside
    /// them, as in a session; otherwise one step begins when the last ends and makes what it needs itself.
    #[arg(long, value_name = "HZ", requires = "suite", value_parser = rate)]
    pub paced: Option<f64>,
    /// Runs only what has NAME in its name, as the suite prints it: `sliding`, `tubes 5 k`, `palpation`.
    #[arg(long, value_name = "NAME", requires = "suite")]
    pub only: Option<String>,
}

const EXAMPLES: &str = "\
Examples:
  sutura bench                             the palpation scene without friction
  sutura bench scenes/palpation.toml my.toml --format json
  sutura bench scenes/anastomosis-50.toml --tissue corotational
  sutura bench --suite                     60 and 150 rows on tubes and a cylinder, up to 20,000 nodes
  sutura bench --suite --steps 100         the same, shorter
  sutura bench --suite --steps 250 --paced 60 --only 1,650
  sutura bench --suite --only sliding      what a needle's speed costs where nothing is computed yet

Figures of scenes are medians over all steps in contact (and once more over those in which a thread pulls), after every compliance column was computed; first_touch_us is
the slowest step while they were not. session_us is all that a session's solver does in a period, over the whole script, and
worst_second_us the largest mean of a second of it; what lockstep waits for factors is left out, and solves_waited says how
often it did. Build with --release: a debug build is many times slower.";

#[derive(Serialize, JsonSchema)]
pub struct Report {
    status: &'static str,
    machine: Machine,
    cases: Vec<Case>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    slides: Vec<sliding::Slide>,
}

#[derive(Serialize, JsonSchema)]
struct Case {
    scene: String,
    tissue: &'static str,
    nodes: usize,
    cells: usize,
    /// Most touched vertices of a step.
    rows: u32,
    /// Steps in contact, in one pass.
    steps: usize,
    /// Steps of one pass that did not end in balance.
    steps_not_ok: usize,
    step_us: Spread,
    #[serde(flatten)]
    of_session: Option<OfSession>,
    /// Displacement of all nodes, for viewers and files; in steps of which it is a part, its stage.
    #[serde(skip_serializing_if = "Option::is_none")]
    field_us: Option<f64>,
    #[schemars(with = "BTreeMap<String, f64>")]
    stages_us: StagesUs,
    /// Assembly and factorisation.
    factor_ms: f64,
    first_touch_us: f64,
    /// Factor and cached columns.
    memory_mb: f64,
    #[serde(flatten)]
    of_rows: Option<Rows>,
    #[serde(flatten)]
    turning: Option<Turning>,
}

/// What a session's solver takes in a period, over all phases of the scene.
#[derive(Serialize, JsonSchema)]
struct OfSession {
    session_us: SessionUs,
    /// Solves that waited for a factor, without that.
    solves_waited: usize,
    /// Largest mean of the solves of a second of scene time.
    worst_second_us: f64,
    #[serde(skip)]
    worst: Option<WorstSecond>,
}

/// What rows on anchors cost.
#[derive(Serialize, JsonSchema)]
struct Rows {
    /// Columns computed per warm step: solves.
    columns_per_step: f64,
    /// One column, three of which a vertex has, computed with others where they were missing together.
    column_us: f64,
    /// Columns of one vertex.
    vertex_kb: f64,
    cached_vertices: usize,
}

/// What corotational tissue did.
#[derive(Serialize, JsonSchema)]
struct Turning {
    /// Made in the step.
    refactors_per_step: f64,
    /// Made beside the steps and taken over, and those of them that the step waited for.
    #[serde(skip_serializing_if = "Option::is_none")]
    renewals_per_step: Option<[f64; 2]>,
    /// CPU time of all threads.
    #[serde(skip_serializing_if = "Option::is_none")]
    cpu_us_per_step: Option<f64>,
    /// Of any cell.
    largest_rotation_deg: f64,
    /// Largest difference from the fully converged displacement, over its largest entry.
    displacement_difference_pct: f64,
}

#[derive(Serialize, JsonSchema)]
struct Spread {
    p50: f64,
    mean: f64,
    p99: f64,
    max: f64,
    /// Lowest and highest median of the passes.
    p50_range: [f64; 2],
}

/// Medians by stage.
struct StagesUs(Vec<(&'static str, f64)>);

impl Serialize for StagesUs {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(self.0.iter().copied())
    }
}

fn rate(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(rate) if (1.0..=1000.0).contains(&rate) => Ok(rate),
        _ => Err("must be 1 to 1000".to_owned()),
    }
}

/// Runs the cases and prints the report.
///
/// # Errors
/// Bad input for a scene that cannot be used or has no hand.
pub fn run(args: &BenchArgs, global: &Global) -> Result<(), Failure> {
    if cfg!(debug_assertions) {
        tracing::warn!("a debug build: the figures are many times too large");
    }
    let mut scenes = Vec::new();
    if args.suite {
        for divisions in SLABS {
            scenes.push(scene::palpation_on(divisions)?);
        }
        if let Some(only) = &args.only {
            scenes.retain(|scene| scene.name.contains(only.as_str()));
        }
    } else if args.scenes.is_empty() {
        scenes.push(scene::frictionless()?);
    }
    for path in &args.scenes {
        scenes.push(scene::open(Some(path))?);
    }
    for scene in &mut scenes {
        if let Some(tissue) = args.tissue {
            scene.tissue = tissue.instead_of(scene.tissue);
        }
        scene::without_session(scene);
    }
    // Hidden by itself where stderr is no terminal.
    let progress = crate::display::progress(scenes.len() * (2 + PASSES));
    let mut cases = Vec::new();
    let mut slides = Vec::new();
    if args.suite {
        let steps = args.steps as usize;
        (cases, slides) = suite::run(steps, args.paced, args.only.as_deref(), &progress)?;
        progress.reset();
        progress.set_length((scenes.len() * (2 + PASSES)) as u64);
    }
    for scene in &scenes {
        cases.extend(measure(scene, &progress)?);
    }
    if let (Some(only), true, true) = (&args.only, cases.is_empty(), slides.is_empty()) {
        return Err(Failure::say(
            Cause::BadInput,
            format!("nothing in the suite has `{only}` in its name"),
            "the names begin with `circling on`, `sliding on` and `palpation`",
        ));
    }
    progress.finish_and_clear();
    let report = Report {
        status: "ok",
        machine: Machine::here(),
        cases,
        slides,
    };
    match global.format {
        Format::Json => crate::display::object(&report),
        Format::Text => print_text(&report),
    }
    Ok(())
}

/// One step of a pass.
#[derive(Clone, Copy)]
struct Sample {
    took: Duration,
    report: StepReport,
}

fn measure(scene: &Scene, progress: &ProgressBar) -> Result<Vec<Case>, Failure> {
    progress.set_message(escaped(&scene.name));
    if let Err(error) = check_rate(scene.host.host_hz, TICK_HZ) {
        let least_hz = least_hz(TICK_HZ);
        let help = format!("have its `[host]` say `host_hz = {least_hz}` or more");
        let message = format!("the scene \"{}\": {error}", scene.name);
        return Err(Failure::say(Cause::BadInput, message, help));
    }
    if scene.hand.is_none() || scene.driven().is_none() {
        let message = format!(
            "the scene \"{}\" has no hand or no tool to follow",
            scene.name
        );
        return Err(Failure::say(
            Cause::BadInput,
            message,
            "add `[hand]` with way points and a `[[tool]]`",
        ));
    }
    let started = Instant::now();
    let (model, mut state, mut work) = scene.build()?;
    let factor_ms = 1e3 * started.elapsed().as_secs_f64();

    let cold = walk(
        scene,
        &model,
        &mut state,
        &StepOptions::default(),
        &mut work,
    );
    // What the cold pass was too late to touch, so that the warm passes find every column.
    let options = StepOptions::with_vertices(usize::MAX);
    state = State::new(&model);
    walk(scene, &model, &mut state, &options, &mut work);
    progress.inc(1);
    let first_touch = cold
        .iter()
        .filter(|s| s.report.columns_computed > 0)
        .map(|s| s.took)
        .max();

    let mut passes: Vec<Vec<Sample>> = Vec::with_capacity(PASSES);
    for _ in 0..PASSES {
        state = State::new(&model);
        passes.push(walk(scene, &model, &mut state, &options, &mut work));
        progress.inc(1);
    }
    let mut field_us: Vec<f64> = (0..PASSES)
        .map(|_| {
            let started = Instant::now();
            let field = model.equilibrium(&state);
            let took = started.elapsed();
            std::hint::black_box(&field);
            1e6 * took.as_secs_f64()
        })
        .collect();
    let field_us = quantile(&mut field_us, 0.5);
    let solves = Solves::of(scene, SESSION_PASSES)?;
    progress.inc(1);
    let first_touch_us = first_touch.map_or(0.0, |t| 1e6 * t.as_secs_f64());
    let memory_mb = 1e-6 * (8 * model.factor_entries() + work.cache_bytes()) as f64;
    let case = |name: String, of: fn(&StepReport) -> bool| {
        let chosen = |pass: &[Sample]| -> Vec<Sample> {
            pass.iter().filter(|s| of(&s.report)).copied().collect()
        };
        let mut medians: Vec<f64> = passes
            .iter()
            .map(|pass| quantile(&mut micros(&chosen(pass), |s| s.took), 0.5))
            .collect();
        medians.sort_by(f64::total_cmp);
        let samples: Vec<Sample> = passes.iter().flat_map(|pass| chosen(pass)).collect();
        let mut took = micros(&samples, |s| s.took);
        let stage = |ns: fn(&StepReport) -> u64| {
            quantile(
                &mut micros(&samples, |s| Duration::from_nanos(ns(&s.report))),
                0.5,
            )
        };
        Case {
            scene: name,
            tissue: scene.tissue.word(),
            nodes: scene.mesh.points_m().len(),
            cells: scene.mesh.cells().len(),
            rows: samples.iter().map(|s| s.report.rows).max().unwrap_or(0),
            steps: samples.len() / PASSES,
            steps_not_ok: passes.last().map_or(0, |pass| {
                let bad = pass.iter().filter(|s| s.report.status != Status::Ok);
                bad.count()
            }),
            step_us: Spread {
                p50: quantile(&mut took, 0.5),
                mean: took.iter().sum::<f64>() / took.len().max(1) as f64,
                p99: quantile(&mut took, 0.99),
                max: quantile(&mut took, 1.0),
                p50_range: [medians[0], medians[PASSES - 1]],
            },
            of_session: None,
            field_us: Some(field_us),
            stages_us: StagesUs(vec![
                ("tissue", stage(|r| r.stages.tissue_ns)),
                ("detect", stage(|r| r.stages.detect_ns)),
                ("columns", stage(|r| r.stages.columns_ns)),
                ("solve", stage(|r| r.stages.solve_ns)),
                ("field", stage(|r| r.stages.field_ns)),
                ("reduce", stage(|r| r.stages.reduce_ns)),
            ]),
            factor_ms,
            first_touch_us,
            memory_mb,
            of_rows: None,
            turning: None,
        }
    };
    let worst = solves.worst_second();
    let mut cases = vec![Case {
        of_session: Some(OfSession {
            session_us: solves.distribution(),
            solves_waited: solves.waited(),
            worst_second_us: worst.map_or(0.0, |worst| worst.mean_us),
            worst,
        }),
        ..case(scene.name.clone(), |report| report.rows > 0)
    }];
    if !scene.threads.is_empty() {
        let pulls = |report: &StepReport| {
            let mut threads = report.threads().iter();
            threads.any(|thread| thread.state != ThreadTension::Slack)
        };
        cases.push(case(format!("{}, pulling", scene.name), pulls));
    }
    Ok(cases)
}

/// The scene's scripts, one step every host period.
fn walk(
    scene: &Scene,
    model: &Model,
    state: &mut State,
    options: &StepOptions,
    work: &mut Workspace,
) -> Vec<Sample> {
    let steps = (scene.seconds * scene.host.host_hz) as u32;
    let mut script = Script::new(scene);
    let timed = |number: u32| {
        let time_s = f64::from(number) / scene.host.host_hz;
        let tools = script.follow(time_s, model, state);
        let started = Instant::now();
        let report = step(model, state, tools, options, work);
        Sample {
            took: started.elapsed(),
            report,
        }
    };
    (0..steps).map(timed).collect()
}

fn micros<T>(samples: &[T], time: impl Fn(&T) -> Duration) -> Vec<f64> {
    samples
        .iter()
        .map(|s| 1e6 * time(s).as_secs_f64())
        .collect()
}

/// Nearest-rank quantile; 0 of nothing.
fn quantile(values: &mut [f64], q: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let rank = (q * values.len() as f64).ceil() as usize;
    values.get(rank.saturating_sub(1)).copied().unwrap_or(0.0)
}

fn print_text(report: &Report) {
    let Machine {
        cpu,
        threads,
        os,
        arch,
        build,
        ..
    } = &report.machine;
    say!("{cpu}, {threads} threads, {os} {arch}, {build} build; times in us");
    say!(
        "{:<26} {:>12} {:>6} {:>5}  {:>7} {:>15} {:>7} {:>7}  {:>8} {:>7} {:>6}  stages",
        "scene",
        "tissue",
        "nodes",
        "rows",
        "p50",
        "(passes)",
        "mean",
        "p99",
        "field",
        "touch",
        "MB"
    );
    for case in &report.cases {
        let [low, high] = case.step_us.p50_range;
        let stages = case.stages_us.0.iter();
        let stages: Vec<String> = stages.map(|(name, us)| format!("{name} {us:.0}")).collect();
        say!(
            "{:<26} {:>12} {:>6} {:>5}  {:>7.1} {:>15} {:>7.1} {:>7.1}  {:>8} {:>7.0} {:>6.1}  {}",
            case.scene,
            case.tissue,
            case.nodes,
            case.rows,
            case.step_us.p50,
            format!("{low:.1}-{high:.1}"),
            case.step_us.mean,
            case.step_us.p99,
            case.field_us
                .map_or("-".to_owned(), |us| format!("{us:.0}")),
            case.first_touch_us,
            case.memory_mb,
            stages.join(", ")
        );
        if let Some(of) = &case.of_session {
            let SessionUs { p50, p99, max } = of.session_us;
            let worst = of.worst.map_or(String::new(), |worst| {
                format!(
                    "; {:.0} on average in the worst second, at {:.1} s",
                    worst.mean_us, worst.from_s
                )
            });
            let waited = match of.solves_waited {
                0 => String::new(),
                waited => format!("; {waited} waited for a factor besides"),
            };
            say!(
                "  in a session, looking ahead and all: p50 {p50:.0}, p99 {p99:.0}, max {max:.0}{worst}{waited}"
            );
        }
        if let Some(turning) = &case.turning {
            say!(
                "  {:.3} refactorisations in a step, cells turn by up to {:.0} degrees, displacement within {:.2} % of the converged one",
                turning.refactors_per_step,
                turning.largest_rotation_deg,
                turning.displacement_difference_pct
            );
            if let Some([adopted, waited]) = turning.renewals_per_step {
                say!("  {adopted:.3} factors a step made beside it, {waited:.3} waited for");
            }
            if let Some(cpu_us) = turning.cpu_us_per_step {
                say!("  {cpu_us:.0} us of CPU time a step, all threads together");
            }
        }
        if case.steps_not_ok > 0 {
            say!(
                "  {} of its steps did not end in balance",
                case.steps_not_ok
            );
        }
    }
    for slide in &report.slides {
        say!("{slide}");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Nearest rank: the smallest value that at least this share of the values does not exceed.
    #[test]
    fn quantiles_are_values_that_occurred() {
        let mut values = [4.0, 1.0, 3.0, 2.0];
        assert_eq!(quantile(&mut values, 0.5), 2.0);
        assert_eq!(quantile(&mut values, 0.99), 4.0);
        assert_eq!(quantile(&mut values, 1.0), 4.0);
        assert_eq!(quantile(&mut [], 0.5), 0.0);
    }
}
