//! A scene's solver, stepped with poses. Entry point: [`Solver`].
//!
//! Python's lock is released in steps. A solver that one thread uses refuses another: it never waits, and never mixes two ways.

use crate::array::{give, vector};
use crate::error::{BusyError, SolveError, apart, of_solve};
use crate::report::Step;
use crate::scene::Scene;
use pyo3::exceptions::{PyKeyError, PyValueError};
use pyo3::prelude::*;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, TryLockError};
use sutura_host::output::{Drawn, Line, Part};
use sutura_host::scene::{self, Pose};
use sutura_host::script::at_rest;
use sutura_host::session::{self, SceneSolver};
use sutura_host::step::{Status, StepReport};
use sutura_host::tool::Act;

/// As far as the square of a quaternion's length may be from 1, as on the wire.
const UNIT_TOLERANCE: f64 = 1e-3;
/// Upright.
const UPRIGHT: [f64; 4] = [0.0, 0.0, 0.0, 1.0];

/// Position and orientation as Python gives them.
type GivenPose<'py> = (Bound<'py, PyAny>, Bound<'py, PyAny>);

/// A scene's solver: it follows poses of tools and says what they feel.
#[pyclass(frozen, module = "sutura")]
pub struct Solver {
    scene: Arc<scene::Scene>,
    inside: Mutex<Inside>,
}

struct Inside {
    solver: SceneSolver,
    /// Of the last step, counted from the first one's start \[s\]; none before the first step.
    time_s: Option<f64>,
}

/// A solver's state between two steps, to go back to.
#[pyclass(frozen, module = "sutura")]
pub struct Moment {
    scene: Arc<scene::Scene>,
    moment: session::Moment,
    time_s: Option<f64>,
}

impl Solver {
    /// # Errors
    /// [`BusyError`] while another thread is inside.
    fn inside(&self) -> PyResult<MutexGuard<'_, Inside>> {
        match self.inside.try_lock() {
            Ok(inside) => Ok(inside),
            // What a panic left is looked at as it is: the panic itself was raised.
            Err(TryLockError::Poisoned(poisoned)) => Ok(poisoned.into_inner()),
            Err(TryLockError::WouldBlock) => Err(BusyError::new_err(
                "this solver is in use by another thread: give each thread a solver of its own, or let one wait for the other \
                 with a threading.Lock",
            )),
        }
    }

    /// Needles, threads and tools as lines.
    fn lines(&self, inside: &Inside) -> Vec<Line> {
        let solver = &inside.solver;
        let tissue = solver.parts().map(|(model, state, _)| (model, state));
        Drawn::of(
            &self.scene,
            &solver.positions_m(),
            tissue,
            None,
            solver.samples(),
        )
        .lines
    }

    /// The lines of one needle or thread.
    ///
    /// # Errors
    /// KeyError for an id that is not the scene's.
    fn lines_of(&self, part: Part, id: u8, known: Vec<u8>) -> PyResult<Vec<Line>> {
        let what = if part == Part::Needle {
            "needle"
        } else {
            "thread"
        };
        if !known.contains(&id) {
            let message = format!("no {what} has the id {id}: the scene's {what}s are {known:?}");
            return Err(PyKeyError::new_err(message));
        }
        let lines = self.lines(&*self.inside()?).into_iter();
        Ok(lines
            .filter(|line| line.part == part && line.id == id)
            .collect())
    }
}

#[pymethods]
impl Solver {
    /// Builds a scene's solver, and brings the tools that are held to their places.
    #[new]
    fn new(py: Python<'_>, scene: &Scene) -> PyResult<Self> {
        let scene = scene.inner.clone();
        let built = scene.clone();
        let solver = apart(py, move || SceneSolver::new(&built))?;
        let solver = solver.map_err(|error| of_solve(&error))?;
        let inside = Mutex::new(Inside {
            solver,
            time_s: None,
        });
        Ok(Self { scene, inside })
    }

