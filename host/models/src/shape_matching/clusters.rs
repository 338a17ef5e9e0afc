//! Overlapping clusters of a mesh's nodes, with weights from its material.
//!
//! Entry point: [`Clusters::new`]. The weight of a node in a cluster is E V / (c s^2): modulus times volume, shared among
//! its c clusters, over the cluster's mean square radius per axis. A small uniform strain e then costs E e:e / 2 per volume.

use crate::Materials;
use nalgebra::Vector3;
use std::collections::VecDeque;
use sutura_mesh::{TetMesh, signed_volume};

/// A node of a cluster.
#[derive(Clone, Copy, Debug)]
pub(super) struct Member {
    /// Place at rest, from the cluster's centre \[m\].
    pub rest_m: [f64; 3],
    /// Weight \[N/m\].
    pub weight: f64,
    /// The node.
    pub node: u32,
}

/// All clusters; constant.
#[derive(Clone, Debug)]
pub(super) struct Clusters {
    start: Vec<u32>,
    members: Vec<Member>,
    /// Sum of each node's weights \[N/m\], (n).
    pub stiffness: Vec<f64>,
    /// Volume of each node \[m^3\], (n).
    pub volume: Vec<f64>,
    /// Sum of modulus times volume \[N m\].
    pub modulus_volume: f64,
    /// Number of clusters each node is in, (n).
    pub shared_by: Vec<u32>,
}

impl Clusters {
    /// Nodes within `rings` edges of a centre; centres lie so that every node is within half of that.
    pub fn new(mesh: &TetMesh, materials: &Materials, rings: u32) -> Self {
        let nodes = mesh.points_m().len();
        let (mut volume, mut stuff) = (vec![0.0; nodes], vec![0.0; nodes]);
        let mut beside: Vec<Vec<u32>> = vec![Vec::new(); nodes];
        for (index, cell) in mesh.cells().iter().enumerate() {
            let quarter = 0.25 * signed_volume(&mesh.corners(*cell));
            for &a in cell {
                volume[a as usize] += quarter;
                stuff[a as usize] += quarter * materials.of(index).youngs_modulus_pa;
                beside[a as usize].extend(cell.iter().filter(|b| **b != a));
            }
        }
        for list in &mut beside {
            list.sort_unstable();
            list.dedup();
        }
        let (mut start, mut lists) = (vec![0], Vec::new());
        let (mut covered, mut shared_by) = (vec![false; nodes], vec![0u32; nodes]);
        let mut seen = vec![u32::MAX; nodes];
        let mut queue = VecDeque::new();
        for centre in 0..nodes as u32 {
            if covered[centre as usize] {
                continue;
            }
            queue.push_back((centre, 0));
            seen[centre as usize] = centre;
            while let Some((node, ring)) = queue.pop_front() {
                lists.push(node);
                shared_by[node as usize] += 1;
                covered[node as usize] |= ring <= rings / 2;
                if ring == rings {
                    continue;
                }
                for &next in &beside[node as usize] {
                    if seen[next as usize] != centre {
                        seen[next as usize] = centre;
                        queue.push_back((next, ring + 1));
                    }
                }
            }
            start.push(lists.len() as u32);
        }
        let mut stiffness = vec![0.0; nodes];
        let mut members = Vec::with_capacity(lists.len());
        for range in start.windows(2) {
            let list = &lists[range[0] as usize..range[1] as usize];
            let share = |node: u32| stuff[node as usize] / f64::from(shared_by[node as usize]);
            let at = |node: u32| Vector3::from(mesh.points_m()[node as usize]);
            let all: f64 = list.iter().map(|node| share(*node)).sum();
            let weighted = list.iter().map(|node| share(*node) * at(*node));
            let centre = weighted.sum::<Vector3<f64>>() / all;
            let second = list
                .iter()
                .map(|node| share(*node) * (at(*node) - centre).norm_squared());
            let radius_sq = second.sum::<f64>() / (3.0 * all);
            for &node in list {
                let weight = share(node) / radius_sq;
                stiffness[node as usize] += weight;
                members.push(Member {
                    rest_m: (at(node) - centre).into(),
                    weight,
                    node,
                });
            }
        }
        Self {
            start,
            members,
            stiffness,
            volume,
            modulus_volume: stuff.iter().sum(),
            shared_by,
        }
    }

    /// Number of clusters.
    pub fn count(&self) -> usize {
        self.start.len() - 1
    }

    /// Members of each.
    pub fn iter(&self) -> impl Iterator<Item = &[Member]> {
        self.start
            .windows(2)
            .map(|range| &self.members[range[0] as usize..range[1] as usize])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Material;
    use sutura_mesh::slab;

    #[test]
    fn every_node_is_in_one_and_centres_are_at_the_origin() {
        let mesh = slab([0.02, 0.03, 0.02], [4, 6, 4]).expect("a slab");
        let fat = Material {
            youngs_modulus_pa: 3e3,
            poisson_ratio: 0.45,
        };
        for rings in 1..=4 {
            let clusters = Clusters::new(&mesh, &fat.into(), rings);
            assert!(clusters.shared_by.iter().all(|count| *count > 0));
            assert!((clusters.volume.iter().sum::<f64>() / 12e-6 - 1.0).abs() < 1e-12);
            assert!((clusters.modulus_volume / 36e-3 - 1.0).abs() < 1e-12);
            let mut members = 0;
            for cluster in clusters.iter() {
                let first = |axis: usize| {
                    let sum = cluster.iter().map(|m| m.weight * m.rest_m[axis]);
                    sum.sum::<f64>().abs()
                };
                let size: f64 = cluster.iter().map(|m| m.weight).sum();
                assert!((0..3).all(|axis| first(axis) < 1e-14 * size));
                members += cluster.len();
            }
            assert_eq!(members as u32, clusters.shared_by.iter().sum::<u32>());
            // More rings, fewer clusters: one for each node at first.
            if rings == 1 {
                assert_eq!(clusters.count(), mesh.points_m().len());
            } else {
                assert!(clusters.count() < mesh.points_m().len() / 2);
            }
        }
    }
}
