//! Lower triangle of a sparse symmetric matrix of 3 x 3 blocks, filled group of nodes by group.
//!
//! Entry points: [`Groups`], nodes that act on one another (the nodes of a cell, the cells around a
//! node); [`Pattern::new`]; [`Pattern::add`], which allocates nothing.

use nalgebra::{Matrix3, Vector3};
use sutura_factor::Lower;

/// Lists of nodes, one after the other.
#[derive(Clone, Debug, Default)]
pub(super) struct Groups {
    start: Vec<usize>,
    nodes: Vec<u32>,
}

impl Groups {
    pub fn push(&mut self, nodes: impl IntoIterator<Item = u32>) {
        if self.start.is_empty() {
            self.start.push(0);
        }
        self.nodes.extend(nodes);
        self.start.push(self.nodes.len());
    }

    pub fn len(&self) -> usize {
        self.start.len().saturating_sub(1)
    }

    pub fn get(&self, group: usize) -> &[u32] {
        &self.nodes[self.start[group]..self.start[group + 1]]
    }
}

/// Compressed columns of the lower triangle, rows ascending; where each group's blocks go.
#[derive(Clone, Debug)]
pub(super) struct Pattern {
    pub unknowns: usize,
    pub column_start: Vec<usize>,
    pub row: Vec<usize>,
    /// Of each pair (i, j), i >= j, of a group, group after group.
    blocks: Vec<Block>,
    /// Where a group's blocks begin, (groups).
    first_block: Vec<usize>,
}

/// Place of a 3 x 3 block: its first entry, and how long that column of the triangle is.
#[derive(Clone, Copy, Debug)]
struct Block {
    first: u32,
    column_length: u32,
    /// The pair's first node comes before its second: the block goes in transposed.
    flipped: bool,
}

impl Pattern {
    pub fn new(nodes: usize, groups: &Groups) -> Self {
        let pairs_of = |group: usize| {
            let nodes = groups.get(group);
            (0..nodes.len()).flat_map(move |i| (0..=i).map(move |j| (nodes[i], nodes[j])))
        };
        // (column, row), row >= column.
        let mut pairs: Vec<(u32, u32)> = (0..groups.len())
            .flat_map(|group| pairs_of(group).map(|(i, j)| (i.min(j), i.max(j))))
            .collect();
        pairs.sort_unstable();
        pairs.dedup();
        let mut pair_start = vec![0; nodes + 1];
        for &(column, _) in &pairs {
            pair_start[column as usize + 1] += 1;
        }
        for column in 0..nodes {
            pair_start[column + 1] += pair_start[column];
        }
        let (mut column_start, mut row) = (vec![0], Vec::with_capacity(9 * pairs.len()));
        for column in 0..nodes {
            for axis in 0..3 {
                for &(_, other) in &pairs[pair_start[column]..pair_start[column + 1]] {
                    let first = if other as usize == column { axis } else { 0 };
                    row.extend((first..3).map(|axis| 3 * other as usize + axis));
                }
                column_start.push(row.len());
            }
        }
        let place = |(i, j): (u32, u32)| {
            let (column, row) = (i.min(j), i.max(j));
            let at = column as usize;
            let range = &pairs[pair_start[at]..pair_start[at + 1]];
            let place = range.partition_point(|pair| *pair < (column, row));
            let start = column_start[3 * at];
            Block {
                first: (start + 3 * place) as u32,
                column_length: (column_start[3 * at + 1] - start) as u32,
                flipped: i < j,
            }
        };
        let (mut blocks, mut first_block) = (Vec::new(), Vec::with_capacity(groups.len()));
        for group in 0..groups.len() {
            first_block.push(blocks.len());
            blocks.extend(pairs_of(group).map(place));
        }
        Self {
            unknowns: 3 * nodes,
            column_start,
            row,
            blocks,
            first_block,
        }
    }

    /// Where the triangle has entries.
    pub fn lower(&self) -> Lower<'_> {
        Lower {
            column_start: &self.column_start,
            row: &self.row,
        }
    }

    /// Entries of the triangle.
    pub fn entries(&self) -> usize {
        self.row.len()
    }

    /// Adds the block of the pair (i, j), i >= j, of a group's nodes; with i = j it is symmetric.
    #[inline]
    pub fn add(
        &self,
        values: &mut [f64],
        group: usize,
        (i, j): (usize, usize),
        block: &Matrix3<f64>,
    ) {
        let place = self.blocks[self.first_block[group] + i * (i + 1) / 2 + j];
        // The column's diagonal block loses a row with every column.
        let (first, length) = (place.first as usize, place.column_length as usize);
        let columns = [first, first + length - 1, first + 2 * length - 3];
        for (column, at) in columns.into_iter().enumerate() {
            let top = if i == j { column } else { 0 };
            for (row, value) in (top..3).zip(&mut values[at + top..at + 3]) {
                *value += if place.flipped {
                    block[(column, row)]
                } else {
                    block[(row, column)]
                };
            }
        }
    }

    /// Where the diagonal entry of an unknown stands.
    pub fn diagonal(&self, unknown: usize) -> usize {
        self.column_start[unknown]
    }

    /// out = A x, both halves of the triangle, (nodes x 3).
    pub fn multiply(&self, values: &[f64], x: &[Vector3<f64>], out: &mut [Vector3<f64>]) {
        out.fill(Vector3::zeros());
        for column in 0..self.unknowns {
            let (node, axis) = (column / 3, column % 3);
            let x_column = x[node][axis];
            let mut sum = 0.0;
            let range = self.column_start[column]..self.column_start[column + 1];
            for (&row, value) in self.row[range.clone()].iter().zip(&values[range]) {
                out[row / 3][row % 3] += value * x_column;
                if row != column {
                    sum += value * x[row / 3][row % 3];
                }
            }
            out[node][axis] += sum;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Groups in any order of nodes add up as in a dense matrix.
    #[test]
    fn blocks_add_up_as_in_a_dense_matrix() {
        let mut groups = Groups::default();
        groups.push([0, 3, 1, 2]);
        groups.push([4, 1, 3]);
        let pattern = Pattern::new(5, &groups);
        let mut values = vec![0.0; pattern.entries()];
        let mut dense = [[0.0; 15]; 15];
        for group in 0..groups.len() {
            let nodes = groups.get(group);
            for i in 0..nodes.len() {
                for j in 0..=i {
                    let block = Matrix3::from_fn(|r, c| {
                        (1 + r + 4 * c + 17 * i + 71 * j + 301 * group) as f64
                    });
                    let block = if i == j {
                        block + block.transpose()
                    } else {
                        block
                    };
                    pattern.add(&mut values, group, (i, j), &block);
                    let (row, column) = (3 * nodes[i] as usize, 3 * nodes[j] as usize);
                    for r in 0..3 {
                        for c in 0..3 {
                            dense[row + r][column + c] += block[(r, c)];
                            if i != j {
                                dense[column + c][row + r] += block[(r, c)];
                            }
                        }
                    }
                }
            }
        }
        for column in 0..15 {
            let mut unit = [Vector3::zeros(); 5];
            unit[column / 3][column % 3] = 1.0;
            let mut found = [Vector3::zeros(); 5];
            pattern.multiply(&values, &unit, &mut found);
            for row in 0..15 {
                assert_eq!(found[row / 3][row % 3], dense[row][column]);
            }
            assert_eq!(pattern.row[pattern.diagonal(column)], column);
        }
    }
}
