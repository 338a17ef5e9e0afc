//! What the console is sent of a tool that touches, or will.
//!
//! Entry point: [`reduce_tools`].

use super::balance::{Balance, BalanceWork};
use super::options::StepOptions;
use super::tool_rows::{MAX_TOOL_ROWS, ToolRows};
use crate::model::Model;
use crate::rows::Condensed;
use crate::source::tool::{ALIKE_M, Cones, Contact, NEAR, Turning, in_units};
use crate::tool::ToolSample;
use nalgebra::{Matrix6, Vector3};

/// Rows of a cone.
const CONE: usize = 3;

impl Balance<'_> {
    /// The rows of a tool whose wrench about `grip` follows its pose by `tangent`: those of what it touches, and of what it
    /// may come to touch. Nothing if there are none. The rows of the balance are not those of the last solve any more.
    fn tool_rows(
        &mut self,
        (tool, id): (u32, u8),
        grip: &Vector3<f64>,
        tangent: &Matrix6<f64>,
        options: &StepOptions,
        cones: &mut Cones,
    ) -> Option<ToolRows> {
        let each = self.sources.tools.each();
        let smooth = each.get(tool as usize)?.tool.is_smooth();
        let most_rows = options.most_rows.min(MAX_TOOL_ROWS);
        // Half of what rubs has normals alone, where hardly anything is touched.
        let most = if smooth { most_rows } else { most_rows / 2 };
        if most_rows < if smooth { 1 } else { CONE } {
            return None;
        }
        let touched = self.state.tools.contacts.len();
        let ahead_m = Vector3::from(options.ahead_m).norm();
        self.find_near_tools(options.reach_m + ahead_m);
        self.add_coming(tool, most, options);
        let rows = self.write_rows((tool, id, smooth), grip, tangent, most_rows, cones);
        self.state.tools.contacts.truncate(touched);
        rows
    }

    fn write_rows(
        &mut self,
        (tool, id, smooth): (u32, u8, bool),
        grip: &Vector3<f64>,
        tangent: &Matrix6<f64>,
        most: usize,
        cones: &mut Cones,
    ) -> Option<ToolRows> {
        self.append();
        if !cones.gather(&self.state.tools, (tool, smooth), most) {
            return None;
        }
        // The balance may have left crossings on faces that it had none on before: they have no columns then.
        self.assemble(u32::MAX, 0).ok()?;
        let n = self.work.count();
        cones.load(n, grip);
        let BalanceWork {
            system, set, tools, ..
        } = &mut *self.work;
        let is_known = tools.turning().is_none_or(Turning::is_plain);
        let turning = tools.turning().filter(|turning| turning.is_plain());
        if let Some(turning) = turning {
            let of = (&self.state.tools.contacts[..], tool);
            cones.turn(turning, of, grip, (system, set));
        }
        let k = cones.keep.len();
        let mut out = Condensed {
            compliance: &mut cones.compliance[..k * k],
            delta_free: &mut cones.delta_free[..k],
            jacobian: &mut cones.kept_jacobian[..6 * k],
        };
        let kept = (&cones.keep[..], &cones.jacobian[..6 * n]);
        if !system.condense(set.rows.len(), turning, &self.state.grasp, kept, &mut out) {
            return None;
        }
        let mut out = ToolRows::NONE;
        cones.write(
            &self.sources.tools,
            &self.state.tools,
            tool,
            tangent,
            &mut out,
        );
        out.tool = id;
        out.turning = is_known;
        (out.count > 0).then_some(out)
    }

    /// Takes up the vertices that a tool is nearest to, here or where it may go, as open contacts: as far as their columns
    /// are there.
    fn add_coming(&mut self, tool: u32, most: usize, options: &StepOptions) {
        let tools = &self.sources.tools;
        let Some(placement) = &self.state.tools.placements[tool as usize] else {
            return;
        };
        let solid = tools.solid(tool as usize, placement);
        let then = solid.moved(&Vector3::from(options.ahead_m));
        let reach_m = NEAR * solid.radius() + options.reach_m;
        let room = tools.most_contacts() - self.state.tools.contacts.len();
        let mut nearest: [Option<(f64, u32)>; MAX_TOOL_ROWS] = [None; MAX_TOOL_ROWS];
        let count = most.min(room);
        for (_, node) in self.work.tools.near.iter().filter(|(of, _)| *of == tool) {
            let is = |contact: &Contact| (contact.tool, contact.node) == (tool, *node);
            if !(self.work.system.has(*node) || tools.is_wall(*node)) {
                continue;
            }
            let at = self.position(*node);
            let soonest = solid.gap(&at).min(then.gap(&at));
            if soonest >= reach_m || solid.touch(&at).is_none() {
                continue;
            }
            if self.state.tools.contacts.iter().any(is) {
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
            let contact = Contact::coming(tools, (tool, node), &solid, self.position(node));
            self.state.tools.contacts.extend(contact);
        }
    }
}

/// Vertices that will be touched at once, in radii: as far as one is nearer than another.
const AT_ONCE: f64 = 1e-3;

/// What the console solves by itself of the tools that touch; of those that are apart, the tangent of the touch to come.
pub(super) fn reduce_tools(
    model: &Model,
    balance: &mut Balance,
    samples: &[ToolSample],
    options: &StepOptions,
    cones: &mut Cones,
    out: &mut Vec<ToolRows>,
) {
    for (place, sample) in samples.iter().enumerate() {
        let Some((index, tool)) = model.tool(sample.id) else {
            continue;
        };
        let Some(touching) = balance.sources.tools.place_of(Some(index)) else {
            continue;
        };
        let contact = balance.report.contacts()[place];
        let apart = contact.rows == 0;
        if options.most_rows == 0 && !apart {
            continue;
        }
        let grip = Vector3::from(sample.position_m);
        let tangent = Matrix6::from_fn(|i, j| contact.tangent[i][j]);
        let most = StepOptions {
            // A tangent takes all that there are; where some are sent they are planned as a whole.
            most_rows: if apart && (tool.is_smooth() || options.most_rows == 0) {
                MAX_TOOL_ROWS
            } else {
                options.most_rows
            },
            ..*options
        };
        let of = (touching, sample.id);
        let Some(mut rows) = balance.tool_rows(of, &grip, &tangent, &most, cones) else {
            continue;
        };
        if apart {
            let radius_m = tool.radius_m().max(model.surface().mean_edge_m);
            let at_once_m = contact.gap_m + AT_ONCE * radius_m;
            let coming = cones.coming(&rows, at_once_m).transpose().into();
            balance.report.contacts_mut(samples.len())[place].tangent = coming;
            rows.truncate(options.most_rows);
        }
        if rows.count > 0 {
            out.push(rows);
        }
    }
}
