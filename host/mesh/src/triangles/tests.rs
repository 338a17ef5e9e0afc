//! Surfaces: one box in every format, what is put right of it, and what is refused with its face.

use super::*;
use std::fmt::Write;

/// Sides of a box by its corners, corner k at (k & 1, k >> 1 & 1, k >> 2), counter-clockwise seen from outside.
const SIDES: [[u32; 4]; 6] = [
    [0, 2, 3, 1],
    [4, 5, 7, 6],
    [0, 1, 5, 4],
    [2, 6, 7, 3],
    [0, 4, 6, 2],
    [1, 3, 7, 5],
];

fn corner(k: u32) -> [f64; 3] {
    [0, 1, 2].map(|axis| f64::from((k >> axis) & 1))
}

/// A box of this size from `low` on.
fn cuboid(low: f64, size: f64) -> TriangleMesh {
    let points_m = (0..8).map(|k| corner(k).map(|x| low + size * x)).collect();
    let halves = SIDES
        .iter()
        .flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]);
    TriangleMesh::new(points_m, halves.collect())
}

/// Both beside each other, not joined.
fn both(mut one: TriangleMesh, other: &TriangleMesh) -> TriangleMesh {
    let first = one.points_m.len() as u32;
    one.points_m.extend(&other.points_m);
    let more = other
        .triangles
        .iter()
        .map(|own| own.map(|point| point + first));
    one.triangles.extend(more);
    one
}

/// The unit box by its triangles, under the first line `solid`.
fn ascii(first: &str) -> String {
    let mut text = format!("{first}\n");
    let unit = cuboid(0.0, 1.0);
    for triangle in &unit.triangles {
        text.push_str("  facet normal 0 0 0\n    outer loop\n");
        for point in triangle {
            let [x, y, z] = unit.points_m[*point as usize];
            let _ = writeln!(text, "      vertex {x:e} {y} {z:.3}");
        }
        text.push_str("    endloop\n  endfacet\n");
    }
    text + "endsolid\n"
}

fn binary(title: &[u8]) -> Vec<u8> {
    let unit = cuboid(0.0, 1.0);
    let mut bytes = title.to_vec();
    bytes.resize(80, b' ');
    bytes.extend((unit.triangles.len() as u32).to_le_bytes());
    for triangle in &unit.triangles {
        bytes.extend([1.5f32, 2.5, 3.5].iter().flat_map(|x| x.to_le_bytes()));
        let numbers = triangle
            .iter()
            .flat_map(|point| unit.points_m[*point as usize]);
        bytes.extend(numbers.flat_map(|x| (x as f32).to_le_bytes()));
        bytes.extend([7; 2]);
    }
    bytes
}

/// What is inside, of a surface that is closed \[m^3\].
fn volume(surface: &TriangleMesh) -> f64 {
    surface.check().expect("closed");
    surface.volume_m3()
}

#[test]
fn an_stl_is_told_by_its_bytes_and_not_by_its_first_word() {
    let read = |bytes: &[u8]| SurfaceFormat::Stl.read(bytes, 2.0);
    let whole = read(ascii("solid box").as_bytes()).expect("ASCII");
    assert_eq!((whole.points_m.len(), volume(&whole)), (8, 8.0));
    for first in ["solid", "solid ", "SOLID x", "\n  solid\tx", "solid binary"] {
        let same = read(ascii(first).as_bytes());
        assert_eq!(same, Ok(whole.clone()), "{first:?}");
    }
    let shouted = ascii("solid").to_uppercase().replace('\n', "\r\n");
    assert_eq!(read(shouted.as_bytes()), Ok(whole.clone()));
    for title in ["solid", "solid facet normal", "made by hand", ""] {
        assert_eq!(
            read(&binary(title.as_bytes())),
            Ok(whole.clone()),
            "{title}"
        );
    }
    // Filled up with zeros a text stays a text.
    let padded = [ascii("solid box").into_bytes(), vec![0; 512]].concat();
    assert_eq!(read(&padded), Ok(whole.clone()));
    // Two solids in a file: two boxes on each other.
    let twice = ascii("solid one") + &ascii("solid");
    assert_eq!(
        read(twice.as_bytes()).map(|two| two.triangles.len()),
        Ok(24)
    );
}

