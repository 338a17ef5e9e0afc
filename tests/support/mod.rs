//! Runs the `sutura` command as a user would and looks at all that it says.

#[cfg(unix)]
pub mod session;

use std::path::{Path, PathBuf};
use std::process::Command;

/// What a run of the command left behind.
pub struct Ran {
    pub code: i32,
    pub stdout: String,
    pub stderr: String,
}

/// Runs `sutura` with these arguments in the root of the checkout.
pub fn sutura(arguments: &[&str]) -> Ran {
    sutura_in(&root(), arguments)
}

/// Runs `sutura` with these arguments in `directory`.
pub fn sutura_in(directory: &Path, arguments: &[&str]) -> Ran {
    let output = Command::new(env!("CARGO_BIN_EXE_sutura"))
        .args(arguments)
        .current_dir(directory)
        .env_remove("RUST_LOG")
        .output()
        .expect("the command starts");
    let text = |bytes| String::from_utf8(bytes).expect("output is text");
    Ran {
        code: output.status.code().expect("the command ends by itself"),
        stdout: text(output.stdout),
        stderr: text(output.stderr),
    }
}

/// The root of the checkout.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../..")
        .canonicalize()
        .expect("the checkout is there")
}
