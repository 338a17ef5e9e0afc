//! The image for the Olimex STM32-H405.
#![no_std]
#![no_main]

#[path = "../app.rs"]
mod app;
