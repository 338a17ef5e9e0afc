//! The visit that every form makes of the cells: displacements in, forces out.
//!
//! Entry points: [`visit`], [`second_stress`]. Written once for one cell at a time and for a register of them.

use super::cells::{Batch, Cells};
use super::density::{Moduli, Square, neo_hookean, st_venant_kirchhoff, times, volume};
use super::nodes::Rows;
use super::number::{Float, Number};
use pulp::Simd;

/// Cells of a batch that are computed at once.
#[derive(Clone, Copy)]
pub(super) struct Group<'a> {
    /// The batch, and the first of its places.
    pub batch: usize,
    pub from: usize,
    /// Nodes 0 to 3 of every cell.
    pub nodes: [&'a [u16]; 4],
}

/// What a visit finds out about a group.
#[derive(Clone, Copy)]
pub(super) struct Found<N> {
    /// What [`Form::field`] says of nodes 0 to 3.
    pub corners: [[N; 4]; 4],
    /// Gradient of the energy by the positions of nodes 0 to 3 \[N\].
    pub gradient: [[N; 3]; 4],
    /// Energy \[J\], where it was asked for.
    pub energy: N,
}

/// Adds three numbers of nodes 0 to 3 of a group to what the nodes have; the fourth then has no meaning. Written out:
/// a loop of this size would go through memory.
#[inline(always)]
pub(super) fn add_to_nodes<S: Simd, N: Number<S>>(
    values: [[N; 3]; 4],
    field: &mut Rows<N::Float>,
    group: Group<'_>,
) {
    let [a, b, c, d] = values;
    N::add_to([a[0], a[1], a[2], a[2]], field, group.nodes[0]);
    N::add_to([b[0], b[1], b[2], b[2]], field, group.nodes[1]);
    N::add_to([c[0], c[1], c[2], c[2]], field, group.nodes[2]);
    N::add_to([d[0], d[1], d[2], d[2]], field, group.nodes[3]);
}

/// What a form does with what a visit finds.
pub(super) trait Form<S: Simd, T: Float> {
    /// Whether energies are wanted.
    const ENERGY: bool;
    /// Present displacement of every node \[m\], and of none, (n + 1); the fourth number is the form's own.
    fn field(&self) -> &Rows<T>;
    fn take(&mut self, group: Group<'_>, found: Found<T::Number<S>>);
}

/// Stress that viscoelastic cells remember.
#[derive(Clone, Copy, Debug)]
pub(super) struct Memory<'a, T, const L: usize> {
    /// Share of the law's stress that acts at once.
    pub share: f64,
    /// What is taken off the second Piola-Kirchhoff stress, times volume \[J\]: xx, yy, zz, yz, xz, xy of
    /// each batch; empty: elastic.
    pub stress: &'a [[[T; L]; 6]],
}

/// Visits every batch in order.
#[inline(always)]
pub(super) fn visit<S, T, F, const L: usize>(
    simd: S,
    cells: &Cells<T, L>,
    memory: Memory<'_, T, L>,
    form: &mut F,
) where
    S: Simd,
    T: Float,
    F: Form<S, T>,
{
    let [first, second, third] = cells.runs.clone();
    run::<S, T, F, L, 0>(simd, cells, first, memory, form);
    run::<S, T, F, L, 1>(simd, cells, second, memory, form);
    run::<S, T, F, L, 2>(simd, cells, third, memory, form);
}

/// Batches of one law: 0 St Venant-Kirchhoff, 1 neo-Hookean, 2 fibred.
#[inline(always)]
fn run<S, T, F, const L: usize, const LAW: u8>(
    simd: S,
    cells: &Cells<T, L>,
    batches: std::ops::Range<usize>,
    memory: Memory<'_, T, L>,
    form: &mut F,
) where
    S: Simd,
    T: Float,
    F: Form<S, T>,
{
    let lanes = <T::Number<S> as Number<S>>::LANES;
    let first = batches.start;
    for (index, batch) in cells.batches[batches].iter().enumerate() {
        for from in (0..L).step_by(lanes) {
            let to = from + lanes;
            let group = Group {
                batch: first + index,
                from,
                nodes: [
                    &batch.nodes[0][from..to],
                    &batch.nodes[1][from..to],
                    &batch.nodes[2][from..to],
                    &batch.nodes[3][from..to],
                ],
            };
            let found = one::<S, T, F, L, LAW>(simd, batch, group, memory, form);
            form.take(group, found);
        }
    }
}

/// Displacement gradient; gradients of the shape functions of nodes 1, 2, 3.
#[inline(always)]
fn displacement_gradient<S, N, const L: usize>(
    simd: S,
    batch: &Batch<N::Float, L>,
    from: usize,
    corners: &[[N; 4]; 4],
) -> (Square<N>, [[N; 3]; 3])
where
    S: Simd,
    N: Number<S>,
{
    let mut g = [[corners[0][0]; 3]; 3];
    let mut by = g;
    for k in 0..3 {
        for c in 0..3 {
            g[k][c] = N::load(simd, &batch.gradients[3 * k + c][from..]);
            by[k][c] = corners[k + 1][c] - corners[0][c];
        }
    }
    let mut h = g;
    for r in 0..3 {
        for c in 0..3 {
            h[r][c] = by[2][r].fma(g[2][c], by[1][r].fma(g[1][c], by[0][r] * g[0][c]));
        }
    }
    (h, g)
}

