//! What C and Rust hand each other: plain numbers.

use std::ffi::c_char;
use std::time::Duration;
use sutura_client::message::Mode;
use sutura_client::{Contact, Options, Pose};

/// Before the first complete tick; motors off.
pub const SUTURA_BOOT: u32 = 0;
/// Motors off.
pub const SUTURA_IDLE: u32 = 1;
/// Renders contact force.
pub const SUTURA_ARMED: u32 = 2;
/// The contact is older than its horizon: its force goes to zero, gravity compensation stays.
pub const SUTURA_DECAYING: u32 = 3;
/// A latched fault; motors off until sutura_clear_fault.
pub const SUTURA_FAULT: u32 = 4;

/// Nothing.
pub const SUTURA_FIXTURE_NONE: u32 = 0;
/// A wall that pushes and never pulls.
pub const SUTURA_FIXTURE_WALL: u32 = 1;
/// A spring and a damper that hold the grip at a point.
pub const SUTURA_FIXTURE_COUPLING: u32 = 2;

/// What a simulator decides about its session. 0 stands for the default.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default)]
pub struct SuturaOptions {
    /// How long the console may go on with a contact before its force fades [ms], from the pose that it was computed for;
    /// 60 by default, capped at 150 by the console. Three periods of the simulator and the line's delay.
    pub horizon_ms: u32,
    /// Shortest time between two contacts on the line [us]; 0 by default, 10000 for a UART of 115200 baud.
    pub contact_spacing_us: u32,
    /// How long the console may take to answer [ms]; 3000 by default.
    pub answer_within_ms: u32,
}

impl From<&SuturaOptions> for Options {
    fn from(given: &SuturaOptions) -> Self {
        let default = Options::default();
        let or = |ms: u32, default: Duration| match ms {
            0 => default,
            ms => Duration::from_millis(u64::from(ms)),
        };
        Options {
            horizon: or(given.horizon_ms, default.horizon),
            contact_spacing: Duration::from_micros(u64::from(given.contact_spacing_us)),
            answer_within: or(given.answer_within_ms, default.answer_within),
            ..default
        }
    }
}

/// What a console says of itself.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct SuturaInfo {
    /// Name of the device, UTF-8, ends with 0.
    pub name: [c_char; 17],
    /// Control rate [Hz].
    pub tick_hz: u16,
    /// 1 if motors and hand are simulated.
    pub simulated: u8,
}

/// The console at one tick.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default)]
pub struct SuturaPose {
    /// Console time at which the encoders were read [us]; a contact that is sent for this pose ages from here.
    pub time_us: u64,
    /// Ticks since the console booted.
    pub tick: u32,
    /// Grip position [m], world frame.
    pub position_m: [f32; 3],
    /// Grip orientation, unit quaternion (x, y, z, w); identity where the console does not sense it.
    pub orientation: [f32; 4],
    /// Grip velocity [m/s].
    pub velocity_m_per_s: [f32; 3],
    /// Contact force commanded on the grip in this tick [N], after all guards.
    pub force_n: [f32; 3],
    /// SUTURA_BOOT to SUTURA_FAULT.
    pub mode: u32,
    /// Latched faults, bits: 1 emergency stop, 2 not finite, 4 encoder jump, 8 overrun, 16 board, 32 out of reach,
    /// 64 overspeed, 128 time base, 256 amplifier, 512 supply.
    pub faults: u32,
    /// Age of the contact in use [us]; 4294967295 before the first.
    pub contact_age_us: u32,
    /// Its age when it came into use [us]; 4294967295 before the first.
    pub applied_age_us: u32,
    /// Sequence of the frame that brought it; 0 before the first.
    pub contact_sequence: u32,
}

impl From<&Pose> for SuturaPose {
    fn from(pose: &Pose) -> Self {
        SuturaPose {
            time_us: pose.time_us,
            tick: pose.tick,
            position_m: pose.position_m,
            orientation: pose.orientation,
            velocity_m_per_s: pose.velocity_m_per_s,
            force_n: pose.force_n,
            mode: pose.mode as u32,
            faults: u32::from(pose.faults),
            contact_age_us: pose.contact_age_us,
            applied_age_us: pose.applied_age_us,
            contact_sequence: pose.contact_sequence,
        }
    }
}

impl From<&SuturaPose> for Pose {
    fn from(pose: &SuturaPose) -> Self {
        Pose {
            tick: pose.tick,
            time_us: pose.time_us,
            position_m: pose.position_m,
            orientation: pose.orientation,
            velocity_m_per_s: pose.velocity_m_per_s,
            force_n: pose.force_n,
            mode: match pose.mode {
                SUTURA_IDLE => Mode::Idle,
                SUTURA_ARMED => Mode::Armed,
                SUTURA_DECAYING => Mode::Decaying,
                SUTURA_FAULT => Mode::Fault,
                _ => Mode::Boot,
            },
            faults: pose.faults as u16,
            contact_age_us: pose.contact_age_us,
            applied_age_us: pose.applied_age_us,
            contact_sequence: pose.contact_sequence,
        }
    }
}

/// Contact of the grip at one pose. The console goes on from it by itself until the next one.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct SuturaContact {
    /// Force on the grip at that pose [N], world frame.
    pub force_n: [f32; 3],
    /// Moment on the grip about itself [N m]; consoles with three motors render none.
    pub moment_nm: [f32; 3],
    /// d (force, moment) / d (position, rotation vector) [N/m, N, N m/rad], by rows; of a spring that pushes back the
    /// diagonal is negative. While gap_m > 0: just after touching.
    pub tangent: [[f32; 6]; 6],
    /// Way along -normal until the grip touches [m]; 0 in contact.
    pub gap_m: f32,
    /// Unit vector out of what is touched: a force against it is not rendered.
    pub normal: [f32; 3],
    /// Rate at which the force relaxes at a held pose [1/s]; 0 for most.
    pub relaxation_per_s: f32,
}

impl From<&SuturaContact> for Contact {
    fn from(given: &SuturaContact) -> Self {
        Contact {
            force_n: given.force_n,
            moment_nm: given.moment_nm,
            tangent: given.tangent,
            gap_m: given.gap_m,
            normal: given.normal,
            relaxation_per_s: given.relaxation_per_s,
        }
    }
}

/// Something fixed in space that the console renders by itself. Stiffness and damping are capped at what the device can
/// render stably.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct SuturaFixture {
    /// SUTURA_FIXTURE_NONE, _WALL or _COUPLING.
    pub kind: u32,
    /// A point of the wall's surface, or where the coupling holds [m].
    pub point_m: [f32; 3],
    /// Unit vector out of the wall.
    pub normal: [f32; 3],
    /// [N/m].
    pub stiffness_n_per_m: f32,
    /// [N s/m].
    pub damping_n_s_per_m: f32,
}

/// A point on a simulated hand's path.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct SuturaWayPoint {
    /// Time since the hand took hold [s], not decreasing.
    pub time_s: f32,
    /// Where the hand wants the grip to be [m].
    pub position_m: [f32; 3],
}
