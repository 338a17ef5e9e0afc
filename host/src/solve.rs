//! Tissue at rest, without a console: handles at their targets, loads, tools held where the scene says.
//!
//! Entry point: [`solve`].

use crate::fem::{Equilibrium, Loads};
use crate::output::{Drawn, DrivenNeedle, FixedReaction, HeldTool, Reaction, Solution};
use crate::scene::{Pose, Scene};
use crate::script::at_rest;
pub use crate::session::SolveError;
use crate::session::{IN_BALANCE, MOST_PASSES, MOST_STEPS, SceneSolver};
use crate::step::{State, Status, StepReport};
use crate::thread::Hanging;
use crate::tool::Tool;

/// Solves a scene at rest. Tools come from outside, along the outward normal of the vertex nearest to
/// where the scene holds them. With needles, what is at rest depends on the way there, and tools may go ways of their own: the
/// scripts are followed until the scene's `solve_at_s`.
///
/// ```
/// use sutura_host::scene::{Document, read};
///
/// let pressed = |stiffness_pa: f64| {
///     let text = format!(r#"
///         [mesh.slab]
///         size_m = [0.08, 0.08, 0.03]
///         divisions = [8, 8, 3]
///         [tissue]
///         model = "linear"
///         youngs_modulus_pa = {stiffness_pa}
///         poisson_ratio = 0.45
///         [[fixed]]
///         plane = {{ axis = "z", at_m = -0.03 }}
///         [[tool]]
///         radius_m = 0.014
///         position_m = [0.0, 0.0, 0.009]
///     "#);
///     read(&Document::embedded("slab.toml", "".as_ref(), &text))
/// };
/// let soft = sutura_host::solve::solve(&pressed(5e3)?)?;
/// let stiff = sutura_host::solve::solve(&pressed(15e3)?)?;
/// // The tool pushes the tissue down. Held there, tissue of three times the stiffness moves alike and bears three times
/// // the force.
/// assert!(soft.tools[0].force_n[2] < 0.0);
/// assert!((stiff.tools[0].force_n[2] / soft.tools[0].force_n[2] - 3.0).abs() < 1e-6);
/// let moved = |solution: &sutura_host::output::Solution| {
///     let lengths = solution.drawn.displacement_m.iter();
///     lengths.map(|u| u[0].hypot(u[1]).hypot(u[2])).fold(0.0, f64::max)
/// };
/// assert!((moved(&stiff) - moved(&soft)).abs() < 1e-9);
/// assert!((moved(&soft) - 0.005).abs() < 1e-3);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// Nothing to solve; needles that nobody drives, or a way that cannot be followed; tissue that is not held or handles that conflict; tools held too deep.
pub fn solve(scene: &Scene) -> Result<Solution, SolveError> {
    let held: Vec<(u8, Tool, Pose)> = scene
        .tools
        .iter()
        .filter_map(|tool| Some((tool.id, tool.shape.clone(), tool.pose?)))
        .collect();
    let without = !scene.follows_scripts();
    let acting = scene.acting();
    let loaded = !(acting.forces.is_empty() && acting.handles.is_empty());
    if !loaded && held.is_empty() && scene.added.is_empty() && without {
        return Err(SolveError::Nothing);
    }
    let mut solver = SceneSolver::apart(scene)?;
    let report = if without {
        solver.come_to_rest(&held)?
    } else {
        follow_scripts(scene, &mut solver)?
    };
    let samples: Vec<_> = if without {
        held.iter()
            .map(|(id, _, pose)| at_rest(*id, pose))
            .collect()
    } else {
        solver.samples().to_vec()
    };
    let (model, state, _) = solver.parts().ok_or(SolveError::Nothing)?;
    let wound = solver.wound();
    let rest = model.equilibrium(state)?;
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
    let fixed_reactions = hold(scene, &acting, &rest, state);
    // The step's wrench is what the tool feels.
    let tools = report.contacts().iter().map(|contact| HeldTool {
        tool: contact.id,
        force_n: std::array::from_fn(|i| -contact.wrench[i]),
        torque_nm: std::array::from_fn(|i| -contact.wrench[3 + i]),
        gap_m: contact.gap_m,
        rows: contact.rows,
    });
    let nodes_m = solver.positions_m();
    let mut hanging = Hanging::new(model);
    let free = hanging.as_mut().and_then(|hanging| {
        hanging.beat(0, model, state, &nodes_m);
        hanging.seen(0, model, state, &nodes_m)
    });
    Ok(Solution {
        scene: scene.name.clone(),
        tissue: scene.tissue.word(),
        forces_act_on: "tissue",
        drawn: Drawn::of(scene, &nodes_m, Some((model, state)), free, &samples),
        reactions: reactions.collect(),
        fixed_force_n: [0, 1, 2].map(|axis| {
            let forces = fixed_reactions.iter().map(|own| own.force_n[axis]);
            forces.sum()
        }),
        fixed_reactions,
        tools: tools.collect(),
        needles: report.needles().iter().map(DrivenNeedle::from).collect(),
        wound,
        residual: rest.residual.max(report.residual),
    })
}

