//! The boundary of a mesh as pictures have it: its nodes, counted anew, and what lies behind its triangles.
//!
//! Entry points: [`Boundary::of`], [`Boundary::encode`], [`Boundary::by_area`].

use super::bytes::Message;
use crate::mesh::TetMesh;
use nalgebra::Vector3;
use std::collections::HashMap;

/// What does not change from picture to picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Boundary {
    /// Number that pictures name it by.
    pub number: u32,
    /// Nodes of the whole mesh.
    pub mesh_nodes: u32,
    /// Node of each vertex, ascending, (v).
    pub nodes: Vec<u32>,
    /// Their unloaded positions \[m\], (v x 3).
    pub points_m: Vec<[f64; 3]>,
    /// Vertices of each triangle, counter-clockwise from outside, (f x 3).
    pub triangles: Vec<[u32; 3]>,
    /// The cell behind each, (f).
    pub cells: Vec<u32>,
    /// Its region, (f).
    pub regions: Vec<i32>,
    /// Whether a vertex is fixed, (v).
    pub fixed: Vec<bool>,
    /// Unloaded area of each triangle \[m^2\], (f).
    area_m2: Vec<f64>,
    /// Unloaded outward normal at each vertex, times a third of the area around it \[m^2\], (v).
    normal_m2: Vec<Vector3<f64>>,
    /// A third of the area of the triangles around each vertex \[m^2\], (v).
    around_m2: Vec<f64>,
}

impl Boundary {
    /// Of a mesh whose nodes `fixed` do not move.
    pub fn of(mesh: &TetMesh, fixed: &[u32], number: u32) -> Self {
        let surface = mesh.surface();
        let vertex_of: HashMap<u32, u32> = (0..)
            .zip(&surface.vertices)
            .map(|(vertex, node)| (*node, vertex))
            .collect();
        let vertex = |node: u32| vertex_of.get(&node).copied().unwrap_or_default();
        let at = |node: u32| {
            let point = mesh.points_m().get(node as usize);
            point.map_or_else(Vector3::zeros, |point| Vector3::from(*point))
        };
        let sorted = |mut nodes: [u32; 3]| {
            nodes.sort_unstable();
            nodes
        };
        let mut behind: HashMap<[u32; 3], u32> = HashMap::new();
        for (cell, &[a, b, c, d]) in (0..).zip(mesh.cells()) {
            for face in [[a, b, c], [a, b, d], [a, c, d], [b, c, d]] {
                behind.insert(sorted(face), cell);
            }
        }
        let cells: Vec<u32> = surface
            .triangles
            .iter()
            .map(|nodes| behind.get(&sorted(*nodes)).copied().unwrap_or_default())
            .collect();
        let region = |cell: &u32| mesh.regions().get(*cell as usize).copied();
        let count = surface.vertices.len();
        let mut new = Self {
            number,
            mesh_nodes: mesh.points_m().len() as u32,
            points_m: surface
                .vertices
                .iter()
                .map(|node| at(*node).into())
                .collect(),
            triangles: surface
                .triangles
                .iter()
                .map(|nodes| nodes.map(vertex))
                .collect(),
            regions: cells
                .iter()
                .map(|cell| region(cell).unwrap_or_default() as i32)
                .collect(),
            cells,
            fixed: surface
                .vertices
                .iter()
                .map(|node| fixed.binary_search(node).is_ok())
                .collect(),
            area_m2: Vec::with_capacity(surface.triangles.len()),
            normal_m2: vec![Vector3::zeros(); count],
            around_m2: vec![0.0; count],
            nodes: surface.vertices,
        };
        for (nodes, vertices) in surface.triangles.iter().zip(&new.triangles) {
            let [a, b, c] = nodes.map(at);
            let normal = (b - a).cross(&(c - a)) * 0.5;
            let area = normal.norm();
            new.area_m2.push(area);
            for vertex in vertices {
                new.normal_m2[*vertex as usize] += normal / 3.0;
                new.around_m2[*vertex as usize] += area / 3.0;
            }
        }
        new
    }

    /// The vertex that a node of the mesh is, if it is on the boundary.
    pub fn vertex(&self, node: u32) -> Option<u32> {
        self.nodes.binary_search(&node).ok().map(|at| at as u32)
    }

    /// Values of the triangles (f), averaged at the vertices by the areas of the triangles around each, (v).
    pub fn by_area(&self, of_triangles: &[f64]) -> Vec<f64> {
        let mut sums = vec![0.0; self.nodes.len()];
        for ((vertices, area), value) in self.triangles.iter().zip(&self.area_m2).zip(of_triangles)
        {
            for vertex in vertices {
                sums[*vertex as usize] += area * value / 3.0;
            }
        }
        for (sum, around) in sums.iter_mut().zip(&self.around_m2) {
            *sum /= around.max(f64::MIN_POSITIVE);
        }
        sums
    }

    /// Pressure of forces on vertices \[N\] at each \[Pa\], (v): what goes into the tissue, over the unloaded area around it.
    pub fn pressure_pa(&self, forces: &[(u32, [f64; 3])]) -> Vec<f64> {
        let mut pressure = vec![0.0; self.nodes.len()];
        for (vertex, force_n) in forces {
            let place = *vertex as usize;
            let normal = self.normal_m2[place].try_normalize(0.0).unwrap_or_default();
            let pressed_n = -normal.dot(&Vector3::from(*force_n));
            pressure[place] += pressed_n / self.around_m2[place].max(f64::MIN_POSITIVE);
        }
        pressure
    }

    /// Writes the message.
    pub fn encode(&self, session: u32, out: &mut Vec<u8>) {
        let mut message = Message::begin(out, 1, 0, |header| {
            header.u32(self.number);
            header.u32(self.nodes.len() as u32);
            header.u32(self.triangles.len() as u32);
            header.u32(self.mesh_nodes);
            header.u32(session);
        });
        message.section(1, |to| to.f32s(self.points_m.iter().flatten().copied()));
        message.section(2, |to| {
            self.triangles
                .iter()
                .flatten()
                .for_each(|vertex| to.u32(*vertex));
        });
        message.section(3, |to| {
            self.regions.iter().for_each(|region| to.i32(*region))
        });
        message.section(4, |to| {
            self.fixed.iter().for_each(|fixed| to.u8(u8::from(*fixed)))
        });
        message.section(5, |to| self.nodes.iter().for_each(|node| to.u32(*node)));
    }
}
