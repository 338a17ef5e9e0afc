//! What must not happen, and what may be asked all the same: an answer or a stop that is reported, never a panic,
//! and a list that keeps its promises.

use super::oracle::{NOT, Oracle};
use super::support::{Body, Way, jittered};
use super::{AXES, Slides, Tally, follow, lines_along_axes};
use nalgebra::Vector3;
use sutura_host::mesh::{TetMesh, slab};
use sutura_host::needle::{Curve, Geometry, History, Slack, SlideStatus, Stop, entry, slide, walk};
use sutura_testkit::Random;

fn small_slab() -> TetMesh {
    let even = slab([4.0, 3.0, 2.0], [4, 3, 2]).expect("a slab");
    jittered(&even, &mut Random::new(100), 0.15)
}

/// A needle in the middle of the body, its end outside.
fn within(body: &Body, most: usize) -> (Way, f64, History) {
    let start = Vector3::new(0.1, 0.2, 4.0);
    let way = Way::line(start, -AXES[2], AXES[0], 3.0, 10.0);
    let mut history = History::new(most);
    let report = slide(&body.geometry(), &way.needle(2.0), &mut history, 2.0);
    assert_eq!(report.status, SlideStatus::Ok);
    assert!(history.tip_cell(&body.mesh).is_some());
    (way, 2.0, history)
}

#[test]
fn poses_that_are_no_numbers_change_nothing() {
    let body = Body::at_rest(&small_slab());
    let (way, along, mut history) = within(&body, 100);
    let (geometry, before) = (body.geometry(), history.clone());
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        for spoil in [
            |curve: &mut Curve, bad| curve.start.y = bad,
            |curve: &mut Curve, bad| curve.tangent.x = bad,
            |curve: &mut Curve, bad| curve.inward.z = bad,
            |curve: &mut Curve, bad| curve.curvature = bad,
            |curve: &mut Curve, bad| curve.length = bad,
        ] {
            let mut curve = way.needle(along + 1.0);
            spoil(&mut curve, bad);
            let report = slide(&geometry, &curve, &mut history, 1.0);
            assert_eq!(report.status, SlideStatus::NotFinite);
            assert_eq!(history, before);
            // The parts by themselves: nothing that is not on the way, and an end.
            let found = entry(&geometry, &curve, &History::new(9), 0.0, 3.0);
            assert!(found.crossing.is_none_or(|c| c.alpha.is_finite()));
            let mut copy = history.clone();
            let walked = walk(&geometry, &curve, &mut copy, 3.0);
            assert!(walked.stop != Stop::Full && copy.check(&body.mesh, 3.0).is_ok());
        }
        let curve = way.needle(along);
        let report = slide(&geometry, &curve, &mut history, bad);
        assert_eq!(report.status, SlideStatus::NotFinite);
        assert_eq!(history, before);
    }
}

#[test]
fn tissue_that_is_nowhere_is_reported() {
    let body = Body::at_rest(&small_slab());
    let (way, along, history) = within(&body, 100);
    let tip = history.tip_cell(&body.mesh).expect("inside");
    for bad in [f64::NAN, f64::INFINITY] {
        for corner in body.mesh.cells()[tip as usize] {
            let geometry = Geometry {
                mesh: &body.mesh,
                hierarchy: &body.hierarchy,
                slack: Slack::Everywhere(0.0),
                at: |node: u32| match node == corner {
                    true => Vector3::new(0.0, bad, 0.0),
                    false => body.at[node as usize],
                },
            };
            let mut history = history.clone();
            let report = slide(&geometry, &way.needle(along + 4.0), &mut history, 4.0);
            assert_eq!(history.check(&body.mesh, 3.0), Ok(()));
            assert!(matches!(report.status, SlideStatus::Ok | SlideStatus::Lost));
        }
        let geometry = Geometry {
            mesh: &body.mesh,
            hierarchy: &body.hierarchy,
            slack: Slack::Everywhere(bad),
            at: |_| Vector3::repeat(bad),
        };
        let mut history = history.clone();
        let report = slide(&geometry, &way.needle(along + 4.0), &mut history, 4.0);
        assert_eq!(report.status, SlideStatus::Lost);
        assert_eq!(history.check(&body.mesh, 3.0), Ok(()));
    }
}

