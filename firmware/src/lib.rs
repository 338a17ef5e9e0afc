//! Parts of the firmware that know no hardware, so that they are tested on the build machine; and, on the
//! target, the board layer.
//!
//! The application itself is `src/app.rs`: RTIC tasks that only wire these parts to `sutura_shared`.
#![no_std]

#[cfg(test)]
extern crate std;

#[cfg(target_os = "none")]
pub mod board;
#[cfg(test)]
mod bytes_to_pulses;
pub mod control_side;
pub mod crash_record;
pub mod devices;
pub mod drivers;
pub mod exchange;
pub mod host_side;
pub mod loader;
pub mod log_ring;
pub mod measure;
mod measure_rows;
pub mod outbox;
pub mod safe_state;
pub mod seed;
pub mod selftest;
pub mod serial_number;
pub mod signals;
pub mod watch;
