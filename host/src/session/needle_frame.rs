//! The solver's needle as the wire carries it: f32, within the wire's limits.
//!
//! Entry point: [`needle_frame`].

use super::contact_frame::GRIP;
use crate::needle::TipPlace;
use crate::step::StepReport;
use sutura_shared::wire::message::{Course, Friction, Needle, Tip};
use sutura_shared::wire::validate::{MAX_TANGENT, MAX_WRENCH};

/// A needle in the grip of the driven tool, as a step left it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeldNeedle {
    /// Tool that holds it.
    pub tool: u8,
    /// Id of the needle.
    pub needle: u8,
    /// Motion of the grip per metre of slide, tip first: linear \[1\], then angular \[1/m\], world frame, (6).
    pub slide: [f64; 6],
    /// Where the tip is.
    pub tip: Tip,
    /// Whether it is in tissue that it was not seen to go into, and touches nothing until it has been outside: for the
    /// console its tip is outside.
    pub waits: bool,
    /// Whether it sticks.
    pub friction: Friction,
    /// Axial force on the tool \[N\], positive when it pulls the needle on.
    pub axial_n: f64,
    /// What withstands a slide forward, and backward \[N\], (2), magnitudes.
    pub friction_n: [f64; 2],
    /// Axial force lost per metre of slide: all sticking, and now \[N/m\], (2), magnitudes.
    pub stiffness_n_per_m: [f64; 2],
    /// Force of the tip on the boundary that holds it \[N\].
    pub hold_n: f64,
    /// Such a force that punctures it \[N\]; infinite where none does.
    pub puncture_n: f64,
    /// Axial force right after the puncture, at the same pose \[N\].
    pub punctured_n: f64,
    /// The axial force on the way from there; none where nobody has looked.
    pub course: Course,
}

impl HeldNeedle {
    /// The needle in the grip of `driven`, for the wire.
    pub(super) fn in_grip(report: &StepReport, driven: u8) -> Option<Self> {
        let mut needles = report.needles().iter();
        let needle = needles.find(|n| n.held_by == Some(driven))?;
        let friction = match (needle.slides, needle.axial_n > 0.0) {
            (false, _) => Friction::Sticks,
            (true, false) => Friction::Forward,
            (true, true) => Friction::Backward,
        };
        // What sticks gives way, too, once the boundary does: at most friction is left.
        let left_n = needle.axial_n + needle.hold_n;
        let [forward_n, backward_n] = needle.limit_n;
        Some(Self {
            tool: driven,
            needle: needle.id,
            slide: needle.slide,
            tip: match needle.tip {
                TipPlace::Outside | TipPlace::Waiting => Tip::Outside,
                TipPlace::Holding => Tip::Holding,
                TipPlace::Inside => Tip::Inside,
            },
            waits: needle.tip == TipPlace::Waiting,
            friction,
            axial_n: needle.axial_n,
            friction_n: needle.limit_n,
            stiffness_n_per_m: needle.stiffness_n_per_m,
            hold_n: needle.hold_n,
            puncture_n: needle.puncture_n,
            punctured_n: left_n.max(-forward_n).min(backward_n),
            course: Course::default(),
        })
    }
}

/// Ids of needles that stand for the jaws of a tool: so much less the tool's id.
const JAWS: u8 = u8::MAX;

impl HeldNeedle {
    /// The tissue in the jaws of `driven`, as if it were a needle that tissue holds along the way on which the jaws are pulled
    /// off: what slips does so by friction, to either side.
    pub(super) fn in_jaws(report: &StepReport, driven: u8) -> Option<Self> {
        let mut jaws = report.jaws().iter();
        let jaws = jaws.find(|jaws| jaws.tool == driven && jaws.points > 0)?;
        let [x, y, z] = jaws.away;
        let axial_n: f64 = jaws
            .force_n
            .iter()
            .zip(jaws.away)
            .map(|(f, a)| -f * a)
            .sum();
        let slips = jaws.slipping >= jaws.points;
        Some(Self {
            tool: driven,
            needle: JAWS.wrapping_sub(driven),
            slide: [x, y, z, 0.0, 0.0, 0.0],
            tip: Tip::Inside,
            waits: false,
            friction: if slips {
                Friction::Forward
            } else {
                Friction::Sticks
            },
            axial_n,
            friction_n: [jaws.limit_n; 2],
            stiffness_n_per_m: jaws.stiffness_n_per_m,
            hold_n: 0.0,
            puncture_n: 0.0,
            punctured_n: axial_n,
            course: Course::default(),
        })
    }
}

