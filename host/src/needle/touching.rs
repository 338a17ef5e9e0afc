//! Tools that touch, in a balance with needles.

use super::drive::{Drive, NeedleWork, position};
use super::model::Needles;
use crate::source::tool::{Settled, ToolContacts, Turning, Turns};
use crate::step::Status;
use nalgebra::Vector3;

impl Drive<'_> {
    /// After a solve: linearises the contacts of tools anew and takes up what has come to be inside one; whether that
    /// was not needed.
    pub(super) fn settle_tools(&mut self, solves: u32) -> Result<bool, Status> {
        let tools = &self.needles.tools;
        if tools.is_empty() {
            return Ok(true);
        }
        self.find_near_tools(0.0);
        let Self {
            body,
            points_m,
            grasp,
            work,
            ..
        } = self;
        let at = |node: u32| position(body, points_m, grasp, work, node);
        let of_tools = (grasp.lambda(), grasp.modes());
        let settled = self
            .tools
            .settle(tools, of_tools, (&work.near_tools, solves), at);
        self.report.residual = settled.residual;
        self.clock.lap(&mut self.report.stages.detect_ns);
        // Friction may hold what the normals alone do not.
        let turning = self.work.turning.as_ref();
        let unstable = turning.is_some_and(Turning::is_unstable) && tools.are_smooth();
        match settled {
            Settled {
                has_room: false, ..
            } => Err(Status::TooManyRows),
            Settled { is: true, .. } if unstable => Err(Status::NotConverged),
            Settled { is, .. } => Ok(is),
        }
    }

    /// Lists the vertices that tools may come to touch, or that are `more_m` farther.
    pub(super) fn find_near_tools(&mut self, more_m: f64) {
        let Needles {
            tools,
            resting,
            hierarchy,
            ..
        } = self.needles;
        let NeedleWork {
            system,
            pushes,
            slack_m,
            near_tools,
            ..
        } = &mut *self.work;
        let slack_m = &mut slack_m[..hierarchy.groups()];
        system.slack(self.body, self.grasp, pushes, resting, slack_m);
        tools.near(&self.tools.placements, slack_m, more_m, near_tools);
    }

    /// How far a tool that touches is from the nearest vertex \[m\], and the normal there, out of the tissue.
    pub(super) fn tool_apart(&self, tool: u32) -> (f64, Vector3<f64>) {
        let tools = &self.needles.tools;
        let Some(placement) = &self.tools.placements[tool as usize] else {
            return (f64::MAX, Vector3::z());
        };
        if self.tools.count(tool) > 0 {
            return (0.0, Vector3::z());
        }
        let solid = tools.solid(tool as usize, placement);
        let near = self.work.near_tools.iter().filter(|(of, _)| *of == tool);
        let gaps = near.map(|(_, node)| {
            let at = self.position(*node);
            (solid.gap(&at), at)
        });
        let nearest = gaps.min_by(|a, b| a.0.total_cmp(&b.0));
        // What is far away is as good as at rest.
        let nearest = nearest.or_else(|| {
            let near = tools.nearest_at_rest(&solid)?;
            Some((near.gap_m, near.at))
        });
        let touch = nearest.and_then(|(_, at)| solid.touch(&at));
        touch.map_or((f64::MAX, Vector3::z()), |touch| {
            (touch.gap.max(0.0), -touch.normal)
        })
    }

    /// Takes over what tools touch at the balance.
    pub(super) fn finish_tools(&mut self) {
        let tools = &self.needles.tools;
        if tools.is_empty() {
            return;
        }
        let Self {
            body,
            points_m,
            grasp,
            work,
            ..
        } = self;
        let at = |node: u32| position(body, points_m, grasp, work, node);
        let near = (&work.near_tools[..], &work.slack_m[..]);
        self.tools.accept(tools, near, at);
        self.report.friction_j = self.tools.friction_j;
    }
}

/// Has normals turn; whether any does.
pub(super) fn turn(
    needles: &Needles,
    tools: &ToolContacts,
    work: &mut NeedleWork,
    turns: Turns,
) -> bool {
    let NeedleWork {
        system,
        set,
        turning,
        ..
    } = work;
    turning
        .as_mut()
        .is_some_and(|turning| turning.prepare(&needles.tools, tools, turns, system, set))
}
