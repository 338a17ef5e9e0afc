//! The console's ticks of a recording, run again.
//!
//! Entry point: [`replay_console`]. Before each tick it is given the frames that the recorded state says it had heard by then;
//! afterwards its state must be the recorded one, trace hash and all.

use super::super::read::Recording;
use super::sessions::{DownFrame, Session, sessions};
use crate::session::LimitedTicks;
use sutura_shared::control::{Control, TickInput, TicksLimited};
use sutura_shared::device::DeviceDescription;
use sutura_shared::wire::message::State;
use sutura_shared::wire::{Kind, Valid};

/// Most frames of one tick that are tried without, where the line may have lost some.
const MOST_LOST: usize = 4;

/// What a tick came to.
#[derive(Clone, Debug, PartialEq)]
pub enum Ran {
    /// The recorded state.
    Same,
    /// Not yet comparable: what the console was before the session is not in the recording.
    NotYet,
    /// Another state; how it differs.
    Other(String),
}

/// What runs ticks again.
pub trait Replayed {
    /// A session begins, whose first state is this.
    ///
    /// # Errors
    /// Why it cannot be run.
    fn open(&mut self, session: &Session, first: &Valid<State>) -> Result<(), String>;

    /// Gives it these frames of the host and runs the tick that ended in `state`.
    ///
    /// # Errors
    /// Why the console runs no longer.
    fn tick(&mut self, frames: &[&DownFrame], state: &Valid<State>) -> Result<Ran, String>;

    /// Runs a tick whose state is missing, during which no frame was heard.
    ///
    /// # Errors
    /// Why that is not possible.
    fn unseen(&mut self) -> Result<(), String>;

    /// Tries the tick without running it: whether it would come to the recorded state. `None` where that cannot be tried.
    fn would(&self, frames: &[&DownFrame], state: &Valid<State>) -> Option<bool>;

    /// Ticks of the session that is open in which a limit of the device took a part of the force away; none where the console
    /// cannot be asked.
    fn ticks_limited(&self) -> Option<TicksLimited>;

    /// Trace hash after the last tick.
    fn hash(&self) -> u64;
}

/// What the replay of a console came to.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ConsoleVerdict {
    /// States in the recording.
    pub ticks: u64,
    /// Those that came out the same.
    pub verified_ticks: u64,
    /// Those at the beginning of sessions that could not be compared.
    pub unverified_ticks: u64,
    /// Those of a session whose opening is not in the recording, of which the pose alone was compared: it follows from the encoders.
    pub poses: u64,
    /// Frames of the host that the line must have lost for the rest to come out the same.
    pub lost_frames: u64,
    /// The console's tick that came out differently first.
    pub diverged_at: Option<u32>,
    /// The console's tick from which on nothing can be compared.
    pub unverifiable_from: Option<u32>,
    /// Why, of either.
    pub why: Option<String>,
    /// Ticks that were run in which a limit of the device took a part of the force away; none where the console cannot be asked.
    pub ticks_limited: Option<LimitedTicks>,
    /// Trace hash of the last tick that was run.
    pub hash: u64,
}

/// Runs the console's ticks again, up to the first that differs.
pub fn replay_console(recording: &Recording, console: &mut dyn Replayed) -> ConsoleVerdict {
    let sessions = sessions(recording);
    let mut verdict = ConsoleVerdict::default();
    let states = sessions.iter().map(|session| session.states.len() as u64);
    verdict.ticks = states.sum();
    for session in &sessions {
        let ran = if session.is_opened {
            let ran = one_session(session, console, &mut verdict);
            if let Some(ticks) = console.ticks_limited() {
                let ticks = LimitedTicks::from(ticks);
                verdict.ticks_limited = Some(verdict.ticks_limited.unwrap_or_default() + ticks);
            }
            ran
        } else {
            poses(session, &recording.about.plan.device, &mut verdict)
        };
        if let Err(stop) = ran {
            match stop {
                Stop::Diverged { tick, how } => {
                    verdict.diverged_at = Some(tick);
                    verdict.why = Some(how);
                }
                Stop::Unverifiable { tick, why } => {
                    verdict.unverifiable_from = Some(tick);
                    verdict.why = Some(why);
                }
            }
            break;
        }
    }
    verdict.hash = console.hash();
    verdict
}

enum Stop {
    Diverged { tick: u32, how: String },
    Unverifiable { tick: u32, why: String },
}

