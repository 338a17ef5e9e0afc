//! Files that are there completely or not at all.
//!
//! Entry point: [`write_whole`]: a new file next to the target, flushed to the disk, then renamed.

use std::fs::{self, OpenOptions};
use std::io::{self, Write};
use std::path::Path;

/// Writes `bytes` to `path`; a reader, or a crash at any moment, finds the old file or the new one.
///
/// # Errors
/// What the system says: no such directory, no permission, a full disk. The old file stays.
pub fn write_whole(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let name = path
        .file_name()
        .ok_or_else(|| io::Error::other("the path has no file name"))?;
    let mut fresh_name = name.to_owned();
    // The process id keeps two programs that write the same file out of each other's way.
    fresh_name.push(format!(".{}.partial", std::process::id()));
    let fresh = path.with_file_name(fresh_name);
    let written = write_fresh(&fresh, bytes).and_then(|()| fs::rename(&fresh, path));
    if written.is_err() {
        // The first error is the one to tell; a file that was never made cannot be removed.
        let _ = fs::remove_file(&fresh);
    }
    written
}

fn write_fresh(fresh: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut file = OpenOptions::new()
        .write(true)
        .create(true)
        .truncate(true)
        .open(fresh)?;
    file.write_all(bytes)?;
    file.sync_all()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entries(directory: &Path) -> Vec<String> {
        let list = fs::read_dir(directory).expect("the directory is there");
        let name = |e: io::Result<fs::DirEntry>| {
            e.expect("an entry")
                .file_name()
                .to_string_lossy()
                .into_owned()
        };
        list.map(name).collect()
    }

    #[test]
    fn an_old_file_is_replaced_and_nothing_else_is_left() {
        let directory = tempfile::tempdir().expect("a directory");
        let path = directory.path().join("field.json");
        write_whole(&path, b"old and longer").expect("first write");
        write_whole(&path, b"new").expect("second write");
        assert_eq!(fs::read(&path).expect("readable"), b"new");
        assert_eq!(entries(directory.path()), ["field.json"]);
    }

    /// A directory in the target's place makes the rename fail after the data was written.
    #[test]
    fn a_failed_write_leaves_no_partial_file() {
        let directory = tempfile::tempdir().expect("a directory");
        let path = directory.path().join("taken");
        fs::create_dir(&path).expect("a directory");
        assert!(write_whole(&path, b"x").is_err());
        assert_eq!(entries(directory.path()), ["taken"]);
    }
}
