//! What a scene's solver steps besides the solve's own step: closer on a way that is long, and ahead of the hand.
//!
//! Entry points: `come_closer`, `goal` and `try_ahead`, `look_ahead`, `tighten`. Steps ahead are on a copy of the state, and
//! only where tissue is not linearised anew by each.

use super::super::look_ahead::{Look, course};
use super::super::look_budget::Ahead;
use super::super::{Effort, Goal, HeldNeedle, HeldThread, sideways};
use super::SceneSolver;
use crate::needle::{NeedleReport, TipPlace};
use crate::step::{Status, StepOptions, StepReport};
use crate::tool::ToolSample;
use sutura_shared::wire::message::{Course, State, Tension};

/// Most steps of one look, forward and backward, and how long they are wanted on average \[m\].
const LOOK_STEPS: [usize; 2] = [24, 16];

/// So much slack is looked through to the taut thread \[m\], and so far into that, in turn \[m\].
const NEARLY_TAUT_M: f64 = 0.01;
const TIGHTENING_M: [f64; 3] = [2e-4, 5e-4, 1e-3];
/// States farther apart than this are far apart \[us\], and a needle's way between them is followed in pieces of this time
/// \[us\].
const FAR_US: u64 = 5_500;
const PIECE_US: u64 = 1_000;
/// With fewer, both ways together, friction and stiffness say as much.
const LOOK_LEAST: usize = 4;
/// A frame is in use until it is so many periods old where the host stalls, or for so long \[us\].
const LOOK_PERIODS: f64 = 4.0;
const LOOK_MOST_US: f64 = 150e3;
/// A hand that rests sets out, and a moving one gets faster, by this \[m/s^2\]; and a little more \[m\].
const LOOK_HAND_M_PER_S: f64 = 0.25;
const LOOK_MARGIN_M: f64 = 5e-4;
/// Farther than this a look is too coarse, forward and backward \[m\].
const LOOK_MOST_M: [f64; 2] = [0.018, 0.012];

/// How far a look goes the way a hand goes with this speed \[m\].
fn look_reach_m(speed_m_per_s: f64, period_us: u64, most_m: f64) -> f64 {
    let seconds = 1e-6 * (LOOK_PERIODS * period_us as f64).min(LOOK_MOST_US);
    (LOOK_MARGIN_M + speed_m_per_s.max(LOOK_HAND_M_PER_S) * seconds).min(most_m)
}

/// How far the tip of a needle may get in a look \[m\]: as fast as its grip goes, whatever the direction.
pub(super) fn tip_reach_m(sample: &ToolSample, period_us: u64) -> f64 {
    let [x, y, z] = sample.velocity_m_per_s;
    let speed_m_per_s = (x * x + y * y + z * z).sqrt();
    look_reach_m(speed_m_per_s, period_us, LOOK_MOST_M[0])
}

impl SceneSolver {
    /// Follows the way of the needle or thread in the console's grip between two states that are far apart in several steps:
    /// friction is that of the depth at which a step begins, a boundary gives way at a step's end, and a thread bends anew between
    /// steps. Of what scripts move nobody feels that.
    pub(super) fn come_closer(&mut self, before: &ToolSample, sample: &ToolSample) {
        let period_us = sample
            .console_time_us
            .saturating_sub(before.console_time_us);
        let far = period_us > FAR_US && period_us <= LOOK_MOST_US as u64;
        let last = &self.past.last;
        let mut needles = last.needles().iter();
        let is_held = needles.any(|needle| needle.held_by == Some(sample.id))
            || HeldThread::at_grip(last, sample.id).is_some();
        if !far || !is_held || !self.follower.is_linear() {
            return;
        }
        let wanted = (period_us / PIECE_US).saturating_sub(1) as usize;
        let pieces = self.past.budget.approach(wanted, &self.past.last) as u64 + 1;
        let blend = |from: f64, to: f64, part: f64| from + (to - from) * part;
        for piece in 1..pieces {
            let part = piece as f64 / pieces as f64;
            let mut between = *sample;
            for (at, from) in between.position_m.iter_mut().zip(before.position_m) {
                *at = blend(from, *at, part);
            }
            let turned = before.orientation.iter().zip(sample.orientation);
            // The nearer of the two quaternions that are the same turn; a step makes a unit of it.
            let product: f64 = turned.map(|(a, b)| a * b).sum();
            let sign = if product < 0.0 { -1.0 } else { 1.0 };
            for (at, from) in between.orientation.iter_mut().zip(before.orientation) {
                *at = blend(sign * from, *at, part);
            }
            between.console_time_us = before.console_time_us + period_us * piece / pieces;
            if !self.past.budget.allows(Ahead::Approach, 0) {
                return;
            }
            let report = self.step_with(between, false);
            self.past.budget.made(Ahead::Approach, 0, &report);
        }
    }

