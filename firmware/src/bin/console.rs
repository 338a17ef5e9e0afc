//! The image for a board with motors.
#![no_std]
#![no_main]

#[cfg(feature = "mutants")]
compile_error!("an image for a console has all of its guards: not with the feature `mutants`");

#[path = "../app.rs"]
mod app;
