//! The image for the Olimex STM32-H405 with guards that can be taken out: for the emulator alone.
#![no_std]
#![no_main]

#[path = "../app.rs"]
mod app;