/// What each `[[fixed]]` does to the tissue: `node_force_n` has what acts on its nodes besides.
fn hold(scene: &Scene, acting: &Loads, rest: &Equilibrium, state: &State) -> Vec<FixedReaction> {
    let mut own_n = rest.node_force_n.clone();
    let loads = acting.forces.iter().map(|load| (load.node, load.force_n));
    for (node, force_n) in loads.chain(state.forces_on_prescribed()) {
        for (own, other) in own_n[node as usize].iter_mut().zip(force_n) {
            *own -= other;
        }
    }
    let each = scene.fixed_by.iter().enumerate();
    let each = each.map(|(fixed, nodes)| FixedReaction {
        fixed,
        nodes: nodes.len(),
        force_n: [0, 1, 2].map(|axis| nodes.iter().map(|node| own_n[*node as usize][axis]).sum()),
    });
    each.collect()
}

/// Steps along the scripts of hands and tools until the scene's time to solve at, at its host's rate, then on the spot
/// until the tissue is in balance.
fn follow_scripts(scene: &Scene, solver: &mut SceneSolver) -> Result<StepReport, SolveError> {
    let stays = !scene.needles.is_empty()
        && scene
            .driven()
            .is_some_and(|tool| tool.pose.is_none() && scene.hand.is_none());
    if stays {
        return Err(SolveError::NoHand);
    }
    let end_s = scene.solve_at_s.unwrap_or(scene.seconds);
    let steps = (end_s * scene.host.host_hz).ceil() as u64;
    for number in 0..=steps {
        let time_s = (number as f64 / scene.host.host_hz).min(end_s);
        let report = arrive(time_s, solver)?;
        if number == steps {
            return settle(time_s, report, solver);
        }
    }
    Err(SolveError::Nothing)
}

/// Steps until all is where the scripts have it at a time.
fn arrive(time_s: f64, solver: &mut SceneSolver) -> Result<StepReport, SolveError> {
    for _ in 0..MOST_STEPS {
        let report = solver.step_by_script(time_s);
        match report.status {
            Status::Ok => return Ok(report),
            Status::Waiting | Status::Behind => {}
            status => return Err(SolveError::NoWay { time_s, status }),
        }
    }
    let status = Status::Behind;
    Err(SolveError::NoWay { time_s, status })
}

