//! What a console makes of its rows in one tick, against the host's exact solver of the same rows.
//!
//! Patches of the elastic half-space (Boussinesq, Cerruti) under a ball: the compliance of soft tissue, in f64 for the
//! host and through the wire's f32 for the console.

use sutura_host::rows::{Method, Problem, Row, RowKind, State, Status, Workspace, solve};
use sutura_shared::control::ContactRows;
use sutura_shared::wire::message::{self, MAX_ROWS, Rows};
use sutura_shared::wire::{Header, Kind, List, PROTOCOL_VERSION, Valid};

const YOUNG_PA: f64 = 20e3;
const POISSON: f64 = 0.45;
/// Distance between points \[m\].
const EDGE_M: f64 = 2e-3;
const BALL_M: f64 = 10e-3;
/// How deep the ball is pressed in at the frame's pose \[m\].
const DEEP_M: f64 = 3e-3;

/// A patch of smooth points, or of cones.
struct Patch {
    friction: f64,
    points: Vec<[f64; 2]>,
    /// (n x n), \[m/N\].
    compliance: Vec<f64>,
    n: usize,
}

impl Patch {
    /// `mean`: compliance of the whole patch together \[m/N\], as of a thin slab or a soft organ.
    fn new(friction: f64, mean: f64) -> Self {
        let per_point = if friction > 0.0 { 3 } else { 1 };
        let mut points = Vec::new();
        for i in -4..=4 {
            for j in -4..=4 {
                let wobble = (f64::from(7 * i + 3 * j)).sin() * 0.15;
                let (x, y) = (f64::from(i) + wobble, f64::from(j) - wobble);
                points.push([x * EDGE_M, y * EDGE_M]);
            }
        }
        let off = |p: &[f64; 2]| (p[0] - 0.3 * EDGE_M).hypot(p[1] + 0.2 * EDGE_M);
        points.sort_by(|a, b| off(a).total_cmp(&off(b)));
        points.truncate(MAX_ROWS / per_point);
        let n = points.len() * per_point;
        let mut patch = Patch {
            friction,
            points,
            compliance: vec![0.0; n * n],
            n,
        };
        for i in 0..n {
            for j in 0..n {
                let entry = 0.5 * (patch.kernel(i, j) + patch.kernel(j, i));
                let same = i % per_point == j % per_point;
                patch.compliance[n * j + i] = entry + if same { mean } else { 0.0 };
            }
        }
        patch
    }

    fn rows_per_point(&self) -> usize {
        self.n / self.points.len()
    }

    /// Displacement along row `i` by a unit force along row `j`: Johnson 1985, 3.2 and 3.6; of a point on itself that of a
    /// square with the mean distance.
    fn kernel(&self, i: usize, j: usize) -> f64 {
        let per_point = self.rows_per_point();
        let (p, q) = (self.points[i / per_point], self.points[j / per_point]);
        let (a, b) = (i % per_point, j % per_point);
        let d = [p[0] - q[0], p[1] - q[1]];
        let r = d[0].hypot(d[1]);
        let size = (1.0 + POISSON) / (std::f64::consts::PI * YOUNG_PA);
        let near = 3.525 / EDGE_M;
        match (a, b) {
            (0, 0) if r == 0.0 => size * (1.0 - POISSON) * near,
            (0, 0) => size * (1.0 - POISSON) / r,
            (0, t) | (t, 0) if r > 0.0 => {
                let sign = if a == 0 { 1.0 } else { -1.0 };
                sign * size * (0.5 - POISSON) * d[t - 1] / (r * r)
            }
            (0, _) | (_, 0) => 0.0,
            (a, b) if r == 0.0 => {
                if a == b {
                    size * (1.0 - 0.5 * POISSON) * near
                } else {
                    0.0
                }
            }
            (a, b) => {
                let own = if a == b { (1.0 - POISSON) / r } else { 0.0 };
                size * (own + POISSON * d[a - 1] * d[b - 1] / (r * r * r))
            }
        }
    }

