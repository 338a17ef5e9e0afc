//! Bytes on their way to the host: a ring that takes whole frames or nothing.
//!
//! Entry point: [`Outbox`]. A frame that does not fit is dropped whole, which the host sees as a gap in the
//! sequence; half a frame would cost the next one too.

use heapless::Deque;

/// Bytes that wait for the host.
#[derive(Default)]
pub struct Outbox<const N: usize> {
    bytes: Deque<u8, N>,
    dropped: u32,
}

impl<const N: usize> Outbox<N> {
    /// Nothing waits.
    pub const fn new() -> Self {
        Self {
            bytes: Deque::new(),
            dropped: 0,
        }
    }

    /// Takes a frame whole, or drops it and counts that.
    pub fn push(&mut self, frame: &[u8]) {
        if frame.len() > N - self.bytes.len() {
            self.dropped = self.dropped.wrapping_add(1);
            return;
        }
        for &byte in frame {
            let full = self.bytes.push_back(byte).is_err();
            debug_assert!(!full);
        }
    }

    /// Offers what waits to `write`, which says how many bytes it took, until it takes none.
    pub fn flush(&mut self, mut write: impl FnMut(&[u8]) -> usize) {
        loop {
            let (head, _) = self.bytes.as_slices();
            if head.is_empty() {
                return;
            }
            let taken = write(head);
            if taken == 0 {
                return;
            }
            for _ in 0..taken {
                self.bytes.pop_front();
            }
        }
    }

    /// Frames dropped since boot.
    pub fn dropped(&self) -> u32 {
        self.dropped
    }
}

#[cfg(test)]
mod tests {
    use super::Outbox;
    use std::vec::Vec;

    #[test]
    fn frames_arrive_whole_and_in_order_through_a_slow_writer() {
        let mut outbox = Outbox::<10>::new();
        let mut received = Vec::new();
        for frame in [
            &[1, 2, 3, 4][..],
            &[5, 6, 7, 8],
            &[9, 10, 11, 12],
            &[13],
            &[14, 15],
        ] {
            outbox.push(frame);
            let mut room = 2;
            outbox.flush(|bytes| {
                let taken = bytes.len().min(room);
                received.extend_from_slice(&bytes[..taken]);
                room -= taken;
                taken
            });
        }
        outbox.flush(|bytes| {
            received.extend_from_slice(bytes);
            bytes.len()
        });
        // Two bytes leave after each push: 2, 4, then 6 + 4 bytes just fit, then 8 + 1, 7 + 2.
        assert_eq!(
            received,
            [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15]
        );
        assert_eq!(outbox.dropped(), 0);
    }

    #[test]
    fn a_frame_that_does_not_fit_is_dropped_whole() {
        let mut outbox = Outbox::<4>::new();
        outbox.push(&[1, 2, 3]);
        outbox.push(&[4, 5]);
        outbox.push(&[6]);
        let mut received = Vec::new();
        outbox.flush(|bytes| {
            received.extend_from_slice(bytes);
            bytes.len()
        });
        assert_eq!(received, [1, 2, 3, 6]);
        assert_eq!(outbox.dropped(), 1);
    }
}
