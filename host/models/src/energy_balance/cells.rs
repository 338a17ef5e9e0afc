//! Cells in batches that share no node, and the visit that every form makes of them.
//!
//! Entry points: [`Cells::new`], [`visit`]. The cells of a batch lie side by side, so that one register holds
//! the same number of all of them; as none shares a node with another, what a batch adds to nodes never
//! meets itself, and a batch may move its nodes before the next one looks.

use super::density::{Moduli, Square, neo_hookean, st_venant_kirchhoff, times, volume};
use super::number::{Float, Number};
use crate::BuildError;
use crate::law::Law;
use nalgebra::{Matrix3, Vector3};
use pulp::Simd;
use std::ops::Range;
use sutura_mesh::{TetMesh, signed_volume};

/// Cells side by side; a place without a cell has no volume and the node after the last.
#[derive(Clone, Debug)]
pub(super) struct Batch<T, const L: usize> {
    pub nodes: [[u32; L]; 4],
    /// Gradients of the shape functions of nodes 1, 2, 3 at rest \[1/m\].
    pub gradients: [[T; L]; 9],
    /// Moduli times volume \[J\].
    pub mu: [T; L],
    pub bulk: [T; L],
    pub eta: [T; L],
    pub fibre: [[T; L]; 3],
}

/// Cells of a mesh, by law.
#[derive(Clone, Debug)]
pub(super) struct Cells<T, const L: usize> {
    pub batches: Vec<Batch<T, L>>,
    /// Batches of St Venant-Kirchhoff, neo-Hookean, fibred cells.
    pub runs: [Range<usize>; 3],
}

/// One cell at rest.
pub(super) struct Rest {
    /// Gradients of its shape functions \[1/m\].
    pub gradients: [Vector3<f64>; 4],
    /// Volume \[m^3\].
    pub volume: f64,
}

impl Rest {
    pub fn of(mesh: &TetMesh, cell: [u32; 4]) -> Self {
        let corners = mesh.corners(cell);
        let volume = signed_volume(&corners);
        let [a, b, c] = [1, 2, 3].map(|k| corners[k] - corners[0]);
        let six = 6.0 * volume;
        let own = [b.cross(&c) / six, c.cross(&a) / six, a.cross(&b) / six];
        Self {
            gradients: [-(own[0] + own[1] + own[2]), own[0], own[1], own[2]],
            volume,
        }
    }
}

/// The law of a cell, of one for all or one for each.
pub(super) fn law_of(laws: &[Law], cell: usize) -> &Law {
    &laws[if laws.len() == 1 { 0 } else { cell }]
}

/// # Errors
/// A count that does not fit, a modulus out of range.
pub(super) fn check(laws: &[Law], cells: usize) -> Result<(), BuildError> {
    if laws.len() != 1 && laws.len() != cells {
        return Err(BuildError::Count {
            what: "laws",
            given: laws.len(),
            cells,
        });
    }
    let setting = |name, value, fits, limit| {
        if fits {
            Ok(())
        } else {
            Err(BuildError::Setting { name, value, limit })
        }
    };
    for law in laws {
        let positive = |x: f64| x.is_finite() && x > 0.0;
        match *law {
            Law::StVenantKirchhoff { lambda, mu } => {
                setting("mu", mu, positive(mu), "finite and above zero")?;
                let bulk = lambda + 2.0 / 3.0 * mu;
                setting(
                    "bulk modulus",
                    bulk,
                    positive(bulk),
                    "finite and above zero",
                )?;
            }
            Law::NeoHookean {
                mu,
                kappa,
                eta,
                fibre,
            } => {
                setting("mu", mu, positive(mu), "finite and above zero")?;
                setting("kappa", kappa, positive(kappa), "finite and above zero")?;
                let fits = eta.is_finite() && eta >= 0.0;
                setting("eta", eta, fits, "finite and not below zero")?;
                let length = fibre.norm();
                let fits = eta == 0.0 || (length - 1.0).abs() < 1e-6;
                setting("length of a fibre's direction", length, fits, "1")?;
            }
        }
    }
    Ok(())
}

fn kind(law: &Law) -> usize {
    match law {
        Law::StVenantKirchhoff { .. } => 0,
        Law::NeoHookean { eta: 0.0, .. } => 1,
        Law::NeoHookean { .. } => 2,
    }
}

impl<T: Float, const L: usize> Cells<T, L> {
    /// Batches of checked laws.
    pub fn new(mesh: &TetMesh, laws: &[Law]) -> Self {
        let mut batches = Vec::new();
        let runs = [0, 1, 2].map(|run| {
            let begin = batches.len();
            let of_kind = |&cell: &usize| kind(law_of(laws, cell)) == run;
            // In the same order whatever the precision.
            for group in disjoint::<8>(mesh, (0..mesh.cells().len()).filter(of_kind)) {
                for cells in group.chunks(L) {
                    batches.push(Batch::new(mesh, laws, cells));
                }
            }
            begin..batches.len()
        });
        Self { batches, runs }
    }
}

