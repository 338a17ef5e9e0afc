//! Whole sutures against the least energy: what a session without friction leaves, in whatever order the ends were pulled.

use super::least::{Apart, Least, Suture, turning};
use nalgebra::Vector3;
use std::path::Path;
use sutura_host::collide::{TouchSettings, gaps_m, penetration_m};
use sutura_host::scene::{Document, Scene, position_at};
use sutura_host::session::SceneSolver;
use sutura_host::step::{State, Status, StepOptions, StepReport, Workspace, step};
use sutura_host::thread::{ThreadEnd, ThreadHold, ThreadPart, ThreadPlace, ThreadPoint};
use sutura_host::tool::ToolSample;
use sutura_host::wound::Wound;
use sutura_testkit::full;

/// Most that gap and tensions are off.
const GAP_OFF: f64 = 0.03;
const TENSION_OFF: f64 = 0.03;

/// Parts of their ways at which the hands at head and tail arrive together, and in how many steps.
type Order = [([f64; 2], u32)];

const TOGETHER: &Order = &[([1.0, 1.0], 300)];
const TAIL_FIRST: &Order = &[([0.0, 1.0], 300), ([1.0, 1.0], 300)];
const HEAD_FIRST: &Order = &[([1.0, 0.0], 300), ([1.0, 1.0], 300)];
/// And let go between.
const IN_TURNS: &Order = &[
    ([0.5, 0.0], 150),
    ([0.5, 0.8], 200),
    ([0.2, 0.2], 150),
    ([1.0, 0.2], 200),
    ([1.0, 1.0], 200),
];
/// 1 to 1.5 mm each.
const IN_FEW_STEPS: &Order = &[([1.0, 1.0], 40)];

/// Steps on the spot after that.
pub const REST: u32 = 10;

/// Sewn, held at both ends, and not pulled yet.
pub struct Sewn {
    pub scene: Scene,
    pub solver: SceneSolver,
    pub state: State,
    /// Where the hands begin and end.
    hands: [Vec<ToolSample>; 2],
}

/// What a pull leaves.
struct Pulled {
    state: State,
    at: Vec<Vector3<f64>>,
    report: StepReport,
    /// Tension of each span outside \[N\].
    spans_n: Vec<f64>,
    /// The path of the last step, with all nodes at rest.
    path: Vec<ThreadPoint>,
}

impl Sewn {
    /// A scene of this repository up to its pull, by its scripts.
    fn new(name: &str) -> Self {
        Self::read(name, 1, "linear")
    }

    /// The same with room for cuts.
    fn in_strands(name: &str, strands: u8) -> Self {
        Self::read(name, strands, "linear")
    }

    /// The same on another tissue.
    fn read(name: &str, strands: u8, tissue: &str) -> Self {
        Self::of(name, tissue, |part| part.through.strands = strands)
    }

    /// The same of a thread that rubs.
    pub fn that_rubs(name: &str, friction: f64) -> Self {
        Self::of(name, "linear", |part| {
            part.through.strands = 1;
            part.friction = friction;
        })
    }

    fn of(name: &str, tissue: &str, change: impl Fn(&mut ThreadPart)) -> Self {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenes");
        let text = std::fs::read_to_string(root.join(name)).expect("a scene");
        let model = format!("model = \"{tissue}\"");
        let text = text.replacen("model = \"linear\"", &model, 1);
        let mut scene = Scene::read(&Document::embedded(name, &root, &text), name).expect("good");
        change(&mut scene.threads[0].part);
        let mut solver = SceneSolver::new(&scene).expect("a solver");
        let held_s = scene.threads[0].holds.last().expect("held").time_s + 0.05;
        let next = follow(&scene, &mut solver, 0, held_s);
        let (_, state, _) = solver.parts().expect("rows");
        let (state, begin) = (state.clone(), solver.samples().to_vec());
        follow(&scene, &mut solver, next, scene.seconds);
        let end = solver.samples().to_vec();
        Self {
            scene,
            solver,
            state,
            hands: [begin, end],
        }
    }

    /// The hands after parts of `upto` of their ways; the console's is at the head, the others at the tail.
    pub fn samples(&self, upto: f64, parts: [f64; 2], time_us: u64) -> Vec<ToolSample> {
        let [begin, end] = &self.hands;
        let both = begin.iter().zip(end).enumerate();
        both.map(|(index, (begin, end))| {
            let part = upto * parts[usize::from(index > 0)];
            let [from, to] = [begin, end].map(|sample| Vector3::from(sample.position_m));
            ToolSample {
                position_m: (from + (to - from) * part).into(),
                console_time_us: time_us,
                ..*begin
            }
        })
        .collect()
    }

    /// Pulls what has been sewn so, as far as `upto`.
    fn pulled(&self, order: &Order, upto: f64) -> Pulled {
        self.pulled_from(self.state.clone(), [0.0; 2], order, upto)
    }

