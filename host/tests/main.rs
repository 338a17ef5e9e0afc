//! All tests of the solver and its sessions, in one binary. What counts allocations counts those of its own thread.

mod anchors;
mod collide;
mod console_rows;
mod contact;
mod corotational;
mod driving;
mod fem_models;
mod fresh_workspace;
mod gravity;
mod half_faces;
mod hyperelastic;
mod jaws;
mod keys;
mod layers;
mod link_reconnect;
mod needle;
mod no_alloc;
mod palpation;
mod pressed;
mod rows;
mod session_models;
mod springs;
mod suture;
mod tangents;
mod tissue;
mod touch;
