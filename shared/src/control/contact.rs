//! The local contact model: the force between two frames of the host.
//!
//! Entry points: [`LocalContact::force`] every tick, [`LocalContact::blend_from`] when the model changes.
//! A tangent (Otaduy and Lin 2006) with a gap, so that contact can open: exact for a plane spring. Only
//! forces and translations are rendered here: a console with three joints has no moments to give.

use super::{MAX_HORIZON_US, STALE_DECAY_US};
use crate::math::{Vec3, dot, max, min, shortened};
use crate::wire::ValidContact;

/// Factor per tick on what is left of the force before the model changed: a time constant of 10 ms, below
/// which a change of force is felt as a knock.
const BLEND_DECAY: f32 = 0.904_837_4;

/// How old a contact may be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Freshness {
    /// There is none.
    Missing,
    /// Within its horizon.
    Fresh,
    /// Beyond its horizon.
    Stale,
    /// So far beyond that the console should no longer wait for another one.
    Lost,
}

/// The part of a frame that a console with three joints renders, and how it is blended in.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct LocalContact {
    /// Grip position that was solved for \[m\].
    position_m: Vec3,
    /// Force on the tool there \[N\].
    force_n: Vec3,
    /// Columns of d force / d position \[N/m\]; symmetric.
    tangent: [Vec3; 3],
    /// Way along `-normal` until the tool touches \[m\].
    gap_m: f32,
    /// Out of the tissue.
    normal: Vec3,
    relaxation_per_s: f32,
    horizon_us: u32,
    /// Console time of the state that was solved for \[us\].
    console_time_us: u64,
    pub sequence: u32,
    /// Age when it was first applied \[us\].
    pub applied_age_us: u32,
    /// What is left of the force before the model changed, less this model's \[N\].
    offset_n: Vec3,
    /// Part of the force before the model changed that pulled on this model's side, at most 0 \[N\]; fades
    /// like the offset.
    pull_n: f32,
    /// Largest force \[N\].
    max_force_n: f32,
}

impl LocalContact {
    /// The model of a frame that arrives at `now_us`.
    pub fn new(frame: &ValidContact, now_us: u64, max_force_n: f32) -> Self {
        let body = frame.body();
        let [fx, fy, fz, ..] = body.wrench;
        // Rows of the packed upper triangle: xx xy xz .. | yy yz .. | zz ..
        let [xx, xy, xz, _, _, _, yy, yz, _, _, _, zz, ..] = body.tangent;
        let mut contact = LocalContact {
            position_m: Vec3::from(body.position_m),
            force_n: Vec3::new(fx, fy, fz),
            tangent: [
                Vec3::new(xx, xy, xz),
                Vec3::new(xy, yy, yz),
                Vec3::new(xz, yz, zz),
            ],
            gap_m: body.gap_m,
            normal: Vec3::from(body.normal),
            relaxation_per_s: body.relaxation_per_s,
            horizon_us: body.horizon_us.min(MAX_HORIZON_US),
            console_time_us: frame.console_time_us(),
            sequence: frame.sequence(),
            applied_age_us: 0,
            offset_n: Vec3::zeros(),
            pull_n: 0.0,
            max_force_n,
        };
        contact.applied_age_us = contact.age_us(now_us);
        contact
    }

    /// Age of the data \[us\], counted from the console time that was solved for.
    pub fn age_us(&self, now_us: u64) -> u32 {
        let age = now_us.saturating_sub(self.console_time_us);
        // The largest value means "none" on the wire.
        u32::try_from(age).map_or(u32::MAX - 1, |age| age.min(u32::MAX - 1))
    }

    /// How old the data is, in what it means.
    pub fn freshness(&self, now_us: u64) -> Freshness {
        match self.age_us(now_us).saturating_sub(self.horizon_us) {
            0 => Freshness::Fresh,
            1..=super::LOST_AFTER_US => Freshness::Stale,
            _ => Freshness::Lost,
        }
    }

