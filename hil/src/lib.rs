//! Hardware in the loop: consoles that need no hardware, and lines that fail on purpose.
//!
//! Entry points: [`VirtualConsole`] (real time, behind a pseudo-terminal), [`NativeConsole`] (lockstep, in
//! this process), [`QemuConsole`] (lockstep, the firmware image under QEMU), [`Qemu`] (any image),
//! [`FaultProxy`] (a bad line); with the feature `board-image` `board_image::BoardImage` (the image for motors, with a stand-in for what QEMU
//! lacks), with `scenarios` `scenario` (what goes wrong, played).

#[cfg(all(unix, feature = "board-image"))]
pub mod board_image;
mod fault_proxy;
pub mod identity_trace;
mod native;
#[cfg(unix)]
mod pty;
#[cfg(unix)]
pub mod qemu;
#[cfg(unix)]
mod qemu_console;
#[cfg(feature = "scenarios")]
pub mod scenario;
mod virtual_console;

pub use fault_proxy::FaultProxy;
pub use native::NativeConsole;
#[cfg(unix)]
pub use pty::{Pty, PtyLink};
#[cfg(unix)]
pub use qemu::{Qemu, QemuError, QemuOptions};
#[cfg(unix)]
pub use qemu_console::QemuConsole;
pub use virtual_console::{VirtualConsole, serve};
