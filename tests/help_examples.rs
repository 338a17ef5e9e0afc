//! Every example that a `--help`, README or the book shows: it is run here, and what it feels or writes is looked at. An example
//! without an entry below fails, and so does an entry without an example.
//!
//! Sessions run in lockstep, so that nothing depends on the machine; where the first second shows what the example shows, it is
//! that second. What takes long, or needs an emulator, runs with `SUTURA_FULL=1`.
#![cfg(unix)]
#![allow(clippy::unwrap_used, reason = "tests")]

use crate::support::{Ran, ran, root, sutura_in};
use serde_json::Value;
use std::collections::BTreeSet;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};
use sutura_testkit::full;

/// How an example is run, and what must come of it.
#[derive(Clone, Copy, Debug)]
enum Way {
    /// As it stands: exit code 0, and these files are written.
    Ends(&'static [&'static str]),
    /// The same with one of these exit codes: they depend on the machine.
    EndsWith(&'static [i32]),
    /// As a session in lockstep, so many seconds of it \[s\]: force is felt, and nothing decays on the way.
    Feels(&'static str),
    /// The same of a scene whose force is not that of a press: the session ends well.
    Runs(&'static str),
    /// The same with a tissue that is chosen by measurement, which may miss its budget here.
    Chooses(&'static str),
    /// With a console that is not there in place of a board's: exit code 3, and the port is named.
    Port,
    /// A console that runs until it is told to stop.
    Serves,
    /// A page that is shown until it is told to stop; it says where.
    Shows,
    /// A picture of a page, by a browser that may not be there: then what is missing is said.
    Shot(&'static str),
}
use Way::{Chooses, Ends, EndsWith, Feels, Port, Runs, Serves, Shot, Shows};

/// Seconds of palpation after which the first press has been held for a while.
const FIRST_PRESS: &str = "1";
/// Peak force of that press \[N\]: the hand's spring of 1000 N/m pulls 10 mm deep at most; soft tissue gives half a newton and more.
const PEAK_N: std::ops::Range<f64> = 0.3..10.0;

/// In the order in which they run: some need what others wrote.
const EXAMPLES: &[(&str, Way)] = &[
    ("sutura", Feels(FIRST_PRESS)),
    ("sutura run", Feels(FIRST_PRESS)),
    ("sutura run --lockstep", Feels(FIRST_PRESS)),
    (
        "sutura run --tissue corotational --host-hz 30",
        Feels(FIRST_PRESS),
    ),
    (
        "sutura run --rendering hold --host-hz 30",
        Feels(FIRST_PRESS),
    ),
    ("sutura run --record session.mcap", Feels("1.3")),
    ("sutura replay session.mcap", Ends(&[])),
    (
        "sutura replay session.mcap --verify --format json",
        Ends(&[]),
    ),
    (
        "sutura replay session.mcap --series again",
        Ends(&["again/session.pvd"]),
    ),
    (
        "sutura run --series pictures",
        Ends(&["pictures/session.mcap", "pictures/session.pvd"]),
    ),
    (
        "sutura run scenes/palpation.toml --console virtual --lockstep",
        Feels(FIRST_PRESS),
    ),
    ("sutura run scenes/needle-arc.toml", Runs("0.5")),
    ("sutura run scenes/anastomosis-50.toml", Runs("0.1")),
    ("sutura run scenes/needle-sweeps.toml", Runs("0.5")),
    ("sutura run scenes/two-threads.toml", Runs("0.5")),
    ("sutura run scenes/thread-over-shaft.toml", Runs("0.5")),
    ("sutura run scenes/shaft-on-shaft.toml", Runs("0.5")),
    ("sutura run scenes/needle-pushed.toml", Runs("0.5")),
    ("sutura run --view", Feels(FIRST_PRESS)),
    ("sutura run --foxglove", Feels(FIRST_PRESS)),
    ("sutura run --console /dev/ttyACM0", Port),
    ("sutura run --console /tmp/console", Port),
    ("sutura device list", EndsWith(&[0, 3])),
    ("sutura device list --format json", EndsWith(&[0, 3])),
    ("sutura device selftest /dev/ttyACM0", Port),
    (
        "sutura device selftest /dev/ttyACM0 --out selftest.txt",
        Port,
    ),
    // Of no console: the number is made up.
    ("sutura device log 0043002B3438510B32363530", EndsWith(&[3])),
    (
        "sutura device log 0043002B3438510B32363530 --elf sutura-nucleo-f446ze",
        EndsWith(&[2]),
    ),
    // There are no such images, or a board that is plugged in would be written: tests/flash.rs has both.
    ("sutura flash image.elf", EndsWith(&[2])),
    ("sutura flash image.bin", EndsWith(&[2])),
    ("sutura flash image.bin --method dfu", EndsWith(&[2])),
    ("sutura flash image.hex --method probe", EndsWith(&[2])),
    ("sutura flash image.bin --port /dev/ttyACM0", EndsWith(&[2])),
    (
        "sutura run --console /dev/ttyACM0 --host-hz 500 --budget-ms 2",
        Port,
    ),
    (
        "sutura run --console /dev/ttyACM0 --seconds 3600 --rearm",
        Port,
    ),
    (
        "sutura run --console /dev/ttyACM0 --save-last fault.mcap",
        Port,
    ),
    ("sutura run --console /dev/ttyACM0 --view", Port),
    ("sutura run --console /dev/ttyACM0 --top", Port),
    ("sutura run --top", Feels(FIRST_PRESS)),
    ("sutura run --view --foxglove", Feels(FIRST_PRESS)),
    // No session runs here: tests/top.rs has some.
    ("sutura top", EndsWith(&[2])),
    ("sutura top http://127.0.0.1:8422", EndsWith(&[2])),
    ("sutura view", Shows),
    ("sutura view scenes/anastomosis-20.toml --open", Shows),
    ("sutura view scenes/anastomosis-20.toml", Shows),
    ("sutura view --foxglove", Shows),
    ("sutura view session.mcap", Shows),
    (
        "sutura view scenes/palpation.toml --shot palpation.png --at 2.5",
        Shot("palpation.png"),
    ),
    (
        "sutura view session.mcap --shot forces.png --at 1.2",
        Shot("forces.png"),
    ),
    // Afterwards the file has another recording.
    ("sutura view --record session.mcap", Shows),
    ("sutura console", Serves),
    ("sutura console --link /tmp/bench", Serves),
    ("sutura console --link /tmp/console", Serves),
    ("sutura console --device devices/serial-arm.toml", Serves),
    (
        "sutura solve scenes/cube-handle.toml --out cube.vtu",
        Ends(&["cube.vtu"]),
    ),
    (
        "sutura solve scenes/cube-handle.toml --out cube.json",
        Ends(&["cube.json"]),
    ),
    (
        "sutura solve scenes/palpation.toml --out pressed.json",
        Ends(&["pressed.json"]),
    ),
    (
        "sutura solve scenes/palpation.toml --out out.vtu",
        Ends(&["out.vtu"]),
    ),
    (
        "sutura solve scene.toml --out field.vtu",
        Ends(&["field.vtu"]),
    ),
    ("sutura scene check scenes/palpation.toml", Ends(&[])),
    ("sutura scene check mine.toml", Ends(&[])),
    ("sutura scene check mine.toml --format json", Ends(&[])),
    ("sutura scene explain scenes/palpation.toml", Ends(&[])),
    ("sutura scene explain scene.toml", Ends(&[])),
    ("sutura scene explain mine.toml --format json", Ends(&[])),
    ("sutura scene schema", Ends(&[])),
    ("sutura schema", Ends(&[])),
    ("sutura schema run", Ends(&[])),
    ("sutura schema run --format json", Ends(&[])),
    ("sutura --version", Ends(&[])),
    ("sutura completions bash", Ends(&[])),
    ("sutura completions zsh", Ends(&[])),
    ("sutura completions fish", Ends(&[])),
    (
        "sutura man ~/.local/share/man/man1",
        Ends(&["home/.local/share/man/man1/sutura-run.1"]),
    ),
    ("sutura mesh info tests/data/cube_1650.msh", Ends(&[])),
    ("sutura mesh info part.vtk --scale 0.001", Ends(&[])),
    (
        "sutura mesh info organ.vtk --region tissue_class",
        Ends(&[]),
    ),
    ("sutura mesh info part.ele --format json", Ends(&[])),
    ("sutura mesh info part.msh", Ends(&[])),
    ("sutura mesh info large.msh --time --rows 100", Ends(&[])),
    (
        "sutura mesh convert part.node --out part.msh",
        Ends(&["part.msh"]),
    ),
    (
        "sutura mesh convert part.vtk --out part.msh --scale 0.001",
        Ends(&["part.msh"]),
    ),
    (
        "sutura mesh convert part.inp --out part.msh --clean",
        Ends(&["part.msh"]),
    ),
    // gmsh may not be there.
    (
        "sutura mesh fill liver.stl --nodes 1500 --out liver.msh --scale 0.001",
        EndsWith(&[0, 1]),
    ),
    (
        "sutura mesh fill liver.stl --nodes 300 --out liver.vtu --format json",
        EndsWith(&[0, 1]),
    ),
    (
        "sutura mesh fill lobe.ply --nodes 1000 --out lobe.msh --scale 0.001",
        EndsWith(&[0, 1]),
    ),
    // Its mesh is not there without: tests/cli_mesh_fill.rs runs it on one.
    ("sutura run lobe.toml", EndsWith(&[0, 2])),
    (
        "sutura mesh convert part.msh --out part.vtu",
        Ends(&["part.vtu"]),
    ),
];

/// The same for those that take long. Whole tables, which take hours, are made in their short form.
const LONG: &[(&str, Way)] = &[
    (
        "sutura run --host-hz 50 --budget-ms 15",
        Chooses(FIRST_PRESS),
    ),
    ("sutura run --tissue auto", Chooses(FIRST_PRESS)),
    ("sutura run --budget-ms 5", Chooses(FIRST_PRESS)),
    (
        "sutura run --tissue hyperelastic --host-hz 20 --lockstep",
        Feels(FIRST_PRESS),
    ),
    (
        "sutura run scenes/palpation.toml --console qemu --format json",
        EndsWith(&[0]),
    ),
    (
        "sutura run scenes/palpation.toml --console qemu",
        EndsWith(&[0]),
    ),
    ("sutura replay session.mcap --console qemu", EndsWith(&[0])),
    (
        "sutura solve scenes/needle-slabs.toml --at 3 --out in.vtu",
        Ends(&["in.vtu"]),
    ),
    ("sutura bench", Ends(&[])),
    (
        "sutura bench scenes/palpation.toml my.toml --format json",
        Ends(&[]),
    ),
    (
        "sutura bench scenes/anastomosis-50.toml --tissue corotational",
        Ends(&[]),
    ),
    ("sutura bench --suite", Ends(&[])),
    ("sutura bench --suite --steps 100", Ends(&[])),
    ("sutura bench --suite --only sliding", Ends(&[])),
    (
        "sutura bench --suite --steps 250 --paced 60 --only 1,650",
        Ends(&[]),
    ),
    ("sutura doctor", EndsWith(&[0, 1])),
    ("sutura doctor virtual", EndsWith(&[0, 1])),
    ("sutura doctor virtual --format json", EndsWith(&[0, 1])),
    (
        "sutura doctor --scene scenes/anastomosis-50.toml",
        EndsWith(&[0, 1]),
    ),
    ("sutura doctor /dev/ttyACM0", Port),
    ("sutura fidelity", Ends(&[])),
    ("sutura fidelity --full --plot figures", Ends(&["figures"])),
    ("sutura fidelity --guards --check", Ends(&[])),
    (
        "sutura fidelity --full --only \"palpation taps rows\"",
        Ends(&[]),
    ),
    ("sutura fidelity --full --only corner", Ends(&[])),
    (
        "sutura fidelity --full --only \"trial needle phase\"",
        Ends(&[]),
    ),
    ("sutura fidelity --full --only \"trial draw-17\"", Ends(&[])),
    ("sutura fidelity --check --format json", Ends(&[])),
    ("sutura tradeoff", Ends(&[])),
    ("sutura tradeoff --full --plot figures", Ends(&["figures"])),
    ("sutura tradeoff --full --plot out", Ends(&["out"])),
    ("sutura tradeoff --full --only beam-bending", Ends(&[])),
    ("sutura tradeoff --only beam --errors", Ends(&[])),
    (
        "sutura tradeoff --only \"beam linear\" --cases 1/2 --plot share-1",
        Ends(&["share-1"]),
    ),
    (
        "sutura tradeoff --only \"beam linear\" --cases 2/2 --plot share-2",
        Ends(&["share-2"]),
    ),
    (
        "sutura tradeoff merge share-1/tradeoff.json share-2/tradeoff.json --plot both",
        Ends(&["both"]),
    ),
    (
        "sutura tradeoff --only \"cube linear\" --format json",
        Ends(&[]),
    ),
    ("sutura stability", Ends(&[])),
    ("sutura stability --full --plot tables", Ends(&["tables"])),
    (
        "sutura stability --full --only \"corotational turn\"",
        Ends(&[]),
    ),
];

fn help(of: &[&str]) -> String {
    let ran = sutura_in(&root(), &[of, &["--help"]].concat());
    assert_eq!(ran.code, 0, "{of:?}: {}", ran.stderr);
    ran.stdout
}

/// All commands, by the words that name them.
fn commands(of: &[String]) -> Vec<Vec<String>> {
    let words: Vec<&str> = of.iter().map(String::as_str).collect();
    let text = help(&words);
    let mut all = vec![of.to_vec()];
    let listed = text.lines().skip_while(|line| *line != "Commands:").skip(1);
    for line in listed.take_while(|line| !line.is_empty()) {
        // A name stands two spaces in; what it does may go on below.
        let name = line
            .strip_prefix("  ")
            .filter(|rest| !rest.starts_with(' '));
        let name = name.and_then(|rest| rest.split_whitespace().next());
        if let Some(name) = name.filter(|name| *name != "help") {
            all.extend(commands(&[of, &[name.to_owned()]].concat()));
        }
    }
    all
}

/// The command lines that helps show: up to two spaces, a pipe, or a file that takes the output.
fn shown() -> BTreeSet<String> {
    let mut lines = BTreeSet::new();
    for command in commands(&[]) {
        let words: Vec<&str> = command.iter().map(String::as_str).collect();
        let text = help(&words);
        let examples = text.lines().skip_while(|line| *line != "Examples:").skip(1);
        for line in examples.take_while(|line| !line.is_empty()) {
            let Some(line) = line
                .strip_prefix("  ")
                .filter(|line| line.starts_with("sutura"))
            else {
                continue;
            };
            lines.insert(up_to_its_end(line));
        }
    }
    lines.extend(written());
    lines
}

/// The command of a line that goes on with what it is for, or with what takes its output.
fn up_to_its_end(line: &str) -> String {
    let ends = ["  ", " | ", " > ", " && "];
    let ends = ends.iter().filter_map(|end| line.find(end));
    let line = &line[..ends.min().unwrap_or(line.len())];
    line.trim_end().to_owned()
}

/// The command lines of README and the book: lines of code that begin with the command, or with cargo that runs it.
fn written() -> BTreeSet<String> {
    const CARGO: &str = "cargo run --release";
    let book = std::fs::read_dir(root().join("docs/src")).unwrap();
    let pages = book.map(|entry| entry.unwrap().path());
    let pages = pages.filter(|path| path.extension().is_some_and(|end| end == "md"));
    let others =
        ["README.md", "firmware/README.md", "CONTRIBUTING.md"].map(|name| root().join(name));
    let mut lines = BTreeSet::new();
    for path in pages.chain(others) {
        let text = std::fs::read_to_string(&path).unwrap();
        let mut fenced = false;
        for line in text.lines() {
            if line.starts_with("```") {
                fenced = !fenced;
            }
            let code = if fenced {
                Some(line)
            } else {
                line.strip_prefix("    ")
            };
            let Some(line) = code.map(up_to_its_end) else {
                continue;
            };
            let own = match line.strip_prefix(CARGO) {
                Some("") => Some("sutura".to_owned()),
                Some(rest) => rest
                    .strip_prefix(" -- ")
                    .map(|rest| format!("sutura {rest}")),
                None => Some(line).filter(|line| line.starts_with("sutura ")),
            };
            lines.extend(own);
        }
    }
    lines
}

#[test]
fn every_example_has_an_entry() {
    let shown = shown();
    let entries: BTreeSet<String> = EXAMPLES
        .iter()
        .chain(LONG)
        .map(|(line, _)| (*line).to_owned())
        .collect();
    let missing: Vec<_> = shown.difference(&entries).collect();
    assert!(
        missing.is_empty(),
        "examples that nobody runs: {missing:#?}"
    );
    let stale: Vec<_> = entries.difference(&shown).collect();
    assert!(stale.is_empty(), "entries that no help shows: {stale:#?}");
}

/// A folder in which the files are that examples name.
fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    for name in ["scenes", "devices", "tests"] {
        std::os::unix::fs::symlink(root().join(name), at.join(name)).unwrap();
    }
    for name in ["mine.toml", "my.toml", "scene.toml"] {
        std::fs::copy(root().join("scenes/palpation.toml"), at.join(name)).unwrap();
    }
    std::fs::copy(
        root().join("tests/data/cube_1650.msh"),
        at.join("large.msh"),
    )
    .unwrap();
    let ring = root().join("tests/data/ring.stl");
    std::fs::copy(ring, at.join("liver.stl")).unwrap();
    for name in ["lobe.ply", "lobe.toml"] {
        std::fs::copy(root().join("docs/src/mesh").join(name), at.join(name)).unwrap();
    }
    let deck = root().join("tests/data/meshes/gmsh.inp");
    std::fs::copy(deck, at.join("part.inp")).unwrap();
    for name in ["part.vtk", "part.node", "part.msh"] {
        let ran = sutura_in(
            at,
            &["mesh", "convert", "tests/data/cube_350.msh", "--out", name],
        );
        assert_eq!(ran.code, 0, "{}", ran.stderr);
    }
    let part = std::fs::read_to_string(at.join("part.vtk")).unwrap();
    let organ = part.replace("SCALARS region", "SCALARS tissue_class");
    std::fs::write(at.join("organ.vtk"), organ).unwrap();
    folder
}

/// The words after `sutura`; quotes hold some together.
fn words(line: &str) -> Vec<String> {
    let mut words = Vec::new();
    for (index, part) in line.split('"').enumerate() {
        if index % 2 == 1 {
            words.push(part.to_owned());
        } else {
            let split = part.split_whitespace();
            words.extend(split.map(|word| word.replace('~', "home")));
        }
    }
    words.remove(0);
    words
}

fn run(at: &Path, words: &[String]) -> Ran {
    let mut command = Command::new(env!("CARGO_BIN_EXE_sutura"));
    // No session of the user's is found, and no port taken that others may have.
    command.args(words).env("XDG_RUNTIME_DIR", at);
    if words.iter().any(|word| word == "--foxglove") {
        command.args(["--foxglove-port", "0"]);
    }
    ran(command.current_dir(at))
}

/// A session of so many seconds in lockstep, and what is wrong with it.
fn feel(at: &Path, mut words: Vec<String>, seconds: &str, codes: &[i32]) -> Result<(), String> {
    if words.is_empty() {
        words.push("run".to_owned());
    }
    words.extend(["--seconds", seconds, "--format", "json"].map(str::to_owned));
    if !words.iter().any(|word| word == "--lockstep") {
        words.push("--lockstep".to_owned());
    }
    let ran = run(at, &words);
    if !codes.contains(&ran.code) {
        return Err(format!("exit code {}: {}", ran.code, ran.stderr));
    }
    let summary: Value = serde_json::from_str(&ran.stdout).map_err(|error| error.to_string())?;
    let peak = summary["force_n"]["peak"].as_f64().unwrap_or_default();
    match summary["decays"].as_u64() {
        _ if !PEAK_N.contains(&peak) => Err(format!("a peak of {peak} N")),
        Some(0) => Ok(()),
        decays => Err(format!("{decays:?} decays, a peak of {peak} N")),
    }
}

/// Runs an example; what is wrong, if anything.
fn look(at: &Path, line: &str, way: Way) -> Result<(), String> {
    let mut words = words(line);
    if !words.iter().any(|word| word == "--only") {
        words.retain(|word| word != "--full");
    }
    // What an earlier example has written, and this one writes anew.
    for option in ["--out", "--record", "--shot", "--save-last"] {
        let file = words.windows(2).find(|two| two[0] == option);
        if let Some([_, file]) = file {
            let _ = std::fs::remove_file(at.join(file));
        }
    }
    if let Some([_, folder]) = words.windows(2).find(|two| two[0] == "--plot") {
        let _ = std::fs::remove_dir_all(at.join(folder));
    }
    let ended = |codes: &[i32]| {
        let ran = run(at, &words);
        match codes.contains(&ran.code) {
            true => Ok(()),
            false => Err(format!("exit code {}: {}", ran.code, ran.stderr)),
        }
    };
    match way {
        Feels(seconds) => feel(at, words, seconds, &[0]),
        Chooses(seconds) => feel(at, words, seconds, &[0, 7]),
        EndsWith(codes) => ended(codes),
        Runs(seconds) => {
            let more = ["--lockstep", "--seconds", seconds, "--format", "json"];
            let ran = run(at, &[&words[..], &more.map(str::to_owned)].concat());
            match (ran.code, &ran.json()["status"]) {
                (0, status) if status == "ok" => Ok(()),
                other => Err(format!("{other:?}: {}", ran.stderr)),
            }
        }
        Ends(files) => {
            ended(&[0])?;
            let missing = files.iter().find(|file| !at.join(file).exists());
            missing.map_or(Ok(()), |file| Err(format!("there is no {file}")))
        }
        Port => {
            const NOBODY: &str = "/dev/no-such-console";
            let words: Vec<String> = words
                .iter()
                .map(|word| word.replace("/dev/ttyACM0", NOBODY))
                .map(|word| word.replace("/tmp/console", NOBODY))
                .collect();
            let ran = run(at, &words);
            let said = format!("{}{}", ran.stdout, ran.stderr);
            match (ran.code, said.contains(NOBODY)) {
                (3, true) => Ok(()),
                _ => Err(format!("exit code {}: {said}", ran.code)),
            }
        }
        Serves => serve(at, &words),
        Shows => show(at, &words),
        Shot(file) => {
            let ran = run(at, &words);
            match (ran.code, at.join(file).exists()) {
                (0, true) => Ok(()),
                (2, false) if ran.stderr.contains("apt-get install chromium") => Ok(()),
                other => Err(format!("{other:?}: {}", ran.stderr)),
            }
        }
    }
}

/// Starts a page, reads where it is, asks for it, and tells it to stop.
fn show(at: &Path, words: &[String]) -> Result<(), String> {
    let no_browser = words.iter().filter(|word| *word != "--open");
    let mut page = Command::new(env!("CARGO_BIN_EXE_sutura"))
        .args(no_browser)
        .args(["--view-port", "0"])
        .current_dir(at)
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut stderr = BufReader::new(page.stderr.take().unwrap());
    let mut line = String::new();
    while !line.starts_with("see it: ") {
        line.clear();
        if stderr.read_line(&mut line).unwrap() == 0 {
            let ended = page.wait().unwrap();
            return Err(format!("it does not say where it is: {ended}"));
        }
    }
    let place = line.trim_start_matches("see it: http://").split('/').next();
    let place = place.unwrap_or_default();
    let mut stream = std::net::TcpStream::connect(place).unwrap();
    let request = format!("GET / HTTP/1.1\r\nhost: {place}\r\nconnection: close\r\n\r\n");
    std::io::Write::write_all(&mut stream, request.as_bytes()).unwrap();
    let mut answer = String::new();
    std::io::Read::read_to_string(&mut stream, &mut answer).unwrap();
    // What it says on the way is not waited for.
    std::thread::spawn(move || std::io::copy(&mut stderr, &mut std::io::sink()));
    let told = Command::new("kill").arg(page.id().to_string()).status();
    let ended = page.wait().unwrap();
    let is_page = answer.starts_with("HTTP/1.1 200") && answer.contains("<title>Sutura");
    // 130 of a recording that is still run again.
    match (is_page, told.is_ok_and(|told| told.success()), ended.code()) {
        (true, true, Some(0 | 130)) => Ok(()),
        other => Err(format!("{line:?}: {other:?}")),
    }
}

/// Starts a console, reads its port, and tells it to stop.
fn serve(at: &Path, words: &[String]) -> Result<(), String> {
    // Not where another run of this test puts its own.
    let link = at.join("bench").display().to_string();
    let words = words.iter().map(|word| {
        word.replace("/tmp/bench", &link)
            .replace("/tmp/console", &link)
    });
    let mut console = Command::new(env!("CARGO_BIN_EXE_sutura"))
        .args(words)
        .current_dir(at)
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut port = String::new();
    let mut stdout = BufReader::new(console.stdout.take().unwrap());
    stdout.read_line(&mut port).unwrap();
    let is_there = Path::new(port.trim()).exists();
    let told = Command::new("kill").arg(console.id().to_string()).status();
    let ended = console.wait().unwrap();
    match (
        is_there,
        told.is_ok_and(|told| told.success()),
        ended.code(),
    ) {
        (true, true, Some(0)) => Ok(()),
        other => Err(format!("port {port:?}: {other:?}")),
    }
}

#[test]
fn every_example_does_what_it_shows() {
    let folder = folder();
    let emulated = Command::new("qemu-system-arm")
        .arg("--version")
        .stdout(Stdio::null())
        .status()
        .is_ok();
    let long = LONG
        .iter()
        .filter(|(line, _)| full() && (emulated || !line.contains("qemu")));
    let mut wrong = Vec::new();
    for (line, way) in EXAMPLES.iter().chain(long) {
        let began = std::time::Instant::now();
        let looked = look(folder.path(), line, *way);
        println!("{:6.1} s  {line}", began.elapsed().as_secs_f64());
        if let Err(why) = looked {
            wrong.push(format!("{line}: {why}"));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
