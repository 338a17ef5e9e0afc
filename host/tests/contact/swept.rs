//! Tools that are swept past the tissue's edges by more than a step follows: every step has its rows, or a word.

use super::bench::{Bench, SOFT, all_finite, force, pose};
use nalgebra::{UnitQuaternion, Vector3};
use sutura_host::fem::Loads;
use sutura_host::mesh::slab;
use sutura_host::model::Model;
use sutura_host::step::{State, Status, StepOptions, StepReport};
use sutura_host::tool::{Shape, Tool};
use sutura_testkit::{Random, full};

/// A slab of 80 x 80 x 30 mm held at its bottom, under a tool that rubs.
fn bench(shape: Shape, friction: f64) -> Bench {
    let mesh = slab([0.08, 0.08, 0.03], [12, 12, 5]).expect("a slab");
    let fixed: Vec<u32> = (0..13 * 13).collect();
    let tool = Tool::new(shape, [0.0; 3]).with_friction(friction, friction);
    let model = Model::new(&mesh, SOFT, &fixed, Loads::default(), &[(0, tool)]);
    Bench {
        options: StepOptions {
            most_rows: 12,
            ..StepOptions::with_vertices(1000)
        },
        ..Bench::around(model.expect("a model"))
    }
}

/// Takes the tool along one step; returns its report.
fn go(bench: &mut Bench, state: &mut State, to: Vector3<f64>) -> StepReport {
    let report = bench.step(state, pose(to, UnitQuaternion::identity()));
    assert!(all_finite(&report), "at {to}");
    match report.status {
        Status::Ok | Status::Behind => {
            let felt = &report.contacts()[0];
            // Forces belong to touched vertices: without any there is none.
            assert!(felt.rows > 0 || force(felt) == Vector3::zeros(), "at {to}");
        }
        Status::Inside | Status::NotConverged | Status::TooManyRows => {
            assert!(report.contacts().is_empty(), "at {to}");
        }
        other => panic!("{other:?} at {to}"),
    }
    report
}

/// Sweeps on which the last piece that a step may follow has no balance.
const SWEEPS: [&[[f64; 3]]; 3] = [
    &[
        [
            0.04333513338470533,
            0.041497785658150446,
            -0.00727582999513526,
        ],
        [
            0.029428565189890246,
            0.03580539805039891,
            -0.005829681377609,
        ],
        [
            0.015521996995075164,
            0.03011301044264738,
            -0.0043835327600827406,
        ],
        [
            0.0016154288002600825,
            0.024420622834895846,
            -0.00293738414255648,
        ],
        [
            -0.012291139394555,
            0.018728235227144313,
            -0.0014912355250302203,
        ],
    ],
    &[
        [
            0.05999842517042886,
            0.0004347149277957055,
            -0.0057991292073038235,
        ],
        [
            0.05030470980439286,
            0.004844727824625304,
            -0.004588659912809095,
        ],
        [
            0.04061099443835686,
            0.009254740721454902,
            -0.003378190618314366,
        ],
        [
            0.03091727907232087,
            0.013664753618284498,
            -0.002167721323819637,
        ],
    ],
    &[
        [
            0.05145102929425094,
            -0.03086732227716119,
            -0.012837637738247535,
        ],
        [
            0.030809399281353168,
            -0.027727588716458838,
            -0.007259493198660659,
        ],
        [
            0.010167769268455397,
            -0.02458785515575649,
            -0.0016813486590737826,
        ],
    ],
];

/// A step that ends behind in a piece without balance has the rows of the last balance, and its forces.
#[test]
fn a_step_that_ends_in_a_piece_without_balance_has_the_rows_of_the_last_one() {
    let mut behind = 0;
    for way in SWEEPS {
        let mut bench = bench(Shape::flat_punch(0.006, 0.01), 0.1);
        let mut state = State::new(&bench.model);
        for to in way {
            // A step goes only so far.
            for _ in 0..100 {
                let report = go(&mut bench, &mut state, Vector3::from(*to));
                if report.status != Status::Behind {
                    break;
                }
                behind += 1;
            }
        }
    }
    assert!(behind > 0);
}

/// Punches, boxes and balls that rub, through the slab's edges by 5 to 30 mm a step. `SUTURA_FULL=1`: twenty times as many.
#[test]
fn sweeps_over_edges_end_with_rows_or_a_word() {
    let mut random = Random::new(61);
    let (mut words, mut felt) = (0, 0);
    for _ in 0..if full() { 1200 } else { 60 } {
        let size_m = random.between(0.003, 0.009);
        let shape = match random.below(4) {
            0 => Shape::rounded_box([2.0 * size_m, 1.5 * size_m, 0.02]),
            1 => Shape::Sphere { radius_m: size_m },
            _ => Shape::flat_punch(size_m, 0.01),
        };
        let mut bench = bench(shape, random.between(0.05, 0.5));
        let mut state = State::new(&bench.model);
        for _ in 0..2 {
            let angle = random.between(0.0, std::f64::consts::TAU);
            let from = Vector3::new(
                0.06 * angle.cos(),
                0.06 * angle.sin(),
                random.between(-0.03, 0.01),
            );
            let to = Vector3::new(
                random.between(-0.05, 0.05),
                random.between(-0.05, 0.05),
                random.between(-0.03, 0.012),
            );
            let stride_m = random.between(0.005, 0.03);
            let steps = ((to - from).norm() / stride_m).ceil() as u32;
            for step in 0..=steps {
                let place = from.lerp(&to, f64::from(step) / f64::from(steps));
                for _ in 0..3 {
                    let report = go(&mut bench, &mut state, place);
                    felt += u32::from(report.status == Status::Behind && report.rows > 0);
                    words += u32::from(!report.status.has_balance());
                    if report.status != Status::Behind {
                        break;
                    }
                }
            }
            // Up and away.
            go(&mut bench, &mut state, Vector3::new(0.0, 0.0, 0.2));
        }
    }
    assert!(felt > 10 && words > 10, "{felt} {words}");
}
