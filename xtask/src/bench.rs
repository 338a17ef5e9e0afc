//! `cargo xtask bench`: counts the instructions of the solver's parts and compares them with the snapshot.
//! Entry point: [`gated`].
//!
//! Valgrind shows the program a processor of its own, the same on every machine that has AVX2, so that
//! the solver's choice of SIMD kernels, and with it the counts, do not depend on the machine.

use crate::Format;
use crate::gates::{self, Gate, Outcome, SOLVER, Snapshot};
use crate::run::Tool;
use crate::setup::{self, VALGRIND};
use crate::test::TEST_FEATURES;
use anyhow::{Context, Result, bail};
use serde::Serialize;
use serde_json::Value;
use std::collections::BTreeMap;

/// Name of the snapshot.
const SNAPSHOT: &str = "solver";

/// Most that the solver's thread may spend on those who watch, after a step, and when nobody does \[instructions\].
const LIMITS: [(&str, u64); 2] = [("offer", 60_000), ("offer_unwatched", 50)];

/// What `--format json` prints.
#[derive(Serialize)]
struct Summary {
    rustc: String,
    machine: String,
    instructions: BTreeMap<String, u64>,
    gates: Vec<Gate>,
    status: &'static str,
}

/// Runs the benches; fails if one takes more instructions than its snapshot allows.
pub fn gated(bless: bool, format: Format) -> Result<()> {
    setup::instruction_counter()?;
    let snapshot = Snapshot {
        rustc: Tool::new("rustc --version").output()?.trim().to_owned(),
        machine: machine()?,
        figures: count()?,
        ..Snapshot::default()
    };
    if bless {
        SOLVER.save(SNAPSHOT, &snapshot)?;
    }
    let mut gates = SOLVER.compare(SNAPSHOT, &SOLVER.load(SNAPSHOT)?, &snapshot);
    for (name, limit) in LIMITS {
        gates.push(gates::limit(
            name,
            snapshot.figures.get(name).copied(),
            limit,
        ));
    }
    let failed = gates
        .iter()
        .filter(|gate| gate.outcome == Outcome::Failed)
        .count();
    let summary = Summary {
        rustc: snapshot.rustc,
        machine: snapshot.machine,
        instructions: snapshot.figures,
        gates,
        status: if failed == 0 { "ok" } else { "failed" },
    };
    match format {
        Format::Json => println!("{}", serde_json::to_string(&summary)?),
        Format::Text => gates::print(&summary.gates),
    }
    if failed > 0 {
        bail!(
            "{failed} parts take more instructions; if that is meant, and within the limits, run `cargo xtask bench --bless`"
        );
    }
    Ok(())
}

/// What the counts depend on besides the program: the processor that valgrind shows.
fn machine() -> Result<String> {
    let valgrind = Tool::new(VALGRIND).arg("--version").output()?;
    let flags = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let simd = ["avx2", "avx"]
        .into_iter()
        .find(|flag| flags.split_whitespace().any(|word| word == *flag));
    let arch = std::env::consts::ARCH;
    Ok(format!(
        "{} on {arch} with {}",
        valgrind.trim(),
        simd.unwrap_or("its base instructions")
    ))
}

/// Instruction counts by name.
fn count() -> Result<BTreeMap<String, u64>> {
    eprintln!("counting instructions under valgrind");
    // With the features and the profile of the tests, in which the solver is compiled as for a release: nothing is built twice.
    let tool = Tool::new(
        "cargo bench --quiet --locked --profile dev --workspace --bench solver --features",
    )
    .arg(TEST_FEATURES)
    .arg("--")
    .arg("--output-format=json");
    let again = tool.shown();
    let output = tool.output().context("the benches failed")?;
    let mut counts = BTreeMap::new();
    for line in output.lines().filter(|line| line.starts_with('{')) {
        let summary: Value =
            serde_json::from_str(line).with_context(|| format!("the benches printed `{line}`"))?;
        let (name, instructions) = read(&summary)
            .with_context(|| format!("no instruction count in what `{again}` prints"))?;
        counts.insert(name, instructions);
    }
    if counts.is_empty() {
        bail!("the benches printed nothing; run them: {again}");
    }
    Ok(counts)
}

/// Name and instructions of one bench.
fn read(summary: &Value) -> Option<(String, u64)> {
    let name = summary["function_name"].as_str()?;
    let metrics = &summary["profiles"][0]["data"]["total"]["metrics"];
    let instructions = metrics["Ir"]["values"]["new"].as_u64()?;
    Some((name.to_owned(), instructions))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As gungraun-runner 0.20.0 prints it, shortened.
    #[test]
    fn the_count_is_found_in_what_the_runner_prints() {
        let line = r#"{"function_name":"tissue_factor","id":"slab","profiles":[{"data":{"parts":[],
            "total":{"metrics":{"Dr":{"values":{"new":7}},"Ir":{"values":{"new":587426,"old":5}}}}}}]}"#;
        let summary: Value = serde_json::from_str(line).expect("JSON");
        assert_eq!(read(&summary), Some(("tissue_factor".to_owned(), 587_426)));
        assert_eq!(read(&Value::Null), None);
    }
}
