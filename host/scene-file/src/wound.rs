//! What a scene file may say of threads, of tissue that touches tissue and of bodies that touch each other, key by key, as in
//! [`super::scene`].
//!
//! Entry points: [`ThreadSection`], [`TissueContactSection`], [`BodyContactSection`].

use super::scene::{RegionTag, Selection};
use schemars::JsonSchema;
use serde::Deserialize;
use toml::Spanned;

/// `[[thread]]`: fastened to the end of a needle.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ThreadSection {
    /// Number on the wire; its place in the list when left out.
    #[schemars(with = "Option<u8>")]
    pub id: Option<Spanned<u8>>,
    /// Id of the needle whose end it is fastened to.
    #[schemars(with = "u8")]
    pub needle: Spanned<u8>,
    /// From tail to head \[m\].
    #[schemars(with = "f64")]
    pub length_m: Spanned<f64>,
    /// Coulomb's coefficient against tissue; none when left out.
    #[schemars(with = "Option<f64>")]
    pub friction: Option<Spanned<f64>>,
    /// Tension that it bears \[N\]; 20 when left out.
    #[schemars(with = "Option<f64>")]
    pub strength_n: Option<Spanned<f64>>,
    /// EA, tension over strain \[N\]; `inf`, or left out, for one that does not stretch.
    #[schemars(with = "Option<f64>")]
    pub axial_stiffness_n: Option<Spanned<f64>>,
    /// Drag of tissue along it, per length in tissue \[N/m\]; none when left out.
    #[schemars(with = "Option<f64>")]
    pub drag_n_per_m: Option<Spanned<f64>>,
    /// What a tool's grip holds before the thread slips through it \[N\]; all when left out.
    #[schemars(with = "Option<f64>")]
    pub grip_n: Option<Spanned<f64>>,
    /// What a knot holds before it opens \[N\]; all when left out.
    #[schemars(with = "Option<f64>")]
    pub knot_n: Option<Spanned<f64>>,
    /// Diameter, over which it presses on tissue \[m\]; 0.0003 when left out.
    #[schemars(with = "Option<f64>")]
    pub thickness_m: Option<Spanned<f64>>,
    /// Pressure on tissue above which that would tear, which is warned of \[Pa\]; none when left out.
    #[schemars(with = "Option<f64>")]
    pub tear_pa: Option<Spanned<f64>>,
    /// Whether taut spans outside keep out of the tissue within every step.
    #[serde(default)]
    pub body: bool,
    /// What holds its ends, from when on.
    #[serde(default)]
    #[schemars(with = "Vec<ThreadHoldSection>")]
    pub hold: Vec<Spanned<ThreadHoldSection>>,
    /// When it is cut, and where.
    #[serde(default)]
    #[schemars(with = "Vec<ThreadCutSection>")]
    pub cut: Vec<Spanned<ThreadCutSection>>,
    /// When what of it bridges punctures is shortened.
    #[serde(default)]
    #[schemars(with = "Vec<ThreadTightenSection>")]
    pub tighten: Vec<Spanned<ThreadTightenSection>>,
}

/// An end of a thread.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum ThreadEndName {
    /// The one that follows.
    Tail,
    /// The one at the needle.
    Head,
    /// No end: what is outside the tissue, where it is nearest to the hand. Hands there divide it.
    Span,
}

/// `[[thread.cut]]`: it is cut outside the tissue, where it is nearest to a tool or a place.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ThreadCutSection {
    /// Since the session began \[s\].
    #[schemars(with = "f64")]
    pub time_s: Spanned<f64>,
    /// Id of a tool that is a grip, once the thread is within its reach.
    #[schemars(with = "Option<u8>")]
    pub tool: Option<Spanned<u8>>,
    /// A place \[m\], (3).
    #[schemars(with = "Option<[f64; 3]>")]
    pub at_m: Option<Spanned<[f64; 3]>>,
    /// Both ends have a knot that is too thick for a puncture: what is sewn stays drawn together, and the next stitch begins with one.
    #[serde(default)]
    pub knots: bool,
}

