//! The device that a virtual console starts as.
//!
//! Entry point: [`open`].

use crate::failure::Failure;
use std::path::Path;
use sutura_host::scene::{BUILT_IN_DEVICES, Document, read_device};
use sutura_shared::device::DeviceDescription;

/// Reads a device file; without a path it is the first built-in device.
///
/// # Errors
/// Bad input: the file, or something in it.
pub fn open(path: Option<&Path>) -> Result<DeviceDescription, Failure> {
    let (name, text) = BUILT_IN_DEVICES[0];
    let document = match path {
        Some(path) => Document::read(path)?,
        None => Document::embedded(name, Path::new(""), text),
    };
    Ok(read_device(&document)?)
}
