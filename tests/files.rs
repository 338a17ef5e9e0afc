//! Files that commands write: what is there is kept, folders are made before the work, and a full disk takes no result.

use crate::support::{ran, root, sutura_in};
use std::path::Path;
use sutura_host::mesh::RawMesh;
use sutura_host::output::{MeshFormat, write_mesh};

const SESSION: [&str; 6] = ["run", "--lockstep", "--seconds", "0.1", "--format", "json"];

/// A link of the user's is kept by a console that would put its own in that place, wherever it leads.
#[cfg(unix)]
#[test]
fn a_console_replaces_no_link_but_to_a_terminal_that_is_gone() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path();
    std::fs::write(at.join("mine.txt"), "mine").expect("writable");
    let running = sutura_hil::Pty::open().expect("a pseudo-terminal");
    for target in ["mine.txt", ".", "/dev/null", "nowhere", running.path()] {
        let link = at.join("port");
        std::os::unix::fs::symlink(target, &link).expect("a link");
        let ran = sutura_in(at, &["console", "--link", "port"]);
        assert_eq!(ran.code, 2, "{target}: {}", ran.stderr);
        assert!(
            ran.stderr.contains("cannot make the link port"),
            "{}",
            ran.stderr
        );
        assert_eq!(std::fs::read_link(&link).expect("there"), Path::new(target));
        std::fs::remove_file(&link).expect("there");
    }
}

/// A link of a console that was killed is replaced, whichever terminal that had, and what has come in the link's place is kept.
#[cfg(unix)]
#[test]
fn a_console_removes_nothing_but_its_own_link() {
    use sutura_hil::{Pty, PtyLink};
    let folder = tempfile::tempdir().expect("a folder");
    let link = folder.path().join("port");
    let pty = Pty::open().expect("a pseudo-terminal");
    for left in ["/dev/pts/1048575", pty.path()] {
        std::os::unix::fs::symlink(left, &link).expect("a link");
        let made = PtyLink::make(&link, pty.path()).expect("a link");
        let target = std::fs::read_link(&link).expect("there");
        assert_eq!(target, Path::new(pty.path()));
        drop(made);
        assert!(std::fs::symlink_metadata(&link).is_err());
    }
    let made = PtyLink::make(&link, pty.path()).expect("a link");
    std::fs::remove_file(&link).expect("there");
    std::fs::write(&link, "mine").expect("writable");
    drop(made);
    assert_eq!(std::fs::read_to_string(&link).expect("kept"), "mine");
}

#[test]
fn what_is_there_is_kept_unless_asked() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path();
    let mesh = root().join("tests/data/cube_350.msh").display().to_string();
    let scene = root().join("scenes/cube-handle.toml").display().to_string();
    for (file, line) in [
        ("a.json", &["solve", &scene, "--out", "a.json"][..]),
        ("a.vtk", &["mesh", "convert", &mesh, "--out", "a.vtk"]),
        ("a.mcap", &[&SESSION[..], &["--record", "a.mcap"]].concat()),
        (
            "last.mcap",
            &[&SESSION[..], &["--save-last", "last.mcap"]].concat(),
        ),
        (
            "self.txt",
            &["device", "selftest", "/dev/none", "--out", "self.txt"],
        ),
        ("a.png", &["view", &scene, "--shot", "a.png"]),
    ] {
        std::fs::write(at.join(file), "mine").expect("writable");
        let ran = sutura_in(at, line);
        assert_eq!(ran.code, 2, "{line:?}: {}", ran.stderr);
        for words in [&format!("{file} is there already")[..], "--overwrite"] {
            assert!(ran.stderr.contains(words), "{line:?}: {}", ran.stderr);
        }
        let kept = std::fs::read_to_string(at.join(file)).expect("there");
        assert_eq!(kept, "mine", "{line:?}");
    }
    let ran = sutura_in(at, &["solve", &scene, "--out", "a.json", "--overwrite"]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let written = std::fs::read_to_string(at.join("a.json")).expect("there");
    assert!(written.contains("displacement_m"));
}

