//! Boxes and tubes of tetrahedra without a mesh generator.
//!
//! Entry points: [`slab`], [`tube`]. Each cube is cut into six along its diagonal (Kuhn 1960); in a slab
//! mirrored from cube to cube (Todd's J1): faces match, and the mesh is symmetric about every plane of
//! nodes.

use super::{MeshError, TetMesh};

/// The six paths from one corner of a cube to the opposite one, one axis at a time. The flag says
/// whether the tetrahedron on the path is positively oriented.
const PATHS: [([usize; 3], bool); 6] = [
    ([0, 1, 2], true),
    ([1, 2, 0], true),
    ([2, 0, 1], true),
    ([0, 2, 1], false),
    ([2, 1, 0], false),
    ([1, 0, 2], false),
];

const MOST_CUBES: usize = 10_000_000;

/// A slab of `size_m` \[m\] in `divisions` cubes along x, y, z: centred in x and y, top at z = 0,
/// bottom at z = -`size_m[2]`. Node (i, j, k) has index `i + (nx + 1) (j + (ny + 1) k)`, k upwards.
///
/// # Errors
/// [`MeshError::Slab`] for sizes or divisions that make no cells.
///
/// ```
/// let mesh = sutura_mesh::slab([0.08, 0.08, 0.03], [4, 4, 2])?;
/// assert_eq!((mesh.points_m().len(), mesh.cells().len()), (75, 192));
/// # Ok::<(), sutura_mesh::MeshError>(())
/// ```
pub fn slab(size_m: [f64; 3], divisions: [usize; 3]) -> Result<TetMesh, MeshError> {
    let cubes = divisions
        .iter()
        .try_fold(1usize, |cubes, &n| cubes.checked_mul(n));
    if !size_m.iter().all(|size| size.is_finite() && *size > 0.0)
        || !cubes.is_some_and(|cubes| (1..=MOST_CUBES).contains(&cubes))
    {
        return Err(MeshError::Slab { size_m, divisions });
    }
    let [nx, ny, nz] = divisions;
    let node = |ijk: [usize; 3]| (ijk[0] + (nx + 1) * (ijk[1] + (ny + 1) * ijk[2])) as u32;
    let low = [-0.5 * size_m[0], -0.5 * size_m[1], -size_m[2]];

    let mut points_m = Vec::with_capacity((nx + 1) * (ny + 1) * (nz + 1));
    for k in 0..=nz {
        for j in 0..=ny {
            for i in 0..=nx {
                let at = |axis: usize, step: usize| {
                    let span = size_m[axis] / divisions[axis] as f64;
                    // From the nearer end, so that mirrored nodes are mirrored to the last bit.
                    if 2 * step <= divisions[axis] {
                        low[axis] + span * step as f64
                    } else {
                        low[axis] + size_m[axis] - span * (divisions[axis] - step) as f64
                    }
                };
                points_m.push([at(0, i), at(1, j), at(2, k)]);
            }
        }
    }

    let mut cells = Vec::with_capacity(6 * nx * ny * nz);
    for k in 0..nz {
        for j in 0..ny {
            for i in 0..nx {
                let cube = [i, j, k];
                // A cube with an odd index is the mirror image of its neighbour.
                let odd = cube.map(|index| index % 2 == 1);
                let mirrored = odd.iter().filter(|odd| **odd).count() % 2 == 1;
                for (path, positive) in PATHS {
                    let mut corner =
                        [0, 1, 2].map(|axis: usize| cube[axis] + usize::from(odd[axis]));
                    let mut cell = [node(corner); 4];
                    for (step, &axis) in path.iter().enumerate() {
                        corner[axis] = cube[axis] + usize::from(!odd[axis]);
                        cell[step + 1] = node(corner);
                    }
                    if positive == mirrored {
                        cell.swap(2, 3);
                    }
                    cells.push(cell);
                }
            }
        }
    }
    TetMesh::new(points_m, cells)
}

