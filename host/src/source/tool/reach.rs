//! Which vertices a tool may come to touch, and how far it may go at once.

use super::{Placements, ToolContacts, TouchingTools};
use crate::boxes::Bounds;
use crate::contact::entry::{Nearest, way_in};
use crate::contact::shape::Solid;
use crate::marks::Marks;
use crate::model::Model;
use crate::tool::Placement;
use nalgebra::Vector3;

/// Distances from boxes are less exact than those from points, by this part.
const ROUNDING: f64 = 1e-9;
/// Vertices within so many radii of a tool may come to be touched in a piece of its way, or follow each other there.
pub(crate) const NEAR: f64 = 0.5;

impl TouchingTools {
    /// Lists the vertices that may be near a tool, or `more_m` farther, with its place among those that touch: where they
    /// rest, give or take the `slack_m` of their groups \[m\]. `marks` is scratch.
    pub fn near(
        &self,
        placements: &Placements,
        slack_m: &[f64],
        more_m: f64,
        marks: &mut Marks,
        out: &mut Vec<(u32, u32)>,
    ) {
        out.clear();
        let most_m = self.most_slack_m(slack_m);
        for (tool, placement) in (0u32..).zip(placements.iter().take(self.each.len())) {
            let Some(placement) = placement else {
                continue;
            };
            let solid = self.solid(tool as usize, placement);
            let reach_m = NEAR * solid.radius() + more_m;
            // As far from the centre it is out of reach of any shape, give or take a rounding.
            let bound_m = (solid.bound() + reach_m) * (1.0 + 1e-9);
            let is_far = |square: f64, slack_m: f64| square > (bound_m + slack_m).powi(2);
            self.runs.where_near(
                |_, bounds| !is_far(bounds.distance_squared(&solid.centre), most_m),
                |run| {
                    marks.set(run);
                },
            );
            marks.take(|run| {
                for place in self.run(run as usize) {
                    let square = (self.resting_m[place] - solid.centre).norm_squared();
                    let own_m = self.slack_of(place, slack_m);
                    if !is_far(square, own_m)
                        && !solid.is_beyond(&self.resting_m[place], reach_m + own_m)
                        && self.least_gap_m(&solid, place, slack_m) < reach_m
                    {
                        out.push((tool, self.nodes[place]));
                    }
                }
            });
        }
    }

    /// Whether every tool, at its target, is clear of the tissue at rest.
    pub fn are_free(&self, targets: &Placements, contains: impl Fn(&Vector3<f64>) -> bool) -> bool {
        !self.is_empty()
            && targets.iter().enumerate().all(|(tool, target)| {
                target.is_none_or(|target| {
                    let solid = self.solid(tool, &target);
                    let near = self.nearest_at_rest(&solid);
                    near.is_none_or(|near| near.gap_m > 0.0) && !contains(&solid.middle())
                })
            })
    }

    /// No vertex is nearer to a tool than this \[m\].
    pub fn clearance_m(&self, solid: &Solid, slack_m: &[f64]) -> f64 {
        let most_m = self.most_slack_m(slack_m);
        let least_m = |run: u32| {
            let gaps = self.run(run as usize);
            let gaps = gaps.map(|place| self.least_gap_m(solid, place, slack_m));
            gaps.fold(f64::MAX, f64::min)
        };
        let clearance_m = self
            .runs
            .least(|bounds| least_gap_m(solid, bounds) - most_m, least_m);
        clearance_m.min(f64::MAX)
    }

    fn least_gap_m(&self, solid: &Solid, place: usize, slack_m: &[f64]) -> f64 {
        solid.gap(&self.resting_m[place]) - self.slack_of(place, slack_m)
    }

    /// As far as a vertex may be from where it rests \[m\].
    fn slack_of(&self, place: usize, slack_m: &[f64]) -> f64 {
        if place >= self.free {
            return 0.0;
        }
        let slack_m = slack_m.get(self.group[place] as usize);
        slack_m.copied().unwrap_or(f64::MAX)
    }

    /// As far as any may be.
    fn most_slack_m(&self, slack_m: &[f64]) -> f64 {
        if slack_m.len() < self.groups {
            return f64::MAX;
        }
        slack_m.iter().copied().fold(0.0, f64::max)
    }

