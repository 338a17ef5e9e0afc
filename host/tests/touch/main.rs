//! Bodies of tissue that touch: balances of two blocks, pressed by what is fixed.

mod press;
mod rig;
