//! The identity trace ([`sutura_shared::identity_trace`]) of any console in lockstep, and what it must come to.
//!
//! Entry points: [`run`], [`committed`].

use sutura_host::link::{LinkError, LockstepConsole};
use sutura_shared::identity_trace::{self, Lockstep};
pub use sutura_shared::identity_trace::{Coverage, IdentityTrace};

/// Why a run did not end.
#[derive(Debug, thiserror::Error)]
pub enum TraceError {
    /// The console is gone.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// The console does something else than one tick and one state for each exchange.
    #[error("tick {tick}: {what}")]
    Answer {
        /// Of the script.
        tick: u32,
        /// What is wrong.
        what: String,
    },
}

/// Runs the script on a console that has just booted.
///
/// # Errors
/// [`TraceError`]; other bits are no error.
pub fn run(console: &mut dyn LockstepConsole) -> Result<IdentityTrace, TraceError> {
    let mut lockstep = Through {
        console,
        up: Vec::new(),
    };
    identity_trace::run(&mut lockstep).map_err(|error| match error {
        identity_trace::TraceError::Console(error) => error.into(),
        identity_trace::TraceError::Answer {
            tick,
            what,
            counters,
        } => TraceError::Answer {
            tick,
            what: format!("{what}, {counters:?}"),
        },
    })
}

struct Through<'a> {
    console: &'a mut dyn LockstepConsole,
    up: Vec<u8>,
}

impl Lockstep for Through<'_> {
    type Error = LinkError;

    fn exchange(&mut self, down: &[u8], up: &mut dyn FnMut(u8)) -> Result<(), LinkError> {
        self.up.clear();
        self.console.exchange(down, &mut self.up)?;
        self.up.iter().for_each(|byte| up(*byte));
        Ok(())
    }
}

/// A console's code, and what its trace came to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Committed {
    /// As [`sutura_shared::control::CODE`] was.
    pub code: u32,
    /// [`IdentityTrace::hash`].
    pub hash: u64,
}

/// Of every code that there was, the newest last: `tests/golden/identity-trace.txt`. Lines that cannot be read are left
/// out; a test sees to it that there are none.
pub fn committed() -> impl Iterator<Item = Committed> {
    let lines = COMMITTED.lines().filter(|line| !line.starts_with('#'));
    lines.filter_map(|line| {
        let (code, hash) = line.split_once(' ')?;
        Some(Committed {
            code: code.parse().ok()?,
            hash: u64::from_str_radix(hash, 16).ok()?,
        })
    })
}

const COMMITTED: &str = include_str!("../../tests/golden/identity-trace.txt");
