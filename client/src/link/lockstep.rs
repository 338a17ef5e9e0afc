//! A console that advances by exactly one control tick per exchange.
//!
//! Entry point: [`LockstepConsole`]. Time is the console's tick count and nothing else, so two runs
//! of the same session give the same bits, in this process and under an emulator.

use super::LinkError;
use sutura_shared::control::TicksLimited;

/// One control tick at a time, in step with the caller.
pub trait LockstepConsole {
    /// Delivers the bytes of `down` (any number of whole frames), runs one tick, and appends what the
    /// console sends to `up`.
    ///
    /// # Errors
    /// [`LinkError::Gone`] when the console ended or passed its time limit.
    fn exchange(&mut self, down: &[u8], up: &mut Vec<u8>) -> Result<(), LinkError>;

    /// Has the next tick find that the one before took longer than its period, as a console that keeps time may: for replays.
    /// Does nothing where that cannot be said.
    fn overran(&mut self) {}

    /// Ticks of the session in which a limit of the device took a part of the force away; none where the console cannot be
    /// asked.
    fn ticks_limited(&self) -> Option<TicksLimited> {
        None
    }

    /// What the user calls it.
    fn name(&self) -> &str;
}
