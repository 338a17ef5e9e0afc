//! Tables and pictures as files.
//!
//! Entry points: [`csv`], [`write_pictures`]; [`Kept`], for lines as they are measured.

use crate::failure::{Cause, Failure};
use crate::files::unwritable;
use serde::Serialize;
use std::fmt::Write as _;
use std::fs::File;
use std::io::Write as _;
use std::path::Path;
use std::sync::{Mutex, PoisonError};
use sutura_files::{may_write, write_whole};

/// Lines of a table as they are measured, one JSON object each: whoever interrupts hours of work has what there was.
pub struct Kept(Option<Mutex<File>>);

impl Kept {
    /// In `cases.jsonl` of a directory, if there is one.
    ///
    /// # Errors
    /// If it cannot be made.
    pub fn within(directory: Option<&Path>) -> Result<Kept, Failure> {
        let file = directory.map(|directory| {
            let path = directory.join("cases.jsonl");
            let made = may_write(&path).and_then(|()| File::create(&path));
            made.map_err(|error| unwritable(&path, &error))
        });
        Ok(Kept(file.transpose()?.map(Mutex::new)))
    }

    /// Writes a line, at once. A disk that is full is told by what is written in the end.
    pub fn line(&self, row: &impl Serialize) {
        let Some(file) = &self.0 else { return };
        let mut line = serde_json::to_string(row).unwrap_or_default();
        line.push('\n');
        let mut file = file.lock().unwrap_or_else(PoisonError::into_inner);
        let _ = file.write_all(line.as_bytes());
    }
}

/// Draws a report's pictures into a directory.
///
/// # Errors
/// If one cannot be written.
pub fn write_pictures(report: &serde_json::Value, directory: &Path) -> Result<(), Failure> {
    let pictures = sutura_plot::pictures(report).map_err(|error| {
        Failure::say(
            Cause::Failed,
            error.to_string(),
            "this is a defect of the command; the tables are written",
        )
    })?;
    for picture in pictures {
        let path = directory.join(&picture.name);
        write_whole(&path, picture.svg.as_bytes()).map_err(|error| unwritable(&path, &error))?;
    }
    Ok(())
}

/// Rows with all columns that any of them has, in the order of their first mention.
pub fn csv<T: Serialize>(rows: &[T]) -> String {
    let rows: Vec<_> = rows.iter().map(|row| serde_json::json!(row)).collect();
    let mut columns: Vec<&String> = Vec::new();
    for key in rows
        .iter()
        .filter_map(|row| row.as_object())
        .flat_map(|row| row.keys())
    {
        if !columns.contains(&key) {
            columns.push(key);
        }
    }
    let mut text = String::new();
    let names: Vec<_> = columns.iter().map(|name| name.as_str()).collect();
    let _ = writeln!(text, "{}", names.join(","));
    for row in &rows {
        let cells: Vec<_> = columns
            .iter()
            .map(|name| match row.get(name.as_str()) {
                None | Some(serde_json::Value::Null) => String::new(),
                Some(serde_json::Value::String(word)) => quoted(word),
                Some(serde_json::Value::Array(words)) => {
                    let word = |w: &serde_json::Value| {
                        w.as_str().map_or_else(|| w.to_string(), str::to_owned)
                    };
                    let words: Vec<_> = words.iter().map(word).collect();
                    quoted(&words.join(" "))
                }
                Some(other) => other.to_string(),
            })
            .collect();
        let _ = writeln!(text, "{}", cells.join(","));
    }
    text
}

fn quoted(word: &str) -> String {
    if word.contains([',', '"', '\n']) {
        format!("\"{}\"", word.replace('"', "\"\""))
    } else {
        word.to_owned()
    }
}
