//! Bodies of a filled surface that lie in each other: each is meshed by itself, and its new surface is off the old one.
//!
//! Entry point: [`overlaps`].

use super::Hint;
use std::ops::Range;
use sutura_host::collide::{Penetration, Solid};
use sutura_host::mesh::RawMesh;
use sutura_host::work::begin;
use sutura_host::wound::Overlap;

/// Depth from which bodies lie in each other [mean edges of the boundary]: more than rounding leaves of faces that touch.
const LEAST: f64 = 0.01;

/// A warning for each two bodies that lie in each other; `bodies` are the cells of each.
pub fn overlaps(mesh: &RawMesh, bodies: &[Range<usize>]) -> Vec<Hint> {
    if bodies.len() < 2 {
        return Vec::new();
    }
    begin("looking whether bodies lie in each other", || {
        format!("{} bodies", bodies.len())
    });
    let solid = |cells: &Range<usize>| {
        let solid = Solid::new(&mesh.points_m, &mesh.cells[cells.clone()]);
        let edge_m = solid.mean_edge_m();
        (solid, edge_m)
    };
    let solids: Vec<_> = bodies.iter().map(solid).collect();
    let mut warned = Vec::new();
    for (one, (first, first_m)) in solids.iter().enumerate() {
        for (other, (second, second_m)) in solids.iter().enumerate().skip(one + 1) {
            let into_second = first.penetration_into(second, LEAST * second_m);
            let into_first = second.penetration_into(first, LEAST * first_m);
            let both = [(into_first, *first_m), (into_second, *second_m)];
            warned.extend(hint([one + 1, other + 1], both));
        }
    }
    warned
}

/// Warning of two bodies, by their numbers from 1, each with the other's part that lies in it and its own mean edge \[m\].
fn hint([one, other]: [usize; 2], both: [(Option<Penetration>, f64); 2]) -> Option<Hint> {
    let each = || {
        both.into_iter()
            .filter_map(|(found, edge_m)| Some((found?, edge_m)))
    };
    let ratio = |(found, edge_m): &(Penetration, f64)| found.depth_m / edge_m;
    let deepest = each().max_by(|a, b| ratio(a).total_cmp(&ratio(b)))?;
    let nodes: usize = each().map(|(found, _)| found.nodes).sum();
    let nodes = match nodes {
        0 => "edges of one go through the other".to_owned(),
        1 => "1 node of one lies in the other".to_owned(),
        nodes => format!("{nodes} nodes of either lie in the other"),
    };
    let ([x, y, z], ratio) = (deepest.0.at_m, ratio(&deepest));
    let message = format!(
        "bodies {one} and {other} lie in each other by up to {ratio:.2} mean edges ({:.3} mm), at about [{x:.6}, {y:.6}, {z:.6}] m: {nodes}",
        1e3 * deepest.0.depth_m
    );
    let scenes = match Overlap::of(ratio) {
        Some(_) => "scenes in which they may touch refuse that",
        None => "what lies in another body is not kept apart there",
    };
    let help = format!(
        "cells of this size cut across the gap between them: ask for more --nodes, or move the surfaces farther apart; {scenes}"
    );
    Some(Hint { message, help })
}
