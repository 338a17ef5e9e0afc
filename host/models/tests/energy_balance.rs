//! Energy balance against solutions by Newton's method from another program, and its allocations.

use serde_json::Value;
use sutura_mesh::{TetMesh, read_msh_raw, slab};
use sutura_models::energy_balance::{EnergyBalance, Form, Lanes, Prony, Settings};
use sutura_models::hyperelastic::{self, Hyperelastic};
use sutura_models::law::Law;
use sutura_models::{BoundaryConditions, Material, Outcome, Tissue};

const BRAIN: Material = Material {
    youngs_modulus_pa: 3_000.0,
    poisson_ratio: 0.49,
};

type Held = Vec<(u32, [f64; 3])>;

/// The sheared cube of zhang-2017, 5.3.2: mesh, what is held, solution, reaction of the top.
fn sheared_cube() -> (TetMesh, Held, Vec<[f64; 3]>, [f64; 3]) {
    let read = |file: &str| {
        let data = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/data/");
        std::fs::read_to_string(format!("{data}{file}")).expect(file)
    };
    let json: Value = serde_json::from_str(&read("neo-cube-sheared.json")).expect("json");
    let mesh = read_msh_raw(&read("cube_350.msh"))
        .and_then(|mesh| mesh.scaled(2.0)?.check())
        .expect("a mesh");
    let nodes = |key: &str| -> Vec<u32> { serde_json::from_value(json[key].clone()).expect(key) };
    let triple = |key: &str| -> [f64; 3] { serde_json::from_value(json[key].clone()).expect(key) };
    let by = triple("moved_by_m");
    let fixed = nodes("fixed_nodes")
        .into_iter()
        .map(|node| (node, [0.0; 3]));
    let moved = nodes("moved_nodes").into_iter().map(|node| (node, by));
    let mut held: Held = fixed.chain(moved).collect();
    held.sort_by_key(|(node, _)| *node);
    let solution = serde_json::from_value(json["displacement_m"].clone()).expect("solution");
    (mesh, held, solution, triple("reaction_on_moved_n"))
}

/// Largest error of a displacement \[m\], relative error of the reaction.
fn errors(settings: Settings) -> (f64, f64) {
    let (mesh, held, solution, reaction) = sheared_cube();
    let mut model =
        EnergyBalance::new(&mesh, &[Law::neo_hookean(BRAIN)], settings).expect("a model");
    model.step(
        &BoundaryConditions {
            held: &held,
            force_n: &[],
        },
        0.01,
    );
    let mut worst = 0.0f64;
    let points = mesh.points_m().iter().zip(&solution);
    for (now, (rest, u)) in model.positions_m().iter().zip(points) {
        for c in 0..3 {
            worst = worst.max((now[c] - rest[c] - u[c]).abs());
        }
    }
    let mut off = 0.0f64;
    for c in 0..3 {
        let moved = model.reactions_n().iter().zip(&held);
        let sum: f64 = moved
            .filter(|(_, (_, u))| u[2] != 0.0)
            .map(|(r, _)| r[c])
            .sum();
        off = off.max((sum - reaction[c]).abs());
    }
    (worst, off / reaction[2].abs())
}

#[test]
fn converged_it_is_the_newton_solution() {
    let settings = Settings {
        lanes: Lanes::Scalar,
        iterations: 400,
        tolerance: 1e-9,
        ..Settings::default()
    };
    let (worst, off) = errors(settings);
    assert!(worst < 0.5e-6 && off < 1e-6, "{worst:e} m, {off:e}");
}

#[test]
fn the_compliant_form_converges_to_the_newton_solution() {
    let of = |iterations| {
        errors(Settings {
            form: Form::Compliant,
            lanes: Lanes::Scalar,
            iterations,
            ..Settings::default()
        })
    };
    let (early, late) = (of(100), of(500));
    assert!(late.0 < 2e-5 && late.1 < 1e-4, "{late:?}");
    assert!(early.0 > 100.0 * late.0, "{early:?} {late:?}");
}

#[test]
fn converged_it_is_where_newton_ends_with_fibres_and_loads() {
    let mesh = slab([0.06, 0.05, 0.04], [4, 4, 3]).expect("a slab");
    let held: Held = (0..25).map(|node| (node, [0.0; 3])).collect();
    let mut force_n = vec![[0.0; 3]; 100];
    force_n[75..].fill([0.01, 0.004, -0.02]);
    let drive = BoundaryConditions {
        held: &held,
        force_n: &force_n,
    };
    let law = Law::fibred(BRAIN, 2_000.0, [0.0, 0.6, 0.8]);
    let mut newton =
        Hyperelastic::new(&mesh, &[law], hyperelastic::Settings::default()).expect("a model");
    assert_eq!(newton.step(&drive, 0.0).outcome, Outcome::Converged);
    for (form, iterations) in [(Form::Balanced, 500), (Form::Compliant, 3_000)] {
        let settings = Settings {
            form,
            iterations,
            lanes: Lanes::Scalar,
            tolerance: 1e-9,
            ..Settings::default()
        };
        let mut model = EnergyBalance::new(&mesh, &[law], settings).expect("a model");
        let report = model.step(&drive, 0.0);
        let ours = model.positions_m().as_flattened().iter();
        let pairs = ours.zip(newton.positions_m().as_flattened());
        let off = pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(off < 5e-8, "{form:?}: {off:e} m, {}", report.residual);
        assert!((report.energy_difference).abs() < 0.1, "{form:?}");
    }
}

#[test]
fn a_step_and_its_tangent_allocate_nothing_after_the_first() {
    let mesh = slab([0.06, 0.05, 0.04], [4, 4, 3]).expect("a slab");
    let held = |first: u32, by: f64| -> Held {
        let bottom = (first..first + 25).map(|node| (node, [0.0; 3]));
        bottom
            .chain((75..100).map(|node| (node, [by, 0.0, 0.0])))
            .collect()
    };
    let drives = [
        held(0, 0.0),
        held(0, 1e-3),
        held(3, 2e-3),
        held(0, f64::NAN),
    ];
    let force_n = vec![[0.0, 0.0, 1e-3]; 100];
    let material = Material {
        youngs_modulus_pa: 3_000.0,
        poisson_ratio: 0.45,
    };
    for form in [
        Form::Printed,
        Form::Averaged,
        Form::Compliant,
        Form::Balanced,
    ] {
        for lanes in [Lanes::Scalar, Lanes::Wide] {
            let mut settings = Settings {
                form,
                lanes,
                iterations: 4,
                ..Settings::default()
            };
            if form == Form::Balanced {
                settings.relaxation.push(Prony {
                    share: 0.5,
                    time_s: 0.58,
                });
            }
            let mut model = EnergyBalance::new(&mesh, &[Law::neo_hookean(material)], settings)
                .expect("a model");
            let mut failed = 0;
            let mut go = |held: &Held| {
                let drive = BoundaryConditions {
                    held,
                    force_n: &force_n,
                };
                let report = model.step(&drive, 0.001);
                let tangent = model.tangent(&drive, &[30, 31], 0.001);
                let fails = matches!(report.outcome, Outcome::Failed(_));
                let printed = matches!(form, Form::Printed | Form::Averaged);
                assert_eq!(tangent.is_some(), !(fails || printed));
                failed += u32::from(fails);
            };
            go(&drives[0]);
            let allocated = allocation_counter::measure(|| drives.iter().for_each(&mut go));
            assert_eq!(allocated.count_total, 0, "{form:?} {lanes:?}");
            assert_eq!(failed, 1);
        }
    }
}