    /// The same from a state on in which the hands have gone parts of their ways.
    fn pulled_from(
        &self,
        mut state: State,
        mut from: [f64; 2],
        order: &Order,
        upto: f64,
    ) -> Pulled {
        let (model, _, _) = self.solver.parts().expect("rows");
        let mut work = Workspace::new(model);
        let mut time_us = self.hands[0][0].console_time_us;
        let mut report = StepReport::default();
        let mut path = Vec::new();
        let last = order.last().map_or([1.0; 2], |(to, _)| *to);
        let rest = [(last, REST)];
        for (to, steps) in order.iter().chain(&rest) {
            for k in 1..=*steps {
                time_us += 5000;
                let done = f64::from(k) / f64::from(*steps);
                let parts = [0, 1].map(|end| from[end] + done * (to[end] - from[end]));
                let samples = self.samples(upto, parts, time_us);
                // What it bends around in this step.
                path = state.thread_path(model, 0, model.points_m());
                let mut step = || {
                    step(
                        model,
                        &mut state,
                        &samples,
                        &StepOptions::default(),
                        &mut work,
                    )
                };
                report = step();
                while matches!(report.status, Status::Waiting | Status::Behind) {
                    report = step();
                }
                assert_eq!(report.status, Status::Ok, "{to:?} {k}");
            }
            from = *to;
        }
        let nodes_m = state.positions(model);
        let outside =
            |point: &&ThreadPoint| matches!(point.what, ThreadPlace::End | ThreadPlace::Leaves);
        let after = state.thread_path(model, 0, &nodes_m);
        let spans = after[..after.len() - 1].iter().filter(outside);
        Pulled {
            state,
            at: nodes_m.into_iter().map(Vector3::from).collect(),
            report,
            spans_n: spans.map(|point| point.tension_n).collect(),
            path,
        }
    }

    fn suture(&self, pulled: &Pulled) -> Suture {
        self.suture_of(&self.turning(&pulled.path))
    }

    /// The points at which a path turns.
    pub fn turning(&self, path: &[ThreadPoint]) -> Vec<ThreadPoint> {
        turning(path, 0.15 * self.scene.mesh.surface().mean_edge_m)
    }

    /// Of a path that turns there, with all nodes at rest.
    pub fn suture_of(&self, path: &[ThreadPoint]) -> Suture {
        let scene = &self.scene;
        let edge_m = scene.mesh.surface().mean_edge_m;
        let [one, other] = &scene.touching[0].faces;
        let apart = Apart::new([one, other], TouchSettings::default().separation * edge_m);
        Suture::new(
            (&scene.mesh, &scene.fixed),
            |cell| scene.materials.of(cell),
            path,
            Some(apart),
        )
    }

    /// Mean distance of the rims' nodes to the other part \[m\].
    fn gap_m(&self, at: &[Vector3<f64>]) -> f64 {
        let pair = &self.scene.touching[0];
        let mut gaps = gaps_m(&pair.rims[0], &pair.faces[1], at);
        gaps.extend(gaps_m(&pair.rims[1], &pair.faces[0], at));
        gaps.iter().sum::<f64>() / gaps.len() as f64
    }

    /// Pulls, and compares with the least energy of as much thread.
    fn compare(&self, order: &Order, upto: f64) {
        let pulled = self.pulled(order, upto);
        let suture = self.suture(&pulled);
        let thread = pulled.report.threads()[0];
        // The same law: the path is as long as the solver has it.
        let off = suture.length_m(&pulled.at) - thread.length_m;
        assert!(off.abs() < 1e-9, "{off} m");
        suture.check_slopes(&pulled.at);
        let least = suture.drawn(thread.available_m, f64::INFINITY);
        self.check(&suture, &pulled, &least);
    }

    fn check(&self, suture: &Suture, pulled: &Pulled, least: &Least) {
        let [one, other] = &self.scene.touching[0].faces;
        assert_eq!(penetration_m([one, other], &least.at), 0.0);
        let [gap_m, least_m] = [&pulled.at, &least.at].map(|at| self.gap_m(at));
        let most = |sign: f64| {
            let signed = pulled.spans_n.iter().map(|tension_n| sign * tension_n);
            sign * signed.fold(f64::NEG_INFINITY, f64::max)
        };
        println!(
            "gap {gap_m} of {least_m} m; tissue {} of {} J; {} spans with {} to {} of {} N",
            suture.tissue_j(&pulled.at),
            least.tissue_j,
            pulled.spans_n.len(),
            most(-1.0),
            most(1.0),
            least.tension_n
        );
        assert!((gap_m / least_m - 1.0).abs() < GAP_OFF, "{gap_m} {least_m}");
        for tension_n in &pulled.spans_n {
            let off = tension_n / least.tension_n - 1.0;
            assert!(off.abs() < TENSION_OFF, "{tension_n} {}", least.tension_n);
        }
    }
}

