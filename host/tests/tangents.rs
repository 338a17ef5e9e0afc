//! Contact Jacobians in every shipped scene, where tools, needles, threads, springs and tissues that touch act at once:
//! against perturbed whole steps.

use nalgebra::{Matrix6, Quaternion, UnitQuaternion, Vector3, Vector6};
use sutura_host::model::Model;
use sutura_host::scene::{Document, Scene};
use sutura_host::script::Script;
use sutura_host::step::{State, Status, StepOptions, StepReport, Workspace, step};
use sutura_host::tool::ToolSample;

/// Rotations count as the way of a point so far from the grip \[m\].
const ARM_M: f64 = 0.01;
/// By so much a tool is moved \[m\]. Slides along an arc are solved to 5e-10, which may be 2.5e-3 of that.
const MOVED_M: f64 = 2e-7;
/// What is softer than this is not felt \[N/m\].
const LEAST_N_PER_M: f64 = 1.0;
/// A hand at rest leaves what has slipped at its limit: forward and backward differ by more than this part.
const KINK: f64 = 3e-4;

/// Columns of all vertices that a step needs.
const ALL: StepOptions = StepOptions::with_vertices(usize::MAX);

/// What a scene may be off by, beyond what its steps say themselves.
struct Case {
    name: &'static str,
    /// Part of the tangent.
    exact: f64,
    /// Of spans of threads that are held across by tensions too slight for rows of their own \[N/m\].
    spans_n_per_m: f64,
    /// Tangents to compare at least.
    least: u32,
}

fn scene(name: &str) -> Scene {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenes");
    let document = Document::read(&folder.join(format!("{name}.toml"))).expect("a file");
    Scene::read(&document, name).expect("a good scene")
}

/// A sample with its grip moved, and turned about it.
fn moved(sample: &ToolSample, by: &Vector6<f64>) -> ToolSample {
    let [x, y, z, w] = sample.orientation;
    let (shift, turn) = (by.fixed_rows::<3>(0), by.fixed_rows::<3>(3));
    let turn = UnitQuaternion::from_scaled_axis(turn / ARM_M);
    let turned = turn * UnitQuaternion::new_unchecked(Quaternion::new(w, x, y, z));
    ToolSample {
        position_m: (Vector3::from(sample.position_m) + shift).into(),
        orientation: turned.coords.into(),
        ..*sample
    }
}

/// The tangent of a step's `tool`th sample, and that of perturbed steps forward and backward \[N/m\].
fn tangents(
    model: &Model,
    start: &State,
    samples: &[ToolSample],
    tool: usize,
    work: &mut Workspace,
) -> Option<[Matrix6<f64>; 3]> {
    let unit = |axis: usize| if axis < 3 { 1.0 } else { 1.0 / ARM_M };
    let scale = Matrix6::from_diagonal(&Vector6::from_fn(|axis, _| unit(axis)));
    let mut solve = |by: &Vector6<f64>| {
        let mut samples = samples.to_vec();
        samples[tool] = moved(&samples[tool], by);
        let report = step(model, &mut start.clone(), &samples, &ALL, work);
        (report.status == Status::Ok).then(|| report.contacts()[tool])
    };
    let here = solve(&Vector6::zeros())?;
    let wrench = Vector6::from(here.wrench);
    let found = scale * Matrix6::from_fn(|i, j| here.tangent[i][j]) * scale;
    let [mut forward, mut backward] = [Matrix6::zeros(); 2];
    for axis in 0..6 {
        for (sign, column) in [(1.0, &mut forward), (-1.0, &mut backward)] {
            let there = solve(&Vector6::ith(axis, sign * MOVED_M))?;
            let change = Vector6::from(there.wrench) - wrench;
            column.set_column(axis, &(scale * change * (sign / MOVED_M)));
        }
    }
    Some([found, forward, backward])
}

/// Whether a step touches what the one before did: where a vertex sticks that has just been met depends on the pose.
fn is_same(report: &StepReport, last: &StepReport) -> bool {
    report.rows == last.rows
}

fn check(case: &Case) {
    let scene = scene(case.name);
    let (model, mut state, mut work) = scene.build().expect("a model");
    let mut script = Script::new(&scene);
    let (mut compared, mut kinks, mut worst) = (0, 0, 0.0f64);
    let mut last = StepReport::default();
    for number in 0..(scene.seconds * scene.host.host_hz) as u64 {
        let time_s = number as f64 / scene.host.host_hz;
        let samples = script.follow(time_s, &model, &mut state).to_vec();
        let start = state.clone();
        let report = step(&model, &mut state, &samples, &ALL, &mut work);
        let is_same = is_same(&report, &last);
        last = report;
        if number % 29 != 5 || report.status != Status::Ok || !is_same {
            continue;
        }
        for tool in 0..samples.len() {
            let Some([found, forward, backward]) =
                tangents(&model, &start, &samples, tool, &mut work)
            else {
                continue;
            };
            let expected = (forward + backward) * 0.5;
            let size = expected.norm();
            if size < LEAST_N_PER_M {
                continue;
            }
            if (forward - backward).norm() > KINK * size {
                kinks += 1;
                continue;
            }
            compared += 1;
            let off = (found - expected).norm() / size;
            let may = case.exact.max(report.tangent_error) + case.spans_n_per_m / size;
            worst = worst.max(off / may);
            assert!(
                off <= may,
                "{} at {time_s:.3} s, tool {tool}: off by {off:.1e} of {size:.3e} N/m, not {may:.1e}\n{found:.3}{expected:.3}",
                case.name
            );
        }
    }
    println!(
        "{}: {compared} tangents compared, {kinks} at a limit, worst {worst:.2} of what it may be",
        case.name
    );
    assert!(compared >= case.least, "{} {compared}", case.name);
}

/// Alone: a ball that presses, one that rubs, two tools.
#[test]
fn of_tools() {
    for (name, least) in [("palpation", 5), ("drag", 5), ("two-tools", 5)] {
        check(&Case {
            name,
            exact: 1e-5,
            spans_n_per_m: 0.0,
            least,
        });
    }
}

/// A straight needle and an arc, whose slides are solved within a tolerance.
#[test]
fn of_needles() {
    for (name, exact) in [
        ("needle-slabs", 1e-5),
        ("needle-arc", 2.5e-3),
        ("needle-hyperelastic", 1e-5),
    ] {
        check(&Case {
            name,
            exact,
            spans_n_per_m: 0.0,
            least: 5,
        });
    }
}

/// Punches that rub beside a needle; a spring beside a tool; jaws.
#[test]
fn of_pairs() {
    // The slab's tool sticks to it now and then only.
    for (name, least) in [("needle-held-slab", 5), ("tied-slab", 2), ("jaws-lift", 5)] {
        check(&Case {
            name,
            exact: 1e-5,
            spans_n_per_m: 0.0,
            least,
        });
    }
}

/// A thread beside a ball that rubs, and one that pulls together tissues that touch.
#[test]
fn of_threads() {
    for name in ["suture-and-probe", "wound-slabs"] {
        check(&Case {
            name,
            exact: 1e-5,
            spans_n_per_m: 0.2,
            least: 5,
        });
    }
}
