//! Points of tissue that are held or moved: equality rows, condensed by their compliance.
//!
//! Entry point: [`HeldPoints::new`]. With Y = K^-1 C' and W = C Y (younes-2021, 2.2.2):
//! `lambda = W^-1 (C u_free - b)`, `u = u_free - Y lambda`, force on the tissue `-C' lambda`.

use super::error::TissueError;
use super::factor::Factor;
use super::numbering::Numbering;

/// A point of tissue: a weighted sum of nodes, usually barycentric in a face or cell.
#[derive(Clone, Debug, PartialEq)]
pub struct Anchor {
    /// Mesh nodes.
    pub vertices: Vec<u32>,
    /// Weight of each; they should add up to 1.
    pub weights: Vec<f64>,
}

/// An anchor and where it has to go.
#[derive(Clone, Debug, PartialEq)]
pub struct Handle {
    /// The point.
    pub anchor: Anchor,
    /// Its displacement from rest \[m\], (3), world frame.
    pub target_displacement_m: [f64; 3],
}

impl Anchor {
    /// The weighted sum of a field over the nodes.
    pub(crate) fn sum(&self, field: impl Fn(u32) -> [f64; 3]) -> [f64; 3] {
        let mut sum = [0.0; 3];
        for (&node, &weight) in self.vertices.iter().zip(&self.weights) {
            let value = field(node);
            for axis in 0..3 {
                sum[axis] += weight * value[axis];
            }
        }
        sum
    }
}

/// Tissue with a factored stiffness.
pub(crate) trait Factored {
    /// Where the nodes are among the unknowns.
    fn numbering(&self) -> &Numbering;
    /// The stiffness, as its factor.
    fn factor(&self) -> &Factor;
}

/// Anchors held by equality rows, ready to correct any solution of the tissue without them.
#[derive(Debug)]
pub(crate) struct HeldPoints {
    anchors: Vec<Anchor>,
    /// K^-1 C', one column of unknowns per row \[m/N\].
    y: Vec<f64>,
    /// Cholesky factor of W, lower, by rows.
    w_factor: Vec<f64>,
}

impl HeldPoints {
    pub fn new(tissue: &impl Factored, anchors: Vec<Anchor>) -> Result<Self, TissueError> {
        let (numbering, factor) = (tissue.numbering(), tissue.factor());
        for (handle, anchor) in anchors.iter().enumerate() {
            check(handle, anchor, numbering.nodes())?;
        }
        let rows = 3 * anchors.len();
        let unknowns = numbering.unknowns();
        let mut y = vec![0.0; unknowns * rows];
        for (row, column) in y.chunks_exact_mut(unknowns.max(1)).enumerate() {
            let anchor = &anchors[row / 3];
            for (&node, &weight) in anchor.vertices.iter().zip(&anchor.weights) {
                if let Some(first) = numbering.first_unknown(node) {
                    column[first + row % 3] += weight;
                }
            }
        }
        if rows > 0 {
            factor.solve(&mut y, &mut factor.scratch());
        }
        let mut held = Self {
            anchors,
            y,
            w_factor: vec![0.0; rows * rows],
        };
        let mut column = vec![0.0; rows];
        for row in 0..rows {
            let y = &held.y[unknowns * row..unknowns * (row + 1)];
            held.at_anchors(numbering, y, &mut column);
            for (other, &value) in column.iter().enumerate() {
                held.w_factor[rows * other + row] = value;
            }
        }
        factor_in_place(&mut held.w_factor, rows)
            .map_err(|row| TissueError::HandlesConflict { handle: row / 3 })?;
        Ok(held)
    }

    /// No points.
    pub fn none() -> Self {
        Self {
            anchors: Vec::new(),
            y: Vec::new(),
            w_factor: Vec::new(),
        }
    }

    /// Number of rows: three per anchor.
    pub fn rows(&self) -> usize {
        3 * self.anchors.len()
    }

    pub fn is_empty(&self) -> bool {
        self.anchors.is_empty()
    }

    /// Makes `u` (unknowns) satisfy `C u = target`; `lambda` (3 per anchor) carries the target in and
    /// the multipliers out.
    pub fn correct(&self, tissue: &impl Factored, u: &mut [f64], lambda: &mut [f64]) {
        let rows = 3 * self.anchors.len();
        let numbering = tissue.numbering();
        let unknowns = numbering.unknowns();
        for (anchor, lambda) in self.anchors.iter().zip(lambda.chunks_exact_mut(3)) {
            let at = anchor.sum(|node| numbering.at_node(u, node));
            for axis in 0..3 {
                lambda[axis] = at[axis] - lambda[axis];
            }
        }
        solve_factored(&self.w_factor, rows, lambda);
        for (row, &lambda) in lambda.iter().enumerate() {
            for (u, y) in u.iter_mut().zip(&self.y[unknowns * row..]) {
                *u -= y * lambda;
            }
        }
    }

    fn at_anchors(&self, numbering: &Numbering, u: &[f64], out: &mut [f64]) {
        for (anchor, out) in self.anchors.iter().zip(out.chunks_exact_mut(3)) {
            out.copy_from_slice(&anchor.sum(|node| numbering.at_node(u, node)));
        }
    }
}

fn check(handle: usize, anchor: &Anchor, nodes: usize) -> Result<(), TissueError> {
    let sound = anchor.vertices.len() == anchor.weights.len()
        && !anchor.vertices.is_empty()
        && anchor.weights.iter().all(|weight| weight.is_finite());
    if !sound {
        return Err(TissueError::AnchorWeights { handle });
    }
    match anchor.vertices.iter().find(|node| **node as usize >= nodes) {
        Some(&node) => Err(TissueError::NoSuchNode {
            what: "a handle",
            node,
            nodes,
        }),
        None => Ok(()),
    }
}

/// Cholesky of a small dense matrix by rows, lower triangle; the first row that depends on those
/// before it as the error.
fn factor_in_place(w: &mut [f64], n: usize) -> Result<(), usize> {
    for i in 0..n {
        let diagonal = w[n * i + i];
        for j in 0..=i {
            let dot: f64 = (0..j).map(|k| w[n * i + k] * w[n * j + k]).sum();
            let rest = w[n * i + j] - dot;
            w[n * i + j] = if j < i {
                rest / w[n * j + j]
            } else if rest > 1e-12 * diagonal {
                rest.sqrt()
            } else {
                return Err(i);
            };
        }
    }
    Ok(())
}

fn solve_factored(factor: &[f64], n: usize, x: &mut [f64]) {
    for i in 0..n {
        let dot: f64 = (0..i).map(|k| factor[n * i + k] * x[k]).sum();
        x[i] = (x[i] - dot) / factor[n * i + i];
    }
    for i in (0..n).rev() {
        let dot: f64 = (i + 1..n).map(|k| factor[n * k + i] * x[k]).sum();
        x[i] = (x[i] - dot) / factor[n * i + i];
    }
}
