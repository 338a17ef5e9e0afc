//! Scenes: what a TOML file describes, checked and ready to be built into a solver.
//!
//! Entry points: [`load`] and [`Scene::build`]. A scene builds only what it names.

mod added;
mod bodies;
mod device;
mod document;
mod gravity;
mod hand;
mod jaws;
mod needles;
mod parts;
mod reach;
mod read;
mod region;
mod rendering;
mod schema;
mod select;
mod threads;
mod tissue;
mod tool_shape;
mod tools;
mod touching;
mod units;
mod way;

pub use added::ADDED_KEYS;
pub use device::{BUILT_IN as BUILT_IN_DEVICES, Device, built_in_device, find_device, read_device};
pub use document::{Document, Flaw, SceneError, Sources, nearest};
pub use gravity::Gravity;
pub use hand::{hand_script, joints_at, position_at};
pub use jaws::Jaws;
pub use needles::{Hold, Needle, NeedleSolver};
pub use read::LONGEST_S;
pub use region::Region;
pub use rendering::Rendering;
pub use schema::schema;
pub use sutura_scene_file::scene::{HandSection, WayPointSection};
pub use threads::{Cut, CutBy, Thread, ThreadHeld, Tighten};
pub(crate) use tissue::RELAXES;
pub use tissue::{ContactLaw, DENSITY_KG_PER_M3, Registered, Tissue, models};
pub use touching::TissueContact;
pub use units::unlikely_size;
pub use way::{OnWay, Way, WayStop};

use crate::collide::{TouchError, TouchPart, TouchSettings};
use crate::fem::{Hyperelasticity, Loads, Materials, Policy, TissueError};
use crate::mesh::TetMesh;
use crate::model::{Model, ModelError, Passes};
use crate::needle::{NeedleError, NeedlePart, NeedleSettings, NeedleTissue};
use crate::registry::Substance;
use crate::rod::{Bar, BarPart, BodyContact};
use crate::source::Added;
use crate::step::{State, Workspace};
use crate::thread::{ThreadContact, ThreadError};
use crate::tool;
use crate::work;
use nalgebra::Vector3;
use std::path::Path;
use std::sync::Arc;
use sutura_models::hyperelastic::Cells;
use sutura_shared::wire::message::HandScript;

/// Passes of a step on hyperelastic tissue: as a rule two or three bring it below its setting's tolerance, and a way
/// that was cut short because cells would have inverted takes one or two more.
const MOST_HYPERELASTIC_PASSES: u32 = 4;

/// A checked scene.
#[derive(Debug)]
pub struct Scene {
    /// For people: as written, or the file's stem.
    pub name: String,
    /// Length of a session \[s\].
    pub seconds: f64,
    /// Until when a solve without a console follows the scripts \[s\]; to the end if the scene does not say.
    pub solve_at_s: Option<f64>,
    /// The tissue's mesh, in metres.
    pub mesh: TetMesh,
    /// Which tissue model.
    pub tissue: Tissue,
    /// What each cell is made of.
    pub materials: Materials,
    /// Its density \[kg/m^3\], for models with masses.
    pub density_kg_per_m3: f64,
    /// Share of its stress that fades, and the time in which it does \[s\]: of energy-balance-neo-hookean tissue alone.
    pub relaxation: Option<(f64, f64)>,
    /// What pulls on all of it, if the scene says so.
    pub gravity: Option<Gravity>,
    /// Whether it begins at rest under what acts on it, or as the mesh has it.
    pub settle: bool,
    /// Cells with a material of their own, in the order of their sections.
    pub regions: Vec<Region>,
    /// Nodes that do not move, ascending.
    pub fixed: Vec<u32>,
    /// Those of each `[[fixed]]`, but for what an earlier one holds already, ascending.
    pub fixed_by: Vec<Vec<u32>>,
    /// Tools, with different ids.
    pub tools: Vec<Tool>,
    /// Needles, with different ids.
    pub needles: Vec<Needle>,
    /// How each cell answers them, (m); empty in a scene without needles.
    pub needle_tissue: Vec<NeedleTissue>,
    /// Threads, with different ids, on different needles.
    pub threads: Vec<Thread>,
    /// Jaws, on different tools.
    pub jaws: Vec<Jaws>,
    /// Parts of the tissue that may touch.
    pub touching: Vec<TissueContact>,
    /// Threads that may lie on bodies of grips and needles.
    pub body_contacts: Vec<ThreadContact>,
    /// Bodies of grips and needles that press on each other.
    pub body_pairs: Vec<BodyContact>,
    /// Sources of constraints that it adds by keys of their own.
    pub(crate) added: Vec<Arc<dyn Added>>,
    /// Speed against accuracy of needles.
    pub needle_solver: NeedleSolver,
    /// Places in the file for errors that building the solver finds.
    pub(crate) places: Places,
    /// Forces on nodes, and points of tissue that are moved to a target.
    pub loads: Loads,
    /// A name for each handle that has one, (as many as there are handles).
    pub handle_names: Vec<Option<String>>,
    /// The console, if the scene names one.
    pub device: Option<Device>,
    /// The hand on a simulated console, if the scene has one.
    pub hand: Option<HandScript>,
    /// How the host works.
    pub host: HostSettings,
    /// What is allowed but probably not meant.
    pub warnings: Vec<Flaw>,
    /// What is as meant, and good to know.
    pub notes: Vec<Flaw>,
    /// What the mesh's reader left out of its file or made of it.
    pub mesh_notes: Vec<Flaw>,
}

