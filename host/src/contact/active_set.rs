//! Balance of tissue and spheres at given centres: Newton on the touched set, the set by signs.
//!
//! Entry point: [`solve`]. With p the forces on the tissue, `K_A = S^-1` the stiffness seen at the
//! touched vertices and `G = blockdiag(lambda_i (I - n_i n_i') / |x_i - c|)` the turning of the
//! normals, Newton's step for `p = N lambda`, `g = 0` is `(K_A - G) du - N dlambda = N lambda - p`,
//! `N' du = -g`. It is solved in the tangent planes T (du = -N g + T a), where `T'(K_A - G) T` is
//! positive definite at every stable balance. After each step rows that pull are dropped and
//! vertices inside a sphere added (primal-dual active set, Hintermueller, Ito & Kunisch 2002).

use super::columns::Columns;
use crate::dense::Dense;
use nalgebra::Vector3;

/// Most vertices touched at once, by all tools.
pub(crate) const MAX_ROWS: usize = 96;
/// Newton steps before a solve is given up: five reach round-off when the set is right.
const MAX_ITERATIONS: u32 = 40;
/// Steps after which the set changes by one row at a time, which cannot go round in circles as
/// easily as changing it everywhere at once.
const CAREFUL_AFTER: u32 = 12;
/// Balance: largest gap over radius, and largest tangential over largest force.
const TOLERANCE: f64 = 1e-11;
/// A vertex counts as inside a sphere when it is deeper than this part of the radius.
pub(crate) const DEPTH: f64 = 1e-10;

/// One touched vertex.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Row {
    /// Among the touchable vertices.
    pub vertex: u32,
    /// Index of the tool.
    pub tool: u32,
    /// Force on the tissue \[N\].
    pub force: Vector3<f64>,
}

/// A sphere where it is now.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Sphere {
    pub centre: Vector3<f64>,
    pub radius: f64,
    /// A tool that was not sampled touches nothing.
    pub present: bool,
}

/// Why there is no balance.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Failure {
    Missing,
    TooManyRows,
    NotConverged,
}

/// What is known about one row at the present iterate.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Geometry {
    pub normal: Vector3<f64>,
    pub tangents: [Vector3<f64>; 2],
    pub distance: f64,
    pub gap: f64,
    pub lambda: f64,
}

/// Buffers of the solve, at their largest size; after a solve they describe the balance found.
pub(crate) struct ContactWork {
    pub geometry: Vec<Geometry>,
    /// K_A, (3k x 3k) \[N/m\].
    pub stiffness: Vec<f64>,
    /// Factor of T'(K_A - G) T, (2k x 2k).
    pub tangential: Vec<f64>,
    pub dense: Dense,
    compliance: Vec<f64>,
    du: Vec<f64>,
    a: Vec<f64>,
    /// Vertices near a sphere, and which.
    pub near: Vec<Near>,
    /// Near vertices whose columns a solve asked for and did not find.
    pub missing: Vec<u32>,
    /// Near vertices inside their sphere, with their gap.
    entering: Vec<(f64, Near)>,
    pub iterations: u32,
    pub residual: f64,
}

/// A vertex that a sphere might touch.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Near {
    pub vertex: u32,
    pub tool: u32,
    /// Gap when it was listed, in radii.
    pub gap: f64,
}

impl ContactWork {
    /// For a model with so many touchable vertices.
    pub fn new(vertices: usize) -> Self {
        let (n, t) = (3 * MAX_ROWS, 2 * MAX_ROWS);
        Self {
            geometry: Vec::with_capacity(MAX_ROWS),
            stiffness: vec![0.0; n * n],
            tangential: vec![0.0; t * t],
            dense: Dense::new(n),
            compliance: vec![0.0; n * n],
            du: vec![0.0; n],
            a: vec![0.0; t],
            near: Vec::with_capacity(vertices),
            missing: Vec::with_capacity(vertices),
            entering: Vec::with_capacity(vertices),
            iterations: 0,
            residual: 0.0,
        }
    }
}

/// Finds the balance with the spheres where they are, starting from `rows`.
pub(crate) fn solve(
    spheres: &[Sphere],
    resting: &[Vector3<f64>],
    columns: &Columns,
    rows: &mut Vec<Row>,
    work: &mut ContactWork,
) -> Result<(), Failure> {
    work.geometry.clear();
    work.residual = 0.0;
    let mut changed = !rows.is_empty();
    for iteration in 0..MAX_ITERATIONS {
        let all_at_once = iteration < CAREFUL_AFTER;
        if rows.is_empty() || iteration == 0 {
            changed |= update_set(spheres, resting, columns, rows, work, all_at_once)?;
            if rows.is_empty() {
                return Ok(());
            }
        }
        if changed {
            condense(columns, rows, work)?;
        }
        look(spheres, resting, columns, rows, work)?;
        if work.residual <= TOLERANCE && !changed {
            return factor_tangential(work, true).map_err(|_| Failure::NotConverged);
        }
        newton(spheres, rows, work)?;
        work.iterations += 1;
        changed = update_set(spheres, resting, columns, rows, work, all_at_once)?;
    }
    Err(Failure::NotConverged)
}

