//! Position adjustments of the ellipsoid-bounded ChainMail, spread first moved first.
//!
//! Entry point: [`enforce`]. After zhang-2017, (3.40) to (3.46): a link beyond its limits moves both its elements
//! along itself, by the inverse of their masses, to the limit.

use super::awake::Awake;
use super::links::{Links, difference, square};
use super::queue::Queue;
use super::region::Region;

/// What elements share while links are brought within their limits.
pub(super) struct Adjusted<'a> {
    /// Rest positions \[m\], (n x 3).
    pub rest_m: &'a [[f64; 3]],
    /// Positions \[m\], (n x 3).
    pub x: &'a mut [[f64; 3]],
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
        for axis in 0..3 {
            let push = share * d[axis];
            self.x[a][axis] += wi * push;
            self.x[b][axis] -= wj * push;
        }
        for (node, w, sign) in [(a, wi, 1.0), (b, wj, -1.0)] {
            if w == 0.0 {
                for axis in 0..3 {
                    self.impulse[node][axis] += sign * share * d[axis];
                }
            } else if self.stamp[node] != self.now {
                self.stamp[node] = self.now;
                self.adjusted += 1;
            }
        }
        true
    }
}

/// Brings every link of what is awake within its limits, beginning with the elements that wait in `queue`.
/// Takes at most `most_visits` elements from it.
pub(super) fn enforce<R: Region>(
    links: &Links,
    region: &R,
    tolerance: f64,
    awake: &mut Awake,
    queue: &mut Queue,
    state: &mut Adjusted<'_>,
    most_visits: u64,
) -> Enforced {
    let mut visits = 0;
    // What was moved from outside spreads first; what is then still beyond is found link by link.
    for sweep in [false, true] {
        if sweep {
            for i in awake.near() {
                let (first, upper) = links.upper(i);
                let mut xi = state.x[i];
                for (index, link) in upper.iter().enumerate() {
                    let d = difference(&xi, &state.x[link.to as usize]);
                    if region.violated(first + index, link.rest_sq, d, tolerance) {
                        let (least, greatest) = region.lengths(first + index, link.rest_sq, d);
                        if state.adjust(i as u32, link.to, d, least, greatest) {
                            xi = state.x[i];
                            queue.push(i as u32);
                            queue.push(link.to);
                        }
                    }
                }
            }
        }
        while visits < most_visits {
            let Some(i) = queue.pop() else { break };
            visits += 1;
            awake.wake(i, links);
            let mut xi = state.x[i as usize];
            for link in links.beside(i as usize) {
                let d = difference(&xi, &state.x[link.to as usize]);
                if region.violated(link.link as usize, link.rest_sq, d, tolerance) {
                    let (least, greatest) = region.lengths(link.link as usize, link.rest_sq, d);
                    if state.adjust(i, link.to, d, least, greatest) {
                        xi = state.x[i as usize];
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
        awake.wake(i, links);
        within = false;
    }
    Enforced { visits, within }
}
