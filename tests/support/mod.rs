//! Runs the `sutura` command as a user would and looks at all that it says.

pub mod described;
#[cfg(unix)]
pub mod session;
#[cfg(target_os = "linux")]
pub mod terminal;

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
    let mut command = Command::new(env!("CARGO_BIN_EXE_sutura"));
    ran(command.args(arguments).current_dir(directory))
}

/// Runs a command to its end.
pub fn ran(command: &mut Command) -> Ran {
    let output = command.env_remove("RUST_LOG").output();
    let output = output.expect("the command starts");
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

/// The palpation scene in `directory`, with a hand that presses so deep that no balance is found.
pub fn too_deep(directory: &Path) -> PathBuf {
    let text = std::fs::read_to_string(root().join("scenes/palpation.toml")).expect("it ships");
    let (rest, deep) = ("[0.0, 0.0, 0.0]", "[0.0, 0.0, -0.025]");
    let deep = text
        .replace(
            &format!("position_m = {rest}"),
            &format!("position_m = {deep}"),
        )
        .replace("stiffness_n_per_m = 1000.0", "stiffness_n_per_m = 2000.0");
    let file = directory.join("deep.toml");
    std::fs::write(&file, deep).expect("writable");
    file
}

impl Ran {
    /// What `--format json` printed.
    pub fn json(&self) -> serde_json::Value {
        let object = serde_json::from_str(&self.stdout);
        object.unwrap_or_else(|_| panic!("no JSON object: {}{}", self.stdout, self.stderr))
    }

    /// Whether a session in real time, run with `--format json`, ended in one of the ways that it may on a machine that is
    /// late: at its time, at rest because no contact came for half a second, or with too little of its contact felt. What it
    /// was to feel is for sessions in lockstep.
    pub fn ended_well(&self) -> bool {
        let object = self.json();
        let status = object["status"].as_str().unwrap_or_default();
        match self.code {
            0 => status == "ok",
            // A machine that stands still for half a second is enough for that.
            1 => status.starts_with("idle: no usable contact"),
            8 => ["not-rendered: ", "behind: ", "inside: "]
                .iter()
                .any(|word| status.starts_with(word)),
            _ => false,
        }
    }
}

/// Runs a session in real time, once more where this machine let its line stand still for so long that the console
/// counted as gone, or has not yet let the threads of the link before it close the port.
#[cfg(unix)]
pub fn session_of(arguments: &[&str]) -> Ran {
    patiently(|| sutura(&[arguments, &["--format", "json"]].concat()))
}

/// As [`session_of`], for a session that is begun in another way.
#[cfg(unix)]
pub fn patiently(mut session: impl FnMut() -> Ran) -> Ran {
    session::undisturbed(|| {
        let ran = session();
        let still = ["nothing came for", "no state came", "in use by"];
        let stood = ran.code == 3 && still.iter().any(|words| ran.stderr.contains(words));
        (!stood).then_some(ran)
    })
}
