//! `cargo xtask setup`: what the checks need and a fresh machine lacks. Entry point: [`all`].

use crate::aarch64;
use crate::locks;
use crate::mesher;
use crate::run::Tool;
use crate::toolchain::{Toolchain, apt_install_missing};
use anyhow::{Context, Result};

/// The emulator's program.
pub const QEMU: &str = "qemu-system-arm";

/// What counts the solver's instructions.
pub const VALGRIND: &str = "valgrind";

/// What starts the counting; of the same version as the crate `gungraun` in Cargo.lock.
const RUNNER: &str = "gungraun-runner";

/// Installs what is missing and says what is used; with `full` what the long tests need, too.
pub fn all(full: bool) -> Result<()> {
    let toolchain = Toolchain::ensure()?;
    eprintln!(
        "compiler for the chip: {}, {}",
        toolchain.describe(),
        toolchain.version()?
    );
    rustup_components()?;
    qemu()?;
    browser()?;
    instruction_counter()?;
    if full {
        mesher::ensure()?;
        aarch64::ensure()?;
    }
    cargo_command("deny", "dependency checks")?;
    cargo_command("nextest", "test runner")
}

/// Valgrind, and the runner of the instruction counts.
pub fn instruction_counter() -> Result<()> {
    // Without the debug symbols of the C library valgrind cannot redirect its calls.
    apt_install_missing(&[(VALGRIND, VALGRIND), (VALGRIND, "libc6-dbg")])
        .context("valgrind is missing")?;
    let wanted = locks::version("gungraun")?;
    let version = || Tool::new(RUNNER).arg("--version").output();
    let is_right = |text: &String| text.trim().ends_with(&format!(" {wanted}"));
    if !version().is_ok_and(|text| is_right(&text)) {
        let install = format!("cargo install {RUNNER} --debug --locked --version ={wanted}");
        eprintln!("installing {RUNNER} from source, which takes minutes: {install}");
        Tool::new(&install)
            .run()
            .with_context(|| format!("{RUNNER} is missing"))?;
    }
    let valgrind = Tool::new(VALGRIND).arg("--version").output()?;
    eprintln!(
        "instruction counts: {}, {}",
        valgrind.trim(),
        version()?.trim()
    );
    Ok(())
}

/// Formatter and lints, which minimal toolchains lack.
fn rustup_components() -> Result<()> {
    for (component, words) in [
        ("rustfmt", "cargo fmt --version"),
        ("clippy", "cargo clippy --version"),
    ] {
        if Tool::new(words).output().is_err() {
            Tool::new("rustup component add").arg(component).run()?;
        }
    }
    Ok(())
}

/// The emulator.
pub fn qemu() -> Result<()> {
    apt_install_missing(&[(QEMU, QEMU)]).context("QEMU is missing")?;
    let version = Tool::new(QEMU).arg("--version").output()?;
    eprintln!("emulator: {}", version.lines().next().unwrap_or_default());
    Ok(())
}

/// What the live page is tested in, and with.
fn browser() -> Result<()> {
    const BROWSER: &str = "chromium";
    apt_install_missing(&[("node", "nodejs"), ("npm", "npm"), (BROWSER, BROWSER)])
        .context("the page's tests need a browser and node")?;
    Tool::new("npm ci --ignore-scripts --no-audit --no-fund --silent --prefix tests/browser")
        .run()
        .context("the packages of the page's tests are missing")?;
    let version = Tool::new(BROWSER).arg("--version").output()?;
    eprintln!("browser: {}", version.trim());
    Ok(())
}

/// Subcommands of cargo, from source.
fn cargo_command(name: &str, what: &str) -> Result<()> {
    let version = || Tool::new(&format!("cargo {name} --version")).output();
    if version().is_err() {
        let install = format!("cargo install cargo-{name} --debug --locked");
        eprintln!("installing cargo-{name} from source, which takes minutes: {install}");
        Tool::new(&install)
            .run()
            .with_context(|| format!("cargo-{name} is missing"))?;
    }
    let version = version()?;
    let line = version.lines().next().unwrap_or_default();
    eprintln!("{what}: {line}");
    Ok(())
}

/// Whether the runner that times every test can be started.
pub fn has_test_runner() -> bool {
    Tool::new("cargo nextest --version").output().is_ok()
}
