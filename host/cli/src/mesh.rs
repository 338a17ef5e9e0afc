//! `sutura mesh`: what a mesh file is like, and the same mesh in another format.

use crate::failure::{Cause, Failure};
use crate::{Format, Global};
use clap::{Args, Subcommand};
use std::path::{Path, PathBuf};
use sutura_host::mesh::{MeshError, MeshReport, RawMesh, read_raw_mesh};
use sutura_host::output::{MeshFormat, write_mesh};

/// Looks at tetrahedral mesh files and converts them: .msh (gmsh), .node and .ele (tetgen), .vtk.
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub struct MeshArgs {
    #[command(subcommand)]
    command: MeshCommand,
}

const EXAMPLES: &str = "\
Examples:
  sutura mesh info tests/data/cube_1650.msh
  sutura mesh convert part.node --out part.msh";

const INFO_EXAMPLES: &str = "\
Examples:
  sutura mesh info tests/data/cube_1650.msh
  sutura mesh info part.vtk --scale 0.001                   a file in millimetres
  sutura mesh info part.ele --format json | jq .quality     part.node is read too

Quality is the mean ratio: 1 for a regular tetrahedron, 0 for a flat one, below 0 for an inverted one.
Inverted and flat cells are counted here; scenes refuse a mesh that has any, with the first one's number.";

const CONVERT_EXAMPLES: &str = "\
Examples:
  sutura mesh convert part.node --out part.msh              tetgen to gmsh 2.2, regions kept
  sutura mesh convert part.vtk --out part.msh --scale 0.001 millimetres to metres
  sutura mesh convert part.msh --out part.vtu               ParaView: colour by mean_ratio or region";

#[derive(Subcommand, Debug)]
enum MeshCommand {
    /// Counts, sizes, quality, regions, and whether scenes take the mesh.
    #[command(after_help = INFO_EXAMPLES)]
    Info {
        #[command(flatten)]
        input: Input,
    },
    /// Writes the mesh in another format, good or bad as it is; only nodes and tetrahedra are kept.
    #[command(after_help = CONVERT_EXAMPLES)]
    Convert {
        #[command(flatten)]
        input: Input,
        /// New file: .msh (gmsh 2.2), .node or .ele (both are written), .vtk or .vtu.
        #[arg(short, long, value_name = "FILE")]
        out: PathBuf,
    },
}

#[derive(Args, Debug)]
struct Input {
    /// Mesh file: .msh, .node or .ele, .vtk.
    file: PathBuf,
    /// Metres per unit of the file.
    #[arg(long, value_name = "S", default_value_t = 1.0)]
    scale: f64,
}

/// Reports on a mesh or converts it.
///
/// # Errors
/// Bad input: a file that cannot be read or written, a scale that is not positive.
pub fn run(args: &MeshArgs, global: &Global) -> Result<(), Failure> {
    match &args.command {
        MeshCommand::Info { input } => info(input, global),
        MeshCommand::Convert { input, out } => convert(input, out, global),
    }
}

fn read(input: &Input) -> Result<(RawMesh, MeshReport), Failure> {
    let read = read_raw_mesh(&input.file, input.scale);
    read.and_then(|mesh| MeshReport::of(&mesh).map(|report| (mesh, report)))
        .map_err(|error| match error {
            MeshError::Unreadable { .. } | MeshError::Extension(_) | MeshError::Scale(_) => {
                let help = "name a mesh file: sutura mesh info --help";
                Failure::say(Cause::BadInput, error.to_string(), help)
            }
            error => Failure::say(
                Cause::BadInput,
                format!("{}: {error}", input.file.display()),
                "mend the file at that place, or write it again with the program that made it",
            ),
        })
}

fn info(input: &Input, global: &Global) -> Result<(), Failure> {
    let (_, report) = read(input)?;
    match global.format {
        Format::Json => print_json(&report, &[("file", &input.file)]),
        Format::Text => print_text(&input.file, &report),
    }
    Ok(())
}

fn convert(input: &Input, out: &Path, global: &Global) -> Result<(), Failure> {
    // Before the work: a mesh that cannot be written need not be read.
    let Some(format) = MeshFormat::of(out) else {
        let message = format!("{}: not a mesh format that is written", out.display());
        let help = "end the name in .msh, .node, .ele, .vtk or .vtu";
        return Err(Failure::say(Cause::BadInput, message, help));
    };
    let (mesh, report) = read(input)?;
    write_mesh(&mesh, out, format).map_err(|error| {
        let message = format!("cannot write {}: {error}", out.display());
        let help = "name a file in a directory that exists and is yours";
        Failure::say(Cause::BadInput, message, help)
    })?;
    if let Some(refusal) = &report.refusal {
        tracing::warn!("scenes will refuse this mesh: {refusal}");
    }
    match global.format {
        Format::Json => print_json(&report, &[("file", &input.file), ("out", &out.to_owned())]),
        Format::Text => println!(
            "{} nodes and {} cells written to {}",
            report.nodes,
            report.cells,
            out.display()
        ),
    }
    Ok(())
}

fn print_json(report: &MeshReport, files: &[(&str, &PathBuf)]) {
    let mut object = serde_json::json!(report);
    object["status"] = "ok".into();
    for (key, path) in files {
        object[*key] = path.display().to_string().into();
    }
    println!("{object}");
}

fn print_text(file: &Path, report: &MeshReport) {
    let [x, y, z] = report.size_m.map(|size| 1e3 * size);
    let (edge, quality) = (&report.edge_m, &report.quality);
    println!("{}", file.display());
    println!("  nodes              {:>10}", report.nodes);
    println!("  cells              {:>10}", report.cells);
    println!("  boundary faces     {:>10}", report.boundary_faces);
    println!("  inverted cells     {:>10}", report.inverted);
    println!("  flat cells         {:>10}", report.flat);
    println!("  unused nodes       {:>10}", report.unreferenced);
    println!("  size               {x:.3} x {y:.3} x {z:.3} mm");
    println!("  volume             {:.6} ml", 1e6 * report.volume_m3);
    println!(
        "  edges              {:.3} mm to {:.3} mm, mean {:.3} mm",
        1e3 * edge.min,
        1e3 * edge.max,
        1e3 * edge.mean
    );
    println!(
        "  mean ratio         {:.3} at worst, {:.3} for 1 %, {:.3} for half",
        quality.min, quality.p01, quality.p50
    );
    for region in &report.regions {
        let name = region.name.as_deref().unwrap_or("");
        println!(
            "  region {:<6} {:>16} cells, {:.6} ml  {name}",
            region.region,
            region.cells,
            1e6 * region.volume_m3
        );
    }
    match &report.refusal {
        None => println!("scenes take this mesh"),
        Some(why) => println!("scenes refuse this mesh: {why}"),
    }
}
