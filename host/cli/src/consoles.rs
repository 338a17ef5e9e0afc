//! `sutura device`: the consoles that are plugged in, what they log, and what a bare board says of itself.

use crate::failure::{Cause, Failure};
use crate::run::link_failure;
use crate::{Format, Global};
use clap::{Args, Subcommand};
use schemars::JsonSchema;
use serde::Serialize;
use std::io;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use sutura_host::link::{Port, consoles, open_serial};

/// Longest time between two lines of a self-test, which says every second that it is busy; a reset takes two.
const SILENCE: Duration = Duration::from_secs(5);
/// Longest self-test, however busy the board says it is.
const LONGEST: Duration = Duration::from_secs(600);
/// Time between two attempts to reach a board that resets itself.
const RETRY: Duration = Duration::from_millis(200);
/// What a self-test is told: to begin, and to go on after a reset.
const BEGIN: &[u8] = b"t";
const GO_ON: &[u8] = b"c";
/// What it is sent, in turn, when it asks for bytes; and what lines begin with that are only to be counted.
const PATTERN: &[u8] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZ";
const FILLER: char = '~';

/// Looks at consoles that are plugged in, reads their logs, and runs a bare board's self-test.
#[derive(Args, Debug)]
pub struct DeviceArgs {
    #[command(subcommand)]
    command: DeviceCommand,
}

const LIST_EXAMPLES: &str = "\
Examples:
  sutura device list                     port and serial number of every console on USB
  sutura device list --format json

A serial number is the chip's own. It goes wherever a port's name does, and stays when a port's name changes: `sutura run --console SERIAL`.
Boards behind a serial bridge have no such number: name their port.

Exit codes: 0 there are some, 3 there is none.";

const SELFTEST_EXAMPLES: &str = "\
Examples:
  sutura device selftest /dev/ttyACM0                       print what the board finds, line by line
  sutura device selftest /dev/ttyACM0 --out selftest.txt    and keep it

The board has the image sutura-selftest-BOARD of `cargo xtask firmware`, its jumpers (the wiring page), and NO AMPLIFIER: enable goes high.

Exit codes: 0 all passed, 1 something failed, 3 nothing on PORT answers as a self-test.";

const LOG_EXAMPLES: &str = "\
Examples:
  sutura device log 0043002B3438510B32363530                                   what that console logs, until Ctrl-C
  sutura device log 0043002B3438510B32363530 --elf sutura-nucleo-f446ze        in the words of this image

The words are in the ELF file that is on the console, not in what it sends. Without --elf: that of the last `cargo xtask firmware` here.
The log tells what it has lost; whoever comes late finds how it began.

Exit codes: 0 stopped, 2 no image, or not that console's, 3 no such console, or it broke off.";

#[derive(Subcommand, Debug)]
enum DeviceCommand {
    /// Port and serial number of every console on USB.
    #[command(after_help = LIST_EXAMPLES)]
    List,
    /// Has a board with jumpers and without amplifiers test itself.
    #[command(after_help = SELFTEST_EXAMPLES)]
    Selftest {
        /// The board's port, or its serial number.
        port: String,
        /// New file that the lines are written to.
        #[arg(short, long, value_name = "FILE")]
        out: Option<PathBuf>,
    },
    /// What a console on USB logs, until Ctrl-C.
    #[command(after_help = LOG_EXAMPLES)]
    Log {
        /// The console's serial number: see `sutura device list`.
        serial: String,
        /// The ELF file that is on it.
        #[arg(long, value_name = "FILE")]
        elf: Option<PathBuf>,
    },
}

/// Runs the command.
///
/// # Errors
/// No console is plugged in; a self-test that fails, or that nobody answers.
pub fn run(args: &DeviceArgs, global: &Global) -> Result<(), Failure> {
    match &args.command {
        DeviceCommand::List => list(global),
        DeviceCommand::Selftest { port, out } => {
            if let Some(out) = out {
                crate::files::free(out, global)?;
            }
            let open = open_serial(port).map_err(link_failure)?;
            // Its port may have another name after a reset.
            let same = consoles().into_iter().find(|console| console.port == *port);
            let name = same.map_or_else(|| port.clone(), |console| console.serial_number);
            let text = global.format == Format::Text;
            let say = |line: &str| {
                if text {
                    say!("{line}");
                }
            };
            let report = listen(open, || open_serial(&name).ok(), say, LONGEST)?;
            judge(&report, port, out.as_deref(), global)
        }
        DeviceCommand::Log { serial, elf } => log::run(serial, elf.as_deref(), global),
    }
}

