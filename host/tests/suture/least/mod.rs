//! The least energy of a whole suture, from rest: linear tissue, a thread of one tension through given faces, bodies kept apart.
//!
//! Entry points: [`Suture::new`], then [`Suture::pulled`] with a tension, which may differ along the path ([`Suture::in_shares`]), or
//! [`Suture::drawn`] with a length. It shares mesh and
//! path with the solver and none of its rows: 1/2 u'Ku + T sum |y| + a barrier between bodies, over the displacements of all nodes, by
//! Newton's method with a line search. T sum |y| is convex, and a thread of given length has the tension with which it is as
//! long as that. Bodies that are kept apart may have several balances: what is found is that to which a tension leads that grows.

mod apart;

pub use apart::Apart;
use apart::place;
use faer::prelude::Solve;
use faer::sparse::linalg::solvers::Llt;
use faer::sparse::{SparseColMat, Triplet};
use faer::{Col, Side};
use nalgebra::{Matrix3, Matrix4, Vector3};
use sutura_host::fem::Material;
use sutura_host::mesh::TetMesh;
use sutura_host::thread::{ThreadPlace, ThreadPoint};

/// Lengths are sqrt(|y|^2 + this^2): pieces that vanish have a slope \[m\].
const ROUND_M: f64 = 1e-7;
/// What is sought is found when no node would move by more \[m\].
const STILL_M: f64 = 1e-8;
/// The same on the way there.
const ROUGH_M: f64 = 1e-6;
/// No node moves by more at a time \[m\].
const LONGEST_M: f64 = 3e-4;
/// Most steps of Newton's method with one tension.
const MOST_STEPS: u32 = 400;
/// Tension from which it grows \[N\], and the most by which it does at a time.
const FIRST_N: f64 = 0.01;
const GROWS: f64 = 1.3;
/// Distance from which bodies push each other away while the tension grows \[m\].
const WIDEST_M: f64 = 1e-4;
/// A given length is held this well \[m\].
const LENGTH_M: f64 = 1e-7;

/// A node and its part in a point of tissue, or in a difference of two.
pub type Term = (u32, f64);

/// A point of a thread's path.
#[derive(Clone, Debug)]
pub enum Stop {
    /// Where a hand is \[m\].
    Held(Vector3<f64>),
    /// A point of tissue.
    Tissue(Vec<Term>),
}

/// Slopes \[N\] and stiffnesses \[N/m\] of all free nodes, the latter below the diagonal.
pub struct Stamp<'a> {
    first: &'a [Option<usize>],
    slope: Vec<f64>,
    stiffness: Vec<Triplet<usize, usize, f64>>,
}

impl Stamp<'_> {
    /// Of an energy of a weighted sum of nodes' places.
    pub fn add(&mut self, terms: &[Term], slope: Vector3<f64>, stiffness: Matrix3<f64>) {
        let free = || {
            let each = terms.iter();
            each.filter_map(|(node, weight)| Some((self.first[*node as usize]?, *weight)))
        };
        let free: Vec<(usize, f64)> = free().collect();
        for (row, weight) in &free {
            for axis in 0..3 {
                self.slope[row + axis] += weight * slope[axis];
            }
            for (column, other) in free.iter().filter(|(column, _)| column <= row) {
                for (i, j) in (0..3).flat_map(|i| (0..3).map(move |j| (i, j))) {
                    if row + i >= column + j {
                        let val = weight * other * stiffness[(i, j)];
                        self.stiffness.push(Triplet::new(row + i, column + j, val));
                    }
                }
            }
        }
    }
}

/// What is found.
#[derive(Clone, Debug)]
pub struct Least {
    /// Of all nodes \[m\], (n).
    pub at: Vec<Vector3<f64>>,
    /// One all along \[N\].
    pub tension_n: f64,
    /// Of the path \[m\].
    pub length_m: f64,
    /// Of the tissue \[J\].
    pub tissue_j: f64,
}

