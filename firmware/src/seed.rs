//! Session numbers for chips without a random generator: noise, the chip's number, and a count that survives resets.
//!
//! Entry point: [`Seeds::draw`]. Two boots in a row never draw the same number while RAM keeps what the first one left; after
//! a power-up, when it keeps nothing, noise and what RAM came up with decide.

/// Words that RAM keeps.
pub const WORDS: usize = 3;

/// What a boot leaves for the next one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Seeds {
    count: u32,
    last: u32,
    /// The check: what RAM came up with has none.
    known: bool,
}

/// Mixes all bits into all (SplitMix64, Steele, Lea and Flood 2014).
const fn mix(word: u64) -> u64 {
    let word = word.wrapping_add(0x9E37_79B9_7F4A_7C15);
    let word = (word ^ word >> 30).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let word = (word ^ word >> 27).wrapping_mul(0x94D0_49BB_1331_11EB);
    word ^ word >> 31
}

fn check(count: u32, last: u32) -> u32 {
    mix(u64::from(count) << 32 | u64::from(last)) as u32 ^ 0x5EED_5EED
}

impl Seeds {
    /// What RAM holds.
    pub fn from_words([count, last, kept]: [u32; WORDS]) -> Seeds {
        Seeds {
            count,
            last,
            known: kept == check(count, last),
        }
    }

    /// What RAM is to hold.
    pub fn to_words(self) -> [u32; WORDS] {
        [self.count, self.last, check(self.count, self.last)]
    }

    /// A number for this boot, from the chip's own number and as much noise as there is.
    pub fn draw(&mut self, chip_id: [u32; 3], noise: u64) -> u32 {
        self.count = self.count.wrapping_add(1);
        let [a, b, c] = chip_id.map(u64::from);
        let state = mix(mix(mix(a << 32 | b) ^ c) ^ noise) ^ u64::from(self.count);
        let drawn = mix(state) as u32;
        // By chance alone once in four thousand million boots.
        let again = self.known && drawn == self.last;
        self.last = if again { drawn.wrapping_add(1) } else { drawn };
        self.known = true;
        self.last
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;
    use std::vec::Vec;

    const CHIP: [u32; 3] = [0x0043_002B, 0x3438_510B, 0x3236_3530];

    /// A boot: what RAM holds, in and out.
    fn boot(ram: &mut [u32; WORDS], noise: u64) -> u32 {
        let mut seeds = Seeds::from_words(*ram);
        let seed = seeds.draw(CHIP, noise);
        *ram = seeds.to_words();
        seed
    }

    /// With no noise at all, as from a converter that stands still, the count alone makes them differ.
    #[test]
    fn boots_without_noise_differ() {
        let mut ram = [0; WORDS];
        let seeds: Vec<u32> = (0..20_000).map(|_| boot(&mut ram, 0)).collect();
        assert!(seeds.windows(2).all(|pair| pair[0] != pair[1]));
        let different: BTreeSet<_> = seeds.iter().collect();
        assert!(different.len() > 19_990, "{}", different.len());
    }

    /// The very number that would come again is told apart, if RAM is what the boot before left.
    #[test]
    fn the_number_of_the_boot_before_never_comes_again() {
        for noise in 0..200 {
            let next = Seeds::from_words([7, 0, 0]).draw(CHIP, noise);
            let known = Seeds {
                count: 7,
                last: next,
                known: true,
            };
            let mut ram = known.to_words();
            assert_ne!(boot(&mut ram, noise), next);
            // One flipped bit, and nobody knows what was last.
            let mut ram = known.to_words();
            ram[2] ^= 1 << (noise % 32);
            assert_eq!(boot(&mut ram, noise), next);
        }
    }

    #[test]
    fn noise_chip_and_ram_all_count() {
        let draw = |ram, chip, noise| Seeds::from_words(ram).draw(chip, noise);
        let one = draw([1, 2, 3], CHIP, 4);
        let mut other = CHIP;
        other[2] ^= 1;
        for different in [
            draw([9, 2, 3], CHIP, 4),
            draw([1, 2, 3], other, 4),
            draw([1, 2, 3], CHIP, 5),
        ] {
            assert_ne!(different, one);
        }
    }
}
