//! Threads that hang, in sessions of the scenes that have one.

use crate::pictures::{open, plan};
use std::ops::ControlFlow;
use std::sync::Arc;
use sutura_hil::NativeConsole;
use sutura_host::mesh::Surface;
use sutura_host::picture::{Heard, Offer, Offering};
use sutura_host::session::{SceneSolver, Snapshot, Solve, Solved, run_lockstep};
use sutura_host::thread::{Beats, Hanging, ThreadPlace, ThreadPoint};
use sutura_shared::wire::Valid;
use sutura_shared::wire::message::State;

/// How far below the surface a node may be at most \[m\]: a tenth of the thread's radius.
const DEEPEST_M: f64 = 1.25e-5;

/// Solves, and lets someone see each.
struct Seen<'a, V> {
    solver: &'a mut SceneSolver,
    visit: V,
}

impl<V: FnMut(&SceneSolver, u64) + Send> Solve for Seen<'_, V> {
    fn solve(&mut self, state: &Valid<State>) -> Solved {
        let solved = self.solver.solve(state);
        (self.visit)(self.solver, state.console_time_us());
        solved
    }

    fn scene(&self) -> serde_json::Map<String, serde_json::Value> {
        self.solver.scene()
    }
}

/// A session in lockstep of which every solve is seen.
fn watch<V: FnMut(&SceneSolver, u64) + Send>(
    name: &str,
    seconds: f64,
    visit: impl FnOnce(&SceneSolver) -> V,
) {
    let (scene, _) = open(name);
    let plan = plan(&scene, seconds);
    let mut solver = SceneSolver::for_session(&scene, &plan).expect("a solver");
    let visit = visit(&solver);
    let mut seen = Seen {
        solver: &mut solver,
        visit,
    };
    let mut console = NativeConsole::new(&plan.device).expect("a console");
    let ran = run_lockstep(
        &mut console,
        &plan,
        &mut seen,
        |_| ControlFlow::Continue(()),
    );
    ran.expect("a session");
}

fn distance(a: &ThreadPoint, b: &ThreadPoint) -> f64 {
    let squares = a.at_m.iter().zip(b.at_m).map(|(a, b)| (a - b).powi(2));
    squares.sum::<f64>().sqrt()
}

/// Whether a point is in tissue, and what is `depth_m` from it to all sides, edges and corners of a cube, too.
fn is_below(surface: &Surface, nodes_m: &[[f64; 3]], at: [f64; 3], depth_m: f64) -> bool {
    let mut ways = (0..27).map(|way| [way % 3, way / 3 % 3, way / 9].map(|x| f64::from(x) - 1.0));
    let around = |way: [f64; 3]| {
        let far = way.iter().map(|x| x * x).sum::<f64>().sqrt().max(1e-9);
        let to = std::array::from_fn(|axis| at[axis] + depth_m * way[axis] / far);
        surface.contains(nodes_m, to)
    };
    surface.contains(nodes_m, at) && ways.all(around)
}

/// Where each run of what hangs begins and ends in a path: the points that hold it, or a loose end.
fn runs(path: &[ThreadPoint]) -> Vec<(usize, usize)> {
    let hangs = |place: &usize| path[*place].what == ThreadPlace::Hangs;
    let begins = (0..path.len() - 1).filter(|place| !hangs(place) && hangs(&(place + 1)));
    begins
        .map(|begin| {
            let end = (begin + 1..path.len()).find(|place| !hangs(place));
            (begin, end.expect("held by something"))
        })
        .collect()
}

