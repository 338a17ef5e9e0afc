//! Needles through meshes: the list that follows a needle step by step against brute force.

pub mod back;
mod extremes;
mod oracle;
pub mod support;

use nalgebra::Vector3;
use oracle::{Aside, NOT, Oracle};
use support::{Body, Way, generated, jittered};
use sutura_host::mesh::{TetMesh, slab, tube};
use sutura_host::needle::{History, SlideStatus, slide};
use sutura_testkit::Random;

/// What was met.
#[derive(Debug, Default)]
struct Tally {
    steps: usize,
    pushed: usize,
    popped: usize,
    /// Most crossings in one step, forward or back.
    most: usize,
    passes: usize,
    /// Crossings compared, over all steps.
    compared: usize,
    /// Of those, through vertices and edges.
    vertices: usize,
    edges: usize,
    /// Of the needle's length: alpha, where face and curve are 0.01 rad apart or more.
    alpha: f64,
    /// The same times the sine of that angle, for all.
    depth: f64,
    /// From the curve to the point on the face.
    off: f64,
    end_inside: usize,
}

/// How far a needle slides in one step.
enum Slides {
    Any,
    /// In multiples of a length, which are exact.
    By(f64),
}

impl Slides {
    /// To and fro: on the same way for a while, then back for a shorter one.
    fn next(&self, random: &mut Random, way: &Way, forward: &mut bool) -> f64 {
        let most = match random.bits() % 20 {
            0 => 0.0,
            1 => 0.7 * way.reach,
            2..5 => way.length(),
            5..12 => 0.3 * way.length(),
            _ => 0.05 * way.length(),
        };
        if random.unit() < if *forward { 0.1 } else { 0.2 } {
            *forward = !*forward;
        }
        let any = most * random.unit() * if *forward { 1.0 } else { -1.0 };
        match self {
            Self::Any => any,
            Self::By(quantum) => (any / quantum).round() * quantum,
        }
    }
}

/// Slides a needle to and fro along its way, and looks at everything after every step.
fn follow(
    body: &Body,
    way: &Way,
    steps: usize,
    slides: &Slides,
    aside: Aside,
    random: &mut Random,
    tally: &mut Tally,
) {
    let (geometry, length) = (body.geometry(), way.length());
    let oracle = Oracle::new(&body.mesh, &body.at);
    let [mut history, mut needle_only] = [History::new(2000), History::new(0)];
    let (mut along, mut forward) = (0.0, true);
    for step in 0..steps {
        let sigma = slides.next(random, way, &mut forward);
        let sigma = (along + sigma).clamp(0.0, way.reach) - along;
        if along + sigma == 0.0 || along + sigma == way.reach {
            forward = !forward;
        }
        along += sigma;
        let needle = way.needle(along);
        let report = slide(&geometry, &needle, &mut history, sigma);
        assert_eq!((report.status, report.guessed), (SlideStatus::Ok, 0));
        assert_eq!(history.check(&body.mesh, length), Ok(()));

        let expected = oracle.crossings(&needle, [-along, length], aside);
        let behind = expected.iter().take_while(|c| c.alpha < 0.0).count();
        let (cell, end) = (expected.last(), expected[..behind].last());
        let expected = &expected[behind..];
        let names = |step: &str| format!("{step} at step {step:?}, {along} along, by {sigma}");
        let found = history.on_needle();
        // Without what lies behind its end the needle is the same.
        needle_only.clone_from(&history);
        let dropped = needle_only.drop_behind(&body.mesh, 0.0);
        assert_eq!(
            (needle_only.check(&body.mesh, length), dropped),
            (Ok(()), behind)
        );
        assert_eq!(needle_only.crossings(), found);
        assert_eq!(needle_only.before(), history.end_cell(&body.mesh));
        let both = |k: usize| (found.get(k), expected.get(k));
        assert_eq!(found.len(), expected.len(), "{}", names("count"));
        assert_eq!(
            history.tip_cell(&body.mesh),
            cell.and_then(|c| c.to),
            "tip at step {step}"
        );
        assert_eq!(
            history.end_cell(&body.mesh),
            end.and_then(|c| c.to),
            "end at step {step}"
        );
        for (k, (found, expected)) in found.iter().zip(expected).enumerate() {
            assert_eq!(
                (found.face, found.enters, found.from(), found.to(&body.mesh)),
                (expected.face, expected.enters, expected.from, expected.to),
                "{k} {:?} at step {step}",
                both(k)
            );
            let apart = (found.alpha - expected.alpha).abs() / length;
            let nodes = body.mesh.vertices(found.face);
            let on_face: Vector3<f64> = std::iter::zip(nodes, found.weights)
                .map(|(node, weight)| body.at[node as usize] * weight)
                .sum();
            tally.depth = tally.depth.max(apart * expected.steepness);
            if expected.steepness > 0.01 {
                tally.alpha = tally.alpha.max(apart);
            }
            tally.off = tally
                .off
                .max((on_face - needle.at(found.alpha)).norm() / length);
            let zeros = found.weights.iter().filter(|w| **w == 0.0).count();
            tally.vertices += usize::from(zeros == 2);
            tally.edges += usize::from(zeros == 1);
        }
        tally.compared += found.len();
        tally.steps += 1;
        tally.pushed += report.pushed as usize;
        tally.popped += report.popped as usize;
        tally.passes += (report.entered + report.left) as usize;
        tally.most = tally.most.max(report.pushed.max(report.popped) as usize);
        tally.end_inside += usize::from(end.is_some_and(|c| c.to.is_some()));
    }
}

