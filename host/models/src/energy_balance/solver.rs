//! State of a model in one precision, and the visits' bookkeeping.
//!
//! Entry points: [`Core`], [`Solve`], which hides its precision.

use super::cells::{Batch, Cells, Form, Found, Memory, Rest, visit};
use super::lattice::Rough;
use super::number::Float;
use super::relaxation::Relaxation;
use super::settings::{self, Motion, Settings};
use crate::law::Law;
use pulp::{Arch, Simd, WithSimd};
use sutura_mesh::TetMesh;

/// Everything that is stored in one precision. Arrays of nodes have one more, for places without a cell.
pub(super) struct Core<T: Float, const L: usize> {
    pub arch: Arch,
    pub cells: Cells<T, L>,
    pub rough: Rough<T>,
    pub relaxation: Relaxation<T, L>,
    /// 1 for free nodes, 0 for held ones.
    pub free: Vec<T>,
    /// Lumped masses \[kg\].
    pub mass: Vec<f64>,
    /// Displacement from rest \[m\].
    pub u: Vec<[T; 4]>,
    /// Loads \[N\].
    pub force: Vec<[T; 4]>,
    /// Where inertia alone would lead \[m\], and mass over the square of the time step \[N/m\].
    pub ahead: Vec<[T; 4]>,
    pub inertia: Vec<T>,
    /// How far a newton moves a node in [`super::Form::Compliant`], or any multiple of its inverse mass in
    /// the printed forms; zero where held.
    pub ease: Vec<T>,
    /// Multiplier of each cell \[sqrt J\].
    pub multiplier: Vec<[T; L]>,
    /// Out of balance \[N\], trial's, correction, direction.
    pub g: Vec<[T; 4]>,
    pub trial: Vec<[T; 4]>,
    pub z: Vec<[T; 4]>,
    pub d: Vec<[T; 4]>,
    /// Cells at each node.
    pub valence: Vec<T>,
    /// Last step along a direction.
    pub stride: f64,
    pub most_iterations: u32,
    pub tolerance: f64,
    pub form: settings::Form,
    pub motion: Motion,
    proximity: f64,
    own_stiffness: Vec<f64>,
    saved: Vec<[T; 4]>,
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
    /// Remembers displacements, or goes back to them.
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
    pub fn new(mesh: &TetMesh, laws: &[Law], settings: &Settings) -> Self {
        let nodes = mesh.points_m().len();
        let cells = Cells::new(mesh, laws);
        let mut mass = vec![0.0; nodes];
        let mut valence = vec![T::default(); nodes + 1];
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
        let zero = || vec![[T::default(); 4]; nodes + 1];
        Self {
            arch: Arch::new(),
            relaxation: Relaxation::new(&settings.relaxation, &cells),
            multiplier: vec![[T::default(); L]; cells.batches.len()],
            cells,
            own_stiffness: rough.own_stiffness(),
            rough,
            free: vec![T::default(); nodes + 1],
            mass,
            u: zero(),
            force: zero(),
            ahead: zero(),
            inertia: vec![T::default(); nodes + 1],
            ease: vec![T::default(); nodes + 1],
            g: zero(),
            trial: zero(),
            z: zero(),
            d: zero(),
            valence,
            stride: 0.5,
            most_iterations: settings.iterations,
            tolerance: settings.tolerance,
            form: settings.form,
            motion: settings.motion,
            proximity: settings.proximity,
            saved: zero(),
        }
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
    pub u: &'a [[T; 4]],
    pub sum: &'a mut [[T; 4]],
    pub energy: f64,
}

impl<T: Float, const L: usize, const ENERGY: bool> Form<T, L> for Gather<'_, T, ENERGY> {
    const ENERGY: bool = ENERGY;
    #[inline(always)]
    fn displacement(&self) -> &[[T; 4]] {
        self.u
    }
    #[inline(always)]
    fn take(&mut self, _: usize, batch: &Batch<T, L>, found: &Found<T, L>) {
        for k in 0..4 {
            for lane in 0..L {
                let sum = &mut self.sum[batch.nodes[k][lane] as usize];
                for c in 0..3 {
                    sum[c] += found.gradient[3 * k + c][lane];
                }
            }
        }
        if ENERGY {
            for energy in found.energy {
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
    u: &[[T; 4]],
    sum: &mut [[T; 4]],
) -> f64 {
    sum.fill([T::default(); 4]);
    let mut gather = Gather::<T, ENERGY> {
        u,
        sum,
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

impl<T: Float, const L: usize> Solve for Core<T, L> {
    fn hold(&mut self, free: &[bool], step_s: Option<f64>) {
        for (node, is_free) in free.iter().enumerate() {
            let mass = self.mass[node];
            let inertia = step_s.map_or(0.0, |step| mass / (step * step));
            self.free[node] = T::of(f64::from(u8::from(*is_free)));
            self.inertia[node] = T::of(inertia);
            let ease = match (self.form, step_s) {
                _ if !is_free => 0.0,
                (settings::Form::Compliant, Some(_)) => 1.0 / inertia,
                (settings::Form::Compliant, None) => {
                    1.0 / (self.proximity * self.own_stiffness[node])
                }
                _ => 1.0 / mass,
            };
            self.ease[node] = T::of(ease);
        }
        if self.form == settings::Form::Balanced {
            self.rough.hold(&self.free, &self.inertia);
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
        self.saved.copy_from_slice(&self.u);
    }

    fn restore(&mut self) {
        self.u.copy_from_slice(&self.saved);
    }

    fn iterate(&mut self) -> u32 {
        self.arch.dispatch(Iterate(self))
    }

    fn energy(&mut self, gradient: &mut [[f64; 3]]) -> f64 {
        let energy = self.arch.dispatch(Energy(self));
        for (to, from) in gradient.iter_mut().zip(&self.trial) {
            *to = [0, 1, 2].map(|c| from[c].wide());
        }
        energy
    }

    fn begin(&mut self, step_s: f64) {
        self.relaxation.begin(step_s);
    }

    fn end(&mut self) {
        self.relaxation.end(&self.cells, &self.u);
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

/// Sum of products of two fields, in eight partial sums.
#[inline(always)]
pub(super) fn dot<T: Float>(a: &[[T; 4]], b: &[[T; 4]]) -> f64 {
    let mut sums = [T::default(); 16];
    let (a, b) = (a.as_flattened(), b.as_flattened());
    let (mut pairs, mut others) = (a.chunks_exact(16), b.chunks_exact(16));
    for (x, y) in (&mut pairs).zip(&mut others) {
        for k in 0..16 {
            sums[k] = x[k].fma(y[k], sums[k]);
        }
    }
    let rest = pairs.remainder().iter().zip(others.remainder());
    let rest: f64 = rest.map(|(x, y)| (*x * *y).wide()).sum();
    sums.iter().map(|sum| sum.wide()).sum::<f64>() + rest
}

/// `y += factor x`.
#[inline(always)]
pub(super) fn add<T: Float>(y: &mut [[T; 4]], factor: f64, x: &[[T; 4]]) {
    let factor = T::of(factor);
    for (y, x) in y.as_flattened_mut().iter_mut().zip(x.as_flattened()) {
        *y = factor.fma(*x, *y);
    }
}
