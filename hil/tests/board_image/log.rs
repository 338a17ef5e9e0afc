//! The log: what comes over USB and what a probe finds, when somebody reads it and when nobody does.

use super::{Bench, On};
use std::time::Duration;
use sutura_board::{Line, LogBytes, LogError, LogImage, LogPlace, follow};
use sutura_shared::wire::message::{Command, Mode};

fn words(on: On) -> LogImage {
    LogImage::read(&on.image()).unwrap_or_else(|error| panic!("{error}"))
}

/// Pieces of a log; after them the console is gone.
struct Pieces(Vec<Vec<u8>>);

impl LogBytes for Pieces {
    fn read(&mut self, _: Duration) -> Result<Vec<u8>, LogError> {
        let gone = || LogError::Gone {
            source: std::io::ErrorKind::NotConnected.into(),
        };
        self.0.pop().ok_or_else(gone)
    }
}

/// What waits on the log's endpoint, so many bytes at a time.
fn packets(bench: &mut Bench, length: usize) -> Pieces {
    let bytes = bench.board.take_log().unwrap();
    Pieces(bytes.chunks(length).rev().map(<[u8]>::to_vec).collect())
}

/// The lines of all pieces.
fn followed(words: &LogImage, mut pieces: Pieces) -> Result<Vec<Line>, LogError> {
    let (mut left, mut lines) = (pieces.0.len(), Vec::new());
    let enough = || {
        left = left.wrapping_sub(1);
        left == usize::MAX
    };
    follow(&mut pieces, words, enough, |line| lines.push(line.clone()))?;
    Ok(lines)
}

on_each_board!(the_host_finds_the_log_beside_the_port_by_its_class);
fn the_host_finds_the_log_beside_the_port_by_its_class(on: On) {
    let mut board = on.start();
    let said = board.enumerate().unwrap();
    let place = LogPlace::find(&said.configuration).unwrap();
    assert_eq!((place.interface, place.endpoint), (2, 0x83));
    let name = board.string(place.name.unwrap().get()).unwrap();
    assert_eq!(name, on.name());
}

on_each_board!(a_log_is_followed_until_it_ends_or_is_another_images);
fn a_log_is_followed_until_it_ends_or_is_another_images(on: On) {
    let words = words(on);
    let mut bench = Bench::start(on);
    let mut pieces = packets(&mut bench, 64);
    // Noise after a line that is known is one line that is not; the next one is known again.
    let started = pieces.0.clone();
    let noise = || vec![0x11, 0x22, 0x33, 0];
    pieces.0.extend(vec![noise(); 4]);
    pieces.0.extend(started);
    let lines = followed(&words, Pieces(pieces.0.clone())).unwrap();
    let known = texts(&lines).iter().filter(|text| **text != "?").count();
    assert_eq!((known, lines.len()), (4, 8), "{lines:?}");
    // Noise alone is another image's log.
    let other = followed(&words, Pieces(vec![noise(); 3])).unwrap_err();
    assert!(matches!(other, LogError::OtherImage), "{other}");
    // Who is gone is told of.
    let gone = follow(&mut pieces, &words, || false, |_| {}).unwrap_err();
    assert!(gone.to_string().contains("broke off"), "{gone}");
}

/// What lines say, with `?` for what the image cannot have said.
fn texts(lines: &[Line]) -> Vec<&str> {
    let texts = lines.iter().map(|line| line.text.as_deref());
    texts.map(|text| text.unwrap_or("?")).collect()
}

on_each_board!(what_happens_is_read_over_usb_and_by_a_probe);
fn what_happens_is_read_over_usb_and_by_a_probe(on: On) {
    let words = words(on);
    let mut by_probe = words.lines();
    let mut bench = Bench::start(on);
    bench.arm();
    bench.say(&Command::Disarm);
    bench.tick();
    bench.board.touch(1200).unwrap();
    for _ in 0..3 {
        bench.tick();
    }
    let usb = followed(&words, packets(&mut bench, 7)).unwrap();
    let probe = by_probe.of(&bench.board.take_probe_log().unwrap());
    assert_eq!(usb, probe);
    assert_eq!(
        texts(&usb),
        [
            "started, reset cause 1",
            "mode 1",
            "mode 2",
            "mode 1",
            "not at rest: not going into the loader"
        ]
    );
    let levels: Vec<_> = usb.iter().map(|line| line.level).collect();
    assert_eq!(levels, ["info", "info", "info", "info", "warn"]);
    // Console time: before the first tick, in the one after it, which leaves `Boot`, and in the last but two.
    let ticks = bench.board.ticks();
    let times: Vec<u64> = usb.iter().map(|line| microseconds(&line.time)).collect();
    assert_eq!(times[..2], [0, 2000]);
    assert_eq!(times[4], 1000 * (ticks - 2), "{times:?}");
    assert!(times.is_sorted(), "{times:?}");
    // And no more.
    assert!(bench.board.take_log().unwrap().is_empty());
    assert!(bench.board.take_probe_log().unwrap().is_empty());
}

