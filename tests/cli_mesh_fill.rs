//! `sutura mesh fill`: what of a surface is refused, how the number of nodes is met, and what gmsh's failures become.
//!
//! A script stands in for gmsh: it takes the size of cells out of the script that it is given, and hands back one of some
//! meshes that the test made. With `SUTURA_FULL=1` gmsh itself has to be on `PATH`.

use crate::support::described::assert_described;
use crate::support::{Ran, ran, sutura_in};
use serde_json::Value;
use std::fmt::Write;
use std::io::{BufRead as _, Read as _};
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;
use sutura_testkit::full;

type Triangle = [[f64; 3]; 3];

/// The twelve triangles of a box from `low` on, counter-clockwise from outside.
fn cuboid(low: [f64; 3], size: f64) -> Vec<Triangle> {
    let corner = |k: usize| [0, 1, 2].map(|axis| low[axis] + size * ((k >> axis) & 1) as f64);
    let sides = [
        [0, 2, 3, 1],
        [4, 5, 7, 6],
        [0, 1, 5, 4],
        [2, 6, 7, 3],
        [0, 4, 6, 2],
        [1, 3, 7, 5],
    ];
    let halves = |[a, b, c, d]: [usize; 4]| [[a, b, c], [a, c, d]].map(|t| t.map(corner));
    sides.into_iter().flat_map(halves).collect()
}

fn stl(path: &Path, triangles: &[Triangle]) {
    let mut text = String::from("solid box\n");
    for triangle in triangles {
        text.push_str("facet normal 0 0 0\nouter loop\n");
        for [x, y, z] in triangle {
            writeln!(text, "vertex {x} {y} {z}").expect("a string");
        }
        text.push_str("endloop\nendfacet\n");
    }
    text.push_str("endsolid box\n");
    std::fs::write(path, text).expect("writable");
}

/// A folder with a box of 30 mm in millimetres and a stand-in for gmsh.
fn folder(gmsh: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path();
    stl(&at.join("box.stl"), &cuboid([0.0; 3], 30.0));
    let program = at.join("bin/gmsh");
    std::fs::create_dir(at.join("bin")).expect("a folder");
    std::fs::write(&program, format!("#!/bin/sh\n{gmsh}")).expect("writable");
    let mode = std::fs::Permissions::from_mode(0o755);
    std::fs::set_permissions(&program, mode).expect("executable");
    folder
}

/// `sutura mesh fill` in the folder, with its `bin` before all else on `PATH`.
fn fill(at: &Path, arguments: &[&str]) -> Ran {
    let path = std::env::var("PATH").unwrap_or_default();
    let mut command = Command::new(env!("CARGO_BIN_EXE_sutura"));
    command
        .current_dir(at)
        .args(["mesh", "fill"])
        .args(arguments);
    ran(command.env("PATH", format!("{}:{path}", at.join("bin").display())))
}

/// What it said, without the breaks and bars of a terminal's lines.
fn unwrapped(ran: &Ran) -> String {
    let words = ran.stderr.split_whitespace();
    words
        .filter(|word| *word != "\u{2502}")
        .collect::<Vec<_>>()
        .join(" ")
}

/// Hands back `mesh-K.msh` for cells with edges of a K-th of the box, K from 1 to 9, and notes each size.
const STAND_IN: &str = r#"
h=$(sed -n 's/^h = \(.*\);/\1/p' "$1")
k=$(awk -v h="$h" 'BEGIN { k = int(30 / h + 0.5); if (k < 1) k = 1; if (k > 9) k = 9; print k }')
cp surface.stl "$(dirname "$0")/given.stl" || exit 3
echo "$h $k" >> "$(dirname "$0")/sizes"
cp "$(dirname "$0")/mesh-$k.msh" filled.msh
"#;

