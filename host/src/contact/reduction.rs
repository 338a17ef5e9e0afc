//! A tool's rows for the console: a small linear complementarity problem that predicts its wrench near
//! the balance, switches of the touched set included.
//!
//! Entry point: [`Reduction::rows_of`]. Around the balance `d delta = J dq + W d lambda` and
//! `d wrench = M dq + J' d lambda`. With E = K_A - G and Y of `tangent`, and y the load on the touched
//! vertices that stands for a unit multiplier (n itself, or `K_A S n` at a vertex not touched yet),
//! `W = y'E^-1 y` (and what a vertex not touched yields by itself), `J = -n'R - y'E^-1 Y`. All other active
//! rows are condensed out.

use super::active_set::{ContactWork, Row};
use super::newton::{dot, multiply};
use super::shape::Solid;
use super::tangent::{PoseWork, rigid};
use crate::columns::Columns;
use crate::dense::Dense;
use nalgebra::{Matrix6, Vector3};

/// Most rows of one tool that a console is given.
pub const MAX_TOOL_ROWS: usize = 24;

/// Rows of one tool at a balance: `delta = delta_m + J dq + W (lambda - lambda_n)`, and
/// 0 <= lambda _|_ delta >= 0. The wrench changes by `M dq + J' (lambda - lambda_n)`, and its skew part by
/// the moment as in the tangent. While no row switches that is the tangent: with a the rows that touch,
/// its symmetric part is `M - J_a' W_aa^-1 J_a`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ToolRows {
    /// Which tool.
    pub tool: u8,
    /// How many there are. Touching rows come first, the largest multiplier foremost, then the nearest
    /// others.
    pub count: usize,
    /// Whether J and W know that normals turn. Not so where tissue that is held by the forces instead of
    /// the tool would slip, deep in it: there W would not be positive definite. M makes up for it as
    /// long as no row switches.
    pub turning: bool,
    /// What each row may do. The tangents of a cone follow its normal.
    pub kind: [ToolRowKind; MAX_TOOL_ROWS],
    /// The node each row acts on: the same row from step to step.
    pub id: [u32; MAX_TOOL_ROWS],
    /// Gap \[m\]; 0 where it touches.
    pub delta_m: [f64; MAX_TOOL_ROWS],
    /// Multiplier \[N\], 0 where it does not touch.
    pub lambda_n: [f64; MAX_TOOL_ROWS],
    /// d delta / d pose for left increments of the grip, (count x 6) \[m/m, m/rad\]. Minus a row's
    /// normal and its moment arm, and what the turning of the normals adds.
    pub jacobian: [[f64; 6]; MAX_TOOL_ROWS],
    /// W, upper triangle by rows, (count (count + 1) / 2) \[m/N\].
    pub compliance: [f64; MAX_TOOL_ROWS * (MAX_TOOL_ROWS + 1) / 2],
    /// M: symmetric part of d wrench / d pose with all multipliers held, (6 x 6) \[N/m, N, N m/rad\].
    pub held: [[f64; 6]; 6],
    /// Curvature of the tool's surface \[1/m\]: of a sphere; 0 of others.
    pub curvature_per_m: f64,
    /// Of the balance: as the step reports it.
    pub residual: f64,
}

/// What a row of a tool may do.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub enum ToolRowKind {
    /// Along a normal, without friction.
    #[default]
    Smooth,
    /// Along a normal with friction; its two tangents follow.
    Normal {
        /// Coulomb's coefficient.
        friction: f64,
    },
    /// Across the normal before: it sticks where delta is 0.
    Tangent,
}

impl ToolRows {
    pub(crate) const NONE: Self = Self {
        tool: 0,
        count: 0,
        turning: false,
        kind: [ToolRowKind::Smooth; MAX_TOOL_ROWS],
        id: [0; MAX_TOOL_ROWS],
        delta_m: [0.0; MAX_TOOL_ROWS],
        lambda_n: [0.0; MAX_TOOL_ROWS],
        jacobian: [[0.0; 6]; MAX_TOOL_ROWS],
        compliance: [0.0; MAX_TOOL_ROWS * (MAX_TOOL_ROWS + 1) / 2],
        held: [[0.0; 6]; 6],
        curvature_per_m: 0.0,
        residual: 0.0,
    };

