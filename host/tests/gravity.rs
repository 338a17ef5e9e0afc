//! The weight of tissue: how far it sags, what carries it, and what tools feel of tissue that sags.

use nalgebra::{Rotation3, Vector3};
use std::fmt::Write;
use std::path::Path;
use sutura_host::fem::Equilibrium;
use sutura_host::mesh::TetMesh;
use sutura_host::model::Model;
use sutura_host::scene::{Document, Pose, Registered, Scene, SceneError, read};
use sutura_host::script::at_rest;
use sutura_host::session::{Rendering, SceneSolver};
use sutura_host::solve::solve;
use sutura_host::step::{State, Status, StepOptions, StepReport, Workspace, step};
use tempfile::TempDir;

const DOWN: [f64; 3] = [0.0, 0.0, -9.81];
/// Tissues with a balance of forces, followed closely.
const WITH_ROWS: [&str; 3] = [
    "model = \"linear\"",
    "model = \"corotational\"\ncorotational = { refactor_every = 1, passes = 50, tolerance = 1e-11 }",
    "model = \"hyperelastic\"",
];
const SOFT: &str = "youngs_modulus_pa = 20e3\npoisson_ratio = 0.4\ndensity_kg_per_m3 = 1000.0";
const BALL: &str = "[[tool]]\nradius_m = 0.012\n";

fn read_in(folder: &Path, text: &str) -> Result<Scene, SceneError> {
    read(&Document::embedded("test.toml", folder, text))
}

fn scene(text: &str) -> Scene {
    read_in("".as_ref(), text).expect("good")
}

/// A bar along x under its own weight, held at its lower end.
fn bar(size_m: [f64; 3], divisions: [usize; 3], tissue: &str) -> String {
    format!(
        "gravity_m_per_s2 = {DOWN:?}\n[mesh.slab]\nsize_m = {size_m:?}\ndivisions = {divisions:?}\n\
         [[fixed]]\nplane = {{ axis = \"x\", at_m = {} }}\n[tissue]\n{tissue}\n",
        -0.5 * size_m[0]
    )
}

/// One of 40 x 15 x 15 mm.
fn short_bar(tissue: &str) -> String {
    bar([0.04, 0.015, 0.015], [8, 3, 3], tissue)
}

/// How it rests, and what nodes get from outside.
fn rest(scene: &Scene) -> Equilibrium {
    let (model, state, _) = scene.build().expect("a balance");
    model.equilibrium(&state).expect("finite")
}

/// Mean drop of the free end of a bar along x \[m\].
fn drop_m(scene: &Scene) -> f64 {
    let points = scene.mesh.points_m();
    let far = points.iter().map(|x| x[0]).fold(f64::MIN, f64::max);
    let rest = rest(scene);
    let nodes = points.iter().zip(&rest.displacement_m);
    let drops: Vec<f64> = nodes
        .filter(|(x, _)| (x[0] - far).abs() < 1e-9)
        .map(|(_, u)| -u[2])
        .collect();
    drops.iter().sum::<f64>() / drops.len() as f64
}

/// Force of all that is fixed on the tissue \[N\], (3): what its nodes get from outside but for weight and loads.
fn reaction_n(scene: &Scene, rest: &Equilibrium) -> Vector3<f64> {
    let fixed = scene.fixed.iter();
    let all: Vector3<f64> = fixed
        .map(|node| Vector3::from(rest.node_force_n[*node as usize]))
        .sum();
    let loads = scene.acting().forces.into_iter();
    let on_fixed = loads.filter(|load| scene.fixed.binary_search(&load.node).is_ok());
    all - on_fixed
        .map(|load| Vector3::from(load.force_n))
        .sum::<Vector3<f64>>()
}

