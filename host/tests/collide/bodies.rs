//! Pairs from trees against all pairs.

use nalgebra::Vector3;
use std::collections::BTreeSet;
use sutura_host::collide::{Body, Margin, Pair, Path, Verdict};
use sutura_host::mesh::{TetMesh, tube};

const MARGIN: Margin = Margin {
    separation_m: 1e-5,
    tolerance_m: 1e-7,
};

/// Two tubes of which one goes into the other, as for an anastomosis; nodes of the second follow the first's.
struct Scene {
    mesh: TetMesh,
    first: Vec<[u32; 3]>,
    second: Vec<[u32; 3]>,
}

impl Scene {
    fn new() -> Self {
        let upper = tube([0.008, 0.011], [0.0, 0.03], [1, 10, 4]).expect("a tube");
        let lower = tube([0.0115, 0.015], [-0.02, 0.01], [1, 11, 4]).expect("a tube");
        let nodes = upper.points_m().len() as u32;
        let mesh = upper.beside(&lower).expect("two tubes");
        let faces = mesh.surface().triangles;
        let (first, second) = faces.into_iter().partition(|face| face[0] < nodes);
        Self {
            mesh,
            first,
            second,
        }
    }

    /// A step in which everything wobbles: number after number other waves.
    fn path(&self, number: u32) -> impl Fn(u32) -> Path + '_ {
        move |node| {
            let at = Vector3::from(self.mesh.points_m()[node as usize]);
            let place = |time: f64| {
                let phase = 1.3 * f64::from(number) + time;
                let wave = |axis: usize| {
                    let along = 300.0 * at[(axis + 1) % 3] + 200.0 * at[(axis + 2) % 3];
                    0.0012 * (along + 2.0 * phase + axis as f64).sin()
                };
                at + Vector3::from_fn(|axis, _| wave(axis))
            };
            Path {
                from: place(0.0),
                to: place(0.7),
            }
        }
    }
}

fn edges(faces: &[[u32; 3]]) -> BTreeSet<[u32; 2]> {
    let of_face = |[a, b, c]: [u32; 3]| [[a, b], [b, c], [c, a]];
    let sides = faces.iter().flat_map(|face| of_face(*face));
    sides.map(|[a, b]| [a.min(b), a.max(b)]).collect()
}

fn vertices(faces: &[[u32; 3]]) -> BTreeSet<u32> {
    faces.iter().flatten().copied().collect()
}

fn all_pairs(first: &[[u32; 3]], second: &[[u32; 3]]) -> Vec<Pair> {
    let mut pairs = Vec::new();
    for node in vertices(first) {
        pairs.extend(second.iter().map(|face| Pair::VertexFace(node, *face)));
    }
    for node in vertices(second) {
        pairs.extend(first.iter().map(|face| Pair::FaceVertex(*face, node)));
    }
    let others = edges(second);
    for edge in edges(first) {
        pairs.extend(others.iter().map(|other| Pair::EdgeEdge(edge, *other)));
    }
    pairs
}

fn meeting(pairs: &[Pair], path: impl Fn(u32) -> Path) -> BTreeSet<Pair> {
    let meets = |pair: &&Pair| match pair.sweep(&path, &MARGIN).verdict {
        Verdict::Meet(impact) => {
            assert!(!impact.given_up);
            true
        }
        Verdict::Apart => false,
        Verdict::NotFinite => panic!("{pair:?}"),
    };
    pairs.iter().filter(meets).copied().collect()
}

/// In every step, with trees that were built in the first: the same meetings as of all pairs, each visited once,
/// and few others.
#[test]
fn two_bodies_have_the_meetings_of_all_their_pairs() {
    let scene = Scene::new();
    let all = all_pairs(&scene.first, &scene.second);
    let start = scene.path(0);
    let mut first = Body::new(&scene.first, &start, &MARGIN);
    let mut second = Body::new(&scene.second, &start, &MARGIN);
    let mut meetings = 0;
    for number in 0..3 {
        let path = scene.path(number);
        first.sweep(&path, &MARGIN);
        second.sweep(&path, &MARGIN);
        let mut found = Vec::new();
        first.against(&second, &path, |pair| found.push(pair));
        let once: BTreeSet<Pair> = found.iter().copied().collect();
        assert_eq!(once.len(), found.len(), "a pair came twice");
        let expected = meeting(&all, &path);
        assert_eq!(meeting(&found, &path), expected);
        println!(
            "{} of {} pairs visited, {} meet",
            found.len(),
            all.len(),
            expected.len()
        );
        assert!(found.len() * 20 < all.len(), "{} visited", found.len());
        meetings += expected.len();
    }
    assert!(meetings > 50, "{meetings}");
}

/// One half of the wall goes through the other: as above, but for what shares a node.
#[test]
fn a_body_has_the_meetings_of_its_own_pairs() {
    let scene = Scene::new();
    let path = |node: u32| {
        let Path { from, .. } = scene.path(0)(node);
        let to = Vector3::new(from.x, from.y.min(-0.6 * from.y), from.z);
        Path { from, to }
    };
    let body = Body::new(&scene.first, path, &MARGIN);
    let mut found = Vec::new();
    body.with_itself(path, |pair| found.push(pair));
    let ordered = |pair: &Pair| match *pair {
        Pair::FaceVertex(face, node) => Pair::VertexFace(node, face),
        Pair::EdgeEdge(a, b) => Pair::EdgeEdge(a.min(b), a.max(b)),
        pair => pair,
    };
    let once: BTreeSet<Pair> = found.iter().map(ordered).collect();
    assert_eq!(once.len(), found.len(), "a pair came twice");
    let all: BTreeSet<Pair> = all_pairs(&scene.first, &scene.first)
        .iter()
        .filter(|pair| {
            let [a, b, c, d] = pair.nodes();
            match pair {
                Pair::EdgeEdge(..) => ![a, b].iter().any(|node| [c, d].contains(node)),
                _ => ![b, c, d].contains(&a),
            }
        })
        .map(ordered)
        .collect();
    let all: Vec<Pair> = all.into_iter().collect();
    let expected: BTreeSet<Pair> = meeting(&all, path);
    assert_eq!(
        meeting(&found, path)
            .iter()
            .map(ordered)
            .collect::<BTreeSet<_>>(),
        expected
    );
    println!(
        "{} of {} pairs visited, {} meet",
        found.len(),
        all.len(),
        expected.len()
    );
    assert!(expected.len() > 50, "{}", expected.len());
}

#[test]
fn a_step_allocates_nothing() {
    let scene = Scene::new();
    let mut first = Body::new(&scene.first, scene.path(0), &MARGIN);
    let mut second = Body::new(&scene.second, scene.path(0), &MARGIN);
    let mut visited = 0;
    let allocated = allocation_counter::measure(|| {
        let path = scene.path(1);
        first.sweep(&path, &MARGIN);
        second.sweep(&path, &MARGIN);
        first.against(&second, &path, |_| visited += 1);
        first.with_itself(&path, |_| visited += 1);
    });
    assert!(visited > 0);
    assert_eq!(allocated.count_total, 0, "{allocated:?}");
}
