//! Capsules, boxes and meshes: derivatives in every region, turns, limits, and distances found by search.

use super::shape::{Solid, Touch};
use crate::mesh::SurfaceFormat;
use crate::tool::{ClosedMesh, Placement, Shape, Tool};
use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use std::sync::Arc;

const CAPSULE: Shape = Shape::Capsule {
    radius_m: 0.7,
    length_m: 2.5,
};
const SIZE: [f64; 3] = [1.8, 2.6, 3.4];
const FILLET: f64 = 0.3;
const BOX: Shape = Shape::RoundedBox {
    size_m: SIZE,
    fillet_m: FILLET,
};
/// Half of the box's core.
const HALF: [f64; 3] = [0.6, 1.0, 1.4];

/// Aslant, with a side that is not the usual one.
fn tool(shape: &Shape) -> Tool {
    Tool {
        axis: [0.0, 0.6, -0.8],
        side: [0.0, 0.8, 0.6],
        ..Tool::new(shape.clone(), [0.0; 3])
    }
}

fn placed(rng: &mut fastrand::Rng) -> Placement {
    Placement {
        centre: vector(rng),
        rotation: UnitQuaternion::from_scaled_axis(vector(rng) * 3.0),
    }
}

/// Entries from -1 to 1.
fn vector(rng: &mut fastrand::Rng) -> Vector3<f64> {
    Vector3::from_fn(|_, _| 2.0 * rng.f64() - 1.0)
}

fn between(rng: &mut fastrand::Rng, low: f64, high: f64) -> f64 {
    low + (high - low) * rng.f64()
}

/// Side, across and axis.
fn frame(solid: &Solid) -> Matrix3<f64> {
    let (side, axis) = (solid.side, solid.axis);
    Matrix3::from_columns(&[side, axis.cross(&side), axis])
}

/// A point of each region of the capsule, away from where its curvature jumps: beside the bar, before it and behind it.
fn around_capsule(rng: &mut fastrand::Rng, solid: &Solid) -> [Vector3<f64>; 3] {
    let frame = frame(solid);
    let far = between(rng, 0.1, 2.0);
    let angle = between(rng, 0.0, std::f64::consts::TAU);
    let beside = Vector3::new(
        far * angle.cos(),
        far * angle.sin(),
        between(rng, -2.4, -0.1),
    );
    let round = vector(rng).normalize() * far;
    let before = Vector3::new(round.x, round.y, round.z.abs() + 0.01);
    let behind = Vector3::new(round.x, round.y, -2.51 - round.z.abs());
    [beside, before, behind].map(|at| solid.centre + frame * at)
}

/// Points of the region of the box in which it is beyond these faces of its core: before a face, an edge or a corner; for
/// none of them in the core, nearest to the first.
fn around_box(rng: &mut fastrand::Rng, solid: &Solid, beyond: [i32; 3]) -> Vector3<f64> {
    let is_inside = beyond == [0; 3];
    let at = Vector3::from_fn(|i, _| match beyond[i] {
        0 if is_inside && i == 0 => HALF[0] - between(rng, 0.01, 0.05),
        0 if is_inside => between(rng, -0.9, 0.9) * (HALF[i] - 0.1),
        0 => between(rng, -0.98, 0.98) * HALF[i],
        sign => f64::from(sign) * (HALF[i] + between(rng, 0.02, 1.0)),
    });
    solid.middle() + frame(solid) * at
}

fn every_region() -> impl Iterator<Item = [i32; 3]> {
    (0..27).map(|k| [k % 3 - 1, k / 3 % 3 - 1, k / 9 - 1])
}

