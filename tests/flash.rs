//! `sutura flash` with stand-ins for `dfu-util` and `probe-rs`: programs of those names, over a file that behaves like a chip's flash.
#![cfg(unix)]
#![allow(clippy::unwrap_used, reason = "tests")]

#[cfg(feature = "qemu-tests")]
mod selftest;

use crate::support::{Ran, ran, root};
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::PathBuf;
use std::process::Command;
use sutura_hil::Pty;
use sutura_shared::identification::Identification;

const H405: &str = "olimex-h405";
const FLASH: usize = 1024 * 1024;

/// A folder with the programs, the chip's flash, and switches for what goes wrong.
struct Bench {
    folder: tempfile::TempDir,
}

impl Bench {
    /// A board with an empty flash that is in its ROM's loader, and has a probe.
    fn new() -> Bench {
        let bench = Bench {
            folder: tempfile::tempdir().unwrap(),
        };
        for (program, text) in [
            ("dfu-util", include_str!("flash/dfu-util.sh")),
            ("probe-rs", include_str!("flash/probe-rs.sh")),
            ("flash-model", include_str!("flash/flash-model.sh")),
        ] {
            let path = bench.path(&format!("bin/{program}"));
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(&path, text).unwrap();
            fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
        }
        bench.fill(&[]);
        bench.set("loader", "07*128Kg");
        bench.set("id", "10076413");
        bench.set("probe", "0483:374b:066BFF");
        bench
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn set(&self, name: &str, text: &str) {
        fs::write(self.path(name), text).unwrap();
    }

    fn clear(&self, name: &str) {
        fs::remove_file(self.path(name)).unwrap();
    }

    fn fill(&self, bytes: &[u8]) {
        let mut flash = vec![0xFF; FLASH];
        flash[..bytes.len()].copy_from_slice(bytes);
        fs::write(self.path("flash.bin"), flash).unwrap();
    }

    fn flash(&self) -> Vec<u8> {
        fs::read(self.path("flash.bin")).unwrap()
    }

    /// What the programs were asked, a line each.
    fn asked(&self) -> Vec<String> {
        let log = fs::read_to_string(self.path("log")).unwrap_or_default();
        log.lines().map(str::to_owned).collect()
    }

    fn image(&self, board: &str) -> (String, Vec<u8>) {
        let bytes = image(board);
        let path = self.path(&format!("{board}.bin"));
        fs::write(&path, &bytes).unwrap();
        (path.to_string_lossy().into_owned(), bytes)
    }

    /// Runs `sutura flash` with these programs and no others but the shell's.
    fn run(&self, arguments: &[&str]) -> Ran {
        let bin = self.path("bin");
        let mut command = Command::new(env!("CARGO_BIN_EXE_sutura"));
        command.arg("flash").args(arguments).current_dir(root());
        command.env("PATH", format!("{}:/usr/bin:/bin", bin.display()));
        ran(command.env("FAKE_BOARD", self.folder.path()))
    }
}

/// An image as ours are: a vector table, what it is, and code from the second sector on.
fn image(board: &str) -> Vec<u8> {
    let mut bytes: Vec<u8> = (0..40_003).map(|at| (at % 249) as u8).collect();
    bytes[0x200..0x4000].fill(0xFF);
    bytes[..8].copy_from_slice(&[0, 0, 1, 0x20, 0x01, 0x40, 0, 0x08]);
    let own = Identification::new(board, "console", "0.1.0").to_bytes();
    bytes[0x188..0x188 + own.len()].copy_from_slice(&own);
    bytes
}

#[test]
fn an_image_goes_through_the_roms_loader_and_is_read_back() {
    let bench = Bench::new();
    let (path, bytes) = bench.image(H405);
    let done = bench.run(&[&path, "--method", "dfu", "--format", "json"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let json = done.json();
    crate::support::described::assert_described("flash", &json);
    assert_eq!(json["status"], "ok");
    assert_eq!(
        (&json["board"], &json["method"]),
        (&H405.into(), &"dfu".into())
    );
    assert_eq!(
        (&json["bytes"], &json["replaced"]),
        (&40_003.into(), &"nothing".into())
    );
    assert_eq!(json["started"], true);
    assert!(bench.flash()[..bytes.len()] == bytes);
    // The first sector is emptied first and written last; then everything is read, and the loader left.
    let asked = bench.asked();
    let order: Vec<_> = asked
        .iter()
        .filter_map(|line| line.split_once("-s "))
        .map(|(_, what)| what)
        .collect();
    let firsts: Vec<_> = order
        .iter()
        .map(|what| what.split(" /").next().unwrap())
        .collect();
    assert_eq!(
        firsts,
        [
            "0x08000000:1024 -U",
            "0x08000000 -D",
            "0x08004000 -D",
            "0x08000000 -D",
            "0x08000000:40003 -U",
            "0x08000000:leave"
        ]
    );
    assert!(asked.iter().all(|line| line.starts_with("dfu-util ")));
    // Again, by the number that the loader has, over what is there now.
    let done = bench.run(&[&path, "--device", "345F37823336"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    assert!(
        done.stdout
            .contains("in place of console 0.1.0 of olimex-h405; it runs"),
        "{}",
        done.stdout
    );
}

#[test]
fn an_image_goes_through_a_probe() {
    let bench = Bench::new();
    let (path, bytes) = bench.image(H405);
    let done = bench.run(&[&path, "--method", "probe", "--format", "json"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    assert_eq!(done.json()["method"], "probe");
    assert!(bench.flash()[..bytes.len()] == bytes);
    let asked = bench.asked();
    assert!(
        asked
            .iter()
            .skip(1)
            .all(|line| line.contains("--chip STM32F405RGTx --probe 0483:374b:066BFF")),
        "{asked:?}"
    );
    assert!(asked.last().unwrap().starts_with("probe-rs reset"));
}

/// The console that is asked to leave is a pseudo-terminal; the loader shows up once it has been looked for.
#[test]
fn a_running_console_is_touched_and_the_loader_that_shows_up_is_written() {
    let bench = Bench::new();
    bench.clear("loader");
    bench.set("comes", "07*128Kg");
    let (path, bytes) = bench.image(H405);
    let console = Pty::open().unwrap();
    let done = bench.run(&[&path, "--port", console.path(), "--format", "json"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    assert_eq!(done.json()["method"], "touch");
    assert!(bench.flash()[..bytes.len()] == bytes);
}

#[test]
fn a_console_that_does_not_leave_is_told_of_with_what_to_do() {
    let bench = Bench::new();
    bench.clear("loader");
    let (path, _) = bench.image(H405);
    let console = Pty::open().unwrap();
    let done = bench.run(&[&path, "--port", console.path()]);
    assert_eq!(done.code, 3);
    for words in [
        "has not gone into the loader",
        "at rest only",
        "BOOT0 to 3.3 V",
    ] {
        assert!(done.stderr.contains(words), "{words}: {}", done.stderr);
    }
}

/// Nothing is written, and what to do is said; with `--force` it is, but never on another chip.
#[test]
fn the_wrong_board_is_named_before_anything_is_written() {
    let foreign = vec![0x11; 4096];
    for (there, loader, image_for, code, says, forced) in [
        (
            image("nucleo-f446ze"),
            "07*128Kg",
            H405,
            2,
            "an image for `nucleo-f446ze`",
            0,
        ),
        (foreign, "07*128Kg", H405, 2, "not one of Sutura's", 0),
        (
            image(H405),
            "07*128Kg",
            "nucleo-f446ze",
            2,
            "1024 KiB of flash, not 512 KiB",
            2,
        ),
        (
            Vec::new(),
            "03*128Kg",
            H405,
            2,
            "512 KiB of flash, not 1024 KiB",
            2,
        ),
        (
            Vec::new(),
            "07*128Kg",
            "virtual",
            2,
            "no board is named `virtual`",
            2,
        ),
    ] {
        let bench = Bench::new();
        bench.set("loader", loader);
        bench.fill(&there);
        let before = bench.flash();
        let (path, bytes) = bench.image(image_for);
        let done = bench.run(&[&path, "--method", "dfu"]);
        assert_eq!(done.code, code, "{}", done.stderr);
        assert!(done.stderr.contains(says), "{says}: {}", done.stderr);
        assert!(bench.flash() == before);
        let done = bench.run(&[&path, "--method", "dfu", "--force"]);
        assert_eq!(done.code, forced, "{}", done.stderr);
        assert_eq!(bench.flash()[..bytes.len()] == bytes, forced == 0);
    }
    // By a probe the chip itself says what it is.
    let bench = Bench::new();
    bench.set("id", "10006421");
    let (path, _) = bench.image(H405);
    let done = bench.run(&[&path, "--method", "probe"]);
    assert_eq!(done.code, 2);
    assert!(
        done.stderr.contains("chip id 0x421, not chip id 0x413"),
        "{}",
        done.stderr
    );
}

/// Each download in turn loses the board half way; it does not start then, and the next run mends it. In the last one a half
/// of the vector table is there, without what the image is: what that is only its owner knows.
#[test]
fn a_supply_that_goes_is_told_of_and_writing_again_mends_it() {
    for download in ["1", "2", "3"] {
        let bench = Bench::new();
        bench.fill(&image(H405));
        let (path, bytes) = bench.image(H405);
        bench.set("cut", download);
        let done = bench.run(&[&path, "--method", "dfu", "--format", "json"]);
        assert_eq!(done.code, 1, "{}", done.stderr);
        assert!(
            done.json()["help"]
                .as_str()
                .unwrap()
                .contains("does not start")
        );
        assert!(done.stderr.contains("lost the board"), "{}", done.stderr);
        assert!(bench.flash()[..bytes.len()] != bytes);
        bench.clear("cut");
        bench.set("loader", "07*128Kg");
        let again = &[&*path, "--method", "dfu", "--force"][..if download == "3" { 4 } else { 3 }];
        let done = bench.run(again);
        assert_eq!(done.code, 0, "{}", done.stderr);
        assert!(bench.flash()[..bytes.len()] == bytes);
    }
}

#[test]
fn a_byte_that_comes_back_otherwise_is_named_and_the_board_does_not_start() {
    let bench = Bench::new();
    let (path, _) = bench.image(H405);
    bench.set("worn", "20001");
    let done = bench.run(&[&path, "--method", "dfu"]);
    assert_eq!(done.code, 1);
    assert!(
        done.stderr
            .contains("at 0x08004e21 there is 0x00, not 0x51"),
        "{}",
        done.stderr
    );
    assert_eq!(bench.flash()[..8], [0xFF; 8]);
}

#[test]
fn what_is_not_there_is_named_with_the_way_to_get_it() {
    let bench = Bench::new();
    let (path, _) = bench.image(H405);
    bench.clear("loader");
    let done = bench.run(&[&path, "--method", "dfu"]);
    assert_eq!(done.code, 3);
    assert!(
        done.stderr.contains("no board is in the loader") && done.stderr.contains("BOOT0"),
        "{}",
        done.stderr
    );
    bench.set("denied", "");
    let done = bench.run(&[&path, "--method", "dfu"]);
    assert_eq!(done.code, 3);
    assert!(
        done.stderr.contains("LIBUSB_ERROR_ACCESS") && done.stderr.contains("udev/rules.d"),
        "{}",
        done.stderr
    );
    bench.set("probe", "");
    let done = bench.run(&[&path, "--method", "probe"]);
    assert_eq!(done.code, 3);
    assert!(
        done.stderr.contains("no probe is there") && done.stderr.contains("probe-rs list"),
        "{}",
        done.stderr
    );
    // No programs at all.
    for (method, words) in [
        ("dfu", ["`dfu-util` is not there", "apt install dfu-util"]),
        ("probe", ["`probe-rs` is not there", "https://probe.rs"]),
        ("touch", ["`dfu-util` is not there", "apt install dfu-util"]),
    ] {
        let mut command = Command::new(env!("CARGO_BIN_EXE_sutura"));
        command
            .args(["flash", &path, "--method", method])
            .env("PATH", bench.folder.path());
        let done = ran(&mut command);
        assert_eq!(done.code, 3, "{}", done.stderr);
        for word in words {
            assert!(done.stderr.contains(word), "{word}: {}", done.stderr);
        }
    }
}

#[test]
fn bad_images_are_refused_before_any_program_is_asked() {
    let bench = Bench::new();
    let (path, _) = bench.image(H405);
    let bare = bench.path("bare.bin");
    let mut bytes = image(H405);
    bytes[0x188..0x1C8].fill(0);
    fs::write(&bare, bytes).unwrap();
    let bare = bare.to_string_lossy().into_owned();
    for (arguments, says) in [
        (
            &[&*path, "--board", "nucleo-f446ze"][..],
            "--board says `nucleo-f446ze`",
        ),
        (&["Cargo.toml"], "neither an ELF file"),
        (&["not-there.bin"], "cannot read the image `not-there.bin`"),
        (&[&*bare, "--force"], "does not say what it is"),
        (&[&*bare, "--board", H405], "does not say what it is"),
    ] {
        let done = bench.run(arguments);
        assert_eq!(done.code, 2, "{}", done.stderr);
        assert!(done.stderr.contains(says), "{says}: {}", done.stderr);
        assert!(bench.asked().is_empty());
    }
    let done = bench.run(&[&bare, "--force", "--board", H405, "--method", "dfu"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
}
