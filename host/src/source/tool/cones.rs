//! What a console solves of a tool's contact by itself: few cones in place of many.
//!
//! Entry points: [`Cones::gather`], [`Cones::load`], then [`Cones::write`]. Where more vertices touch than there is room
//! for, neighbours share one cone: each bears the part of its force that it bears now, so that the normal force and the
//! limit of friction stay what they are, and W, J become `B'WB`, `B'J`. Those that press least, which let go first, and those
//! that come have normals of their own; their tangents are with the nearest cone's, whose coefficient is so much larger. What
//! that takes from the tangent, and what turns, is in M.

use super::{Contact, Load, ToolContacts, TouchingTools, Turning};
use crate::anchors::{ConstraintSet, ConstraintSystem};
use crate::step::{MAX_TOOL_ROWS, ToolRowKind, ToolRows};
use nalgebra::{Matrix2, Matrix3, Matrix3x2, Matrix6, Vector2, Vector3};
use sutura_factor::Lu;

/// Rows of a cone.
const AXES: usize = 3;

/// Arms of friction that are shorter by more than this part than those of what it is of are not made longer.
const MOST_FARTHER: f64 = 0.5;

/// Part of its elastic stretch by which a cone has slipped when it no longer sticks across its way.
const SLIPPED: f64 = 0.1;

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

/// A contact, and its parts of what is sent.
#[derive(Clone, Copy, Debug)]
struct Member {
    contact: Contact,
    /// Of the touches, the one whose normal has its normal, and the cone whose tangents have its tangents, if any do; and
    /// its shares of their ways.
    touch: usize,
    normal_share: f64,
    cone: Option<usize>,
    share: f64,
    /// From the nearest of the cones' first ones, squared \[1e-12 m^2\].
    apart: f64,
    /// The cone's first tangent in the frame of the contact's: cosine and sine.
    turn: Vector2<f64>,
}

/// What is sent as one contact: a cone, or a normal alone.
#[derive(Clone, Copy, Debug)]
struct Touch {
    /// Its firmest member.
    lead: Contact,
    /// Its first row, and how many it has.
    row: usize,
    axes: usize,
    /// Normal forces of those whose tangents it has, over those whose normals it has: at least 1.
    bears: f64,
}

