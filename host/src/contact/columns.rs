//! Columns of K^-1 for touched vertices, kept once computed.
//!
//! Entry points: [`Columns::compute`], [`Columns::block`]. A column is restricted to the touchable
//! vertices of the boundary, so that a step costs nothing that grows with the volume of the mesh.

use crate::fem::SolveScratch;
use crate::model::Model;
use nalgebra::{Matrix3, Vector3};

/// Vertices solved for together: enough for the factor to be streamed once for many columns, few
/// enough for the right-hand sides to stay in the cache.
const BATCH: usize = 8;

const MISSING: u32 = u32::MAX;

/// The cache. Vertices are numbered among the touchable ones.
pub(crate) struct Columns {
    /// Place of each vertex's columns in `data`, or [`MISSING`], (b).
    place: Vec<u32>,
    /// For each vertex three columns of 3 b displacements for a unit force along x, y, z \[m/N\].
    data: Vec<f64>,
    length: usize,
    rhs: Vec<f64>,
    lambda: Vec<f64>,
    scratch: SolveScratch,
}

impl Columns {
    pub fn new(model: &Model) -> Self {
        Self {
            place: vec![MISSING; model.touchable.len()],
            data: Vec::new(),
            length: 3 * model.touchable.len(),
            rhs: vec![0.0; 3 * BATCH * model.tissue.unknowns()],
            lambda: vec![0.0; model.held.rows()],
            scratch: model.tissue.scratch(3 * BATCH),
        }
    }

    pub fn has(&self, vertex: u32) -> bool {
        self.place[vertex as usize] != MISSING
    }

    /// Vertices whose columns are there.
    pub fn count(&self) -> usize {
        self.data.len() / (3 * self.length).max(1)
    }

    pub fn bytes(&self) -> usize {
        size_of_val(self.data.as_slice())
    }

    /// Computes the columns of `vertices`; those that are there already are computed again in vain.
    pub fn compute(&mut self, model: &Model, vertices: &[u32]) {
        let unknowns = model.tissue.unknowns();
        for batch in vertices.chunks(BATCH) {
            self.rhs[..3 * batch.len() * unknowns].fill(0.0);
            for (which, &vertex) in batch.iter().enumerate() {
                // Touchable vertices are free.
                let node = model.touchable[vertex as usize];
                if let Some(first) = model.tissue.first_unknown(node) {
                    for axis in 0..3 {
                        self.rhs[(3 * which + axis) * unknowns + first + axis] = 1.0;
                    }
                }
            }
            let rhs = &mut self.rhs[..3 * batch.len() * unknowns];
            model
                .tissue
                .solve_unknowns(rhs, 3 * batch.len(), &mut self.scratch);
            for (which, &vertex) in batch.iter().enumerate() {
                self.place[vertex as usize] = self.count() as u32;
                for axis in 0..3 {
                    let at = (3 * which + axis) * unknowns;
                    let u = &mut self.rhs[at..at + unknowns];
                    if !model.held.is_empty() {
                        // Handles stay where they are while the tool pushes.
                        self.lambda.fill(0.0);
                        model.held.correct(&model.tissue, u, &mut self.lambda);
                    }
                    for &node in &model.touchable {
                        self.data.extend(model.tissue.at_node(u, node));
                    }
                }
            }
        }
    }

    fn of(&self, vertex: u32) -> &[f64] {
        let start = 3 * self.length * self.place[vertex as usize] as usize;
        &self.data[start..start + 3 * self.length]
    }

    /// Displacement of `at` per force on `pushed`, whose columns must be there \[m/N\].
    pub fn block(&self, at: u32, pushed: u32) -> Matrix3<f64> {
        let columns = self.of(pushed);
        let at = 3 * at as usize;
        Matrix3::from_fn(|row, axis| columns[self.length * axis + at + row])
    }

    /// Adds the displacement of every vertex for a force on `pushed` to `u` (3 b).
    pub fn add(&self, pushed: u32, force: &Vector3<f64>, u: &mut [f64]) {
        let (x, rest) = self.of(pushed).split_at(self.length);
        let (y, z) = rest.split_at(self.length);
        for ((u, x), (y, z)) in u.iter_mut().zip(x).zip(y.iter().zip(z)) {
            *u += x * force.x + y * force.y + z * force.z;
        }
    }
}
