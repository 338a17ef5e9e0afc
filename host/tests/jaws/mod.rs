//! Jaws that take hold of tissue: against dense solves and the laws of friction, and at extremes.

mod bench;
mod extremes;
mod linear;
mod rig;
mod session;
mod slip;
mod turning;
