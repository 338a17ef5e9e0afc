//! What a session shows, and what its clients have of it.
//!
//! Entry points: [`Shared`] for the session's side, [`Shared::next_for`] for a client's. A picture is a latest value: a client is
//! given the next one when all but one are acknowledged, and never an older one than there is.

use super::command::{Command, FORMAT, Refused};
use serde_json::{Value, json};
use std::collections::{BTreeMap, VecDeque};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::Sender;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::sync::Notify;

/// Most clients at once.
pub const MOST_CLIENTS: usize = 8;
/// Pictures that a client may have without having said so.
const UNDERWAY: usize = 2;
/// Blocks of telemetry that are kept: 60 s of 20 a second, ticks and solves.
const KEPT: usize = 2 * 60 * 20;
/// Who is so many blocks behind gets the newest: 5 s.
const BEHIND: u64 = 2 * 5 * 20;
/// Blocks that a newcomer gets: 10 s.
const RECENT: u64 = 2 * 10 * 20;
/// Texts that are kept for clients which are busy.
const TEXTS: usize = 256;
/// Answers that a client may leave unread.
const ANSWERS: usize = 256;
/// Pictures a second that a client wants until it says otherwise \[Hz\].
const PICTURE_HZ: f64 = 30.0;

/// Kinds of messages that are told apart here.
const PICTURE: u8 = 2;
const SOLVES: u8 = 4;

/// Bytes that several clients get.
pub type Bytes = Arc<[u8]>;

/// A command, and where its answer goes.
#[derive(Debug)]
pub struct Request {
    /// What is asked for.
    pub command: Command,
    /// Who asks.
    pub reply: Reply,
}

/// Where an answer goes. Dropped without one the client hears that there is none.
#[derive(Debug)]
pub struct Reply {
    shared: Arc<Shared>,
    client: u64,
    id: u64,
    is_given: bool,
}

impl Reply {
    /// Name of the person who asks: a page by its number, or the terminal of this program.
    pub fn person(&self) -> String {
        let state = self.shared.lock();
        match state.clients.get(&self.client) {
            Some(client) if client.is_own => "the terminal".to_owned(),
            _ => format!("page {}", self.client),
        }
    }

    /// It has been done.
    pub fn done(mut self) {
        self.give(json!({"re": self.id, "ok": true}));
    }

    /// It is not done, and why, and what to do.
    pub fn refuse(mut self, message: &str, help: &str) {
        self.give(json!({"re": self.id, "error": {"message": message, "help": help}}));
    }

    /// Name of the person who asks.
    pub fn asker(&self) -> &'static str {
        let state = self.shared.lock();
        match state.clients.get(&self.client) {
            Some(client) if client.is_own => "the terminal",
            _ if state.controller == Some(self.client) => "the page that controls",
            _ => "a page that watches",
        }
    }

    fn give(&mut self, answer: Value) {
        self.is_given = true;
        self.shared.answer(self.client, answer.to_string());
    }
}

impl Drop for Reply {
    fn drop(&mut self) {
        if !self.is_given {
            let error = json!({"message": "the session is over", "help": "begin another one"});
            self.give(json!({"re": self.id, "error": error}));
        }
    }
}

/// How a session begins, or changes altogether.
#[derive(Clone, Debug, Default)]
pub struct Beginning {
    /// What `hello` says of it, but for what the server knows: version, session, role.
    pub hello: serde_json::Map<String, Value>,
    /// The geometry's message; its session is written by the server.
    pub geometry: Option<Vec<u8>>,
    /// Whether it is a recording: all of its telemetry is kept, and it is looked at by time.
    pub recorded: bool,
}

/// What clients want of pictures.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Wants {
    /// Pictures a second \[Hz\]; 0: nobody watches.
    pub picture_hz: f64,
    /// The scalar that was asked for last.
    pub scalar: Option<String>,
}

/// Figures of a server.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Figures {
    /// Clients that there are.
    pub clients: usize,
    /// Clients that there have been.
    pub joined: u64,
    /// Whether one of them controls.
    pub controller: bool,
    /// Pictures that were sent, to all clients together.
    pub sent: u64,
}

