//! Message bodies. Each derives its size on the wire and its schema; fixed arrays and bounded lists only.

use super::list::List;
use crate::device::{DeviceDescription, JOINTS};
use postcard::experimental::max_size::MaxSize;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Opens a session; the console answers with a `Hello` of its own.
///
/// The host sends `session` = 0 and a random `nonce`. The console echoes the nonce and gives the
/// session number that every later frame must carry.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, MaxSize, Schema)]
pub struct Hello {
    /// Hash over the schemas of all messages; a difference refuses torque.
    pub schema_hash: u64,
    /// Chosen by the host, echoed by the console.
    pub nonce: u32,
    /// Given by the console; 0 in the host's `Hello`.
    pub session: u32,
    /// Control rate of the console \[Hz\]; the rate the host expects, in the host's `Hello`.
    pub tick_hz: u16,
    /// Largest frame that the sender accepts \[bytes\].
    pub max_frame: u16,
    /// Whether the console simulates its motors and hand; false in the host's `Hello`.
    pub simulated: bool,
    /// Name of the device in UTF-8, zero padded; zeros in the host's `Hello`.
    pub device_name: [u8; 16],
    /// Why the console gives no session; `None` if it does, and in the host's `Hello`.
    pub refusal: Refusal,
}

/// Why a console gives a host no session.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, MaxSize, Schema)]
#[repr(u8)]
pub enum Refusal {
    /// It gives one; or the host is of another version, and all that is sure is the header.
    None = 0,
    /// The host's messages have another layout.
    Schema = 1,
    /// The host expects another control rate.
    TickRate = 2,
    /// The host cannot take the largest frame.
    FrameSize = 3,
    /// Another host has a session and uses it.
    Owned = 4,
}

/// Control mode of the console. Torque other than gravity compensation only in `Armed` and `Decaying`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, MaxSize, Schema)]
#[repr(u8)]
pub enum Mode {
    /// Before the first complete tick; amplifiers off.
    Boot = 0,
    /// Amplifiers off.
    Idle = 1,
    /// Rendering contact force.
    Armed = 2,
    /// Contact data is older than its horizon: contact force goes to zero, gravity compensation stays.
    Decaying = 3,
    /// A latched fault; amplifiers off until the host clears it.
    Fault = 4,
}

/// Pose and force of the console at one tick. The header's console time is when the encoders were read.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, MaxSize, Schema)]
pub struct State {
    /// Ticks since boot.
    pub tick: u32,
    /// Grip position \[m\], (3), world frame.
    pub position_m: [f32; 3],
    /// Grip orientation, unit quaternion (x, y, z, w); identity where the console does not sense it.
    pub orientation: [f32; 4],
    /// Grip velocity, estimated \[m/s\], (3).
    pub velocity_m_per_s: [f32; 3],
    /// Contact force commanded on the grip in this tick \[N\], (3), after all guards.
    pub force_n: [f32; 3],
    /// Motor currents commanded in this tick \[A\], (3).
    pub current_a: [f32; JOINTS],
    /// Control mode.
    pub mode: Mode,
    /// Latched faults, bits of [`crate::wire::faults`].
    pub faults: u16,
    /// Sequence of the contact frame in use; 0 before the first.
    pub contact_sequence: u32,
    /// Age of the contact data now \[us\]; `u32::MAX` before the first.
    pub contact_age_us: u32,
    /// Age of the contact data in use when it was first applied \[us\]: the latency of the whole loop.
    pub applied_age_us: u32,
    /// Running hash over every tick's inputs, outputs and internal state since the session began.
    pub trace_hash: u64,
    /// Encoder readings of this tick \[counts\], (3), as the board gave them.
    pub encoder_counts: [i32; JOINTS],
    /// What else the board read, bits of [`crate::wire::inputs`].
    pub inputs: u8,
    /// Sequence of the newest frame of the host, pings and rows apart, that had been applied before this tick, or refused as
    /// too late; 0 before the first. Rows are applied with their contact.
    pub heard_sequence: u32,
}

/// Asks the console for its clock, and keeps the session the sender's.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, MaxSize, Schema)]
pub struct Ping {
    /// The host's monotonic clock when this was sent \[us\].
    pub host_us: u64,
}

/// The console's answer to the newest [`Ping`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, MaxSize, Schema)]
pub struct Pong {
    /// The ping's.
    pub host_us: u64,
    /// Console clock when the ping was taken in \[us\].
    pub received_us: u64,
    /// Console clock when this was sent \[us\].
    pub sent_us: u64,
}

