//! What a step found about needles.
//!
//! Entry point: [`NeedleReport`].

use super::source::{Point, What};
use super::state::Tip;
use super::surface::TipLoad;
use super::{Curve, MOST_GROUPS, Slack};
use crate::step::{Balance, Felt, slide_twist};
use crate::tool::ToolSample;
use nalgebra::Vector3;

/// As far ahead of a tip outside the next boundary is looked for \[m\].
const LOOK_M: f64 = 0.005;

/// Where a needle's tip is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TipPlace {
    /// Outside the tissue.
    #[default]
    Outside,
    /// It holds a boundary face, from either side.
    Holding,
    /// Inside.
    Inside,
    /// The needle was put here, into the tissue, without a way that led in: it touches nothing until all of it has been
    /// outside once. See [`crate::step::State::put`].
    Waiting,
}

/// What a step found about one needle.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct NeedleReport {
    /// Which needle.
    pub id: u8,
    /// The tool that holds it.
    pub held_by: Option<u8>,
    /// Where its tip is.
    pub tip: TipPlace,
    /// Whether there may be a surface as near to a tip outside as was asked for
    /// ([`StepOptions::tip_reach_m`](crate::step::StepOptions::tip_reach_m)).
    pub near: bool,
    /// Faces that it goes through.
    pub crossings: u32,
    /// Places where its body touches the surface.
    pub touches: u32,
    /// Boundary faces that it has broken through so far.
    pub punctures: u32,
    /// Whether all that rubs slides.
    pub slides: bool,
    /// Wrench of the tissue on it, along its slide \[N\]: below zero against driving.
    pub axial_n: f64,
    /// Largest axial force of friction and cutting, forward and backward \[N\].
    pub limit_n: [f64; 2],
    /// Axial force of the tip on the face that it holds \[N\].
    pub hold_n: f64,
    /// Axial force that breaks through it, in the direction of the present one \[N\]; infinite for never, 0 when it holds none.
    pub puncture_n: f64,
    /// Stiffness against its slide \[N/m\]: if all stuck, and as it is.
    pub stiffness_n_per_m: [f64; 2],
    /// Its slide as a twist of the grip per metre: linear, then angular \[1/m\].
    pub slide: [f64; 6],
    /// Spent so far \[J\]: by friction, cutting, and forces let go.
    pub dissipated_j: [f64; 3],
    /// Times so far that the way through the cells was guessed by its direction, or lost, or that tissue folded
    /// so far that crossings would have changed places.
    pub guessed: u32,
}

