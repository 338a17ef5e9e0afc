//! The 1 kHz control tick: encoders in, motor currents out.
//!
//! Entry point: [`Control::tick`]. It costs the same whatever the data (a new frame costs two evaluations
//! of the contact more), allocates nothing and does not panic. Whatever the encoders and the host send,
//! the currents are finite and within the limits of the device, and without fresh contact data the
//! contact force goes to 0.

mod amplifiers;
mod bend;
mod contact;
mod credit;
mod drift;
mod drive;
mod encoders;
mod laws;
mod limits;
mod mode;
mod needle;
mod passivity;
mod ramps;
mod render;
mod round;
mod rows;
mod swing;
mod thread;
mod trust;
mod tuning;
mod velocity;
mod wall;

pub use limits::TicksLimited;
pub use needle::LocalNeedle;
pub use rows::{ContactRows, RowsForce};
pub use thread::LocalThread;
pub use tuning::{Guards, Rendering, Tuning};

use crate::device::{DeviceDescription, DeviceError, JOINTS, Joint};
use crate::hash::TraceHash;
use crate::kinematics::{self, Grip, Pose};
use crate::math::{Vec3, clamp, dot, is_finite, min};
use crate::mutant::stands;
use crate::wire::message::{Command, Fixture, Mode, State};
use crate::wire::validate::{MAX_POSITION, MAX_SPEED, UNIT_TOLERANCE};
use crate::wire::{Message, Valid, ValidContact, ValidFixture, ValidNeedle, ValidThread};
use crate::wire::{faults, inputs};
use amplifiers::Amplifiers;
use contact::{Freshness, LocalContact};
use drive::Drive;
use encoders::{Encoders, Joints};
use limits::Limits;
use mode::{Faults, Orders, has_torque, next_mode};
use passivity::{Local, Passivity};
use ramps::{Ramps, may_let_down};
use render::Render;
use swing::{Along, Swing};
use wall::Fixed;

/// Control rate \[Hz\].
pub const TICK_HZ: u16 = 1000;
/// Period of control \[us\].
pub const TICK_US: u64 = 1000;
/// Period of control \[s\].
pub const TICK_S: f32 = 1e-3;
/// Longest use of a contact frame \[us\], whatever the frame says: a hand goes 30 mm in this time, further
/// than a tangent holds.
pub const MAX_HORIZON_US: u32 = 150_000;
/// Time from the horizon until the contact force is gone \[us\]: longer than a knock, shorter than an
/// unstable swing.
pub const STALE_DECAY_US: u32 = 30_000;
/// Time from the horizon until the console disarms \[us\].
pub const LOST_AFTER_US: u32 = 500_000;

/// Which code computes a tick. Recordings have it, so that one is replayed by the code that it was made by.
///
/// Raised by one with every change of the bits that a console computes, that is with every hash that is added to
/// `tests/golden/identity-trace.txt`; a test compares the two. Changes that no bit shows, as of speed or size, leave it.
pub const CODE: u32 = 8;

/// Longest time between two ticks whose motion is believed \[ticks\].
const MOST_SWALLOWED: u64 = 10;

/// From reading the encoders until the motors act on it \[s\].
fn delay_s(device: &DeviceDescription) -> f32 {
    device.actuation_delay_us as f32 * 1e-6
}

fn new_render(device: &DeviceDescription, tuning: Tuning) -> Render {
    let limits = [device.max_force_n, device.stable_stiffness_n_per_m()];
    Render::new(limits, delay_s(device), tuning)
}

/// Where no orientation is sensed.
const UNTURNED: [f32; 4] = [0.0, 0.0, 0.0, 1.0];

/// What the host has solved, as a tick takes it: the contact, and its rows if the host has sent any.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fresh {
    /// The contact.
    pub contact: ValidContact,
    /// The rows of the same console time; none if they did not come.
    pub rows: ContactRows,
}

impl Fresh {
    /// A contact, and the rows that came last if they are its own: of the same tool and console time.
    pub fn of(contact: ValidContact, rows: &ContactRows) -> Fresh {
        let mut fresh = Fresh::from(contact);
        let own = rows.tool() == contact.body().tool
            && rows.console_time_us() == contact.console_time_us();
        if own && !rows.is_empty() {
            fresh.rows = *rows;
        }
        fresh
    }
}

impl From<ValidContact> for Fresh {
    fn from(contact: ValidContact) -> Self {
        Fresh {
            contact,
            rows: ContactRows::NONE,
        }
    }
}

