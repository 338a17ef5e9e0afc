//! The steps' end of what is made beside them.
//!
//! Entry points: [`Renewer::ask`], [`Renewer::go_on`], [`Renewer::take`]. A state says what it has asked for by a
//! ticket. If something else is in the making, as after a copy of the state was put back, that is let go and the
//! state's own wish is made: late, but with the same bits.

use super::thread::{Maker, Thread};
use super::{Renewal, Renewals, Rule};
use crate::columns::{Bank, ColumnSolver, Groups};
use crate::fem::{CorotationalState, CorotationalTissue, HeldPoints, Renewed};
use std::collections::VecDeque;
use std::sync::Arc;

/// Vertices whose columns were in use in so many steps are in use: they are computed for a new factor, too.
const IN_USE: u64 = 32;
/// And so many at most that will soon be.
const MOST_WISHED: usize = 24;

/// Asks, and takes over.
pub(crate) struct Renewer {
    rule: Rule,
    by: By,
    /// `None` while the thread has it.
    here: Option<Box<Renewal>>,
    /// What is made or in the making.
    ticket: Option<u64>,
    /// Whether it is made.
    made: bool,
    /// Vertices that it is to have columns for, whoever computes them, (b).
    told: Vec<bool>,
    /// Columns that were used in this step or a later one go with it.
    since: u64,
    late: Vec<u32>,
    wished: Vec<u32>,
    /// Step of the wishes.
    wished_at: u64,
    /// Steps in which recorded factors came.
    due: VecDeque<u64>,
    #[cfg(test)]
    pub handicap: super::Handicap,
    #[cfg(test)]
    spare: Option<Box<Maker>>,
}

enum By {
    Thread(Thread),
    /// Without a thread the step that is to take it over makes it.
    Step(Box<Maker>),
    /// The thread is gone.
    Nobody,
}

impl Renewer {
    /// `next` has room for columns of the next factor.
    pub fn new(
        tissue: Arc<CorotationalTissue>,
        held: Arc<HeldPoints>,
        solver: ColumnSolver,
        groups: Groups,
        next: Bank,
        rule: Rule,
    ) -> Self {
        let vertices = next.vertices();
        let tangent = Renewed::new(&tissue);
        #[cfg(test)]
        let spare = Maker::new(tissue.clone(), held.clone(), groups.clone(), solver.clone());
        let by = match Thread::start(Maker::new(tissue, held, groups, solver)) {
            Ok(thread) => By::Thread(thread),
            Err((error, maker)) => {
                tracing::warn!("no thread for factors, steps make them: {error}");
                By::Step(maker)
            }
        };
        Self {
            rule,
            by,
            here: Some(Box::new(Renewal {
                ticket: 0,
                tangent,
                columns: next,
                wanted: Vec::with_capacity(vertices),
                asked: 0,
                #[cfg(test)]
                handicap: super::Handicap::default(),
            })),
            ticket: None,
            made: false,
            told: vec![false; vertices],
            since: 0,
            late: Vec::with_capacity(vertices),
            wished: Vec::with_capacity(MOST_WISHED),
            wished_at: 0,
            due: VecDeque::new(),
            #[cfg(test)]
            handicap: super::Handicap::default(),
            #[cfg(test)]
            spare: Some(Box::new(spare)),
        }
    }

    pub fn set_rule(&mut self, rule: Rule) {
        self.rule = rule;
    }

    /// Whether there is still somebody to make one.
    pub fn works(&self) -> bool {
        !matches!(self.by, By::Nobody)
    }

    /// As [`Rule::helpless`].
    pub fn helpless(&self) -> f64 {
        self.rule.helpless()
    }

    /// A recorded factor came in this step.
    pub fn expect(&mut self, step: u64) {
        self.due.push_back(step);
    }

    /// A vertex that may be in use soon, as of the step `now`.
    pub fn wish(&mut self, vertex: u32, now: u64) {
        if self.wished_at != now {
            self.wished_at = now;
            self.wished.clear();
        }
        if self.wished.len() < MOST_WISHED {
            self.wished.push(vertex);
        }
    }

    /// Has what `state` has asked for made, with the columns in use; if the thread is at something else, some other time.
    pub fn ask(&mut self, state: &CorotationalState, in_use: &Bank, now: u64) {
        let Some(ticket) = state.ticket().filter(|ticket| self.ticket != Some(*ticket)) else {
            return;
        };
        self.collect();
        let Some(mut renewal) = self.here.take() else {
            return;
        };
        self.ticket = Some(ticket);
        self.made = false;
        self.since = now.saturating_sub(IN_USE);
        self.told.fill(false);
        renewal.ticket = ticket;
        renewal.asked = now;
        renewal.tangent.read(state);
        renewal.wanted.clear();
        let wished = wished(&self.wished, self.wished_at, now);
        let used = in_use.used_since(self.since).map(|(vertex, _)| vertex);
        for vertex in used.chain(wished) {
            if !std::mem::replace(&mut self.told[vertex as usize], true) {
                renewal.wanted.push(vertex);
            }
        }
        #[cfg(test)]
        {
            renewal.handicap = self.handicap;
        }
        self.here = match &self.by {
            By::Thread(thread) => thread.ask(renewal),
            By::Step(_) | By::Nobody => Some(renewal),
        };
    }

