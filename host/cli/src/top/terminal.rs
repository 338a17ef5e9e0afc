//! The terminal while figures are drawn on it: taken, and given back however the program ends.
//!
//! Entry points: [`Screen::open`]; [`restore`] for whoever ends the program at once.

use crate::failure::{Cause, Failure};
use ratatui::backend::CrosstermBackend;
use ratatui::crossterm::cursor::Show;
use ratatui::crossterm::event::{self, Event, KeyCode, KeyEventKind, KeyModifiers};
use ratatui::crossterm::execute;
use ratatui::crossterm::terminal::{
    EnterAlternateScreen, LeaveAlternateScreen, disable_raw_mode, enable_raw_mode,
};
use ratatui::{Frame, Terminal};
use std::io::{self, BufWriter, Stderr};
use std::sync::Once;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Whether the terminal is taken.
static TAKEN: AtomicBool = AtomicBool::new(false);
static HOOK: Once = Once::new();

/// A key, or that the screen has another size.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pressed {
    /// A letter.
    Key(char),
    /// Ctrl-C.
    Interrupt,
    /// Anything else.
    Other,
    /// The screen's size is another one.
    Resized,
}

/// A terminal that is drawn on, by way of stderr: stdout is for results. Dropped, it is as it was.
pub struct Screen(Terminal<CrosstermBackend<BufWriter<Stderr>>>);

impl Screen {
    /// Takes the terminal.
    ///
    /// # Errors
    /// What the system says.
    pub fn open() -> io::Result<Screen> {
        HOOK.call_once(|| {
            let before = std::panic::take_hook();
            std::panic::set_hook(Box::new(move |panic| {
                restore();
                before(panic);
            }));
        });
        TAKEN.store(true, Ordering::SeqCst);
        crate::display::hold_notes();
        let opened = enable_raw_mode()
            .and_then(|()| execute!(io::stderr(), EnterAlternateScreen))
            .and_then(|()| Terminal::new(CrosstermBackend::new(BufWriter::new(io::stderr()))));
        match opened {
            Ok(terminal) => Ok(Screen(terminal)),
            Err(error) => {
                restore();
                Err(error)
            }
        }
    }

    /// Draws all of it.
    ///
    /// # Errors
    /// The terminal is gone.
    pub fn draw(&mut self, draw: impl FnOnce(&mut Frame<'_>)) -> io::Result<()> {
        self.0.draw(draw).map(|_| ())
    }

    /// The next key, if one has been pressed.
    ///
    /// # Errors
    /// The terminal is gone.
    pub fn pressed(&mut self) -> io::Result<Option<Pressed>> {
        if !event::poll(Duration::ZERO)? {
            return Ok(None);
        }
        Ok(Some(match event::read()? {
            Event::Key(key) if key.kind == KeyEventKind::Release => Pressed::Other,
            Event::Key(key) => match key.code {
                KeyCode::Char('c') if key.modifiers.contains(KeyModifiers::CONTROL) => {
                    Pressed::Interrupt
                }
                KeyCode::Char(letter) => Pressed::Key(letter),
                _ => Pressed::Other,
            },
            Event::Resize(..) => Pressed::Resized,
            _ => Pressed::Other,
        }))
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        restore();
    }
}

/// Gives the terminal back if it is taken, and says what could not be said meanwhile.
pub fn restore() {
    if !TAKEN.swap(false, Ordering::SeqCst) {
        return;
    }
    // A terminal that is gone needs nothing.
    let _ = disable_raw_mode();
    let _ = execute!(io::stderr(), LeaveAlternateScreen, Show);
    crate::display::release_notes();
}

/// A terminal that cannot be drawn on.
pub fn failed(error: &io::Error) -> Failure {
    let message = format!("the terminal cannot be drawn on: {error}");
    let help = "send the output to a file or a pipe, and there is a line a second instead";
    Failure::say(Cause::Failed, message, help)
}
