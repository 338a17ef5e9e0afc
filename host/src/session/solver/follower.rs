//! What follows a scene's tools and says what each of them feels: tissue with constraints, or a model to which tools stick.
//!
//! Entry point: [`Follower::follow`].

use super::constrained::Constrained;
use crate::prescribed::Prescribed;
use crate::step::{StepOptions, StepReport};
use crate::tool::ToolSample;
use serde_json::{Map, Value};
use std::borrow::Cow;

/// One of the two.
pub(super) enum Follower {
    /// Nodes go where forces and constraints balance.
    Constrained(Box<Constrained>),
    /// Nodes go where tools take them.
    Prescribed(Box<Prescribed>),
}

impl Follower {
    /// Follows the tools to `samples`, as far as a step goes. Where there is a balance there is a contact for each.
    pub fn follow(&mut self, samples: &[ToolSample], options: &StepOptions) -> StepReport {
        match self {
            Self::Constrained(tissue) => tissue.step(samples, options),
            Self::Prescribed(tissue) => tissue.follow(samples),
        }
    }

    /// Where the last step has a tool that was sampled at `sample`.
    pub fn reached(&self, sample: &ToolSample) -> ToolSample {
        match self {
            Self::Constrained(tissue) => tissue.state.reached(&tissue.model, sample),
            Self::Prescribed(tissue) => tissue.reached(sample),
        }
    }

    /// Tissue with constraints, if that is what follows.
    pub fn constrained(&mut self) -> Option<&mut Constrained> {
        match self {
            Self::Constrained(tissue) => Some(tissue),
            Self::Prescribed(_) => None,
        }
    }

    /// Hash of its state, to the bit.
    pub fn hash(&self) -> u64 {
        match self {
            Self::Constrained(tissue) => tissue.state.hash(),
            Self::Prescribed(tissue) => tissue.hash(),
        }
    }

    /// Where every node is \[m\], (n x 3).
    pub fn positions_m(&self) -> Cow<'_, [[f64; 3]]> {
        match self {
            Self::Constrained(tissue) => tissue.state.positions(&tissue.model).into(),
            Self::Prescribed(tissue) => tissue.positions_m().into(),
        }
    }

    /// How many nodes it has.
    pub fn nodes(&self) -> usize {
        match self {
            Self::Constrained(tissue) => tissue.model.points_m().len(),
            Self::Prescribed(tissue) => tissue.positions_m().len(),
        }
    }

    /// Whether a step linearises nothing anew.
    pub fn is_linear(&self) -> bool {
        matches!(self, Self::Constrained(tissue) if tissue.model.body.is_linear())
    }

    /// Whether a tool rubs.
    pub fn rubs(&self, tool: u8) -> bool {
        match self {
            Self::Constrained(tissue) => {
                let found = tissue.model.tool(tool);
                found.is_some_and(|(_, tool)| !tool.is_grip() && !tool.is_smooth())
            }
            Self::Prescribed(_) => false,
        }
    }

    /// Whether tissue remembers which way tools came, needles aside.
    pub fn remembers(&self) -> bool {
        match self {
            Self::Constrained(tissue) => {
                tissue.wound.is_some() || tissue.rubs() || tissue.model.has_jaws()
            }
            Self::Prescribed(_) => true,
        }
    }

    /// Whether the last step is withheld because its force means nothing.
    pub fn is_unfinished(&self) -> bool {
        matches!(self, Self::Prescribed(tissue) if tissue.is_unfinished())
    }

    /// Its own part of a session's summary; `last` is the newest step that found a balance.
    pub fn said(&self, last: &StepReport) -> Map<String, Value> {
        let mut said = Map::new();
        match self {
            Self::Constrained(tissue) => {
                let added = tissue.state.added(&tissue.model).into_iter();
                let added: Map<_, _> = added
                    .map(|(name, values)| {
                        let values = values.into_iter();
                        let values = values.map(|(key, value)| (key.to_owned(), value.into()));
                        (name, Value::Object(values.collect()))
                    })
                    .collect();
                if tissue.rubs() {
                    said.insert("friction_j".to_owned(), last.friction_j.into());
                }
                if !added.is_empty() {
                    said.insert("added".to_owned(), added.into());
                }
            }
            Self::Prescribed(tissue) => {
                said.insert("model".to_owned(), tissue.said());
            }
        }
        said
    }
}
