//! Who may ask for what: a table of requests with the answer that each gets.

use crate::support::{begin, open, page, run, server};
use serde_json::json;
use std::io::{Read as _, Write as _};
use std::net::{SocketAddr, TcpStream};
use sutura_view::{FILES, MOST_BYTES, Options, Server};
use tokio_tungstenite::tungstenite::Message;

/// Status, headers in small letters, and body of the answer to a request.
fn answer(address: SocketAddr, request: &str) -> (u16, String, Vec<u8>) {
    let mut stream = TcpStream::connect(address).expect("a connection");
    stream.write_all(request.as_bytes()).expect("sent");
    let mut bytes = Vec::new();
    stream.read_to_end(&mut bytes).expect("an answer");
    let split = bytes.windows(4).position(|four| four == b"\r\n\r\n");
    let split = split.unwrap_or(bytes.len());
    let head = String::from_utf8_lossy(&bytes[..split]).to_lowercase();
    let status = head.split(' ').nth(1).and_then(|word| word.parse().ok());
    let body = bytes.get(split + 4..).unwrap_or_default().to_vec();
    (
        status.unwrap_or_else(|| panic!("no answer: {head}")),
        head,
        body,
    )
}

fn get(address: SocketAddr, path: &str, headers: &str) -> (u16, String, Vec<u8>) {
    let request = format!("GET {path} HTTP/1.1\r\n{headers}connection: close\r\n\r\n");
    answer(address, &request)
}

#[test]
fn every_file_is_served_from_the_binary_with_all_headers() {
    let (server, _asked) = server();
    let address = server.address();
    let host = format!("host: {address}\r\n");
    assert!(
        FILES
            .iter()
            .any(|file| file.path.starts_with("/vendor/three/"))
    );
    for file in FILES {
        let (status, head, body) = get(address, file.path, &host);
        assert_eq!(status, 200, "{}", file.path);
        assert!(body == file.bytes, "{}", file.path);
        for line in [
            "content-security-policy: default-src 'none'; script-src 'self'",
            "frame-ancestors 'none'",
            "x-content-type-options: nosniff",
            "referrer-policy: no-referrer",
            "cross-origin-opener-policy: same-origin",
            "cross-origin-resource-policy: same-origin",
            "cache-control: no-store",
        ] {
            assert!(head.contains(line), "{}: no `{line}` in {head}", file.path);
        }
        // Files hold no secrets.
        let key = server.key().as_bytes();
        assert!(
            !body.windows(key.len()).any(|part| part == key),
            "{}",
            file.path
        );
    }
}

#[test]
fn requests_get_the_answers_of_the_table() {
    let (server, _asked) = server();
    let address = server.address();
    let port = address.port();
    let own = format!("127.0.0.1:{port}");
    let path = FILES[0].path;
    let by_host = [
        (own.clone(), 200),
        (format!("localhost:{port}"), 200),
        (format!("LOCALHOST:{port}"), 200),
        (format!("[::1]:{port}"), 200),
        ("127.0.0.1".to_owned(), 421),
        (format!("127.0.0.1.evil:{port}"), 421),
        (format!("127.0.0.1:{port}.evil"), 421),
        (format!("127.0.0.2:{port}"), 421),
        (format!("evil.example:{port}"), 421),
        (String::new(), 421),
    ];
    for (host, expected) in by_host {
        let (status, head, _) = get(address, path, &format!("host: {host}\r\n"));
        assert_eq!(status, expected, "host {host}");
        assert!(head.contains("nosniff"), "host {host}: {head}");
    }
    let twice = format!("host: {own}\r\nhost: evil.example\r\n");
    let (status, _, _) = get(address, path, &twice);
    assert!(status == 421 || status == 400, "two hosts: {status}");

    let host = format!("host: {own}\r\n");
    for other in [
        "/favicon.ico",
        "/page/",
        "/page/../Cargo.toml",
        "/page/%2e%2e/Cargo.toml",
        "/page/..%2fCargo.toml",
        "//etc/passwd",
        "/vendor/three/../../src/lib.rs",
        "/vendor/vendor.toml",
        "/session.json",
    ] {
        assert_eq!(get(address, other, &host).0, 404, "{other}");
    }
    for method in ["POST", "PUT", "DELETE", "OPTIONS"] {
        let request = format!("{method} {path} HTTP/1.1\r\n{host}connection: close\r\n\r\n");
        assert_eq!(answer(address, &request).0, 405, "{method}");
    }
    // A socket's request that asks for none.
    let origin = format!("{host}origin: http://{own}\r\n");
    let status = get(address, "/ws", &origin).0;
    assert!((400..500).contains(&status), "{status}");
}

