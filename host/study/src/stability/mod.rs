//! Every tissue model, the row solver and the console at the extremes: what holds, what gets worse, what refuses.
//!
//! Entry points: [`suite::measure`]; [`judge`] has the criteria, with their numbers, in one place.

mod console;
mod extremes;
pub mod judge;
mod rows;
pub mod suite;
