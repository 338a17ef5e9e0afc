//! W = C K^-1 C' by barycentric sums of cached blocks.
//!
//! Entry point: [`assemble`].

use super::AnchorRow;
use crate::columns::Columns;
use nalgebra::{Matrix3, Vector3};

/// An anchor with its free nodes counted as the columns count them; fixed nodes are left out.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Reached {
    pub vertices: [u32; 4],
    pub weights: [f64; 4],
    pub count: usize,
}

impl Reached {
    pub fn parts(&self) -> impl Iterator<Item = (u32, f64)> {
        let pairs = self.vertices.into_iter().zip(self.weights);
        pairs.take(self.count)
    }
}

/// Fills `w` (n x n, column-major, both triangles) for `rows`, which are in the order of their anchors;
/// `first_row` (anchors + 1) says where each anchor's rows begin. `pairs` is scratch, (anchors).
pub(super) fn assemble(
    anchors: &[Reached],
    rows: &[AnchorRow],
    first_row: &[u32],
    columns: &Columns,
    pairs: &mut [Matrix3<f64>],
    w: &mut [f64],
) {
    let n = rows.len();
    for (b, pushed) in anchors.iter().enumerate() {
        let of_b = first_row[b] as usize..first_row[b + 1] as usize;
        if of_b.is_empty() {
            continue;
        }
        let pairs = &mut pairs[..=b];
        pairs.fill(Matrix3::zeros());
        // One pushed vertex at a time: its blocks lie together.
        for (vertex, weight) in pushed.parts() {
            let blocks = columns.of(vertex);
            for (pair, at) in pairs.iter_mut().zip(anchors) {
                let mut sum = Matrix3::zeros();
                for (node, share) in at.parts() {
                    let start = 9 * node as usize;
                    sum += Matrix3::from_column_slice(&blocks[start..start + 9]) * share;
                }
                *pair += sum * weight;
            }
        }
        for column in of_b {
            let direction = Vector3::from(rows[column].direction);
            for (a, pair) in pairs.iter().enumerate() {
                let moved = pair * direction;
                for row in first_row[a] as usize..first_row[a + 1] as usize {
                    let entry = moved.dot(&Vector3::from(rows[row].direction));
                    w[n * column + row] = entry;
                    w[n * row + column] = entry;
                }
            }
        }
    }
}
