//! Solves for the columns of a few vertices at once, and reads them at the vertices that count.
//!
//! Entry points: [`ColumnSolver::solve`], then [`ColumnSolver::read`].

use crate::fem::{ColumnScratch, Factored, HeldPoints};

/// Where columns are read, and buffers.
#[derive(Clone)]
pub(crate) struct ColumnSolver {
    /// First unknown of every vertex that can be reached, (b).
    first_unknown: Vec<usize>,
    /// Parts of the factor that a solve must visit.
    needed: Vec<u32>,
    scratch: Vec<ColumnScratch>,
    /// One whole column, (unknowns): only where points are held.
    whole: Vec<f64>,
    lambda: Vec<f64>,
}

impl ColumnSolver {
    /// Vertices solved for together: enough for the factor to be fetched from memory once for many
    /// columns, few enough for the right-hand sides to stay in the cache.
    pub const BATCH: usize = 8;

    /// For forces on and displacements of the free nodes `reached`.
    pub fn new(tissue: &impl Factored, held: &HeldPoints, reached: &[u32]) -> Self {
        let (numbering, factor) = (tissue.numbering(), tissue.factor());
        let first_unknown: Vec<usize> = reached
            .iter()
            .filter_map(|&node| numbering.first_unknown(node))
            .collect();
        debug_assert_eq!(first_unknown.len(), reached.len(), "a fixed node");
        let unknowns = numbering.unknowns();
        let (needed, whole) = if held.is_empty() {
            let read = first_unknown.iter().flat_map(|&first| first..first + 3);
            (factor.needed_for(read), 0)
        } else {
            (factor.needed_for(0..unknowns), unknowns)
        };
        Self {
            first_unknown,
            needed,
            scratch: (0..Self::BATCH).map(|_| factor.column_scratch()).collect(),
            whole: vec![0.0; whole],
            lambda: vec![0.0; held.rows()],
        }
    }

    /// First unknown of a vertex.
    pub fn first_unknown(&self, vertex: u32) -> usize {
        self.first_unknown[vertex as usize]
    }

    /// Solves for unit forces on up to [`Self::BATCH`] `vertices`, counted among the reached.
    pub fn solve(&mut self, tissue: &impl Factored, vertices: &[u32]) {
        let mut unknowns = [[0; 3]; Self::BATCH];
        for (unknowns, &vertex) in unknowns.iter_mut().zip(vertices) {
            let first = self.first_unknown[vertex as usize];
            *unknowns = [first, first + 1, first + 2];
        }
        let unknowns = &unknowns[..vertices.len().min(Self::BATCH)];
        tissue
            .factor()
            .solve_columns(unknowns, &self.needed, &mut self.scratch);
    }

    /// The blocks (b x 3 x 3, column-major) of the vertex at place `which` of the last solve. Held points
    /// stay where they are while it is pushed.
    pub fn read(
        &mut self,
        tissue: &impl Factored,
        held: &HeldPoints,
        which: usize,
        blocks: &mut [f64],
    ) {
        let factor = tissue.factor();
        let scratch = &self.scratch[which];
        if held.is_empty() {
            for (block, &first) in blocks.chunks_exact_mut(9).zip(&self.first_unknown) {
                for axis in 0..3 {
                    let row = factor.read_column(scratch, first + axis);
                    for (column, value) in row.iter().enumerate() {
                        block[3 * column + axis] = *value;
                    }
                }
            }
            return;
        }
        for column in 0..3 {
            for (unknown, u) in self.whole.iter_mut().enumerate() {
                *u = factor.read_column(scratch, unknown)[column];
            }
            self.lambda.fill(0.0);
            held.correct(tissue, &mut self.whole, &mut self.lambda);
            for (block, &first) in blocks.chunks_exact_mut(9).zip(&self.first_unknown) {
                block[3 * column..3 * column + 3].copy_from_slice(&self.whole[first..first + 3]);
            }
        }
    }
}