#[cfg(feature = "log")]
mod log {
    //! `sutura device log`.

    use super::*;
    use crate::signals::stop_on_signals;
    use std::sync::atomic::Ordering;
    use sutura_board::{Line, LogError, LogImage, UsbLog, follow};

    /// Shows the log of a console.
    pub fn run(serial: &str, elf: Option<&Path>, global: &Global) -> Result<(), Failure> {
        // Before the console is looked for: a file that is named has to be good.
        let named = elf.map(LogImage::read).transpose().map_err(failure)?;
        let mut usb = UsbLog::open(serial).map_err(failure)?;
        let image = match named {
            Some(image) => image,
            None => LogImage::read(&last_built(&usb.board)).map_err(failure)?,
        };
        let stop = stop_on_signals()?;
        let stopped = || stop.load(Ordering::Relaxed);
        follow(&mut usb, &image, stopped, |line| show(line, global)).map_err(failure)
    }

    /// Where `cargo xtask firmware` puts a board's image.
    fn last_built(board: &str) -> PathBuf {
        format!("firmware/target/thumbv7em-none-eabihf/release/sutura-{board}").into()
    }

    fn show(line: &Line, global: &Global) {
        let text = line.text.as_deref();
        match global.format {
            Format::Json => crate::display::object(&Logged {
                time_s: line.time.parse().ok(),
                level: line.level,
                text,
            }),
            Format::Text => say!(
                "{:>14} {:5} {}",
                line.time,
                line.level,
                text.unwrap_or("(garbled)")
            ),
        }
    }

    fn failure(error: LogError) -> Failure {
        let cause = match error {
            LogError::Image(_) | LogError::NoWords { .. } | LogError::OtherImage => Cause::BadInput,
            _ => Cause::NoConsole,
        };
        Failure::new(cause, error)
    }
}

#[cfg(not(feature = "log"))]
mod log {
    //! In the place of a console's log in a build without it.

    use super::*;

    /// Says why there is none.
    pub fn run(_: &str, _: Option<&Path>, _: &Global) -> Result<(), Failure> {
        let message = "this program was built without a console's log in words";
        let help = "build it with the Cargo feature `log`: cargo run --release --features log";
        Err(Failure::say(Cause::BadInput, message, help))
    }
}

/// What `sutura device list --format json` prints.
#[derive(Serialize, JsonSchema)]
pub struct Listed {
    /// `ok`.
    status: &'static str,
    /// Every console that says so on USB.
    consoles: Vec<Plugged>,
}

/// A console on USB.
#[derive(Serialize, JsonSchema)]
struct Plugged {
    /// What `--console` opens.
    port: String,
    /// What it has in USB; `--console` takes that, too.
    serial_number: String,
}

/// What `sutura device selftest --format json` prints.
#[derive(Serialize, JsonSchema)]
pub struct Tested<'a> {
    /// `ok` or `failed`.
    status: &'static str,
    /// Where the board is.
    port: &'a str,
    /// Names of the checks that failed.
    failed: Vec<&'a str>,
    /// All of them.
    checks: &'a [Found],
}

/// A line of `sutura device log --format json`.
#[derive(Serialize, JsonSchema)]
pub struct Logged<'a> {
    /// On the console's clock \[s\]; none if the line is garbled.
    pub time_s: Option<f64>,
    /// How important it is.
    pub level: &'a str,
    /// What it says; none if it is garbled.
    pub text: Option<&'a str>,
}

fn list(global: &Global) -> Result<(), Failure> {
    let found = consoles();
    if found.is_empty() {
        return Err(Failure::say(
            Cause::NoConsole,
            "no console is plugged in, of those that say so on USB",
            "plug one in, in the USB connector of its board's own (not a probe's); `sutura doctor` shows all ports",
        ));
    }
    match global.format {
        Format::Json => {
            let consoles = found.iter().map(|console| Plugged {
                port: console.port.clone(),
                serial_number: console.serial_number.clone(),
            });
            crate::display::object(&Listed {
                status: "ok",
                consoles: consoles.collect(),
            });
        }
        Format::Text => {
            for console in &found {
                say!("{}  {}", console.serial_number, console.port);
            }
        }
    }
    Ok(())
}

/// What a board's self-test has said.
#[derive(Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
struct Report {
    checks: Vec<Found>,
}

/// A line of it.
#[derive(Debug, PartialEq, Eq, Serialize, JsonSchema)]
struct Found {
    /// Name of the check.
    name: String,
    /// How it ended.
    verdict: Verdict,
    /// What was measured, in the board's words.
    figure: String,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, JsonSchema)]
