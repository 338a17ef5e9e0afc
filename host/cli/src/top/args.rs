//! The options of `sutura top`.

use clap::Args;

/// Shows the figures of a running session in a terminal.
///
/// Mode, faults with their fix, force, latency and age against the horizon, energy, the solver's step by stage, the link, ticks and
/// speed, of a session that has a page: `sutura view` or `sutura run --view`. Without a terminal one line a second; with
/// `--format json` that is an object.
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub struct TopArgs {
    /// Address of the session's page, as it was printed; when left out, the session of this user on this machine.
    pub url: Option<String>,
}

const EXAMPLES: &str = "\
Examples:
  sutura top                                the session that runs here
  sutura top http://127.0.0.1:8422          one of several
  sutura top > figures.txt                  a line a second
  sutura run --top                          a session with these figures in place of its bar

Keys: s safe stop, a twice arms, c clears a fault, p pauses a scene that is steered, t takes the controls, q leaves, ? says more.
Over SSH run it on the session's machine, or: `ssh -L 8421:127.0.0.1:8421 HOST`, then `sutura top` with the address that was printed
there. Safe stop is software: it is no emergency stop.";
