//! The console's control loop in this process, with what the recorded states say that the board read.
//!
//! Entry point: [`NativeTicks`]. It needs no simulation and so takes recordings of consoles with motors. Of a simulated
//! console the mechanics run along, from when the host says what device it is, and must give what the encoders read.

use super::console::{Ran, Replayed};
use super::sessions::{DownFrame, Session};
use sutura_shared::console_endpoint::{ConsoleEndpoint, Delivery};
use sutura_shared::control::{Control, Fresh, TICK_US, TickInput, TicksLimited};
use sutura_shared::device::DeviceDescription;
use sutura_shared::hash::TraceHash;
use sutura_shared::link::{ConsoleLink, Identity};
use sutura_shared::simulated_console::SimulatedBoard;
use sutura_shared::wire::Valid;
use sutura_shared::wire::message::{Report, Simulate, State};

/// Ticks within which a console whose past is unknown must come to the recorded bits: its filters have forgotten it by then,
/// and amplifiers that are off have nothing to remember.
const JOIN_WITHIN: u64 = 2000;

/// The control loop, run again.
pub struct NativeTicks {
    device: DeviceDescription,
    run: Option<Box<Run>>,
}

#[derive(Clone)]
struct Run {
    endpoint: ConsoleEndpoint,
    control: Control,
    board: Option<SimulatedBoard>,
    contact: Option<Fresh>,
    /// Whether the recorded bits have been reached.
    joined: bool,
    ticks: u64,
    /// Ticks until the host had said what the console is, which makes all that was before void.
    known_since: Option<u64>,
    /// Trace hash of the recorded tick before.
    before: u64,
    /// Trace hash of the tick that was run last.
    hash: u64,
}

impl NativeTicks {
    /// Of a console that is this device, or becomes it.
    pub fn new(device: &DeviceDescription) -> Self {
        NativeTicks {
            device: *device,
            run: None,
        }
    }
}

impl Replayed for NativeTicks {
    fn open(&mut self, session: &Session, first: &Valid<State>) -> Result<(), String> {
        let identity = Identity {
            tick_hz: session.console.tick_hz,
            simulated: session.console.simulated,
            device_name: session.console.device_name,
        };
        let mut link = ConsoleLink::new(identity, 0);
        link.adopt(session.console.session, first.console_time_us());
        let mut control =
            Control::new(self.device).map_err(|error| format!("the recorded device: {error}"))?;
        control.open_session();
        let before = TraceHash::new().value();
        self.run = Some(Box::new(Run {
            endpoint: ConsoleEndpoint::new(link, Report::default()),
            control,
            board: None,
            contact: None,
            joined: false,
            ticks: 0,
            known_since: None,
            before,
            hash: before,
        }));
        Ok(())
    }

    fn tick(&mut self, frames: &[&DownFrame], state: &Valid<State>) -> Result<Ran, String> {
        let run = self.run.as_mut().ok_or("no session is open")?;
        run.tick(frames, state)
    }

    fn unseen(&mut self) -> Result<(), String> {
        let run = self.run.as_mut().ok_or("no session is open")?;
        run.unseen()
    }

    fn would(&self, frames: &[&DownFrame], state: &Valid<State>) -> Option<bool> {
        let mut run = self.run.clone().filter(|run| run.joined)?;
        Some(run.tick(frames, state) == Ok(Ran::Same))
    }

    fn ticks_limited(&self) -> Option<TicksLimited> {
        let run = self.run.as_ref()?;
        Some(run.control.ticks_limited())
    }

    fn hash(&self) -> u64 {
        self.run.as_ref().map_or(0, |run| run.hash)
    }
}

