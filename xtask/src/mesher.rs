//! gmsh, and what makes a surface out of a label volume: in an environment of their own under the target folder, for the long
//! tests alone. Entry points: [`ensure`], [`on_path`].

use crate::python;
use crate::run::{Tool, target};
use crate::toolchain::apt_install;
use anyhow::{Context, Result};
use std::ffi::OsString;
use std::path::PathBuf;

/// As `pip` names them.
const PACKAGES: [&str; 3] = ["gmsh", "numpy", "scikit-image"];
/// What the program of the package wants of the system.
const LIBRARIES: [&str; 4] = ["libglu1-mesa", "libxcursor1", "libxft2", "libxinerama1"];

/// Installs what is missing and says what is used.
///
/// # Errors
/// If it cannot be installed, or does not start then.
pub fn ensure() -> Result<()> {
    let python = python::environment(&folder()?, false)?;
    let version = || {
        let gmsh = Tool::new("gmsh --version").env("PATH", on_path()?);
        gmsh.output()
    };
    // Installed once: without a network, too, they are there at the next run.
    let has = Tool::new(&format!("{} -c", python.display())).arg("import numpy, skimage");
    if has.output().is_err() || version().is_err() {
        let install = Tool::new(&python::pip(&python));
        let install = PACKAGES.iter().fold(install, |tool, name| tool.arg(name));
        install.run().context("gmsh is missing")?;
    }
    if version().is_err() {
        apt_install(&LIBRARIES).context("gmsh does not start")?;
    }
    eprintln!("mesher: gmsh {}", version()?.trim());
    Ok(())
}

/// `PATH` with its programs before all others.
///
/// # Errors
/// If nobody knows where cargo builds.
pub fn on_path() -> Result<OsString> {
    let programs = folder()?.join(if cfg!(windows) { "Scripts" } else { "bin" });
    let path = std::env::var_os("PATH").unwrap_or_default();
    let folders = std::iter::once(programs).chain(std::env::split_paths(&path));
    Ok(std::env::join_paths(folders)?)
}

fn folder() -> Result<PathBuf> {
    Ok(target()?.join("mesher"))
}
