//! What a scene file may say, key by key. Units are in the names; unknown keys are refused.
//!
//! Entry point: [`SceneFile`]. Values are checked where they are used.

use super::jaws::JawsSection;
use super::wound::{BodyContactSection, ThreadSection, TissueContactSection};
use schemars::JsonSchema;
use serde::Deserialize;
use toml::Spanned;
use toml::de::DeTable;

/// Keys at the top of a scene's file, but for those by which it adds sources.
pub const KEYS: [&str; 21] = [
    "name",
    "seconds",
    "device",
    "solve_at_s",
    "gravity_m_per_s2",
    "settle",
    "mesh",
    "tissue",
    "region",
    "fixed",
    "tool",
    "needle",
    "thread",
    "jaws",
    "tissue_contact",
    "body_contact",
    "needle_solver",
    "handle",
    "load",
    "hand",
    "host",
];

// Without the keys by which it adds sources.
/// A whole scene file.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SceneFile {
    /// For people; the file's stem when left out.
    pub name: Option<String>,
    /// How long a session lasts \[s\].
    #[schemars(with = "Option<f64>", extend("exclusiveMinimum" = 0.0, "maximum" = 86400.0))]
    pub seconds: Option<Spanned<f64>>,
    /// Name of a device, or path of a device file ending in `.toml`.
    #[schemars(with = "Option<String>")]
    pub device: Option<Spanned<String>>,
    /// Until when `sutura solve` follows the scripts of hands and tools \[s\], in scenes with needles; to the end
    /// when left out.
    #[schemars(with = "Option<f64>")]
    pub solve_at_s: Option<Spanned<f64>>,
    /// What tissue and threads fall with \[m/s^2\], (3), world frame; tissue weighs nothing when left out.
    #[schemars(with = "Option<[f64; 3]>")]
    pub gravity_m_per_s2: Option<Spanned<[f64; 3]>>,
    /// Whether the tissue begins at rest under its weight and its loads, as it does when left out; else it begins as the mesh
    /// has it, and the first solves bring it to rest.
    #[schemars(with = "Option<bool>")]
    pub settle: Option<Spanned<bool>>,
    /// Where the tissue is.
    #[schemars(with = "MeshSection")]
    pub mesh: Spanned<MeshSection>,
    /// What the tissue is made of.
    pub tissue: TissueSection,
    /// Parts of the tissue that are made of something else.
    #[serde(default)]
    #[schemars(with = "Vec<RegionSection>")]
    pub region: Vec<Spanned<RegionSection>>,
    /// Nodes that do not move.
    #[serde(default)]
    #[schemars(with = "Vec<Selection>")]
    pub fixed: Vec<Spanned<Selection>>,
    /// Tools that can touch the tissue, or hold needles.
    #[serde(default)]
    #[schemars(with = "Vec<ToolSection>")]
    pub tool: Vec<Spanned<ToolSection>>,
    /// Needles.
    #[serde(default)]
    #[schemars(with = "Vec<NeedleSection>")]
    pub needle: Vec<Spanned<NeedleSection>>,
    /// Threads.
    #[serde(default)]
    #[schemars(with = "Vec<ThreadSection>")]
    pub thread: Vec<Spanned<ThreadSection>>,
    /// Jaws that take hold of tissue.
    #[serde(default)]
    #[schemars(with = "Vec<JawsSection>")]
    pub jaws: Vec<Spanned<JawsSection>>,
    /// Parts of the tissue that may touch.
    #[serde(default)]
    #[schemars(with = "Vec<TissueContactSection>")]
    pub tissue_contact: Vec<Spanned<TissueContactSection>>,
    /// Threads that may lie on bodies of grips and needles.
    #[serde(default)]
    #[schemars(with = "Vec<BodyContactSection>")]
    pub body_contact: Vec<Spanned<BodyContactSection>>,
    /// Speed against accuracy of needles.
    #[schemars(with = "Option<NeedleSolverSection>")]
    pub needle_solver: Option<Spanned<NeedleSolverSection>>,
    /// Points of tissue that are moved to a target.
    #[serde(default)]
    pub handle: Vec<HandleSection>,
    /// Forces on nodes.
    #[serde(default)]
    pub load: Vec<LoadSection>,
    /// The hand on a simulated console's grip.
    #[schemars(with = "Option<HandSection>")]
    pub hand: Option<Spanned<HandSection>>,
    /// How the host works.
    #[serde(default)]
    pub host: HostSection,
}

