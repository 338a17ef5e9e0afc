//! The USB serial number of a board: its chip's own number in hexadecimal.
//!
//! Entry point: [`serial_number`].

/// Digits of a serial number.
pub const DIGITS: usize = 24;

/// Serial number from the 96 bits of the chip's unique id (RM0090, 39.1), the first word's highest digit first.
pub fn serial_number(id: [u32; 3]) -> [u8; DIGITS] {
    let mut digits = [b'0'; DIGITS];
    let nibbles = id
        .iter()
        .flat_map(|word| (0..8).map(move |place| (word >> (28 - 4 * place) & 0xF) as u8));
    for (digit, nibble) in digits.iter_mut().zip(nibbles) {
        *digit = if nibble < 10 {
            b'0' + nibble
        } else {
            b'A' - 10 + nibble
        };
    }
    digits
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;
    use std::format;

    /// Reference: the standard library's formatting.
    #[test]
    fn it_is_the_id_in_hexadecimal() {
        for id in [
            [0; 3],
            [u32::MAX; 3],
            [0x0123_4567, 0x89AB_CDEF, 0x0042_F00D],
        ] {
            let expected = format!("{:08X}{:08X}{:08X}", id[0], id[1], id[2]);
            assert_eq!(serial_number(id), expected.as_bytes());
        }
    }

    #[test]
    fn chips_that_differ_in_one_bit_have_different_numbers() {
        let mut seen = BTreeSet::from([serial_number([0; 3])]);
        for bit in 0..96 {
            let mut id = [0; 3];
            id[bit / 32] = 1 << (bit % 32);
            assert!(seen.insert(serial_number(id)), "bit {bit}");
        }
    }
}
