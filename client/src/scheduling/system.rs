//! What Linux is asked.

use rustix::mm::MlockAllFlags;
use rustix::process::{Resource, getpriority_process, getrlimit};
use rustix::thread::CapabilitySet;
use rustix::time::{ClockId, clock_gettime};
use std::num::NonZeroU64;
use std::time::Duration;
use thread_priority::{
    NormalThreadSchedulePolicy, RealtimeThreadSchedulePolicy, ThreadPriority, ThreadPriorityValue,
    ThreadSchedulePolicy, set_thread_priority_and_policy, thread_native_id, thread_schedule_policy,
};

/// Ordinary threads are woken up to 50 us after their time, so that the kernel wakes several at once.
const SLACK_NS: NonZeroU64 = NonZeroU64::MIN;
/// The kernel kills a process of which a real-time thread computed for so long without a rest; a solve may.
const LEAST_RTTIME_US: u64 = 2_000_000;
const NORMAL: ThreadSchedulePolicy =
    ThreadSchedulePolicy::Normal(NormalThreadSchedulePolicy::Other);

pub(super) fn sharpen_timers() {
    if let Err(error) = rustix::thread::set_current_timer_slack(Some(SLACK_NS)) {
        tracing::debug!("timers keep their slack: {error}");
    }
}

/// Whether the calling thread goes before ordinary ones from now on.
pub(super) fn real_time(priority: u8) -> bool {
    if let Some(limit) = getrlimit(Resource::Rttime).current
        && limit < LEAST_RTTIME_US
    {
        tracing::debug!("no real-time scheduling: a limit of {limit} us would end this process");
        return false;
    }
    let policy = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::RoundRobin);
    let asked = ThreadPriorityValue::try_from(priority)
        .map(ThreadPriority::Crossplatform)
        .map_err(|reason| reason.to_string())
        .and_then(|priority| {
            set_thread_priority_and_policy(thread_native_id(), priority, policy)
                .map_err(|error| error.to_string())
        });
    if let Err(reason) = &asked {
        tracing::debug!("no real-time scheduling at priority {priority}: {reason}");
    }
    asked.is_ok()
}

/// Makes the calling thread an ordinary one, as nice as it was.
pub(super) fn ordinary() {
    if !matches!(
        thread_schedule_policy(),
        Ok(ThreadSchedulePolicy::Realtime(_))
    ) {
        return;
    }
    let priority = as_nice_as(getpriority_process(None).unwrap_or_default());
    if let Err(error) = set_thread_priority_and_policy(thread_native_id(), priority, NORMAL) {
        tracing::debug!("still a real-time thread: {error}");
    }
}

/// What stands for this niceness among ordinary threads, -20 to 19: whoever made a thread nicer may not undo it.
fn as_nice_as(nice: i32) -> ThreadPriority {
    // The crate spreads 0..=99 over 39..=0 steps above -20 and cuts off what is behind the point: the middle of a step.
    let value = (99.0 * (1.0 - (f64::from(nice) + 20.5) / 39.0)).round();
    let value = ThreadPriorityValue::try_from(value.clamp(0.0, 99.0) as u8);
    value.map_or(ThreadPriority::Min, ThreadPriority::Crossplatform)
}

/// Time that the calling thread has computed.
pub(super) fn computing_time() -> Duration {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    Duration::new(
        time.tv_sec.unsigned_abs(),
        u32::try_from(time.tv_nsec).unwrap_or_default(),
    )
}

pub(super) fn lock_memory() -> bool {
    let boundless = getrlimit(Resource::Memlock).current.is_none()
        || rustix::thread::capabilities(None)
            .is_ok_and(|sets| sets.effective.contains(CapabilitySet::IPC_LOCK));
    let flags = if boundless {
        MlockAllFlags::CURRENT | MlockAllFlags::FUTURE
    } else {
        MlockAllFlags::CURRENT
    };
    let locked = rustix::mm::mlockall(flags);
    if let Err(error) = &locked {
        tracing::debug!("memory is not locked: {error}");
    }
    locked.is_ok()
}

pub(super) fn unlock_memory() {
    if let Err(error) = rustix::mm::munlockall() {
        tracing::debug!("memory stays locked: {error}");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thread_stays_as_nice_as_it_was() {
        for nice in -20..=19 {
            let asked = as_nice_as(nice).to_posix(NORMAL);
            assert_eq!(asked, Ok(nice));
        }
    }
}
