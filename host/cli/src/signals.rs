//! Ctrl-C and a polite `kill` end a command in order; a second one ends it at once.

use crate::failure::{Cause, Failure};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Exit code of a process that a second Ctrl-C ended, as shells have it.
const INTERRUPTED: i32 = 130;

/// A flag that the first signal sets.
///
/// # Errors
/// When the system gives no handler.
pub fn stop_on_signals() -> Result<Arc<AtomicBool>, Failure> {
    let stop = Arc::new(AtomicBool::new(false));
    let flag = stop.clone();
    let set = ctrlc::set_handler(move || {
        if flag.swap(true, Ordering::Relaxed) {
            #[cfg(feature = "top")]
            crate::top::terminal::restore();
            std::process::exit(INTERRUPTED);
        }
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