/// A file in a folder that is not there is refused before any work, whenever it would be written; so is a link that leads nowhere, which
/// would be replaced.
#[cfg(unix)]
#[test]
fn a_file_that_cannot_be_made_is_refused_before_the_work() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path();
    let scene = root().join("scenes/cube-handle.toml").display().to_string();
    for (line, ending) in [
        (&["solve", &scene, "--out"][..], "json"),
        (&["view", &scene, "--shot"], "png"),
        (&[&SESSION[..], &["--record"]].concat(), "mcap"),
        (&[&SESSION[..], &["--save-last"]].concat(), "mcap"),
    ] {
        let link = format!("dangling.{ending}");
        let _ = std::os::unix::fs::symlink("nowhere", at.join(&link));
        let missing = format!("none/a.{ending}");
        for (to, words) in [
            (&missing, format!("cannot write {missing}")),
            (&link, format!("{link} is there already")),
        ] {
            let line = [line, &[to]].concat();
            let ran = sutura_in(at, &line);
            assert_eq!(ran.code, 2, "{line:?}: {}", ran.stderr);
            assert!(ran.stderr.contains(&words), "{line:?}: {}", ran.stderr);
        }
        assert!(at.join(&link).is_symlink());
    }
}

/// Hours of work are not begun for a folder that could not be written, or that has something in it.
#[test]
fn a_folder_is_made_before_the_work() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path();
    std::fs::write(at.join("file"), "mine").expect("writable");
    std::fs::create_dir(at.join("full")).expect("made");
    std::fs::write(at.join("full/mine"), "mine").expect("writable");
    for command in ["fidelity", "tradeoff", "stability"] {
        // Words that no case has: that is said later, with the folder made.
        let plot = |to: &str| {
            sutura_in(
                at,
                &[command, "--only", "nothing-of-this-name", "--plot", to],
            )
        };
        for (to, said) in [
            ("file", "--plot file: "),
            ("full", "--plot full: the folder is not empty"),
        ] {
            let ran = plot(to);
            assert_eq!(ran.code, 2, "{command}: {}", ran.stderr);
            assert!(ran.stderr.contains(said), "{command}: {}", ran.stderr);
        }
        let new = format!("{command}/new");
        let ran = plot(&new);
        assert!(
            ran.stderr.contains("nothing-of-this-name"),
            "{command}: {}",
            ran.stderr
        );
        assert!(at.join(new).is_dir(), "{command}");
    }
}

/// A disk that is full from the beginning is told before a session begins; one that fills on the way takes the recording, and not
/// what the session came to. A file that may not grow stands in for it.
#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_takes_no_summary() {
    let folder = tempfile::tempdir().expect("a folder");
    let full = sutura_in(
        folder.path(),
        &[&SESSION[..], &["--record", "/dev/full"]].concat(),
    );
    assert_eq!(full.code, 1, "{}", full.stderr);
    assert!(
        full.stderr.contains("No space left on device"),
        "{}",
        full.stderr
    );
    let line = format!(
        "trap '' XFSZ; ulimit -f 64; exec {} run --lockstep --seconds 1 --format json --record a.mcap",
        env!("CARGO_BIN_EXE_sutura")
    );
    let mut shell = std::process::Command::new("sh");
    let grown = ran(shell.args(["-c", &line]).current_dir(folder.path()));
    assert_eq!(grown.code, 1, "{}", grown.stderr);
    assert!(
        grown.stderr.contains("cannot write the recording a.mcap"),
        "{}",
        grown.stderr
    );
    let summary = grown.json();
    assert_eq!(summary["ticks"], 1000, "{}", grown.stdout);
    assert_eq!(summary["status"], "failed", "{}", grown.stdout);
}

/// A full disk is no bad input, whoever writes; a missing folder is.
#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_is_a_failure_of_every_writer() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path();
    for name in ["full.json", "full.vtu", "full.vtk", "full.msh"] {
        std::os::unix::fs::symlink("/dev/full", at.join(name)).expect("a link");
    }
    let scene = small(at, "scene.toml", "a");
    let mesh = root().join("tests/data/cube_350.msh").display().to_string();
    for line in [
        ["solve", &scene, "--out", "full.json"],
        ["solve", &scene, "--out", "full.vtu"],
        ["mesh convert", &mesh, "--out", "full.vtk"],
        ["mesh convert", &mesh, "--out", "full.msh"],
    ] {
        let words = line.iter().flat_map(|words| words.split(' '));
        let words: Vec<&str> = words.chain(["--format", "json"]).collect();
        let full = sutura_in(at, &words);
        assert_eq!(full.code, 1, "{words:?}: {}", full.stderr);
        assert_eq!(full.json()["status"], "failed", "{words:?}");
        for said in [line[3], "No space left on device"] {
            assert!(full.stderr.contains(said), "{words:?}: {}", full.stderr);
        }
        let none = words.iter().map(|word| word.replace("full", "none/full"));
        let none: Vec<String> = none.collect();
        let none: Vec<&str> = none.iter().map(String::as_str).collect();
        assert_eq!(sutura_in(at, &none).code, 2, "{none:?}");
    }
}

