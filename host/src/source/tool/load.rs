//! How tissue answers a motion of a tool by the forces that turn with it.
//!
//! Entry point: [`Load::add`]. A motion of the tool about its grip turns the force on a vertex that stays where it is by
//! `h = theta x p - G dX`, dX the tool's motion there. On tissue whose normals turn that moves rows by `C (K - G)^-1 h`. What lies
//! along the ways g of [`super::turning`], `h = g c`, needs nothing but what is known of these: `C (K - G)^-1 g = Q M^-1`
//! and `g' (K - G)^-1 g = M^-1 E`. What is left of h on a shape that is not curved in both directions, f, moves all anchors
//! by `B f`.

use super::Contact;
use super::turning::{Slider, Turning};
use crate::anchors::{ConstraintSet, ConstraintSystem};
use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};
use sutura_factor::{add_product, solve_lower, subtract_product};

/// Motions of a tool.
const POSES: usize = 6;

/// Scratch.
pub(crate) struct Load {
    /// c, then `R^-1 (c + g' B f)`; `R^-1 (E c + g' B f)`; `R^-1 g' B f`; (m x 6) each.
    along: Vec<f64>,
    stretched: Vec<f64>,
    rest: Vec<f64>,
    /// f for each turn of the tool, by the anchors that it acts on, and B f at all anchors.
    left: Vec<(usize, Matrix3<f64>)>,
    moved: Vec<Matrix3<f64>>,
    /// `F^-1 N B f` of springs, (s x 3).
    springs: Vec<f64>,
}

impl Load {
    /// For so many rows and contacts.
    pub fn new(most_rows: usize, most_contacts: usize) -> Self {
        let square = || vec![0.0; POSES * 2 * most_contacts];
        Self {
            along: square(),
            stretched: square(),
            rest: square(),
            left: Vec::with_capacity(most_contacts),
            moved: Vec::with_capacity(most_rows),
            springs: vec![0.0; 3 * most_contacts],
        }
    }

    /// Takes what a motion of `tool` about `grip` moves all rows by off their J in `jacobian`, (n x 6), as far as contacts
    /// slide and their number of ways is `wanted`. Says `h' (K - G)^-1 h` \[N/m, N, N m per rad\].
    pub fn add(
        &mut self,
        turning: &Turning,
        (contacts, tool): (&[Contact], u32),
        grip: &Vector3<f64>,
        wanted: impl Fn(usize) -> bool,
        (system, set): (&ConstraintSystem, &ConstraintSet),
        jacobian: &mut [f64],
    ) -> Matrix6<f64> {
        let m = turning.ways.len();
        self.along[..POSES * m].fill(0.0);
        self.left.clear();
        for slider in &turning.sliders {
            let contact = &contacts[slider.place];
            if contact.tool == tool && wanted(slider.ways.1) {
                self.split(turning, slider, contact, grip);
            }
        }
        self.displace(system, set.anchors.len() + set.ways.len());
        let n = set.count();
        let mut answer = hold(turning, n, jacobian);
        self.push(turning, set, &mut answer);
        self.answer(turning, &mut answer);
        self.take_off(turning, set, jacobian);
        answer
    }

    /// Takes h of a contact apart: into what lies along its ways, and the rest.
    fn split(
        &mut self,
        turning: &Turning,
        slider: &Slider,
        contact: &Contact,
        grip: &Vector3<f64>,
    ) {
        let m = turning.ways.len();
        let (first, count) = slider.ways;
        let arm = contact.at_m - grip;
        let force_n = contact.normal * contact.lambda_n[0];
        let mut left = force_n.cross_matrix() * -1.0;
        for (place, way) in turning.ways.iter().enumerate().skip(first).take(count) {
            let along = &way.along;
            let (turned, square) = (force_n.cross(along), along.norm_squared());
            let moved = arm.cross(along);
            for axis in 0..3 {
                self.along[m * axis + place] = -along[axis];
                // (e x p).g = e.(p x g), and for G likewise.
                self.along[m * (3 + axis) + place] = turned[axis] / square - moved[axis];
            }
            left -= along * (turned / square).transpose();
        }
        if count < 2 {
            self.left.push((slider.anchor, left));
        }
    }

    /// B f of all anchors.
    fn displace(&mut self, system: &ConstraintSystem, anchors: usize) {
        self.moved.clear();
        if self.left.is_empty() {
            return;
        }
        let moved = (0..anchors).map(|at| {
            let each = self.left.iter();
            each.map(|(from, force)| system.between(*from, at).tr_mul(force))
                .sum::<Matrix3<f64>>()
        });
        self.moved.extend(moved);
    }

