//! `cargo xtask firmware`: builds the images, measures them, compares with the snapshots.
//! Entry points: [`build_one`], [`gated`].

use crate::Format;
use crate::cycles::{self, Estimate};
use crate::gates::{self, FIRMWARE, Gate, Outcome, Snapshot};
use crate::image::{self, Image};
use crate::made_of;
use crate::run::{Tool, root};
use crate::setup::{self, QEMU};
use crate::toolchain::{TARGET, Toolchain};
use anyhow::{Context, Result, bail};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// A board of `firmware/src/board`: a feature of its package.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Board {
    name: String,
    /// It has motors, and so a self-test, and an image that can go without a guard.
    motors: bool,
}

/// What is read of `firmware/Cargo.toml`.
#[derive(Deserialize)]
struct Manifest {
    features: BTreeMap<String, Vec<String>>,
}

impl Board {
    /// QEMU's netduinoplus2 with a simulated console.
    pub fn simulated() -> Board {
        Board {
            name: "virtual".to_owned(),
            motors: false,
        }
    }

    /// Every board: those whose feature has `motors`, and the simulated one.
    ///
    /// # Errors
    /// If `firmware/Cargo.toml` cannot be read.
    pub fn all() -> Result<Vec<Board>> {
        let path = root().join("firmware/Cargo.toml");
        let text = std::fs::read_to_string(&path)
            .with_context(|| format!("cannot read {}", path.display()))?;
        let manifest: Manifest =
            toml::from_str(&text).with_context(|| format!("cannot read {}", path.display()))?;
        let mut boards = with_motors(&manifest);
        boards.push(Board::simulated());
        Ok(boards)
    }

    /// The board of a name, for the command line.
    ///
    /// # Errors
    /// What boards there are.
    pub fn of_name(name: &str) -> Result<Board> {
        let boards = Board::all()?;
        let names: Vec<_> = boards.iter().map(|board| board.name.clone()).collect();
        let found = boards.into_iter().find(|board| board.name == name);
        found.with_context(|| format!("the boards are {}", names.join(", ")))
    }

    /// Name of its cargo feature.
    pub fn name(&self) -> &str {
        &self.name
    }
}

fn with_motors(manifest: &Manifest) -> Vec<Board> {
    let motors = |needs: &Vec<String>| needs.iter().any(|need| need == "motors");
    let features = manifest.features.iter();
    features
        .filter(|(_, needs)| motors(needs))
        .map(|(name, _)| Board {
            name: name.clone(),
            motors: true,
        })
        .collect()
}

/// Most that a lock shared with the control task may hold, whoever takes it \[instructions\].
const LOCK_LIMIT: u64 = 200;

/// Most that a tick may take, kinematics included: rendering a tangent, solving the rows alone, and a whole tick of an arm in which the rows
/// are changed besides \[instructions\]. What a tick has are cycles: [`CYCLE_LIMIT`]; these are counted, not estimated, and tell what grows.
const TICK_LIMITS: [(&str, u64); 5] = [
    ("tick_tangent_with_swap_serial_arm", 9_600),
    ("rows24_solve", 65_000),
    ("rows24_cones_solve", 65_000),
    ("tick_rows24_with_swap_serial_arm", 84_000),
    ("tick_rows24_cones_with_swap_serial_arm", 84_000),
];

/// Most that a tick may take, estimated: a fifth of its 168000 is left for the link and telemetry \[cycles\].
const CYCLE_LIMIT: u64 = 134_400;

/// Every board's core. For it the compiler takes a multiplication and an addition, of a cycle each, in the place of the two in one, which
/// takes three; both round twice, and give the same bits.
const CORE: &str = "-Ctarget-cpu=cortex-m4";

/// Time after which the emulator is stopped \[s\]; a run takes about one.
const BENCH_LIMIT_S: u32 = 60;

fn image_path(binary: &str) -> PathBuf {
    root()
        .join("firmware/target")
        .join(TARGET)
        .join("release")
        .join(binary)
}

/// Builds one board's image, saying nothing when it is fresh.
fn build(toolchain: &Toolchain, board: &Board) -> Result<()> {
    // Paths of this machine would end up in panic messages: sizes and epitaphs would differ between
    // machines.
    let remap = |from: PathBuf, to: &str| format!("--remap-path-prefix={}={to}", from.display());
    let flags = [
        remap(cargo_home(), "cargo"),
        remap(root(), "sutura"),
        CORE.to_owned(),
    ];
    let flags = flags.join(" ");
    // Cargo looks for `.cargo/config.toml` from the working folder on, not from the manifest.
    let cargo = |words: &str| {
        let tool = toolchain.cargo(&format!("build --release --locked --quiet {words}"));
        tool.arg("--target-dir")
            .arg(root().join("firmware/target"))
            .env("RUSTFLAGS", &flags)
            .within("firmware")
            .run()
            .with_context(|| format!("the image for {} does not build", board.name()))
    };
    let name = board.name();
    cargo(&format!("--features {name}"))?;
    if !board.motors {
        return made_of::write(&image_path(&format!("sutura-{name}")));
    }
    keep("sutura-console", &format!("sutura-{name}"))?;
    keep("sutura-selftest", &format!("sutura-selftest-{name}"))?;
    // Never beside the others: with that feature they are other images.
    cargo(&format!("--features {name},mutants --bin sutura-mutants"))?;
    keep("sutura-mutants", &format!("sutura-mutants-{name}"))
}

