//! Where the sessions of this user are, for the user's other programs: one file for each, which only the user reads.
//!
//! Entry points: [`note`], written by a server and removed at its end; [`noted`] for who looks for one. The files are
//! `sutura/session-PORT.json` in `$XDG_RUNTIME_DIR`; where that is not set there are none.

use serde_json::{Value, json};
use std::io;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};

/// A session's server, as its file says.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Noted {
    /// Where it is reached from this machine.
    pub address: SocketAddr,
    /// Its key.
    pub key: String,
    /// Its process.
    pub pid: u32,
}

fn folder() -> Option<PathBuf> {
    let folder = std::env::var_os("XDG_RUNTIME_DIR").filter(|folder| !folder.is_empty())?;
    Some(PathBuf::from(folder).join("sutura"))
}

/// Writes down where a server is, and its key; where there is such a place.
pub fn note(address: SocketAddr, key: &str) -> Option<PathBuf> {
    let folder = folder()?;
    std::fs::create_dir_all(&folder).ok()?;
    // No two servers of a machine share a port, so that none overwrites another's.
    let path = folder.join(format!("session-{}.json", address.port()));
    let ip = match address.ip() {
        ip if ip.is_unspecified() => IpAddr::V4(Ipv4Addr::LOCALHOST),
        ip => ip,
    };
    let text =
        json!({"address": ip, "port": address.port(), "key": key, "pid": std::process::id()});
    write_for_me(&path, &text.to_string()).ok()?;
    Some(path)
}

/// The sessions that are written down, by port. A program that was killed leaves its file: whether it still answers is seen by
/// connecting.
pub fn noted() -> Vec<Noted> {
    let files = folder().and_then(|folder| std::fs::read_dir(folder).ok());
    let paths = files.into_iter().flatten().flatten();
    let mut all: Vec<Noted> = paths.filter_map(|file| read(&file.path())).collect();
    all.sort_by_key(|noted| noted.address.port());
    all
}

fn read(path: &Path) -> Option<Noted> {
    let name = path.file_name()?.to_str()?;
    if !(name.starts_with("session-") && name.ends_with(".json")) {
        return None;
    }
    let said: Value = serde_json::from_slice(&std::fs::read(path).ok()?).ok()?;
    let port = said["port"]
        .as_u64()
        .and_then(|port| port.try_into().ok())?;
    let ip: IpAddr = said["address"].as_str()?.parse().ok()?;
    Some(Noted {
        address: SocketAddr::new(ip, port),
        key: said["key"].as_str()?.to_owned(),
        pid: said["pid"].as_u64()?.try_into().ok()?,
    })
}

fn write_for_me(path: &Path, text: &str) -> io::Result<()> {
    let mut options = std::fs::OpenOptions::new();
    options.write(true).create(true).truncate(true);
    #[cfg(unix)]
    {
        use std::os::unix::fs::OpenOptionsExt as _;
        options.mode(0o600);
    }
    // One that is there may have other rights.
    let _ = std::fs::remove_file(path);
    io::Write::write_all(&mut options.open(path)?, text.as_bytes())
}