/// Slabs in place of what gmsh makes of the box, with K cubes along each edge.
fn stand_ins(at: &Path) {
    for k in 1..=9usize {
        let slab = sutura_host::mesh::slab([30.0; 3], [k; 3]).expect("a slab");
        let raw = sutura_host::mesh::RawMesh::new(
            slab.points_m().to_vec(),
            slab.cells().to_vec(),
            Vec::new(),
        );
        let path = at.join(format!("bin/mesh-{k}.msh"));
        let format = sutura_host::output::MeshFormat::of(&path).expect("a format");
        sutura_host::output::write_mesh(&raw, &path, format).expect("written");
    }
}

/// Turned over in places, with triangles twice and a box inside: gmsh is given one that is closed, and all is said.
#[test]
fn what_is_put_right_is_said() {
    let folder = folder(STAND_IN);
    let at = folder.path();
    stand_ins(at);
    let mut triangles = cuboid([0.0; 3], 30.0);
    triangles[3].swap(0, 1);
    triangles.push(triangles[5]);
    triangles.remove(8);
    triangles.extend(cuboid([10.0; 3], 5.0));
    stl(&at.join("bad.stl"), &triangles);
    let arguments = [
        "bad.stl", "--nodes", "343", "--out", "a.msh", "--scale", "0.001",
    ];
    let ran = fill(at, &[&arguments[..], &["--format", "json"]].concat());
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let report = ran.json();
    assert_described("mesh-fill", &report);
    let expected = serde_json::json!({
        "welded_points": 0, "dropped_triangles": 1, "split_edges": 0, "filled_holes": 1, "turned_triangles": 13, "parts": 2,
        "hollows": 1,
    });
    assert_eq!(report["repaired"], expected);
    let notes = report["notes"].to_string();
    for words in [
        "1 triangle dropped",
        "1 hole filled",
        "13 triangles turned over",
        "1 part lies inside another",
    ] {
        assert!(notes.contains(words), "{words}: {notes}");
    }
    // What it is given is closed, looks outwards, and has the box's volume less the hollow's.
    let bytes = std::fs::read(at.join("bin/given.stl")).expect("kept");
    let given = sutura_host::mesh::SurfaceFormat::Stl
        .read(&bytes, 1.0)
        .expect("an STL");
    assert!(given.check().is_ok());
    // gmsh 4.15 does not read zeros before round coordinates.
    assert!(bytes[..80].iter().all(|byte| (b' '..=b'~').contains(byte)));
    assert!(!bytes.starts_with(b"solid"));
    assert!((given.volume_m3() - (27000.0 - 125.0)).abs() < 1e-3);
    // An OBJ of the same box in metres, of its sides.
    let mut text = String::new();
    for k in 0..8 {
        let [x, y, z] = [0, 1, 2].map(|axis| 0.03 * f64::from(k >> axis & 1));
        writeln!(text, "v {x} {y} {z}").expect("a string");
    }
    text.push_str("f 1 3 4 2\nf 5 6 8 7\nf 1 2 6 5\nf 3 7 8 4\nf 1 5 7 3\nf 2 4 8 6\n");
    std::fs::write(at.join("box.obj"), text).expect("writable");
    let ran = fill(
        at,
        &[
            "box.obj", "--nodes", "343", "--out", "b.msh", "--format", "json",
        ],
    );
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let report = ran.json();
    assert_eq!(
        (&report["triangles"], &report["nodes"]),
        (&12.into(), &343.into())
    );
    // A mesh is never written over the surface, whatever it is called.
    let same = at.join("same.msh");
    std::os::unix::fs::symlink(at.join("box.obj"), &same).expect("a link");
    let ran = fill(
        at,
        &[
            "box.obj",
            "--nodes",
            "343",
            "--out",
            "same.msh",
            "--overwrite",
        ],
    );
    assert!(
        ran.code == 2 && unwrapped(&ran).contains("written over itself"),
        "{}",
        ran.stderr
    );
}

