//! Sessions for tests: a plane of springs in place of tissue, a hand that presses on it, a tapped line.
#![allow(dead_code, reason = "each test file uses its own part")]

use std::io;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use sutura_host::link::{LinkError, LinkOptions, LockstepConsole, Port};
use sutura_host::scene::{BUILT_IN_DEVICES, Document, read_device};
use sutura_host::session::{LINE_BYTES_PER_S, Plan, Rendering, Solve, Solved, Summary};
use sutura_host::step::{Status, ToolContact};
use sutura_shared::device::DeviceDescription;
use sutura_shared::wire::message::{HandScript, State, WAY_POINTS, WayPoint};
use sutura_shared::wire::{Accumulator, Unchecked, Valid, decode};

/// Longer than any machine needs, shorter than anybody waits.
pub const LONG: Duration = Duration::from_secs(60);

/// A link that waits for a machine that stands still.
pub fn patient() -> LinkOptions {
    LinkOptions {
        answer_within: LONG,
        silent_after: LONG,
        ..LinkOptions::default()
    }
}

/// Whether a session in real time ended in one of the ways that it may: where the machine let the host wait for half a
/// second, the console has gone to rest; and where it was late all the time, too little of its contact was felt.
pub fn ended_well(summary: &Summary) -> bool {
    // Force that an outage took away comes back slowly.
    let late = [
        "not-rendered: ",
        "behind: ",
        "limited: force that no motion",
    ];
    let is_late = late.iter().any(|word| summary.status.starts_with(word));
    summary.status == "ok" || went_idle(summary) || is_late
}

/// Whether the console has gone to rest by itself.
pub fn went_idle(summary: &Summary) -> bool {
    summary.status.starts_with("idle: no usable contact")
}

/// Once more until the machine let a session come as far as what is asserted of it: none means that it did not.
pub fn undisturbed<T>(mut session: impl FnMut() -> Option<T>) -> T {
    let deadline = Instant::now() + LONG;
    loop {
        if let Some(result) = session() {
            return result;
        }
        assert!(
            Instant::now() < deadline,
            "this machine, or a defect, ended every attempt before it came to what is asserted"
        );
    }
}

/// Stiffness of the plane \[N/m\].
pub const PLANE_N_PER_M: f64 = 300.0;
/// Stiffness of the hand \[N/m\].
pub const HAND_N_PER_M: f64 = 1000.0;
/// How far below the plane the hand wants to be at the end \[m\].
pub const DEPTH_M: f64 = 0.01;
/// Time at which the hand gets there \[s\].
pub const DOWN_S: f32 = 0.4;

/// Springs under the plane z = 0 that push the grip up: force and tangent in closed form.
pub struct Plane;

impl Solve for Plane {
    fn solve(&mut self, state: &Valid<State>) -> Solved {
        let z = f64::from(state.body().position_m[2]);
        let mut contact = ToolContact {
            normal: [0.0, 0.0, 1.0],
            gap_m: z.max(0.0),
            ..ToolContact::default()
        };
        contact.wrench[2] = PLANE_N_PER_M * (-z).max(0.0);
        contact.tangent[2][2] = -PLANE_N_PER_M;
        Solved {
            position_m: state.body().position_m,
            contact: Some(contact),
            status: Status::Ok,
            touched: z < 0.0,
            ..Solved::default()
        }
    }

    fn scene(&self) -> serde_json::Map<String, serde_json::Value> {
        serde_json::Map::new()
    }
}

/// The same, but every tenth force is no number.
#[derive(Default)]
pub struct NoNumber {
    solves: u64,
    pub without: u64,
}

impl Solve for NoNumber {
    fn solve(&mut self, state: &Valid<State>) -> Solved {
        let mut solved = Plane.solve(state);
        self.solves += 1;
        if self.solves.is_multiple_of(10)
            && let Some(contact) = &mut solved.contact
        {
            contact.wrench[0] = f64::NAN;
            self.without += 1;
        }
        solved
    }

    fn scene(&self) -> serde_json::Map<String, serde_json::Value> {
        serde_json::Map::new()
    }
}

/// Force at rest where plane and hand hold each other, both springs in series \[N\].
pub fn force_at_rest() -> f64 {
    DEPTH_M * PLANE_N_PER_M * HAND_N_PER_M / (PLANE_N_PER_M + HAND_N_PER_M)
}

