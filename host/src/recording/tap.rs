//! Where a session's bytes and solves are told as they pass.
//!
//! Entry point: [`Tap`]. Telling never waits: what finds no room in the queue is left out and counted, and the numbers
//! that follow each other show where.

use super::SolveSample;
use super::scene_sample::Sketch;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Sender, SyncSender, TrySendError};
use std::time::{Instant, SystemTime, UNIX_EPOCH};

/// Which way bytes went.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Direction {
    /// To the console.
    Down,
    /// From the console.
    Up,
}

/// What waits for the writer.
#[derive(Debug)]
pub(super) enum Event {
    /// Bytes of the line, whole frames or not.
    Bytes {
        direction: Direction,
        /// Counts the events of this direction, those that were left out too.
        number: u64,
        time_ns: u64,
        bytes: Vec<u8>,
    },
    /// A solve.
    Solve {
        number: u64,
        time_ns: u64,
        sample: Box<SolveSample>,
    },
    /// Where needles, threads and tools are.
    Sketch {
        number: u64,
        time_ns: u64,
        sketch: Sketch,
    },
    /// Write the last seconds to a file, and say how that went.
    Save {
        path: PathBuf,
        done: Sender<Result<u64, super::RecordingError>>,
    },
    /// End the file, and say how long it is.
    Close {
        done: Sender<Result<u64, super::RecordingError>>,
    },
    /// Nothing comes any more.
    End,
}

#[derive(Debug)]
struct Shared {
    queue: SyncSender<Event>,
    clock: Clock,
    whole: bool,
    numbers: [AtomicU64; 4],
    lost: [AtomicU64; 4],
}

#[derive(Debug)]
enum Clock {
    Wall {
        began: Instant,
        began_ns: u64,
    },
    /// Of a session in lockstep, so that two recordings of it are the same \[ns\].
    Ticks(AtomicU64),
}

/// A handle for whoever has something to tell; the default one tells nobody.
#[derive(Clone, Debug, Default)]
pub struct Tap(Option<Arc<Shared>>);

/// How much found no room in the queue.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Lost {
    /// Pieces of what went to the console.
    pub down: u64,
    /// Pieces of what came from it.
    pub up: u64,
    /// Solves.
    pub solves: u64,
}

impl Tap {
    /// `whole`: the session is recorded as a whole, so that it can be replayed.
    pub(super) fn new(queue: SyncSender<Event>, lockstep: bool, whole: bool) -> Tap {
        let now = SystemTime::now().duration_since(UNIX_EPOCH);
        let began_ns = now.map_or(0, |now| u64::try_from(now.as_nanos()).unwrap_or_default());
        Tap(Some(Arc::new(Shared {
            queue,
            clock: if lockstep {
                Clock::Ticks(AtomicU64::new(0))
            } else {
                Clock::Wall {
                    began: Instant::now(),
                    began_ns,
                }
            },
            whole,
            numbers: Default::default(),
            lost: Default::default(),
        })))
    }

    /// Whether anybody hears it.
    pub fn is_heard(&self) -> bool {
        self.0.is_some()
    }

    /// Whether what is told is for a replay, which needs to know what nobody looks at.
    pub fn is_for_replay(&self) -> bool {
        self.0.as_deref().is_some_and(|shared| shared.whole)
    }

    /// Bytes that went one way.
    pub fn bytes(&self, direction: Direction, bytes: &[u8]) {
        let Some(shared) = self.0.as_deref().filter(|_| !bytes.is_empty()) else {
            return;
        };
        let number = shared.number(direction as usize);
        shared.tell(
            direction as usize,
            Event::Bytes {
                direction,
                number,
                time_ns: shared.clock.now_ns(),
                bytes: bytes.to_vec(),
            },
        );
    }

    /// A solve.
    pub fn solve(&self, sample: SolveSample) {
        let Some(shared) = self.0.as_deref() else {
            return;
        };
        let number = shared.number(SOLVES);
        let event = Event::Solve {
            number,
            time_ns: shared.clock.now_ns(),
            sample: Box::new(sample),
        };
        shared.tell(SOLVES, event);
    }

