//! State of a model in one precision, and the visits' bookkeeping.
//!
//! Entry points: [`Core`], [`Solve`], which hides its precision.

use super::cells::{Cells, Rest, edge_m};
use super::lattice::Rough;
use super::nodes::{Field, Rows, rows_for};
use super::number::{Float, Number, arch};
use super::relaxation::Relaxation;
use super::settings::{self, Motion, Settings};
use super::visit::{Form, Found, Group, Memory, add_to_nodes, visit};
use crate::BuildError;
use crate::law::Law;
use pulp::{Arch, Simd, WithSimd};
use sutura_mesh::TetMesh;

/// Everything that is stored in one precision. Arrays of nodes have one more, for places without a cell.
pub(super) struct Core<T: Float, const L: usize> {
    pub arch: Arch,
    pub cells: Cells<T, L>,
    pub rough: Rough<T>,
    pub relaxation: Relaxation<T, L>,
    /// 1 for free nodes, 0 for held ones; 0 for the fourth number, which therefore counts nowhere.
    pub free: Vec<[T; 4]>,
    /// Lumped masses \[kg\].
    pub mass: Vec<f64>,
    /// Displacement from rest \[m\]. The fourth number is how far a newton moves a node in
    /// [`super::Form::Compliant`], its inverse mass in the printed forms; zero where held.
    pub u: Field<T>,
    /// Loads \[N\].
    pub force: Vec<[T; 4]>,
    /// Where inertia alone would lead \[m\], and mass over the square of the time step \[N/m\].
    pub ahead: Vec<[T; 4]>,
    pub inertia: Vec<[T; 4]>,
    /// Multiplier of each cell \[sqrt J\].
    pub multiplier: Vec<[T; L]>,
    /// Out of balance \[N\], trial's, correction, direction.
    pub g: Field<T>,
    pub trial: Field<T>,
    pub z: Field<T>,
    pub d: Vec<[T; 4]>,
    /// Each node's own stiffness \[N/m\].
    pub own: Vec<[T; 4]>,
    /// Cells at each node.
    pub valence: Vec<T>,
    /// Edge of a typical cell \[m\].
    pub edge_m: f64,
    /// Last step along a direction.
    pub stride: f64,
    pub most_iterations: u32,
    pub tolerance: f64,
    pub form: settings::Form,
    pub motion: Motion,
    proximity: f64,
    own_stiffness: Vec<f64>,
    saved_u: Vec<[T; 4]>,
    saved_stride: f64,
}

/// A [`Core`] of either precision.
pub(super) trait Solve {
    /// Held nodes are those for which `free` is false; loads and inertia are there for a time step, or
    /// `None` without inertia. Rebuilds what depends on them.
    fn hold(&mut self, free: &[bool], step_s: Option<f64>);
    fn place(&mut self, node: usize, displacement_m: [f64; 3]);
    fn displacement(&self, node: usize) -> [f64; 3];
    fn load(&mut self, node: usize, force_n: [f64; 3]);
    fn aim(&mut self, node: usize, displacement_m: [f64; 3]);
    /// Remembers all that time steps change, or goes back to it.
    fn save(&mut self);
    fn restore(&mut self);
    /// Runs the form; says how many visits it made.
    fn iterate(&mut self) -> u32;
    /// Elastic energy \[J\]; its gradient by every node goes to `gradient` (n).
    fn energy(&mut self, gradient: &mut [[f64; 3]]) -> f64;
    /// Begins a time step of viscoelastic stress, and ends it.
    fn begin(&mut self, step_s: f64);
    fn end(&mut self);
    fn mass(&self) -> &[f64];
}

impl<T: Float, const L: usize> Core<T, L> {
    /// # Errors
    /// Too many nodes.
    pub fn new(mesh: &TetMesh, laws: &[Law], settings: &Settings) -> Result<Self, BuildError> {
        let nodes = mesh.points_m().len();
        let cells = Cells::new(mesh, laws);
        let mut mass = vec![0.0; nodes];
        let mut valence = vec![T::default(); rows_for(nodes)];
        for cell in mesh.cells() {
            let share = settings.density_kg_per_m3 * Rest::of(mesh, *cell).volume / 4.0;
            for node in cell {
                mass[*node as usize] += share;
                valence[*node as usize] += T::of(1.0);
            }
        }
        let points = if settings.form == settings::Form::Balanced {
            settings.lattice_points as usize
        } else {
            0
        };
        let rough = Rough::new(mesh, laws, points);
        let own = rough.own_stiffness();
        let field = || Field::new(nodes);
        let zero = || vec![[T::default(); 4]; rows_for(nodes)];
        Ok(Self {
            arch: arch(),
            relaxation: Relaxation::new(&settings.relaxation, &cells),
            multiplier: vec![[T::default(); L]; cells.batches.len()],
            cells,
            own: own.iter().map(|own| [T::of(*own); 4]).collect(),
            own_stiffness: own,
            rough,
            free: zero(),
            mass,
            u: field()?,
            force: zero(),
            ahead: zero(),
            inertia: zero(),
            g: field()?,
            trial: field()?,
            z: field()?,
            d: zero(),
            valence,
            edge_m: edge_m(mesh),
            stride: 0.5,
            most_iterations: settings.iterations,
            tolerance: settings.tolerance,
            form: settings.form,
            motion: settings.motion,
            proximity: settings.proximity,
            saved_u: zero(),
            saved_stride: 0.5,
        })
    }
}

/// Runs a core's form with the widest registers there are.
struct Iterate<'a, T: Float, const L: usize>(&'a mut Core<T, L>);

