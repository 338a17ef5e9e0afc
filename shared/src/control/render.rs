//! From the newest frame to the force that is wanted at every tick: local model, trust, lead, and the change of models.
//!
//! Entry points: [`Render::take`] when a frame has come, [`Render::force`] every tick. It asks for one evaluation
//! of the local model a tick, also when the model changes: the old one is continued by the new one's tangent.

use super::bend::Bend;
use super::contact::{Freshness, LocalContact, STRONGEST_N};
use super::drift::{Change, Drift};
use super::laws::{Cone, Growth};
use super::needle::LocalNeedle;
use super::round::{Shape, Skin};
use super::rows::{ContactRows, MAX_RESIDUAL};
use super::thread::LocalThread;
use super::trust::Trust;
use super::tuning::{Rendering, Tuning};
use super::{Fresh, MAX_HORIZON_US, TICK_S, TICK_US};
use crate::kinematics::Grip;
use crate::math::{Vec3, clamp, dot, max, min, shortened, shrink};
use crate::wire::{ValidNeedle, ValidThread};

/// Factor per tick on what is left of the force before the model changed: a time constant of 10 ms, below
/// which a change of force is felt as a knock.
const BLEND_DECAY: f32 = 0.904_837_4;
/// Ticks between two frames from which on that is so. What is left fades within the time between frames where they come more often: each
/// is another change, and what is left of all of them would be a force of 10 ms ago.
const BLEND_TICKS: u8 = 10;
/// Way of a tick on which a change of force tells as much as a tangent does \[m\]: less than a step of an encoder.
const TOLD_M: f32 = 10e-6;
/// Way across the normal for which rows are taken to know what is there \[m\], and the same in ways between frames: beyond that the tool is on
/// other parts of the surface, which are as likely more of the same.
const SIDEWAYS_M: f32 = 3e-3;
const SIDEWAYS: f32 = 1.5;
/// Way of a contact on a turn of the grip \[m/rad\], at most.
const LEVER_M: f32 = 0.1;
/// A smaller force is zero \[N\].
const LEAST_N: f32 = 1e-9;
/// A smaller force is none as to how it goes on \[N\].
const NONE_N: f32 = 1e-4;
/// Part of a needle's bounds by which a force that goes on from the model before may be beyond them: of one that sticks stiffly, and of others, which
/// fade into them.
const BEYOND: [f32; 2] = [0.05, 0.15];
/// Part by which rows give way to the tangent, or come back, in a tick: all of it in 10 ms.
const GIVE_WAY: f32 = 0.1;

/// What is rendered, and how it came about.
#[derive(Clone, Copy, Debug)]
pub(super) struct Render {
    tuning: Tuning,
    max_force_n: f32,
    /// Largest stiffness that this device renders stably \[N/m\].
    stable_n_per_m: f32,
    /// From reading the encoders to the middle of the time in which the motors act on it \[s\].
    lead_s: f32,
    /// What is added to it \[s\].
    more_s: f32,
    contact: Option<LocalContact>,
    rows: ContactRows,
    /// Part of the force that the rows have, 0 to 1; the tangent has the rest.
    rows_share: f32,
    /// How far across the normal they go \[m\].
    sideways_m: f32,
    /// Of the frame in use.
    needle: Option<LocalNeedle>,
    thread: Option<LocalThread>,
    /// Largest stiffness of the model along any direction \[N/m\].
    stiffness: f32,
    /// Console time until which a needle or a thread is in the grip, whether or not its next frame comes \[us\]: a
    /// contact may pull as well as push until then.
    held_until_us: u64,
    trust: Trust,
    drift: Drift,
    bend: Bend,
    /// Shape under the frame in use as its tangent alone tells it.
    shape: Option<Shape>,
    /// The last two frames with other normals, the newest first.
    beside: [Option<Skin>; 2],
    /// See [`left`](Self::left).
    left: f32,
    /// The model is new since the last tick.
    changed: bool,
    /// Whether the needle's boundary has given way where the model was asked for last, and whether that is because the model is
    /// new.
    through: bool,
    parted: bool,
    /// What is left of the force before the model changed, less this model's \[N\].
    offset_n: Vec3,
    /// Part of the force before the model changed that pulled on this model's side, at most 0 \[N\]; fades
    /// like the offset.
    pull_n: f32,
    /// Factor per tick on both.
    fade: f32,
    /// Ticks since the model changed, and between that change and the one before; no more than [`BLEND_TICKS`] are counted.
    ticks: [u8; 2],
    /// Of the last tick: force \[N\] before the guards, and the pose that it is for.
    last: Option<(Vec3, Grip)>,
    /// What the model gave at the last tick, unless it was new then \[N\].
    model_n: Option<Vec3>,
    /// Change of the model's force over the last tick in which it was not new \[N\], and the way on which it changed \[m\].
    course: Option<(Vec3, Vec3)>,
    track: Track,
    /// Friction cone of this tick; none where nothing rubs.
    cone: Option<Cone>,
    /// Excess beyond it that the last force is allowed \[N\].
    beyond_n: f32,
    growth: Growth,
}

