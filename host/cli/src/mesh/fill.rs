//! `sutura mesh fill`: tetrahedra inside a closed surface, by gmsh, a program of its own that is looked for on `PATH`.
//!
//! Entry point: [`fill`]. What is asked of the surface is looked at here, before gmsh runs; the size of the cells follows
//! from the number of nodes by a few runs.

use super::overlap::overlaps;
use super::{
    Hint, QUICK_NODES, Times, bad, format_of, hints, measure, print_text, print_times, write,
};
use crate::failure::{Cause, Failure};
use crate::signals::{stop_on_signals, stopped};
use crate::{Format, Global, display};
use clap::Args;
use schemars::JsonSchema;
use serde::Serialize;
use std::io::{self, ErrorKind};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::Duration;
use sutura_files::read_plain;
use sutura_host::boxes::Bounds;
use sutura_host::mesh::{
    MOST_BYTES, MeshError, MeshReport, RawMesh, Repaired, SurfaceFlaw, SurfaceFormat, TriangleMesh,
    read_raw_mesh,
};
use sutura_host::tool::crossing;
use sutura_host::work::begin;

/// The number of nodes counts as met within this part of it.
const CLOSE: f64 = 0.1;
/// Runs of gmsh at most: the number of nodes goes with the size of cells almost as the cube, three are mostly enough.
const MOST_RUNS: u32 = 8;
/// Bodies of a surface at most: gmsh runs for each.
const MOST_BODIES: usize = 20;
/// Between two looks whether gmsh has ended.
const LOOKS_EVERY: Duration = Duration::from_millis(20);
/// Lines of gmsh that a message has at most.
const MOST_TOLD: usize = 8;
/// gmsh works in millimetres \[m\]: its tolerances are made for numbers about 1.
const MM: f64 = 0.001;
/// The head of the surface that gmsh is given, filled up with blanks to 80 bytes.
const HEAD: &str = "binary STL in millimetres, by sutura";

