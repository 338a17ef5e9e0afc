//! Strings over cylinders and ridges against their lengths, over bumps against another hull.

use super::*;
use crate::mesh::{TetMesh, slab, tube};
use std::f64::consts::{PI, TAU};

const LEAST_TURN: f64 = 1e-6;

/// A surface, and its nodes.
struct Tissue {
    skin: Skin,
    at: Vec<Vector3<f64>>,
    faces: Vec<[u32; 3]>,
}

impl Tissue {
    fn new(meshes: &[TetMesh], moved: impl Fn(usize, Vector3<f64>) -> Vector3<f64>) -> Self {
        let (mut at, mut faces) = (Vec::new(), Vec::new());
        for (index, mesh) in meshes.iter().enumerate() {
            let first = at.len() as u32;
            let points = mesh
                .points_m()
                .iter()
                .map(|p| moved(index, Vector3::from(*p)));
            at.extend(points);
            let triangles = mesh.surface().triangles.into_iter();
            faces.extend(triangles.map(|face| face.map(|node| node + first)));
        }
        let skin = Skin::new(&faces, &at);
        Self { skin, at, faces }
    }

    fn path(&self, from: Vector3<f64>, to: Vector3<f64>, up: Vector3<f64>) -> Vec<Vector3<f64>> {
        self.path_of(from, to, up, LEAST_TURN, 40)
    }

    fn path_of(
        &self,
        from: Vector3<f64>,
        to: Vector3<f64>,
        up: Vector3<f64>,
        least_turn: f64,
        most: usize,
    ) -> Vec<Vector3<f64>> {
        let mut out = Vec::with_capacity(most);
        let room = out.capacity();
        let turn = (least_turn, &[][..]);
        wraps(&self.skin, &self.at, &from, &to, &up, turn, &mut out);
        assert!(out.len() <= room && out.capacity() == room);
        let bends = out.iter().map(|Wrap { nodes, weights }| {
            assert!(nodes[0] < nodes[1]);
            assert!(
                (weights[0] + weights[1] - 1.0).abs() < 1e-15 && weights[0].min(weights[1]) >= 0.0
            );
            let [a, b] = nodes.map(|node| self.at[node as usize]);
            a * weights[0] + b * weights[1]
        });
        std::iter::once(from).chain(bends).chain([to]).collect()
    }

    /// Points of the section above the chord, without following anything.
    fn section(&self, plane: &Plane) -> Vec<[f64; 2]> {
        let mut points = vec![[0.0, 0.0], [plane.length, 0.0]];
        for face in &self.faces {
            for k in 0..3 {
                let [a, b] = [face[k], face[(k + 1) % 3]]
                    .map(|node| plane.corner(&self.at, node).expect("a node"));
                if (a.beyond >= 0.0) != (b.beyond >= 0.0) {
                    let at = plane.crossing(&a, &b);
                    if at.h > 0.0 && 0.0 < at.s && at.s < plane.length {
                        points.push([at.s, at.h]);
                    }
                }
            }
        }
        points
    }
}

fn length(path: &[Vector3<f64>]) -> f64 {
    path.windows(2)
        .map(|ends| ends[0].metric_distance(&ends[1]))
        .sum()
}

/// By Andrew's chain.
fn hull_length(mut points: Vec<[f64; 2]>) -> f64 {
    points.sort_by(|a, b| a.partial_cmp(b).expect("numbers"));
    let mut hull: Vec<[f64; 2]> = Vec::new();
    for p in points {
        while let [.., a, b] = hull[..]
            && (b[0] - a[0]) * (p[1] - a[1]) >= (b[1] - a[1]) * (p[0] - a[0])
        {
            hull.pop();
        }
        hull.push(p);
    }
    let sides = hull.windows(2);
    sides
        .map(|ends| (ends[1][0] - ends[0][0]).hypot(ends[1][1] - ends[0][1]))
        .sum()
}

fn vector(x: f64, y: f64, z: f64) -> Vector3<f64> {
    Vector3::new(x, y, z)
}

/// An edge that turns a string by less than the least is bent over if it was before, down to a fifth of that.
#[test]
fn a_string_stays_bent_over_an_edge_that_it_presses_down() {
    const TURN: f64 = 0.05;
    // The top of a block, its middle edge across the string raised to a ridge.
    let mesh = slab([0.02, 0.01, 0.004], [2, 1, 1]).expect("a slab");
    let bends = |share: f64, former: &[[u32; 2]]| {
        let height = 0.01 * (0.5 * share * TURN).tan();
        let ridge = |_, p: Vector3<f64>| {
            if p.z > -1e-9 && p.x.abs() < 1e-9 {
                p + Vector3::z() * height
            } else {
                p
            }
        };
        let tissue = Tissue::new(std::slice::from_ref(&mesh), ridge);
        let (from, to) = (vector(-0.01, 1e-4, 0.0), vector(0.01, 1e-4, 0.0));
        let mut out = Vec::with_capacity(4);
        let turn = (TURN, former);
        wraps(
            &tissue.skin,
            &tissue.at,
            &from,
            &to,
            &Vector3::z(),
            turn,
            &mut out,
        );
        out.iter().map(|wrap| wrap.nodes).collect::<Vec<_>>()
    };
    let edge = bends(1.1, &[]);
    assert_eq!(edge.len(), 1);
    assert!(bends(0.9, &[]).is_empty());
    let kept = [1.1, 0.9, 0.25, 0.15].map(|share| bends(share, &edge).len());
    assert_eq!(kept, [1, 1, 1, 0]);
}

