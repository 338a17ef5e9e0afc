//! Where the sessions of this user are, for the user's other programs: one file for each, which only the user reads.
//!
//! Entry points: [`note`], written by a server and removed at its end; [`noted`] for who looks for one. The files are
//! `sutura/session-PORT.json` in `$XDG_RUNTIME_DIR`; where that is not set there are none.

use super::guard::new_key;
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

/// A file that leads a browser to an address with a key. Everybody on a machine can read command lines; this file is for its user
/// alone. Removed when dropped.
#[derive(Debug)]
pub struct Redirect(PathBuf);

impl Redirect {
    /// Writes one, beside the notes or in the system's folder for temporary files.
    ///
    /// # Errors
    /// The file cannot be written; there is no random name.
    pub fn to(url: &str) -> io::Result<Self> {
        let place = folder().filter(|folder| std::fs::create_dir_all(folder).is_ok());
        let name = new_key().map_err(io::Error::other)?;
        let place = place.unwrap_or_else(std::env::temp_dir);
        let path = place.join(format!("sutura-{name}.html"));
        let url = url
            .replace('&', "&amp;")
            .replace('"', "&quot;")
            .replace('<', "&lt;");
        let text = format!(
            "<!doctype html><meta charset=\"utf-8\"><title>Sutura</title><meta name=\"referrer\" content=\"no-referrer\">\
             <meta http-equiv=\"refresh\" content=\"0; url={url}\"><a href=\"{url}\">Sutura</a>\n"
        );
        write_for_me(&path, &text)?;
        Ok(Self(path))
    }

    /// Path of the file.
    pub fn path(&self) -> &Path {
        &self.0
    }
}

impl Drop for Redirect {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

fn write_for_me(path: &Path, text: &str) -> io::Result<()> {
    let mut options = std::fs::OpenOptions::new();
    options.write(true).create_new(true);
    #[cfg(unix)]
    {
        use std::os::unix::fs::OpenOptionsExt as _;
        options.mode(0o600);
    }
    // One that is there may have other rights.
    let _ = std::fs::remove_file(path);
    io::Write::write_all(&mut options.open(path)?, text.as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The address stands in a file that others cannot read, and that is gone with its owner.
    #[test]
    fn a_redirect_is_its_users_alone() {
        let url = "http://127.0.0.1:8421/#key=0123&view=\"";
        let redirect = Redirect::to(url).expect("a file");
        let path = redirect.path().to_owned();
        let text = std::fs::read_to_string(&path).expect("it is there");
        let expected = "url=http://127.0.0.1:8421/#key=0123&amp;view=&quot;\"";
        assert!(text.contains(expected), "{text}");
        assert!(!path.to_string_lossy().contains("0123"), "{path:?}");
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt as _;
            let mode = std::fs::metadata(&path).expect("it is there").permissions();
            assert_eq!(mode.mode() & 0o777, 0o600);
        }
        drop(redirect);
        assert!(!path.exists());
    }
}
