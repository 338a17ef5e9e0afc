//! ChainMail: elements that move freely within bounds their neighbours set, and drag them along beyond.
//!
//! Entry points: [`ClassicalChainMail`] (zhang-2017, 3.1) and [`EllipsoidChainMail`] (zhang-2017, 3.3). Elements are
//! the nodes of a mesh, links its edges. Variants share links, queue and regions, and differ in the rest.

// An axis indexes several arrays at once.
#![allow(clippy::needless_range_loop)]

mod adjust;
mod awake;
mod classical;
mod ellipsoid;
mod forces;
mod fours;
mod links;
mod motion;
mod propagate;
mod quad;
mod queue;
mod region;
mod settings;
mod state;

pub use classical::{ClassicalChainMail, ClassicalSettings};
pub use ellipsoid::EllipsoidChainMail;
pub use settings::EllipsoidSettings;

/// Why a scene with needles or thread refuses a ChainMail: their rows hold tissue at points inside cells and
/// need the compliance between any two of them, while a ChainMail has the reaction of held nodes and a secant of
/// it, and nothing that can be condensed.
pub const REFUSAL: &str = "a ChainMail has reactions and a secant tangent of held nodes only; needles and thread \
     need the compliance between points inside cells: use linear or corotational tissue";