impl Run {
    fn tick(&mut self, frames: &[&DownFrame], state: &Valid<State>) -> Result<Ran, String> {
        let body = state.body();
        let before_us = state.console_time_us().saturating_sub(TICK_US);
        for frame in frames {
            let mut bytes = &frame.bytes[..];
            while let Some(delivery) = self.endpoint.receive(&mut bytes, before_us) {
                self.apply(delivery, before_us);
            }
        }
        let recorded = TickInput::of(state);
        let input = match &mut self.board {
            Some(board) => board.read(recorded.overrun),
            None => recorded,
        };
        if input != recorded {
            let (here, there) = (input.encoder_counts, recorded.encoder_counts);
            return Ok(Ran::Other(if here == there {
                "the simulated board reads other switches".to_owned()
            } else {
                format!("the simulated encoders read {here:?} instead of {there:?}")
            }));
        }
        if !self.joined {
            // What was before is not known: every tick goes on from the recorded one, until one comes out as recorded.
            self.control
                .go_on_from(body.tick.wrapping_sub(1), self.before);
        }
        let here = self.run(&input);
        let same = here == *body;
        self.joined |= same;
        self.ticks += 1;
        self.before = body.trace_hash;
        if same {
            return Ok(Ran::Same);
        }
        let known = self.known_since.is_some_and(|since| self.ticks > since + 2);
        if self.joined || known {
            return Ok(Ran::Other(difference(&here, body)));
        }
        if self.ticks > JOIN_WITHIN {
            return Err(format!(
                "what the console was before the session is not in the recording, and {JOIN_WITHIN} ticks have not \
                 brought it to the recorded bits"
            ));
        }
        Ok(Ran::NotYet)
    }

    fn run(&mut self, input: &TickInput) -> State {
        let output = self.control.tick(input, self.contact.take().as_ref());
        if let Some(board) = &mut self.board {
            board.write(&output);
        }
        self.hash = output.state.trace_hash;
        output.state
    }

    fn unseen(&mut self) -> Result<(), String> {
        let board = self.board.as_mut();
        let board = board.ok_or("states are missing, and with them what the encoders read")?;
        let input = board.read(false);
        self.before = self.run(&input).trace_hash;
        Ok(())
    }

    /// As a console does, but for the simulated board, which is known only once the host has said what it is.
    fn apply(&mut self, delivery: Delivery, now_us: u64) {
        let order = match delivery {
            Delivery::Contact(contact) => {
                self.contact = Some(self.endpoint.fresh(contact));
                return;
            }
            // Sessions are opened by what is recorded of them.
            Delivery::Order(order) if order.voids_contacts() => return,
            Delivery::Order(order) => order,
        };
        order.obey(&mut self.control, |order, control| {
            match (order, &mut self.board) {
                (Simulate::Device(device), _) => {
                    if control.change_device(device) {
                        self.board = Some(SimulatedBoard::at(device, now_us));
                        self.known_since = Some(self.ticks);
                    }
                }
                (order, Some(board)) => board.simulate(order, control),
                (Simulate::Hand(_), None) => {
                    control.restart_encoders();
                }
                (_, None) => {}
            }
        });
    }
}

/// In what two states of one tick differ.
pub(super) fn difference(here: &State, there: &State) -> String {
    let parts = [
        ("tick", here.tick == there.tick),
        ("pose", here.position_m == there.position_m),
        ("orientation", here.orientation == there.orientation),
        ("velocity", here.velocity_m_per_s == there.velocity_m_per_s),
        ("force", here.force_n == there.force_n),
        ("currents", here.current_a == there.current_a),
        ("mode", here.mode == there.mode),
        ("faults", here.faults == there.faults),
        (
            "contact in use",
            here.contact_sequence == there.contact_sequence,
        ),
        ("its age", here.contact_age_us == there.contact_age_us),
        ("its latency", here.applied_age_us == there.applied_age_us),
        (
            "encoder readings",
            here.encoder_counts == there.encoder_counts,
        ),
        ("inputs", here.inputs == there.inputs),
        ("frames heard", here.heard_sequence == there.heard_sequence),
        ("trace hash", here.trace_hash == there.trace_hash),
    ];
    let other = parts.iter().filter(|(_, same)| !same);
    let names: Vec<_> = other.map(|(name, _)| *name).collect();
    format!("not as recorded: {}", names.join(", "))
}