/// Normal and curvature against central differences of gap and normal.
fn assert_derivatives(solid: &Solid, at: &Vector3<f64>) -> Touch {
    let touch = solid.touch(at).expect("a normal");
    assert!((touch.gap - solid.gap(at)).abs() < 1e-15);
    assert!((touch.normal.norm() - 1.0).abs() < 1e-14);
    assert!((touch.curvature * touch.normal).norm() < 1e-13);
    assert!((touch.curvature - touch.curvature.transpose()).norm() < 1e-13);
    let h = 1e-5;
    for axis in 0..3 {
        let step = Vector3::ith(axis, h);
        let (plus, minus) = (at + step, at - step);
        let slope = (solid.gap(&plus) - solid.gap(&minus)) / (2.0 * h);
        // The third derivative is at most 3/d^2, at distances d from the core of 0.02 and more.
        let error = (slope - touch.normal[axis]).abs();
        assert!(error < 2e-7, "{error:e} at {at}");
        let normal = |point| solid.touch(&point).expect("a normal").normal;
        let turn = (normal(plus) - normal(minus)) / (2.0 * h);
        let error = (turn - touch.curvature.column(axis)).norm();
        assert!(
            error < 1e-7 * (1.0 + touch.curvature.norm().powi(3)),
            "{error:e} at {at}"
        );
    }
    touch
}

#[test]
fn the_derivatives_are_those_of_the_distance_in_every_region() {
    let rng = &mut fastrand::Rng::with_seed(1);
    for _ in 0..200 {
        let solid = Solid::new(&tool(&CAPSULE), 0.0, &placed(rng));
        for (region, at) in around_capsule(rng, &solid).iter().enumerate() {
            let touch = assert_derivatives(&solid, at);
            let distance = touch.gap + 0.7;
            let ways = if region == 0 { 1.0 } else { 2.0 };
            assert!((touch.curvature.trace() * distance - ways).abs() < 1e-12);
        }
    }
    for beyond in every_region() {
        let ways = f64::from(beyond.map(i32::abs).iter().sum::<i32>() - 1);
        for _ in 0..30 {
            let solid = Solid::new(&tool(&BOX), 0.0, &placed(rng));
            let touch = assert_derivatives(&solid, &around_box(rng, &solid, beyond));
            // Flat before faces and inside, a cylinder at edges, a ball at corners.
            let trace = touch.curvature.trace() * (touch.gap + FILLET);
            assert!((trace - ways.max(0.0)).abs() < 1e-12, "{beyond:?}: {trace}");
        }
    }
}

#[test]
fn what_turns_with_the_shape_sees_it_as_it_was() {
    let rng = &mut fastrand::Rng::with_seed(2);
    for shape in [CAPSULE, BOX] {
        for _ in 0..300 {
            let at = vector(rng) * 3.0;
            let place = placed(rng);
            let still = Placement {
                centre: Vector3::zeros(),
                rotation: UnitQuaternion::identity(),
            };
            let here = Solid::new(&tool(&shape), 0.0, &still).touch(&at);
            let there = Solid::new(&tool(&shape), 0.0, &place).touch(&place.world_of(&at));
            let (here, there) = (here.expect("a normal"), there.expect("a normal"));
            let turn = place.rotation.to_rotation_matrix().into_inner();
            assert!((here.gap - there.gap).abs() < 1e-14);
            assert!((turn * here.normal - there.normal).norm() < 1e-12);
            let turned = turn * here.curvature * turn.transpose();
            assert!((turned - there.curvature).norm() < 1e-12 * (1.0 + turned.norm().powi(2)));
        }
    }
}

impl Placement {
    fn world_of(&self, local: &Vector3<f64>) -> Vector3<f64> {
        self.centre + self.rotation * local
    }
}

