//! Work that takes seconds before a command's own begins: what it is, how large, and how far.
//!
//! Entry points: [`Layer`], which hears of it, and [`watch`], while whose guard lives it is shown: as a bar on a terminal, else
//! as one line on stderr for each piece of work that takes longer than a second, and another every ten.

use crate::signals::stopped;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::fmt;
use std::io::IsTerminal;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use sutura_host::text::escaped;
use sutura_host::work::{DONE, END, OF, SIZE, TARGET, WHAT};
use tracing::field::{Field, Visit};
use tracing::{Event, Subscriber};
use tracing_subscriber::layer::Context;

/// Longer than this, and somebody who waits wonders.
const LONG: Duration = Duration::from_secs(1);
/// Longer than this without another word, and somebody who reads a log wonders whether it goes on.
const AGAIN: Duration = Duration::from_secs(10);

static SHOWN: Mutex<Option<Shown>> = Mutex::new(None);
static CHANGED: Condvar = Condvar::new();

/// What is shown at present.
struct Shown {
    /// None where stderr is no terminal.
    bar: Option<ProgressBar>,
    /// Piece of work that goes on.
    now: Option<Piece>,
    /// Work that it is a piece of, if anything says so by its end.
    whole: Option<Piece>,
    began: Instant,
    /// Whether anything has been.
    told: bool,
}

/// A piece of work.
struct Piece {
    what: String,
    since: Instant,
    /// Time of the last line about it.
    said: Option<Instant>,
    /// Parts that are done, and all.
    share: Option<(u64, u64)>,
}

impl Piece {
    fn new(what: String, since: Instant) -> Self {
        Self {
            what,
            since,
            said: None,
            share: None,
        }
    }

    /// Returns a line of a log.
    fn line(&self, now: Instant) -> String {
        let Self { what, share, .. } = self;
        if self.said.is_none() {
            return format!("{what} ..");
        }
        let seconds = now.saturating_duration_since(self.since).as_secs_f64();
        match *share {
            Some((done, of)) if of > 0 => {
                let share = 100.0 * done as f64 / of as f64;
                format!("{what}: {share:.0} % after {seconds:.0} s ..")
            }
            _ => format!("{what}: {seconds:.0} s so far .."),
        }
    }
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
        whole: None,
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
        if last.told && last.bar.is_none() && !stopped() {
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
    /// Shows which work goes on now.
    fn head(&self) {
        if let (Some(bar), Some(piece)) = (&self.bar, &self.now) {
            bar.set_style(ProgressStyle::default_spinner());
            bar.set_message(escaped(&piece.what));
        }
        CHANGED.notify_all();
    }

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
        let Some(piece) = &mut self.now else {
            return LONG;
        };
        let due = match piece.said {
            None => piece.since + LONG,
            Some(said) => said + AGAIN,
        };
        let left = due.saturating_duration_since(now);
        if left.is_zero() {
            note!("{}", piece.line(now));
            (piece.said, self.told) = (Some(now), true);
        }
        if left.is_zero() { AGAIN } else { left }
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
            shown.whole = shown.now.replace(Piece::new(what, Instant::now()));
            shown.head();
        }
        if told.ends && shown.whole.is_some() {
            shown.now = shown.whole.take();
            shown.head();
        }
        let (Some(done), Some(of)) = (told.done, told.of) else {
            return;
        };
        if let Some(piece) = &mut shown.now {
            piece.share = Some((done, of));
        }
        if let Some(bar) = &shown.bar {
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
    ends: bool,
}

impl Visit for Told {
    fn record_bool(&mut self, field: &Field, value: bool) {
        self.ends |= value && field.name() == END;
    }

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
    fn only_what_is_long_is_told_and_again_every_ten_seconds() {
        let began = Instant::now();
        let mut shown = Shown {
            bar: None,
            now: None,
            whole: None,
            began,
            told: false,
        };
        assert_eq!(shown.tell(began + 5 * LONG), LONG);
        assert!(!shown.told);
        shown.now = Some(Piece::new("factoring".to_owned(), began));
        assert_eq!(shown.tell(began + LONG / 4), 3 * LONG / 4);
        assert!(!shown.told);
        assert_eq!(shown.tell(began + LONG), AGAIN);
        assert!(shown.told);
        shown.told = false;
        assert_eq!(shown.tell(began + 2 * LONG), AGAIN - LONG);
        assert!(!shown.told);
        assert_eq!(shown.tell(began + LONG + AGAIN), AGAIN);
        assert!(shown.told);
    }

    #[test]
    fn a_piece_that_is_done_gives_way_to_the_work_that_it_is_of() {
        use tracing_subscriber::layer::SubscriberExt as _;
        let heard = tracing_subscriber::registry().with(Layer);
        tracing::subscriber::with_default(heard, || {
            *shown() = Some(Shown {
                bar: None,
                now: None,
                whole: None,
                began: Instant::now(),
                told: false,
            });
            let goes_on = || {
                let guard = shown();
                let piece = guard.as_ref().and_then(|shown| shown.now.as_ref());
                piece.map(|piece| (piece.what.clone(), piece.share))
            };
            let ends = || tracing::debug!(target: TARGET, end = true);
            ends();
            assert_eq!(goes_on(), None);
            tracing::info!(target: TARGET, what = "looking for rest", size = "all");
            tracing::debug!(target: TARGET, done = 3_u64, of = 4_u64);
            tracing::info!(target: TARGET, what = "computing columns", size = "2");
            tracing::debug!(target: TARGET, done = 2_u64, of = 2_u64);
            ends();
            assert_eq!(
                goes_on(),
                Some(("looking for rest: all".to_owned(), Some((3, 4))))
            );
            ends();
            assert_eq!(
                goes_on(),
                Some(("looking for rest: all".to_owned(), Some((3, 4))))
            );
            *shown() = None;
        });
    }

    #[test]
    fn a_line_says_the_share_where_it_is_known() {
        let began = Instant::now();
        let mut piece = Piece::new("factoring".to_owned(), began);
        assert_eq!(piece.line(began + LONG), "factoring ..");
        piece.said = Some(began + LONG);
        assert_eq!(piece.line(began + AGAIN), "factoring: 10 s so far ..");
        piece.share = Some((3, 4));
        assert_eq!(piece.line(began + AGAIN), "factoring: 75 % after 10 s ..");
    }
}
