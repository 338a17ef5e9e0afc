//! Good scenes read as they are written; every kind of slip is told at its place, with a way out.

use super::*;
use crate::fem::Material;
use crate::mesh::SurfaceFormat;
use miette::Diagnostic;
use nalgebra::Vector3;
use std::sync::Arc;

const GOOD: &str = r#"
name = "good"
seconds = 2.5
device = "cartesian-bench"

[mesh.slab]
size_m = [0.08, 0.06, 0.03]
divisions = [8, 6, 3]

[tissue]
youngs_modulus_pa = 15e3
poisson_ratio = 0.45

[[fixed]]
plane = { axis = "z", at_m = -0.03 }

[[fixed]]
nodes = [0, 1]

[[tool]]
id = 3
radius_m = 0.05
offset_m = [0.0, 0.0, -0.01]
position_m = [0.0, 0.0, 0.04]

[[handle]]
name = "pull"
vertices = [250, 251]
barycentric = [0.25, 0.75]
target_displacement_m = [0.0, 0.0, 0.002]

[[load]]
on = { box = { min_m = [0.039, -1.0, -0.001], max_m = [1.0, 1.0, 1.0] } }
total_force_n = [0.7, 0.0, 0.0]

[hand]
stiffness_n_per_m = 800.0
damping_n_s_per_m = 8.0
way_point = [{ time_s = 0.0, position_m = [0.0, 0.01, 0.05] }, { time_s = 1.0, position_m = [0.0, 0.0, 0.0] }]

[host]
host_hz = 120.0
horizon_ms = 45.0
"#;

pub(super) fn read(text: &str) -> Result<Scene, SceneError> {
    Scene::read(
        &Document::embedded("scene.toml", Path::new("/nowhere"), text),
        "scene",
    )
}

#[test]
fn every_value_arrives_where_it_belongs() {
    let scene = read(GOOD).expect("the scene is good");
    assert_eq!(scene.name, "good");
    assert_eq!(scene.seconds, 2.5);
    let material = Material {
        youngs_modulus_pa: 15e3,
        poisson_ratio: 0.45,
    };
    assert_eq!(scene.materials, material.into());
    assert_eq!(scene.tissue, Tissue::Linear);
    assert_eq!(
        scene.host,
        HostSettings {
            host_hz: 120.0,
            horizon_us: Some(45_000)
        }
    );
    assert_eq!(scene.tools.len(), 1);
    assert_eq!(
        (scene.tools[0].id, scene.tools[0].shape.radius_m()),
        (3, 0.05)
    );
    assert_eq!(scene.tools[0].shape.offset_m, [0.0, 0.0, -0.01]);
    let pose = Pose {
        position_m: [0.0, 0.0, 0.04],
        orientation: [0.0, 0.0, 0.0, 1.0],
    };
    assert_eq!(scene.tools[0].pose, Some(pose));
    let handle = &scene.loads.handles[0];
    assert_eq!(handle.anchor.vertices, [250, 251]);
    assert_eq!(handle.anchor.weights, [0.25, 0.75]);
    assert_eq!(handle.target_displacement_m, [0.0, 0.0, 0.002]);
    assert_eq!(scene.handle_names, [Some("pull".to_owned())]);
    let hand = scene.hand.expect("the scene has a hand");
    assert_eq!((hand.count, hand.stiffness_n_per_m), (2, 800.0));
    // The bench console's origin is the world's.
    assert_eq!(hand.start_joint, [0.0, 0.01, 0.05]);
    assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
    // 9 x 7 nodes on the bottom; nodes 0 and 1 are there or add to them.
    assert!(
        (63..=65).contains(&scene.fixed.len()),
        "{}",
        scene.fixed.len()
    );
    // The rim x = 0.04 of the top: 7 nodes share the force.
    let forces = &scene.loads.forces;
    assert_eq!(forces.len(), 7);
    for load in forces {
        assert!((load.force_n[0] - 0.1).abs() < 1e-12);
        assert!((scene.mesh.points_m()[load.node as usize][0] - 0.04).abs() < 1e-12);
    }
}

#[test]
fn a_scene_needs_only_tissue_and_what_holds_it() {
    let least = "[mesh.slab]\nsize_m = [1.0, 1.0, 1.0]\ndivisions = [1, 1, 1]\n\
                 [tissue]\nyoungs_modulus_pa = 1.0\npoisson_ratio = 0.3\n\
                 [[fixed]]\nplane = { axis = \"x\", at_m = -0.5 }\n";
    let scene = read(least).expect("the least scene is good");
    assert_eq!(scene.name, "scene");
    assert!(scene.device.is_none() && scene.hand.is_none() && scene.tools.is_empty());
    assert_eq!(scene.fixed.len(), 4);
}

#[test]
fn a_flat_punch_arrives_with_its_own_choices_where_nothing_is_said() {
    use crate::tool::{self, Shape};
    let shape = |keys: &str| {
        let text = GOOD.replace(
            "radius_m = 0.05",
            &format!("shape = \"flat-punch\"\n{keys}"),
        );
        read(&text).expect("good").tools[0].shape.clone()
    };
    let said = "radius_m = 0.05\nfillet_m = 0.004\nlength_m = 0.02\naxis = [0.0, -2.0, 0.0]\n\
                friction = 0.3\nstatic_friction = 0.5";
    let expected = tool::Tool {
        shape: Shape::FlatPunch {
            radius_m: 0.05,
            fillet_m: 0.004,
            length_m: 0.02,
        },
        offset_m: [0.0, 0.0, -0.01],
        axis: [0.0, -1.0, 0.0],
        side: tool::Tool::DEFAULT_SIDE,
        friction: 0.3,
        static_friction: 0.5,
    };
    assert_eq!(shape(said), expected);
    let unsaid = tool::Tool::new(Shape::flat_punch(0.05, 0.2), [0.0, 0.0, -0.01]);
    assert_eq!(shape("radius_m = 0.05"), unsaid);
}

