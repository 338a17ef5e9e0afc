//! Random paths against clarabel's interior point method on the problem as it is stated: least energy of the
//! tissue under a bound on the path's length, with K^-1 from whole solves.

use super::*;
use clarabel::algebra::CscMatrix;
use clarabel::solver::SupportedConeT::{NonnegativeConeT, SecondOrderConeT};
use clarabel::solver::{DefaultSettingsBuilder, DefaultSolver, IPSolver, SolverStatus};
use sutura_host::thread::pull::PullStatus;

/// How segments (3 each) are, and how forces along their axes move them, by columns.
fn gathered(scene: &Scene, path: &[PathPoint], outside: &[bool]) -> (Vec<f64>, Vec<Vec<f64>>) {
    let rest = scene.at_rest();
    let segments: Vec<_> = outside_segments(path, outside).collect();
    let ways = |moved: &[[f64; 3]]| -> Vec<f64> {
        segments
            .iter()
            .flat_map(|(a, b)| {
                let way: [f64; 3] = (scene.at(b, moved) - scene.at(a, moved)).into();
                way
            })
            .collect()
    };
    let free = ways(&rest);
    let mut columns = Vec::new();
    for ends in &segments {
        for axis in 0..3 {
            let pulled = [(ends.0, 1.0), (ends.1, -1.0)];
            let forces = pulled.iter().flat_map(|(point, sign)| {
                let anchor = match point {
                    PathPoint::Tissue(anchor) => Some(*anchor),
                    PathPoint::Held(_) => None,
                };
                anchor.into_iter().flat_map(move |anchor| {
                    let nodes = anchor.nodes.into_iter().zip(anchor.weights);
                    nodes.map(move |(node, weight)| {
                        let mut force = [0.0; 3];
                        force[axis] = sign * weight;
                        (node, force)
                    })
                })
            });
            let moved = scene.moved(forces);
            columns.push(ways(&moved).iter().zip(&free).map(|(y, f)| f - y).collect());
        }
    }
    (free, columns)
}

/// Columns of R with `R R'` the given matrix of any rank: Cholesky with the largest pivot first.
fn root(n: usize, entry: impl Fn(usize, usize) -> f64) -> Vec<Vec<f64>> {
    let mut columns: Vec<Vec<f64>> = Vec::new();
    let left = |columns: &[Vec<f64>], row: usize, column: usize| {
        let done: f64 = columns.iter().map(|r| r[row] * r[column]).sum();
        entry(row, column) - done
    };
    for _ in 0..n {
        let sizes = (0..n).map(|row| (row, left(&columns, row, row)));
        let (pivot, size) = sizes
            .max_by(|a, b| a.1.total_cmp(&b.1))
            .expect("at least one");
        let next = if size > 1e-15 {
            let column = (0..n).map(|row| left(&columns, row, pivot) / size.sqrt());
            column.collect()
        } else {
            vec![0.0; n]
        };
        columns.push(next);
    }
    columns
}

/// Tension and segments: `min 1/2 v'v` with `|y_free - R v| <= t` by segments, `sum t <= a`, `G = R R'`.
fn cone_programme(free: &[f64], g: &[Vec<f64>], available_m: f64) -> (f64, Vec<f64>) {
    let (n, m) = (free.len(), free.len() / 3);
    let length = free.iter().fold(0.0f64, |most, x| most.max(x.abs()));
    let soft = g.iter().flatten().fold(0.0f64, |most, x| most.max(x.abs()));
    let root = root(n, |row, column| {
        0.5 * (g[column][row] + g[row][column]) / soft
    });
    let r = |row: usize, column: usize| root[column][row];
    let starts = (0..=n).chain(std::iter::repeat_n(n, m)).collect();
    let hessian = CscMatrix::new(n + m, n + m, starts, (0..n).collect(), vec![1.0; n]);
    // Rows: the sum, then by segments t and y.
    let (mut values, mut rows, mut starts) = (Vec::new(), Vec::new(), vec![0]);
    for column in 0..n {
        for row in 0..n {
            rows.push(1 + 4 * (row / 3) + 1 + row % 3);
            values.push(r(row, column));
        }
        starts.push(rows.len());
    }
    for segment in 0..m {
        rows.extend([0, 1 + 4 * segment]);
        values.extend([1.0, -1.0]);
        starts.push(rows.len());
    }
    let matrix = CscMatrix::new(1 + 4 * m, n + m, starts, rows, values);
    let mut bounds = vec![available_m / length];
    let mut cones = vec![NonnegativeConeT(1)];
    for way in free.chunks(3) {
        bounds.push(0.0);
        bounds.extend(way.iter().map(|x| x / length));
        cones.push(SecondOrderConeT(4));
    }
    let settings = DefaultSettingsBuilder::default()
        .verbose(false)
        .tol_gap_abs(1e-14)
        .tol_gap_rel(1e-14)
        .tol_feas(1e-14)
        .build()
        .expect("settings");
    let linear = vec![0.0; n + m];
    let mut solver = DefaultSolver::new(&hessian, &linear, &matrix, &bounds, &cones, settings)
        .expect("a programme");
    solver.solve();
    let solution = &solver.solution;
    assert!(matches!(
        solution.status,
        SolverStatus::Solved | SolverStatus::AlmostSolved | SolverStatus::InsufficientProgress
    ));
    let ways = (0..n)
        .map(|row| {
            let moved: f64 = (0..n)
                .map(|column| r(row, column) * solution.x[column])
                .sum();
            free[row] - length * moved
        })
        .collect();
    (solution.z[0] * length / soft, ways)
}