#[test]
fn sockets_are_for_the_page_and_for_programs_with_the_key() {
    let (server, _asked) = server();
    let address = server.address();
    let port = address.port();
    /// Headers of a request.
    type Headers = Vec<(&'static str, String)>;
    let table: Vec<(Headers, Option<u16>)> = vec![
        (vec![("origin", format!("http://127.0.0.1:{port}"))], None),
        (vec![("origin", format!("http://localhost:{port}"))], None),
        // A page of another server, of a name that a name server has moved here, and what looks like ours.
        (
            vec![("origin", "http://evil.example".to_owned())],
            Some(403),
        ),
        (
            vec![("origin", format!("http://127.0.0.1.evil:{port}"))],
            Some(403),
        ),
        (
            vec![("origin", format!("https://127.0.0.1:{port}"))],
            Some(403),
        ),
        (vec![("origin", "http://127.0.0.1".to_owned())], Some(403)),
        (vec![("origin", "null".to_owned())], Some(403)),
        (
            vec![
                ("host", format!("evil.example:{port}")),
                ("origin", format!("http://evil.example:{port}")),
            ],
            Some(421),
        ),
        // Programs.
        (vec![], Some(403)),
        (
            vec![("authorization", "Bearer wrong".to_owned())],
            Some(403),
        ),
        (
            vec![("authorization", format!("Basic {}", server.key()))],
            Some(403),
        ),
        (
            vec![("authorization", format!("Bearer {}", server.key()))],
            None,
        ),
        // The key does not make up for another page's origin.
        (
            vec![
                ("origin", "http://evil.example".to_owned()),
                ("authorization", format!("Bearer {}", server.key())),
            ],
            Some(403),
        ),
    ];
    run(async {
        for (headers, expected) in table {
            let opened = open(address, &headers).await;
            assert_eq!(opened.err(), expected, "{headers:?}");
        }
    });
}

#[test]
fn nothing_is_shown_without_the_key() {
    let (server, _asked) = server();
    begin(&server, &["pause"]);
    let good = server.key().to_owned();
    let mut nearly = good.clone();
    nearly.pop();
    nearly.push(if good.ends_with('0') { '1' } else { '0' });
    let first =
        |key: &str, format: u64| json!({"key": key, "control": true, "format": format}).to_string();
    let table = [
        (first(&nearly, 1), 4401),
        (first("", 1), 4401),
        (
            first(&good.to_uppercase(), 1),
            if good.to_uppercase() == good { 0 } else { 4401 },
        ),
        (first(&good, 2), 4406),
        (json!({"key": good, "control": true}).to_string(), 4400),
        (
            json!({"key": good, "control": true, "format": 1, "more": 1}).to_string(),
            4400,
        ),
        (json!({"id": 1, "do": "safe_stop"}).to_string(), 4400),
        ("x".to_owned(), 4400),
        ("x".repeat(MOST_BYTES + 1), 1009),
    ];
    run(async {
        for (text, code) in table.into_iter().filter(|(_, code)| *code != 0) {
            let mut client = page(&server).await;
            client.say(text.clone()).await;
            let (ended, reason) = client.end().await.unwrap_or_default();
            assert_eq!(ended, code, "{reason} for {}", &text[..text.len().min(80)]);
            assert!(!reason.is_empty());
        }
        // Who says nothing is not waited for.
        let mut silent = page(&server).await;
        assert_eq!(silent.end().await.unwrap_or_default().0, 4408);
        assert_eq!(server.shared().figures().joined, 0);
    });
}

#[test]
fn a_flood_and_too_large_a_message_end_the_connection() {
    let (server, _asked) = server();
    begin(&server, &["pause"]);
    run(async {
        let mut client = page(&server).await;
        client.greet(&server, true).await;
        client.say("x".repeat(MOST_BYTES + 1)).await;
        assert_eq!(client.end().await.unwrap_or_default().0, 1009);

        let mut client = page(&server).await;
        client.greet(&server, true).await;
        for _ in 0..400 {
            // It may be closed before all of them are said.
            let text = Message::text("{\"do\":\"ack\",\"sequence\":1}");
            if futures_util::SinkExt::send(&mut client.socket, text)
                .await
                .is_err()
            {
                break;
            }
        }
        assert_eq!(client.end().await.unwrap_or_default().0, 4429);

        let mut clients = Vec::new();
        for _ in 0..8 {
            let mut client = page(&server).await;
            client.greet(&server, false).await;
            clients.push(client);
        }
        let mut ninth = page(&server).await;
        ninth
            .say(json!({"key": server.key(), "control": false, "format": 1}).to_string())
            .await;
        assert_eq!(ninth.end().await.unwrap_or_default().0, 4429);
    });
}

#[test]
fn it_listens_beyond_this_machine_only_under_a_name() {
    let anywhere = Options {
        port: 0,
        bind: std::net::Ipv4Addr::UNSPECIFIED.into(),
        ..Options::default()
    };
    let refused = Server::start(&anywhere).map(|_| ()).expect_err("no name");
    assert!(refused.help().contains("--view-host"), "{refused}");
    let named = Options {
        names: vec!["lab-pc".to_owned()],
        ..anywhere
    };
    let (server, _asked) = Server::start(&named).expect("a server");
    let port = server.address().port();
    let local = SocketAddr::from(([127, 0, 0, 1], port));
    let path = FILES[0].path;
    assert_eq!(get(local, path, &format!("host: lab-pc:{port}\r\n")).0, 200);
    assert_eq!(
        get(local, path, &format!("host: lab-pc.evil:{port}\r\n")).0,
        421
    );
    assert!(
        server
            .url()
            .starts_with(&format!("http://lab-pc:{port}/#key="))
    );
}

/// The next port if one is taken, and words where none is left.
#[test]
fn a_port_that_is_taken_is_passed_over() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
    let port = taken.local_addr().expect("an address").port();
    let options = Options {
        port,
        ..Options::default()
    };
    let (server, _asked) = Server::start(&options).expect("a server");
    assert!(server.address().port() > port && server.address().port() < port + 10);
}
