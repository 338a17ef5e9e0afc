//! Where the grip is, and how the console does: a [`State`] as a simulator reads it.

use sutura_shared::wire::Valid;
use sutura_shared::wire::faults;
use sutura_shared::wire::message::{Mode, State};

/// The console at one tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Ticks since the console booted.
    pub tick: u32,
    /// Console time at which the encoders were read \[us\]; a contact that is sent for this pose ages from here.
    pub time_us: u64,
    /// Grip position \[m\], (3), world frame.
    pub position_m: [f32; 3],
    /// Grip orientation, unit quaternion (x, y, z, w); identity where the console does not sense it.
    pub orientation: [f32; 4],
    /// Grip velocity \[m/s\], (3).
    pub velocity_m_per_s: [f32; 3],
    /// Contact force commanded on the grip in this tick \[N\], (3), after all guards.
    pub force_n: [f32; 3],
    /// Control mode.
    pub mode: Mode,
    /// Latched faults, bits of [`sutura_shared::wire::faults`].
    pub faults: u16,
    /// Age of the contact in use \[us\]; `u32::MAX` before the first.
    pub contact_age_us: u32,
    /// Its age when it came into use \[us\]; `u32::MAX` before the first.
    pub applied_age_us: u32,
    /// Sequence of the frame that brought it; 0 before the first.
    pub contact_sequence: u32,
}

impl Pose {
    /// Names of the faults that are latched.
    pub fn fault_names(&self) -> impl Iterator<Item = &'static str> {
        faults::names(self.faults)
    }

    /// Whether the console renders force.
    pub fn is_armed(&self) -> bool {
        matches!(self.mode, Mode::Armed | Mode::Decaying)
    }
}

impl From<&Valid<State>> for Pose {
    fn from(state: &Valid<State>) -> Self {
        let time_us = state.console_time_us();
        let state = state.body();
        Pose {
            tick: state.tick,
            time_us,
            position_m: state.position_m,
            orientation: state.orientation,
            velocity_m_per_s: state.velocity_m_per_s,
            force_n: state.force_n,
            mode: state.mode,
            faults: state.faults,
            contact_age_us: state.contact_age_us,
            applied_age_us: state.applied_age_us,
            contact_sequence: state.contact_sequence,
        }
    }
}
