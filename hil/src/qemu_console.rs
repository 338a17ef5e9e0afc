//! The firmware image under QEMU, one control tick per exchange over two named pipes.
//!
//! Entry point: [`QemuConsole::start`]. The image opens the pipes through semihosting, in the order
//! down, up. One exchange: down a u16 length and that many bytes, up the same; all little endian. The highest bit of
//! the length down says that the tick before overran; 0xFFFF tells the image to end.

use crate::qemu::{Qemu, QemuError, QemuOptions};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{Mode, OFlags};
use std::fs::File;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;
use sutura_host::link::{LinkError, LockstepConsole};

/// Tells the image to end.
const QUIT: u16 = 0xFFFF;
/// Beside the length of a message down: the tick before took longer than its period.
const OVERRAN: u16 = 0x8000;

/// How often is looked whether the image has opened its end, or has ended.
const LOOK_EVERY: Duration = Duration::from_millis(5);

/// The emulated console in lockstep. Dropping it ends the emulator.
#[derive(Debug)]
pub struct QemuConsole {
    qemu: Qemu,
    down: File,
    up: File,
    /// One message down, length first.
    message: Vec<u8>,
    /// Whether the next message says that the tick before overran.
    overran: bool,
    /// Whether the image has answered yet.
    answered: bool,
    /// Where the pipes are; the image opens the second one only after the first.
    _pipes: tempfile::TempDir,
}

impl QemuConsole {
    /// Boots the image and opens the pipes to it.
    ///
    /// # Errors
    /// See [`QemuError`].
    pub fn start(image: PathBuf, time_limit: Duration) -> Result<QemuConsole, QemuError> {
        QemuConsole::tuned(image, time_limit, 0, &[])
    }

    /// With another seed for session numbers, and without the guards of these names.
    ///
    /// # Errors
    /// See [`QemuError`]; the image itself ends when a name is none.
    pub fn tuned(
        image: PathBuf,
        time_limit: Duration,
        seed: u32,
        off: &[String],
    ) -> Result<QemuConsole, QemuError> {
        let pipes = tempfile::Builder::new()
            .prefix("sutura-lockstep-")
            .tempdir()
            .map_err(system("no temporary directory"))?;
        let (down, up) = (pipes.path().join("down"), pipes.path().join("up"));
        make_pipes(&[&down, &up])?;
        let mut args = vec![
            "lockstep".to_owned(),
            down.to_string_lossy().into(),
            up.to_string_lossy().into(),
        ];
        if seed != 0 {
            args.push(format!("seed={seed}"));
        }
        if !off.is_empty() {
            args.push(format!("off={}", off.join(",")));
        }
        let qemu = Qemu::start(&QemuOptions {
            image,
            args,
            icount: true,
            uart: false,
            gdb: false,
            time_limit,
        })?;
        // Opening a pipe waits for the other end for ever, unless told not to wait at all.
        let up = open(&up, OFlags::RDONLY)?;
        let down = open_for_writing(&down, &qemu)?;
        for pipe in [&down, &up] {
            rustix::fs::fcntl_setfl(pipe, OFlags::empty())
                .map_err(io::Error::from)
                .map_err(system("a pipe"))?;
        }
        Ok(QemuConsole {
            qemu,
            down,
            up,
            message: Vec::new(),
            overran: false,
            answered: false,
            _pipes: pipes,
        })
    }

    /// Tells the image to end and waits for it.
    ///
    /// # Errors
    /// When it ends with another code than 0 or not in time, or when QEMU logged something unexpected.
    pub fn quit(mut self) -> Result<(), QemuError> {
        // If the image is already gone, its end is what there is to report.
        drop(self.down.write_all(&QUIT.to_le_bytes()));
        let status = self.qemu.wait()?;
        if !status.success() {
            return Err(self.qemu.ending());
        }
        self.qemu.check_log(|_| false)
    }

    fn try_exchange(&mut self, down: &[u8], up: &mut Vec<u8>) -> io::Result<()> {
        let length = u16::try_from(down.len())
            .ok()
            .filter(|length| *length < OVERRAN);
        let length =
            length.ok_or_else(|| io::Error::other("more bytes than one exchange carries"))?;
        let overran = if std::mem::take(&mut self.overran) {
            OVERRAN
        } else {
            0
        };
        self.message.clear();
        self.message
            .extend_from_slice(&(length | overran).to_le_bytes());
        self.message.extend_from_slice(down);
        self.down.write_all(&self.message)?;
        if !self.answered {
            // Until the image has opened its end, a read would take that for the end of the stream.
            wait_for_data(&self.up, &self.qemu)?;
            self.answered = true;
        }
        let mut length = [0; 2];
        self.up.read_exact(&mut length)?;
        let start = up.len();
        up.resize(start + usize::from(u16::from_le_bytes(length)), 0);
        self.up.read_exact(&mut up[start..])
    }
}

impl LockstepConsole for QemuConsole {
    fn exchange(&mut self, down: &[u8], up: &mut Vec<u8>) -> Result<(), LinkError> {
        self.try_exchange(down, up).map_err(|error| {
            let reason = match error.kind() {
                io::ErrorKind::BrokenPipe | io::ErrorKind::UnexpectedEof => {
                    self.qemu.ending().to_string()
                }
                _ => error.to_string(),
            };
            LinkError::Gone {
                name: self.name().to_owned(),
                reason,
            }
        })
    }

    fn overran(&mut self) {
        self.overran = true;
    }

    fn name(&self) -> &str {
        "qemu"
    }
}

fn system(what: &'static str) -> impl FnOnce(io::Error) -> QemuError {
    move |source| QemuError::System {
        what: what.to_owned(),
        source,
    }
}

/// Named pipes come from the system's own program: not every system has the call in a safe wrapper.
fn make_pipes(paths: &[&Path]) -> Result<(), QemuError> {
    let made = Command::new("mkfifo")
        .args(paths)
        .status()
        .map_err(system("`mkfifo` cannot be started"))?;
    if made.success() {
        Ok(())
    } else {
        Err(system("`mkfifo` failed")(io::Error::other(
            made.to_string(),
        )))
    }
}

fn open(path: &Path, access: OFlags) -> Result<File, QemuError> {
    let file = rustix::fs::open(
        path,
        access | OFlags::NONBLOCK | OFlags::CLOEXEC,
        Mode::empty(),
    );
    file.map(File::from)
        .map_err(io::Error::from)
        .map_err(system("a pipe to the emulator cannot be opened"))
}

/// Opens the pipe down once the image reads from it.
fn open_for_writing(path: &Path, qemu: &Qemu) -> Result<File, QemuError> {
    loop {
        match open(path, OFlags::WRONLY) {
            Err(QemuError::System { source, .. }) if source.raw_os_error() == Some(NO_READER) => {
                if !qemu.is_running() {
                    return Err(qemu.ending());
                }
                std::thread::sleep(LOOK_EVERY);
            }
            done => return done,
        }
    }
}

/// What the system says while nobody reads from a pipe (ENXIO).
const NO_READER: i32 = rustix::io::Errno::NXIO.raw_os_error();

/// Waits until there is something to read, or until the image has ended.
fn wait_for_data(up: &File, qemu: &Qemu) -> io::Result<()> {
    let timeout = Timespec {
        tv_sec: 0,
        tv_nsec: 20_000_000,
    };
    loop {
        let mut fds = [PollFd::new(up, PollFlags::IN)];
        if poll(&mut fds, Some(&timeout))? > 0 || !qemu.is_running() {
            return Ok(());
        }
    }
}
