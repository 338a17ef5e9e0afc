//! Rows on anchors: against independent solutions, against whole solves, and their contracts.

use std::sync::Arc;
use sutura_host::anchors::circling::Circling;
use sutura_host::anchors::{
    AnchorPoint, AnchorSettings, AnchorSolver, AnchorStatus, AnchorStep, PointConstraint,
};
use sutura_host::fem::{Anchor, CorotationalTissue, Handle, LinearTissue, Loads, Material, Policy};
use sutura_host::mesh::{TetMesh, read_msh, slab};
use sutura_host::rows::RowKind;

const SOFT: Material = Material {
    youngs_modulus_pa: 15e3,
    poisson_ratio: 0.45,
};
const RATE_HZ: f64 = 1000.0;

fn data(name: &str) -> String {
    let path = format!("{}/../tests/data/{name}", env!("CARGO_MANIFEST_DIR"));
    std::fs::read_to_string(path).expect("the data are there")
}

/// A soft block glued to its bottom.
fn block() -> (TetMesh, Vec<u32>) {
    let mesh = slab([0.06, 0.06, 0.03], [6, 6, 3]).expect("a slab");
    let bottom = (0..49).collect();
    (mesh, bottom)
}

fn boundary(mesh: &TetMesh, tissue: &LinearTissue) -> Vec<u32> {
    let vertices = mesh.surface().vertices;
    vertices
        .into_iter()
        .filter(|node| !tissue.is_fixed(*node))
        .collect()
}

fn plenty() -> AnchorSettings {
    AnchorSettings {
        vertices_per_step: usize::MAX,
        ..AnchorSettings::default()
    }
}

fn linear(mesh: &TetMesh, fixed: &[u32], settings: AnchorSettings) -> AnchorSolver {
    let tissue = Arc::new(LinearTissue::new(mesh, SOFT, fixed).expect("tissue"));
    let reached = boundary(mesh, &tissue);
    AnchorSolver::linear(tissue, &reached, settings).expect("a solver")
}

/// What a step's rows ask for, as handles of a whole solve: three rows an anchor, orthonormal.
fn handles(points: &[AnchorPoint], rows: &[PointConstraint]) -> Vec<Handle> {
    let target = |anchor: usize| {
        let mut target = [0.0; 3];
        for row in &rows[3 * anchor..3 * anchor + 3] {
            for (target, direction) in target.iter_mut().zip(row.direction) {
                *target += direction * row.target_m;
            }
        }
        target
    };
    let numbered = points.iter().enumerate();
    numbered
        .map(|(anchor, point)| Handle {
            anchor: Anchor {
                vertices: point.nodes[..3].to_vec(),
                weights: point.weights[..3].to_vec(),
            },
            target_displacement_m: target(anchor),
        })
        .collect()
}

/// Force on the tissue of three rows: -C' lambda.
fn force(rows: &[PointConstraint], lambda: &[f64], anchor: usize) -> [f64; 3] {
    let mut force = [0.0; 3];
    for row in 3 * anchor..3 * anchor + 3 {
        for (force, direction) in force.iter_mut().zip(rows[row].direction) {
            *force -= direction * lambda[row];
        }
    }
    force
}

fn largest(values: impl Iterator<Item = f64>) -> f64 {
    values.fold(0.0, |most, value| most.max(value.abs()))
}

