//! Tools as a source of constraints.
//!
//! Entry point: [`ToolSource`].

use super::{Patches, Settled, Slipped, TouchingTools, Turning, Turns};
use crate::marks::Marks;
use crate::needle::MOST_GROUPS;
use crate::source::{Room, Source};
use crate::step::{Balance, BalanceWork, Felt, Sources, Status};
use nalgebra::Vector3;
use std::ops::Range;

/// Tools that touch.
pub(crate) struct ToolSource;

/// Scratch of all tools.
pub(crate) struct ToolWork {
    /// Rows of the present set, three for each contact.
    pub rows: Range<usize>,
    /// Vertices near these, each with each, and how far those of each group are from where they rest at most \[m\].
    pub near: Vec<(u32, u32)>,
    slack_m: [f64; MOST_GROUPS],
    /// Scratch.
    marks: Marks,
    /// Nodes whose columns will be needed, the nearest first, and as near these are.
    pub next_nodes: Vec<u32>,
    pub next_gaps: Vec<(f64, u32)>,
    /// Tool or body that has slipped into the tissue, after [`Balance::slipped_in`].
    pub slipped: Option<Slipped>,
    pub patches: Patches,
    turning: Option<Turning>,
    /// Whether normals turn in the next solve.
    turns: bool,
}

impl ToolWork {
    /// For so many rows of all sources.
    pub fn new(tools: &TouchingTools, most_rows: usize) -> Self {
        let pairs = tools.most_pairs();
        Self {
            rows: 0..0,
            near: Vec::with_capacity(pairs),
            slack_m: [0.0; MOST_GROUPS],
            marks: tools.marks(),
            next_nodes: Vec::with_capacity(pairs),
            next_gaps: Vec::with_capacity(pairs),
            slipped: None,
            patches: Patches::new(tools),
            turning: tools.turning(most_rows),
            turns: false,
        }
    }

    /// How normals turn in the next solve, if any does.
    pub fn turning(&self) -> Option<&Turning> {
        self.turning.as_ref().filter(|_| self.turns)
    }

    /// The same, for the solve.
    pub fn turning_mut(&mut self) -> Option<&mut Turning> {
        self.turning.as_mut().filter(|_| self.turns)
    }

    /// What [`Balance::turn_normals`] found last.
    pub fn known_turning(&self) -> Option<&Turning> {
        self.turning.as_ref()
    }
}

impl Source for ToolSource {
    /// A row for each vertex that is touched, and two across it where a tool rubs.
    fn room(&self, sources: &Sources) -> Room {
        let contacts = sources.tools.most_contacts();
        let each = if sources.tools.are_smooth() { 1 } else { 3 };
        Room::new(contacts, each * contacts)
    }

    fn append(&self, balance: &mut Balance) {
        let BalanceWork { set, tools, .. } = &mut *balance.work;
        let first = set.rows.len();
        let known = &balance.sources.tools;
        balance.state.tools.append(known, balance.points_m, set);
        tools.rows = first..set.rows.len();
    }

    /// Has normals turn with the vertices.
    fn soften(&self, balance: &mut Balance, _solve: u32) {
        balance.work.tools.turns = balance.turn_normals(Turns::Sliding);
    }

    /// Takes up what has come to be inside a tool.
    fn settle(&self, balance: &mut Balance, solve: u32) -> Result<bool, Status> {
        let tools = &balance.sources.tools;
        if tools.is_empty() {
            return Ok(true);
        }
        balance.find_near_tools(0.0);
        let BalanceWork {
            system,
            nodes,
            tools: work,
            ..
        } = &*balance.work;
        let (body, points_m, grasp) = (balance.body, balance.points_m, &balance.state.grasp);
        let at = |node: u32| nodes.position(node, body, points_m, grasp, system);
        let found = (grasp.lambda(), grasp.modes());
        let settled = balance
            .state
            .tools
            .settle(tools, found, (&work.near, solve), at);
        balance.report.residual = settled.residual;
        balance.clock.lap(&mut balance.report.stages.detect_ns);
        // Friction may hold what the normals alone do not.
        let unstable = work.turning.as_ref().is_some_and(Turning::is_unstable);
        match settled {
            Settled {
                has_room: false, ..
            } => Err(Status::TooManyRows),
            Settled { is: true, .. } if unstable && tools.are_smooth() => Err(Status::NotConverged),
            Settled { is, .. } => Ok(is),
        }
    }

    fn accept(&self, balance: &mut Balance) {
        let tools = &balance.sources.tools;
        if tools.is_empty() {
            return;
        }
        let BalanceWork {
            system,
            nodes,
            tools: work,
            ..
        } = &*balance.work;
        let (body, points_m, grasp) = (balance.body, balance.points_m, &balance.state.grasp);
        let at = |node: u32| nodes.position(node, body, points_m, grasp, system);
        let near = (&work.near[..], &work.slack_m[..]);
        balance.state.tools.accept(tools, near, at);
        balance.report.friction_j = balance.state.tools.friction_j;
    }

    fn feel(&self, balance: &mut Balance, felt: &mut Felt) {
        let Some(tool) = felt.touching else {
            return;
        };
        felt.wrench += balance.state.tools.wrench(tool, &felt.grip);
        felt.rows += balance.state.tools.count(tool);
        (felt.gap_m, felt.normal) = balance.tool_apart(tool);
    }
}

impl Balance<'_> {
    /// Has normals turn in the compliance of the set; whether any does.
    pub(crate) fn turn_normals(&mut self, turns: Turns) -> bool {
        let BalanceWork {
            system, set, tools, ..
        } = &mut *self.work;
        tools.turning.as_mut().is_some_and(|turning| {
            let known = &self.sources.tools;
            turning.prepare(known, &self.state.tools, turns, system, set)
        })
    }

    /// Lists the vertices that tools may come to touch, or that are `more_m` farther.
    pub(crate) fn find_near_tools(&mut self, more_m: f64) {
        let mut slack_m = [0.0; MOST_GROUPS];
        let known = self.slack(&mut slack_m);
        let placements = &self.state.tools.placements;
        let ToolWork { near, marks, .. } = &mut self.work.tools;
        let tools = &self.sources.tools;
        tools.near(placements, known, more_m, marks, near);
        self.work.tools.slack_m = slack_m;
    }

    /// How far a tool that touches is from the nearest vertex \[m\], and the normal there, out of the tissue.
    pub(crate) fn tool_apart(&self, tool: u32) -> (f64, Vector3<f64>) {
        let tools = &self.sources.tools;
        let Some(placement) = &self.state.tools.placements[tool as usize] else {
            return (f64::MAX, Vector3::z());
        };
        if self.state.tools.count(tool) > 0 {
            return (0.0, Vector3::z());
        }
        let solid = tools.solid(tool as usize, placement);
        let near = self.work.tools.near.iter().filter(|(of, _)| *of == tool);
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
}
