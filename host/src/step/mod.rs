//! One step of the solver, and what it reports.
//!
//! Entry point: [`step`], whose stages are listed in `outline.rs`. Three lifetimes: [`Model`](crate::model::Model) is
//! constant, [`State`] evolves and can be kept and compared, [`Workspace`] is scratch and a cache that could be dropped
//! between any two steps. What else a step is asked for is in its [`StepOptions`].

mod balance;
mod console;
mod kept;
mod options;
mod outline;
mod prefetch;
mod reached;
mod reduce;
mod report;
mod rest;
#[cfg(test)]
mod room_tests;
mod sources;
mod state;
mod substeps;
mod tangent;
mod targets;
mod tool_rows;
mod workspace;

pub use crate::columns::Arrival;
pub use crate::renewal::{Renewals, Rule};
pub(crate) use balance::{Balance, BalanceWork, unloaded};
pub use options::StepOptions;
pub use outline::{step, try_step};
pub(crate) use reduce::Felt;
pub use report::{Stages, Status, StepReport, ToolContact};
pub(crate) use rest::{NoRest, hold, settle};
#[cfg(test)]
pub(crate) use sources::SourcesWork;
pub(crate) use sources::{Sources, SourcesState};
pub use state::State;
pub(crate) use tangent::{Pull, slide_twist};
pub(crate) use targets::about;
pub use tool_rows::{MAX_TOOL_ROWS, ToolRowKind, ToolRows};
pub(crate) use workspace::DEFAULT_CACHE_BYTES;
pub use workspace::Workspace;
