//! Body -> typed message -> checked message: nothing that failed a check can be used by mistake.
//!
//! Entry points: [`Decoded::unpack`], then [`Unchecked::validate`]; [`Message::check`] is the same check
//! for a message that is about to be sent.

use super::frame::{Decoded, Header, Kind};
use super::message::{
    COURSE_POINTS, Command, Contact, Course, Fixture, HandScript, Hello, Needle, Ping, Pong,
    Report, Rows, Simulate, State, Tension, Thread, WAY_POINTS, WayPoint,
};
use super::{PROTOCOL_VERSION, Reject};
use crate::device::{DeviceDescription, Joint, Kinematics};
use postcard::experimental::max_size::MaxSize;
use serde::{Serialize, de::DeserializeOwned};

/// Largest distance from the origin of a grip, a way point or a gap \[m\]: no desktop console reaches
/// further, and everything computed from it in f32 stays finite.
pub const MAX_POSITION: f32 = 10.0;
/// Largest speed of a grip \[m/s\]: ten times what a hand can do.
pub const MAX_SPEED: f32 = 100.0;
/// Largest force \[N\] and moment \[N m\]: far above what the console's own limit lets through, so only a
/// broken solve gets here.
pub const MAX_WRENCH: f32 = 1e4;
/// Largest entry of a tangent \[N/m, N, N m/rad\]: steel would feel softer at the end of an arm.
pub const MAX_TANGENT: f32 = 1e7;
/// Largest way of a grip per way of the needle in its grip: as far from the middle of a circle as 100 radii.
pub const MAX_SLIDE: f32 = 100.0;
/// Largest curvature of a needle \[1/m\]: a circle of 0.1 mm.
pub const MAX_CURVATURE: f32 = 1e4;
/// Fastest relaxation \[1/s\]: gone within one tick of 1 ms.
pub const MAX_RELAXATION: f32 = 1e3;
/// Largest motor current \[A\].
pub const MAX_CURRENT: f32 = 1e3;
/// By how much the square of a unit vector's or quaternion's length may differ from 1. Rounding to f32
/// gives 1e-6; at 1e-3 the force is still right to 0.1 %.
pub const UNIT_TOLERANCE: f32 = 1e-3;
/// Number of tools that one console can have.
pub const MAX_TOOLS: u8 = 8;
/// Slowest rate of `State` frames \[ticks\].
pub const MAX_STATE_EVERY: u16 = 1000;
/// End of the longest hand script \[s\]: beyond an hour f32 no longer resolves a quarter of a tick.
pub const MAX_SCRIPT_TIME: f32 = 3600.0;
/// Stiffest simulated hand \[N/m\] (a real one: 200) that the simulation's sub-steps keep stable.
pub const MAX_HAND_STIFFNESS: f32 = 1e5;
/// Largest damping of a simulated hand \[N s/m\] (a real one: 2).
pub const MAX_HAND_DAMPING: f32 = 1e4;
/// Largest magnitude of any number in a device description: keeps products of three of them finite in
/// f32. What makes a device usable is checked where it is used.
pub const MAX_DEVICE_NUMBER: f32 = 1e9;

/// Which way a message travels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// From the host to the console.
    ToConsole,
    /// From the console to the host.
    ToHost,
}

impl Kind {
    /// Whether frames of this kind may travel in `direction`.
    pub fn travels(self, direction: Direction) -> bool {
        match self {
            Kind::Hello => true,
            Kind::State | Kind::Report | Kind::Pong => direction == Direction::ToHost,
            Kind::Contact
            | Kind::Command
            | Kind::Simulate
            | Kind::Needle
            | Kind::Thread
            | Kind::Rows
            | Kind::Ping
            | Kind::Fixture => direction == Direction::ToConsole,
            Kind::Tools => false,
        }
    }
}

/// A body that travels in a frame of its own.
pub trait Message: Serialize + DeserializeOwned + MaxSize {
    /// Kind of the frame.
    const KIND: Kind;

    /// Whether a receiver accepts these values: finite, in range, unit vectors of unit length.
    ///
    /// # Errors
    /// [`Reject::NotFinite`], [`Reject::Range`] or [`Reject::Name`].
    fn check(&self) -> Result<(), Reject>;
}

/// A message whose body has been checked, with its header. Only [`Valid::new`] makes one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Valid<M> {
    header: Header,
    body: M,
}