    /// The vertex that rests nearest to a tool; of several the first.
    pub fn nearest_at_rest(&self, solid: &Solid) -> Option<Nearest> {
        let mut nearest: Option<(usize, f64)> = None;
        self.runs.least(
            |bounds| least_gap_m(solid, bounds),
            |run| {
                let own = self.run(run as usize);
                let own = own.map(|place| (place, solid.gap(&self.resting_m[place])));
                nearest = nearest
                    .into_iter()
                    .chain(own)
                    .min_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
                nearest.map_or(f64::INFINITY, |(_, gap_m)| gap_m)
            },
        );
        let (place, gap_m) = nearest?;
        Some(Nearest {
            at: self.resting_m[place],
            normal: self.normals[place],
            gap_m,
        })
    }
}

/// No point of a box is nearer to a tool than this \[m\]: from one point to another the distance changes by no more than
/// the way between them.
fn least_gap_m(solid: &Solid, bounds: &Bounds) -> f64 {
    let gap_m = solid.gap(&bounds.middle());
    let half_m = 0.5 * (bounds.high - bounds.low).norm();
    gap_m - half_m - ROUNDING * (gap_m.abs() + half_m)
}

impl ToolContacts {
    /// Tools touch nothing any more.
    pub fn let_go(&mut self) {
        self.contacts.clear();
    }

    /// Brings tools that were nowhere before to where their ways to `targets` begin: outside tissue at rest. Whether there
    /// is such a place for all of them. A tool that tissue has slipped around has none before it [has left](Self::has_left).
    pub fn bring_in(&mut self, model: &Model, tools: &TouchingTools, targets: &Placements) -> bool {
        let contains = |at: &Vector3<f64>| model.contains(at);
        for (tool, target) in targets.iter().enumerate().take(tools.each.len()) {
            let (Some(target), None) = (target, self.placements[tool]) else {
                continue;
            };
            let solid = tools.solid(tool, target);
            if !self.has_left(model, tools, tool, &solid) {
                return false;
            }
            let Some(out) = way_in(&solid, |solid| tools.nearest_at_rest(solid), contains) else {
                return false;
            };
            // From where a tool came that begins in the tissue nobody knows.
            let is_outside = !solid.cores().iter().any(contains);
            self.clear[tool] = is_outside.then(|| solid.middle() + out);
            self.hardest[tool] = None;
            self.placements[tool] = Some(Placement {
                centre: target.centre + out,
                ..*target
            });
        }
        true
    }

    /// Where the tools are after a part of their ways to `targets`.
    pub fn towards(&self, targets: &Placements, part: f64) -> Placements {
        let mut placements = *targets;
        for (placement, from) in placements.iter_mut().zip(&self.placements) {
            if let (Some(placement), Some(from)) = (placement.as_mut(), from) {
                *placement = from.towards(placement, part);
            }
        }
        placements
    }

