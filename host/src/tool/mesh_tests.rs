//! Closed meshes: what is none is told, the deepest place, and STL files good and bad.

use super::closed_mesh::{ClosedMesh, MOST_TRIANGLES};
use crate::mesh::{SurfaceFlaw, SurfaceFormat};
use nalgebra::Vector3;

const BRACKET: &[u8] = include_bytes!("../../../tests/data/bracket.stl");
const RING: &[u8] = include_bytes!("../../../tests/data/ring.stl");

/// Four corners, and the triangles of a tetrahedron from a corner on.
fn tetrahedron() -> (Vec<[f64; 3]>, Vec<[u32; 3]>) {
    let points = vec![
        [0.0, 0.0, 0.0],
        [1.0, 0.0, 0.0],
        [0.0, 1.0, 0.0],
        [0.0, 0.0, 1.0],
    ];
    let triangles = vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];
    (points, triangles)
}

fn read_stl(bytes: &[u8], scale_to_m: f64) -> Result<ClosedMesh, SurfaceFlaw> {
    ClosedMesh::read(SurfaceFormat::Stl, bytes, scale_to_m)
}

fn flaw(change: impl FnOnce(&mut Vec<[f64; 3]>, &mut Vec<[u32; 3]>)) -> SurfaceFlaw {
    let (mut points, mut triangles) = tetrahedron();
    change(&mut points, &mut triangles);
    ClosedMesh::new(&points, &triangles).expect_err("a flaw")
}

#[test]
fn what_is_no_closed_surface_is_told_with_its_place() {
    let (points, triangles) = tetrahedron();
    assert!(ClosedMesh::new(&points, &triangles).is_ok());
    assert_eq!(flaw(|_, triangles| triangles.clear()), SurfaceFlaw::Empty);
    let many =
        |_: &mut Vec<_>, triangles: &mut Vec<_>| triangles.resize(MOST_TRIANGLES + 1, [0; 3]);
    let too_many = SurfaceFlaw::TooMany {
        triangles: MOST_TRIANGLES + 1,
        most: MOST_TRIANGLES,
    };
    assert_eq!(flaw(many), too_many);
    let open = flaw(|_, triangles| {
        triangles.pop();
    });
    assert_eq!(
        open,
        SurfaceFlaw::Open {
            face: 0,
            from_m: [0.0, 1.0, 0.0],
            to_m: [1.0, 0.0, 0.0],
            edges: 3
        }
    );
    let turned = flaw(|_, triangles| triangles[3].reverse());
    assert!(
        matches!(turned, SurfaceFlaw::Turned { other: 3, .. }),
        "{turned}"
    );
    let twice = flaw(|_, triangles| triangles.push([1, 2, 3]));
    assert!(
        matches!(
            twice,
            SurfaceFlaw::Turned {
                one: 3,
                other: 4,
                ..
            }
        ),
        "{twice}"
    );
    let nowhere = flaw(|points, _| points[2][1] = f64::NAN);
    assert_eq!(nowhere, SurfaceFlaw::NotFinite { face: 0 });
    let far = flaw(|points, _| points[3][1] = 1e200);
    assert_eq!(far, SurfaceFlaw::NotFinite { face: 1 });
    let flat = flaw(|points, _| points[3] = [0.5, 0.0, 0.0]);
    assert!(
        matches!(flat, SurfaceFlaw::NoArea { face: 1, .. }),
        "{flat}"
    );
    let missing = flaw(|_, triangles| triangles[2][1] = 4);
    let expected = SurfaceFlaw::NoPoint {
        face: 2,
        corner: 4,
        points: 4,
    };
    assert_eq!(missing, expected);
    let inside_out = flaw(|_, triangles| triangles.iter_mut().for_each(|own| own.reverse()));
    assert!(matches!(inside_out, SurfaceFlaw::InsideOut { .. }));
    // A second one that has but the first's tip, and one that has nothing of it.
    let second = |points: &mut Vec<[f64; 3]>, triangles: &mut Vec<[u32; 3]>, first: u32| {
        let (more, others) = tetrahedron();
        let more = more.iter().map(|at| at.map(|x| x + 1.0));
        points.extend(more);
        let joined = |corner: u32| if corner == 0 { first } else { corner + 4 };
        triangles.extend(others.iter().map(|own| own.map(joined)));
    };
    let pinched = flaw(|points, triangles| {
        second(points, triangles, 3);
        points[3] = [1.0; 3];
    });
    let at_m = [1.0; 3];
    let (one, other) = (1, 4);
    assert_eq!(pinched, SurfaceFlaw::Pinched { one, other, at_m });
    let (mut points, mut triangles) = tetrahedron();
    second(&mut points, &mut triangles, 4);
    assert!(ClosedMesh::new(&points, &triangles).is_ok());
}