/// A sphere over a slab of few cells: name, device, mesh and tool are put in.
fn scene(name: &str, device: &str, mesh: &str, tool: &str) -> String {
    format!(
        "name = \"{name}\"\ndevice = \"{device}\"\n[mesh{mesh}\n\
        [tissue]\nmodel = \"linear\"\nyoungs_modulus_pa = 15e3\npoisson_ratio = 0.45\n\
        [[fixed]]\nplane = {{ axis = \"z\", at_m = -0.03 }}\n\
        [[tool]]\n{tool}\nposition_m = [0.0, 0.0, 0.012]\n\
        [hand]\nstiffness_n_per_m = 1000.0\ndamping_n_s_per_m = 10.0\n\
        [[hand.way_point]]\ntime_s = 0.0\nposition_m = [0.0, 0.0, 0.03]\n"
    )
}

/// Such a scene in a file of this name, which says the other.
fn small(at: &Path, file: &str, name: &str) -> String {
    let slab = ".slab]\nsize_m = [0.08, 0.08, 0.03]\ndivisions = [8, 8, 3]";
    let text = scene(name, "cartesian-bench", slab, "radius_m = 0.014");
    std::fs::write(at.join(file), text).expect("writable");
    file.to_owned()
}

/// Such a scene with its mesh, its device and its tool in files of their own.
fn of_files(at: &Path) -> [&'static str; 4] {
    let mesh = "]\nfile = \"mesh.vtu\"\nscale_to_m = 1.0";
    let tool = "shape = \"mesh\"\nmesh = \"tool.stl\"\nscale_to_m = 0.001";
    let text = scene("of files", "device.toml", mesh, tool);
    std::fs::write(at.join("scene.toml"), text).expect("writable");
    let copy = |from: &str, to: &str| {
        std::fs::copy(root().join(from), at.join(to)).expect("a copy");
    };
    copy("devices/cartesian-bench.toml", "device.toml");
    copy("tests/data/ring.stl", "tool.stl");
    let slab = sutura_host::mesh::slab([0.08, 0.08, 0.03], [6, 6, 3]).expect("a slab");
    let raw = RawMesh::new(slab.points_m().to_vec(), slab.cells().to_vec(), Vec::new());
    write_mesh(&raw, &at.join("mesh.vtu"), MeshFormat::Vtu).expect("written");
    ["scene.toml", "mesh.vtu", "device.toml", "tool.stl"]
}

