//! Rows for the console: they reproduce the tangent, and predict where rows switch.

use super::bench::{Bench, RADIUS, at, ball, contact, pose, slab_mesh};
use nalgebra::{Matrix6, SMatrix, SVector, UnitQuaternion, Vector3, Vector6};
use sutura_host::fem::Loads;
use sutura_host::step::{MAX_TOOL_ROWS, State, ToolContact, ToolRows};
use sutura_host::tool::{Shape, Tool, ToolSample};
use sutura_testkit::Random;

const N: usize = MAX_TOOL_ROWS;

/// J and W of the rows that `keep` chooses; the others are left without any effect.
fn parts(
    rows: &ToolRows,
    keep: impl Fn(usize) -> bool,
) -> (SMatrix<f64, N, 6>, SMatrix<f64, N, N>) {
    let keep = |i: usize| i < rows.count && keep(i);
    let jacobian = SMatrix::from_fn(|i, j| if keep(i) { rows.jacobian[i][j] } else { 0.0 });
    let compliance = SMatrix::from_fn(|i, j| {
        if keep(i) && keep(j) {
            rows.compliance_between(i, j)
        } else {
            f64::from(i == j)
        }
    });
    (jacobian, compliance)
}

/// -J_a' W_aa^-1 J_a over the rows that touch.
fn active_part(rows: &ToolRows) -> Matrix6<f64> {
    let (jacobian, compliance) = parts(rows, |i| rows.lambda_n[i] > 0.0);
    let inverse = compliance.cholesky().expect("positive definite").inverse();
    -jacobian.transpose() * inverse * jacobian
}

fn symmetric(contact: &ToolContact) -> Matrix6<f64> {
    let tangent = Matrix6::from_fn(|i, j| contact.tangent[i][j]);
    (tangent + tangent.transpose()) * 0.5
}

/// The wrench at a pose `dq` away, by the rows: complementarity by projected Gauss-Seidel.
fn predict(rows: &ToolRows, contact: &ToolContact, dq: &Vector6<f64>) -> Vector6<f64> {
    let (jacobian, compliance) = parts(rows, |_| true);
    let before = SVector::<f64, N>::from(rows.lambda_n);
    let free = SVector::<f64, N>::from(rows.delta_m) + jacobian * dq;
    let mut lambda = before;
    for _ in 0..5_000 {
        for i in 0..rows.count {
            let gap = free[i] + compliance.column(i).dot(&(lambda - before));
            lambda[i] = (lambda[i] - gap / compliance[(i, i)]).max(0.0);
        }
    }
    let skew = Matrix6::from_fn(|i, j| contact.tangent[i][j]) - symmetric(contact);
    let held = Matrix6::from_fn(|i, j| rows.held[i][j]) + skew;
    Vector6::from(contact.wrench) + held * dq + jacobian.transpose() * (lambda - before)
}

/// Checks `M - J_a' W_aa^-1 J_a` against the tangent's symmetric part. W and J come from K_A - G, the tangent
/// from the planes across the normals: two ways that share K_A and the geometry.
pub fn assert_reproduced(rows: &ToolRows, contact: &ToolContact, what: &str) {
    let held = Matrix6::from_fn(|i, j| rows.held[i][j]);
    let expected = symmetric(contact);
    let error = held + active_part(rows) - expected;
    for (i, j) in [(0, 0), (0, 3), (3, 3)] {
        // A turn about a sphere's centre does nothing: that block is judged by the others.
        let arm = RADIUS.powi((i + j) as i32 / 3);
        let scale = expected.fixed_view::<3, 3>(0, 0).norm() * arm;
        let error = error.fixed_view::<3, 3>(i, j).norm() / scale;
        assert!(error < 1e-9, "{what}: block {i} {j} off by {error:.1e}");
    }
}

fn lean() -> UnitQuaternion<f64> {
    UnitQuaternion::from_scaled_axis(Vector3::new(0.1, -0.15, 0.2))
}

