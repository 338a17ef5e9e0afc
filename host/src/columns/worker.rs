//! A thread that computes columns while steps go on.
//!
//! Entry points: [`Worker::start`], [`Worker::ask`], [`Worker::finished`]. Buffers travel to the thread
//! and back, so that neither side allocates or waits. It ends when its owner is dropped.

use super::solver::ColumnSolver;
use crate::fem::{HeldPoints, LinearTissue};
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
    /// `None` only while being dropped.
    jobs: Option<SyncSender<Job>>,
    done: Receiver<Job>,
    on_their_way: usize,
    thread: Option<JoinHandle<()>>,
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
            jobs: Some(jobs),
            done,
            on_their_way: 0,
            thread: Some(thread),
        })
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
        if let Some(jobs) = &self.jobs
            && jobs.try_send(job).is_ok()
        {
            self.on_their_way += 1;
        }
    }

    /// Slot and blocks of columns that have been finished, if any.
    pub fn finished(&mut self) -> Option<(u32, Vec<f64>)> {
        let job = self.done.try_recv().ok()?;
        self.on_their_way -= 1;
        Some((job.slot, job.blocks))
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        self.jobs = None;
        // A full queue of finished jobs must not hold the thread up.
        while self.done.recv().is_ok() {}
        if let Some(thread) = self.thread.take() {
            // It does not panic; if it did, that was said on stderr.
            let _ = thread.join();
        }
    }
}