/// What a board reads at the start of a tick.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TickInput {
    /// Console time at which the encoders were read \[us\].
    pub now_us: u64,
    /// Encoder readings \[counts\], (3); they may wrap around.
    pub encoder_counts: [i32; JOINTS],
    /// Orientation of the grip, unit quaternion (x, y, z, w), where the console senses it.
    pub orientation: Option<[f32; 4]>,
    /// The emergency stop is pressed.
    pub emergency_stop: bool,
    /// The board has found a fault of its own.
    pub board_fault: bool,
    /// The amplifiers do not take currents: off, not ready yet, or not ready any more. Under power they have 520 ms to get
    /// ready, in which nothing is rendered; then, and from then on, it is a fault.
    pub amplifiers_unready: bool,
    /// A supply is too low, or was since the tick before.
    pub supply_low: bool,
    /// The board's clocks contradict each other.
    pub time_base_fault: bool,
    /// The computation of the tick before took longer than its period.
    pub overrun: bool,
}

impl TickInput {
    /// What the board read in the tick that ended in this state: the same input gives the same tick.
    pub fn of(state: &Valid<State>) -> TickInput {
        let body = state.body();
        let has = |bit| body.inputs & bit != 0;
        TickInput {
            now_us: state.console_time_us(),
            encoder_counts: body.encoder_counts,
            orientation: match (has(inputs::ORIENTATION), has(inputs::NO_ROTATION)) {
                (false, _) => None,
                (true, false) => Some(body.orientation),
                (true, true) => Some([0.0; 4]),
            },
            emergency_stop: has(inputs::EMERGENCY_STOP),
            board_fault: has(inputs::BOARD_FAULT),
            amplifiers_unready: has(inputs::AMPLIFIER),
            supply_low: has(inputs::SUPPLY),
            // No input bit is left for it. The fault serves as well: it is latched from the tick that first saw it, and a tick
            // that clears it while it is still there latches it again.
            time_base_fault: body.faults & faults::TIME_BASE != 0,
            overrun: has(inputs::OVERRUN),
        }
    }

    /// Everything but the encoders, as bits of [`inputs`].
    fn bits(&self) -> u8 {
        let bit = |set, bit| if set { bit } else { 0 };
        let turned = self.orientation.as_ref();
        bit(self.emergency_stop, inputs::EMERGENCY_STOP)
            | bit(self.board_fault, inputs::BOARD_FAULT)
            | bit(self.amplifiers_unready, inputs::AMPLIFIER)
            | bit(self.supply_low, inputs::SUPPLY)
            | bit(self.overrun, inputs::OVERRUN)
            | bit(turned.is_some(), inputs::ORIENTATION)
            | bit(turned.is_some_and(|q| !is_unit(q)), inputs::NO_ROTATION)
    }
}

/// What a board puts out at the end of a tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TickOutput {
    /// Motor currents \[A\], (3).
    pub current_a: [f32; JOINTS],
    /// Whether the amplifiers are on; the currents are 0 while they are not. After a fault that lets the weight down they still
    /// are, for up to 300 ms.
    pub amplifiers_on: bool,
    /// What the host is told.
    pub state: State,
}

/// The control loop of one console.
#[derive(Clone, Copy, Debug)]
pub struct Control {
    device: DeviceDescription,
    encoders: Encoders,
    render: Render,
    /// The newest states of needle and thread in the grip.
    needle: Option<ValidNeedle>,
    thread: Option<ValidThread>,
    /// What came since the last tick.
    new_needle: Option<ValidNeedle>,
    new_thread: Option<ValidThread>,
    orders: Orders,
    faults: Faults,
    mode: Mode,
    amplifiers: Amplifiers,
    ramps: Ramps,
    drive: Drive,
    limits: Limits,
    passivity: Passivity,
    swing: Swing,
    fixed: Fixed,
    /// Put up since the last tick.
    new_fixture: Option<ValidFixture>,
    tuning: Tuning,
    /// Console time of the last tick \[us\]; none before the first.
    ticked_us: Option<u64>,
    tick: u32,
    /// Sequence of the newest frame that has been applied, or refused as too late; 0 before the first.
    heard: u32,
    trace: TraceHash,
}

impl Control {
    /// Control of a device, at boot.
    ///
    /// # Errors
    /// See [`DeviceDescription::validate`].
    pub fn new(device: DeviceDescription) -> Result<Control, DeviceError> {
        Control::tuned(device, Tuning::default())
    }

