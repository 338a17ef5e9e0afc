//! Tools that tissue sticks to: which nodes each of them holds, where, and when it lets go.
//!
//! Entry point: [`Sticking`]. A free boundary node that comes to lie inside a tool is taken to the tool's surface and
//! stays at that place of it; one that would have to be pulled is let go: unilateral contact with friction
//! that never slips, by an active set.

use crate::contact::shape::{Solid, Touch};
use crate::mesh::TetMesh;
use crate::source::tool::WALL_M_PER_N;
use crate::tool::{MAX_TOOLS, Placement};
use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};
use serde::Serialize;
use sutura_models::{BoundaryConditions, Tangent};

/// How deep a node must be to be taken, in mean edges: far below what is felt, so that a node that was let go is not
/// taken again by rounding.
const TAKEN_EDGES: f64 = 1e-3;

/// Halvings of a tool's way to the place where it meets a node: of a way of 4 mm all but 1 um.
const HALVINGS: u32 = 12;

/// Where the tools are, and their shapes there.
pub(super) type Tools = [Option<(Placement, Solid)>; MAX_TOOLS];

/// A node that sticks.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) struct Stuck {
    tool: usize,
    /// In the frame of the tool's shape \[m\].
    place: Vector3<f64>,
}

/// A tool's contact.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Touched {
    /// Force on the tool \[N\], and moment about the grip \[N m\].
    pub force: Vector3<f64>,
    pub moment: Vector3<f64>,
    /// Nodes that press.
    pub nodes: u32,
    /// Where the force acts, from the grip: nodes by the size of their force \[m\].
    arm: Vector3<f64>,
    /// Sum of arm times force \[N m\].
    spread: Matrix3<f64>,
}

/// A tool's contact with fixed nodes, each of which gives way by [`WALL_M_PER_N`] along the normal.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Wall {
    /// Force on the tool \[N\] and moment about the grip \[N m\], (6).
    pub wrench: Vector6<f64>,
    /// d wrench / d pose of the grip for left increments, (6 x 6).
    tangent: Matrix6<f64>,
    /// Nodes that press.
    pub nodes: u32,
    /// Elastic energy \[J\].
    pub energy_j: f64,
}

impl Wall {
    /// A node at `arm` from the grip \[m\].
    fn add(&mut self, touch: &Touch, arm: &Vector3<f64>) {
        let force = touch.normal * (touch.gap / WALL_M_PER_N);
        let stiffness = touch.normal * touch.normal.transpose() + touch.curvature * touch.gap;
        let stiffness = stiffness / WALL_M_PER_N;
        let cross = arm.cross_matrix();
        let turned = stiffness * cross - force.cross_matrix();
        self.wrench += stacked(&force, &arm.cross(&force));
        let blocks = [
            (0, 0, -stiffness),
            (0, 3, turned),
            (3, 0, force.cross_matrix() - cross * stiffness),
            (3, 3, cross * turned),
        ];
        for (row, column, block) in blocks {
            let mut own = self.tangent.fixed_view_mut::<3, 3>(row, column);
            own += block;
        }
        self.nodes += 1;
        self.energy_j += 0.5 * touch.gap * touch.gap / WALL_M_PER_N;
    }

    /// Adds its derivative to that of a wrench by rows.
    pub fn add_tangent(&self, rows: &mut [[f64; 6]; 6]) {
        for (row, own) in rows.iter_mut().enumerate() {
            for (column, entry) in own.iter_mut().enumerate() {
                *entry += self.tangent[(row, column)];
            }
        }
    }
}

/// Force and moment as a wrench, (6).
pub(super) fn stacked(a: &Vector3<f64>, b: &Vector3<f64>) -> Vector6<f64> {
    Vector6::new(a.x, a.y, a.z, b.x, b.y, b.z)
}

/// Nodes that tools hold.
#[derive(Clone, Debug)]
pub(super) struct Sticking {
    rest_m: Vec<[f64; 3]>,
    /// Boundary nodes that can be taken, and those that are fixed, (b).
    touchable: Vec<u32>,
    walls: Vec<u32>,
    is_fixed: Vec<bool>,
    taken_m: f64,
    stuck: Vec<Option<Stuck>>,
    before: Vec<Option<Stuck>>,
    held: Vec<(u32, [f64; 3])>,
    /// Of each tool, rows of `held`.
    rows: [Vec<usize>; MAX_TOOLS],
}

impl Sticking {
    /// Nothing touched yet; nodes `fixed` do not move.
    pub fn new(mesh: &TetMesh, fixed: &[u32]) -> Self {
        let (nodes, surface) = (mesh.points_m().len(), mesh.surface());
        let mut is_fixed = vec![false; nodes];
        for node in fixed {
            is_fixed[*node as usize] = true;
        }
        let vertices = surface.vertices.into_iter();
        let (walls, touchable): (Vec<u32>, Vec<u32>) =
            vertices.partition(|node| is_fixed[*node as usize]);
        let room = || Vec::with_capacity(touchable.len());
        Sticking {
            rest_m: mesh.points_m().to_vec(),
            taken_m: TAKEN_EDGES * surface.mean_edge_m,
            stuck: vec![None; nodes],
            before: vec![None; nodes],
            held: Vec::with_capacity(nodes),
            rows: std::array::from_fn(|_| room()),
            touchable,
            walls,
            is_fixed,
        }
    }

