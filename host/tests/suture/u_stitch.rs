//! A U stitch against an independent minimiser: the energy of the tissue and the tension times all of the path, from rest.

use super::one_length::*;
use crate::driving::bench::MATERIAL;
use faer::prelude::Solve;
use faer::{Col, Mat};
use nalgebra::{Matrix3, Matrix4, Vector3, Vector4};
use sutura_host::fem::{LinearTissue, Loads, NodeLoad};
use sutura_host::mesh::TetMesh;
use sutura_host::thread::{ThreadPlace, ThreadPoint, Through};

/// Points of the path nearer to each other than this are one \[m\].
const APART_M: f64 = 2e-4;

/// A point of tissue: a cell's nodes and their parts.
type Point = ([u32; 4], [f64; 4]);

/// The cell in which a point lies, and where.
fn locate(mesh: &TetMesh, at: Vector3<f64>) -> Point {
    let inside = |cell: &[u32; 4]| {
        let corner = |node: u32| Vector3::from(mesh.points_m()[node as usize]);
        let columns = cell.map(|node| corner(node).push(1.0));
        let weights = Matrix4::from_columns(&columns).try_inverse()? * at.push(1.0);
        (weights.min() > -1e-6).then(|| (*cell, Vector4::into(weights)))
    };
    mesh.cells().iter().find_map(inside).expect("in a cell")
}

/// Displacement of each point by a force on each, (3 m x 3 m) \[m/N\].
fn compliance(tissue: &LinearTissue, points: &[Point]) -> Mat<f64> {
    let m = points.len();
    let mut out = Mat::zeros(3 * m, 3 * m);
    for (pushed, (nodes, weights)) in points.iter().enumerate() {
        for axis in 0..3 {
            let force = |weight: f64| {
                let mut force = [0.0; 3];
                force[axis] = weight;
                force
            };
            let each = nodes.iter().zip(weights);
            let loads = Loads {
                forces: each
                    .map(|(node, weight)| NodeLoad {
                        node: *node,
                        force_n: force(*weight),
                    })
                    .collect(),
                ..Loads::default()
            };
            let moved = tissue.solve(&loads).expect("a balance").displacement_m;
            for (point, (nodes, weights)) in points.iter().enumerate() {
                let way: Vector3<f64> = nodes
                    .iter()
                    .zip(weights)
                    .map(|(node, weight)| Vector3::from(moved[*node as usize]) * *weight)
                    .sum();
                for (along, way) in way.iter().enumerate() {
                    out[(3 * point + along, 3 * pushed + axis)] = *way;
                }
            }
        }
    }
    out
}

/// Where the points of a path between two hands come to rest with one tension all along: the stationary point of the convex energy
/// 1/2 (x - X)' C^-1 (x - X) + T sum |y|, found in forces by Newton's method while the tension grows.
fn least_energy(
    from: &[Vector3<f64>],
    compliance: &Mat<f64>,
    hands: [Vector3<f64>; 2],
    tension_n: f64,
) -> Vec<Vector3<f64>> {
    let m = from.len();
    let rest = Col::from_fn(3 * m, |row| from[row / 3][row % 3]);
    let mut x = rest.clone();
    const STEPS: u32 = 40;
    for step in 1..=STEPS {
        let tension_n = tension_n * f64::from(step) / f64::from(STEPS);
        for round in 0.. {
            let at = |place: usize| match place {
                0 => hands[0],
                place if place > m => hands[1],
                place => Vector3::from_fn(|axis, _| x[3 * place - 3 + axis]),
            };
            let mut force = Col::<f64>::zeros(3 * m);
            let mut rise = Mat::<f64>::zeros(3 * m, 3 * m);
            for piece in 0..=m {
                let way = at(piece + 1) - at(piece);
                let along = way.normalize();
                let across = Matrix3::identity() - along * along.transpose();
                let stiff = across * (tension_n / way.norm());
                // Its pull on both of its ends, and how that changes as they move.
                for (end, sign) in [(piece, 1.0), (piece + 1, -1.0)] {
                    let Some(row) = end.checked_sub(1).filter(|row| *row < m) else {
                        continue;
                    };
                    (0..3).for_each(|axis| force[3 * row + axis] += sign * tension_n * along[axis]);
                    for (other, way_sign) in [(piece, -1.0), (piece + 1, 1.0)] {
                        let Some(column) = other.checked_sub(1).filter(|column| *column < m) else {
                            continue;
                        };
                        for (i, j) in (0..3).flat_map(|i| (0..3).map(move |j| (i, j))) {
                            rise[(3 * row + i, 3 * column + j)] += sign * way_sign * stiff[(i, j)];
                        }
                    }
                }
            }
            let over = &x - &rest - compliance * force;
            if over.norm_max() < 1e-12 {
                break;
            }
            assert!(round < 50, "{}", over.norm_max());
            let matrix = Mat::<f64>::identity(3 * m, 3 * m) - compliance * rise;
            let change = matrix.partial_piv_lu().solve(&over);
            // No point may pass its neighbour in one go.
            let part = f64::min(1e-4 / change.norm_max(), 1.0);
            x -= faer::Scale(part) * change;
        }
    }
    (0..m)
        .map(|place| Vector3::from_fn(|axis, _| x[3 * place + axis]))
        .collect()
}

