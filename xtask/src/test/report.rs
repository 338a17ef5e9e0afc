//! What ran, how long it took and what failed: steps, and the tests within them. Entry points: [`Report::step`],
//! [`Report::print`].

use super::junit::Case;
use crate::run::Tool;
use anyhow::{Result, bail};
use std::collections::BTreeMap;
use std::fmt::Write;
use std::time::Instant;

/// How many tests the list of the slowest has.
const SLOWEST: usize = 20;

/// What a step spends its time on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    /// Installs, or finds, what the checks need.
    Tools,
    /// Compiles, with what looks at the result.
    Build,
    /// Looks at files.
    Checks,
    /// Runs tests.
    Tests,
}

impl Kind {
    fn word(self) -> &'static str {
        match self {
            Self::Tools => "tools",
            Self::Build => "build",
            Self::Checks => "checks",
            Self::Tests => "tests",
        }
    }
}

/// A step that ended.
struct Step {
    kind: Kind,
    name: String,
    seconds: f64,
    /// Why it failed, and how to run it again.
    failure: Option<String>,
    failed_tests: Vec<String>,
}

/// All steps so far, and all tests within them.
#[derive(Default)]
pub struct Report {
    steps: Vec<Step>,
    passed: u64,
    cases: Vec<Case>,
    /// Failed tests of the step that runs.
    failed_now: Vec<String>,
    /// Those that a runner counted but did not name.
    unnamed_now: u64,
    failed: u64,
}

impl Report {
    /// Runs one step; a failure is kept and told at the end.
    pub fn step(
        &mut self,
        kind: Kind,
        name: &str,
        again: &str,
        run: impl FnOnce(&mut Self) -> Result<()>,
    ) -> bool {
        eprintln!("\n== {name}");
        let start = Instant::now();
        let result = run(self);
        let seconds = start.elapsed().as_secs_f64();
        let ok = result.is_ok();
        let word = if ok { "ok" } else { "FAILED" };
        if let Err(error) = &result {
            eprintln!("error: {error:#}");
        }
        eprintln!("== {name}: {word}, {seconds:.1} s");
        let failed_tests = std::mem::take(&mut self.failed_now);
        let counted = failed_tests.len() as u64;
        let unnamed = std::mem::take(&mut self.unnamed_now).saturating_sub(counted);
        // A step that fails without a failed test counts as one.
        self.failed += (counted + unnamed).max(u64::from(!ok));
        self.steps.push(Step {
            kind,
            name: name.to_owned(),
            seconds,
            failure: result
                .err()
                .map(|error| format!("{error:#}; run it again with\n    {again}")),
            failed_tests,
        });
        ok
    }

    /// Runs programs as one step, those after a failed one, too.
    pub fn tools(&mut self, kind: Kind, name: &str, tools: impl IntoIterator<Item = Tool>) -> bool {
        let tools: Vec<Tool> = tools.into_iter().collect();
        let again: Vec<String> = tools.iter().map(Tool::shown).collect();
        self.step(kind, name, &again.join(" && "), |report| {
            let mut wrong = Vec::new();
            for tool in tools {
                let ran = tool.run_lines(|line| {
                    report.read(line);
                    eprintln!("{line}");
                });
                if let Err(error) = ran {
                    wrong.push(format!("{error:#}"));
                }
            }
            if !wrong.is_empty() {
                bail!("{}", wrong.join("; "));
            }
            Ok(())
        })
    }

    /// Reads a line of the standard test harness: `test a::b ... FAILED` and `test result: ok. 3 passed; 0 failed; ..`.
    pub fn read(&mut self, line: &str) {
        let Some(rest) = line.trim_start().strip_prefix("test ") else {
            return;
        };
        if let Some(name) = rest.strip_suffix(" ... FAILED") {
            self.failed_now.push(name.to_owned());
        }
        let Some(result) = rest.strip_prefix("result: ") else {
            return;
        };
        let mut before = "";
        for word in result.split_whitespace() {
            let count = before.parse().unwrap_or(0);
            match word {
                "passed;" => self.passed += count,
                "failed;" => self.unnamed_now += count,
                _ => {}
            }
            before = word;
        }
    }

    /// Takes in the tests that a runner names one by one.
    pub fn take(&mut self, cases: Vec<Case>) {
        for case in cases {
            if case.failed {
                self.failed_now.push(case.to_string());
            } else {
                self.passed += 1;
            }
            self.cases.push(case);
        }
    }

    /// Whether nothing failed.
    pub fn is_good(&self) -> bool {
        self.failed == 0
    }

    /// Tests that passed; tests that failed, and steps that failed without one.
    pub fn counts(&self) -> (u64, u64) {
        (self.passed, self.failed)
    }

