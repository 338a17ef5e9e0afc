//! Shape matching: rest, rigid motion, momenta, forces, recovery, inversion, extremes, no allocation.

// An axis indexes several arrays at once.
#![allow(clippy::needless_range_loop)]

use nalgebra::{Rotation3, Vector3};
use sutura_mesh::{TetMesh, slab};
use sutura_models::shape_matching::{ShapeMatching, ShapeMatchingSettings};
use sutura_models::{BoundaryConditions, BuildError, Material, Outcome, Tissue};

const LIVER: Material = Material {
    youngs_modulus_pa: 3_500.0,
    poisson_ratio: 0.47,
};
const STEP_S: f64 = 1e-3;

fn cube(divisions: usize) -> TetMesh {
    slab([0.02; 3], [divisions; 3]).expect("a cube")
}

fn tissue(mesh: &TetMesh, settings: ShapeMatchingSettings) -> ShapeMatching {
    ShapeMatching::new(mesh, LIVER, settings).expect("a model")
}

/// The bottom held, and a square in the middle of the top moved; the latter's places in the list.
fn poke(mesh: &TetMesh, half_m: f64, by: [f64; 3]) -> (Vec<(u32, [f64; 3])>, Vec<usize>) {
    let (mut held, mut moved) = (Vec::new(), Vec::new());
    let low = mesh.points_m()[0][2];
    for (node, p) in mesh.points_m().iter().enumerate() {
        if p[2] < low + 1e-9 {
            held.push((node as u32, [0.0; 3]));
        } else if p[2] > -1e-9 && p[0].abs() <= half_m && p[1].abs() <= half_m {
            moved.push(held.len());
            held.push((node as u32, by));
        }
    }
    (held, moved)
}

fn held_only(held: &[(u32, [f64; 3])]) -> BoundaryConditions<'_> {
    BoundaryConditions { held, force_n: &[] }
}

fn sum(tissue: &ShapeMatching, of: &[usize], axis: usize) -> f64 {
    of.iter().map(|at| tissue.reactions_n()[*at][axis]).sum()
}

fn greatest_distance(a: &[[f64; 3]], b: &[[f64; 3]]) -> f64 {
    a.iter()
        .zip(b)
        .map(|(a, b)| (Vector3::from(*a) - Vector3::from(*b)).norm())
        .fold(0.0, f64::max)
}

#[test]
fn rest_stays_at_rest_and_held_nodes_carry_the_body_rigidly() {
    let mesh = cube(4);
    let settings = ShapeMatchingSettings::default();
    let mut resting = tissue(&mesh, settings);
    let (held, _) = poke(&mesh, 0.004, [0.0; 3]);
    for _ in 0..200 {
        assert_eq!(
            resting.step(&held_only(&held), STEP_S).outcome,
            Outcome::Converged
        );
    }
    assert!(greatest_distance(resting.positions_m(), mesh.points_m()) < 1e-12);
    assert!(
        resting
            .reactions_n()
            .iter()
            .flatten()
            .all(|f| f.abs() < 1e-10)
    );

    let boundary = mesh.surface().vertices;
    let turn = Vector3::new(0.4, -1.0, 0.6);
    let at = |t: f64, p: &[f64; 3]| {
        Rotation3::from_scaled_axis(turn * t) * Vector3::from(*p)
            + Vector3::new(0.01, 0.02, -0.03) * t
    };
    let mut body = tissue(&mesh, settings);
    for step in 0..1500 {
        let t = f64::from(step.min(200)) / 200.0;
        let held: Vec<(u32, [f64; 3])> = boundary
            .iter()
            .map(|node| {
                let p = &mesh.points_m()[*node as usize];
                (*node, (at(t, p) - Vector3::from(*p)).into())
            })
            .collect();
        body.step(&held_only(&held), STEP_S);
    }
    let expected: Vec<[f64; 3]> = mesh.points_m().iter().map(|p| at(1.0, p).into()).collect();
    let off = greatest_distance(body.positions_m(), &expected);
    assert!(off < 1e-7, "{off}");
    assert!(body.reactions_n().iter().flatten().all(|f| f.abs() < 1e-5));
}

