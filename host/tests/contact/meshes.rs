//! Meshes as tools: a box against a rounded box, exact tangents, and what is not convex.

use super::bench::{Bench, at, contact, force, pose};
use super::jacobian::compare_jacobians;
use nalgebra::{Matrix6, UnitQuaternion, Vector3};
use std::path::PathBuf;
use std::sync::Arc;
use sutura_host::mesh::SurfaceFormat;
use sutura_host::step::{State, Status};
use sutura_host::tool::{ClosedMesh, Shape, Tool};

/// One of the files in tests/data, whose unit is `scale_to_m`, larger by `fillet_m` all around.
fn from_file(name: &str, scale_to_m: f64, fillet_m: f64) -> Shape {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../tests/data");
    let bytes = std::fs::read(path.join(name)).expect("the file");
    Shape::Mesh {
        mesh: Arc::new(ClosedMesh::read(SurfaceFormat::Stl, &bytes, scale_to_m).expect("closed")),
        fillet_m,
    }
}

/// A box and its core as a mesh of twelve triangles.
fn boxes() -> [Shape; 2] {
    let (size_m, fillet_m) = ([0.024, 0.03, 0.04], 0.004);
    let [x, y, z] = size_m.map(|size| size - 2.0 * fillet_m);
    let corner = |k: u32| {
        let side = |bit: u32| if k & bit == 0 { -0.5 } else { 0.5 };
        [x * side(1), y * side(2), fillet_m + z * (0.5 + side(4))]
    };
    let points: Vec<[f64; 3]> = (0..8).map(corner).collect();
    let squares = [
        [0, 2, 3, 1],
        [4, 5, 7, 6],
        [0, 1, 5, 4],
        [2, 6, 7, 3],
        [0, 4, 6, 2],
        [1, 3, 7, 5],
    ];
    let triangles = squares.map(|[a, b, c, d]| [[a, b, c], [a, c, d]]).concat();
    let mesh = ClosedMesh::new(&points, &triangles).expect("closed");
    let mesh = Shape::Mesh {
        mesh: Arc::new(mesh),
        fillet_m,
    };
    [Shape::RoundedBox { size_m, fillet_m }, mesh]
}

#[test]
fn a_mesh_of_a_box_feels_what_a_rounded_box_feels() {
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.12, -0.08, 0.4));
    let felt = boxes().map(|shape| {
        let tool = Tool {
            side: [0.6, 0.8, 0.0],
            ..Tool::new(shape, [0.0; 3])
        };
        let mut bench = Bench::slab(tool);
        let sample = pose(Vector3::new(0.0013, 0.0007, -0.003), turn);
        let (state, report) = bench.afresh(at(0.0, 0.0, 0.2), sample);
        bench.assert_balanced(&state, &[sample]);
        contact(&report)
    });
    let [exact, found] = &felt;
    assert!(
        exact.rows > 12 && exact.rows == found.rows,
        "{} rows",
        exact.rows
    );
    let (one, other) = (force(exact), force(found));
    assert!((one - other).norm() < 1e-9 * one.norm(), "{one} {other}");
    let [one, other] = [exact, found].map(|contact| Matrix6::from_fn(|i, j| contact.tangent[i][j]));
    assert!((one - other).norm() < 1e-9 * one.norm());
}

/// Few vertices, so that a switch of one is told from the rest.
#[test]
fn the_jacobian_of_a_mesh_is_exact_on_a_slab() {
    let shape = from_file("bracket.stl", 0.0006, 0.0025);
    let bench = Bench::slab(Tool::new(shape, [0.02, -0.01, -0.03]));
    compare_jacobians(bench, at(0.0, 0.0, 0.06), 8, |chance| {
        let [x, y, z] = chance.vector().into();
        let centre = Vector3::new(0.01 * x, 0.01 * y, 0.0025 - 0.0025 + 0.001 * z);
        let turn = UnitQuaternion::from_scaled_axis(chance.vector() * 0.25);
        (centre, turn)
    });
}

/// A ring that is pressed flat into the slab pushes what is in its hole inwards, and nothing is in the ring itself.
#[test]
fn a_ring_touches_on_its_inside() {
    let fillet_m = 0.003;
    let mut bench = Bench::slab(Tool::new(from_file("ring.stl", 0.001, fillet_m), [0.0; 3]));
    let mut state = State::new(&bench.model);
    let height = |depth_m: f64| at(0.0013, 0.0007, 0.006 + fillet_m - depth_m);
    bench.step(&mut state, at(0.0, 0.0, 0.05));
    let mut inwards = 0;
    for tenths in 0..=60 {
        let sample = height(1e-4 * f64::from(tenths));
        let report = bench.step(&mut state, sample);
        assert_eq!(report.status, Status::Ok, "{tenths}");
        if tenths % 20 != 0 {
            continue;
        }
        bench.assert_balanced(&state, &[sample]);
        inwards = 0;
        for (node, on_tissue) in state.contact_forces(&bench.model) {
            let [x, y, _] = bench.model.points_m()[node as usize];
            let (out, push) = (
                Vector3::new(x - 0.0013, y - 0.0007, 0.0),
                Vector3::from(on_tissue),
            );
            let is_inwards = push.dot(&out) < -1e-3 * push.norm() * out.norm();
            assert!(!is_inwards || out.norm() < 0.017, "{out} {push}");
            inwards += usize::from(is_inwards);
        }
    }
    assert!(inwards >= 4, "{inwards} vertices");
    let air = bench.step(&mut state, at(0.0, 0.0, 0.05));
    assert_eq!((air.status, air.rows), (Status::Ok, 0));
}

/// A step with a mesh makes no memory once the columns that it needs are there.
#[test]
fn a_step_with_a_mesh_allocates_nothing() {
    let mut bench = Bench::slab(Tool::new(from_file("bracket.stl", 0.001, 0.003), [0.0; 3]));
    let path = |tick: u32| at(0.002, 0.001, 0.006 - 1e-4 * f64::from(tick % 60));
    let mut state = State::new(&bench.model);
    for tick in 0..120 {
        bench.step(&mut state, path(tick));
    }
    let mut most = 0;
    let allocated = allocation_counter::measure(|| {
        for tick in 0..120 {
            most = most.max(bench.step(&mut state, path(tick)).rows);
        }
    });
    assert!(most > 10, "{most} rows");
    assert_eq!(allocated.count_total, 0, "{allocated:?}");
}