#[test]
fn what_is_no_stl_is_told_with_its_line_or_byte() {
    let told = |bytes: &[u8]| {
        SurfaceFormat::Stl
            .read(bytes, 1.0)
            .expect_err("bad")
            .to_string()
    };
    let text = ascii("solid");
    let word = told(text.replace("vertex 1e0", "vertex one").as_bytes());
    assert!(
        word.contains("three coordinates, found `one`") && word.starts_with("line "),
        "{word}"
    );
    let cut = told(&text.as_bytes()[..text.len() / 2]);
    assert!(cut.contains("is it cut off?"), "{cut}");
    let whole = binary(b"solid");
    for (bytes, found) in [
        (whole[..whole.len() - 1].to_vec(), 683),
        ([whole.clone(), vec![b'x'; 9]].concat(), 693),
        (binary(b"made by hand")[..84].to_vec(), 84),
    ] {
        let size = told(&bytes);
        let said = format!("12 triangles, which take 684 bytes, and has {found} bytes");
        assert!(size.contains(&said), "{size}");
    }
    let mut none = whole.clone();
    none[80..84].fill(0);
    assert!(told(&none).contains("0 triangles, which take 84 bytes, and has 684"));
    let short = told(b"no surface");
    assert!(
        short.contains("expected an STL file") && short.contains("`no surface`"),
        "{short}"
    );
    let scale = SurfaceFormat::Stl.read(&whole, 0.0).expect_err("zero");
    assert_eq!(scale, MeshError::Scale(0.0));
}

/// Quads, corners by number with those of textures and normals, and from the last one back.
#[test]
fn an_obj_has_polygons() {
    let mut text = String::from("# a box\nmtllib box.mtl\no box\n");
    for k in 0..8 {
        let [x, y, z] = corner(k);
        let _ = writeln!(text, "v {x} {y} {z} 1.0\nvn 0 0 1\nvt 0 0");
    }
    for [a, b, c, d] in SIDES {
        let _ = match a {
            0 => writeln!(
                text,
                "f {}/1/1 {}//2 \\\n  {}/3 {}",
                a + 1,
                b + 1,
                c + 1,
                d + 1
            ),
            _ => writeln!(text, "f -{} -{} -{} -{}", 8 - a, 8 - b, 8 - c, 8 - d),
        };
    }
    let surface = SurfaceFormat::Obj
        .read(text.as_bytes(), 1.0)
        .expect("a box");
    assert_eq!(surface.triangles, cuboid(0.0, 1.0).triangles);
    assert_eq!((volume(&surface), surface.face(11)), (1.0, 5));
    let told = |line: &str| {
        let error = SurfaceFormat::Obj.read(format!("{text}{line}\n").as_bytes(), 1.0);
        error.expect_err("bad").to_string()
    };
    for line in ["f 1 2 9", "f 0 1 2", "f 1 2 -9", "f 1 2 x"] {
        let error = told(line);
        assert!(
            error.starts_with("line 37") && error.contains("8 vertices so far"),
            "{error}"
        );
    }
    assert!(told("f 1 2").contains("a face of 3 to 1000 corners, found `2`"));
    assert!(told("v 1 2").contains("three coordinates"));
    assert!(told("\u{1}").contains("a keyword such as v or f"));
}

/// A box with colours, a list beside that of the corners, and edges, in each coding.
fn ply(coding: &str) -> Vec<u8> {
    let head = format!(
        "ply\r\nformat {coding} 1.0\ncomment made by hand\nelement vertex 8\nproperty uchar red\nproperty double x\n\
         property float y\nproperty float z\nelement face 6\nproperty list uchar float texcoord\n\
         property list uchar int vertex_indices\nelement edge 1\nproperty int vertex1\nend_header\n"
    );
    let mut bytes = head.replace('\r', "").into_bytes();
    let put = |bytes: &mut Vec<u8>, value: f64, size: usize, real: bool| {
        let little = match (real, size) {
            (true, 8) => value.to_le_bytes().to_vec(),
            (true, _) => (value as f32).to_le_bytes().to_vec(),
            (false, size) => (value as i64).to_le_bytes()[..size].to_vec(),
        };
        match coding {
            "ascii" => bytes.extend(format!("{value} ").bytes()),
            "binary_little_endian" => bytes.extend(little),
            _ => bytes.extend(little.iter().rev()),
        }
    };
    for k in 0..8 {
        let [x, y, z] = corner(k);
        put(&mut bytes, 200.0, 1, false);
        put(&mut bytes, x, 8, true);
        put(&mut bytes, y, 4, true);
        put(&mut bytes, z, 4, true);
    }
    for side in SIDES {
        put(&mut bytes, 1.0, 1, false);
        put(&mut bytes, 0.5, 4, true);
        put(&mut bytes, 4.0, 1, false);
        for point in side {
            put(&mut bytes, f64::from(point), 4, false);
        }
    }
    put(&mut bytes, 3.0, 4, false);
    bytes
}