/// A bar of 60 x 4 x 15 mm. What is left of the finest of three meshes to what they converge to (Richardson, error of the square of
/// the edge), and that itself against Timoshenko's beam, w L^4 / 8 E I + w L^2 / 2 (5/6) G A, which is exact for it to a percent.
#[test]
fn a_cantilever_sags_as_far_as_a_refined_one() {
    let (length, width, height, modulus, density) = (0.06f64, 0.004, 0.015f64, 200e3, 1000.0);
    let tissue = format!(
        "youngs_modulus_pa = {modulus}\npoisson_ratio = 0.0\ndensity_kg_per_m3 = {density}"
    );
    // Nothing varies across its width.
    let drop = |n: usize| {
        drop_m(&scene(&bar(
            [length, width, height],
            [4 * n, 1, n],
            &tissue,
        )))
    };
    let [coarse, middle, fine] = [6, 12, 24].map(drop);
    let refined = fine + (fine - middle) / 3.0;
    let before = middle + (middle - coarse) / 3.0;
    assert!((before / refined - 1.0).abs() < 5e-3, "{before} {refined}");
    let load = density * 9.81 * width * height;
    let bends = load * length.powi(4) / (8.0 * modulus * width * height.powi(3) / 12.0);
    let shears = load * length.powi(2) / (2.0 * 5.0 / 6.0 * 0.5 * modulus * width * height);
    let beam = bends + shears;
    assert!((refined / beam - 1.0).abs() < 0.01, "{refined} {beam}");
    assert!((fine / refined - 1.0).abs() < 0.01, "{fine} {refined}");
}

/// Of two materials that lie one on the other, on every tissue with a balance of forces.
#[test]
fn what_is_fixed_carries_the_weight() {
    for model in WITH_ROWS {
        let text = short_bar(&format!("{SOFT}\n{model}"))
            + "[[region]]\nbox = { min_m = [-1.0, -1.0, -0.005], max_m = [1.0, 1.0, 1.0] }\n\
               youngs_modulus_pa = 10e3\npoisson_ratio = 0.3\ndensity_kg_per_m3 = 900.0\n";
        let scene = scene(&text);
        let (upper, lower) = (0.04 * 0.015 * 0.005 * 900.0, 0.04 * 0.015 * 0.01 * 1000.0);
        let weight = Vector3::from(DOWN) * (upper + lower);
        assert!((scene.weight_n() / weight.norm() - 1.0).abs() < 1e-12);
        let rest = rest(&scene);
        let off = (reaction_n(&scene, &rest) + weight).norm() / weight.norm();
        assert!(off < 1e-9, "{model}: {off}");
        assert!(rest.residual < 1e-9, "{model}: {}", rest.residual);
        let sag = rest.displacement_m.iter().map(|u| -u[2]);
        assert!(sag.fold(0.0, f64::max) > 1e-3, "{model}");
    }
}

/// Held at both ends, by two of them: each carries its half of a bar whose mesh is the same seen from either end, and what a
/// third holds that the first has already is the first's.
#[test]
fn each_that_is_fixed_says_what_it_carries() {
    for model in WITH_ROWS {
        let text = bar([0.04, 0.01, 0.01], [8, 2, 2], &format!("{SOFT}\n{model}"))
            + "[[fixed]]\nplane = { axis = \"x\", at_m = 0.02 }\n\
               [[fixed]]\nbox = { min_m = [-1.0, -1.0, -1.0], max_m = [-0.014, 1.0, 1.0] }\n\
               [[load]]\non = { plane = { axis = \"x\", at_m = 0.02 } }\ntotal_force_n = [0.0, 0.0, -3.0]\n";
        let scene = scene(&text);
        let solution = solve(&scene).expect("a rest");
        let weight_n = scene.weight_n();
        // What acts on fixed nodes is carried as well, and the tissue does not feel it.
        let [x, y, z] = solution.fixed_force_n;
        let off = (z / (weight_n + 3.0) - 1.0)
            .abs()
            .max(x.hypot(y) / weight_n);
        assert!(off < 1e-9, "{model}: {off}");
        let each = &solution.fixed_reactions;
        let nodes: Vec<usize> = each.iter().map(|own| own.nodes).collect();
        assert_eq!(nodes, [9, 9, 9], "{model}");
        let sum = |axis: usize| each.iter().map(|own| own.force_n[axis]).sum::<f64>();
        assert_eq!([0, 1, 2].map(sum), solution.fixed_force_n, "{model}");
        assert!(
            each[1].force_n[2] > 3.0 && each[2].force_n[2] > 0.2 * weight_n,
            "{model}: {each:?}"
        );
    }
}

