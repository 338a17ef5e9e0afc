//! What a console solves of a tool's contact by itself: few cones in place of many.
//!
//! Entry points: [`Cones::gather`], [`Cones::load`], then [`Cones::write`]. Where more vertices touch than there is room
//! for, neighbours share one cone: each bears the part of its force that it bears now, so that the normal force and the
//! limit of friction stay what they are, and W, J become `B'WB`, `B'J`. What that takes from the tangent, and what turns, is in M.

use super::{Contact, Load, ToolContacts, TouchingTools, Turning};
use crate::anchors::{ConstraintSet, ConstraintSystem};
use crate::dense::Lu;
use crate::step::{MAX_TOOL_ROWS, ToolRowKind, ToolRows};
use nalgebra::{Matrix6, Vector2, Vector3};

/// Rows of a cone.
const AXES: usize = 3;

/// Arms of friction that are shorter by more than this part than those of what it is of are not made longer.
const MOST_FARTHER: f64 = 0.5;

/// Forces as part of the largest one, and squares of ways \[m^2\], that differ by less are the same: where a scene is
/// symmetric what is first is not for a rounding to say.
const ALIKE_FORCE: f64 = 1e-6;
const ALIKE_SQUARE_M2: f64 = 1e-12;
/// The same for gaps \[m\].
pub(crate) const ALIKE_M: f64 = 1e-9;

/// A number counted in a unit, so that what is alike is mostly the same.
pub(crate) fn in_units(x: f64, unit: f64) -> f64 {
    (x / unit).round()
}

/// A contact, and its part of a cone.
#[derive(Clone, Copy, Debug)]
struct Member {
    contact: Contact,
    cone: usize,
    weight: f64,
    /// From the nearest of the cones' first ones, squared \[1e-12 m^2\].
    apart: f64,
    /// The cone's first tangent in the frame of the contact's: cosine and sine.
    turn: Vector2<f64>,
}

/// Scratch.
pub(crate) struct Cones {
    members: Vec<Member>,
    /// Rows of a cone: three, or its normal where the tool does not rub.
    axes: usize,
    /// Rows of the members.
    pub keep: Vec<usize>,
    /// J of all rows, (n x 6), for motions about the grip.
    pub jacobian: Vec<f64>,
    grip: Vector3<f64>,
    /// Of the kept rows: W, (k x k), delta without their forces, (k), and J, (k x 6).
    pub compliance: Vec<f64>,
    pub delta_free: Vec<f64>,
    pub kept_jacobian: Vec<f64>,
    /// W B, (k x m).
    shared: Vec<f64>,
    /// Of the cones: W, (m x m), J, (m x 6), and forces, (m).
    w: Vec<f64>,
    j: Vec<f64>,
    lambda: Vec<f64>,
    matrix: Vec<f64>,
    rhs: Vec<f64>,
    lu: Lu,
    turned: Load,
}

impl Cones {
    /// For so many rows in all, and contacts of a tool.
    pub fn new(most_rows: usize, most_contacts: usize) -> Self {
        let (k, m) = (AXES * most_contacts, MAX_TOOL_ROWS);
        Self {
            members: Vec::with_capacity(most_contacts),
            axes: AXES,
            keep: Vec::with_capacity(k),
            jacobian: vec![0.0; 6 * most_rows],
            grip: Vector3::zeros(),
            compliance: vec![0.0; k * k],
            delta_free: vec![0.0; k],
            kept_jacobian: vec![0.0; 6 * k],
            shared: vec![0.0; k * m],
            w: vec![0.0; m * m],
            j: vec![0.0; 6 * m],
            lambda: vec![0.0; m],
            matrix: vec![0.0; m * m],
            rhs: vec![0.0; 6 * m],
            lu: Lu::new(m),
            turned: Load::new(most_rows, most_contacts),
        }
    }

