//! Rows on hyperelastic tissue: against the reference's own balance, linear tissue, and itself turned.

use nalgebra::{Rotation3, Vector3};
use std::sync::Arc;
use sutura_host::anchors::{
    AnchorPoint, AnchorSettings, AnchorSolver, AnchorStatus, AnchorStep, PointConstraint,
};
use sutura_host::fem::{
    Anchor, Handle, HyperelasticTissue, Hyperelasticity, LinearTissue, Loads, Material, NodeLoad,
    Policy,
};
use sutura_host::mesh::{TetMesh, slab};
use sutura_host::model::{Model, Passes};
use sutura_host::needle::NeedleSettings;
use sutura_host::rows::RowKind;
use sutura_host::step::{State, Status, StepOptions, Workspace, step};
use sutura_models::hyperelastic::{Cells, Hyperelastic, Settings};
use sutura_models::law::Law;
use sutura_models::{BoundaryConditions, Outcome, Tissue};

const SOFT: Material = Material {
    youngs_modulus_pa: 15e3,
    poisson_ratio: 0.45,
};
/// With a tangent that is factored in every pass.
const FRESH: Policy = Policy {
    refactor_rotation_rad: 0.0,
    refactor_every: 0,
    cg_iterations: 0,
    cg_tolerance: 0.0,
};
/// Nodes of the block's top that are pulled, each its own way: up to a sixth of its thickness.
const PULLED: [(u32, [f64; 3]); 4] = [
    (160, [0.002, 0.001, 0.004]),
    (163, [-0.001, 0.003, 0.005]),
    (170, [0.0, 0.002, -0.003]),
    (185, [0.003, -0.002, 0.002]),
];

/// A soft block glued to its bottom: the first 49 nodes.
fn block() -> TetMesh {
    slab([0.06, 0.06, 0.03], [6, 6, 3]).expect("a slab")
}

fn bottom() -> Vec<u32> {
    (0..49).collect()
}

fn free(mesh: &TetMesh) -> Vec<u32> {
    (49..mesh.points_m().len() as u32).collect()
}

fn converged() -> AnchorSettings {
    AnchorSettings {
        vertices_per_step: usize::MAX,
        passes: 100,
        tolerance: 1e-12,
        ..AnchorSettings::default()
    }
}

fn tissue(mesh: &TetMesh, cells: Cells, policy: Policy) -> Arc<HyperelasticTissue> {
    let laws = [Law::neo_hookean(SOFT)];
    let substance = Hyperelasticity { laws: &laws, cells };
    Arc::new(HyperelasticTissue::new(mesh, &substance, &bottom(), policy).expect("tissue"))
}

fn solver(mesh: &TetMesh, cells: Cells, policy: Policy, settings: AnchorSettings) -> AnchorSolver {
    let tissue = tissue(mesh, cells, policy);
    AnchorSolver::hyperelastic(tissue, &free(mesh), settings).expect("a solver")
}

/// Three equality rows on each node, along the axes turned by `turn`, that move it by `share` of its way.
fn pulls(share: f64, turn: &Rotation3<f64>) -> (Vec<AnchorPoint>, Vec<PointConstraint>) {
    let points = PULLED.map(|(node, _)| AnchorPoint {
        nodes: [node; 4],
        weights: [1.0, 0.0, 0.0, 0.0],
    });
    let mut rows = Vec::new();
    for (anchor, (_, way)) in (0u32..).zip(PULLED) {
        for (axis, target) in way.into_iter().enumerate() {
            rows.push(PointConstraint {
                id: rows.len() as u64,
                anchor,
                kind: RowKind::Equality,
                direction: (turn * Vector3::ith(axis, 1.0)).into(),
                target_m: share * target,
            });
        }
    }
    (points.to_vec(), rows)
}

fn pull(solver: &mut AnchorSolver, share: f64, turn: &Rotation3<f64>) -> AnchorStep {
    let (points, rows) = pulls(share, turn);
    let report = solver.step(&points, &rows, true);
    assert_eq!(report.status, AnchorStatus::Ok, "{report:?}");
    report
}

/// Largest difference over the largest of `expected`.
fn off(found: impl Iterator<Item = [f64; 3]>, expected: impl Iterator<Item = [f64; 3]>) -> f64 {
    let (mut most, mut size) = (0.0f64, 0.0f64);
    for (found, expected) in found.zip(expected) {
        most = most.max((Vector3::from(found) - Vector3::from(expected)).norm());
        size = size.max(Vector3::from(expected).norm());
    }
    most / size
}

