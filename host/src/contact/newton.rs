//! Newton's step for the forces of a given set of rows, in the planes along which vertices can slide.
//!
//! Entry points: [`Newton::condense`], [`Newton::look`], [`Newton::step`]. With p the forces on the
//! touched vertices, `K_A = S^-1` the stiffness seen there and `G = sum lambda_i H_i` the turning of the
//! normals (H the Hessian of a tool's distance), Newton's step for `p = N lambda`, `g = 0` is
//! `(K_A - G) du - N dlambda = N lambda - p`, `N' du = -g`. It is solved in the planes T across the
//! normals (du = -N (N'N)^-1 g + T a), where `T'(K_A - G) T` is positive definite at every stable balance.

use super::active_set::{Failure, Row, Solids};
use super::reduction::MAX_TOOL_ROWS;
use super::shape::Touch;
use crate::columns::Columns;
use crate::dense::{Dense, Indefinite};
use nalgebra::{Matrix3, Vector3};

/// Rows that one vertex can have: as many as it has directions.
const MOST_ON_A_VERTEX: usize = 3;
/// Two normals closer than this \[rad\], or three with less volume, are one too many.
const PARALLEL: f64 = 1e-6;

/// What is known about one row at the present iterate.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Geometry {
    /// Of its vertex among the touched ones.
    pub place: usize,
    pub normal: Vector3<f64>,
    pub gap: f64,
    /// Hessian of the gap \[1/m\].
    pub curvature: Matrix3<f64>,
    /// Column of N (N'N)^-1 of its vertex: finds this row's share of a force, or closes its gap alone.
    pub dual: Vector3<f64>,
    pub lambda: f64,
}

/// A vertex with at least one row.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Touched {
    pub vertex: u32,
    pub at: Vector3<f64>,
    rows: [usize; MOST_ON_A_VERTEX],
    count: usize,
    /// Directions across all its normals; `free` of them.
    tangents: [Vector3<f64>; 2],
    free: usize,
    /// Of its first tangent in the system of slides.
    pub first: usize,
    /// Its block of G \[N/m\].
    pub turning: Matrix3<f64>,
}

impl Touched {
    fn new(vertex: u32) -> Self {
        Self {
            vertex,
            at: Vector3::zeros(),
            rows: [0; MOST_ON_A_VERTEX],
            count: 0,
            tangents: [Vector3::zeros(); 2],
            free: 0,
            first: 0,
            turning: Matrix3::zeros(),
        }
    }

    /// Indices of its rows.
    fn rows(&self) -> &[usize] {
        &self.rows[..self.count]
    }

    /// Along which it can slide: two directions, one between two tools, none between three.
    pub fn tangents(&self) -> &[Vector3<f64>] {
        &self.tangents[..self.free]
    }
}

/// Buffers at their largest size, and the state of the last look.
pub(crate) struct Newton {
    /// One for each row.
    pub geometry: Vec<Geometry>,
    pub touched: Vec<Touched>,
    /// K_A, (3v x 3v) \[N/m\].
    pub stiffness: Vec<f64>,
    /// Factor of T'(K_A - G) T, (t x t).
    tangential: Vec<f64>,
    /// Slides in all: t, the sum of the touched vertices' free directions.
    pub slides: usize,
    pub dense: Dense,
    /// S, then its factor, (3v x 3v).
    pub compliance: Vec<f64>,
    du: Vec<f64>,
    /// K_A du, (3v).
    pushed: Vec<f64>,
    a: Vec<f64>,
    most_rows: usize,
}

impl Newton {
    /// For so many rows.
    pub fn new(most_rows: usize) -> Self {
        let (n, t) = (3 * most_rows, 2 * most_rows);
        Self {
            geometry: Vec::with_capacity(most_rows),
            touched: Vec::with_capacity(most_rows),
            stiffness: vec![0.0; n * n],
            tangential: vec![0.0; t * t],
            slides: 0,
            // The reduction solves for rows that do not touch, too.
            dense: Dense::new(n + MAX_TOOL_ROWS + 6),
            compliance: vec![0.0; n * n],
            du: vec![0.0; n],
            pushed: vec![0.0; n],
            a: vec![0.0; t],
            most_rows,
        }
    }