/// What is sent next.
#[derive(Clone, Debug, PartialEq)]
pub enum Next {
    /// JSON.
    Text(String),
    /// A message.
    Binary(Bytes),
    /// Telemetry of which something before it is missing.
    AfterGap(Bytes),
}

/// A client that has given the key.
#[derive(Debug)]
struct Client {
    wake: Arc<Notify>,
    may_control: bool,
    /// Parts of the session that it has; `None`: it has to be greeted.
    version: Option<u64>,
    /// Number of the session whose hello it has; 0: none.
    session: u32,
    /// Number of the session whose geometry it has; 0: none.
    geometry: u32,
    answers: VecDeque<String>,
    /// Next text and next block.
    text: u64,
    block: u64,
    /// End of the blocks when it came: what it gets of the time before is not late.
    came: u64,
    /// Whether something is missing before the next ticks, and solves.
    gaps: [bool; 2],
    /// Picture that it was given last, and those it has not said that it has.
    picture: u64,
    underway: VecDeque<u32>,
    seek: Option<Bytes>,
    picture_hz: f64,
    /// Whether it is a part of the program that shows.
    is_own: bool,
}

#[derive(Debug, Default)]
struct State {
    beginning: Beginning,
    session: u32,
    /// Counts beginnings and changes of roles and settings: who has seen another number begins anew.
    version: u64,
    clients: BTreeMap<u64, Client>,
    next_client: u64,
    joined: u64,
    controller: Option<u64>,
    scalar: Option<String>,
    /// Counts pictures, and the newest.
    pictures: u64,
    picture: Option<Bytes>,
    blocks: VecDeque<Bytes>,
    /// Number of the first block that is kept, and of the first text.
    first_block: u64,
    texts: VecDeque<String>,
    first_text: u64,
    /// Pictures of a recording by their time \[s\], ascending.
    line: Vec<(f64, Bytes)>,
}

/// What a session shows, for all clients.
#[derive(Debug)]
pub struct Shared {
    state: Mutex<State>,
    sent: AtomicU64,
    requests: Sender<Request>,
    /// Wakes whoever makes pictures.
    wanted: std::sync::Condvar,
}

