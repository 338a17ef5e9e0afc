//! What the console needs of a balance: each tool's wrench and its exact derivative.
//!
//! Entry points: [`centre_tangent`], [`at_grip`]. From the Newton system of `active_set` with the
//! centre moved by dc: `T'(K_A - G) T a = -T' K_A E dc`, `dF = -E' K_A (E + T a)`, E the stacked
//! identity. Moved to the grip at -r from the centre with J = \[I, -\[r\]x\]:
//! `d wrench / d pose = J' dF/dc J + blockdiag(0, [F]x [r]x)`.

use super::active_set::{ContactWork, MAX_ROWS, Row};
use nalgebra::{Matrix3, Matrix6, Vector3};

/// Buffers of the reduction.
pub(crate) struct TangentWork {
    /// K_A E, (3k x 3).
    pushed: Vec<f64>,
    /// T' K_A E, then the slides it causes, (2k x 3) each.
    along: Vec<f64>,
    slides: Vec<f64>,
}

impl TangentWork {
    pub fn new() -> Self {
        Self {
            pushed: vec![0.0; 9 * MAX_ROWS],
            along: vec![0.0; 6 * MAX_ROWS],
            slides: vec![0.0; 6 * MAX_ROWS],
        }
    }
}

/// Force on `tool` \[N\].
pub(crate) fn force(rows: &[Row], tool: u32) -> Vector3<f64> {
    -rows
        .iter()
        .filter(|row| row.tool == tool)
        .map(|row| row.force)
        .sum::<Vector3<f64>>()
}

/// d force / d centre of one tool, the others held \[N/m\], at the balance that `contact` describes.
pub(crate) fn centre_tangent(
    rows: &[Row],
    tool: u32,
    contact: &mut ContactWork,
    work: &mut TangentWork,
) -> Matrix3<f64> {
    let k = rows.len();
    let (n, t) = (3 * k, 2 * k);
    let (pushed, along) = (&mut work.pushed[..3 * n], &mut work.along[..3 * t]);
    pushed.fill(0.0);
    for (j, _) in rows.iter().enumerate().filter(|(_, row)| row.tool == tool) {
        for axis in 0..3 {
            let start = n * (3 * j + axis);
            let column = &contact.stiffness[start..start + n];
            for (pushed, k) in pushed[n * axis..n * (axis + 1)].iter_mut().zip(column) {
                *pushed += k;
            }
        }
    }
    let mut stiffness = Matrix3::zeros();
    for axis in 0..3 {
        for (i, (row, geometry)) in rows.iter().zip(&contact.geometry).enumerate() {
            let start = n * axis + 3 * i;
            let share = Vector3::from_column_slice(&pushed[start..start + 3]);
            if row.tool == tool {
                stiffness.set_column(axis, &(stiffness.column(axis) + share));
            }
            for (a, across) in geometry.tangents.iter().enumerate() {
                along[t * axis + 2 * i + a] = across.dot(&share);
            }
        }
    }
    let slides = &mut work.slides[..3 * t];
    slides.copy_from_slice(along);
    contact
        .dense
        .solve(&contact.tangential[..t * t], t, slides, 3);
    for i in 0..3 {
        for j in 0..3 {
            let along = &along[t * i..t * (i + 1)];
            let slides = &slides[t * j..t * (j + 1)];
            stiffness[(i, j)] -= along.iter().zip(slides).map(|(a, b)| a * b).sum::<f64>();
        }
    }
    // Symmetric up to round-off; make it so to the last bit.
    -(stiffness + stiffness.transpose()) * 0.5
}

/// Wrench about the grip and its derivative by the grip's pose, from force and tangent at the
/// sphere's centre and the arm from grip to centre.
pub(crate) fn at_grip(
    force: &Vector3<f64>,
    centre_tangent: &Matrix3<f64>,
    arm: &Vector3<f64>,
) -> ([f64; 6], [[f64; 6]; 6]) {
    let moment = arm.cross(force);
    let turn = arm.cross_matrix();
    let mut tangent = Matrix6::zeros();
    let mixed = -centre_tangent * turn;
    tangent
        .fixed_view_mut::<3, 3>(0, 0)
        .copy_from(centre_tangent);
    tangent.fixed_view_mut::<3, 3>(0, 3).copy_from(&mixed);
    tangent
        .fixed_view_mut::<3, 3>(3, 0)
        .copy_from(&mixed.transpose());
    let rotations = turn * mixed + force.cross_matrix() * turn;
    tangent.fixed_view_mut::<3, 3>(3, 3).copy_from(&rotations);

    let mut rows = [[0.0; 6]; 6];
    for (i, row) in rows.iter_mut().enumerate() {
        for (j, entry) in row.iter_mut().enumerate() {
            *entry = tangent[(i, j)];
        }
    }
    (
        [force.x, force.y, force.z, moment.x, moment.y, moment.z],
        rows,
    )
}