/// A mesh in gmsh's format, to the bit.
fn written(mesh: &TetMesh, turned: impl Fn(Vector3<f64>) -> Vector3<f64>) -> String {
    let mut text = "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n".to_owned();
    let points = mesh.points_m();
    let _ = writeln!(text, "{}", points.len());
    for (number, point) in (1..).zip(points) {
        let at = turned(Vector3::from(*point));
        let _ = writeln!(text, "{number} {:?} {:?} {:?}", at.x, at.y, at.z);
    }
    let _ = writeln!(text, "$EndNodes\n$Elements\n{}", mesh.cells().len());
    for (number, cell) in (1..).zip(mesh.cells()) {
        let [a, b, c, d] = cell.map(|node| node + 1);
        let _ = writeln!(text, "{number} 4 0 {a} {b} {c} {d}");
    }
    text + "$EndElements\n"
}

/// The scene of a mesh file, turned and shifted with its gravity.
fn turned_scene(
    folder: &Path,
    plain: &Scene,
    model: &str,
    turn: &Rotation3<f64>,
    by: Vector3<f64>,
) -> Scene {
    std::fs::write(
        folder.join("a.msh"),
        written(&plain.mesh, |x| turn * x + by),
    )
    .expect("written");
    let gravity: [f64; 3] = (turn * Vector3::from(DOWN)).into();
    let text = format!(
        "gravity_m_per_s2 = {gravity:?}\n[mesh]\nfile = \"a.msh\"\nscale_to_m = 1.0\n[[fixed]]\nnodes = {:?}\n[tissue]\n{SOFT}\n{model}\n",
        plain.fixed
    );
    read_in(folder, &text).expect("good")
}

#[test]
fn a_turned_and_shifted_scene_sags_the_same() {
    let folder = TempDir::new().expect("a folder");
    let turn = Rotation3::from_euler_angles(0.7, -1.1, 2.3);
    let far = Vector3::new(0.3, -0.2, 0.1);
    for model in WITH_ROWS {
        let plain = scene(&short_bar(&format!("{SOFT}\n{model}")));
        let straight = rest(&plain);
        let size = straight
            .displacement_m
            .iter()
            .map(|u| Vector3::from(*u).norm())
            .fold(0.0, f64::max);
        for (turn, by) in [(turn, Vector3::zeros()), (Rotation3::identity(), far)] {
            let other = rest(&turned_scene(folder.path(), &plain, model, &turn, by));
            let pairs = straight.displacement_m.iter().zip(&other.displacement_m);
            let off = pairs
                .map(|(a, b)| (turn * Vector3::from(*a) - Vector3::from(*b)).norm())
                .fold(0.0, f64::max);
            assert!(off < 1e-9 * size, "{model}: {}", off / size);
        }
    }
}

/// A scene that is stepped by its tool 0.
struct Bench {
    model: Model,
    state: State,
    work: Workspace,
}

impl Bench {
    fn new(scene: &Scene) -> Self {
        let (model, state, work) = scene.build().expect("a balance");
        Bench { model, state, work }
    }

    fn step(&mut self, at: [f64; 3]) -> StepReport {
        let pose = Pose {
            position_m: at,
            orientation: [0.0, 0.0, 0.0, 1.0],
        };
        let (sample, options) = (at_rest(0, &pose), StepOptions::default());
        step(
            &self.model,
            &mut self.state,
            &[sample],
            &options,
            &mut self.work,
        )
    }

