//! `cargo xtask aarch64`: the command for Linux on 64-bit ARM, run under an emulator and compared with this machine's.
//! Entry points: [`all`], and [`compare`] once the workspace's tests are built.
//!
//! The console's ticks are the same to the bit: a recording of one replays on the other. The solver's steps are not, as its kernels go
//! by the processor's instructions: their wrenches agree to [`TOLERANCE`].

use crate::run::{Tool, target};
use crate::toolchain::{add_target, apt_install_missing};
use anyhow::{Context, Result, bail, ensure};
use serde_json::Value;
use std::path::Path;

/// As rustc calls it.
const TARGET: &str = "aarch64-unknown-linux-gnu";
/// What links for it, and the emulator of its programs.
const LINKER: &str = "aarch64-linux-gnu-gcc";
const EMULATOR: &str = "qemu-aarch64";
/// Where the emulated program finds its libraries.
const SYSROOT: &str = "/usr/aarch64-linux-gnu";
/// A session with a press, a tick at a time.
const SESSION: &str = "run scenes/palpation.toml --lockstep --seconds 1";
/// Force that it has at least \[N\].
const LEAST_N: f64 = 0.3;
/// Largest difference of an entry of a wrench between two processors' solvers, over the largest.
const TOLERANCE: f64 = 1e-6;

/// Installs what is missing.
///
/// # Errors
/// If it cannot be installed.
pub fn ensure() -> Result<()> {
    if !add_target(TARGET) {
        bail!("there is no Rust for {TARGET}: run `rustup target add {TARGET}` while online");
    }
    apt_install_missing(&[
        (LINKER, "gcc-aarch64-linux-gnu"),
        (LINKER, "libc6-dev-arm64-cross"),
        (EMULATOR, "qemu-user"),
    ])
    .context("64-bit ARM needs a linker and an emulator")?;
    let version = Tool::new(EMULATOR).arg("--version").output()?;
    eprintln!("64-bit ARM: {}", version.lines().next().unwrap_or_default());
    Ok(())
}

/// Builds this machine's command, and compares.
///
/// # Errors
/// As of [`compare`].
pub fn all() -> Result<()> {
    ensure()?;
    Tool::new("cargo build --locked -p sutura").run()?;
    compare()
}

/// Builds the command for it, without what is optional, and compares sessions.
///
/// # Errors
/// If it cannot be built or run, or its console has other bits.
pub fn compare() -> Result<()> {
    let build =
        Tool::new("cargo build --locked -p sutura --no-default-features --target").arg(TARGET);
    build
        .env("CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_LINKER", LINKER)
        .run()?;
    let folder = target()?;
    let [here, there] = ["debug/sutura".to_owned(), format!("{TARGET}/debug/sutura")]
        .map(|program| folder.join(program));
    let native = |words: &str| answer(Tool::new(&format!("{} {words}", here.display())));
    let emulated = |words: &str| {
        let words = format!("{EMULATOR} -L {SYSROOT} {} {words}", there.display());
        answer(Tool::new(&words))
    };
    let recording = folder.join("aarch64.mcap");
    for (one, other, way) in [
        (
            &native as &dyn Fn(&str) -> Result<Value>,
            &emulated as _,
            "replayed there",
        ),
        (&emulated as _, &native as _, "recorded there"),
    ] {
        replay(&recording, one, other).context(way)?;
    }
    Ok(std::fs::remove_file(&recording)?)
}

/// Records a session by one, replays it by the other, and compares.
fn replay(
    recording: &Path,
    one: &dyn Fn(&str) -> Result<Value>,
    other: &dyn Fn(&str) -> Result<Value>,
) -> Result<()> {
    let file = recording.display();
    let recorded = one(&format!("{SESSION} --overwrite --record {file}"))?;
    let [own, replayed] = [one, other].map(|by| by(&format!("replay {file}")));
    let (own, replayed) = (own?, replayed?);
    let (console, host) = (&replayed["console"], &replayed["host"]);
    let hash = &own["console"]["hash"];
    ensure!(
        console["diverged_at"].is_null() && hash.is_string() && console["hash"] == *hash,
        "the console's ticks differ from those of {hash}: {console}"
    );
    let (felt, off) = (&recorded["force_n"]["peak"], &host["largest_difference"]);
    ensure!(
        felt.as_f64() > Some(LEAST_N) && off.as_f64() <= Some(TOLERANCE),
        "a peak of {felt} N, and wrenches that differ by {off}: {host}"
    );
    eprintln!(
        "{} ticks with the same bits, trace {}; wrenches of {} solves within {off}",
        console["verified_ticks"], console["hash"], host["verified_steps"]
    );
    Ok(())
}

fn answer(tool: Tool) -> Result<Value> {
    let text = tool.arg("--format").arg("json").output()?;
    serde_json::from_str(&text).with_context(|| format!("no object: {text}"))
}
