//! Memory that will be read soon is asked for before it is.

/// Values in a line of a cache.
pub(crate) const LINE: usize = 8;

/// Asks for the line of memory that a value lies in, without waiting for it: what is not in a cache any more, as after a while in which
/// the processor did other things, costs memory's bandwidth then instead of its latency. Changes nothing else; does nothing where a
/// processor has no such instruction.
#[inline(always)]
pub fn fetch_line(value: &f64) {
    #[cfg(target_arch = "x86_64")]
    safe_arch::prefetch_t0(value);
    #[cfg(not(target_arch = "x86_64"))]
    let _ = value;
}

/// Reads from the lines of memory that `values` lie in, which brings them into the caches: where many are asked for by [`fetch_line`]
/// with nothing to do meanwhile, a processor forgets those for which it has no room.
pub fn touch(values: &[f64]) {
    let read: f64 = values.iter().step_by(LINE).sum();
    std::hint::black_box(read);
}