#[test]
fn sizes_are_tried_until_the_nodes_are_near() {
    let folder = folder(STAND_IN);
    let at = folder.path();
    stand_ins(at);
    // 6 cubes along each edge have 7^3 nodes.
    let arguments = [
        "box.stl", "--nodes", "350", "--out", "box.msh", "--scale", "0.001",
    ];
    let result = fill(at, &[&arguments[..], &["--format", "json"]].concat());
    assert_eq!(result.code, 0, "{}", result.stderr);
    let report = result.json();
    assert_eq!(
        (&report["nodes"], &report["triangles"]),
        (&343.into(), &12.into())
    );
    assert_eq!(
        (&report["wanted_nodes"], &report["usable"]),
        (&350.into(), &true.into())
    );
    assert_eq!(
        report["size_m"][0].as_f64().map(|x| (1e6 * x).round()),
        Some(3e4)
    );
    assert!(report["step_us"].as_f64() > Some(0.0), "{report}");
    let sizes = std::fs::read_to_string(at.join("bin/sizes")).expect("it ran");
    assert_eq!(report["runs"].as_u64(), Some(sizes.lines().count() as u64));
    let info = sutura_in(at, &["mesh", "info", "box.msh", "--format", "json"]).json();
    assert_eq!(
        (&info["nodes"], &info["size_m"]),
        (&report["nodes"], &report["size_m"])
    );
    // Between 8 and 27 nodes there are none: the nearest, and a word about it.
    let far = fill(
        at,
        &[
            "box.stl", "--nodes", "20", "--out", "few.msh", "--scale", "0.001",
        ],
    );
    assert_eq!(far.code, 0, "{}", far.stderr);
    assert!(
        far.stderr
            .contains("20 nodes were asked for, 27 is as near"),
        "{}",
        far.stderr
    );
}

#[test]
fn surfaces_that_cannot_be_filled_are_refused_by_their_triangles() {
    let folder = folder("echo gmsh ran; exit 1");
    let at = folder.path();
    let whole = cuboid([0.0; 3], 30.0);
    // Two holes that meet in a corner.
    let open = [&whole[1..10], &whole[11..]].concat();
    stl(&at.join("open.stl"), &open);
    // A second box, whose corner is inside the first.
    let both = [whole.clone(), cuboid([20.0, 19.0, 18.0], 30.0)].concat();
    stl(&at.join("crossing.stl"), &both);
    // A third triangle at an edge of the first.
    let mut fin = whole[0];
    fin[2] = [50.0, 50.0, 50.0];
    stl(&at.join("fin.stl"), &[whole.clone(), vec![fin]].concat());
    std::fs::write(at.join("part.off"), "OFF\n").expect("writable");
    std::fs::write(at.join("words.stl"), "no surface\n").expect("writable");
    std::fs::write(at.join("cut.ply"), "ply\nformat ascii 1.0\n").expect("writable");
    std::fs::write(at.join("far.obj"), "v 0 0 0\nf 1 2 3\n").expect("writable");
    for (file, said) in [
        (
            "open.stl",
            ["the surface is open: face 0 has", "Close Holes"],
        ),
        ("crossing.stl", ["faces 2 and 17 cross each other", "Union"]),
        (
            "fin.stl",
            ["faces [0, 9, 12] meet in one edge", "Repair non Manifold"],
        ),
        ("part.off", ["part.off is no surface", "meshio convert"]),
        (
            "words.stl",
            ["words.stl: line 1", "mend the file at that place"],
        ),
        ("cut.ply", ["cut.ply: line 3", "is it cut off?"]),
        (
            "far.obj",
            ["far.obj: line 2", "one of the 1 vertices so far"],
        ),
        ("none.stl", ["cannot read none.stl", "No such file"]),
    ] {
        let ran = fill(
            at,
            &[file, "--nodes", "300", "--out", "a.msh", "--scale", "0.001"],
        );
        assert_eq!(ran.code, 2, "{file}: {}", ran.stderr);
        let text = unwrapped(&ran);
        for words in said {
            assert!(text.contains(words), "{file}: no {words} in {text}");
        }
        assert!(!text.contains("gmsh ran") && !at.join("a.msh").exists());
    }
    // Side by side they do not cross.
    let apart = [whole, cuboid([40.0, 0.0, 0.0], 30.0)].concat();
    stl(&at.join("apart.stl"), &apart);
    let ran = fill(at, &["apart.stl", "--nodes", "300", "--out", "a.msh"]);
    assert!(
        ran.code == 1 && ran.stderr.contains("gmsh ran"),
        "{}",
        ran.stderr
    );
}