    /// Takes the contacts of `tool`, those that press first, into at most `most` cones. Whether there are any.
    pub fn gather(
        &mut self,
        state: &ToolContacts,
        (tool, smooth): (u32, bool),
        most: usize,
    ) -> bool {
        self.axes = if smooth { 1 } else { AXES };
        self.members.clear();
        self.keep.clear();
        let own = state.contacts.iter().filter(|contact| contact.tool == tool);
        self.members.extend(own.map(|contact| Member {
            contact: *contact,
            cone: 0,
            weight: 1.0,
            apart: f64::MAX,
            turn: Vector2::x(),
        }));
        let forces = self.members.iter().map(|member| member.contact.lambda_n[0]);
        let unit_n = ALIKE_FORCE * forces.fold(f64::MIN_POSITIVE, f64::max);
        let key = |member: &Member| {
            let Contact {
                lambda_n, gap_m, ..
            } = member.contact;
            // What presses has no gap but a rounding.
            if member.presses() {
                (-in_units(lambda_n[0], unit_n).max(1.0), 0.0)
            } else {
                (0.0, in_units(gap_m, ALIKE_M))
            }
        };
        self.members.sort_unstable_by(|a, b| {
            let ((firm, gap), (other_firm, other_gap)) = (key(a), key(b));
            let firmer = firm.total_cmp(&other_firm);
            firmer
                .then(gap.total_cmp(&other_gap))
                .then(a.contact.node.cmp(&b.contact.node))
        });
        let pressing = self
            .members
            .iter()
            .take_while(|member| member.presses())
            .count();
        let coming = self.members.len() - pressing;
        // Those that come have a cone each, but what presses goes first.
        let spared = most.saturating_sub(coming.min(most / 4)).max(1);
        let cones = self.share(pressing, spared.min(pressing));
        let coming = coming.min(most.saturating_sub(cones));
        self.members.truncate(pressing + coming);
        for (place, member) in self.members[pressing..].iter_mut().enumerate() {
            member.cone = cones + place;
        }
        for member in &self.members {
            let row = member.contact.row as usize;
            self.keep.extend(row..row + self.axes);
        }
        !self.members.is_empty()
    }

    /// Gives the first `count` members to so many cones: each to the nearest of those that are farthest apart.
    fn share(&mut self, count: usize, cones: usize) -> usize {
        let pressing = &mut self.members[..count];
        let mut seeds = [0; MAX_TOOL_ROWS];
        for cone in 1..cones {
            let last = pressing[seeds[cone - 1]].contact.at_m;
            for member in pressing.iter_mut() {
                let square = (last - member.contact.at_m).norm_squared();
                let way = in_units(square, ALIKE_SQUARE_M2);
                member.apart = member.apart.min(way);
            }
            let farthest =
                (0..count).max_by(|a, b| pressing[*a].apart.total_cmp(&pressing[*b].apart));
            seeds[cone] = farthest.unwrap_or(0);
        }
        let leads = seeds.map(|seed| pressing.get(seed).map(|member| member.contact));
        let mut whole = [0.0; MAX_TOOL_ROWS];
        for member in pressing.iter_mut() {
            let near = leads[..cones].iter().flatten().enumerate();
            let nearest = near.min_by(|(_, a), (_, b)| {
                let way = |lead: &Contact| {
                    let square = (lead.at_m - member.contact.at_m).norm_squared();
                    in_units(square, ALIKE_SQUARE_M2)
                };
                way(a).total_cmp(&way(b))
            });
            let Some((cone, lead)) = nearest else {
                continue;
            };
            member.cone = cone;
            whole[cone] += member.contact.lambda_n[0];
            let [_, a, b] = member.contact.frame();
            let flat = Vector2::new(a.dot(&lead.tangent), b.dot(&lead.tangent));
            member.turn = flat.try_normalize(1e-6).unwrap_or_else(Vector2::x);
        }
        for member in pressing {
            member.weight = member.contact.lambda_n[0] / whole[member.cone];
        }
        cones
    }

    /// J of all `n` rows for a motion of the tool about `grip`, what turns by that left out.
    pub fn load(&mut self, n: usize, grip: &Vector3<f64>) {
        self.grip = *grip;
        let jacobian = &mut self.jacobian[..6 * n];
        jacobian.fill(0.0);
        for member in &self.members {
            let arm = member.contact.at_m - grip;
            let frame = member.contact.frame();
            for (axis, direction) in frame.iter().enumerate().take(self.axes) {
                let row = member.contact.row as usize + axis;
                let turn = arm.cross(direction);
                for pose in 0..3 {
                    jacobian[n * pose + row] = direction[pose];
                    jacobian[n * (3 + pose) + row] = turn[pose];
                }
            }
        }
    }

    /// Takes what turns by a motion of `tool` about `grip` off J.
    pub fn turn(
        &mut self,
        turning: &Turning,
        of: (&[Contact], u32),
        grip: &Vector3<f64>,
        (system, set): (&ConstraintSystem, &ConstraintSet),
    ) {
        let jacobian = &mut self.jacobian[..6 * set.count()];
        let curved = |ways: usize| ways > 0;
        self.turned
            .add(turning, of, grip, curved, (system, set), jacobian);
    }

