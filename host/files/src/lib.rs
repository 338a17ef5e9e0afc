//! Files that users name: which are read, which are written, and which are never written over.
//!
//! Entry points: [`read_plain`], [`may_write`], [`has_folder`], [`is_same`], [`lead_to_one`], [`write_whole`].

mod whole;

pub use whole::write_whole;

use std::fs::{File, FileType};
use std::io::{self, ErrorKind, Read};
use std::path::{Path, PathBuf, absolute};

/// Largest text that people write, such as a scene or a device \[bytes\].
pub const MOST_TEXT: u64 = 64 << 20;

/// Reads a plain file of at most `most` bytes. Links are followed.
///
/// A pipe may never end, and a device may have effects: neither is opened. Some files of the system say that they are empty, and
/// are not: nobody waits for what they give.
///
/// # Errors
/// The system's, and [`ErrorKind::InvalidInput`] for a file of another kind or a larger one.
pub fn read_plain(path: &Path, most: u64) -> io::Result<Vec<u8>> {
    let found = std::fs::metadata(path)?;
    if !found.is_file() {
        let (kind, step) = kind(found.file_type());
        return Err(refused(format!(
            "it is {kind}, and only plain files are read: {step}"
        )));
    }
    if found.len() == 0 {
        return match gives_nothing(path)? {
            true => Ok(Vec::new()),
            false => Err(refused(
                "it says that it is empty, and is not, as files of the system do: copy what is in it to a plain file, and name that"
                    .to_owned(),
            )),
        };
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

/// Whether a file that is said to be empty is. What has nothing at present but may have later is not.
fn gives_nothing(path: &Path) -> io::Result<bool> {
    let mut options = File::options();
    options.read(true);
    #[cfg(unix)]
    {
        use std::os::unix::fs::OpenOptionsExt as _;
        // The flag is a positive number on every system.
        options.custom_flags(rustix::fs::OFlags::NONBLOCK.bits().cast_signed());
    }
    match options.open(path)?.read(&mut [0]) {
        Ok(count) => Ok(count == 0),
        Err(error) if error.kind() == ErrorKind::WouldBlock => Ok(false),
        Err(error) => Err(error),
    }
}

/// Names a kind of file that is not plain, and says what the user can do in place of reading it.
fn kind(of: FileType) -> (&'static str, &'static str) {
    #[cfg(unix)]
    {
        use std::os::unix::fs::FileTypeExt as _;
        if of.is_fifo() {
            let step =
                "let the program that writes to it write a file (`COMMAND > FILE`), and name that";
            return ("a pipe", step);
        }
        if of.is_socket() {
            return ("a socket", "name a file");
        }
        if of.is_char_device() || of.is_block_device() {
            return ("a device", "copy what it gives to a file, and name that");
        }
    }
    match of.is_dir() {
        true => ("a folder", "name a file in it"),
        false => ("no plain file", "name a file"),
    }
}

/// Whether a file may be written there: a plain one or a new one. Terminals and other devices that take one byte after another may,
/// and so may the pipe that a shell has made of standard output; a pipe with a name waits until somebody reads it.
///
/// # Errors
/// [`ErrorKind::InvalidInput`] for what is there and is something else.
pub fn may_write(path: &Path) -> io::Result<()> {
    let Ok(found) = std::fs::metadata(path) else {
        return Ok(());
    };
    let of = found.file_type();
    #[cfg(unix)]
    {
        use std::os::unix::fs::FileTypeExt as _;
        if of.is_char_device() || (of.is_fifo() && path.canonicalize().is_err()) {
            return Ok(());
        }
    }
    match of.is_file() {
        true => Ok(()),
        false => Err(refused(format!(
            "it is {}, and only plain files are written: name a file that is not there yet",
            kind(of).0
        ))),
    }
}

/// Whether a new file can be made there: its folder is there, and the user may write in it. A file that is there has one.
///
/// # Errors
/// The system's, for the folder.
pub fn has_folder(path: &Path) -> io::Result<()> {
    if path.exists() {
        return Ok(());
    }
    let target = target(path);
    let folder = target.parent().unwrap_or(Path::new("/"));
    if !std::fs::metadata(folder)?.is_dir() {
        return Err(io::Error::from(ErrorKind::NotADirectory));
    }
    #[cfg(unix)]
    {
        use rustix::fs::Access;
        rustix::fs::access(folder, Access::WRITE_OK | Access::EXEC_OK)?;
    }
    Ok(())
}

/// Whether what is written to two paths comes to one file, be it there or not. A device takes both.
pub fn lead_to_one(one: &Path, other: &Path) -> bool {
    let is_device = one.metadata().is_ok_and(|found| !found.is_file());
    !is_device && (is_same(one, other) || target(one) == target(other))
}

/// Most links that are followed from one to the next, as the system does.
const MOST_LINKS: usize = 40;

/// Absolute path without links of a file that is there, or would be once it is written.
pub fn target(path: &Path) -> PathBuf {
    let mut path = path.to_owned();
    for _ in 0..MOST_LINKS {
        if let Ok(found) = path.canonicalize() {
            return found;
        }
        let Ok(to) = path.read_link() else { break };
        path = path.parent().unwrap_or(Path::new("")).join(to);
    }
    let path = absolute(&path).unwrap_or(path);
    let folder = path.parent().and_then(|folder| folder.canonicalize().ok());
    match (folder, path.file_name()) {
        (Some(folder), Some(name)) => folder.join(name),
        _ => path,
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
        let said = refusal(&pipe, 1 << 30);
        assert!(
            said.contains("a pipe") && said.contains("COMMAND > FILE"),
            "{said}"
        );
    }

    /// Such files say that they have no bytes, and some wait for the next as a pipe does.
    #[cfg(target_os = "linux")]
    #[test]
    fn files_that_only_say_that_they_are_empty_are_not_read() {
        let folder = tempfile::tempdir().expect("a folder");
        let empty = folder.path().join("empty");
        File::create(&empty).expect("created");
        assert_eq!(read_plain(&empty, 5).expect("read"), b"");
        for path in ["/proc/version", "/proc/kmsg"] {
            // The second is for those alone who may read it.
            if File::open(path).is_ok() {
                let said = refusal(path.as_ref(), 1 << 30);
                assert!(said.contains("as files of the system do"), "{path}: {said}");
            }
        }
    }

    #[cfg(unix)]
    #[test]
    fn files_are_written_and_pipes_and_folders_are_not() {
        let folder = tempfile::tempdir().expect("a folder");
        let at = |name: &str| folder.path().join(name);
        std::fs::write(at("old"), b"1").expect("written");
        std::os::unix::fs::symlink("new", at("dangling")).expect("a link");
        std::os::unix::fs::symlink("/dev/null", at("device")).expect("a link");
        for name in ["old", "new", "dangling", "device", "none/new"] {
            assert!(may_write(&at(name)).is_ok(), "{name}");
        }
        for name in ["old", "new", "dangling", "device"] {
            assert!(has_folder(&at(name)).is_ok(), "{name}");
        }
        std::os::unix::fs::symlink("none/new", at("lost")).expect("a link");
        for (name, kind) in [
            ("none/new", ErrorKind::NotFound),
            ("lost", ErrorKind::NotFound),
            ("old/new", ErrorKind::NotADirectory),
        ] {
            let error = has_folder(&at(name)).expect_err(name);
            assert_eq!(error.kind(), kind, "{name}");
        }
        let made = std::process::Command::new("mkfifo")
            .arg(at("pipe"))
            .status();
        assert!(made.expect("mkfifo").success());
        std::os::unix::fs::symlink("pipe", at("to-pipe")).expect("a link");
        let socket = std::os::unix::net::UnixListener::bind(at("socket")).expect("a socket");
        for (name, said) in [
            ("pipe", "a pipe"),
            ("to-pipe", "a pipe"),
            ("", "a folder"),
            ("socket", "a socket"),
        ] {
            for error in [may_write(&at(name)), write_whole(&at(name), b"1")] {
                let error = error.expect_err("no plain file");
                assert_eq!(error.kind(), ErrorKind::InvalidInput, "{name}: {error}");
                assert!(error.to_string().contains(said), "{name}: {error}");
            }
        }
        drop(socket);
    }

    #[cfg(unix)]
    #[test]
    fn names_that_come_to_one_file_are_found_before_it_is_there() {
        let folder = tempfile::tempdir().expect("a folder");
        let at = |name: &str| folder.path().join(name);
        std::fs::create_dir(at("in")).expect("a folder");
        std::os::unix::fs::symlink("in", at("link")).expect("a link");
        std::os::unix::fs::symlink("in/new", at("dangling")).expect("a link");
        for (one, other) in [
            ("in/new", "link/new"),
            ("in/new", "in/../in/new"),
            ("dangling", "in/new"),
        ] {
            assert!(lead_to_one(&at(one), &at(other)), "{one} {other}");
        }
        assert!(!lead_to_one(&at("in/new"), &at("new")));
        assert!(lead_to_one("new".as_ref(), "./new".as_ref()));
        std::fs::write(at("in/new"), b"1").expect("written");
        std::fs::hard_link(at("in/new"), at("hard")).expect("a link");
        assert!(lead_to_one(&at("dangling"), &at("hard")));
        assert!(!lead_to_one("/dev/null".as_ref(), "/dev/null".as_ref()));
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
