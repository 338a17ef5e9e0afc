//! The C library as a stranger uses it: built by cargo, linked by the system's compiler, run against a virtual console.
#![cfg(unix)]
#![allow(clippy::unwrap_used, reason = "tests")]

use crate::support::session;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use sutura_hil::VirtualConsole;

/// Stiffness of the sphere in sphere.c \[N/m\].
const STIFFNESS: f64 = 400.0;
/// Stiffness of the hand in sphere.c \[N/m\], and how far below the top of the sphere it wants to be \[m\].
const HAND: (f64, f64) = (1000.0, 0.01);

fn root() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."))
}

fn run(command: &mut Command) -> Output {
    let output = command.output().unwrap();
    assert!(
        output.status.success(),
        "{command:?}: {}\n{}",
        output.status,
        String::from_utf8_lossy(&output.stderr)
    );
    output
}

/// The static library, which cargo has built with these tests: it is one of their dependencies.
fn library() -> PathBuf {
    let beside = std::env::current_exe().unwrap();
    beside.with_file_name("libsutura_capi.a")
}

/// Mode, place \[m\], force felt \[N\] and force of the sphere at that place \[N\], as sphere.c prints them.
struct Line {
    mode: u32,
    felt: [f64; 3],
    law: [f64; 3],
}

fn lines(output: &str) -> Vec<Line> {
    let numbers = output.lines().skip(1).map(|line| {
        let numbers = line.split_whitespace().map(|word| word.parse().unwrap());
        <[f64; 10]>::try_from(numbers.collect::<Vec<_>>()).unwrap()
    });
    let lines = numbers.map(|[mode, _, _, _, fx, fy, fz, lx, ly, lz]| Line {
        mode: mode as u32,
        felt: [fx, fy, fz],
        law: [lx, ly, lz],
    });
    lines.collect()
}

#[test]
fn the_c_example_renders_its_sphere() {
    let folder = tempfile::tempdir().unwrap();
    let sphere = folder.path().join("sphere");
    // The command line of the book's page.
    let mut cc = Command::new("cc");
    cc.args([
        "-std=c99",
        "-Wall",
        "-Wextra",
        "-Wpedantic",
        "-Werror",
        "-Iclient/c",
    ]);
    cc.arg("client/c/sphere.c")
        .arg(library())
        .arg("-o")
        .arg(&sphere);
    run(cc.args(["-lpthread", "-ldl", "-lm"]).current_dir(root()));

    let console = VirtualConsole::start(&session::device()).unwrap();
    let port = console.path().unwrap();
    let output = run(Command::new(&sphere).args([port, "2.5"]));
    let output = String::from_utf8(output.stdout).unwrap();
    println!("{output}");
    assert!(output.starts_with("cartesian-bench, 1000 Hz, simulated\n"));
    let lines = lines(&output);
    assert!(lines.iter().any(|line| line.mode == 2), "was never armed");
    // Pressed by more than 2 N the console's force is the sphere's at that place, to within what three steps of the encoders
    // (15 mN) and the last millisecond's velocity make of it, and in the balance of both springs, which only the right
    // stiffness gives; friction holds 0.3 N. On a desktop that stops for longer than the horizon the force decays in
    // between, so that not every line is like that.
    let (stiffness, depth) = HAND;
    let balance = depth * stiffness * STIFFNESS / (stiffness + STIFFNESS);
    let at_rest = |line: &&Line| {
        let pairs = line.felt.iter().zip(&line.law);
        let off = pairs.fold(0.0, |worst: f64, (felt, law)| worst.max((felt - law).abs()));
        line.mode == 2 && off < 0.03 && (line.felt[2] - balance).abs() < 0.3
    };
    let good = lines.iter().filter(at_rest).count();
    assert!(
        good >= 3,
        "{good} of {} lines at the sphere's force, {balance} N",
        lines.len()
    );
}

#[test]
fn a_failure_has_words_in_c() {
    let folder = tempfile::tempdir().unwrap();
    let source = folder.path().join("missing.c");
    let text = r#"
        #include "sutura.h"
        #include <stdio.h>
        int main(void) {
            sutura_console *console;
            sutura_pose pose;
            int32_t missing = sutura_open("/dev/no-such-console", NULL, &console);
            printf("%d %d %s\n", missing == SUTURA_NO_CONSOLE, console == NULL, sutura_last_error());
            printf("%d ", sutura_read_pose(console, 1, &pose) == SUTURA_BAD_ARGUMENT);
            printf("%s %d\n", sutura_last_error(), sutura_close(NULL) == SUTURA_OK);
            return 0;
        }"#;
    std::fs::write(&source, text).unwrap();
    let program = folder.path().join("missing");
    let mut cc = Command::new("cc");
    cc.args(["-std=c99", "-Wall", "-Wextra", "-Werror", "-Iclient/c"])
        .arg(&source);
    cc.arg(library())
        .arg("-o")
        .arg(&program)
        .args(["-lpthread", "-ldl", "-lm"]);
    run(cc.current_dir(root()));
    let output = String::from_utf8(run(&mut Command::new(program)).stdout).unwrap();
    let (missing, null) = output.split_once('\n').unwrap();
    assert!(
        missing.starts_with("1 1 there is no port `/dev/no-such-console`"),
        "{output}"
    );
    assert_eq!(null.trim(), "1 console is NULL 1");
}

#[test]
fn the_header_is_good_cpp() {
    if Command::new("c++").arg("--version").output().is_err() {
        eprintln!("no C++ compiler: the header is checked in C alone");
        return;
    }
    let mut cpp = Command::new("c++");
    cpp.args([
        "-fsyntax-only",
        "-Wall",
        "-Wextra",
        "-Werror",
        "-x",
        "c++",
        "client/c/sutura.h",
    ]);
    run(cpp.current_dir(root()));
}
