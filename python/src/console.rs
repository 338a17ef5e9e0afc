//! A console of one's own: pose in, contact out. Entry points from Python: `Console(port)`, `Console.virtual(scene)`.

use crate::array::{matrix, vector};
use crate::error::{self, ConsoleError, interrupted};
use crate::report::Step;
use crate::scene::Scene;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use sutura_client as client;
use sutura_client::message::Simulate;
use sutura_hil::VirtualConsole;
use sutura_host::session::{Plan, mode_word};
use sutura_host::step::Status;
use sutura_shared::wire::validate::name;

/// Between two looks for Ctrl-C while a pose is waited for.
const LOOK_EVERY: Duration = Duration::from_millis(50);
/// How far the length of a direction may be off 1, as on the wire.
const UNIT_TOLERANCE: f32 = 1e-3;
/// Longest times that arguments may give \[s\].
const MOST_WAIT_S: f64 = 3600.0;

/// An open session with a console, which renders what it was sent last at 1 kHz by itself.
#[pyclass(frozen, module = "sutura")]
pub struct Console(Mutex<Option<Arc<Held>>>);

struct Held {
    // Dropped first: it disarms the console.
    console: client::Console,
    _simulated: Option<Mutex<VirtualConsole>>,
}

/// The console at one tick.
#[pyclass(frozen, module = "sutura")]
pub struct Pose {
    /// Ticks since the console booted.
    #[pyo3(get)]
    tick: u32,
    /// Console time at which the encoders were read \[s\].
    #[pyo3(get)]
    time_s: f64,
    /// Grip position \[m\], world frame.
    #[pyo3(get)]
    position_m: (f32, f32, f32),
    /// Grip orientation, unit quaternion (x, y, z, w).
    #[pyo3(get)]
    orientation: (f32, f32, f32, f32),
    /// Grip velocity \[m/s\].
    #[pyo3(get)]
    velocity_m_per_s: (f32, f32, f32),
    /// Contact force commanded on the grip \[N\], after all guards.
    #[pyo3(get)]
    force_n: (f32, f32, f32),
    /// "idle", "armed", "decaying", "fault".
    #[pyo3(get)]
    mode: &'static str,
    /// Whether it renders force.
    #[pyo3(get)]
    is_armed: bool,
    /// Latched faults.
    #[pyo3(get)]
    faults: Vec<&'static str>,
    /// Age of the contact in use \[s\]; None before the first.
    #[pyo3(get)]
    contact_age_s: Option<f64>,
    inner: client::Pose,
}

impl From<client::Pose> for Pose {
    fn from(pose: client::Pose) -> Self {
        let [qx, qy, qz, qw] = pose.orientation;
        let age_us = pose.contact_age_us;
        Pose {
            tick: pose.tick,
            time_s: 1e-6 * pose.time_us as f64,
            position_m: pose.position_m.into(),
            orientation: (qx, qy, qz, qw),
            velocity_m_per_s: pose.velocity_m_per_s.into(),
            force_n: pose.force_n.into(),
            mode: mode_word(pose.mode),
            is_armed: pose.is_armed(),
            faults: pose.fault_names().collect(),
            contact_age_s: (age_us != u32::MAX).then(|| 1e-6 * f64::from(age_us)),
            inner: pose,
        }
    }
}

fn options(horizon_s: f64) -> PyResult<client::Options> {
    Ok(client::Options {
        horizon: duration("horizon_s", horizon_s)?,
        give_up: error::gives_up,
        ..client::Options::default()
    })
}

fn duration(name: &str, seconds: f64) -> PyResult<Duration> {
    if (0.0..=MOST_WAIT_S).contains(&seconds) {
        return Ok(Duration::from_secs_f64(seconds));
    }
    Err(PyValueError::new_err(format!(
        "{name} is {seconds}: give a time from 0 to {MOST_WAIT_S} s"
    )))
}

fn single<const N: usize>(name: &str, given: &Bound<'_, PyAny>) -> PyResult<[f32; N]> {
    Ok(vector(name, given)?.map(|number: f64| number as f32))
}

fn unit(name: &str, given: &Bound<'_, PyAny>) -> PyResult<[f32; 3]> {
    let direction: [f32; 3] = single(name, given)?;
    let length = direction.iter().map(|x| x * x).sum::<f32>().sqrt();
    if (length - 1.0).abs() > UNIT_TOLERANCE {
        return Err(PyValueError::new_err(format!(
            "{name} has the length {length}: give a unit vector"
        )));
    }
    Ok(direction)
}

impl Console {
    fn locked(&self) -> MutexGuard<'_, Option<Arc<Held>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Does something with the session, without Python's lock.
    fn with<T: Send>(
        &self,
        py: Python<'_>,
        act: impl FnOnce(&client::Console) -> Result<T, client::Error> + Send,
    ) -> PyResult<T> {
        let held = self.locked().clone().ok_or_else(|| {
            ConsoleError::new_err("this console is closed: open another `sutura.Console`")
        })?;
        py.detach(|| act(&held.console))
            .map_err(|error| error::of_link(&error))
    }
}

#[pymethods]
impl Console {
    /// Opens a session with the console on a serial port or pseudo-terminal. What it is sent may be used for `horizon_s` \[s\]
    /// after the pose that it was computed for.
    #[new]
    #[pyo3(signature = (port, *, horizon_s = 0.06))]
    fn new(py: Python<'_>, port: &str, horizon_s: f64) -> PyResult<Self> {
        let options = options(horizon_s)?;
        let console = py.detach(|| client::Console::open(port, options));
        let held = Held {
            console: console.map_err(|error| error::of_link(&error))?,
            _simulated: None,
        };
        Ok(Self(Mutex::new(Some(Arc::new(held)))))
    }