    /// W\[i\]\[j\] \[m/N\]; 0 for rows that are not there.
    pub fn compliance_between(&self, i: usize, j: usize) -> f64 {
        let (i, j) = (i.min(j), i.max(j));
        if j >= self.count {
            return 0.0;
        }
        self.compliance[self.count * i - i * i.saturating_sub(1) / 2 - i + j]
    }

    /// Leaves out all but the first `most` rows, which must not touch.
    pub(crate) fn truncate(&mut self, most: usize) {
        if self.count <= most {
            return;
        }
        let whole = *self;
        self.count = most;
        let pairs = (0..most).flat_map(|i| (i..most).map(move |j| (i, j)));
        for (entry, (i, j)) in self.compliance.iter_mut().zip(pairs) {
            *entry = whole.compliance_between(i, j);
        }
    }
}

/// A row of the problem before it is reduced.
#[derive(Clone, Copy)]
struct Candidate {
    vertex: u32,
    /// Among the active rows; `None` where it does not touch.
    row: Option<usize>,
    delta: f64,
    lambda: f64,
    normal: Vector3<f64>,
    /// From the grip, for rows of the tool itself.
    arm: Option<Vector3<f64>>,
}

/// A vertex that does not touch.
#[derive(Clone, Copy)]
struct Nearest {
    vertex: u32,
    /// Now, and the least of now and ahead \[m\].
    gap: f64,
    soonest: f64,
}

/// Buffers of the reduction.
pub(crate) struct Reduction {
    candidates: Vec<Candidate>,
    nearest: Vec<Nearest>,
    /// y, then E^-1 y, (3v x m), and E^-1 Y, (3v x 6).
    loads: Vec<f64>,
    answers: Vec<f64>,
    yields: Vec<f64>,
    /// S n of rows that do not touch, (3v x m).
    moved: Vec<f64>,
    /// W, (m x m), and J, (m x 6).
    compliance: Vec<f64>,
    jacobian: Vec<f64>,
    /// Of the rows condensed out: factor of their W, and its answer to the others, (o x (m + 6)).
    others: Vec<f64>,
    shares: Vec<f64>,
    /// M.
    held: Matrix6<f64>,
}

/// Whose rows, and where to look for those that do not touch yet.
pub(crate) struct Surroundings<'a> {
    /// Index of the tool.
    pub tool: u32,
    /// Where it is held \[m\].
    pub grip: Vector3<f64>,
    pub solid: &'a Solid,
    pub columns: &'a Columns,
    /// Touchable vertices without tools \[m\], (b), and what the tools move them \[m\], (3 b).
    pub resting_m: &'a [Vector3<f64>],
    pub displacement: &'a [f64],
    /// How far the tool will have moved while the rows are in use \[m\].
    pub ahead_m: Vector3<f64>,
    /// Vertices with a larger gap \[m\], now and then, are left out; above 0.
    pub most_gap: f64,
    /// Of more rows the least are condensed out, or left out where they do not touch; at most [`MAX_TOOL_ROWS`].
    pub most_rows: usize,
}

impl Surroundings<'_> {
    fn at(&self, vertex: u32) -> Vector3<f64> {
        let start = 3 * vertex as usize;
        self.resting_m[vertex as usize]
            + Vector3::from_column_slice(&self.displacement[start..start + 3])
    }
}

impl Reduction {
    /// For so many rows, and touchable vertices.
    pub fn new(most_rows: usize, vertices: usize) -> Self {
        let (n, m) = (3 * most_rows, most_rows + MAX_TOOL_ROWS);
        Self {
            candidates: Vec::with_capacity(m),
            nearest: Vec::with_capacity(vertices),
            loads: vec![0.0; n * m],
            answers: vec![0.0; n * m],
            yields: vec![0.0; 6 * n],
            moved: vec![0.0; n * MAX_TOOL_ROWS],
            compliance: vec![0.0; m * m],
            jacobian: vec![0.0; 6 * m],
            others: vec![0.0; m * m],
            shares: vec![0.0; m * (MAX_TOOL_ROWS + 6)],
            held: Matrix6::zeros(),
        }
    }