    /// Control with a rendering or without guards, to measure what they are for. Nothing on the wire
    /// reaches this.
    ///
    /// # Errors
    /// See [`DeviceDescription::validate`].
    pub fn tuned(device: DeviceDescription, tuning: Tuning) -> Result<Control, DeviceError> {
        device.validate()?;
        Ok(Control {
            encoders: Encoders::new(&device, tuning.guards),
            render: new_render(&device, tuning),
            needle: None,
            thread: None,
            new_needle: None,
            new_thread: None,
            orders: Orders::default(),
            faults: Faults::default(),
            mode: Mode::Boot,
            amplifiers: Amplifiers::Off,
            ramps: Ramps::default(),
            drive: Drive::new(&device),
            limits: Limits::new(&device, tuning.guards),
            passivity: Passivity::new(&device, tuning.guards),
            swing: Swing::NONE,
            fixed: Fixed::none(&device),
            new_fixture: None,
            tuning,
            ticked_us: None,
            tick: 0,
            heard: 0,
            trace: TraceHash::new(),
            device,
        })
    }

    /// A host has opened a session: disarms, forgets contact, needle and thread, and starts the trace hash again.
    pub fn open_session(&mut self) {
        self.close_session();
        self.limits.count_anew();
        self.trace = TraceHash::new();
    }

    /// Goes on as one that has run so many ticks and has this trace: for replays, which know both from a recording.
    pub fn go_on_from(&mut self, tick: u32, trace: u64) {
        self.tick = tick;
        self.trace = TraceHash::from_value(trace);
    }

    /// The host's session is over: disarms, and forgets contact, needle and thread.
    pub fn close_session(&mut self) {
        if self.tuning.guards.disarm {
            self.orders = Orders::default();
            self.orders.command(Command::Disarm);
            self.forget();
        }
        self.new_needle = None;
        self.new_thread = None;
        self.new_fixture = None;
        self.heard = 0;
    }

    /// Takes note of the sequence of a frame that the next tick will have applied: [`State::heard_sequence`]. A contact's
    /// is noted by the tick itself.
    pub fn hear(&mut self, sequence: u32) {
        // As the link counts: half of the circle is newer.
        if sequence.wrapping_sub(self.heard) < 1 << 31 {
            self.heard = sequence;
        }
    }

    /// Takes what the console renders by itself from the next tick on.
    pub fn fix(&mut self, fixture: &ValidFixture) {
        self.new_fixture = Some(*fixture);
    }

    /// Takes an order, for the next tick.
    pub fn command(&mut self, command: Command) {
        self.orders.command(command);
    }

    /// Takes the state of a needle, for the next tick: the newest counts.
    pub fn needle(&mut self, needle: &ValidNeedle) {
        self.new_needle = Some(*needle);
    }

    /// The newest state of the needle in the grip; none before the first, and after a fault.
    pub fn needle_in_grip(&self) -> Option<&ValidNeedle> {
        self.needle.as_ref()
    }

    /// Takes the state of a thread, for the next tick: the newest counts.
    pub fn thread(&mut self, thread: &ValidThread) {
        self.new_thread = Some(*thread);
    }

    /// The newest state of the thread in the grip; none before the first, and after a fault.
    pub fn thread_in_grip(&self) -> Option<&ValidThread> {
        self.thread.as_ref()
    }

    /// What is rendered besides contacts.
    pub fn fixture(&self) -> &Fixture {
        self.fixed.fixture()
    }

    /// Energy that the contact force has taken from the hand and not given back, as far as it may still pay for
    /// something \[J\].
    pub fn tank_j(&self) -> f32 {
        self.passivity.energy_j()
    }

    /// Ticks of the session in which a limit of the device took a part of the force away.
    pub fn ticks_limited(&self) -> TicksLimited {
        self.limits.ticks()
    }

    fn forget(&mut self) {
        self.render.forget();
        self.fixed.set(&Fixture::None);
        self.needle = None;
        self.thread = None;
    }

