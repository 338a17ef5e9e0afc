//! `sutura solve`: the tissue at rest under a scene's handles, loads and held tools.

use crate::failure::{Cause, Failure};
use crate::{Format, Global, display, files, scene};
use clap::Args;
use schemars::JsonSchema;
use serde::Serialize;
use std::path::PathBuf;
use sutura_host::output::{
    DrivenNeedle, FixedReaction, HeldTool, Reaction, Solution, SolutionFormat,
};
use sutura_host::scene::{LONGEST_S, Scene};
use sutura_host::session::EndingKind;
use sutura_host::solve::{SolveError, solve};
use sutura_host::wound::{Overlap, WoundReport};

/// Solves a scene at rest: handles at their targets, loads, and tools held where `position_m` says.
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub struct SolveArgs {
    /// Scene file.
    pub scene: PathBuf,
    /// Result file: .json or .vtu (ParaView).
    #[arg(short, long, value_name = "FILE")]
    pub out: PathBuf,
    /// Until when the scripts are followed [s], in scenes with needles; the scene's `solve_at_s`, or its end, when left
    /// out.
    #[arg(long, value_name = "SECONDS")]
    pub at: Option<f64>,
}

const EXAMPLES: &str = "\
Examples:
  sutura solve scenes/cube-handle.toml --out cube.vtu      open it in ParaView, then Warp By Vector
  sutura solve scenes/cube-handle.toml --out cube.json
  sutura solve scenes/palpation.toml --out pressed.json    a sphere held 9 mm deep in a slab
  sutura solve scenes/needle-slabs.toml --at 3 --out in.vtu   a needle three seconds after the start

The JSON file has points_m, displacement_m, reactions[] (handle, force_n, torque_nm), fixed_force_n,
fixed_reactions[] (fixed, nodes, force_n), tools[] and residual.
Forces and torques act on the tissue; the handle or the tool feels the opposite.";

/// Solves and writes the file.
///
/// # Errors
/// Bad input for a scene that cannot be used or solved, and for a file that cannot be written there; failed for a full disk.
pub fn run(args: &SolveArgs, global: &Global) -> Result<(), Failure> {
    // Before the work: a solve that cannot be kept is wasted.
    let Some(format) = SolutionFormat::of(&args.out) else {
        let message = format!("{}: not a result format", args.out.display());
        return Err(Failure::say(
            Cause::BadInput,
            message,
            "end the name in .json or .vtu",
        ));
    };
    files::free(&args.out, global)?;
    let shown = crate::work::watch();
    let document = scene::document(Some(&args.scene))?;
    let (mut scene, _) = scene::open_with_sources(&document)?;
    files::never_over(&args.out, &document.paths())?;
    scene::without_session(&mut scene);
    if let Some(at_s) = args.at {
        scene.solve_at_s = Some(solve_at(at_s, &scene)?);
    }
    let solution = solve(&scene)?;
    drop(shown);
    let written = solution.write(&args.out, format);
    written.map_err(|error| files::unwritable(&args.out, &error))?;
    match global.format {
        Format::Json => display::object(&solved(args, &solution)),
        Format::Text => print_text(args, &solution),
    }
    overlap(&solution).map_or(Ok(()), |overlap| {
        let failure = Failure::say(Cause::NotRendered, overlap.to_string(), Overlap::HELP);
        Err(failure.after_summary())
    })
}

/// Whether parts that may touch are in each other at rest, and how far.
fn overlap(solution: &Solution) -> Option<Overlap> {
    Overlap::of(solution.wound.as_ref()?.penetration_ratio?)
}

fn solve_at(at_s: f64, scene: &Scene) -> Result<f64, Failure> {
    if !scene.follows_scripts() {
        let message = format!(
            "--at {at_s}: the scene \"{}\" has no needle, no jaws, no tissue contact and no tool on a way of its own, so no script is followed",
            scene.name
        );
        let help = "leave --at out: tools are held where `position_m` says";
        return Err(Failure::say(Cause::BadInput, message, help));
    }
    if !(0.0..=LONGEST_S).contains(&at_s) {
        let message = format!("--at {at_s}: must be from 0 to 86400 seconds");
        let help = "scripts begin at 0";
        return Err(Failure::say(Cause::BadInput, message, help));
    }
    Ok(at_s)
}

impl From<SolveError> for Failure {
    fn from(error: SolveError) -> Failure {
        let cause = match error {
            SolveError::NoRest(_) | SolveError::NoWay { .. } => Cause::Failed,
            SolveError::Nothing
            | SolveError::NoHand
            | SolveError::NoRoom { .. }
            | SolveError::Prescribed(_)
            | SolveError::Scene(_)
            | SolveError::Tissue(_) => Cause::BadInput,
        };
        Failure::new(cause, error)
    }
}

