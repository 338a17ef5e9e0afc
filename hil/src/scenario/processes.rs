//! Consoles and hosts as processes of their own, by the wall clock; a console at a port; the image under QEMU.
//!
//! Entry points: [`Processes`], [`AtPort`], [`Emulated`], [`Relay`]: each a [`Bench`]. The bench owns the console's port,
//! and a host that is a process has a pseudo-terminal in its place: whatever is said passes the bench both ways.

use super::host::{Host, HostError, ModelHost};
use super::peer::{ByTheClock, InLockstep, Peer, PeerError};
use super::run::Hosts;
use super::suite::Bench;
use super::{ConsoleKind, Ticks, World};
use crate::{Pty, PtyLink, QemuConsole};
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};
use sutura_host::link::{LinkError, Port, open_serial};
use sutura_shared::control::TICK_HZ;
use sutura_shared::link::{HostEvent, HostLink};
use sutura_shared::wire::MAX_FRAME;
use sutura_shared::wire::message::Command as Order;

/// The firmware's image may take this long for a scenario.
const IMAGE_LIMIT: Duration = Duration::from_secs(300);
/// Time for a console at a port to say who it is.
const ANSWERS_WITHIN: Duration = Duration::from_secs(3);
/// Longer than a session is owned after its host has gone.
const FREE_AGAIN: Duration = Duration::from_millis(400);

fn system(what: impl Into<String>) -> impl FnOnce(std::io::Error) -> PeerError {
    let what = what.into();
    move |source| PeerError::System { what, source }
}

/// A process that does not outlive its purpose: dropping it is SIGKILL.
struct Owned(Child);

impl Drop for Owned {
    fn drop(&mut self) {
        // An error means that it has already ended.
        drop(self.0.kill());
        drop(self.0.wait());
    }
}

/// `sutura console` and, where a scenario wants it, `sutura run`.
pub struct Processes {
    sutura: PathBuf,
    directory: tempfile::TempDir,
    consoles: AtomicU32,
}

impl Processes {
    /// With this `sutura` command.
    ///
    /// # Errors
    /// When the system has no temporary directory.
    pub fn new(sutura: PathBuf) -> Result<Self, PeerError> {
        let directory = tempfile::Builder::new().prefix("sutura-hil-").tempdir();
        Ok(Processes {
            sutura,
            directory: directory.map_err(system("no temporary directory"))?,
            consoles: AtomicU32::new(0),
        })
    }

    /// Starts a console in its place and opens its port.
    fn start(&self, link: &Path, off: &[String]) -> Result<(Owned, Box<dyn Port>), PeerError> {
        let mut command = Command::new(&self.sutura);
        command.arg("console").arg("--link").arg(link);
        if !off.is_empty() {
            command.arg("--without").arg(off.join(","));
        }
        let shown = self.sutura.display();
        let child = command
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .spawn()
            .map_err(system(format!("`{shown} console` cannot be started")))?;
        let mut console = Owned(child);
        // It says its port once it is there.
        let mut line = String::new();
        if let Some(stdout) = console.0.stdout.take() {
            let read = BufReader::new(stdout).read_line(&mut line);
            read.map_err(system("what the console said"))?;
        }
        Ok((console, open_serial(&link.to_string_lossy())?))
    }
}

impl Bench for Processes {
    fn kind(&self) -> ConsoleKind {
        ConsoleKind::Virtual
    }

    fn console(&self, off: &[String]) -> Result<Box<dyn Peer + '_>, PeerError> {
        let number = self.consoles.fetch_add(1, Ordering::Relaxed);
        let link = self.directory.path().join(format!("console-{number}"));
        let (console, port) = self.start(&link, off)?;
        let mut console = Some(console);
        let off = off.to_vec();
        let reopen = move || {
            // The old one first: the new one takes its place.
            drop(console.take());
            let (started, port) = self.start(&link, &off)?;
            console = Some(started);
            Ok(port)
        };
        let peer = ByTheClock::new(ConsoleKind::Virtual, port, Some(Box::new(reopen)));
        Ok(Box::new(peer))
    }

    fn hosts(&self) -> Box<Hosts<'_>> {
        Box::new(|scenario, generation, arms| match &scenario.host.world {
            // A process always arms.
            World::Tissue(scene) if scenario.host.process && arms => {
                let host = PtyHost::start(&self.sutura, scene, scenario.host.hz)?;
                Ok(Box::new(host))
            }
            _ => Ok(Box::new(ModelHost::new(scenario, generation, arms)?)),
        })
    }
}

/// A host behind a pseudo-terminal that stands for the console's port.
struct PtyHost {
    port: Box<dyn Port>,
    /// What the terminal did not take yet.
    waiting: Vec<u8>,
    _process: Option<Owned>,
}

impl PtyHost {
    fn start(sutura: &Path, scene: &Path, hz: f64) -> Result<Self, HostError> {
        let failed = |what: &str| {
            let what = what.to_owned();
            move |source| HostError::Process { what, source }
        };
        let pty = Pty::open().map_err(failed("no pseudo-terminal for the host"))?;
        let child = Command::new(sutura)
            .arg("run")
            .arg(scene)
            .args(["--console", pty.path(), "--seconds", "3600"])
            .args(["--host-hz", &hz.to_string()])
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .map_err(failed("`sutura run` cannot be started"))?;
        Ok(PtyHost {
            port: Box::new(pty),
            waiting: Vec::new(),
            _process: Some(Owned(child)),
        })
    }
}

