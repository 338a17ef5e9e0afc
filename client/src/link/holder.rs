//! Which program has a port, where the system says so.
//!
//! Entry point: [`holder`]. Linux lists the locks on files in /proc/locks, by device, inode and process.

use std::path::Path;

/// Name and process of whoever has the lock on `port`; none where that is not known.
pub(super) fn holder(port: &str) -> Option<String> {
    #[cfg(target_os = "linux")]
    {
        use std::os::unix::fs::MetadataExt;
        let file = std::fs::metadata(port).ok()?;
        let locks = std::fs::read_to_string("/proc/locks").ok()?;
        let process = process_of(&locks, file.dev(), file.ino())?;
        let name = std::fs::read_to_string(Path::new("/proc").join(process).join("comm")).ok()?;
        Some(format!("{}, process {process}", name.trim()))
    }
    #[cfg(not(target_os = "linux"))]
    {
        let _ = Path::new(port);
        None
    }
}

/// The process with a lock (`flock`) on a file, from the text of /proc/locks.
#[cfg_attr(not(target_os = "linux"), allow(dead_code))]
fn process_of(locks: &str, device: u64, inode: u64) -> Option<&str> {
    // As the C library packs them.
    let major = (device >> 8) & 0xfff | (device >> 32) & 0xffff_f000;
    let minor = device & 0xff | (device >> 12) & 0xffff_ff00;
    let file = format!("{major:02x}:{minor:02x}:{inode}");
    locks.lines().find_map(|line| {
        let words: Vec<&str> = line.split_whitespace().collect();
        match words[..] {
            // Number, class, kind, access, process, file, from, to.
            [_, "FLOCK", _, _, process, found, ..] if found == file => Some(process),
            _ => None,
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_process_stands_beside_the_file() {
        let locks = "1: POSIX  ADVISORY  WRITE 77 08:01:12 0 EOF\n\
                     1: -> FLOCK  ADVISORY  WRITE 78 08:01:12 0 EOF\n\
                     2: FLOCK  ADVISORY  WRITE 4321 00:19:5 0 EOF\n\
                     3: FLOCK  ADVISORY  READ 99 08:01:12 0 EOF\n";
        assert_eq!(process_of(locks, 0x19, 5), Some("4321"));
        assert_eq!(process_of(locks, 0x801, 12), Some("99"));
        assert_eq!(process_of(locks, 0x801, 5), None);
        assert_eq!(process_of("", 0x801, 5), None);
    }
}
