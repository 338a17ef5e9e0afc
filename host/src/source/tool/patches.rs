//! Patches of the surface that a tool presses on: touched vertices with no more than two others between them.
//!
//! Entry point: [`Patches::largest_share`]. Lips of a cut are two patches, of one mesh or of two: the way along the surface from
//! one to the other leads around the cut. Each pushes the tool away from the other one; patches that push it the same way bear it
//! side by side, as one.

use super::{Contact, TouchingTools};
use crate::marks::Marks;
use nalgebra::Vector3;

/// Cosine of the angle between the forces of patches that push a tool the same way.
const SAME_WAY: f64 = 0.9;

/// Parent of a vertex outside all patches.
const NONE: u32 = u32::MAX;

/// Scratch: a forest of touched vertices and those beside them (Galler & Fischer 1964).
#[derive(Debug)]
pub(crate) struct Patches {
    touched: Marks,
    /// Another vertex of its patch, or itself, (b).
    parent: Vec<u32>,
    /// Normal force of a patch on the tool \[N\], (3), and the sum of its parts' magnitudes, at the vertex that is its own parent, (b).
    pressed: Vec<(Vector3<f64>, f64)>,
}

impl Patches {
    pub fn new(tools: &TouchingTools) -> Self {
        let count = tools.nodes.len();
        Self {
            touched: Marks::new(count),
            parent: vec![NONE; count],
            pressed: vec![(Vector3::zeros(), 0.0); count],
        }
    }

    /// Share of the normal force of `contacts` that the patch with the most of it has, with those that push the same way; 0 without
    /// force.
    pub(super) fn largest_share<'a>(
        &mut self,
        tools: &TouchingTools,
        contacts: impl Iterator<Item = &'a Contact> + Clone,
    ) -> f64 {
        let pressed = contacts.filter_map(|contact| {
            let place = tools.place_of_node(contact.node)?;
            Some((place as u32, contact))
        });
        self.join(tools, pressed.clone().map(|(place, _)| place));
        let (mut most, mut most_n, mut total_n) = (Vector3::zeros(), 0.0, 0.0);
        for (place, contact) in pressed {
            let patch = self.patch_of(place) as usize;
            let (force, sum_n) = &mut self.pressed[patch];
            *force -= contact.normal * contact.lambda_n[0];
            *sum_n += contact.lambda_n[0];
            total_n += contact.lambda_n[0];
        }
        for (force, sum_n) in &self.pressed {
            if *sum_n > most_n {
                (most, most_n) = (*force, *sum_n);
            }
        }
        let pushes_alike = |(force, _): &&(Vector3<f64>, f64)| {
            force.dot(&most) >= SAME_WAY * force.norm() * most.norm()
        };
        let alike = self.pressed.iter().filter(pushes_alike);
        let alike_n: f64 = alike.map(|(_, sum_n)| sum_n).sum();
        if total_n > 0.0 {
            alike_n / total_n
        } else {
            0.0
        }
    }

    /// Makes patches of what is `touched` and of the vertices beside it.
    fn join(&mut self, tools: &TouchingTools, touched: impl Iterator<Item = u32>) {
        self.touched.clear();
        self.parent.fill(NONE);
        self.pressed.fill((Vector3::zeros(), 0.0));
        for place in touched {
            self.touched.set(place);
            self.parent[place as usize] = place;
        }
        for edge in &tools.edges {
            if edge.iter().any(|end| self.touched.has(*end)) {
                for end in edge {
                    let parent = &mut self.parent[*end as usize];
                    *parent = if *parent == NONE { *end } else { *parent };
                }
            }
        }
        for edge in &tools.edges {
            if edge.iter().all(|end| self.parent[*end as usize] != NONE) {
                let [first, second] = edge.map(|end| self.patch_of(end));
                self.parent[first.max(second) as usize] = first.min(second);
            }
        }
    }

    /// Returns the vertex that stands for the patch of a vertex. Halves the way to it.
    fn patch_of(&mut self, place: u32) -> u32 {
        let mut at = place;
        while self.parent[at as usize] != at {
            let next = self.parent[at as usize];
            self.parent[at as usize] = self.parent[next as usize];
            at = next;
        }
        at
    }
}