impl Tally {
    /// The two ways of finding alpha and a point agree.
    fn is_close(&self) {
        eprintln!("{self:?}");
        let worst = self.alpha.max(self.depth).max(self.off);
        assert!(worst <= 1e-12, "{self:?}");
        assert!(self.popped > self.steps / 12 && self.most >= 8, "{self:?}");
        assert!(self.passes > self.steps / 50, "{self:?}");
        assert!(self.end_inside > self.steps / 20, "{self:?}");
        assert!(self.compared > self.steps, "{self:?}");
    }
}

/// Through faces, as a curve does that has nothing to do with the mesh.
fn through_faces(body: &Body, seed: u64, needles: usize, steps: usize) -> Tally {
    let mut random = Random::new(seed);
    let (low, high) = body.bounds();
    let size = (high - low).norm();
    let mut tally = Tally::default();
    for needle in 0..needles {
        let length = random.between(0.2, 1.5) * size;
        let way = loop {
            let way = if needle % 2 == 0 {
                Way::any_line(body, &mut random, length)
            } else {
                Way::any_arc(body, &mut random, length)
            };
            if let Some(way) = way.trimmed(body, 6) {
                break way;
            }
        };
        follow(
            body,
            &way,
            steps,
            &Slides::Any,
            NOT,
            &mut random,
            &mut tally,
        );
    }
    tally.is_close();
    tally
}

/// Moves the mesh as a whole.
fn shifted(mesh: &TetMesh, by: [f64; 3]) -> TetMesh {
    let points = mesh.points_m().iter();
    let points = points.map(|p| (Vector3::from(*p) + Vector3::from(by)).into());
    TetMesh::new(points.collect(), mesh.cells().to_vec()).expect("the same mesh")
}

#[test]
fn any_way_through_a_jittered_slab() {
    let even = slab([4.0, 3.0, 2.0], [4, 3, 2]).expect("a slab");
    let random = &mut Random::new(1);
    for seed in 0..5 {
        let mesh = jittered(&even, random, 0.15);
        through_faces(&Body::at_rest(&mesh), 10 + seed, 20, 200);
        let deformed = Body::at_rest(&mesh).deformed(random, 0.8);
        assert!(deformed.slack_m > 0.1 && deformed.volumes().all(|v| v > 0.0));
        through_faces(&deformed, 20 + seed, 20, 200);
    }
}

#[test]
fn any_way_through_generated_meshes() {
    for (seed, name) in ["cube_1650", "cylinder_1650", "tubes_younes"]
        .into_iter()
        .enumerate()
    {
        let body = Body::at_rest(&generated(name));
        through_faces(&body, 30 + seed as u64, 10, 100);
        let (low, high) = body.bounds();
        let deformed = body.deformed(&mut Random::new(40), 0.1 * (high - low).amin());
        assert!(deformed.volumes().all(|v| v > 0.0));
        through_faces(&deformed, 50 + seed as u64, 10, 100);
    }
}

#[test]
fn any_way_through_a_tube_and_through_two_bodies() {
    let tube = tube([0.5, 1.0], [-1.0, 1.0], [2, 12, 4]).expect("a tube");
    through_faces(&Body::at_rest(&tube), 60, 40, 200);
    let bent = Body::at_rest(&tube).deformed(&mut Random::new(61), 0.3);
    through_faces(&bent, 62, 40, 200);

    // One a little beside the other; one on the other, face to face without sharing a node.
    let left = slab([2.0, 2.0, 2.0], [3, 3, 3]).expect("a slab");
    let right = slab([2.0, 2.0, 2.0], [2, 3, 4]).expect("a slab");
    for (seed, gap) in [(63, 0.1), (64, 0.0)] {
        let both = left.beside(&shifted(&right, [2.0 + gap, 0.0, 0.0]));
        let both = both.expect("two bodies");
        through_faces(&Body::at_rest(&both), seed, 40, 200);
    }
}