    /// Steps until the tool is there and the tissue in balance.
    fn to(&mut self, at: [f64; 3]) -> StepReport {
        let mut still = 0;
        for _ in 0..2000 {
            let report = self.step(at);
            match report.status {
                Status::Ok if report.imbalance < 1e-9 => still += 1,
                Status::Ok | Status::Behind | Status::Waiting => still = 0,
                other => panic!("{other:?} at {at:?}"),
            }
            if still > 2 {
                return report;
            }
        }
        panic!("no balance at {at:?}");
    }
}

/// On the free end of a bar that sags: nothing until it touches, the slope of the energy after that, and with the fixed end's the
/// force of all of the tissue is its weight.
#[test]
fn a_tool_feels_what_sags_where_it_is() {
    for model in WITH_ROWS {
        let scene = scene(&(short_bar(&format!("{SOFT}\n{model}")) + BALL));
        let mut bench = Bench::new(&scene);
        // Its radius above the unloaded top, which has sagged.
        let above = bench.to([0.018, 0.0, 0.012]);
        let apart = above.contacts()[0];
        assert_eq!((apart.wrench, apart.rows), ([0.0; 6], 0), "{model}");
        let sag = bench.model.sag_m();
        assert!(
            apart.gap_m > 0.4 * sag && apart.gap_m <= sag,
            "{model}: {} {sag}",
            apart.gap_m
        );
        let (at, h) = (0.012 - sag - 1.5e-3, 2e-5);
        let felt = [at - h, at, at + h].map(|z| bench.to([0.018, 0.0, z]));
        let slope = (felt[2].stored_energy_j - felt[0].stored_energy_j) / (2.0 * h);
        let middle = felt[1].contacts()[0].wrench[2];
        assert!(middle > 1e-3, "{model}: {middle}");
        assert!(
            (slope / -middle - 1.0).abs() < 1e-3,
            "{model}: {slope} {middle}"
        );
        let rest = bench.model.equilibrium(&bench.state).expect("finite");
        assert!(rest.residual < 1e-7, "{model}: {}", rest.residual);
        let last = felt[2].contacts()[0].wrench;
        let on_tissue = -Vector3::new(last[0], last[1], last[2]);
        let weight = Vector3::from(DOWN) / 9.81 * scene.weight_n();
        let left = reaction_n(&scene, &rest) + on_tissue + weight;
        assert!(left.norm() < 1e-7 * weight.norm(), "{model}: {left}");
    }
}

/// Gravity of zero, and densities without it, change no bit.
#[test]
fn without_gravity_nothing_changes() {
    for model in WITH_ROWS {
        let weighs = short_bar(&format!("{SOFT}\n{model}")) + BALL;
        let none = weighs.replace(&format!("gravity_m_per_s2 = {DOWN:?}\n"), "");
        let zero = weighs.replace(&format!("{DOWN:?}"), "[0.0, 0.0, 0.0]");
        let pressed = |text: &str| {
            let mut bench = Bench::new(&scene(text));
            for step in 0..20 {
                bench.step([0.018, 0.0, 0.013 - 2e-4 * f64::from(step)]);
            }
            bench.state.hash()
        };
        let plain = pressed(&none);
        assert_eq!(plain, pressed(&zero), "{model}");
        assert_ne!(plain, pressed(&weighs), "{model}");
    }
}

