//! Needles that go to and fro along themselves through tissue that does not move, with and without a thread, by tip and by end: their
//! list against all faces of the mesh, which nothing is asked about who is next to whom.

use super::support::{Body, generated, jittered};
use nalgebra::{Isometry3, Vector3};
use std::f64::consts::TAU;
use sutura_host::mesh::{HalfFace, slab, tube};
use sutura_host::needle::{
    Crossing, Curve, History, Needle, NeedleSegment, NeedleSegments, NeedleShape, SlideStatus,
    slide,
};
use sutura_testkit::Random;

/// A way made of lines and arcs: length, and 1 / radius.
pub type Track = Vec<(f64, f64)>;

/// A passage through a face, by where on the way.
#[derive(Clone, Copy, Debug)]
pub struct Met {
    pub at: f64,
    /// The half-face of the cell that it comes from; of that which it goes to if it comes from outside.
    pub half: HalfFace,
    pub enters: bool,
}

/// A point of the way and its tangent, in the plane of the first tangent and of what lies across it.
fn along(track: &Track, mut at: f64) -> ([f64; 2], [f64; 2]) {
    let (mut point, mut heading) = ([0.0, 0.0], 0.0f64);
    for (place, (length, curvature)) in track.iter().enumerate() {
        let part = if place + 1 == track.len() {
            at
        } else {
            at.min(*length)
        };
        let (sin, cos) = heading.sin_cos();
        let turn = part * curvature;
        let (x, y) = if *curvature == 0.0 {
            (part, 0.0)
        } else {
            (turn.sin() / curvature, (1.0 - turn.cos()) / curvature)
        };
        point = [point[0] + x * cos - y * sin, point[1] + x * sin + y * cos];
        heading += turn;
        at -= part;
        if at <= 0.0 {
            break;
        }
    }
    (point, [heading.cos(), heading.sin()])
}

/// Where the way lies in space: a point, and the axes of its plane.
#[derive(Clone, Copy)]
pub struct Plane {
    pub origin: Vector3<f64>,
    pub x: Vector3<f64>,
    pub y: Vector3<f64>,
}

impl Plane {
    fn at(&self, track: &Track, at: f64) -> (Vector3<f64>, Vector3<f64>) {
        let (point, tangent) = along(track, at);
        let of = |[u, v]: [f64; 2]| self.x * u + self.y * v;
        (self.origin + of(point), of(tangent))
    }
}

/// All faces that a way goes through, in its order: each face against each line and circle by their equations.
pub fn all_faces(body: &Body, track: &Track, plane: &Plane) -> Vec<Met> {
    let mut met = Vec::new();
    let mut begins = 0.0;
    for (length, curvature) in track {
        let (point, tangent) = plane.at(track, begins);
        let across = plane.x.cross(&plane.y).cross(&tangent);
        for half in body.mesh.faces() {
            let [a, b, c] = body.mesh.vertices(*half).map(|node| body.at[node as usize]);
            let normal = (b - a).cross(&(c - a));
            let far = normal.dot(&(a - point));
            let (t, n) = (normal.dot(&tangent), normal.dot(&across));
            let places = if *curvature == 0.0 {
                [Some(far / t), None]
            } else {
                // t sin(s) + n (1 - cos(s)) = far curvature.
                let size = t.hypot(n);
                let sine = (far * curvature - n) / size;
                let phase = n.atan2(t);
                let first = (sine.abs() <= 1.0).then(|| sine.asin());
                let both = [first, first.map(|angle| TAU / 2.0 - angle)];
                both.map(|angle| Some((angle? + phase).rem_euclid(TAU) / curvature))
            };
            for place in places.into_iter().flatten() {
                if !(0.0..*length).contains(&place) {
                    continue;
                }
                let (hit, way) = plane.at(track, begins + place);
                let area = normal.norm_squared();
                let parts = [(b, c), (c, a), (a, b)]
                    .map(|(p, q)| (p - hit).cross(&(q - hit)).dot(&normal) / area);
                if parts.iter().any(|part| *part <= 0.0) {
                    continue;
                }
                // Half-faces are seen counter-clockwise from outside their cell.
                let outwards = way.dot(&normal) > 0.0;
                let other = body.mesh.opposite(*half);
                let (from, into) = if outwards {
                    (Some(*half), other)
                } else {
                    (other, Some(*half))
                };
                met.extend(from.or(into).map(|half| Met {
                    at: begins + place,
                    half,
                    enters: from.is_none(),
                }));
            }
        }
        begins += length;
    }
    met.sort_by(|a, b| a.at.total_cmp(&b.at));
    met
}

