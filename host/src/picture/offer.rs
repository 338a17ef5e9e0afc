//! How a solver's state gets to whoever draws it, without the solver ever waiting.
//!
//! Entry points: [`Offer`], [`Showing`], [`Offering`]. Three snapshots change hands: the solver writes its own, and puts it where the one
//! who draws finds it, if that is free at the moment; else the next one will do. Of a scene with a thread those at beats go in a row of their
//! own, [`Heard`], of which none is left out while it has room: how a thread hangs follows from all of them.

use crate::recording::TappedSolver;
use crate::session::{Effort, Plan, SceneSolver, Snapshot, Solve, Solved, Spared};
use crate::thread::Beats;
use crate::times::Times;
use crate::tool::Act;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;
use sutura_shared::wire::Valid;
use sutura_shared::wire::message::State;

/// Longest time of an offer that its percentiles tell apart \[ns\].
const LONGEST_NS: u64 = 1_000_000_000;

/// Beats that wait for who draws at most: 3.2 s of the console's time.
const MOST_BEATS: usize = 32;

/// A beat of a solver's threads.
#[derive(Debug)]
struct Beat {
    snapshot: Box<Snapshot>,
    /// Whether beats before it are missing.
    begins: bool,
}

/// The solver's side of the row of beats.
#[derive(Debug)]
struct Told {
    to: SyncSender<Beat>,
    free: Receiver<Box<Snapshot>>,
}

/// The beats of a solver's threads, for who draws them.
#[derive(Debug)]
pub struct Heard {
    from: Receiver<Beat>,
    back: SyncSender<Box<Snapshot>>,
    /// One that is later than what is drawn.
    next: Option<Beat>,
    is_open: bool,
}

impl Heard {
    /// From now on there is room for beats, of snapshots like this one.
    pub fn open(&mut self, own: &Snapshot) {
        if !std::mem::replace(&mut self.is_open, true) {
            for _ in 0..MOST_BEATS {
                self.give_back(Box::new(own.clone()));
            }
        }
    }

    /// Visits the beats up to a snapshot, that one's own included, and whether others are missing before each.
    pub fn up_to(&mut self, own: &Snapshot, mut visit: impl FnMut(&Snapshot, bool)) {
        while let Some(beat) = self.next.take().or_else(|| self.from.try_recv().ok()) {
            // The count of solves begins anew some day.
            let ahead = beat.snapshot.solves.wrapping_sub(own.solves);
            if ahead != 0 && ahead < u32::MAX / 2 {
                self.next = Some(beat);
                return;
            }
            visit(&beat.snapshot, beat.begins);
            self.give_back(beat.snapshot);
        }
    }

    fn give_back(&self, snapshot: Box<Snapshot>) {
        // There is room for all; the solver may be gone.
        let _ = self.back.try_send(snapshot);
    }
}

/// Where a solver and who draws it meet.
#[derive(Debug)]
pub struct Offer {
    /// Console time between two snapshots \[us\]; 0: nobody watches.
    period_us: AtomicU64,
    /// Snapshots that were made so far.
    made: AtomicU64,
    slot: Mutex<Slot>,
    /// Both ends of the row of beats, until they are fetched; of a scene with a thread.
    told: Mutex<Option<Told>>,
    heard: Mutex<Option<Heard>>,
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
        let has_thread = solver.model().is_some_and(|model| model.has_thread());
        let (told, heard) = has_thread.then(row).unzip();
        Arc::new(Self {
            told: Mutex::new(told),
            heard: Mutex::new(heard),
            period_us: AtomicU64::new(0),
            made: AtomicU64::new(0),
            slot: Mutex::new(Slot {
                snapshot: Box::new(Snapshot::of(solver)),
                is_fresh: false,
                took_ns: Times::new(LONGEST_NS),
            }),
        })
    }

    /// Offers the solver's state before its first solve.
    pub fn offer_first(&self) {
        let mut slot = self.slot.lock().unwrap_or_else(PoisonError::into_inner);
        slot.is_fresh = true;
    }

    /// From now on there is a snapshot every so much console time \[us\]; 0: nobody watches.
    pub fn want(&self, period_us: u64) {
        self.period_us.store(period_us, Ordering::Relaxed);
    }

    /// Whether somebody watches.
    pub fn is_wanted(&self) -> bool {
        self.period_us.load(Ordering::Relaxed) > 0
    }

    /// The beats of its threads, once; none of a scene without.
    pub fn heard(&self) -> Option<Heard> {
        self.heard
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take()
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

/// A row of beats.
fn row() -> (Told, Heard) {
    let (to, from) = sync_channel(MOST_BEATS);
    let (back, free) = sync_channel(MOST_BEATS);
    let heard = Heard {
        from,
        back,
        next: None,
        is_open: false,
    };
    (Told { to, free }, heard)
}

/// The solver's side of an [`Offer`].
#[derive(Debug)]
pub struct Offering {
    offer: Arc<Offer>,
    own: Box<Snapshot>,
    due_us: u64,
    solves: u32,
    told: Option<Told>,
    beats: Beats,
    /// Whether a beat is missing before the next one.
    is_missing: bool,
}

impl Offering {
    /// To an offer, of this solver's states.
    pub fn new(offer: Arc<Offer>, solver: &SceneSolver) -> Self {
        let told = offer.told.lock();
        let told = told.unwrap_or_else(PoisonError::into_inner).take();
        Self {
            offer,
            own: Box::new(Snapshot::of(solver)),
            due_us: 0,
            solves: 0,
            told,
            beats: Beats::default(),
            is_missing: true,
        }
    }

    /// Tells of a beat, if this is one and there is room; there is none before somebody looks.
    fn beat(&mut self, solver: &SceneSolver, now_us: u64) {
        let Some(told) = &self.told else {
            return;
        };
        if !self.beats.is_due(now_us) {
            return;
        }
        let begins = std::mem::replace(&mut self.is_missing, true);
        let Ok(mut snapshot) = told.free.try_recv() else {
            return;
        };
        solver.snapshot(&mut snapshot);
        snapshot.solves = self.solves;
        self.is_missing = told.to.try_send(Beat { snapshot, begins }).is_err();
    }

    /// After a solve for a state of this console time \[us\].
    pub fn solved(&mut self, solver: &SceneSolver, now_us: u64) {
        self.solves = self.solves.wrapping_add(1);
        let period_us = self.offer.period_us.load(Ordering::Relaxed);
        if period_us == 0 {
            self.is_missing = true;
            return;
        }
        self.beat(solver, now_us);
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

    fn warm(&self) {
        self.solver.warm();
    }

    fn scene(&self) -> serde_json::Map<String, serde_json::Value> {
        self.solver.scene()
    }
}