/// Two tangents and an arc; what the polygon lacks falls with the square of its sides.
#[test]
fn over_a_cylinder_a_string_is_two_tangents_and_an_arc() {
    let radius = 0.011;
    let (from, to) = (vector(-0.014, 0.004, 0.0101), vector(0.012, 0.0045, 0.0101));
    let touch = |p: &Vector3<f64>| (radius / p.xy().norm()).acos();
    let apart = from.xy().angle(&to.xy());
    let tangents: f64 = [from, to]
        .map(|p| (p.xy().norm_squared() - radius * radius).sqrt())
        .iter()
        .sum();
    let expected = tangents + radius * (apart - touch(&from) - touch(&to));
    let mut off = Vec::new();
    for around in [16, 32, 64, 128] {
        let mesh = tube([0.008, radius], [0.0, 0.03], [1, around, 4]).expect("a tube");
        let tissue = Tissue::new(&[mesh], |_, p| p);
        let path = tissue.path(from, to, Vector3::y());
        assert!(path.len() > around / 8, "{} of {around}", path.len());
        assert!(length(&path) < expected);
        off.push(1.0 - length(&path) / expected);
    }
    for (coarse, fine) in off.iter().zip(&off[1..]) {
        assert!((3.0..5.0).contains(&(coarse / fine)), "{off:?}");
    }
    assert!(off[3] < 2e-4, "{off:?}");
}

/// Down at the cylinder's far side the string goes the other way, and in its bore a chord is free.
#[test]
fn a_free_chord_has_no_bends_whatever_hangs_over_it() {
    let mesh = tube([0.008, 0.011], [0.0, 0.03], [2, 30, 8]).expect("a tube");
    let tissue = Tissue::new(&[mesh], |_, p| p);
    // Beside the tube, below it, in its bore, along the bore, and one that only touches.
    for (from, to, up) in [
        (
            vector(-0.02, 0.012, 0.01),
            vector(0.02, 0.012, 0.01),
            Vector3::y(),
        ),
        (
            vector(-0.02, -0.012, 0.01),
            vector(0.02, -0.012, 0.01),
            Vector3::y(),
        ),
        (
            vector(-0.004, 0.004, 0.01),
            vector(0.005, 0.004, 0.012),
            Vector3::y(),
        ),
        (
            vector(0.0, -0.0078, 0.001),
            vector(0.001, -0.0077, 0.04),
            Vector3::y(),
        ),
        (
            vector(-0.01, 0.011, 0.01),
            vector(0.01, 0.011, 0.01),
            Vector3::y(),
        ),
    ] {
        assert_eq!(tissue.path(from, to, up), [from, to]);
    }
    // In the bore near the wall: the bore's other wall is above it, the near wall bulges nowhere.
    let point = |angle: f64, z: f64| {
        0.99 * 0.008 * vector(angle.cos(), angle.sin(), 0.0) + z * Vector3::z()
    };
    let (from, to) = (point(-1.6, 0.01), point(-1.2, 0.012));
    assert_eq!(tissue.path(from, to, -(from + to)), [from, to]);
}

/// In a tube that is bent inwards, a string along the bore bends over the near wall, not over the far one.
#[test]
fn in_a_dented_bore_a_string_bends_over_the_near_wall_only() {
    let mesh = tube([0.008, 0.011], [0.0, 0.03], [2, 30, 30]).expect("a tube");
    let dent = 0.002;
    let tissue = Tissue::new(&[mesh], |_, p| {
        let depth = if p.y < 0.0 {
            dent * (1.0 - (p.z / 0.015 - 1.0).powi(2))
        } else {
            0.0
        };
        p + depth * Vector3::y()
    });
    let (from, to) = (
        vector(0.0002, -0.0075, 0.001),
        vector(0.0001, -0.0075, 0.029),
    );
    let path = tissue.path(from, to, Vector3::y());
    let top = path.iter().map(|p| p.y).fold(f64::MIN, f64::max);
    assert!(
        path.len() > 10 && (top - (dent - 0.008)).abs() < 2e-4,
        "{} up to {top}",
        path.len()
    );
}

