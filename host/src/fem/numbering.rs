//! Which nodes can move: free nodes are counted first, fixed ones after them.
//!
//! Entry point: [`Numbering::new`]. A field in this order starts with the vector of unknowns.

use super::error::TissueError;

/// Places of nodes in a field that has free nodes first.
#[derive(Clone, Debug)]
pub(crate) struct Numbering {
    /// Place of each node, (n).
    place: Vec<u32>,
    /// Free nodes: the places below this.
    free: u32,
}

impl Numbering {
    /// Numbers `nodes` nodes of which `fixed` are held.
    pub fn new(nodes: usize, fixed: &[u32]) -> Result<Self, TissueError> {
        let mut is_fixed = vec![false; nodes];
        for &node in fixed {
            *is_fixed
                .get_mut(node as usize)
                .ok_or(TissueError::NoSuchNode {
                    what: "the list of fixed nodes",
                    node,
                    nodes,
                })? = true;
        }
        let free = is_fixed.iter().filter(|fixed| !**fixed).count() as u32;
        if free == 0 {
            return Err(TissueError::AllFixed(nodes));
        }
        let mut next = [0, free];
        let place = is_fixed
            .into_iter()
            .map(|fixed| {
                let place = next[usize::from(fixed)];
                next[usize::from(fixed)] += 1;
                place
            })
            .collect();
        Ok(Self { place, free })
    }

    /// Number of nodes, fixed ones included.
    pub fn nodes(&self) -> usize {
        self.place.len()
    }

    /// Number of fixed nodes.
    pub fn fixed(&self) -> usize {
        self.nodes() - self.free as usize
    }

    /// Number of scalar unknowns: three per free node.
    pub fn unknowns(&self) -> usize {
        3 * self.free as usize
    }

    /// Number of free nodes.
    pub fn free(&self) -> u32 {
        self.free
    }

    /// Whether a node is held.
    pub fn is_fixed(&self, node: u32) -> bool {
        self.place[node as usize] >= self.free
    }

    /// A node's place among all nodes, free ones first.
    pub fn place(&self, node: u32) -> u32 {
        self.place[node as usize]
    }

    /// The node at a place; a search through all of them.
    pub fn node_at(&self, place: u32) -> Option<u32> {
        let node = self.place.iter().position(|other| *other == place)?;
        Some(node as u32)
    }

    /// Index of a node's first unknown; `None` for a fixed node.
    pub fn first_unknown(&self, node: u32) -> Option<usize> {
        let place = self.place[node as usize];
        (place < self.free).then_some(3 * place as usize)
    }

    /// A node's value in a vector of unknowns; zero for a fixed node.
    pub fn at_node(&self, u: &[f64], node: u32) -> [f64; 3] {
        match self.first_unknown(node) {
            Some(first) => [u[first], u[first + 1], u[first + 2]],
            None => [0.0; 3],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn free_nodes_come_first_and_in_order() {
        let numbering = Numbering::new(5, &[3, 0, 3]).expect("numbered");
        let places: Vec<u32> = (0..5).map(|node| numbering.place(node)).collect();
        assert_eq!(places, [3, 0, 1, 4, 2]);
        assert_eq!((numbering.fixed(), numbering.unknowns()), (2, 9));
        assert_eq!(numbering.first_unknown(4), Some(6));
        assert_eq!(numbering.first_unknown(3), None);
        assert_eq!(
            numbering.at_node(&[0.0, 0.0, 0.0, 1.0, 2.0, 3.0], 2),
            [1.0, 2.0, 3.0]
        );
    }
}
