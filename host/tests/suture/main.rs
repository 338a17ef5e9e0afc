//! Threads drawn through tissue by needles, and pulled.

#[path = "../driving/bench.rs"]
#[expect(dead_code, reason = "shared with the tests of driving")]
mod bench;
mod extremes;
mod hanging;
mod pull;
mod rig;
