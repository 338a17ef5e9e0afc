//! How soon an ordinary thread is let on after it was woken: the length of its turns.
//!
//! Entry point: [`shorten`]. Linux gives turns by deadlines, and whoever asks for short turns has the nearer ones: it is woken
//! beside busy programs within a tenth of a millisecond instead of one or two turns of theirs, without a larger share of the
//! processor. No right is needed; kernels before 6.12 ignore it.

use rustix::process::getpriority_process;

/// Length of a turn \[ns\]: the shortest that there is.
const TURN_NS: u64 = 100_000;

/// `struct sched_attr` of the kernel, as it was first.
#[repr(C)]
#[derive(Default)]
struct Attributes {
    size: u32,
    policy: u32,
    flags: u64,
    nice: i32,
    priority: u32,
    runtime_ns: u64,
    deadline_ns: u64,
    period_ns: u64,
}

/// Gives the calling thread, which is an ordinary one, short turns; as nice as it was. Says whether the system did.
#[allow(
    unsafe_code,
    reason = "no kept crate has this call; the proof is beside it"
)]
pub(super) fn shorten() -> bool {
    let attributes = Attributes {
        size: size_of::<Attributes>() as u32,
        policy: libc::SCHED_OTHER as u32,
        nice: getpriority_process(None).unwrap_or_default(),
        runtime_ns: TURN_NS,
        ..Attributes::default()
    };
    // SAFETY: the call has three arguments: thread 0, which is the calling one, a pointer, and no flags. The kernel reads
    // `size` bytes from the pointer, which are those of the live, initialised value above, laid out as the kernel's (repr(C),
    // no padding: 2 x 4, 8, 2 x 4, 3 x 8 bytes), and writes only that field if it does not know the size. Nothing is kept.
    let done = unsafe { libc::syscall(libc::SYS_sched_setattr, 0, &raw const attributes, 0) };
    if done != 0 {
        tracing::debug!(
            "turns keep their length: {}",
            std::io::Error::last_os_error()
        );
    }
    done == 0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_kernel_s_layout_has_48_bytes_and_the_thread_goes_on() {
        assert_eq!(size_of::<Attributes>(), 48);
        let nice = getpriority_process(None).ok();
        let asked = std::thread::spawn(shorten);
        // An old kernel or a sandbox may refuse.
        let _ = asked.join().expect("it returns");
        assert_eq!(getpriority_process(None).ok(), nice);
    }
}
