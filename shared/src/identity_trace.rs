//! Fifteen thousand ticks that every console must answer with the same bits.
//!
//! Entry point: [`run`]; what it must come to is in `tests/golden/identity-trace.txt`. The script drives a simulated console in lockstep
//! through every mode, with two devices, with contact data that is ordinary, wild, stale or wrong, with a tool that rubs, and folds what
//! comes back into one hash. [`Coverage`] says what really happened, so that a hash of nothing interesting does not pass.

use crate::control::{TICK_HZ, TICK_US};
use crate::device::{DeviceDescription, JOINTS, Joint, Kinematics};
use crate::hash::TraceHash;
use crate::link::{Counters, EXPIRES_AFTER_US, HostEvent, HostLink};
use crate::math::{Vec3, dot, max};
use crate::wire::message::{
    Command, Contact, HandScript, Mode, Row, RowKind, Rows, Simulate, State, WAY_POINTS, WayPoint,
};
use crate::wire::{List, MAX_FRAME, Message};

/// A console that runs a tick when it is told to.
pub trait Lockstep {
    /// Why it did not.
    type Error;

    /// One tick: `down` comes before it, and what the console sends after it goes to `up`, byte by byte.
    ///
    /// # Errors
    /// If the console is gone.
    fn exchange(&mut self, down: &[u8], up: &mut dyn FnMut(u8)) -> Result<(), Self::Error>;
}

/// What a console made of the script.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct IdentityTrace {
    /// Over every state.
    pub hash: u64,
    /// What the states showed.
    pub coverage: Coverage,
}

/// How often something showed in the states.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Coverage {
    /// States, one per tick.
    pub states: u32,
    /// Ticks in each mode, in the order of [`Mode`].
    pub modes: [u32; 5],
    /// All faults seen, bits of [`crate::wire::faults`].
    pub faults: u16,
    /// Numbers that are not 0 and smaller than the smallest normal one.
    pub subnormals: u32,
    /// Zeros with a minus sign.
    pub negative_zeros: u32,
    /// Contacts that came into use while there was torque.
    pub swaps: u32,
    /// Ticks on the way down after the horizon.
    pub decaying_forces: u32,
    /// Ticks on which a fault let the weight down.
    pub let_down: u32,
    /// Changes from a fault to idle.
    pub recoveries: u32,
}

/// Why a run did not end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TraceError<E> {
    /// The console is gone.
    Console(E),
    /// The console does something else than one tick and one state for each exchange.
    Answer {
        /// Of the script.
        tick: u32,
        /// What is wrong.
        what: &'static str,
        /// What came over the line.
        counters: Counters,
    },
}

/// Runs the script on a console that has just booted.
///
/// # Errors
/// [`TraceError`]; other bits are no error.
pub fn run<C: Lockstep>(console: &mut C) -> Result<IdentityTrace, TraceError<C::Error>> {
    let mut driver = Driver::new(console);
    // The second session starts the console's own hash when the first device is already forgotten.
    driver.open()?;
    driver.simulate(Simulate::Device(stages(FINE)))?;
    driver.ticks(3)?;
    driver.be_turned_away()?;
    driver.fall_silent()?;
    driver.open()?;
    driver.trace = TraceHash::new();

    driver.feel_a_wall(
        stages(FINE),
        &over_the_wall([0.0; JOINTS]),
        [0.0; JOINTS],
        1500,
    )?;
    driver.lose_contact()?;
    driver.stop_and_recover()?;
    driver.tear_away()?;
    driver.rub(stages(FINE), &over_the_wall([0.0; JOINTS]), 1500)?;
    driver.feel_a_wall(
        stages(COARSE),
        &over_the_wall([0.0; JOINTS]),
        [0.0; JOINTS],
        1500,
    )?;
    driver.feel_wild_frames(2500)?;
    driver.press_hard()?;
    driver.rest()?;
    driver.feel_a_wall(
        arm(),
        &over_the_wall([0.14, 0.0, 0.12]),
        [0.0, 0.9, -1.2],
        1500,
    )?;
    driver.feel_wild_frames(2000)?;
    driver.press_hard()?;
    driver.lose_contact()?;
    driver.stop_and_recover()?;
    driver.lose_counts()?;
    Ok(IdentityTrace {
        hash: driver.trace.value(),
        coverage: driver.coverage,
    })
}