/// The host's latest local contact model. The header's console time is that of the `State` it was solved for.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, MaxSize, Schema)]
pub struct Contact {
    /// Tool that this contact belongs to.
    pub tool: u8,
    /// Grip position that was solved for \[m\], (3).
    pub position_m: [f32; 3],
    /// Grip orientation that was solved for, unit quaternion (x, y, z, w).
    pub orientation: [f32; 4],
    /// Wrench on the tool at that pose: force \[N\], then moment about the grip \[N m\], (6).
    pub wrench: [f32; 6],
    /// Symmetric part of d wrench / d pose, packed upper triangle by rows, (21) of 6 x 6 \[N/m, N, N m/rad\];
    /// the skew part follows from the moment. While `gap_m` > 0: the tangent just after touching.
    pub tangent: [f32; 21],
    /// Distance along `normal` that the tool can still move into the tissue before it touches \[m\]; 0 in contact.
    pub gap_m: f32,
    /// Unit vector out of the tissue, (3); any unit vector while nothing is near.
    pub normal: [f32; 3],
    /// Rate at which the force relaxes at a held pose \[1/s\]; 0 for quasi-static tissue.
    pub relaxation_per_s: f32,
    /// How long after the header's console time this frame may be used \[us\]; the console caps it.
    pub horizon_us: u32,
}

/// Where a needle's tip is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, MaxSize, Schema)]
#[repr(u8)]
pub enum Tip {
    /// In the open, or at a boundary that it does not press on.
    Outside = 0,
    /// Held by a boundary, from outside or from inside, that it has not punctured.
    Holding = 1,
    /// In tissue.
    Inside = 2,
}

/// How tissue and needle move against each other along the needle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, MaxSize, Schema)]
#[repr(u8)]
pub enum Friction {
    /// Somewhere the tissue goes along with the needle; also where no tissue is.
    Sticks = 0,
    /// All of it slides, the tip ahead.
    Forward = 1,
    /// All of it slides, the tip behind.
    Backward = 2,
}

/// Most points of a [`Course`].
pub const COURSE_POINTS: usize = 12;

/// How a needle's axial force goes on as the grip moves along the slide from the pose that was solved for, one way
/// and without turning back: what the host has found by going there beforehand. Straight lines between the points,
/// and from no way and the solved force to the first. Two points at one way: the force jumps, as a boundary gives way
/// there.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, MaxSize, Schema)]
pub struct Course {
    /// How many of `points` are on the way forward; 0 where the host has not looked.
    pub forward: u8,
    /// How many of those that follow are on the way backward.
    pub backward: u8,
    /// Way along the slide \[m\], a magnitude, not decreasing, and the axial force there \[N\], (12 x 2).
    pub points: [[f32; 2]; COURSE_POINTS],
}

impl Course {
    /// The points on the way forward, and on the way backward.
    pub fn ways(&self) -> [&[[f32; 2]]; 2] {
        let forward = usize::from(self.forward).min(COURSE_POINTS);
        let (forward, rest) = self.points.split_at(forward);
        let backward = usize::from(self.backward).min(rest.len());
        [forward, rest.split_at(backward).0]
    }
}

/// What a needle in a tool's grip does along itself: with it a console can go on by itself between two
/// frames of the host. The header's console time is that of the `State` it was solved for; pose and horizon are those
/// of the `Contact` of the same console time. A host sends it before that one.
///
/// Axial means along the slide: a wrench w on the tool has the axial force w . `slide` \[N\], positive
/// when it pulls the needle on, tip first.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, MaxSize, Schema)]
pub struct Needle {
    /// Tool that holds the needle.
    pub tool: u8,
    /// Which of the scene's needles.
    pub needle: u8,
    /// Motion of the grip while the needle slides along itself, tip first, per metre of slide: linear \[1\],
    /// then angular \[1/m\], world frame, (6). Of a straight needle: its direction, and 0.
    pub slide: [f32; 6],
    /// Where the tip is.
    pub tip: Tip,
    /// Whether it sticks.
    pub friction: Friction,
    /// Axial force on the tool at that pose \[N\].
    pub axial_n: f32,
    /// Largest axial force with which friction, and cutting at the tip, withstand a slide forward, and
    /// backward \[N\], (2); magnitudes.
    pub friction_n: [f32; 2],
    /// Axial force on the tool lost per metre of slide: while all of the needle sticks, and with what sticks
    /// now \[N/m\], (2); magnitudes.
    pub stiffness_n_per_m: [f32; 2],
    /// Force with which the tip presses on the boundary that holds it \[N\]; 0 if none does.
    pub hold_n: f32,
    /// Such a force at which that boundary is punctured \[N\]; the largest that the wire carries where none is
    /// enough, 0 if none holds the tip.
    pub puncture_n: f32,
    /// Axial force on the tool at that pose if the boundary did not hold the tip any longer \[N\]: what is
    /// left right after the puncture.
    pub punctured_n: f32,
    /// The axial force on the way.
    pub course: Course,
}

