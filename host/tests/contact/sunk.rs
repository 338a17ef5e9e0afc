//! Bodies of grips and needles that a hand takes deeper than they can be pressed: pushed out, or said to be inside.

use nalgebra::Vector3;
use sutura_host::scene::{Document, Pose, Scene};
use sutura_host::script::at_rest;
use sutura_host::session::SceneSolver;
use sutura_host::step::{Status, StepReport};

/// Bodies with the height of the grip at which their axis is in the surface \[m\].
const BODIES: [(&str, f64); 5] = [
    ("radius_m = 0.014, length_m = 0.03, friction = 0.1", 0.0),
    ("radius_m = 0.014, length_m = 0.03", 0.0),
    ("radius_m = 0.002, length_m = 0.03", 0.0),
    (
        "radius_m = 0.005, length_m = 0.03, axis = [1.0, 0.0, 0.0], offset_m = [0.015, 0.0, 0.0]",
        0.0,
    ),
    ("radius_m = 0.001, length_m = 0.03, friction = 0.1", 0.0),
];

fn scene(law: &str, more: &str) -> Scene {
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
{more}
"#
    );
    Scene::read(&Document::embedded("sunk.toml", "".as_ref(), &text), "sunk").expect("good")
}

fn grip(body: &str) -> String {
    format!("[[tool]]\nshape = \"grip\"\nbody = {{ {body} }}\n")
}

const TOP: &str = "[[fixed]]\nplane = { axis = \"z\", at_m = 0.0 }\n";

struct Hand {
    solver: SceneSolver,
    time_us: u64,
}

impl Hand {
    fn new(scene: &Scene) -> Self {
        Self {
            solver: SceneSolver::new(scene).expect("a solver"),
            time_us: 0,
        }
    }

    /// Goes there in as many steps as that takes.
    fn go(&mut self, position_m: [f64; 3]) -> StepReport {
        self.time_us += 5_000;
        let pose = Pose {
            position_m,
            orientation: [0.0, 0.0, 0.0, 1.0],
        };
        let mut sample = at_rest(0, &pose);
        sample.console_time_us = self.time_us;
        let mut report = self.solver.step(sample);
        for _ in 0..100 {
            match report.status {
                Status::Waiting | Status::Behind => report = self.solver.step(sample),
                _ => break,
            }
        }
        report
    }
}

fn force_n(report: &StepReport) -> Vector3<f64> {
    Vector3::from_column_slice(&report.contacts()[0].wrench[..3])
}

/// Pushes a body from above through all of the slab; how many steps were said to be inside. Where its
/// axis is in the surface the grip is at `axis_m` \[m\].
fn push_through(hand: &mut Hand, [x, y]: [f64; 2], axis_m: f64, stride_m: f64, what: &str) -> u32 {
    let start = hand.go([x, y, axis_m + 0.016]);
    assert_eq!((start.status, start.rows), (Status::Ok, 0), "{what}");
    let (mut inside, mut height_m) = (0, axis_m + 0.016);
    while height_m > axis_m - 0.04 {
        height_m -= stride_m;
        let report = hand.go([x, y, height_m]);
        let place = format!("{what}, {:.2} mm deep", 1e3 * (axis_m - height_m));
        match report.status {
            Status::Ok => {
                let force_n = force_n(&report).z;
                // Said to be inside it is felt again once it is outside, which it may be below.
                if inside > 0 {
                    assert!(height_m < axis_m - 0.03, "{place}");
                    assert_eq!(force_n, 0.0, "{place}");
                    continue;
                }
                assert!(force_n >= 0.0, "{place}: it pulls by {force_n} N");
                let is_in = height_m < axis_m - 1e-3 && height_m > axis_m - 0.03;
                assert!(
                    !is_in || (report.rows > 0 && force_n > 0.0),
                    "{place}: {force_n} N by {} rows",
                    report.rows
                );
            }
            Status::Inside => inside += 1,
            Status::NotConverged | Status::TooManyRows => {}
            other => panic!("{place}: {other:?}"),
        }
    }
    inside
}

