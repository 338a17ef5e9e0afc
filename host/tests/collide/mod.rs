//! Swept tests against exact arithmetic, and the search for pairs against all pairs.

mod bodies;
mod exact;
mod oracle;
mod queries;
mod sweeps;