#[test]
fn no_way_changes_nothing_and_outside_there_is_nothing() {
    let body = Body::at_rest(&small_slab());
    let (way, along, mut history) = within(&body, 100);
    let before = history.clone();
    for _ in 0..10 {
        let report = slide(&body.geometry(), &way.needle(along), &mut history, 0.0);
        assert_eq!((report.pushed, report.popped), (0, 0));
        assert_eq!(history, before);
    }
    let mut random = Random::new(101);
    let mut history = History::new(100);
    for _ in 0..1000 {
        let tangent = random.direction();
        let inward = tangent.cross(&random.direction()).normalize();
        // The body's ball has a radius of 2.7 + 0.5, and the way stays above it.
        let start = Vector3::new(0.0, 0.0, 4.0 + 10.0) + random.vector();
        let way = Way::line(start, tangent, inward, 3.0, 0.0);
        let report = slide(
            &body.geometry(),
            &way.needle(0.0),
            &mut history,
            random.between(-4.0, 4.0),
        );
        assert_eq!((report.status, report.pushed), (SlideStatus::Ok, 0));
        assert!(history.crossings().is_empty());
    }
}

#[test]
fn a_needle_that_jumps_keeps_a_sound_list() {
    let body = Body::at_rest(&small_slab());
    let mut random = Random::new(102);
    let mut stops = [0; 3];
    for needle in 0..300 {
        let length = random.between(1.0, 6.0);
        let way = match needle % 2 {
            0 => Way::any_line(&body, &mut random, length),
            _ => Way::any_arc(&body, &mut random, length),
        };
        let length = way.length();
        let mut history = History::new(64);
        for _ in 0..20 {
            // Anywhere on the way, with a slide that has nothing to do with it.
            let along = random.unit() * way.reach;
            let size = 10f64.powf(random.between(-18.0, 4.0));
            let size = if random.unit() < 0.05 { 1e300 } else { size };
            let sigma = size * random.between(-0.3, 1.0);
            let report = slide(&body.geometry(), &way.needle(along), &mut history, sigma);
            assert_eq!(history.check(&body.mesh, length), Ok(()));
            let kind = match report.status {
                SlideStatus::Ok => 0,
                SlideStatus::Full => 1,
                SlideStatus::Lost => 2,
                SlideStatus::NotFinite => panic!("{sigma} is a number"),
            };
            stops[kind] += 1;
            if report.status != SlideStatus::Ok {
                history.clear();
            }
        }
    }
    assert!(stops[0] > 3000, "{stops:?}");
}

#[test]
fn slivers_are_passed_as_other_cells() {
    // Cells of 1 by 1 by 1 / 600: faces meet at 0.1 degrees.
    let flat = slab([4.0, 3.0, 2.0 / 600.0], [4, 3, 2]).expect("a slab");
    let body = Body::at_rest(&flat);
    let least = body.mesh.edges().map(|edge| {
        let [a, b] = body.mesh.edge_vertices(edge).map(|n| body.at[n as usize]);
        let [p, q] = [edge.face(), edge.mate().face()].map(|face| {
            let third = body
                .mesh
                .vertices(face)
                .into_iter()
                .find(|n| !body.mesh.edge_vertices(edge).contains(n));
            let out = body.at[third.expect("a third") as usize] - a;
            out - (b - a) * (out.dot(&(b - a)) / (b - a).norm_squared())
        });
        p.angle(&q).to_degrees()
    });
    assert!(least.fold(180.0, f64::min) < 0.15);
    let mut random = Random::new(103);
    let mut tally = Tally::default();
    for needle in 0..60 {
        let length = random.between(0.5, 3.0);
        let way = loop {
            let way = match needle % 2 {
                0 => Way::any_line(&body, &mut random, length),
                _ => Way::any_arc(&body, &mut random, length),
            };
            if let Some(way) = way.trimmed(&body, 3) {
                break way;
            }
        };
        follow(&body, &way, 100, &Slides::Any, NOT, &mut random, &mut tally);
    }
    assert!(
        tally.compared > tally.steps && tally.off < 1e-12,
        "{tally:?}"
    );
}

/// From the whole line or circle.
fn distance(curve: &Curve, point: &Vector3<f64>) -> f64 {
    (curve.at(curve.project(point, 0.0)) - point).norm()
}

/// Barycentric coordinates of a point in a cell, which may be inside out; `None` if it has no volume to speak of.
fn weights(body: &Body, cell: u32, point: &Vector3<f64>) -> Option<[f64; 4]> {
    let [a, b, c, d] = body.mesh.cells()[cell as usize].map(|node| body.at[node as usize]);
    let volume = |a, b, c, d| -> f64 {
        let [a, b, c, d]: [&Vector3<f64>; 4] = [a, b, c, d];
        (b - a).cross(&(c - a)).dot(&(d - a))
    };
    let all = volume(&a, &b, &c, &d);
    let parts = [
        volume(point, &b, &c, &d),
        volume(&a, point, &c, &d),
        volume(&a, &b, point, &d),
        volume(&a, &b, &c, point),
    ];
    (all.abs() > 1e-6).then(|| parts.map(|part| part / all))
}

