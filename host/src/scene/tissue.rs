//! Tissue models by name, as scenes, command lines and recordings write them.
//!
//! Entry point: [`Tissue::named`]: `linear`, or `shape-matching: 4 rings` with one of the model's settings.

use super::Rendering;
use super::{Corotational, Scene, nearest};
use crate::mesh::TetMesh;
use crate::registry::Substance;
use crate::registry::{Body, Entry, Setting, entries, entry, hyperelastic_setting};
use schemars::JsonSchema;
use serde::Serialize;
use std::fmt;
use sutura_models::hyperelastic::Cells;

/// Density of soft tissue where a scene does not say \[kg/m^3\].
pub const DENSITY_KG_PER_M3: f64 = 1050.0;

/// How tissue answers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Tissue {
    /// Linear elasticity, small displacements.
    Linear,
    /// Linear elasticity that turns with each element, and how closely it is followed.
    Corotational(Corotational),
    /// One of the registry's models. Hyperelastic tissue has rows, on cells with the mesh's own nodes; to all others tools
    /// stick, in sessions only.
    Registered(Registered),
    /// What holds the session's budget, by measurement before it begins; linear where there is no session.
    Auto,
}

/// A model of the [registry](crate::registry) with one of its settings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Registered {
    name: &'static str,
    /// None: the usual one, because none was named.
    setting: Option<usize>,
}

/// How tools touch tissue.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum ContactLaw {
    /// They push along the normal only.
    Frictionless,
    /// They rub, each with its own coefficients.
    Coulomb,
    /// What they touch stays where they touched it, until they would have to pull.
    Sticking,
}

impl ContactLaw {
    /// In words.
    pub fn words(self) -> &'static str {
        match self {
            ContactLaw::Frictionless => "contact without friction",
            ContactLaw::Coulomb => "contact with Coulomb friction",
            ContactLaw::Sticking => "contact that sticks",
        }
    }
}

impl Tissue {
    /// Whether its steps may take as many passes as there is time for: what is not said of corotational tissue.
    pub fn leaves_passes_open(&self) -> bool {
        matches!(self, Tissue::Corotational(own) if own.passes.is_none())
    }

    /// A model by its name, with its usual setting, or as `name: setting`.
    ///
    /// # Errors
    /// What is wrong with it, and what there is.
    pub fn named(text: &str) -> Result<Tissue, String> {
        let (name, setting) = match text.split_once(':') {
            Some((name, setting)) => (name.trim(), Some(setting.trim())),
            None => (text.trim(), None),
        };
        match (name, setting) {
            ("linear", None) => Ok(Tissue::Linear),
            ("auto", None) => Ok(Tissue::Auto),
            ("corotational", Some(setting)) => Corotational::named(setting)
                .map(Tissue::Corotational)
                .ok_or_else(|| format!("no setting of corotational `{setting}`: give `1 pass`, `2 passes` and so on")),
            ("corotational", None) => Ok(Tissue::Corotational(Corotational::default())),
            ("linear" | "auto", Some(_)) => Err(format!("{name} has no settings")),
            _ => Registered::new(name, setting).map(Tissue::Registered),
        }
    }

    /// The name as files and output write it.
    pub fn word(self) -> &'static str {
        match self {
            Tissue::Linear => "linear",
            Tissue::Corotational(_) => "corotational",
            Tissue::Registered(model) => model.name,
            Tissue::Auto => "auto",
        }
    }

    /// In place of what a scene says; its settings stay where it has some for this model.
    pub fn instead_of(self, scenes: Tissue) -> Tissue {
        match (self, scenes) {
            (Tissue::Corotational(own), Tissue::Corotational(scenes)) => {
                Tissue::Corotational(Corotational {
                    passes: own.passes.or(scenes.passes),
                    ..scenes
                })
            }
            (Tissue::Registered(own), Tissue::Registered(scenes)) if own.name == scenes.name => {
                Tissue::Registered(Registered {
                    setting: own.setting.or(scenes.setting),
                    ..own
                })
            }
            _ => self,
        }
    }

    /// Whether it has the compliance that rows need: tools press it with or without friction, and do not stick.
    pub fn has_rows(self) -> bool {
        match self {
            Tissue::Linear | Tissue::Corotational(_) | Tissue::Auto => true,
            Tissue::Registered(model) => model.has_rows(),
        }
    }

    /// The model to which tools stick, if it is one.
    pub fn sticking(self) -> Option<Registered> {
        match self {
            Tissue::Registered(model) if !model.has_rows() => Some(model),
            _ => None,
        }
    }

    /// What a session renders from if nobody says.
    pub fn usual_rendering(self) -> Rendering {
        if self.has_rows() {
            Rendering::Rows
        } else {
            Rendering::Tangent
        }
    }
}

