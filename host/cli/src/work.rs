//! Work that takes seconds before a command's own begins: what it is, how large, and how far.
//!
//! Entry points: [`Layer`], which hears of it, and [`watch`], while whose guard lives it is shown: as a bar on a terminal, else
//! as one line on stderr for each piece of work that takes longer than a second.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::fmt;
use std::io::IsTerminal;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use sutura_host::text::escaped;
use sutura_host::work::{DONE, OF, SIZE, TARGET, WHAT};
use tracing::field::{Field, Visit};
use tracing::{Event, Subscriber};
use tracing_subscriber::layer::Context;

/// Longer than this, and somebody who waits wonders.
const LONG: Duration = Duration::from_secs(1);

static SHOWN: Mutex<Option<Shown>> = Mutex::new(None);
static CHANGED: Condvar = Condvar::new();

/// What is shown at present.
struct Shown {
    /// None where stderr is no terminal.
    bar: Option<ProgressBar>,
    /// What goes on, since when, and whether that has been said.
    now: Option<(String, Instant, bool)>,
    began: Instant,
    /// Whether anything has been.
    told: bool,
}

fn shown() -> MutexGuard<'static, Option<Shown>> {
    SHOWN.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Shows long work until the guard is dropped.
pub fn watch() -> Watched {
    // Drawn once it is long.
    let bar = std::io::stderr()
        .is_terminal()
        .then(|| ProgressBar::with_draw_target(None, ProgressDrawTarget::hidden()));
    *shown() = Some(Shown {
        bar,
        now: None,
        began: Instant::now(),
        told: false,
    });
    let teller = std::thread::Builder::new().name("sutura-work".to_owned());
    // Without it the work is done in silence.
    let teller = teller.spawn(tell).ok();
    Watched { teller }
}

/// Ends the showing when dropped.
pub struct Watched {
    teller: Option<JoinHandle<()>>,
}

impl Drop for Watched {
    fn drop(&mut self) {
        let last = shown().take();
        CHANGED.notify_all();
        if let Some(teller) = self.teller.take() {
            let _ = teller.join();
        }
        let Some(last) = last else { return };
        if let Some(bar) = &last.bar {
            bar.finish_and_clear();
        }
        if last.told && last.bar.is_none() {
            note!("done after {:.1} s", last.began.elapsed().as_secs_f64());
        }
    }
}

/// What has gone on for too long is drawn on a terminal, else said, once each.
fn tell() {
    let mut guard = shown();
    while let Some(all) = guard.as_mut() {
        let wait = all.tell(Instant::now());
        let waited = CHANGED.wait_timeout(guard, wait);
        guard = waited.unwrap_or_else(PoisonError::into_inner).0;
    }
}

impl Shown {
    /// Tells what is due, and how long it is until something else may be.
    fn tell(&mut self, now: Instant) -> Duration {
        if let Some(bar) = &self.bar {
            let left = LONG.saturating_sub(now.saturating_duration_since(self.began));
            if left.is_zero() && !self.told {
                self.told = true;
                bar.set_draw_target(ProgressDrawTarget::stderr());
                bar.enable_steady_tick(Duration::from_millis(100));
            }
            return if left.is_zero() { LONG } else { left };
        }
        let Some((what, since, said)) = self.now.as_mut().filter(|(_, _, said)| !said) else {
            return LONG;
        };
        let left = LONG.saturating_sub(now.saturating_duration_since(*since));
        if !left.is_zero() {
            return left;
        }
        note!("{what} ..");
        (*said, self.told) = (true, true);
        LONG
    }
}

/// Hears of long work.
pub struct Layer;

impl<S: Subscriber> tracing_subscriber::Layer<S> for Layer {
    fn on_event(&self, event: &Event<'_>, _: Context<'_, S>) {
        if event.metadata().target() != TARGET {
            return;
        }
        let mut told = Told::default();
        event.record(&mut told);
        let mut guard = shown();
        let Some(shown) = guard.as_mut() else { return };
        if let Told {
            what: Some(what),
            size,
            ..
        } = &told
        {
            let what = match size {
                Some(size) => format!("{what}: {size}"),
                None => what.clone(),
            };
            if let Some(bar) = &shown.bar {
                bar.set_style(ProgressStyle::default_spinner());
                bar.set_message(escaped(&what));
            }
            shown.now = Some((what, Instant::now(), false));
            CHANGED.notify_all();
        }
        if let (Some(bar), Some(done), Some(of)) = (&shown.bar, told.done, told.of) {
            if let Ok(style) = ProgressStyle::with_template("{bar:30} {pos}/{len} {msg}") {
                bar.set_style(style);
            }
            bar.set_length(of);
            bar.set_position(done);
        }
    }
}

/// The fields of an event.
#[derive(Default)]
struct Told {
    what: Option<String>,
    size: Option<String>,
    done: Option<u64>,
    of: Option<u64>,
}

impl Visit for Told {
    fn record_str(&mut self, field: &Field, value: &str) {
        match field.name() {
            WHAT => self.what = Some(value.to_owned()),
            SIZE => self.size = Some(value.to_owned()),
            _ => {}
        }
    }

    fn record_u64(&mut self, field: &Field, value: u64) {
        match field.name() {
            DONE => self.done = Some(value),
            OF => self.of = Some(value),
            _ => {}
        }
    }

    fn record_debug(&mut self, field: &Field, value: &dyn fmt::Debug) {
        self.record_str(field, &format!("{value:?}"));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_is_long_is_told_and_that_once() {
        let began = Instant::now();
        let mut shown = Shown {
            bar: None,
            now: None,
            began,
            told: false,
        };
        assert_eq!(shown.tell(began + 5 * LONG), LONG);
        assert!(!shown.told);
        shown.now = Some(("factoring".to_owned(), began, false));
        assert_eq!(shown.tell(began + LONG / 4), 3 * LONG / 4);
        assert!(!shown.told);
        shown.tell(began + LONG);
        assert!(shown.told);
        assert!(shown.now.as_ref().is_some_and(|(_, _, said)| *said));
        shown.told = false;
        assert_eq!(shown.tell(began + 2 * LONG), LONG);
        assert!(!shown.told);
    }
}
