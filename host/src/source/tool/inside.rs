//! Whether a tool that touches has slipped into the tissue.
//!
//! Entry points: [`Balance::slipped_in`] after a balance, [`ToolContacts::lead_out`] before a way is not followed. Contact is
//! at vertices, and deeper than a tool's radius nothing but the mesh and friction keeps a surface from sliding around the tool
//! and closing over it. How far it has is told by the contact's outwardness: each normal force on the tool, projected on the
//! tissue's outward normal at its vertex at rest, summed over the contact, over the sum of the forces. It is 1 where every
//! vertex presses straight out, 1/2 where a flat surface presses evenly on half of a ball, and below 0 where tissue pulls the
//! tool in. Vertex by vertex it is the same for one piece of tissue and for several, and no way of the tool is in it.

use super::{Contact, Placements, ToolContacts, TouchingTools};
use crate::contact::shape::Solid;
use crate::model::Model;
use crate::step::Balance;
use crate::thread::Obstacle;
use crate::tool::{Placement, Shape};
use nalgebra::{Matrix3, Vector3};

/// Least outwardness of a contact of a round tool from outside: where much of it lies along the sides of a thin tool it is twice
/// that.
const LEAST_OUTWARD: f64 = 0.15;
/// The same of a tool with a flat face, whose sides are pinched by what its face has pressed down.
const LEAST_OF_A_FACE: f64 = 0.0;
/// Least outwardness of a contact on one side of the tool, which may lie on the flank of an edge or a tip.
const LEAST_ON_A_SIDE: f64 = -0.5;
/// Outwardness below which tissue that has closed over a tool pulls it in, from whichever side.
const PULLS_IN: f64 = 0.0;
/// Magnitude of the summed force over the sum of the magnitudes, from which on a contact is on one side of the tool.
const ONE_SIDE: f64 = 0.8;
/// Contacts that are less outward wrap around the tool: below that a force that falls on the way in is no bend of the tissue.
const WRAPS: f64 = 0.75;
/// Fall of the force on the way in of a round tool, as a share and \[N\], from which on it is told.
const FALL: (f64, f64) = (0.015, 0.02);
/// The same of other tools: vertices that leave a face over its rim take a little with them.
const FALL_OF_A_FACE: (f64, f64) = (0.1, 0.1);
/// The same on a way aside: tissue along which a tool is drawn lifts off behind it.
const FALL_ASIDE: (f64, f64) = (0.25, 0.1);
/// Share of the normal force that one patch of the surface has at least where it alone presses on a tool.
const ALONE: f64 = 0.8;
/// Cosine of the angle between a way straight in and the inward normal of the tissue, from which on it is one.
const STRAIGHT_IN: f64 = 0.85;
/// Largest way aside on a way in, as a part of the depth gained: 55 degrees. Beyond 45 degrees a fall counts from [`FALL_OF_A_FACE`] on.
const SLANT: f64 = 1.5;
/// Way aside beyond that, in radii of the tool, up to which a hand trembles: a force before it is compared with one after it.
const ASIDE: f64 = 0.75;
/// Way aside beyond that, in radii of the tool, from which on a tool is no longer on its way straight in.
const STRAYS: f64 = 0.02;
/// Least way of a tool, in radii of it, that has made a fall of a tenth while another tool presses as well: that may have made it.
const BESIDE: f64 = 0.1;
/// Distance around the contact within which the tissue's mean rotation is taken, in radii of the tool.
const AROUND: f64 = 4.0;
/// Most looks at a tool's way: 16 of its radii where it stays as near as that.
const MOST_LOOKS: u32 = 64;

/// Contact of one tool, summed over its vertices.
#[derive(Clone, Copy, Debug)]
struct Pressing {
    /// Normal force on the tool \[N\], (3), and the sum of its parts' magnitudes.
    force: Vector3<f64>,
    total: f64,
    /// Sum of its parts along the outward normals at their vertices \[N\].
    outward: f64,
    /// Sum of those normals, each times its part \[N\], (3).
    out: Vector3<f64>,
    /// Force on the tool with friction \[N\], (3).
    whole: Vector3<f64>,
}

