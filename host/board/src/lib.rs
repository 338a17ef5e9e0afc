//! Firmware images, the boards that they are for, and how they get there.
//!
//! Entry points: [`Image::read`], [`flash()`]; with feature `log` `LogImage` and `UsbLog`. What speaks to a chip are programs that their makers keep, behind the trait [`Loader`]:
//! `dfu-util` for the loader in the chip's ROM ([`DfuUtil`]), `probe-rs` for a probe ([`ProbeRs`]).

mod dfu_util;
mod error;
mod flash;
mod image;
#[cfg(feature = "log")]
mod log;
mod probe_rs;
mod program;
mod target;
#[cfg(feature = "log")]
mod usb_log;

pub use dfu_util::DfuUtil;
pub use error::{BOOT_PINS, FlashError};
pub use flash::{Done, Flash, Loader, Replaced, flash};
pub use image::Image;
#[cfg(feature = "log")]
pub use log::{Line, Lines, LogBytes, LogError, LogImage, follow};
pub use probe_rs::ProbeRs;
pub use target::{BOARDS, Chip, FLASH_START, Target};
#[cfg(feature = "log")]
pub use usb_log::{LogPlace, UsbLog};
