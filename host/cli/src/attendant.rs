//! What happens when a console goes away during a session: the user is told, and arms it again.
//!
//! Entry point: [`Operator`].

use std::io::IsTerminal;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use sutura_host::link::LinkError;
use sutura_host::session::Attendant;

/// Tells on stderr what happens; arms again by itself if it is to, else when Enter is pressed on a terminal.
#[derive(Debug)]
pub struct Operator {
    rearms: bool,
    /// Whether Enter has been pressed; none while nobody listens.
    enter: Option<Arc<AtomicBool>>,
}

impl Operator {
    /// `rearms`: arms the console by itself.
    pub fn new(rearms: bool) -> Self {
        Operator {
            rearms,
            enter: None,
        }
    }

    /// Listens to the terminal, if there is one, until the program ends.
    fn listen(&mut self) {
        if self.rearms || self.enter.is_some() || !std::io::stdin().is_terminal() {
            return;
        }
        let pressed = Arc::new(AtomicBool::new(false));
        let press = pressed.clone();
        let listening = std::thread::Builder::new()
            .name("sutura-enter".to_owned())
            .spawn(move || {
                let mut line = String::new();
                while std::io::stdin().read_line(&mut line).is_ok_and(|n| n > 0) {
                    press.store(true, Ordering::Relaxed);
                }
            });
        self.enter = listening.is_ok().then_some(pressed);
    }
}

impl Operator {
    /// What arms the console next, in words.
    fn ready(&mut self) -> &'static str {
        self.listen();
        match &self.enter {
            _ if self.rearms => "it is armed again",
            Some(pressed) => {
                pressed.store(false, Ordering::Relaxed);
                "press Enter to arm it"
            }
            None => "it stays at rest; with --rearm it is armed by itself",
        }
    }
}

impl Attendant for Operator {
    fn lost(&mut self, why: &LinkError) {
        note!("{why}; its force goes to zero by itself, and it is looked for");
    }

    fn back(&mut self) {
        let next = self.ready();
        note!("the console is back, at rest: {next}");
    }

    fn let_go(&mut self) {
        let next = self.ready();
        note!("the console has let go, since no contact came in time for half a second: {next}");
    }

    fn arms(&mut self) -> bool {
        let pressed = |enter: &Arc<AtomicBool>| enter.swap(false, Ordering::Relaxed);
        self.rearms || self.enter.as_ref().is_some_and(pressed)
    }
}