/// What a cone gives way with along its normal and across it, and a point of its own \[N/m\].
const CONE_N_PER_M: f32 = 800.0;
const ACROSS_N_PER_M: f32 = 600.0;
const ALONE_N_PER_M: f32 = 200.0;
/// By how much they pull each other along \[m/N\]: eight tenths of what would make them one.
const ALONG_M_PER_N: f32 = 2e-3;
/// How far above the cone's plane the point of its own is \[m\].
const ABOVE_M: f32 = 3e-3;
/// Encoder of an ordinary console \[1/m\].
const COARSE: f32 = 81_487.0;
/// Encoder that shows the last bit of what it measures \[1/m\].
const FINE: f32 = 1e9;

fn joint(counts_per_unit: f32, effort_per_amp: f32, max_speed_per_s: f32, inertia: f32) -> Joint {
    Joint {
        counts_per_unit,
        zero_counts: -17,
        effort_per_amp,
        max_current_a: 3.0,
        max_slew_per_s: 500.0,
        max_speed_per_s,
        inertia,
        damping: 2.0 * inertia,
        coulomb: 0.5 * inertia,
    }
}

fn stages(counts_per_m: f32) -> DeviceDescription {
    DeviceDescription {
        name: *b"identity-stages\0",
        kinematics: Kinematics::Cartesian {
            origin_m: [0.0, -0.0, 0.0],
        },
        joints: [
            joint(counts_per_m, 4.0, 2.0, 0.4),
            joint(-counts_per_m, -4.0, 2.0, 0.3),
            joint(counts_per_m, 3.0, 2.0, 0.25),
        ],
        gravity_mass_kg: [0.0, 0.0, 0.25],
        max_force_n: 5.0,
        max_power_w: 5.0,
        max_grip_speed_m_per_s: 1.5,
        actuation_delay_us: 1000,
    }
}

fn arm() -> DeviceDescription {
    DeviceDescription {
        name: *b"identity-arm\0\0\0\0",
        kinematics: Kinematics::SerialArm {
            shoulder_m: [-0.1, 0.02, 0.1],
            upper_m: 0.21,
            fore_m: 0.19,
        },
        joints: [
            joint(1e8, 0.3, 40.0, 0.006),
            joint(-12_732.0, -0.3, 40.0, 0.006),
            joint(1e8, 0.1, 40.0, 0.003),
        ],
        gravity_mass_kg: [0.0, 0.06, 0.04],
        max_force_n: 3.0,
        max_power_w: 5.0,
        max_grip_speed_m_per_s: 1.5,
        actuation_delay_us: 1000,
    }
}

/// Down through the plane z = 0 and up again, more than once, around `place`.
fn over_the_wall(place: [f32; 3]) -> HandScript {
    let [x, y, z] = place;
    let points = [
        (0.0, [x, y, z + 0.02]),
        (0.3, [x, y, -0.01]),
        (0.5, [x + 0.01, y, -0.012]),
        (0.7, [x, y - 0.01, 0.004]),
        (0.7, [x, y - 0.012, 0.004]),
        (1.0, [x - 0.01, y, -0.015]),
        (1.4, [x, y, 0.01]),
    ];
    let mut way_points = [WayPoint::default(); WAY_POINTS];
    for (slot, (time_s, position_m)) in way_points.iter_mut().zip(points) {
        *slot = WayPoint { time_s, position_m };
    }
    HandScript {
        stiffness_n_per_m: 400.0,
        damping_n_s_per_m: 8.0,
        start_joint: [0.0; JOINTS],
        count: points.len() as u8,
        way_points,
    }
}

