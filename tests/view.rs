//! `sutura view` and `sutura run --view`, asked by a client as the page is one.
#![allow(clippy::unwrap_used, reason = "tests")]

use crate::support::{root, sutura};
use serde_json::{Value, json};
use std::io::{BufRead as _, BufReader, ErrorKind, Read as _, Write as _};
use std::net::TcpStream;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use sutura_testkit::full;
use tempfile::tempdir;
use tokio_tungstenite::tungstenite::client::IntoClientRequest as _;
use tokio_tungstenite::tungstenite::{Message, WebSocket, client};

/// Long enough for anything on a busy machine.
const LONG: Duration = Duration::from_secs(120);

/// The command, running, and where its page is.
pub struct Running {
    child: Child,
    pub address: String,
    key: String,
    words: std::sync::mpsc::Receiver<String>,
}

impl Running {
    fn start(arguments: &[&str]) -> Running {
        Running::start_with(arguments, &[])
    }

    /// With these variables in its environment.
    pub fn start_with(arguments: &[&str], variables: &[(&str, &str)]) -> Running {
        let mut command = Command::new(env!("CARGO_BIN_EXE_sutura"));
        command.envs(variables.iter().copied());
        let command = command.args(arguments).current_dir(root());
        let command = command.stdin(Stdio::null()).stdout(Stdio::piped());
        let mut child = command.stderr(Stdio::piped()).spawn().unwrap();
        let (tell, words) = std::sync::mpsc::channel();
        let stderr = child.stderr.take().unwrap();
        std::thread::spawn(move || {
            for line in BufReader::new(stderr).lines().map_while(Result::ok) {
                if tell.send(line).is_err() {
                    return;
                }
            }
        });
        let url = loop {
            let line = words.recv_timeout(LONG).unwrap();
            if let Some(url) = line.strip_prefix("see it: http://") {
                break url.to_owned();
            }
        };
        let (address, key) = url.split_once("/#key=").unwrap();
        Running {
            child,
            address: address.to_owned(),
            key: key.to_owned(),
            words,
        }
    }

    /// The next line on stderr.
    pub fn line(&self) -> String {
        self.words.recv_timeout(LONG).unwrap()
    }

    fn client(&self) -> Client {
        let stream = TcpStream::connect(&self.address).unwrap();
        stream.set_read_timeout(Some(LONG)).unwrap();
        let mut request = format!("ws://{}/ws", self.address)
            .into_client_request()
            .unwrap();
        let origin = format!("http://{}", self.address).parse().unwrap();
        request.headers_mut().insert("origin", origin);
        let (socket, _) = client(request, stream).unwrap();
        let mut client = Client { socket, id: 0 };
        client.say(&json!({"key": self.key, "control": true, "format": 1}));
        client
    }

    /// Ctrl-C; the exit code, and stdout.
    pub fn stop(self) -> (i32, String) {
        let pid = rustix::process::Pid::from_child(&self.child);
        rustix::process::kill_process(pid, rustix::process::Signal::INT).unwrap();
        self.finish()
    }

