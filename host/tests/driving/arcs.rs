//! Shafts that are not straight against the tissue's surface.

use super::bench::*;
use super::bodies::*;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3, Vector6};
use sutura_host::mesh::TetMesh;
use sutura_host::needle::Needle;

/// How an arc, or what is made of arcs and lines, comes to lie on the slab.
#[derive(Clone, Copy, Debug)]
enum Way {
    /// Hanging down in a plane across the surface: it bulges into it.
    Hangs,
    /// In a plane along the surface.
    Lies,
    /// Tilted by 30 degrees.
    Leans,
}

const WAYS: [Way; 3] = [Way::Hangs, Way::Lies, Way::Leans];

/// A needle whose middle is `height_m` above the slab's top, its tip beyond the slab's side.
fn over(needle: Needle, way: Way, height_m: f64) -> (Needle, Isometry3<f64>) {
    let up = match way {
        Way::Hangs => Vector3::new(0.02, 0.0, 1.0),
        Way::Lies => Vector3::new(1.0, 0.02, 1e-3),
        Way::Leans => Vector3::new(1.0, 0.0, 0.577),
    };
    let along = Vector3::new(0.05, 1.0, 0.0);
    let up = up.normalize();
    // Turned so that it goes along at its middle.
    let middle = frame([0.0; 3], along.into(), up.into());
    let half = needle.at(&Isometry3::identity());
    let at = 0.5 * half.length;
    let own = Isometry3::from(&sutura_host::needle::Curve {
        start: half.at(at),
        tangent: half.tangent_at(at),
        inward: half.inward_at(at),
        ..half
    });
    let pose = middle * own.inverse();
    let curve = needle.at(&pose);
    let lowest = (0..=1000).map(|part| curve.at(curve.length * f64::from(part) / 1000.0).z);
    let lowest = lowest.fold(f64::MAX, f64::min);
    let lift = height_m + 0.5 * THICKNESS_M - lowest;
    let shift = Translation3::new(0.0013, -0.0007, lift);
    (needle, shift * pose)
}

fn needles() -> [Needle; 2] {
    let infinite = f64::INFINITY;
    [
        arc(0.012, 140.0),
        of_segments(&[
            (0.008, infinite),
            (0.012, 0.015),
            (0.006, 0.008),
            (0.004, infinite),
        ]),
    ]
}

/// Pressed down, swept aside and turned about itself, a shaft pushes, and the tissue keeps out of it.
#[test]
fn an_arc_pushes_what_it_is_swept_against() {
    for needle in needles() {
        for way in WAYS {
            let part = over(needle, way, 1e-4);
            let mut bench = build(a_slab(), Kind::Linear, part, 20e3, rubbing(0.3));
            let edge_m = bench.mesh.surface().mean_edge_m;
            let front_m = needle.shape.length_m() - edge_m.max(2.0 * THICKNESS_M);
            assert_eq!(force(&shift(&mut bench, [0.0; 3])), Vector3::zeros());
            let (mut pressed, mut aside, mut worst) = (Vector3::zeros(), 0.0f64, f64::MIN);
            for place in 0..34 {
                let last = match place {
                    0..10 => shift(&mut bench, [0.0, 0.0, -1e-4]),
                    10..22 => shift(&mut bench, [1e-4, 0.0, 0.0]),
                    // It rolls.
                    _ => turn(&mut bench, &needle, 0.01),
                };
                let now = force(&last);
                if place < 2 {
                    continue;
                }
                match place {
                    0..10 => {
                        assert!(now.z < pressed.z, "{way:?} {place}: {now}");
                        pressed = now;
                    }
                    10..22 => aside = aside.max(now.x - pressed.x),
                    _ => assert!(now.z < 0.0),
                }
                let overlap = overlap_m(&bench, &needle, 0.0, front_m);
                worst = worst.max(overlap);
                println!(
                    "{way:?} {place}: {:.1} mN, {} touches, overlap {:.1e} edges, {} solves, {} pieces, {} rows",
                    1e3 * now.norm(),
                    last.needles()[0].touches,
                    overlap / edge_m,
                    last.solves,
                    last.substeps,
                    last.rows,
                );
            }
            println!(
                "{way:?}: {pressed:?} N, {aside} N aside, {:.1e} edges",
                worst / edge_m
            );
            assert!(worst <= 1e-3 * edge_m, "{way:?}: {worst} m");
            assert!(aside > 0.01, "{way:?}: it drags {aside} N along");
            for _ in 0..25 {
                let last = shift(&mut bench, [0.0, 0.0, 2e-4]);
                assert!(force(&last).z <= 1e-12, "{way:?}: it pulls");
            }
            let last = shift(&mut bench, [0.0; 3]);
            assert_eq!(
                (force(&last), last.needles()[0].touches),
                (Vector3::zeros(), 0)
            );
        }
    }
}