/// Puts an image under a board's name, before the next board's takes its place, with what it was made of.
fn keep(built: &str, name: &str) -> Result<()> {
    let (built, image) = (image_path(built), image_path(name));
    for (from, to) in [
        (built.clone(), image.clone()),
        (built.with_extension("d"), image.with_extension("d")),
    ] {
        std::fs::copy(&from, &to).with_context(|| format!("cannot copy {}", from.display()))?;
    }
    made_of::write(&image)
}

/// Where cargo keeps the sources of dependencies.
fn cargo_home() -> PathBuf {
    let home = std::env::var_os("CARGO_HOME").map(PathBuf::from);
    home.or_else(|| std::env::home_dir().map(|home| home.join(".cargo")))
        .unwrap_or_default()
}

/// `cargo xtask firmware --board NAME`.
pub fn build_one(board: &Board, format: Format) -> Result<()> {
    build(&Toolchain::ensure()?, board)?;
    if format == Format::Json {
        let image = image_path(&format!("sutura-{}", board.name()));
        println!(
            "{}",
            serde_json::json!({ "board": board.name(), "image": image })
        );
    }
    Ok(())
}

/// What `--format json` prints.
#[derive(Serialize)]
struct Summary {
    rustc: String,
    boards: BTreeMap<String, Image>,
    instructions: BTreeMap<String, u64>,
    cycles: BTreeMap<String, Estimate>,
    gates: Vec<Gate>,
    status: &'static str,
}

/// `cargo xtask firmware`: all boards, all figures, all gates.
pub fn gated(bless: bool, format: Format) -> Result<()> {
    let toolchain = Toolchain::ensure()?;
    setup::qemu()?;
    let rustc = toolchain.version()?;
    let mut boards = BTreeMap::new();
    let mut snapshots = Vec::new();
    for board in &Board::all()? {
        eprintln!(
            "building the image for {} with {}",
            board.name(),
            toolchain.describe()
        );
        build(&toolchain, board)?;
        let image = image::read(&image_path(&format!("sutura-{}", board.name())))?;
        let sizes = [
            ("text", image.text),
            ("data", image.data),
            ("bss", image.bss),
        ];
        let snapshot = Snapshot {
            rustc: rustc.clone(),
            figures: sizes
                .into_iter()
                .map(|(name, size)| (name.to_owned(), size))
                .collect(),
            panic_symbols: image.panic_symbols.clone(),
            ..Snapshot::default()
        };
        snapshots.push((board.name.clone(), snapshot));
        boards.insert(board.name.clone(), image);
    }
    let instructions = count_instructions()?;
    let figures = instructions.clone();
    snapshots.push((
        "instructions".to_owned(),
        Snapshot {
            rustc: rustc.clone(),
            figures,
            ..Snapshot::default()
        },
    ));

    let mut gates = Vec::new();
    for (name, snapshot) in &snapshots {
        if bless {
            FIRMWARE.save(name, snapshot)?;
        }
        gates.extend(FIRMWARE.compare(name, &FIRMWARE.load(name)?, snapshot));
    }
    for name in ["contact_swap", "contact_take", "state_swap", "state_take"] {
        gates.push(gates::limit(
            name,
            instructions.get(name).copied(),
            LOCK_LIMIT,
        ));
    }
    for (name, limit) in TICK_LIMITS {
        gates.push(gates::limit(name, instructions.get(name).copied(), limit));
    }
    let cycles = cycles::all()?;
    for (name, estimate) in &cycles {
        let title = format!("{name} in cycles");
        gates.push(gates::limit(&title, Some(estimate.cycles), CYCLE_LIMIT));
        // The followed count is that of the run: to a percent and some blocks that an interrupt or a page cuts.
        let counted = instructions.get(name).copied().unwrap_or(0);
        let apart = counted.abs_diff(estimate.instructions);
        let title = format!("{name} followed");
        gates.push(gates::limit(&title, Some(apart), counted / 100 + 120));
    }
    for (board, image) in &boards {
        let way = image.panic_in_control.join(" calls ");
        let (outcome, found) = if way.is_empty() {
            (Outcome::Ok, "no direct calls lead to a panic".to_owned())
        } else {
            (Outcome::Failed, way)
        };
        gates.push(Gate {
            name: format!("{board} control task"),
            outcome,
            found,
        });
    }
    gates.extend(fault_paths());
    let failed = gates
        .iter()
        .filter(|gate| gate.outcome == Outcome::Failed)
        .count();
    let status = if failed == 0 { "ok" } else { "failed" };
    let summary = Summary {
        rustc,
        boards,
        instructions,
        cycles,
        gates,
        status,
    };
    match format {
        Format::Json => println!("{}", serde_json::to_string(&summary)?),
        Format::Text => print_text(&summary),
    }
    if failed > 0 {
        bail!(
            "{failed} firmware gates failed; if larger figures are meant, run `cargo xtask firmware --bless`"
        );
    }
    Ok(())
}