/// Multipliers of the two normals of [`Driver::cone`] that solve their rows without friction, from their gaps \[N\].
fn both_bear(gap_m: [f32; 2]) -> [f32; 2] {
    let give = [1.0 / CONE_N_PER_M, 1.0 / ALONE_N_PER_M];
    let alone = [0, 1].map(|row| max(0.0, -gap_m[row]) / give[row]);
    let determinant = give[0] * give[1] - ALONG_M_PER_N * ALONG_M_PER_N;
    let both = [0, 1]
        .map(|row| (ALONG_M_PER_N * gap_m[1 - row] - give[1 - row] * gap_m[row]) / determinant);
    if both[0] >= 0.0 && both[1] >= 0.0 {
        both
    } else if gap_m[1] + ALONG_M_PER_N * alone[0] >= 0.0 {
        [alone[0], 0.0]
    } else {
        [0.0, alone[1]]
    }
}

/// The script's end of the line.
struct Driver<'a, C> {
    console: &'a mut C,
    link: HostLink,
    /// Frames for the next tick.
    down: heapless::Vec<u8, MAX_FRAME>,
    exchanges: u32,
    /// Newest state, and its console time \[us\].
    state: Option<State>,
    now_us: u64,
    device: DeviceDescription,
    random: Random,
    trace: TraceHash,
    coverage: Coverage,
}

impl<'a, C: Lockstep> Driver<'a, C> {
    fn new(console: &'a mut C) -> Self {
        Driver {
            console,
            link: HostLink::new(TICK_HZ),
            down: heapless::Vec::new(),
            exchanges: 0,
            state: None,
            now_us: 0,
            device: stages(FINE),
            random: Random(1),
            trace: TraceHash::new(),
            coverage: Coverage::default(),
        }
    }

    fn wrong(&self, what: &'static str) -> TraceError<C::Error> {
        TraceError::Answer {
            tick: self.exchanges,
            what,
            counters: self.link.counters(),
        }
    }

    /// Queues a frame.
    fn put(&mut self, frame: &[u8]) -> Result<(), TraceError<C::Error>> {
        let put = self.down.extend_from_slice(frame);
        put.map_err(|_| self.wrong("no room for what the script says in a tick"))
    }

    fn open(&mut self) -> Result<(), TraceError<C::Error>> {
        let mut frame = [0; MAX_FRAME];
        let hello = self.link.hello(self.exchanges + 1, &mut frame);
        let len = hello.map_err(|_| self.wrong("a hello that does not fit"))?;
        self.put(&frame[..len])?;
        self.state = None;
        self.ticks(1)
    }

    /// Another host asks for the console while it is in use.
    fn be_turned_away(&mut self) -> Result<(), TraceError<C::Error>> {
        let mut frame = [0; MAX_FRAME];
        let mut other = HostLink::new(TICK_HZ);
        let hello = other.hello(0x07e7, &mut frame);
        let len = hello.map_err(|_| self.wrong("a hello that does not fit"))?;
        self.exchanges += 1;
        let mut first = None;
        let asked = self.console.exchange(&frame[..len], &mut |byte| {
            let event = other.receive(byte);
            first = first.or(event.map(|event| matches!(event, HostEvent::Owned)));
        });
        asked.map_err(TraceError::Console)?;
        match first {
            Some(true) => Ok(()),
            _ => Err(self.wrong("another host is not turned away")),
        }
    }

    /// Nothing goes down until the console closes the session.
    fn fall_silent(&mut self) -> Result<(), TraceError<C::Error>> {
        let most = 2 * (EXPIRES_AFTER_US / TICK_US);
        for _ in 0..most {
            self.exchanges += 1;
            let mut says = false;
            let silent = self.console.exchange(&[], &mut |_| says = true);
            silent.map_err(TraceError::Console)?;
            if !says {
                return Ok(());
            }
        }
        Err(self.wrong("a session in which nothing came goes on"))
    }

