//! What a scene builds, which key asks for it, and what it costs on this machine.
//!
//! Entry point: [`explain`]. Every cost is measured by building the scene and following its hand; what is
//! not measured is left open, never estimated.

mod model;
mod wound;

use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::Serialize;
use std::time::{Duration, Instant};
use sutura_host::fem::{CorotationalTissue, LinearTissue};
use sutura_host::model::ModelError;
use sutura_host::needle::{Hierarchy, NeedleShape};
use sutura_host::scene::{
    ADDED_KEYS, HostSettings, Pose, Rendering, Scene, SceneError, Tissue, position_at,
};
use sutura_host::script::{Path, at_rest, path};
use sutura_host::session::{SceneSolver, most_rows, usb_bytes_per_s};
use sutura_host::solve::SolveError;
use sutura_host::step::{Status, StepReport};
use sutura_host::tool::{Shape, ToolSample};
use sutura_shared::control::TICK_HZ;

/// Seconds between two places of a needle whose surroundings are prepared.
const PREPARED_EVERY_S: f64 = 0.02;
/// Steps along the hand's path that are timed at most, evenly spread.
const MOST_STEPS: u32 = 2000;
/// Corotational steps take hundreds of times longer: so many pieces of the path stand for all of it, ...
const PIECES: usize = 12;
/// ... each with so many steps a host period apart, ...
const PIECE_STEPS: usize = 8;
/// ... after at most so many that bring the tool there and are not counted, ...
const MOST_WAY_STEPS: usize = 24;
/// ... until this much time has passed: whoever asks is waiting.
const LONGEST: Duration = Duration::from_secs(5);

/// One part of a scene's solver, or one that the scene does without.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Component {
    /// What it is.
    pub name: String,
    /// Whether the scene has it.
    pub built: bool,
    /// Which key asks for it, or why nothing does.
    pub why: String,
    /// Scalar constraints that it adds to a step, most of those on the hand's path; `None` where the word
    /// has no meaning or nothing was followed.
    pub rows: Option<u32>,
    /// Memory \[bytes\]; `None`: not measured.
    pub bytes: Option<usize>,
    /// Time \[us\]; `None`: not measured.
    pub us: Option<f64>,
    /// How often this time is taken: `once`, `vertex` (once for each that is touched), `step`, `factor` (once
    /// for each refactorisation), or `request`.
    pub per: Option<&'static str>,
}

impl Component {
    fn built(name: impl Into<String>, why: impl Into<String>) -> Self {
        Self {
            name: name.into(),
            built: true,
            why: why.into(),
            rows: None,
            bytes: None,
            us: None,
            per: None,
        }
    }

    fn absent(name: impl Into<String>, why: impl Into<String>) -> Self {
        Self {
            built: false,
            ..Self::built(name, why)
        }
    }

    fn rows(self, rows: u32) -> Self {
        Self {
            rows: Some(rows),
            ..self
        }
    }

    fn bytes(self, bytes: usize) -> Self {
        Self {
            bytes: Some(bytes),
            ..self
        }
    }

    fn takes(self, time: Option<Duration>, per: &'static str) -> Self {
        Self {
            us: time.map(|time| 1e6 * time.as_secs_f64()),
            per: time.map(|_| per),
            ..self
        }
    }
}