/// In every picture each run that hangs is as long as there is thread for it, what holds it is where the path has it, and no node is in
/// the tissue.
fn hangs_as_it_must(name: &str, seconds: f64) -> (usize, u32) {
    let (mut most_runs, mut nodes) = (0, 0);
    watch(name, seconds, |solver| {
        let mut own = Snapshot::of(solver);
        let mut hanging = Hanging::new(solver.model().expect("tissue")).expect("a thread");
        let (mut beats, mut solves) = (Beats::default(), 0_u32);
        let (most_runs, nodes) = (&mut most_runs, &mut nodes);
        move |solver, now_us| {
            let (is_beat, is_seen) = (beats.is_due(now_us), solves.is_multiple_of(7));
            solves += 1;
            if !(is_beat || is_seen) {
                return;
            }
            solver.snapshot(&mut own);
            let nodes_m = own.positions_m();
            if is_beat {
                own.beat(&mut hanging, &nodes_m);
            }
            let (model, state) = own.constrained().expect("tissue");
            let free = own.threads(&mut hanging, &nodes_m).expect("a beat");
            let path = free.path(0);
            let runs = runs(path);
            *most_runs = runs.len().max(*most_runs);
            for (begin, end) in runs {
                let run = &path[begin..=end];
                let length_m: f64 = run.windows(2).map(|two| distance(&two[0], &two[1])).sum();
                let there_is = path[end].along_m - path[begin].along_m;
                assert!(
                    (length_m / there_is - 1.0).abs() < 1e-9,
                    "{name}, {} s: {length_m} m of {there_is} m",
                    own.time_s()
                );
                for node in &path[begin + 1..end] {
                    *nodes += 1;
                    assert!(
                        !is_below(model.surface(), &nodes_m, node.at_m, DEEPEST_M),
                        "{name}, {} s: {node:?}",
                        own.time_s()
                    );
                }
            }
            let fixed = state.thread_path(model, 0, &nodes_m);
            let is_held = |point: &&ThreadPoint| {
                !matches!(point.what, ThreadPlace::Hangs | ThreadPlace::Wraps)
            };
            let held: Vec<_> = path.iter().filter(is_held).collect();
            let fixed: Vec<_> = fixed.iter().filter(is_held).collect();
            // Besides there is the loose end.
            assert!(held.ends_with(&fixed) && held.len() <= fixed.len() + 1);
        }
    });
    (most_runs, nodes)
}

#[test]
fn the_thread_of_a_wound_hangs_outside_the_tissue_and_keeps_its_length() {
    // To where a hand holds the tail and another one pulls the needle.
    let (runs, nodes) = hangs_as_it_must("wound-slabs.toml", 8.0);
    assert!(runs > 3 && nodes > 10_000, "{runs} runs, {nodes} nodes");
}

#[test]
fn the_thread_of_an_anastomosis_hangs_outside_the_tissue_and_keeps_its_length() {
    let (runs, nodes) = hangs_as_it_must("anastomosis-20.toml", 2.5);
    assert!(runs > 1 && nodes > 10_000, "{runs} runs, {nodes} nodes");
}

/// A solver that offers beats; someone fetches them from some time on, if at all.
struct Offers {
    offering: Offering,
    heard: Heard,
    own: Snapshot,
    from_us: u64,
    /// Of the beats that were fetched whether others are missing before each.
    begins: Vec<bool>,
    allocated: u64,
}

fn offers(seconds: f64, from_us: u64) -> Offers {
    let mut offers = None;
    watch("suture-and-probe.toml", seconds, |solver| {
        let offer: Arc<Offer> = Offer::new(solver);
        let own = Snapshot::of(solver);
        let mut heard = offer.heard().expect("a scene with a thread");
        assert!(offer.heard().is_none(), "for one who draws");
        heard.open(&own);
        offer.want(1_000_000_000);
        let offers = offers.insert(Offers {
            offering: Offering::new(offer, solver),
            heard,
            own,
            from_us,
            begins: Vec::new(),
            allocated: 0,
        });
        let mut began_us = None;
        move |solver, now_us| {
            let told = || offers.offering.solved(solver, now_us);
            offers.allocated += allocation_counter::measure(told).count_total;
            let passed_us = now_us - *began_us.get_or_insert(now_us);
            if passed_us >= offers.from_us {
                solver.snapshot(&mut offers.own);
                offers.own.solves = u32::MAX / 4;
                let begins = &mut offers.begins;
                offers
                    .heard
                    .up_to(&offers.own, |_, missing| begins.push(missing));
            }
        }
    });
    offers.expect("a session")
}

/// The solver never waits for who draws: who fetches every beat misses none; who is more than 32 of them late has the first 32, and is told that
/// others are missing then. Once they are there no beat takes memory.
#[test]
fn beats_wait_for_who_draws_and_the_solver_for_nobody() {
    let kept = offers(0.8, 0);
    assert!((7..=10).contains(&kept.begins.len()), "{:?}", kept.begins);
    let missing: Vec<_> = kept.begins.iter().filter(|missing| **missing).collect();
    assert!(kept.begins[0] && missing.len() == 1);
    // What grows for the first time may take memory.
    assert!(kept.allocated < 20, "{}", kept.allocated);

    let late = offers(4.6, 3_950_000);
    let places: Vec<_> = (0..late.begins.len())
        .filter(|beat| late.begins[*beat])
        .collect();
    assert_eq!(places, [0, 32], "{:?}", late.begins);
}
