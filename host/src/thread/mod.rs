//! Suture thread: pulled through anchors in tissue.
//!
//! Entry point: [`pull::ThreadSolver`]. Source: Younes 2021, section 3.3.

pub mod pull;
mod tension;