/// Ticks whose places are remembered: as long as most frames are under way and in use.
const TRACKED: usize = 128;

/// Places of the grip in the last ticks in which there were rows \[m\].
#[derive(Clone, Copy, Debug)]
struct Track {
    places_m: [Vec3; TRACKED],
    /// Place of the next one, and how many there are.
    next: usize,
    count: usize,
}

impl Track {
    const NONE: Track = Track {
        places_m: [Vec3::new(0.0, 0.0, 0.0); TRACKED],
        next: 0,
        count: 0,
    };

    fn push(&mut self, place_m: Vec3) {
        if let Some(place) = self.places_m.get_mut(self.next) {
            *place = place_m;
        }
        self.next = (self.next + 1) % TRACKED;
        self.count = (self.count + 1).min(TRACKED);
    }

    /// Farthest along a direction in the last `age_us`, and at `now_m` \[m\].
    fn farthest(&self, along: &Vec3, age_us: u32, now_m: &Vec3) -> f32 {
        let ticks = (u64::from(age_us) / TICK_US) as usize;
        let mut most = dot(along, now_m);
        for ago in 1..=ticks.min(self.count) {
            let place = self.places_m.get((self.next + TRACKED - ago) % TRACKED);
            if let Some(place) = place {
                most = max(most, dot(along, place));
            }
        }
        most
    }
}

impl Render {
    /// Nothing to render, on a device with this largest force \[N\] and stiffness \[N/m\]. `delay_s`: from reading the encoders until the
    /// motors act.
    pub fn new([max_force_n, stable_n_per_m]: [f32; 2], delay_s: f32, tuning: Tuning) -> Self {
        Render {
            tuning,
            stable_n_per_m,
            max_force_n: if tuning.guards.force {
                max_force_n
            } else {
                STRONGEST_N
            },
            lead_s: if tuning.guards.lead {
                delay_s + 0.5 * TICK_S
            } else {
                0.0
            },
            more_s: 0.0,
            contact: None,
            rows: ContactRows::NONE,
            rows_share: 1.0,
            sideways_m: SIDEWAYS_M,
            needle: None,
            thread: None,
            stiffness: 0.0,
            held_until_us: 0,
            trust: Trust::FULL,
            drift: Drift::NONE,
            bend: Bend::NONE,
            shape: None,
            beside: [None; 2],
            left: 0.0,
            changed: false,
            through: false,
            parted: false,
            offset_n: Vec3::zeros(),
            pull_n: 0.0,
            fade: BLEND_DECAY,
            ticks: [BLEND_TICKS; 2],
            last: None,
            model_n: None,
            course: None,
            track: Track::NONE,
            cone: None,
            beyond_n: 0.0,
            growth: Growth::NONE,
        }
    }

    /// Forgets everything.
    pub fn forget(&mut self) {
        self.contact = None;
        self.rows = ContactRows::NONE;
        (self.needle, self.thread, self.held_until_us) = (None, None, 0);
        (self.trust, self.bend, self.beside) = (Trust::FULL, Bend::NONE, [None; 2]);
        self.drift = Drift::NONE;
        self.track.count = 0;
        self.growth = Growth::NONE;
        self.start_from_nothing();
    }

    /// The next force is 0, and grows from there.
    pub fn start_from_nothing(&mut self) {
        (self.last, self.model_n, self.course) = (None, None, None);
        self.changed = true;
        (self.offset_n, self.pull_n) = (Vec3::zeros(), 0.0);
        self.ticks = [BLEND_TICKS; 2];
    }

    /// From reading the encoders to the middle of the time in which the motors act on it \[s\].
    pub fn lead_s(&self) -> f32 {
        self.lead_s + self.more_s
    }

    /// Adds so much to the lead \[s\].
    pub fn lead_more(&mut self, more_s: f32) {
        self.more_s = more_s;
    }

    /// The frame in use.
    pub fn contact(&self) -> Option<&LocalContact> {
        self.contact.as_ref()
    }

    /// Least stiffness that what is rendered may have along a force, and the largest along any direction \[N/m\]: the
    /// tangent's with a thread's that is slack, and what successive frames say of it.
    pub fn stiffness(&self, force: &Vec3) -> (f32, f32) {
        let Some(contact) = &self.contact else {
            return (0.0, 0.0);
        };
        let (along, most) = if self.tuning.guards.along {
            (contact.stiffness_along(force), self.stiffness)
        } else {
            let most = contact.stiffness_of_axes();
            (most, most)
        };
        let scale = self.trust.scale();
        (along * min(scale, 1.0), most * max(scale, 1.0))
    }

    /// Speed at which the tissue's surface comes towards the tool by itself \[m/s\]. Baselines know nothing of it.
    pub fn drift_m_per_s(&self) -> f32 {
        match self.tuning.rendering {
            Rendering::Tangent | Rendering::Rows => self.drift.speed(),
            Rendering::Hold | Rendering::LinearTime => 0.0,
        }
    }

