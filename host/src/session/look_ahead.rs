//! How the axial force of a needle goes on: the solver goes there beforehand, on a copy of its state.
//!
//! Entry point: [`course`]. From the solved pose a few steps forward along the slide and a few backward say what slides
//! next, where the tip touches, and where a boundary gives way; the console has it between two frames.

use crate::model::Model;
use crate::needle::{NeedleReport, TipPlace};
use crate::step::{State, Status, Workspace, step};
use crate::tool::ToolSample;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use sutura_shared::wire::message::{COURSE_POINTS, Course};

/// Most points of a course that are on the way forward: there is more to come by than on the way back.
const FORWARD_POINTS: usize = 8;
/// The nearest is looked at most closely: steps grow with these powers of their number, forward and backward.
const GROWTH: [f64; 2] = [1.5, 2.0];

/// How far to look, and with how many steps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Look {
    /// Way forward, and backward \[m\], (2).
    pub reach_m: [f64; 2],
    /// Steps forward, and backward, (2).
    pub steps: [usize; 2],
    /// Speed along the slide that friction is to have \[m/s\].
    pub speed_m_per_s: f64,
}

/// One of the steps.
#[derive(Clone, Copy, Debug)]
struct Visit {
    way_m: f64,
    report: NeedleReport,
}

/// The axial force of `needle`, which the tool of the first sample holds, on its way both ways from `state`.
pub(super) fn course(
    model: &Model,
    state: &State,
    samples: &[ToolSample],
    needle: &NeedleReport,
    look: &Look,
    work: &mut Workspace,
) -> Course {
    let mut course = Course::default();
    let mut free = COURSE_POINTS;
    let mut next = 0;
    for (side, sign) in [1.0, -1.0].into_iter().enumerate() {
        let mut visits = vec![Visit {
            way_m: 0.0,
            report: *needle,
        }];
        visit(model, state, samples, look, side, sign, &mut visits, work);
        let mut points = vec![[0.0, needle.axial_n]];
        points_of(&visits, &mut points);
        let kept = if side == 0 { FORWARD_POINTS } else { free };
        thin(&mut points, kept + 1);
        points.remove(0);
        for (slot, point) in course.points.iter_mut().skip(next).zip(&points) {
            *slot = point.map(|value| value as f32);
        }
        free -= points.len();
        next += points.len();
        let count = points.len() as u8;
        if side == 0 {
            course.forward = count;
        } else {
            course.backward = count;
        }
    }
    course
}

/// Steps one way.
#[expect(clippy::too_many_arguments, reason = "they are the solver")]
fn visit(
    model: &Model,
    state: &State,
    samples: &[ToolSample],
    look: &Look,
    side: usize,
    sign: f64,
    visits: &mut Vec<Visit>,
    work: &mut Workspace,
) {
    let steps = look.steps[side];
    let Some((start, needle)) = samples
        .first()
        .zip(visits.first().map(|first| first.report))
    else {
        return;
    };
    if steps == 0 {
        return;
    }
    let mut trial = state.clone();
    let mut samples = samples.to_vec();
    for index in 1..=steps {
        let way_m = look.reach_m[side] * (index as f64 / steps as f64).powf(GROWTH[side]);
        samples[0] = slid(start, &needle.slide, sign * way_m);
        let passed_us = 1e6 * way_m / look.speed_m_per_s.max(1e-3);
        for sample in &mut samples {
            sample.console_time_us = start.console_time_us + passed_us as u64;
        }
        let report = step(model, &mut trial, &samples, work);
        let found = report.needles().iter().find(|other| other.id == needle.id);
        match found {
            Some(found) if report.status == Status::Ok => visits.push(Visit {
                way_m,
                report: *found,
            }),
            _ => return,
        }
    }
}