impl SceneFile {
    /// From a file's table without keys of added sources.
    ///
    /// # Errors
    /// What is not of a scene's file, and where.
    pub fn read(table: Spanned<DeTable<'_>>) -> Result<SceneFile, toml::de::Error> {
        SceneFile::deserialize(toml::Deserializer::from(table))
    }
}

/// `[mesh]`: a file with its scale, a structured slab, or several parts.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MeshSection {
    /// gmsh file, relative to the scene file.
    #[schemars(with = "Option<String>")]
    pub file: Option<Spanned<String>>,
    /// Metres per mesh unit: 0.001 for a mesh in millimetres. A body above 2 m or below 2 mm is warned of.
    #[schemars(with = "Option<f64>", extend("exclusiveMinimum" = 0.0))]
    pub scale_to_m: Option<Spanned<f64>>,
    /// Cell array of a .vtk or .vtu file that has the regions; one of a name that is known when left out.
    #[schemars(with = "Option<String>")]
    pub region_array: Option<Spanned<String>>,
    /// Structured slab, centred in x and y, top at z = 0.
    #[schemars(with = "Option<SlabSection>")]
    pub slab: Option<Spanned<SlabSection>>,
    /// Slabs and tubes beside each other, not connected.
    #[serde(default)]
    #[schemars(with = "Vec<PartSection>")]
    pub part: Vec<Spanned<PartSection>>,
}

/// `[[mesh.part]]`: a slab or a tube at its place; its cells are a region.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PartSection {
    /// Name of the region; its number is the part's place in the list, from 1.
    pub name: Option<String>,
    /// A structured slab.
    #[schemars(with = "Option<SlabSection>")]
    pub slab: Option<Spanned<SlabSection>>,
    /// A structured tube.
    #[schemars(with = "Option<TubeSection>")]
    pub tube: Option<Spanned<TubeSection>>,
    /// Where the middle of the slab's top, or of the tube, is \[m\], (3); the origin when left out.
    #[schemars(with = "Option<[f64; 3]>")]
    pub at_m: Option<Spanned<[f64; 3]>>,
}

/// A tube of `[[mesh.part]]`.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TubeSection {
    /// Inner and outer radius \[m\], (2).
    #[schemars(with = "[f64; 2]")]
    pub radii_m: Spanned<[f64; 2]>,
    /// Along its axis \[m\].
    #[schemars(with = "f64")]
    pub length_m: Spanned<f64>,
    /// Along radius, circumference and axis, (3); at least 3 around.
    #[schemars(with = "[usize; 3]")]
    pub divisions: Spanned<[usize; 3]>,
    /// Which way it lies; z when left out.
    pub axis: Option<Axis>,
}

/// `[mesh.slab]`, and a slab of `[[mesh.part]]`.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SlabSection {
    /// Along x, y, z \[m\], (3). A body above 2 m or below 2 mm is warned of.
    #[schemars(with = "[f64; 3]", extend("items" = {"type": "number", "exclusiveMinimum": 0.0}))]
    pub size_m: Spanned<[f64; 3]>,
    /// Cubes along x, y, z, (3).
    #[schemars(with = "[usize; 3]")]
    pub divisions: Spanned<[usize; 3]>,
}

