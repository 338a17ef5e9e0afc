//! What a step did. Entry point: [`Step`]. Everything in it is a copy: later steps do not change it.

use crate::array::give;
use pyo3::exceptions::PyKeyError;
use pyo3::prelude::*;
use sutura_host::jaws::{JawsReport, Pads};
use sutura_host::needle::{NeedleReport, TipPlace};
use sutura_host::step::{StepReport, ToolContact};
use sutura_host::thread::{ThreadReport, ThreadTension};

/// What a step did.
#[pyclass(frozen, module = "sutura")]
pub struct Step(pub(crate) Box<StepReport>);

impl Step {
    /// A tool's contact; the driven tool's, or the first, without an id.
    fn find(&self, tool: Option<u8>) -> PyResult<&ToolContact> {
        let contacts = self.0.contacts();
        let found = match tool {
            Some(id) => contacts.iter().find(|contact| contact.id == id),
            None => contacts.first(),
        };
        found.ok_or_else(|| {
            let ids: Vec<_> = contacts.iter().map(|contact| contact.id).collect();
            let status = self.0.status.name();
            let tool = tool.map_or_else(|| "any tool".to_owned(), |id| format!("tool {id}"));
            PyKeyError::new_err(format!(
                "no contact of {tool}: the step ended with the status {status:?} and has contacts of the tools {ids:?}; look \
                 at `has_balance` first"
            ))
        })
    }
}

#[pymethods]
impl Step {
    /// How it ended: "ok", "waiting" for compliance columns, "behind" the tools, and others of the book.
    #[getter]
    fn status(&self) -> &'static str {
        self.0.status.name()
    }

    /// Whether a balance was found: else there are no contacts, needles and threads in it.
    #[getter]
    fn has_balance(&self) -> bool {
        self.0.status.has_balance()
    }

    /// Force on a tool \[N\], then moment about its grip \[N m\], (6,), world frame.
    #[pyo3(signature = (tool = None, *, out = None))]
    fn wrench<'py>(
        &self,
        py: Python<'py>,
        tool: Option<u8>,
        out: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        give(py, &self.find(tool)?.wrench, &[6], out)
    }

    /// d wrench / d pose for increments in the world frame, (6, 6) \[N/m, N, N m/rad\].
    #[pyo3(signature = (tool = None, *, out = None))]
    fn tangent<'py>(
        &self,
        py: Python<'py>,
        tool: Option<u8>,
        out: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        give(py, self.find(tool)?.tangent.as_flattened(), &[6, 6], out)
    }

    /// All of a tool's contact.
    #[pyo3(signature = (tool = None))]
    fn contact(&self, tool: Option<u8>) -> PyResult<Contact> {
        let contact = self.find(tool)?;
        let [fx, fy, fz, mx, my, mz] = contact.wrench;
        Ok(Contact {
            tool: contact.id,
            force_n: (fx, fy, fz),
            moment_nm: (mx, my, mz),
            gap_m: contact.gap_m,
            normal: contact.normal.into(),
            vertices: contact.rows,
        })
    }

    /// Needles, in the scene's order; none without a balance.
    #[getter]
    fn needles(&self) -> Vec<Needle> {
        self.0.needles().iter().map(Needle::from).collect()
    }

    /// Threads, in the scene's order; none without a balance.
    #[getter]
    fn threads(&self) -> Vec<Thread> {
        self.0.threads().iter().map(Thread::from).collect()
    }

    /// Jaws, in the scene's order; none without a balance.
    #[getter]
    fn jaws(&self) -> Vec<Jaws> {
        self.0.jaws().iter().map(Jaws::from).collect()
    }

    /// Touches: one for every vertex and tool.
    #[getter]
    fn rows(&self) -> u32 {
        self.0.rows
    }

    /// Newton iterations.
    #[getter]
    fn iterations(&self) -> u32 {
        self.0.iterations
    }

    /// Pieces into which the tools' path was cut.
    #[getter]
    fn substeps(&self) -> u32 {
        self.0.substeps
    }

    /// Largest of gap over radius and of tangential force over largest force.
    #[getter]
    fn residual(&self) -> f64 {
        self.0.residual
    }

    /// Out-of-balance force over the forces on tissue that is not linear.
    #[getter]
    fn imbalance(&self) -> f64 {
        self.0.imbalance
    }

    /// Elastic energy that the tools have put into the tissue \[J\].
    #[getter]
    fn stored_energy_j(&self) -> f64 {
        self.0.stored_energy_j
    }

    /// Dissipated by the friction of tools so far \[J\].
    #[getter]
    fn friction_j(&self) -> f64 {
        self.0.friction_j
    }

    fn __repr__(&self) -> String {
        let report = &self.0;
        let (status, rows, energy_j) = (report.status.name(), report.rows, report.stored_energy_j);
        format!("Step(status={status:?}, rows={rows}, stored_energy_j={energy_j:e})")
    }
}