/// Places in a scene's file for errors that only building its solver finds.
#[derive(Debug)]
pub(crate) struct Places {
    /// The first load or handle; none without one.
    pub acting: Option<Flaw>,
    /// The tissue's mesh.
    pub mesh: Flaw,
    /// The tissue's modulus.
    pub tissue: Flaw,
    /// Parts that are built beside the tissue.
    pub parts: Vec<(Part, Flaw)>,
}

/// A part of a scene that its solver is built from, by its id or else by its place among its kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Part {
    /// A tool.
    Tool(u8),
    /// A needle.
    Needle(u8),
    /// A thread.
    Thread(u8),
    /// A handle.
    Handle(usize),
    /// A `[[tissue_contact]]`.
    Touch(usize),
    /// A `[[body_contact]]`.
    Pair(usize),
}

/// Kinds of errors that are about the parts of a scene.
enum About {
    Part(Part),
    /// All of a kind: the last is one too many.
    Last(fn(&Part) -> bool),
    Tissue,
    Mesh,
    Acting,
    /// Nothing in the file.
    Nothing,
}

/// Returns what an error of the solver's parts is about.
fn about(error: &ModelError) -> About {
    use ModelError::{
        Bar, BodyContact, Jaws, NoRest, NotHeld, SameTool, TooManyTools, Tool, WideHandle,
    };
    match error {
        Tool { id, .. } | SameTool(id) => About::Part(Part::Tool(*id)),
        Jaws { tool, .. } | Bar { tool, .. } => About::Part(Part::Tool(*tool)),
        TooManyTools(_) => About::Last(|part| matches!(part, Part::Tool(_))),
        BodyContact { .. } => About::Last(|part| matches!(part, Part::Pair(_))),
        WideHandle(index) => About::Part(Part::Handle(*index)),
        ModelError::Needle(error) => match error {
            NeedleError::Flaw { id, .. }
            | NeedleError::Inside { id }
            | NeedleError::SameNeedle(id) => About::Part(Part::Needle(*id)),
            NeedleError::TooMany(_) => About::Last(|part| matches!(part, Part::Needle(_))),
            _ => About::Tissue,
        },
        ModelError::Thread(error) => match error {
            ThreadError::SameThread(id)
            | ThreadError::Needle { id, .. }
            | ThreadError::Number { id, .. } => About::Part(Part::Thread(*id)),
            ThreadError::Contact { contact, .. } => About::Part(Part::Thread(contact.thread)),
            ThreadError::TooManyStrands(_) => About::Last(|part| matches!(part, Part::Thread(_))),
        },
        ModelError::Touch(error) => match error {
            TouchError::NoFaces { part } | TouchError::NoSuchNode { part, .. } => {
                About::Part(Part::Touch(*part))
            }
            TouchError::Number { .. } => About::Last(|part| matches!(part, Part::Touch(_))),
        },
        NoRest { .. } | NotHeld { .. } => About::Acting,
        ModelError::Tissue(error) => match error {
            TissueError::NoEquilibrium { .. } | TissueError::NotFinite(_) => About::Acting,
            TissueError::AnchorWeights { handle } | TissueError::HandlesConflict { handle } => {
                About::Part(Part::Handle(*handle))
            }
            TissueError::Stopped => About::Nothing,
            TissueError::Material(_) | TissueError::Elasticity(_) | TissueError::Policy(_) => {
                About::Tissue
            }
            _ => About::Mesh,
        },
    }
}