/// Tissue models by name.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum TissueModel {
    /// Linear elasticity, small displacements.
    #[default]
    Linear,
    /// Linear elasticity that turns with each element: large rotations, small strains.
    Corotational,
    /// Neo-Hookean finite elements in balance by Newton's method.
    Hyperelastic,
    /// Neo-Hookean cells whose energies balance at the nodes, without a matrix; sessions only, and tools stick to it, as to all
    /// that follow.
    EnergyBalanceNeoHookean,
    /// St Venant-Kirchhoff cells whose energies balance at the nodes, without a matrix.
    EnergyBalanceStvk,
    /// Chains of nodes with limits, one material.
    ChainmailClassical,
    /// Chains of nodes with limits by cell.
    ChainmailEllipsoid,
    /// Clusters of nodes that keep their shape.
    ShapeMatching,
    /// What holds the session's budget, by measurement before it begins; linear where there is no session.
    Auto,
}

impl TissueModel {
    /// Whether its density is that of masses which move, besides what it weighs.
    pub fn has_mass(self) -> bool {
        !matches!(
            self,
            TissueModel::Linear | TissueModel::Corotational | TissueModel::Hyperelastic
        )
    }

    /// As the file writes it.
    pub fn word(self) -> &'static str {
        match self {
            TissueModel::Linear => "linear",
            TissueModel::Corotational => "corotational",
            TissueModel::Hyperelastic => "hyperelastic",
            TissueModel::EnergyBalanceNeoHookean => "energy-balance-neo-hookean",
            TissueModel::EnergyBalanceStvk => "energy-balance-stvk",
            TissueModel::ChainmailClassical => "chainmail-classical",
            TissueModel::ChainmailEllipsoid => "chainmail-ellipsoid",
            TissueModel::ShapeMatching => "shape-matching",
            TissueModel::Auto => "auto",
        }
    }
}

/// `[tissue]`: model, and the material of every cell that no region names.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TissueSection {
    /// Which model.
    #[serde(default)]
    pub model: TissueModel,
    /// One of the model's settings by name, of models that have such; the usual one when left out.
    #[schemars(with = "Option<String>")]
    pub setting: Option<Spanned<String>>,
    /// Young's modulus \[Pa\]: soft tissue has 1e3 to 1e6. What is too stiff to be felt is warned of.
    #[schemars(with = "f64", extend("exclusiveMinimum" = 0.0))]
    pub youngs_modulus_pa: Spanned<f64>,
    /// Poisson's ratio.
    #[schemars(with = "f64", extend("exclusiveMinimum" = -1.0, "exclusiveMaximum" = 0.5))]
    pub poisson_ratio: Spanned<f64>,
    /// Density \[kg/m^3\], for weight under `gravity_m_per_s2`, and for models with masses, where it is 1050 when left out.
    #[schemars(with = "Option<f64>", extend("minimum" = 1.0, "maximum" = 30000.0))]
    pub density_kg_per_m3: Option<Spanned<f64>>,
    /// Stress relaxation at a held pose, of energy-balance-neo-hookean tissue; none when left out.
    #[schemars(with = "Option<RelaxationSection>")]
    pub relaxation: Option<Spanned<RelaxationSection>>,
    /// How the tissue answers needles; scenes with needles need it.
    #[schemars(with = "Option<NeedleTissueSection>")]
    pub needle: Option<Spanned<NeedleTissueSection>>,
    /// Speed against accuracy of the corotational model.
    #[schemars(with = "Option<CorotationalSection>")]
    pub corotational: Option<Spanned<CorotationalSection>>,
}

/// `relaxation = { share = .., time_s = .. }` of `[tissue]`: one term of a Prony series.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RelaxationSection {
    /// Share of the stress that fades.
    #[schemars(with = "f64", extend("exclusiveMinimum" = 0.0, "exclusiveMaximum" = 1.0))]
    pub share: Spanned<f64>,
    /// Time in which it fades to a part of 1/e \[s\].
    #[schemars(with = "f64", extend("minimum" = 0.001, "maximum" = 10000.0))]
    pub time_s: Spanned<f64>,
}

