//! The protocol as a stranger reads it: a host in Python, written from its page, against the golden vectors and a console.
#![cfg(unix)]
#![allow(clippy::unwrap_used, reason = "tests")]

use crate::support::session;
use std::path::Path;
use std::process::Command;
use sutura_hil::VirtualConsole;
use sutura_shared::wire::{MAX_FRAME, PROTOCOL_VERSION, SCHEMA_HASH};

use crate::support::session::{DEPTH_M, HAND_N_PER_M, PLANE_N_PER_M, force_at_rest};

const FOLDER: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../hil/python");
const GOLDEN: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/golden");

/// What a program says; none, with a message, where there is no Python.
fn python(arguments: &[&str]) -> Option<String> {
    let mut python = Command::new("python3");
    // No cache beside the sources.
    let output = match python.arg("-B").args(arguments).output() {
        Ok(output) => output,
        Err(error) => {
            eprintln!("skipped: no python3 ({error})");
            return None;
        }
    };
    assert!(
        output.status.success(),
        "{arguments:?}: {}",
        String::from_utf8_lossy(&output.stderr)
    );
    Some(String::from_utf8(output.stdout).unwrap())
}

#[test]
fn python_writes_the_golden_frames() {
    let Some(written) = python(&[&format!("{GOLDEN}/frames.py")]) else {
        return;
    };
    let golden = std::fs::read_to_string(format!("{GOLDEN}/frames.hex")).unwrap();
    assert_eq!(written, golden);
}

#[test]
fn python_reads_the_golden_frames() {
    let program = "import sys; sys.path.insert(0, sys.argv[1]); import sutura_peer as peer
for line in open(sys.argv[2]):
    if line[0] != '#':
        data = bytes.fromhex(line.split()[1])
        name, body, *header = peer.decode(data[:-1])
        assert peer.encode(name, body, *header) == data, line
        for at in range(len(data) - 1):
            for value in {0, 255, data[at] ^ 1, data[at] ^ 128} - {data[at]}:
                try:
                    peer.decode(data[:at] + bytes([value]) + data[at + 1:-1])
                except peer.Refused:
                    continue
                raise SystemExit(f'{line} with {value} at {at} was taken')
print(hex(peer.SCHEMA_HASH), peer.VERSION, peer.MAX_FRAME)";
    let hex = format!("{GOLDEN}/frames.hex");
    let Some(said) = python(&["-c", program, FOLDER, &hex]) else {
        return;
    };
    let expected = format!("{SCHEMA_HASH:#x} {PROTOCOL_VERSION} {MAX_FRAME}");
    assert_eq!(
        said.trim(),
        expected,
        "sutura_peer.py is of another protocol"
    );
}

/// What a stranger copies from the page.
#[test]
fn the_page_has_the_number_of_the_layouts() {
    let page = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/src/protocol.md");
    let page = std::fs::read_to_string(page).unwrap();
    assert!(
        page.contains(&format!("`0x{SCHEMA_HASH:016X}`")),
        "docs/src/protocol.md has another hash"
    );
    assert!(
        page.contains(&format!("at least {MAX_FRAME}")),
        "docs/src/protocol.md has another frame size"
    );
    assert!(page.contains(&format!("| version | 1 | {PROTOCOL_VERSION} |")));
}

#[test]
fn a_host_in_python_renders_its_plane() {
    let press = Path::new(FOLDER).join("press.py");
    // Friction (0.15 N in the stage) holds the grip up to that far from where both springs are in balance; a machine so
    // busy that the force had to decay lets the hand go deeper before it is back.
    let deepest = 1.3 * DEPTH_M * PLANE_N_PER_M;
    let mut peak = 0.0;
    // The hand gets there in the end; when, is up to the machine.
    for seconds in ["2", "5", "20"] {
        let console = VirtualConsole::start(&session::device()).unwrap();
        let Some(said) = python(&[press.to_str().unwrap(), console.path().unwrap(), seconds])
        else {
            return;
        };
        let seen: serde_json::Value = serde_json::from_str(&said).unwrap();
        println!("{seen:#}");
        assert_eq!(seen["console"]["device_name"], "cartesian-bench");
        assert_eq!(seen["refused"], 0);
        assert!(seen["modes"].as_array().unwrap().contains(&"Armed".into()));
        let count = |what: &str| seen[what].as_u64().unwrap();
        assert!(count("states") > 0 && count("contacts") > 0 && count("pongs") > 0);
        peak = seen["peak_n"].as_f64().unwrap();
        assert!(peak < deepest, "{peak} N where {deepest} N are the most");
        if peak > force_at_rest() - 0.3 {
            return;
        }
    }
    panic!("{peak} N where {HAND_N_PER_M} N/m press on {PLANE_N_PER_M} N/m");
}
