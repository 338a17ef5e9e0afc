//! The page and its libraries, in the binary.
//!
//! Entry point: [`find`].

/// A file that is served.
#[derive(Debug)]
pub struct File {
    /// Where.
    pub path: &'static str,
    /// Its media type.
    pub kind: &'static str,
    /// All of it.
    pub bytes: &'static [u8],
}

include!(concat!(env!("OUT_DIR"), "/files.rs"));

/// The file that is served at exactly this path.
pub fn find(path: &str) -> Option<&'static File> {
    FILES.iter().find(|file| file.path == path)
}
