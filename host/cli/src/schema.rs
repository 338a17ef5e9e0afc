//! `sutura schema`: the keys of what commands print with `--format json`, from the types that print them.
//!
//! Entry points: [`run`], [`OUTPUTS`]. The book's tables are what this prints: `cargo xtask book`.

use crate::failure::{Cause, Failure};
use crate::{Format, Global, display};
use clap::Args;
use clap::builder::PossibleValuesParser;
use schemars::generate::SchemaSettings;
use schemars::{JsonSchema, Schema};
use serde_json::Value;
use std::fmt::Write as _;
use sutura_host::session::{Summary, UNSENDABLE};
use sutura_host::step::Status;
use sutura_host::wound::WoundReport;

/// Says which keys a command prints with `--format json`, as a table; with that, as JSON Schema.
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub struct SchemaArgs {
    /// What is described; all names when left out.
    #[arg(value_name = "NAME", value_parser = PossibleValuesParser::new(names()))]
    pub name: Option<String>,
}

const EXAMPLES: &str = "\
Examples:
  sutura schema                        what there is to describe
  sutura schema run                    the keys of a session's summary
  sutura schema run --format json      JSON Schema, 2020-12

The schema of scene files, which are input, is that of `sutura scene schema`.";

/// Something that is described.
struct Output {
    name: &'static str,
    /// Which command prints it.
    about: &'static str,
    described: Described,
}

/// What is described of it.
enum Described {
    /// The keys of an object.
    Object(fn() -> Schema),
    /// Words or numbers, each with its meaning.
    Values(fn() -> Vec<(String, String)>),
}
use Described::{Object, Values};

const OUTPUTS: &[Output] = &[
    output("run", "sutura run", of::<Summary>),
    output(
        "run-line",
        "sutura run --stream, each line",
        of::<display::Line>,
    ),
    output(
        "wound",
        "sutura run, within `scene`: threads and tissues that touch",
        of::<WoundReport>,
    ),
    output(
        "replay",
        "sutura replay",
        of::<sutura_host::recording::replay::Report>,
    ),
    output("solve", "sutura solve", of::<crate::solve::Solved>),
    output(
        "solution",
        "the file of sutura solve --out FILE.json",
        of::<sutura_host::output::Solution>,
    ),
    output("bench", "sutura bench", of::<crate::bench::Report>),
    output(
        "fidelity",
        "sutura fidelity",
        of::<sutura_study::fidelity::report::Report>,
    ),
    output(
        "tradeoff",
        "sutura tradeoff",
        of::<sutura_study::tradeoff::table::Table>,
    ),
    output(
        "stability",
        "sutura stability",
        of::<sutura_study::stability::suite::Table>,
    ),
    output(
        "scene-check",
        "sutura scene check",
        of::<crate::scene::command::Checked>,
    ),
    output(
        "scene-explain",
        "sutura scene explain",
        of::<crate::scene::command::Explained>,
    ),
    output("mesh-info", "sutura mesh info", of::<crate::mesh::Info>),
    output(
        "mesh-convert",
        "sutura mesh convert",
        of::<crate::mesh::Converted>,
    ),
    output("mesh-fill", "sutura mesh fill", of::<crate::mesh::Filled>),
    output("doctor", "sutura doctor", of::<crate::doctor::Looked>),
    output(
        "device-list",
        "sutura device list",
        of::<crate::consoles::Listed>,
    ),
    output(
        "device-selftest",
        "sutura device selftest",
        of::<crate::consoles::Tested>,
    ),
    output(
        "device-log",
        "sutura device log, each line",
        of::<crate::consoles::Logged>,
    ),
    output("flash", "sutura flash", of::<crate::flash::Flashed>),
    output("console", "sutura console", of::<crate::console::Started>),
    output(
        "failure",
        "every command that fails, unless it has printed its result",
        of::<crate::Failed>,
    ),
    Output {
        name: "exit-codes",
        about: "exit codes of all commands",
        described: Values(exit_codes),
    },
    Output {
        name: "withheld",
        about: "why the contact of a step is withheld: keys of `steps_withheld`",
        described: Values(withheld),
    },
];

