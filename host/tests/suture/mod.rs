//! Threads drawn through tissue by needles, and pulled.

mod extremes;
mod friction;
mod gives;
mod hanging;
mod one_length;
mod pressure;
mod pull;
mod rig;
