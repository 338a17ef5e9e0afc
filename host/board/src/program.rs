//! Programs of others, and what they say.
//!
//! Entry point: [`Program::run`].

use crate::FlashError;
use std::ffi::OsStr;
use std::io::ErrorKind;
use std::process::{Command, Stdio};

/// A program that is looked for where the system looks.
#[derive(Clone, Copy, Debug)]
pub struct Program {
    /// Its name.
    pub name: &'static str,
    /// What it is for.
    pub what: &'static str,
    /// How to get it.
    pub install: &'static str,
}

impl Program {
    /// A file that it is given, or gives, cannot be made, read or written.
    pub fn file_error(&self, source: std::io::Error) -> FlashError {
        FlashError::File {
            program: self.name,
            source,
        }
    }

    /// Runs it to its end; what it said on stdout and stderr.
    ///
    /// # Errors
    /// [`FlashError::NoProgram`]; [`FlashError::Program`] if it fails, with the last that it said.
    pub fn run<S: AsRef<OsStr>>(&self, arguments: &[S]) -> Result<[String; 2], FlashError> {
        let mut command = Command::new(self.name);
        // It may ask for what nobody answers.
        command.args(arguments).stdin(Stdio::null());
        let shown = || {
            let words = arguments.iter().map(|word| word.as_ref().to_string_lossy());
            let words: Vec<_> = std::iter::once(self.name.into()).chain(words).collect();
            words.join(" ")
        };
        match command.output() {
            Ok(output) if output.status.success() => {
                let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
                Ok([text(&output.stdout), text(&output.stderr)])
            }
            Ok(output) => {
                let of = |bytes: &[u8]| last_words(&String::from_utf8_lossy(bytes));
                let said = of(&output.stderr).or_else(|| of(&output.stdout));
                Err(FlashError::Program {
                    command: shown(),
                    said: said.unwrap_or_else(|| output.status.to_string()),
                })
            }
            Err(error) if error.kind() == ErrorKind::NotFound => Err(FlashError::NoProgram {
                program: self.name,
                what: self.what,
                install: self.install,
            }),
            Err(error) => Err(FlashError::Program {
                command: shown(),
                said: error.to_string(),
            }),
        }
    }
}

/// The last line that is not empty.
fn last_words(text: &str) -> Option<String> {
    let mut lines = text.lines().rev().map(str::trim);
    lines.find(|line| !line.is_empty()).map(str::to_owned)
}
