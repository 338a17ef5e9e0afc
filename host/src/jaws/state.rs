//! What evolves about jaws: where they are, and the points that they hold.
//!
//! Entry points: [`JawsState`], [`crate::step::State::act`].

use super::{JawsPart, JawsReport};
use crate::anchors::AnchorPoint;
use crate::event::Loss;
use nalgebra::{Isometry3, Vector3};
use serde::Serialize;

/// What pads do.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub enum Pads {
    /// Open: they hold nothing.
    #[default]
    Open,
    /// They take hold at the end of the next step that has what that needs.
    Closing,
    /// Closed, on tissue or on nothing.
    Closed,
}

/// A point of tissue that is held.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Grasped {
    /// Which point.
    pub at: AnchorPoint,
    /// Where it is held, in the frame of the grip \[m\], (3).
    pub local_m: [f64; 3],
    /// Names its rows.
    pub(super) id: u32,
}

/// One pair of jaws.
#[derive(Debug, PartialEq, Serialize)]
pub(crate) struct JawsState {
    pub pads: Pads,
    /// Of the grip at the last balance; nothing before the first one that has the tool.
    pub pose: Option<Isometry3<f64>>,
    pub points: Vec<Grasped>,
    /// How far from the middle of the pads points may be, along the axis and along the hinge \[m\], (2): where they are taken,
    /// and at least the pads.
    pub reach_m: [f64; 2],
    pub next_id: u32,
    /// Spent on slips so far \[J\].
    pub friction_j: f64,
    /// Why everything was lost since that was told last.
    pub lost: Option<Loss>,
}

impl JawsState {
    /// Open, and nowhere.
    pub fn new(part: &JawsPart) -> Self {
        Self {
            pads: Pads::Open,
            pose: None,
            points: Vec::with_capacity(part.jaws.points),
            reach_m: [0.0; 2],
            next_id: 0,
            friction_j: 0.0,
            lost: None,
        }
    }

    /// As a copy of `other`, without new memory.
    pub fn copy_from(&mut self, other: &Self) {
        let Self {
            pads,
            pose,
            points,
            reach_m,
            next_id,
            friction_j,
            lost,
        } = self;
        (*pads, *pose, *reach_m) = (other.pads, other.pose, other.reach_m);
        (*next_id, *friction_j, *lost) = (other.next_id, other.friction_j, other.lost);
        points.clone_from(&other.points);
    }

    /// Closes or opens; what is closed already, or about to be, stays so.
    pub fn close(&mut self, closed: bool) {
        if !closed {
            self.pads = Pads::Open;
            self.points.clear();
        } else if self.pads == Pads::Open {
            self.pads = Pads::Closing;
        }
    }

    /// Loses everything; the pads stay shut.
    pub fn lose(&mut self, why: Loss) {
        self.points.clear();
        self.lost = Some(why);
    }

    /// Lets go of points that have slipped out of the pads.
    pub fn drop_what_is_out(&mut self, part: &JawsPart) {
        let (had, reach_m) = (self.points.len(), self.reach_m);
        self.points.retain(|point| {
            let off = off_middle_m(part, &point.local_m.into());
            off[0] <= reach_m[0] && off[1] <= reach_m[1]
        });
        if had > 0 && self.points.is_empty() {
            self.lose(Loss::Slipped);
        }
    }

    /// Has the pads hold these points where they are \[m\], of a grip at `pose`.
    pub fn take(
        &mut self,
        part: &JawsPart,
        pose: &Isometry3<f64>,
        found: impl Iterator<Item = (AnchorPoint, Vector3<f64>)>,
    ) {
        self.pads = Pads::Closed;
        self.points.clear();
        self.reach_m = [0.5 * part.jaws.length_m, 0.5 * part.jaws.width_m];
        for (at, place_m) in found.take(part.jaws.points) {
            let local = pose.inverse_transform_point(&place_m.into()).coords;
            let off = off_middle_m(part, &local);
            self.reach_m = [self.reach_m[0].max(off[0]), self.reach_m[1].max(off[1])];
            self.points.push(Grasped {
                at,
                local_m: local.into(),
                id: self.next_id,
            });
            self.next_id = self.next_id.wrapping_add(1);
        }
    }

    /// As far as it is known without a balance.
    pub fn report(&self, part: &JawsPart) -> JawsReport {
        JawsReport {
            tool: part.tool,
            pads: self.pads,
            points: self.points.len() as u32,
            friction_j: self.friction_j,
            ..JawsReport::default()
        }
    }
}

/// `Vec::clone` would not keep the room for points.
impl Clone for JawsState {
    fn clone(&self) -> Self {
        let mut points = Vec::with_capacity(self.points.capacity());
        points.extend_from_slice(&self.points);
        Self { points, ..*self }
    }
}

/// How far from the middle of the pads a place is, along the axis and along the hinge \[m\], (2).
fn off_middle_m(part: &JawsPart, local_m: &Vector3<f64>) -> [f64; 2] {
    let in_pads = part.jaws.in_pads(local_m);
    [
        (in_pads.x - 0.5 * part.jaws.length_m).abs(),
        in_pads.y.abs(),
    ]
}