/// A surface of two bodies is filled body by body, a hollow with the body that has it.
#[test]
fn bodies_that_lie_apart_are_filled_one_by_one() {
    let folder = folder(STAND_IN);
    let at = folder.path();
    stand_ins(at);
    let bodies = [cuboid([0.0; 3], 30.0), cuboid([50.0, 0.0, 0.0], 30.0)];
    let hollow = cuboid([60.0, 10.0, 10.0], 5.0);
    stl(
        &at.join("two.stl"),
        &[&bodies.concat()[..], &hollow].concat(),
    );
    let arguments = [
        "two.stl", "--nodes", "686", "--out", "a.msh", "--scale", "0.001",
    ];
    let ran = fill(at, &[&arguments[..], &["--format", "json"]].concat());
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let report = ran.json();
    assert_eq!(report["nodes"], 686, "{report}");
    let sizes = std::fs::read_to_string(at.join("bin/sizes")).expect("it ran");
    let runs = report["runs"].as_u64().expect("a number");
    assert_eq!(2 * runs, sizes.lines().count() as u64);
    // The last one that it was given.
    let bytes = std::fs::read(at.join("bin/given.stl")).expect("kept");
    let given = sutura_host::mesh::SurfaceFormat::Stl.read(&bytes, 1.0);
    let volume = given.expect("an STL").volume_m3();
    assert!((volume - (27000.0 - 125.0)).abs() < 1e-3, "{volume}");
    let crumbs: Vec<_> = (0..21)
        .map(|k| cuboid([10.0 * f64::from(k), 0.0, 0.0], 1.0))
        .collect();
    stl(&at.join("crumbs.stl"), &crumbs.concat());
    let ran = fill(at, &["crumbs.stl", "--nodes", "100", "--out", "b.msh"]);
    assert_eq!(ran.code, 2, "{}", ran.stderr);
    assert!(unwrapped(&ran).contains("21 bodies"), "{}", ran.stderr);
}

/// Two boxes of 30 mm in place of what gmsh makes of two bodies, one after the other: the second is so far above the first \[mm\].
fn stacked(at: &Path, up: f64) {
    for (name, by) in [("1", [0.0; 3]), ("0", [3.0, 2.0, up])] {
        let slab = sutura_host::mesh::slab([30.0; 3], [6; 3]).expect("a slab");
        let points = slab.points_m().iter();
        let points = points.map(|x| [0, 1, 2].map(|axis| x[axis] + by[axis]));
        let regions = vec![1; slab.cells().len()];
        let mut raw =
            sutura_host::mesh::RawMesh::new(points.collect(), slab.cells().to_vec(), regions);
        raw.region_names.insert(1, "tissue".into());
        let path = at.join(format!("bin/body-{name}.msh"));
        let format = sutura_host::output::MeshFormat::of(&path).expect("a format");
        sutura_host::output::write_mesh(&raw, &path, format).expect("written");
    }
}

