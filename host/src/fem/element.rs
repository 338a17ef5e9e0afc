//! The four-node tetrahedron: constant gradients, stiffness blocks, strain and stress.
//!
//! Entry point: [`Element::of_mesh`]. Any text on linear finite elements, e.g. Zienkiewicz & Taylor,
//! ch. 6.

use super::numbering::Numbering;
use super::pattern::ascending;
use crate::mesh::TetMesh;
use nalgebra::{Matrix3, Vector3};
use sutura_models::Materials;

/// One cell's constant data.
#[derive(Clone, Debug)]
pub(super) struct Element {
    pub nodes: [u32; 4],
    /// Gradient of each corner's shape function \[1/m\], (4 x 3).
    pub gradients: [Vector3<f64>; 4],
    pub volume_m3: f64,
    /// (lambda, mu) \[Pa\]
    pub lame: (f64, f64),
}

impl Element {
    /// Of every cell, with materials that have been checked.
    pub fn of_mesh(mesh: &TetMesh, materials: &Materials) -> Vec<Self> {
        let cells = mesh.cells().iter().enumerate();
        cells
            .map(|(index, &cell)| Self::new(cell, &mesh.corners(cell), materials.of(index).lame()))
            .collect()
    }

    /// `corners` of a positively oriented cell \[m\].
    fn new(nodes: [u32; 4], corners: &[Vector3<f64>; 4], lame: (f64, f64)) -> Self {
        let [p0, p1, p2, p3] = corners;
        let (a, b, c) = (p1 - p0, p2 - p0, p3 - p0);
        let six_volume = a.dot(&b.cross(&c));
        let (g1, g2, g3) = (
            b.cross(&c) / six_volume,
            c.cross(&a) / six_volume,
            a.cross(&b) / six_volume,
        );
        Self {
            nodes,
            gradients: [-(g1 + g2 + g3), g1, g2, g3],
            volume_m3: six_volume / 6.0,
            lame,
        }
    }

    /// Places of the corners instead of nodes, ascending.
    pub fn placed(&self, numbering: &Numbering) -> Self {
        let places = self.nodes.map(|node| numbering.place(node));
        let order = ascending(places);
        Self {
            nodes: order.map(|corner| places[corner]),
            gradients: order.map(|corner| self.gradients[corner]),
            ..self.clone()
        }
    }

    /// What a strain of 1 pulls on a corner with \[N\], in magnitude.
    pub fn force_of_unit_strain(&self) -> f64 {
        let (lambda, mu) = self.lame;
        let longest = self.gradients.iter().map(Vector3::norm).fold(0.0, f64::max);
        self.volume_m3 * longest * (lambda.abs() + 2.0 * mu)
    }

    /// Stiffness block between two corners \[N/m\].
    pub fn stiffness(&self, a: usize, b: usize) -> Matrix3<f64> {
        let (lambda, mu) = self.lame;
        let (ga, gb) = (self.gradients[a], self.gradients[b]);
        let shear = ga.dot(&gb);
        ((ga * gb.transpose()) * lambda
            + (gb * ga.transpose() + Matrix3::from_diagonal_element(shear)) * mu)
            * self.volume_m3
    }

    /// Stress \[Pa\] for the displacement of the four corners \[m\].
    pub fn stress(&self, u: &[Vector3<f64>; 4]) -> Matrix3<f64> {
        let (lambda, mu) = self.lame;
        let mut gradient = Matrix3::zeros();
        for (u, g) in u.iter().zip(&self.gradients) {
            gradient += u * g.transpose();
        }
        let strain = (gradient + gradient.transpose()) * 0.5;
        strain * (2.0 * mu) + Matrix3::from_diagonal_element(lambda * strain.trace())
    }
}