#[test]
fn both_momenta_last_where_nothing_is_held() {
    let mesh = cube(4);
    let mut body = tissue(&mesh, ShapeMatchingSettings::default());
    let velocities: Vec<[f64; 3]> = mesh
        .points_m()
        .iter()
        .map(|p| {
            let p = Vector3::from(*p);
            let v = Vector3::new(0.3, -0.2, 0.5)
                + Vector3::new(5.0, -8.0, 3.0).cross(&p)
                + Vector3::new(100.0 * p.x, -80.0 * p.y, 4e3 * p.x * p.z);
            v.into()
        })
        .collect();
    body.step(&BoundaryConditions::default(), STEP_S);
    body.set_velocities(&velocities);
    let first = body.step(&BoundaryConditions::default(), STEP_S);
    let scale = 1060.0 * 8e-6 * body.mass_factor() * 2.0;
    let mut strained = 0.0f64;
    for _ in 0..500 {
        let report = body.step(&BoundaryConditions::default(), STEP_S);
        strained = strained.max(report.energy_j);
        let off = Vector3::from(report.momentum) - Vector3::from(first.momentum);
        assert!(off.norm() < 1e-13 * scale, "{off}");
        let off = Vector3::from(report.angular_momentum) - Vector3::from(first.angular_momentum);
        assert!(off.norm() < 1e-13 * scale * 0.4, "{off}");
    }
    // It did deform, and came to move rigidly.
    assert!(strained > 1e-5, "{strained}");
    let last = body.step(&BoundaryConditions::default(), STEP_S);
    assert!(
        last.energy_j < 1e-2 * strained,
        "{} {strained}",
        last.energy_j
    );
}

#[test]
fn a_stretched_bar_has_youngs_modulus_the_finer_the_better() {
    let strain = 0.01;
    let expected = 3_500.0 * 1e-4 * strain;
    let force = |across: usize, density_kg_per_m3, step_s| {
        let mesh = slab([0.01, 0.01, 0.03], [across, across, 3 * across]).expect("a bar");
        let (held, moved) = poke(&mesh, 1.0, [0.0, 0.0, strain * 0.03]);
        let settings = ShapeMatchingSettings {
            density_kg_per_m3,
            ..ShapeMatchingSettings::default()
        };
        let mut bar = tissue(&mesh, settings);
        let mut report = bar.step(&held_only(&held), step_s);
        for _ in 0..10_000 {
            if report.residual < 1e-5 {
                break;
            }
            report = bar.step(&held_only(&held), step_s);
        }
        assert!(report.residual < 1e-5, "{report:?}");
        let opposite: f64 = bar.reactions_n().iter().map(|r| r[2]).sum();
        let force = sum(&bar, &moved, 2);
        assert!(opposite.abs() < 1e-3 * force);
        // Energy is work: the force is the gradient.
        assert!((report.energy_j / (0.5 * force * strain * 0.03) - 1.0).abs() < 1e-3);
        force
    };
    let off: Vec<f64> = [2, 4, 6]
        .map(|across| (force(across, 1060.0, STEP_S) / expected - 1.0).abs())
        .into();
    assert!(
        off[2] < 0.25 && off[2] < off[1] && off[1] < off[0],
        "{off:?}"
    );
    // Neither mass nor step has a say.
    let here = force(2, 1060.0, STEP_S);
    for (density, step_s) in [
        (106.0, STEP_S),
        (10_600.0, STEP_S),
        (1060.0, 1e-4),
        (1060.0, 1e-2),
    ] {
        let there = force(2, density, step_s);
        assert!(
            (there / here - 1.0).abs() < 1e-3,
            "{density} {step_s} {here} {there}"
        );
    }
}

