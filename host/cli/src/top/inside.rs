//! The figures of a session that this program runs, in place of its bar.
//!
//! Entry points: [`Top::start`], [`Top::end`].

use super::command::{LINE_EVERY, show};
use super::figures::Figures;
use super::source::{Inside, Source as _};
use super::terminal::{Screen, failed};
use crate::failure::Failure;
use crate::view::session::Viewed;
use std::io::{self, IsTerminal as _};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Instant;

/// A thread that shows figures until the session is over.
pub struct Top {
    over: Arc<AtomicBool>,
    thread: JoinHandle<()>,
}

impl Top {
    /// Shows them on the terminal, or as a line a second on stderr where that is none; `q` sets `stop`.
    ///
    /// # Errors
    /// A terminal that is none to draw on; no thread.
    pub fn start(viewed: &Viewed, stop: Arc<AtomicBool>) -> Result<Top, Failure> {
        let is_seen = io::stdin().is_terminal() && io::stderr().is_terminal();
        let screen = is_seen.then(Screen::open).transpose();
        let screen = screen.map_err(|error| failed(&error))?;
        let source = Inside::new(viewed.shared().clone());
        let over = Arc::new(AtomicBool::new(false));
        let ends = over.clone();
        let thread = std::thread::Builder::new().name("sutura-top".to_owned());
        let thread = thread.spawn(move || match screen {
            Some(screen) => on_screen(source, screen, &ends, &stop),
            None => in_lines(source, &ends),
        });
        let thread = thread.map_err(|error| failed(&error))?;
        Ok(Top { over, thread })
    }

    /// The session is over: the terminal is as it was.
    pub fn end(self) {
        self.over.store(true, Ordering::Relaxed);
        // A panic of it has been printed.
        let _ = self.thread.join();
    }
}

fn on_screen(mut source: Inside, mut screen: Screen, over: &AtomicBool, stop: &AtomicBool) {
    match show(&mut source, &mut screen, over, "q ends the session") {
        // By its key, or because the session is over.
        Ok(_) if over.load(Ordering::Relaxed) => {}
        Ok(_) => stop.store(true, Ordering::Relaxed),
        Err(error) => {
            drop(screen);
            note!("the figures are no longer shown: {error}");
        }
    }
}

fn in_lines(mut source: Inside, over: &AtomicBool) {
    let mut figures = Figures::new(Instant::now());
    let mut said = Instant::now();
    while !over.load(Ordering::Relaxed) {
        for message in source.receive() {
            figures.hear(&message, Instant::now());
        }
        if said.elapsed() >= LINE_EVERY
            && let Some(line) = figures.line(false)
        {
            said = Instant::now();
            note!("{line}");
        }
    }
}