#[test]
fn folded_and_collapsed_tissue_is_passed_or_reported() {
    let mesh = small_slab();
    let mut random = Random::new(104);
    let mut stops = [0; 2];
    let (mut inverted, mut flat, mut pushed, mut within) = (0, 0, 0, 0);
    for case in 0..300 {
        let mut body = Body::at_rest(&mesh);
        let by = 10f64.powf(random.between(-1.0, 0.5));
        for at in &mut body.at {
            if random.unit() < 0.3 {
                *at += random.vector() * by;
            }
        }
        if case % 3 == 0 {
            // Edges without a length, cells without a volume.
            for _ in 0..10 {
                let cell = body.mesh.cells()[random.bits() as usize % body.mesh.cells().len()];
                body.at[cell[0] as usize] = body.at[cell[1] as usize];
            }
        }
        if case % 3 == 1 {
            // All in the plane of some needles.
            for at in &mut body.at {
                at.y = at.y.min(0.0);
            }
        }
        let body = Body::new(body.mesh, body.at);
        inverted += body.volumes().filter(|v| *v < 0.0).count();
        flat += body.volumes().filter(|v| *v == 0.0).count();
        let length = random.between(1.0, 6.0);
        let way = match case % 4 {
            0 | 1 => Way::any_line(&body, &mut random, length),
            2 => Way::any_arc(&body, &mut random, length),
            _ => {
                let start = Vector3::new(random.between(-1.0, 1.0), 0.0, 9.0);
                Way::line(start, -AXES[2], AXES[case % 2], length, 20.0)
            }
        };
        let length = way.length();
        // Straight through: the tip is in its cell, whichever way round that is.
        let mut history = History::new(500);
        for step in 1..=50 {
            let sigma = way.reach / 50.0;
            let needle = way.needle(f64::from(step) * sigma);
            let report = slide(&body.geometry(), &needle, &mut history, sigma);
            let tip_cell = history.tip_cell(&body.mesh);
            if let (SlideStatus::Ok, 0, Some(cell)) = (report.status, report.guessed, tip_cell) {
                let inside = weights(&body, cell, &needle.at(length));
                within += usize::from(inside.is_some());
                let least = inside.map_or(0.0, |w| w.into_iter().fold(1.0, f64::min));
                assert!(least > -1e-6, "{case} {step}: {inside:?}");
            }
        }

        let (mut along, mut forward) = (0.0, true);
        let mut history = History::new(500);
        for _ in 0..100 {
            let sigma = Slides::Any.next(&mut random, &way, &mut forward);
            let sigma = (along + sigma).clamp(0.0, way.reach) - along;
            along += sigma;
            let needle = way.needle(along);
            let report = slide(&body.geometry(), &needle, &mut history, sigma);
            assert_eq!(history.check(&body.mesh, length), Ok(()));
            pushed += report.pushed;
            stops[usize::from(report.status != SlideStatus::Ok)] += 1;
            if report.status != SlideStatus::Ok {
                break;
            }
            if report.guessed == 0 {
                let last = report.pushed as usize;
                for crossing in history.crossings().iter().rev().take(last) {
                    let nodes = body.mesh.vertices(crossing.face);
                    let on_face: Vector3<f64> = std::iter::zip(nodes, crossing.weights)
                        .map(|(node, weight)| body.at[node as usize] * weight)
                        .sum();
                    assert!(distance(&needle, &on_face) < 1e-9);
                }
            }
        }
    }
    assert!(inverted > 1000 && flat > 100 && pushed > 3000);
    assert!(within > 1000, "{within}");
    assert!(stops[0] > 50 * stops[1], "{stops:?}");
}

#[test]
fn ten_thousand_crossings_in_one_step() {
    let mesh = slab([1.0, 1.0, 4.0], [1, 1, 5000]).expect("a slab");
    let body = Body::at_rest(&mesh);
    let tangent = Vector3::new(0.1, 0.05, -4.0).normalize();
    let inward = tangent.cross(&AXES[0]).normalize();
    let way = Way::line(Vector3::new(-0.05, 0.01, 5.0), tangent, inward, 4.5, 8.0);
    for most in [100, 8_000, 20_000] {
        let mut history = History::new(most);
        let needle = way.needle(5.0);
        let report = slide(&body.geometry(), &needle, &mut history, 5.0);
        assert_eq!(history.check(&body.mesh, 4.5), Ok(()));
        let found = history.crossings();
        assert_eq!(report.pushed as usize, found.len());
        if most < 10_000 {
            assert_eq!((report.status, found.len()), (SlideStatus::Full, most));
            // Withdrawn by so much that the list is whole again.
            let report = slide(&body.geometry(), &way.needle(0.5), &mut history, -4.5);
            assert_eq!(report.status, SlideStatus::Ok);
            assert!(history.crossings().is_empty());
        } else {
            let expected = Oracle::new(&body.mesh, &body.at).crossings(&needle, [-5.0, 4.5], NOT);
            assert!(expected.len() >= 10_000 && report.status == SlideStatus::Ok);
            let names = expected.iter().map(|c| (c.face, c.enters));
            assert!(names.eq(found.iter().map(|c| (c.face, c.enters))));
        }
    }
}