impl Pressing {
    fn outwardness(&self) -> f64 {
        self.outward / self.total
    }

    /// Least outwardness of such a contact from outside, of a tool that `is_round` or not, on whose way in the force `falls` or
    /// not.
    fn least(&self, is_round: bool, falls: bool) -> f64 {
        if self.force.norm() > ONE_SIDE * self.total {
            return LEAST_ON_A_SIDE;
        }
        match (is_round, falls) {
            (_, true) => WRAPS,
            (true, false) => LEAST_OUTWARD,
            (false, false) => LEAST_OF_A_FACE,
        }
    }
}

/// A tool or a body that has slipped into the tissue.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Slipped {
    /// By its place among the tools that touch.
    Tool(u32),
    Body(Obstacle),
}

/// Place of a tool that tissue has slipped around.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Sunk {
    /// Before the step in which that happened, or where a core of it was in the tissue last \[m\], (3).
    last: Vector3<f64>,
    /// Whether a core of it has been in the tissue since.
    is_deep: bool,
}

/// Force on a tool.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Force {
    /// Without friction \[N\], (3).
    normal: Vector3<f64>,
    /// Magnitude with friction \[N\].
    whole_n: f64,
}

/// Largest force on a tool on its way in, and its place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Hardest {
    at: Placement,
    /// Place in the tool's middle that was next to what it touched then \[m\], (3): its way is the tool's, however that turns.
    core: Vector3<f64>,
    force: Force,
    /// The way out, unit vector, (3).
    out: Vector3<f64>,
    /// Tool position at the last equilibrium, and its force there.
    last: Placement,
    last_force: Force,
    /// Whether the tool has gone aside since: it was somewhere else meanwhile, and may have turned back.
    has_strayed: bool,
}

impl Hardest {
    /// `out` leads out of the tissue, and is of any length: a tool that is drawn along is pushed another way. `whole_n` is the force's
    /// magnitude with friction \[N\]. None where nothing pushes.
    pub fn new(
        at: &Placement,
        core: &Vector3<f64>,
        normal: &Vector3<f64>,
        out: &Vector3<f64>,
        whole_n: f64,
    ) -> Option<Self> {
        let along = normal.try_normalize(0.0)?;
        let force = Force {
            normal: *normal,
            whole_n,
        };
        Some(Self {
            at: *at,
            core: *core,
            force,
            out: out.try_normalize(0.0).unwrap_or(along),
            last: *at,
            last_force: force,
            has_strayed: false,
        })
    }

    /// Goes on to the next balance. What the force loses while the tool rests is not lost on its way: tissue that is not linear
    /// comes to balance, or another tool goes.
    pub fn go_on(&mut self, now: &Self) {
        if now.at == self.last {
            let lost_n = (self.last_force.normal - now.force.normal).dot(&self.out);
            self.force.normal -= self.out * lost_n.max(0.0);
            let lost_n = self.last_force.whole_n - now.force.whole_n;
            self.force.whole_n -= lost_n.max(0.0);
        }
        (self.last, self.last_force) = (now.at, now.force);
    }

    fn way(&self) -> Vector3<f64> {
        let arm = self.at.rotation.inverse() * (self.core - self.at.centre);
        self.last.centre + self.last.rotation * arm - self.core
    }

    /// Normal forces against the way in, the largest and the last \[N\].
    fn against(&self) -> [f64; 2] {
        let against = -self.way().try_normalize(0.0).unwrap_or(-self.out);
        [self.force, self.last_force].map(|force| force.normal.dot(&against))
    }

    /// Magnitudes with friction, the largest and the last \[N\].
    fn whole(&self) -> [f64; 2] {
        [self.force.whole_n, self.last_force.whole_n]
    }

    /// Angle from there to a place \[rad\].
    pub fn angle_to(&self, at: &Placement) -> f64 {
        self.at.angle_to(at)
    }

    /// Whether the force pushes a tool onward that has gone straight on in.
    pub fn is_pushed_on(&self, turn_m: f64) -> bool {
        let [_, last_n] = self.against();
        last_n < 0.0 && self.falls_ahead(turn_m, FALL) == Some(true)
    }

