//! Rods: balls swept along curves, which touch the tissue's surface. Bodies of needles are rods, and bodies of grips: [`Bar`].
//!
//! Entry points: `Rod` for what one is, `Swept` for one where it is; `touch.rs` says where it touches, and `feature.rs` what.

mod bar;
mod feature;
mod shape;
mod source;
mod touch;

pub(crate) use bar::BarState;
pub use bar::{Bar, BarPart};
pub(crate) use shape::{PIECE_RADII, Rod};
pub(crate) use source::{BarSource, BarWork};
pub(crate) use touch::{CORRECTED, MOST_TOUCHES, OVERLAP, Swept, Touch, TouchWork};
