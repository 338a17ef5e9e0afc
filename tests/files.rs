//! Files that commands write: what is there is kept, folders are made before the work, and a full disk takes no result.

use crate::support::{ran, root, sutura_in};

const SESSION: [&str; 6] = ["run", "--lockstep", "--seconds", "0.1", "--format", "json"];

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
    assert_eq!(grown.json()["ticks"], 1000, "{}", grown.stdout);
}
