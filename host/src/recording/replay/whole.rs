//! A whole simulated console, run again tick by tick: the firmware's image under an emulator, or the same natively.
//!
//! Entry point: [`WholeConsole`]. It reads its own encoders; only frames are given to it, and which ticks overran.

use super::super::tap::Direction;
use super::console::{Ran, Replayed};
use super::native::difference;
use super::sessions::{DownFrame, Session, frame_with_session, parse};
use crate::link::LockstepConsole;
use sutura_shared::control::TicksLimited;
use sutura_shared::wire::message::State;
use sutura_shared::wire::{Checked, Valid, inputs};

/// Ticks that a console may have been up before the recorded session: five minutes, which an emulator runs in some.
const MOST_BEFORE: u32 = 300_000;

/// A console in lockstep with a recording.
pub struct WholeConsole<'a> {
    console: &'a mut dyn LockstepConsole,
    up: Vec<u8>,
    /// Ticks so far.
    ticks: u32,
    hello: Vec<u8>,
    /// Session here and in the recording.
    session: (u32, u32),
    hash: u64,
}

impl<'a> WholeConsole<'a> {
    /// With a console at boot.
    pub fn new(console: &'a mut dyn LockstepConsole) -> Self {
        WholeConsole {
            console,
            up: Vec::new(),
            ticks: 0,
            hello: Vec::new(),
            session: (0, 0),
            hash: 0,
        }
    }

    /// One tick; what the console says goes to `each`.
    fn exchange(&mut self, down: &[u8]) -> Result<(), String> {
        self.up.clear();
        self.ticks = self.ticks.wrapping_add(1);
        let done = self.console.exchange(down, &mut self.up);
        done.map_err(|error| error.to_string())
    }
}

impl Replayed for WholeConsole<'_> {
    fn open(&mut self, session: &Session, first: &Valid<State>) -> Result<(), String> {
        if !session.console.simulated {
            return Err(
                "the recorded console has motors: only its control loop can be run again"
                    .to_owned(),
            );
        }
        let before = first.body().tick.wrapping_sub(self.ticks).wrapping_sub(1);
        if before > MOST_BEFORE {
            return Err(format!(
                "the console had been up for {} ticks before",
                first.body().tick
            ));
        }
        for _ in 0..before {
            self.exchange(&[])?;
        }
        let hello = session.hello.clone();
        self.hello = hello.ok_or("the host's `Hello` is not in the recording")?;
        self.session = (0, session.console.session);
        Ok(())
    }

    fn tick(&mut self, frames: &[&DownFrame], state: &Valid<State>) -> Result<Ran, String> {
        let (here, there) = self.session;
        let mut down = std::mem::take(&mut self.hello);
        let opens = !down.is_empty();
        for frame in frames {
            if here == there || opens {
                down.extend_from_slice(&frame.bytes);
            } else {
                down.extend(frame_with_session(&frame.bytes, here));
            }
        }
        if state.body().inputs & inputs::OVERRUN != 0 {
            self.console.overran();
        }
        self.exchange(&down)?;
        let mut answer = None;
        for frame in self.up.split_inclusive(|byte| *byte == 0) {
            match parse(Direction::Up, frame) {
                Some((_, Some(Checked::Hello(hello)))) => self.session.0 = hello.body().session,
                Some((_, Some(Checked::State(state)))) => answer = Some(*state.body()),
                _ => {}
            }
        }
        let Some(answer) = answer else {
            return Ok(Ran::Other("it sends no state".to_owned()));
        };
        self.hash = answer.trace_hash;
        Ok(if answer == *state.body() {
            Ran::Same
        } else {
            Ran::Other(difference(&answer, state.body()))
        })
    }

    fn unseen(&mut self) -> Result<(), String> {
        self.exchange(&[])
    }

    fn would(&self, _: &[&DownFrame], _: &Valid<State>) -> Option<bool> {
        None
    }

    fn ticks_limited(&self) -> Option<TicksLimited> {
        self.console.ticks_limited()
    }

    fn hash(&self) -> u64 {
        self.hash
    }
}
