//! In the place of a page in a build without one.

use super::PageArgs;
use crate::attendant::Operator;
use crate::failure::{Cause, Failure};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use sutura_host::picture::Offer;
use sutura_host::recording::{Saver, Seen};
use sutura_host::scene::Scene;
use sutura_host::session::{Attendant, Plan, Progress, SceneSolver, ViewSummary};

/// Nothing: there is none.
pub enum Viewed {}

/// Why there is no page.
pub fn missing() -> Failure {
    let message = "this program was built without its page";
    Failure::say(
        Cause::BadInput,
        message,
        "build it with the Cargo feature `view`",
    )
}

impl Viewed {
    /// Says why there is no page.
    ///
    /// # Errors
    /// Always.
    pub fn open(_: &PageArgs) -> Result<Viewed, Failure> {
        Err(missing())
    }

    /// Says why there is nothing of it.
    ///
    /// # Errors
    /// Always.
    pub fn inside(_: &PageArgs) -> Result<Viewed, Failure> {
        Err(missing())
    }

    /// Never.
    pub fn begin(
        &mut self,
        _: &Scene,
        _: &Plan,
        _: &SceneSolver,
        _: &str,
        _: bool,
    ) -> Result<(), Failure> {
        match *self {}
    }

    /// Never.
    pub fn offer(&self) -> Option<Arc<Offer>> {
        match *self {}
    }

    /// Never.
    pub fn seen(&self) -> Option<Seen> {
        match *self {}
    }

    /// Never.
    pub fn kept(&self) -> Option<&Path> {
        match *self {}
    }

    /// Never.
    pub fn attendant(
        &mut self,
        _: Operator,
        _: &Plan,
        _: bool,
        _: (Saver, PathBuf),
    ) -> Box<dyn Attendant> {
        match *self {}
    }

    /// Never.
    pub fn progress(&self, _: &Progress<'_>) {
        match *self {}
    }

    /// Never.
    pub fn end(&mut self) -> Option<ViewSummary> {
        match *self {}
    }

    /// Never.
    pub fn was_seen(&self) -> bool {
        match *self {}
    }

    /// Never.
    ///
    /// # Errors
    /// None.
    pub fn stay(&self, _: &Path, _: &AtomicBool) -> Result<(), Failure> {
        match *self {}
    }
}

/// Nobody could look at a page that there is not.
pub fn has_desktop() -> bool {
    false
}
