//! The image for the emulator: QEMU, machine `netduinoplus2`.
#![no_std]
#![no_main]

#[path = "../app.rs"]
mod app;