    /// Needle and thread in the console's grip, for the wire, as `report` has them, and how they go on.
    pub(super) fn in_grip(
        &mut self,
        report: &StepReport,
        period_us: u64,
    ) -> (Option<HeldNeedle>, Option<HeldThread>) {
        let Some(driven) = self.driven() else {
            return (None, None);
        };
        let is_good = report.status == Status::Ok;
        let looks_ahead = is_good && self.looks_ahead && self.effort == Effort::Full;
        let mut needle = HeldNeedle::in_grip(report, driven);
        if let Some(needle) = needle.as_mut().filter(|_| looks_ahead) {
            needle.course = self.look_ahead(needle.needle, report, period_us);
        }
        let needle = needle.or_else(|| HeldNeedle::in_jaws(report, driven));
        let mut thread = HeldThread::at_grip(report, driven);
        let slack = |thread: &&mut HeldThread| thread.state == Tension::Slack;
        if let Some(thread) = thread.as_mut().filter(slack).filter(|_| is_good) {
            // Of what else is in the grip.
            thread.stiffness_n_per_m = 0.0;
            if looks_ahead {
                self.tighten(thread, report);
            }
        }
        (needle, thread)
    }

    /// How the axial force of the needle in the grip goes on, as far as it may get before the console hears of it.
    fn look_ahead(&mut self, needle: u8, report: &StepReport, period_us: u64) -> Course {
        let found = report.needles().iter().find(|other| other.id == needle);
        let sample = self.past.script.samples().first();
        let wanted = found.zip(sample);
        let look = wanted.and_then(|(found, at)| self.look(found, at, period_us, report));
        let tissue = self.follower.constrained();
        let (Some(found), Some(mut look), Some(tissue)) = (found, look, tissue) else {
            return Course::default();
        };
        look.steps = self.past.budget.course(look.steps);
        course(
            &tissue.model,
            &tissue.state,
            self.past.script.samples(),
            found,
            &look,
            (&mut tissue.work, &mut self.past.budget),
        )
    }

    /// Where a slack thread becomes taut and how stiff it is then, if that is near: the solver pulls on a copy of its
    /// state. Not where tissue is linearised anew by a step.
    fn tighten(&mut self, thread: &mut HeldThread, like: &StepReport) {
        let near = (0.0..=NEARLY_TAUT_M).contains(&thread.slack_m);
        let known = thread.direction != [0.0; 3];
        let linear = self.follower.is_linear();
        let options = self.options_ahead();
        let budget = &mut self.past.budget;
        let is_paid = budget.affords(Ahead::Pull, like) >= 1;
        if !(near && known && linear && is_paid) {
            return;
        }
        let mut samples = self.past.script.samples().to_vec();
        let (Some(sample), Some(tissue)) = (samples.first().copied(), self.follower.constrained())
        else {
            return;
        };
        let mut state = tissue.state.clone();
        // Straight back is not quite the way on which it tightens.
        for beyond_m in TIGHTENING_M {
            if !budget.allows(Ahead::Pull, 0) {
                return;
            }
            let way_m = thread.slack_m + beyond_m;
            for (at, (from, pull)) in samples[0]
                .position_m
                .iter_mut()
                .zip(sample.position_m.iter().zip(thread.direction))
            {
                *at = from - pull * way_m;
            }
            let report = tissue.try_on(&mut state, &samples, &options);
            budget.made(Ahead::Pull, 0, &report);
            let there = HeldThread::at_grip(&report, thread.tool);
            let Some(there) = there.filter(|_| report.status == Status::Ok) else {
                return;
            };
            if there.state == Tension::Taut && there.stiffness_n_per_m > 0.0 {
                thread.stiffness_n_per_m = there.stiffness_n_per_m;
                thread.slack_m = (way_m - there.tension_n / there.stiffness_n_per_m).max(0.0);
                return;
            }
        }
    }