/// Scratch.
pub(crate) struct Cones {
    members: Vec<Member>,
    touches: Vec<Touch>,
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
    slip: Vec<f64>,
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
            touches: Vec::with_capacity(m),
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
            slip: vec![0.0; m],
            matrix: vec![0.0; m * m],
            rhs: vec![0.0; 6 * m],
            lu: Lu::new(m),
            turned: Load::new(most_rows, most_contacts),
        }
    }

    /// Takes the contacts of `tool`, those that press first, into at most `most` rows. Whether there are any.
    pub fn gather(
        &mut self,
        state: &ToolContacts,
        (tool, smooth): (u32, bool),
        most: usize,
    ) -> bool {
        self.axes = if smooth { 1 } else { AXES };
        self.members.clear();
        self.touches.clear();
        self.keep.clear();
        let own = state.contacts.iter().filter(|contact| contact.tool == tool);
        self.members.extend(own.map(|contact| Member {
            contact: *contact,
            touch: 0,
            normal_share: 1.0,
            cone: None,
            share: 0.0,
            apart: f64::MAX,
            turn: Vector2::x(),
        }));
        self.sort();
        let pressing = self.members.iter().take_while(|member| member.presses());
        let pressing = pressing.count();
        let coming = self.members.len() - pressing;
        let plan = Plan::of(pressing, coming, most, self.axes);
        self.members.truncate(pressing + plan.coming);
        self.share(plan.core, plan.cones);
        self.single(pressing, &plan);
        for member in &self.members {
            let row = member.contact.row as usize;
            self.keep.extend(row..row + self.axes);
        }
        !self.members.is_empty()
    }

    /// The firmest first, then the nearest.
    fn sort(&mut self) {
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
    }

    /// Gives the first `count` members to so many cones: each to the nearest of those that are farthest apart.
    fn share(&mut self, count: usize, cones: usize) {
        let core = &mut self.members[..count];
        let mut seeds = [0; MAX_TOOL_ROWS];
        for cone in 1..cones {
            let last = core[seeds[cone - 1]].contact.at_m;
            for member in core.iter_mut() {
                let square = (last - member.contact.at_m).norm_squared();
                let way = in_units(square, ALIKE_SQUARE_M2);
                member.apart = member.apart.min(way);
            }
            let farthest = (0..count).max_by(|a, b| core[*a].apart.total_cmp(&core[*b].apart));
            seeds[cone] = farthest.unwrap_or(0);
        }
        for (cone, seed) in seeds.iter().take(cones).enumerate() {
            self.touches.extend(core.get(*seed).map(|member| Touch {
                lead: member.contact,
                row: self.axes * cone,
                axes: self.axes,
                bears: 1.0,
            }));
        }
    }

    /// Members beside the core have normals of their own; tangents of all that presses are shared by the cones.
    fn single(&mut self, pressing: usize, plan: &Plan) {
        let has_cone = pressing..pressing + plan.coming_cones;
        let cones = self.touches.len();
        let (mut own, mut all) = ([0.0; MAX_TOOL_ROWS], [0.0; MAX_TOOL_ROWS]);
        for (place, member) in self.members.iter_mut().enumerate() {
            let near = self.touches[..cones].iter().enumerate();
            let nearest = near.min_by(|(_, a), (_, b)| {
                let way = |touch: &Touch| {
                    let square = (touch.lead.at_m - member.contact.at_m).norm_squared();
                    in_units(square, ALIKE_SQUARE_M2)
                };
                way(a).total_cmp(&way(b))
            });
            if let Some((cone, touch)) = nearest.filter(|_| place < pressing) {
                all[cone] += member.contact.lambda_n[0];
                member.cone = (self.axes > 1).then_some(cone);
                let [_, a, b] = member.contact.frame();
                let flat = Vector2::new(a.dot(&touch.lead.tangent), b.dot(&touch.lead.tangent));
                member.turn = flat.try_normalize(1e-6).unwrap_or_else(Vector2::x);
                if place < plan.core {
                    own[cone] += member.contact.lambda_n[0];
                    member.touch = cone;
                    continue;
                }
            }
            member.touch = self.touches.len();
            let row = self.touches.last().map_or(0, |last| last.row + last.axes);
            self.touches.push(Touch {
                lead: member.contact,
                row,
                axes: if has_cone.contains(&place) {
                    self.axes
                } else {
                    1
                },
                bears: 1.0,
            });
            if has_cone.contains(&place) {
                member.cone = Some(member.touch);
                member.share = 1.0;
            }
        }
        for (place, member) in self.members[..pressing].iter_mut().enumerate() {
            let lambda_n = member.contact.lambda_n[0];
            if place < plan.core {
                member.normal_share = lambda_n / own[member.touch];
            }
            member.share = member.cone.map_or(0.0, |cone| lambda_n / all[cone]);
        }
        for (touch, (own, all)) in self.touches[..cones].iter_mut().zip(own.iter().zip(all)) {
            touch.bears = all / own;
        }
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
        let m = self.count();
        self.merge(m);
        self.spread(m);
        let each = &tools.each[tool as usize];
        let held = tangent - self.follows(m);
        let held = self.without_friction(held);
        *out = ToolRows::NONE;
        out.count = m;
        for touch in &self.touches {
            let (row, lead) = (touch.row, &touch.lead);
            let friction = if lead.sticks {
                each.tool.static_friction.max(each.tool.friction)
            } else {
                each.tool.friction
            };
            out.kind[row] = if touch.axes == 1 {
                ToolRowKind::Smooth
            } else {
                let friction = friction * touch.bears;
                ToolRowKind::Normal { friction }
            };
            if lead.lambda_n[0] <= 0.0 {
                out.delta_m[row] = lead.gap_m;
            }
            for row in row..row + touch.axes {
                out.id[row] = lead.node;
                if row > touch.row {
                    out.kind[row] = ToolRowKind::Tangent;
                    out.slip_m[row] = self.slip[row];
                }
                out.lambda_n[row] = self.lambda[row];
                for pose in 0..6 {
                    out.jacobian[row][pose] = self.j[m * pose + row];
                }
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
        self.touches.last().map_or(0, |last| last.row + last.axes)
    }

    /// W, J and forces of the touches, and how far they have slipped.
    fn merge(&mut self, m: usize) {
        let (k, axes) = (self.keep.len(), self.axes);
        self.shared[..k * m].fill(0.0);
        self.j[..6 * m].fill(0.0);
        self.w[..m * m].fill(0.0);
        self.lambda[..m].fill(0.0);
        self.slip[..m].fill(0.0);
        for (place, member) in self.members.iter().enumerate() {
            let slip = member.contact.slip_m();
            for part in member.parts(place, axes, &self.touches) {
                let column = &self.compliance[k * part.own..k * (part.own + 1)];
                let out = &mut self.shared[k * part.row..k * (part.row + 1)];
                for (out, w) in out.iter_mut().zip(column) {
                    *out += part.way * w;
                }
                for pose in 0..6 {
                    self.j[m * pose + part.row] +=
                        part.way * self.kept_jacobian[k * pose + part.own];
                }
                self.slip[part.row] += part.way * slip[part.own % axes];
                // All of the force, and its share of the way.
                self.lambda[part.row] += part.force * member.contact.lambda_n[part.own % axes];
            }
        }
        for (place, member) in self.members.iter().enumerate() {
            for part in member.parts(place, axes, &self.touches) {
                for column in 0..m {
                    self.w[m * column + part.row] += part.way * self.shared[k * column + part.own];
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
        let cones = self.touches.iter().filter(|touch| touch.axes == AXES);
        let of_cones = cones.clone().map(|touch| {
            let row = touch.row;
            let way = moved(&self.j, row + 1).hypot(moved(&self.j, row + 2));
            touch.bears * self.lambda[row] * way
        });
        let farther = whole / of_cones.sum::<f64>() - 1.0;
        // Less is left where members lie about one and the same middle.
        if !(farther > 0.0 && farther < MOST_FARTHER) {
            return;
        }
        for row in cones.flat_map(|touch| touch.row + 1..touch.row + AXES) {
            let turn = axis * (farther * moved(&self.j, row));
            for pose in 0..3 {
                self.j[m * (3 + pose) + row] += turn[pose];
            }
        }
    }

    /// Derivative of the wrench by the pose for these cones as they stick, slip or are open now. A cone that slips gives way along its friction;
    /// across that it sticks as long as it has hardly slipped, and turns then.
    fn follows(&mut self, m: usize) -> Matrix6<f64> {
        if m == 0 {
            return Matrix6::zeros();
        }
        let matrix = &mut self.matrix[..m * m];
        matrix.copy_from_slice(&self.w[..m * m]);
        self.rhs[..6 * m].copy_from_slice(&self.j[..6 * m]);
        for touch in &self.touches {
            let (first, open) = (touch.row, touch.lead.lambda_n[0] <= 0.0);
            let rows = first..first + touch.axes;
            if open {
                for row in rows {
                    (0..m).for_each(|column| matrix[m * column + row] = 0.0);
                    (0..6).for_each(|pose| self.rhs[m * pose + row] = 0.0);
                    matrix[m * row + row] = 1.0;
                }
                continue;
            }
            if touch.axes == 1 || !touch.lead.slips {
                continue;
            }
            let (a, b) = (first + 1, first + 2);
            let friction = Vector2::new(self.lambda[a], self.lambda[b]);
            let part = friction.norm() / self.lambda[first];
            let along = friction.try_normalize(0.0).unwrap_or_else(Vector2::x);
            let [_, x, y] = touch.lead.slip_m();
            let stretch_m = 0.5 * (self.w[m * a + a] + self.w[m * b + b]) * friction.norm();
            let sticks_across = x.hypot(y) < SLIPPED * stretch_m;
            // The second row is the one across, the first one the law of what slips.
            for column in 0..m {
                let own = &mut matrix[m * column..m * (column + 1)];
                own[b] = along.x * own[b] - along.y * own[a];
                own[a] = 0.0;
            }
            for pose in 0..6 {
                let own = &mut self.rhs[m * pose..m * (pose + 1)];
                own[b] = along.x * own[b] - along.y * own[a];
                own[a] = 0.0;
            }
            matrix[m * a + a] = along.x;
            matrix[m * b + a] = along.y;
            matrix[m * first + a] = -part;
            if !sticks_across {
                (0..m).for_each(|column| matrix[m * column + b] = 0.0);
                (0..6).for_each(|pose| self.rhs[m * pose + b] = 0.0);
                (matrix[m * a + b], matrix[m * b + b]) = (-along.y, along.x);
            }
        }
        self.solve(m)
    }

    /// `held` without the stiffness that holds a tool back across its normal: turning normals of a convex tool make none. It is of contacts
    /// that stick beside what their cones have, and would hold however far the tool goes.
    fn without_friction(&self, mut held: Matrix6<f64>) -> Matrix6<f64> {
        let pressing = self.members.iter().filter(|member| member.presses());
        let along: Vector3<f64> = pressing
            .map(|member| member.contact.normal * member.contact.lambda_n[0])
            .sum();
        let Some(normal) = along.try_normalize(0.0).filter(|_| self.axes == AXES) else {
            return held;
        };
        let aside = if normal.x.abs() < normal.y.abs() {
            Vector3::x()
        } else {
            Vector3::y()
        };
        let first = normal.cross(&aside).normalize();
        let axes = Matrix3x2::from_columns(&[first, normal.cross(&first)]);
        let shift: Matrix3<f64> = held.fixed_view::<3, 3>(0, 0).into();
        let flat = axes.transpose() * (shift + shift.transpose()) * axes * 0.5;
        let found = flat.symmetric_eigen();
        let holds = Matrix2::from_diagonal(&found.eigenvalues.map(|value| value.min(0.0)));
        let holds = found.eigenvectors * holds * found.eigenvectors.transpose();
        let mut shift = held.fixed_view_mut::<3, 3>(0, 0);
        shift -= axes * holds * axes.transpose();
        held
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

    /// Its rows, in those of the touches; `place` is its own among the members, each of which has `axes` rows.
    fn parts(
        &self,
        place: usize,
        axes: usize,
        touches: &[Touch],
    ) -> impl Iterator<Item = Part> + use<> {
        let own = axes * place;
        let normal = touches.get(self.touch).map(|touch| Part {
            own,
            row: touch.row,
            way: self.normal_share,
            force: 1.0,
        });
        let cone = self.cone.and_then(|cone| touches.get(cone));
        let (row, share, turn) = (cone.map(|cone| cone.row), self.share, self.turn);
        let tangents = [
            (1, 1, turn.x),
            (2, 1, turn.y),
            (1, 2, -turn.y),
            (2, 2, turn.x),
        ];
        let tangents = tangents.into_iter().filter_map(move |(axis, of, turned)| {
            Some(Part {
                own: own + axis,
                row: row? + of,
                way: share * turned,
                force: turned,
            })
        });
        normal.into_iter().chain(tangents)
    }
}

/// A member's row, its place among the kept, in one that is sent: what that has of its way, and of its force.
struct Part {
    own: usize,
    row: usize,
    way: f64,
    force: f64,
}

/// What becomes of those that press, the firmest first, and of those that come, the nearest first.
struct Plan {
    /// So many of those that press share so many cones; the others have normals of their own.
    core: usize,
    cones: usize,
    /// For so many of those that come there is room, the first of them with cones of their own.
    coming: usize,
    coming_cones: usize,
}

impl Plan {
    /// Of what slides over tissue most slips, each vertex in its own direction: few are touched then, and there are many cones.
    /// What is pressed deep touches many, which sticks and lets go one by one: there are many normals.
    fn of(pressing: usize, coming: usize, most: usize, axes: usize) -> Plan {
        if axes == 1 || axes * (pressing + coming) <= most {
            // Those that come have a row each, but what presses goes first.
            let spared = most.saturating_sub(coming.min(most / 4)).max(1);
            let cones = spared.min(pressing);
            let coming = coming.min((most / axes).saturating_sub(cones));
            return Plan {
                core: pressing,
                cones,
                coming,
                coming_cones: if axes == 1 { 0 } else { coming },
            };
        }
        let (many, few) = (most / 4, (most / 6).max(1));
        if pressing < many {
            // Hardly touched yet: what comes has the rest.
            let coming_cones = coming.min(many - pressing);
            let normals = most - axes * (pressing + coming_cones);
            return Plan {
                core: pressing,
                cones: pressing,
                coming: coming.min(coming_cones + normals),
                coming_cones,
            };
        }
        let (cones, spared) = if pressing <= 2 * most / 3 {
            (many.max(1), many.saturating_sub(1))
        } else {
            (few, few)
        };
        let cones = cones.min(pressing);
        let singles = most - axes * cones;
        let coming = coming.min(spared).min(singles);
        let rim = (singles - coming).min(pressing - cones);
        Plan {
            core: pressing - rim,
            cones,
            coming,
            coming_cones: 0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Plan;

    /// A frame made as the first vertex touches tells as much of what comes as one made just before, and no row is left over.
    #[test]
    fn what_has_hardly_touched_leaves_its_rows_to_what_comes() {
        const ROWS: usize = 24;
        let told = |pressing| {
            let plan = Plan::of(pressing, 12, ROWS, 3);
            let cones = plan.cones + plan.coming_cones;
            let normals = pressing - plan.core + plan.coming - plan.coming_cones;
            (pressing + plan.coming, 3 * cones + normals)
        };
        for pressing in 0..6 {
            assert_eq!(told(pressing), (12, ROWS), "{pressing}");
        }
        for pressing in 6..40 {
            let (vertices, rows) = told(pressing);
            assert!(
                vertices > pressing && rows <= ROWS,
                "{pressing}: {vertices}, {rows}"
            );
        }
    }
}
