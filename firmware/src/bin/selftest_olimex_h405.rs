//! The self-test's image for the Olimex STM32-H405.
#![no_std]
#![no_main]

#[path = "../selftest_app.rs"]
mod app;