/// Builds the scene, follows its hand, and lists its parts.
///
/// # Errors
/// What [`SceneSolver::new`] refuses.
pub fn explain(scene: &Scene) -> Result<Vec<Component>, SolveError> {
    if let Some(model) = scene.tissue.sticking() {
        return model::explain(scene, model);
    }
    let hand = hand_path(scene);
    let mut solver = SceneSolver::new(scene)?;
    // Held tools have come to touch some already.
    let before = solver.prepare(&Path::default());
    let apart_m = SceneSolver::apart_m(scene);
    let every_s = scene.seconds / f64::from(steps(scene));
    let ahead = path(scene, scene.seconds, every_s.max(PREPARED_EVERY_S), apart_m);
    let (there, preparing) = timed(|| solver.prepare(&ahead));
    let prepared = (there - before) as u32;
    // A needle's way cannot be cut into pieces.
    let whole = matches!(scene.tissue, Tissue::Linear | Tissue::Auto) || scene.depends_on_way();
    let walk: Vec<(StepReport, Duration)> = match solver.driven() {
        Some(id) if whole => hand
            .iter()
            .map(|at| timed(|| solver.step(on_path(id, at))))
            .collect(),
        Some(id) => pieces(&mut solver, id, &hand),
        None => Vec::new(),
    };

    let mut parts = tissue(scene)?;
    let Some((model, state, work)) = solver.parts() else {
        return Ok(parts);
    };
    let per_vertex = (prepared > 0).then(|| preparing / prepared);
    parts.push(columns(scene, work.cache_bytes(), per_vertex));
    parts.extend(contacts(scene, &walk));
    parts.extend(needles(scene, &walk));
    parts.extend(jaws(scene, &walk));
    parts.extend(bodies(scene));
    parts.extend(wound::threads(scene, &walk));
    parts.extend(wound::touching(scene, &walk));
    parts.extend(wound::body_contacts(scene, &walk));
    parts.push(handles(scene));
    parts.extend(added(scene));
    parts.push(loads(scene));
    parts.push(weight(scene));
    let ((), field) = timed(|| {
        std::hint::black_box(model.equilibrium(state).is_ok());
    });
    let name = "displacement of all nodes";
    let is_needed = !scene.threads.is_empty() || !scene.touching.is_empty();
    let component = if is_needed {
        let why = "`[[thread]]`, `[[tissue_contact]]`: where threads bend and tissues may meet";
        Component::built(name.to_owned(), why.to_owned())
    } else {
        let why =
            "no step needs every node's displacement: `sutura solve` computes it, for its file";
        Component::absent(name, why)
    };
    parts.push(component.takes(Some(field), if is_needed { "solve" } else { "request" }));
    parts.push(match scene.tissue {
        Tissue::Linear | Tissue::Auto => Component::absent(
            "refactorisation",
            "`[tissue] model = \"linear\"`: the stiffness is constant",
        ),
        Tissue::Corotational(_) | Tissue::Registered(_) => {
            refactorisation(scene.tissue.word(), &walk)
        }
    });
    parts.push(console_rows(scene));
    parts.extend(console(scene));
    Ok(parts)
}

/// Steps in pieces of the path, evenly spread; the tool is brought to each before it is timed there.
fn pieces(
    solver: &mut SceneSolver,
    id: u8,
    path: &[(f64, [f64; 3])],
) -> Vec<(StepReport, Duration)> {
    let started = Instant::now();
    let mut walk = Vec::with_capacity(PIECES * PIECE_STEPS);
    for piece in 0..PIECES {
        let first = piece * path.len() / PIECES;
        let end = (piece + 1) * path.len() / PIECES;
        let places = &path[first..end.min(first + PIECE_STEPS)];
        let Some(start) = places.first() else {
            continue;
        };
        for _ in 0..MOST_WAY_STEPS {
            let report = solver.step(on_path(id, start));
            if report.status == Status::Ok || started.elapsed() > LONGEST {
                break;
            }
        }
        for at in places {
            if started.elapsed() > LONGEST {
                return walk;
            }
            walk.push(timed(|| solver.step(on_path(id, at))));
        }
    }
    walk
}

/// The grip upright at a place of the hand's path and its time.
fn on_path(id: u8, (time_s, position_m): &(f64, [f64; 3])) -> ToolSample {
    let pose = Pose {
        position_m: *position_m,
        orientation: [0.0, 0.0, 0.0, 1.0],
    };
    ToolSample {
        console_time_us: (1e6 * time_s).round() as u64,
        ..at_rest(id, &pose)
    }
}

