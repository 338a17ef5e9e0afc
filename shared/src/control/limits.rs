//! Limits on force, slew, power and speed at the grip.
