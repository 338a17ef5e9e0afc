//! `--shot`: a picture of the page, by an installed Chromium.
//!
//! Entry point: [`take`]. The browser is asked over two pipes in its own protocol (Chrome DevTools), in a headless window that draws
//! in software where there is no graphics.

use super::page::Page;
use super::sandbox::At;
use super::{ViewArgs, What};
use crate::failure::{Cause, Failure};
use crate::files::unwritable;
use crate::signals::{stopped, unfinished};
use base64::Engine as _;
use serde_json::{Value, json};
use std::io::{self, BufRead as _, BufReader, Write as _};
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};
use sutura_files::write_whole;
use sutura_view::Shared;

/// Programs that take pictures of pages, by name.
const BROWSERS: [&str; 4] = ["chromium", "chromium-browser", "google-chrome", "chrome"];
/// Standard input and output become the pipes that the browser listens to.
const AS_PIPES: &str = "exec \"$0\" \"$@\" 3<&0 4>&1 </dev/null >/dev/null 2>&1";
/// Time without a change after which a page has drawn all that it got, plots and figures included.
const SETTLES_WITHIN: Duration = Duration::from_secs(1);
/// How long all of it may take besides the session, and how long that may take on a machine that has much else to do.
const WITHIN: Duration = Duration::from_secs(120);
const REACHED_WITHIN: Duration = Duration::from_secs(600);

/// Shows a scene or a recording, and takes a picture of it.
///
/// # Errors
/// No browser, or one that takes none; a full disk.
pub fn take(
    args: &ViewArgs,
    what: What,
    shot: &Path,
    stop: &Arc<AtomicBool>,
) -> Result<(), Failure> {
    let at_s = what.shot_at(args.at)?;
    let browser = browser()?;
    let mut page = Page::open(&args.page)?;
    let at = At {
        at_s,
        reached: Arc::default(),
    };
    let shared = page.shared().clone();
    let url = page.url().unwrap_or_default();
    let (reached, stopping) = (at.reached.clone(), stop.clone());
    let failed = |error: &io::Error| failed(browser, shot, error);
    let profile = tempfile::tempdir().map_err(|error| failed(&error))?;
    let started = Browser::start(browser, profile.path()).map_err(|error| failed(&error))?;
    let running = started.child.clone();
    let thread = std::thread::Builder::new().name("sutura-shot".to_owned());
    let taking = thread.spawn(move || {
        let taken = photograph(started, &url, &shared, (at_s, &reached, &stopping));
        let was_stopped = stopping.swap(true, Ordering::Relaxed);
        (taken, was_stopped)
    });
    let taking = taking.map_err(|error| failed(&error))?;
    let shown = what.show(&mut page, None, args, Some(at), stop);
    stop.store(true, Ordering::Relaxed);
    if stopped() || shown.is_err() {
        // One that does not answer keeps nobody waiting.
        end(&running);
    }
    let taken = taking.join();
    let (taken, was_stopped) =
        taken.unwrap_or_else(|_| (Err(io::Error::other("it failed")), false));
    match taken {
        // A failure in the browser ends the session, and not the other way round.
        Err(error) if !was_stopped => Err(failed(&error)),
        taken => {
            shown?;
            let help =
                "run it again, and let it come so far; `--at S` says when the picture is taken";
            let (png, drawn_s) = taken.map_err(|_| unfinished("no picture was taken", help))?;
            write_whole(shot, &png).map_err(|error| unwritable(shot, &error))?;
            note!("{}: the picture of {drawn_s:.3} s", shot.display());
            Ok(())
        }
    }
}

/// Ends a browser, and whoever waits for what it says.
fn end(child: &Mutex<Child>) {
    let mut child = child.lock().unwrap_or_else(PoisonError::into_inner);
    // It has ended, or ends now.
    let _ = child.kill();
    let _ = child.wait();
}