/// Groups of up to `L` cells of which no two share a node: each cell goes into the oldest open group that
/// takes it.
fn disjoint<const L: usize>(mesh: &TetMesh, cells: impl Iterator<Item = usize>) -> Vec<Vec<usize>> {
    let mut groups: Vec<Vec<usize>> = Vec::new();
    let mut open: Vec<usize> = Vec::new();
    for cell in cells {
        let nodes = mesh.cells()[cell];
        let apart = |other: &usize| !mesh.cells()[*other].iter().any(|node| nodes.contains(node));
        let place = open.iter().position(|g| groups[*g].iter().all(apart));
        let group = if let Some(place) = place {
            let group = open[place];
            if groups[group].len() + 1 == L {
                open.remove(place);
            }
            group
        } else {
            groups.push(Vec::with_capacity(L));
            open.push(groups.len() - 1);
            groups.len() - 1
        };
        groups[group].push(cell);
    }
    groups
}

impl<T: Float, const L: usize> Batch<T, L> {
    fn new(mesh: &TetMesh, laws: &[Law], group: &[usize]) -> Self {
        let none = [T::default(); L];
        let mut batch = Self {
            nodes: [[mesh.points_m().len() as u32; L]; 4],
            gradients: [none; 9],
            mu: none,
            bulk: none,
            eta: none,
            fibre: [none; 3],
        };
        for (lane, &cell) in group.iter().enumerate() {
            let nodes = mesh.cells()[cell];
            let rest = Rest::of(mesh, nodes);
            for k in 0..4 {
                batch.nodes[k][lane] = nodes[k];
            }
            for k in 0..9 {
                batch.gradients[k][lane] = T::of(rest.gradients[1 + k / 3][k % 3]);
            }
            let (mu, bulk, eta, fibre) = match *law_of(laws, cell) {
                Law::StVenantKirchhoff { lambda, mu } => (mu, lambda, 0.0, Vector3::zeros()),
                Law::NeoHookean {
                    mu,
                    kappa,
                    eta,
                    fibre,
                } => (mu, kappa, eta, fibre),
            };
            batch.mu[lane] = T::of(mu * rest.volume);
            batch.bulk[lane] = T::of(bulk * rest.volume);
            batch.eta[lane] = T::of(eta * rest.volume);
            for k in 0..3 {
                batch.fibre[k][lane] = T::of(fibre[k]);
            }
        }
        batch
    }
}

/// What a visit finds out about a batch.
#[derive(Clone, Copy, Debug)]
pub(super) struct Found<T, const L: usize> {
    /// Gradient of the energy by the positions of nodes 0, 1, 2, 3 \[N\].
    pub gradient: [[T; L]; 12],
    /// Energy \[J\], where it was asked for.
    pub energy: [T; L],
}