impl Host for PtyHost {
    fn step(&mut self, _: Ticks, heard: &[u8], said: &mut Vec<u8>) -> Result<(), HostError> {
        self.waiting.extend_from_slice(heard);
        // A host that has ended takes nothing, and says nothing.
        let written = self.port.write(&self.waiting).unwrap_or(self.waiting.len());
        self.waiting.drain(..written);
        let mut chunk = [0; 4096];
        while let Ok(count @ 1..) = self.port.read(&mut chunk, Duration::ZERO) {
            said.extend(chunk.iter().take(count));
        }
        Ok(())
    }

    fn takes_its_time(&self) -> bool {
        true
    }
}

/// A virtual console for a host of somebody else's, with what goes wrong between the two.
pub struct Relay {
    processes: Processes,
    pty: Pty,
    _link: PtyLink,
}

impl Relay {
    /// The host finds the console at `link`.
    ///
    /// # Errors
    /// When the system gives no pseudo-terminal, or no link to it.
    pub fn new(sutura: PathBuf, link: PathBuf) -> Result<Self, PeerError> {
        let pty = Pty::open().map_err(system("no pseudo-terminal for the host"))?;
        let made = PtyLink::make(&link, pty.path());
        let link = made.map_err(system(format!("cannot make the link {}", link.display())))?;
        Ok(Relay {
            processes: Processes::new(sutura)?,
            pty,
            _link: link,
        })
    }
}

impl Bench for Relay {
    fn kind(&self) -> ConsoleKind {
        ConsoleKind::Virtual
    }

    fn console(&self, off: &[String]) -> Result<Box<dyn Peer + '_>, PeerError> {
        self.processes.console(off)
    }

    fn has_mutants(&self) -> bool {
        false
    }

    /// Where a scenario kills its host, this one is not heard any more until it is back.
    fn hosts(&self) -> Box<Hosts<'_>> {
        Box::new(|_, _, _| {
            let failed = |source| HostError::Process {
                what: "the host's pseudo-terminal".to_owned(),
                source,
            };
            Ok(Box::new(PtyHost {
                port: self.pty.try_clone().map_err(failed)?,
                waiting: Vec::new(),
                _process: None,
            }))
        })
    }
}

/// A console at a port.
pub struct AtPort {
    path: String,
    simulated: bool,
}

impl AtPort {
    /// Asks the console at a port who it is.
    ///
    /// # Errors
    /// When nobody answers.
    pub fn new(path: &str) -> Result<Self, PeerError> {
        let mut bench = AtPort {
            path: path.to_owned(),
            simulated: false,
        };
        bench.simulated = bench.prepare()?;
        Ok(bench)
    }

    /// Clears what an earlier scenario has left, and goes again; whether the console is simulated.
    fn prepare(&self) -> Result<bool, PeerError> {
        let mut port = open_serial(&self.path)?;
        let gone = |error: std::io::Error| LinkError::Gone {
            name: self.path.clone(),
            reason: error.to_string(),
        };
        let mut link = HostLink::new(TICK_HZ);
        let started = Instant::now();
        let (mut frame, mut chunk) = ([0; MAX_FRAME], [0; 4096]);
        let mut asked = None::<Instant>;
        let mut nonce = std::process::id();
        while started.elapsed() < ANSWERS_WITHIN {
            if asked.is_none_or(|asked| asked.elapsed() > FREE_AGAIN) {
                asked = Some(Instant::now());
                nonce = nonce.wrapping_add(1);
                let length = link.hello(nonce, &mut frame).unwrap_or_default();
                port.write(&[0]).map_err(gone)?;
                port.write(frame.get(..length).unwrap_or_default())
                    .map_err(gone)?;
            }
            let count = port
                .read(&mut chunk, Duration::from_millis(20))
                .map_err(gone)?;
            for byte in chunk.iter().take(count) {
                if let Some(HostEvent::Opened(console)) = link.receive(*byte) {
                    let length = link
                        .send(0, &Order::ClearFault, &mut frame)
                        .unwrap_or_default();
                    port.write(frame.get(..length).unwrap_or_default())
                        .map_err(gone)?;
                    std::thread::sleep(FREE_AGAIN);
                    return Ok(console.simulated);
                }
            }
        }
        Err(PeerError::Link(LinkError::NoAnswer {
            name: self.path.clone(),
            waited: ANSWERS_WITHIN,
            heard: "no answer to a Hello".to_owned(),
        }))
    }
}

impl Bench for AtPort {
    fn kind(&self) -> ConsoleKind {
        ConsoleKind::Port
    }

    fn console(&self, _: &[String]) -> Result<Box<dyn Peer + '_>, PeerError> {
        self.prepare()?;
        let port = open_serial(&self.path)?;
        Ok(Box::new(ByTheClock::new(ConsoleKind::Port, port, None)))
    }

    fn has_mutants(&self) -> bool {
        false
    }

    fn has_motors(&self) -> bool {
        !self.simulated
    }
}

/// The firmware's image under QEMU, in lockstep.
pub struct Emulated {
    /// The image.
    pub image: PathBuf,
}

impl Bench for Emulated {
    fn kind(&self) -> ConsoleKind {
        ConsoleKind::Qemu
    }

    fn console(&self, off: &[String]) -> Result<Box<dyn Peer + '_>, PeerError> {
        let off = off.to_vec();
        let boot = move |seed| {
            let console = QemuConsole::tuned(self.image.clone(), IMAGE_LIMIT, seed, &off)?;
            Ok(Box::new(console) as _)
        };
        Ok(Box::new(InLockstep::new(ConsoleKind::Qemu, boot)?))
    }
}