    /// d delta / d position of a row, and its gap with the ball as deep as at the frame's pose.
    fn geometry(&self, row: usize) -> ([f64; 3], f64) {
        let per_point = self.rows_per_point();
        let [x, y] = self.points[row / per_point];
        match row % per_point {
            0 => (
                [-x / BALL_M, -y / BALL_M, 1.0],
                (x * x + y * y) / (2.0 * BALL_M) - DEEP_M,
            ),
            1 => ([1.0, 0.0, 0.0], 0.0),
            _ => ([0.0, 1.0, 0.0], 0.0),
        }
    }

    fn rows(&self) -> Vec<Row> {
        let per_point = self.rows_per_point();
        let kind = |row| match row % per_point {
            0 if per_point == 1 => RowKind::Inequality,
            0 => RowKind::Normal {
                friction: self.friction,
            },
            _ => RowKind::Tangent,
        };
        let row = |row| Row {
            id: row as u64,
            kind: kind(row),
        };
        (0..self.n).map(row).collect()
    }

    /// The host's multipliers with the ball moved by `d`, all tangents sticking where the frame has them.
    fn exact(&self, d: [f64; 3], state: &mut State, work: &mut Workspace) -> Vec<f64> {
        let free = (0..self.n).map(|row| {
            let (jacobian, gap) = self.geometry(row);
            gap + (0..3).map(|axis| jacobian[axis] * d[axis]).sum::<f64>()
        });
        let free: Vec<f64> = free.collect();
        let rows = self.rows();
        let problem = Problem {
            rows: &rows,
            compliance: &self.compliance,
            delta_free: &free,
        };
        let outcome = solve(&problem, Method::ActiveSet, state, work);
        assert_eq!(outcome.status, Status::Ok);
        state.lambda().to_vec()
    }

    fn frame(&self, lambda: &[f64]) -> ContactRows {
        let per_point = self.rows_per_point();
        let row = |row: usize| {
            let (jacobian, gap) = self.geometry(row);
            let id = (row / per_point) as u32;
            let mut along = [0.0; 6];
            for (entry, value) in along.iter_mut().zip(jacobian) {
                *entry = value as f32;
            }
            message::Row {
                kind: match row % per_point {
                    0 if per_point == 1 => message::RowKind::Smooth { id },
                    0 => message::RowKind::Normal {
                        id,
                        friction: self.friction as f32,
                    },
                    _ => message::RowKind::Tangent { anchor_m: 0.0 },
                },
                delta_free_m: gap as f32,
                lambda_n: lambda[row] as f32,
                jacobian: along,
            }
        };
        let pairs = (0..self.n).flat_map(|i| (i..self.n).map(move |j| (i, j)));
        let body = Rows {
            tool: 0,
            held: [0.0; 21],
            curvature_per_m: 0.0,
            rows: List::of((0..self.n).map(row)),
            compliance: List::of(pairs.map(|(i, j)| self.compliance[self.n * j + i] as f32)),
        };
        let header = Header {
            version: PROTOCOL_VERSION,
            kind: Kind::Rows,
            session: 1,
            sequence: 1,
            console_time_us: 1,
        };
        ContactRows::unpack(&Valid::new(header, body).expect("a valid frame"))
    }

    /// Force on the ball.
    fn force(&self, lambda: impl Iterator<Item = f64>) -> [f64; 3] {
        let mut force = [0.0; 3];
        for (row, lambda) in lambda.enumerate() {
            let (jacobian, _) = self.geometry(row);
            for (sum, entry) in force.iter_mut().zip(jacobian) {
                *sum += entry * lambda;
            }
        }
        force
    }
}

fn apart(a: [f64; 3], b: [f64; 3]) -> f64 {
    let squares = a.iter().zip(b).map(|(a, b)| (a - b) * (a - b));
    squares.sum::<f64>().sqrt()
}

fn console_force(patch: &Patch, rows: &ContactRows) -> [f64; 3] {
    patch.force(rows.multipliers_n().map(f64::from))
}

fn dx(d: [f64; 3]) -> [f32; 6] {
    [d[0] as f32, d[1] as f32, d[2] as f32, 0.0, 0.0, 0.0]
}

