//! Fault scenarios with the console in a process of its own, by the wall clock: a short form of
//! `cargo xtask hil --console virtual`. Times are counted in the console's ticks.
#![cfg(unix)]
#![allow(clippy::unwrap_used, reason = "tests")]

use sutura_hil::scenario::built_in;
use sutura_hil::scenario::processes::Processes;
use sutura_hil::scenario::suite::{Case, Extent, MutantVerdict};

#[test]
fn killed_hosts_and_reset_consoles_are_survived_and_mutants_are_not() {
    let processes = Processes::new(env!("CARGO_BIN_EXE_sutura").into()).unwrap();
    let extent = Extent {
        mutants: true,
        twice: false,
    };
    let some = ["host-killed-100hz", "console-reset"];
    let all = built_in().unwrap_or_else(|error| panic!("{error:?}"));
    for scenario in all.iter().filter(|s| some.contains(&s.name.as_str())) {
        let case = Case::run(scenario, &processes, extent);
        assert!(case.is_met(), "{case:#?}");
        assert!(matches!(case.mutant, MutantVerdict::Caught(_)), "{case:#?}");
    }
}