/// A step after a turn about the middle of the needle, about the normal of its plane.
fn turn(bench: &mut Bench, needle: &Needle, by_rad: f64) -> sutura_host::step::StepReport {
    let curve = needle.at(&bench.grip);
    let (centre, axis) = (curve.at(0.5 * curve.length), curve.binormal());
    let turn = UnitQuaternion::from_scaled_axis(axis * by_rad);
    bench.grip = Isometry3::from_parts(
        Translation3::from(centre + turn * (bench.grip.translation.vector - centre)),
        turn * bench.grip.rotation,
    );
    shift(bench, [0.0; 3])
}

/// Pressed and swept so that it lies on the surface.
fn laid(part: (Needle, Isometry3<f64>), friction: f64) -> Bench {
    let mut bench = build(a_slab(), Kind::Linear, part, 20e3, rubbing(friction));
    for place in 0..14 {
        let by = if place < 10 {
            [0.0, 0.0, -1e-4]
        } else {
            [1e-4, 0.0, 0.0]
        };
        shift(&mut bench, by);
    }
    bench
}

/// A way on which nothing comes to lie anew, which a step's tangent does not foresee.
#[test]
fn the_tangent_of_an_arc_is_the_derivative() {
    for needle in needles() {
        for (way, friction) in WAYS.into_iter().flat_map(|way| [(way, 0.0), (way, 0.4)]) {
            let mut bench = laid(over(needle, way, 1e-4), friction);
            let (mut share, mut found) = (1.0, (f64::NAN, 2));
            while found.1 > 1 {
                share *= 0.25;
                let by = Vector6::new(3e-5, -2e-5, -2e-5, 1e-3, 5e-4, 1e-3) * share;
                let to = moved(&bench.grip, &by);
                found = tangent_off(&mut bench, to);
                println!("{way:?}, mu {friction}, {share} of the way: {found:?}");
                assert!(share > 1e-3);
            }
            assert!(found.0 < 1e-6, "{way:?}, mu {friction}: off by {found:?}");
        }
    }
}

/// What the hand feels is what the tissue gets, and what that is held with.
#[test]
fn what_an_arc_presses_with_is_what_the_tissue_is_held_with() {
    for way in WAYS {
        let mut bench = laid(over(arc(0.012, 140.0), way, 1e-4), 0.3);
        let felt = force(&shift(&mut bench, [0.0; 3]));
        let whole = bench.model.equilibrium(&bench.state).expect("a balance");
        let (mut pushed, mut held) = (Vector3::zeros(), Vector3::zeros());
        for (at, force) in bench.mesh.points_m().iter().zip(&whole.node_force_n) {
            let force = Vector3::from(*force);
            if at[2] < -0.008 + 1e-9 {
                held += force;
            } else {
                pushed += force;
            }
        }
        println!("{way:?}: {felt:?} N felt, {pushed:?} N pushed, {held:?} N held");
        assert!(felt.norm() > 0.1);
        assert!((felt - pushed).norm() < 1e-9 * felt.norm(), "{way:?}");
        assert!((felt + held).norm() < 1e-9 * felt.norm(), "{way:?}");
    }
}

