//! What is constant about bodies of tissue that may touch.
//!
//! Entry point: [`Touching::new`]. Source: Younes 2021, section 2.2.6; lengths are given in mean edges of the
//! boundaries, for that is the length below which a mesh says nothing.

use super::shell::Shell;
use nalgebra::Vector3;
use thiserror::Error;

/// Two bodies that may touch; for contact of a body with itself one body twice.
#[derive(Clone, Debug, PartialEq)]
pub struct TouchPart {
    /// Boundary faces of either by their nodes, counter-clockwise seen from outside, (2 x f x 3).
    pub faces: [Vec<[u32; 3]>; 2],
    /// Coulomb's coefficient \[1\].
    pub friction: f64,
}

/// How contact is found and kept. Lengths are parts of the mean edge of the boundaries.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TouchSettings {
    /// Distance at which bodies in contact are held apart: the room for what rows that are linearised leave
    /// out. 0.005: five times the 0.001 by which nothing shall penetrate.
    pub separation: f64,
    /// Features that do not press and are farther apart than this are let go of. 0.02: four separations, so
    /// that what has been let go of does not come back at once.
    pub release: f64,
    /// A point of contact that has wandered by less than this over its face or edge stays where it is in the
    /// rows, so that what is known of it does not have to be computed again. 0.05.
    pub wander: f64,
    /// Features that come as near as this are looked at more closely. 0.4: more makes a longer list, less has
    /// it made anew more often.
    pub guard: f64,
    /// Most pairs of features that are kept apart at a time. 256.
    pub most_pairs: usize,
}

impl Default for TouchSettings {
    fn default() -> Self {
        Self {
            separation: 0.005,
            release: 0.02,
            wander: 0.05,
            guard: 0.4,
            most_pairs: 256,
        }
    }
}

/// Why bodies cannot be kept apart.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum TouchError {
    /// A body without a boundary.
    #[error("tissue contact {part}: one of the two bodies has no faces")]
    NoFaces {
        /// Which part.
        part: usize,
    },
    /// A node that does not exist, or is not anywhere.
    #[error(
        "tissue contact {part} names node {node}, which does not exist or has no finite position"
    )]
    NoSuchNode {
        /// Which part.
        part: usize,
        /// The node.
        node: u32,
    },
    /// A number out of range.
    #[error("tissue contact: `{what}` is {value}; it must be {rule}")]
    Number {
        /// Its name.
        what: &'static str,
        /// Its value.
        value: f64,
        /// What is allowed.
        rule: &'static str,
    },
}

/// Two bodies, by what lies beside what.
#[derive(Clone, Debug)]
pub(super) struct Part {
    /// One of a body with itself.
    shells: Vec<Shell>,
    pub friction: f64,
}

impl Part {
    pub fn shells(&self) -> [&Shell; 2] {
        let last = self.shells.len() - 1;
        [&self.shells[0], &self.shells[last]]
    }

    /// Whether it is one body and itself.
    pub fn is_one(&self) -> bool {
        self.shells.len() == 1
    }
}

/// Bodies that may touch.
#[derive(Clone, Debug)]
pub struct Touching {
    pub(super) parts: Vec<Part>,
    /// Nodes of all boundaries, ascending.
    pub(super) nodes: Vec<u32>,
    pub(super) settings: TouchSettings,
    mean_edge_m: f64,
}

impl Touching {
    /// Of `parts`, with their nodes at `at` \[m\] (n x 3) in the beginning. Bodies may touch there; what
    /// overlaps by less than half a separation does not get deeper, and what overlaps by more is not held before
    /// it has come out. [`super::penetration_m`] says by how much they do.
    ///
    /// # Errors
    /// A body without faces, nodes that do not exist, numbers out of range.
    pub fn new(
        parts: &[TouchPart],
        at: &[Vector3<f64>],
        settings: TouchSettings,
    ) -> Result<Self, TouchError> {
        check(&settings)?;
        let (mut nodes, mut own) = (Vec::new(), Vec::with_capacity(parts.len()));
        let (mut edges, mut length_m) = (0usize, 0.0);
        for (index, part) in parts.iter().enumerate() {
            if !(part.friction.is_finite() && part.friction >= 0.0) {
                return Err(TouchError::Number {
                    what: "friction",
                    value: part.friction,
                    rule: "0 or more",
                });
            }
            let known = |node: &&u32| {
                let at = at.get(**node as usize);
                !at.is_some_and(|at| at.iter().all(|x| x.is_finite()))
            };
            if part.faces.iter().any(Vec::is_empty) {
                return Err(TouchError::NoFaces { part: index });
            }
            if let Some(&node) = part.faces.iter().flatten().flatten().find(known) {
                return Err(TouchError::NoSuchNode { part: index, node });
            }
            let mut shells: Vec<Shell> = part.faces.iter().map(|faces| Shell::new(faces)).collect();
            if part.faces[0] == part.faces[1] {
                shells.truncate(1);
            }
            for shell in &shells {
                nodes.extend(shell.nodes());
                for [a, b] in shell.edges() {
                    edges += 1;
                    length_m += (at[a as usize] - at[b as usize]).norm();
                }
            }
            own.push(Part {
                shells,
                friction: part.friction,
            });
        }
        nodes.sort_unstable();
        nodes.dedup();
        Ok(Self {
            parts: own,
            nodes,
            settings,
            mean_edge_m: length_m / edges.max(1) as f64,
        })
    }

    /// Mean length of the boundaries' edges in the beginning \[m\].
    pub fn mean_edge_m(&self) -> f64 {
        self.mean_edge_m
    }

    /// Distance at which bodies in contact are held apart \[m\].
    pub fn separation_m(&self) -> f64 {
        self.settings.separation * self.mean_edge_m
    }

    /// Most pairs of features that are kept apart at a time; each has an anchor, and a row or, with friction,
    /// three.
    pub fn most_pairs(&self) -> usize {
        self.settings.most_pairs
    }

    /// Most rows of [`super::TouchState::rows`].
    pub fn most_rows(&self) -> usize {
        let rough = self.parts.iter().any(|part| part.friction > 0.0);
        self.settings.most_pairs * if rough { 3 } else { 1 }
    }

    /// Nodes that rows may name: those of the boundaries, ascending.
    pub fn nodes(&self) -> &[u32] {
        &self.nodes
    }
}

fn check(settings: &TouchSettings) -> Result<(), TouchError> {
    let lengths = [
        ("separation", settings.separation),
        ("release", settings.release),
        ("wander", settings.wander),
        ("guard", settings.guard),
    ];
    for (what, value) in lengths {
        if !(value > 0.0 && value <= 1.0) {
            return Err(TouchError::Number {
                what,
                value,
                rule: "above 0 and at most 1 mean edge",
            });
        }
    }
    if settings.release <= settings.separation {
        return Err(TouchError::Number {
            what: "release",
            value: settings.release,
            rule: "larger than the separation",
        });
    }
    Ok(())
}
