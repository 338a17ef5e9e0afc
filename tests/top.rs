//! `sutura top` and `sutura run --top` at a terminal, and without one.
#![allow(clippy::unwrap_used, reason = "tests")]

use crate::support::terminal::Terminal;
use crate::support::{ran, root};
use crate::view::Running;
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;
use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::{Command, Stdio};
use tempfile::{TempDir, tempdir};
use tokio_tungstenite::tungstenite::{Message, accept};

/// A place where sessions are written down.
fn place() -> (TempDir, String) {
    let folder = tempdir().unwrap();
    let path = folder.path().to_str().unwrap().to_owned();
    (folder, path)
}

fn view(place: &str) -> Running {
    let arguments = ["view", "--view-port", "0"];
    Running::start_with(&arguments, &[("XDG_RUNTIME_DIR", place)])
}

fn top(place: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_sutura"));
    command.arg("top").env("XDG_RUNTIME_DIR", place);
    command.current_dir(root()).stdin(Stdio::null());
    command
}

fn tick(screen: &str) -> Option<u64> {
    let rest = screen.split_once("tick ")?.1;
    rest.split_whitespace().next()?.parse().ok()
}

/// Figures move, keys do what they say, and the terminal is as it was after SIGTERM.
#[test]
fn figures_move_and_keys_are_obeyed() {
    let (_folder, place) = place();
    let session = view(&place);
    let mut top = Terminal::start(&["top"], &[("XDG_RUNTIME_DIR", &place)]);
    assert!(top.is_sane());
    top.shows(" ARMED ");
    assert!(!top.is_sane(), "the terminal is taken");
    let first = top.until("a tick", tick);
    top.until("a later tick", |screen| {
        tick(screen).filter(|tick| *tick > first)
    });
    top.until("a force", |screen| {
        let (before, _) = screen.split_once(" N ")?;
        let force_n: f64 = before.split_whitespace().last()?.parse().ok()?;
        (force_n > 0.1).then_some(())
    });
    // In lockstep there is no link, and nothing is invented.
    top.shows("link       – kB/s down, – up");
    top.press("?");
    top.shows("It is no emergency stop");
    top.press("s");
    top.shows(" IDLE ");
    top.shows("safe stop, asked for by");
    top.press("a");
    top.shows("a once more arms the console");
    top.press("x");
    top.shows("safe stop");
    top.press("aa");
    top.shows(" ARMED ");
    top.press("p");
    top.shows("paused");
    top.press("p");
    top.until("going on", |screen| {
        (!screen.contains("paused")).then_some(())
    });
    top.signal(Signal::TERM);
    assert_eq!(top.ended(), 0);
    assert!(top.is_sane(), "{}", top.screen());
    // The session goes on without it.
    let mut again = Terminal::start(&["top"], &[("XDG_RUNTIME_DIR", &place)]);
    again.shows(" ARMED ");
    assert_eq!(session.stop().0, 0);
    assert_eq!(again.ended(), 0);
    assert!(again.is_sane());
    again.shows("it has ended");
}

/// `q` ends a session that has its figures in place of the bar; its summary is on a terminal that is as it was.
#[test]
fn a_session_with_figures_leaves_its_summary() {
    let (_folder, place) = place();
    let arguments = ["run", "--top", "--seconds", "3600", "--rearm"];
    let mut run = Terminal::start(&arguments, &[("XDG_RUNTIME_DIR", &place)]);
    run.until("a tick", tick);
    // It opens no port that nobody has asked for.
    assert!(!Path::new(&place).join("sutura").exists());
    run.press("s");
    run.shows(" IDLE ");
    run.press("aa");
    run.shows(" ARMED ");
    run.press("q");
    run.ended();
    assert!(run.is_sane());
    let (_, said) = run.finish();
    assert!(said.contains("s by the console's clock"), "{said}");
    assert!(!said.contains("see it"), "{said}");
}