/// The built-in bench console.
pub fn device() -> DeviceDescription {
    let (name, text) = BUILT_IN_DEVICES[0];
    read_device(&Document::embedded(name, "".as_ref(), text))
        .expect("a built-in device is good")
        .description
}

/// A session in which the hand comes from 10 mm above the plane, presses, and stays.
pub fn plan(seconds: f64) -> Plan {
    let mut way_points = [WayPoint::default(); WAY_POINTS];
    way_points[0].position_m = [0.0, 0.0, 0.01];
    way_points[1] = WayPoint {
        time_s: DOWN_S,
        position_m: [0.0, 0.0, -DEPTH_M as f32],
    };
    let hand = HandScript {
        stiffness_n_per_m: HAND_N_PER_M as f32,
        damping_n_s_per_m: 10.0,
        start_joint: [0.0, 0.0, 0.01],
        count: 2,
        way_points,
    };
    Plan {
        device: device(),
        hand,
        host_hz: 100.0,
        seconds,
        tick_hz: 1000,
        state_every: 1,
        horizon_us: None,
        clear_fault: false,
        fixture: sutura_shared::wire::message::Fixture::None,
        rendering: Rendering::Rows,
        line_bytes_per_s: LINE_BYTES_PER_S,
    }
}

/// Magnitude of the contact force in a state \[N\].
pub fn force(state: &State) -> f32 {
    state.force_n.iter().map(|f| f * f).sum::<f32>().sqrt()
}

/// A console's port that keeps a copy of all that the console says, whether a host reads it or not.
pub struct Tap {
    port: Box<dyn Port>,
    said: Arc<Mutex<Vec<u8>>>,
}

/// What a [`Tap`] heard.
#[derive(Clone)]
pub struct Said(Arc<Mutex<Vec<u8>>>);

impl Tap {
    pub fn new(port: Box<dyn Port>) -> (Tap, Said) {
        let said = Arc::new(Mutex::new(Vec::new()));
        (
            Tap {
                port,
                said: said.clone(),
            },
            Said(said),
        )
    }
}

impl Port for Tap {
    fn name(&self) -> String {
        self.port.name()
    }

    fn read(&mut self, into: &mut [u8], wait: Duration) -> io::Result<usize> {
        self.port.read(into, wait)
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.said.lock().expect("no panic").extend_from_slice(bytes);
        // What a dead host does not take is gone, as on a wire.
        self.port.write(bytes)?;
        Ok(bytes.len())
    }

    fn try_clone(&self) -> io::Result<Box<dyn Port>> {
        Ok(Box::new(Tap {
            port: self.port.try_clone()?,
            said: self.said.clone(),
        }))
    }
}

impl Said {
    /// All states so far, of whatever session.
    pub fn states(&self) -> Vec<State> {
        let bytes = self.0.lock().expect("no panic").clone();
        let mut accumulator = Accumulator::new();
        let mut states = Vec::new();
        for byte in bytes {
            let Some(packet) = accumulator.push(byte) else {
                continue;
            };
            let packet = packet.expect("the console's own bytes are whole");
            let unpacked = decode(packet)
                .expect("and right")
                .unpack()
                .expect("and decode");
            if let Unchecked::State(_, state) = unpacked {
                states.push(state);
            }
        }
        states
    }
}

/// A console in lockstep that finds in these of its ticks that the one before took longer than its period.
pub struct Overrunning<C> {
    console: C,
    ticks: u32,
    overran: &'static [u32],
}

impl<C: LockstepConsole> Overrunning<C> {
    /// Ticks are counted from 1.
    pub fn new(console: C, overran: &'static [u32]) -> Self {
        Overrunning {
            console,
            ticks: 0,
            overran,
        }
    }
}

impl<C: LockstepConsole> LockstepConsole for Overrunning<C> {
    fn exchange(&mut self, down: &[u8], up: &mut Vec<u8>) -> Result<(), LinkError> {
        self.ticks += 1;
        if self.overran.contains(&self.ticks) {
            self.console.overran();
        }
        self.console.exchange(down, up)
    }

    fn name(&self) -> &str {
        self.console.name()
    }
}
