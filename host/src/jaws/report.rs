//! What a step found about jaws.
//!
//! Entry point: [`JawsReport`].

use super::Pads;
use crate::step::{Balance, Felt};
use nalgebra::{Vector3, Vector6};

/// Force below which a pull has no direction \[N\].
const NO_PULL_N: f64 = 1e-9;

/// What a step found about one pair of jaws.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct JawsReport {
    /// The tool that carries them.
    pub tool: u8,
    /// What their pads do.
    pub pads: Pads,
    /// Points of tissue that they hold.
    pub points: u32,
    /// Their force on the tissue \[N\], (3), world frame.
    pub force_n: [f64; 3],
    /// Its part in the plane of the pads \[N\].
    pub in_plane_n: f64,
    /// The most that this can be \[N\].
    pub limit_n: f64,
    /// How many of the points slipped.
    pub slipping: u32,
    /// Where they are pulled to in that plane, unit vector, (3): away from the pull of the tissue; back to the hinge while nothing
    /// pulls.
    pub away: [f64; 3],
    /// Stiffness against a way there \[N/m\]: if all stuck, and as it is.
    pub stiffness_n_per_m: [f64; 2],
    /// Spent on slips so far \[J\].
    pub friction_j: f64,
}

impl Balance<'_> {
    /// What a tool feels of what its jaws hold.
    pub(super) fn feel_jaws(&mut self, felt: &mut Felt) {
        let parts = &self.sources.jaws;
        for point in &self.work.jaws.points {
            if parts[point.jaws].tool != felt.tool {
                continue;
            }
            let (force, arm) = (point.force_n, point.at_m - felt.grip);
            let moment = arm.cross(&force);
            felt.wrench -= Vector6::new(force.x, force.y, force.z, moment.x, moment.y, moment.z);
            felt.rows += 3;
            felt.gap_m = 0.0;
        }
    }

    /// What a step found about all jaws, but for stiffness.
    pub(super) fn report_jaws(&mut self) {
        let count = self.sources.jaws.len();
        for (index, part) in self.sources.jaws.iter().enumerate() {
            let state = &self.state.jaws[index];
            let own = self
                .work
                .jaws
                .points
                .iter()
                .filter(|point| point.jaws == index);
            let (mut force, mut slipping) = (Vector3::zeros(), 0);
            for point in own {
                force += point.force_n;
                slipping += u32::from(point.slips);
            }
            let turned = state.pose.map(|pose| pose.rotation).unwrap_or_default();
            let [across, axis, _] = part.jaws.frame(&turned);
            let flat = force - across * across.dot(&force);
            self.report.jaws_mut(count)[index] = JawsReport {
                force_n: force.into(),
                in_plane_n: flat.norm(),
                limit_n: part.jaws.limit_n(),
                slipping,
                away: flat.try_normalize(NO_PULL_N).unwrap_or(-axis).into(),
                ..state.report(part)
            };
        }
    }
}