/// Steps on the spot until corotational tissue is in balance, and nothing moves that would be viscous.
fn settle(
    time_s: f64,
    first: StepReport,
    solver: &mut SceneSolver,
) -> Result<StepReport, SolveError> {
    let mut passes = first.passes;
    loop {
        let report = arrive(time_s, solver)?;
        passes += report.passes;
        // A step looks before it moves: only the next one knows what this one left.
        if report.passes == 0 || report.imbalance <= IN_BALANCE {
            return Ok(report);
        }
        if passes > MOST_PASSES {
            let status = Status::NotConverged;
            return Err(SolveError::NoWay { time_s, status });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Document;
    use nalgebra::Vector3;
    use std::path::Path;

    const SLAB: &str = r#"
[mesh.slab]
size_m = [0.06, 0.06, 0.03]
divisions = [12, 12, 6]

[tissue]
youngs_modulus_pa = 10e3
poisson_ratio = 0.4

[[fixed]]
plane = { axis = "z", at_m = -0.03 }
"#;
    /// Pressed in by 3 mm, off the middle.
    const TOOL: &str = "[[tool]]\nradius_m = 0.018\nposition_m = [0.004, 0.0, 0.015]\n";
    /// The top drawn sideways.
    const LOAD: &str = "[[load]]\non = { plane = { axis = \"z\", at_m = 0.0 } }\ntotal_force_n = [0.3, 0.0, 0.0]\n";

    fn scene(parts: &[&str]) -> Scene {
        let text = parts.concat();
        Scene::read(
            &Document::embedded("test.toml", Path::new(""), &text),
            "test",
        )
        .expect("good")
    }

    /// A handle at the node of the slab nearest to `place`.
    fn handle(place: [f64; 3], target: [f64; 3]) -> String {
        let scene = scene(&[SLAB]);
        let distance = |x: &[f64; 3]| (0..3).map(|i| (x[i] - place[i]).powi(2)).sum::<f64>();
        let points = scene.mesh.points_m();
        let node = (0..points.len())
            .min_by(|a, b| distance(&points[*a]).total_cmp(&distance(&points[*b])))
            .expect("the slab has nodes");
        format!(
            "[[handle]]\nname = \"pull\"\nvertices = [{node}]\nbarycentric = [1.0]\n\
             target_displacement_m = {target:?}\n"
        )
    }

    /// Distance of every node on the top from the sphere \[m\].
    fn gaps(scene: &Scene, solution: &Solution) -> Vec<f64> {
        let tool = &scene.tools[0];
        let centre = Vector3::from(tool.pose.expect("held").position_m);
        let nodes = solution
            .drawn
            .points_m
            .iter()
            .zip(&solution.drawn.displacement_m);
        let top = nodes.filter(|(x, _)| x[2] > -1e-9);
        top.map(|(x, u)| {
            (Vector3::from(*x) + Vector3::from(*u) - centre).norm() - tool.shape.radius_m()
        })
        .collect()
    }

    /// Handle, load and tool at once: each condition holds in the one field, and each has moved the
    /// others' forces.
    #[test]
    fn handle_load_and_tool_hold_together() {
        let target = [0.0, 0.0, 0.002];
        let pull = handle([-0.02, 0.0, 0.0], target);
        let all = scene(&[SLAB, TOOL, LOAD, &pull]);
        let solution = solve(&all).expect("has a rest");
        let node = all.loads.handles[0].anchor.vertices[0] as usize;
        for (moved, wanted) in solution.drawn.displacement_m[node].iter().zip(target) {
            assert!((moved - wanted).abs() < 1e-12);
        }
        let gaps = gaps(&all, &solution);
        let touching = gaps.iter().filter(|gap| gap.abs() < 1e-9).count();
        assert!(
            gaps.iter().all(|gap| *gap > -1e-9),
            "the sphere is in the tissue"
        );
        assert_eq!(touching, solution.tools[0].rows as usize);
        assert!(touching > 3, "{touching}");
        assert!(solution.residual < 1e-9, "{}", solution.residual);

        let reaction = &solution.reactions[0];
        assert_eq!(reaction.name.as_deref(), Some("pull"));
        assert!(
            reaction.force_n[2] > 0.0,
            "pulled up: {:?}",
            reaction.force_n
        );
        let alone = solve(&scene(&[SLAB, TOOL])).expect("has a rest");
        let [with, without] = [&solution, &alone].map(|s| s.tools[0].force_n[2]);
        assert!(without < 0.0 && with < 0.0, "pushed down: {with} {without}");
        assert!(
            (with / without - 1.0).abs() > 1e-3,
            "not coupled: {with} {without}"
        );
    }

    /// Force on the tissue and torque about the grip belong to one line of action: the grip held 20 mm
    /// aside of the same sphere changes the torque by r x F and nothing else.
    #[test]
    fn the_torque_is_about_the_grip() {
        let aside = TOOL.replace(
            "position_m = [0.004",
            "offset_m = [0.02, 0.0, 0.0]\nposition_m = [-0.016",
        );
        let [centred, aside] =
            [TOOL, &aside].map(|tool| solve(&scene(&[SLAB, tool])).expect("has a rest"));
        let (at_centre, at_grip) = (&centred.tools[0], &aside.tools[0]);
        let force = Vector3::from(at_centre.force_n);
        assert!((Vector3::from(at_grip.force_n) - force).norm() < 1e-9 * force.norm());
        assert!(Vector3::from(at_centre.torque_nm).norm() < 1e-12);
        let expected = Vector3::new(0.02, 0.0, 0.0).cross(&force);
        assert!((Vector3::from(at_grip.torque_nm) - expected).norm() < 1e-9 * expected.norm());
    }

    /// Corotational and hyperelastic tissue is in balance, touched and not entered, and not far from linear tissue; with
    /// handles instead of a tool, too.
    #[test]
    fn tissue_that_is_not_linear_comes_to_rest_under_a_tool_or_handles() {
        for tissue in ["corotational", "hyperelastic"] {
            comes_to_rest(tissue);
        }
    }

    fn comes_to_rest(tissue: &str) {
        let turning = SLAB.replace("0.4\n", &format!("0.4\nmodel = \"{tissue}\"\n"));
        let pressed = scene(&[&turning, TOOL, LOAD]);
        let solution = solve(&pressed).expect("has a rest");
        assert_eq!(solution.tissue, tissue);
        assert!(solution.residual < 1e-8, "{}", solution.residual);
        let gaps = gaps(&pressed, &solution);
        assert!(gaps.iter().all(|gap| *gap > -1e-9));
        let touching = gaps.iter().filter(|gap| gap.abs() < 1e-9).count();
        assert_eq!(touching, solution.tools[0].rows as usize);
        let linear = solve(&scene(&[SLAB, TOOL, LOAD])).expect("has a rest");
        let ratio = solution.tools[0].force_n[2] / linear.tools[0].force_n[2];
        assert!((ratio - 1.0).abs() < 0.3 && ratio != 1.0, "{ratio}");

        let pull = handle([-0.02, 0.0, 0.0], [0.0, 0.0, 0.005]);
        let pulled = solve(&scene(&[&turning, LOAD, &pull])).expect("has a rest");
        assert!(pulled.residual < 1e-9, "{}", pulled.residual);
        assert!(pulled.reactions[0].force_n[2] > 0.0);
        // Both at once: in balance, the handle at its place, each felt by the other.
        let both = solve(&scene(&[&turning, TOOL, &pull])).expect("has a rest");
        assert!(both.residual < 1e-8, "{}", both.residual);
        let held = scene(&[&turning, &pull]).loads.handles[0].anchor.vertices[0] as usize;
        for (moved, wanted) in both.drawn.displacement_m[held]
            .iter()
            .zip([0.0, 0.0, 0.005])
        {
            assert!((moved - wanted).abs() < 1e-9, "{moved}");
        }
        let alone = solve(&scene(&[&turning, TOOL])).expect("has a rest");
        let [with, without] = [&both, &alone].map(|s| s.tools[0].force_n[2]);
        assert!((with / without - 1.0).abs() > 1e-3, "{with} {without}");
    }

    #[test]
    fn a_tool_held_far_too_deep_finds_no_rest() {
        let deep = TOOL.replace("0.015]", "-0.02]");
        let error = solve(&scene(&[SLAB, &deep])).expect_err("38 mm into 30 mm");
        assert!(matches!(error, SolveError::NoRest(_)), "{error}");
    }

    /// A bar that is bent by a load across its end: what turns with its cells comes back along the bar, what
    /// is linear cannot. To second order the end of a cantilever under w comes back by 3/5 w^2 / L.
    #[test]
    fn a_corotational_bar_shortens_as_it_bends() {
        let bar = "[mesh.slab]\nsize_m = [0.2, 0.02, 0.02]\ndivisions = [40, 3, 3]\n\
                   [tissue]\nyoungs_modulus_pa = 20e3\npoisson_ratio = 0.0\nmodel = \"corotational\"\n\
                   [[fixed]]\nplane = { axis = \"x\", at_m = -0.1 }\n\
                   [[load]]\non = { plane = { axis = \"x\", at_m = 0.1 } }\ntotal_force_n = [0.0, 0.004, 0.0]\n";
        let end = |scene: &Scene| {
            let solution = solve(scene).expect("has a rest");
            let nodes = solution
                .drawn
                .points_m
                .iter()
                .zip(&solution.drawn.displacement_m);
            let end: Vec<_> = nodes
                .filter(|(x, _)| x[0] > 0.0999)
                .map(|(_, u)| *u)
                .collect();
            [0, 1].map(|axis: usize| end.iter().map(|u| u[axis]).sum::<f64>() / end.len() as f64)
        };
        let [along, across] = end(&scene(&[bar]));
        let expected = -0.6 * across * across / 0.2;
        assert!(across > 0.02, "hardly bent: {across}");
        assert!(
            (along / expected - 1.0).abs() < 0.1,
            "{along} instead of {expected}"
        );
        let [linear, _] = end(&scene(&[&bar.replace("corotational", "linear")]));
        assert!(linear.abs() < 0.02 * along.abs(), "{linear}");
    }

    #[test]
    fn nothing_to_solve_is_said() {
        assert!(matches!(solve(&scene(&[SLAB])), Err(SolveError::Nothing)));
    }
}
