//! Compact half-face structure: who is next to whom in a tetrahedral mesh, in constant time each.
//!
//! Entry point: [`HalfFaces::new`]. Source: Younes 2021, section 2.1.3 and algorithms 2.1 to 2.5. The
//! thesis finds a vertex's cells by walking; here they are listed once, so that no query allocates.

use super::MeshError;
use super::boundary::Boundary;
use super::check::{self, Tags};
use super::half_face::{CORNERS, HalfEdge, HalfFace};
use super::manifold;
use serde::{Deserialize, Serialize};
use std::sync::OnceLock;

/// More cells than this and a half-face's number does not fit 32 bits.
const MOST_CELLS: usize = 1 << 30;

/// Connectivity of a tetrahedral mesh that is a manifold with boundary.
///
/// Level 0 is the cells, level 1 the opposite half-faces; both are always there. Level 2 (what touches a
/// vertex, the edges, the faces) and level 3 (the [`Boundary`]) are built when first asked for, each
/// part by itself, and kept. Numbers of vertices and cells that do not exist have nothing around them.
///
/// Serialised it is its vertex count and cells: the rest is a function of these, and building it anew
/// costs no more than checking that a file has it right.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(try_from = "Level0")]
pub struct HalfFaces {
    nodes: usize,
    cells: Vec<[u32; 4]>,
    #[serde(skip)]
    opposite: Vec<Option<HalfFace>>,
    #[serde(skip)]
    links: OnceLock<Rows<HalfFace>>,
    #[serde(skip)]
    incident: OnceLock<Vec<Option<HalfFace>>>,
    #[serde(skip)]
    edges: OnceLock<Rows<(u32, HalfEdge)>>,
    #[serde(skip)]
    faces: OnceLock<Vec<HalfFace>>,
    #[serde(skip)]
    boundary: OnceLock<Boundary>,
}

/// What a file holds.
#[derive(Deserialize)]
struct Level0 {
    nodes: usize,
    cells: Vec<[u32; 4]>,
}

impl TryFrom<Level0> for HalfFaces {
    type Error = MeshError;

    fn try_from(stored: Level0) -> Result<Self, MeshError> {
        Self::new(stored.nodes, stored.cells)
    }
}

/// Everything else follows from the cells.
impl PartialEq for HalfFaces {
    fn eq(&self, other: &Self) -> bool {
        self.nodes == other.nodes && self.cells == other.cells
    }
}

/// Lists of different lengths, one for each vertex.
#[derive(Clone, Debug)]
struct Rows<T> {
    start: Vec<usize>,
    values: Vec<T>,
}

impl<T: Copy> Rows<T> {
    /// Sorts `items` by their vertex; those of one vertex stay in their order.
    fn of(nodes: usize, items: impl Iterator<Item = (u32, T)> + Clone) -> Self {
        let mut start = vec![0; nodes + 1];
        for (node, _) in items.clone() {
            start[node as usize + 1] += 1;
        }
        for node in 0..nodes {
            start[node + 1] += start[node];
        }
        let mut place = start.clone();
        let mut values = Vec::new();
        if let Some((_, any)) = items.clone().next() {
            values.resize(start[nodes], any);
        }
        for (node, value) in items {
            values[place[node as usize]] = value;
            place[node as usize] += 1;
        }
        Self { start, values }
    }

    fn row(&self, node: u32) -> &[T] {
        let node = node as usize;
        match self.start.get(node..node.saturating_add(2)) {
            Some(&[from, to]) => &self.values[from..to],
            _ => &[],
        }
    }
}

