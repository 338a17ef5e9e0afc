//! An open link: one thread reads, one writes, and nobody else waits for either.
//!
//! Entry points: [`Link::open`], [`Link::open_with`]. States come in through a latest-value slot, contacts go out through
//! one; orders (commands, and what a simulation is told) wait in a bounded queue. Closing or dropping the link disarms
//! the console first. Nothing here is global: a process may have any number of links.

use super::clock::{Clock, ClockEstimate, Exchange, RoundTrips};
use super::felt::{Felt, Order, append};
use super::handshake::{READ_WAIT, gone, lock, shake_hands, write_all};
use super::sent::{SentContact, SentContacts};
use super::silence::Silence;
use super::slot::{Outbox, Outgoing, Slot};
use super::unusable::{Advance, Unusable};
use super::{LinkError, Port};
use crate::scheduling::{Duty, Granted, Role};
use std::fmt;
use std::sync::atomic::{AtomicBool, AtomicU16, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use sutura_shared::link::{Counters, HostEvent, HostLink, SendError};
use sutura_shared::wire::message::{Command, Hello, Ping, State};
use sutura_shared::wire::{MAX_FRAME, Reject, Valid};

/// How long a closing link waits for its threads. A write to a console that no longer takes bytes never
/// returns; its thread is then left behind.
const CLOSE_WAIT: Duration = Duration::from_millis(500);
/// Orders that may wait to be written; a session sends a handful at its start.
const ORDERS: usize = 16;
/// Time between two pings. Not a whole number of ticks (golden section), so that pings meet the console at every moment
/// of its tick.
const PING_EVERY: Duration = Duration::from_micros(99_382);
/// See [`LinkOptions::silent_after`]. A console answers every ping; and one that starts anew without
/// its port going away is to be found again within a second.
const SILENT: Duration = Duration::from_millis(600);
/// A console may take so long from its answer to the first state that can be used. A link that looks for its console again is over
/// then: it has never seen one.
const FIRST_STATE: Duration = Duration::from_secs(2);
/// Time between two attempts to open the port of a console that went away.
const OPEN_AGAIN: Duration = Duration::from_millis(100);
/// How long a console that came back may take to answer before its port is opened anew.
const ANSWER_AGAIN: Duration = Duration::from_secs(1);

/// What the caller decides about a link.
#[derive(Clone, Copy, Debug)]
pub struct LinkOptions {
    /// Control rate that the host expects \[Hz\].
    pub tick_hz: u16,
    /// How long the console may take to answer.
    pub answer_within: Duration,
    /// A console that sent no state that can be used for so long is taken for gone, where it can be looked for again. States whose
    /// ticks [stand still](Advance) cannot be used.
    pub silent_after: Duration,
    /// Shortest time between two contact frames; newer ones replace the one that waits.
    pub contact_spacing: Duration,
    /// Time between two pings: at most a third of the time for which a console is its host's.
    pub ping_every: Duration,
    /// Whether the link's threads ask for [real-time scheduling](crate::scheduling). [`Link::granted`] says what they got.
    pub real_time: bool,
    /// Whether [`Link::felt`] writes itself where the line is free, which saves the writer's wake-up. It then waits for a line
    /// that is full, for 20 ms at most. Not with a `contact_spacing`.
    pub at_once: bool,
    /// Whether to give up, asked while a handshake waits on the caller's thread.
    pub give_up: fn() -> bool,
}

impl Default for LinkOptions {
    fn default() -> Self {
        LinkOptions {
            tick_hz: 1000,
            answer_within: Duration::from_secs(3),
            silent_after: SILENT,
            contact_spacing: Duration::ZERO,
            ping_every: PING_EVERY,
            real_time: false,
            at_once: false,
            give_up: || false,
        }
    }
}

/// What went over a link so far, in all its sessions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LinkCounters {
    /// Frames, as the host's end counted them.
    pub frames: Counters,
    /// Why most of the host's end's refused frames were, and how many of them.
    pub refused_most: Option<(Reject, u32)>,
    /// Contact frames written.
    pub contacts_sent: u64,
    /// Solves of which nothing was written, since the console would have refused it.
    pub contacts_unsendable: u64,
    /// States replaced by a newer one before the solver took them.
    pub states_superseded: u64,
    /// Contacts replaced by a newer one before they were written.
    pub contacts_superseded: u64,
    /// Pings written.
    pub pings_sent: u64,
    /// Bytes written.
    pub bytes_down: u64,
    /// Bytes read.
    pub bytes_up: u64,
    /// Sessions, the first one included.
    pub sessions: u32,
}

