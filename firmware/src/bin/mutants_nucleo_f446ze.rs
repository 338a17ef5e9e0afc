//! The image for the ST NUCLEO-F446ZE with guards that can be taken out: for the emulator alone.
#![no_std]
#![no_main]

#[path = "../app.rs"]
mod app;
