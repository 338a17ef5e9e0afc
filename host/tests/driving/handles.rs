//! Handles beside needles: against solves of the whole tissue under the needle's forces.

use super::bench::{Bench, Kind, MATERIAL, frame, slabs, straight, tissue};
use nalgebra::Vector3;
use sutura_host::fem::{
    Anchor, CorotationalTissue, Equilibrium, Handle, LinearTissue, Loads, NodeLoad, Policy,
};
use sutura_host::model::Passes;
use sutura_host::needle::NeedleSettings;
use sutura_host::step::{State, Status, StepOptions, step};

/// Passes of a step that go on until the tissue is in balance.
const EXACT: Passes = Passes {
    most: 60,
    tolerance: 1e-12,
};

/// The face of the upper slab's top that is nearest to a place, held `by` aside.
fn handle(place: [f64; 2], by: [f64; 3]) -> Handle {
    let mesh = slabs().0;
    let points = mesh.points_m();
    let top = points.iter().map(|x| x[2]).fold(f64::MIN, f64::max);
    let far = |face: &[u32; 3]| -> f64 {
        let corners = face.iter().map(|node| points[*node as usize]);
        corners
            .map(|x| (x[0] - place[0]).hypot(x[1] - place[1]) + 10.0 * (top - x[2]))
            .sum()
    };
    let faces = mesh.surface().triangles;
    let nearest = faces.iter().min_by(|a, b| far(a).total_cmp(&far(b)));
    Handle {
        anchor: Anchor {
            vertices: nearest.expect("a face").to_vec(),
            weights: vec![0.5, 0.3, 0.2],
        },
        target_displacement_m: by,
    }
}

fn held(handles: Vec<Handle>, kind: Kind) -> Bench {
    let mesh = slabs();
    let tissue = vec![tissue(); mesh.0.cells().len()];
    let start = frame([0.0011, 0.0007, 0.044], [0.1, 0.05, -1.0], [1.0, 0.0, 0.0]);
    let loads = Loads {
        forces: vec![NodeLoad {
            node: mesh.0.points_m().len() as u32 / 4,
            force_n: [0.0, 0.01, -0.02],
        }],
        handles,
        ..Loads::default()
    };
    let needles = [(straight(0.03), start)];
    let settings = NeedleSettings::default();
    Bench::loaded(mesh, kind, &needles, (MATERIAL, loads), &tissue, settings)
}

/// Away from the faces that the needle goes through.
fn pull() -> Handle {
    handle([-0.008, -0.009], [0.0004, 0.0003, 0.0011])
}

/// Pushes the needle on by so many steps of 0.25 mm.
fn push(bench: &mut Bench, steps: usize) {
    for _ in 0..steps {
        let along = bench.grip.rotation * Vector3::x();
        bench.grip.translation.vector += along * 2.5e-4;
        let report = bench.step();
        assert_eq!(report.status, Status::Ok);
        bench.look(&report);
    }
}

/// The loads of a bench with its needle's forces among them.
fn acting(bench: &Bench, handles: &[Handle]) -> Loads {
    let held = |node: &u32| handles.iter().any(|h| h.anchor.vertices.contains(node));
    let forces = bench.state.contact_forces(&bench.model);
    let by_needle = forces.filter(|(node, _)| !held(node));
    let mut loads = Loads {
        forces: vec![NodeLoad {
            node: bench.mesh.points_m().len() as u32 / 4,
            force_n: [0.0, 0.01, -0.02],
        }],
        handles: handles.to_vec(),
        ..Loads::default()
    };
    let by_needle = by_needle.map(|(node, force_n)| NodeLoad { node, force_n });
    loads.forces.extend(by_needle);
    loads
}

/// Of displacements over the largest, and of handles' forces over theirs.
fn apart(found: &Equilibrium, wanted: &Equilibrium) -> [f64; 2] {
    let off = |a: &[[f64; 3]], b: &[[f64; 3]]| {
        assert_eq!(a.len(), b.len());
        let way = |(a, b): (&[f64; 3], &[f64; 3])| (Vector3::from(*a) - Vector3::from(*b)).norm();
        let largest = b
            .iter()
            .map(|b| Vector3::from(*b).norm())
            .fold(0.0, f64::max);
        a.iter().zip(b).map(way).fold(0.0, f64::max) / largest
    };
    [
        off(&found.displacement_m, &wanted.displacement_m),
        off(&found.handle_force_n, &wanted.handle_force_n),
    ]
}