    /// Steps with the driven tool's grip at `position_m` \[m\], (3,), turned by the unit quaternion `orientation`, (4,),
    /// (x, y, z, w), at `time_s` \[s\] after the start: a solver's period after the last step when left out, 0 in the first
    /// step. Tools that the hand does not carry follow their scripts, but those of `tools`, by id: these are from now on at
    /// (position, orientation). While the status is "waiting" or "behind" the step is taken again, `most_steps` times in
    /// all.
    #[pyo3(signature = (position_m, orientation = None, *, time_s = None, velocity_m_per_s = None, tools = None, most_steps = 1))]
    #[expect(clippy::too_many_arguments, reason = "by name, in Python")]
    fn step(
        &self,
        py: Python<'_>,
        position_m: &Bound<'_, PyAny>,
        orientation: Option<&Bound<'_, PyAny>>,
        time_s: Option<f64>,
        velocity_m_per_s: Option<&Bound<'_, PyAny>>,
        tools: Option<BTreeMap<u8, GivenPose<'_>>>,
        most_steps: u32,
    ) -> PyResult<Step> {
        let pose = pose(position_m, orientation)?;
        let velocity_m_per_s = match velocity_m_per_s {
            Some(given) => vector("velocity_m_per_s", given)?,
            None => [0.0; 3],
        };
        if most_steps == 0 {
            return Err(PyValueError::new_err("most_steps is 0: give 1 or more"));
        }
        let mut inside = self.inside()?;
        let Some(driven) = inside.solver.driven() else {
            return Err(SolveError::new_err(format!(
                "the scene {:?} has no tool that a hand carries: add a [[tool]] to it",
                self.scene.name
            )));
        };
        let time_s = inside.next_s(time_s, 1.0 / self.scene.host.host_hz)?;
        let mut placed = Vec::new();
        for (id, (position_m, orientation)) in tools.iter().flatten() {
            placed.push((*id, self::pose(position_m, Some(orientation))?));
        }
        for (id, pose) in &placed {
            if !inside.solver.place(*id, pose) {
                let others: Vec<_> = self.scene.held().map(|(tool, _)| tool.id).collect();
                return Err(PyKeyError::new_err(format!(
                    "tools[{id}]: the tools that the hand does not carry are {others:?}; the driven tool, {driven}, goes by \
                     position_m"
                )));
            }
        }
        let mut sample = at_rest(driven, &pose);
        sample.velocity_m_per_s = velocity_m_per_s;
        sample.console_time_us = (1e6 * time_s).round() as u64;
        let inside = &mut *inside;
        let report = py.detach(|| inside.step(sample, most_steps));
        inside.time_s = Some(time_s);
        Ok(Step(report))
    }

    /// Time of steps at grips (k, 3) \[m\] one after the other, each with a wrench copied out, without Python \[us\], (k,): what a
    /// step from Python is compared with.
    fn _steps_us<'py>(
        &self,
        py: Python<'py>,
        positions_m: Vec<[f64; 3]>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let mut inside = self.inside()?;
        let driven = inside.solver.driven().unwrap_or_default();
        let period_s = 1.0 / self.scene.host.host_hz;
        let mut times_us = Vec::with_capacity(positions_m.len());
        for position_m in positions_m {
            let time_s = inside.next_s(None, period_s)?;
            let pose = Pose {
                position_m,
                orientation: UPRIGHT,
            };
            let start = std::time::Instant::now();
            let mut sample = at_rest(driven, &pose);
            sample.console_time_us = (1e6 * time_s).round() as u64;
            let report = inside.step(sample, 1);
            std::hint::black_box(report.contacts().first().map(|contact| contact.wrench));
            times_us.push(1e6 * start.elapsed().as_secs_f64());
            inside.time_s = Some(time_s);
        }
        give(py, &times_us, &[times_us.len()], None)
    }

    /// The last step's.
    #[getter]
    fn last(&self) -> PyResult<Step> {
        Ok(Step(Box::new(*self.inside()?.solver.last())))
    }

    /// Time of the last step \[s\]; None before the first.
    #[getter]
    fn time_s(&self) -> PyResult<Option<f64>> {
        Ok(self.inside()?.time_s)
    }

    /// Has a tool's jaws close before the next step; whether the tool can.
    fn close(&self, tool: u8) -> PyResult<bool> {
        Ok(self.inside()?.solver.act(Act::Close(tool)))
    }

    /// Has a tool's jaws open before the next step; whether the tool can.
    fn open(&self, tool: u8) -> PyResult<bool> {
        Ok(self.inside()?.solver.act(Act::Open(tool)))
    }

    /// Where every node is \[m\], (n, 3).
    #[pyo3(signature = (*, out = None))]
    fn positions_m<'py>(
        &self,
        py: Python<'py>,
        out: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let inside = self.inside()?;
        let nodes_m = inside.solver.positions_m();
        give(py, nodes_m.as_flattened(), &[nodes_m.len(), 3], out)
    }

    /// How far every node is from where it is without load \[m\], (n, 3).
    #[pyo3(signature = (*, out = None))]
    fn displacement_m<'py>(
        &self,
        py: Python<'py>,
        out: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let displacement_m = self.inside()?.displacement_m(&self.scene);
        give(
            py,
            displacement_m.as_flattened(),
            &[displacement_m.len(), 3],
            out,
        )
    }

    /// Principal stresses of each cell \[Pa\], descending, tension positive, (m, 3).
    #[pyo3(signature = (*, out = None))]
    fn stress_pa<'py>(
        &self,
        py: Python<'py>,
        out: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let inside = self.inside()?;
        let Some((model, _, _)) = inside.solver.parts() else {
            return Err(no_such(&self.scene, "stresses"));
        };
        let displacement_m = inside.displacement_m(&self.scene);
        let stress_pa = py.detach(|| model.principal_stress_pa(&displacement_m));
        give(py, stress_pa.as_flattened(), &[stress_pa.len(), 3], out)
    }

    /// Points of a needle's centre line from its end to its tip \[m\], (33, 3).
    #[pyo3(signature = (needle, *, out = None))]
    fn needle_path_m<'py>(
        &self,
        py: Python<'py>,
        needle: u8,
        out: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let known = self.scene.needles.iter().map(|needle| needle.id).collect();
        let lines = self.lines_of(Part::Needle, needle, known)?;
        let path_m = lines.first().map_or(&[][..], |line| &line.points_m);
        give(py, path_m.as_flattened(), &[path_m.len(), 3], out)
    }

    /// A thread's pieces, one if it is whole, each from tail to head: points \[m\], (k, 3), and the tension from each to the
    /// next \[N\], (k,).
    fn thread_path<'py>(
        &self,
        py: Python<'py>,
        thread: u8,
    ) -> PyResult<Vec<(Bound<'py, PyAny>, Bound<'py, PyAny>)>> {
        let known = self
            .scene
            .threads
            .iter()
            .map(|thread| thread.part.id)
            .collect();
        let pieces = self.lines_of(Part::Thread, thread, known)?;
        let arrays = pieces.iter().map(|line| {
            let count = line.points_m.len();
            let points_m = give(py, line.points_m.as_flattened(), &[count, 3], None)?;
            Ok((points_m, give(py, &line.tension_n, &[count], None)?))
        });
        arrays.collect()
    }

    /// Its state between two steps, to go back to; copies it.
    fn moment(&self) -> PyResult<Moment> {
        let inside = self.inside()?;
        let Some(moment) = inside.solver.moment() else {
            return Err(no_such(&self.scene, "moments"));
        };
        let (scene, time_s) = (self.scene.clone(), inside.time_s);
        Ok(Moment {
            scene,
            moment,
            time_s,
        })
    }

    /// Goes on from a moment of this solver, or of another one of the same Scene.
    fn go_on_from(&self, moment: &Moment) -> PyResult<()> {
        if !Arc::ptr_eq(&self.scene, &moment.scene) {
            return Err(PyValueError::new_err(format!(
                "this moment is of another Scene ({:?}) than the solver ({:?}): build both solvers from one Scene object",
                moment.scene.name, self.scene.name
            )));
        }
        let mut inside = self.inside()?;
        inside.solver.go_on_from(&moment.moment);
        inside.time_s = moment.time_s;
        Ok(())
    }

    /// Hash of its state, to the bit.
    fn hash(&self) -> PyResult<u64> {
        Ok(self.inside()?.solver.hash())
    }

    fn __repr__(&self) -> String {
        format!(
            "Solver({:?}: {} tissue)",
            self.scene.name,
            self.scene.tissue.word()
        )
    }
}

