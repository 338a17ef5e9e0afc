//! The extremes of tissue: one block, driven too far in each of the ways one can think of.
//!
//! Entry point: [`trials`].

use super::judge::{Course, LONGEST_STEP_S, Path, Verdict, difference, guarded};
use nalgebra::{Rotation3, Vector3};
use sutura_host::mesh::{TetMesh, slab};
use sutura_host::registry::Substance;
use sutura_host::registry::{Body, Entry};
use sutura_models::{Material, Tissue};

/// Side of the block \[m\].
const SIDE_M: f64 = 0.06;
/// Cubes along a side.
const CUBES: usize = 3;
/// Steps in which everything stays where it is: 20, and as many as two seconds have for models that need
/// time to come to rest.
const REST: usize = 20;
const REST_IN_TIME: usize = 200;

/// Liver, as in zhang-2017.
const USUAL: Substance = Substance {
    material: Material {
        youngs_modulus_pa: 3_500.0,
        poisson_ratio: 0.45,
    },
    fibres: None,
    relaxation: None,
    density_kg_per_m3: 1_060.0,
};

/// One trial of one model.
pub struct Trial<'a> {
    /// What is extreme.
    pub what: &'static str,
    /// How much of it.
    pub value: f64,
    run: Box<dyn Fn() -> Verdict + 'a>,
    /// Finds the largest value that is stable.
    pub largest: Option<Box<dyn Fn() -> f64 + 'a>>,
}

impl Trial<'_> {
    /// Runs it.
    pub fn run(&self) -> Verdict {
        guarded(|| (self.run)())
    }
}

/// All trials of a model; the short form has one of each kind.
pub fn trials<'a>(entry: &'a Entry, full: bool) -> Vec<Trial<'a>> {
    let block = Block::new(entry);
    let mut all = Vec::new();
    let mut add = |what: &'static str, values: &[f64], run: fn(&Block<'a>, f64) -> Verdict| {
        let values = if full {
            values
        } else {
            &values[values.len() - 1..]
        };
        for &value in values {
            all.push(Trial {
                what,
                value,
                run: Box::new(move || run(&block, value)),
                largest: None,
            });
        }
    };
    add("stiffness ratio", &[1e2, 1e4, 1e6], Block::stiffness_ratio);
    add("Young's modulus [Pa]", &[1.0, 1e9], Block::modulus);
    let ratios = [0.0, 0.3, 0.45, 0.49, 0.499, 0.4999, 0.49999];
    add("Poisson's ratio", &ratios, Block::poisson);
    add(
        "sliver's least angle [deg]",
        &[10.0, 1.0, 0.1],
        Block::sliver,
    );
    add(
        "node pushed through its cell [edges]",
        &[1.0, 1.5, 3.0],
        Block::inverted,
    );
    add("turn [deg]", &[190.0, 360.0], Block::turned);
    add("compression [%]", &[50.0, 90.0], Block::compressed);
    add("jump in a step [body lengths]", &[1.0, 10.0], Block::jump);
    if entry.double.is_some() {
        add(
            "single against double precision, compression [%]",
            &[1.0, 10.0, 50.0],
            Block::precision,
        );
    }
    if entry.has_step || entry.dynamic.is_some() {
        let steps = [1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1, 1.0];
        add("time step [s]", &steps, Block::time_step);
        if let Some(last) = all.last_mut() {
            last.largest = Some(Box::new(move || block.largest_step()));
        }
    }
    all
}

/// The block, bottom at z = -side.
#[derive(Clone, Copy)]
struct Block<'a> {
    entry: &'a Entry,
}

fn is_bottom([_, _, z]: [f64; 3]) -> bool {
    z < -SIDE_M * (1.0 - 1e-9)
}

fn is_top([_, _, z]: [f64; 3]) -> bool {
    z > -1e-9 * SIDE_M
}

/// Bottom held, top moved.
fn moved(by: [f64; 3]) -> impl Fn([f64; 3], f64) -> Option<[f64; 3]> {
    move |at, share| {
        if is_bottom(at) {
            Some([0.0; 3])
        } else {
            is_top(at).then_some(by.map(|u| share * u))
        }
    }
}

const PRESS: [f64; 3] = [0.0, 0.0, -0.1 * SIDE_M];

impl<'a> Block<'a> {
    fn new(entry: &'a Entry) -> Self {
        Self { entry }
    }