/// Two blocks whose tops rise towards a gap: over both rims, straight between them.
#[test]
fn over_a_gap_a_string_bends_over_both_rims() {
    let block = || slab([0.02, 0.02, 0.01], [7, 5, 3]).expect("a block");
    let (gap, rise) = (0.004, 0.15);
    let tissue = Tissue::new(&[block(), block()], |index, p| {
        let side = if index == 0 { -1.0 } else { 1.0 };
        let x = p.x + side * 0.5 * (0.02 + gap);
        vector(x, p.y, p.z - rise * (x.abs() - 0.5 * gap))
    });
    let on_top = |x: f64, y: f64| vector(x, y, -rise * (x.abs() - 0.5 * gap));
    let (from, to) = (on_top(-0.012, 0.0011), on_top(0.0105, 0.0011));
    let path = tissue.path(from, to, Vector3::z());
    assert_eq!(path.len(), 4, "{path:?}");
    let expected = (0.010 + 0.0085) * rise.hypot(1.0) + gap;
    assert!((length(&path) / expected - 1.0).abs() < 1e-12);
    assert!((path[1] - on_top(-0.002, 0.0011)).norm() < 1e-12);
    assert!((path[2] - on_top(0.002, 0.0011)).norm() < 1e-12);
    // From a place in the air above the second block it is the first rim only.
    let path = tissue.path(from, vector(0.0105, 0.0011, 0.001), Vector3::z());
    assert_eq!(path.len(), 3);
    // Along a flat top, all nodes of which are in one plane with the chord, nothing.
    let (from, to) = (on_top(-0.012, -0.004), on_top(-0.011, 0.007));
    assert_eq!(tissue.path(from, to, Vector3::z()), [from, to]);
    // Across the plane of two walls that face each other: no way out, no bends; numbers that are none.
    let (from, to) = (vector(-0.002, 0.001, -0.004), vector(0.002, 0.001, -0.004));
    for up in [
        Vector3::zeros(),
        Vector3::x(),
        Vector3::repeat(f64::NAN),
        Vector3::repeat(f64::INFINITY),
    ] {
        assert_eq!(tissue.path(from, to, up).len(), 2);
    }
    for to in [
        from,
        Vector3::repeat(f64::NAN),
        Vector3::repeat(1e300),
        vector(f64::INFINITY, 0.0, 0.0),
    ] {
        let mut out = Vec::with_capacity(4);
        wraps(
            &tissue.skin,
            &tissue.at,
            &from,
            &to,
            &Vector3::z(),
            (LEAST_TURN, &[]),
            &mut out,
        );
        assert!(out.is_empty());
    }
}

/// A block whose top has waves, seen from two points of it.
fn waves() -> (Tissue, impl Fn(f64, f64) -> Vector3<f64>) {
    let block = slab([0.06, 0.06, 0.01], [30, 30, 2]).expect("a block");
    let tissue = Tissue::new(&[block], |_, p| {
        let wave = 0.0015 * ((p.x * 300.0).sin() + (p.y * 370.0 + 200.0 * p.x).cos());
        p + vector(0.0, 0.0, (1.0 + p.z / 0.01) * wave)
    });
    let (at, faces) = (tissue.at.clone(), tissue.faces.clone());
    let on_top = move |x: f64, y: f64| {
        let mut top = f64::MIN;
        for face in &faces {
            let [a, b, c] = face.map(|node| at[node as usize]);
            let area = (b - a).xy().perp(&(c - a).xy());
            let inside = [[b, c], [c, a], [a, b]].map(|[p, q]| {
                let p = p.xy();
                (q.xy() - p).perp(&(nalgebra::Vector2::new(x, y) - p)) / area
            });
            if area > 0.0 && inside.iter().all(|part| *part >= -1e-12) {
                top = top.max(inside[0] * a.z + inside[1] * b.z + inside[2] * c.z);
            }
        }
        vector(x, y, top)
    };
    (tissue, on_top)
}

