//! How much memory this process may still take, asked before work that needs much of it.
//!
//! Entry points: [`available_bytes`], [`require`]. On Linux the least of what the machine has (MemAvailable), what the
//! control groups leave (v2 and v1), and what is left of a limit on the address space (`ulimit -v`); unknown elsewhere.

use std::path::{Path, PathBuf};
use thiserror::Error;

/// Work that needs more memory than there is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("{what} needs {} of memory, and {} is free", gigabytes(*needed_bytes), gigabytes(*available_bytes))]
pub struct Shortage {
    /// What needs it, as the subject of a sentence.
    pub what: &'static str,
    /// How much \[bytes\].
    pub needed_bytes: u64,
    /// How much there is \[bytes\].
    pub available_bytes: u64,
}

fn gigabytes(bytes: u64) -> String {
    format!("{:.2} GB", 1e-9 * bytes as f64)
}

/// Less than this is not asked for \[bytes\]: a machine that has not even that shows it soon enough, and asking takes longer than
/// a small mesh does.
const ASKED_FROM: u64 = 64 << 20;

/// Whether `what` may be begun, which needs so much.
///
/// # Errors
/// [`Shortage`], if less is known to be free.
pub fn require(what: &'static str, needed_bytes: u64) -> Result<(), Shortage> {
    if needed_bytes < ASKED_FROM {
        return Ok(());
    }
    match available_bytes() {
        Some(available_bytes) if available_bytes < needed_bytes => Err(Shortage {
            what,
            needed_bytes,
            available_bytes,
        }),
        _ => Ok(()),
    }
}

/// So many zeros, or the shortage. As `vec![0.0; count]` they cost nothing before they are touched.
///
/// # Errors
/// [`Shortage`], where the allocator has no such piece.
pub fn zeros(what: &'static str, count: usize) -> Result<Vec<f64>, Shortage> {
    bytemuck::try_zeroed_vec(count).map_err(|()| Shortage {
        what,
        needed_bytes: (count as u64).saturating_mul(size_of::<f64>() as u64),
        available_bytes: available_bytes().unwrap_or_default(),
    })
}

/// What this process may still take \[bytes\]; `None` where the system does not say.
pub fn available_bytes() -> Option<u64> {
    available_below(Path::new("/"))
}

/// The same for a system whose files are below `root`.
fn available_below(root: &Path) -> Option<u64> {
    let files = Files(root);
    let groups = files.text("proc/self/cgroup").unwrap_or_default();
    let of_groups = groups.lines().flat_map(|line| files.group(line));
    let all = [files.of_machine(), files.of_address_space()];
    all.into_iter().flatten().chain(of_groups).min()
}

struct Files<'a>(&'a Path);

impl Files<'_> {
    fn text(&self, path: impl AsRef<Path>) -> Option<String> {
        std::fs::read_to_string(self.0.join(path)).ok()
    }

    fn number(&self, path: PathBuf) -> Option<u64> {
        self.text(path)?.trim().parse().ok()
    }

    fn of_machine(&self) -> Option<u64> {
        kilobytes(&self.text("proc/meminfo")?, "MemAvailable:")
    }

    fn of_address_space(&self) -> Option<u64> {
        let limits = self.text("proc/self/limits")?;
        let line = |line: &str| line.strip_prefix("Max address space").map(str::to_owned);
        let limit = limits.lines().find_map(line)?;
        // Soft, hard; a word where there is none.
        let limit: u64 = limit.split_whitespace().next()?.parse().ok()?;
        let used = kilobytes(&self.text("proc/self/status")?, "VmSize:")?;
        Some(limit.saturating_sub(used))
    }

    /// What a line of /proc/self/cgroup, and the groups around that one, leave.
    fn group(&self, line: &str) -> Vec<u64> {
        let mut parts = line.splitn(3, ':');
        let (Some(_), Some(kinds), Some(path)) = (parts.next(), parts.next(), parts.next()) else {
            return Vec::new();
        };
        let (mount, limit, used, cache) = match kinds {
            "" => (
                "sys/fs/cgroup",
                "memory.max",
                "memory.current",
                "inactive_file ",
            ),
            _ if kinds.split(',').any(|kind| kind == "memory") => (
                "sys/fs/cgroup/memory",
                "memory.limit_in_bytes",
                "memory.usage_in_bytes",
                "total_inactive_file ",
            ),
            _ => return Vec::new(),
        };
        // Within a container the path may be the host's: then the mount itself is the group.
        let path = Path::new(path.trim_start_matches('/'));
        let groups = path.ancestors().map(|group| Path::new(mount).join(group));
        let left = groups.filter_map(|group| {
            let limit = self.number(group.join(limit))?;
            let used = self.number(group.join(used))?;
            // Pages of files that nobody has used lately are given back.
            let stat = self.text(group.join("memory.stat")).unwrap_or_default();
            let cached = stat.lines().find_map(|line| line.strip_prefix(cache));
            let cached = cached
                .and_then(|bytes| bytes.trim().parse().ok())
                .unwrap_or(0u64);
            Some(limit.saturating_sub(used.saturating_sub(cached)))
        });
        left.collect()
    }
}