impl Shared {
    /// Of a session that takes `requests`.
    pub fn new(requests: Sender<Request>) -> Arc<Self> {
        Arc::new(Self {
            state: Mutex::new(State::default()),
            sent: AtomicU64::new(0),
            requests,
            wanted: std::sync::Condvar::new(),
        })
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A session begins.
    pub fn begin(&self, mut beginning: Beginning) {
        let mut state = self.lock();
        state.session += 1;
        state.version += 1;
        if let Some(place) = beginning
            .geometry
            .as_mut()
            .and_then(|bytes| bytes.get_mut(20..24))
        {
            place.copy_from_slice(&state.session.to_le_bytes());
        }
        state.beginning = beginning;
        state.picture = None;
        state.first_block += state.blocks.len() as u64;
        state.blocks.clear();
        state.line.clear();
        state.scalar = None;
        let first_block = state.first_block;
        for client in state.clients.values_mut() {
            (client.block, client.came, client.seek) = (first_block, first_block, None);
            client.gaps = [true; 2];
            client.underway.clear();
        }
        state.wake_all();
    }

    /// Number of the session.
    pub fn session(&self) -> u32 {
        self.lock().session
    }

    /// A picture that is newer than all before.
    pub fn picture(&self, bytes: Vec<u8>) {
        let mut state = self.lock();
        state.pictures += 1;
        state.picture = Some(bytes.into());
        state.wake_all();
    }

    /// A picture of a recording at a time \[s\], in place of the one of that time if there is one.
    pub fn recorded_picture(&self, time_s: f64, bytes: Vec<u8>) {
        let line = &mut self.lock().line;
        let place = line.partition_point(|(at_s, _)| *at_s < time_s);
        match line.get_mut(place).filter(|(at_s, _)| *at_s <= time_s) {
            Some((_, before)) => *before = bytes.into(),
            None => line.insert(place, (time_s, bytes.into())),
        }
    }

    /// A block of ticks or solves.
    pub fn block(&self, bytes: Vec<u8>) {
        let mut state = self.lock();
        state.blocks.push_back(bytes.into());
        if state.blocks.len() > KEPT && !state.beginning.recorded {
            state.blocks.pop_front();
            state.first_block += 1;
        }
        state.wake_all();
    }

    /// Gauges, or an event.
    pub fn text(&self, text: &Value) {
        let mut state = self.lock();
        let text = text.to_string();
        state.texts.push_back(text);
        if state.texts.len() > TEXTS {
            state.texts.pop_front();
            state.first_text += 1;
        }
        state.wake_all();
    }

    /// Changes a part of what `hello` says to those who come from now on.
    pub fn amend(&self, key: &str, value: Value) {
        self.lock().beginning.hello.insert(key.to_owned(), value);
    }

    /// Says `hello` again to all who are there, after a change of it.
    pub fn say_again(&self) {
        let mut state = self.lock();
        state.version += 1;
        state.wake_all();
    }

    /// What clients want.
    pub fn wants(&self) -> Wants {
        self.lock().wants()
    }

    /// Waits until somebody watches, or for so long.
    pub fn wait_for_watcher(&self, most: std::time::Duration) -> Wants {
        let state = self.lock();
        let idle = |state: &mut State| state.wants().picture_hz == 0.0;
        let waited = self.wanted.wait_timeout_while(state, most, idle);
        let (state, _) = waited.unwrap_or_else(PoisonError::into_inner);
        state.wants()
    }

    /// Clients, and what was sent.
    pub fn figures(&self) -> Figures {
        let state = self.lock();
        Figures {
            clients: state.others(),
            joined: state.joined,
            controller: state.controller.is_some(),
            sent: self.sent.load(Ordering::Relaxed),
        }
    }

    /// A client has given the key. `None` if there are enough.
    pub fn join(&self, wants_control: bool, may_control: bool) -> Option<(u64, Arc<Notify>)> {
        let mut state = self.lock();
        if state.others() >= MOST_CLIENTS {
            return None;
        }
        state.joined += 1;
        let joined = self.enter(&mut state, wants_control, may_control);
        Some(joined)
    }

    /// A part of this program is shown the session as a client is, without a line: it does not count, and wants no pictures until
    /// it says so.
    pub fn join_own(&self, wants_control: bool) -> u64 {
        let mut state = self.lock();
        let (id, _) = self.enter(&mut state, wants_control, true);
        if let Some(client) = state.clients.get_mut(&id) {
            (client.is_own, client.picture_hz) = (true, 0.0);
        }
        id
    }

    fn enter(
        &self,
        state: &mut State,
        wants_control: bool,
        may_control: bool,
    ) -> (u64, Arc<Notify>) {
        let id = state.next_client;
        state.next_client += 1;
        if wants_control && may_control && state.controller.is_none() {
            state.controller = Some(id);
        }
        let end = state.first_block + state.blocks.len() as u64;
        let recent = if state.beginning.recorded {
            0
        } else {
            end.saturating_sub(RECENT)
        };
        let wake = Arc::new(Notify::new());
        let client = Client {
            wake: wake.clone(),
            may_control,
            version: None,
            session: 0,
            geometry: 0,
            answers: VecDeque::new(),
            text: state.first_text + state.texts.len() as u64,
            block: recent.max(state.first_block),
            came: end,
            gaps: [true; 2],
            picture: 0,
            underway: VecDeque::new(),
            seek: None,
            picture_hz: PICTURE_HZ,
            is_own: false,
        };
        state.clients.insert(id, client);
        wake.notify_one();
        self.wanted.notify_all();
        (id, wake)
    }

    /// A client is gone.
    pub fn leave(&self, id: u64) {
        let mut state = self.lock();
        state.clients.remove(&id);
        if state.controller == Some(id) {
            state.controller = None;
        }
    }

    /// What a client says after its first message; its answer, if there is one now.
    pub fn hear(self: &Arc<Self>, client: u64, text: &str) {
        let answer = match Command::read(text) {
            Err(refused) => Some(refusal(&refused)),
            Ok((id, command)) => self.obey(client, id, command),
        };
        if let Some(answer) = answer {
            self.answer(client, answer);
        }
    }

    fn obey(self: &Arc<Self>, client: u64, id: u64, command: Command) -> Option<String> {
        let ok = || Some(json!({"re": id, "ok": true}).to_string());
        let refuse = |message: String, help: &str| Some(refusal(&Refused::new(id, message, help)));
        let mut state = self.lock();
        let own = state.clients.get_mut(&client)?;
        match &command {
            Command::Ack(sequence) => {
                let known = own.underway.iter().position(|each| each == sequence);
                own.underway.drain(..known.map_or(0, |place| place + 1));
                own.wake.notify_one();
                return None;
            }
            Command::PictureHz(hz) => {
                own.picture_hz = *hz;
                self.wanted.notify_all();
                return ok();
            }
            Command::TakeControl if !own.may_control => {
                let message = "the controls are for pages on the host's own machine".to_owned();
                return refuse(
                    message,
                    "use `ssh -L`, or start the host with --view-control any",
                );
            }
            Command::TakeControl => {
                let before = state.controller.replace(client);
                if before != Some(client) {
                    // The others' roles stay.
                    for id in before.into_iter().chain([client]) {
                        state.greet_again(id);
                    }
                }
                return ok();
            }
            _ => {}
        }
        let name = command.name();
        let listed = state.beginning.hello.get("do").and_then(Value::as_array);
        let is_listed = listed.is_some_and(|list| list.iter().any(|word| word == name));
        if !is_listed {
            let message = format!("`{name}` does not work in this session");
            return refuse(message, "`do` of `hello` lists what does");
        }
        if command.takes_control() && state.controller != Some(client) {
            let message = format!("`{name}` is for who controls; this client watches");
            return refuse(message, "say `take_control` first");
        }
        match command {
            Command::Scalar(name) => {
                if let Some(name) = name.as_ref().filter(|name| !state.has_scalar(name)) {
                    let message = format!("there is no scalar `{name}`");
                    return refuse(message, "`scalars` of `hello` lists what there is");
                }
                state.scalar = name;
                ok()
            }
            Command::Seek(time_s) => {
                let after = state.line.partition_point(|(at_s, _)| *at_s <= time_s);
                let found = state.line.get(after.saturating_sub(1));
                let Some(bytes) = found.map(|(_, bytes)| bytes.clone()) else {
                    return refuse("there is no picture yet".to_owned(), "wait for `ready`");
                };
                if let Some(own) = state.clients.get_mut(&client) {
                    own.seek = Some(bytes);
                    own.wake.notify_one();
                }
                ok()
            }
            command => {
                drop(state);
                let reply = Reply {
                    shared: self.clone(),
                    client,
                    id,
                    is_given: false,
                };
                // Nobody takes it: the reply says so as it is dropped.
                let _ = self.requests.send(Request { command, reply });
                None
            }
        }
    }

    fn answer(&self, client: u64, text: String) {
        let mut state = self.lock();
        if let Some(client) = state.clients.get_mut(&client) {
            client.answers.push_back(text);
            if client.answers.len() > ANSWERS {
                client.answers.pop_front();
            }
            client.wake.notify_one();
        }
    }

    /// What is sent to a client next, if there is anything.
    pub fn next_for(&self, id: u64) -> Option<Next> {
        let mut state = self.lock();
        let next = state.next_for(id);
        if let Some(Next::Binary(bytes)) = &next
            && bytes.first() == Some(&PICTURE)
        {
            self.sent.fetch_add(1, Ordering::Relaxed);
        }
        next
    }
}

fn refusal(refused: &Refused) -> String {
    let error = json!({"message": refused.message, "help": refused.help});
    json!({"re": refused.id, "error": error}).to_string()
}

/// Sequence of a picture's message.
fn sequence(picture: &[u8]) -> u32 {
    let bytes = picture.get(4..8).and_then(|bytes| bytes.try_into().ok());
    u32::from_le_bytes(bytes.unwrap_or_default())
}

impl State {
    /// Clients but for the program's own.
    fn others(&self) -> usize {
        self.clients
            .values()
            .filter(|client| !client.is_own)
            .count()
    }