    pub fn most_rows(&self) -> usize {
        self.most_rows
    }

    /// Forgets the last set.
    pub fn clear(&mut self) {
        self.geometry.clear();
        self.touched.clear();
    }

    /// Unknowns of the touched vertices: 3v.
    pub fn unknowns(&self) -> usize {
        3 * self.touched.len()
    }

    /// Lists the touched vertices and finds the stiffness seen at them: the inverse of their compliance.
    pub fn condense(&mut self, columns: &Columns, rows: &[Row]) -> Result<(), Failure> {
        self.touched.clear();
        for (index, row) in rows.iter().enumerate() {
            let known = self.touched.iter().position(|at| at.vertex == row.vertex);
            let place = known.unwrap_or_else(|| {
                self.touched.push(Touched::new(row.vertex));
                self.touched.len() - 1
            });
            let touched = &mut self.touched[place];
            let free = touched.rows.get_mut(touched.count);
            *free.ok_or(Failure::NotConverged)? = index;
            touched.count += 1;
        }
        let n = self.unknowns();
        for (j, pushed) in self.touched.iter().enumerate() {
            for (i, at) in self.touched.iter().enumerate().skip(j) {
                let block = columns.block(at.vertex, pushed.vertex);
                for axis in 0..3 {
                    let start = n * (3 * j + axis) + 3 * i;
                    self.compliance[start..start + 3]
                        .copy_from_slice(block.column(axis).as_slice());
                }
            }
        }
        self.dense
            .factor(&mut self.compliance[..n * n], n)
            .map_err(|_| Failure::NotConverged)?;
        self.dense
            .invert(&self.compliance[..n * n], &mut self.stiffness[..n * n], n);
        Ok(())
    }

    /// Geometry of every row at the present forces. Returns the residual: the largest of gap over
    /// radius and of tangential over largest force.
    pub fn look(
        &mut self,
        solids: &Solids,
        resting: &[Vector3<f64>],
        columns: &Columns,
        rows: &mut [Row],
    ) -> Result<f64, Failure> {
        let mut residual = 0.0f64;
        self.geometry.clear();
        self.geometry.resize(rows.len(), Geometry::nothing());
        self.slides = 0;
        for (place, touched) in self.touched.iter_mut().enumerate() {
            touched.at =
                resting[touched.vertex as usize] + displacement(columns, rows, touched.vertex);
            for &index in touched.rows() {
                let solid = solids[rows[index].tool as usize]
                    .as_ref()
                    .ok_or(Failure::NotConverged)?;
                let touch = solid.touch(&touched.at).ok_or(Failure::NotConverged)?;
                residual = residual.max(touch.gap.abs() / solid.radius());
                self.geometry[index] = Geometry::of(&touch, place);
            }
            touched.first = self.slides;
            span(touched, &mut self.geometry).ok_or(Failure::NotConverged)?;
            self.slides += touched.free;
        }
        // Multipliers, and what of the forces is along no normal.
        let largest = self
            .touched
            .iter()
            .map(|touched| whole(touched, rows).norm())
            .fold(0.0, f64::max);
        for touched in &mut self.touched {
            let whole = whole(touched, rows);
            share(touched, &self.geometry, &whole, rows);
            let mut sideways = whole;
            touched.turning = Matrix3::zeros();
            for &index in &touched.rows[..touched.count] {
                let row = &mut self.geometry[index];
                row.lambda = row.dual.dot(&whole).max(0.0);
                sideways -= row.normal * row.lambda;
                touched.turning += row.curvature * row.lambda;
            }
            if largest > 0.0 {
                residual = residual.max(sideways.norm() / largest);
            }
        }
        Ok(residual)
    }

    /// At a balance: leaves the factor for derivatives behind, if the balance is stable.
    pub fn finish(&mut self) -> Result<(), Failure> {
        self.factor_slides(true).map_err(|_| Failure::NotConverged)
    }

