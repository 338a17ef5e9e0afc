//! Files that users name: which are read, and which are never written over.
//!
//! Entry points: [`read_plain`], [`is_same`], [`write_whole`].

mod whole;

pub use whole::write_whole;

use std::fs::{File, FileType};
use std::io::{self, ErrorKind, Read};
use std::path::Path;

/// Largest text that people write, such as a scene or a device \[bytes\].
pub const MOST_TEXT: u64 = 64 << 20;

/// Reads a plain file of at most `most` bytes. Links are followed.
///
/// A pipe may never end, and a device may have effects: neither is opened.
///
/// # Errors
/// The system's, and [`ErrorKind::InvalidInput`] for a file of another kind or a larger one.
pub fn read_plain(path: &Path, most: u64) -> io::Result<Vec<u8>> {
    let found = std::fs::metadata(path)?;
    if !found.is_file() {
        let kind = kind(found.file_type());
        return Err(refused(format!(
            "it is {kind}, and only plain files are read"
        )));
    }
    let too_large = |bytes: u64| {
        refused(format!(
            "it has {bytes} bytes, and at most {most} are read of such a file"
        ))
    };
    if found.len() > most {
        return Err(too_large(found.len()));
    }
    let mut bytes = Vec::new();
    let room = usize::try_from(found.len()).unwrap_or(usize::MAX);
    bytes.try_reserve_exact(room).map_err(|_| {
        let message = format!("there is no memory for its {} bytes", found.len());
        io::Error::new(ErrorKind::OutOfMemory, message)
    })?;
    // It may grow meanwhile.
    let mut file = File::open(path)?.take(most.saturating_add(1));
    file.read_to_end(&mut bytes)?;
    match bytes.len() as u64 {
        length if length > most => Err(too_large(length)),
        _ => Ok(bytes),
    }
}

fn refused(why: String) -> io::Error {
    io::Error::new(ErrorKind::InvalidInput, why)
}

/// Names a kind of file that is not plain.
fn kind(of: FileType) -> &'static str {
    #[cfg(unix)]
    {
        use std::os::unix::fs::FileTypeExt as _;
        if of.is_fifo() {
            return "a pipe";
        }
        if of.is_socket() {
            return "a socket";
        }
        if of.is_char_device() || of.is_block_device() {
            return "a device";
        }
    }
    match of.is_dir() {
        true => "a folder",
        false => "no plain file",
    }
}

/// Whether two paths lead to one file, by whatever names and links.
pub fn is_same(one: &Path, other: &Path) -> bool {
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt as _;
        let place = |path: &Path| {
            let found = std::fs::metadata(path).ok()?;
            Some((found.dev(), found.ino()))
        };
        place(one).is_some_and(|found| Some(found) == place(other))
    }
    #[cfg(not(unix))]
    {
        let place = |path: &Path| path.canonicalize().ok();
        place(one).is_some_and(|found| Some(found) == place(other))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refusal(path: &Path, most: u64) -> String {
        let error = read_plain(path, most).expect_err("a file that is not read");
        assert_eq!(error.kind(), ErrorKind::InvalidInput, "{error}");
        error.to_string()
    }

    #[test]
    fn plain_files_are_read_up_to_their_largest_size() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("a");
        std::fs::write(&path, b"12345").expect("written");
        assert_eq!(read_plain(&path, 5).expect("read"), b"12345");
        let said = refusal(&path, 4);
        assert!(
            said.contains("5 bytes") && said.contains("at most 4"),
            "{said}"
        );
        assert!(refusal(folder.path(), 4).contains("a folder"));
        let none = read_plain(&folder.path().join("b"), 5).expect_err("none");
        assert_eq!(none.kind(), ErrorKind::NotFound);
        // A hole of a terabyte is as long as it says.
        let sparse = File::create(folder.path().join("sparse")).expect("created");
        if sparse.set_len(1 << 40).is_ok() {
            assert!(refusal(&folder.path().join("sparse"), 1 << 30).contains("1099511627776"));
        }
    }

    #[cfg(unix)]
    #[test]
    fn pipes_and_devices_are_named_and_not_opened() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("link");
        std::os::unix::fs::symlink("/dev/zero", &path).expect("a link");
        assert!(refusal(&path, 1 << 30).contains("a device"));
        let pipe = folder.path().join("pipe");
        let made = std::process::Command::new("mkfifo").arg(&pipe).status();
        assert!(made.expect("mkfifo").success());
        assert!(refusal(&pipe, 1 << 30).contains("a pipe"));
    }

    #[test]
    fn one_file_is_the_same_by_all_its_names() {
        let folder = tempfile::tempdir().expect("a folder");
        let [a, b] = ["a", "b"].map(|name| folder.path().join(name));
        std::fs::write(&a, b"1").expect("written");
        assert!(!is_same(&a, &b), "a file that is not there");
        std::fs::write(&b, b"1").expect("written");
        assert!(!is_same(&a, &b));
        assert!(is_same(&a, &folder.path().join(".").join("a")));
        std::fs::remove_file(&b).expect("removed");
        std::fs::hard_link(&a, &b).expect("a hard link");
        assert!(is_same(&a, &b));
        #[cfg(unix)]
        {
            let c = folder.path().join("c");
            std::os::unix::fs::symlink("a", &c).expect("a link");
            assert!(is_same(&c, &b));
        }
    }
}
