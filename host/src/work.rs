//! Work that may take seconds, told as it is begun: what it is, and how large; and how it is ended early.
//!
//! Entry points: [`begin`], [`TARGET`], [`stop_with`]. It is told as `tracing` events, whose fields are the [`WHAT`] and [`SIZE`] of the work or, while
//! it goes on, [`DONE`] parts [`OF`] so many, and the [`END`] of a piece of it; whoever shows progress listens, and nobody pays who does not.

use std::cell::RefCell;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Target of the events.
pub const TARGET: &str = "sutura::work";
/// Field with what is begun, in words.
pub const WHAT: &str = "what";
/// Field with its size, in words.
pub const SIZE: &str = "size";
/// Field with the parts that are done.
pub const DONE: &str = "done";
/// Field with all parts.
pub const OF: &str = "of";
/// Field of the end of a piece of the work that was begun before.
pub const END: &str = "end";

thread_local! {
    static STOP: RefCell<Option<Arc<AtomicBool>>> = const { RefCell::new(None) };
}

/// Has long work on this thread end with an error at its next stage, piece or pass once `stop` is set; none: it goes on to its end.
/// A solver step ends without a balance, at its next iteration. A factorisation is one piece.
pub fn stop_with(stop: Option<Arc<AtomicBool>>) {
    STOP.set(stop);
}

/// Whether work on this thread is to end.
pub(crate) fn is_stopped() -> bool {
    STOP.with_borrow(|stop| {
        let stop = stop.as_ref();
        stop.is_some_and(|stop| stop.load(Ordering::Relaxed))
    })
}

/// Says that something is begun that may take long.
pub fn begin(what: &'static str, size: impl FnOnce() -> String) {
    if tracing::enabled!(target: TARGET, tracing::Level::INFO) {
        tracing::info!(target: TARGET, what, size = size());
    }
}

/// Says that a piece of the work that was begun before is done, and that goes on.
pub(crate) fn end() {
    tracing::debug!(target: TARGET, end = true);
}

/// Says how far it is.
pub(crate) fn part(done: usize, of: usize) {
    tracing::debug!(target: TARGET, done, of);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Document, Pose, Scene, read};
    use crate::script::at_rest;
    use crate::session::SceneSolver;
    use crate::step::{Status, StepOptions, step};

    fn slab(model: &str) -> Scene {
        let text = format!(
            r#"
            gravity_m_per_s2 = [0.0, 0.0, -9.81]
            [mesh.slab]
            size_m = [0.04, 0.04, 0.02]
            divisions = [4, 4, 2]
            [tissue]
            model = "{model}"
            youngs_modulus_pa = 15e3
            poisson_ratio = 0.45
            density_kg_per_m3 = 1000.0
            [[fixed]]
            plane = {{ axis = "z", at_m = -0.02 }}
            [[tool]]
            radius_m = 0.014
            "#
        );
        read(&Document::embedded("slab.toml", "".as_ref(), &text)).expect("a good scene")
    }

    /// A step is given up where it is told to, and when it has taken too much; the next one goes on from before.
    #[test]
    fn a_step_ends_where_it_is_stopped_or_takes_too_much() {
        let scene = slab("linear");
        let (model, mut state, mut work) = scene.build().expect("a model");
        let pose = Pose {
            position_m: [0.0, 0.0, 0.013],
            orientation: [0.0, 0.0, 0.0, 1.0],
        };
        let sample = at_rest(scene.tools[0].id, &pose);
        let mut take =
            |options: &StepOptions| step(&model, &mut state, &[sample], options, &mut work).status;
        let all = StepOptions::default();
        stop_with(Some(Arc::new(AtomicBool::new(true))));
        let stopped = take(&all);
        stop_with(None);
        assert_eq!(stopped, Status::NotConverged);
        let spent = StepOptions {
            most_effort: Some(-1.0),
            ..all
        };
        assert_eq!(take(&spent), Status::NotConverged);
        let found = (0..10)
            .map(|_| take(&all))
            .find(|found| *found == Status::Ok);
        assert!(found.is_some());
    }

    /// A flag that is set ends the building of a solver with an error, on this thread alone; without it the same is built.
    #[test]
    fn building_ends_where_it_is_stopped() {
        let stop = Arc::new(AtomicBool::new(true));
        for model in ["linear", "corotational", "hyperelastic"] {
            let scene = slab(model);
            stop_with(Some(stop.clone()));
            let error = SceneSolver::new(&scene).map(drop).expect_err("stopped");
            assert!(error.to_string().contains("stopped"), "{model}: {error}");
            let elsewhere = std::thread::scope(|scope| {
                let built = scope.spawn(|| SceneSolver::new(&scene).map(drop));
                built.join().expect("no panic")
            });
            assert!(elsewhere.is_ok(), "{model}: {elsewhere:?}");
            stop_with(None);
            assert!(SceneSolver::new(&scene).is_ok(), "{model}");
        }
    }
}