/// Bodies are meshed one by one: where what comes of them lies in each other it is said, and scenes in which they may touch refuse
/// what they do not bear, named as two parts or as one.
#[test]
fn bodies_that_lie_in_each_other_are_warned_of() {
    let folder = folder(
        r#"
bin="$(dirname "$0")"
echo ran >> "$bin/runs"
cp "$bin/body-$(($(wc -l < "$bin/runs") % 2)).msh" filled.msh
"#,
    );
    let at = folder.path();
    let apart = [cuboid([0.0; 3], 30.0), cuboid([50.0, 0.0, 0.0], 30.0)];
    stl(&at.join("two.stl"), &apart.concat());
    let scene = "[mesh]\nfile = \"a.msh\"\nscale_to_m = 1.0\n[tissue]\nmodel = \"linear\"\nyoungs_modulus_pa = 20e3\npoisson_ratio = 0.45\n\
                 [[fixed]]\nplane = { axis = \"z\", at_m = -0.03 }\n[[fixed]]\nplane = { axis = \"x\", at_m = -0.012 }\n\
                 [[tissue_contact]]\nbetween = [\"tissue\", \"tissue\"]\n";
    std::fs::write(at.join("scene.toml"), scene).expect("writable");
    for (up, said, checked) in [
        (28.0, Some(["0.35 mean edges (2.000 mm)", "refuse that"]), 2),
        (
            29.0,
            Some(["0.18 mean edges (1.000 mm)", "not kept apart"]),
            0,
        ),
        (30.0, None, 0),
        (31.0, None, 0),
    ] {
        stacked(at, up);
        let arguments = [
            "two.stl",
            "--nodes",
            "686",
            "--out",
            "a.msh",
            "--scale",
            "0.001",
            "--overwrite",
        ];
        let ran = fill(at, &[&arguments[..], &["--format", "json"]].concat());
        assert_eq!(ran.code, 0, "{}", ran.stderr);
        let report = ran.json();
        assert_described("mesh-fill", &report);
        let warnings = report["warnings"].as_array().expect("a list");
        assert_eq!(warnings.len(), usize::from(said.is_some()), "{report}");
        if let Some([depth, scenes]) = said {
            let words = format!("bodies 1 and 2 lie in each other by up to {depth}, at about [");
            let message = warnings[0]["message"].as_str().expect("text");
            assert!(message.starts_with(&words), "{message}");
            assert!(
                message.ends_with(": 72 nodes of either lie in the other"),
                "{message}"
            );
            let help = warnings[0]["help"].as_str().expect("text");
            assert!(
                help.contains("more --nodes") && help.contains(scenes),
                "{help}"
            );
            assert!(ran.stderr.contains(&words), "{}", ran.stderr);
        }
        let check = sutura_in(at, &["scene", "check", "scene.toml"]);
        assert_eq!(check.code, checked, "{up}: {}", check.stderr);
        assert_eq!(
            check.stderr.contains("deep in each other"),
            checked == 2,
            "{up}: {}",
            check.stderr
        );
    }
}

/// A later run that fails takes nothing from an earlier one.
#[test]
fn a_run_that_fails_leaves_the_nearest_before_it() {
    let once = r#"[ -e "$(dirname "$0")/sizes" ] && { echo 'Error   : PLC Error'; exit 1; }"#;
    for (wanted, nodes, which) in [("20", 27, "coarser"), ("900", 729, "finer")] {
        let folder = folder(&format!("{once}{STAND_IN}"));
        let at = folder.path();
        stand_ins(at);
        let arguments = [
            "box.stl", "--nodes", wanted, "--out", "a.msh", "--scale", "0.001",
        ];
        let ran = fill(at, &[&arguments[..], &["--format", "json"]].concat());
        assert_eq!(ran.code, 0, "{}", ran.stderr);
        let report = ran.json();
        assert_eq!(
            (&report["nodes"], &report["runs"]),
            (&nodes.into(), &2.into()),
            "{report}"
        );
        let message = report["warnings"][0]["message"].as_str().expect("text");
        assert!(
            message.starts_with(&format!("a run with {which} cells, edges of ")),
            "{message}"
        );
        assert!(
            message.ends_with("it says: Error   : PLC Error"),
            "{message}"
        );
        assert!(ran.stderr.contains("PLC Error"), "{}", ran.stderr);
        let info = sutura_in(at, &["mesh", "info", "a.msh", "--format", "json"]).json();
        assert_eq!(info["nodes"], nodes);
    }
}

