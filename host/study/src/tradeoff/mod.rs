//! Error against time of every tissue model, on cases with known answers.
//!
//! Entry points: [`table::Plan`] for the whole table, [`measure::measure`] for its lines, [`sutura_host::registry`] for the models, [`cases::all`] for the
//! cases. Two answers are computed by the program itself: Newton's balance of the same cells and law (what is
//! off then is the model or its solver), and quadratic cells (what is off then is everything). A suture, which has
//! neither, is a table of its own: [`suture::measure`].

pub mod cases;
pub mod front;
pub mod lattice;
pub mod literature;
pub mod measure;
pub mod suture;
pub mod table;
pub mod truth;