/// A line `name  123 kB`, in bytes.
fn kilobytes(text: &str, name: &str) -> Option<u64> {
    let line = text.lines().find_map(|line| line.strip_prefix(name))?;
    let number: u64 = line.split_whitespace().next()?.parse().ok()?;
    Some(1024 * number)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A system with these files, which are gone with it.
    struct System(PathBuf);

    impl System {
        fn of(name: &str, files: &[(&str, &str)]) -> System {
            let root = format!("sutura-memory-{}-{name}", std::process::id());
            let root = std::env::temp_dir().join(root);
            for (path, text) in files {
                let path = root.join(path);
                std::fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
                std::fs::write(path, text).expect("a file");
            }
            System(root)
        }
    }

    impl Drop for System {
        fn drop(&mut self) {
            let _ = std::fs::remove_dir_all(&self.0);
        }
    }

    const MACHINE: (&str, &str) = (
        "proc/meminfo",
        "MemTotal:  8000 kB\nMemFree:  10 kB\nMemAvailable:   4000 kB\n",
    );

    fn available(name: &str, files: &[(&str, &str)]) -> Option<u64> {
        available_below(&System::of(name, files).0)
    }

    #[test]
    fn a_system_that_says_nothing_refuses_nothing() {
        assert_eq!(available("nothing", &[("proc/uptime", "1")]), None);
    }

    #[test]
    fn the_machine_has_what_can_be_freed() {
        assert_eq!(available("machine", &[MACHINE]), Some(4_096_000));
    }

    #[test]
    fn the_narrowest_group_around_the_process_counts() {
        let files = [
            MACHINE,
            ("proc/self/cgroup", "0::/jobs/one\n"),
            ("sys/fs/cgroup/jobs/one/memory.max", "max\n"),
            ("sys/fs/cgroup/jobs/one/memory.current", "700000\n"),
            ("sys/fs/cgroup/jobs/memory.max", "1000000\n"),
            ("sys/fs/cgroup/jobs/memory.current", "800000\n"),
            (
                "sys/fs/cgroup/jobs/memory.stat",
                "anon 5\ninactive_file 100000\n",
            ),
        ];
        assert_eq!(available("v2", &files), Some(300_000));
        let files = [
            MACHINE,
            ("proc/self/cgroup", "5:cpu:/\n4:memory:/docker/abc\n"),
            ("sys/fs/cgroup/memory/memory.limit_in_bytes", "2000000\n"),
            ("sys/fs/cgroup/memory/memory.usage_in_bytes", "1500000\n"),
        ];
        assert_eq!(available("v1", &files), Some(500_000));
    }

    #[test]
    fn a_limit_on_the_address_space_counts() {
        let files = |limit: &str| {
            let limits = format!(
                "Max cpu time   unlimited unlimited seconds\nMax address space  {limit}  unlimited  bytes\n"
            );
            available(
                &format!("space-{}", limit.len()),
                &[
                    MACHINE,
                    ("proc/self/limits", &limits),
                    ("proc/self/status", "Name:\tx\nVmSize:\t  1000 kB\n"),
                ],
            )
        };
        assert_eq!(files("2000000"), Some(976_000));
        assert_eq!(files("unlimited"), Some(4_096_000));
    }

    #[test]
    fn more_than_there_is_cannot_be_had() {
        // 4 EiB: beyond any address space, and a sum of bytes that the tests' counter can hold.
        let error = zeros("a field", usize::MAX / 32).expect_err("nobody has so much");
        assert_eq!(error.what, "a field");
        assert_eq!(zeros("a field", 3), Ok(vec![0.0; 3]));
        if available_bytes().is_some() {
            let error = require("the factor", u64::MAX).expect_err("nobody has so much");
            assert!(error.to_string().starts_with("the factor needs"), "{error}");
        }
        assert_eq!(require("nothing", 0), Ok(()));
    }
}
