//! Every scenario on the shared simulation, twice, and its mutant: the short form of `cargo xtask hil`.

#![allow(clippy::unwrap_used, reason = "a test")]

use sutura_hil::scenario::built_in;
use sutura_hil::scenario::suite::{Case, Extent, MutantVerdict, Native, Verdict};

#[test]
fn every_scenario_is_met_twice_with_the_same_bits_and_every_mutant_is_caught() {
    let extent = Extent {
        mutants: true,
        twice: true,
    };
    let mut wrong = Vec::new();
    for scenario in built_in().unwrap_or_else(|error| panic!("{error:?}")) {
        let case = Case::run(&scenario, &Native, extent);
        let Verdict::Ran(outcome) = &case.verdict else {
            panic!("{}: {:?}", case.name, case.verdict);
        };
        let unmet: Vec<_> = outcome.checks.iter().filter(|check| !check.met).collect();
        if !unmet.is_empty() {
            wrong.push(format!("{}: {unmet:#?}", case.name));
        }
        if case.repeats != Some(true) {
            wrong.push(format!("{}: a second run gave other bits", case.name));
        }
        match &case.mutant {
            MutantVerdict::Caught(_) => {}
            other => wrong.push(format!("{} without {:?}: {other:?}", case.name, case.off)),
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
