//! What clients are shown: newest pictures at their own pace, telemetry without holes that are not said, roles.

use crate::support::{Client, SOON, begin, page, picture, run, server};
use serde_json::json;
use std::time::Duration;
use sutura_view::{Beginning, Command, Server};
use tokio::time::sleep;
use tokio_tungstenite::tungstenite::Message;

fn sequence(picture: &[u8]) -> u32 {
    u32::from_le_bytes(picture[4..8].try_into().expect("a header"))
}

fn ticks(first: u32) -> Vec<u8> {
    [&[3, 1, 0, 0][..], &first.to_le_bytes()].concat()
}

async fn acknowledge(client: &mut Client, sequence: u32) {
    client
        .say(json!({"do": "ack", "sequence": sequence}).to_string())
        .await;
}

#[test]
fn a_newcomer_gets_the_scene_the_newest_picture_and_the_last_telemetry() {
    let (server, _asked) = server();
    begin(&server, &["pause"]);
    for sequence in 1..=5 {
        server.shared().picture(picture(sequence, 100));
    }
    (0..3).for_each(|first| server.shared().block(ticks(first)));
    run(async {
        let mut client = page(&server).await;
        let hello = client.greet(&server, true).await;
        assert_eq!(
            (&hello["role"], &hello["session"]),
            (&json!("control"), &json!(1))
        );
        let geometry = client.binary(1).await;
        assert_eq!(geometry[20..24], 1_u32.to_le_bytes());
        assert_eq!(sequence(&client.binary(2).await), 5);
        let blocks = [
            client.binary(3).await,
            client.binary(3).await,
            client.binary(3).await,
        ];
        assert_eq!(
            blocks.each_ref().map(|block| block[2]),
            [1, 0, 0],
            "a gap before the first"
        );
        assert_eq!(blocks.map(|block| block[4]), [0, 1, 2]);
    });
}

/// At most two pictures are underway, and who acknowledges late gets the newest one.
#[test]
fn pictures_come_as_they_are_acknowledged() {
    let (server, _asked) = server();
    begin(&server, &["pause"]);
    run(async {
        let mut client = page(&server).await;
        client.greet(&server, true).await;
        let mut got = Vec::new();
        for sequence_now in 1..=20 {
            server.shared().picture(picture(sequence_now, 100));
            if sequence_now <= 2 {
                got.push(sequence(&client.binary(2).await));
            }
        }
        assert_eq!(got, [1, 2]);
        // Nothing more before an acknowledgement: the next message is an answer.
        let answer = client
            .ask(json!({"id": 7, "do": "picture_hz", "hz": 30}))
            .await;
        assert_eq!(answer["ok"], true);
        assert_eq!(server.shared().figures().sent, 2);
        acknowledge(&mut client, 1).await;
        assert_eq!(sequence(&client.binary(2).await), 20);
        // One that was never sent changes nothing.
        acknowledge(&mut client, 99).await;
        server.shared().picture(picture(21, 100));
        client
            .ask(json!({"id": 8, "do": "picture_hz", "hz": 30}))
            .await;
        assert_eq!(server.shared().figures().sent, 3);
        // One acknowledgement stands for those before.
        acknowledge(&mut client, 20).await;
        assert_eq!(sequence(&client.binary(2).await), 21);
    });
}

/// A client that never reads costs the others nothing, and holds no more than one picture.
#[test]
fn a_client_that_never_reads_changes_nothing_for_others() {
    let (server, _asked) = server();
    begin(&server, &["pause"]);
    run(async {
        let mut deaf = page(&server).await;
        deaf.greet(&server, false).await;
        let mut client = page(&server).await;
        client.greet(&server, true).await;
        for sequence_now in 1..=200 {
            server.shared().picture(picture(sequence_now, 1 << 20));
            let got = sequence(&client.binary(2).await);
            assert_eq!(got, sequence_now);
            acknowledge(&mut client, got).await;
        }
        // Two of its own, of which it has taken none.
        assert!(server.shared().figures().sent <= 202);
        // It reads again: what was underway, then the newest.
        let mut last = 0;
        while last < 200 {
            last = sequence(&deaf.binary(2).await);
            acknowledge(&mut deaf, last).await;
        }
    });
}

