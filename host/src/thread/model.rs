//! What is constant about a scene's threads, and what a step reports of them.
//!
//! Entry points: [`ThreadPart`], [`ThreadReport`].

use thiserror::Error;

/// A thread of a model, fastened to the end of a needle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ThreadPart {
    /// Names it.
    pub id: u8,
    /// Id of the needle whose end its head is fastened to.
    pub needle: u8,
    /// Its length \[m\].
    pub length_m: f64,
    /// Coulomb's coefficient against tissue \[1\]: tension falls by e^(friction turn) where it slides around
    /// a turn (capstan).
    pub friction: f64,
    /// Tension that it bears \[N\]; it is not exceeded, the path stays longer then.
    pub strength_n: f64,
}

/// What holds one of a thread's ends.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum ThreadHold {
    /// Nothing: it is drawn into the tissue without effort.
    #[default]
    Free,
    /// A knot that is too thick for the first puncture.
    Knot,
    /// A place \[m\], (3).
    Place([f64; 3]),
    /// The grip of a tool, by its id, which takes hold of it without slack at the nearest face.
    Tool(u8),
}

/// Which end of a thread.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ThreadEnd {
    /// The one that follows.
    Tail,
    /// The one at the needle. Held by nothing it is held by the needle.
    Head,
}

/// How a thread does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ThreadTension {
    /// There is more of it than its path needs: no tension.
    #[default]
    Slack,
    /// Its path is as long as what there is of it.
    Taut,
    /// It pulls with its strength, and its path is longer than what there is of it.
    Strained,
}

/// What a step found about one thread.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ThreadReport {
    /// Which thread.
    pub id: u8,
    /// Whether it pulls.
    pub state: ThreadTension,
    /// Tension at the tail and at the head \[N\].
    pub tension_n: [f64; 2],
    /// The tools that hold its tail and its head, the latter through the needle or not.
    pub held_by: [Option<u8>; 2],
    /// Unit vectors along which it pulls what holds its tail and its head, (2 x 3); zero where nothing does.
    pub direction: [[f64; 3]; 2],
    /// Where it is held at tail and head \[m\], (2 x 3).
    pub end_m: [[f64; 3]; 2],
    /// Boundary faces that it goes through.
    pub punctures: u32,
    /// Length of its path outside the tissue and at its ends \[m\].
    pub length_m: f64,
    /// What there is of it for that \[m\].
    pub available_m: f64,
    /// Drawn out of the tissue so far by what holds the tail, and the head \[m\].
    pub pulled_m: [f64; 2],
    /// Segments of no length that the tension holds closed.
    pub welds: u32,
    /// Points of tissue outside that it bends around.
    pub wraps: u32,
    /// Spent by friction so far \[J\].
    pub dissipated_j: f64,
    /// d(tension at the head) / d(length at the head) \[N/m\].
    pub stiffness_n_per_m: f64,
}

/// A point of a thread's path, from tail to head.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ThreadPoint {
    /// Where it is \[m\], (3).
    pub at_m: [f64; 3],
    /// Where on the thread, counted from the head \[m\].
    pub along_m: f64,
    /// What it is.
    pub what: ThreadPlace,
    /// Tension between it and the next point \[N\].
    pub tension_n: f64,
}

/// What a point of a thread's path is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ThreadPlace {
    /// Held, or the needle's end.
    End,
    /// In a face within the tissue.
    Inside,
    /// In a boundary face; the thread goes into the tissue there, seen from the tail.
    Enters,
    /// In a boundary face; the thread comes out of the tissue there.
    Leaves,
    /// On the surface, where it bends around it.
    Wraps,
}

/// Why threads cannot be used.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum ThreadError {
    /// One id for two threads.
    #[error("two threads have the id {0}")]
    SameThread(u8),
    /// A needle that is not there, or has a thread already.
    #[error("thread {id} is fastened to needle {needle}, which {flaw}")]
    Needle {
        /// Which thread.
        id: u8,
        /// Which needle.
        needle: u8,
        /// What is wrong with it.
        flaw: &'static str,
    },
    /// A number out of range.
    #[error("thread {id}: `{what}` is {value}; it must be {rule}")]
    Number {
        /// Which thread.
        id: u8,
        /// Its name.
        what: &'static str,
        /// Its value.
        value: f64,
        /// What is allowed.
        rule: &'static str,
    },
}