/// The name, with the setting where the model has any by name: [`Tissue::named`] reads it.
impl fmt::Display for Tissue {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.word())?;
        match self {
            Tissue::Registered(model) => write!(f, ": {}", model.setting()),
            Tissue::Corotational(Corotational {
                passes: Some(passes),
                ..
            }) => match passes {
                1 => f.write_str(": 1 pass"),
                _ => write!(f, ": {passes} passes"),
            },
            Tissue::Linear | Tissue::Corotational(_) | Tissue::Auto => Ok(()),
        }
    }
}

impl Corotational {
    /// By its number of passes, all else the solver's choice.
    fn named(setting: &str) -> Option<Self> {
        let passes: u32 = setting
            .strip_suffix(" passes")
            .or(setting.strip_suffix(" pass"))?
            .trim()
            .parse()
            .ok()?;
        (passes > 0).then_some(Corotational {
            passes: Some(passes),
            ..Corotational::default()
        })
    }
}

/// Model of which a scene can say that its stress fades.
pub(crate) const RELAXES: &str = "energy-balance-neo-hookean";

/// Substance of a scene's tissue, but for its numbers: no fibres.
const PLAIN: Substance = Substance {
    material: crate::fem::Material {
        youngs_modulus_pa: 1e4,
        poisson_ratio: 0.45,
    },
    fibres: None,
    relaxation: None,
    density_kg_per_m3: DENSITY_KG_PER_M3,
};

/// Models whose material a scene can describe.
pub fn models() -> Vec<Entry> {
    let mut all = entries();
    all.retain(|entry| (entry.fits)(&PLAIN));
    all
}

impl Registered {
    /// A model and a setting by their names; the usual setting if none is named.
    ///
    /// # Errors
    /// What is wrong with them, and what there is.
    pub fn new(name: &str, setting: Option<&str>) -> Result<Self, String> {
        let models = models();
        let Some(entry) = models.iter().find(|entry| entry.tissue == name) else {
            let mut known: Vec<_> = models.iter().map(|entry| entry.tissue).collect();
            known.push("auto");
            return Err(unknown("tissue model", name, &known));
        };
        let names: Vec<_> = entry.settings.iter().map(|s| s.name.as_str()).collect();
        let index = match setting {
            None => None,
            Some(setting) => match names.iter().position(|name| *name == setting) {
                Some(index) => Some(index),
                None => return Err(unknown(&format!("setting of {name}"), setting, &names)),
            },
        };
        Ok(Registered {
            name: entry.tissue,
            setting: index,
        })
    }

    /// The setting that builds a body: the stress of energy-balance-neo-hookean tissue fades where that of the body does.
    fn find_for(self, body: &Body) -> Option<Setting> {
        let relaxes = self.relaxes() && body.substance.relaxation.is_some();
        let name = if relaxes {
            "energy-balance-prony"
        } else {
            self.name
        };
        let settings = entry(name)?.settings;
        settings.into_iter().nth(self.setting.unwrap_or(0))
    }

    /// Whether its stress may fade.
    pub fn relaxes(self) -> bool {
        self.name == RELAXES
    }

    fn find(self) -> Option<Setting> {
        let settings = entry(self.name)?.settings;
        settings.into_iter().nth(self.setting.unwrap_or(0))
    }