    /// Whichever of this and the force `now` is the largest on the way in of a tool of this radius: `now` where it is larger, or the tool
    /// has gone back, or farther aside than a hand trembles.
    pub fn or(self, now: Self, radius_m: f64) -> Self {
        let has_strayed = self.has_strayed || !self.is_on_way(SLANT, STRAYS * radius_m);
        // Tissue along which a tool is drawn pushes less from below, and more from before.
        let [most_n, last_n] = match has_strayed {
            true => self.whole(),
            false => self.against(),
        };
        if last_n >= most_n || !self.is_on_way(SLANT, ASIDE * radius_m) {
            return now;
        }
        Self {
            has_strayed,
            ..self
        }
    }

    /// Whether the force has fallen since by this share and \[N\], and the tool gone straight on in, or by a tenth on a way that is slanted or
    /// turns, or by a quarter after it went aside, by up to `trembles_m`.
    fn has_fallen(&self, turn_m: f64, trembles_m: f64, fall: (f64, f64)) -> bool {
        let ahead = self.falls_ahead(turn_m, fall);
        ahead.filter(|_| !self.has_strayed).unwrap_or_else(|| {
            self.is_on_way(SLANT, trembles_m) && has_fallen_by(self.whole(), FALL_ASIDE)
        })
    }

    /// Whether the force has fallen by this share and \[N\] on a way straight in, or by a tenth on one that is slanted or turns. None where the
    /// tool is on neither.
    fn falls_ahead(&self, turn_m: f64, fall: (f64, f64)) -> Option<bool> {
        let against = self.against();
        if self.is_on_way(1.0, -turn_m) {
            return Some(has_fallen_by(against, fall));
        }
        let falls = || {
            has_fallen_by(against, FALL_OF_A_FACE) || has_fallen_by(self.whole(), FALL_OF_A_FACE)
        };
        self.is_on_way(SLANT, 0.0).then(falls)
    }

    /// Whether the tool is deeper now, and aside by less than a part `slant` of that and `more_m`.
    fn is_on_way(&self, slant: f64, more_m: f64) -> bool {
        let way = self.way();
        let deeper_m = -way.dot(&self.out);
        let aside_m = (way + self.out * deeper_m).norm();
        deeper_m > 0.0 && aside_m < slant * deeper_m + more_m
    }
}

/// Whether of the largest force and the last this share and \[N\] are lost.
fn has_fallen_by([most_n, last_n]: [f64; 2], (share, least_n): (f64, f64)) -> bool {
    last_n < most_n - f64::max(share * most_n, least_n)
}

impl ToolContacts {
    /// Contacts of a tool that press.
    fn pressing(&self, tool: u32) -> impl Iterator<Item = &Contact> + Clone {
        let own = self.contacts.iter();
        own.filter(move |contact| contact.tool == tool && contact.lambda_n[0] > 0.0)
    }

    /// Sums the contacts of a tool against outward normals that are turned by `turn`.
    fn pressed(&self, tools: &TouchingTools, tool: u32, turn: &Matrix3<f64>) -> Pressing {
        let nothing = Pressing {
            force: Vector3::zeros(),
            total: 0.0,
            outward: 0.0,
            out: Vector3::zeros(),
            whole: Vector3::zeros(),
        };
        self.pressing(tool).fold(nothing, |sum, contact| {
            let force = -contact.normal * contact.lambda_n[0];
            let out = tools.normal_of(contact.node);
            let out = out.map_or(Vector3::zeros(), |out| turn * out);
            Pressing {
                force: sum.force + force,
                total: sum.total + contact.lambda_n[0],
                outward: sum.outward + force.dot(&out),
                out: sum.out + out * contact.lambda_n[0],
                whole: sum.whole - contact.force_n(),
            }
        })
    }

