//! `--foxglove`: what a session says, live, on channels that Foxglove, Lichtblick and PlotJuggler take.
//!
//! Entry points: [`Live::open`], [`Tap`] for what the recorder tells. `/tool` and `/solve` are the recording's samples, `/gauges` the
//! page's figures, `/scene` what a picture shows. For this machine alone; nothing that a client says is obeyed.

use super::PageArgs;
use super::gauges::{TOPIC, schema};
use super::live_scene::LiveScene;
use crate::failure::{Cause, Failure};
use foxglove::messages::SceneUpdate;
use foxglove::{Channel, Context, FoxgloveError, RawChannel, Schema, WebSocketServerHandle};
use schemars::{JsonSchema, schema_for};
use serde::Serialize;
use serde_json::{Value, json};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;
use sutura_host::recording::{SOLVE, SolveSample, TOOL, ToolSample};
use sutura_shared::wire::message::State;
use sutura_view::{Next, Shared};

/// Channel of what is to be seen.
const SCENE: &str = "/scene";
/// Ticks between two samples of the grip, as in recordings.
const TOOL_EVERY: u32 = 20;
/// Pictures a second \[Hz\].
const PICTURE_HZ: f64 = 10.0;
/// Between two looks for something new.
const LOOK_EVERY: Duration = Duration::from_millis(20);

/// Channels that are served. Dropped, they end.
pub struct Live {
    tap: Tap,
    /// Channels are there as long as this is.
    _context: Arc<Context>,
    server: Option<WebSocketServerHandle>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

/// Where the recorder tells of what passes.
#[derive(Clone)]
pub struct Tap {
    tool: Arc<RawChannel>,
    solve: Arc<RawChannel>,
    /// Tick of the newest sample of the grip.
    tick: Arc<AtomicU32>,
}

impl Live {
    /// Opens the channels if they are asked for, and says where.
    ///
    /// # Errors
    /// No port.
    pub fn open(args: &PageArgs, shared: &Arc<Shared>) -> Result<Option<Live>, Failure> {
        if !args.foxglove {
            return Ok(None);
        }
        let port = args.foxglove_port;
        let opened = Self::serve(port, shared).map_err(|error| {
            let message =
                format!("port {port} on 127.0.0.1 cannot be had for live channels: {error}");
            let help = "give another one with --foxglove-port, or end what uses it";
            Failure::say(Cause::BadInput, message, help)
        })?;
        let port = opened
            .server
            .as_ref()
            .map_or(port, WebSocketServerHandle::port);
        note!(
            "live channels: ws://127.0.0.1:{port} (Foxglove, Lichtblick, PlotJuggler); to be read only, without a key, from this machine alone"
        );
        Ok(Some(opened))
    }

    fn serve(port: u16, shared: &Arc<Shared>) -> Result<Live, FoxgloveError> {
        let context = Context::new();
        let gauges = channel(&context, TOPIC, "sutura.Gauges", &schema())?;
        let scene = context.channel_builder(SCENE).build::<SceneUpdate>();
        let tap = Tap {
            tool: samples::<ToolSample>(&context, TOOL, "sutura.Tool")?,
            solve: samples::<SolveSample>(&context, SOLVE, "sutura.Solve")?,
            tick: Arc::default(),
        };
        let server = context
            .websocket_server()
            .name("sutura")
            .bind("127.0.0.1", port)
            // It can do nothing for clients but let them read.
            .capabilities([])
            .start_blocking()?;
        let stop = Arc::new(AtomicBool::new(false));
        let showing = Showing {
            shared: shared.clone(),
            gauges,
            scene,
            stop: stop.clone(),
        };
        let thread = std::thread::Builder::new().name("sutura-live".to_owned());
        let thread = thread.spawn(move || showing.run());
        Ok(Live {
            tap,
            _context: context,
            server: Some(server),
            stop,
            thread: Some(thread.map_err(FoxgloveError::from)?),
        })
    }

    /// For a recorder.
    pub fn tap(&self) -> Tap {
        self.tap.clone()
    }
}

impl Drop for Live {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // A panic of it has been printed.
            let _ = thread.join();
        }
        if let Some(server) = self.server.take() {
            // Clients are gone with the program.
            drop(server.stop());
        }
    }
}

fn channel(
    context: &Arc<Context>,
    topic: &str,
    name: &str,
    schema: &Value,
) -> Result<Arc<RawChannel>, FoxgloveError> {
    let schema = Schema::new(name, "jsonschema", schema.to_string().into_bytes());
    let builder = context.channel_builder(topic).message_encoding("json");
    builder.schema(schema).build_raw()
}

/// A channel with the schema that a recording has of it.
fn samples<T: JsonSchema>(
    context: &Arc<Context>,
    topic: &str,
    name: &str,
) -> Result<Arc<RawChannel>, FoxgloveError> {
    channel(context, topic, name, &schema_for!(T).to_value())
}

fn log(channel: &RawChannel, sample: &impl Serialize) {
    // Only maps with keys that are no text could fail; samples have none.
    if let Ok(bytes) = serde_json::to_vec(sample) {
        channel.log(&bytes);
    }
}

impl Tap {
    /// Takes note of a state.
    pub fn state(&self, state: &State) {
        let since = state.tick.wrapping_sub(self.tick.load(Ordering::Relaxed));
        if since < TOOL_EVERY || !self.tool.has_sinks() {
            return;
        }
        self.tick.store(state.tick, Ordering::Relaxed);
        log(&self.tool, &ToolSample::from(state));
    }

    /// Takes note of a solve.
    pub fn solve(&self, sample: &SolveSample) {
        if self.solve.has_sinks() {
            log(&self.solve, sample);
        }
    }
}

/// The thread's own: it is shown the session as a page is.
struct Showing {
    shared: Arc<Shared>,
    gauges: Arc<RawChannel>,
    scene: Channel<SceneUpdate>,
    stop: Arc<AtomicBool>,
}

impl Showing {
    fn run(self) {
        let own = self.shared.join_own(false);
        let say = |command: Value| self.shared.hear(own, &command.to_string());
        let mut scene = LiveScene::default();
        let mut is_watched = false;
        while !self.stop.load(Ordering::Relaxed) {
            if self.scene.has_sinks() != is_watched {
                is_watched = !is_watched;
                let hz = if is_watched { PICTURE_HZ } else { 0.0 };
                say(json!({"id": 0, "do": "picture_hz", "hz": hz}));
                scene.is_new = true;
            }
            let Some(next) = self.shared.next_for(own) else {
                std::thread::sleep(LOOK_EVERY);
                continue;
            };
            match next {
                Next::Text(text) => {
                    let Ok(said) = serde_json::from_str::<Value>(&text) else {
                        continue;
                    };
                    match said["kind"].as_str() {
                        Some("hello") => scene.hello(&said),
                        Some("gauges") => self.gauges.log(text.as_bytes()),
                        _ => {}
                    }
                }
                Next::Binary(bytes) | Next::AfterGap(bytes) => match bytes.first() {
                    Some(1) => scene.geometry(&bytes),
                    Some(2) => {
                        if let Some((sequence, update)) = scene.picture(&bytes) {
                            say(json!({"do": "ack", "sequence": sequence}));
                            self.scene.log(&update);
                        }
                    }
                    _ => {}
                },
            }
        }
        self.shared.leave(own);
    }
}