/// The frame for the state that `needle` was solved for.
pub fn needle_frame(needle: &HeldNeedle) -> Needle {
    // Round-off below zero, and thresholds that nothing reaches; what is not a number stays that, and is
    // not sent.
    let force = |value: f64| (value as f32).clamp(0.0, MAX_WRENCH);
    Needle {
        tool: GRIP,
        needle: needle.needle,
        slide: needle.slide.map(|value| value as f32),
        tip: needle.tip,
        friction: needle.friction,
        axial_n: needle.axial_n as f32,
        friction_n: needle.friction_n.map(force),
        stiffness_n_per_m: needle
            .stiffness_n_per_m
            .map(|value| (value as f32).clamp(0.0, MAX_TANGENT)),
        hold_n: force(needle.hold_n),
        puncture_n: force(needle.puncture_n),
        punctured_n: needle.punctured_n as f32,
        course: needle.course,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::jaws::JawsReport;
    use sutura_shared::wire::message::COURSE_POINTS;
    use sutura_shared::wire::{Message, Reject};

    const NEEDLE: HeldNeedle = HeldNeedle {
        tool: 0,
        needle: 2,
        slide: [0.0, 0.0, -1.0, 0.0, 0.0, 0.0],
        tip: Tip::Holding,
        waits: false,
        friction: Friction::Forward,
        axial_n: -0.25,
        friction_n: [0.25, 0.125],
        stiffness_n_per_m: [90.0, 30.0],
        hold_n: 0.125,
        puncture_n: f64::INFINITY,
        punctured_n: -0.125,
        course: Course {
            forward: 2,
            backward: 1,
            points: [[0.5; 2]; COURSE_POINTS],
        },
    };

    #[test]
    fn the_frame_passes_the_consoles_own_check() {
        let frame = needle_frame(&NEEDLE);
        assert_eq!(frame.check(), Ok(()));
        assert_eq!(frame.needle, 2);
        assert_eq!((frame.axial_n, frame.punctured_n), (-0.25, -0.125));
        assert_eq!(frame.friction_n, [0.25, 0.125]);
        assert_eq!(frame.course, NEEDLE.course);
        // Never punctured: the largest force that the wire has.
        assert_eq!(frame.puncture_n, MAX_WRENCH);
    }

    /// What jaws pull at is felt along the way on which they are pulled off, held by friction to either side.
    #[test]
    fn tissue_in_jaws_is_a_needle_that_it_holds() {
        let mut report = StepReport::default();
        assert_eq!(HeldNeedle::in_jaws(&report, 3), None);
        report.jaws_mut(1)[0] = JawsReport {
            tool: 3,
            points: 8,
            force_n: [0.3, 0.0, 0.4],
            in_plane_n: 0.5,
            limit_n: f64::INFINITY,
            away: [0.6, 0.0, 0.8],
            stiffness_n_per_m: [200.0, 150.0],
            ..JawsReport::default()
        };
        assert_eq!(HeldNeedle::in_jaws(&report, 4), None);
        let held = HeldNeedle::in_jaws(&report, 3).expect("it holds tissue");
        let frame = needle_frame(&held);
        assert_eq!(frame.check(), Ok(()));
        assert_eq!(
            (frame.tool, frame.needle, frame.tip),
            (GRIP, 252, Tip::Inside)
        );
        assert_eq!((frame.axial_n, frame.friction), (-0.5, Friction::Sticks));
        assert_eq!(frame.friction_n, [MAX_WRENCH; 2]);
        assert_eq!(frame.stiffness_n_per_m, [200.0, 150.0]);
        // At the bound the tissue goes no further with them.
        (
            report.jaws_mut(1)[0].limit_n,
            report.jaws_mut(1)[0].slipping,
        ) = (0.5, 8);
        let slips = HeldNeedle::in_jaws(&report, 3).expect("it holds tissue");
        assert_eq!(
            (slips.friction, slips.friction_n),
            (Friction::Forward, [0.5; 2])
        );
        report.jaws_mut(1)[0].points = 0;
        assert_eq!(HeldNeedle::in_jaws(&report, 3), None);
    }

    #[test]
    fn round_off_below_zero_is_sent_as_zero_and_nonsense_is_not_sent() {
        let below = HeldNeedle {
            hold_n: -1e-17,
            friction_n: [-1e-17, 0.0],
            ..NEEDLE
        };
        let frame = needle_frame(&below);
        assert_eq!((frame.check(), frame.hold_n), (Ok(()), 0.0));
        let nonsense = HeldNeedle {
            friction_n: [f64::NAN, 0.0],
            ..NEEDLE
        };
        let frame = needle_frame(&nonsense);
        assert_eq!(frame.check(), Err(Reject::NotFinite));
    }
}
