//! Suture needles: their shape, their way through the mesh, and the rows by which tissue holds them.
//!
//! Entry points: [`Needle`], [`Curve`], [`slide`]. Source: Younes 2021, sections 3.1 and 3.2, with friction-bounded
//! axial rows in place of its sticking rows (3.28), which are their limit for infinite friction.

mod body;
mod end;
mod events;
mod fall;
mod hierarchy;
mod history;
mod ledger;
mod loose;
mod model;
mod relax;
mod report;
mod section;
mod shape;
mod slide;
mod source;
mod state;
mod surface;
mod walk;
mod yielding;

pub(crate) use fall::LONGEST_FALL_S;
pub use hierarchy::{Capsule, Hierarchy, MOST_GROUPS, Slack};
pub use history::{Broken, Crossing, History};
pub(crate) use loose::FreeNeedleSource;
pub use model::{MAX_NEEDLES, NeedleError, NeedlePart, NeedleSettings, NeedleWeight, Playback};
pub(crate) use model::{check, contains};
pub use report::{NeedleReport, TipPlace};
pub use shape::{
    Curve, Joints, MOST_SEGMENTS, Needle, NeedleSegment, NeedleSegments, NeedleShape, NeedleTissue,
};
pub use slide::{Entry, Geometry, SlideReport, SlideStatus, entry, slide};
pub(crate) use source::{NeedleSource, NeedleWork, Point, STIFFEST_M_PER_N, What, anchor};
pub use state::CrossingFriction;
pub(crate) use state::{Grip, NeedleState, Tip};
pub(crate) use surface::{Lie, cone, friction_of};
pub use walk::{Stop, Walked, walk, walk_back};
pub(crate) use yielding::Push;

/// Places on a curve that are nearer than this to each other \[m\] may be in either order by rounding alone:
/// 1e-9 of its length, which for faces nearly along the curve is still far above rounding, and far
/// below anything that tissue has.
fn tie(curve: &Curve) -> f64 {
    1e-9 * curve.length
}