/// `[[thread.hold]]`: from this time on an end is held by a tool, at a place, by a knot, or by nothing.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ThreadHoldSection {
    /// Since the session began \[s\].
    #[schemars(with = "f64")]
    pub time_s: Spanned<f64>,
    /// Which end, or a span.
    pub end: ThreadEndName,
    /// Id of a tool that is a grip: it takes the thread without slack, once that is within its reach, where it is then.
    #[schemars(with = "Option<u8>")]
    pub tool: Option<Spanned<u8>>,
    /// Where the end is held \[m\], (3).
    #[schemars(with = "Option<[f64; 3]>")]
    pub at_m: Option<Spanned<[f64; 3]>>,
    /// A knot at the tail, too thick for the first puncture: true, or left out.
    #[schemars(with = "Option<bool>")]
    pub knot: Option<Spanned<bool>>,
    /// The `tool` lets go of the head or the span that it holds: true, or left out.
    #[schemars(with = "Option<bool>")]
    pub lets_go: Option<Spanned<bool>>,
}

/// `[[thread.tighten]]`: hands hold the thread where spans that bridge two parts of the tissue end, and draw it out of them until there is
/// thread for a part of their length in the unloaded mesh.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ThreadTightenSection {
    /// When it begins, since the session began \[s\].
    #[schemars(with = "f64")]
    pub time_s: Spanned<f64>,
    /// When it is done \[s\]; in between in proportion to time.
    #[schemars(with = "f64")]
    pub until_s: Spanned<f64>,
    /// Part of the length in the unloaded mesh that is left then, 0 to 1.
    #[schemars(with = "f64")]
    pub ratio: Spanned<f64>,
    /// Whether one span comes after the other, from the tail on; all together when left out.
    #[serde(default)]
    pub in_turn: bool,
    /// Tension in a span at which its hand draws no further \[N\]; it draws on when left out.
    #[schemars(with = "Option<f64>")]
    pub most_n: Option<Spanned<f64>>,
}

/// `[[tissue_contact]]`: two parts of the tissue may touch.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TissueContactSection {
    /// Regions of the mesh, by number or name, (2); one twice for folds of a part that touch each other.
    #[schemars(with = "[RegionTag; 2]")]
    pub between: [Spanned<RegionTag>; 2],
    /// Coulomb's coefficient; none when left out.
    #[schemars(with = "Option<f64>")]
    pub friction: Option<Spanned<f64>>,
    /// Nodes of each part whose distance to the other part is the gap of the report, (2); no gap is reported when left
    /// out.
    #[schemars(with = "Option<[Selection; 2]>")]
    pub rims: Option<[Spanned<Selection>; 2]>,
}

/// `[[body_contact]]`: taut spans of a thread lie on a body instead of going through it, or two bodies press on each other.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BodyContactSection {
    /// A thread, and a tool or a needle with a body; or two tools with bodies, or one and a needle, (2).
    #[schemars(with = "[BodyName; 2]")]
    pub between: [Spanned<BodyName>; 2],
    /// Of two bodies: normal force per overlap \[N/m\]; 1000 when left out, two thirds of what a console renders stably.
    #[schemars(with = "Option<f64>")]
    pub stiffness_n_per_m: Option<Spanned<f64>>,
    /// Of two bodies: Coulomb's coefficient; 0 when left out.
    #[schemars(with = "Option<f64>")]
    pub friction: Option<Spanned<f64>>,
}

/// How a scene names what touches: `{ thread = 0 }`, `{ tool = 1 }`, `{ needle = 0 }`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum BodyName {
    /// Id of a thread.
    Thread(u8),
    /// Id of a tool that is a grip with a `body`.
    Tool(u8),
    /// Id of a needle with `body = true`.
    Needle(u8),
}
