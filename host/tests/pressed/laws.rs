//! What pressed slabs must obey.

use super::rig::{Pressed, Setup, shared, traction};
use crate::touch::rig::Blocks;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use sutura_host::collide::TouchSettings;
use sutura_host::fem::{
    Anchor, CorotationalTissue, Handle, LinearTissue, Loads, Material, Materials, NodeLoad, Policy,
};
use sutura_host::model::ModelError;
use sutura_host::step::{State, Status, StepOptions, Workspace, step};

const SIDE_M: f64 = 0.02;
const HEIGHT_M: f64 = 0.03;
const GAP_M: f64 = 2e-4;
/// Without Poisson's ratio a column under pressure stays a column.
const COLUMN: Material = Material {
    youngs_modulus_pa: 10e3,
    poisson_ratio: 0.0,
};

/// Two columns, the lower one on a table and the upper one under a ceiling, whose lower end is drawn down by a uniform
/// traction over a gap.
fn apart(gap_m: f64, [upper, lower]: [[usize; 3]; 2], traction_pa: f64, turns: bool) -> Setup {
    let size = [SIDE_M, SIDE_M, HEIGHT_M];
    let above = Isometry3::translation(0.0, 0.0, HEIGHT_M + gap_m);
    let blocks = Blocks::new(&[(size, upper, above), (size, lower, Isometry3::identity())]);
    let mut fixed = blocks.nodes(0, |at| at[2] > HEIGHT_M + gap_m - 1e-9);
    fixed.extend(blocks.nodes(1, |at| at[2] < 1e-9 - HEIGHT_M));
    let points = blocks.mesh.points_m();
    let is_low = |node: &u32| points[*node as usize][2] < gap_m + 1e-9;
    let mut faces = blocks.faces(0);
    faces.retain(|face| face.iter().all(is_low));
    let down = Vector3::new(0.0, 0.0, -traction_pa);
    let forces = traction(points, &faces, down);
    Setup {
        fixed,
        loads: Loads {
            forces,
            ..Loads::default()
        },
        blocks,
        materials: COLUMN.into(),
        friction: 0.0,
        turns,
    }
}

/// Two columns over a narrow gap.
fn columns(upper: [usize; 3], lower: [usize; 3], traction_pa: f64, turns: bool) -> Pressed {
    Pressed::new(apart(GAP_M, [upper, lower], traction_pa, turns)).expect("has a rest")
}

/// How far two columns are from their closed form.
#[derive(Debug)]
struct Deviation {
    /// Pressure of the contact in closed form \[Pa\].
    pressure_pa: f64,
    /// Largest of a principal stress of a cell \[Pa\], of all cells and of those that are not at the contact.
    stress_pa: [f64; 2],
    /// Largest of a node \[m\].
    node_m: f64,
}

fn deviation(pressed: &Pressed, gap_m: f64, traction_pa: f64) -> Deviation {
    // Both give way by h / E: (P - q) h / E + q h / E of each other, until what is left of the gap is the separation.
    let give = HEIGHT_M / COLUMN.youngs_modulus_pa;
    let closed_m = gap_m - pressed.separation_m;
    let pressure_pa = 0.5 * (traction_pa - closed_m / give);
    let rest = pressed.rest();
    let stress = pressed.model.principal_stress_pa(&rest.displacement_m);
    let mesh = &pressed.blocks.mesh;
    let (mut off_pa, mut off_m) = ([0.0f64; 2], 0.0f64);
    for (cell, stress) in mesh.cells().iter().zip(&stress) {
        let wanted = if cell[0] < pressed.blocks.first[1] {
            [traction_pa - pressure_pa, 0.0, 0.0]
        } else {
            [0.0, 0.0, -pressure_pa]
        };
        let z = cell.map(|node| mesh.points_m()[node as usize][2] - 0.5 * gap_m);
        let far = usize::from(z.iter().all(|z| z.abs() > 0.5 * SIDE_M));
        for (found, wanted) in stress.iter().zip(wanted) {
            for off_pa in &mut off_pa[..=far] {
                *off_pa = off_pa.max((found - wanted).abs());
            }
        }
    }
    for (node, (at, u)) in (0u32..).zip(mesh.points_m().iter().zip(&rest.displacement_m)) {
        let wanted = if node < pressed.blocks.first[1] {
            let part = (HEIGHT_M + gap_m - at[2]) / HEIGHT_M;
            -part * (traction_pa - pressure_pa) * give
        } else {
            -(at[2] + HEIGHT_M) / HEIGHT_M * pressure_pa * give
        };
        off_m = off_m.max((Vector3::from(*u) - Vector3::new(0.0, 0.0, wanted)).norm());
    }
    Deviation {
        pressure_pa,
        stress_pa: off_pa,
        node_m: off_m,
    }
}

