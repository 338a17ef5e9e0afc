//! The tissue models by name, each with the settings over which it is measured.
//!
//! Entry points: [`entries`], [`entry`]. A new model is one entry here; trade-off and stability then have it.

mod substance;

pub use substance::Substance;

use crate::fem::{CorotationalModel, LinearModel, ModelSettings, Policy};
use crate::mesh::TetMesh;
use sutura_models::chainmail::{
    ClassicalChainMail, ClassicalSettings, EllipsoidChainMail, EllipsoidSettings,
};
use sutura_models::energy_balance::{self, EnergyBalance, Form, Lanes, Prony};
use sutura_models::hyperelastic::{self, Cells, Hyperelastic, Motion, Scheme};
use sutura_models::law::Law;
use sutura_models::shape_matching::{ShapeMatching, ShapeMatchingSettings};
use sutura_models::{Material, Materials, Tissue, chainmail, shape_matching as matching};

/// Builds tissue, or says why it refuses.
pub type Build = Box<dyn Fn(&Body, &TetMesh) -> Result<Box<dyn Tissue>, String> + Send + Sync>;

/// What tissue is to be made of.
#[derive(Clone, Debug, PartialEq)]
pub struct Body {
    /// All of it, but for the materials of `cells`.
    pub substance: Substance,
    /// Material of each cell in place of the substance's, (m); empty: the same everywhere.
    pub cells: Vec<Material>,
}

impl Body {
    /// The same everywhere.
    pub fn of(substance: Substance) -> Self {
        Self {
            substance,
            cells: Vec::new(),
        }
    }

    fn in_cells(&self) -> Vec<Substance> {
        let of = |material: &Material| Substance {
            material: *material,
            ..self.substance
        };
        self.cells.iter().map(of).collect()
    }

    /// For models of elasticity at small strain.
    fn materials(&self) -> Materials {
        if self.cells.is_empty() {
            return self.substance.material.into();
        }
        Materials::by_cell(self.cells.clone(), (0..self.cells.len() as u32).collect())
    }

    /// For hyperelastic models: one law, or one for each cell.
    pub(crate) fn laws(&self, law: fn(&Substance) -> Law) -> Vec<Law> {
        if self.cells.is_empty() {
            return vec![law(&self.substance)];
        }
        self.in_cells().iter().map(law).collect()
    }
}

/// One way to run a model.
pub struct Setting {
    /// The knobs in words.
    pub name: String,
    /// In the short table as well.
    pub short: bool,
    /// Whether these are the cells of the truth, which would only be compared with itself on its own mesh.
    pub of_truth: bool,
    /// Makes it.
    pub build: Build,
}

/// One model.
pub struct Entry {
    /// Its name for people, scenes and `--only`.
    pub tissue: &'static str,
    /// Whether it has forces in newtons.
    pub has_forces: bool,
    /// Whether its step has a length: what it does depends on the time that passes.
    pub has_step: bool,
    /// Why scenes with needles or threads cannot have it, if so.
    pub refuses_needles: Option<&'static str>,
    /// Substances it is meant for; others it would treat as something else.
    pub fits: fn(&Substance) -> bool,
    /// The usual one in double precision, where that is not what it has.
    pub double: Option<Setting>,
    /// With masses and time, where the usual one goes straight to balance.
    pub dynamic: Option<Setting>,
    /// What it is measured with; the first is the usual one.
    pub settings: Vec<Setting>,
}

impl Entry {
    /// With the usual settings.
    ///
    /// # Errors
    /// Why the model refuses.
    pub fn build(&self, body: &Body, mesh: &TetMesh) -> Result<Box<dyn Tissue>, String> {
        match self.settings.first() {
            Some(setting) => (setting.build)(body, mesh),
            None => Err("there are no settings".to_owned()),
        }
    }
}

