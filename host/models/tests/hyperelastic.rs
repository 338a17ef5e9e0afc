//! Hyperelastic tissue as a caller sees it: patch test, tangents, momentum, drives that cannot be.

use sutura_mesh::{TetMesh, slab};
use sutura_models::hyperelastic::{Cells, Hyperelastic, Motion, Scheme, Settings};
use sutura_models::law::Law;
use sutura_models::{BoundaryConditions, Material, Outcome, Tissue};

const LIVER: Material = Material {
    youngs_modulus_pa: 3_500.0,
    poisson_ratio: 0.45,
};
const CELLS: [Cells; 3] = [Cells::Linear, Cells::Averaged, Cells::Quadratic];

fn laws() -> [Law; 3] {
    [
        Law::st_venant_kirchhoff(LIVER),
        Law::neo_hookean(LIVER),
        Law::fibred(LIVER, 2_400.0, [1.0, 2.0, -0.5]),
    ]
}

fn block() -> TetMesh {
    slab([0.06, 0.06, 0.04], [3, 3, 2]).expect("a slab")
}

fn tissue(law: Law, settings: Settings) -> Hyperelastic {
    Hyperelastic::new(&block(), &[law], settings).expect("tissue")
}

fn with(cells: Cells) -> Settings {
    Settings {
        cells,
        ..Settings::default()
    }
}

fn dynamic(cells: Cells, scheme: Scheme, drag_per_s: f64) -> Settings {
    Settings {
        motion: Motion::Implicit {
            density_kg_per_m3: 1_000.0,
            drag_per_s,
            scheme,
        },
        ..with(cells)
    }
}

type Node = (u32, [f64; 3]);
type Held = Vec<Node>;

/// Nodes of the block that `chosen` picks by rest position, displaced as it says.
fn hold(chosen: impl Fn([f64; 3]) -> Option<[f64; 3]>) -> Held {
    let mesh = block();
    let nodes = mesh.points_m().iter().enumerate();
    nodes
        .filter_map(|(node, p)| Some((node as u32, chosen(*p)?)))
        .collect()
}

fn bottom(p: [f64; 3]) -> bool {
    p[2] < -0.0399
}

fn top(p: [f64; 3]) -> bool {
    p[2] > -1e-4
}

fn bottom_held_top_moved(by: [f64; 3]) -> Held {
    hold(|p| match (bottom(p), top(p)) {
        (true, _) => Some([0.0; 3]),
        (_, true) => Some(by),
        _ => None,
    })
}

fn step(tissue: &mut Hyperelastic, held: &Held) -> sutura_models::Diagnostics {
    let drive = BoundaryConditions { held, force_n: &[] };
    tissue.step(&drive, 0.01)
}

fn sum_of(reactions: &[[f64; 3]], moved: &[usize]) -> [f64; 3] {
    let add = |sum: [f64; 3], &index: &usize| [0, 1, 2].map(|i| sum[i] + reactions[index][i]);
    moved.iter().fold([0.0; 3], add)
}

fn norm(x: [f64; 3]) -> f64 {
    x.iter().map(|x| x * x).sum::<f64>().sqrt()
}

fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|i| a[i] - b[i])
}

/// The boundary deformed as F says: so is the inside, and the energy is that of the law. With mid-edge nodes
/// at the mean of their ends this holds for quadratic cells as well.
#[test]
fn patch_test() {
    let f = [[1.15, 0.2, 0.0], [-0.1, 0.95, 0.1], [0.05, 0.0, 1.1]];
    let moved = |p: [f64; 3]| [0, 1, 2].map(|i| (0..3).map(|j| f[i][j] * p[j]).sum::<f64>() - p[i]);
    let boundary = block().surface().vertices;
    for cells in CELLS {
        for law in laws() {
            let mut tissue = tissue(law, with(cells));
            let points = block().points_m().to_vec();
            let held: Held = boundary
                .iter()
                .map(|&node| (node, moved(points[node as usize])))
                .collect();
            assert!(held.len() < points.len(), "nothing is free");
            let done = step(&mut tissue, &held);
            assert_eq!(done.outcome, Outcome::Converged);
            for (x, rest) in tissue.positions_m().iter().zip(&points) {
                let off = norm(minus(minus(*x, *rest), moved(*rest)));
                assert!(off < 1e-10, "{cells:?} {law:?}: {off}");
            }
            let matrix = nalgebra::Matrix3::from_fn(|i, j| f[i][j]);
            let expected = 0.06 * 0.06 * 0.04 * law.energy(&matrix);
            assert!(
                (done.energy_j / expected - 1.0).abs() < 1e-9,
                "{cells:?} {law:?}"
            );
        }
    }
}

