//! Connections without the key: they shut nobody out, and none of them stays.

use crate::support::{SOON, begin, page, run, server};
use std::io::{ErrorKind, Read as _, Write as _};
use std::net::{SocketAddr, TcpStream};
use sutura_view::{FILES, MOST_WAITING};

/// A connection with the begin of a request that never ends.
fn half(address: SocketAddr) -> TcpStream {
    let mut stream = TcpStream::connect(address).expect("a connection");
    stream
        .write_all(b"GET / HTTP/1.1\r\nhost: half")
        .expect("sent");
    stream.set_nonblocking(true).expect("a socket");
    stream
}

/// Whether the other end has closed it.
fn is_closed(stream: &mut TcpStream) -> bool {
    let outcome = stream.read(&mut [0; 512]);
    !matches!(outcome, Err(error) if error.kind() == ErrorKind::WouldBlock)
}

/// More half requests than there are places: the oldest go, a page is served among them, and no more than the places stay open.
#[test]
fn half_requests_shut_nobody_out() {
    let (server, _asked) = server();
    begin(&server, &["pause"]);
    let mut early: Vec<_> = (0..3 * MOST_WAITING)
        .map(|_| half(server.address()))
        .collect();
    run(async {
        // Its socket, its first words and its answer.
        let mut client = page(&server).await;
        assert_eq!(client.greet(&server, true).await["role"], "control");
        let more: Vec<_> = (0..MOST_WAITING).map(|_| half(server.address())).collect();
        // A connection with the key is none of them.
        let answer = client
            .ask(serde_json::json!({"id": 1, "do": "picture_hz", "hz": 5}))
            .await;
        assert_eq!(answer["ok"], true);
        drop(more);
    });
    // All but the newest have been closed, in the order in which they came.
    let deadline = std::time::Instant::now() + SOON;
    let (gone, _) = early.split_at_mut(2 * MOST_WAITING);
    while !gone.iter_mut().all(is_closed) {
        assert!(
            std::time::Instant::now() < deadline,
            "old half requests stay"
        );
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
}

/// Waits for the end of a silent connection.
fn ended(mut stream: TcpStream) -> Vec<u8> {
    stream.set_nonblocking(false).expect("a socket");
    stream.set_read_timeout(Some(6 * SOON)).expect("a socket");
    let mut bytes = Vec::new();
    match stream.read_to_end(&mut bytes) {
        Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
            panic!("it stays open")
        }
        _ => bytes,
    }
}

/// Half a head, no byte at all, an answer after which nothing more is asked, and a socket whose client says nothing: each ends by
/// itself, without anybody who waits for its place.
#[test]
fn no_connection_stays_for_nothing() {
    let (server, _asked) = server();
    let address = server.address();
    std::thread::scope(|scope| {
        scope.spawn(move || ended(half(address)));
        scope.spawn(move || ended(TcpStream::connect(address).expect("a connection")));
        scope.spawn(move || {
            let mut stream = TcpStream::connect(address).expect("a connection");
            let path = FILES[0].path;
            let request = format!("GET {path} HTTP/1.1\r\nhost: {address}\r\n\r\n");
            stream.write_all(request.as_bytes()).expect("sent");
            let answer = ended(stream);
            assert!(answer.starts_with(b"HTTP/1.1 200"), "it was answered");
        });
        scope.spawn(move || {
            let answer = ended(socket(address));
            assert!(answer.starts_with(b"HTTP/1.1 101"), "it was opened");
        });
    });
}

/// An open socket, without anything said.
fn socket(address: SocketAddr) -> TcpStream {
    let mut stream = TcpStream::connect(address).expect("a connection");
    let request = format!(
        "GET /ws HTTP/1.1\r\nhost: {address}\r\norigin: http://{address}\r\nupgrade: websocket\r\nconnection: upgrade\r\n\
         sec-websocket-version: 13\r\nsec-websocket-key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
    );
    stream.write_all(request.as_bytes()).expect("sent");
    stream
}

/// A text of a client, masked with zeros.
fn text(bytes: &[u8]) -> Vec<u8> {
    let length = u8::try_from(bytes.len())
        .ok()
        .filter(|length| *length < 126);
    let head = [0x81, 0x80 | length.expect("a short text"), 0, 0, 0, 0];
    [&head[..], bytes].concat()
}

/// The code with which the host closes.
fn code(bytes: &[u8]) -> Option<u16> {
    let is_close = |four: &[u8]| four[0] == 0x88 && four[1] > 2 && four[1] < 126;
    let four = bytes.windows(4).rfind(|four| is_close(four))?;
    Some(u16::from_be_bytes([four[2], four[3]]))
}

/// Each fault is told by the code that RFC 6455 has for it, before the key and after it.
#[test]
fn bad_frames_are_told_by_their_codes() {
    let (server, _asked) = server();
    begin(&server, &["pause"]);
    let first = format!(
        "{{\"key\":\"{}\",\"control\":false,\"format\":1}}",
        server.key()
    );
    let announced = |bytes: u64| [&[0x81, 0xff][..], &bytes.to_be_bytes(), &[0; 4]].concat();
    let whole = |bytes: usize| [announced(bytes as u64), vec![b' '; bytes]].concat();
    let table = [
        // Not masked; reserved bits; an opcode that does not exist; a ping that is too long.
        (vec![0x81, 1, b'x'], 1002),
        (vec![0xf1, 0x80, 0, 0, 0, 0], 1002),
        (vec![0x83, 0x80, 0, 0, 0, 0], 1002),
        ([&[0x89, 0xfe, 1, 0][..], &[0; 260]].concat(), 1002),
        (text(&[0xff, 0xfe]), 1007),
        (announced(10_000_000), 1009),
        (whole(65_537), 1009),
        (whole(1_000_000), 1009),
    ];
    std::thread::scope(|scope| {
        for (bytes, expected) in &table {
            for first in [None, Some(&first)] {
                let address = server.address();
                scope.spawn(move || {
                    let mut stream = socket(address);
                    if let Some(first) = first {
                        stream.write_all(&text(first.as_bytes())).expect("sent");
                    }
                    stream.write_all(bytes).expect("sent");
                    let said = ended(stream);
                    let was_greeted = first.is_some();
                    assert_eq!(
                        code(&said),
                        Some(*expected),
                        "{bytes:?}, greeted {was_greeted}"
                    );
                });
            }
        }
    });
}
