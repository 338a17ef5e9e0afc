//! `--foxglove`, asked by a client that speaks the protocol of Foxglove's programs.
#![allow(clippy::unwrap_used, reason = "tests")]

use crate::support::sutura;
use crate::view::Running;
use base64::Engine as _;
use foxglove::Decode as _;
use foxglove::messages::SceneUpdate;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::net::TcpStream;
use std::time::{Duration, Instant};
use tokio_tungstenite::tungstenite::client::IntoClientRequest as _;
use tokio_tungstenite::tungstenite::{Message, WebSocket, client};

/// Long enough for anything on a busy machine.
const LONG: Duration = Duration::from_secs(120);

/// A client with the channels that it was told of.
struct Client {
    socket: WebSocket<TcpStream>,
    channels: BTreeMap<String, Value>,
}

impl Client {
    fn open(address: &str) -> Client {
        let stream = TcpStream::connect(address).unwrap();
        stream.set_read_timeout(Some(LONG)).unwrap();
        let mut request = format!("ws://{address}/").into_client_request().unwrap();
        let protocol = "foxglove.sdk.v1".parse().unwrap();
        request
            .headers_mut()
            .insert("sec-websocket-protocol", protocol);
        let (mut socket, answer) = client(request, stream).unwrap();
        assert_eq!(
            answer.headers()["sec-websocket-protocol"],
            "foxglove.sdk.v1"
        );
        let mut channels = BTreeMap::new();
        while channels.len() < 4 {
            let Message::Text(text) = socket.read().unwrap() else {
                continue;
            };
            let said: Value = serde_json::from_str(&text).unwrap();
            match said["op"].as_str().unwrap() {
                "serverInfo" => assert_eq!(said["capabilities"], json!([]), "to be read only"),
                "advertise" => {
                    channels.extend(said["channels"].as_array().unwrap().iter().map(|channel| {
                        (
                            channel["topic"].as_str().unwrap().to_owned(),
                            channel.clone(),
                        )
                    }))
                }
                _ => {}
            }
        }
        Client { socket, channels }
    }

    fn say(&mut self, value: &Value) {
        self.socket.send(Message::text(value.to_string())).unwrap();
    }

    /// Subscribes to all; the subscription of each has the channel's number.
    fn subscribe(&mut self) {
        let all = self.channels.values();
        let all: Vec<_> = all
            .map(|channel| json!({"id": channel["id"], "channelId": channel["id"]}))
            .collect();
        self.say(&json!({"op": "subscribe", "subscriptions": all}));
    }

    /// The next message that `wanted` makes something of.
    fn until<T>(&mut self, mut wanted: impl FnMut(&str, &[u8]) -> Option<T>) -> T {
        let began = Instant::now();
        while began.elapsed() < LONG {
            let Message::Binary(bytes) = self.socket.read().unwrap() else {
                continue;
            };
            if bytes[0] != 1 {
                continue;
            }
            let id = u32::from_le_bytes(bytes[1..5].try_into().unwrap());
            let topic = self.channels.iter().find(|(_, own)| own["id"] == id);
            let topic = topic.unwrap().0.clone();
            if let Some(found) = wanted(&topic, &bytes[13..]) {
                return found;
            }
        }
        panic!("it did not come");
    }
}

fn start(arguments: &[&str]) -> (Running, String) {
    let ports = ["--view-port", "0", "--foxglove", "--foxglove-port", "0"];
    let running = Running::start_with(&[arguments, &ports].concat(), &[]);
    let line = running.line();
    let (_, address) = line.split_once("ws://").unwrap();
    let address = address.split(' ').next().unwrap().to_owned();
    assert!(address.starts_with("127.0.0.1:"), "{line}");
    assert!(line.contains("without a key"), "{line}");
    (running, address)
}