/// Where `vertex` is moved by the forces of `rows`.
fn displacement(columns: &Columns, rows: &[Row], vertex: u32) -> Vector3<f64> {
    rows.iter()
        .map(|row| columns.block(vertex, row.vertex) * row.force)
        .sum()
}

/// Drops rows that pull and adds near vertices that are inside their sphere, all at once or only the
/// worst. Whether anything changed.
fn update_set(
    spheres: &[Sphere],
    resting: &[Vector3<f64>],
    columns: &Columns,
    rows: &mut Vec<Row>,
    work: &mut ContactWork,
    all_at_once: bool,
) -> Result<bool, Failure> {
    work.missing.clear();
    work.entering.clear();
    for near in &work.near {
        if rows.iter().any(|row| row.vertex == near.vertex) {
            continue;
        }
        let sphere = spheres[near.tool as usize];
        let at = resting[near.vertex as usize] + displacement(columns, rows, near.vertex);
        let gap = (at - sphere.centre).norm() - sphere.radius;
        if gap < -DEPTH * sphere.radius {
            work.entering.push((gap, *near));
            if !columns.has(near.vertex) {
                work.missing.push(near.vertex);
            }
        }
    }

    // The multiplier of the last Newton step acts along the normal that the step started from. A row
    // that has not seen a step yet stays.
    let pulls = |index: usize, row: &Row| {
        work.geometry
            .get(index)
            .map_or(0.0, |geometry| geometry.normal.dot(&row.force))
    };
    let before = rows.len();
    if all_at_once {
        let mut index = 0;
        rows.retain(|row| {
            index += 1;
            pulls(index - 1, row) >= 0.0
        });
    } else {
        let forces = rows
            .iter()
            .enumerate()
            .map(|(index, row)| (pulls(index, row), index));
        if let Some((force, index)) = forces.min_by(|a, b| a.0.total_cmp(&b.0))
            && force < 0.0
        {
            rows.remove(index);
            return Ok(true);
        }
        // No row pulls: let the deepest vertex in.
        work.entering.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        work.entering.truncate(1);
    }

    if !work.missing.is_empty() {
        return Err(Failure::Missing);
    }
    if rows.len() + work.entering.len() > MAX_ROWS {
        return Err(Failure::TooManyRows);
    }
    rows.extend(work.entering.iter().map(|(_, near)| Row {
        vertex: near.vertex,
        tool: near.tool,
        force: Vector3::zeros(),
    }));
    Ok(rows.len() != before || !work.entering.is_empty())
}

/// Stiffness seen at the touched vertices: the inverse of their compliance.
fn condense(columns: &Columns, rows: &[Row], work: &mut ContactWork) -> Result<(), Failure> {
    let n = 3 * rows.len();
    for (j, pushed) in rows.iter().enumerate() {
        for (i, at) in rows.iter().enumerate().skip(j) {
            let block = columns.block(at.vertex, pushed.vertex);
            for axis in 0..3 {
                let start = n * (3 * j + axis) + 3 * i;
                work.compliance[start..start + 3].copy_from_slice(block.column(axis).as_slice());
            }
        }
    }
    work.dense
        .factor(&mut work.compliance[..n * n], n)
        .map_err(|_| Failure::NotConverged)?;
    work.dense
        .invert(&work.compliance[..n * n], &mut work.stiffness[..n * n], n);
    Ok(())
}

/// Geometry and residual of every row at the present forces.
fn look(
    spheres: &[Sphere],
    resting: &[Vector3<f64>],
    columns: &Columns,
    rows: &[Row],
    work: &mut ContactWork,
) -> Result<(), Failure> {
    work.geometry.clear();
    let largest = rows.iter().map(|row| row.force.norm()).fold(0.0, f64::max);
    work.residual = 0.0;
    for row in rows {
        let sphere = spheres[row.tool as usize];
        let at = resting[row.vertex as usize] + displacement(columns, rows, row.vertex);
        let arm = at - sphere.centre;
        let distance = arm.norm();
        // A vertex at the centre has no normal; far less than that is never a balance.
        if !(distance > 1e-3 * sphere.radius && distance.is_finite()) {
            return Err(Failure::NotConverged);
        }
        let normal = arm / distance;
        let lambda = normal.dot(&row.force).max(0.0);
        let gap = distance - sphere.radius;
        let sideways = (row.force - normal * lambda).norm();
        work.residual = work.residual.max(gap.abs() / sphere.radius);
        if largest > 0.0 {
            work.residual = work.residual.max(sideways / largest);
        }
        work.geometry.push(Geometry {
            normal,
            tangents: tangents(&normal),
            distance,
            gap,
            lambda,
        });
    }
    Ok(())
}

