//! Rows of what is touched, and what a solve says of them.

use super::{Contact, ToolContacts, TouchingTools};
use crate::anchors::{AnchorPoint, ConstraintSet, PointConstraint};
use crate::collide::across;
use crate::contact::shape::Solid;
use crate::rows::{Mode, RowKind};
use crate::tool::Placement;
use nalgebra::Vector3;

/// Bit of a row's id that no other rows have.
const ID: u64 = 1 << 56;
/// Balance: largest gap over radius, and largest change of a normal since it was linearised \[rad\].
const TOLERANCE: f64 = 1e-11;
/// What slips under friction turns by more than its normal's own force, which no solve foresees: after so many this is good
/// enough.
const ENOUGH: (u32, f64) = (16, 1e-8);
/// Every so many solves the next linearisation is where the last ones lead to.
const EXTRAPOLATED: u32 = 5;
/// Longest way of a vertex from one linearisation to the next, in radii of the tool.
const LONGEST: f64 = 0.5;
/// A vertex counts as inside a tool when it is deeper than this part of its radius.
const DEPTH: f64 = 1e-9;

/// What [`ToolContacts::settle`] found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Settled {
    /// Whether the solve was a balance.
    pub is: bool,
    /// Largest gap over radius and change of a normal, of what presses.
    pub residual: f64,
    /// Whether there was room for all that is touched.
    pub has_room: bool,
}

impl Placement {
    /// A place in the frame of the shape \[m\] as it is in the world.
    pub(super) fn world(&self, local: &Vector3<f64>) -> Vector3<f64> {
        self.centre + self.rotation * local
    }

    pub(super) fn local(&self, world: &Vector3<f64>) -> Vector3<f64> {
        self.rotation.inverse() * (world - self.centre)
    }
}

impl ToolContacts {
    /// Appends a row for each contact, or three where the tool rubs; `points_m` (n x 3) are the unloaded nodes.
    pub fn append(
        &mut self,
        tools: &TouchingTools,
        points_m: &[[f64; 3]],
        set: &mut ConstraintSet,
    ) {
        for contact in &mut self.contacts {
            contact.row = set.rows.len() as u32;
            let tool = &tools.each[contact.tool as usize].tool;
            let Some(placement) = &self.placements[contact.tool as usize] else {
                continue;
            };
            let node = contact.node;
            let anchor = set.add(AnchorPoint {
                nodes: [node; 4],
                weights: [1.0, 0.0, 0.0, 0.0],
            });
            let friction = if contact.sticks {
                tool.static_friction.max(tool.friction)
            } else {
                tool.friction
            };
            let rest = Vector3::from(points_m[node as usize]);
            let way = contact.at_m - rest;
            let sticks_at = placement.world(&contact.local_m) - rest;
            let frame = contact.frame();
            let targets = [
                frame[0].dot(&way) + contact.gap_m,
                frame[1].dot(&sticks_at),
                frame[2].dot(&sticks_at),
            ];
            let id = ID | u64::from(contact.tool) << 40 | u64::from(node) << 2;
            let rows = frame.into_iter().zip(targets);
            let count = if contact.smooth { 1 } else { 3 };
            for (axis, (direction, target_m)) in (0u64..).zip(rows.take(count)) {
                if contact.is_wall {
                    let row = set.rows.len() as u32;
                    set.soft.push((row, contact.gives_m_per_n()));
                }
                set.rows.push(PointConstraint {
                    id: id | axis,
                    anchor,
                    kind: match axis {
                        0 if contact.smooth => RowKind::Inequality,
                        0 => RowKind::Normal { friction },
                        _ => RowKind::Tangent,
                    },
                    direction: direction.into(),
                    target_m,
                });
            }
        }
    }