/// A checked [`Contact`].
pub type ValidContact = Valid<Contact>;
/// A checked [`Needle`].
pub type ValidNeedle = Valid<Needle>;
/// A checked [`Thread`].
pub type ValidThread = Valid<Thread>;
/// A checked [`Rows`].
pub type ValidRows = Valid<Rows>;
/// A checked [`Command`].
pub type ValidCommand = Valid<Command>;
/// A checked [`Fixture`].
pub type ValidFixture = Valid<Fixture>;
/// A checked [`Simulate`].
pub type ValidSimulate = Valid<Simulate>;

impl<M: Message> Valid<M> {
    /// Checks a message.
    ///
    /// # Errors
    /// See [`Message::check`]; [`Reject::Kind`] and [`Reject::Version`] if the header is not the body's.
    pub fn new(header: Header, body: M) -> Result<Self, Reject> {
        if header.kind != M::KIND {
            return Err(Reject::Kind);
        }
        if header.version != PROTOCOL_VERSION {
            return Err(Reject::Version);
        }
        body.check()?;
        Ok(Valid { header, body })
    }
}

impl<M> Valid<M> {
    /// The message.
    pub fn body(&self) -> &M {
        &self.body
    }

    /// Sequence of its frame.
    pub fn sequence(&self) -> u32 {
        self.header.sequence
    }

    /// Console time in its frame \[us\], see [`Header::console_time_us`].
    pub fn console_time_us(&self) -> u64 {
        self.header.console_time_us
    }
}

/// A body of the right layout with unchecked values.
#[derive(Clone, Copy, Debug, PartialEq)]
#[allow(
    clippy::large_enum_variant,
    reason = "lives on the stack for one frame"
)]
#[allow(missing_docs, reason = "named after the messages")]
pub enum Unchecked {
    Hello(Header, Hello),
    State(Header, State),
    Contact(Header, Contact),
    Command(Header, Command),
    Report(Header, Report),
    Simulate(Header, Simulate),
    Needle(Header, Needle),
    Thread(Header, Thread),
    Fixture(Header, Fixture),
    Ping(Header, Ping),
    Pong(Header, Pong),
}

/// A checked message of any kind.
#[derive(Clone, Copy, Debug, PartialEq)]
#[allow(
    clippy::large_enum_variant,
    reason = "lives on the stack for one frame"
)]
#[allow(missing_docs, reason = "named after the messages")]
pub enum Checked {
    Hello(Valid<Hello>),
    State(Valid<State>),
    Contact(ValidContact),
    Command(ValidCommand),
    Report(Valid<Report>),
    Simulate(ValidSimulate),
    Needle(ValidNeedle),
    Thread(ValidThread),
    Fixture(ValidFixture),
    Ping(Valid<Ping>),
    Pong(Valid<Pong>),
}

impl Decoded<'_> {
    /// Reads the body of any message but [`Rows`]: see [`Self::rows`].
    ///
    /// # Errors
    /// [`Reject::Kind`] for rows;     /// [`Reject::Body`] if it does not decode, [`Reject::Trailing`] if bytes are left over.
    pub fn unpack(&self) -> Result<Unchecked, Reject> {
        let header = self.header;
        Ok(match header.kind {
            Kind::Hello => Unchecked::Hello(header, self.read()?),
            Kind::State => Unchecked::State(header, self.read()?),
            Kind::Contact => Unchecked::Contact(header, self.read()?),
            Kind::Command => Unchecked::Command(header, self.read()?),
            Kind::Report => Unchecked::Report(header, self.read()?),
            Kind::Simulate => Unchecked::Simulate(header, self.read()?),
            Kind::Needle => Unchecked::Needle(header, self.read()?),
            Kind::Thread => Unchecked::Thread(header, self.read()?),
            Kind::Rows => return Err(Reject::Kind),
            Kind::Fixture => Unchecked::Fixture(header, self.read()?),
            Kind::Ping => Unchecked::Ping(header, self.read()?),
            Kind::Pong => Unchecked::Pong(header, self.read()?),
            Kind::Tools => return Err(Reject::ReservedKind),
        })
    }

    /// Reads and checks rows. They are ten times as large as all else, and would make every message that is handed on
    /// as large as they are: they are no part of [`Unchecked`] and [`Checked`].
    ///
    /// # Errors
    /// As of [`Self::unpack`] and [`Unchecked::validate`], [`Reject::Kind`] for other kinds.
    pub fn rows(&self, direction: Direction) -> Result<ValidRows, Reject> {
        if !self.header.kind.travels(direction) {
            return Err(Reject::Direction);
        }
        if self.header.kind != Kind::Rows {
            return Err(Reject::Kind);
        }
        Valid::new(self.header, self.read()?)
    }

    fn read<M: Message>(&self) -> Result<M, Reject> {
        match postcard::take_from_bytes(self.body) {
            Ok((body, [])) => Ok(body),
            Ok(_) => Err(Reject::Trailing),
            Err(_) => Err(Reject::Body),
        }
    }
}