/// What a scene says about corotational tissue; the solver's own choice where it says nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Corotational {
    /// Factor again once an element has turned by so much since the last time \[degree\].
    pub refactor_rotation_deg: Option<f64>,
    /// Factor again in every pass of this number at the latest.
    pub refactor_every: Option<u32>,
    /// Iterations of conjugate gradients in a pass.
    pub cg_iterations: Option<u32>,
    /// Most passes of one step.
    pub passes: Option<u32>,
    /// Passes end when the out-of-balance force has fallen below this share of the forces.
    pub tolerance: Option<f64>,
}

impl Corotational {
    /// When its tissue is factored anew, with what it leaves out as solvers have it.
    pub fn policy(&self) -> Policy {
        let solvers = Policy::default();
        Policy {
            refactor_rotation_rad: self
                .refactor_rotation_deg
                .map_or(solvers.refactor_rotation_rad, f64::to_radians),
            // The policy counts the passes in between.
            refactor_every: self
                .refactor_every
                .map_or(solvers.refactor_every, |every| every.saturating_sub(1)),
            cg_iterations: self.cg_iterations.unwrap_or(solvers.cg_iterations),
            ..solvers
        }
    }

    pub(crate) fn passes(&self) -> Passes {
        let solvers = Passes::default();
        Passes {
            most: self.passes.unwrap_or(solvers.most),
            tolerance: self.tolerance.unwrap_or(solvers.tolerance),
        }
    }
}

/// A tool of a scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Tool {
    /// Number on the wire.
    pub id: u8,
    /// Its shape, on the grip.
    pub shape: tool::Tool,
    /// Whether the console's grip carries it: one tool of a scene that has any.
    pub driven: bool,
    /// Where the grip is held: always if another tool is driven, else in solves without a console. With a
    /// script, where it begins.
    pub pose: Option<Pose>,
    /// How the grip turns, and where one goes that the console does not carry.
    pub way: Option<Way>,
    /// From how far a grip takes a needle or a thread \[m\].
    pub reach_m: f64,
    /// What of a grip touches the tissue.
    pub body: Option<Bar>,
}

impl Tool {
    /// What is seen of it: its shape, or the body of a grip.
    pub fn seen(&self) -> tool::Tool {
        let Some(bar) = self.body else {
            return self.shape.clone();
        };
        let (radius_m, length_m) = (bar.radius_m, bar.length_m);
        tool::Tool {
            axis: bar.axis,
            ..tool::Tool::new(tool::Shape::Capsule { radius_m, length_m }, bar.offset_m)
        }
    }
}

/// Position and orientation of a grip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Grip \[m\], (3), world frame.
    pub position_m: [f64; 3],
    /// Unit quaternion (x, y, z, w), grip to world.
    pub orientation: [f64; 4],
}

/// How the host works.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HostSettings {
    /// Solver steps a second \[Hz\].
    pub host_hz: f64,
    /// How long the console may use a contact frame at least \[us\], from its console time; what a session measures makes it
    /// longer.
    pub horizon_us: Option<u32>,
}

/// Reads and checks a scene file and every file that it names.
///
/// ```
/// let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../scenes/palpation.toml");
/// let scene = sutura_host::scene::load(path.as_ref())?;
/// // The slab's top is at z = 0, and it is 30 mm thick.
/// let heights = || scene.mesh.points_m().iter().map(|point| point[2]);
/// assert_eq!(heights().fold(f64::NEG_INFINITY, f64::max), 0.0);
/// assert!((heights().fold(f64::INFINITY, f64::min) + 0.03).abs() < 1e-12);
/// // It is held by its bottom alone.
/// let fixed = scene.fixed.iter().map(|node| scene.mesh.points_m()[*node as usize][2]);
/// assert!(fixed.into_iter().all(|height| (height + 0.03).abs() < 1e-12));
/// # Ok::<(), sutura_host::scene::SceneError>(())
/// ```
///
/// # Errors
/// The first thing that is wrong, at its place in the file.
pub fn load(path: &Path) -> Result<Scene, SceneError> {
    read(&Document::read(path)?)
}

/// As [`load`], of a document that is already in memory.
///
/// ```
/// use sutura_host::scene::{Document, read};
///
/// let slab = |poisson_ratio: f64| {
///     let text = format!(r#"
///         [mesh.slab]
///         size_m = [0.08, 0.08, 0.03]
///         divisions = [4, 4, 2]
///         [tissue]
///         model = "linear"
///         youngs_modulus_pa = 15e3
///         poisson_ratio = {poisson_ratio}
///         [[fixed]]
///         plane = {{ axis = "z", at_m = -0.03 }}
///     "#);
///     read(&Document::embedded("slab.toml", "".as_ref(), &text))
/// };
/// assert_eq!(slab(0.45)?.mesh.points_m().len(), 5 * 5 * 3);
/// // Nothing elastic gets larger under pressure from all sides.
/// let wrong = slab(0.6).unwrap_err();
/// assert!(wrong.to_string().contains("poisson"), "{wrong}");
/// # Ok::<(), sutura_host::scene::SceneError>(())
/// ```
///
/// # Errors
/// As there.
pub fn read(document: &Document) -> Result<Scene, SceneError> {
    work::begin("reading the scene and its mesh", || document.stem());
    Scene::read(document, &document.stem())
}

