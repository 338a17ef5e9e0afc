//! Ctrl-C and a polite `kill` end a command in order; a second one ends it at once.

use crate::failure::{Cause, Failure};
use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// A flag that the first signal sets.
///
/// # Errors
/// When the system gives no handler.
pub fn stop_on_signals() -> Result<Arc<AtomicBool>, Failure> {
    on_signals(|| {})
}

/// The same for work that goes on to the end of the line at hand, which may take long: that is said.
///
/// # Errors
/// When the system gives no handler.
pub fn stop_after_a_line() -> Result<Arc<AtomicBool>, Failure> {
    on_signals(|| note!("the line at hand is finished first; Ctrl-C again ends at once"))
}

/// What is left of a table that has been printed, and written where it was to be.
pub fn interrupted(lines: usize) -> Failure {
    let message = format!("interrupted: the table has the {lines} lines by then");
    let help = "what is missing can be measured by its names with --only";
    Failure::say(Cause::Interrupted, message, help).after_summary()
}

/// Whether a signal came.
static STOPPED: AtomicBool = AtomicBool::new(false);

/// Whether a signal has set the flag of this process.
pub fn stopped() -> bool {
    STOPPED.load(Ordering::Relaxed)
}

fn on_signals(first: impl Fn() + Send + 'static) -> Result<Arc<AtomicBool>, Failure> {
    let stop = Arc::new(AtomicBool::new(false));
    let flag = stop.clone();
    let set = ctrlc::set_handler(move || {
        STOPPED.store(true, Ordering::Relaxed);
        if flag.swap(true, Ordering::Relaxed) {
            #[cfg(feature = "top")]
            crate::top::terminal::restore();
            std::process::exit(i32::from(Cause::Interrupted.code()));
        }
        first();
    });
    set.map_err(|error| {
        Failure::say(
            Cause::Failed,
            format!("signals cannot be handled: {error}"),
            "start the command from a shell",
        )
    })?;
    Ok(stop)
}

/// Whether to go on with what is measured line by line.
pub fn then(stop: &AtomicBool) -> ControlFlow<()> {
    match stop.load(Ordering::Relaxed) {
        true => ControlFlow::Break(()),
        false => ControlFlow::Continue(()),
    }
}
