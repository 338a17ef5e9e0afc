//! Suture thread: pulled through anchors in tissue.
//!
//! Entry points: [`ThreadPart`] for a thread that follows a needle in a [`crate::model::Model`];
//! [`pull::ThreadSolver`] for one alone. Source: Younes 2021, section 3.3.

#[cfg_attr(not(test), expect(dead_code))]
mod chain;
mod model;
#[cfg_attr(not(test), expect(dead_code))]
mod nearest;
pub mod pull;
#[cfg_attr(not(test), expect(dead_code))]
mod skin;
mod tension;
#[cfg_attr(not(test), expect(dead_code))]
mod wrap;

pub use model::{
    ThreadEnd, ThreadError, ThreadHold, ThreadPart, ThreadPlace, ThreadPoint, ThreadReport,
    ThreadTension,
};
