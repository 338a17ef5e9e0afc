//! Nodes and edges of a mesh as elements and links: neighbours, rest lengths, stiffness, mass.
//!
//! Entry point: [`Links::new`]. A link's stiffness is the sum of E V / l^2 over its cells (van Gelder 1998), times one
//! factor for the mesh: with it a small stretch along x, y and z costs, on average, what Young's modulus asks for.

use super::fours::{End, Fours};
use crate::{BuildError, Materials};
use nalgebra::{Matrix6, Vector3, Vector6};
use sutura_mesh::{TetMesh, signed_volume};

/// A link as either of its elements sees it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Beside {
    /// Square of the rest length \[m^2\].
    pub rest_sq: f64,
    /// The other element.
    pub to: u32,
    /// Its place in [`Links::owned`].
    pub place: u32,
}

/// Elements and links; constant.
#[derive(Clone, Debug)]
pub(super) struct Links {
    /// Rest positions \[m\], (n x 3).
    pub rest_m: Vec<[f64; 3]>,
    /// Mass \[kg\], (n).
    pub mass_kg: Vec<f64>,
    /// Sum of k over the links of each element \[N/m\], (n).
    pub stiffness: Vec<f64>,
    /// Mean of Young's modulus times volume over all cells, summed \[N m\].
    pub modulus_volume: f64,
    /// Longest extent of the mesh \[m\].
    pub extent_m: f64,
    /// Mean rest length \[m\].
    pub edge_m: f64,
    /// Links by the elements that own them.
    pub owned: Fours,
    beside_start: Vec<u32>,
    beside: Vec<Beside>,
}

impl Links {
    /// Elements and links of a mesh, with link stiffness times `share`.
    ///
    /// # Errors
    /// A material out of range.
    pub fn new(
        mesh: &TetMesh,
        materials: &Materials,
        density_kg_per_m3: f64,
        share: f64,
    ) -> Result<Self, BuildError> {
        materials.check(mesh.cells().len())?;
        let rest_m = mesh.points_m().to_vec();
        let at = |node: u32| Vector3::from(rest_m[node as usize]);
        let nodes = rest_m.len();
        let (mut mass_kg, mut modulus_volume) = (vec![0.0; nodes], 0.0);
        let mut edges: Vec<(u32, u32, f64)> = Vec::with_capacity(6 * mesh.cells().len());
        for (index, cell) in mesh.cells().iter().enumerate() {
            let volume = signed_volume(&mesh.corners(*cell));
            let weight = materials.of(index).youngs_modulus_pa * volume;
            modulus_volume += weight;
            for (corner, &a) in cell.iter().enumerate() {
                mass_kg[a as usize] += 0.25 * density_kg_per_m3 * volume;
                for &b in &cell[corner + 1..] {
                    edges.push((a.min(b), a.max(b), weight));
                }
            }
        }
        edges.sort_by_key(|edge| (edge.0, edge.1));
        let share = share * calibration(mesh);
        let mut stiffness = vec![0.0; nodes];
        let mut ends = Vec::new();
        let mut edge_m = 0.0;
        for shared in edges.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
            let (a, b, _) = shared[0];
            let weight: f64 = shared.iter().map(|edge| edge.2).sum();
            // Summed exactly as a step does it: a link at rest then has no strain at all.
            let rest_sq = square(difference(&rest_m[a as usize], &rest_m[b as usize]));
            let k = share * weight / rest_sq;
            stiffness[a as usize] += k;
            stiffness[b as usize] += k;
            edge_m += rest_sq.sqrt();
            ends.push(End {
                owner: a,
                to: b,
                rest_sq,
                spring: (0.5 * k / rest_sq) as f32,
            });
        }
        edge_m /= ends.len() as f64;
        let by_owner = Fours::new(ends, nodes);
        let mut both: Vec<(u32, Beside)> = Vec::with_capacity(2 * by_owner.places());
        for node in 0..nodes {
            for link in by_owner.of(node) {
                for (of, to) in [(node as u32, link.to), (link.to, node as u32)] {
                    let beside = Beside {
                        rest_sq: link.rest_sq,
                        to,
                        place: link.place as u32,
                    };
                    both.push((of, beside));
                }
            }
        }
        both.sort_by_key(|(node, beside)| (*node, beside.to));
        let mut beside_start = vec![0; nodes + 1];
        for (node, _) in &both {
            beside_start[*node as usize + 1] += 1;
        }
        accumulate(&mut beside_start);
        let (low, high) = mesh
            .points_m()
            .iter()
            .fold((at(0), at(0)), |(low, high), point| {
                (
                    low.inf(&Vector3::from(*point)),
                    high.sup(&Vector3::from(*point)),
                )
            });
        Ok(Self {
            mass_kg,
            stiffness,
            modulus_volume,
            extent_m: (high - low).max(),
            edge_m,
            owned: by_owner,
            beside_start,
            beside: both.into_iter().map(|(_, beside)| beside).collect(),
            rest_m,
        })
    }

    /// Number of elements.
    pub fn nodes(&self) -> usize {
        self.rest_m.len()
    }

    /// All links of one element, ascending by the other.
    #[inline]
    pub fn beside(&self, node: usize) -> &[Beside] {
        &self.beside[self.beside_start[node] as usize..self.beside_start[node + 1] as usize]
    }
}

