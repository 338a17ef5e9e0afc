//! A thread that computes columns: what a step finds is what it finds by itself.

use super::bench::{Bench, RADIUS, at, ball};
use std::time::Duration;
use sutura_host::step::{State, Status};
use sutura_host::tool::ToolSample;

/// In the slab from the first step on, along it, and out.
fn path(tick: u32) -> ToolSample {
    let t = f64::from(tick);
    at(
        0.02 * (0.05 * t).sin(),
        0.0005 * t - 0.01,
        RADIUS - 0.001 - 0.005 * (0.1 * t).sin(),
    )
}

/// From the same state to the same place: same bits as a step that computes its columns itself, but
/// for the steps that wait.
#[test]
fn a_step_that_is_served_has_the_bits_of_one_that_computes() {
    let [mut served, mut computing] = [(); 2].map(|()| Bench::slab(ball([0.0; 3])));
    served.work.start_worker(&served.model).expect("a thread");
    let mut state = State::new(&served.model);
    let (mut waited, mut touching) = (0u32, 0);
    for tick in 0..40 {
        // What is on its way comes some time: at most ten seconds.
        for attempt in 0.. {
            let mut expected = state.clone();
            let report = served.step(&mut state, path(tick));
            assert_eq!(report.columns_computed, 0, "the thread does that");
            if report.status == Status::Waiting {
                assert!(report.contacts().is_empty());
                assert!(attempt < 10_000, "the columns never come");
                waited += 1;
                std::thread::sleep(Duration::from_millis(1));
                continue;
            }
            let found = computing.step(&mut expected, path(tick));
            assert_eq!(report.status, found.status, "tick {tick}");
            let mut contacts = [report.contacts()[0], found.contacts()[0]];
            if contacts[0].rows == 0 && contacts[0].tangent == [[0.0; 6]; 6] {
                // Apart: the tangent just after touching comes with the nearest vertex's columns.
                contacts[1].tangent = contacts[0].tangent;
            }
            assert_eq!(contacts[0], contacts[1], "tick {tick}");
            assert_eq!(
                (
                    report.rows,
                    report.substeps,
                    report.residual,
                    report.stored_energy_j
                ),
                (
                    found.rows,
                    found.substeps,
                    found.residual,
                    found.stored_energy_j
                ),
                "tick {tick}"
            );
            assert_eq!(state, expected, "tick {tick}");
            touching += u32::from(report.status == Status::Ok && report.rows > 1);
            break;
        }
    }
    println!("{waited} steps waited, {touching} touched");
    assert!(waited > 0, "nobody had asked for the first columns");
    assert!(touching > 15, "only {touching} steps touched");
}
