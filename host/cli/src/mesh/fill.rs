//! `sutura mesh fill`: tetrahedra inside a closed surface, by gmsh, a program of its own that is looked for on `PATH`.
//!
//! Entry point: [`fill`]. What is asked of the surface is looked at here, before gmsh runs; the size of the cells follows
//! from the number of nodes by a few runs.

use super::{
    Hint, QUICK_NODES, Times, bad, format_of, hints, measure, print_text, print_times, write,
};
use crate::failure::{Cause, Failure};
use crate::{Format, Global, display, files};
use clap::Args;
use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::Serialize;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::process::Command;
use sutura_host::mesh::{MeshReport, RawMesh, read_raw_mesh};
use sutura_host::tool::{ClosedMesh, MeshFlaw, read_stl};

/// The number of nodes counts as met within this part of it.
const CLOSE: f64 = 0.1;
/// Runs of gmsh at most: the number of nodes goes with the size of cells almost as the cube, three are mostly enough.
const MOST_RUNS: u32 = 8;

/// Arguments of `sutura mesh fill`.
#[derive(Args, Debug)]
pub struct FillArgs {
    /// Closed surface, .stl, binary or ASCII.
    surface: PathBuf,
    /// About how many nodes the mesh is to have.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(20..=1_000_000))]
    nodes: u32,
    /// New file: .msh (gmsh 2.2), .node or .ele (both are written), .vtk or .vtu.
    #[arg(short, long, value_name = "FILE")]
    out: PathBuf,
    /// Metres per unit of the surface's file; the new file is in metres.
    #[arg(long, value_name = "S", default_value_t = 1.0)]
    scale: f64,
    /// About how many vertices the step is to touch whose time is measured.
    #[arg(long, value_name = "N", default_value_t = 30, value_parser = clap::value_parser!(u32).range(1..=1000))]
    rows: u32,
}

/// What `sutura mesh fill --format json` prints.
#[derive(Serialize, JsonSchema)]
pub struct Filled {
    /// `ok`.
    status: &'static str,
    /// The surface's file.
    file: String,
    /// The new file.
    out: String,
    /// Triangles of the surface.
    triangles: usize,
    /// How many nodes were asked for.
    wanted_nodes: u32,
    /// How often gmsh ran.
    runs: u32,
    /// Length of edges that gmsh was asked for at last \[m\].
    wanted_edge_m: f64,
    #[serde(flatten)]
    report: MeshReport,
    /// What is allowed but hardly meant.
    warnings: Vec<Hint>,
    #[serde(flatten)]
    times: Times,
}

/// Fills a surface.
///
/// # Errors
/// Bad input: a surface that is not closed, crosses itself, or cannot be read; failed: gmsh is not there, or does not do it.
pub fn fill(args: &FillArgs, global: &Global) -> Result<(), Failure> {
    let format = format_of(&args.out)?;
    files::free(&args.out, global)?;
    let (bytes, surface) = read_surface(&args.surface, args.scale)?;
    let found = search(&bytes, &surface, args)?;
    let report = MeshReport::of(&found.mesh).map_err(|error| bad(&args.surface, &error))?;
    write(&found.mesh, &args.out, format)?;
    if let Some(refusal) = &report.refusal {
        tracing::warn!("scenes will refuse this mesh: {refusal}");
    }
    let off = report.nodes as f64 / f64::from(args.nodes) - 1.0;
    if off.abs() > CLOSE {
        tracing::warn!(
            "{} nodes were asked for, {} is as near as {} runs of gmsh came: a surface that is narrow for so few nodes has more",
            args.nodes,
            report.nodes,
            found.runs
        );
    }
    let trial = match report.nodes <= QUICK_NODES {
        true => measure(found.mesh, args.rows),
        false => Err(format!(
            "{} nodes: sutura mesh info --time measures it",
            report.nodes
        )),
    };
    let warnings = hints(&report);
    match global.format {
        Format::Json => display::object(&Filled {
            status: "ok",
            file: args.surface.display().to_string(),
            out: args.out.display().to_string(),
            triangles: surface.triangles().len(),
            wanted_nodes: args.nodes,
            runs: found.runs,
            wanted_edge_m: found.edge_m,
            times: Times::of(&trial),
            warnings,
            report,
        }),
        Format::Text => {
            print_text(&args.out, &report);
            print_times(&trial);
            for hint in warnings {
                say!("{}: {}", hint.message, hint.help);
            }
        }
    }
    Ok(())
}

