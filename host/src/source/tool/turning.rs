//! How normals turn as vertices slide: what makes the solves Newton's.
//!
//! Entry points: [`Turning::prepare`] and [`Turning::aim`] before a solve, [`Turning::forces`] after it. Where a vertex slides
//! by `dx` across the normal of its contact, the force on it turns by `G dx`, `G = lambda H = sum g g'`, H the Hessian of
//! the tool's distance, whose eigenvectors across the normal give at most two g. With B what forces on vertices move these
//! by, the rows' compliance W becomes `W + Q M^-1 Q'`, `Q = C B g`, `M = 1 - E`, `E = g' B g` (Woodbury): `C (K - G)^-1 C'`.
//! Both are symmetric and M has to be positive definite, so that a Cholesky factor does. Deep in tissue it is not though
//! the balance is stable, for what presses keeps the normals from giving way. There these get springs S to where they are
//! closed, which bear nothing at the balance (augmented Lagrangian; Hestenes 1969): B, and with it W, Q and E, lose
//! `B N' (S^-1 + N B N')^-1 N B` first.

use super::{Contact, ToolContacts, TouchingTools};
use crate::anchors::{ConstraintSet, ConstraintSystem, PointConstraint};
use nalgebra::{Matrix2, Matrix3, Matrix6, Vector3};
use sutura_factor::{Dense, add_product, solve_lower, solve_lower_transposed, subtract_product};

/// Springs at normals, in stiffnesses of their rows.
const SPRING: f64 = 100.0;
/// A curvature that is smaller than this part of the other one across it is none.
const FLAT: f64 = 1e-12;

/// Which normals turn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Turns {
    /// Of all that slides.
    Sliding,
    /// Of tools that do not rub.
    Smooth,
}

/// A contact that presses and may slide.
#[derive(Clone, Copy, Debug)]
pub(super) struct Slider {
    /// Of its contact among all.
    pub place: usize,
    /// Of its normal.
    pub row: usize,
    pub anchor: usize,
    /// The first of its ways, and how many it has: less than two on what is not curved in both directions.
    pub ways: (usize, usize),
    /// Of the spring at its normal \[N/m\], if normals have such.
    pub spring: f64,
}

/// A way across a normal along which that turns.
#[derive(Clone, Copy, Debug)]
pub(super) struct Way {
    pub place: usize,
    /// Of its normal.
    pub row: usize,
    pub anchor: usize,
    /// g \[(N/m)^(1/2)\], (3).
    pub along: Vector3<f64>,
}

/// Scratch, and the compliance in which normals turn.
pub(crate) struct Turning {
    pub(super) sliders: Vec<Slider>,
    pub(super) ways: Vec<Way>,
    /// `R^-1 Q'`, (m x n), with m ways and n rows.
    pub(super) answers: Vec<f64>,
    /// E, (m x m), and the Cholesky factor R of M.
    pub(super) stretch: Vec<f64>,
    pub(super) factor: Vec<f64>,
    /// Springs: the Cholesky factor F of `S^-1 + N B N'`, (s x s), and `F^-1 N B` of rows, (s x n), and of ways, (s x m).
    pub(super) springs: Vec<f64>,
    pub(super) spring_rows: Vec<f64>,
    pub(super) spring_ways: Vec<f64>,
    spring_gaps: Vec<f64>,
    /// Where the vertices are along their ways without the rows' forces, less where they were: `R^-1` of it.
    free: Vec<f64>,
    /// Where they come to.
    at: Vec<f64>,
    /// What a force moves each anchor by \[m\].
    moved: Vec<Vector3<f64>>,
    /// C (K - G)^-1 C', (n x n), and delta without forces \[m\], (n).
    pub compliance: Vec<f64>,
    pub delta_free: Vec<f64>,
    dense: Dense,
    /// Whether normals have springs, and whether not even these make it positive definite.
    augmented: bool,
    unstable: bool,
}

