//! One corotational cell: deformation gradient, forces, and the consistent tangent.
//!
//! Entry points: [`gradient`], [`stress`], [`twist`], [`tangent_blocks`], [`tangent_stress`]. With
//! P = dpsi/dF = 2 mu F + c R, c = lambda tr(S - I) - 2 mu, and dR = R \[w\], (tr(S) I - S) w =
//! axial(R'dF - dF'R):  dP = 2 mu dF + R (lambda tr(R'dF) I + c \[w\]).

use super::super::element::Element;
use super::super::rotation::{Polar, inverse, twice_axial, twist_matrix};
use super::TangentKind;
use nalgebra::{Matrix3, Vector3};

/// A field in the order of places: three numbers each.
pub(super) type Field = [[f64; 3]];

/// sum u_a g_a', the displacement gradient of a cell.
#[inline]
pub(super) fn gradient(element: &Element, u: &Field) -> Matrix3<f64> {
    let [u0, u1, u2, u3] = element.nodes.map(|place| Vector3::from(u[place as usize]));
    let [_, g1, g2, g3] = &element.gradients;
    (u1 - u0) * g1.transpose() + (u2 - u0) * g2.transpose() + (u3 - u0) * g3.transpose()
}

/// Adds the corners' forces V P g_a to a field.
#[inline]
pub(super) fn add_force(element: &Element, stress: &Matrix3<f64>, force: &mut Field) {
    let stress = stress * element.volume_m3;
    let [_, g1, g2, g3] = &element.gradients;
    let (f1, f2, f3) = (stress * g1, stress * g2, stress * g3);
    for (place, f) in element.nodes.iter().zip([-(f1 + f2 + f3), f1, f2, f3]) {
        let sum = &mut force[*place as usize];
        sum[0] += f.x;
        sum[1] += f.y;
        sum[2] += f.z;
    }
}

/// lambda tr(S - I) - 2 mu, the part of P that turns with R \[Pa\].
#[inline]
fn turning(element: &Element, stretch: &Matrix3<f64>) -> f64 {
    let (lambda, mu) = element.lame;
    lambda * (stretch.trace() - 3.0) - 2.0 * mu
}

/// First Piola-Kirchhoff stress \[Pa\].
#[inline]
pub(super) fn stress(element: &Element, f: &Matrix3<f64>, polar: &Polar) -> Matrix3<f64> {
    f * (2.0 * element.lame.1) + polar.rotation * turning(element, &polar.stretch)
}

/// Energy \[J\].
pub(super) fn energy(element: &Element, stretch: &Matrix3<f64>) -> f64 {
    let (lambda, mu) = element.lame;
    let strain = stretch - Matrix3::identity();
    element.volume_m3 * (mu * strain.norm_squared() + 0.5 * lambda * strain.trace().powi(2))
}

/// Stress 2 mu (S - I) + lambda tr(S - I) I in the frame that turns with the cell, turned back into
/// the world's \[Pa\].
pub(super) fn rotated_stress(element: &Element, polar: &Polar) -> Matrix3<f64> {
    let (lambda, mu) = element.lame;
    let strain = polar.stretch - Matrix3::identity();
    let stress = strain * (2.0 * mu) + Matrix3::from_diagonal_element(lambda * strain.trace());
    polar.rotation * stress * polar.rotation.transpose()
}

/// c (tr(S) I - S)^-1 in the cell's frame \[Pa\]: from the spin of R'dF to the stress that its turning
/// gives. The rotated stiffness R K R' has -mu I here, which is also the least that keeps a cell's
/// stiffness positive semidefinite.
#[inline]
pub(super) fn twist(element: &Element, stretch: &Matrix3<f64>, kind: TangentKind) -> Matrix3<f64> {
    let mu = element.lame.1;
    let c = turning(element, stretch);
    let matrix = twist_matrix(stretch);
    let convex =
        || c >= 0.0 || inverse(&(matrix + Matrix3::from_diagonal_element(c / mu))).is_some();
    match inverse(&matrix) {
        Some(inverse) if kind == TangentKind::Consistent || convex() => inverse * c,
        _ => Matrix3::from_diagonal_element(-mu),
    }
}

/// dP for a displacement gradient dF \[Pa\].
#[inline]
pub(super) fn tangent_stress(
    element: &Element,
    rotation: &Matrix3<f64>,
    twist: &Matrix3<f64>,
    df: &Matrix3<f64>,
) -> Matrix3<f64> {
    let (lambda, mu) = element.lame;
    let turned = rotation.tr_mul(df);
    let mut inner = (twist * twice_axial(&turned)).cross_matrix();
    let pressure = lambda * turned.trace();
    for axis in 0..3 {
        inner[(axis, axis)] += pressure;
    }
    df * (2.0 * mu) + rotation * inner
}

/// Blocks of the tangent \[N/m\] between corners a >= b, in the order of a cell's pairs: with h = R g,
/// V (2 mu g_a.g_b I + lambda h_a h_b' + \[h_a\]' T \[h_b\]), T the twist in the world's frame.
#[inline]
pub(super) fn tangent_blocks(
    element: &Element,
    rotation: &Matrix3<f64>,
    twist: &Matrix3<f64>,
) -> [Matrix3<f64>; 10] {
    let (lambda, mu) = element.lame;
    let volume = element.volume_m3;
    let [_, g1, g2, g3] = &element.gradients;
    let h = [rotation * g1, rotation * g2, rotation * g3];
    let twist = rotation * (twist * volume) * rotation.transpose();
    let twisted = h.map(|h| twist * h.cross_matrix());
    let block = |a: usize, b: usize| {
        let (ha, hb) = (&h[a], &h[b]);
        let shear = 2.0 * mu * volume * ha.dot(hb);
        let column = |j: usize| twisted[b].column(j).cross(ha) + ha * (lambda * volume * hb[j]);
        let mut block = Matrix3::from_columns(&[column(0), column(1), column(2)]);
        for axis in 0..3 {
            block[(axis, axis)] += shear;
        }
        block
    };
    let (k11, k21, k22) = (block(0, 0), block(1, 0), block(1, 1));
    let (k31, k32, k33) = (block(2, 0), block(2, 1), block(2, 2));
    // A translation gives no force.
    let k10 = -(k11 + k21.transpose() + k31.transpose());
    let k20 = -(k21 + k22 + k32.transpose());
    let k30 = -(k31 + k32 + k33);
    let k00 = -(k10 + k20 + k30);
    [k00, k10, k11, k20, k21, k22, k30, k31, k32, k33]
}
