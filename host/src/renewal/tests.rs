//! Whoever makes a factor, however slowly, and from whichever state: the same bits.

use super::{Handicap, Rule};
use crate::columns::Columns;
use crate::fem::{Loads, Material, Policy};
use crate::mesh::slab;
use crate::model::{Model, Passes};
use crate::step::{
    Arrival, Renewals, State, Status, StepOptions, StepReport, ToolContact, Workspace, step,
};
use crate::tool::{Tool, ToolSample};
use std::time::Duration;

const RADIUS: f64 = 0.014;
const TICKS: u32 = 70;

/// A block of 60 x 60 x 30 mm that is held below, and a ball.
fn block() -> Model {
    let mesh = slab([0.06, 0.06, 0.03], [8, 8, 4]).expect("a slab");
    let bottom: Vec<u32> = (0..81).collect();
    let soft = Material {
        youngs_modulus_pa: 15e3,
        poisson_ratio: 0.45,
    };
    let tools = [(0, Tool::sphere(RADIUS, [0.0; 3]))];
    let (policy, passes) = (Policy::default(), Passes::default());
    let loads = Loads::default();
    Model::corotational(&mesh, soft, &bottom, loads, &tools, policy, passes).expect("a model")
}

/// Columns are computed in the step that needs them.
const MANY: StepOptions = StepOptions::with_vertices(1000);

/// Down by 10 mm and along.
fn path(tick: u32) -> ToolSample {
    let part = f64::from(tick) / f64::from(TICKS);
    ToolSample {
        id: 0,
        position_m: [0.004 + 0.006 * part, -0.002, RADIUS + 0.001 - 0.011 * part],
        orientation: [0.0, 0.0, 0.0, 1.0],
        velocity_m_per_s: [0.0; 3],
        console_time_us: 0,
    }
}

fn workspace(model: &Model, rule: Rule, handicap: Handicap) -> Workspace {
    let mut work = Workspace::new(model);
    work.renew_beside(model, rule);
    let renewer = work
        .served()
        .and_then(Columns::renewer_mut)
        .expect("it renews");
    renewer.handicap = handicap;
    work
}

/// What a step says but for times and who had to wait.
fn said(report: &StepReport) -> Said {
    let Renewals { asked, adopted, .. } = report.renewals;
    (
        report.status,
        report.rows,
        report.contacts().first().copied(),
        [report.imbalance, report.tangent_error],
        [asked, adopted, report.refactorisations],
    )
}

type Said = (Status, u32, Option<ToolContact>, [f64; 2], [u32; 3]);

fn run(
    model: &Model,
    state: &mut State,
    work: &mut Workspace,
    ticks: std::ops::Range<u32>,
) -> (Vec<Said>, Renewals) {
    let mut all = Renewals::default();
    let each = ticks.map(|tick| {
        let report = step(model, state, &[path(tick)], &MANY, work);
        assert_eq!(report.status, Status::Ok, "{report:?}");
        all = all.plus(report.renewals);
        said(&report)
    });
    (each.collect(), all)
}

fn slowly() -> Handicap {
    Handicap {
        delay: Duration::from_millis(15),
        fails: false,
    }
}

#[test]
fn a_slow_thread_and_none_give_the_bits_of_a_fast_one() {
    let model = block();
    let rule = Rule::SAME_EVERYWHERE;
    let mut fast = workspace(&model, rule, Handicap::default());
    let mut slow = workspace(&model, rule, slowly());
    let mut alone = workspace(&model, rule, Handicap::default());
    alone
        .served()
        .and_then(Columns::renewer_mut)
        .expect("it renews")
        .lose_thread();
    let mut states = [(); 3].map(|()| State::new(&model));
    let [one, two, three] = &mut states;
    let (found, renewals) = run(&model, one, &mut fast, 0..TICKS);
    assert!(renewals.adopted >= 4, "{renewals:?}");
    assert_eq!(renewals.failed, 0, "{renewals:?}");
    let in_step: u32 = found.iter().map(|said| said.4[2]).sum();
    assert_eq!(in_step, 0, "factors made in the step");

    let (same, renewals) = run(&model, two, &mut slow, 0..TICKS);
    assert!(renewals.waited >= 4, "it was not slow: {renewals:?}");
    assert_eq!(same, found);
    let (same, renewals) = run(&model, three, &mut alone, 0..TICKS);
    assert_eq!(renewals.waited, renewals.adopted);
    assert_eq!(same, found);
    assert_eq!(states[0], states[1]);
    assert_eq!(states[0], states[2]);
}

