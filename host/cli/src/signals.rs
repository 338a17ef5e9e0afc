//! Ctrl-C and a polite `kill` end a command in order; a second one ends it at once.

use crate::failure::{Cause, Failure};
use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use sutura_host::work;

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

/// Failure of a table that ends early: it has been printed, and written where it was to be.
pub fn interrupted(lines: usize) -> Failure {
    let message = format!("interrupted: the table has the {lines} lines by then");
    let help = "what is missing can be measured by its names with --only";
    Failure::say(Cause::Interrupted, message, help).after_summary()
}

/// Returns the failure of a command that was interrupted before it had a result.
pub fn unfinished(what: &str, help: &str) -> Failure {
    Failure::say(Cause::Interrupted, format!("interrupted: {what}"), help)
}

/// Long work on this thread ends at its next stage once a flag is set, as long as this lives.
pub struct Stoppable(());

impl Stoppable {
    /// By this flag.
    pub fn by(stop: &Arc<AtomicBool>) -> Self {
        work::stop_with(Some(stop.clone()));
        Self(())
    }
}

impl Drop for Stoppable {
    fn drop(&mut self) {
        work::stop_with(None);
    }
}

/// A signal ends the program within [`GRACE`], in the midst of a stage too, as long as this lives: nothing is lost by that.
#[cfg(feature = "view")]
pub struct Hasty(());

#[cfg(feature = "view")]
impl Hasty {
    /// From now on.
    pub fn begin() -> Self {
        HASTY.store(true, Ordering::Relaxed);
        Self(())
    }
}

#[cfg(feature = "view")]
impl Drop for Hasty {
    fn drop(&mut self) {
        HASTY.store(false, Ordering::Relaxed);
    }
}

/// Longest time from a signal to the end of work that loses nothing.
const GRACE: Duration = Duration::from_secs(1);

/// See [`Hasty`].
static HASTY: AtomicBool = AtomicBool::new(false);

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
            end();
        }
        first();
        // The second signal is heard meanwhile.
        std::thread::spawn(|| {
            std::thread::sleep(GRACE);
            if HASTY.load(Ordering::Relaxed) {
                note!("interrupted");
                end();
            }
        });
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

/// Ends the program where it is.
fn end() -> ! {
    #[cfg(feature = "top")]
    crate::top::terminal::restore();
    std::process::exit(i32::from(Cause::Interrupted.code()))
}

/// Whether to go on with what is measured line by line.
pub fn then(stop: &AtomicBool) -> ControlFlow<()> {
    match stop.load(Ordering::Relaxed) {
        true => ControlFlow::Break(()),
        false => ControlFlow::Continue(()),
    }
}