/// A session by its scripts from a step on, up to a time; the next step.
fn follow(scene: &Scene, solver: &mut SceneSolver, from: u64, until_s: f64) -> u64 {
    look_at(scene, solver, from, until_s, |_| {})
}

/// The same with a look at each step.
fn look_at(
    scene: &Scene,
    solver: &mut SceneSolver,
    from: u64,
    until_s: f64,
    mut look: impl FnMut(&StepReport),
) -> u64 {
    let hand = scene.hand.as_ref().expect("a hand");
    let hz = scene.host.host_hz;
    let last = (until_s * hz).round() as u64;
    for number in from..=last {
        let time_s = number as f64 / hz;
        let sample = ToolSample {
            id: solver.driven().expect("driven"),
            position_m: position_at(hand, time_s),
            orientation: [0.0, 0.0, 0.0, 1.0],
            velocity_m_per_s: [0.0; 3],
            console_time_us: (1e6 * time_s).round() as u64,
        };
        let mut report = solver.step(sample);
        while matches!(report.status, Status::Waiting | Status::Behind) {
            report = solver.step(sample);
        }
        assert_eq!(report.status, Status::Ok, "{time_s} s");
        look(&report);
    }
    last + 1
}

/// Where two rims touch under a thread it presses on both: with the one or the other in turn the tension went to and fro by a fortieth, with hands
/// that stay where they are.
#[test]
fn over_two_rims_that_touch_a_thread_is_at_rest() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data");
    let name = "wound-by-hand.toml";
    let text = std::fs::read_to_string(root.join(name)).expect("a scene");
    let scene = Scene::read(&Document::embedded(name, &root, &text), name).expect("good");
    let mut solver = SceneSolver::new(&scene).expect("a solver");
    // The needle is brought back through the air.
    let next = follow(&scene, &mut solver, 0, 8.4);
    let (mut tensions, mut most) = (Vec::new(), 0);
    look_at(&scene, &mut solver, next, 8.7, |report| {
        let thread = report.threads()[0];
        most = most.max(thread.wraps);
        tensions.push(thread.tension_n[0]);
    });
    assert!(most > 3, "{most}");
    for pair in tensions.windows(2) {
        assert!((pair[1] / pair[0] - 1.0).abs() < 2e-3, "{tensions:?}");
    }
}

/// Two slabs, drawn until they press.
#[test]
fn two_slabs_are_closed_as_the_least_energy_has_it() {
    let sewn = Sewn::new("wound-slabs.toml");
    let long = [TAIL_FIRST, HEAD_FIRST, IN_FEW_STEPS];
    let orders = [TOGETHER, IN_TURNS].into_iter();
    for order in orders.chain(long.into_iter().filter(|_| full())) {
        sewn.compare(order, 1.0);
    }
}

/// Two tubes with 20 punctures, their walls not yet pressed across each other: beyond that there are several balances.
#[test]
fn two_tubes_are_closed_as_the_least_energy_has_it() {
    let sewn = Sewn::new("anastomosis-20.toml");
    let long = [TAIL_FIRST, HEAD_FIRST, IN_TURNS, IN_FEW_STEPS];
    sewn.compare(TOGETHER, 0.8);
    for order in long.into_iter().filter(|_| full()) {
        sewn.compare(order, 0.8);
    }
}

/// The same pulled all the way: one of several balances, and the least energy next to where the session is.
#[test]
fn two_tubes_that_are_pulled_hard_are_in_a_balance() {
    if !full() {
        return;
    }
    let sewn = Sewn::new("anastomosis-20.toml");
    for order in [TOGETHER, TAIL_FIRST, HEAD_FIRST, IN_TURNS, IN_FEW_STEPS] {
        let pulled = sewn.pulled(order, 1.0);
        let suture = sewn.suture(&pulled);
        let thread = pulled.report.threads()[0];
        let from_rest = suture.drawn(thread.available_m, f64::INFINITY);
        println!(
            "from rest: {} m, {} N",
            sewn.gap_m(&from_rest.at),
            from_rest.tension_n
        );
        let [tension_n, _] = thread.tension_n;
        let next = suture.drawn_from(&pulled.at, tension_n, thread.available_m);
        sewn.check(&suture, &pulled, &next);
    }
}

/// Two tubes with 50 punctures, pulled all the way.
#[test]
fn fifty_punctures_are_closed_as_the_least_energy_has_it() {
    if !full() {
        return;
    }
    let sewn = Sewn::new("anastomosis-50.toml");
    for order in [TOGETHER, TAIL_FIRST, HEAD_FIRST, IN_TURNS, IN_FEW_STEPS] {
        sewn.compare(order, 1.0);
    }
}

