//! Files and folders that commands write: what is there is kept, unless the user says otherwise.
//!
//! Entry points: [`free`], for a file, and [`folder`], both before the work begins.

use crate::Global;
use crate::failure::{Cause, Failure};
use std::path::Path;

/// Whether a file may be written: it is not there, is empty, or `--overwrite` says so. What is no file (a terminal, a pipe) is
/// written in any case.
///
/// # Errors
/// Bad input: it has something in it.
pub fn free(path: &Path, global: &Global) -> Result<(), Failure> {
    let has_something = path
        .metadata()
        .is_ok_and(|found| found.is_file() && found.len() > 0);
    if global.overwrite || !has_something {
        return Ok(());
    }
    let message = format!("{} is there already", path.display());
    let help = "name another file, or write over it with --overwrite";
    Err(Failure::say(Cause::BadInput, message, help))
}

/// Makes a folder for what `option` writes.
///
/// # Errors
/// Bad input: it has something in it, or cannot be made.
pub fn folder(option: &str, path: &Path, global: &Global) -> Result<(), Failure> {
    let made = std::fs::create_dir_all(path).and_then(|()| std::fs::read_dir(path));
    let message = match made.map(|mut entries| entries.next().is_none()) {
        Ok(is_empty) if is_empty || global.overwrite => return Ok(()),
        Ok(_) => format!("{option} {}: the folder is not empty", path.display()),
        Err(error) => format!("{option} {}: {error}", path.display()),
    };
    let help = "name a folder that is not there yet, in one that is yours; --overwrite writes over files in one that is";
    Err(Failure::say(Cause::BadInput, message, help))
}