    /// Rows of a tool at the balance that `contact` and `pose`, differentiated for it, describe. The
    /// ids are numbers of touchable vertices.
    pub fn rows_of(
        &mut self,
        rows: &[Row],
        around: &Surroundings<'_>,
        contact: &mut ContactWork,
        pose: &PoseWork,
        out: &mut ToolRows,
    ) {
        *out = ToolRows::NONE;
        out.residual = contact.residual;
        out.curvature_per_m = around.solid.curvature_per_m();
        let kept = self.choose(rows, around, contact);
        for turning in [true, false] {
            if self
                .respond(around.columns, contact, pose, turning)
                .is_none()
                || self.condense_out(kept, contact).is_none()
            {
                continue;
            }
            out.turning = turning;
            self.write(kept, out);
            if !turning {
                let rows = self.candidates[..kept].iter();
                let touching = rows.take_while(|row| row.row.is_some()).count();
                let dense = &mut contact.newton.dense;
                out.held = (pose.symmetric - self.held_by(out, touching, dense)).into();
            }
            return;
        }
    }

    /// Lists the rows to be kept, then those to be condensed out; how many are kept.
    fn choose(&mut self, rows: &[Row], around: &Surroundings<'_>, contact: &ContactWork) -> usize {
        let newton = &contact.newton;
        self.candidates.clear();
        for (index, (row, geometry)) in rows.iter().zip(&newton.geometry).enumerate() {
            let arm = newton.touched[geometry.place].at - around.grip;
            self.candidates.push(Candidate {
                vertex: row.vertex,
                row: Some(index),
                delta: 0.0,
                lambda: geometry.lambda,
                normal: geometry.normal,
                arm: (row.tool == around.tool).then_some(arm),
            });
        }
        // Own rows by force, then the other tools'; equal ones by vertex, for the same order every time.
        self.candidates.sort_unstable_by(|a, b| {
            let own = b.arm.is_some().cmp(&a.arm.is_some());
            own.then(b.lambda.total_cmp(&a.lambda))
                .then(a.vertex.cmp(&b.vertex))
        });
        let own = self
            .candidates
            .iter()
            .take_while(|row| row.arm.is_some())
            .count();
        self.find_nearest(rows, around);
        // A third of the room for what comes to touch, if there is so much.
        let coming = self.nearest.len().min(around.most_rows / 3);
        let touching = own.min(around.most_rows - coming);
        self.put_first(touching, own, around);
        let mut kept = touching;
        self.nearest.truncate(around.most_rows - touching);
        // The next to touch first.
        self.nearest.sort_unstable_by(|a, b| {
            let nearer = a.gap.total_cmp(&b.gap);
            nearer.then(a.vertex.cmp(&b.vertex))
        });
        for near in &self.nearest {
            let at = around.at(near.vertex);
            if let Some(touch) = around.solid.touch(&at) {
                let free = Candidate {
                    vertex: near.vertex,
                    row: None,
                    delta: touch.gap.max(0.0),
                    lambda: 0.0,
                    normal: touch.normal,
                    arm: Some(at - around.grip),
                };
                self.candidates.insert(kept, free);
                kept += 1;
            }
        }
        kept
    }

    /// Lists the vertices that do not touch and are near, or soon will be, the soonest first.
    fn find_nearest(&mut self, rows: &[Row], around: &Surroundings<'_>) {
        let ahead = around.solid.moved(&around.ahead_m);
        self.nearest.clear();
        let vertices = 0..around.resting_m.len() as u32;
        for vertex in vertices.take_while(|_| around.most_rows > 0) {
            let at = around.at(vertex);
            let gap = around.solid.gap(&at);
            let soonest = gap.min(ahead.gap(&at));
            let touches = |row: &Row| row.vertex == vertex && row.tool == around.tool;
            if soonest <= around.most_gap && around.columns.has(vertex) && !rows.iter().any(touches)
            {
                let near = Nearest {
                    vertex,
                    gap,
                    soonest,
                };
                self.nearest.push(near);
            }
        }
        self.nearest.sort_unstable_by(|a, b| {
            let sooner = a.soonest.total_cmp(&b.soonest);
            sooner.then(a.vertex.cmp(&b.vertex))
        });
    }

