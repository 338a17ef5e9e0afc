//! What a session gives the console to render from.
//!
//! Entry point: [`Rendering`].

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What the console is given to render from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum Rendering {
    /// The contact's force alone.
    Hold,
    /// The contact with its tangent, and nothing else.
    Tangent,
    /// Besides, the contact's rows, as many as the line carries, and the states of needle and thread.
    #[default]
    Rows,
}

impl Rendering {
    /// In one word.
    pub fn word(self) -> &'static str {
        match self {
            Rendering::Hold => "hold",
            Rendering::Tangent => "tangent",
            Rendering::Rows => "rows",
        }
    }
}