/// Three numbers in the world frame.
type Triple = (f64, f64, f64);

/// What a tool feels.
#[pyclass(frozen, get_all, module = "sutura")]
pub struct Contact {
    /// Id of the tool.
    tool: u8,
    /// Force on the tool \[N\].
    force_n: Triple,
    /// Moment on the tool about its grip \[N m\].
    moment_nm: Triple,
    /// Distance to the tissue \[m\]; 0 in contact.
    gap_m: f64,
    /// Unit vector out of the tissue.
    normal: Triple,
    /// Vertices that it touches.
    vertices: u32,
}

/// A needle after a step.
#[pyclass(frozen, get_all, module = "sutura")]
pub struct Needle {
    /// Id of the needle.
    id: u8,
    /// Id of the tool that holds it.
    held_by: Option<u8>,
    /// Where its tip is: "outside", "holding" a boundary, "inside", "waiting".
    tip: &'static str,
    /// Faces of the mesh that it goes through.
    crossings: u32,
    /// Boundaries that it has broken through so far.
    punctures: u32,
    /// Places where its body touches the surface.
    touches: u32,
    /// Force of the tissue on it along itself \[N\], below zero against driving.
    axial_n: f64,
    /// Axial force of the tip on the face that it holds \[N\].
    hold_n: f64,
    /// Axial force that breaks through that \[N\]; infinite for never, 0 when it holds none.
    puncture_n: f64,
    /// Spent so far by friction, cutting, and forces let go \[J\].
    dissipated_j: Triple,
}

impl From<&NeedleReport> for Needle {
    fn from(report: &NeedleReport) -> Self {
        Self {
            id: report.id,
            held_by: report.held_by,
            tip: match report.tip {
                TipPlace::Outside => "outside",
                TipPlace::Holding => "holding",
                TipPlace::Inside => "inside",
                TipPlace::Waiting => "waiting",
            },
            crossings: report.crossings,
            punctures: report.punctures,
            touches: report.touches,
            axial_n: report.axial_n,
            hold_n: report.hold_n,
            puncture_n: report.puncture_n,
            dissipated_j: report.dissipated_j.into(),
        }
    }
}

/// A thread after a step. Pairs are of its tail and its head.
#[pyclass(frozen, get_all, module = "sutura")]
pub struct Thread {
    /// Id of the thread.
    id: u8,
    /// Whether any of it pulls: else it is slack.
    taut: bool,
    /// Tension \[N\].
    tension_n: (f64, f64),
    /// What there is of thread more than its path needs \[m\].
    slack_m: (f64, f64),
    /// Ids of the tools that hold it.
    held_by: (Option<u8>, Option<u8>),
    /// Boundary faces that it goes through.
    punctures: u32,
    /// Length of its path \[m\].
    length_m: f64,
    /// Drawn out of the tissue so far \[m\].
    pulled_m: (f64, f64),
    /// What has been broken off \[m\], if it has broken.
    broken_off_m: Option<f64>,
    /// Largest pressure on tissue at a passage \[Pa\].
    pressure_pa: f64,
}

impl From<&ThreadReport> for Thread {
    fn from(report: &ThreadReport) -> Self {
        Self {
            id: report.id,
            taut: report.state == ThreadTension::Taut,
            tension_n: report.tension_n.into(),
            slack_m: report.slack_m.into(),
            held_by: report.held_by.into(),
            punctures: report.punctures,
            length_m: report.length_m,
            pulled_m: report.pulled_m.into(),
            broken_off_m: report.broken_off_m,
            pressure_pa: report.pressure_pa,
        }
    }
}

/// Jaws after a step.
#[pyclass(frozen, get_all, module = "sutura")]
pub struct Jaws {
    /// Id of the tool that carries them.
    tool: u8,
    /// "open", "closing" or "closed".
    pads: &'static str,
    /// Points of tissue that they hold.
    points: u32,
    /// How many of these slipped.
    slipping: u32,
    /// Their force on the tissue \[N\].
    force_n: Triple,
}

impl From<&JawsReport> for Jaws {
    fn from(report: &JawsReport) -> Self {
        Self {
            tool: report.tool,
            pads: match report.pads {
                Pads::Open => "open",
                Pads::Closing => "closing",
                Pads::Closed => "closed",
            },
            points: report.points,
            slipping: report.slipping,
            force_n: report.force_n.into(),
        }
    }
}
