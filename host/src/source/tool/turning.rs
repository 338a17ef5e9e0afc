//! How normals turn as vertices slide: what makes the solves Newton's.
//!
//! Entry points: [`Turning::prepare`], and [`Turning::forces`] after the solve. Where a vertex slides by `dx` across
//! the normal of its contact, the force on it turns by `G dx`, `G = lambda H`, H the Hessian of the tool's distance. With
//! T the rows across the normals, the rows' compliance W becomes `W + Q M^-1 Q'`, `Q = W_T L`, `M = 1 - L' W_TT L`, `L L' = T G T'`
//! (Woodbury): `C (K - G)^-1 C'`. Deep in tissue `K - G` is not positive definite though the balance is stable, for what presses
//! keeps the normals from giving way. There these get springs to where they are closed, which bear nothing at the balance
//! (augmented Lagrangian; Hestenes 1969).

use super::{Contact, ToolContacts, TouchingTools};
use crate::anchors::AnchorRow;
use crate::dense::{Dense, Lu, add_product, solve_lower};
use nalgebra::{Matrix2, Vector2, Vector3};

/// Springs at normals, in stiffnesses of their rows.
const SPRING: f64 = 100.0;

/// A contact whose normal turns.
#[derive(Clone, Copy, Debug)]
struct Turn {
    /// Of its contact among all.
    place: usize,
    /// Of the first of its two rows across the normal.
    row: usize,
    /// G there \[N/m\], and its Cholesky factor.
    stiffness: Matrix2<f64>,
    factor: Matrix2<f64>,
    /// Where the vertex was across the normal \[m\].
    was_m: Vector2<f64>,
}

impl Turn {
    /// Not on a flat face.
    fn turns(&self) -> bool {
        self.factor != Matrix2::zeros()
    }
}

/// Scratch, and the compliance in which normals turn.
pub(crate) struct Turning {
    turns: Vec<Turn>,
    /// W_T L, then `M^-1` of its transpose, (n x m) each.
    q: Vec<f64>,
    answers: Vec<f64>,
    m: Vec<f64>,
    v: Vec<f64>,
    pub compliance: Vec<f64>,
    pub delta_free: Vec<f64>,
    dense: Dense,
    lu: Lu,
    /// Whether normals have springs, and whether not even these make it positive definite.
    augmented: bool,
    unstable: bool,
}

impl Turning {
    /// For so many rows and contacts.
    pub fn new(most_rows: usize, most_contacts: usize) -> Self {
        let most = 3 * most_contacts;
        Self {
            turns: Vec::with_capacity(most_contacts),
            q: vec![0.0; most * most_rows],
            answers: vec![0.0; most * most_rows],
            m: vec![0.0; most * most],
            v: vec![0.0; most],
            compliance: vec![0.0; most_rows * most_rows],
            delta_free: vec![0.0; most_rows],
            dense: Dense::new(most.max(1)),
            lu: Lu::new(most.max(1)),
            augmented: false,
            unstable: false,
        }
    }

    /// Makes [`Self::compliance`] and [`Self::delta_free`] of the rows `rows` from `w` (n x n) and `delta_free` (n) for the
    /// contacts of `state`. Whether anything turns.
    pub fn prepare(
        &mut self,
        tools: &TouchingTools,
        state: &ToolContacts,
        rows: &[AnchorRow],
        (w, delta_free): (&[f64], &[f64]),
        points_m: &[[f64; 3]],
    ) -> bool {
        let n = delta_free.len();
        self.turns.clear();
        self.unstable = false;
        self.gather(tools, state, points_m, Turn::turns);
        let m = 2 * self.turns.len();
        if m == 0 {
            return false;
        }
        for (place, turn) in self.turns.iter().enumerate() {
            let across = [turn.row, turn.row + 1].map(|row| &w[n * row..n * (row + 1)]);
            for axis in 0..2 {
                let share = turn.factor.column(axis);
                let q = &mut self.q[n * (2 * place + axis)..][..n];
                for (q, (a, b)) in q.iter_mut().zip(across[0].iter().zip(across[1])) {
                    *q = share[0] * a + share[1] * b;
                }
            }
            let free = [turn.row, turn.row + 1].map(|row| rows[row].target_m - delta_free[row]);
            let v = turn.factor.transpose() * (Vector2::from(free) - turn.was_m);
            self.v[2 * place..2 * place + 2].copy_from_slice(v.as_slice());
        }
        for (place, turn) in self.turns.iter().enumerate() {
            for column in 0..m {
                let q = &self.q[n * column + turn.row..][..2];
                let of = turn.factor.transpose() * Vector2::new(q[0], q[1]);
                for axis in 0..2 {
                    let row = 2 * place + axis;
                    self.m[m * column + row] = f64::from(u8::from(row == column)) - of[axis];
                }
            }
        }
        self.compliance[..n * n].copy_from_slice(w);
        self.delta_free[..n].copy_from_slice(delta_free);
        self.augmented = self.dense.factor(&mut self.m[..m * m], m).is_err();
        if self.augmented {
            self.gather(tools, state, points_m, |_| true);
            self.augment(rows, w, delta_free);
            self.unstable = !self.is_positive(n);
            if self.unstable {
                self.turns.clear();
                return false;
            }
        } else {
            self.add(n, m);
        }
        true
    }