/// Arguments of `sutura mesh fill`.
#[derive(Args, Debug)]
pub struct FillArgs {
    /// Closed surface: .stl, .obj or .ply, binary or ASCII.
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
    /// Triangles of the surface, repaired.
    triangles: usize,
    /// What was put right of it.
    repaired: Repaired,
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
    super::free(&args.out, &args.surface, global)?;
    let shown = crate::work::watch();
    let (surface, repaired) = read_surface(&args.surface, args.scale)?;
    // From here on Ctrl-C ends gmsh, too.
    stop_on_signals()?;
    let found = search(&bodies(&surface, &args.surface)?, args)?;
    let mut said: Vec<Hint> = found.failed.into_iter().collect();
    said.extend(overlaps(&found.mesh, &found.bodies));
    drop(shown);
    let mut report = MeshReport::of(&found.mesh).map_err(|error| bad(&args.surface, &error))?;
    report.notes.splice(0..0, notes(&repaired));
    write(&found.mesh, &args.out, format)?;
    if let Some(refusal) = &report.refusal {
        tracing::warn!("scenes will refuse this mesh: {refusal}");
    }
    let off = report.nodes as f64 / f64::from(args.nodes) - 1.0;
    if off.abs() > CLOSE {
        said.push(Hint {
            message: format!(
                "{} nodes were asked for, {} is as near as {} runs of gmsh came",
                args.nodes, report.nodes, found.runs
            ),
            help: "a surface that is narrow for so few nodes has more".to_owned(),
        });
    }
    for hint in &said {
        tracing::warn!("{}: {}", hint.message, hint.help);
    }
    let trial = match report.nodes <= QUICK_NODES {
        true => measure(found.mesh, args.rows),
        false => Err(format!(
            "{} nodes: sutura mesh info --time measures it",
            report.nodes
        )),
    };
    let warnings: Vec<Hint> = hints(&report).into_iter().chain(said).collect();
    match global.format {
        Format::Json => display::object(&Filled {
            status: "ok",
            file: args.surface.display().to_string(),
            out: args.out.display().to_string(),
            triangles: surface.triangles.len(),
            repaired,
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
            for hint in hints(&report) {
                say!("{}: {}", hint.message, hint.help);
            }
        }
    }
    Ok(())
}

/// The surface in metres, repaired where there is one way to do it, and what that did.
fn read_surface(path: &Path, scale: f64) -> Result<(TriangleMesh, Repaired), Failure> {
    let refuse = |message: String, help: &str| Failure::say(Cause::BadInput, message, help);
    let format = SurfaceFormat::of(path).map_err(|error| {
        let help = "write it as one of these: meshio convert part.off part.ply, or by the program that made it";
        refuse(error.to_string(), help)
    })?;
    let bytes = read_plain(path, MOST_BYTES).map_err(|error| {
        let message = format!("cannot read {}: {error}", path.display());
        refuse(message, "name a surface: sutura mesh fill --help")
    })?;
    let flawed =
        |flaw: SurfaceFlaw| refuse(format!("{}: {flaw}", path.display()), next_step(&flaw));
    begin("reading the surface", || format!("{} bytes", bytes.len()));
    let read = format.read(&bytes, scale);
    let mut surface = read.map_err(|error| flawed(error.into()))?;
    let size = |surface: &TriangleMesh| format!("{} triangles", surface.triangles.len());
    begin("repairing the surface", || size(&surface));
    let repaired = surface.repair().map_err(flawed)?;
    begin("looking where the surface crosses itself", || {
        size(&surface)
    });
    if let Some(found) = crossing(&surface) {
        let ([one, other], [x, y, z]) = (found.triangles, found.at_m);
        let filled = match repaired.filled_holes {
            0 => "",
            _ => " (or what fills a hole beside them)",
        };
        let message = format!(
            "{}: faces {} and {}{filled} cross each other at about [{x:.6}, {y:.6}, {z:.6}] m",
            path.display(),
            surface.face(one),
            surface.face(other)
        );
        return Err(refuse(
            message,
            "join the parts that cross before: MeshLab's \"Mesh Boolean: Union\", or a mask that has no such place",
        ));
    }
    Ok((surface, repaired))
}

/// The bodies of a repaired surface.
fn bodies(surface: &TriangleMesh, path: &Path) -> Result<Vec<TriangleMesh>, Failure> {
    let bad = |message: String, help: &str| Failure::say(Cause::BadInput, message, help);
    let bodies = surface.bodies().map_err(|flaw| {
        let help = next_step(&flaw);
        bad(format!("{}: {flaw}", path.display()), help)
    })?;
    if bodies.len() > MOST_BODIES {
        let count = bodies.len();
        return Err(bad(
            format!(
                "{}: {count} bodies that hang together with nothing, {MOST_BODIES} can be filled",
                path.display()
            ),
            "keep those that are meant: skimage.measure.label for a mask, MeshLab's \"Remove Isolated Pieces\" for a surface",
        ));
    }
    Ok(bodies)
}

/// What to do about a surface that is not repaired here.
fn next_step(flaw: &SurfaceFlaw) -> &'static str {
    match flaw {
        SurfaceFlaw::File(MeshError::Scale(_)) => {
            "--scale takes metres per unit of the file: 0.001 for millimetres"
        }
        SurfaceFlaw::File(_) => {
            "mend the file at that place, or write it again with the program that made it"
        }
        SurfaceFlaw::Open { .. } => {
            "close it: MeshLab's \"Close Holes\"; a surface by marching cubes needs a margin of one voxel around the mask"
        }
        SurfaceFlaw::Crowded { .. } | SurfaceFlaw::Pinched { .. } => {
            "part it there: MeshLab's \"Repair non Manifold Edges\" and \"Split Vertices Incident on Non Manifold Faces\"; or smooth the mask a little"
        }
        SurfaceFlaw::NoArea { .. } => {
            "MeshLab's \"Remove T-Vertices\" takes faces without area away, and \"Isotropic Explicit Remeshing\" too"
        }
        _ => "mend the surface there, or make it again from its mask",
    }
}

/// What was put right, in words.
fn notes(repaired: &Repaired) -> Vec<String> {
    let said = |count: usize, one: &str, many: &str| match count {
        0 => None,
        1 => Some(format!("1 {one}")),
        count => Some(format!("{count} {many}")),
    };
    let notes = [
        said(
            repaired.welded_points,
            "point lay on another and is one with it",
            "points lay on others and are one with them",
        ),
        said(
            repaired.dropped_triangles,
            "triangle dropped: two corners at one place, or there a second time",
            "triangles dropped: two corners at one place, or there a second time",
        ),
        said(
            repaired.split_edges,
            "edge split at a point on it that its triangle did not have",
            "edges split at points on them that their triangles did not have",
        ),
        said(
            repaired.filled_holes,
            "hole filled, as its rim is flat or has few edges: see that the body has none there",
            "holes filled, as their rims are flat or have few edges: see that the body has none there",
        ),
        said(
            repaired.turned_triangles,
            "triangle turned over, to look outwards",
            "triangles turned over, to look outwards",
        ),
        said(
            repaired.hollows,
            "part lies inside another: a hollow",
            "parts lie inside others: hollows",
        ),
        said(
            repaired.parts.saturating_sub(repaired.hollows + 1),
            "part more that hangs together with nothing: filled, too; crumbs of a mask go with skimage.measure.label",
            "parts more that hang together with nothing: filled, too; crumbs of a mask go with skimage.measure.label",
        ),
    ];
    notes.into_iter().flatten().collect()
}

