//! Work that may take seconds, told as it is begun: what it is, and how large.
//!
//! Entry point: [`TARGET`]. It is told as `tracing` events, whose fields are the [`WHAT`] and [`SIZE`] of the work or, while
//! it goes on, [`DONE`] parts [`OF`] so many; whoever shows progress listens, and nobody pays who does not.

/// Target of the events.
pub const TARGET: &str = "sutura::work";
/// Field with what is begun, in words.
pub const WHAT: &str = "what";
/// Field with its size, in words.
pub const SIZE: &str = "size";
/// Field with the parts that are done.
pub const DONE: &str = "done";
/// Field with all parts.
pub const OF: &str = "of";

/// Says that something is begun that may take long.
pub(crate) fn begin(what: &'static str, size: impl FnOnce() -> String) {
    if tracing::enabled!(target: TARGET, tracing::Level::INFO) {
        tracing::info!(target: TARGET, what, size = size());
    }
}

/// Says how far it is.
pub(crate) fn part(done: usize, of: usize) {
    tracing::debug!(target: TARGET, done, of);
}