/// From the mesh, or at rest: in the end the same.
#[test]
fn tissue_that_does_not_begin_settled_comes_to_the_same_rest() {
    for model in ["model = \"corotational\"", "model = \"hyperelastic\""] {
        let text = short_bar(&format!("{SOFT}\n{model}")) + BALL;
        let farthest = |solver: &SceneSolver, from: &[[f64; 3]]| {
            let at = solver.positions_m();
            let pairs = at.iter().zip(from);
            let ways = pairs.map(|(a, b)| (Vector3::from(*a) - Vector3::from(*b)).norm());
            ways.fold(0.0, f64::max)
        };
        let settled = SceneSolver::new(&scene(&text)).expect("a rest");
        let rest = settled.positions_m().into_owned();
        let begun = scene(&format!("settle = false\n{text}"));
        let said: Vec<String> = begun.warnings.iter().map(ToString::to_string).collect();
        assert!(
            said.iter().all(|words| !words.contains("at rest")),
            "{said:?}"
        );
        let mut falls = SceneSolver::new(&begun).expect("a mesh");
        assert_eq!(farthest(&falls, begun.mesh.points_m()), 0.0, "{model}");
        let sag = farthest(&settled, begun.mesh.points_m());
        let far = Pose {
            position_m: [0.0, 0.0, 0.1],
            orientation: [0.0, 0.0, 0.0, 1.0],
        };
        for _ in 0..200 {
            assert_eq!(falls.step(at_rest(0, &far)).status, Status::Ok);
        }
        let off = farthest(&falls, &rest);
        assert!(off < 1e-3 * sag, "{model}: {off} of {sag}");
        // A solve without a console is at rest whatever the session begins with.
        let plain = solve(&scene(&text)).expect("a rest");
        let same = solve(&begun).expect("a rest");
        assert_eq!(plain.drawn.displacement_m, same.drawn.displacement_m);
    }
}

/// Models to which tools stick begin settled, or from the mesh.
#[test]
fn models_without_rows_sag_too() {
    let stiff = SOFT.replace("20e3", "60e3");
    let reference = drop_m(&scene(&short_bar(&format!(
        "{stiff}\nmodel = \"corotational\""
    ))));
    for (model, most) in [
        ("energy-balance-neo-hookean", 0.1),
        ("energy-balance-stvk", 0.1),
        ("shape-matching", 20.0),
        ("chainmail-classical", 20.0),
        ("chainmail-ellipsoid", 20.0),
    ] {
        let of = |more: &str| {
            let text = format!(
                "{more}{}{BALL}",
                short_bar(&format!("{stiff}\nmodel = \"{model}\""))
            );
            let scene = scene(&text);
            let registered = Registered::new(model, None).expect("there");
            let solver = SceneSolver::sticking(&scene, registered, Rendering::Hold, 200.0);
            let solver = solver.expect("a rest");
            let at = solver.positions_m();
            let points = scene.mesh.points_m().iter().zip(at.iter());
            let end = points.filter(|(x, _)| x[0] > 0.0199);
            let drops: Vec<f64> = end.map(|(x, at)| x[2] - at[2]).collect();
            drops.iter().sum::<f64>() / drops.len() as f64
        };
        let sag = of("");
        assert!(
            (sag / reference - 1.0).abs() < most && sag > 0.0,
            "{model}: {sag} {reference}"
        );
        assert_eq!(of("settle = false\n"), 0.0, "{model}");
    }
}

/// What cannot bear its weight is told with how far it would sag, against its size; the sag of a small displacement is the inverse of
/// the modulus.
#[test]
fn tissue_that_collapses_is_told_its_sag_and_its_size() {
    let of = |modulus: &str, model: &str| {
        let soft = SOFT.replace("20e3", modulus);
        scene(&short_bar(&format!("{soft}\n{model}")))
    };
    let sag_mm = 1e3 * of("20e3", WITH_ROWS[0]).build().expect("linear").0.sag_m();
    for model in &WITH_ROWS[1..] {
        let told = of("20.0", model)
            .build()
            .err()
            .expect("a jelly")
            .to_string();
        assert!(
            told.contains("no balance under its weight of 0.088 N"),
            "{told}"
        );
        let sag = format!("it would sag by {:.1} mm", 1e3 * sag_mm);
        assert!(told.contains(&sag), "{told}, {sag}");
        assert!(told.contains("it is 40.0 mm in size"), "{told}");
    }
}

