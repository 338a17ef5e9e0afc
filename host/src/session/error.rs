//! Why a scene has no solver, or no solution.
//!
//! Entry point: [`SolveError`].

use crate::fem::TissueError;
use crate::prescribed::PrescribedError;
use crate::scene::SceneError;
use crate::step::Status;
use miette::Diagnostic;
use thiserror::Error;

/// Why a scene has no solution at rest.
#[derive(Debug, Error, Diagnostic)]
pub enum SolveError {
    /// Nothing acts on the tissue.
    #[error("the scene has nothing to solve: no handle, no load, and no tool with a position")]
    #[diagnostic(help("add a `[[handle]]`, a `[[load]]`, or `position_m` to a `[[tool]]`"))]
    Nothing,
    /// The solver cannot be built.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Scene(#[from] SceneError),
    /// The tissue does not answer.
    #[error("the tissue cannot be solved: {0}")]
    Tissue(#[from] TissueError),
    /// A model to which tools stick does not take it.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Prescribed(#[from] PrescribedError),
    /// Nobody drives the needles.
    #[error("the scene's needles are held by a tool that nothing moves")]
    #[diagnostic(help(
        "add `[hand]` with way points for the driven tool, as in scenes/needle-slabs.toml"
    ))]
    NoHand,
    /// The way to the place could not be followed.
    #[error("the tissue found no rest {time_s:.3} s after the start: {}", status.name())]
    #[diagnostic(help(
        "let the hand go slower there, or less deep; `sutura run --lockstep` shows what the session does"
    ))]
    NoWay {
        /// Since the start of the scripts \[s\].
        time_s: f64,
        /// How the step ended.
        status: Status,
    },
    /// A tool could not be brought to its place.
    #[error("the tissue found no rest with the tools where the scene holds them: {}", .0.name())]
    #[diagnostic(help("move the tools' `position_m` less deep into the tissue"))]
    NoRest(Status),
    /// Tools touch too much where the scene holds them.
    #[error(
        "the tools touch more vertices where the scene holds them than a step has room for in contact, {room}"
    )]
    #[diagnostic(help(
        "take a coarser mesh or a smaller tool, or move the tools' `position_m` less deep into the tissue"
    ))]
    NoRoom {
        /// Most vertices in contact, with all tools together.
        room: usize,
    },
}
