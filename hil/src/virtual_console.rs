//! A console in a thread: the shared simulation at its tick rate by the wall clock, behind a port.
//!
//! Entry points: [`VirtualConsole::start`] for one behind a pseudo-terminal of its own,
//! [`VirtualConsole::start_in_memory`] for this process alone, [`serve`] for the loop itself. A tick that the desktop wakes late is run and counted, never skipped, so that console
//! time keeps step with the wall clock.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
#[cfg(unix)]
use sutura_host::link::open_serial;
use sutura_host::link::{LinkError, PipeEnd, Port, nonce};
use sutura_host::scheduling::{Duty, Granted, Role};
use sutura_host::session::ConsoleLimits;
use sutura_shared::control::TicksLimited;
use sutura_shared::device::DeviceDescription;
use sutura_shared::simulated_console::{Pace, SimulatedConsole, Without};

/// Bytes that may wait for a host that does not read; then whole frames are dropped. One second of a
/// thousand states would be 110 kB: by then the host is gone.
const BACKLOG: usize = 16 * 1024;

/// Bytes read from the line at once; more stay for the next round.
const CHUNK: usize = 4096;

/// A console running in a thread of this process. Dropping it stops it.
#[derive(Debug)]
pub struct VirtualConsole {
    host_end: HostEnd,
    stop: Arc<AtomicBool>,
    granted: Arc<OnceLock<Granted>>,
    limited: Arc<Mutex<TicksLimited>>,
    thread: Option<JoinHandle<()>>,
}

impl VirtualConsole {
    /// Starts a console that is `device` until a host tells it otherwise.
    ///
    /// # Errors
    /// [`LinkError::Open`] when the system gives no pseudo-terminal or no thread.
    pub fn start(device: &DeviceDescription) -> Result<VirtualConsole, LinkError> {
        VirtualConsole::start_without(device, Without::default())
    }

    /// Starts one without some of its guards and checks, to see whether a test notices.
    ///
    /// # Errors
    /// As [`start`](Self::start).
    pub fn start_without(
        device: &DeviceDescription,
        without: Without,
    ) -> Result<VirtualConsole, LinkError> {
        let (port, host_end) = open_line()?;
        VirtualConsole::behind(port, host_end, device, without)
    }

    /// Starts one behind a pipe in this process's memory: bytes wake whoever waits for them. A pseudo-terminal hands them
    /// to a thread of the kernel first, which on a busy machine keeps them for milliseconds, whatever the priority of the
    /// threads at its ends.
    ///
    /// # Errors
    /// [`LinkError::Open`] when the system gives no thread.
    pub fn start_in_memory(device: &DeviceDescription) -> Result<VirtualConsole, LinkError> {
        let (console, host) = sutura_host::link::pipe();
        let host_end = HostEnd::Pipe(Some(host));
        VirtualConsole::behind(Box::new(console), host_end, device, Without::default())
    }

    fn behind(
        port: Box<dyn Port>,
        host_end: HostEnd,
        device: &DeviceDescription,
        without: Without,
    ) -> Result<VirtualConsole, LinkError> {
        let Without { tuning, checks } = without;
        let console = SimulatedConsole::tuned(device, nonce(), tuning, checks)
            .map_err(|error| unusable(&format!("the device is unusable: {error}")))?;
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = stop.clone();
        let granted = Arc::new(OnceLock::new());
        let asked = granted.clone();
        let limited = Arc::new(Mutex::new(TicksLimited::default()));
        let counted = limited.clone();
        let thread = std::thread::Builder::new()
            .name("sutura-console".to_owned())
            .spawn(move || {
                let duty = Duty::begin(Role::Console);
                // Nobody else sets it.
                let _ = asked.set(duty.granted());
                run(console, port, &stopped, Some((duty, &counted)));
            })
            .map_err(|error| unusable(&error.to_string()))?;
        Ok(VirtualConsole {
            host_end,
            stop,
            granted,
            limited,
            thread: Some(thread),
        })
    }

    /// What its thread got of the system.
    pub fn granted(&self) -> Granted {
        self.granted.get().copied().unwrap_or_default()
    }