    /// The cones, from what is known of the kept rows, for a tool whose wrench follows its pose by `tangent`.
    pub fn write(
        &mut self,
        tools: &TouchingTools,
        state: &ToolContacts,
        tool: u32,
        tangent: &Matrix6<f64>,
        out: &mut ToolRows,
    ) {
        let m = self.axes * self.count();
        self.merge(m);
        self.spread(m);
        let each = &tools.each[tool as usize];
        let held = tangent - self.follows(m);
        *out = ToolRows::NONE;
        out.count = m;
        let (axes, smooth) = (self.axes, self.axes == 1);
        for i in 0..m {
            let lead = self.members.iter().find(|member| member.cone == i / axes);
            let Some(lead) = lead.map(|member| &member.contact) else {
                continue;
            };
            out.id[i] = lead.node;
            out.kind[i] = match (smooth, i % axes) {
                (true, _) => ToolRowKind::Smooth,
                (false, 0) => ToolRowKind::Normal {
                    friction: if lead.sticks {
                        each.tool.static_friction.max(each.tool.friction)
                    } else {
                        each.tool.friction
                    },
                },
                (false, _) => ToolRowKind::Tangent,
            };
            if i % axes == 0 && lead.lambda_n[0] <= 0.0 {
                out.delta_m[i] = lead.gap_m;
            }
            out.lambda_n[i] = self.lambda[i];
            for pose in 0..6 {
                out.jacobian[i][pose] = self.j[m * pose + i];
            }
        }
        let pairs = (0..out.count).flat_map(|i| (i..out.count).map(move |j| (i, j)));
        for (entry, (i, j)) in out.compliance.iter_mut().zip(pairs) {
            *entry = self.w[m * j + i];
        }
        out.held = ((held + held.transpose()) * 0.5).into();
        if let Some(placement) = &state.placements[tool as usize] {
            out.curvature_per_m = tools.solid(tool as usize, placement).curvature_per_m();
        }
    }

    /// How the wrench of a tool that touches nothing will follow its pose once the vertices with gaps up to `most_gap_m` touch.
    pub fn coming(&mut self, rows: &ToolRows, most_gap_m: f64) -> Matrix6<f64> {
        let normals =
            |i: &usize| rows.kind[*i] != ToolRowKind::Tangent && rows.delta_m[*i] <= most_gap_m;
        let m = (0..rows.count).filter(normals).count();
        if m == 0 {
            return Matrix6::zeros();
        }
        for (place, i) in (0..rows.count).filter(normals).enumerate() {
            for (other, j) in (0..rows.count).filter(normals).enumerate() {
                self.matrix[m * other + place] = rows.compliance_between(i, j);
            }
            for pose in 0..6 {
                self.j[m * pose + place] = rows.jacobian[i][pose];
            }
        }
        self.rhs[..6 * m].copy_from_slice(&self.j[..6 * m]);
        self.solve(m)
    }

    fn count(&self) -> usize {
        self.members
            .iter()
            .map(|member| member.cone + 1)
            .max()
            .unwrap_or(0)
    }

    /// W, J and forces of the cones.
    fn merge(&mut self, m: usize) {
        let (k, axes) = (self.keep.len(), self.axes);
        self.shared[..k * m].fill(0.0);
        self.j[..6 * m].fill(0.0);
        self.w[..m * m].fill(0.0);
        self.lambda[..m].fill(0.0);
        for (place, member) in self.members.iter().enumerate() {
            for (own, cone, turned) in member.parts(place, axes) {
                let part = turned * member.weight;
                let column = &self.compliance[k * own..k * (own + 1)];
                let out = &mut self.shared[k * cone..k * (cone + 1)];
                for (out, w) in out.iter_mut().zip(column) {
                    *out += part * w;
                }
                for pose in 0..6 {
                    self.j[m * pose + cone] += part * self.kept_jacobian[k * pose + own];
                }
                // All of the force, and its share of the way.
                self.lambda[cone] += turned * member.contact.lambda_n[own % axes];
            }
        }
        for (place, member) in self.members.iter().enumerate() {
            for (own, cone, turned) in member.parts(place, axes) {
                let part = turned * member.weight;
                for column in 0..m {
                    self.w[m * column + cone] += part * self.shared[k * column + own];
                }
            }
        }
    }

