//! Joint coordinates and velocities from encoder counts, and whether an encoder can be believed.
//!
//! Entry point: [`Encoders::read`].

use super::TICK_S;
use crate::device::{DeviceDescription, JOINTS};

/// Weight of the newest difference in the velocity: 1 - exp(-2 pi f T) for a first-order low pass of
/// f = 100 Hz. It lags by 1.1 ms on a ramp. A hand moves below 10 Hz, and one count of the encoder shows
/// as at most this share of a count per tick.
pub const VELOCITY_GAIN: f32 = 0.466_510_4;

/// What the encoders say in one tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Joints {
    /// Coordinates \[m or rad\], (3).
    pub position: [f32; JOINTS],
    /// Filtered velocities \[m/s or rad/s\], (3).
    pub velocity: [f32; JOINTS],
    /// Whether a joint moved faster than the device can.
    pub jumped: bool,
}

/// One joint: constants from the description, then what evolves.
#[derive(Clone, Copy, Debug)]
struct Encoder {
    /// Reading at coordinate 0 \[counts\].
    zero_counts: i32,
    /// \[unit per count\].
    unit_per_count: f32,
    /// Largest believable change in one tick \[counts\].
    max_counts: u32,
    /// Filtered velocity \[unit/s\].
    velocity: f32,
}

/// The encoders of a console.
#[derive(Clone, Copy, Debug)]
pub(super) struct Encoders {
    joints: [Encoder; JOINTS],
    /// Counts of the last tick; none at the start.
    previous: Option<[i32; JOINTS]>,
}

impl Encoders {
    pub fn new(device: &DeviceDescription) -> Self {
        let joints = device.joints.map(|joint| Encoder {
            zero_counts: joint.zero_counts,
            unit_per_count: 1.0 / joint.counts_per_unit,
            // One more for the quantisation.
            max_counts: (joint.max_speed_per_s * TICK_S * joint.counts_per_unit.abs()) as u32 + 1,
            velocity: 0.0,
        });
        Encoders {
            joints,
            previous: None,
        }
    }

    /// Forgets where the joints were: the next reading is believed as it is, at velocity 0.
    pub fn restart(&mut self) {
        self.previous = None;
        for joint in &mut self.joints {
            joint.velocity = 0.0;
        }
    }

    /// Whether there has been a reading since the start.
    pub fn have_started(&self) -> bool {
        self.previous.is_some()
    }

    /// Takes this tick's counts. After a jump the velocity starts again from 0.
    pub fn read(&mut self, counts: &[i32; JOINTS]) -> Joints {
        let previous = self.previous.unwrap_or(*counts);
        let mut position = [0.0; JOINTS];
        let mut jumped = false;
        let steps = counts.iter().zip(&previous);
        for ((joint, (now, before)), q) in self.joints.iter_mut().zip(steps).zip(&mut position) {
            *q = now.wrapping_sub(joint.zero_counts) as f32 * joint.unit_per_count;
            let moved = now.wrapping_sub(*before);
            jumped |= moved.unsigned_abs() > joint.max_counts;
            let velocity = moved as f32 * joint.unit_per_count * (1.0 / TICK_S);
            joint.velocity += VELOCITY_GAIN * (velocity - joint.velocity);
        }
        if jumped {
            self.restart();
        }
        self.previous = Some(*counts);
        Joints {
            position,
            velocity: self.joints.map(|joint| joint.velocity),
            jumped,
        }
    }
}
