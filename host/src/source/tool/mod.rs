//! Tools that touch: boundary vertices against convex shapes, with Coulomb friction.
//!
//! Entry points, in the order of a balance: [`ToolContacts::place`], [`ToolContacts::append`] before a solve,
//! [`ToolContacts::settle`] after it until nothing is left to do, [`ToolContacts::accept`] once the balance is found.
//! A touched vertex has one cone: its normal row keeps it outside the shape, by the distance linearised where the last
//! solve left it, and two tangent rows keep it where it sticks on the tool, if that rubs. Friction is plastic flow, integrated
//! backwards (Simo & Hughes 1998, 1.4): what slides sticks from then on where it has come to.

mod accept;
mod cones;
mod inside;
mod load;
mod patches;
mod reach;
mod rows;
mod source;
mod tangent;
mod turning;

pub(crate) use cones::{ALIKE_M, Cones, in_units};
use inside::Sunk;
pub(crate) use inside::{Hardest, Slipped};
pub(crate) use load::Load;
use patches::Patches;
pub(crate) use reach::NEAR;
use rows::Settled;
pub(crate) use source::{ToolSource, ToolWork};
pub(crate) use tangent::Touched;
pub(crate) use turning::{Turning, Turns};

use crate::boxes::{Bounds, Tree};
use crate::contact::shape::Solid;
use crate::marks::Marks;
use crate::tool::{MAX_TOOLS, Placement, Tool};
use nalgebra::{Vector3, Vector6};
use serde::Serialize;
use std::ops::Range;

/// Most contacts at once, of all tools.
pub(crate) const MOST_CONTACTS: usize = 192;

/// Compliance of a contact with a prescribed vertex \[m/N\]: a fiftieth of soft tissue's, and what a console renders without
/// shaking. Without any, several such vertices would say the same of one tool.
pub(crate) const WALL_M_PER_N: f64 = 1e-4;

/// Vertices in a run.
const RUN: usize = 16;

/// Where tools are, by their places among those that touch.
pub(crate) type Placements = [Option<Placement>; MAX_TOOLS];

/// A tool of the model that touches.
#[derive(Clone, Debug)]
pub(crate) struct TouchingTool {
    /// Among the model's tools.
    pub index: usize,
    pub tool: Tool,
    /// It counts as no thinner than this \[m\]: it would slip in between vertices.
    least_m: f64,
}

/// What is constant: the tools, and the vertices that they can touch.
#[derive(Debug)]
pub(crate) struct TouchingTools {
    each: Vec<TouchingTool>,
    /// Boundary nodes: those that can move, ascending, then prescribed ones, ascending, (b).
    nodes: Vec<u32>,
    /// Number of those that can move.
    free: usize,
    /// Where they rest under the loads \[m\], (b).
    resting_m: Vec<Vector3<f64>>,
    /// Their outward normals there, (b).
    normals: Vec<Vector3<f64>>,
    /// In which group of the hierarchy each is, (b).
    group: Vec<u32>,
    /// Places of two of them that are ends of an edge of the surface.
    edges: Vec<[u32; 2]>,
    /// Groups that they are in.
    groups: usize,
    /// Around runs of them, so many one after the other: mesh generators number neighbours one after the other, too, and
    /// what is found run by run is in the order of these lists.
    runs: Tree,
}

/// A vertex that a tool touches.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct Contact {
    /// Among the tools that touch.
    pub tool: u32,
    pub node: u32,
    /// Where on the tool it sticks \[m\], (3), in the frame of its [`Placement`].
    pub local_m: Vector3<f64>,
    /// Whether it stuck at the last balance and has not slipped since: then the static coefficient holds.
    pub sticks: bool,
    /// Where the last solve left it \[m\], (3).
    pub at_m: Vector3<f64>,
    /// Its way there from where the solve before had left it \[m\], (3).
    way_m: Vector3<f64>,
    /// Distance from the tool there \[m\].
    pub gap_m: f64,
    /// Out of the tool, unit vector, (3), and one across it, (3): the frame of its rows.
    pub normal: Vector3<f64>,
    pub tangent: Vector3<f64>,
    /// Multipliers of the last solve \[N\]: along the normal, and across it.
    pub lambda_n: [f64; 3],
    /// Whether it slips.
    pub slips: bool,
    /// At the last balance: by how far the place where it stuck on the tool had run ahead of it \[m\], (3).
    ahead_m: Vector3<f64>,
    /// Force on the tissue at the last balance \[N\], (3).
    before_n: Vector3<f64>,
    /// The first of its rows in the last solve: which solve that was is of no consequence.
    #[serde(skip)]
    pub row: u32,
    /// Whether it has but the first of these: the tool does not rub.
    smooth: bool,
    /// Whether its vertex is prescribed.
    #[serde(skip)]
    pub is_wall: bool,
}

impl Contact {
    /// Directions of its rows: into the tool, and two across.
    pub fn frame(&self) -> [Vector3<f64>; 3] {
        [-self.normal, self.tangent, self.normal.cross(&self.tangent)]
    }