/// Who is behind by more than five seconds is given the newest, and told.
#[test]
fn telemetry_that_is_missed_is_said() {
    let (server, _asked) = server();
    begin(&server, &["pause"]);
    run(async {
        let mut client = page(&server).await;
        client.greet(&server, true).await;
        server.shared().block(ticks(0));
        assert_eq!(client.binary(3).await[2], 1);
        server.shared().block(ticks(1));
        assert_eq!(client.binary(3).await[2], 0);
        // So much at once is more than 5 s of blocks, unless they are sent while they come.
        let (mut expected, mut gaps, mut end) = (2, 0, 2);
        for _ in 0..40 {
            for first in end..end + 250 {
                server.shared().block(ticks(first));
            }
            end += 250;
            // What was on its way by then comes first; what comes after a gap says so, up to the newest.
            while expected < end {
                let next = client.binary(3).await;
                let first = u32::from_le_bytes([next[4], next[5], next[6], next[7]]);
                if next[2] == 1 {
                    assert!(first > expected, "{first} after {expected}");
                    gaps += 1;
                } else {
                    assert_eq!(first, expected);
                }
                expected = first + 1;
            }
            if gaps > 0 {
                break;
            }
        }
        assert!(gaps > 0);
    });
}

#[test]
fn one_client_controls_and_safe_stop_is_for_all() {
    let (server, asked) = server();
    begin(&server, &["pause", "safe_stop"]);
    run(async {
        let mut first = page(&server).await;
        assert_eq!(first.greet(&server, true).await["role"], "control");
        let mut second = page(&server).await;
        assert_eq!(second.greet(&server, true).await["role"], "watch");
        let refused = second.ask(json!({"id": 1, "do": "pause"})).await;
        assert!(
            refused["error"]["help"]
                .as_str()
                .is_some_and(|help| help.contains("take_control"))
        );
        assert!(asked.try_recv().is_err(), "nothing was asked for");

        second
            .say(json!({"id": 2, "do": "safe_stop"}).to_string())
            .await;
        let request = asked.recv_timeout(SOON).expect("a request");
        assert_eq!(request.command, Command::SafeStop);
        request.reply.done();

        let taken = second.ask(json!({"id": 3, "do": "take_control"})).await;
        assert_eq!(taken["ok"], true);
        assert_eq!(second.text("hello").await["role"], "control");
        assert_eq!(first.text("hello").await["role"], "watch");
        let refused = first.ask(json!({"id": 4, "do": "pause"})).await;
        assert!(refused["error"].is_object());
        // Who controls leaves: the controls are free.
        drop(second);
        while server.shared().figures().controller {
            sleep(Duration::from_millis(5)).await;
        }
        let mut third = page(&server).await;
        assert_eq!(third.greet(&server, true).await["role"], "control");
        // What does not work here is refused whoever asks.
        let refused = third.ask(json!({"id": 5, "do": "reset"})).await;
        assert!(
            refused["error"]["message"]
                .as_str()
                .is_some_and(|message| message.contains("reset"))
        );
        // A session that drops a request has said so.
        third.say(json!({"id": 6, "do": "pause"}).to_string()).await;
        drop(asked.recv_timeout(SOON).expect("a request"));
        let answer = third.ask(json!({"id": 6, "do": "ack"})).await;
        assert!(answer["error"].is_object(), "{answer}");
    });
}

/// Taking control costs the others nothing: two clients hear of it, and nobody gets the geometry again.
#[test]
fn roles_change_without_the_geometry() {
    let (server, _asked) = server();
    begin(&server, &["pause"]);
    server.shared().picture(picture(1, 100));
    run(async {
        let mut clients = Vec::new();
        for _ in 0..3 {
            let mut client = page(&server).await;
            client.greet(&server, true).await;
            client.binary(1).await;
            client.binary(2).await;
            clients.push(client);
        }
        // Kinds of what comes up to the answer of a command.
        async fn kinds(client: &mut Client, id: u64) -> Vec<String> {
            client
                .say(json!({"id": id, "do": "picture_hz", "hz": 30}).to_string())
                .await;
            let mut kinds = Vec::new();
            loop {
                match client.message().await.expect("still open") {
                    Message::Text(text) => {
                        let value: serde_json::Value = serde_json::from_str(&text).expect("JSON");
                        if value["re"] == id {
                            return kinds;
                        }
                        kinds.push(value["kind"].to_string());
                    }
                    Message::Binary(bytes) => kinds.push(bytes[0].to_string()),
                    _ => {}
                }
            }
        }
        for round in 0..4 {
            let answer = clients[1].ask(json!({"id": 1, "do": "take_control"})).await;
            assert_eq!(answer["ok"], true);
            for (at, client) in clients.iter_mut().enumerate() {
                let expected: &[&str] = match (round, at) {
                    (0, 0 | 1) => &["\"hello\""],
                    _ => &[],
                };
                // An answer goes before what waits.
                let mut came = kinds(client, 10).await;
                came.extend(kinds(client, 11).await);
                assert_eq!(came, expected, "round {round}, client {at}");
            }
        }
    });
}

