//! The reader of scenario files: what is right is taken as it is written, what is wrong is named with its place and limit.

#![allow(clippy::unwrap_used, reason = "a test")]

use miette::Diagnostic;
use proptest::prelude::*;
use std::path::Path;
use sutura_hil::scenario::{Scenario, built_in};
use sutura_host::scene::{Document, SceneError};

/// Placeholders: a number, what stands before the fault's kind, and the kind.
fn file(seconds: f64, hz: f64, at_ms: f64, fault: &str) -> String {
    format!(
        "about = \"A test\"\nseconds = {seconds:?}\n\n[host]\nmodel = \"wall\"\nhz = {hz:?}\n\n\
         [[fault]]\nat_ms = {at_ms:?}\n{fault}\n\n[expect]\nforce_n = 4.0\n\n[mutant]\noff = [\"horizon\"]\n"
    )
}

fn read(text: &str) -> Result<Scenario, SceneError> {
    Scenario::read(&Document::embedded("my.toml", Path::new(""), text), "my")
}

/// File and line, message and help, as a report has them.
fn complaint(text: &str) -> String {
    let error = read(text).expect_err("wrong");
    let label = error.labels().and_then(|mut labels| labels.next());
    let span = *label.expect("a place").inner();
    let source = error.source_code().expect("the file");
    let place = source.read_span(&span, 0, 0).expect("within the file");
    let help = error.help().map(|help| help.to_string());
    let (name, line) = (place.name().unwrap_or_default(), place.line() + 1);
    format!("{name}:{line}: {error} ({})", help.unwrap_or_default())
}

#[test]
fn every_scenario_of_the_project_is_right_and_has_a_mutant_and_something_to_show() {
    let all = built_in().unwrap_or_else(|error| panic!("{error:?}"));
    assert!(all.len() >= 40, "{}", all.len());
    for scenario in all {
        assert!(!scenario.mutant.is_empty(), "{}", scenario.name);
        let shows = scenario.expect.felt_n.is_some() || scenario.expect.force_n == Some(0.0);
        assert!(shows, "{}: nothing need be felt", scenario.name);
    }
}

/// File, line, key, limit; or the nearest word that is known.
#[test]
fn a_complaint_names_file_line_key_and_limit() {
    for (text, parts) in [
        (
            file(2.0, 2000.0, 500.0, "stall = {}"),
            &["my.toml:6", "hz = 2000", "from 1 to 1000 Hz"][..],
        ),
        (
            file(2.0, 100.0, 2500.0, "stall = {}"),
            &["my.toml:9", "at_ms = 2500", "from 0 to 2000 ms"],
        ),
        (
            file(2.0, 100.0, 500.0, "loss = { share = 1.5 }"),
            &["my.toml:10", "share = 1.5", "from 0 to 1"],
        ),
        (
            file(2.0, 100.0, 500.0, "los = { share = 0.5 }"),
            &["my.toml:10", "unknown key `los`", "did you mean `loss`"],
        ),
        (
            file(2.0, 100.0, 500.0, "loss = { share = 0.5, sahre = 1 }"),
            &["my.toml:10", "unknown key `sahre`", "`share`"],
        ),
        (
            file(2.0, 100.0, 500.0, ""),
            &["my.toml:8", "0 kinds of fault", "there must be one"],
        ),
        (
            file(2.0, 100.0, 500.0, "stall = {}\ncable_pulled = {}"),
            &["my.toml:8", "2 kinds of fault"],
        ),
        (
            file(2.0, 100.0, 500.0, "host_killed = {}\nway = \"up\""),
            &["my.toml:11", "has no `way`"],
        ),
        (
            file(
                2.0,
                100.0,
                500.0,
                "solver_wedged = { contacts = \"repeats\" }",
            ),
            &["my.toml:10", "`repeats`", "did you mean `repeat`"],
        ),
        (
            file(2.0, 100.0, 500.0, "host_killed = {}\nzero_within_ms = 1500"),
            &[
                "my.toml:11",
                "zero_within_ms",
                "the fault lasts 1500 ms only",
            ],
        ),
        (
            file(2.0, 100.0, 500.0, "stall = {}").replace("horizon", "horizont"),
            &["my.toml:16", "unknown guard `horizont`"],
        ),
        (
            file(2.0, 100.0, 500.0, "stall = {}").replace("\"wall\"", "\"tissue\""),
            &["my.toml:5", "missing key `scene`"],
        ),
    ] {
        let said = complaint(&text);
        for part in parts {
            assert!(said.contains(part), "{part} in:\n{said}");
        }
    }
}

proptest! {
    #[test]
    fn numbers_within_their_limits_are_taken_and_others_are_named(
        seconds in -1.0_f64..700.0,
        hz in -10.0_f64..1100.0,
        at_share in -0.2_f64..1.2,
        share in -0.5_f64..1.5,
    ) {
        let at_ms = (at_share * seconds * 1e3).round();
        let text = file(seconds, hz, at_ms, &format!("loss = {{ share = {share:?} }}"));
        let end = (seconds * 1e3).round();
        let flaws = [
            ("seconds", (0.01..=600.0).contains(&seconds)),
            ("at_ms", (0.0..=end).contains(&at_ms)),
            ("share", (0.0..=1.0).contains(&share)),
            ("hz", (1.0..=1000.0).contains(&hz)),
        ];
        match flaws.iter().find(|(_, right)| !right) {
            None => {
                let scenario = read(&text).unwrap();
                prop_assert_eq!(scenario.ticks as f64, end);
                prop_assert_eq!(scenario.faults[0].at as f64, at_ms);
                prop_assert_eq!(scenario.host.hz, hz);
            }
            Some((key, _)) => {
                let said = complaint(&text);
                prop_assert!(said.contains(&format!("{key} = ")), "{} in {}", key, said);
                prop_assert!(said.contains("must be from"), "{}", said);
            }
        }
    }

    /// Whatever a hand on the keyboard does to a file: it is read, or refused with a place; nothing panics.
    #[test]
    fn broken_files_are_refused_and_nothing_worse(
        place in 0_usize..260,
        length in 0_usize..12,
        with in "[ -~\\n]{0,6}",
    ) {
        let mut text = file(2.0, 100.0, 500.0, "bursts = { lost_ms = 30, every_ms = 100 }\nfor_ms = 300");
        let from = place.min(text.len());
        let to = (from + length).min(text.len());
        text.replace_range(from..to, &with);
        if let Err(error) = read(&text) {
            prop_assert!(matches!(error, SceneError::Flaw(_)));
            prop_assert!(!complaint(&text).is_empty());
        }
    }
}
