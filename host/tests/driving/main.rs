//! Needles driven through tissue: forces, energy, derivatives, extremes.

mod bench;
mod energy;
mod force;
mod tangent;