/// Opens the console's port, the first time and whenever the console has gone away.
pub type Connector = Box<dyn FnMut() -> Result<Box<dyn Port>, LinkError> + Send>;

/// What a link's listener hears, on the reader's thread: it must return at once.
#[derive(Clone, Copy, Debug)]
pub enum Heard<'a> {
    /// A contact that went out; before any state that could know of it.
    Sent(SentContact),
    /// A state, a report, the answer to a ping.
    Event(&'a HostEvent),
    /// The console went away, or its session is over. The link tries to get it back.
    Lost(&'a LinkError),
    /// The console is back, in a new session: it is disarmed and knows nothing.
    Reopened(&'a Hello),
}

/// How a link stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Standing {
    /// A session is open: the how manieth.
    Open(u32),
    /// The console went away and is looked for.
    Lost,
    /// The link is over.
    Over,
}

/// A link with an open session.
pub struct Link {
    shared: Arc<Shared>,
    threads: Vec<JoinHandle<()>>,
    name: String,
    /// Whether its threads ask for real-time scheduling.
    asked: bool,
}

impl fmt::Debug for Link {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let standing = self.standing();
        f.debug_struct("Link")
            .field("name", &self.name)
            .field("standing", &standing)
            .finish_non_exhaustive()
    }
}

struct Shared {
    tick_hz: u16,
    end: Mutex<HostLink>,
    /// What the ends of earlier sessions counted.
    before: Mutex<Counters>,
    states: Slot<Valid<State>>,
    /// What was solved for the newest state, and its console time \[us\].
    outbox: Outbox<Order, (u64, Felt)>,
    /// Contacts that went out and that the listener has not heard of.
    sent: Mutex<SentContacts>,
    /// Whether what is felt is written at once.
    at_once: bool,
    /// Threads that go before ordinary ones, of those that asked.
    granted: AtomicU64,
    /// Where the writer writes; none while the console is away.
    line: Mutex<Option<Written>>,
    /// Why the writer could not.
    unwritten: Mutex<Option<LinkError>>,
    status: Mutex<Status>,
    /// States since the last one that could be used.
    unusable: Mutex<Unusable>,
    /// Ticks between two states, as the console was told in this session.
    state_every: AtomicU16,
    clock: Mutex<Clock>,
    /// The host's clock starts here.
    started: Instant,
    contacts_sent: AtomicU64,
    contacts_unsendable: AtomicU64,
    pings_sent: AtomicU64,
    bytes_down: AtomicU64,
    bytes_up: AtomicU64,
    /// Console time of the newest state \[us\].
    console_time_us: AtomicU64,
    closing: AtomicBool,
}

/// The line as those who write see it.
struct Written {
    port: Box<dyn Port>,
    /// Bytes of a frame that has begun.
    rest: Vec<u8>,
    /// For what is written next.
    frames: Vec<u8>,
}

impl Written {
    fn new(port: Box<dyn Port>) -> Self {
        Written {
            port,
            rest: Vec::with_capacity(3 * MAX_FRAME),
            frames: Vec::with_capacity(3 * MAX_FRAME),
        }
    }
}

struct Status {
    standing: Standing,
    sessions: u32,
    console: Hello,
    /// Why the link is over.
    over: Option<LinkError>,
}

impl Link {
    /// Opens a session with the console at the other end of `port` and starts the I/O threads. Once the console goes
    /// away the link is over.
    ///
    /// `listener` hears every state and report, on the reader's thread: it must return at once.
    ///
    /// # Errors
    /// [`LinkError::NoAnswer`], [`LinkError::Owned`], [`LinkError::Mismatch`], or [`LinkError::Gone`].
    pub fn open(
        port: Box<dyn Port>,
        options: LinkOptions,
        mut listener: impl FnMut(&HostEvent) + Send + 'static,
    ) -> Result<Link, LinkError> {
        Link::open_heard(port, options, move |heard| {
            if let Heard::Event(event) = heard {
                listener(event);
            }
        })
    }