#[test]
fn a_capsule_without_length_is_a_sphere() {
    let rng = &mut fastrand::Rng::with_seed(3);
    let shape = Shape::Capsule {
        radius_m: 0.7,
        length_m: 0.0,
    };
    for _ in 0..300 {
        let place = placed(rng);
        let capsule = Solid::new(&tool(&shape), 0.0, &place);
        let sphere = Solid::new(&Tool::sphere(0.7, [0.0; 3]), 0.0, &place);
        let at = place.centre + vector(rng);
        assert_eq!(capsule.gap(&at), sphere.gap(&at));
        let (one, other) = (capsule.touch(&at), sphere.touch(&at));
        let (one, other) = (one.expect("a normal"), other.expect("a normal"));
        assert_eq!(
            (one.gap, one.normal, one.curvature),
            (other.gap, other.normal, other.curvature)
        );
        let measures = |solid: &Solid| {
            let lengths = [solid.radius(), solid.piece(), solid.reach(), solid.bound()];
            (lengths, solid.curvature_per_m(), solid.middle())
        };
        assert_eq!(measures(&capsule), measures(&sphere));
    }
}

/// The least of a convex function of two numbers in a rectangle around 0, by trying a net of places that shrinks.
fn least(half: [f64; 2], of: impl Fn(f64, f64) -> f64) -> f64 {
    let (mut middle, mut reach) = ([0.0; 2], half);
    let mut best = of(0.0, 0.0);
    for _ in 0..60 {
        let around = middle;
        for k in 0..81 {
            let at = [k % 9, k / 9].map(|n| f64::from(n) / 4.0 - 1.0);
            let [u, v] = [0, 1].map(|i| (around[i] + reach[i] * at[i]).clamp(-half[i], half[i]));
            let value = of(u, v);
            if value < best {
                (best, middle) = (value, [u, v]);
            }
        }
        reach = reach.map(|r| 0.6 * r);
    }
    best
}

#[test]
fn distances_from_a_box_are_those_of_the_nearest_place_on_its_core() {
    let rng = &mut fastrand::Rng::with_seed(4);
    for _ in 0..60 {
        let solid = Solid::new(&tool(&BOX), 0.0, &placed(rng));
        let local = vector(rng) * 2.0;
        let at = solid.middle() + frame(&solid) * local;
        let faces = (0..3).flat_map(|axis| [(axis, 1.0), (axis, -1.0)]);
        let to_face = faces.map(|(axis, sign)| {
            let (next, last) = ((axis + 1) % 3, (axis + 2) % 3);
            least([HALF[next], HALF[last]], |u, v| {
                let mut on = Vector3::zeros();
                (on[axis], on[next], on[last]) = (sign * HALF[axis], u, v);
                (local - on).norm()
            })
        });
        let nearest = to_face.fold(f64::MAX, f64::min);
        let is_inside = (0..3).all(|axis| local[axis].abs() < HALF[axis]);
        let expected = if is_inside { -nearest } else { nearest } - FILLET;
        let found = solid.gap(&at);
        assert!((found - expected).abs() < 1e-9, "{found}, not {expected}");
    }
}

/// No surface is beyond the bound, no turn moves it by more than the reach, and both are hardly more than it takes.
#[test]
fn bounds_and_reaches_hold_the_whole_shape() {
    let rng = &mut fastrand::Rng::with_seed(5);
    let angle = 1e-3;
    for shape in [CAPSULE, BOX] {
        let (mut farthest, mut most) = (0.0f64, 0.0f64);
        let place = placed(rng);
        let solid = Solid::new(&tool(&shape), 0.0, &place);
        assert!(solid.gap(&solid.middle()) <= -0.99 * solid.radius());
        for _ in 0..20_000 {
            let at = solid.centre + vector(rng).normalize() * rng.f64() * 1.1 * solid.bound();
            let gap = solid.gap(&at);
            if gap < 0.0 {
                farthest = farthest.max((at - solid.centre).norm());
            }
            let turn = UnitQuaternion::from_scaled_axis(vector(rng).normalize() * angle);
            let turned = Placement {
                rotation: turn * place.rotation,
                ..place
            };
            let moved = (Solid::new(&tool(&shape), 0.0, &turned).gap(&at) - gap).abs();
            most = most.max(moved / angle);
        }
        assert!(farthest <= solid.bound() && farthest > 0.85 * solid.bound());
        assert!(
            most <= solid.reach() && most > 0.7 * solid.reach(),
            "{most}"
        );
    }
}