/// Samples are as their schemas say, those of the recording; a scene has tissue, and whatever it has of tool, needle and thread.
#[test]
fn channels_say_what_their_schemas_say() {
    let (running, address) = start(&["view", "scenes/anastomosis-20.toml"]);
    let mut client = Client::open(&address);
    client.subscribe();
    let mut schemas = BTreeMap::new();
    for (topic, name, encoding) in [
        ("/tool", "sutura.Tool", "json"),
        ("/solve", "sutura.Solve", "json"),
        ("/gauges", "sutura.Gauges", "json"),
        ("/scene", "foxglove.SceneUpdate", "protobuf"),
    ] {
        let channel = &client.channels[topic];
        assert_eq!(
            (&channel["schemaName"], &channel["encoding"]),
            (&json!(name), &json!(encoding))
        );
        let schema = channel["schema"].as_str().unwrap();
        if encoding == "json" {
            let schema: Value = serde_json::from_str(schema).unwrap();
            schemas.insert(topic, jsonschema::validator_for(&schema).unwrap());
        } else {
            let bytes = base64::engine::general_purpose::STANDARD.decode(schema);
            assert!(!bytes.unwrap().is_empty());
        }
    }
    for topic in ["/tool", "/solve", "/gauges"] {
        for _ in 0..3 {
            let sample: Value = client
                .until(|own, bytes| (own == topic).then(|| serde_json::from_slice(bytes).unwrap()));
            let errors: Vec<_> = schemas[topic].iter_errors(&sample).collect();
            assert!(errors.is_empty(), "{topic}: {errors:?} of {sample}");
        }
    }
    let scene = |client: &mut Client| {
        client.until(|own, bytes| (own == "/scene").then(|| SceneUpdate::decode(bytes).unwrap()))
    };
    let two = [scene(&mut client), scene(&mut client)];
    let entity = |id: &str| {
        let mut all = two.iter().flat_map(|update| &update.entities);
        all.find(|entity| entity.id == id)
            .unwrap_or_else(|| panic!("no {id}"))
    };
    let tissue = &entity("tissue").triangles[0];
    assert!(tissue.points.len() > 100 && tissue.indices.len() > 300);
    let most = *tissue.indices.iter().max().unwrap() as usize;
    assert_eq!(most + 1, tissue.points.len());
    assert!(entity("needle 0").lines[0].points.len() > 5);
    // Half of the pictures are without it.
    let with = two
        .iter()
        .filter(|update| update.entities.iter().any(|each| each.id == "tissue"));
    assert_eq!(with.count(), 1);
    assert_eq!(running.stop().0, 0);
}

/// Who reads changes nothing: with a client that takes all and one that never reads, what was recorded runs again to the same bits.
#[test]
fn readers_change_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("read.mcap");
    let file = file.to_str().unwrap();
    let (running, address) = start(&["view", "--record", file]);
    let mut never = Client::open(&address);
    never.subscribe();
    let mut reads = Client::open(&address);
    reads.subscribe();
    let mut ticks = Vec::new();
    reads.until(|topic, bytes| {
        if topic == "/tool" {
            let sample: Value = serde_json::from_slice(bytes).unwrap();
            ticks.push(sample["tick"].as_u64().unwrap());
        }
        (ticks.len() == 50).then_some(())
    });
    // Every 20 ms of the console's time, as in recordings.
    assert!(
        ticks.windows(2).all(|two| two[1] - two[0] == 20),
        "{ticks:?}"
    );
    assert_eq!(running.stop().0, 0);
    let replayed = sutura(&["replay", file, "--verify", "--format", "json"]);
    assert_eq!(replayed.code, 0, "{}{}", replayed.stdout, replayed.stderr);
}

/// Off unless asked for; a port that is taken is said.
#[test]
fn a_taken_port_is_said() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port().to_string();
    let ran = sutura(&[
        "run",
        "--seconds",
        "0.2",
        "--foxglove",
        "--foxglove-port",
        &port,
    ]);
    assert_eq!(ran.code, 2);
    assert!(ran.stderr.contains("--foxglove-port"), "{}", ran.stderr);
}
