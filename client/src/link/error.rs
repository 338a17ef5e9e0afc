//! What can go wrong between the host and a console, and what the user can do about it.
//!
//! Entry point: [`LinkError`]; its text says what happened, [`LinkError::help`] the next step.

use std::fmt;
use std::time::Duration;
use sutura_shared::link::{Mismatch, SendError};

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
    #[error("`{name}` is in use by another program")]
    Busy {
        /// The port asked for.
        name: String,
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
        /// How long the host waited.
        waited: Duration,
        /// What came instead.
        heard: String,
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

impl LinkError {
    /// What the user can do next.
    pub fn help(&self) -> String {
        match self {
            LinkError::NoPort { .. } => {
                "plug the console in and name one of its ports, or use `--console virtual`".to_owned()
            }
            LinkError::Permission { name } => format!(
                "let your user open serial ports (Linux: `sudo usermod -aG dialout $USER`, then log in again), or check `ls -l {name}`"
            ),
            LinkError::Busy { name } => format!(
                "close the other program (`fuser {name}` names it); ModemManager lets go of a new port after about 10 s"
            ),
            LinkError::Open { .. } => "name a serial port or a pseudo-terminal, or use `--console virtual`".to_owned(),
            LinkError::NoAnswer { .. } => {
                "check that this port is a Sutura console, that it has power and that its firmware runs; press its reset and try again".to_owned()
            }
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
}
