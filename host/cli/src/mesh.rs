//! `sutura mesh`: what a mesh file is like, the same mesh in another format, and one inside a closed surface.

mod fill;
mod overlap;

pub use fill::Filled;

use crate::failure::{Cause, Failure};
use crate::{Format, Global, display, files};
use clap::{Args, Subcommand};
use schemars::JsonSchema;
use serde::Serialize;
use std::path::{Path, PathBuf};
use sutura_files::read_plain;
use sutura_host::mesh::{Cleaned, MOST_BYTES, MeshError, MeshReport, RawMesh, read_raw_mesh_with};
use sutura_host::output::{MeshFormat, write_mesh};
use sutura_host::scene::unlikely_size;
use sutura_study::trial::{Trial, trial};

/// Looks at tetrahedral mesh files, converts them (gmsh, tetgen, VTK, medit, abaqus), and fills closed surfaces.
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub struct MeshArgs {
    #[command(subcommand)]
    command: MeshCommand,
}

const EXAMPLES: &str = "\
Examples:
  sutura mesh info tests/data/cube_1650.msh
  sutura mesh convert part.node --out part.msh
  sutura mesh fill liver.stl --nodes 1500 --out liver.msh --scale 0.001";

const INFO_EXAMPLES: &str = "\
Examples:
  sutura mesh info tests/data/cube_1650.msh
  sutura mesh info part.vtk --scale 0.001                   a file in millimetres
  sutura mesh info organ.vtk --region tissue_class          regions of a cell array with a name of its own
  sutura mesh info part.ele --format json | jq .quality     part.node is read too
  sutura mesh info large.msh --time --rows 100              times of a step that touches about 100 vertices

Times are measured, on this machine: the stiffness of the mesh is factored with the lowest nodes of every part fixed, and a sphere that
touches about as many vertices as --rows says is pressed on its top. Factoring once takes factor_ms, a vertex that
is touched for the first time column_us, every step step_us. Above 5,000 nodes this takes long: ask for it with --time.

Quality is the mean ratio: 1 for a regular tetrahedron, 0 for a flat one, below 0 for an inverted one.
Inverted and flat cells are counted here; scenes refuse a mesh that has any, with the first one's number.";

const CONVERT_EXAMPLES: &str = "\
Examples:
  sutura mesh convert part.node --out part.msh              tetgen to gmsh 2.2, regions kept
  sutura mesh convert part.vtk --out part.msh --scale 0.001  millimetres to metres
  sutura mesh convert part.inp --out part.msh --clean       nodes without cells dropped, inverted cells turned
  sutura mesh convert part.msh --out part.vtu               ParaView: colour by mean_ratio or region";

const FILL_EXAMPLES: &str = "\
Examples:
  sutura mesh fill liver.stl --nodes 1500 --out liver.msh --scale 0.001  a surface in millimetres; the mesh is in metres
  sutura mesh fill liver.stl --nodes 300 --out liver.vtu --format json
  sutura mesh fill lobe.ply --nodes 1000 --out lobe.msh --scale 0.001  .obj and .ply too; faces of more corners are split

gmsh does it, a program of its own: pip install gmsh, or apt install gmsh. It meshes the surface anew with triangles of one size, and the
inside with tetrahedra; it runs with one size after another until there are about as many nodes as asked for, within a tenth.
Points that lie on each other are welded, triangles with two corners at one place or there twice dropped, others turned over to look outwards, and all of it
is said. A surface that is open, crosses itself, or has more than two faces at an edge is refused, with the faces by their number, from 0.";