/// The force of the contact is what loads and fixed nodes leave, to a part in 1e6.
fn assert_balanced(pressed: &Pressed) {
    let rest = pressed.rest();
    assert!(rest.residual < 1e-9, "{}", rest.residual);
    let (contact, others) = (pressed.contact_n(), pressed.others_n(&rest));
    assert!(contact.z > 0.0, "{contact}");
    assert!(
        (contact + others).norm() < 1e-6 * contact.norm(),
        "{contact} {others}"
    );
}

/// Parts that only meet after several shares of a load, and none of them moves a node as far as the gap.
#[test]
fn loads_close_a_gap_that_is_wider_than_one_of_their_shares() {
    for (gap_m, turns) in [(2e-3, false), (2e-3, true), (6e-3, false)] {
        let traction_pa = 5000.0;
        let setup = apart(gap_m, [[4, 4, 6]; 2], traction_pa, turns);
        let mut pressed = Pressed::new(setup).expect("has a rest");
        assert_balanced(&pressed);
        if !turns {
            let off = deviation(&pressed, gap_m, traction_pa);
            assert!(off.pressure_pa > 1000.0);
            assert!(off.stress_pa[0] < 1e-9 * off.pressure_pa, "{off:?}");
        }
        let (_, last) = pressed.wait(1);
        assert!(last.touching >= 25, "{}", last.touching);
    }
}

/// Pairs for which there is no room would go through each other.
#[test]
fn more_pairs_than_there_is_room_for_are_no_rest() {
    let settings = TouchSettings {
        most_pairs: 15,
        ..TouchSettings::default()
    };
    let setup = || apart(GAP_M, [[3, 3, 3]; 2], 200.0, false);
    let found = Pressed::with(setup(), settings).map(drop);
    let Err(ModelError::NoRest { status, .. }) = found else {
        panic!("{found:?}")
    };
    assert_eq!(status, Status::TooManyRows);
    // One for each node of the faces.
    let most_pairs = 16;
    let settings = TouchSettings {
        most_pairs,
        ..settings
    };
    let pressed = Pressed::with(setup(), settings).expect("has a rest");
    assert_balanced(&pressed);
}

#[test]
fn two_columns_share_a_pressure_by_their_stiffness() {
    // The last one would be 15 mm in the other column, three edges.
    for (traction_pa, turns) in [(200.0, false), (200.0, true), (5000.0, false)] {
        let mut pressed = columns([4, 4, 6], [4, 4, 6], traction_pa, turns);
        assert_balanced(&pressed);
        let off = deviation(&pressed, GAP_M, traction_pa);
        assert!(off.pressure_pa > 50.0);
        assert!(off.stress_pa[0] < 1e-9 * off.pressure_pa, "{off:?}");
        assert!(off.node_m < 1e-12, "{off:?}");
        // Nothing moves in steps that nothing happens in.
        let (moved_m, report) = pressed.wait(5);
        assert!(moved_m < 1e-11, "{moved_m}");
        assert!(report.touching > 0);
        assert!(report.stored_energy_j.abs() < 1e-9);
    }
}