fn displacements(solver: &AnchorSolver, mesh: &TetMesh) -> Vec<[f64; 3]> {
    let nodes = free(mesh);
    nodes
        .into_iter()
        .map(|node| solver.displacement_m(node))
        .collect()
}

fn forces(solver: &AnchorSolver) -> Vec<[f64; 3]> {
    // Along the axes, in the order of the rows.
    let rows = solver.lambda().chunks_exact(3);
    rows.map(|lambda| [-lambda[0], -lambda[1], -lambda[2]])
        .collect()
}

/// The reference's own solver with the pulled nodes held where they go, under forces on all nodes (n x 3) or none.
fn reference(mesh: &TetMesh, cells: Cells, force_n: &[[f64; 3]]) -> Hyperelastic {
    let settings = Settings {
        cells,
        tolerance: 1e-11,
        ..Settings::default()
    };
    let laws = [Law::neo_hookean(SOFT)];
    let mut reference = Hyperelastic::new(mesh, &laws, settings).expect("the reference");
    let fixed = bottom().into_iter().map(|node| (node, [0.0; 3]));
    let held: Vec<(u32, [f64; 3])> = fixed.chain(PULLED).collect();
    let drive = BoundaryConditions {
        held: &held,
        force_n,
    };
    let done = reference.step(&drive, 0.0);
    assert_eq!(done.outcome, Outcome::Converged);
    reference
}

/// Where the reference's own solver has the same nodes, and what it holds them with.
#[test]
fn passes_converge_to_the_references_balance() {
    let mesh = block();
    for cells in [Cells::Linear, Cells::Averaged] {
        let reference = reference(&mesh, cells, &[]);
        let expected: Vec<[f64; 3]> = free(&mesh)
            .into_iter()
            .map(|node| {
                let (x, rest) = (
                    reference.positions_m()[node as usize],
                    mesh.points_m()[node as usize],
                );
                [0, 1, 2].map(|axis| x[axis] - rest[axis])
            })
            .collect();
        let held_with = &reference.reactions_n()[49..];
        for (policy, most) in [(FRESH, 10), (Policy::default(), 60)] {
            let mut solver = solver(&mesh, cells, policy, converged());
            let report = pull(&mut solver, 1.0, &Rotation3::identity());
            let u = off(
                displacements(&solver, &mesh).into_iter(),
                expected.iter().copied(),
            );
            let f = off(forces(&solver).into_iter(), held_with.iter().copied());
            println!(
                "{cells:?}, {} passes: displacement {u:.1e}, forces {f:.1e}",
                report.passes
            );
            assert!(u < 1e-6 && f < 1e-6, "{cells:?}: {u:e} {f:e}");
            assert!(report.passes <= most, "{cells:?}: {report:?}");
        }
    }
}

/// With a fresh factor each pass squares what is out of balance; with a stale one it falls by a share.
#[test]
fn passes_converge_quadratically_with_fresh_factors() {
    let mesh = block();
    let settings = AnchorSettings {
        passes: 1,
        ..converged()
    };
    let mut solver = solver(&mesh, Cells::Linear, FRESH, settings);
    let residuals: Vec<f64> = (0..9)
        .map(|_| {
            let report = pull(&mut solver, 1.0, &Rotation3::identity());
            report.linearisation.expect("one").residual_n
        })
        .collect();
    println!("{residuals:?}");
    // The first pass has no forces yet, the second those of the linear guess.
    let size = solver.lambda().iter().fold(0.0f64, |m, l| m.max(l.abs()));
    let share: Vec<f64> = residuals[1..].iter().map(|r| r / size).collect();
    let squares = share
        .windows(2)
        .filter(|two| two[0] < 0.1 && two[1] > 1e-13)
        .map(|two| two[1] / (two[0] * two[0]))
        .collect::<Vec<_>>();
    assert!(squares.len() >= 2, "{share:?}");
    assert!(squares.iter().all(|c| *c < 30.0), "{share:?}: {squares:?}");
}

