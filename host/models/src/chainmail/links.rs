//! Nodes and edges of a mesh as elements and links: neighbours, rest lengths, stiffness, mass.
//!
//! Entry point: [`Links::new`]. A link's stiffness is the sum of E V / l^2 over its cells (van Gelder 1998): where
//! edges point everywhere alike this is Young's modulus exactly, with the Poisson's ratio 1/4 of any network of springs.

use crate::{BuildError, Materials};
use nalgebra::Vector3;
use sutura_mesh::{TetMesh, signed_volume};

/// A link as the lower of its two elements sees it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Upper {
    /// Square of the rest length \[m^2\].
    pub rest_sq: f64,
    /// The other element, the higher one.
    pub to: u32,
    /// k / (2 l0^2) \[N/m^3\]; single precision keeps a link in 16 bytes, and both ends use the same.
    pub spring: f32,
}

/// A link as either of its elements sees it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Beside {
    /// Square of the rest length \[m^2\].
    pub rest_sq: f64,
    /// The other element.
    pub to: u32,
    /// Index among all links, in the order of [`Links::upper`].
    pub link: u32,
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
    upper_start: Vec<u32>,
    upper: Vec<Upper>,
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
        let mut stiffness = vec![0.0; nodes];
        let (mut upper_start, mut upper) = (vec![0; nodes + 1], Vec::new());
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
            upper_start[a as usize + 1] += 1;
            edge_m += rest_sq.sqrt();
            ends.push((a, b, rest_sq));
            upper.push(Upper {
                rest_sq,
                to: b,
                spring: (0.5 * k / rest_sq) as f32,
            });
        }
        edge_m /= upper.len() as f64;
        accumulate(&mut upper_start);
        let mut both: Vec<(u32, Beside)> = Vec::with_capacity(2 * upper.len());
        for (link, &(a, b, rest_sq)) in ends.iter().enumerate() {
            let link = link as u32;
            both.push((
                a,
                Beside {
                    rest_sq,
                    to: b,
                    link,
                },
            ));
            both.push((
                b,
                Beside {
                    rest_sq,
                    to: a,
                    link,
                },
            ));
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
            upper_start,
            upper,
            beside_start,
            beside: both.into_iter().map(|(_, beside)| beside).collect(),
            rest_m,
        })
    }

    /// Number of elements.
    pub fn nodes(&self) -> usize {
        self.rest_m.len()
    }

    /// Number of links.
    pub fn count(&self) -> usize {
        self.upper.len()
    }

    /// Links of one element to higher ones, and the index of the first of them.
    #[inline]
    pub fn upper(&self, node: usize) -> (usize, &[Upper]) {
        let range = self.upper_start[node] as usize..self.upper_start[node + 1] as usize;
        (range.start, &self.upper[range])
    }

    /// All links of one element, ascending by the other.
    #[inline]
    pub fn beside(&self, node: usize) -> &[Beside] {
        &self.beside[self.beside_start[node] as usize..self.beside_start[node + 1] as usize]
    }
}

/// Counts to starts.
fn accumulate(starts: &mut [u32]) {
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
        assert_eq!(links.count(), seen.len());
        let mut directed = 0;
        for node in 0..links.nodes() {
            for beside in links.beside(node) {
                directed += 1;
                let pair = (node as u32).min(beside.to);
                let (first, upper) = links.upper(pair as usize);
                let own = &upper[beside.link as usize - first];
                assert_eq!(own.to, (node as u32).max(beside.to));
                assert_eq!(own.rest_sq, beside.rest_sq);
            }
        }
        assert_eq!(directed, 2 * seen.len());
    }

    #[test]
    fn averaged_over_directions_the_links_have_youngs_modulus() {
        // Energy of a strain, averaged over all directions of strain, is that of the material with
        // nu = 1/4: for an edge, <(n e n)^2> = (tr^2 + 2 e:e) / 15, so a pure expansion must be exact.
        let mesh = slab([0.02, 0.03, 0.01], [2, 3, 2]).expect("a slab");
        let links = Links::new(&mesh, &FAT.into(), 1000.0, 1.0).expect("links");
        let strain = 1e-6;
        let mut energy = 0.0;
        for node in 0..links.nodes() {
            for link in links.upper(node).1 {
                let k = 2.0 * f64::from(link.spring) * link.rest_sq;
                energy += 0.5 * k * link.rest_sq * strain * strain;
            }
        }
        // Bulk modulus E / (3 (1 - 2 nu)) = 2/3 E at nu = 1/4: 9/2 K e^2 V = 3 E e^2 V.
        let expected = 3.0 * 3e3 * strain * strain * 6e-6;
        assert!(
            (energy / expected - 1.0).abs() < 1e-6,
            "{energy} {expected}"
        );
    }
}