    fn rest(&self) -> usize {
        if self.entry.has_step {
            REST_IN_TIME
        } else {
            REST
        }
    }

    fn mesh() -> Result<TetMesh, Verdict> {
        slab([SIDE_M; 3], [CUBES; 3]).map_err(|error| Verdict::Defect(error.to_string()))
    }

    fn build(&self, substance: Substance, mesh: &TetMesh) -> Result<Box<dyn Tissue>, Verdict> {
        self.entry
            .build(&Body::of(substance), mesh)
            .map_err(Verdict::Refused)
    }

    /// Runs the usual block, or one of another substance, along a path.
    fn along(&self, substance: Substance, path: Path, steps: usize, back: bool) -> Verdict {
        let run = || {
            let mesh = Self::mesh()?;
            let mut tissue = self.build(substance, &mesh)?;
            let course = Course {
                mesh: &mesh,
                path,
                steps,
                rest: self.rest(),
                back,
                step_s: 0.01,
            };
            Ok(course.run(&mut *tissue).verdict)
        };
        run().unwrap_or_else(|verdict| verdict)
    }

    /// Half of the block is stiffer.
    fn stiffness_ratio(&self, ratio: f64) -> Verdict {
        let run = || {
            let mesh = Self::mesh()?;
            let low = |cell: &[u32; 4]| {
                let z: f64 = mesh.corners(*cell).iter().map(|corner| corner.z).sum();
                z < -2.0 * SIDE_M
            };
            let body = Body {
                substance: USUAL,
                cells: mesh
                    .cells()
                    .iter()
                    .map(|cell| Material {
                        youngs_modulus_pa: USUAL.material.youngs_modulus_pa
                            * if low(cell) { ratio } else { 1.0 },
                        ..USUAL.material
                    })
                    .collect(),
            };
            let mut tissue = self.entry.build(&body, &mesh).map_err(Verdict::Refused)?;
            let course = Course {
                mesh: &mesh,
                path: &moved(PRESS),
                steps: 10,
                rest: self.rest(),
                back: true,
                step_s: 0.01,
            };
            Ok(course.run(&mut *tissue).verdict)
        };
        run().unwrap_or_else(|verdict: Verdict| verdict)
    }

    fn modulus(&self, youngs_modulus_pa: f64) -> Verdict {
        let material = Material {
            youngs_modulus_pa,
            ..USUAL.material
        };
        let substance = Substance { material, ..USUAL };
        self.along(substance, &moved(PRESS), 10, true)
    }

    fn poisson(&self, poisson_ratio: f64) -> Verdict {
        let material = Material {
            poisson_ratio,
            ..USUAL.material
        };
        let substance = Substance { material, ..USUAL };
        self.along(substance, &moved(PRESS), 10, true)
    }

    /// An inner node is moved towards the opposite face of one of its cells until an angle between two
    /// faces is as small as that.
    fn sliver(&self, degrees: f64) -> Verdict {
        let run = || {
            let mesh = with_sliver(&Self::mesh()?, degrees.to_radians())?;
            let mut tissue = self.build(USUAL, &mesh)?;
            let course = Course {
                mesh: &mesh,
                path: &moved(PRESS),
                steps: 10,
                rest: self.rest(),
                back: true,
                step_s: 0.01,
            };
            Ok(course.run(&mut *tissue).verdict)
        };
        run().unwrap_or_else(|verdict: Verdict| verdict)
    }

    /// An inner node is held and pushed across its cells, which it turns inside out.
    fn inverted(&self, edges: f64) -> Verdict {
        let edge = SIDE_M / CUBES as f64;
        let inner = move |at: [f64; 3]| {
            let target = [-0.5 * edge, -0.5 * edge, -2.0 * edge];
            (0..3).all(|axis| (at[axis] - target[axis]).abs() < 1e-6 * edge)
        };
        let path = move |at: [f64; 3], share: f64| {
            if is_bottom(at) {
                Some([0.0; 3])
            } else {
                inner(at).then_some([share * edges * edge, 0.0, 0.0])
            }
        };
        self.along(USUAL, &path, 20, true)
    }