    /// What [`Self::go_back`] goes back to.
    pub fn keep(&mut self) {
        self.before.copy_from_slice(&self.stuck);
    }

    /// As at the last [`Self::keep`].
    pub fn go_back(&mut self) {
        self.stuck.copy_from_slice(&self.before);
    }

    /// Free nodes inside tools, which came from `before`, are theirs from now on, at the place where they were met. Says how
    /// many.
    pub fn take(&mut self, before: &Tools, tools: &Tools, positions_m: &[[f64; 3]]) -> usize {
        let mut taken = 0;
        for node in &self.touchable {
            let node = *node as usize;
            if self.stuck[node].is_some() {
                continue;
            }
            let at = Vector3::from(positions_m[node]);
            for (tool, (placement, solid)) in present(tools) {
                if solid.gap(&at) >= -self.taken_m {
                    continue;
                }
                let (placement, solid) = match &before[tool] {
                    Some(before) => met(before, &(*placement, solid.clone()), &at),
                    None => (*placement, solid.clone()),
                };
                if let Some(touch) = solid.touch(&at) {
                    let on_surface = at - touch.normal * touch.gap;
                    let place = placement.rotation.inverse() * (on_surface - placement.centre);
                    self.stuck[node] = Some(Stuck { tool, place });
                    taken += 1;
                    break;
                }
            }
        }
        taken
    }

    /// Where fixed and stuck nodes go with the tools there.
    pub fn lay_out(&mut self, tools: &Tools) {
        self.held.clear();
        self.rows.iter_mut().for_each(Vec::clear);
        for (node, rest) in self.rest_m.iter().enumerate() {
            if self.is_fixed[node] {
                self.held.push((node as u32, [0.0; 3]));
                continue;
            }
            let Some(Stuck { tool, place }) = self.stuck[node] else {
                continue;
            };
            let Some((placement, _)) = &tools[tool] else {
                self.stuck[node] = None;
                continue;
            };
            let at = placement.centre + placement.rotation * place;
            self.rows[tool].push(self.held.len());
            self.held
                .push((node as u32, (at - Vector3::from(*rest)).into()));
        }
    }

    /// What was laid out last, with these loads \[N\].
    pub fn drive<'a>(&'a self, force_n: &'a [[f64; 3]]) -> BoundaryConditions<'a> {
        BoundaryConditions {
            held: &self.held,
            force_n,
        }
    }

    /// Lets go of nodes whose reaction pulls at the tool. Says how many.
    pub fn let_go(&mut self, tools: &Tools, reactions_n: &[[f64; 3]]) -> usize {
        let mut gone = 0;
        for (tool, (_, solid)) in present(tools) {
            for row in &self.rows[tool] {
                let (Some((node, moved)), Some(force)) =
                    (self.held.get(*row), reactions_n.get(*row))
                else {
                    continue;
                };
                let node = *node as usize;
                let at = Vector3::from(self.rest_m[node]) + Vector3::from(*moved);
                let pulls = solid
                    .touch(&at)
                    .is_none_or(|touch| touch.normal.dot(&Vector3::from(*force)) < 0.0);
                if pulls && self.stuck[node].take().is_some() {
                    gone += 1;
                }
            }
        }
        gone
    }

    /// Rows of the drive whose nodes press on a tool, in `into`.
    pub fn pressing(&self, tool: usize, into: &mut Vec<usize>) {
        into.clear();
        let rows = self.rows[tool].iter().copied();
        into.extend(rows.filter(|row| self.stuck[self.held[*row].0 as usize].is_some()));
    }

    /// Node of a row of the drive.
    pub fn node(&self, row: usize) -> Option<u32> {
        self.held.get(row).map(|(node, _)| *node)
    }

    /// Whether a tool holds any node in what was laid out last.
    pub fn held(&self, tool: usize) -> bool {
        self.rows.get(tool).is_some_and(|rows| !rows.is_empty())
    }

    /// What a tool with its grip there feels of these rows of the drive.
    pub fn touched(
        &self,
        rows: &[usize],
        reactions_n: &[[f64; 3]],
        grip: &Vector3<f64>,
    ) -> Touched {
        let mut touched = Touched {
            force: Vector3::zeros(),
            moment: Vector3::zeros(),
            nodes: rows.len() as u32,
            arm: Vector3::zeros(),
            spread: Matrix3::zeros(),
        };
        let mut size = 0.0;
        for row in rows {
            let (Some((node, moved)), Some(reaction)) =
                (self.held.get(*row), reactions_n.get(*row))
            else {
                continue;
            };
            let force = -Vector3::from(*reaction);
            let arm = Vector3::from(self.rest_m[*node as usize]) + Vector3::from(*moved) - grip;
            touched.force += force;
            touched.moment += arm.cross(&force);
            touched.spread += arm * force.transpose();
            touched.arm += arm * force.norm();
            size += force.norm();
        }
        if size > 0.0 {
            touched.arm /= size;
        }
        touched
    }

