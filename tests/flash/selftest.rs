//! A self-test's whole way: `sutura flash` writes it to a board that runs a console's image, the chip starts from what is in its flash then, and
//! `sutura device selftest` hears it to its end, through the resets that it makes. The chip is QEMU with a stand-in for what that lacks.

use super::Bench;
use crate::support::{Ran, root};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;
use sutura_board::Image;
use sutura_hil::Pty;
use sutura_hil::board_image::{Board, BoardImage, BoardImageError, default_image};
use sutura_hil::board_image::{default_selftest, provenance, reset};
use sutura_host::link::Port;

/// For a run that hangs, on a machine that does other things.
const TIME_LIMIT: Duration = Duration::from_secs(1500);
/// Ticks that a self-test waits before it lets a watchdog run out, about.
const ANNOUNCED: usize = 53;
/// An image says every second of its own that it is busy. Those of the emulator are longer than the host's, who is told at his.
const BUSY: (&[u8], Duration) = (b"busy emulator\r\n", Duration::from_secs(1));

#[test]
fn olimex_h405() {
    goes_its_whole_way(Board::OLIMEX_H405, "07*128Kg");
}

#[test]
fn nucleo_f446ze() {
    goes_its_whole_way(Board::NUCLEO_F446ZE, "03*128Kg");
}

/// `sectors`: how the board's loader names the larger ones.
fn goes_its_whole_way(board: Board, sectors: &str) {
    let bench = Bench::new();
    let console = Image::read(&known(&default_image(board))).unwrap();
    bench.fill(&console.bytes);
    bench.clear("loader");
    bench.set("comes", sectors);
    let elf = known(&default_selftest(board));
    let running = Pty::open().unwrap();
    let elf_path = elf.to_string_lossy();
    let done = bench.run(&[&elf_path, "--port", running.path(), "--format", "json"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let json = done.json();
    assert_eq!(
        (&json["image"], &json["board"], &json["method"]),
        (&"selftest".into(), &board.name().into(), &"touch".into())
    );
    let replaced = json["replaced"].as_str().unwrap();
    assert!(replaced.starts_with("console "), "{replaced}");
    let bytes = Image::read(&elf).unwrap().bytes;
    assert!(bench.flash()[..bytes.len()] == bytes);

    let report = bench.path("selftest.txt");
    let heard = Desk::power_up(board, &bench).hear(&report);
    // No cycle counter.
    assert_eq!(heard.code, 1, "{}", heard.stderr);
    let mut lines: Vec<&str> = heard.stdout.lines().collect();
    let end = lines.pop().unwrap();
    let kept = std::fs::read_to_string(&report).unwrap();
    assert!(kept.lines().eq(lines.iter().copied()), "{kept}");
    check(&lines, end);
    let says = format!("1 of {} checks failed: clocks", lines.len());
    assert!(heard.stderr.contains(&says), "{}", heard.stderr);
}

/// An image that is what these sources make.
fn known(image: &Path) -> PathBuf {
    let known = provenance(image).unwrap_or_else(|error| panic!("{error}"));
    known.image
}

fn names<'a>(lines: &[&'a str], verdict: &str) -> Vec<&'a str> {
    let of = |line: &&'a str| line.split_once(' ').filter(|(is, _)| *is == verdict);
    let names = lines.iter().filter_map(of);
    names
        .filter_map(|(_, rest)| rest.split(' ').next())
        .collect()
}