#[derive(Subcommand, Debug)]
enum MeshCommand {
    /// Counts, sizes, quality, regions, whether scenes take the mesh, and how fast steps will be.
    #[command(after_help = INFO_EXAMPLES)]
    Info {
        #[command(flatten)]
        input: Input,
        /// Measure the times of a step above 5,000 nodes too.
        #[arg(long)]
        time: bool,
        /// About how many vertices that step is to touch.
        #[arg(long, value_name = "N", default_value_t = 30, value_parser = clap::value_parser!(u32).range(1..=1000))]
        rows: u32,
    },
    /// Writes the mesh in another format, good or bad as it is; only nodes, tetrahedra and regions are kept.
    #[command(after_help = CONVERT_EXAMPLES)]
    Convert {
        #[command(flatten)]
        input: Input,
        /// New file: .msh (gmsh 2.2), .node or .ele (both are written), .vtk or .vtu.
        #[arg(short, long, value_name = "FILE")]
        out: PathBuf,
        /// Drop nodes that no cell uses, and turn inverted cells; regions are kept.
        #[arg(long)]
        clean: bool,
    },
    /// Fills a closed surface with tetrahedra, by gmsh: about as many nodes as asked for.
    #[command(after_help = FILL_EXAMPLES)]
    Fill(fill::FillArgs),
}

#[derive(Args, Debug)]
struct Input {
    /// Mesh file: .msh, .node or .ele, .vtk, .vtu, .mesh, .inp.
    file: PathBuf,
    /// Metres per unit of the file.
    #[arg(long, value_name = "S", default_value_t = 1.0)]
    scale: f64,
    /// Cell array of a .vtk or .vtu that has the regions; one of a name that is known when left out.
    #[arg(long, value_name = "NAME")]
    region: Option<String>,
}

/// Reports on a mesh or converts it.
///
/// # Errors
/// Bad input: a file that cannot be read or written, a scale that is not positive.
pub fn run(args: &MeshArgs, global: &Global) -> Result<(), Failure> {
    match &args.command {
        MeshCommand::Info { input, time, rows } => info(input, *time, *rows, global),
        MeshCommand::Convert { input, out, clean } => convert(input, out, *clean, global),
        MeshCommand::Fill(args) => fill::fill(args, global),
    }
}

fn read(input: &Input) -> Result<(RawMesh, MeshReport), Failure> {
    let region = input.region.as_deref();
    let read = read_raw_mesh_with(&input.file, input.scale, region, |path| {
        read_plain(path, MOST_BYTES)
    });
    read.and_then(|mesh| MeshReport::of(&mesh).map(|report| (mesh, report)))
        .map_err(|error| match error {
            MeshError::Unreadable { .. } | MeshError::Extension(_) | MeshError::Scale(_) => {
                let help = "name a mesh file: sutura mesh info --help";
                Failure::say(Cause::BadInput, error.to_string(), help)
            }
            MeshError::NoCellArray { .. } => {
                let help = "give --region the name of one of its cell arrays; other formats than .vtk and .vtu have none";
                let message = format!("{}: {error}", input.file.display());
                Failure::say(Cause::BadInput, message, help)
            }
            error => bad(&input.file, &error),
        })
}

fn bad(file: &Path, error: &MeshError) -> Failure {
    Failure::say(
        Cause::BadInput,
        format!("{}: {error}", file.display()),
        "mend the file at that place, or write it again with the program that made it",
    )
}

/// What `sutura mesh info --format json` prints.
#[derive(Serialize, JsonSchema)]
pub struct Info {
    /// `ok`.
    status: &'static str,
    /// The mesh's file.
    file: String,
    #[serde(flatten)]
    report: MeshReport,
    /// What is allowed but hardly meant.
    warnings: Vec<Hint>,
    #[serde(flatten)]
    times: Times,
}

/// A warning.
#[derive(Serialize, JsonSchema)]
struct Hint {
    /// What there is.
    message: String,
    /// What to do about it.
    help: String,
}

/// What `sutura mesh convert --format json` prints.
#[derive(Serialize, JsonSchema)]
pub struct Converted {
    /// `ok`.
    status: &'static str,
    /// The mesh's file.
    file: String,
    /// The new file.
    out: String,
    /// What `--clean` did.
    cleaned: Option<Cleaned>,
    #[serde(flatten)]
    report: MeshReport,
}

