//! The bars: what a scene's runs must hold under a load. Entry point: [`bars`].

use super::load::Load;
use super::measured::Measured;
use serde::Serialize;

/// How far force, punctures and gap may be from those in lockstep.
const NEAR: f64 = 0.05;
/// Of the planned solves.
const LEAST_SOLVES: f64 = 0.9;
/// A decay in so many seconds \[s\].
const DECAY_EVERY_S: f64 = 10.0;
/// Of the whole solve \[us\].
const SESSION_P99_US: f64 = 5000.0;
/// Mean of the whole solve, in every second \[us\].
const SESSION_SECOND_US: f64 = 2000.0;
/// Of palpation on an idle machine \[ms\].
const PALPATION_HORIZON_MS: f64 = 60.0;
/// A machine that is later than that is marked \[us\].
pub const LATE_US: f64 = 5000.0;

/// Whether something holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    Met,
    Missed,
}

/// One bar over all runs of a scene under a load.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Bar {
    pub name: String,
    pub verdict: Verdict,
    /// Runs that hold it, of all.
    pub held: usize,
    pub of: usize,
    /// Numbers of the runs that miss it, counted from 1.
    pub missed_in: Vec<usize>,
}

impl Bar {
    /// Whether it is missed.
    pub fn is_missed(&self) -> bool {
        self.verdict == Verdict::Missed
    }
}

/// One bar.
fn bar(name: &str, runs: &[Measured], holds: impl Fn(&Measured) -> bool) -> Bar {
    let numbered = runs.iter().enumerate();
    let missed_in: Vec<usize> = numbered
        .filter_map(|(index, run)| (!holds(run)).then_some(index + 1))
        .collect();
    let verdict = match missed_in.is_empty() {
        true => Verdict::Met,
        false => Verdict::Missed,
    };
    Bar {
        name: name.to_owned(),
        verdict,
        held: runs.len() - missed_in.len(),
        of: runs.len(),
        missed_in,
    }
}

/// Within 5 % of lockstep.
fn near(
    name: &str,
    runs: &[Measured],
    lockstep: &Measured,
    figure: impl Fn(&Measured) -> Option<f64>,
) -> Bar {
    let wanted = figure(lockstep);
    let name = format!("{name} within 5 % of lockstep");
    bar(&name, runs, |run| {
        let both = figure(run).zip(wanted);
        both.is_some_and(|(found, wanted)| (found - wanted).abs() <= NEAR * wanted.abs())
    })
}

/// All bars of a scene's runs. A figure that every summary has, and this one lacks, misses its bar.
pub fn bars(scene: &str, load: Load, lockstep: &Measured, runs: &[Measured]) -> Vec<Bar> {
    let at_most = |name: &str, most: f64, figure: &dyn Fn(&Measured) -> Option<f64>| {
        bar(name, runs, |run| {
            figure(run).is_some_and(|found| found <= most)
        })
    };
    let reference = std::slice::from_ref(lockstep);
    let mut bars = vec![
        bar("ends ok in lockstep", reference, Measured::is_ok),
        bar("ends ok", runs, Measured::is_ok),
        bar("never idle", runs, |run| !run.went_idle()),
    ];
    if load == Load::Idle {
        bars.push(bar("no decay", runs, |run| run.decays == Some(0.0)));
        bars.push(at_most("overload all zero", 0.0, &|run| run.overload));
        bars.push(at_most("session_us p99 <= 5 ms", SESSION_P99_US, &|run| {
            run.session_p99_us
        }));
        bars.push(at_most(
            "session_us <= 2 ms in the mean of every second",
            SESSION_SECOND_US,
            &|run| run.session_second_us,
        ));
        if scene == "palpation" {
            let name = "horizon_ms <= 60";
            bars.push(at_most(name, PALPATION_HORIZON_MS, &|run| run.horizon_ms));
        }
    } else {
        bars.push(bar("at most one decay in 10 s", runs, |run| {
            let most = (run.seconds.unwrap_or(0.0) / DECAY_EVERY_S)
                .floor()
                .max(1.0);
            run.decays.is_some_and(|decays| decays <= most)
        }));
    }
    bars.push(bar("solves >= 90 % of those planned", runs, |run| {
        run.solves_ratio.is_some_and(|ratio| ratio >= LEAST_SOLVES)
    }));
    let near =
        |name: &str, figure: fn(&Measured) -> Option<f64>| near(name, runs, lockstep, figure);
    bars.push(near("peak force", |run| run.peak_n));
    bars.push(near("RMS force", |run| run.rms_n));
    // Only scenes with a needle, and with a wound, have these.
    if lockstep.punctures.is_some() {
        bars.push(near("punctures", |run| run.punctures));
    }
    if lockstep.gap_ratio.is_some() {
        bars.push(near("final gap", |run| run.gap_ratio));
    }
    bars
}

