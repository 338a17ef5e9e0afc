//! What tissue weighs: `gravity_m_per_s2`, and `density_kg_per_m3` of `[tissue]` and of each `[[region]]`.
//!
//! Entry points: [`read_gravity`], [`read_densities`], [`read_settle`].

use super::document::{Document, Flaw, SceneError};
use super::{Needle, Scene, Tissue, units};
use crate::fem::{LinearTissue, Loads, NodeLoad, weight};
use crate::mesh::TetMesh;
use crate::needle::NeedleWeight;
use std::ops::Range;
use sutura_scene_file::scene::SceneFile;
use toml::Spanned;

/// Strongest gravity \[m/s^2\]: three times the Earth's.
const STRONGEST_M_PER_S2: f64 = 30.0;
/// Lightest and heaviest tissue \[kg/m^3\]: beyond foam and beyond any metal.
const DENSITIES: [f64; 2] = [1.0, 30_000.0];
/// Lightest body tissue \[kg/m^3\]: an inflated lung has some 200.
const LIGHTEST_TISSUE: f64 = 100.0;
/// What a density in g/cm^3, kg/mm^3 or t/mm^3 is multiplied by, and one in g/m^3.
const FACTORS: [f64; 4] = [1e3, 1e9, 1e12, 1e-3];
/// Sag over size from which linear tissue is said to be none: its error is of the square of its turns.
const LARGE_SAG: f64 = 0.1;
const PER_VOLUME: &str = "`density_kg_per_m3`: water has 1000, muscle 1060, liver 1060, fat 920";

/// What pulls on all tissue, and what that gives.
#[derive(Clone, Debug, PartialEq)]
pub struct Gravity {
    /// What all falls with \[m/s^2\], (3), world frame.
    pub m_per_s2: [f64; 3],
    /// Mass of all tissue \[kg\].
    pub mass_kg: f64,
    /// Weight of every node \[N\]: a quarter of that of each of its cells.
    pub(crate) on_nodes: Vec<NodeLoad>,
}

impl Scene {
    /// What acts on the tissue besides tools: `[[load]]`s, `[[handle]]`s, and its weight.
    pub fn acting(&self) -> Loads {
        let mut all = self.loads.clone();
        let weight = self.gravity.iter().flat_map(|gravity| &gravity.on_nodes);
        all.forces.extend(weight);
        all
    }

    /// Weight of all tissue \[N\].
    pub fn weight_n(&self) -> f64 {
        self.gravity.as_ref().map_or(0.0, |gravity| {
            let strength = gravity.m_per_s2.map(|g| g * g).iter().sum::<f64>().sqrt();
            gravity.mass_kg * strength
        })
    }

    /// That its weight has no balance; nothing where the tissue weighs nothing.
    pub(super) fn collapse(&self) -> Option<SceneError> {
        let weight_n = self.weight_n();
        if weight_n == 0.0 {
            return None;
        }
        let tissue = LinearTissue::new(&self.mesh, self.materials.clone(), &self.fixed).ok()?;
        let found = tissue.solve(&self.acting()).ok()?;
        let ways = found
            .displacement_m
            .iter()
            .map(|u| u[0].hypot(u[1]).hypot(u[2]));
        Some(SceneError::Collapses {
            weight_n,
            sag_m: ways.fold(0.0, f64::max),
            size_m: units::size_m(&self.mesh),
        })
    }

    /// Warning of tissue that sags far under its weight: it rests, on what it touches, with its nodes at `positions_m`
    /// (n x 3).
    pub(crate) fn sags(&self, positions_m: &[[f64; 3]]) -> Option<String> {
        let (sag_m, size_m) = (self.moved_m(positions_m), units::size_m(&self.mesh));
        let is_linear = matches!(self.tissue, Tissue::Linear | Tissue::Auto);
        let (most, help) = match is_linear {
            true => (
                LARGE_SAG,
                "linear tissue is right where that is small: take `model = \"corotational\"`, or see that `youngs_modulus_pa` is in Pa",
            ),
            false => (1.0, "see that `youngs_modulus_pa` is in Pa"),
        };
        (self.weight_n() > 0.0 && sag_m > most * size_m).then(|| {
            format!(
                "the tissue sags by {:.1} mm under its weight, {:.0} % of its size of {:.1} mm: {help}",
                1e3 * sag_m,
                100.0 * sag_m / size_m,
                1e3 * size_m
            )
        })
    }
}

