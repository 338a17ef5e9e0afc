//! Position adjustments of the ellipsoid-bounded ChainMail, spread first moved first.
//!
//! Entry point: [`enforce`]. After zhang-2017, (3.40) to (3.46): a link beyond its limits moves both its elements
//! along itself, by the inverse of their masses, to the limit.

use super::awake::Awake;
use super::forces::{Element, between};
use super::links::{Links, difference, square};
use super::quad::Quad;
use super::queue::Queue;
use super::region::Region;

/// What elements share while links are brought within their limits.
pub(super) struct Adjusted<'a> {
    /// Rest positions \[m\], (n x 3).
    pub rest_m: &'a [[f64; 3]],
    /// Positions, (n).
    pub at: &'a mut [Element],
    /// Inverse masses \[1/kg\], 0 where held, (n).
    pub inverse_mass: &'a [f64],
    /// Mass times adjustment that links gave to held elements \[kg m\], (n x 3).
    pub impulse: &'a mut [[f64; 3]],
    /// Step in which an element was last adjusted, (n).
    pub stamp: &'a mut [u32],
    /// This step.
    pub now: u32,
    /// Elements adjusted in it.
    pub adjusted: usize,
    /// Elements adjusted or woken in it: their forces are out of date.
    pub stale: &'a mut Vec<u32>,
}

/// How it went.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Enforced {
    /// Elements taken from the queue.
    pub visits: u64,
    /// Whether every link with a free end lies within its limits, to the tolerance.
    pub within: bool,
}

impl Adjusted<'_> {
    /// Brings one link back to its limit; says whether anything moved.
    #[inline]
    fn adjust(&mut self, i: u32, j: u32, mut d: [f64; 3], least: f64, greatest: f64) -> bool {
        let (a, b) = (i as usize, j as usize);
        let (wi, wj) = (self.inverse_mass[a], self.inverse_mass[b]);
        // Two held elements stay where they are told.
        if wi + wj == 0.0 {
            return false;
        }
        let length = square(d).sqrt();
        let target = if length > greatest { greatest } else { least };
        let mut along = length;
        if length == 0.0 {
            // Two at one point part in the direction they have at rest.
            d = difference(&self.rest_m[a], &self.rest_m[b]);
            along = square(d).sqrt();
        }
        let share = (length - target) / (along * (wi + wj));
        let push = share * Quad::of(d);
        self.at[a].x = self.at[a].x + wi * push;
        self.at[b].x = self.at[b].x - wj * push;
        for (node, w, sign) in [(a, wi, 1.0), (b, wj, -1.0)] {
            if w == 0.0 {
                for axis in 0..3 {
                    self.impulse[node][axis] += sign * share * d[axis];
                }
            } else if self.stamp[node] != self.now {
                self.stamp[node] = self.now;
                self.adjusted += 1;
                self.stale.push(node as u32);
            }
        }
        true
    }

    fn wake(&mut self, node: u32, awake: &mut Awake, links: &Links) {
        if awake.wake(node, links) {
            self.stale.push(node);
        }
    }
}

/// Brings links within their limits: first what the elements that wait in `queue` drag along, then the links of
/// those in `beyond`, which nothing has brought back yet. Takes at most `most_visits` elements from the queue.
#[allow(clippy::too_many_arguments)]
pub(super) fn enforce<R: Region>(
    links: &Links,
    region: &R,
    tolerance: f64,
    beyond: &[u32],
    awake: &mut Awake,
    queue: &mut Queue,
    state: &mut Adjusted<'_>,
    most_visits: u64,
) -> Enforced {
    let mut visits = 0;
    for found in [&[], beyond] {
        for &i in found {
            let still = links.owned.of(i as usize).any(|link| {
                let j = link.to as usize;
                let d = between(&state.at[i as usize], &state.at[j]);
                state.inverse_mass[i as usize] + state.inverse_mass[j] > 0.0
                    && region.violated(link.place, link.rest_sq, d, tolerance)
            });
            if still {
                queue.push(i);
            }
        }
        while visits < most_visits {
            let Some(i) = queue.pop() else { break };
            visits += 1;
            state.wake(i, awake, links);
            for link in links.beside(i as usize) {
                let d = between(&state.at[i as usize], &state.at[link.to as usize]);
                let place = link.place as usize;
                if region.violated(place, link.rest_sq, d, tolerance) {
                    let (least, greatest) = region.lengths(place, link.rest_sq, d);
                    if state.adjust(i, link.to, d, least, greatest) {
                        queue.push(link.to);
                        if state.inverse_mass[i as usize] > 0.0 {
                            queue.push(i);
                        }
                    }
                }
            }
        }
    }
    let mut within = true;
    while let Some(i) = queue.pop() {
        state.wake(i, awake, links);
        within = false;
    }
    Enforced { visits, within }
}
