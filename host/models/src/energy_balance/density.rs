//! Energy and stress of one cell, of its displacement gradient, in any [`Number`].
//!
//! Entry points: [`neo_hookean`], [`st_venant_kirchhoff`]. The laws of zhang-2017, 5.2.5, rewritten in
//! H = F - I so that no digit is lost near rest, where single precision has few. Below a fifth and above five
//! times its volume a neo-Hookean cell follows the second-order expansion of J^(-2/3) about that volume:
//! energy and stress stay finite and smooth through inversion, and the stress leads back.

use super::number::{HIGH, LOW, Number};
use pulp::Simd;

/// Moduli times a cell's volume, and its fibres.
#[derive(Clone, Copy)]
pub(super) struct Moduli<N> {
    /// Shear modulus \[J\].
    pub mu: N,
    /// Bulk modulus, or the first Lame parameter of St Venant-Kirchhoff \[J\].
    pub bulk: N,
    /// Modulus of the fibres \[J\]; not read without.
    pub eta: N,
    pub fibre: [N; 3],
}

/// A 3 x 3 matrix, row by row.
pub(super) type Square<N> = [[N; 3]; 3];

#[inline(always)]
fn cofactor<S: Simd, N: Number<S>>(h: &Square<N>) -> Square<N> {
    let mut cofactor = *h;
    for r in 0..3 {
        for c in 0..3 {
            let (a, b, d, e) = ((r + 1) % 3, (r + 2) % 3, (c + 1) % 3, (c + 2) % 3);
            cofactor[r][c] = h[a][e].fnma(h[b][d], h[a][d] * h[b][e]);
        }
    }
    cofactor
}

#[inline(always)]
fn squares<S: Simd, N: Number<S>>(h: &Square<N>) -> N {
    let mut sums = h[0];
    for c in 0..3 {
        sums[c] = h[2][c].fma(h[2][c], h[1][c].fma(h[1][c], h[0][c] * h[0][c]));
    }
    sums[0] + sums[1] + sums[2]
}

/// Volume ratio less one, cofactors of F less the identity, of H.
#[inline(always)]
pub(super) fn volume<S: Simd, N: Number<S>>(h: &Square<N>) -> (N, Square<N>) {
    let second = cofactor(h);
    let trace = h[0][0] + h[1][1] + h[2][2];
    let minors = second[0][0] + second[1][1] + second[2][2];
    let third = h[0][2].fma(
        second[0][2],
        h[0][1].fma(second[0][1], h[0][0] * second[0][0]),
    );
    let mut first = second;
    for r in 0..3 {
        for c in 0..3 {
            first[r][c] = first[r][c] - h[c][r];
        }
        first[r][r] = first[r][r] + trace;
    }
    (trace + minors + third, first)
}

/// Energy (where `ENERGY`) and first Piola-Kirchhoff stress of the neo-Hookean law (5.35), with fibres
/// (5.37) where `FIBRES`, of H.
#[inline(always)]
pub(super) fn neo_hookean<S, N, const FIBRES: bool, const ENERGY: bool>(
    h: &Square<N>,
    m: &Moduli<N>,
) -> (N, Square<N>)
where
    S: Simd,
    N: Number<S>,
{
    let one = m.mu.like(1.0);
    let half = m.mu.like(0.5);
    let two = m.mu.like(2.0);
    let two_thirds = m.mu.like(-2.0 / 3.0);
    let five_ninths = m.mu.like(5.0 / 9.0);
    let trace = h[0][0] + h[1][1] + h[2][2];
    let stretch = trace.fma(two, squares(h));
    let (e, cofactors) = volume(h);
    let inside = e.least(m.mu.like(HIGH - 1.0)).most(m.mu.like(LOW - 1.0));
    let r = (inside + one).inverse_cube_root();
    let r2 = r * r;
    let r3 = r2 * r;
    // Zero unless the volume is out of range.
    let beyond = (e - inside) * r3;
    let tail = beyond.fma(five_ninths, two_thirds);
    let shape = (r2 * beyond).fma(tail, r2);
    let d_shape = r2 * r3 * beyond.fma(m.mu.like(10.0 / 9.0), two_thirds);
    // shape + 3/2 d_shape, which is small near rest.
    let slope = r3.fma(m.mu.like(5.0 / 3.0), beyond.fma(five_ninths, two_thirds));
    let even = r2 * beyond.fma(slope, r3 * inside);
    let mut of_cofactors = (m.mu * half * stretch).fma(d_shape, m.bulk * e);
    let mut energy = m.mu;
    let mut pull = m.eta;
    let mut turned = m.fibre;
    let (mut along, mut shape_1) = (m.mu, m.mu);
    if FIBRES || ENERGY {
        let one_less = inside * r3 / (r2 + r + one);
        shape_1 = (r2 * beyond).fma(tail, -(one_less * (r + one)));
    }
    if FIBRES {
        let a = &m.fibre;
        for (k, row) in h.iter().enumerate() {
            turned[k] = row[2].fma(a[2], row[1].fma(a[1], row[0] * a[0]));
        }
        let mut i4 = turned[2].fma(turned[2], turned[1].fma(turned[1], turned[0] * turned[0]));
        let projected = turned[2].fma(a[2], turned[1].fma(a[1], turned[0] * a[0]));
        i4 = projected.fma(two, i4);
        along = shape.fma(i4, shape_1);
        for k in 0..3 {
            turned[k] = turned[k] + a[k];
        }
        pull = m.eta * along * two;
        of_cofactors = (pull * half * d_shape).fma(i4 + one, of_cofactors);
        pull = pull * shape;
    }
    let of_identity = m.mu.fma(even, of_cofactors);
    let of_first = (m.mu * m.mu.like(1.5)).fma(d_shape, of_cofactors);
    let of_h = m.mu * shape;
    let mut p = cofactors;
    for row in 0..3 {
        for column in 0..3 {
            let mut entry = of_h.fma(h[row][column], of_first * cofactors[row][column]);
            if row == column {
                entry = entry + of_identity;
            }
            if FIBRES {
                entry = (pull * turned[row]).fma(m.fibre[column], entry);
            }
            p[row][column] = entry;
        }
    }
    if ENERGY {
        let isochoric = shape.fma(stretch, shape_1 * m.mu.like(3.0));
        energy = (m.mu * half).fma(isochoric, m.bulk * half * e * e);
        if FIBRES {
            energy = (m.eta * half * along).fma(along, energy);
        }
    }
    (energy, p)
}