/// Why needles and threads do not go with models that balance all nodes at once and have no factored tangent besides.
const NO_COLUMNS: &str = "it balances all nodes at once; needles and thread need the compliance between points inside \
     cells: use linear, corotational or hyperelastic tissue";

/// All models.
pub fn entries() -> Vec<Entry> {
    vec![
        linear(),
        corotational(),
        hyperelastic(),
        energy_balance("energy-balance-neo-hookean", always, |substance| {
            Law::neo_hookean(substance.material)
        }),
        energy_balance("energy-balance-stvk", isotropic, |substance| {
            Law::st_venant_kirchhoff(substance.material)
        }),
        energy_balance("energy-balance-fiber", fibred, Substance::law),
        energy_balance("energy-balance-prony", relaxing, Substance::law),
        chainmail_classical(),
        chainmail_ellipsoid(),
        shape_matching(),
    ]
}

/// One model by its name.
pub fn entry(tissue: &str) -> Option<Entry> {
    entries().into_iter().find(|entry| entry.tissue == tissue)
}

fn always(_: &Substance) -> bool {
    true
}

fn isotropic(substance: &Substance) -> bool {
    substance.fibres.is_none() && substance.relaxation.is_none()
}

fn fibred(substance: &Substance) -> bool {
    substance.fibres.is_some()
}

fn relaxing(substance: &Substance) -> bool {
    substance.relaxation.is_some()
}

fn setting<T: Tissue + 'static, E: std::fmt::Display>(
    name: impl Into<String>,
    short: bool,
    build: impl Fn(&Body, &TetMesh) -> Result<T, E> + Send + Sync + 'static,
) -> Setting {
    Setting {
        name: name.into(),
        short,
        of_truth: false,
        build: Box::new(move |body, mesh| match build(body, mesh) {
            Ok(tissue) => Ok(Box::new(tissue)),
            Err(error) => Err(error.to_string()),
        }),
    }
}

fn linear() -> Entry {
    Entry {
        tissue: "linear",
        has_forces: true,
        has_step: false,
        refuses_needles: None,
        fits: always,
        double: None,
        dynamic: None,
        settings: vec![setting("", true, |body, mesh| {
            LinearModel::new(mesh, body.materials())
        })],
    }
}

fn corotational() -> Entry {
    let with = |name: &str, short, settings: ModelSettings| {
        setting(name, short, move |body: &Body, mesh: &TetMesh| {
            CorotationalModel::new(mesh, body.materials(), settings)
        })
    };
    let usual = |iterations| ModelSettings {
        iterations,
        ..ModelSettings::default()
    };
    let never = |iterations| ModelSettings {
        policy: Policy {
            refactor_rotation_rad: f64::INFINITY,
            refactor_every: u32::MAX,
            ..Policy::default()
        },
        ..usual(iterations)
    };
    let always_anew = |iterations| ModelSettings {
        iterations,
        tolerance: 1e-4,
        ..ModelSettings::CONVERGED
    };
    Entry {
        tissue: "corotational",
        has_forces: true,
        has_step: false,
        refuses_needles: None,
        fits: always,
        double: None,
        dynamic: None,
        settings: vec![
            with("4 solves, factor at 0.1 rad", true, usual(4)),
            with("1 solve, factor at 0.1 rad", true, usual(1)),
            with("1 solve, factor never", false, never(1)),
            with("4 solves, factor never", false, never(4)),
            with("1 solve, factor always", false, always_anew(1)),
            with("4 solves, factor always", false, always_anew(4)),
            with("to 1e-10, factor always", true, ModelSettings::CONVERGED),
        ],
    }
}

/// Settings of hyperelastic tissue: in words, in the short table as well, cells, and the share of the forces that is left
/// out of balance.
const HYPERELASTIC: [(&str, bool, Cells, f64); 4] = [
    ("linear cells, to 1e-3", true, Cells::Linear, 1e-3),
    ("linear cells, to 1e-9", false, Cells::Linear, 1e-9),
    ("averaged cells, to 1e-3", true, Cells::Averaged, 1e-3),
    ("quadratic cells, to 1e-3", false, Cells::Quadratic, 1e-3),
];

