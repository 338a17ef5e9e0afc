//! Which vertices a tool may come to touch, and how far it may go at once.

use super::{Placements, ToolContacts, TouchingTools};
use crate::contact::entry::{Nearest, way_in};
use crate::contact::shape::Solid;
use crate::tool::Placement;
use nalgebra::Vector3;

/// Vertices within so many radii of a tool may come to be touched in a piece of its way, or follow each other there.
pub(crate) const NEAR: f64 = 0.5;

impl TouchingTools {
    /// Lists the vertices that may be near a tool, or `more_m` farther, with its place among those that touch: where they
    /// rest, give or take the `slack_m` of their groups \[m\].
    pub fn near(
        &self,
        placements: &Placements,
        slack_m: &[f64],
        more_m: f64,
        out: &mut Vec<(u32, u32)>,
    ) {
        out.clear();
        for (tool, placement) in (0u32..).zip(placements.iter().take(self.each.len())) {
            let Some(placement) = placement else {
                continue;
            };
            let solid = self.solid(tool as usize, placement);
            let reach_m = NEAR * solid.radius() + more_m;
            // As far from the centre it is out of reach of any shape, give or take a rounding.
            let bound_m = (solid.bound() + reach_m) * (1.0 + 1e-9);
            for (place, (node, rest)) in self.nodes.iter().zip(&self.resting_m).enumerate() {
                let slack = slack_m.get(self.group[place] as usize);
                let far_m = bound_m + slack.copied().unwrap_or(f64::MAX);
                if (rest - solid.centre).norm_squared() > far_m * far_m {
                    continue;
                }
                if self.least_gap_m(&solid, place, slack_m) < reach_m {
                    out.push((tool, *node));
                }
            }
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
        let gaps = (0..self.nodes.len()).map(|place| self.least_gap_m(solid, place, slack_m));
        gaps.fold(f64::MAX, f64::min)
    }

    fn least_gap_m(&self, solid: &Solid, place: usize, slack_m: &[f64]) -> f64 {
        let slack_m = slack_m.get(self.group[place] as usize).copied();
        solid.gap(&self.resting_m[place]) - slack_m.unwrap_or(f64::MAX)
    }

    /// The vertex that rests nearest to a tool.
    pub fn nearest_at_rest(&self, solid: &Solid) -> Option<Nearest> {
        let gaps = self.resting_m.iter().map(|at| solid.gap(at)).enumerate();
        let (place, gap_m) = gaps.min_by(|a, b| a.1.total_cmp(&b.1))?;
        Some(Nearest {
            at: self.resting_m[place],
            normal: self.normals[place],
            gap_m,
        })
    }
}

impl ToolContacts {
    /// Tools touch nothing any more.
    pub fn let_go(&mut self) {
        self.contacts.clear();
    }

    /// Forgets tools that touch nothing though they are inside: they have slipped in between vertices, and start afresh
    /// outside. Whether there were any.
    pub fn forget_inside(
        &mut self,
        tools: &TouchingTools,
        contains: impl Fn(&Vector3<f64>) -> bool,
    ) -> bool {
        for tool in 0..tools.each.len() {
            let Some(placement) = &self.placements[tool] else {
                continue;
            };
            if self.count(tool as u32) > 0 {
                continue;
            }
            let solid = tools.solid(tool, placement);
            let middle = solid.middle();
            // The surface is closed: behind the nearest vertex's tangent plane is the cheap suspicion, the solid angle
            // the proof.
            let suspect = tools
                .nearest_at_rest(&solid)
                .is_some_and(|near| (middle - near.at).dot(&near.normal) < 0.0);
            if suspect && contains(&middle) {
                self.placements[tool] = None;
                return true;
            }
        }
        false
    }

    /// Brings tools that were nowhere before to where their ways to `targets` begin: outside tissue at rest. Whether there
    /// is such a place for all of them.
    pub fn bring_in(
        &mut self,
        tools: &TouchingTools,
        targets: &Placements,
        contains: impl Fn(&Vector3<f64>) -> bool,
    ) -> bool {
        for (tool, target) in targets.iter().enumerate().take(tools.each.len()) {
            let (Some(target), None) = (target, self.placements[tool]) else {
                continue;
            };
            let solid = tools.solid(tool, target);
            let Some(out) = way_in(&solid, |solid| tools.nearest_at_rest(solid), &contains) else {
                return false;
            };
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
