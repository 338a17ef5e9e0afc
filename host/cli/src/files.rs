//! Files and folders that commands write: what is there is kept, unless the user says otherwise, and what is read in any case.
//!
//! Entry points: [`free`], for a file, [`folder`] and [`apart`], all before the work begins; [`never_over`] and [`never_into`], once it is
//! known what is read; [`unwritable`], where the system refuses.

use crate::Global;
use crate::failure::{Cause, Failure};
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use sutura_files::{has_folder, is_same, lead_to_one, may_write, target};

/// Whether a file may be written: its folder is there, and it is not there itself, is empty, or `--overwrite` says so. A terminal or another such device is
/// written in any case.
///
/// # Errors
/// Bad input: it has something in it, or is a folder, a pipe or something else that is no file.
pub fn free(path: &Path, global: &Global) -> Result<(), Failure> {
    may_write(path)
        .and_then(|()| has_folder(path))
        .map_err(|error| unwritable(path, &error))?;
    if global.overwrite || !has_something(path) {
        return Ok(());
    }
    let message = format!("{} is there already", path.display());
    let help = "name another file, or write over it with --overwrite";
    Err(Failure::say(Cause::BadInput, message, help))
}

/// Whether there is a file with something in it, or a link that leads nowhere.
pub fn has_something(path: &Path) -> bool {
    match path.metadata() {
        Ok(found) => found.is_file() && found.len() > 0,
        Err(_) => path.is_symlink(),
    }
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

/// Whether no file that is read is one of those in a folder that would be written, by their names; and each of these may be.
///
/// # Errors
/// Bad input: one is.
pub fn never_into(
    folder: &Path,
    is_written: impl Fn(&str) -> bool,
    read: &[PathBuf],
) -> Result<(), Failure> {
    for file in within(folder, is_written) {
        may_write(&file).map_err(|error| unwritable(&file, &error))?;
        never_over(&file, read)?;
    }
    Ok(())
}

/// Files and links in a folder of which the names are chosen.
fn within(folder: &Path, is_chosen: impl Fn(&str) -> bool) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let chosen = entries.filter(|entry| entry.file_name().to_str().is_some_and(&is_chosen));
    chosen.map(|entry| entry.path()).collect()
}

/// An option that writes, with its path.
pub type Output<'a> = (&'static str, Option<&'a Path>);

/// Whether no two outputs are one file.
///
/// # Errors
/// Bad input: two are.
pub fn apart(outputs: &[Output<'_>]) -> Result<(), Failure> {
    let outputs: Vec<_> = outputs
        .iter()
        .filter_map(|(option, path)| Some((*option, (*path)?)))
        .collect();
    for (number, one) in outputs.iter().enumerate() {
        for other in &outputs[..number] {
            if lead_to_one(one.1, other.1) {
                return Err(both(*other, *one));
            }
        }
    }
    Ok(())
}

/// Whether no output is one of those files that `option` writes into a folder, by their names.
///
/// # Errors
/// Bad input: one is.
pub fn apart_from_those_in(
    (option, folder): (&'static str, &Path),
    is_written: impl Fn(&str) -> bool,
    outputs: &[Output<'_>],
) -> Result<(), Failure> {
    let place = target(folder);
    let there = within(folder, &is_written);
    for (other, path) in outputs {
        let Some(path) = *path else { continue };
        let target = target(path);
        let name = target.file_name().and_then(|name| name.to_str());
        let is_in = target.parent() == Some(&place) && name.is_some_and(&is_written);
        if is_in || there.iter().any(|file| lead_to_one(file, path)) {
            return Err(both((option, folder), (other, path)));
        }
    }
    Ok(())
}

fn both(one: (&str, &Path), other: (&str, &Path)) -> Failure {
    let message = format!(
        "{} {} and {} {} would write to one file",
        one.0,
        one.1.display(),
        other.0,
        other.1.display()
    );
    Failure::say(Cause::BadInput, message, "give each a file of its own")
}

/// Makes a folder for what `option` writes.
///
/// # Errors
/// Bad input: it has something in it, or cannot be made. A full disk is a failure.
pub fn folder(option: &str, path: &Path, global: &Global) -> Result<(), Failure> {
    // A pipe in it would wait for a reader.
    let is_writable = |entry: io::Result<std::fs::DirEntry>| {
        let path = entry?.path();
        match path.is_dir() {
            true => Ok(()),
            false => may_write(&path).map_err(|error| {
                io::Error::new(error.kind(), format!("{}: {error}", path.display()))
            }),
        }
    };
    let made = std::fs::create_dir_all(path)
        .and_then(|()| std::fs::read_dir(path)?.try_for_each(is_writable))
        .and_then(|()| std::fs::read_dir(path));
    let (cause, message) = match made.map(|mut entries| entries.next().is_none()) {
        Ok(is_empty) if is_empty || global.overwrite => return Ok(()),
        Ok(_) => (
            Cause::BadInput,
            format!("{option} {}: the folder is not empty", path.display()),
        ),
        Err(error) => (
            cause(error.kind()),
            format!("{option} {}: {error}", path.display()),
        ),
    };
    let help = "name a folder that is not there yet, in one that is yours; --overwrite writes over files in one that is";
    Err(Failure::say(cause, message, help))
}

/// The failure to write a file: bad input where another path helps, else this machine's own.
pub fn unwritable(path: &Path, error: &io::Error) -> Failure {
    let cause = cause(error.kind());
    let help = match cause {
        Cause::BadInput => "name a file in a folder that exists and is yours",
        _ => "make room on its disk, or name a file on another one",
    };
    let message = format!("cannot write {}: {error}", path.display());
    Failure::say(cause, message, help)
}

/// Bad input where another path helps, else this machine's own failure.
pub fn cause(kind: ErrorKind) -> Cause {
    match kind {
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