    /// Its name.
    pub fn name(self) -> &'static str {
        self.name
    }

    /// Tissue of this model and setting, made of what `body` says.
    ///
    /// # Errors
    /// Why the model refuses.
    pub fn build(
        self,
        body: &Body,
        mesh: &TetMesh,
    ) -> Result<Box<dyn sutura_models::Tissue>, String> {
        let setting = self
            .find_for(body)
            .ok_or_else(|| format!("{} has no such setting", self.name))?;
        (setting.build)(body, mesh)
    }

    /// Whether it has the compliance that rows need. Quadratic cells have nodes that the mesh does not have.
    pub fn has_rows(self) -> bool {
        self.hyperelastic()
            .is_some_and(|(cells, _)| cells != Cells::Quadratic)
    }

    /// Cells, and the share of the forces that may be left out of balance, of hyperelastic tissue.
    pub(crate) fn hyperelastic(self) -> Option<(Cells, f64)> {
        (self.name == "hyperelastic").then(|| hyperelastic_setting(&self.setting()))?
    }

    /// Its setting in words.
    pub fn setting(self) -> String {
        self.find().map_or_else(String::new, |setting| setting.name)
    }
}

/// That there is no such thing, with what there is.
fn unknown(what: &str, word: &str, known: &[&str]) -> String {
    let all: Vec<_> = known.iter().map(|name| format!("`{name}`")).collect();
    let meant =
        nearest(word, known).map_or_else(String::new, |near| format!("did you mean `{near}`? "));
    format!("no {what} `{word}`: {meant}there are {}", all.join(", "))
}

impl Scene {
    /// Force of its loads and its weight on every node \[N\], (n x 3); empty without either.
    pub(crate) fn node_forces(&self) -> Vec<[f64; 3]> {
        let acting = self.acting().forces;
        if acting.is_empty() {
            return Vec::new();
        }
        let mut forces = vec![[0.0; 3]; self.mesh.points_m().len()];
        for load in &acting {
            for (sum, force) in forces[load.node as usize].iter_mut().zip(load.force_n) {
                *sum += force;
            }
        }
        forces
    }

    /// Whether contacts are rows: [`step`](crate::step::step) takes what has, to all else tools stick.
    pub fn has_rows(&self) -> bool {
        self.tissue.has_rows()
    }

    /// What a session renders from if nobody says.
    pub fn usual_rendering(&self) -> Rendering {
        self.tissue.usual_rendering()
    }

    /// How tools touch its tissue.
    pub fn contact_law(&self) -> ContactLaw {
        let rubs = |tool: &super::Tool| !tool.shape.is_smooth();
        match self.has_rows() {
            false => ContactLaw::Sticking,
            true if self.tools.iter().any(rubs) => ContactLaw::Coulomb,
            true => ContactLaw::Frictionless,
        }
    }

