//! The self-test's images, with jumpers and without: what each line says, and that they go on after the resets that they make.

use super::{On, TIME_LIMIT, known};
use std::collections::BTreeSet;
use sutura_hil::board_image::{BoardImage, BoardImageError, default_selftest, reset};

/// Ticks after which a self-test has ended.
const MOST_TICKS: usize = 4000;
/// Ticks that a self-test waits before it lets a watchdog run out, about.
const ANNOUNCED: usize = 53;

/// What the host is asked to send, and what it gets by the thousand.
const PATTERN: &[u8; 26] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZ";
const FILLER: char = '~';

/// A board, and what it has said.
struct Desk {
    board: BoardImage,
    text: String,
    lines: Vec<String>,
    fillers: usize,
}

impl Desk {
    fn new(on: On, jumpers: bool) -> Desk {
        let image = known(&default_selftest(on.board));
        let board = BoardImage::power_up(on.board, image, TIME_LIMIT);
        let mut board = board.unwrap_or_else(|e| panic!("{e}"));
        board.chip().lines.jumpers = jumpers;
        board.boot().unwrap_or_else(|e| panic!("{e}"));
        board.enumerate().unwrap_or_else(|e| panic!("{e}"));
        for _ in 0..20 {
            board.tick().unwrap();
        }
        assert!(board.take().is_empty(), "nobody has asked");
        board.send(b"t");
        Desk {
            board,
            text: String::new(),
            lines: Vec::new(),
            fillers: 0,
        }
    }

    /// Until a line begins like this.
    fn run_to(&mut self, last: &str) {
        for _ in 0..MOST_TICKS {
            let ticked = self.board.tick();
            ticked.unwrap_or_else(|e| panic!("{e}, after {:#?}", self.lines));
            let said = self.board.take();
            self.text.push_str(std::str::from_utf8(&said).unwrap());
            while let Some((line, rest)) = self.text.split_once("\r\n") {
                let (line, rest) = (line.to_owned(), rest.to_owned());
                self.text = rest;
                self.obey(&line);
                if line.starts_with(last) {
                    return;
                }
            }
        }
        panic!("it has not come to `{last}`: {:#?}", self.lines);
    }

    fn obey(&mut self, line: &str) {
        match line.split_once(' ') {
            Some(("send", count)) => {
                let pattern = PATTERN.iter().copied().cycle();
                let bytes: Vec<u8> = pattern.take(count.parse().unwrap()).collect();
                self.board.send(&bytes);
            }
            Some(("next", "window_watchdog")) => {
                let fed = self.runs_out(ANNOUNCED + 49);
                let feeds = self.board.chip().feeds;
                assert!(feeds.window == fed.window && feeds.independent > fed.independent);
                is_reset(self.board.window_watchdog().map(|_| ()));
                self.goes_on(reset::SOFTWARE);
            }
            Some(("next", "independent_watchdog")) => {
                let fed = self.runs_out(ANNOUNCED + 100);
                let feeds = self.board.chip().feeds;
                assert!(feeds.window > fed.window && feeds.independent == fed.independent);
                self.goes_on(reset::INDEPENDENT_WATCHDOG);
            }
            Some(("next", "clock_security")) => {
                let ticked = (0..2 * ANNOUNCED).try_for_each(|_| self.board.tick_without_idle());
                is_reset(ticked);
                self.goes_on(reset::SOFTWARE);
            }
            Some(("next", other)) => panic!("{other}"),
            _ if line.starts_with(FILLER) => {
                assert_eq!(line.len(), 62, "{line}");
                self.fillers += 1;
            }
            _ => self.lines.push(line.to_owned()),
        }
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

    /// Through a reset, with the cable plugged in again.
    fn goes_on(&mut self, cause: u32) {
        let again = self.board.boot_again(cause);
        again.unwrap_or_else(|e| panic!("{e}"));
        self.board.enumerate().unwrap_or_else(|e| panic!("{e}"));
        self.board.send(b"c");
        self.text.clear();
    }

    fn end(mut self) -> Vec<String> {
        assert!(!self.board.chip().outputs().enable, "left on");
        eprintln!("{}\n{}", self.lines.join("\n"), self.board.speed());
        self.lines
    }
}

fn is_reset(outcome: Result<(), BoardImageError>) {
    assert!(
        matches!(outcome, Err(BoardImageError::Reset)),
        "{outcome:?}"
    );
}

fn names<'a>(lines: &'a [String], verdict: &str) -> Vec<&'a str> {
    let of = |line: &'a String| line.split_once(' ').filter(|(is, _)| *is == verdict);
    let names = lines.iter().filter_map(of);
    names
        .filter_map(|(_, rest)| rest.split(' ').next())
        .collect()
}

on_each_board!(with_its_jumpers_a_board_fails_only_what_the_emulator_lacks);
fn with_its_jumpers_a_board_fails_only_what_the_emulator_lacks(on: On) {
    let mut desk = Desk::new(on, true);
    desk.run_to("end ");
    assert_eq!(desk.fillers, 16_384 / 64);
    let lines = desk.end();
    // No cycle counter.
    assert_eq!(names(&lines, "FAIL"), ["clocks"]);
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
    assert_eq!(names(&lines, "pass"), passed);
    // Every case that `cargo xtask firmware` counts, the application's locks and lengths of frames apart.
    let text = include_str!("../../../firmware/snapshots/instructions.json");
    let snapshot: serde_json::Value = serde_json::from_str(text).unwrap();
    let cases = snapshot["figures"].as_object().unwrap().keys();
    let mut expected: BTreeSet<&str> = cases
        .map(String::as_str)
        .filter(|name| !name.ends_with("_bytes"))
        .filter(|name| !["contact_swap", "contact_take", "state_swap", "state_take"].contains(name))
        .collect();
    expected.extend(["stop_cuts", "rows_a_second", "usb_down", "usb_up"]);
    let untimed: BTreeSet<&str> = names(&lines, "untimed").into_iter().collect();
    assert_eq!(untimed, expected);
    let end = format!(
        "end {} passed 1 failed {} untimed",
        passed.len(),
        expected.len()
    );
    assert_eq!(lines.last(), Some(&end));
    for line in [
        "pass encoder_3_backward -400 of -400 counts",
        "pass clock_security on; an NMI: cause 5, epitaph 3 at -14",
        "untimed usb_down 16384 bytes, as they were sent",
    ] {
        assert!(lines.contains(&line.to_owned()), "{line}: {lines:#?}");
    }
}

on_each_board!(without_jumpers_each_check_of_theirs_fails);
fn without_jumpers_each_check_of_theirs_fails(on: On) {
    let mut desk = Desk::new(on, false);
    desk.run_to("FAIL encoder_3_backward");
    let expected = [
        "clocks",
        "stop_line",
        "ready_line",
        "stop_cuts",
        "encoder_1_forward",
        "encoder_2_forward",
        "encoder_3_forward",
        "encoder_1_backward",
        "encoder_2_backward",
        "encoder_3_backward",
    ];
    assert_eq!(names(&desk.end(), "FAIL"), expected);
}
