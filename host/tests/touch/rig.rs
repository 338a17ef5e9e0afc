//! Blocks of linear tissue whose fixed nodes are moved, solved with the rows of their contact.

use nalgebra::{Isometry3, Point3, Vector3};
use std::sync::Arc;
use sutura_host::anchors::{
    AnchorPoint, AnchorSettings, AnchorSolver, AnchorStatus, PointConstraint,
};
use sutura_host::collide::{TouchPart, TouchSettings, TouchState, TouchWork, Touching};
use sutura_host::fem::{LinearTissue, Loads, Material, NodeLoad};
use sutura_host::mesh::{RawMesh, TetMesh, slab};

pub const SOFT: Material = Material {
    youngs_modulus_pa: 15e3,
    poisson_ratio: 0.4,
};

/// Bodies in one mesh.
pub struct Blocks {
    pub mesh: TetMesh,
    /// First node of each body, and the number of all.
    pub first: Vec<u32>,
}

impl Blocks {
    /// Slabs (size, divisions), each where its isometry puts it.
    pub fn new(slabs: &[([f64; 3], [usize; 3], Isometry3<f64>)]) -> Self {
        let slabs = slabs.iter();
        Self::of(slabs.map(|(size, divisions, to)| (slab(*size, *divisions).expect("a slab"), *to)))
    }

    /// Meshes, each where its isometry puts it.
    pub fn of(bodies: impl Iterator<Item = (TetMesh, Isometry3<f64>)>) -> Self {
        let (mut points, mut cells, mut first) = (Vec::new(), Vec::new(), vec![0]);
        for (mesh, to) in bodies {
            let start = points.len() as u32;
            let moved = mesh.points_m().iter();
            points.extend(moved.map(|at| <[f64; 3]>::from((to * Point3::from(*at)).coords)));
            cells.extend(
                mesh.cells()
                    .iter()
                    .map(|cell| cell.map(|node| node + start)),
            );
            first.push(points.len() as u32);
        }
        let mesh = RawMesh::new(points, cells, Vec::new()).check();
        Self {
            mesh: mesh.expect("a mesh"),
            first,
        }
    }

    pub fn faces(&self, body: usize) -> Vec<[u32; 3]> {
        let own = self.first[body]..self.first[body + 1];
        let faces = self.mesh.surface().triangles.into_iter();
        faces.filter(|face| own.contains(&face[0])).collect()
    }

    /// Nodes of a body that are chosen by their place.
    pub fn nodes(&self, body: usize, chosen: impl Fn(&[f64; 3]) -> bool) -> Vec<u32> {
        let own = self.first[body]..self.first[body + 1];
        own.filter(|node| chosen(&self.mesh.points_m()[*node as usize]))
            .collect()
    }
}

/// What came of a step.
#[derive(Clone, Debug, Default)]
pub struct Step {
    pub solves: usize,
    /// Where each solve had the nodes \[m\].
    pub seen: Vec<Vec<Vector3<f64>>>,
    /// What the fixed nodes were moved by.
    pub moved: Vec<(u32, [f64; 3])>,
    pub rows: Vec<PointConstraint>,
    pub anchors: Vec<AnchorPoint>,
    pub lambda: Vec<f64>,
}

impl Step {
    /// Force of the contact on a body's nodes \[N\].
    pub fn force_on(&self, nodes: std::ops::Range<u32>) -> Vector3<f64> {
        let mut sum = Vector3::zeros();
        for (row, lambda) in self.rows.iter().zip(&self.lambda) {
            let anchor = &self.anchors[row.anchor as usize];
            for (node, weight) in anchor.nodes.iter().zip(anchor.weights) {
                if nodes.contains(node) {
                    sum -= Vector3::from(row.direction) * (lambda * weight);
                }
            }
        }
        sum
    }
}

/// The same way for all of them.
pub fn moved(nodes: &[u32], by: [f64; 3]) -> Vec<(u32, [f64; 3])> {
    nodes.iter().map(|node| (*node, by)).collect()
}

/// Most solves of a step.
const MOST: usize = 12;

pub struct Rig {
    pub blocks: Blocks,
    pub tissue: Arc<LinearTissue>,
    solver: AnchorSolver,
    pub touching: Touching,
    pub state: TouchState,
    pub work: TouchWork,
    pub at: Vec<Vector3<f64>>,
}

