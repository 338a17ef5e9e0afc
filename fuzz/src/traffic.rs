//! Frames for a console, most of them wrong in one place, and a count of how far each got.
//!
//! Entry point: [`Traffic::run`]. Of a hundred frames some eighty are mutated in a field and stamped anew, with the session
//! and the sequence that the console waits for; the others are bent as a line bends them. In between a steady hand keeps
//! the console armed, so that what is accepted is felt.

use crate::bench::Bench;
use crate::forge::{Stamp, frame};
use crate::mutate;
use crate::seeds::{Seed, TO_CONSOLE, choose};
use fastrand::Rng;
use sutura_shared::control::Tuning;
use sutura_shared::link::Counters;
use sutura_shared::wire::message::{Command, Contact, Mode, Simulate};
use sutura_shared::wire::{MAX_FRAME, Message, PROTOCOL_VERSION, Reject, encode, faults};

/// Kind of a `Hello`.
const HELLO: u8 = 1;
/// Frames between two looks whether the console still hears, at most.
const LOOK_EVERY: u32 = 400;

/// How far frames got.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    /// Frames made.
    pub frames: u64,
    /// Of them: a field or more of the message was changed, or bytes of the frame.
    pub mutated: u64,
    /// Of them: with byte stuffing, checksum, session and sequence that are right.
    pub restamped: u64,
    /// Frames whose body the console decoded.
    pub decoded: u64,
    /// Of them: every value passed its check.
    pub validated: u64,
    /// Of them: used.
    pub accepted: u64,
    /// Times that a good frame was heard right after garbage and a delimiter.
    pub heard_again: u64,
    /// Sessions opened.
    pub sessions: u64,
    /// Ticks.
    pub ticks: u64,
    /// Of them: with the amplifiers on.
    pub ticks_under_torque: u64,
    /// Refusals, by the number of their reason.
    pub refused: [u64; 32],
}

impl Tally {
    /// Adds another one.
    pub fn add(&mut self, other: &Tally) {
        let pairs = [
            (&mut self.frames, other.frames),
            (&mut self.mutated, other.mutated),
            (&mut self.restamped, other.restamped),
            (&mut self.decoded, other.decoded),
            (&mut self.validated, other.validated),
            (&mut self.accepted, other.accepted),
            (&mut self.heard_again, other.heard_again),
            (&mut self.sessions, other.sessions),
            (&mut self.ticks, other.ticks),
            (&mut self.ticks_under_torque, other.ticks_under_torque),
        ];
        for (sum, more) in pairs {
            *sum += more;
        }
        for (sum, more) in self.refused.iter_mut().zip(other.refused) {
            *sum += more;
        }
    }
}

/// A console and what is sent to it.
pub struct Traffic<'a> {
    bench: Bench,
    rng: Rng,
    seeds: &'a [Seed],
    /// Of the last frame that the console may have taken in this session.
    sequence: u32,
    /// Bytes without a delimiter are on the line.
    open_end: bool,
    tally: Tally,
}

