//! Programs that xtask runs, from the root of the checkout. Entry point: [`Tool`].

use anyhow::{Context, Result, anyhow, bail};
use std::ffi::OsStr;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::thread::JoinHandle;

/// Root of the checkout that cargo runs this for, which may not be the one that it was built in.
pub fn root() -> PathBuf {
    let here = std::env::var_os("CARGO_MANIFEST_DIR").map(PathBuf::from);
    let here = here.unwrap_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")));
    here.parent().map(Path::to_path_buf).unwrap_or(here)
}

/// A command line that can be shown and run.
pub struct Tool {
    command: Command,
    /// Environment, then program and arguments.
    shown: String,
    /// Working folder, if not the root.
    folder: Option<String>,
}

impl Tool {
    /// `words`: the program and its arguments, separated by spaces.
    pub fn new(words: &str) -> Self {
        let mut parts = words.split_whitespace();
        let mut command = Command::new(parts.next().unwrap_or_default());
        command.args(parts).current_dir(root());
        Self {
            command,
            shown: words.to_owned(),
            folder: None,
        }
    }

    /// This program.
    ///
    /// # Errors
    /// If nobody knows where it is.
    pub fn own() -> Result<Self> {
        let own = std::env::current_exe()?;
        let mut command = Command::new(&own);
        command.current_dir(root());
        Ok(Self {
            command,
            shown: own.display().to_string(),
            folder: None,
        })
    }

    /// Adds one argument, as it is.
    pub fn arg(mut self, argument: impl AsRef<OsStr>) -> Self {
        self.shown = format!("{} {}", self.shown, argument.as_ref().display());
        self.command.arg(argument);
        self
    }

    /// Sets an environment variable.
    pub fn env(mut self, name: &str, value: impl AsRef<OsStr>) -> Self {
        self.shown = format!("{name}='{}' {}", value.as_ref().display(), self.shown);
        self.command.env(name, value);
        self
    }

    /// Runs with another working folder, relative to the root of the checkout.
    pub fn within(mut self, folder: &str) -> Self {
        self.folder = Some(folder.to_owned());
        self.command.current_dir(root().join(folder));
        self
    }

    /// The command line, to be typed from the root of the checkout.
    pub fn shown(&self) -> String {
        match &self.folder {
            Some(folder) => format!("(cd {folder} && {})", self.shown),
            None => self.shown.clone(),
        }
    }

    /// Runs to the end; what it writes goes to stderr.
    pub fn run(self) -> Result<()> {
        self.run_lines(|line| eprintln!("{line}"))
    }

    /// Runs to the end and gives each line of its stdout to `see`; its stderr passes through.
    pub fn run_lines(mut self, mut see: impl FnMut(&str)) -> Result<()> {
        let shown = self.shown();
        let mut child = self
            .command
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .spawn()
            .with_context(|| format!("cannot start `{shown}`"))?;
        if let Some(stdout) = child.stdout.take() {
            for line in BufReader::new(stdout).lines() {
                see(&line?);
            }
        }
        let status = child.wait()?;
        if !status.success() {
            bail!("`{shown}` failed ({status})");
        }
        Ok(())
    }

    /// Starts it, beside what is run meanwhile; what it prints is kept until it is waited for.
    pub fn beside(mut self) -> Beside {
        Beside {
            shown: self.shown(),
            thread: std::thread::spawn(move || self.command.stdin(Stdio::null()).output()),
        }
    }

    /// Runs to the end without showing anything; its stdout, if it succeeded.
    pub fn output(self) -> Result<String> {
        self.both().map(|(stdout, _)| stdout)
    }

    /// As [`Tool::output`]; its stdout and its stderr.
    pub fn both(mut self) -> Result<(String, String)> {
        let shown = self.shown();
        let output = self
            .command
            .stdin(Stdio::null())
            .output()
            .with_context(|| format!("cannot start `{shown}`"))?;
        let [stdout, stderr] = [&output.stdout, &output.stderr]
            .map(|bytes| String::from_utf8_lossy(bytes).into_owned());
        if !output.status.success() {
            bail!("`{shown}` failed ({}): {}", output.status, stderr.trim());
        }
        Ok((stdout, stderr))
    }
}

/// A command line that runs beside others.
pub struct Beside {
    shown: String,
    thread: JoinHandle<std::io::Result<Output>>,
}

impl Beside {
    /// The command line.
    pub fn shown(&self) -> String {
        self.shown.clone()
    }

    /// Waits for its end, and shows what it wrote.
    pub fn wait(self) -> Result<()> {
        let shown = self.shown;
        let output = self.thread.join().map_err(|_| anyhow!("it panicked"))?;
        let output = output.with_context(|| format!("cannot start `{shown}`"))?;
        eprint!("{}", String::from_utf8_lossy(&output.stderr));
        eprint!("{}", String::from_utf8_lossy(&output.stdout));
        if !output.status.success() {
            bail!("`{shown}` failed ({})", output.status);
        }
        Ok(())
    }
}

/// Where cargo builds: `target`, or where `CARGO_TARGET_DIR` and its like say.
///
/// # Errors
/// If cargo does not say.
pub fn target() -> Result<PathBuf> {
    let metadata = Tool::new("cargo metadata --format-version 1 --no-deps --offline").output()?;
    let metadata: serde_json::Value = serde_json::from_str(&metadata)?;
    let folder = metadata["target_directory"].as_str();
    Ok(folder.map_or_else(|| root().join("target"), Into::into))
}

/// Whether a program of this name can be started.
pub fn is_there(program: &str) -> bool {
    let mut command = Command::new(program);
    command
        .arg("--version")
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null());
    command.status().is_ok_and(|status| status.success())
}