    /// Of `own` rows that touch, puts those first that will let go soonest: the others are deep in contact, where they
    /// are as good condensed. Both parts stay sorted by force.
    fn put_first(&mut self, kept: usize, own: usize, around: &Surroundings<'_>) {
        let strongest = self.candidates.first().map_or(0.0, |row| row.lambda);
        if kept == own || strongest <= 0.0 {
            return;
        }
        let ahead = around.solid.moved(&around.ahead_m);
        let firmness = |row: &Candidate| {
            let left_m = row.arm.map_or(0.0, |arm| ahead.gap(&(around.grip + arm)));
            row.lambda / strongest - left_m / around.most_gap
        };
        let own = &mut self.candidates[..own];
        own.sort_unstable_by(|a, b| {
            let looser = firmness(a).total_cmp(&firmness(b));
            looser.then(a.vertex.cmp(&b.vertex))
        });
        let (first, others) = own.split_at_mut(kept);
        for part in [first, others] {
            part.sort_unstable_by(|a, b| {
                b.lambda.total_cmp(&a.lambda).then(a.vertex.cmp(&b.vertex))
            });
        }
    }

    /// W and J of all listed rows, with normals that turn or with E = K_A; `None` if E is not positive
    /// definite.
    fn respond(
        &mut self,
        columns: &Columns,
        contact: &mut ContactWork,
        pose: &PoseWork,
        turning: bool,
    ) -> Option<()> {
        let newton = &mut contact.newton;
        let (n, m) = (newton.unknowns(), self.candidates.len());
        self.loads[..n * m].fill(0.0);
        let mut free = 0;
        for (i, candidate) in self.candidates.iter().enumerate() {
            let load = &mut self.loads[n * i..n * (i + 1)];
            if let Some(row) = candidate.row {
                let place = 3 * newton.geometry[row].place;
                load[place..place + 3].copy_from_slice(candidate.normal.as_slice());
                continue;
            }
            let moved = &mut self.moved[n * free..n * (free + 1)];
            free += 1;
            for (place, touched) in newton.touched.iter().enumerate() {
                let u = columns.block(touched.vertex, candidate.vertex) * candidate.normal;
                moved[3 * place..3 * place + 3].copy_from_slice(u.as_slice());
            }
            multiply(&newton.stiffness[..n * n], moved, load);
        }
        if n > 0 {
            let tissue = &mut newton.compliance[..n * n];
            tissue.copy_from_slice(&newton.stiffness[..n * n]);
            let bends = newton.touched.iter().filter(|_| turning);
            for (place, touched) in bends.enumerate() {
                for (i, j) in (0..9).map(|entry| (entry / 3, entry % 3)) {
                    tissue[n * (3 * place + j) + 3 * place + i] -= touched.turning[(i, j)];
                }
            }
            newton.dense.factor(tissue, n).ok()?;
            self.answers[..n * m].copy_from_slice(&self.loads[..n * m]);
            newton.dense.solve(tissue, n, &mut self.answers[..n * m], m);
            if turning {
                self.yields[..6 * n].copy_from_slice(&pose.turned[..6 * n]);
            } else {
                self.yields[..6 * n].fill(0.0);
            }
            newton.dense.solve(tissue, n, &mut self.yields[..6 * n], 6);
        }
        self.held = pose.held;
        for (i, j) in (0..36).map(|entry| (entry / 6, entry % 6)) {
            let (turned, yields) = (&pose.turned[n * i..], &self.yields[n * j..]);
            self.held[(i, j)] += dot(&turned[..n], &yields[..n]);
        }
        let mut free = 0;
        for (j, column) in self.candidates.iter().enumerate() {
            let answer = &self.answers[n * j..n * (j + 1)];
            for (i, row) in self.candidates.iter().enumerate() {
                let load = &self.loads[n * i..n * (i + 1)];
                let mut compliance = dot(load, answer);
                if row.row.is_none() && column.row.is_none() {
                    // What the untouched vertices yield with the touched ones held.
                    let block = columns.block(row.vertex, column.vertex);
                    compliance += row.normal.dot(&(block * column.normal));
                    compliance -= dot(load, &self.moved[n * free..n * (free + 1)]);
                }
                self.compliance[m * j + i] = compliance;
            }
            if column.row.is_none() {
                free += 1;
            }
            let own = column
                .arm
                .map(|arm| rigid(&arm).transpose() * column.normal);
            let load = &self.loads[n * j..n * (j + 1)];
            for axis in 0..6 {
                let yields = dot(load, &self.yields[n * axis..n * (axis + 1)]);
                self.jacobian[m * axis + j] = -yields - own.map_or(0.0, |own| own[axis]);
            }
        }
        Some(())
    }

