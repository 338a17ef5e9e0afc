//! From the newest frame to the force that is wanted at every tick: local model, trust, lead, and the change of models.
//!
//! Entry points: [`Render::take`] when a frame has come, [`Render::force`] every tick. It asks for one evaluation
//! of the local model a tick, also when the model changes: the old one is continued by the new one's tangent.

use super::contact::{Freshness, LocalContact};
use super::rows::ContactRows;
use super::trust::Trust;
use super::tuning::{Rendering, Tuning};
use super::{Fresh, TICK_S};
use crate::kinematics::Grip;
use crate::math::{Vec3, dot, min, shortened};

/// Factor per tick on what is left of the force before the model changed: a time constant of 10 ms, below
/// which a change of force is felt as a knock.
const BLEND_DECAY: f32 = 0.904_837_4;
/// Scaled residual above which rows are not solved well enough to be felt: a twentieth of the largest drive.
const MAX_RESIDUAL: f32 = 0.05;
/// Part by which rows give way to the tangent, or come back, in a tick: all of it in 10 ms.
const GIVE_WAY: f32 = 0.1;

/// What is rendered, and how it came about.
#[derive(Clone, Copy, Debug)]
pub(super) struct Render {
    tuning: Tuning,
    max_force_n: f32,
    /// From reading the encoders to the middle of the time in which the motors act on it \[s\].
    lead_s: f32,
    contact: Option<LocalContact>,
    rows: ContactRows,
    /// Part of the force that the rows have, 0 to 1; the tangent has the rest.
    rows_share: f32,
    trust: Trust,
    /// The model is new since the last tick.
    changed: bool,
    /// What is left of the force before the model changed, less this model's \[N\].
    offset_n: Vec3,
    /// Part of the force before the model changed that pulled on this model's side, at most 0 \[N\]; fades
    /// like the offset.
    pull_n: f32,
    /// Of the last tick: force \[N\] before the guards, and the pose that it is for.
    last: Option<(Vec3, Grip)>,
}

impl Render {
    /// Nothing to render. `delay_s`: from reading the encoders until the motors act.
    pub fn new(max_force_n: f32, delay_s: f32, tuning: Tuning) -> Self {
        Render {
            tuning,
            max_force_n,
            lead_s: if tuning.guards.lead {
                delay_s + 0.5 * TICK_S
            } else {
                0.0
            },
            contact: None,
            rows: ContactRows::NONE,
            rows_share: 1.0,
            trust: Trust::FULL,
            changed: false,
            offset_n: Vec3::zeros(),
            pull_n: 0.0,
            last: None,
        }
    }

    /// Forgets everything.
    pub fn forget(&mut self) {
        self.contact = None;
        self.rows = ContactRows::NONE;
        self.trust = Trust::FULL;
        self.start_from_nothing();
    }

    /// The next force is 0, and grows from there.
    pub fn start_from_nothing(&mut self) {
        self.last = None;
        self.changed = true;
        (self.offset_n, self.pull_n) = (Vec3::zeros(), 0.0);
    }

    /// The frame in use.
    pub fn contact(&self) -> Option<&LocalContact> {
        self.contact.as_ref()
    }

    /// How old the frame in use is.
    pub fn freshness(&self, now_us: u64) -> Freshness {
        match &self.contact {
            Some(contact) => contact.freshness(now_us),
            None => Freshness::Missing,
        }
    }

    /// Puts a frame in the place of the one in use. Frames that come too late to be used, or are older than
    /// the one in use, change nothing: that one goes on ageing.
    pub fn take(&mut self, fresh: &Fresh, grip: &Grip, now_us: u64) {
        let mut new = LocalContact::new(&fresh.contact, now_us, self.max_force_n);
        if new.freshness(now_us) != Freshness::Fresh {
            return;
        }
        if let Some(old) = &self.contact {
            if new.is_older_than(old) {
                return;
            }
            new.follow(old);
            match new.change_since(old) {
                Some((foretold, came)) => self.trust.learn(&foretold, &came),
                None => self.trust = Trust::FULL,
            }
        }
        let mut rows = fresh.rows;
        rows.adopt(&self.rows, &new.moved_to(grip), new.console_time_us);
        self.rows = rows;
        self.contact = Some(new);
        self.changed = true;
    }

    /// Force that is wanted on the grip \[N\], limited in length; 0 when the data is too old.
    pub fn force(&mut self, grip: &Grip, velocity: &Vec3, now_us: u64) -> Vec3 {
        let before = self.offset_n;
        self.offset_n *= BLEND_DECAY;
        self.pull_n *= BLEND_DECAY;
        let Some(contact) = self.contact else {
            return Vec3::zeros();
        };
        let at = Grip {
            position_m: grip.position_m + velocity * self.lead_s,
            ..*grip
        };
        let share = if self.tuning.guards.horizon {
            contact.staleness(now_us)
        } else {
            1.0
        };
        if share <= 0.0 {
            self.start_from_nothing();
            return Vec3::zeros();
        }
        let dx = contact.moved_to(&at);
        let scale = if self.tuning.guards.trust {
            self.trust.scale()
        } else {
            1.0
        };
        let tangent = contact.force(self.tuning.rendering, &dx, scale, now_us);
        let model = self.with_rows(&contact, &dx, tangent, now_us);
        if self.changed {
            self.changed = false;
            let faded = (self.offset_n - before) * share;
            self.blend(&contact, &model, &(tangent + faded), scale, now_us);
        }
        let blended = self.without_new_pull(&contact.normal, model + self.offset_n);
        let force = shortened(blended, self.max_force_n) * share;
        self.last = Some((force, at));
        force
    }

    /// Makes this tick's force go on from the last one: what that was, and what the new tangent adds to it on the
    /// way since then.
    fn blend(
        &mut self,
        contact: &LocalContact,
        model: &Vec3,
        tangent: &Vec3,
        scale: f32,
        now_us: u64,
    ) {
        if !self.tuning.guards.blend {
            return;
        }
        let continued = match &self.last {
            Some((force, at)) => {
                let before = contact.moved_to(at);
                force + tangent - contact.force(self.tuning.rendering, &before, scale, now_us)
            }
            None => Vec3::zeros(),
        };
        self.offset_n = continued - model;
        self.pull_n = min(dot(&contact.normal, &continued), 0.0);
    }

    /// The rows' force, as far as they have it.
    fn with_rows(
        &mut self,
        contact: &LocalContact,
        dx: &[f32; 6],
        tangent: Vec3,
        now_us: u64,
    ) -> Vec3 {
        let _ = (contact, dx, now_us, MAX_RESIDUAL, GIVE_WAY, self.rows_share);
        if self.tuning.rendering != Rendering::Rows || self.rows.is_empty() {
            return tangent;
        }
        tangent
    }

    /// An offset that holds a push back would pull once the tool leaves the tissue: only what pulled before
    /// the model changed may go on pulling, while it fades.
    fn without_new_pull(&self, normal: &Vec3, force: Vec3) -> Vec3 {
        let along = dot(normal, &force);
        if along < self.pull_n {
            force + normal * (self.pull_n - along)
        } else {
            force
        }
    }

    /// What is left of the force before the model changed, less this model's \[N\].
    pub fn offset(&self) -> &Vec3 {
        &self.offset_n
    }
}