    fn send<M: Message>(&mut self, time_us: u64, body: &M) -> Result<(), TraceError<C::Error>> {
        let mut frame = [0; MAX_FRAME];
        let sent = self.link.send(time_us, body, &mut frame);
        let len = sent.map_err(|_| self.wrong("a message that does not fit"))?;
        self.put(&frame[..len])
    }

    fn command(&mut self, command: Command) -> Result<(), TraceError<C::Error>> {
        self.send(self.now_us, &command)
    }

    fn simulate(&mut self, order: Simulate) -> Result<(), TraceError<C::Error>> {
        if let Simulate::Device(device) = &order {
            self.device = *device;
        }
        self.send(self.now_us, &order)
    }

    fn contact(&mut self, body: &Contact) -> Result<(), TraceError<C::Error>> {
        self.send(self.now_us, body)
    }

    /// Runs ticks; what has been sent arrives before the first.
    fn ticks(&mut self, count: u32) -> Result<(), TraceError<C::Error>> {
        for _ in 0..count {
            self.exchanges += 1;
            let (mut states, mut refused, mut newest) = (0, false, None);
            let link = &mut self.link;
            let ticked = self
                .console
                .exchange(&self.down, &mut |byte| match link.receive(byte) {
                    Some(HostEvent::State(state)) => {
                        states += 1;
                        newest = Some(state);
                    }
                    Some(HostEvent::Refused(_) | HostEvent::Owned) => refused = true,
                    Some(HostEvent::Opened(_) | HostEvent::Report(_) | HostEvent::Pong(_))
                    | None => {}
                });
            ticked.map_err(TraceError::Console)?;
            self.down.clear();
            if refused {
                return Err(self.wrong("the session is refused"));
            }
            let counters = self.link.counters();
            match newest {
                Some(state)
                    if states == 1 && counters.frames_rejected + counters.frames_lost == 0 =>
                {
                    self.now_us = state.console_time_us();
                    self.take(state.body());
                }
                _ => return Err(self.wrong("not one state for a tick, whole and in order")),
            }
        }
        Ok(())
    }

    fn take(&mut self, state: &State) {
        self.trace.double(state.trace_hash);
        self.trace.word(state.heard_sequence);
        self.trace.word(state.inputs.into());
        self.coverage.add(state, self.state.as_ref());
        self.state = Some(*state);
    }

    fn position(&self) -> Vec3 {
        self.state
            .map_or(Vec3::zeros(), |state| Vec3::from(state.position_m))
    }

    /// Ordinary use: a wall solved at 100 Hz and delivered one host period later.
    fn feel_a_wall(
        &mut self,
        device: DeviceDescription,
        hand: &HandScript,
        start_joint: [f32; JOINTS],
        ticks: u32,
    ) -> Result<(), TraceError<C::Error>> {
        self.command(Command::Disarm)?;
        self.ticks(1)?;
        self.simulate(Simulate::Device(device))?;
        self.ticks(2)?;
        self.simulate(Simulate::Hand(HandScript {
            start_joint,
            ..*hand
        }))?;
        self.command(Command::Arm)?;
        for _ in 0..ticks / 10 {
            let (solved_us, contact) = (self.now_us, self.wall());
            self.ticks(10)?;
            self.send(solved_us, &contact)?;
        }
        self.ticks(1)
    }

    /// A plane with friction by rows: a cone, and a point of its own that comes to bear beside it.
    fn rub(
        &mut self,
        device: DeviceDescription,
        hand: &HandScript,
        ticks: u32,
    ) -> Result<(), TraceError<C::Error>> {
        self.command(Command::Disarm)?;
        self.ticks(1)?;
        self.simulate(Simulate::Device(device))?;
        self.ticks(2)?;
        self.simulate(Simulate::Hand(*hand))?;
        self.command(Command::Arm)?;
        for _ in 0..ticks / 10 {
            let (solved_us, rows, contact) = (self.now_us, self.cone(), self.flat());
            self.ticks(10)?;
            self.send(solved_us, &rows)?;
            self.send(solved_us, &contact)?;
        }
        self.ticks(1)
    }

