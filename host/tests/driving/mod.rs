//! Needles driven through tissue: forces, energy, derivatives, extremes.

mod allocations;
mod arcs;
mod bars;
pub mod bench;
mod bodies;
mod energy;
mod extremes;
mod falling;
mod force;
mod grips;
mod handles;
mod overrun;
mod pairs;
mod playback;
mod pushes;
mod slips;
mod tangent;
mod thrown;
mod waiting;
mod walks;
