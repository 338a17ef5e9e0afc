//! The tangent against perturbed full solves, each detecting contact afresh.

use super::bench::{ARCH, Bench, RADIUS, at, ball, contact, force, pose};
use nalgebra::{Matrix3, Matrix3x6, Matrix6, UnitQuaternion, Vector3};
use sutura_host::tool::{Tool, ToolSample};
use sutura_testkit::Random;

#[test]
fn the_tangent_under_the_middle_is_symmetric() {
    let mut bench = Bench::slab(ball([0.0; 3]));
    let (_, report) = bench.afresh(at(0.0, 0.0, 0.05), at(0.0, 0.0, RADIUS - 0.008));
    let contact = contact(&report);
    let k = contact.tangent;
    let normal = k[2][2];
    assert!(normal < 0.0);
    println!("lateral over normal stiffness {}", k[0][0] / normal);
    // The mesh is its own mirror image in x and in y, and x and y can be swapped.
    assert!((k[0][0] - k[1][1]).abs() < 1e-8 * normal.abs(), "{k:?}");
    for (i, j) in [(0, 1), (0, 2), (1, 2), (1, 0), (2, 0), (2, 1)] {
        assert!(
            k[i][j].abs() < 1e-8 * normal.abs(),
            "{i} {j}: {:?}",
            k[i][j]
        );
    }
    assert!(force(&contact).xy().norm() < 1e-10 * force(&contact).z);
}

/// Turns a pose by a small left (world-frame) increment.
fn turned(position: Vector3<f64>, rotation: UnitQuaternion<f64>, by: Vector3<f64>) -> ToolSample {
    pose(position, UnitQuaternion::from_scaled_axis(by) * rotation)
}

/// The Jacobian by central differences of fourth order over full solves, each from a new state; `None`
/// where one of them touches other vertices than the pose itself, or they lie on two sides of a kink.
fn by_differences(
    bench: &mut Bench,
    from: ToolSample,
    position: Vector3<f64>,
    rotation: UnitQuaternion<f64>,
) -> Option<Matrix6<f64>> {
    let mut touched_by = |sample: ToolSample| {
        let (state, report) = bench.afresh(from, sample);
        let mut touched: Vec<u32> = state
            .contact_forces(&bench.model)
            .map(|(node, _)| node)
            .collect();
        touched.sort_unstable();
        (touched, contact(&report).wrench)
    };
    let (touched, _) = touched_by(pose(position, rotation));
    let mut jacobian = Matrix6::zeros();
    // Step of each difference: [m] and [rad]. The fifth derivative costs h^4, large where a rim is
    // small, and round-off 1/h.
    let h = [8e-7, 4e-5];
    for axis in 0..6 {
        let step = h[axis / 3];
        let mut wrenches = [[0.0; 6]; 4];
        for (wrench, way) in wrenches.iter_mut().zip([-2.0, -1.0, 1.0, 2.0]) {
            let mut by = Vector3::zeros();
            by[axis % 3] = way * step;
            let sample = if axis < 3 {
                pose(position + by, rotation)
            } else {
                turned(position, rotation, by)
            };
            let (others, found) = touched_by(sample);
            if others != touched {
                return None; // the set of touched vertices switches here
            }
            *wrench = found;
        }
        let [mm, m, p, pp] = wrenches;
        // Curvature jumps where a vertex passes from a face to its rim: a switch, too.
        let slopes = (0..6).map(|row| ((pp[row] - p[row]).abs(), (m[row] - mm[row]).abs()));
        let (forward, back) = slopes.fold((0.0, 0.0), |(a, b): (f64, f64), (c, d)| {
            (a.max(c), b.max(d))
        });
        let largest = forward.max(back);
        if largest > 1e-12 && (forward - back).abs() > 0.03 * largest {
            return None;
        }
        for row in 0..6 {
            jacobian[(row, axis)] = (8.0 * (p[row] - m[row]) - (pp[row] - mm[row])) / (12.0 * step);
        }
    }
    Some(jacobian)
}

