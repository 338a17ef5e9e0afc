//! Guards that this image goes without: it is run by tests that have to notice. No console has it.
//!
//! Entry point: [`without`]. Whoever runs it sets the switch, in RAM that start-up leaves alone, before the first instruction.

use core::mem::MaybeUninit;
use sutura_shared::control::Guards;
use sutura_shared::link::Checks;
use sutura_shared::mutant::{stands, take_out};
use sutura_shared::simulated_console::Without;

/// As `sutura_shared::mutant::switch` gives it.
#[unsafe(no_mangle)]
#[unsafe(link_section = ".uninit.SUTURA_MUTANT")]
static mut SUTURA_MUTANT: MaybeUninit<[u32; 2]> = MaybeUninit::uninit();

/// Takes out the guard that the switch names; where that is one of the control loop or the link: all but it.
pub fn without() -> Without {
    // SAFETY: any bits make integers, and a volatile read takes what RAM holds; nobody writes the static while the image runs.
    take_out(unsafe {
        (&raw const SUTURA_MUTANT)
            .cast::<[u32; 2]>()
            .read_volatile()
    });
    let mut without = Without::default();
    for name in Guards::NAMES.into_iter().chain(Checks::NAMES) {
        if !stands(name) {
            without.switch_off(name);
        }
    }
    without
}
