//! Sources of constraints: what acts on tissue. Each finds where it acts, appends its constraints to the set, takes over
//! what a solve found, and reports.
//!
//! Entry point: [`Source`]. A balance asks all sources of a scene ([`Sources::each`]) one after another; what they keep from
//! step to step is in [`SourcesState`](crate::step::SourcesState). `spring.rs` is an example of one that a scene adds by a
//! key of its own.

mod added;
mod handle;
mod spring;
#[cfg(test)]
pub(crate) mod testing;
pub(crate) mod tool;

pub(crate) use added::{Added, Kept, Section, scene_keys};

use crate::collide::TissueContactSource;
use crate::jaws::JawsSource;
use crate::needle::{FreeNeedleSource, NeedleSource};
use crate::rod::{BarSource, PairSource};
use crate::step::{Balance, Felt, Sources, Status};
use crate::thread::ThreadSource;
use crate::tool::ToolSample;
use handle::HandleSource;
pub(crate) use handle::{Handles, MOST_NODES};
pub use spring::SpringSection;
use tool::ToolSource;

/// What a balance asks of a source, in the order of the methods.
pub(crate) trait Source: Sync {
    /// What it needs at most in a scene.
    fn room(&self, sources: &Sources) -> Room;

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

/// What a source needs at most.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Room {
    /// Points, and ways between two.
    pub anchors: usize,
    /// Rows on one of these.
    pub rows: usize,
    /// Rows on several, and the terms of all of them.
    pub spread: usize,
    pub terms: usize,
}

impl Room {
    /// For so many points or ways, and rows on one of these each.
    pub fn new(anchors: usize, rows: usize) -> Self {
        Self {
            anchors,
            rows,
            spread: 0,
            terms: 0,
        }
    }
}

impl std::ops::Add for Room {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            anchors: self.anchors + other.anchors,
            rows: self.rows + other.rows,
            spread: self.spread + other.spread,
            terms: self.terms + other.terms,
        }
    }
}

/// Sources whose rows are on points; those that a scene adds come after them.
pub(crate) const ON_POINTS: [&dyn Source; 7] = [
    &NeedleSource,
    &TissueContactSource,
    &ToolSource,
    &HandleSource,
    &JawsSource,
    &BarSource,
    &PairSource,
];

/// Sources whose rows are on ways, or that have none.
pub(crate) const ON_WAYS: [&dyn Source; 2] = [&ThreadSource, &FreeNeedleSource];
