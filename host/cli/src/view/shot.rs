//! `--shot`: a picture of the page, by an installed Chromium.
//!
//! Entry point: [`take`]. The browser is asked over two pipes in its own protocol (Chrome DevTools), in a headless window that draws
//! in software where there is no graphics.

use super::page::Page;
use super::sandbox::At;
use super::{ViewArgs, What};
use crate::failure::{Cause, Failure};
use base64::Engine as _;
use serde_json::{Value, json};
use std::io::{self, BufRead as _, BufReader, Write as _};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use sutura_view::Shared;

/// Programs that take pictures of pages, by name.
const BROWSERS: [&str; 4] = ["chromium", "chromium-browser", "google-chrome", "chrome"];
/// Standard input and output become the pipes that the browser listens to.
const AS_PIPES: &str = "exec \"$0\" \"$@\" 3<&0 4>&1 </dev/null >/dev/null 2>&1";
/// How long a page is given to draw what it got last, in software.
const DRAWN_WITHIN: Duration = Duration::from_secs(4);
/// How long all of it may take besides the session, and how long that may take on a machine that has much else to do.
const WITHIN: Duration = Duration::from_secs(120);
const REACHED_WITHIN: Duration = Duration::from_secs(600);

/// Shows a scene or a recording, and takes a picture of it.
///
/// # Errors
/// No browser, or one that takes none.
pub fn take(
    args: &ViewArgs,
    what: What,
    shot: &Path,
    stop: &Arc<AtomicBool>,
) -> Result<(), Failure> {
    let browser = browser()?;
    let mut page = Page::open(&args.page)?;
    let at = At {
        at_s: args.at,
        reached: Arc::default(),
    };
    let shared = page.shared().clone();
    let url = page.url().unwrap_or_default();
    let (reached, stopping) = (at.reached.clone(), stop.clone());
    let file = PathBuf::from(shot);
    let thread = std::thread::Builder::new().name("sutura-shot".to_owned());
    let taking = thread.spawn(move || {
        let taken = photograph(browser, &url, &file, &shared, (&reached, &stopping));
        stopping.store(true, Ordering::Relaxed);
        taken
    });
    let taking = taking.map_err(|error| failed(browser, shot, &error))?;
    let shown = what.show(&mut page, None, args, Some(at), stop);
    stop.store(true, Ordering::Relaxed);
    let taken = taking.join();
    shown?;
    match taken {
        Ok(taken) => taken.map_err(|error| failed(browser, shot, &error)),
        Err(_) => Err(failed(browser, shot, &io::Error::other("it failed"))),
    }
}

fn failed(browser: &str, shot: &Path, error: &io::Error) -> Failure {
    let message = format!("{browser} took no picture for {}: {error}", shot.display());
    let help = match error.kind() {
        io::ErrorKind::Interrupted => {
            "run it again, and let it come so far; `--at S` says when the picture is taken"
        }
        io::ErrorKind::TimedOut => {
            "take it earlier (`--at S`), or on a machine that has less to do"
        }
        _ => {
            "see that the folder is yours, and that the browser runs here: `chromium --headless --screenshot about:blank`"
        }
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
    child: Child,
    to: ChildStdin,
    from: BufReader<ChildStdout>,
    asked: u64,
}

impl Drop for Browser {
    fn drop(&mut self) {
        // It has ended, or ends now.
        let _ = self.child.kill();
        let _ = self.child.wait();
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
            child,
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
                    Some(error) => Err(io::Error::other(error["message"].to_string())),
                    None => Ok(answer["result"].clone()),
                };
            }
        }
    }
}

fn photograph(
    browser: &str,
    url: &str,
    file: &Path,
    shared: &Shared,
    (reached, stop): (&AtomicBool, &AtomicBool),
) -> io::Result<()> {
    let profile = tempfile::tempdir()?;
    let mut browser = Browser::start(browser, profile.path())?;
    let text = |value: &Value| value.as_str().unwrap_or_default().to_owned();
    let target = browser.ask(None, "Target.createTarget", json!({"url": url}))?;
    let attach = json!({"targetId": target["targetId"], "flatten": true});
    let session = text(&browser.ask(None, "Target.attachToTarget", attach)?["sessionId"]);
    let began = Instant::now();
    let (mut sent, mut still, mut stood) = (0, began, began);
    loop {
        let is_reached = reached.load(Ordering::Relaxed);
        if is_reached && sent > 0 && still.elapsed() > DRAWN_WITHIN {
            break;
        }
        if stop.load(Ordering::Relaxed) {
            let message = "it was stopped before there was one";
            return Err(io::Error::new(io::ErrorKind::Interrupted, message));
        }
        if stood.elapsed() > WITHIN {
            let message = "the page drew nothing for two minutes";
            return Err(io::Error::new(io::ErrorKind::TimedOut, message));
        }
        if began.elapsed() > REACHED_WITHIN + WITHIN {
            let message = "the session did not come so far in ten minutes";
            return Err(io::Error::new(io::ErrorKind::TimedOut, message));
        }
        let figures = shared.figures();
        if figures.sent != sent || !is_reached {
            (sent, still) = (figures.sent, Instant::now());
        }
        // The session waits for the page, and the picture for the session.
        if !is_reached && figures.joined > 0 {
            stood = Instant::now();
        }
        std::thread::sleep(Duration::from_millis(50));
    }
    let taken = browser.ask(
        Some(&session),
        "Page.captureScreenshot",
        json!({"format": "png"}),
    )?;
    let bytes = base64::engine::general_purpose::STANDARD.decode(text(&taken["data"]));
    std::fs::write(file, bytes.map_err(io::Error::other)?)
}