/// Times of a step on the mesh; none if they were not measured.
#[derive(Default, Serialize, JsonSchema)]
struct Times {
    /// Assembly and factorisation, with the lowest nodes fixed \[ms\].
    factor_ms: Option<f64>,
    /// Memory of the factor \[MB\].
    factor_mb: Option<f64>,
    /// The compliance columns of one vertex, when it is touched for the first time \[us\].
    column_us: Option<f64>,
    /// Median of the deeper steps of the press, with all columns at hand \[us\].
    step_us: Option<f64>,
    /// Vertices that the sphere touched at most: the rows of the step.
    step_rows: Option<u32>,
    /// Radius of the sphere \[m\].
    step_radius_m: Option<f64>,
    /// How the last step ended, `ok` if all is well; else why nothing was measured.
    step_status: String,
}

impl Times {
    fn of(trial: &Result<Trial, String>) -> Times {
        match trial {
            Ok(trial) => Times {
                factor_ms: Some(trial.factor_ms),
                factor_mb: Some(trial.factor_mb),
                column_us: Some(trial.column_us),
                step_us: trial.step_us,
                step_rows: Some(trial.step_rows),
                step_radius_m: Some(trial.step_radius_m),
                step_status: trial.step_status.to_owned(),
            },
            Err(why) => Times {
                step_status: why.clone(),
                ..Times::default()
            },
        }
    }
}

/// Nodes up to which times are measured unasked: the factorisation then takes a fraction of a second.
const QUICK_NODES: usize = 5000;

fn info(input: &Input, time: bool, rows: u32, global: &Global) -> Result<(), Failure> {
    let (mesh, report) = read(input)?;
    let trial = if time || report.nodes <= QUICK_NODES {
        measure(mesh, rows)
    } else {
        Err(format!("{} nodes: ask for it with --time", report.nodes))
    };
    let warnings = hints(&report);
    match global.format {
        Format::Json => display::object(&Info {
            status: "ok",
            file: input.file.display().to_string(),
            times: Times::of(&trial),
            warnings,
            report,
        }),
        Format::Text => {
            print_text(&input.file, &report);
            print_times(&trial);
            for hint in warnings {
                say!("{}: {}", hint.message, hint.help);
            }
        }
    }
    Ok(())
}

fn hints(report: &MeshReport) -> Vec<Hint> {
    let largest_m = report.size_m.iter().copied().fold(0.0, f64::max);
    let hints = unlikely_size(largest_m, "--scale").into_iter();
    hints
        .map(|(message, help)| Hint { message, help })
        .collect()
}

/// Times of a step on the mesh, or why there are none.
fn measure(mesh: RawMesh, rows: u32) -> Result<Trial, String> {
    if cfg!(debug_assertions) {
        tracing::warn!("a debug build: the times are many times too large");
    }
    let mesh = mesh
        .check()
        .map_err(|_| "scenes refuse this mesh".to_owned())?;
    trial(&mesh, rows).map_err(|error| error.to_string())
}

fn print_times(trial: &Result<Trial, String>) {
    match trial {
        Err(why) => say!("  step time          not measured: {why}"),
        Ok(trial) => {
            say!(
                "  factor             {:.1} ms, {:.1} MB",
                trial.factor_ms,
                trial.factor_mb
            );
            say!(
                "  first touch        {:.0} us for a vertex",
                trial.column_us
            );
            match trial.step_us {
                Some(us) => say!(
                    "  step               {us:.0} us for {} rows, a sphere of {:.2} mm",
                    trial.step_rows,
                    1e3 * trial.step_radius_m
                ),
                None => say!(
                    "  step               no rest was found: {}",
                    trial.step_status
                ),
            }
        }
    }
}

