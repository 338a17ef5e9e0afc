//! Where tools are when a step has followed them only part of the way.
//!
//! Entry point: [`SourcesState::reached`].

use super::sources::{Sources, SourcesState};
use super::targets::pose_of;
use crate::model::Model;
use crate::thread::ThreadHold;
use crate::tool::ToolSample;
use nalgebra::{Isometry3, Translation3};

impl SourcesState {
    /// Where the last balance has the grip of a tool that was sampled at `sample`, by what it carries; there, if it carries nothing.
    pub fn reached(&self, model: &Model, sources: &Sources, sample: &ToolSample) -> ToolSample {
        if let Some(found) = self.shape_reached(model, sources, sample) {
            return found;
        }
        let pose = self
            .grip_of_rod(sources, sample.id)
            .or_else(|| self.grip_of_needle(sample.id))
            .or_else(|| self.grip_of_thread(sample));
        pose.map_or(*sample, |pose| ToolSample {
            position_m: pose.translation.vector.into(),
            orientation: pose.rotation.coords.into(),
            ..*sample
        })
    }

    fn shape_reached(
        &self,
        model: &Model,
        sources: &Sources,
        sample: &ToolSample,
    ) -> Option<ToolSample> {
        let (index, tool) = model.tool(sample.id)?;
        let place = sources.tools.place_of(Some(index))?;
        let placement = self.tools.placements[place as usize]?;
        Some(tool.sample_at(&placement, sample))
    }

    fn grip_of_rod(&self, sources: &Sources, tool: u8) -> Option<Isometry3<f64>> {
        let jaws = sources.jaws_of(tool).map(|jaws| self.jaws[jaws].pose);
        let bar = || sources.bar_of(tool).map(|bar| self.bars[bar].pose);
        jaws.or_else(bar).flatten()
    }

    fn grip_of_needle(&self, tool: u8) -> Option<Isometry3<f64>> {
        self.each.iter().find_map(|each| {
            let grip = each.grip.filter(|grip| grip.tool == tool)?;
            Some(each.pose * grip.needle.inverse())
        })
    }

    /// A thread does not know how its tool is turned.
    fn grip_of_thread(&self, sample: &ToolSample) -> Option<Isometry3<f64>> {
        let rotation = pose_of(sample)?.rotation;
        let strands = self.threads.iter().filter(|strand| strand.is_used);
        let mut ends = strands.flat_map(|strand| [strand.tail, strand.head]);
        let hold = ends.find(|hold| hold.by == ThreadHold::Tool(sample.id))?;
        let at = hold.at - rotation * hold.on_tool;
        Some(Isometry3::from_parts(Translation3::from(at), rotation))
    }
}
