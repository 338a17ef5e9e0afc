//! Jaws: two pads on a grip that take hold of the tissue between them, and lift, pull and turn it.
//!
//! Entry points: [`Jaws`] and [`JawsPart`] for a [`crate::model::Model`], [`crate::step::State::act`] to take hold and let
//! go. Points of the boundary between the pads are held across these by equality rows, and in their plane by Coulomb's law at
//! the given clamping force, of which each point has its share. Nothing moves and no force changes when jaws take hold.

mod between;
mod model;
mod report;
mod source;
mod state;
mod tangent;

pub(crate) use between::between;
pub use model::{
    DEFAULT_LENGTH_M, DEFAULT_OPENING_DEG, DEFAULT_POINTS, DEFAULT_WIDTH_M, FEWEST_POINTS, Jaws,
    JawsPart, MOST_POINTS,
};
pub use report::JawsReport;
pub(crate) use source::{JawsSource, JawsWork};
pub(crate) use state::JawsState;
pub use state::{Grasped, Pads};
pub(crate) use tangent::Gripped;