/// A uniform traction on the end of a bar that may shrink freely: uniform stretch, in linear and in quadratic
/// cells, of the size that the law gives.
#[test]
fn a_uniform_traction_gives_a_uniform_stretch() {
    // Nothing is held, so that the sides are free to shrink everywhere: masses stand in for it.
    let mesh = block();
    let end = |high: bool| {
        let mut faces = mesh.surface().triangles;
        faces.retain(|face| {
            face.iter().all(|&node| {
                let p = mesh.points_m()[node as usize];
                if high { top(p) } else { bottom(p) }
            })
        });
        faces
    };
    let force = 0.9;
    for cells in CELLS {
        let law = Law::neo_hookean(LIVER);
        let mut tissue = tissue(law, dynamic(cells, Scheme::BackwardEuler, 0.0));
        tissue
            .add_traction(&end(true), [0.0, 0.0, force])
            .expect("faces");
        tissue
            .add_traction(&end(false), [0.0, 0.0, -force])
            .expect("faces");
        // Backward Euler with long steps is a way to balance without any node held.
        for _ in 0..6 {
            let drive = BoundaryConditions::default();
            assert_eq!(tissue.step(&drive, 100.0).outcome, Outcome::Converged);
        }
        let (_, f) = tissue.deformation(0, [0.25; 4]).expect("a cell");
        for cell in 0..mesh.cells().len() {
            let (_, here) = tissue
                .deformation(cell, [0.7, 0.1, 0.1, 0.1])
                .expect("a cell");
            let off = (0..3).map(|i| norm(minus(here[i], f[i]))).sum::<f64>();
            assert!(off < 1e-7, "{cells:?}: {off}");
        }
        let matrix = nalgebra::Matrix3::from_fn(|i, j| f[i][j]);
        let stress = law.stress(&matrix);
        assert!(
            (stress[(2, 2)] / (force / 0.0036) - 1.0).abs() < 1e-6,
            "{cells:?} {stress}"
        );
        assert!(stress[(0, 0)].abs() < 1e-6 * stress[(2, 2)]);
        assert!(f[2][2] > 1.06 && f[0][0] < 0.99, "{f:?}");
    }
}

/// The tangent of a group is what solves with the group a little further say.
#[test]
fn tangents_agree_with_perturbed_solves() {
    let by = [0.006, -0.003, 0.008];
    for (cells, law) in CELLS.into_iter().zip(laws()) {
        let mut still = tissue(law, with(cells));
        let held = bottom_held_top_moved(by);
        let moved: Vec<usize> = (0..held.len()).filter(|&i| held[i].1 == by).collect();
        assert_eq!(step(&mut still, &held).outcome, Outcome::Converged);
        let drive = BoundaryConditions {
            held: &held,
            force_n: &[],
        };
        let before = still.positions_m().to_vec();
        let tangent = still.tangent(&drive, &moved, 0.0).expect("a tangent");
        assert_eq!(before, still.positions_m());
        assert_eq!(tangent.error, 0.0);
        let h = 1e-5;
        for axis in 0..3 {
            let [ahead, behind] = [h, -h].map(|h| {
                let mut other = by;
                other[axis] += h;
                let mut tissue = tissue(law, with(cells));
                let held = bottom_held_top_moved(other);
                assert_eq!(step(&mut tissue, &held).outcome, Outcome::Converged);
                sum_of(tissue.reactions_n(), &moved)
            });
            for row in 0..3 {
                let by_difference = (ahead[row] - behind[row]) / (2.0 * h);
                let exact = tangent.stiffness_n_per_m[row][axis];
                assert!(
                    (exact - by_difference).abs() < 1e-5 * tangent.stiffness_n_per_m[2][2],
                    "{cells:?} {row} {axis}: {exact} {by_difference}"
                );
            }
        }
    }
}

