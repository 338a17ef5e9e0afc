//! What a scene file may say of jaws, key by key, as in [`super::scene`].
//!
//! Entry point: [`JawsSection`].

use schemars::JsonSchema;
use serde::Deserialize;
use toml::Spanned;

/// `[[jaws]]`: two pads on a grip that take hold of tissue.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct JawsSection {
    /// Id of the tool that carries them: a grip that holds no needle and no thread.
    #[schemars(with = "u8")]
    pub tool: Spanned<u8>,
    /// Force with which the pads press on what is between them \[N\]; `inf`: nothing slips.
    #[schemars(with = "f64")]
    pub clamp_n: Spanned<f64>,
    /// Coulomb's coefficient of both pads together: they hold `friction` times `clamp_n` in their plane.
    #[schemars(with = "f64")]
    pub friction: Spanned<f64>,
    /// Length of the pads from the hinge to the front \[m\]; 0.02 when left out.
    #[schemars(with = "Option<f64>")]
    pub length_m: Option<Spanned<f64>>,
    /// Their width along the hinge \[m\]; 0.005 when left out.
    #[schemars(with = "Option<f64>")]
    pub width_m: Option<Spanned<f64>>,
    /// Angle between them while they are open \[degree\]; 60 when left out.
    #[schemars(with = "Option<f64>")]
    pub opening_deg: Option<Spanned<f64>>,
    /// Middle of the closed pads' front edges in the grip's frame \[m\], (3); the grip when left out.
    #[schemars(with = "Option<[f64; 3]>")]
    pub offset_m: Option<Spanned<[f64; 3]>>,
    /// Where they point in the grip's frame, of any length, (3); down when left out.
    #[schemars(with = "Option<[f64; 3]>")]
    pub axis: Option<Spanned<[f64; 3]>>,
    /// Along the hinge in the grip's frame, of any length, (3); only what of it lies across `axis` counts. x when left out.
    #[schemars(with = "Option<[f64; 3]>")]
    pub side: Option<Spanned<[f64; 3]>>,
    /// Most points of tissue that they hold; 8 when left out.
    #[schemars(with = "Option<u32>")]
    pub points: Option<Spanned<u32>>,
    /// Pull over the area of a pad above which the jaws tear off \[Pa\]; none when left out.
    #[schemars(with = "Option<f64>")]
    pub strength_pa: Option<Spanned<f64>>,
    /// When they are closed.
    #[serde(default)]
    #[schemars(with = "Vec<JawsCloseSection>")]
    pub close: Vec<Spanned<JawsCloseSection>>,
}

/// `[[jaws.close]]`: they close, hold, and open.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct JawsCloseSection {
    /// Since the session began \[s\].
    #[schemars(with = "f64")]
    pub from_s: Spanned<f64>,
    /// The same, when they open; never when left out.
    #[schemars(with = "Option<f64>")]
    pub to_s: Option<Spanned<f64>>,
}
