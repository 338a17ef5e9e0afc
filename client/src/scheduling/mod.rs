//! What the threads of a session ask of the system: to be woken in time, before others, and not to wait for memory.
//!
//! Entry points: [`Duty::begin`] at the start of a thread, [`LockedMemory::ask`] for the process, [`ordinary`] for a thread
//! that computes for long beside them. Nothing here fails: what the user may not have is not had, and
//! [`Duty::granted`] says so. Only Linux is asked.
//!
//! # Why round robin, low, and given up
//!
//! `SCHED_RR` at priorities of 10 to 12 stands before every ordinary program and behind the kernel's own threads (50). The one
//! who waits for the shortest time goes first: the console's tick, then the link, then the solver. `SCHED_DEADLINE` would
//! bound each by itself, but holds a solve that takes longer than planned until its next period, also on an idle
//! machine, and no limit gives it to an ordinary user. `RLIMIT_RTTIME` ends the process with `SIGXCPU`. Hence each thread
//! watches itself: one that computed for more than [`MOST`] of a [`WINDOW`] is ordinary until it has rested for
//! [`REST`]. A solver that never sleeps, on one of two cores, thus holds that core for a tenth of a second at most
//! between two seconds in which it shares; in one solve that never ends it holds one core, and the kernel keeps a
//! twentieth of that free for others (`sched_rt_runtime_us`, the fair server). Nothing is pinned to a core: on two, what is pinned waits for
//! whatever else is there while the other core is free.
//!
//! A thread that may not have this, or that gave it up, asks for short turns (`slice`), which is everybody's right.

mod share;
#[cfg(target_os = "linux")]
mod slice;
#[cfg(target_os = "linux")]
mod system;
#[cfg(not(target_os = "linux"))]
#[path = "elsewhere.rs"]
mod system;

use share::{Change, Share};
pub use share::{MOST, REST, WINDOW};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Instant;

/// What a thread does in a session; the one with the shortest time to wait goes first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// Ticks a virtual console.
    Console,
    /// Reads from or writes to the line.
    Link,
    /// Solves.
    Solver,
}

impl Role {
    /// Static priority under `SCHED_RR`, 1 to 99.
    pub fn priority(self) -> u8 {
        match self {
            Role::Console => 12,
            Role::Link => 11,
            Role::Solver => 10,
        }
    }
}

/// What a thread got of the system.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Granted {
    /// It did not ask.
    #[default]
    NotAsked,
    /// It is scheduled like every other program.
    Ordinary,
    /// It goes before ordinary programs.
    RealTime,
}

impl Granted {
    /// Stable word for it.
    pub fn word(self) -> &'static str {
        match self {
            Granted::NotAsked => "not-asked",
            Granted::Ordinary => "ordinary",
            Granted::RealTime => "real-time",
        }
    }
}

/// The calling thread's place among others, for as long as it lives.
#[derive(Debug)]
pub struct Duty {
    role: Role,
    granted: Granted,
    /// While it has more than others.
    watch: Option<Watch>,
}

#[derive(Debug)]
struct Watch {
    share: Share,
    since: Instant,
    computed: std::time::Duration,
}

impl Duty {
    /// Asks for the calling thread: timers to the point, and real-time scheduling.
    ///
    /// Threads that it starts inherit what it has: those that compute for long call [`ordinary`].
    pub fn begin(role: Role) -> Duty {
        system::sharpen_timers();
        let granted = if system::real_time(role.priority()) {
            Granted::RealTime
        } else {
            Granted::Ordinary
        };
        let watch = (granted == Granted::RealTime).then(|| Watch {
            share: Share::default(),
            since: Instant::now(),
            computed: system::computing_time(),
        });
        Duty {
            role,
            granted,
            watch,
        }
    }

    /// What it got when it asked.
    pub fn granted(&self) -> Granted {
        self.granted
    }