/// A sample with its grip moved along the slide.
fn slid(sample: &ToolSample, slide: &[f64; 6], way_m: f64) -> ToolSample {
    let [x, y, z, a, b, c] = *slide;
    let (shift, turn) = (Vector3::new(x, y, z), Vector3::new(a, b, c));
    let curvature = turn.norm();
    let moved = if curvature > 0.0 {
        let angle = curvature * way_m;
        let across = turn.cross(&shift) / curvature;
        (shift * angle.sin() + across * (1.0 - angle.cos())) / curvature
    } else {
        shift * way_m
    };
    let [qx, qy, qz, qw] = sample.orientation;
    let turned = UnitQuaternion::from_scaled_axis(turn * way_m)
        * UnitQuaternion::from_quaternion(Quaternion::new(qw, qx, qy, qz));
    let turned = turned.coords;
    ToolSample {
        position_m: (Vector3::from(sample.position_m) + moved).into(),
        orientation: [turned.x, turned.y, turned.z, turned.w],
        ..*sample
    }
}

/// Straight lines between what was visited; where the tip touches they bend, and where a boundary gives way they jump.
fn points_of(visits: &[Visit], points: &mut Vec<[f64; 2]>) {
    for (index, pair) in visits.windows(2).enumerate() {
        let [from, to] = pair else {
            continue;
        };
        let after = visits.get(index + 2);
        let before = index.checked_sub(1).and_then(|before| visits.get(before));
        let (held, holds) = (
            from.report.tip == TipPlace::Holding,
            to.report.tip == TipPlace::Holding,
        );
        if to.report.punctures > from.report.punctures {
            if held {
                let (way_m, axial_n) = threshold(before, from, to);
                points.push([way_m, axial_n]);
                points.push([way_m, past(way_m, to, after)]);
            }
        } else if holds && !held && to.way_m > from.way_m {
            // Without the face, friction alone is felt; of what is touched the force grows from nothing.
            let stiffness = to.report.stiffness_n_per_m[1].max(1e-3);
            let way_m = (to.way_m - to.report.hold_n / stiffness).clamp(from.way_m, to.way_m);
            points.push([way_m, to.report.axial_n + to.report.hold_n]);
        }
        points.push([to.way_m, to.report.axial_n]);
    }
}

/// Takes out what the others come closest to, until `most` are left; jumps and both ends stay.
fn thin(points: &mut Vec<[f64; 2]>, most: usize) {
    while points.len() > most {
        let spared = |index: usize| {
            let [before, own, after] = [points[index - 1], points[index], points[index + 1]];
            if before[0] == own[0] || own[0] == after[0] {
                return f64::MAX;
            }
            let part = (own[0] - before[0]) / (after[0] - before[0]);
            (before[1] + (after[1] - before[1]) * part - own[1]).abs()
        };
        let least = (1..points.len() - 1).min_by(|a, b| spared(*a).total_cmp(&spared(*b)));
        // Without any in between, the farthest goes.
        let least = least.filter(|index| spared(*index) < f64::MAX);
        points.remove(least.unwrap_or(points.len() - 1));
    }
}

/// Where the tip's force is as large as the boundary bears, and the axial force there.
fn threshold(before: Option<&Visit>, from: &Visit, to: &Visit) -> (f64, f64) {
    let slope = before
        .filter(|before| before.report.tip == TipPlace::Holding && before.way_m < from.way_m)
        .map(|before| {
            let way_m = from.way_m - before.way_m;
            (from.report.hold_n - before.report.hold_n) / way_m
        })
        .filter(|slope| *slope > 0.0)
        .unwrap_or(from.report.stiffness_n_per_m[1].max(1e-3));
    let left_n = (from.report.puncture_n - from.report.hold_n).max(0.0);
    let way_m = (left_n / slope).min(to.way_m - from.way_m);
    let axial_n = from.report.axial_n - from.report.stiffness_n_per_m[1] * way_m;
    (from.way_m + way_m, axial_n)
}

/// The axial force right after a boundary has given way: as straight as it goes on from there.
fn past(way_m: f64, to: &Visit, after: Option<&Visit>) -> f64 {
    let goes_on = after.filter(|after| {
        after.report.tip == to.report.tip && after.report.punctures == to.report.punctures
    });
    let slope = goes_on.map_or(0.0, |after| {
        (after.report.axial_n - to.report.axial_n) / (after.way_m - to.way_m)
    });
    to.report.axial_n - slope * (to.way_m - way_m)
}