/// Same discretisation, other solver: displacement and forces of the 20 handles on two tubes.
#[test]
fn rows_agree_with_an_independent_solver() {
    let case: serde_json::Value =
        serde_json::from_str(&data("linear-tubes-20-handles.json")).expect("JSON");
    let number = |value: &serde_json::Value| value.as_f64().expect("a number");
    let list = |value: &serde_json::Value| -> Vec<f64> {
        value
            .as_array()
            .expect("a list")
            .iter()
            .map(number)
            .collect()
    };
    let mesh = read_msh(&data("tubes_younes.msh"), number(&case["scale_to_m"])).expect("a mesh");
    let fixed: Vec<u32> = list(&case["fixed_nodes"])
        .iter()
        .map(|n| *n as u32)
        .collect();
    let material = Material {
        youngs_modulus_pa: number(&case["material"]["youngs_modulus_pa"]),
        poisson_ratio: number(&case["material"]["poisson_ratio"]),
    };
    let tissue = Arc::new(LinearTissue::new(&mesh, material, &fixed).expect("tissue"));
    let reached = boundary(&mesh, &tissue);
    let mut solver = AnchorSolver::linear(tissue, &reached, plenty()).expect("a solver");

    let (mut points, mut rows) = (Vec::new(), Vec::new());
    // Directions that are not the axes': the columns of a rotation.
    let frame = [[0.48, 0.6, 0.64], [-0.8, 0.0, 0.6], [0.36, -0.8, 0.48]];
    for (anchor, handle) in case["handles"]
        .as_array()
        .expect("handles")
        .iter()
        .enumerate()
    {
        let (nodes, weights) = (list(&handle["vertices"]), list(&handle["barycentric"]));
        let target = list(&handle["target_displacement_m"]);
        points.push(AnchorPoint {
            nodes: [nodes[0] as u32, nodes[1] as u32, nodes[2] as u32, 0],
            weights: [weights[0], weights[1], weights[2], 0.0],
        });
        for direction in frame {
            rows.push(PointConstraint {
                id: rows.len() as u64,
                anchor: anchor as u32,
                kind: RowKind::Equality,
                direction,
                target_m: (0..3).map(|i| direction[i] * target[i]).sum(),
            });
        }
    }
    let report = solver.step(&points, &rows, true);
    assert_eq!(report.status, AnchorStatus::Ok, "{report:?}");

    let expected = case["force_on_tissue_n"].as_array().expect("forces");
    let scale = largest(expected.iter().flat_map(&list));
    for (anchor, expected) in expected.iter().enumerate() {
        let found = force(&rows, solver.lambda(), anchor);
        for (found, expected) in found.iter().zip(list(expected)) {
            assert!(
                (found - expected).abs() < 1e-6 * scale,
                "{found} {expected}"
            );
        }
    }
    let expected = case["displacement_m"].as_array().expect("displacements");
    let scale = largest(expected.iter().flat_map(&list));
    for (node, expected) in expected.iter().enumerate() {
        let found = solver.displacement_m(node as u32);
        for (found, expected) in found.iter().zip(list(expected)) {
            assert!(
                (found - expected).abs() < 1e-6 * scale,
                "{found} {expected}"
            );
        }
    }
}

/// Steps whose anchors change faces and whose directions turn, against whole solves from scratch.
#[test]
fn every_step_is_the_whole_solve() {
    let (mesh, fixed) = block();
    let tissue = LinearTissue::new(&mesh, SOFT, &fixed).expect("tissue");
    let mut solver = linear(&mesh, &fixed, plenty());
    let mut workload = Circling::new(&mesh, &fixed, 8, 1.0).expect("room for 8 anchors");
    let mut seen = std::collections::BTreeSet::new();
    for step in 0..300 {
        let (points, rows) = workload.at(step, RATE_HZ);
        let (points, rows) = (points.to_vec(), rows.to_vec());
        let report = solver.step(&points, &rows, true);
        assert_eq!(report.status, AnchorStatus::Ok);
        seen.extend(points.iter().map(|point| point.nodes));
        if step % 60 != 59 {
            continue;
        }
        let loads = Loads {
            handles: handles(&points, &rows),
            ..Loads::default()
        };
        let whole = tissue.solve(&loads).expect("a solution");
        let scale = largest(whole.handle_force_n.iter().flatten().copied());
        for (anchor, expected) in whole.handle_force_n.iter().enumerate() {
            let found = force(&rows, solver.lambda(), anchor);
            assert!((0..3).all(|i| (found[i] - expected[i]).abs() < 1e-9 * scale));
        }
        let scale = largest(whole.displacement_m.iter().flatten().copied());
        for (node, expected) in (0u32..).zip(&whole.displacement_m) {
            let found = solver.displacement_m(node);
            assert!((0..3).all(|i| (found[i] - expected[i]).abs() < 1e-9 * scale));
        }
    }
    assert!(seen.len() > 8, "no anchor ever changed its face");
}