/// A slab held at two of its sides, that sags between them, and a straight needle above its middle in the console's grip.
const PIERCED: &str = r#"
gravity_m_per_s2 = [0.0, 0.0, -9.81]
device = "cartesian-bench"
[mesh.slab]
size_m = [0.04, 0.02, 0.006]
divisions = [12, 6, 2]
[tissue]
youngs_modulus_pa = 40e3
poisson_ratio = 0.4
density_kg_per_m3 = 1000.0
MODEL
[tissue.needle]
friction_n_per_m = 10.0
cutting_pa = 5e4
puncture_pa = 2e5
[[fixed]]
plane = { axis = "x", at_m = -0.02 }
[[fixed]]
plane = { axis = "x", at_m = 0.02 }
[[tool]]
id = 0
shape = "grip"
[[needle]]
shape = "straight"
length_m = 0.03
thickness_m = 0.0008
end_m = [0.0007, 0.0004, 0.035]
direction = [0.0, 0.0, -1.0]
[[needle.hold]]
time_s = 0.0
tool = 0
"#;

/// What a needle meets on its way down: where it first feels anything, the largest force against it before it has broken in, where
/// its tip was one after the other, and faces crossed in the end.
struct Way {
    touches_m: f64,
    threshold_n: f64,
    tips: Vec<String>,
    punctures: u32,
    crossings: Vec<u32>,
}

fn pierce(text: &str) -> Way {
    let mut solver = SceneSolver::new(&scene(text)).expect("a rest");
    let mut way = Way {
        touches_m: f64::NAN,
        threshold_n: 0.0,
        tips: Vec::new(),
        punctures: 0,
        crossings: Vec::new(),
    };
    let down = (0..600).map(|step| 0.035 - 4e-5 * f64::from(step));
    for z in down {
        let pose = Pose {
            position_m: [0.0007, 0.0004, z],
            orientation: [0.0, 0.0, 0.0, 1.0],
        };
        let mut report = solver.step(at_rest(0, &pose));
        while matches!(report.status, Status::Behind | Status::Waiting) {
            report = solver.step(at_rest(0, &pose));
        }
        assert_eq!(report.status, Status::Ok, "{z}");
        let needle = report.needles()[0];
        let tip = format!("{:?}", needle.tip);
        if way.tips.last() != Some(&tip) {
            way.tips.push(tip);
        }
        if way.crossings.last() != Some(&needle.crossings) {
            way.crossings.push(needle.crossings);
        }
        if way.touches_m.is_nan() {
            match needle.axial_n == 0.0 {
                true => assert_eq!(report.contacts()[0].wrench, [0.0; 6], "{z}"),
                false => way.touches_m = z - 0.03,
            }
        }
        if needle.punctures == 0 {
            way.threshold_n = way.threshold_n.max(-needle.axial_n);
        }
        way.punctures = needle.punctures;
    }
    way
}

/// It feels nothing before it is where the slab hangs, breaks in at the same force as without weight, and goes through the same.
#[test]
fn a_needle_goes_through_tissue_that_sags() {
    for model in ["model = \"linear\"", "model = \"corotational\""] {
        let text = PIERCED.replace("MODEL", model);
        let sag_m = Bench::new(&scene(&text)).model.sag_m();
        let hangs = pierce(&text);
        let plain = pierce(&text.replace("-9.81", "0.0"));
        assert!(sag_m > 3e-4, "{sag_m}");
        // At its middle, whose top sags as far as any node but for a hair.
        assert!(
            (hangs.touches_m + sag_m).abs() < 0.1 * sag_m + 4e-5,
            "{model}: {} {sag_m}",
            hangs.touches_m
        );
        assert!(plain.touches_m.abs() < 1e-4, "{model}: {}", plain.touches_m);
        let ratio = hangs.threshold_n / plain.threshold_n;
        assert!(
            plain.threshold_n > 0.05 && (ratio - 1.0).abs() < 0.05,
            "{model}: {ratio} of {}",
            plain.threshold_n
        );
        assert_eq!(
            (&hangs.tips, hangs.punctures),
            (&plain.tips, plain.punctures),
            "{model}"
        );
        assert_eq!(
            hangs.tips,
            ["Outside", "Holding", "Inside", "Holding", "Outside"],
            "{model}"
        );
        assert_eq!(hangs.crossings.last(), plain.crossings.last(), "{model}");
    }
}

