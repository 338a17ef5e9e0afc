//! Which image is run: its hash, and whether it is what `cargo xtask firmware` made of the sources that are here.
//!
//! Entry point: [`provenance`]. Beside each image that command writes `IMAGE.sha256`, in the format of `sha256sum`: the image, then every file
//! that it was built from, relative to the checkout.

use super::{Board, BoardImageError};
use crate::qemu::{QemuError, board_of};
use sha2::{Digest, Sha256};
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};

/// Where images are, relative to the source checkout.
const IMAGES: &str = "firmware/target/thumbv7em-none-eabihf/release";

/// An image that has been checked.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Provenance {
    /// Where it is.
    pub image: PathBuf,
    /// SHA-256 of the file, in hexadecimal digits.
    pub sha256: String,
    /// Files that it was built from, which are here as they were then.
    pub sources: usize,
}

fn checkout() -> &'static Path {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    here.parent().unwrap_or(here)
}

/// Where `cargo xtask firmware` puts a board's image, in the source checkout that this program was built from.
pub fn default_image(board: Board) -> PathBuf {
    image(&format!("sutura-{}", board.name()))
}

/// Where it puts the image of that board's self-test.
pub fn default_selftest(board: Board) -> PathBuf {
    image(&format!("sutura-selftest-{}", board.name()))
}

/// Where it puts the image of that name.
pub(super) fn image(name: &str) -> PathBuf {
    checkout().join(IMAGES).join(name)
}

/// Checks an image against the list beside it, and its sources against the same list.
///
/// # Errors
/// [`QemuError::NoImage`]; [`BoardImageError::Stale`] if there is no list, or if image or sources are not what it says.
pub fn provenance(image: &Path) -> Result<Provenance, BoardImageError> {
    check(image, checkout())
}

fn check(image: &Path, root: &Path) -> Result<Provenance, BoardImageError> {
    let stale = |why: String| BoardImageError::Stale {
        path: image.to_owned(),
        board: board_of(image),
        why,
    };
    let Ok(bytes) = fs::read(image) else {
        let path = image.to_owned();
        return Err(QemuError::NoImage { path }.into());
    };
    let sha256 = hash(&bytes);
    let list = image.with_added_extension("sha256");
    let text = fs::read_to_string(&list)
        .map_err(|_| stale(format!("there is no list `{}`", list.display())))?;
    let mut lines = text.lines().filter_map(|line| line.split_once("  "));
    match lines.next() {
        Some((known, _)) if known == sha256 => {}
        _ => {
            return Err(stale(format!(
                "its SHA-256 is {sha256}, and the list's another"
            )));
        }
    }
    let mut sources = 0;
    for (known, path) in lines {
        let found = fs::read(root.join(path)).map(|bytes| hash(&bytes));
        if found.is_ok_and(|found| found == known) {
            sources += 1;
        } else {
            return Err(stale(format!("`{path}` has changed")));
        }
    }
    if sources == 0 {
        return Err(stale("the list names no sources".to_owned()));
    }
    Ok(Provenance {
        image: image.to_owned(),
        sha256,
        sources,
    })
}

fn hash(bytes: &[u8]) -> String {
    let mut digits = String::new();
    for byte in Sha256::digest(bytes) {
        // Writing to a string cannot fail.
        let _ = write!(digits, "{byte:02x}");
    }
    digits
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An image and one source, with a list as `sha256sum` writes it.
    fn folder() -> (tempfile::TempDir, PathBuf) {
        let folder = tempfile::tempdir().expect("a folder");
        let image = folder.path().join("sutura-some-board");
        fs::write(&image, "image").expect("writable");
        fs::write(folder.path().join("main.rs"), "fn main() {}").expect("writable");
        let list = format!(
            "{}  sutura-some-board\n{}  main.rs\n",
            hash(b"image"),
            hash(b"fn main() {}")
        );
        fs::write(folder.path().join("sutura-some-board.sha256"), list).expect("writable");
        (folder, image)
    }

    fn why(folder: &tempfile::TempDir, image: &Path) -> String {
        let error = check(image, folder.path()).expect_err("stale");
        let text = error.to_string();
        assert!(
            text.contains("cargo xtask firmware --board some-board"),
            "{text}"
        );
        text
    }

    #[test]
    fn an_image_of_these_sources_passes() {
        let (folder, image) = folder();
        let known = check(&image, folder.path()).expect("as it was built");
        assert_eq!(known.sources, 1);
        assert_eq!(known.sha256, hash(b"image"));
    }

    #[test]
    fn what_has_changed_is_named_with_what_to_run() {
        let (folder, image) = folder();
        fs::write(folder.path().join("main.rs"), "fn main() { loop {} }").expect("writable");
        assert!(why(&folder, &image).contains("`main.rs` has changed"));
        fs::write(&image, "another").expect("writable");
        assert!(why(&folder, &image).contains("SHA-256"));
        fs::remove_file(folder.path().join("sutura-some-board.sha256")).expect("there");
        assert!(why(&folder, &image).contains("no list"));
        fs::remove_file(&image).expect("there");
        assert!(why(&folder, &image).contains("no firmware image"));
    }

    /// The test vector of the standard (FIPS 180-2, B.1).
    #[test]
    fn the_hash_is_sha_256() {
        let abc = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        assert_eq!(hash(b"abc"), abc);
    }
}