impl<T: Float, const L: usize> WithSimd for Iterate<'_, T, L> {
    type Output = u32;
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> u32 {
        match self.0.form {
            settings::Form::Printed => super::printed::run(simd, self.0, false),
            settings::Form::Averaged => super::printed::run(simd, self.0, true),
            settings::Form::Compliant => super::compliant::run(simd, self.0),
            settings::Form::Balanced => super::balanced::run(simd, self.0),
        }
    }
}

/// Sums gradients over cells.
pub(super) struct Gather<'a, T, const ENERGY: bool> {
    pub u: &'a Rows<T>,
    pub sum: &'a mut Rows<T>,
    pub energy: f64,
}

impl<S: Simd, T: Float, const ENERGY: bool> Form<S, T> for Gather<'_, T, ENERGY> {
    const ENERGY: bool = ENERGY;
    #[inline(always)]
    fn field(&self) -> &Rows<T> {
        self.u
    }
    #[inline(always)]
    fn take(&mut self, group: Group<'_>, found: Found<T::Number<S>>) {
        add_to_nodes(found.gradient, self.sum, group);
        if ENERGY {
            let mut lanes = [T::default(); 16];
            found.energy.store(&mut lanes);
            for energy in lanes {
                self.energy += energy.wide();
            }
        }
    }
}

/// Gradient of the elastic energy by every node into `sum` (n + 1), and the energy where `ENERGY`.
#[inline(always)]
pub(super) fn gradient<S: Simd, T: Float, const L: usize, const ENERGY: bool>(
    simd: S,
    cells: &Cells<T, L>,
    memory: Memory<'_, T, L>,
    u: &Field<T>,
    sum: &mut Field<T>,
) -> f64 {
    sum.fill([T::default(); 4]);
    let mut gather = Gather::<T, ENERGY> {
        u: u.rows(),
        sum: sum.rows_mut(),
        energy: 0.0,
    };
    visit(simd, cells, memory, &mut gather);
    gather.energy
}

struct Energy<'a, T: Float, const L: usize>(&'a mut Core<T, L>);

impl<T: Float, const L: usize> WithSimd for Energy<'_, T, L> {
    type Output = f64;
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> f64 {
        let core = self.0;
        let memory = core.relaxation.memory();
        gradient::<S, T, L, true>(simd, &core.cells, memory, &core.u, &mut core.trial)
    }
}

struct End<'a, T: Float, const L: usize>(&'a mut Core<T, L>);

impl<T: Float, const L: usize> WithSimd for End<'_, T, L> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        self.0.relaxation.end(simd, &self.0.cells, self.0.u.rows());
    }
}

impl<T: Float, const L: usize> Solve for Core<T, L> {
    fn hold(&mut self, free: &[bool], step_s: Option<f64>) {
        for (node, is_free) in free.iter().enumerate() {
            let mass = self.mass[node];
            let inertia = step_s.map_or(0.0, |step| mass / (step * step));
            let counts = T::of(f64::from(u8::from(*is_free)));
            self.free[node] = [counts, counts, counts, T::default()];
            self.inertia[node] = [T::of(inertia); 4];
            let weight = match (self.form, step_s) {
                _ if !is_free => 0.0,
                (settings::Form::Balanced, _) => 0.0,
                (settings::Form::Compliant, Some(_)) => 1.0 / inertia,
                (settings::Form::Compliant, None) => {
                    1.0 / (self.proximity * self.own_stiffness[node])
                }
                _ => 1.0 / mass,
            };
            self.u[node][3] = T::of(weight);
        }
        if self.form == settings::Form::Balanced {
            self.rough.hold(self.arch, &self.free, &self.inertia);
        }
    }

    fn place(&mut self, node: usize, displacement_m: [f64; 3]) {
        set(&mut self.u[node], displacement_m);
    }

    fn displacement(&self, node: usize) -> [f64; 3] {
        [0, 1, 2].map(|c| self.u[node][c].wide())
    }

    fn load(&mut self, node: usize, force_n: [f64; 3]) {
        set(&mut self.force[node], force_n);
    }

    fn aim(&mut self, node: usize, displacement_m: [f64; 3]) {
        set(&mut self.ahead[node], displacement_m);
    }

    fn save(&mut self) {
        self.saved_u.copy_from_slice(&self.u);
        self.saved_stride = self.stride;
        self.relaxation.save();
    }

    fn restore(&mut self) {
        for (u, saved) in self.u.iter_mut().zip(&self.saved_u) {
            u[..3].copy_from_slice(&saved[..3]);
        }
        self.stride = self.saved_stride;
        self.relaxation.restore();
    }

    fn iterate(&mut self) -> u32 {
        self.arch.dispatch(Iterate(self))
    }

    fn energy(&mut self, gradient: &mut [[f64; 3]]) -> f64 {
        let energy = self.arch.dispatch(Energy(self));
        for (to, from) in gradient.iter_mut().zip(self.trial.iter()) {
            *to = [0, 1, 2].map(|c| from[c].wide());
        }
        energy
    }

    fn begin(&mut self, step_s: f64) {
        self.relaxation.begin(step_s);
    }

    fn end(&mut self) {
        self.arch.dispatch(End(self));
    }

    fn mass(&self) -> &[f64] {
        &self.mass
    }
}

fn set<T: Float>(to: &mut [T; 4], value: [f64; 3]) {
    for c in 0..3 {
        to[c] = T::of(value[c]);
    }
}

/// `y += factor x`.
#[inline(always)]
pub(super) fn add<T: Float>(y: &mut [[T; 4]], factor: f64, x: &[[T; 4]]) {
    let factor = T::of(factor);
    for (y, x) in y.as_flattened_mut().iter_mut().zip(x.as_flattened()) {
        *y = factor.fma(*x, *y);
    }
}
