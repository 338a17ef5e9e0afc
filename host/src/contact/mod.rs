//! Shapes that touch: how far a point is from one, and how one comes to where it is.

pub(crate) mod entry;
pub(crate) mod shape;