/// What a needle has of a way.
pub fn needle_on(
    track: &Track,
    plane: &Plane,
    from: f64,
    length_m: f64,
) -> (Needle, Isometry3<f64>) {
    let mut segments = Vec::new();
    let mut begins = 0.0;
    for (length, curvature) in track {
        let ends = begins + length;
        let part = ends.min(from + length_m) - begins.max(from);
        if part > 0.0 {
            segments.push((part, *curvature));
        }
        begins = ends;
    }
    let shape = match segments.as_slice() {
        [(length_m, 0.0)] => NeedleShape::Straight {
            length_m: *length_m,
        },
        [(length_m, curvature)] => NeedleShape::Arc {
            radius_m: curvature.recip(),
            angle_rad: length_m * curvature,
        },
        several => {
            let each = several.iter().map(|(length_m, curvature)| NeedleSegment {
                length_m: *length_m,
                radius_m: curvature.recip(),
            });
            let each: Vec<_> = each.collect();
            NeedleShape::Segments(NeedleSegments::new(&each).expect("a few"))
        }
    };
    let (start, tangent) = plane.at(track, from);
    let normal = plane.x.cross(&plane.y);
    let axes = nalgebra::Matrix3::from_columns(&[tangent, normal.cross(&tangent), normal]);
    let turn = nalgebra::Rotation3::from_matrix_unchecked(axes);
    let needle = Needle {
        shape,
        thickness_m: 1e-3,
    };
    (needle, Isometry3::from_parts(start.into(), turn.into()))
}

fn curve_on(track: &Track, plane: &Plane, from: f64, length_m: f64) -> Curve {
    let (needle, pose) = needle_on(track, plane, from, length_m);
    needle.at(&pose)
}

#[derive(Debug, Default)]
struct Count {
    drives: usize,
    steps: usize,
    reversals: usize,
    /// Steps with the end in tissue, and of those back.
    inside: usize,
    back_inside: usize,
    /// Ends that came out of tissue backwards, or went into it.
    ends_out: usize,
    ends_in: usize,
    compared: usize,
    joined: usize,
}

/// Drives a needle to and fro, and compares its list after every step.
fn drive(
    body: &Body,
    (track, plane, length): (&Track, &Plane, f64),
    (steps, threaded): (usize, bool),
    random: &mut Random,
    count: &mut Count,
) -> Result<(), String> {
    let met = all_faces(body, track, plane);
    let (Some(first), Some(last)) = (met.first(), met.last()) else {
        return Ok(());
    };
    count.drives += 1;
    // From just before the first face, all of it outside, to just behind the last.
    let whole: f64 = track.iter().map(|(length, _)| length).sum();
    let begin = (first.at - 1.05 * length).max(0.0);
    let reach = (last.at + 0.05 * length).min(whole - length);
    let mut history = History::new(4000);
    let (mut at, mut forward) = (begin, true);
    for step in 0..steps {
        let size = [0.02, 0.1, 0.5][random.bits() as usize % 3];
        let turned = random.unit() < 0.15;
        forward ^= turned;
        count.reversals += usize::from(turned);
        let by = size * length * random.unit() * if forward { 1.0 } else { -1.0 };
        let to = (at + by).clamp(begin, reach.max(begin));
        let (by, was) = (to - at, at);
        at = to;
        let tie = 1e-9 * length;
        // Where rounding decides, nothing is asked.
        let doubtful = |m: &Met| (m.at - at).abs() < tie || (m.at - at - length).abs() < tie;
        if met.iter().any(doubtful) {
            at = was;
            continue;
        }
        let needle = curve_on(track, plane, at, length);
        let had_end = history.end_cell(&body.mesh);
        let report = slide(&body.geometry(), &needle, &mut history, by);
        if report.status != SlideStatus::Ok || report.guessed > 0 {
            return Err(format!("{report:?} at step {step}"));
        }
        if !threaded {
            history.drop_behind(&body.mesh, 0.0);
        }
        let checked = history.check(&body.mesh, length);
        let end = history.end_cell(&body.mesh);
        let from = if threaded { 0.0 } else { at };
        let own = met.iter().filter(|m| m.at >= from && m.at <= at + length);
        let own: Vec<&Met> = own.collect();
        let same = |found: &Crossing, met: &&Met| {
            let apart = (found.alpha - (met.at - at)).abs();
            (found.face, found.enters) == (met.half, met.enters) && apart < 1e-8 * length
        };
        let all = history.crossings();
        let agree = all.len() == own.len() && all.iter().zip(&own).all(|(a, b)| same(a, b));
        let before = met.iter().rfind(|m| m.at < at);
        let behind = before.and_then(|m| {
            let ahead = if m.enters {
                Some(m.half)
            } else {
                body.mesh.opposite(m.half)
            };
            ahead.map(HalfFace::cell)
        });
        if !agree || checked.is_err() || end != behind {
            return Err(format!(
                "step {step} at {at} by {by}: {checked:?} {all:?}\n{own:?}"
            ));
        }
        count.steps += 1;
        count.inside += usize::from(end.is_some());
        count.back_inside += usize::from(end.is_some() && by < 0.0);
        count.ends_out += usize::from(by < 0.0 && had_end.is_some() && end.is_none());
        count.ends_in += usize::from(by < 0.0 && had_end.is_none() && end.is_some());
        count.compared += all.len();
        count.joined += usize::from(
            needle.bends()
                && needle
                    != Curve {
                        joints: Default::default(),
                        ..needle
                    },
        );
    }
    Ok(())
}

