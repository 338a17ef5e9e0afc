//! What a mesh is like, good or bad: counts, sizes, quality of its cells.
//!
//! Entry point: [`MeshReport::of`]. Quality is the mean ratio of Liu & Joe 1994.

use super::check::{is_flat, longest_edge};
use super::manifold::for_each_face;
use super::{CellId, MeshError, RawMesh, signed_volume};
use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::Serialize;
use std::collections::BTreeMap;
use std::convert::Infallible;

/// A mesh in figures. Lengths in metres after the reader's scale.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct MeshReport {
    /// How many nodes there are.
    pub nodes: usize,
    /// How many tetrahedra.
    pub cells: usize,
    /// How many triangles belong to one cell only.
    pub boundary_faces: usize,
    /// Cells of negative volume.
    pub inverted: usize,
    /// Cells with next to no volume, of either sign.
    pub flat: usize,
    /// Nodes that belong to no cell.
    pub unreferenced: usize,
    /// Mean ratio of the cells.
    pub quality: Quality,
    /// Lengths of edges \[m\].
    pub edge_m: EdgeLengths,
    /// Size of the box around the nodes \[m\], (3).
    pub size_m: [f64; 3],
    /// Sum of the cells' signed volumes \[m^3\].
    pub volume_m3: f64,
    /// Every region, by its number.
    pub regions: Vec<RegionReport>,
    /// What was left out of the file or made of it: faces, nodes in the middle of edges.
    pub notes: Vec<String>,
    /// Whether scenes take the mesh.
    pub usable: bool,
    /// Why not.
    pub refusal: Option<String>,
}

/// Smallest value and quantiles (nearest rank) of a quality; not a number without cells.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Quality {
    /// Name of the measure: `mean-ratio`, see [`mean_ratio`].
    pub measure: &'static str,
    /// Worst cell.
    pub min: f64,
    /// One cell in a hundred is worse.
    pub p01: f64,
    /// Every other cell is worse.
    pub p50: f64,
}

/// Of the edges of all cells, one that several cells share counted for each.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct EdgeLengths {
    /// Shortest \[m\].
    pub min: f64,
    /// Mean \[m\].
    pub mean: f64,
    /// Longest \[m\].
    pub max: f64,
}

/// One region of a mesh.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct RegionReport {
    /// Its number, 0 for cells without a region.
    pub region: i64,
    /// Its name, if the file has one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// How many cells it has.
    pub cells: usize,
    /// Sum of their signed volumes \[m^3\].
    pub volume_m3: f64,
}

/// Mean ratio of a tetrahedron: `12 (3 V)^(2/3)` over the sum of its squared edges, with the sign of V.
/// 1 for a regular one, 0 for a flat one, below 0 for an inverted one; the same in any unit of length.
pub fn mean_ratio(corners: &[Vector3<f64>; 4]) -> f64 {
    let volume = signed_volume(corners);
    let squares: f64 = edges(corners).map(|length| length * length).sum();
    12.0 * (3.0 * volume.abs()).powf(2.0 / 3.0) / squares * volume.signum()
}

fn edges(corners: &[Vector3<f64>; 4]) -> impl Iterator<Item = f64> + '_ {
    let pairs = [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]];
    pairs
        .into_iter()
        .map(|[a, b]| (corners[a] - corners[b]).norm())
}

impl MeshReport {
    /// Looks at every cell.
    ///
    /// # Errors
    /// [`MeshError::NoSuchNode`]; everything else that is wrong with the mesh is in the report.
    pub fn of(mesh: &RawMesh) -> Result<Self, MeshError> {
        let nodes = mesh.points_m.len();
        let mut used = vec![false; nodes];
        for (index, cell) in mesh.cells.iter().enumerate() {
            for &node in cell {
                *used.get_mut(node as usize).ok_or(MeshError::NoSuchNode {
                    cell: CellId { index, tag: None },
                    node: node.into(),
                    nodes,
                })? = true;
            }
        }
        let mut boundary_faces = 0;
        let Ok(()) = for_each_face(nodes, &mesh.cells, |group| {
            boundary_faces += usize::from(group.len() == 1);
            Ok::<(), Infallible>(())
        });

        let (mut inverted, mut flat, mut volume_m3) = (0, 0, 0.0);
        let mut edge_m = EdgeLengths {
            min: f64::INFINITY,
            mean: 0.0,
            max: 0.0,
        };
        let mut regions: BTreeMap<i64, (usize, f64)> = BTreeMap::new();
        let mut qualities = mesh.qualities();
        for (index, &cell) in mesh.cells.iter().enumerate() {
            let corners = mesh.corners(cell);
            let volume = signed_volume(&corners);
            inverted += usize::from(volume < 0.0);
            flat += usize::from(is_flat(volume, longest_edge(&corners)));
            volume_m3 += volume;
            for length in edges(&corners) {
                edge_m.min = edge_m.min.min(length);
                edge_m.max = edge_m.max.max(length);
                edge_m.mean += length / (6 * mesh.cells.len()) as f64;
            }
            let region = mesh.regions.get(index).copied().unwrap_or(0);
            let (cells, volume_of) = regions.entry(region).or_default();
            *cells += 1;
            *volume_of += volume;
        }
        qualities.sort_unstable_by(f64::total_cmp);
        let refusal = mesh.clone().check().err().map(|error| error.to_string());
        Ok(Self {
            nodes,
            cells: mesh.cells.len(),
            boundary_faces,
            inverted,
            flat,
            unreferenced: used.iter().filter(|used| !**used).count(),
            quality: Quality {
                measure: "mean-ratio",
                min: quantile(&qualities, 0.0),
                p01: quantile(&qualities, 0.01),
                p50: quantile(&qualities, 0.5),
            },
            edge_m,
            size_m: size(&mesh.points_m),
            volume_m3,
            regions: regions
                .into_iter()
                .map(|(region, (cells, volume_m3))| RegionReport {
                    region,
                    name: mesh.region_names.get(&region).cloned(),
                    cells,
                    volume_m3,
                })
                .collect(),
            notes: mesh.notes.clone(),
            usable: refusal.is_none(),
            refusal,
        })
    }
}