impl Unchecked {
    /// Checks direction and values.
    ///
    /// # Errors
    /// [`Reject::Direction`] if this end never receives such a message; else see [`Message::check`].
    pub fn validate(self, direction: Direction) -> Result<Checked, Reject> {
        if !self.travels(direction) {
            return Err(Reject::Direction);
        }
        Ok(match self {
            Unchecked::Hello(header, body) => Checked::Hello(Valid::new(header, body)?),
            Unchecked::State(header, body) => Checked::State(Valid::new(header, body)?),
            Unchecked::Contact(header, body) => Checked::Contact(Valid::new(header, body)?),
            Unchecked::Command(header, body) => Checked::Command(Valid::new(header, body)?),
            Unchecked::Report(header, body) => Checked::Report(Valid::new(header, body)?),
            Unchecked::Simulate(header, body) => Checked::Simulate(Valid::new(header, body)?),
            Unchecked::Needle(header, body) => Checked::Needle(Valid::new(header, body)?),
            Unchecked::Thread(header, body) => Checked::Thread(Valid::new(header, body)?),
            Unchecked::Fixture(header, body) => Checked::Fixture(Valid::new(header, body)?),
            Unchecked::Ping(header, body) => Checked::Ping(Valid::new(header, body)?),
            Unchecked::Pong(header, body) => Checked::Pong(Valid::new(header, body)?),
        })
    }

    fn travels(&self, direction: Direction) -> bool {
        match self {
            // An end that hears its own Hello (a line that echoes) must not answer it: only consoles
            // have a name.
            Unchecked::Hello(_, hello) => {
                let to_host = hello.device_name != [0; 16];
                to_host == (direction == Direction::ToHost)
            }
            _ => self.header().kind.travels(direction),
        }
    }

    fn header(&self) -> &Header {
        match self {
            Unchecked::Hello(header, _)
            | Unchecked::State(header, _)
            | Unchecked::Contact(header, _)
            | Unchecked::Command(header, _)
            | Unchecked::Report(header, _)
            | Unchecked::Simulate(header, _)
            | Unchecked::Needle(header, _)
            | Unchecked::Thread(header, _)
            | Unchecked::Fixture(header, _)
            | Unchecked::Ping(header, _)
            | Unchecked::Pong(header, _) => header,
        }
    }
}

impl Checked {
    /// Header of its frame.
    pub fn header(&self) -> &Header {
        match self {
            Checked::Hello(message) => &message.header,
            Checked::State(message) => &message.header,
            Checked::Contact(message) => &message.header,
            Checked::Command(message) => &message.header,
            Checked::Report(message) => &message.header,
            Checked::Simulate(message) => &message.header,
            Checked::Needle(message) => &message.header,
            Checked::Thread(message) => &message.header,
            Checked::Fixture(message) => &message.header,
            Checked::Ping(message) => &message.header,
            Checked::Pong(message) => &message.header,
        }
    }

    /// Tool of a contact, a needle or a thread; 0 of other messages.
    pub fn tool(&self) -> u8 {
        match self {
            Checked::Contact(contact) => contact.body.tool,
            Checked::Needle(needle) => needle.body.tool,
            Checked::Thread(thread) => thread.body.tool,
            _ => 0,
        }
    }
}

impl Message for Hello {
    const KIND: Kind = Kind::Hello;

    fn check(&self) -> Result<(), Reject> {
        require(self.tick_hz > 0)?;
        name(&self.device_name).map(|_| ())
    }
}

impl Message for State {
    const KIND: Kind = Kind::State;

