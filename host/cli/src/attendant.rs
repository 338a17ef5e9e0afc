//! What happens when a console goes away or lets go during a session: the user is told, and arms it again.
//!
//! Entry points: [`Operator`]; [`Lasting`] for force that is kept back, and for a needle that waits. Enter arms it, or a line that a script writes to standard input.

use std::io::IsTerminal;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use sutura_host::link::LinkError;
use sutura_host::session::{Arms, Attendant, Stop};

/// Tells on stderr what happens; arms again by itself if it is to, else when a line comes on standard input.
#[derive(Debug)]
pub struct Operator {
    rearms: bool,
    /// Whether keys of a screen arm, and standard input is that screen's.
    has_keys: bool,
    /// None while nobody listens.
    lines: Option<Arc<Lines>>,
}

/// What came on standard input.
#[derive(Debug, Default)]
struct Lines {
    came: AtomicBool,
    over: AtomicBool,
}

impl Operator {
    /// `rearms`: arms the console by itself.
    pub fn new(rearms: bool) -> Self {
        Operator {
            rearms,
            has_keys: false,
            lines: None,
        }
    }

    /// Where a screen takes the keys.
    pub fn at_screen(self) -> Self {
        Operator {
            has_keys: true,
            ..self
        }
    }

    /// Listens until standard input or the program ends. Lines that wait there already were not written for this.
    fn listen(&mut self) {
        if self.rearms || self.has_keys || self.lines.is_some() || !stdin::drain() {
            return;
        }
        let lines = Arc::new(Lines::default());
        let heard = lines.clone();
        let listening = std::thread::Builder::new()
            .name("sutura-enter".to_owned())
            .spawn(move || {
                let mut line = String::new();
                while std::io::stdin().read_line(&mut line).is_ok_and(|n| n > 0) {
                    line.clear();
                    heard.came.store(true, Ordering::Relaxed);
                }
                heard.over.store(true, Ordering::Relaxed);
            });
        self.lines = listening.is_ok().then_some(lines);
    }

    /// What arms the console next, in words; by itself not before `wait` is over.
    fn ready(&mut self, wait: Duration) -> String {
        if self.rearms && !wait.is_zero() {
            return format!(
                "it is armed again in {:.0} s, three times a minute at most",
                wait.as_secs_f64().ceil()
            );
        }
        if self.rearms {
            return "it is armed again".to_owned();
        }
        let by_hand = self.by_hand();
        by_hand
            .unwrap_or("it stays at rest; with --rearm it is armed by itself")
            .to_owned()
    }

    /// Words for arming the console from the terminal; none where nobody is asked.
    fn by_hand(&mut self) -> Option<&'static str> {
        self.listen();
        match &self.lines {
            _ if self.has_keys => Some("a, pressed twice, arms it"),
            Some(lines) if !lines.over.load(Ordering::Relaxed) => {
                lines.came.store(false, Ordering::Relaxed);
                if std::io::stdin().is_terminal() {
                    Some("press Enter to arm it")
                } else {
                    Some("a line on standard input arms it")
                }
            }
            _ => None,
        }
    }
}

/// Tells the user when something lasts that keeps a contact from being felt: longer than force takes to come back.
#[derive(Debug, Default)]
pub struct Lasting {
    /// Session time since which it is \[s\], and whether that was told.
    since_s: Option<f64>,
    told: bool,
}

/// A force of 5 N is back by then \[s\].
const RETURN_S: f64 = 1.25;

/// What is said of force that the console withholds.
pub const WITHHELD: &str = "the console withholds force that no motion has paid for: move the tool out of the tissue, and in again";
/// What is said of a needle that was in tissue when the console was armed.
pub const WAITS: &str = "the console was armed with the needle in the tissue, which feels nothing of it: move all of it out, and in again \
     by its tip";

