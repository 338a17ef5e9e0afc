//! Pressed, slid and let go of: nothing gets inside, and nothing is gained.

use super::rig::{Blocks, Rig, moved};
use nalgebra::{Isometry3, Vector3};
use sutura_host::anchors::PointConstraint;
use sutura_host::collide::{
    TouchPart, TouchSettings, TouchState, TouchWork, Touching, penetration_m,
};

/// A block with turned faces over a large one, its top and the other's bottom fixed.
fn turned_block(friction: f64) -> (Rig, Vec<u32>) {
    let turn = Vector3::new(0.02, -0.03, 0.4);
    let above = Isometry3::new(Vector3::new(-0.0061, 0.0013, 0.0215), turn);
    let blocks = Blocks::new(&[
        ([0.03, 0.03, 0.02], [6, 6, 4], above),
        ([0.06, 0.06, 0.03], [9, 9, 4], Isometry3::identity()),
    ]);
    let count = blocks.first[1];
    let top: Vec<u32> = (count - 49..count).collect();
    let mut fixed = blocks.nodes(1, |at| at[2] < -0.0299);
    fixed.extend(&top);
    (Rig::new(blocks, &fixed, friction), top)
}

/// Ways of the top \[m\]: down, aside, up, and back.
fn cycle(steps: u32) -> impl Iterator<Item = [f64; 3]> {
    let way = [
        [0.0, 0.0, 0.0],
        [0.0, 0.0, -0.0035],
        [0.011, 0.004, -0.004],
        [0.011, 0.004, 0.001],
        [0.0, 0.0, 0.0],
    ];
    (0..4 * steps).map(move |step| {
        let (leg, along) = (
            (step / steps) as usize,
            f64::from(step % steps + 1) / f64::from(steps),
        );
        [0, 1, 2].map(|axis: usize| way[leg][axis] * (1.0 - along) + way[leg + 1][axis] * along)
    })
}

/// What came of a cycle.
#[derive(Debug)]
struct Cycle {
    /// Work that was not given back, and the most that was in it \[J\].
    work_j: [f64; 2],
    /// Deepest penetration, in mean edges.
    deepest: f64,
    most_n: f64,
    solves: usize,
    most_solves: usize,
    most_pairs: usize,
    pairs_taken: u64,
}

fn around(rig: &mut Rig, top: &[u32], steps: u32) -> Cycle {
    let faces = rig.faces();
    let edge = rig.touching.mean_edge_m();
    let mut found = Cycle {
        work_j: [0.0; 2],
        deepest: 0.0,
        most_n: 0.0,
        solves: 0,
        most_solves: 0,
        most_pairs: 0,
        pairs_taken: 0,
    };
    let mut before = (Vector3::zeros(), Vector3::zeros());
    for to in cycle(steps) {
        let report = rig.step(&moved(top, to));
        let push = rig.holding(top, &report);
        let [work, stored] = &mut found.work_j;
        *work += 0.5 * (push + before.1).dot(&(Vector3::from(to) - before.0));
        *stored = stored.max(*work);
        before = (Vector3::from(to), push);
        let depth = penetration_m([&faces[0], &faces[1]], &rig.at);
        found.deepest = found.deepest.max(depth / edge);
        found.most_n = found.most_n.max(push.norm());
        found.solves += report.solves;
        found.most_solves = found.most_solves.max(report.solves);
        found.most_pairs = found.most_pairs.max(rig.state.pairs());
        let serials = report.rows.iter().map(|row| (row.id & 0xff_ffff_ffff) >> 2);
        found.pairs_taken = serials.fold(found.pairs_taken, |most, serial| most.max(serial + 1));
    }
    found
}

/// In steps of a thirtieth of an edge up to two thirds of one; what linearised rows lose is of second order in a step.
#[test]
fn a_block_that_is_pressed_slid_and_lifted_never_gets_inside_and_gives_back_the_work() {
    for (steps, most) in [(60, 0.005), (15, 0.04), (4, f64::INFINITY)] {
        let (mut rig, top) = turned_block(0.0);
        let found = around(&mut rig, &top, steps);
        assert!(found.deepest <= 1e-3, "{found:?}");
        assert!(found.most_n > 0.3, "{found:?}");
        assert_eq!(rig.state.pairs(), 0);
        let [work, stored] = found.work_j;
        assert!(work.abs() < most * stored, "{found:?}");
    }
}

