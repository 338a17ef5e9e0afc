//! Whether a body of a grip or a needle has come into the tissue.
//!
//! Entry point: [`Balance::sunk_in`] after a balance. Contact keeps the axis of a rod outside of the surface, by its radius. An axis
//! inside has lost its contact: the surface has closed over the rod, or the rod is behind a wall. Contact that pushes a rod onward
//! along its own way in is that of a surface on its other side.

use super::shape::Rod;
use crate::model::Model;
use crate::needle::What;
use crate::source::tool::Hardest;
use crate::step::{Balance, SourcesState};
use crate::thread::Obstacle;
use crate::tool::Placement;
use nalgebra::{UnitQuaternion, Vector3};

/// Places on the axis of a rod that are looked at, both ends included.
const PLACES: u32 = 5;

impl Balance<'_> {
    /// Finds a body that has come into the tissue in the balance that was just found. One that presses is looked for in the tissue
    /// where its way `ends`; one that does not, where it pressed just before as well.
    pub(crate) fn sunk_in(&mut self, model: &Model, ends: bool) -> Option<Obstacle> {
        let bars = (0..self.sources.bars.len()).find(|bar| self.is_bar_sunk(model, *bar, ends));
        bars.map(Obstacle::Bar).or_else(|| {
            let mut needles = 0..self.state.each.len();
            let needle = needles.find(|needle| self.is_shaft_sunk(model, *needle, ends));
            needle.map(Obstacle::Needle)
        })
    }

    fn is_bar_sunk(&mut self, model: &Model, bar: usize, ends: bool) -> bool {
        let state = &self.state.bars[bar];
        let (Some(pose), Some(rod)) = (state.pose, self.bar_rod(bar)) else {
            return false;
        };
        if !state.has_been_outside {
            return ends && (state.is_sunk || self.is_axis_enclosed(model, &rod, |_| true));
        }
        let points = self.work.bars.points.iter();
        let own = points.filter(|point| point.bar == bar);
        let forces = own.map(|point| self.state.grasp.force_on(point.anchor));
        let force = -forces.sum::<Vector3<f64>>();
        let before = self.state.bars[bar].hardest;
        let (now, pushed_on) = pressed(before, &rod, &pose.rotation, &force);
        self.state.bars[bar].hardest = now;
        let looks = ends || (before.is_some() && now.is_none());
        pushed_on || (looks && self.is_axis_enclosed(model, &rod, |_| true))
    }

    fn is_shaft_sunk(&mut self, model: &Model, needle: usize, ends: bool) -> bool {
        if !self.sources.needles[needle].body {
            return false;
        }
        let Some(rod) = self.shaft_rod(needle) else {
            return false;
        };
        let points = self.work.needles.points.iter().enumerate();
        let touches = |what: What| matches!(what, What::Touch(_));
        let own = points.filter(|(_, point)| point.needle == needle && touches(point.what));
        let forces = own.map(|(index, _)| self.state.grasp.force_on(index));
        let force = -forces.sum::<Vector3<f64>>();
        let before = self.state.each[needle].hardest;
        let rotation = self.state.each[needle].pose.rotation;
        let (now, pushed_on) = pressed(before, &rod, &rotation, &force);
        self.state.each[needle].hardest = now;
        let looks = ends || (before.is_some() && now.is_none());
        pushed_on
            || (looks
                && self.is_axis_enclosed(model, &rod, |alpha| self.is_shaft_free(needle, alpha)))
    }

    /// Whether a place of a rod's axis that `is_free` is in the tissue.
    fn is_axis_enclosed(&self, model: &Model, rod: &Rod, is_free: impl Fn(f64) -> bool) -> bool {
        let last = f64::from(PLACES - 1);
        let places = (0..PLACES).map(|place| rod.front_m * (f64::from(place) / last));
        let mut places = places.filter(|alpha| is_free(*alpha));
        places.any(|alpha| {
            let at = rod.curve.at(alpha);
            // The same order as for tools: the cheap suspicion, the surface at rest, and the proof.
            model.is_behind_nearest(&at)
                && model.contains(&at)
                && model.surface().encloses(|node| self.position(node), &at)
        })
    }
}

impl SourcesState {
    /// Forgets the contact of a body: it starts afresh outside.
    pub(crate) fn forget_body(&mut self, body: Obstacle) {
        match body {
            Obstacle::Bar(bar) => self.bars[bar].forget(),
            Obstacle::Needle(needle) => {
                let state = &mut self.each[needle];
                state.touches.clear();
                state.hardest = None;
            }
        }
    }
}

/// Updates the largest force on a rod on its way in by `force` \[N\]; also returns whether that pushes it onward.
fn pressed(
    before: Option<Hardest>,
    rod: &Rod,
    rotation: &UnitQuaternion<f64>,
    force: &Vector3<f64>,
) -> (Option<Hardest>, bool) {
    let at = Placement {
        centre: rod.curve.at(0.5 * rod.front_m),
        rotation: *rotation,
    };
    let now = Hardest::new(&at, &at.centre, force, force, force.norm());
    let (Some(now), Some(mut hardest)) = (now, before) else {
        return (now, false);
    };
    let turn_m = 0.5 * rod.front_m * hardest.angle_to(&at);
    hardest.go_on(&now);
    let pushed_on = hardest.is_pushed_on(turn_m);
    let next = if pushed_on {
        hardest
    } else {
        hardest.or(now, rod.radius_m)
    };
    (Some(next), pushed_on)
}