    /// After a solve with the multipliers `lambda` and `modes` of all rows: linearises anew where it has the vertices,
    /// `at` a node \[m\], and takes up those of `near` that are inside a tool now; it was the balance's
    /// `solves`th.
    pub fn settle(
        &mut self,
        tools: &TouchingTools,
        (lambda, modes): (&[f64], &[Mode]),
        (near, solves): (&[(u32, u32)], u32),
        at: impl Fn(u32) -> Vector3<f64>,
    ) -> Settled {
        let mut settled = Settled {
            is: true,
            residual: 0.0,
            has_room: true,
        };
        let farther = self.farther(tools, solves, &at);
        let Self {
            placements,
            contacts,
            ..
        } = self;
        for contact in contacts {
            let row = contact.row as usize;
            let rows = row..row + if contact.smooth { 1 } else { 3 };
            let (Some(lambda), Some(modes)) = (lambda.get(rows.clone()), modes.get(rows)) else {
                continue;
            };
            let Some(placement) = &placements[contact.tool as usize] else {
                continue;
            };
            let solid = tools.solid(contact.tool as usize, placement);
            contact.lambda_n = [0.0; 3];
            contact.lambda_n[..lambda.len()].copy_from_slice(lambda);
            contact.slips = modes.get(1) == Some(&Mode::Slipping);
            contact.go_on(&solid, at(contact.node), farther, &mut settled);
            let tool = &tools.each[contact.tool as usize].tool;
            if contact.sticks && contact.slips && tool.static_friction > tool.friction {
                contact.sticks = false;
                settled.is = false;
            }
        }
        let (many, enough) = ENOUGH;
        let is_enough = solves > many && !tools.are_smooth();
        let tolerance = if is_enough { enough } else { TOLERANCE };
        settled.is &= settled.residual <= tolerance;
        self.take_up(tools, near, at, &mut settled);
        settled
    }

    /// How much farther than a solve the next linearisation is: what slips under friction turns by more than a solve
    /// foresees, and the ways from one linearisation to the next shrink by the same factor, whose series ends there
    /// (Aitken 1926).
    fn farther(
        &mut self,
        tools: &TouchingTools,
        solves: u32,
        at: impl Fn(u32) -> Vector3<f64>,
    ) -> f64 {
        if tools.are_smooth() {
            return 1.0;
        }
        let (mut along, mut square) = (0.0, 0.0);
        for contact in &mut self.contacts {
            let way = at(contact.node) - contact.at_m;
            along += way.dot(&contact.way_m);
            square += contact.way_m.norm_squared();
            contact.way_m = way;
        }
        let factor = along / square;
        if solves.is_multiple_of(EXTRAPOLATED) && (0.2..0.98).contains(&factor) {
            1.0 / (1.0 - factor)
        } else {
            1.0
        }
    }

    /// Takes up the vertices of `near` that are inside a tool.
    fn take_up(
        &mut self,
        tools: &TouchingTools,
        near: &[(u32, u32)],
        at: impl Fn(u32) -> Vector3<f64>,
        settled: &mut Settled,
    ) {
        for own in near.chunk_by(|a, b| a.0 == b.0) {
            let tool = own[0].0;
            let Some(placement) = self.placements[tool as usize] else {
                continue;
            };
            let solid = tools.solid(tool as usize, &placement);
            for &(_, node) in own {
                let is = |contact: &Contact| (contact.tool, contact.node) == (tool, node);
                let place = at(node);
                if solid.is_beyond(&place, 0.0)
                    || solid.gap(&place) >= -DEPTH * solid.radius()
                    || self.contacts.iter().any(is)
                {
                    continue;
                }
                settled.is = false;
                settled.has_room &= self.contacts.len() < tools.most_contacts();
                if !settled.has_room {
                    return;
                }
                let mut contact = self.touch(tools, (tool, node), &placement, &solid, place);
                contact.look(&solid, place);
                self.contacts.push(contact);
            }
        }
    }

