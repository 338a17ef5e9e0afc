//! A client's connection: the first message, then what it says one way and what it is shown the other.
//!
//! Entry point: [`serve`]. What it says is heard also while nothing can be sent to it.

use super::command::{FORMAT, First};
use super::guard::Guard;
use super::shared::{Next, Shared};
use super::waiting::Guest;
use axum::body::Bytes;
use axum::extract::ws::{CloseFrame, Message, WebSocket};
use futures_util::stream::{SplitSink, SplitStream};
use futures_util::{SinkExt as _, StreamExt as _};
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::Notify;
use tokio::time::{Instant, timeout};

/// Largest message of a client \[bytes\].
pub const MOST_BYTES: usize = 64 * 1024;
/// Largest frame that is read to its end, to be answered if it is too large for a message.
pub const MOST_BYTES_OF_A_FRAME: usize = 16 * MOST_BYTES;
/// Messages of a client in a second.
pub const MOST_A_SECOND: u32 = 200;
/// How long the first message may take.
const FIRST_WITHIN: Duration = Duration::from_secs(2);
/// How long one message may take to a client that reads slowly, or that stands still.
const SENT_WITHIN: Duration = Duration::from_secs(120);
/// How long a farewell may take.
const CLOSED_WITHIN: Duration = Duration::from_secs(1);

/// Why a connection ends: code and words.
type End = (u16, &'static str);

const NO_FIRST: End = (4408, "no first message within 2 s");
const BAD_FIRST: End = (
    4400,
    "the first message is not {\"key\":..,\"control\":..,\"format\":1}",
);
const BAD_KEY: End = (
    4401,
    "this is not the key: open the address that the host has printed",
);
const BAD_FORMAT: End = (4406, "this host speaks format 1 of its page: reload it");
const FULL: End = (4429, "there are 8 clients already");
const FLOOD: End = (4429, "more than 200 messages in a second");
const TOO_LARGE: End = (1009, "a message of more than 64 kB");
const NO_FRAME: End = (1002, "what came is no WebSocket frame of a client");
const NO_TEXT: End = (1007, "a text that is not UTF-8");
const TOO_SLOW: End = (1013, "nothing could be sent for 2 min");
const BINARY: End = (1003, "clients speak JSON");

/// Serves a client until either side ends it.
pub async fn serve(
    socket: WebSocket,
    peer: SocketAddr,
    guest: Arc<Guest>,
    shared: Arc<Shared>,
    guard: Arc<Guard>,
) {
    let (mut to, mut from) = socket.split();
    let begun = tokio::select! {
        begun = begin(&mut from, peer, &shared, &guard) => begun,
        () = guest.dismissed() => return,
    };
    let end = match begun {
        Err(end) => end,
        Ok((id, wake)) => {
            guest.has_key();
            let end = tokio::select! {
                end = hear(&mut from, id, &shared) => end,
                end = show(&mut to, id, &wake, &shared) => end,
            };
            shared.leave(id);
            end
        }
    };
    if let Some((code, reason)) = end {
        let frame = CloseFrame {
            code,
            reason: reason.into(),
        };
        // Who does not take it is gone all the same.
        let _ = timeout(CLOSED_WITHIN, to.send(Message::Close(Some(frame)))).await;
    }
}

async fn begin(
    from: &mut SplitStream<WebSocket>,
    peer: SocketAddr,
    shared: &Arc<Shared>,
    guard: &Guard,
) -> Result<(u64, Arc<Notify>), Option<End>> {
    let Ok(message) = timeout(FIRST_WITHIN, from.next()).await else {
        return Err(Some(NO_FIRST));
    };
    let text = match message {
        Some(Ok(Message::Text(text))) => text,
        Some(Err(error)) => return Err(bad_frame(error)),
        Some(Ok(Message::Close(_))) | None => return Err(None),
        Some(Ok(_)) => return Err(Some(BAD_FIRST)),
    };
    let first = First::read(&text).ok_or(Some(BAD_FIRST))?;
    if !guard.is_key(&first.key) {
        return Err(Some(BAD_KEY));
    }
    if first.format != FORMAT {
        return Err(Some(BAD_FORMAT));
    }
    let joined = shared.join(first.control, guard.may_control(peer));
    joined.ok_or(Some(FULL))
}

/// The end of a client whose bytes are no message; none if the connection broke.
fn bad_frame(error: axum::Error) -> Option<End> {
    use tungstenite::Error;
    let error = error.into_inner();
    match error.downcast_ref::<Error>() {
        Some(Error::Capacity(_)) => Some(TOO_LARGE),
        Some(Error::Utf8(_)) => Some(NO_TEXT),
        Some(Error::Protocol(_)) => Some(NO_FRAME),
        _ => None,
    }
}

/// What a client says.
async fn hear(from: &mut SplitStream<WebSocket>, id: u64, shared: &Arc<Shared>) -> Option<End> {
    let (mut second, mut count) = (Instant::now(), 0);
    while let Some(message) = from.next().await {
        if second.elapsed() >= Duration::from_secs(1) {
            (second, count) = (Instant::now(), 0);
        }
        count += 1;
        if count > MOST_A_SECOND {
            return Some(FLOOD);
        }
        match message {
            Ok(Message::Text(text)) => shared.hear(id, &text),
            Ok(Message::Ping(_) | Message::Pong(_)) => {}
            Ok(Message::Binary(_)) => return Some(BINARY),
            Ok(Message::Close(_)) => return None,
            Err(error) => return bad_frame(error),
        }
    }
    None
}

/// What a client is shown.
async fn show(
    to: &mut SplitSink<WebSocket, Message>,
    id: u64,
    wake: &Notify,
    shared: &Arc<Shared>,
) -> Option<End> {
    loop {
        let message = match shared.next_for(id) {
            Some(Next::Text(text)) => Message::Text(text.into()),
            Some(Next::Binary(bytes)) => Message::Binary(Bytes::from_owner(bytes)),
            Some(Next::AfterGap(bytes)) => {
                let mut bytes = bytes.to_vec();
                // The first bit of the flags.
                if let Some(flags) = bytes.get_mut(2) {
                    *flags |= 1;
                }
                Message::Binary(bytes.into())
            }
            None => {
                wake.notified().await;
                continue;
            }
        };
        match timeout(SENT_WITHIN, to.send(message)).await {
            Ok(Ok(())) => {}
            Ok(Err(_)) => return None,
            Err(_) => return Some(TOO_SLOW),
        }
    }
}