/// A way from outside a body through it and out again, with a needle's length; `kind` lines, arcs, and both by turns.
fn any_track(body: &Body, kind: usize, random: &mut Random) -> (Track, Plane, f64) {
    let (low, high) = body.bounds();
    let size = (high - low).norm();
    let length = random.between(0.15, 1.1) * size;
    let middle = (low + high) / 2.0 + (high - low).component_mul(&random.vector()) * 0.3;
    let x = random.direction();
    let y = x.cross(&random.direction()).normalize();
    let far = size + length;
    let mut track: Track = match kind {
        0 => vec![(2.0 * far, 0.0)],
        1 => {
            let radius = far / 2.0 + random.unit() * size;
            vec![(TAU * radius - 1.01 * length, radius.recip())]
        }
        _ => vec![(far, 0.0)],
    };
    if kind == 2 {
        for place in 0..random.bits() as usize % 3 + 1 {
            let curvature = random.between(0.3, 1.2) / size;
            track.push((0.3 * size * random.between(0.5, 1.0), curvature));
            if place == 1 {
                track.push((0.2 * size, 0.0));
            }
        }
        track.push((far, 0.0));
    }
    // Its middle lies in the body, and its beginning outside.
    let half = if kind == 1 { track[0].0 / 2.0 } else { far };
    let mut plane = Plane {
        origin: Vector3::zeros(),
        x,
        y,
    };
    let (there, _) = plane.at(&track, half);
    plane.origin = middle - there;
    (track, plane, length)
}

/// So many drives of so many steps; how many of them differ.
fn drives(body: &Body, seed: u64, (count, steps): (usize, usize), tally: &mut Count) -> usize {
    let mut random = Random::new(seed);
    let (low, high) = body.bounds();
    let (mut differ, mut number) = (0, 0);
    let upto = tally.drives + count;
    while tally.drives < upto {
        number += 1;
        let way = any_track(body, number % 3, &mut random);
        let (track, plane, length) = (&way.0, &way.1, way.2);
        // A needle starts outside.
        let needle = curve_on(track, plane, 0.0, length);
        let is_inside = |look: u32| {
            let at = needle.at(length * f64::from(look) / 20.0);
            (0..3).all(|k| low[k] <= at[k] && at[k] <= high[k])
        };
        if (0..=20).any(is_inside) {
            continue;
        }
        let threaded = number / 3 % 2 == 0;
        let way = (track, plane, length);
        if let Err(told) = drive(body, way, (steps, threaded), &mut random, tally) {
            eprintln!("drive {number} of {seed}: {:.2000}", told);
            differ += 1;
        }
    }
    differ
}

fn bodies() -> Vec<Body> {
    let random = &mut Random::new(90);
    let even = slab([4.0, 3.0, 2.0], [4, 3, 2]).expect("a slab");
    let uneven = jittered(&even, random, 0.15);
    let round = tube([0.5, 1.0], [-1.0, 1.0], [2, 12, 4]).expect("a tube");
    let mut bodies = vec![
        Body::at_rest(&uneven),
        Body::at_rest(&uneven).deformed(random, 0.8),
        Body::at_rest(&round),
        Body::at_rest(&round).deformed(random, 0.3),
    ];
    bodies.push(Body::at_rest(&generated("cube_1650")));
    bodies
}

/// `count` drives of so many steps in each body: none differs.
fn against_all_faces(count: usize, steps: usize) -> Count {
    let mut tally = Count::default();
    let mut differ = 0;
    for (seed, body) in (0..).zip(bodies()) {
        differ += drives(&body, 200 + seed, (count, steps), &mut tally);
    }
    eprintln!("{tally:?}");
    assert_eq!(differ, 0);
    let steps = tally.steps;
    assert!(tally.reversals > steps / 20 && tally.inside > steps / 20);
    assert!(tally.back_inside > steps / 60 && tally.joined > steps / 60);
    assert!(tally.ends_out > steps / 1000 && tally.ends_in > steps / 1000);
    assert!(tally.compared > steps);
    tally
}

#[test]
fn to_and_fro_against_all_faces() {
    let tally = against_all_faces(220, 100);
    assert!(tally.steps >= 100_000, "{tally:?}");
}

/// A hundred thousand drives.
#[test]
#[ignore = "a hundred thousand drives"]
fn a_hundred_thousand_drives_against_all_faces() {
    let tally = against_all_faces(20_000, 100);
    assert!(tally.drives >= 100_000, "{tally:?}");
}
