//! Nodes that are held by the drive of a step, any of them: their rows of a stiffness become diagonal.
//!
//! Entry points: [`Held::take`], [`Held::mask`]. The pattern stays that of all nodes, and so does its
//! analysis: another set of held nodes costs a factorisation and allocates nothing.

use super::pattern::Pattern;
use sutura_models::BoundaryConditions;

/// Which nodes are held.
#[derive(Clone, Debug)]
pub(super) struct Held {
    is_held: Vec<bool>,
    held: usize,
    /// Whether a step has said so.
    known: bool,
}

impl Held {
    /// None of so many nodes.
    pub fn none(nodes: usize) -> Self {
        Self {
            is_held: vec![false; nodes],
            held: 0,
            known: false,
        }
    }

    /// Takes the held nodes of a checked drive; whether they are others than before.
    pub fn take(&mut self, drive: &BoundaryConditions<'_>) -> bool {
        if self.are_of(drive) {
            return false;
        }
        self.is_held.fill(false);
        for (node, _) in drive.held {
            self.is_held[*node as usize] = true;
        }
        (self.held, self.known) = (drive.held.len(), true);
        true
    }

    /// Whether these are the held nodes of a checked drive.
    pub fn are_of(&self, drive: &BoundaryConditions<'_>) -> bool {
        self.known
            && self.held == drive.held.len()
            && drive.held.iter().all(|(node, _)| self.is(*node))
    }

    /// The next [`Self::take`] finds others in any case.
    pub fn forget(&mut self) {
        self.known = false;
    }

    /// Whether a node is held.
    pub fn is(&self, node: u32) -> bool {
        self.is_held[node as usize]
    }

    /// Sets held nodes' entries of a vector to zero.
    pub fn clear(&self, vector: &mut [f64]) {
        for (values, held) in vector.chunks_exact_mut(3).zip(&self.is_held) {
            if *held {
                values.fill(0.0);
            }
        }
    }

    /// Cuts held nodes off the lower triangle of a stiffness: their rows and columns are those of the
    /// largest entry times the identity.
    pub fn mask(&self, pattern: &Pattern, stiffness: &mut [f64]) {
        let pivot = largest(stiffness).max(f64::MIN_POSITIVE);
        for column in 0..pattern.unknowns {
            let own = self.is_held[column / 3];
            let range = pattern.column_start[column]..pattern.column_start[column + 1];
            for (&row, value) in pattern.row[range.clone()].iter().zip(&mut stiffness[range]) {
                if own || self.is_held[row / 3] {
                    *value = if row == column { pivot } else { 0.0 };
                }
            }
        }
    }
}

/// What is wrong with a drive for tissue of so many nodes.
pub(super) fn fault_of(drive: &BoundaryConditions<'_>, nodes: usize) -> Option<&'static str> {
    let ascending = drive.held.windows(2).all(|two| two[0].0 < two[1].0);
    let last = drive.held.last().map_or(0, |(node, _)| *node as usize);
    let finite = |vector: &[f64; 3]| vector.iter().all(|x| x.is_finite());
    if !ascending {
        Some("held nodes are not in ascending order")
    } else if last >= nodes {
        Some("a held node is not in the mesh")
    } else if !drive.force_n.is_empty() && drive.force_n.len() != nodes {
        Some("there is not one force for each node")
    } else if !drive.held.iter().all(|(_, target)| finite(target)) {
        Some("a held node's displacement is not finite")
    } else if !drive.force_n.iter().all(finite) {
        Some("a force is not finite")
    } else if drive.held.len() == nodes {
        Some("all nodes are held: nothing can move")
    } else {
        None
    }
}

/// Largest magnitude.
pub(super) fn largest(values: &[f64]) -> f64 {
    values.iter().fold(0.0, |most: f64, x| most.max(x.abs()))
}
