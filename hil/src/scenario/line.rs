//! The line between host and console, with all that goes wrong on it and in what goes over it.
//!
//! Entry points: [`Line::carry`] for what one end says, [`Line::deliver`] for what then comes out at the other.
//! Frames that are left out or put in between change the numbers of those that follow, as if the host had sent
//! them so: what the console sees is then a fault of the host, not of the line.

use super::tamper::Frame;
use super::{Fault, FaultKind, FloodWith, Insane, LineFault, Tamper, Ticks, Way};
use fastrand::Rng;
use sutura_shared::link::HostLink;
use sutura_shared::wire::{Kind, MAX_FRAME, Message, encode};

/// One direction.
#[derive(Default)]
struct Half {
    /// Of a frame that has not ended.
    partial: Vec<u8>,
    /// What comes out when, in the order in which it went in.
    queue: Vec<(Ticks, Vec<u8>)>,
    /// When the last of them comes out that keeps its place.
    last: Ticks,
}

/// The numbers that the console sees.
#[derive(Default)]
struct Numbers {
    session: u32,
    /// Of the last frame as the host gave it, and as it went on.
    given: u32,
    sent: u32,
}

/// The line.
pub(super) struct Line<'a> {
    faults: &'a [Fault],
    random: Rng,
    down: Half,
    up: Half,
    numbers: Numbers,
    /// What a wedged host repeats: the last that was solved.
    last_solved: Vec<Frame>,
    solved: Vec<Frame>,
    /// Everything that hosts have said, by session.
    recorded: Vec<(u32, Vec<u8>)>,
    replayed: f64,
    shaken: bool,
}

impl<'a> Line<'a> {
    pub fn new(faults: &'a [Fault], seed: u64) -> Self {
        Line {
            faults,
            random: Rng::with_seed(seed),
            down: Half::default(),
            up: Half::default(),
            numbers: Numbers::default(),
            last_solved: Vec::new(),
            solved: Vec::new(),
            recorded: Vec::new(),
            replayed: 0.0,
            shaken: false,
        }
    }

    /// The scenario begins: ticks count from 0, and from now on these may go wrong.
    pub fn begin(&mut self, faults: &'a [Fault]) {
        self.faults = faults;
        for half in [&mut self.down, &mut self.up] {
            half.last = 0;
            half.queue.iter_mut().for_each(|(when, _)| *when = 0);
        }
    }

    fn half(&mut self, way: Way) -> &mut Half {
        match way {
            Way::Down => &mut self.down,
            Way::Up => &mut self.up,
        }
    }

    /// Takes what one end says at a tick.
    pub fn carry(&mut self, way: Way, now: Ticks, bytes: &[u8]) {
        let mut rest = std::mem::take(&mut self.half(way).partial);
        rest.extend_from_slice(bytes);
        let mut left = rest.as_slice();
        while let Some(end) = left.iter().position(|byte| *byte == 0) {
            let (frame, after) = left.split_at(end + 1);
            left = after;
            match way {
                Way::Down => self.say(now, frame),
                Way::Up => self.put(way, now, frame.to_vec()),
            }
        }
        self.half(way).partial = left.to_vec();
    }

    /// One end is gone: what it has begun to say comes as it is.
    pub fn cut(&mut self, way: Way, now: Ticks) {
        let partial = std::mem::take(&mut self.half(way).partial);
        if !partial.is_empty() {
            self.put(way, now, partial);
        }
    }

