//! The shared simulation in this process, one control tick per exchange.
//!
//! Entry point: [`NativeConsole::new`]. Bit for bit what [`QemuConsole`](crate::QemuConsole) does.

use sutura_host::link::{LinkError, LockstepConsole};
use sutura_shared::control::TicksLimited;
use sutura_shared::device::{DeviceDescription, DeviceError};
use sutura_shared::simulated_console::{Pace, SimulatedConsole, Without};

/// A console in lockstep, without threads or clocks.
pub struct NativeConsole {
    console: SimulatedConsole,
    /// Of the next tick.
    pace: Pace,
}

impl NativeConsole {
    /// A console at boot that is `device` until a host tells it otherwise.
    ///
    /// # Errors
    /// [`DeviceError`] if the description is unusable.
    pub fn new(device: &DeviceDescription) -> Result<NativeConsole, DeviceError> {
        // Nothing here is random: two runs must give the same bits.
        NativeConsole::tuned(device, 0, Without::default())
    }

    /// A console with another seed for session numbers, and without some of its guards.
    ///
    /// # Errors
    /// [`DeviceError`] if the description is unusable.
    pub fn tuned(
        device: &DeviceDescription,
        seed: u32,
        without: Without,
    ) -> Result<NativeConsole, DeviceError> {
        let Without { tuning, checks } = without;
        Ok(NativeConsole {
            console: SimulatedConsole::tuned(device, seed, tuning, checks)?,
            pace: Pace::default(),
        })
    }

    /// The simulation, to look at.
    pub fn console(&self) -> &SimulatedConsole {
        &self.console
    }
}

impl LockstepConsole for NativeConsole {
    fn exchange(&mut self, down: &[u8], up: &mut Vec<u8>) -> Result<(), LinkError> {
        self.console.feed(down);
        self.console.tick(std::mem::take(&mut self.pace));
        self.console.drain(up);
        Ok(())
    }

    fn overran(&mut self) {
        self.pace.overrun = true;
    }

    fn ticks_limited(&self) -> Option<TicksLimited> {
        Some(self.console.control().ticks_limited())
    }

    fn name(&self) -> &str {
        "native"
    }
}