    /// In a fault any finite value passes: the host must hear of the fault whatever the encoders say.
    fn check(&self) -> Result<(), Reject> {
        let limit = |limit| if self.faults == 0 { limit } else { f32::MAX };
        within(&self.position_m, limit(MAX_POSITION))?;
        within(&self.velocity_m_per_s, limit(MAX_SPEED))?;
        within(&self.force_n, limit(MAX_WRENCH))?;
        within(&self.current_a, limit(MAX_CURRENT))?;
        unit(&self.orientation)
    }
}

impl Message for Contact {
    const KIND: Kind = Kind::Contact;

    fn check(&self) -> Result<(), Reject> {
        require(self.tool < MAX_TOOLS)?;
        within(&self.position_m, MAX_POSITION)?;
        unit(&self.orientation)?;
        within(&self.wrench, MAX_WRENCH)?;
        within(&self.tangent, MAX_TANGENT)?;
        between(self.gap_m, 0.0, MAX_POSITION)?;
        unit(&self.normal)?;
        between(self.relaxation_per_s, 0.0, MAX_RELAXATION)
    }
}

impl Message for Needle {
    const KIND: Kind = Kind::Needle;

    fn check(&self) -> Result<(), Reject> {
        require(self.tool < MAX_TOOLS)?;
        let (linear, angular) = self.slide.split_at(3);
        within(linear, MAX_SLIDE)?;
        within(angular, MAX_CURVATURE)?;
        // On a circle the grip may be anywhere, its middle included.
        if angular.iter().all(|value| *value == 0.0) {
            unit(linear)?;
        }
        within(&[self.axial_n, self.punctured_n], MAX_WRENCH)?;
        for limit in self.friction_n {
            between(limit, 0.0, MAX_WRENCH)?;
        }
        for stiffness in self.stiffness_n_per_m {
            between(stiffness, 0.0, MAX_TANGENT)?;
        }
        between(self.hold_n, 0.0, MAX_WRENCH)?;
        between(self.puncture_n, 0.0, MAX_WRENCH)?;
        check_course(&self.course)
    }
}

/// Points beyond `count` are not used, but no non-finite number gets in anywhere.
fn check_course(course: &Course) -> Result<(), Reject> {
    for [way_m, axial_n] in course.points {
        between(way_m, 0.0, MAX_POSITION)?;
        within(&[axial_n], MAX_WRENCH)?;
    }
    let counted = usize::from(course.forward) + usize::from(course.backward);
    require(counted <= COURSE_POINTS)?;
    let on_the_way = |way: &[[f32; 2]]| way.iter().map(|[way_m, _]| *way_m).is_sorted();
    require(course.ways().into_iter().all(on_the_way))
}

impl Message for Thread {
    const KIND: Kind = Kind::Thread;

    fn check(&self) -> Result<(), Reject> {
        require(self.tool < MAX_TOOLS)?;
        unit(&self.direction)?;
        between(self.tension_n, 0.0, MAX_WRENCH)?;
        between(self.stiffness_n_per_m, 0.0, MAX_TANGENT)?;
        let is_slack = self.state == Tension::Slack;
        between(self.slack_m, 0.0, if is_slack { MAX_POSITION } else { 0.0 })?;
        require(!is_slack || self.tension_n == 0.0)
    }
}

impl Message for Fixture {
    const KIND: Kind = Kind::Fixture;

    fn check(&self) -> Result<(), Reject> {
        let (place, stiffness, damping) = match self {
            Fixture::None => return Ok(()),
            Fixture::Wall {
                point_m,
                normal,
                stiffness_n_per_m,
                damping_n_s_per_m,
            } => {
                unit(normal)?;
                (point_m, stiffness_n_per_m, damping_n_s_per_m)
            }
            Fixture::Coupling {
                anchor_m,
                stiffness_n_per_m,
                damping_n_s_per_m,
            } => (anchor_m, stiffness_n_per_m, damping_n_s_per_m),
        };
        within(place, MAX_POSITION)?;
        between(*stiffness, 0.0, MAX_TANGENT)?;
        between(*damping, 0.0, MAX_HAND_DAMPING)
    }
}

impl Message for Command {
    const KIND: Kind = Kind::Command;

    fn check(&self) -> Result<(), Reject> {
        match self {
            Command::StateEvery { ticks } => require((1..=MAX_STATE_EVERY).contains(ticks)),
            Command::Arm | Command::Disarm | Command::ClearFault => Ok(()),
        }
    }
}

impl Message for Ping {
    const KIND: Kind = Kind::Ping;

