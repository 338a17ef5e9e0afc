//! The self-test's image for a board with motors.
#![no_std]
#![no_main]

#[path = "../selftest_app.rs"]
mod app;