    /// The bottom turns about its middle, and everything with it.
    fn turned(&self, degrees: f64) -> Verdict {
        let middle = Vector3::new(0.0, 0.0, -SIDE_M);
        let turned = move |at: [f64; 3], share: f64| -> Vector3<f64> {
            let angle = share * degrees.to_radians();
            let turn = Rotation3::from_axis_angle(&Vector3::x_axis(), angle);
            let from = Vector3::from(at) - middle;
            turn * from - from
        };
        let path = move |at: [f64; 3], share: f64| is_bottom(at).then(|| turned(at, share).into());
        let run = || {
            let mesh = Self::mesh()?;
            let mut tissue = self.build(USUAL, &mesh)?;
            let course = Course {
                mesh: &mesh,
                path: &path,
                steps: (degrees / 5.0).ceil() as usize,
                rest: self.rest(),
                back: false,
                step_s: 0.01,
            };
            let answer: Vec<_> = mesh.points_m().iter().map(|at| turned(*at, 1.0)).collect();
            let seen = course.run(&mut *tissue);
            // What has only turned has no forces, whose balance is no measure then.
            if !matches!(seen.verdict, Verdict::Stable | Verdict::Degraded(_)) {
                return Ok(seen.verdict);
            }
            // After a whole turn the answer is nothing: measured by the size instead.
            let size = course.size_m();
            let off = seen
                .u
                .iter()
                .zip(&answer)
                .map(|(a, b)| (a - b).norm() / size)
                .fold(0.0, f64::max);
            Ok(if off > super::judge::MOST_DIFFERENCE {
                let off = 100.0 * off;
                Verdict::Degraded(format!(
                    "{off:.0} % of its size from where it should turn to"
                ))
            } else {
                Verdict::Stable
            })
        };
        run().unwrap_or_else(|verdict: Verdict| verdict)
    }

    fn compressed(&self, percent: f64) -> Verdict {
        let path = moved([0.0, 0.0, -0.01 * percent * SIDE_M]);
        self.along(USUAL, &path, 50, true)
    }

    /// The top is elsewhere from one step to the next, and back.
    fn jump(&self, lengths: f64) -> Verdict {
        self.along(USUAL, &moved([0.0, 0.0, lengths * SIDE_M]), 1, true)
    }

    /// The usual setting in single and in double precision, on the same way.
    fn precision(&self, percent: f64) -> Verdict {
        let run = || {
            let mesh = Self::mesh()?;
            let course = Course {
                mesh: &mesh,
                path: &moved([0.0, 0.0, -0.01 * percent * SIDE_M]),
                steps: 20,
                rest: self.rest(),
                back: false,
                step_s: 0.01,
            };
            let mut single = self.build(USUAL, &mesh)?;
            let Some(double) = &self.entry.double else {
                return Err(Verdict::Refused("there is one precision only".to_owned()));
            };
            let mut double = (double.build)(&Body::of(USUAL), &mesh).map_err(Verdict::Refused)?;
            let answer = course.run(&mut *double);
            if answer.verdict != Verdict::Stable {
                return Ok(answer.verdict);
            }
            let seen = course.run(&mut *single);
            let difference = difference(&seen.u, &answer.u);
            Ok(match seen.verdict {
                Verdict::Stable if difference > super::judge::MOST_ROUNDING => {
                    Verdict::Degraded(format!("{:.2} % from double precision", 100.0 * difference))
                }
                verdict => verdict,
            })
        };
        run().unwrap_or_else(|verdict: Verdict| verdict)
    }

    /// Against the same way, in the same time, in steps of 1 ms, or half as long where they are shorter. What is
    /// on its way has forces out of balance, which are no measure.
    fn time_step(&self, step_s: f64) -> Verdict {
        let run = || {
            let mesh = Self::mesh()?;
            let path = moved(PRESS);
            // Half a second there and as long at rest; as much of it as 500 steps are, at least one and ten.
            let steps = (0.5 / step_s).round().clamp(1.0, 500.0);
            let rest = steps.max(10.0);
            let course = |parts: f64| Course {
                mesh: &mesh,
                path: &path,
                steps: (steps * parts) as usize,
                rest: (rest * parts) as usize,
                back: false,
                step_s: step_s / parts,
            };
            let build = || {
                let body = Body::of(USUAL);
                match &self.entry.dynamic {
                    Some(dynamic) => (dynamic.build)(&body, &mesh).map_err(Verdict::Refused),
                    None => self.build(USUAL, &mesh),
                }
            };
            let seen = course(1.0).run(&mut *build()?);
            let exact = course((step_s / 0.001).round().max(2.0)).run(&mut *build()?);
            if !matches!(seen.verdict, Verdict::Stable | Verdict::Degraded(_)) {
                return Ok(seen.verdict);
            }
            if exact.u.is_empty() {
                return Ok(exact.verdict);
            }
            let difference = difference(&seen.u, &exact.u);
            Ok(if difference > super::judge::MOST_DIFFERENCE {
                let off = 100.0 * difference;
                Verdict::Degraded(format!("{off:.0} % from shorter steps"))
            } else {
                Verdict::Stable
            })
        };
        run().unwrap_or_else(|verdict: Verdict| verdict)
    }

