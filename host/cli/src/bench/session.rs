//! What a session's solver takes: contact, looking ahead and all that its thread does in a period, over the whole script.
//!
//! Entry point: [`Solves::of`]. The session is run in lockstep with a virtual console, once so that every compliance column
//! that it needs is there, then as often as is measured; time stands for what the same solve took when it was fastest. What steps
//! wait for factors is left out: in real time factors come when they are made.

use crate::failure::{Cause, Failure};
use schemars::JsonSchema;
use serde::Serialize;
use std::ops::ControlFlow;
use std::time::{Duration, Instant};
use sutura_hil::NativeConsole;
use sutura_host::scene::Scene;
use sutura_host::session::{Plan, SceneSolver, Solve, Solved, run_lockstep};
use sutura_shared::wire::Valid;
use sutura_shared::wire::message::State;

/// A second of console time \[us\].
const SECOND_US: u64 = 1_000_000;

/// The solves of a session.
#[derive(Clone, Debug, Default)]
pub struct Solves {
    /// Console time \[us\], and what each took \[us\].
    each: Vec<(u64, f64)>,
    /// How many of them waited for a factor.
    waited: usize,
}

/// Their distribution.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, JsonSchema)]
pub struct SessionUs {
    pub p50: f64,
    pub p99: f64,
    pub max: f64,
}

/// The second of a session whose solves take longest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WorstSecond {
    /// Its begin, since the first solve \[s\].
    pub from_s: f64,
    /// Mean of its solves \[us\].
    pub mean_us: f64,
    /// Its slowest hundredth \[us\].
    pub p99_us: f64,
}

/// A solver with a clock beside it.
struct Timed<'a> {
    solver: &'a mut dyn Solve,
    solves: Vec<(u64, Duration)>,
    waited: usize,
}

impl Solve for Timed<'_> {
    fn solve(&mut self, state: &Valid<State>) -> Solved {
        let started = Instant::now();
        let solved = self.solver.solve(state);
        let waited = Duration::from_nanos(solved.stages.wait_ns);
        let took = started.elapsed().saturating_sub(waited);
        self.solves.push((state.console_time_us(), took));
        self.waited += usize::from(!waited.is_zero());
        solved
    }

    fn scene(&self) -> serde_json::Map<String, serde_json::Value> {
        self.solver.scene()
    }
}

impl Solves {
    /// Of a scene's session, as lockstep runs it; the fastest of so many `passes` after one that is not measured.
    ///
    /// # Errors
    /// A scene that has no session, or no solver.
    pub fn of(scene: &Scene, passes: usize) -> Result<Solves, Failure> {
        let plan = Plan::of_scene(scene)?;
        let mut solver = SceneSolver::for_session(scene, &plan)?;
        let Some(begin) = solver.moment() else {
            // Nor are there columns for which a second pass would be made.
            return Solves::run(&plan, &mut solver);
        };
        Solves::run(&plan, &mut solver)?;
        let mut best: Option<Solves> = None;
        for _ in 0..passes.max(1) {
            solver.go_on_from(&begin);
            let pass = Solves::run(&plan, &mut solver)?;
            best = Some(match best {
                Some(best) => best.faster(pass),
                None => pass,
            });
        }
        Ok(best.unwrap_or_default())
    }

    fn run(plan: &Plan, solver: &mut dyn Solve) -> Result<Solves, Failure> {
        let mut console = NativeConsole::new(&plan.device).map_err(|error| {
            let message = format!("the device is unusable: {error}");
            Failure::say(Cause::BadInput, message, "correct its device file")
        })?;
        let mut timed = Timed {
            solver,
            solves: Vec::new(),
            waited: 0,
        };
        let ran = run_lockstep(
            &mut console,
            plan,
            &mut timed,
            |_| ControlFlow::Continue(()),
        );
        ran.map_err(|error| {
            let help = "see what `sutura run --lockstep` says of it";
            Failure::say(Cause::Failed, error.to_string(), help)
        })?;
        let micros = |(time_us, took): (u64, Duration)| (time_us, 1e6 * took.as_secs_f64());
        Ok(Solves {
            each: timed.solves.into_iter().map(micros).collect(),
            waited: timed.waited,
        })
    }

