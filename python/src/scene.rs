//! A checked scene. Entry points from Python: `Scene.load`, `Scene.from_toml`; a dict becomes the text of a file first.

use crate::array::give;
use crate::error;
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use std::ffi::OsString;
use std::path::PathBuf;
use std::sync::Arc;
use sutura_host::scene::{self, Document, Sources};

/// A checked scene: tissue, tools, needles, threads. It does not change.
#[pyclass(frozen, module = "sutura")]
pub struct Scene {
    pub(crate) inner: Arc<scene::Scene>,
    /// Its text, and the files that it names.
    pub(crate) sources: Sources,
    /// Files that it was read from, by absolute paths.
    pub(crate) read: Vec<PathBuf>,
    warnings: Vec<String>,
}

impl Scene {
    fn read(
        py: Python<'_>,
        before: Vec<PathBuf>,
        document: impl FnOnce() -> Result<Document, scene::SceneError> + Send,
    ) -> PyResult<Self> {
        let read = py.detach(|| {
            let document = document()?;
            let scene = scene::read(&document)?;
            let files = before.into_iter().chain(document.paths()).collect();
            Ok((scene, document.sources(), files))
        });
        let (mut inner, sources, files) =
            read.map_err(|error: scene::SceneError| error::of_scene(&error))?;
        let warnings = inner.warnings.drain(..);
        Ok(Self {
            warnings: warnings.map(|warning| error::text(&warning)).collect(),
            inner: Arc::new(inner),
            sources,
            read: files,
        })
    }
}

#[pymethods]
impl Scene {
    /// Reads a scene file, and the files that it names.
    #[staticmethod]
    #[pyo3(text_signature = "(path)")]
    fn load(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        Self::read(py, Vec::new(), || Document::read(&path))
    }

    /// Reads the text of a scene file; paths in it begin at `directory`.
    #[staticmethod]
    #[pyo3(signature = (text, *, directory = PathBuf::new(), name = "scene.toml"))]
    fn from_toml(py: Python<'_>, text: &str, directory: PathBuf, name: &str) -> PyResult<Self> {
        Self::read(py, Vec::new(), || {
            Ok(Document::embedded(name, &directory, text))
        })
    }

    /// For people.
    #[getter]
    fn name(&self) -> &str {
        &self.inner.name
    }

    /// The text of its file.
    #[getter]
    fn toml(&self) -> &str {
        &self.sources.text
    }

    /// Name of the tissue model.
    #[getter]
    fn tissue(&self) -> &'static str {
        self.inner.tissue.word()
    }

    /// Length of a session \[s\].
    #[getter]
    fn seconds(&self) -> f64 {
        self.inner.seconds
    }

    /// Solver steps a second \[Hz\].
    #[getter]
    fn host_hz(&self) -> f64 {
        self.inner.host.host_hz
    }

    /// What is allowed but probably not meant, as the command says it.
    #[getter]
    fn warnings(&self) -> Vec<String> {
        self.warnings.clone()
    }

    /// Ids of the tools.
    #[getter]
    fn tools(&self) -> Vec<u32> {
        self.inner.tools.iter().map(|tool| tool.id.into()).collect()
    }

    /// Id of the tool that the hand carries.
    #[getter]
    fn driven(&self) -> Option<u8> {
        self.inner.driven().map(|tool| tool.id)
    }

    /// Ids of the needles.
    #[getter]
    fn needles(&self) -> Vec<u32> {
        self.inner
            .needles
            .iter()
            .map(|needle| needle.id.into())
            .collect()
    }

    /// Ids of the threads.
    #[getter]
    fn threads(&self) -> Vec<u32> {
        self.inner
            .threads
            .iter()
            .map(|thread| thread.part.id.into())
            .collect()
    }

    /// Node positions at rest without load \[m\], (n, 3).
    #[pyo3(signature = (*, out = None))]
    fn points_m<'py>(
        &self,
        py: Python<'py>,
        out: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let points_m = self.inner.mesh.points_m();
        give(py, points_m.as_flattened(), &[points_m.len(), 3], out)
    }

    /// Nodes of each cell, (m, 4), uint32.
    #[pyo3(signature = (*, out = None))]
    fn cells<'py>(
        &self,
        py: Python<'py>,
        out: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let cells = self.inner.mesh.cells();
        give(py, cells.as_flattened(), &[cells.len(), 4], out)
    }

    /// Nodes of each boundary triangle, counter-clockwise seen from outside, (f, 3), uint32.
    #[pyo3(signature = (*, out = None))]
    fn triangles<'py>(
        &self,
        py: Python<'py>,
        out: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let surface = self.inner.mesh.surface();
        let triangles = &surface.triangles;
        give(py, triangles.as_flattened(), &[triangles.len(), 3], out)
    }

    /// Nodes that do not move, ascending, (k,), uint32.
    #[pyo3(signature = (*, out = None))]
    fn fixed<'py>(
        &self,
        py: Python<'py>,
        out: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        give(py, &self.inner.fixed, &[self.inner.fixed.len()], out)
    }

    fn __repr__(&self) -> String {
        let scene = &self.inner;
        format!(
            "Scene({:?}: {} tissue, {} nodes, {} cells)",
            scene.name,
            scene.tissue.word(),
            scene.mesh.points_m().len(),
            scene.mesh.cells().len()
        )
    }

    /// A scene is its text and its files, wherever it goes; and what those were read from is written over nowhere.
    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<(Bound<'py, PyAny>, Parts<'py>)> {
        let rebuild = slf.py().get_type::<Self>().getattr("_from_parts")?;
        let Sources { name, text, files } = slf.get().sources.clone();
        let read = slf
            .get()
            .read
            .iter()
            .map(|path| path.clone().into_os_string());
        let read = read.collect();
        let files = files.into_iter();
        let files = files
            .map(|(path, bytes)| (path, PyBytes::new(slf.py(), &bytes)))
            .collect();
        Ok((rebuild, (name, text, files, read)))
    }

    #[staticmethod]
    #[pyo3(signature = (name, text, files, read = Vec::new()))]
    fn _from_parts(
        py: Python<'_>,
        name: String,
        text: String,
        files: Vec<(String, Vec<u8>)>,
        read: Vec<OsString>,
    ) -> PyResult<Self> {
        let read = read.into_iter().map(PathBuf::from).collect();
        let files = files.into_iter().collect();
        Self::read(py, read, || {
            Ok(Document::from_sources(&Sources { name, text, files }))
        })
    }
}

/// Name, text, files by their paths, and the paths that it was read from.
type Parts<'py> = (
    String,
    String,
    Vec<(String, Bound<'py, PyBytes>)>,
    Vec<OsString>,
);
