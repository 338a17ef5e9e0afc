//! Factors that are renewed beside the steps: the forces are those of one renewed in every step, and a step that takes
//! one over computes no columns.

use super::bench::{Bench, RADIUS, SOFT, at, ball, force};
use sutura_host::fem::{Loads, Policy};
use sutura_host::mesh::slab;
use sutura_host::model::{Model, Passes};
use sutura_host::step::{Renewals, Rule, State, Status};
use sutura_host::tool::ToolSample;

/// Factors in every pass.
const FRESH: Policy = Policy {
    refactor_rotation_rad: 0.0,
    refactor_every: 0,
    cg_iterations: 0,
    cg_tolerance: 0.0,
};
const BALANCED: Passes = Passes {
    most: 60,
    tolerance: 1e-9,
};
const TICKS: u32 = 90;

/// A block of 60 x 60 x 30 mm that is held below.
fn block(policy: Policy, passes: Passes) -> Bench {
    let mesh = slab([0.06, 0.06, 0.03], [10, 10, 5]).expect("a slab");
    let bottom: Vec<u32> = (0..121).collect();
    let tools = [(0, ball([0.0; 3]))];
    let loads = Loads::default();
    let model = Model::corotational(&mesh, SOFT, &bottom, loads, &tools, policy, passes);
    let model = model.expect("a model");
    Bench::around(model)
}

/// A palpation: down by 10 mm, along by 8 mm, up again.
fn path(tick: u32) -> ToolSample {
    let part = f64::from(tick) / f64::from(TICKS);
    let depth = 0.010 * (std::f64::consts::PI * part).sin();
    at(0.008 * part, -0.002, RADIUS + 0.001 - depth)
}

#[test]
fn forces_are_those_of_a_factor_renewed_in_every_step() {
    let mut fresh = block(FRESH, BALANCED);
    let mut beside = block(Policy::default(), BALANCED);
    beside
        .work
        .renew_beside(&beside.model, Rule::SAME_EVERYWHERE);
    let mut states = [State::new(&fresh.model), State::new(&beside.model)];
    let (mut renewals, mut in_step) = (Renewals::default(), 0);
    let (mut largest, mut apart, mut most_rows) = (0.0f64, 0.0f64, 0);
    for tick in 0..=TICKS {
        let expected = fresh.step(&mut states[0], path(tick));
        let found = beside.step(&mut states[1], path(tick));
        assert_eq!((expected.status, found.status), (Status::Ok, Status::Ok));
        assert!(found.imbalance <= BALANCED.tolerance, "{found:?}");
        assert_eq!(expected.rows, found.rows, "tick {tick}");
        renewals = renewals.plus(found.renewals);
        in_step += found.refactorisations;
        most_rows = most_rows.max(found.rows);
        let [expected, found] = [expected, found].map(|report| force(&report.contacts()[0]));
        largest = largest.max(expected.norm());
        apart = apart.max((expected - found).norm());
    }
    println!(
        "{apart:e} N of {largest} N, {most_rows} rows, {renewals:?}, {in_step} factors in the step"
    );
    assert!(most_rows > 5, "{most_rows}");
    assert!(renewals.adopted >= 5, "{renewals:?}");
    assert_eq!((in_step, renewals.failed), (0, 0));
    assert!(apart < 1e-6 * largest, "{apart:e} N of {largest} N");
}

/// One pass a step, as sessions have it. A factor made in the step takes the columns of all that is touched with it;
/// one made beside it comes with them.
#[test]
fn a_step_that_takes_a_factor_over_computes_no_columns() {
    let computed = |rule: Option<Rule>| {
        let mut bench = block(Policy::default(), Passes::default());
        if let Some(rule) = rule {
            bench.work.renew_beside(&bench.model, rule);
        }
        let mut state = State::new(&bench.model);
        let (mut most, mut changes, mut late) = (0, 0, 0);
        let mut rows = 0;
        for tick in 0..=TICKS {
            let report = bench.step(&mut state, path(tick));
            assert_eq!(report.status, Status::Ok, "{report:?}");
            if report.refactorisations + report.renewals.adopted > 0 {
                changes += 1;
                // What is touched for the first time is new with any factor.
                let new = report.rows.saturating_sub(rows);
                most = most.max((report.columns_computed / 3).saturating_sub(new));
                late = late.max(report.renewals.columns_late);
            }
            rows = report.rows;
        }
        assert!(changes >= 4, "{changes}");
        (most, late)
    };
    let (in_step, _) = computed(None);
    assert!(in_step > 5, "{in_step}");
    let (beside, late) = computed(Some(Rule::SAME_EVERYWHERE));
    println!("{in_step} vertices in the step, {beside} and {late} beside it");
    assert!(beside <= 2, "{beside}");
    assert!(late <= 4, "{late}");
}
