//! Runs a firmware image under QEMU and sees to it that the emulator never outlives its purpose.
//!
//! Entry points: [`Qemu::start`], [`Qemu::wait`]. Machine `netduinoplus2` is an STM32F405, the
//! console's chip; what QEMU models of it is in the firmware's README.

use std::ffi::OsString;
use std::fs;
use std::io::{self, BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Program that emulates the chip.
pub const PROGRAM: &str = "qemu-system-arm";
/// Emulated board.
pub const MACHINE: &str = "netduinoplus2";

/// The virtual board's image, relative to the source checkout.
pub const IMAGE: &str = "firmware/target/thumbv7em-none-eabihf/release/sutura-virtual";

/// What to run.
#[derive(Clone, Debug)]
pub struct QemuOptions {
    /// ELF image.
    pub image: PathBuf,
    /// Command line that the image reads through semihosting.
    pub args: Vec<String>,
    /// Count instructions as time, bit-identical from run to run, as fast as the machine allows;
    /// otherwise emulated time follows the wall clock.
    pub icount: bool,
    /// Give the first UART a pseudo-terminal.
    pub uart: bool,
    /// Wait for a debugger before the first instruction: see [`Qemu::gdb`]. Without semihosting, as on a chip.
    pub gdb: bool,
    /// The emulator is killed after this long.
    pub time_limit: Duration,
}

/// Why the image does not run, or no longer.
#[derive(Debug, thiserror::Error)]
pub enum QemuError {
    /// QEMU is not installed.
    #[error("`{PROGRAM}` was not found; install it with `cargo xtask setup`")]
    NoQemu,
    /// There is no image.
    #[error(
        "there is no firmware image at `{path}`; build it with `cargo xtask firmware --board {}`",
        board_of(path)
    )]
    NoImage {
        /// Where it was looked for.
        path: PathBuf,
    },
    /// The system refused something that the emulator needs.
    #[error("{what}: {source}")]
    System {
        /// What was tried.
        what: String,
        /// What the system said.
        source: io::Error,
    },
    /// The emulator was killed because it ran too long.
    #[error("the emulated console ran into its time limit of {:.0} s{stderr}", limit.as_secs_f64())]
    TimeLimit {
        /// The limit.
        limit: Duration,
        /// What it wrote to stderr.
        stderr: Said,
    },
    /// The emulator ended by itself.
    #[error("the emulated console ended with {status}{stderr}")]
    Ended {
        /// How.
        status: ExitStatus,
        /// What it wrote to stderr.
        stderr: Said,
    },
    /// The image did something that QEMU does not model, or that a program should not do.
    #[error("QEMU complains about the image ({} lines in all):\n{}", lines.len(), lines[..lines.len().min(5)].join("\n"))]
    Complaints {
        /// Lines of QEMU's log.
        lines: Vec<String>,
    },
}

/// What a process wrote to stderr, as the tail of a sentence.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Said(String);

impl std::fmt::Display for Said {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let text = self.0.trim();
        if text.is_empty() {
            f.write_str(" and said nothing")
        } else {
            write!(f, "; it said:\n{text}")
        }
    }
}

/// A running emulator. Dropping it kills the emulator.
#[derive(Debug)]
pub struct Qemu {
    shared: Arc<Shared>,
    threads: Vec<JoinHandle<()>>,
    limit: Duration,
    uart: Option<String>,
    directory: tempfile::TempDir,
}

#[derive(Debug)]
struct Shared {
    process: Mutex<Process>,
    ended: Condvar,
    stderr: Mutex<String>,
}

#[derive(Debug)]
struct Process {
    child: Child,
    status: Option<ExitStatus>,
    timed_out: bool,
}

/// The data behind these locks are whole even if a thread panicked.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn system(what: impl Into<String>) -> impl FnOnce(io::Error) -> QemuError {
    let what = what.into();
    move |source| QemuError::System { what, source }
}

/// Path of the virtual board's image in the source checkout that this program was built from.
pub fn default_image() -> PathBuf {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    here.parent().unwrap_or(here).join(IMAGE)
}