/// An end of a thread.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, MaxSize, Schema)]
#[repr(u8)]
pub enum End {
    /// The one that follows.
    Tail = 0,
    /// The one at the needle.
    Head = 1,
}

/// How a thread does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, MaxSize, Schema)]
#[repr(u8)]
pub enum Tension {
    /// There is more of it than its path needs.
    Slack = 0,
    /// Its path is as long as what there is of it.
    Taut = 1,
    /// It pulls with all that it bears, and its path is longer than what there is of it.
    Strained = 2,
}

/// How a thread pulls at a tool's grip, or how much of it is left before it does: with it a console can go on by
/// itself between two frames of the host. The header's console time is that of the `State` it was solved for; pose and
/// horizon are those of the `Contact` of the same console time. A host sends it before that one.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, MaxSize, Schema)]
pub struct Thread {
    /// Tool that holds it, by itself or by its needle.
    pub tool: u8,
    /// Which of the scene's threads.
    pub thread: u8,
    /// Which of its ends.
    pub end: End,
    /// Whether it pulls.
    pub state: Tension,
    /// Unit vector along which it pulls the grip, (3), world frame; any unit vector while it is slack.
    pub direction: [f32; 3],
    /// Force with which it pulls at that pose \[N\].
    pub tension_n: f32,
    /// Tension gained per metre that the grip moves against `direction` \[N/m\]; while it is slack: as it will be once
    /// it is taut, 0 where that is not known.
    pub stiffness_n_per_m: f32,
    /// Way of the grip against `direction` before it is taut \[m\]; 0 unless it is slack.
    pub slack_m: f32,
}

/// Most rows of one tool.
pub const MAX_ROWS: usize = 24;

/// What a row may do.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, MaxSize, Schema)]
#[repr(u8)]
pub enum RowKind {
    /// Along the normal of a contact without friction.
    Smooth {
        /// Names the contact from frame to frame; of a tool's contacts at most one has it.
        id: u32,
    } = 0,
    /// Along the normal of a contact with friction; its two tangents follow.
    Normal {
        /// As of [`RowKind::Smooth`].
        id: u32,
        /// Coulomb's coefficient, above 0.
        friction: f32,
    } = 1,
    /// Along one of the two orthogonal unit tangents of the [`RowKind::Normal`] before.
    Tangent {
        /// How far the contact has slipped along this row \[m\]: it sticks where `delta` is this.
        anchor_m: f32,
    } = 2,
}

/// A row: 0 <= lambda _|_ delta >= 0 along a normal; |lambda| <= friction lambda_normal along the tangents, where
/// delta stays at the anchor unless that limit is reached, and then drags it along.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, MaxSize, Schema)]
pub struct Row {
    /// What it may do.
    pub kind: RowKind,
    /// delta at the frame's pose with all multipliers 0 \[m\].
    pub delta_free_m: f32,
    /// The host's multiplier \[N\].
    pub lambda_n: f32,
    /// J: d delta / d pose, left increments about the grip, world frame, (6) \[m/m, m/rad\].
    pub jacobian: [f32; 6],
}

impl Default for Row {
    /// One that does nothing.
    fn default() -> Self {
        Row {
            kind: RowKind::Smooth { id: 0 },
            delta_free_m: 0.0,
            lambda_n: 0.0,
            jacobian: [0.0; 6],
        }
    }
}

/// A tool's contact as a small problem of its own, `delta = delta_free + J dx + W lambda`, which a console
/// solves anew at every pose dx from the frame's; the wrench is then that of the `Contact` and
/// `M dx + J' (lambda - lambda_n)`. The header's console time is that of the `State` it was solved for, pose and
/// horizon are those of the `Contact` of the same console time. A host sends it before that one.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, MaxSize, Schema)]
pub struct Rows {
    /// Tool that the rows belong to.
    pub tool: u8,
    /// M: symmetric part of d wrench / d pose with all multipliers held, packed like [`Contact::tangent`],
    /// (21) \[N/m, N, N m/rad\].
    pub held: [f32; 21],
    /// Curvature of the tool where it touches \[1/m\]; 0 of a flat one, or where it differs from row to row.
    pub curvature_per_m: f32,
    /// The rows; those of one contact follow each other.
    pub rows: List<Row, MAX_ROWS>,
    /// W with everything else condensed out, packed upper triangle by rows, (n (n + 1) / 2) \[m/N\].
    pub compliance: List<f32, { MAX_ROWS * (MAX_ROWS + 1) / 2 }>,
}

