//! What can go wrong between the host and a console, and what the user can do about it.
//!
//! Entry point: [`LinkError`]; its text says what happened, [`LinkError::help`] the next step.

use std::fmt;
use std::path::Path;
use std::time::Duration;
use sutura_shared::link::{Mismatch, SendError};
use sutura_shared::wire::Reject;

/// Names of ports, as a sentence shows them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Ports(Vec<String>);

impl From<Vec<String>> for Ports {
    fn from(names: Vec<String>) -> Self {
        Ports(names)
    }
}

impl fmt::Display for Ports {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.0.is_empty() {
            f.write_str("this machine shows no serial ports")
        } else {
            write!(f, "ports found: {}", self.0.join(", "))
        }
    }
}

/// Why there is no link to a console, or no longer one.
#[derive(Clone, Debug, thiserror::Error)]
pub enum LinkError {
    /// No port of that name.
    #[error("there is no port `{name}`; {found}")]
    NoPort {
        /// The port asked for.
        name: String,
        /// What there is instead.
        found: Ports,
    },
    /// The user may not open the port.
    #[error("no permission to open `{name}`")]
    Permission {
        /// The port asked for.
        name: String,
    },
    /// Another program has the port.
    #[error("`{name}` is in use by another program{}", in_brackets(by.as_deref()))]
    Busy {
        /// The port asked for.
        name: String,
        /// Which program, if the system says so.
        by: Option<String>,
    },
    /// The system refused for another reason.
    #[error("`{name}` cannot be opened as a console's port: {reason}")]
    Open {
        /// The port asked for.
        name: String,
        /// What the system said.
        reason: String,
    },
    /// Nobody answered the handshake.
    #[error("no console answered on `{name}` within {:.1} s ({heard})", waited.as_secs_f64())]
    NoAnswer {
        /// The port.
        name: String,
        /// Time that the host waited.
        waited: Duration,
        /// States that came instead, in words.
        heard: String,
    },
    /// Somebody answered the handshake, and no state came that a session can use.
    #[error("the console on `{name}` opened a session and sent no state that can be used within {:.1} s: {heard}", waited.as_secs_f64())]
    NoStates {
        /// The port.
        name: String,
        /// Time that the host waited.
        waited: Duration,
        /// States that came instead, in words.
        heard: String,
        /// Whether frames came, and were refused.
        refused: bool,
    },
    /// The caller no longer waits for an answer.
    #[error("the console on `{name}` is no longer waited for: interrupted")]
    GivenUp {
        /// The port.
        name: String,
    },
    /// The two ends speak different protocols.
    #[error("the console on `{name}` and this program do not work together: {mismatch}")]
    Mismatch {
        /// The port.
        name: String,
        /// What differs.
        mismatch: Mismatch,
    },
    /// Another host uses the console.
    #[error("the console on `{name}` is in use by another host")]
    Owned {
        /// The port.
        name: String,
    },
    /// The other end went away while the link was open.
    #[error("the console on `{name}` is gone: {reason}")]
    Gone {
        /// The port.
        name: String,
        /// What the system said.
        reason: String,
    },
    /// Orders pile up because the console does not take them.
    #[error("`{name}` takes no more orders: {waiting} are waiting")]
    Stuck {
        /// The port.
        name: String,
        /// Orders in the queue.
        waiting: usize,
    },
    /// A message that the console would refuse.
    #[error("not sent to the console on `{name}`: {source}")]
    Unsendable {
        /// The port.
        name: String,
        /// Why not.
        source: SendError,
    },
    /// The console answered, but did not do what a session needs.
    #[error("the console on `{name}` {what}")]
    Console {
        /// The port.
        name: String,
        /// What it did or did not do.
        what: String,
    },
}

/// ` (what)`, or nothing.
fn in_brackets(what: Option<&str>) -> String {
    what.map_or_else(String::new, |what| format!(" ({what})"))
}

/// Whether a port is that of a virtual console: a pseudo-terminal, or a link to one, which stands outside of /dev. It has no
/// cable and no reset, and is late where its PC is.
pub fn is_virtual(name: &str) -> bool {
    let path = Path::new(name);
    if !cfg!(unix) || name == "virtual" {
        return name == "virtual";
    }
    // The terminal goes with its console; a link to it may stay.
    let real = std::fs::canonicalize(path).or_else(|_| std::fs::read_link(path));
    let real = real.unwrap_or_else(|_| path.to_owned());
    ["/dev/pts", "/dev/ttys"]
        .iter()
        .any(|of| real.to_string_lossy().starts_with(of))
        || !real.starts_with("/dev")
}

