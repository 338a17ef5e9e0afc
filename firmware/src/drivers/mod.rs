//! What hangs on a board and is the same for all of them, over the traits of `embedded-hal` 1.0: a board hands in its pins.
//!
//! Entry points: [`amplifier::Amplifiers`], [`angle::AngleEncoder`], [`spi::Selected`], [`lines`], [`analog`], [`lamp::Lamp`]. Fault paths do not come through
//! here, see [`crate::safe_state`].

pub mod amplifier;
pub mod analog;
pub mod angle;
pub mod lamp;
pub mod lines;
pub mod spi;