/// Compares the Jacobian with differences at 24 poses that `draw` gives as the shape's centre and the
/// grip's rotation; somewhere at least `expected_rows` vertices must be touched.
pub fn compare_jacobians(
    mut bench: Bench,
    from: ToolSample,
    expected_rows: u32,
    mut draw: impl FnMut(&mut Random) -> (Vector3<f64>, UnitQuaternion<f64>),
) {
    let mut random = Random::new(42);
    let (mut poses, mut worst, mut fewest, mut most, mut switches) = (0, 0.0f64, u32::MAX, 0, 0);
    while poses < 24 {
        // The drawn position is the shape's centre; the grip is where the offset puts it.
        let (centre, rotation) = draw(&mut random);
        let arm = rotation * Vector3::from(bench.model.tools()[0].1.offset_m);
        let position = centre - arm;
        let Some(expected) = by_differences(&mut bench, from, position, rotation) else {
            switches += 1;
            assert!(switches < 100, "no pose is away from a switch");
            continue;
        };
        let sample = pose(position, rotation);
        let (state, report) = bench.afresh(from, sample);
        bench.assert_balanced(&state, &[sample]);
        let found = contact(&report);
        let tangent = Matrix6::from_fn(|i, j| found.tangent[i][j]);
        // Translations and rotations have different units: each block against its own size.
        for (i, j) in [(0, 0), (0, 3), (3, 0), (3, 3)] {
            let scale = expected.fixed_view::<3, 3>(i, j).norm();
            let difference = tangent.fixed_view::<3, 3>(i, j) - expected.fixed_view::<3, 3>(i, j);
            // A block that is zero but for round-off is judged by the others.
            let size = tangent.fixed_view::<3, 3>(0, 0).norm()
                * bench.model.tools()[0].1.radius_m().powi((i + j) as i32 / 3);
            if scale > 1e-9 * size {
                worst = worst.max(difference.norm() / scale);
                assert!(
                    difference.norm() <= 1e-6 * scale,
                    "{:e} in block {i} {j} at {position} with {} rows",
                    difference.norm() / scale,
                    found.rows
                );
            } else {
                assert!(difference.norm() < 1e-9 * size);
            }
        }
        // Skew part: -1/2 [m]x in the rotations, nothing elsewhere.
        let skew = (tangent - tangent.transpose()) * 0.5;
        let moment = Vector3::from_column_slice(&found.wrench[3..]);
        let rest = skew.fixed_view::<3, 3>(3, 3) + moment.cross_matrix() * 0.5;
        assert!(
            rest.norm() < 1e-12 * (1.0 + moment.norm()),
            "skew part off by {rest}"
        );
        assert!(skew.fixed_view::<6, 3>(0, 0).norm() < 1e-9 * tangent.norm());
        poses += 1;
        fewest = fewest.min(found.rows);
        most = most.max(found.rows);
    }
    println!(
        "{poses} poses, {fewest} to {most} rows, {switches} drawn at a switch; largest error {worst:.1e}"
    );
    assert!(most >= expected_rows, "at most {most} vertices are touched");
}

#[test]
fn the_jacobian_is_exact_on_a_slab() {
    compare_jacobians(
        Bench::slab(ball([0.0; 3])),
        at(0.0, 0.0, 0.05),
        14,
        |random| {
            let [x, y, z] = random.vector().into();
            (
                Vector3::new(0.012 * x, 0.012 * y, RADIUS - 0.006 + 0.003 * z),
                UnitQuaternion::identity(),
            )
        },
    );
}