#[inline(always)]
fn moduli<S, N, const L: usize>(simd: S, batch: &Batch<N::Float, L>, from: usize) -> Moduli<N>
where
    S: Simd,
    N: Number<S>,
{
    Moduli {
        mu: N::load(simd, &batch.mu[from..]),
        bulk: N::load(simd, &batch.bulk[from..]),
        eta: N::load(simd, &batch.eta[from..]),
        fibre: [
            N::load(simd, &batch.fibre[0][from..]),
            N::load(simd, &batch.fibre[1][from..]),
            N::load(simd, &batch.fibre[2][from..]),
        ],
    }
}

#[inline(always)]
fn one<S, T, F, const L: usize, const LAW: u8>(
    simd: S,
    batch: &Batch<T, L>,
    group: Group<'_>,
    memory: Memory<'_, T, L>,
    form: &F,
) -> Found<T::Number<S>>
where
    S: Simd,
    T: Float,
    F: Form<S, T>,
{
    let from = group.from;
    let corners = [
        T::Number::gather(simd, form.field(), group.nodes[0]),
        T::Number::gather(simd, form.field(), group.nodes[1]),
        T::Number::gather(simd, form.field(), group.nodes[2]),
        T::Number::gather(simd, form.field(), group.nodes[3]),
    ];
    let (h, g) = displacement_gradient::<S, T::Number<S>, L>(simd, batch, from, &corners);
    let moduli = moduli(simd, batch, from);
    let (mut energy, mut p) = match (LAW, F::ENERGY) {
        (0, _) => st_venant_kirchhoff(&h, &moduli),
        (1, true) => neo_hookean::<S, _, false, true>(&h, &moduli),
        (1, false) => neo_hookean::<S, _, false, false>(&h, &moduli),
        (_, true) => neo_hookean::<S, _, true, true>(&h, &moduli),
        (_, false) => neo_hookean::<S, _, true, false>(&h, &moduli),
    };
    // Asked here, not by a second copy of this function for each law: those took as long to compile as all else.
    if let Some(stress) = memory.stress.get(group.batch) {
        let mut terms = [energy; 6];
        for (term, stored) in terms.iter_mut().zip(stress) {
            *term = T::Number::load(simd, &stored[from..]);
        }
        let [xx, yy, zz, yz, xz, xy] = terms;
        let less = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]];
        let share = xx.like(memory.share);
        let off = times(&h, &less);
        let half = xx.like(0.5);
        energy = energy * share;
        for r in 0..3 {
            for c in 0..3 {
                // E = sym H + H'H / 2, so S : E = S : H + (S H') : H' / 2.
                energy = energy - half * (less[r][c] + off[r][c]) * h[r][c];
                p[r][c] = p[r][c].fma(share, -off[r][c]);
            }
        }
    }
    let mut gradient = [[energy; 3]; 4];
    for r in 0..3 {
        for k in 0..3 {
            gradient[k + 1][r] = p[r][2].fma(g[k][2], p[r][1].fma(g[k][1], p[r][0] * g[k][0]));
        }
        gradient[0][r] = -(gradient[1][r] + gradient[2][r] + gradient[3][r]);
    }
    Found {
        corners,
        gradient,
        energy,
    }
}

/// Second Piola-Kirchhoff stress of the law alone, times volume \[J\], of cells displaced by `field` (n + 1): xx, yy, zz,
/// yz, xz, xy.
#[inline(always)]
pub(super) fn second_stress<S, T, const L: usize, const LAW: u8>(
    simd: S,
    batch: &Batch<T, L>,
    from: usize,
    field: &Rows<T>,
) -> [T::Number<S>; 6]
where
    S: Simd,
    T: Float,
{
    let corners = [
        T::Number::gather(simd, field, &batch.nodes[0][from..]),
        T::Number::gather(simd, field, &batch.nodes[1][from..]),
        T::Number::gather(simd, field, &batch.nodes[2][from..]),
        T::Number::gather(simd, field, &batch.nodes[3][from..]),
    ];
    let (h, _) = displacement_gradient::<S, T::Number<S>, L>(simd, batch, from, &corners);
    let moduli = moduli(simd, batch, from);
    let (_, p) = match LAW {
        0 => st_venant_kirchhoff(&h, &moduli),
        1 => neo_hookean::<S, _, false, false>(&h, &moduli),
        _ => neo_hookean::<S, _, true, false>(&h, &moduli),
    };
    // S = F^-1 P = cof F' P / J.
    let (e, cofactors) = volume(&h);
    let part = e.like(1.0) / (e + e.like(1.0));
    let mut s = p;
    for r in 0..3 {
        for c in 0..3 {
            let sum = cofactors[0][r].fma(p[0][c], cofactors[1][r] * p[1][c]);
            s[r][c] = part * (p[r][c] + cofactors[2][r].fma(p[2][c], sum));
        }
    }
    let half = e.like(0.5);
    [
        s[0][0],
        s[1][1],
        s[2][2],
        half * (s[1][2] + s[2][1]),
        half * (s[0][2] + s[2][0]),
        half * (s[0][1] + s[1][0]),
    ]
}
