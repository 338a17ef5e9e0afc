//! The whole table, at once or in shares: what is measured, what came of it, and how shares become one.
//!
//! Entry points: [`Plan::measure`], [`merge`]. A share has whole cases, and fronts are within a case: what is merged is put
//! together and not computed again.

use super::literature::{FIGURES, Figure};
use super::measure::{self, Extent};
use super::{cases::Case, suture};
use crate::INTERRUPTED;
use crate::idle::{IDLE, load};
use crate::machine::{Busy, Machine};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::cell::Cell;
use std::fmt::Write as _;
use std::ops::ControlFlow;
use std::str::FromStr;
use sutura_host::registry::Entry;

/// One of so many parts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Share {
    /// Which, from 1 on.
    pub number: usize,
    /// Of how many.
    pub of: usize,
}

impl Share {
    /// Everything.
    pub const ALL: Share = Share { number: 1, of: 1 };
}

impl std::fmt::Display for Share {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}/{}", self.number, self.of)
    }
}

impl FromStr for Share {
    type Err = String;

    fn from_str(text: &str) -> Result<Share, String> {
        let two = text.split_once('/');
        let two = two.and_then(|(number, of)| Some((number.parse().ok()?, of.parse().ok()?)));
        match two {
            Some((number, of)) if (1..=of).contains(&number) => Ok(Share { number, of }),
            _ => Err(format!(
                "`{text}` is no share: give I/N with I from 1 to N, as in 2/4"
            )),
        }
    }
}

/// What is measured.
pub struct Plan {
    extent: Extent,
    words: String,
    share: Share,
    cases: Vec<(Case, Vec<Entry>)>,
    sewn: Vec<&'static str>,
}

/// Why there is nothing to measure.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error, miette::Diagnostic)]
pub enum NoPlan {
    /// Nothing has these words.
    #[error("no case and tissue have all the words `{words}`")]
    #[diagnostic(help(
        "words are parts of a case's or a tissue's name: `beam`, `cylinder-compressed`, `linear`; --full has more cases"
    ))]
    Words {
        /// As they were given.
        words: String,
    },
    /// There are fewer cases than shares.
    #[error("the share {share} has no case: there are {cases}")]
    #[diagnostic(help("give at most {cases} shares: a case is in one of them"))]
    Share {
        /// As it was given.
        share: String,
        /// How many there are.
        cases: usize,
    },
}

impl Plan {
    /// A share of what has all of `words`, in the names of its case or its tissue.
    ///
    /// # Errors
    /// [`NoPlan`].
    pub fn new(extent: Extent, words: &str, share: Share) -> Result<Plan, NoPlan> {
        let each: Vec<_> = words.split_whitespace().collect();
        let mut plan = Plan {
            extent,
            words: each.join(" "),
            share,
            cases: measure::plan(extent, &each),
            sewn: suture::plan(&each),
        };
        let all = plan.names().len();
        if all == 0 {
            return Err(NoPlan::Words { words: plan.words });
        }
        // Neighbours take about as long: they go to different shares.
        let mut place = 0..;
        let mut is_own = || {
            place
                .next()
                .is_some_and(|at: usize| at % share.of + 1 == share.number)
        };
        plan.cases.retain(|_| is_own());
        if !plan.sewn.is_empty() && !is_own() {
            plan.sewn.clear();
        }
        if plan.names().is_empty() {
            return Err(NoPlan::Share {
                share: share.to_string(),
                cases: all,
            });
        }
        Ok(plan)
    }

