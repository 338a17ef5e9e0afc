//! Linear and corotational tissue behind the interface of all models.

use nalgebra::{Rotation3, Vector3};
use sutura_host::fem::{
    CorotationalModel, CorotationalTissue, LinearModel, LinearTissue, Loads, Material,
    ModelSettings, NodeLoad, Policy,
};
use sutura_host::mesh::{TetMesh, slab};
use sutura_host::models::{BoundaryConditions, Outcome, Tissue};

const SOFT: Material = Material {
    youngs_modulus_pa: 5e3,
    poisson_ratio: 0.45,
};

fn block() -> TetMesh {
    slab([0.06, 0.05, 0.04], [3, 3, 3]).expect("a slab")
}

/// Bottom held still, the top's nodes pushed in and aside by `by`; the rows of the top.
fn pressed(by: [f64; 3]) -> (Vec<(u32, [f64; 3])>, Vec<usize>) {
    let bottom = (0..16).map(|node| (node, [0.0; 3]));
    let top = (48..64).map(|node| (node, by));
    (bottom.chain(top).collect(), (16..32).collect())
}

fn both() -> Vec<(&'static str, Box<dyn Tissue>)> {
    let mesh = block();
    let linear = LinearModel::new(&mesh, SOFT).expect("linear");
    let corotational =
        CorotationalModel::new(&mesh, SOFT, ModelSettings::CONVERGED).expect("corotational");
    vec![
        ("linear", Box::new(linear)),
        ("corotational", Box::new(corotational)),
    ]
}

fn summed(tissue: &dyn Tissue, rows: &[usize]) -> Vector3<f64> {
    rows.iter()
        .map(|row| Vector3::from(tissue.reactions_n()[*row]))
        .sum()
}

/// Reactions against the other solve that the library has, with nodes fixed for good.
#[test]
fn they_agree_with_tissue_whose_nodes_are_fixed_for_good() {
    let mesh = block();
    let (held, top) = pressed([0.004, 0.0, -0.009]);
    let mut force_n = vec![[0.0; 3]; 64];
    force_n[30] = [0.01, -0.02, 0.005];
    let drive = BoundaryConditions {
        held: &held,
        force_n: &force_n,
    };
    let fixed: Vec<u32> = held.iter().map(|(node, _)| *node).collect();
    let loads = Loads {
        forces: vec![NodeLoad {
            node: 30,
            force_n: force_n[30],
        }],
        fixed_displacement_m: held.clone(),
        ..Loads::default()
    };
    let linear = LinearTissue::new(&mesh, SOFT, &fixed).expect("tissue");
    let corotational =
        CorotationalTissue::new(&mesh, SOFT, &fixed, Policy::default()).expect("tissue");
    let expected = [
        linear.solve(&loads).expect("solved"),
        corotational.solve(&loads).expect("solved"),
    ];
    for ((name, mut tissue), expected) in both().into_iter().zip(expected) {
        let done = tissue.step(&drive, 0.01);
        assert_eq!(done.outcome, Outcome::Converged, "{name}: {done:?}");
        for (node, (at, rest)) in tissue.positions_m().iter().zip(mesh.points_m()).enumerate() {
            let found = Vector3::from(*at) - Vector3::from(*rest);
            let known = Vector3::from(expected.displacement_m[node]);
            assert!((found - known).norm() < 1e-10, "{name}: node {node}");
        }
        let force: Vector3<f64> = (48..64)
            .map(|node| Vector3::from(expected.node_force_n[node]))
            .sum();
        let found = summed(&*tissue, &top);
        assert!((found - force).norm() < 1e-7 * force.norm(), "{name}");
    }
}

#[test]
fn the_tangent_is_the_derivative_of_the_reaction() {
    let at = [0.003, -0.002, -0.008];
    for (name, mut tissue) in both() {
        let (held, top) = pressed(at);
        let drive = BoundaryConditions {
            held: &held,
            force_n: &[],
        };
        assert_eq!(tissue.step(&drive, 0.01).outcome, Outcome::Converged);
        let before = tissue.positions_m().to_vec();
        let tangent = tissue.tangent(&drive, &top, 0.01).expect("a tangent");
        assert_eq!(tangent.error, 0.0, "{name}");
        assert_eq!(tissue.positions_m(), before, "{name}");
        let h = 1e-6;
        for axis in 0..3 {
            let mut force_at = |way: f64| {
                let mut moved = at;
                moved[axis] += way;
                let (held, _) = pressed(moved);
                let drive = BoundaryConditions {
                    held: &held,
                    force_n: &[],
                };
                assert_eq!(tissue.step(&drive, 0.01).outcome, Outcome::Converged);
                summed(&*tissue, &top)
            };
            let slope = (force_at(h) - force_at(-h)) / (2.0 * h);
            for row in 0..3 {
                let exact = tangent.stiffness_n_per_m[row][axis];
                assert!(
                    (exact - slope[row]).abs() < 1e-5 * slope.norm(),
                    "{name}: {row} {axis}: {exact} {}",
                    slope[row]
                );
            }
        }
    }
}