    /// Has friction of the cones act as far from their middle, on average, as that of their members does: what is in the
    /// middle of some is nearer, and would spin too easily.
    fn spread(&mut self, m: usize) {
        let pressing = self.members.iter().filter(|member| member.presses());
        let pressing = pressing.map(|member| (member, member.contact.lambda_n[0]));
        let (mut force_n, mut moment, mut along) = (0.0, Vector3::zeros(), Vector3::zeros());
        for (member, lambda_n) in pressing.clone() {
            force_n += lambda_n;
            moment += member.contact.at_m * lambda_n;
            along += member.contact.normal * lambda_n;
        }
        let middle = moment / force_n;
        let Some(axis) = along.try_normalize(0.0).filter(|_| self.axes == AXES) else {
            return;
        };
        let whole: f64 = pressing
            .map(|(member, lambda_n)| {
                let arm = member.contact.at_m - middle;
                lambda_n * axis.cross(&arm).norm()
            })
            .sum();
        // How far a unit spin about the middle moves a row.
        let back = axis.cross(&(middle - self.grip));
        let moved = |j: &[f64], row: usize| -> f64 {
            let of = |first: usize| Vector3::from_fn(|pose, _| j[m * (first + pose) + row]);
            of(3).dot(&axis) - of(0).dot(&back)
        };
        let cones = (0..m).step_by(AXES);
        let of_cones = cones.map(|row| {
            let way = moved(&self.j, row + 1).hypot(moved(&self.j, row + 2));
            self.lambda[row] * way
        });
        let farther = whole / of_cones.sum::<f64>() - 1.0;
        // Less is left where members lie about one and the same middle.
        if !(farther > 0.0 && farther < MOST_FARTHER) {
            return;
        }
        for row in (0..m).filter(|row| row % AXES > 0) {
            let turn = axis * (farther * moved(&self.j, row));
            for pose in 0..3 {
                self.j[m * (3 + pose) + row] += turn[pose];
            }
        }
    }

    /// How the wrench follows the pose by these cones as they stick, slip or are open now.
    fn follows(&mut self, m: usize) -> Matrix6<f64> {
        if m == 0 {
            return Matrix6::zeros();
        }
        let matrix = &mut self.matrix[..m * m];
        matrix.copy_from_slice(&self.w[..m * m]);
        self.rhs[..6 * m].copy_from_slice(&self.j[..6 * m]);
        let mut done = 0u32;
        for member in &self.members {
            // Of each its first is its firmest.
            if done & 1 << member.cone != 0 {
                continue;
            }
            done |= 1 << member.cone;
            let first = self.axes * member.cone;
            let open = !member.presses();
            let normal = self.lambda[first];
            for axis in 0..self.axes {
                let row = first + axis;
                if !(open || (axis > 0 && member.contact.slips)) {
                    continue;
                }
                for column in 0..m {
                    matrix[m * column + row] = f64::from(u8::from(column == row));
                }
                for pose in 0..6 {
                    self.rhs[m * pose + row] = 0.0;
                }
                if !open {
                    // What slips keeps its direction.
                    matrix[m * first + row] = -self.lambda[row] / normal;
                }
            }
        }
        self.solve(m)
    }

    /// `-J' A^-1 B` for the matrix A (m x m) and the right-hand sides B (m x 6).
    fn solve(&mut self, m: usize) -> Matrix6<f64> {
        let (matrix, rhs) = (&mut self.matrix[..m * m], &mut self.rhs[..6 * m]);
        self.lu.factor(matrix, m);
        self.lu.solve(matrix, m, rhs, 6);
        Matrix6::from_fn(|i, j| {
            let forces = rhs[m * j..m * (j + 1)].iter();
            let products = forces.zip(&self.j[m * i..m * (i + 1)]).map(|(f, j)| f * j);
            -products.sum::<f64>()
        })
    }
}

impl Member {
    fn presses(&self) -> bool {
        self.contact.lambda_n[0] > 0.0
    }

    /// Its row among the kept, the cone's, and that one's direction in its own; `place` is its own among the members.
    fn parts(
        &self,
        place: usize,
        axes: usize,
    ) -> impl Iterator<Item = (usize, usize, f64)> + use<> {
        let (own, cone) = (axes * place, axes * self.cone);
        let (c, s) = (self.turn.x, self.turn.y);
        [
            (own, cone, 1.0),
            (own + 1, cone + 1, c),
            (own + 2, cone + 1, s),
            (own + 1, cone + 2, -s),
            (own + 2, cone + 2, c),
        ]
        .into_iter()
        .take(if axes == 1 { 1 } else { 5 })
    }
}