/// The board that an image is for, by its file's name; of other names, the virtual one.
pub(crate) fn board_of(image: &Path) -> String {
    let name = image.file_name().unwrap_or_default().to_string_lossy();
    let name = name.strip_prefix("sutura-").unwrap_or("virtual");
    // A board's other images are built beside it.
    let board = ["selftest-", "mutants-"].iter();
    let mut board = board.filter_map(|kind| name.strip_prefix(kind));
    board.next().unwrap_or(name).to_owned()
}

/// What the emulator says of itself: one line.
///
/// # Errors
/// [`QemuError::NoQemu`], or what the system said.
pub fn version() -> Result<String, QemuError> {
    let output = Command::new(PROGRAM)
        .arg("--version")
        .output()
        .map_err(no_program)?;
    let text = String::from_utf8_lossy(&output.stdout);
    Ok(text.lines().next().unwrap_or_default().to_owned())
}

/// Why the program cannot be started.
fn no_program(error: io::Error) -> QemuError {
    match error.kind() {
        io::ErrorKind::NotFound => QemuError::NoQemu,
        _ => QemuError::System {
            what: format!("`{PROGRAM}` cannot be started"),
            source: error,
        },
    }
}

/// Starts an image that talks over its first UART; see [`Qemu::uart`].
///
/// # Errors
/// See [`Qemu::start`].
pub fn with_uart(image: PathBuf, time_limit: Duration) -> Result<Qemu, QemuError> {
    let args = vec!["uart".to_owned()];
    Qemu::start(&QemuOptions {
        image,
        args,
        icount: false,
        uart: true,
        gdb: false,
        time_limit,
    })
}

/// How often an emulator that ends by itself, or runs too long, is looked for.
const LOOK_EVERY: Duration = Duration::from_millis(20);

/// How much of stderr is kept \[bytes\].
const STDERR_KEPT: usize = 16 * 1024;

impl Qemu {
    /// Starts the emulator.
    ///
    /// # Errors
    /// [`QemuError::NoQemu`], [`QemuError::NoImage`], or what the system said.
    pub fn start(options: &QemuOptions) -> Result<Qemu, QemuError> {
        if !options.image.is_file() {
            return Err(QemuError::NoImage {
                path: options.image.clone(),
            });
        }
        let directory = tempfile::Builder::new()
            .prefix("sutura-qemu-")
            .tempdir()
            .map_err(system("no temporary directory for the emulator"))?;
        let mut child = Command::new(PROGRAM)
            .args(command_line(options, directory.path()))
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .map_err(no_program)?;
        let (stdout, stderr) = (child.stdout.take(), child.stderr.take());
        let shared = Arc::new(Shared {
            process: Mutex::new(Process {
                child,
                status: None,
                timed_out: false,
            }),
            ended: Condvar::new(),
            stderr: Mutex::default(),
        });
        let mut qemu = Qemu {
            shared,
            threads: Vec::new(),
            limit: options.time_limit,
            uart: None,
            directory,
        };
        let for_keeper = qemu.shared.clone();
        let keeper =
            stderr.map(|stream| std::thread::spawn(move || keep(stream, &for_keeper.stderr)));
        let for_watcher = qemu.shared.clone();
        let limit = options.time_limit;
        qemu.threads.push(std::thread::spawn(move || {
            watch(&for_watcher, limit, keeper)
        }));
        if let Some(stdout) = stdout {
            let mut lines = BufReader::new(stdout);
            if options.uart {
                qemu.uart = Some(qemu.find_uart(&mut lines)?);
            }
            // Nobody else reads it, and a full pipe would stop the emulator.
            qemu.threads.push(std::thread::spawn(move || {
                drop(io::copy(&mut lines, &mut io::sink()))
            }));
        }
        Ok(qemu)
    }

    /// The path of the UART's pseudo-terminal, for the host to open.
    pub fn uart(&self) -> Option<&str> {
        self.uart.as_deref()
    }

