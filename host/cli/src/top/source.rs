//! Where figures come from and commands go: the server of a page, or this program itself.
//!
//! Entry points: [`Remote::open`], [`Inside`].

use crate::failure::{Cause, Failure};
use serde_json::{Value, json};
use std::io;
use std::net::{TcpStream, ToSocketAddrs as _};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use sutura_view::{Next, Shared};
use tungstenite::client::IntoClientRequest as _;
use tungstenite::http::HeaderValue;
use tungstenite::{Error, HandshakeError, WebSocket};

/// Most time for reading or writing before keys are looked at.
const WAIT: Duration = Duration::from_millis(20);
/// Most time for a server to be reached, to say of which session it is, and to take a command.
const WITHIN: Duration = Duration::from_secs(5);
/// Next step for a session that cannot be reached.
const HELP: &str =
    "is it still running? over SSH, forward its port: `ssh -L 8421:127.0.0.1:8421 HOST`";
/// Messages that are taken at once.
const AT_ONCE: usize = 64;

/// A message.
#[derive(Clone, Debug, PartialEq)]
pub enum Message {
    /// JSON.
    Text(Value),
    /// Of the page's format.
    Binary(Vec<u8>),
}

/// Who says how a session goes, and takes commands.
pub trait Source {
    /// What has come; waits a little for something.
    fn receive(&mut self) -> Vec<Message>;

    /// Says a command, and returns it with its number.
    fn say(&mut self, command: Value) -> Value;

    /// Why nothing comes any more, if so.
    fn ended(&self) -> Option<String>;
}

/// Says that a server did not say in time of which session it is.
fn late() -> String {
    format!(
        "it did not say within {} s of which session it is",
        WITHIN.as_secs()
    )
}

/// Whether only the time for reading or writing was over.
fn would_wait(error: &Error) -> bool {
    use io::ErrorKind::{Interrupted, TimedOut, WouldBlock};
    matches!(error, Error::Io(why) if matches!(why.kind(), WouldBlock | TimedOut | Interrupted))
}

/// A command with a number of its own.
fn numbered(last: &mut u64, mut command: Value) -> Value {
    *last += 1;
    command["id"] = json!(*last);
    command
}

/// No pictures: they are not shown.
fn none() -> Value {
    json!({"do": "picture_hz", "hz": 0})
}

/// The server of a page.
pub struct Remote {
    socket: WebSocket<TcpStream>,
    address: String,
    asked: u64,
    ended: Option<String>,
    /// Messages that came while the session was opened.
    first: Vec<Message>,
}

impl Remote {
    /// Opens the session at an address (name and port). `None`: `stop` was set before it was open.
    ///
    /// # Errors
    /// Nobody answers, or refuses, or says in time of which session it is.
    pub fn open(address: &str, key: &str, stop: &AtomicBool) -> Result<Option<Remote>, Failure> {
        let unreachable = |why: &dyn std::fmt::Display| {
            let message = format!("the session at {address} cannot be reached: {why}");
            Failure::say(Cause::BadInput, message, HELP)
        };
        let mut places = address.to_socket_addrs().map_err(|why| unreachable(&why))?;
        let mut stream = Err(io::Error::from(io::ErrorKind::NotFound));
        while let (Err(_), Some(place)) = (&stream, places.next()) {
            stream = TcpStream::connect_timeout(&place, WITHIN);
        }
        let stream = stream.map_err(|why| unreachable(&why))?;
        let timeouts = || {
            stream.set_nodelay(true)?;
            stream.set_write_timeout(Some(WAIT))?;
            stream.set_read_timeout(Some(WAIT))
        };
        timeouts().map_err(|why| unreachable(&why))?;
        let until = Instant::now() + WITHIN;
        let stopped = || stop.load(Ordering::Relaxed);
        let mut request = format!("ws://{address}/ws")
            .into_client_request()
            .map_err(|why| unreachable(&why))?;
        let given = HeaderValue::from_str(&format!("Bearer {key}"));
        let given = given.map_err(|why| unreachable(&why))?;
        request.headers_mut().insert("authorization", given);
        let cloned = stream.try_clone().map_err(|why| unreachable(&why))?;
        let mut opened = tungstenite::client(request, cloned);
        while let Err(HandshakeError::Interrupted(half)) = opened {
            if stopped() {
                return Ok(None);
            }
            if Instant::now() > until {
                return Err(unreachable(&late()));
            }
            opened = half.handshake();
        }
        let (socket, _) = opened.map_err(|error| match error {
            HandshakeError::Failure(Error::Http(answer)) if answer.status() == 403 => {
                let message = format!("the session at {address} has another key");
                let help = "open the address that it has printed; every start has a new key";
                Failure::say(Cause::BadInput, message, help)
            }
            other => unreachable(&other),
        })?;
        let mut new = Remote {
            socket,
            address: address.to_owned(),
            asked: 0,
            ended: None,
            first: Vec::new(),
        };
        new.send(&json!({"key": key, "control": true, "format": 1}));
        let asked = new.say(none());
        // Only a session's server says this, the answer alone while the session is made; others may be silent, or say
        // anything for ever.
        let is_known = |message: &Message| match message {
            Message::Text(text) => text["kind"] == "hello" || text["re"] == asked["id"],
            Message::Binary(_) => false,
        };
        loop {
            let mut came = new.receive();
            if let Some(place) = came.iter().position(is_known) {
                new.first = came.split_off(place);
                return Ok(Some(new));
            }
            match &new.ended {
                Some(why) => return Err(Failure::say(Cause::BadInput, why, HELP)),
                None if stopped() => return Ok(None),
                None if Instant::now() > until => return Err(unreachable(&late())),
                None => {}
            }
        }
    }