/// Patch test of contact (Taylor & Papadopoulos 1991): a uniform pressure passes through meshes that do not match. Rows at
/// points share it out among the nodes only about as a pressure would, which is hardly seen half a width from there, and
/// the less the more the pressure moves tissue by than the separation.
#[test]
fn a_uniform_pressure_passes_through_meshes_that_do_not_match() {
    for (upper, lower) in [
        ([4, 4, 4], [5, 5, 5]),
        ([3, 4, 4], [7, 5, 5]),
        ([2, 2, 3], [6, 6, 4]),
    ] {
        for traction_pa in [200.0, 2000.0] {
            let pressed = columns(upper, lower, traction_pa, false);
            assert_balanced(&pressed);
            let off = deviation(&pressed, GAP_M, traction_pa);
            let mean_pa = pressed.contact_n().z / (SIDE_M * SIDE_M);
            // Nodes that lie between a half of the separation and all of it are not held yet.
            let bars = if traction_pa > 1000.0 {
                [0.001, 0.05, 0.005]
            } else {
                [0.01, 0.2, 0.02]
            };
            let off_pa = [
                (mean_pa - off.pressure_pa).abs(),
                off.stress_pa[0],
                off.stress_pa[1],
            ];
            for (off_pa, bar) in off_pa.iter().zip(bars) {
                assert!(
                    *off_pa < bar * off.pressure_pa,
                    "{upper:?} {lower:?}: {mean_pa} {off:?}"
                );
            }
            assert!(off.node_m < 1.5 * pressed.separation_m, "{off:?}");
        }
    }
}

/// Young's modulus of what a block hangs on [Pa].
const SOFT_PA: f64 = 50.0;

/// A block over a larger one, turned and shifted; the block hangs on tissue that is soft.
fn hanging(to: &Isometry3<f64>, friction: f64, load_n: Vector3<f64>, turns: bool) -> Pressed {
    hanging_on(to, friction, load_n, turns, SOFT_PA)
}

/// As [`hanging`], with the Young's modulus of what the block hangs on.
fn hanging_on(
    to: &Isometry3<f64>,
    friction: f64,
    load_n: Vector3<f64>,
    turns: bool,
    soft_pa: f64,
) -> Pressed {
    let soft = Material {
        youngs_modulus_pa: soft_pa,
        poisson_ratio: 0.0,
    };
    let block = Material {
        youngs_modulus_pa: 20e3,
        poisson_ratio: 0.3,
    };
    let above = Isometry3::translation(0.0011, 0.0007, 0.012 + 5e-5);
    let local = Blocks::new(&[
        ([0.02, 0.02, 0.012], [4, 4, 3], above),
        ([0.04, 0.04, 0.01], [7, 7, 3], Isometry3::identity()),
    ]);
    let mut fixed = local.nodes(0, |at| at[2] > 0.012);
    fixed.extend(local.nodes(1, |at| at[2] < -0.0099));
    // Nodes of the block: all layers but those of what it hangs on.
    let low = local.nodes(0, |at| at[2] < 0.0041);
    let middle = |cell: &[u32; 4]| {
        let z = cell
            .iter()
            .map(|node| local.mesh.points_m()[*node as usize][2]);
        z.sum::<f64>() / 4.0
    };
    let cells = local.mesh.cells().iter();
    let of_cell = cells.map(|cell| u32::from(middle(cell) > 0.008)).collect();
    let sideways = shared(
        &local.nodes(0, |at| at[2] < 1e-4),
        to.rotation * Vector3::new(load_n.x, load_n.y, 0.0),
    );
    let down = shared(&low, to.rotation * Vector3::new(0.0, 0.0, load_n.z));
    let slabs = [0, 1].map(|body| {
        let whole = [
            ([0.02, 0.02, 0.012], [4, 4, 3], to * above),
            ([0.04, 0.04, 0.01], [7, 7, 3], *to),
        ];
        whole[body]
    });
    Pressed::new(Setup {
        blocks: Blocks::new(&slabs),
        materials: Materials::by_cell(vec![block, soft], of_cell),
        fixed,
        loads: Loads {
            forces: sideways.into_iter().chain(down).collect(),
            ..Loads::default()
        },
        friction,
        turns,
    })
    .expect("has a rest")
}

