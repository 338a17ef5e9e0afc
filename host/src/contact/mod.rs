//! Shapes that touch: how far a point is from one, and how one comes to where it is.

mod capsule;
pub(crate) mod entry;
mod mesh;
mod rounded_box;
pub(crate) mod shape;
#[cfg(test)]
mod shape_tests;
