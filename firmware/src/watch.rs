//! Which tasks have run lately: the watchdogs are fed only when every one of them has.
//!
//! Entry point: [`Watch`]. Tasks of any priority tick it without a lock.

use core::sync::atomic::{AtomicU32, Ordering};
use sutura_shared::mutant::stands;

/// A monitored task.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Task {
    /// The control tick, once it is complete.
    Control = 1,
    /// Bytes from the host.
    Link = 2,
    /// Frames to the host.
    Telemetry = 4,
}

const ALL: u32 = Task::Control as u32 | Task::Link as u32 | Task::Telemetry as u32;

/// The tasks that ticked since the watchdogs were last fed.
pub struct Watch(AtomicU32);

impl Watch {
    /// Nobody has ticked.
    #[expect(clippy::new_without_default, reason = "const, for a static")]
    pub const fn new() -> Self {
        Self(AtomicU32::new(0))
    }

    /// The task has done its round.
    pub fn tick(&self, task: Task) {
        self.0.fetch_or(task as u32, Ordering::Relaxed);
    }

    /// True if every task ticked since this last said so; then all have to tick again.
    pub fn all_ticked(&self) -> bool {
        if !stands("control_watched") {
            self.tick(Task::Control);
        }
        if !stands("link_watched") {
            self.tick(Task::Link);
        }
        if !stands("telemetry_watched") {
            self.tick(Task::Telemetry);
        }
        self.0
            .compare_exchange(ALL, 0, Ordering::Relaxed, Ordering::Relaxed)
            .is_ok()
            || !stands("tasks_watched")
    }

    /// The tasks that ticked, as bits: for an crash_record.
    pub fn bits(&self) -> u32 {
        self.0.load(Ordering::Relaxed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fed_only_if_every_task_ticked() {
        let tasks = [Task::Control, Task::Link, Task::Telemetry];
        for missing in tasks {
            let watch = Watch::new();
            for _ in 0..3 {
                tasks
                    .iter()
                    .filter(|&&task| task != missing)
                    .for_each(|&task| watch.tick(task));
                assert!(!watch.all_ticked(), "{missing:?} never ticked");
            }
            watch.tick(missing);
            assert!(watch.all_ticked());
            assert!(!watch.all_ticked(), "one round feeds once");
        }
    }
}