    fn send(&mut self, value: &Value) {
        let until = Instant::now() + WITHIN;
        let mut sent = self
            .socket
            .send(tungstenite::Message::text(value.to_string()));
        while sent.as_ref().is_err_and(would_wait) && Instant::now() < until {
            sent = self.socket.flush();
        }
        if let Err(error) = sent {
            self.end(&error);
        }
    }

    fn end(&mut self, why: &Error) {
        let words = match why {
            Error::ConnectionClosed | Error::AlreadyClosed => "it has ended".to_owned(),
            // A program that ends says no farewell.
            Error::Protocol(_) | Error::Io(_) => {
                "it has ended, or cannot be reached any more".to_owned()
            }
            other => other.to_string(),
        };
        let words = format!("the session at {}: {words}", self.address);
        self.ended.get_or_insert(words);
    }
}

impl Source for Remote {
    fn receive(&mut self) -> Vec<Message> {
        let mut all = std::mem::take(&mut self.first);
        let until = Instant::now() + WAIT;
        for _ in 0..AT_ONCE {
            // A server that takes nothing holds up each reading that has to answer a ping.
            if self.ended.is_some() || Instant::now() > until {
                break;
            }
            match self.socket.read() {
                Ok(tungstenite::Message::Text(text)) => {
                    all.extend(serde_json::from_str(&text).ok().map(Message::Text));
                }
                Ok(tungstenite::Message::Binary(bytes)) => {
                    all.push(Message::Binary(bytes.to_vec()));
                }
                Ok(tungstenite::Message::Close(why)) => {
                    let reason = why.filter(|why| !why.reason.is_empty());
                    let words =
                        reason.map_or("it has ended".to_owned(), |why| why.reason.to_string());
                    self.ended = Some(format!("the session at {}: {words}", self.address));
                }
                Ok(_) => {}
                Err(error) if would_wait(&error) => break,
                Err(error) => self.end(&error),
            }
        }
        all
    }

    fn say(&mut self, command: Value) -> Value {
        let command = numbered(&mut self.asked, command);
        self.send(&command);
        command
    }

    fn ended(&self) -> Option<String> {
        self.ended.clone()
    }
}

/// A session of this program.
pub struct Inside {
    shared: Arc<Shared>,
    own: u64,
    asked: u64,
}

impl Inside {
    /// Is shown what this session shows.
    pub fn new(shared: Arc<Shared>) -> Self {
        Self {
            own: shared.join_own(true),
            shared,
            asked: 0,
        }
    }
}

impl Drop for Inside {
    fn drop(&mut self) {
        self.shared.leave(self.own);
    }
}

impl Source for Inside {
    fn receive(&mut self) -> Vec<Message> {
        let next = || self.shared.next_for(self.own);
        let message = |next| match next {
            Next::Text(text) => serde_json::from_str(&text).ok().map(Message::Text),
            Next::Binary(bytes) | Next::AfterGap(bytes) => Some(Message::Binary(bytes.to_vec())),
        };
        let all: Vec<Message> = std::iter::from_fn(next)
            .take(AT_ONCE)
            .filter_map(message)
            .collect();
        if all.is_empty() {
            std::thread::sleep(WAIT);
        }
        all
    }

    fn say(&mut self, command: Value) -> Value {
        let command = numbered(&mut self.asked, command);
        self.shared.hear(self.own, &command.to_string());
        command
    }

    fn ended(&self) -> Option<String> {
        None
    }
}
