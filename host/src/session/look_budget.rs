//! How much a solve may spend on steps ahead of it: a share of the planned period, whatever the last period was.
//!
//! Entry point: [`LookBudget`]. A host that is late must not look farther ahead for that. In lockstep and in simulated time a
//! step is priced by a count of what it did, so that nothing depends on the machine; in real time by the processor's time
//! that it took; and a replay makes as many as were made then.

use crate::clock::Stopwatch;
use crate::step::{Status, StepReport};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Part of the planned period that may be spent.
const SHARE: f64 = 0.2;

/// Price of a step \[us\], and of each of its solves of so many rows: measured once, and the same everywhere.
const STEP_US: f64 = 30.0;
const SOLVE_US: f64 = 5.5;
const SOLVE_ROWS: f64 = 60.0;
/// Price of a displacement of all nodes, and of the boundary brought there \[us a node\].
const FIELD_US: f64 = 0.2;
/// Price of a pass over tissue that is not linear \[us a node\].
const PASS_US: f64 = 0.7;
/// Passes besides a step's first that are wanted: each leaves less than a tenth out of balance.
const MOST_PASSES: usize = 3;
/// A price follows what a step took by this part: one that was dear says little.
const FOLLOWS: f64 = 0.25;
/// And is forgotten by this part from solve to solve: where nothing can be paid for, nothing would ever be learnt again.
const FORGETS: f64 = 0.03;
/// Down to this part of the price by the solve's own count: steps ahead may be cheaper, but never for nothing.
const LEAST: f64 = 0.25;
/// More steps of a kind than any solve wants.
const BOUNDLESS: usize = usize::MAX / 4;

/// What a step ahead is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Ahead {
    /// The way between two samples that are far apart.
    Approach,
    /// A needle's way along its slide.
    Course,
    /// A pull on a thread that is slack.
    Pull,
    /// Another pass of the solve's own step, over tissue that one leaves out of balance.
    Pass,
    /// A step that is thrown away, over tissue that is not linear.
    Trial,
}

/// Steps that a solve made besides its own.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Looked {
    /// On the way between two samples that are far apart: made.
    pub approach: u32,
    /// Those that were planned and not made.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub approach_left: u32,
    /// Along a needle's slide, forward and backward: planned, (2).
    pub planned: [u32; 2],
    /// Made, (2).
    pub made: [u32; 2],
    /// Pulls on a thread that is slack.
    pub pulls: u32,
    /// Passes over tissue that is not linear, besides the step's first: allowed.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub passes: u32,
    /// Steps over such tissue that were thrown away.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub trials: u32,
    /// Whether there was no time for more.
    pub short: bool,
    /// Whether none were planned: the host was late for some time, and the solve was made at once where the hand will be.
    #[serde(default, skip_serializing_if = "is_false")]
    pub hurried: bool,
}

fn is_false(flag: &bool) -> bool {
    !*flag
}

fn is_zero(count: &u32) -> bool {
    *count == 0
}

impl Looked {
    /// Whether nothing was looked at and nothing given up.
    pub fn is_nothing(&self) -> bool {
        *self == Looked::default()
    }
}

/// What decides.
#[derive(Clone, Copy, Debug)]
enum Pace {
    /// Counts times committed prices.
    Counted,
    /// The processor's time, and the clock on the wall.
    Measured(Stopwatch),
    /// What was made then.
    Recorded(Looked),
}

/// The budget of one solver.
#[derive(Clone, Debug)]
pub(super) struct LookBudget {
    planned_us: f64,
    /// Nodes of the mesh.
    nodes: f64,
    pace: Pace,
    /// Price of each [`Ahead`] \[us\], (5); none before the first.
    price_us: [Option<f64>; 5],
    left_us: f64,
    looked: Looked,
}

/// Price of a step by its count \[us\].
fn counted_us(report: &StepReport, nodes: f64) -> f64 {
    let rows = f64::from(report.rows) / SOLVE_ROWS;
    let solves = f64::from(report.solves.max(1));
    STEP_US + SOLVE_US * solves * (1.0 + rows * rows) + FIELD_US * f64::from(report.fields) * nodes
}