/// What Younes (2021, figures 4.6 and 4.7) found of 20 and 50 punctures, which linear and corotational tissue have alike: contact and suture close the
/// gap between two tubes, and more punctures spread the stress that this takes and leave less of the gap.
#[test]
fn more_punctures_close_more_and_spread_the_stress() {
    let tissues = ["linear", "corotational"];
    for tissue in &tissues[..if full() { 2 } else { 1 }] {
        let found = ["anastomosis-20.toml", "anastomosis-50.toml"].map(|name| {
            let sewn = Sewn::read(name, 1, tissue);
            let pulled = sewn.pulled(TOGETHER, 1.0);
            let (model, _, _) = sewn.solver.parts().expect("rows");
            let wound = Wound::new(&sewn.scene, model).expect("a wound");
            let report = wound.report(model, &pulled.state, &pulled.report);
            let found = [report.gap_ratio, report.stress_peak_pa].map(|value| value.expect("told"));
            println!("{tissue} {name}: {found:?} {:?}", report.bridge_ratio);
            assert!(found[0] < 0.3 && report.penetration_ratio < Some(1e-3));
            found
        });
        let [twenty, fifty] = found;
        assert!(fifty[0] < 0.8 * twenty[0], "{tissue}: {found:?}");
        assert!(fifty[1] < 0.8 * twenty[1], "{tissue}: {found:?}");
    }
}

/// How far apart the rims of punctures are that are drawn together is one number, wherever the session ended.
#[test]
fn welds_do_not_depend_on_the_pull() {
    let names = [
        "wound-slabs.toml",
        "anastomosis-20.toml",
        "anastomosis-50.toml",
    ];
    for name in &names[..if full() { 3 } else { 1 }] {
        let sewn = Sewn::new(name);
        let (model, _, _) = sewn.solver.parts().expect("rows");
        let wound = Wound::new(&sewn.scene, model).expect("a wound");
        let ends = [(TOGETHER, 0.0), (TAIL_FIRST, 0.7), (IN_FEW_STEPS, 1.0)];
        let gaps_m = ends.map(|(order, upto)| {
            let pulled = sewn.pulled(order, upto);
            let report = wound.report(model, &pulled.state, &pulled.report);
            report.rim_gap_welded_m.expect("a balance")
        });
        println!("{name}: {gaps_m:?} m");
        assert_eq!(gaps_m, [gaps_m[0]; 3]);
        let rest: Vec<_> = model
            .points_m()
            .iter()
            .map(|at| Vector3::from(*at))
            .collect();
        assert!(gaps_m[0] < 0.5 * sewn.gap_m(&rest), "{gaps_m:?}");
    }
}

/// Of a suture that is cut, with a knot at either side, and whose tail is let go, what lies beyond the cut is drawn on: as if what lies
/// before had never been sewn.
#[test]
fn a_suture_that_is_cut_is_what_is_left_of_it() {
    let sewn = Sewn::in_strands("wound-slabs.toml", 2);
    let (model, _, _) = sewn.solver.parts().expect("rows");
    let Pulled { mut state, .. } = sewn.pulled(TOGETHER, 0.7);
    let path = state.thread_path(model, 0, &state.positions(model));
    let is_run = |two: &&[ThreadPoint]| {
        two[0].what == ThreadPlace::Leaves && two[1].what == ThreadPlace::Enters
    };
    // Each bite is through both slabs: every second run is from bite to bite.
    let run = path.windows(2).filter(is_run).nth(1).expect("bites");
    let [a, b] = [0, 1].map(|end| Vector3::from(run[end].at_m));
    let middle = (a + b) / 2.0;
    assert!(state.cut_thread(model, 0, &middle.into(), true));
    let samples = sewn.samples(0.7, [1.0; 2], 0);
    assert!(state.hold_thread(model, 0, ThreadEnd::Tail, ThreadHold::Free, &samples));
    let on: &Order = &[([1.6, 1.0], 300)];
    let mut pulled = sewn.pulled_from(state, [1.0; 2], on, 0.7);
    let cut = pulled
        .path
        .iter()
        .rposition(|point| point.what == ThreadPlace::Cut);
    let before = pulled.path.drain(..=cut.expect("a cut"));
    let spans = before.filter(|point| point.what == ThreadPlace::Leaves);
    let before_n: Vec<f64> = pulled.spans_n.drain(..spans.count()).collect();
    assert_eq!(before_n, [0.0; 3]);
    let suture = sewn.suture(&pulled);
    let [first, last] = [pulled.path.first(), pulled.path.last()].map(|end| end.expect("a path"));
    let least = suture.drawn(last.along_m - first.along_m, f64::INFINITY);
    sewn.check(&suture, &pulled, &least);
}