    /// Whether this was solved for an earlier state than `other`.
    pub fn is_older_than(&self, other: &LocalContact) -> bool {
        self.console_time_us < other.console_time_us
    }

    /// Lets one tick pass for the blend.
    pub fn fade_blend(&mut self) {
        self.offset_n *= BLEND_DECAY;
        self.pull_n *= BLEND_DECAY;
    }

    /// Makes the force at this moment continue from `rendered`, for a contact that is fresh.
    pub fn blend_from(&mut self, rendered: &Vec3, position: &Vec3, now_us: u64) {
        self.offset_n = rendered - self.model(position, self.age_us(now_us));
        self.pull_n = min(dot(&self.normal, rendered), 0.0);
    }

    /// Contact force on the grip \[N\], limited in length, 0 when the data is too old.
    pub fn force(&self, position: &Vec3, now_us: u64) -> Vec3 {
        let age_us = self.age_us(now_us);
        let share = self.staleness(age_us);
        if share > 0.0 {
            let blended = self.model(position, age_us) + self.offset_n;
            shortened(self.without_new_pull(blended), self.max_force_n) * share
        } else {
            Vec3::zeros()
        }
    }

    /// An offset that holds a push back would pull once the tool leaves the tissue: only what pulled before
    /// the model changed may go on pulling, while it fades.
    fn without_new_pull(&self, force: Vec3) -> Vec3 {
        let along = dot(&self.normal, &force);
        if along < self.pull_n {
            force + self.normal * (self.pull_n - along)
        } else {
            force
        }
    }

    /// 1 up to the horizon, then down to 0 in a straight line.
    fn staleness(&self, age_us: u32) -> f32 {
        let over_us = age_us.saturating_sub(self.horizon_us);
        let left_us = STALE_DECAY_US.saturating_sub(over_us);
        left_us as f32 * (1.0 / STALE_DECAY_US as f32)
    }

    /// The frame's own force at another position and time.
    fn model(&self, position: &Vec3, age_us: u32) -> Vec3 {
        let moved = position - self.position_m;
        let force = if self.gap_m > 0.0 {
            self.force_across_gap(&moved)
        } else {
            self.force_n * self.relaxed(age_us) + self.stiffness_times(&moved)
        };
        // Tissue pushes and never pulls.
        if dot(&self.normal, &force) > 0.0 {
            shortened(force, self.max_force_n)
        } else {
            Vec3::zeros()
        }
    }

    /// What lies behind the gap acts only on the part of the way that is left after it.
    fn force_across_gap(&self, moved: &Vec3) -> Vec3 {
        let closed_m = -dot(&self.normal, moved);
        if closed_m > self.gap_m {
            self.stiffness_times(moved) * (1.0 - self.gap_m / closed_m)
        } else {
            Vec3::zeros()
        }
    }

    fn relaxed(&self, age_us: u32) -> f32 {
        max(0.0, 1.0 - self.relaxation_per_s * (age_us as f32 * 1e-6))
    }

    fn stiffness_times(&self, moved: &Vec3) -> Vec3 {
        let [x, y, z] = self.tangent;
        x * moved.x + y * moved.y + z * moved.z
    }

