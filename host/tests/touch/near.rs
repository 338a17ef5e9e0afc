//! How far apart bodies are said to be, and whom that lets off looking.

use super::rig::{Blocks, Rig, moved};
use nalgebra::{Isometry3, Vector3};
use sutura_host::collide::{Body, Margin, Path, TouchPart, TouchSettings, Touching};
use sutura_host::mesh::tube;

const NONE: Margin = Margin {
    separation_m: 0.0,
    tolerance_m: 0.0,
};

fn boxes(faces: &[[u32; 3]], at: &[Vector3<f64>]) -> Vec<[Vector3<f64>; 2]> {
    let around = |face: &[u32; 3]| {
        let [a, b, c] = face.map(|node| at[node as usize]);
        [a.inf(&b).inf(&c), a.sup(&b).sup(&c)]
    };
    faces.iter().map(around).collect()
}

/// Against all pairs of faces' boxes, for tubes side by side, over each other and within each other.
#[test]
fn bodies_are_as_far_apart_as_the_boxes_of_their_nearest_faces() {
    let ways = [
        [0.0, 0.0, 0.036],
        [0.03, 0.001, 0.02],
        [0.05, 0.04, 0.06],
        [0.0, 0.0, 0.0],
    ];
    for (index, by) in ways.into_iter().enumerate() {
        let inner = tube([0.008, 0.011], [0.0, 0.03], [1, 14, 5]).expect("a tube");
        let outer = tube([0.0125, 0.015], [0.0, 0.03], [1, 17, 6]).expect("a tube");
        let blocks = Blocks::of(
            [
                (
                    inner,
                    Isometry3::new(by.into(), Vector3::new(0.1, 0.02, 0.3)),
                ),
                (outer, Isometry3::identity()),
            ]
            .into_iter(),
        );
        let at: Vec<Vector3<f64>> = blocks
            .mesh
            .points_m()
            .iter()
            .map(|p| Vector3::from(*p))
            .collect();
        let path = |node: u32| Path {
            from: at[node as usize],
            to: at[node as usize],
        };
        let faces = [blocks.faces(0), blocks.faces(1)];
        let [a, b] = [0, 1].map(|body: usize| Body::new(&faces[body], path, &NONE));
        let others = boxes(&faces[1], &at);
        let mut least = f64::INFINITY;
        for [low, high] in boxes(&faces[0], &at) {
            for [other_low, other_high] in &others {
                let gap = (low - other_high)
                    .sup(&(other_low - high))
                    .sup(&Vector3::zeros());
                least = least.min(gap.norm());
            }
        }
        for found in [a.apart_m(&b), b.apart_m(&a)] {
            assert!(
                found <= least && found >= least * (1.0 - 1e-12),
                "{by:?}: {found} {least}"
            );
        }
        assert!(index == 3 || least > 1e-4, "{by:?}: {least}");
    }
}

/// 0.5 mm apart: either may move by half of it.
#[test]
fn nobody_has_to_look_before_something_can_have_met() {
    let blocks = Blocks::new(&[
        (
            [0.03, 0.03, 0.02],
            [5, 5, 3],
            Isometry3::translation(0.002, 0.001, 0.0205),
        ),
        ([0.06, 0.06, 0.03], [8, 8, 4], Isometry3::identity()),
    ]);
    let top = blocks.nodes(0, |at| at[2] > 0.0204);
    let mut fixed = blocks.nodes(1, |at| at[2] < -0.0299);
    fixed.extend(&top);
    let mut rig = Rig::new(blocks, &fixed, 0.0);
    // Nothing is known before the first balance.
    assert!(!rig.state.is_clear(0.0));
    rig.step(&[]);
    let room = 0.0005 - rig.touching.separation_m();
    assert!(rig.state.is_clear(0.499 * room) && !rig.state.is_clear(0.501 * room));
    rig.step(&moved(&top, [0.0, 0.0, -0.0004]));
    assert!(rig.state.is_clear(2e-5) && !rig.state.is_clear(1e-4));
    rig.step(&moved(&top, [0.0, 0.0, -0.0006]));
    assert!(rig.state.pairs() > 0 && !rig.state.is_clear(0.0));
}

#[test]
fn what_makes_no_sense_is_refused() {
    let at = vec![
        Vector3::zeros(),
        Vector3::x(),
        Vector3::y(),
        Vector3::z(),
        Vector3::repeat(f64::NAN),
    ];
    let part = |a: [u32; 3], b: [u32; 3], friction| TouchPart {
        faces: [vec![a], vec![b]],
        friction,
    };
    let new = |part: TouchPart, settings| Touching::new(&[part], &at, settings).map(|_| ());
    let plain = TouchSettings::default();
    let says = |result: Result<(), _>, what: &str| {
        let error = format!(
            "{}",
            result
                .map_err(|error: sutura_host::collide::TouchError| error)
                .expect_err(what)
        );
        assert!(error.contains(what), "{error}");
    };
    assert!(new(part([0, 1, 2], [1, 2, 3], 0.1), plain).is_ok());
    says(new(part([0, 1, 2], [1, 2, 9], 0.1), plain), "node 9");
    says(new(part([0, 1, 4], [1, 2, 3], 0.1), plain), "node 4");
    says(new(part([0, 1, 2], [1, 2, 3], -0.1), plain), "friction");
    says(new(part([0, 1, 2], [1, 2, 3], f64::NAN), plain), "friction");
    let empty = TouchPart {
        faces: [vec![], vec![[0, 1, 2]]],
        friction: 0.0,
    };
    says(new(empty, plain), "no faces");
    let close = TouchSettings {
        release: 0.004,
        ..plain
    };
    says(new(part([0, 1, 2], [1, 2, 3], 0.0), close), "release");
    let none = TouchSettings {
        guard: 0.0,
        ..plain
    };
    says(new(part([0, 1, 2], [1, 2, 3], 0.0), none), "guard");
}