fn failed(browser: &str, shot: &Path, error: &io::Error) -> Failure {
    let message = format!("{browser} took no picture for {}: {error}", shot.display());
    let help = match error.kind() {
        io::ErrorKind::TimedOut => {
            "take it earlier (`--at S`), or on a machine that has less to do"
        }
        _ => "see that the browser runs here: `chromium --headless --screenshot about:blank`",
    };
    Failure::say(Cause::Failed, message, help)
}

/// A browser that is there.
fn browser() -> Result<&'static str, Failure> {
    let runs = |name: &&str| {
        let mut command = Command::new(name);
        let version = command
            .arg("--version")
            .stdout(Stdio::null())
            .stderr(Stdio::null());
        version.status().is_ok_and(|status| status.success())
    };
    BROWSERS.into_iter().find(runs).ok_or_else(|| {
        let message = "no Chromium was found that could take a picture of the page";
        Failure::say(
            Cause::BadInput,
            message,
            "install one: `apt-get install chromium`",
        )
    })
}

/// A browser that is asked over pipes.
struct Browser {
    child: Arc<Mutex<Child>>,
    to: ChildStdin,
    from: BufReader<ChildStdout>,
    asked: u64,
}

impl Drop for Browser {
    fn drop(&mut self) {
        end(&self.child);
    }
}

impl Browser {
    fn start(name: &str, profile: &Path) -> io::Result<Self> {
        let mut command = Command::new("sh");
        command
            .args([
                "-c",
                AS_PIPES,
                name,
                "--headless=new",
                "--remote-debugging-pipe",
            ])
            .args([
                "--hide-scrollbars",
                "--no-first-run",
                "--window-size=1280,800",
            ])
            // The page around the picture is put together without the software that draws in it: that comes to 4 frames a second.
            .arg("--disable-gpu-compositing")
            .args(["--enable-unsafe-swiftshader", "--use-angle=swiftshader"])
            .arg(format!("--user-data-dir={}", profile.display()));
        // It refuses to run for root with its sandbox.
        #[cfg(unix)]
        if rustix::process::geteuid().is_root() {
            command.arg("--no-sandbox");
        }
        command.stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut child = command.stderr(Stdio::null()).spawn()?;
        let pipes = child.stdin.take().zip(child.stdout.take());
        let (to, from) = pipes.ok_or_else(|| io::Error::other("it has no pipes"))?;
        Ok(Self {
            child: Arc::new(Mutex::new(child)),
            to,
            from: BufReader::new(from),
            asked: 0,
        })
    }

    /// Asks, and waits for the answer; what else is told is passed over.
    fn ask(&mut self, session: Option<&str>, method: &str, parameters: Value) -> io::Result<Value> {
        self.asked += 1;
        let mut question = json!({"id": self.asked, "method": method, "params": parameters});
        if let Some(session) = session {
            question["sessionId"] = json!(session);
        }
        self.to.write_all(question.to_string().as_bytes())?;
        self.to.write_all(&[0])?;
        self.to.flush()?;
        loop {
            let mut bytes = Vec::new();
            if self.from.read_until(0, &mut bytes)? == 0 {
                return Err(io::Error::other("it has ended"));
            }
            bytes.pop();
            let answer: Value = serde_json::from_slice(&bytes)?;
            if answer["id"] == self.asked {
                return match answer.get("error") {
                    Some(error) => {
                        let message = error["message"].to_string();
                        Err(io::Error::new(io::ErrorKind::InvalidInput, message))
                    }
                    None => Ok(answer["result"].clone()),
                };
            }
        }
    }
}

/// State that a page reports.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Seen {
    /// Session time of the picture that is drawn \[s\].
    drawn_s: Option<f64>,
    /// Blocks of telemetry that have come.
    blocks: u64,
}

/// A page in a browser.
struct Tab {
    browser: Browser,
    session: String,
}

impl Tab {
    fn open(mut browser: Browser, url: &str) -> io::Result<Self> {
        let target = browser.ask(None, "Target.createTarget", json!({"url": url}))?;
        let attach = json!({"targetId": target["targetId"], "flatten": true});
        let session = text(&browser.ask(None, "Target.attachToTarget", attach)?["sessionId"]);
        Ok(Self { browser, session })
    }

