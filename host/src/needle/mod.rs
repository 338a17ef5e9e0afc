//! Suture needles: their shape, their way through the mesh, and the rows by which tissue holds them.
//!
//! Entry points: [`Needle`], [`Curve`]. Source: Younes 2021, sections 3.1 and 3.2, with friction-bounded
//! axial rows in place of its sticking rows (3.28), which are their limit for infinite friction.

mod shape;

pub use shape::{Curve, Needle, NeedleShape, NeedleTissue};