/// Of several bodies the one that gmsh does not fill is named by its number, its size and its place.
#[test]
fn the_body_that_is_not_filled_is_named() {
    let folder = folder(&format!(
        r#"[ -e "$(dirname "$0")/sizes" ] && {{ echo 'Error   : overlapping facets'; exit 1; }}{STAND_IN}"#
    ));
    let at = folder.path();
    stand_ins(at);
    let bodies = [cuboid([0.0; 3], 30.0), cuboid([100.0, 0.0, 0.0], 2.0)];
    stl(&at.join("crumb.stl"), &bodies.concat());
    let arguments = [
        "crumb.stl",
        "--nodes",
        "343",
        "--out",
        "a.msh",
        "--scale",
        "0.001",
    ];
    let ran = fill(at, &arguments);
    assert_eq!(ran.code, 1, "{}", ran.stderr);
    let text = unwrapped(&ran);
    for words in [
        "body 2 of 2 (0.002000 x 0.002000 x 0.002000 m, its middle at [0.101000, 0.001000, 0.001000] m, with face 12)",
        "it says: Error : overlapping facets",
        "ask for more nodes",
        "Remove Isolated Pieces",
    ] {
        assert!(text.contains(words), "no {words} in {text}");
    }
    assert!(!at.join("a.msh").exists());
}

#[test]
fn failures_of_gmsh_are_told_with_its_words() {
    let failing = folder(
        "echo 'Warning : Facets cross'; echo 'Info : at work'; echo 'Error   : Could not recover boundary' >&2; exit 0",
    );
    let arguments = ["box.stl", "--nodes", "300", "--out", "a.msh"];
    let ran = fill(failing.path(), &arguments);
    assert_eq!(ran.code, 1, "{}", ran.stderr);
    let said = "it says: Warning : Facets cross; Error   : Could not recover boundary";
    assert!(ran.stderr.contains(said), "{}", ran.stderr);
    let garbled = folder("echo nonsense > filled.msh; echo 'Warning : No tetrahedra in region 1'");
    let ran = fill(garbled.path(), &arguments);
    assert_eq!(ran.code, 1, "{}", ran.stderr);
    let said = "it says: Warning : No tetrahedra in region 1";
    assert!(unwrapped(&ran).contains(said), "{}", ran.stderr);
    assert!(ran.stderr.contains("$MeshFormat"), "{}", ran.stderr);
    // Nothing of that name on `PATH`.
    let none = failing.path().join("nowhere");
    let mut command = Command::new(env!("CARGO_BIN_EXE_sutura"));
    command
        .current_dir(failing.path())
        .args(["mesh", "fill"])
        .args(arguments);
    let ran = crate::support::ran(command.env("PATH", none));
    assert_eq!(ran.code, 1, "{}", ran.stderr);
    assert!(ran.stderr.contains("pip install gmsh"), "{}", ran.stderr);
}

