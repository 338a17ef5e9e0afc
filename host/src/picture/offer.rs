//! How a solver's state gets to whoever draws it, without the solver ever waiting.
//!
//! Entry points: [`Offer`], [`Showing`], [`Offering`]. Three snapshots change hands: the solver writes its own, and puts it where the one
//! who draws finds it, if that is free at the moment; else the next one will do.

use crate::recording::TappedSolver;
use crate::session::{Effort, Plan, SceneSolver, Snapshot, Solve, Solved, Spared};
use crate::times::Times;
use crate::tool::Act;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;
use sutura_shared::wire::Valid;
use sutura_shared::wire::message::State;

/// Longest time of an offer that its percentiles tell apart \[ns\].
const LONGEST_NS: u64 = 1_000_000_000;

/// Where a solver and who draws it meet.
#[derive(Debug)]
pub struct Offer {
    /// Console time between two snapshots \[us\]; 0: nobody watches.
    period_us: AtomicU64,
    /// Snapshots that were made so far.
    made: AtomicU64,
    slot: Mutex<Slot>,
}

#[derive(Debug)]
struct Slot {
    snapshot: Box<Snapshot>,
    is_fresh: bool,
    /// What offers took \[ns\].
    took_ns: Times,
}

impl Offer {
    /// For a solver, whom nobody watches yet.
    pub fn new(solver: &SceneSolver) -> Arc<Self> {
        Arc::new(Self {
            period_us: AtomicU64::new(0),
            made: AtomicU64::new(0),
            slot: Mutex::new(Slot {
                snapshot: Box::new(Snapshot::of(solver)),
                is_fresh: false,
                took_ns: Times::new(LONGEST_NS),
            }),
        })
    }

    /// From now on there is a snapshot every so much console time \[us\]; 0: nobody watches.
    pub fn want(&self, period_us: u64) {
        self.period_us.store(period_us, Ordering::Relaxed);
    }

    /// Snapshots that were made so far.
    pub fn made(&self) -> u64 {
        self.made.load(Ordering::Relaxed)
    }

    /// Takes the newest snapshot in exchange for another; says whether there was one that had not been taken.
    pub fn take(&self, own: &mut Box<Snapshot>) -> bool {
        let mut slot = self.slot.lock().unwrap_or_else(PoisonError::into_inner);
        if !std::mem::take(&mut slot.is_fresh) {
            return false;
        }
        std::mem::swap(&mut slot.snapshot, own);
        true
    }

    /// Half of the offers took no longer than this, and 99 of 100 \[us\].
    pub fn took_us(&self) -> [f64; 2] {
        let slot = self.slot.lock().unwrap_or_else(PoisonError::into_inner);
        [0.5, 0.99].map(|part| 1e-3 * slot.took_ns.quantile(part) as f64)
    }
}

/// The solver's side of an [`Offer`].
#[derive(Debug)]
pub struct Offering {
    offer: Arc<Offer>,
    own: Box<Snapshot>,
    due_us: u64,
    solves: u32,
}

impl Offering {
    /// To an offer, of this solver's states.
    pub fn new(offer: Arc<Offer>, solver: &SceneSolver) -> Self {
        Self {
            offer,
            own: Box::new(Snapshot::of(solver)),
            due_us: 0,
            solves: 0,
        }
    }

    /// After a solve for a state of this console time \[us\].
    pub fn solved(&mut self, solver: &SceneSolver, now_us: u64) {
        self.solves = self.solves.wrapping_add(1);
        let period_us = self.offer.period_us.load(Ordering::Relaxed);
        if period_us == 0 {
            return;
        }
        // A console that has started anew counts from the beginning.
        let is_early = now_us < self.due_us && self.due_us - now_us <= period_us;
        if is_early {
            return;
        }
        self.due_us = (self.due_us + period_us).max(now_us + period_us / 2);
        let began = Instant::now();
        solver.snapshot(&mut self.own);
        self.own.solves = self.solves;
        let Ok(mut slot) = self.offer.slot.try_lock() else {
            return;
        };
        std::mem::swap(&mut slot.snapshot, &mut self.own);
        slot.is_fresh = true;
        let took_ns = began.elapsed().as_nanos();
        slot.took_ns
            .record(u64::try_from(took_ns).unwrap_or(u64::MAX));
        drop(slot);
        self.offer.made.fetch_add(1, Ordering::Relaxed);
    }
}

/// A solver that is shown.
pub struct Showing<'a> {
    solver: TappedSolver<'a>,
    offering: Option<Offering>,
}

impl<'a> Showing<'a> {
    /// Stands in for `solver`, whose state goes to `offer`, if there is one.
    pub fn new(solver: TappedSolver<'a>, offer: Option<Arc<Offer>>) -> Self {
        let offering = offer.map(|offer| Offering::new(offer, solver.solver()));
        Self { solver, offering }
    }
}

impl Solve for Showing<'_> {
    fn act(&mut self, act: Act) -> bool {
        self.solver.act(act)
    }

    fn spare(&mut self, effort: Effort) -> Spared {
        self.solver.spare(effort)
    }

    fn tune(&mut self, plan: &Plan) {
        self.solver.tune(plan);
    }

    fn solve(&mut self, state: &Valid<State>) -> Solved {
        let solved = self.solver.solve(state);
        if let Some(offering) = &mut self.offering {
            offering.solved(self.solver.solver(), state.console_time_us());
        }
        solved
    }

    fn scene(&self) -> serde_json::Map<String, serde_json::Value> {
        self.solver.scene()
    }
}
