//! A tissue at rest: displacement, reactions, and how well the equations hold.
//!
//! Entry point: [`Solution`]. Signs: `force_n` and `torque_nm` in [`Reaction`] and [`HeldTool`] act **on
//! the tissue**; the handle or the tool feels the opposite.

use super::{Drawn, vtu};
use crate::needle::{NeedleReport, TipPlace};
use crate::wound::WoundReport;
use schemars::JsonSchema;
use serde::Serialize;
use std::io;
use std::path::Path;
use sutura_files::write_whole;

/// What `sutura solve` writes. The keys of the JSON file are the names of these fields.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct Solution {
    /// Name of the scene.
    pub scene: String,
    /// Name of the tissue model.
    pub tissue: &'static str,
    /// What `force_n` and `torque_nm` act on.
    pub forces_act_on: &'static str,
    /// Where all is.
    #[serde(flatten)]
    pub drawn: Drawn,
    /// One for each handle, in the scene's order.
    pub reactions: Vec<Reaction>,
    /// Force of all that is fixed on the tissue \[N\], (3).
    pub fixed_force_n: [f64; 3],
    /// One for each `[[fixed]]`, in the scene's order.
    pub fixed_reactions: Vec<FixedReaction>,
    /// One for each tool that the scene holds somewhere.
    pub tools: Vec<HeldTool>,
    /// One for each needle, in the scene's order.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub needles: Vec<DrivenNeedle>,
    /// How well threads and contact close a wound.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub wound: Option<WoundReport>,
    /// Largest component of the unbalanced force on a free node, over the largest nodal force; 1 \[-\].
    pub residual: f64,
}

/// What a handle does to the tissue.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Reaction {
    /// Place of the handle in the scene, from 0.
    pub handle: usize,
    /// The handle's name, if it has one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Force on the tissue \[N\], (3).
    pub force_n: [f64; 3],
    /// Moment on the tissue about the handle \[N m\], (3); a point handle has none.
    pub torque_nm: [f64; 3],
}

/// What a `[[fixed]]` does to the tissue: the force of its nodes on their cells, less the loads that act on these nodes.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct FixedReaction {
    /// Place of the `[[fixed]]` in the scene, from 0.
    pub fixed: usize,
    /// Its nodes, but for those of an earlier one.
    pub nodes: usize,
    /// Force on the tissue \[N\], (3).
    pub force_n: [f64; 3],
}

/// What a tool does to the tissue.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct HeldTool {
    /// Id of the tool.
    pub tool: u8,
    /// Force on the tissue \[N\], (3).
    pub force_n: [f64; 3],
    /// Moment on the tissue about the grip \[N m\], (3).
    pub torque_nm: [f64; 3],
    /// Distance to the tissue \[m\]; 0 in contact.
    pub gap_m: f64,
    /// Touched vertices.
    pub rows: u32,
}

/// A needle as its way has left it.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct DrivenNeedle {
    /// Id of the needle.
    pub needle: u8,
    /// Id of the tool that holds it.
    pub held_by: Option<u8>,
    /// Where its tip is: `outside`, `holding` a boundary, `inside`.
    pub tip: &'static str,
    /// Faces of the mesh that it goes through.
    pub crossings: u32,
    /// Boundaries that it has broken through on its way.
    pub punctures: u32,
    /// Force of the tissue on it along itself \[N\], positive towards its tip.
    pub axial_n: f64,
}

impl From<&NeedleReport> for DrivenNeedle {
    fn from(report: &NeedleReport) -> Self {
        DrivenNeedle {
            needle: report.id,
            held_by: report.held_by,
            tip: tip_word(report.tip),
            crossings: report.crossings,
            punctures: report.punctures,
            axial_n: report.axial_n,
        }
    }
}

/// As reports print it.
pub(crate) fn tip_word(tip: TipPlace) -> &'static str {
    match tip {
        TipPlace::Outside => "outside",
        TipPlace::Holding => "holding",
        TipPlace::Inside => "inside",
        TipPlace::Waiting => "waiting",
    }
}

/// File formats, by extension.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SolutionFormat {
    /// `.json`
    Json,
    /// `.vtu`, for ParaView and everything else that reads VTK.
    Vtu,
}

impl SolutionFormat {
    /// The format that a path's extension stands for.
    pub fn of(path: &Path) -> Option<SolutionFormat> {
        match path.extension()?.to_str()? {
            "json" => Some(SolutionFormat::Json),
            "vtu" => Some(SolutionFormat::Vtu),
            _ => None,
        }
    }
}

impl Solution {
    /// Writes the file, whole or not at all.
    ///
    /// # Errors
    /// What the system says.
    pub fn write(&self, path: &Path, format: SolutionFormat) -> io::Result<()> {
        match format {
            SolutionFormat::Json => write_whole(path, &serde_json::to_vec(self)?),
            SolutionFormat::Vtu => write_whole(path, vtu(&self.drawn).as_bytes()),
        }
    }
}