    /// Where the time went, the slowest tests, and all that failed.
    pub fn print(&self) -> String {
        let mut text = String::new();
        // Writing into a string cannot fail.
        let _ = self
            .write_times(&mut text)
            .and_then(|()| self.write_failures(&mut text));
        text
    }

    fn write_times(&self, text: &mut String) -> std::fmt::Result {
        let all: f64 = self.steps.iter().map(|step| step.seconds).sum();
        writeln!(text, "{} steps in {:.1} min", self.steps.len(), all / 60.0)?;
        let mut kinds: BTreeMap<Kind, Vec<&Step>> = BTreeMap::new();
        for step in &self.steps {
            kinds.entry(step.kind).or_default().push(step);
        }
        for (kind, mut steps) in kinds {
            let sum: f64 = steps.iter().map(|step| step.seconds).sum();
            writeln!(text, "{:>9.1} s  {}", sum, kind.word())?;
            steps.sort_by(|a, b| b.seconds.total_cmp(&a.seconds));
            for step in steps {
                writeln!(text, "{:>9.1} s      {}", step.seconds, step.name)?;
            }
        }
        if self.cases.is_empty() {
            return Ok(());
        }
        let mut suites: BTreeMap<&str, (usize, f64)> = BTreeMap::new();
        for case in &self.cases {
            let suite = suites.entry(&case.suite).or_default();
            suite.0 += 1;
            suite.1 += case.seconds;
        }
        let mut suites: Vec<_> = suites.into_iter().collect();
        suites.sort_by(|a, b| b.1.1.total_cmp(&a.1.1));
        writeln!(
            text,
            "\nsuites, each test's time added up (several run at once)"
        )?;
        for (name, (count, seconds)) in suites {
            writeln!(text, "{seconds:>9.1} s  {name}, {count} tests")?;
        }
        let mut slowest: Vec<&Case> = self.cases.iter().collect();
        slowest.sort_by(|a, b| b.seconds.total_cmp(&a.seconds));
        writeln!(text, "\nslowest tests")?;
        for case in slowest.into_iter().take(SLOWEST) {
            writeln!(text, "{:>9.1} s  {case}", case.seconds)?;
        }
        Ok(())
    }

    fn write_failures(&self, text: &mut String) -> std::fmt::Result {
        let failed: Vec<&Step> = self.steps.iter().filter(|s| s.failure.is_some()).collect();
        if failed.is_empty() {
            return Ok(());
        }
        writeln!(text, "\nfailed")?;
        for step in failed {
            let why = step.failure.as_deref().unwrap_or_default();
            writeln!(text, "step `{}`: {why}", step.name)?;
            for test in &step.failed_tests {
                writeln!(text, "    test {test}")?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_of_several_runners_add_up() {
        let mut report = Report::default();
        report.step(Kind::Tests, "both", "both", |report| {
            report.read("running 5 tests");
            report.read("test result: ok. 3 passed; 0 failed; 1 ignored; 0 measured; 0 filtered out; finished in 0.00s");
            report.read("test a::b ... ok");
            report.read("test c::d ... FAILED");
            report.read(
                "test result: FAILED. 12 passed; 2 failed; 0 ignored; 0 measured; 0 filtered out",
            );
            bail!("failed")
        });
        assert_eq!(report.counts(), (15, 2));
        assert!(report.print().contains("test c::d"), "{}", report.print());
    }

    #[test]
    fn all_steps_run_and_all_failures_are_listed_with_how_to_run_them_again() {
        let mut report = Report::default();
        let case = |name: &str, failed| Case {
            suite: "sutura::all".into(),
            name: name.into(),
            seconds: 1.5,
            failed,
        };
        let tool = |words: &str| [Tool::new(words)];
        assert!(!report.tools(Kind::Checks, "nothing", tool("false --x")));
        assert!(report.tools(Kind::Checks, "something", tool("true")));
        report.step(Kind::Tests, "suite", "cargo suite", |report| {
            report.take(vec![case("good", false), case("bad", true)]);
            bail!("a test failed")
        });
        assert_eq!(report.counts(), (1, 2));
        assert!(!report.is_good());
        let text = report.print();
        for words in [
            "step `nothing`",
            "false --x",
            "cargo suite",
            "test sutura::all bad",
            "3 steps",
            "sutura::all, 2 tests",
        ] {
            assert!(text.contains(words), "no {words} in:\n{text}");
        }
        assert!(!text.contains("step `something`"), "{text}");
    }

    #[test]
    fn a_failed_step_without_a_test_counts_as_one() {
        let mut report = Report::default();
        report.step(Kind::Build, "a", "a", |_| bail!("no"));
        report.step(Kind::Build, "b", "b", |_| Ok(()));
        assert_eq!(report.counts(), (0, 1));
    }
}
