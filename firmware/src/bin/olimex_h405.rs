//! The image for the Olimex STM32-H405.
#![no_std]
#![no_main]

#[cfg(feature = "mutants")]
compile_error!("an image for a console has all of its guards: not with the feature `mutants`");

#[path = "../app.rs"]
mod app;