    /// Which part of the way to `targets` the tools may go at once, so that no vertex ends up on the wrong side of one.
    pub fn part(&self, tools: &TouchingTools, targets: &Placements) -> f64 {
        let mut part = 1.0f64;
        let ways = self.placements.iter().zip(targets).enumerate();
        for (tool, (from, target)) in ways.take(tools.each.len()) {
            let (Some(from), Some(target)) = (from, target) else {
                continue;
            };
            let solid = tools.solid(tool, from);
            let way_m =
                (target.centre - from.centre).norm() + solid.reach() * from.angle_to(target);
            let mut reach_m = solid.piece();
            if way_m > reach_m {
                reach_m += tools.clearance_m(&solid, &self.slack_m).max(0.0);
            }
            if way_m > reach_m {
                part = part.min(reach_m / way_m);
            }
        }
        part
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tool::{MAX_TOOLS, Shape, Tool};
    use nalgebra::UnitQuaternion;

    const GROUPS: u32 = 5;

    fn vector(rng: &mut fastrand::Rng, size: f64) -> Vector3<f64> {
        Vector3::from_fn(|_, _| size * (2.0 * rng.f64() - 1.0))
    }

    /// Two tools over vertices that are numbered without order, and some of them twice in a place.
    fn tools(rng: &mut fastrand::Rng, count: usize) -> TouchingTools {
        let mut at: Vec<_> = (0..count).map(|_| vector(rng, 1.0)).collect();
        for place in (7..count).step_by(7) {
            at[place] = at[place - 5];
        }
        let normals: Vec<_> = at.iter().map(|at| at.normalize()).collect();
        let nodes: Vec<u32> = (0..count as u32).map(|place| 3 * place).collect();
        let group: Vec<u32> = nodes.iter().map(|_| rng.u32(0..GROUPS)).collect();
        let shapes = [
            Shape::Sphere { radius_m: 0.3 },
            Shape::rounded_box([0.3, 0.5, 0.9]),
        ];
        let tools = shapes.map(|shape| (0, Tool::new(shape, [0.0; 3])));
        // Every third run is of prescribed nodes.
        let free = count - count / 3;
        let nodes = nodes.split_at(free);
        TouchingTools::new(
            &tools,
            0.01,
            nodes,
            (&at, &normals),
            group,
            std::iter::empty(),
        )
    }

    fn somewhere(rng: &mut fastrand::Rng) -> Placement {
        Placement {
            centre: vector(rng, 1.5),
            rotation: UnitQuaternion::from_scaled_axis(vector(rng, 2.0)),
        }
    }

    /// What the boxes find is what a look at every vertex finds, to the bit and in the same order.
    #[test]
    fn nothing_near_a_tool_is_missed() {
        let rng = &mut fastrand::Rng::with_seed(11);
        let (mut found, mut marks_left) = (0, 0);
        for count in [0, 1, 15, 16, 17, 500] {
            let tools = tools(rng, count);
            let mut marks = Marks::new(count.div_ceil(16));
            for round in 0..60 {
                let mut placements = [None; MAX_TOOLS];
                placements[0] = (round % 5 != 0).then(|| somewhere(rng));
                placements[1] = (round % 7 != 0).then(|| somewhere(rng));
                // Sometimes less is known than there are groups.
                let known = if round % 10 == 9 { 2 } else { GROUPS };
                let slack_m: Vec<f64> = (0..known).map(|_| 0.2 * rng.f64()).collect();
                let more_m = 0.2 * rng.f64();
                let gap = |solid: &Solid, place: usize| {
                    let slack_m = slack_m.get(tools.group[place] as usize);
                    let slack_m = slack_m.copied().unwrap_or(f64::MAX);
                    let slack_m = if place < tools.free { slack_m } else { 0.0 };
                    solid.gap(&tools.resting_m[place]) - slack_m
                };
                let mut expected = Vec::new();
                for (tool, placement) in placements.iter().enumerate().take(2) {
                    let Some(placement) = placement else {
                        continue;
                    };
                    let solid = tools.solid(tool, placement);
                    let reach_m = NEAR * solid.radius() + more_m;
                    let near = (0..count).filter(|place| gap(&solid, *place) < reach_m);
                    expected.extend(near.map(|place| (tool as u32, tools.nodes[place])));
                    let clearance_m = (0..count).map(|place| gap(&solid, place));
                    let clearance_m = clearance_m.fold(f64::MAX, f64::min);
                    assert_eq!(tools.clearance_m(&solid, &slack_m), clearance_m);
                    let gaps = tools.resting_m.iter().map(|at| solid.gap(at));
                    let nearest = gaps.enumerate().min_by(|a, b| a.1.total_cmp(&b.1));
                    let nearest = nearest.map(|(place, gap_m)| (gap_m, tools.normals[place]));
                    let seen = tools.nearest_at_rest(&solid);
                    assert_eq!(seen.map(|near| (near.gap_m, near.normal)), nearest);
                }
                let mut near = Vec::new();
                tools.near(&placements, &slack_m, more_m, &mut marks, &mut near);
                assert_eq!(near, expected);
                found += near.len();
                marks_left += marks.each().count();
            }
        }
        assert!(found > 1000 && marks_left == 0, "{found}");
    }
}