/// Takes a body out of the tissue, where it has begun anew, and presses again.
fn begins_anew(hand: &mut Hand, [x, y]: [f64; 2], axis_m: f64, is_thick: bool, what: &str) {
    // From below it comes into the tissue once more, and touches nothing after that.
    hand.go([x, y, 0.08]);
    let out = hand.go([x, y, 0.08]);
    assert_eq!((out.status, out.rows), (Status::Ok, 0), "{what}");
    hand.go([x, y, axis_m + 0.016]);
    let deep_m = if is_thick { 0.012 } else { 0.0 };
    let again = hand.go([x, y, axis_m + deep_m]);
    assert_eq!(again.status, Status::Ok, "{what}");
    assert!(force_n(&again).z > 0.0, "{what}");
}

/// Bodies through soft tissue, slowly and by more than their radius at once.
#[test]
fn a_body_that_is_pushed_through_tissue_is_pushed_out_or_said_to_be_inside() {
    let mut words = 0;
    for law in ["linear", "corotational"] {
        for (body, axis_m) in BODIES {
            let scene = scene(law, &grip(body));
            for (place, stride_m) in [([0.01, -0.005], 5.5e-4), ([0.0021, 0.0013], 5.5e-3)] {
                let what = format!("{law}, {body}, {stride_m} m a step");
                let mut hand = Hand::new(&scene);
                let inside = push_through(&mut hand, place, axis_m, stride_m, &what);
                println!("{what}: {inside} steps inside");
                words += inside;
                // Out of tissue that turns a body of this size may have too many rows on one long way.
                if law == "linear" {
                    begins_anew(&mut hand, place, axis_m, body.contains("0.014"), &what);
                }
            }
        }
    }
    assert!(words > 100, "{words}");
}

/// Bodies as thin as a hand can push through what stands still.
#[test]
fn a_body_whose_axis_comes_behind_a_wall_is_inside() {
    for law in ["linear", "corotational", "hyperelastic"] {
        for radius_m in [0.001, 5e-5] {
            let body = format!("radius_m = {radius_m}, length_m = 0.03");
            let scene = scene(law, &format!("{TOP}{}", grip(&body)));
            for place in [[0.004, 0.004], [0.0027, 0.0054], [0.0, 0.0]] {
                let what = format!("{law}, {radius_m} m thick, at {place:?}");
                let mut hand = Hand::new(&scene);
                let inside = push_through(&mut hand, place, 0.0, 5e-4, &what);
                assert!(inside > 20, "{what}: {inside}");
            }
        }
    }
}

/// The shaft of a needle that lies on the slab, pushed down as a whole.
#[test]
fn a_shaft_that_is_pushed_through_tissue_is_pushed_out_or_said_to_be_inside() {
    let needle = "[tissue.needle]\nfriction_n_per_m = 5.0\npuncture_pa = 2e5\nsurface_friction = 0.2\n\
                  [[tool]]\nshape = \"grip\"\n\
                  [[needle]]\nshape = \"straight\"\nlength_m = 0.03\nthickness_m = 0.001\nbody = true\n\
                  end_m = [-0.015, 0.002, 0.004]\ndirection = [1.0, 0.0, 0.0]\n\
                  hold = [{ time_s = 0.0, tool = 0 }]\n";
    let mut words = 0;
    for (law, fixed) in [("linear", ""), ("corotational", ""), ("linear", TOP)] {
        let fixed = format!("{fixed}{needle}");
        let scene = scene(law, &fixed);
        let mut hand = Hand::new(&scene);
        let start = hand.go([0.0; 3]);
        assert_eq!((start.status, start.rows), (Status::Ok, 0));
        for part in 1..=56 {
            let height_m = -5e-4 * f64::from(part);
            let report = hand.go([0.0, 0.0, height_m]);
            let place = format!("{law}, {} mm down", -1e3 * height_m);
            match report.status {
                Status::Ok => {
                    let force_n = force_n(&report).z;
                    assert!(force_n >= -1e-9, "{place}: it pulls by {force_n} N");
                    assert!(
                        height_m > -5e-3 || (report.rows > 0 && force_n > 0.0),
                        "{place}: {force_n} N by {} rows",
                        report.rows
                    );
                }
                Status::Inside => words += 1,
                Status::NotConverged | Status::TooManyRows => {}
                other => panic!("{place}: {other:?}"),
            }
        }
    }
    assert!(words > 10, "{words}");
}