#[test]
fn a_ply_is_read_as_text_and_in_both_orders_of_bytes() {
    for coding in ["ascii", "binary_little_endian", "binary_big_endian"] {
        let bytes = ply(coding);
        let surface = SurfaceFormat::Ply.read(&bytes, 1.0).expect(coding);
        assert_eq!(surface.triangles, cuboid(0.0, 1.0).triangles, "{coding}");
        assert_eq!((volume(&surface), surface.face(11)), (1.0, 5), "{coding}");
        // Ends anywhere but behind the last number's first digit.
        for end in 0..bytes.len() - 2 {
            assert!(
                SurfaceFormat::Ply.read(&bytes[..end], 1.0).is_err(),
                "{coding} {end}"
            );
        }
    }
    let text = String::from_utf8(ply("ascii")).expect("text");
    let told = |from: &str, to: &str| {
        let text = text.replace(from, to);
        SurfaceFormat::Ply
            .read(text.as_bytes(), 1.0)
            .expect_err(to)
            .to_string()
    };
    assert!(told("vertex_indices", "corners").contains("list vertex_indices"));
    assert!(told("double x", "double u").contains("properties x, y and z"));
    assert!(told("ascii", "utf8").contains("binary_big_endian"));
    assert!(told("4 0 2 3 1", "4 0 2 3 8").contains("one of the 8 vertices, from 0"));
    assert!(told("element face 6", "element face 99999999999").contains("is it cut off?"));
    assert!(told("element face", "element strip").contains("no element face"));
    assert!(told("format", "property int x\nformat").contains("an element first"));
}

/// An arrow's head, whose fan from the wrong corner would be larger than it is; and a square with a corner on a side.
#[test]
fn polygons_are_split_into_their_own_area() {
    let area = |points_m: &[[f64; 3]]| -> f64 {
        let corners: Vec<u32> = (0..points_m.len() as u32).collect();
        let triangles = polygon::split(points_m, &corners);
        assert_eq!(triangles.len(), corners.len() - 2);
        let at = |point: u32| Vector3::from(points_m[point as usize]);
        let areas = triangles
            .iter()
            .map(|&[a, b, c]| (at(b) - at(a)).cross(&(at(c) - at(a))).norm());
        0.5 * areas.sum::<f64>()
    };
    let mut arrow = [
        [0.0, 0.0, 5.0],
        [2.0, -2.0, 5.0],
        [1.0, 0.0, 5.0],
        [2.0, 2.0, 5.0],
    ];
    for _ in 0..4 {
        assert!((area(&arrow) - 2.0).abs() < 1e-12, "{arrow:?}");
        arrow.rotate_left(1);
    }
    let mut square = [
        [0.0, 0.0, 0.0],
        [0.0, 1.0, 0.0],
        [0.0, 2.0, 0.0],
        [0.0, 2.0, 2.0],
        [0.0, 0.0, 2.0],
    ];
    for _ in 0..5 {
        assert!((area(&square) - 4.0).abs() < 1e-12, "{square:?}");
        square.rotate_left(1);
    }
}

/// Turned at random, with every triangle's points its own, some triangles twice and some without a third corner: the same box.
#[test]
fn what_can_be_put_right_in_one_way_is() {
    let plain = cuboid(1.0, 2.0);
    let mut points_m = Vec::new();
    let mut triangles = Vec::new();
    for (number, triangle) in plain.triangles.iter().enumerate() {
        let first = points_m.len() as u32;
        // Each a little beside the others.
        let off = 1e-7 * (number % 3) as f64;
        points_m.extend(triangle.map(|point| plain.points_m[point as usize].map(|x| x + off)));
        triangles.push([first, first + 1, first + 2]);
        if number % 2 == 0 {
            triangles[number].swap(0, 1);
        }
    }
    triangles.push([0, 1, 1]);
    triangles.push([5, 3, 4]);
    points_m.push([1e3; 3]);
    let mut surface = TriangleMesh::new(points_m, triangles);
    let repaired = surface.repair().expect("a box");
    let expected = Repaired {
        welded_points: 36 - 8,
        dropped_triangles: 2,
        turned_triangles: 6,
        parts: 1,
        ..Repaired::default()
    };
    assert_eq!(repaired, expected);
    assert_eq!((surface.points_m.len(), surface.triangles.len()), (8, 12));
    assert!((volume(&surface) - 8.0).abs() < 1e-5);
    // Sound already: nothing is done, and but for the order of its points nothing is changed.
    let nothing = Repaired {
        parts: 1,
        ..Repaired::default()
    };
    assert_eq!(surface.repair(), Ok(nothing));
    let mut again = surface.clone();
    assert_eq!((again.repair(), again), (Ok(nothing), surface));
    let mut inside_out = plain.clone();
    inside_out
        .triangles
        .iter_mut()
        .for_each(|own| own.reverse());
    assert_eq!(
        inside_out.repair().map(|done| done.turned_triangles),
        Ok(12)
    );
    assert!((volume(&inside_out) - 8.0).abs() < 1e-12);
}

