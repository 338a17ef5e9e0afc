//! How the axial force of a needle goes on: the solver goes there beforehand, on a copy of its state.
//!
//! Entry point: [`course`]. From the solved pose a few steps forward along the slide and a few backward say what slides
//! next, where the tip touches, and where a boundary gives way; the console has it between two frames.

use super::look_budget::{Ahead, LookBudget};
use crate::model::Model;
use crate::needle::{NeedleReport, TipPlace};
use crate::step::{State, Status, StepOptions, Workspace, step};
use crate::tool::ToolSample;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use sutura_shared::wire::message::{COURSE_POINTS, Course};

/// Most points of a course that are on the way forward, while the needle goes there, and while it goes back.
const FORWARD_POINTS: [usize; 2] = [8, 5];
/// The nearest is looked at most closely: steps grow with these powers of their number, forward and backward.
const GROWTH: [f64; 2] = [2.2, 2.2];

/// Points within this way are as near as they can be \[m\].
const NEAR_M: f64 = 5e-4;

/// How far to look, and with how many steps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Look {
    /// Way forward, and backward \[m\], (2).
    pub reach_m: [f64; 2],
    /// Steps forward, and backward, (2).
    pub steps: [usize; 2],
    /// What each of them is asked for.
    pub options: StepOptions,
    /// Speed along the slide that friction is to have \[m/s\].
    pub speed_m_per_s: f64,
    /// Whether it is on its way back.
    pub goes_back: bool,
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
    (work, budget): (&mut Workspace, &mut LookBudget),
) -> Course {
    let piece_m = model
        .sources
        .as_ref()
        .map_or(f64::MAX, |sources| sources.piece_m);
    let mut course = Course::default();
    let mut free = COURSE_POINTS;
    let mut next = 0;
    for (side, sign) in [1.0, -1.0].into_iter().enumerate() {
        let mut visits = vec![Visit {
            way_m: 0.0,
            report: *needle,
        }];
        visit(
            model,
            state,
            samples,
            look,
            (side, sign),
            &mut visits,
            (&mut *work, &mut *budget),
        );
        let mut points = vec![[0.0, needle.axial_n]];
        points_of(&visits, piece_m, &mut points);
        let kept = if side == 0 {
            FORWARD_POINTS[usize::from(look.goes_back)]
        } else {
            free
        };
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
fn visit(
    model: &Model,
    state: &State,
    samples: &[ToolSample],
    look: &Look,
    (side, sign): (usize, f64),
    visits: &mut Vec<Visit>,
    (work, budget): (&mut Workspace, &mut LookBudget),
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
        if !budget.allows(Ahead::Course, side) {
            return;
        }
        let report = step(model, &mut trial, &samples, &look.options, work);
        budget.made(Ahead::Course, side, &report);
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
fn points_of(visits: &[Visit], piece_m: f64, points: &mut Vec<[f64; 2]>) {
    let mut gave_way = false;
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
            // By then the host will have said more.
            if gave_way {
                return;
            }
            gave_way = true;
            if held {
                let (way_m, axial_n) = threshold(before, from, to);
                points.push([way_m, axial_n]);
                let left_n = past(way_m, to, after);
                points.push([way_m, left_n]);
                // What is seen by then sticks again at first, as stiff as all of it.
                if let Some(after) = after.filter(|after| after.report.slides) {
                    let stiffness = after.report.stiffness_n_per_m[0].max(1e-3);
                    let stuck_m = (left_n - after.report.axial_n) / stiffness;
                    if way_m + stuck_m < after.way_m && stuck_m > 0.0 {
                        points.push([way_m + stuck_m, after.report.axial_n]);
                        continue;
                    }
                }
            }
        } else if holds && !held && to.way_m > from.way_m {
            // The force goes on as it did, as nothing or as friction and cutting, until the face is touched.
            let stiffness = to.report.stiffness_n_per_m[1].max(1e-3);
            let slope = before
                .filter(|before| before.report.slides && from.report.slides)
                .filter(|before| before.way_m < from.way_m)
                .map_or(0.0, |before| {
                    let gained_n = from.report.axial_n - before.report.axial_n;
                    gained_n / (from.way_m - before.way_m)
                });
            let step_m = to.way_m - from.way_m;
            let meets_n = to.report.axial_n + stiffness * step_m - from.report.axial_n;
            let rises = (slope + stiffness).max(1e-3);
            let since_m = (meets_n / rises).clamp(0.0, step_m);
            let way_m = from.way_m + since_m;
            let axial_n = from.report.axial_n + slope * since_m;
            if points.last().is_none_or(|last| last[0] < way_m) {
                points.push([way_m, axial_n]);
            }
        }
        // Friction is that of the depth at which the last piece of a step began: what is found belongs there.
        let same = from.report.punctures == to.report.punctures;
        let rubs_on = [from, to]
            .iter()
            .all(|visit| visit.report.tip == TipPlace::Inside && visit.report.slides);
        let step_m = to.way_m - from.way_m;
        let last_m = if same && rubs_on {
            step_m / (step_m / piece_m).ceil().max(1.0)
        } else {
            0.0
        };
        let next = [to.way_m - last_m, to.report.axial_n];
        // What lags behind what is known already says nothing new.
        if points.last().is_none_or(|last| last[0] < next[0]) {
            points.push(next);
        }
    }
}

/// Takes out what the others come closest to, the farther the sooner, until `most` are left; jumps and both ends stay.
fn thin(points: &mut Vec<[f64; 2]>, most: usize) {
    while points.len() > most {
        let spared = |index: usize| {
            let [before, own, after] = [points[index - 1], points[index], points[index + 1]];
            if before[0] == own[0] || own[0] == after[0] {
                return f64::MAX;
            }
            let part = (own[0] - before[0]) / (after[0] - before[0]);
            let off = before[1] + (after[1] - before[1]) * part - own[1];
            off.abs() / (NEAR_M + own[0])
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

/// The axial force right after a boundary has given way: less by the friction that is new where the needle is seen.
fn past(way_m: f64, to: &Visit, after: Option<&Visit>) -> f64 {
    let goes_on = after.filter(|after| {
        let same = after.report.punctures == to.report.punctures;
        same && after.report.tip == to.report.tip && to.report.slides && after.report.slides
    });
    let slope = goes_on.map_or(0.0, |after| {
        (after.report.axial_n - to.report.axial_n) / (after.way_m - to.way_m)
    });
    to.report.axial_n - slope * (to.way_m - way_m)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn visit(way_m: f64, tip: TipPlace, axial_n: f64, hold_n: f64, punctures: u32) -> Visit {
        Visit {
            way_m,
            report: NeedleReport {
                tip,
                axial_n,
                hold_n,
                punctures,
                puncture_n: if tip == TipPlace::Holding { 0.25 } else { 0.0 },
                stiffness_n_per_m: [100.0; 2],
                slides: tip == TipPlace::Inside,
                ..NeedleReport::default()
            },
        }
    }

    /// Touches after 1.5 mm, gives way 2.5 mm later, and rubs more by 20 N/m from then on.
    #[test]
    fn a_touch_is_a_corner_and_a_puncture_a_jump() {
        let visits = [
            visit(0.0, TipPlace::Outside, 0.0, 0.0, 0),
            visit(1e-3, TipPlace::Outside, 0.0, 0.0, 0),
            visit(2e-3, TipPlace::Holding, -0.05, 0.05, 0),
            visit(3e-3, TipPlace::Holding, -0.15, 0.15, 0),
            visit(5e-3, TipPlace::Inside, -0.12, 0.0, 1),
            visit(6e-3, TipPlace::Inside, -0.14, 0.0, 1),
        ];
        let mut points = Vec::new();
        points_of(&visits, 1e-3, &mut points);
        let expected = [
            [1e-3, 0.0],
            [1.5e-3, 0.0],
            [2e-3, -0.05],
            [3e-3, -0.15],
            [4e-3, -0.25],
            [4e-3, -0.10],
            // It sticks at first, at 100 N/m.
            [4.4e-3, -0.14],
            [5e-3, -0.14],
        ];
        assert_eq!(points.len(), expected.len(), "{points:?}");
        for (point, expected) in points.iter().zip(&expected) {
            assert!((point[0] - expected[0]).abs() < 1e-12, "{points:?}");
            assert!((point[1] - expected[1]).abs() < 1e-12, "{points:?}");
        }
        // What is straight goes first, the jump and both ends never.
        points.insert(0, [0.0, 0.0]);
        thin(&mut points, 6);
        let ways = points.iter().map(|point| point[0]);
        let kept = [0.0, 1.5e-3, 4e-3, 4e-3, 5e-3];
        for way in kept {
            assert!(
                ways.clone().any(|kept| (kept - way).abs() < 1e-12),
                "{points:?}"
            );
        }
        assert_eq!(points.len(), 6);
    }

    /// Along a circle the middle stays where it is.
    #[test]
    fn a_round_needle_is_slid_about_its_middle() {
        let sample = ToolSample {
            id: 0,
            position_m: [0.01, 0.0, 0.0],
            orientation: [0.0, 0.0, 0.0, 1.0],
            velocity_m_per_s: [0.0; 3],
            console_time_us: 0,
        };
        // About z through the origin, radius 10 mm.
        let slide = [0.0, 1.0, 0.0, 0.0, 0.0, 100.0];
        let quarter = slid(&sample, &slide, 0.01 * std::f64::consts::FRAC_PI_2);
        let [x, y, z] = quarter.position_m;
        assert!(x.abs() < 1e-15 && (y - 0.01).abs() < 1e-15 && z == 0.0);
        let half = std::f64::consts::FRAC_1_SQRT_2;
        assert!((quarter.orientation[2] - half).abs() < 1e-15);
    }
}
