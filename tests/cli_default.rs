//! The scene that the command has by itself, where there is no checkout.

use crate::support::{Ran, sutura, sutura_in};
#[cfg(target_os = "linux")]
use crate::support::{patiently, ran, root};
use serde_json::Value;
#[cfg(target_os = "linux")]
use std::process::Command;

const SHORT: [&str; 6] = ["run", "--lockstep", "--seconds", "0.05", "--format", "json"];

fn hash(ran: &Ran) -> String {
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let summary: Value = serde_json::from_str(&ran.stdout).expect("one JSON object");
    assert_eq!(summary["ticks"], 50);
    summary["trace_hash"].as_str().expect("a hash").to_owned()
}

/// In an empty directory the copy inside the program runs, and it is the scene that ships: same bits in,
/// same bits out.
#[test]
fn the_default_scene_runs_anywhere_and_is_the_one_that_ships() {
    let empty = tempfile::tempdir().expect("a directory");
    assert_eq!(
        hash(&sutura_in(empty.path(), &SHORT)),
        hash(&sutura(&SHORT))
    );
}

/// Who may neither lock memory nor go before others has a session in real time all the same.
#[cfg(target_os = "linux")]
#[test]
fn a_user_without_rights_has_a_session_in_real_time() {
    let is_root = Command::new("id").arg("-u").output().expect("`id` starts");
    let mut command = Command::new("timeout");
    command.args([
        "--kill-after=5",
        "60",
        "prlimit",
        "--rtprio=0:0",
        "--memlock=0:0",
    ]);
    if is_root.stdout == b"0\n" {
        // Root goes beyond limits by its capabilities.
        command.args(["setpriv", "--bounding-set=-ipc_lock,-sys_nice"]);
    }
    command.arg(env!("CARGO_BIN_EXE_sutura"));
    command.args(["run", "--seconds", "0.5", "--format", "json"]);
    command.current_dir(root());
    let ran = patiently(|| ran(&mut command));
    // Of `timeout`, from 124 on.
    assert!(ran.code < 124, "it does not end: {}", ran.stderr);
    assert!(ran.ended_well(), "{}{}", ran.stdout, ran.stderr);
    let scheduling = &ran.json()["scheduling"];
    assert_eq!(scheduling["memory_locked"], false);
    for thread in ["solver", "link", "console"] {
        assert_eq!(scheduling[thread], "ordinary", "{scheduling}");
    }
}