/// Through corners, along edges, in faces: `ways` that meet the mesh to the last bit.
fn through_corners(body: &Body, seed: u64, steps: usize, ways: &[(Way, Slides)]) -> Tally {
    let mut random = Random::new(seed);
    let mut tally = Tally::default();
    // Aside by what no two parts of these meshes are apart.
    let aside = Aside(1e-6, 1e-10);
    for (way, slides) in ways {
        follow(body, way, steps, slides, aside, &mut random, &mut tally);
    }
    tally.is_close();
    assert!(tally.vertices > tally.steps / 4, "{tally:?}");
    assert!(tally.vertices + tally.edges > tally.steps, "{tally:?}");
    tally
}

const AXES: [Vector3<f64>; 3] = [
    Vector3::new(1.0, 0.0, 0.0),
    Vector3::new(0.0, 1.0, 0.0),
    Vector3::new(0.0, 0.0, 1.0),
];

/// Lines along the axes through corners, middles of edges and middles of faces of a grid of ones in
/// [-2, 2] x [-2, 2] x [-2, 0], and along its surface; `count` of them, for a body with x and y up to `size`.
fn lines_along_axes(random: &mut Random, count: usize, size: f64) -> Vec<(Way, Slides)> {
    let mut pick = |n: u64| (random.bits() % n) as usize;
    let draw = |_| {
        let axis = pick(3);
        let sign = [1.0, -1.0][pick(2)];
        let aside = [AXES[(axis + 1) % 3], AXES[(axis + 2) % 3]];
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let (inward, exact) = match pick(6) {
            0 => (aside[0], true),
            1 => (-aside[0], true),
            2 => (aside[1], true),
            3 => (-aside[1], true),
            4 => ((aside[0] + aside[1]) * half, false),
            _ => ((aside[1] - aside[0]) * half, false),
        };
        let mut start = Vector3::from_fn(|_, _| 0.5 * pick(9) as f64 - 2.0);
        start.z = -0.5 * pick(5) as f64;
        start[axis] = if axis == 2 {
            -1.0 - 4.25 * sign
        } else {
            -(size + 3.25) * sign
        };
        let slides = if exact {
            Slides::By(0.0625)
        } else {
            Slides::Any
        };
        (
            Way::line(start, AXES[axis] * sign, inward, 3.0, 2.0 * size + 3.5),
            slides,
        )
    };
    (0..count).map(draw).collect()
}

/// Lines along the diagonals of the faces of the same grid, and in its surface.
fn lines_along_diagonals(random: &mut Random, count: usize) -> Vec<(Way, Slides)> {
    let mut pick = |n: u64| (random.bits() % n) as usize;
    let draw = |_| {
        let (axis, other, signs) = (pick(3), 1 + pick(2), [pick(2), pick(2)]);
        let [a, b, c] = [axis, (axis + other) % 3, (axis + 3 - other) % 3];
        let [one, two] = signs.map(|sign| [1.0, -1.0][sign]);
        let half = std::f64::consts::FRAC_1_SQRT_2;
        // Places on the line have the same two coordinates but for their sign: they stay so.
        let diagonal = AXES[a] * one + AXES[b] * two;
        let across = AXES[b] * two - AXES[a] * one;
        let inward = if pick(2) == 0 { across * half } else { AXES[c] };
        let mut start = diagonal * -4.25;
        start[c] = 0.5 * (pick(5) as f64) - if c == 2 { 2.0 } else { 1.0 };
        (
            Way::line(start, diagonal * half, inward, 3.0, 9.0),
            Slides::Any,
        )
    };
    (0..count).map(draw).collect()
}

#[test]
fn lines_through_vertices_and_edges_and_in_faces() {
    let mesh = slab([4.0, 4.0, 2.0], [4, 4, 2]).expect("a slab");
    let body = Body::at_rest(&mesh);
    let random = &mut Random::new(70);
    through_corners(&body, 71, 100, &lines_along_axes(random, 120, 2.0));
    through_corners(&body, 72, 100, &lines_along_diagonals(random, 120));

    // The grid's planes slanted: its space diagonals are along z.
    for [slant_x, slant_y] in [[1.0, 1.0], [-1.0, 1.0]] {
        let slanted = |at: &Vector3<f64>| at - Vector3::new(slant_x, slant_y, 0.0) * at.z;
        let slanted = Body::new(body.mesh.clone(), body.at.iter().map(slanted).collect());
        through_corners(&slanted, 73, 100, &lines_along_axes(random, 120, 4.0));
    }

    // A second body with its face on that of the first, and other cells.
    let other = slab([4.0, 4.0, 2.0], [2, 4, 4]).expect("a slab");
    let both = mesh.beside(&shifted(&other, [4.0, 0.0, 0.0]));
    let body = Body::at_rest(&both.expect("two bodies"));
    through_corners(&body, 74, 100, &lines_along_axes(random, 120, 6.0));
}

