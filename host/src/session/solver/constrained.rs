//! Tissue with constraints, whose step is [`step`](crate::step::step).
//!
//! Entry points: [`Constrained::new`], [`Constrained::step`].

use super::super::SolveError;
use crate::contact::shape::Solid;
use crate::fem::TissueError;
use crate::model::Model;
use crate::scene::{Pose, Scene, SceneError};
use crate::script::{Fall, Path, at_rest, gap_at_rest, outside};
use crate::source::tool::MOST_CONTACTS;
use crate::step::{State, Status, StepOptions, StepReport, Workspace, step, try_step};
use crate::tool::{Tool, ToolSample};
use crate::work;
use crate::wound::{Overlap, Wound};
use nalgebra::Vector3;
use std::sync::Arc;

/// Most steps that follow a tool to its pose; a step moves it by a good part of its radius.
pub(crate) const MOST_STEPS: usize = 10_000;
/// Out-of-balance force on corotational tissue over the forces that act on it: below what files show.
pub(crate) const IN_BALANCE: f64 = 1e-9;
/// Passes with the tools at their places: a stale factor leaves about a tenth in each.
pub(crate) const MOST_PASSES: u32 = 300;

/// Initial distance of bodies that press on each other, in radii of the thickest.
const APART_RADII: f64 = 4.0;
/// How far from the tool vertices are prepared, in radii: as far as a step looks ahead.
const PREPARED_RADII: f64 = 0.5;
/// How far from a needle nodes are prepared, in mean edges: those of the faces that it goes through, and of the
/// next ones.
const PREPARED_EDGES: f64 = 1.5;
/// And so much further \[m\]: the hand strays from its path, and tissue moves along.
const PREPARED_MARGIN_M: f64 = 0.003;

/// It, and what it is stepped with.
pub(super) struct Constrained {
    pub model: Arc<Model>,
    pub state: State,
    pub work: Workspace,
    pub wound: Option<Wound>,
}

impl Constrained {
    /// A scene's tissue before its tools come.
    pub fn new(scene: &Scene) -> Result<Self, SceneError> {
        let (model, state, work) = scene.build()?;
        if let Some(words) = scene.sags(&state.positions(&model)) {
            tracing::warn!("{words}");
        }
        let wound = Wound::new(scene, &model);
        let tissue = Self {
            wound,
            model: Arc::new(model),
            state,
            work,
        };
        if let Some(overlap) = tissue.overlap() {
            tracing::warn!("{overlap}");
        }
        Ok(tissue)
    }

    /// Returns the overlap of parts that may touch, if it is deeper than contact leaves them.
    pub fn overlap(&self) -> Option<Overlap> {
        let wound = self.wound.as_ref()?;
        wound.overlap(&self.model, &self.state)
    }

    /// Whether any tool rubs.
    pub fn rubs(&self) -> bool {
        self.model.tools().iter().any(|(_, tool)| !tool.is_smooth())
    }

    /// Computes the columns of what the tool `driven` and needles come by on `path`. Returns of how many vertices there are
    /// some now.
    pub fn prepare(&mut self, path: &Path, driven: Option<u8>) -> usize {
        let surface = self.model.surface();
        let edge_m = surface.mean_edge_m;
        let needles_m = PREPARED_EDGES * edge_m + PREPARED_MARGIN_M;
        let touching = driven.and_then(|id| self.model.tool(id));
        let touching = touching.filter(|(_, tool)| !tool.is_grip());
        let solids: Vec<Solid> = touching.map_or_else(Vec::new, |(_, tool)| {
            let grips = path.grips.iter();
            let placed = grips.filter_map(|grip| tool.place(&at_rest(0, grip)));
            placed
                .map(|place| Solid::new(tool, edge_m, &place))
                .collect()
        });
        let faces_a_fall = |(vertex, normal): (&u32, &[f64; 3])| {
            let at = Vector3::from(self.model.points_m()[*vertex as usize]);
            let lands = |fall: &Fall| fall.lands_on(&at, &Vector3::from(*normal));
            path.falls.iter().any(lands).then_some(at)
        };
        let vertices = surface.vertices.iter().zip(&surface.normals);
        let lain_on_m: Vec<Vector3<f64>> = vertices.filter_map(faces_a_fall).collect();
        let near = |vertex: [f64; 3]| {
            let vertex = Vector3::from(vertex);
            let touched = |solid: &Solid| {
                solid.gap(&vertex) <= PREPARED_RADII * solid.radius() + PREPARED_MARGIN_M
            };
            let pierced =
                |place: &Vector3<f64>| (place - vertex).norm_squared() <= needles_m * needles_m;
            let held = |place: &Vector3<f64>| {
                (place - vertex).norm_squared() <= (0.5 * edge_m + PREPARED_MARGIN_M).powi(2)
            };
            solids.iter().any(touched)
                || path.needles.iter().any(pierced)
                || path.pads.iter().chain(&lain_on_m).any(held)
        };
        let count = self.work.prepare(&self.model, near);
        tracing::info!("compliance of {count} vertices computed beforehand");
        count
    }