/// `[tissue.corotational]`: when the stiffness is factored again, and what is done in between.
#[derive(Debug, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CorotationalSection {
    /// Factor again once an element has turned by so much since the last time \[degree\].
    #[schemars(with = "Option<f64>")]
    pub refactor_rotation_deg: Option<Spanned<f64>>,
    /// Factor again after so many passes at the latest; 1 factors in every pass.
    #[schemars(with = "Option<u32>")]
    pub refactor_every: Option<Spanned<u32>>,
    /// Iterations of conjugate gradients in a pass, with the old factor as preconditioner.
    #[schemars(with = "Option<u32>")]
    pub cg_iterations: Option<Spanned<u32>>,
    /// Most passes of a step: each linearises the tissue anew.
    #[schemars(with = "Option<u32>")]
    pub passes: Option<Spanned<u32>>,
    /// Passes end when the out-of-balance force has fallen below this share of the forces.
    #[schemars(with = "Option<f64>")]
    pub tolerance: Option<Spanned<f64>>,
}

/// `[[region]]`: cells with a material of their own.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RegionSection {
    /// Number or name of a region of the mesh file.
    #[schemars(with = "Option<RegionTag>")]
    pub tag: Option<Spanned<RegionTag>>,
    /// All cells whose centroid lies in a closed box.
    #[serde(rename = "box")]
    #[schemars(with = "Option<Cuboid>")]
    pub cuboid: Option<Spanned<Cuboid>>,
    /// Young's modulus \[Pa\]: soft tissue has 1e3 to 1e6. What is too stiff to be felt is warned of.
    #[schemars(with = "f64", extend("exclusiveMinimum" = 0.0))]
    pub youngs_modulus_pa: Spanned<f64>,
    /// Poisson's ratio.
    #[schemars(with = "f64", extend("exclusiveMinimum" = -1.0, "exclusiveMaximum" = 0.5))]
    pub poisson_ratio: Spanned<f64>,
    /// Density \[kg/m^3\], for weight under `gravity_m_per_s2`; that of `[tissue]` when left out.
    #[schemars(with = "Option<f64>", extend("minimum" = 1.0, "maximum" = 30000.0))]
    pub density_kg_per_m3: Option<Spanned<f64>>,
    /// How this part answers needles, where it does so in its own way.
    #[schemars(with = "Option<NeedleTissueSection>")]
    pub needle: Option<Spanned<NeedleTissueSection>>,
}

/// How tissue answers needles: `[tissue.needle]`, and `needle = { .. }` of a region, which has what it leaves
/// out from `[tissue.needle]`.
#[derive(Debug, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct NeedleTissueSection {
    /// Axial force per length of needle in tissue while it slides \[N/m\].
    #[schemars(with = "Option<f64>")]
    pub friction_n_per_m: Option<Spanned<f64>>,
    /// The same before it begins to slide \[N/m\]; that while it slides when left out.
    #[schemars(with = "Option<f64>")]
    pub static_friction_n_per_m: Option<Spanned<f64>>,
    /// Added to the sliding friction per speed \[N s/m^2\]; 0 when left out.
    #[schemars(with = "Option<f64>")]
    pub viscous_n_s_per_m2: Option<Spanned<f64>>,
    /// Force that cuts on, per area of the tip \[Pa\]; 0 when left out.
    #[schemars(with = "Option<f64>")]
    pub cutting_pa: Option<Spanned<f64>>,
    /// Force on the tip that breaks through a boundary, per area of the tip \[Pa\]; `inf`: never. What acts along the needle
    /// counts; across the surface, from outside, where `surface_friction` is finite.
    #[schemars(with = "Option<f64>")]
    pub puncture_pa: Option<Spanned<f64>>,
    /// Coulomb's coefficient of the needle on the surface, from outside; `inf` when left out: its tip never slips.
    #[schemars(with = "Option<f64>")]
    pub surface_friction: Option<Spanned<f64>>,
}