impl<'a> Traffic<'a> {
    /// A new console; the same seed gives the same frames.
    pub fn new(seeds: &'a [Seed], seed: u64) -> Traffic<'a> {
        Traffic::tuned(seeds, seed, Tuning::default())
    }

    /// A console without some of its guards, to find out whether that is noticed.
    pub fn tuned(seeds: &'a [Seed], seed: u64, tuning: Tuning) -> Traffic<'a> {
        let mut traffic = Traffic {
            bench: Bench::new(seed as u32, tuning),
            rng: Rng::with_seed(seed),
            seeds,
            sequence: 0,
            open_end: false,
            tally: Tally::default(),
        };
        traffic.open();
        traffic
    }

    /// Sends so many frames.
    ///
    /// # Panics
    /// On a defect of the console.
    pub fn run(&mut self, frames: u64) -> Tally {
        let end = self.tally.frames + frames;
        let mut next_look = self.rng.u32(1..LOOK_EVERY);
        while self.tally.frames < end {
            if self.rng.u8(0..5) == 0 {
                self.bend();
            } else {
                self.forge();
            }
            if self.rng.u8(0..2) == 0 {
                self.tick();
            }
            if self.rng.u8(0..16) == 0 {
                self.steady();
            }
            if self.rng.u16(0..2000) == 0 {
                self.silence();
            }
            next_look -= 1;
            if next_look == 0 {
                next_look = self.rng.u32(1..LOOK_EVERY);
                self.look();
            }
        }
        [self.tally.ticks, self.tally.ticks_under_torque] = self.bench.ticks;
        self.tally
    }

    fn tick(&mut self) {
        let session = self.bench.session;
        self.bench.tick();
        if self.bench.session != session {
            self.sequence = 0;
        }
    }

    fn open(&mut self) {
        self.bench.shake_hands(self.rng.u32(..));
        self.sequence = 0;
        self.open_end = false;
        self.tally.sessions += 1;
    }

    /// What the console would take next.
    fn stamp(&mut self, kind: u8) -> Stamp {
        let age_us = self.rng.u64(0..50_000);
        Stamp {
            version: PROTOCOL_VERSION,
            kind,
            session: self.bench.session,
            sequence: self.sequence.wrapping_add(1),
            console_time_us: self.bench.now_us().saturating_sub(age_us),
        }
    }

    /// A seed with its body changed or not.
    fn message(&mut self) -> Option<(Seed, bool)> {
        let mut seed = choose(self.seeds, TO_CONSOLE, &mut self.rng)?.clone();
        let before = seed.body.clone();
        if self.rng.u8(0..16) > 0 {
            mutate::body(seed.kind, &mut seed.body, &mut self.rng);
        }
        let mutated = seed.body != before;
        Some((seed, mutated))
    }

    /// A message that was changed, in a frame that is right or nearly.
    fn forge(&mut self) {
        let Some((seed, mut mutated)) = self.message() else {
            return;
        };
        let right = self.stamp(seed.kind);
        let mut stamp = right;
        if self.rng.u8(0..12) == 0 {
            self.change(&mut stamp);
            mutated |= stamp != right;
        }
        if seed.kind == HELLO {
            if self.rng.u8(0..8) > 0 {
                return;
            }
            // Outside the count, as handshakes are; now and then it would open a session.
            (stamp.session, stamp.sequence) = (0, 0);
        }
        let restamped = (stamp.version, stamp.session, stamp.sequence)
            == (right.version, right.session, right.sequence);
        let bytes = frame(&stamp, &seed.body);
        self.tally.mutated += u64::from(mutated);
        self.tally.restamped += u64::from(mutated && restamped && !self.open_end);
        self.send(&bytes);
        if stamp.session == self.bench.session {
            let ahead = stamp.sequence.wrapping_sub(self.sequence);
            if (1..1 << 31).contains(&ahead) {
                self.sequence = stamp.sequence;
            }
        }
        self.open_end = false;
    }

    /// Something else in the header.
    fn change(&mut self, stamp: &mut Stamp) {
        let rng = &mut self.rng;
        match rng.u8(0..6) {
            0 => stamp.version = rng.u8(..),
            1 => {
                stamp.kind = if rng.bool() {
                    rng.u8(..)
                } else {
                    rng.u8(0..24)
                }
            }
            2 => stamp.session = if rng.bool() { rng.u32(..) } else { 0 },
            3 => stamp.sequence = stamp.sequence.wrapping_sub(rng.u32(1..20)),
            4 => stamp.sequence = stamp.sequence.wrapping_add(rng.u32(1..1000)),
            _ => {
                let ahead = [
                    u64::MAX,
                    rng.u64(..),
                    stamp.console_time_us + rng.u64(0..100_000),
                ];
                stamp.console_time_us = *rng.choice(&ahead).unwrap_or(&0);
            }
        }
    }

    /// A frame that something happened to on the line.
    fn bend(&mut self) {
        let Some((seed, _)) = self.message() else {
            return;
        };
        if seed.kind == HELLO {
            return;
        }
        let stamp = self.stamp(seed.kind);
        let mut bytes = frame(&stamp, &seed.body);
        mutate::line(&mut bytes, &mut self.rng);
        // What is left of it may be whole.
        self.sequence = stamp.sequence;
        self.tally.mutated += 1;
        self.send(&bytes);
        self.open_end =
            bytes.last().is_some_and(|byte| *byte != 0) || (bytes.is_empty() && self.open_end);
    }

    fn send(&mut self, bytes: &[u8]) {
        let before = self.bench.counters();
        self.bench.feed(bytes);
        self.tally.frames += 1;
        self.count(&before);
    }

    /// How far what was sent got.
    fn count(&mut self, before: &Counters) {
        let after = self.bench.counters();
        let accepted = u64::from(after.frames_received - before.frames_received);
        let rejected = after.frames_rejected - before.frames_rejected;
        let tally = &mut self.tally;
        tally.accepted += accepted;
        tally.validated += accepted;
        tally.decoded += accepted;
        // Of several at once, which bent frames can be, the last counts for all.
        let Some(reason) = after.last_reject.filter(|_| rejected > 0) else {
            return;
        };
        let rejected = u64::from(rejected);
        if let Some(count) = tally.refused.get_mut(reason as usize) {
            *count += rejected;
        }
        match reason {
            Reject::NotFinite | Reject::Range | Reject::Name => tally.decoded += rejected,
            Reject::FromTheFuture
            | Reject::NotSimulated
            | Reject::Schema
            | Reject::TickRate
            | Reject::FrameSize
            | Reject::Owned
            | Reject::Clock => {
                tally.decoded += rejected;
                tally.validated += rejected;
            }
            _ => {}
        }
    }

    /// A good frame, counted by nobody.
    fn good<M: Message>(&mut self, body: &M) {
        if self.open_end {
            self.bench.feed(&[0]);
            self.open_end = false;
        }
        self.sequence = self.sequence.wrapping_add(1);
        let mut frame = [0; MAX_FRAME];
        let (session, now_us) = (self.bench.session, self.bench.now_us());
        let len = encode(session, self.sequence, now_us, body, &mut frame).unwrap_or_default();
        self.bench.feed(frame.get(..len).unwrap_or_default());
    }

    /// Orders and a contact that keep the console armed, and the grip where it can be felt.
    fn steady(&mut self) {
        let Some(state) = self.bench.state else {
            return;
        };
        if state.faults & faults::UNTIL_RESTART != 0 {
            self.bench.restart();
            self.open();
        }
        if !matches!(state.mode, Mode::Armed | Mode::Decaying) {
            self.good(&Simulate::EmergencyStop(false));
            self.good(&Simulate::EncoderOffset([0; 3]));
            self.good(&Command::ClearFault);
            self.tick();
            self.good(&Command::Arm);
        }
        self.good(&Contact {
            tool: 0,
            position_m: state.position_m,
            orientation: state.orientation,
            wrench: [0.0, 0.0, 1.0, 0.0, 0.0, 0.0],
            // 400 N/m on the three axes.
            tangent: std::array::from_fn(|k| if [0, 6, 11].contains(&k) { -400.0 } else { 0.0 }),
            gap_m: 0.0,
            normal: [0.0, 0.0, 1.0],
            relaxation_per_s: 0.0,
            horizon_us: 100_000,
        });
        self.tick();
    }

    /// A host that hangs: contacts become too old, and now and then the session does.
    fn silence(&mut self) {
        let ticks = if self.rng.u8(0..8) == 0 {
            1200
        } else {
            self.rng.u32(150..700)
        };
        for _ in 0..ticks {
            self.tick();
        }
    }

    /// Whether the first good frame after garbage and a delimiter is heard.
    fn look(&mut self) {
        let mut garbage: Vec<u8> = (0..self.rng.usize(0..80))
            .map(|_| self.rng.u8(..))
            .collect();
        if self.rng.u8(0..50) == 0 {
            garbage = (0..self.rng.usize(2000..9000))
                .map(|_| self.rng.u8(1..))
                .collect();
        }
        self.bench.feed(&garbage);
        self.bench.feed(&[0]);
        self.open_end = false;
        let before = self.bench.counters();
        self.good(&Command::StateEvery { ticks: 1 });
        let after = self.bench.counters();
        let heard = after.frames_received - before.frames_received;
        if heard == 1 && after.frames_rejected == before.frames_rejected {
            self.tally.heard_again += 1;
            return;
        }
        // A session that has ended, or was opened by a forged Hello, needs a new one.
        assert_eq!(
            after.last_reject,
            Some(Reject::Session),
            "the first good frame after garbage and a delimiter was refused: {after:?}"
        );
        self.open();
    }
}