#[test]
fn rows_reproduce_the_tangent() {
    let offset = [0.02, -0.01, -0.05];
    let punch = Tool::new(Shape::flat_punch(RADIUS, 0.04), offset);
    // The last touches more vertices than there are rows: the others are condensed out.
    let wide = Tool::sphere(0.03, offset);
    for (what, tool, height, fits) in [
        ("sphere", ball(offset), RADIUS - 0.007, true),
        ("punch", punch, 0.0, true),
        ("wide sphere", wide, 0.03 - 0.009, false),
    ] {
        let mut bench = Bench::slab(tool);
        bench.options.most_rows = MAX_TOOL_ROWS;
        let centre = Vector3::new(0.002, 0.001, height);
        let grip = centre - lean() * Vector3::from(offset);
        let (_, report) = bench.afresh(at(0.0, 0.0, 0.2), pose(grip, lean()));
        let contact = contact(&report);
        assert!(
            (contact.rows <= 24) == fits,
            "{what}: {} rows",
            contact.rows
        );
        let rows = bench.work.rows(0).expect("rows");
        assert_eq!(rows.count, 24);
        assert_reproduced(rows, &contact, what);
        assert!(rows.turning);
        let (_, compliance) = parts(rows, |_| true);
        assert!(
            compliance.cholesky().is_some(),
            "W is not positive definite"
        );
        for (lambda, delta) in rows.lambda_n.iter().zip(&rows.delta_m) {
            assert!(*lambda >= 0.0 && *delta >= 0.0 && lambda * delta == 0.0);
        }
        // Lifting the tool off opens every gap.
        assert!(rows.jacobian.iter().all(|row| row[2] > 0.0));
    }
}

#[test]
fn another_tool_is_condensed_out() {
    let (mesh, bottom) = slab_mesh();
    let tools = [(0, ball([0.0; 3])), (5, ball([0.01, 0.0, -0.02]))];
    let mut bench = Bench::new(&mesh, &bottom, Loads::default(), &tools);
    bench.options.most_rows = MAX_TOOL_ROWS;
    // Near enough for vertices that both touch.
    let left = at(-0.0045, 0.001, RADIUS - 0.005);
    let right = ToolSample {
        id: 5,
        ..at(-0.0055, 0.0, RADIUS + 0.02 - 0.0055)
    };
    let mut state = State::new(&bench.model);
    let report = bench.follow(&mut state, &[left, right]);
    assert_eq!(report.contacts().len(), 2, "{:?}", report.status);
    bench.assert_balanced(&state, &[left, right]);
    for contact in report.contacts() {
        let rows = bench.work.rows(contact.id).expect("rows");
        assert_eq!(rows.tool, contact.id);
        assert_reproduced(rows, contact, "one of two");
    }
    bench.options.most_rows = 0;
    bench.follow(&mut state, &[left, right]);
    assert!(bench.work.rows(0).is_none(), "nobody asked");
}

/// Along a motion of the grip that makes rows switch, the rows predict the full solver's wrench far
/// better than the tangent does.
#[test]
fn rows_predict_switches() {
    let offset = [0.02, -0.01, -0.05];
    let punch = Tool::new(Shape::flat_punch(RADIUS, 0.04), offset);
    let mut random = Random::new(11);
    for (what, tool, height) in [
        ("sphere", ball(offset), RADIUS - 0.005),
        ("punch", punch, 0.001),
    ] {
        let mut bench = Bench::slab(tool);
        bench.options.most_rows = MAX_TOOL_ROWS;
        let (mut by_rows, mut by_tangent) = (Vec::new(), Vec::new());
        for _ in 0..200 {
            let centre = Vector3::new(0.004, 0.004, 0.0).component_mul(&random.vector())
                + Vector3::z() * height;
            let grip = centre - lean() * Vector3::from(offset);
            let (from, here) = (at(0.0, 0.0, 0.2), pose(grip, lean()));
            let (_, report) = bench.afresh(from, here);
            let start = contact(&report);
            let rows = *bench.work.rows(0).expect("rows");
            let (dx, turn) = (random.vector() * 1e-4, random.vector() * 1e-3);
            let there = pose(grip + dx, UnitQuaternion::from_scaled_axis(turn) * lean());
            let (_, report) = bench.afresh(from, there);
            let end = contact(&report);
            if end.rows == start.rows {
                continue;
            }
            let dq = Vector6::new(dx.x, dx.y, dx.z, turn.x, turn.y, turn.z);
            let tangent = Matrix6::from_fn(|i, j| start.tangent[i][j]);
            let expected = Vector6::from(end.wrench);
            let error = |wrench: Vector6<f64>| (wrench - expected).fixed_rows::<3>(0).norm();
            by_rows.push(error(predict(&rows, &start, &dq)));
            by_tangent.push(error(Vector6::from(start.wrench) + tangent * dq));
        }
        let switched = by_rows.len();
        let [rows, tangent] = [by_rows, by_tangent].map(|mut errors| {
            errors.sort_by(f64::total_cmp);
            (errors[switched / 2], errors[switched - 1])
        });
        println!(
            "{what}: {switched} of 200 switch; median and worst of rows {:.1e} and {:.1e} N, of the tangent {:.1e} and {:.1e} N",
            rows.0, rows.1, tangent.0, tangent.1
        );
        assert!(switched >= 20);
        // A vertex that goes round a narrow rim is foreseen by neither.
        assert!(rows.0 < 0.3 * tangent.0 && rows.1 <= 1.1 * tangent.1);
    }
}