#[test]
fn what_was_let_go_recovers_at_its_rate_and_slower_and_slower() {
    let mesh = cube(5);
    let dent = |recovery_per_s| {
        let settings = ShapeMatchingSettings {
            recovery_per_s,
            ..ShapeMatchingSettings::default()
        };
        let mut body = tissue(&mesh, settings);
        let (held, moved) = poke(&mesh, 0.005, [0.0, 0.0, -3e-3]);
        for _ in 0..500 {
            body.step(&held_only(&held), STEP_S);
        }
        let node = held[moved[0]].0 as usize;
        let (bottom, _) = poke(&mesh, -1.0, [0.0; 3]);
        let mut depths = Vec::new();
        for _ in 0..1000 {
            body.step(&held_only(&bottom), STEP_S);
            depths.push(-body.positions_m()[node][2]);
        }
        (depths, body.limited()[node])
    };
    let (kept, limited) = dent(0.0);
    assert_eq!(limited, 1.0);
    assert!(
        kept.iter().all(|depth| (depth - 3e-3).abs() < 1e-4),
        "{:?}",
        kept.last()
    );
    let (slow, limited) = dent(2.0);
    assert_eq!(limited, 0.0);
    let (fast, _) = dent(f64::INFINITY);
    // At once it hardly moves; in the end it is back; plain shape matching is back sooner.
    assert!(
        slow[10] > 2.9e-3 && slow[999] < 3e-4,
        "{} {}",
        slow[10],
        slow[999]
    );
    assert!(fast[100] < slow[100] - 1e-4, "{} {}", fast[100], slow[100]);
}

#[test]
fn a_body_turned_inside_out_comes_back() {
    // The top is pushed through the bottom and let go.
    let mesh = cube(3);
    let settings = ShapeMatchingSettings {
        recovery_per_s: f64::INFINITY,
        ..ShapeMatchingSettings::default()
    };
    let mut body = tissue(&mesh, settings);
    let (held, _) = poke(&mesh, 1.0, [0.0, 0.0, -0.035]);
    for _ in 0..300 {
        body.step(&held_only(&held), STEP_S);
    }
    let (bottom, _) = poke(&mesh, -1.0, [0.0; 3]);
    for _ in 0..6000 {
        body.step(&held_only(&bottom), STEP_S);
    }
    let off = greatest_distance(body.positions_m(), mesh.points_m());
    assert!(off < 1e-4, "{off}");
}

#[test]
fn the_same_inputs_give_the_same_bits_and_nothing_is_allocated() {
    let mesh = cube(4);
    let drives: Vec<_> = (0..100)
        .map(|step| {
            let depth = 5e-3 * (f64::from(step) * 0.05).sin();
            poke(&mesh, 0.005, [depth, 0.5 * depth, -depth]).0
        })
        .collect();
    let run = || {
        let mut body = tissue(&mesh, ShapeMatchingSettings::default());
        body.step(&held_only(&drives[0]), STEP_S);
        let counted = allocation_counter::measure(|| {
            for held in &drives {
                body.step(&held_only(held), STEP_S);
                body.tangent(&held_only(held), &[0], STEP_S)
                    .expect("a tangent");
            }
            body.step(&BoundaryConditions::default(), 1e-4);
        });
        assert_eq!(counted.count_total, 0);
        body.positions_m().to_vec()
    };
    assert_eq!(run(), run());
}

