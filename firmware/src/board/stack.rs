//! The stack's own region of RAM, and how much of it was never used: the start-up code paints it, and the
//! paint that is left tells.

use core::ops::Range;

unsafe extern "C" {
    static _stack_end: u32;
    static _stack_start: u32;
}

/// Addresses of the stack, from `memory.x`.
pub fn region() -> Range<usize> {
    (&raw const _stack_end).addr()..(&raw const _stack_start).addr()
}

/// Bytes at the far end of the stack that nothing has written since boot.
pub fn unused_bytes() -> u32 {
    let painted = |address: &usize| {
        // SAFETY: an aligned word of the stack's region, which holds nothing else. The walk stops at the
        // first word that is not paint, which lies below everything that is live.
        let word = unsafe { (*address as *const u32).read_volatile() };
        word == cortex_m_rt::STACK_PAINT_VALUE
    };
    4 * region().step_by(4).take_while(painted).count() as u32
}