/// Half way of a turn about any of its directions a box has turned half as far.
#[test]
fn a_box_on_its_way_is_turned_as_a_whole() {
    let rng = &mut fastrand::Rng::with_seed(6);
    for axis in 0..3 {
        let from = placed(rng);
        let begin = Solid::new(&tool(&BOX), 0.0, &from);
        let about = frame(&begin).column(axis).into_owned() * 0.3;
        let turned = |part: f64| Placement {
            centre: from.centre + Vector3::x() * part,
            rotation: UnitQuaternion::from_scaled_axis(about * part) * from.rotation,
        };
        let end = Solid::new(&tool(&BOX), 0.0, &turned(1.0));
        let (half, expected) = (
            begin.towards(&end, 0.5),
            Solid::new(&tool(&BOX), 0.0, &turned(0.5)),
        );
        for _ in 0..50 {
            let at = expected.middle() + vector(rng) * 2.0;
            assert!((half.gap(&at) - expected.gap(&at)).abs() < 1e-12);
        }
        let frame = frame(&begin.towards(&end, 0.3));
        assert!((frame.transpose() * frame - Matrix3::identity()).norm() < 1e-14);
    }
}

/// The core of [`BOX`] as a mesh, each face cut into so many squares along both sides, all with the same diagonal.
fn box_mesh(cuts: u32) -> Shape {
    let mut points: Vec<[f64; 3]> = Vec::new();
    let mut number = |at: [f64; 3]| {
        let known = points.iter().position(|point| *point == at);
        known.unwrap_or_else(|| {
            points.push(at);
            points.len() - 1
        }) as u32
    };
    let mut triangles = Vec::new();
    for (axis, sign) in (0..3).flat_map(|axis| [(axis, 1.0), (axis, -1.0)]) {
        let (next, last) = ((axis + 1) % 3, (axis + 2) % 3);
        let mut corner = |u: u32, v: u32| {
            let mut at = [0.0; 3];
            let part = |k: u32| f64::from(2 * k) / f64::from(cuts) - 1.0;
            (at[axis], at[next], at[last]) = (
                sign * HALF[axis],
                HALF[next] * part(u),
                HALF[last] * part(v),
            );
            // Its front face is a fillet before the origin, which is at the front of the whole.
            at[2] += FILLET + HALF[2];
            number(at)
        };
        for (u, v) in (0..cuts).flat_map(|u| (0..cuts).map(move |v| (u, v))) {
            let [a, b, c, d] = [
                corner(u, v),
                corner(u + 1, v),
                corner(u + 1, v + 1),
                corner(u, v + 1),
            ];
            let mut pair = [[a, b, c], [a, c, d]];
            if sign < 0.0 {
                pair.iter_mut().for_each(|triangle| triangle.reverse());
            }
            triangles.extend(pair);
        }
    }
    let mesh = ClosedMesh::new(&points, &triangles).expect("closed");
    Shape::Mesh {
        mesh: Arc::new(mesh),
        fillet_m: FILLET,
    }
}

