//! The last seconds of a session, in memory.
//!
//! Entry point: [`Ring::push`]. Bounded in time and bytes; what is oldest goes first. What opened the session (the device,
//! the hand, orders) is long gone by the time that anybody wants to see the rest, so that such a file is for looking at.

use super::file::Entry;
use std::collections::VecDeque;
use std::time::Duration;

/// How much is kept.
pub const LAST: Duration = Duration::from_secs(30);
/// And at most so many bytes, with what the list itself takes: 30 s of 1000 states, 1000 contacts and 1000 solves a second are
/// less than half.
pub const LAST_BYTES: usize = 64 << 20;

/// The newest entries.
#[derive(Debug)]
pub struct Ring {
    entries: VecDeque<Entry>,
    last: Duration,
    most_bytes: usize,
    bytes: usize,
}

/// What an entry takes \[bytes\].
fn size(entry: &Entry) -> usize {
    // Its bytes stand behind two counters of their own.
    size_of::<Entry>() + entry.bytes.len() + 2 * size_of::<usize>()
}

impl Ring {
    /// An empty one that keeps `last`, and at most `most_bytes`.
    pub fn new(last: Duration, most_bytes: usize) -> Ring {
        Ring {
            entries: VecDeque::new(),
            last,
            most_bytes,
            bytes: 0,
        }
    }

    /// Appends an entry; those that are too old, or too much, go.
    pub fn push(&mut self, entry: Entry) {
        let last_ns = u64::try_from(self.last.as_nanos()).unwrap_or(u64::MAX);
        let oldest_ns = entry.time_ns.saturating_sub(last_ns);
        self.bytes += size(&entry);
        self.entries.push_back(entry);
        while let Some(oldest) = self.entries.front() {
            if oldest.time_ns >= oldest_ns && self.bytes <= self.most_bytes {
                break;
            }
            self.bytes -= size(oldest);
            self.entries.pop_front();
        }
    }

    /// What is kept, oldest first.
    pub fn entries(&self) -> impl Iterator<Item = &Entry> {
        self.entries.iter()
    }

    /// What that takes \[bytes\].
    pub fn bytes(&self) -> usize {
        self.bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Whatever comes: within its bytes and its time, and what is kept is the newest without a gap.
        #[test]
        fn it_is_bounded_and_keeps_the_newest(
            entries in prop::collection::vec((0_u64..5_000, 0_usize..400), 1..200),
            most_bytes in 0_usize..5_000,
            last_ns in 0_u64..50_000,
        ) {
            let mut ring = Ring::new(Duration::from_nanos(last_ns), most_bytes);
            let mut time_ns = 0;
            for (sequence, (step_ns, length)) in (1..).zip(&entries) {
                time_ns += step_ns;
                ring.push(Entry {
                    topic: crate::recording::UP,
                    sequence,
                    time_ns,
                    bytes: vec![0; *length].into(),
                });
                prop_assert!(ring.bytes() <= most_bytes);
                let sum: usize = ring.entries().map(size).sum();
                prop_assert_eq!(ring.bytes(), sum);
                let kept: Vec<_> = ring.entries().map(|entry| entry.sequence).collect();
                let newest: Vec<_> = (sequence + 1 - kept.len() as u32..=sequence).collect();
                prop_assert_eq!(&kept, &newest);
                prop_assert!(ring.entries().all(|entry| entry.time_ns + last_ns >= time_ns));
                // What went had to go: the newest of it is too old, or there is no room for it.
                if let Some(gone) = entries.get((sequence as usize).wrapping_sub(kept.len() + 1)) {
                    let gone_bytes = size_of::<Entry>() + gone.1 + 2 * size_of::<usize>();
                    let age: u64 = entries[sequence as usize - kept.len()..sequence as usize]
                        .iter()
                        .map(|(step_ns, _)| step_ns)
                        .sum();
                    prop_assert!(age > last_ns || sum + gone_bytes > most_bytes);
                }
            }
        }
    }
}