#[test]
fn a_handle_beside_a_needle_holds_as_a_whole_solve_has_it() {
    let handles = [pull()];
    let mut bench = held(handles.to_vec(), Kind::Linear);
    let (mesh, fixed) = slabs();
    let tissue = LinearTissue::new(&mesh, MATERIAL, &fixed).expect("tissue");
    let mut forces = Vec::new();
    for pushed in [0, 1, 30, 30] {
        push(&mut bench, pushed);
        let found = bench.model.equilibrium(&bench.state).expect("a balance");
        let wanted = tissue.solve(&acting(&bench, &handles)).expect("a balance");
        let apart = apart(&found, &wanted);
        assert!(apart.iter().all(|off| *off < 1e-9), "{pushed}: {apart:?}");
        assert!(found.residual < 1e-9);
        forces.push(Vector3::from(found.handle_force_n[0]));
    }
    // The needle comes to the tissue later than in a step, and draws at it.
    assert!((forces[1] - forces[0]).norm() < 1e-12 * forces[0].norm());
    assert!((forces[2] - forces[0]).norm() > 1e-2 * forces[0].norm());
    let punctures = bench.step().needles()[0].punctures;
    assert!(punctures >= 2, "{punctures}");
}

#[test]
fn so_it_does_on_tissue_that_turns() {
    let handles = [pull()];
    let mut bench = held(handles.to_vec(), Kind::Corotational(EXACT));
    let (mesh, fixed) = slabs();
    let tissue = CorotationalTissue::new(&mesh, MATERIAL, &fixed, Policy::default());
    let tissue = tissue.expect("tissue");
    let before = bench.model.equilibrium(&bench.state).expect("a balance");
    push(&mut bench, 1);
    let after = bench.model.equilibrium(&bench.state).expect("a balance");
    // The first step does not jump.
    let jump = apart(&after, &before);
    assert!(jump.iter().all(|off| *off < 1e-8), "{jump:?}");
    for pushed in [30, 30] {
        push(&mut bench, pushed);
        for _ in 0..5 {
            assert_eq!(bench.step().status, Status::Ok);
        }
        let found = bench.model.equilibrium(&bench.state).expect("a balance");
        let wanted = tissue.solve(&acting(&bench, &handles)).expect("a balance");
        let apart = apart(&found, &wanted);
        assert!(apart.iter().all(|off| *off < 1e-6), "{pushed}: {apart:?}");
    }
}

/// Two handles at the far corner of the other slab, one of them where it is without.
#[test]
fn a_handle_far_away_leaves_the_needle_as_it_is() {
    let far = || {
        let points = slabs().0.points_m().to_vec();
        let corner =
            |x: &[f64; 3]| (x[0] + 0.0107).abs() + (x[1] + 0.015).abs() + (x[2] + 0.008).abs();
        let nodes = 0..points.len() as u32;
        let near = |a: &u32, b: &u32| {
            corner(&points[*a as usize]).total_cmp(&corner(&points[*b as usize]))
        };
        Handle {
            anchor: Anchor {
                vertices: vec![nodes.min_by(near).expect("a node")],
                weights: vec![1.0],
            },
            target_displacement_m: [0.0, 0.0, 2e-5],
        }
    };
    for kind in [|| Kind::Linear, || Kind::Corotational(EXACT)] {
        let [with, without] = [vec![far()], vec![]].map(|handles| {
            let mut bench = held(handles, kind());
            push(&mut bench, 50);
            let needle = bench.step().needles()[0];
            assert!(needle.punctures > 0);
            needle.axial_n
        });
        assert!(without < -0.01, "{without}");
        assert!((with / without - 1.0).abs() < 0.02, "{with} {without}");
    }
}

#[test]
fn no_step_with_a_handle_allocates() {
    for kind in [Kind::Linear, Kind::Corotational(EXACT)] {
        let mut bench = held(vec![pull()], kind);
        push(&mut bench, 40);
        // Again, with all columns there.
        let samples: Vec<_> = (0..30)
            .map(|_| {
                let along = bench.grip.rotation * Vector3::x();
                bench.grip.translation.vector += along * 1e-4;
                bench.sample()
            })
            .collect();
        // Every pass of a step asks for the columns of its whole way.
        let all = StepOptions::with_vertices(1000);
        let mut run = |state: &mut State| {
            samples.iter().all(|sample| {
                let report = step(&bench.model, state, &[*sample], &all, &mut bench.work);
                report.status == Status::Ok
            })
        };
        let mut warm = bench.state.clone();
        assert!(run(&mut warm));
        let mut done = false;
        let allocated = allocation_counter::measure(|| done = run(&mut bench.state));
        assert!(done);
        assert_eq!(allocated.count_total, 0, "{allocated:?}");
    }
}