    /// Factors T'(K_A - G) T, or T' K_A T where the turning normals are left out.
    fn factor_slides(&mut self, turning: bool) -> Result<(), Indefinite> {
        let (n, t) = (self.unknowns(), self.slides);
        for (j, column) in self.touched.iter().enumerate() {
            for (b, along) in column.tangents().iter().enumerate() {
                let start = t * (column.first + b);
                for (i, row) in self.touched.iter().enumerate().skip(j) {
                    let mut pushed = Vector3::zeros();
                    for axis in 0..3 {
                        let start = n * (3 * j + axis) + 3 * i;
                        let block = &self.stiffness[start..start + 3];
                        pushed += Vector3::new(block[0], block[1], block[2]) * along[axis];
                    }
                    if turning && i == j {
                        pushed -= column.turning * along;
                    }
                    for (a, across) in row.tangents().iter().enumerate() {
                        self.tangential[start + row.first + a] = across.dot(&pushed);
                    }
                }
            }
        }
        self.dense.factor(&mut self.tangential[..t * t], t)
    }

    /// Solves T'(K_A - G) T a = rhs in place, for several right-hand sides (t x columns).
    pub fn solve_slides(&mut self, rhs: &mut [f64], columns: usize) {
        let t = self.slides;
        if t > 0 {
            self.dense.solve(&self.tangential[..t * t], t, rhs, columns);
        }
    }

    /// One Newton step on the forces.
    pub fn step(&mut self, solids: &Solids, rows: &mut [Row]) -> Result<(), Failure> {
        let (n, t) = (self.unknowns(), self.slides);
        // Where the turning normals would make a saddle (deep inside a wrong set), leave them out:
        // slower, but downhill.
        let turning = self.factor_slides(true).is_ok();
        if !turning {
            self.factor_slides(false)
                .map_err(|_| Failure::NotConverged)?;
        }
        // What closes the gaps, then the slides from T'(K_A - G) T a = -T'((K_A - G) du + p).
        for (place, touched) in self.touched.iter().enumerate() {
            let rows = touched.rows().iter().map(|&index| &self.geometry[index]);
            let du: Vector3<f64> = rows.map(|row| -row.dual * row.gap).sum();
            self.du[3 * place..3 * place + 3].copy_from_slice(du.as_slice());
        }
        multiply(&self.stiffness[..n * n], &self.du, &mut self.pushed[..n]);
        for (place, touched) in self.touched.iter().enumerate() {
            let du = Vector3::from_column_slice(&self.du[3 * place..3 * place + 3]);
            let mut left = -Vector3::from_column_slice(&self.pushed[3 * place..3 * place + 3]);
            left -= whole(touched, rows);
            if turning {
                left += touched.turning * du;
            }
            for (a, across) in touched.tangents().iter().enumerate() {
                self.a[touched.first + a] = across.dot(&left);
            }
        }
        if t > 0 {
            self.dense
                .solve(&self.tangential[..t * t], t, &mut self.a[..t], 1);
        }
        let mut part = 1.0f64;
        for (place, touched) in self.touched.iter().enumerate() {
            let du = &mut self.du[3 * place..3 * place + 3];
            for (a, along) in touched.tangents().iter().enumerate() {
                for (du, along) in du.iter_mut().zip(along.iter()) {
                    *du += along * self.a[touched.first + a];
                }
            }
            // A step that throws a vertex across its tool is no guide: shorten it.
            let length = Vector3::from_column_slice(du).norm();
            for &index in touched.rows() {
                if let Some(solid) = &solids[rows[index].tool as usize] {
                    part = part.min(0.5 * solid.radius() / length);
                }
            }
        }
        multiply(&self.stiffness[..n * n], &self.du, &mut self.pushed[..n]);
        for (place, touched) in self.touched.iter().enumerate() {
            let more = Vector3::from_column_slice(&self.pushed[3 * place..3 * place + 3]) * part;
            let whole = whole(touched, rows) + more;
            if !whole.iter().all(|force| force.is_finite()) {
                return Err(Failure::NotConverged);
            }
            share(touched, &self.geometry, &whole, rows);
        }
        Ok(())
    }
}

