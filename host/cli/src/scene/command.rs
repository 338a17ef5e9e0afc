//! `sutura scene`: whether a scene is good, what it builds and what that costs, and the schema of its file.

use crate::failure::{Cause, Failure, render};
use crate::run::{lockstep_console, session_failure};
use crate::{Format, Global, display};
use clap::{Args, Subcommand};
use miette::{Diagnostic, Report};
use schemars::JsonSchema;
use serde::Serialize;
use std::path::{Path, PathBuf};
use sutura_host::scene::{self, Flaw, Scene};
use sutura_host::session::{Overfull, Plan, SceneSolver, check_rate, overfull};
use sutura_host::wound::Overlap;
use sutura_shared::control::TICK_HZ;
use sutura_study::explain::{Component, explain};

/// Looks at scene files: checks them, explains what they build, describes their keys.
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub struct SceneArgs {
    #[command(subcommand)]
    command: SceneCommand,
}

const EXAMPLES: &str = "\
Examples:
  sutura scene check scenes/palpation.toml
  sutura scene explain scenes/palpation.toml
  sutura scene schema > scene.schema.json";

const CHECK_EXAMPLES: &str = "\
Examples:
  sutura scene check mine.toml                  the first thing that is wrong, at its character
  sutura scene check mine.toml --format json    status, warnings[], notes[] with line and column

Reads every file that the scene names, builds the solver, brings held tools to their places, and follows the session
where tools may touch more vertices than a step has room for. Warnings and notes do not fail; what is wrong ends with
exit code 2.";

const EXPLAIN_EXAMPLES: &str = "\
Examples:
  sutura scene explain scenes/palpation.toml
  sutura scene explain mine.toml --format json | jq '.components[] | select(.built) | {name, us, per}'

Everything is built and the driven tool follows the hand's path, so times and bytes are those of this machine. A dash,
or null, is what was not measured. Times are per `once`, per touched `vertex`, per `step`, or per `request`.";

const SCHEMA_EXAMPLES: &str = "\
Examples:
  sutura scene schema > scene.schema.json       JSON Schema, 2020-12
  taplo check --schema file://$PWD/scene.schema.json mine.toml

Editors complete and check keys with it. What depends on several keys or on the mesh only `check` sees.";

#[derive(Subcommand, Debug)]
enum SceneCommand {
    /// Whether a scene is good: the file, its mesh, every name in it, its tools; builds the solver.
    #[command(after_help = CHECK_EXAMPLES)]
    Check {
        /// Scene file.
        scene: PathBuf,
    },
    /// What a scene builds, which key asks for it, and what it costs on this machine.
    #[command(after_help = EXPLAIN_EXAMPLES)]
    Explain {
        /// Scene file.
        scene: PathBuf,
    },
    /// The JSON Schema of scene files.
    #[command(after_help = SCHEMA_EXAMPLES)]
    Schema {
        /// Not needed: the schema is the same for every scene.
        scene: Option<PathBuf>,
    },
}

/// Checks, explains or describes.
///
/// # Errors
/// Bad input: the scene, something in it, or a file that it names; tools that are held too deep.
pub fn run(args: &SceneArgs, global: &Global) -> Result<(), Failure> {
    match &args.command {
        SceneCommand::Check { scene } => check(scene, global),
        SceneCommand::Explain { scene } => print_components(scene, global),
        SceneCommand::Schema { .. } => {
            let schema = scene::schema();
            match global.format {
                Format::Json => say!("{schema}"),
                Format::Text => display::lines(&format!("{schema:#}")),
            }
            Ok(())
        }
    }
}

fn check(path: &Path, global: &Global) -> Result<(), Failure> {
    let shown = crate::work::watch();
    let mut scene = scene::load(path)?;
    scene.notes.append(&mut scene.mesh_notes);
    let said = [&mut scene.warnings, &mut scene.notes].map(std::mem::take);
    let [warnings, notes] = said
        .each_ref()
        .map(|flaws| flaws.iter().map(placed).collect::<Vec<_>>());
    for flaw in said.into_iter().flatten() {
        render(&Report::new(flaw));
    }
    // What `run` refuses is refused here; without a hand a scene is for `solve`.
    if scene.hand.is_some() {
        let plan = Plan::of_scene(&scene)?;
        check_rate(plan.host_hz, TICK_HZ).map_err(|error| session_failure(error, "virtual"))?;
    }
    let solver = SceneSolver::new(&scene)?;
    check_apart(&solver)?;
    drop(solver);
    check_room(&scene)?;
    drop(shown);
    match global.format {
        Format::Json => display::object(&Checked {
            counts: counts(path, &scene),
            warnings,
            notes,
        }),
        Format::Text => say!(
            "{}: good (warnings: {}, notes: {}): \"{}\", {} tissue, {} nodes, {} cells, {} tools, {} needles, {} handles",
            path.display(),
            warnings.len(),
            notes.len(),
            scene.name,
            scene.tissue.word(),
            scene.mesh.points_m().len(),
            scene.mesh.cells().len(),
            scene.tools.len(),
            scene.needles.len(),
            scene.loads.handles.len()
        ),
    }
    Ok(())
}

