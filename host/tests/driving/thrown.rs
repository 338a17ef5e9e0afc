//! Needles that a hand takes farther in one step than a step follows.

use sutura_host::scene::{Document, Pose, Scene};
use sutura_host::script::at_rest;
use sutura_host::session::SceneSolver;
use sutura_host::step::Status;

/// A needle 40 mm long above two slabs of 8 mm goes through both, in steps of this length at most \[m\]; statuses but the
/// last, punctures, and what was spent \[J\].
fn through(step_m: f64) -> (Vec<Status>, u32, f64) {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../scenes/needle-slabs.toml");
    let document = Document::read(path.as_ref()).expect("it ships");
    let scene = Scene::read(&document, "slabs").expect("good");
    let mut solver = SceneSolver::new(&scene).expect("a solver");
    let (from_m, to_m) = (0.06, -0.06);
    let steps = ((from_m - to_m) / step_m).ceil() as u32;
    let mut on_the_way = Vec::new();
    for number in 0..=steps {
        let part = f64::from(number) / f64::from(steps);
        let pose = Pose {
            position_m: [0.0011, 0.0007, from_m + (to_m - from_m) * part],
            orientation: [0.0, 0.0, 0.0, 1.0],
        };
        let mut sample = at_rest(0, &pose);
        sample.console_time_us = 5000 * u64::from(number);
        loop {
            let report = solver.step(sample);
            match report.status {
                Status::Ok => break,
                Status::Waiting | Status::Behind => on_the_way.push(report.status),
                other => panic!("{other:?}"),
            }
        }
    }
    let needle = *solver.last().needles().first().expect("a needle");
    assert_eq!(needle.crossings, 0);
    (
        on_the_way,
        needle.punctures,
        needle.dissipated_j.iter().sum(),
    )
}

/// No more is spent in large steps, `behind` or not, than on the same way in small ones.
#[test]
fn a_needle_that_is_thrown_through_tissue_spends_no_more_than_a_slow_one() {
    let (_, punctures, slow_j) = through(5e-4);
    assert_eq!(punctures, 4);
    for step_m in [0.12, 0.05] {
        let (on_the_way, punctures, spent_j) = through(step_m);
        println!("in steps of {step_m} m: {on_the_way:?}");
        assert_eq!(punctures, 4, "in steps of {step_m} m");
        assert!(
            (spent_j / slow_j - 1.0).abs() < 0.2,
            "in steps of {step_m} m: {spent_j} J, {slow_j} J when slow"
        );
    }
}

/// A ball goes from above a soft slab to 8 mm deep beside its middle in so many steps, and stays there for twenty; its force \[N\],
/// (3), and the stored energy \[J\].
fn pressed(law: &str, steps: u32) -> ([f64; 3], f64) {
    let text = format!(
        r#"
[mesh.slab]
size_m = [0.08, 0.08, 0.03]
divisions = [12, 12, 5]
[tissue]
model = "{law}"
youngs_modulus_pa = 15e3
poisson_ratio = 0.45
[[fixed]]
plane = {{ axis = "z", at_m = -0.03 }}
[[tool]]
radius_m = 0.014
"#
    );
    let document = Document::embedded("thrown.toml", "".as_ref(), &text);
    let scene = Scene::read(&document, "thrown").expect("good");
    let mut solver = SceneSolver::new(&scene).expect("a solver");
    let (from_m, to_m) = ([0.0, 0.0, 0.05], [0.0021, 0.0013, 0.006]);
    for number in 0..=steps + 20 {
        let part = f64::from(number.min(steps)) / f64::from(steps);
        let along = |axis: usize| from_m[axis] + (to_m[axis] - from_m[axis]) * part;
        let pose = Pose {
            position_m: [0, 1, 2].map(along),
            orientation: [0.0, 0.0, 0.0, 1.0],
        };
        let mut sample = at_rest(0, &pose);
        sample.console_time_us = 5000 * u64::from(number);
        for _ in 0..100 {
            let report = solver.step(sample);
            match report.status {
                Status::Ok => break,
                Status::Waiting | Status::Behind => {}
                other => panic!("{law} in {steps} steps: {other:?}"),
            }
        }
    }
    let report = solver.last();
    let [x, y, z, ..] = report.contacts()[0].wrench;
    ([x, y, z], report.stored_energy_j)
}

/// A ball that comes in one step feels what it feels after small steps.
#[test]
fn a_ball_that_is_thrown_at_tissue_feels_what_a_slow_one_does() {
    for law in ["linear", "corotational"] {
        let (slow, slow_j) = pressed(law, 200);
        let (thrown, thrown_j) = pressed(law, 1);
        println!("{law}: {slow:?} N, {slow_j} J; thrown {thrown:?} N, {thrown_j} J");
        let ratio = thrown[2] / slow[2];
        assert!((ratio - 1.0).abs() < 0.05, "{law}: {thrown:?} {slow:?}");
        assert!(thrown_j < 1.05 * slow_j, "{law}: {thrown_j} {slow_j}");
    }
}