    /// Names of its cases, in the table's order.
    pub fn names(&self) -> Vec<&'static str> {
        let sewn = (!self.sewn.is_empty()).then_some(suture::CASE);
        let cases = self.cases.iter().map(|(case, _)| case.name);
        cases.chain(sewn).collect()
    }

    /// Lines that it has.
    pub fn lines(&self) -> usize {
        measure::lines(&self.cases, self.extent) + suture::lines(&self.sewn, self.extent)
    }

    /// Measures it, one line after the other; `told` is called with each as it is found, and says whether to go on: else the table is
    /// [`INTERRUPTED`], with the lines by then. `program` names release and commit.
    ///
    /// # Errors
    /// A case without an answer, which is a defect.
    pub fn measure(
        &self,
        program: &str,
        told: &mut dyn FnMut(Line<'_>) -> ControlFlow<()>,
    ) -> Result<Table, String> {
        let (load_before, busy) = (load(), Busy::begin());
        let stopped = Cell::new(false);
        let mut told = |line: Line<'_>| {
            let then = told(line);
            stopped.set(then.is_break());
            then
        };
        let report = measure::measure(&self.cases, self.extent, &mut |row| told(Line::Case(row)))?;
        let sutures = match stopped.get() {
            true => Vec::new(),
            false => suture::measure(&self.sewn, self.extent, &mut |row| told(Line::Suture(row))),
        };
        let full = if self.extent.full { "full" } else { "short" };
        let others = busy.and_then(|busy| busy.others());
        Ok(Table {
            status: if stopped.get() { INTERRUPTED } else { "ok" },
            extent: full,
            report,
            sutures,
            literature: FIGURES,
            made: [Made {
                share: self.share.to_string(),
                only: self.words.clone(),
                timed: self.extent.timed,
                cases: self.names().into_iter().map(str::to_owned).collect(),
                program: program.to_owned(),
                machine: Machine::here(),
                load_before,
                load_after: load(),
                others,
                idle: others.map(|others| others <= IDLE),
            }],
        })
    }
}

/// A line of either table.
#[derive(Clone, Copy, Debug, Serialize)]
#[serde(untagged)]
pub enum Line<'a> {
    /// Of the models' table.
    Case(&'a measure::Row),
    /// Of the suture's.
    Suture(&'a suture::Row),
}

/// What was measured.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct Table {
    /// `ok`, or `interrupted`.
    pub status: &'static str,
    extent: &'static str,
    /// Of the models.
    #[serde(flatten)]
    pub report: measure::Report,
    /// Of the suture.
    pub sutures: Vec<suture::Row>,
    #[schemars(with = "Vec<Figure>")]
    literature: [Figure; FIGURES.len()],
    /// Where and how: one for each share that it is made of.
    #[schemars(with = "Vec<Made>")]
    pub made: [Made; 1],
}

/// Where and how a share was measured.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Made {
    /// Which share of the cases, as I/N; 1/1 is all.
    pub share: String,
    /// The words that cases were chosen by.
    pub only: String,
    /// Whether steps were timed: else there are errors alone, the same on every machine of the same instructions.
    pub timed: bool,
    /// Its cases.
    pub cases: Vec<String>,
    /// Release and commit of the program.
    pub program: String,
    /// The machine.
    pub machine: Machine,
    /// Processes that ran or wanted to in the minute before it began, in the mean, where the system tells.
    pub load_before: Option<f64>,
    /// The same of the minute before its end, with the measurement itself.
    pub load_after: Option<f64>,
    /// Processors that other programs kept busy while it was measured, in the mean, where the system tells.
    pub others: Option<f64>,
    /// Whether those were few enough for times to mean something.
    pub idle: Option<bool>,
}

impl Made {
    /// That times were taken beside other work; nothing where they were not, or where nobody knows.
    pub fn disturbed(&self) -> Option<String> {
        let others = self
            .others
            .filter(|_| self.timed && self.idle == Some(false))?;
        Some(format!(
            "other programs kept {others:.1} processors busy: times are not those of an idle machine"
        ))
    }
}

