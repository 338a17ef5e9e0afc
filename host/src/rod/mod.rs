//! Rods: balls swept along curves, which touch the tissue's surface, and each other. Bodies of needles are rods, and bodies of grips:
//! [`Bar`].
//!
//! Entry points: `Rod` for what one is, `Swept` for one where it is; `touch.rs` says where it touches, and `feature.rs` what;
//! [`BodyContact`] for two of them that press on each other, by `press.rs`. `inside.rs` says whether one has come into the tissue.

mod bar;
mod feature;
mod inside;
mod pair;
mod press;
mod shape;
mod source;
mod touch;

pub(crate) use bar::BarState;
pub use bar::{Bar, BarPart};
pub use pair::{BodyContact, STIFFEST_PAIR_N_PER_M};
pub(crate) use pair::{MOST_PLACES, PairPart, PairSource, PairState};
pub(crate) use shape::{PIECE_RADII, Rod};
pub(crate) use source::{BarSource, BarWork};
pub(crate) use touch::{CORRECTED, MOST_TOUCHES, OVERLAP, Swept, Touch, TouchWork};
