//! Figures against committed snapshots. Entry points: [`Snapshot`], [`Store::compare`].

use anyhow::{Context, Result};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

/// A folder of snapshots.
pub struct Store {
    /// Seen from the root of the checkout.
    folder: &'static str,
    /// The command that writes them.
    bless: &'static str,
    /// Growth that needs no new snapshot.
    allowed: Growth,
}

/// How much a figure may grow.
#[derive(Clone, Copy)]
struct Growth {
    /// Of the figure \[%\].
    percent: u64,
    /// Besides, so that small figures may move at all \[bytes or instructions\].
    least: u64,
}

/// Sizes and instruction counts of the firmware's images.
pub const FIRMWARE: Store = Store {
    folder: "firmware/snapshots",
    bless: "cargo xtask firmware --bless",
    allowed: Growth {
        percent: 1,
        least: 8,
    },
};

/// Instruction counts of the solver: parts of the C library, which machines have in different versions,
/// count too, and the compiler shares out and inlines functions in another way where the checkout has another path.
pub const SOLVER: Store = Store {
    folder: "host/snapshots",
    bless: "cargo xtask bench --bless",
    allowed: Growth {
        percent: 3,
        least: 100,
    },
};

/// Figures of one image at one time.
#[derive(Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Snapshot {
    /// The compiler: with another one, differences only warn.
    pub rustc: String,
    /// What else the figures depend on: with another machine, differences only warn.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub machine: String,
    /// Sizes \[bytes\] or instruction counts, by name.
    pub figures: BTreeMap<String, u64>,
    /// Functions that panic.
    #[serde(default)]
    pub panic_symbols: BTreeSet<String>,
}

/// Outcome of one comparison.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Gate {
    /// Image and figure.
    pub name: String,
    /// `ok`, `warning` or `failed`.
    pub outcome: Outcome,
    /// What was found.
    pub found: String,
}

/// How a gate ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Outcome {
    /// Within the tolerance.
    Ok,
    /// Different, but not to be failed for.
    Warning,
    /// Worse than the snapshot or a limit.
    Failed,
}

impl Store {
    fn path(&self, image: &str) -> PathBuf {
        let folder = crate::run::root().join(self.folder);
        folder.join(image).with_extension("json")
    }

    /// Reads the snapshot of an image.
    pub fn load(&self, image: &str) -> Result<Snapshot> {
        let path = self.path(image);
        let text = std::fs::read_to_string(&path).with_context(|| {
            format!(
                "no snapshot {}; write one with `{}`",
                path.display(),
                self.bless
            )
        })?;
        serde_json::from_str(&text).with_context(|| format!("{} is no snapshot", path.display()))
    }

    /// Writes the snapshot of an image.
    pub fn save(&self, image: &str, snapshot: &Snapshot) -> Result<()> {
        let path = self.path(image);
        let text = serde_json::to_string_pretty(snapshot)? + "\n";
        std::fs::write(&path, text).with_context(|| format!("cannot write {}", path.display()))
    }

    /// Compares present figures with a snapshot. Only growth fails; what shrank is worth a new snapshot.
    pub fn compare(&self, image: &str, old: &Snapshot, new: &Snapshot) -> Vec<Gate> {
        compare(image, old, new, self.allowed)
    }
}

fn compare(image: &str, old: &Snapshot, new: &Snapshot, allowed: Growth) -> Vec<Gate> {
    let worse = if (&old.rustc, &old.machine) == (&new.rustc, &new.machine) {
        Outcome::Failed
    } else {
        Outcome::Warning
    };
    let mut gates = Vec::new();
    let mut gate = |figure: &str, outcome, found: String| {
        gates.push(Gate {
            name: format!("{image} {figure}"),
            outcome,
            found,
        });
    };
    for (what, before, now) in [
        ("compiler", &old.rustc, &new.rustc),
        ("machine", &old.machine, &new.machine),
    ] {
        if before != now {
            let found =
                format!("the snapshot is from `{before}`, this is `{now}`: differences only warn");
            gate(what, Outcome::Warning, found);
        }
    }
    let names: BTreeSet<&String> = old.figures.keys().chain(new.figures.keys()).collect();
    for name in names {
        match (old.figures.get(name), new.figures.get(name)) {
            (Some(&before), Some(&now)) => {
                let allowed = before * allowed.percent / 100 + allowed.least;
                let outcome = if now > before + allowed {
                    worse
                } else if now + allowed < before {
                    Outcome::Warning
                } else {
                    Outcome::Ok
                };
                gate(name, outcome, format!("{now}, snapshot {before}"));
            }
            (None, Some(now)) => gate(name, worse, format!("{now}, not in the snapshot")),
            (_, None) => gate(name, worse, "gone".to_owned()),
        }
    }
    let added: Vec<&str> = new
        .panic_symbols
        .difference(&old.panic_symbols)
        .map(String::as_str)
        .collect();
    let (outcome, found) = match added.as_slice() {
        // Images without any, and figures that are of no image.
        [] if new.panic_symbols.is_empty() && old.panic_symbols.is_empty() => return gates,
        [] => (
            Outcome::Ok,
            format!("{} panicking functions, none new", new.panic_symbols.len()),
        ),
        added => (
            worse,
            format!("new panicking functions: {}", added.join(", ")),
        ),
    };
    gate("panics", outcome, found);
    gates
}