/// What sets it apart from linear tissue falls with the square of the pull: relative to it, linearly.
#[test]
fn small_strains_are_linear_tissues() {
    let mesh = block();
    let linear = Arc::new(LinearTissue::new(&mesh, SOFT, &bottom()).expect("tissue"));
    let mut linear = AnchorSolver::linear(linear, &free(&mesh), converged()).expect("a solver");
    let errors = [1e-2, 5e-3, 2.5e-3].map(|share| {
        let mut own = solver(&mesh, Cells::Linear, FRESH, converged());
        pull(&mut own, share, &Rotation3::identity());
        pull(&mut linear, share, &Rotation3::identity());
        let u = off(
            displacements(&own, &mesh).into_iter(),
            displacements(&linear, &mesh).into_iter(),
        );
        let f = off(forces(&own).into_iter(), forces(&linear).into_iter());
        [u, f]
    });
    println!("{errors:?}");
    for kind in 0..2 {
        assert!(
            errors[0][kind] < 0.05 && errors[0][kind] > 1e-5,
            "{errors:?}"
        );
        for two in errors.windows(2) {
            let order = (two[0][kind] / two[1][kind]).log2();
            assert!((order - 1.0).abs() < 0.1, "order {order}: {errors:?}");
        }
    }
}

/// Mesh and rows turned together: the same multipliers, the displacement turned.
#[test]
fn a_turned_world_has_the_same_forces() {
    let mesh = block();
    let turn = Rotation3::from_euler_angles(0.7, -1.9, 2.6);
    let points = mesh.points_m().iter();
    let turned = points.map(|p| (turn * Vector3::from(*p)).into()).collect();
    let turned = TetMesh::new(turned, mesh.cells().to_vec()).expect("a mesh");
    for cells in [Cells::Linear, Cells::Averaged] {
        let mut own = solver(&mesh, cells, Policy::default(), converged());
        let mut other = solver(&turned, cells, Policy::default(), converged());
        for share in [0.3, 1.0, 0.6] {
            pull(&mut own, share, &Rotation3::identity());
            pull(&mut other, share, &turn);
            let f = off(forces(&other).into_iter(), forces(&own).into_iter());
            let back = displacements(&other, &turned).into_iter();
            let back = back.map(|u| (turn.inverse() * Vector3::from(u)).into());
            let u = off(back, displacements(&own, &mesh).into_iter());
            println!("{cells:?} {share}: forces {f:.1e}, displacement {u:.1e}");
            assert!(f < 1e-8 && u < 1e-8, "{f:e} {u:e}");
        }
    }
}

/// A press beyond what one pass can follow ends with no cell inside out, and is there after some more.
#[test]
fn a_press_that_would_invert_cells_is_followed_in_parts() {
    let mesh = block();
    let settings = AnchorSettings {
        passes: 1,
        ..converged()
    };
    // One node of the top, through most of the slab of 30 mm.
    for depth_m in [0.018, 0.021, 0.024] {
        let mut solver = solver(&mesh, Cells::Linear, Policy::default(), settings);
        let (points, mut rows) = pulls(1.0, &Rotation3::identity());
        rows.truncate(3);
        for (row, target) in rows.iter_mut().zip([0.0, 0.0, -depth_m]) {
            row.target_m = target;
        }
        let mut statuses = Vec::new();
        for _ in 0..60 {
            statuses.push(solver.step(&points[..1], &rows, true).status);
            for cell in mesh.cells() {
                let volume = volume(&mesh, *cell, &solver);
                assert!(volume > 0.0, "{cell:?}: {volume}");
            }
        }
        let parts = statuses
            .iter()
            .filter(|status| **status == AnchorStatus::NotSolved)
            .count();
        println!("{depth_m} m: {parts} passes in part");
        assert!((1..20).contains(&parts), "{statuses:?}");
        assert_eq!(statuses.last(), Some(&AnchorStatus::Ok), "{statuses:?}");
        let reached = solver.displacement_m(PULLED[0].0);
        assert!((reached[2] + depth_m).abs() < 1e-9, "{reached:?}");
        let report = solver.step(&points[..1], &rows, false);
        let left = report.linearisation.expect("one").residual_n;
        assert!(left < 1e-6, "{left} N out of balance");
    }
}

/// Six times the volume of a cell where it is \[m^3\].
fn volume(mesh: &TetMesh, cell: [u32; 4], solver: &AnchorSolver) -> f64 {
    let at = cell.map(|node| {
        let u = Vector3::from(solver.displacement_m(node));
        Vector3::from(mesh.points_m()[node as usize]) + u
    });
    let edges = [at[1] - at[0], at[2] - at[0], at[3] - at[0]];
    edges[0].cross(&edges[1]).dot(&edges[2])
}