/// Returns what is found at last; fails after a minute without it.
fn sooner_or_later<T>(what: &str, mut found: impl FnMut() -> Option<T>) -> T {
    for _ in 0..6000 {
        if let Some(found) = found() {
            return found;
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    panic!("not within a minute: {what}");
}

/// A gmsh that takes long is told of, and Ctrl-C ends it and what it has started, with nothing left.
#[test]
fn a_gmsh_that_does_not_end_is_told_of_and_stopped() {
    let folder = folder("sleep 1000 & echo $! > \"$(dirname \"$0\")/id\"\necho at work\nwait\n");
    let at = folder.path();
    let path = std::env::var("PATH").unwrap_or_default();
    let mut command = Command::new(env!("CARGO_BIN_EXE_sutura"));
    let arguments = [
        "mesh", "fill", "box.stl", "--nodes", "300", "--out", "a.msh", "--format", "json",
    ];
    command
        .args(arguments)
        .current_dir(at)
        .env("TMPDIR", at.join("bin"));
    command.env("PATH", format!("{}:{path}", at.join("bin").display()));
    command.stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = command.spawn().expect("it starts");
    let mut said = std::io::BufReader::new(child.stderr.take().expect("a pipe"));
    let mut line = String::new();
    said.read_line(&mut line).expect("text");
    assert!(
        line.starts_with("gmsh fills the surface: run 1 of at most 8, edges of "),
        "{line}"
    );
    // The line comes before the program starts, and its number is written after that.
    let id = sooner_or_later("gmsh ran", || {
        let id = std::fs::read_to_string(at.join("bin/id")).ok()?;
        id.ends_with('\n').then(|| id.trim().to_owned())
    });
    let told = Command::new("kill")
        .args(["-INT", &child.id().to_string()])
        .status();
    assert!(told.is_ok_and(|told| told.success()));
    said.read_to_string(&mut line).expect("text");
    let output = child.wait_with_output().expect("it ends");
    assert_eq!(output.status.code(), Some(130), "{line}");
    assert!(
        line.contains("stopped while gmsh filled the surface") && !line.contains("done after"),
        "{line}"
    );
    let object: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!(object["status"], "interrupted");
    // Once it is gone nobody has its number, or a process that waits to be collected.
    sooner_or_later("what gmsh started is gone", || {
        let state = std::fs::read_to_string(format!("/proc/{id}/stat")).unwrap_or_default();
        (state.is_empty() || state.contains(") Z ")).then_some(())
    });
    let left: Vec<_> = std::fs::read_dir(at.join("bin"))
        .expect("there")
        .flatten()
        .collect();
    assert_eq!(left.len(), 2, "{left:?}");
    assert!(!at.join("a.msh").exists());
}

/// The real program on a box with round coordinates, and on the ring of 256 triangles.
#[test]
fn gmsh_fills_a_box_and_a_ring() {
    if !full() {
        return;
    }
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path();
    stl(&at.join("box.stl"), &cuboid([0.0; 3], 20.0));
    let arguments = [
        "mesh", "fill", "box.stl", "--nodes", "100", "--out", "box.msh",
    ];
    let ran = sutura_in(
        at,
        &[&arguments[..], &["--scale", "0.001", "--format", "json"]].concat(),
    );
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let volume = ran.json()["volume_m3"].as_f64().expect("a number");
    assert!((volume / 8e-6 - 1.0).abs() < 1e-6, "{volume}");
    let ring = crate::support::root().join("tests/data/ring.stl");
    std::fs::copy(ring, at.join("ring.stl")).expect("a copy");
    let arguments = [
        "mesh", "fill", "ring.stl", "--nodes", "1000", "--out", "ring.msh",
    ];
    let more = ["--scale", "0.001", "--format", "json"];
    let ran = sutura_in(at, &[&arguments[..], &more[..]].concat());
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let report: Value = ran.json();
    assert_described("mesh-fill", &report);
    let nodes = report["nodes"].as_f64().expect("a number");
    assert!((nodes / 1000.0 - 1.0).abs() <= 0.1, "{nodes}");
    assert_eq!(report["usable"], true, "{report}");
    assert_eq!(report["regions"][0]["name"], "tissue");
    let apart = [cuboid([0.0; 3], 20.0), cuboid([50.0, 0.0, 0.0], 10.0)];
    stl(&at.join("two.stl"), &apart.concat());
    let arguments = [
        "mesh", "fill", "two.stl", "--nodes", "300", "--out", "two.msh",
    ];
    let ran = sutura_in(at, &[&arguments[..], &more[..]].concat());
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let volume = ran.json()["volume_m3"].as_f64().expect("a number");
    assert!((volume / 9e-6 - 1.0).abs() < 1e-6, "{volume}");
}

/// Whether a program can be started.
fn is_there(program: &str) -> bool {
    let ran = Command::new(program).arg("--version").output();
    ran.is_ok_and(|ran| ran.status.success())
}

/// The book's way from a drawn label volume to a scene, command by command. The surface is kept beside the script: where gmsh is
/// there the rest is done with it. With `SUTURA_FULL=1` numpy, scikit-image and gmsh have to be there, and the surface is that of the script.
#[test]
fn a_label_volume_becomes_a_scene_in_three_commands() {
    let book = crate::support::root().join("docs/src/mesh");
    let kept = std::fs::read(book.join("lobe.ply")).expect("kept");
    let mut surface = sutura_host::mesh::SurfaceFormat::Ply
        .read(&kept, 0.001)
        .expect("a surface");
    let sound = surface.repair().expect("closed");
    assert_eq!((sound.turned_triangles, sound.parts), (0, 1), "{sound:?}");
    assert_eq!(sutura_host::tool::crossing(&surface), None);
    if !full() && !is_there("gmsh") {
        return;
    }
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path();
    for name in ["lobe.ply", "lobe.toml", "surface.py"] {
        std::fs::copy(book.join(name), at.join(name)).expect("a copy");
    }
    if full() {
        std::fs::remove_file(at.join("lobe.ply")).expect("there");
        let ran = ran(Command::new("python").arg("surface.py").current_dir(at));
        assert_eq!(ran.code, 0, "{}", ran.stderr);
        // Other releases of scikit-image may count its points in another order.
        let made = std::fs::read(at.join("lobe.ply")).expect("written");
        let made = sutura_host::mesh::SurfaceFormat::Ply.read(&made, 0.001);
        let mut made = made.expect("a surface");
        assert_eq!(made.repair(), Ok(sound));
        let ratio = made.volume_m3() / surface.volume_m3();
        assert!(
            (ratio - 1.0).abs() < 1e-3,
            "the kept surface is another one: {ratio}"
        );
    }
    let page = std::fs::read_to_string(book.join("../mesh.md")).expect("readable");
    for words in [
        "mesh fill lobe.ply --nodes 1000 --out lobe.msh --scale 0.001",
        "run lobe.toml",
    ] {
        assert!(
            page.contains(&format!("sutura {words}\n")),
            "the book does not say {words}"
        );
    }
    let arguments = [
        "lobe.ply", "--nodes", "1000", "--out", "lobe.msh", "--scale", "0.001", "--format", "json",
    ];
    let ran = sutura_in(at, &[&["mesh", "fill"], &arguments[..]].concat());
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let report: Value = ran.json();
    assert_described("mesh-fill", &report);
    let nodes = report["nodes"].as_f64().expect("a number");
    assert!((nodes / 1000.0 - 1.0).abs() <= 0.1, "{nodes}");
    assert_eq!(report["usable"], true, "{report}");
    // gmsh cuts the steps of the voxels' corners, and keeps what is inside.
    let volume = report["volume_m3"].as_f64().expect("a number");
    assert!(
        (volume / surface.volume_m3() - 1.0).abs() < 0.05,
        "{volume}"
    );
    let checked = sutura_in(at, &["scene", "check", "lobe.toml", "--format", "json"]);
    assert_eq!(checked.code, 0, "{}", checked.stderr);
    assert_eq!(checked.json()["warnings"], serde_json::json!([]));
    let ran = sutura_in(at, &["run", "lobe.toml", "--lockstep", "--format", "json"]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let peak = ran.json()["force_n"]["peak"].as_f64().expect("a number");
    assert!((0.1..10.0).contains(&peak), "{peak}");
}