/// The surface of a box of 6 x 6 x 6 cubes.
fn fine() -> TriangleMesh {
    let mesh = crate::slab([1.0; 3], [6; 3]).expect("a slab");
    TriangleMesh::new(mesh.points_m().to_vec(), mesh.surface().triangles.clone())
}

/// One triangle at an edge of a box has its points, the other not (T-vertices): it is split there.
#[test]
fn points_on_the_edges_of_others_become_corners() {
    let mut surface = cuboid(1.0, 2.0);
    assert_eq!(surface.triangles[0], [0, 2, 3]);
    // From corner 0 to corner 2, a little beside the edge.
    let along = [0.1, 0.4, 0.9].map(|part| [1.0 + 1e-7, 1.0 + 2.0 * part, 1.0]);
    surface.points_m.extend(along);
    surface.triangles[0] = [0, 8, 3];
    surface
        .triangles
        .extend([[8, 9, 3], [10, 9, 3], [10, 2, 3]]);
    let repaired = surface.repair().expect("a box");
    let expected = Repaired {
        split_edges: 3,
        turned_triangles: 1,
        parts: 1,
        ..Repaired::default()
    };
    assert_eq!(repaired, expected);
    assert_eq!(surface.triangles.len(), 12 + 3 + 3);
    assert!((volume(&surface) - 8.0).abs() < 1e-6);
    // Those that are new are of the face that was split, that from corner 0 to 6 and 2.
    assert_eq!([15, 16, 17].map(|triangle| surface.face(triangle)), [9; 3]);
}

/// Holes of few edges are filled however they are bent, flat ones however many edges they have: the box is whole again.
#[test]
fn small_and_flat_holes_are_filled() {
    let whole = cuboid(0.0, 2.0);
    // A triangle; a side; and all around a corner, which is cut off by that.
    for (kept, expected_m3) in [
        ((|k, _| k != 3) as fn(usize, &[u32; 3]) -> bool, 8.0),
        (|k, _| k > 1, 8.0),
        (|_, triangle| !triangle.contains(&7), f64::NAN),
    ] {
        let mut surface = whole.clone();
        let mut numbers = 0..;
        surface
            .triangles
            .retain(|triangle| numbers.next().is_some_and(|k| kept(k, triangle)));
        let repaired = surface.repair().expect("a box");
        assert_eq!((repaired.filled_holes, repaired.parts), (1, 1));
        let volume_m3 = volume(&surface);
        let is_expected = (volume_m3 - expected_m3).abs() < 1e-12;
        assert!(
            is_expected || expected_m3.is_nan() && (1.0..8.0).contains(&volume_m3),
            "{volume_m3}"
        );
    }
    // The top of a box of cubes: a ring of 24 edges, most of them in one line.
    let mut surface = fine();
    let points_m = surface.points_m.clone();
    let top = points_m.iter().map(|at| at[2]).fold(f64::MIN, f64::max);
    surface.triangles.retain(|triangle| {
        triangle
            .iter()
            .any(|point| points_m[*point as usize][2] < top)
    });
    let repaired = surface.repair().expect("a box");
    assert_eq!(repaired.filled_holes, 1);
    assert!((volume(&surface) - 1.0).abs() < 1e-12);
    // A hole bent over an edge of the box, one cube and two wide on its top: of 12 edges it is filled, of 14 it is not.
    for (wide, filled) in [(1.0, true), (2.0, false)] {
        let mut surface = fine();
        let points_m = surface.points_m.clone();
        surface.triangles.retain(|triangle| {
            let middle = |axis: usize| {
                let corners = triangle.map(|point| points_m[point as usize][axis]);
                6.0 * corners.iter().sum::<f64>() / 3.0
            };
            let [x, y, z] = [0, 1, 2].map(middle);
            let on_top = z > -1e-9 && x > 3.0 - wide;
            let beside = x > 3.0 - 1e-9 && z > -1.0;
            !((on_top || beside) && y.abs() < 2.0)
        });
        let repaired = surface.repair();
        match filled {
            true => assert_eq!(repaired.map(|done| done.filled_holes), Ok(1)),
            false => assert!(
                matches!(repaired, Err(SurfaceFlaw::Open { edges: 14, .. })),
                "{repaired:?}"
            ),
        }
    }
    // Two holes of a box of cubes that are apart are two.
    let mut surface = fine();
    surface.triangles.swap_remove(100);
    surface.triangles.swap_remove(7);
    assert_eq!(surface.repair().map(|done| done.filled_holes), Ok(2));
    assert!((volume(&surface) - 1.0).abs() < 1e-12);
}

