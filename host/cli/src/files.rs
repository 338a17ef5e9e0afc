//! Files and folders that commands write: what is there is kept, unless the user says otherwise, and what is read in any case.
//!
//! Entry points: [`free`], for a file, and [`folder`], both before the work begins; [`never_over`], once it is known what is read;
//! [`unwritable`], where the system refuses.

use crate::Global;
use crate::failure::{Cause, Failure};
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use sutura_files::is_same;

/// Whether a file may be written: it is not there, is empty, or `--overwrite` says so. What is no file (a terminal, a pipe) is
/// written in any case.
///
/// # Errors
/// Bad input: it has something in it.
pub fn free(path: &Path, global: &Global) -> Result<(), Failure> {
    if global.overwrite || !has_something(path) {
        return Ok(());
    }
    let message = format!("{} is there already", path.display());
    let help = "name another file, or write over it with --overwrite";
    Err(Failure::say(Cause::BadInput, message, help))
}

/// Whether there is a file with something in it.
pub fn has_something(path: &Path) -> bool {
    let found = path.metadata();
    found.is_ok_and(|found| found.is_file() && found.len() > 0)
}

/// Whether `out` is none of the files that are read, by whatever name or link. `--overwrite` changes nothing of that.
///
/// # Errors
/// Bad input: it is one.
pub fn never_over(out: &Path, read: &[PathBuf]) -> Result<(), Failure> {
    let Some(file) = read.iter().find(|file| is_same(file, out)) else {
        return Ok(());
    };
    let same = match file == out {
        true => String::new(),
        false => format!(", the same file as {}", out.display()),
    };
    let message = format!(
        "{}{same}, is read here and would be written over itself",
        file.display()
    );
    let help = "name another file: --overwrite writes over nothing that is read";
    Err(Failure::say(Cause::BadInput, message, help))
}

/// Makes a folder for what `option` writes.
///
/// # Errors
/// Bad input: it has something in it, or cannot be made. A full disk is a failure.
pub fn folder(option: &str, path: &Path, global: &Global) -> Result<(), Failure> {
    let made = std::fs::create_dir_all(path).and_then(|()| std::fs::read_dir(path));
    let (cause, message) = match made.map(|mut entries| entries.next().is_none()) {
        Ok(is_empty) if is_empty || global.overwrite => return Ok(()),
        Ok(_) => (
            Cause::BadInput,
            format!("{option} {}: the folder is not empty", path.display()),
        ),
        Err(error) => (
            cause(&error),
            format!("{option} {}: {error}", path.display()),
        ),
    };
    let help = "name a folder that is not there yet, in one that is yours; --overwrite writes over files in one that is";
    Err(Failure::say(cause, message, help))
}

/// The failure to write a file: bad input where another path helps, else this machine's own.
pub fn unwritable(path: &Path, error: &io::Error) -> Failure {
    let cause = cause(error);
    let help = match cause {
        Cause::BadInput => "name a file in a folder that exists and is yours",
        _ => "make room on its disk, or name a file on another one",
    };
    let message = format!("cannot write {}: {error}", path.display());
    Failure::say(cause, message, help)
}

fn cause(error: &io::Error) -> Cause {
    match error.kind() {
        ErrorKind::NotFound
        | ErrorKind::PermissionDenied
        | ErrorKind::AlreadyExists
        | ErrorKind::NotADirectory
        | ErrorKind::IsADirectory
        | ErrorKind::ReadOnlyFilesystem
        | ErrorKind::InvalidInput
        | ErrorKind::InvalidFilename => Cause::BadInput,
        _ => Cause::Failed,
    }
}
