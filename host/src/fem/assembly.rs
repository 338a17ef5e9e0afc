//! Stiffness of undeformed tissue: the lower triangle for the unknowns of free nodes.
//!
//! Entry point: [`assemble`].

use super::element::Element;
use super::error::TissueError;
use super::pattern::{PAIRS, Pattern};
use crate::work;
use sutura_models::memory;

/// What assembly takes for a cell at most, elements, pattern and its analysis included \[bytes\]; counted on slabs, whose
/// nodes have 14 neighbours.
const BYTES_PER_CELL: u64 = 800;

/// Whether there is memory to assemble so many cells; says that it is begun.
///
/// # Errors
/// [`TissueError::TooLarge`].
pub(super) fn begin(cells: usize) -> Result<(), TissueError> {
    memory::require("its stiffness", BYTES_PER_CELL * cells as u64)?;
    work::begin("assembling the stiffness", || format!("{cells} cells"));
    match work::is_stopped() {
        true => Err(TissueError::Stopped),
        false => Ok(()),
    }
}

/// Sums the stiffness of [placed](Element::placed) elements over the `free` first places: where, and how
/// much \[N/m\].
pub(super) fn assemble(elements: &[Element], free: u32) -> (Pattern, Vec<f64>) {
    let cells: Vec<[u32; 4]> = elements.iter().map(|element| element.nodes).collect();
    let pattern = Pattern::new(&cells, free);
    let mut values = vec![0.0; pattern.entries()];
    for (cell, element) in elements.iter().enumerate() {
        let blocks = PAIRS.map(|(a, b)| element.stiffness(a, b));
        pattern.add_cell(&mut values, cell, &blocks);
    }
    (pattern, values)
}