    fn ask(&mut self, method: &str, parameters: Value) -> io::Result<Value> {
        self.browser.ask(Some(&self.session), method, parameters)
    }

    /// The value of an expression in the page, or of what it promises.
    fn evaluate(&mut self, expression: &str) -> io::Result<Value> {
        let parameters =
            json!({"expression": expression, "returnByValue": true, "awaitPromise": true});
        let answer = self.ask("Runtime.evaluate", parameters)?;
        Ok(answer["result"]["value"].clone())
    }

    /// Returns the page's present state; none while it is being loaded.
    fn look(&mut self) -> io::Result<Seen> {
        let said = match self.evaluate(SEEN) {
            // A page that is being loaded has nothing that could be asked.
            Err(error) if error.kind() == io::ErrorKind::InvalidInput => Value::Null,
            said => said?,
        };
        Ok(Seen {
            drawn_s: said["drawn"].as_str().and_then(|text| text.parse().ok()),
            blocks: said["blocks"].as_u64().unwrap_or_default(),
        })
    }
}

/// See [`Tab::look`].
const SEEN: &str = "({drawn: document.getElementById('stage')?.dataset.drawnS ?? null, blocks: window.sutura?.telemetry?.blocks ?? 0})";
/// Done when what was drawn last is on the screen.
const ON_SCREEN: &str =
    "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => done(true))))";

fn text(value: &Value) -> String {
    value.as_str().unwrap_or_default().to_owned()
}

fn timed_out(message: String) -> io::Error {
    io::Error::new(io::ErrorKind::TimedOut, message)
}

/// Waits until the page draws the picture of `at_s`, and takes it: the bytes of its file, and the time that it shows \[s\].
fn photograph(
    browser: Browser,
    url: &str,
    shared: &Shared,
    (at_s, reached, stop): (f64, &OnceLock<f64>, &AtomicBool),
) -> io::Result<(Vec<u8>, f64)> {
    let mut tab = Tab::open(browser, url)?;
    let began = Instant::now();
    let (mut seen, mut still, mut stood) = (None, began, began);
    loop {
        if stop.load(Ordering::Relaxed) {
            let message = "it was stopped before there was one";
            return Err(io::Error::new(io::ErrorKind::Interrupted, message));
        }
        let now = tab.look()?;
        if seen != Some(now) {
            (seen, still) = (Some(now), Instant::now());
        }
        match reached.get() {
            // The session waits for the page, and the picture for the session.
            None if shared.figures().joined > 0 => stood = Instant::now(),
            None => {}
            Some(period_s) => {
                let drawn_s = now
                    .drawn_s
                    .filter(|drawn_s| (drawn_s - at_s).abs() <= *period_s);
                if let Some(drawn_s) = drawn_s.filter(|_| still.elapsed() > SETTLES_WITHIN) {
                    tab.evaluate(ON_SCREEN)?;
                    let taken = tab.ask("Page.captureScreenshot", json!({"format": "png"}))?;
                    if tab.look()? == now {
                        let bytes = text(&taken["data"]);
                        let bytes = base64::engine::general_purpose::STANDARD.decode(bytes);
                        return Ok((bytes.map_err(io::Error::other)?, drawn_s));
                    }
                }
            }
        }
        if stood.elapsed() > WITHIN {
            return Err(timed_out(match now.drawn_s {
                Some(drawn_s) => format!(
                    "the page draws the picture of {drawn_s:.3} s, and not that of {at_s} s, for two minutes"
                ),
                None => "the page drew nothing for two minutes".to_owned(),
            }));
        }
        if began.elapsed() > REACHED_WITHIN + WITHIN {
            return Err(timed_out(
                "the session did not come so far in ten minutes".to_owned(),
            ));
        }
        std::thread::sleep(Duration::from_millis(50));
    }
}
