//! Random row sets of every kind, and the law they must obey, written out without the solver.

use sutura_host::rows::{Mode, Problem, Row, RowKind, State};
use sutura_testkit::Random;

/// An owned problem.
#[derive(Clone, Debug)]
pub struct Set {
    pub rows: Vec<Row>,
    pub compliance: Vec<f64>,
    pub delta_free: Vec<f64>,
    /// Whether rows were made dependent on purpose, and their targets at odds.
    pub dependent: bool,
    pub conflicting: bool,
}

impl Set {
    pub fn problem(&self) -> Problem<'_> {
        Problem {
            rows: &self.rows,
            compliance: &self.compliance,
            delta_free: &self.delta_free,
        }
    }

    pub fn has_cones(&self) -> bool {
        self.rows.iter().any(|row| row.kind == RowKind::Tangent)
    }

    /// The same rows in another order, cones together; and where each went.
    pub fn permuted(&self, random: &mut Random) -> (Self, Vec<usize>) {
        let n = self.rows.len();
        let mut starts: Vec<usize> = (0..n)
            .filter(|&row| self.rows[row].kind != RowKind::Tangent)
            .collect();
        for i in (1..starts.len()).rev() {
            starts.swap(i, random.below(i + 1));
        }
        let mut from = Vec::new();
        for start in starts {
            let length = match self.rows[start].kind {
                RowKind::Normal { .. } => 3,
                RowKind::Disc { .. } => 2,
                _ => 1,
            };
            from.extend(start..start + length);
        }
        let mut set = self.clone();
        for (i, &a) in from.iter().enumerate() {
            set.rows[i] = self.rows[a];
            set.delta_free[i] = self.delta_free[a];
            for (j, &b) in from.iter().enumerate() {
                set.compliance[j * n + i] = self.compliance[b * n + a];
            }
        }
        (set, from)
    }
}

/// What sets to draw.
#[derive(Clone, Copy)]
pub struct Draw {
    pub most_rows: usize,
    pub kinds: &'static [Kind],
    /// Share of sets with rows that copy or combine others.
    pub dependent: f64,
    /// Share of these rows that are so to 1e-2 .. 1e-10 only.
    pub nearly: f64,
    /// Share of those sets whose targets contradict.
    pub conflicting: f64,
    /// Least eigenvalue, relative, of independent sets.
    pub softest: f64,
    /// Largest coefficient of friction.
    pub friction: f64,
    /// Powers of ten of a row's compliance: of the whole set, and from row to row.
    pub magnitude: (f64, f64),
    pub spread: f64,
}

#[derive(Clone, Copy, PartialEq)]
pub enum Kind {
    Equality,
    Inequality,
    Box,
    Cone,
    Disc,
}

pub const CONVEX: &[Kind] = &[Kind::Equality, Kind::Inequality, Kind::Box];
pub const WITH_DISCS: &[Kind] = &[Kind::Equality, Kind::Inequality, Kind::Cone, Kind::Disc];
pub const ALL: &[Kind] = &[Kind::Equality, Kind::Inequality, Kind::Box, Kind::Cone];

