//! `sutura doctor`: finds what is wrong with this PC, its console and the line between them, and says the one fix.
//!
//! Entry point: [`run`]. [`system`] reads the machine, [`console`] asks the console.

mod console;
mod system;

use crate::bench::session::{SessionUs, Solves};
use crate::failure::{Cause, Failure};
use crate::run::link_failure;
use crate::{Format, Global};
use clap::Args;
use schemars::JsonSchema;
use serde::Serialize;
use std::path::PathBuf;
use sutura_hil::VirtualConsole;
use sutura_host::link::open_serial;
use sutura_host::scene::Scene;
use sutura_host::session::{Plan, check_rate, least_hz};
use system::System;

/// Looks at this machine, and at the console on PORT, and says what to do about what it finds.
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub struct DoctorArgs {
    /// A console's port, or `virtual`; the machine alone when left out.
    pub port: Option<String>,
    /// Scene whose solves are timed over its whole script; the palpation scene when left out.
    #[arg(long, value_name = "SCENE")]
    pub scene: Option<PathBuf>,
    /// Where the machine's files are: for tests.
    #[arg(long, value_name = "DIR", default_value = "/", hide = true)]
    pub root: PathBuf,
}

const EXAMPLES: &str = "\
Examples:
  sutura doctor                                    this machine: ports, scheduling, solver
  sutura doctor /dev/ttyACM0                       the console on that port too: ticks, round trips
  sutura doctor virtual --format json
  sutura doctor --scene scenes/anastomosis-50.toml  how many steps a second that scene can have here

Exit codes: 0 all is well, 3 no console answered on PORT, 1 something else is to be mended.";

/// Something that was looked at.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, JsonSchema)]
pub struct Check {
    /// What.
    pub name: &'static str,
    /// Whether it is as it should be.
    pub ok: bool,
    /// What there is.
    pub found: String,
    /// What to do about it; none if it is as it should be.
    pub fix: Option<String>,
}

/// What `--format json` prints.
#[derive(Serialize, JsonSchema)]
pub struct Looked<'a> {
    /// All that was looked at.
    checks: &'a [Check],
}

impl Check {
    /// As it should be.
    fn good(name: &'static str, found: impl Into<String>) -> Check {
        Check {
            name,
            ok: true,
            found: found.into(),
            fix: None,
        }
    }

    /// Not as it should be.
    fn bad(name: &'static str, found: impl Into<String>, fix: impl Into<String>) -> Check {
        Check {
            name,
            ok: false,
            found: found.into(),
            fix: Some(fix.into()),
        }
    }
}

/// What was found on a port.
pub struct Checks {
    checks: Vec<Check>,
    /// Whether a console answered.
    answered: bool,
}

/// Looks at everything and prints what it finds.
///
/// # Errors
/// A scene that cannot be used; whatever is not as it should be, after it has been printed.
pub fn run(args: &DoctorArgs, global: &Global) -> Result<(), Failure> {
    let scene = crate::scene::open(args.scene.as_deref())?;
    let mut checks = System::at(&args.root).checks();
    let mut answered = true;
    match args.port.as_deref() {
        None => {}
        Some("virtual") => {
            let plan = Plan::of_scene(&scene)?;
            let mut console = VirtualConsole::start(&plan.device).map_err(link_failure)?;
            let found = console::checks("virtual", console.host_port());
            answered = found.answered;
            checks.extend(found.checks);
        }
        Some(port) => {
            let found = console::checks(port, open_serial(port));
            answered = found.answered;
            checks.extend(found.checks);
        }
    }
    checks.push(host_rate(&scene)?);
    print(&checks, global.format);
    let bad = checks.iter().filter(|check| !check.ok).count();
    if !answered {
        let port = args.port.as_deref().unwrap_or_default();
        let message = format!("no console answered on `{port}`");
        let help = "see the check `console`";
        return Err(Failure::say(Cause::NoConsole, message, help).after_summary());
    }
    if bad > 0 {
        let message = format!("{bad} of {} checks found something to mend", checks.len());
        let help = "the fixes stand behind what was found; each is to be run once";
        return Err(Failure::say(Cause::Failed, message, help).after_summary());
    }
    Ok(())
}

/// How many solves a second the scene can have here where they take longest, measured over its whole script.
fn host_rate(scene: &Scene) -> Result<Check, Failure> {
    const NAME: &str = "host_rate";
    let plan = Plan::of_scene(scene)?;
    if let Err(error) = check_rate(plan.host_hz, plan.tick_hz) {
        let least_hz = least_hz(plan.tick_hz);
        let help = format!("have its `[host]` say `host_hz = {least_hz}` or more");
        return Ok(Check::bad(NAME, format!("{}: {error}", scene.name), help));
    }
    let shown = crate::work::watch();
    let solves = match Solves::of(scene, 1) {
        Err(failure) if failure.cause != Cause::BadInput => None,
        solves => Some(solves?),
    };
    drop(shown);
    let worst = solves.and_then(|solves| Some((solves.worst_second()?, solves.distribution())));
    let Some((worst, SessionUs { p50, p99, .. })) = worst else {
        let help = "run `sutura scene check` on it";
        return Ok(Check::bad(NAME, "the scene does not run", help));
    };
    let rate = 1e6 / worst.p99_us.max(p99).max(1.0);
    let found = format!(
        "{}: solves of p50 {p50:.0} us, p99 {p99:.0} us; in the worst second, at {:.1} s, {:.0} us on average and p99 {:.0} us: {:.0} a second; it asks for {:.0}",
        scene.name,
        worst.from_s,
        worst.mean_us,
        worst.p99_us,
        rate.min(1000.0),
        plan.host_hz
    );
    Ok(if rate < plan.host_hz {
        Check::bad(NAME, found, slower(rate, least_hz(plan.tick_hz)))
    } else {
        Check::good(NAME, found)
    })
}

/// What to do where so many solves a second are what a scene can have; with fewer than `least_hz` there is no session.
fn slower(rate: f64, least_hz: f64) -> String {
    if rate >= least_hz {
        format!("run it with --host-hz {:.0}", rate.floor())
    } else {
        format!(
            "no rate will do, {least_hz} a second are the least: take a coarser mesh, or another `--tissue`"
        )
    }
}

fn print(checks: &[Check], format: Format) {
    match format {
        Format::Json => crate::display::object(&Looked { checks }),
        Format::Text => {
            for check in checks {
                let mark = if check.ok { "ok " } else { "BAD" };
                say!("{mark} {:<14} {}", check.name, check.found);
                if let Some(fix) = &check.fix {
                    say!("    {:<14} fix: {fix}", "");
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is proposed is a rate that `sutura run` takes.
    #[test]
    fn no_rate_is_proposed_that_sessions_refuse() {
        let least_hz = least_hz(1000);
        assert_eq!(slower(150.7, least_hz), "run it with --host-hz 150");
        assert!(slower(least_hz, least_hz).ends_with("--host-hz 14"));
        for rate in [5.0, 13.9] {
            let help = slower(rate, least_hz);
            assert!(help.starts_with("no rate will do"), "{help}");
        }
    }
}
