//! How a session begins: a port, and a console at its other end that answers.
//!
//! Entry point: [`shake_hands`].

use super::{LinkError, LinkOptions, Port};
use std::hash::{BuildHasher, Hasher, RandomState};
use std::io;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use sutura_shared::link::{HostEvent, HostLink};
use sutura_shared::wire::MAX_FRAME;
use sutura_shared::wire::message::Hello;

/// How long a `Hello` may stay unanswered before another one is sent: a console answers within a few
/// ticks, even over the emulator's UART (0.1 s).
const ASK_AGAIN: Duration = Duration::from_millis(400);
/// The same for a console that another host uses.
const ASK_OWNED_AGAIN: Duration = Duration::from_millis(50);
/// How long a read waits before the thread looks whether it should end.
pub(super) const READ_WAIT: Duration = Duration::from_millis(50);

/// A lock that outlives a panicking thread: the data are plain values, always whole.
pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A number that nobody can guess from the last one.
pub fn nonce() -> u32 {
    RandomState::new().build_hasher().finish() as u32
}

fn describe(error: &io::Error) -> String {
    match error.kind() {
        io::ErrorKind::BrokenPipe => "it closed its end of the line".to_owned(),
        _ => error.to_string(),
    }
}

pub(super) fn gone(name: &str, error: &io::Error) -> LinkError {
    LinkError::Gone {
        name: name.to_owned(),
        reason: describe(error),
    }
}

/// Writes everything, or gives up while the port takes nothing.
pub(super) fn write_all(
    port: &mut dyn Port,
    mut bytes: &[u8],
    give_up: impl Fn() -> bool,
) -> io::Result<()> {
    while !bytes.is_empty() {
        let count = port.write(bytes)?;
        bytes = &bytes[count..];
        if count == 0 {
            if give_up() {
                return Err(io::ErrorKind::TimedOut.into());
            }
            // A full line drains within a tick or two of the console.
            std::thread::sleep(Duration::from_millis(1));
        }
    }
    Ok(())
}

/// Asks whether a console of this protocol is at the other end of `port`; what it says of itself. The session that this
/// opens is nobody's: the next host's `Hello` takes its place, and a session that has a host is left alone.
///
/// # Errors
/// [`LinkError::NoAnswer`], [`LinkError::Owned`], [`LinkError::Mismatch`], [`LinkError::GivenUp`], or [`LinkError::Gone`].
pub fn knock(port: &mut dyn Port, options: &LinkOptions) -> Result<Hello, LinkError> {
    let end = Mutex::new(HostLink::new(options.tick_hz));
    let (console, _) = shake_hands(port, &end, options.answer_within, options.give_up)?;
    Ok(console)
}

/// A console says nothing for so long once a session that nobody uses has expired: many ticks.
const QUIET: Duration = Duration::from_millis(20);
/// That takes a second after a [`knock`]; one that talks on is left to the handshake.
const QUIET_WITHIN: Duration = Duration::from_millis(1500);

/// Reads what comes over `port` and is of no use any more, such as the states of the session that [`knock`] opened, until
/// nothing comes, or the caller [gives up](LinkOptions::give_up).
///
/// # Errors
/// [`LinkError::Gone`].
pub fn drain(port: &mut dyn Port, options: &LinkOptions) -> Result<(), LinkError> {
    let mut chunk = [0; 4096];
    let began = Instant::now();
    while began.elapsed() < QUIET_WITHIN && !(options.give_up)() {
        match port.read(&mut chunk, QUIET) {
            Ok(0) => break,
            Ok(_) => {}
            Err(error) => return Err(gone(&port.name(), &error)),
        }
    }
    Ok(())
}

/// Asks for a session until the console answers; what it said of itself, and the bytes behind its answer. Ends early
/// once it is to `give_up`.
pub(super) fn shake_hands(
    port: &mut dyn Port,
    end: &Mutex<HostLink>,
    within: Duration,
    give_up: impl Fn() -> bool,
) -> Result<(Hello, Vec<u8>), LinkError> {
    let name = port.name();
    let started = Instant::now();
    let late = || started.elapsed() >= within || give_up();
    let (mut frame, mut chunk) = ([0; MAX_FRAME], [0; 4096]);
    let mut question = Vec::with_capacity(MAX_FRAME);
    let (mut heard, mut owned) = (0, false);
    while !late() {
        let asked = Instant::now();
        let mut again = ASK_AGAIN;
        let length = lock(end).hello(nonce(), &mut frame).unwrap_or_default();
        // A delimiter first: it ends whatever half a frame an earlier host left on the line.
        question.clear();
        question.push(0);
        question.extend_from_slice(&frame[..length]);
        write_all(port, &question, late).map_err(|error| match give_up() {
            true => LinkError::GivenUp { name: name.clone() },
            false => gone(&name, &error),
        })?;
        while asked.elapsed() < again && !late() {
            let count = port
                .read(&mut chunk, READ_WAIT)
                .map_err(|error| gone(&name, &error))?;
            heard += count;
            for (at, byte) in chunk[..count].iter().enumerate() {
                match lock(end).receive(*byte) {
                    Some(HostEvent::Opened(console)) => {
                        return Ok((console, chunk[at + 1..count].to_vec()));
                    }
                    Some(HostEvent::Refused(mismatch)) => {
                        return Err(LinkError::Mismatch { name, mismatch });
                    }
                    // Its host may be gone, and its session with it before long.
                    Some(HostEvent::Owned) => (owned, again) = (true, ASK_OWNED_AGAIN),
                    _ => {}
                }
            }
        }
    }
    if give_up() {
        return Err(LinkError::GivenUp { name });
    }
    if owned {
        return Err(LinkError::Owned { name });
    }
    if let Some(mismatch) = lock(end).unusable_answer() {
        return Err(LinkError::Mismatch { name, mismatch });
    }
    let heard = match (heard, lock(end).counters().frames_rejected) {
        (0, _) => "nothing came".to_owned(),
        (_, 0) => format!("{heard} bytes came, no whole frame"),
        (_, rejected) => format!("{heard} bytes came, {rejected} frames were refused"),
    };
    Err(LinkError::NoAnswer {
        name,
        waited: within,
        heard,
    })
}
