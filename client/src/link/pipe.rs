//! A byte pipe in memory, with the same behaviour as a serial port.
//!
//! Entry point: [`pipe`]. It is the link to a virtual console in the same process, `sutura run`'s by default, and the bench for
//! tests of the link.

use super::port::Port;
use std::collections::VecDeque;
use std::io;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// How much one direction holds before writes take less than offered, as a kernel's terminal does \[bytes\].
const CAPACITY: usize = 4096;

#[derive(Debug, Default)]
struct Direction {
    bytes: Mutex<VecDeque<u8>>,
    arrived: Condvar,
}

impl Direction {
    fn bytes(&self) -> MutexGuard<'_, VecDeque<u8>> {
        self.bytes.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// One end of a [`pipe`]. The other end sees `BrokenPipe` once every handle to this one is dropped.
#[derive(Debug)]
pub struct PipeEnd {
    name: &'static str,
    incoming: Arc<Direction>,
    outgoing: Arc<Direction>,
    /// Held by all handles to this end.
    alive: Arc<()>,
    /// Upgradable while the other end is alive.
    peer: std::sync::Weak<()>,
}

/// Two connected ends.
pub fn pipe() -> (PipeEnd, PipeEnd) {
    let (ab, ba) = (
        Arc::new(Direction::default()),
        Arc::new(Direction::default()),
    );
    let (a, b) = (Arc::new(()), Arc::new(()));
    let first = PipeEnd {
        name: "in-memory pipe",
        incoming: ba.clone(),
        outgoing: ab.clone(),
        peer: Arc::downgrade(&b),
        alive: a.clone(),
    };
    let second = PipeEnd {
        name: "in-memory pipe",
        incoming: ab,
        outgoing: ba,
        peer: Arc::downgrade(&a),
        alive: b,
    };
    (first, second)
}

impl PipeEnd {
    fn peer_is_alive(&self) -> bool {
        self.peer.strong_count() > 0
    }
}

impl Drop for PipeEnd {
    fn drop(&mut self) {
        // The last handle must count as gone before the other end is woken to look.
        self.alive = Arc::new(());
        self.outgoing.arrived.notify_all();
    }
}

impl Port for PipeEnd {
    fn name(&self) -> String {
        self.name.to_owned()
    }

    fn read(&mut self, into: &mut [u8], wait: Duration) -> io::Result<usize> {
        let deadline = Instant::now() + wait;
        let mut bytes = self.incoming.bytes();
        loop {
            if !bytes.is_empty() {
                let count = bytes.len().min(into.len());
                for (to, from) in into.iter_mut().zip(bytes.drain(..count)) {
                    *to = from;
                }
                return Ok(count);
            }
            if !self.peer_is_alive() {
                return Err(io::ErrorKind::BrokenPipe.into());
            }
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Ok(0);
            }
            bytes = self
                .incoming
                .arrived
                .wait_timeout(bytes, left)
                .unwrap_or_else(PoisonError::into_inner)
                .0;
        }
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if !self.peer_is_alive() {
            return Err(io::ErrorKind::BrokenPipe.into());
        }
        let mut held = self.outgoing.bytes();
        let count = bytes.len().min(CAPACITY - held.len());
        held.extend(&bytes[..count]);
        drop(held);
        self.outgoing.arrived.notify_all();
        Ok(count)
    }

    fn try_clone(&self) -> io::Result<Box<dyn Port>> {
        Ok(Box::new(PipeEnd {
            name: self.name,
            incoming: self.incoming.clone(),
            outgoing: self.outgoing.clone(),
            alive: self.alive.clone(),
            peer: self.peer.clone(),
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::error::Error;

    const LONG: Duration = Duration::from_secs(600);

    #[test]
    fn bytes_cross_in_order_and_a_full_pipe_takes_less() -> Result<(), Box<dyn Error>> {
        let (mut a, mut b) = pipe();
        assert_eq!(
            b.read(&mut [0; 8], Duration::ZERO)?,
            0,
            "nothing there is not an error"
        );
        let sent: Vec<u8> = (0..=255).cycle().take(CAPACITY + 1).collect();
        assert_eq!(a.write(&sent)?, CAPACITY);
        assert_eq!(a.write(&sent)?, 0);
        let mut got = vec![0; CAPACITY];
        assert_eq!(b.read(&mut got[..10], LONG)?, 10);
        assert_eq!(b.read(&mut got[10..], LONG)?, CAPACITY - 10);
        assert_eq!(got, sent[..CAPACITY]);
        Ok(())
    }

    #[test]
    fn a_dropped_end_is_a_broken_pipe_after_its_last_bytes() -> Result<(), Box<dyn Error>> {
        let (mut a, mut b) = pipe();
        let second_handle = a.try_clone()?;
        a.write(&[1])?;
        drop(a);
        assert_eq!(b.read(&mut [0; 8], LONG)?, 1);
        assert_eq!(
            b.read(&mut [0; 8], Duration::ZERO)?,
            0,
            "one handle is left"
        );
        std::thread::scope(|scope| {
            let waiting = scope.spawn(|| b.read(&mut [0; 8], LONG).map_err(|e| e.kind()));
            drop(second_handle);
            assert_eq!(waiting.join().ok(), Some(Err(io::ErrorKind::BrokenPipe)));
        });
        assert_eq!(
            b.write(&[2]).map_err(|e| e.kind()),
            Err(io::ErrorKind::BrokenPipe)
        );
        Ok(())
    }
}