    /// A frame of the host, as the host's faults make it.
    fn say(&mut self, now: Ticks, bytes: &[u8]) {
        let Some(mut frame) = Frame::take_apart(bytes) else {
            return self.put(Way::Down, now, bytes.to_vec());
        };
        if frame.is(Kind::Hello) {
            self.recorded.push((0, bytes.to_vec()));
            return self.put(Way::Down, now, bytes.to_vec());
        }
        if frame.session() != self.numbers.session {
            self.numbers = Numbers {
                session: frame.session(),
                ..Numbers::default()
            };
        }
        // What the host itself left out stays left out.
        let step = frame.sequence().wrapping_sub(self.numbers.given);
        self.numbers.given = frame.sequence();
        self.recorded.push((frame.session(), bytes.to_vec()));
        if frame.is_solved() {
            self.solved.push(frame.clone());
        }
        let whole = frame
            .is(Kind::Contact)
            .then(|| std::mem::take(&mut self.solved));
        match self.wedged(now) {
            Some(repeats) if frame.is_solved() => {
                if repeats && whole.is_some() {
                    for mut old in self.last_solved.clone() {
                        self.stamp(&mut old, 1);
                        self.put(Way::Down, now, old.put_together());
                    }
                }
                return;
            }
            Some(_) => {}
            None => {
                if let Some(whole) = whole {
                    self.last_solved = whole;
                }
            }
        }
        self.tamper(now, &mut frame);
        self.stamp(&mut frame, step);
        self.put(Way::Down, now, frame.put_together());
    }

    /// Gives a frame the next number.
    fn stamp(&mut self, frame: &mut Frame, step: u32) {
        self.numbers.sent = self.numbers.sent.wrapping_add(step);
        frame.set_session(self.numbers.session);
        frame.set_sequence(self.numbers.sent);
    }

    /// Says something in the host's name; not before it has a session.
    pub fn inject<M: Message>(&mut self, now: Ticks, body: &M) {
        if self.numbers.session == 0 {
            return;
        }
        let mut out = [0; MAX_FRAME];
        self.numbers.sent = self.numbers.sent.wrapping_add(1);
        let Numbers { session, sent, .. } = self.numbers;
        if let Ok(length) = encode(session, sent, 0, body, &mut out) {
            let frame = out.iter().take(length).copied().collect();
            // It is the bench that says so: no fault of the line keeps it back, but what is before it stays before it.
            let when = self.down.last.max(now);
            self.down.queue.push((when, frame));
        }
    }

    fn on(&self, now: Ticks) -> impl Iterator<Item = &'a FaultKind> + use<'a> {
        let faults = self.faults;
        faults
            .iter()
            .filter(move |fault| fault.is_on(now))
            .map(|fault| &fault.kind)
    }

    fn wedged(&self, now: Ticks) -> Option<bool> {
        self.on(now).find_map(|kind| match kind {
            FaultKind::Tamper(Tamper::Wedged { repeats }) => Some(*repeats),
            _ => None,
        })
    }

    fn tamper(&mut self, now: Ticks, frame: &mut Frame) {
        for fault in self.faults.iter().filter(|fault| fault.is_on(now)) {
            match fault.kind {
                FaultKind::Tamper(Tamper::Clock {
                    offset_us,
                    drift_ppm,
                }) if frame.is_solved() => {
                    let since_s = (now - fault.at) as f64 * 1e-3;
                    let off_us = (offset_us + drift_ppm * since_s).round();
                    let time_us = frame.time_us().saturating_add_signed(off_us as i64);
                    frame.set_time_us(time_us);
                }
                FaultKind::Tamper(Tamper::Insane { what, value, share })
                    if frame.is(Kind::Contact) && self.random.f64() < share =>
                {
                    self.shaken = !self.shaken;
                    insane(frame, what, value as f32, self.shaken);
                }
                _ => {}
            }
        }
    }

