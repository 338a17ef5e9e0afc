//! What the readers of all formats gather: nodes by the numbers of their file, tetrahedra of four or ten nodes.
//!
//! Entry points: [`Gather::node`], [`Gather::cell`], [`Gather::into_mesh`].

use super::super::check::Tags;
use super::super::{MeshError, Place, RawMesh};
use nalgebra::Vector3;
use std::collections::{BTreeMap, HashMap};

/// Corners of the edges of a tetrahedron.
const EDGES: [[usize; 2]; 6] = [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]];

/// Farther from the middle of its edge, in lengths of the edge, a node is no mid node.
const FARTHEST: f64 = 0.5;

/// Nearer, an edge counts as straight: coordinates with six digits.
const STRAIGHT: f64 = 1e-4;

/// A kind of cells of a file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Shape {
    Tetrahedron,
    /// With a node in the middle of each edge, in any order after the corners.
    Tetrahedron10,
    /// A point, line or face: it bounds a volume that others fill.
    Lower,
    /// Another that fills a volume.
    Other(&'static str),
}

/// How a file numbers its nodes.
#[derive(Debug)]
enum Numbering {
    /// One after another, from this number on.
    From(u64),
    /// As each says.
    Own(HashMap<u64, u32>),
}

/// What has been read so far. Cells hold the file's numbers until all nodes are known.
pub(super) struct Gather {
    numbering: Numbering,
    pub points: Vec<[f64; 3]>,
    tags: Tags,
    cells: Vec<[u64; 4]>,
    /// Mid nodes, with the cell.
    mids: Vec<(usize, [u64; 6])>,
    pub regions: Vec<i64>,
    pub region_names: BTreeMap<i64, String>,
    /// Points, lines and faces.
    pub left_out: usize,
    pub notes: Vec<String>,
}

impl Gather {
    fn new(numbering: Numbering) -> Self {
        Self {
            numbering,
            points: Vec::new(),
            tags: Tags::default(),
            cells: Vec::new(),
            mids: Vec::new(),
            regions: Vec::new(),
            region_names: BTreeMap::new(),
            left_out: 0,
            notes: Vec::new(),
        }
    }

    /// For files whose nodes have no numbers of their own.
    pub fn counted_from(first: u64) -> Self {
        Self::new(Numbering::From(first))
    }

    /// For files that give each node a number.
    pub fn numbered() -> Self {
        Self::new(Numbering::Own(HashMap::new()))
    }

    /// One more node.
    ///
    /// # Errors
    /// Its number is there already.
    pub fn node(&mut self, place: Place, tag: u64, at: [f64; 3]) -> Result<(), MeshError> {
        if let Numbering::Own(index_of) = &mut self.numbering {
            let count = self.points.len();
            let index = u32::try_from(count).map_err(|_| MeshError::TooManyNodes(count))?;
            if index_of.insert(tag, index).is_some() {
                return Err(MeshError::NodeTagTwice { at: place, tag });
            }
            self.tags.nodes.push(tag);
        }
        self.points.push(at);
        Ok(())
    }

    /// The index of a node of the cell that comes next.
    fn index(&self, number: u64, cell: usize) -> Result<u32, MeshError> {
        let index = match &self.numbering {
            Numbering::From(first) => number
                .checked_sub(*first)
                .filter(|index| *index < self.points.len() as u64)
                .and_then(|index| u32::try_from(index).ok()),
            Numbering::Own(index_of) => index_of.get(&number).copied(),
        };
        index.ok_or(MeshError::NoSuchNode {
            cell: self.tags.cell(cell),
            node: number,
            nodes: self.points.len(),
        })
    }

    /// One more cell, if it is a tetrahedron; `kind` is what the format calls it.
    ///
    /// # Errors
    /// It fills a volume and is none, or has not as many nodes as its kind.
    pub fn cell(
        &mut self,
        place: Place,
        tag: u64,
        (shape, kind): (Shape, &str),
        region: i64,
        nodes: &[u64],
    ) -> Result<(), MeshError> {
        let wanted = match shape {
            Shape::Tetrahedron => 4,
            Shape::Tetrahedron10 => 10,
            Shape::Lower => {
                self.left_out += 1;
                return Ok(());
            }
            Shape::Other(name) => {
                return Err(MeshError::NoTetrahedron {
                    at: place,
                    tag,
                    kind: kind.into(),
                    name,
                });
            }
        };
        let (Some(&corners), true) = (nodes.first_chunk(), nodes.len() == wanted) else {
            return Err(MeshError::Syntax {
                at: place,
                expected: format!("{wanted} nodes of cell {tag}, a tetrahedron"),
                found: format!("{} nodes", nodes.len()),
            });
        };
        if let Some(mids) = nodes.get(4..).and_then(<[u64]>::first_chunk) {
            self.mids.push((self.cells.len(), *mids));
        }
        self.cells.push(corners);
        self.regions.push(region);
        self.tags.cells.push(tag);
        Ok(())
    }