/// Whatever it is called there, and whatever `--overwrite` allows.
#[cfg(unix)]
#[test]
fn nothing_that_is_read_is_written_over() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path();
    let read = of_files(at);
    for file in read {
        let place = at.join(file);
        let (stem, end) = file.split_once('.').expect("an extension");
        std::os::unix::fs::symlink(file, at.join(format!("{stem}-link.{end}"))).expect("a link");
        std::fs::hard_link(&place, at.join(format!("{stem}-hard.{end}"))).expect("a link");
    }
    let good = sutura_in(at, &["scene", "check", "scene.toml"]);
    assert_eq!(good.code, 0, "{}", good.stderr);
    let before = read.map(|file| std::fs::read(at.join(file)).expect("there"));
    let session = |option: &'static str, to: &'static str| {
        let line = ["run", "scene.toml", "--lockstep", "--seconds", "0.1"];
        [&line[..], &[option, to]].concat()
    };
    let absolute = at.join("mesh.vtu").display().to_string();
    let mut lines = vec![
        vec!["mesh", "convert", "mesh.vtu", "--out", "mesh-link.vtu"],
        vec!["mesh", "convert", "mesh.vtu", "--out", "./mesh-hard.vtu"],
        vec!["mesh", "convert", "mesh.vtu", "--out", &absolute],
        vec!["solve", "scene.toml", "--out", "mesh.vtu"],
        vec!["solve", "scene.toml", "--out", "mesh-hard.vtu"],
    ];
    // Files of a series have names of their own: any of them may be one that is read.
    let recorded = sutura_in(at, &session("--record", "a.mcap"));
    assert_eq!(recorded.code, 0, "{}", recorded.stderr);
    for (folder, name, to) in [
        ("first", "session-00000.vtu", "mesh.vtu"),
        ("later", "session-12345.vtu", "mesh.vtu"),
        ("list", "session.pvd", "tool.stl"),
        ("again", "session-00001.vtu", "a.mcap"),
    ] {
        std::fs::create_dir(at.join(folder)).expect("a folder");
        std::fs::hard_link(at.join(to), at.join(folder).join(name)).expect("a link");
    }
    for folder in ["first", "later", "list"] {
        lines.push(session("--series", folder));
    }
    lines.push(vec!["replay", "a.mcap", "--series", "again"]);
    for to in [
        "scene.toml",
        "./scene-link.toml",
        "mesh-hard.vtu",
        "device.toml",
        "tool-link.stl",
    ] {
        lines.extend([session("--record", to), session("--save-last", to)]);
    }
    // Last, as these would not end.
    lines.extend([
        vec!["view", "scene.toml", "--record", "device-hard.toml"],
        vec!["view", "scene.toml", "--shot", "scene.toml"],
    ]);
    for mut line in lines {
        line.push("--overwrite");
        let ran = sutura_in(at, &line);
        assert_eq!(ran.code, 2, "{line:?}: {}", ran.stderr);
        let said = "is read here and would be written over itself";
        assert!(ran.stderr.contains(said), "{line:?}: {}", ran.stderr);
        let after = read.map(|file| std::fs::read(at.join(file)).expect("there"));
        assert!(before == after, "{line:?}");
    }
}

/// Two outputs in one file would end with half of each, by whatever names it is called, and whether it is there or not.
#[cfg(unix)]
#[test]
fn two_outputs_are_never_one_file() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path();
    let scene = small(at, "scene.toml", "a");
    std::fs::write(at.join("a.mcap"), "mine").expect("writable");
    std::fs::hard_link(at.join("a.mcap"), at.join("hard.mcap")).expect("a link");
    std::os::unix::fs::symlink("new.mcap", at.join("link.mcap")).expect("a link");
    std::fs::create_dir(at.join("series")).expect("a folder");
    std::os::unix::fs::symlink("../b.mcap", at.join("series/session-00003.vtu")).expect("a link");
    let run = [
        "run",
        &scene,
        "--lockstep",
        "--seconds",
        "0.1",
        "--overwrite",
    ];
    let absolute = at.join("new.mcap").display().to_string();
    for outputs in [
        ["--record", "a.mcap", "--save-last", "./a.mcap"],
        ["--record", "a.mcap", "--save-last", "hard.mcap"],
        ["--record", "new.mcap", "--save-last", "link.mcap"],
        ["--record", &absolute, "--save-last", "series/../new.mcap"],
        ["--series", "series", "--save-last", "series/session.mcap"],
        [
            "--series",
            "series",
            "--save-last",
            "series/session-00000.vtu",
        ],
        ["--series", "series", "--record", "./series/session.pvd"],
        ["--series", "series", "--record", "b.mcap"],
    ] {
        let ran = sutura_in(at, &[&run[..], &outputs].concat());
        assert_eq!(ran.code, 2, "{outputs:?}: {}", ran.stderr);
        let said = "would write to one file";
        assert!(ran.stderr.contains(said), "{outputs:?}: {}", ran.stderr);
    }
    let shot = [
        "view",
        &scene,
        "--overwrite",
        "--record",
        "a.mcap",
        "--shot",
        "hard.mcap",
    ];
    let ran = sutura_in(at, &shot);
    assert_eq!(ran.code, 2, "{}", ran.stderr);
    let kept = std::fs::read_to_string(at.join("a.mcap")).expect("there");
    assert_eq!(kept, "mine");
    // Beside its pictures a recording of another name is welcome.
    let apart = [
        "--series",
        "other",
        "--record",
        "other/mine.mcap",
        "--save-last",
        "other/last.mcap",
    ];
    let ran = sutura_in(at, &[&run[..], &apart].concat());
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    assert!(at.join("other/session-00000.vtu").is_file() && at.join("other/mine.mcap").is_file());
}