enum Verdict {
    /// As it should be.
    #[serde(rename = "pass")]
    Pass,
    /// Not as it should be.
    #[serde(rename = "FAIL")]
    Fail,
    /// The board's cycle counter stands: it is an emulator, or broken.
    #[serde(rename = "untimed")]
    Untimed,
}

impl Verdict {
    const WORDS: [(&str, Verdict); 3] = [
        ("pass", Verdict::Pass),
        ("FAIL", Verdict::Fail),
        ("untimed", Verdict::Untimed),
    ];

    fn word(self) -> &'static str {
        let mut words = Verdict::WORDS.into_iter();
        words
            .find_map(|(word, verdict)| (verdict == self).then_some(word))
            .unwrap_or_default()
    }
}

impl Found {
    /// `pass NAME FIGURE`, or `FAIL` or `untimed` in the place of `pass`.
    fn read(line: &str) -> Option<Found> {
        let (verdict, rest) = line.split_once(' ')?;
        let (name, figure) = rest.split_once(' ').unwrap_or((rest, ""));
        let mut words = Verdict::WORDS.into_iter();
        let verdict = words.find_map(|(word, is)| (word == verdict).then_some(is))?;
        let (name, figure) = (name.to_owned(), figure.to_owned());
        Some(Found {
            name,
            verdict,
            figure,
        })
    }
}

/// Asks for a self-test and gives its lines as they come, until it ends. Sends the bytes that it asks for, and opens the port again
/// after each reset that it has told of. A self-test that is not over after the `longest` time is given up.
fn listen(
    port: Box<dyn Port>,
    mut reopen: impl FnMut() -> Option<Box<dyn Port>>,
    mut say: impl FnMut(&str),
    longest: Duration,
) -> Result<Report, Failure> {
    let began = Instant::now();
    let name = port.name();
    let mut open = Some(port);
    let mut report = Report::default();
    let mut heard = Instant::now();
    // To be sent, and received up to the end of a line.
    let (mut down, mut rest) = (BEGIN.to_vec(), Vec::new());
    let mut resets = false;
    loop {
        // What came before it broke off counts: it may have told of its reset.
        let exchanged = open
            .as_deref_mut()
            .map(|port| exchange(port, &mut down, &mut rest));
        while let Some(end) = rest.iter().position(|byte| *byte == b'\n') {
            let line: Vec<u8> = rest.drain(..=end).collect();
            let line = String::from_utf8_lossy(&line);
            let line = line.trim();
            let before = std::mem::replace(&mut heard, Instant::now());
            if let Some(found) = Found::read(line) {
                say(line);
                report.checks.push(found);
                resets = false;
            } else if line.starts_with("end ") && !report.checks.is_empty() {
                say(line);
                return Ok(report);
            } else if let Some(count) = line.strip_prefix("send ") {
                let count = count.parse().unwrap_or(0);
                down.extend(PATTERN.iter().copied().cycle().take(count));
            } else if line.starts_with("next ") {
                resets = true;
            } else if !line.starts_with(FILLER) && !line.starts_with("busy ") {
                // Noise is no sign of life.
                heard = before;
            }
        }
        match exchanged {
            Some(Ok(())) => {}
            Some(Err(error)) if !resets => {
                return Err(Failure::say(
                    Cause::NoConsole,
                    format!("`{name}` broke off: {error}"),
                    "plug the board in again, and start over",
                ));
            }
            // It is on its way through the reset that it has told of.
            _ => {
                drop(open.take());
                rest.clear();
                std::thread::sleep(RETRY);
                open = reopen();
                down = GO_ON.to_vec();
            }
        }
        if heard.elapsed() > SILENCE || began.elapsed() > longest {
            let message = match report.checks.last() {
                _ if began.elapsed() > longest => {
                    format!(
                        "the self-test on `{name}` does not end: it may take {} s",
                        longest.as_secs()
                    )
                }
                None => format!("nothing on `{name}` answers as a self-test"),
                Some(last) => format!("the self-test on `{name}` stopped after `{}`", last.name),
            };
            return Err(Failure::say(
                Cause::NoConsole,
                message,
                "flash the image sutura-selftest-BOARD of `cargo xtask firmware` on a board without amplifiers, and press its reset",
            ));
        }
    }
}