/// Largest displacement of a node \[m\].
fn largest_m(solution: &Solution) -> f64 {
    solution
        .drawn
        .displacement_m
        .iter()
        .map(length)
        .fold(0.0, f64::max)
}

fn length(v: &[f64; 3]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// What `--format json` prints.
#[derive(Serialize, JsonSchema)]
pub struct Solved<'a> {
    /// `ok`, or `overlap`: parts that may touch are in each other.
    status: &'static str,
    /// The result file.
    out: String,
    /// Name of the scene.
    scene: &'a str,
    /// Name of the tissue model.
    tissue: &'static str,
    /// Nodes of the mesh.
    nodes: usize,
    /// Cells of the mesh.
    cells: usize,
    /// Largest displacement of a node \[m\].
    displacement_max_m: f64,
    /// One for each handle, in the scene's order.
    reactions: &'a [Reaction],
    /// Force of all that is fixed on the tissue \[N\], (3).
    fixed_force_n: [f64; 3],
    /// One for each `[[fixed]]`, in the scene's order.
    fixed_reactions: &'a [FixedReaction],
    /// One for each tool that the scene holds somewhere.
    tools: &'a [HeldTool],
    /// One for each needle, in the scene's order.
    needles: &'a [DrivenNeedle],
    /// How well threads and contact close a wound; none in scenes without.
    wound: Option<&'a WoundReport>,
    /// Largest component of the unbalanced force on a free node, over the largest nodal force.
    residual: f64,
}

fn solved<'a>(args: &SolveArgs, solution: &'a Solution) -> Solved<'a> {
    Solved {
        status: match overlap(solution) {
            Some(_) => EndingKind::Overlap.word(),
            None => EndingKind::Ok.word(),
        },
        out: args.out.display().to_string(),
        scene: &solution.scene,
        tissue: solution.tissue,
        nodes: solution.drawn.points_m.len(),
        cells: solution.drawn.cells.len(),
        displacement_max_m: largest_m(solution),
        reactions: &solution.reactions,
        fixed_force_n: solution.fixed_force_n,
        fixed_reactions: &solution.fixed_reactions,
        tools: &solution.tools,
        needles: &solution.needles,
        wound: solution.wound.as_ref(),
        residual: solution.residual,
    }
}

fn print_text(args: &SolveArgs, solution: &Solution) {
    say!("{}: {} tissue at rest", solution.scene, solution.tissue);
    say!("  nodes              {:>10}", solution.drawn.points_m.len());
    say!("  cells              {:>10}", solution.drawn.cells.len());
    say!(
        "  displaced at most  {:>10.4} mm",
        1e3 * largest_m(solution)
    );
    say!("  residual           {:>10.1e}", solution.residual);
    for reaction in &solution.reactions {
        let name = reaction
            .name
            .clone()
            .unwrap_or_else(|| reaction.handle.to_string());
        say!(
            "  handle {name}: force on the tissue {} N",
            vector(&reaction.force_n)
        );
    }
    say!(
        "  fixed: force on the tissue {} N",
        vector(&solution.fixed_force_n)
    );
    for own in solution
        .fixed_reactions
        .iter()
        .filter(|_| solution.fixed_reactions.len() > 1)
    {
        say!(
            "  fixed {}: force on the tissue {} N, {} nodes",
            own.fixed,
            vector(&own.force_n),
            own.nodes
        );
    }
    for tool in &solution.tools {
        say!(
            "  tool {}: force on the tissue {} N, {} vertices touched, gap {:.3} mm",
            tool.tool,
            vector(&tool.force_n),
            tool.rows,
            1e3 * tool.gap_m
        );
    }
    for needle in &solution.needles {
        say!(
            "  needle {}: tip {}, {} punctures, through {} faces, axial force {:.4} N",
            needle.needle,
            needle.tip,
            needle.punctures,
            needle.crossings,
            needle.axial_n
        );
    }
    for thread in solution.wound.iter().flat_map(|wound| &wound.threads) {
        say!(
            "  thread {}: {}, through {} boundaries, {} spans bridge, tension {:.4} N",
            thread.thread,
            thread.state,
            thread.punctures,
            thread.bridges,
            thread.tension_n[0].max(thread.tension_n[1])
        );
    }
    if let Some((gap_m, ratio)) = solution
        .wound
        .as_ref()
        .and_then(|w| w.rim_gap_m.zip(w.gap_ratio))
    {
        say!(
            "  gap                {:>10.4} mm, {:.1} % of that at the start",
            1e3 * gap_m,
            1e2 * ratio
        );
    }
    say!("written to {}", args.out.display());
}

fn vector([x, y, z]: &[f64; 3]) -> String {
    format!("({x:.4}, {y:.4}, {z:.4})")
}
