//! Taut spans over tissue: how deep they cut into it, and what they press with.

use super::one_length::*;
use super::rig::*;
use nalgebra::Vector3;
use sutura_host::step::StepReport;
use sutura_host::thread::{ThreadEnd, ThreadHold, ThreadPlace, ThreadPoint, Through};

/// Distance of a point from a triangle \[m\].
fn distance(at: &Vector3<f64>, [a, b, c]: [Vector3<f64>; 3]) -> f64 {
    let normal = (b - a).cross(&(c - a)).normalize();
    let foot = at - normal * normal.dot(&(at - a));
    let sides = [(a, b), (b, c), (c, a)];
    let inside =
        |(p, q): (Vector3<f64>, Vector3<f64>)| (q - p).cross(&(foot - p)).dot(&normal) >= 0.0;
    if sides.into_iter().all(inside) {
        return (foot - at).norm();
    }
    let of = |(p, q): (Vector3<f64>, Vector3<f64>)| {
        let part = ((at - p).dot(&(q - p)) / (q - p).norm_squared()).clamp(0.0, 1.0);
        (p + (q - p) * part - at).norm()
    };
    sides.into_iter().map(of).fold(f64::MAX, f64::min)
}

/// How deep what lies outside of a thread's path is in the tissue \[m\].
fn depth_m(bench: &Bench, path: &[ThreadPoint]) -> f64 {
    let nodes = bench.state.positions(&bench.model);
    let at = |node: u32| Vector3::from(nodes[node as usize]);
    let surface = bench.mesh.surface();
    let mut deepest = 0.0f64;
    for pair in path.windows(2) {
        let outside = matches!(
            pair[0].what,
            ThreadPlace::End | ThreadPlace::Leaves | ThreadPlace::Wraps
        ) && pair[1].what != ThreadPlace::Hangs;
        if !outside {
            continue;
        }
        let [from, to] = [pair[0].at_m, pair[1].at_m].map(Vector3::from);
        for part in 1..400 {
            let point = from + (to - from) * (f64::from(part) / 400.0);
            let is_in = |cell: &[u32; 4]| {
                let [a, b, c, d] = cell.map(at);
                let volume =
                    |[a, b, c, d]: [Vector3<f64>; 4]| (b - a).cross(&(c - a)).dot(&(d - a));
                let whole = volume([a, b, c, d]);
                let parts = [
                    volume([point, b, c, d]),
                    volume([a, point, c, d]),
                    volume([a, b, point, d]),
                    volume([a, b, c, point]),
                ];
                parts.iter().all(|part| part * whole > 0.0)
            };
            if bench.mesh.cells().iter().any(is_in) {
                let faces = surface.triangles.iter();
                let near = faces.map(|face| distance(&point, face.map(at)));
                deepest = deepest.max(near.fold(f64::MAX, f64::min));
            }
        }
    }
    deepest
}

/// Where the tail is held, beyond the rim of the slab that the thread goes down through: below its top, beside, level, and round a corner.
const PLACES: [[f64; 3]; 4] = [
    [0.025, 0.0007, -0.005],
    [0.025, 0.003, -0.001],
    [0.025, 0.0007, 0.0],
    [0.018, 0.018, -0.006],
];

fn below(at: &[f64; 3]) -> bool {
    at[2] < -0.0199
}

/// The side that nothing goes through.
fn beside(at: &[f64; 3]) -> bool {
    at[0] < -0.0149
}

/// A thread down through a slab, its tail over the rim.
fn laid(place: [f64; 3], body: bool, is_held: fn(&[f64; 3]) -> bool) -> Bench {
    let through = Through { body, ..ELASTIC };
    let mut bench = drawn_through(thick(is_held), part(through));
    bench.other.translation.vector = Vector3::from(place);
    hold(&mut bench, ThreadEnd::Tail, ThreadHold::Tool(1));
    bench
}

