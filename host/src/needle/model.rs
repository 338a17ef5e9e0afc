//! What is constant about a scene's needles.
//!
//! Entry point: [`Needles::new`].

use super::rest::Rest;
use super::{Geometry, Hierarchy, History, Needle, NeedleTissue, Slack, entry};
use crate::anchors::AnchorSettings;
use crate::collide::Touching;
use crate::mesh::{HalfFaces, TetMesh};
use crate::source::Handles;
use crate::source::tool::TouchingTools;
use crate::thread::{MOST_SEGMENTS, Threads};
use crate::tool::Tool;
use nalgebra::{Isometry3, Vector3};
use thiserror::Error;

/// Most needles in one model.
pub const MAX_NEEDLES: usize = 4;

/// Least distance between crossings with rows, in mean boundary edges.
const APART: f64 = 0.15;

/// A needle of a model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NeedlePart {
    /// Names it.
    pub id: u8,
    /// Its shape.
    pub needle: Needle,
    /// Where its frame is before the first step: outside the tissue.
    pub start: Isometry3<f64>,
}

/// How a needle's way since the first contact is followed once its tip has broken through.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Playback {
    /// The tip's path through the tissue as it is without the tip's force, and one solve at its end.
    #[default]
    OneSolve,
    /// A solve at each of up to 16 poses.
    EveryPose,
}

/// What needles may use.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NeedleSettings {
    /// What follows a puncture.
    pub playback: Playback,
    /// Most faces that one needle can go through.
    pub most_crossings: usize,
    /// Vertices whose columns one step may compute before it waits.
    pub vertices_per_step: usize,
    /// Memory for columns \[bytes\].
    pub memory_bytes: usize,
}

impl Default for NeedleSettings {
    /// 48 crossings are ten tube walls; 64 vertices are all that a few new ones, or a refactorisation, ask for.
    fn default() -> Self {
        Self {
            playback: Playback::OneSolve,
            most_crossings: 48,
            vertices_per_step: 64,
            memory_bytes: 512 << 20,
        }
    }
}

/// Why needles cannot be used.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum NeedleError {
    /// A needle without a sound shape or pose.
    #[error("needle {id}: {flaw}")]
    Flaw {
        /// Which needle.
        id: u8,
        /// What is wrong with it.
        flaw: String,
    },
    /// A needle that is in tissue before the first step.
    #[error("needle {id} starts in the tissue; start it outside, it gets in by its tip")]
    Inside {
        /// Which needle.
        id: u8,
    },
    /// One id for two needles.
    #[error("two needles have the id {0}")]
    SameNeedle(u8),
    /// More needles than a step has room for.
    #[error("{0} needles; at most {MAX_NEEDLES} are possible")]
    TooMany(usize),
    /// Properties for another number of cells.
    #[error("needle properties for {given} cells; the mesh has {cells}")]
    Cells {
        /// How many there are.
        given: usize,
        /// How many there should be.
        cells: usize,
    },
    /// A property that is below zero or not a number.
    #[error("{what} is {value}; it must be zero or above{}", if *.what == "puncture_pa" { "" } else { " and finite" })]
    Property {
        /// Its name.
        what: &'static str,
        /// Its value.
        value: f64,
    },
    /// A setting out of range.
    #[error("`{what}` is {value}; it must be at least {least}")]
    Setting {
        /// Its name.
        what: &'static str,
        /// Its value.
        value: usize,
        /// The least possible.
        least: usize,
    },
}

/// Needles and how tissue answers them.
#[derive(Debug)]
pub(crate) struct Needles {
    pub parts: Vec<NeedlePart>,
    pub settings: NeedleSettings,
    pub mesh: HalfFaces,
    pub hierarchy: Hierarchy,
    pub threads: Threads,
    /// Tools that touch.
    pub tools: TouchingTools,
    /// Bodies of tissue that may touch, if there are any.
    pub touching: Option<Touching>,
    /// Points of tissue that are held.
    pub handles: Handles,
    /// What evolves, before the first step, where tissues touch already.
    pub rest: Option<Box<Rest>>,
    /// Displacement under the loads alone, where the hierarchy is \[m\], (n x 3).
    pub resting: Vec<[f64; 3]>,
    /// Where nodes rest under the loads \[m\], (n).
    pub resting_m: Vec<Vector3<f64>>,
    /// Kinds of tissue, and each cell's among them, (m).
    kinds: Vec<NeedleTissue>,
    kind_of_cell: Vec<u32>,
    /// Least distance between crossings that both have rows \[m\]: at vertices and edges they coincide, and what
    /// is nearer than this says the same thing twice, with large forces against each other.
    pub apart_m: f64,
    /// Longest piece of a needle's way between two solves \[m\].
    pub piece_m: f64,
}

