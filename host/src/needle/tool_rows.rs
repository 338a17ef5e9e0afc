//! What the console is sent of a tool that touches, or will.
//!
//! Entry point: [`Drive::tool_rows`].

use super::drive::{Drive, NeedleWork};
use super::touching::turn;
use crate::anchors::ConstraintSet;
use crate::source::tool::{ALIKE_M, Cones, Contact, NEAR, Turning, Turns, in_units};
use crate::step::{MAX_TOOL_ROWS, ToolRows};
use nalgebra::{Matrix6, Vector3};

/// Rows of a cone.
const CONE: usize = 3;

/// What a console wants to know of a tool.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Wanted {
    /// Most rows; 0 for none.
    pub most_rows: usize,
    /// The way that it may go while they are in use, and any way besides \[m\].
    pub ahead_m: Vector3<f64>,
    pub reach_m: f64,
}

impl Drive<'_> {
    /// The rows of a tool whose wrench about `grip` follows its pose by `tangent`: those of what it touches, and of what it
    /// may come to touch. Nothing if there are none. The rows of the balance are not those of the last solve any more.
    pub(super) fn tool_rows(
        &mut self,
        (tool, id): (u32, u8),
        grip: &Vector3<f64>,
        tangent: &Matrix6<f64>,
        wanted: &Wanted,
        cones: &mut Cones,
    ) -> Option<ToolRows> {
        let each = self.needles.tools.each();
        let smooth = each.get(tool as usize)?.tool.is_smooth();
        let most_rows = wanted.most_rows.min(MAX_TOOL_ROWS);
        let most = most_rows / if smooth { 1 } else { CONE };
        if most == 0 {
            return None;
        }
        let touched = self.tools.contacts.len();
        self.find_near_tools(wanted.reach_m + wanted.ahead_m.norm());
        self.add_coming((tool, smooth), most, wanted);
        let rows = self.write_rows((tool, id), grip, tangent, most, cones);
        self.tools.contacts.truncate(touched);
        rows
    }

    fn write_rows(
        &mut self,
        (tool, id): (u32, u8),
        grip: &Vector3<f64>,
        tangent: &Matrix6<f64>,
        most: usize,
        cones: &mut Cones,
    ) -> Option<ToolRows> {
        self.make_rows();
        let smooth = self.needles.tools.each()[tool as usize].tool.is_smooth();
        if !cones.gather(self.tools, (tool, smooth), most) {
            return None;
        }
        let NeedleWork { system, set, .. } = &mut *self.work;
        let ConstraintSet {
            anchors,
            ways,
            rows,
            ..
        } = &*set;
        let sound = system.read(self.body, anchors, ways, rows)
            && system.read_spread(&set.spread, &set.terms);
        // The balance may have left crossings on faces that it had none on before.
        if !sound || !system.fetch(self.body, self.grasp, 0).all {
            return None;
        }
        system.assemble(self.body, self.grasp, rows);
        self.soften();
        let n = self.work.count();
        cones.load(n, grip);
        let turns = turn(self.needles, self.tools, self.work, Turns::Sliding);
        let NeedleWork {
            system,
            set,
            turning,
            ..
        } = &mut *self.work;
        let turning = turning.as_ref().filter(|_| turns);
        let is_known = turning.is_none_or(Turning::is_plain);
        let turning = turning.filter(|turning| turning.is_plain());
        if let Some(turning) = turning {
            cones.turn(turning, (&self.tools.contacts, tool), grip, (system, set));
        }
        if !system.condense(set.rows.len(), turning, self.grasp, cones) {
            return None;
        }
        let mut out = ToolRows::NONE;
        cones.write(&self.needles.tools, self.tools, tool, tangent, &mut out);
        out.tool = id;
        out.turning = is_known;
        (out.count > 0).then_some(out)
    }

    /// Takes up the vertices that a tool is nearest to, here or where it may go, as open contacts: as far as their columns
    /// are there.
    fn add_coming(&mut self, (tool, smooth): (u32, bool), most: usize, wanted: &Wanted) {
        let tools = &self.needles.tools;
        let Some(placement) = &self.tools.placements[tool as usize] else {
            return;
        };
        let solid = tools.solid(tool as usize, placement);
        let then = solid.moved(&wanted.ahead_m);
        let reach_m = NEAR * solid.radius() + wanted.reach_m;
        let room = tools.most_contacts() - self.tools.contacts.len();
        let mut nearest: [Option<(f64, u32)>; MAX_TOOL_ROWS] = [None; MAX_TOOL_ROWS];
        let count = most.min(room);
        for (_, node) in self.work.near_tools.iter().filter(|(of, _)| *of == tool) {
            let is = |contact: &Contact| (contact.tool, contact.node) == (tool, *node);
            if !self.work.system.has(*node) {
                continue;
            }
            let at = self.position(*node);
            let soonest = solid.gap(&at).min(then.gap(&at));
            if soonest >= reach_m || solid.touch(&at).is_none() {
                continue;
            }
            if self.tools.contacts.iter().any(is) {
                continue;
            }
            // Into its place among the nearest.
            let mut new = Some((in_units(soonest, ALIKE_M), *node));
            for place in nearest[..count].iter_mut() {
                if place.is_none_or(|before| new < Some(before)) {
                    std::mem::swap(place, &mut new);
                }
                if new.is_none() {
                    break;
                }
            }
        }
        for (_, node) in nearest.into_iter().flatten() {
            let contact = Contact::coming((tool, smooth), node, &solid, self.position(node));
            self.tools.contacts.extend(contact);
        }
    }
}