/// Cells and tolerance of a setting of hyperelastic tissue by its name.
pub(crate) fn hyperelastic_setting(name: &str) -> Option<(Cells, f64)> {
    let found = HYPERELASTIC.into_iter().find(|(own, ..)| *own == name);
    found.map(|(_, _, cells, tolerance)| (cells, tolerance))
}

fn hyperelastic() -> Entry {
    let with = |name: &str, short, cells: Cells, tolerance: f64| {
        setting(name, short, move |body: &Body, mesh: &TetMesh| {
            let settings = hyperelastic::Settings {
                cells,
                tolerance,
                ..hyperelastic::Settings::default()
            };
            Hyperelastic::new(mesh, &body.laws(Substance::law), settings)
        })
    };
    Entry {
        tissue: "hyperelastic",
        has_forces: true,
        has_step: false,
        refuses_needles: None,
        fits: always,
        double: None,
        dynamic: Some(setting(
            "backward Euler",
            false,
            |body: &Body, mesh: &TetMesh| {
                let settings = hyperelastic::Settings {
                    motion: Motion::Implicit {
                        density_kg_per_m3: body.substance.density_kg_per_m3,
                        drag_per_s: 20.0,
                        scheme: Scheme::BackwardEuler,
                    },
                    tolerance: 1e-6,
                    ..hyperelastic::Settings::default()
                };
                Hyperelastic::new(mesh, &body.laws(Substance::law), settings)
            },
        )),
        settings: HYPERELASTIC
            .into_iter()
            .map(|(name, short, cells, tolerance)| Setting {
                of_truth: cells == Cells::Quadratic,
                ..with(name, short, cells, tolerance)
            })
            .collect(),
    }
}

fn energy_balance(
    tissue: &'static str,
    fits: fn(&Substance) -> bool,
    law: fn(&Substance) -> Law,
) -> Entry {
    let relaxes = tissue.ends_with("prony");
    let with = |name: &str, short, form, lanes, iterations| {
        setting(name, short, move |body: &Body, mesh: &TetMesh| {
            let relaxation = match body.substance.relaxation {
                Some((share, time_s)) if relaxes => vec![Prony { share, time_s }],
                _ => Vec::new(),
            };
            let settings = energy_balance::Settings {
                form,
                iterations,
                lanes,
                relaxation,
                density_kg_per_m3: body.substance.density_kg_per_m3,
                ..energy_balance::Settings::default()
            };
            EnergyBalance::new(mesh, &body.laws(law), settings)
        })
    };
    let mut settings = vec![
        with(
            "balanced, 20 iterations",
            true,
            Form::Balanced,
            Lanes::Wide,
            20,
        ),
        with(
            "balanced, 5 iterations",
            true,
            Form::Balanced,
            Lanes::Wide,
            5,
        ),
        with(
            "balanced, 100 iterations",
            false,
            Form::Balanced,
            Lanes::Wide,
            100,
        ),
        with(
            "balanced, 20 iterations, scalar",
            false,
            Form::Balanced,
            Lanes::Scalar,
            20,
        ),
    ];
    if !relaxes {
        settings.extend([
            with(
                "compliant, 20 iterations",
                false,
                Form::Compliant,
                Lanes::Wide,
                20,
            ),
            with(
                "averaged, 20 iterations",
                false,
                Form::Averaged,
                Lanes::Wide,
                20,
            ),
            with(
                "printed, 20 iterations",
                false,
                Form::Printed,
                Lanes::Wide,
                20,
            ),
        ]);
    }
    Entry {
        tissue,
        has_forces: true,
        has_step: relaxes,
        refuses_needles: Some(NO_COLUMNS),
        fits,
        double: Some(with(
            "balanced, 20 iterations, scalar",
            false,
            Form::Balanced,
            Lanes::Scalar,
            20,
        )),
        dynamic: (!relaxes).then(|| {
            setting("dynamic", false, move |body: &Body, mesh: &TetMesh| {
                let settings = energy_balance::Settings {
                    motion: energy_balance::Motion::Dynamic,
                    density_kg_per_m3: body.substance.density_kg_per_m3,
                    ..energy_balance::Settings::default()
                };
                EnergyBalance::new(mesh, &body.laws(law), settings)
            })
        }),
        settings,
    }
}

