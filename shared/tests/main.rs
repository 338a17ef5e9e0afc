//! All tests of what console and host share, in one binary.

mod bounds;
mod closed_loop;
mod comeback;
mod common;
mod contact_rows;
mod control;
mod events;
mod kinematics;
mod link;
mod needle_and_thread;
mod needle_bounds;
mod passivity;
mod ramps;
mod rig;
mod round_bodies;
mod rows_values;
mod simulated_console;
mod turned;
mod virtual_device;
mod wire_frames;
mod wire_golden;
mod wire_values;