/// Solver steps a second that a scene asks for \[Hz\], without its mesh; none if its file is wrong, as [`read`] says.
pub fn host_hz(document: &Document) -> Option<f64> {
    read::read_host_hz(document).ok()
}

impl Scene {
    /// What it adds by keys of their own: each with its name, and why the scene has it.
    pub fn added(&self) -> impl Iterator<Item = (String, String)> {
        self.added.iter().map(|added| added.explain())
    }

    /// The tool that the console's grip carries.
    pub fn driven(&self) -> Option<&Tool> {
        self.tools.iter().find(|tool| tool.driven)
    }

    /// The tool that the console's grip carries, if that has jaws.
    pub fn driven_jaws(&self) -> Option<u8> {
        let driven = self.driven()?.id;
        self.jaws
            .iter()
            .any(|jaws| jaws.part.tool == driven)
            .then_some(driven)
    }

    /// Bodies of grips.
    pub fn bars(&self) -> impl Iterator<Item = BarPart> {
        let tools = self.tools.iter();
        tools.filter_map(|tool| {
            let bar = tool.body?;
            Some(BarPart { tool: tool.id, bar })
        })
    }

    /// Whether what is at rest depends on the way there: there are needles, jaws, or tissues that touch.
    pub fn depends_on_way(&self) -> bool {
        !(self.needles.is_empty() && self.touching.is_empty() && self.jaws.is_empty())
    }

    /// Whether a solve without a console follows scripts: what is at rest depends on the way there, or tools go ways of their own.
    pub fn follows_scripts(&self) -> bool {
        let goes = |tool: &Tool| !tool.driven && tool.way.is_some();
        self.depends_on_way() || self.tools.iter().any(goes)
    }

    /// Tools that are held while another is driven, with their poses.
    pub fn held(&self) -> impl Iterator<Item = (&Tool, Pose)> {
        let others = self.tools.iter().filter(|tool| !tool.driven);
        others.filter_map(|tool| Some((tool, tool.pose?)))
    }

    /// The solver for this scene: what is constant, what evolves, and scratch.
    ///
    /// # Errors
    /// [`SceneError::Build`]: tissue that is not held against rigid motion, handles that conflict, too many
    /// tools; corotational tissue without a balance under its loads; quadratic cells with needles; tissues that touch and find
    /// no rest. [`SceneError::OnlySessions`] for a model that tools stick to: any without [`Registered::has_rows`].
    pub fn build(&self) -> Result<(Model, State, Workspace), SceneError> {
        let tools: Vec<_> = self
            .tools
            .iter()
            .map(|tool| (tool.id, tool.shape.clone()))
            .collect();
        let (mesh, fixed) = (&self.mesh, &self.fixed[..]);
        let (materials, loads) = (self.materials.clone(), self.acting());
        let model = match self.tissue {
            Tissue::Linear | Tissue::Auto => Model::new(mesh, materials, fixed, loads, &tools),
            Tissue::Corotational(settings) => {
                let (policy, passes) = (settings.policy(), settings.passes());
                Model::corotational(mesh, materials, fixed, loads, &tools, policy, passes)
            }
            Tissue::Registered(model) if self.has_rows() => self.hyperelastic(model, &tools),
            Tissue::Registered(model) => {
                return Err(SceneError::OnlySessions {
                    model: model.name(),
                });
            }
        }
        .map_err(|error| match error {
            ModelError::Tissue(TissueError::TooLarge(shortage)) => SceneError::TooLarge {
                nodes: mesh.points_m().len(),
                shortage,
            },
            ModelError::Tissue(TissueError::NoEquilibrium { .. }) => {
                self.collapse().unwrap_or(SceneError::Build(error))
            }
            error => self.placed(error),
        })?;
        let model = match &self.gravity {
            Some(gravity) => model.with_gravity(gravity.m_per_s2),
            None => model,
        };
        let model = self.add_needles(model);
        let jaws: Vec<_> = self.jaws.iter().map(|jaws| jaws.part).collect();
        let model = model.and_then(|model| model.with_jaws(mesh, &jaws));
        let bars: Vec<_> = self.bars().collect();
        let model = model.and_then(|model| model.with_bars(mesh, &bars));
        let contacts = &self.body_contacts[..];
        let model = model.and_then(|model| model.with_thread_contacts(contacts));
        let pairs = &self.body_pairs[..];
        let model = model.and_then(|model| model.with_body_contacts(pairs));
        let model = model.and_then(|model| model.with_added(mesh, &self.added));
        let model = model.map_err(|error| self.placed(error))?;
        let (state, workspace) = (State::new(&model), Workspace::new(&model));
        self.check_rest(&state.positions(&model))?;
        Ok((model, state, workspace))
    }