/// Everything that an emulator can tell passes.
fn check(lines: &[&str], end: &str) {
    assert_eq!(names(lines, "FAIL"), ["clocks"]);
    let passed = [
        "reset",
        "time_base",
        "supply",
        "stop_line",
        "ready_line",
        "encoder_1_forward",
        "encoder_2_forward",
        "encoder_3_forward",
        "encoder_1_backward",
        "encoder_2_backward",
        "encoder_3_backward",
        "identity_trace",
        "window_watchdog",
        "independent_watchdog",
        "clock_security",
    ];
    assert_eq!(names(lines, "pass"), passed);
    // Every case that `cargo xtask firmware` counts, the application's locks and lengths of frames apart.
    let text = include_str!("../../firmware/snapshots/instructions.json");
    let snapshot: serde_json::Value = serde_json::from_str(text).unwrap();
    let cases = snapshot["figures"].as_object().unwrap().keys();
    let mut expected: BTreeSet<&str> = cases
        .map(String::as_str)
        .filter(|name| !name.ends_with("_bytes"))
        .filter(|name| !["contact_swap", "contact_take", "state_swap", "state_take"].contains(name))
        .collect();
    expected.extend(["stop_cuts", "rows_a_second", "usb_down", "usb_up"]);
    let untimed: BTreeSet<&str> = names(lines, "untimed").into_iter().collect();
    assert_eq!(untimed, expected);
    let counts = format!(
        "end {} passed 1 failed {} untimed",
        passed.len(),
        expected.len()
    );
    assert_eq!(end, counts);
    for line in [
        "pass encoder_3_backward -400 of -400 counts",
        "pass clock_security on; an NMI: cause 5, epitaph 3 at -14",
        "untimed usb_down 16384 bytes, as they were sent",
    ] {
        assert!(lines.contains(&line), "{line}: {lines:#?}");
    }
}

/// The host's end of the cable, which a reset of the board pulls out and plugs in again, under the same name.
struct Cable {
    name: PathBuf,
    port: Arc<Mutex<Pty>>,
    /// Between two lines.
    whole: Arc<Mutex<bool>>,
    over: Option<Sender<()>>,
    busy: Option<JoinHandle<()>>,
}

impl Cable {
    fn plug(name: PathBuf) -> Cable {
        let port = Pty::open().unwrap();
        std::os::unix::fs::symlink(port.path(), &name).unwrap();
        let (port, whole) = (Arc::new(Mutex::new(port)), Arc::new(Mutex::new(true)));
        let (over, wait) = mpsc::channel();
        let for_busy = (port.clone(), whole.clone());
        let busy = std::thread::spawn(move || {
            let (port, whole) = for_busy;
            while wait.recv_timeout(BUSY.1) == Err(RecvTimeoutError::Timeout) {
                if *whole.lock().unwrap() {
                    port.lock().unwrap().write(BUSY.0).unwrap();
                }
            }
        });
        Cable {
            name,
            port,
            whole,
            over: Some(over),
            busy: Some(busy),
        }
    }

    /// What the host has sent.
    fn take(&self) -> Vec<u8> {
        let mut bytes = [0; 4096];
        let mut port = self.port.lock().unwrap();
        let count = port.read(&mut bytes, Duration::ZERO).unwrap();
        bytes[..count].to_vec()
    }

    fn give(&self, mut bytes: &[u8]) {
        let Some(last) = bytes.last() else {
            return;
        };
        let mut whole = self.whole.lock().unwrap();
        while !bytes.is_empty() {
            let sent = self.port.lock().unwrap().write(bytes).unwrap();
            bytes = &bytes[sent..];
        }
        *whole = *last == b'\n';
    }

    /// Once the host has read all.
    fn plug_again(&self) {
        while self.port.lock().unwrap().unread().unwrap() > 0 {
            std::thread::sleep(Duration::from_millis(5));
        }
        let new = Pty::open().unwrap();
        std::fs::remove_file(&self.name).unwrap();
        std::os::unix::fs::symlink(new.path(), &self.name).unwrap();
        *self.port.lock().unwrap() = new;
    }
}

impl Drop for Cable {
    fn drop(&mut self) {
        self.over.take();
        let _ = self.busy.take().map(JoinHandle::join);
    }
}

/// A board with jumpers, and its cable.
struct Desk {
    board: BoardImage,
    cable: Cable,
    /// A line that has not ended.
    rest: String,
    /// Lines of bytes for their own sake.
    fillers: usize,
}

impl Desk {
    /// From what is in the flash.
    fn power_up(board: Board, bench: &Bench) -> Desk {
        let image = BoardImage::power_up(board, bench.path("flash.bin"), TIME_LIMIT);
        let mut board = image.unwrap_or_else(|e| panic!("{e}"));
        board.chip().lines.jumpers = true;
        board.boot().unwrap_or_else(|e| panic!("{e}"));
        board.enumerate().unwrap_or_else(|e| panic!("{e}"));
        Desk {
            board,
            cable: Cable::plug(bench.path("console")),
            rest: String::new(),
            fillers: 0,
        }
    }