#[cfg(test)]
mod tests {
    use super::*;

    fn good() -> Measured {
        Measured {
            code: Some(0),
            status: "ok".into(),
            mode: "armed".into(),
            seconds: Some(12.0),
            decays: Some(0.0),
            peak_n: Some(2.0),
            rms_n: Some(1.0),
            punctures: Some(4.0),
            solves_ratio: Some(1.0),
            overload: Some(0.0),
            session_p99_us: Some(1000.0),
            session_second_us: Some(500.0),
            horizon_ms: Some(40.0),
            ..Measured::default()
        }
    }

    fn missed(load: Load, run: Measured) -> Vec<String> {
        let bars = bars("palpation", load, &good(), &[good(), run]);
        let missed = bars.into_iter().filter(Bar::is_missed);
        missed
            .map(|bar| {
                assert_eq!((bar.held, bar.of, &bar.missed_in[..]), (1, 2, &[2][..]));
                bar.name
            })
            .collect()
    }

    #[test]
    fn each_bar_is_missed_by_what_it_forbids_and_by_nothing_else() {
        for load in Load::ALL {
            assert_eq!(missed(load, good()), Vec::<String>::new());
        }
        let change = |change: &dyn Fn(&mut Measured)| {
            let mut run = good();
            change(&mut run);
            run
        };
        let busy = Load::BusyPlain;
        let cases: [(Load, Measured, &str); 12] = [
            (busy, change(&|r| r.code = Some(1)), "ends ok"),
            (busy, change(&|r| r.mode = "idle".into()), "never idle"),
            (busy, change(&|r| r.decays = Some(2.0)), "at most one decay"),
            (busy, change(&|r| r.decays = None), "at most one decay"),
            (busy, change(&|r| r.solves_ratio = Some(0.89)), "solves"),
            (busy, change(&|r| r.peak_n = Some(2.11)), "peak force"),
            (busy, change(&|r| r.rms_n = Some(0.94)), "RMS force"),
            (busy, change(&|r| r.punctures = Some(3.0)), "punctures"),
            (busy, change(&|r| r.punctures = None), "punctures"),
            (Load::Idle, change(&|r| r.decays = Some(1.0)), "no decay"),
            (Load::Idle, change(&|r| r.overload = Some(1.0)), "overload"),
            (
                Load::Idle,
                change(&|r| r.session_p99_us = Some(5001.0)),
                "session_us p99",
            ),
        ];
        for (load, run, name) in cases {
            let missed = missed(load, run);
            assert_eq!(missed.len(), 1, "{name}: {missed:?}");
            assert!(missed[0].starts_with(name), "{missed:?}");
        }
        // Two in 24 s are not more than one in ten.
        let long = change(&|r| (r.seconds, r.decays) = (Some(24.0), Some(2.0)));
        assert!(missed(busy, long).is_empty());
    }

    #[test]
    fn a_scene_that_fails_in_lockstep_misses_a_bar() {
        let mut lockstep = good();
        (lockstep.code, lockstep.status) = (Some(1), "failed".into());
        let all = bars("palpation", Load::Idle, &lockstep, &[good()]);
        let missed: Vec<_> = all.iter().filter(|bar| bar.is_missed()).collect();
        assert_eq!(missed.len(), 1, "{missed:?}");
        assert_eq!(missed[0].name, "ends ok in lockstep");
    }

    #[test]
    fn a_figure_that_every_summary_has_is_missed_where_it_is_not() {
        let run = Measured {
            overload: None,
            session_p99_us: None,
            session_second_us: None,
            horizon_ms: None,
            peak_n: None,
            ..good()
        };
        let all = bars("palpation", Load::Idle, &good(), &[run]);
        let verdict = |name: &str| {
            all.iter()
                .find(|bar| bar.name.starts_with(name))
                .map(|bar| bar.verdict)
        };
        let lacking = [
            "overload",
            "session_us p99",
            "session_us <= 2 ms",
            "horizon_ms",
            "peak",
        ];
        for name in lacking {
            assert_eq!(verdict(name), Some(Verdict::Missed), "{name}");
        }
        assert_eq!(verdict("ends ok"), Some(Verdict::Met));
        // Nothing is sewn there.
        assert_eq!(verdict("final gap"), None);
    }
}