/// The centre of the ball in the corner of a cube, and a depth that no place of a ring is beyond.
#[test]
fn the_deepest_place_is_that_of_the_largest_ball() {
    let (points, triangles) = tetrahedron();
    let mesh = ClosedMesh::new(&points, &triangles).expect("closed");
    let (at, deep) = mesh.deepest_m();
    let expected = 1.0 / (3.0 + 3f64.sqrt());
    assert!((deep - expected).abs() < 1e-5, "{deep}, not {expected}");
    assert!((at - Vector3::repeat(expected)).norm() < 1e-4, "{at}");
    let ring = read_stl(RING, 0.001).expect("closed");
    let (at, deep) = ring.deepest_m();
    assert!((0.005..0.006).contains(&deep), "{deep}");
    assert!((at.xy().norm() - 0.016).abs() < 0.001 && at.z.abs() < 0.001);
}

#[test]
fn files_of_both_kinds_arrive() {
    let bracket = read_stl(BRACKET, 0.001).expect("closed");
    assert_eq!(
        (bracket.points_m().len(), bracket.triangles().len()),
        (12, 20)
    );
    assert_eq!(bracket.points_m()[0], Vector3::new(-0.020, -0.008, 0.0));
    let reach_m = 0.02f64.hypot(0.008).hypot(0.036);
    assert!((bracket.reach_m() - reach_m).abs() < 1e-15);
    let ring = read_stl(RING, 0.002).expect("closed");
    assert_eq!((ring.points_m().len(), ring.triangles().len()), (128, 256));
    assert!((ring.reach_m() - 0.044).abs() < 1e-9);
    // A binary title says nothing, and zero has no sign.
    let mut other = RING.to_vec();
    other[..80].fill(b'x');
    for number in other[84..]
        .chunks_exact_mut(50)
        .flat_map(|own| own[..48].chunks_exact_mut(4))
    {
        if number == [0; 4] {
            number[3] = 0x80;
        }
    }
    assert_eq!(read_stl(&other, 0.002).expect("closed"), ring);
}

/// Files cut off anywhere, with counts that are too large, and with bytes changed at random end in an error or in a mesh.
#[test]
fn garbage_is_told_and_breaks_nothing() {
    for end in 0..BRACKET.len() - "endsolid bracket\n".len() {
        assert!(read_stl(&BRACKET[..end], 0.001).is_err(), "cut at {end}");
    }
    for end in (0..RING.len()).step_by(7) {
        assert!(read_stl(&RING[..end], 0.001).is_err(), "cut at {end}");
    }
    let mut giant = RING.to_vec();
    giant[..5].copy_from_slice(b"title");
    for count in [u32::MAX, 20_001, 257, 0] {
        giant[80..84].copy_from_slice(&count.to_le_bytes());
        let flaw = read_stl(&giant, 0.001).expect_err("another size");
        assert!(matches!(flaw, SurfaceFlaw::File(_)), "{flaw}");
    }
    giant[80..84].copy_from_slice(&0u32.to_le_bytes());
    assert_eq!(read_stl(&giant[..84], 0.001), Err(SurfaceFlaw::Empty));
    let rng = &mut fastrand::Rng::with_seed(13);
    let mut refused = 0;
    for round in 0..2000 {
        let mut file = if round % 2 == 0 {
            BRACKET.to_vec()
        } else {
            RING.to_vec()
        };
        for _ in 0..rng.usize(1..8) {
            let at = rng.usize(..file.len());
            file[at] = rng.u8(..);
        }
        refused += u32::from(read_stl(&file, 0.001).is_err());
    }
    assert!(refused > 1000, "{refused}");
    let noise: Vec<u8> = (0..5000).map(|_| rng.u8(..)).collect();
    assert!(read_stl(&noise, 1.0).is_err());
}