    /// Until `sutura device selftest` has heard enough.
    fn hear(mut self, report: &Path) -> Ran {
        let mut command = Command::new(env!("CARGO_BIN_EXE_sutura"));
        command.args(["device", "selftest"]).current_dir(root());
        command.arg(&self.cable.name).arg("--out").arg(report);
        command.env_remove("RUST_LOG").stdin(Stdio::null());
        command.stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut host = command.spawn().unwrap();
        while host.try_wait().unwrap().is_none() {
            self.board.send(&self.cable.take());
            self.board.tick().unwrap_or_else(|e| panic!("{e}"));
            let said = self.board.take();
            self.cable.give(&said);
            self.rest.push_str(std::str::from_utf8(&said).unwrap());
            while let Some((line, rest)) = self.rest.split_once("\r\n") {
                self.fillers += usize::from(line.starts_with('~'));
                let announced = line.strip_prefix("next ").map(str::to_owned);
                let bulk = line.strip_prefix("send ").map(str::to_owned);
                self.rest = rest.to_owned();
                if let Some(what) = announced {
                    self.resets(&what);
                    self.cable.plug_again();
                }
                if let Some(count) = bulk {
                    self.send_bulk(count.parse().unwrap());
                }
            }
        }
        assert!(!self.board.chip().outputs().enable, "left on");
        assert_eq!(self.fillers, 16_384 / 64);
        eprintln!("{}", self.board.speed());
        end(host)
    }

    /// Bytes that the image has asked for, all at once: ticks are not to run out while a busy machine keeps the host waiting.
    fn send_bulk(&mut self, count: usize) {
        let mut bytes = Vec::new();
        while bytes.len() < count {
            std::thread::sleep(Duration::from_millis(1));
            bytes.extend(self.cable.take());
        }
        self.board.send(&bytes);
    }

    /// What the image has announced, and the boot after it.
    fn resets(&mut self, what: &str) {
        let cause = match what {
            "window_watchdog" => {
                let fed = self.runs_out(ANNOUNCED + 49);
                let feeds = self.board.chip().feeds;
                assert!(feeds.window == fed.window && feeds.independent > fed.independent);
                is_reset(self.board.window_watchdog().map(|_| ()));
                reset::SOFTWARE
            }
            "independent_watchdog" => {
                let fed = self.runs_out(ANNOUNCED + 100);
                let feeds = self.board.chip().feeds;
                assert!(feeds.window > fed.window && feeds.independent == fed.independent);
                reset::INDEPENDENT_WATCHDOG
            }
            "clock_security" => {
                let ticked = (0..2 * ANNOUNCED).try_for_each(|_| self.board.tick_without_idle());
                is_reset(ticked);
                reset::SOFTWARE
            }
            other => panic!("{other}"),
        };
        let again = self.board.boot_again(cause);
        again.unwrap_or_else(|e| panic!("{e}"));
        self.board.enumerate().unwrap_or_else(|e| panic!("{e}"));
        self.rest.clear();
    }

    /// Ticks in which idle has no turn, and then a round of it: what was fed before.
    fn runs_out(&mut self, ticks: usize) -> sutura_hil::board_image::Feeds {
        let fed = self.board.chip().feeds;
        for _ in 0..ticks {
            self.board.tick_without_idle().unwrap();
        }
        self.board.idle_steps(400).unwrap();
        fed
    }
}

fn is_reset(outcome: Result<(), BoardImageError>) {
    assert!(
        matches!(outcome, Err(BoardImageError::Reset)),
        "{outcome:?}"
    );
}

/// What a command that has ended left behind: less than a pipe holds.
fn end(host: Child) -> Ran {
    let output = host.wait_with_output().unwrap();
    let text = |bytes| String::from_utf8(bytes).unwrap();
    Ran {
        code: output.status.code().unwrap(),
        stdout: text(output.stdout),
        stderr: text(output.stderr),
    }
}