pub fn draw(random: &mut Random, how: &Draw) -> Set {
    // Mostly small.
    let count = (how.most_rows as f64 * random.unit().powi(3)) as usize;
    let mut kinds = Vec::new();
    while kinds.len() < count {
        match how.kinds[random.below(how.kinds.len())] {
            Kind::Equality => kinds.push(RowKind::Equality),
            Kind::Inequality => kinds.push(RowKind::Inequality),
            Kind::Box => kinds.push(RowKind::Box {
                limit_n: if random.chance(0.05) {
                    0.0
                } else {
                    random.unit()
                },
            }),
            Kind::Cone => {
                let friction = if random.chance(0.1) {
                    0.0
                } else {
                    how.friction * random.unit()
                };
                kinds.push(RowKind::Normal { friction });
                kinds.extend([RowKind::Tangent; 2]);
            }
            Kind::Disc => {
                let limit_n = 0.05 * 400f64.powf(random.unit());
                kinds.extend([RowKind::Disc { limit_n }, RowKind::Tangent]);
            }
        }
    }
    let n = kinds.len();
    // C: rows in an energy's square root, so that W = C C'; u: a displacement that meets all targets.
    let width = n + 3;
    let mut c: Vec<f64> = (0..n * width).map(|_| random.signed()).collect();
    for row in 0..n {
        c[row * width + row] += how.softest.sqrt() * (n as f64).sqrt();
    }
    let u: Vec<f64> = (0..width).map(|_| random.signed()).collect();
    let dependent = n > 1 && random.chance(how.dependent);
    let conflicting = dependent && random.chance(how.conflicting);
    if dependent {
        for _ in 0..1 + random.below(n / 2 + 1) {
            let noise = if random.chance(how.nearly) {
                10f64.powf(-2.0 - 8.0 * random.unit())
            } else {
                0.0
            };
            let (to, a, b) = (random.below(n), random.below(n), random.below(n));
            let (x, y) = match random.below(3) {
                0 => (1.0, 0.0),
                1 => (-1.0, 0.0),
                _ => (random.signed(), random.signed()),
            };
            if to != a && to != b {
                for k in 0..width {
                    c[to * width + k] =
                        x * c[a * width + k] + y * c[b * width + k] + noise * random.signed();
                }
            }
        }
    }
    let magnitude = how.magnitude.0 + (how.magnitude.1 - how.magnitude.0) * random.unit();
    let spread = if random.chance(0.3) { how.spread } else { 0.0 };
    let mut scale = vec![0.0; n];
    for row in 0..n {
        scale[row] = if kinds[row] == RowKind::Tangent {
            scale[row - 1]
        } else {
            10f64.powf(0.5 * (magnitude + spread * random.signed()))
        };
    }
    let mut compliance = vec![0.0; n * n];
    for i in 0..n {
        for j in 0..n {
            let product: f64 = (0..width)
                .map(|k| c[i * width + k] * c[j * width + k])
                .sum();
            compliance[j * n + i] = scale[i] * scale[j] * product / width as f64;
        }
    }
    let load = 10f64.powf(-0.5 * magnitude.abs() * random.unit()) * 10f64.powf(0.5 * magnitude);
    let mut delta_free: Vec<f64> = (0..n)
        .map(|i| {
            let reach: f64 = (0..width).map(|k| c[i * width + k] * u[k]).sum();
            scale[i] * reach * load / 10f64.powf(0.5 * magnitude)
        })
        .collect();
    if conflicting {
        for _ in 0..1 + random.below(3) {
            let row = random.below(n);
            delta_free[row] += scale[row] * random.signed() * load / 10f64.powf(0.5 * magnitude);
        }
    }
    if random.chance(0.02) {
        delta_free.fill(0.0);
    }
    // Limits that matter: in units of the forces that the loads call for.
    let each = kinds.iter_mut().zip(scale.iter().zip(&delta_free));
    for (row, (kind, (scale, free))) in each.enumerate() {
        if let RowKind::Box { limit_n } = kind {
            *limit_n *= 2.0 * free.abs() / (scale * scale);
            // Some of them pull more than they push, or do not push.
            let part = [1.0, 0.25, 1.0, 0.0][row % 4];
            if part < 1.0 {
                *kind = RowKind::Between {
                    least_n: -part * *limit_n,
                    most_n: *limit_n,
                };
            }
        }
    }
    let rows = kinds
        .into_iter()
        .map(|kind| Row {
            id: random.bits(),
            kind,
        })
        .collect();
    Set {
        rows,
        compliance,
        delta_free,
        dependent,
        conflicting,
    }
}

/// Bounds and cones of the forces, to the last bit (cones to rounding), and finite numbers.
pub fn assert_admissible(set: &Set, state: &State) {
    assert_eq!(state.lambda().len(), set.rows.len());
    for (row, (&lambda, &delta)) in state.lambda().iter().zip(state.delta()).enumerate() {
        assert!(
            lambda.is_finite() && delta.is_finite(),
            "{row}: {lambda} {delta}"
        );
        match set.rows[row].kind {
            RowKind::Inequality => assert!(lambda >= 0.0),
            RowKind::Box { limit_n } => {
                assert!(
                    lambda.abs() <= limit_n * (1.0 + 1e-14),
                    "{lambda} {limit_n}"
                );
            }
            RowKind::Between { least_n, most_n } => {
                let rounding = 1e-14 * (most_n - least_n);
                assert!(lambda >= least_n - rounding && lambda <= most_n + rounding);
            }
            RowKind::Normal { friction } => {
                assert!(lambda >= 0.0);
                let lateral = state.lambda()[row + 1].hypot(state.lambda()[row + 2]);
                assert!(lateral <= friction * lambda * (1.0 + 1e-12) + 1e-300);
            }
            RowKind::Disc { limit_n } => {
                let length = state.lambda()[row].hypot(state.lambda()[row + 1]);
                assert!(length <= limit_n * (1.0 + 1e-12));
            }
            RowKind::Equality | RowKind::Tangent => {}
        }
        if state.modes()[row] == Mode::Slipping {
            let kind = set.rows[row].kind;
            assert!(
                matches!(kind, RowKind::Tangent | RowKind::Disc { .. }),
                "{kind:?}"
            );
        }
    }
}
