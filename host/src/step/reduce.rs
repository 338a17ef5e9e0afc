//! What tools feel at a balance: their wrenches, and how these follow their poses.
//!
//! Entry point: [`reduce`].

use super::balance::Balance;
use super::options::StepOptions;
use super::report::ToolContact;
use super::tangent::{Moves, TangentWork};
use crate::model::Model;
use crate::tool::ToolSample;
use nalgebra::{Matrix6, Vector3, Vector6};

/// What a tool feels of all sources.
pub(crate) struct Felt {
    /// Which tool, and where its grip is \[m\].
    pub tool: u8,
    pub grip: Vector3<f64>,
    /// Place among the tools that touch, for one that has a shape.
    pub touching: Option<u32>,
    /// Force \[N\] and moment about the grip \[N m\] on it.
    pub wrench: Vector6<f64>,
    /// Rows that it feels.
    pub rows: u32,
    /// How far it is from touching \[m\], and the normal there.
    pub gap_m: f64,
    pub normal: Vector3<f64>,
    /// What the wrench follows the pose by without tissue, (6 x 6).
    pub tangent: Option<Matrix6<f64>>,
    /// Of what it may come to press on: how far that is \[m\], the normal there, and the tangent just after touching.
    pub coming: Option<(f64, Vector3<f64>, Matrix6<f64>)>,
}

impl Felt {
    fn new(model: &Model, balance: &Balance, sample: &ToolSample) -> Self {
        let tool = model.tool(sample.id);
        Self {
            tool: sample.id,
            grip: Vector3::from(sample.position_m),
            touching: balance.sources.tools.place_of(tool.map(|(index, _)| index)),
            wrench: Vector6::zeros(),
            rows: 0,
            gap_m: f64::MAX,
            normal: Vector3::z(),
            tangent: None,
            coming: None,
        }
    }

    /// d wrench / d pose by tissue, and by other bodies: what these add, or, for a tool that feels nothing, will.
    fn with_bodies(&mut self, derivative: Matrix6<f64>) -> Matrix6<f64> {
        if let Some(own) = self.tangent {
            return derivative + own;
        }
        let feels_nothing = self.rows == 0 && self.wrench == Vector6::zeros();
        let Some((gap_m, normal, coming)) = self.coming.filter(|_| feels_nothing) else {
            return derivative;
        };
        (self.gap_m, self.normal) = (gap_m, normal);
        coming
    }

    /// With d wrench / d pose, (6 x 6).
    fn contact(&self, tangent: &Matrix6<f64>) -> ToolContact {
        let force: Vector3<f64> = self.wrench.fixed_rows::<3>(0).into();
        ToolContact {
            id: self.tool,
            wrench: self.wrench.into(),
            tangent: tangent.transpose().into(),
            gap_m: self.gap_m,
            normal: force.try_normalize(1e-12).unwrap_or(self.normal).into(),
            rows: self.rows,
            relaxation_per_s: 0.0,
        }
    }
}

/// One contact for each sample, with a tangent as far as these are asked for, and a report of each source.
pub(super) fn reduce(
    model: &Model,
    balance: &mut Balance,
    samples: &[ToolSample],
    options: &StepOptions,
    tangent: &mut TangentWork,
) {
    balance.work.needles.ahead.clear();
    tangent.factor(balance);
    let tangents = options.tangents.unwrap_or(samples.len());
    for (place, sample) in samples.iter().enumerate() {
        let mut felt = Felt::new(model, balance, sample);
        for source in balance.sources.each() {
            source.feel(balance, &mut felt);
        }
        let derivative = if place < tangents {
            tool_tangent(balance, tangent, &felt)
        } else {
            Matrix6::zeros()
        };
        let derivative = felt.with_bodies(derivative);
        balance.report.contacts_mut(samples.len())[place] = felt.contact(&derivative);
    }
    for source in balance.sources.each() {
        source.report(balance, samples);
    }
    tangent.report_slides(balance, samples);
    let system = &mut balance.work.system;
    let stored = system.stored_j(&balance.state.grasp);
    let potential_j = model
        .body
        .potential_j(balance.state.grasp.motion(), system.body_work());
    let rest = balance.sources.rest.as_ref();
    let stored = stored - rest.map_or(0.0, |rest| rest.stored_j);
    balance.report.stored_energy_j = potential_j.map_or(stored, |potential_j| {
        potential_j - model.resting_potential_j
    });
    if balance.state.tools.touch_walls() {
        balance.report.stored_energy_j += balance.state.tools.stored_j();
    }
    if !balance.sources.pairs.is_empty() {
        balance.report.stored_energy_j += balance.stored_in_pairs_j();
    }
}

/// d wrench / d pose of a tool, (6 x 6).
fn tool_tangent(balance: &Balance, tangent: &mut TangentWork, felt: &Felt) -> Matrix6<f64> {
    let held = |needle: usize| balance.is_held_by(needle, felt.tool);
    let moves = Moves {
        needle: &held,
        tool: felt.touching,
        jaws: balance.sources.jaws_of(felt.tool),
        bar: balance.sources.bar_of(felt.tool),
    };
    let mut derivative =
        tangent.differentiate(balance, &felt.grip, moves, &balance.work.threads.pulls);
    // Without friction what tools feel comes from an energy: symmetric to the last bit, but for what the moment makes.
    if felt.touching.is_some() && balance.sources.are_conservative() {
        let moment: Vector3<f64> = felt.wrench.fixed_rows::<3>(3).into();
        derivative = (derivative + derivative.transpose()) * 0.5;
        let mut corner = derivative.fixed_view_mut::<3, 3>(3, 3);
        corner -= moment.cross_matrix() * 0.5;
    }
    derivative
}