/// Loads that are there from the beginning: the model rests where the reference does, and knows its energy.
#[test]
fn a_model_rests_under_its_loads() {
    let mesh = block();
    let laws = [Law::neo_hookean(SOFT)];
    let substance = Hyperelasticity {
        laws: &laws,
        cells: Cells::Linear,
    };
    let loads = Loads {
        forces: PULLED
            .map(|(node, way)| NodeLoad {
                node,
                force_n: way.map(|x| 50.0 * x),
            })
            .to_vec(),
        ..Loads::default()
    };
    let model = Model::hyperelastic(
        &mesh,
        &substance,
        &bottom(),
        loads,
        &[],
        Policy::default(),
        Passes::default(),
    )
    .expect("a model");
    let rest = model.equilibrium(&State::new(&model)).expect("a balance");
    assert!(rest.residual < 1e-9, "{}", rest.residual);
    let most = rest.displacement_m.iter().flatten();
    assert!(most.fold(0.0f64, |m, u| m.max(u.abs())) > 1e-3);
}

/// Handles beside a load: all nodes are where the reference has them that holds the same nodes, and so are the forces of
/// the handles; before the first step and after it.
#[test]
fn handles_hold_as_the_reference_does() {
    let mesh = block();
    let load = NodeLoad {
        node: 150,
        force_n: [0.02, -0.03, 0.05],
    };
    let mut force_n = vec![[0.0; 3]; mesh.points_m().len()];
    force_n[150] = load.force_n;
    let handle = |(node, way): (u32, [f64; 3])| Handle {
        anchor: Anchor {
            vertices: vec![node],
            weights: vec![1.0],
        },
        target_displacement_m: way,
    };
    let loads = Loads {
        forces: vec![load],
        handles: PULLED.map(handle).to_vec(),
        ..Loads::default()
    };
    let laws = [Law::neo_hookean(SOFT)];
    for cells in [Cells::Linear, Cells::Averaged] {
        let reference = reference(&mesh, cells, &force_n);
        let moved = |(x, rest): (&[f64; 3], &[f64; 3])| [0, 1, 2].map(|axis| x[axis] - rest[axis]);
        let places = reference.positions_m().iter().zip(mesh.points_m());
        let expected: Vec<[f64; 3]> = places.map(moved).collect();
        let forces = &reference.reactions_n()[49..];
        let substance = Hyperelasticity { laws: &laws, cells };
        let build = |loads: Loads| {
            let (policy, passes) = (Policy::default(), Passes::default());
            Model::hyperelastic(&mesh, &substance, &bottom(), loads, &[], policy, passes)
        };
        let resting = build(loads.clone()).expect("a model");
        let by_rows = build(loads.clone()).expect("a model");
        let by_rows = by_rows
            .with_needles(&mesh, &[], &[], NeedleSettings::default())
            .expect("handles as rows");
        for (model, steps) in [(&resting, 0), (&by_rows, 0), (&by_rows, 3)] {
            let (mut state, mut work) = (State::new(model), Workspace::new(model));
            for _ in 0..steps {
                let report = step(model, &mut state, &[], &StepOptions::default(), &mut work);
                assert_eq!(report.status, Status::Ok);
            }
            let rest = model.equilibrium(&state).expect("a balance");
            let u = off(rest.displacement_m.into_iter(), expected.iter().copied());
            let f = off(rest.handle_force_n.into_iter(), forces.iter().copied());
            println!(
                "{cells:?}, {steps} steps: {u:.1e}, forces {f:.1e}, {:.1e}",
                rest.residual
            );
            assert!(u < 1e-6 && f < 1e-6 && rest.residual < 1e-8);
        }
        let apart = Handle {
            target_displacement_m: [0.0, 0.0, 0.001],
            ..loads.handles[0].clone()
        };
        let refused = |handles: Vec<Handle>| {
            let loads = Loads {
                handles,
                ..Loads::default()
            };
            build(loads).err().map(|error| error.to_string())
        };
        let torn = refused(vec![loads.handles[0].clone(), apart]);
        assert!(torn.is_some_and(|why| why.contains("handle 1")));
        // A cell whose corners are held turned inside out has no energy.
        let cell = mesh.cells().last().expect("a cell");
        let upside_down = |node: &u32| {
            let z = mesh.points_m()[*node as usize][2];
            handle((*node, [0.0, 0.0, -2.0 * (z + 0.005)]))
        };
        let inverted = refused(cell.iter().map(upside_down).collect());
        assert!(inverted.is_some_and(|why| why.contains("of their ways: ")));
    }
}