    /// Whether the force on a tool, as it is now, has fallen on the way in by this share and \[N\]; keeps where it was pushed hardest.
    fn falls(
        &mut self,
        tools: &TouchingTools,
        tool: u32,
        pressed: &Pressing,
        fall: (f64, f64),
    ) -> bool {
        let place = tool as usize;
        let Some(at) = &self.placements[place] else {
            return false;
        };
        let solid = tools.solid(place, at);
        let total = pressed.total;
        let sum = self.pressing(tool).fold(Vector3::zeros(), |sum, contact| {
            sum + contact.at_m * contact.lambda_n[0]
        });
        let core = match total > 0.0 {
            true => solid.core_next_to(&(sum / total)),
            false => at.centre,
        };
        let now = Hardest::new(
            at,
            &core,
            &pressed.force,
            &pressed.out,
            pressed.whole.norm(),
        );
        let others_press = (0..tools.each.len() as u32)
            .any(|other| other != tool && self.pressing(other).next().is_some());
        let (Some(now), Some(hardest)) = (now, &mut self.hardest[place]) else {
            self.hardest[place] = now;
            return false;
        };
        let turn_m = solid.turned_m(&tools.solid(place, &hardest.at));
        hardest.go_on(&now);
        let (fall, least_m) = match others_press {
            true => (FALL_OF_A_FACE, BESIDE * solid.radius()),
            false => (fall, 0.0),
        };
        if hardest.way().norm() >= least_m
            && hardest.has_fallen(turn_m, ASIDE * solid.radius(), fall)
        {
            return true;
        }
        *hardest = hardest.or(now, solid.radius());
        false
    }

    /// Whether all that a tool touches is prescribed.
    fn touches_walls_alone(&self, tool: u32) -> bool {
        let mut own = self.contacts.iter().filter(|contact| contact.tool == tool);
        own.all(|contact| contact.is_wall)
    }

    /// Forgets a tool that tissue has slipped around: it starts afresh outside.
    pub fn forget(&mut self, tools: &TouchingTools, tool: u32) {
        let place = tool as usize;
        let from = self.placements[place].take();
        self.slipped[place] = from.map(|at| Sunk {
            last: tools.solid(place, &at).middle(),
            is_deep: false,
        });
        self.hardest[place] = None;
        self.contacts.retain(|contact| contact.tool != tool);
    }

    /// Whether a tool at a place has left the tissue that had slipped around it, if any had. It has once no core is in the tissue at
    /// rest, nor any part of it if a core has been, and the place is not [behind a wall](Model::is_behind_wall).
    pub(super) fn has_left(
        &mut self,
        model: &Model,
        tools: &TouchingTools,
        tool: usize,
        solid: &Solid,
    ) -> bool {
        let Some(Sunk { last, is_deep }) = self.slipped[tool] else {
            return true;
        };
        if let Some(core) = solid.cores().into_iter().find(|core| model.contains(core)) {
            self.slipped[tool] = Some(Sunk {
                last: core,
                is_deep: true,
            });
            return false;
        }
        let is_in = || {
            let near = tools.nearest_at_rest(solid);
            near.is_some_and(|near| near.gap_m < 0.0)
        };
        if (is_deep && is_in())
            || model.is_behind_wall(&last, self.clear[tool].as_ref(), &solid.middle())
        {
            return false;
        }
        self.slipped[tool] = None;
        true
    }

    /// Updates the places where tools are clear of the tissue, at the end of a way where none is inside.
    fn note_clear(&mut self, tools: &TouchingTools) {
        for tool in 0..tools.each.len() {
            if let Some(at) = &self.placements[tool]
                && self.count(tool as u32) == 0
            {
                self.clear[tool] = Some(tools.solid(tool, at).middle());
            }
        }
    }