    /// Force of what the surface has come by itself since the frame \[N\].
    fn drifted(&self, contact: &LocalContact, now_us: u64) -> Vec3 {
        let speed = self.drift_m_per_s();
        if speed == 0.0 {
            return Vec3::zeros();
        }
        let age_s = contact.age_us(now_us) as f32 * 1e-6;
        contact.normal * (contact.stiffness_out * speed * age_s)
    }

    /// How old the frame in use is.
    pub fn freshness(&self, now_us: u64) -> Freshness {
        match &self.contact {
            Some(contact) => contact.freshness(now_us),
            None => Freshness::Missing,
        }
    }

    /// Part of the largest force that the age of the frame in use still allows, 0 to 1, and 0 without one: of the tick
    /// whose [`force`](Self::force) was asked for last.
    pub fn left(&self) -> f32 {
        self.left
    }

    /// Whether the model of the last tick has no force where the grip is; there is none without a contact in use.
    pub fn is_apart(&self) -> bool {
        self.model_n.is_none_or(|force| force == Vec3::zeros())
    }

    /// Puts a frame in the place of the one in use, with the needle and the thread of the same console time. Frames
    /// that come too late to be used, or are older than the one in use, change nothing: that one goes on ageing.
    pub fn take(
        &mut self,
        fresh: &Fresh,
        needle: Option<&ValidNeedle>,
        thread: Option<&ValidThread>,
        grip: &Grip,
        now_us: u64,
    ) {
        let mut new = LocalContact::new(&fresh.contact, now_us, self.max_force_n);
        if needle.is_some() {
            new.limit(self.stable_n_per_m);
        }
        if new.freshness(now_us) != Freshness::Fresh {
            return;
        }
        let outdated = |old: &LocalContact| new.is_older_than(old);
        if self.contact.as_ref().is_some_and(outdated) {
            return;
        }
        self.hold(needle, thread, (&new, &fresh.contact.body().tangent));
        self.sideways_m = SIDEWAYS_M;
        let skin = new.skin();
        let shape = new.shape();
        if let Some(old) = &self.contact {
            new.follow(old);
            let way_m = length(&new.across(&new.way_since(old)));
            self.sideways_m = max(SIDEWAYS_M, SIDEWAYS * way_m);
            let holds = now_us < self.held_until_us;
            let change = if holds {
                None
            } else {
                new.change_since(old, [&shape, &self.shape])
            };
            match &change {
                Some((foretold, came, span_s)) => {
                    let stiffness = new.stiffness_out;
                    self.drift.learn(&Change {
                        normal: new.normal,
                        told: *foretold,
                        came: *came,
                        stiffness,
                        aside_m: way_m,
                        span_s: *span_s,
                    });
                    // What the surface did says nothing of the tangent.
                    let drifted = stiffness * self.drift_m_per_s() * *span_s;
                    let came = came - new.normal * drifted;
                    self.trust.learn(foretold, &came, *span_s);
                }
                None => {
                    (self.trust, self.bend) = (Trust::FULL, Bend::NONE);
                    self.drift = Drift::NONE;
                }
            }
            if self.tuning.guards.bend && !holds {
                let shape = &new.shape_beside(&shape, &skin, &self.beside);
                let touched = new.touched_at(old, shape.as_ref());
                if let Some((place_m, slope)) = touched {
                    self.bend
                        .learn(&place_m, &slope, (&Vec3::zeros(), shape), 1.0);
                }
                if change.is_some() || touched.is_some() {
                    let (slope, force) = (new.slope(), new.own_force());
                    let scale = self.trust.scale();
                    self.bend
                        .learn(new.place_m(), &slope, (&force, shape), scale);
                } else {
                    self.bend.lie(shape);
                }
            }
        }
        let [last, _] = self.beside;
        if last.is_none_or(|last| skin.is_elsewhere(&last)) {
            self.beside = [Some(skin), last];
        }
        let age_us = new.age_us(now_us);
        let farthest = |along: &Vec3| {
            let farthest = self.track.farthest(along, age_us, &grip.position_m);
            farthest - dot(along, new.place_m())
        };
        self.rows.replace(&fresh.rows, farthest);
        self.growth.note(&new.own_force(), now_us);
        self.contact = Some(new);
        self.shape = shape;
        self.changed = true;
    }

    /// Takes needle and thread of the same console time as a contact.
    fn hold(
        &mut self,
        needle: Option<&ValidNeedle>,
        thread: Option<&ValidThread>,
        (contact, told): (&LocalContact, &[f32; 21]),
    ) {
        let solved_us = contact.console_time_us;
        match needle.filter(|needle| needle.console_time_us() == solved_us) {
            Some(frame) => {
                let mut needle = LocalNeedle::new(frame);
                if !self.tuning.guards.rubs {
                    needle.forget_friction();
                }
                needle.limit(self.stable_n_per_m, [told, contact.tangent()]);
                needle.note_contact(contact.tangent(), contact.wrench());
                if let Some(old) = &self.needle {
                    needle.adopt(old);
                }
                self.needle = Some(needle);
            }
            None => self.needle = None,
        }
        self.through &= self.needle.is_some();
        let thread = thread.filter(|thread| thread.console_time_us() == solved_us);
        self.thread = thread.map(LocalThread::new);
        // No eigenvalue of a sum is beyond the sum of the largest.
        let thread = self.thread.as_ref();
        let needle = self.needle.as_ref();
        let lacking = thread.map_or(0.0, LocalThread::lacking_n_per_m)
            + needle.map_or(0.0, LocalNeedle::lacking_n_per_m);
        self.stiffness = contact.stiffness() + lacking;
        if self.needle.is_some() || self.thread.is_some() {
            self.held_until_us = solved_us.saturating_add(u64::from(MAX_HORIZON_US));
        }
    }

