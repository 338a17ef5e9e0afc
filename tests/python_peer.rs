//! The protocol as a stranger reads it: a host in Python, written from its page, against the golden vectors and a console.
#![cfg(unix)]
#![allow(clippy::unwrap_used, reason = "tests")]

use crate::support::session;
use crate::support::session::{DEPTH_M, HAND_N_PER_M, PLANE_N_PER_M, force_at_rest};
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};
use sutura_hil::VirtualConsole;
use sutura_shared::wire::{MAX_FRAME, PROTOCOL_VERSION, SCHEMA_HASH};

use sutura_hil::Pty;
use sutura_host::link::{Link, LinkError, LinkOptions, open_serial};

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
    let mut tries = Vec::new();
    // The console is armed and the hand gets there in the end; when, is up to the machine.
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
        let is_armed = seen["modes"].as_array().unwrap().contains(&"Armed".into());
        let [states, contacts, pongs] =
            ["states", "contacts", "pongs"].map(|what| seen[what].as_u64().unwrap());
        let peak = seen["peak_n"].as_f64().unwrap();
        assert!(peak < deepest, "{peak} N where {deepest} N are the most");
        let is_pressed = peak > force_at_rest() - 0.3;
        if is_armed && is_pressed && contacts > 0 && pongs > 0 {
            return;
        }
        tries.push(format!(
            "{seconds} s: {states} states, {contacts} contacts, {pongs} pongs, {peak} N, armed: {is_armed}"
        ));
    }
    panic!("{HAND_N_PER_M} N/m do not press on {PLANE_N_PER_M} N/m: {tries:#?}");
}

/// Somebody else's session is left alone: not a byte of it is taken, and whoever tries is told who has the port.
#[test]
fn python_keeps_off_a_port_in_use() {
    let mut console = VirtualConsole::start(&session::device()).unwrap();
    let path = console.path().unwrap().to_owned();
    let link = Link::open(console.host_port().unwrap(), LinkOptions::default(), |_| {}).unwrap();
    let program = "import sys; sys.path.insert(0, sys.argv[1]); import sutura_peer as peer
try:
    peer.Host(sys.argv[2])
except peer.Busy as busy:
    print(busy)";
    let Some(said) = python(&["-c", program, FOLDER, &path]) else {
        return;
    };
    let mine = format!("process {}", std::process::id());
    assert!(said.contains("in use"), "{said:?}");
    assert!(
        cfg!(not(target_os = "linux")) || said.contains(&mine),
        "{said:?}"
    );
    // A byte that another reader took would be a frame refused or lost here.
    let frames = link.close().frames;
    assert_eq!((frames.frames_lost, frames.frames_rejected), (0, 0));
}

/// And the other way round: what Python has open is busy for a host of ours, until it is closed.
#[test]
fn a_port_that_python_has_is_busy() {
    let pty = Pty::open().unwrap();
    let program = "import sys; sys.path.insert(0, sys.argv[1]); import sutura_peer as peer
host = peer.Host(sys.argv[2])
print('open', flush=True)
sys.stdin.read()";
    let child = Command::new("python3")
        .args(["-B", "-c", program, FOLDER, pty.path()])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn();
    let Ok(mut child) = child else {
        eprintln!("skipped: no python3");
        return;
    };
    let mut line = String::new();
    let mut stdout = BufReader::new(child.stdout.take().unwrap());
    stdout.read_line(&mut line).unwrap();
    assert_eq!(line, "open\n");
    let Err(error) = open_serial(pty.path()) else {
        panic!("opened")
    };
    assert!(matches!(error, LinkError::Busy { .. }), "{error:?}");
    let holder = format!("process {}", child.id());
    let said = error.to_string();
    assert!(
        cfg!(not(target_os = "linux")) || said.contains(&holder),
        "{said}"
    );
    drop(child.stdin.take());
    assert!(child.wait().unwrap().success());
    open_serial(pty.path()).unwrap();
}

/// A terminal may say that bytes wait and then have none: nothing has come, and nothing is wrong. One whose other end is
/// closed is a console that is gone, in words.
#[test]
fn python_takes_no_bytes_for_no_bytes() {
    let program = "import os, sys; sys.path.insert(0, sys.argv[1]); import sutura_peer as peer
console, terminal = os.openpty()
host = peer.Host(os.ttyname(terminal))
os.close(terminal)
really = peer.select.select
peer.select.select = lambda reads, writes, errors, timeout=None: (reads, writes, errors)
assert list(host.frames(0.01)) == []
os.write(console, b'x' * 10)
assert host.read(0.01) == b'x' * 10
room = 0
try:
    while room < 1 << 24:
        room += os.write(host.port, b'x' * 4096)
except BlockingIOError:
    peer.select.select = lambda *them: really(*them[:3], 0.01)
try:
    host.write(b'x' * 65536, within=0.05)
    raise SystemExit('a full line took everything')
except ConnectionError as error:
    assert 'takes no bytes' in str(error), error
peer.select.select = really
os.close(console)
try:
    host.read(1.0)
    raise SystemExit('nobody is there')
except ConnectionError as error:
    assert 'is gone' in str(error), error
print('all said')";
    let Some(said) = python(&["-c", program, FOLDER]) else {
        return;
    };
    assert_eq!(said.trim(), "all said");
}
