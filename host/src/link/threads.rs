//! An open link: one thread reads, one writes, and nobody else waits for either.
//!
//! Entry point: [`Link::open`]. States come in through a latest-value slot, contacts go out through
//! one; orders (commands, and what a simulation is told) wait in a bounded queue. Closing or dropping
//! the link disarms the console first.

use super::slot::{Outbox, Outgoing, Slot};
use super::{LinkError, Port};
use std::hash::{BuildHasher, Hasher, RandomState};
use std::io;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use sutura_shared::link::{Counters, HostEvent, HostLink, SendError};
use sutura_shared::wire::message::{
    Command, Contact, Fixture, Hello, Needle, Rows, Simulate, State, Thread,
};
use sutura_shared::wire::{MAX_FRAME, Message, Valid};

/// How long a `Hello` may stay unanswered before another one is sent: a console answers within a few
/// ticks, even over the emulator's UART (0.1 s).
const ASK_AGAIN: Duration = Duration::from_millis(400);

/// How long a read waits before the thread looks whether it should end.
const READ_WAIT: Duration = Duration::from_millis(50);

/// How long a closing link waits for its threads. A write to a console that no longer takes bytes never
/// returns; its thread is then left behind.
const CLOSE_WAIT: Duration = Duration::from_millis(500);

/// Orders that may wait to be written; a session sends a handful at its start.
const ORDERS: usize = 16;

/// What the caller decides about a link.
#[derive(Clone, Copy, Debug)]
pub struct LinkOptions {
    /// Control rate that the host expects \[Hz\].
    pub tick_hz: u16,
    /// How long the console may take to answer.
    pub answer_within: Duration,
    /// Shortest time between two contact frames; newer ones replace the one that waits.
    pub contact_spacing: Duration,
}

impl Default for LinkOptions {
    fn default() -> Self {
        LinkOptions {
            tick_hz: 1000,
            answer_within: Duration::from_secs(3),
            contact_spacing: Duration::ZERO,
        }
    }
}

/// What a console can be told, apart from contacts.
#[derive(Clone, Copy, Debug, PartialEq)]
#[allow(clippy::large_enum_variant, reason = "a handful per session")]
pub enum Order {
    /// To any console.
    Command(Command),
    /// To any console.
    Fixture(Fixture),
    /// To a simulated one.
    Simulate(Simulate),
}

/// What went over a link so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LinkCounters {
    /// Frames, as the host's end counted them.
    pub frames: Counters,
    /// Contact frames written.
    pub contacts_sent: u64,
    /// States replaced by a newer one before the solver took them.
    pub states_superseded: u64,
    /// Contacts replaced by a newer one before they were written.
    pub contacts_superseded: u64,
}

/// A link with an open session.
#[derive(Debug)]
pub struct Link {
    shared: Arc<Shared>,
    threads: Vec<JoinHandle<()>>,
    console: Hello,
    name: String,
}

/// What the console is told of one solve: sent together, the contact last, or not at all.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Felt {
    /// The contact of the console's tool.
    pub contact: Contact,
    /// Its rows.
    pub rows: Option<Rows>,
    /// The needle in its grip.
    pub needle: Option<Needle>,
    /// The thread that pulls at it.
    pub thread: Option<Thread>,
}

#[derive(Debug)]
struct Shared {
    end: Mutex<HostLink>,
    states: Slot<Valid<State>>,
    /// What was solved for the newest state, and its console time \[us\].
    outbox: Outbox<Order, (u64, Felt)>,
    contacts_sent: AtomicU64,
    /// Console time of the newest state \[us\].
    console_time_us: AtomicU64,
    closing: AtomicBool,
    /// Why the link broke, in the system's words.
    broken: Mutex<Option<String>>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A number that nobody can guess from the last one.
pub fn nonce() -> u32 {
    RandomState::new().build_hasher().finish() as u32
}

impl Link {
    /// Opens a session with the console at the other end of `port` and starts the I/O threads.
    ///
    /// `listener` hears every state and report, on the reader's thread: it must return at once.
    ///
    /// # Errors
    /// [`LinkError::NoAnswer`], [`LinkError::Mismatch`], or [`LinkError::Gone`].
    pub fn open(
        mut port: Box<dyn Port>,
        options: LinkOptions,
        listener: impl FnMut(&HostEvent) + Send + 'static,
    ) -> Result<Link, LinkError> {
        let name = port.name();
        let mut end = HostLink::new(options.tick_hz);
        let (console, rest) = shake_hands(port.as_mut(), &mut end, options.answer_within)?;
        let writer_port = port.try_clone().map_err(|error| gone(&name, &error))?;
        let shared = Arc::new(Shared {
            end: Mutex::new(end),
            states: Slot::default(),
            outbox: Outbox::new(ORDERS),
            contacts_sent: AtomicU64::new(0),
            console_time_us: AtomicU64::new(0),
            closing: AtomicBool::new(false),
            broken: Mutex::new(None),
        });
        let mut link = Link {
            shared,
            threads: Vec::new(),
            console,
            name,
        };
        let reads = link.shared.clone();
        link.spawn("sutura-read", move || reads.read(port, &rest, listener))?;
        let writes = link.shared.clone();
        link.spawn("sutura-write", move || {
            writes.write(writer_port, options.contact_spacing)
        })?;
        Ok(link)
    }

