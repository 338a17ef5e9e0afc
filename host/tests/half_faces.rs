//! The half-face structure against definitions applied to every cell: Younes 2021, 2.1.1, by brute force.

use proptest::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use sutura_host::mesh::{HalfFace, HalfFaces, MeshError, TetMesh, read_msh, slab};
use sutura_testkit::Random;

type Cell = [u32; 4];

fn triangle(mut nodes: [u32; 3]) -> [u32; 3] {
    nodes.sort_unstable();
    nodes
}

/// The four triangles of a cell with the node that each leaves out.
fn triangles(cell: Cell) -> [([u32; 3], u32); 4] {
    let [a, b, c, d] = cell;
    [
        ([b, c, d], a),
        ([a, c, d], b),
        ([a, b, d], c),
        ([a, b, c], d),
    ]
    .map(|(nodes, apex)| (triangle(nodes), apex))
}

/// How many parts `items` fall into when `joined` ones belong together.
fn parts<T: Copy>(items: &[T], joined: impl Fn(T, T) -> bool) -> usize {
    let mut left: Vec<T> = items.to_vec();
    let mut count = 0;
    while let Some(first) = left.pop() {
        count += 1;
        let mut part = vec![first];
        while let Some(item) = part.pop() {
            let (near, far) = left
                .iter()
                .partition::<Vec<T>, _>(|other| joined(item, **other));
            left = far;
            part.extend(near);
        }
    }
    count
}

/// "A combinatorial 3-manifold": every triangle has at most two cells, and the link of every vertex is a
/// 2-manifold (each edge in at most two triangles, one fan around each vertex), connected, and a sphere
/// or a disk by its Euler characteristic.
fn is_manifold(nodes: u32, cells: &[Cell]) -> bool {
    let mut on_face: BTreeMap<[u32; 3], usize> = BTreeMap::new();
    for (face, _) in cells.iter().flat_map(|cell| triangles(*cell)) {
        *on_face.entry(face).or_default() += 1;
    }
    on_face.values().all(|count| *count <= 2)
        && (0..nodes).all(|node| {
            let link: Vec<[u32; 3]> = cells
                .iter()
                .flat_map(|cell| triangles(*cell))
                .filter(|(_, apex)| *apex == node)
                .map(|(face, _)| face)
                .collect();
            let shared = |a: [u32; 3], b: [u32; 3]| a.iter().filter(|n| b.contains(n)).count();
            let mut edges: BTreeMap<[u32; 2], usize> = BTreeMap::new();
            for [a, b, c] in &link {
                for edge in [[*a, *b], [*b, *c], [*a, *c]] {
                    *edges.entry(edge).or_default() += 1;
                }
            }
            let corners: BTreeSet<u32> = link.iter().flatten().copied().collect();
            let one_fan = |corner: &u32| {
                let fan: Vec<_> = link
                    .iter()
                    .copied()
                    .filter(|t| t.contains(corner))
                    .collect();
                parts(&fan, |a, b| shared(a, b) == 2) == 1
            };
            let closed = edges.values().all(|count| *count == 2);
            // Vertices + triangles - edges, without a difference that could be negative.
            let characteristic = if closed { 2 } else { 1 };
            edges.values().all(|count| *count <= 2)
                && corners.iter().all(one_fan)
                && parts(&link, |a, b| shared(a, b) == 2) == 1
                && corners.len() + link.len() == edges.len() + characteristic
        })
}

/// The same cells with nodes counted from 0 without gaps; with as many nodes as are used.
fn compact(cells: &[Cell]) -> (u32, Vec<Cell>) {
    let used: BTreeSet<u32> = cells.iter().flatten().copied().collect();
    let new: BTreeMap<u32, u32> = used.into_iter().zip(0..).collect();
    let cells = cells
        .iter()
        .map(|cell| cell.map(|node| new[&node]))
        .collect();
    (new.len() as u32, cells)
}

/// Renumbers nodes, reorders cells and turns each cell to another of its twelve even orders.
fn scramble(nodes: u32, cells: &mut [Cell], seed: u64) {
    let mut random = Random::new(seed);
    let mut random = move |count: usize| random.below(count);
    let mut numbers: Vec<u32> = (0..nodes).collect();
    for k in (1..numbers.len()).rev() {
        numbers.swap(k, random(k + 1));
    }
    for k in (1..cells.len()).rev() {
        cells.swap(k, random(k + 1));
    }
    for cell in cells {
        *cell = cell.map(|node| numbers[node as usize]);
        for _ in 0..2 {
            // Two swaps are an even permutation.
            let (a, b) = (random(4), 1 + random(3));
            cell.swap(a, (a + b) % 4);
        }
    }
}