    /// Like [`open`](Self::open), with a listener that hears of contacts that went out, too.
    ///
    /// # Errors
    /// Those of [`open`](Self::open).
    pub fn open_heard(
        port: Box<dyn Port>,
        options: LinkOptions,
        listener: impl FnMut(Heard<'_>) + Send + 'static,
    ) -> Result<Link, LinkError> {
        Link::start(port, None, options, listener)
    }

    /// Like [`open`](Self::open), with a console that may go away, start anew or close the session: its port is then opened
    /// again until it is back, or this link is closed. Orders and contacts that wait are dropped, and the console, which
    /// is disarmed, stays so until [`order`](Self::order) arms it.
    ///
    /// # Errors
    /// Those of `connect` and [`open`](Self::open), the first time.
    pub fn open_with(
        connect: impl FnMut() -> Result<Box<dyn Port>, LinkError> + Send + 'static,
        options: LinkOptions,
        listener: impl FnMut(Heard<'_>) + Send + 'static,
    ) -> Result<Link, LinkError> {
        let mut connect: Connector = Box::new(connect);
        let port = connect()?;
        Link::start(port, Some(connect), options, listener)
    }

    fn start(
        mut port: Box<dyn Port>,
        connect: Option<Connector>,
        options: LinkOptions,
        listener: impl FnMut(Heard<'_>) + Send + 'static,
    ) -> Result<Link, LinkError> {
        let name = port.name();
        let end = Mutex::new(HostLink::new(options.tick_hz));
        let (console, rest) =
            shake_hands(port.as_mut(), &end, options.answer_within, options.give_up)?;
        let writer_port = port.try_clone().map_err(|error| gone(&name, &error))?;
        let shared = Arc::new(Shared {
            tick_hz: options.tick_hz,
            end,
            before: Mutex::default(),
            states: Slot::default(),
            outbox: Outbox::new(ORDERS),
            sent: Mutex::default(),
            at_once: options.at_once && options.contact_spacing.is_zero(),
            granted: AtomicU64::new(0),
            line: Mutex::new(Some(Written::new(writer_port))),
            unwritten: Mutex::new(None),
            status: Mutex::new(Status {
                standing: Standing::Open(1),
                sessions: 1,
                console,
                over: None,
            }),
            unusable: Mutex::default(),
            state_every: AtomicU16::new(1),
            clock: Mutex::default(),
            started: Instant::now(),
            contacts_sent: AtomicU64::new(0),
            contacts_unsendable: AtomicU64::new(0),
            pings_sent: AtomicU64::new(0),
            bytes_down: AtomicU64::new(0),
            bytes_up: AtomicU64::new(0),
            console_time_us: AtomicU64::new(0),
            closing: AtomicBool::new(false),
        });
        let mut link = Link {
            shared,
            threads: Vec::new(),
            name,
            asked: options.real_time,
        };
        let reader = Reader {
            shared: link.shared.clone(),
            connect,
            options,
            listener,
        };
        link.spawn("sutura-read", move || reader.run(port, rest))?;
        let writes = link.shared.clone();
        link.spawn("sutura-write", move || writes.write(&options))?;
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

    /// What the console said of itself, in the newest session.
    pub fn console(&self) -> Hello {
        lock(&self.shared.status).console
    }

    /// What the user calls the port.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// How the link stands.
    pub fn standing(&self) -> Standing {
        lock(&self.shared.status).standing
    }

    /// Takes the newest state that nobody took yet, waiting for one until `deadline`.
    ///
    /// # Errors
    /// As [`check`](Self::check), when all that came before has been taken.
    pub fn state(&self, deadline: Instant) -> Result<Option<Valid<State>>, LinkError> {
        self.state_from(None, deadline)
    }

    /// As [`state`](Self::state), waiting for one of that tick or later; at the deadline the newest, whatever its tick.
    /// Only one thread may wait in this way.
    ///
    /// # Errors
    /// As [`state`](Self::state).
    pub fn state_from(
        &self,
        tick: Option<u32>,
        deadline: Instant,
    ) -> Result<Option<Valid<State>>, LinkError> {
        match self.shared.states.wait_for(tick, deadline) {
            Some(state) => Ok(Some(state)),
            None => self.check().map(|()| None),
        }
    }

    /// Puts out what was solved for the state of `console_time_us`, in place of what still waits.
    pub fn felt(&self, console_time_us: u64, felt: Felt) {
        if !self.shared.write_at_once(console_time_us, &felt) {
            self.shared.outbox.put((console_time_us, felt));
        }
    }

    /// What the link's threads got of the system, if they [asked](LinkOptions::real_time).
    pub fn granted(&self) -> Granted {
        match self.shared.granted.load(Ordering::Relaxed) {
            _ if !self.asked => Granted::NotAsked,
            0 | 1 => Granted::Ordinary,
            _ => Granted::RealTime,
        }
    }

    /// Queues an order; while the console is away it is dropped.
    ///
    /// # Errors
    /// As [`check`](Self::check); [`LinkError::Stuck`] if the console takes no orders.
    pub fn order(&self, order: Order) -> Result<(), LinkError> {
        self.check()?;
        if let Order::Command(Command::StateEvery { ticks }) = order {
            self.shared.state_every.store(ticks, Ordering::Relaxed);
        }
        let queued = self.shared.outbox.order(order);
        queued.map_err(|_| LinkError::Stuck {
            name: self.name.clone(),
            waiting: ORDERS,
        })
    }

    /// Whether the link is not over: a console that is away may come back.
    ///
    /// # Errors
    /// [`LinkError::Gone`], or why the console that came back is not to be used.
    pub fn check(&self) -> Result<(), LinkError> {
        match &lock(&self.shared.status).over {
            None => Ok(()),
            Some(error) => Err(error.clone()),
        }
    }

    /// The reason why no state came since the last that could be used, in words.
    pub fn why_no_state(&self) -> String {
        lock(&self.shared.unusable).to_string()
    }

    /// What went over the link so far.
    pub fn counters(&self) -> LinkCounters {
        let shared = &self.shared;
        let refused_most = lock(&shared.unusable).refused_most();
        LinkCounters {
            frames: sum(*lock(&shared.before), lock(&shared.end).counters()),
            refused_most,
            contacts_sent: shared.contacts_sent.load(Ordering::Relaxed),
            contacts_unsendable: shared.contacts_unsendable.load(Ordering::Relaxed),
            states_superseded: shared.states.superseded(),
            contacts_superseded: shared.outbox.superseded(),
            pings_sent: shared.pings_sent.load(Ordering::Relaxed),
            bytes_down: shared.bytes_down.load(Ordering::Relaxed),
            bytes_up: shared.bytes_up.load(Ordering::Relaxed),
            sessions: lock(&shared.status).sessions,
        }
    }

    /// The console's clock; none before the first answer to a ping. The host's is [`host_us`](Self::host_us).
    pub fn clock(&self) -> Option<ClockEstimate> {
        lock(&self.shared.clock).estimate()
    }

    /// Round trips of the pings so far.
    pub fn round_trips(&self) -> RoundTrips {
        lock(&self.shared.clock).round_trips()
    }

    /// Round trips of the pings of the last while; of the last minute at most.
    pub fn round_trips_within(&self, last: Duration) -> RoundTrips {
        let last_us = u64::try_from(last.as_micros()).unwrap_or(u64::MAX);
        let since_us = self.host_us().saturating_sub(last_us);
        lock(&self.shared.clock).round_trips_since(since_us)
    }

    /// The host's clock: since the link was opened \[us\].
    pub fn host_us(&self) -> u64 {
        self.shared.host_us(Instant::now())
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

/// The reader's thread, which also gets a lost console back.
struct Reader<L> {
    shared: Arc<Shared>,
    connect: Option<Connector>,
    options: LinkOptions,
    listener: L,
}

impl<L: FnMut(Heard<'_>)> Reader<L> {
    /// Until the link closes or is over.
    fn run(mut self, mut port: Box<dyn Port>, mut rest: Vec<u8>) {
        let mut duty = self.shared.begin(&self.options);
        loop {
            let Some(lost) = self.read(port.as_mut(), &rest, &mut duty) else {
                return;
            };
            // Some ports can be opened once only: let go of this one first.
            drop(port);
            if self.connect.is_none() || matches!(lost, LinkError::NoStates { .. }) {
                return self.shared.end(lost);
            }
            self.shared.suspend();
            (self.listener)(Heard::Lost(&lost));
            match self.reconnect() {
                Ok(Some((new, hello, bytes))) => {
                    (port, rest) = (new, bytes);
                    (self.listener)(Heard::Reopened(&hello));
                }
                Ok(None) => return,
                Err(error) => return self.shared.end(error),
            }
        }
    }

    /// Bytes to events, events to the slot and the listener; why the session is lost, none if the link closes.
    fn read(
        &mut self,
        port: &mut dyn Port,
        rest: &[u8],
        duty: &mut Option<Duty>,
    ) -> Option<LinkError> {
        let opened = Instant::now();
        lock(&self.shared.unusable).begin();
        let mut advance = Advance::new(self.options.tick_hz, self.options.silent_after);
        let mut counted = u32::from(self.hear(rest, opened, &mut advance));
        let is_first = lock(&self.shared.status).sessions == 1;
        let mut silence = Silence::from(opened);
        let mut chunk = [0; 4096];
        while !self.shared.is_closing() {
            duty.as_mut().map(Duty::look);
            if let Some(error) = lock(&self.shared.unwritten).take() {
                return Some(error);
            }
            match port.read(&mut chunk, READ_WAIT) {
                Ok(count) => {
                    let now = Instant::now();
                    let came = self.hear(&chunk[..count], now, &mut advance);
                    counted = counted.saturating_add(u32::from(came));
                    let quiet = silence.look(now, came);
                    // The first counts, whatever its tick: only the next one shows that ticks go on.
                    let is_new = is_first && counted < 2;
                    if self.connect.is_some() && quiet > self.patience(is_new) {
                        return Some(self.without_states(port.name(), is_new));
                    }
                }
                Err(error) => return Some(gone(&port.name(), &error)),
            }
        }
        None
    }

    /// Time without a state that can be used after which the console is gone; a new one has longer.
    fn patience(&self, is_new: bool) -> Duration {
        let every = f64::from(self.shared.state_every.load(Ordering::Relaxed));
        let between = Duration::from_secs_f64(every / f64::from(self.options.tick_hz.max(1)));
        let silent = self.options.silent_after + between;
        match is_new {
            true => silent.max(FIRST_STATE),
            false => silent,
        }
    }

    /// The error of a session in which no state can be used for so long.
    fn without_states(&self, name: String, is_new: bool) -> LinkError {
        let waited = self.patience(is_new);
        let unusable = lock(&self.shared.unusable);
        let heard = unusable.to_string();
        if is_new {
            return LinkError::NoStates {
                name,
                waited,
                heard,
                refused: unusable.is_refused(),
            };
        }
        let reason = format!("no state for {:.1} s: {heard}", waited.as_secs_f64());
        LinkError::Gone { name, reason }
    }

    /// Whether a state that counts was among the bytes that came at `now`.
    fn hear(&mut self, bytes: &[u8], now: Instant, advance: &mut Advance) -> bool {
        let shared = &self.shared;
        shared
            .bytes_up
            .fetch_add(bytes.len() as u64, Ordering::Relaxed);
        lock(&shared.unusable).bytes(bytes.len());
        let mut any = false;
        let mut bytes = bytes.iter();
        loop {
            // Not over the listener, and not for every byte.
            let event = {
                let mut end = lock(&shared.end);
                let mut unusable = lock(&shared.unusable);
                bytes.find_map(|byte| {
                    let event = end.receive(*byte);
                    unusable.look(&end.counters());
                    event
                })
            };
            let Some(event) = event else { return any };
            if matches!(event, HostEvent::State(_)) {
                // Not over the listener either.
                let next = || lock(&shared.sent).next();
                while let Some(sent) = next() {
                    (self.listener)(Heard::Sent(sent));
                }
            }
            (self.listener)(Heard::Event(&event));
            match event {
                HostEvent::State(state) => {
                    let time_us = state.console_time_us();
                    shared.console_time_us.store(time_us, Ordering::Relaxed);
                    let tick = state.body().tick;
                    shared.states.put(tick, state);
                    let counts = advance.counts(tick);
                    any |= counts;
                    let mut unusable = lock(&shared.unusable);
                    match counts {
                        true => unusable.counted(tick),
                        false => unusable.stood(tick),
                    }
                }
                HostEvent::Pong(pong) => {
                    let pong = pong.body();
                    lock(&shared.clock).note(&Exchange {
                        asked_us: pong.host_us,
                        received_us: pong.received_us,
                        sent_us: pong.sent_us,
                        heard_us: shared.host_us(now),
                    });
                    lock(&shared.unusable).other();
                }
                _ => lock(&shared.unusable).other(),
            }
        }
    }

    /// Tries to open the port and a session until it succeeds; none if the link closes.
    #[allow(
        clippy::type_complexity,
        reason = "a port, who is there, and what it said"
    )]
    fn reconnect(&mut self) -> Result<Option<(Box<dyn Port>, Hello, Vec<u8>)>, LinkError> {
        let Reader {
            shared,
            connect: Some(connect),
            options,
            ..
        } = self
        else {
            return Ok(None);
        };
        while !shared.is_closing() {
            let attempt = connect().and_then(|mut port| {
                let within = ANSWER_AGAIN.min(options.answer_within);
                let closing = || shared.is_closing();
                let (hello, rest) = shake_hands(port.as_mut(), &shared.end, within, closing)?;
                let name = port.name();
                let writer = port.try_clone().map_err(|error| gone(&name, &error))?;
                Ok((port, writer, hello, rest))
            });
            match attempt {
                Ok((port, writer, hello, rest)) => {
                    shared.resume(writer, hello);
                    return Ok(Some((port, hello, rest)));
                }
                Err(error @ LinkError::Mismatch { .. }) => return Err(error),
                Err(error) => tracing::debug!("not back yet: {error}"),
            }
            std::thread::sleep(OPEN_AGAIN);
        }
        Ok(None)
    }
}

impl Shared {
    fn is_closing(&self) -> bool {
        self.closing.load(Ordering::Relaxed)
    }

    fn host_us(&self, now: Instant) -> u64 {
        let since = now.saturating_duration_since(self.started);
        u64::try_from(since.as_micros()).unwrap_or(u64::MAX)
    }

    /// The session is lost: what was on its way belongs to it.
    fn suspend(&self) {
        lock(&self.status).standing = Standing::Lost;
        *lock(&self.line) = None;
        self.outbox.clear();
        self.states.clear();
        lock(&self.clock).forget();
        self.console_time_us.store(0, Ordering::Relaxed);
        self.state_every.store(1, Ordering::Relaxed);
        let mut before = lock(&self.before);
        let mut end = lock(&self.end);
        *before = sum(*before, end.counters());
        *end = HostLink::new(self.tick_hz);
        // Within the end's lock, as they are written down.
        lock(&self.sent).clear();
    }

    /// Another session is open.
    fn resume(&self, writer: Box<dyn Port>, console: Hello) {
        // Nothing of the old session may go out in the new one.
        self.outbox.clear();
        lock(&self.unwritten).take();
        *lock(&self.line) = Some(Written::new(writer));
        let mut status = lock(&self.status);
        status.sessions += 1;
        status.console = console;
        status.standing = Standing::Open(status.sessions);
    }

    /// The link is over.
    fn end(&self, error: LinkError) {
        let mut status = lock(&self.status);
        status.over.get_or_insert(error);
        status.standing = Standing::Over;
        drop(status);
        self.states.close();
        self.outbox.close();
    }

    /// What the calling thread asks of the system, if it is to.
    fn begin(&self, options: &LinkOptions) -> Option<Duty> {
        let duty = options.real_time.then(|| Duty::begin(Role::Link))?;
        if duty.granted() == Granted::RealTime {
            self.granted.fetch_add(1, Ordering::Relaxed);
        }
        Some(duty)
    }

    /// Until the outbox is closed: orders, contacts and pings to bytes, all that goes together in one write.
    fn write(&self, options: &LinkOptions) {
        let mut duty = self.begin(options);
        let mut next_contact = Instant::now();
        let mut next_ping = Instant::now();
        while let Some(outgoing) = self.outbox.next(next_contact, next_ping) {
            duty.as_mut().map(Duty::look);
            let mut line = lock(&self.line);
            let pings = Instant::now() >= next_ping;
            if pings {
                next_ping = Instant::now() + options.ping_every;
            }
            // The console is away.
            let Some(Written { port, rest, frames }) = line.as_mut() else {
                continue;
            };
            frames.clear();
            frames.append(rest);
            let encoded = self.encode(&outgoing, pings, frames);
            if let Err(error) = &encoded {
                // Nothing is sent that the console would refuse: it ages out what it has.
                tracing::warn!("a message to the console was not sent: {error}");
            }
            let give_up = || self.is_closing() || lock(&self.status).standing == Standing::Lost;
            if let Err(error) = write_all(port.as_mut(), frames, give_up) {
                let error = gone(&port.name(), &error);
                *line = None;
                drop(line);
                lock(&self.unwritten).get_or_insert(error);
                continue;
            }
            self.bytes_down
                .fetch_add(frames.len() as u64, Ordering::Relaxed);
            self.pings_sent
                .fetch_add(u64::from(pings), Ordering::Relaxed);
            if matches!(outgoing, Outgoing::Latest(_)) && encoded.is_ok() {
                self.contacts_sent.fetch_add(1, Ordering::Relaxed);
                next_contact = Instant::now() + options.contact_spacing;
            }
        }
    }

    /// Writes what was solved past the writer, if that is what is wanted, nothing waits and nobody else writes. What the
    /// line does not take at once is the writer's.
    fn write_at_once(&self, console_time_us: u64, felt: &Felt) -> bool {
        if !self.at_once || !self.outbox.is_idle() {
            return false;
        }
        let Ok(mut line) = self.line.try_lock() else {
            return false;
        };
        let Some(Written { port, rest, frames }) = line.as_mut() else {
            return false;
        };
        if !rest.is_empty() {
            return false;
        }
        frames.clear();
        let encoded = self.append_felt(&mut lock(&self.end), console_time_us, felt, frames);
        if let Err(error) = encoded {
            // Nothing is sent that the console would refuse: it ages out what it has.
            tracing::warn!("a message to the console was not sent: {error}");
            return true;
        }
        match port.write(frames) {
            Ok(count) => {
                rest.extend_from_slice(frames.get(count..).unwrap_or_default());
                self.bytes_down.fetch_add(count as u64, Ordering::Relaxed);
                self.contacts_sent.fetch_add(1, Ordering::Relaxed);
                if !rest.is_empty() {
                    self.outbox.call();
                }
            }
            Err(error) => {
                let error = gone(&port.name(), &error);
                *line = None;
                drop(line);
                lock(&self.unwritten).get_or_insert(error);
            }
        }
        true
    }

    /// Appends what was solved, and notes its contact for the listener.
    fn append_felt(
        &self,
        end: &mut HostLink,
        console_time_us: u64,
        felt: &Felt,
        frames: &mut Vec<u8>,
    ) -> Result<(), SendError> {
        match felt.append(end, console_time_us, frames) {
            Ok(sent) => {
                lock(&self.sent).put(sent);
                Ok(())
            }
            Err(error) => {
                self.contacts_unsendable.fetch_add(1, Ordering::Relaxed);
                Err(error)
            }
        }
    }

    fn encode(
        &self,
        outgoing: &Outgoing<Order, (u64, Felt)>,
        pings: bool,
        frames: &mut Vec<u8>,
    ) -> Result<(), SendError> {
        let newest = self.console_time_us.load(Ordering::Relaxed);
        let mut end = lock(&self.end);
        if pings {
            let host_us = self.host_us(Instant::now());
            append(&mut end, newest, &Ping { host_us }, frames)?;
        }
        match outgoing {
            Outgoing::Order(order) => order.append(&mut end, newest, frames),
            Outgoing::Latest((time_us, felt)) => self.append_felt(&mut end, *time_us, felt, frames),
            Outgoing::Nothing => Ok(()),
        }
    }
}

/// What two ends counted.
fn sum(a: Counters, b: Counters) -> Counters {
    Counters {
        frames_sent: a.frames_sent.saturating_add(b.frames_sent),
        frames_received: a.frames_received.saturating_add(b.frames_received),
        frames_lost: a.frames_lost.saturating_add(b.frames_lost),
        frames_rejected: a.frames_rejected.saturating_add(b.frames_rejected),
        last_reject: b.last_reject.or(a.last_reject),
    }
}