/// Median time of the tissue's part of those steps that factored.
fn refactorisation(tissue: &str, walk: &[(StepReport, Duration)]) -> Component {
    let mut factored: Vec<Duration> = walk
        .iter()
        .filter(|(report, _)| report.refactorisations > 0)
        .map(|(report, _)| Duration::from_nanos(report.stages.tissue_ns) / report.refactorisations)
        .collect();
    factored.sort();
    let why = format!(
        "`[tissue] model = \"{tissue}\"`: the stiffness {} with the elements; in {} of {} steps that \
         were followed",
        if tissue == "corotational" {
            "turns"
        } else {
            "turns and strains"
        },
        factored.len(),
        walk.len()
    );
    let median = factored.get(factored.len() / 2).copied();
    Component::built("refactorisation", why).takes(median, "factor")
}

fn timed<T>(work: impl FnOnce() -> T) -> (T, Duration) {
    let started = Instant::now();
    let done = work();
    (done, started.elapsed())
}

/// Steps that are followed: one a host period.
fn steps(scene: &Scene) -> u32 {
    let periods = (scene.seconds * scene.host.host_hz) as u32;
    periods.clamp(1, MOST_STEPS)
}

/// When and where the hand wants the grip \[s\], \[m\]; empty without a hand.
fn hand_path(scene: &Scene) -> Vec<(f64, [f64; 3])> {
    let Some(hand) = &scene.hand else {
        return Vec::new();
    };
    let steps = steps(scene);
    let at = |step| {
        let time_s = scene.seconds * f64::from(step) / f64::from(steps);
        (time_s, position_at(hand, time_s))
    };
    (0..steps).map(at).collect()
}

/// Mesh and boundary.
fn geometry(scene: &Scene) -> Vec<Component> {
    let mesh = &scene.mesh;
    let tables =
        size_of_val(mesh.points_m()) + size_of_val(mesh.cells()) + size_of_val(mesh.regions());
    let why = format!(
        "`[mesh]`: {} nodes, {} cells; bytes without what neighbours share",
        mesh.points_m().len(),
        mesh.cells().len()
    );
    let mut parts = vec![Component::built("mesh", why).bytes(tables)];

    let (surface, took) = timed(|| mesh.surface());
    let bytes = size_of_val(surface.triangles.as_slice())
        + size_of_val(surface.vertices.as_slice())
        + size_of_val(surface.normals.as_slice());
    let why = format!(
        "`[mesh]`: {} vertices, {} triangles, edges of {:.2} mm on average",
        surface.vertices.len(),
        surface.triangles.len(),
        1e3 * surface.mean_edge_m
    );
    parts.push(
        Component::built("surface", why)
            .bytes(bytes)
            .takes(Some(took), "once"),
    );
    parts
}

fn tissue(scene: &Scene) -> Result<Vec<Component>, SceneError> {
    let mesh = &scene.mesh;
    let mut parts = geometry(scene);
    let (materials, fixed) = (scene.materials.clone(), &scene.fixed[..]);
    let (size, took) = timed(|| match scene.tissue {
        Tissue::Linear | Tissue::Auto => LinearTissue::new(mesh, materials, fixed)
            .map(|tissue| (tissue.unknowns(), tissue.factor_entries()))
            .map_err(ModelError::from),
        Tissue::Corotational(settings) => {
            CorotationalTissue::new(mesh, materials, fixed, settings.policy())
                .map(|tissue| (tissue.unknowns(), tissue.factor_entries()))
                .map_err(ModelError::from)
        }
        Tissue::Registered(model) => scene
            .hyperelastic(model, &[])
            .map(|model| (model.unknowns(), model.factor_entries())),
    });
    let (unknowns, entries) = size.map_err(SceneError::Build)?;
    let why = format!(
        "`[tissue]`, {} nodes held by `[[fixed]]`: {unknowns} unknowns, {entries} entries in the factor",
        scene.fixed.len(),
    );
    let factor = Component::built(format!("{} tissue, factored", scene.tissue.word()), why);
    parts.push(
        factor
            .bytes(size_of::<f64>() * entries)
            .takes(Some(took), "once"),
    );
    parts.push(materials_of(scene));
    Ok(parts)
}

