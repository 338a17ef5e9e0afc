//! Velocity from quantised positions.