/// Gravity and the weight that the densities of the cells give with it; none in a scene that does not name it, or names no
/// direction. `of_cell`: 0 for `[tissue]`, else which `[[region]]`, from 1, (m); `densities` by that number \[kg/m^3\].
///
/// # Errors
/// A flaw at gravity that is none, at what has no density, and where a part of the tissue is held by nothing.
pub(super) fn read_gravity(
    document: &Document,
    file: &SceneFile,
    mesh: &TetMesh,
    of_cell: &[u32],
    densities: &[Option<f64>],
    fixed: &[u32],
    warnings: &mut Vec<Flaw>,
) -> Result<Option<Gravity>, SceneError> {
    let Some(value) = &file.gravity_m_per_s2 else {
        warnings.extend(idle_densities(document, file));
        return Ok(None);
    };
    let m_per_s2 = read_acceleration(document, value)?;
    if m_per_s2 == [0.0; 3] {
        return Ok(Some(Gravity {
            m_per_s2,
            mass_kg: 0.0,
            on_nodes: Vec::new(),
        }));
    }
    let mut of_cells = Vec::with_capacity(of_cell.len());
    for index in of_cell {
        match densities.get(*index as usize).copied().flatten() {
            Some(density) => of_cells.push(density),
            None => return Err(without_density(document, file, value.span(), *index)),
        }
    }
    if let Some(node) = unheld(mesh, fixed) {
        let [x, y, z] = mesh.points_m()[node as usize].map(|x| 1e3 * x);
        let message = format!(
            "gravity, and nothing holds the part of the tissue with node {node} at [{x:.1}, {y:.1}, {z:.1}] mm: it falls"
        );
        let help =
            "add a `[[fixed]]` that holds some of it, or connect it with the rest of the mesh";
        return Err(document.flaw(value.span(), message, "falls for ever", Some(help)));
    }
    let (mass_kg, on_nodes) = weight(mesh, &of_cells, m_per_s2);
    Ok(Some(Gravity {
        m_per_s2,
        mass_kg,
        on_nodes,
    }))
}

fn read_acceleration(
    document: &Document,
    value: &Spanned<[f64; 3]>,
) -> Result<[f64; 3], SceneError> {
    let m_per_s2 = document.finite("gravity_m_per_s2", value)?;
    let strength = m_per_s2.map(|g| g * g).iter().sum::<f64>().sqrt();
    if strength <= STRONGEST_M_PER_S2 {
        return Ok(m_per_s2);
    }
    let message = format!(
        "gravity_m_per_s2 is {strength} m/s^2 strong: must be at most {STRONGEST_M_PER_S2}"
    );
    let help = match 1e-3 * strength <= STRONGEST_M_PER_S2 {
        true => format!(
            "on the Earth it is [0.0, 0.0, -9.81], z up; times 0.001, from mm/s^2, yours is {:?}",
            m_per_s2.map(|g| 1e-3 * g)
        ),
        false => "on the Earth it is [0.0, 0.0, -9.81], z up".to_owned(),
    };
    Err(document.flaw(value.span(), message, "too strong", Some(&help)))
}

