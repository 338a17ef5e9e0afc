//! Jaws of a scene, closed by its script, by hand, and against it.

use sutura_host::event::{Event, Loss};
use sutura_host::jaws::Pads;
use sutura_host::scene::{Document, Pose, Scene};
use sutura_host::script::at_rest;
use sutura_host::session::SceneSolver;
use sutura_host::step::StepReport;
use sutura_host::tool::Act;

const SCENE: &str = r#"
[mesh.slab]
size_m = [0.06, 0.04, 0.02]
divisions = [10, 8, 4]
[tissue]
youngs_modulus_pa = 15e3
poisson_ratio = 0.4
[[fixed]]
plane = { axis = "z", at_m = -0.02 }
[[tool]]
id = 4
shape = "grip"
[[jaws]]
tool = 4
clamp_n = 20.0
friction = 0.5
width_m = 0.0064
close = [{ from_s = 0.19, to_s = 0.49 }]
"#;

/// A solver, its hand at a height, every 20 ms.
struct Hand {
    solver: SceneSolver,
    steps: u64,
}

impl Hand {
    fn new() -> Self {
        let document = Document::embedded("test.toml", "".as_ref(), SCENE);
        let scene = Scene::read(&document, "test").expect("a good scene");
        let solver = SceneSolver::new(&scene).expect("a solver");
        Self { solver, steps: 0 }
    }

    fn at(&mut self, z: f64) -> StepReport {
        let pose = Pose {
            position_m: [0.003, 0.001, z],
            orientation: [0.0, 0.0, 0.0, 1.0],
        };
        let mut sample = at_rest(4, &pose);
        sample.console_time_us = 20_000 * self.steps;
        self.steps += 1;
        let report = self.solver.step(sample);
        assert_eq!(report.status.name(), "ok");
        report
    }

    /// With the steps in which they happened.
    fn events(&self) -> Vec<(f64, Event)> {
        let events = self.solver.events().iter();
        let events = events.map(|one| ((one.time_s / 0.02).round(), one.event));
        events.collect()
    }
}

#[test]
fn a_script_closes_and_opens_jaws() {
    let mut hand = Hand::new();
    for step in 0..40 {
        let report = hand.at(-0.005 + 1e-4 * f64::from(step));
        let jaws = report.jaws()[0];
        let closed = (10..25).contains(&step);
        assert_eq!(jaws.pads == Pads::Open, !closed, "{step}");
        assert_eq!(report.contacts()[0].rows > 0, closed && step > 10, "{step}");
        let [_, _, pull, ..] = report.contacts()[0].wrench;
        assert!((pull < -0.01) == (closed && step > 10), "{step}: {pull} N");
    }
    let grasped = Event::Grasped { tool: 4, points: 8 };
    assert_eq!(hand.events(), [(10.0, grasped)]);
}

/// In between, and beside a script, hands do as they like.
#[test]
fn hands_close_and_open_jaws_besides() {
    let mut hand = Hand::new();
    hand.at(-0.005);
    assert!(hand.solver.act(Act::Close(4)));
    assert!(!hand.solver.act(Act::Close(7)), "there is no such tool");
    assert_eq!(hand.at(-0.005).jaws()[0].pads, Pads::Closed);
    let lifted = hand.at(-0.003);
    assert!(lifted.contacts()[0].wrench[2] < -0.1);
    hand.solver.act(Act::Open(4));
    let free = hand.at(-0.003);
    assert_eq!(
        (free.contacts()[0].rows, free.contacts()[0].wrench),
        (0, [0.0; 6])
    );
    // The script closes them once, and does not mind what is done then.
    while hand.steps < 15 {
        hand.at(0.04);
    }
    assert_eq!(hand.at(0.04).jaws()[0].pads, Pads::Closed);
    hand.solver.act(Act::Open(4));
    assert_eq!(hand.at(-0.005).jaws()[0].pads, Pads::Open);
    let nothing = Event::Lost {
        tool: 4,
        why: Loss::Nothing,
    };
    let grasped = Event::Grasped { tool: 4, points: 6 };
    assert_eq!(hand.events(), [(1.0, grasped), (10.0, nothing)]);
}
