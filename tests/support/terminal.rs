//! The `sutura` command at a terminal of its own: what is on its screen, keys, and how it leaves the terminal.

#![allow(clippy::unwrap_used, reason = "tests")]

use super::root;
use rustix::fs::{Mode, OFlags};
use rustix::process::{Pid, Signal, kill_process};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{LocalModes, Winsize, tcgetattr, tcsetwinsize};
use std::fs::File;
use std::io::{Read as _, Write as _};
use std::num::NonZero;
use std::os::fd::OwnedFd;
use std::process::{Child, Command};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// Long enough for anything on a busy machine.
const LONG: Duration = Duration::from_secs(120);

const ROWS: NonZero<u16> = NonZero::new(24).unwrap();
const COLUMNS: NonZero<u16> = NonZero::new(80).unwrap();

/// A pseudo-terminal of 80 x 24, and a program on it.
pub struct Terminal {
    line: File,
    /// Kept open, so that what is written last can be read.
    end: OwnedFd,
    child: Child,
    seen: Arc<Mutex<Seen>>,
}

struct Seen {
    screen: vt100::Parser,
    /// All that came.
    bytes: Vec<u8>,
}

impl Terminal {
    /// Starts the command in a session whose terminal this is. Nothing of a desktop is in its environment but `variables`.
    pub fn start(arguments: &[&str], variables: &[(&str, &str)]) -> Terminal {
        let line = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
        grantpt(&line).unwrap();
        unlockpt(&line).unwrap();
        let name = ptsname(&line, Vec::new()).unwrap();
        let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC;
        let end = rustix::fs::open(&name, flags, Mode::empty()).unwrap();
        let size = Winsize {
            ws_row: ROWS.get(),
            ws_col: COLUMNS.get(),
            ws_xpixel: 0,
            ws_ypixel: 0,
        };
        tcsetwinsize(&end, size).unwrap();
        // Of util-linux, which every Linux has: makes its standard input the terminal of a new session.
        let mut command = Command::new("setsid");
        command.arg("--ctty").arg(env!("CARGO_BIN_EXE_sutura"));
        command.args(arguments).current_dir(root());
        for name in ["DISPLAY", "WAYLAND_DISPLAY", "SSH_CONNECTION", "RUST_LOG"] {
            command.env_remove(name);
        }
        command.env("TERM", "xterm-256color");
        command.envs(variables.iter().copied());
        let clone = || end.try_clone().unwrap();
        let child = command.stdin(clone()).stdout(clone()).stderr(clone());
        let child = child.spawn().unwrap();
        let seen = Arc::new(Mutex::new(Seen {
            screen: vt100::Parser::new(ROWS, COLUMNS, 0),
            bytes: Vec::new(),
        }));
        let line = File::from(line);
        let (mut from, sees) = (line.try_clone().unwrap(), seen.clone());
        std::thread::spawn(move || {
            let mut bytes = [0; 4096];
            while let Ok(count @ 1..) = from.read(&mut bytes) {
                let mut seen = sees.lock().unwrap();
                seen.screen.process(&bytes[..count]);
                seen.bytes.extend_from_slice(&bytes[..count]);
            }
        });
        Terminal {
            line,
            end,
            child,
            seen,
        }
    }

    /// What is on the screen.
    pub fn screen(&self) -> String {
        self.seen.lock().unwrap().screen.screen().contents()
    }

    /// Waits until `found` finds something on the screen.
    pub fn until<T>(&self, what: &str, found: impl Fn(&str) -> Option<T>) -> T {
        let began = Instant::now();
        loop {
            let screen = self.screen();
            if let Some(found) = found(&screen) {
                return found;
            }
            assert!(began.elapsed() < LONG, "no {what} on the screen:\n{screen}");
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Waits until these words are on the screen.
    pub fn shows(&self, words: &str) {
        self.until(words, |screen| screen.contains(words).then_some(()));
    }

    /// Presses keys.
    pub fn press(&mut self, keys: &str) {
        self.line.write_all(keys.as_bytes()).unwrap();
    }

    /// Sends a signal.
    pub fn signal(&self, signal: Signal) {
        kill_process(Pid::from_child(&self.child), signal).unwrap();
    }

    /// Whether lines are edited and echoed as a shell wants them.
    pub fn is_sane(&self) -> bool {
        let modes = tcgetattr(&self.end).unwrap().local_modes;
        let sane = LocalModes::ICANON | LocalModes::ECHO | LocalModes::ISIG;
        let seen = self.seen.lock().unwrap();
        let screen = seen.screen.screen();
        modes.contains(sane) && !screen.alternate_screen() && !screen.hide_cursor()
    }

    /// Waits for the program's end: its exit code, and all that it wrote.
    pub fn finish(mut self) -> (i32, String) {
        let code = self.ended();
        let seen = self.seen.lock().unwrap();
        (code, String::from_utf8_lossy(&seen.bytes).replace('\r', ""))
    }

    /// Waits for the program's end: its exit code.
    pub fn ended(&mut self) -> i32 {
        let began = Instant::now();
        let status = loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                break status;
            }
            assert!(
                began.elapsed() < LONG,
                "it does not end:\n{}",
                self.screen()
            );
            std::thread::sleep(Duration::from_millis(20));
        };
        // What has been written last may still be on its way.
        let mut before = usize::MAX;
        while before != self.seen.lock().unwrap().bytes.len() {
            before = self.seen.lock().unwrap().bytes.len();
            std::thread::sleep(Duration::from_millis(200));
        }
        status.code().expect("it ends by itself")
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        // It has ended, or a test has failed.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