    /// A simulated console in this process, of a scene's device and in its hand.
    #[staticmethod]
    #[pyo3(name = "virtual", signature = (scene, *, horizon_s = 0.06))]
    fn simulated(py: Python<'_>, scene: &Scene, horizon_s: f64) -> PyResult<Self> {
        let options = options(horizon_s)?;
        let plan = Plan::of_scene(&scene.inner).map_err(|error| error::of_plan(&error))?;
        let opened = py.detach(|| {
            let mut simulated = VirtualConsole::start_in_memory(&plan.device)?;
            let console = client::Console::over(simulated.host_port()?, options)?;
            console.simulate(&Simulate::Hand(plan.hand))?;
            Ok(Held {
                console,
                _simulated: Some(Mutex::new(simulated)),
            })
        });
        let held = opened.map_err(|error| error::of_link(&error))?;
        Ok(Self(Mutex::new(Some(Arc::new(held)))))
    }

    /// What the console calls itself.
    #[getter]
    fn name(&self, py: Python<'_>) -> PyResult<String> {
        let hello = self.with(py, |console| Ok(console.info()))?;
        Ok(name(&hello.device_name).unwrap_or_default().to_owned())
    }

    /// Whether its motors and its hand are simulated.
    #[getter]
    fn is_simulated(&self, py: Python<'_>) -> PyResult<bool> {
        self.with(py, |console| Ok(console.info().simulated))
    }

    /// Whether a session is open now; else the console is away and looked for.
    #[getter]
    fn is_connected(&self, py: Python<'_>) -> PyResult<bool> {
        self.with(py, |console| Ok(console.is_connected()))
    }

    /// Turns the motors on; the force grows from 0.
    fn arm(&self, py: Python<'_>) -> PyResult<()> {
        self.with(py, client::Console::arm)
    }

    /// Turns the motors off.
    fn disarm(&self, py: Python<'_>) -> PyResult<()> {
        self.with(py, client::Console::disarm)
    }

    /// Leaves a latched fault whose cause is gone.
    fn clear_fault(&self, py: Python<'_>) -> PyResult<()> {
        self.with(py, client::Console::clear_fault)
    }

    /// The newest pose that was not read yet; waits for one up to `timeout_s` \[s\], None if none came.
    #[pyo3(signature = (timeout_s = 0.5))]
    fn pose(&self, py: Python<'_>, timeout_s: f64) -> PyResult<Option<Pose>> {
        let until = Instant::now() + duration("timeout_s", timeout_s)?;
        loop {
            let left = until.saturating_duration_since(Instant::now());
            let pose = self.with(py, |console| console.pose(left.min(LOOK_EVERY)))?;
            if pose.is_some() || left <= LOOK_EVERY {
                return Ok(pose.map(Pose::from));
            }
            interrupted()?;
        }
    }

    /// Sends the force on the grip at `pose` \[N\], (3,), of something with the outward unit `normal`, (3,), and how the force
    /// changes with the grip's position from there, `stiffness` \[N/m\], (3, 3); or how far it is away, `gap_m` \[m\], without a
    /// force. Without a normal the force is held as it is.
    #[pyo3(signature = (pose, force_n, normal = None, *, stiffness = None, gap_m = 0.0))]
    fn send_contact(
        &self,
        py: Python<'_>,
        pose: &Pose,
        force_n: &Bound<'_, PyAny>,
        normal: Option<&Bound<'_, PyAny>>,
        stiffness: Option<&Bound<'_, PyAny>>,
        gap_m: f64,
    ) -> PyResult<()> {
        let force_n = single("force_n", force_n)?;
        let mut contact = match normal {
            Some(normal) => client::Contact::touching(force_n, unit("normal", normal)?),
            None => client::Contact::force(force_n),
        };
        contact.gap_m = gap_m as f32;
        if let Some(stiffness) = stiffness {
            let rows = matrix("stiffness", stiffness)?;
            contact = contact.with_stiffness(rows.map(|row| row.map(|number| number as f32)));
        }
        let pose = pose.inner;
        self.with(py, |console| console.send_contact(&pose, &contact))
    }

    /// Sends what a scene's driven tool feels in a step that was taken at `pose`; whether that ended "ok", else nothing is sent.
    fn send_step(&self, py: Python<'_>, pose: &Pose, step: &Step) -> PyResult<bool> {
        // One that is behind has the balance of another pose.
        let felt = step.0.contacts().first();
        let Some(felt) = felt.filter(|_| step.0.status == Status::Ok) else {
            return Ok(false);
        };
        let [fx, fy, fz, mx, my, mz] = felt.wrench.map(|number| number as f32);
        let contact = client::Contact {
            force_n: [fx, fy, fz],
            moment_nm: [mx, my, mz],
            tangent: felt.tangent.map(|row| row.map(|number| number as f32)),
            gap_m: felt.gap_m as f32,
            normal: felt.normal.map(|number| number as f32),
            relaxation_per_s: 0.0,
        };
        let pose = pose.inner;
        self.with(py, |console| console.send_contact(&pose, &contact))?;
        Ok(true)
    }

    /// Disarms the console and ends the session.
    fn close(&self, py: Python<'_>) {
        let held = self.locked().take();
        py.detach(|| drop(held));
    }

    fn __enter__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    #[pyo3(signature = (*_args))]
    fn __exit__(&self, py: Python<'_>, _args: &Bound<'_, pyo3::types::PyTuple>) {
        self.close(py);
    }
}