/// An order to the console.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, MaxSize, Schema)]
#[repr(u8)]
pub enum Command {
    /// Enter `Armed` from `Idle`.
    Arm = 0,
    /// Enter `Idle`.
    Disarm = 1,
    /// Leave `Fault` for `Idle`, if the cause is gone.
    ClearFault = 2,
    /// Send a `State` every so many ticks (1 to 1000).
    StateEvery {
        /// Ticks between two states.
        ticks: u16,
    } = 3,
}

/// Something fixed in space that the console renders by itself, with or without contacts, until it is told of another
/// one, a session opens, or a fault comes. Stiffness and damping are capped at what the device can render stably.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, MaxSize, Schema)]
#[repr(u8)]
pub enum Fixture {
    /// Nothing.
    #[default]
    None = 0,
    /// A wall that pushes and never pulls.
    Wall {
        /// A point of its surface \[m\], (3).
        point_m: [f32; 3],
        /// Unit vector out of it, (3).
        normal: [f32; 3],
        /// \[N/m\].
        stiffness_n_per_m: f32,
        /// \[N s/m\].
        damping_n_s_per_m: f32,
    } = 1,
    /// A spring and a damper that hold the grip at a point.
    Coupling {
        /// The point \[m\], (3).
        anchor_m: [f32; 3],
        /// \[N/m\].
        stiffness_n_per_m: f32,
        /// \[N s/m\].
        damping_n_s_per_m: f32,
    } = 2,
}

/// Counters of the console since boot, sent about once a second.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, MaxSize, Schema)]
pub struct Report {
    /// Control ticks run.
    pub ticks: u32,
    /// Ticks whose computation took longer than their period.
    pub tick_overruns: u32,
    /// Ticks that started more than one period late; they are run, never skipped.
    pub ticks_late: u32,
    /// Valid frames received.
    pub frames_received: u32,
    /// Frames that never came, by gaps in the sequence.
    pub frames_lost: u32,
    /// Frames refused, for any reason.
    pub frames_rejected: u32,
    /// Contact frames replaced by a newer one before a tick used them.
    pub frames_superseded: u32,
    /// Why the last frame was refused: a pinned discriminant of `wire::Reject`; 0 = none was.
    pub last_reject: u8,
    /// Cause of the last reset: 0 unknown, 1 power, 2 pin, 3 software, 4 watchdog, 5 fault handler.
    pub reset_cause: u8,
    /// What the last fault handler left behind: 0 nothing, 1 panic, 2 hard fault, 3 unexpected exception,
    /// 4 watchdog about to bite.
    pub epitaph_kind: u8,
    /// Where it happened: the program counter, or a hash of file and line for a panic; 0 without an epitaph.
    pub epitaph_place: u32,
    /// Stack never used since boot \[bytes\]; 0 where it is not painted.
    pub stack_free_bytes: u32,
    /// Largest cost of one control tick, in the board's unit (cycles, instructions or ns).
    pub tick_cost_max: u32,
}

/// Number of way points of a scripted hand.
pub const WAY_POINTS: usize = 12;

/// One point on the hand's path.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, MaxSize, Schema)]
pub struct WayPoint {
    /// Time since the script began \[s\], not decreasing.
    pub time_s: f32,
    /// Where the hand wants the grip to be \[m\], (3).
    pub position_m: [f32; 3],
}

/// A hand on the grip of a simulated console: spring and damper on a path of minimum-jerk segments.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, MaxSize, Schema)]
pub struct HandScript {
    /// Stiffness \[N/m\].
    pub stiffness_n_per_m: f32,
    /// Damping \[N s/m\].
    pub damping_n_s_per_m: f32,
    /// Joint coordinates at the start \[m or rad\], (3).
    pub start_joint: [f32; JOINTS],
    /// How many of `way_points` count (1 or more); the last is held.
    pub count: u8,
    /// The path, (12).
    pub way_points: [WayPoint; WAY_POINTS],
}

/// Orders to a simulated console; a console with motors rejects them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, MaxSize, Schema)]
#[allow(
    clippy::large_enum_variant,
    reason = "fixed-size wire message, never stored in bulk"
)]
#[repr(u8)]
pub enum Simulate {
    /// Become this device; refused while armed.
    Device(DeviceDescription) = 0,
    /// Start this hand script now.
    Hand(HandScript) = 1,
    /// Press or release the emergency stop.
    EmergencyStop(bool) = 2,
    /// Add an offset to every encoder reading from now on \[counts\].
    EncoderOffset([i32; JOINTS]) = 3,
}
