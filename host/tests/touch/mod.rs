//! Bodies of tissue that touch: balances of two blocks, pressed by what is fixed.

mod bench;
mod cycles;
mod laws;
mod near;
mod press;
pub(crate) mod rig;
mod walks;