impl Geometry {
    fn nothing() -> Self {
        Self {
            place: 0,
            normal: Vector3::zeros(),
            gap: 0.0,
            curvature: Matrix3::zeros(),
            dual: Vector3::zeros(),
            lambda: 0.0,
        }
    }

    fn of(touch: &Touch, place: usize) -> Self {
        Self {
            place,
            normal: touch.normal,
            gap: touch.gap,
            curvature: touch.curvature,
            dual: touch.normal,
            lambda: 0.0,
        }
    }
}

/// Where `vertex` is moved by the forces of `rows`.
pub(crate) fn displacement(columns: &Columns, rows: &[Row], vertex: u32) -> Vector3<f64> {
    rows.iter()
        .map(|row| columns.block(vertex, row.vertex) * row.force)
        .sum()
}

/// Force on a vertex, of all its rows.
fn whole(touched: &Touched, rows: &[Row]) -> Vector3<f64> {
    touched.rows().iter().map(|&index| rows[index].force).sum()
}

/// Gives each row of a vertex its multiplier's share of the force on it, and what is along no normal in
/// equal parts.
fn share(touched: &Touched, geometry: &[Geometry], whole: &Vector3<f64>, rows: &mut [Row]) {
    let own = |index: usize| geometry[index].normal * geometry[index].dual.dot(whole);
    match *touched.rows() {
        [one] => rows[one].force = *whole,
        _ => {
            let along: Vector3<f64> = touched.rows().iter().map(|&index| own(index)).sum();
            let rest = (whole - along) / touched.rows().len() as f64;
            for &index in touched.rows() {
                rows[index].force = own(index) + rest;
            }
        }
    }
}

/// Tangents and duals of a vertex from its rows' normals; `None` if these do not differ.
fn span(touched: &mut Touched, geometry: &mut [Geometry]) -> Option<()> {
    match *touched.rows() {
        [one] => {
            touched.tangents = tangents(&geometry[one].normal);
            touched.free = 2;
        }
        [one, two] => {
            let (a, b) = (geometry[one].normal, geometry[two].normal);
            let across = a.cross(&b);
            let square = across.norm_squared();
            if square < PARALLEL * PARALLEL {
                return None;
            }
            let cosine = a.dot(&b);
            geometry[one].dual = (a - b * cosine) / square;
            geometry[two].dual = (b - a * cosine) / square;
            touched.tangents[0] = across / square.sqrt();
            touched.free = 1;
        }
        [one, two, three] => {
            let normals = [one, two, three].map(|index| geometry[index].normal);
            let volume = normals[0].cross(&normals[1]).dot(&normals[2]);
            if volume.abs() < PARALLEL {
                return None;
            }
            for (which, index) in [one, two, three].into_iter().enumerate() {
                let (next, last) = (normals[(which + 1) % 3], normals[(which + 2) % 3]);
                geometry[index].dual = next.cross(&last) / volume;
            }
            touched.free = 0;
        }
        _ => return None,
    }
    Some(())
}

/// Two unit vectors that complete `normal`.
fn tangents(normal: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let axis = normal.iamin();
    let mut other = Vector3::zeros();
    other[axis] = 1.0;
    let first = normal.cross(&other).normalize();
    [first, normal.cross(&first)]
}

/// `matrix` (n x n) times `vector`, by columns: additions that do not wait for each other.
pub(crate) fn multiply(matrix: &[f64], vector: &[f64], product: &mut [f64]) {
    product.fill(0.0);
    for (column, x) in matrix.chunks_exact(product.len().max(1)).zip(vector) {
        for (sum, a) in product.iter_mut().zip(column) {
            *sum += a * x;
        }
    }
}

/// Inner product, in four sums that do not wait for each other.
pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    let (a, b) = (a.chunks_exact(4), b.chunks_exact(4));
    let rest: f64 = a
        .remainder()
        .iter()
        .zip(b.remainder())
        .map(|(a, b)| a * b)
        .sum();
    let mut sums = [0.0; 4];
    for (a, b) in a.zip(b) {
        for (sum, (a, b)) in sums.iter_mut().zip(a.iter().zip(b)) {
            *sum += a * b;
        }
    }
    rest + (sums[0] + sums[1]) + (sums[2] + sums[3])
}