    /// What is left of the force before the model changed, less this model's \[N\].
    pub fn offset(&self) -> &Vec3 {
        &self.offset_n
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::message::Contact;
    use crate::wire::{Header, Kind, PROTOCOL_VERSION};

    /// Solved for this console time \[us\].
    const SOLVED: u64 = 1_000_000;
    /// A limit that nothing here reaches \[N\].
    const STRONG: f32 = 1e3;

    fn frame(body: Contact) -> LocalContact {
        let header = Header {
            version: PROTOCOL_VERSION,
            kind: Kind::Contact,
            session: 1,
            sequence: 7,
            console_time_us: SOLVED,
        };
        let frame = ValidContact::new(header, body).expect("the test gives a valid contact");
        LocalContact::new(&frame, SOLVED, STRONG)
    }

    /// A spring of `stiffness` \[N/m\] behind the plane through the origin, as solved at `position`.
    fn wall(stiffness: f32, normal: Vec3, position: Vec3) -> Contact {
        let height = dot(&normal, &position);
        let [x, y, z]: [f32; 3] = normal.into();
        let mut tangent = [0.0; 21];
        for (index, product) in
            [0, 1, 2, 6, 7, 11]
                .into_iter()
                .zip([x * x, x * y, x * z, y * y, y * z, z * z])
        {
            tangent[index] = -stiffness * product;
        }
        let push = stiffness * max(0.0, -height);
        Contact {
            tool: 0,
            position_m: position.into(),
            orientation: [0.0, 0.0, 0.0, 1.0],
            wrench: [push * x, push * y, push * z, 0.0, 0.0, 0.0],
            tangent,
            gap_m: max(0.0, height),
            normal: normal.into(),
            relaxation_per_s: 0.0,
            horizon_us: 100_000,
        }
    }

    /// A linear wall is what the tangent model is exact for, touching or not, towards it or away.
    #[test]
    fn a_linear_wall_is_rendered_exactly() {
        let normal = Vec3::new(0.36, -0.48, 0.8);
        let along = Vec3::new(0.8, 0.6, 0.0);
        for solved in [-8e-3, -1e-3, 0.0, 2e-3, 9e-3] {
            let model = frame(wall(800.0, normal, normal * solved + along * 0.02));
            for height in [-9e-3, -8e-3, -2e-3, -1e-6, 0.0, 1e-6, 3e-3, 0.1] {
                let force = model.force(&(normal * height - along * 0.01), SOLVED);
                let expected = normal * (800.0 * max(0.0, -height));
                // Rounding of 9 mm times 800 N/m.
                let error = force - expected;
                assert!(
                    dot(&error, &error) < 2e-5 * 2e-5,
                    "{solved} {height}: {force} {expected}"
                );
            }
        }
    }

    #[test]
    fn a_gap_closes_where_it_says() {
        let mut contact = wall(1000.0, Vec3::z(), Vec3::new(0.0, 0.0, 4e-3));
        contact.gap_m = 3e-3;
        let model = frame(contact);
        let at = |z: f32| model.force(&Vec3::new(0.0, 0.0, z), SOLVED).z;
        assert_eq!(at(1.001e-3), 0.0);
        assert!((at(0.5e-3) - 0.5).abs() < 1e-5, "{}", at(0.5e-3));
        // Sideways is no way in.
        let sideways = model.force(&Vec3::new(0.1, 0.1, 4e-3), SOLVED);
        assert_eq!(sideways, Vec3::zeros());
    }

    #[test]
    fn tissue_never_pulls() {
        let mut contact = wall(1000.0, Vec3::z(), Vec3::new(0.0, 0.0, -1e-3));
        // A tangent of the wrong sign: pressing in would pull.
        contact.tangent[11] = 5000.0;
        let model = frame(contact);
        let force = model.force(&Vec3::new(0.0, 0.0, -2e-3), SOLVED);
        assert_eq!(force, Vec3::zeros());
    }

    #[test]
    fn age_counts_from_the_solved_state_and_takes_the_force_away() {
        let model = frame(wall(1000.0, Vec3::z(), Vec3::new(0.0, 0.0, -1e-3)));
        let at = |age_us: u64| model.force(&Vec3::new(0.0, 0.0, -1e-3), SOLVED + age_us).z;
        assert_eq!((at(0), at(100_000)), (1.0, 1.0));
        assert!((at(115_000) - 0.5).abs() < 1e-6);
        assert!(at(129_999) > 0.0);
        assert_eq!(at(130_000).to_bits(), 0);
        assert_eq!(at(u64::MAX - SOLVED).to_bits(), 0);
        let freshness = |age_us| model.freshness(SOLVED + age_us);
        assert_eq!(freshness(100_000), Freshness::Fresh);
        assert_eq!(freshness(100_001), Freshness::Stale);
        assert_eq!(freshness(600_000), Freshness::Stale);
        assert_eq!(freshness(600_001), Freshness::Lost);
        assert_eq!(model.age_us(u64::MAX), u32::MAX - 1);
    }

    #[test]
    fn the_console_caps_the_horizon() {
        let contact = Contact {
            horizon_us: u32::MAX,
            ..wall(1000.0, Vec3::z(), Vec3::zeros())
        };
        assert_eq!(frame(contact).horizon_us, 150_000);
    }

    #[test]
    fn force_relaxes_at_the_given_rate_and_not_below_nothing() {
        let contact = Contact {
            relaxation_per_s: 20.0,
            ..wall(1000.0, Vec3::z(), Vec3::new(0.0, 0.0, -1e-3))
        };
        let model = frame(contact);
        let at = |age_us: u64| model.force(&Vec3::new(0.0, 0.0, -1e-3), SOLVED + age_us).z;
        assert!((at(10_000) - 0.8).abs() < 1e-6);
        assert_eq!(at(51_000), 0.0);
    }

    /// The offset alone decides what is left of the old force: exp(-t / 10 ms), below 1 % after 50 ms.
    #[test]
    fn a_blend_starts_at_the_old_force_and_is_gone_after_50_ms() {
        let here = Vec3::new(0.0, 0.0, -1e-3);
        let mut model = frame(wall(2000.0, Vec3::z(), here));
        let old = Vec3::new(0.5, 0.0, 5.0);
        model.blend_from(&old, &here, SOLVED);
        let start = model.force(&here, SOLVED);
        let error = start - old;
        assert!(dot(&error, &error) < 1e-12, "{start}");
        for ms in 1..=50 {
            model.fade_blend();
            let left = (model.force(&here, SOLVED).z - 2.0) / 3.0;
            let expected = (-f64::from(ms) / 10.0).exp();
            assert!((f64::from(left) - expected).abs() < 1e-5, "{ms} ms: {left}");
        }
        assert!((model.force(&here, SOLVED).z - 2.0).abs() < 0.01 * 3.0);
    }

    /// Withdrawing in the middle of a blend: the missing part of a push must not become a pull.
    #[test]
    fn a_blend_never_pulls_where_nothing_pulled_before() {
        let inside = Vec3::new(0.0, 0.0, -1e-3);
        let mut model = frame(wall(2000.0, Vec3::z(), inside));
        model.blend_from(&Vec3::new(0.3, 0.0, 0.0), &inside, SOLVED);
        assert_eq!(model.force(&inside, SOLVED).z, 0.0);
        for ms in 0_u8..20 {
            model.fade_blend();
            let height = -1e-3 + 0.2e-3 * f32::from(ms);
            let force = model.force(&Vec3::new(0.0, 0.0, height), SOLVED);
            assert!(force.z >= -1e-6, "{ms} ms: {force}");
            assert!(force.x > 0.0, "along the surface it only fades: {force}");
        }
    }

    /// The other side of a thin sheet: what was rendered points into the new normal's tissue, and still
    /// fades instead of falling away in one tick.
    #[test]
    fn a_force_against_the_new_normal_fades_too() {
        let outside = Vec3::new(0.0, 0.0, 5e-3);
        let mut model = frame(wall(2000.0, Vec3::z(), outside));
        model.blend_from(&Vec3::new(0.0, 0.0, -3.0), &outside, SOLVED);
        assert_eq!(model.force(&outside, SOLVED).z, -3.0);
        model.fade_blend();
        assert!((model.force(&outside, SOLVED).z + 3.0 * BLEND_DECAY).abs() < 1e-6);
    }

    #[test]
    fn the_longest_force_is_kept_to_its_limit() {
        let mut model = frame(wall(1e5, Vec3::z(), Vec3::new(0.0, 0.0, -0.05)));
        model.max_force_n = 10.0;
        let force = model.force(&Vec3::new(0.01, 0.0, -0.05), SOLVED);
        assert!((force.z - 10.0).abs() < 1e-5, "{force}");
    }
}