fn materials_of(scene: &Scene) -> Component {
    if scene.regions.is_empty() {
        Component::absent(
            "materials of regions",
            "no `[[region]]`: one material everywhere",
        )
    } else {
        let list: Vec<String> = scene
            .regions
            .iter()
            .map(|region| format!("{} ({} cells)", region.name, region.cells))
            .collect();
        Component::built(
            "materials of regions",
            format!("`[[region]]`: {}", list.join(", ")),
        )
    }
}

fn columns(scene: &Scene, bytes: usize, per_vertex: Option<Duration>) -> Component {
    let name = "compliance columns";
    if scene.tools.is_empty() {
        return Component::absent(name, "no `[[tool]]`: nothing touches the tissue");
    }
    if scene.needles.is_empty() && !scene.jaws.is_empty() {
        let why = "`[[jaws]]`: three for each node of what they hold; here those between the pads where the scripts close them";
        return Component::built(name, why)
            .bytes(bytes)
            .takes(per_vertex, "vertex");
    }
    if !scene.needles.is_empty() {
        let why = "`[[needle]]`: three for each node of a face that a needle goes through; here those along the scripts";
        return Component::built(name, why)
            .bytes(bytes)
            .takes(per_vertex, "vertex");
    }
    let why = match scene.hand {
        Some(_) => {
            "`[[tool]]`: three for each vertex that is touched or near; here those along `[hand]`'s path"
        }
        None => {
            "`[[tool]]`: three for each vertex that is touched or near; no `[hand]` to follow, so few yet"
        }
    };
    Component::built(name, why)
        .bytes(bytes)
        .takes(per_vertex, "vertex")
}

/// The contact of each tool, and the step that balances all of them.
fn contacts(scene: &Scene, walk: &[(StepReport, Duration)]) -> Vec<Component> {
    if scene.tools.is_empty() {
        return vec![Component::absent("contact", "no `[[tool]]`")];
    }
    let mut parts = Vec::new();
    for tool in &scene.tools {
        let shape = match tool.shape.shape {
            Shape::Sphere { .. } => "sphere",
            Shape::FlatPunch { .. } => "flat punch",
            Shape::Capsule { .. } => "capsule",
            Shape::RoundedBox { .. } => "rounded box",
            Shape::Mesh { .. } => "mesh",
            Shape::Grip => "grip",
        };
        let name = match tool.shape.shape {
            Shape::Grip => format!("tool {}, {shape}", tool.id),
            _ => format!("contact of tool {}, {shape}", tool.id),
        };
        if !tool.driven && tool.pose.is_none() {
            let why = "neither driven nor held: no `driven = true`, no `position_m`";
            parts.push(Component::absent(name, why));
            continue;
        }
        let why = match (tool.driven, &scene.hand) {
            (true, Some(_)) => {
                "`[[tool]]`, driven: carried by the console's grip along `[hand]`'s path"
            }
            (true, None) => {
                "`[[tool]]`, driven: carried by the console's grip; no `[hand]` to follow here"
            }
            (false, _) if tool.way.is_some() => {
                "`[[tool]]` with `[[tool.way_point]]`: follows its script while another is driven"
            }
            (false, _) => "`[[tool]]` with `position_m`: held there while another is driven",
        };
        let most = walk
            .iter()
            .flat_map(|(report, _)| report.contacts())
            .filter(|contact| contact.id == tool.id)
            .map(|contact| contact.rows)
            .max();
        parts.push(Component {
            rows: most,
            ..Component::built(name, why)
        });
    }
    // As in a session: linear tissue has its columns, corotational tissue computes them again and again, and
    // what is in no balance is not sent.
    let keeps_columns = matches!(scene.tissue, Tissue::Linear | Tissue::Auto);
    let mut touching: Vec<&(StepReport, Duration)> = walk
        .iter()
        .filter(|(report, _)| {
            let computed = keeps_columns && report.columns_computed > 0;
            report.status == Status::Ok && report.rows > 0 && !computed
        })
        .collect();
    touching.sort_by_key(|(_, took)| *took);
    let median = touching.get(touching.len() / 2).map(|(_, took)| *took);
    let why = match touching.last() {
        Some((_, slowest)) => format!(
            "all contacts together: median of {} steps in contact, slowest {:.0} us",
            touching.len(),
            1e6 * slowest.as_secs_f64()
        ),
        None => "all contacts together: no step in contact was followed".to_owned(),
    };
    parts.push(Component {
        rows: touching.iter().map(|(report, _)| report.rows).max(),
        ..Component::built("step", why).takes(median, "step")
    });
    parts
}