impl Needles {
    /// For `mesh`, whose nodes rest at `resting_m`; `tissue` by cell, or nothing where there are no needles.
    pub fn new(
        parts: &[NeedlePart],
        tissue: &[NeedleTissue],
        settings: NeedleSettings,
        mesh: &TetMesh,
        resting_m: &[[f64; 3]],
    ) -> Result<Self, NeedleError> {
        if parts.len() > MAX_NEEDLES {
            return Err(NeedleError::TooMany(parts.len()));
        }
        for (index, part) in parts.iter().enumerate() {
            let coords = part.start.to_homogeneous();
            let flaw = part.needle.flaw().or_else(|| {
                let finite = coords.iter().all(|x| x.is_finite());
                (!finite).then(|| "its start is not finite".to_owned())
            });
            if let Some(flaw) = flaw {
                let id = part.id;
                return Err(NeedleError::Flaw { id, flaw });
            }
            if parts[..index].iter().any(|other| other.id == part.id) {
                return Err(NeedleError::SameNeedle(part.id));
            }
        }
        let (given, cells) = (tissue.len(), mesh.cells().len());
        if given != cells && !(parts.is_empty() && given == 0) {
            return Err(NeedleError::Cells { given, cells });
        }
        for (what, value) in [
            ("most_crossings", settings.most_crossings),
            ("vertices_per_step", settings.vertices_per_step),
        ] {
            let least = 1;
            if value < least {
                return Err(NeedleError::Setting { what, value, least });
            }
        }
        let mut kinds: Vec<NeedleTissue> = Vec::new();
        let mut kind_of_cell = Vec::with_capacity(cells);
        for of_cell in tissue {
            let known = kinds.iter().position(|kind| kind == of_cell);
            if known.is_none() {
                check(of_cell)?;
                kinds.push(*of_cell);
            }
            kind_of_cell.push(known.unwrap_or(kinds.len() - 1) as u32);
        }
        let half_faces = mesh.half_faces().clone();
        let hierarchy = Hierarchy::new(&half_faces, |node| {
            resting_m
                .get(node as usize)
                .map_or_else(Vector3::zeros, |at| Vector3::from(*at))
        });
        let needles = Self {
            parts: parts.to_vec(),
            settings,
            mesh: half_faces,
            hierarchy,
            threads: Threads::none(),
            tools: TouchingTools::none(),
            touching: None,
            handles: Handles::default(),
            rest: None,
            resting_m: resting_m.iter().map(|at| Vector3::from(*at)).collect(),
            resting: resting_m
                .iter()
                .zip(mesh.points_m())
                .map(|(at, from)| [at[0] - from[0], at[1] - from[1], at[2] - from[2]])
                .collect(),
            kinds,
            kind_of_cell,
            apart_m: APART * mesh.surface().mean_edge_m,
            piece_m: 0.25 * mesh.surface().mean_edge_m,
        };
        needles.start_outside(&needles.resting_m)?;
        Ok(needles)
    }

    /// Looks whether the needles start outside tissue whose nodes are `at_m` \[m\], (n x 3).
    ///
    /// # Errors
    /// The first one that does not.
    pub fn start_outside(&self, at_m: &[Vector3<f64>]) -> Result<(), NeedleError> {
        let at = |node: u32| at_m.get(node as usize).copied().unwrap_or_default();
        let ways = at_m.iter().zip(&self.resting_m);
        let moved_m = ways.fold(0.0f64, |most, (at, from)| most.max((at - from).norm()));
        let geometry = Geometry {
            mesh: &self.mesh,
            hierarchy: &self.hierarchy,
            slack: Slack::Everywhere(moved_m),
            at,
        };
        for part in &self.parts {
            let curve = part.needle.at(&part.start);
            let found = entry(&geometry, &curve, &History::new(0), 0.0, curve.length);
            let inside = |cell: &[u32; 4]| contains(&cell.map(at), &curve.start);
            if found.crossing.is_some() || self.mesh.cells().iter().any(inside) {
                return Err(NeedleError::Inside { id: part.id });
            }
        }
        Ok(())
    }