    /// The socket of the debugger's stub; there a moment after the start.
    pub fn gdb(&self) -> PathBuf {
        self.directory.path().join(GDB)
    }

    /// What the emulator logs about the image; not there before the first line.
    pub fn log(&self) -> PathBuf {
        self.directory.path().join(LOG)
    }

    /// A directory that lives as long as the emulator.
    pub fn directory(&self) -> &Path {
        self.directory.path()
    }

    /// Waits until the image ends by itself; its exit code, if it gave one.
    ///
    /// # Errors
    /// [`QemuError::TimeLimit`].
    pub fn wait(&self) -> Result<ExitStatus, QemuError> {
        let mut process = lock(&self.shared.process);
        loop {
            if let Some(status) = process.status {
                let timed_out = process.timed_out;
                drop(process);
                return if timed_out {
                    Err(self.ending())
                } else {
                    Ok(status)
                };
            }
            process = self
                .shared
                .ended
                .wait(process)
                .unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Whether the emulator still runs.
    pub fn is_running(&self) -> bool {
        lock(&self.shared.process).status.is_none()
    }

    /// Why the emulator is no longer there: for whoever finds its pipes closed.
    pub fn ending(&self) -> QemuError {
        // A closed pipe is seen a moment before the process is known to have ended.
        let mut process = lock(&self.shared.process);
        while process.status.is_none() {
            process = self
                .shared
                .ended
                .wait(process)
                .unwrap_or_else(PoisonError::into_inner);
        }
        let stderr = Said(lock(&self.shared.stderr).clone());
        match process.status {
            Some(status) if !process.timed_out => QemuError::Ended { status, stderr },
            _ => QemuError::TimeLimit {
                limit: self.limit,
                stderr,
            },
        }
    }

    /// Ends the emulator at once.
    pub fn kill(&self) {
        // An error means that it has already ended.
        drop(lock(&self.shared.process).child.kill());
    }

    /// Checks what QEMU logged about the image: accesses to what is not there, guest errors.
    ///
    /// # Errors
    /// [`QemuError::Complaints`] with every line that `expected` does not know.
    pub fn check_log(&self, expected: impl Fn(&str) -> bool) -> Result<(), QemuError> {
        // No file: nothing was logged.
        let log = fs::read_to_string(self.log()).unwrap_or_default();
        let lines: Vec<String> = log
            .lines()
            .filter(|line| !expected(line))
            .map(str::to_owned)
            .collect();
        if lines.is_empty() {
            Ok(())
        } else {
            Err(QemuError::Complaints { lines })
        }
    }

    fn find_uart(&self, lines: &mut impl BufRead) -> Result<String, QemuError> {
        // "char device redirected to /dev/pts/3 (label uart)"
        let mut line = String::new();
        while lines
            .read_line(&mut line)
            .map_err(system("the emulator's output cannot be read"))?
            > 0
        {
            if let Some(path) = line
                .split_whitespace()
                .find(|word| word.starts_with("/dev/"))
            {
                return Ok(path.to_owned());
            }
            line.clear();
        }
        Err(self.ending())
    }
}

impl Drop for Qemu {
    fn drop(&mut self) {
        self.kill();
        for thread in self.threads.drain(..) {
            // Its panic, if any, has already been reported on stderr.
            drop(thread.join());
        }
    }
}

const LOG: &str = "qemu.log";
const GDB: &str = "gdb";

fn command_line(options: &QemuOptions, directory: &Path) -> Vec<OsString> {
    // A comma ends a value; twice it is a comma.
    let semihosting = options.args.iter().fold(
        "enable=on,target=native,arg=sutura".to_owned(),
        |line, arg| format!("{line},arg={}", arg.replace(',', ",,")),
    );
    let mut line: Vec<OsString> = [
        "-M",
        MACHINE,
        "-display",
        "none",
        "-monitor",
        "none",
        "-nodefaults",
    ]
    .map(Into::into)
    .into();
    if options.gdb {
        // A comma ends a value here, too.
        let path = directory.join(GDB).to_string_lossy().replace(',', ",,");
        let socket = format!("socket,id=gdb,path={path},server=on,wait=off");
        line.extend(["-S".into(), "-chardev".into(), socket.into()]);
        line.extend(["-gdb", "chardev:gdb"].map(Into::into));
    } else {
        line.extend(["-semihosting-config".into(), semihosting.into()]);
    }
    if options.icount {
        line.extend(["-icount", "shift=3,sleep=off"].map(Into::into));
    }
    if options.uart {
        line.extend(["-chardev", "pty,id=uart", "-serial", "chardev:uart"].map(Into::into));
    }
    line.extend(["-d", "guest_errors,unimp", "-D"].map(Into::into));
    line.extend([
        directory.join(LOG).into_os_string(),
        "-kernel".into(),
        options.image.clone().into_os_string(),
    ]);
    line
}

/// Notes when the process ends, and ends it when its time is up.
fn watch(shared: &Shared, limit: Duration, mut keeper: Option<JoinHandle<()>>) {
    let started = Instant::now();
    loop {
        let mut process = lock(&shared.process);
        if let Ok(Some(status)) = process.child.try_wait() {
            // Whoever asks for the end gets all that the process said.
            keeper.take().map(JoinHandle::join);
            process.status = Some(status);
            shared.ended.notify_all();
            return;
        }
        if started.elapsed() >= limit && !process.timed_out {
            process.timed_out = true;
            drop(process.child.kill());
        }
        drop(process);
        std::thread::sleep(LOOK_EVERY);
    }
}

/// Keeps the last part of what a stream says.
fn keep(mut stream: impl Read, kept: &Mutex<String>) {
    let mut chunk = [0; 1024];
    while let Ok(count @ 1..) = stream.read(&mut chunk) {
        let mut kept = lock(kept);
        kept.push_str(&String::from_utf8_lossy(&chunk[..count]));
        if kept.len() > STDERR_KEPT {
            let from =
                (kept.len() - STDERR_KEPT / 2..=kept.len()).find(|at| kept.is_char_boundary(*at));
            kept.drain(..from.unwrap_or_default());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn options(image: PathBuf) -> QemuOptions {
        QemuOptions {
            image,
            args: Vec::new(),
            icount: true,
            uart: false,
            gdb: false,
            time_limit: Duration::from_secs(60),
        }
    }

    #[test]
    fn a_missing_image_says_how_to_build_it() {
        for (image, board) in [
            ("no/such/sutura-virtual", "virtual"),
            ("no/such/sutura-olimex-h405", "olimex-h405"),
            ("no/such/sutura-selftest-olimex-h405", "olimex-h405"),
            ("no/such/sutura-mutants-olimex-h405", "olimex-h405"),
            ("no/such/image", "virtual"),
        ] {
            let Err(error) = Qemu::start(&options(image.into())) else {
                panic!("started")
            };
            let build = format!("`cargo xtask firmware --board {board}`");
            assert!(error.to_string().contains(&build), "{error}");
        }
    }

    #[test]
    fn commas_in_arguments_are_doubled_as_qemu_wants_them() {
        let mut options = options("image".into());
        options.args = vec!["lockstep".into(), "/tmp/a,b".into()];
        let line = command_line(&options, Path::new("/tmp"));
        let at = line.iter().position(|word| word == "-semihosting-config");
        let value = at
            .and_then(|at| line.get(at + 1))
            .and_then(|word| word.to_str());
        assert_eq!(
            value,
            Some("enable=on,target=native,arg=sutura,arg=lockstep,arg=/tmp/a,,b")
        );
    }

    #[test]
    fn stderr_keeps_its_end() {
        let kept = Mutex::default();
        let text: String = (0..9_000).map(|i| format!("{i}\u{e9}\n")).collect();
        keep(text.as_bytes(), &kept);
        let kept = lock(&kept);
        assert!(kept.len() <= STDERR_KEPT);
        assert!(
            kept.ends_with("8999\u{e9}\n"),
            "{}",
            &kept[kept.len() - 40..]
        );
    }
}
