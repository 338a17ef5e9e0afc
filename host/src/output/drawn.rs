//! A scene at an instant, for files that other programs draw.
//!
//! Entry point: [`Drawn::of`].

use super::outline::outline;
use crate::model::Model;
use crate::needle::Needle;
use crate::scene::{self, Scene};
use crate::step::State;
use crate::thread::{FreeThreads, ThreadPlace, ThreadPoint};
use crate::tool::ToolSample;
use nalgebra::Isometry3;
use schemars::JsonSchema;
use serde::Serialize;

/// Distance between two points of a needle's centre line, in its length.
const NEEDLE_PIECES: u32 = 32;

/// The tissue and what is beside it.
#[derive(Clone, Debug, Default, Serialize, JsonSchema)]
pub struct Drawn {
    /// Node positions at rest without load \[m\], (n x 3), world frame.
    pub points_m: Vec<[f64; 3]>,
    /// Nodal displacement \[m\], (n x 3), world frame.
    pub displacement_m: Vec<[f64; 3]>,
    /// Whether a node does not move, (n); in the grid file only, as all below.
    #[serde(skip)]
    pub fixed: Vec<bool>,
    /// Nodes of each cell, (m x 4).
    #[serde(skip)]
    pub cells: Vec<[u32; 4]>,
    /// Region of each cell, (m).
    #[serde(skip)]
    pub regions: Vec<i64>,
    /// Principal stresses of each cell \[Pa\], descending, tension positive, (m x 3); (0 x 3) of models that say none.
    #[serde(skip)]
    pub principal_stress_pa: Vec<[f64; 3]>,
    /// Needles, threads and tools.
    #[serde(skip)]
    pub lines: Vec<Line>,
}

/// What a line is of; the number is that in files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// A needle's centre line, from its end to its tip.
    Needle = 1,
    /// A thread, from its tail to its head.
    Thread = 2,
    /// An outline of a tool's shape.
    Tool = 3,
}

/// A line of what is not tissue.
#[derive(Clone, Debug, PartialEq)]
pub struct Line {
    /// What it is of.
    pub part: Part,
    /// Id of the needle, thread or tool.
    pub id: u8,
    /// How far what is meant reaches around the line \[m\]; 0 for what lies on a surface.
    pub radius_m: f64,
    /// Where it is \[m\], (k x 3), world frame.
    pub points_m: Vec<[f64; 3]>,
    /// Of a thread: tension between each point and the next \[N\], (k); of others (0).
    pub tension_n: Vec<f64>,
}

impl Drawn {
    /// A scene with its nodes at `at_m` (n x 3), needles and threads in the tissue as its state has them, the latter as
    /// `free` has them where they hang, and tools where `samples` says. Allocates: for files, not for the loop.
    pub fn of(
        scene: &Scene,
        at_m: &[[f64; 3]],
        tissue: Option<(&Model, &State)>,
        free: Option<&FreeThreads>,
        samples: &[ToolSample],
    ) -> Self {
        let points_m = scene.mesh.points_m().to_vec();
        let ways = at_m.iter().zip(&points_m);
        let displacement_m: Vec<_> = ways
            .map(|(at, from)| std::array::from_fn(|axis| at[axis] - from[axis]))
            .collect();
        let mut fixed = vec![false; points_m.len()];
        for &node in &scene.fixed {
            fixed[node as usize] = true;
        }
        let mut regions = scene.mesh.regions().to_vec();
        regions.resize(scene.mesh.cells().len(), 0);
        let stress = |(model, _): (&Model, _)| model.principal_stress_pa(&displacement_m);
        Self {
            fixed,
            cells: scene.mesh.cells().to_vec(),
            regions,
            principal_stress_pa: tissue.map_or_else(Vec::new, stress),
            lines: Beside::of(scene).lines(at_m, tissue, free, samples),
            points_m,
            displacement_m,
        }
    }
}

/// Points of the centre line of a needle with its frame at `pose`, from its end to its tip \[m\].
pub(crate) fn centre_line(needle: &Needle, pose: &Isometry3<f64>) -> Vec<[f64; 3]> {
    let curve = needle.at(pose);
    let places = (0..=NEEDLE_PIECES).map(|k| f64::from(k) / f64::from(NEEDLE_PIECES));
    places
        .map(|share| curve.at(share * curve.length).into())
        .collect()
}

/// What of a scene is not tissue.
#[derive(Clone, Debug)]
pub(crate) struct Beside {
    needles: Vec<scene::Needle>,
    /// Their ids.
    threads: Vec<u8>,
    tools: Vec<scene::Tool>,
}

impl Beside {
    pub fn of(scene: &Scene) -> Self {
        Self {
            needles: scene.needles.clone(),
            threads: scene.threads.iter().map(|each| each.part.id).collect(),
            tools: scene.tools.clone(),
        }
    }

    /// Whether there is a needle.
    pub fn has_needles(&self) -> bool {
        !self.needles.is_empty()
    }

    /// Needles, threads and tools, in the scene's order, with nodes at `at_m` (n x 3) \[m\]; threads straight without `free`.
    pub fn lines(
        &self,
        at_m: &[[f64; 3]],
        tissue: Option<(&Model, &State)>,
        free: Option<&FreeThreads>,
        samples: &[ToolSample],
    ) -> Vec<Line> {
        let mut lines = Vec::new();
        if let Some((model, state)) = tissue {
            for needle in &self.needles {
                let pose = state.needle_pose(model, needle.id);
                let pose = pose.unwrap_or(needle.start);
                lines.push(Line {
                    part: Part::Needle,
                    id: needle.id,
                    radius_m: 0.5 * needle.needle.thickness_m,
                    points_m: centre_line(&needle.needle, &pose),
                    tension_n: Vec::new(),
                });
            }
            for &id in &self.threads {
                let straight = || state.thread_path(model, id, at_m);
                let path = free.map_or_else(straight, |free| free.path(id).to_vec());
                let is_end = |point: &ThreadPoint| point.what == ThreadPlace::Cut;
                for piece in path.split_inclusive(is_end).filter(|piece| piece.len() > 1) {
                    lines.push(Line {
                        part: Part::Thread,
                        id,
                        radius_m: 0.0,
                        points_m: piece.iter().map(|point| point.at_m).collect(),
                        tension_n: piece.iter().map(|point| point.tension_n).collect(),
                    });
                }
            }
        }
        for tool in &self.tools {
            let sample = samples.iter().find(|sample| sample.id == tool.id);
            let seen = tool.seen();
            let Some(placement) = sample.and_then(|sample| seen.place(sample)) else {
                continue;
            };
            let (radius_m, outlines) = outline(&seen);
            lines.extend(outlines.into_iter().map(|local| {
                Line {
                    part: Part::Tool,
                    id: tool.id,
                    radius_m,
                    points_m: local
                        .iter()
                        .map(|at| (placement.centre + placement.rotation * at).into())
                        .collect(),
                    tension_n: Vec::new(),
                }
            }));
        }
        lines
    }
}