    fn wake_all(&self) {
        self.clients
            .values()
            .for_each(|client| client.wake.notify_one());
    }

    fn greet_again(&mut self, id: u64) {
        if let Some(client) = self.clients.get_mut(&id) {
            client.version = None;
            client.wake.notify_one();
        }
    }

    fn wants(&self) -> Wants {
        let rates = self.clients.values().map(|client| client.picture_hz);
        Wants {
            picture_hz: if self.beginning.recorded {
                0.0
            } else {
                rates.fold(0.0, f64::max)
            },
            scalar: self.scalar.clone(),
        }
    }

    fn has_scalar(&self, name: &str) -> bool {
        let list = self
            .beginning
            .hello
            .get("scalars")
            .and_then(Value::as_array);
        list.is_some_and(|list| list.iter().any(|scalar| scalar["name"] == name))
    }

    fn hello(&self, id: u64) -> String {
        let mut hello = self.beginning.hello.clone();
        let role = if self.controller == Some(id) {
            "control"
        } else {
            "watch"
        };
        let own = [
            ("kind", json!("hello")),
            ("format", json!(FORMAT)),
            ("version", json!(env!("CARGO_PKG_VERSION"))),
            ("session", json!(self.session)),
            ("role", json!(role)),
        ];
        hello.extend(own.map(|(key, value)| (key.to_owned(), value)));
        Value::Object(hello).to_string()
    }