/// What a form does with what a visit finds.
pub(super) trait Form<T: Float, const L: usize> {
    /// Whether energies are wanted.
    const ENERGY: bool;
    /// Present displacement of every node \[m\], and of none, (n + 1).
    fn displacement(&self) -> &[[T; 4]];
    /// Takes what was found about batch `index`.
    fn take(&mut self, index: usize, batch: &Batch<T, L>, found: &Found<T, L>);
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
    F: Form<T, L>,
{
    let [first, second, third] = &cells.runs;
    let empty = memory.stress.is_empty();
    for index in first.clone() {
        one::<S, T, F, L, 0>(simd, index, &cells.batches[index], memory, form);
    }
    for index in second.clone() {
        if empty {
            one::<S, T, F, L, 1>(simd, index, &cells.batches[index], memory, form);
        } else {
            one::<S, T, F, L, 3>(simd, index, &cells.batches[index], memory, form);
        }
    }
    for index in third.clone() {
        one::<S, T, F, L, 2>(simd, index, &cells.batches[index], memory, form);
    }
}

/// Displacement gradient of the lanes from `from` on.
#[inline(always)]
fn gradient_of<S, N, const L: usize>(
    simd: S,
    from: usize,
    batch: &Batch<N::Float, L>,
    corners: &[[N::Float; L]; 12],
) -> (Square<N>, [[N; 3]; 3])
where
    S: Simd,
    N: Number<S>,
{
    let load = |row: &[N::Float; L]| N::load(simd, &row[from..]);
    let zero = [0, 1, 2].map(|c| load(&corners[c]));
    let g = [0, 1, 2].map(|k| [0, 1, 2].map(|c| load(&batch.gradients[3 * k + c])));
    let by = [1, 2, 3].map(|k| [0, 1, 2].map(|c| load(&corners[3 * k + c]) - zero[c]));
    let h = [0, 1, 2].map(|r| {
        [0, 1, 2].map(|c| by[2][r].fma(g[2][c], by[1][r].fma(g[1][c], by[0][r] * g[0][c])))
    });
    (h, g)
}

/// Displacements of a batch's nodes, lane by lane.
#[inline(always)]
pub(super) fn gather<T: Float, const L: usize>(
    nodes: &[[u32; L]; 4],
    displacement: &[[T; 4]],
) -> [[T; L]; 12] {
    let mut corners = [[T::default(); L]; 12];
    for k in 0..4 {
        for lane in 0..L {
            let at = displacement[nodes[k][lane] as usize];
            for c in 0..3 {
                corners[3 * k + c][lane] = at[c];
            }
        }
    }
    corners
}

/// One batch of law `KIND`: 0 St Venant-Kirchhoff, 1 neo-Hookean, 2 fibred, 3 neo-Hookean with memory.
#[inline(always)]
fn one<S, T, F, const L: usize, const KIND: u8>(
    simd: S,
    index: usize,
    batch: &Batch<T, L>,
    memory: Memory<'_, T, L>,
    form: &mut F,
) where
    S: Simd,
    T: Float,
    F: Form<T, L>,
{
    let corners = gather(&batch.nodes, form.displacement());
    let mut found = Found {
        gradient: [[T::default(); L]; 12],
        energy: [T::default(); L],
    };
    for group in 0..L / <T::Number<S> as Number<S>>::LANES {
        let from = group * <T::Number<S> as Number<S>>::LANES;
        let (h, g) = gradient_of::<S, T::Number<S>, L>(simd, from, batch, &corners);
        let load = |row: &[T; L]| T::Number::<S>::load(simd, &row[from..]);
        let moduli = Moduli {
            mu: load(&batch.mu),
            bulk: load(&batch.bulk),
            eta: load(&batch.eta),
            fibre: [0, 1, 2].map(|k| load(&batch.fibre[k])),
        };
        let (mut energy, mut p) = match (KIND, F::ENERGY) {
            (0, _) => st_venant_kirchhoff(&h, &moduli),
            (2, true) => neo_hookean::<S, _, true, true>(&h, &moduli),
            (2, false) => neo_hookean::<S, _, true, false>(&h, &moduli),
            (_, true) => neo_hookean::<S, _, false, true>(&h, &moduli),
            (_, false) => neo_hookean::<S, _, false, false>(&h, &moduli),
        };
        if KIND != 1
            && let Some(memory_of) = memory.stress.get(index)
        {
            let [xx, yy, zz, yz, xz, xy] = [0, 1, 2, 3, 4, 5].map(|k| load(&memory_of[k]));
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
        for r in 0..3 {
            let of = |k: usize| p[r][2].fma(g[k][2], p[r][1].fma(g[k][1], p[r][0] * g[k][0]));
            let forces = [of(0), of(1), of(2)];
            for k in 0..3 {
                forces[k].store(&mut found.gradient[3 * (k + 1) + r][from..]);
            }
            (-(forces[0] + forces[1] + forces[2])).store(&mut found.gradient[r][from..]);
        }
        if F::ENERGY {
            energy.store(&mut found.energy[from..]);
        }
    }
    form.take(index, batch, &found);
}

/// Second Piola-Kirchhoff stress times volume \[J\] of one place of a batch: xx, yy, zz, yz, xz, xy.
/// `gradient` is that of the law alone.
pub(super) fn second_stress<T: Float, const L: usize>(
    batch: &Batch<T, L>,
    lane: usize,
    corners: &[[T; L]; 12],
    law: usize,
) -> [f64; 6] {
    let at = |row: &[T; L]| row[lane].wide();
    let mut h = [[0.0; 3]; 3];
    for (r, row) in h.iter_mut().enumerate() {
        for (c, entry) in row.iter_mut().enumerate() {
            for k in 0..3 {
                *entry += (at(&corners[3 * (k + 1) + r]) - at(&corners[r]))
                    * at(&batch.gradients[3 * k + c]);
            }
        }
    }
    let moduli = Moduli {
        mu: at(&batch.mu),
        bulk: at(&batch.bulk),
        eta: at(&batch.eta),
        fibre: [0, 1, 2].map(|k| at(&batch.fibre[k])),
    };
    let (_, p) = if law == 0 {
        st_venant_kirchhoff::<pulp::Scalar, f64>(&h, &moduli)
    } else {
        neo_hookean::<pulp::Scalar, f64, true, false>(&h, &moduli)
    };
    let (e, cofactors) = volume::<pulp::Scalar, f64>(&h);
    let cofactors = Matrix3::identity() + Matrix3::from_fn(|r, c| cofactors[r][c]);
    let s = cofactors.transpose() * Matrix3::from_fn(|r, c| p[r][c]) / (1.0 + e);
    let mean = |r: usize, c: usize| 0.5 * (s[(r, c)] + s[(c, r)]);
    [
        s[(0, 0)],
        s[(1, 1)],
        s[(2, 2)],
        mean(1, 2),
        mean(0, 2),
        mean(0, 1),
    ]
}
