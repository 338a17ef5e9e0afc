//! Two bodies of tissue under loads, at rest in contact.

use crate::touch::rig::Blocks;
use nalgebra::Vector3;
use sutura_host::collide::{TouchPart, TouchSettings, Touching};
use sutura_host::fem::{Equilibrium, Loads, Materials, NodeLoad, Policy};
use sutura_host::model::{Model, ModelError, Passes};
use sutura_host::step::{State, Status, StepOptions, StepReport, Workspace, step};

/// What two bodies are made of and how they are held and loaded.
pub struct Setup {
    pub blocks: Blocks,
    pub materials: Materials,
    pub fixed: Vec<u32>,
    pub loads: Loads,
    pub friction: f64,
    pub turns: bool,
}

pub struct Pressed {
    pub blocks: Blocks,
    pub loads: Loads,
    pub fixed: Vec<u32>,
    pub model: Model,
    pub state: State,
    /// Distance at which bodies are held apart \[m\].
    pub separation_m: f64,
}

impl Pressed {
    /// At rest; the first body is the upper one.
    pub fn new(setup: Setup) -> Result<Self, ModelError> {
        Self::with(setup, TouchSettings::default())
    }

    /// Makes what [`Self::new`] makes, with contact found and kept by these settings.
    pub fn with(setup: Setup, settings: TouchSettings) -> Result<Self, ModelError> {
        let Setup {
            blocks,
            materials,
            fixed,
            loads,
            friction,
            turns,
        } = setup;
        let mesh = &blocks.mesh;
        let model = if turns {
            let passes = Passes {
                most: 20,
                tolerance: 1e-12,
            };
            let policy = Policy::default();
            Model::corotational(mesh, materials, &fixed, loads.clone(), &[], policy, passes)
        } else {
            Model::new(mesh, materials, &fixed, loads.clone(), &[])
        }?;
        let part = TouchPart {
            faces: [blocks.faces(0), blocks.faces(1)],
            friction,
        };
        let at: Vec<_> = mesh.points_m().iter().map(|x| Vector3::from(*x)).collect();
        let touching = Touching::new(std::slice::from_ref(&part), &at, settings)?;
        let model = model.with_touching(mesh, &[part], settings)?;
        let state = State::new(&model);
        Ok(Self {
            separation_m: touching.separation_m(),
            blocks,
            loads,
            fixed,
            model,
            state,
        })
    }

    pub fn rest(&self) -> Equilibrium {
        self.model.equilibrium(&self.state).expect("a balance")
    }

    /// Force of the contact on the upper body \[N\].
    pub fn contact_n(&self) -> Vector3<f64> {
        let upper = self.blocks.first[0]..self.blocks.first[1];
        let forces = self.state.contact_forces(&self.model);
        let own = forces.filter(|(node, _)| upper.contains(node));
        own.map(|(_, force)| Vector3::from(force)).sum()
    }

    /// What loads and fixed nodes put on the upper body \[N\].
    pub fn others_n(&self, rest: &Equilibrium) -> Vector3<f64> {
        let upper = self.blocks.first[0]..self.blocks.first[1];
        let loads = self.loads.forces.iter();
        let loads = loads
            .filter(|load| upper.contains(&load.node))
            .map(|load| load.force_n);
        let fixed = self.fixed.iter().filter(|node| upper.contains(node));
        let fixed = fixed.map(|node| rest.node_force_n[*node as usize]);
        loads.chain(fixed).map(Vector3::from).sum()
    }

    /// Farthest a node is from where it was when the model began after so many steps \[m\], and their last report.
    pub fn wait(&mut self, steps: usize) -> (f64, StepReport) {
        let mut work = Workspace::new(&self.model);
        work.prepare(&self.model, |_| true);
        let before = self.rest().displacement_m;
        let mut last = StepReport::default();
        for _ in 0..steps {
            last = step(
                &self.model,
                &mut self.state,
                &[],
                &StepOptions::default(),
                &mut work,
            );
            assert_eq!(last.status, Status::Ok);
        }
        let after = self.rest().displacement_m;
        let ways = before.iter().zip(&after);
        let moved = ways.map(|(a, b)| (Vector3::from(*a) - Vector3::from(*b)).norm());
        (moved.fold(0.0, f64::max), last)
    }
}

/// The same force on each of some nodes, `total_n` together.
pub fn shared(nodes: &[u32], total_n: Vector3<f64>) -> Vec<NodeLoad> {
    let force_n = (total_n / nodes.len() as f64).into();
    let load = |node: &u32| NodeLoad {
        node: *node,
        force_n,
    };
    nodes.iter().map(load).collect()
}

/// A uniform traction on faces \[Pa\], as forces on their nodes.
pub fn traction(
    points_m: &[[f64; 3]],
    faces: &[[u32; 3]],
    traction_pa: Vector3<f64>,
) -> Vec<NodeLoad> {
    let at = |node: u32| Vector3::from(points_m[node as usize]);
    let on_face = |face: &[u32; 3]| {
        let [a, b, c] = face.map(at);
        let force = traction_pa * (0.5 * (b - a).cross(&(c - a)).norm() / 3.0);
        face.map(|node| NodeLoad {
            node,
            force_n: force.into(),
        })
    };
    faces.iter().flat_map(on_face).collect()
}
