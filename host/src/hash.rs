//! One number for all that a value holds, to compare two runs bit by bit.
//!
//! Entry point: [`hash_of`]. The value is written as postcard, whose bytes follow from its fields alone (an `f64` as its
//! bits), and goes into the console's own kind of hash instead of a buffer: nothing is allocated.

use postcard::ser_flavors::Flavor;
use serde::Serialize;
use sutura_shared::hash::TraceHash;

struct Bytes(TraceHash);

impl Flavor for Bytes {
    type Output = u64;

    fn try_extend(&mut self, data: &[u8]) -> postcard::Result<()> {
        for chunk in data.chunks(4) {
            let mut word = [0; 4];
            for (to, from) in word.iter_mut().zip(chunk) {
                *to = *from;
            }
            self.0.word(u32::from_le_bytes(word));
        }
        Ok(())
    }

    fn try_push(&mut self, data: u8) -> postcard::Result<()> {
        self.0.word(u32::from(data));
        Ok(())
    }

    fn finalize(self) -> postcard::Result<u64> {
        Ok(self.0.value())
    }
}

/// Hash of everything that `value` holds; 0 for what postcard cannot write, as a list of unknown length.
pub(crate) fn hash_of(value: &impl Serialize) -> u64 {
    postcard::serialize_with_flavor(value, Bytes(TraceHash::new())).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_bit_of_a_number_and_the_order_count() {
        let values = (1.0_f64, vec![0.1, 0.2], Some(3_u32));
        let hash = hash_of(&values);
        assert_eq!(hash, hash_of(&values.clone()));
        let next = f64::from_bits(0.1_f64.to_bits() ^ 1);
        for other in [
            (1.0, vec![next, 0.2], Some(3)),
            (1.0, vec![0.2, 0.1], Some(3)),
            (1.0, vec![0.1, 0.2], None),
            (-1.0, vec![0.1, 0.2], Some(3)),
        ] {
            assert_ne!(hash, hash_of(&other), "{other:?}");
        }
        assert_ne!(hash_of(&0.0_f64), hash_of(&-0.0_f64));
    }
}