impl LookBudget {
    /// For solves that are planned every `planned_us`, on a mesh of so many nodes.
    pub fn new(planned_us: f64, nodes: usize) -> Self {
        LookBudget {
            planned_us,
            nodes: nodes as f64,
            pace: Pace::Counted,
            price_us: [None; 5],
            left_us: 0.0,
            looked: Looked::default(),
        }
    }

    /// Solves are planned every `planned_us` from now on.
    pub fn plan(&mut self, planned_us: f64) {
        self.planned_us = planned_us;
    }

    /// From now on the processor's time decides: for real time.
    pub fn measure(&mut self) {
        self.pace = Pace::Measured(Stopwatch::start());
    }

    /// From now on it is as [`Self::expect`] says: for replays.
    pub fn replay(&mut self) {
        self.pace = Pace::Recorded(Looked::default());
    }

    /// Notes whether the solve under way plans no steps besides its own.
    pub fn hurry(&mut self, hurried: bool) {
        self.looked.hurried = hurried;
    }

    /// What the next solve of a replay made then.
    pub fn expect(&mut self, looked: Looked) {
        if let Pace::Recorded(expected) = &mut self.pace {
            *expected = looked;
        }
    }

    /// Begins a solve; `like`: what a step is like now.
    pub fn begin(&mut self, like: &StepReport) {
        self.left_us = SHARE * self.planned_us;
        self.looked = Looked::default();
        let least_us = LEAST * counted_us(like, self.nodes);
        for price_us in self.price_us.iter_mut().flatten() {
            if *price_us > least_us {
                *price_us = (*price_us * (1.0 - FORGETS)).max(least_us);
            }
        }
        if let Pace::Measured(watch) = &mut self.pace {
            *watch = Stopwatch::start();
        }
    }

    /// What this solve has made so far.
    pub fn looked(&self) -> Looked {
        self.looked
    }

    /// Steps of this kind that what is left pays for; `like`: what one is like before the first has been made.
    pub fn affords(&self, kind: Ahead, like: &StepReport) -> usize {
        if let Pace::Recorded(expected) = &self.pace {
            return match kind {
                Ahead::Approach => (expected.approach + expected.approach_left) as usize,
                // As many as are wanted, where any were: how many there were says the plan.
                Ahead::Course if expected.planned == [0; 2] => 0,
                Ahead::Course => BOUNDLESS,
                Ahead::Pull => expected.pulls as usize,
                Ahead::Pass => expected.passes as usize,
                Ahead::Trial => expected.trials as usize,
            };
        }
        let by_count_us = || match kind {
            Ahead::Pass => PASS_US * self.nodes,
            Ahead::Trial => PASS_US * self.nodes * f64::from(like.passes.max(1)),
            _ => counted_us(like, self.nodes),
        };
        let price_us = self.price_us[kind as usize].unwrap_or_else(by_count_us);
        ((self.left_us / price_us).max(0.0) as usize).min(BOUNDLESS)
    }

    /// Steps between two samples: `wanted`, or fewer.
    pub fn approach(&mut self, wanted: usize, like: &StepReport) -> usize {
        let planned = wanted.min(self.affords(Ahead::Approach, like));
        self.looked.approach_left = planned as u32;
        planned
    }

    /// Most passes of the solve's own step over tissue that is not linear, and that one leaves out of balance.
    pub fn passes(&mut self, like: &StepReport) -> u32 {
        let more = self.affords(Ahead::Pass, like).min(MOST_PASSES);
        self.looked.passes = more as u32;
        self.looked.passes + 1
    }

    /// Steps along a slide, forward and backward, as they are planned.
    pub fn course(&mut self, wanted: [usize; 2]) -> [usize; 2] {
        let planned = match &self.pace {
            Pace::Recorded(expected) => expected.planned,
            _ => wanted.map(|steps| steps as u32),
        };
        self.looked.planned = planned;
        planned.map(|steps| steps as usize)
    }