    /// Lists the contacts that press and may slide, as far as they are `wanted`.
    fn gather(
        &mut self,
        tools: &TouchingTools,
        state: &ToolContacts,
        points_m: &[[f64; 3]],
        wanted: impl Fn(&Turn) -> bool,
    ) {
        self.turns.clear();
        for (place, contact) in state.contacts.iter().enumerate() {
            let turn = turn_of(tools, state, contact, points_m).filter(&wanted);
            self.turns.extend(turn.map(|turn| Turn { place, ..turn }));
        }
    }

    /// Whether what the contacts give way by is positive definite.
    fn is_positive(&mut self, n: usize) -> bool {
        let m = 3 * self.turns.len();
        let row_of = |place: usize| self.turns[place / 3].row - 1 + place % 3;
        for column in 0..m {
            for row in 0..m {
                let entry = self.compliance[n * row_of(column) + row_of(row)];
                self.m[m * column + row] = entry;
            }
        }
        self.dense.factor(&mut self.m[..m * m], m).is_ok()
    }

    /// Whether the normals of the last [`Self::prepare`] turn faster than tissue holds against it: no balance there is
    /// stable.
    pub fn is_unstable(&self) -> bool {
        self.unstable
    }

    /// Whether it is `C (K - G)^-1 C'` itself, for derivatives.
    pub fn is_plain(&self) -> bool {
        !self.augmented
    }

    /// With springs at the normals: `W - W_c D M^-1 W_c'`, `M = 1 + W_cc D`, D the springs and -G.
    fn augment(&mut self, rows: &[AnchorRow], w: &[f64], delta_free: &[f64]) {
        let n = delta_free.len();
        let m = 3 * self.turns.len();
        for (place, turn) in self.turns.iter().enumerate() {
            let first = turn.row - 1;
            let spring = SPRING / w[first * (n + 1)].max(f64::MIN_POSITIVE);
            let columns = [0, 1, 2].map(|axis| &w[n * (first + axis)..n * (first + axis + 1)]);
            // W_c D, (n x m).
            let out = &mut self.q[3 * n * place..3 * n * (place + 1)];
            let (normal, across) = out.split_at_mut(n);
            let (a, b) = across.split_at_mut(n);
            let g = turn.stiffness;
            for row in 0..n {
                let [c, t, u] = columns.map(|column| column[row]);
                normal[row] = spring * c;
                a[row] = -(t * g[(0, 0)] + u * g[(1, 0)]);
                b[row] = -(t * g[(0, 1)] + u * g[(1, 1)]);
            }
            let free = |axis: usize| rows[first + axis].target_m - delta_free[first + axis];
            self.v[3 * place] = -delta_free[first];
            self.v[3 * place + 1] = free(1) - turn.was_m.x;
            self.v[3 * place + 2] = free(2) - turn.was_m.y;
        }
        let row_of = |place: usize| self.turns[place / 3].row - 1 + place % 3;
        for column in 0..m {
            for row in 0..m {
                let one = f64::from(u8::from(row == column));
                self.m[m * column + row] = one + self.q[n * column + row_of(row)];
            }
        }
        for column in 0..n {
            for row in 0..m {
                self.answers[m * column + row] = w[n * column + row_of(row)];
            }
        }
        self.lu.factor(&mut self.m[..m * m], m);
        self.lu
            .solve(&self.m[..m * m], m, &mut self.answers[..m * n], n);
        self.lu.solve(&self.m[..m * m], m, &mut self.v[..m], 1);
        for (column, answer) in self.answers[..m * n].chunks_exact(m).enumerate() {
            let out = &mut self.compliance[n * column..n * (column + 1)];
            for (q, by) in self.q.chunks_exact(n).zip(answer) {
                for (out, q) in out.iter_mut().zip(q) {
                    *out -= by * q;
                }
            }
        }
        for column in 0..n {
            for row in 0..column {
                let (i, j) = (n * column + row, n * row + column);
                let both = 0.5 * (self.compliance[i] + self.compliance[j]);
                (self.compliance[i], self.compliance[j]) = (both, both);
            }
        }
        for (q, by) in self.q.chunks_exact(n).zip(&self.v[..m]) {
            for (delta, q) in self.delta_free.iter_mut().zip(q) {
                *delta += by * q;
            }
        }
    }

