//! What latched faults mean, and what to do about each.
//!
//! Entry points: [`fault_names`], [`fault_words`].

use sutura_shared::wire::faults::{
    AMPLIFIER, BOARD, E_STOP, ENCODER_JUMP, NAMES, NOT_FINITE, OUT_OF_REACH, OVERRUN, OVERSPEED,
    SUPPLY, TIME_BASE, UNTIL_RESTART, names,
};

/// Names of the faults that are set, in the order of the bits, and behind them the bits that this host does not know, as a number: `0x400`.
pub fn fault_names(bits: u16) -> Vec<String> {
    let known = NAMES.iter().fold(0, |all, (bit, _)| all | bit);
    let unknown = Some(bits & !known).filter(|bits| *bits != 0);
    let number = unknown.map(|bits| format!("{bits:#x}"));
    names(bits).map(str::to_owned).chain(number).collect()
}

/// Whether one of these faults, by name, ends with a restart of the console alone.
pub fn needs_restart(faults: &[String]) -> bool {
    names(UNTIL_RESTART).any(|name| faults.iter().any(|fault| fault == name))
}

/// The faults' names in a sentence; a console may be in a latched fault and name none.
pub(super) fn said(names: &[String]) -> String {
    match names {
        [] => "it does not say which".to_owned(),
        names => names.join(", "),
    }
}

/// What a fault is, in a sentence, and what to do: of one bit of the wire's.
pub fn fault_words(bit: u16) -> (&'static str, &'static str) {
    match bit {
        E_STOP => (
            "the emergency stop is pressed, or was",
            "release it, and clear the fault",
        ),
        NOT_FINITE => (
            "a force or a current was no number, and the motors were switched off",
            "this is a defect: please report it with a recording; then clear the fault",
        ),
        ENCODER_JUMP => (
            "an encoder moved, or changed its speed, faster than the device can",
            "check the encoder's cable and connector, and restart the console where its origin is: clearing does not help, the place is lost",
        ),
        OVERRUN => (
            "three control ticks in a row took longer than their period",
            "give the console's computer less to do beside it, and clear the fault",
        ),
        BOARD => (
            "the board reported a fault of its own",
            "what it was stands beside it; else check supply and amplifier, and clear the fault",
        ),
        OUT_OF_REACH => (
            "the encoders put the grip where no console reaches",
            "check the device file and the encoders' zero, and clear the fault",
        ),
        OVERSPEED => (
            "the grip was faster than the device allows under power",
            "hold the grip, and clear the fault",
        ),
        TIME_BASE => (
            "two clocks of the board contradicted each other",
            "reset the board; if it comes again, the board is broken: do not use it",
        ),
        AMPLIFIER => (
            "an amplifier did not get ready within half a second, or stopped being so under power",
            "check the motors' supply and the amplifier's own display, and clear the fault",
        ),
        SUPPLY => (
            "the board's supply is, or was, too low, or the motors' supply is not within its limits",
            "check the supplies and their cables, and clear the fault",
        ),
        _ => (
            "the console reports a fault that this host does not know",
            "use the release that the console's firmware is of",
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn every_fault_has_words_of_its_own() {
        let words: BTreeSet<_> = NAMES.iter().map(|(bit, _)| fault_words(*bit)).collect();
        assert_eq!(words.len(), NAMES.len());
        assert!(!words.contains(&fault_words(1 << 15)));
    }

    #[test]
    fn a_fault_without_bits_has_words() {
        assert_eq!(said(&[]), "it does not say which");
        assert_eq!(said(&fault_names(E_STOP | SUPPLY)), "e_stop, supply");
    }

    /// Nobody is told to clear what clearing leaves.
    #[test]
    fn lost_counts_need_a_restart_and_say_so() {
        for (bit, name) in NAMES {
            let (_, help) = fault_words(bit);
            let restarts = bit & UNTIL_RESTART != 0;
            assert_eq!(needs_restart(&fault_names(bit)), restarts, "{name}");
            assert_eq!(help.contains("restart the console"), restarts, "{help}");
            assert!(!(restarts && help.contains("clear the fault")), "{help}");
        }
        assert!(needs_restart(&fault_names(E_STOP | ENCODER_JUMP)));
        assert!(!needs_restart(&[]));
    }

    /// A newer console's fault is never a fault without a name.
    #[test]
    fn bits_without_a_name_are_a_number() {
        assert_eq!(fault_names(0), [""; 0]);
        assert_eq!(fault_names(E_STOP | SUPPLY), ["e_stop", "supply"]);
        assert_eq!(fault_names(1 << 10), ["0x400"]);
        assert_eq!(fault_names(BOARD | 0xC000), ["board", "0xc000"]);
    }
}