impl Turning {
    /// For so many rows, contacts and anchors.
    pub fn new(most_rows: usize, most_contacts: usize) -> Self {
        let most = 2 * most_contacts;
        Self {
            sliders: Vec::with_capacity(most_contacts),
            ways: Vec::with_capacity(most),
            answers: vec![0.0; most * most_rows],
            stretch: vec![0.0; most * most],
            factor: vec![0.0; most * most],
            springs: vec![0.0; most_contacts * most_contacts],
            spring_rows: vec![0.0; most_contacts * most_rows],
            spring_ways: vec![0.0; most_contacts * most],
            spring_gaps: vec![0.0; most_contacts],
            free: vec![0.0; most],
            at: vec![0.0; most],
            moved: Vec::with_capacity(most_rows),
            compliance: vec![0.0; most_rows * most_rows],
            delta_free: vec![0.0; most_rows],
            dense: Dense::new(most.max(1)),
            augmented: false,
            unstable: false,
        }
    }

    /// Makes [`Self::compliance`] of the rows of `set`, whose compliance `system` has, for those contacts of `state` that
    /// turn. Whether any does.
    pub fn prepare(
        &mut self,
        tools: &TouchingTools,
        state: &ToolContacts,
        turns: Turns,
        system: &ConstraintSystem,
        set: &ConstraintSet,
    ) -> bool {
        let n = set.count();
        (self.augmented, self.unstable) = (false, false);
        self.gather(tools, state, turns, &set.rows);
        if self.ways.is_empty() {
            return false;
        }
        self.reach(system, set);
        let w = system.compliance(n);
        self.compliance[..n * n].copy_from_slice(w);
        if !self.factor() {
            self.augmented = true;
            if !(self.stiffen(n, w) && self.factor()) {
                self.give_up();
                return false;
            }
        }
        let m = self.ways.len();
        let answers = &mut self.answers[..m * n];
        solve_lower(&self.factor[..m * m], m, answers, n);
        add_product(
            1.0,
            answers,
            answers,
            &mut self.compliance[..n * n],
            (m, n, n),
        );
        true
    }

    /// Has nothing turn.
    fn give_up(&mut self) {
        (self.augmented, self.unstable) = (false, true);
        self.ways.clear();
        for slider in &mut self.sliders {
            (slider.ways, slider.spring) = ((0, 0), 0.0);
        }
    }

    /// Lists the contacts that press and may slide, and their ways.
    fn gather(
        &mut self,
        tools: &TouchingTools,
        state: &ToolContacts,
        turns: Turns,
        rows: &[PointConstraint],
    ) {
        self.sliders.clear();
        self.ways.clear();
        for (place, contact) in state.contacts.iter().enumerate() {
            let slides = contact.smooth || (contact.slips && turns == Turns::Sliding);
            let row = contact.row as usize;
            let (true, Some(of)) = (contact.lambda_n[0] > 0.0 && slides, rows.get(row)) else {
                continue;
            };
            let first = self.ways.len();
            let anchor = of.anchor as usize;
            let ways = ways(tools, state, contact).into_iter().flatten();
            self.ways.extend(ways.map(|along| Way {
                place,
                row,
                anchor,
                along,
            }));
            self.sliders.push(Slider {
                place,
                row,
                anchor,
                ways: (first, self.ways.len() - first),
                spring: 0.0,
            });
        }
    }

    /// Q', (m x n), and E.
    fn reach(&mut self, system: &ConstraintSystem, set: &ConstraintSet) {
        let m = self.ways.len();
        let anchors = set.anchors.len() + set.ways.len();
        for (j, way) in self.ways.iter().enumerate() {
            self.moved.clear();
            let moved = (0..anchors).map(|at| system.between(way.anchor, at).tr_mul(&way.along));
            self.moved.extend(moved);
            let along = |anchor: u32, direction: [f64; 3]| {
                Vector3::from(direction).dot(&self.moved[anchor as usize])
            };
            let rows = set.rows.iter().map(|row| along(row.anchor, row.direction));
            let spread = set.spread.iter().map(|row| {
                let terms = set.terms[row.terms.0 as usize..].iter();
                let terms = terms.take(row.terms.1 as usize);
                terms
                    .map(|term| along(term.anchor, term.direction))
                    .sum::<f64>()
            });
            let own = self.answers.iter_mut().skip(j).step_by(m);
            for (out, entry) in own.zip(rows.chain(spread)) {
                *out = entry;
            }
            let column = &mut self.stretch[m * j..m * (j + 1)];
            for (out, other) in column.iter_mut().zip(&self.ways) {
                *out = other.along.dot(&self.moved[other.anchor]);
            }
        }
    }