    /// Whether the straight ways of all tools to `targets` lead out of the tissue: each goes where its contacts push it, and
    /// once it is clear of the tissue at rest it meets none again.
    pub fn lead_out(&self, tools: &TouchingTools, targets: &Placements) -> bool {
        let ways = self.placements.iter().zip(targets).enumerate();
        ways.take(tools.each.len()).all(|(tool, (from, target))| {
            let (Some(from), Some(target)) = (from, target) else {
                return true;
            };
            let way = target.centre - from.centre;
            let mut is_clear = self.count(tool as u32) == 0;
            let pressed = self.pressed(tools, tool as u32, &Matrix3::identity());
            if pressed.force.dot(&way) < 0.0 {
                return false;
            }
            let way_m = way.norm() + tools.solid(tool, from).reach() * from.angle_to(target);
            let mut done_m = 0.0;
            for _ in 0..MOST_LOOKS {
                let part = if done_m < way_m { done_m / way_m } else { 1.0 };
                let solid = tools.solid(tool, &from.towards(target, part));
                let near = tools.nearest_at_rest(&solid);
                let clearance_m = near.map_or(f64::MAX, |near| near.gap_m);
                if is_clear && clearance_m < 0.0 {
                    return false;
                }
                is_clear |= clearance_m > 0.0;
                if done_m >= way_m {
                    return true;
                }
                done_m += clearance_m.max(solid.piece());
            }
            false
        })
    }
}