    /// Leaves in the first `kept` rows of W and J what they are with all others active.
    fn condense_out(&mut self, kept: usize, contact: &mut ContactWork) -> Option<()> {
        let m = self.candidates.len();
        let out = m - kept;
        if out == 0 {
            return Some(());
        }
        let dense = &mut contact.newton.dense;
        for j in 0..out {
            let column = &self.compliance[m * (kept + j) + kept..m * (kept + j + 1)];
            self.others[out * j..out * (j + 1)].copy_from_slice(column);
        }
        dense.factor(&mut self.others[..out * out], out).ok()?;
        let columns = kept + 6;
        for j in 0..columns {
            let whole = if j < kept {
                &self.compliance[m * j..m * (j + 1)]
            } else {
                &self.jacobian[m * (j - kept)..m * (j - kept + 1)]
            };
            self.shares[out * j..out * (j + 1)].copy_from_slice(&whole[kept..]);
        }
        let shares = &mut self.shares[..out * columns];
        dense.solve(&self.others[..out * out], out, shares, columns);
        for (i, j) in (0..36).map(|entry| (entry / 6, entry % 6)) {
            let jacobian = &self.jacobian[m * i + kept..m * (i + 1)];
            self.held[(i, j)] -= dot(jacobian, &shares[out * (kept + j)..out * (kept + j + 1)]);
        }
        for i in 0..kept {
            // W is symmetric: its column i holds row i.
            let (first, others) = self.compliance[m * i..m * (i + 1)].split_at_mut(kept);
            for axis in 0..6 {
                let share = &shares[out * (kept + axis)..out * (kept + axis + 1)];
                self.jacobian[m * axis + i] -= dot(others, share);
            }
            for (j, entry) in first.iter_mut().enumerate() {
                *entry -= dot(others, &shares[out * j..out * (j + 1)]);
            }
        }
        Some(())
    }

    /// d wrench / d pose of a tool that touches nothing, just after the rows with gaps up to `most_gap`
    /// will have come to touch.
    pub fn coming(&mut self, rows: &ToolRows, most_gap: f64, dense: &mut Dense) -> Matrix6<f64> {
        let near = rows.delta_m[..rows.count].iter();
        let m = near.take_while(|delta| **delta <= most_gap).count();
        self.held_by(rows, m, dense)
    }

    /// -J' W^-1 J over the first `m` rows.
    fn held_by(&mut self, rows: &ToolRows, m: usize, dense: &mut Dense) -> Matrix6<f64> {
        for (i, j) in (0..m * m).map(|entry| (entry % m, entry / m)) {
            self.others[m * j + i] = rows.compliance_between(i, j);
        }
        let mut tangent = Matrix6::zeros();
        if m == 0 || dense.factor(&mut self.others[..m * m], m).is_err() {
            return tangent;
        }
        let shares = &mut self.shares[..6 * m];
        for (axis, share) in shares.chunks_exact_mut(m).enumerate() {
            for (entry, jacobian) in share.iter_mut().zip(&rows.jacobian) {
                *entry = jacobian[axis];
            }
        }
        dense.solve(&self.others[..m * m], m, shares, 6);
        for (j, share) in shares.chunks_exact(m).enumerate() {
            for (jacobian, share) in rows.jacobian.iter().zip(share) {
                for i in 0..6 {
                    tangent[(i, j)] -= jacobian[i] * share;
                }
            }
        }
        tangent
    }

    fn write(&self, kept: usize, out: &mut ToolRows) {
        let m = self.candidates.len();
        out.count = kept;
        out.held = ((self.held + self.held.transpose()) * 0.5).into();
        let mut packed = 0;
        for (i, row) in self.candidates[..kept].iter().enumerate() {
            out.id[i] = row.vertex;
            out.delta_m[i] = row.delta;
            out.lambda_n[i] = row.lambda;
            for axis in 0..6 {
                out.jacobian[i][axis] = self.jacobian[m * axis + i];
            }
            for j in i..kept {
                let both = self.compliance[m * i + j] + self.compliance[m * j + i];
                out.compliance[packed] = 0.5 * both;
                packed += 1;
            }
        }
    }
}