/// How a mesh file calls a region.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(
    untagged,
    expecting = "expected the number or the name of a region of the mesh"
)]
pub enum RegionTag {
    /// gmsh's physical group, tetgen's attribute; 0 for cells without.
    Number(i64),
    /// Its name, if the file has one.
    Name(String),
}

impl std::fmt::Display for RegionTag {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Number(number) => write!(f, "{number}"),
            Self::Name(name) => write!(f, "\"{name}\""),
        }
    }
}

/// Nodes of the mesh, in one of three ways.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Selection {
    /// All nodes on a plane across an axis.
    pub plane: Option<Plane>,
    /// All nodes in a closed box.
    #[serde(rename = "box")]
    pub cuboid: Option<Cuboid>,
    /// These nodes, counted from 0 in the mesh file's order.
    #[schemars(with = "Option<Vec<u32>>")]
    pub nodes: Option<Spanned<Vec<u32>>>,
}

/// A plane across a world axis.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Plane {
    /// The axis that is normal to it.
    pub axis: Axis,
    /// Where it cuts the axis \[m\].
    pub at_m: f64,
    /// How far off a node may be \[m\]; 1 um when left out, below any mesh edge.
    #[serde(default = "one_micrometre")]
    pub within_m: f64,
}

fn one_micrometre() -> f64 {
    1e-6
}

/// A world axis.
#[derive(Clone, Copy, Debug, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
#[allow(missing_docs, reason = "they are what they are called")]
pub enum Axis {
    X,
    Y,
    Z,
}

/// A closed box along the world axes.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Cuboid {
    /// Lowest corner \[m\], (3).
    pub min_m: [f64; 3],
    /// Highest corner \[m\], (3).
    pub max_m: [f64; 3],
}

impl Cuboid {
    /// Whether a point lies in it or on its boundary.
    pub fn contains(&self, x: [f64; 3]) -> bool {
        (0..3).all(|i| self.min_m[i] <= x[i] && x[i] <= self.max_m[i])
    }
}

/// Shapes of tools by name.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum ToolShape {
    /// A ball.
    #[default]
    Sphere,
    /// A round bar that ends in a flat face with a rounded rim.
    FlatPunch,
    /// A round bar with half a ball at both ends.
    Capsule,
    /// A box with rounded edges and corners.
    RoundedBox,
    /// A closed surface of triangles from a file, its edges rounded.
    Mesh,
    /// Touches nothing, and holds a needle.
    Grip,
}