/// Wherever it is cut into triangles, also right before their corners and edges.
#[test]
fn a_mesh_of_a_box_is_a_rounded_box() {
    let rng = &mut fastrand::Rng::with_seed(7);
    for cuts in [1, 2, 3] {
        let mesh = box_mesh(cuts);
        for round in 0..20 {
            let place = if round == 0 {
                Placement {
                    centre: Vector3::zeros(),
                    rotation: UnitQuaternion::identity(),
                }
            } else {
                placed(rng)
            };
            let own = |shape| match round {
                0 => Tool::new(shape, [0.0; 3]),
                _ => tool(&shape),
            };
            let exact = Solid::new(&own(BOX), 0.0, &place);
            let found = Solid::new(&own(mesh.clone()), 0.0, &place);
            assert!((exact.middle() - found.middle()).norm() < 0.9);
            assert!((exact.radius() - found.radius()).abs() < 1e-6);
            let close = |at: &Vector3<f64>| {
                let (one, other) = (found.touch(at), exact.touch(at));
                let (one, other) = (one.expect("a normal"), other.expect("a normal"));
                assert!(
                    (one.gap - other.gap).abs() < 1e-12,
                    "{} {}",
                    one.gap,
                    other.gap
                );
                assert!((found.gap(at) - one.gap).abs() < 1e-14);
                assert!((one.normal - other.normal).norm() < 1e-12);
                let error = (one.curvature - other.curvature).norm();
                assert!(error < 1e-9 * (1.0 + other.curvature.norm()), "{error:e}");
            };
            for beyond in every_region() {
                close(&around_box(rng, &exact, beyond));
            }
            // Before corners, edges and diagonals of triangles on the first face.
            for (y, z) in [
                (0.0, 0.0),
                (1.0 / 3.0, 1.0 / 3.0),
                (0.5, 0.5),
                (0.0, 0.3),
                (-1.0 / 3.0, 0.2),
            ] {
                let local = Vector3::new(HALF[0] + 0.2, HALF[1] * y, HALF[2] * z);
                close(&(exact.middle() + frame(&exact) * local));
            }
            // And before those on the edge between two faces.
            for z in [0.0, 1.0 / 3.0, -1.0 / 3.0, 0.1] {
                let local = Vector3::new(HALF[0] + 0.2, HALF[1] + 0.1, HALF[2] * z);
                close(&(exact.middle() + frame(&exact) * local));
            }
        }
    }
}

/// An L, inside and outside: flat before faces, bent by 1/d around edges and corners, and below zero inside of the notch.
#[test]
fn derivatives_of_a_mesh_are_those_of_its_distance() {
    let bytes = include_bytes!("../../../tests/data/bracket.stl");
    let mesh = ClosedMesh::read(SurfaceFormat::Stl, bytes, 0.1).expect("closed");
    let shape = Shape::Mesh {
        mesh: Arc::new(mesh),
        fillet_m: FILLET,
    };
    let rng = &mut fastrand::Rng::with_seed(8);
    let mut seen = [0; 4];
    for round in 0..4000 {
        let solid = Solid::new(&tool(&shape), 0.0, &placed(rng));
        // Every second place is in the corner behind the notch.
        let place = if round % 2 == 0 {
            vector(rng) * 4.0
        } else {
            Vector3::new(-1.2, 0.0, -0.8) + vector(rng) * 0.3
        };
        let at = solid.centre + frame(&solid) * place;
        let touch = solid.touch(&at).expect("a normal");
        let distance = touch.gap + FILLET;
        // Away from where another part becomes the nearest.
        let near = (0..3).flat_map(|axis| [1e-3, -1e-3].map(|way| at + Vector3::ith(axis, way)));
        let is_smooth = near.into_iter().all(|other| {
            let foretold = touch.normal + touch.curvature * (other - at);
            let there = solid.touch(&other).expect("a normal");
            (there.normal - foretold).norm() < 1e-4
                && (there.curvature - touch.curvature).norm()
                    < 0.1 * (touch.curvature.norm() + 1e-9)
        });
        if distance.abs() < 0.05 || !is_smooth {
            continue;
        }
        assert_derivatives(&solid, &at);
        let ways = touch.curvature.trace() * distance;
        assert!((ways - ways.round()).abs() < 1e-9, "{ways}");
        let is_notch = distance < 0.0 && ways > 0.5;
        seen[if is_notch { 3 } else { ways.round() as usize }] += 1;
    }
    println!("{seen:?}");
    assert!(
        seen[0] > 300 && seen[1] > 100 && seen[2] > 100 && seen[3] > 100,
        "{seen:?}"
    );
}