/// How far a point is inside a cell, negative outside: to the nearest of its faces' planes.
fn depth(body: &Body, at: &[Vector3<f64>], cell: u32, point: &Vector3<f64>) -> f64 {
    let faces = body.mesh.half_face(cell, 0).expect("a cell").of_cell();
    let inside = faces.map(|face| {
        let [a, b, c] = body.mesh.vertices(face).map(|node| at[node as usize]);
        -(b - a).cross(&(c - a)).normalize().dot(&(point - a))
    });
    inside.into_iter().fold(f64::INFINITY, f64::min)
}

/// The tissue moves between slides, and nothing holds it to the needle: crossings come to lie off the curve
/// by as much. The tip is still in its cell but for that; on ways through corners and edges as well, where the least
/// motion takes the curve to other cells.
#[test]
fn tissue_that_moves_from_step_to_step_does_not_lose_the_tip() {
    let jittered = Body::at_rest(&small_slab());
    let grid = Body::at_rest(&slab([4.0, 4.0, 2.0], [4, 4, 2]).expect("a slab"));
    let mut random = Random::new(105);
    let (mut guessed, mut inside) = (0, 0);
    for by in [1e-15, 1e-12, 1e-9, 1e-6, 1e-3, 0.02] {
        let (mut worst, mut misplaced) = (0.0f64, 0.0f64);
        for needle in 0..300 {
            let length = random.between(1.0, 6.0);
            let (body, way) = match needle % 3 {
                0 => {
                    let ways = lines_along_axes(&mut random, 1, 2.0);
                    (&grid, ways[0].0)
                }
                1 => (&jittered, Way::any_line(&jittered, &mut random, length)),
                _ => (&jittered, Way::any_arc(&jittered, &mut random, length)),
            };
            let way = way.trimmed(&jittered, 1).unwrap_or(way);
            let (mut along, mut forward) = (0.0, true);
            let mut history = History::new(500);
            for step in 0..100 {
                let at: Vec<_> = body.at.iter().map(|at| at + random.vector() * by).collect();
                let sigma = Slides::Any.next(&mut random, &way, &mut forward);
                let sigma = (along + sigma).clamp(0.0, way.reach) - along;
                along += sigma;
                let curve = way.needle(along);
                let geometry = Geometry {
                    mesh: &body.mesh,
                    hierarchy: &body.hierarchy,
                    slack: Slack::Everywhere(2.0 * by),
                    at: |node: u32| at[node as usize],
                };
                let report = slide(&geometry, &curve, &mut history, sigma);
                assert_eq!(report.status, SlideStatus::Ok, "{by} {needle} {step}");
                assert_eq!(history.check(&body.mesh, curve.length), Ok(()));
                guessed += report.guessed;
                // Where the needle has a new crossing, the tissue has it too.
                for crossing in history
                    .crossings()
                    .iter()
                    .rev()
                    .take(report.pushed as usize)
                {
                    let nodes = body.mesh.vertices(crossing.face);
                    let on_face: Vector3<f64> = std::iter::zip(nodes, crossing.weights)
                        .map(|(node, weight)| at[node as usize] * weight)
                        .sum();
                    let apart = (on_face - curve.at(crossing.alpha)).norm();
                    misplaced = misplaced.max(apart / (by + 1e-14));
                }
                let tip = curve.at(curve.length);
                let off = match history.tip_cell(&body.mesh) {
                    Some(cell) => {
                        inside += 1;
                        -depth(body, &at, cell, &tip)
                    }
                    // Tissue that comes over a tip that is outside is not a slide's business.
                    None if by > 1e-4 => 0.0,
                    None => {
                        let cells = 0..body.mesh.cells().len() as u32;
                        let deepest = cells.map(|cell| depth(body, &at, cell, &tip));
                        deepest.fold(-1.0, f64::max)
                    }
                };
                worst = worst.max(off / (by + 1e-14));
            }
        }
        assert!(worst < 3.0 && misplaced < 10.0, "{by}: {worst} {misplaced}");
    }
    assert!(guessed > 100 && inside > 3000, "{guessed} {inside}");
}