/// Gives needles what they fall with: with gravity, those that have a density.
///
/// # Errors
/// A flaw at a density that is none of any matter, and at one of a needle without a body.
pub(super) fn weigh_needles(
    document: &Document,
    file: &SceneFile,
    gravity: Option<&Gravity>,
    needles: &mut [Needle],
    warnings: &mut Vec<Flaw>,
) -> Result<(), SceneError> {
    for (needle, section) in needles.iter_mut().zip(&file.needle) {
        let Some(value) = &section.get_ref().density_kg_per_m3 else {
            continue;
        };
        let [least, most] = DENSITIES;
        let rule = format!("from {least} to {most}");
        let sound = |density| (least..=most).contains(&density);
        let help = "steel has 7900, titanium 4500";
        let density_kg_per_m3 = document.number("density_kg_per_m3", value, &rule, sound, help)?;
        if !needle.body {
            let message =
                "a needle that weighs something, and has no body to lie on the tissue with";
            let help =
                "add `body = true`, or leave the density out: then it stays where it is let go";
            return Err(document.flaw(value.span(), message, "it falls through", Some(help)));
        }
        match gravity {
            Some(gravity) => {
                needle.weight = Some(NeedleWeight {
                    density_kg_per_m3,
                    gravity_m_per_s2: gravity.m_per_s2,
                });
            }
            None => warnings.push(idle_density(document, value)),
        }
    }
    Ok(())
}

/// Density of `[tissue]` first, then of each `[[region]]`, which has that of `[tissue]` where it says nothing \[kg/m^3\].
///
/// # Errors
/// A flaw at one that is none of any matter, with the factor that another unit suggests.
pub(super) fn read_densities(
    document: &Document,
    file: &SceneFile,
    warnings: &mut Vec<Flaw>,
) -> Result<Vec<Option<f64>>, SceneError> {
    let regions = file
        .region
        .iter()
        .map(|region| &region.get_ref().density_kg_per_m3);
    let mut list: Vec<Option<f64>> = Vec::with_capacity(1 + file.region.len());
    for value in std::iter::once(&file.tissue.density_kg_per_m3).chain(regions) {
        let own = match value {
            Some(value) => {
                let density = read_density(document, value)?;
                warnings.extend(light(document, value));
                Some(density)
            }
            None => list.first().copied().flatten(),
        };
        list.push(own);
    }
    Ok(list)
}

/// A density \[kg/m^3\].
///
/// # Errors
/// A flaw at one that is none of any matter, with the factor that another unit suggests.
fn read_density(document: &Document, value: &Spanned<f64>) -> Result<f64, SceneError> {
    let density = *value.get_ref();
    let [least, most] = DENSITIES;
    let help = match likely_factor(density) {
        Some(factor) => format!(
            "water has 1000, muscle 1060, fat 920; times {factor:e} yours is {:.0}",
            factor * density
        ),
        None => "water has 1000, muscle 1060, fat 920".to_owned(),
    };
    let rule = format!("from {least} to {most}");
    let sound = |density| (least..=most).contains(&density);
    document.number("density_kg_per_m3", value, &rule, sound, &help)
}

/// The factor with which a density is one of soft tissue or bone.
fn likely_factor(density: f64) -> Option<f64> {
    let mut factors = FACTORS.into_iter();
    factors.find(|factor| (500.0..=3000.0).contains(&(factor * density)))
}

/// A warning of a density that is possible, and hardly of tissue.
fn light(document: &Document, value: &Spanned<f64>) -> Option<Flaw> {
    let density = *value.get_ref();
    let factor = likely_factor(density).filter(|_| density < LIGHTEST_TISSUE)?;
    let message = format!("density_kg_per_m3 = {density}: hardly any tissue is so light");
    let help = format!(
        "water has 1000 kg/m^3, which is 1 g/cm^3: times {factor} yours is {:.0}",
        factor * density
    );
    Some(document.warning(value.span(), &message, "hardly kg/m^3", &help))
}

/// Warnings of densities that weigh nothing: of regions, and of tissue on which a density has no other use.
fn idle_densities(document: &Document, file: &SceneFile) -> Vec<Flaw> {
    let has_mass = file.tissue.model.has_mass();
    let own = file.tissue.density_kg_per_m3.iter().filter(|_| !has_mass);
    let regions = file.region.iter();
    let regions = regions.filter_map(|region| region.get_ref().density_kg_per_m3.as_ref());
    let densities = own.chain(regions);
    densities
        .map(|value| idle_density(document, value))
        .collect()
}

