//! W = C K^-1 C' by barycentric sums of cached blocks.
//!
//! Entry point: [`assemble`].

use super::{AnchorRow, SpreadRow, Term};
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

/// Rows on several anchors.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Spread {
    pub rows: Vec<SpreadRow>,
    pub terms: Vec<Term>,
}

impl Spread {
    pub fn terms_of(&self, row: &SpreadRow) -> &[Term] {
        let (first, count) = (row.terms.0 as usize, row.terms.1 as usize);
        self.terms.get(first..first + count).unwrap_or_default()
    }

    /// As a copy of `other`, without new memory.
    pub fn copy_from(&mut self, other: &Self) {
        self.rows.clone_from(&other.rows);
        self.terms.clone_from(&other.terms);
    }
}

/// Fills `w` (n x n, column-major, both triangles), n the number of `rows` and `spread` rows, with the former
/// first, which are in the order of their anchors; `first_row` (anchors + 1) says where each anchor's rows
/// begin. `pairs` (anchors) and `moved` (spread rows x anchors) are scratch.
#[expect(clippy::too_many_arguments, reason = "buffers of one owner")]
pub(super) fn assemble(
    anchors: &[Reached],
    rows: &[AnchorRow],
    first_row: &[u32],
    spread: &Spread,
    columns: &Columns,
    pairs: &mut [Matrix3<f64>],
    moved: &mut [Vector3<f64>],
    w: &mut [f64],
) {
    let single = rows.len();
    let n = single + spread.rows.len();
    moved.fill(Vector3::zeros());
    for (b, pushed) in anchors.iter().enumerate() {
        let of_b = first_row[b] as usize..first_row[b + 1] as usize;
        if of_b.is_empty() && spread.rows.is_empty() {
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
        // What unit forces of the spread rows move each anchor by.
        for (index, row) in spread.rows.iter().enumerate() {
            let moved = &mut moved[index * anchors.len()..(index + 1) * anchors.len()];
            for term in spread.terms_of(row) {
                let direction = Vector3::from(term.direction);
                let at = term.anchor as usize;
                if at == b {
                    for (moved, pair) in moved.iter_mut().zip(pairs.iter()) {
                        *moved += pair * direction;
                    }
                } else if at < b {
                    moved[b] += pairs[at].transpose() * direction;
                }
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
    for (index, row) in spread.rows.iter().enumerate() {
        let column = single + index;
        let moved = &moved[index * anchors.len()..(index + 1) * anchors.len()];
        for (place, row) in rows.iter().enumerate() {
            let entry = moved[row.anchor as usize].dot(&Vector3::from(row.direction));
            w[n * column + place] = entry;
            w[n * place + column] = entry;
        }
        for (other, before) in spread.rows[..=index].iter().enumerate() {
            let entry: f64 = spread
                .terms_of(before)
                .iter()
                .map(|term| moved[term.anchor as usize].dot(&Vector3::from(term.direction)))
                .sum();
            w[n * column + single + other] = entry;
            w[n * (single + other) + column] = entry;
        }
        // What gives way besides the tissue.
        w[(n + 1) * column] += row.compliance_m_per_n;
    }
}