    /// Whether the next step of this kind may be made; `side`: of a course's.
    pub fn allows(&mut self, kind: Ahead, side: usize) -> bool {
        // What turns out dearer than it was priced may cost as much again, no more.
        let is_paid = self.left_us > -SHARE * self.planned_us;
        let is_allowed = match &self.pace {
            Pace::Counted => is_paid,
            Pace::Measured(watch) => is_paid && watch.wall_us() < self.planned_us,
            Pace::Recorded(expected) => match kind {
                Ahead::Approach => self.looked.approach < expected.approach,
                Ahead::Course => self.looked.made[side] < expected.made[side],
                Ahead::Pull => self.looked.pulls < expected.pulls,
                Ahead::Pass => self.looked.passes < expected.passes,
                Ahead::Trial => self.looked.trials < expected.trials,
            },
        };
        self.looked.short |= !is_allowed;
        is_allowed
    }

    /// A step of this kind has been made.
    pub fn made(&mut self, kind: Ahead, side: usize, report: &StepReport) {
        match kind {
            Ahead::Approach => {
                self.looked.approach += 1;
                self.looked.approach_left = self.looked.approach_left.saturating_sub(1);
            }
            Ahead::Course => self.looked.made[side] += 1,
            Ahead::Pull => self.looked.pulls += 1,
            Ahead::Pass => self.looked.passes += 1,
            Ahead::Trial => self.looked.trials += 1,
        }
        let trial_us = PASS_US * self.nodes * f64::from(report.passes.max(1));
        let price_us = match &mut self.pace {
            Pace::Measured(watch) => watch.cpu_lap_us(),
            _ if kind == Ahead::Trial => trial_us,
            _ => counted_us(report, self.nodes),
        };
        self.left_us -= price_us;
        // A step without a balance has tried everything; the next one is of another kind.
        if report.status == Status::Ok {
            let known = &mut self.price_us[kind as usize];
            let before_us = known.unwrap_or(price_us);
            *known = Some(before_us + FOLLOWS * (price_us - before_us));
        }
    }