    fn next_for(&mut self, id: u64) -> Option<Next> {
        let (version, began) = (self.version, self.session > 0);
        let client = self.clients.get_mut(&id)?;
        if let Some(answer) = client.answers.pop_front() {
            return Some(Next::Text(answer));
        }
        if !began {
            return None;
        }
        if client.version != Some(version) {
            client.version = Some(version);
            if std::mem::replace(&mut client.session, self.session) != self.session {
                client.picture = 0;
                client.underway.clear();
            }
            return Some(Next::Text(self.hello(id)));
        }
        if std::mem::replace(&mut client.geometry, self.session) != self.session
            && let Some(geometry) = &self.beginning.geometry
        {
            return Some(Next::Binary(geometry.as_slice().into()));
        }
        client.text = client.text.max(self.first_text);
        if let Some(text) = self.texts.get((client.text - self.first_text) as usize) {
            client.text += 1;
            return Some(Next::Text(text.clone()));
        }
        if client.underway.len() < UNDERWAY {
            let is_new = client.picture != self.pictures && client.picture_hz > 0.0;
            let newest = self.picture.clone().filter(|_| is_new);
            if newest.is_some() {
                client.picture = self.pictures;
            }
            if let Some(picture) = newest.or_else(|| client.seek.take()) {
                client.underway.push_back(sequence(&picture));
                return Some(Next::Binary(picture));
            }
        }
        let end = self.first_block + self.blocks.len() as u64;
        let is_late = end.saturating_sub(client.block.max(client.came)) > BEHIND;
        if is_late && !self.beginning.recorded {
            (client.block, client.gaps) = (end - 2, [true; 2]);
        }
        if client.block < self.first_block {
            (client.block, client.gaps) = (self.first_block, [true; 2]);
        }
        let block = self
            .blocks
            .get((client.block - self.first_block) as usize)?;
        client.block += 1;
        let kind = usize::from(block.first() == Some(&SOLVES));
        Some(if std::mem::take(&mut client.gaps[kind]) {
            Next::AfterGap(block.clone())
        } else {
            Next::Binary(block.clone())
        })
    }
}