/// Sends what is to be sent, and takes what has come, also from a board that takes no more.
fn exchange(port: &mut dyn Port, down: &mut Vec<u8>, rest: &mut Vec<u8>) -> io::Result<()> {
    let sent = port.write(down).map(|sent| {
        down.drain(..sent);
    });
    let wait = match down.is_empty() {
        true => Duration::from_millis(100),
        false => Duration::from_millis(1),
    };
    let mut bytes = [0; 4096];
    let count = port.read(&mut bytes, wait)?;
    rest.extend_from_slice(bytes.get(..count).unwrap_or_default());
    sent
}

/// Writes and judges a report.
fn judge(report: &Report, port: &str, out: Option<&Path>, global: &Global) -> Result<(), Failure> {
    let written = out.map_or(Ok(()), |path| keep(report, path));
    let failed: Vec<&str> = report
        .checks
        .iter()
        .filter(|found| found.verdict == Verdict::Fail)
        .map(|found| found.name.as_str())
        .collect();
    let json = global.format == Format::Json;
    if json {
        let is_good = failed.is_empty() && written.is_ok();
        let status = if is_good { "ok" } else { "failed" };
        crate::display::object(&Tested {
            status,
            port,
            failed: failed.clone(),
            checks: &report.checks,
        });
    }
    // A JSON object has said it already.
    let told = |failure: Failure| match json {
        true => failure.after_summary(),
        false => failure,
    };
    written.map_err(told)?;
    if failed.is_empty() {
        return Ok(());
    }
    Err(told(Failure::say(
        Cause::Failed,
        format!(
            "{} of {} checks failed: {}",
            failed.len(),
            report.checks.len(),
            failed.join(", ")
        ),
        "look at the jumpers of those first, then at the board: the wiring page has both",
    )))
}

fn keep(report: &Report, path: &Path) -> Result<(), Failure> {
    let line = |found: &Found| {
        let verdict = found.verdict.word();
        format!("{verdict} {} {}\n", found.name, found.figure)
    };
    let text: String = report.checks.iter().map(line).collect();
    let written = sutura_files::write_whole(path, text.as_bytes());
    written.map_err(|error| crate::files::unwritable(path, &error))
}

#[cfg(test)]
mod tests {
    use super::*;
    use sutura_host::link::pipe;

    /// What `listen` makes of a board that sends this once it is asked, in small pieces.
    fn heard(said: &'static str) -> (Result<Report, Failure>, Vec<String>) {
        let (host, mut board) = pipe();
        let there = std::thread::spawn(move || {
            let mut asked = [0; 8];
            while board
                .read(&mut asked, Duration::from_millis(50))
                .is_ok_and(|count| count == 0)
            {}
            for piece in said.as_bytes().chunks(7) {
                board.write(piece).expect("room");
            }
            // Holds its end as long as the host listens.
            while board.read(&mut asked, Duration::from_millis(50)).is_ok() {}
        });
        let mut lines = Vec::new();
        let say = |line: &str| lines.push(line.to_owned());
        let report = listen(Box::new(host), || None, say, LONGEST);
        there.join().expect("it ends");
        (report, lines)
    }

    #[test]
    fn lines_are_given_as_they_come_and_end_with_the_end() {
        let (report, lines) = heard(
            "noise\r\npass reset cause 1, epitaph 0\r\nFAIL stop_cuts enable stayed high\r\nend 1 passed 1 failed\r\n",
        );
        assert_eq!(lines.len(), 3, "{lines:?}");
        let report = report.expect("it came to its end");
        let expected = [
            ("reset", Verdict::Pass, "cause 1, epitaph 0"),
            ("stop_cuts", Verdict::Fail, "enable stayed high"),
        ];
        let found = report
            .checks
            .iter()
            .map(|found| (found.name.as_str(), found.verdict, found.figure.as_str()));
        assert!(found.eq(expected), "{report:?}");
    }

    #[test]
    fn what_does_not_answer_or_stops_is_named_with_what_to_flash() {
        let check = |said, says| {
            let (report, _) = heard(said);
            let error = report.expect_err("no end").report.to_string();
            assert!(error.contains(says), "{error}");
        };
        // Each waits for silence.
        std::thread::scope(|scope| {
            for (said, says) in [
                ("", "nothing on"),
                ("\u{1}\u{2} a console's frames \n", "nothing on"),
                ("pass reset cause 1, epitaph 0\n", "stopped after `reset`"),
            ] {
                scope.spawn(move || check(said, says));
            }
        });
    }

