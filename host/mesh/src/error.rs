//! What can be wrong with a mesh. Each message names the node or cell by index and, where a file
//! gave one, by tag.

use std::fmt;
use thiserror::Error;

/// A cell in a message: 0-based index and the file's tag.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CellId {
    /// 0-based index among the tetrahedra.
    pub index: usize,
    /// Number of the element in the file.
    pub tag: Option<u64>,
}

/// A node in a message: 0-based index and the file's tag.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NodeId {
    /// 0-based index.
    pub index: usize,
    /// Number of the node in the file.
    pub tag: Option<u64>,
}

impl fmt::Display for CellId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.tag {
            Some(tag) => write!(f, "element {tag} (index {})", self.index),
            None => write!(f, "cell {}", self.index),
        }
    }
}

impl fmt::Display for NodeId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.tag {
            Some(tag) => write!(f, "node {tag} (index {})", self.index),
            None => write!(f, "node {}", self.index),
        }
    }
}

/// Where in a file something is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// In a line, from 1.
    Line(usize),
    /// After so many bytes.
    Byte(usize),
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Place::Line(line) => write!(f, "line {line}"),
            Place::Byte(byte) => write!(f, "byte {byte}"),
        }
    }
}

/// Why a mesh is refused.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum MeshError {
    /// The file is not what the format says at this place.
    #[error("{at}: expected {expected}, found {found}")]
    Syntax {
        /// Where.
        at: Place,
        /// What the format asks for here.
        expected: String,
        /// What stands there.
        found: String,
    },
    /// The file ends inside a section.
    #[error("{at}: the file ends while {expected} was expected; is it cut off?")]
    Truncated {
        /// Where.
        at: Place,
        /// What the format asks for here.
        expected: String,
    },
    /// A binary file of another size than its count of triangles takes.
    #[error(
        "it says that it has {count} triangles, which take {size} bytes, and has {found} bytes: is it cut off, or is something put to its end?"
    )]
    WrongSize {
        /// Triangles, as it says.
        count: u32,
        /// What these take.
        size: u64,
        /// What there is.
        found: u64,
    },
    /// What is wrong in one of the files that make a mesh together.
    #[error("{file}: {error}")]
    InFile {
        /// The file, or its extension.
        file: String,
        /// What is wrong there.
        error: Box<MeshError>,
    },
    /// A file that cannot be read, or is not text.
    #[error("cannot read {file}: {reason}")]
    Unreadable {
        /// The file.
        file: String,
        /// What the system says.
        reason: String,
    },
    /// A file of a kind that is not read.
    #[error(
        "{0} is no mesh file that is read here; these are: .msh, .node with .ele, .vtk, .vtu, .mesh, .inp"
    )]
    Extension(String),
    /// A file of a kind that is not read as a surface.
    #[error("{0} is no surface that is read here; these are: .stl, .obj, .ply")]
    NoSurface(String),
    /// A version or encoding that is not read.
    #[error("{at}: {found} is not read; save it as gmsh 4.1 or 2.2: gmsh -save -format msh41 FILE")]
    Version {
        /// Where.
        at: Place,
        /// What the file says it is.
        found: String,
    },
    /// A cell array that the user names is not there.
    #[error("the file has no cell array `{name}`; {known}")]
    NoCellArray {
        /// Its name.
        name: String,
        /// Those that there are, in words.
        known: String,
    },
    /// Arrays that are packed, and too large when they are unpacked.
    #[error(
        "{at}: the packed arrays take more than {most} bytes, which are 100 times the file and 64 MiB: is it damaged? Else save it without compression"
    )]
    Unpacked {
        /// The array with which they are too many.
        at: Place,
        /// Largest number of bytes that are read, 8 for each number.
        most: u64,
    },
    /// A section that must be there is not.
    #[error("the file has no {0}; is it cut off, or a file of another kind?")]
    NoSection(&'static str),
    /// A section that may be there once is there again.
    #[error("{at}: a second {section}")]
    SecondSection {
        /// Where.
        at: Place,
        /// Name of the section.
        section: &'static str,
    },
    /// Cells that fill a volume and are no tetrahedra.
    #[error(
        "{at}: element {tag} has type {kind} ({name}); only tetrahedra of 4 or 10 nodes fill a volume here: mesh again without recombination, at most of second order"
    )]
    NoTetrahedron {
        /// Where.
        at: Place,
        /// The cell's number in the file.
        tag: u64,
        /// The type as the file says it.
        kind: String,
        /// The type's name.
        name: &'static str,
    },
    /// A node of a ten-node tetrahedron that is nowhere near the middle of an edge.
    #[error(
        "{cell} has 10 nodes, none of which of its own lies near the middle of the edge from {from} to {to}: mesh again with order 1"
    )]
    MidNode {
        /// The cell.
        cell: CellId,
        /// An end of the edge.
        from: NodeId,
        /// The other.
        to: NodeId,
    },
    /// Two nodes carry one tag.
    #[error("{at}: node {tag} is given twice")]
    NodeTagTwice {
        /// Where.
        at: Place,
        /// The tag.
        tag: u64,
    },
    /// A cell names a node that does not exist.
    #[error("{cell} names node {node}, which does not exist ({nodes} nodes)")]
    NoSuchNode {
        /// The cell.
        cell: CellId,
        /// The node's number as it stands in the cell.
        node: u64,
        /// How many nodes there are.
        nodes: usize,
    },
    /// No tetrahedra at all.
    #[error("the mesh has no tetrahedra; a surface mesh has to be filled first: gmsh -3 FILE")]
    NoCells,
    /// More nodes than an index can count.
    #[error("the mesh has {0} nodes; at most 1,000,000,000 can be indexed")]
    TooManyNodes(usize),
    /// More cells than an index can count.
    #[error("the mesh has {0} cells; at most 1,073,741,824 can be indexed")]
    TooManyCells(usize),
    /// A coordinate is infinite or not a number.
    #[error("{node} is at {at:?}, which is not finite")]
    NotFinite {
        /// The node.
        node: NodeId,
        /// Its coordinates.
        at: [f64; 3],
    },
    /// The scale from the file's unit to metres is not a positive number.
    #[error("the scale to metres is {0}; it must be finite and above zero")]
    Scale(f64),
    /// A cell with one node twice.
    #[error("{cell} has {node} twice")]
    NodeTwice {
        /// The cell.
        cell: CellId,
        /// The node.
        node: NodeId,
    },
    /// A cell turned inside out.
    #[error(
        "{cell} is inverted: its volume is {volume_m3:.3e} m^3; swap two of its nodes, or mesh again"
    )]
    Inverted {
        /// The cell.
        cell: CellId,
        /// Signed volume \[m^3\].
        volume_m3: f64,
    },
    /// A cell without volume.
    #[error(
        "{cell} is flat: its volume is {volume_m3:.3e} m^3 with edges up to {edge_m:.3e} m; mesh again with -optimize"
    )]
    Degenerate {
        /// The cell.
        cell: CellId,
        /// Signed volume \[m^3\].
        volume_m3: f64,
        /// Longest edge \[m\].
        edge_m: f64,
    },
    /// Two cells on the same four nodes.
    #[error("{second} has the same nodes as {first}")]
    Duplicate {
        /// The first of them.
        first: CellId,
        /// The second.
        second: CellId,
    },
    /// Three cells on one face.
    #[error("{first}, {second} and {third} share one face; a face joins at most two cells")]
    CrowdedFace {
        /// A cell on the face.
        first: CellId,
        /// Another.
        second: CellId,
        /// One too many.
        third: CellId,
    },
    /// Two cells on one side of a face.
    #[error(
        "{first} and {second} lie on the same side of the face that they share: they overlap, or one of them is inside out"
    )]
    SameSide {
        /// One of them.
        first: CellId,
        /// The other.
        second: CellId,
    },
    /// Cells around an edge that do not hang together by faces.
    #[error(
        "{first} and {second} meet in the edge from {from} to {to} and no faces join them around it: join them by a face, or give each an edge of its own"
    )]
    SplitEdge {
        /// The edge's smaller end.
        from: NodeId,
        /// Its larger end.
        to: NodeId,
        /// A cell of one fan.
        first: CellId,
        /// A cell of another.
        second: CellId,
    },
    /// A node at which the mesh touches itself.
    #[error(
        "the mesh touches itself at {node}, between {first} and {second}: join its parts by faces there, or give each a node of its own"
    )]
    PinchedNode {
        /// The node.
        node: NodeId,
        /// A cell at it.
        first: CellId,
        /// A cell that no faces join to it there, or the same where the boundary alone touches itself.
        second: CellId,
    },
    /// A node that no cell uses.
    #[error(
        "{node} belongs to no tetrahedron (of {count} such nodes the first): delete it, or save only volume elements"
    )]
    Unreferenced {
        /// The first such node.
        node: NodeId,
        /// How many there are.
        count: usize,
    },
    /// A tube with lengths or a number of divisions that make none.
    #[error(
        "a tube of radii {radii_m:?} m between {heights_m:?} m in {divisions:?} divisions is not possible: radii must be above zero and both pairs ascend, divisions be at least [1, 3, 1] and together at most 10,000,000 cubes"
    )]
    Tube {
        /// Wanted inner and outer radius \[m\].
        radii_m: [f64; 2],
        /// Wanted heights \[m\].
        heights_m: [f64; 2],
        /// Wanted divisions.
        divisions: [usize; 3],
    },
    /// A slab with a size or a number of divisions that makes no cells.
    #[error(
        "a slab of {size_m:?} m in {divisions:?} divisions is not possible: sizes must be finite and above zero, divisions at least 1 and together at most 10,000,000 cubes"
    )]
    Slab {
        /// Wanted size \[m\].
        size_m: [f64; 3],
        /// Wanted divisions.
        divisions: [usize; 3],
    },
}