    /// An error of the solver's parts, at the place in the file that it is about.
    pub(crate) fn placed(&self, error: ModelError) -> SceneError {
        let Places {
            acting,
            mesh,
            tissue,
            parts,
        } = &self.places;
        let mut parts = parts.iter();
        let place = match about(&error) {
            About::Part(part) => parts.find(|(other, _)| *other == part).map(|(_, at)| at),
            About::Last(is_one) => parts.rfind(|(other, _)| is_one(other)).map(|(_, at)| at),
            About::Tissue => Some(tissue),
            About::Mesh => Some(mesh),
            About::Acting => acting.as_ref(),
            About::Nothing => None,
        };
        match place {
            Some(place) => SceneError::Flaw(Box::new(place.saying(error.to_string()))),
            None => SceneError::Build(error),
        }
    }

    /// Farthest way of a node from the unloaded mesh to `positions_m` (n x 3) \[m\].
    fn moved_m(&self, positions_m: &[[f64; 3]]) -> f64 {
        let ways = positions_m.iter().zip(self.mesh.points_m());
        let ways = ways.map(|(at, from)| Vector3::from(*at).metric_distance(&Vector3::from(*from)));
        ways.fold(0.0, f64::max)
    }

    /// Checks that forces on the tissue move it by less than its size.
    fn check_rest(&self, positions_m: &[[f64; 3]]) -> Result<(), SceneError> {
        let (moved_m, size_m) = (self.moved_m(positions_m), units::size_m(&self.mesh));
        if moved_m <= size_m || !self.loads.handles.is_empty() {
            return Ok(());
        }
        match &self.places.acting {
            Some(place) => {
                let message = format!(
                    "the loads move the tissue by {:.1} mm, and it is {:.1} mm in size",
                    1e3 * moved_m,
                    1e3 * size_m
                );
                Err(SceneError::Flaw(Box::new(place.saying(message))))
            }
            // Tissue that sags under its weight is warned of.
            None => Ok(()),
        }
    }

    /// Hyperelastic tissue as its setting has it, without needles yet.
    ///
    /// # Errors
    /// What no model can be built of.
    pub fn hyperelastic(
        &self,
        model: Registered,
        tools: &[(u8, tool::Tool)],
    ) -> Result<Model, ModelError> {
        let (cells, tolerance) = model
            .hyperelastic()
            .unwrap_or((Cells::Linear, Passes::default().tolerance));
        let laws = self.body().laws(Substance::law);
        let substance = Hyperelasticity { laws: &laws, cells };
        let passes = Passes {
            most: MOST_HYPERELASTIC_PASSES,
            tolerance,
        };
        let (loads, policy) = (self.acting(), Policy::default());
        Model::hyperelastic(
            &self.mesh,
            &substance,
            &self.fixed,
            loads,
            tools,
            policy,
            passes,
        )
    }

    fn add_needles(&self, model: Model) -> Result<Model, ModelError> {
        if self.needles.is_empty() && self.touching.is_empty() {
            return Ok(model);
        }
        let parts: Vec<_> = self
            .needles
            .iter()
            .map(|needle| NeedlePart {
                id: needle.id,
                needle: needle.needle,
                start: needle.start,
                body: needle.body,
                weight: needle.weight,
            })
            .collect();
        let settings = NeedleSettings {
            playback: self.needle_solver.playback,
            ..NeedleSettings::default()
        };
        let model = model.with_needles(&self.mesh, &parts, &self.needle_tissue, settings)?;
        let threads: Vec<_> = self.threads.iter().map(|thread| thread.part).collect();
        let model = model.with_threads(&threads)?;
        if self.touching.is_empty() {
            return Ok(model);
        }
        let parts = self.touching.iter().map(|contact| TouchPart {
            faces: contact.faces.clone(),
            friction: contact.friction,
        });
        let parts: Vec<_> = parts.collect();
        model.with_touching(&self.mesh, &parts, TouchSettings::default())
    }
}

#[cfg(test)]
mod gravity_tests;
#[cfg(test)]
mod needle_tests;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod wound_tests;