/// `[[tool]]`: a rigid shape on a grip.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ToolSection {
    /// Number on the wire; its place in the list when left out.
    #[schemars(with = "Option<u8>")]
    pub id: Option<Spanned<u8>>,
    /// What touches.
    #[serde(default)]
    pub shape: ToolShape,
    /// Radius of the sphere, or of the bar of a punch or a capsule \[m\]; one larger than the body is warned of.
    #[schemars(with = "Option<f64>", extend("minimum" = 0.0))]
    pub radius_m: Option<Spanned<f64>>,
    /// Of a box, from face to face: along `side`, across both, and along `axis`; for one that looks down along x, y and z
    /// \[m\], (3).
    #[schemars(with = "Option<[f64; 3]>", extend("items" = {"type": "number", "exclusiveMinimum": 0.0}))]
    pub size_m: Option<Spanned<[f64; 3]>>,
    /// STL file of a closed surface, binary or ASCII, relative to the scene file.
    #[schemars(with = "Option<String>")]
    pub mesh: Option<Spanned<String>>,
    /// Metres per unit of that file: 0.001 for millimetres.
    #[schemars(with = "Option<f64>", extend("exclusiveMinimum" = 0.0))]
    pub scale_to_m: Option<Spanned<f64>>,
    /// Radius of a punch's rounded rim, or of a box's edges and corners, or by which a mesh is larger all around \[m\]; a
    /// tenth of the punch's radius, of half the box's least size, or of the largest ball's in the mesh when left out.
    #[schemars(with = "Option<f64>")]
    pub fillet_m: Option<Spanned<f64>>,
    /// Length of a punch's bar behind its face, or of a capsule from centre to centre of its ends \[m\]; four radii when
    /// left out.
    #[schemars(with = "Option<f64>")]
    pub length_m: Option<Spanned<f64>>,
    /// Where the front of a punch, a capsule or a box looks, or -z of a mesh, in the grip's frame, of any length, (3); down
    /// when left out.
    #[schemars(with = "Option<[f64; 3]>")]
    pub axis: Option<Spanned<[f64; 3]>>,
    /// Where the side of a box, or x of a mesh, looks in the grip's frame, of any length, (3); only what of it lies across
    /// `axis` counts. x when left out.
    #[schemars(with = "Option<[f64; 3]>")]
    pub side: Option<Spanned<[f64; 3]>>,
    /// Centre of the sphere, of the ball at a capsule's front, or of the front face of a punch or a box, or origin of a mesh,
    /// in the grip's frame \[m\], (3).
    #[schemars(with = "Option<[f64; 3]>")]
    pub offset_m: Option<Spanned<[f64; 3]>>,
    /// Coulomb's coefficient of the tool on tissue while it slides; 0 when left out.
    #[schemars(with = "Option<f64>")]
    pub friction: Option<Spanned<f64>>,
    /// The same while it sticks, at least `friction`; the same when left out.
    #[schemars(with = "Option<f64>")]
    pub static_friction: Option<Spanned<f64>>,
    /// From how far a grip takes a needle or a thread that it is to hold \[m\]; 0.005 when left out.
    #[schemars(with = "Option<f64>")]
    pub reach_m: Option<Spanned<f64>>,
    /// Of a grip: what of it touches the tissue. Nothing when left out.
    #[schemars(with = "Option<GripBodySection>")]
    pub body: Option<Spanned<GripBodySection>>,
    /// Whether the console's grip carries this tool, as one tool in a scene; the first when no tool says so.
    #[schemars(with = "Option<bool>")]
    pub driven: Option<Spanned<bool>>,
    /// Where the grip is held \[m\], (3): always if another tool is driven, else by `sutura solve`.
    #[schemars(with = "Option<[f64; 3]>")]
    pub position_m: Option<Spanned<[f64; 3]>>,
    /// How the grip is held there: unit quaternion (x, y, z, w).
    #[schemars(with = "Option<[f64; 4]>")]
    pub orientation: Option<Spanned<[f64; 4]>>,
    /// How the grip turns, and, if the console does not carry it, where it goes.
    #[serde(default)]
    #[schemars(with = "Vec<ToolWayPointSection>")]
    pub way_point: Vec<Spanned<ToolWayPointSection>>,
}

/// `body` of a `[[tool]]` that is a grip: a round bar with half a ball at both ends.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct GripBodySection {
    /// Of the bar \[m\].
    #[schemars(with = "f64", extend("exclusiveMinimum" = 0.0))]
    pub radius_m: Spanned<f64>,
    /// From centre to centre of its ends \[m\].
    #[schemars(with = "f64")]
    pub length_m: Spanned<f64>,
    /// Where its front looks in the grip's frame, of any length, (3); down when left out.
    #[schemars(with = "Option<[f64; 3]>")]
    pub axis: Option<Spanned<[f64; 3]>>,
    /// Centre of the ball at its front, in the grip's frame \[m\], (3); the grip when left out.
    #[schemars(with = "Option<[f64; 3]>")]
    pub offset_m: Option<Spanned<[f64; 3]>>,
    /// Coulomb's coefficient on tissue; 0 when left out.
    #[schemars(with = "Option<f64>")]
    pub friction: Option<Spanned<f64>>,
}