/// Pairs keep their ids while they wander over faces, so that the next solve starts from their forces. New are those of a vertex that comes
/// to a second side of a valley: they begin without force.
#[test]
fn pairs_keep_their_ids_while_they_slide() {
    let (mut rig, top) = turned_block(0.0);
    let (mut before, mut kept, mut all) = (Vec::new(), 0, 0);
    for (number, to) in cycle(60).take(120).enumerate() {
        let report = rig.step(&moved(&top, to));
        let vertex = |row: &PointConstraint| {
            let anchor = &report.anchors[row.anchor as usize];
            (anchor.weights[0] == 1.0).then_some(anchor.nodes[0])
        };
        let pressing = report.rows.iter().zip(&report.lambda);
        let now: Vec<&PointConstraint> = pressing
            .filter(|(_, lambda)| **lambda > 0.0)
            .map(|(row, _)| row)
            .collect();
        assert!(now.iter().all(|row| row.id >> 40 == 1));
        let mut sorted: Vec<u64> = now.iter().map(|row| row.id).collect();
        sorted.sort_unstable();
        sorted.dedup();
        assert_eq!(sorted.len(), now.len());
        if number >= 60 {
            let was = |row: &PointConstraint| before.contains(&row.id);
            let is_second = |row: &PointConstraint| {
                let mut others = report.rows.iter().filter(|other| other.id != row.id);
                vertex(row).is_some()
                    && others.any(|other| vertex(other) == vertex(row) && was(other))
            };
            let goes_on = now.iter().filter(|row| was(row) || is_second(row));
            kept += goes_on.count();
            all += now.len();
        }
        before = report.rows.iter().map(|row| row.id).collect();
    }
    assert!(
        all > 2000 && kept as f64 > 0.98 * all as f64,
        "{kept} of {all}"
    );
}

/// Friction keeps some of it.
#[test]
fn friction_costs_work() {
    let (mut rig, top) = turned_block(0.3);
    let found = around(&mut rig, &top, 30);
    assert!(found.deepest <= 1e-3, "{found:?}");
    let [work, stored] = found.work_j;
    // Some 0.9 N over 1.1 cm.
    assert!(
        work > 0.5 * 0.3 * found.most_n * 0.0117 && work <= stored,
        "{found:?}"
    );
}

/// One body that touches itself is pressed as two are.
#[test]
fn a_body_that_touches_itself_does_as_two_bodies_do() {
    let (mut two, top) = turned_block(0.0);
    let (mut one, _) = turned_block(0.0);
    let faces = one.faces().concat();
    let part = TouchPart {
        faces: [faces.clone(), faces],
        friction: 0.0,
    };
    one.touching = Touching::new(&[part], &one.at, TouchSettings::default()).expect("a body");
    one.state = TouchState::new(&one.touching, &one.at);
    one.work = TouchWork::new(&one.touching, one.at.len());
    let mut most = 0.0f64;
    for to in cycle(15).take(32) {
        let [push, other] = [&mut two, &mut one].map(|rig| {
            let report = rig.step(&moved(&top, to));
            rig.holding(&top, &report)
        });
        assert!(
            (push - other).norm() <= 1e-3 * push.norm().max(1e-3),
            "{to:?} {push} {other}"
        );
        most = most.max(push.norm());
    }
    assert!(most > 0.3, "{most}");
}

/// The same bits every time, and whatever the scratch knows.
#[test]
fn scratch_does_not_matter() {
    let (mut one, top) = turned_block(0.0);
    let (mut other, _) = turned_block(0.0);
    let mut most = 0;
    for to in cycle(15).take(35) {
        let first = one.step(&moved(&top, to));
        other.work = TouchWork::new(&other.touching, other.at.len());
        let second = other.step(&moved(&top, to));
        assert_eq!(first.lambda, second.lambda);
        assert!(one.state == other.state, "{to:?}");
        most = most.max(first.rows.len());
    }
    assert!(most > 50, "{most}");
}

#[test]
fn looking_and_accepting_allocate_nothing() {
    let (mut rig, top) = turned_block(0.2);
    let points = rig.blocks.mesh.points_m().to_vec();
    let rest = rig.at.clone();
    let mut steps = Vec::new();
    for to in cycle(10).take(28) {
        let report = rig.step(&moved(&top, to));
        steps.push((report.seen, report.lambda));
    }
    let mut state = TouchState::new(&rig.touching, &rest);
    let mut saved = TouchState::new(&rig.touching, &rest);
    let mut work = TouchWork::new(&rig.touching, rest.len());
    let mut anchors = Vec::with_capacity(rig.touching.most_pairs());
    let mut rows = Vec::with_capacity(rig.touching.most_rows());
    let mut most = 0;
    let allocated = allocation_counter::measure(|| {
        for (seen, lambda) in &steps {
            saved.copy_from(&state);
            for at in seen {
                anchors.clear();
                rows.clear();
                state.rows(&rig.touching, &points, &mut anchors, &mut rows);
                state.look(&rig.touching, &mut work, at);
                most = most.max(rows.len());
            }
            if let Some(at) = seen.last() {
                state.accept(&rig.touching, &mut work, at, lambda);
            }
        }
    });
    assert!(most > 100, "{most}");
    assert!(state == rig.state);
    assert_eq!(allocated.count_total, 0, "{allocated:?}");
}
