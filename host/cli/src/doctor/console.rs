//! What a console on a port answers, how steadily it ticks, and how long its line takes.
//!
//! Entry point: [`checks`].

use super::{Check, Checks};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use sutura_host::link::{Link, LinkError, LinkOptions, Port, RoundTrips};
use sutura_shared::control::TICK_HZ;
use sutura_shared::link::HostEvent;
use sutura_shared::wire::validate::name;
use sutura_shared::wire::{PROTOCOL_VERSION, SCHEMA_HASH};

/// How long is listened and asked.
const LISTEN: Duration = Duration::from_secs(1);
/// Time between two pings: not a whole number of ticks.
const PING_EVERY: Duration = Duration::from_micros(7_382);
/// By how much the tick rate may differ from what it should be, by the host's clock.
const RATE_TOLERANCE: f64 = 0.01;
/// How late one state in a hundred may come after the fastest \[ms\]: longer, and a contact is a tick older.
const JITTER_MS: f64 = 1.0;
/// How long one ping in a hundred may take \[ms\]: state to contact applied within three ticks needs that.
const ROUND_TRIP_MS: f64 = 2.0;

/// What the states of a second were like.
#[derive(Clone, Debug, Default)]
struct States {
    /// When each came \[us\], and its console time \[us\].
    came: Vec<(f64, f64)>,
    first_tick: Option<u32>,
    last_tick: u32,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Opens a session on the port, listens, and says what there is. `port` fails as it was opened.
pub fn checks(name: &str, port: Result<Box<dyn Port>, LinkError>) -> Checks {
    match port.and_then(listen) {
        Ok(checks) => Checks {
            checks,
            answered: true,
        },
        Err(error) => {
            let answered = matches!(error, LinkError::Mismatch { .. } | LinkError::Owned { .. });
            let checks = vec![Check::bad("console", error.to_string(), error.help())];
            tracing::debug!("{name}: {error:?}");
            Checks { checks, answered }
        }
    }
}

fn listen(port: Box<dyn Port>) -> Result<Vec<Check>, LinkError> {
    let states = Arc::new(Mutex::new(States::default()));
    let written = states.clone();
    let started = Instant::now();
    let options = LinkOptions {
        ping_every: PING_EVERY,
        ..LinkOptions::default()
    };
    let link = Link::open(port, options, move |event| {
        if let HostEvent::State(state) = event {
            let mut states = lock(&written);
            let now_us = 1e6 * started.elapsed().as_secs_f64();
            let tick = state.body().tick;
            states.first_tick.get_or_insert(tick);
            states.last_tick = tick;
            states.came.push((now_us, state.console_time_us() as f64));
        }
    })?;
    std::thread::sleep(LISTEN);
    link.check()?;
    let (console, trips) = (link.console(), link.round_trips());
    let came = link.why_no_state();
    let lost = link.close().frames.frames_lost;
    let states = lock(&states).clone();
    let kind = if console.simulated {
        "simulated"
    } else {
        "with motors"
    };
    let found = format!(
        "{}, {kind}, {} Hz",
        name(&console.device_name).unwrap_or_default(),
        console.tick_hz
    );
    Ok(vec![
        Check::good("console", found),
        Check::good(
            "protocol",
            format!(
                "version {PROTOCOL_VERSION}, schema {SCHEMA_HASH:016x}: firmware and program fit"
            ),
        ),
        ticks(&states, lost, &came),
        jitter(&states),
        round_trips(&trips),
    ])
}

/// Whether the console ticks as fast as it says, and whether all states came; `came`: what else did, where none can be used.
fn ticks(states: &States, lost: u32, came: &str) -> Check {
    const NAME: &str = "tick_rate";
    let (Some(first), Some((from, _)), Some((to, _))) =
        (states.first_tick, states.came.first(), states.came.last())
    else {
        let help = "press the console's reset and ask again";
        let found = format!("no state that can be used came within a second: {came}");
        return Check::bad(NAME, found, help);
    };
    let ticks = f64::from(states.last_tick.wrapping_sub(first));
    let rate = 1e6 * ticks / (to - from).max(1.0);
    let found = format!("{rate:.1} Hz by this machine's clock, {lost} states lost");
    if lost > 0 {
        let help =
            "close other programs: this machine or its line is too busy for 1000 frames a second";
        Check::bad(NAME, found, help)
    } else if (rate / f64::from(TICK_HZ) - 1.0).abs() > RATE_TOLERANCE {
        let help = "check the console's crystal and clock settings; a virtual console needs a less busy machine";
        Check::bad(NAME, found, help)
    } else {
        Check::good(NAME, found)
    }
}

/// How unevenly the states came: how much later than the one that came fastest, by the console's clock.
fn jitter(states: &States) -> Check {
    const NAME: &str = "tick_jitter";
    let late = states.came.iter().map(|(came, console)| came - console);
    let mut late: Vec<f64> = late.collect();
    late.sort_by(f64::total_cmp);
    let (Some(fastest), Some(slowest)) = (late.first(), late.last()) else {
        return Check::bad(
            NAME,
            "no state came",
            "press the console's reset and ask again",
        );
    };
    let at = |share: usize| late.get(late.len() * share / 100).unwrap_or(slowest) - fastest;
    let (p50, p99) = (1e-3 * at(50), 1e-3 * at(99));
    let found = format!("states late by p50 {p50:.2} ms, p99 {p99:.2} ms");
    if p99 > JITTER_MS {
        let help =
            "close other programs, or let this user have real-time scheduling: see `real_time`";
        Check::bad(NAME, found, help)
    } else {
        Check::good(NAME, found)
    }
}

fn round_trips(trips: &RoundTrips) -> Check {
    const NAME: &str = "round_trip";
    if trips.count == 0 {
        let help = "flash the firmware that came with this program: `cargo xtask firmware`";
        return Check::bad(NAME, "no ping was answered", help);
    }
    let ms = |us: f64| us / 1e3;
    let found = format!(
        "min {:.2} ms, p50 {:.2} ms, p99 {:.2} ms, max {:.2} ms of {} pings",
        ms(trips.min),
        ms(trips.p50),
        ms(trips.p99),
        ms(trips.max),
        trips.count
    );
    if ms(trips.p99) > ROUND_TRIP_MS {
        let help = "plug the console into a USB port of the machine itself, without a hub, and close other programs";
        Check::bad(NAME, found, help)
    } else {
        Check::good(NAME, found)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A second of states, a tenth of which come 3 ms late.
    fn states(rate: f64, late_us: f64) -> States {
        let period_us = 1e6 / rate;
        let came = |tick: u32| {
            let due = period_us * f64::from(tick);
            let late = if tick.is_multiple_of(10) {
                late_us
            } else {
                0.0
            };
            (due + 200.0 + late, 1e3 * f64::from(tick))
        };
        States {
            came: (1..=1000).map(came).collect(),
            first_tick: Some(1),
            last_tick: 1000,
        }
    }

    #[test]
    fn rate_loss_and_jitter_are_told_apart() {
        let good = states(1000.0, 0.0);
        let ticks = |states: &States, lost| ticks(states, lost, "12 frames were refused");
        assert!(ticks(&good, 0).ok && jitter(&good).ok);
        assert!(!ticks(&good, 1).ok);
        assert!(!ticks(&states(950.0, 0.0), 0).ok);
        let late = states(1000.0, 3000.0);
        assert!(ticks(&late, 0).ok);
        let late = jitter(&late);
        assert!(!late.ok && late.found.contains("p99 3.00 ms"), "{late:?}");
        let none = States::default();
        assert!(!ticks(&none, 0).ok && !jitter(&none).ok);
        assert!(ticks(&none, 0).found.ends_with("12 frames were refused"));
    }

    #[test]
    fn round_trips_beyond_two_ticks_are_bad() {
        let trips = |p99| RoundTrips {
            count: 100,
            min: 100.0,
            p50: 500.0,
            p99,
            max: p99,
        };
        assert!(round_trips(&trips(1900.0)).ok);
        assert!(!round_trips(&trips(16_000.0)).ok);
        assert!(!round_trips(&RoundTrips::default()).ok);
    }
}
