//! `sutura top`: the figures of a session in a terminal; and those that `sutura run --top` has in place of its bar.
//!
//! Entry points: [`run`] for the command, [`Top::start`] for a session of this process.

mod args;
#[cfg(feature = "top")]
mod figures;
#[cfg(feature = "top")]
mod find;
#[cfg(feature = "top")]
mod inside;
#[cfg(feature = "top")]
mod keys;
#[cfg(feature = "top")]
mod screen;
#[cfg(feature = "top")]
mod source;
#[cfg(feature = "top")]
pub mod terminal;
#[cfg(not(feature = "top"))]
mod without;

pub use args::TopArgs;
#[cfg(feature = "top")]
pub use inside::Top;
#[cfg(not(feature = "top"))]
pub use without::{Top, run};

#[cfg(feature = "top")]
mod command {
    use super::TopArgs;
    use super::figures::Figures;
    use super::find::{Server, find};
    use super::keys::{Does, Keys};
    use super::screen::{Look, draw};
    use super::source::{Remote, Source};
    use super::terminal::Screen;
    use crate::failure::Failure;
    use crate::signals::stop_on_signals;
    use crate::{Format, Global};
    use std::io::{self, IsTerminal as _};
    use std::sync::atomic::{AtomicBool, Ordering};
    use std::time::{Duration, Instant};

    /// Between two pictures of the screen.
    const DRAW_EVERY: Duration = Duration::from_millis(100);
    /// Between two lines where there is no terminal.
    pub const LINE_EVERY: Duration = Duration::from_secs(1);

    /// Shows the figures until it is told to end, or the session's server is gone.
    ///
    /// # Errors
    /// No session, or one that refuses.
    pub fn run(args: &TopArgs, global: &Global) -> Result<(), Failure> {
        let stop = stop_on_signals()?;
        let Server { address, key, .. } = find(args.url.as_deref())?;
        let Some(mut source) = Remote::open(&address, &key, &stop)? else {
            return Ok(());
        };
        let is_seen = io::stdin().is_terminal()
            && io::stdout().is_terminal()
            && io::stderr().is_terminal()
            && global.format == Format::Text;
        let ended = if is_seen {
            let screen = Screen::open();
            let mut screen = screen.map_err(|error| super::terminal::failed(&error))?;
            let quits = "q leaves the session running";
            show(&mut source, &mut screen, &stop, quits)
                .map_err(|error| super::terminal::failed(&error))?
        } else {
            lines(&mut source, global.format, &stop)
        };
        match ended {
            Some(why) => {
                note!("{why}");
                Ok(())
            }
            None => Ok(()),
        }
    }

    /// Shows figures on a screen until `q` or `stop`; why the source has ended if it has.
    pub fn show(
        source: &mut dyn Source,
        screen: &mut Screen,
        stop: &AtomicBool,
        quits: &'static str,
    ) -> io::Result<Option<String>> {
        let mut figures = Figures::new(Instant::now());
        let mut keys = Keys::default();
        let (mut is_new, mut drawn) = (true, None::<Instant>);
        loop {
            if stop.load(Ordering::Relaxed) {
                return Ok(None);
            }
            for message in source.receive() {
                is_new |= figures.hear(&message, Instant::now());
            }
            if let Some(why) = source.ended() {
                return Ok(Some(why));
            }
            while let Some(pressed) = screen.pressed()? {
                is_new = true;
                match keys.press(pressed, &figures, Instant::now()) {
                    Does::Nothing => {}
                    Does::Quit => return Ok(None),
                    Does::Say(command) => {
                        figures.asked(source.say(command));
                    }
                }
            }
            for note in crate::display::take_notes() {
                is_new = true;
                figures.note(note);
            }
            let now = Instant::now();
            let since = drawn.map_or(Duration::MAX, |then| now.duration_since(then));
            // What grows old is redrawn without anything new.
            if (is_new && since >= DRAW_EVERY) || since >= LINE_EVERY {
                (is_new, drawn) = (false, Some(now));
                let look = Look {
                    now,
                    keys: &keys,
                    quits,
                };
                screen.draw(|frame| draw(frame, &figures, &look))?;
            }
        }
    }

    /// A line a second; why the source has ended if it has.
    fn lines(source: &mut dyn Source, format: Format, stop: &AtomicBool) -> Option<String> {
        let mut figures = Figures::new(Instant::now());
        let mut said = Instant::now();
        while !stop.load(Ordering::Relaxed) {
            for message in source.receive() {
                figures.hear(&message, Instant::now());
            }
            if let Some(why) = source.ended() {
                return Some(why);
            }
            if said.elapsed() >= LINE_EVERY
                && let Some(line) = figures.line(format == Format::Json)
            {
                said = Instant::now();
                if !crate::display::tell(&line, format) {
                    return None;
                }
            }
        }
        None
    }
}

#[cfg(feature = "top")]
pub use command::run;
