//! A command that is given up when it says nothing for long. Entry point: [`run`].

use anyhow::{Context, Result};
use std::io::Read;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Longest that it may compute without a word \[s\].
const SILENT_S: f64 = 20.0;
/// Longest that it may compute at all \[s\].
const LONGEST_S: f64 = 120.0;
/// Time between two looks at it.
const LOOK: Duration = Duration::from_millis(20);

/// Ways in which it can end.
pub enum Ended {
    Exit {
        code: i32,
        out: String,
        err: String,
    },
    Signal,
    /// It computed for so long without a word.
    Silent {
        cpu_s: f64,
    },
    /// It computed on and on, and said so last.
    TooLong {
        cpu_s: f64,
        last: String,
    },
}

type Heard = Arc<Mutex<Vec<u8>>>;

/// Runs a program in a folder until it ends or is given up. Times are its own, whatever else the machine does.
///
/// # Errors
/// If it cannot be started.
pub fn run(program: &Path, folder: &Path, words: &[&str]) -> Result<Ended> {
    let mut child = Command::new(program)
        .args(words)
        .current_dir(folder)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .with_context(|| program.display().to_string())?;
    let (out, err) = (Heard::default(), Heard::default());
    let readers = [
        child.stdout.take().map(|pipe| listen(pipe, out.clone())),
        child.stderr.take().map(|pipe| listen(pipe, err.clone())),
    ];
    let began = Instant::now();
    let (mut heard, mut heard_s) = (0, 0.0);
    let ended = loop {
        if let Some(status) = child.try_wait()? {
            break status.code();
        }
        let cpu_s = cpu_s(&child).unwrap_or_else(|| began.elapsed().as_secs_f64());
        let now = length(&out) + length(&err);
        if now != heard {
            (heard, heard_s) = (now, cpu_s);
        }
        if cpu_s - heard_s > SILENT_S || cpu_s > LONGEST_S {
            child.kill()?;
            child.wait()?;
            let said = text(&err);
            let last = said.lines().next_back().unwrap_or_default().to_owned();
            return Ok(match cpu_s - heard_s > SILENT_S {
                true => Ended::Silent { cpu_s },
                false => Ended::TooLong { cpu_s, last },
            });
        }
        std::thread::sleep(LOOK);
    };
    for reader in readers.into_iter().flatten() {
        let _ = reader.join();
    }
    Ok(match ended {
        Some(code) => Ended::Exit {
            code,
            out: text(&out),
            err: text(&err),
        },
        None => Ended::Signal,
    })
}

fn listen(mut pipe: impl Read + Send + 'static, heard: Heard) -> JoinHandle<()> {
    std::thread::spawn(move || {
        let mut chunk = [0; 4096];
        while let Ok(count @ 1..) = pipe.read(&mut chunk) {
            let mut heard = heard.lock().unwrap_or_else(PoisonError::into_inner);
            heard.extend_from_slice(&chunk[..count]);
        }
    })
}

fn length(heard: &Heard) -> usize {
    heard.lock().unwrap_or_else(PoisonError::into_inner).len()
}

fn text(heard: &Heard) -> String {
    let heard = heard.lock().unwrap_or_else(PoisonError::into_inner);
    String::from_utf8_lossy(&heard).into_owned()
}

/// Processor time that it has taken \[s\]; none where the system does not say so.
fn cpu_s(child: &Child) -> Option<f64> {
    let stat = std::fs::read_to_string(format!("/proc/{}/stat", child.id())).ok()?;
    // Its name, in brackets, may have spaces.
    let (_, fields) = stat.rsplit_once(')')?;
    let mut fields = fields.split_whitespace().skip(11);
    let mut ticks = || fields.next()?.parse::<f64>().ok();
    // A hundred a second on every Linux.
    Some((ticks()? + ticks()?) / 100.0)
}