/// Why shares make no table.
#[derive(Clone, Debug, PartialEq, thiserror::Error, miette::Diagnostic)]
pub enum NoMerge {
    /// There is nothing to merge.
    #[error("no shares were given")]
    #[diagnostic(help("give the files of all shares"))]
    Nothing,
    /// It is something else.
    #[error("{name} is no table of `sutura tradeoff`: {why}")]
    #[diagnostic(help(
        "give what `sutura tradeoff --cases I/N --format json` printed, or the tradeoff.json of its --plot DIR"
    ))]
    NoTable {
        /// The file.
        name: String,
        /// What is wrong with it.
        why: String,
    },
    /// They are not shares of one table.
    #[error("{first} and {second} are not of one table: {what} is {here} and {there}")]
    #[diagnostic(help("{}", if *is_machine {
        "times of two machines make no front: measure all shares on one, or with --errors, which has no times and no front"
    } else {
        "measure all shares with one program and the same options"
    }))]
    Differ {
        /// A file.
        first: String,
        /// And another.
        second: String,
        /// What differs.
        what: &'static str,
        /// In the one.
        here: String,
        /// In the other.
        there: String,
        /// Whether it is the machine.
        is_machine: bool,
    },
    /// One of them is there twice.
    #[error("{first} and {second} are both the share {share}")]
    #[diagnostic(help("give each share once"))]
    Twice {
        /// A file.
        first: String,
        /// And another.
        second: String,
        /// Which share.
        share: String,
    },
    /// Some are not there.
    #[error("of the {of} shares {missing} are missing")]
    #[diagnostic(help("measure them with `sutura tradeoff --cases I/{of}`"))]
    Missing {
        /// How many there are.
        of: usize,
        /// Which ones.
        missing: String,
    },
}

/// A share as it was read.
struct Part {
    name: String,
    share: Share,
    made: Made,
    extent: String,
    table: Value,
}

impl Part {
    fn read(name: &str, text: &str) -> Result<Part, NoMerge> {
        let no_table = |why: String| NoMerge::NoTable {
            name: name.to_owned(),
            why,
        };
        let table: Value =
            serde_json::from_str(text).map_err(|error| no_table(error.to_string()))?;
        if table["status"] == INTERRUPTED {
            return Err(no_table(
                "it was interrupted: measure this share again".to_owned(),
            ));
        }
        let key = |key: &str| {
            let value = table.get(key).cloned();
            value.ok_or_else(|| no_table(format!("it has no `{key}`")))
        };
        for list in LISTS {
            if !key(list)?.is_array() {
                return Err(no_table(format!("its `{list}` is no list")));
            }
        }
        let made: Vec<Made> = serde_json::from_value(key("made")?)
            .map_err(|error| no_table(format!("`made`: {error}")))?;
        let [made] = &made[..] else {
            return Err(no_table("it is merged already, or empty".to_owned()));
        };
        let extent = key("extent")?.as_str().unwrap_or_default().to_owned();
        Ok(Part {
            name: name.to_owned(),
            share: made.share.parse().map_err(no_table)?,
            made: made.clone(),
            extent,
            table,
        })
    }

    /// What of this share and another one must be the same and is not.
    fn differs(&self, other: &Part) -> Option<(&'static str, String, String, bool)> {
        let plain = |part: &Part| {
            let made = &part.made;
            [
                ("the program", made.program.clone()),
                ("the extent", part.extent.clone()),
                ("--only", format!("`{}`", made.only)),
                ("the number of shares", part.share.of.to_string()),
                ("timing", if made.timed { "on" } else { "off" }.to_owned()),
                ("the build", made.machine.build.clone()),
                ("the instructions", made.machine.simd.clone()),
            ]
        };
        for ((what, here), (_, there)) in plain(self).into_iter().zip(plain(other)) {
            if here != there {
                return Some((what, here, there, false));
            }
        }
        let (here, there) = (&self.made.machine, &other.made.machine);
        if !self.made.timed || here == there {
            return None;
        }
        let words = |m: &Machine| format!("`{}` ({}, {} threads)", m.host, m.cpu, m.threads);
        Some(("the machine", words(here), words(there), true))
    }
}

/// Keys of a table that are put together; `made` too.
const LISTS: [&str; 4] = ["cases", "truths", "best", "sutures"];