/// `[[tool.way_point]]`: between two of them with minimum jerk, from rest to rest.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ToolWayPointSection {
    /// Since the session began \[s\].
    #[schemars(with = "f64")]
    pub time_s: Spanned<f64>,
    /// How the grip is turned: axis in the world frame times angle \[degree\], (3); not turned when left out.
    #[schemars(with = "Option<[f64; 3]>")]
    pub rotation_deg: Option<Spanned<[f64; 3]>>,
    /// Where the grip is \[m\], (3); only of tools that the console does not carry, and then of every point.
    #[schemars(with = "Option<[f64; 3]>")]
    pub position_m: Option<Spanned<[f64; 3]>>,
}

/// Shapes of needles by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum NeedleShapeName {
    /// Straight.
    Straight,
    /// Part of a circle.
    Arc,
    /// Straight and circular parts one after the other.
    Segments,
}

/// A part of a needle of `segments`, with the tangent of the one before it where the two meet.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct NeedleSegmentSection {
    /// Arc length \[m\].
    #[schemars(with = "f64")]
    pub length_m: Spanned<f64>,
    /// Radius of the circle \[m\]; straight when left out.
    #[schemars(with = "Option<f64>", extend("exclusiveMinimum" = 0.0))]
    pub radius_m: Option<Spanned<f64>>,
}

/// `[[needle]]`: its shape, where it is when the session begins, and who holds it when.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct NeedleSection {
    /// Number on the wire; its place in the list when left out.
    #[schemars(with = "Option<u8>")]
    pub id: Option<Spanned<u8>>,
    /// Straight, part of a circle, or several of both.
    pub shape: NeedleShapeName,
    /// From end to tip \[m\], of a straight needle.
    #[schemars(with = "Option<f64>")]
    pub length_m: Option<Spanned<f64>>,
    /// Radius of the circle \[m\], of an arc.
    #[schemars(with = "Option<f64>", extend("exclusiveMinimum" = 0.0))]
    pub radius_m: Option<Spanned<f64>>,
    /// From end to tip \[degree\], of an arc; less than 360.
    #[schemars(with = "Option<f64>")]
    pub angle_deg: Option<Spanned<f64>>,
    /// From end to tip, of a needle of segments, (1 to 6).
    #[schemars(with = "Option<Vec<NeedleSegmentSection>>")]
    pub segments: Option<Spanned<Vec<NeedleSegmentSection>>>,
    /// Diameter \[m\].
    #[schemars(with = "f64", extend("exclusiveMinimum" = 0.0))]
    pub thickness_m: Spanned<f64>,
    /// Where its end, opposite to the tip, is at the start \[m\], (3).
    #[schemars(with = "[f64; 3]")]
    pub end_m: Spanned<[f64; 3]>,
    /// Which way it goes at its end, towards the tip, of any length, (3).
    #[schemars(with = "[f64; 3]")]
    pub direction: Spanned<[f64; 3]>,
    /// From the end to the circle's centre, of any length, (3); of an arc, or of segments: to the side that they bend to. Only what of it lies across
    /// `direction` counts.
    #[schemars(with = "Option<[f64; 3]>")]
    pub towards: Option<Spanned<[f64; 3]>>,
    /// Whether its shaft touches the surface where it is outside of the tissue.
    #[serde(default)]
    pub body: bool,
    /// What it is made of \[kg/m^3\]: with the scene's gravity it falls where nobody holds it; steel has 7900. Needs `body`.
    #[schemars(with = "Option<f64>", extend("minimum" = 1.0, "maximum" = 30_000.0))]
    pub density_kg_per_m3: Option<Spanned<f64>>,
    /// Who holds it, from when on.
    #[serde(default)]
    #[schemars(with = "Vec<NeedleHoldSection>")]
    pub hold: Vec<Spanned<NeedleHoldSection>>,
}

