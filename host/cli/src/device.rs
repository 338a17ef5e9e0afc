//! The device that a virtual console starts as.
//!
//! Entry point: [`open`].

use crate::failure::Failure;
use std::path::Path;
use sutura_host::scene::{Document, built_in_device, read_device};
use sutura_shared::device::DeviceDescription;

/// Reads a device file; without a path it is the first built-in device.
///
/// # Errors
/// Bad input: the file, or something in it.
pub fn open(path: Option<&Path>) -> Result<DeviceDescription, Failure> {
    let device = match path {
        Some(path) => read_device(&Document::read(path)?),
        None => built_in_device(),
    };
    Ok(device?.description)
}