/// A box in a box is a hollow, whichever way it looked; one in that is solid again; one beside them is a part of its own.
#[test]
fn parts_inside_others_are_hollows() {
    let mut nested = both(cuboid(0.0, 10.0), &cuboid(1.0, 8.0));
    nested = both(nested, &cuboid(2.0, 6.0));
    nested = both(nested, &cuboid(20.0, 1.0));
    for turned in 0..16 {
        let mut surface = nested.clone();
        for (number, triangle) in surface.triangles.iter_mut().enumerate() {
            if turned >> (number / 12) & 1 == 1 {
                triangle.swap(0, 2);
            }
        }
        let repaired = surface.repair().expect("boxes");
        assert_eq!((repaired.parts, repaired.hollows), (4, 1), "{turned}");
        let expected = 1000.0 - 512.0 + 216.0 + 1.0;
        assert!((volume(&surface) - expected).abs() < 1e-9, "{turned}");
        let bodies = surface.bodies().expect("boxes");
        let volumes: Vec<_> = bodies.iter().map(volume).collect();
        let expected = [1000.0 - 512.0, 216.0, 1.0];
        let is_near = |(own, expected): (&f64, f64)| (own - expected).abs() < 1e-9;
        assert_eq!(volumes.len(), expected.len(), "{turned}");
        assert!(volumes.iter().zip(expected).all(is_near), "{volumes:?}");
    }
}

/// Boxes that cut each other are two bodies, whichever has a corner in the other.
#[test]
fn parts_that_cut_each_other_are_no_hollows() {
    for (one, other) in [(5.0, 15.0), (5.0, 8.0), (-5.0, 8.0), (-1.0, 10.0)] {
        let mut surface = both(cuboid(0.0, 10.0), &cuboid(one, other));
        let repaired = surface.repair().expect("boxes");
        assert_eq!((repaired.parts, repaired.hollows), (2, 0), "{one} {other}");
        let bodies = surface.bodies().expect("boxes");
        let volumes: Vec<_> = bodies.iter().map(volume).collect();
        assert_eq!(volumes.len(), 2, "{one} {other}");
        assert!((volumes[0] - 1000.0).abs() < 1e-9, "{volumes:?}");
        assert!((volumes[1] - other.powi(3)).abs() < 1e-9, "{volumes:?}");
    }
}

