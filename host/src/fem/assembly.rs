//! Lower triangle of the stiffness matrix in compressed columns, for the unknowns of free nodes.
//!
//! Entry point: [`assemble`].

use super::element::Element;

/// Marks a fixed node in the numbering of free nodes.
pub(super) const FIXED: u32 = u32::MAX;

/// Lower triangle, rows ascending in each column.
pub(super) struct LowerTriangle {
    pub unknowns: usize,
    pub column_start: Vec<usize>,
    pub row: Vec<usize>,
    /// \[N/m\]
    pub value: Vec<f64>,
}

/// Sums the elements' stiffness over free nodes; `free_of_node` numbers them or says [`FIXED`].
pub(super) fn assemble(
    elements: &[Element],
    free_of_node: &[u32],
    free_nodes: usize,
) -> LowerTriangle {
    // Blocks (column, row), row >= column, of nodes that share an element.
    let mut blocks: Vec<(u32, u32)> = Vec::with_capacity(10 * elements.len());
    for element in elements {
        let free = element.nodes.map(|node| free_of_node[node as usize]);
        for column in free {
            for row in free {
                if row != FIXED && column <= row {
                    blocks.push((column, row));
                }
            }
        }
    }
    blocks.sort_unstable();
    blocks.dedup();
    let mut block_start = vec![0; free_nodes + 1];
    for &(column, _) in &blocks {
        block_start[column as usize + 1] += 1;
    }
    for column in 0..free_nodes {
        block_start[column + 1] += block_start[column];
    }

    let unknowns = 3 * free_nodes;
    let mut column_start = Vec::with_capacity(unknowns + 1);
    let mut row = Vec::with_capacity(9 * blocks.len());
    column_start.push(0);
    for column in 0..free_nodes {
        for axis in 0..3 {
            for &(_, block_row) in &blocks[block_start[column]..block_start[column + 1]] {
                let first = if block_row as usize == column {
                    axis
                } else {
                    0
                };
                row.extend((first..3).map(|axis| 3 * block_row as usize + axis));
            }
            column_start.push(row.len());
        }
    }

    let mut value = vec![0.0; row.len()];
    for element in elements {
        let free = element.nodes.map(|node| free_of_node[node as usize]);
        for b in 0..4 {
            for a in 0..4 {
                if free[a] == FIXED || free[b] == FIXED || free[b] > free[a] {
                    continue;
                }
                let stiffness = element.stiffness(a, b);
                let column = free[b] as usize;
                let range = &blocks[block_start[column]..block_start[column + 1]];
                // The block is there: the same loops made the pattern.
                let Ok(place) = range.binary_search(&(free[b], free[a])) else {
                    continue;
                };
                for j in 0..3 {
                    // The diagonal block comes first and has lost j rows in column j.
                    let first = if free[a] == free[b] { j } else { 0 };
                    let lost = if free[a] == free[b] { 0 } else { j };
                    let at = column_start[3 * column + j] + 3 * place - lost;
                    for i in first..3 {
                        value[at + i - first] += stiffness[(i, j)];
                    }
                }
            }
        }
    }
    LowerTriangle {
        unknowns,
        column_start,
        row,
        value,
    }
}