/// Compares the poses of a session whose opening is not in the recording: what they are made of is in their own states. Stops at the
/// first that differs, or else at the first tick, as nothing else can be compared.
fn poses(
    session: &Session,
    device: &DeviceDescription,
    verdict: &mut ConsoleVerdict,
) -> Result<(), Stop> {
    let Some((first, _)) = session.states.first() else {
        return Ok(());
    };
    let unverifiable = |why: String| Stop::Unverifiable {
        tick: first.body().tick,
        why,
    };
    let mut control = Control::new(*device)
        .map_err(|error| unverifiable(format!("the recorded device: {error}")))?;
    for (state, _) in &session.states {
        let there = state.body();
        let here = control.tick(&TickInput::of(state), None).state;
        if (here.position_m, here.orientation) != (there.position_m, there.orientation) {
            return Err(Stop::Diverged {
                tick: there.tick,
                how: "its pose is not that of its encoders".to_owned(),
            });
        }
        verdict.poses += 1;
    }
    Err(unverifiable(
        "it holds the last seconds of a session: what the console was before is not known, and poses alone were compared".to_owned(),
    ))
}

fn one_session(
    session: &Session,
    console: &mut dyn Replayed,
    verdict: &mut ConsoleVerdict,
) -> Result<(), Stop> {
    let Some((first, _)) = session.states.first() else {
        return Ok(());
    };
    let unverifiable = |tick: u32, why: String| Stop::Unverifiable { tick, why };
    console
        .open(session, first)
        .map_err(|why| unverifiable(first.body().tick, why))?;
    let mut down = Heard::new(&session.down);
    let mut before: Option<State> = None;
    for (state, time_ns) in &session.states {
        let body = state.body();
        let tick = body.tick;
        if let Some(before) = before {
            catch_up(console, &before, body).map_err(|why| unverifiable(tick, why))?;
        }
        let frames = down.before(body.heard_sequence, *time_ns);
        let frames = frames.map_err(|missing| {
            unverifiable(
                tick,
                format!("frame {missing} of the host is not in the recording"),
            )
        })?;
        let frames = without_lost(console, frames, state, verdict);
        match console.tick(&frames, state) {
            Ok(Ran::Same) => verdict.verified_ticks += 1,
            Ok(Ran::NotYet) => verdict.unverified_ticks += 1,
            Ok(Ran::Other(how)) => return Err(Stop::Diverged { tick, how }),
            Err(why) => return Err(unverifiable(tick, why)),
        }
        before = Some(*body);
    }
    Ok(())
}

/// Runs the ticks between two states, if there are any.
fn catch_up(console: &mut dyn Replayed, before: &State, now: &State) -> Result<(), String> {
    let missing = now.tick.wrapping_sub(before.tick).wrapping_sub(1);
    if missing == 0 {
        return Ok(());
    }
    if missing > u32::from(u16::MAX) {
        return Err(format!(
            "its tick does not follow that of the state before, {}",
            before.tick
        ));
    }
    if before.heard_sequence != now.heard_sequence {
        return Err(format!(
            "the states of {missing} ticks before are missing, and in which of them the host's frames were heard"
        ));
    }
    (0..missing).try_for_each(|_| console.unseen())
}

/// Leaves out frames that the line has lost, if only without them the tick comes out as it was. The last was heard.
fn without_lost<'a>(
    console: &dyn Replayed,
    frames: Vec<&'a DownFrame>,
    state: &Valid<State>,
    verdict: &mut ConsoleVerdict,
) -> Vec<&'a DownFrame> {
    let doubtful = frames.len().saturating_sub(1);
    if doubtful == 0 || doubtful > MOST_LOST || console.would(&frames, state) != Some(false) {
        return frames;
    }
    for lost in 1..1_u32 << doubtful {
        let kept = (0_u32..).zip(&frames);
        let kept: Vec<_> = kept
            .filter(|(index, _)| lost & (1 << index) == 0)
            .map(|(_, frame)| *frame)
            .collect();
        if console.would(&kept, state) == Some(true) {
            verdict.lost_frames += u64::from(lost.count_ones());
            return kept;
        }
    }
    frames
}

/// The host's frames, as the console comes to hear them.
struct Heard<'a> {
    waiting: &'a [DownFrame],
    newest: u32,
}

impl<'a> Heard<'a> {
    fn new(down: &'a [DownFrame]) -> Self {
        Heard {
            waiting: down,
            newest: 0,
        }
    }

    /// Those up to `sequence`, and pings of before `time_ns`; or the number of one that is missing.
    fn before(&mut self, sequence: u32, time_ns: u64) -> Result<Vec<&'a DownFrame>, u32> {
        let mut frames = Vec::new();
        while let Some((frame, rest)) = self.waiting.split_first() {
            let number = frame.header.sequence;
            let is_due =
                number <= sequence || (frame.header.kind == Kind::Ping && frame.time_ns <= time_ns);
            if !is_due {
                break;
            }
            if number != self.newest.wrapping_add(1) && number <= sequence {
                return Err(self.newest.wrapping_add(1));
            }
            (self.waiting, self.newest) = (rest, number);
            frames.push(frame);
        }
        if self.newest < sequence {
            return Err(self.newest.wrapping_add(1));
        }
        Ok(frames)
    }
}