/// Against a hull of the whole section, which for a graph of heights is what the string follows.
#[test]
fn over_waves_it_is_the_hull_of_the_section() {
    let (tissue, on_top) = waves();
    let mut bent = 0;
    for turn in 0..200 {
        let angle = TAU * f64::from(turn) / 200.0 + 0.001;
        let far = 0.003 + 0.0001 * f64::from(turn);
        let from = on_top(-0.0021, 0.0013);
        let to = on_top(-0.0021 + far * angle.cos(), 0.0013 + far * angle.sin());
        let up = vector(0.1, -0.05, 1.0);
        let plane = Plane::new(&from, &to, &up).expect("a plane");
        let expected = hull_length(tissue.section(&plane));
        let path = tissue.path(from, to, up);
        let found = length(&path);
        let chord = from.metric_distance(&to);
        assert!(
            (found / expected - 1.0).abs() < 1e-9,
            "{turn}: {found} of {expected}"
        );
        assert!(found >= chord);
        bent += u32::from(found > 1.0001 * chord);
        // The same from the other end.
        let mut back = tissue.path(to, from, up);
        back.reverse();
        assert!((length(&back) / found - 1.0).abs() < 1e-9);
        // Left out: what turns by less than is asked for, and what there is no room for; each shortens it.
        let coarse = tissue.path_of(from, to, up, 0.1, 40);
        let turns = coarse
            .windows(3)
            .map(|p| (p[1] - p[0]).angle(&(p[2] - p[1])));
        assert!(turns.into_iter().all(|turn| turn >= 0.1));
        assert!((chord..=found * (1.0 + 1e-12)).contains(&length(&coarse)));
        assert!(found - length(&coarse) < 0.01 * found);
        let one = tissue.path_of(from, to, up, LEAST_TURN, 1);
        assert!(one.len() <= 3 && length(&one) <= found * (1.0 + 1e-12));
    }
    assert!(bent > 100, "{bent}");
}

/// No jump while an end moves by a micrometre at a time, over edges and vertices.
#[test]
fn its_length_follows_small_motion() {
    let (tissue, on_top) = waves();
    let from = on_top(-0.0202, 0.0113);
    let mut before: Option<(f64, Vector3<f64>)> = None;
    let mut bends = [usize::MAX, 0];
    for step in 0..3000 {
        let x = -0.012 + 1e-6 * f64::from(step);
        let to = on_top(x, 0.0113 + 0.3 * (x + 0.012));
        let path = tissue.path_of(from, to, Vector3::z(), 1e-3, 40);
        let now = length(&path);
        bends = [bends[0].min(path.len()), bends[1].max(path.len())];
        if let Some((length, end)) = before {
            let moved = end.metric_distance(&to);
            assert!(
                (now - length).abs() < 1.5 * moved + 1e-8,
                "by {} at {x}",
                now - length
            );
        }
        before = Some((now, to));
    }
    assert!(bends[1] > bends[0], "{bends:?}");
}

/// What moves is followed, with nothing allocated, and to the same bits.
#[test]
fn a_moved_surface_is_followed_without_allocation() {
    let (mut tissue, on_top) = waves();
    let (from, to) = (on_top(-0.0202, 0.0113), on_top(0.013, 0.0107));
    let before = tissue.path(from, to, Vector3::z());
    let turn = nalgebra::Rotation3::from_scaled_axis(vector(0.3, -1.2, 0.7));
    let shift = vector(0.3, 0.1, -0.2);
    for p in &mut tissue.at {
        *p = turn * *p + shift;
    }
    let mut out = Vec::with_capacity(40);
    let [start, end] = [from, to].map(|p| turn * p + shift);
    let allocated = allocation_counter::measure(|| {
        tissue.skin.refit(&tissue.at);
        wraps(
            &tissue.skin,
            &tissue.at,
            &start,
            &end,
            &(turn * Vector3::z()),
            (LEAST_TURN, &[]),
            &mut out,
        );
    });
    assert_eq!(allocated.count_total, 0);
    let path = tissue.path(start, end, turn * Vector3::z());
    assert!(before.len() > 5 && out.len() + 2 == path.len());
    assert!((length(&before) / length(&path) - 1.0).abs() < 1e-9);
    let bits = |path: &[Vector3<f64>]| {
        path.iter()
            .flat_map(|p| [p.x.to_bits(), p.y.to_bits(), p.z.to_bits()])
            .collect::<Vec<_>>()
    };
    assert_eq!(
        bits(&path),
        bits(&tissue.path(start, end, turn * Vector3::z()))
    );
}

/// Through a sphere's poles, where many edges meet in one vertex of the plane.
#[test]
fn over_a_sphere_it_is_the_great_circle() {
    let radius = 0.01;
    // A block blown up to a sphere.
    let mesh = slab([0.02, 0.02, 0.02], [16, 16, 16]).expect("a block");
    let tissue = Tissue::new(&[mesh], |_, p| {
        let p: Vector3<f64> = p + 0.01 * Vector3::z();
        let size = p.norm();
        if size > 0.0 {
            p * (p.amax() / size) * (radius / 0.01)
        } else {
            p
        }
    });
    let [from, to] =
        [0.2 * PI, 0.9 * PI].map(|angle| radius * vector(angle.cos(), 0.0, angle.sin()));
    let path = tissue.path(from, to, from + to);
    let expected = radius * 0.7 * PI;
    assert!(
        (0.995..1.0).contains(&(length(&path) / expected)),
        "{} of {expected}",
        length(&path)
    );
    assert!(
        path.iter()
            .all(|p| p.norm() <= radius * (1.0 + 1e-12) && p.norm() > 0.99 * radius)
    );
}
