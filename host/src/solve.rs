//! Tissue at rest, without a console: handles at their targets, loads, tools held where the scene says.
//!
//! Entry point: [`solve`].

use crate::fem::TissueError;
use crate::model::Model;
use crate::output::{HeldTool, Reaction, Solution};
use crate::scene::{Pose, Scene, SceneError};
use crate::step::{State, Status, StepReport, Workspace, step};
use crate::tool::{SphereTool, ToolSample};
use miette::Diagnostic;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use thiserror::Error;

/// Most steps that follow a tool to its pose; a step moves it by a good part of its radius.
const MOST_STEPS: usize = 10_000;

/// Why a scene has no solution at rest.
#[derive(Debug, Error, Diagnostic)]
pub enum SolveError {
    /// Nothing acts on the tissue.
    #[error("the scene has nothing to solve: no handle, no load, and no tool with a position")]
    #[diagnostic(help("add a `[[handle]]`, a `[[load]]`, or `position_m` to a `[[tool]]`"))]
    Nothing,
    /// The solver cannot be built.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Scene(#[from] SceneError),
    /// The tissue does not answer.
    #[error("the tissue cannot be solved: {0}")]
    Tissue(#[from] TissueError),
    /// A tool could not be brought to its place.
    #[error("the tissue found no rest with the tools where the scene holds them: {}", .0.name())]
    #[diagnostic(help("move the tools' `position_m` less deep into the tissue"))]
    NoRest(Status),
}

/// Solves a scene at rest. Tools come from outside, along the outward normal of the vertex nearest to
/// where the scene holds them.
///
/// # Errors
/// Nothing to solve; tissue that is not held or handles that conflict; tools held too deep.
pub fn solve(scene: &Scene) -> Result<Solution, SolveError> {
    let held: Vec<(u8, SphereTool, Pose)> = scene
        .tools
        .iter()
        .filter_map(|tool| Some((tool.id, tool.shape, tool.pose?)))
        .collect();
    if scene.loads.forces.is_empty() && scene.loads.handles.is_empty() && held.is_empty() {
        return Err(SolveError::Nothing);
    }
    let (model, mut state, mut work) = scene.build()?;
    let report = bring_in(&model, &mut state, &held, &mut work)?;
    let rest = model.equilibrium(&state)?;
    let reactions = rest
        .handle_force_n
        .iter()
        .enumerate()
        .map(|(handle, force_n)| Reaction {
            handle,
            name: scene.handle_names.get(handle).cloned().flatten(),
            force_n: *force_n,
            torque_nm: [0.0; 3],
        });
    // The step's wrench is what the tool feels.
    let tools = report.contacts().iter().map(|contact| HeldTool {
        tool: contact.id,
        force_n: std::array::from_fn(|i| -contact.wrench[i]),
        torque_nm: std::array::from_fn(|i| -contact.wrench[3 + i]),
        gap_m: contact.gap_m,
        rows: contact.rows,
    });
    Ok(Solution {
        scene: scene.name.clone(),
        tissue: scene.tissue.word(),
        forces_act_on: "tissue",
        points_m: scene.mesh.points_m().to_vec(),
        displacement_m: rest.displacement_m,
        reactions: reactions.collect(),
        tools: tools.collect(),
        residual: rest.residual.max(report.residual),
        cells: scene.mesh.cells().to_vec(),
    })
}

/// Steps until every tool is where the scene holds it.
fn bring_in(
    model: &Model,
    state: &mut State,
    held: &[(u8, SphereTool, Pose)],
    work: &mut Workspace,
) -> Result<StepReport, SolveError> {
    if held.is_empty() {
        return Ok(StepReport::default());
    }
    let outside: Vec<ToolSample> = held
        .iter()
        .map(|(id, shape, pose)| sample(*id, &outside(model, shape, pose)))
        .collect();
    let inside: Vec<ToolSample> = held.iter().map(|(id, _, pose)| sample(*id, pose)).collect();
    step(model, state, &outside, work);
    for _ in 0..MOST_STEPS {
        let report = step(model, state, &inside, work);
        match report.status {
            Status::Ok => return Ok(report),
            Status::Waiting | Status::Behind => {}
            stuck => return Err(SolveError::NoRest(stuck)),
        }
    }
    Err(SolveError::NoRest(Status::Behind))
}

fn sample(id: u8, pose: &Pose) -> ToolSample {
    ToolSample {
        id,
        position_m: pose.position_m,
        orientation: pose.orientation,
        velocity_m_per_s: [0.0; 3],
        console_time_us: 0,
    }
}

/// The pose moved out along the nearest vertex's normal until the sphere is clear of the tissue.
fn outside(model: &Model, shape: &SphereTool, pose: &Pose) -> Pose {
    let [x, y, z, w] = pose.orientation;
    let turn = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
    let arm = turn * Vector3::from(shape.offset_m);
    let grip = Vector3::from(pose.position_m);
    let points = model.points_m();
    let surface = model.surface();
    let distance =
        |centre: Vector3<f64>, node: u32| (Vector3::from(points[node as usize]) - centre).norm();
    let nearest = surface
        .vertices
        .iter()
        .zip(&surface.normals)
        .min_by(|a, b| distance(grip + arm, *a.0).total_cmp(&distance(grip + arm, *b.0)));
    let Some((_, normal)) = nearest else {
        return *pose;
    };
    let stride = Vector3::from(*normal) * shape.radius_m.max(surface.mean_edge_m);
    let clear = |centre: Vector3<f64>| {
        surface
            .vertices
            .iter()
            .all(|node| distance(centre, *node) > shape.radius_m)
            && !surface.contains(points, centre.into())
    };
    let way_out = (0..1000).map(|strides| stride * f64::from(strides));
    let out = way_out
        .into_iter()
        .find(|out| clear(grip + arm + out))
        .unwrap_or_default();
    Pose {
        position_m: (grip + out).into(),
        ..*pose
    }
}
