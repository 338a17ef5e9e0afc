//! Threads that hang, in sessions of the scenes that have one.

use crate::pictures::{open, plan};
use std::ops::ControlFlow;
use sutura_hil::NativeConsole;
use sutura_host::mesh::Surface;
use sutura_host::session::{SceneSolver, Snapshot, Solve, Solved, run_lockstep};
use sutura_host::thread::{Beats, Hanging, ThreadPlace, ThreadPoint};
use sutura_shared::wire::Valid;
use sutura_shared::wire::message::State;

/// Threads of a session, seen after every so many solves.
struct Seen<'a, V> {
    solver: &'a mut SceneSolver,
    own: Snapshot,
    hanging: Hanging,
    beats: Beats,
    every: u32,
    solves: u32,
    visit: V,
}

impl<V: FnMut(&Snapshot, &[[f64; 3]], &mut Hanging) + Send> Solve for Seen<'_, V> {
    fn solve(&mut self, state: &Valid<State>) -> Solved {
        let solved = self.solver.solve(state);
        let is_beat = self.beats.is_due(state.console_time_us());
        let is_seen = self.solves.is_multiple_of(self.every);
        self.solves += 1;
        if is_beat || is_seen {
            self.solver.snapshot(&mut self.own);
            let nodes_m = self.own.positions_m();
            if is_beat {
                let t = std::time::Instant::now();
                self.own.beat(&mut self.hanging, &nodes_m);
                eprintln!("BEAT {} {}", self.own.time_s(), t.elapsed().as_micros());
            }
            if is_seen {
                (self.visit)(&self.own, &nodes_m, &mut self.hanging);
            }
        }
        solved
    }

    fn scene(&self) -> serde_json::Map<String, serde_json::Value> {
        self.solver.scene()
    }
}

fn watch(
    name: &str,
    seconds: f64,
    every: u32,
    visit: impl FnMut(&Snapshot, &[[f64; 3]], &mut Hanging) + Send,
) {
    let (scene, _) = open(name);
    let plan = plan(&scene, seconds);
    let mut solver = SceneSolver::for_session(&scene, &plan).expect("a solver");
    let hanging = solver.model().and_then(|model| Hanging::new(model));
    let own = Snapshot::of(&solver);
    let mut seen = Seen {
        solver: &mut solver,
        own,
        hanging: hanging.expect("a thread"),
        beats: Beats::default(),
        every,
        solves: 0,
        visit,
    };
    let mut console = NativeConsole::new(&plan.device).expect("a console");
    let ran = run_lockstep(&mut console, &plan, &mut seen, |_| {
        ControlFlow::Continue(())
    });
    ran.expect("a session");
}

fn distance(a: &ThreadPoint, b: &ThreadPoint) -> f64 {
    let squares = a.at_m.iter().zip(b.at_m).map(|(a, b)| (a - b).powi(2));
    squares.sum::<f64>().sqrt()
}

/// Whether a point is in tissue, and nothing within `depth_m` of it is outside.
fn is_below(surface: &Surface, nodes_m: &[[f64; 3]], at: [f64; 3], depth_m: f64) -> bool {
    // To the sides, edges and corners of a cube.
    let mut ways = (0..27).map(|way| [way % 3, way / 3 % 3, way / 9].map(|x| f64::from(x) - 1.0));
    let around = |way: [f64; 3]| {
        let far = way.iter().map(|x: &f64| x * x).sum::<f64>().sqrt().max(1e-9);
        let to: [f64; 3] = std::array::from_fn(|axis| at[axis] + depth_m * way[axis] / far);
        surface.contains(nodes_m, to)
    };
    surface.contains(nodes_m, at) && ways.all(around)
}

#[derive(Debug, Default)]
struct Worst {
    seen: u32,
    hanging: usize,
    spans: usize,
    length: f64,
    inside: [u32; 6],
    nodes: u32,
}

fn look(name: &str, seconds: f64) -> Worst {
    let mut worst = Worst::default();
    watch(name, seconds, 5, |own, nodes_m, hanging| {
        let (model, state) = own.constrained().expect("tissue");
        let t = std::time::Instant::now();
        let Some(free) = own.threads(hanging, nodes_m) else {
            return;
        };
        eprintln!("SEEN {} {}", own.time_s(), t.elapsed().as_micros());
        let path = free.path(0).to_vec();
        let fixed = state.thread_path(model, 0, nodes_m);
        worst.seen += 1;
        // Runs of what hangs, with the points that hold it.
        let mut first = 0;
        while first < path.len() {
            let is_free = |point: &ThreadPoint| point.what == ThreadPlace::Hangs;
            let begins = path[first + 1..].iter().position(is_free);
            let Some(begins) = begins.map(|place| first + place) else {
                break;
            };
            let ends = path[begins + 1..].iter().position(|point| !is_free(point));
            let ends = begins + 1 + ends.expect("held by something");
            let run = &path[begins..=ends];
            let length: f64 = run.windows(2).map(|two| distance(&two[0], &two[1])).sum();
            let material = run[run.len() - 1].along_m - run[0].along_m;
            worst.length = worst.length.max((length / material - 1.0).abs());
            worst.spans += 1;
            worst.hanging = worst.hanging.max(run.len());
            for node in &run[1..run.len() - 1] {
                worst.nodes += 1;
                for (count, depth) in worst.inside.iter_mut().zip([1e-9, 1e-5, 5e-5, 1e-4, 2e-4, 1e-3]) {
                    *count += u32::from(is_below(model.surface(), nodes_m, node.at_m, depth));
                }
                if is_below(model.surface(), nodes_m, node.at_m, 5e-5) {
                    eprintln!("DEEP {} {:?} of {} nodes {} m", own.time_s(), node, run.len(), material);
                }
            }
            first = ends;
        }
        let held = path.iter().filter(|point| point.what != ThreadPlace::Hangs && point.what != ThreadPlace::Wraps);
        for point in held.skip(1) {
            assert!(fixed.iter().any(|other| other.at_m == point.at_m), "{point:?}");
        }
    });
    worst
}

#[test]
fn measure() {
    for (name, seconds) in [("suture-and-probe.toml", 6.0), ("wound-slabs.toml", 9.0), ("anastomosis-20.toml", 10.9)] {
        let worst = look(name, seconds);
        eprintln!("WORST {name} {worst:?}");
    }
}
