//! A client of a page, as a browser is one, that reads as it is told. Entry points: [`Client::open`], [`Client::read`], [`follow`].

use anyhow::{Context, Result, bail};
use serde_json::{Value, json};
use std::io::ErrorKind;
use std::net::TcpStream;
use std::time::{Duration, Instant};
use tungstenite::client::IntoClientRequest as _;
use tungstenite::{Message, WebSocket};

/// Long enough for anything that a session does.
const LONG: Duration = Duration::from_secs(60);
/// The console renders.
pub const ARMED: u8 = 2;

/// Something that the host said.
#[derive(Debug)]
pub enum Said {
    /// A picture's session time \[s\]; it has been acknowledged.
    Picture(f64),
    /// Mode of the newest tick, and whether ticks before it are missing.
    Ticks {
        mode: Option<u8>,
        gap: bool,
    },
    Text(Value),
    Other,
}

pub struct Client {
    socket: WebSocket<TcpStream>,
    id: u64,
}

impl Client {
    /// Joins the page at `url`, as who controls it if nobody does.
    pub fn open(url: &str) -> Result<Self> {
        let parts = url
            .strip_prefix("http://")
            .unwrap_or(url)
            .split_once("/#key=");
        let (address, key) = parts.with_context(|| format!("no page's address: {url}"))?;
        let stream = TcpStream::connect(address)?;
        stream.set_read_timeout(Some(LONG))?;
        stream.set_nodelay(true)?;
        let mut request = format!("ws://{address}/ws").into_client_request()?;
        let origin = format!("http://{address}").parse()?;
        request.headers_mut().insert("origin", origin);
        let (socket, _) = tungstenite::client(request, stream).context("the page refuses")?;
        let mut client = Self { socket, id: 0 };
        client.say(&json!({"key": key, "control": true, "format": 1}))?;
        Ok(client)
    }

    pub fn say(&mut self, value: &Value) -> Result<()> {
        Ok(self.socket.send(Message::text(value.to_string()))?)
    }

    /// The next message.
    pub fn read(&mut self) -> Result<Said> {
        let message = loop {
            match self.socket.read() {
                // Stopped and going on.
                Err(tungstenite::Error::Io(error)) if error.kind() == ErrorKind::Interrupted => {}
                message => break message?,
            }
        };
        match message {
            Message::Text(text) => Ok(Said::Text(serde_json::from_str(&text)?)),
            Message::Binary(bytes) => match bytes.first() {
                Some(2) => {
                    let number = u32::from_le_bytes(array(&bytes, 4)?);
                    self.say(&json!({"do": "ack", "sequence": number}))?;
                    Ok(Said::Picture(f64::from_le_bytes(array(&bytes, 8)?)))
                }
                Some(3) => Ok(Said::Ticks {
                    mode: section(&bytes, 8).and_then(|modes| modes.last().copied()),
                    gap: bytes[2] & 1 != 0,
                }),
                _ => Ok(Said::Other),
            },
            Message::Close(frame) => bail!("the page has closed: {frame:?}"),
            _ => Ok(Said::Other),
        }
    }

    /// Reads until `wanted` makes something of what comes.
    pub fn until<T>(&mut self, mut wanted: impl FnMut(&Said) -> Option<T>) -> Result<T> {
        let began = Instant::now();
        while began.elapsed() < LONG {
            if let Some(found) = wanted(&self.read()?) {
                return Ok(found);
            }
        }
        bail!("what was waited for did not come");
    }

    /// Sends a command; its number.
    pub fn send(&mut self, mut command: Value) -> Result<u64> {
        self.id += 1;
        command["id"] = json!(self.id);
        self.say(&command)?;
        Ok(self.id)
    }

    /// The answer to the command of this number.
    pub fn answer(&mut self, id: u64) -> Result<()> {
        let answer = self.until(|said| match said {
            Said::Text(value) if value["re"] == id => Some(value.clone()),
            _ => None,
        })?;
        match &answer["error"] {
            Value::Null => Ok(()),
            error => bail!("refused: {error}"),
        }
    }

    pub fn ask(&mut self, command: Value) -> Result<()> {
        let id = self.send(command)?;
        self.answer(id)
    }

    /// Waits for the console to be in this mode.
    pub fn mode(&mut self, wanted: u8) -> Result<()> {
        self.until(|said| match said {
            Said::Ticks { mode, .. } if *mode == Some(wanted) => Some(()),
            _ => None,
        })
    }

    /// The connection itself, to be read as somebody else likes.
    pub fn into_stream(self) -> TcpStream {
        self.socket.into_inner()
    }
}

fn array<const N: usize>(bytes: &[u8], at: usize) -> Result<[u8; N]> {
    let part = bytes.get(at..at + N).and_then(|part| part.try_into().ok());
    part.context("a message that is too short")
}

/// Bytes of a block's section with this tag.
fn section(bytes: &[u8], wanted: u16) -> Option<&[u8]> {
    let mut at = 24;
    while let Some(head) = bytes.get(at..at + 8) {
        let tag = u16::from_le_bytes([head[0], head[1]]);
        let length = u32::from_le_bytes([head[4], head[5], head[6], head[7]]) as usize;
        if tag == wanted {
            return bytes.get(at + 8..at + 8 + length);
        }
        at = (at + 8 + length).next_multiple_of(8);
    }
    None
}

/// Prints the session time of every picture that comes, until nothing comes: what is stopped from outside.
///
/// # Errors
/// The page closes.
pub fn follow(url: &str) -> Result<()> {
    let mut client = Client::open(url)?;
    client.ask(json!({"do": "picture_hz", "hz": 60}))?;
    loop {
        if let Said::Picture(time_s) = client.read()? {
            println!("{time_s}");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The golden bytes that host and page agree on.
    #[test]
    fn the_mode_of_the_newest_tick_is_found() {
        let file = crate::run::root().join("tests/golden/view/ticks.bin");
        let bytes = std::fs::read(file).expect("golden bytes");
        let rows = u32::from_le_bytes(array(&bytes, 8).expect("a header")) as usize;
        assert_eq!(section(&bytes, 8).expect("modes").len(), rows);
        assert_eq!(section(&bytes, 1).expect("times").len(), 8 * rows);
        assert!(section(&bytes, 99).is_none());
    }
}
