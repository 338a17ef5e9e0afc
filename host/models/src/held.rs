//! What a step of any of these models does with held nodes: hold and let go, reactions, their work, and giving up.
//!
//! Entry point: [`Held`].

use crate::drive_check::failed;
use crate::in_place::clone_in_place;
use crate::{BoundaryConditions, Diagnostics};

/// Held nodes of a step and what holds them.
#[derive(Debug)]
pub(crate) struct Held {
    /// Ascending.
    nodes: Vec<u32>,
    /// Reactions, one for each \[N\].
    pub reactions_n: Vec<[f64; 3]>,
}

clone_in_place!(Held { nodes, reactions_n });

impl Held {
    /// None, with room for all of `nodes`.
    pub fn new(nodes: usize) -> Self {
        Self {
            nodes: Vec::with_capacity(nodes),
            reactions_n: Vec::with_capacity(nodes),
        }
    }

    /// Takes over the nodes that the drive holds; calls `let_go` with each that is no longer held.
    pub fn hold(&mut self, drive: &BoundaryConditions<'_>, mut let_go: impl FnMut(usize)) {
        let mut now = drive.held.iter().map(|held| held.0).peekable();
        for &node in &self.nodes {
            while now.next_if(|held| *held < node).is_some() {}
            if now.peek() != Some(&node) {
                let_go(node as usize);
            }
        }
        self.nodes.clear();
        self.nodes.extend(drive.held.iter().map(|held| held.0));
    }

    /// Writes the `reaction` \[N\] of each held node. Returns the sum of their squares \[N^2\] and their work over
    /// what each has `gone` in the step \[J\].
    pub fn react(
        &mut self,
        drive: &BoundaryConditions<'_>,
        reaction: impl Fn(usize) -> [f64; 3],
        gone: impl Fn(usize) -> [f64; 3],
    ) -> (f64, f64) {
        let (mut square_n2, mut work_j) = (0.0, 0.0);
        self.reactions_n.clear();
        for &(node, _) in drive.held {
            let i = node as usize;
            let (reaction, gone) = (reaction(i), gone(i));
            for axis in 0..3 {
                square_n2 += reaction[axis] * reaction[axis];
                work_j += reaction[axis] * gone[axis];
            }
            self.reactions_n.push(reaction);
        }
        (square_n2, work_j)
    }

    /// Says that a step that was undone has failed: reactions are none.
    pub fn give_up(&mut self, drive: &BoundaryConditions<'_>, energy_j: f64) -> Diagnostics {
        self.reactions_n.clear();
        self.reactions_n.resize(drive.held.len(), [0.0; 3]);
        failed("the step leads to positions that are not finite", energy_j)
    }
}

/// The load on a node \[N\].
pub(crate) fn load(drive: &BoundaryConditions<'_>, node: usize) -> [f64; 3] {
    drive.force_n.get(node).copied().unwrap_or_default()
}

/// `part / whole`, and 0 where there is nothing to compare.
pub(crate) fn ratio(part: f64, whole: f64) -> f64 {
    if part == 0.0 { 0.0 } else { part / whole }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_is_no_longer_held_is_let_go_once() {
        let mut held = Held::new(13);
        let mut hold = |nodes: &[u32]| {
            let nodes: Vec<_> = nodes.iter().map(|node| (*node, [0.0; 3])).collect();
            let drive = BoundaryConditions {
                held: &nodes,
                force_n: &[],
            };
            let mut gone = Vec::new();
            held.hold(&drive, |node| gone.push(node));
            gone
        };
        assert!(hold(&[1, 4, 6, 9]).is_empty());
        assert!(hold(&[0, 1, 4, 5, 6, 9, 12]).is_empty());
        assert_eq!(hold(&[2, 4, 9]), [0, 1, 5, 6, 12]);
        assert_eq!(hold(&[]), [2, 4, 9]);
        assert!(hold(&[3]).is_empty());
    }

    #[test]
    fn reactions_are_summed_and_work() {
        let nodes = [(2, [0.0; 3]), (3, [0.0; 3])];
        let drive = BoundaryConditions {
            held: &nodes,
            force_n: &[],
        };
        let mut held = Held::new(13);
        let of = |i: usize| [i as f64, 0.0, -1.0];
        let (square_n2, work_j) = held.react(&drive, of, |i| [1.0, 5.0, 2.0 * i as f64]);
        assert_eq!(held.reactions_n, [[2.0, 0.0, -1.0], [3.0, 0.0, -1.0]]);
        assert_eq!((square_n2, work_j), (5.0 + 10.0, -2.0 - 3.0));
        let report = held.give_up(&drive, 0.5);
        assert_eq!(held.reactions_n, [[0.0; 3]; 2]);
        assert_eq!(report.energy_j, 0.5);
    }
}