struct Found {
    mesh: RawMesh,
    /// Cells of each body.
    bodies: Vec<Range<usize>>,
    edge_m: f64,
    runs: u32,
    /// Run that failed after this mesh was found.
    failed: Option<Hint>,
}

/// Runs gmsh with one size of cells after the other until the number of nodes is near, or a run fails; the nearest of them.
///
/// # Errors
/// No run before the one that failed; Ctrl-C.
fn search(bodies: &[TriangleMesh], args: &FillArgs) -> Result<Found, Failure> {
    let failed = |error: io::Error| {
        let help = "the folder for temporary files has to be there, and yours";
        Failure::say(Cause::Failed, format!("no place to work in: {error}"), help)
    };
    let folder = tempfile::tempdir().map_err(failed)?;
    let surfaces: Vec<_> = bodies.iter().map(stl).collect();
    let places = places(bodies);
    let volume_m3: f64 = bodies.iter().map(TriangleMesh::volume_m3).sum();
    let wanted = f64::from(args.nodes);
    // A regular tetrahedron has the volume of its edge cubed over the root of 72; a mesh has some five cells a node.
    let mut edge_m = (volume_m3 * 72f64.sqrt() / (5.0 * wanted)).cbrt();
    // Sizes known to give too many nodes, and too few.
    let (mut fine, mut coarse) = (0.0f64, f64::INFINITY);
    let mut nearest: Option<(f64, Found)> = None;
    for runs in 1..=MOST_RUNS {
        begin("gmsh fills the surface", || {
            let edge_mm = 1e3 * edge_m;
            format!("run {runs} of at most {MOST_RUNS}, edges of {edge_mm:.3} mm")
        });
        let mut mesh = RawMesh::default();
        let mut cells = Vec::new();
        let ran: Result<(), Failure> =
            surfaces
                .iter()
                .zip(&places)
                .try_for_each(|(surface, place)| {
                    std::fs::write(folder.path().join("surface.stl"), surface).map_err(failed)?;
                    let first = mesh.cells.len();
                    mesh.append(run_gmsh(folder.path(), edge_m, place)?);
                    cells.push(first..mesh.cells.len());
                    Ok(())
                });
        match (ran, &mut nearest) {
            (Ok(()), _) => {}
            (Err(failure), Some((_, found))) if failure.cause != Cause::Interrupted => {
                found.failed = Some(without(&failure, edge_m, found.edge_m));
                found.runs = runs;
                break;
            }
            (Err(failure), _) => return Err(failure),
        }
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
            let found = Found {
                mesh,
                bodies: cells,
                edge_m,
                runs,
                failed: None,
            };
            nearest = Some((off, found));
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

/// Warning of a run with edges of `edge_m` that failed, where the mesh with edges of `found_m` is written.
fn without(failure: &Failure, edge_m: f64, found_m: f64) -> Hint {
    let [message, help] = failure.in_words();
    let which = match edge_m > found_m {
        true => "coarser",
        false => "finer",
    };
    let [edge_mm, found_mm] = [edge_m, found_m].map(|m| 1e3 * m);
    Hint {
        message: format!(
            "a run with {which} cells, edges of {edge_mm:.3} mm, failed, and the nearest before it, of {found_mm:.3} mm, is written; {message}"
        ),
        help,
    }
}

/// Number, size and middle of each body, in words; empty for one that is alone.
fn places(bodies: &[TriangleMesh]) -> Vec<String> {
    let count = bodies.len();
    let place = |(index, body): (usize, &TriangleMesh)| {
        let corners = body.triangles.iter().flatten();
        let around = corners.fold(Bounds::NOTHING, |all, point| {
            all.with(&body.points_m[*point as usize].into())
        });
        let (size, middle) = (around.high - around.low, around.middle());
        format!(
            "body {} of {count} ({:.6} x {:.6} x {:.6} m, its middle at [{:.6}, {:.6}, {:.6}] m, with face {})",
            index + 1,
            size.x,
            size.y,
            size.z,
            middle.x,
            middle.y,
            middle.z,
            body.face(0)
        )
    };
    match count {
        1 => vec![String::new()],
        _ => bodies.iter().enumerate().map(place).collect(),
    }
}

/// The surface as a binary STL file in millimetres: what came as 32 bits in these goes out as it came.
fn stl(surface: &TriangleMesh) -> Vec<u8> {
    // gmsh looks for a word in it: zeros before coordinates that are round are no surface to it.
    let mut bytes = format!("{HEAD:80}").into_bytes();
    bytes.extend((surface.triangles.len() as u32).to_le_bytes());
    for corners in &surface.triangles {
        bytes.extend([0; 12]);
        let numbers = corners
            .iter()
            .flat_map(|point| surface.points_m[*point as usize]);
        bytes.extend(numbers.flat_map(|x| ((x / MM) as f32).to_le_bytes()));
        bytes.extend([0; 2]);
    }
    bytes
}

/// One mesh, in metres, of cells with edges of about this length. The surface is meshed anew: that of a segmentation has
/// steps of its voxels, and never the size that is wanted. Edges sharper than 85 degrees stay: the steps of marching cubes
/// are of 45 to 70, and as edges of patches they are more than gmsh can flatten. `place` names the body among several.
fn run_gmsh(folder: &Path, edge_m: f64, place: &str) -> Result<RawMesh, Failure> {
    let edge = edge_m / MM;
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
    let log = folder.join("gmsh.log");
    let mut command = Command::new("gmsh");
    command.args(arguments).current_dir(folder);
    let status = ended(&mut command, &log).map_err(|error| match error.kind() {
        ErrorKind::Interrupted => Failure::say(
            Cause::Interrupted,
            "stopped while gmsh filled the surface",
            "nothing is written",
        ),
        ErrorKind::NotFound => said(
            "gmsh, which fills surfaces, is not on PATH".into(),
            "install it: pip install gmsh, or apt install gmsh; then gmsh --version answers",
        ),
        _ => said(
            format!("gmsh does not start: {error}"),
            "gmsh --version has to answer",
        ),
    })?;
    let words = read_plain(&log, MOST_BYTES).unwrap_or_default();
    let words = String::from_utf8_lossy(&words);
    let has_error = words.lines().any(|line| line.contains("Error"));
    if !status.success() || has_error || !filled.is_file() {
        let (what, help) = match place.is_empty() {
            true => (
                "the surface",
                "if that names no other cause, the surface is narrower somewhere than cells of this size: smooth and simplify it, or ask for more nodes",
            ),
            false => (
                place,
                "if that names no other cause, this body is smaller, or narrower somewhere, than cells of this size, which all bodies have: ask for more nodes; \
                 leave it out if it is a crumb (MeshLab's \"Remove Isolated Pieces\", skimage.measure.label for a mask); or fill it by itself",
            ),
        };
        return Err(said(
            format!(
                "gmsh did not fill {what} with edges of {edge:.3} mm; it says: {}",
                told(&words)
            ),
            help,
        ));
    }
    let mesh = read_raw_mesh(&filled, MM).map_err(|error| {
        let help = "if that names no cause: gmsh 4.8 or later is needed; gmsh --version says which there is";
        let words = told(&words);
        let of = match place.is_empty() {
            true => String::new(),
            false => format!(" of {place}"),
        };
        said(
            format!("what gmsh wrote{of} cannot be read: {error}; it says: {words}"),
            help,
        )
    })?;
    std::fs::remove_file(&filled).ok();
    Ok(mesh)
}

/// Runs a program to its end, or to Ctrl-C, which ends it and all that it has started. Its words go to a file.
///
/// # Errors
/// It does not start; [`ErrorKind::Interrupted`].
fn ended(command: &mut Command, log: &Path) -> io::Result<ExitStatus> {
    let file = std::fs::File::create(log)?;
    command
        .stdin(Stdio::null())
        .stderr(file.try_clone()?)
        .stdout(file);
    // A group of its own: a terminal's Ctrl-C comes to this program alone.
    #[cfg(unix)]
    std::os::unix::process::CommandExt::process_group(command, 0);
    let mut child = command.spawn()?;
    loop {
        if let Some(status) = child.try_wait()? {
            return Ok(status);
        }
        if stopped() {
            end(&mut child);
            return Err(ErrorKind::Interrupted.into());
        }
        std::thread::sleep(LOOKS_EVERY);
    }
}

/// Ends a program with its group, and waits for it.
fn end(child: &mut Child) {
    // A program that has ended by itself cannot be killed.
    #[cfg(unix)]
    if let Some(group) = rustix::process::Pid::from_raw(child.id().cast_signed()) {
        let _ = rustix::process::kill_process_group(group, rustix::process::Signal::KILL);
    }
    let _ = child.kill();
    let _ = child.wait();
}

/// Errors and warnings among what gmsh printed, each once; without any, its last line.
fn told(words: &str) -> String {
    let is_flaw = |line: &&str| line.contains("Error") || line.contains("Warning");
    let mut flaws: Vec<&str> = Vec::new();
    for line in words.lines().map(str::trim).filter(is_flaw) {
        if !flaws.contains(&line) && flaws.len() < MOST_TOLD {
            flaws.push(line);
        }
    }
    let last = words.lines().rfind(|line| !line.trim().is_empty());
    match flaws.is_empty() {
        true => last.unwrap_or("nothing").trim().to_owned(),
        false => flaws.join("; "),
    }
}
