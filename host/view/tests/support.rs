//! A server, and clients of it.

use futures_util::{SinkExt as _, StreamExt as _};
use serde_json::{Value, json};
use std::net::{SocketAddr, TcpStream};
use std::sync::mpsc::Receiver;
use std::time::Duration;
use sutura_view::{Beginning, Options, Request, Server};
use tokio::time::timeout;
use tokio_tungstenite::tungstenite::client::IntoClientRequest as _;
use tokio_tungstenite::tungstenite::{Error, Message, protocol::CloseFrame};
use tokio_tungstenite::{WebSocketStream, client_async};

/// Long enough for anything that happens at once, on a busy machine.
pub const SOON: Duration = Duration::from_secs(20);

pub fn server() -> (Server, Receiver<Request>) {
    let options = Options {
        port: 0,
        ..Options::default()
    };
    Server::start(&options).expect("a server")
}

/// A session with these commands and a small geometry.
pub fn begin(server: &Server, commands: &[&str]) {
    let mut hello = serde_json::Map::new();
    hello.insert("do".to_owned(), json!(commands));
    hello.insert("scalars".to_owned(), json!([{"name": "displacement"}]));
    server.shared().begin(Beginning {
        hello,
        geometry: Some(vec![1; 32]),
        recorded: false,
    });
}

/// A picture's message of this sequence, of so many bytes.
pub fn picture(sequence: u32, bytes: usize) -> Vec<u8> {
    let mut picture = vec![0; bytes.max(56)];
    (picture[0], picture[1]) = (2, 1);
    picture[4..8].copy_from_slice(&sequence.to_le_bytes());
    picture
}

pub fn run(test: impl Future<Output = ()>) {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build();
    runtime.expect("a runtime").block_on(test);
}

pub struct Client {
    pub socket: WebSocketStream<tokio::net::TcpStream>,
}

/// Opens the socket with these headers besides; the status of the answer if it is refused.
pub async fn open(address: SocketAddr, headers: &[(&'static str, String)]) -> Result<Client, u16> {
    let stream = TcpStream::connect(address).expect("a connection");
    stream.set_nonblocking(true).expect("a socket");
    let stream = tokio::net::TcpStream::from_std(stream).expect("a socket");
    let mut request = format!("ws://{address}/ws")
        .into_client_request()
        .expect("a request");
    for (name, value) in headers {
        let value = value.parse().expect("a header");
        request.headers_mut().insert(*name, value);
    }
    match client_async(request, stream).await {
        Ok((socket, _)) => Ok(Client { socket }),
        Err(Error::Http(response)) => Err(response.status().as_u16()),
        Err(other) => panic!("{other}"),
    }
}

/// The page of this server.
pub async fn page(server: &Server) -> Client {
    let origin = format!("http://{}", server.address());
    let opened = open(server.address(), &[("origin", origin)]).await;
    opened.unwrap_or_else(|status| panic!("refused with {status}"))
}

impl Client {
    pub async fn say(&mut self, text: impl Into<String>) {
        let text: String = text.into();
        self.socket.send(Message::text(text)).await.expect("sent");
    }

    /// Says the first words, and returns `hello`.
    pub async fn greet(&mut self, server: &Server, control: bool) -> Value {
        let first = json!({"key": server.key(), "control": control, "format": 1});
        self.say(first.to_string()).await;
        self.text("hello").await
    }

    pub async fn message(&mut self) -> Option<Message> {
        let next = timeout(SOON, self.socket.next()).await;
        next.expect("something in time").and_then(Result::ok)
    }

    /// The next text of this kind, whatever comes before.
    pub async fn text(&mut self, kind: &str) -> Value {
        loop {
            let message = self.message().await.expect("still open");
            let Message::Text(text) = message else {
                continue;
            };
            let value: Value = serde_json::from_str(&text).expect("JSON");
            if value["kind"] == kind {
                return value;
            }
        }
    }

    /// The answer to a command.
    pub async fn ask(&mut self, command: Value) -> Value {
        let id = command["id"].clone();
        self.say(command.to_string()).await;
        loop {
            let message = self.message().await.expect("still open");
            let Message::Text(text) = message else {
                continue;
            };
            let value: Value = serde_json::from_str(&text).expect("JSON");
            if value["re"] == id {
                return value;
            }
        }
    }

    /// The next binary message of this kind.
    pub async fn binary(&mut self, kind: u8) -> Vec<u8> {
        loop {
            let message = self.message().await.expect("still open");
            if let Message::Binary(bytes) = message
                && bytes.first() == Some(&kind)
            {
                return bytes.to_vec();
            }
        }
    }

    /// How the connection ends.
    pub async fn end(&mut self) -> Option<(u16, String)> {
        while let Some(message) = self.message().await {
            if let Message::Close(frame) = message {
                let words = |CloseFrame { code, reason }| (u16::from(code), reason.to_string());
                return frame.map(words);
            }
        }
        None
    }
}