#[test]
fn lines_along_the_edges_of_a_tube() {
    let tube = tube([0.5, 1.0], [-1.0, 1.0], [2, 12, 4]).expect("a tube");
    let body = Body::at_rest(&tube);
    let random = &mut Random::new(75);
    let way = |_| {
        let mut start = body.at[random.bits() as usize % body.at.len()];
        let sign = [1.0, -1.0][random.bits() as usize % 2];
        start.z = -2.25 * sign;
        // Nothing else is in a plane that is turned anyhow.
        let angle = random.between(0.0, 6.0);
        let inward = Vector3::new(angle.cos(), angle.sin(), 0.0);
        let way = Way::line(start, AXES[2] * sign, inward, 1.0, 3.5);
        (way, Slides::Any)
    };
    let ways: Vec<_> = (0..50).map(way).collect();
    through_corners(&body, 76, 100, &ways);
}

#[test]
fn circles_through_vertices_and_edges() {
    // (5, 0), (4, 3), (3, 4) and their mirror images are nodes.
    let flat = Body::at_rest(&slab([12.0, 8.0, 2.0], [12, 8, 2]).expect("a slab"));
    let deep = Body::at_rest(&slab([12.0, 2.0, 6.0], [12, 2, 6]).expect("a slab"));
    let [x, y, z] = AXES;
    let mut ways = Vec::new();
    for level in 0..5 {
        let down = z * (-0.5 * f64::from(level));
        ways.push((
            Way::about_origin(5.0, [x, y], 0.96, 6.0, 24.0).moved(down),
            Slides::Any,
        ));
        ways.push((
            Way::about_origin(5.0, [-y, x], 2.53, 6.0, 24.0).moved(down),
            Slides::Any,
        ));
        ways.push((
            Way::about_origin(5.0, [y, x], -0.6, 6.0, 24.0).moved(down),
            Slides::Any,
        ));
    }
    through_corners(&flat, 80, 200, &ways);
    let mut ways = Vec::new();
    for level in 0..5 {
        let aside = y * (-1.0 + 0.5 * f64::from(level));
        for forth in [x, -x] {
            ways.push((
                Way::about_origin(5.0, [forth, z], 0.1, 12.0, 19.0).moved(aside),
                Slides::Any,
            ));
        }
    }
    through_corners(&deep, 81, 200, &ways);
}

/// The same cells in the middle of a slab and of one of twenty times its size: a step inside looks at the same
/// cells, and one from outside at a few boxes more for each doubling of the surface, four ways at most
/// where the tree's first cuts all meet.
#[test]
fn a_step_costs_the_same_in_a_mesh_of_twenty_times_the_size() {
    let small = Body::at_rest(&slab([12.0, 12.0, 5.0], [12, 12, 5]).expect("a slab"));
    let large = Body::at_rest(&slab([60.0, 48.0, 5.0], [60, 48, 5]).expect("a slab"));
    assert_eq!(large.mesh.cells().len(), 20 * small.mesh.cells().len());
    let faces = |body: &Body| body.mesh.boundary().half_faces().len() as f64;
    let doublings = (faces(&large) / faces(&small)).log2().ceil() as u32;
    let tangent = Vector3::new(0.2, 0.1, -1.0).normalize();
    let inward = tangent.cross(&AXES[0]).normalize();
    for (x, y) in [(0.2, 0.1), (-1.7, 2.9)] {
        let start = Vector3::new(x, y, 0.0) - tangent * 10.0;
        let way = Way::line(start, tangent, inward, 9.0, 10.0);
        let [mut one, mut other] = [History::new(100), History::new(100)];
        let mut along = 0.0;
        for sigma in [0.9, 0.05, 0.1, 1.3, 0.05, 0.4, 1.0, 1.5] {
            along += sigma;
            let outside = one.crossings().is_empty();
            let step = |body: &Body, history: &mut History| {
                slide(&body.geometry(), &way.needle(along), history, sigma)
            };
            let (a, b) = (step(&small, &mut one), step(&large, &mut other));
            assert_eq!((a.pushed, a.entered), (b.pushed, b.entered));
            let more = if outside { 4 * 2 * doublings } else { 0 };
            assert!(b.looked_at <= a.looked_at + more, "{a:?} {b:?}");
        }
        assert!(one.crossings().len() > 10);
    }
}