fn places(path: &[ThreadPoint]) -> Vec<Vector3<f64>> {
    path.iter().map(|point| Vector3::from(point.at_m)).collect()
}

/// Distance of its punctures \[m\].
fn between_m(path: &[ThreadPoint]) -> f64 {
    let of = |what: ThreadPlace| path.iter().find(|point| point.what == what);
    let [enters, leaves] = [ThreadPlace::Enters, ThreadPlace::Leaves].map(of);
    let at = |point: Option<&ThreadPoint>| Vector3::from(point.expect("a puncture").at_m);
    at(enters).metric_distance(&at(leaves))
}

/// It bunches the tissue between its punctures as the least energy has it, the more the harder it is pulled.
#[test]
fn a_u_stitch_bunches_as_the_least_energy_has_it() {
    let mesh = thick(sides);
    let tissue = LinearTissue::new(&mesh.0, MATERIAL, &mesh.1).expect("tissue");
    let mut bench = wound_up_in(mesh, 1, part(Through::default()));
    let at_rest = bench.path(7);
    assert!(bench.largest_displacement_m() < 1e-12);
    // Every face that is apart from the one before it, and both punctures.
    let last = at_rest.len() - 2;
    let mut from: Vec<Vector3<f64>> = Vec::new();
    for (place, at) in places(&at_rest)
        .into_iter()
        .enumerate()
        .take(last + 1)
        .skip(1)
    {
        let near = |before: &Vector3<f64>| before.metric_distance(&at) < APART_M;
        if place == last {
            while from.len() > 1 && near(&from[from.len() - 1]) {
                from.pop();
            }
        }
        if place == last || !from.last().is_some_and(near) {
            from.push(at);
        }
    }
    let points: Vec<Point> = from.iter().map(|at| locate(&bench.mesh, *at)).collect();
    let compliance = compliance(&tissue, &points);
    let mut before_m = between_m(&at_rest);
    for _ in 0..6 {
        for _ in 0..8 {
            bench.grip.translation.vector.z += 2e-4;
            bench.other.translation.vector.z += 2e-4;
            assert_eq!(bench.step_both().status.name(), "ok");
        }
        let thread = bench.step_both().threads()[0];
        let path = bench.path(7);
        let now_m = between_m(&path);
        let tension_n = thread.tension_n[1];
        if tension_n == 0.0 {
            continue;
        }
        assert_eq!(thread.wraps, 0);
        let all = places(&path);
        let hands = [all[0], all[all.len() - 1]];
        let least = least_energy(&from, &compliance, hands, tension_n);
        let [first, last] = [least[0], least[least.len() - 1]];
        let expected_m = first.metric_distance(&last);
        let whole = [&hands[..1], &least, &hands[1..]].concat();
        let length_m: f64 = whole
            .windows(2)
            .map(|two| two[0].metric_distance(&two[1]))
            .sum();
        println!(
            "{tension_n} N: {now_m} m, least energy {expected_m} m, length {} and {length_m} m",
            thread.length_m
        );
        assert!(
            (now_m / expected_m - 1.0).abs() < 0.01,
            "{now_m} {expected_m}"
        );
        assert!(
            (thread.length_m / length_m - 1.0).abs() < 2e-3,
            "{thread:?}"
        );
        assert!(now_m < before_m, "{now_m} {before_m}");
        before_m = now_m;
    }
    assert!(before_m < 0.9 * between_m(&at_rest), "{before_m}");
}
