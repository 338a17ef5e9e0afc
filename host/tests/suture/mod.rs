//! Threads drawn through tissue by needles, and pulled.

mod back;
mod by_hand;
mod cut;
mod ends;
mod extremes;
mod friction;
mod gives;
mod hands;
mod hanging;
mod in_the_air;
mod laps;
mod least;
mod one_length;
mod over;
mod pressure;
mod pull;
mod rig;
mod tighten;
mod u_stitch;
mod whole;