/// Jaws that lift a slab carry, with what is fixed, its weight; before they close there is nothing to feel.
#[test]
fn jaws_hold_tissue_with_its_weight() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenes/jaws-lift.toml");
    let text = std::fs::read_to_string(path).expect("readable");
    let text = text
        .replace("divisions = [16, 12, 5]", "divisions = [12, 9, 4]")
        .replace("[tissue]", "[tissue]\ndensity_kg_per_m3 = 1060.0");
    let text = format!("gravity_m_per_s2 = {DOWN:?}\n{text}");
    let at = |time_s: f64| {
        let mut scene = scene(&text);
        scene.solve_at_s = Some(time_s);
        let solution = solve(&scene).expect("a rest");
        let force = |v: [f64; 3]| Vector3::from(v);
        let tools: Vector3<f64> = solution.tools.iter().map(|tool| force(tool.force_n)).sum();
        let weight = Vector3::from(DOWN) / 9.81 * scene.weight_n();
        let left = (force(solution.fixed_force_n) + tools + weight).norm() / weight.norm();
        assert!(left < 1e-6, "{time_s}: {left}");
        tools
    };
    assert_eq!(at(1.0), Vector3::zeros());
    let lifted = at(3.0);
    assert!(lifted.z > 0.1, "{lifted}");
}

/// Two slabs, one held above the other: the upper sags onto the lower, and what holds them carries both.
#[test]
fn tissue_that_sags_onto_other_tissue_lies_on_it() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenes/touching-slabs.toml");
    let text = std::fs::read_to_string(path).expect("readable");
    let cut = |text: &str, from: &str, to: &str| {
        let start = text.find(from).expect("there");
        let end = text[start..].find(to).map_or(text.len(), |end| start + end);
        text[..start].to_owned() + &text[end..]
    };
    let text = cut(&text, "# On the upper slab's top", "# The console's own");
    let text = text.replace("[tissue]", "[tissue]\ndensity_kg_per_m3 = 1000.0");
    let text = format!("gravity_m_per_s2 = {DOWN:?}\n{text}");
    let apart = cut(&text, "[[tissue_contact]]", "\u{0}");
    let of = |text: &str| {
        let scene = scene(text);
        let solution = solve(&scene).expect("a rest");
        let weight_n = scene.weight_n();
        let off = (solution.fixed_force_n[2] / weight_n - 1.0).abs();
        let table_n = solution.fixed_reactions[0].force_n[2];
        let points = solution
            .drawn
            .points_m
            .iter()
            .zip(&solution.drawn.displacement_m);
        let at = points.map(|(x, u)| (*x, x[2] + u[2]));
        // The least of the upper slab's underside near its middle, and the lower one's top there.
        let middle = at.filter(|(x, _)| x[0].abs() < 0.006 && x[1].abs() < 0.006);
        let (upper, lower): (Vec<_>, Vec<_>) = middle.partition(|(x, _)| x[2] > 1e-4);
        let under = upper.iter().map(|(_, z)| *z).fold(f64::MAX, f64::min);
        let top = lower.iter().map(|(_, z)| *z).fold(f64::MIN, f64::max);
        (off, table_n, under - top)
    };
    let lower_n = 9.81 * 1000.0 * 0.03 * 0.03 * 0.01;
    let (off, table_n, gap_m) = of(&apart);
    assert!(
        off < 1e-9 && (table_n / lower_n - 1.0).abs() < 1e-9,
        "{off} {table_n}"
    );
    assert!(gap_m < -2e-4, "goes through it: {gap_m}");
    let (off, table_n, gap_m) = of(&text);
    assert!(
        off < 1e-7 && table_n > 1.05 * lower_n,
        "{off} {table_n} {lower_n}"
    );
    assert!(gap_m > -5e-5, "{gap_m}");
}