    /// The contact that goes with [`Self::cone`].
    fn flat(&self) -> Contact {
        let height_m = self.position().z;
        let mut tangent = [0.0; 21];
        tangent[11] = -CONE_N_PER_M;
        Contact {
            tool: 0,
            position_m: self.position().into(),
            orientation: [0.0, 0.0, 0.0, 1.0],
            wrench: [0.0, 0.0, CONE_N_PER_M * max(0.0, -height_m), 0.0, 0.0, 0.0],
            tangent,
            gap_m: max(0.0, height_m),
            normal: [0.0, 0.0, 1.0],
            relaxation_per_s: 0.0,
            horizon_us: 40_000,
        }
    }

    /// Rows on the plane z = 0: a cone that has slipped a little, differently every time, and a normal 3 mm above. They pull each
    /// other along, and change names now and then: then the multipliers of the frame before are not theirs, and those sent are.
    fn cone(&mut self) -> Rows {
        let height_m = self.position().z;
        let bearing = both_bear([height_m, height_m - ABOVE_M]);
        let mut tangent = |axis: usize| {
            let mut jacobian = [0.0; 6];
            jacobian[axis] = 1.0;
            let anchor_m = self.random.float(1e-3);
            Row {
                kind: RowKind::Tangent { anchor_m },
                delta_free_m: anchor_m,
                lambda_n: 0.0,
                jacobian,
            }
        };
        let across = [tangent(0), tangent(1)];
        let normal = |kind: RowKind, gap_m: f32, lambda_n: f32| Row {
            kind,
            delta_free_m: gap_m,
            lambda_n,
            jacobian: [0.0, 0.0, 1.0, 0.0, 0.0, 0.0],
        };
        let friction = 0.3;
        let id = if self.random.below(2) == 0 {
            [3, 9]
        } else {
            [9, 3]
        };
        let kind = RowKind::Normal {
            id: id[0],
            friction,
        };
        let cone = normal(kind, height_m, bearing[0]);
        let kind = RowKind::Smooth { id: id[1] };
        let alone = normal(kind, height_m - ABOVE_M, bearing[1]);
        let diagonal = [CONE_N_PER_M, ACROSS_N_PER_M, ACROSS_N_PER_M, ALONE_N_PER_M];
        let entry = |i: usize, j: usize| match (i, j) {
            (0, 3) => ALONG_M_PER_N,
            _ if i == j => 1.0 / diagonal[i],
            _ => 0.0,
        };
        let upper = (0..4).flat_map(|i| (i..4).map(move |j| (i, j)));
        Rows {
            tool: 0,
            held: [0.0; 21],
            curvature_per_m: 50.0,
            rows: List::of([cone, across[0], across[1], alone]),
            compliance: List::of(upper.map(|(i, j)| entry(i, j))),
        }
    }

    /// A plane near the grip that is tilted and stiffened a little differently every time.
    fn wall(&mut self) -> Contact {
        let normal = Vec3::from(NORMALS[self.random.below(NORMALS.len())]);
        let stiffness = 300.0 + 20.0 * self.random.below(50) as f32;
        let position = self.position();
        let height = dot(&normal, &position);
        let push = normal * (stiffness * max(0.0, -height));
        let mut tangent = [0.0; 21];
        let [x, y, z]: [f32; 3] = normal.into();
        let products = [x * x, x * y, x * z, y * y, y * z, z * z];
        for (index, product) in FORCE_ROWS.into_iter().zip(products) {
            tangent[index] = -stiffness * product;
        }
        Contact {
            tool: 0,
            position_m: position.into(),
            orientation: [0.0, 0.0, 0.0, 1.0],
            wrench: [push.x, push.y, push.z, 0.0, 0.0, 0.0],
            tangent,
            gap_m: max(0.0, height),
            normal: normal.into(),
            relaxation_per_s: self.random.below(3) as f32,
            horizon_us: 40_000,
        }
    }