    /// Becomes another device, from boot on; false, and nothing changes, while the amplifiers are on, a
    /// fault is latched, or if the description is not valid. For simulated consoles.
    pub fn change_device(&mut self, device: &DeviceDescription) -> bool {
        if has_torque(self.mode) || self.mode == Mode::Fault || device.validate().is_err() {
            return false;
        }
        self.device = *device;
        self.encoders = Encoders::new(device, self.tuning.guards);
        self.drive = Drive::new(device);
        self.limits = Limits::new(device, self.tuning.guards);
        self.passivity = Passivity::new(device, self.tuning.guards);
        self.swing = Swing::NONE;
        self.fixed = Fixed::none(device);
        self.render = new_render(device, self.tuning);
        self.forget();
        self.mode = Mode::Boot;
        true
    }

    /// The joints have been put elsewhere: the next reading is believed as it is. False, and nothing
    /// changes, while the amplifiers are on. For simulated consoles.
    pub fn restart_encoders(&mut self) -> bool {
        if has_torque(self.mode) {
            return false;
        }
        self.encoders.restart();
        true
    }

    /// Ticks since the last one, those counted in that an interrupt has swallowed.
    fn ticks_since(&mut self, now_us: u64) -> u32 {
        let before_us = self.ticked_us.replace(now_us);
        let passed_us = before_us.map_or(TICK_US, |before_us| now_us.saturating_sub(before_us));
        let ticks = (passed_us + TICK_US / 2) / TICK_US;
        // A clock that stands still or jumps says nothing of motion.
        if (1..=MOST_SWALLOWED).contains(&ticks) && stands("swallowed_ticks") {
            ticks as u32
        } else {
            1
        }
    }

    /// One tick: from the encoders, and the newest contact if one has come since the last tick, to the
    /// motors.
    pub fn tick(&mut self, input: &TickInput, fresh: Option<&Fresh>) -> TickOutput {
        self.tick = self.tick.wrapping_add(1);
        if let Some(fresh) = fresh {
            self.hear(fresh.contact.sequence());
        }
        let started = self.encoders.have_started();
        let ticks = self.ticks_since(input.now_us);
        let joints = self.encoders.read(&input.encoder_counts, ticks);
        let pose = kinematics::forward(&self.device, &joints.position);
        let velocity = pose.velocity(&joints.velocity);
        let grip = self.grip(&pose, input);
        self.passivity.book(&joints.moved);

        let needle = taken(&mut self.new_needle);
        let thread = taken(&mut self.new_thread);
        if let Some(fixture) = self.new_fixture.take() {
            self.fixed.set(fixture.body());
        }
        // This console has one grip, which is tool 0.
        take_newer(&mut self.needle, needle.filter(|n| n.body().tool == 0));
        take_newer(&mut self.thread, thread.filter(|t| t.body().tool == 0));
        if let Some(fresh) = fresh.filter(|fresh| fresh.contact.body().tool == 0) {
            let (needle, thread) = (self.needle.as_ref(), self.thread.as_ref());
            self.render.take(fresh, needle, thread, &grip, input.now_us);
        }
        let too_fast = self.limits.too_fast(&velocity, self.renders());
        self.latch_faults(input, &joints, &pose, too_fast);
        self.change_mode(started, input);

        let (force, left) = self.wanted_force(&grip, &velocity, input.now_us);
        let force = self.guard(&force, left, &pose, &velocity, &joints);
        let (current_a, force) = self.drive_motors(&pose, &force);

        let state = self.state(input, &grip, &velocity, &force, current_a);
        let state = self.hash(
            input,
            (fresh, needle.as_ref(), thread.as_ref()),
            &joints,
            state,
        );
        TickOutput {
            current_a,
            amplifiers_on: self.wants_amplifiers(),
            state,
        }
    }

    fn grip(&self, pose: &Pose, input: &TickInput) -> Grip {
        Grip {
            position_m: pose.position_m,
            orientation: input.orientation.filter(is_unit).unwrap_or(UNTURNED),
        }
    }

    fn latch_faults(&mut self, input: &TickInput, joints: &Joints, pose: &Pose, too_fast: bool) {
        let turned = input.orientation.as_ref().is_none_or(is_unit);
        let beyond = |x: &f32| x.abs() > MAX_POSITION;
        let out_of_reach = joints.position.iter().any(beyond) || pose.position_m.iter().any(beyond);
        let causes = [
            (
                input.emergency_stop && self.tuning.guards.emergency_stop,
                faults::E_STOP,
            ),
            (input.board_fault, faults::BOARD),
            (input.supply_low, faults::SUPPLY | faults::BOARD),
            (input.time_base_fault, faults::TIME_BASE),
            (
                (joints.jumped && self.tuning.guards.encoder_jump) || !turned,
                faults::ENCODER_JUMP,
            ),
            (out_of_reach && stands("out_of_reach"), faults::OUT_OF_REACH),
            (too_fast, faults::OVERSPEED),
        ];
        let present = causes.iter().filter(|(present, _)| *present);
        let causes = present.fold(0, |all, (_, bit)| all | bit);
        self.faults.latch(causes, input.overrun, self.orders.clear);
    }

