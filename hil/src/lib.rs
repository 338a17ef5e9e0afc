//! Hardware in the loop: consoles that need no hardware, and lines that fail on purpose.
//!
//! Entry points: [`VirtualConsole`] (real time, behind a pseudo-terminal), [`NativeConsole`] (lockstep, in
//! this process), [`QemuConsole`] (lockstep, the firmware image under QEMU), [`Qemu`] (any image),
//! [`Meddler`] (a bad line).

pub mod identity_trace;
mod meddler;
mod native;
#[cfg(unix)]
mod pty;
#[cfg(unix)]
pub mod qemu;
#[cfg(unix)]
mod qemu_console;
pub mod scenario;
mod virtual_console;

pub use meddler::Meddler;
pub use native::NativeConsole;
#[cfg(unix)]
pub use pty::Pty;
#[cfg(unix)]
pub use qemu::{Qemu, QemuError, QemuOptions};
#[cfg(unix)]
pub use qemu_console::QemuConsole;
pub use virtual_console::{VirtualConsole, serve};