fn convert(input: &Input, out: &Path, clean: bool, global: &Global) -> Result<(), Failure> {
    // Before the work: a mesh that cannot be written need not be read.
    let format = format_of(out)?;
    free(out, &input.file, global)?;
    let (mut mesh, mut report) = read(input)?;
    let cleaned = clean.then(|| mesh.clean());
    if clean {
        report = MeshReport::of(&mesh).map_err(|error| bad(&input.file, &error))?;
    }
    write(&mesh, out, format)?;
    if let Some(refusal) = &report.refusal {
        tracing::warn!("scenes will refuse this mesh: {refusal}");
    }
    match global.format {
        Format::Json => display::object(&Converted {
            status: "ok",
            file: input.file.display().to_string(),
            out: out.display().to_string(),
            cleaned,
            report,
        }),
        Format::Text => {
            for note in &report.notes {
                say!("{note}");
            }
            if let Some(done) = cleaned {
                say!(
                    "{} nodes without a cell dropped, {} inverted cells turned",
                    done.dropped_nodes,
                    done.turned_cells
                );
            }
            say!(
                "{} nodes and {} cells written to {}",
                report.nodes,
                report.cells,
                out.display()
            );
        }
    }
    Ok(())
}

fn format_of(out: &Path) -> Result<MeshFormat, Failure> {
    MeshFormat::of(out).ok_or_else(|| {
        let message = format!("{}: not a mesh format that is written", out.display());
        let help = "end the name in .msh, .node, .ele, .vtk or .vtu";
        Failure::say(Cause::BadInput, message, help)
    })
}

/// Files of a mesh: tetgen's are two.
fn files_of(mesh: &Path) -> Vec<PathBuf> {
    match mesh.extension().and_then(|end| end.to_str()) {
        Some("node" | "ele") => ["node", "ele"].map(|end| mesh.with_extension(end)).into(),
        _ => vec![mesh.to_owned()],
    }
}

/// Whether a mesh may be written there, beside one that is read.
fn free(out: &Path, read: &Path, global: &Global) -> Result<(), Failure> {
    for file in files_of(out) {
        files::never_over(&file, &files_of(read))?;
        files::free(&file, global)?;
    }
    Ok(())
}

fn write(mesh: &RawMesh, out: &Path, format: MeshFormat) -> Result<(), Failure> {
    write_mesh(mesh, out, format).map_err(|error| files::unwritable(out, &error))
}

fn print_text(file: &Path, report: &MeshReport) {
    let [x, y, z] = report.size_m.map(|size| 1e3 * size);
    let (edge, quality) = (&report.edge_m, &report.quality);
    say!("{}", file.display());
    say!("  nodes              {:>10}", report.nodes);
    say!("  cells              {:>10}", report.cells);
    say!("  boundary faces     {:>10}", report.boundary_faces);
    say!("  inverted cells     {:>10}", report.inverted);
    say!("  flat cells         {:>10}", report.flat);
    say!("  unused nodes       {:>10}", report.unreferenced);
    say!("  size               {x:.3} x {y:.3} x {z:.3} mm");
    say!("  volume             {:.6} ml", 1e6 * report.volume_m3);
    say!(
        "  edges              {:.3} mm to {:.3} mm, mean {:.3} mm",
        1e3 * edge.min,
        1e3 * edge.max,
        1e3 * edge.mean
    );
    say!(
        "  mean ratio         {:.3} at worst, {:.3} for 1 %, {:.3} for half",
        quality.min,
        quality.p01,
        quality.p50
    );
    for region in &report.regions {
        let name = region.name.as_deref().unwrap_or("");
        say!(
            "  region {:<6} {:>16} cells, {:.6} ml  {name}",
            region.region,
            region.cells,
            1e6 * region.volume_m3
        );
    }
    for note in &report.notes {
        say!("  {note}");
    }
    match &report.refusal {
        None => say!("scenes take this mesh"),
        Some(why) => say!("scenes refuse this mesh: {why}"),
    }
}
