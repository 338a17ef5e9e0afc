//! Suture needles: their shape, their way through the mesh, and the rows by which tissue holds them.
//!
//! Entry points: [`Needle`], [`Curve`], [`slide`]. Source: Younes 2021, sections 3.1 and 3.2, with friction-bounded
//! axial rows in place of its sticking rows (3.28), which are their limit for infinite friction.

mod drive;
mod events;
mod hierarchy;
mod history;
mod kept;
mod ledger;
mod loose;
mod model;
mod rest;
mod section;
mod sewing;
mod shape;
mod slide;
mod state;
mod step;
mod tangent;
mod threads;
mod tool_rows;
mod touching;
mod walk;

pub(crate) use drive::anchor;
pub use hierarchy::{Capsule, Hierarchy, MOST_GROUPS, Slack};
pub use history::{Broken, Crossing, History};
pub(crate) use model::Needles;
pub use model::{MAX_NEEDLES, NeedleError, NeedlePart, NeedleSettings, Playback};
pub(crate) use rest::{NoRest, settle};
pub use shape::{Curve, Needle, NeedleShape, NeedleTissue};
pub use slide::{Entry, Geometry, SlideReport, SlideStatus, entry, slide};
pub(crate) use state::NeedleState;
pub use state::Rubbing;
pub use step::{NeedleReport, TipPlace};
pub(crate) use step::{NeedlesState, NeedlesWork, grip, pose_of, step};
pub(crate) use tool_rows::Wanted;
pub use walk::{Stop, Walked, walk};

/// Places on a curve that are nearer than this to each other \[m\] may be in either order by rounding alone:
/// 1e-9 of its length, which for faces nearly along the curve is still far above rounding, and far
/// below anything that tissue has.
fn tie(curve: &Curve) -> f64 {
    1e-9 * curve.length
}