    /// Whether a needle or a thread is in the grip.
    fn holds(&self, now_us: u64) -> bool {
        now_us < self.held_until_us
    }

    /// Force that is wanted on the grip \[N\], limited in length; 0 when the data is too old.
    pub fn force(&mut self, grip: &Grip, velocity: &Vec3, now_us: u64) -> Vec3 {
        // Nothing slips, or is told to, where no rows are.
        if self.rows.is_empty() {
            self.track.count = 0;
        } else {
            self.track.push(grip.position_m);
        }
        self.drift.tick();
        self.cone = None;
        let before = self.offset_n;
        self.offset_n *= self.fade;
        self.pull_n *= self.fade;
        let [since, last] = self.ticks;
        self.ticks = [(since + 1).min(BLEND_TICKS), last];
        let Some(contact) = &self.contact else {
            self.left = 0.0;
            return Vec3::zeros();
        };
        let at = Grip {
            position_m: grip.position_m + velocity * self.lead_s(),
            ..*grip
        };
        let share = if self.tuning.guards.horizon {
            contact.staleness(now_us)
        } else {
            1.0
        };
        self.left = share;
        if share <= 0.0 {
            self.start_from_nothing();
            return Vec3::zeros();
        }
        let dx = contact.moved_to(&at);
        let (tangent, normal) = self.by_tangent(contact, &dx, now_us);
        let model = if self.tuning.rendering == Rendering::Rows {
            self.solved(grip, &dx, tangent, now_us)
        } else {
            tangent
        };
        let is_new = core::mem::take(&mut self.changed);
        let way = self.last.map(|(_, last)| at.position_m - last.position_m);
        if is_new {
            self.fade = fade(self.ticks);
            self.ticks = [0, self.ticks[0]];
            let faded = (self.offset_n - before) * share;
            // As fast as it goes: a tick's way is of a few steps of an encoder, and swings by them.
            let onward = velocity * TICK_S;
            let tangent = tangent + faded;
            self.blend(&dx, (&model, &normal), &tangent, onward, now_us);
        }
        // A tick on one model says how the force goes on into the next one.
        // Where a force sets in or ends, there is no course: such a tick has a part of its way in the air.
        let is_none = |force: &Vec3| dot(force, force) < NONE_N * NONE_N;
        self.course = match (self.model_n, way) {
            (Some(before), _) if is_none(&before) || is_none(&model) => None,
            (Some(before), Some(way)) if !is_new => Some((model - before, way)),
            (None, Some(_)) if !is_new => self.course,
            _ => None,
        };
        self.model_n = Some(model);
        self.bound(&dx, way);
        let mut force = self.grown(model + self.offset_n, &dx, now_us);
        if !self.holds(now_us) {
            force = self.without_new_pull(&normal, force);
            self.cone = self.cone_at(&dx, is_new);
            force = self.rubbing(force);
        }
        let mut force = shortened(force, self.max_force_n) * share;
        if dot(&force, &force) < LEAST_N * LEAST_N {
            // What has faded so far is over.
            force = Vec3::zeros();
        }
        self.last = Some((force, at));
        force
    }

    /// A force no larger than the last frames' allow, with what the way since the newest one adds at the stiffness that the device renders
    /// stably.
    fn grown(&self, force: Vec3, dx: &[f32; 6], now_us: u64) -> Vec3 {
        let baseline = matches!(
            self.tuning.rendering,
            Rendering::Hold | Rendering::LinearTime
        );
        if baseline || !self.tuning.guards.blend {
            return force;
        }
        self.growth.keep(force, || {
            let [x, y, z, a, b, c] = *dx;
            let age_us = self.contact.as_ref().map_or(0, |new| new.age_us(now_us));
            let way_m = length(&Vec3::new(x, y, z)) + LEVER_M * length(&Vec3::new(a, b, c));
            let came_m = self.drift_m_per_s().abs() * (age_us as f32 * 1e-6);
            self.stable_n_per_m * (way_m + came_m)
        })
    }