/// Pulled taut over a rim it bends there, and the tissue keeps out of it; without a body it would cut in.
#[test]
fn a_taut_span_with_a_body_bends_over_a_rim() {
    for place in PLACES {
        let [with, without] = [true, false].map(|body| {
            let mut bench = laid(place, body, below);
            let edge_m = bench.mesh.surface().mean_edge_m;
            let mut worst = 0.0f64;
            for k in 0..14 {
                bench.grip.translation.vector.z -= 2e-4;
                let report = bench.step_both();
                assert_eq!(report.status.name(), "ok");
                let path = bench.path(7);
                let wraps = path.iter().filter(|p| p.what == ThreadPlace::Wraps);
                let depth = depth_m(&bench, &path);
                worst = worst.max(depth);
                println!(
                    "over {body} {place:?} {k}: {:.4} N, {} wraps, depth {:.1e} edges, {} solves, {} rows",
                    report.threads()[0].tension_n[0],
                    wraps.count(),
                    depth / edge_m,
                    report.solves,
                    report.rows
                );
            }
            // Nobody moves: bends settle along their edges within some steps, then nothing does.
            let tension = |bench: &mut Bench| bench.step_both().threads()[0].tension_n[0];
            let before = tension(&mut bench);
            if body {
                let settled = (0..10).fold(before, |_, _| tension(&mut bench));
                assert!((settled / before - 1.0).abs() < 2e-3, "{before} {settled}");
                for _ in 0..6 {
                    let now = tension(&mut bench);
                    assert!((now / settled - 1.0).abs() < 1e-9, "{settled} {now}");
                }
                assert!(before > 0.1);
            }
            worst / edge_m
        });
        println!("over {place:?}: {with:.1e} edges, without a body {without:.1e}");
        assert!(with <= 1e-3 && without > 1e-3, "{with} {without}");
    }
}

/// What both hands pull with is what the tissue is held with, and what bends the thread is the tension times its turn.
#[test]
fn what_bends_a_span_is_its_tension() {
    for place in [PLACES[0], PLACES[3]] {
        let mut bench = laid(place, true, beside);
        let report = go(&mut bench, Vector3::new(0.0, 0.0, -0.0024));
        let felt = report.contacts().iter().map(|contact| {
            let [x, y, z, ..] = contact.wrench;
            -Vector3::new(x, y, z)
        });
        let felt: Vector3<f64> = felt.sum();
        let whole = bench.model.equilibrium(&bench.state).expect("a balance");
        let mut held = Vector3::zeros();
        for (at, force) in bench.mesh.points_m().iter().zip(&whole.node_force_n) {
            if beside(at) {
                held += Vector3::from(*force);
            }
        }
        let tension = report.threads()[0].tension_n[0];
        assert!(
            tension > 0.02 && (felt + held).norm() < 1e-6 * tension,
            "{felt} {held}"
        );
        // Of the part over the rim: the turn from where it comes in to where it goes.
        let path = bench.path(7);
        let first = path.iter().position(|p| p.what == ThreadPlace::Enters);
        let over = &path[..=first.expect("a puncture")];
        let ways: Vec<_> = over
            .windows(2)
            .map(|pair| (Vector3::from(pair[1].at_m) - Vector3::from(pair[0].at_m)).normalize())
            .collect();
        let pressed = (ways[ways.len() - 1] - ways[0]) * tension;
        assert!(pressed.z < 0.0 && ways.len() > 1, "{pressed}");
        // Every bend presses, none pulls.
        for pair in ways.windows(2) {
            let turn = (pair[1] - pair[0]).dot(&pressed);
            assert!(turn > -1e-3 * pressed.norm(), "{ways:?}");
        }
    }
}

/// A hand feels how the tension changes with its way, bends included.
#[test]
fn hands_feel_a_span_over_a_rim() {
    for place in [PLACES[0], PLACES[3]] {
        let mut bench = laid(place, true, below);
        go(&mut bench, Vector3::new(0.0, 0.0, -0.0024));
        for _ in 0..10 {
            bench.step_both();
        }
        let report = bench.step_both();
        super::pull::tangents_are_true(&mut bench, &report);
    }
}

/// What the hand does over a rim is stored, in the tissue and in the thread, and comes back; what is missing falls with the step.
#[test]
fn the_work_on_a_span_over_a_rim_is_stored() {
    let missing = [2e-4f64, 5e-5].map(|step_m| {
        let mut bench = laid(PLACES[0], true, below);
        let stored = |bench: &Bench, report: &StepReport| {
            report.stored_energy_j + super::pull::stretched(bench, EA_N).1
        };
        let report = bench.step_both();
        let pull = |report: &StepReport| -report.contacts()[0].wrench[2];
        let (mut before, start_j) = (pull(&report), stored(&bench, &report));
        let (mut work_j, mut peak_j, mut worst_j) = (0.0, 0.0f64, 0.0f64);
        let steps = (0.002 / step_m).round() as usize;
        for k in 0..2 * steps {
            let way = if k < steps { -step_m } else { step_m };
            let report = go(&mut bench, Vector3::new(0.0, 0.0, way));
            let now = pull(&report);
            work_j += 0.5 * (before + now) * way;
            before = now;
            let stored_j = stored(&bench, &report) - start_j;
            peak_j = peak_j.max(stored_j);
            worst_j = worst_j.max((work_j - stored_j).abs());
        }
        println!("{step_m}: {worst_j} of {peak_j} J");
        worst_j / peak_j
    });
    assert!(
        missing[1] < 0.02 && missing[1] < 0.6 * missing[0] + 1e-3,
        "{missing:?}"
    );
}
