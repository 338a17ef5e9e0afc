//! Who makes renewals: a thread, or whoever needs one.
//!
//! Entry points: [`Maker::make`], [`Thread::start`]. Buffers travel to the thread and back, so that neither side
//! allocates once they have grown, and the steps never wait unless they want to.

use super::Renewal;
use crate::body::View;
use crate::columns::{ColumnSolver, Groups};
use crate::fem::{CorotationalTissue, HeldPoints, RenewScratch};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, sync_channel};
use std::thread::JoinHandle;

/// Vertices that may be told of while a renewal is in the making.
const MOST_MORE: usize = 256;
/// Slots that are kept empty, for what is touched next.
const SPARE: usize = 16;

/// What making one takes.
pub(super) struct Maker {
    tissue: Arc<CorotationalTissue>,
    held: Arc<HeldPoints>,
    groups: Groups,
    solver: ColumnSolver,
    scratch: RenewScratch,
}

/// The thread's owner.
pub(super) struct Thread {
    /// `None` only while being dropped.
    jobs: Option<SyncSender<Box<Renewal>>>,
    /// Ticket and vertex.
    more: Option<SyncSender<(u64, u32)>>,
    done: Receiver<Box<Renewal>>,
    thread: Option<JoinHandle<()>>,
}

impl Maker {
    pub fn new(
        tissue: Arc<CorotationalTissue>,
        held: Arc<HeldPoints>,
        groups: Groups,
        solver: ColumnSolver,
    ) -> Self {
        Self {
            scratch: tissue.renew_scratch(),
            tissue,
            held,
            groups,
            solver,
        }
    }

    /// Factors the tangent and computes the columns that are wanted.
    pub fn make(&mut self, renewal: &mut Renewal) {
        renewal.columns.forget();
        self.tissue.renew(&mut renewal.tangent, &mut self.scratch);
        #[cfg(test)]
        {
            std::thread::sleep(renewal.handicap.delay);
            if renewal.handicap.fails {
                renewal.tangent.spoil();
            }
        }
        self.add_columns(renewal);
    }

    fn add_columns(&mut self, renewal: &mut Renewal) {
        if !renewal.tangent.is_sound() {
            return;
        }
        let Renewal {
            tangent,
            columns,
            wanted,
            asked,
            ..
        } = renewal;
        let view = View::new(self.tissue.numbering(), tangent.factor());
        let (solver, held, groups) = (&mut self.solver, &self.held, &self.groups);
        columns.compute(solver, &view, held, groups, wanted, |_| false, *asked);
    }
}

impl Thread {
    /// # Errors
    /// Gives the maker back when the system has no thread to give.
    pub fn start(maker: Maker) -> Result<Self, (std::io::Error, Box<Maker>)> {
        let (jobs, asked) = sync_channel::<Box<Renewal>>(1);
        let (more, told) = sync_channel::<(u64, u32)>(MOST_MORE);
        let (finished, done) = sync_channel(1);
        // The maker goes to the thread only once there is one.
        let (hand, over) = sync_channel::<Maker>(1);
        let spawned = std::thread::Builder::new()
            .name("renewal".to_owned())
            .spawn(move || {
                // Whoever started it may go before other programs; this one computes for long.
                crate::scheduling::ordinary();
                let Ok(mut maker) = over.recv() else {
                    return;
                };
                while let Ok(mut renewal) = asked.recv() {
                    maker.make(&mut renewal);
                    loop {
                        renewal.wanted.clear();
                        let of_this = told
                            .try_iter()
                            .filter(|(ticket, _)| *ticket == renewal.ticket);
                        let few = of_this.take(ColumnSolver::BATCH);
                        renewal.wanted.extend(few.map(|(_, vertex)| vertex));
                        if renewal.wanted.is_empty() {
                            break;
                        }
                        maker.add_columns(&mut renewal);
                    }
                    renewal.columns.spare(SPARE, maker.groups.count());
                    // Fails only when nobody waits for it any more.
                    if finished.send(renewal).is_err() {
                        return;
                    }
                }
            });
        let thread = match spawned {
            Ok(thread) => thread,
            Err(error) => return Err((error, Box::new(maker))),
        };
        // The thread waits for it.
        let _ = hand.send(maker);
        Ok(Self {
            jobs: Some(jobs),
            more: Some(more),
            done,
            thread: Some(thread),
        })
    }

    /// Hands over what is to be made; the thread must be idle. Gives it back when there is no thread any more.
    pub fn ask(&self, renewal: Box<Renewal>) -> Option<Box<Renewal>> {
        match &self.jobs {
            Some(jobs) => jobs.try_send(renewal).err().map(|error| match error {
                std::sync::mpsc::TrySendError::Full(renewal)
                | std::sync::mpsc::TrySendError::Disconnected(renewal) => renewal,
            }),
            None => Some(renewal),
        }
    }

    /// Another vertex for what is in the making, if there is room.
    pub fn tell(&self, ticket: u64, vertex: u32) {
        if let Some(more) = &self.more {
            // Full or gone: the step does without.
            let _ = more.try_send((ticket, vertex));
        }
    }

    /// What is made, if it is; an error when there is no thread any more.
    pub fn look(&self) -> Result<Option<Box<Renewal>>, ()> {
        match self.done.try_recv() {
            Ok(renewal) => Ok(Some(renewal)),
            Err(TryRecvError::Empty) => Ok(None),
            Err(TryRecvError::Disconnected) => Err(()),
        }
    }

    /// What is made, as soon as it is; nothing when there is no thread any more.
    pub fn wait(&self) -> Option<Box<Renewal>> {
        self.done.recv().ok()
    }
}

impl Drop for Thread {
    fn drop(&mut self) {
        self.jobs = None;
        self.more = None;
        // A finished renewal must not hold the thread up.
        while self.done.recv().is_ok() {}
        if let Some(thread) = self.thread.take() {
            // It does not panic; if it did, that was said on stderr.
            let _ = thread.join();
        }
    }
}