    /// Largest step up to [`LONGEST_STEP_S`] that is stable, by bisection of its logarithm.
    fn largest_step(&self) -> f64 {
        let stable = |step_s: f64| guarded(|| self.time_step(step_s)) == Verdict::Stable;
        let (mut low, mut high) = (1e-3f64, LONGEST_STEP_S);
        if stable(high) {
            return high;
        }
        if !stable(low) {
            return f64::NAN;
        }
        for _ in 0..8 {
            let middle = (low * high).sqrt();
            if stable(middle) {
                low = middle;
            } else {
                high = middle;
            }
        }
        low
    }
}

/// Moves the inner node towards a face of one of its cells, by bisection.
fn with_sliver(mesh: &TetMesh, angle: f64) -> Result<TetMesh, Verdict> {
    let edge = SIDE_M / CUBES as f64;
    let is_inner = |at: &[f64; 3]| {
        let far = |x: f64| x.abs() < 0.6 * edge;
        far(at[0]) && far(at[1]) && at[2] < -0.5 * edge && at[2] > -2.5 * edge
    };
    let inner = mesh.points_m().iter().position(is_inner).unwrap_or(0);
    let cell = mesh
        .cells()
        .iter()
        .find(|cell| cell.contains(&(inner as u32)))
        .ok_or_else(|| Verdict::Defect("the block has no inner node".to_owned()))?;
    let from = Vector3::from(mesh.points_m()[inner]);
    let others = cell.iter().filter(|node| **node as usize != inner);
    let middle = others
        .map(|node| Vector3::from(mesh.points_m()[*node as usize]))
        .sum::<Vector3<f64>>()
        / 3.0;
    let at = |share: f64| {
        let mut points = mesh.points_m().to_vec();
        points[inner] = (from + share * (middle - from)).into();
        TetMesh::new(points, mesh.cells().to_vec())
    };
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..60 {
        let share = 0.5 * (low + high);
        match at(share) {
            Ok(mesh) if least_angle(&mesh) > angle => low = share,
            _ => high = share,
        }
    }
    at(low).map_err(|error| Verdict::Refused(error.to_string()))
}

/// Least angle between two faces of a cell \[rad\].
fn least_angle(mesh: &TetMesh) -> f64 {
    let mut least = std::f64::consts::PI;
    for cell in mesh.cells() {
        let p = mesh.corners(*cell);
        let face = |a: usize, b: usize, c: usize| (p[b] - p[a]).cross(&(p[c] - p[a])).normalize();
        // Outwards.
        let normals = [face(1, 2, 3), face(0, 3, 2), face(0, 1, 3), face(0, 2, 1)];
        for (i, a) in normals.iter().enumerate() {
            for b in &normals[..i] {
                let angle = std::f64::consts::PI - a.cross(b).norm().atan2(a.dot(b));
                least = least.min(angle);
            }
        }
    }
    least
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slivers_have_the_angle_that_is_asked_for() {
        let mesh = slab([SIDE_M; 3], [CUBES; 3]).expect("a slab");
        for degrees in [10.0, 1.0, 0.1] {
            let sliver = with_sliver(&mesh, f64::to_radians(degrees)).expect("a sliver");
            let least = least_angle(&sliver).to_degrees();
            assert!(
                (least - degrees).abs() < 0.01 * degrees,
                "{least} {degrees}"
            );
        }
    }

    /// What moves in time goes another way in steps of a second than in short ones, and that is seen.
    #[test]
    fn a_step_that_is_too_long_is_degraded() {
        let entry = sutura_host::registry::entry("shape-matching").expect("a model");
        let verdicts = [0.01, 1.0].map(|step_s| Block::new(&entry).time_step(step_s));
        assert_eq!(
            verdicts.map(|verdict| verdict.word()),
            ["stable", "degraded"]
        );
    }
}
