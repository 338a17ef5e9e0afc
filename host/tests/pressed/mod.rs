//! Slabs that loads press together, without a needle: against closed forms, balances of forces, and turned scenes.

mod laws;
mod rig;