    /// Bounds the wait for a console that stays busy, or reports something new, for ever.
    #[test]
    fn a_self_test_without_an_end_is_given_up() {
        for said in [
            "busy for a while\n",
            "pass again 1 of 1\n",
            "~\n",
            "next reset\n",
        ] {
            let (host, mut board) = pipe();
            let there = std::thread::spawn(move || {
                while board.write(said.as_bytes()).is_ok() {
                    let _ = board.read(&mut [0; 8], Duration::from_millis(5));
                }
            });
            let longest = Duration::from_millis(200);
            let report = listen(Box::new(host), || None, |_| {}, longest);
            let error = report.expect_err("no end").report.to_string();
            let is_meant = error.contains("does not end") || error.contains("nothing on");
            assert!(is_meant, "{said:?}: {error}");
            there.join().expect("it ends");
        }
    }

    #[test]
    fn a_check_that_failed_is_an_error_that_names_it_and_the_lines_are_kept() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("selftest.txt");
        let found = |name: &str, verdict| Found {
            name: name.to_owned(),
            verdict,
            figure: "3 of 4".to_owned(),
        };
        let global = Global {
            format: Format::Text,
            verbose: 0,
            overwrite: false,
        };
        let mut report = Report {
            checks: vec![
                found("clocks", Verdict::Pass),
                found("usb_up", Verdict::Untimed),
            ],
        };
        assert!(judge(&report, "x", Some(&path), &global).is_ok());
        report
            .checks
            .push(found("encoder_2_forward", Verdict::Fail));
        let error = judge(&report, "x", Some(&path), &global).expect_err("one failed");
        let error = error.report.to_string();
        assert_eq!(error, "1 of 3 checks failed: encoder_2_forward");
        let text = std::fs::read_to_string(&path).expect("written");
        let expected = "pass clocks 3 of 4\nuntimed usb_up 3 of 4\nFAIL encoder_2_forward 3 of 4\n";
        assert_eq!(text, expected);
    }

    /// What only a board on USB gives; `tests/schemas.rs` has the rest.
    #[test]
    fn consoles_and_their_logs_have_the_keys_that_are_described() {
        let plugged = Plugged {
            port: "/dev/ttyACM0".to_owned(),
            serial_number: "0043002B3438510B32363530".to_owned(),
        };
        let listed = Listed {
            status: "ok",
            consoles: vec![plugged],
        };
        crate::schema::assert_described("device-list", &listed);
        let said = Logged {
            time_s: Some(1.5),
            level: "info",
            text: Some("armed"),
        };
        let garbled = Logged {
            time_s: None,
            level: "",
            text: None,
        };
        for line in [said, garbled] {
            crate::schema::assert_described("device-log", &line);
        }
    }

    /// A board that asks for 60 bytes, resets itself, and goes on.
    #[test]
    fn what_it_asks_for_is_sent_and_a_reset_is_gone_through() {
        let (host, mut board) = pipe();
        let (again, mut after) = pipe();
        let there = std::thread::spawn(move || {
            let asked = hear(&mut board, 1);
            board.write(b"send 60\r\n").expect("room");
            let bytes = hear(&mut board, 60);
            board
                .write(b"pass usb_down 60 bytes\r\n~filler\r\nnext window_watchdog\r\n")
                .expect("room");
            std::thread::sleep(Duration::from_millis(300));
            drop(board);
            let word = hear(&mut after, 1);
            after
                .write(b"pass window_watchdog after 49 ms\r\nend 2 passed 0 failed 0 untimed\r\n")
                .expect("room");
            std::thread::sleep(Duration::from_millis(300));
            (asked, bytes, word)
        });
        let mut ports: Vec<Option<Box<dyn Port>>> = vec![Some(Box::new(again)), None, None];
        let mut lines = Vec::new();
        let report = listen(
            Box::new(host),
            || ports.pop().flatten(),
            |line| lines.push(line.to_owned()),
            LONGEST,
        );
        let (asked, bytes, word) = there.join().expect("it ends");
        assert_eq!((asked.as_slice(), word.as_slice()), (BEGIN, GO_ON));
        let expected: Vec<u8> = PATTERN.iter().copied().cycle().take(60).collect();
        assert_eq!(bytes, expected);
        let names: Vec<_> = report.expect("to its end").checks;
        assert_eq!(names.len(), 2, "{names:?}");
        assert_eq!(lines.len(), 3, "{lines:?}");
    }

    fn hear(port: &mut impl Port, count: usize) -> Vec<u8> {
        let mut heard = Vec::new();
        while heard.len() < count {
            let mut bytes = [0; 64];
            let read = port.read(&mut bytes, Duration::from_millis(50));
            heard.extend_from_slice(&bytes[..read.expect("it is there")]);
        }
        heard
    }
}