const fn output(name: &'static str, about: &'static str, schema: fn() -> Schema) -> Output {
    Output {
        name,
        about,
        described: Object(schema),
    }
}

/// That every key of what is printed under that name is described, and that every one that is described is there.
#[cfg(test)]
pub fn assert_described(name: &str, printed: &impl serde::Serialize) {
    let output = OUTPUTS.iter().find(|output| output.name == name);
    let Some(Object(schema)) = output.map(|output| &output.described) else {
        panic!("no object is called {name}");
    };
    let table = keys(&schema().to_value());
    let described = table
        .lines()
        .skip(2)
        .filter_map(|row| row.split('`').nth(1));
    let described: std::collections::BTreeSet<_> = described.map(str::to_owned).collect();
    let mut found = std::collections::BTreeSet::new();
    let printed = serde_json::to_value(printed).expect("JSON");
    let mut left = vec![(String::new(), &printed)];
    while let Some((before, value)) = left.pop() {
        for (key, value) in value.as_object().into_iter().flatten() {
            let objects = value.as_array().into_iter().flatten();
            let objects: Vec<_> = objects.filter(|value| value.is_object()).collect();
            let many = if objects.is_empty() { "" } else { "[]" };
            let key = format!("{before}{key}{many}");
            let inner = objects.into_iter().chain([value]);
            left.extend(inner.map(|value| (format!("{key}."), value)));
            found.insert(key);
        }
    }
    assert_eq!(found, described, "{name}");
}

fn names() -> impl Iterator<Item = &'static str> {
    OUTPUTS.iter().map(|output| output.name)
}

/// The schema of what a type is written as, without references.
fn of<T: JsonSchema>() -> Schema {
    let settings = SchemaSettings::draft2020_12().for_serialize();
    let settings = settings.with(|settings| settings.inline_subschemas = true);
    settings.into_generator().into_root_schema_for::<T>()
}

/// Prints names, a table, or a schema.
///
/// # Errors
/// None that arguments could cause.
pub fn run(args: &SchemaArgs, global: &Global) -> Result<(), Failure> {
    let wanted = args.name.as_deref();
    let Some(output) = OUTPUTS.iter().find(|output| Some(output.name) == wanted) else {
        match global.format {
            Format::Json => say!(
                "{}",
                serde_json::json!({ "names": names().collect::<Vec<_>>() })
            ),
            Format::Text => {
                for output in OUTPUTS {
                    say!("  {:<16} {}", output.name, output.about);
                }
            }
        }
        return Ok(());
    };
    match (&output.described, global.format) {
        (Object(schema), Format::Json) => display::lines(&format!("{:#}", schema().to_value())),
        (Object(schema), Format::Text) => display::lines(keys(&schema().to_value()).trim_end()),
        (Values(values), Format::Json) => {
            let values = values().into_iter();
            let each = values.map(
                |(value, meaning)| serde_json::json!({ "const": value, "description": meaning }),
            );
            let all = serde_json::json!({ "oneOf": each.collect::<Vec<_>>() });
            display::lines(&format!("{all:#}"));
        }
        (Values(values), Format::Text) => {
            let mut table = String::from("| value | means |\n|---|---|\n");
            for (value, meaning) in values() {
                let _ = writeln!(table, "| `{value}` | {meaning} |");
            }
            display::lines(table.trim_end());
        }
    }
    Ok(())
}

fn exit_codes() -> Vec<(String, String)> {
    let done = ("0".to_owned(), "done".to_owned());
    let failed = Cause::ALL.iter().map(|cause| {
        let meaning = format!("{}: {}", cause.word(), cause.meaning());
        (cause.code().to_string(), meaning)
    });
    std::iter::once(done).chain(failed).collect()
}