    /// To be called in every round: gives way to others after it has not rested for too long, and comes back.
    ///
    /// Whether it goes before ordinary programs from now on; costs a look at the clock.
    pub fn look(&mut self) -> bool {
        let Some(watch) = &mut self.watch else {
            return false;
        };
        let wall = watch.since.elapsed();
        if wall < WINDOW {
            return watch.share.is_held();
        }
        let computed = system::computing_time();
        let change = watch
            .share
            .note(wall, computed.saturating_sub(watch.computed));
        watch.since = Instant::now();
        watch.computed = computed;
        match change {
            Change::None => {}
            Change::GiveWay => {
                tracing::debug!(
                    "{:?} does not rest: it gives way to other programs",
                    self.role
                );
                system::give_way();
            }
            Change::Return => {
                system::real_time(self.role.priority());
            }
        }
        watch.share.is_held()
    }

    /// How often it gave way so far.
    pub fn gave_way(&self) -> u64 {
        self.watch.as_ref().map_or(0, |watch| watch.share.given())
    }
}

/// Makes the calling thread an ordinary one whatever the thread that started it is: for work that may take long.
pub fn ordinary() {
    system::ordinary();
}

/// All of this process's memory stays in RAM while this lives.
#[derive(Debug)]
pub struct LockedMemory(());

impl LockedMemory {
    /// None if the user's limit is too small for it, or the system has no such thing.
    ///
    /// With a limit only what is there now is locked: otherwise a later allocation could meet the limit and fail.
    pub fn ask() -> Option<LockedMemory> {
        Self::ask_of(system::lock_memory)
    }

    fn ask_of(lock: impl FnOnce() -> bool) -> Option<LockedMemory> {
        let mut holders = holders();
        if !lock() {
            return None;
        }
        *holders += 1;
        Some(LockedMemory(()))
    }
}

/// How many hold the process's memory: the last one lets it go.
fn holders() -> MutexGuard<'static, usize> {
    static HOLDERS: Mutex<usize> = Mutex::new(0);
    HOLDERS.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Drop for LockedMemory {
    fn drop(&mut self) {
        let mut holders = holders();
        *holders -= 1;
        if *holders == 0 {
            system::unlock_memory();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_waits_for_the_shortest_time_goes_first() {
        assert!(Role::Console.priority() > Role::Link.priority());
        assert!(Role::Link.priority() > Role::Solver.priority());
        // Below the kernel's own threads, above every ordinary one.
        for role in [Role::Console, Role::Link, Role::Solver] {
            assert!((1..50).contains(&role.priority()), "{role:?}");
        }
    }

    #[test]
    fn asking_never_fails_and_says_what_was_got() {
        let asked = std::thread::spawn(|| {
            let mut duty = Duty::begin(Role::Solver);
            let held = duty.look();
            let got = duty.granted();
            ordinary();
            (held, got, duty.gave_way())
        });
        let (held, got, gave_way) = asked.join().expect("a thread");
        assert_ne!(got, Granted::NotAsked);
        assert_eq!(held, got == Granted::RealTime);
        assert_eq!(gave_way, 0);
        drop(LockedMemory::ask());
    }

    /// Who may not lock memory is told so, however often, and is in nobody's way.
    #[test]
    fn memory_that_may_not_be_locked_is_not_waited_for() {
        let (told, answer) = std::sync::mpsc::channel();
        std::thread::spawn(move || {
            let refused = [(); 2].map(|()| LockedMemory::ask_of(|| false));
            drop(LockedMemory::ask());
            told.send(refused.iter().all(Option::is_none))
        });
        let minute = std::time::Duration::from_secs(60);
        assert_eq!(answer.recv_timeout(minute), Ok(true));
    }

    /// A session that ends takes nothing from another in the same process.
    #[cfg(target_os = "linux")]
    #[test]
    fn memory_stays_locked_until_the_last_one_lets_go() {
        let is_locked = || {
            let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
            let kb = status.lines().find_map(|line| line.strip_prefix("VmLck:"));
            kb.is_some_and(|kb| kb.trim() != "0 kB")
        };
        let (Some(first), Some(second)) = (LockedMemory::ask(), LockedMemory::ask()) else {
            return;
        };
        drop(first);
        assert!(is_locked());
        drop(second);
    }
}