impl HalfFaces {
    /// Levels 0 and 1 of `cells` on vertices 0 to `nodes` - 1, after a look at every face, edge and
    /// vertex. The vertices' positions play no part.
    ///
    /// # Errors
    /// No cells, too many, a cell with a vertex twice or one that does not exist; then cells that do not
    /// meet as in a manifold: [`MeshError::Duplicate`], [`MeshError::CrowdedFace`],
    /// [`MeshError::SameSide`], [`MeshError::SplitEdge`], [`MeshError::PinchedNode`].
    ///
    /// ```
    /// use sutura_mesh::HalfFaces;
    /// let mesh = HalfFaces::new(5, vec![[0, 1, 2, 3], [1, 2, 3, 4]])?;
    /// let shared = mesh.half_face(0, 0).expect("cell 0 is there");
    /// assert_eq!(mesh.vertices(shared), [1, 2, 3]);
    /// let beyond = mesh.opposite(shared).expect("cell 1 is behind it");
    /// assert_eq!((beyond.cell(), mesh.apex(beyond)), (1, 4));
    /// # Ok::<(), sutura_mesh::MeshError>(())
    /// ```
    pub fn new(nodes: usize, cells: Vec<[u32; 4]>) -> Result<Self, MeshError> {
        let tags = Tags::default();
        check::check_cells(nodes, &cells, &tags)?;
        Self::of_checked_cells(nodes, cells, &tags)
    }

    /// As [`HalfFaces::new`], for cells whose vertices have been looked at.
    pub(super) fn of_checked_cells(
        nodes: usize,
        cells: Vec<[u32; 4]>,
        tags: &Tags,
    ) -> Result<Self, MeshError> {
        if cells.len() > MOST_CELLS {
            return Err(MeshError::TooManyCells(cells.len()));
        }
        let opposite = manifold::match_faces(nodes, &cells, tags)?;
        let mesh = Self {
            nodes,
            cells,
            opposite,
            links: OnceLock::new(),
            incident: OnceLock::new(),
            edges: OnceLock::new(),
            faces: OnceLock::new(),
            boundary: OnceLock::new(),
        };
        manifold::check_edges(&mesh, tags)?;
        manifold::check_nodes(&mesh, tags)?;
        Ok(mesh)
    }

    /// How many vertices there are, n.
    pub fn nodes(&self) -> usize {
        self.nodes
    }

    /// Vertices of each cell, (m x 4).
    pub fn cells(&self) -> &[[u32; 4]] {
        &self.cells
    }

    /// Number of the connected body that each node belongs to, (n), in the order of their first cells, and how many there are: cells that share a
    /// node are of one.
    pub fn bodies(&self) -> (Vec<u32>, u32) {
        const NONE: u32 = u32::MAX;
        let mut body = vec![NONE; self.nodes()];
        let mut waiting = Vec::new();
        let mut count = 0;
        for &[first, ..] in self.cells() {
            if body[first as usize] != NONE {
                continue;
            }
            body[first as usize] = count;
            waiting.push(first);
            while let Some(node) = waiting.pop() {
                for cell in self.cells_of_vertex(node) {
                    for other in self.cells()[cell as usize] {
                        if body[other as usize] == NONE {
                            body[other as usize] = count;
                            waiting.push(other);
                        }
                    }
                }
            }
            count += 1;
        }
        (body, count)
    }

    /// The half-face opposite a corner, 0 to 3, of a cell.
    pub fn half_face(&self, cell: u32, corner: usize) -> Option<HalfFace> {
        let cell = cell as usize;
        (cell < self.cells.len() && corner < 4).then(|| HalfFace::of(cell, corner))
    }

    /// Every half-face, in the order of the cells, (4 m).
    pub fn half_faces(&self) -> impl DoubleEndedIterator<Item = HalfFace> + Clone + use<> {
        (0..4 * self.cells.len()).map(|index| HalfFace::of(index / 4, index))
    }

    /// The vertex of its cell that a half-face does not have.
    pub fn apex(&self, face: HalfFace) -> u32 {
        self.corner(face.cell(), face.corner())
    }

    /// Vertices of a half-face, counter-clockwise seen from outside its cell (table 2.1).
    pub fn vertices(&self, face: HalfFace) -> [u32; 3] {
        CORNERS[face.corner()].map(|corner| self.corner(face.cell(), corner))
    }

    /// Vertices that a half-edge starts from and ends in.
    pub fn edge_vertices(&self, edge: HalfEdge) -> [u32; 2] {
        edge.corners()
            .map(|corner| self.corner(edge.cell(), corner))
    }

    fn corner(&self, cell: u32, corner: usize) -> u32 {
        self.cells
            .get(cell as usize)
            .map_or(u32::MAX, |cell| cell[corner])
    }