/// Every query against its definition, for the vertices and edges that `sampled` picks.
fn queries_hold(mesh: &HalfFaces, sampled: impl Fn(usize) -> bool) {
    let cells = mesh.cells();
    let set = |faces: &mut dyn Iterator<Item = HalfFace>| faces.collect::<BTreeSet<_>>();
    let mut on_face: BTreeMap<[u32; 3], Vec<HalfFace>> = BTreeMap::new();
    for face in mesh.half_faces() {
        let (nodes, apex) = triangles(cells[face.cell() as usize])[face.corner()];
        assert_eq!(triangle(mesh.vertices(face)), nodes);
        assert_eq!(mesh.apex(face), apex);
        on_face.entry(nodes).or_default().push(face);
    }
    for faces in on_face.values() {
        match faces[..] {
            [only] => assert_eq!(mesh.opposite(only), None),
            [a, b] => {
                assert_eq!((mesh.opposite(a), mesh.opposite(b)), (Some(b), Some(a)));
                assert_eq!(mesh.adjacent_cells(a.cell())[a.corner()], Some(b.cell()));
            }
            _ => panic!("{faces:?} on one face"),
        }
    }
    let firsts: BTreeSet<HalfFace> = on_face.values().map(|faces| faces[0]).collect();
    assert!(firsts.iter().eq(mesh.faces()));

    let outside: BTreeSet<HalfFace> = on_face
        .values()
        .filter(|f| f.len() == 1)
        .map(|f| f[0])
        .collect();
    assert!(outside.iter().eq(mesh.boundary().half_faces()));
    let outside_nodes: BTreeSet<u32> = outside.iter().flat_map(|f| mesh.vertices(*f)).collect();
    assert!(outside_nodes.iter().eq(mesh.boundary().vertices()));

    for vertex in (0..mesh.nodes() as u32).filter(|v| sampled(*v as usize)) {
        let star: BTreeSet<HalfFace> = mesh
            .half_faces()
            .filter(|f| cells[f.cell() as usize].contains(&vertex))
            .collect();
        let has = |f: &&HalfFace| mesh.vertices(**f).contains(&vertex);
        let open: BTreeSet<HalfFace> = star.iter().filter(has).copied().collect();
        assert_eq!(set(&mut mesh.star_of_vertex(vertex)), star);
        assert_eq!(set(&mut mesh.open_star_of_vertex(vertex)), open);
        let link = mesh.link_of_vertex(vertex);
        assert!(star.difference(&open).eq(link));
        assert!(
            mesh.cells_of_vertex(vertex)
                .eq(link.iter().map(|f| f.cell()))
        );
        let incident = mesh
            .half_face_of_vertex(vertex)
            .expect("every vertex has cells");
        assert!(open.contains(&incident));
        assert_eq!(outside.contains(&incident), outside_nodes.contains(&vertex));
        assert_eq!(
            mesh.is_boundary_vertex(vertex),
            outside_nodes.contains(&vertex)
        );
    }

    let mut pairs = BTreeSet::new();
    for cell in cells {
        for (a, b) in [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)] {
            pairs.insert([cell[a].min(cell[b]), cell[a].max(cell[b])]);
        }
    }
    let sorted = |edge| {
        let [from, to] = mesh.edge_vertices(edge);
        [from.min(to), from.max(to)]
    };
    assert!(mesh.edges().map(sorted).eq(pairs.iter().copied()));
    for (_, pair) in pairs.iter().enumerate().filter(|(k, _)| sampled(*k)) {
        let edge = mesh.edge(pair[1], pair[0]).expect("an edge of the mesh");
        let star: BTreeSet<HalfFace> = mesh
            .half_faces()
            .filter(|f| {
                pair.iter()
                    .all(|end| cells[f.cell() as usize].contains(end))
            })
            .collect();
        let has = |f: &&HalfFace| pair.iter().all(|end| mesh.vertices(**f).contains(end));
        let open: BTreeSet<HalfFace> = star.iter().filter(has).copied().collect();
        let around = BTreeSet::from_iter(star.iter().map(|f| f.cell()));
        assert_eq!(
            outside.contains(&edge.face()),
            open.iter().any(|f| outside.contains(f))
        );
        // From every half-edge of the edge, wherever in the fan it is.
        for first in mesh.around_edge(edge) {
            assert_eq!(sorted(first), *pair);
            assert_eq!(mesh.around_edge(first).count(), 2 * around.len());
            assert_eq!(set(&mut mesh.open_star_of_edge(first)), open);
            assert_eq!(mesh.cells_of_edge(first).collect::<BTreeSet<_>>(), around);
            assert_eq!(set(&mut mesh.star_of_edge(first)), star);
            let link = set(&mut mesh.link_of_edge(first));
            assert!(star.difference(&open).eq(&link));
            if let Some(radial) = mesh.radial(first) {
                assert_eq!(mesh.opposite(first.face()), Some(radial.face()));
                let [from, to] = mesh.edge_vertices(first);
                assert_eq!(mesh.edge_vertices(radial), [to, from]);
                assert_eq!(mesh.radial(radial), Some(first));
            } else {
                assert!(outside.contains(&first.face()));
            }
        }
    }
    boundary_holds(mesh);
}

