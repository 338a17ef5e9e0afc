//! `sutura doctor`: what it looks at, what it says, and its exit codes. Whether this machine is fast enough is not asserted.
#![cfg(unix)]
#![allow(clippy::unwrap_used, reason = "tests")]

use crate::support::described::assert_described;
use crate::support::{Ran, sutura};
use std::path::Path;

fn checks(stdout: &str) -> Vec<serde_json::Value> {
    let object: serde_json::Value = serde_json::from_str(stdout).unwrap();
    object["checks"].as_array().unwrap().clone()
}

/// Those with something wrong have one fix, the others none; the exit code follows from them.
fn consistent(ran: &Ran) -> Vec<serde_json::Value> {
    assert_described("doctor", &ran.json());
    let checks = checks(&ran.stdout);
    for check in &checks {
        assert!(
            check["name"].is_string() && check["found"].is_string(),
            "{check}"
        );
        assert_eq!(
            check["ok"].as_bool().unwrap(),
            check["fix"].is_null(),
            "{check}"
        );
    }
    checks
}

fn named<'a>(checks: &'a [serde_json::Value], name: &str) -> &'a serde_json::Value {
    let found = checks.iter().find(|check| check["name"] == name);
    found.unwrap_or_else(|| panic!("no check `{name}` in {checks:?}"))
}

fn write(root: &Path, path: &str, text: &str) {
    let path = root.join(path);
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(path, text).unwrap();
}

/// A machine on which nothing is wrong.
fn machine() -> tempfile::TempDir {
    let root = tempfile::tempdir().unwrap();
    write(
        root.path(),
        "proc/version",
        "Linux version 6.1 #1 SMP PREEMPT_RT\n",
    );
    write(
        root.path(),
        "proc/self/limits",
        "Max realtime priority 80 80\nMax locked memory unlimited unlimited bytes\n",
    );
    root
}

#[test]
fn a_machine_is_looked_at_below_its_root() {
    let root = machine();
    let doctor = || {
        sutura(&[
            "doctor",
            "--root",
            root.path().to_str().unwrap(),
            "--format",
            "json",
        ])
    };
    let ran = doctor();
    let found = consistent(&ran);
    let names = [
        "ports",
        "latency_timer",
        "modem_manager",
        "real_time",
        "locked_memory",
        "preemption",
        "governor",
    ];
    for name in names {
        assert_eq!(named(&found, name)["ok"], true, "{}", ran.stdout);
    }
    let all_well = found.iter().all(|check| check["ok"] == true);
    assert_eq!(ran.code, i32::from(!all_well), "{}", ran.stderr);
    assert!(
        named(&found, "host_rate")["found"]
            .as_str()
            .unwrap()
            .contains("in the worst second, at ")
    );

    write(
        root.path(),
        "sys/bus/usb-serial/devices/ttyUSB3/latency_timer",
        "16\n",
    );
    let ran = doctor();
    let found = consistent(&ran);
    let timer = named(&found, "latency_timer");
    assert_eq!(
        (ran.code, &timer["ok"]),
        (1, &false.into()),
        "{}",
        ran.stderr
    );
    assert!(
        timer["fix"]
            .as_str()
            .unwrap()
            .contains("ttyUSB3/latency_timer")
    );
}

#[test]
fn a_console_that_answers_is_described() {
    let root = machine();
    let ran = sutura(&[
        "doctor",
        "virtual",
        "--root",
        root.path().to_str().unwrap(),
        "--format",
        "json",
    ]);
    let found = consistent(&ran);
    let console = named(&found, "console");
    assert_eq!(console["ok"], true, "{}", ran.stdout);
    assert!(
        console["found"]
            .as_str()
            .unwrap()
            .contains("cartesian-bench, simulated, 1000 Hz")
    );
    assert_eq!(named(&found, "protocol")["ok"], true);
    for name in ["tick_rate", "tick_jitter", "round_trip"] {
        named(&found, name);
    }
    let all_well = found.iter().all(|check| check["ok"] == true);
    assert_eq!(ran.code, i32::from(!all_well), "{}", ran.stderr);
}

#[test]
fn no_console_has_its_own_exit_code_and_the_rest_is_still_told() {
    let ran = sutura(&["doctor", "/dev/no-such-console", "--format", "json"]);
    assert_eq!(ran.code, 3, "{}", ran.stderr);
    let found = consistent(&ran);
    let console = named(&found, "console");
    assert_eq!(console["ok"], false);
    assert!(
        console["found"]
            .as_str()
            .unwrap()
            .contains("/dev/no-such-console")
    );
    named(&found, "host_rate");
    // Text for people: a line for each, and the fix below.
    let ran = sutura(&["doctor", "/dev/no-such-console"]);
    assert_eq!(ran.code, 3);
    assert!(
        ran.stdout.contains("BAD console") && ran.stdout.contains("fix: "),
        "{}",
        ran.stdout
    );
}