/// The tangent of nodes that nothing holds is what solves that hold them say; nothing is held afterwards.
#[test]
fn tangents_to_come_agree_with_solves_that_hold() {
    for (cells, law) in CELLS.into_iter().zip(laws()) {
        let rest = hold(|p| bottom(p).then_some([0.0; 3]));
        // All of the top, by less the further along x.
        let share = |p: [f64; 3]| top(p).then(|| 1.0 - 5.0 * p[0].min(0.1));
        let points = block().points_m().to_vec();
        let touched: Vec<(u32, f64)> = (0u32..)
            .zip(&points)
            .filter_map(|(node, p)| Some((node, share(*p)?)))
            .collect();
        let held_by = |by: [f64; 3]| {
            hold(|p| {
                let part = share(p).or(bottom(p).then_some(0.0))?;
                Some(by.map(|x| part * x))
            })
        };
        let mut apart = tissue(law, with(cells));
        let drive = BoundaryConditions {
            held: &rest,
            force_n: &[],
        };
        let before = apart.tangent_to_come(&drive, &touched, 0.0);
        assert_eq!(before, None, "before any step");
        assert_eq!(step(&mut apart, &rest).outcome, Outcome::Converged);
        let tangent = apart
            .tangent_to_come(&drive, &touched, 0.0)
            .expect("a tangent");
        let h = 1e-6;
        let size = tangent.stiffness_n_per_m[2][2];
        assert!(size > 10.0, "{size}");
        for axis in 0..3 {
            let [ahead, behind] = [h, -h].map(|h| {
                let mut by = [0.0; 3];
                by[axis] = h;
                let mut tissue = tissue(law, with(cells));
                let held = held_by(by);
                assert_eq!(step(&mut tissue, &held).outcome, Outcome::Converged);
                let mut sum = [0.0; 3];
                for ((node, _), force) in held.iter().zip(tissue.reactions_n()) {
                    let part = share(points[*node as usize]).unwrap_or(0.0);
                    (0..3).for_each(|i| sum[i] += part * force[i]);
                }
                sum
            });
            for row in 0..3 {
                let by_difference = (ahead[row] - behind[row]) / (2.0 * h);
                let exact = tangent.stiffness_n_per_m[row][axis];
                assert!(
                    (exact - by_difference).abs() < 1e-5 * size,
                    "{cells:?} {row} {axis}: {exact} {by_difference}"
                );
            }
        }
        // As if nobody had asked.
        let mut other = tissue(law, with(cells));
        step(&mut other, &rest);
        let goes_on = held_by([0.0, 0.0, -0.004]);
        step(&mut apart, &goes_on);
        step(&mut other, &goes_on);
        assert_eq!(apart.positions_m(), other.positions_m());
    }
}

/// In dynamics the tangent knows of masses and of the time there is.
#[test]
fn tangents_of_dynamics_agree_with_perturbed_steps() {
    let by = [0.002, 0.001, 0.003];
    for (cells, scheme) in [
        (Cells::Quadratic, Scheme::BackwardEuler),
        (Cells::Averaged, Scheme::Midpoint),
    ] {
        let run = |by| {
            let mut tissue = tissue(Law::neo_hookean(LIVER), dynamic(cells, scheme, 3.0));
            let held = bottom_held_top_moved(by);
            assert_eq!(step(&mut tissue, &held).outcome, Outcome::Converged);
            (tissue, held)
        };
        let (mut still, held) = run(by);
        let moved: Vec<usize> = (0..held.len()).filter(|&i| held[i].1 == by).collect();
        let drive = BoundaryConditions {
            held: &held,
            force_n: &[],
        };
        let tangent = still.tangent(&drive, &moved, 0.01).expect("a tangent");
        let h = 1e-6;
        for axis in 0..3 {
            let [ahead, behind] = [h, -h].map(|h| {
                let mut other = by;
                other[axis] += h;
                sum_of(run(other).0.reactions_n(), &moved)
            });
            for row in 0..3 {
                let by_difference = (ahead[row] - behind[row]) / (2.0 * h);
                let exact = tangent.stiffness_n_per_m[row][axis];
                assert!(
                    (exact - by_difference).abs() < 1e-5 * tangent.stiffness_n_per_m[2][2],
                    "{cells:?} {row} {axis}: {exact} {by_difference}"
                );
            }
        }
    }
}