/// One table from all its shares, each with a name for messages and the text of its JSON object.
///
/// # Errors
/// [`NoMerge`]: times of two machines, of two programs, of two sets of cases are not one table.
pub fn merge(shares: &[(String, String)]) -> Result<Value, NoMerge> {
    let parts = shares.iter().map(|(name, text)| Part::read(name, text));
    let mut parts = parts.collect::<Result<Vec<_>, _>>()?;
    let Some(first) = parts.first() else {
        return Err(NoMerge::Nothing);
    };
    let of = first.share.of;
    for other in &parts[1..] {
        if let Some((what, here, there, is_machine)) = first.differs(other) {
            return Err(NoMerge::Differ {
                first: first.name.clone(),
                second: other.name.clone(),
                what,
                here,
                there,
                is_machine,
            });
        }
    }
    parts.sort_by_key(|part| part.share.number);
    for two in parts.windows(2) {
        if let [a, b] = two
            && a.share == b.share
        {
            return Err(NoMerge::Twice {
                first: a.name.clone(),
                second: b.name.clone(),
                share: a.share.to_string(),
            });
        }
    }
    let there: Vec<_> = parts.iter().map(|part| part.share.number).collect();
    let missing: Vec<_> = (1..=of).filter(|number| !there.contains(number)).collect();
    if !missing.is_empty() {
        let missing: Vec<_> = missing
            .iter()
            .map(|number| format!("{number}/{of}"))
            .collect();
        return Err(NoMerge::Missing {
            of,
            missing: missing.join(", "),
        });
    }
    Ok(joined(&parts))
}

/// Cases in the order in which one process has them: shares take turns.
fn joined(parts: &[Part]) -> Value {
    let mut names: Vec<&String> = Vec::new();
    let most = parts.iter().map(|part| part.made.cases.len()).max();
    for turn in 0..most.unwrap_or(0) {
        names.extend(parts.iter().filter_map(|part| part.made.cases.get(turn)));
    }
    let lines = |list: &str| -> Vec<Value> {
        let of_part = |part: &Part| part.table[list].as_array().cloned().unwrap_or_default();
        let all: Vec<_> = parts.iter().flat_map(of_part).collect();
        let mut lines = Vec::with_capacity(all.len());
        for name in &names {
            lines.extend(
                all.iter()
                    .filter(|line| line["case"] == name.as_str())
                    .cloned(),
            );
        }
        lines
    };
    let mut table = parts[0].table.clone();
    for list in LISTS {
        table[list] = lines(list).into();
    }
    table["made"] = parts.iter().map(|part| json!(part.made)).collect();
    table
}

