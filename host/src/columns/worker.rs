//! A thread that computes columns while steps go on.
//!
//! Entry points: [`Worker::start`], [`Worker::ask`], [`Worker::finished`]. Buffers travel to the thread
//! and back, so that neither side allocates or waits. It ends when its owner is dropped. When columns come is the one
//! thing about a session that depends on the machine's pace: [`Worker::recorded`] has them come when they came before.

use super::Arrival;
use super::solver::ColumnSolver;
use crate::fem::{HeldPoints, LinearTissue};
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;

/// Vertices that may be on their way at once.
const MOST: usize = 64;

struct Job {
    slot: u32,
    vertex: u32,
    blocks: Vec<f64>,
}

/// The thread's owner.
pub(super) struct Worker {
    by: By,
    on_their_way: usize,
}

enum By {
    Thread {
        /// `None` only while being dropped.
        jobs: Option<SyncSender<Job>>,
        done: Receiver<Job>,
        thread: Option<JoinHandle<()>>,
    },
    /// No thread: each is computed in the step in which it came when that was recorded.
    Recorded {
        solver: Box<ColumnSolver>,
        tissue: Arc<LinearTissue>,
        held: Arc<HeldPoints>,
        asked: Vec<Job>,
        due: VecDeque<Arrival>,
    },
}

impl Worker {
    pub fn start(
        mut solver: ColumnSolver,
        tissue: Arc<LinearTissue>,
        held: Arc<HeldPoints>,
    ) -> std::io::Result<Self> {
        let (jobs, asked) = sync_channel::<Job>(MOST);
        let (finished, done) = sync_channel(MOST);
        let thread = std::thread::Builder::new()
            .name("columns".to_owned())
            .spawn(move || {
                // Whoever started it may go before other programs; this one computes for long.
                crate::scheduling::ordinary();
                let mut batch = Vec::with_capacity(ColumnSolver::BATCH);
                let mut vertices = Vec::with_capacity(ColumnSolver::BATCH);
                while let Ok(job) = asked.recv() {
                    batch.push(job);
                    while batch.len() < ColumnSolver::BATCH
                        && let Ok(job) = asked.try_recv()
                    {
                        batch.push(job);
                    }
                    vertices.clear();
                    vertices.extend(batch.iter().map(|job| job.vertex));
                    solver.solve(&*tissue, &vertices);
                    for (which, mut job) in batch.drain(..).enumerate() {
                        solver.read(&*tissue, &held, which, &mut job.blocks);
                        // Fails only when nobody waits for it any more.
                        if finished.send(job).is_err() {
                            return;
                        }
                    }
                }
            })?;
        Ok(Self {
            by: By::Thread {
                jobs: Some(jobs),
                done,
                thread: Some(thread),
            },
            on_their_way: 0,
        })
    }

    /// One whose columns come when [`Worker::expect`] says.
    pub fn recorded(
        solver: ColumnSolver,
        tissue: Arc<LinearTissue>,
        held: Arc<HeldPoints>,
    ) -> Self {
        Self {
            by: By::Recorded {
                solver: Box::new(solver),
                tissue,
                held,
                asked: Vec::with_capacity(MOST),
                due: VecDeque::new(),
            },
            on_their_way: 0,
        }
    }

    /// What came in steps to come, in order; nothing to a thread.
    pub fn expect(&mut self, arrivals: &[Arrival]) {
        if let By::Recorded { due, .. } = &mut self.by {
            due.extend(arrivals);
        }
    }

    pub fn has_room(&self) -> bool {
        self.on_their_way < MOST
    }

    /// Hands over a buffer to be filled; there must be room.
    pub fn ask(&mut self, slot: u32, vertex: u32, blocks: Vec<f64>) {
        let job = Job {
            slot,
            vertex,
            blocks,
        };
        let taken = match &mut self.by {
            By::Thread { jobs, .. } => jobs.as_ref().is_some_and(|jobs| jobs.try_send(job).is_ok()),
            By::Recorded { asked, .. } => {
                asked.push(job);
                true
            }
        };
        self.on_their_way += usize::from(taken);
    }

    /// Slot and blocks of columns that have been finished by this step, if any.
    pub fn finished(&mut self, step: u64) -> Option<(u32, Vec<f64>)> {
        let job = match &mut self.by {
            By::Thread { done, .. } => done.try_recv().ok()?,
            By::Recorded {
                solver,
                tissue,
                held,
                asked,
                due,
            } => loop {
                let arrival = due.pop_front_if(|arrival| arrival.step <= step)?;
                let vertex = arrival.vertex;
                // What was not asked for this time does not come either: the replay has gone another way.
                if let Some(index) = asked.iter().position(|job| job.vertex == vertex) {
                    let mut job = asked.swap_remove(index);
                    solver.solve(&**tissue, &[vertex]);
                    solver.read(&**tissue, held, 0, &mut job.blocks);
                    break job;
                }
            },
        };
        self.on_their_way -= 1;
        Some((job.slot, job.blocks))
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        let By::Thread { jobs, done, thread } = &mut self.by else {
            return;
        };
        *jobs = None;
        // A full queue of finished jobs must not hold the thread up.
        while done.recv().is_ok() {}
        if let Some(thread) = thread.take() {
            // It does not panic; if it did, that was said on stderr.
            let _ = thread.join();
        }
    }
}