    /// Distance from a tool's shape to the nearest boundary node \[m\], and the normal there, out of the tissue; nothing where
    /// there is no normal.
    pub fn apart(
        &self,
        solid: &Solid,
        positions_m: &[[f64; 3]],
    ) -> Option<(f64, Vector3<f64>, u32)> {
        let gaps = self.touchable.iter().chain(&self.walls).map(|node| {
            let at = Vector3::from(positions_m[*node as usize]);
            (solid.gap(&at), *node)
        });
        let (gap, node) = gaps.min_by(|a, b| a.0.total_cmp(&b.0))?;
        let touch = solid.touch(&positions_m[node as usize].into())?;
        Some((gap, -touch.normal, node))
    }

    /// Returns the wrench of fixed nodes on a tool with its grip there.
    pub fn wall(&self, solid: &Solid, grip: &Vector3<f64>) -> Wall {
        let mut wall = Wall::default();
        for node in &self.walls {
            let at = Vector3::from(self.rest_m[*node as usize]);
            let touch = solid.touch(&at).filter(|touch| touch.gap < 0.0);
            if let Some(touch) = touch {
                wall.add(&touch, &(at - grip));
            }
        }
        wall
    }

    /// Nodes that a tool would meet if it went `depth_m` deeper than where it first touches, at `gap_m`, in `into`: each with
    /// the part of that way on which it is met.
    pub fn to_come(
        &self,
        solid: &Solid,
        positions_m: &[[f64; 3]],
        (gap_m, depth_m): (f64, f64),
        into: &mut Vec<(u32, f64)>,
    ) {
        into.clear();
        let met = self.touchable.iter().filter_map(|node| {
            let gap = solid.gap(&positions_m[*node as usize].into());
            let part = 1.0 - (gap - gap_m) / depth_m;
            // A ball meets a half-space within half of the height at which it would cut it (Hertz 1881).
            (part > 0.5).then_some((*node, part.min(1.0)))
        });
        into.extend(met);
    }

    /// All that evolves, by node.
    pub fn state(&self) -> &[Option<Stuck>] {
        &self.stuck
    }
}

/// Where a tool is on its way when it meets a point that does not move; at the end of the way, if the point was inside
/// already.
fn met(
    from: &(Placement, Solid),
    to: &(Placement, Solid),
    point: &Vector3<f64>,
) -> (Placement, Solid) {
    if from.1.gap(point) <= 0.0 {
        return to.clone();
    }
    let (mut outside, mut inside) = (0.0, 1.0);
    for _ in 0..HALVINGS {
        let part = 0.5 * (outside + inside);
        if from.1.towards(&to.1, part).gap(point) > 0.0 {
            outside = part;
        } else {
            inside = part;
        }
    }
    (from.0.towards(&to.0, inside), from.1.towards(&to.1, inside))
}

/// Tools that are somewhere.
pub(super) fn present(tools: &Tools) -> impl Iterator<Item = (usize, &(Placement, Solid))> {
    let each = tools.iter().enumerate();
    each.filter_map(|(index, tool)| Some((index, tool.as_ref()?)))
}

impl Touched {
    /// Of a touch to come at a place from the grip \[m\]: nothing yet.
    pub fn to_come(at: &Vector3<f64>) -> Self {
        Touched {
            force: Vector3::zeros(),
            moment: Vector3::zeros(),
            nodes: 0,
            arm: *at,
            spread: Matrix3::zeros(),
        }
    }

    /// d wrench / d pose of the grip by rows, for left increments: the nodes' summed stiffness at the place where the force
    /// acts. Its skew part is -1/2 \[moment\]x in the rotations.
    pub fn tangent(&self, stiffness: &Tangent) -> [[f64; 6]; 6] {
        let k = Matrix3::from(stiffness.stiffness_n_per_m).transpose();
        let k = 0.5 * (k + k.transpose());
        // The place moves by `dx - arm x dtheta`.
        let cross = self.arm.cross_matrix();
        let coupling = k * cross;
        let turning = self.spread - Matrix3::from_diagonal_element(self.spread.trace());
        let rotations = cross * coupling + turning;
        std::array::from_fn(|row| {
            std::array::from_fn(|column| match (row < 3, column < 3) {
                (true, true) => -k[(row, column)],
                (true, false) => coupling[(row, column - 3)],
                (false, true) => coupling[(column, row - 3)],
                (false, false) => rotations[(row - 3, column - 3)],
            })
        })
    }
}
