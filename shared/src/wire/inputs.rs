//! Bits of [`State::inputs`](super::message::State::inputs): what a board read besides its encoders, and one that the tick
//! itself has set. With them a recording of the states is enough to run the console's ticks again: see [`TickInput::of`].
//!
//! [`TickInput::of`]: crate::control::TickInput::of

/// The emergency stop was pressed.
pub const EMERGENCY_STOP: u8 = 1 << 0;
/// The board had found a fault of its own.
pub const BOARD_FAULT: u8 = 1 << 1;
/// The computation of the tick before took longer than its period.
pub const OVERRUN: u8 = 1 << 2;
/// The console senses its grip's orientation, which is that of the state.
pub const ORIENTATION: u8 = 1 << 3;
/// What it sensed was no rotation; the state has the identity in its place.
pub const NO_ROTATION: u8 = 1 << 4;
/// The amplifiers do not take currents: off, not ready yet, or not ready any more.
pub const AMPLIFIER: u8 = 1 << 5;
/// A supply was too low, or had been since the tick before.
pub const SUPPLY: u8 = 1 << 6;
/// Force is withheld: the tank, or a return after an outage, lets through so much less than the contact asks for that a finger
/// notices it (10 % and 30 mN). A notice, not an input: a tick that is run again finds it anew.
pub const WITHHELD: u8 = 1 << 7;