    /// Obeys the orders. Those that come during boot wait for its end.
    fn change_mode(&mut self, started: bool, input: &TickInput) {
        let freshness = self.render.freshness(input.now_us);
        let before = self.mode;
        let faults = self.faults.latched();
        self.mode = next_mode(before, self.orders, faults, started, freshness);
        if self.mode != Mode::Boot {
            self.orders = Orders::default();
        }
        if self.mode == Mode::Fault {
            self.forget();
        }
        let rendered = has_torque(before) && self.amplifiers.take_current();
        if self
            .amplifiers
            .judge(self.wants_amplifiers(), input.amplifiers_unready)
        {
            self.trip(faults::AMPLIFIER | faults::BOARD);
        }
        let arms = has_torque(self.mode) && !has_torque(before);
        let begins = self.renders() && !rendered;
        if arms || begins {
            // As a replay knows it, which begins with a session, or where nothing was rendered.
            self.swing = Swing::NONE;
            self.render.lead_more(0.0);
            self.begin_rendering(freshness);
        }
        if self.renders() {
            self.ramps.rise(begins);
        }
    }

    /// Whether currents of contact and weight go to the motors.
    fn renders(&self) -> bool {
        has_torque(self.mode) && self.amplifiers.take_current()
    }

    /// Whether the amplifiers are to be on: under power, or as long as a fault lets down what the motors carry.
    fn wants_amplifiers(&self) -> bool {
        let lets_down = || {
            self.mode == Mode::Fault && may_let_down(self.faults.latched()) && self.drive.carries()
        };
        has_torque(self.mode) || lets_down()
    }

    /// The first force after arming is 0 and grows from there; what is too old then is no contact at all.
    fn begin_rendering(&mut self, freshness: Freshness) {
        if freshness == Freshness::Fresh {
            self.render.start_from_nothing();
        } else {
            self.render.forget();
        }
    }

    /// Force that is wanted of contact and fixture \[N\], and the part of the largest force that they may have together:
    /// what the contact's age leaves, and what the fixture, which has no age, pushes by itself. Both rise with arming.
    fn wanted_force(&mut self, grip: &Grip, velocity: &Vec3, now_us: u64) -> (Vec3, f32) {
        if !self.renders() {
            return (Vec3::zeros(), 0.0);
        }
        let at = grip.position_m + velocity * self.render.lead_s();
        let contact = self.render.force(grip, velocity, now_us);
        let fixed = self.fixed.force(&at, velocity);
        let left = self.render.left() + self.limits.part_of(&fixed);
        let ramp = self.ramps.contact();
        ((contact + fixed) * ramp, min(left, 1.0) * ramp)
    }

    /// As much of a force as limits and tank let through. `left`: the part of the largest force that it may have.
    fn guard(
        &mut self,
        force: &Vec3,
        left: f32,
        pose: &Pose,
        velocity: &Vec3,
        joints: &Joints,
    ) -> Vec3 {
        let bounded = self.limits.bound(force, velocity);
        let (along, most) = self.render.stiffness(&bounded);
        let ramp = self.ramps.contact();
        let local = Local {
            along: (along + self.fixed.stiffness_along(&bounded)) * ramp,
            most: (most + self.fixed.stiffness()) * ramp,
            ramp,
            left: self.render.left(),
            horizon_s: self.render.contact().map_or(0.0, LocalContact::horizon_s),
            is_apart: self.render.is_apart(),
            drift_m_per_s: self.render.drift_m_per_s(),
        };
        if self.tuning.guards.swing && self.tuning.guards.lead {
            let joints = &self.device.joints;
            self.swing.watch(&bounded, velocity, |direction| {
                // Ways of the joints' coordinates along it, by the principle of virtual work.
                let ways = pose.effort(direction);
                let sum = |of: &dyn Fn(f32, &Joint) -> f32| {
                    let ways = ways.iter().zip(joints);
                    ways.fold(0.0, |sum, (way, joint)| sum + of(*way, joint))
                };
                Along {
                    square_per_s2: local.most * sum(&|way, joint| way * way / joint.inertia),
                    step_m: sum(&|way, joint| (way / joint.counts_per_unit).abs()),
                }
            });
            self.render.lead_more(self.swing.lead_s());
        }
        let allowed = self
            .passivity
            .allow(&bounded, pose, &joints.velocity, &local);
        // Damping is no friction. A fixture's force has no cone.
        let allowed = match self.fixed.fixture() {
            Fixture::None => self.render.rubbing(allowed),
            Fixture::Wall { .. } | Fixture::Coupling { .. } => allowed,
        };
        self.limits.slewed(&allowed, pose, left)
    }

