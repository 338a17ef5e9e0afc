//! Everything that must be the same on the console and on the host.
//!
//! The console's firmware, the host, the virtual console inside an emulated image and the one in
//! the host's own process all run this code, and all get the same bits from it.
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;

pub mod control;
pub mod device;
pub mod hash;
pub mod kinematics;
pub mod link;
pub mod math;
pub mod simulated_console;
pub mod virtual_console;
pub mod wire;
