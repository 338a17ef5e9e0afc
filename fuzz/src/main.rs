//! The driver's command line: `cargo xtask fuzz` runs this.

use clap::{Parser, ValueEnum};
use std::process::ExitCode;
use std::time::Instant;
use sutura_fuzz::driver::{Counts, Target, run};

/// Mutates frames, scenes, meshes and recordings and looks what reads them.
#[derive(Parser)]
#[command(name = "cargo xtask fuzz", bin_name = "cargo xtask fuzz", after_help = EXAMPLES)]
struct Arguments {
    /// What is fuzzed; all of them when left out.
    #[arg(value_enum)]
    target: Option<Target>,
    /// A hundred times as much.
    #[arg(long)]
    full: bool,
    /// Frames or files.
    #[arg(long, value_name = "N")]
    count: Option<u64>,
    /// Where the random numbers begin; the same seed gives the same frames and files.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Threads; as many as the machine has cores when left out.
    #[arg(long, value_name = "N")]
    threads: Option<usize>,
    /// How to print the counts.
    #[arg(long, value_enum, default_value = "text")]
    format: Format,
}

const EXAMPLES: &str = "\
Examples:
  cargo xtask fuzz                                  all targets, within a minute
  cargo xtask fuzz stream --full                    100 million frames for the console
  cargo xtask fuzz stream --seed 17 --count 100000  one console again, as a failure says";

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Format {
    Text,
    Json,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let mut objects = Vec::new();
    let mut failed = false;
    for target in Target::ALL {
        if arguments.target.is_some_and(|wanted| wanted != target) {
            continue;
        }
        let factor = if arguments.full { 100 } else { 1 };
        let count = arguments.count.unwrap_or(factor * target.short());
        let began = Instant::now();
        let (counts, defect) = run(target, arguments.seed, count, arguments.threads);
        let seconds = began.elapsed().as_secs_f64();
        failed |= defect;
        match arguments.format {
            Format::Text => print(target, &counts, seconds),
            Format::Json => objects.push(json(target, &counts, seconds)),
        }
    }
    if arguments.format == Format::Json {
        println!(
            "{}",
            serde_json::json!({ "targets": objects, "failed": failed })
        );
    }
    ExitCode::from(u8::from(failed))
}

fn print(target: Target, counts: &Counts, seconds: f64) {
    println!("{} ({seconds:.1} s)", target.name());
    for (name, count) in counts.rows() {
        println!("  {name:<22}{count:>12}");
    }
    for (reason, count) in counts.refused() {
        println!("    {count:>12}  {reason}");
    }
}

fn json(target: Target, counts: &Counts, seconds: f64) -> serde_json::Value {
    let named = |(name, count): &(&str, u64)| ((*name).to_owned(), (*count).into());
    let mut object: serde_json::Map<String, serde_json::Value> =
        counts.rows().iter().map(named).collect();
    let refused: serde_json::Map<_, _> = counts
        .refused()
        .iter()
        .map(|(reason, count)| (format!("{reason:?}"), (*count).into()))
        .collect();
    object.insert("target".to_owned(), target.name().into());
    object.insert("seconds".to_owned(), seconds.into());
    if !refused.is_empty() {
        object.insert("refused".to_owned(), refused.into());
    }
    object.into()
}