#[test]
fn a_block_slips_beyond_the_cone_and_not_within_it() {
    let friction = 0.4;
    let rests = Isometry3::identity();
    let slipped = |share: f64| {
        let load = Vector3::new(share * friction * 0.3, 0.0, -0.3);
        let pressed = hanging(&rests, friction, load, false);
        assert_balanced(&pressed);
        let contact = pressed.contact_n();
        let rest = pressed.rest();
        let low = pressed.blocks.nodes(0, |at| at[2] < 1e-4);
        let slips = low
            .iter()
            .map(|node| rest.displacement_m[*node as usize][0]);
        let slip_m = slips.sum::<f64>() / low.len() as f64;
        let used = contact.x.abs() / (friction * contact.z);
        (used, slip_m)
    };
    let [(_, half_m), (within, within_m), (beyond, beyond_m)] = [0.5, 0.99, 1.01].map(slipped);
    assert!((0.985..0.9999).contains(&within), "{within}");
    // The cones stand on faces that are bent a little, and on both sides of valleys that are pressed into them.
    assert!((0.99..1.005).contains(&beyond), "{beyond}");
    assert!(within_m < 3.0 * half_m && beyond_m > 2.5 * within_m);
}

/// How far a scene comes to rest from where it does turned by `axis` [rad] and shifted, over the farthest way of a node, and
/// the same of the contact's force.
fn turned_off(axis: Vector3<f64>, friction: f64, turns: bool, soft_pa: f64) -> [f64; 2] {
    let turned = Isometry3::from_parts(
        Translation3::new(0.03, -0.02, 0.05),
        UnitQuaternion::from_scaled_axis(axis),
    );
    let load = Vector3::new(0.02, 0.013, -0.3);
    let [straight, turned_] =
        [Isometry3::identity(), turned].map(|to| hanging_on(&to, friction, load, turns, soft_pa));
    let [a, b] = [&straight, &turned_].map(Pressed::rest);
    let (mut off_m, mut most_m) = (0.0f64, 0.0f64);
    for (a, b) in a.displacement_m.iter().zip(&b.displacement_m) {
        let a = turned.rotation * Vector3::from(*a);
        off_m = off_m.max((a - Vector3::from(*b)).norm());
        most_m = most_m.max(a.norm());
    }
    let [a, b] = [&straight, &turned_].map(Pressed::contact_n);
    [off_m / most_m, (turned.rotation * a - b).norm() / a.norm()]
}

#[test]
fn a_turned_scene_comes_to_the_same_rest() {
    for turn in 0..3 {
        let along = f64::from(turn);
        let axis = Vector3::new(0.3 + 0.4 * along, -0.5 + 0.28 * along, 0.7);
        for (friction, turns, soft_pa) in [
            (0.0, false, SOFT_PA),
            (0.4, false, SOFT_PA),
            (0.0, true, 4.0 * SOFT_PA),
        ] {
            let [off, _] = turned_off(axis, friction, turns, soft_pa);
            assert!(off < 1e-9, "{turn} {friction} {turns}: {off}");
        }
        // On what is softer the passes of the loading overshoot, and what they meet on the way differs with the last bits: a rest is
        // then one of several, which differ by what contact leaves open: its separation, and 5 % of an edge at which points of contact
        // stay where they are.
        let [off, off_n] = turned_off(axis, 0.0, true, SOFT_PA);
        assert!(off < 0.02 && off_n < 0.002, "{turn}: {off} {off_n}");
    }
}