    /// Cone of all contacts at a pose. What the last force is beyond a new one fades, as what is left of it does.
    fn cone_at(&mut self, dx: &[f32; 6], is_new: bool) -> Option<Cone> {
        let is_felt = self.tuning.rendering == Rendering::Rows && self.tuning.guards.blend;
        let cone = self.rows.cone().filter(|_| is_felt)?;
        if is_new {
            let last = self.last.map_or(0.0, |(force, _)| cone.beyond_n(&force));
            self.beyond_n = last;
        } else {
            self.beyond_n *= self.fade;
        }
        let mut part = 0.0;
        if cone.spread > 0.0 {
            let [x, y, z, ..] = *dx;
            let way = Vec3::new(x, y, z);
            let across_m = length(&(way - cone.axis * dot(&cone.axis, &way)));
            part = clamp(across_m * (1.0 / SIDEWAYS_M) - 1.0, 0.0, 1.0);
        }
        Some(cone.after(part, self.beyond_n))
    }

    /// A force with no more friction than the contacts of the last tick hold.
    pub fn rubbing(&self, force: Vec3) -> Vec3 {
        self.cone.map_or(force, |cone| cone.keep(force))
    }

    /// Force that the frame has without anything to be solved or remembered, by the tangent or a baseline \[N\], and the normal there.
    fn by_tangent(&self, contact: &LocalContact, dx: &[f32; 6], now_us: u64) -> (Vec3, Vec3) {
        let rendering = self.tuning.rendering;
        if self.holds(now_us) {
            let force = contact.bilateral(rendering, dx, now_us);
            return (force, contact.normal);
        }
        let scale = if self.tuning.guards.trust {
            let age_s = contact.age_us(now_us) as f32 * 1e-6;
            self.trust.scale() * self.trust.confidence(age_s)
        } else {
            1.0
        };
        let [x, y, z, ..] = *dx;
        let way = Vec3::new(x, y, z);
        let mut onward = self.bend.onward(&way);
        onward.more += self.drifted(contact, now_us);
        let dx = &dx.map(|d| d * onward.reach);
        let force = contact.force(rendering, dx, (scale, &onward), now_us);
        (force, onward.turned(&contact.normal))
    }

    /// The force with all that the console solves by itself: the needle's and the thread's state, or contact rows.
    fn solved(&mut self, grip: &Grip, dx: &[f32; 6], tangent: Vec3, now_us: u64) -> Vec3 {
        let Some(contact) = &self.contact else {
            return tangent;
        };
        let mut force = tangent;
        if let Some(needle) = &mut self.needle {
            // Slips where the grip is: where it would get at this speed, it need not.
            needle.follow(&contact.moved_to(grip), now_us);
            let was_through = core::mem::replace(&mut self.through, needle.is_through(dx));
            if self.through && !was_through {
                // What has given way does not go on: the course before it does.
                (self.parted, self.model_n) = (self.changed, None);
            }
            force += linear_part(&needle.lacking(dx));
        }
        if let Some(thread) = &self.thread {
            force += linear_part(&thread.correction(dx));
        }
        if self.rows.is_empty() || self.holds(now_us) {
            return shortened(force, self.max_force_n);
        }
        let dx = &self.not_too_far(contact, dx);
        let solved = self.rows.solve(dx);
        let lost = self.tuning.guards.residual && solved.residual > MAX_RESIDUAL;
        let step = if lost { -GIVE_WAY } else { GIVE_WAY };
        self.rows_share = clamp(self.rows_share + step, 0.0, 1.0);
        let touches = self.rows.multipliers_n().any(|multiplier| multiplier > 0.0);
        let by_rows = if touches {
            let force = contact.relaxed_force(now_us) + self.drifted(contact, now_us);
            contact.pushing(&contact.normal, force + linear_part(&solved.change))
        } else {
            Vec3::zeros()
        };
        tangent + (by_rows - tangent) * self.rows_share
    }

    /// A motion, in as far as rows know what is there.
    fn not_too_far(&self, contact: &LocalContact, dx: &[f32; 6]) -> [f32; 6] {
        let [x, y, z, a, b, c] = *dx;
        let across = contact.across(&Vec3::new(x, y, z));
        let way_m = length(&across);
        if way_m <= self.sideways_m || !self.tuning.guards.bend {
            return *dx;
        }
        let [u, v, w]: [f32; 3] = (across * (1.0 - self.sideways_m / way_m)).into();
        [x - u, y - v, z - w, a, b, c]
    }

    /// Makes this tick's force go on from the last one: what that was, and what is added to it on the way since then, by
    /// the course that the force has taken so far, and across that by the new tangent.
    fn blend(
        &mut self,
        dx: &[f32; 6],
        (model, normal): (&Vec3, &Vec3),
        tangent: &Vec3,
        way: Vec3,
        now_us: u64,
    ) {
        // The baselines are what they are known as, steps and all.
        let baseline = matches!(
            self.tuning.rendering,
            Rendering::Hold | Rendering::LinearTime
        );
        if baseline || !self.tuning.guards.blend {
            return;
        }
        let parted = core::mem::take(&mut self.parted);
        (self.offset_n, self.pull_n) = (Vec3::zeros() - model, 0.0);
        let (Some(contact), Some((force, at))) = (&self.contact, &self.last) else {
            return;
        };
        if parted && dot(model, model) < dot(force, force) {
            // What has given way is felt, and not faded.
            self.offset_n = Vec3::zeros();
            return;
        }
        let before = contact.moved_to(at);
        let mut by_tangent = tangent - self.by_tangent(contact, &before, now_us).0;
        if let Some(thread) = &self.thread {
            // One that goes slack on the way does not push.
            let now = linear_part(&thread.correction(dx));
            by_tangent += now - linear_part(&thread.correction(&before));
        }
        let mut continued = force + self.onward(by_tangent, way);
        self.pull_n = min(dot(normal, force), 0.0);
        if !self.holds(now_us) {
            continued = self.without_new_pull(normal, continued);
        }
        self.offset_n = continued - model;
    }