/// Needles, and what finds the faces that they come to.
fn needles(scene: &Scene, walk: &[(StepReport, Duration)]) -> Vec<Component> {
    if scene.needles.is_empty() {
        return vec![Component::absent("needle", "no `[[needle]]`")];
    }
    let mut parts = Vec::new();
    for (index, needle) in scene.needles.iter().enumerate() {
        let shape = match needle.needle.shape {
            NeedleShape::Straight { .. } => "straight",
            NeedleShape::Arc { .. } => "arc",
            NeedleShape::Segments(_) => "of segments",
        };
        let reports = || {
            walk.iter()
                .filter_map(|(step, _)| step.needles().get(index))
        };
        let crossings = reports().map(|report| report.crossings).max();
        let why = match reports().next_back() {
            Some(last) => format!(
                "`[[needle]]`: {:.1} mm long, through {} faces at most, {} punctures along the scripts",
                1e3 * needle.needle.shape.length_m(),
                crossings.unwrap_or(0),
                last.punctures
            ),
            None => "`[[needle]]`; no `[hand]` to follow here".to_owned(),
        };
        let name = format!("needle {}, {shape}", needle.id);
        // Two across and one along for each face.
        parts.push(Component {
            rows: crossings.map(|crossings| 3 * crossings),
            ..Component::built(name, why)
        });
        if needle.body {
            let touches = reports().map(|report| report.touches).max();
            let why = match touches {
                Some(touches) => format!(
                    "`body`: touches the surface in {touches} places at most along the scripts"
                ),
                None => "`body`; no `[hand]` to follow here".to_owned(),
            };
            let name = format!("body of needle {}", needle.id);
            parts.push(Component {
                rows: touches.map(|touches| 3 * touches),
                ..Component::built(name, why)
            });
        }
    }
    let half_faces = scene.mesh.half_faces();
    let points_m = scene.mesh.points_m();
    let at = |node: u32| Vector3::from(points_m[node as usize]);
    let (hierarchy, took) = timed(|| Hierarchy::new(half_faces, at));
    std::hint::black_box(&hierarchy);
    let why = "`[[needle]]`: finds the face that a tip outside comes to";
    parts.push(Component::built("hierarchy of the boundary", why).takes(Some(took), "once"));
    parts
}

/// Jaws: three rows at each point that they hold.
fn jaws(scene: &Scene, walk: &[(StepReport, Duration)]) -> Vec<Component> {
    if scene.jaws.is_empty() {
        return vec![Component::absent("jaws", "no `[[jaws]]`")];
    }
    let each = scene.jaws.iter().enumerate().map(|(index, each)| {
        let jaws = &each.part.jaws;
        let reports = walk.iter().filter_map(|(step, _)| step.jaws().get(index));
        let points = reports.map(|report| report.points).max();
        let why = format!(
            "`[[jaws]]`: pads of {:.1} by {:.1} mm that hold {:.2} N in their plane, closed {} times; {} points at most along \
             the scripts",
            1e3 * jaws.length_m,
            1e3 * jaws.width_m,
            jaws.limit_n(),
            each.closes.len(),
            points.unwrap_or(0)
        );
        Component {
            rows: points.map(|points| 3 * points),
            ..Component::built(format!("jaws of tool {}", each.part.tool), why)
        }
    });
    each.collect()
}

/// Bodies of grips: three rows at each place where they touch, or may come to.
fn bodies(scene: &Scene) -> Vec<Component> {
    let each = scene.bars().map(|part| {
        let why = format!(
            "`body` of a `[[tool]]`: a bar of {:.1} by {:.1} mm that touches the surface; rows where it does, or may in the next \
             piece of its way",
            2e3 * part.bar.radius_m,
            1e3 * part.bar.length_m,
        );
        Component::built(format!("body of tool {}", part.tool), why)
    });
    each.collect()
}