fn forces_after(solver: &mut AnchorSolver, steps: u64, each: impl Fn(&AnchorStep)) -> Vec<f64> {
    let (mesh, fixed) = block();
    let mut workload = Circling::new(&mesh, &fixed, 8, 1.0).expect("room for 8 anchors");
    for step in 0..steps {
        let (points, rows) = workload.at(step, RATE_HZ);
        // Once more for every time that it waits.
        while {
            let report = solver.step(points, rows, false);
            each(&report);
            report.status == AnchorStatus::Waiting
        } {}
    }
    solver.lambda().to_vec()
}

/// Few columns a step, a cache that must forget, or all at once: the same bits.
#[test]
fn neither_budget_nor_threads_nor_memory_change_a_bit() {
    let (mesh, fixed) = block();
    let expected = forces_after(&mut linear(&mesh, &fixed, plenty()), 40, |report| {
        assert_eq!(report.status, AnchorStatus::Ok);
    });
    assert!(expected.iter().any(|lambda| lambda.abs() > 1e-3));

    let one = AnchorSettings {
        vertices_per_step: 1,
        ..AnchorSettings::default()
    };
    let waited = std::cell::Cell::new(0);
    let mut slow = linear(&mesh, &fixed, one);
    let found = forces_after(&mut slow, 40, |report| {
        assert!(report.vertices_computed <= 1);
        waited.set(waited.get() + u32::from(report.status == AnchorStatus::Waiting));
    });
    assert!(waited.get() >= 8, "it waited {} times", waited.get());
    assert_eq!(found, expected);

    let tissue = Arc::new(LinearTissue::new(&mesh, SOFT, &fixed).expect("tissue"));
    let reached = boundary(&mesh, &tissue);
    let mut served = AnchorSolver::linear(tissue, &reached, plenty()).expect("a solver");
    served.start_worker().expect("a thread");
    let found = forces_after(&mut served, 40, |report| {
        assert_eq!(report.vertices_computed, 0, "the worker does that");
    });
    assert_eq!(found, expected, "on another thread");

    let small = AnchorSettings {
        memory_bytes: 0,
        most_anchors: 8,
        most_rows: 24,
        ..plenty()
    };
    let mut forgetful = linear(&mesh, &fixed, small);
    let found = forces_after(&mut forgetful, 40, |_| {});
    assert_eq!(found, expected);
    // What 8 anchors may name, before and after a change of faces.
    assert!(forgetful.cached_vertices() <= 64);
}

#[test]
fn a_warm_step_allocates_nothing() {
    let (mesh, fixed) = block();
    let mut workload = Circling::new(&mesh, &fixed, 8, 1.0).expect("room for 8 anchors");
    let tissue = LinearTissue::new(&mesh, SOFT, &fixed).expect("tissue");
    let reached = boundary(&mesh, &tissue);
    let policy = Policy {
        refactor_every: 5,
        ..Policy::default()
    };
    let turning = Arc::new(CorotationalTissue::new(&mesh, SOFT, &fixed, policy).expect("tissue"));
    let solvers = [
        AnchorSolver::linear(Arc::new(tissue), &reached, plenty()).expect("a solver"),
        AnchorSolver::corotational(turning, &reached, plenty()).expect("a solver"),
    ];
    for mut solver in solvers {
        for step in 0..25 {
            let (points, rows) = workload.at(step, RATE_HZ);
            assert_eq!(solver.step(points, rows, true).status, AnchorStatus::Ok);
        }
        let allocated = allocation_counter::measure(|| {
            for step in 25..60 {
                let (points, rows) = workload.at(step, RATE_HZ);
                solver.step(points, rows, true);
            }
        });
        assert_eq!(allocated.count_total, 0, "{allocated:?}");
    }
}