    /// Adds tools that touch the boundary nodes `nodes`, which are `at_rest` (b) \[m\] with outward normals (b); none is
    /// thinner than `least_m`.
    pub fn with_tools(
        mut self,
        tools: &[(u8, Tool)],
        least_m: f64,
        nodes: &[u32],
        at_rest: (&[Vector3<f64>], &[Vector3<f64>]),
    ) -> Self {
        let mut group_of = vec![0; self.mesh.nodes()];
        for (group, face) in self.hierarchy.grouped_faces() {
            for node in self.mesh.vertices(face) {
                group_of[node as usize] = group as u32;
            }
        }
        let group = nodes.iter().map(|node| group_of[*node as usize]).collect();
        self.tools = TouchingTools::new(tools, least_m, nodes, at_rest, group);
        self
    }

    /// Whether rows may act inside the tissue: not by tools alone.
    pub fn reach_inside(&self) -> bool {
        let tools_only = self.parts.is_empty() && self.handles.count() == 0;
        !tools_only || self.touching.is_some() || !self.threads.parts.is_empty()
    }

    /// Whether forces follow from an energy alone: there are but tools without friction.
    pub fn are_conservative(&self) -> bool {
        self.tools.are_smooth() && !self.reach_inside()
    }

    /// How a cell answers needles.
    pub fn tissue(&self, cell: u32) -> &NeedleTissue {
        const NONE: NeedleTissue = NeedleTissue {
            friction_n_per_m: 0.0,
            static_friction_n_per_m: 0.0,
            viscous_n_s_per_m2: 0.0,
            cutting_pa: 0.0,
            puncture_pa: 0.0,
        };
        let kind = self.kind_of_cell.get(cell as usize);
        kind.map_or(&NONE, |kind| &self.kinds[*kind as usize])
    }

    /// What rows of these needles need at most: at each crossing three, and at each tip.
    pub fn anchor_settings(&self) -> AnchorSettings {
        let of_needles = self.parts.len() * (self.settings.most_crossings + 1);
        let threads = self.threads.parts.len();
        let touching = self.touching.as_ref();
        let (pairs, rows) = touching.map_or((0, 0), |own| (own.most_pairs(), own.most_rows()));
        let contacts = self.tools.most_contacts();
        let points = contacts + self.handles.count();
        let most_anchors = of_needles + threads * MOST_SEGMENTS + pairs + points;
        let rubbing = self.threads.parts.iter().any(|part| part.friction > 0.0);
        // A row for every span, and of all that lies beyond it.
        let most_terms = threads * MOST_SEGMENTS * if rubbing { MOST_SEGMENTS } else { 3 };
        AnchorSettings {
            most_rows: 3 * (most_anchors - pairs) + rows,
            most_anchors,
            most_spread: threads * 2 * MOST_SEGMENTS,
            most_terms,
            vertices_per_step: self.settings.vertices_per_step,
            memory_bytes: self.settings.memory_bytes,
            ..AnchorSettings::default()
        }
    }
}

/// Whether a point lies in a cell, which has its corners in the mesh's order.
pub(super) fn contains(corners: &[Vector3<f64>; 4], at: &Vector3<f64>) -> bool {
    let volume = |[a, b, c, d]: [Vector3<f64>; 4]| (b - a).cross(&(c - a)).dot(&(d - a));
    let whole = volume(*corners);
    (0..4).all(|corner| {
        let mut part = *corners;
        part[corner] = *at;
        volume(part) * whole > 0.0
    })
}

fn check(tissue: &NeedleTissue) -> Result<(), NeedleError> {
    let NeedleTissue {
        friction_n_per_m,
        static_friction_n_per_m,
        viscous_n_s_per_m2,
        cutting_pa,
        puncture_pa,
    } = *tissue;
    for (what, value) in [
        ("friction_n_per_m", friction_n_per_m),
        ("static_friction_n_per_m", static_friction_n_per_m),
        ("viscous_n_s_per_m2", viscous_n_s_per_m2),
        ("cutting_pa", cutting_pa),
        ("puncture_pa", puncture_pa),
    ] {
        let endless = value.is_infinite() && what != "puncture_pa";
        if value.is_nan() || value < 0.0 || endless {
            return Err(NeedleError::Property { what, value });
        }
    }
    Ok(())
}