    /// Along its rows, how far it slipped at the last balance \[m\].
    pub fn slip_m(&self) -> [f64; 3] {
        let slip = |direction: Vector3<f64>| direction.dot(&self.ahead_m);
        let slips = if self.slips { 1.0 } else { 0.0 };
        self.frame().map(|direction| slips * slip(direction))
    }

    /// Compliance of its rows beside the tissue's \[m/N\].
    pub fn gives_m_per_n(&self) -> f64 {
        if self.is_wall { WALL_M_PER_N } else { 0.0 }
    }

    /// Elastic part of the way by which the place where it sticks has run ahead of it, across the normal \[m\], (3).
    fn stretch_m(&self) -> Vector3<f64> {
        let force = self.force_n();
        (force - self.normal * self.normal.dot(&force)) * self.gives_m_per_n()
    }

    /// Force of the tool on the tissue \[N\], (3).
    pub fn force_n(&self) -> Vector3<f64> {
        let rows = self.frame().into_iter().zip(self.lambda_n);
        -rows
            .map(|(direction, lambda)| direction * lambda)
            .sum::<Vector3<f64>>()
    }
}

/// What evolves: where the tools are, and what they touch.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct ToolContacts {
    /// Where each tool shall be, by its place among those that touch; `None` for one that is nowhere.
    pub placements: Placements,
    /// Where each was at the last balance.
    before: Placements,
    pub contacts: Vec<Contact>,
    /// Vertices near a tool at the last balance, and where they were \[m\].
    near: Vec<(u32, Vector3<f64>)>,
    /// As far as nodes were from where they rest, by their groups \[m\].
    slack_m: Vec<f64>,
    /// Dissipated by friction so far \[J\].
    pub friction_j: f64,
    /// Largest force on each tool on its way in, and its place.
    #[serde(skip)]
    hardest: [Option<Hardest>; MAX_TOOLS],
    /// Place of each tool that tissue has slipped around, and that has not left it since.
    #[serde(skip)]
    slipped: [Option<Sunk>; MAX_TOOLS],
    /// Middle of each tool at the last place that was clear of the tissue \[m\], (3).
    #[serde(skip)]
    clear: [Option<Vector3<f64>>; MAX_TOOLS],
}

impl TouchingTools {
    /// The tools that have a shape, for a boundary with the nodes `free` and `prescribed`, at `resting_m` (b) \[m\] with the outward
    /// `normals` (b), in `group` (b); ends of the surface's `edges` are mesh nodes.
    pub fn new(
        tools: &[(u8, Tool)],
        least_m: f64,
        (free, prescribed): (&[u32], &[u32]),
        (resting_m, normals): (&[Vector3<f64>], &[Vector3<f64>]),
        group: Vec<u32>,
        edges: impl Iterator<Item = [u32; 2]>,
    ) -> Self {
        let touching = tools
            .iter()
            .enumerate()
            .filter(|(_, (_, tool))| !tool.is_grip());
        let each = touching.map(|(index, (_, tool))| TouchingTool {
            index,
            tool: tool.clone(),
            least_m,
        });
        let mut tools = Self {
            each: each.collect(),
            nodes: [free, prescribed].concat(),
            free: free.len(),
            resting_m: resting_m.to_vec(),
            normals: normals.to_vec(),
            groups: group.iter().max().map_or(0, |last| *last as usize + 1),
            group,
            edges: Vec::new(),
            runs: Tree::new(resting_m.len().div_ceil(RUN) as u32, |run| {
                let own = resting_m.iter().skip(RUN * run as usize).take(RUN);
                own.fold(Bounds::NOTHING, |all, at| all.with(at))
            }),
        };
        let places = |ends: [u32; 2]| {
            let [first, second] = ends.map(|end| tools.place_of_node(end));
            Some([first? as u32, second? as u32])
        };
        tools.edges = edges.filter_map(places).collect();
        tools
    }

    /// No tools.
    pub fn none() -> Self {
        Self::new(
            &[],
            0.0,
            (&[], &[]),
            (&[], &[]),
            Vec::new(),
            std::iter::empty(),
        )
    }

    pub fn each(&self) -> &[TouchingTool] {
        &self.each
    }

    /// Whether a boundary node is prescribed.
    pub fn is_wall(&self, node: u32) -> bool {
        self.nodes[self.free..].binary_search(&node).is_ok()
    }

    /// Place among these of the model's tool `index`.
    pub fn place_of(&self, index: Option<usize>) -> Option<u32> {
        let place = self.each.iter().position(|each| Some(each.index) == index);
        place.map(|place| place as u32)
    }

    /// Where these are, of all the model's tools.
    pub fn targets(&self, all: &Placements) -> Placements {
        let mut own = [None; MAX_TOOLS];
        for (own, each) in own.iter_mut().zip(&self.each) {
            *own = all[each.index];
        }
        own
    }