/// Tissue with a thread.
pub struct Suture {
    rest: Vec<Vector3<f64>>,
    first: Vec<Option<usize>>,
    unknowns: usize,
    /// Below the diagonal, each entry once \[N/m\].
    stiffness: Vec<Triplet<usize, usize, f64>>,
    path: Vec<Stop>,
    /// What the tension is multiplied by in each piece of the path.
    shares: Vec<f64>,
    apart: Option<Apart>,
}

/// A point of tissue by the cell in which it rests.
pub fn locate(mesh: &TetMesh, at: Vector3<f64>) -> Vec<Term> {
    let inside = |cell: &[u32; 4]| {
        let corner = |node: u32| Vector3::from(mesh.points_m()[node as usize]);
        let columns = cell.map(|node| corner(node).push(1.0));
        let weights = Matrix4::from_columns(&columns).try_inverse()? * at.push(1.0);
        let terms = cell.iter().zip(weights.iter());
        (weights.min() > -1e-6).then(|| terms.map(|(node, part)| (*node, *part)).collect())
    };
    mesh.cells().iter().find_map(inside).expect("in a cell")
}

/// The points at which a path turns, of one whose tissue is at rest: faces inside that are nearer to each other than `apart_m`
/// are one, and of more than 128 faces only every second, third ... is one.
pub fn turning(path: &[ThreadPoint], apart_m: f64) -> Vec<ThreadPoint> {
    let is_face =
        |point: &&ThreadPoint| !matches!(point.what, ThreadPlace::End | ThreadPlace::Wraps);
    let stride = 1 + path.iter().filter(is_face).count() / 128;
    let far = |a: &ThreadPoint, b: &ThreadPoint| {
        Vector3::from(a.at_m).metric_distance(&Vector3::from(b.at_m)) >= apart_m
    };
    let (mut kept, mut since): (Vec<ThreadPoint>, usize) = (Vec::new(), 0);
    for (place, point) in path.iter().enumerate() {
        since += 1;
        let inside = point.what == ThreadPlace::Inside;
        let mut beyond = path[place..].iter();
        let leaves = beyond.find(|beyond| beyond.what == ThreadPlace::Leaves);
        let apart = kept.last().is_none_or(|last| far(last, point))
            && leaves.is_none_or(|leaves| far(leaves, point));
        if !inside || (since.is_multiple_of(stride) && apart) {
            kept.push(*point);
            since = 0;
        }
    }
    kept
}

impl Suture {
    /// Of linear tissue; the path is that of a thread with all nodes at rest, between two hands.
    pub fn new(
        (mesh, fixed): (&TetMesh, &[u32]),
        material: impl Fn(usize) -> Material,
        path: &[ThreadPoint],
        apart: Option<Apart>,
    ) -> Self {
        let rest: Vec<Vector3<f64>> = mesh.points_m().iter().map(|x| Vector3::from(*x)).collect();
        let mut first = vec![Some(0); rest.len()];
        fixed.iter().for_each(|node| first[*node as usize] = None);
        let mut unknowns = 0;
        for own in first.iter_mut().flatten() {
            *own = unknowns;
            unknowns += 3;
        }
        let stop = |point: &ThreadPoint| match point.what {
            ThreadPlace::End => Stop::Held(point.at_m.into()),
            _ => Stop::Tissue(locate(mesh, point.at_m.into())),
        };
        let mut suture = Self {
            path: path.iter().map(stop).collect(),
            shares: vec![1.0; path.len() - 1],
            rest,
            first,
            unknowns,
            stiffness: Vec::new(),
            apart,
        };
        suture.stiffness = suture.assembled(mesh, material);
        suture
    }

