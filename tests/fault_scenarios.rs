//! Fault scenarios with the console in a process of its own, by the wall clock: a short form of
//! `cargo xtask hil --console virtual`. Times and counts are asserted in lockstep, by the tests of `hil`; here only what no
//! scheduler can change.
#![cfg(unix)]
#![allow(clippy::unwrap_used, reason = "tests")]

use sutura_hil::scenario::built_in;
use sutura_hil::scenario::processes::Processes;
use sutura_hil::scenario::suite::{Case, Extent, MutantVerdict, Verdict};

/// Checks of a scenario that hold however late host and console are.
const AT_ANY_PACE: [&str; 4] = ["force_n", "mode", "faults", "wrong frames of the console"];

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
        let Verdict::Ran(outcome) = &case.verdict else {
            panic!("{case:#?}");
        };
        for what in AT_ANY_PACE {
            let mut checks = outcome.checks.iter();
            let check = checks.find(|check| check.what == what);
            assert!(check.is_some_and(|check| check.met), "{what}: {case:#?}");
        }
        // A machine that is late only makes more of a mutant's checks fail.
        assert!(matches!(case.mutant, MutantVerdict::Caught(_)), "{case:#?}");
    }
}