    /// Frames of any valid numbers, at any rate, of any age, for any tool; orders in between.
    fn feel_wild_frames(&mut self, ticks: u32) -> Result<(), TraceError<C::Error>> {
        for _ in 0..ticks {
            if self.random.below(4) == 0 {
                let contact = self.wild_contact();
                let age_us = [0, 0, 0, 5_000, 30_000, 149_000, 200_000][self.random.below(7)];
                self.send(self.now_us.saturating_sub(age_us), &contact)?;
            }
            if self.random.below(200) == 0 {
                self.command(Command::Disarm)?;
            }
            if self.random.below(20) == 0 {
                self.command(Command::Arm)?;
            }
            if self.random.below(20) == 0 {
                self.command(Command::ClearFault)?;
            }
            self.ticks(1)?;
        }
        Ok(())
    }

    fn wild_contact(&mut self) -> Contact {
        let mut contact = self.wall();
        let near = self.random.below(2) == 0;
        for x in &mut contact.position_m {
            *x = if near { *x } else { self.random.float(0.1) };
        }
        let strength = [1e-38, 1e-3, 1.0, 1e4][self.random.below(4)];
        contact.wrench = contact.wrench.map(|_| self.random.float(strength));
        let stiffness = [1e-38, 1e2, 1e3, 1e7][self.random.below(4)];
        contact.tangent = contact.tangent.map(|_| self.random.float(stiffness));
        contact.gap_m = [0.0, -0.0, 1e-42, 1e-3, 0.05][self.random.below(5)];
        contact.relaxation_per_s = self.random.float(1000.0).abs();
        contact.horizon_us = [0, 1_000, 60_000, u32::MAX][self.random.below(4)];
        contact.tool = [0, 0, 0, 0, 7][self.random.below(5)];
        contact
    }

    /// No frames until the force is gone, frames again, then none until the console gives up.
    fn lose_contact(&mut self) -> Result<(), TraceError<C::Error>> {
        self.command(Command::Arm)?;
        for pause in [120, 20, 650] {
            for _ in 0..30 {
                let push = self.random.float(6.0);
                let contact = Contact {
                    wrench: [push, 1e-40, 5.0, 0.0, -0.0, 0.0],
                    gap_m: 0.0,
                    horizon_us: 30_000,
                    ..self.wall()
                };
                self.contact(&contact)?;
                self.ticks(2)?;
            }
            self.ticks(pause)?;
        }
        Ok(())
    }

    /// More force than the console may give, sideways and up, until no earlier force is left in the blend.
    fn press_hard(&mut self) -> Result<(), TraceError<C::Error>> {
        self.command(Command::ClearFault)?;
        self.ticks(1)?;
        self.command(Command::Arm)?;
        for _ in 0..20 {
            let contact = Contact {
                wrench: [300.0, -400.0, 500.0, 0.0, 0.0, 0.0],
                gap_m: 0.0,
                normal: [0.0, 0.0, 1.0],
                ..self.wall()
            };
            self.contact(&contact)?;
            self.ticks(10)?;
        }
        Ok(())
    }

    /// The emergency stop, and out of it again.
    fn stop_and_recover(&mut self) -> Result<(), TraceError<C::Error>> {
        let stop = Simulate::EmergencyStop(true);
        self.stop(stop, Simulate::EmergencyStop(false))
    }

    /// A hand that is too fast, there and back: a fault that lets the weight down, and out of it again.
    fn tear_away(&mut self) -> Result<(), TraceError<C::Error>> {
        for far_m in [0.16, -0.16, 0.16] {
            self.command(Command::Arm)?;
            self.ticks(120)?;
            let [x, y, z]: [f32; 3] = self.position().into();
            let mut hand = over_the_wall([0.0; JOINTS]);
            hand.stiffness_n_per_m = 2000.0;
            hand.damping_n_s_per_m = 20.0;
            hand.count = 3;
            let points = [(0.0, y), (0.02, y), (0.191, y + far_m)];
            for (slot, (time_s, y)) in hand.way_points.iter_mut().zip(points) {
                let position_m = [x, y, z];
                *slot = WayPoint { time_s, position_m };
            }
            self.simulate(Simulate::Hand(hand))?;
            self.ticks(250)?;
            self.command(Command::ClearFault)?;
            self.ticks(2)?;
        }
        Ok(())
    }

