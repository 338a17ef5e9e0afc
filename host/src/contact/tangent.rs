//! What the console needs of a balance: each tool's wrench and its exact derivative by the pose.
//!
//! Entry points: [`wrench`], [`PoseWork::differentiate`]. The grip moves by dq = (dx, dtheta), left
//! increments; a point r from it follows by `R dq`, `R = [I, -[r]x]`, and a normal n by dtheta x n. With
//! E = K_A - G (see `newton`), and over the rows of this tool `Rh = sum n* n' R` (n* the duals),
//! `P dq = sum lambda dtheta x n` and `Y = sum lambda H R - P`, the touched vertices move by
//! `du = Rh dq + T a`, `T'E T a = -T'(E Rh + Y) dq`, and the wrench by
//! `-Rh'E Rh - Rh'Y - Y'Rh + C - Z + B'(T'E T)^-1 B`, `B = T'(E Rh + Y)`,
//! `C = sum lambda R'H R - R'P - P'R`, `Z = blockdiag(0, sum [lambda n]x [r]x)`. All but Z is symmetric; the
//! skew part of -Z is -1/2 \[moment\]x.

use super::active_set::{ContactWork, Row};
use super::newton::{dot, multiply};
use nalgebra::{Matrix3, Matrix3x6, Matrix6, Vector3, Vector6};

/// Derivatives by one tool's pose, and buffers for them.
pub(crate) struct PoseWork {
    /// Rh, then E Rh + Y, (3v x 6).
    moved: Vec<f64>,
    pushed: Vec<f64>,
    /// Y, (3v x 6): what a motion of the pose takes from the balance at the touched vertices, as far as
    /// no multiplier changes \[N/m, N\].
    pub turned: Vec<f64>,
    /// B, then the slides it causes, (t x 6) each.
    along: Vec<f64>,
    slides: Vec<f64>,
    /// C less the symmetric part of Z: how the wrench changes with the touched vertices and all
    /// multipliers held.
    pub held: Matrix6<f64>,
    /// Symmetric part of the tangent.
    pub symmetric: Matrix6<f64>,
}

impl PoseWork {
    /// For so many rows.
    pub fn new(most_rows: usize) -> Self {
        Self {
            moved: vec![0.0; 18 * most_rows],
            pushed: vec![0.0; 18 * most_rows],
            turned: vec![0.0; 18 * most_rows],
            along: vec![0.0; 12 * most_rows],
            slides: vec![0.0; 12 * most_rows],
            held: Matrix6::zeros(),
            symmetric: Matrix6::zeros(),
        }
    }

    /// d wrench / d pose of `tool`, held at `grip`, the others held still, at the balance that
    /// `contact` describes; `moment` is that on the tool.
    pub fn differentiate(
        &mut self,
        rows: &[Row],
        tool: u32,
        grip: &Vector3<f64>,
        moment: &Vector3<f64>,
        contact: &mut ContactWork,
    ) -> Matrix6<f64> {
        let newton = &mut contact.newton;
        let (n, t) = (newton.unknowns(), newton.slides);
        self.moved[..6 * n].fill(0.0);
        self.turned[..6 * n].fill(0.0);
        self.held = Matrix6::zeros();
        for (row, geometry) in rows.iter().zip(&newton.geometry) {
            if row.tool != tool {
                continue;
            }
            let arm = newton.touched[geometry.place].at - grip;
            let rigid = rigid(&arm);
            let push = geometry.normal * geometry.lambda;
            let turn = block(&Matrix3::zeros(), &-push.cross_matrix());
            let bend = geometry.curvature * geometry.lambda;
            add(
                &mut self.moved,
                n,
                geometry.place,
                &(geometry.dual * (geometry.normal.transpose() * rigid)),
            );
            add(&mut self.turned, n, geometry.place, &(bend * rigid - turn));
            self.held += rigid.transpose() * bend * rigid
                - rigid.transpose() * turn
                - turn.transpose() * rigid;
            let swing = push.cross_matrix() * arm.cross_matrix();
            let mut corner = self.held.fixed_view_mut::<3, 3>(3, 3);
            corner -= (swing + swing.transpose()) * 0.5;
        }
        // E Rh + Y.
        for (axis, (moved, pushed)) in self.moved[..6 * n]
            .chunks_exact(n.max(1))
            .zip(self.pushed.chunks_exact_mut(n.max(1)))
            .enumerate()
        {
            multiply(&newton.stiffness[..n * n], moved, pushed);
            for (place, touched) in newton.touched.iter().enumerate() {
                let own = Vector3::from_column_slice(&moved[3 * place..3 * place + 3]);
                let turned = &self.turned[n * axis + 3 * place..][..3];
                let sum = Vector3::from_column_slice(&pushed[3 * place..3 * place + 3])
                    - touched.turning * own
                    + Vector3::from_column_slice(turned);
                pushed[3 * place..3 * place + 3].copy_from_slice(sum.as_slice());
                for (a, across) in touched.tangents().iter().enumerate() {
                    self.along[t * axis + touched.first + a] = across.dot(&sum);
                }
            }
        }
        self.slides[..6 * t].copy_from_slice(&self.along[..6 * t]);
        newton.solve_slides(&mut self.slides[..6 * t], 6);
        let mut tangent = Matrix6::zeros();
        for i in 0..6 {
            for j in i..6 {
                let (a, b) = (n * i..n * (i + 1), n * j..n * (j + 1));
                let (c, d) = (t * i..t * (i + 1), t * j..t * (j + 1));
                // Symmetric up to round-off; make it so to the last bit.
                let entry = self.held[(i, j)] + dot(&self.along[c], &self.slides[d])
                    - dot(&self.moved[a.clone()], &self.pushed[b.clone()])
                    - dot(&self.turned[a], &self.moved[b]);
                tangent[(i, j)] = entry;
                tangent[(j, i)] = entry;
            }
        }
        self.symmetric = tangent;
        let mut corner = tangent.fixed_view_mut::<3, 3>(3, 3);
        corner -= moment.cross_matrix() * 0.5;
        tangent
    }
}

/// Force and moment about `grip` on `tool` \[N, N m\].
pub(crate) fn wrench(
    rows: &[Row],
    tool: u32,
    grip: &Vector3<f64>,
    contact: &ContactWork,
) -> Vector6<f64> {
    let mut wrench = Vector6::zeros();
    for (row, geometry) in rows.iter().zip(&contact.newton.geometry) {
        if row.tool == tool {
            let arm = contact.newton.touched[geometry.place].at - grip;
            wrench -= rigid(&arm).transpose() * row.force;
        }
    }
    wrench
}

/// How a point `arm` from the grip moves with it: \[I, -\[arm\]x\].
pub(crate) fn rigid(arm: &Vector3<f64>) -> Matrix3x6<f64> {
    block(&Matrix3::identity(), &-arm.cross_matrix())
}

fn block(left: &Matrix3<f64>, right: &Matrix3<f64>) -> Matrix3x6<f64> {
    let mut both = Matrix3x6::zeros();
    both.fixed_view_mut::<3, 3>(0, 0).copy_from(left);
    both.fixed_view_mut::<3, 3>(0, 3).copy_from(right);
    both
}

/// Adds `values` to three rows of a matrix (n x 6).
fn add(matrix: &mut [f64], n: usize, place: usize, values: &Matrix3x6<f64>) {
    for (axis, column) in values.column_iter().enumerate() {
        let start = n * axis + 3 * place;
        for (entry, value) in matrix[start..start + 3].iter_mut().zip(column.iter()) {
            *entry += value;
        }
    }
}