    /// Factors M; whether it is positive definite.
    fn factor(&mut self) -> bool {
        let m = self.ways.len();
        let factor = &mut self.factor[..m * m];
        for (place, (out, e)) in factor.iter_mut().zip(&self.stretch).enumerate() {
            let one = f64::from(u8::from(place % (m + 1) == 0));
            *out = one - e;
        }
        self.dense.factor(factor, m).is_ok()
    }

    /// Puts springs at normals, `w` (n x n) being the compliance without; whether that could be done.
    fn stiffen(&mut self, n: usize, w: &[f64]) -> bool {
        let (s, m) = (self.sliders.len(), self.ways.len());
        for j in 0..s {
            let column = self.sliders[j].row;
            for (i, slider) in self.sliders.iter().enumerate() {
                self.springs[s * j + i] = w[n * column + slider.row];
            }
            let gives = w[column * (n + 1)].max(f64::MIN_POSITIVE) / SPRING;
            self.springs[j * (s + 1)] += gives;
            self.sliders[j].spring = gives.recip();
        }
        let springs = &mut self.springs[..s * s];
        if self.dense.factor(springs, s).is_err() {
            return false;
        }
        let rows = &mut self.spring_rows[..s * n];
        for (out, w) in rows.chunks_exact_mut(s).zip(w.chunks_exact(n)) {
            for (out, slider) in out.iter_mut().zip(&self.sliders) {
                *out = w[slider.row];
            }
        }
        let ways = &mut self.spring_ways[..s * m];
        for (j, out) in ways.chunks_exact_mut(s).enumerate() {
            for (out, slider) in out.iter_mut().zip(&self.sliders) {
                *out = self.answers[m * slider.row + j];
            }
        }
        solve_lower(springs, s, rows, n);
        solve_lower(springs, s, ways, m);
        subtract_product(rows, rows, &mut self.compliance[..n * n], (s, n, n));
        subtract_product(ways, rows, &mut self.answers[..m * n], (s, m, n));
        subtract_product(ways, ways, &mut self.stretch[..m * m], (s, m, m));
        true
    }

    /// After [`Self::prepare`]: [`Self::delta_free`] from what `system` has; `points_m` (nodes x 3) are unloaded.
    pub fn aim(
        &mut self,
        state: &ToolContacts,
        system: &ConstraintSystem,
        n: usize,
        points_m: &[[f64; 3]],
    ) {
        let m = self.ways.len();
        let free = &mut self.free[..m];
        for (free, way) in free.iter_mut().zip(&self.ways) {
            let contact = &state.contacts[way.place];
            let was = contact.at_m - Vector3::from(points_m[contact.node as usize]);
            *free = way.along.dot(&(system.free_m(way.anchor) - was));
        }
        let delta = &mut self.delta_free[..n];
        delta.copy_from_slice(system.delta_free_m(n));
        if self.augmented {
            let s = self.sliders.len();
            let gaps = &mut self.spring_gaps[..s];
            for (gap, slider) in gaps.iter_mut().zip(&self.sliders) {
                *gap = delta[slider.row];
            }
            solve_lower(&self.springs[..s * s], s, gaps, 1);
            weigh(1.0, &self.spring_ways[..s * m], gaps, free);
            weigh(-1.0, &self.spring_rows[..s * n], gaps, delta);
        }
        solve_lower(&self.factor[..m * m], m, free, 1);
        weigh(-1.0, &self.answers[..m * n], free, delta);
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

    /// After a solve for `lambda` \[N\], (n): normal rows, and what turned forces act across the normals on the tissue as
    /// long as these press \[N\], (3).
    pub fn forces(&mut self, lambda: &[f64]) -> impl Iterator<Item = (usize, Vector3<f64>)> + '_ {
        let m = self.ways.len();
        let at = &mut self.at[..m];
        at.copy_from_slice(&self.free[..m]);
        for (answers, lambda) in self.answers.chunks_exact(m.max(1)).zip(lambda) {
            if *lambda != 0.0 {
                for (at, answer) in at.iter_mut().zip(answers) {
                    *at -= answer * lambda;
                }
            }
        }
        if m > 0 {
            solve_lower_transposed(&self.factor[..m * m], m, at, 1);
        }
        let turned = self.ways.iter().zip(&self.at);
        turned.map(|(way, at)| (way.row, way.along * *at))
    }
}

/// Of the contacts that slide.
impl Turning {
    /// Whether any is of `tool`.
    pub fn slides(&self, contacts: &[Contact], tool: u32) -> bool {
        let mut own = self.sliders.iter();
        own.any(|slider| contacts[slider.place].tool == tool)
    }