/// A handle on the upper column's lower end presses it into the other; the whole tissue under the forces of the contact and
/// with the same handle says the same.
#[test]
fn a_handle_presses_tissue_on_tissue() {
    let size = [SIDE_M, SIDE_M, HEIGHT_M];
    for turns in [false, true] {
        let above = Isometry3::translation(0.001, 0.0, HEIGHT_M + GAP_M);
        let slabs = [
            (size, [4, 4, 4], above),
            (size, [5, 5, 4], Isometry3::identity()),
        ];
        let blocks = Blocks::new(&slabs);
        let mut fixed = blocks.nodes(0, |at| at[2] > HEIGHT_M + GAP_M - 1e-9);
        fixed.extend(blocks.nodes(1, |at| at[2] < 1e-9 - HEIGHT_M));
        let inside = |at: &[f64; 3]| {
            (at[0] - 0.001).abs() < 1e-4 && at[1].abs() < 1e-4 && (at[2] - 0.0077).abs() < 1e-3
        };
        let handle = Handle {
            anchor: Anchor {
                vertices: blocks.nodes(0, inside),
                weights: vec![1.0],
            },
            target_displacement_m: [0.0, 2e-4, -1e-3],
        };
        assert_eq!(handle.anchor.vertices.len(), 1);
        let mut pressed = Pressed::new(Setup {
            loads: Loads {
                handles: vec![handle.clone()],
                ..Loads::default()
            },
            blocks,
            materials: COLUMN.into(),
            fixed,
            friction: 0.2,
            turns,
        })
        .expect("has a rest");
        let rest = pressed.rest();
        let forces = pressed.state.contact_forces(&pressed.model);
        let by_contact = forces.filter(|(node, _)| *node != handle.anchor.vertices[0]);
        let by_contact: Vec<_> = by_contact
            .map(|(node, force_n)| NodeLoad { node, force_n })
            .collect();
        assert!(by_contact.len() > 20, "{}", by_contact.len());
        let loads = Loads {
            forces: by_contact,
            handles: vec![handle],
            ..Loads::default()
        };
        let (mesh, fixed) = (&pressed.blocks.mesh, &pressed.fixed);
        let whole = if turns {
            let tissue = CorotationalTissue::new(mesh, COLUMN, fixed, Policy::default());
            tissue.expect("tissue").solve(&loads)
        } else {
            LinearTissue::new(mesh, COLUMN, fixed)
                .expect("tissue")
                .solve(&loads)
        }
        .expect("a balance");
        let off_n = Vector3::from(rest.handle_force_n[0]) - Vector3::from(whole.handle_force_n[0]);
        let force_n = Vector3::from(whole.handle_force_n[0]).norm();
        assert!(off_n.norm() < 1e-7 * force_n, "{off_n} of {force_n}");
        for (found, wanted) in rest.displacement_m.iter().zip(&whole.displacement_m) {
            assert!((Vector3::from(*found) - Vector3::from(*wanted)).norm() < 1e-10);
        }
        let (moved_m, _) = pressed.wait(5);
        assert!(moved_m < 1e-10, "{moved_m}");
    }
}

/// Where bodies do not meet nothing is other than without contact.
#[test]
fn what_does_not_meet_rests_as_without_contact() {
    let up = columns([2, 2, 3], [3, 3, 3], -50.0, false);
    assert_eq!(up.state.contact_forces(&up.model).count(), 0);
    let (off_m, report) = {
        let mut up = up;
        up.wait(2)
    };
    assert_eq!((off_m, report.touching), (0.0, 0));
}

#[test]
fn no_step_of_pressed_slabs_allocates() {
    for turns in [false, true] {
        let load = Vector3::new(0.05, 0.0, -0.3);
        let pressed = hanging(&Isometry3::identity(), 0.4, load, turns);
        let mut state = State::new(&pressed.model);
        let mut work = Workspace::new(&pressed.model);
        work.prepare(&pressed.model, |_| true);
        let mut run = |steps: usize| {
            (0..steps).all(|_| {
                step(
                    &pressed.model,
                    &mut state,
                    &[],
                    &StepOptions::default(),
                    &mut work,
                )
                .status
                    == Status::Ok
            })
        };
        assert!(run(3));
        let mut done = false;
        let allocated = allocation_counter::measure(|| done = run(20));
        assert!(done);
        assert_eq!(allocated.count_total, 0, "{turns}: {allocated:?}");
    }
}
