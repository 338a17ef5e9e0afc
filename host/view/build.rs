//! Makes a table of the page's files and of the libraries that it uses, and the hash of its import map.

use base64::Engine as _;
use sha2::{Digest as _, Sha256};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::{env, fs, io};

const OPEN: &str = "<script type=\"importmap\">";

fn files(folder: &Path, into: &mut Vec<PathBuf>) -> io::Result<()> {
    let mut entries = fs::read_dir(folder)?.collect::<io::Result<Vec<_>>>()?;
    entries.sort_by_key(fs::DirEntry::path);
    for entry in entries {
        let path = entry.path();
        if path.is_dir() {
            files(&path, into)?;
        } else {
            into.push(path);
        }
    }
    Ok(())
}

fn kind(path: &Path) -> Option<&'static str> {
    match path.extension()?.to_str()? {
        "html" => Some("text/html; charset=utf-8"),
        "js" | "mjs" => Some("text/javascript; charset=utf-8"),
        "css" => Some("text/css; charset=utf-8"),
        "svg" => Some("image/svg+xml"),
        "png" => Some("image/png"),
        _ => None,
    }
}

fn main() -> io::Result<()> {
    let root = PathBuf::from(env::var("CARGO_MANIFEST_DIR").unwrap_or_default());
    let mut table =
        String::from("/// Everything that is served.\npub static FILES: &[File] = &[\n");
    let mut hash = String::new();
    for folder in ["page", "vendor"] {
        println!("cargo::rerun-if-changed={folder}");
        let mut found = Vec::new();
        if root.join(folder).is_dir() {
            files(&root.join(folder), &mut found)?;
        }
        for path in found {
            println!("cargo::rerun-if-changed={}", path.display());
            let Some(kind) = kind(&path) else { continue };
            let local = path.strip_prefix(&root).unwrap_or(&path);
            let local = local.to_string_lossy().replace('\\', "/");
            let served = match local.as_str() {
                "page/index.html" => {
                    let text = fs::read_to_string(&path)?;
                    let map = text
                        .split(OPEN)
                        .nth(1)
                        .and_then(|rest| rest.split("</script>").next());
                    if let Some(map) = map {
                        let digest = Sha256::digest(map.as_bytes());
                        let digest = base64::engine::general_purpose::STANDARD.encode(digest);
                        hash = format!(" 'sha256-{digest}'");
                    }
                    "/".to_owned()
                }
                other => format!("/{other}"),
            };
            let whole = path.display().to_string();
            let _ = writeln!(
                table,
                "    File {{ path: {served:?}, kind: {kind:?}, bytes: include_bytes!({whole:?}) }},"
            );
        }
    }
    table += "];\n";
    let _ = writeln!(
        table,
        "/// Source of the import map, as policies name it.\npub const IMPORT_MAP: &str = {hash:?};"
    );
    let out = PathBuf::from(env::var("OUT_DIR").unwrap_or_default());
    fs::write(out.join("files.rs"), table)
}
