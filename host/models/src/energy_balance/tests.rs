//! Physics of every form on small meshes.

use super::*;
use crate::Material;
use nalgebra::Matrix3;
use sutura_mesh::slab;

const LIVER: Material = Material {
    youngs_modulus_pa: 3_500.0,
    poisson_ratio: 0.45,
};

fn laws() -> [Law; 3] {
    [
        Law::st_venant_kirchhoff(LIVER),
        Law::neo_hookean(LIVER),
        Law::fibred(LIVER, 2_400.0, [0.0, 0.6, 0.8]),
    ]
}

fn block() -> TetMesh {
    slab([0.06, 0.05, 0.04], [3, 3, 3]).expect("a slab")
}

fn build(mesh: &TetMesh, law: Law, settings: Settings) -> EnergyBalance {
    EnergyBalance::new(mesh, &[law], settings).expect("a model")
}

fn precise(form: Form, iterations: u32) -> Settings {
    Settings {
        form,
        iterations,
        lanes: Lanes::Scalar,
        tolerance: 1e-10,
        ..Settings::default()
    }
}

type Held = Vec<(u32, [f64; 3])>;

/// Bottom held, top moved by `by`.
fn between_plates(mesh: &TetMesh, by: [f64; 3]) -> Held {
    let height = |p: &[f64; 3]| p[2];
    let low = mesh.points_m().iter().map(height).fold(0.0, f64::min);
    let nodes = (0..).zip(mesh.points_m());
    nodes
        .filter_map(|(node, p)| match p[2] {
            z if z > -1e-9 => Some((node, by)),
            z if z < low + 1e-9 => Some((node, [0.0; 3])),
            _ => None,
        })
        .collect()
}

fn held(held: &Held) -> BoundaryConditions<'_> {
    BoundaryConditions { held, force_n: &[] }
}

/// Force of the cells on every node \[N\], straight from the law.
fn nodal_forces(mesh: &TetMesh, law: &Law, positions: &[[f64; 3]]) -> Vec<Vector3<f64>> {
    let mut forces = vec![Vector3::zeros(); positions.len()];
    for cell in mesh.cells() {
        let rest = cells::Rest::of(mesh, *cell);
        let mut f = Matrix3::zeros();
        for (node, gradient) in cell.iter().zip(&rest.gradients) {
            f += Vector3::from(positions[*node as usize]) * gradient.transpose();
        }
        let stress = law.stress(&f) * rest.volume;
        for (node, gradient) in cell.iter().zip(&rest.gradients) {
            forces[*node as usize] -= stress * gradient;
        }
    }
    forces
}

