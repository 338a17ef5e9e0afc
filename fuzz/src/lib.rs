//! Mutated frames, scenes, meshes and recordings against what reads them: nothing panics, and what comes out is bounded.
//!
//! Entry points: [`stream`], [`host`], [`scene`], [`mesh`] and [`recording`], each of any bytes, for libFuzzer or another engine; and
//! what `cargo xtask fuzz` runs, on a stable compiler: [`driver::run`]. The driver is the project's own because what matters has a memory: a frame is used only with the number that the session
//! has come to, and the engines that work without a nightly compiler know bytes alone. To add a target, write a
//! function of bytes, put seeds into `corpus/<name>`, and name it in `driver.rs`.
#![forbid(unsafe_code)]

mod bench;
pub mod driver;
pub mod files;
mod forge;
pub mod host_end;
mod layout;
mod mutate;
pub mod recordings;
pub mod seeds;
pub mod traffic;

pub use bench::stream;
pub use files::{mesh, scene};
pub use host_end::host;
pub use recordings::recording;