#[test]
fn tension_and_segments_are_those_of_the_cone_programme() {
    let scene = Scene::new();
    let mut solver = scene.solver(16, 1e3);
    let mut random = Random(7);
    let (mut worst, mut welds, mut most, mut taut, mut sum) = ((0.0f64, 0.0f64), 0, 0, 0, 0);
    let mut short = 0;
    for case in 0..60 {
        let (path, outside) = if case < 8 {
            stitches(&scene.mesh, 1 + case)
        } else {
            random.path(&scene.mesh)
        };
        if path.len() > 16 {
            solver = scene.solver(path.len(), 1e3);
        }
        let (free, g) = gathered(&scene, &path, &outside);
        let whole: f64 = free
            .chunks(3)
            .map(|y| Vector3::from_column_slice(y).norm())
            .sum();
        let share = if case < 8 {
            0.5
        } else {
            0.2 + 0.85 * random.unit()
        };
        let pull = solver.pull(&path, &outside, share * whole);
        if pull.status == PullStatus::Strained {
            continue;
        }
        assert_eq!(pull.status, PullStatus::Ok, "{case}");
        if share >= 1.0 {
            assert_eq!(pull.tension_n, 0.0);
            continue;
        }
        let (tension, ways) = cone_programme(&free, &g, share * whole);
        let off = (pull.tension_n - tension).abs() / tension;
        let far = (0..ways.len() / 3).flat_map(|segment| solver.segment_m(segment).expect("one"));
        let far = far.zip(&ways).map(|(own, way)| (own - way).abs());
        let far = far.fold(0.0, f64::max) / whole;
        // The interior point method stops short where a segment has just closed or is about to.
        assert!(off < 1e-3 && far < 1e-4, "{case}: {off:e} {far:e} {pull:?}");
        if off > 1e-6 || far > 1e-6 {
            short += 1;
            println!("{case}: {off:e} {far:e} {pull:?}");
        }
        // Then the law itself, on compliance from whole solves, which is enough of a convex problem.
        let force: Vec<f64> = (0..free.len() / 3)
            .flat_map(|segment| solver.segment_force_n(segment))
            .collect();
        for (segment, free) in free.chunks(3).enumerate() {
            let way = Vector3::from_fn(|axis, _| {
                let row = 3 * segment + axis;
                let moved: f64 = g.iter().zip(&force).map(|(g, f)| g[row] * f).sum();
                free[axis] - moved
            });
            let pulled = Vector3::from_column_slice(&force[3 * segment..3 * segment + 3]);
            let idle = pull.tension_n * way.norm() - pulled.dot(&way);
            assert!(pulled.norm() <= pull.tension_n * (1.0 + 1e-12));
            assert!(
                idle.abs() <= 1e-12 * pull.tension_n * whole,
                "{case}: {idle:e}"
            );
        }
        assert!((pull.length_m - share * whole).abs() < 1e-9);
        worst = (worst.0.max(off), worst.1.max(far));
        welds += pull.welds;
        most = most.max(pull.solves);
        sum += pull.solves;
        taut += 1;
    }
    assert!(short <= taut / 20);
    println!("{taut} taut: {worst:?} off, {welds} welds, solves {sum}, at most {most}");
    assert!(taut >= 30 && welds >= 10);
}
