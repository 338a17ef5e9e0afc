//! Springs: against solves of the whole tissue under the forces that they report, on tissue of several kinds.

use nalgebra::Vector3;
use sutura_host::fem::{Loads, NodeLoad, Policy};
use sutura_host::model::{Model, Passes};
use sutura_host::scene::{Document, Scene};
use sutura_host::solve::solve;
use sutura_host::step::{State, StepOptions, step};

/// A block with a spring between two corners of its top, and one from a third to a fixed place.
fn block(tissue: &str) -> Scene {
    block_with(tissue, "")
}

/// The same with more in its scene.
fn block_with(tissue: &str, more: &str) -> Scene {
    let text = format!(
        "[mesh.slab]\nsize_m = [0.04, 0.03, 0.02]\ndivisions = [4, 3, 2]\n\
         [tissue]\nmodel = \"{tissue}\"\nyoungs_modulus_pa = 12e3\npoisson_ratio = 0.4\n\
         [[fixed]]\nplane = {{ axis = \"z\", at_m = -0.02 }}\n\
         [[spring]]\nfrom_m = [-0.01, 0.005, 0.0]\nto_m = [0.02, 0.015, 0.0]\n\
         stiffness_n_per_m = 20.0\nlength_m = 0.02\n\
         [[spring]]\nfrom_m = [-0.02, -0.015, 0.0]\nto_m = [-0.03, -0.01, 0.02]\nto_is_fixed = true\n\
         stiffness_n_per_m = 8.0\nlength_m = 0.012\n{more}"
    );
    let document = Document::embedded("block.toml", "".as_ref(), &text);
    Scene::read(&document, "block").expect("a good scene")
}

/// The node nearest to a place.
fn node(scene: &Scene, at: [f64; 3]) -> u32 {
    let far = |x: &[f64; 3]| (Vector3::from(*x) - Vector3::from(at)).norm();
    let nodes = (0u32..).zip(scene.mesh.points_m());
    let nearest = nodes.min_by(|a, b| far(a.1).total_cmp(&far(b.1)));
    nearest.expect("a node").0
}

/// Where the nodes are after some steps without any tool, and the springs' tensions \[N\] and lengths \[m\].
fn at_rest(scene: &Scene) -> (Vec<[f64; 3]>, Vec<[f64; 2]>) {
    let (model, mut state, mut work) = scene.build().expect("a good model");
    let options = StepOptions::with_vertices(usize::MAX);
    for _ in 0..40 {
        let report = step(&model, &mut state, &[], &options, &mut work);
        assert_eq!(report.status.name(), "ok");
    }
    let added = state.added(&model);
    let values = added.iter().map(|(_, values)| {
        let value = |key: &str| values.iter().find(|(name, _)| *name == key);
        ["tension_n", "length_m"].map(|key| value(key).expect("a value").1)
    });
    (state.positions(&model), values.collect())
}

/// The springs' forces on nodes, by the law of a spring and where these are; they must be what is reported.
fn forces(scene: &Scene, at_m: &[[f64; 3]], springs: &[[f64; 2]]) -> Loads {
    let [a, b, c] = [
        [-0.01, 0.005, 0.0],
        [0.02, 0.015, 0.0],
        [-0.02, -0.015, 0.0],
    ]
    .map(|at| node(scene, at));
    let at = |node: u32| Vector3::from(at_m[node as usize]);
    let ways = [at(b) - at(a), Vector3::new(-0.03, -0.01, 0.02) - at(c)];
    let law = [(20.0, 0.02), (8.0, 0.012)];
    let mut tensions = [0.0; 2];
    for (place, (way, (stiffness, rest_m))) in ways.iter().zip(law).enumerate() {
        let [tension_n, length_m] = springs[place];
        assert!((way.norm() - length_m).abs() < 1e-7 * length_m);
        tensions[place] = stiffness * (way.norm() - rest_m);
        assert!((tensions[place] - tension_n).abs() < 1e-6 * tension_n);
    }
    let pull = |spring: usize| ways[spring].normalize() * tensions[spring];
    let forces = [(a, pull(0)), (b, -pull(0)), (c, pull(1))];
    let forces = forces.map(|(node, force)| NodeLoad {
        node,
        force_n: force.into(),
    });
    Loads {
        forces: forces.to_vec(),
        ..Loads::default()
    }
}

fn assert_at(scene: &Scene, found_m: &[[f64; 3]], at_m: &[[f64; 3]], exact: f64) {
    let far = |a: &[f64; 3], b: &[f64; 3]| (Vector3::from(*a) - Vector3::from(*b)).norm();
    let most = |a: &[[f64; 3]], b: &[[f64; 3]]| {
        a.iter()
            .zip(b)
            .fold(0.0f64, |most, (a, b)| most.max(far(a, b)))
    };
    let moved_m = most(at_m, scene.mesh.points_m());
    let error_m = most(at_m, found_m);
    assert!(
        moved_m > 1e-4 && error_m < exact * moved_m,
        "{error_m} of {moved_m} m"
    );
}

#[test]
fn tissue_is_where_the_springs_tensions_as_loads_have_it() {
    let scene = block("linear");
    let (at_m, springs) = at_rest(&scene);
    let loads = forces(&scene, &at_m, &springs);
    let model = Model::new(
        &scene.mesh,
        scene.materials.clone(),
        &scene.fixed,
        loads,
        &[],
    );
    let model = model.expect("tissue");
    assert_at(&scene, &State::new(&model).positions(&model), &at_m, 1e-8);
}

#[test]
fn tissue_that_turns_is_where_the_springs_tensions_as_loads_have_it() {
    let scene = block("corotational");
    let (at_m, springs) = at_rest(&scene);
    let loads = forces(&scene, &at_m, &springs);
    let (mesh, fixed, materials) = (&scene.mesh, &scene.fixed, scene.materials.clone());
    let (policy, passes) = (Policy::default(), Passes::default());
    let model = Model::corotational(mesh, materials, fixed, loads, &[], policy, passes);
    let model = model.expect("tissue");
    assert_at(&scene, &State::new(&model).positions(&model), &at_m, 1e-6);
}

/// Solves without a console have springs, a tool somewhere or none: to the bit the same, and what steps come to.
#[test]
fn solves_have_springs_with_a_far_tool_and_without() {
    let far = "[[tool]]\nradius_m = 0.01\nposition_m = [0.0, 0.0, 0.3]\n";
    for tissue in ["linear", "corotational", "hyperelastic"] {
        let [without, with] =
            ["", far].map(|more| solve(&block_with(tissue, more)).expect("a rest"));
        assert_eq!(
            without.drawn.displacement_m, with.drawn.displacement_m,
            "{tissue}"
        );
        assert_eq!(without.fixed_force_n, with.fixed_force_n, "{tissue}");
        let scene = block(tissue);
        let (by_steps, _) = at_rest(&scene);
        let ways = without
            .drawn
            .displacement_m
            .iter()
            .zip(scene.mesh.points_m());
        let solved: Vec<[f64; 3]> = ways
            .map(|(u, x)| [x[0] + u[0], x[1] + u[1], x[2] + u[2]])
            .collect();
        assert_at(&scene, &solved, &by_steps, 1e-6);
        let moved = without.drawn.displacement_m.iter().flatten();
        assert!(
            moved.fold(0.0f64, |most, u| most.max(u.abs())) > 1e-4,
            "{tissue}"
        );
    }
}