/// With enough passes corotational rows end where Newton's method on the whole tissue does.
#[test]
fn corotational_rows_converge_to_the_whole_solve() {
    let (mesh, fixed) = block();
    let linear = LinearTissue::new(&mesh, SOFT, &fixed).expect("tissue");
    let reached = boundary(&mesh, &linear);
    let tissue =
        Arc::new(CorotationalTissue::new(&mesh, SOFT, &fixed, Policy::default()).expect("tissue"));
    let settings = AnchorSettings {
        passes: 60,
        tolerance: 1e-10,
        ..plenty()
    };
    let mut solver =
        AnchorSolver::corotational(tissue.clone(), &reached, settings).expect("a solver");
    let mut workload = Circling::new(&mesh, &fixed, 8, 1.0).expect("room for 8 anchors");
    // 50 ms a step: 16 degrees of the circle each.
    for step in 0..10 {
        let (points, rows) = workload.at(step, 20.0);
        let (points, rows) = (points.to_vec(), rows.to_vec());
        let report = solver.step(&points, &rows, true);
        assert_eq!(report.status, AnchorStatus::Ok, "{report:?}");
        let loads = Loads {
            handles: handles(&points, &rows),
            ..Loads::default()
        };
        let whole = tissue.solve(&loads).expect("a solution");
        let scale = largest(whole.displacement_m.iter().flatten().copied());
        let worst = (0u32..)
            .zip(&whole.displacement_m)
            .flat_map(|(node, expected)| {
                let found = solver.displacement_m(node);
                (0..3).map(move |i| found[i] - expected[i])
            });
        let worst = largest(worst);
        assert!(
            worst <= 1e-6 * scale,
            "step {step}: {worst} of {scale}, {report:?}"
        );
    }
}

/// A row that may only push: the anchor under it moves away freely, and is held against it.
#[test]
fn one_sided_rows_push_and_never_pull() {
    let (mesh, fixed) = block();
    let mut solver = linear(&mesh, &fixed, plenty());
    let top = (mesh.points_m().len() - 25) as u32;
    let points = [AnchorPoint {
        nodes: [top, 0, 0, 0],
        weights: [1.0, 0.0, 0.0, 0.0],
    }];
    let mut row = PointConstraint {
        id: 7,
        anchor: 0,
        kind: RowKind::Inequality,
        direction: [0.0, 0.0, 1.0],
        target_m: 0.001,
    };
    assert_eq!(solver.step(&points, &[row], true).status, AnchorStatus::Ok);
    assert_eq!(solver.lambda(), [0.0], "nothing holds it below its limit");
    row.target_m = -0.001;
    assert_eq!(solver.step(&points, &[row], true).status, AnchorStatus::Ok);
    assert!(solver.lambda()[0] > 0.0);
    // Pressed down to its limit: the force on the tissue is -C' lambda.
    assert!((solver.displacement_m(top)[2] + 0.001).abs() < 1e-12);
}

#[test]
fn rows_that_make_no_sense_are_refused() {
    let (mesh, fixed) = block();
    let mut solver = linear(&mesh, &fixed, plenty());
    let mut workload = Circling::new(&mesh, &fixed, 8, 1.0).expect("room for 8 anchors");
    let (points, rows) = workload.at(100, RATE_HZ);
    assert_eq!(solver.step(points, rows, false).status, AnchorStatus::Ok);
    let good = solver.lambda().to_vec();

    let mut refuse = |points: &[AnchorPoint], rows: &[PointConstraint]| {
        assert_eq!(
            solver.step(points, rows, false).status,
            AnchorStatus::Malformed
        );
        assert_eq!(solver.lambda(), good, "the last forces stay");
    };
    let reversed: Vec<PointConstraint> = rows.iter().rev().copied().collect();
    refuse(points, &reversed);
    refuse(&points[..4], rows);
    let mut far = points.to_vec();
    far[3].nodes[1] = 1_000_000;
    refuse(&far, rows);
    // An inner node: not among those that were said to be reached.
    let inner = mesh.surface().vertices;
    let inner = (0..mesh.points_m().len() as u32).find(|node| !inner.contains(node));
    far[3].nodes[1] = inner.expect("an inner node");
    refuse(&far, rows);
    let many = vec![points[0]; 51];
    refuse(&many, &[]);
}