    /// Currents, and the contact force that they make. A number that is not finite ends in a fault.
    fn drive_motors(&mut self, pose: &Pose, force: &Vec3) -> ([f32; JOINTS], Vec3) {
        if self.renders() {
            let contact = pose.effort(force);
            let part = self.ramps.weight();
            let weight = pose.weight_effort.map(|weight| weight * part);
            let command = self.drive.command(&weight, &contact);
            match command.filter(|_| is_finite(force)) {
                Some(command) => {
                    self.limits
                        .count(command.share < 1.0 && dot(force, force) > 0.0);
                    let force = force * command.share;
                    self.passivity.commit(&command.contact, &force);
                    self.limits.commit(&force);
                    return (command.current_a, force);
                }
                None => self.trip(faults::NOT_FINITE),
            }
        }
        self.limits.commit(&Vec3::zeros());
        if self.amplifiers.take_current() {
            // What was commanded of the contact still acts, for the device's delay, and is still booked.
            self.passivity.commit(&[0.0; JOINTS], &Vec3::zeros());
            let current_a = self.drive.let_down(self.ramps.let_down());
            if self.drive.carries() {
                return (current_a, Vec3::zeros());
            }
            self.amplifiers = Amplifiers::Off;
        }
        self.ramps.off();
        self.drive.off();
        self.passivity.off();
        ([0.0; JOINTS], Vec3::zeros())
    }

    /// A fault found in the middle of a tick.
    fn trip(&mut self, fault: u16) {
        self.faults.add(fault);
        self.mode = Mode::Fault;
        self.amplifiers = Amplifiers::Off;
        self.forget();
    }

    fn state(
        &self,
        input: &TickInput,
        grip: &Grip,
        velocity: &Vec3,
        force: &Vec3,
        current_a: [f32; JOINTS],
    ) -> State {
        let now_us = input.now_us;
        let contact = self.render.contact();
        State {
            tick: self.tick,
            position_m: grip.position_m.into(),
            orientation: grip.orientation,
            // An estimate may overshoot what the encoders are believed.
            velocity_m_per_s: velocity.map(|v| clamp(v, -MAX_SPEED, MAX_SPEED)).into(),
            force_n: (*force).into(),
            current_a,
            mode: self.mode,
            faults: self.faults.latched(),
            contact_sequence: contact.map_or(0, |contact| contact.sequence),
            contact_age_us: contact.map_or(u32::MAX, |contact| contact.age_us(now_us)),
            applied_age_us: contact.map_or(u32::MAX, |contact| contact.applied_age_us),
            trace_hash: 0,
            encoder_counts: input.encoder_counts,
            inputs: input.bits() | self.notice(),
            heard_sequence: self.heard,
        }
    }

    /// What is to be said besides what was read, as a bit of [`inputs`].
    fn notice(&self) -> u8 {
        if self.passivity.withholds() {
            inputs::WITHHELD
        } else {
            0
        }
    }

