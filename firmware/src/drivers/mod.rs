//! What hangs on a board and is the same for all of them, over the traits of `embedded-hal` 1.0: a board hands in its pins.
//!
//! Entry point: [`amplifier::Amplifiers`]. Fault paths do not come through here, see [`crate::safe_state`].

pub mod amplifier;