    /// Those of `tool`, with the rows of their normals.
    fn own<'a>(
        &'a self,
        contacts: &'a [Contact],
        tool: u32,
    ) -> impl Iterator<Item = (&'a Slider, &'a Contact)> {
        let each = self.sliders.iter();
        each.map(|slider| (slider, &contacts[slider.place]))
            .filter(move |(_, contact)| contact.tool == tool)
    }

    /// J of the normals for a motion of `tool` about `grip`, into a `jacobian` (n x 6) of zeros.
    pub fn lead(
        &self,
        (contacts, tool): (&[Contact], u32),
        grip: &Vector3<f64>,
        jacobian: &mut [f64],
    ) {
        let n = jacobian.len() / 6;
        for (slider, contact) in self.own(contacts, tool) {
            let turned = contact.normal.cross(&(contact.at_m - grip));
            for axis in 0..3 {
                jacobian[n * axis + slider.row] = -contact.normal[axis];
                jacobian[n * (3 + axis) + slider.row] = turned[axis];
            }
        }
    }

    /// d wrench / d pose of `tool` about `grip` where vertices stay and multipliers are kept, (6 x 6).
    pub fn turned(&self, (contacts, tool): (&[Contact], u32), grip: &Vector3<f64>) -> Matrix6<f64> {
        let mut all = Matrix6::zeros();
        for (slider, contact) in self.own(contacts, tool) {
            let (first, count) = slider.ways;
            let mut stiffness = Matrix3::zeros();
            for way in self.ways.iter().skip(first).take(count) {
                stiffness += way.along * way.along.transpose();
            }
            let arm = (contact.at_m - grip).cross_matrix();
            let force = (contact.normal * contact.lambda_n[0]).cross_matrix();
            // G dX - theta x p, and what the moment's arm adds, which the grip takes away from.
            let (shift, turn) = (stiffness, force - stiffness * arm);
            let blocks = [
                (0, 0, shift),
                (0, 3, turn),
                (3, 0, arm * shift - force),
                (3, 3, arm * turn),
            ];
            for (row, column, block) in blocks {
                let mut own = all.fixed_view_mut::<3, 3>(row, column);
                own += block;
            }
        }
        all
    }
}

/// `out += scale a' x` for a (k x n), x (k) and out (n).
fn weigh(scale: f64, a: &[f64], x: &[f64], out: &mut [f64]) {
    for (out, column) in out.iter_mut().zip(a.chunks_exact(x.len().max(1))) {
        let along: f64 = column.iter().zip(x).map(|(a, x)| a * x).sum();
        *out += scale * along;
    }
}

/// g of a contact, orthogonal to each other, the longer first: the eigenvectors of `lambda H` across its normal (Jacobi).
fn ways(
    tools: &TouchingTools,
    state: &ToolContacts,
    contact: &Contact,
) -> [Option<Vector3<f64>>; 2] {
    let tool = contact.tool as usize;
    let touch = state.placements[tool]
        .as_ref()
        .and_then(|placement| tools.solid(tool, placement).touch(&contact.at_m));
    let Some(touch) = touch else {
        return [None; 2];
    };
    let [_, a, b] = contact.frame();
    let bend = |i: &Vector3<f64>, j: &Vector3<f64>| i.dot(&(touch.curvature * j));
    let bends = Matrix2::new(bend(&a, &a), bend(&a, &b), bend(&b, &a), bend(&b, &b));
    let (first, second, off) = (bends[(0, 0)], bends[(1, 1)], bends[(0, 1)]);
    let tangent = if off == 0.0 {
        0.0
    } else {
        let tau = (second - first) / (2.0 * off);
        tau.signum() / (tau.abs() + (1.0 + tau * tau).sqrt())
    };
    let cosine = (1.0 + tangent * tangent).sqrt().recip();
    let sine = tangent * cosine;
    let mut each = [
        (first - tangent * off, a * cosine - b * sine),
        (second + tangent * off, a * sine + b * cosine),
    ];
    if each[1].0 > each[0].0 {
        each.swap(0, 1);
    }
    let least = FLAT * each[0].0;
    each.map(|(bend, along)| {
        let turns = bend > 0.0 && bend > least;
        turns.then(|| along * (contact.lambda_n[0] * bend).sqrt())
    })
}
