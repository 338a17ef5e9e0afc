//! Files that are there completely or not at all.
//!
//! Entry point: [`write_whole`]: a new file next to the target, flushed to the disk, then renamed.

use super::may_write;
use std::fs::{self, OpenOptions};
use std::io::{self, Write};
use std::path::Path;

/// Writes `bytes` to `path`; a reader, or a crash at any moment, finds the old file or the new one.
///
/// A link stays a link to what is replaced. A device that [may be written](may_write) is written itself.
///
/// # Errors
/// The same as [`may_write`]'s, and the system's: no such directory, no permission, a full disk. The old file stays.
pub fn write_whole(path: &Path, bytes: &[u8]) -> io::Result<()> {
    may_write(path)?;
    let target = path.canonicalize();
    let path = target.as_deref().unwrap_or(path);
    let is_special = |found: fs::Metadata| !found.is_file() && !found.is_dir();
    if path.metadata().is_ok_and(is_special) {
        return OpenOptions::new().write(true).open(path)?.write_all(bytes);
    }
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

    #[cfg(unix)]
    #[test]
    fn links_stay_and_devices_are_written_themselves() {
        let directory = tempfile::tempdir().expect("a directory");
        let [path, link] = ["field.json", "link.json"].map(|name| directory.path().join(name));
        fs::write(&path, b"old").expect("written");
        std::os::unix::fs::symlink("field.json", &link).expect("a link");
        write_whole(&link, b"new").expect("written");
        assert_eq!(fs::read(&path).expect("readable"), b"new");
        assert!(link.is_symlink());
        let full = directory.path().join("full.json");
        std::os::unix::fs::symlink("/dev/full", &full).expect("a link");
        if Path::new("/dev/full").exists() {
            let error = write_whole(&full, b"new").expect_err("a full disk");
            assert_eq!(error.kind(), io::ErrorKind::StorageFull);
            assert!(full.is_symlink());
        }
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
