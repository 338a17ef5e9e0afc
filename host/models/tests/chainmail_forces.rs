//! Forces of both ChainMails: against the material, against each other's energy, and the curves of soft tissue.

// An axis indexes several arrays at once.
#![allow(clippy::needless_range_loop)]

use sutura_mesh::{TetMesh, slab};
use sutura_models::chainmail::{
    ClassicalChainMail, ClassicalSettings, EllipsoidChainMail, EllipsoidSettings,
};
use sutura_models::shape_matching::{ShapeMatching, ShapeMatchingSettings};
use sutura_models::{BoundaryConditions, Diagnostics, Material, Outcome, Tissue};

const LIVER: Material = Material {
    youngs_modulus_pa: 3_500.0,
    poisson_ratio: 0.47,
};
const STEP_S: f64 = 1e-3;

fn cube(divisions: usize) -> TetMesh {
    slab([0.02; 3], [divisions; 3]).expect("a cube")
}

fn ellipsoid(mesh: &TetMesh, settings: EllipsoidSettings) -> EllipsoidChainMail {
    EllipsoidChainMail::new(mesh, LIVER, settings).expect("a model")
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

fn step(tissue: &mut dyn Tissue, held: &[(u32, [f64; 3])], step_s: f64) -> Diagnostics {
    let report = tissue.step(&BoundaryConditions { held, force_n: &[] }, step_s);
    assert!(!matches!(report.outcome, Outcome::Failed(_)));
    report
}

fn sum(tissue: &dyn Tissue, of: &[usize], axis: usize) -> f64 {
    of.iter().map(|at| tissue.reactions_n()[*at][axis]).sum()
}

#[test]
fn a_stretched_bar_has_youngs_modulus() {
    let mesh = slab([0.01, 0.01, 0.04], [3, 3, 12]).expect("a bar");
    let strain = 0.01;
    let (held, moved) = poke(&mesh, 1.0, [0.0, 0.0, strain * 0.04]);
    let expected = 3_500.0 * 1e-4 * strain;
    let mut one = ellipsoid(&mesh, EllipsoidSettings::default());
    let classical = ClassicalSettings {
        relaxations: 50,
        ..ClassicalSettings::default()
    };
    let mut other = ClassicalChainMail::new(&mesh, LIVER, classical).expect("a model");
    for tissue in [&mut one as &mut dyn Tissue, &mut other] {
        let mut report = step(tissue, &held, STEP_S);
        for _ in 0..1500 {
            report = step(tissue, &held, STEP_S);
        }
        let force = sum(tissue, &moved, 2);
        // The ends are clamped, and edges of this mesh do not point everywhere alike.
        assert!((force / expected - 1.0).abs() < 0.1, "{}", force / expected);
        // The other end holds against it, and the energy is the work.
        let opposite: f64 = tissue.reactions_n().iter().map(|r| r[2]).sum();
        assert!(opposite.abs() < 1e-3 * force, "{opposite} {force}");
        let work = 0.5 * force * strain * 0.04;
        assert!(
            (report.energy_j / work - 1.0).abs() < 0.02,
            "{}",
            report.energy_j / work
        );
    }
}

#[test]
fn forces_at_rest_know_neither_mass_nor_step() {
    let mesh = cube(5);
    let (held, moved) = poke(&mesh, 0.005, [0.0, 0.0, -1e-3]);
    let mut forces = Vec::new();
    for (density, step_s) in [
        (1060.0, 1e-3),
        (106.0, 1e-3),
        (10_600.0, 1e-3),
        (1060.0, 1e-4),
        (1060.0, 5e-3),
    ] {
        let settings = EllipsoidSettings {
            density_kg_per_m3: density,
            ..EllipsoidSettings::default()
        };
        let mut tissue = ellipsoid(&mesh, settings);
        let mut report = step(&mut tissue, &held, step_s);
        for _ in 0..20_000 {
            report = step(&mut tissue, &held, step_s);
            if report.residual < 1e-4 {
                break;
            }
        }
        assert!(report.residual < 1e-4, "{density} {step_s} {report:?}");
        forces.push(sum(&tissue, &moved, 2));
    }
    for force in &forces {
        assert!((force / forces[0] - 1.0).abs() < 2e-3, "{forces:?}");
    }
}

#[test]
fn reactions_are_what_changes_the_momentum() {
    let mesh = cube(4);
    let (held, _) = poke(&mesh, -1.0, [0.0; 3]);
    let velocities: Vec<[f64; 3]> = mesh
        .points_m()
        .iter()
        .map(|p| [20.0 * (p[2] + 0.02) + 0.3, 30.0 * p[0], -25.0 * p[1] - 0.4])
        .collect();
    // Without drag, and with springs or with limits alone: a spring's force acts in the step after the one
    // that reports it, a limit's in its own.
    for (stiffness, limit, later) in [(1.0, 0.9, true), (0.0, 0.1, false)] {
        let settings = EllipsoidSettings {
            relaxation_s: 0.0,
            strain_limit: [limit; 3],
            stiffness,
            visits: 50,
            sleep_m_per_s: 0.0,
            ..EllipsoidSettings::default()
        };
        let mut tissue = ellipsoid(&mesh, settings);
        let scale = if later { 0.05 } else { 1.0 };
        let slow: Vec<[f64; 3]> = velocities.iter().map(|v| v.map(|v| scale * v)).collect();
        tissue.set_velocities(&slow);
        let mut last = step(&mut tissue, &held, STEP_S).momentum;
        let total = |tissue: &dyn Tissue| {
            let of = |axis: usize| tissue.reactions_n().iter().map(|r| r[axis]).sum::<f64>();
            [of(0), of(1), of(2)]
        };
        let (mut before, mut largest, mut adjusted) = (total(&tissue), 0.0f64, 0);
        for _ in 0..100 {
            let now = step(&mut tissue, &held, STEP_S).momentum;
            let after = total(&tissue);
            let force = if later { before } else { after };
            for axis in 0..3 {
                let change = (now[axis] - last[axis]) / STEP_S;
                largest = largest.max(change.abs());
                assert!(
                    (change - force[axis]).abs() < 1e-9,
                    "{stiffness} {change} {force:?}"
                );
            }
            adjusted += tissue.adjusted();
            (last, before) = (now, after);
        }
        assert!(largest > 1e-4, "{largest}");
        assert_eq!(adjusted > 0, !later, "{adjusted}");
    }
}

#[test]
fn what_classical_propagation_hands_back_is_the_derivative_of_its_energy() {
    // From rest, in one step and as printed, a patch that moves drags others; the springs' energy at the
    // end is a function of its displacement alone, and its derivative must be the reaction.
    let mesh = cube(6);
    let settings = ClassicalSettings {
        relaxations: 0,
        tolerance: 1e-9,
        ..ClassicalSettings::default()
    };
    let run = |by: [f64; 3]| {
        let (held, moved) = poke(&mesh, 0.004, by);
        let mut tissue = ClassicalChainMail::new(&mesh, LIVER, settings).expect("a model");
        let report = step(&mut tissue, &held, STEP_S);
        assert_eq!(report.outcome, Outcome::Converged);
        let reaction = [0, 1, 2].map(|axis| sum(&tissue, &moved, axis));
        (report.energy_j, reaction, tissue.moved())
    };
    for by in [
        [0.0, 0.0, -4.6e-3],
        [2.3e-3, 0.7e-3, -4.1e-3],
        [0.0, 0.0, 5.3e-3],
    ] {
        let (_, reaction, moved) = run(by);
        assert!(moved > 50, "{moved}");
        let size = reaction.iter().map(|r| r * r).sum::<f64>().sqrt();
        for axis in 0..3 {
            let h = 1e-7;
            let mut ends = [0.0; 2];
            for (end, sign) in ends.iter_mut().zip([1.0, -1.0]) {
                let mut at = by;
                at[axis] += sign * h;
                *end = run(at).0;
            }
            let derivative = (ends[0] - ends[1]) / (2.0 * h);
            assert!(
                (derivative - reaction[axis]).abs() < 1e-4 * size,
                "{axis} {derivative} {reaction:?}"
            );
        }
    }
}

#[test]
fn pressing_deeper_gets_stiffer_and_tighter_limits_sooner() {
    let mesh = cube(10);
    // Force at every half millimetre up to 3.5 mm, at 5 mm/s.
    let forces = |limit: f64| {
        let settings = EllipsoidSettings {
            strain_limit: [limit; 3],
            visits: 50,
            ..EllipsoidSettings::default()
        };
        let mut tissue = ellipsoid(&mesh, settings);
        let mut forces = Vec::new();
        for tick in 0..=700 {
            let (held, moved) = poke(&mesh, 0.0041, [0.0, 0.0, -5e-6 * f64::from(tick)]);
            step(&mut tissue, &held, STEP_S);
            if tick % 100 == 0 {
                forces.push(-sum(&tissue, &moved, 2));
            }
        }
        forces
    };
    let [tight, middle, wide] = [0.1, 0.3, 0.5].map(forces);
    let slope = |forces: &[f64], at: usize| forces[at] - forces[at - 1];
    // The springs alone soften, as cells fold; the limits stiffen, the tight ones sooner.
    assert!(slope(&tight, 4) > 1.5 * slope(&tight, 2), "{tight:?}");
    assert!(slope(&middle, 7) > 1.2 * slope(&middle, 3), "{middle:?}");
    assert!(slope(&middle, 4) < 1.2 * slope(&middle, 2), "{middle:?}");
    assert!(tight[4] > 1.5 * middle[4] && middle[4] > 1.02 * wide[4]);
    assert!(middle[7] > 1.15 * wide[7], "{middle:?} {wide:?}");
}

#[test]
fn a_point_pressed_in_gets_stiffer_at_every_limit() {
    let mesh = cube(10);
    // Mean force over each quarter of a millimetre up to 2.75 mm, at 5 mm/s.
    let forces = |limit: f64| {
        let settings = EllipsoidSettings {
            strain_limit: [limit; 3],
            visits: 50,
            ..EllipsoidSettings::default()
        };
        let mut tissue = ellipsoid(&mesh, settings);
        let mut forces = [0.0; 11];
        for tick in 0..550 {
            let depth = 5e-6 * f64::from(tick + 1);
            let (held, moved) = poke(&mesh, 1e-6, [0.0, 0.0, -depth]);
            assert_eq!(moved.len(), 1);
            step(&mut tissue, &held, STEP_S);
            forces[tick as usize / 50] -= sum(&tissue, &moved, 2) / 50.0;
        }
        forces
    };
    let all = [0.1, 0.3, 0.5].map(forces);
    for forces in &all {
        let stiffness = |to: usize| forces[to] - forces[to - 4];
        assert!(stiffness(10) > 2.0 * stiffness(4), "{forces:?}");
    }
    let [tight, middle, wide] = all.map(|forces| forces[7]);
    assert!(
        tight > 2.0 * middle && middle > 1.2 * wide,
        "{tight} {middle} {wide}"
    );
}

#[test]
fn loading_and_unloading_enclose_an_area_that_shrinks_with_speed() {
    let mesh = cube(6);
    let mut areas = Vec::new();
    for ticks in [100, 400, 1600] {
        let mut tissue = ellipsoid(&mesh, EllipsoidSettings::default());
        let (mut area, mut peak, mut last) = (0.0, 0.0f64, (0.0, 0.0));
        for tick in 1..=2 * ticks {
            let up = f64::from(if tick <= ticks {
                tick
            } else {
                2 * ticks - tick
            });
            let depth = 2e-3 * up / f64::from(ticks);
            let (held, moved) = poke(&mesh, 0.004, [0.0, 0.0, -depth]);
            step(&mut tissue, &held, STEP_S);
            let force = -sum(&tissue, &moved, 2);
            area += 0.5 * (force + last.1) * (depth - last.0);
            peak = peak.max(force);
            last = (depth, force);
        }
        // As a share of the square around the loop.
        areas.push(area / (peak * 2e-3));
    }
    assert!(areas[2] > 1e-3, "{areas:?}");
    assert!(
        areas[0] > 1.5 * areas[1] && areas[1] > 1.5 * areas[2],
        "{areas:?}"
    );
}

#[test]
fn at_a_constant_depth_the_force_falls_towards_a_value_above_zero() {
    let mesh = cube(6);
    let mut tissue = ellipsoid(&mesh, EllipsoidSettings::default());
    let mut forces = Vec::new();
    for tick in 1..=1500 {
        let depth = 2e-3 * (f64::from(tick) / 50.0).min(1.0);
        let (held, moved) = poke(&mesh, 0.004, [0.0, 0.0, -depth]);
        step(&mut tissue, &held, STEP_S);
        if tick > 50 {
            forces.push(-sum(&tissue, &moved, 2));
        }
    }
    let (first, end) = (forces[0], forces[forces.len() - 1]);
    assert!(end > 0.0 && first > 1.1 * end, "{first} {end}");
    for pair in forces.windows(2) {
        assert!(pair[1] <= pair[0] + 1e-4 * (first - end), "{pair:?}");
    }
    let quarter = forces[forces.len() / 4];
    assert!((quarter - end) < 0.2 * (first - end));
}

#[test]
fn a_load_is_borne_by_the_springs_and_the_ground() {
    let mesh = cube(5);
    let (held, _) = poke(&mesh, -1.0, [0.0; 3]);
    let mut force_n = vec![[0.0; 3]; mesh.points_m().len()];
    let top: Vec<usize> = (0..force_n.len())
        .filter(|node| mesh.points_m()[*node][2] > -1e-9)
        .collect();
    let total = -0.02;
    for node in &top {
        force_n[*node] = [0.0, 0.0, total / top.len() as f64];
    }
    let drive = BoundaryConditions {
        held: &held,
        force_n: &force_n,
    };
    let mut one = ellipsoid(&mesh, EllipsoidSettings::default());
    let mut other =
        ClassicalChainMail::new(&mesh, LIVER, ClassicalSettings::default()).expect("a model");
    let mut sunk = Vec::new();
    for tissue in [&mut one as &mut dyn Tissue, &mut other] {
        for _ in 0..3000 {
            tissue.step(&drive, STEP_S);
        }
        let ground: f64 = tissue.reactions_n().iter().map(|r| r[2]).sum();
        assert!((ground + total).abs() < 1e-3 * 0.02, "{ground}");
        let depth: f64 = top.iter().map(|node| tissue.positions_m()[*node][2]).sum();
        sunk.push(-depth / top.len() as f64);
    }
    // F h / (E A); the same load on every node is too much for edges and corners.
    let expected = 0.02 * 0.02 / (3_500.0 * 4e-4);
    for depth in &sunk {
        assert!((depth / expected - 1.0).abs() < 0.25, "{sunk:?} {expected}");
    }
    assert!((sunk[0] / sunk[1] - 1.0).abs() < 0.05, "{sunk:?}");
    // Unloaded, it comes back.
    let drive = BoundaryConditions {
        held: &held,
        force_n: &[],
    };
    for _ in 0..3000 {
        one.step(&drive, STEP_S);
    }
    let off = top.iter().map(|node| one.positions_m()[*node][2].abs());
    assert!(off.fold(0.0, f64::max) < 1e-2 * expected);
}

#[test]
fn the_tangent_is_the_change_of_the_reaction_in_a_step() {
    let mesh = cube(5);
    let (held, moved) = poke(&mesh, 0.005, [0.0, 0.0, -1e-3]);
    let classical = ClassicalSettings {
        relaxations: 20,
        ..ClassicalSettings::default()
    };
    let mut one = ellipsoid(&mesh, EllipsoidSettings::default());
    let mut other = ClassicalChainMail::new(&mesh, LIVER, classical).expect("a model");
    for tissue in [&mut one as &mut dyn Tissue, &mut other] {
        for _ in 0..1000 {
            step(tissue, &held, STEP_S);
        }
        let drive = BoundaryConditions {
            held: &held,
            force_n: &[],
        };
        let before = tissue.positions_m().to_vec();
        let tangent = tissue.tangent(&drive, &moved, STEP_S).expect("a tangent");
        assert_eq!(tissue.positions_m(), before);
        assert!(tangent.error < 0.05, "{tangent:?}");
        let at_rest = sum(tissue, &moved, 2);
        let further = 1e-5;
        let (deeper, _) = poke(&mesh, 0.005, [0.0, 0.0, -1e-3 - further]);
        step(tissue, &deeper, STEP_S);
        let change = (sum(tissue, &moved, 2) - at_rest) / -further;
        let said = tangent.stiffness_n_per_m[2][2];
        assert!(
            said > 0.0 && (change / said - 1.0).abs() < 0.05,
            "{change} {said}"
        );
        assert!(tissue.tangent(&drive, &[], STEP_S).is_none());
    }
}

/// The tangent of nodes that nothing holds is what steps say that hold and move them; nothing is held afterwards.
#[test]
fn tangents_to_come_are_those_of_steps_that_hold() {
    let mesh = cube(5);
    let (ground, _) = poke(&mesh, -1.0, [0.0; 3]);
    let (poked, moved) = poke(&mesh, 0.006, [0.0; 3]);
    // By less and less of the common displacement; what is held already does not move with them.
    let part = |place: usize| 1.0 / (1.0 + place as f64);
    let mut touched: Vec<(u32, f64)> = (0..)
        .map(part)
        .zip(&moved)
        .map(|(part, at)| (poked[*at].0, part))
        .collect();
    let own = touched.len();
    touched.push((ground[0].0, 1.0));
    let models = || -> Vec<Box<dyn Tissue>> {
        let classical = ClassicalSettings {
            relaxations: 20,
            ..ClassicalSettings::default()
        };
        vec![
            Box::new(ellipsoid(&mesh, EllipsoidSettings::default())),
            Box::new(ClassicalChainMail::new(&mesh, LIVER, classical).expect("a model")),
            Box::new(
                ShapeMatching::new(&mesh, LIVER, ShapeMatchingSettings::default())
                    .expect("a model"),
            ),
        ]
    };
    let drive = BoundaryConditions {
        held: &ground,
        force_n: &[],
    };
    for (mut apart, (mut other, mut held)) in
        models().into_iter().zip(models().into_iter().zip(models()))
    {
        for tissue in [&mut apart, &mut other, &mut held] {
            step(&mut **tissue, &ground, STEP_S);
        }
        let tangent = apart
            .tangent_to_come(&drive, &touched, STEP_S)
            .expect("a tangent");
        let further = 1e-5;
        let mut deeper = poked.clone();
        for (at, (_, part)) in moved.iter().zip(&touched) {
            deeper[*at].1[2] = -further * part;
        }
        step(&mut *held, &deeper, STEP_S);
        let pushed: f64 = moved
            .iter()
            .zip(&touched)
            .map(|(at, (_, part))| part * held.reactions_n()[*at][2])
            .sum();
        let (said, change) = (tangent.stiffness_n_per_m[2][2], pushed / -further);
        assert!(
            said > 0.0 && (change / said - 1.0).abs() < 0.05,
            "{change} {said}"
        );
        // One that is held says nothing more.
        let without = apart.tangent_to_come(&drive, &touched[..own], STEP_S);
        assert_eq!(without, Some(tangent));
        assert!(
            apart
                .tangent_to_come(&drive, &touched[own..], STEP_S)
                .is_none()
        );
        // As if nobody had asked.
        for tissue in [&mut apart, &mut other] {
            step(&mut **tissue, &deeper, STEP_S);
        }
        assert_eq!(apart.positions_m(), other.positions_m());
    }
}

#[test]
fn limits_by_axis_and_by_region_have_their_way() {
    let mesh = cube(6);
    let stretch = |settings: EllipsoidSettings, axis: usize| {
        let mut tissue = ellipsoid(&mesh, settings);
        let mut by = [0.0; 3];
        by[axis] = 4e-3;
        let (held, moved) = poke(&mesh, 0.004, by);
        for _ in 0..400 {
            step(&mut tissue, &held, STEP_S);
        }
        sum(&tissue, &moved, axis)
    };
    let of = |strain_limit| EllipsoidSettings {
        strain_limit,
        visits: 50,
        ..EllipsoidSettings::default()
    };
    let (x_even, z_even) = (stretch(of([0.4; 3]), 0), stretch(of([0.4; 3]), 2));
    let (x_tight, z_tight) = (
        stretch(of([0.4, 0.4, 0.08]), 0),
        stretch(of([0.4, 0.4, 0.08]), 2),
    );
    // Tight along z: a pull along z meets it more than one along x.
    assert!(
        z_tight / z_even > 1.2 * x_tight / x_even,
        "{x_even} {x_tight} {z_even} {z_tight}"
    );
    // Tight on one side only: that side is dragged along further.
    let mut tissue = ellipsoid(&mesh, of([0.4; 3]));
    let x = |node: u32| mesh.points_m()[node as usize][0];
    tissue
        .set_limits(|a, b| {
            if x(a) + x(b) > 0.0 {
                [0.05; 3]
            } else {
                [0.4; 3]
            }
        })
        .expect("limits");
    let (held, _) = poke(&mesh, 0.002, [0.0, 0.0, 4e-3]);
    for _ in 0..400 {
        step(&mut tissue, &held, STEP_S);
    }
    let lifted = |side: f64| -> f64 {
        let nodes = (0..mesh.points_m().len()).filter(|n| x(*n as u32) * side > 1e-6);
        nodes
            .map(|n| tissue.positions_m()[n][2] - mesh.points_m()[n][2])
            .sum()
    };
    assert!(
        lifted(1.0) > 1.1 * lifted(-1.0),
        "{} {}",
        lifted(1.0),
        lifted(-1.0)
    );
}

/// Pressed beyond what its links allow, mail has no force any more, and says so.
#[test]
fn mail_that_jams_does_not_stand_by_its_forces() {
    let mesh = cube(8);
    let settings = EllipsoidSettings {
        strain_limit: [0.1; 3],
        ..EllipsoidSettings::default()
    };
    let mut tissue = ellipsoid(&mesh, settings);
    let (mut first_jam_m, mut before) = (None, 0.0);
    for tick in 1..=1000 {
        let depth_m = 5e-6 * f64::from(tick);
        let (held, _) = poke(&mesh, 1e-6, [0.0, 0.0, -depth_m]);
        let report = step(&mut tissue, &held, STEP_S);
        let excess = match report.outcome {
            Outcome::Unfinished => tissue.greatest_excess(),
            _ => 0.0,
        };
        // A step that brings back what jammed has no force either.
        let lacking = f64::max(excess, before) / (10.0 * settings.tolerance);
        before = excess;
        if lacking > 1.0 {
            assert_eq!(report.force_error, f64::INFINITY, "{depth_m}");
            first_jam_m = first_jam_m.or(Some(depth_m));
        } else {
            assert_eq!(report.force_error, lacking, "{depth_m}");
        }
    }
    let first_jam_m = first_jam_m.expect("5 mm under a point are too much");
    assert!(first_jam_m > 1e-3, "{first_jam_m}");
}
