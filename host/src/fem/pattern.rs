//! Where every cell's stiffness goes in the lower triangle: found once, filled again and again.
//!
//! Entry points: [`Pattern::new`], [`Pattern::add_cell`], which allocates nothing.

use nalgebra::Matrix3;
use sutura_factor::Lower;

/// Marks a block with a fixed node, which is not kept.
const NOT_KEPT: u32 = u32::MAX;

/// Pairs of a cell's corners, the first with the higher place: one block of the triangle each.
#[rustfmt::skip]
pub(super) const PAIRS: [(usize, usize); 10] = [
    (0, 0),
    (1, 0), (1, 1),
    (2, 0), (2, 1), (2, 2),
    (3, 0), (3, 1), (3, 2), (3, 3),
];

/// Lower triangle in compressed columns, rows ascending in each; each cell's blocks in it.
#[derive(Debug)]
pub(crate) struct Pattern {
    pub unknowns: usize,
    pub column_start: Vec<usize>,
    pub row: Vec<usize>,
    /// Of each cell's [`PAIRS`], (m x 10).
    blocks: Vec<[Block; 10]>,
}

/// Place of a 3 x 3 block: of its first column, and how long that column of the triangle is.
#[derive(Clone, Copy, Debug)]
struct Block {
    first: u32,
    column_length: u32,
}

/// The corners of a cell in the order of their places, as [`Pattern::new`] wants them.
pub(super) fn ascending(places: [u32; 4]) -> [usize; 4] {
    let mut order = [0, 1, 2, 3];
    order.sort_unstable_by_key(|&corner| places[corner]);
    order
}

impl Pattern {
    /// `cells` as places of their corners, ascending, of which those below `free` are kept.
    pub fn new(cells: &[[u32; 4]], free: u32) -> Self {
        // (column, row), row >= column, of nodes that share a cell.
        let mut pairs: Vec<(u32, u32)> = Vec::with_capacity(10 * cells.len());
        for cell in cells {
            for (b, &column) in cell.iter().enumerate() {
                let kept = cell[b..].iter().filter(|row| **row < free);
                pairs.extend(kept.map(|&row| (column, row)));
            }
        }
        pairs.sort_unstable();
        pairs.dedup();
        let mut pair_start = vec![0; free as usize + 1];
        for &(column, _) in &pairs {
            pair_start[column as usize + 1] += 1;
        }
        for column in 0..free as usize {
            pair_start[column + 1] += pair_start[column];
        }

        let unknowns = 3 * free as usize;
        let mut column_start = Vec::with_capacity(unknowns + 1);
        let mut row = Vec::with_capacity(9 * pairs.len());
        column_start.push(0);
        for column in 0..free as usize {
            for axis in 0..3 {
                for &(_, other) in &pairs[pair_start[column]..pair_start[column + 1]] {
                    let first = if other as usize == column { axis } else { 0 };
                    row.extend((first..3).map(|axis| 3 * other as usize + axis));
                }
                column_start.push(row.len());
            }
        }

        let block = |column: u32, row: u32| {
            if row >= free {
                return Block {
                    first: NOT_KEPT,
                    column_length: 0,
                };
            }
            let at = column as usize;
            let range = &pairs[pair_start[at]..pair_start[at + 1]];
            let place = range.partition_point(|pair| *pair < (column, row));
            let start = column_start[3 * at];
            Block {
                first: (start + 3 * place) as u32,
                column_length: (column_start[3 * at + 1] - start) as u32,
            }
        };
        let blocks = cells
            .iter()
            .map(|cell| PAIRS.map(|(a, b)| block(cell[b], cell[a])))
            .collect();
        Self {
            unknowns,
            column_start,
            row,
            blocks,
        }
    }

    /// Of columns that are known already, for values that come from elsewhere.
    pub fn of_columns(column_start: Vec<usize>, row: Vec<usize>) -> Self {
        Self {
            unknowns: column_start.len() - 1,
            column_start,
            row,
            blocks: Vec::new(),
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

    /// Adds the blocks of a cell's [`PAIRS`] to the triangle's values \[N/m\], (entries).
    #[inline]
    pub fn add_cell(&self, values: &mut [f64], cell: usize, blocks: &[Matrix3<f64>; 10]) {
        for ((place, block), (a, b)) in self.blocks[cell].iter().zip(blocks).zip(PAIRS) {
            if place.first == NOT_KEPT {
                continue;
            }
            // The column's diagonal block loses a row with every column.
            let (first, length) = (place.first as usize, place.column_length as usize);
            let columns = [first, first + length - 1, first + 2 * length - 3];
            for (j, at) in columns.into_iter().enumerate() {
                let top = if a == b { j } else { 0 };
                for (i, value) in values[at + top..at + 3].iter_mut().enumerate() {
                    *value += block[(top + i, j)];
                }
            }
        }
    }

    /// out = A x with the triangle's values, both halves.
    pub fn multiply(&self, values: &[f64], x: &[f64], out: &mut [f64]) {
        out.fill(0.0);
        for column in 0..self.unknowns {
            let range = self.column_start[column]..self.column_start[column + 1];
            for (&row, value) in self.row[range.clone()].iter().zip(&values[range]) {
                out[row] += value * x[column];
                if row != column {
                    out[column] += value * x[row];
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two cells on a face, one node fixed: the same sum as a dense matrix has.
    #[test]
    fn blocks_add_up_as_in_a_dense_matrix() {
        let cells = [[0, 1, 2, 3], [1, 2, 3, 4]];
        let free = 4;
        let pattern = Pattern::new(&cells, free);
        assert_eq!(pattern.unknowns, 12);
        let mut values = vec![0.0; pattern.entries()];
        let mut dense = [[0.0; 12]; 12];
        for (index, cell) in cells.iter().enumerate() {
            let blocks = PAIRS.map(|(a, b)| {
                let block =
                    Matrix3::from_fn(|i, j| (1 + i + 4 * j + 17 * a + 71 * b + 301 * index) as f64);
                if a == b {
                    block + block.transpose()
                } else {
                    block
                }
            });
            pattern.add_cell(&mut values, index, &blocks);
            for ((a, b), block) in PAIRS.into_iter().zip(blocks) {
                let (row, column) = (cell[a] as usize, cell[b] as usize);
                if row >= free as usize {
                    continue;
                }
                for i in 0..3 {
                    for j in 0..3 {
                        dense[3 * row + i][3 * column + j] += block[(i, j)];
                        if row != column {
                            dense[3 * column + j][3 * row + i] += block[(i, j)];
                        }
                    }
                }
            }
        }
        for column in 0..12 {
            let mut unit = [0.0; 12];
            unit[column] = 1.0;
            let mut found = [0.0; 12];
            pattern.multiply(&values, &unit, &mut found);
            assert_eq!(found, dense.map(|row| row[column]), "column {column}");
        }
    }
}