impl Lasting {
    /// Takes note of whether it is so; true when that is to be told.
    pub fn lasts(&mut self, elapsed_s: f64, is_so: bool) -> bool {
        if !is_so {
            *self = Lasting::default();
            return false;
        }
        let since_s = *self.since_s.get_or_insert(elapsed_s);
        let tells = !self.told && elapsed_s - since_s > RETURN_S;
        self.told |= tells;
        tells
    }
}

impl Attendant for Operator {
    fn lost(&mut self, why: &LinkError) {
        note!("{why}; its force goes to zero by itself, and it is looked for");
    }

    fn back(&mut self) {
        let next = self.ready(Duration::ZERO);
        note!("the console is back, at rest: {next}");
    }

    fn let_go(&mut self, wait: Duration) {
        let next = self.ready(wait);
        note!("the console has let go, since no contact came in time for half a second: {next}");
    }

    fn stopped(&mut self, stop: Stop, person: &str) {
        match stop {
            Stop::Safe => {
                let next = self.by_hand().unwrap_or("it rests until somebody arms it");
                note!("safe stop by {person}: {next}");
            }
            Stop::TakeOut => {
                note!("taken out of the tissue by {person}: it is armed when it is out");
            }
        }
    }

    fn arms(&mut self) -> Arms {
        let came = |lines: &Arc<Lines>| lines.came.swap(false, Ordering::Relaxed);
        match &self.lines {
            _ if self.rearms => Arms::ByItself,
            Some(lines) if came(lines) => Arms::ByHand,
            _ => Arms::No,
        }
    }
}

#[cfg(unix)]
mod stdin {
    //! What waits on standard input.

    use rustix::event::{PollFd, PollFlags, Timespec, poll};
    use rustix::io::{Errno, read};

    /// Most that is read away; who writes without end is heard all the same \[pieces of 4 kB\].
    const MOST: usize = 16;

    /// Reads away what waits; says whether more may come.
    pub fn drain() -> bool {
        let stdin = std::io::stdin();
        let mut waste = [0; 4096];
        for _ in 0..MOST {
            let mut waits = [PollFd::new(&stdin, PollFlags::IN)];
            match poll(&mut waits, Some(&Timespec::default())) {
                Ok(0) => return true,
                Ok(_) => {}
                Err(Errno::INTR) => continue,
                Err(_) => return false,
            }
            match read(&stdin, &mut waste) {
                Ok(0) => return false,
                Ok(_) | Err(Errno::INTR) => {}
                Err(_) => return false,
            }
        }
        true
    }
}

#[cfg(not(unix))]
mod stdin {
    //! Whether somebody sits at standard input.

    use std::io::IsTerminal;

    /// Whether lines may come.
    pub fn drain() -> bool {
        std::io::stdin().is_terminal()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// It is not said to be armed while it is not.
    #[test]
    fn a_limit_that_holds_is_said() {
        let mut operator = Operator::new(true);
        assert_eq!(operator.ready(Duration::ZERO), "it is armed again");
        let words = operator.ready(Duration::from_millis(34_200));
        assert!(words.starts_with("it is armed again in 35 s"), "{words}");
        assert_eq!(operator.arms(), Arms::ByItself);
    }

    /// Once each time, however long it lasts.
    #[test]
    fn what_lasts_is_told_once() {
        let mut lasting = Lasting::default();
        let told = |lasting: &mut Lasting, from_s: f64, is_so: bool| {
            let times = (0..40).map(|tenth| from_s + 0.1 * f64::from(tenth));
            let told: Vec<f64> = times.filter(|at| lasting.lasts(*at, is_so)).collect();
            told
        };
        let first = told(&mut lasting, 0.0, true);
        assert!(
            first.len() == 1 && (first[0] - 1.3).abs() < 1e-9,
            "{first:?}"
        );
        assert!(told(&mut lasting, 4.0, false).is_empty());
        assert_eq!(told(&mut lasting, 8.0, true).len(), 1);
    }
}