/// Held nodes turned half a circle, in parts: no force at the end, and everything has turned with them.
#[test]
fn half_a_turn_of_what_is_held_gives_no_force() {
    for cells in CELLS {
        let mut tissue = tissue(Law::neo_hookean(LIVER), with(cells));
        let turned = |p: [f64; 3], angle: f64| {
            let (sin, cos) = angle.sin_cos();
            [p[0], cos * p[1] - sin * p[2], sin * p[1] + cos * p[2]]
        };
        let mut most = 0.0f64;
        for part in 1..=8 {
            let angle = std::f64::consts::PI * f64::from(part) / 8.0;
            let held = hold(|p| bottom(p).then(|| minus(turned(p, angle), p)));
            assert_eq!(step(&mut tissue, &held).outcome, Outcome::Converged);
            let reactions = tissue.reactions_n().iter();
            most = reactions.fold(0.0, |most, reaction| most.max(norm(*reaction)));
        }
        assert!(most < 1e-9, "{cells:?}: {most} N");
        for (x, rest) in tissue.positions_m().iter().zip(block().points_m()) {
            let off = norm(minus(*x, turned(*rest, std::f64::consts::PI)));
            assert!(off < 1e-9, "{cells:?}: {off} m");
        }
    }
}

/// Work that the top did is in the tissue; the trapezoidal rule shows how coarse the way was, to its second
/// order.
#[test]
fn work_is_energy() {
    for cells in CELLS {
        let difference = |load_steps: u32| {
            let settings = Settings {
                load_steps,
                ..with(cells)
            };
            let mut tissue = tissue(Law::neo_hookean(LIVER), settings);
            let mut last = 0.0;
            // Steps of the same parts, so that none is doubled.
            for part in 1..=load_steps {
                let share = f64::from(part) / f64::from(load_steps);
                let by = [0.005 * share, 0.0, -0.003 * share];
                let force_n = vec![[0.0, 0.06 * share, 0.0]; tissue.positions_m().len()];
                let drive = BoundaryConditions {
                    held: &bottom_held_top_moved(by),
                    force_n: &force_n,
                };
                let settled = tissue.step(&drive, 0.0);
                assert_eq!(settled.outcome, Outcome::Converged);
                last = settled.energy_difference;
            }
            last.abs()
        };
        let (coarse, fine) = (difference(1), difference(4));
        assert!(
            coarse < 0.05 && fine < coarse / 6.0,
            "{cells:?}: {coarse} {fine}"
        );
    }
}

/// Nodes pulled, pushed through the bottom, or thrown ten lengths of the body away: an honest outcome, numbers
/// in every field that has one, and no change where there was no way.
#[test]
fn drives_beyond_reason_fail_honestly() {
    let ways: [[f64; 3]; 5] = [
        [0.0, 0.0, 0.6],
        [0.6, 0.0, 0.0],
        [0.0, 0.0, -0.04],
        [0.0, 0.0, -0.08],
        [0.3, 0.1, -0.6],
    ];
    for cells in CELLS {
        for (by, law) in ways.into_iter().zip(laws().into_iter().cycle()) {
            let settings = Settings {
                most_iterations: 40,
                ..with(cells)
            };
            let mut tissue = tissue(law, settings);
            let before = tissue.positions_m().to_vec();
            let done = step(&mut tissue, &bottom_held_top_moved(by));
            let finite = tissue.positions_m().iter().flatten().all(|x| x.is_finite());
            assert!(finite && done.energy_j.is_finite(), "{cells:?} {by:?}");
            let neo = !matches!(law, Law::StVenantKirchhoff { .. });
            if let Outcome::Failed(_) = done.outcome {
                assert_eq!(before, tissue.positions_m());
                // And it goes on from there.
                let back = step(&mut tissue, &bottom_held_top_moved([0.0, 0.0, 0.001]));
                assert_eq!(back.outcome, Outcome::Converged);
            } else {
                assert!(
                    !neo || by[2] > -0.04,
                    "flat cells have no balance: {done:?}"
                );
                assert!(tissue.reactions_n().iter().flatten().all(|f| f.is_finite()));
            }
        }
    }
}