fn withheld() -> Vec<(String, String)> {
    let schema = of::<Status>().to_value();
    let variants = schema["oneOf"].as_array().into_iter().flatten();
    let of_step = variants.filter_map(|variant| {
        let name = variant["const"].as_str()?.to_owned();
        Some((name, in_our_words(&plain(variant["description"].as_str()?))))
    });
    let of_session = (
        UNSENDABLE.to_owned(),
        "The step was good, and has a number that the console would refuse: a force above 1e4 N, a stiffness above 1e7 N/m.".to_owned(),
    );
    let good = Status::Ok.name();
    let mut all: Vec<_> = of_step.filter(|(name, _)| name != good).collect();
    all.push(of_session);
    all
}

/// With the names of other reasons as they are printed: `not-converged` for `NotConverged`.
fn in_our_words(meaning: &str) -> String {
    let parts = meaning.split('`').enumerate().map(|(number, part)| {
        if number % 2 == 0 || !part.starts_with(|first: char| first.is_ascii_uppercase()) {
            return part.to_owned();
        }
        let mut word = String::new();
        for letter in part.chars() {
            if letter.is_ascii_uppercase() && !word.is_empty() {
                word.push('-');
            }
            word.push(letter.to_ascii_lowercase());
        }
        word
    });
    parts.collect::<Vec<_>>().join("`")
}

/// A Markdown table of all keys of an object.
fn keys(schema: &Value) -> String {
    let mut table = String::from("| key | is | meaning |\n|---|---|---|\n");
    rows(schema, "", &mut table);
    table
}

/// Keys of times and lengths of which many are measured: they say what they are by themselves.
const OF_MANY: [&str; 6] = ["min", "mean", "p50", "p99", "p999", "max"];

fn rows(schema: &Value, before: &str, table: &mut String) {
    let mut properties: Vec<(&String, &Value)> = Vec::new();
    collect(schema, &mut properties);
    properties.sort_by_key(|(key, _)| *key);
    for (key, value) in properties {
        let (inner, many) = peeled(value);
        let meaning = value["description"].as_str().map(plain).unwrap_or_default();
        let mut inside: Vec<(&String, &Value)> = Vec::new();
        collect(inner, &mut inside);
        let key = format!(
            "{before}{key}{}",
            "[]".repeat(usize::from(many && !inside.is_empty()))
        );
        let is_of_many = !inside.is_empty()
            && inside
                .iter()
                .all(|(key, _)| OF_MANY.contains(&key.as_str()));
        if is_of_many {
            let names = OF_MANY
                .iter()
                .filter(|name| inside.iter().any(|(key, _)| key == *name));
            let names: Vec<_> = names.copied().collect();
            let _ = writeln!(
                table,
                "| `{key}{{{}}}` | {} | {meaning} |",
                names.join(","),
                kind(inside[0].1)
            );
            continue;
        }
        let _ = writeln!(table, "| `{key}` | {} | {meaning} |", kind(value));
        if !inside.is_empty() {
            rows(inner, &format!("{key}."), table);
        }
    }
}

/// The properties of a schema, those that it takes from others included.
fn collect<'a>(schema: &'a Value, into: &mut Vec<(&'a String, &'a Value)>) {
    into.extend(schema["properties"].as_object().into_iter().flatten());
    for way in ["allOf", "anyOf"] {
        for part in schema[way].as_array().into_iter().flatten() {
            collect(part, into);
        }
    }
}

/// What may be null without that, what comes many times once; and whether it does.
fn peeled(schema: &Value) -> (&Value, bool) {
    let is_null = |part: &&Value| part["type"] != "null";
    let mut choices = schema["anyOf"].as_array().into_iter().flatten();
    let schema = choices.find(is_null).unwrap_or(schema);
    match schema["items"].is_object() {
        true => (peeled(&schema["items"]).0, true),
        false => (schema, false),
    }
}