/// Closed, and turned the same way: each side's other side runs back; rings go once around.
fn boundary_holds(mesh: &HalfFaces) {
    let boundary = mesh.boundary();
    let mut sides = 0;
    for edge in boundary.edges() {
        let back = boundary.opposite(edge);
        let [from, to] = boundary.side_vertices(edge);
        assert_eq!(boundary.side_vertices(back), [to, from]);
        assert_eq!(boundary.opposite(back), edge);
        sides += 2;
    }
    assert_eq!(sides, 3 * boundary.triangles().len());
    for (place, face) in boundary.half_faces().iter().enumerate() {
        assert_eq!(boundary.triangle_of(*face), Some(place));
        assert_eq!(boundary.triangles()[place], mesh.vertices(*face));
    }
    for &vertex in boundary.vertices() {
        let ring: BTreeSet<usize> = boundary
            .leaving(vertex)
            .inspect(|side| assert_eq!(boundary.side_vertices(*side)[0], vertex))
            .map(|side| side.triangle())
            .collect();
        let around = |(_, t): &(usize, &[u32; 3])| t.contains(&vertex);
        let by_hand = boundary.triangles().iter().enumerate().filter(around);
        assert!(by_hand.map(|(place, _)| place).eq(ring));
        assert_eq!(
            boundary.leaving(vertex).count(),
            boundary.leaving(vertex).collect::<BTreeSet<_>>().len()
        );
    }
}

fn structured(divisions: [usize; 3]) -> TetMesh {
    slab([0.3, 0.2, 0.1], divisions).expect("a slab")
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(64) })]

    /// Holes anywhere, any numbering: refused exactly when the definition says so.
    #[test]
    fn what_is_refused_is_what_is_no_manifold(
        gone in prop::collection::btree_set(0usize..48, 0..24),
        seed: u64,
    ) {
        let kept: Vec<Cell> = structured([2, 2, 2]).cells().iter().enumerate()
            .filter(|(k, _)| !gone.contains(k)).map(|(_, cell)| *cell).collect();
        let (nodes, mut cells) = compact(&kept);
        scramble(nodes, &mut cells, seed);
        let made = HalfFaces::new(nodes as usize, cells.clone());
        prop_assert_eq!(made.is_ok(), is_manifold(nodes, &cells), "{:?}", made.err());
    }

    /// Random bodies: a slab with cells taken away as long as it stays a manifold.
    #[test]
    fn queries_are_their_definitions_on_random_meshes(
        gone in prop::collection::vec(any::<prop::sample::Index>(), 0..30),
        seed: u64,
    ) {
        let mut kept = structured([3, 2, 2]).cells().to_vec();
        for index in gone {
            let cell = kept.remove(index.index(kept.len()));
            let (nodes, cells) = compact(&kept);
            if !is_manifold(nodes, &cells) {
                kept.push(cell);
            }
        }
        let (nodes, mut cells) = compact(&kept);
        scramble(nodes, &mut cells, seed);
        let mesh = HalfFaces::new(nodes as usize, cells);
        prop_assert!(mesh.is_ok(), "{:?}", mesh.err());
        if let Ok(mesh) = mesh {
            queries_hold(&mesh, |_| true);
        }
    }

    /// Any cells at all on a few vertices: an answer or a refusal, never a panic.
    #[test]
    fn arbitrary_cells_are_taken_or_refused(
        cells in prop::collection::vec(prop::array::uniform4(0u32..8), 0..12),
    ) {
        if let Ok(mesh) = HalfFaces::new(8, cells.clone()) {
            let (nodes, cells) = compact(&cells);
            prop_assert!(is_manifold(nodes, &cells));
            // Vertices that no cell has are none of this structure's business.
            for vertex in 0..8 {
                prop_assert_eq!(
                    mesh.half_face_of_vertex(vertex).is_none(),
                    mesh.link_of_vertex(vertex).is_empty()
                );
            }
        }
    }
}