    /// Keeps what is left of the force before the model changed from taking a needle beyond what holds it, and works it off on the `way`
    /// since the last tick: a needle that slides forgets how it was stretched.
    fn bound(&mut self, dx: &[f32; 6], way: Option<Vec3>) {
        if !self.tuning.guards.blend || self.tuning.rendering != Rendering::Rows {
            return;
        }
        let Some(needle) = &self.needle else {
            return;
        };
        if let Some((along, axial_n, [least_n, most_n])) = needle.bounds(dx) {
            let [stiff, other] = BEYOND;
            let before_n = dot(&along, &self.offset_n);
            let (beyond, wanted_n) = if needle.is_stiff() {
                let slid_m = way.map_or(0.0, |way| dot(&along, &way).abs());
                let worked_n = needle.stick_n_per_m() * slid_m;
                (stiff, shrink(before_n, worked_n))
            } else {
                (other, before_n)
            };
            let beyond_n = beyond * max(most_n, -least_n);
            let kept_n = clamp(
                wanted_n,
                min(least_n - beyond_n - axial_n, 0.0),
                max(most_n + beyond_n - axial_n, 0.0),
            );
            self.offset_n += along * (kept_n - before_n);
        }
    }

    /// Change of the force on a way \[m\] of one tick: as on the tick before in as far as the way goes on in its direction,
    /// else `by_tangent`.
    fn onward(&self, by_tangent: Vec3, way: Vec3) -> Vec3 {
        let Some((change, before)) = self.course else {
            return by_tangent;
        };
        let along = dot(&way, &before);
        let square = dot(&before, &before) + TOLD_M * TOLD_M;
        let again = clamp(along / square, -1.0, 2.0);
        // Square of the cosine between the two; little of ways that are short.
        let told = along * along / (square * (dot(&way, &way) + TOLD_M * TOLD_M));
        by_tangent + (change * again - by_tangent) * told
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

    /// Multipliers of the contact rows as they were solved last \[N\]; none without rows.
    pub fn multipliers_n(&self) -> impl Iterator<Item = f32> {
        self.rows.multipliers_n()
    }

    /// What is left of the force before the model changed, less this model's \[N\].
    pub fn offset(&self) -> &Vec3 {
        &self.offset_n
    }
}

/// Factor per tick on what is left of the force before the model changed, from the last two times between changes \[ticks\]: the
/// longer one counts, so that a frame that comes late and its successor that does not are no two quick ones.
fn fade(ticks: [u8; 2]) -> f32 {
    let between = ticks[0].max(ticks[1]);
    if between >= BLEND_TICKS {
        return BLEND_DECAY;
    }
    f32::from(between) / f32::from(between + 1)
}

/// Length of a vector.
fn length(v: &Vec3) -> f32 {
    libm::sqrtf(dot(v, v))
}

/// Force of a wrench \[N\]: consoles with three motors have no moments to give.
fn linear_part(wrench: &[f32; 6]) -> Vec3 {
    let [x, y, z, ..] = *wrench;
    Vec3::new(x, y, z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::message::Contact;
    use crate::wire::{Header, Kind, PROTOCOL_VERSION, ValidContact};

    /// Solved for this console time \[us\].
    const SOLVED: u64 = 1_000_000;

    /// A spring of `stiffness` \[N/m\] below z = 0, as solved at the height `z` \[m\].
    fn floor(stiffness: f32, z: f32) -> Contact {
        let mut contact = Contact {
            tool: 0,
            position_m: [0.0, 0.0, z],
            orientation: [0.0, 0.0, 0.0, 1.0],
            wrench: [0.0, 0.0, -stiffness * min(z, 0.0), 0.0, 0.0, 0.0],
            tangent: [0.0; 21],
            gap_m: if z > 0.0 { z } else { 0.0 },
            normal: [0.0, 0.0, 1.0],
            relaxation_per_s: 0.0,
            horizon_us: 100_000,
        };
        contact.tangent[11] = -stiffness;
        contact
    }

    /// A console whose grip stands where it is put, without lead.
    struct Stand {
        render: Render,
        now_us: u64,
    }

    impl Stand {
        fn new() -> Self {
            let mut tuning = Tuning::default();
            tuning.guards.lead = false;
            Stand {
                render: Render::new([1e3, 1e9], TICK_S, tuning),
                now_us: SOLVED,
            }
        }

        fn take(&mut self, contact: Contact, solved_us: u64, z: f32) {
            let header = Header {
                version: PROTOCOL_VERSION,
                kind: Kind::Contact,
                session: 1,
                sequence: 7,
                console_time_us: solved_us,
            };
            let frame = ValidContact::new(header, contact).expect("a valid contact");
            self.render
                .take(&frame.into(), None, None, &grip(z), self.now_us);
        }

        fn force(&mut self, z: f32) -> f32 {
            let force = self.render.force(&grip(z), &Vec3::zeros(), self.now_us);
            self.now_us += 1000;
            force.z
        }

        /// Lets the blend from nothing end.
        fn settle(&mut self, contact: Contact, z: f32) -> f32 {
            for _ in 0..15 {
                self.take(contact, self.now_us, z);
                for _ in 0..BLEND_TICKS {
                    self.force(z);
                }
            }
            self.force(z)
        }
    }

    fn grip(z: f32) -> Grip {
        Grip {
            position_m: Vec3::new(0.0, 0.0, z),
            orientation: [0.0, 0.0, 0.0, 1.0],
        }
    }

    #[test]
    fn age_counts_from_the_solved_state_and_takes_the_force_away() {
        let mut stand = Stand::new();
        let force = stand.settle(floor(1000.0, -1e-3), -1e-3);
        assert!((force - 1.0).abs() < 1e-5, "{force}");
        let solved_us = stand.now_us - 1000 * (u64::from(BLEND_TICKS) + 1);
        let mut at = |age_us: u64| {
            stand.now_us = solved_us + age_us;
            stand.force(-1e-3)
        };
        assert!((at(100_000) - 1.0).abs() < 1e-5);
        assert!((at(115_000) - 0.5).abs() < 1e-5);
        assert!(at(129_999) > 0.0);
        assert_eq!(at(130_000).to_bits(), 0);
        let freshness = |age_us| stand.render.freshness(solved_us + age_us);
        assert_eq!(freshness(100_000), Freshness::Fresh);
        assert_eq!(freshness(100_001), Freshness::Stale);
        assert_eq!(freshness(600_000), Freshness::Stale);
        assert_eq!(freshness(600_001), Freshness::Lost);
    }

    /// The offset alone decides what is left of the old force: exp(-t / 10 ms), below 1 % after 50 ms.
    #[test]
    fn a_blend_starts_at_the_old_force_and_is_gone_after_50_ms() {
        let mut stand = Stand::new();
        stand.settle(floor(5000.0, -1e-3), -1e-3);
        stand.take(floor(2000.0, -1e-3), stand.now_us, -1e-3);
        for ms in 0..=50 {
            let left = (stand.force(-1e-3) - 2.0) / 3.0;
            let expected = (-f64::from(ms) / 10.0).exp();
            assert!((f64::from(left) - expected).abs() < 2e-5, "{ms} ms: {left}");
        }
    }

    /// A simulator that knows no stiffness, on a force that grows by 50 mN a tick: what is felt is as late as the next frame, and not
    /// later by 10 ms.
    #[test]
    fn frames_that_come_often_are_felt_within_two_of_them() {
        for between in [1, 2, 4] {
            let mut stand = Stand::new();
            let growing = |now_us: u64| {
                let mut contact = floor(0.0, -1e-3);
                contact.wrench[2] = 50e-6 * (now_us - SOLVED) as f32;
                contact
            };
            let mut worst: f32 = 0.0;
            for tick in 0..100 {
                if tick % between == 0 {
                    stand.take(growing(stand.now_us), stand.now_us, -1e-3);
                }
                let wanted = growing(stand.now_us).wrench[2];
                let force = stand.force(-1e-3);
                if tick >= 50 {
                    worst = max(worst, wanted - force);
                }
            }
            assert!(worst < 50e-3 * 2.01 * between as f32, "{between}: {worst}");
        }
    }

    /// A swap while the grip moves: the old force goes on along the new tangent.
    #[test]
    fn a_moving_grip_feels_no_step_at_a_swap() {
        let mut stand = Stand::new();
        stand.settle(floor(1000.0, -1e-3), -1e-3);
        let before = stand.force(-1e-3);
        stand.take(floor(1000.0, -0.5e-3), stand.now_us, -1.1e-3);
        let after = stand.force(-1.1e-3);
        assert!((after - before - 0.1).abs() < 1e-5, "{before} {after}");
    }

    /// Withdrawing in the middle of a blend: the missing part of a push must not become a pull.
    #[test]
    fn a_blend_never_pulls_where_nothing_pulled_before() {
        let mut stand = Stand::new();
        stand.take(floor(2000.0, -1e-3), stand.now_us, -1e-3);
        assert_eq!(stand.force(-1e-3), 0.0);
        for ms in 0_u8..20 {
            let force = stand.force(-1e-3 + 0.2e-3 * f32::from(ms));
            assert!(force >= -1e-6, "{ms} ms: {force}");
        }
    }

    /// Withdrawing as fast as the force goes: a course that has come to its end does not go on below nothing.
    #[test]
    fn a_course_that_ends_does_not_pull() {
        let mut stand = Stand::new();
        stand.settle(floor(1000.0, -0.3e-3), -0.3e-3);
        let onward = Vec3::new(0.0, 0.0, 0.25);
        let force = |stand: &mut Stand, z| {
            let force = stand.render.force(&grip(z), &onward, stand.now_us);
            stand.now_us += 1000;
            force.z
        };
        let before = force(&mut stand, -0.05e-3);
        assert!((before - 0.05).abs() < 1e-3, "{before}");
        stand.take(floor(1000.0, 0.2e-3), stand.now_us, 0.2e-3);
        for ms in 0_u8..20 {
            let force = force(&mut stand, 0.2e-3 + 0.25e-3 * f32::from(ms));
            assert!(force >= 0.0, "{ms} ms: {force}");
        }
    }

    /// The other side of a thin sheet: what was rendered points into the new normal's tissue, and still
    /// fades instead of falling away in one tick.
    #[test]
    fn a_force_against_the_new_normal_fades_too() {
        let mut stand = Stand::new();
        let mut ceiling = floor(0.0, 5e-3);
        (ceiling.gap_m, ceiling.normal) = (0.0, [0.0, 0.0, -1.0]);
        ceiling.wrench[2] = -3.0;
        stand.settle(ceiling, 5e-3);
        stand.take(floor(2000.0, 5e-3), stand.now_us, 5e-3);
        assert!((stand.force(5e-3) + 3.0).abs() < 1e-5);
        assert!((stand.force(5e-3) + 3.0 * BLEND_DECAY).abs() < 1e-5);
    }

    #[test]
    fn the_longest_force_is_kept_to_its_limit() {
        let mut stand = Stand::new();
        stand.render.max_force_n = 10.0;
        let force = stand.settle(floor(1e5, -0.05), -0.05);
        assert!((force - 10.0).abs() < 1e-4, "{force}");
    }

    /// A tangent of fifty times the force's own stiffness, and a hand that goes on by half a millimetre.
    #[test]
    fn a_force_grows_at_the_stiffness_that_is_stable_at_most() {
        let mut stand = Stand::new();
        stand.render.stable_n_per_m = 8800.0;
        let mut contact = floor(1000.0, -1e-3);
        contact.tangent[11] *= 50.0;
        let force = stand.settle(contact, -1e-3);
        assert!((force - 1.0).abs() < 1e-5, "{force}");
        for (z, most) in [(-1.01e-3, 1.4 + 0.088), (-1.5e-3, 1.4 + 4.4)] {
            let force = stand.force(z);
            assert!((force - most).abs() < 1e-2, "{z}: {force}");
        }
    }

    /// Frames of a spring of 1000 N/m whose tangent says another stiffness, on a path of 1 mm a frame.
    fn scale_after(told: f32, frames: u8) -> f32 {
        let mut stand = Stand::new();
        for frame in 0..frames {
            let z = -2e-3 - 1e-3 * f32::from(frame);
            let mut contact = floor(1000.0, z);
            contact.tangent[11] = -told;
            stand.take(contact, stand.now_us, z);
            stand.now_us += 30_000;
        }
        stand.render.trust.scale()
    }

    #[test]
    fn a_tangent_that_is_wrong_by_a_factor_is_found_out() {
        assert_eq!(scale_after(1250.0, 1), 1.0);
        for told in [500.0, 750.0, 1000.0, 1250.0, 2000.0] {
            let scale = scale_after(told, 4);
            assert!(
                (scale * told / 1000.0 - 1.0).abs() < 1e-3,
                "{told}: {scale}"
            );
        }
        assert_eq!(scale_after(10_000.0, 4), 0.4);
    }

    /// Changes across what was foretold: nothing is explained, and little is believed at the next frame's age.
    #[test]
    fn what_explains_nothing_is_worth_less_the_older_it_is() {
        let (told, span_s) = (Vec3::x(), 0.03);
        let mut right = Trust::FULL;
        let mut wrong = Trust::FULL;
        for _ in 0..5 {
            right.learn(&told, &(told * 0.8), span_s);
            wrong.learn(&told, &Vec3::y(), span_s);
        }
        assert!(right.confidence(0.1) > 0.99, "{}", right.confidence(0.1));
        assert!((right.scale() - 0.8).abs() < 1e-3);
        assert!(wrong.confidence(0.03) < 0.2 && wrong.confidence(0.0) == 1.0);
        assert!(wrong.confidence(0.1) < wrong.confidence(0.03));
    }

    /// The trapezoidal rule is exact for a force that is quadratic in the way: non-linear tissue with a right
    /// tangent is not mistaken for linear tissue with a wrong one.
    #[test]
    fn hardening_tissue_is_no_wrong_tangent() {
        let mut stand = Stand::new();
        for frame in 0..5_u8 {
            let deep = 2e-3 + 1.5e-3 * f32::from(frame);
            let mut contact = floor(0.0, -deep);
            contact.wrench[2] = 1e5 * deep * deep;
            contact.tangent[11] = -2e5 * deep;
            stand.take(contact, stand.now_us, -deep);
            stand.now_us += 30_000;
        }
        assert!((stand.render.trust.scale() - 1.0).abs() < 1e-4);
    }
}
