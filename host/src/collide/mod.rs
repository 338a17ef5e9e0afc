//! Contact between tissues: where boundaries meet while they move, each node on a straight line over a step.
//!
//! Entry points: [`Body`] for the pairs of features that may meet, [`vertex_face`] and [`edge_edge`] for whether
//! and when they do. These never miss a meeting and may report one that is none by less than a stated
//! distance. [`Touching`] and [`TouchState`] make rows of them that keep bodies of tissue apart (younes-2021,
//! 2.2.6).

mod body;
mod depth;
mod feature_pair;
mod look;
mod near;
mod pairs;
mod patch;
mod shell;
mod solid;
mod source;
mod sweep;
mod touch;
mod touch_state;

pub use body::{Body, Pair};
pub use depth::{gaps_m, penetration_m};
pub use look::TouchWork;
pub use pairs::{Path, edge_edge, vertex_face};
pub(crate) use patch::closest;
pub use solid::{Penetration, Solid};
pub(crate) use source::TissueContactSource;
pub use sweep::{Impact, Margin, Sweep, Verdict};
pub use touch::{TouchError, TouchPart, TouchSettings, Touching};
pub use touch_state::TouchState;
pub(crate) use touch_state::across;