    /// Adds `Q M^-1 Q'` and takes `Q M^-1 v` off.
    fn add(&mut self, n: usize, m: usize) {
        let Self {
            q,
            answers,
            m: factor,
            v,
            compliance,
            delta_free,
            ..
        } = self;
        let (factor, answers) = (&factor[..m * m], &mut answers[..m * n]);
        for (row, answers) in answers.chunks_exact_mut(m).enumerate() {
            for (answer, q) in answers.iter_mut().zip(q.chunks_exact(n)) {
                *answer = q[row];
            }
        }
        // M = L L', so that what is added is the square of L^-1 Q'.
        solve_lower(factor, m, answers, n);
        solve_lower(factor, m, &mut v[..m], 1);
        add_product(1.0, answers, answers, &mut compliance[..n * n], (m, n, n));
        for (delta, answer) in delta_free.iter_mut().zip(answers.chunks_exact(m)) {
            *delta -= answer.iter().zip(&v[..m]).map(|(q, v)| q * v).sum::<f64>();
        }
    }

    /// What a motion of `tool` about `grip` changes of all rows' delta by the forces that turn with it, into their J, (n x 6).
    pub fn load(
        &self,
        state: &ToolContacts,
        tool: u32,
        grip: &Vector3<f64>,
        n: usize,
        jacobian: &mut [f64],
    ) {
        for turn in &self.turns {
            let contact = &state.contacts[turn.place];
            if contact.tool != tool {
                continue;
            }
            let [_, a, b] = contact.frame();
            let arm = contact.at_m - grip;
            for pose in 0..6 {
                let axis = Vector3::ith(pose % 3, 1.0);
                let (moved, turned) = if pose < 3 {
                    (axis, Vector3::zeros())
                } else {
                    (
                        axis.cross(&arm),
                        axis.cross(&contact.normal) * contact.lambda_n[0],
                    )
                };
                let across = |v: &Vector3<f64>| Vector2::new(a.dot(v), b.dot(v));
                let force = across(&turned) - turn.stiffness * across(&moved);
                for (axis, force) in force.iter().enumerate() {
                    let column = &self.compliance[n * (turn.row + axis)..][..n];
                    let own = &mut jacobian[n * pose..n * (pose + 1)];
                    for (own, w) in own.iter_mut().zip(column) {
                        *own -= w * force;
                    }
                }
            }
        }
    }

    /// After a solve that left `delta_m`: normal rows, rows across them, and what the turned forces add to the multipliers of
    /// the latter as long as the former press \[N\].
    pub fn forces<'a>(
        &'a self,
        rows: &'a [AnchorRow],
        delta_m: &'a [f64],
    ) -> impl Iterator<Item = (usize, usize, f64)> + 'a {
        self.turns.iter().flat_map(move |turn| {
            let at = [turn.row, turn.row + 1].map(|row| rows[row].target_m - delta_m[row]);
            let turned = turn.stiffness * (Vector2::from(at) - turn.was_m);
            [0, 1].map(|axis| (turn.row - 1, turn.row + axis, -turned[axis]))
        })
    }
}

/// What turns at a contact; nothing where it sticks or is open.
fn turn_of(
    tools: &TouchingTools,
    state: &ToolContacts,
    contact: &Contact,
    points_m: &[[f64; 3]],
) -> Option<Turn> {
    let rubs = !tools.each[contact.tool as usize].tool.is_smooth();
    if contact.lambda_n[0] <= 0.0 || (rubs && !contact.slips) {
        return None;
    }
    let placement = state.placements[contact.tool as usize].as_ref()?;
    let solid = tools.solid(contact.tool as usize, placement);
    let touch = solid.touch(&contact.at_m)?;
    let [_, a, b] = contact.frame();
    let bend =
        |i: &Vector3<f64>, j: &Vector3<f64>| contact.lambda_n[0] * i.dot(&(touch.curvature * j));
    let stiffness = Matrix2::new(bend(&a, &a), bend(&a, &b), bend(&b, &a), bend(&b, &b));
    let first = stiffness[(0, 0)].max(0.0).sqrt();
    let across = if first > 0.0 {
        stiffness[(1, 0)] / first
    } else {
        0.0
    };
    let second = (stiffness[(1, 1)] - across * across).max(0.0).sqrt();
    let was = contact.at_m - Vector3::from(points_m[contact.node as usize]);
    Some(Turn {
        place: 0,
        row: contact.row as usize + 1,
        stiffness,
        factor: Matrix2::new(first, 0.0, across, second),
        was_m: Vector2::new(a.dot(&was), b.dot(&was)),
    })
}