/// Compares a figure with a limit that no snapshot can move.
pub fn limit(name: &str, figure: Option<u64>, limit: u64) -> Gate {
    let (outcome, found) = match figure {
        Some(figure) if figure <= limit => (Outcome::Ok, format!("{figure}, limit {limit}")),
        Some(figure) => (Outcome::Failed, format!("{figure}, limit {limit}")),
        None => (Outcome::Failed, format!("not measured, limit {limit}")),
    };
    Gate {
        name: format!("{name} limit"),
        outcome,
        found,
    }
}

/// One line for each.
pub fn print(gates: &[Gate]) {
    for gate in gates {
        let mark = match gate.outcome {
            Outcome::Ok => "ok     ",
            Outcome::Warning => "warning",
            Outcome::Failed => "FAILED ",
        };
        println!("{mark}  {:<40} {}", gate.name, gate.found);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn snapshot(rustc: &str, tick: u64, panics: &[&str]) -> Snapshot {
        Snapshot {
            rustc: rustc.to_owned(),
            machine: String::new(),
            figures: BTreeMap::from([("tick".to_owned(), tick)]),
            panic_symbols: panics.iter().map(|name| (*name).to_owned()).collect(),
        }
    }

    fn outcomes(old: &Snapshot, new: &Snapshot) -> Vec<Outcome> {
        compare("image", old, new, FIRMWARE.allowed)
            .iter()
            .map(|gate| gate.outcome)
            .collect()
    }

    #[test]
    fn growth_beyond_one_percent_and_eight_fails() {
        use Outcome::{Failed, Ok, Warning};
        let old = snapshot("1.95", 1000, &[]);
        assert_eq!(outcomes(&old, &snapshot("1.95", 1018, &[])), [Ok]);
        assert_eq!(outcomes(&old, &snapshot("1.95", 1019, &[])), [Failed]);
        assert_eq!(outcomes(&old, &snapshot("1.95", 981, &[])), [Warning]);
        assert_eq!(
            outcomes(&old, &snapshot("1.96", 2000, &[])),
            [Warning, Warning]
        );
    }

    #[test]
    fn on_another_machine_growth_only_warns() {
        let old = snapshot("1.95", 1000, &[]);
        let mut new = snapshot("1.95", 2000, &[]);
        new.machine = "x86_64 without AVX2".to_owned();
        assert_eq!(outcomes(&old, &new), [Outcome::Warning; 2]);
    }

    #[test]
    fn a_new_panic_fails_and_is_named_and_one_less_does_not() {
        let old = snapshot("1.95", 1, &["core::panicking::panic"]);
        let new = snapshot(
            "1.95",
            1,
            &["core::panicking::panic", "core::option::unwrap_failed"],
        );
        let gates = compare("image", &old, &new, FIRMWARE.allowed);
        assert_eq!(gates[1].outcome, Outcome::Failed);
        assert!(
            gates[1].found.contains("core::option::unwrap_failed"),
            "{}",
            gates[1].found
        );
        assert_eq!(outcomes(&new, &old)[1], Outcome::Ok);
        let none = snapshot("1.95", 1, &[]);
        assert_eq!(outcomes(&none, &old)[1], Outcome::Failed);
    }

    #[test]
    fn figures_may_not_come_or_go_unseen() {
        let old = snapshot("1.95", 1, &[]);
        let mut new = snapshot("1.95", 1, &[]);
        new.figures.insert("more".to_owned(), 5);
        assert_eq!(outcomes(&old, &new), [Outcome::Failed, Outcome::Ok]);
        assert_eq!(outcomes(&new, &old), [Outcome::Failed, Outcome::Ok]);
    }

    #[test]
    fn a_limit_holds_at_its_value_and_needs_a_figure() {
        assert_eq!(limit("lock", Some(200), 200).outcome, Outcome::Ok);
        assert_eq!(limit("lock", Some(201), 200).outcome, Outcome::Failed);
        assert_eq!(limit("lock", None, 200).outcome, Outcome::Failed);
    }
}