    /// A sketch of the scene; one that is left out is only seen in its channel's numbers.
    pub(super) fn sketch(&self, sketch: Sketch) {
        if let Some(shared) = self.0.as_deref() {
            let event = Event::Sketch {
                number: shared.number(SKETCHES),
                time_ns: shared.clock.now_ns(),
                sketch,
            };
            shared.tell(SKETCHES, event);
        }
    }

    /// In lockstep: another tick has been run.
    pub fn ticked(&self, period_ns: u64) {
        if let Some(Clock::Ticks(now_ns)) = self.0.as_deref().map(|shared| &shared.clock) {
            now_ns.fetch_add(period_ns, Ordering::Relaxed);
        }
    }

    /// Whether times are those of the wall clock.
    pub(super) fn keeps_wall_time(&self) -> bool {
        let clock = self.0.as_deref().map(|shared| &shared.clock);
        matches!(clock, Some(Clock::Wall { .. }))
    }

    /// Waits for room: for what must not be left out.
    pub(super) fn must_tell(&self, event: Event) -> bool {
        let shared = self.0.as_deref();
        shared.is_some_and(|shared| shared.queue.send(event).is_ok())
    }

    /// What found no room so far.
    pub fn lost(&self) -> Lost {
        let lost = |which: usize| {
            self.0
                .as_deref()
                .map_or(0, |shared| shared.lost[which].load(Ordering::Relaxed))
        };
        Lost {
            down: lost(Direction::Down as usize),
            up: lost(Direction::Up as usize),
            solves: lost(SOLVES),
        }
    }
}

/// Place of the solves among the counters; the directions come before.
const SOLVES: usize = 2;
/// And that of sketches.
const SKETCHES: usize = 3;

impl Shared {
    fn number(&self, which: usize) -> u64 {
        self.numbers[which].fetch_add(1, Ordering::Relaxed) + 1
    }

    fn tell(&self, which: usize, event: Event) {
        if let Err(TrySendError::Full(_)) = self.queue.try_send(event) {
            self.lost[which].fetch_add(1, Ordering::Relaxed);
        }
    }
}

impl Clock {
    fn now_ns(&self) -> u64 {
        match self {
            Clock::Wall { began, began_ns } => {
                let since = u64::try_from(began.elapsed().as_nanos()).unwrap_or(u64::MAX);
                began_ns.saturating_add(since)
            }
            Clock::Ticks(now_ns) => now_ns.load(Ordering::Relaxed),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc::sync_channel;

    /// Whoever tells something goes on at once; what found no room is counted, and its number is not given again.
    #[test]
    fn a_full_queue_leaves_out_and_counts() {
        let (queue, events) = sync_channel(2);
        let tap = Tap::new(queue, false, true);
        for _ in 0..5 {
            tap.bytes(Direction::Up, &[1, 0]);
        }
        tap.bytes(Direction::Down, &[2, 0]);
        tap.bytes(Direction::Down, &[]);
        let lost = Lost {
            up: 3,
            down: 1,
            solves: 0,
        };
        assert_eq!(tap.lost(), lost);
        let numbers = || {
            let event = events.try_recv().ok()?;
            let Event::Bytes {
                direction, number, ..
            } = event
            else {
                return None;
            };
            Some((direction, number))
        };
        assert_eq!(numbers(), Some((Direction::Up, 1)));
        assert_eq!(numbers(), Some((Direction::Up, 2)));
        assert_eq!(numbers(), None);
        tap.bytes(Direction::Up, &[1, 0]);
        tap.bytes(Direction::Down, &[2, 0]);
        assert_eq!(numbers(), Some((Direction::Up, 6)));
        assert_eq!(numbers(), Some((Direction::Down, 2)));
        assert_eq!(tap.lost(), lost);
    }
}
