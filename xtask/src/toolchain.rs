//! A compiler for the chip: the rustup toolchain's own target, or Debian's compiler with the core library
//! built from source. Entry point: [`Toolchain::ensure`].

use crate::run::{Tool, is_there};
use anyhow::{Context, Result, bail};
use std::path::{Path, PathBuf};

/// The chip's target.
pub const TARGET: &str = "thumbv7em-none-eabihf";

/// How the firmware is compiled.
#[derive(Debug, PartialEq, Eq)]
pub enum Toolchain {
    /// The default compiler has the target.
    Target,
    /// Debian's `rustc-web` and `rust-web-src`, with the linker of the default toolchain.
    BuildStd {
        /// The default toolchain's `rust-lld`.
        linker: PathBuf,
    },
}

const DEBIAN_RUSTC: &str = "/usr/bin/rustc";

impl Toolchain {
    /// Finds a compiler for the chip, installing one if need be; says so only if it had to.
    pub fn ensure() -> Result<Self> {
        if add_target(TARGET) {
            return Ok(Self::Target);
        }
        eprintln!(
            "rustup could not; trying Debian's rustc-web with the core library built from source"
        );
        Self::debian().with_context(|| {
            format!(
                "there is no compiler for {TARGET}: run `rustup target add {TARGET}` while online, or on \
                 Debian `apt-get install rustc-web rust-web-src`"
            )
        })
    }

    fn debian() -> Result<Self> {
        if !debian_is_there() {
            apt_install(&["rustc-web", "rust-web-src"])?;
        }
        if !debian_is_there() {
            bail!("{DEBIAN_RUSTC} has no sources of the core library");
        }
        let sysroot = Tool::new("rustc --print sysroot").output()?;
        let linker = Path::new(sysroot.trim())
            .join("lib/rustlib")
            .join(host()?)
            .join("bin/rust-lld");
        if !linker.is_file() {
            bail!(
                "the default toolchain has no linker at {}",
                linker.display()
            );
        }
        Ok(Self::BuildStd { linker })
    }

    /// The compiler's version, as in the snapshots.
    pub fn version(&self) -> Result<String> {
        let rustc = match self {
            Self::Target => "rustc",
            Self::BuildStd { .. } => DEBIAN_RUSTC,
        };
        Ok(Tool::new(rustc)
            .arg("--version")
            .output()?
            .trim()
            .to_owned())
    }

    /// One line for people.
    pub fn describe(&self) -> String {
        match self {
            Self::Target => format!("rustup's {TARGET}"),
            Self::BuildStd { .. } => format!("Debian's {DEBIAN_RUSTC} with -Zbuild-std=core"),
        }
    }

    /// A cargo command for the firmware: `words` come after `cargo`.
    pub fn cargo(&self, words: &str) -> Tool {
        match self {
            Self::Target => Tool::new(&format!("cargo {words}")),
            Self::BuildStd { linker } => Tool::new(&format!("cargo -Zbuild-std=core {words}"))
                .env("RUSTC", DEBIAN_RUSTC)
                .env("RUSTC_BOOTSTRAP", "1")
                .env("CARGO_TARGET_THUMBV7EM_NONE_EABIHF_LINKER", linker),
        }
    }
}

/// The build machine's target.
pub fn host() -> Result<String> {
    let version = Tool::new("rustc -vV").output()?;
    let host = version.lines().find_map(|line| line.strip_prefix("host: "));
    Ok(host.context("`rustc -vV` names no host")?.to_owned())
}

/// Has rustup install a target if it is not there; whether it is there now.
pub fn add_target(target: &str) -> bool {
    if has_target(target) {
        return true;
    }
    eprintln!("installing the Rust target {target}: rustup target add {target}");
    let added = Tool::new("rustup target add").arg(target).run();
    added.is_ok() && has_target(target)
}

fn has_target(target: &str) -> bool {
    let libdir = Tool::new("rustc --print target-libdir --target")
        .arg(target)
        .output();
    let Ok(entries) = libdir.and_then(|path| Ok(std::fs::read_dir(path.trim())?)) else {
        return false;
    };
    entries
        .flatten()
        .any(|entry| entry.file_name().to_string_lossy().starts_with("libcore-"))
}

fn debian_is_there() -> bool {
    let sysroot = Tool::new(DEBIAN_RUSTC)
        .arg("--print")
        .arg("sysroot")
        .output();
    sysroot.is_ok_and(|path| {
        Path::new(path.trim())
            .join("lib/rustlib/src/rust/library/core/Cargo.toml")
            .is_file()
    })
}

/// Installs the Debian packages of those programs that are not there.
///
/// # Errors
/// As of [`apt_install`].
pub fn apt_install_missing(programs: &[(&str, &str)]) -> Result<()> {
    let missing = programs.iter().filter(|(program, _)| !is_there(program));
    let packages: Vec<_> = missing.map(|(_, package)| *package).collect();
    match packages.is_empty() {
        true => Ok(()),
        false => apt_install(&packages),
    }
}

/// Installs Debian packages, as root or through sudo, or says how to.
pub fn apt_install(packages: &[&str]) -> Result<()> {
    let wanted = packages.join(" ");
    let root = Tool::new("id -u").output().is_ok_and(|id| id.trim() == "0");
    let sudo = if root {
        ""
    } else if Tool::new("sudo -n true").output().is_ok() {
        "sudo -n "
    } else {
        bail!("not root: run `sudo apt-get install {wanted}`, then this command again");
    };
    if !is_there("apt-get") {
        bail!("no apt-get here: install {wanted} with this system's package manager");
    }
    let env = "env DEBIAN_FRONTEND=noninteractive";
    let install = format!("{sudo}{env} apt-get install --yes --no-install-recommends {wanted}");
    eprintln!("installing {wanted}: {install}");
    // The package lists may be missing or stale: refresh them only if a first attempt fails.
    if Tool::new(&install).run().is_ok() {
        return Ok(());
    }
    Tool::new(&format!("{sudo}{env} apt-get update")).run()?;
    Tool::new(&install)
        .run()
        .with_context(|| format!("could not install {wanted}"))
}