/// With a factor on its way, in the same workspace and in a new one.
#[test]
fn a_copied_state_goes_on_alike() {
    let model = block();
    let rule = Rule::SAME_EVERYWHERE;
    let mut work = workspace(&model, rule, Handicap::default());
    let mut state = State::new(&model);
    let mut on_its_way = 0;
    for tick in 0..TICKS - 10 {
        let copy = state.clone();
        run(&model, &mut state, &mut work, tick..tick + 1);
        let is_asked = |state: &State| state.motion().state().and_then(|s| s.ticket()).is_some();
        if !is_asked(&copy) || on_its_way > 5 {
            continue;
        }
        on_its_way += 1;
        let mut straight = state.clone();
        let (expected, _) = run(&model, &mut straight, &mut work, tick + 1..tick + 10);
        for work in [&mut work, &mut workspace(&model, rule, slowly())] {
            let mut again = copy.clone();
            let (found, _) = run(&model, &mut again, work, tick..tick + 10);
            assert_eq!(found[1..], expected);
            assert_eq!(again, straight);
        }
    }
    assert!(on_its_way >= 3);
}

#[test]
fn a_factor_is_taken_over_in_the_recorded_step() {
    let model = block();
    let mut live = workspace(&model, Rule::WhenThere, slowly());
    live.log_arrivals();
    let mut state = State::new(&model);
    let (mut found, mut arrivals) = (Vec::new(), Vec::new());
    for tick in 0..TICKS {
        // About when the thread is there now and then.
        std::thread::sleep(Duration::from_millis(2));
        found.extend(run(&model, &mut state, &mut live, tick..tick + 1).0);
        arrivals.extend(live.take_arrivals());
    }
    let adopted: u32 = found.iter().map(|said| said.4[1]).sum();
    assert!(adopted >= 2, "{adopted}");
    assert_eq!(arrivals.len(), adopted as usize);
    assert!(arrivals.iter().all(|a| a.vertex == Arrival::FACTOR));

    let replay = |arrivals: &[Arrival]| {
        let mut work = workspace(&model, Rule::AsRecorded, Handicap::default());
        work.expect(arrivals);
        let mut again = State::new(&model);
        let said = run(&model, &mut again, &mut work, 0..TICKS).0;
        (said, again)
    };
    let (said, again) = replay(&arrivals);
    assert_eq!(said, found);
    assert_eq!(again, state);
    // It does matter when.
    let mut later = arrivals;
    later.iter_mut().for_each(|arrival| arrival.step += 2);
    assert_ne!(replay(&later).0, found);
}

#[test]
fn a_tangent_that_cannot_be_factored_leaves_the_last_good_one() {
    let model = block();
    let fails = Handicap {
        fails: true,
        ..Handicap::default()
    };
    let mut work = workspace(&model, Rule::SAME_EVERYWHERE, fails);
    let mut state = State::new(&model);
    let (said, renewals) = run(&model, &mut state, &mut work, 0..TICKS);
    assert_eq!(renewals.adopted, 0);
    assert!((1..=3).contains(&renewals.failed), "{renewals:?}");
    // What is too old to help is made in the step.
    let in_step: u32 = said.iter().map(|said| said.4[2]).sum();
    assert!(in_step >= 1, "{in_step}");
    // It goes on as soon as it can.
    work.served()
        .and_then(Columns::renewer_mut)
        .expect("it renews")
        .handicap = Handicap::default();
    let mut adopted = 0;
    for tick in (0..TICKS).rev() {
        let report = step(&model, &mut state, &[path(tick)], &MANY, &mut work);
        adopted += report.renewals.adopted;
    }
    assert!(adopted >= 1);
}

/// A tool that jumps turns cells farther than any stale factor helps.
#[test]
fn after_a_jump_the_step_makes_the_factor_itself() {
    let model = block();
    let mut work = workspace(&model, Rule::SAME_EVERYWHERE, Handicap::default());
    let mut state = State::new(&model);
    let mut in_step = 0;
    for tick in [0, TICKS / 2, TICKS, TICKS, TICKS, TICKS, TICKS] {
        let report = step(&model, &mut state, &[path(tick)], &MANY, &mut work);
        assert_eq!(report.status, Status::Ok, "{report:?}");
        in_step += report.refactorisations;
    }
    assert!((1..=4).contains(&in_step), "{in_step}");
    let report = step(&model, &mut state, &[path(TICKS)], &MANY, &mut work);
    assert!(report.imbalance < 1e-2, "{report:?}");
}