#[test]
fn the_jacobian_is_exact_with_the_sphere_off_the_grip() {
    let offset = [0.02, -0.01, -0.05];
    compare_jacobians(Bench::slab(ball(offset)), at(0.0, 0.0, 0.2), 14, |random| {
        let [x, y, z] = random.vector().into();
        let centre = Vector3::new(0.012 * x, 0.012 * y, RADIUS - 0.006 + 0.003 * z);
        (
            centre,
            UnitQuaternion::from_scaled_axis(random.vector() * 0.8),
        )
    });
}

#[test]
fn the_jacobian_is_exact_on_an_arch() {
    let offset = [0.0, 0.03, 0.05];
    compare_jacobians(
        Bench::arch(Tool::sphere(0.018, offset)),
        at(0.0, 0.0, 0.2),
        12,
        |random| {
            let [angle, y, depth] = random.vector().into();
            let out = Vector3::new((0.3 * angle).sin(), 0.0, (0.3 * angle).cos());
            let height = ARCH + 0.018 - 0.006 + 0.003 * depth;
            let centre = out * height + Vector3::new(0.0, 0.012 * y, -ARCH);
            (
                centre,
                UnitQuaternion::from_scaled_axis(random.vector() * 0.4),
            )
        },
    );
}

#[test]
fn the_jacobian_is_exact_on_an_unstructured_cylinder() {
    let offset = [0.0, 0.01, 0.04];
    compare_jacobians(
        Bench::cylinder(Tool::sphere(0.02, offset)),
        at(0.2, 0.0, 0.06),
        8,
        |random| {
            let [angle, z, depth] = random.vector().into();
            let out = Vector3::new((0.5 * angle).cos(), (0.5 * angle).sin(), 0.0);
            let centre =
                out * (0.03 + 0.02 - 0.005 + 0.002 * depth) + Vector3::z() * (0.06 + 0.015 * z);
            (
                centre,
                UnitQuaternion::from_scaled_axis(random.vector() * 0.4),
            )
        },
    );
}

/// A sphere's normals do not turn with it: about a grip aside of it, wrench and tangent are those at its
/// centre, moved by the arm r: `J' T J + blockdiag(0, [F]x [r]x)` with `J = [I, -[r]x]`.
#[test]
fn a_sphere_feels_at_the_grip_what_it_feels_at_its_centre() {
    let offset = [0.02, -0.01, -0.05];
    let centre = Vector3::new(0.003, -0.002, RADIUS - 0.006);
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.3, -0.5, 0.4));
    let arm = turn * Vector3::from(offset);
    let mut bench = Bench::slab(ball([0.0; 3]));
    let (_, report) = bench.afresh(at(0.0, 0.0, 0.05), pose(centre, turn));
    let there = contact(&report);
    let mut bench = Bench::slab(ball(offset));
    let (_, report) = bench.afresh(at(0.0, 0.0, 0.2), pose(centre - arm, turn));
    let here = contact(&report);

    let push = force(&there);
    let stiffness = Matrix3::from_fn(|i, j| there.tangent[i][j]);
    let mut rigid = Matrix3x6::zeros();
    rigid.fixed_view_mut::<3, 3>(0, 0).fill_with_identity();
    rigid
        .fixed_view_mut::<3, 3>(0, 3)
        .copy_from(&-arm.cross_matrix());
    let mut expected = rigid.transpose() * stiffness * rigid;
    let mut corner = expected.fixed_view_mut::<3, 3>(3, 3);
    corner += push.cross_matrix() * arm.cross_matrix();
    let found = Matrix6::from_fn(|i, j| here.tangent[i][j]);
    assert!((found - expected).norm() < 1e-9 * expected.norm());
    let moment = Vector3::from_column_slice(&here.wrench[3..]);
    assert!((moment - arm.cross(&push)).norm() < 1e-9 * moment.norm());
    let alone = Matrix6::from_fn(|i, j| there.tangent[i][j]);
    let turning = alone.fixed_view::<6, 3>(0, 3).norm();
    assert!(
        turning < 1e-9 * stiffness.norm(),
        "a turn about the centre does nothing"
    );
}
