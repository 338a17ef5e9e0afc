//! What became of the scenarios: a table, a sentence, an object, JUnit XML.

use quick_junit::{NonSuccessKind, Report, TestCase, TestCaseStatus, TestSuite};
use serde_json::{Value, json};
use std::time::Duration;
use sutura_hil::scenario::ConsoleKind;
use sutura_hil::scenario::suite::{Case, MutantVerdict, Verdict};

/// A case as lines of the table; what was not met in full.
pub fn lines(case: &Case) -> String {
    let (outcome, counts) = match &case.verdict {
        Verdict::Ran(outcome) => {
            let met = outcome.checks.iter().filter(|check| check.met).count();
            let counts = format!("{met}/{}", outcome.checks.len());
            (if outcome.is_met() { "met" } else { "NOT MET" }, counts)
        }
        Verdict::Skipped(_) => ("skipped", "-".to_owned()),
        Verdict::Broken(_) => ("BROKEN", "-".to_owned()),
    };
    let repeats = match case.repeats {
        Some(true) => "same hash",
        Some(false) => "OTHER HASH",
        None => "",
    };
    let off = case.off.join("+");
    let mutant = match &case.mutant {
        MutantVerdict::Caught(_) => format!("{off}: caught"),
        MutantVerdict::Survived => format!("{off}: NOT CAUGHT"),
        MutantVerdict::Skipped => String::new(),
        MutantVerdict::Broken(_) => format!("{off}: BROKEN"),
    };
    let mut text = format!(
        "{:<30}{outcome:<9}{counts:<7}{repeats:<11}{mutant}\n",
        case.name
    );
    for reason in reasons(case) {
        text += &format!("    {reason}\n");
    }
    text
}

/// Why a case is not as it must be, or was skipped.
fn reasons(case: &Case) -> Vec<String> {
    let mut reasons = Vec::new();
    match &case.verdict {
        Verdict::Ran(outcome) => {
            let unmet = outcome.checks.iter().filter(|check| !check.met);
            let text = unmet.map(|check| {
                format!(
                    "{}: {} expected, {} found",
                    check.what, check.limit, check.found
                )
            });
            reasons.extend(text);
        }
        Verdict::Skipped(why) => reasons.push((*why).to_owned()),
        Verdict::Broken(error) => reasons.push(error.to_string()),
    }
    if case.repeats == Some(false) {
        reasons.push("a second run gave other bits".to_owned());
    }
    match &case.mutant {
        MutantVerdict::Survived => {
            reasons.push(format!(
                "without {} all is met, too",
                case.off.join(" and ")
            ));
        }
        MutantVerdict::Broken(error) => reasons.push(format!("the mutant: {error}")),
        MutantVerdict::Caught(_) | MutantVerdict::Skipped => {}
    }
    reasons
}

/// Counts over all cases.
#[derive(Default)]
pub struct Sums {
    scenarios: usize,
    skipped: usize,
    met: usize,
    expectations: usize,
    expectations_met: usize,
    mutants: usize,
    caught: usize,
    console_s: f64,
    wall_s: f64,
}

impl Sums {
    /// Of these cases.
    pub fn of(cases: &[Case]) -> Self {
        let mut sums = Sums::default();
        for case in cases {
            match &case.verdict {
                Verdict::Skipped(_) => {
                    sums.skipped += 1;
                    continue;
                }
                Verdict::Ran(outcome) => {
                    sums.met += usize::from(outcome.is_met() && case.repeats != Some(false));
                    sums.expectations += outcome.checks.len();
                    sums.expectations_met += outcome.checks.iter().filter(|c| c.met).count();
                    sums.console_s += outcome.ticks as f64 * 1e-3;
                    sums.wall_s += outcome.wall_s;
                }
                Verdict::Broken(_) => {}
            }
            sums.scenarios += 1;
            sums.mutants += usize::from(!matches!(case.mutant, MutantVerdict::Skipped));
            sums.caught += usize::from(matches!(case.mutant, MutantVerdict::Caught(_)));
        }
        sums
    }

    fn ratio(&self) -> f64 {
        self.console_s / self.wall_s.max(1e-9)
    }

