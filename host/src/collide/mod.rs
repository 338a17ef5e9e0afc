//! Contact between tissues: where boundaries meet while they move, each node on a straight line over a step.
//!
//! Entry points: [`vertex_face`] and [`edge_edge`], which never miss a meeting and may report one that is
//! none by less than a stated distance.

mod pairs;
mod patch;
mod sweep;

pub use pairs::{Path, edge_edge, vertex_face};
pub use sweep::{Impact, Margin, Sweep, Verdict};
