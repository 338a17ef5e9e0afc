//! What every tissue model does: take held nodes and loads, advance one step, say where it is and what it took.
//!
//! Entry point: [`Tissue`].

/// What acts on tissue during a step.
#[derive(Clone, Copy, Debug, Default)]
pub struct BoundaryConditions<'a> {
    /// Nodes that are held, and their displacement from rest \[m\], ascending by node. Which nodes are
    /// held may change from step to step.
    pub held: &'a [(u32, [f64; 3])],
    /// Force on every node \[N\], (n x 3), or empty: none.
    pub force_n: &'a [[f64; 3]],
}

/// How a step ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// Within the model's own tolerance of where it wants to be.
    Converged,
    /// Stopped by its number of iterations; positions are finite and usable.
    Unfinished,
    /// There was no way on: positions are those before the step.
    Failed(&'static str),
}

impl Outcome {
    /// The [`Diagnostics::force_error`] of a step that ended so with a `residual` of forces.
    pub fn force_error(self, residual: f64) -> f64 {
        match self {
            Self::Converged => 0.0,
            Self::Unfinished if !residual.is_nan() => residual,
            _ => f64::INFINITY,
        }
    }
}

/// What a step took and left behind.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Diagnostics {
    /// How it ended.
    pub outcome: Outcome,
    /// Iterations of the innermost loop that visits all elements.
    pub iterations: u32,
    /// Force out of balance at free nodes as a share of the forces that act, 2-norms; NaN where a model has
    /// no forces.
    pub residual: f64,
    /// Estimated relative error of the held nodes' summed reaction as the model's own equations have it: 0 where these were
    /// met to its tolerance, whatever else `residual` counts, such as inertia; where they were not, the share that is lacking: the
    /// residual, if that is what it counts; infinite where reactions mean nothing.
    pub force_error: f64,
    /// Elastic energy \[J\]; of the model's own springs where it has no material law.
    pub energy_j: f64,
    /// Work of the loads and of held nodes since rest less elastic and kinetic energy, as a share of that
    /// work; NaN where a model does not keep account.
    pub energy_difference: f64,
    /// Linear momentum \[kg m/s\], (3).
    pub momentum: [f64; 3],
    /// Angular momentum about the origin \[kg m^2/s\], (3).
    pub angular_momentum: [f64; 3],
}

/// How the force of some held nodes answers when they are moved together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tangent {
    /// Change of their summed reaction with a common displacement \[N/m\], (3 x 3), row by row.
    pub stiffness_n_per_m: [[f64; 3]; 3],
    /// Estimated relative error, 0 for an exact one.
    pub error: f64,
}

/// Tissue of one model.
pub trait Tissue: Send {
    /// Advances by `step_s` \[s\]; quasi-static models only go to balance. Allocates nothing once a drive
    /// with as many held nodes has been seen. Never panics: numbers that are none end in
    /// [`Outcome::Failed`] and leave the positions as they were.
    fn step(&mut self, drive: &BoundaryConditions<'_>, step_s: f64) -> Diagnostics;

    /// Where every node is \[m\], (n x 3).
    fn positions_m(&self) -> &[[f64; 3]];

    /// Force of each held node of the last step on tissue \[N\], (h x 3), in the order of the drive.
    fn reactions_n(&self) -> &[[f64; 3]];

    /// Tangent of the held nodes at `moved`, indices into the last drive, which is given again. Leaves
    /// the state as it was. `None`: the model has no forces to speak of.
    fn tangent(
        &mut self,
        drive: &BoundaryConditions<'_>,
        moved: &[usize],
        step_s: f64,
    ) -> Option<Tangent>;

    /// Tangent of a touch to come, after a step of this drive: of nodes that nothing holds yet, each moved by its share, 0 to 1, of a
    /// common displacement; twice the energy of a unit of it \[N/m\]. Leaves the state as it was. `None`: the model cannot say.
    fn tangent_to_come(
        &mut self,
        drive: &BoundaryConditions<'_>,
        touched: &[(u32, f64)],
        step_s: f64,
    ) -> Option<Tangent> {
        let _ = (drive, touched, step_s);
        None
    }
}