/// A pipe waits for a reader, and a folder takes nothing: both are told before any work, whoever would write there.
#[cfg(unix)]
#[test]
fn only_plain_files_are_written() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path();
    let scene = small(at, "scene.toml", "a");
    let mesh = root().join("tests/data/cube_350.msh").display().to_string();
    let surface = root().join("tests/data/ring.stl").display().to_string();
    let run = ["run", &scene, "--lockstep", "--seconds", "0.1"];
    let recorded = sutura_in(at, &[&run[..], &["--record", "whole.mcap"]].concat());
    assert_eq!(recorded.code, 0, "{}", recorded.stderr);
    let pipe = |name: &str| {
        let made = std::process::Command::new("mkfifo")
            .arg(at.join(name))
            .status();
        assert!(made.expect("mkfifo").success());
    };
    let ends = ["json", "mcap", "vtu", "png", "txt"];
    for end in ends {
        pipe(&format!("pipe.{end}"));
        std::fs::create_dir(at.join(format!("folder.{end}"))).expect("a folder");
    }
    std::os::unix::fs::symlink("pipe.mcap", at.join("pipe-link.mcap")).expect("a link");
    for folder in ["pictures", "tables"] {
        std::fs::create_dir(at.join(folder)).expect("a folder");
    }
    pipe("pictures/session-00002.vtu");
    pipe("tables/cases.jsonl");
    let refused = |line: &[&str], said: &str| {
        let line = [line, &["--overwrite"]].concat();
        let ran = sutura_in(at, &line);
        assert_eq!(ran.code, 2, "{line:?}: {}", ran.stderr);
        for words in [
            said,
            "only plain files are written: name a file that is not there yet",
        ] {
            assert!(ran.stderr.contains(words), "{line:?}: {}", ran.stderr);
        }
    };
    for (kind, said) in [("pipe", "it is a pipe"), ("folder", "it is a folder")] {
        let [json, mcap, vtu, png, txt] = ends.map(|end| format!("{kind}.{end}"));
        refused(&["solve", &scene, "--out", &json], said);
        refused(&[&run[..], &["--record", &mcap]].concat(), said);
        refused(&[&run[..], &["--save-last", &mcap]].concat(), said);
        refused(&["view", &scene, "--record", &mcap], said);
        refused(&["view", &scene, "--shot", &png], said);
        refused(&["mesh", "convert", &mesh, "--out", &vtu], said);
        refused(
            &["mesh", "fill", &surface, "--nodes", "100", "--out", &vtu],
            said,
        );
        refused(&["device", "selftest", "/dev/none", "--out", &txt], said);
    }
    let pipe = "it is a pipe";
    refused(&[&run[..], &["--record", "pipe-link.mcap"]].concat(), pipe);
    refused(&[&run[..], &["--series", "pictures"]].concat(), pipe);
    refused(&["replay", "whole.mcap", "--series", "pictures"], pipe);
    for command in ["stability", "tradeoff", "fidelity"] {
        refused(&[command, "--plot", "tables"], pipe);
    }
    // A name that cannot be written is bad input, whoever finds out.
    let none = sutura_in(at, &[&run[..], &["--record", "none/a.mcap"]].concat());
    assert_eq!(none.code, 2, "{}", none.stderr);
}