/// What people are told of a merged table.
pub fn words(table: &Value) -> String {
    let mut text = String::new();
    let made = table["made"].as_array().into_iter().flatten();
    for made in made.filter_map(|made| Made::deserialize(made).ok()) {
        let load = made.load_before;
        let _ = writeln!(
            text,
            "{:>7}  {} ({}), load {} before: {}",
            made.share,
            made.machine.host,
            made.machine.cpu,
            load.map_or_else(|| "unknown".to_owned(), |load| load.to_string()),
            made.cases.join(", ")
        );
        if let Some(disturbed) = made.disturbed() {
            let _ = writeln!(text, "         {disturbed}");
        }
    }
    let count = |list: &str| table[list].as_array().map_or(0, Vec::len);
    let _ = write!(
        text,
        "{} lines of {} cases, {} of the suture; --format json prints them, --plot DIR writes tables and pictures",
        count("cases"),
        count("truths"),
        count("sutures")
    );
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(share: &str) -> Vec<&'static str> {
        let extent = Extent {
            full: true,
            timed: false,
        };
        let share = share.parse().expect("a share");
        Plan::new(extent, "", share).expect("cases").names()
    }

    #[test]
    fn every_case_is_in_one_share() {
        let mut all = names("1/1");
        let mut shared: Vec<_> = ["1/3", "2/3", "3/3"].into_iter().flat_map(names).collect();
        assert!(shared.contains(&suture::CASE));
        all.sort_unstable();
        shared.sort_unstable();
        assert_eq!(all, shared);
        let extent = Extent {
            full: true,
            timed: false,
        };
        let share = Share { number: 99, of: 99 };
        let error = Plan::new(extent, "", share).err().expect("too many");
        assert_eq!(
            error.to_string(),
            format!("the share 99/99 has no case: there are {}", all.len())
        );
        for bad in ["0/3", "4/3", "1", "1/", "a/b", "1/0", "-1/2"] {
            let error = bad.parse::<Share>().expect_err(bad);
            assert!(error.contains("give I/N with I from 1 to N"), "{error}");
        }
    }

    fn share(number: usize, cases: &[&str], change: impl Fn(&mut Value)) -> (String, String) {
        let lines: Vec<_> = cases
            .iter()
            .map(|case| json!({ "case": case, "step_us": 1.5 }))
            .collect();
        let mut table = json!({
            "status": "ok", "extent": "short", "cases": lines, "truths": lines, "best": [], "sutures": [], "literature": [],
            "made": [{
                "share": format!("{number}/2"), "only": "", "timed": true, "cases": cases, "program": "1 (a)",
                "machine": { "host": "one", "cpu": "c", "threads": 2, "os": "o", "arch": "a", "simd": "v3", "build": "release" },
                "load_before": 0.1, "load_after": 1.0, "others": 0.1, "idle": true,
            }],
        });
        change(&mut table);
        (format!("{number}.json"), table.to_string())
    }

    #[test]
    fn shares_become_the_table_of_one_process() {
        let beside_others = |table: &mut Value| {
            table["made"][0]["others"] = json!(1.25);
            table["made"][0]["idle"] = json!(false);
        };
        let two = [
            share(2, &["b"], beside_others),
            share(1, &["a", "c"], |_| {}),
        ];
        let table = merge(&two).expect("one table");
        let cases: Vec<_> = table["cases"]
            .as_array()
            .expect("lines")
            .iter()
            .map(|line| &line["case"])
            .collect();
        assert_eq!(cases, ["a", "b", "c"]);
        assert_eq!(table["made"].as_array().map(Vec::len), Some(2));
        let words = words(&table);
        let own: Vec<_> = words.lines().map(str::trim).collect();
        assert_eq!(
            own[..3],
            [
                "1/2  one (c), load 0.1 before: a, c",
                "2/2  one (c), load 0.1 before: b",
                "other programs kept 1.2 processors busy: times are not those of an idle machine",
            ]
        );
    }

    #[test]
    fn what_is_not_of_one_table_is_refused_by_name() {
        let said = |change: &dyn Fn(&mut Value)| {
            let two = [share(1, &["a"], |_| {}), share(2, &["b"], change)];
            merge(&two).expect_err("two tables").to_string()
        };
        let made = |key: &'static str, value: Value| {
            move |table: &mut Value| table["made"][0][key] = value.clone()
        };
        let machine = |key: &'static str, value: &'static str| {
            move |table: &mut Value| table["made"][0]["machine"][key] = value.into()
        };
        for (error, named) in [
            (
                said(&machine("host", "two")),
                "1.json and 2.json are not of one table: the machine is `one` (c, 2 threads) and `two` (c, 2 threads)",
            ),
            (
                said(&machine("simd", "v4")),
                "the instructions is v3 and v4",
            ),
            (
                said(&made("program", json!("2 (b)"))),
                "the program is 1 (a) and 2 (b)",
            ),
            (
                said(&made("only", json!("beam"))),
                "--only is `` and `beam`",
            ),
            (said(&made("timed", json!(false))), "timing is on and off"),
            (
                said(&made("share", json!("2/3"))),
                "the number of shares is 2 and 3",
            ),
            (
                said(&made("share", json!("1/2"))),
                "1.json and 2.json are both the share 1/2",
            ),
            (
                said(&|table| table["extent"] = json!("full")),
                "the extent is short and full",
            ),
            (
                said(&|table| table["status"] = json!(INTERRUPTED)),
                "2.json is no table of `sutura tradeoff`: it was interrupted: measure this share again",
            ),
            (
                said(&|table| table["best"] = json!(3)),
                "2.json is no table of `sutura tradeoff`: its `best` is no list",
            ),
        ] {
            assert!(error.contains(named), "{error}");
        }
        let missing = merge(&[share(2, &["b"], |_| {})]).expect_err("one of two");
        assert_eq!(missing.to_string(), "of the 2 shares 1/2 are missing");
    }

    #[test]
    fn errors_alone_may_come_from_two_machines() {
        let untimed = |host: &'static str| {
            move |table: &mut Value| {
                table["made"][0]["timed"] = json!(false);
                table["made"][0]["machine"]["host"] = json!(host);
            }
        };
        let two = [
            share(1, &["a"], untimed("one")),
            share(2, &["b"], untimed("two")),
        ];
        assert!(merge(&two).is_ok());
    }
}
