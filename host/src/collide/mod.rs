//! Contact between tissues: where boundaries meet while they move, each node on a straight line over a step.
//!
//! Entry points: [`Body`] for the pairs of features that may meet, [`vertex_face`] and [`edge_edge`] for whether
//! and when they do. These never miss a meeting and may report one that is none by less than a stated
//! distance.

mod body;
mod pairs;
mod patch;
mod sweep;
mod tree;

pub use body::{Body, Pair};
pub use pairs::{Path, edge_edge, vertex_face};
pub use sweep::{Impact, Margin, Sweep, Verdict};
pub use tree::{Bounds, Tree};