/// A pipe that nobody writes to, a device without end and a folder are told at once, whatever is read.
#[cfg(unix)]
#[test]
fn only_plain_files_are_read() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path();
    for (kind, said) in [
        (
            "pipe",
            "it is a pipe, and only plain files are read: let the program that writes to it write a file",
        ),
        ("zero", "it is a device"),
        ("folder", "it is a folder"),
    ] {
        let make = |name: &str| {
            let place = at.join(name);
            // The files that a scene names exist already.
            let _ = std::fs::remove_file(&place);
            match kind {
                "pipe" => {
                    let made = std::process::Command::new("mkfifo").arg(&place).status();
                    assert!(made.expect("mkfifo").success());
                }
                "zero" => std::os::unix::fs::symlink("/dev/zero", &place).expect("a link"),
                _ => std::fs::create_dir(&place).expect("a folder"),
            }
        };
        let refused = |line: &[&str]| {
            let ran = sutura_in(at, line);
            assert_eq!(ran.code, 2, "{line:?}: {}", ran.stderr);
            assert!(ran.stderr.contains(said), "{line:?}: {}", ran.stderr);
        };
        for end in [
            "toml", "msh", "vtk", "vtu", "ele", "node", "stl", "mcap", "bin",
        ] {
            make(&format!("{kind}.{end}"));
        }
        let named = |end: &str| format!("{kind}.{end}");
        for command in [
            &["scene", "check"][..],
            &["scene", "explain"],
            &["run"],
            &["view"],
            &["bench"],
        ] {
            refused(&[command, &[&named("toml")]].concat());
        }
        refused(&["solve", &named("toml"), "--out", "a.json"]);
        for end in ["msh", "vtk", "vtu", "ele"] {
            refused(&["mesh", "info", &named(end)]);
        }
        refused(&[
            "mesh",
            "fill",
            &named("stl"),
            "--nodes",
            "100",
            "--out",
            "a.msh",
        ]);
        refused(&["replay", &named("mcap")]);
        refused(&["view", &named("mcap")]);
        refused(&["tradeoff", "merge", &named("toml")]);
        refused(&["flash", &named("bin"), "--board", "nucleo-f446ze"]);
        for file in &of_files(at)[1..] {
            make(file);
            refused(&["scene", "check", "scene.toml"]);
            std::fs::remove_dir(at.join(file))
                .or_else(|_| std::fs::remove_file(at.join(file)))
                .expect("removed");
            of_files(at);
        }
    }
    let file = std::fs::File::create(at.join("large.toml")).expect("created");
    file.set_len(1 << 32).expect("a hole");
    let ran = sutura_in(at, &["scene", "check", "large.toml"]);
    assert_eq!(ran.code, 2, "{}", ran.stderr);
    assert!(ran.stderr.contains("at most 67108864"), "{}", ran.stderr);
}

/// Terminal escapes in foreign names: a title, a clear screen, a bell, the same in one character of C1; an order turned around, twice,
/// and the end of a line.
const STEERS: &str = "\u{1b}]0;title\u{7}\u{1b}[2J\u{9b}31m\u{202e}txt\u{2066}\u{2028}";

fn steers_nothing(ran: &crate::support::Ran, line: &[&str]) {
    for text in [&ran.stdout, &ran.stderr] {
        let raw = text.chars().find(|c| {
            (c.is_control() && !matches!(c, '\n' | '\t'))
                || STEERS[1..].contains(*c) && !c.is_ascii()
        });
        assert_eq!(raw, None, "{line:?}: {text:?}");
    }
}

#[cfg(unix)]
#[test]
fn foreign_text_steers_no_terminal() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path();
    let file = format!("{STEERS}.toml");
    let escapes: String = STEERS
        .chars()
        .map(|letter| format!("\\u{:04x}", u32::from(letter)))
        .collect();
    small(at, &file, &escapes);
    let mesh = format!("{STEERS}.msh");
    let mut raw = RawMesh::new(
        vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        vec![[0, 1, 2, 3]],
        vec![7],
    );
    raw.region_names.insert(7, STEERS.to_owned());
    write_mesh(&raw, &at.join(&mesh), MeshFormat::Msh).expect("written");
    let out = format!("{STEERS}.json");
    let copy = format!("{STEERS}-2.vtk");
    for line in [
        &[
            "run",
            &file,
            "--lockstep",
            "--seconds",
            "0.1",
            "--record",
            "a.mcap",
            "-v",
        ][..],
        &["replay", "a.mcap", "-v"],
        &["solve", &file, "--out", &out],
        &["scene", "check", &file],
        &["scene", "explain", &file],
        &["bench", &file],
        &["mesh", "info", &mesh],
        &["mesh", "convert", &mesh, "--out", &copy],
    ] {
        let text = sutura_in(at, line);
        assert_eq!(text.code, 0, "{line:?}: {}", text.stderr);
        steers_nothing(&text, line);
        let json = [line, &["--format", "json", "--overwrite"]].concat();
        let ran = sutura_in(at, &json);
        assert_eq!(ran.code, 0, "{json:?}: {}", ran.stderr);
        steers_nothing(&ran, &json);
        let object = ran.json();
        let names = ["scene", "name", "file", "out"].map(|key| object[key].as_str());
        let is_whole = names.iter().flatten().any(|name| name.contains(STEERS));
        let is_region = object["regions"][0]["name"] == STEERS;
        assert!(
            is_whole || is_region || !object["scene"].is_string(),
            "{json:?}: values stay: {object}"
        );
    }
}
