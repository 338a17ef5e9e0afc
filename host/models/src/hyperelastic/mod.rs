//! The reference: hyperelastic finite elements in balance by Newton's method.
//!
//! Entry point: [`Hyperelastic`]. zhang-2017, chapter 5, without its shortcut: instead of a step towards equal
//! work and energy, the potential itself is minimised.

mod averaged;
mod discrete;
mod elastic;
mod elasticity;
mod factor;
mod loads;
mod motion;
mod newton;
mod pattern;
mod settings;
mod settle;
#[cfg(test)]
mod tests;
mod tissue;

pub use elasticity::Elasticity;
pub use motion::{Motion, Scheme};
pub use settings::{Cells, Settings};

use crate::BuildError;
use crate::law::Law;
use discrete::Discrete;
use elastic::Elastic;
use motion::Course;
use nalgebra::Vector3;
use newton::Balance;
use sutura_mesh::TetMesh;

/// Hyperelastic tissue.
///
/// Its nodes are those of the mesh and, of quadratic cells, one in the middle of each edge. Drives and
/// positions speak of the mesh's. A mid-edge node on the boundary whose two ends are held is held at their
/// mean; what holds it counts half for each. Held nodes that move go there on a straight line: a turn must be
/// given in steps well below half a circle.
///
/// ```
/// use sutura_mesh::slab;
/// use sutura_models::hyperelastic::{Hyperelastic, Settings};
/// use sutura_models::{BoundaryConditions, Material, Outcome, Tissue, law::Law};
/// let mesh = slab([0.04, 0.04, 0.02], [4, 4, 2])?;
/// let liver = Material { youngs_modulus_pa: 3_500.0, poisson_ratio: 0.45 };
/// let mut tissue = Hyperelastic::new(&mesh, &[Law::neo_hookean(liver)], Settings::default())?;
/// let bottom = (0..25).map(|node| (node, [0.0; 3]));
/// let held: Vec<_> = bottom.chain([(62, [0.0, 0.0, 0.005])]).collect();
/// let done = tissue.step(&BoundaryConditions { held: &held, force_n: &[] }, 0.0);
/// assert_eq!(done.outcome, Outcome::Converged);
/// assert!(tissue.reactions_n()[25][2] > 0.0);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Hyperelastic {
    settings: Settings,
    balance: Balance,
    state: State,
    work: Work,
}

/// What evolves.
struct State {
    /// Every node \[m\].
    x: Vec<Vector3<f64>>,
    /// \[m/s\]; zeros in statics.
    velocity: Vec<Vector3<f64>>,
    /// What holds each node \[N\]; zero at free ones.
    holding: Vec<Vector3<f64>>,
    /// Load on each node \[N\].
    load: Vec<Vector3<f64>>,
    /// Work done on the tissue since rest \[J\].
    work_j: f64,
    /// Where balance was last sought \[m\]: `x`, or the middle of the step.
    at: Vec<Vector3<f64>>,
    /// Of the step that led here.
    course: Course,
    /// Held nodes of the mesh.
    held: Vec<u32>,
    /// Nodes of the mesh \[m\].
    positions_m: Vec<[f64; 3]>,
    /// In the order of `held` \[N\].
    reactions_n: Vec<[f64; 3]>,
}

/// Scratch and what the caller has laid on.
struct Work {
    /// Tractions and body forces \[N\].
    own_load: Vec<Vector3<f64>>,
    /// All loads at the end of the step \[N\].
    load: Vec<Vector3<f64>>,
    /// Where held nodes are to go \[m\].
    target: Vec<Vector3<f64>>,
    /// On the way there \[m\].
    waypoint: Vec<Vector3<f64>>,
    x: Vec<Vector3<f64>>,
    /// The last balance on the way, and what held its nodes.
    passed: Vec<Vector3<f64>>,
    holding: Vec<Vector3<f64>>,
    velocity: Vec<Vector3<f64>>,
    share: Vec<f64>,
}

impl Hyperelastic {
    /// Tissue at rest in the shape of `mesh`, with one law for all cells or one for each.
    ///
    /// # Errors
    /// [`BuildError::Count`] of laws, [`BuildError::Setting`] for a modulus or a setting out of range or a mesh
    /// too large for memory.
    pub fn new(mesh: &TetMesh, laws: &[Law], settings: Settings) -> Result<Self, BuildError> {
        check_count(mesh, laws)?;
        laws.iter().try_for_each(settings::check_law)?;
        settings.check()?;
        let mut balance = Balance::new(Elastic::new(Discrete::new(mesh, settings.cells), laws))?;
        if let Motion::Implicit {
            density_kg_per_m3, ..
        } = settings.motion
        {
            balance.masses = balance.elastic.discrete.masses(density_kg_per_m3);
        }
        let rest = balance.elastic.discrete.rest.clone();
        let zeros = vec![Vector3::zeros(); rest.len()];
        let corners = mesh.points_m().len();
        Ok(Self {
            settings,
            state: State {
                at: rest.clone(),
                velocity: zeros.clone(),
                holding: zeros.clone(),
                load: zeros.clone(),
                work_j: 0.0,
                course: Course::STATIC,
                held: Vec::with_capacity(corners),
                positions_m: mesh.points_m().to_vec(),
                reactions_n: Vec::with_capacity(corners),
                x: rest.clone(),
            },
            work: Work {
                own_load: zeros.clone(),
                load: zeros.clone(),
                target: rest.clone(),
                waypoint: rest.clone(),
                x: rest.clone(),
                passed: rest,
                holding: zeros.clone(),
                velocity: zeros,
                share: vec![0.0; balance.held.len()],
            },
            balance,
        })
    }