    /// The same triangle seen from the cell on its other side (2.12); `None` on the boundary.
    pub fn opposite(&self, face: HalfFace) -> Option<HalfFace> {
        self.opposite.get(face.index()).copied().flatten()
    }

    /// The cells behind the four half-faces of a cell, by corner: r33.
    pub fn adjacent_cells(&self, cell: u32) -> [Option<u32>; 4] {
        [0, 1, 2, 3].map(|corner| {
            let face = self.half_face(cell, corner)?;
            self.opposite(face).map(HalfFace::cell)
        })
    }

    /// The same edge the other way on the other side of the half-face; `None` on the boundary.
    ///
    /// Equation 2.16 as printed takes the half-edge after the shared start, which lies on another edge;
    /// the one before it is meant.
    pub fn radial(&self, edge: HalfEdge) -> Option<HalfEdge> {
        let beyond = self.opposite(edge.face())?;
        let [_, end] = self.edge_vertices(edge);
        let mut sides = beyond.half_edges().into_iter();
        sides.find(|side| self.edge_vertices(*side)[0] == end)
    }

    /// Half-faces that see a vertex from the far side of its cells: its link (algorithm 2.3), one for
    /// each cell around it, ascending.
    pub fn link_of_vertex(&self, vertex: u32) -> &[HalfFace] {
        let links = self.links.get_or_init(|| {
            let by_apex = self.half_faces().map(|face| (self.apex(face), face));
            Rows::of(self.nodes, by_apex)
        });
        links.row(vertex)
    }