    /// Linear tetrahedra: V (lambda a b' + mu b a' + mu (a.b) 1) for two nodes with the gradients a and b.
    fn assembled(
        &self,
        mesh: &TetMesh,
        material: impl Fn(usize) -> Material,
    ) -> Vec<Triplet<usize, usize, f64>> {
        let mut all = Vec::new();
        for (index, cell) in mesh.cells().iter().enumerate() {
            let (lambda, mu) = material(index).lame();
            let corners = cell.map(|node| self.rest[node as usize].push(1.0));
            let matrix = Matrix4::from_columns(&corners);
            let volume = matrix.determinant().abs() / 6.0;
            let inverse = matrix.try_inverse().expect("a volume");
            let gradient = |node: usize| {
                Vector3::new(inverse[(node, 0)], inverse[(node, 1)], inverse[(node, 2)])
            };
            for (i, j) in (0..4).flat_map(|i| (0..4).map(move |j| (i, j))) {
                let rows = [i, j].map(|node| self.first[cell[node] as usize]);
                let [Some(row), Some(column)] = rows else {
                    continue;
                };
                let (a, b) = (gradient(i), gradient(j));
                let block = a * b.transpose() * lambda
                    + b * a.transpose() * mu
                    + Matrix3::identity() * (mu * a.dot(&b));
                for (k, l) in (0..3).flat_map(|k| (0..3).map(move |l| (k, l))) {
                    if row + k >= column + l {
                        all.push(Triplet::new(row + k, column + l, volume * block[(k, l)]));
                    }
                }
            }
        }
        let n = self.unknowns;
        let sum = SparseColMat::try_new_from_triplets(n, n, &all).expect("within");
        let entries = sum.triplet_iter();
        entries
            .map(|entry| Triplet::new(entry.row, entry.col, *entry.val))
            .collect()
    }

    /// With tensions that differ from piece to piece, whatever moves: in these parts of that which is given.
    pub fn in_shares(mut self, shares: Vec<f64>) -> Self {
        assert_eq!(shares.len(), self.shares.len());
        self.shares = shares;
        self
    }