/// `[[needle.hold]]`: from this time on a tool holds the needle where it happens to be, once that is within its reach, or none
/// does.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct NeedleHoldSection {
    /// Since the session began \[s\]; the first is 0.
    #[schemars(with = "f64")]
    pub time_s: Spanned<f64>,
    /// Id of a tool that is a grip; the needle is let go when left out. Who held it before goes on until it is taken.
    #[schemars(with = "Option<u8>")]
    pub tool: Option<Spanned<u8>>,
}

/// What follows a puncture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum PlaybackName {
    /// The way since the first contact is tracked at once, and solved once at its end.
    #[default]
    OneSolve,
    /// The same, with a solve at each of up to 16 poses on the way.
    EveryPose,
}

/// `[needle_solver]`: speed against accuracy of needles.
#[derive(Debug, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct NeedleSolverSection {
    /// What follows a puncture.
    #[serde(default)]
    pub playback: PlaybackName,
}

/// `[[handle]]`: a point of tissue by barycentric coordinates, and where it goes.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct HandleSection {
    /// For people and output.
    pub name: Option<String>,
    /// Nodes of a face or cell, counted from 0, (1 to 4).
    #[schemars(with = "Vec<u32>")]
    pub vertices: Spanned<Vec<u32>>,
    /// Weights of these nodes, sum 1, (as many).
    #[schemars(with = "Vec<f64>")]
    pub barycentric: Spanned<Vec<f64>>,
    /// How far the point is moved \[m\], (3).
    #[schemars(with = "[f64; 3]")]
    pub target_displacement_m: Spanned<[f64; 3]>,
}

/// `[[load]]`: a force spread equally over some nodes.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LoadSection {
    /// Where it acts.
    #[schemars(with = "Selection")]
    pub on: Spanned<Selection>,
    /// Sum over the nodes \[N\], (3).
    #[schemars(with = "[f64; 3]")]
    pub total_force_n: Spanned<[f64; 3]>,
}

/// `[hand]`: spring and damper between the grip and a path of minimum-jerk segments.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct HandSection {
    /// Stiffness \[N/m\].
    #[schemars(with = "f64")]
    pub stiffness_n_per_m: Spanned<f64>,
    /// Damping \[N s/m\].
    #[schemars(with = "f64")]
    pub damping_n_s_per_m: Spanned<f64>,
    /// The path; the grip starts at its first point.
    #[schemars(with = "Vec<WayPointSection>")]
    pub way_point: Spanned<Vec<WayPointSection>>,
}

/// `[[hand.way_point]]`.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct WayPointSection {
    /// Since the session began \[s\].
    #[schemars(with = "f64")]
    pub time_s: Spanned<f64>,
    /// Where the hand wants the grip \[m\], (3).
    #[schemars(with = "[f64; 3]")]
    pub position_m: Spanned<[f64; 3]>,
}

/// `[host]`.
#[derive(Debug, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct HostSection {
    /// Solver steps a second \[Hz\].
    #[schemars(with = "Option<f64>", extend("minimum" = 1.0, "maximum" = 1000.0))]
    pub host_hz: Option<Spanned<f64>>,
    /// How long the console may use a contact frame at least \[ms\], from its console time; measured delays and solves make
    /// it longer.
    #[schemars(with = "Option<f64>", extend("exclusiveMinimum" = 0.0, "maximum" = 150.0))]
    pub horizon_ms: Option<Spanned<f64>>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_are_those_of_the_file() {
        let schema = schemars::SchemaGenerator::default().into_root_schema_for::<SceneFile>();
        let properties = schema.get("properties").and_then(|all| all.as_object());
        let mut keys: Vec<&String> = properties.into_iter().flat_map(|all| all.keys()).collect();
        let mut known = KEYS.to_vec();
        keys.sort_unstable();
        known.sort_unstable();
        assert_eq!(keys, known);
    }
}
