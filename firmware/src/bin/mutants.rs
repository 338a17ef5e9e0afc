//! The image for a board with motors with guards that can be taken out: for the emulator alone.
#![no_std]
#![no_main]

#[path = "../app.rs"]
mod app;