impl Inside {
    /// When the next step is \[s\].
    ///
    /// # Errors
    /// ValueError for no time of a session, and for one before the last step's.
    fn next_s(&self, asked_s: Option<f64>, period_s: f64) -> PyResult<f64> {
        let Some(asked_s) = asked_s else {
            return Ok(self.time_s.map_or(0.0, |last_s| last_s + period_s));
        };
        let from_s = self.time_s.unwrap_or(0.0);
        if (from_s..=scene::LONGEST_S).contains(&asked_s) {
            return Ok(asked_s);
        }
        let longest_s = scene::LONGEST_S;
        Err(PyValueError::new_err(format!(
            "time_s is {asked_s}: give a time from the last step's, {from_s} s, to {longest_s} s; `go_on_from` goes back"
        )))
    }

    /// The step and its repeats.
    fn step(&mut self, sample: sutura_host::tool::ToolSample, most_steps: u32) -> Box<StepReport> {
        let mut report = Box::new(self.solver.step(sample));
        for _ in 1..most_steps {
            if !matches!(report.status, Status::Waiting | Status::Behind) {
                break;
            }
            *report = self.solver.step(sample);
        }
        report
    }

    fn displacement_m(&self, scene: &scene::Scene) -> Vec<[f64; 3]> {
        let nodes_m = self.solver.positions_m();
        let ways = nodes_m.iter().zip(scene.mesh.points_m());
        ways.map(|(at, from)| std::array::from_fn(|axis| at[axis] - from[axis]))
            .collect()
    }
}

fn no_such(scene: &scene::Scene, what: &str) -> PyErr {
    SolveError::new_err(format!(
        "{} tissue has no {what}: take `linear`, `corotational` or `hyperelastic` in [tissue]",
        scene.tissue.word()
    ))
}

/// A grip's pose.
fn pose(position_m: &Bound<'_, PyAny>, orientation: Option<&Bound<'_, PyAny>>) -> PyResult<Pose> {
    let position_m = vector("position_m", position_m)?;
    let orientation = match orientation {
        Some(given) => vector("orientation", given)?,
        None => UPRIGHT,
    };
    let square: f64 = orientation.iter().map(|x| x * x).sum();
    if (square - 1.0).abs() > UNIT_TOLERANCE {
        return Err(PyValueError::new_err(format!(
            "orientation has the length {}: give a unit quaternion (x, y, z, w)",
            square.sqrt()
        )));
    }
    Ok(Pose {
        position_m,
        orientation,
    })
}