    /// How many tetrahedra there are.
    pub fn cells(&self) -> usize {
        self.cells.len()
    }

    /// The mesh, without its mid nodes.
    ///
    /// # Errors
    /// A cell names a node that does not exist, or a mid node lies elsewhere.
    pub fn into_mesh(mut self) -> Result<RawMesh, MeshError> {
        let mut cells = Vec::with_capacity(self.cells.len());
        for (index, cell) in self.cells.iter().enumerate() {
            let mut nodes = [0; 4];
            for (node, number) in nodes.iter_mut().zip(cell) {
                *node = self.index(*number, index)?;
            }
            cells.push(nodes);
        }
        if self.left_out > 0 {
            let note = format!("{} points, lines and faces are left out", self.left_out);
            self.notes.push(note);
        }
        self.drop_mid_nodes(&mut cells)?;
        Ok(RawMesh {
            points_m: self.points,
            cells,
            regions: self.regions,
            region_names: self.region_names,
            notes: self.notes,
            tags: self.tags,
        })
    }

    /// Takes nodes out that are in the middle of edges only.
    fn drop_mid_nodes(&mut self, cells: &mut [[u32; 4]]) -> Result<(), MeshError> {
        if self.mids.is_empty() {
            return Ok(());
        }
        let mut is_mid = vec![false; self.points.len()];
        let (mut curved, mut farthest) = (0, 0.0f64);
        for (cell, mids) in &self.mids {
            let mut nodes = [0; 6];
            for (node, number) in nodes.iter_mut().zip(mids) {
                *node = self.index(*number, *cell)?;
                is_mid[*node as usize] = true;
            }
            let beside = self.farthest_beside(*cell, cells[*cell], nodes)?;
            curved += usize::from(beside > STRAIGHT);
            farthest = farthest.max(beside);
        }
        for node in cells.iter().flatten() {
            is_mid[*node as usize] = false;
        }
        let dropped = is_mid.iter().filter(|mid| **mid).count();
        let shape = match curved {
            0 => "every edge is straight".to_owned(),
            _ => format!(
                "{curved} cells have curved edges, which become straight: nodes lie up to {:.1} % of an edge beside its middle",
                100.0 * farthest
            ),
        };
        let of = self.mids.len();
        self.notes.push(format!(
            "{of} cells of 10 nodes are taken as cells of 4: {dropped} nodes in the middle of edges are dropped; {shape}"
        ));
        keep_nodes(
            |node| !is_mid[node],
            &mut self.points,
            &mut self.tags.nodes,
            cells,
        );
        Ok(())
    }

    /// How far the mid nodes of a cell lie from the middles of its edges at most, in lengths of the edge.
    fn farthest_beside(
        &self,
        cell: usize,
        corners: [u32; 4],
        mids: [u32; 6],
    ) -> Result<f64, MeshError> {
        let at = |node: u32| Vector3::from(self.points[node as usize]);
        let (mut taken, mut farthest) = ([false; 6], 0.0f64);
        for [a, b] in EDGES {
            let [a, b] = [corners[a], corners[b]];
            let (middle, length) = ((at(a) + at(b)) / 2.0, (at(a) - at(b)).norm());
            let far = |mid: usize| (at(mids[mid]) - middle).norm();
            // The order of mid nodes differs from format to format: an edge has the nearest.
            let nearest = (0..6)
                .min_by(|a, b| far(*a).total_cmp(&far(*b)))
                .unwrap_or(0);
            let beside = far(nearest) / length;
            // Not a number where nodes coincide.
            let is_far = beside.is_nan() || beside > FARTHEST;
            if std::mem::replace(&mut taken[nearest], true) || is_far {
                return Err(MeshError::MidNode {
                    cell: self.tags.cell(cell),
                    from: self.tags.node(a as usize),
                    to: self.tags.node(b as usize),
                });
            }
            farthest = farthest.max(beside);
        }
        Ok(farthest)
    }
}

/// Keeps some nodes, with their numbers, and counts those of the cells anew.
pub(crate) fn keep_nodes(
    keep: impl Fn(usize) -> bool,
    points: &mut Vec<[f64; 3]>,
    tags: &mut Vec<u64>,
    cells: &mut [[u32; 4]],
) {
    let mut kept = 0;
    let new: Vec<u32> = (0..points.len())
        .map(|node| {
            let index = kept;
            kept += u32::from(keep(node));
            index
        })
        .collect();
    let mut each = (0..).map(&keep);
    points.retain(|_| each.next() == Some(true));
    let mut each = (0..).map(&keep);
    tags.retain(|_| each.next() == Some(true));
    for node in cells.iter_mut().flatten() {
        *node = new.get(*node as usize).copied().unwrap_or(u32::MAX);
    }
}