/// Energy and first Piola-Kirchhoff stress of the St Venant-Kirchhoff law (5.33), of H.
#[inline(always)]
pub(super) fn st_venant_kirchhoff<S: Simd, N: Number<S>>(
    h: &Square<N>,
    m: &Moduli<N>,
) -> (N, Square<N>) {
    let half = m.mu.like(0.5);
    let mut strain = *h;
    for r in 0..3 {
        for c in 0..3 {
            let product = h[2][r].fma(h[2][c], h[1][r].fma(h[1][c], h[0][r] * h[0][c]));
            strain[r][c] = half * (h[r][c] + h[c][r] + product);
        }
    }
    let trace = strain[0][0] + strain[1][1] + strain[2][2];
    let energy = m.mu.fma(squares(&strain), half * m.bulk * trace * trace);
    let mut s = strain;
    for r in 0..3 {
        for c in 0..3 {
            s[r][c] = m.mu.like(2.0) * m.mu * strain[r][c];
        }
        s[r][r] = m.bulk.fma(trace, s[r][r]);
    }
    (energy, times(h, &s))
}

/// F S of H and a symmetric S: S + H S.
#[inline(always)]
pub(super) fn times<S: Simd, N: Number<S>>(h: &Square<N>, s: &Square<N>) -> Square<N> {
    let mut p = *s;
    for r in 0..3 {
        for c in 0..3 {
            let product = h[r][1].fma(s[1][c], h[r][0] * s[0][c]);
            p[r][c] = s[r][c] + h[r][2].fma(s[2][c], product);
        }
    }
    p
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Material;
    use crate::law::Law;
    use nalgebra::Matrix3;
    use pulp::Scalar;

    const LIVER: Material = Material {
        youngs_modulus_pa: 3_500.0,
        poisson_ratio: 0.49,
    };

    fn both(law: &Law, h: &Matrix3<f64>) -> (f64, Matrix3<f64>) {
        let rows = [0, 1, 2].map(|r| [0, 1, 2].map(|c| h[(r, c)]));
        let (energy, p) = match *law {
            Law::StVenantKirchhoff { lambda, mu } => st_venant_kirchhoff::<Scalar, f64>(
                &rows,
                &Moduli {
                    mu,
                    bulk: lambda,
                    eta: 0.0,
                    fibre: [0.0; 3],
                },
            ),
            Law::NeoHookean {
                mu,
                kappa,
                eta,
                fibre,
            } => neo_hookean::<Scalar, f64, true, true>(
                &rows,
                &Moduli {
                    mu,
                    bulk: kappa,
                    eta,
                    fibre: fibre.into(),
                },
            ),
        };
        (energy, Matrix3::from_fn(|r, c| p[r][c]))
    }

    fn laws() -> [Law; 3] {
        [
            Law::st_venant_kirchhoff(LIVER),
            Law::neo_hookean(LIVER),
            Law::fibred(LIVER, 2_400.0, [1.0, 2.0, -0.5]),
        ]
    }

    fn some(seed: u64, size: f64) -> Matrix3<f64> {
        let mut state = seed;
        Matrix3::from_fn(|_, _| {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            size * ((state >> 40) as f64 / f64::from(1 << 23) - 1.0)
        })
    }

    #[test]
    fn in_range_it_is_the_law() {
        for law in laws() {
            for seed in 0..200 {
                let h = some(seed, 0.3);
                let f = Matrix3::identity() + h;
                let (energy, stress) = both(&law, &h);
                assert!((energy - law.energy(&f)).abs() < 1e-9 * (1.0 + energy));
                let exact = law.stress(&f);
                assert!((stress - exact).norm() < 1e-9 * (1.0 + exact.norm()));
            }
        }
    }

    #[test]
    fn out_of_range_stress_is_still_the_gradient_of_energy() {
        for law in laws() {
            for seed in 0..300 {
                let (h, dh) = (some(seed, 2.5), some(seed + 1000, 1.0));
                let step = 1e-5;
                let ahead = both(&law, &(h + step * dh)).0;
                let behind = both(&law, &(h - step * dh)).0;
                let exact = both(&law, &h).1.dot(&dh);
                let scale = both(&law, &h).1.norm() + 1e4;
                assert!(((ahead - behind) / (2.0 * step) - exact).abs() < 1e-6 * scale);
            }
        }
    }

    #[test]
    fn an_inverted_cell_is_pushed_back() {
        for law in &laws()[1..] {
            for depth in [1.0, 1.2, 2.0, 3.0] {
                let h = Matrix3::from_diagonal(&[-depth, 0.0, 0.0].into());
                let (energy, stress) = both(law, &h);
                assert!(energy.is_finite() && stress[(0, 0)] < 0.0, "{depth}");
            }
        }
    }
}
