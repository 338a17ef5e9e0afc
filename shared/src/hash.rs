//! A running hash over numbers, to compare two runs bit by bit.
//!
//! Entry point: [`TraceHash`]. FNV-1a (Fowler, Noll and Vo) with 64 bits, over 32-bit words instead of
//! bytes: a quarter of the multiplications.

use crate::math::{Vec3, canonical};

/// A running hash. It finds differences; it does not resist forgery.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TraceHash(u64);

impl TraceHash {
    /// The hash of nothing.
    pub const fn new() -> Self {
        TraceHash(0xcbf2_9ce4_8422_2325)
    }

    /// Adds a word.
    #[inline]
    pub fn word(&mut self, word: u32) {
        self.0 = (self.0 ^ u64::from(word)).wrapping_mul(0x0000_0100_0000_01b3);
    }

    /// Adds a double word, lower half first.
    #[inline]
    pub fn double(&mut self, value: u64) {
        self.word(value as u32);
        self.word((value >> 32) as u32);
    }

    /// Adds numbers: signed zeros differ, all NaNs are the same.
    #[inline]
    pub fn floats(&mut self, values: &[f32]) {
        for value in values {
            self.word(canonical(*value));
        }
    }

    /// Adds a vector.
    #[inline]
    pub fn vector(&mut self, v: &Vec3) {
        self.floats(&[v.x, v.y, v.z]);
    }

    /// The hash of everything so far.
    pub const fn value(&self) -> u64 {
        self.0
    }
}

impl Default for TraceHash {
    fn default() -> Self {
        Self::new()
    }
}