/// What helps where a virtual console does not do as it should.
pub const VIRTUAL_HELP: &str = "a virtual console is as late as its PC is busy: close other programs (`sutura doctor` says what else helps); one in a process of its own, `sutura console`, must still run";

impl LinkError {
    /// What the user can do next.
    pub fn help(&self) -> String {
        match self {
            LinkError::Mismatch {
                mismatch: Mismatch::Unusable(Reject::Name),
                ..
            } => "give its device file a `name` of 1 to 16 letters, digits and `-`, and start it anew with that".to_owned(),
            LinkError::Mismatch { .. } | LinkError::NoStates { refused: true, .. }
                if self.is_of_virtual() =>
            {
                "start the virtual console from the same build as this program: `sutura console`".to_owned()
            }
            _ if self.is_of_virtual() => VIRTUAL_HELP.to_owned(),
            LinkError::NoPort { .. } => {
                "plug the console in and name one of its ports; `sutura run --console virtual` and `sutura doctor virtual` need none".to_owned()
            }
            LinkError::Permission { name } => format!(
                "let your user open serial ports (Linux: `sudo usermod -aG dialout $USER`, then log in again), or check `ls -l {name}`"
            ),
            LinkError::Busy { name, by: None } => format!(
                "close the other program (`fuser {name}` names it); ModemManager lets go of a new port after about 10 s"
            ),
            LinkError::Busy { .. } => "close that program, or name another port".to_owned(),
            LinkError::Open { .. } => "name a serial port or a pseudo-terminal; `sutura run --console virtual` and `sutura doctor virtual` need none".to_owned(),
            LinkError::NoAnswer { .. } => {
                "check that this port is a Sutura console, that it has power and that its firmware runs; press its reset and try again".to_owned()
            }
            LinkError::NoStates { .. } => {
                "press the console's reset and try again; if it stays, flash the firmware that came with this program: `cargo xtask firmware`".to_owned()
            }
            LinkError::GivenUp { .. } => "start again once it answers: `sutura doctor PORT` says what comes".to_owned(),
            LinkError::Mismatch { .. } => {
                "flash the firmware that came with this program: `cargo xtask firmware`".to_owned()
            }
            LinkError::Owned { name } => format!(
                "end the other session; `fuser {name}` names the program if it runs on this machine"
            ),
            LinkError::Gone { .. } => "check the cable and the console's power, then start again; the console lets its force decay by itself".to_owned(),
            LinkError::Unsendable { .. } => "correct the value: the console checks every number before it uses it".to_owned(),
            LinkError::Stuck { .. } | LinkError::Console { .. } => "press the console's reset and start again".to_owned(),
        }
    }

    /// Whether it is about a virtual console, and that makes a difference to what helps.
    fn is_of_virtual(&self) -> bool {
        match self {
            LinkError::NoAnswer { name, .. }
            | LinkError::NoStates { name, .. }
            | LinkError::Mismatch { name, .. }
            | LinkError::Gone { name, .. }
            | LinkError::Stuck { name, .. }
            | LinkError::Console { name, .. } => is_virtual(name),
            _ => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A pseudo-terminal has neither a cable nor a reset.
    #[cfg(unix)]
    #[test]
    fn a_virtual_console_is_not_told_of_cables() {
        let errors = |name: &str| {
            let (name, reason) = (name.to_owned(), "nothing came for 0.6 s".to_owned());
            [
                LinkError::Gone {
                    name: name.clone(),
                    reason: reason.clone(),
                },
                LinkError::NoAnswer {
                    name: name.clone(),
                    waited: Duration::from_secs(3),
                    heard: reason.clone(),
                },
                LinkError::NoStates {
                    name: name.clone(),
                    waited: Duration::from_secs(2),
                    heard: reason.clone(),
                    refused: false,
                },
                LinkError::Stuck {
                    name: name.clone(),
                    waiting: 16,
                },
                LinkError::Console { name, what: reason },
            ]
        };
        let speaks_of_hardware = |error: &LinkError| {
            let help = error.help();
            ["cable", "power", "reset"]
                .iter()
                .any(|word| help.contains(word))
        };
        for name in ["/dev/pts/63", "virtual", "/tmp/no-such-bench"] {
            for error in errors(name) {
                assert!(!speaks_of_hardware(&error), "{name}: {}", error.help());
                assert!(error.help().contains("PC"), "{name}: {}", error.help());
            }
        }
        for error in errors("/dev/ttyACM0") {
            assert!(speaks_of_hardware(&error), "{}", error.help());
        }
    }
}
