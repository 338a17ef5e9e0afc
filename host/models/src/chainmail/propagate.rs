//! Propagation of the classical ChainMail, and the forces it hands back.
//!
//! Entry points: [`Propagation::spread`], [`Propagation::hand_back`]. After zhang-2017, (3.4) to (3.6): an element beyond a
//! bound follows the one that moved, axis by axis. An element visited again is bounded again until nothing violates.

use super::links::{Links, difference};
use super::queue::Queue;
use super::region::Box3;
use crate::in_place::clone_in_place;

/// One element dragged by another.
#[derive(Clone, Copy, Debug)]
struct Drag {
    by: u32,
    dragged: u32,
    /// Axes along which it was.
    axes: [bool; 3],
}

/// Who dragged whom in a step.
#[derive(Debug)]
pub(super) struct Propagation {
    queue: Queue,
    drags: Vec<Drag>,
    most_drags: usize,
    stamp: Vec<u32>,
    now: u32,
    /// Elements dragged in the last step.
    pub moved: usize,
    /// Elements taken from the queue in the last step.
    pub visits: u64,
}

clone_in_place!(Propagation {
    queue,
    drags,
    most_drags,
    stamp,
    now,
    moved,
    visits,
});

impl Propagation {
    /// For `nodes` elements; remembers at most `most_drags` of a step.
    pub fn new(nodes: usize, most_drags: usize) -> Self {
        Self {
            queue: Queue::new(nodes),
            drags: Vec::with_capacity(most_drags),
            most_drags,
            stamp: vec![0; nodes],
            now: 0,
            moved: 0,
            visits: 0,
        }
    }

    /// Starts a step.
    pub fn begin(&mut self) {
        self.now = self.now.wrapping_add(1);
        self.drags.clear();
        (self.moved, self.visits) = (0, 0);
    }

    /// An element that moved, first moved first.
    pub fn push(&mut self, node: u32) {
        self.queue.push(node);
    }

    /// Spreads until nothing violates its bounds; `false` where `most_visits` or the memory for drags was
    /// not enough. What is `held` stays.
    pub fn spread(
        &mut self,
        links: &Links,
        region: &Box3,
        slack_m: f64,
        held: &[bool],
        x: &mut [[f64; 3]],
        most_visits: u64,
    ) -> bool {
        while let Some(i) = self.queue.pop() {
            self.visits += 1;
            if self.visits > most_visits {
                self.queue.clear();
                return false;
            }
            let xi = x[i as usize];
            for link in links.beside(i as usize) {
                let j = link.to as usize;
                if held[j] && held[i as usize] {
                    continue;
                }
                let offset = difference(&links.rest_m[i as usize], &links.rest_m[j]);
                let mut axes = [false; 3];
                for (axis, (least, greatest)) in region.intervals(offset).into_iter().enumerate() {
                    let at = x[j][axis] - xi[axis];
                    if held[j] {
                        // What is held does not follow: it drags back.
                        if at < least - slack_m || at > greatest + slack_m {
                            self.queue.push(link.to);
                        }
                    } else if at < least - slack_m {
                        x[j][axis] = xi[axis] + least;
                        axes[axis] = true;
                    } else if at > greatest + slack_m {
                        x[j][axis] = xi[axis] + greatest;
                        axes[axis] = true;
                    }
                }
                if axes == [false; 3] {
                    continue;
                }
                if self.drags.len() == self.most_drags {
                    self.queue.clear();
                    return false;
                }
                self.drags.push(Drag {
                    by: i,
                    dragged: link.to,
                    axes,
                });
                self.queue.push(link.to);
                if self.stamp[j] != self.now {
                    self.stamp[j] = self.now;
                    self.moved += 1;
                }
            }
        }
        true
    }

    /// Hands each dragged element's force on to what dragged it, last dragged first: the derivative of
    /// positions by those of held elements, transposed. What arrives at held elements is minus the change of
    /// energy with their displacement.
    pub fn hand_back(&self, force: &mut [[f64; 3]]) {
        for drag in self.drags.iter().rev() {
            for axis in 0..3 {
                if drag.axes[axis] {
                    let handed = force[drag.dragged as usize][axis];
                    force[drag.dragged as usize][axis] = 0.0;
                    force[drag.by as usize][axis] += handed;
                }
            }
        }
    }
}