#[test]
fn what_others_have_to_mend_is_told_with_its_faces() {
    let refused = |change: &dyn Fn(&mut TriangleMesh)| {
        let mut surface = cuboid(0.0, 2.0);
        change(&mut surface);
        surface.repair().expect_err("no solid")
    };
    // Two holes that meet in a point: which of its edges go on in which hole nothing says.
    let open = refused(&|surface| {
        surface.triangles.remove(10);
        surface.triangles.remove(0);
    });
    assert!(
        matches!(
            open,
            SurfaceFlaw::Open {
                face: 0,
                edges: 6,
                ..
            }
        ),
        "{open}"
    );
    // One side alone: what fills its rim holds nothing. And so beside a box.
    let sheet = |surface: &mut TriangleMesh| surface.triangles.truncate(2);
    let open = refused(&sheet);
    assert!(
        matches!(
            open,
            SurfaceFlaw::Open {
                face: 0,
                edges: 4,
                ..
            }
        ),
        "{open}"
    );
    let mut one = cuboid(5.0, 2.0);
    sheet(&mut one);
    let open = both(cuboid(0.0, 2.0), &one).repair().expect_err("a sheet");
    assert!(
        matches!(
            open,
            SurfaceFlaw::Open {
                face: 12,
                edges: 4,
                ..
            }
        ),
        "{open}"
    );
    // A corner torn off along steps.
    let mut torn = fine();
    let points_m = torn.points_m.clone();
    torn.triangles.retain(|triangle| {
        let at = |axis: usize| {
            triangle
                .iter()
                .map(|point| points_m[*point as usize][axis])
                .sum::<f64>()
                / 3.0
        };
        at(0) + at(1) + at(2) < -0.5
    });
    let open = torn.repair().expect_err("a large hole");
    assert!(
        matches!(open, SurfaceFlaw::Open { edges: 13.., .. }),
        "{open}"
    );
    // A third triangle at the edge of the first and the second.
    let crowded = refused(&|surface| {
        surface.points_m.push([3.0; 3]);
        surface.triangles.push([0, 3, 8]);
    });
    let SurfaceFlaw::Crowded { faces, .. } = crowded else {
        panic!("{crowded}");
    };
    assert_eq!(faces, [0, 1, 12]);
    let nowhere = refused(&|surface| surface.points_m[7][2] = f64::INFINITY);
    assert_eq!(nowhere, SurfaceFlaw::NotFinite { face: 2 });
    let flat = refused(&|surface| surface.points_m[1] = [1.0, 1.0, 0.0]);
    assert!(
        matches!(flat, SurfaceFlaw::NoArea { face: 1, .. }),
        "{flat}"
    );
    assert_eq!(
        refused(&|surface| surface.triangles.clear()),
        SurfaceFlaw::Empty
    );
    // A torus whose one ring of squares is joined the wrong way round: Klein's bottle.
    let (rings, sides) = (5u32, 6u32);
    let klein = |i: u32, j: u32| {
        let j = if i < rings {
            j % sides
        } else {
            (2 * sides - j) % sides
        };
        (i % rings) * sides + j
    };
    let mut bottle = TriangleMesh::default();
    for i in 0..rings {
        for j in 0..sides {
            bottle
                .points_m
                .push([f64::from(i), f64::from(j * j), f64::from(i * j)]);
            let [a, b, c, d] = [
                klein(i, j),
                klein(i + 1, j),
                klein(i + 1, j + 1),
                klein(i, j + 1),
            ];
            bottle.triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    let one_sided = bottle.repair().expect_err("no outside");
    assert!(
        matches!(one_sided, SurfaceFlaw::OneSided { .. }),
        "{one_sided}"
    );
    // Faces are counted as the file has them, two triangles each.
    let text = String::from_utf8(ply("ascii")).expect("text");
    let text = text
        .replace("element face 6", "element face 7")
        .replace("4 1 3 7 5 ", "4 1 3 7 5 1 0.5 3 0 3 5 ");
    let read = SurfaceFormat::Ply.read(text.as_bytes(), 1.0);
    let crowded = read.expect("a box").repair().expect_err("a wall");
    let SurfaceFlaw::Crowded { faces, .. } = crowded else {
        panic!("{crowded}");
    };
    assert_eq!(faces, [0, 0, 6]);
}

/// Bytes changed at random end in an error or a surface, for each format.
#[test]
fn garbage_breaks_nothing() {
    let text = |text: &str| text.as_bytes().to_vec();
    let obj = text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n");
    let mut seed = 0x2545_f491_4f6c_dd1du64;
    let mut draw = |below: usize| {
        seed ^= seed << 13;
        seed ^= seed >> 7;
        seed ^= seed << 17;
        (seed % below as u64) as usize
    };
    let mut refused = 0;
    for (format, whole) in [
        (SurfaceFormat::Stl, text(&ascii("solid"))),
        (SurfaceFormat::Stl, binary(b"solid")),
        (SurfaceFormat::Obj, obj),
        (SurfaceFormat::Ply, ply("ascii")),
        (SurfaceFormat::Ply, ply("binary_little_endian")),
        (SurfaceFormat::Ply, ply("binary_big_endian")),
    ] {
        for _ in 0..500 {
            let mut bytes = whole.clone();
            for _ in 0..1 + draw(6) {
                let at = draw(bytes.len());
                bytes[at] = draw(256) as u8;
            }
            let read = format.read(&bytes, 1.0).map_err(SurfaceFlaw::from);
            refused += u32::from(read.and_then(|mut surface| surface.repair()).is_err());
        }
    }
    assert!(refused > 1000, "{refused}");
}