    /// The solve's own step has been made; its first pass is not charged, and it says what a step on the way to it costs at
    /// least, and what a pass does.
    pub fn stepped(&mut self, report: &StepReport) {
        let passes = f64::from(report.passes.max(1));
        let mut pass_us = PASS_US * self.nodes;
        if let Pace::Measured(watch) = &mut self.pace {
            let own_us = watch.cpu_lap_us();
            pass_us = own_us / passes;
            let [approach, _, _, pass, _] = &mut self.price_us;
            *approach = Some(approach.map_or(own_us, |price_us| price_us.max(own_us)));
            let before_us = pass.unwrap_or(pass_us);
            *pass = Some(before_us + FOLLOWS * (pass_us - before_us));
        }
        self.left_us -= pass_us * (passes - 1.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn report(rows: u32, solves: u32, fields: u32) -> StepReport {
        let mut report = StepReport::default();
        (report.rows, report.solves, report.fields) = (rows, solves, fields);
        report
    }

    /// 1 ms of 5, in steps of three solves of 60 rows.
    #[test]
    fn a_count_buys_the_same_steps_however_late_the_host_is() {
        let mut budget = LookBudget::new(5000.0, 1000);
        let like = report(60, 3, 0);
        budget.begin(&like);
        let price_us = STEP_US + SOLVE_US * 3.0 * 2.0;
        let most = (1000.0 / price_us) as usize;
        assert_eq!(budget.affords(Ahead::Course, &like), most);
        assert_eq!(budget.approach(40, &like), most);
        for _ in 0..4 {
            assert!(budget.allows(Ahead::Approach, 0));
            budget.made(Ahead::Approach, 0, &like);
        }
        let left = ((1000.0 - 4.0 * price_us) / price_us) as usize;
        assert_eq!(budget.affords(Ahead::Course, &like), left);
        // A displacement of all nodes is another thing.
        budget.made(Ahead::Pull, 0, &report(60, 3, 2));
        assert!(budget.affords(Ahead::Pull, &like) < 2);
    }

    /// Steps that were too dear are tried again some time, and one that found no balance says nothing.
    #[test]
    fn what_was_dear_once_is_not_given_up_for_good() {
        let mut budget = LookBudget::new(5000.0, 1000);
        let like = report(60, 3, 0);
        budget.begin(&like);
        let most = budget.affords(Ahead::Course, &like);
        let mut failed = report(60, 2000, 0);
        failed.status = Status::NotConverged;
        budget.made(Ahead::Course, 0, &failed);
        budget.begin(&like);
        assert_eq!(budget.affords(Ahead::Course, &like), most);
        budget.made(Ahead::Course, 0, &report(60, 200, 0));
        budget.begin(&like);
        assert_eq!(budget.affords(Ahead::Course, &like), 0);
        let tried = (0..200).any(|_| {
            budget.begin(&like);
            budget.affords(Ahead::Course, &like) >= 4
        });
        assert!(tried);
    }

    /// A needle that is nowhere near for ten seconds.
    #[test]
    fn a_price_that_nobody_pays_stays_one() {
        let mut budget = LookBudget::new(5000.0, 1000);
        let like = report(60, 3, 0);
        budget.begin(&like);
        let most = budget.affords(Ahead::Course, &like);
        budget.made(Ahead::Course, 0, &report(60, 200, 0));
        for _ in 0..100_000 {
            budget.begin(&like);
        }
        assert!((most..=5 * most).contains(&budget.affords(Ahead::Course, &like)));
        // A clock that stood still.
        budget.price_us = [Some(0.0); 5];
        assert!(budget.affords(Ahead::Course, &like) <= usize::MAX / 4);
    }

    #[test]
    fn a_replay_makes_what_was_made() {
        let then = Looked {
            approach: 2,
            approach_left: 3,
            planned: [7, 3],
            made: [7, 1],
            pulls: 1,
            passes: 2,
            trials: 1,
            short: true,
            hurried: false,
        };
        let mut budget = LookBudget::new(5000.0, 1000);
        budget.replay();
        budget.expect(then);
        budget.begin(&report(60, 3, 0));
        let like = report(3, 1, 0);
        let count = |budget: &mut LookBudget, kind, side, most| {
            for _ in 0..most {
                if budget.allows(kind, side) {
                    budget.made(kind, side, &like);
                }
            }
        };
        assert_eq!(budget.approach(40, &like), 5);
        count(&mut budget, Ahead::Approach, 0, 5);
        assert_eq!(budget.course([24, 16]), [7, 3]);
        count(&mut budget, Ahead::Course, 0, 7);
        count(&mut budget, Ahead::Course, 1, 3);
        count(&mut budget, Ahead::Pull, 0, 3);
        count(&mut budget, Ahead::Trial, 0, 3);
        assert_eq!(budget.passes(&like), 3);
        assert_eq!(budget.looked(), then);
    }

    /// A price that was measured once moves with what comes, and not at once.
    #[test]
    fn a_measured_price_follows() {
        let mut budget = LookBudget::new(1e9, 1000);
        budget.measure();
        budget.begin(&report(60, 3, 0));
        assert!(budget.allows(Ahead::Pull, 0));
        let like = report(3, 1, 0);
        let by_count = budget.affords(Ahead::Pull, &like);
        budget.made(Ahead::Pull, 0, &like);
        assert_ne!(budget.affords(Ahead::Pull, &like), by_count);
    }

    #[test]
    fn nothing_is_begun_that_the_period_has_no_time_for() {
        let mut budget = LookBudget::new(0.0, 1000);
        budget.measure();
        budget.begin(&report(60, 3, 0));
        assert!(!budget.allows(Ahead::Course, 0));
        assert!(budget.looked().short);
    }
}