fn idle_density(document: &Document, value: &Spanned<f64>) -> Flaw {
    let message = "a density, but no gravity: it has no effect";
    let help = "add `gravity_m_per_s2 = [0.0, 0.0, -9.81]` at the top, or leave the density out";
    document.warning(value.span(), message, "weighs nothing", help)
}

/// That cells have no density: those of `[tissue]`, or of a region.
fn without_density(
    document: &Document,
    file: &SceneFile,
    gravity: Range<usize>,
    index: u32,
) -> SceneError {
    let region = (index as usize).checked_sub(1);
    let region = region.and_then(|region| file.region.get(region));
    let Some(region) = region else {
        let message = "gravity, but nothing says what the tissue weighs";
        let help = format!("add to `[tissue]` {PER_VOLUME}");
        return document.flaw(gravity, message, "on no mass", Some(&help));
    };
    let name = match &region.get_ref().tag {
        Some(tag) => format!("region {}", tag.get_ref()),
        None => "this region".to_owned(),
    };
    let message = format!("gravity, but nothing says what {name} weighs");
    let help = format!("add to this `[[region]]`, or to `[tissue]` for all of them, {PER_VOLUME}");
    document.flaw(region.span(), message, "has no density", Some(&help))
}

/// A node of a connected part of the mesh in which none is fixed, if there is one.
fn unheld(mesh: &TetMesh, fixed: &[u32]) -> Option<u32> {
    let nodes = mesh.points_m().len() as u32;
    let mut parent: Vec<u32> = (0..nodes).collect();
    fn root(parent: &mut [u32], mut node: u32) -> u32 {
        while parent[node as usize] != node {
            parent[node as usize] = parent[parent[node as usize] as usize];
            node = parent[node as usize];
        }
        node
    }
    for cell in mesh.cells() {
        let first = root(&mut parent, cell[0]);
        for node in &cell[1..] {
            let other = root(&mut parent, *node);
            parent[other as usize] = first;
        }
    }
    let mut holds = vec![false; parent.len()];
    for node in fixed {
        holds[root(&mut parent, *node) as usize] = true;
    }
    (0..nodes).find(|node| !holds[root(&mut parent, *node) as usize])
}

/// Whether the tissue begins at rest under what acts on it.
///
/// # Errors
/// A flaw at a tissue that is not to, but has to: what touches it is brought to tissue at rest.
pub(super) fn read_settle(
    document: &Document,
    value: Option<&Spanned<bool>>,
    scene: &Scene,
) -> Result<(bool, Option<Flaw>), SceneError> {
    let Some(value) = value.filter(|value| !value.get_ref()) else {
        return Ok((true, None));
    };
    let brought = if !scene.touching.is_empty() {
        Some("tissues that touch")
    } else if !scene.loads.handles.is_empty() {
        Some("handles")
    } else if scene.held().next().is_some() {
        Some("tools that the scene holds")
    } else {
        None
    };
    if let Some(brought) = brought {
        let message = format!("{brought} are brought to tissue at rest");
        let help = "leave `settle` out";
        return Err(document.flaw(value.span(), message, "cannot be", Some(help)));
    }
    let idle = if scene.acting().forces.is_empty() {
        Some("nothing acts on the tissue: it is at rest as the mesh has it")
    } else if matches!(scene.tissue, Tissue::Linear | Tissue::Auto) {
        Some("linear tissue is at rest with the first solve: it has no way to go there")
    } else {
        None
    };
    let help = "leave `settle` out; corotational and hyperelastic tissue go there in some solves";
    let warning = idle.map(|why| document.warning(value.span(), why, "has no effect", help));
    Ok((false, warning))
}
