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

    /// Goes on from a hash that was.
    pub const fn from_value(value: u64) -> Self {
        TraceHash(value)
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

#[cfg(test)]
mod tests {
    use super::*;

    /// For one word below 256 this is FNV-1a of one byte; the value is that of "a" in the test vectors of
    /// draft-eastlake-fnv (appendix C).
    #[test]
    fn one_letter_hashes_as_published() {
        let mut hash = TraceHash::new();
        hash.word(u32::from(b'a'));
        assert_eq!(hash.value(), 0xaf63_dc4c_8601_ec8c);
    }

    #[test]
    fn order_zeros_and_halves_count_but_not_the_kind_of_nan() {
        let of = |values: &[f32]| {
            let mut hash = TraceHash::default();
            hash.floats(values);
            hash.value()
        };
        assert_ne!(of(&[1.0, 2.0]), of(&[2.0, 1.0]));
        assert_ne!(of(&[0.0]), of(&[-0.0]));
        assert_eq!(of(&[f32::NAN]), of(&[-f32::NAN]));
        let mut double = TraceHash::new();
        double.double(0x0000_0002_0000_0001);
        let mut words = TraceHash::new();
        words.word(1);
        words.word(2);
        assert_eq!(double, words);
    }
}