fn largest_difference(a: &[[f64; 3]], b: &[[f64; 3]]) -> f64 {
    let pairs = a.as_flattened().iter().zip(b.as_flattened());
    pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

#[test]
fn a_uniform_strain_is_exact() {
    let mesh = block();
    let h = Matrix3::new(0.1, 0.05, 0.0, -0.03, -0.08, 0.06, 0.02, 0.0, 0.07);
    let field = |p: &[f64; 3]| -> [f64; 3] { (h * Vector3::from(*p)).into() };
    let inside =
        |p: &[f64; 3]| p[0].abs() < 0.029 && p[1].abs() < 0.024 && p[2] < -1e-9 && p[2] > -0.039;
    let nodes = (0..).zip(mesh.points_m());
    let outer: Held = nodes
        .filter(|(_, p)| !inside(p))
        .map(|(node, p)| (node, field(p)))
        .collect();
    assert!(outer.len() < mesh.points_m().len());
    let points = mesh.points_m().iter();
    let exact: Vec<[f64; 3]> = points
        .map(|p| (Vector3::from(*p) + Vector3::from(field(p))).into())
        .collect();
    for law in laws() {
        for (form, lanes, limit) in [
            (Form::Balanced, Lanes::Scalar, 1e-9),
            // Single precision: a few units in the last place of 5 mm.
            (Form::Balanced, Lanes::Wide, 2e-9),
            (Form::Compliant, Lanes::Scalar, 1e-9),
            (Form::Compliant, Lanes::Wide, 2e-9),
        ] {
            let settings = Settings {
                lanes,
                ..precise(form, if form == Form::Balanced { 200 } else { 2_000 })
            };
            let mut model = build(&mesh, law, settings);
            model.step(&held(&outer), 0.01);
            let off = largest_difference(model.positions_m(), &exact);
            assert!(off < limit, "{form:?} {lanes:?}: {off:e}");
        }
    }
}

#[test]
fn where_it_rests_the_laws_own_forces_balance_the_loads() {
    let mesh = block();
    let bottom: Held = (0..16).map(|node| (node, [0.0; 3])).collect();
    let mut force_n = vec![[0.0; 3]; mesh.points_m().len()];
    for (node, force) in force_n.iter_mut().enumerate().skip(48) {
        *force = [0.004, -0.002, 0.003 * (node % 3) as f64];
    }
    let drive = BoundaryConditions {
        held: &bottom,
        force_n: &force_n,
    };
    for law in laws() {
        let mut rests = Vec::new();
        for (form, proximity, iterations) in [
            (Form::Balanced, 1.0, 300),
            (Form::Compliant, 3.0, 6_000),
            (Form::Compliant, 5.0, 10_000),
        ] {
            let settings = Settings {
                proximity,
                ..precise(form, iterations)
            };
            let mut model = build(&mesh, law, settings);
            let report = model.step(&drive, 0.01);
            assert!(report.energy_j > 0.0, "{form:?} {report:?}");
            let forces = nodal_forces(&mesh, &law, model.positions_m());
            let acting: f64 = force_n
                .as_flattened()
                .iter()
                .map(|f| f * f)
                .sum::<f64>()
                .sqrt();
            for (node, force) in forces.iter().enumerate() {
                let sum = force + Vector3::from(force_n[node]);
                if node >= 16 {
                    assert!(sum.norm() < 1e-6 * acting, "{form:?} {law:?}: {sum}");
                } else {
                    let by = Vector3::from(model.reactions_n()[node]);
                    assert!((by + sum).norm() < 1e-9 * acting);
                }
            }
            assert!(report.residual < 1e-6, "{form:?}: {}", report.residual);
            rests.push(model.positions_m().to_vec());
        }
        // The same place whatever held the steps back.
        for other in &rests[1..] {
            assert!(largest_difference(&rests[0], other) < 1e-7);
        }
    }
}

#[test]
fn lanes_and_one_by_one_agree_within_single_precision() {
    let mesh = block();
    let plates = between_plates(&mesh, [0.001, 0.0005, -0.001]);
    for law in laws() {
        for form in [
            Form::Printed,
            Form::Averaged,
            Form::Compliant,
            Form::Balanced,
        ] {
            let iterations = if form == Form::Printed { 1 } else { 12 };
            let [one, eight] = [Lanes::Scalar, Lanes::Wide].map(|lanes| {
                let settings = Settings {
                    lanes,
                    ..precise(form, iterations)
                };
                let mut model = build(&mesh, law, settings);
                let report = model.step(&held(&plates), 0.01);
                (model.positions_m().to_vec(), report)
            });
            let off = largest_difference(&one.0, &eight.0);
            // Rounding of 1 mm to single precision, some ten times over.
            assert!(off < 5e-9, "{form:?} {law:?}: {off:e}");
            let energy = (one.1.energy_j / eight.1.energy_j - 1.0).abs();
            assert!(energy < 5e-6, "{form:?}: {energy:e}");
        }
    }
}

/// Deforms a block between plates and lets go of it for one iteration; the increments.
fn one_iteration_free(mesh: &TetMesh, form: Form) -> (EnergyBalance, Vec<Vector3<f64>>) {
    let settings = Settings {
        motion: Motion::Dynamic,
        ..precise(form, 1)
    };
    let mut model = build(mesh, laws()[1], settings);
    let plates = between_plates(mesh, [0.003, 0.001, 0.002]);
    model.step(&held(&plates), 0.01);
    let at_rest = vec![[0.0; 3]; mesh.points_m().len()];
    model.set_velocities(&at_rest);
    let before = model.positions_m().to_vec();
    model.step(&BoundaryConditions::default(), 0.01);
    let moved = model.positions_m().iter().zip(&before);
    let increments = moved
        .map(|(a, b)| Vector3::from(*a) - Vector3::from(*b))
        .collect();
    // Moments are about where the increments were computed.
    model.positions_m.copy_from_slice(&before);
    (model, increments)
}

#[test]
fn increments_carry_no_momentum() {
    let one = TetMesh::new(
        vec![
            [0.0; 3],
            [0.02, 0.0, 0.0],
            [0.0, 0.02, 0.0],
            [0.0, 0.005, -0.02],
        ],
        vec![[0, 2, 1, 3]],
    )
    .expect("a cell");
    // Cells of the compliant form follow one another: moments cancel cell by cell.
    for (mesh, form) in [
        (block(), Form::Printed),
        (one.clone(), Form::Printed),
        (one, Form::Compliant),
        (block(), Form::Compliant),
    ] {
        let single = mesh.cells().len() == 1;
        let (model, increments) = one_iteration_free(&mesh, form);
        let (mut linear, mut angular, mut size, mut turn) =
            (Vector3::zeros(), Vector3::zeros(), 0.0, 0.0);
        for (node, by) in increments.iter().enumerate() {
            let mass = model.solver.mass()[node];
            let arm = Vector3::from(model.positions_m[node]);
            linear += mass * by;
            angular += mass * arm.cross(by);
            size += mass * by.norm();
            turn += mass * arm.norm() * by.norm();
        }
        assert!(size > 1e-7 * model.solver.mass().iter().sum::<f64>());
        assert!(linear.norm() < 1e-12 * size, "{form:?}: {linear} of {size}");
        if single || form == Form::Printed {
            assert!(
                angular.norm() < 1e-11 * turn,
                "{form:?}: {angular} of {turn}"
            );
        }
    }
}

#[test]
fn as_printed_a_cell_goes_to_zero_energy_whatever_the_load() {
    // W / |dW|^2 halves the linearised C = sqrt(2 W), which is convex: a quarter of W is left, or more.
    let mesh = TetMesh::new(
        vec![
            [0.0; 3],
            [0.02, 0.0, 0.0],
            [0.0, 0.02, 0.0],
            [0.0, 0.0, 0.02],
        ],
        vec![[0, 1, 2, 3]],
    )
    .expect("a cell");
    let stretched: Held = vec![
        (0, [0.0; 3]),
        (1, [1e-5, 0.0, 0.0]),
        (2, [0.0, 2e-5, 1e-5]),
        (3, [0.0, 0.0, 0.0]),
    ];
    let mut model = build(&mesh, laws()[1], precise(Form::Printed, 1));
    let mut energy = model.step(&held(&stretched), 0.01).energy_j;
    let first = energy;
    for _ in 0..60 {
        let next = model.step(&BoundaryConditions::default(), 0.01).energy_j;
        assert!(next / energy > 0.249, "{}", next / energy);
        energy = next;
    }
    assert!(energy < 0.3 * first, "{}", energy / first);
}

#[test]
fn let_go_in_motion_it_keeps_its_momentum_and_loses_energy() {
    let mesh = block();
    let settings = Settings {
        motion: Motion::Dynamic,
        ..precise(Form::Balanced, 200)
    };
    let mut model = build(&mesh, laws()[1], settings);
    let points = mesh.points_m().iter();
    let spin: Vec<[f64; 3]> = points
        .map(|p| [0.2 - 3.0 * p[1], 3.0 * p[0], 0.5 * p[2]])
        .collect();
    model.set_velocities(&spin);
    let kinetic = |model: &EnergyBalance| -> f64 {
        let nodes = model.velocity.iter().zip(model.solver.mass());
        nodes
            .map(|(v, m)| 0.5 * m * Vector3::from(*v).norm_squared())
            .sum()
    };
    let mut energy = kinetic(&model);
    let mut first: Option<Diagnostics> = None;
    for _ in 0..20 {
        let report = model.step(&BoundaryConditions::default(), 0.002);
        assert!(report.residual < 1e-6);
        let now = report.energy_j + kinetic(&model);
        assert!(now < energy * (1.0 + 1e-9));
        energy = now;
        let first = first.get_or_insert(report);
        let along = Vector3::from(first.momentum) - Vector3::from(report.momentum);
        assert!(along.norm() < 1e-7 * Vector3::from(first.momentum).norm());
    }
}

#[test]
fn a_held_block_relaxes_by_the_prony_series() {
    let mesh = block();
    let plates = between_plates(&mesh, [-0.001, 0.0, -0.002]);
    let (share, time_s) = (0.5, 0.58);
    let each = |law| [Lanes::Scalar, Lanes::Wide].map(|lanes| (law, lanes));
    for (law, lanes) in laws().into_iter().flat_map(each) {
        let mut off = Vec::new();
        for steps in [40, 80] {
            let step_s = 2.0 * time_s / f64::from(steps);
            let settings = Settings {
                relaxation: vec![Prony { share, time_s }],
                lanes,
                tolerance: 1e-5,
                ..precise(Form::Balanced, 60)
            };
            let mut model = build(&mesh, law, settings);
            let mut elastic = build(&mesh, law, precise(Form::Balanced, 300));
            elastic.step(&held(&plates), step_s);
            let pull = |model: &EnergyBalance| -> f64 {
                let reactions = model.reactions_n().iter().zip(&plates);
                reactions
                    .filter(|(_, (_, u))| u[2] != 0.0)
                    .map(|(r, _)| r[2])
                    .sum()
            };
            let mut worst = 0.0f64;
            for step in 1..=steps {
                model.step(&held(&plates), step_s);
                let left = pull(&model) / pull(&elastic);
                let time = f64::from(step) * step_s;
                // What the update itself makes of the series, and the series.
                let updated = 1.0 - share * (1.0 - (1.0 + step_s / time_s).powi(-step));
                let exact = 1.0 - share * (1.0 - (-time / time_s).exp());
                assert!(
                    (left - updated).abs() < 2e-4,
                    "{law:?} {lanes:?} {step}: {left} {updated}"
                );
                worst = worst.max((left - exact).abs());
            }
            off.push(worst);
        }
        let order = off[0] / off[1];
        assert!((1.8..2.2).contains(&order), "{law:?} {lanes:?}: {off:?}");
    }
}

/// Steps from cell to cell carry a load one cell further each; the lattice carries it along a beam at once.
#[test]
fn the_lattice_carries_loads_along_a_beam() {
    let mesh = slab([0.2, 0.04, 0.04], [15, 3, 3]).expect("a slab");
    let is_end = |p: &[f64; 3]| p[0] < -0.1 + 1e-9;
    let nodes = (0..).zip(mesh.points_m());
    let end: Held = nodes
        .filter(|(_, p)| is_end(p))
        .map(|(node, _)| (node, [0.0; 3]))
        .collect();
    let force_n = vec![[0.0, 0.0, -1e-5]; mesh.points_m().len()];
    let drive = BoundaryConditions {
        held: &end,
        force_n: &force_n,
    };
    let after_twenty = |lattice_points| {
        let settings = Settings {
            lattice_points,
            ..precise(Form::Balanced, 20)
        };
        build(&mesh, laws()[1], settings).step(&drive, 0.01)
    };
    let (without, with) = (after_twenty(0), after_twenty(64));
    assert!(
        with.residual < 0.02 * without.residual,
        "{with:?} {without:?}"
    );
    // Most of the beam has not heard of the load without it.
    assert!(
        with.energy_j > 10.0 * without.energy_j,
        "{with:?} {without:?}"
    );
}

#[test]
fn inverted_cells_find_their_way_back() {
    let mesh = block();
    let plates = between_plates(&mesh, [0.0; 3]);
    let inside = |p: &[f64; 3]| p[0].abs() < 0.029 && p[1].abs() < 0.024 && p[2] > -0.02;
    let mut nodes = (0..).zip(mesh.points_m());
    let (node, _) = nodes
        .find(|(_, p)| inside(p) && p[2] < -1e-9)
        .expect("a node inside");
    for law in &laws()[1..] {
        for lanes in [Lanes::Scalar, Lanes::Wide] {
            let settings = Settings {
                lanes,
                ..precise(Form::Balanced, 60)
            };
            let mut model = build(&mesh, *law, settings);
            model.step(&held(&plates), 0.01);
            // One node through the opposite faces of its cells.
            model.solver.place(node as usize, [0.02, 0.015, -0.01]);
            for _ in 0..5 {
                model.step(&held(&plates), 0.01);
            }
            let off = largest_difference(model.positions_m(), mesh.points_m());
            assert!(off < 1e-5, "{lanes:?}: {off:e}");
        }
    }
}

#[test]
fn held_nodes_that_go_far_go_in_parts() {
    let mesh = block();
    let mut once = build(&mesh, laws()[1], precise(Form::Balanced, 200));
    let report = once.step(&held(&between_plates(&mesh, [0.0, 0.0, -0.02])), 0.01);
    assert!(report.iterations > 200, "{report:?}");
    let mut slowly = build(&mesh, laws()[1], precise(Form::Balanced, 200));
    for k in 1..=20 {
        let by = [0.0, 0.0, -0.001 * f64::from(k)];
        slowly.step(&held(&between_plates(&mesh, by)), 0.01);
    }
    let off = largest_difference(once.positions_m(), slowly.positions_m());
    assert!(off < 1e-8, "{off:e}");
}

#[test]
fn a_block_turned_inside_out_stays_finite() {
    let mesh = block();
    for law in laws() {
        for lanes in [Lanes::Scalar, Lanes::Wide] {
            let settings = Settings {
                lanes,
                ..precise(Form::Balanced, 20)
            };
            let mut model = build(&mesh, law, settings);
            // The top through the bottom, ten body lengths away, and back.
            for z in [-0.03, -0.05, -0.4, 0.0] {
                let report = model.step(&held(&between_plates(&mesh, [0.0, 0.0, z])), 0.01);
                assert!(report.energy_j.is_finite() && report.residual.is_finite());
                assert!(
                    model
                        .positions_m()
                        .as_flattened()
                        .iter()
                        .all(|x| x.is_finite())
                );
            }
        }
    }
}

#[test]
fn numbers_that_are_none_fail_and_change_nothing() {
    let mesh = block();
    for form in [
        Form::Printed,
        Form::Averaged,
        Form::Compliant,
        Form::Balanced,
    ] {
        for lanes in [Lanes::Scalar, Lanes::Wide] {
            let settings = Settings {
                lanes,
                ..precise(form, 5)
            };
            let mut model = build(&mesh, laws()[1], settings);
            model.step(&held(&between_plates(&mesh, [0.001; 3])), 0.01);
            let before = model.positions_m().to_vec();
            let nan = [[f64::NAN; 3]; 1];
            let bad_loads = vec![[f64::INFINITY, 0.0, 0.0]; mesh.points_m().len()];
            let far = between_plates(&mesh, [1e200, 0.0, 0.0]);
            for drive in [
                held(&vec![(0, [f64::NAN; 3])]),
                held(&vec![(9_999, [0.0; 3])]),
                held(&vec![(3, [0.0; 3]), (2, [0.0; 3])]),
                held(&far),
                BoundaryConditions {
                    held: &[],
                    force_n: &nan,
                },
                BoundaryConditions {
                    held: &[],
                    force_n: &bad_loads,
                },
            ] {
                let report = model.step(&drive, 0.01);
                assert!(
                    matches!(report.outcome, Outcome::Failed(_)),
                    "{form:?} {report:?}"
                );
                assert_eq!(model.positions_m(), before);
            }
            let plates = between_plates(&mesh, [0.001; 3]);
            let again = model.step(&held(&plates), 0.01);
            assert!(again.energy_j.is_finite() && !matches!(again.outcome, Outcome::Failed(_)));
            assert!(matches!(
                model.step(&held(&plates), f64::NAN).outcome,
                Outcome::Failed(_)
            ));
        }
    }
}

#[test]
fn after_a_step_that_failed_all_goes_on_as_if_it_had_not_been() {
    let mesh = block();
    let by = |z| between_plates(&mesh, [0.001, 0.0, z]);
    let prony = vec![Prony {
        share: 0.5,
        time_s: 0.58,
    }];
    for (law, lanes, relaxation, nearest) in [
        (laws()[0], Lanes::Wide, prony.clone(), 5),
        (laws()[1], Lanes::Wide, Vec::new(), 5),
        (laws()[2], Lanes::Wide, prony, 3),
        (laws()[0], Lanes::Scalar, Vec::new(), 40),
    ] {
        let settings = Settings {
            lanes,
            relaxation,
            ..precise(Form::Balanced, 5)
        };
        // The further, the sooner forces pass the greatest number there is: at first in the last part of the way, in the end in
        // the first.
        let mut parts = Vec::new();
        for far in (nearest..).map(|exponent| 10f64.powi(exponent)) {
            let [mut spared, mut struck] = [0, 1].map(|_| build(&mesh, law, settings.clone()));
            spared.step(&held(&by(-0.001)), 0.01);
            struck.step(&held(&by(-0.001)), 0.01);
            let report = struck.step(&held(&by(far)), 0.01);
            if !matches!(report.outcome, Outcome::Failed(_)) {
                continue;
            }
            for z in [-0.001, -0.002] {
                // As words: what is not kept account of is no number, which is not equal to itself.
                let reports = [&mut spared, &mut struck]
                    .map(|model| format!("{:?}", model.step(&held(&by(z)), 0.01)));
                assert_eq!(reports[0], reports[1], "{law:?} {lanes:?}, {far:e} m");
                assert_eq!(spared.positions_m(), struck.positions_m());
                assert_eq!(spared.reactions_n(), struck.reactions_n());
                assert_eq!(spared.work_j(), struck.work_j());
                assert!(struck.work_j().is_finite());
            }
            parts.push(report.iterations.div_ceil(settings.iterations));
            if parts.ends_with(&[1]) {
                break;
            }
        }
        assert!(parts[0] > 1, "{law:?} {lanes:?}: {parts:?}");
    }
}

#[test]
fn the_tangent_is_that_of_whole_steps() {
    let mesh = block();
    for lanes in [Lanes::Scalar, Lanes::Wide] {
        let settings = Settings {
            lanes,
            tolerance: 1e-5,
            ..precise(Form::Balanced, 60)
        };
        let by = [0.001, 0.0005, -0.002];
        let plates = between_plates(&mesh, by);
        let moved: Vec<usize> = (0..plates.len()).filter(|k| plates[*k].1 == by).collect();
        let sum = |model: &EnergyBalance| -> Vector3<f64> {
            moved
                .iter()
                .map(|k| Vector3::from(model.reactions_n()[*k]))
                .sum()
        };
        let mut model = build(&mesh, laws()[2], settings);
        model.step(&held(&plates), 0.01);
        let before = model.positions_m().to_vec();
        let tangent = model
            .tangent(&held(&plates), &moved, 0.01)
            .expect("a tangent");
        assert!(tangent.error < 3e-4, "{lanes:?}: {}", tangent.error);
        assert_eq!(model.positions_m(), before);
        let reference = precise(Form::Balanced, 300);
        for axis in 0..3 {
            let [ahead, behind] = [1e-4, -1e-4].map(|step| {
                let mut to = by;
                to[axis] += step;
                let mut other = build(&mesh, laws()[2], reference.clone());
                other.step(&held(&between_plates(&mesh, to)), 0.01);
                sum(&other)
            });
            let exact = (ahead - behind) / 2e-4;
            for row in 0..3 {
                let stiffness = tangent.stiffness_n_per_m[row][axis];
                assert!((stiffness - exact[row]).abs() < 2e-3 * exact.norm());
            }
        }
        let next = model.step(&held(&plates), 0.01);
        assert!(next.residual < 1e-4);
    }
}

#[test]
fn there_is_no_tangent_where_a_trial_does_not_stay_finite() {
    let mesh = block();
    for lanes in [Lanes::Scalar, Lanes::Wide] {
        let settings = Settings {
            lanes,
            ..precise(Form::Balanced, 20)
        };
        let mut model = build(&mesh, laws()[1], settings);
        let (near, far) = ([0.001; 3], [1e200, 0.0, 0.0]);
        let plates = between_plates(&mesh, near);
        let moved: Vec<usize> = (0..plates.len()).filter(|k| plates[*k].1 == near).collect();
        model.step(&held(&plates), 0.01);
        let before = model.tangent(&held(&plates), &moved, 0.01);
        assert!(before.is_some_and(|tangent| tangent.error.is_finite()));
        let gone = model.tangent(&held(&between_plates(&mesh, far)), &moved, 0.01);
        assert_eq!(gone, None, "{lanes:?}");
        assert_eq!(model.tangent(&held(&plates), &moved, 0.01), before);
    }
}

#[test]
fn what_is_out_of_range_is_refused() {
    let mesh = block();
    let refused =
        |laws: &[Law], settings: Settings| EnergyBalance::new(&mesh, laws, settings).is_err();
    let law = laws()[1];
    assert!(refused(&[], Settings::default()));
    assert!(refused(&[law; 2], Settings::default()));
    assert!(!refused(
        &vec![law; mesh.cells().len()],
        Settings::default()
    ));
    let none = |change: fn(&mut Settings)| {
        let mut settings = Settings::default();
        change(&mut settings);
        settings
    };
    assert!(refused(&[law], none(|s| s.iterations = 0)));
    assert!(refused(&[law], none(|s| s.load_steps = 0)));
    assert!(refused(&[law], none(|s| s.density_kg_per_m3 = f64::NAN)));
    assert!(refused(&[law], none(|s| s.proximity = 0.0)));
    let prony = |share, time_s| vec![Prony { share, time_s }];
    for relaxation in [prony(1.0, 1.0), prony(-0.1, 1.0), prony(0.5, 0.0)] {
        let settings = Settings {
            relaxation,
            ..Settings::default()
        };
        assert!(refused(&[law], settings));
    }
    let bad = Law::NeoHookean {
        mu: -1.0,
        kappa: 1.0,
        eta: 0.0,
        fibre: Vector3::z(),
    };
    assert!(refused(&[bad], Settings::default()));
}