impl Balance<'_> {
    /// Where a needle is.
    pub(crate) fn curve(&self, needle: usize) -> Curve {
        let pose = &self.state.each[needle].pose;
        self.sources.needles[needle].needle.at(pose)
    }

    /// Whether a tool holds a needle.
    pub(crate) fn is_held_by(&self, needle: usize, tool: u8) -> bool {
        let grip = self.state.each[needle].grip;
        grip.is_some_and(|grip| grip.tool == tool)
    }

    /// Where the tool is that holds a needle \[m\]; the needle's end if none of `samples` does.
    pub(crate) fn grip_of(&self, needle: usize, samples: &[ToolSample]) -> Vector3<f64> {
        let held = samples
            .iter()
            .find(|sample| self.is_held_by(needle, sample.id));
        held.map_or_else(
            || self.curve(needle).start,
            |sample| Vector3::from(sample.position_m),
        )
    }

    /// What a tool feels of the needles that it holds, and the columns that their tips need next.
    pub(super) fn feel_needles(&mut self, felt: &mut Felt) {
        for needle in 0..self.state.each.len() {
            if !self.is_held_by(needle, felt.tool) {
                continue;
            }
            felt.wrench += self.wrench_on(needle, &felt.grip);
            let points = self.work.needles.points.iter();
            let acts = |point: &&Point| {
                let presses = || self.state.grasp.lambda()[point.first_row] > 0.0;
                point.needle == needle && (!matches!(point.what, What::Touch(_)) || presses())
            };
            let rows = 3 * points.filter(acts).count() as u32;
            felt.rows += rows;
            let curve = self.curve(needle);
            let forward = curve.tangent_at(curve.length);
            if rows > 0 {
                felt.gap_m = 0.0;
            }
            if self.state.each[needle].tip == Tip::Outside {
                let tip = curve.at(curve.length);
                let path = Curve::segment(&tip, &(tip + forward * LOOK_M));
                if let Some(face) = path.and_then(|path| self.first_face(&path)) {
                    felt.gap_m = felt.gap_m.min(face.alpha);
                    let cells = self.sources.mesh.cells();
                    let ahead = &mut self.work.needles.ahead;
                    ahead.extend(cells.get(face.face.cell() as usize).into_iter().flatten());
                }
            }
            felt.normal = -forward;
        }
    }

    /// What a step found about each needle, but for stiffness.
    pub(super) fn report_needles(&mut self, samples: &[ToolSample]) {
        let count = self.state.each.len();
        for needle in 0..count {
            self.report.needles_mut(count)[needle] = self.needle_report(needle, samples);
            // Cells around the tip are next.
            let mesh = &self.sources.mesh;
            if let Some(cell) = self.state.each[needle].history.tip_cell(mesh) {
                let near = mesh.adjacent_cells(cell).into_iter().flatten();
                for cell in std::iter::once(cell).chain(near) {
                    let nodes = mesh.cells().get(cell as usize);
                    self.work.needles.ahead.extend(nodes.into_iter().flatten());
                }
            }
        }
    }

    /// Whether there may be a surface around a tip outside.
    fn is_near(&self, needle: usize) -> bool {
        let is_asked = self.tip_reach_m > 0.0;
        if !is_asked || self.state.each[needle].tip != Tip::Outside {
            return false;
        }
        let curve = self.curve(needle);
        let mut slack = [0.0; MOST_GROUPS];
        let slack = Slack::ByGroup(self.slack(&mut slack));
        let tip = curve.at(curve.length);
        let hierarchy = &self.sources.hierarchy;
        hierarchy.comes_within(&tip, self.tip_reach_m, slack)
    }

    fn needle_report(&self, needle: usize, samples: &[ToolSample]) -> NeedleReport {
        let each = &self.state.each[needle];
        let part = &self.sources.needles[needle];
        let grip = self.grip_of(needle, samples);
        let twist = slide_twist(&self.curve(needle), &grip);
        let rubbing: f64 = each.holds.iter().map(|hold| hold.limit_n).sum();
        let cutting = match each.tip {
            Tip::Inside { cut: Some(cut) } => cut.limit_n,
            _ => 0.0,
        };
        let (hold_n, puncture_n) = match (each.tip, self.tip_load(needle)) {
            (Tip::Holding { face, .. }, Some(TipLoad { load_n, axial_n })) => {
                let limit_n =
                    self.sources.tissue(face.face.cell()).puncture_pa * part.needle.tip_area_m2();
                let puncture_n = match (load_n == axial_n, axial_n > 0.0) {
                    (true, _) => limit_n,
                    (false, true) => limit_n * (axial_n / load_n),
                    (false, false) => f64::INFINITY,
                };
                (axial_n, puncture_n)
            }
            _ => (0.0, 0.0),
        };
        let mut holds = each.holds.iter();
        let touches = each.touches.iter();
        let pressing = touches
            .filter(|touch| touch.force != Vector3::zeros())
            .count();
        NeedleReport {
            id: part.id,
            held_by: each.grip.map(|by| by.tool),
            tip: match each.tip {
                Tip::Outside => TipPlace::Outside,
                Tip::Holding { .. } => TipPlace::Holding,
                Tip::Inside { .. } => TipPlace::Inside,
                Tip::Waiting => TipPlace::Waiting,
            },
            near: self.is_near(needle),
            crossings: each.holds.len() as u32,
            touches: pressing as u32,
            punctures: each.tally.punctures,
            slides: !each.holds.is_empty() && holds.all(|hold| hold.slides || hold.limit_n == 0.0),
            axial_n: self.wrench_on(needle, &grip).dot(&twist),
            limit_n: [rubbing + cutting, rubbing],
            hold_n,
            puncture_n,
            stiffness_n_per_m: [0.0; 2],
            slide: twist.into(),
            dissipated_j: [
                each.tally.friction_j,
                each.tally.cutting_j,
                each.tally.release_j,
            ],
            guessed: each.tally.guessed + each.tally.lost + each.tally.folded,
        }
    }
}