fn recording(server: &Server) {
    let mut hello = serde_json::Map::new();
    hello.insert("do".to_owned(), json!(["seek"]));
    server.shared().begin(Beginning {
        hello,
        geometry: None,
        recorded: true,
    });
}

/// A session that is over is a recording: a new `hello`, all of its telemetry, and pictures by time for each client.
#[test]
fn a_recording_is_looked_at_by_time() {
    let (server, _asked) = server();
    begin(&server, &["pause"]);
    run(async {
        let mut early = page(&server).await;
        early.greet(&server, true).await;
        recording(&server);
        assert_eq!(early.text("hello").await["session"], 2);
        let refused = early.ask(json!({"id": 1, "do": "seek", "time_s": 0})).await;
        assert!(refused["error"].is_object());
        for number in 0..400_u32 {
            server.shared().block(ticks(number));
            server
                .shared()
                .recorded_picture(f64::from(number) / 30.0, picture(number + 1, 100));
        }
        let mut late = page(&server).await;
        late.greet(&server, true).await;
        for number in 0..400_u32 {
            assert_eq!(late.binary(3).await[4], number as u8);
        }
        for (client, time_s, expected) in [(&mut late, 1.0, 31), (&mut early, 2.01, 61)] {
            let answer = client
                .ask(json!({"id": 2, "do": "seek", "time_s": time_s}))
                .await;
            assert_eq!(answer["ok"], true);
            assert_eq!(sequence(&client.binary(2).await), expected);
            acknowledge(client, expected).await;
        }
        // Another one of the same time takes its place, and that alone.
        server.shared().recorded_picture(1.0, picture(1000, 100));
        for (time_s, expected) in [(1.0, 1000), (0.99, 30), (1.04, 32)] {
            late.ask(json!({"id": 2, "do": "seek", "time_s": time_s}))
                .await;
            assert_eq!(sequence(&late.binary(2).await), expected);
            acknowledge(&mut late, expected).await;
        }
        let scalar = early
            .ask(json!({"id": 3, "do": "scalar", "name": null}))
            .await;
        assert!(scalar["error"].is_object(), "{scalar}");
    });
}

/// The words that ask for scalars and rates reach whoever makes pictures.
#[test]
fn pictures_are_wanted_by_whoever_watches() {
    let (server, _asked) = server();
    begin(&server, &["scalar"]);
    assert_eq!(server.shared().wants().picture_hz, 0.0);
    run(async {
        let mut one = page(&server).await;
        one.greet(&server, true).await;
        one.ask(json!({"id": 1, "do": "picture_hz", "hz": 12}))
            .await;
        let mut other = page(&server).await;
        other.greet(&server, false).await;
        other
            .ask(json!({"id": 1, "do": "picture_hz", "hz": 0}))
            .await;
        assert_eq!(server.shared().wants().picture_hz, 12.0);
        let refused = one
            .ask(json!({"id": 2, "do": "scalar", "name": "temperature"}))
            .await;
        assert!(refused["error"].is_object());
        one.ask(json!({"id": 3, "do": "scalar", "name": "displacement"}))
            .await;
        assert_eq!(
            server.shared().wants().scalar.as_deref(),
            Some("displacement")
        );
        one.ask(json!({"id": 4, "do": "scalar", "name": null}))
            .await;
        assert_eq!(server.shared().wants().scalar, None);
        drop((one, other));
        while server.shared().figures().clients > 0 {
            sleep(Duration::from_millis(5)).await;
        }
        assert_eq!(server.shared().wants().picture_hz, 0.0);
    });
}