/// Work of the reactions along a path is the energy that is stored.
#[test]
fn reactions_work_as_much_as_energy_rises() {
    for (name, mut tissue) in both() {
        let (mut work, mut energy, mut last) = (0.0, 0.0, Vector3::zeros());
        let steps = 40;
        for step in 1..=steps {
            let share = f64::from(step) / f64::from(steps);
            let (held, top) = pressed([0.01 * share, 0.0, -0.012 * share]);
            let drive = BoundaryConditions {
                held: &held,
                force_n: &[],
            };
            energy = tissue.step(&drive, 0.01).energy_j;
            let force = summed(&*tissue, &top);
            let way = Vector3::new(0.01, 0.0, -0.012) / f64::from(steps);
            work += 0.5 * (force + last).dot(&way);
            last = force;
        }
        assert!(
            (work - energy).abs() < 1e-3 * energy,
            "{name}: {work} {energy}"
        );
    }
}

/// Corotational tissue that is carried and turned as a whole has no forces; linear tissue has.
#[test]
fn a_turn_beyond_half_a_circle_costs_nothing() {
    let mesh = block();
    let mut tissue = CorotationalModel::new(&mesh, SOFT, ModelSettings::CONVERGED).expect("tissue");
    for turn in 1..=20 {
        let angle = 0.2 * f64::from(turn);
        let turn = Rotation3::from_axis_angle(&Vector3::y_axis(), angle);
        let held: Vec<_> = (0..16)
            .map(|node| {
                let rest = Vector3::from(mesh.points_m()[node as usize]);
                (node, (turn * rest - rest).into())
            })
            .collect();
        let drive = BoundaryConditions {
            held: &held,
            force_n: &[],
        };
        let done = tissue.step(&drive, 0.01);
        assert_eq!(done.outcome, Outcome::Converged, "{angle}");
        assert!(done.energy_j < 1e-12, "{angle}: {}", done.energy_j);
    }
}

/// Other nodes in every step, and as if they had been held from the beginning.
#[test]
fn held_nodes_may_change() {
    let others: Vec<_> = (0..16)
        .map(|node| (node, [0.0; 3]))
        .chain([(55, [0.0, 0.001, -0.006]), (58, [0.0, 0.0, -0.005])])
        .collect();
    let (first, _) = pressed([0.0, 0.003, -0.006]);
    for ((name, mut fresh), (_, mut used)) in both().into_iter().zip(both()) {
        let drive = |held| BoundaryConditions { held, force_n: &[] };
        used.step(&drive(&first), 0.01);
        let a = used.step(&drive(&others), 0.01);
        let b = fresh.step(&drive(&others), 0.01);
        assert_eq!(
            (a.outcome, b.outcome),
            (Outcome::Converged, Outcome::Converged)
        );
        for (a, b) in used.positions_m().iter().zip(fresh.positions_m()) {
            assert!(
                (Vector3::from(*a) - Vector3::from(*b)).norm() < 1e-9,
                "{name}"
            );
        }
    }
}

#[test]
fn what_cannot_be_done_is_said_and_leaves_the_place() {
    let nan = [(0, [f64::NAN, 0.0, 0.0])];
    let far = [(64, [0.0; 3])];
    let twice = [(3, [0.0; 3]), (3, [0.0; 3])];
    let few = [(0, [0.0; 3]), (1, [0.0; 3])];
    let line = [0, 1, 2, 3].map(|node| (node, [0.0; 3]));
    for (name, mut tissue) in both() {
        let (held, _) = pressed([0.0, 0.0, -0.004]);
        let sound = BoundaryConditions {
            held: &held,
            force_n: &[],
        };
        tissue.step(&sound, 0.01);
        let before = tissue.positions_m().to_vec();
        for held in [&nan[..], &far, &twice, &few, &line, &[]] {
            let drive = BoundaryConditions { held, force_n: &[] };
            let done = tissue.step(&drive, 0.01);
            assert!(
                matches!(done.outcome, Outcome::Failed(_)),
                "{name}: {held:?}: {done:?}"
            );
            assert_eq!(tissue.positions_m(), before, "{name}: {held:?}");
        }
        assert_eq!(tissue.step(&sound, 0.01).outcome, Outcome::Converged);
    }
}

#[test]
fn steps_allocate_nothing() {
    let mesh = block();
    let settings = ModelSettings::default();
    let corotational = CorotationalModel::new(&mesh, SOFT, settings).expect("tissue");
    let linear = LinearModel::new(&mesh, SOFT).expect("tissue");
    let models: [Box<dyn Tissue>; 2] = [Box::new(linear), Box::new(corotational)];
    for mut tissue in models {
        let (a, _) = pressed([0.0, 0.0, -0.004]);
        let (mut b, _) = pressed([0.002, 0.0, -0.012]);
        // As many, but not the same.
        b[31].0 = 63;
        b[15].0 = 17;
        let step = |tissue: &mut Box<dyn Tissue>, held: &[(u32, [f64; 3])]| {
            tissue.step(&BoundaryConditions { held, force_n: &[] }, 0.01);
        };
        step(&mut tissue, &a);
        let count = allocation_counter::measure(|| {
            for _ in 0..3 {
                step(&mut tissue, &a);
                step(&mut tissue, &b);
            }
        });
        assert_eq!(count.count_total, 0);
    }
}