    fn stamp(&self) -> Stamp<'_> {
        Stamp {
            first: &self.first,
            slope: vec![0.0; self.unknowns],
            stiffness: Vec::new(),
        }
    }

    fn displacements(&self, at: &[Vector3<f64>]) -> Vec<f64> {
        let mut u = vec![0.0; self.unknowns];
        for (node, first) in self.first.iter().enumerate() {
            if let Some(first) = first {
                u[*first..first + 3].copy_from_slice((at[node] - self.rest[node]).as_slice());
            }
        }
        u
    }

    fn places(&self, u: &[f64]) -> Vec<Vector3<f64>> {
        let each = self.rest.iter().zip(&self.first);
        each.map(|(rest, first)| match first {
            Some(first) => rest + Vector3::from_column_slice(&u[*first..first + 3]),
            None => *rest,
        })
        .collect()
    }

    /// K u \[N\].
    fn carried(&self, u: &[f64]) -> Vec<f64> {
        let mut force = vec![0.0; u.len()];
        for entry in &self.stiffness {
            force[entry.row] += entry.val * u[entry.col];
            if entry.row != entry.col {
                force[entry.col] += entry.val * u[entry.row];
            }
        }
        force
    }

    /// Elastic energy of the tissue with its nodes there \[J\].
    pub fn tissue_j(&self, at: &[Vector3<f64>]) -> f64 {
        let u = self.displacements(at);
        0.5 * dot(&u, &self.carried(&u))
    }

    /// Each piece of the path \[m\], and what moves it.
    fn pieces(&self, at: &[Vector3<f64>]) -> Vec<(Vector3<f64>, Vec<Term>)> {
        let of = |stop: &Stop| match stop {
            Stop::Held(there) => (*there, Vec::new()),
            Stop::Tissue(terms) => (place(terms, at), terms.clone()),
        };
        let between = |two: &[Stop]| {
            let ((from, own), (to, mut terms)) = (of(&two[0]), of(&two[1]));
            terms.extend(own.iter().map(|(node, weight)| (*node, -weight)));
            (to - from, terms)
        };
        self.path.windows(2).map(between).collect()
    }

    /// Length of the path with the nodes there \[m\].
    pub fn length_m(&self, at: &[Vector3<f64>]) -> f64 {
        self.pieces(at).iter().map(|(way, _)| way.norm()).sum()
    }

    /// Length of the path as it is rounded \[m\], times the tension.
    fn thread_j(&self, at: &[Vector3<f64>], tension_n: f64, stamp: &mut Option<&mut Stamp>) -> f64 {
        let mut energy = 0.0;
        for ((way, terms), share) in self.pieces(at).into_iter().zip(&self.shares) {
            let length = way.norm().hypot(ROUND_M);
            let tension_n = tension_n * share;
            energy += tension_n * length;
            if let Some(stamp) = stamp {
                let along = way / length;
                let across = Matrix3::identity() - along * along.transpose();
                stamp.add(&terms, along * tension_n, across * (tension_n / length));
            }
        }
        energy
    }

    /// Energy \[J\]; its slope and stiffness are added to `stamp`.
    fn energy(&self, u: &[f64], tension_n: f64, mut stamp: Option<&mut Stamp>) -> f64 {
        let at = self.places(u);
        let force = self.carried(u);
        if let Some(stamp) = &mut stamp {
            let each = stamp.slope.iter_mut().zip(&force);
            each.for_each(|(slope, force)| *slope += force);
            stamp.stiffness.extend_from_slice(&self.stiffness);
        }
        let apart = self.apart.as_ref();
        let apart_j = apart.map_or(0.0, |apart| apart.energy(&at, &mut stamp));
        0.5 * dot(u, &force) + self.thread_j(&at, tension_n, &mut stamp) + apart_j
    }

    /// Slope of the energy \[N\], and its stiffness, factored.
    fn slope(&self, u: &[f64], tension_n: f64) -> (f64, Vec<f64>, Llt<usize, f64>) {
        let mut stamp = self.stamp();
        let energy = self.energy(u, tension_n, Some(&mut stamp));
        let n = self.unknowns;
        let matrix = SparseColMat::try_new_from_triplets(n, n, &stamp.stiffness).expect("within");
        let factor = matrix.sp_cholesky(Side::Lower).expect("positive");
        (energy, stamp.slope, factor)
    }

    /// Goes down to the least energy with one tension, until no node would move by more than `still_m`; the last factor.
    fn descend(&self, u: &mut Vec<f64>, tension_n: f64, still_m: f64) -> Llt<usize, f64> {
        for _ in 0..MOST_STEPS {
            if let Some(apart) = &self.apart {
                apart.look(&self.places(u));
            }
            let (energy, slope, factor) = self.slope(u, tension_n);
            let way = factor.solve(&Col::from_fn(slope.len(), |row| -slope[row]));
            let way: Vec<f64> = way.iter().copied().collect();
            let most = way.iter().fold(0.0f64, |most, x| most.max(x.abs()));
            if most < still_m {
                return factor;
            }
            let falls = dot(&slope, &way);
            let mut part = (LONGEST_M / most).min(1.0);
            loop {
                let moved: Vec<f64> = u.iter().zip(&way).map(|(u, by)| u + part * by).collect();
                let now = self.energy(&moved, tension_n, None);
                if now <= energy + 1e-4 * part * falls + 1e-13 * energy.abs() {
                    *u = moved;
                    break;
                }
                part *= 0.5;
                // What falls by less than rounding.
                if part * most < 1e-3 * still_m {
                    return factor;
                }
            }
        }
        panic!("no least energy with {tension_n} N");
    }

    fn found(&self, u: &[f64], tension_n: f64) -> Least {
        let at = self.places(u);
        Least {
            tension_n,
            length_m: self.length_m(&at),
            tissue_j: 0.5 * dot(u, &self.carried(u)),
            at,
        }
    }

    /// Distances from which bodies push each other away, one after the other.
    fn distances(&self) -> Vec<f64> {
        let Some(apart) = &self.apart else {
            return vec![0.0];
        };
        let wide = std::iter::successors(Some(WIDEST_M), |acts_m| Some(0.3 * acts_m));
        let wide = wide.take_while(|acts_m| *acts_m > apart.narrowest_m);
        wide.chain([apart.narrowest_m]).collect()
    }

    fn act_from(&self, acts_m: f64) {
        if let Some(apart) = &self.apart {
            apart.act_from(acts_m);
        }
    }

    /// With a tension, which grows from none.
    pub fn pulled(&self, tension_n: f64) -> Least {
        let mut u = vec![0.0; self.unknowns];
        self.act_from(WIDEST_M);
        let mut now_n = FIRST_N.min(tension_n);
        while now_n < tension_n {
            self.descend(&mut u, now_n, ROUGH_M);
            now_n = (now_n * GROWS).min(tension_n);
        }
        for acts_m in self.distances() {
            self.act_from(acts_m);
            self.descend(&mut u, tension_n, STILL_M);
        }
        self.found(&u, tension_n)
    }

    /// With as much thread as that between the hands, unstretched, of so much EA \[N\], its tension growing from none; without
    /// any if that is long enough.
    pub fn drawn(&self, available_m: f64, axial_stiffness_n: f64) -> Least {
        let mut u = vec![0.0; self.unknowns];
        if self.length_m(&self.rest) <= available_m {
            return self.found(&u, 0.0);
        }
        let gives = available_m / axial_stiffness_n;
        let mut tension_n = FIRST_N;
        for acts_m in self.distances() {
            self.act_from(acts_m);
            self.fit(&mut u, &mut tension_n, (available_m, gives));
        }
        self.found(&u, tension_n)
    }

    /// The same from where nodes are already, with the tension there: the balance next to that.
    pub fn drawn_from(&self, at: &[Vector3<f64>], tension_n: f64, available_m: f64) -> Least {
        let (mut u, mut tension_n) = (self.displacements(at), tension_n);
        if let Some(acts_m) = self.distances().last() {
            self.act_from(*acts_m);
        }
        self.fit(&mut u, &mut tension_n, (available_m, 0.0));
        self.found(&u, tension_n)
    }

    /// Compares its slopes with differences of the energy, in some directions from there.
    pub fn check_slopes(&self, at: &[Vector3<f64>]) {
        let u = self.displacements(at);
        let with = |by: f64, way: &[f64]| -> Vec<f64> {
            u.iter().zip(way).map(|(u, way)| u + by * way).collect()
        };
        if let Some(apart) = &self.apart {
            apart.look(at);
            apart.act_from(20.0 * apart.narrowest_m);
        }
        let slope = |u: &[f64]| {
            let mut stamp = self.stamp();
            let energy = self.energy(u, 0.5, Some(&mut stamp));
            (energy, stamp.slope)
        };
        let mut random = fastrand::Rng::with_seed(1);
        for _ in 0..10 {
            let way: Vec<f64> = u.iter().map(|_| random.f64() - 0.5).collect();
            let h = 1e-8;
            let [(more, _), (less, _)] = [h, -h].map(|h| slope(&with(h, &way)));
            let (energy, own) = slope(&u);
            assert!(energy.is_finite());
            let (by, expected) = ((more - less) / (2.0 * h), dot(&own, &way));
            assert!(
                (by - expected).abs() < 1e-5 * dot(&own, &own).sqrt(),
                "{by} {expected}"
            );
        }
    }

    /// Finds the tension with which the path is as long as there is thread, which gives way by so much \[m/N\]: Newton's method
    /// on the length, which falls with the tension.
    fn fit(&self, u: &mut Vec<f64>, tension_n: &mut f64, (available_m, gives): (f64, f64)) {
        for _ in 0..MOST_STEPS {
            let factor = self.descend(u, *tension_n, STILL_M);
            let at = self.places(u);
            let over = self.length_m(&at) - available_m - gives * *tension_n;
            if over.abs() < LENGTH_M {
                return;
            }
            let mut stamp = self.stamp();
            self.thread_j(&at, 1.0, &mut Some(&mut stamp));
            let slope = Col::from_fn(self.unknowns, |row| stamp.slope[row]);
            let moves = factor.solve(&slope);
            let change = over / (slope.transpose() * &moves + gives);
            *tension_n = (*tension_n + change).clamp(*tension_n / GROWS, *tension_n * GROWS);
        }
        panic!("no tension draws it to {available_m} m");
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