    /// A vertex that has come to be inside a tool: it touched on the way from where both were at the last balance, and
    /// sticks there.
    fn touch(
        &self,
        tools: &TouchingTools,
        (tool, node): (u32, u32),
        placement: &Placement,
        solid: &Solid,
        at_m: Vector3<f64>,
    ) -> Contact {
        let now = placement.local(&at_m);
        let known = self.near.binary_search_by_key(&node, |(node, _)| *node);
        let was = known.ok().and_then(|found| {
            let before = self.before[tool as usize].as_ref()?;
            Some(before.local(&self.near[found].1))
        });
        let entry = was.and_then(|was| first_inside(placement, solid, was, now));
        // Off the surface it would be held beside where it can be.
        let nearest = || {
            let touch = solid.touch(&at_m);
            touch.map_or(now, |touch| {
                placement.local(&(at_m - touch.normal * touch.gap))
            })
        };
        let local_m = entry.unwrap_or_else(nearest);
        Contact {
            local_m,
            ..Contact::new(tools, (tool, node), at_m)
        }
    }
}

/// Where on the straight way of a vertex from `was` to `now`, both in the tool's frame \[m\], it is first inside; nowhere if
/// it has been inside before.
fn first_inside(
    placement: &Placement,
    solid: &Solid,
    was: Vector3<f64>,
    now: Vector3<f64>,
) -> Option<Vector3<f64>> {
    let inside = |part: f64| solid.gap(&placement.world(&was.lerp(&now, part))) < 0.0;
    if inside(0.0) {
        return None;
    }
    // Shapes are convex: outside, then inside.
    let (mut out, mut r#in) = (0.0, 1.0);
    for _ in 0..52 {
        let middle = 0.5 * (out + r#in);
        if inside(middle) {
            r#in = middle;
        } else {
            out = middle;
        }
    }
    Some(was.lerp(&now, out))
}

impl Contact {
    /// At a vertex, without force.
    fn new(tools: &TouchingTools, (tool, node): (u32, u32), at_m: Vector3<f64>) -> Self {
        Self {
            tool,
            node,
            local_m: Vector3::zeros(),
            sticks: true,
            at_m,
            gap_m: 0.0,
            normal: Vector3::zeros(),
            tangent: Vector3::x(),
            lambda_n: [0.0; 3],
            slips: false,
            way_m: Vector3::zeros(),
            ahead_m: Vector3::zeros(),
            before_n: Vector3::zeros(),
            row: 0,
            smooth: tools.each[tool as usize].tool.is_smooth(),
            is_wall: tools.is_wall(node),
        }
    }

    /// At a vertex that a tool may come to touch, with the tool's shape as it is now.
    pub fn coming(
        tools: &TouchingTools,
        of: (u32, u32),
        solid: &Solid,
        at_m: Vector3<f64>,
    ) -> Option<Self> {
        let mut contact = Self::new(tools, of, at_m);
        contact.look(solid, at_m).then_some(contact)
    }

    /// Linearises where a solve has the vertex, or so much `farther`.
    fn go_on(&mut self, solid: &Solid, at_m: Vector3<f64>, farther: f64, settled: &mut Settled) {
        let before = self.normal;
        // What would be thrown across its tool is no guide: not so far at once.
        let way = at_m - self.at_m;
        let part = farther.min(LONGEST * solid.radius() / way.norm());
        let there = if part == 1.0 {
            at_m
        } else {
            self.at_m + way * part
        };
        if !self.look(solid, there) {
            settled.residual = f64::INFINITY;
            return;
        }
        let gap = if self.is_wall {
            (self.gap_m + self.gives_m_per_n() * self.lambda_n[0]) / solid.radius()
        } else {
            self.gap_m / solid.radius()
        };
        let off = if self.lambda_n[0] > 0.0 {
            gap.abs().max((self.normal - before).norm())
        } else {
            (-gap).max(0.0)
        };
        settled.residual = settled.residual.max(off);
        settled.is &= part == 1.0;
    }

    /// Distance and normal where the vertex is; whether there is a normal.
    pub(super) fn look(&mut self, solid: &Solid, at_m: Vector3<f64>) -> bool {
        self.at_m = at_m;
        let Some(touch) = solid.touch(&at_m) else {
            return false;
        };
        self.gap_m = touch.gap;
        self.normal = touch.normal;
        self.tangent = across(&touch.normal, &self.tangent);
        true
    }
}
