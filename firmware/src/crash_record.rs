//! What a fault handler leaves behind for the next boot, and what the reset flags say.
//!
//! Entry points: [`CrashRecord::to_words`] before the reset, [`CrashRecord::from_words`] after it,
//! [`reset_cause`]. RAM that nobody initialises holds noise after power-up, hence the mark and the check. A record stays there until a
//! host has been told: the boot that finds it may end in a watchdog before any host comes.

/// Which handler wrote the crash_record; the numbers are those of `Report::epitaph_kind`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Kind {
    /// A panic; the place is [`place_of`] its file and line.
    Panic = 1,
    /// A hard fault; the place is the program counter.
    HardFault = 2,
    /// Another exception or interrupt that nobody handles; the place is its number.
    Exception = 3,
    /// The window watchdog is about to bite; the place is which tasks ticked.
    Watchdog = 4,
}

/// The last words of a fault handler.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CrashRecord {
    /// Who wrote it.
    pub kind: Kind,
    /// Where it happened, see [`Kind`].
    pub place: u32,
}

/// Whether a boot has found a record before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Age {
    /// Left by the program that ran last.
    New,
    /// Left by an earlier one, and no host has been told since.
    Kept,
}

const MARK: u32 = 0x5375_7475;
/// Set in the first word of a record that is kept.
const KEPT: u32 = 1 << 31;

impl CrashRecord {
    /// Three words for the uninitialised RAM.
    pub fn to_words(self, age: Age) -> [u32; 3] {
        let kept = match age {
            Age::New => 0,
            Age::Kept => KEPT,
        };
        let kind = MARK ^ kept ^ self.kind as u32;
        [kind, self.place, check(kind, self.place)]
    }

    /// Reads the words back; `None` for noise.
    pub fn from_words([kind, place, sum]: [u32; 3]) -> Option<(Self, Age)> {
        if sum != check(kind, place) {
            return None;
        }
        let kind = kind ^ MARK;
        let age = if kind & KEPT == 0 {
            Age::New
        } else {
            Age::Kept
        };
        let kind = match kind & !KEPT {
            1 => Kind::Panic,
            2 => Kind::HardFault,
            3 => Kind::Exception,
            4 => Kind::Watchdog,
            _ => return None,
        };
        Some((Self { kind, place }, age))
    }
}

fn check(kind: u32, place: u32) -> u32 {
    !(kind.rotate_left(7) ^ place.wrapping_mul(0x9E37_79B1))
}

/// Hash of a source place: FNV-1a (Fowler, Noll and Vo 1991, 32 bits) over the file name and the line.
pub fn place_of(file: &str, line: u32) -> u32 {
    let fold = |hash: u32, byte: &u8| (hash ^ u32::from(*byte)).wrapping_mul(0x0100_0193);
    let hash = file.as_bytes().iter().fold(0x811C_9DC5, fold);
    line.to_le_bytes().iter().fold(hash, fold)
}

/// Cause of a reset in the numbers of `Report::reset_cause`, from the flags in `RCC_CSR` (RM0090, 7.3.21).
///
/// Several flags stand at once: every reset pulls the pin too, and a power-up sets the brown-out flag. A
/// software reset with a new crash record is a fault handler's.
pub fn reset_cause(csr: u32, found: Option<Age>) -> u8 {
    const PIN: u32 = 1 << 26;
    const POWER: u32 = 1 << 27 | 1 << 25;
    const SOFTWARE: u32 = 1 << 28;
    const WATCHDOGS: u32 = 1 << 29 | 1 << 30;
    if csr & POWER != 0 {
        1
    } else if csr & WATCHDOGS != 0 {
        4
    } else if csr & SOFTWARE != 0 {
        if found == Some(Age::New) { 5 } else { 3 }
    } else if csr & PIN != 0 {
        2
    } else {
        0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_epitaph_survives_and_one_flipped_bit_voids_it() {
        for kind in [
            Kind::Panic,
            Kind::HardFault,
            Kind::Exception,
            Kind::Watchdog,
        ] {
            let crash_record = CrashRecord {
                kind,
                place: 0x0800_1234,
            };
            for age in [Age::New, Age::Kept] {
                let words = crash_record.to_words(age);
                assert_eq!(CrashRecord::from_words(words), Some((crash_record, age)));
                for bit in 0..96 {
                    let mut broken = words;
                    broken[bit / 32] ^= 1 << (bit % 32);
                    assert_eq!(CrashRecord::from_words(broken), None, "bit {bit}");
                }
            }
        }
    }

    #[test]
    fn erased_and_zeroed_memory_is_no_epitaph() {
        assert_eq!(CrashRecord::from_words([0; 3]), None);
        assert_eq!(CrashRecord::from_words([u32::MAX; 3]), None);
    }

    /// Test vector of the FNV authors: the 32-bit FNV-1a of "foobar" is 0xBF9CF968.
    #[test]
    fn place_is_fnv1a() {
        let line = u32::from_le_bytes(*b"obar");
        assert_eq!(place_of("fo", line), 0xBF9C_F968);
    }

    /// Flag combinations as RM0090 describes them: the pin flag stands beside every other.
    #[test]
    fn the_strongest_flag_names_the_cause() {
        assert_eq!(reset_cause(0x0E00_0000, None), 1);
        assert_eq!(reset_cause(0x0400_0000, None), 2);
        assert_eq!(reset_cause(0x1400_0000, None), 3);
        assert_eq!(reset_cause(0x2400_0000, None), 4);
        assert_eq!(reset_cause(0x4400_0000, Some(Age::New)), 4);
        assert_eq!(reset_cause(0x1400_0000, Some(Age::New)), 5);
        // An older one says nothing of this reset.
        assert_eq!(reset_cause(0x1400_0000, Some(Age::Kept)), 3);
        assert_eq!(reset_cause(0, None), 0);
    }
}
