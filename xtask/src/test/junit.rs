//! The report that the test runner leaves in JUnit's XML. Entry point: [`read`].

use anyhow::{Context, Result};
use std::fmt;
use std::path::Path;

/// One test.
#[derive(Debug, PartialEq)]
pub struct Case {
    /// The binary, as the runner calls it: `sutura-host::all`.
    pub suite: String,
    /// With its modules.
    pub name: String,
    /// How long it took \[s\].
    pub seconds: f64,
    /// Whether it failed, or was ended because it hung.
    pub failed: bool,
}

impl fmt::Display for Case {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}", self.suite, self.name)
    }
}

/// Reads a report.
///
/// # Errors
/// If there is none, or it is no JUnit report.
pub fn read(path: &Path) -> Result<Vec<Case>> {
    let text = std::fs::read_to_string(path)
        .with_context(|| format!("the runner left no report at {}", path.display()))?;
    parse(&text).with_context(|| format!("{} is no JUnit report", path.display()))
}

fn parse(text: &str) -> Result<Vec<Case>> {
    let document = roxmltree::Document::parse(text)?;
    let nodes = document.descendants();
    let cases = nodes.filter(|node| node.has_tag_name("testcase"));
    cases
        .map(|node| {
            let attribute = |name: &str| {
                let value = node.attribute(name);
                value.with_context(|| format!("a test case without {name}"))
            };
            Ok(Case {
                suite: attribute("classname")?.to_owned(),
                name: attribute("name")?.to_owned(),
                seconds: attribute("time")?.parse().context("a time")?,
                failed: node
                    .children()
                    .any(|child| child.has_tag_name("failure") || child.has_tag_name("error")),
            })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As cargo-nextest 0.9 writes it, shortened.
    const REPORT: &str = r#"<?xml version="1.0" encoding="UTF-8"?>
<testsuites name="nextest-run" tests="2" failures="1" errors="0" time="0.026">
    <testsuite name="xtask::bin/xtask" tests="2" disabled="0" errors="0" failures="1">
        <testcase name="locks::tests::named" classname="xtask::bin/xtask" timestamp="2026-01-01T00:00:00.000+00:00" time="0.008">
        </testcase>
        <testcase name="locks::tests::other" classname="xtask::bin/xtask" timestamp="2026-01-01T00:00:00.000+00:00" time="1.250">
            <failure message="thread panicked" type="test failure with exit code 101">here</failure>
        </testcase>
    </testsuite>
</testsuites>"#;

    #[test]
    fn cases_have_their_suite_their_time_and_their_verdict() {
        let cases = parse(REPORT).expect("a report");
        let short: Vec<_> = cases
            .iter()
            .map(|case| (case.seconds, case.failed))
            .collect();
        assert_eq!(short, [(0.008, false), (1.25, true)]);
        assert_eq!(cases[1].to_string(), "xtask::bin/xtask locks::tests::other");
    }

    #[test]
    fn what_is_no_report_is_refused() {
        assert!(parse("<testsuites><testcase/></testsuites>").is_err());
        assert!(read(Path::new("/nowhere/junit.xml")).is_err());
    }
}