impl Rig {
    /// Contact between body 0 and body 1; `fixed` nodes are those that steps move.
    pub fn new(blocks: Blocks, fixed: &[u32], friction: f64) -> Self {
        Self::with(blocks, fixed, friction, SOFT, TouchSettings::default())
    }

    pub fn with(
        blocks: Blocks,
        fixed: &[u32],
        friction: f64,
        material: Material,
        settings: TouchSettings,
    ) -> Self {
        let mesh = &blocks.mesh;
        let tissue = Arc::new(LinearTissue::new(mesh, material, fixed).expect("tissue"));
        let mut reached = mesh.surface().vertices;
        reached.retain(|node| !tissue.is_fixed(*node));
        let at: Vec<Vector3<f64>> = mesh.points_m().iter().map(|p| Vector3::from(*p)).collect();
        let part = TouchPart {
            faces: [blocks.faces(0), blocks.faces(1)],
            friction,
        };
        let touching = Touching::new(&[part], &at, settings).expect("bodies");
        let anchors = AnchorSettings {
            most_rows: touching.most_rows(),
            most_anchors: touching.most_pairs(),
            vertices_per_step: usize::MAX,
            ..AnchorSettings::default()
        };
        let solver = AnchorSolver::linear(tissue.clone(), &reached, anchors).expect("a solver");
        let state = TouchState::new(&touching, &at);
        let work = TouchWork::new(&touching, at.len());
        Self {
            tissue,
            solver,
            touching,
            state,
            work,
            at,
            blocks,
        }
    }

    /// Faces of the two bodies.
    pub fn faces(&self) -> [Vec<[u32; 3]>; 2] {
        [self.blocks.faces(0), self.blocks.faces(1)]
    }

    /// Balances with fixed nodes moved by `moved` \[m\].
    pub fn step(&mut self, moved: &[(u32, [f64; 3])]) -> Step {
        let loads = Loads {
            fixed_displacement_m: moved.to_vec(),
            ..Loads::default()
        };
        let free = self.tissue.solve(&loads).expect("a balance").displacement_m;
        let mut step = Step {
            moved: moved.to_vec(),
            ..Step::default()
        };
        loop {
            step.solves += 1;
            step.anchors.clear();
            step.rows.clear();
            let points = self.blocks.mesh.points_m();
            self.state
                .rows(&self.touching, points, &mut step.anchors, &mut step.rows);
            // The solver's tissue is one whose fixed nodes have not moved.
            let mut rows = step.rows.clone();
            for row in &mut rows {
                let anchor = &step.anchors[row.anchor as usize];
                for (node, weight) in anchor.nodes.iter().zip(anchor.weights) {
                    let free = Vector3::from(free[*node as usize]) * weight;
                    row.target_m -= Vector3::from(row.direction).dot(&free);
                }
            }
            let report = self.solver.step(&step.anchors, &rows, true);
            assert_eq!(report.status, AnchorStatus::Ok, "{report:?}");
            step.lambda = self.solver.lambda().to_vec();
            for (node, at) in self.at.iter_mut().enumerate() {
                *at = Vector3::from(points[node])
                    + Vector3::from(free[node])
                    + Vector3::from(self.solver.displacement_m(node as u32));
            }
            step.seen.push(self.at.clone());
            if step.solves >= MOST || !self.state.look(&self.touching, &mut self.work, &self.at) {
                break;
            }
        }
        assert!(step.solves < MOST, "still meeting");
        self.state
            .accept(&self.touching, &mut self.work, &self.at, &step.lambda);
        step
    }

    /// Force that `nodes`, which are fixed, get from what moves them \[N\].
    pub fn holding(&self, nodes: &[u32], step: &Step) -> Vector3<f64> {
        let mut forces = Vec::new();
        for (row, lambda) in step.rows.iter().zip(&step.lambda) {
            let anchor = &step.anchors[row.anchor as usize];
            for (node, weight) in anchor.nodes.iter().zip(anchor.weights) {
                forces.push(NodeLoad {
                    node: *node,
                    force_n: row.direction.map(|x| -x * lambda * weight),
                });
            }
        }
        let loads = Loads {
            forces,
            fixed_displacement_m: step.moved.clone(),
            ..Loads::default()
        };
        let balance = self.tissue.solve(&loads).expect("a balance");
        let held = nodes
            .iter()
            .map(|node| balance.node_force_n[*node as usize]);
        held.map(Vector3::from).sum()
    }
}