/// A tube about the z axis between two radii and two heights \[m\], in `divisions` along radius,
/// circumference and height; at least 3 around.
///
/// # Errors
/// [`MeshError::Tube`] for lengths or divisions that make no tube.
pub fn tube(
    radii_m: [f64; 2],
    heights_m: [f64; 2],
    divisions: [usize; 3],
) -> Result<TetMesh, MeshError> {
    let [inner, outer] = radii_m;
    let [low, high] = heights_m;
    let cubes = divisions
        .iter()
        .try_fold(1usize, |cubes, &n| cubes.checked_mul(n));
    let sound = outer.is_finite() && high.is_finite() && low.is_finite();
    if !(sound && 0.0 < inner && inner < outer && low < high)
        || divisions[1] < 3
        || !cubes.is_some_and(|cubes| (1..=MOST_CUBES).contains(&cubes))
    {
        return Err(MeshError::Tube {
            radii_m,
            heights_m,
            divisions,
        });
    }
    let [nr, around, nz] = divisions;
    let node = |[i, j, k]: [usize; 3]| (i + (nr + 1) * (j % around + around * k)) as u32;
    let mut points_m = Vec::with_capacity((nr + 1) * around * (nz + 1));
    for k in 0..=nz {
        for j in 0..around {
            for i in 0..=nr {
                let radius = inner + (outer - inner) * i as f64 / nr as f64;
                let (sin, cos) = (std::f64::consts::TAU * j as f64 / around as f64).sin_cos();
                let z = low + (high - low) * k as f64 / nz as f64;
                points_m.push([radius * cos, radius * sin, z]);
            }
        }
    }
    let mut cells = Vec::with_capacity(6 * nr * around * nz);
    for k in 0..nz {
        for j in 0..around {
            for i in 0..nr {
                for (path, positive) in PATHS {
                    let mut corner = [i, j, k];
                    let mut cell = [node(corner); 4];
                    for (step, &axis) in path.iter().enumerate() {
                        corner[axis] += 1;
                        cell[step + 1] = node(corner);
                    }
                    if !positive {
                        cell.swap(2, 3);
                    }
                    cells.push(cell);
                }
            }
        }
    }
    TetMesh::new(points_m, cells)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signed_volume;
    use std::collections::HashSet;

    #[test]
    fn cells_fill_the_box() {
        let mesh = slab([0.3, 0.2, 0.1], [3, 4, 5]).expect("a slab");
        let volume: f64 = mesh
            .cells()
            .iter()
            .map(|cell| signed_volume(&mesh.corners(*cell)))
            .sum();
        assert!((volume - 0.3 * 0.2 * 0.1).abs() < 1e-15);
        assert_eq!(mesh.cells().len(), 6 * 60);
        let top = mesh.points_m().iter().filter(|p| p[2] == 0.0).count();
        assert_eq!(top, 4 * 5, "the top lies at exactly z = 0");
    }

    #[test]
    fn the_mesh_is_its_own_mirror_image() {
        let mesh = slab([0.08, 0.08, 0.03], [4, 4, 3]).expect("a slab");
        let n = 5;
        let mirror = |node: u32| {
            let (i, rest) = (node % n, node / n);
            (n - 1 - i) + n * rest
        };
        let swap = |node: u32| {
            let (i, j, k) = (node % n, node / n % n, node / n / n);
            j + n * (i + n * k)
        };
        let sorted = |mut cell: [u32; 4]| {
            cell.sort_unstable();
            cell
        };
        let cells: HashSet<_> = mesh.cells().iter().map(|cell| sorted(*cell)).collect();
        for cell in &cells {
            assert!(cells.contains(&sorted(cell.map(mirror))));
            assert!(cells.contains(&sorted(cell.map(swap))));
        }
    }

    /// The boundary is a torus, and the volume that of the polygon's ring.
    #[test]
    fn a_tube_is_closed_and_full() {
        let (around, radii) = (12, [0.008, 0.011]);
        let mesh = tube(radii, [0.003, 0.033], [2, around, 5]).expect("a tube");
        let volume: f64 = mesh
            .cells()
            .iter()
            .map(|cell| signed_volume(&mesh.corners(*cell)))
            .sum();
        let angle = std::f64::consts::TAU / around as f64;
        let ring = 0.5 * around as f64 * angle.sin() * (radii[1].powi(2) - radii[0].powi(2));
        assert!((volume / (ring * 0.03) - 1.0).abs() < 1e-12);
        let surface = mesh.surface();
        let (faces, vertices) = (surface.triangles.len(), surface.vertices.len());
        // Euler: V - E + F = 0 with E = 3/2 F.
        assert_eq!(2 * vertices, faces);
        for (radii, divisions) in [([0.0, 0.1], [1, 3, 1]), ([0.1, 0.2], [1, 2, 1])] {
            let refused = tube(radii, [0.0, 1.0], divisions);
            assert!(matches!(refused, Err(MeshError::Tube { .. })));
        }
    }

    #[test]
    fn impossible_slabs_are_refused() {
        for (size, divisions) in [
            ([0.1, 0.1, 0.0], [1, 1, 1]),
            ([0.1, f64::NAN, 0.1], [1, 1, 1]),
            ([0.1, 0.1, 0.1], [1, 0, 1]),
            ([0.1, 0.1, 0.1], [usize::MAX, 2, 2]),
        ] {
            assert!(matches!(slab(size, divisions), Err(MeshError::Slab { .. })));
        }
    }
}