/// The file's bytes, and the surface in metres.
fn read_surface(path: &Path, scale: f64) -> Result<(Vec<u8>, ClosedMesh), Failure> {
    let refuse = |message: String, help: &str| Failure::say(Cause::BadInput, message, help);
    if !(scale.is_finite() && scale > 0.0) {
        let message = format!("the scale to metres is {scale}");
        return Err(refuse(message, "it must be finite and above zero"));
    }
    if path
        .extension()
        .is_none_or(|e| !e.eq_ignore_ascii_case("stl"))
    {
        let message = format!("{}: surfaces are read from .stl files", path.display());
        return Err(refuse(
            message,
            "write it as STL: meshio convert part.ply part.stl, or by the program that made it",
        ));
    }
    let bytes = std::fs::read(path).map_err(|error| {
        let message = format!("cannot read {}: {error}", path.display());
        refuse(message, "name a surface: sutura mesh fill --help")
    })?;
    let surface = read_stl(&bytes, scale).map_err(|flaw| {
        let message = format!("{}: {flaw}", path.display());
        let next = match flaw {
            MeshFlaw::TooMany => "take fewer triangles: MeshLab's \"Quadric Edge Collapse Decimation\", or a coarser mask",
            _ => "mend the surface there: MeshLab's \"Close Holes\" and \"Re-Orient all faces\" do most",
        };
        refuse(message, next)
    })?;
    if let Some([one, other]) = crossing(&surface) {
        let corner = surface.triangles()[one][0];
        let [x, y, z]: [f64; 3] = surface.points_m()[corner as usize].into();
        let message = format!(
            "{}: triangles {one} and {other} cross each other at about [{x:.6}, {y:.6}, {z:.6}] m",
            path.display()
        );
        return Err(refuse(
            message,
            "join the parts that cross before: MeshLab's \"Mesh Boolean: Union\", or a mask that has no such place",
        ));
    }
    Ok((bytes, surface))
}

/// Two triangles of which an edge of one goes through the other, counted from 0. Those in one plane are left to gmsh.
fn crossing(surface: &ClosedMesh) -> Option<[usize; 2]> {
    let corners = |triangle: usize| {
        surface.triangles()[triangle].map(|point| surface.points_m()[point as usize])
    };
    let bounds: Vec<_> = (0..surface.triangles().len())
        .map(|triangle| {
            let [a, b, c] = corners(triangle);
            (a.inf(&b).inf(&c), a.sup(&b).sup(&c))
        })
        .collect();
    // A sweep along x: only those whose boxes overlap there are compared.
    let mut order: Vec<usize> = (0..bounds.len()).collect();
    order.sort_by(|a, b| bounds[*a].0.x.total_cmp(&bounds[*b].0.x));
    for (place, &one) in order.iter().enumerate() {
        let (low, high) = bounds[one];
        let near = order[place + 1..].iter();
        for &other in near.take_while(|other| bounds[**other].0.x <= high.x) {
            let (other_low, other_high) = bounds[other];
            let apart = (1..3).any(|k| low[k] > other_high[k] || other_low[k] > high[k]);
            if apart {
                continue;
            }
            let names = [one, other].map(|triangle| surface.triangles()[triangle]);
            let goes_through = |edges: [u32; 3], face: [u32; 3]| {
                let at = |point: u32| surface.points_m()[point as usize];
                (0..3).any(|k| {
                    let (from, to) = (edges[k], edges[(k + 1) % 3]);
                    let has_common = face.contains(&from) || face.contains(&to);
                    !has_common && cuts(at(from), at(to), face.map(at))
                })
            };
            if goes_through(names[0], names[1]) || goes_through(names[1], names[0]) {
                return Some([one.min(other), one.max(other)]);
            }
        }
    }
    None
}

/// Whether a line passes from one side of a triangle to the other within its edges, by the signs of volumes.
fn cuts(from: Vector3<f64>, to: Vector3<f64>, [a, b, c]: [Vector3<f64>; 3]) -> bool {
    let side = |p: Vector3<f64>, q: Vector3<f64>, r: Vector3<f64>, at: Vector3<f64>| {
        (q - p).cross(&(r - p)).dot(&(at - p))
    };
    let ends = side(a, b, c, from) * side(a, b, c, to);
    let around = [(a, b), (b, c), (c, a)].map(|(p, q)| side(from, to, p, q));
    ends < 0.0 && (around.iter().all(|x| *x > 0.0) || around.iter().all(|x| *x < 0.0))
}

struct Found {
    mesh: RawMesh,
    edge_m: f64,
    runs: u32,
}