fn handles(scene: &Scene) -> Component {
    let count = scene.loads.handles.len();
    if count == 0 {
        return Component::absent("handles", "no `[[handle]]`");
    }
    let when = if scene.depends_on_way() {
        "in every step, beside what else acts"
    } else {
        "once"
    };
    let why = format!("`[[handle]]`: {count} points with three rows each, solved {when}");
    Component::built("handles", why).rows(3 * count as u32)
}

/// Sources that scenes add by keys of their own.
fn added(scene: &Scene) -> Vec<Component> {
    if scene.added().next().is_none() {
        let keys = ADDED_KEYS.iter();
        return keys
            .map(|key| Component::absent(format!("{key}s"), format!("no `[[{key}]]`")))
            .collect();
    }
    let each = scene.added();
    each.map(|(name, why)| Component::built(name, why))
        .collect()
}

fn loads(scene: &Scene) -> Component {
    match scene.loads.forces.len() {
        0 => Component::absent("loads", "no `[[load]]`"),
        count => Component::built("loads", format!("`[[load]]`: forces on {count} nodes")),
    }
}

/// What the tissue weighs.
fn weight(scene: &Scene) -> Component {
    match &scene.gravity {
        None => Component::absent("weight", "no `gravity_m_per_s2`: nothing weighs anything"),
        Some(gravity) => {
            let why = format!(
                "`gravity_m_per_s2`: {:.1} g, {:.3} N on {} nodes, in the tissue's balance before the first step",
                1e3 * gravity.mass_kg,
                scene.weight_n(),
                scene.mesh.points_m().len()
            );
            Component::built("weight", why)
        }
    }
}

/// Rows that the console solves between two solves.
fn console_rows(scene: &Scene) -> Component {
    let name = "console rows";
    if scene.usual_rendering() != Rendering::Rows {
        let why = "no rows: tools stick to this tissue, and the console has the tangent";
        return Component::absent(name, why);
    }
    let host_hz = scene.host.host_hz;
    let board_rows_hz = scene.device.and_then(|device| device.board_rows_hz);
    match most_rows(usb_bytes_per_s(board_rows_hz), host_hz, f64::from(TICK_HZ)) {
        0 => {
            let why = format!(
                "no rows: at {host_hz} solves a second line and board have no room, and the console has the tangent"
            );
            Component::absent(name, why)
        }
        most => {
            let why = format!(
                "`[host]`: at {host_hz} solves a second a frame has up to {most} of the contact's rows, which the console solves itself"
            );
            Component::built(name, why)
        }
    }
}