/// What brings the mean of Young's moduli along x, y, z of the springs, strained alike everywhere, to that of the
/// material. A network's edges do not point everywhere alike; if they did, this would be 1.
fn calibration(mesh: &TetMesh) -> f64 {
    let (mut volume, mut stiffness) = (0.0, Matrix6::zeros());
    for cell in mesh.cells() {
        let corners = mesh.corners(*cell);
        let own = signed_volume(&corners);
        volume += own;
        for a in 0..4 {
            for b in a + 1..4 {
                // Energy V e^2 / 2 of a link along n, with e = n . E n in Voigt's notation.
                let n = (corners[b] - corners[a]).normalize();
                let along = Vector6::new(
                    n.x * n.x,
                    n.y * n.y,
                    n.z * n.z,
                    n.y * n.z,
                    n.z * n.x,
                    n.x * n.y,
                );
                stiffness += own * along * along.transpose();
            }
        }
    }
    // Six edges of a tetrahedron determine its strain, so this is never singular.
    let Some(compliance) = (stiffness / volume).try_inverse() else {
        return 1.0;
    };
    let moduli = [0, 1, 2].map(|axis| 1.0 / compliance[(axis, axis)]);
    3.0 / (moduli[0] + moduli[1] + moduli[2])
}

/// Counts to starts.
pub(super) fn accumulate(starts: &mut [u32]) {
    let mut sum = 0;
    for start in starts {
        sum += *start;
        *start = sum;
    }
}

/// From `a` to `b`.
#[inline]
pub(super) fn difference(a: &[f64; 3], b: &[f64; 3]) -> [f64; 3] {
    [b[0] - a[0], b[1] - a[1], b[2] - a[2]]
}

/// Square of a length.
#[inline]
pub(super) fn square(d: [f64; 3]) -> f64 {
    d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Material;
    use nalgebra::Matrix3;
    use sutura_mesh::slab;

    const FAT: Material = Material {
        youngs_modulus_pa: 3e3,
        poisson_ratio: 0.45,
    };

    #[test]
    fn every_edge_is_a_link_once_and_mass_is_that_of_the_volume() {
        let mesh = slab([0.02, 0.03, 0.01], [2, 3, 2]).expect("a slab");
        let links = Links::new(&mesh, &FAT.into(), 1000.0, 1.0).expect("links");
        let mass: f64 = links.mass_kg.iter().sum();
        assert!((mass - 1000.0 * 6e-6).abs() < 1e-12);
        assert!((links.extent_m - 0.03).abs() < 1e-15);
        let mut seen = std::collections::BTreeSet::new();
        for cell in mesh.cells() {
            for a in cell {
                for b in cell {
                    if a < b {
                        seen.insert((*a, *b));
                    }
                }
            }
        }
        let mut once = std::collections::BTreeMap::new();
        for node in 0..links.nodes() {
            for link in links.owned.of(node) {
                let pair = ((node as u32).min(link.to), (node as u32).max(link.to));
                assert!(once.insert(pair, link).is_none() && link.place < links.owned.places());
            }
        }
        assert!(once.keys().eq(&seen));
        let mut directed = 0;
        for node in 0..links.nodes() {
            assert!(links.beside(node).is_sorted_by_key(|beside| beside.to));
            for beside in links.beside(node) {
                directed += 1;
                let pair = ((node as u32).min(beside.to), (node as u32).max(beside.to));
                let own = once[&pair];
                assert_eq!(
                    (own.place, own.rest_sq),
                    (beside.place as usize, beside.rest_sq)
                );
                assert_eq!(own.spring, links.owned.spring(beside.place));
            }
        }
        assert_eq!(directed, 2 * seen.len());
    }

    #[test]
    fn a_stretched_mesh_has_youngs_modulus() {
        // Energy of a uniform strain, by moving every node; the lateral strains that make it least are found
        // one at a time.
        let mesh = slab([0.02, 0.03, 0.01], [4, 6, 2]).expect("a slab");
        let links = Links::new(&mesh, &FAT.into(), 1000.0, 1.0).expect("links");
        let energy = |strain: &[f64; 6]| {
            let [x, y, z, yz, zx, xy] = *strain;
            let half = Matrix3::new(x, xy, zx, xy, y, yz, zx, yz, z);
            let mut sum = 0.0;
            for node in 0..links.nodes() {
                for link in links.owned.of(node) {
                    let (a, b) = (&links.rest_m[node], &links.rest_m[link.to as usize]);
                    let d = Vector3::from(difference(a, b));
                    let k = 2.0 * link.spring * link.rest_sq;
                    sum += 0.5 * k * d.dot(&(half * d)).powi(2) / link.rest_sq;
                }
            }
            sum
        };
        let mut mean = 0.0;
        for axis in 0..3 {
            let mut strain = [0.0; 6];
            strain[axis] = 1.0;
            for _ in 0..60 {
                for other in (0..6).filter(|other| *other != axis) {
                    let at = |value: f64| {
                        let mut trial = strain;
                        trial[other] = value;
                        energy(&trial)
                    };
                    let (low, middle, high) = (at(-1.0), at(0.0), at(1.0));
                    strain[other] = 0.5 * (low - high) / (low - 2.0 * middle + high);
                }
            }
            mean += energy(&strain) / (0.5 * 6e-6) / 3.0;
        }
        assert!((mean / 3e3 - 1.0).abs() < 1e-5, "{mean}");
    }
}