    /// A step of its own.
    pub fn step(&mut self, samples: &[ToolSample], options: &StepOptions) -> StepReport {
        step(
            &self.model,
            &mut self.state,
            samples,
            options,
            &mut self.work,
        )
    }

    /// A step on another state than its own.
    pub fn try_on(
        &mut self,
        state: &mut State,
        samples: &[ToolSample],
        options: &StepOptions,
    ) -> StepReport {
        step(&self.model, state, samples, options, &mut self.work)
    }

    /// A step that is thrown away, on tissue that is not linear.
    pub fn try_here(
        &mut self,
        samples: &[ToolSample],
        options: &StepOptions,
    ) -> Option<StepReport> {
        try_step(
            &self.model,
            &mut self.state,
            samples,
            options,
            &mut self.work,
        )
    }

    /// Steps until every tool is where the scene holds it, and corotational tissue in balance.
    pub fn come_to_rest(&mut self, held: &[(u8, Tool, Pose)]) -> Result<StepReport, SolveError> {
        let (surface, points_m) = (self.model.surface(), self.model.points_m());
        // Bodies that press on each other have to be seen apart: each begins farther out than the next.
        let apart_m = APART_RADII * self.model.thickest_pair_m();
        let from = (1..).zip(held).map(|(number, (id, shape, pose))| {
            let body = self.model.body_of(*id);
            let shape = body.as_ref().unwrap_or(shape);
            let mut there = outside(surface, points_m, shape, pose);
            let out = gap_at_rest(surface, points_m, shape, &there);
            if let (true, Some((_, out))) = (body.is_some(), out) {
                let out = out * (apart_m * (held.len() - number) as f64);
                there.position_m = (Vector3::from(there.position_m) + out).into();
            }
            at_rest(*id, &there)
        });
        let from: Vec<ToolSample> = from.collect();
        let to = held.iter().map(|(id, _, pose)| at_rest(*id, pose));
        let to: Vec<ToolSample> = to.collect();
        work::begin("bringing tools to where they are held", || {
            format!("{} tools", held.len())
        });
        let options = StepOptions::default();
        self.step(&from, &options);
        let mut passes = 0;
        for _ in 0..MOST_STEPS {
            let report = self.step(&to, &options);
            if work::is_stopped() {
                return Err(TissueError::Stopped.into());
            }
            match report.status {
                // A step looks before it moves: only the next one knows what this one left.
                Status::Ok
                    if report.passes == 0 || (passes > 0 && report.imbalance <= IN_BALANCE) =>
                {
                    return Ok(report);
                }
                Status::Ok => passes += report.passes,
                Status::Waiting | Status::Behind => {}
                Status::TooManyRows => {
                    return Err(SolveError::NoRoom {
                        room: MOST_CONTACTS,
                    });
                }
                stuck => return Err(SolveError::NoRest(stuck)),
            }
            if passes > MOST_PASSES {
                return Err(SolveError::NoRest(Status::NotConverged));
            }
        }
        Err(SolveError::NoRest(Status::Behind))
    }
}