fn chainmail_classical() -> Entry {
    let with = |name: &str, short, change: fn(&mut ClassicalSettings)| {
        setting(name, short, move |body: &Body, mesh: &TetMesh| {
            let mut settings = ClassicalSettings {
                density_kg_per_m3: body.substance.density_kg_per_m3,
                ..ClassicalSettings::default()
            };
            change(&mut settings);
            if !body.cells.is_empty() {
                return Err(
                    "a classical ChainMail has one material and one box for all cells".to_owned(),
                );
            }
            ClassicalChainMail::new(mesh, body.substance.material, settings)
                .map_err(|error| error.to_string())
        })
    };
    Entry {
        tissue: "chainmail-classical",
        has_forces: true,
        has_step: false,
        refuses_needles: Some(chainmail::REFUSAL),
        fits: always,
        double: None,
        dynamic: None,
        settings: vec![
            with("4 relaxations", true, |_| {}),
            with("as printed", true, |settings| settings.relaxations = 0),
            with("32 relaxations", false, |settings| {
                settings.relaxations = 32
            }),
        ],
    }
}

fn chainmail_ellipsoid() -> Entry {
    let with = |name: &str, short, change: fn(&mut EllipsoidSettings)| {
        setting(name, short, move |body: &Body, mesh: &TetMesh| {
            let mut settings = EllipsoidSettings {
                density_kg_per_m3: body.substance.density_kg_per_m3,
                ..EllipsoidSettings::default()
            };
            change(&mut settings);
            EllipsoidChainMail::new(mesh, body.materials(), settings)
        })
    };
    Entry {
        tissue: "chainmail-ellipsoid",
        has_forces: true,
        has_step: true,
        refuses_needles: Some(chainmail::REFUSAL),
        fits: always,
        double: None,
        dynamic: None,
        settings: vec![
            with("limit 0.3", true, |_| {}),
            with("limit 0.1", true, |settings| {
                settings.strain_limit = [0.1; 3]
            }),
            with("limit 0.3, no springs", false, |settings| {
                settings.stiffness = 0.0
            }),
            with("limit 0.3, 16 visits", false, |settings| {
                settings.visits = 16
            }),
        ],
    }
}

fn shape_matching() -> Entry {
    let with = |name: &str, short, rings| {
        setting(name, short, move |body: &Body, mesh: &TetMesh| {
            let settings = ShapeMatchingSettings {
                rings,
                density_kg_per_m3: body.substance.density_kg_per_m3,
                ..ShapeMatchingSettings::default()
            };
            ShapeMatching::new(mesh, body.materials(), settings)
        })
    };
    Entry {
        tissue: "shape-matching",
        has_forces: true,
        has_step: true,
        refuses_needles: Some(matching::REFUSAL),
        fits: always,
        double: None,
        dynamic: None,
        settings: vec![
            with("2 rings", true, 2),
            with("1 ring", false, 1),
            with("4 rings", false, 4),
        ],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_settings_are_unique() {
        let entries = entries();
        for (index, entry) in entries.iter().enumerate() {
            assert!(
                entries[..index]
                    .iter()
                    .all(|other| other.tissue != entry.tissue)
            );
            assert!(entry.settings.first().is_some_and(|setting| setting.short));
            for (index, setting) in entry.settings.iter().enumerate() {
                let others = &entry.settings[..index];
                assert!(others.iter().all(|other| other.name != setting.name));
            }
        }
    }
}