    /// Cells around a vertex, ascending: r03.
    pub fn cells_of_vertex(&self, vertex: u32) -> impl Iterator<Item = u32> + '_ {
        self.link_of_vertex(vertex).iter().map(|face| face.cell())
    }

    /// All half-faces of the cells around a vertex: its star (algorithm 2.1).
    pub fn star_of_vertex(&self, vertex: u32) -> impl Iterator<Item = HalfFace> + '_ {
        let link = self.link_of_vertex(vertex).iter();
        link.flat_map(|face| face.of_cell())
    }

    /// Half-faces that have a vertex: its open star.
    ///
    /// Algorithm 2.2 as printed keeps the half-faces *named* by another corner, which are these.
    pub fn open_star_of_vertex(&self, vertex: u32) -> impl Iterator<Item = HalfFace> + '_ {
        let link = self.link_of_vertex(vertex).iter();
        link.flat_map(|face| [face.next(), face.middle(), face.previous()])
    }

    /// A half-face that has the vertex; for a vertex on the boundary one on the boundary.
    pub fn half_face_of_vertex(&self, vertex: u32) -> Option<HalfFace> {
        let incident = self.incident.get_or_init(|| {
            let mut incident = vec![None; self.nodes];
            // Backwards, inner ones first: what stays is the first on the boundary, if there is one.
            for on_boundary in [false, true] {
                for face in self.half_faces().rev() {
                    if self.opposite(face).is_none() == on_boundary {
                        for vertex in self.vertices(face) {
                            incident[vertex as usize] = Some(face);
                        }
                    }
                }
            }
            incident
        });
        incident.get(vertex as usize).copied().flatten()
    }

    /// Whether a vertex lies on the boundary.
    pub fn is_boundary_vertex(&self, vertex: u32) -> bool {
        self.half_face_of_vertex(vertex)
            .is_some_and(|face| self.opposite(face).is_none())
    }

    /// One half-edge for each edge, ordered by smaller and larger vertex; for an edge on the boundary
    /// one on the boundary.
    pub fn edges(&self) -> impl ExactSizeIterator<Item = HalfEdge> + '_ {
        self.edge_rows().values.iter().map(|(_, edge)| *edge)
    }

    /// A half-edge between two vertices, in either direction; for an edge on the boundary one on the
    /// boundary.
    pub fn edge(&self, a: u32, b: u32) -> Option<HalfEdge> {
        let row = self.edge_rows().row(a.min(b));
        let place = row.binary_search_by_key(&a.max(b), |(end, _)| *end).ok()?;
        row.get(place).map(|(_, edge)| *edge)
    }

    fn edge_rows(&self) -> &Rows<(u32, HalfEdge)> {
        self.edges.get_or_init(|| {
            // Each edge of a cell lies in two half-faces; `mate` gives the other one.
            let of_cells = self.half_faces().flat_map(|face| {
                face.half_edges().into_iter().map(|edge| {
                    let [from, to] = self.edge_vertices(edge);
                    (from.min(to), (from.max(to), edge))
                })
            });
            let mut rows = Rows::of(self.nodes, of_cells);
            let mut kept = Vec::with_capacity(rows.values.len() / 10);
            let mut start = vec![0; self.nodes + 1];
            for node in 0..self.nodes {
                let row = &mut rows.values[rows.start[node]..rows.start[node + 1]];
                row.sort_unstable_by_key(|(end, edge)| {
                    (*end, self.opposite(edge.face()).is_some(), *edge)
                });
                for edge in row.chunk_by(|a, b| a.0 == b.0) {
                    kept.extend(edge.first());
                }
                start[node + 1] = kept.len();
            }
            Rows {
                start,
                values: kept,
            }
        })
    }

    /// Half-edges around an edge, each cell giving two, from `edge` on; across the whole fan.
    pub fn around_edge(&self, edge: HalfEdge) -> AroundEdge<'_> {
        AroundEdge {
            mesh: self,
            first: edge,
            next: Some(edge),
            crossed: false,
            reversed: false,
        }
    }

    /// Cells around an edge: r13.
    pub fn cells_of_edge(&self, edge: HalfEdge) -> impl Iterator<Item = u32> + '_ {
        self.around_edge(edge).step_by(2).map(HalfEdge::cell)
    }

    /// Half-faces that have an edge: its open star (algorithm 2.4).
    pub fn open_star_of_edge(&self, edge: HalfEdge) -> impl Iterator<Item = HalfFace> + '_ {
        self.around_edge(edge).map(HalfEdge::face)
    }

    /// Half-faces of the cells around an edge that do not have the edge: what lies around its open star
    /// (algorithm 2.5, "link of facets").
    pub fn link_of_edge(&self, edge: HalfEdge) -> impl Iterator<Item = HalfFace> + '_ {
        self.around_edge(edge).map(HalfEdge::across_start)
    }

    /// All half-faces of the cells around an edge: its star.
    pub fn star_of_edge(&self, edge: HalfEdge) -> impl Iterator<Item = HalfFace> + '_ {
        self.around_edge(edge)
            .step_by(2)
            .flat_map(|edge| edge.face().of_cell())
    }

    /// One half-face for each triangle of the mesh, ascending: the first of the two.
    pub fn faces(&self) -> &[HalfFace] {
        self.faces.get_or_init(|| {
            self.half_faces()
                .filter(|face| self.opposite(*face).is_none_or(|other| *face < other))
                .collect()
        })
    }

    /// The boundary as a compact half-edge structure.
    pub fn boundary(&self) -> &Boundary {
        self.boundary.get_or_init(|| Boundary::of(self))
    }
}

/// Half-edges around an edge; made by [`HalfFaces::around_edge`].
#[derive(Clone, Debug)]
pub struct AroundEdge<'a> {
    mesh: &'a HalfFaces,
    first: HalfEdge,
    next: Option<HalfEdge>,
    /// Whether the next step leaves the cell.
    crossed: bool,
    /// Whether the fan beyond `first` is being swept.
    reversed: bool,
}

impl Iterator for AroundEdge<'_> {
    type Item = HalfEdge;

    /// `EdgeSweep` of algorithm 2.4, one half-edge at a time. Where the sweep ends at the boundary, what
    /// lies on the other side of the first half-face is swept too; the thesis' test for there being
    /// something is added.
    fn next(&mut self) -> Option<HalfEdge> {
        let edge = self.next?;
        self.next = if self.crossed {
            match self.mesh.radial(edge) {
                Some(radial) if radial == self.first => None,
                Some(radial) => Some(radial),
                None if self.reversed => None,
                None => {
                    self.reversed = true;
                    self.mesh.radial(self.first)
                }
            }
        } else {
            Some(edge.mate())
        };
        self.crossed = !self.crossed;
        Some(edge)
    }
}
