//! Suture thread: pulled through anchors in tissue.
//!
//! Entry points: [`ThreadPart`] for a thread that follows a needle in a [`crate::model::Model`];
//! [`Hanging`] for the shape of what hangs. Source: Younes 2021, section 3.3.

mod bends;
mod chain;
mod cylinder;
mod ends;
mod follow;
mod free;
mod gives;
mod hanging;
mod lap;
mod legs;
mod model;
mod nearest;
mod pressure;
mod report;
mod segments;
mod skin;
mod source;
mod state;
mod strands;
mod stretch;
mod through;
mod tighten;
mod wrap;

pub(crate) use bends::BendWork;
pub(crate) use ends::EndRows;
pub(crate) use follow::{FollowWork, Tie};
pub(crate) use lap::{Contact, Obstacle};
pub(crate) use model::{MAX_STRANDS, MOST_HANDS, Threads};
pub(crate) use report::nearest_outside;
pub(crate) use segments::Segment;
pub(crate) use skin::Skin;
pub(crate) use source::{ThreadSource, ThreadWork};
pub(crate) use state::ThreadState;
pub(crate) use wrap::{Wrap, wraps};

pub use chain::{ChainReport, ChainSettings, ChainStatus};
pub use free::FreeThreads;
pub use hanging::{Beats, Hanging};
pub use model::{
    Bridge, HandReport, ThreadBody, ThreadContact, ThreadEnd, ThreadError, ThreadHold, ThreadPart,
    ThreadPlace, ThreadPoint, ThreadReport, ThreadTension, Through, Tightening,
};
