//! The image for the ST NUCLEO-F446ZE.
#![no_std]
#![no_main]

#[path = "../app.rs"]
mod app;
