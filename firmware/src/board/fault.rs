//! Every way in which the program can go wrong ends here: torque off first, then an crash_record for the next
//! boot, then the board's `end`.

use crate::crash_record::{Age, CrashRecord, Kind, place_of};
use core::mem::MaybeUninit;
use core::panic::PanicInfo;
use cortex_m_rt::exception;
use sutura_shared::mutant::stands;

#[unsafe(link_section = ".uninit.CRASH_RECORD")]
static mut CRASH_RECORD: MaybeUninit<[u32; 3]> = MaybeUninit::uninit();

/// Leaves an crash_record and ends the program. The torque must be off already.
pub fn bury(crash_record: CrashRecord) -> ! {
    cortex_m::interrupt::disable();
    let words = crash_record.to_words(Age::New);
    if stands("epitaph") {
        // SAFETY: interrupts are off and this never returns: nobody else reads or writes the static.
        unsafe {
            (&raw mut CRASH_RECORD)
                .cast::<[u32; 3]>()
                .write_volatile(words)
        };
    }
    super::end(crash_record)
}

/// Reads the crash record that no host has been told of, if any, and keeps it; for use in the initialisation, once.
pub fn exhume() -> Option<(CrashRecord, Age)> {
    let place = (&raw mut CRASH_RECORD).cast::<[u32; 3]>();
    // SAFETY: only called before interrupts are enabled; any bits make an array of integers, and a
    // volatile read takes what the RAM holds.
    unsafe {
        let found = CrashRecord::from_words(place.read_volatile());
        let kept = found.filter(|_| stands("record_kept"));
        let kept = kept.map(|(crash_record, _)| crash_record.to_words(Age::Kept));
        place.write_volatile(kept.unwrap_or_default());
        found
    }
}

/// Forgets the crash record: a host has been told of it.
pub fn forget() {
    let place = (&raw mut CRASH_RECORD).cast::<[u32; 3]>();
    // SAFETY: the telemetry task alone calls this. A fault handler that interrupts it writes a record of its own and never comes
    // back: no half of the two is left.
    unsafe { place.write_volatile([0; 3]) };
}

#[panic_handler]
fn panic(info: &PanicInfo) -> ! {
    super::safe_state();
    let place = info
        .location()
        .map_or(0, |place| place_of(place.file(), place.line()));
    bury(CrashRecord {
        kind: Kind::Panic,
        place,
    })
}

/// Restores a stack before anything uses it: an overflown stack is what brings us here most likely.
#[unsafe(no_mangle)]
#[unsafe(naked)]
extern "C" fn HardFault() {
    core::arch::naked_asm!(
        "mrs r0, msp",
        "ldr r1, =_stack_start",
        "mov sp, r1",
        "b {handler}",
        handler = sym hard_fault,
    )
}

extern "C" fn hard_fault(stack_pointer: usize) -> ! {
    if stands("hard_fault_stops") {
        super::safe_state();
    }
    // The exception frame holds the program counter in its seventh word, unless the stack had overflown.
    let top = super::stack::region();
    let place = if top.contains(&stack_pointer) && top.contains(&(stack_pointer + 31)) {
        // SAFETY: aligned by the processor, inside the stack's region of RAM, never written again.
        unsafe { (stack_pointer as *const u32).add(6).read_volatile() }
    } else {
        0
    };
    bury(CrashRecord {
        kind: Kind::HardFault,
        place,
    })
}

#[exception]
unsafe fn DefaultHandler(number: i16) -> ! {
    if stands("exception_stops") {
        super::safe_state();
    }
    bury(CrashRecord {
        kind: Kind::Exception,
        place: number as u32,
    })
}
