//! Bodies of needles: the shaft outside of the tissue against its surface.
//!
//! Entry points: [`Balance::touch_bodies`] after a solve, [`Balance::follow_bodies`] once a balance is found. The shaft is a rod.
//!
//! The tissue around a hole is held by the rows of the hole: no part of the shaft touches that is nearer than a mean edge to
//! where it goes in or out, along the needle, or to its tip, which is sharp.

use super::source::What;
use super::state::{NeedleState, Tip};
use crate::rod::{CORRECTED, OVERLAP, Rod, Swept, Touch};
use crate::step::{Balance, Sources, Status};

/// Places within so many radii of a body may come to touch in the next piece of its way.
const NEAR: f64 = 0.5;
/// A body is near the surface within so many mean edges.
const NEAR_EDGES: f64 = 2.0;

/// A needle's body where it is.
struct Shaft<'a> {
    rod: Rod,
    /// How far from a hole it begins \[m\].
    margin_m: f64,
    state: &'a NeedleState,
    sources: &'a Sources,
}

impl Swept for Shaft<'_> {
    fn rod(&self) -> &Rod {
        &self.rod
    }

    /// Whether the needle is outside of the tissue at a place, and not near where it goes in or out.
    fn is_free(&self, alpha: f64) -> bool {
        let mut inside = self.state.history.before().is_some();
        for crossing in self.state.history.crossings() {
            if !(crossing.enters || crossing.leaves(&self.sources.mesh)) {
                continue;
            }
            if (crossing.alpha - alpha).abs() < self.margin_m {
                return false;
            }
            inside ^= crossing.alpha < alpha;
        }
        !inside && (0.0..=self.rod.front_m).contains(&alpha)
    }

    fn friction(&self, cell: u32) -> f64 {
        self.sources.tissue(cell).surface_friction
    }
}

impl Balance<'_> {
    fn shaft(&self, needle: usize) -> Option<Shaft<'_>> {
        let (part, state) = (&self.sources.needles[needle], &self.state.each[needle]);
        let (curve, edge_m) = (part.needle.at(&state.pose), self.sources.edge_m());
        let radius_m = 0.5 * part.needle.thickness_m;
        let margin_m = edge_m.max(4.0 * radius_m);
        let rod = Rod::new(curve, radius_m, curve.length - margin_m, edge_m);
        let touches = part.body && state.tip != Tip::Waiting && rod.front_m > 0.0;
        touches.then_some(Shaft {
            rod,
            margin_m,
            state,
            sources: self.sources,
        })
    }

    /// The shape of a needle's body where it is.
    pub(crate) fn shaft_rod(&self, needle: usize) -> Option<Rod> {
        self.shaft(needle).map(|shaft| shaft.rod)
    }

    /// Whether a needle's body can touch anything at a place on it \[m\].
    pub(crate) fn is_shaft_free(&self, needle: usize, alpha: f64) -> bool {
        self.shaft(needle).is_some_and(|shaft| shaft.is_free(alpha))
    }

    /// After the `solve`th solve: bodies that are in the tissue touch it; whether there are none.
    ///
    /// # Errors
    /// More places than there is room for.
    pub(super) fn touch_bodies(&mut self, solve: u32) -> Result<bool, Status> {
        let mut settled = true;
        let within_m = OVERLAP.map(|overlap| overlap * self.sources.edge_m());
        for needle in 0..self.state.each.len() {
            settled &= solve > CORRECTED || self.correct(needle, within_m);
            let added = self.add_touches(needle, -within_m[1]);
            settled &= added.ok_or(Status::TooManyRows)? == 0;
        }
        Ok(settled)
    }

    /// Has what presses, or is in the body, lie where the last solve has it, unless that is where it lies give or take
    /// `within_m`, both; whether all do.
    fn correct(&mut self, needle: usize, within_m: [f64; 2]) -> bool {
        let mut right = true;
        for place in 0..self.state.each[needle].touches.len() {
            let Some(index) = self.point_of(needle, What::Touch(place)) else {
                continue;
            };
            let first_row = self.work.needles.points[index].first_row;
            let presses = self.state.grasp.lambda()[first_row] > 0.0;
            let force = self.state.grasp.force_on(index);
            let solved = (presses, force, self.slipped(first_row));
            let touch = &self.state.each[needle].touches[place];
            let shaft = self.shaft(needle);
            let next = shaft.and_then(|shaft| self.corrected(&shaft, touch, solved, within_m));
            if let Some(next) = next {
                self.state.each[needle].touches[place] = next;
                right = false;
            }
        }
        right
    }

    /// Takes up what is nearer to a body than `within_m` and not yet touched; how much that is, nothing if there is no room.
    fn add_touches(&mut self, needle: usize, within_m: f64) -> Option<usize> {
        let mut work = std::mem::take(&mut self.work.rods);
        work.found.clear();
        let has_room = self.shaft(needle).is_none_or(|shaft| {
            self.look_for_touches(&shaft, &shaft.state.touches, within_m, &mut work)
        });
        let state = &mut self.state.each[needle];
        for touch in &work.found {
            let id = state.new_id();
            state.touches.push(Touch { id, ..*touch });
        }
        let count = work.found.len();
        self.work.rods = work;
        has_room.then_some(count)
    }

    /// Bodies touch where the balance has them: what presses goes with its edge, and what is near may touch next.
    pub(super) fn follow_bodies(&mut self) {
        for needle in 0..self.state.each.len() {
            let part = &self.sources.needles[needle];
            if !part.body {
                continue;
            }
            let mut touches = std::mem::take(&mut self.state.each[needle].touches);
            let shaft = self.shaft(needle);
            touches.retain_mut(|touch| {
                let pressing = shaft.as_ref().filter(|_| touch.presses());
                let next = pressing.and_then(|shaft| self.followed(shaft, touch));
                *touch = next.unwrap_or(*touch);
                next.is_some()
            });
            self.state.each[needle].touches = touches;
            // Of what finds no room now the next solve sees whether it has to.
            let _ = self.add_touches(needle, 0.5 * NEAR * part.needle.thickness_m);
            let mut work = std::mem::take(&mut self.work.rods);
            let near_m = NEAR_EDGES * self.sources.edge_m();
            let is_near = self
                .shaft(needle)
                .is_some_and(|shaft| self.is_near_surface(&shaft.rod, near_m, &mut work));
            self.work.rods = work;
            self.state.each[needle].is_near = is_near;
        }
    }
}