    fn check(&self) -> Result<(), Reject> {
        Ok(())
    }
}

impl Message for Pong {
    const KIND: Kind = Kind::Pong;

    fn check(&self) -> Result<(), Reject> {
        Ok(())
    }
}

impl Message for Report {
    const KIND: Kind = Kind::Report;

    fn check(&self) -> Result<(), Reject> {
        Ok(())
    }
}

impl Message for Simulate {
    const KIND: Kind = Kind::Simulate;

    fn check(&self) -> Result<(), Reject> {
        match self {
            Simulate::Device(device) => check_device(device),
            Simulate::Hand(script) => check_hand(script),
            Simulate::EmergencyStop(_) | Simulate::EncoderOffset(_) => Ok(()),
        }
    }
}

fn check_device(device: &DeviceDescription) -> Result<(), Reject> {
    name(&device.name)?;
    match device.kinematics {
        Kinematics::Cartesian { origin_m } => within(&origin_m, MAX_POSITION)?,
        Kinematics::SerialArm {
            shoulder_m,
            upper_m,
            fore_m,
        } => {
            within(&shoulder_m, MAX_POSITION)?;
            within(&[upper_m, fore_m], MAX_POSITION)?;
        }
    }
    for joint in &device.joints {
        // Destructured, so that a new field cannot be forgotten here.
        let Joint {
            counts_per_unit,
            zero_counts: _,
            effort_per_amp,
            max_current_a,
            max_slew_per_s,
            max_speed_per_s,
            inertia,
            damping,
            coulomb,
        } = *joint;
        let numbers = [
            counts_per_unit,
            effort_per_amp,
            max_current_a,
            max_slew_per_s,
            max_speed_per_s,
            inertia,
            damping,
            coulomb,
        ];
        within(&numbers, MAX_DEVICE_NUMBER)?;
    }
    within(&device.gravity_mass_kg, MAX_DEVICE_NUMBER)?;
    let limits = [
        device.max_force_n,
        device.max_power_w,
        device.max_grip_speed_m_per_s,
    ];
    within(&limits, MAX_DEVICE_NUMBER)
}

fn check_hand(script: &HandScript) -> Result<(), Reject> {
    between(script.stiffness_n_per_m, 0.0, MAX_HAND_STIFFNESS)?;
    between(script.damping_n_s_per_m, 0.0, MAX_HAND_DAMPING)?;
    within(&script.start_joint, MAX_POSITION)?;
    let count = usize::from(script.count);
    require((1..=WAY_POINTS).contains(&count))?;
    // Way points beyond `count` are not used, but no non-finite number gets in anywhere.
    for WayPoint { time_s, position_m } in &script.way_points {
        between(*time_s, 0.0, MAX_SCRIPT_TIME)?;
        within(position_m, MAX_POSITION)?;
    }
    let used = script.way_points.iter().take(count);
    require(used.map(|point| point.time_s).is_sorted())
}

/// Text of a zero-padded name.
///
/// # Errors
/// [`Reject::Name`] if it is not UTF-8, goes on after a zero, or has control characters (it is printed
/// on terminals).
pub fn name(bytes: &[u8; 16]) -> Result<&str, Reject> {
    let text = core::str::from_utf8(bytes).map_err(|_| Reject::Name)?;
    let text = text.trim_end_matches('\0');
    if text.chars().any(char::is_control) {
        return Err(Reject::Name);
    }
    Ok(text)
}

pub(super) fn require(ok: bool) -> Result<(), Reject> {
    if ok { Ok(()) } else { Err(Reject::Range) }
}

pub(super) fn between(value: f32, low: f32, high: f32) -> Result<(), Reject> {
    if !value.is_finite() {
        return Err(Reject::NotFinite);
    }
    require(low <= value && value <= high)
}

/// Every value finite and of magnitude at most `limit`.
pub(super) fn within(values: &[f32], limit: f32) -> Result<(), Reject> {
    values
        .iter()
        .try_for_each(|value| between(*value, -limit, limit))
}

/// Unit length to [`UNIT_TOLERANCE`].
fn unit(values: &[f32]) -> Result<(), Reject> {
    within(values, 1.0 + UNIT_TOLERANCE)?;
    let square: f32 = values.iter().map(|value| value * value).sum();
    between(square, 1.0 - UNIT_TOLERANCE, 1.0 + UNIT_TOLERANCE)
}