/// Drawn along its own circle it rubs with friction times what presses.
#[test]
fn an_arc_rubs() {
    for friction in [0.0, 0.2, 0.6] {
        let needle = arc(0.012, 140.0);
        let part = over(needle, Way::Lies, 1e-5);
        let mut bench = build(a_slab(), Kind::Linear, part, 1e6, rubbing(friction));
        shift(&mut bench, [0.0, 0.0, -1e-4]);
        for place in 0..40 {
            let curve = needle.at(&bench.grip);
            let (centre, axis) = (curve.at(0.0) + curve.inward * 0.012, curve.binormal());
            let turn = UnitQuaternion::from_scaled_axis(axis * 4e-3);
            bench.grip = Isometry3::from_parts(
                Translation3::from(centre + turn * (bench.grip.translation.vector - centre)),
                turn * bench.grip.rotation,
            );
            let report = shift(&mut bench, [0.0; 3]);
            if place < 10 {
                continue;
            }
            let pressed = force(&report);
            let [.., x, y, z] = report.contacts()[0].wrench;
            let arm = bench.grip.translation.vector - centre;
            let moment = -Vector3::new(x, y, z) + arm.cross(&pressed);
            let ratio = moment.dot(&axis) / 0.012 / pressed.dot(&axis).abs();
            assert!(
                (ratio - friction).abs() < 0.01 * friction + 1e-3,
                "{place}: {ratio} of {friction}"
            );
        }
    }
}

/// The same scene turned and shifted has the same forces.
#[test]
fn an_arc_anywhere_presses_the_same() {
    let turn = Isometry3::new(Vector3::new(0.3, -0.2, 0.1), Vector3::new(0.4, -1.1, 0.7));
    for way in WAYS {
        let (needle, start) = over(arc(0.012, 140.0), way, 1e-4);
        let [mut here, mut there] = [Isometry3::identity(), turn].map(|turn| {
            let (mesh, fixed) = a_slab();
            let points = mesh.points_m().iter();
            let points = points.map(|p| (turn * nalgebra::Point3::from(*p)).coords.into());
            let cells = mesh.cells().to_vec();
            let mesh = TetMesh::new(points.collect(), cells).expect("the same slab");
            let part = (needle, turn * start);
            build((mesh, fixed), Kind::Linear, part, 20e3, rubbing(0.3))
        });
        for place in 0..24 {
            // Less than a piece, of which rounding would else say whether it is one or two.
            let by = if place < 10 {
                Vector3::new(0.0, 0.0, -9e-5)
            } else {
                Vector3::new(9e-5, 0.0, 0.0)
            };
            let one = force(&shift(&mut here, by.into()));
            let two = force(&shift(&mut there, (turn.rotation * by).into()));
            let off = (turn.rotation * one - two).norm();
            assert!(off <= 1e-9 * one.norm(), "{way:?} {place}: {off} of {one}");
        }
    }
}

/// The hand's work goes into the tissue and friction; what is missing falls with the step.
#[test]
fn the_work_on_an_arc_is_stored_and_rubbed_away() {
    for way in WAYS {
        let missing = [5e-5f64, 1.25e-5].map(|step_m| {
            let part = over(arc(0.012, 140.0), way, 1e-6);
            let mut bench = build(a_slab(), Kind::Linear, part, 20e3, rubbing(0.3));
            missing_of_work(&mut bench, step_m)
        });
        println!("{way:?}: {missing:?}");
        assert!(
            missing[1] < 0.02 && missing[1] < 0.6 * missing[0] + 1e-3,
            "{way:?}: {missing:?}"
        );
    }
}

/// An arc that hangs over the rim of the slab, along it, bulges into the rim alone.
#[test]
fn an_arc_that_hangs_along_a_rim_is_kept_out() {
    let (needle, start) = over(arc(0.012, 140.0), Way::Hangs, 1e-4);
    let along = frame([0.0; 3], [0.05, 1.0, 0.0], [0.0, 0.0, 1.0]).rotation;
    let straight = frame([0.0; 3], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]).rotation;
    let turn = straight * along.inverse();
    let rim = Translation3::new(0.015, 0.0, 0.0);
    let start = rim * turn * (Translation3::new(-0.0013, 0.0, 0.0) * start);
    let mut bench = build(a_slab(), Kind::Linear, (needle, start), 20e3, rubbing(0.3));
    let edge_m = bench.mesh.surface().mean_edge_m;
    let front_m = needle.shape.length_m() - edge_m.max(2.0 * THICKNESS_M);
    for place in 0..20 {
        let by = if place < 10 {
            [0.0, 0.0, -1e-4]
        } else {
            [-1e-5, 1e-4, 0.0]
        };
        let now = force(&shift(&mut bench, by));
        let overlap = overlap_m(&bench, &needle, 0.0, front_m);
        println!("{place}: {now:?} N, overlap {:.1e} edges", overlap / edge_m);
        assert!(place < 4 || now.z < 0.0);
        assert!(overlap <= 1e-3 * edge_m, "{place}: {overlap} m");
    }
}