/// Checks that parts that may touch begin outside each other.
///
/// # Errors
/// Bad input: they do not.
fn check_apart(solver: &SceneSolver) -> Result<(), Failure> {
    solver.overlap().map_or(Ok(()), |overlap| {
        Err(Failure::say(
            Cause::BadInput,
            overlap.to_string(),
            Overlap::HELP,
        ))
    })
}

/// Whether every step of the scene's session has room for what its tools touch.
///
/// # Errors
/// Bad input: one has not; what no solver can be built of.
fn check_room(scene: &Scene) -> Result<(), Failure> {
    if scene.hand.is_none() {
        return Ok(());
    }
    let plan = Plan::of_scene(scene)?;
    let mut console = lockstep_console(&plan.device)?;
    match overfull(scene, &plan, &mut console)? {
        Some(overfull) => Err(Failure::say(
            Cause::BadInput,
            overfull.to_string(),
            Overfull::HELP,
        )),
        None => Ok(()),
    }
}

/// What there is in a scene.
#[derive(Serialize, JsonSchema)]
struct Counts {
    /// `ok`.
    status: &'static str,
    /// The scene's file.
    file: String,
    /// The scene's name.
    scene: String,
    /// Name of the tissue model.
    tissue: &'static str,
    /// Nodes of the mesh.
    nodes: usize,
    /// Cells of the mesh.
    cells: usize,
    /// Regions with a material of their own.
    regions: usize,
    /// Tools.
    tools: usize,
    /// Needles.
    needles: usize,
    /// Handles.
    handles: usize,
}

/// What `sutura scene check --format json` prints.
#[derive(Serialize, JsonSchema)]
pub struct Checked {
    #[serde(flatten)]
    counts: Counts,
    /// What is allowed but hardly meant.
    warnings: Vec<Placed>,
    /// What is worth knowing.
    notes: Vec<Placed>,
}

/// What `sutura scene explain --format json` prints.
#[derive(Serialize, JsonSchema)]
pub struct Explained {
    #[serde(flatten)]
    counts: Counts,
    /// Parts of the solver, those too that the scene does without.
    components: Vec<Component>,
}

/// A warning or a note with its place.
#[derive(Serialize, JsonSchema)]
struct Placed {
    /// What there is.
    message: String,
    /// What to do about it.
    help: Option<String>,
    /// File that it is about: the scene's, or that of its device.
    file: Option<String>,
    /// Line in that file, from 1.
    line: Option<usize>,
    /// Column, from 1.
    column: Option<usize>,
}

fn counts(path: &Path, scene: &Scene) -> Counts {
    Counts {
        status: "ok",
        file: path.display().to_string(),
        scene: scene.name.clone(),
        tissue: scene.tissue.word(),
        nodes: scene.mesh.points_m().len(),
        cells: scene.mesh.cells().len(),
        regions: scene.regions.len(),
        tools: scene.tools.len(),
        needles: scene.needles.len(),
        handles: scene.loads.handles.len(),
    }
}

fn placed(warning: &Flaw) -> Placed {
    let source = warning.source_code();
    let place = source.and_then(|source| source.read_span(&warning.span(), 0, 0).ok());
    Placed {
        message: warning.to_string(),
        help: warning.help().map(|help| help.to_string()),
        file: place
            .as_ref()
            .and_then(|place| place.name())
            .map(str::to_owned),
        line: place.as_ref().map(|place| place.line() + 1),
        column: place.as_ref().map(|place| place.column() + 1),
    }
}

fn print_components(path: &Path, global: &Global) -> Result<(), Failure> {
    if cfg!(debug_assertions) {
        tracing::warn!("a debug build: the times are many times too large");
    }
    let shown = crate::work::watch();
    let mut scene = super::open(Some(path))?;
    super::without_session(&mut scene);
    check_room(&scene)?;
    let components = explain(&scene)?;
    drop(shown);
    if global.format == Format::Json {
        display::object(&Explained {
            counts: counts(path, &scene),
            components,
        });
        return Ok(());
    }
    say!("{}: {} tissue", scene.name, scene.tissue.word());
    let (built, absent): (Vec<_>, Vec<_>) = components.iter().partition(|part| part.built);
    say!("");
    say!("built                               rows     memory          time");
    for part in built {
        line(part);
    }
    say!("");
    say!("not built");
    for part in absent {
        line(part);
    }
    Ok(())
}

fn line(part: &Component) {
    let dash = || "-".to_owned();
    let rows = part.rows.map_or_else(dash, |rows| rows.to_string());
    let memory = part.bytes.map_or_else(dash, |bytes| match bytes {
        0..10_000 => format!("{bytes} B"),
        10_000..10_000_000 => format!("{:.0} kB", 1e-3 * bytes as f64),
        _ => format!("{:.0} MB", 1e-6 * bytes as f64),
    });
    let time = match (part.us, part.per) {
        (Some(us), Some(per)) if us < 1e4 => format!("{us:.0} us / {per}"),
        (Some(us), Some(per)) => format!("{:.0} ms / {per}", 1e-3 * us),
        _ => dash(),
    };
    say!(
        "  {:<30} {rows:>7} {memory:>10} {time:>17}  {}",
        part.name,
        part.why
    );
}