    fn spawn(&mut self, name: &str, body: impl FnOnce() + Send + 'static) -> Result<(), LinkError> {
        let thread = std::thread::Builder::new()
            .name(name.to_owned())
            .spawn(body);
        self.threads
            .push(thread.map_err(|error| gone(&self.name, &error))?);
        Ok(())
    }

    /// What the console said of itself.
    pub fn console(&self) -> &Hello {
        &self.console
    }

    /// What the user calls the port.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Takes the newest state that nobody took yet, waiting for one until `deadline`.
    ///
    /// # Errors
    /// [`LinkError::Gone`] once the link is broken and all that came before has been taken.
    pub fn state(&self, deadline: Instant) -> Result<Option<Valid<State>>, LinkError> {
        match self.shared.states.wait_until(deadline) {
            Some(state) => Ok(Some(state)),
            None => self.check().map(|()| None),
        }
    }

    /// Puts out what was solved for the state of `console_time_us`, in place of what still waits.
    pub fn felt(&self, console_time_us: u64, felt: Felt) {
        self.shared.outbox.put((console_time_us, felt));
    }

    /// Queues an order.
    ///
    /// # Errors
    /// [`LinkError::Gone`] on a broken link, [`LinkError::Stuck`] if the console takes no orders.
    pub fn order(&self, order: Order) -> Result<(), LinkError> {
        self.check()?;
        let queued = self.shared.outbox.order(order);
        queued.map_err(|_| LinkError::Stuck {
            name: self.name.clone(),
            waiting: ORDERS,
        })
    }

    /// Whether the link still stands.
    ///
    /// # Errors
    /// [`LinkError::Gone`] if not.
    pub fn check(&self) -> Result<(), LinkError> {
        match &*lock(&self.shared.broken) {
            None => Ok(()),
            Some(reason) => Err(LinkError::Gone {
                name: self.name.clone(),
                reason: reason.clone(),
            }),
        }
    }

    /// What went over the link so far.
    pub fn counters(&self) -> LinkCounters {
        LinkCounters {
            frames: lock(&self.shared.end).counters(),
            contacts_sent: self.shared.contacts_sent.load(Ordering::Relaxed),
            states_superseded: self.shared.states.superseded(),
            contacts_superseded: self.shared.outbox.superseded(),
        }
    }

    /// Disarms the console, lets all orders go out, and ends the threads.
    pub fn close(mut self) -> LinkCounters {
        self.shut();
        self.counters()
    }

    fn shut(&mut self) {
        // A full queue means that the console takes nothing: it lets its force decay by itself.
        let _ = self.shared.outbox.order(Order::Command(Command::Disarm));
        self.shared.outbox.close();
        let deadline = Instant::now() + CLOSE_WAIT;
        // The writer, started last, ends first: its last order must be out before the reader lets go.
        while let Some(thread) = self.threads.pop() {
            while !thread.is_finished() && Instant::now() < deadline {
                std::thread::sleep(Duration::from_millis(1));
            }
            self.shared.closing.store(true, Ordering::Relaxed);
            if thread.is_finished() && thread.join().is_err() {
                tracing::error!("a thread of the link panicked");
            }
        }
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        self.shut();
    }
}

impl Shared {
    /// Until the link closes or breaks: bytes to events, events to the slot and the listener.
    fn read(&self, mut port: Box<dyn Port>, rest: &[u8], mut listener: impl FnMut(&HostEvent)) {
        self.hear(rest, &mut listener);
        let mut chunk = [0; 4096];
        while !self.closing.load(Ordering::Relaxed) {
            match port.read(&mut chunk, READ_WAIT) {
                Ok(count) => self.hear(&chunk[..count], &mut listener),
                Err(error) => return self.break_off(&error),
            }
        }
    }

    fn hear(&self, bytes: &[u8], listener: &mut impl FnMut(&HostEvent)) {
        for byte in bytes {
            let event = lock(&self.end).receive(*byte);
            if let Some(event) = event {
                listener(&event);
                if let HostEvent::State(state) = event {
                    self.console_time_us
                        .store(state.console_time_us(), Ordering::Relaxed);
                    self.states.put(state);
                }
            }
        }
    }