    /// A step begins while something is in the making: what has come in use since is told, and what will be.
    pub fn go_on(&mut self, state: &CorotationalState, in_use: &Bank, now: u64) {
        self.ask(state, in_use, now);
        let Some(ticket) = self.ticket else {
            return;
        };
        let wished = wished(&self.wished, self.wished_at, now);
        let used = in_use.used_since(now.saturating_sub(1));
        for vertex in used.map(|(vertex, _)| vertex).chain(wished) {
            if std::mem::replace(&mut self.told[vertex as usize], true) {
                continue;
            }
            // Where it comes too late, the step that takes over computes them.
            if let (By::Thread(thread), None) = (&self.by, &self.here) {
                thread.tell(ticket, vertex);
            }
        }
    }

    /// Whether `state` is to take over in this step what it has asked for.
    pub fn is_due(
        &mut self,
        tissue: &CorotationalTissue,
        state: &CorotationalState,
        now: u64,
    ) -> bool {
        let steps = state.steps_since_asked();
        let due = match self.rule {
            Rule::After(most) => steps >= most,
            Rule::WhenThere => {
                self.collect();
                match self.by {
                    By::Thread(_) => self.is_made(state),
                    By::Step(_) => steps >= Rule::STEPS,
                    By::Nobody => true,
                }
            }
            Rule::AsRecorded => {
                let before = self.due.len();
                while self.due.pop_front_if(|step| *step <= now).is_some() {}
                self.due.len() < before
            }
        };
        due || tissue.is_in_need(state, self.rule.helpless())
    }

    fn is_made(&self, state: &CorotationalState) -> bool {
        self.here.is_some() && self.made && self.ticket == state.ticket()
    }

    /// Gives `state` what it has asked for, and `columns` those of it; whether it could be made.
    pub fn take(
        &mut self,
        state: &mut CorotationalState,
        columns: &mut Bank,
        now: u64,
        report: &mut Renewals,
    ) -> bool {
        self.collect();
        report.waited += u32::from(!self.is_made(state));
        while !self.is_made(state) && self.works() {
            self.ask(state, columns, now);
            match (&mut self.by, &mut self.here) {
                (By::Thread(thread), None) => match thread.wait() {
                    Some(renewal) => (self.here, self.made) = (Some(renewal), true),
                    None => self.by = By::Nobody,
                },
                (By::Step(maker), Some(renewal)) => {
                    maker.make(renewal);
                    self.made = true;
                }
                // A thread that takes nothing is gone.
                _ => self.by = By::Nobody,
            }
        }
        let made = self.is_made(state);
        let Some(renewal) = self
            .here
            .as_mut()
            .filter(|renewal| made && renewal.tangent.is_sound())
        else {
            state.go_without();
            self.ticket = None;
            report.failed += 1;
            return false;
        };
        state.adopt(&mut renewal.tangent);
        std::mem::swap(columns, &mut renewal.columns);
        self.late.clear();
        for (vertex, used) in renewal.columns.used_since(self.since) {
            self.told[vertex as usize] = true;
            columns.keep(vertex, used);
        }
        let told = (0..).zip(&self.told).filter(|(_, told)| **told);
        let missing = told.map(|(vertex, _)| vertex);
        self.late
            .extend(missing.filter(|vertex| !columns.has(*vertex)));
        self.ticket = None;
        report.adopted += 1;
        true
    }

    /// After [`Self::take`]: vertices in use, or wished for, whose columns are not there.
    pub fn late(&self) -> &[u32] {
        &self.late
    }

    /// As on a system that has no thread to give.
    #[cfg(test)]
    pub fn lose_thread(&mut self) {
        if let Some(maker) = self.spare.take() {
            self.by = By::Step(maker);
        }
    }

    /// What the thread has made, if it has.
    fn collect(&mut self) {
        let By::Thread(thread) = &self.by else {
            return;
        };
        if self.here.is_some() {
            return;
        }
        match thread.look() {
            Ok(Some(renewal)) => (self.here, self.made) = (Some(renewal), true),
            Ok(None) => {}
            Err(()) => self.by = By::Nobody,
        }
    }
}

/// What was wished for in the step before `now`, or in it.
fn wished(vertices: &[u32], at: u64, now: u64) -> impl Iterator<Item = u32> + '_ {
    vertices.iter().copied().filter(move |_| at + 1 >= now)
}