    /// All of them in a sentence.
    pub fn sentence(&self, kind: ConsoleKind) -> String {
        format!(
            "{}: {} of {} scenarios met ({} of {} expectations), {} skipped; {} of {} mutants caught; {:.1} s of console \
             time, {:.1} times as fast as the clock",
            kind.word(),
            self.met,
            self.scenarios,
            self.expectations_met,
            self.expectations,
            self.skipped,
            self.caught,
            self.mutants,
            self.console_s,
            self.ratio(),
        )
    }
}

/// All as one object.
pub fn object(cases: &[Case], sums: &Sums, kind: ConsoleKind) -> Value {
    let case = |case: &Case| {
        let (outcome, checks, hash) = match &case.verdict {
            Verdict::Ran(outcome) => {
                let checks = outcome.checks.iter().map(|check| {
                    json!({ "what": check.what, "limit": check.limit, "found": check.found, "met": check.met })
                });
                let word = if outcome.is_met() { "met" } else { "not-met" };
                (
                    word,
                    checks.collect(),
                    Some(format!("{:016x}", outcome.hash)),
                )
            }
            Verdict::Skipped(_) => ("skipped", Vec::new(), None),
            Verdict::Broken(_) => ("broken", Vec::new(), None),
        };
        let (mutant, caught_by) = match &case.mutant {
            MutantVerdict::Caught(by) => ("caught", by.clone()),
            MutantVerdict::Survived => ("survived", Vec::new()),
            MutantVerdict::Skipped => ("skipped", Vec::new()),
            MutantVerdict::Broken(_) => ("broken", Vec::new()),
        };
        json!({
            "name": case.name,
            "about": case.about,
            "outcome": outcome,
            "expectations": checks,
            "trace_hash": hash,
            "repeats": case.repeats,
            "mutant": { "off": case.off, "outcome": mutant, "caught_by": caught_by },
            "reasons": reasons(case),
        })
    };
    json!({
        "console": kind.word(),
        "scenarios": sums.scenarios,
        "met": sums.met,
        "skipped": sums.skipped,
        "expectations": { "all": sums.expectations, "met": sums.expectations_met },
        "mutants": { "all": sums.mutants, "caught": sums.caught },
        "console_s": sums.console_s,
        "wall_s": sums.wall_s,
        "speed_ratio": sums.ratio(),
        "cases": cases.iter().map(case).collect::<Vec<_>>(),
        "status": if cases.iter().all(Case::is_met) { "ok" } else { "failed" },
    })
}

/// All as continuous integration reads it.
pub fn junit(cases: &[Case], kind: ConsoleKind) -> Report {
    let mut suite = TestSuite::new(format!("hil.{}", kind.word()));
    for case in cases {
        let mut status = TestCaseStatus::success();
        let failed = |message: String| {
            let mut status = TestCaseStatus::non_success(NonSuccessKind::Failure);
            status.set_message(message);
            status
        };
        let mut time = Duration::ZERO;
        match &case.verdict {
            Verdict::Ran(outcome) => {
                time = Duration::try_from_secs_f64(outcome.wall_s).unwrap_or_default();
                let unmet = outcome.checks.iter().filter(|check| !check.met);
                let unmet: Vec<_> = unmet
                    .map(|c| format!("{}: {} expected, {} found", c.what, c.limit, c.found))
                    .collect();
                if !unmet.is_empty() {
                    status = failed(unmet.join("\n"));
                } else if case.repeats == Some(false) {
                    status = failed("a second run gave other bits".to_owned());
                }
            }
            Verdict::Skipped(why) => {
                status = TestCaseStatus::skipped();
                status.set_message(*why);
            }
            Verdict::Broken(error) => {
                status = TestCaseStatus::non_success(NonSuccessKind::Error);
                status.set_message(error.to_string());
            }
        }
        let mut test = TestCase::new(case.name.as_str(), status);
        test.set_classname("scenario");
        test.set_time(time);
        suite.add_test_case(test);
        let status = match &case.mutant {
            MutantVerdict::Caught(_) => TestCaseStatus::success(),
            MutantVerdict::Skipped => continue,
            MutantVerdict::Survived => {
                failed("all expectations are met without the guard".to_owned())
            }
            MutantVerdict::Broken(error) => failed(error.to_string()),
        };
        let name = format!("{} without {}", case.name, case.off.join(", "));
        let mut test = TestCase::new(name, status);
        test.set_classname("mutant");
        suite.add_test_case(test);
    }
    let mut report = Report::new("sutura hil");
    report.add_test_suite(suite);
    report
}