fn print_text(summary: &Summary) {
    println!("{:<16} {:>9} {:>9} {:>9}", "image", "text", "data", "bss");
    for (board, image) in &summary.boards {
        println!(
            "{board:<16} {:>9} {:>9} {:>9}  bytes",
            image.text, image.data, image.bss
        );
    }
    println!();
    for (name, count) in &summary.instructions {
        let cycles = summary.cycles.get(name).map_or_else(String::new, |one| {
            let (flash, branches) = (one.flash, one.branches);
            format!(
                ", about {} cycles: {flash} of them wait for flash, {branches} for branches",
                one.cycles
            )
        });
        println!("{name:<40} {count:>9}  instructions{cycles}");
    }
    println!();
    gates::print(&summary.gates);
}

/// One line of the bench image.
#[derive(Deserialize)]
struct Count {
    name: String,
    instructions: u64,
}

/// QEMU with the bench image, where every instruction takes 8 ns of virtual time; `words` are its command line.
fn bench(words: &[&str]) -> Tool {
    let mut config = "enable=on,target=native,arg=bench".to_owned();
    for word in words {
        config.push_str(",arg=");
        config.push_str(word);
    }
    Tool::new(&format!(
        "timeout {BENCH_LIMIT_S} {QEMU} -M netduinoplus2 -nographic -icount shift=3,sleep=off -semihosting-config"
    ))
    .arg(config)
    .arg("-kernel")
    .arg(image_path("sutura-bench"))
}

/// Instruction counts, by name.
fn count_instructions() -> Result<BTreeMap<String, u64>> {
    eprintln!("counting instructions under QEMU");
    let tool = bench(&[]);
    let again = tool.shown();
    let output = tool.output().context("the bench image failed under QEMU")?;
    let mut counts = BTreeMap::new();
    for line in output.lines().filter(|line| line.starts_with('{')) {
        let count: Count = serde_json::from_str(line)
            .with_context(|| format!("the bench image printed `{line}`"))?;
        counts.insert(count.name, count.instructions);
    }
    if counts.is_empty() {
        bail!("the bench image printed nothing; run it: {again}");
    }
    Ok(counts)
}

/// Lets the image go wrong in each way and reads what its fault handler says.
fn fault_paths() -> Vec<Gate> {
    eprintln!("going through the fault handlers under QEMU");
    // Kinds of `Report::epitaph_kind`. An overflown stack is a hard fault.
    [("panic", 1), ("overflow", 2), ("exception", 3)]
        .into_iter()
        .map(|(crash, kind)| {
            // The handler ends the emulator with an exit code, which makes this an error.
            let said = match bench(&["crash", crash]).output() {
                Ok(_) => "it went on".to_owned(),
                Err(error) => error.to_string(),
            };
            let reached = said.contains(&format!("fault {kind} at 0x"));
            let found = if reached {
                format!("crash_record {kind}")
            } else {
                said
            };
            let outcome = if reached {
                Outcome::Ok
            } else {
                Outcome::Failed
            };
            Gate {
                name: format!("fault path {crash}"),
                outcome,
                found,
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boards_are_the_features_with_motors_and_the_simulated_one() {
        let text = "[features]\nb = [\"motors\", \"hal/b\"]\nvirtual = []\nmotors = []\na = [\"motors\"]\n";
        let manifest: Manifest = toml::from_str(text).expect("a manifest");
        let names: Vec<_> = with_motors(&manifest)
            .into_iter()
            .map(|board| board.name)
            .collect();
        assert_eq!(names, ["a", "b"]);
        let all = Board::all().expect("the firmware's manifest");
        assert!(all.len() > 1 && all.contains(&Board::simulated()));
        let error = Board::of_name("no-such-board").expect_err("there is none");
        assert!(error.to_string().contains("virtual"), "{error}");
    }
}