    /// Place of a node among the vertices that tools can touch.
    fn place_of_node(&self, node: u32) -> Option<usize> {
        let (free, prescribed) = self.nodes.split_at(self.free);
        let among_free = free.binary_search(&node);
        let among_prescribed = || prescribed.binary_search(&node).map(|at| self.free + at);
        among_free.or_else(|_| among_prescribed()).ok()
    }

    /// Outward normal at a vertex at rest, unit vector, (3).
    fn normal_of(&self, node: u32) -> Option<Vector3<f64>> {
        self.place_of_node(node).map(|place| self.normals[place])
    }

    /// Whether none of them rubs.
    pub fn are_smooth(&self) -> bool {
        self.each.iter().all(|each| each.tool.is_smooth())
    }

    pub fn is_empty(&self) -> bool {
        self.each.is_empty()
    }

    /// Most contacts at once.
    pub fn most_contacts(&self) -> usize {
        MOST_CONTACTS.min(self.nodes.len() * self.each.len())
    }

    /// A tool's shape where it is.
    pub fn solid(&self, tool: usize, placement: &Placement) -> Solid {
        let TouchingTool { tool, least_m, .. } = &self.each[tool];
        Solid::new(tool, *least_m, placement)
    }

    /// None of the runs of its vertices.
    pub fn marks(&self) -> Marks {
        Marks::new(self.nodes.len().div_ceil(RUN))
    }

    /// Places of the vertices of a run.
    fn run(&self, run: usize) -> Range<usize> {
        RUN * run..(RUN * (run + 1)).min(self.nodes.len())
    }

    /// Vertices near a tool, each with each.
    pub fn most_pairs(&self) -> usize {
        self.nodes.len() * self.each.len()
    }

    /// Scratch for what consoles solve by themselves, among so many rows, if there are tools.
    pub fn cones(&self, most_rows: usize) -> Option<Cones> {
        (!self.is_empty()).then(|| Cones::new(most_rows, self.most_contacts()))
    }

    /// Scratch for how normals turn among so many rows, if there are tools.
    pub fn turning(&self, most_rows: usize) -> Option<Turning> {
        (!self.is_empty()).then(|| Turning::new(most_rows, self.most_contacts()))
    }
}

impl ToolContacts {
    /// No tool anywhere.
    pub fn new(tools: &TouchingTools) -> Self {
        let most = tools.most_contacts();
        Self {
            placements: [None; MAX_TOOLS],
            before: [None; MAX_TOOLS],
            contacts: Vec::with_capacity(most),
            near: Vec::with_capacity(tools.most_pairs()),
            slack_m: vec![0.0; tools.groups],
            friction_j: 0.0,
            hardest: [None; MAX_TOOLS],
            slipped: [None; MAX_TOOLS],
            clear: [None; MAX_TOOLS],
        }
    }

    /// Whether there is no tool that touches, for traces that are older than these.
    pub fn touch_nothing(&self) -> bool {
        self.contacts.is_empty() && self.placements.iter().all(Option::is_none)
    }

    /// How many vertices a tool touches.
    pub fn count(&self, tool: u32) -> u32 {
        self.contacts
            .iter()
            .filter(|contact| contact.tool == tool)
            .count() as u32
    }

    /// Force on a tool \[N\], and its moment about `grip` \[N m\].
    pub fn wrench(&self, tool: u32, grip: &Vector3<f64>) -> Vector6<f64> {
        let own = self.contacts.iter().filter(|contact| contact.tool == tool);
        let each = own.map(|contact| {
            let force = -contact.force_n();
            let moment = (contact.at_m - grip).cross(&force);
            Vector6::new(force.x, force.y, force.z, moment.x, moment.y, moment.z)
        });
        each.sum()
    }

    /// Whether a tool touches prescribed vertices.
    pub fn touch_walls(&self) -> bool {
        self.contacts.iter().any(|contact| contact.is_wall)
    }

    /// Elastic energy of contacts with prescribed vertices \[J\].
    pub fn stored_j(&self) -> f64 {
        let walls = self.contacts.iter().filter(|contact| contact.is_wall);
        let squares = walls.map(|contact| contact.force_n().norm_squared());
        0.5 * WALL_M_PER_N * squares.sum::<f64>()
    }

    /// As a copy of `other`, without new memory.
    pub fn copy_from(&mut self, other: &Self) {
        self.placements = other.placements;
        self.before = other.before;
        self.contacts.clone_from(&other.contacts);
        self.near.clone_from(&other.near);
        self.slack_m.clone_from(&other.slack_m);
        self.friction_j = other.friction_j;
        self.hardest = other.hardest;
        self.slipped = other.slipped;
        self.clear = other.clear;
    }

    /// Puts the tools where they shall be; one that goes nowhere lets go.
    pub fn place(&mut self, tools: &TouchingTools, placements: &Placements) {
        self.placements = *placements;
        self.contacts.retain_mut(|contact| {
            let placement = placements[contact.tool as usize].as_ref();
            placement.is_some_and(|placement| {
                let solid = tools.solid(contact.tool as usize, placement);
                contact.look(&solid, contact.at_m)
            })
        });
    }
}
