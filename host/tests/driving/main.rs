//! Needles driven through tissue: forces, energy, derivatives, extremes.

mod bench;
mod force;
