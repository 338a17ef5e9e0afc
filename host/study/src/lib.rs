//! What is asked of sessions and of tissue models, beyond running them.
//!
//! Entry points: [`fidelity`] compares what a hand feels with solves every millisecond, [`tradeoff`] error with time,
//! [`stability`] looks at the extremes; [`choice`] finds the model that suits a machine, [`explain`] says what a scene costs.

/// `status` of a table that somebody has stopped: it has what there was by then.
pub const INTERRUPTED: &str = "interrupted";

pub mod choice;
pub mod explain;
pub mod fidelity;
pub mod idle;
pub mod machine;
pub mod stability;
pub mod tradeoff;
pub mod trial;