    /// Encoders that jump, and out of reach: faults that no order clears, so they come last.
    fn lose_counts(&mut self) -> Result<(), TraceError<C::Error>> {
        let back = Simulate::EncoderOffset([0; JOINTS]);
        for off in [[0, 40_000_000, 0], [i32::MAX, i32::MIN, 1_900_000_000]] {
            self.stop(Simulate::EncoderOffset(off), back)?;
        }
        Ok(())
    }

    /// A cause, and its end, with orders that arm in between and after it.
    fn stop(&mut self, cause: Simulate, end: Simulate) -> Result<(), TraceError<C::Error>> {
        self.command(Command::Arm)?;
        let contact = self.wall();
        self.contact(&contact)?;
        self.ticks(15)?;
        self.simulate(cause)?;
        self.ticks(5)?;
        self.command(Command::ClearFault)?;
        self.command(Command::Arm)?;
        self.ticks(5)?;
        self.simulate(end)?;
        self.ticks(5)?;
        self.command(Command::ClearFault)?;
        self.ticks(2)
    }

    /// Nothing moves until every filter has run out, through the smallest numbers there are.
    fn rest(&mut self) -> Result<(), TraceError<C::Error>> {
        self.command(Command::ClearFault)?;
        self.ticks(1)?;
        self.command(Command::Arm)?;
        self.ticks(700)
    }
}

/// Places of the force rows in a packed tangent.
const FORCE_ROWS: [usize; 6] = [0, 1, 2, 6, 7, 11];

/// Directions of unit length, zeros of both signs.
const NORMALS: [[f32; 3]; 5] = [
    [0.0, 0.0, 1.0],
    [-0.0, -0.0, 1.0],
    [0.6, 0.0, 0.8],
    [0.0, -0.28, 0.96],
    [0.36, 0.48, 0.8],
];

impl Coverage {
    fn add(&mut self, state: &State, before: Option<&State>) {
        self.states += 1;
        self.modes[state.mode as usize] += 1;
        self.faults |= state.faults;
        let numbers = [state.velocity_m_per_s, state.force_n, state.current_a];
        for x in numbers.as_flattened() {
            self.subnormals += u32::from(x.is_subnormal());
            self.negative_zeros += u32::from(x.to_bits() == (-0.0_f32).to_bits());
        }
        let torque = matches!(state.mode, Mode::Armed | Mode::Decaying);
        let pushes = state.force_n != [0.0; 3];
        self.decaying_forces += u32::from(state.mode == Mode::Decaying && pushes);
        if let Some(before) = before {
            let swapped = state.contact_sequence != before.contact_sequence;
            self.swaps += u32::from(torque && swapped);
            let carries = state.mode == Mode::Fault && state.current_a != [0.0; JOINTS];
            self.let_down += u32::from(carries);
            let recovered = before.mode == Mode::Fault && state.mode != Mode::Fault;
            self.recoveries += u32::from(recovered);
        }
    }
}

/// SplitMix64 (Steele, Lea and Flood 2014).
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn below(&mut self, limit: usize) -> usize {
        (self.next() % limit as u64) as usize
    }

    /// A zero of either sign, a limit, a subnormal, or anything up to `limit` in magnitude.
    fn float(&mut self, limit: f32) -> f32 {
        let magnitude = match self.below(8) {
            0 => 0.0,
            1 => limit,
            2 => f32::from_bits(self.below(1 << 23) as u32),
            _ => limit * (self.below(1 << 24) as f32 / 16_777_216.0),
        };
        if self.below(2) == 0 {
            magnitude
        } else {
            -magnitude
        }
    }
}