    /// Each solve as it was fastest: in lockstep two passes do the same.
    fn faster(self, other: Solves) -> Solves {
        let same = self.each.len() == other.each.len();
        if !same {
            return other;
        }
        let pairs = self.each.into_iter().zip(other.each);
        Solves {
            each: pairs.map(|((time, a), (_, b))| (time, a.min(b))).collect(),
            waited: other.waited,
        }
    }

    /// How many of them waited for a factor, which is not part of what they took.
    pub fn waited(&self) -> usize {
        self.waited
    }

    /// Their distribution.
    pub fn distribution(&self) -> SessionUs {
        let mut took: Vec<f64> = self.each.iter().map(|(_, us)| *us).collect();
        SessionUs {
            p50: super::quantile(&mut took, 0.5),
            p99: super::quantile(&mut took, 0.99),
            max: super::quantile(&mut took, 1.0),
        }
    }

    /// Of all seconds of console time that begin with a solve the one with the largest mean; a shorter session is one.
    pub fn worst_second(&self) -> Option<WorstSecond> {
        let solves = &self.each;
        let (first_us, last_us) = (solves.first()?.0, solves.last()?.0);
        let mut worst: Option<(usize, usize, f64)> = None;
        let (mut end, mut sum) = (0, 0.0);
        for (begin, (time_us, took)) in solves.iter().enumerate() {
            while let Some((_, us)) = solves.get(end).filter(|at| at.0 < time_us + SECOND_US) {
                sum += us;
                end += 1;
            }
            // A part of a second at the session's end is not one.
            let whole = begin == 0 || time_us + SECOND_US <= last_us + 1;
            let mean = sum / (end - begin) as f64;
            if whole && worst.is_none_or(|(_, _, most)| mean > most) {
                worst = Some((begin, end, mean));
            }
            sum -= took;
        }
        let (begin, end, mean_us) = worst?;
        let mut took: Vec<f64> = solves[begin..end].iter().map(|(_, us)| *us).collect();
        Some(WorstSecond {
            from_s: 1e-6 * (solves[begin].0 - first_us) as f64,
            mean_us,
            p99_us: super::quantile(&mut took, 0.99),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 100 solves a second for so long, of which those of one time take longer.
    fn solves(seconds: u64, slow: std::ops::Range<u64>) -> Solves {
        let all = (0..100 * seconds).map(|k| {
            let us = if slow.contains(&k) { 900.0 } else { 100.0 };
            (5_000_000 + 10_000 * k, us)
        });
        of(all.collect())
    }

    fn of(each: Vec<(u64, f64)>) -> Solves {
        Solves { each, waited: 0 }
    }

    #[test]
    fn the_worst_second_is_found_wherever_it_is() {
        let worst = solves(5, 230..280).worst_second().expect("a second");
        assert!((worst.mean_us - 500.0).abs() < 1e-6, "{worst:?}");
        assert!((1.79..=2.3).contains(&worst.from_s), "{worst:?}");
        assert_eq!(worst.p99_us, 900.0);
        // What the first second and the quantiles of all do not show.
        let few = solves(60, 3000..3050);
        assert_eq!(
            few.distribution(),
            SessionUs {
                p50: 100.0,
                p99: 100.0,
                max: 900.0
            }
        );
        assert_eq!(few.worst_second().map(|worst| worst.p99_us), Some(900.0));
    }

    #[test]
    fn a_short_session_is_one_second() {
        let short = of(vec![(0, 1.0), (10_000, 3.0)]);
        let worst = short.worst_second().expect("a second");
        assert_eq!((worst.from_s, worst.mean_us), (0.0, 2.0));
        assert_eq!(Solves::default().worst_second(), None);
    }

    #[test]
    fn each_solve_counts_as_it_was_fastest() {
        let a = of(vec![(0, 1.0), (10, 8.0)]);
        let b = of(vec![(0, 2.0), (10, 3.0)]);
        assert_eq!(a.faster(b).each, [(0, 1.0), (10, 3.0)]);
    }
}
