//! Fault bits of [`State::faults`](super::message::State::faults), latched until the host clears them, or the console restarts: [`UNTIL_RESTART`].
//!
//! A bit keeps its meaning for ever; the host shows bits that it does not know by number.

/// The emergency stop is, or was, pressed.
pub const E_STOP: u16 = 1 << 0;
/// A computed force or current was not finite.
pub const NOT_FINITE: u16 = 1 << 1;
/// An encoder moved faster than the device can, or changed its pace by more than 1,000 m/s^2 at the grip.
pub const ENCODER_JUMP: u16 = 1 << 2;
/// Three ticks in a row took longer than their period.
pub const OVERRUN: u16 = 1 << 3;
/// The board reported a fault of its own; what it was is said by another bit, if by any.
pub const BOARD: u16 = 1 << 4;
/// The encoders put a joint or the grip where no console reaches: more than 10 m or rad.
pub const OUT_OF_REACH: u16 = 1 << 5;

/// The grip was faster than the device allows under power, for five ticks.
pub const OVERSPEED: u16 = 1 << 6;
/// The board's clocks contradict each other: one stands, or races.
pub const TIME_BASE: u16 = 1 << 7;
/// The amplifiers did not get ready, or stopped being so under power. [`BOARD`] is set beside it.
pub const AMPLIFIER: u16 = 1 << 8;
/// A supply is, or was, too low, or the motors' too high or not to be measured. [`BOARD`] is set beside it.
pub const SUPPLY: u16 = 1 << 9;

/// Faults that no order clears: counts may be lost, and with them the place. Only a restart takes the pose that it finds for the
/// origin, and arms again.
pub const UNTIL_RESTART: u16 = ENCODER_JUMP;

/// Every fault that this version knows, with the name that users see.
pub const NAMES: [(u16, &str); 10] = [
    (E_STOP, "e_stop"),
    (NOT_FINITE, "not_finite"),
    (ENCODER_JUMP, "encoder_jump"),
    (OVERRUN, "overrun"),
    (BOARD, "board"),
    (OUT_OF_REACH, "out_of_reach"),
    (OVERSPEED, "overspeed"),
    (TIME_BASE, "time_base"),
    (AMPLIFIER, "amplifier"),
    (SUPPLY, "supply"),
];

/// Names of the faults that are set in `bits`, in the order of the bits.
///
/// ```
/// use sutura_shared::wire::faults;
/// assert!(faults::names(faults::E_STOP | faults::OVERRUN).eq(["e_stop", "overrun"]));
/// ```
pub fn names(bits: u16) -> impl Iterator<Item = &'static str> {
    NAMES
        .into_iter()
        .filter(move |(bit, _)| bits & bit != 0)
        .map(|(_, name)| name)
}