    /// Until the outbox is closed or the link breaks: orders and contacts to bytes.
    fn write(&self, mut port: Box<dyn Port>, contact_spacing: Duration) {
        let mut frames = Vec::with_capacity(3 * MAX_FRAME);
        let mut next_contact = Instant::now();
        while let Some(outgoing) = self.outbox.next(next_contact) {
            let newest = self.console_time_us.load(Ordering::Relaxed);
            frames.clear();
            let mut end = lock(&self.end);
            let encoded = match &outgoing {
                Outgoing::Order(Order::Command(command)) => {
                    append(&mut end, newest, command, &mut frames)
                }
                Outgoing::Order(Order::Fixture(fixture)) => {
                    append(&mut end, newest, fixture, &mut frames)
                }
                Outgoing::Order(Order::Simulate(simulate)) => {
                    append(&mut end, newest, simulate, &mut frames)
                }
                Outgoing::Latest((time_us, felt)) => {
                    append_all(&mut end, *time_us, felt, &mut frames)
                }
            };
            drop(end);
            if let Err(error) = encoded {
                // Nothing is sent that the console would refuse: it ages out what it has.
                tracing::warn!("a message to the console was not sent: {error}");
                continue;
            }
            let give_up = || self.closing.load(Ordering::Relaxed);
            if let Err(error) = write_all(port.as_mut(), &frames, give_up) {
                return self.break_off(&error);
            }
            if matches!(outgoing, Outgoing::Latest(_)) {
                self.contacts_sent.fetch_add(1, Ordering::Relaxed);
                next_contact = Instant::now() + contact_spacing;
            }
        }
    }

