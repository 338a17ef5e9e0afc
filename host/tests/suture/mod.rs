//! Threads drawn through tissue by needles, and pulled.

mod extremes;
mod hanging;
mod pull;
mod rig;