fn console(scene: &Scene) -> [Component; 3] {
    let device = match &scene.device {
        Some(_) => Component::built(
            "device",
            "`device`: what the simulated console is, and what its grip reaches",
        ),
        None => Component::absent("device", "no `device`: there is no console to describe"),
    };
    let hand = match &scene.hand {
        Some(hand) => {
            let why = format!(
                "`[hand]`: {} way points, followed by simulated consoles only",
                hand.count
            );
            Component::built("hand", why)
        }
        None => Component::absent("hand", "no `[hand]`: nobody holds a simulated console"),
    };
    let HostSettings {
        host_hz,
        horizon_us,
    } = scene.host;
    let horizon = match horizon_us {
        Some(us) => format!("a frame lasts {} ms", f64::from(us) / 1e3),
        None => "how long a frame lasts is measured".to_owned(),
    };
    let why = format!(
        "`[host]`: {host_hz} steps a second, {:.1} ms for each; {horizon}",
        1e3 / host_hz
    );
    [device, hand, Component::built("host", why)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;
    use sutura_host::scene::Document;

    const SLAB: &str = r#"
[mesh.slab]
size_m = [0.06, 0.06, 0.03]
divisions = [6, 6, 3]

[tissue]
youngs_modulus_pa = 10e3
poisson_ratio = 0.4

[[fixed]]
plane = { axis = "z", at_m = -0.03 }
"#;
    const HAND: &str = r#"
[hand]
stiffness_n_per_m = 1000.0
damping_n_s_per_m = 10.0
way_point = [{ time_s = 0.0, position_m = [0.0, 0.0, 0.04] }, { time_s = 0.4, position_m = [0.0, 0.0, 0.034] }]
"#;

    fn parts(text: &str) -> Vec<Component> {
        let document = Document::embedded("test.toml", Path::new(""), text);
        let scene = Scene::read(&document, "test").expect("good");
        explain(&scene).expect("has a rest")
    }

    fn part<'a>(parts: &'a [Component], name: &str) -> &'a Component {
        let found = parts.iter().find(|part| part.name == name);
        found.unwrap_or_else(|| panic!("no {name} in {parts:#?}"))
    }

    /// Its own factor, with what factors again; and in a few seconds even in a debug build.
    #[test]
    fn corotational_tissue_is_timed_as_it_is_built() {
        let tool = "[[tool]]\nradius_m = 0.036\n";
        let slab = SLAB.replace(
            "0.4\n",
            "0.4\nmodel = \"corotational\"\ncorotational = { refactor_every = 1 }\n",
        );
        let text = format!("device = \"cartesian-bench\"\nseconds = 0.5\n{slab}{tool}{HAND}");
        let parts = parts(&text);
        let factor = part(&parts, "corotational tissue, factored");
        assert!(
            factor.bytes >= Some(8 * 3 * 147) && factor.us > Some(0.0),
            "{factor:?}"
        );
        let again = part(&parts, "refactorisation");
        assert!(
            again.built && again.us > Some(0.0) && again.per == Some("factor"),
            "{again:?}"
        );
        // Every step factors, of twelve pieces of eight steps.
        assert!(
            again.why.ends_with("in 96 of 96 steps that were followed"),
            "{}",
            again.why
        );
        let step = part(&parts, "step");
        assert!(step.rows > Some(0) && step.us > Some(0.0), "{step:?}");
    }

    #[test]
    fn a_scene_without_tools_says_what_it_does_without() {
        let parts = parts(SLAB);
        for name in [
            "compliance columns",
            "contact",
            "handles",
            "loads",
            "weight",
            "device",
            "hand",
            "needle",
            "thread",
            "contact of tissues",
            "threads on bodies",
        ] {
            let part = part(&parts, name);
            assert!(!part.built && part.why.starts_with("no "), "{part:?}");
            assert_eq!((part.rows, part.bytes, part.us), (None, None, None));
        }
        let factor = part(&parts, "linear tissue, factored");
        // A factor has at least its diagonal: three unknowns for each of 7 x 7 x 3 free nodes.
        assert!(factor.bytes >= Some(8 * 3 * 147), "{factor:?}");
        assert!(factor.us > Some(0.0) && factor.per == Some("once"));
    }

    /// The driven tool is followed along the hand's path, the other stays in the tissue's side.
    #[test]
    fn every_tool_has_its_rows_and_the_step_has_them_all() {
        let tools = "[[tool]]\nradius_m = 0.036\n[[tool]]\nid = 7\nradius_m = 0.036\nposition_m = [0.064, 0.0, -0.01]\n";
        let text = format!("device = \"cartesian-bench\"\nseconds = 0.5\n{SLAB}{tools}{HAND}");
        let parts = parts(&text);
        let rows = |name: &str| part(&parts, name).rows.unwrap_or(0);
        assert!(
            rows("contact of tool 0, sphere") > 0 && rows("contact of tool 7, sphere") > 0,
            "{parts:#?}"
        );
        assert!(
            rows("step")
                >= rows("contact of tool 0, sphere").max(rows("contact of tool 7, sphere"))
        );
        let step = part(&parts, "step");
        assert!(step.us > Some(0.0) && step.per == Some("step"), "{step:?}");
        let columns = part(&parts, "compliance columns");
        assert!(columns.bytes > Some(0), "{columns:?}");
    }
}