/// What a value is, in words.
fn kind(schema: &Value) -> String {
    let types: Vec<&str> = match &schema["type"] {
        Value::String(one) => vec![one],
        Value::Array(many) => many.iter().filter_map(Value::as_str).collect(),
        _ => Vec::new(),
    };
    if types.is_empty() {
        let choices = schema["anyOf"].as_array().into_iter().flatten();
        let mut words: Vec<String> = choices.map(kind).collect();
        words.dedup();
        let consts = schema["oneOf"].as_array().into_iter().flatten();
        words.extend(consts.filter_map(|one| Some(format!("`{}`", one["const"].as_str()?))));
        return match words.is_empty() {
            true => "any".to_owned(),
            false => words.join(" or "),
        };
    }
    let words = types.into_iter().map(|name| match name {
        "array" => {
            let many = match schema["maxItems"].as_u64() {
                Some(most) if schema["minItems"] == schema["maxItems"] => format!("{most} "),
                _ => "list of ".to_owned(),
            };
            format!("{many}{}", plural(&kind(&schema["items"])))
        }
        "object" => match schema["additionalProperties"].is_object() {
            true => format!("{} by name", plural(&kind(&schema["additionalProperties"]))),
            false => "object".to_owned(),
        },
        "string" => match schema["enum"].as_array() {
            Some(all) => all
                .iter()
                .filter_map(Value::as_str)
                .map(|word| format!("`{word}`"))
                .collect::<Vec<_>>()
                .join(" or "),
            None => "text".to_owned(),
        },
        "boolean" => "true or false".to_owned(),
        other => other.to_owned(),
    });
    words.collect::<Vec<_>>().join(" or ")
}

fn plural(kind: &str) -> String {
    match kind {
        "text" | "any" | "true or false" => kind.to_owned(),
        // `3 numbers`, also of what may be none.
        _ => match kind.split_once(' ') {
            Some((first, rest)) => format!("{first}s {rest}"),
            None => format!("{kind}s"),
        },
    }
}

/// A document of Rust as Markdown that stands in a table: without links to code, and on one line.
fn plain(document: &str) -> String {
    let line = document
        .split("\n\n")
        .map(|part| part.split_whitespace().collect::<Vec<_>>().join(" "));
    let line = line.collect::<Vec<_>>().join(" ");
    let line = line
        .replace("\\[", "[")
        .replace("\\]", "]")
        .replace('|', "\\|");
    line.replace("[`", "`").replace("`]", "`")
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::Serialize;

    /// What the tests describe.
    #[derive(Serialize, JsonSchema)]
    #[allow(dead_code, reason = "only described")]
    struct Told {
        /// As [`Told`] says \[m\].
        length_m: f64,
        /// Its parts.
        parts: Vec<Part>,
        /// None if there is none.
        time_us: Option<Times>,
        /// By reason.
        counts: std::collections::BTreeMap<&'static str, u64>,
        /// Place.
        at_m: [f64; 3],
        #[serde(flatten)]
        more: Option<Part>,
        #[serde(skip)]
        hidden: u32,
    }

    #[derive(Serialize, JsonSchema)]
    struct Part {
        /// Its name.
        name: Option<String>,
    }

    #[derive(Serialize, JsonSchema)]
    struct Times {
        p99: f64,
        p50: f64,
    }

    #[test]
    fn a_table_has_every_key_with_what_its_type_says() {
        let table = keys(&of::<Told>().to_value());
        let expected = "\
| key | is | meaning |
|---|---|---|
| `at_m` | 3 numbers | Place. |
| `counts` | integers by name | By reason. |
| `length_m` | number | As `Told` says [m]. |
| `name` | text or null | Its name. |
| `parts[]` | list of objects | Its parts. |
| `parts[].name` | text or null | Its name. |
| `time_us{p50,p99}` | number | None if there is none. |
";
        assert_eq!(table, expected);
    }

    #[test]
    fn reasons_are_those_of_steps_and_none_is_good() {
        let all = withheld();
        let names: Vec<&str> = all.iter().map(|(name, _)| name.as_str()).collect();
        assert!(
            names.contains(&Status::NotConverged.name()) && names.contains(&UNSENDABLE),
            "{names:?}"
        );
        assert!(!names.contains(&Status::Ok.name()));
        let is_ours = |(_, meaning): &(String, String)| !meaning.contains("`NotConverged`");
        assert!(all.iter().all(is_ours), "{all:?}");
        assert_eq!(
            in_our_words("as `NotConverged` in `x`"),
            "as `not-converged` in `x`"
        );
        assert!(
            all.iter().all(|(_, meaning)| meaning.ends_with('.')),
            "{all:?}"
        );
    }
}