    /// Adds a dead load \[N\] spread evenly over `faces` of the mesh (their area at rest) to what acts from
    /// the next step on. Does the same work as the traction on all that cells can do.
    ///
    /// # Errors
    /// [`BuildError::Setting`] with the index of a face that has a node or edge the mesh does not have.
    pub fn add_traction(
        &mut self,
        faces: &[[u32; 3]],
        force_n: [f64; 3],
    ) -> Result<(), BuildError> {
        let discrete = &self.balance.elastic.discrete;
        let mut load = self.work.own_load.clone();
        loads::traction(discrete, faces, Vector3::from(force_n), &mut load).map_err(|face| {
            BuildError::Setting {
                name: "index of a face",
                value: face as f64,
                limit: "that of a face whose corners and edges are the mesh's",
            }
        })?;
        self.work.own_load = load;
        Ok(())
    }

    /// Adds a dead force per volume \[N/m^3\], given at rest positions \[m\], to what acts from the next step on.
    pub fn add_body_force(&mut self, density: impl Fn([f64; 3]) -> [f64; 3]) {
        loads::body_force(
            &self.balance.elastic.discrete,
            density,
            &mut self.work.own_load,
        );
    }

    /// Takes tractions and body forces away, from the next step on.
    pub fn clear_loads(&mut self) {
        self.work.own_load.fill(Vector3::zeros());
    }

    /// Gives every node of the mesh a velocity \[m/s\], (n x 3), mid-edge nodes the mean of their ends'; the
    /// energy this takes counts as work. Means nothing in statics.
    ///
    /// # Errors
    /// [`BuildError::Setting`] for another number of nodes.
    pub fn set_velocity_m_per_s(&mut self, velocity: &[[f64; 3]]) -> Result<(), BuildError> {
        let discrete = &self.balance.elastic.discrete;
        if velocity.len() != discrete.corners {
            return Err(BuildError::Setting {
                name: "number of velocities",
                value: velocity.len() as f64,
                limit: "that of the mesh's nodes",
            });
        }
        let before = self.kinetic_j();
        let state = &mut self.state.velocity;
        for (now, given) in state.iter_mut().zip(velocity) {
            *now = Vector3::from(*given);
        }
        for (index, [a, b]) in discrete.ends.iter().enumerate() {
            state[discrete.corners + index] = 0.5 * (state[*a as usize] + state[*b as usize]);
        }
        self.state.work_j += self.kinetic_j() - before;
        Ok(())
    }

    /// Displacement \[m\] and deformation gradient (3 x 3, row by row) of a point of a cell, by barycentric
    /// coordinates. `None`: there is no such cell.
    pub fn deformation(&self, cell: usize, at: [f64; 4]) -> Option<([f64; 3], [[f64; 3]; 3])> {
        let discrete = &self.balance.elastic.discrete;
        if cell >= discrete.volume.len() {
            return None;
        }
        let (values, gradients) = discrete.shape(cell, at);
        let nodes = discrete.cell_nodes(cell);
        let moved: Vector3<f64> = nodes
            .iter()
            .zip(values)
            .map(|(&node, value)| {
                value * (self.state.x[node as usize] - discrete.rest[node as usize])
            })
            .sum();
        let f = Discrete::deformation(nodes, &gradients[..nodes.len()], &self.state.x);
        let rows = [0, 1, 2].map(|i| [0, 1, 2].map(|j| f[(i, j)]));
        Some((moved.into(), rows))
    }

    /// Mean displacement \[m\] of `faces` of the mesh, by area at rest: what a traction on them works on.
    /// Not a number where a face is not the mesh's.
    pub fn mean_displacement_m(&self, faces: &[[u32; 3]]) -> [f64; 3] {
        let discrete = &self.balance.elastic.discrete;
        let (mut sum, mut weight) = (Vector3::zeros(), 0.0);
        let mut load = vec![Vector3::zeros(); self.state.x.len()];
        if loads::traction(discrete, faces, Vector3::x(), &mut load).is_ok() {
            for (node, share) in load.iter().enumerate() {
                sum += share.x * (self.state.x[node] - discrete.rest[node]);
                weight += share.x;
            }
        }
        (sum / weight).into()
    }

    /// Nodes that the method solves for, mid-edge nodes included.
    pub fn node_count(&self) -> usize {
        self.state.x.len()
    }

    fn kinetic_j(&self) -> f64 {
        let masses = self.balance.masses.iter().zip(&self.state.velocity);
        masses.map(|(mass, v)| 0.5 * mass * v.norm_squared()).sum()
    }
}

/// Whether there is one law for all cells, or one for each.
fn check_count(mesh: &TetMesh, laws: &[Law]) -> Result<(), BuildError> {
    let cells = mesh.cells().len();
    if laws.len() == 1 || laws.len() == cells {
        return Ok(());
    }
    Err(BuildError::Count {
        what: "laws",
        given: laws.len(),
        cells,
    })
}