on_each_board!(a_chip_without_brown_out_level_3_says_so_at_every_start);
/// As chips come from their maker: off. The option bits of a console have level 3, and it says nothing.
pub(super) fn a_chip_without_brown_out_level_3_says_so_at_every_start(on: On) {
    let words = words(on);
    for (level, said) in [(0, None), (1, Some(1)), (2, Some(2)), (3, Some(3))] {
        let mut board = on.power_up();
        board.chip().brown_out = level;
        board.boot().unwrap();
        let mut bench = Bench::of(on, board);
        bench.open();
        let lines = words.lines().of(&bench.board.take_log().unwrap());
        let told = said.map(|level| {
            format!("brown-out level 3 is not set (BOR_LEV = {level}, not 0): see the wiring page")
        });
        let told: Vec<_> = told.iter().map(String::as_str).collect();
        let expected = [&told[..], &["started, reset cause 1", "mode 1"]].concat();
        assert_eq!(texts(&lines), expected);
    }
}

on_each_board!(clocks_a_tenth_apart_are_told_of_and_clocks_a_little_apart_are_not);
/// More than 5 % in a hundred ticks, either way, is a line of the log every hundred ticks, and no fault.
fn clocks_a_tenth_apart_are_told_of_and_clocks_a_little_apart_are_not(on: On) {
    let words = words(on);
    let mut lines = words.lines();
    let mut bench = Bench::start(on);
    let mut hundred = |bench: &mut Bench| {
        bench.tick();
        while !bench.board.ticks().is_multiple_of(100) {
            assert_eq!(bench.tick().faults, 0);
        }
        lines.of(&bench.board.take_log().unwrap())
    };
    hundred(&mut bench);
    for (percent, told) in [(104, 0), (110, 1), (90, 1), (96, 0)] {
        bench.board.chip().lines.systick_per_tick = 210 * percent;
        let line = format!("SysTick has run at {percent} % of the tick timer");
        assert_eq!(texts(&hundred(&mut bench)), vec![line.as_str(); told]);
    }
}

/// Of `1.002000` seconds.
fn microseconds(time: &str) -> u64 {
    let (seconds, rest) = time.split_once('.').unwrap_or((time, "0"));
    seconds.parse::<u64>().unwrap() * 1_000_000 + rest.parse::<u64>().unwrap()
}

on_each_board!(a_log_that_nobody_reads_costs_no_tick_and_what_is_lost_is_told);
/// Modes change until both rings are full: who comes then finds how it began, and how much is missing.
fn a_log_that_nobody_reads_costs_no_tick_and_what_is_lost_is_told(on: On) {
    let words = words(on);
    let mut lines = words.lines();
    let mut bench = Bench::start(on);
    for change in 0..260 {
        let command = if change % 2 == 0 {
            Command::Arm
        } else {
            Command::Disarm
        };
        bench.say(&command);
        bench.tick();
    }
    assert_eq!(bench.report.unwrap().tick_overruns, 0);
    // What had been given to the endpoint has been taken by nobody; the ring behind it is full.
    let first = lines.of(&bench.board.take_log().unwrap());
    assert_eq!(
        texts(&first)[..3],
        ["started, reset cause 1", "mode 1", "mode 2"]
    );
    for (at, text) in texts(&first).iter().enumerate().skip(2) {
        assert_eq!(
            *text,
            if at % 2 == 0 { "mode 2" } else { "mode 1" },
            "line {at}"
        );
    }
    // 260 changes, "started" and the first mode, less those that came.
    let missing = 262 - first.len();
    assert!(missing > 50, "{missing}");
    bench.tick();
    bench.tick();
    let told = lines.of(&bench.board.take_log().unwrap());
    let [line] = &told[..] else {
        panic!("{told:?}");
    };
    let text = line.text.as_deref().unwrap();
    assert!(
        text.starts_with("lines lost so far: ") && text.ends_with(&format!(", {missing} over USB")),
        "{text}"
    );
    // Nobody reads the probe's: it has the first ones, and lost the same, and that line.
    let probe = words.lines().of(&bench.board.take_probe_log().unwrap());
    assert_eq!(
        texts(&probe)[..3],
        ["started, reset cause 1", "mode 1", "mode 2"]
    );
    assert!(bench.tick().mode == Mode::Idle);
}

on_each_board!(a_line_of_the_log_in_every_tick_takes_nothing_of_the_port);
/// What a flooded port takes, with a mode that changes in every tick, and a host that reads of it; and with one that does not. The log is on
/// because the two are within 2 % of each other.
fn a_line_of_the_log_in_every_tick_takes_nothing_of_the_port(on: On) {
    const TICKS: usize = 100;
    let flooded = |changes: bool| {
        let mut bench = Bench::start(on);
        bench.compares = false;
        bench.board.take_log().unwrap();
        let (mut taken, mut logged) = (0, 0);
        for tick in 0..TICKS {
            bench.say(&match changes && tick % 2 == 0 {
                true => Command::Arm,
                false => Command::Disarm,
            });
            // 1 MB/s.
            while bench.board.waiting() + bench.down.len().div_ceil(64) < 16 {
                let contact = bench.floor();
                bench.say(&contact);
            }
            let waiting = bench.board.waiting() + bench.down.len().div_ceil(64);
            bench.try_tick().unwrap_or_else(|error| panic!("{error}"));
            taken += waiting - bench.board.waiting();
            logged += bench.board.take_log().unwrap().len();
        }
        eprintln!("{taken} packets down, {logged} bytes of log");
        (taken, logged)
    };
    let (quiet, none) = flooded(false);
    let (told, bytes) = flooded(true);
    assert!(none == 0 && bytes > 4 * TICKS, "{none}, {bytes}");
    assert!(quiet > 10 * TICKS, "{quiet}");
    assert!(50 * told.abs_diff(quiet) <= quiet, "{told}, {quiet}");
}