/// Runs gmsh with one size of cells after the other until the number of nodes is near; the nearest of them.
fn search(bytes: &[u8], surface: &ClosedMesh, args: &FillArgs) -> Result<Found, Failure> {
    let failed = |error: std::io::Error| {
        let help = "the folder for temporary files has to be there, and yours";
        Failure::say(Cause::Failed, format!("no place to work in: {error}"), help)
    };
    let folder = tempfile::tempdir().map_err(failed)?;
    std::fs::write(folder.path().join("surface.stl"), bytes).map_err(failed)?;
    let wanted = f64::from(args.nodes);
    // A regular tetrahedron has the volume of its edge cubed over the root of 72; a mesh has some five cells a node.
    let mut edge_m = (volume_m3(surface) * 72f64.sqrt() / (5.0 * wanted)).cbrt();
    // Sizes known to give too many nodes, and too few.
    let (mut fine, mut coarse) = (0.0f64, f64::INFINITY);
    let mut nearest: Option<(f64, Found)> = None;
    for runs in 1..=MOST_RUNS {
        let mesh = run_gmsh(folder.path(), edge_m, args.scale)?;
        let ratio = mesh.points_m.len() as f64 / wanted;
        tracing::info!(
            "edges of {:.3} mm: {} nodes",
            1e3 * edge_m,
            mesh.points_m.len()
        );
        match ratio > 1.0 {
            true => fine = fine.max(edge_m),
            false => coarse = coarse.min(edge_m),
        }
        let off = ratio.ln().abs();
        if nearest.as_ref().is_none_or(|(least, _)| off < *least) {
            nearest = Some((off, Found { mesh, edge_m, runs }));
        }
        if let Some((_, found)) = &mut nearest {
            found.runs = runs;
        }
        if (ratio - 1.0).abs() <= CLOSE {
            break;
        }
        let next = edge_m * ratio.cbrt();
        edge_m = match fine < next && next < coarse {
            true => next,
            false if fine > 0.0 && coarse.is_finite() => (fine * coarse).sqrt(),
            false => edge_m * if ratio > 1.0 { 1.3 } else { 0.77 },
        };
    }
    let nothing = || Failure::say(Cause::Failed, "gmsh made no mesh", "look at the surface");
    nearest.map(|(_, found)| found).ok_or_else(nothing)
}

fn volume_m3(surface: &ClosedMesh) -> f64 {
    let six_fold = surface.triangles().iter().map(|triangle| {
        let [a, b, c] = triangle.map(|point| surface.points_m()[point as usize]);
        a.dot(&b.cross(&c))
    });
    six_fold.sum::<f64>() / 6.0
}

/// One mesh, in metres, of cells with edges of about this length. The surface is meshed anew: that of a segmentation has
/// steps of its voxels, and never the size that is wanted. Edges sharper than 85 degrees stay: the steps of marching cubes
/// are of 45 to 70, and as edges of patches they are more than gmsh can flatten.
fn run_gmsh(folder: &Path, edge_m: f64, scale: f64) -> Result<RawMesh, Failure> {
    let edge = edge_m / scale;
    let script = format!(
        "h = {edge:e};\n\
         Merge \"surface.stl\";\n\
         ClassifySurfaces{{85*Pi/180, 1, 1, Pi}};\n\
         CreateGeometry;\n\
         Surface Loop(1) = Surface{{:}};\n\
         Volume(1) = {{1}};\n\
         Physical Volume(\"tissue\", 1) = {{1}};\n\
         Mesh.MeshSizeMin = h;\n\
         Mesh.MeshSizeMax = h;\n\
         Mesh.Optimize = 1;\n"
    );
    let said = |message: String, help: &str| Failure::say(Cause::Failed, message, help);
    std::fs::write(folder.join("fill.geo"), script).map_err(|error| {
        said(
            format!("cannot write for gmsh: {error}"),
            "make room for it",
        )
    })?;
    let filled = folder.join("filled.msh");
    let arguments = [
        "fill.geo",
        "-3",
        "-format",
        "msh41",
        "-bin",
        "-v",
        "2",
        "-o",
        "filled.msh",
    ];
    let output = Command::new("gmsh")
        .args(arguments)
        .current_dir(folder)
        .output()
        .map_err(|error| match error.kind() {
            ErrorKind::NotFound => said(
                "gmsh, which fills surfaces, is not on PATH".into(),
                "install it: pip install gmsh, or apt install gmsh; then gmsh --version answers",
            ),
            _ => said(
                format!("gmsh does not start: {error}"),
                "gmsh --version has to answer",
            ),
        })?;
    let words = [output.stdout, output.stderr].concat();
    let words = String::from_utf8_lossy(&words);
    let error = words.lines().find(|line| line.contains("Error"));
    if !output.status.success() || error.is_some() || !filled.is_file() {
        let last = error.or(words.lines().last()).unwrap_or("nothing");
        return Err(said(
            format!("gmsh did not fill the surface; it says: {}", last.trim()),
            "smooth and simplify the surface, or ask for more nodes: it is narrower somewhere than cells of this size",
        ));
    }
    let mesh = read_raw_mesh(&filled, scale).map_err(|error| {
        let help = "gmsh 4.8 or later is needed; gmsh --version says which there is";
        said(format!("what gmsh wrote cannot be read: {error}"), help)
    })?;
    std::fs::remove_file(&filled).ok();
    Ok(mesh)
}