    /// Counts, for a session, the ticks in which a limit of the device took a part of the force away.
    pub fn limits(&self) -> ConsoleLimits {
        let limited = self.limited.clone();
        Box::new(move || *limited.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// The path that a host opens; none on systems without pseudo-terminals.
    pub fn path(&self) -> Option<&str> {
        match &self.host_end {
            #[cfg(unix)]
            HostEnd::Terminal(path) => Some(path),
            HostEnd::Pipe(_) => None,
        }
    }

    /// Opens the host's end, as a host would.
    ///
    /// # Errors
    /// See [`sutura_host::link::open_serial`]; a pipe in memory can be opened once.
    pub fn host_port(&mut self) -> Result<Box<dyn Port>, LinkError> {
        match &mut self.host_end {
            #[cfg(unix)]
            HostEnd::Terminal(path) => open_serial(path),
            HostEnd::Pipe(end) => match end.take() {
                Some(end) => Ok(Box::new(end)),
                None => Err(LinkError::Busy {
                    name: "the in-memory pipe".to_owned(),
                    by: None,
                }),
            },
        }
    }
}

impl Drop for VirtualConsole {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the virtual console panicked");
        }
    }
}

/// Where a host finds the console.
#[derive(Debug)]
enum HostEnd {
    /// At a pseudo-terminal.
    #[cfg(unix)]
    Terminal(String),
    /// In this process alone.
    Pipe(Option<PipeEnd>),
}

#[cfg(unix)]
fn open_line() -> Result<(Box<dyn Port>, HostEnd), LinkError> {
    let pty =
        crate::Pty::open().map_err(|error| unusable(&format!("no pseudo-terminal: {error}")))?;
    let path = pty.path().to_owned();
    Ok((Box::new(pty), HostEnd::Terminal(path)))
}

#[cfg(not(unix))]
fn open_line() -> Result<(Box<dyn Port>, HostEnd), LinkError> {
    let (console, host) = sutura_host::link::pipe();
    Ok((Box::new(console), HostEnd::Pipe(Some(host))))
}

fn unusable(reason: &str) -> LinkError {
    LinkError::Open {
        name: "virtual".to_owned(),
        reason: reason.to_owned(),
    }
}

/// Runs `console` at its tick rate behind `port` until `stop` is set.
pub fn serve(console: SimulatedConsole, port: Box<dyn Port>, stop: &AtomicBool) {
    run(console, port, stop, None);
}

fn run(
    mut console: SimulatedConsole,
    mut port: Box<dyn Port>,
    stop: &AtomicBool,
    mut own: Option<(Duty, &Mutex<TicksLimited>)>,
) {
    let period = Duration::from_secs(1) / u32::from(console.tick_hz());
    let mut chunk = [0; CHUNK];
    let (mut fresh, mut waiting) = (Vec::new(), Vec::new());
    let mut pace = Pace::default();
    let mut due = Instant::now() + period;
    while !stop.load(Ordering::Relaxed) {
        if let Some((duty, _)) = &mut own {
            duty.look();
        }
        let now = Instant::now();
        if let Some(early) = due.checked_duration_since(now) {
            std::thread::sleep(early);
        }
        pace.late = due.elapsed() >= period;
        // Its time before this tick goes on from the last one.
        console.wait(micros(due.elapsed() + period));
        let began = computing_time();
        // A host that came and went leaves errors behind, and another one may come: nothing to hear.
        while let Ok(count @ 1..) = port.read(&mut chunk, Duration::ZERO) {
            console.feed(&chunk[..count]);
        }
        console.tick(pace);
        // A reader that comes at the wrong moment sees it one tick later.
        if let Some(Ok(mut limited)) = own.as_ref().map(|(_, limited)| limited.try_lock()) {
            *limited = console.control().ticks_limited();
        }
        fresh.clear();
        console.wait(micros(due.elapsed()));
        console.drain(&mut fresh);
        if waiting.len() + fresh.len() <= BACKLOG {
            waiting.extend_from_slice(&fresh);
        }
        let written = port.write(&waiting).unwrap_or(waiting.len());
        waiting.drain(..written);
        pace.overrun = computing_time().saturating_sub(began) > period;
        due += period;
    }
}

fn micros(time: Duration) -> u64 {
    u64::try_from(time.as_micros()).unwrap_or(u64::MAX)
}

/// Time that this thread has computed. Time in which the desktop let others run is lateness, not computation.
fn computing_time() -> Duration {
    #[cfg(unix)]
    {
        let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
        Duration::new(
            time.tv_sec.unsigned_abs(),
            u32::try_from(time.tv_nsec).unwrap_or_default(),
        )
    }
    #[cfg(not(unix))]
    {
        static START: std::sync::OnceLock<Instant> = std::sync::OnceLock::new();
        START.get_or_init(Instant::now).elapsed()
    }
}
