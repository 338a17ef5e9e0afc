//! Suture thread: pulled through anchors in tissue.
//!
//! Entry points: [`ThreadPart`] for a thread that follows a needle in a [`crate::model::Model`];
//! [`pull::ThreadSolver`] for one alone. Source: Younes 2021, section 3.3.

mod model;
pub mod pull;
mod tension;

pub use model::{
    ThreadEnd, ThreadError, ThreadHold, ThreadPart, ThreadPlace, ThreadPoint, ThreadReport,
    ThreadTension,
};
