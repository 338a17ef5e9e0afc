//! A workspace is scratch: with a new one in every third step, all shipped scenes come to the same bits as with one that is kept;
//! `SUTURA_FULL=1`: in every step.

use sutura_host::scene::{Corotational, Document, Scene, Tissue};
use sutura_host::script::Script;
use sutura_host::step::{State, StepOptions, StepReport, Workspace, step};
use sutura_testkit::full;

/// A new workspace has to compute all columns that it needs.
const ALL: StepOptions = StepOptions::with_vertices(usize::MAX);

/// Steps of a scene, beginning at `from_s`, at `hz` steps a second.
struct Case {
    name: &'static str,
    corotational: bool,
    from_s: f64,
    steps: u32,
    hz: f64,
}

fn scene(case: &Case) -> Scene {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenes");
    let path = folder.join(format!("{}.toml", case.name));
    let document = Document::read(&path).expect("a file");
    let mut scene = Scene::read(&document, case.name).expect("a good scene");
    if case.corotational {
        scene.tissue = Tissue::Corotational(Corotational::default()).instead_of(scene.tissue);
    }
    scene
}

fn check(case: &Case) {
    let scene = scene(case);
    let (model, mut kept, mut work) = scene.build().expect("a model");
    let mut fresh = kept.clone();
    let mut scripts = [Script::new(&scene), Script::new(&scene)];
    let mut acted = 0;
    let first = (case.from_s * case.hz) as u32;
    let every = if full() { 1 } else { 3 };
    let mut anew = Workspace::new(&model);
    for number in 0..first + case.steps {
        let time_s = f64::from(number) / case.hz;
        let mut take = |of: usize, state: &mut State, work: &mut Workspace| {
            let samples = scripts[of].follow(time_s, &model, state).to_vec();
            step(&model, state, &samples, &ALL, work)
        };
        let one = take(0, &mut kept, &mut work);
        let is_new = number >= first && (number - first).is_multiple_of(every);
        if is_new {
            anew = Workspace::new(&model);
        }
        let other = take(1, &mut fresh, &mut anew);
        let what = format!("{} at {time_s:.3} s", case.name);
        assert_eq!((one.status, one.rows), (other.status, other.rows), "{what}");
        assert_eq!(bits(&one), bits(&other), "{what}");
        assert!(kept == fresh, "{what}: another state");
        acted += u32::from(number >= first && one.rows > 0);
    }
    assert!(
        2 * acted > case.steps,
        "{}: {acted} steps with rows",
        case.name
    );
}

/// What tools feel. The tangent of a tool that is only near is said when columns for it are there, and is not compared.
fn bits(report: &StepReport) -> Vec<u64> {
    let mut numbers = Vec::new();
    for contact in report.contacts() {
        numbers.extend(contact.wrench);
        if contact.wrench != [0.0; 6] {
            numbers.extend(contact.tangent.iter().flatten());
        }
    }
    numbers.into_iter().map(f64::to_bits).collect()
}

macro_rules! cases {
    ($($test:ident $name:literal $corotational:literal $from_s:literal $steps:literal $hz:literal;)*) => {
        $(#[test]
        fn $test() {
            check(&Case { name: $name, corotational: $corotational, from_s: $from_s, steps: $steps, hz: $hz });
        })*
    };
}

// Whether on corotational tissue instead of linear; from when on, how many steps, how many a second.
cases! {
    palpation "palpation" false 0.6 25 100.0;
    palpation_on_corotational "palpation" true 0.6 25 100.0;
    drag "drag" false 0.6 50 100.0;
    two_tools "two-tools" false 0.6 25 100.0;
    needle_slabs "needle-slabs" false 0.7 1100 100.0;
    needle_arc "needle-arc" false 0.5 1400 100.0;
    needle_held_slab "needle-held-slab" true 0.5 150 100.0;
    needle_hyperelastic "needle-hyperelastic" false 0.5 150 50.0;
    suture_and_probe "suture-and-probe" true 0.5 50 10.0;
    touching_slabs "touching-slabs" false 0.2 80 100.0;
    wound_slabs "wound-slabs" false 0.5 225 25.0;
    tied_slab "tied-slab" false 0.5 100 50.0;
    jaws_lift "jaws-lift" true 1.0 150 50.0;
    anastomosis "anastomosis-20" false 1.0 200 25.0;
}