/// Two unit vectors that complete `normal`.
fn tangents(normal: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let axis = normal.iamin();
    let mut other = Vector3::zeros();
    other[axis] = 1.0;
    let first = normal.cross(&other).normalize();
    [first, normal.cross(&first)]
}

/// Factors T'(K_A - G) T, or T' K_A T where the turning normals are left out.
fn factor_tangential(
    work: &mut ContactWork,
    turning: bool,
) -> Result<(), crate::dense::Indefinite> {
    let k = work.geometry.len();
    let (n, t) = (3 * k, 2 * k);
    for (j, column) in work.geometry.iter().enumerate() {
        for (b, along) in column.tangents.iter().enumerate() {
            for (i, row) in work.geometry.iter().enumerate().skip(j) {
                let mut pushed = Vector3::zeros();
                for axis in 0..3 {
                    let start = n * (3 * j + axis) + 3 * i;
                    let block = &work.stiffness[start..start + 3];
                    pushed += Vector3::new(block[0], block[1], block[2]) * along[axis];
                }
                for (a, across) in row.tangents.iter().enumerate() {
                    work.tangential[t * (2 * j + b) + 2 * i + a] = across.dot(&pushed);
                }
            }
            if turning {
                work.tangential[(t + 1) * (2 * j + b)] -= column.lambda / column.distance;
            }
        }
    }
    work.dense.factor(&mut work.tangential[..t * t], t)
}

/// One Newton step on the forces.
fn newton(spheres: &[Sphere], rows: &mut [Row], work: &mut ContactWork) -> Result<(), Failure> {
    let k = rows.len();
    let (n, t) = (3 * k, 2 * k);
    // Where the turning normals would make a saddle (deep inside a wrong set), leave them out: slower,
    // but downhill.
    if factor_tangential(work, true).is_err() {
        factor_tangential(work, false).map_err(|_| Failure::NotConverged)?;
    }
    // du = -N g, then a from T'(K_A - G) T a = T'(K_A N g - p).
    for (i, geometry) in work.geometry.iter().enumerate() {
        let du = -geometry.normal * geometry.gap;
        work.du[3 * i..3 * i + 3].copy_from_slice(du.as_slice());
    }
    for (i, (row, geometry)) in rows.iter().zip(&work.geometry).enumerate() {
        let left = -multiply(&work.stiffness, &work.du, n, i) - row.force;
        for (a, across) in geometry.tangents.iter().enumerate() {
            work.a[2 * i + a] = across.dot(&left);
        }
    }
    work.dense
        .solve(&work.tangential[..t * t], t, &mut work.a[..t], 1);
    for (i, geometry) in work.geometry.iter().enumerate() {
        let slide = geometry.tangents[0] * work.a[2 * i] + geometry.tangents[1] * work.a[2 * i + 1];
        for axis in 0..3 {
            work.du[3 * i + axis] += slide[axis];
        }
    }
    // A step that throws a vertex across its sphere is no guide: shorten it.
    let mut part = 1.0f64;
    for (row, du) in rows.iter().zip(work.du[..n].chunks_exact(3)) {
        let length = Vector3::new(du[0], du[1], du[2]).norm();
        part = part.min(0.5 * spheres[row.tool as usize].radius / length);
    }
    for (i, row) in rows.iter_mut().enumerate() {
        row.force += multiply(&work.stiffness, &work.du, n, i) * part;
        if !row.force.iter().all(|force| force.is_finite()) {
            return Err(Failure::NotConverged);
        }
    }
    Ok(())
}

/// Three rows of a symmetric matrix (n x n) times a vector.
fn multiply(matrix: &[f64], vector: &[f64], n: usize, block: usize) -> Vector3<f64> {
    let mut product = Vector3::zeros();
    for axis in 0..3 {
        let column = &matrix[n * (3 * block + axis)..n * (3 * block + axis + 1)];
        product[axis] = column.iter().zip(vector).map(|(a, x)| a * x).sum();
    }
    product
}