#[test]
fn loads_and_tangent() {
    let mesh = cube(5);
    let (held, _) = poke(&mesh, -1.0, [0.0; 3]);
    let mut force_n = vec![[0.0; 3]; mesh.points_m().len()];
    let top: Vec<usize> = (0..force_n.len())
        .filter(|node| mesh.points_m()[*node][2] > -1e-9)
        .collect();
    for node in &top {
        force_n[*node] = [0.0, 0.0, -0.01 / top.len() as f64];
    }
    let drive = BoundaryConditions {
        held: &held,
        force_n: &force_n,
    };
    let mut body = tissue(&mesh, ShapeMatchingSettings::default());
    for _ in 0..3000 {
        body.step(&drive, STEP_S);
    }
    let ground: f64 = body.reactions_n().iter().map(|r| r[2]).sum();
    assert!((ground - 0.01).abs() < 1e-5, "{ground}");

    let (held, moved) = poke(&mesh, 0.005, [0.0, 0.0, -1e-3]);
    for _ in 0..1000 {
        body.step(&held_only(&held), STEP_S);
    }
    let before = body.positions_m().to_vec();
    let tangent = body
        .tangent(&held_only(&held), &moved, STEP_S)
        .expect("a tangent");
    assert_eq!(body.positions_m(), before);
    assert!(tangent.error < 0.01, "{tangent:?}");
    let at_rest = sum(&body, &moved, 2);
    let (deeper, _) = poke(&mesh, 0.005, [0.0, 0.0, -1.01e-3]);
    body.step(&held_only(&deeper), STEP_S);
    let change = (sum(&body, &moved, 2) - at_rest) / -1e-5;
    let said = tangent.stiffness_n_per_m[2][2];
    assert!(
        said > 0.0 && (change / said - 1.0).abs() < 0.02,
        "{change} {said}"
    );
    assert!(body.tangent(&held_only(&held), &[], STEP_S).is_none());
}

#[test]
fn extremes_end_in_a_word_and_finite_positions() {
    let mesh = cube(3);
    let mut body = tissue(&mesh, ShapeMatchingSettings::default());
    let finite = |body: &ShapeMatching| {
        let all = body.positions_m().iter().chain(body.reactions_n());
        all.flatten().all(|x| x.is_finite())
    };
    for step_s in [1e-6, 1e-4, 1e-3, 1e-2, 1.0] {
        for by in [
            [0.0, 0.0, 0.2],
            [0.2, -0.2, 0.0],
            [0.0; 3],
            [0.0, 0.0, -0.2],
        ] {
            let (held, _) = poke(&mesh, 0.004, by);
            for _ in 0..5 {
                let report = body.step(&held_only(&held), step_s);
                assert!(!matches!(report.outcome, Outcome::Failed(_)) && finite(&body));
            }
        }
    }
    let (held, _) = poke(&mesh, 0.004, [0.0; 3]);
    for _ in 0..4000 {
        body.step(&held_only(&held), STEP_S);
    }
    assert!(greatest_distance(body.positions_m(), mesh.points_m()) < 1e-3);
    let before = body.positions_m().to_vec();
    let (nan, _) = poke(&mesh, 0.004, [0.0, f64::NAN, 0.0]);
    let (far, _) = poke(&mesh, 0.004, [0.0, 1e200, 0.0]);
    for (held, step_s) in [
        (&nan, STEP_S),
        (&far, STEP_S),
        (&held, f64::NAN),
        (&held, -1.0),
    ] {
        let report = body.step(&held_only(held), step_s);
        assert!(matches!(report.outcome, Outcome::Failed(_)), "{report:?}");
        assert_eq!(body.positions_m(), before);
    }
    let report = body.step(&held_only(&held), STEP_S);
    assert!(report.outcome == Outcome::Converged && finite(&body));
}

#[test]
fn settings_are_checked_and_named() {
    let mesh = cube(1);
    let default = ShapeMatchingSettings::default();
    for (name, settings) in [
        (
            "rings",
            ShapeMatchingSettings {
                rings: 0,
                ..default
            },
        ),
        (
            "recovery_per_s",
            ShapeMatchingSettings {
                recovery_per_s: f64::NAN,
                ..default
            },
        ),
        (
            "relaxation_s",
            ShapeMatchingSettings {
                relaxation_s: -1.0,
                ..default
            },
        ),
        (
            "density_kg_per_m3",
            ShapeMatchingSettings {
                density_kg_per_m3: 0.0,
                ..default
            },
        ),
    ] {
        let error = ShapeMatching::new(&mesh, LIVER, settings).err();
        assert!(
            matches!(error, Some(BuildError::Setting { name: said, .. }) if said == name),
            "{name} {error:?}"
        );
    }
}