/// A stroke at 0.1 m/s with presses and tremor, 33 ms on one frame: what the console's sweeps lag behind.
#[test]
fn smooth_rows_follow_a_hand_to_within_a_part_in_a_thousand() {
    for mean in [0.0, 5e-3, 20e-3] {
        let patch = Patch::new(0.0, mean);
        let (mut state, mut work) = (State::new(MAX_ROWS), Workspace::new(MAX_ROWS));
        let start = patch.exact([0.0; 3], &mut state, &mut work);
        let mut rows = patch.frame(&start);
        let (mut worst, mut largest, mut residual, mut opened) = (0.0_f64, 0.0_f64, 0.0_f32, 0);
        for tick in 1..=33 {
            let t = f64::from(tick) * 1e-3;
            let press = 3e-3 * (10.0 * t).sin() + 1e-3 * (std::f64::consts::TAU * 8.0 * t).sin();
            let d = [0.1 * t, 0.02 * t, press];
            let exact = patch.exact(d, &mut state, &mut work);
            opened += exact.iter().filter(|force| **force == 0.0).count();
            residual = residual.max(rows.solve(&dx(d)).residual);
            let wanted = patch.force(exact.into_iter());
            worst = worst.max(apart(wanted, console_force(&patch, &rows)));
            largest = largest.max(apart(wanted, [0.0; 3]));
        }
        println!(
            "smooth, mean {mean}: {:.1e} of {largest:.2} N, residual {residual:.1e}",
            worst / largest
        );
        assert!(opened > 50, "nothing switched: {opened}");
        assert!(worst < 1e-3 * largest, "{worst} of {largest} N");
        assert!(residual < 1e-2);
    }
}

/// Cones from their anchors, one tick each: sticking, slipping, and both at once.
#[test]
fn cones_find_the_hosts_forces_in_a_tick() {
    let mut slipping = [0, 0];
    for (friction, mean) in [(0.3, 0.0), (0.5, 5e-3), (1.0, 0.0)] {
        let patch = Patch::new(friction, mean);
        let (mut state, mut work) = (State::new(MAX_ROWS), Workspace::new(MAX_ROWS));
        let start = patch.exact([0.0; 3], &mut state, &mut work);
        let largest = apart(patch.force(start.iter().copied()), [0.0; 3]);
        let fresh = patch.frame(&start);
        for (x, y, z) in [
            (1e-4, 0.0, 0.0),
            (-2e-4, 3e-4, -1e-4),
            (1e-3, 0.0, 2e-4),
            (0.0, -2e-3, 0.0),
            (3e-3, 3e-3, -5e-4),
        ] {
            let exact = patch.exact([x, y, z], &mut state, &mut work);
            for cone in exact.chunks_exact(3) {
                let slips = cone[1].hypot(cone[2]) > friction * cone[0] * (1.0 - 1e-6);
                slipping[usize::from(slips)] += 1;
            }
            let mut rows = fresh;
            let solved = rows.solve(&dx([x, y, z]));
            let error = apart(patch.force(exact.into_iter()), console_force(&patch, &rows));
            assert!(
                error < 1e-2 * largest,
                "{friction} {mean} {x} {y} {z}: {error} of {largest} N, residual {}",
                solved.residual
            );
        }
    }
    assert!(slipping.iter().all(|count| *count > 20), "{slipping:?}");
}

/// The number of sweeps is enough because each brings the problem nearer: a tick from far away is not exact, the
/// next ones at the same place are.
#[test]
fn ticks_at_one_place_converge() {
    let patch = Patch::new(0.0, 20e-3);
    let (mut state, mut work) = (State::new(MAX_ROWS), Workspace::new(MAX_ROWS));
    let start = patch.exact([0.0; 3], &mut state, &mut work);
    let d = [3e-3, -2e-3, -4e-3];
    let wanted = patch.force(patch.exact(d, &mut state, &mut work).into_iter());
    let mut rows = patch.frame(&start);
    let errors: Vec<f64> = (1..=6)
        .map(|_| {
            rows.solve(&dx(d));
            apart(wanted, console_force(&patch, &rows)) / apart(wanted, [0.0; 3])
        })
        .collect();
    println!("{errors:?}");
    assert!(errors[0] < 0.02 && errors[5] < 2e-5, "{errors:?}");
}