impl Balance<'_> {
    /// Finds a tool around which the surface has slipped in the balance that was just found: it closes over the tool, or pushes
    /// less the deeper that goes. A tool that touches nothing is looked for in the tissue where its way `ends`, and where it
    /// touched just before. A tool that touches prescribed vertices alone is looked for in the tissue, too: from inside they
    /// would press it on inwards. Bodies of grips and needles are as [`Self::sunk_in`] says.
    pub(crate) fn slipped_in(&mut self, model: &Model, ends: bool) -> Option<Slipped> {
        let count = self.sources.tools.each().len() as u32;
        let found = (0..count).find(|tool| match self.state.tools.count(*tool) {
            0 => self.is_swallowed(model, *tool, ends),
            _ if self.is_wrapped(model, *tool) => true,
            _ => self.state.tools.touches_walls_alone(*tool) && self.is_enclosed(model, *tool),
        });
        let found = found.map(Slipped::Tool);
        let found = found.or_else(|| self.sunk_in(model, ends).map(Slipped::Body));
        self.work.tools.slipped = found;
        if ends && found.is_none() {
            self.state.tools.note_clear(&self.sources.tools);
        }
        found
    }

    /// Whether the surface has slipped around a tool that touches. Vertices that leave a flat face over its rim lower the force
    /// without that: there tissue has come through the face.
    fn is_wrapped(&mut self, model: &Model, tool: u32) -> bool {
        let tools = &self.sources.tools;
        let at_rest = self.state.tools.pressed(tools, tool, &Matrix3::identity());
        let shape = &tools.each()[tool as usize].tool.shape;
        let is_round = matches!(shape, Shape::Sphere { .. } | Shape::Capsule { .. });
        let has_faces = matches!(shape, Shape::FlatPunch { .. } | Shape::RoundedBox { .. });
        let fall = if is_round { FALL } else { FALL_OF_A_FACE };
        let falls = self.state.tools.falls(tools, tool, &at_rest, fall);
        // Where the lips of a cut part before a tool, the force falls as well.
        let falls = falls && at_rest.outwardness() < WRAPS && {
            let pressing = self.state.tools.pressing(tool);
            self.work.tools.patches.largest_share(tools, pressing) >= ALONE
        };
        let suspect = if has_faces {
            WRAPS
        } else {
            at_rest.least(is_round, falls).max(PULLS_IN)
        };
        if at_rest.total == 0.0 || at_rest.outwardness() >= suspect {
            return false;
        }
        // Tissue that has turned is compared where it has.
        let turn = self.rotation_around(tool);
        let tools = &self.sources.tools;
        let turned = self.state.tools.pressed(tools, tool, &turn).outwardness();
        let placement = self.state.tools.placements[tool as usize];
        let Some(placement) = placement.filter(|_| turned < suspect) else {
            return false;
        };
        let solid = tools.solid(tool as usize, &placement);
        // A tool that has its middle outside and comes along the surface is at a rim, where tissue slips from its front to under it.
        let cores = solid.cores();
        let wraps = turned < at_rest.least(is_round, falls)
            && (cores
                .into_iter()
                .any(|core| model.contains(&core) || self.is_within(model, &core))
                || (falls && self.heads_in(tool, &solid)));
        let pulls_in = turned < PULLS_IN && cores.iter().any(|core| self.is_within(model, core));
        wraps
            || pulls_in
            || solid
                .behind_faces()
                .any(|place| self.is_within(model, &place))
    }

    /// Whether the way of a tool since it was pushed hardest leads straight into the tissue at rest, at the vertex next to it.
    fn heads_in(&self, tool: u32, solid: &Solid) -> bool {
        let hardest = &self.state.tools.hardest[tool as usize];
        let near = self.sources.tools.nearest_at_rest(solid);
        let (Some(hardest), Some(near)) = (hardest, near) else {
            return false;
        };
        let way = hardest.way();
        way.dot(&near.normal) < -STRAIGHT_IN * way.norm()
    }

    /// Whether a tool that touches nothing is in the tissue.
    fn is_swallowed(&mut self, model: &Model, tool: u32, ends: bool) -> bool {
        let touched = self.state.tools.hardest[tool as usize].take().is_some();
        (ends || touched) && self.is_enclosed(model, tool)
    }

    /// Whether a core of a tool is in the tissue.
    fn is_enclosed(&mut self, model: &Model, tool: u32) -> bool {
        let tools = &self.sources.tools;
        let Some(placement) = self.state.tools.placements[tool as usize] else {
            return false;
        };
        let solid = tools.solid(tool as usize, &placement);
        // Behind the tangent plane of the nearest vertex is the cheap suspicion, the solid angle of the closed surface at rest
        // the next one, and that of the surface where it is the proof.
        let Some(near) = tools.nearest_at_rest(&solid) else {
            return false;
        };
        let is_suspect =
            |core: &Vector3<f64>| (core - near.at).dot(&near.normal) < 0.0 && model.contains(core);
        let Some(core) = solid.cores().into_iter().find(is_suspect) else {
            return false;
        };
        self.is_within(model, &core)
    }

    /// Whether a point is in the tissue as it is now.
    fn is_within(&mut self, model: &Model, point: &Vector3<f64>) -> bool {
        self.find_all_nodes();
        let at = &self.work.nodes.at;
        model.surface().encloses(|node| at[node as usize], point)
    }

    /// Mean rotation of the tissue around what a tool touches, from rest (Kabsch 1976).
    fn rotation_around(&self, tool: u32) -> Matrix3<f64> {
        let (tools, state) = (&self.sources.tools, &self.state.tools);
        let Some(placement) = &state.placements[tool as usize] else {
            return Matrix3::identity();
        };
        let reach_m = AROUND * tools.solid(tool as usize, placement).radius();
        let touched = || {
            let own = state.pressing(tool);
            own.filter_map(|contact| tools.place_of_node(contact.node))
        };
        let is_near = |place: &usize| {
            touched().any(|touched| {
                let way = tools.resting_m[touched] - tools.resting_m[*place];
                tools.group[touched] == tools.group[*place]
                    && way.norm_squared() < reach_m * reach_m
            })
        };
        let around = || (0..tools.nodes.len()).filter(is_near);
        let (mut count, mut from, mut to) = (0.0, Vector3::zeros(), Vector3::zeros());
        for place in around() {
            count += 1.0;
            from += tools.resting_m[place];
            to += self.position(tools.nodes[place]);
        }
        let (from, to) = (from / count, to / count);
        let mut moment = Matrix3::zeros();
        for place in around() {
            let arm = self.position(tools.nodes[place]) - to;
            moment += arm * (tools.resting_m[place] - from).transpose();
        }
        let found = moment.try_svd(true, true, f64::EPSILON, 0);
        let Some((Some(u), Some(v_t))) = found.map(|svd| (svd.u, svd.v_t)) else {
            return Matrix3::identity();
        };
        // A rotation and no reflection, along the direction of least extent.
        let handed = Vector3::new(1.0, 1.0, (u * v_t).determinant().signum());
        u * Matrix3::from_diagonal(&handed) * v_t
    }
}