#[test]
fn drives_that_are_none_change_nothing() {
    let nan = f64::NAN;
    let few = vec![[0.0; 3]; 3];
    let bad = vec![[nan; 3]; block().points_m().len()];
    for settings in [
        with(Cells::Quadratic),
        dynamic(Cells::Linear, Scheme::Midpoint, 0.0),
    ] {
        let mut tissue = tissue(Law::neo_hookean(LIVER), settings);
        assert!(
            tissue
                .tangent(&BoundaryConditions::default(), &[0], 0.01)
                .is_none()
        );
        let held = bottom_held_top_moved([0.0, 0.0, 0.002]);
        assert_eq!(step(&mut tissue, &held).outcome, Outcome::Converged);
        let (before, reactions) = (tissue.positions_m().to_vec(), tissue.reactions_n().to_vec());
        let drive = BoundaryConditions {
            held: &held,
            force_n: &[],
        };
        let tangent = tissue.tangent(&drive, &[3, 20], 0.01);
        assert!(tangent.is_some());
        let wrong: [(&[Node], &[[f64; 3]]); 6] = [
            (&[(0, [nan, 0.0, 0.0])], &[]),
            (&[(0, [f64::INFINITY, 0.0, 0.0])], &[]),
            (&[(3, [0.0; 3]), (1, [0.0; 3])], &[]),
            (&[(u32::MAX, [0.0; 3])], &[]),
            (&[(0, [0.0; 3])], &few),
            (&[(0, [0.0; 3])], &bad),
        ];
        for (held, force_n) in wrong {
            let done = tissue.step(&BoundaryConditions { held, force_n }, 0.01);
            assert!(matches!(done.outcome, Outcome::Failed(_)), "{done:?}");
            assert_eq!(before, tissue.positions_m());
            assert_eq!(reactions, tissue.reactions_n());
            assert_eq!(tangent, tissue.tangent(&drive, &[3, 20], 0.01));
        }
        // As well when the drive can be taken, but leads nowhere, in a step of another length.
        let flat = hold(|p| Some([0.0, 0.0, -p[2]]));
        let failed = tissue.step(
            &BoundaryConditions {
                held: &flat,
                force_n: &[],
            },
            0.05,
        );
        assert!(matches!(failed.outcome, Outcome::Failed(_)), "{failed:?}");
        assert_eq!(before, tissue.positions_m());
        assert_eq!(tangent, tissue.tangent(&drive, &[3, 20], 0.01));
        assert!(tissue.tangent(&drive, &[held.len()], 0.01).is_none());
    }
    let mut tissue = tissue(
        Law::neo_hookean(LIVER),
        dynamic(Cells::Linear, Scheme::BackwardEuler, 0.0),
    );
    for step_s in [0.0, -1.0, nan, f64::INFINITY] {
        let done = tissue.step(&BoundaryConditions::default(), step_s);
        assert!(matches!(done.outcome, Outcome::Failed(_)), "{done:?}");
    }
}