/// Nearest rank in ascending values.
fn quantile(sorted: &[f64], share: f64) -> f64 {
    let rank = (share * sorted.len() as f64).ceil() as usize;
    sorted
        .get(rank.saturating_sub(1))
        .copied()
        .unwrap_or(f64::NAN)
}

fn size(points: &[[f64; 3]]) -> [f64; 3] {
    [0, 1, 2].map(|axis| {
        let along = points.iter().map(|p| p[axis]);
        let (low, high) = along.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| {
            (low.min(x), high.max(x))
        });
        (high - low).max(0.0)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::slab;

    #[test]
    fn the_mean_ratio_is_that_of_its_definition() {
        // Every other corner of a cube.
        let regular = [
            [1.0, 1.0, 1.0],
            [1.0, -1.0, -1.0],
            [-1.0, 1.0, -1.0],
            [-1.0, -1.0, 1.0],
        ];
        let mut corners = regular.map(Vector3::from);
        if signed_volume(&corners) < 0.0 {
            corners.swap(0, 1);
        }
        assert!((mean_ratio(&corners) - 1.0).abs() < 1e-14);
        assert!((mean_ratio(&corners.map(|p| p * 1e-3)) - 1.0).abs() < 1e-14);
        corners.swap(0, 1);
        assert!((mean_ratio(&corners) + 1.0).abs() < 1e-14);
        // Corner of a cube: V = 1/6, squared edges 3 + 6.
        let corner = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let by_hand = 12.0 * 0.5f64.powf(2.0 / 3.0) / 9.0;
        assert!((mean_ratio(&corner.map(Vector3::from)) - by_hand).abs() < 1e-14);
    }

    #[test]
    fn a_slab_is_counted() {
        let mesh = slab([0.3, 0.2, 0.1], [3, 2, 1]).expect("a slab");
        let regions = (0..36).map(|k| i64::from(k < 12)).collect();
        let mut raw = RawMesh::new(mesh.points_m().to_vec(), mesh.cells().to_vec(), regions);
        let report = MeshReport::of(&raw).expect("a report");
        assert_eq!((report.nodes, report.cells), (24, 36));
        assert_eq!(report.boundary_faces, 2 * 2 * (6 + 3 + 2));
        assert_eq!(
            (report.inverted, report.flat, report.unreferenced),
            (0, 0, 0)
        );
        assert!((report.volume_m3 - 6e-3).abs() < 1e-15);
        assert!((report.edge_m.min - 0.1).abs() < 1e-15);
        assert!((report.edge_m.max - 0.1 * 3f64.sqrt()).abs() < 1e-15);
        let cells: Vec<_> = report.regions.iter().map(|r| (r.region, r.cells)).collect();
        assert_eq!(cells, [(0, 24), (1, 12)]);
        assert!(report.usable && report.refusal.is_none());

        raw.cells[4].swap(0, 1);
        raw.points_m.push([0.0; 3]);
        let report = MeshReport::of(&raw).expect("a report");
        assert_eq!((report.inverted, report.unreferenced), (1, 1));
        assert_eq!(report.boundary_faces, 44, "orientation plays no part");
        assert!(report.quality.min < 0.0 && report.quality.p50 > 0.0);
        assert!(
            report
                .refusal
                .is_some_and(|why| why.contains("cell 4 is inverted"))
        );
    }

    #[test]
    fn nothing_is_reported_too() {
        let report = MeshReport::of(&RawMesh::default()).expect("a report");
        assert!(report.quality.min.is_nan() && !report.usable);
    }
}
