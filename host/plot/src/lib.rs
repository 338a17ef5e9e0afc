//! Reports of the command as pictures: SVG that can be read at 800 px, in grey, and without the program that made it.
//!
//! Entry points: [`pictures`] for a report, [`Chart::svg`] for one picture. Neither measures anything: who has a
//! report's JSON has its pictures, in milliseconds.

mod axis;
mod chart;
mod fidelity;
mod labels;
mod marks;
mod text;
mod tradeoff;

pub use axis::Axis;
pub use chart::{Chart, Series, Shown};

use serde_json::Value;

/// A file's name and contents.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// With `.svg`.
    pub name: String,
    /// The file.
    pub svg: String,
}

/// Why there is no picture.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The plotting library could not draw.
    #[error("the picture could not be drawn: {0}")]
    Drawing(String),
    /// Not what the command writes.
    #[error("the report is not one that can be drawn: {0}")]
    Report(#[from] serde_json::Error),
    /// A report of something else.
    #[error(
        "the report has neither `truths` (as `sutura tradeoff` writes) nor `bars` (as `sutura fidelity` writes)"
    )]
    Unknown,
}

/// What measured a report.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// `sutura tradeoff`.
    Tradeoff,
    /// `sutura fidelity`.
    Fidelity,
}

impl Kind {
    /// What a report is of.
    ///
    /// # Errors
    /// If it is of neither.
    pub fn of(report: &Value) -> Result<Self, Error> {
        if report.get("truths").is_some() {
            Ok(Kind::Tradeoff)
        } else if report.get("bars").is_some() {
            Ok(Kind::Fidelity)
        } else {
            Err(Error::Unknown)
        }
    }

    /// The command's name, which its files have too.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Kind::Tradeoff => "tradeoff",
            Kind::Fidelity => "fidelity",
        }
    }
}

/// All pictures of a report, as `--format json` prints it.
///
/// # Errors
/// If it is of no kind that is drawn here, or lacks what its kind has.
pub fn pictures(report: &Value) -> Result<Vec<Picture>, Error> {
    let charts = match Kind::of(report)? {
        Kind::Tradeoff => tradeoff::charts(report)?,
        Kind::Fidelity => fidelity::charts(report)?,
    };
    let draw = |(name, chart): (String, Chart)| {
        chart.svg().map(|svg| Picture {
            name: format!("{name}.svg"),
            svg,
        })
    };
    charts.into_iter().map(draw).collect()
}
