//! What goes on beside a session, and what its user may do. Entry points: [`Load::begin`], [`Load::run`].

use super::idle::{IDLE, load};
use super::measured::Measured;
use crate::run::root;
use anyhow::{Context, Result, bail};
use serde::Serialize;
use std::fmt;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// The user that root becomes for a session without rights: `nobody`.
const NOBODY: &str = "65534";

/// A session that takes longer hangs \[s\].
const MOST_S: &str = "300";

/// What a session has beside it, and whether it may ask for real-time scheduling.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Load {
    /// Nothing, with the rights of who runs this.
    Idle,
    /// Busy loops at the same priority, without real-time rights.
    BusyPlain,
    /// Busy loops at the same priority, with real-time rights.
    BusyRealTime,
}

impl fmt::Display for Load {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Idle => "idle",
            Self::BusyPlain => "busy, without real-time rights",
            Self::BusyRealTime => "busy, with real-time rights",
        })
    }
}

/// Busy loops, until dropped.
pub struct Busy(Vec<Child>);

impl Drop for Busy {
    fn drop(&mut self) {
        for child in &mut self.0 {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

impl Load {
    /// In the order of measuring.
    pub const ALL: [Self; 3] = [Self::Idle, Self::BusyPlain, Self::BusyRealTime];

    /// Whether this machine and this user can have it.
    ///
    /// # Errors
    /// With what is missing.
    pub fn is_possible(self, program: &Path) -> Result<()> {
        if self == Self::BusyRealTime && !is_root() && real_time_limit() == 0 {
            bail!(
                "no real-time rights: run it as root, or raise the limit first: sudo prlimit --pid $$ --rtprio=80"
            );
        }
        if self == Self::BusyPlain {
            let can = |test: &str, path: &Path| {
                let mut command = self.command(Path::new("test"));
                let status = command.arg(test).arg(path).stderr(Stdio::null()).status();
                status.is_ok_and(|status| status.success())
            };
            if !can("-x", program) || !can("-r", &root().join("scenes")) {
                bail!(
                    "a user without rights cannot run {} on {}: prlimit and setpriv of util-linux are needed, and folders \
                     that others may enter",
                    program.display(),
                    root().display()
                );
            }
        }
        Ok(())
    }

    /// What is to be said before.
    pub fn warning(self) -> Option<String> {
        let load = load()?;
        (self == Self::Idle && load > IDLE).then(|| {
            format!("the machine is not idle: {load} processes ran in the last minute; what follows is of that machine")
        })
    }

    /// Starts what goes on beside the sessions.
    ///
    /// # Errors
    /// If there is no shell.
    pub fn begin(self) -> Result<Busy> {
        let mut busy = Busy(Vec::new());
        if self == Self::Idle {
            return Ok(busy);
        }
        let cores = std::thread::available_parallelism().map_or(2, usize::from);
        // Ends by itself if this program is killed.
        let program = format!(
            "i=0; while :; do i=$((i+1)); if [ $i = 1000000 ]; then i=0; kill -0 {} || exit; fi; done",
            std::process::id()
        );
        for _ in 0..cores.max(2) {
            let mut shell = Command::new("sh");
            shell.args(["-c", &program]).stderr(Stdio::null());
            busy.0.push(shell.spawn().context("there is no `sh`")?);
        }
        Ok(busy)
    }

    /// `program` as this load's user, ended after [`MOST_S`].
    fn limited(self, program: &Path) -> Command {
        let command = self.command(program);
        let mut limited = Command::new("timeout");
        limited.args(["--kill-after=5", MOST_S]);
        limited.arg(command.get_program()).args(command.get_args());
        limited
    }

    /// `program` as this load's user.
    fn command(self, program: &Path) -> Command {
        if self != Self::BusyPlain {
            return Command::new(program);
        }
        let mut command = Command::new("prlimit");
        command.args(["--rtprio=0:0", "--memlock=65536:65536"]);
        if is_root() {
            command.args(["setpriv", "--reuid", NOBODY, "--regid", NOBODY]);
            command.args(["--clear-groups", "--inh-caps=-all", "--no-new-privs"]);
        }
        command.arg(program);
        command
    }

    /// Runs a session and reads what it left.
    ///
    /// # Errors
    /// If the program cannot be started.
    pub fn run(self, program: &Path, arguments: &[&str]) -> Result<Measured> {
        let mut command = self.limited(program);
        command
            .arg("run")
            .args(arguments)
            .args(["--format", "json"])
            .current_dir(root())
            .env_remove("RUST_LOG")
            .stdin(Stdio::null());
        let done = AtomicBool::new(false);
        let (output, late_us) = std::thread::scope(|scope| {
            let watch = scope.spawn(|| lateness(&done));
            let output = command.output();
            done.store(true, Ordering::Relaxed);
            (output, watch.join().unwrap_or(f64::NAN))
        });
        let output = output.with_context(|| format!("cannot start {}", program.display()))?;
        let stdout = String::from_utf8_lossy(&output.stdout);
        let stderr = String::from_utf8_lossy(&output.stderr);
        let code = output.status.code();
        Ok(Measured::read(code, &stdout, &stderr, late_us))
    }
}

/// How late a thread that only sleeps 1 ms wakes at most \[us\].
fn lateness(done: &AtomicBool) -> f64 {
    const NAP: Duration = Duration::from_millis(1);
    let mut worst = Duration::ZERO;
    while !done.load(Ordering::Relaxed) {
        let start = Instant::now();
        std::thread::sleep(NAP);
        worst = worst.max(start.elapsed().saturating_sub(NAP));
    }
    worst.as_secs_f64() * 1e6
}

fn is_root() -> bool {
    crate::run::Tool::new("id -u")
        .output()
        .is_ok_and(|id| id.trim() == "0")
}

/// The highest real-time priority that this user may ask for.
fn real_time_limit() -> u64 {
    let limits = std::fs::read_to_string("/proc/self/limits").unwrap_or_default();
    let line = limits
        .lines()
        .find_map(|line| line.strip_prefix("Max realtime priority"));
    let soft = line.and_then(|rest| rest.split_whitespace().next());
    match soft {
        Some("unlimited") => u64::MAX,
        Some(number) => number.parse().unwrap_or(0),
        None => 0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn busy_loops_run_until_they_are_dropped() {
        let busy = Load::BusyPlain.begin().expect("a shell");
        assert!(busy.0.len() >= 2);
        let pids: Vec<u32> = busy.0.iter().map(Child::id).collect();
        let alive = |pid: &u32| Path::new(&format!("/proc/{pid}")).exists();
        if cfg!(target_os = "linux") {
            assert!(pids.iter().all(alive));
        }
        drop(busy);
        assert!(!pids.iter().any(alive));
        assert!(Load::Idle.begin().expect("nothing to do").0.is_empty());
    }

    #[test]
    fn a_session_without_rights_is_started_without_them() {
        let plain = Load::BusyPlain.command(Path::new("sutura"));
        let words: Vec<_> = plain
            .get_args()
            .map(|word| word.to_string_lossy())
            .collect();
        assert!(words.iter().any(|word| word == "--rtprio=0:0"), "{words:?}");
        assert_eq!(words.iter().any(|word| word == "--reuid"), is_root());
        let rights = Load::BusyRealTime.command(Path::new("sutura"));
        assert_eq!(rights.get_program(), "sutura");
    }
}
