//! Bodies that are a bent and stretched box of cubes, as meshes of any fineness.
//!
//! Entry points: [`Lattice::new`], [`Lattice::locate`]. Places in the unit cube name points of all of them.

use nalgebra::{Matrix3, Vector3};
use sutura_host::mesh::{MeshError, TetMesh, slab};

/// Cells that [`slab`] makes of a cube, one cube after the other.
const CELLS_OF_CUBE: usize = 6;

/// From a point of the unit cube to one of the body \[m\].
pub type Shape = fn([f64; 3]) -> [f64; 3];

/// A mesh and where its nodes were in the unit cube.
#[derive(Clone, Debug)]
pub struct Lattice {
    /// The mesh.
    pub mesh: TetMesh,
    /// Cubes along each side.
    pub divisions: [usize; 3],
    /// Each node's place in the unit cube, (n x 3).
    pub unit: Vec<[f64; 3]>,
}

impl Lattice {
    /// Six cells for each of the cubes.
    ///
    /// # Errors
    /// A shape that turns cells inside out.
    pub fn new(shape: Shape, divisions: [usize; 3]) -> Result<Self, MeshError> {
        let cube = slab([1.0; 3], divisions)?;
        let [nx, ny, nz] = divisions;
        let mut unit = Vec::with_capacity(cube.points_m().len());
        for k in 0..=nz {
            for j in 0..=ny {
                for i in 0..=nx {
                    // Quotients, so that a node has the same place in meshes of any fineness.
                    unit.push([
                        i as f64 / nx as f64,
                        j as f64 / ny as f64,
                        k as f64 / nz as f64,
                    ]);
                }
            }
        }
        let points = unit.iter().map(|at| shape(*at)).collect();
        Ok(Self {
            mesh: TetMesh::new(points, cube.cells().to_vec())?,
            divisions,
            unit,
        })
    }

    /// The cell in which a point of the unit cube lies, and its barycentric coordinates there.
    pub fn locate(&self, at: [f64; 3]) -> (usize, [f64; 4]) {
        let [i, j, k] = [0, 1, 2].map(|axis| {
            let divisions = self.divisions[axis];
            ((at[axis] * divisions as f64).max(0.0) as usize).min(divisions - 1)
        });
        let first = CELLS_OF_CUBE * (i + self.divisions[0] * (j + self.divisions[1] * k));
        let mut found = (first, [f64::NEG_INFINITY; 4]);
        let least = |shares: &[f64; 4]| shares.iter().copied().fold(f64::INFINITY, f64::min);
        for cell in first..first + CELLS_OF_CUBE {
            let [a, b, c, d] =
                self.mesh.cells()[cell].map(|node| Vector3::from(self.unit[node as usize]));
            let edges = Matrix3::from_columns(&[b - a, c - a, d - a]);
            let Some(inverse) = edges.try_inverse() else {
                continue;
            };
            let [x, y, z]: [f64; 3] = (inverse * (Vector3::from(at) - a)).into();
            let shares = [1.0 - x - y - z, x, y, z];
            if least(&shares) > least(&found.1) {
                found = (cell, shares);
            }
        }
        found
    }

    /// Triangles of the surface whose corners all are where `is_there` says, by places in the unit cube.
    pub fn faces(&self, is_there: fn([f64; 3]) -> bool) -> Vec<[u32; 3]> {
        let surface = self.mesh.surface();
        let there = |node: &u32| is_there(self.unit[*node as usize]);
        surface
            .triangles
            .iter()
            .filter(|triangle| triangle.iter().all(there))
            .copied()
            .collect()
    }

    /// A force \[N\] spread evenly over triangles, as forces on nodes \[N\], (n x 3).
    pub fn spread(&self, faces: &[[u32; 3]], force_n: [f64; 3]) -> Vec<[f64; 3]> {
        let at = |node: u32| Vector3::from(self.mesh.points_m()[node as usize]);
        let area = |[a, b, c]: [u32; 3]| (at(b) - at(a)).cross(&(at(c) - at(a))).norm();
        let whole: f64 = faces.iter().map(|face| area(*face)).sum();
        let mut forces = vec![[0.0; 3]; self.unit.len()];
        for face in faces {
            let share = area(*face) / whole / 3.0;
            for node in face {
                for (sum, force) in forces[*node as usize].iter_mut().zip(force_n) {
                    *sum += share * force;
                }
            }
        }
        forces
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BEAM: Shape = |[x, y, z]| [2.0 * x, 0.2 * y, 0.2 * z];

    #[test]
    fn a_point_is_found_where_it_is() {
        let lattice = Lattice::new(BEAM, [5, 2, 3]).expect("a lattice");
        let other = Lattice::new(BEAM, [7, 3, 2]).expect("a lattice");
        for at in &other.unit {
            let (cell, shares) = lattice.locate(*at);
            assert!(shares.iter().all(|share| *share > -1e-12), "{at:?}");
            let corners = lattice.mesh.corners(lattice.mesh.cells()[cell]);
            let there: Vector3<f64> = corners.iter().zip(shares).map(|(p, s)| s * p).sum();
            assert!((there - Vector3::from(BEAM(*at))).norm() < 1e-14, "{at:?}");
        }
    }

    #[test]
    fn a_spread_force_is_whole_and_has_its_middle() {
        // Cubes of one side are not all as large: the middle is that of the area.
        let uneven: Shape = |[x, y, z]| BEAM([x, y * y, z]);
        let lattice = Lattice::new(uneven, [4, 2, 2]).expect("a lattice");
        let end = lattice.faces(|[x, _, _]| x == 1.0);
        assert_eq!(end.len(), 8);
        let forces = lattice.spread(&end, [0.8, 0.0, -0.4]);
        let sum: f64 = forces.iter().map(|force| force[0]).sum();
        assert!((sum - 0.8).abs() < 1e-14);
        let moment: f64 = forces
            .iter()
            .zip(lattice.mesh.points_m())
            .map(|(force, at)| force[2] * at[1])
            .sum();
        assert!((moment + 0.4 * 0.1).abs() < 1e-14);
    }
}