    /// What a step is asked for of which only needles and threads are read.
    fn options_ahead(&self) -> StepOptions {
        StepOptions {
            without_tools: true,
            tip_reach_m: 0.0,
            ..self.options
        }
    }

    /// How far to look; not at all where tissue is linearised anew by a step, or where it would take too long.
    fn look(
        &self,
        needle: &NeedleReport,
        sample: &ToolSample,
        period_us: u64,
        like: &StepReport,
    ) -> Option<Look> {
        let affordable = self.past.budget.affords(Ahead::Course, like);
        let waits = needle.tip == TipPlace::Waiting;
        if waits || !self.follower.is_linear() || affordable < LOOK_LEAST {
            return None;
        }
        let [x, y, z, ..] = needle.slide;
        let [u, v, w] = sample.velocity_m_per_s;
        let square = (x * x + y * y + z * z).max(1e-6);
        let speed_m_per_s = (x * u + y * v + z * w) / square;
        let reach_m = [
            look_reach_m(speed_m_per_s, period_us, LOOK_MOST_M[0]),
            look_reach_m(-speed_m_per_s, period_us, LOOK_MOST_M[1]),
        ];
        // In the air there is nothing to be found.
        let is_free = needle.tip == TipPlace::Outside && needle.crossings == 0;
        let is_far = !needle.near && reach_m.iter().all(|m| *m <= self.options.tip_reach_m);
        if is_free && needle.touches == 0 && is_far {
            return None;
        }
        let goes_back = speed_m_per_s < 0.0;
        let steps = [goes_back, !goes_back].map(|aside| {
            let side = usize::from(aside);
            (affordable * (2 - side) / 3).clamp(1, LOOK_STEPS[side])
        });
        Some(Look {
            reach_m,
            steps,
            options: self.options_ahead(),
            speed_m_per_s: speed_m_per_s.abs(),
            goes_back,
        })
    }

    /// Whether what lies ahead of a tool that rubs is solved on a copy of the state: not in haste.
    pub(super) fn tries_ahead(&self) -> bool {
        self.effort == Effort::Full && self.would_try_ahead()
    }

    /// The same if there is time for it: not where tissue is linearised anew by a step.
    pub(super) fn would_try_ahead(&self) -> bool {
        let rubs = self.driven().is_some_and(|id| self.follower.rubs(id));
        rubs && self.looks_ahead && self.follower.is_linear()
    }

    /// What the contact is solved for: ahead of the state, or on it where tissue remembers which way tools came and nothing is
    /// tried.
    pub(super) fn goal(&mut self, state: &State, period_us: u64) -> Goal {
        let (position_m, velocity) = (state.position_m, state.velocity_m_per_s);
        let contact = self.past.last.contacts().first();
        let remembers = self.has_needles || self.follower.remembers();
        let stays = remembers && !self.tries_ahead();
        let usual_s = self.lead.lead_s(
            state.contact_sequence,
            state.applied_age_us,
            period_us as f64 * 1e-6,
        );
        let lead_s = match contact {
            Some(_) if !stays => usual_s,
            _ => 0.0,
        };
        let normal = contact.map_or([0.0; 3], |contact| contact.normal);
        sideways(position_m, velocity, &normal, lead_s, self.ahead_s)
    }

    /// A step to `goal` on a copy of the state: what the console is to have of it, which the state does not keep. None if
    /// there is no balance, or nothing lies ahead.
    pub(super) fn try_ahead(&mut self, goal: &Goal) -> Option<StepReport> {
        let mut samples = self.past.script.samples().to_vec();
        let driven = samples.first_mut()?;
        let there = goal.position_m.map(f64::from);
        if self.past.last.status != Status::Ok || driven.position_m == there {
            return None;
        }
        driven.position_m = there;
        let tissue = self.follower.constrained()?;
        let mut state = tissue.state.clone();
        let report = tissue.try_on(&mut state, &samples, &self.options);
        (report.status == Status::Ok).then_some(report)
    }
}