    /// `g' B f`, and `f' B f` into `answer`, with normals that have springs if some do.
    fn push(&mut self, turning: &Turning, set: &ConstraintSet, answer: &mut Matrix6<f64>) {
        let (m, s) = (turning.ways.len(), turning.sliders.len());
        let rest = &mut self.rest[..POSES * m];
        rest.fill(0.0);
        if self.left.is_empty() {
            return;
        }
        for (place, way) in turning.ways.iter().enumerate() {
            let moved = self.moved[way.anchor].tr_mul(&way.along);
            for axis in 0..3 {
                rest[m * (3 + axis) + place] = moved[axis];
            }
        }
        let mut turned = Matrix3::zeros();
        for (anchor, force) in &self.left {
            turned += force.tr_mul(&self.moved[*anchor]);
        }
        if !turning.is_plain() {
            let springs = &mut self.springs[..3 * s];
            for (place, slider) in turning.sliders.iter().enumerate() {
                let direction = Vector3::from(set.rows[slider.row].direction);
                let moved = self.moved[slider.anchor].tr_mul(&direction);
                for axis in 0..3 {
                    springs[s * axis + place] = moved[axis];
                }
            }
            solve_lower(&turning.springs[..s * s], s, springs, 3);
            let of_turns = &mut rest[3 * m..];
            subtract_product(&turning.spring_ways[..s * m], springs, of_turns, (s, m, 3));
            turned -=
                Matrix3::from_fn(|i, j| product(column(springs, s, i), column(springs, s, j)));
        }
        let mut corner = answer.fixed_view_mut::<3, 3>(3, 3);
        corner += turned;
    }

    /// Adds what ways answer: `c' M^-1 (E c + d) + d' M^-1 (c + d)`, d being `g' B f`.
    fn answer(&mut self, turning: &Turning, answer: &mut Matrix6<f64>) {
        let m = turning.ways.len();
        if m == 0 {
            return;
        }
        let [along, stretched, rest] =
            [&mut self.along, &mut self.stretched, &mut self.rest].map(|all| &mut all[..POSES * m]);
        stretched.copy_from_slice(rest);
        let stretch = &turning.stretch[..m * m];
        add_product(1.0, stretch, along, stretched, (m, m, POSES));
        for columns in [&mut *along, &mut *stretched] {
            solve_lower(&turning.factor[..m * m], m, columns, POSES);
        }
        *answer += Matrix6::from_fn(|i, j| product(column(along, m, i), column(stretched, m, j)));
        if self.left.is_empty() {
            return;
        }
        solve_lower(&turning.factor[..m * m], m, rest, POSES);
        for (along, rest) in along.iter_mut().zip(&*rest) {
            *along += rest;
        }
        *answer += Matrix6::from_fn(|i, j| product(column(rest, m, i), column(along, m, j)));
    }

    /// Takes what moves rows off J.
    fn take_off(&mut self, turning: &Turning, set: &ConstraintSet, jacobian: &mut [f64]) {
        let (n, m, s) = (set.count(), turning.ways.len(), turning.sliders.len());
        if m > 0 {
            let answers = &turning.answers[..m * n];
            subtract_product(answers, &self.along[..POSES * m], jacobian, (m, n, POSES));
        }
        if self.left.is_empty() {
            return;
        }
        let of_turns = &mut jacobian[3 * n..];
        let mut take = |row: usize, anchor: u32, direction: [f64; 3]| {
            let moved = self.moved[anchor as usize].tr_mul(&Vector3::from(direction));
            for axis in 0..3 {
                of_turns[n * axis + row] -= moved[axis];
            }
        };
        for (place, row) in set.rows.iter().enumerate() {
            take(place, row.anchor, row.direction);
        }
        for (place, row) in set.spread.iter().enumerate() {
            let (first, count) = (row.terms.0 as usize, row.terms.1 as usize);
            for term in set.terms.iter().skip(first).take(count) {
                take(set.rows.len() + place, term.anchor, term.direction);
            }
        }
        if !turning.is_plain() {
            let rows = &turning.spring_rows[..s * n];
            add_product(1.0, rows, &self.springs[..3 * s], of_turns, (s, n, 3));
        }
    }
}

/// What springs at normals make of J, with the motion of what they hold: the balance's normals go with their tool.
fn hold(turning: &Turning, n: usize, jacobian: &[f64]) -> Matrix6<f64> {
    let mut held = Matrix6::zeros();
    for slider in turning.sliders.iter().filter(|slider| slider.spring > 0.0) {
        let way = Vector6::from_fn(|pose, _| jacobian[n * pose + slider.row]);
        held += way * way.transpose() * slider.spring;
    }
    held
}

fn column(all: &[f64], m: usize, column: usize) -> &[f64] {
    &all[m * column..m * (column + 1)]
}

fn product(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
