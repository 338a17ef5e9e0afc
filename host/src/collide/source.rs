//! Tissue that touches tissue as a source of constraints.
//!
//! Entry point: [`TissueContactSource`].

use crate::needle::MOST_GROUPS;
use crate::source::{Room, Source};
use crate::step::{Balance, BalanceWork, Sources};

/// Bodies of tissue that may touch.
pub(crate) struct TissueContactSource;

impl Source for TissueContactSource {
    fn room(&self, sources: &Sources) -> Room {
        let touching = sources.touching.as_ref();
        touching.map_or_else(Room::default, |touching| {
            Room::new(touching.most_pairs(), touching.most_rows())
        })
    }

    fn append(&self, balance: &mut Balance) {
        if let (Some(touching), Some(touch)) = (&balance.sources.touching, &balance.state.touch) {
            let set = &mut balance.work.set;
            touch.rows(touching, balance.points_m, &mut set.anchors, &mut set.rows);
        }
    }

    /// Whether tissues have met on the way to where the last solve has them, and so have rows now.
    fn meets(&self, balance: &mut Balance) -> bool {
        let Some(touching) = &balance.sources.touching else {
            return false;
        };
        let mut slack = [0.0; MOST_GROUPS];
        let slack = balance.slack(&mut slack).iter().copied();
        let slack_m = slack.fold(0.0, f64::max);
        let resting_m = &balance.sources.resting_m;
        let touch = balance.state.touch.as_ref();
        if touch.is_none_or(|touch| touch.is_clear(slack_m + touch.strayed_m(touching, resting_m)))
        {
            if let Some(work) = &mut balance.work.touch {
                work.without_room = 0;
            }
            return false;
        }
        balance.find_all_nodes();
        let BalanceWork { touch, nodes, .. } = &mut *balance.work;
        let met = match (&mut balance.state.touch, touch) {
            (Some(state), Some(work)) => state.look(touching, work, &nodes.at),
            _ => false,
        };
        balance.clock.lap(&mut balance.report.stages.detect_ns);
        met
    }

    /// What touches is looked at anew.
    fn accept(&self, balance: &mut Balance) {
        let Some(touching) = &balance.sources.touching else {
            return;
        };
        let BalanceWork {
            touch,
            nodes,
            needles,
            ..
        } = &mut *balance.work;
        if nodes.at_solve != nodes.solves {
            return;
        }
        if let (Some(state), Some(work)) = (&mut balance.state.touch, touch) {
            let first = 3 * needles.points.len();
            let lambda = balance.state.grasp.lambda().get(first..);
            state.accept(touching, work, &nodes.at, lambda.unwrap_or_default());
            balance.report.touching = state.pressing() as u32;
        }
        balance.clock.lap(&mut balance.report.stages.detect_ns);
    }
}
