//! Whole frames or none: a ring of bytes between whoever logs and what carries it away.
//!
//! Entry points: [`Ring::begin`], [`Ring::push`], [`Ring::commit`] for a frame; [`Ring::peek`], [`Ring::drop_front`] for the other end. One
//! context writes and one reads, whichever interrupts the other. Nobody waits: a frame that does not fit is lost and counted,
//! and what came before it stays, so that who comes late finds how it all began.

use core::sync::atomic::{AtomicBool, AtomicU8, AtomicU32, Ordering};

/// A ring over memory of its owner's, of whose bytes one stays free. As a debug probe sees it: a buffer and two offsets.
#[derive(Debug)]
pub struct Ring<'a> {
    bytes: &'a [AtomicU8],
    /// Offset of the next byte to be written, of whole frames.
    written: &'a AtomicU32,
    /// Offset of the next byte to be read; its reader's.
    read: &'a AtomicU32,
    /// Offset of the next byte of the frame that is being written.
    next: AtomicU32,
    fits: AtomicBool,
    lost: AtomicU32,
}

impl<'a> Ring<'a> {
    /// An empty ring, where the offsets are both 0.
    pub const fn new(bytes: &'a [AtomicU8], written: &'a AtomicU32, read: &'a AtomicU32) -> Self {
        Ring {
            bytes,
            written,
            read,
            next: AtomicU32::new(0),
            fits: AtomicBool::new(true),
            lost: AtomicU32::new(0),
        }
    }

    fn length(&self) -> u32 {
        self.bytes.len() as u32
    }

    /// Begins a frame.
    pub fn begin(&self) {
        self.next
            .store(self.written.load(Ordering::Relaxed), Ordering::Relaxed);
        self.fits.store(true, Ordering::Relaxed);
    }

    /// Bytes of the frame.
    pub fn push(&self, bytes: &[u8]) {
        let read = self.read.load(Ordering::Acquire);
        let mut next = self.next.load(Ordering::Relaxed);
        for &byte in bytes {
            let after = if next + 1 >= self.length() {
                0
            } else {
                next + 1
            };
            match self.bytes.get(next as usize) {
                Some(place) if after != read => place.store(byte, Ordering::Relaxed),
                _ => return self.fits.store(false, Ordering::Relaxed),
            }
            next = after;
        }
        self.next.store(next, Ordering::Relaxed);
    }

    /// The frame is complete: its reader may have it, if all of it is there.
    pub fn commit(&self) {
        if self.fits.load(Ordering::Relaxed) {
            self.written
                .store(self.next.load(Ordering::Relaxed), Ordering::Release);
        } else {
            self.lose();
        }
    }

    /// A frame was lost before it came here.
    pub fn lose(&self) {
        self.lost.fetch_add(1, Ordering::Relaxed);
    }

    /// Frames that were lost (wrapping).
    pub fn lost(&self) -> u32 {
        self.lost.load(Ordering::Relaxed)
    }

    /// Whether at least half of it is free.
    pub fn has_room(&self) -> bool {
        2 * self.waiting() <= self.length()
    }

    /// Bytes that wait to be read.
    fn waiting(&self) -> u32 {
        let written = self.written.load(Ordering::Acquire);
        let read = self.read.load(Ordering::Relaxed);
        if written >= read {
            written - read
        } else {
            written + self.length() - read
        }
    }

    /// The oldest bytes, as many as there are and fit; they stay.
    pub fn peek(&self, into: &mut [u8]) -> usize {
        let count = into.len().min(self.waiting() as usize);
        let read = self.read.load(Ordering::Relaxed) as usize;
        let places = self.bytes.iter().cycle().skip(read);
        for (byte, place) in into.iter_mut().take(count).zip(places) {
            *byte = place.load(Ordering::Relaxed);
        }
        count
    }

    /// The oldest bytes have been carried away.
    pub fn drop_front(&self, count: usize) {
        let moved = self.read.load(Ordering::Relaxed) + (count as u32).min(self.waiting());
        let read = if moved >= self.length() {
            moved - self.length()
        } else {
            moved
        };
        self.read.store(read, Ordering::Release);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::VecDeque;
    use std::vec::Vec;

    /// Frames of every length, read in pieces of every length, against a queue of whole frames with the same room.
    #[test]
    fn whole_frames_come_out_in_order_and_the_others_are_counted() {
        let bytes: [AtomicU8; 61] = [const { AtomicU8::new(0) }; 61];
        let (written, read) = (AtomicU32::new(0), AtomicU32::new(0));
        let ring = Ring::new(&bytes, &written, &read);
        let (mut model, mut lost, mut kept) = (VecDeque::new(), 0, 0);
        let mut random = 7_u32;
        let mut draw = |below: u32| {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (random >> 16) % below
        };
        for round in 0..20_000_u32 {
            let frame: Vec<u8> = (0..draw(70)).map(|at| (round + at) as u8).collect();
            ring.begin();
            frame
                .chunks(1 + draw(9) as usize)
                .for_each(|piece| ring.push(piece));
            ring.commit();
            if model.len() + frame.len() < bytes.len() {
                model.extend(&frame);
                kept += 1;
            } else {
                lost += 1;
            }
            assert_eq!(ring.lost(), lost);
            assert_eq!(ring.has_room(), 2 * model.len() <= bytes.len());
            let mut taken = [0; 64];
            let most = draw(40) as usize;
            let count = ring.peek(&mut taken[..most]);
            assert_eq!(count, most.min(model.len()));
            assert!(taken[..count].iter().eq(model.iter().take(count)));
            // Not all that was looked at is carried away.
            let gone = count.min(draw(40) as usize);
            ring.drop_front(gone);
            model.drain(..gone);
        }
        assert!(lost > 1000 && kept > 1000, "{lost} lost, {kept} kept");
    }

    #[test]
    fn what_does_not_fit_leaves_what_is_there() {
        let bytes: [AtomicU8; 8] = [const { AtomicU8::new(0) }; 8];
        let (written, read) = (AtomicU32::new(0), AtomicU32::new(0));
        let ring = Ring::new(&bytes, &written, &read);
        for frame in [&b"first"[..], b"too much", b"ok", b"!"] {
            ring.begin();
            ring.push(frame);
            ring.commit();
        }
        let mut into = [0; 8];
        assert_eq!(ring.peek(&mut into), 7);
        assert_eq!(&into[..7], b"firstok");
        assert_eq!(ring.lost(), 2);
    }
}