    /// What its tissue is made of, for models of the registry.
    pub fn body(&self) -> Body {
        let cells = self.mesh.cells().len();
        let substance = Substance {
            material: self.materials.of(0),
            density_kg_per_m3: self.density_kg_per_m3,
            relaxation: self.relaxation,
            ..PLAIN
        };
        Body {
            cells: if self.regions.is_empty() {
                Vec::new()
            } else {
                (0..cells).map(|cell| self.materials.of(cell)).collect()
            },
            ..Body::of(substance)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Document;

    #[test]
    fn every_name_is_read_back_with_its_setting() {
        for entry in models() {
            let usual = Tissue::named(entry.tissue).expect(entry.tissue);
            assert_eq!(usual.word(), entry.tissue);
            if !usual.has_rows() {
                for setting in &entry.settings {
                    let text = format!("{}: {}", entry.tissue, setting.name);
                    let tissue = Tissue::named(&text).expect(&text);
                    assert_eq!(tissue.to_string(), text);
                }
            }
            let again = Tissue::named(&usual.to_string()).expect("its own text");
            assert_eq!(again.to_string(), usual.to_string());
        }
    }

    #[test]
    fn a_scenes_settings_stay_where_none_are_named() {
        let named = |text| Tissue::named(text).expect(text);
        for (given, scenes, taken) in [
            (
                "shape-matching",
                "shape-matching: 4 rings",
                "shape-matching: 4 rings",
            ),
            (
                "shape-matching: 2 rings",
                "shape-matching: 4 rings",
                "shape-matching: 2 rings",
            ),
            ("shape-matching", "corotational", "shape-matching: 2 rings"),
            (
                "corotational",
                "corotational: 3 passes",
                "corotational: 3 passes",
            ),
            (
                "corotational: 1 pass",
                "corotational: 3 passes",
                "corotational: 1 pass",
            ),
            ("linear", "shape-matching: 4 rings", "linear"),
        ] {
            let tissue = named(given).instead_of(named(scenes));
            assert_eq!(tissue.to_string(), taken, "{given} in place of {scenes}");
        }
    }

    #[test]
    fn scenes_have_a_word_for_every_model_and_none_besides() {
        let schema = crate::scene::schema();
        let words = schema["$defs"]["TissueModel"]["oneOf"].as_array();
        let words = words.expect("the words").iter();
        let words: Vec<_> = words.filter_map(|word| word["const"].as_str()).collect();
        for word in &words {
            assert_eq!(Tissue::named(word).expect(word).word(), *word);
        }
        let own = models().into_iter().map(|entry| entry.tissue);
        let mut all: Vec<_> = own.chain(["auto"]).collect();
        assert!(all.len() > 5);
        all.retain(|model| !words.contains(model));
        assert!(all.is_empty(), "{all:?}");
    }

    #[test]
    fn what_is_misspelt_is_answered_with_what_there_is() {
        let wrong = Tissue::named("hyperelastc").expect_err("no such model");
        assert!(wrong.contains("did you mean `hyperelastic`?"), "{wrong}");
        assert!(wrong.contains("`shape-matching`"), "{wrong}");
        let wrong = Tissue::named("shape-matching: 3 rings").expect_err("no such setting");
        assert!(
            wrong.contains("no setting of shape-matching `3 rings`"),
            "{wrong}"
        );
        assert!(wrong.contains("`4 rings`"), "{wrong}");
        assert!(Tissue::named("linear: fast").is_err());
        assert!(Tissue::named("corotational: 0 passes").is_err());
        let four = Tissue::named("corotational: 4 passes").expect("a setting");
        assert_eq!(four.to_string(), "corotational: 4 passes");
        assert_eq!(Tissue::named("auto"), Ok(Tissue::Auto));
        // Its fibres have no key in a scene.
        assert!(Tissue::named("energy-balance-fiber").is_err());
    }

    /// What is asked for wins; all else of corotational tissue is the scene's.
    #[test]
    fn another_setting_leaves_the_scenes_others() {
        let of = |passes, tolerance| {
            Tissue::Corotational(Corotational {
                passes,
                tolerance,
                ..Corotational::default()
            })
        };
        let scenes = of(Some(2), Some(1e-4));
        let four = Tissue::named("corotational: 4 passes").expect("a setting");
        assert_eq!(four.instead_of(scenes), of(Some(4), Some(1e-4)));
        let usual = Tissue::named("corotational").expect("a name");
        assert_eq!(usual.instead_of(scenes), scenes);
        assert_eq!(four.instead_of(Tissue::Linear), four);
        assert_eq!(Tissue::Linear.instead_of(scenes), Tissue::Linear);
    }

    #[test]
    fn a_body_has_the_mass_that_the_scene_says() {
        let of = |more: &str| {
            let text = format!(
                "[mesh.slab]\nsize_m = [0.06, 0.06, 0.03]\ndivisions = [2, 2, 1]\n\
                 [tissue]\nyoungs_modulus_pa = 10e3\npoisson_ratio = 0.4\n{more}\
                 [[fixed]]\nplane = {{ axis = \"z\", at_m = -0.03 }}\n[[tool]]\nradius_m = 0.035\n"
            );
            let document = Document::embedded("test.toml", "".as_ref(), &text);
            let scene = Scene::read(&document, "test").expect("good");
            scene.body().substance.density_kg_per_m3
        };
        assert_eq!(of("density_kg_per_m3 = 916.0\n"), 916.0);
        assert_eq!(of(""), DENSITY_KG_PER_M3);
    }
}