/// Without a terminal there is a line a second, or an object.
#[test]
fn without_a_terminal_there_are_lines() {
    let (_folder, place) = place();
    let session = view(&place);
    for format in ["text", "json"] {
        let mut command = top(&place);
        let command = command.args(["--format", format]);
        let mut child = command.stdout(Stdio::piped()).spawn().unwrap();
        let lines = BufReader::new(child.stdout.take().unwrap()).lines();
        let two: Vec<String> = lines.take(2).map(Result::unwrap).collect();
        let time = |line: &String| -> f64 {
            match serde_json::from_str::<Value>(line) {
                Ok(gauges) => gauges["time_s"].as_f64().unwrap(),
                Err(_) => line.split(' ').next().unwrap().parse().unwrap(),
            }
        };
        assert!(time(&two[1]) > time(&two[0]), "{two:?}");
        assert_eq!(two[0].starts_with('{'), format == "json");
        // Whoever read has gone: it ends by itself.
        kill_process(Pid::from_child(&child), Signal::INT).unwrap();
        assert!(child.wait().unwrap().success());
    }
    assert_eq!(session.stop().0, 0);
}

/// Every session has a file of its own; of several one is chosen by its address.
#[test]
fn several_sessions_are_told_apart() {
    let (_folder, place) = place();
    let none = ran(&mut top(&place));
    assert_eq!(none.code, 2);
    assert!(none.stderr.contains("sutura view"), "{}", none.stderr);
    let (one, two) = (view(&place), view(&place));
    let files = || {
        let files = std::fs::read_dir(Path::new(&place).join("sutura")).unwrap();
        files.count()
    };
    assert_eq!(files(), 2);
    let asked = ran(&mut top(&place));
    assert_eq!(asked.code, 2);
    for address in [&one.address, &two.address] {
        assert!(asked.stderr.contains(address.as_str()), "{}", asked.stderr);
    }
    let mut command = top(&place);
    let command = command.arg(format!("http://{}", two.address));
    let mut chosen = command.stdout(Stdio::piped()).spawn().unwrap();
    let mut line = String::new();
    let mut reader = BufReader::new(chosen.stdout.take().unwrap());
    reader.read_line(&mut line).unwrap();
    assert!(line.contains(" N "), "{line}");
    assert_eq!(two.stop().0, 0);
    assert!(chosen.wait().unwrap().success(), "its session has ended");
    assert_eq!(files(), 1);
    // One that was killed leaves its file, and is passed over.
    let gone = Path::new(&place).join("sutura/session-1.json");
    std::fs::write(
        &gone,
        r#"{"address":"127.0.0.1","port":1,"key":"k","pid":1}"#,
    )
    .unwrap();
    let mut only = Terminal::start(&["top"], &[("XDG_RUNTIME_DIR", &place)]);
    only.until("a tick", tick);
    only.press("q");
    assert_eq!(only.ended(), 0);
    let address = one.address.clone();
    let mut wrong = top(&place);
    let wrong = ran(wrong.arg(format!("http://{address}/#key=0123")));
    assert_eq!(wrong.code, 2);
    assert!(wrong.stderr.contains("another key"), "{}", wrong.stderr);
    assert_eq!(one.stop().0, 0);
}

/// A server that takes the connection, and then does this with it until it is closed.
fn server(then: fn(TcpStream)) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    std::thread::spawn(move || {
        if let Ok((stream, _)) = listener.accept() {
            then(stream);
        }
    });
    format!("http://{address}/#key=0123")
}

/// Says the same for ever.
fn flood(stream: TcpStream, message: &Message) {
    let mut socket = accept(stream).unwrap();
    while socket.send(message.clone()).is_ok() {}
}

/// A server that takes a connection and has no session is told within a limit: silent before the handshake or after it, or never silent.
#[test]
fn servers_that_say_of_no_session_are_not_waited_for() {
    let (_folder, place) = place();
    let kinds: [fn(TcpStream); 5] = [
        |mut stream| while stream.read(&mut [0; 512]).is_ok_and(|count| count > 0) {},
        |mut stream| while stream.write_all(b"H").is_ok() {},
        |stream| {
            let mut socket = accept(stream).unwrap();
            while socket.read().is_ok() {}
        },
        |stream| flood(stream, &Message::text("{}")),
        |stream| flood(stream, &Message::Ping("".into())),
    ];
    // All at once: each takes as long as the limit.
    let started = kinds.map(|then| {
        let mut command = top(&place);
        let command = command.arg(server(then)).stdout(Stdio::piped());
        command.stderr(Stdio::piped()).spawn().unwrap()
    });
    for child in started {
        let ended = child.wait_with_output().unwrap();
        let said = String::from_utf8_lossy(&ended.stderr);
        assert_eq!(ended.status.code(), Some(2), "{said}");
        assert!(said.contains("cannot be reached"), "{said}");
        assert!(said.contains("is it still running?"), "{said}");
    }
}