/// Cells of very different sizes: the fourth power of the place of a node.
#[test]
fn queries_are_their_definitions_on_a_graded_mesh() {
    let even = structured([4, 3, 3]);
    let graded = |p: &[f64; 3]| p.map(|x| (x + 0.2).powi(4));
    let points = even.points_m().iter().map(graded).collect();
    let mesh = TetMesh::new(points, even.cells().to_vec()).expect("a sound mesh");
    queries_hold(mesh.half_faces(), |_| true);
}

#[test]
fn queries_are_their_definitions_on_generated_meshes() {
    for name in ["cube_1650", "cylinder_1650", "tubes_younes"] {
        let path = format!("{}/../tests/data/{name}.msh", env!("CARGO_MANIFEST_DIR"));
        let text = std::fs::read_to_string(path).expect("the mesh is there");
        let mesh = read_msh(&text, 1.0).expect("a sound mesh");
        queries_hold(mesh.half_faces(), |k| k % 37 == 0);
        let (faces, cells) = (mesh.half_faces().faces().len(), mesh.cells().len());
        let (edges, nodes) = (mesh.half_faces().edges().len(), mesh.points_m().len());
        let triangles = mesh.surface().triangles.len();
        assert_eq!(2 * faces, 4 * cells + triangles, "{name}");
        // Half the boundary's Euler characteristic: 1 for a ball, 0 for each tube.
        let euler = nodes + faces - edges - cells;
        assert_eq!(euler, usize::from(name != "tubes_younes"), "{name}");
    }
}

#[test]
fn cells_that_meet_in_less_than_a_face_are_named() {
    let edge = HalfFaces::new(6, vec![[0, 1, 2, 3], [1, 0, 4, 5]]).expect_err("a shared edge");
    let MeshError::SplitEdge {
        from,
        to,
        first,
        second,
    } = edge
    else {
        panic!("{edge}")
    };
    assert_eq!(
        (from.index, to.index, first.index, second.index),
        (0, 1, 0, 1)
    );
    let node = HalfFaces::new(7, vec![[0, 1, 2, 3], [0, 4, 5, 6]]).expect_err("a shared node");
    let MeshError::PinchedNode {
        node,
        first,
        second,
    } = node
    else {
        panic!("{node}")
    };
    assert_eq!((node.index, first.index, second.index), (0, 0, 1));
    let twice = HalfFaces::new(4, vec![[0, 1, 2, 3], [1, 0, 2, 3]]).expect_err("one inside out");
    assert!(matches!(twice, MeshError::Duplicate { .. }), "{twice}");
    let side = HalfFaces::new(5, vec![[0, 1, 2, 3], [4, 1, 2, 3]]).expect_err("one side");
    assert!(matches!(side, MeshError::SameSide { .. }), "{side}");
}

#[test]
fn what_does_not_exist_has_nothing_around_it() {
    let mesh = structured([1, 1, 1]);
    let small = HalfFaces::new(4, vec![[0, 1, 2, 3]]).expect("one cell");
    let foreign = mesh.half_faces().half_face(5, 2).expect("cell 5");
    assert_eq!(small.opposite(foreign), None);
    assert_eq!(small.half_face(1, 0), None);
    assert_eq!(small.half_face(0, 4), None);
    assert!(small.link_of_vertex(u32::MAX).is_empty());
    assert_eq!(small.edge(0, 7), None);
    assert_eq!(small.boundary().leaving(9).count(), 0);
    assert_eq!(small.around_edge(foreign.half_edges()[0]).count(), 2);
}

#[test]
fn a_file_gives_the_same_structure_or_a_refusal() {
    let mesh = structured([2, 1, 1]);
    let text = serde_json::to_string(mesh.half_faces()).expect("plain numbers");
    let back: HalfFaces = serde_json::from_str(&text).expect("the same mesh");
    assert_eq!(&back, mesh.half_faces());
    assert!(back.half_faces().eq(mesh.half_faces().half_faces()));
    for face in back.half_faces() {
        assert_eq!(back.opposite(face), mesh.half_faces().opposite(face));
    }
    let bad = r#"{"nodes":7,"cells":[[0,1,2,3],[0,4,5,6]]}"#;
    let error = serde_json::from_str::<HalfFaces>(bad).expect_err("pinched");
    assert!(
        error.to_string().contains("touches itself at node 0"),
        "{error}"
    );
}