    fn break_off(&self, error: &io::Error) {
        lock(&self.broken).get_or_insert_with(|| describe(error));
        self.states.close();
        self.outbox.close();
    }
}

/// Writes one frame behind what is there.
fn append<M: Message>(
    end: &mut HostLink,
    console_time_us: u64,
    body: &M,
    frames: &mut Vec<u8>,
) -> Result<(), SendError> {
    let mut frame = [0; MAX_FRAME];
    let length = end.send(console_time_us, body, &mut frame)?;
    frames.extend_from_slice(&frame[..length]);
    Ok(())
}

/// Rows, needle, thread and contact, or none of them.
fn append_all(
    end: &mut HostLink,
    console_time_us: u64,
    felt: &Felt,
    frames: &mut Vec<u8>,
) -> Result<(), SendError> {
    let Felt {
        contact,
        rows,
        needle,
        thread,
    } = felt;
    // Before another frame takes its number in the sequence.
    contact.check().map_err(SendError::Invalid)?;
    if let Some(thread) = thread {
        thread.check().map_err(SendError::Invalid)?;
    }
    if let Some(needle) = needle {
        needle.check().map_err(SendError::Invalid)?;
    }
    if let Some(rows) = rows {
        append(end, console_time_us, rows, frames)?;
    }
    if let Some(needle) = needle {
        append(end, console_time_us, needle, frames)?;
    }
    if let Some(thread) = thread {
        append(end, console_time_us, thread, frames)?;
    }
    append(end, console_time_us, contact, frames)
}

fn describe(error: &io::Error) -> String {
    match error.kind() {
        io::ErrorKind::BrokenPipe => "it closed its end of the line".to_owned(),
        _ => error.to_string(),
    }
}

fn gone(name: &str, error: &io::Error) -> LinkError {
    LinkError::Gone {
        name: name.to_owned(),
        reason: describe(error),
    }
}

fn write_all(port: &mut dyn Port, mut bytes: &[u8], give_up: impl Fn() -> bool) -> io::Result<()> {
    while !bytes.is_empty() {
        let count = port.write(bytes)?;
        bytes = &bytes[count..];
        if count == 0 {
            if give_up() {
                return Err(io::ErrorKind::TimedOut.into());
            }
            // A full line drains within a tick or two of the console.
            std::thread::sleep(Duration::from_millis(1));
        }
    }
    Ok(())
}

/// Asks for a session until the console answers; what it said of itself, and the bytes behind its answer.
fn shake_hands(
    port: &mut dyn Port,
    end: &mut HostLink,
    within: Duration,
) -> Result<(Hello, Vec<u8>), LinkError> {
    let name = port.name();
    let started = Instant::now();
    let late = || started.elapsed() >= within;
    let (mut frame, mut chunk) = ([0; MAX_FRAME], [0; 4096]);
    let mut heard = 0;
    while !late() {
        let asked = Instant::now();
        let length = end.hello(nonce(), &mut frame).unwrap_or_default();
        // A delimiter first: it ends whatever half a frame an earlier host left on the line.
        let sent =
            write_all(port, &[0], late).and_then(|()| write_all(port, &frame[..length], late));
        sent.map_err(|error| gone(&name, &error))?;
        while asked.elapsed() < ASK_AGAIN && !late() {
            let count = port
                .read(&mut chunk, READ_WAIT)
                .map_err(|error| gone(&name, &error))?;
            heard += count;
            for (at, byte) in chunk[..count].iter().enumerate() {
                match end.receive(*byte) {
                    Some(HostEvent::Opened(console)) => {
                        return Ok((console, chunk[at + 1..count].to_vec()));
                    }
                    Some(HostEvent::Refused(mismatch)) => {
                        return Err(LinkError::Mismatch { name, mismatch });
                    }
                    _ => {}
                }
            }
        }
    }
    let heard = match (heard, end.counters().frames_rejected) {
        (0, _) => "nothing came".to_owned(),
        (_, 0) => format!("{heard} bytes came, no whole frame"),
        (_, rejected) => format!("{heard} bytes came, {rejected} frames were refused"),
    };
    Err(LinkError::NoAnswer {
        name,
        waited: within,
        heard,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use sutura_shared::link::{ConsoleLink, Identity};
    use sutura_shared::wire::Reject;
    use sutura_shared::wire::message::{Course, End, Friction, Tension, Tip};

    const CONTACT: Contact = Contact {
        tool: 0,
        position_m: [0.0; 3],
        orientation: [0.0, 0.0, 0.0, 1.0],
        wrench: [0.0; 6],
        tangent: [0.0; 21],
        gap_m: 0.0,
        normal: [0.0, 0.0, 1.0],
        relaxation_per_s: 0.0,
        horizon_us: 50_000,
    };
    const NEEDLE: Needle = Needle {
        tool: 0,
        needle: 0,
        position_m: [0.0; 3],
        orientation: [0.0, 0.0, 0.0, 1.0],
        slide: [0.0, 0.0, -1.0, 0.0, 0.0, 0.0],
        tip: Tip::Outside,
        friction: Friction::Sticks,
        axial_n: 0.0,
        friction_n: [0.0; 2],
        stiffness_n_per_m: [0.0; 2],
        hold_n: 0.0,
        puncture_n: 1.0,
        punctured_n: 0.0,
        course: Course {
            forward: 0,
            backward: 0,
            points: [[0.0; 2]; 12],
        },
        horizon_us: 50_000,
    };

    const THREAD: Thread = Thread {
        tool: 0,
        thread: 0,
        end: End::Head,
        state: Tension::Taut,
        position_m: [0.0; 3],
        direction: [0.0, 0.0, 1.0],
        tension_n: 1.0,
        stiffness_n_per_m: 100.0,
        slack_m: 0.0,
        horizon_us: 50_000,
    };

    /// What would be refused of the three holds all of them back and takes no number in the sequence, so that the
    /// console does not count it as lost.
    #[test]
    fn needle_thread_and_contact_go_together_or_not_at_all() {
        let identity = Identity {
            tick_hz: 1000,
            simulated: false,
            device_name: *b"bench\0\0\0\0\0\0\0\0\0\0\0",
        };
        let (mut host, mut console) = (HostLink::new(1000), ConsoleLink::new(identity, 7));
        let mut frame = [0; MAX_FRAME];
        let length = host.hello(3, &mut frame).expect("fits");
        frame[..length].iter().for_each(|byte| {
            console.receive(*byte, 0);
        });
        let length = console.take_reply(0, &mut frame).expect("an answer");
        frame[..length].iter().for_each(|byte| {
            host.receive(*byte);
        });

        let bad_contact = Contact {
            gap_m: f32::NAN,
            ..CONTACT
        };
        let bad_needle = Needle {
            hold_n: -1.0,
            ..NEEDLE
        };
        let bad_thread = Thread {
            slack_m: 0.1,
            ..THREAD
        };
        let mut frames = Vec::new();
        let mut append = |contact, needle, thread| {
            let felt = Felt {
                contact,
                rows: None,
                needle: Some(needle),
                thread: Some(thread),
            };
            append_all(&mut host, 0, &felt, &mut frames)
        };
        let not_finite = Err(SendError::Invalid(Reject::NotFinite));
        assert_eq!(append(bad_contact, NEEDLE, THREAD), not_finite);
        let range = Err(SendError::Invalid(Reject::Range));
        assert_eq!(append(CONTACT, bad_needle, THREAD), range);
        assert_eq!(append(CONTACT, NEEDLE, bad_thread), range);
        assert_eq!(append(CONTACT, NEEDLE, THREAD), Ok(()));
        let heard: Vec<_> = frames
            .iter()
            .filter_map(|byte| console.receive(*byte, 0))
            .collect();
        assert_eq!(heard.len(), 3, "{heard:?}");
        assert_eq!(console.counters().frames_lost, 0);
    }
}
