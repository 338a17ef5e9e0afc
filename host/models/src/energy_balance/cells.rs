//! Cells in batches that share no node.
//!
//! Entry point: [`Cells::new`]. The cells of a batch lie side by side, so that one register holds the same number
//! of all of them; as none shares a node with another, a batch may move its nodes before the next one looks.

use super::number::Float;
use crate::BuildError;
use crate::law::Law;
use nalgebra::Vector3;
use std::ops::Range;
use sutura_mesh::{TetMesh, signed_volume};

/// Cells side by side; a place without a cell has no volume and the node after the last.
#[derive(Clone, Debug)]
pub(super) struct Batch<T, const L: usize> {
    /// Numbers of nodes 0 to 3; [`super::nodes::Field`] makes sure that they fit.
    pub nodes: [[u16; L]; 4],
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

/// Edge of a regular tetrahedron of the cells' mean volume \[m\].
pub(super) fn edge_m(mesh: &TetMesh) -> f64 {
    let volumes = mesh.cells().iter().map(|cell| Rest::of(mesh, *cell).volume);
    (volumes.sum::<f64>() / mesh.cells().len() as f64 * 72f64.sqrt()).cbrt()
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
            for group in disjoint::<16>(mesh, (0..mesh.cells().len()).filter(of_kind)) {
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
            nodes: [[mesh.points_m().len() as u16; L]; 4],
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
                batch.nodes[k][lane] = nodes[k] as u16;
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