    /// Puts bytes on the line.
    fn put(&mut self, way: Way, now: Ticks, mut bytes: Vec<u8>) {
        let mut when = now;
        let mut overtaken = 0;
        let mut again = None;
        let faults = self.faults;
        for fault in faults.iter().filter(|fault| fault.is_on(now)) {
            let FaultKind::Line(ways, kind) = fault.kind else {
                continue;
            };
            if !ways.has(way) {
                continue;
            }
            match kind {
                LineFault::Loss(share) if self.random.f64() < share => return,
                LineFault::Bursts(lost, every) if (now - fault.at) % every < lost => return,
                LineFault::Pulled => return,
                LineFault::Duplicates(share, after) if self.random.f64() < share => {
                    again = Some(after);
                }
                LineFault::Reordering(share, by) if self.random.f64() < share => overtaken = by,
                LineFault::BitFlips(share, bits) if self.random.f64() < share => {
                    for _ in 0..bits {
                        let at = self.random.u64(..) as usize % (8 * bytes.len().max(1));
                        if let Some(byte) = bytes.get_mut(at / 8) {
                            *byte ^= 1 << (at % 8);
                        }
                    }
                }
                LineFault::Truncation(share) if self.random.f64() < share => {
                    let kept = self.random.u64(..) as usize % bytes.len().max(1);
                    bytes.truncate(kept);
                }
                LineFault::Delay(ticks) => when += ticks,
                LineFault::Jitter(ticks) => when += self.random.u64(..) % (ticks + 1),
                LineFault::Stall => when = when.max(fault.until),
                _ => {}
            }
        }
        let half = self.half(way);
        // Bytes do not overtake each other, whatever holds them up.
        when = when.max(half.last);
        half.last = when;
        if let Some(after) = again {
            half.queue.push((when + after, bytes.clone()));
        }
        half.queue.push((when + overtaken, bytes));
    }

    /// What besides is on the line to the console at a tick, where `ticks` have passed since the last.
    pub fn disturb(&mut self, now: Ticks, ticks: Ticks, own: &mut Vec<u8>) {
        for kind in self.on(now) {
            match kind {
                FaultKind::Replay(rate) => {
                    let session = self.numbers.session;
                    let before = self.replayed as usize;
                    self.replayed += rate * ticks as f64;
                    let old = self.recorded.iter().skip(before);
                    let count = self.replayed as usize - before;
                    // Of earlier sessions: what this one says is no replay.
                    let old = old.take(count).take_while(|(of, _)| *of != session);
                    old.for_each(|(_, bytes)| own.extend(bytes));
                }
                FaultKind::Flood(with, bytes) => {
                    let room = *bytes * usize::try_from(ticks).unwrap_or(1);
                    self.flood(*with, room, own);
                }
                _ => {}
            }
        }
    }

    fn flood(&mut self, with: FloodWith, room: usize, own: &mut Vec<u8>) {
        let contact = self.last_solved.last().cloned();
        let start = own.len();
        while own.len() < start + room {
            match (with, &contact) {
                (FloodWith::Contacts, Some(contact)) => {
                    let mut frame = contact.clone();
                    self.stamp(&mut frame, 1);
                    own.extend(frame.put_together());
                }
                (FloodWith::Hellos, _) => {
                    let mut out = [0; MAX_FRAME];
                    let nonce = self.random.u64(..) as u32;
                    let mut stranger = HostLink::new(sutura_shared::control::TICK_HZ);
                    let length = stranger.hello(nonce, &mut out).unwrap_or_default();
                    own.extend(out.iter().take(length));
                }
                _ => own.push(self.random.u64(..) as u8),
            }
        }
        if with == FloodWith::Garbage && self.random.u64(..) & 1 == 0 {
            // Now and then the host's own frames are heard.
            own.push(0);
        }
    }

    /// Gives what comes out at a tick.
    pub fn deliver(&mut self, way: Way, now: Ticks, out: &mut Vec<u8>) {
        self.half(way).queue.retain(|(when, bytes)| {
            let due = *when <= now;
            if due {
                out.extend_from_slice(bytes);
            }
            !due
        });
    }
}

fn insane(frame: &mut Frame, what: Insane, value: f32, shaken: bool) {
    frame.change_contact(|contact| match what {
        Insane::Tangent => {
            for place in [0, 6, 11] {
                contact.tangent[place] = -value;
            }
        }
        Insane::Force => contact.wrench[2] = value,
        Insane::Shaking => contact.wrench[2] = if shaken { value } else { -value },
        Insane::Horizon => contact.horizon_us = value as u32,
        Insane::NotFinite => contact.wrench[2] = f32::NAN,
    });
}
