//! `sutura solve`: the tissue at rest under a scene's handles, loads and held tools.

use crate::failure::{Cause, Failure};
use crate::{Format, Global, scene};
use clap::Args;
use std::path::PathBuf;
use sutura_host::output::{Solution, SolutionFormat};
use sutura_host::solve::{SolveError, solve};

/// Solves a scene at rest: handles at their targets, loads, and tools held where `position_m` says.
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub struct SolveArgs {
    /// Scene file.
    pub scene: PathBuf,
    /// Result file: .json or .vtu (ParaView).
    #[arg(short, long, value_name = "FILE")]
    pub out: PathBuf,
}

const EXAMPLES: &str = "\
Examples:
  sutura solve scenes/cube-handle.toml --out cube.vtu      open it in ParaView, then Warp By Vector
  sutura solve scenes/cube-handle.toml --out cube.json
  sutura solve scenes/palpation.toml --out pressed.json    a sphere held 9 mm deep in a slab

The JSON file has points_m, displacement_m, reactions[] (handle, force_n, torque_nm), tools[] and residual.
Forces and torques act on the tissue; the handle or the tool feels the opposite.";

/// Solves and writes the file.
///
/// # Errors
/// Bad input for a scene that cannot be used or solved and for a file that cannot be written.
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
    let scene = scene::open(Some(&args.scene))?;
    let solution = solve(&scene)?;
    solution.write(&args.out, format).map_err(|error| {
        let message = format!("cannot write {}: {error}", args.out.display());
        Failure::say(
            Cause::BadInput,
            message,
            "name a file in a directory that exists and is yours",
        )
    })?;
    match global.format {
        Format::Json => print_json(args, &solution),
        Format::Text => print_text(args, &solution),
    }
    Ok(())
}

impl From<SolveError> for Failure {
    fn from(error: SolveError) -> Failure {
        let cause = match error {
            SolveError::NoRest(_) => Cause::Failed,
            SolveError::Nothing | SolveError::Scene(_) | SolveError::Tissue(_) => Cause::BadInput,
        };
        Failure::new(cause, error)
    }
}

/// Largest displacement of a node \[m\].
fn largest_m(solution: &Solution) -> f64 {
    solution
        .displacement_m
        .iter()
        .map(length)
        .fold(0.0, f64::max)
}

fn length(v: &[f64; 3]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}

fn print_json(args: &SolveArgs, solution: &Solution) {
    let object = serde_json::json!({
        "status": "ok",
        "out": args.out.display().to_string(),
        "scene": solution.scene,
        "tissue": solution.tissue,
        "nodes": solution.points_m.len(),
        "cells": solution.cells.len(),
        "displacement_max_m": largest_m(solution),
        "reactions": solution.reactions,
        "tools": solution.tools,
        "residual": solution.residual,
    });
    say!("{object}");
}

fn print_text(args: &SolveArgs, solution: &Solution) {
    say!("{}: {} tissue at rest", solution.scene, solution.tissue);
    say!("  nodes              {:>10}", solution.points_m.len());
    say!("  cells              {:>10}", solution.cells.len());
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
    for tool in &solution.tools {
        say!(
            "  tool {}: force on the tissue {} N, {} vertices touched, gap {:.3} mm",
            tool.tool,
            vector(&tool.force_n),
            tool.rows,
            1e3 * tool.gap_m
        );
    }
    say!("written to {}", args.out.display());
}

fn vector([x, y, z]: &[f64; 3]) -> String {
    format!("({x:.4}, {y:.4}, {z:.4})")
}
