//! All tests of what console and host share, in one binary.

mod bounds;
mod breathing;
mod closed_loop;
mod coarse;
mod comeback;
mod common;
mod contact_rows;
mod control;
mod events;
mod grip;
mod kinematics;
mod lag;
mod link;
mod needle_and_thread;
mod onset;
mod passivity;
mod ramps;
mod rig;
mod rows_values;
mod simulated_console;
mod stalls;
mod turned;
mod virtual_device;
mod wire_frames;
mod wire_golden;
mod wire_values;
