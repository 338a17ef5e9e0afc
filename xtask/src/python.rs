//! `cargo xtask python`: the Python package's tests, in an environment of their own under the target folder. Entry points:
//! [`all`], [`test`] once the workspace's tests are built, and [`step_cost`], whose times no test depends on.

use crate::run::{Tool, root, target};
use anyhow::{Context, Result};
use std::env::consts::{DLL_PREFIX, DLL_SUFFIX};
use std::fs;
use std::path::{Path, PathBuf};

/// What the short tests need.
const SHORT: [&str; 2] = ["numpy", "pytest"];
/// The package with all that its long tests need, built and installed as anybody does.
const FULL: &str = "./python[test,full]";

/// Builds the library, and tests the package.
///
/// # Errors
/// If anything cannot be built or installed, or a test fails.
pub fn all(full: bool) -> Result<()> {
    if !full {
        Tool::new("cargo test --no-run --locked -p sutura-python").run()?;
    }
    test(full)
}

/// Tests the package: beside the library that the workspace's tests were built with; with `full` a release in a fresh
/// environment.
///
/// # Errors
/// As of [`all`].
pub fn test(full: bool) -> Result<()> {
    if full {
        let python = environment(&target()?.join("python/full"), true)?;
        Tool::new(&pip(&python)).arg(FULL).run()?;
        return pytest(&python).env("SUTURA_FULL", "1").run();
    }
    let (python, site) = short()?;
    pytest(&python).env("PYTHONPATH", &site).run()
}

/// Compares what a step costs from Python with the same from Rust, in pairs, on a slab and on the scene of palpation.
///
/// # Errors
/// If the library cannot be built, or one costs more than its bar.
pub fn step_cost() -> Result<()> {
    Tool::new("cargo test --no-run --locked -p sutura-python").run()?;
    let (python, site) = short()?;
    let cost = || {
        let script = format!("{} -B python/examples/step_cost.py", python.display());
        Tool::new(&script).env("PYTHONPATH", &site)
    };
    let slab = cost().run();
    cost().arg("scenes/palpation.toml").run().and(slab)
}

/// The short tests' Python, and where the package is laid out for it.
fn short() -> Result<(PathBuf, PathBuf)> {
    let folder = target()?.join("python");
    let python = environment(&folder.join("short"), false)?;
    // Installed once: without a network, too, they are there at the next run.
    let has = Tool::new(&format!("{} -c", python.display())).arg("import numpy, pytest");
    if has.output().is_err() {
        let install = Tool::new(&pip(&python));
        SHORT
            .iter()
            .fold(install, |tool, name| tool.arg(name))
            .run()?;
    }
    let site = folder.join("site");
    lay_out(&site)?;
    Ok((python, site))
}

/// A virtual environment in a folder, made anew with `fresh`; its Python.
///
/// # Errors
/// If there is no Python that makes one.
pub fn environment(folder: &Path, fresh: bool) -> Result<PathBuf> {
    let python = match cfg!(windows) {
        true => folder.join("Scripts/python.exe"),
        false => folder.join("bin/python"),
    };
    if fresh || !python.is_file() {
        let make = Tool::new("python3 -m venv --clear").arg(folder);
        make.run().context("Python 3.10 or later with its module venv is needed: on Debian `apt install python3-venv`")?;
    }
    Ok(python)
}

/// Its installer, without more words than it needs.
pub fn pip(python: &Path) -> String {
    format!(
        "{} -m pip install --quiet --disable-pip-version-check",
        python.display()
    )
}

fn pytest(python: &Path) -> Tool {
    // Nothing is left in the checkout.
    Tool::new(&format!(
        "{} -B -m pytest -p no:cacheprovider",
        python.display()
    ))
    .within("python")
}

/// The package as an installation has it: what is of Python, and the library beside it.
fn lay_out(site: &Path) -> Result<()> {
    let package = site.join("sutura");
    if package.exists() {
        fs::remove_dir_all(&package)?;
    }
    fs::create_dir_all(&package)?;
    for entry in fs::read_dir(root().join("python/package/sutura"))? {
        let path = entry?.path();
        if path.is_file() {
            fs::copy(&path, package.join(path.file_name().unwrap_or_default()))?;
        }
    }
    let library = target()?.join(format!("debug/deps/{DLL_PREFIX}_sutura{DLL_SUFFIX}"));
    let module = if cfg!(windows) {
        "_sutura.pyd"
    } else {
        "_sutura.abi3.so"
    };
    fs::copy(&library, package.join(module)).with_context(|| {
        format!(
            "there is no {}: `cargo xtask python` builds it",
            library.display()
        )
    })?;
    Ok(())
}
