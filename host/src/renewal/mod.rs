//! Long work beside the steps: a new factor of turning tissue, and the columns of it.
//!
//! Entry points: [`Renewer`], which the cache of columns owns; [`Renewal`] is what it makes. A factor is asked for
//! before it is needed. A thread factors the tangent of that moment and computes the columns in use, while steps go
//! on with the factor that they have, which preconditions the present tangent; then both change places with the old
//! ones. What is taken over depends on the step in which that happens, and on nothing else.

mod renewer;
#[cfg(test)]
mod tests;
mod thread;

pub(crate) use renewer::Renewer;

use crate::columns::Bank;
use crate::fem::Renewed;
use serde::Serialize;

/// When a renewed factor is taken over.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rule {
    /// So many steps after it was asked for; a step waits for it if need be: the same on every machine.
    After(u32),
    /// In the first step that finds it there.
    WhenThere,
    /// In the steps that a recording says.
    AsRecorded,
}

impl Rule {
    /// Few, because tissue that turns fast outruns a factor that is on its way, and a wait changes no bits.
    const STEPS: u32 = 2;
    /// For sessions that are the same on every machine.
    pub const SAME_EVERYWHERE: Self = Self::After(Self::STEPS);

    /// At so many times the turn that makes a factor old it is of no help any more, and a step makes one itself. Where
    /// steps wait for factors anyway that is where a stale solve does harm; a step in real time that is late by a whole
    /// factor does more: conjugate gradients go on with the old one.
    pub(crate) fn helpless(self) -> f64 {
        match self {
            Self::After(_) => 2.0,
            Self::WhenThere | Self::AsRecorded => 16.0,
        }
    }
}

/// What a step had to do with factors that are made beside it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Renewals {
    /// Factors asked for.
    pub asked: u32,
    /// Factors taken over.
    pub adopted: u32,
    /// Those of them that the step had to wait for, or made itself.
    pub waited: u32,
    /// Tangents that could not be factored: the last good factor stays.
    pub failed: u32,
    /// Vertices whose columns of the new factor the step had to compute: nobody knew of them in time.
    pub columns_late: u32,
}

impl Renewals {
    /// Both together.
    pub fn plus(self, other: Self) -> Self {
        Self {
            asked: self.asked + other.asked,
            adopted: self.adopted + other.adopted,
            waited: self.waited + other.waited,
            failed: self.failed + other.failed,
            columns_late: self.columns_late + other.columns_late,
        }
    }
}

/// A factor and its columns, in the making or made.
pub(crate) struct Renewal {
    /// Of what was asked for.
    ticket: u64,
    tangent: Renewed,
    columns: Bank,
    /// Vertices whose columns are to be computed.
    wanted: Vec<u32>,
    /// Step in which it was asked for.
    asked: u64,
    #[cfg(test)]
    handicap: Handicap,
}

/// How a test hinders the thread.
#[cfg(test)]
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Handicap {
    pub delay: std::time::Duration,
    pub fails: bool,
}