#[test]
fn capsules_and_boxes_arrive_as_they_are_said() {
    use crate::tool::{self, Shape};
    let read_tool = |keys: &str| {
        let text = GOOD.replace("radius_m = 0.05", keys);
        read(&text).expect("good").tools[0].shape.clone()
    };
    let new = |shape| tool::Tool::new(shape, [0.0, 0.0, -0.01]);
    let capsule = |length_m| Shape::Capsule {
        radius_m: 0.05,
        length_m,
    };
    let said = "shape = \"capsule\"\nradius_m = 0.05\n";
    assert_eq!(read_tool(said), new(capsule(0.2)));
    assert_eq!(
        read_tool(&format!("{said}length_m = 0.0")),
        new(capsule(0.0))
    );
    // One that lies: its side is not asked for.
    let lying = tool::Tool {
        axis: [1.0, 0.0, 0.0],
        ..new(capsule(0.2))
    };
    assert_eq!(read_tool(&format!("{said}axis = [3.0, 0.0, 0.0]")), lying);

    let said = "shape = \"rounded-box\"\nsize_m = [0.1, 0.2, 0.3]\n";
    assert_eq!(read_tool(said), new(Shape::rounded_box([0.1, 0.2, 0.3])));
    let turned = tool::Tool {
        axis: [0.0, 1.0, 0.0],
        side: [0.6, 0.0, 0.8],
        friction: 0.2,
        static_friction: 0.2,
        ..new(Shape::RoundedBox {
            size_m: [0.1, 0.2, 0.3],
            fillet_m: 0.05,
        })
    };
    // Only what of the side lies across the axis counts.
    let keys = "fillet_m = 0.05\naxis = [0.0, 2.0, 0.0]\nside = [3.0, -7.0, 4.0]\nfriction = 0.2";
    let found = read_tool(&format!("{said}{keys}"));
    let side = Vector3::from(found.side) - Vector3::from(turned.side);
    assert!(side.norm() < 1e-15);
    assert_eq!(
        tool::Tool {
            side: turned.side,
            ..found
        },
        turned
    );
}

/// From the scene's own files, with what is wrong in them told at their key.
#[test]
fn a_mesh_arrives_from_its_file() {
    use crate::scene::Sources;
    use crate::tool::{self, Shape};
    let file = include_bytes!("../../../tests/data/bracket.stl");
    let read = |file: &[u8], keys: &str| {
        let keys = format!("shape = \"mesh\"\nmesh = \"a.stl\"\nscale_to_m = 0.01\n{keys}");
        let document = Document::from_sources(&Sources {
            name: "scene.toml".to_owned(),
            text: GOOD.replace("radius_m = 0.05", &keys),
            files: [("a.stl".to_owned(), file.to_vec())].into(),
        });
        Scene::read(&document, "scene").map(|scene| scene.tools[0].shape.clone())
    };
    let mesh = tool::ClosedMesh::read(SurfaceFormat::Stl, file, 0.01).expect("closed");
    let (_, deep_m) = mesh.deepest_m();
    let unsaid = tool::Tool::new(Shape::mesh(mesh.clone()), [0.0, 0.0, -0.01]);
    let found = read(file, "").expect("good");
    assert_eq!(found, unsaid);
    assert_eq!(found.radius_m(), deep_m + 0.1 * deep_m);
    let said = tool::Tool {
        axis: [1.0, 0.0, 0.0],
        side: [0.0, 0.0, 1.0],
        ..tool::Tool::new(
            Shape::Mesh {
                mesh: Arc::new(mesh),
                fillet_m: 0.02,
            },
            [0.0, 0.0, -0.01],
        )
    };
    let keys = "fillet_m = 0.02\naxis = [2.0, 0.0, 0.0]\nside = [0.0, 0.0, 3.0]";
    assert_eq!(read(file, keys).expect("good"), said);
    for (file, keys, words) in [
        (
            &file[..700],
            "",
            "a.stl cannot be used: line 53: expected vertex",
        ),
        (b"solid a\nendsolid a\n", "", "it has no triangles"),
        (
            &file[..],
            "fillet_m = 0.0",
            "fillet_m = 0: must be positive",
        ),
        (&file[..], "length_m = 0.1", "a mesh has no `length_m`"),
        (
            &file[..],
            "axis = [1.0, 0.0, 0.0]",
            "what looks along x needs a side",
        ),
    ] {
        let error = read(file, keys).expect_err(words).to_string();
        assert!(error.contains(words), "{error}");
    }
}

#[test]
fn one_tool_is_driven_and_the_others_are_held() {
    let second = "[[tool]]\nid = 9\nradius_m = 0.05\n";
    let held = format!("{second}position_m = [0.0, 0.0, -0.08]\n");
    let scene = read(&format!("{GOOD}{held}")).expect("good");
    assert_eq!(scene.driven().map(|tool| tool.id), Some(3));
    assert_eq!(
        scene.held().map(|(tool, _)| tool.id).collect::<Vec<_>>(),
        [9]
    );
    assert!(scene.warnings.is_empty());

    let scene = read(&format!("{GOOD}{second}driven = true\n")).expect("good");
    assert_eq!(scene.driven().map(|tool| tool.id), Some(9));
    assert_eq!(
        scene.held().map(|(tool, _)| tool.id).collect::<Vec<_>>(),
        [3]
    );

    let scene = read(&format!("{GOOD}{second}")).expect("it only warns");
    assert!(scene.warnings[0].to_string().contains("neither driven"));
    assert_eq!(scene.held().count(), 0);
}

/// Boxes and tags decide by cell; the later section has a cell that both name.
#[test]
fn a_later_region_has_the_cells_that_two_share() {
    let region = |place: &str, youngs: f64| {
        format!("[[region]]\n{place}\nyoungs_modulus_pa = {youngs}\npoisson_ratio = 0.3\n")
    };
    let all = region("tag = 0", 1e3);
    // The two lower of three layers of 8 x 6 cubes, six cells each.
    let low = "box = { min_m = [-1.0, -1.0, -1.0], max_m = [1.0, 1.0, -0.01] }";
    let low = region(low, 2e3);
    let scene = read(&format!("{GOOD}{all}{low}")).expect("good");
    let cells: Vec<_> = scene
        .regions
        .iter()
        .map(|r| (r.name.as_str(), r.cells))
        .collect();
    assert_eq!(cells, [("0", 8 * 6 * 6), ("box", 2 * 8 * 6 * 6)]);
    assert_eq!(scene.regions[1].material.youngs_modulus_pa, 2e3);
    assert!(scene.warnings.is_empty());

    let scene = read(&format!("{GOOD}{low}{all}")).expect("good");
    assert_eq!(scene.regions[0].cells, 0);
    assert!(scene.warnings[0].to_string().contains("no cell is made of"));
}

