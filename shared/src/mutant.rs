//! Guards that are taken out, one at a time, to see whether a test notices.
//!
//! Entry points: [`stands`] at a guard, `take_out` where an image starts. Without the feature `mutants`, which nothing that goes to a
//! console has, every guard stands, the compiler knows it, and nothing of this is left.

#[cfg(feature = "mutants")]
use core::sync::atomic::{AtomicU32, Ordering};

/// Number of a guard, from its name: FNV-1a (Fowler, Noll and Vo 1991, 32 bits).
pub const fn number(name: &str) -> u32 {
    let (mut hash, mut at) = (0x811C_9DC5_u32, 0);
    let bytes = name.as_bytes();
    while at < bytes.len() {
        hash = (hash ^ bytes[at] as u32).wrapping_mul(0x0100_0193);
        at += 1;
    }
    hash
}

/// What the switch is set to, for a guard to be taken out: its number, and a check, which memory that nobody has set does not have.
pub const fn switch(name: &str) -> [u32; 2] {
    [number(name), !number(name)]
}

/// The guard that is out; 0 = none.
#[cfg(feature = "mutants")]
static OUT: AtomicU32 = AtomicU32::new(0);

/// Takes the guard out that a [`switch`] is set to. One that is not set leaves all of them.
#[cfg(feature = "mutants")]
pub fn take_out([number, check]: [u32; 2]) {
    let number = if check == !number { number } else { 0 };
    OUT.store(number, Ordering::Relaxed);
}

/// Whether the guard of this name stands.
#[cfg(feature = "mutants")]
pub fn stands(name: &str) -> bool {
    OUT.load(Ordering::Relaxed) != number(name)
}

/// Whether the guard of this name stands: all of them do.
#[cfg(not(feature = "mutants"))]
#[inline(always)]
pub const fn stands(_: &str) -> bool {
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Test vectors of the FNV authors.
    #[test]
    fn a_number_is_fnv1a() {
        assert_eq!(number(""), 0x811C_9DC5);
        assert_eq!(number("foobar"), 0xBF9C_F968);
    }

    #[cfg(feature = "mutants")]
    #[test]
    fn one_is_out_and_noise_takes_none() {
        assert!(stands("horizon"));
        take_out(switch("horizon"));
        assert!(!stands("horizon") && stands("force"));
        take_out([number("force"), 7]);
        assert!(stands("horizon") && stands("force"));
    }
}
