//! The self-test's image for the ST NUCLEO-F446ZE.
#![no_std]
#![no_main]

#[path = "../selftest_app.rs"]
mod app;
