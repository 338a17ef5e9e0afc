//! Ports, consoles and solvers that tell what passes.
//!
//! Entry points: [`TappedPort`], [`TappedConsole`], [`TappedSolver`]. Sessions do not know of them.

use super::SolveSample;
use super::scene_sample::Sketching;
use super::tap::{Direction, Tap};
use crate::link::{LinkError, LockstepConsole, Port};
use crate::scene::Scene;
use crate::session::{Effort, Plan, SceneSolver, Solve, Solved, Spared, Tuning};
use crate::tool::Act;
use crate::work;
use std::io;
use std::time::{Duration, Instant};
use sutura_shared::control::{TICK_US, TicksLimited};
use sutura_shared::wire::Valid;
use sutura_shared::wire::message::State;

/// A port whose bytes are told both ways.
pub struct TappedPort {
    port: Box<dyn Port>,
    tap: Tap,
}

impl TappedPort {
    /// Stands in for `port`.
    pub fn new(port: Box<dyn Port>, tap: Tap) -> Self {
        TappedPort { port, tap }
    }
}

impl Port for TappedPort {
    fn name(&self) -> String {
        self.port.name()
    }

    fn read(&mut self, into: &mut [u8], wait: Duration) -> io::Result<usize> {
        let count = self.port.read(into, wait)?;
        self.tap
            .bytes(Direction::Up, into.get(..count).unwrap_or_default());
        Ok(count)
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let count = self.port.write(bytes)?;
        self.tap
            .bytes(Direction::Down, bytes.get(..count).unwrap_or_default());
        Ok(count)
    }

    fn try_clone(&self) -> io::Result<Box<dyn Port>> {
        Ok(Box::new(TappedPort {
            port: self.port.try_clone()?,
            tap: self.tap.clone(),
        }))
    }
}

/// A console in lockstep whose frames are told both ways.
pub struct TappedConsole<'a> {
    console: &'a mut dyn LockstepConsole,
    tap: Tap,
}

impl<'a> TappedConsole<'a> {
    /// Stands in for `console`.
    pub fn new(console: &'a mut dyn LockstepConsole, tap: Tap) -> Self {
        TappedConsole { console, tap }
    }
}

impl LockstepConsole for TappedConsole<'_> {
    fn exchange(&mut self, down: &[u8], up: &mut Vec<u8>) -> Result<(), LinkError> {
        let before = up.len();
        self.tap.bytes(Direction::Down, down);
        self.tap.ticked(1000 * TICK_US);
        self.console.exchange(down, up)?;
        self.tap
            .bytes(Direction::Up, up.get(before..).unwrap_or_default());
        Ok(())
    }

    fn overran(&mut self) {
        self.console.overran();
    }

    fn ticks_limited(&self) -> Option<TicksLimited> {
        self.console.ticks_limited()
    }

    fn name(&self) -> &str {
        self.console.name()
    }
}

/// A solver whose solves are told.
pub struct TappedSolver<'a> {
    solver: &'a mut SceneSolver,
    tap: Tap,
    sketching: Option<Sketching>,
    /// Of the next solve, where it is another.
    tuned: Option<Tuning>,
    /// Before the next solve.
    acts: Vec<Act>,
}

impl<'a> TappedSolver<'a> {
    /// Stands in for `solver`.
    pub fn new(solver: &'a mut SceneSolver, tap: Tap) -> Self {
        if tap.is_for_replay() {
            solver.log_arrivals();
        }
        TappedSolver {
            solver,
            tap,
            sketching: None,
            tuned: None,
            acts: Vec::new(),
        }
    }

    /// Tells besides where needles, threads and tools of its scene are, for a file of the whole session.
    pub fn sketched(mut self, scene: &Scene) -> Self {
        if self.tap.is_for_replay() {
            self.sketching = Sketching::new(scene, self.solver);
        }
        self
    }

    /// The solver itself.
    pub fn solver(&self) -> &SceneSolver {
        self.solver
    }
}

impl Solve for TappedSolver<'_> {
    fn spare(&mut self, effort: Effort) -> Spared {
        self.solver.spare(effort)
    }

    fn tune(&mut self, plan: &Plan) {
        self.solver.tune(plan);
        self.tuned = Some(plan.tuning());
    }

    fn act(&mut self, act: Act) -> bool {
        self.acts.push(act);
        self.solver.act(act)
    }

    fn solve(&mut self, state: &Valid<State>) -> Solved {
        if !self.tap.is_heard() {
            return self.solver.solve(state);
        }
        let began = Instant::now();
        let solved = self.solver.solve(state);
        // A step that was given up on the way could not be run again.
        if work::is_stopped() {
            return solved;
        }
        let step_us = began.elapsed().as_secs_f64() * 1e6;
        let replay = self.tap.is_for_replay();
        let hash = if replay { self.solver.hash() } else { 0 };
        let sample = SolveSample::new(state, &solved, hash, &self.solver.take_arrivals());
        let sample = sample.with(&solved, self.solver.last(), self.solver.punctures());
        let tuned = self.tuned.take();
        self.tap.solve(SolveSample {
            step_us,
            tuned,
            acts: std::mem::take(&mut self.acts),
            ..sample
        });
        if let Some(sketching) = &mut self.sketching
            && let Some(sketch) = sketching.solved(self.solver, state.console_time_us())
        {
            self.tap.sketch(sketch);
        }
        solved
    }

    fn warm(&self) {
        self.solver.warm();
    }

    fn scene(&self) -> serde_json::Map<String, serde_json::Value> {
        self.solver.scene()
    }
}
