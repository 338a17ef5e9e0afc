//! Sources of constraints: what acts on tissue. Each finds where it acts, appends its constraints to the set, takes over
//! what a solve found, and reports.
//!
//! Entry point: [`Source`]. A balance asks the sources of [`SOURCES`] one after another; what they keep from step to step
//! is in [`SourcesState`](crate::step::SourcesState).

mod handle;
pub(crate) mod tool;

use crate::collide::TissueContactSource;
use crate::needle::{FreeNeedleSource, NeedleSource};
use crate::step::{Balance, Felt, Status};
use crate::thread::ThreadSource;
use crate::tool::ToolSample;
use handle::HandleSource;
pub(crate) use handle::{Handles, MOST_NODES};
use tool::ToolSource;

/// What a balance asks of a source, in the order of the methods. Only rows are a must.
pub(crate) trait Source: Sync {
    /// Before the solves of a round: bounds of friction, paths of threads.
    fn prepare(&self, _balance: &mut Balance) {}

    /// Appends its points and rows to the set, where the last solve left the tissue. Points come before ways.
    fn append(&self, balance: &mut Balance);

    /// Changes the compliance of its rows for the `solve`th solve of a round: what gives way besides the tissue.
    fn soften(&self, _balance: &mut Balance, _solve: u32) {}

    /// Takes over the `solve`th solve and linearises its rows anew; whether that was not needed.
    ///
    /// # Errors
    /// What makes a balance impossible.
    fn settle(&self, _balance: &mut Balance, _solve: u32) -> Result<bool, Status> {
        Ok(true)
    }

    /// Asked once all have settled: whether it has met what had no rows.
    fn meets(&self, _balance: &mut Balance) -> bool {
        false
    }

    /// At the end of a round: what happens now that tissue is where it is (punctures, tips that let go), while the way of
    /// the needle `played` is played back, if there is one; whether there are other rows for that, and so another round.
    ///
    /// # Errors
    /// What makes a balance impossible.
    fn advance(&self, _balance: &mut Balance, _played: Option<usize>) -> Result<bool, Status> {
        Ok(false)
    }

    /// A balance is found. Asked in reverse order.
    fn accept(&self, _balance: &mut Balance) {}

    /// Adds what a tool feels of it.
    fn feel(&self, _balance: &mut Balance, _felt: &mut Felt) {}

    /// Says what a step found, in the report.
    fn report(&self, _balance: &mut Balance, _samples: &[ToolSample]) {}
}

/// All sources. Their order is that of their rows in the set.
pub(crate) const SOURCES: [&dyn Source; 6] = [
    &NeedleSource,
    &TissueContactSource,
    &ToolSource,
    &HandleSource,
    &ThreadSource,
    &FreeNeedleSource,
];