    fn finish(mut self) -> (i32, String) {
        let mut said = String::new();
        let mut stdout = self.child.stdout.take().unwrap();
        stdout.read_to_string(&mut said).unwrap();
        let status = self.child.wait().unwrap();
        let words: Vec<String> = self.words.iter().collect();
        (status.code().unwrap_or_else(|| panic!("{words:?}")), said)
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        // It has ended, or a test has failed.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

struct Client {
    socket: WebSocket<TcpStream>,
    id: u64,
}

impl Client {
    fn say(&mut self, value: &Value) {
        self.socket.send(Message::text(value.to_string())).unwrap();
    }

    /// The next message that `wanted` makes something of; pictures are acknowledged.
    fn until<T>(&mut self, mut wanted: impl FnMut(&Message) -> Option<T>) -> T {
        let began = Instant::now();
        while began.elapsed() < LONG {
            let message = self.socket.read().unwrap();
            if let Message::Binary(bytes) = &message
                && bytes[0] == 2
            {
                let sequence = u32::from_le_bytes(bytes[4..8].try_into().unwrap());
                self.say(&json!({"do": "ack", "sequence": sequence}));
            }
            if let Some(found) = wanted(&message) {
                return found;
            }
        }
        panic!("it did not come");
    }

    fn text(&mut self, wanted: impl Fn(&Value) -> bool) -> Value {
        self.until(|message| {
            let Message::Text(text) = message else {
                return None;
            };
            let value: Value = serde_json::from_str(text).unwrap();
            wanted(&value).then_some(value)
        })
    }

    fn hello(&mut self) -> Value {
        self.text(|value| value["kind"] == "hello")
    }

    fn event(&mut self, what: &str) -> Value {
        self.text(|value| value["kind"] == "event" && value["what"] == what)
    }

    fn ask(&mut self, mut command: Value) -> Value {
        self.id += 1;
        let id = self.id;
        command["id"] = json!(id);
        self.say(&command);
        self.text(|value| value["re"] == id)
    }

    fn does(&mut self, command: Value) {
        let answer = self.ask(command.clone());
        assert_eq!(answer["ok"], true, "{command}: {answer}");
    }

    fn binary(&mut self, kind: u8) -> Vec<u8> {
        self.until(|message| match message {
            Message::Binary(bytes) if bytes[0] == kind => Some(bytes.to_vec()),
            _ => None,
        })
    }
}

fn f64_at(bytes: &[u8], at: usize) -> f64 {
    f64::from_le_bytes(bytes[at..at + 8].try_into().unwrap())
}

/// A section of a picture.
fn section(picture: &[u8], wanted: u16) -> &[u8] {
    let mut at = 56;
    loop {
        let tag = u16::from_le_bytes([picture[at], picture[at + 1]]);
        let length = u32::from_le_bytes(picture[at + 4..at + 8].try_into().unwrap()) as usize;
        if tag == wanted {
            return &picture[at + 8..at + 8 + length];
        }
        at = (at + 8 + length).next_multiple_of(8);
    }
}

/// Position of the grip in a picture \[m\].
fn grip(picture: &[u8]) -> [f32; 3] {
    let status = section(picture, 7);
    [32, 36, 40].map(|at| f32::from_le_bytes(status[at..at + 4].try_into().unwrap()))
}

/// A sandbox stands still, steps, is dragged, stopped and armed, and begins anew; what was done is recorded, and the recording
/// runs again to the same bits.
#[test]
fn a_sandbox_does_what_its_page_asks_for() {
    let folder = tempdir().unwrap();
    let file = folder.path().join("sandbox.mcap");
    let file = file.to_str().unwrap();
    let running = Running::start(&["view", "--view-port", "0", "--record", file]);
    let mut client = running.client();
    let hello = client.hello();
    assert_eq!(
        (&hello["source"], &hello["pace"], &hello["role"]),
        (&json!("live"), &json!("lockstep"), &json!("control"))
    );
    assert!(hello["tools"][0]["driven"] == true && hello["bounds_m"][1][0].as_f64().unwrap() > 0.0);
    let geometry = client.binary(1);
    let vertices = u32::from_le_bytes(geometry[8..12].try_into().unwrap());
    assert!(vertices > 100);
    let picture = client.binary(2);
    assert_eq!(
        u32::from_le_bytes(picture[32..36].try_into().unwrap()),
        vertices
    );
    client.binary(3);
    client.binary(4);
    client.text(|value| value["kind"] == "gauges" && value["mode"] == "armed");
    // The scene's bench has no board that would say what it takes; it is sent rows where the hand presses.
    assert!(hello["board_rows_hz"].is_null());
    client.text(|value| value["kind"] == "gauges" && value["rows_hz"].as_f64() > Some(0.0));

    // Time stands still, and goes on by so much.
    client.does(json!({"do": "pause"}));
    client.text(|value| value["kind"] == "gauges" && value["paused"] == true);
    let standing = client.text(|value| value["kind"] == "gauges");
    let later = client.text(|value| value["kind"] == "gauges");
    assert_eq!(standing["tick"], later["tick"]);
    client.does(json!({"do": "step", "ticks": 40}));
    let tick = |value: &Value| value["tick"].as_u64().unwrap();
    let from = tick(&later);
    client.text(|value| value["kind"] == "gauges" && tick(value) == from + 40);
    client.does(json!({"do": "resume"}));

    // The grip follows.
    let to = [0.015_f32, -0.01, 0.02];
    client.does(json!({"do": "drag", "to_m": to}));
    let near = |at: [f32; 3]| at.iter().zip(to).all(|(a, b)| (a - b).abs() < 2e-3);
    client.until(|message| match message {
        Message::Binary(bytes) if bytes[0] == 2 && near(grip(bytes)) => Some(()),
        _ => None,
    });
    client.does(json!({"do": "drag", "to_m": null}));

    // Stop is obeyed while time stands still, too.
    client.does(json!({"do": "pause"}));
    client.does(json!({"do": "safe_stop"}));
    client.event("disarmed");
    let refused = client.ask(json!({"do": "drag", "to_m": to}));
    assert!(refused["error"]["help"].as_str().unwrap().contains("arm"));
    client.does(json!({"do": "arm"}));
    client.event("armed");
    client.does(json!({"do": "speed", "factor": 2.0}));
    client.does(json!({"do": "resume"}));

    // Anew, and with another tissue.
    client.does(json!({"do": "reset"}));
    let again = client.hello();
    assert_eq!(again["session"], 2);
    let first = client.binary(2);
    assert!(f64_at(&first, 8) < 2.0, "it is {} s old", f64_at(&first, 8));

    // In the middle of a way, rate, rendering, hand and what stands beside are others at once: it is the session that it was.
    client.text(|value| value["kind"] == "gauges" && value["tick"].as_u64() > Some(500));
    for (name, value) in [
        ("host-hz", json!(50)),
        ("rendering", json!("hold")),
        ("hand-stiffness", json!(400)),
        ("hand-damping", json!(8)),
        ("fixture", json!("coupling")),
        ("rendering", json!("rows")),
        ("host-hz", json!(250)),
        ("fixture", json!("none")),
    ] {
        client.does(json!({"do": "set", "name": name, "value": value}));
        let hello = client.hello();
        assert_eq!(hello["session"], 2, "{name}");
        let settings = hello["settings"].as_array().unwrap();
        let setting = settings.iter().find(|one| one["name"] == name).unwrap();
        assert_eq!(setting["at_once"], true);
        assert!(
            setting["value"] == value || setting["value"].as_f64() == value.as_f64(),
            "{setting}"
        );
        if name == "host-hz" {
            assert_eq!(hello["host_hz"].as_f64(), value.as_f64());
        }
        let gauges = client.text(|value| value["kind"] == "gauges");
        assert_eq!(gauges["mode"], "armed", "{name}");
    }
    let refused = client.ask(json!({"do": "scene", "name": "../secret"}));
    assert!(refused["error"].is_object());
    let (code, _) = running.stop();
    assert_eq!(code, 0);

    let replayed = sutura(&["replay", file, "--verify", "--format", "json"]);
    assert_eq!(replayed.code, 0, "{}{}", replayed.stdout, replayed.stderr);
}

/// Word of the solver in a picture's status.
fn word(picture: &[u8], hello: &Value) -> String {
    let number = usize::from(section(picture, 7)[0]);
    hello["statuses"][number].as_str().unwrap().to_owned()
}

/// A ball without friction that is dragged to 25 mm slips into the tissue and nothing is felt of it any more; taken out by the
/// shortest way it is armed again, outside, where it touches as before. A safe stop keeps it from being armed.
#[test]
fn a_tool_that_has_slipped_in_is_taken_out_and_armed() {
    let folder = tempdir().unwrap();
    let scene = folder.path().join("smooth.toml");
    let text = std::fs::read_to_string(root().join("scenes/palpation.toml")).unwrap();
    let smooth = text.lines().filter(|line| !line.starts_with("friction"));
    std::fs::write(&scene, smooth.collect::<Vec<_>>().join("\n")).unwrap();
    let running = Running::start(&["view", scene.to_str().unwrap(), "--view-port", "0"]);
    let mut client = running.client();
    let hello = client.hello();
    assert!(hello["do"].as_array().unwrap().contains(&json!("take_out")));
    client.event("armed");
    // The scene's own hand goes down meanwhile.
    client.does(json!({"do": "drag", "to_m": [0.003, 0.002, 0.024]}));
    client.until(|message| match message {
        Message::Binary(bytes) if bytes[0] == 2 => (grip(bytes)[2] > 0.02).then_some(()),
        _ => None,
    });
    let refused = client.ask(json!({"do": "take_out"}));
    let message = refused["error"]["message"].as_str();
    assert!(
        message.is_some_and(|message| message.contains("not in the tissue")),
        "{refused}"
    );

    // Beside the middle, where the mesh is the same on no side.
    let slips_in = |client: &mut Client| {
        let mut depth_m = -0.01_f64;
        // Until nobody holds the grip any more, since nothing is felt of it.
        loop {
            depth_m += 5e-4;
            let to_m = [0.003, 0.002, 0.014 - depth_m.min(0.04)];
            let answer = client.ask(json!({"do": "drag", "to_m": to_m}));
            if answer["ok"] != true {
                break;
            }
            // None comes once nobody holds it, which may be between the answer and the picture.
            let picture = client.until(|message| match message {
                Message::Binary(bytes) if bytes[0] == 2 => Some(Some(bytes.to_vec())),
                Message::Text(text) => {
                    let value: Value = serde_json::from_str(text).unwrap();
                    let is_idle = value["kind"] == "gauges" && value["mode"] == "idle";
                    is_idle.then_some(None)
                }
                _ => None,
            });
            let Some(picture) = picture else {
                break;
            };
            let word = word(&picture, &hello);
            if ["inside", "not-converged"].contains(&word.as_str()) {
                assert!(grip(&picture)[2] < 0.0, "{word} at {:?}", grip(&picture));
            }
        }
        let gauges = client.text(|value| value["kind"] == "gauges" && value["mode"] == "idle");
        assert!(gauges["stopped_by"].is_null(), "{gauges}");
    };
    slips_in(&mut client);
    client.does(json!({"do": "take_out"}));
    client.event("armed");
    // By the shortest way: to 17 mm above the top, the radius and a fifth of it, once motors make up for friction.
    let at = client.until(|message| match message {
        Message::Binary(bytes) if bytes[0] == 2 && word(bytes, &hello) == "ok" => {
            Some(grip(bytes)).filter(|at| at[2] > 0.016)
        }
        _ => None,
    });
    assert!(at[2] < 0.0178, "{at:?}");
    // It is felt again.
    client.does(json!({"do": "drag", "to_m": [0.0, 0.0, 0.008]}));
    client.text(|value| value["force_n"].as_f64() > Some(0.3));

    slips_in(&mut client);
    client.does(json!({"do": "take_out"}));
    client.does(json!({"do": "safe_stop"}));
    let stopped = client.text(|value| value["stopped_by"].is_string());
    assert_eq!(stopped["stopped_by"], "the page that controls");
    let ticks = |value: &Value| value["tick"].as_u64().unwrap();
    let later =
        client.text(|value| value["kind"] == "gauges" && ticks(value) > ticks(&stopped) + 1500);
    assert_eq!(
        later["mode"], "idle",
        "a safe stop goes before what is underway"
    );
    assert_eq!(running.stop().0, 0);
}

/// A page ends a recording and begins another one, of a scene that it has changed, and saves the last seconds beside them.
#[test]
fn a_page_changes_a_scene_records_and_saves() {
    let folder = tempdir().unwrap();
    let file = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let first = file("a.mcap");
    let running = Running::start(&["view", "--view-port", "0", "--record", &first]);
    let mut client = running.client();
    client.hello();
    let is_recorded = |client: &mut Client, wanted: bool| {
        client.text(|value| value["kind"] == "gauges" && value["recording"] == wanted)
    };
    let is_whole = |file: &str| {
        let ran = sutura(&["replay", file, "--verify", "--format", "json"]);
        assert_eq!(ran.code, 0, "{file}: {}{}", ran.stdout, ran.stderr);
    };
    is_recorded(&mut client, true);
    client.does(json!({"do": "record", "on": false}));
    is_recorded(&mut client, false);
    is_whole(&first);
    let refused = client.ask(json!({"do": "record", "on": false}));
    assert!(refused["error"].is_object(), "{refused}");

    client.does(json!({"do": "set", "name": "rendering", "value": "tangent"}));
    let hello = client.hello();
    assert_eq!(
        (&hello["rendering"], &hello["session"]),
        (&json!("tangent"), &json!(1))
    );
    client.does(json!({"do": "set", "name": "youngs-modulus", "value": 30e3}));
    let hello = client.hello();
    assert_eq!(
        (&hello["rendering"], &hello["session"]),
        (&json!("tangent"), &json!(2))
    );
    let settings = hello["settings"].clone();
    let mut named = settings.as_array().unwrap().iter();
    let modulus = named.find(|one| one["name"] == "youngs-modulus").unwrap();
    assert_eq!(modulus["value"], 30e3);
    for (name, value) in [
        ("rendering", json!("other")),
        ("rendering", json!(1)),
        ("youngs-modulus", json!(1e9)),
        ("unknown", json!(1)),
    ] {
        let refused = client.ask(json!({"do": "set", "name": name, "value": value}));
        assert!(refused["error"]["help"].is_string(), "{refused}");
    }

    client.does(json!({"do": "record", "on": true}));
    assert_eq!(client.hello()["rendering"], "tangent");
    is_recorded(&mut client, true);
    let refused = client.ask(json!({"do": "hand", "way": "recorded"}));
    let help = &refused["error"]["help"];
    assert!(help.as_str().unwrap().contains("drag"), "{refused}");
    client.text(|value| value["kind"] == "gauges" && value["tick"].as_u64() > Some(1000));
    for name in ["sutura-last.mcap", "sutura-last-2.mcap"] {
        client.does(json!({"do": "save_last"}));
        assert!(std::fs::metadata(file(name)).unwrap().len() > 10_000);
    }
    assert_eq!(running.stop().0, 0);
    // The session is the third, and its file has the scene with the other modulus.
    is_whole(&file("a-3.mcap"));
}

/// A session with a page has the trace and the numbers of one without.
#[test]
fn a_page_leaves_no_trace_in_a_session_in_lockstep() {
    let arguments = ["run", "--lockstep", "--seconds", "1", "--format", "json"];
    let plain = sutura(&arguments).json();
    let shown = Running::start(&[&arguments[..], &["--view", "--view-port", "0"]].concat());
    let mut client = shown.client();
    client.hello();
    // It is over, and stays as a recording.
    let hello = client.text(|value| value["kind"] == "hello" && value["source"] == "recording");
    assert_eq!(hello["time_line"]["solvable"], true);
    client.event("verified");
    let (code, said) = shown.stop();
    let said: Value = serde_json::from_str(&said).unwrap();
    assert_eq!(code, 0);
    assert_eq!(said["trace_hash"], plain["trace_hash"]);
    assert_eq!(said["view"]["clients"], 1);
    assert!(
        said["view"]["url"]
            .as_str()
            .unwrap()
            .starts_with("http://127.0.0.1:")
    );
    assert!(!said.to_string().contains("key="), "the key is nobody's");
    assert!(plain["view"].is_null());
}

/// A recording is run again, and looked at by time.
#[test]
fn a_recording_has_a_time_line() {
    let folder = tempdir().unwrap();
    let file = folder.path().join("session.mcap");
    let file = file.to_str().unwrap();
    let ran = sutura(&["run", "--lockstep", "--seconds", "1.5", "--record", file]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let running = Running::start(&["view", file, "--view-port", "0"]);
    let mut client = running.client();
    let hello = client.hello();
    assert_eq!(hello["source"], "recording");
    assert!((hello["time_line"]["to_s"].as_f64().unwrap() - 1.5).abs() < 0.05);
    let verified = client.event("verified");
    assert_eq!(verified["badge"], "identical", "{verified}");
    for time_s in [0.0, 1.0, 0.5] {
        client.does(json!({"do": "seek", "time_s": time_s}));
        let picture = client.binary(2);
        let found = f64_at(&picture, 8);
        assert!(
            found <= time_s + 1e-9 && found > time_s - 0.05,
            "{found} s for {time_s} s"
        );
        assert_eq!(picture[2] & 1, 1, "of a recording");
    }
    let refused = client.ask(json!({"do": "pause"}));
    assert!(refused["error"].is_object());

    // Pictures of another value take the places of those that there were: of the same time and the same displacements.
    let scalars = hello["scalars"].as_array().unwrap();
    let number = |name: &str| 1 + scalars.iter().position(|one| one["name"] == name).unwrap();
    let mut seen = |name: &str, time_s: f64| {
        client.does(json!({"do": "scalar", "name": name}));
        let began = Instant::now();
        while began.elapsed() < LONG {
            client.does(json!({"do": "seek", "time_s": time_s}));
            let picture = client.binary(2);
            if usize::from(picture[48]) == number(name) {
                return picture;
            }
        }
        panic!("no picture has {name}");
    };
    let stress = seen("von-mises", 0.7);
    let pressure = seen("pressure", 0.7);
    assert_eq!(f64_at(&stress, 8), f64_at(&pressure, 8));
    assert_eq!(section(&stress, 1), section(&pressure, 1));
    assert_ne!(section(&stress, 2), section(&pressure, 2));
    // The last one has it, too, and those of before come again.
    seen("pressure", 1.4);
    assert_eq!(seen("von-mises", 0.7), stress);
    assert_eq!(running.stop().0, 0);
}

/// A recording whose pictures take some seconds to make.
#[cfg(unix)]
fn long_recording(folder: &std::path::Path) -> String {
    let text = std::fs::read_to_string(root().join("scenes/palpation.toml")).unwrap();
    let scene = folder.join("scene.toml");
    std::fs::write(
        &scene,
        text.replacen("divisions = [20, 20, 8]", "divisions = [24, 24, 9]", 1),
    )
    .unwrap();
    let (scene, file) = (scene.to_str().unwrap(), folder.join("long.mcap"));
    let file = file.to_str().unwrap().to_owned();
    let ran = sutura(&[
        "run",
        scene,
        "--lockstep",
        "--seconds",
        "2",
        "--record",
        &file,
    ]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    file
}

/// Ctrl-C while a recording is built and run again: that is left, with the code of an interrupt.
#[cfg(unix)]
#[test]
fn a_recording_that_is_run_again_is_left_at_once() {
    let folder = tempdir().unwrap();
    let file = long_recording(folder.path());
    for _ in 0..20 {
        let running = Running::start(&["view", &file, "--view-port", "0"]);
        let (code, _) = running.stop();
        // A machine that is late has it run again by then.
        if code != 0 {
            assert_eq!(code, 130);
            return;
        }
    }
    panic!("it was never left");
}

/// Ctrl-C before a picture is taken, also by a browser that does not answer.
#[cfg(unix)]
#[test]
fn a_picture_is_not_waited_for_after_ctrl_c() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempdir().unwrap();
    let browser = folder.path().join("chromium");
    let answers = "#!/bin/sh\n[ \"$1\" = --version ] || exec sleep 60\n";
    std::fs::write(&browser, answers).unwrap();
    std::fs::set_permissions(&browser, std::fs::Permissions::from_mode(0o755)).unwrap();
    let recording = folder.path().join("short.mcap");
    let recording = recording.to_str().unwrap();
    let ran = sutura(&[
        "run",
        "--lockstep",
        "--seconds",
        "0.2",
        "--record",
        recording,
    ]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let path = std::env::var("PATH").unwrap();
    let path = format!("{}:{path}", folder.path().display());
    let shot = folder.path().join("shot.png");
    for shown in [recording, "scenes/palpation.toml"] {
        let line = ["view", shown, "--view-port", "0", "--at", "0.1", "--shot"];
        let line = [&line[..], &[shot.to_str().unwrap()]].concat();
        let (code, _) = Running::start_with(&line, &[("PATH", &path)]).stop();
        assert_eq!(code, 130, "{shown}");
        assert!(!shot.exists());
    }
}

/// In real time a page disarms and arms, and nothing arms by itself what it has stopped.
#[test]
fn a_page_stops_and_arms_a_session_in_real_time() {
    let running = Running::start(&[
        "run",
        "--view",
        "--view-port",
        "0",
        "--seconds",
        "8",
        "--host-hz",
        "100",
        "--rearm",
        "--format",
        "json",
    ]);
    let mut client = running.client();
    let hello = client.hello();
    assert_eq!(hello["pace"], "real-time");
    client.event("armed");
    // The console is pinged ten times a second.
    let pinged = client.text(|value| value["rtt_us"]["now"].is_object());
    for of in ["now", "all"] {
        let [p50, p99] = ["p50", "p99"].map(|part| pinged["rtt_us"][of][part].as_f64().unwrap());
        assert!(0.0 < p50 && p50 <= p99, "{pinged}");
    }
    client.does(json!({"do": "safe_stop"}));
    let disarmed = client.event("disarmed");
    let words = "safe stop, asked for by the page that controls";
    assert_eq!(disarmed["text"], words);
    let still = client.text(|value| value["kind"] == "gauges" && value["mode"] == "idle");
    let later = client.text(|value| value["kind"] == "gauges" && value["tick"] != still["tick"]);
    assert_eq!(later["mode"], "idle");
    client.does(json!({"do": "arm"}));
    client.event("armed");
    client.does(json!({"do": "safe_stop"}));
    client.event("disarmed");
    let (_, said) = running.stop();
    let said: Value = serde_json::from_str(&said).unwrap();
    assert!(said["rearmed"].as_u64().unwrap() >= 1, "{said}");
    // The summary names the person who stopped it, and that nobody armed it since.
    let stops = said["safe_stops"].as_array().unwrap();
    let by_a_page = |stop: &Value| stop["by"].as_str().unwrap().starts_with("page ");
    assert!(stops.len() == 2 && stops.iter().all(by_a_page), "{said}");
    let status = said["status"].as_str().unwrap();
    // A machine that is late may have the console let go just before.
    let let_go = said["decays"].as_u64() > Some(0);
    assert!(status.starts_with("stopped: ") || let_go, "{status}");
    assert_eq!(said["mode"], "idle");
}

/// In real time a page closes and opens the jaws of the console's tool, which no script does, and the recording has it.
#[test]
fn a_page_closes_jaws_in_real_time() {
    let folder = tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (scene, file) = (path("jaws.toml"), path("jaws.mcap"));
    let text = std::fs::read_to_string(root().join("scenes/jaws-lift.toml")).unwrap();
    let scripted = text.matches("[[jaws.close]]").count();
    let never = [
        ("from_s = 1.2", "to_s = 4.0"),
        ("from_s = 4.8", "to_s = 7.4"),
    ];
    assert_eq!(scripted, never.len());
    let text = never.iter().fold(text, |text, (from, to)| {
        text.replace(&format!("[[jaws.close]]\n{from}\n{to}\n"), "")
    });
    // Down, and there it stays.
    let (text, _) = text.split_once("# ... up by 8 mm").unwrap();
    let host = "\n[host]\nhost_hz = 100.0\nhorizon_ms = 100.0\n";
    std::fs::write(
        &scene,
        format!("{text}{host}").replace("[[hand.way_point]]\n\n[host]", "[host]"),
    )
    .unwrap();
    let running = Running::start(&[
        "run",
        &scene,
        "--view",
        "--view-port",
        "0",
        "--seconds",
        "60",
        "--record",
        &file,
        "--format",
        "json",
    ]);
    let mut client = running.client();
    let hello = client.hello();
    let commands = hello["do"].as_array().unwrap();
    assert!(commands.contains(&json!("jaws")), "{hello}");
    let tick = |value: &Value| value["tick"].as_u64();
    client.text(|value| value["kind"] == "gauges" && tick(value) > Some(1500));
    client.does(json!({"do": "jaws", "closed": true}));
    let closed = client.text(|value| value["kind"] == "gauges");
    client
        .text(|value| value["kind"] == "gauges" && tick(value) > tick(&closed).map(|at| at + 500));
    client.does(json!({"do": "jaws", "closed": false}));
    let open = client.text(|value| value["kind"] == "gauges");
    client.text(|value| value["kind"] == "gauges" && tick(value) > tick(&open).map(|at| at + 300));
    let (_, said) = running.stop();
    let said: Value = serde_json::from_str(&said).unwrap();
    let events = said["scene"]["events"].as_array().unwrap();
    let grasped = events.iter().filter(|event| event["event"] == "grasped");
    assert_eq!(grasped.count(), 1, "{said}");
    let jaws = &said["scene"]["jaws"][0];
    assert_eq!(
        (&jaws["closed"], &jaws["points"]),
        (&json!(false), &json!(0))
    );
    let ran = sutura(&["replay", &file, "--verify", "--format", "json"]);
    assert_eq!(ran.code, 0, "{}{}", ran.stdout, ran.stderr);
}

/// Who sits at no desktop, or reads stderr from a file, is shown no page unless it is asked for.
#[test]
fn without_a_terminal_there_is_no_page() {
    let mut command = Command::new(env!("CARGO_BIN_EXE_sutura"));
    command
        .args(["run", "--seconds", "0.2"])
        .env("DISPLAY", ":0")
        .current_dir(root());
    let ran = crate::support::ran(&mut command);
    assert!(!ran.stderr.contains("see it"), "{}", ran.stderr);
}

/// What does not go together is said with the next step.
#[test]
fn a_page_for_others_needs_a_name() {
    let ran = sutura(&["view", "--view-bind", "0.0.0.0"]);
    assert_eq!(ran.code, 2);
    assert!(ran.stderr.contains("--view-host"), "{}", ran.stderr);
}

/// What cannot be shown is refused before an address says that there is something to see.
#[test]
fn what_is_refused_has_no_address() {
    for file in [
        "nowhere.mcap",
        "nowhere.toml",
        "scenes/cube-handle.toml",
        "README.md",
    ] {
        let ran = sutura(&["view", file, "--view-port", "0"]);
        assert_eq!(ran.code, 2, "{file}: {}", ran.stderr);
        assert!(!ran.stderr.contains("see it"), "{file}: {}", ran.stderr);
    }
}

/// With eight clients, of whom seven only watch, each one's safe stop is answered, also while another scene is made: before that
/// is ready, and the console rests in the session that it was meant for.
#[test]
fn a_safe_stop_goes_before_a_scene_that_is_made() {
    let running = Running::start(&["view", "scenes/palpation.toml", "--view-port", "0"]);
    let mut first = running.client();
    assert_eq!(first.hello()["role"], "control");
    let mut others: Vec<Client> = (0..7).map(|_| running.client()).collect();
    first.event("armed");
    for other in &mut others {
        assert_eq!(other.hello()["role"], "watch");
        other.does(json!({"do": "safe_stop"}));
    }
    first.does(json!({"do": "arm"}));
    first.say(&json!({"id": 1000, "do": "scene", "name": "anastomosis-20"}));
    first.say(&json!({"id": 1001, "do": "safe_stop"}));
    let answer = first.text(|value| value["re"] == 1000 || value["re"] == 1001);
    assert_eq!((&answer["re"], &answer["ok"]), (&json!(1001), &json!(true)));
    assert_eq!(first.event("disarmed")["session"], 1);
    first.text(|value| value["re"] == 1000 && value["ok"] == true);
    assert_eq!(first.hello()["scene"], "Two tubes, 20 punctures");
    assert_eq!(running.stop().0, 0);
}

/// Of a safe stop and an order to arm the later one counts, in figures, in events and in the words at the end, also where both
/// come before one tick.
#[test]
fn a_safe_stop_and_arming_count_in_their_order() {
    let running = Running::start(&["view", "scenes/palpation.toml", "--view-port", "0"]);
    let mut client = running.client();
    client.event("armed");
    let say = |client: &mut Client, commands: &[&str]| {
        for (place, command) in commands.iter().enumerate() {
            client.say(&json!({"id": 1000 + place, "do": command}));
        }
        let last = 999 + commands.len();
        client.text(|value| value["re"] == last);
        let from = client.text(|value| value["kind"] == "gauges")["tick"].as_u64();
        // What came before the last order was obeyed is not asked for.
        client.text(|value| {
            value["kind"] == "gauges" && value["tick"].as_u64() > from.map(|tick| tick + 50)
        })
    };
    let gauges = say(&mut client, &["safe_stop", "arm"]);
    assert_eq!(
        (&gauges["mode"], &gauges["stopped_by"]),
        (&json!("armed"), &Value::Null)
    );
    let gauges = say(&mut client, &["arm", "safe_stop"]);
    assert_eq!(
        (&gauges["mode"], &gauges["stopped_by"]),
        (&json!("idle"), &json!("the page that controls"))
    );
    client.say(&json!({"id": 2000, "do": "reset"}));
    let ended = loop {
        let line = running.line();
        if line.contains("the session ended as") {
            break line;
        }
    };
    assert!(ended.contains("stopped: safe stop by page "), "{ended}");
    assert_eq!(running.stop().0, 0);
}

/// A drag that comes right after a safe stop is refused, whatever the console's last state was: armed again, the grip stays.
#[test]
fn a_drag_behind_a_safe_stop_is_refused() {
    for command in ["view", "run"] {
        let mut arguments = vec![command, "scenes/palpation.toml", "--view-port", "0"];
        if command == "run" {
            arguments.extend(["--view", "--seconds", "3600"]);
        }
        let running = Running::start(&arguments);
        let mut client = running.client();
        client.event("armed");
        client.does(json!({"do": "drag", "to_m": [0.0, 0.0, 0.03]}));
        client.say(&json!({"id": 1000, "do": "safe_stop"}));
        client.say(&json!({"id": 1001, "do": "drag", "to_m": [0.03, 0.02, 0.02]}));
        let answer = client.text(|value| value["re"] == 1001);
        assert!(answer["error"].is_object(), "{command}: {answer}");
        client.event("disarmed");
        client.does(json!({"do": "arm"}));
        client.event("armed");
        let gauges = client.text(|value| value["kind"] == "gauges");
        let end = gauges["tick"].as_u64().unwrap() + 500;
        client.text(|value| value["kind"] == "gauges" && value["tick"].as_u64() > Some(end));
        let at = client.until(|message| match message {
            Message::Binary(bytes) if bytes[0] == 2 => Some(grip(bytes)),
            _ => None,
        });
        assert!(
            at[0].abs() < 3e-3 && at[1].abs() < 3e-3,
            "{command}: {at:?}"
        );
        running.stop();
    }
}

/// A safe stop while another session is made, for whatever reason, holds that one, too: it begins at rest, says who stopped it,
/// and is armed by nobody but a person.
#[test]
fn a_safe_stop_holds_the_session_that_is_made() {
    let folder = tempdir().unwrap();
    let file = folder.path().join("held.mcap");
    let running = Running::start(&[
        "view",
        "scenes/palpation.toml",
        "--view-port",
        "0",
        "--record",
        file.to_str().unwrap(),
    ]);
    let mut client = running.client();
    let mut session = client.hello()["session"].as_u64().unwrap();
    client.event("armed");
    client.does(json!({"do": "record", "on": false}));
    for mut command in [
        json!({"do": "reset"}),
        json!({"do": "tissue", "name": "corotational"}),
        json!({"do": "record", "on": true}),
        json!({"do": "scene", "name": "drag"}),
    ] {
        command["id"] = json!(1000);
        client.say(&command);
        client.say(&json!({"id": 1001, "do": "safe_stop"}));
        session += 1;
        let is_new = |value: &Value| value["session"].as_u64() == Some(session);
        client.text(|value| value["kind"] == "hello" && is_new(value));
        // Its first event; and it is seen though nothing is solved.
        let (mut event, mut is_seen) = (Value::Null, false);
        client.until(|message| {
            match message {
                Message::Binary(bytes) => is_seen |= bytes[0] == 2,
                Message::Text(text) if event.is_null() => {
                    let value: Value = serde_json::from_str(text).unwrap();
                    if value["kind"] == "event" && is_new(&value) {
                        event = value;
                    }
                }
                _ => {}
            }
            (is_seen && !event.is_null()).then_some(())
        });
        let words = "safe stop, asked for by the page that controls";
        assert_eq!(
            (&event["what"], &event["text"]),
            (&json!("disarmed"), &json!(words)),
            "{command}"
        );
        let tick = |value: &Value| value["tick"].as_u64().unwrap();
        let from = client.text(|value| value["kind"] == "gauges" && is_new(value));
        let later = client.text(|value| {
            assert_ne!(value["what"], "armed", "{command}: {value}");
            value["kind"] == "gauges" && tick(value) > tick(&from) + 500
        });
        assert_eq!(
            (&later["mode"], &later["stopped_by"], &later["solves"]),
            (&json!("idle"), &json!("the page that controls"), &json!(0)),
            "{command}"
        );
        client.does(json!({"do": "arm"}));
        assert_eq!(client.event("armed")["session"].as_u64(), Some(session));
        let armed = client.text(|value| value["kind"] == "gauges" && value["mode"] == "armed");
        assert!(armed["stopped_by"].is_null(), "{armed}");
    }
    // Who arms after it arms the next one, too.
    client.say(&json!({"id": 1000, "do": "reset"}));
    client.say(&json!({"id": 1001, "do": "safe_stop"}));
    client.say(&json!({"id": 1002, "do": "arm"}));
    let event = client
        .text(|value| value["kind"] == "event" && value["session"].as_u64() == Some(session + 1));
    assert_eq!(event["what"], "armed");
    assert_eq!(running.stop().0, 0);
}

/// A scene that takes long to make, or cannot be made at all, keeps nobody from the next.
#[cfg(unix)]
#[test]
fn a_scene_in_the_making_gives_way_to_the_next() {
    let folder = tempdir().unwrap();
    let text = std::fs::read_to_string(root().join("scenes/palpation.toml")).unwrap();
    let own = |name: &str, divisions: &str| {
        let text = text.replacen("divisions = [20, 20, 8]", divisions, 1);
        let place = folder.path().join(name);
        std::fs::write(&place, text).unwrap();
        place.to_str().unwrap().to_owned()
    };
    let scene = own("quick.toml", "divisions = [8, 8, 3]");
    own("long.toml", "divisions = [50, 50, 20]");
    let pipe = folder.path().join("pipe.toml");
    assert!(Command::new("mkfifo").arg(pipe).status().unwrap().success());
    let running = Running::start(&["view", &scene, "--view-port", "0"]);
    let mut client = running.client();
    let session = client.hello()["session"].as_u64().unwrap();
    let refused = client.ask(json!({"do": "scene", "name": "pipe"}));
    let message = refused["error"]["message"].as_str().unwrap();
    assert!(message.contains("it is a pipe"), "{refused}");
    std::fs::write(folder.path().join("broken.toml"), "\nname = [").unwrap();
    let refused = client.ask(json!({"do": "scene", "name": "broken"}));
    let message = refused["error"]["message"].as_str().unwrap();
    assert!(
        message.contains("broken.toml, line 2, column "),
        "{refused}"
    );
    let help = refused["error"]["help"].as_str().unwrap();
    assert!(help.contains("`sutura scene check`"), "{refused}");
    client.say(&json!({"id": 1000, "do": "scene", "name": "long"}));
    client.say(&json!({"id": 1001, "do": "reset"}));
    let answer = client.text(|value| value["re"] == 1000 || value["re"] == 1001);
    assert_eq!(answer["re"], 1000, "{answer}");
    let message = answer["error"]["message"].as_str().unwrap();
    assert!(
        message.contains("another session was asked for"),
        "{answer}"
    );
    client.text(|value| value["re"] == 1001 && value["ok"] == true);
    assert_eq!(client.hello()["session"], session + 1);
    assert_eq!(running.stop().0, 0);
}

/// Resident memory \[MB\].
#[cfg(target_os = "linux")]
fn memory_mb(pid: u32) -> f64 {
    let status = std::fs::read_to_string(format!("/proc/{pid}/status")).unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    let kb = line.unwrap().trim().strip_suffix("kB").unwrap();
    kb.trim().parse::<f64>().unwrap() / 1000.0
}

/// A client that stands still costs the host nothing, and is shown the present when it goes on: after the pictures that were
/// underway, one that is not older than what others had then. The session's own time is what counts.
#[cfg(target_os = "linux")]
#[test]
fn a_client_that_stands_still_goes_on_in_the_present() {
    let stands_s = if full() { 60.0 } else { 4.0 };
    let running = Running::start(&["view", "scenes/palpation.toml", "--view-port", "0"]);
    let mut deaf = running.client();
    let mut other = running.client();
    deaf.binary(2);
    let began_s = f64_at(&other.binary(2), 8);
    let before_mb = memory_mb(running.child.id());
    let mut now_s = began_s;
    while now_s < began_s + stands_s {
        now_s = f64_at(&other.binary(2), 8);
    }
    let more_mb = memory_mb(running.child.id()) - before_mb;
    assert!(more_mb <= 8.0, "{more_mb} MB more");
    // Two were underway, and the newest of before may be sent as the first of them is acknowledged.
    let pictures = [0; 4].map(|_| f64_at(&deaf.binary(2), 8));
    assert!(pictures[0] < began_s + 1.0, "{pictures:?} s");
    assert!(pictures[3] >= now_s - 0.2, "{pictures:?} s at {now_s} s");
    assert_eq!(running.stop().0, 0);
}

/// A connection with the begin of a request that never ends.
fn half(address: &str) -> TcpStream {
    let mut stream = TcpStream::connect(address).unwrap();
    // It may have been closed already.
    let _ = stream.write_all(b"GET / HTTP/1.1\r\nhost: half");
    stream.set_nonblocking(true).unwrap();
    stream
}

/// A session in real time, `beside` which half requests are opened anew whenever they are closed; its summary, and how long a new
/// page took to be greeted.
fn session_beside(beside: usize, hold: Duration) -> (Value, Duration) {
    let folder = tempdir().unwrap();
    let last = folder.path().join("last.mcap");
    let arguments = [
        "run",
        "--view",
        "--view-port",
        "0",
        "--seconds",
        "3600",
        "--rearm",
        "--format",
        "json",
        "--save-last",
        last.to_str().unwrap(),
    ];
    let running = Running::start(&arguments);
    let mut first = running.client();
    first.event("armed");
    let mut halves: Vec<_> = (0..beside).map(|_| half(&running.address)).collect();
    let began = Instant::now();
    let mut greeted = Duration::ZERO;
    loop {
        for stream in &mut halves {
            let is_open = matches!(stream.read(&mut [0; 512]), Err(error) if error.kind() == ErrorKind::WouldBlock);
            if !is_open {
                *stream = half(&running.address);
            }
        }
        // A page that comes now, and what a session writes for it.
        let asked = Instant::now();
        let mut page = running.client();
        assert_eq!(page.hello()["role"], "watch");
        greeted = greeted.max(asked.elapsed());
        #[cfg(target_os = "linux")]
        {
            let folder = format!("/proc/{}/fd", running.child.id());
            let open = std::fs::read_dir(folder).unwrap().count();
            assert!(open < 200, "{open} files and connections are open");
        }
        if began.elapsed() >= hold {
            break;
        }
        std::thread::sleep(Duration::from_millis(200));
    }
    first.does(json!({"do": "save_last"}));
    drop(halves);
    let (_, said) = running.stop();
    assert!(last.exists(), "the last seconds were written");
    (serde_json::from_str(&said).unwrap(), greeted)
}

/// Half requests of a program without the key keep nobody from the page, and leave the session's files alone. In the long form 1,100 for a
/// minute, with the times printed.
#[test]
fn half_requests_beside_a_session_shut_nobody_out() {
    let (beside, hold) = match full() {
        true => (1100, Duration::from_secs(60)),
        false => (300, Duration::from_secs(1)),
    };
    let (summary, greeted) = session_beside(beside, hold);
    println!("{beside} half requests: greeted after {greeted:?} at most");
    assert_eq!(
        summary["view"]["clients"].as_u64().map(|pages| pages >= 2),
        Some(true),
        "{summary}"
    );
    if full() {
        let (alone, _) = session_beside(0, hold);
        let p99 = |summary: &Value| summary["session_us"]["p99"].as_f64().unwrap();
        println!(
            "p99 of a solve: {:.0} us, {:.0} us alone",
            p99(&summary),
            p99(&alone)
        );
    }
}

/// A browser is given a file that leads to the page: everybody reads the command lines of a machine, and nobody but the user that file.
#[cfg(target_os = "linux")]
#[test]
fn the_key_is_in_no_command_line() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempdir().unwrap();
    let program = folder.path().join("xdg-open");
    let said = folder.path().join("said");
    let script = "#!/bin/sh\nprintf '%s\\n' \"$@\" > said.new && mv said.new said\n"
        .replace("said", said.to_str().unwrap());
    std::fs::write(&program, script).unwrap();
    std::fs::set_permissions(&program, std::fs::Permissions::from_mode(0o755)).unwrap();
    let path = std::env::var("PATH").unwrap_or_default();
    let path = format!("{}:{path}", folder.path().display());
    let running = Running::start_with(&["view", "--view-port", "0", "--open"], &[("PATH", &path)]);
    let began = Instant::now();
    while !said.exists() {
        assert!(began.elapsed() < LONG, "no browser was started");
        std::thread::sleep(Duration::from_millis(20));
    }
    let argument = std::fs::read_to_string(&said).unwrap();
    assert!(!argument.contains(&running.key), "{argument}");
    let file = std::path::PathBuf::from(argument.trim_end());
    let text = std::fs::read_to_string(&file).unwrap();
    assert!(
        text.contains(&format!("http://{}/#key={}", running.address, running.key)),
        "{text}"
    );
    assert_eq!(
        std::fs::metadata(&file).unwrap().permissions().mode() & 0o777,
        0o600
    );
    assert_eq!(running.stop().0, 0);
    assert!(!file.exists(), "it is gone with the page");
}
