//! The word with which a session ends, and whether its forces can be trusted.
//!
//! Entry point: [`Ending`]. Of several endings the first in the order of [`EndingKind`] counts.

use std::fmt;

/// Ways in which a session ends, the gravest first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum EndingKind {
    /// A fault is latched.
    Fault,
    /// Steps found a force, and it was not felt.
    NotRendered,
    /// A tool was inside the tissue.
    Inside,
    /// Parts of the tissue that may touch are in each other.
    Overlap,
    /// A force was felt, and no step found a contact.
    Untouched,
    /// Tools lagged behind the hand by more than they touched, or for long and touched nothing.
    Behind,
    /// The tool touched, and no finger notices the largest force.
    Faint,
    /// A person stopped the console, and nobody armed it again.
    Stopped,
    /// The console let go by itself.
    Idle,
    /// Limits of the device, or its energy account, took a part of the force away.
    Limited,
    /// None of these.
    #[default]
    Ok,
}

impl EndingKind {
    /// Stable word, as `status` begins.
    pub fn word(self) -> &'static str {
        match self {
            Self::Fault => "fault",
            Self::NotRendered => "not-rendered",
            Self::Inside => "inside",
            Self::Overlap => "overlap",
            Self::Untouched => "untouched",
            Self::Behind => "behind",
            Self::Faint => "faint",
            Self::Stopped => "stopped",
            Self::Idle => "idle",
            Self::Limited => "limited",
            Self::Ok => "ok",
        }
    }

    /// Whether what was felt is none that the solver stands for.
    pub fn is_untrusted(self) -> bool {
        matches!(
            self,
            Self::NotRendered
                | Self::Inside
                | Self::Overlap
                | Self::Untouched
                | Self::Behind
                | Self::Faint
        )
    }
}

/// Ways in which a session can end.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Ending {
    /// Returns the gravest of several.
    pub kind: EndingKind,
    /// In words; empty where all is well.
    pub why: String,
}

impl Ending {
    /// An ending with its reason.
    pub fn new(kind: EndingKind, why: impl Into<String>) -> Self {
        Ending {
            kind,
            why: why.into(),
        }
    }
}

impl fmt::Display for Ending {
    /// Writes the word, and the reason behind a colon where there is one.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.why.as_str() {
            "" => f.write_str(self.kind.word()),
            why => write!(f, "{}: {why}", self.kind.word()),
        }
    }
}
