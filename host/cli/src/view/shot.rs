//! `--shot`: a picture of the page, by an installed Chromium.
//!
//! Entry point: [`take`].

use super::page::Page;
use super::{ViewArgs, recorded, sandbox};
use crate::failure::{Cause, Failure};
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

/// Programs that take pictures of pages, by name.
const BROWSERS: [&str; 4] = ["chromium", "chromium-browser", "google-chrome", "chrome"];
/// Before the page has its first picture, on a machine that draws in software \[s\].
const READY_S: f64 = 10.0;

/// Shows what is to be shown, and takes a picture of it.
///
/// # Errors
/// No browser, or one that takes none.
pub fn take(args: &ViewArgs, shot: &Path, stop: &Arc<AtomicBool>) -> Result<(), Failure> {
    let browser = browser()?;
    let mut page = Page::open(&args.page)?;
    let url = page.url();
    let taking = photographer(browser, &url, shot, args.at, stop.clone())?;
    let is_recording = args.file.as_ref().filter(|file| file.extension().is_some_and(|end| end == "mcap"));
    let shown = match is_recording {
        Some(file) => recorded::show(&page, file, stop),
        None => sandbox::run(&mut page, args.wish(), args.record.as_deref(), stop),
    };
    stop.store(true, Ordering::Relaxed);
    let taken = taking.join();
    shown?;
    match taken {
        Ok(true) if shot.is_file() => Ok(()),
        _ => {
            let message = format!("{browser} wrote no picture to {}", shot.display());
            Err(Failure::say(Cause::Failed, message, "see that the folder is yours, and that the browser runs there"))
        }
    }
}

/// A browser that is there.
fn browser() -> Result<&'static str, Failure> {
    let runs = |name: &&str| {
        let version = Command::new(name).arg("--version").stdout(Stdio::null()).stderr(Stdio::null()).status();
        version.is_ok_and(|status| status.success())
    };
    BROWSERS.into_iter().find(runs).ok_or_else(|| {
        let message = "no Chromium was found that could take a picture of the page";
        Failure::say(Cause::BadInput, message, "install one: `apt-get install chromium`")
    })
}

/// Takes the picture in a thread of its own, then has all end.
fn photographer(
    browser: &'static str,
    url: &str,
    shot: &Path,
    at_s: f64,
    stop: Arc<AtomicBool>,
) -> Result<JoinHandle<bool>, Failure> {
    let wait_ms = (1e3 * (at_s + READY_S)) as u64;
    let mut command = Command::new(browser);
    command
        .args(["--headless=new", "--hide-scrollbars", "--enable-unsafe-swiftshader"])
        .args(["--use-angle=swiftshader", "--window-size=1280,800", "--disable-gpu-vsync"])
        .arg(format!("--timeout={wait_ms}"))
        .arg(format!("--screenshot={}", shot.display()))
        .arg(url)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null());
    // It refuses to run for root with its sandbox.
    #[cfg(unix)]
    if rustix::process::geteuid().is_root() {
        command.arg("--no-sandbox");
    }
    let thread = std::thread::Builder::new().name("sutura-shot".to_owned());
    let taking = thread.spawn(move || {
        let taken = command.status().is_ok_and(|status| status.success());
        stop.store(true, Ordering::Relaxed);
        taken
    });
    taking.map_err(|error| {
        let message = format!("there is no thread to take the picture from: {error}");
        Failure::say(Cause::Failed, message, "end other programs")
    })
}