/// A block thrown, turning and quivering, with nothing held: the midpoint rule keeps both momenta to round-off and
/// energy nearly; backward Euler keeps linear momentum and only ever loses energy; drag takes exp(-rate t).
#[test]
fn free_flight_keeps_momentum() {
    let mesh = block();
    let velocity: Vec<[f64; 3]> = mesh
        .points_m()
        .iter()
        .map(|p| [0.2 - 6.0 * p[1], 6.0 * p[0] - 1.0 * p[2], 0.1 + 6.0 * p[2]])
        .collect();
    for cells in CELLS {
        let run = |scheme, drag| {
            let mut tissue = tissue(Law::neo_hookean(LIVER), dynamic(cells, scheme, drag));
            tissue.set_velocity_m_per_s(&velocity).expect("velocities");
            let steps: Vec<_> = (0..60)
                .map(|_| tissue.step(&BoundaryConditions::default(), 0.002))
                .collect();
            assert!(steps.iter().all(|done| done.outcome == Outcome::Converged));
            steps
        };
        let ratio = |a: [f64; 3], b: [f64; 3]| norm(minus(a, b)) / norm(b);
        let kept = run(Scheme::Midpoint, 0.0);
        let (first, last) = (kept[0], kept[59]);
        assert!(ratio(last.momentum, first.momentum) < 1e-9, "{cells:?}");
        assert!(
            ratio(last.angular_momentum, first.angular_momentum) < 1e-9,
            "{cells:?}"
        );
        assert!(
            kept.iter().any(|done| done.energy_j > 1e-4),
            "it does not quiver"
        );
        let off = kept
            .iter()
            .fold(0.0f64, |most, done| most.max(done.energy_difference.abs()));
        assert!(off < 0.01, "{cells:?}: {off}");

        let lost = run(Scheme::BackwardEuler, 0.0);
        assert!(ratio(lost[59].momentum, first.momentum) < 1e-9, "{cells:?}");
        let falls = lost
            .windows(2)
            .all(|pair| pair[1].energy_difference >= pair[0].energy_difference);
        assert!(falls && lost[59].energy_difference > 0.01, "{cells:?}");

        let dragged = run(Scheme::Midpoint, 5.0);
        let left = norm(dragged[59].momentum) / norm(first.momentum);
        assert!(
            (left / (-5.0f64 * 0.12).exp() - 1.0).abs() < 1e-3,
            "{cells:?}: {left}"
        );
    }
}

/// Both schemes go to the same motion as steps get shorter, at their orders.
#[test]
fn time_steps_converge_at_their_order() {
    let tip = |scheme, steps: u32| {
        let mut tissue = tissue(Law::neo_hookean(LIVER), dynamic(Cells::Linear, scheme, 0.0));
        let weight = -9.81 * 20.0;
        tissue.add_body_force(|_| [500.0, 0.0, weight]);
        let held = hold(|p| bottom(p).then_some([0.0; 3]));
        for _ in 0..steps {
            let drive = BoundaryConditions {
                held: &held,
                force_n: &[],
            };
            let done = tissue.step(&drive, 0.02 / f64::from(steps));
            assert_eq!(done.outcome, Outcome::Converged);
        }
        tissue.positions_m()[block().points_m().len() - 1]
    };
    let exact = tip(Scheme::Midpoint, 128);
    for (scheme, order) in [(Scheme::BackwardEuler, 1.0), (Scheme::Midpoint, 2.0)] {
        let [coarse, fine] = [16, 32].map(|steps| norm(minus(tip(scheme, steps), exact)));
        let found = (coarse / fine).log2();
        assert!((found - order).abs() < 0.25, "{scheme:?}: {found}");
    }
}

/// Once a drive has been seen, nothing is allocated, whichever nodes are held.
#[test]
fn steps_and_tangents_allocate_nothing() {
    for cells in CELLS {
        for settings in [with(cells), dynamic(cells, Scheme::BackwardEuler, 1.0)] {
            let mut tissue = tissue(Law::neo_hookean(LIVER), settings);
            let drives: Vec<Held> = (0..4)
                .map(|k| {
                    let by = [0.001 * f64::from(k), 0.0, 0.002];
                    match k {
                        3 => hold(|p| (p[0] < -0.029).then_some([0.0; 3])),
                        _ => bottom_held_top_moved(by),
                    }
                })
                .collect();
            step(&mut tissue, &drives[0]);
            let mut converged = 0;
            let allocated = allocation_counter::measure(|| {
                for held in &drives {
                    let drive = BoundaryConditions { held, force_n: &[] };
                    converged += u32::from(tissue.step(&drive, 0.01).outcome == Outcome::Converged);
                    converged += u32::from(tissue.tangent(&drive, &[0, 3], 0.01).is_some());
                }
            });
            assert_eq!(converged, 8);
            assert_eq!(allocated.count_total, 0, "{cells:?}");
        }
    }
}