/// Two layers under a pull without shrinking sideways (nu = 0, so that each layer is uniaxial): springs
/// in series, u = F/A (h1/E1 + h2/E2). Linear tetrahedra hold this piecewise linear field exactly.
#[test]
fn two_regions_are_springs_in_series() {
    let text = "\
[mesh.slab]
size_m = [0.04, 0.02, 0.03]
divisions = [4, 2, 3]

[tissue]
youngs_modulus_pa = 5e3
poisson_ratio = 0.0

[[region]]
box = { min_m = [-1.0, -1.0, -0.01], max_m = [1.0, 1.0, 0.0] }
youngs_modulus_pa = 40e3
poisson_ratio = 0.0

[[fixed]]
plane = { axis = \"z\", at_m = -0.03 }
";
    let scene = read(text).expect("good");
    let (model, _, _) = scene.build().expect("held");
    // A uniform pull on the top: each triangle's third to each of its corners.
    let (traction_pa, mut forces) = (30.0, Vec::new());
    let surface = model.surface();
    let points = model.points_m();
    for triangle in &surface.triangles {
        let [a, b, c] = triangle.map(|node| Vector3::from(points[node as usize]));
        if [a, b, c].iter().all(|x| x.z.abs() < 1e-12) {
            let third = (b - a).cross(&(c - a)).norm() / 6.0 * traction_pa;
            let share = |node| crate::fem::NodeLoad {
                node,
                force_n: [0.0, 0.0, third],
            };
            forces.extend(triangle.map(share));
        }
    }
    let loads = Loads {
        forces,
        ..Loads::default()
    };
    let tissue = crate::fem::LinearTissue::new(&scene.mesh, scene.materials.clone(), &scene.fixed);
    let u = tissue
        .expect("held")
        .solve(&loads)
        .expect("held")
        .displacement_m;
    let closed_form_m = traction_pa * (0.02 / 5e3 + 0.01 / 40e3);
    for (x, u) in points.iter().zip(&u).filter(|(x, _)| x[2].abs() < 1e-12) {
        assert!((u[2] / closed_form_m - 1.0).abs() < 1e-10, "{x:?}: {u:?}");
    }
}

#[test]
fn corotational_settings_arrive_at_their_solver() {
    let text = GOOD.replace(
        "poisson_ratio = 0.45",
        "poisson_ratio = 0.45\nmodel = \"corotational\"\n[tissue.corotational]\n\
         refactor_rotation_deg = 6.0\nrefactor_every = 20\ncg_iterations = 3\npasses = 4\ntolerance = 1e-4",
    );
    let scene = read(&text).expect("good");
    let settings = Corotational {
        refactor_rotation_deg: Some(6.0),
        refactor_every: Some(20),
        cg_iterations: Some(3),
        passes: Some(4),
        tolerance: Some(1e-4),
    };
    assert_eq!(scene.tissue, Tissue::Corotational(settings));
    assert_eq!(scene.tissue.word(), "corotational");
    let policy = settings.policy();
    assert!((policy.refactor_rotation_rad - 6f64.to_radians()).abs() < 1e-15);
    assert_eq!((policy.refactor_every, policy.cg_iterations), (19, 3));
    let passes = settings.passes();
    assert_eq!((passes.most, passes.tolerance), (4, 1e-4));
    assert!(scene.build().is_ok(), "a handle and a tool");
}

#[test]
fn a_small_tool_says_its_error_at_its_radius() {
    let scene = read(&GOOD.replace("radius_m = 0.05", "radius_m = 0.01")).expect("it only warns");
    let [warning] = scene.warnings.as_slice() else {
        panic!("{:?}", scene.warnings)
    };
    assert_eq!(warning.severity(), Some(miette::Severity::Warning));
    assert!(warning.to_string().contains("measured error"), "{warning}");
    assert!(scene.notes.is_empty(), "{:?}", scene.notes);
    assert_eq!(&underlined(warning, "0.01"), "0.01");
}

/// Sizes that were not measured have no measured error.
#[test]
fn below_half_an_edge_nothing_was_measured() {
    for radius in ["0.0", "0.005"] {
        let text = GOOD.replace("radius_m = 0.05", &format!("radius_m = {radius}"));
        let scene = read(&text).expect("it only warns");
        let said = scene.warnings[0].to_string();
        assert!(
            said.contains("nobody has measured") && !said.contains('%'),
            "{said}"
        );
        assert!(said.contains("counts as one of 11.4 mm"), "{said}");
    }
    // Just above, it is said as it was measured.
    let edge_m = read(GOOD).expect("good").mesh.surface().mean_edge_m;
    let radius = format!("radius_m = {}", 0.5 * edge_m * (1.0 + 1e-12));
    let scene = read(&GOOD.replace("radius_m = 0.05", &radius)).expect("it only warns");
    let said = scene.warnings[0].to_string();
    assert!(said.contains("measured error of 2840 %"), "{said}");
}

/// A block with edges of a centimetre beside a slab with edges of a millimetre, which the hand presses: of a ball of 5 mm the edges
/// matter that it meets, and that it counts as one of the mean edge of all.
#[test]
fn edges_are_those_near_the_path() {
    let parts = "[[mesh.part]]\nslab = { size_m = [0.02, 0.02, 0.006], divisions = [20, 20, 4] }\n\
                 [[mesh.part]]\nslab = { size_m = [0.2, 0.2, 0.05], divisions = [20, 20, 5] }\nat_m = [0.0, 0.5, 0.0]\n";
    let graded = |radius: &str, at: &str| {
        let text = format!(
            "device = \"cartesian-bench\"\n{parts}[tissue]\nyoungs_modulus_pa = 15e3\npoisson_ratio = 0.45\n\
             [[fixed]]\nplane = {{ axis = \"z\", at_m = -0.006 }}\n[[fixed]]\nplane = {{ axis = \"z\", at_m = -0.05 }}\n\
             [[tool]]\nradius_m = {radius}\n[hand]\nstiffness_n_per_m = 800.0\ndamping_n_s_per_m = 8.0\n\
             way_point = [{{ time_s = 0.0, position_m = [{at}, 0.03] }}, {{ time_s = 1.0, position_m = [{at}, 0.008] }}]\n"
        );
        let scene = read(&text).expect("it only warns");
        let said = scene.warnings.iter().chain(&scene.notes);
        let said: Vec<String> = said.map(ToString::to_string).collect();
        (said.join("\n"), scene.mesh.surface().mean_edge_m)
    };
    let (said, mean_m) = graded("0.012", "0.0, 0.0");
    assert!(mean_m > 0.004, "{mean_m}");
    assert!(said.is_empty(), "{said}");
    let (said, _) = graded("0.005", "0.0, 0.0");
    assert!(
        said.contains("a tool of 5.0 mm radius counts as one of"),
        "{said}"
    );
    assert!(said.contains("edges have 1."), "{said}");
    // The same ball where edges have a centimetre.
    let (said, _) = graded("0.012", "0.0, 0.5");
    assert!(said.contains("on edges of 11.4 mm"), "{said}");
}

#[test]
fn below_four_edges_the_error_is_a_note() {
    let good = read(GOOD).expect("a scene");
    let edge_m = good.mesh.surface().mean_edge_m;
    let of = |edges: f64| {
        let radius = format!("radius_m = {}", edges * edge_m);
        read(&GOOD.replace("radius_m = 0.05", &radius)).expect("a scene")
    };
    let scene = of(3.5);
    let [note] = scene.notes.as_slice() else {
        panic!("{:?}", scene.notes)
    };
    assert_eq!(note.severity(), Some(miette::Severity::Advice));
    assert!(note.to_string().contains("measured error of 3 %"), "{note}");
    assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
    assert!(of(4.01).notes.is_empty());
}

/// The text that a complaint's span covers in `GOOD` after one edit.
fn underlined(flaw: &Flaw, edited: &str) -> String {
    let source = flaw.source_code().expect("a flaw has its source");
    let text = source
        .read_span(&flaw.span(), 0, 0)
        .expect("the span is inside");
    let text = String::from_utf8(text.data().to_vec()).expect("the source is text");
    assert!(!text.is_empty(), "nothing is underlined for {edited}");
    text
}

/// One slip, made by an edit of the good scene, and what has to be said about it.
pub(super) struct Slip {
    pub from: &'static str,
    pub to: &'static str,
    pub message: &'static str,
    pub under: &'static str,
    pub help: &'static str,
}

const SLIPS: &[Slip] = &[
    Slip {
        from: "youngs_modulus_pa",
        to: "yungs_modulus_pa",
        message: "unknown key `yungs_modulus_pa`",
        under: "yungs_modulus_pa",
        help: "did you mean `youngs_modulus_pa`?",
    },
    Slip {
        from: "radius_m = 0.05",
        to: "radius_mm = 50.0",
        message: "unknown key `radius_mm`",
        under: "radius_mm",
        help: "did you mean `radius_m`?",
    },
    Slip {
        from: "[host]",
        to: "[hosst]",
        message: "unknown key `hosst`",
        under: "hosst",
        help: "did you mean `host`?",
    },
    Slip {
        from: "poisson_ratio = 0.45",
        to: "model = \"liner\"\npoisson_ratio = 0.45",
        message: "unknown value `liner`",
        under: "\"liner\"",
        help: "did you mean `linear`?",
    },
    Slip {
        from: "poisson_ratio = 0.45",
        to: "",
        message: "missing key `poisson_ratio`",
        under: "[tissue]",
        help: "add `poisson_ratio = ...`",
    },
    Slip {
        from: "[[fixed]]",
        to: "[[region]]\ntag = 7\nyoungs_modulus_pa = 1.0\npoisson_ratio = 0.3\n[[fixed]]",
        message: "the mesh has no region 7",
        under: "7",
        help: "gives its cells no regions",
    },
    Slip {
        from: "[[fixed]]",
        to: "[[region]]\ntag = 0.5\nyoungs_modulus_pa = 1.0\npoisson_ratio = 0.3\n[[fixed]]",
        message: "expected the number or the name of a region",
        under: "0.5",
        help: "",
    },
    Slip {
        from: "[[fixed]]",
        to: "[[region]]\nyoungs_modulus_pa = 1.0\npoisson_ratio = 0.3\n[[fixed]]",
        message: "a region says one thing",
        under: "[[region]]",
        help: "either `tag`",
    },
    Slip {
        from: "[[fixed]]",
        to: "[[region]]\nbox = { min_m = [1.0, 1.0, 1.0], max_m = [2.0, 2.0, 2.0] }\nyoungs_modulus_pa = 1.0\npoisson_ratio = 0.3\n[[fixed]]",
        message: "this region holds no cell",
        under: "{ min_m = [1.0, 1.0, 1.0], max_m = [2.0, 2.0, 2.0] }",
        help: "centroid",
    },
    Slip {
        from: "[[fixed]]",
        to: "[[region]]\ntag = 0\nyoungs_modulus_pa = 0.0\npoisson_ratio = 0.3\n[[fixed]]",
        message: "youngs_modulus_pa = 0: must be positive",
        under: "0.0",
        help: "soft tissue has",
    },
    Slip {
        from: "[[fixed]]",
        to: "[tissue.corotational]\nrefactor_every = 5\n[[fixed]]",
        message: "settings for a model that this tissue does not have",
        under: "[tissue.corotational]",
        help: "add `model = \"corotational\"`",
    },
    Slip {
        from: "poisson_ratio = 0.45",
        to: "poisson_ratio = 0.45\nmodel = \"corotational\"\ncorotational = { refactor_rotation_deg = 120.0 }",
        message: "refactor_rotation_deg = 120: must be more than 0 and at most 90",
        under: "120.0",
        help: "costs more factorisations",
    },
    Slip {
        from: "poisson_ratio = 0.45",
        to: "poisson_ratio = 0.45\nmodel = \"corotational\"\ncorotational = { refactor_every = 0 }",
        message: "refactor_every = 0: must be 1 or more",
        under: "0",
        help: "every step",
    },
    Slip {
        from: "radius_m = 0.05",
        to: "radius_m = 0.05\nfillet_m = 0.01",
        message: "a sphere has no `fillet_m`",
        under: "0.01",
        help: "add a shape that has it: `shape = \"flat-punch\"`, `shape = \"rounded-box\"`",
    },
    Slip {
        from: "radius_m = 0.05",
        to: "shape = \"capsule\"\nradius_m = 0.05\nside = [1.0, 0.0, 0.0]",
        message: "a capsule has no `side`",
        under: "[1.0, 0.0, 0.0]",
        help: "`shape = \"rounded-box\"`",
    },
    Slip {
        from: "radius_m = 0.05",
        to: "shape = \"capsule\"\nlength_m = 0.05",
        message: "missing key `radius_m`",
        under: "[[tool]]",
        help: "`shape = \"grip\"`",
    },
    Slip {
        from: "radius_m = 0.05",
        to: "shape = \"capsule\"\nradius_m = 0.05\nlength_m = -0.01",
        message: "length_m = -0.01: must be zero or positive",
        under: "-0.01",
        help: "from centre to centre",
    },
    Slip {
        from: "radius_m = 0.05",
        to: "shape = \"rounded-box\"\nradius_m = 0.05",
        message: "a rounded box has no `radius_m`",
        under: "0.05",
        help: "`shape = \"capsule\"`",
    },
    Slip {
        from: "radius_m = 0.05",
        to: "shape = \"rounded-box\"",
        message: "missing key `size_m`",
        under: "[[tool]]",
        help: "add `size_m = ...`",
    },
    Slip {
        from: "radius_m = 0.05",
        to: "shape = \"rounded-box\"\nsize_m = [0.1, 0.0, 0.1]",
        message: "size_m: a box that is 0 m wide",
        under: "[0.1, 0.0, 0.1]",
        help: "from face to face",
    },
    Slip {
        from: "radius_m = 0.05",
        to: "shape = \"rounded-box\"\nsize_m = [0.1, 0.2, 0.3]\nfillet_m = 0.06",
        message: "fillet_m = 0.06: must be more than 0 and at most half of each size",
        under: "0.06",
        help: "rounded by this",
    },
    Slip {
        from: "radius_m = 0.05",
        to: "shape = \"rounded-box\"\nsize_m = [0.1, 0.2, 0.3]\nside = [0.0, 0.0, 3.0]",
        message: "side: no direction across the axis",
        under: "[0.0, 0.0, 3.0]",
        help: "add `side = ",
    },
    Slip {
        from: "radius_m = 0.05",
        to: "shape = \"rounded-box\"\nsize_m = [0.1, 0.2, 0.3]\naxis = [-2.0, 0.0, 0.0]",
        message: "what looks along x needs a side",
        under: "[-2.0, 0.0, 0.0]",
        help: "add `side = [0.0, 1.0, 0.0]`",
    },
    Slip {
        from: "radius_m = 0.05",
        to: "shape = \"flat-puch\"\nradius_m = 0.05",
        message: "unknown value `flat-puch`",
        under: "\"flat-puch\"",
        help: "did you mean `flat-punch`?",
    },
    Slip {
        from: "radius_m = 0.05",
        to: "shape = \"flat-punch\"\nradius_m = 0.0",
        message: "radius_m = 0: must be positive",
        under: "0.0",
        help: "",
    },
    Slip {
        from: "radius_m = 0.05",
        to: "shape = \"flat-punch\"\nradius_m = 0.05\nfillet_m = 0.06",
        message: "fillet_m = 0.06: must be more than 0 and at most the radius",
        under: "0.06",
        help: "rounded",
    },
    Slip {
        from: "radius_m = 0.05",
        to: "shape = \"flat-punch\"\nradius_m = 0.05\nlength_m = 0.009",
        message: "length_m = 0.009: must be at least two fillets",
        under: "0.009",
        help: "both ends",
    },
    Slip {
        from: "radius_m = 0.05",
        to: "shape = \"flat-punch\"\nradius_m = 0.05\naxis = [0.0, 0.0, 0.0]",
        message: "axis: a direction without length",
        under: "[0.0, 0.0, 0.0]",
        help: "down is",
    },
    Slip {
        from: "radius_m = 0.05",
        to: "shape = \"mesh\"\nscale_to_m = 0.001",
        message: "missing key `mesh`",
        under: "[[tool]]",
        help: "add `mesh = ...`",
    },
    Slip {
        from: "radius_m = 0.05",
        to: "shape = \"mesh\"\nmesh = \"a.stl\"",
        message: "missing key `scale_to_m`",
        under: "[[tool]]",
        help: "add `scale_to_m = ...`",
    },
    Slip {
        from: "radius_m = 0.05",
        to: "shape = \"mesh\"\nmesh = \"a.stl\"\nscale_to_m = 0.0",
        message: "scale_to_m = 0: must be positive",
        under: "0.0",
        help: "0.001 for a mesh in millimetres",
    },
    Slip {
        from: "radius_m = 0.05",
        to: "shape = \"mesh\"\nmesh = \"a.stl\"\nscale_to_m = 0.001",
        message: "cannot read the mesh /nowhere/a.stl",
        under: "\"a.stl\"",
        help: "relative to the scene file",
    },
    Slip {
        from: "[[handle]]",
        to: "[[tool]]\nid = 4\nradius_m = 0.05\ndriven = true\n[[tool]]\nradius_m = 0.05\ndriven = true\n[[handle]]",
        message: "two tools are driven",
        under: "true",
        help: "hold the others",
    },
    Slip {
        from: "id = 3",
        to: "id = 3\ndriven = false",
        message: "no tool is driven",
        under: "false",
        help: "leave `driven` out",
    },
    Slip {
        from: "way_point = [{",
        to: "way_point = [] # {",
        message: "0 way points: a hand has 1 to 12",
        under: "[]",
        help: "the last point is held",
    },
    Slip {
        from: "seconds = 2.5",
        to: "seconds = \"2.5\"",
        message: "a number is needed here, not the text \"2.5\"",
        under: "\"2.5\"",
        help: "",
    },
    Slip {
        from: "youngs_modulus_pa = 15e3",
        to: "youngs_modulus_pa = -15e3",
        message: "youngs_modulus_pa = -15000: must be positive",
        under: "-15e3",
        help: "soft tissue has",
    },
    Slip {
        from: "youngs_modulus_pa = 15e3",
        to: "youngs_modulus_pa = nan",
        message: "youngs_modulus_pa = NaN: must be positive",
        under: "nan",
        help: "soft tissue has",
    },
    Slip {
        from: "poisson_ratio = 0.45",
        to: "poisson_ratio = 0.5",
        message: "poisson_ratio = 0.5: must be more than -1 and less than 0.5",
        under: "0.5",
        help: "incompressible",
    },
    Slip {
        from: "device = \"cartesian-bench\"",
        to: "device = \"cartesian-bensch\"",
        message: "unknown device `cartesian-bensch`",
        under: "\"cartesian-bensch\"",
        help: "did you mean `cartesian-bench`?",
    },
    Slip {
        from: "device = \"cartesian-bench\"",
        to: "device = \"mine.toml\"",
        message: "there is no device file /nowhere/mine.toml",
        under: "\"mine.toml\"",
        help: "relative to the scene file",
    },
    Slip {
        from: "device = \"cartesian-bench\"",
        to: "",
        message: "a hand needs a device to hold",
        under: "[hand]",
        help: "add `device",
    },
    Slip {
        from: "[mesh.slab]",
        to: "[mesh]\nfile = \"no.msh\"\nscale_to_m = 1.0\n[mesh.slab]",
        message: "the mesh comes from one place",
        under: "[mesh]",
        help: "either `file",
    },
    Slip {
        from: "divisions = [8, 6, 3]",
        to: "divisions = [8, 0, 3]",
        message: "divisions: must be 1 or more",
        under: "[8, 0, 3]",
        help: "a slab of",
    },
    Slip {
        from: "at_m = -0.03",
        to: "at_m = -0.3",
        message: "this selection holds no node",
        under: "[[fixed]]",
        help: "z -0.030000..0.000000",
    },
    Slip {
        from: "nodes = [0, 1]",
        to: "nodes = [0, 252]",
        message: "node 252 is not in the mesh",
        under: "[0, 252]",
        help: "counted from 0",
    },
    Slip {
        from: "[[handle]]",
        to: "[[spring]]\nfrom_m = [10.0, 0.0, 0.0]\nto_m = [0.0, 0.0, 0.0]\nstiffness_n_per_m = 10.0\n[[handle]]",
        message: "`from_m` is 9.9600 m from the nearest node, and the mesh's longest edge has 0.0173 m",
        under: "[[spring]]",
        help: "",
    },
    Slip {
        from: "vertices = [250, 251]",
        to: "vertices = []",
        message: "a handle without vertices",
        under: "[]",
        help: "name the 1 to 4 nodes",
    },
    Slip {
        from: "barycentric = [0.25, 0.75]",
        to: "barycentric = [0.25, 0.8]",
        message: "barycentric coordinates must be 0 or more and sum to 1, not 1.05",
        under: "[0.25, 0.8]",
        help: "weigh the vertices",
    },
    Slip {
        from: "vertices = [250, 251]",
        to: "vertices = [0, 1]",
        message: "a handle on fixed nodes cannot move",
        under: "[0, 1]",
        help: "take a handle elsewhere",
    },
    Slip {
        from: "position_m = [0.0, 0.0, 0.04]",
        to: "position_m = [0.0, inf, 0.04]",
        message: "position_m: every entry must be a finite number",
        under: "[0.0, inf, 0.04]",
        help: "no places",
    },
    Slip {
        from: "position_m = [0.0, 0.0, 0.04]",
        to: "position_m = [0.0, 0.0, 0.04]\norientation = [0.0, 0.0, 0.0, 2.0]",
        message: "orientation: a quaternion of length 2.0000",
        under: "[0.0, 0.0, 0.0, 2.0]",
        help: "unit quaternion",
    },
    Slip {
        from: "time_s = 0.0",
        to: "time_s = 1.5",
        message: "time_s = 1: must be at least 1.5",
        under: "1.0",
        help: "do not go back",
    },
    Slip {
        from: "stiffness_n_per_m = 800.0",
        to: "stiffness_n_per_m = 800000.0",
        message: "stiffness_n_per_m = 800000: must be from 0 to 100000",
        under: "800000.0",
        help: "200 to 2000 N/m",
    },
    Slip {
        from: "damping_n_s_per_m = 8.0",
        to: "damping_n_s_per_m = 80000.0",
        message: "damping_n_s_per_m = 80000: must be from 0 to 10000",
        under: "80000.0",
        help: "2 to 40 N s/m",
    },
    Slip {
        from: "host_hz = 120.0",
        to: "host_hz = 12000.0",
        message: "host_hz = 12000: must be from 1 to 1000",
        under: "12000.0",
        help: "1000 Hz",
    },
    Slip {
        from: "horizon_ms = 45.0",
        to: "horizon_ms = 450.0",
        message: "horizon_ms = 450: must be more than 0 and at most 150",
        under: "450.0",
        help: "caps it",
    },
];

/// Values that are allowed but unlikely, by an edit of the good scene: the warning and its place.
const DOUBTS: &[Slip] = &[
    Slip {
        from: "youngs_modulus_pa = 15e3",
        to: "youngs_modulus_pa = 15.0",
        message: "youngs_modulus_pa = 15: softer than 100 Pa",
        under: "15.0",
        help: "times 1000 it is 15 kPa",
    },
    Slip {
        from: "youngs_modulus_pa = 15e3",
        to: "youngs_modulus_pa = 0.015",
        message: "youngs_modulus_pa = 0.015: softer than 100 Pa",
        under: "0.015",
        help: "times 1000000 it is 15 kPa",
    },
    Slip {
        from: "offset_m = [0.0, 0.0, -0.01]",
        to: "offset_m = [0.0, 0.0, -30.0]",
        message: "`offset_m`: a way of 30.0 m, larger than 2.0 m",
        under: "[0.0, 0.0, -30.0]",
        help: "times 0.001 it is 30.0 mm",
    },
    Slip {
        from: "position_m = [0.0, 0.0, 0.04]",
        to: "position_m = [0.0, 0.0, 40.0]",
        message: "`position_m`: 40.0 m from the tissue, farther than 2.0 m",
        under: "[0.0, 0.0, 40.0]",
        help: "times 0.001 it is (0, 0, 0.04) m",
    },
    Slip {
        from: "target_displacement_m = [0.0, 0.0, 0.002]",
        to: "target_displacement_m = [0.0, 0.0, 2.0]",
        message: "`target_displacement_m`: 2.0 m, farther than the body is large, 80.0 mm",
        under: "[0.0, 0.0, 2.0]",
        help: "times 0.001 it is 2.0 mm",
    },
    Slip {
        from: "position_m = [0.0, 0.01, 0.05]",
        to: "position_m = [1.0, 0.01, 0.05]",
        message: "this way point takes joint 0 of cartesian-bench to 1.000 m, and its travel is -0.11 to 0.11 m",
        under: "[1.0, 0.01, 0.05]",
        help: "times 0.001 it is within",
    },
    Slip {
        from: "time_s = 1.0, position_m = [0.0, 0.0, 0.0]",
        to: "time_s = 0.01, position_m = [0.0, 0.0, 0.0]",
        message: "the hand goes at up to 9.56 m/s on its 51.0 mm to this way point, and cartesian-bench is in a fault above 1.5 m/s",
        under: "[0.0, 0.0, 0.0]",
        help: "give it 0.06 s instead of 0.01 s",
    },
    Slip {
        from: "time_s = 1.0, position_m = [0.0, 0.0, 0.0]",
        to: "time_s = 0.0, position_m = [0.0, 0.0, 0.0]",
        message: "the hand jumps on its 51.0 mm to this way point",
        under: "[0.0, 0.0, 0.0]",
        help: "give it 0.06 s instead of 0.00 s",
    },
    Slip {
        from: "radius_m = 0.05\noffset_m = [0.0, 0.0, -0.01]",
        to: "shape = \"rounded-box\"\nsize_m = [0.06, 5.0, 0.06]",
        message: "`size_m`: a length of 5.0 m, larger than 2.0 m",
        under: "[0.06, 5.0, 0.06]",
        help: "times 0.001 it is 5.0 mm",
    },
    Slip {
        from: "radius_m = 0.05\noffset_m = [0.0, 0.0, -0.01]",
        to: "shape = \"grip\"\nbody = { radius_m = 2.0, length_m = 0.06 }",
        message: "`radius_m`: a bar with a radius of 2.0 m, larger than 50.0 mm",
        under: "2.0",
        help: "times 0.001 it is 2.0 mm",
    },
    Slip {
        from: "radius_m = 0.05\noffset_m = [0.0, 0.0, -0.01]",
        to: "shape = \"grip\"\nbody = { radius_m = 2e-6, length_m = 0.06 }",
        message: "`radius_m`: a bar with a radius of 2.0 um, smaller than 50.0 um",
        under: "2e-6",
        help: "times 1000 it is 2.0 mm",
    },
    Slip {
        from: "radius_m = 0.05\noffset_m = [0.0, 0.0, -0.01]",
        to: "shape = \"grip\"\nbody = { radius_m = 0.002, length_m = 60.0, offset_m = [0.0, 30.0, 0.0] }",
        message: "`length_m`: a length of 60.0 m, larger than 2.0 m",
        under: "60.0",
        help: "times 0.001 it is 60.0 mm",
    },
    Slip {
        from: "size_m = [0.08, 0.06, 0.03]\ndivisions = [8, 6, 3]",
        to: "size_m = [0.08, 0.06, 0.03]\ndivisions = [1, 1, 300]",
        message: "1800 of 1800 cells are over a hundred times as wide as thick",
        under: "[0.08, 0.06, 0.03]",
        help: "take fewer `divisions` across what is thin",
    },
];

/// Whatever is doubtful of a scene is a warning at its place, and the good scene has none.
#[test]
fn what_cannot_be_meant_is_doubted_at_its_place() {
    assert!(read(GOOD).expect("good").warnings.is_empty());
    for doubt in DOUBTS {
        assert!(GOOD.contains(doubt.from), "{}", doubt.from);
        let text = GOOD.replacen(doubt.from, doubt.to, 1);
        let scene = read(&text).unwrap_or_else(|error| panic!("{}: {error}", doubt.to));
        let said: Vec<String> = scene.warnings.iter().map(ToString::to_string).collect();
        let found = scene
            .warnings
            .iter()
            .find(|flaw| flaw.to_string().contains(doubt.message));
        let Some(found) = found else {
            panic!("{}: {said:?}", doubt.to);
        };
        assert_eq!(found.severity(), Some(miette::Severity::Warning));
        assert_eq!(underlined(found, doubt.to), doubt.under, "{said:?}");
        let help = found
            .help()
            .map(|help| help.to_string())
            .unwrap_or_default();
        assert!(help.contains(doubt.help), "{}: {help}", doubt.to);
    }
}

/// 80 mm wide and 50 um thick: neither its size nor its cells can be meant.
#[test]
fn a_film_is_doubted() {
    let text = GOOD
        .replace(
            "size_m = [0.08, 0.06, 0.03]",
            "size_m = [0.08, 0.06, 50e-6]",
        )
        .replace("at_m = -0.03", "at_m = -50e-6")
        .replace("divisions = [8, 6, 3]", "divisions = [8, 6, 8]");
    let scene = read(&text.replace("nodes = [0, 1]", "nodes = [0]")).expect("it only warns");
    let said: Vec<String> = scene.warnings.iter().map(ToString::to_string).collect();
    for words in [
        "the body is 50.0 um thick, thinner than 100.0 um",
        "2304 of 2304 cells are over a hundred times as wide as thick",
    ] {
        assert!(said.iter().any(|said| said.contains(words)), "{said:?}");
    }
}

/// Reads the good scene with a device of its own, and its hand's first place by another one.
fn read_with(device: &str, begins: &str) -> Result<Scene, SceneError> {
    let document = Document::from_sources(&Sources {
        name: "scene.toml".to_owned(),
        text: GOOD
            .replace("\"cartesian-bench\"", "\"own.toml\"")
            .replace("position_m = [0.0, 0.01, 0.05]", begins),
        files: [("own.toml".to_owned(), device.into())].into(),
    });
    Scene::read(&document, "scene")
}

/// Motors that do not bear the weight at a way point are told of there, and those that just do are not.
#[test]
fn a_grip_that_its_motors_do_not_carry_is_told_of() {
    let [cartesian, arm] = BUILT_IN_DEVICES.map(|(_, text)| text);
    let warnings = |device: &str| {
        let scene = read_with(device, "position_m = [0.0, 0.01, 0.05]").expect("it only warns");
        let said = scene.warnings.iter().map(ToString::to_string);
        said.filter(|said| said.contains("the grip falls"))
            .collect::<Vec<_>>()
    };
    for (mass, is_carried) in [("1.52", true), ("1.54", false), ("309.0", false)] {
        let device = cartesian.replace(
            "carried_mass_kg = 0.25",
            &format!("carried_mass_kg = {mass}"),
        );
        assert_eq!(warnings(&device).is_empty(), is_carried, "{mass} kg");
    }
    let said = &warnings(&arm.replace("grip_mass_kg = 0.04", "grip_mass_kg = 5.6"))[0];
    assert!(
        said.contains("of joint 1, and its motor gives 0.90 N m"),
        "{said}"
    );
    assert!(warnings(arm).is_empty());
}

/// Every console refuses a hand that begins beyond 10 m of a joint's own origin, and so does the scene.
#[test]
fn a_hand_begins_where_a_console_can_be_told() {
    use sutura_shared::wire::Message;
    use sutura_shared::wire::message::Simulate;
    let device = BUILT_IN_DEVICES[0].1;
    let far = device.replace("origin_m = [0.0, 0.0, 0.0]", "origin_m = [8.0, 0.0, 0.0]");
    let read_at = |x: f64| read_with(&far, &format!("position_m = [{x:?}, 0.01, 0.05]"));
    let hand = read_at(-1.5).expect("it only warns").hand.expect("a hand");
    assert_eq!(Simulate::Hand(hand).check(), Ok(()));
    let error = read_at(-2.5).expect_err("10.5 m from the origin");
    assert!(
        error.to_string().contains("cannot reach this way point"),
        "{error}"
    );
}

/// Each slip in `good` is told as it should be.
#[track_caller]
pub(super) fn check_slips(good: &str, slips: &[Slip]) {
    let complaints: Vec<String> = slips
        .iter()
        .filter_map(|slip| complaint(good, slip))
        .collect();
    assert!(complaints.is_empty(), "{}", complaints.join("\n"));
}

/// What is wrong with what is said about a slip.
fn complaint(good: &str, slip: &Slip) -> Option<String> {
    let Slip {
        from,
        to,
        message,
        under,
        help,
    } = *slip;
    if !good.contains(from) {
        return Some(format!("the good scene has no {from}"));
    }
    let error = match read(&good.replacen(from, to, 1)) {
        Ok(_) => return Some(format!("accepted: {to}")),
        Err(SceneError::Flaw(flaw)) => flaw,
        Err(other) => return Some(format!("{to}: not a flaw at a place: {other}")),
    };
    let said = error.to_string();
    if !said.contains(message) {
        return Some(format!("{to}: {said}"));
    }
    let underlined = underlined(&error, to);
    if underlined != under {
        return Some(format!("{said}: {underlined} is underlined, not {under}"));
    }
    let way_out = error.help().map(|h| h.to_string()).unwrap_or_default();
    (!way_out.contains(help)).then(|| format!("{to}: {way_out}"))
}

#[test]
fn every_slip_is_told_at_its_place_with_a_way_out() {
    check_slips(GOOD, SLIPS);
}

/// An arm of twice 0.22 m, 0.30 m behind the origin, does not reach 0.5 m ahead of it.
#[test]
fn a_way_point_out_of_an_arms_reach_is_refused() {
    let arm = GOOD.replace("cartesian-bench", "serial-arm");
    read(&arm).expect("the arm reaches the good scene's path");
    let far = arm.replace(
        "position_m = [0.0, 0.01, 0.05]",
        "position_m = [0.5, 0.01, 0.05]",
    );
    let error = read(&far).expect_err("too far");
    assert_eq!(
        error.to_string(),
        "the grip cannot reach this way point (0.5, 0.01, 0.05) m: it is 0.803 m from the shoulder, and the arm reaches 0.000 m to 0.440 m"
    );
}

/// Cut off anywhere, a scene is read or refused at a place that is in it: no panic, no lost span.
#[test]
fn a_scene_cut_off_anywhere_is_told_at_a_place_in_it() {
    for end in (0..GOOD.len()).filter(|end| GOOD.is_char_boundary(*end)) {
        if let Err(SceneError::Flaw(flaw)) = read(&GOOD[..end]) {
            let span = flaw.span();
            assert!(
                span.offset() + span.len() <= end,
                "{flaw} at {span:?} of {end}"
            );
            let source = flaw.source_code().expect("a flaw has its source");
            assert!(
                source.read_span(&span, 1, 1).is_ok(),
                "{flaw} at {span:?} of {end}"
            );
        }
    }
}