    /// Adds this tick's inputs, outputs and internal state to the trace.
    fn hash(
        &mut self,
        input: &TickInput,
        (fresh, needle, thread): (Option<&Fresh>, Option<&ValidNeedle>, Option<&ValidThread>),
        joints: &Joints,
        state: State,
    ) -> State {
        let trace = &mut self.trace;
        trace.double(input.now_us);
        for counts in input.encoder_counts {
            trace.word(counts as u32);
        }
        // Where a board has no such lines the word is what it was before there were any.
        let flags = [
            input.supply_low,
            input.amplifiers_unready,
            input.emergency_stop,
            input.board_fault,
            input.overrun,
        ];
        trace.word(
            flags
                .iter()
                .fold(0, |bits, flag| bits << 1 | u32::from(*flag)),
        );
        if let Some(frame) = fresh {
            hash_contact(trace, &frame.contact);
        }
        if let Some(frame) = needle {
            hash_needle(trace, frame);
        }
        if let Some(frame) = thread {
            hash_thread(trace, frame);
        }
        if *self.fixed.fixture() != Fixture::None {
            hash_fixture(trace, self.fixed.fixture());
        }
        trace.floats(&joints.velocity);
        if self.render.contact().is_some() {
            trace.vector(self.render.offset());
            for multiplier in self.render.multipliers_n() {
                trace.floats(&[multiplier]);
            }
        }
        trace.floats(&[self.passivity.energy_j(), self.passivity.owed_j()]);
        trace.word(self.faults.overruns());
        trace.word(state.tick);
        trace.floats(&state.position_m);
        trace.floats(&state.velocity_m_per_s);
        trace.floats(&state.force_n);
        trace.floats(&state.current_a);
        trace.word(state.mode as u32 | u32::from(state.faults) << 16);
        trace.word(state.contact_sequence);
        trace.word(state.contact_age_us);
        trace.word(state.applied_age_us);
        State {
            trace_hash: trace.value(),
            ..state
        }
    }
}

/// Whether a quaternion is finite and of unit length, to what f32 makes of it.
fn is_unit(q: &[f32; 4]) -> bool {
    let square: f32 = q.iter().fold(0.0, |sum, x| sum + x * x);
    (square - 1.0).abs() <= UNIT_TOLERANCE
}

fn hash_contact(trace: &mut TraceHash, frame: &ValidContact) {
    let body = frame.body();
    trace.word(frame.sequence());
    trace.double(frame.console_time_us());
    trace.word(u32::from(body.tool));
    trace.floats(&body.position_m);
    trace.floats(&body.orientation);
    trace.floats(&body.wrench);
    trace.floats(&body.tangent);
    trace.floats(&body.normal);
    trace.floats(&[body.gap_m, body.relaxation_per_s]);
    trace.word(body.horizon_us);
}

/// Takes what has come, if anything has: [`Option::take`] moves as many bytes where nothing has.
fn taken<T>(place: &mut Option<T>) -> Option<T> {
    if place.is_some() { place.take() } else { None }
}

/// What was solved for no older a state takes the place of the one before.
fn take_newer<M: Message + Copy>(kept: &mut Option<Valid<M>>, fresh: Option<Valid<M>>) {
    let Some(frame) = fresh else {
        return;
    };
    if kept.is_none_or(|old| frame.console_time_us() >= old.console_time_us()) {
        *kept = Some(frame);
    }
}

fn hash_thread(trace: &mut TraceHash, frame: &ValidThread) {
    let body = frame.body();
    trace.word(frame.sequence());
    trace.double(frame.console_time_us());
    let words = [body.tool, body.thread, body.end as u8, body.state as u8];
    trace.word(u32::from_le_bytes(words));
    trace.floats(&body.direction);
    trace.floats(&[body.tension_n, body.stiffness_n_per_m, body.slack_m]);
}

fn hash_fixture(trace: &mut TraceHash, fixture: &Fixture) {
    match fixture {
        Fixture::None => {}
        Fixture::Wall {
            point_m,
            normal,
            stiffness_n_per_m,
            damping_n_s_per_m,
        } => {
            trace.floats(point_m);
            trace.floats(normal);
            trace.floats(&[*stiffness_n_per_m, *damping_n_s_per_m]);
        }
        Fixture::Coupling {
            anchor_m,
            stiffness_n_per_m,
            damping_n_s_per_m,
        } => {
            trace.floats(anchor_m);
            trace.floats(&[*stiffness_n_per_m, *damping_n_s_per_m]);
        }
    }
}

fn hash_needle(trace: &mut TraceHash, frame: &ValidNeedle) {
    let body = frame.body();
    trace.word(frame.sequence());
    trace.double(frame.console_time_us());
    let words = [body.tool, body.needle, body.tip as u8, body.friction as u8];
    trace.word(u32::from_le_bytes(words));
    trace.floats(&body.slide);
    trace.floats(&body.friction_n);
    trace.floats(&body.stiffness_n_per_m);
    let forces = [body.axial_n, body.hold_n, body.puncture_n, body.punctured_n];
    trace.floats(&forces);
    let counts = [body.course.forward, body.course.backward, 0, 0];
    trace.word(u32::from_le_bytes(counts));
    trace.floats(body.course.points.as_flattened());
}
