//! A balance is found: what slipped sticks where it is now, and what is open is let go of.

use super::{ToolContacts, TouchingTools};
use nalgebra::Vector3;

impl ToolContacts {
    /// Takes over the balance in which nodes are `at` \[m\]; `near` are the vertices that may be touched next, `slack_m` how far
    /// those of each group are from where they rest at most.
    pub fn accept(
        &mut self,
        tools: &TouchingTools,
        (near, slack_m): (&[(u32, u32)], &[f64]),
        at: impl Fn(u32) -> Vector3<f64>,
    ) {
        let Self {
            placements,
            contacts,
            friction_j,
            ..
        } = self;
        contacts.retain_mut(|contact| {
            let Some(placement) = &placements[contact.tool as usize] else {
                return false;
            };
            let force_n = contact.force_n();
            contact.ahead_m = placement.world(&contact.local_m) - contact.at_m;
            let stretch_m = contact.stretch_m();
            if contact.is_wall && contact.slips {
                contact.ahead_m -= stretch_m;
            }
            if contact.slips {
                // All of the way that the tool ran ahead, as the hand and the tissue count theirs: along a round rim both
                // normals have a part of it, one against the other.
                let mut way_m = contact.ahead_m;
                if contact.is_wall {
                    // The share along the normal is stored.
                    way_m -= contact.normal * contact.normal.dot(&way_m);
                }
                *friction_j += 0.5 * (contact.before_n + force_n).dot(&way_m);
            }
            if contact.slips || tools.each[contact.tool as usize].tool.is_smooth() {
                contact.local_m = if contact.is_wall {
                    placement.local(&(contact.at_m + stretch_m))
                } else {
                    placement.local(&contact.at_m)
                };
            }
            contact.sticks = !contact.slips;
            contact.before_n = force_n;
            contact.lambda_n[0] > 0.0
        });
        self.before = self.placements;
        let count = self.slack_m.len();
        self.slack_m.copy_from_slice(&slack_m[..count]);
        self.near.clear();
        self.near
            .extend(near.iter().map(|(_, node)| (*node, Vector3::zeros())));
        self.near.sort_unstable_by_key(|(node, _)| *node);
        self.near.dedup_by_key(|(node, _)| *node);
        for (node, place) in &mut self.near {
            *place = at(*node);
        }
    }
}
