//! In the place of live channels in a build without them.

use super::PageArgs;
use crate::failure::{Cause, Failure};
use std::sync::Arc;
use sutura_host::recording::SolveSample;
use sutura_shared::wire::message::State;
use sutura_view::Shared;

/// Nothing: there are none.
pub enum Live {}

/// Nothing: there are none.
pub enum Tap {}

impl Live {
    /// None, if none are asked for.
    ///
    /// # Errors
    /// They are.
    pub fn open(args: &PageArgs, _: &Arc<Shared>) -> Result<Option<Live>, Failure> {
        if !args.foxglove {
            return Ok(None);
        }
        let message = "this program was built without live channels";
        let help =
            "build it with the Cargo feature `foxglove`: cargo run --release --features foxglove";
        Err(Failure::say(Cause::BadInput, message, help))
    }

    /// Never.
    pub fn tap(&self) -> Tap {
        match *self {}
    }
}

impl Tap {
    /// Never.
    pub fn state(&self, _: &State) {
        match *self {}
    }

    /// Never.
    pub fn solve(&self, _: &SolveSample) {
        match *self {}
    }
}
